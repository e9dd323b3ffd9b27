"""Columns that are products of a site's column and functions of a sample: the sums and fits of dense ones."""

import numpy as np
import pytest
from engine.linear_problem import Column, Curve, Hat, LinearProblem, linear_problem

from lite6jax.estimation.equations import explained_by
from lite6jax.estimation.factored import Factored, gram, pulled
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.noise import Autocorrelation, NoiseModel
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms

ORDERS = tuple(range(1, 26))


class Dense(LinearProblem):
    def factored(self, term):
        return None


def test_sums_are_those_of_dense_columns():
    rng = np.random.default_rng(1)
    plain, root, rows = rng.normal(size=(4, 3, 50)), rng.uniform(size=(3, 50)), rng.normal(size=(3, 50))
    sites = [Factored(rng.normal(size=(c, 3, 50)), rng.normal(size=(k, 50))) for c, k in ((1, 5), (2, 2), (3, 4))]
    dense = [(one.site[:, None] * one.functions[:, None]).reshape(-1, 3, 50) for one in sites]
    every = np.concatenate([plain, *dense]) * root
    parts = [plain * root, *(site.weighed(root) for site in sites)]
    np.testing.assert_allclose(gram(parts), np.einsum("irs,jrs->ij", every, every), rtol=0, atol=1e-12)
    np.testing.assert_allclose(pulled(parts, rows), np.einsum("irs,rs->i", every, rows), rtol=0, atol=1e-12)
    for one, full in zip(sites, dense, strict=True):
        values = rng.normal(size=len(one))
        np.testing.assert_allclose(one.total(values), np.tensordot(values, full, 1), rtol=0, atol=1e-12)


@pytest.mark.parametrize("noise", [None, NoiseModel((Autocorrelation(0.9, 0.5),) * 2, np.array([0, 1]))])
def test_a_curve_of_many_numbers_is_fitted_as_with_dense_columns(noise):
    problem = linear_problem(np.random.default_rng(3), planted=lambda d: 0.8 * d["u2"] + np.abs(d["angle"]))
    terms, dense = Terms((Column("u2"), Hat(0.0, 1.0, 1, ORDERS))), Dense(**vars(problem))
    one, other = (fit(each, terms, EngineOptions(), noise=noise) for each in (problem, dense))
    assert problem.factored(terms.terms[1]) is not None
    np.testing.assert_allclose(one.values, other.values, rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-8, atol=1e-12)
    assert one.parameters == pytest.approx(other.parameters, abs=1e-6)


@pytest.mark.parametrize("noise", [None, NoiseModel((Autocorrelation(0.9, 0.5),) * 2, np.array([0, 1]))])
def test_terms_explain_what_their_dense_columns_do(noise):
    """And what a part of a function explains is in the equations of the whole."""
    problem = linear_problem(np.random.default_rng(4), planted=lambda d: 0.3 * d["u2"] ** 2 + 0.2 * d["u1"])
    options, model = EngineOptions(), Terms((Column("u1"),))
    tests = [
        score_test(each, fit(each, model, options, noise=noise), options) for each in (problem, Dense(**vars(problem)))
    ]
    terms = [Column("u1"), Curve("u2"), Curve("u3", degree=4), Hat(0.0, 1.0, 3), Column("u4")]
    found, dense = (test.explained(terms) for test in tests)
    assert [one.size for one in found] == [one.size for one in dense]
    assert found[0].confounded
    assert found[1].gain > 10
    np.testing.assert_allclose([one.gain for one in found], [one.gain for one in dense], rtol=1e-9, atol=1e-9)
    (whole,) = tests[0].equations(terms[1:2])
    for part in terms[1].parts:
        (own,) = explained_by([whole.part(part.numbers)], options.confounded)
        assert own.gain == pytest.approx(tests[1].explained([part.made()])[0].gain, rel=1e-9)
        assert own.gain < found[1].gain
