import numpy as np
import pytest

import lite6jax
from lite6jax.calibration.residual import padded_size
from tests.oracles.arms import lite6_positions, perturbed_parameters
from tests.oracles.chains import seed_poses
from tests.oracles.transforms import perturb_poses

NOISE = (2e-5, 1e-4)


def fleet(arms=11, samples=60, seed=0):
    rng = np.random.default_rng(seed)
    x = np.array([perturbed_parameters(rng) for _ in range(arms)])
    q = np.array([lite6_positions(rng, samples) for _ in range(arms)])
    T = np.array([perturb_poses(rng, seed_poses(xi, qi), *NOISE) for xi, qi in zip(x, q, strict=True)])
    return x, q, T


def test_parameters_stand_in_the_seeds_order_within_their_uncertainty():
    x, q, T = fleet()
    found = lite6jax.fit_fleet(q, T, nominal="lite6", noise=NOISE)
    assert found.parameters.shape == (11, 28)
    assert found.names[:4] == ("base_x", "base_y", "base_roll", "base_pitch")
    assert found.names[4:12] == ("theta_off1", "d1", "a1", "alpha1", "theta_off2", "a2", "alpha2", "theta_off3")
    assert found.names[-1] == "beta2"
    assert (found.result == lite6jax.Result.CONVERGED).all()
    z = (found.parameters - x) / found.standard_deviation
    assert abs(np.mean(z**2) - 1) < 4.4 * np.sqrt(2 / z.size)
    np.testing.assert_allclose(found.position_rms, NOISE[0] * np.sqrt(3), rtol=0.25)


def test_each_arm_is_as_if_fitted_alone():
    _, q, T = fleet()
    together = lite6jax.fit_fleet(q, T, nominal="lite6", noise=NOISE)
    for k in (0, 7, 10):
        alone = lite6jax.fit_fleet(q[k : k + 1], T[k : k + 1], nominal="lite6", noise=NOISE)
        np.testing.assert_allclose(alone.parameters[0], together.parameters[k], atol=1e-14)


def test_ragged_arms_by_zero_weight_and_by_missing_poses():
    _, q, T = fleet(4)
    weight = np.ones((4, 60))
    weight[1, 40:] = 0
    masked, T_wild = T.copy(), T.copy()
    masked[1, 40:] = np.nan
    T_wild[1, 40:] *= 17.0
    short = lite6jax.fit_fleet(q[1:2, :40], T[1:2, :40], nominal="lite6", noise=NOISE)
    for found in (
        lite6jax.fit_fleet(q, T_wild, nominal="lite6", noise=NOISE, weight=weight),
        lite6jax.fit_fleet(q, masked, nominal="lite6", noise=NOISE),
    ):
        np.testing.assert_allclose(found.parameters[1], short.parameters[0], atol=1e-13)
        np.testing.assert_allclose(found.covariance[1], short.covariance[0], rtol=1e-6, atol=1e-22)
        assert (found.result == lite6jax.Result.CONVERGED).all()


def test_a_fleet_never_throws_for_one_arm():
    x, q, T = fleet()
    T[3] = np.nan
    T[5, 4:] = np.nan
    T[8] = np.eye(4)  # an arm that stands still
    found = lite6jax.fit_fleet(q, T, nominal="lite6", noise=NOISE, max_steps=30)
    assert found.result[3] == lite6jax.Result.TOO_FEW_SAMPLES
    assert found.result[5] == lite6jax.Result.TOO_FEW_SAMPLES
    assert found.result[8] == lite6jax.Result.SINGULAR
    others = [0, 1, 2, 4, 6, 7, 9, 10]
    assert (found.result[others] == lite6jax.Result.CONVERGED).all()
    assert np.abs((found.parameters - x)[others] / found.standard_deviation[others]).max() < 5


def test_shared_joint_positions():
    rng = np.random.default_rng(4)
    q = lite6_positions(rng, 60)
    x = np.array([perturbed_parameters(rng) for _ in range(8)])
    T = np.array([seed_poses(xi, q) for xi in x])
    shared = lite6jax.fit_fleet(q, T, nominal="lite6")
    own = lite6jax.fit_fleet(np.repeat(q[None], 8, 0), T, nominal="lite6")
    np.testing.assert_allclose(shared.parameters, x, atol=1e-13)
    np.testing.assert_allclose(shared.parameters, own.parameters, atol=1e-14)


def test_without_noise_the_covariance_comes_from_the_residuals():
    x, q, T = fleet(8, seed=5)
    found = lite6jax.fit_fleet(q, T, nominal="lite6")
    z = (found.parameters - x) / found.standard_deviation
    # a radian weighs like 0.1 m and the noises stand 0.2 m to a radian, so the stated spread is only about right
    assert 0.4 < np.mean(z**2) < 2.5


@pytest.mark.long
def test_calibrations_many_and_seven_joints():
    rng = np.random.default_rng(6)
    for name in ("lite6", "ur10e", "xarm7"):
        arm = lite6jax.read_arm(name)
        tolerance = np.array([8e-4] * 3 + [np.deg2rad(0.15)] * 3)
        factory = arm.kinematics + tolerance * rng.normal(size=(5, arm.dof, 6))
        found = lite6jax.fit_fleet_calibrations(factory, nominal=name)
        assert (found.result == lite6jax.Result.CONVERGED).all()
        expected = lite6jax.six_parameter_to_hayati(arm.form, factory, arm.hayati)
        np.testing.assert_allclose(found.parameters, expected, atol=2e-12)


def test_a_calibration_that_is_not_finite_is_said_to_be_so():
    arm = lite6jax.read_arm("lite6")
    factory = np.repeat(arm.kinematics[None], 3, 0)
    factory[1, 2, 3] = np.nan
    found = lite6jax.fit_fleet_calibrations(factory, nominal=arm)
    assert [lite6jax.Result(code).name for code in found.result] == ["CONVERGED", "NOT_FINITE", "CONVERGED"]


@pytest.mark.long
def test_more_samples_than_a_block_give_the_same_answer():
    _, q, T = fleet(1, 2500, seed=7)
    blocks = lite6jax.fit_fleet(q, T, nominal="lite6", noise=NOISE)
    halves = lite6jax.fit_fleet(q[:, :1250], T[:, :1250], nominal="lite6", noise=NOISE)
    assert padded_size(2500)[0] > padded_size(2500)[1]
    # twice the samples, half the variance; and both are the same arm
    ratio = halves.standard_deviation / blocks.standard_deviation
    assert np.abs(np.mean(ratio) - np.sqrt(2)) < 0.1
    assert np.abs((blocks.parameters - halves.parameters) / halves.standard_deviation).max() < 5


@pytest.mark.parametrize("samples", [1, 2, 5, 17, 300, 2399, 2400, 2401, 10**6])
def test_padding_is_small_and_whole_blocks(samples):
    size, block = padded_size(samples)
    assert size >= samples
    assert size % block == 0
    assert size - samples <= max(3, samples // 16, block - 1 if samples > 2400 else 0)


def test_messages():
    _, q, T = fleet(2, 40)
    for positions, poses, options, message in [
        (q, T[0], {}, r"T_base_flange of shape .*: give \(arm, sample, 4, 4\)"),
        (
            q,
            T,
            {"nominal": "xarm7"},
            r"joint_position of shape \(2, 40, 6\): xarm7 with these poses takes \(2, 40, 7\)",
        ),
        (q, T, {"noise": (0.0, 1e-4)}, r"two positive standard deviations"),
        (q, T, {"weight": np.ones((2, 39))}, r"weight of shape \(2, 39\): give \(2, 40\)"),
        (q, T, {"weight": -np.ones((2, 40))}, "not negative"),
        (q[:0], T[:0], {}, "at least one arm"),
        (q, T, {"nominal": "lite7"}, "lite7"),
    ]:
        with pytest.raises(lite6jax.InputError, match=message):
            lite6jax.fit_fleet(positions, poses, **{"nominal": "lite6", **options})
    with pytest.raises(lite6jax.InputError, match=r"factory of shape \(6, 6\): lite6 takes \(arm, 6, 6\)"):
        lite6jax.fit_fleet_calibrations(np.zeros((6, 6)), nominal="lite6")
