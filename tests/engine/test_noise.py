"""How noise remembers: what is found of it, and that the filter makes it white."""

import numpy as np
import pytest
from diagnosis.recorded import NOISE, OPTIONS, Made, fitted_to, found, moving_motion, searched, static_motion
from scipy.linalg import toeplitz
from scipy.stats import chi2

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.estimation.least_squares import weighed
from lite6jax.estimation.noise import (
    UNCORRELATED,
    Autocorrelation,
    NoiseModel,
    autocorrelation,
    autocorrelation_time,
    noise_model,
    run_starts,
)
from lite6jax.estimation.score_test import remaining_noise_model


def noise(rng, memory, slow, rows, samples):
    """A slow part and a white one, together of unit variance."""
    drawn = rng.normal(size=(rows, samples))
    for t in range(1, samples):
        drawn[:, t] = memory * drawn[:, t - 1] + np.sqrt(1 - memory**2) * drawn[:, t]
    return np.sqrt(slow) * drawn + np.sqrt(1 - slow) * rng.normal(size=(rows, samples))


def covariance(memory, slow, samples):
    return slow * toeplitz(memory ** np.arange(samples)) + (1 - slow) * np.eye(samples)


@pytest.mark.parametrize(("memory", "slow"), [(0.9, 1.0), (0.9, 0.5), (0.5, 0.8), (0.98, 0.3)])
def test_the_filter_is_the_inverse_root_of_the_covariance(memory, slow):
    n = 300
    C = covariance(memory, slow, n)
    F = Autocorrelation(memory, slow).whitened(np.eye(n), (0,)).T  # the filter as a matrix
    white = F @ C @ F.T * 1.0
    late = slice(n // 2, None)  # a mixture's filter settles after some samples
    scale = white[-1, -1]
    np.testing.assert_allclose(white[late, late], scale * np.eye(n - n // 2), atol=2e-3)
    assert scale == pytest.approx(1.0, abs=1e-3)


def test_the_volume_is_the_determinant_of_the_filter():
    model, starts = Autocorrelation(0.8, 0.6), (0, 30, 75)
    F = model.whitened(np.eye(100), starts).T
    assert model.log_volume(100, len(starts)) == pytest.approx(np.linalg.slogdet(F)[1], rel=1e-12)


def test_the_volume_is_that_of_the_samples_that_are_used():
    """A gap is no run of its own: the likelihood of a fit with it is that of the other samples alone."""
    used, of_rows = np.ones(100, bool), np.zeros(2, int)
    used[30:60] = False
    with_gap = NoiseModel((Autocorrelation(0.8, 0.6),), of_rows, (0, 30, 60, 75))
    alone = NoiseModel((Autocorrelation(0.8, 0.6),), of_rows, (0, 30, 45))
    assert with_gap.log_volume(used) == pytest.approx(alone.log_volume(np.ones(70, bool)), rel=1e-12)


def test_the_noise_of_all_samples_follows_from_that_of_every_fifth():
    memory, slow, every = 0.95, 0.7, 5
    few = NoiseModel((Autocorrelation(memory**every, slow),), np.array([0]))
    run = np.zeros(600, int)
    model = few.between(every, run)
    rows = noise(np.random.default_rng(4), memory, slow, 1, 600)
    white = NoiseModel((Autocorrelation(memory, slow),), np.array([0]))
    np.testing.assert_allclose(model.whitened(rows), white.whitened(rows), rtol=0, atol=1e-9)
    assert NoiseModel((UNCORRELATED,), np.array([0])).between(every, run).white


def test_a_stretch_remembers_nothing_of_the_one_before():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(3, 90))
    other = rows.copy()
    other[:, :40] += 1.0
    starts = run_starts(np.repeat([0, 4, 2], [40, 30, 20]))
    model = NoiseModel((Autocorrelation(0.9, 0.7),), np.zeros(3, int), starts)
    np.testing.assert_array_equal(model.whitened(rows)[:, 40:], model.whitened(other)[:, 40:])
    assert starts == (0, 40, 70)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize(("memory", "slow"), [(0.9, 1.0), (0.97, 0.5), (0.6, 0.9)])
def test_colour_is_found_although_a_fit_has_taken_part_of_it(memory, slow, smooth):
    """34 numbers of 400 rows: the residual's own autocorrelation is far too short."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(34, 3, 400))
    if smooth:
        columns = np.cumsum(columns, -1) / 10
    y = noise(rng, memory, slow, 3, 400)
    X = columns.reshape(34, -1)
    left = (y.ravel() - np.linalg.lstsq(X.T, y.ravel(), rcond=None)[0] @ X).reshape(3, -1)
    (found,) = noise_model(left, columns, np.zeros(34), np.zeros(3, int), np.zeros(400, int), OPTIONS).models
    assert found.coefficient == pytest.approx(memory, abs=0.1 if slow > 0.5 else 0.03)
    assert found.share == pytest.approx(slow, abs=0.2)


def test_what_is_known_beforehand_is_no_memory():
    """Numbers that their prior knows better than the rows do: they weigh the same whatever the noise is taken for."""
    rng = np.random.default_rng(4)
    columns = 0.1 * np.cumsum(rng.normal(size=(60, 1, 600)), -1)
    prior = np.full(60, 300.0)
    y = noise(rng, 0.5, 0.8, 1, 600) + np.tensordot(rng.normal(size=60) / prior, columns, 1)
    (found,) = noise_model(y, columns, prior, np.zeros(1, int), np.zeros(600, int), OPTIONS).models
    assert found.coefficient == pytest.approx(0.5, abs=0.1)
    assert found.share == pytest.approx(0.8, abs=0.2)


def test_white_noise_is_white():
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(34, 3, 400))
    one_run, group = np.zeros(400, int), np.zeros(3, int)
    models = [
        noise_model(noise(rng, 0.0, 0.0, 3, 400), columns, np.zeros(34), group, one_run, OPTIONS) for _ in range(20)
    ]
    assert all(model.white for model in models)
    rows = rng.normal(size=(2, 5))
    assert UNCORRELATED.whitened(rows, (0,)) is rows


def test_what_is_autocorrelated_comes_on_top_of_the_declared_noise():
    """White noise of the standard deviation 1 under a slow part of 3; read-outs of 0.4 that are declared to be of 1."""
    rng = np.random.default_rng(6)
    nothing = np.zeros((0, 1, 1500)), np.zeros(0)
    alone = np.zeros(1, int), np.zeros(1500, int), OPTIONS
    slow = np.sqrt(10) * noise(rng, 0.97, 0.9, 1, 1500)
    (free,) = noise_model(slow, *nothing, *alone).models
    (limited,) = noise_model(slow, *nothing, *alone, declared=np.ones(1)).models
    assert (limited.coefficient, limited.share) == (free.coefficient, free.share)
    assert free.share == pytest.approx(0.9, abs=0.05)

    fine = 0.4 * noise(rng, 0.9, 0.4, 1, 1500)
    assert noise_model(fine, *nothing, *alone).models[0].share > 0
    assert noise_model(fine, *nothing, *alone, declared=np.ones(1)).white


def test_a_scale_is_no_less_than_the_declared_noise_over_the_white_share():
    rng = np.random.default_rng(7)
    rows = 0.2 * rng.normal(size=(2, 400))
    groups = np.array([0, 1])
    models = NoiseModel((UNCORRELATED, Autocorrelation(0.9, 0.75)), groups)
    used = np.ones(400, bool)
    np.testing.assert_allclose(weighed(rows, models, used, 1.0).scale, [1.0, 2.0])
    assert (weighed(rows, models, used).scale < 0.3).all()


@pytest.mark.parametrize("samples", [8, 15, 19, 30])
def test_noise_of_few_samples_has_a_model(samples):
    ramp = np.tile(np.linspace(-3, 3, samples), (3, 1))
    nothing = np.zeros((0, 3, samples)), np.zeros(0)
    model = noise_model(ramp, *nothing, np.zeros(3, int), np.zeros(samples, int), OPTIONS)
    assert model.models[0].share > 0 or samples < 15


def test_autocorrelation_and_length_are_those_of_the_noise():
    rng = np.random.default_rng(2)
    rows = noise(rng, 0.9, 1.0, 3, 20000)
    np.testing.assert_allclose(autocorrelation(rows, 5), 0.9 ** np.arange(6), atol=0.02)
    assert autocorrelation_time(rows) == pytest.approx(1.9 / 0.1, rel=0.15)
    assert Autocorrelation(0.9, 1.0).time == pytest.approx(1.9 / 0.1)


def recorded(made, motion, seed):
    """Positions whose noise has a memory of 0.9; as large as declared."""
    poses = made.poses(motion)
    poses[:, :3, 3] += NOISE[0] * noise(np.random.default_rng(900 + seed), 0.9, 1.0, 3, len(poses)).T
    return made.recording(motion, noise=None, poses=poses)


def test_held_out_rows_are_not_remembered(tmp_path):
    case = pose_problem(recorded(Made(tmp_path, orientation=False), static_motion(4), 4))
    used = np.arange(case.samples) >= 60
    model = remaining_noise_model(case, fitted_to(case, training=used), OPTIONS)
    assert model.models[0].coefficient > 0.5
    assert 60 in model.starts


@pytest.mark.long
def test_an_effect_under_noise_that_remembers_is_as_sure_as_it_is_said_to_be(tmp_path):
    """Over some recordings the errors are what the standard deviations say; white noise's would be a third of them."""
    motion, off = moving_motion(1), []
    for seed in range(4):
        made = Made(tmp_path, ("joint_compliance:joint=2,compliance_rad_per_Nm=2e-5",), 1, orientation=False)
        selection = searched(pose_problem(recorded(made, motion, seed)))
        assert found(selection) == [("joint_compliance", "joint2")]
        assert not selection.state.fit.noise.white
        off.append((selection.state.fit.values[0] - 2e-5) / np.sqrt(selection.state.fit.covariance[0, 0]))

    assert chi2.ppf(0.005, len(off)) < np.sum(np.square(off)) < chi2.ppf(0.995, len(off))
    white = fitted_to(selection.problem, selection.state.fit.terms)
    assert selection.state.fit.covariance[0, 0] > 4 * white.covariance[0, 0]


@pytest.mark.long
def test_nothing_is_found_in_noise_that_remembers(tmp_path):
    for seed in range(2):
        for motion in (static_motion(seed), moving_motion(seed)):
            selection = searched(
                pose_problem(recorded(Made(tmp_path, seed=seed, geometry="prior", orientation=False), motion, seed))
            )
            assert not selection.state.tested
            assert selection.nearest is not None
            assert selection.nearest[1] > 0.003
