"""The evidence of many arms against dense regressions, and its distribution where there is nothing to find."""

import numpy as np
import pytest
from fleet.linear_arms import OPTIONS, SAMPLES, arm, tried, wave
from scipy.signal import lfilter
from scipy.stats import kstest

from lite6jax.estimation.thresholds import CONFOUNDED
from lite6jax.fleet.pooling import screen, weigh
from lite6jax.fleet.reduced import order_grid
from lite6jax.fleet.terms import CUBICS, SPLINES, FleetProcess, PooledTerm

BENT = PooledTerm("bent")
LOADED = ("gravity torque of joint 1",), (-3.0, 3.0)


def arms_of(seed, count, effects=lambda i: (), **options):
    rng = np.random.default_rng(seed)
    return [arm(rng, effects(i), **options) for i in range(count)]


def process(kernel, drivers=LOADED[0], bounds=LOADED[1], site="joint1"):
    return FleetProcess(site, "rz", "rad", drivers, bounds, kernel)


def measured(arms, term):
    return [one.evidence(term) for one in arms]


def outside(one, rows):
    return rows - (rows @ one.basis.T) @ one.basis


def evidence_of(arms, columns, named):
    """At the likeliest of many prior variances, of columns `(reading, number)` of all arms together.

    Those of names are orthonormal.
    """
    y = np.concatenate([outside(one, one.residual[None])[0] for one in arms])
    freedom, left = sum(one.residual.size - len(one.basis) for one in arms), float(y @ y)
    if named:
        columns = np.linalg.svd(columns, full_matrices=False)[0]
    values, V = np.linalg.eigh(columns.T @ columns)
    pulls = (V.T @ (columns.T @ y)) ** 2
    gains = [0.0]
    for variance in np.geomspace(1e-4, 1e6, 400) / values.max():
        explained = np.sum(pulls * variance / (1 + variance * values))
        gains.append(-0.5 * freedom * np.log1p(-explained / left) - 0.5 * np.sum(np.log1p(variance * values)))
    return max(gains)


@pytest.mark.parametrize("term", [BENT, process("smooth"), process("line")], ids=["name", "smooth", "line"])
@pytest.mark.parametrize(
    ("sizes", "way"), [([0.3] * 5, "mean"), ([0.5, -0.6, 0.4, -0.5, 0.6], "any"), ([0.0, 0.0, 0.6, 0.0, 0.0], "one")]
)
def test_the_evidence_is_that_of_regressions_over_all_arms(term, sizes, way):
    numbers = np.array([0.3, -0.8]) if term != process("smooth") else 0.15 * np.cos(np.arange(11))
    arms = arms_of(1, 5, lambda i: [(term, sizes[i] * numbers)], samples=400)
    found = weigh(term, measured(arms, term), CONFOUNDED)
    own = [outside(one, one.columns_of(term)).T for one in arms]
    each = [evidence_of([one], part, term == BENT) for one, part in zip(arms, own, strict=True)]
    apart = [np.hstack([part if i == k else 0 * part for k in range(5)]) for i, part in enumerate(own)]
    whole = {
        "mean": evidence_of(arms, np.concatenate(own), term == BENT),
        "any": evidence_of(arms, np.concatenate(apart), term == BENT),
        "one": max(each) - np.log(5),
    }
    assert max(whole, key=lambda one: whole[one]) == way
    assert (found.way, found.gain) == (way, pytest.approx(whole[way] - np.log(3), rel=0.01))


def screened(arms):
    """What names and all that is screened say, and all that is tried."""
    all_tried = tried(arms)
    processes = *all_tried.singles, *all_tried.pairs
    return *screen([one.scan(processes, OPTIONS) for one in arms], CONFOUNDED), all_tried


def test_what_a_search_screens_is_what_is_measured():
    arms = arms_of(2, 4)
    named, groups, all_tried = screened(arms)
    assert set(named) == set(all_tried.named)
    np.testing.assert_allclose(named["bent"][2].score, arms[2].evidence(BENT).score)
    at, term = int(np.flatnonzero(order_grid(OPTIONS) == 30.0)[0]), PooledTerm("waves:joint3", 30.0)
    expected = weigh(term, measured(arms, term), CONFOUNDED).gain
    assert groups["waves:joint3"][at] - np.log(3) == pytest.approx(expected)
    assert (len(groups[SPLINES]), len(groups[CUBICS])) == (4, 0)  # each site has one quantity of its own


@pytest.mark.parametrize(("size", "way"), [(0.7, "mean"), (1.0, "any"), (1.2, "one")])
def test_the_likeliest_process_is_screened_first(size, way):
    rng, numbers = np.random.default_rng(6), np.cos(np.arange(11)) - (np.arange(11) == 0)
    factor = {"mean": lambda i: 1.0, "any": lambda i: rng.choice([-1, 1]), "one": lambda i: i == 2}[way]
    truth = process("smooth", site="joint3")
    arms = arms_of(2, 6, lambda i: [(truth, size * factor(i) * numbers)], samples=300)
    _, groups, all_tried = screened(arms)
    (at,) = (k for k, one in enumerate(all_tried.singles) if one.key == truth.key)
    kernels = all_tried.with_every_kernel(all_tried.singles[at])
    best = max((weigh(one, measured(arms, one), CONFOUNDED) for one in kernels), key=lambda one: one.gain)
    assert best.way == way
    assert 0.7 < groups[SPLINES][at] / best.gain < 2
    assert groups[SPLINES][at] == max(groups[SPLINES])


def test_noise_larger_than_its_model_is_no_evidence():
    rng = np.random.default_rng(3)
    named, groups, all_tried = screened([arm(rng, noise=3 * rng.normal(size=SAMPLES)) for _ in range(20)])
    assert np.max(groups["waves:joint3"] - all_tried.cost_of_waves(order_grid(OPTIONS))) < 3
    assert max(weigh(PooledTerm(key), each, CONFOUNDED).gain for key, each in named.items()) < 5


@pytest.mark.parametrize("term", [BENT, process("smooth")], ids=["name", "process"])
def test_evidence_without_an_effect_is_as_rare_as_it_says(term):
    found = []
    for seed in range(60):
        evidence = [one.evidence(term) for one in arms_of(100 + seed, 6)]
        found.append(weigh(term, evidence, CONFOUNDED).p_value)
    assert kstest(found, "uniform", alternative="greater").pvalue > 1e-3


def test_noise_that_the_model_does_not_know_is_seen_by_the_blocks():
    """Columns and noise that both vary slowly: evidence in white noise would be certain."""
    rng, white, robust = np.random.default_rng(4), [], []
    for _ in range(20):
        arms = []
        for _ in range(6):
            one = arm(rng, noise=lfilter([0.6], [1, -0.8], rng.normal(size=400)), samples=400)
            one.columns[one.parts["soft"]] = lfilter([0.2], [1, -0.97], rng.normal(size=(1, 400)))
            arms.append(one)
        evidence = [one.evidence(PooledTerm("soft")) for one in arms]
        found = weigh(PooledTerm("soft"), evidence, CONFOUNDED)
        robust.append(found.sure)
        white.append(found.net)
    assert np.mean(np.array(white) > 3) > 0.3
    assert np.mean(np.array(robust) > 3) < 0.1


def test_a_wave_of_any_phase_has_no_mean_and_is_in_any():
    rng = np.random.default_rng(5)
    arms = [arm(rng, [wave(41.0, 0.5, phase)]) for phase in rng.uniform(-np.pi, np.pi, 25)]
    term = PooledTerm("waves:joint3", 41.0)
    found = weigh(term, [one.evidence(term) for one in arms], CONFOUNDED)
    assert (found.way, found.gain > 30) == ("any", True)
