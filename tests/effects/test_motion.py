"""Motions: what they are made of, the same motion at another instant, and what they refuse."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typed import refusal

from lite6jax.effects.motion import accelerated, beyond, motion_of, select, shifted, since_reversal
from tests.oracles.effects import later, random_motion

shift = jax.jit(shifted)
outside = jax.jit(beyond)


def simulated(seed=0, samples=(9, 5, 14)):
    return random_motion(np.random.default_rng(seed), 3, samples)


@pytest.mark.parametrize("offset", [0.0, 0.011, -0.017, 0.2, -0.33])
def test_a_later_motion_is_scipys_hermite_spline_within_each_run(offset):
    arrays = simulated()
    motion, expected = motion_of(**arrays), later(arrays, offset)
    found, inside = shift(motion, offset), ~np.asarray(outside(motion, offset))
    assert inside.mean() > 0.3
    for name, array in zip(
        ("joint_position", "joint_velocity", "direction", "payload"),
        (found.joint_position.T, found.joint_velocity.T, found.direction.T, found.payload),
        strict=True,
    ):
        np.testing.assert_allclose(array[inside], expected[name][inside], rtol=0, atol=1e-12)
    warmth = expected["joint_temperature"].mean(axis=1) - 25
    np.testing.assert_allclose(found.temperature_rise[inside], warmth[inside], rtol=0, atol=1e-12)
    each = expected["joint_temperature"].T - 25
    np.testing.assert_allclose(found.joint_temperature_rise[:, inside], each[:, inside], rtol=0, atol=1e-12)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))


def test_no_offset_is_exactly_the_same_motion():
    motion = motion_of(**simulated(1, (4, 1, 3)))
    for before, after in zip(jax.tree.leaves(motion), jax.tree.leaves(shift(motion, 0.0)), strict=True):
        np.testing.assert_array_equal(before, after)
    assert not outside(motion, 0.0).any()


def test_interpolation_of_a_smooth_motion_is_of_fourth_order():
    errors = []
    for step in (0.04, 0.02, 0.01):
        t = np.arange(0, 4, step)
        motion = motion_of(np.sin(t)[:, None], joint_velocity=np.cos(t)[:, None], time=t)
        found = shift(motion, 0.5 * step).joint_position[0]
        errors.append(np.abs(found - np.sin(t + 0.5 * step))[:-1].max())
    assert errors[-1] < 1e-10
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 16, rtol=0.02)


def test_rows_more_than_a_step_beyond_their_run_are_told():
    time = np.array([0.0, 1.0, 2.0, 2.5, 0.0, 1.0])
    run = np.array([0, 0, 0, 0, 1, 1])
    motion = motion_of(np.zeros((6, 2)), joint_velocity=np.zeros((6, 2)), time=time, run=run)
    for offset, rows in [
        (0.5, [0, 0, 0, 0, 0, 0]),
        (0.6, [0, 0, 0, 1, 0, 0]),
        (1.0, [0, 0, 0, 1, 0, 0]),
        (1.1, [0, 0, 1, 1, 0, 1]),
        (-1.0, [0, 0, 0, 0, 0, 0]),
        (-1.1, [1, 0, 0, 0, 1, 0]),
        (9.0, [1, 1, 1, 1, 1, 1]),
    ]:
        np.testing.assert_array_equal(outside(motion, offset), np.array(rows, bool), err_msg=str(offset))


def test_beyond_the_ends_the_motion_goes_on_for_a_step_and_stands():
    t = np.arange(5.0)
    motion = motion_of((t**2)[:, None], joint_velocity=2 * t[:, None], time=t)
    np.testing.assert_allclose(shift(motion, 1.0).joint_position[0], (t + 1) ** 2, atol=1e-12)
    np.testing.assert_allclose(shift(motion, -1.0).joint_position[0], (t - 1) ** 2, atol=1e-12)
    np.testing.assert_allclose(shift(motion, 7.0).joint_position[0], 25.0)


def test_the_derivative_by_the_offset_is_the_velocity():
    motion = motion_of(**simulated(2))
    _, slope = jax.jvp(lambda s: shifted(motion, s).joint_position, (0.0,), (1.0,))
    np.testing.assert_allclose(slope, motion.joint_velocity, rtol=0, atol=1e-12)


def test_samples_of_one_instant_and_runs_of_one_sample_give_finite_numbers():
    time = np.array([0.0, 1.0, 1.0, 2.0, 5.0, 7.0, 7.0])
    run = np.array([0, 0, 0, 0, 1, 2, 2])
    q = np.arange(14.0).reshape(7, 2)
    motion = motion_of(q, joint_velocity=q, time=time, run=run, payload=np.ones(7))
    for offset in (-3.0, 0.0, 0.4, 10.0):
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(shift(motion, offset)))
    assert outside(motion, 0.1)[4]


def test_the_temperature_is_the_mean_of_the_joints_else_the_ambient_above_the_reference():
    q = np.zeros((2, 3))
    joints, ambient = [[20.0, 30.0, 40.0], [21.0, 31.0, 41.0]], [50.0, 60.0]
    found = motion_of(q, joint_temperature=joints, ambient_temperature=ambient, reference_temperature=20.0)
    np.testing.assert_allclose(found.temperature_rise, [10.0, 11.0])
    found = motion_of(q, ambient_temperature=ambient)
    np.testing.assert_allclose(found.temperature_rise, [25.0, 35.0])
    np.testing.assert_allclose(found.joint_temperature_rise, [[25.0, 35.0]] * 3)
    found = motion_of(q, joint_temperature=joints, ambient_temperature=ambient)
    np.testing.assert_allclose(found.joint_temperature_rise, np.transpose(joints) - 25)
    assert motion_of(q).temperature_rise is motion_of(q).joint_temperature_rise is None


def test_what_the_sensor_shows_stays_at_its_stamps_and_may_be_missing():
    arrays = simulated()
    shown = np.random.default_rng(0).uniform(-1, 1, (28, 3))
    shown[4] = np.nan
    motion = motion_of(**arrays, measured_position=shown)
    np.testing.assert_array_equal(motion.measured_position, shown.T)
    np.testing.assert_array_equal(shift(motion, 0.02).measured_position, shown.T)
    np.testing.assert_array_equal(select(motion, [5, 2]).measured_position, shown[[5, 2]].T)


def test_what_is_not_given_is_not_there_and_the_payload_is_nothing():
    motion = motion_of(np.arange(6.0).reshape(3, 2))
    assert (motion.dof, motion.samples) == (2, 3)
    assert motion.joint_velocity is motion.direction is motion.time is motion.temperature_rise is None
    np.testing.assert_array_equal(motion.payload, 0)
    np.testing.assert_array_equal(motion.joint_position, [[0, 2, 4], [1, 3, 5]])
    np.testing.assert_array_equal(motion.run, [[0, 0, 0], [2, 2, 2]])


def test_a_run_may_have_the_number_of_an_earlier_one():
    motion = motion_of(np.zeros((5, 1)), run=[1, 1, 0, 1, 1])
    np.testing.assert_array_equal(motion.run, [[0, 0, 2, 3, 3], [1, 1, 2, 4, 4]])


def test_chosen_rows_keep_what_they_know():
    motion = motion_of(**simulated(3))
    chosen = select(motion, [4, 0])
    np.testing.assert_array_equal(chosen.direction, motion.direction[:, np.array([4, 0])])
    np.testing.assert_array_equal(chosen.joint_temperature_rise, motion.joint_temperature_rise[:, np.array([4, 0])])
    np.testing.assert_array_equal(chosen.run, [[0, 1], [0, 1]])
    np.testing.assert_array_equal(select(motion, np.arange(28) < 3).payload, motion.payload[:3])


Q = np.zeros((3, 2))


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        (
            {"joint_position": np.zeros(3)},
            "joint_position has the shape (3,); give (sample, joint), neither of them zero",
        ),
        (
            {"joint_position": np.zeros((0, 2))},
            "joint_position has the shape (0, 2); give (sample, joint), neither of them zero",
        ),
        ({"joint_position": Q, "time": [0, 1]}, "time has the shape (2,); give (3,)"),
        ({"joint_position": Q, "joint_velocity": Q[:, :1]}, "joint_velocity has the shape (3, 1); give (3, 2)"),
        ({"joint_position": Q, "run": [0, 1]}, "run has the shape (2,); give (3,)"),
        (
            {"joint_position": Q, "payload": [0, np.nan, 0]},
            "payload is not finite in row 2; drop such rows first",
        ),
        (
            {"joint_position": np.full((3, 2), np.inf)},
            "joint_position is not finite in row 1; drop such rows first",
        ),
        ({"joint_position": Q, "time": [0, 2, 1]}, "time goes back at row 3; sort the rows by time within each run"),
    ],
)
def test_motion_refuses(arrays, message):
    assert refusal(motion_of, **arrays) == f"motion: {message}"


def test_time_may_start_again_in_another_run():
    motion_of(Q, time=[0, 1, 0], run=[0, 0, 1])


def test_gradients_pass_backwards_through_a_later_motion():
    motion = motion_of(**simulated(4))
    weight = jnp.asarray(np.random.default_rng(0).standard_normal(motion.joint_position.shape))
    cost = jax.jit(lambda s: jnp.sum(weight * shifted(motion, s).joint_position))
    backward = jax.grad(cost)(0.013)
    _, forward = jax.jvp(cost, (0.013,), (1.0,))
    np.testing.assert_allclose(backward, forward, rtol=1e-12)


def test_accelerations_are_the_slopes_of_the_velocity_within_each_run():
    time = np.array([0.0, 0.1, 0.25, 0.3, 0.5, 7.0, 7.2, 9.0])
    run = np.array([0, 0, 0, 0, 0, 1, 1, 2])
    slope = np.array([2.0, -3.0])
    dq = np.where(run[:, None] == 1, 5.0, 1.0) + slope * time[:, None] * np.where(run[:, None] == 1, 2, 1)
    motion = motion_of(dq, joint_velocity=dq, time=time, run=run)
    wanted = slope[:, None] * np.array([1, 1, 1, 1, 1, 2, 2, 0])  # a run of one sample shows none
    np.testing.assert_allclose(accelerated(motion).joint_acceleration, wanted, rtol=0, atol=1e-12)


@pytest.mark.parametrize("step", [0.05, 0.004])
def test_accelerations_of_a_smooth_motion_are_near_however_dense_its_samples(step):
    t = np.arange(0, 3, step)
    motion = accelerated(motion_of(np.sin(2 * t)[:, None], joint_velocity=2 * np.cos(2 * t)[:, None], time=t))
    inside = (t > 0.06) & (t < t[-1] - 0.06)
    off = motion.joint_acceleration[0] + 4 * np.sin(2 * t)
    assert np.abs(off[inside]).max() < 4 * (2 * 0.05) ** 2 / 6 * 1.01  # of a central difference
    noise = np.random.default_rng(0).normal(0, 1e-3, (len(t), 1))
    noisy = accelerated(motion_of(np.zeros_like(noise), joint_velocity=noise, time=t)).joint_acceleration[0]
    assert np.std(noisy[inside]) < 1.1 * np.sqrt(2) * 1e-3 / 0.1


def test_a_later_motion_has_the_acceleration_between_its_samples():
    t = np.arange(6) * 0.1
    motion = accelerated(motion_of((t**3)[:, None], joint_velocity=(3 * t**2)[:, None], time=t))
    inner = slice(1, 4)
    np.testing.assert_allclose(shift(motion, 0.03).joint_acceleration[0, inner], 6 * (t + 0.03)[inner], atol=1e-12)
    np.testing.assert_array_equal(shift(motion, 0.0).joint_acceleration, motion.joint_acceleration)
    assert select(motion, [2]).joint_acceleration.shape == (1, 1)


def test_nothing_accelerates_without_velocities_or_times():
    q = np.zeros((3, 2))
    for motion in (motion_of(q, time=np.arange(3.0)), motion_of(q, joint_velocity=q)):
        assert accelerated(motion) is motion


def travelled(position, least):
    """How far one joint of one run is from its last reversal, found by looking back from each sample."""
    found = []
    for k, now in enumerate(position):
        turned, farthest, sense = position[0], position[0], 0.0
        for q in position[: k + 1]:
            sense = sense or np.sign(q - farthest)
            if sense * (farthest - q) > least:
                turned, farthest, sense = farthest, q, -sense
            elif sense * (q - farthest) > 0:
                farthest = q
        found.append(abs(now - turned))
    return np.array(found)


@pytest.mark.parametrize("sliding", [(), (1,)])
def test_the_travel_since_reversal_begins_anew_with_each_run_and_ignores_jitter(sliding):
    arrays = simulated(3, (40, 1, 25))
    rng = np.random.default_rng(4)
    arrays["joint_position"] += rng.normal(0, 1e-5, arrays["joint_position"].shape)
    found = np.asarray(since_reversal(motion_of(**arrays, sliding=sliding)))
    for run in np.unique(arrays["run"]):
        rows = arrays["run"] == run
        for j, q in enumerate(arrays["joint_position"][rows].T):
            expected = travelled(q, 1e-5 if j in sliding else 1e-4)
            np.testing.assert_allclose(found[j, rows], expected, rtol=0, atol=1e-12)


def test_a_joint_that_turns_back_travels_from_there():
    q = np.array([0.0, 0.2, 0.5, 0.5 - 5e-5, 0.4, 0.1, 0.3])[:, None]
    found = since_reversal(motion_of(q, joint_velocity=np.zeros_like(q)))[0]
    np.testing.assert_allclose(found, [0, 0.2, 0.5, 0.5 - 5e-5, 0.1, 0.4, 0.2], atol=1e-12)
