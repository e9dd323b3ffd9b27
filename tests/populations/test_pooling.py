"""Statistics over arms against dense regressions, and their distribution where there is nothing to find."""

import numpy as np
import pytest
from populations.linear_arms import CANDIDATES, OPTIONS, SAMPLES, arm, wave
from scipy.signal import lfilter
from scipy.stats import chi2, kstest

from lite6jax.populations.evidence import Scan
from lite6jax.populations.pooling import Overdispersion, p_value, pooled, statistics
from lite6jax.populations.reduced import PooledTerm, order_grid

NONE = Overdispersion({"mean": 1.0, "any": 1.0, "drift": 1.0}, {"mean": 1.0, "any": 1.0, "drift": 1.0})
BENT = PooledTerm("bent")


def arms_of(seed, count, effects=lambda i: (), **options):
    rng = np.random.default_rng(seed)
    return [arm(rng, effects(i), **options) for i in range(count)]


def explained(arms, columns):
    """The sum of squares that columns, one list an arm, explain together beside each arm's nuisance, and their rank."""
    A = np.concatenate([part - one.basis.T @ (one.basis @ part) for one, part in zip(arms, columns, strict=True)])
    y = np.concatenate([one.residual - one.basis.T @ (one.basis @ one.residual) for one in arms])
    fitted = A @ np.linalg.lstsq(A, y, rcond=None)[0]
    return float(fitted @ fitted)


def test_statistics_are_sums_of_squares_of_regressions():
    arms, x = arms_of(1, 5), np.array([-2.0, -1.0, 0.0, 1.5, 2.0])
    evidence = [one.evidence(BENT, OPTIONS) for one in arms]
    found = statistics(
        np.array([e.score for e in evidence]), np.array([e.information for e in evidence]), x, ("mean", "any", "drift")
    )
    own = [one.columns_of(BENT).T for one in arms]
    mean = explained(arms, own)
    assert found["mean"] == (pytest.approx(mean), 2)
    apart = [np.hstack([part if i == k else 0 * part for k in range(5)]) for i, part in enumerate(own)]
    assert found["any"] == (pytest.approx(explained(arms, apart)), 10)
    both = [np.hstack([part, x_ * part]) for part, x_ in zip(own, x, strict=True)]
    assert found["drift"] == (pytest.approx(explained(arms, both) - mean), 2)


def test_waves_are_pooled_as_any_other_candidate():
    arms, x = arms_of(2, 4), np.array([-1.0, 0.0, 0.5, 2.0])
    scans = []
    for one in arms:
        named, score, information = one.scores(OPTIONS)
        keys = [candidate.key for candidate in one.candidates]
        scans.append(Scan(dict(zip(keys, named, strict=True)), {"waves:joint3": (score[0], information[0])}))
    found = pooled(enumerate(scans), x)
    at = int(np.flatnonzero(order_grid(OPTIONS) == 30.0)[0])
    evidence = [one.evidence(PooledTerm("waves:joint3", 30.0), OPTIONS) for one in arms]
    expected = statistics(
        np.array([e.score for e in evidence]), np.array([e.information for e in evidence]), x, ("mean", "any", "drift")
    )
    for way, statistic in expected.items():
        values, freedom = found.waves["waves:joint3"][way]
        assert (values[at], freedom[at]) == (pytest.approx(statistic.value), statistic.freedom)
    assert set(found.named) == set(CANDIDATES) - {"waves:joint3"}
    assert "drift" not in pooled(enumerate(scans), None).named["soft"]


def test_overdispersion_is_that_of_noise_larger_than_its_model():
    rng = np.random.default_rng(3)
    arms = [arm(rng, noise=1.5 * rng.normal(size=SAMPLES)) for _ in range(20)]
    scans = []
    for one in arms:
        named, score, information = one.scores(OPTIONS)
        keys = [candidate.key for candidate in one.candidates]
        scans.append(Scan(dict(zip(keys, named, strict=True)), {"waves:joint3": (score[0], information[0])}))
    found = pooled(enumerate(scans), None).overdispersion
    assert found.waves["any"] == pytest.approx(2.25, rel=0.1)
    assert found.named["any"] == pytest.approx(2.25, rel=0.2)
    quiet = pooled(enumerate(scans[:1]), None).overdispersion
    assert min(quiet.named.values()) >= 1.0


@pytest.mark.parametrize("way", ["mean", "any", "drift"])
def test_p_values_without_an_effect_are_not_too_small(way):
    x, found = np.linspace(-1, 1, 6), []
    for seed in range(60):
        arms = arms_of(100 + seed, 6)
        evidence = [one.evidence(BENT, OPTIONS) for one in arms]
        found.append(p_value(BENT, evidence, x, way, NONE))
    assert kstest(found, "uniform", alternative="greater").pvalue > 1e-3
    assert np.mean(found) < 0.8  # and not all one


def test_noise_that_the_model_does_not_know_is_seen_by_the_blocks():
    """Columns and noise that both vary slowly: white tests would be certain."""
    rng, white, robust = np.random.default_rng(4), [], []
    for _ in range(20):
        evidence = []
        for _ in range(6):
            one = arm(rng, noise=lfilter([0.6], [1, -0.8], rng.normal(size=400)), samples=400)
            one.columns[one.parts["soft"]] = lfilter([0.2], [1, -0.97], rng.normal(size=(1, 400)))
            evidence.append(one.evidence(PooledTerm("soft"), OPTIONS))
        score, information = (np.array([getattr(e, name) for e in evidence]) for name in ("score", "information"))
        white.append(chi2.sf(statistics(score, information, np.zeros(6), ("mean",))["mean"].value, 1))
        robust.append(p_value(PooledTerm("soft"), evidence, np.zeros(6), "mean", NONE))
    assert np.mean(np.array(white) < 0.05) > 0.3
    assert np.mean(np.array(robust) < 0.05) < 0.3


def test_a_wave_of_any_phase_has_no_mean_and_is_in_any():
    rng = np.random.default_rng(5)
    arms = [arm(rng, [wave(41.0, 0.5, phase)]) for phase in rng.uniform(-np.pi, np.pi, 25)]
    term = PooledTerm("waves:joint3", 41.0)
    evidence = [one.evidence(term, OPTIONS) for one in arms]
    assert p_value(term, evidence, np.zeros(25), "any", NONE) < 1e-12
    assert p_value(term, evidence, np.zeros(25), "mean", NONE) > 1e-6
