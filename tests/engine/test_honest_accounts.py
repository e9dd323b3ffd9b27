"""One evidence of a state: each step of a search changes it by what one dense determinant says."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from engine.linear_problem import Column, Driver, Process, linear_problem

from lite6jax.estimation.least_squares import FREEDOM, fit
from lite6jax.estimation.options import DEFAULTS
from lite6jax.estimation.terms import Terms
from lite6jax.search.search import chance_of
from lite6jax.search.select import Selector
from lite6jax.search.state import SelectedTerm, State, refitted

FLAT = 1e6
"""Variance of what nothing is known of beforehand."""


def random_problem(seed):
    """Of correlated regressors that act, in noise of the declared size; with a process of one of them."""
    rng = np.random.default_rng(seed)
    correlation = rng.uniform(0.3, 0.95)
    problem = linear_problem(rng, 200, noise=(1.0, 1.0))
    data = dict(problem.data)
    data["u2"] = correlation * data["u1"] + np.sqrt(1 - correlation**2) * data["u2"]
    data["u3"] = correlation * np.tanh(2 * data["u2"]) + np.sqrt(1 - correlation**2) * data["u3"]
    sizes = rng.uniform(0.3, 0.6, 3) / np.sqrt(1 - correlation**2)
    signal = sizes @ np.stack([data[f"u{k}"] for k in (1, 2, 3)])
    problem = replace(problem, data=data, measured=problem.measured + np.outer(problem.shares, signal))
    bounds = (float(data["u2"].min()), float(data["u2"].max()))
    return problem, Process("x", (Driver("u2"),), bounds, "smooth", float(rng.uniform(0.2, 0.8)))


def states_of(process):
    """What a search passes: names and processes that are added, dropped, exchanged, and estimated anew."""
    u1 = Column("u1")
    u2 = Column("u2")
    u3 = Column("u3")
    finer = replace(process, kernel="medium", spread=0.6 * process.spread)
    return {
        "nothing": (),
        "a name added": (u1,),
        "exchanged for its neighbour": (u2,),
        "both": (u1, u2),
        "three": (u1, u2, u3),
        "a process in the place of the neighbour": (u1, process, u3),
        "estimated anew": (u1, finer, u3),
        "one dropped": (finer, u3),
        "a process beside a name of its driver": (u1, u2, process, u3),
    }


def state_of(problem, terms):
    """Of these terms, fitted and weighed."""
    selector = Selector(problem, DEFAULTS)
    baseline = fit(problem, Terms(), DEFAULTS)
    tested = [SelectedTerm(term) for term in terms]
    return selector.weighed(refitted(problem, State(baseline, baseline), tested, DEFAULTS))


def gross(state):
    """Its evidence without the costs of the choice of its terms."""
    return state.evidence + sum(test.cost for test in state.tested)


def dense_evidence(problem, state):
    """What the likelihood of the fit is less than by one determinant, that of the covariance of all readings.

    The numbers of a name have the prior covariance τ² A⁻¹, A their information beside all others, τ² as the data say:
    the shrinkage by it costs half a unit for each number.
    """
    fitted = state.fit
    names = [term for term in fitted.terms.terms if not term.nonparametric]
    root = np.sqrt(fitted.residuals.row_weight).ravel()[:, None]

    def flat(columns):
        return columns.reshape(len(columns), -1).T * root

    # of a flat prior of the levels nothing is left in their directions
    levels = flat(problem.levels)
    Q = np.linalg.svd(levels, full_matrices=True)[0][:, levels.shape[1] :]
    C = np.eye(Q.shape[1])
    for process in (term for term in fitted.terms.terms if term.nonparametric):
        F = Q.T @ flat(problem.columns([process]))
        C += process.spread**2 * F @ F.T
    outside = [Q.T @ flat(problem.columns([term])) for term in names]
    total = C.copy()
    further = 0.0
    for k, (X, name) in enumerate(zip(outside, names, strict=True)):
        rest = C + FLAT * sum((Y @ Y.T for j, Y in enumerate(outside) if j != k), np.zeros_like(C))
        A = X.T @ np.linalg.solve(rest, X)
        values = fitted.values[fitted.terms.slices[fitted.terms.terms.index(name)]]
        ratio = max(values @ A @ values / len(values), 1.0)
        further += 0.5 * len(values) * (1 - 1 / ratio)
        total += (ratio - 1) * X @ np.linalg.solve(A, X.T)
    return fitted.own_likelihood - 0.5 * np.linalg.slogdet(total)[1] - further


@pytest.mark.parametrize("seed", range(30))
def test_each_step_changes_the_evidence_by_what_one_determinant_says(seed):
    problem, process = random_problem(seed)
    states = {name: state_of(problem, terms) for name, terms in states_of(process).items()}
    dense = {name: dense_evidence(problem, state) for name, state in states.items()}
    for before, after in combinations(states, 2):
        step = gross(states[after]) - gross(states[before])
        assert step == pytest.approx(dense[after] - dense[before], abs=0.5), (before, after)


def dense_likelihood(fitted):
    """Student's, of innovations by a Cholesky factor of the noise's covariance; the filter rounds a run's beginning."""
    r = fitted.residuals
    samples = r.rows.shape[1]
    total = -0.5 * fitted.penalty
    for group, scale in enumerate(fitted.scale):
        model = fitted.noise.models[group]
        lags = np.abs(np.subtract.outer(np.arange(samples), np.arange(samples)))
        factor = np.linalg.cholesky(model.share * model.coefficient**lags + (1 - model.share) * np.eye(samples))
        of_group = r.rows[r.groups == group]
        innovations = np.linalg.solve(factor, of_group.T)
        squares = np.sum(innovations**2, 1) / scale**2
        count = len(of_group)
        total -= 0.5 * (FREEDOM + count) * np.sum(np.log1p(squares / FREEDOM)) + samples * count * np.log(scale)
        total -= count * np.log(np.diagonal(factor)).sum()
    return total


@pytest.mark.parametrize("seed", range(5))
def test_autocorrelated_noise_changes_the_evidence_by_a_dense_likelihood_and_its_price(seed):
    """Beside the same terms, from white noise and back; the price is that of a choice among the models tried."""
    rng = np.random.default_rng(seed)
    problem, _ = random_problem(seed)
    slow = np.stack([wandering(rng, 200) for _ in range(2)])
    problem = replace(problem, measured=problem.measured + 2.0 * slow)
    prior = replace(DEFAULTS.prior, autocorrelated_noise=0.1)
    white = state_of(problem, (Column("u1"), Column("u3")))
    models = {}
    for options in (DEFAULTS, replace(DEFAULTS, prior=prior)):
        selector = Selector(problem, options)
        state = replace(white, fit=selector.in_likeliest_noise(white.fit))
        assert not state.fit.noise.white
        step = state.evidence - white.evidence
        dense = dense_likelihood(state.fit) - state.fit.volume - (dense_likelihood(white.fit) - white.fit.volume)
        assert step == pytest.approx(dense - state.fit.noise.price, abs=0.5)
        models[options.prior.autocorrelated_noise] = state.fit.noise
    groups = sum(model.share > 0 for model in models[0.25].models)
    assert models[0.1].price - models[0.25].price == pytest.approx(groups * np.log(2.5))
    assert white.fit.noise.price == 0


def wandering(rng, samples):
    """Of unit variance, with a memory of 33 samples."""
    drawn = rng.normal(size=samples)
    for t in range(1, samples):
        drawn[t] = 0.97 * drawn[t - 1] + np.sqrt(1 - 0.97**2) * drawn[t]
    return drawn


def test_the_chance_of_a_name_is_right_in_noise_that_is_taken_for_white():
    """A regressor and noise that both wander, and have nothing to do with each other: evidence alone is often sure."""
    by_evidence = []
    by_blocks = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        problem = linear_problem(rng, 300, noise=(1.0, 1.0))
        data = dict(problem.data)
        data["u1"] = wandering(rng, 300)
        measured = problem.measured + np.outer(problem.shares, 1.5 * wandering(rng, 300))
        problem = replace(problem, data=data, measured=measured)
        state = state_of(problem, (Column("u1"),))
        by_evidence.append(np.exp(-max(state.tested[0].net, 0.0)))
        by_blocks.append(chance_of(Selector(problem, DEFAULTS), state, 0))
    assert np.mean(np.array(by_evidence) < 0.05) > 0.3
    assert np.mean(np.array(by_blocks) < 0.05) <= 0.15


def test_a_name_that_nearly_every_problem_has_is_one_of_all_that_were_tried():
    """Its prior is even odds, and yet as many names were tried as beside any other."""
    rng = np.random.default_rng(7)
    problem = linear_problem(rng, 300, noise=(1.0, 1.0))
    usual = Column("u1", usual=True)
    problem = replace(
        problem,
        measured=problem.measured + 0.25 * np.outer(problem.shares, problem.data["u1"]),
        candidates=(usual, *(Column(f"u{k}") for k in range(2, 7))),
    )
    state = state_of(problem, (usual,))
    selector = Selector(problem, DEFAULTS)
    score = selector.beside(state, 0).score([usual])[0]
    assert 0 < score.p_value < 0.05
    assert chance_of(selector, state, 0) == pytest.approx(len(selector.scan.names) * score.p_value)
    assert len(selector.scan.names) >= 6
