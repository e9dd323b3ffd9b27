"""Refits over many noises: unbiased, as scattered as they say, unmoved by wild rows, held by what is known before."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.recorded import OPTIONS, Made, fitted_to, static_motion, truth, with_effects
from engine.linear_problem import Column, linear_problem
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.stats import chi2, multivariate_t, norm

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.least_squares import fit, weighed
from lite6jax.estimation.noise import white_noise
from lite6jax.estimation.options import DEFAULTS, FitOptions
from lite6jax.estimation.projection import scaled_inverse, scaled_solve
from lite6jax.estimation.robust import FREEDOM
from lite6jax.estimation.terms import Terms

TEXTS = ("joint_compliance:joint=2,compliance_rad_per_Nm=9e-5", "joint_backlash:joint=4,gap_rad=8e-4")
PHYSICS = Terms(tuple(truth(text)[0] for text in TEXTS))
VALUES = np.array([9e-5, 8e-4])
SAMPLES = 160
PROBABLE = (1e-4, 1 - 1e-4)


@pytest.fixture(scope="module")
def still():
    return static_motion(5, SAMPLES)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The sensor stands somewhere unknown."""
    return Made(tmp_path_factory.mktemp("arm"), TEXTS, seed=1, frame=True)


@pytest.fixture(scope="module")
def poses(arm, still):
    return arm.poses(still)


def likely(sum_of_squares, count):
    low, high = chi2.ppf(PROBABLE, count)
    return low < sum_of_squares < high


def settled(case, terms=PHYSICS, **options):
    """A refit about the arm that a first one finds."""
    return fitted_to(case.relinearised(fitted_to(case, terms, **options).nuisance), terms, **options)


def test_values_scatter_as_their_covariance_says(arm, still, poses):
    distances, scales = [], []
    for seed in range(20):
        fitted = fitted_to(pose_problem(arm.recording(still, poses=poses, seed=seed)), PHYSICS)
        assert fitted.converged
        off = fitted.values - VALUES
        distances.append(off @ np.linalg.solve(fitted.covariance, off))
        scales.append(fitted.scale[0])
        # all numbers count, less what the priors say of these two
        precision = np.array([3 / number.upper**2 for term in PHYSICS.terms for number in term.coordinates])
        assert fitted.parameters == pytest.approx(8 - precision @ np.diagonal(fitted.covariance), abs=1e-6)
    assert likely(np.sum(distances), 40)
    assert max(distances) < chi2.ppf(1 - 1e-5, 2)
    assert np.mean(scales) == pytest.approx(1.0, abs=0.02)


def test_twice_the_noise_doubles_scale_and_deviations(arm, still, poses):
    quiet = fitted_to(pose_problem(arm.recording(still, poses=poses, seed=1)), PHYSICS)
    loud = fitted_to(pose_problem(arm.recording(still, poses=poses, seed=1, noise=(4e-5, 2e-4))), PHYSICS)
    assert loud.scale[0] / quiet.scale[0] == pytest.approx(2.0, rel=1e-2)
    ratio = np.sqrt(np.diagonal(loud.covariance) / np.diagonal(quiet.covariance))
    np.testing.assert_allclose(ratio, 2.0, rtol=1e-2)


def test_residuals_of_exactly_zero_leave_weights_that_columns_can_take():
    """Rounding decides whether noise-free poses leave 1e-16 m or nothing."""
    nothing = weighed(np.zeros((6, 30)), white_noise(np.array([0, 0, 0, 1, 1, 1])), np.ones(30, bool))
    columns = np.full((2, 180), 1e10) * np.sqrt(nothing.row_weight).ravel()
    assert np.isfinite(columns @ columns.T).all()


@pytest.mark.parametrize("size", [3e-4, 1e-3])
def test_a_function_nearly_confounded_with_the_sensor_frame_is_fitted_to_the_noise(arm, still, size):
    """Axes of a sensor that are skewed: six of the twelve numbers move its frame. Undamped steps led nowhere."""
    skewed = replace(arm, effects=(), orientation=False, geometry="prior", tool=True)
    poses = skewed.poses(still)
    poses[:, :3, 3] += size * poses[:, :3, 3] @ np.random.default_rng(9).uniform(-1, 1, (3, 3))
    recording = skewed.recording(still, poses=poses, seed=2)
    slopes = tuple(
        Unnamed("sensor", f"measured position {axis}", float(each.min()), float(each.max()), "line", component)
        for axis, each in zip("xyz", recording.position.T, strict=True)
        for component in "xyz"
    )
    case = pose_problem(recording)
    baseline = fitted_to(case)
    fitted = fitted_to(case, Terms(slopes), nuisance=baseline.nuisance)
    assert baseline.scale[0] > 3
    assert fitted.scale[0] < 1


def scale_among_wild_rows(share):
    """Where Student's likelihood puts the scale of unit noise when a share of the rows is infinitely far."""
    nu, rows, noise = FREEDOM, 6, chi2(6)

    def scale(share):
        def balance(s):
            weighed = quad(lambda x: noise.pdf(x) * x / (nu * s**2 + x), 0, np.inf)[0]
            return (nu + rows) * ((1 - share) * weighed + share) - rows

        return brentq(balance, 0.3, 3)

    return scale(share) / scale(0.0)


@pytest.mark.parametrize("seed", range(4))
def test_one_wild_row_in_twenty_moves_nothing(arm, still, poses, seed):
    rng = np.random.default_rng(seed)
    wild = rng.choice(SAMPLES, SAMPLES // 20, replace=False)
    recording = arm.recording(still, poses=poses, seed=seed)
    position = recording.position.copy()
    direction = rng.standard_normal((len(wild), 3))
    position[wild] += rng.uniform(1e-3, 3e-3, (len(wild), 1)) * direction / np.linalg.norm(direction, axis=1)[:, None]
    fitted = fitted_to(pose_problem(replace(recording, position=position)), PHYSICS)
    assert (np.abs(fitted.values - VALUES) < 4 * np.sqrt(np.diagonal(fitted.covariance))).all()
    assert (fitted.residuals.weight[0, wild] < 0.02).all()
    assert np.median(np.delete(fitted.residuals.weight[0], wild)) > 0.8
    assert set(np.flatnonzero(fitted.residuals.squares > 30 * 6)) == set(wild)
    assert fitted.scale[0] == pytest.approx(scale_among_wild_rows(len(wild) / SAMPLES), abs=0.04)


@pytest.mark.parametrize("seed", range(4))
def test_a_fit_of_few_steps_comes_near_its_end_in_heavy_tails(seed):
    rng = np.random.default_rng(seed)
    problem = linear_problem(rng, 400, noise=(1.0, 1.0))
    wild = rng.random(problem.measured.shape) < 0.4
    tails = 6.0 * np.abs(rng.standard_normal(wild.shape)) * np.sign(problem.data["u1"])
    problem = replace(problem, measured=problem.measured + np.where(wild, tails, 0.0))
    terms = Terms((Column("u1"), Column("u2")))
    rough = fit(problem, terms, DEFAULTS.rough)
    to_the_end = replace(DEFAULTS, fit=replace(DEFAULTS.fit, settled=1e-8, steps=200))
    final = fit(problem, terms, to_the_end)
    assert rough.converged
    std = np.sqrt(np.diagonal(final.covariance))
    np.testing.assert_allclose(rough.values / std, final.values / std, atol=0.003)


def test_rows_left_out_do_not_count(arm, still, poses):
    recording = arm.recording(still, poses=poses, seed=1)
    used = np.arange(SAMPLES) % 5 != 0
    position = recording.position.copy()
    position[~used] += 0.01
    spoilt = pose_problem(replace(recording, position=position))
    first, case = fitted_to(spoilt, PHYSICS, training=used), pose_problem(recording)
    start = replace(case, start=spoilt.start)
    np.testing.assert_allclose(first.values, fitted_to(start, PHYSICS, training=used).values, rtol=1e-9)
    assert (np.abs(first.values - VALUES) < 4 * np.sqrt(np.diagonal(first.covariance))).all()
    assert first.residuals.rows.shape == (6, SAMPLES)


def test_geometry_nobody_knows_is_fitted_along(arm, still):
    made = Made(arm.folder, TEXTS, seed=2, geometry="free", frame=True, tool=True)
    case = pose_problem(made.recording(still))
    fitted = settled(case)
    assert fitted.converged
    assert (np.abs(fitted.values - VALUES) < 4 * np.sqrt(np.diagonal(fitted.covariance))).all()
    # no poses determine more than thirty numbers of six axes, a sensor and a tool
    assert fitted.parameters == pytest.approx(30 + 2, abs=0.1)
    assert fitted.scale[0] == pytest.approx(1.0, abs=0.05)


def test_what_is_known_beforehand_holds_the_geometry(arm, still):
    made = Made(arm.folder, TEXTS, seed=2, geometry="prior", frame=True)
    recording = made.recording(still)
    case = pose_problem(recording)
    fitted = fitted_to(case, PHYSICS)
    known = case.precision > 0
    assert np.count_nonzero(known) == 30
    # the true arm is one standard deviation away in each number
    assert np.sum((fitted.nuisance[known] / 5e-5) ** 2) < chi2.ppf(1 - 1e-6, 30) * 2
    assert (np.abs(fitted.values - VALUES) < 4 * np.sqrt(np.diagonal(fitted.covariance))).all()
    held = replace(case, precision=np.where(known, 1e18, 0.0))
    tight = fitted_to(held, PHYSICS)
    assert np.abs(tight.nuisance[known]).max() < 1e-8
    assert tight.parameters == pytest.approx(8, abs=1e-2)
    assert 8.5 < fitted.parameters < 38
    # beginning elsewhere, the prior still pulls to what is known, not to the start
    away = np.where(known, 3e-5, 0.0)
    np.testing.assert_allclose(
        fitted_to(case.relinearised(away), PHYSICS).nuisance + away, fitted.nuisance, rtol=0, atol=2e-7
    )


def test_without_effects_or_nuisance_there_is_nothing_to_fit(arm, still):
    made = Made(arm.folder, seed=1, inertial=0.0)
    case = pose_problem(made.recording(still))
    fitted = fitted_to(case, Terms())
    assert (fitted.values.size, fitted.nuisance.size, fitted.parameters, fitted.converged) == (0, 0, 0.0, True)
    np.testing.assert_array_equal(fitted.residuals.rows, case.residual(np.zeros(0), Terms(), np.zeros(0)))


def test_the_likelihood_is_student_t_and_that_of_the_priors(arm, still, poses):
    case = pose_problem(arm.recording(still, poses=poses, seed=1))
    one, other = fitted_to(case, PHYSICS), fitted_to(case, Terms())
    numbers = [number for term in PHYSICS.terms for number in term.coordinates]
    for scale in (1.0, 1.7):
        t = multivariate_t(np.zeros(6), scale**2 * np.eye(6), df=FREEDOM)
        wanted = t.logpdf(one.residuals.rows.T).sum() - t.logpdf(other.residuals.rows.T).sum()
        for value, number in zip(one.values, numbers, strict=True):
            spread = np.sqrt(np.mean(np.linspace(number.lower, number.upper, 100_001) ** 2))
            wanted += norm.logpdf(value, scale=spread) - norm.logpdf(0, scale=spread)
        assert one.log_likelihood(np.array([scale])) - other.log_likelihood(np.array([scale])) == pytest.approx(
            wanted, rel=1e-9
        )
    t, wide = (multivariate_t(np.zeros(6), s**2 * np.eye(6), df=FREEDOM) for s in (1.0, 2.0))
    wanted = (t.logpdf(one.residuals.rows.T) - wide.logpdf(one.residuals.rows.T)).sum()
    assert one.log_likelihood(np.array([1.0])) - one.log_likelihood(np.array([2.0])) == pytest.approx(wanted, rel=1e-9)


def test_adding_what_is_there_and_what_is_not(arm, still, poses):
    """Twice the gain of likelihood by physics that is not there is a chi-square; by physics that is, hundreds."""
    idle, _ = truth("joint_compliance:joint=5,compliance_rad_per_Nm=1e-5")
    gains = []
    for seed in range(6):
        case = pose_problem(arm.recording(still, poses=poses, seed=seed))
        base, more = fitted_to(case, PHYSICS), fitted_to(case, Terms((*PHYSICS.terms, idle)))
        gains.append(2 * (more.log_likelihood(more.scale) - base.log_likelihood(more.scale)))
        without = fitted_to(case, Terms(PHYSICS.terms[:1]))
        assert base.log_likelihood(np.array([1.0])) - without.log_likelihood(np.array([1.0])) > 100
    assert min(gains) > -1e-3
    assert np.sum(gains) < 1.3 * chi2.ppf(1 - 1e-4, 6)  # Student's likelihood of normal noise is not exact


def test_an_effect_that_does_nothing_keeps_its_zero(arm, still, poses):
    """The last joint turns about the measured point: positions do not show it."""
    made = Made(arm.folder, seed=1, orientation=False)
    effect, _ = truth("joint_offset:joint=6,offset_rad=1e-3")
    fitted = fitted_to(pose_problem(made.recording(still)), Terms((effect,)))
    assert fitted.values == pytest.approx([0.0], abs=1e-9)


def test_effects_may_start_anywhere_near(arm, still, poses):
    case = pose_problem(with_effects(arm, *TEXTS).recording(still, poses=poses, seed=1))
    first = fitted_to(case, PHYSICS)
    second = fitted_to(case, PHYSICS, values=3 * VALUES)
    np.testing.assert_allclose(second.values, first.values, rtol=1e-3)


@pytest.mark.parametrize("numbers", [4, 80])
def test_numbers_without_information_are_zero_and_change_no_others(numbers):
    """Where no term is loaded, gravity's direction changes no reading: its rows of the normal matrix are zero."""
    J = np.random.default_rng(1).normal(size=(200, numbers))
    none = [0, numbers // 2]
    J[:, none] = 0.0
    size = np.geomspace(1e-3, 1e5, numbers)
    H = J.T @ J * np.outer(size, size)
    x, inverse = scaled_solve(H, J.T @ np.ones(200) * size), scaled_inverse(H)
    expected = np.linalg.pinv(J, rcond=1e-12)  # the default keeps what rounding leaves of the zeros
    np.testing.assert_allclose(x * size, expected @ np.ones(200), atol=1e-12)
    np.testing.assert_allclose(inverse * np.outer(size, size), expected @ expected.T, atol=1e-12)
    assert not x[none].any()
    assert not inverse[none].any()


def test_kept_derivatives_lead_to_the_same_fit(arm, still, poses, monkeypatch):
    case, taken = pose_problem(arm.recording(still, poses=poses, seed=3)), []
    columns = type(case).nuisance_columns
    monkeypatch.setattr(type(case), "nuisance_columns", lambda *given: taken.append(1) or columns(*given))
    fits = []
    for stale in (0.0, 0.1):
        taken.append(0)
        fits.append(fit(case, PHYSICS, replace(OPTIONS, fit=FitOptions(stale=stale, may_relinearise=False))))
    first = taken.index(0, 1)
    assert sum(taken[first:]) < sum(taken[:first])
    anew, kept = fits
    assert kept.converged
    std = np.sqrt(np.diagonal(anew.covariance))
    np.testing.assert_allclose(kept.values, anew.values, atol=0.01 * std.min())
