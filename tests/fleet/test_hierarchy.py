"""The hierarchical model against dense normal distributions, and against closed forms of balanced arms."""

import numpy as np
import pytest
from scipy.stats import kstest, multivariate_normal, t

from lite6jax.fleet.hierarchy import ArmLikelihoods, fitted

TYPICAL = np.array([1e-5, 2e-3])


def drawn(seed, arms=7, spread=2.0):
    """Measured numbers `(arm, number)` with covariances, and the likelihoods."""
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(arms, 2, 2)) + 2 * np.eye(2)
    covariance = (roots @ roots.swapaxes(1, 2)) * np.outer(TYPICAL, TYPICAL)
    mean = np.array([3.0, -1.0]) * TYPICAL
    truth = mean + spread * TYPICAL * rng.normal(size=(arms, 2))
    y = np.array([rng.multivariate_normal(m, C) for m, C in zip(truth, covariance, strict=True)])
    information = np.linalg.inv(covariance)
    return y, covariance, ArmLikelihoods(np.einsum("aij,aj->ai", information, y), information, TYPICAL)


def dense(y, covariance, tau):
    """Design, covariance and numbers of all arms in one vector."""
    V = np.zeros((y.size, y.size))
    for a, C in enumerate(covariance):
        V[2 * a : 2 * a + 2, 2 * a : 2 * a + 2] = C + tau**2 * np.diag(TYPICAL**2)
    return np.tile(np.eye(2), (len(y), 1)), V, y.ravel()


@pytest.mark.parametrize("tau", [0.0, 0.7, 5.0])
def test_mean_and_likelihood_are_those_of_generalised_least_squares(tau):
    y, covariance, arms = drawn(1)
    X, V, numbers = dense(y, covariance, tau)
    M = X.T @ np.linalg.solve(V, X)
    expected = np.linalg.solve(M, X.T @ np.linalg.solve(V, numbers))
    mean, _, likely, restricted = arms.solved(tau)
    np.testing.assert_allclose(mean * TYPICAL, expected, rtol=1e-8)
    nothing = dense(y, covariance, 0.0)[1]
    gain = multivariate_normal.logpdf(numbers, X @ expected, V) - multivariate_normal.logpdf(numbers, None, nothing)
    assert likely == pytest.approx(gain, rel=1e-8)
    in_typical = np.linalg.slogdet(M * np.outer(TYPICAL, TYPICAL))[1]
    assert restricted == pytest.approx(gain - 0.5 * in_typical, rel=1e-8)


def test_the_spread_maximises_the_restricted_likelihood_and_is_its_closed_form_for_like_arms():
    rng = np.random.default_rng(2)
    y = 3.0 + 2.0 * rng.normal(size=12)
    found = fitted(ArmLikelihoods(y[:, None] / 0.5, np.full((12, 1, 1), 1 / 0.5), np.ones(1)))
    assert found.between[0] == pytest.approx(np.sqrt(np.var(y, ddof=1) - 0.5), rel=1e-5)
    half = t.ppf(0.975, 11) * np.std(y, ddof=1) / np.sqrt(12)
    assert found.half_width[0] == pytest.approx(half, rel=1e-5)
    assert found.mean[0] == pytest.approx(y.mean())


def test_arms_that_are_alike_have_no_spread():
    y = np.linspace(-0.1, 0.1, 9)
    found = fitted(ArmLikelihoods(y[:, None], np.ones((9, 1, 1)), np.ones(1)))
    assert found.tau == 0.0
    assert found.std[0] == pytest.approx(1 / 3)
    values, covariances = found.shrunken()
    np.testing.assert_allclose(values, 0.0, atol=1e-12)
    np.testing.assert_allclose(covariances, 1 / 9)


def test_estimates_of_arms_are_best_linear_predictions():
    y, covariance, arms = drawn(3)
    found = fitted(arms)
    X, V, numbers = dense(y, covariance, found.tau)
    prior = found.tau**2 * np.diag(np.tile(TYPICAL**2, len(y)))
    mean = X @ found.mean
    expected = (mean + prior @ np.linalg.solve(V, numbers - mean)).reshape(-1, 2)
    values, covariances = found.shrunken()
    np.testing.assert_allclose(values, expected, rtol=1e-6)
    gain = prior @ np.linalg.inv(V)
    of_mean = (np.eye(len(V)) - gain) @ X @ found.covariance @ X.T @ (np.eye(len(V)) - gain).T
    whole = prior - gain @ prior + of_mean
    for a in range(len(y)):
        at = slice(2 * a, 2 * a + 2)
        np.testing.assert_allclose(covariances[a], whole[at, at], rtol=1e-5)


def test_an_arm_that_does_not_show_the_effect_gets_the_mean():
    _, _, arms = drawn(4)
    score, information = arms.score.copy(), arms.information.copy()
    score[2], information[2] = 0.0, 0.0
    found = fitted(ArmLikelihoods(score, information, TYPICAL))
    rest = fitted(arms.without(2))
    np.testing.assert_allclose(found.mean, rest.mean, rtol=1e-6)
    np.testing.assert_allclose(found.shrunken()[0][2], rest.mean, rtol=1e-6)
    assert found.outlier_p_value(2) == 1.0


def test_nothing_is_fitted_to_too_few_arms():
    _, _, arms = drawn(5, arms=2)
    assert fitted(arms) is not None
    assert fitted(arms.without(0)) is None


@pytest.mark.long
@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_p_values_of_usual_arms_are_not_too_small_and_intervals_hold_the_mean(spread):
    rng, p_values, held = np.random.default_rng(6), [], []
    for _ in range(150):
        variance = rng.uniform(0.5, 2.0, 12)
        y = 1.0 + spread * rng.normal(size=12) + np.sqrt(variance) * rng.normal(size=12)
        arms = ArmLikelihoods((y / variance)[:, None], 1 / variance[:, None, None], np.ones(1))
        found = fitted(arms)
        p_values.append(found.outlier_p_value(0))
        held.append(abs(found.mean[0] - 1.0) < found.half_width[0])
    assert kstest(p_values, "uniform", alternative="greater").pvalue > 1e-3
    assert np.mean(held) > 0.9


def test_an_odd_arm_has_a_small_p_value_and_no_other_arm_has():
    rng = np.random.default_rng(7)
    y = 5.0 + rng.normal(size=20)
    y[3] += 12.0
    found = fitted(ArmLikelihoods(y[:, None], np.ones((20, 1, 1)), np.ones(1)))
    p_values = [found.outlier_p_value(a) for a in range(20)]
    assert int(np.argmin(p_values)) == 3
    others = np.delete(y, 3)
    spread = np.std(others, ddof=1) if np.var(others, ddof=1) > 1 else 1.0
    distance = (y[3] - others.mean()) / (spread * np.sqrt(1 + 1 / 19))
    assert p_values[3] == pytest.approx(2 * t.sf(distance, 18), rel=1e-3)
    assert min(np.delete(p_values, 3)) > 0.01
