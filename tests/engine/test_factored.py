"""Columns that are products of a site's column and functions of a sample: the sums and fits of dense ones."""

from dataclasses import fields

import numpy as np
import pytest
from engine.linear_problem import Column, Driver, LinearProblem, Process, linear_problem

from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.noise import Autocorrelation, NoiseModel
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.terms import Factored, Terms, gram, pulled

WHEEL = Process("wheel", (Driver("angle"),), (-9.0, 9.0), "fine")


class Dense(LinearProblem):
    def factored(self, term):
        return None


def dense(problem):
    """The same problem without products."""
    return Dense(**{field.name: getattr(problem, field.name) for field in fields(problem)})


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
def test_a_process_of_many_numbers_is_fitted_as_with_dense_columns(noise):
    problem = linear_problem(np.random.default_rng(3), planted=lambda d: 0.8 * d["u2"] + np.abs(d["angle"]))
    terms = Terms((Column("u2"), WHEEL))
    one, other = (fit(each, terms, EngineOptions(), noise=noise) for each in (problem, dense(problem)))
    assert problem.factored(terms.terms[1]) is not None
    np.testing.assert_allclose(one.values, other.values, rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-8, atol=1e-12)
    assert one.parameters == pytest.approx(other.parameters, abs=1e-6)
