"""What is weighed beside a model without a term, or with more, is what is weighed when nothing of the whole is used."""

from dataclasses import fields, replace

import numpy as np
import pytest
from engine.linear_problem import Column, Decay, LinearProblem, Process, Wave, linear_problem

from lite6jax.estimation.evidence import Marginal
from lite6jax.estimation.least_squares import fit, linear_columns
from lite6jax.estimation.noise import Autocorrelation, NoiseModel
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import prior_precision
from lite6jax.estimation.projection import Span
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms
from lite6jax.search.scan import ModelScan, Scan
from lite6jax.search.spectrum import lines

OPTIONS = EngineOptions()
CHANGES = {"without a name": (0,), "without a process": (2,), "without both": (0, 2)}


def computed_anew(test):
    """The same test, with an orthonormal basis of its own and nothing that is known of another one."""
    basis = test.span.basis
    span = Span(basis, np.eye(len(basis)), np.zeros((0, basis.shape[1])), np.zeros(0))
    return replace(test, span=span, whole=None, table={}, grams={})


def noise_of(kind, problem):
    """White noise, or another one in each group that is autocorrelated."""
    if kind == "white":
        return None
    return NoiseModel((Autocorrelation(0.7, 0.8), Autocorrelation(0.5, 1.0)), problem.groups, (0, 50))


class WithMasses(LinearProblem):
    """A problem with two masses more, known by a prior, that act through what the name u2 and a wave give way."""

    precision = property(lambda self: np.array([0.0, 0.0, 4.0, 1.0]))
    informative = property(lambda self: np.array([False, False, True, False]))

    def __post_init__(self):
        plain = {field.name: getattr(self, field.name) for field in fields(self)}
        object.__setattr__(self, "plain", LinearProblem(**plain | {"offset": 0.0}))
        object.__setattr__(self, "offset", np.zeros(4))
        self.data["every_run"] = self.every_run

    def nuisance_columns(self, terms, values):
        sizes = {term: values[part].sum() for term, part in terms.pairs}
        through = np.stack([self.data["u1"] + self.data["angle"], self.data["u3"] * self.data["u1"]])
        moved = sizes.get(Column("u2"), 0.0) * through + sizes.get(Wave(2.0), 0.0) * through**2
        return np.concatenate([self.levels, 0.3 * moved[:, None] * np.array(self.shares)[:, None] ** 2])

    def residual(self, nuisance, terms, values):
        masses = np.tensordot(nuisance[2:], self.nuisance_columns(terms, values)[2:], 1)
        return self.plain.residual(nuisance[:2], terms, values) + masses


@pytest.fixture(scope="module", params=["white", "autocorrelated"])
def with_masses(request):
    """A test of a model with a name through which masses act, as `whole`."""
    planted = lambda d: 0.8 * d["u2"] + np.tanh(3 * d["u3"]) + 0.4 * d["u5"] ** 2 + 0.5 * np.sin(3 * d["angle"])  # noqa: E731
    plain = linear_problem(np.random.default_rng(6), 160, planted)
    problem = WithMasses(**{field.name: getattr(plain, field.name) for field in fields(plain)})
    third = problem.quantities[2]
    process = Process("x", (third.driver,), third.bounds, "cubic", 1.0)
    noise = noise_of(request.param, problem)
    fitted = fit(problem, Terms((Column("u2"), Wave(2.0), process)), OPTIONS, noise=noise)
    return problem, Scan(problem, OPTIONS), score_test(problem, fitted, OPTIONS)


class Delayed(LinearProblem):
    """A problem whose column u4 is 0.3 of what the rest of the model does, as an offset in time has its rate."""

    def columns(self, terms, values=None, beside=None):
        columns = super().columns(terms, values, beside)
        if values is None and beside is None:
            return columns
        model, numbers = beside or (Terms(tuple(terms)), values)
        others = [term != Column("u4") for term in model.terms]
        rest, rest_numbers = model.part(numbers, others)
        done = np.tensordot(rest_numbers, super().columns(rest.terms, rest_numbers), 1) if rest.terms else 0.0
        begins = np.cumsum([0, *(term.size for term in terms)])
        for term, k in zip(terms, begins, strict=False):
            if term == Column("u4"):
                columns[k] += 0.3 * done
        return columns


@pytest.fixture(scope="module", params=["white", "autocorrelated"])
def delayed(request):
    """A test of a model with a column that follows the other terms, as `whole`."""
    planted = lambda d: 0.8 * d["u2"] + np.tanh(3 * d["u3"]) + 0.4 * d["u4"] + 0.5 * np.sin(3 * d["angle"])  # noqa: E731
    plain = linear_problem(np.random.default_rng(6), 160, planted)
    problem = Delayed(**{field.name: getattr(plain, field.name) for field in fields(plain)})
    third = problem.quantities[2]
    process = Process("x", (third.driver,), third.bounds, "cubic", 1.0)
    noise = noise_of(request.param, problem)
    fitted = fit(plain, Terms((Column("u2"), Column("u4"), process)), OPTIONS, noise=noise)
    return problem, Scan(problem, OPTIONS), score_test(problem, fitted, OPTIONS)


def projection_on(problem, test):
    """The projection on the columns of a model with the readings of their priors, those that are stated first."""
    fitted = test.fit
    columns = fitted.noise.whitened(linear_columns(problem, fitted.terms, fitted.values))
    columns = (columns * (test.scale[0] / test.scale)[:, None]).reshape(len(columns), -1)
    precision = np.append(problem.precision, prior_precision(problem, fitted.terms.terms))
    order = np.argsort(~np.append(problem.informative, np.zeros(fitted.terms.size, bool)), kind="stable")
    rows = np.concatenate([columns, (np.diag(np.sqrt(precision)) * fitted.scale[0])[:, order]], 1)
    rows = rows[columns.any(1)]
    read = len(test.residual)
    return rows[:, :read].T @ np.linalg.pinv(rows @ rows.T, hermitian=True) @ rows[:, :read]


def assert_close(some, others, tolerance=1e-9):
    scale = max(float(np.abs(others).max(initial=0.0)), 1e-300)
    np.testing.assert_allclose(some, others, rtol=0, atol=tolerance * scale)


def all_weighed(scan, test):
    """Log odds of all that is tried, by what it is."""
    weighed = ModelScan(scan, test)
    candidates = [*weighed.ranked(), *weighed.named()]
    pairs = [((pair.names[0].cause, pair.names[1].cause), pair.net) for pair in weighed.pairs_at("x")]
    by_name = {(one.key, one.process[2:], round(one.cost, 3)): one.net for one in candidates}
    return by_name | dict(pairs) | {("line", line.family.site): line.gain for line in lines(test)}


@pytest.fixture(scope="module", params=["white", "autocorrelated", "autocorrelated, of one row"])
def whole(request):
    """A test beside two names and a process, in which a wave, a bump and a name are left, of two groups of noise."""
    rng = np.random.default_rng(5)
    shares = (1.0, 0.0) if request.param.endswith("row") else (1.0, 0.5)
    planted = lambda d: 0.8 * d["u2"] + np.tanh(3 * d["u3"]) + 0.4 * d["u5"] ** 2 + 0.5 * np.sin(3 * d["angle"])  # noqa: E731
    problem = linear_problem(rng, 160, planted, shares=shares)
    problem = replace(problem, shaped=tuple(Decay("u1", width) for width in (0.5, 1.0, 2.0)))
    third = problem.quantities[2]
    process = Process("x", (third.driver,), third.bounds, "medium", 1.0)
    model = Terms((Column("u2"), Wave(2.0), process))
    noise = noise_of(request.param, problem)
    fitted = fit(problem, model, OPTIONS, noise=noise)
    return problem, Scan(problem, OPTIONS), score_test(problem, fitted, OPTIONS)


@pytest.mark.parametrize("change", CHANGES)
def test_all_that_is_tried_is_worth_the_same_beside_a_part_of_a_model(whole, change):
    _, scan, test = whole
    part = test.beside([k not in CHANGES[change] for k in range(3)])
    assert part.whole is test
    expected = all_weighed(scan, computed_anew(part))
    odds_by_name = all_weighed(scan, part)
    assert odds_by_name.keys() == expected.keys()
    assert len(odds_by_name) > 15
    for key, odds in expected.items():
        assert odds_by_name[key] == pytest.approx(odds, rel=1e-7, abs=1e-7), key
    # and once more, of what is kept by now
    again = all_weighed(scan, test.beside([k not in CHANGES[change] for k in range(3)]))
    assert again == pytest.approx(odds_by_name, rel=1e-12, abs=1e-9)


def test_all_that_is_tried_is_worth_the_same_beside_more(whole):
    problem, scan, test = whole
    part = test.beside([True, False, True])
    columns = problem.columns([Column("u4"), Column("u5")])
    more = part.extend(columns).extend(columns[:1] + problem.columns([Column("u6")]))
    assert more.whole is test
    expected = all_weighed(scan, computed_anew(more))
    odds_by_name = all_weighed(scan, more)
    assert odds_by_name.keys() == expected.keys()
    for key, odds in expected.items():
        assert odds_by_name[key] == pytest.approx(odds, rel=1e-7, abs=1e-7), key


def test_information_and_pull_are_those_computed_anew_to_nine_digits(whole):
    problem, scan, test = whole
    part = test.beside([False, True, False])
    anew = computed_anew(part)
    changed_marginal = Marginal(part)
    marginal = Marginal(anew)
    functions = scan.splines[1][:5] + 0.1
    keys = [(k, "splines") for k in range(5)]
    for component in problem.components:
        for _ in range(2):  # computed, and then known
            of = changed_marginal.sums(component.column), marginal.sums(component.column)
            changed = changed_marginal.equations(of[0], functions, [(component.name, component.site, k) for k in keys])
            for one, other in zip(changed, marginal.equations(of[1], functions), strict=True):
                assert_close(one, other)
            exactly = changed_marginal.dense(component.column, functions[0], (component.site, component.name, "exact"))
            for one, other in zip(exactly, marginal.dense(component.column, functions[0]), strict=True):
                assert_close(one, other)


@pytest.mark.parametrize("stay", [(False, True, True), (True, False, True), (False, False, True)])
def test_beside_a_model_without_what_masses_act_through_their_columns_are_others(with_masses, stay):
    problem, scan, test = with_masses
    part = test.beside(stay)
    assert part.whole is test
    assert_close(part.basis.T @ part.basis, projection_on(problem, part))
    expected = all_weighed(scan, computed_anew(part))
    odds_by_name = all_weighed(scan, part)
    assert odds_by_name.keys() == expected.keys()
    for key, odds in expected.items():
        assert odds_by_name[key] == pytest.approx(odds, rel=1e-7, abs=1e-7), key


def test_a_part_of_a_part_is_that_part_of_the_whole(whole):
    _, _, test = whole
    at_once = test.beside([False, True, False])
    one_by_one = test.beside([False, True, True]).beside([True, False])
    assert_close(one_by_one.basis.T @ one_by_one.basis, at_once.basis.T @ at_once.basis)
    assert_close(one_by_one.left, at_once.left)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_the_transpose_of_whitening_is_its_transpose(share):
    model = Autocorrelation(0.8, share)
    starts = (0, 5, 6, 9)
    whitening = model.whitened(np.eye(13), starts)
    np.testing.assert_allclose(model.transposed(np.eye(13), starts), whitening.T, rtol=0, atol=1e-13)


def test_a_group_that_a_term_couples_is_not_coupled_without_it():
    problem = linear_problem(np.random.default_rng(2), 80, lambda d: d["u2"])
    process = Process("x", (problem.quantities[0].driver,), problem.quantities[0].bounds, spread=1.0)
    fitted = fit(problem, Terms((Column("u2"), process)), OPTIONS)
    test = score_test(problem, fitted, OPTIONS)
    assert test.coupled.all()
    assert not test.beside([False, False]).coupled[0, 1]


def test_what_one_model_knows_of_candidates_serves_another_in_other_noise(whole):
    """Products of candidates with themselves are kept over each group's own noise: scales change, they do not."""
    problem, scan, test = whole
    grams = {}
    all_weighed(scan, score_test(problem, test.fit, OPTIONS, grams))
    count = len(grams)
    assert count > 100
    fewer = fit(problem, test.fit.terms.part(test.fit.values, [True, False, False])[0], OPTIONS, noise=test.fit.noise)
    assert np.abs(np.log(fewer.scale / test.fit.scale)).max() > 0.1
    expected = all_weighed(scan, score_test(problem, fewer, OPTIONS))
    odds_by_name = all_weighed(scan, score_test(problem, fewer, OPTIONS, grams))
    assert len(grams) < 1.5 * count
    assert odds_by_name == pytest.approx(expected, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("stay", [(False, True, True), (True, True, False), (False, True, False), (True, False, True)])
def test_beside_a_model_without_what_a_column_follows_it_is_another(delayed, stay):
    problem, scan, test = delayed
    part = test.beside(stay)
    assert part.whole is test
    assert_close(part.basis.T @ part.basis, projection_on(problem, part))
    expected = all_weighed(scan, computed_anew(part))
    odds_by_name = all_weighed(scan, part)
    assert odds_by_name.keys() == expected.keys()
    for key, odds in expected.items():
        assert odds_by_name[key] == pytest.approx(odds, rel=1e-7, abs=1e-7), key
