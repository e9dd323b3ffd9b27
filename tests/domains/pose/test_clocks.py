"""Offset and drift of two clocks from a motion: without bias, as exact as the noise allows, with honest deviations."""

from functools import cache

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from lite6jax.arms.description import load_bundled
from lite6jax.domains.pose.clocks import find_clocks
from lite6jax.errors import InputError
from lite6jax.recordings.streams import JointStream
from tests.oracles.chains import six_parameter_poses

LITE6 = load_bundled("lite6")
OFFSET, DRIFT, NOISE = 1234.567, 80e-6, 5e-5


def experiment(seed, sensor=37.0, robot=100.0, duration=30.0, systematic=0.0):
    """The robot's log, the sensor's times and positions, the offset at a sensor's time, and the tool's speeds."""
    rng = np.random.default_rng(seed)
    knots = np.arange(0, duration + 2, 1.5)
    middle, width = np.array([0, 0.2, 1.6, 0, 0.6, 0]), np.array([1, 0.4, 0.4, 1, 0.4, 1])
    motion = CubicSpline(knots, middle + width * rng.uniform(-1, 1, (len(knots), 6)))
    t = np.arange(0, duration, 1 / robot)
    at = np.arange(1.0, duration - 1.0, 1 / sensor) + rng.uniform(0, 1 / sensor)
    tool, turned, moved = 0.05 * rng.normal(size=3), Rotation.from_rotvec(rng.normal(size=3)), rng.normal(size=3)

    def placed(at):
        poses = six_parameter_poses(LITE6.kinematics, motion(at))
        point = poses[:, :3, 3] + poses[:, :3, :3] @ tool
        return point + systematic * np.sin(motion(at)[:, :3] + 1.0)

    position = turned.apply(placed(at)) + moved + NOISE * rng.normal(size=(len(at), 3))
    shown = at - OFFSET - DRIFT * (at - at[0])  # to first order in the drift

    def offset(time):
        return OFFSET + DRIFT * (time - shown[0]) / (1 - DRIFT)

    speed = np.linalg.norm(placed(at + 1e-4) - placed(at - 1e-4), axis=1) / 2e-4
    return JointStream.of(t, motion(t)), shown, position, offset, speed


@cache
def found_in(seed):
    """The clocks of an experiment without systematic errors, what they should be, and the bound of their deviation."""
    joints, time, position, offset, speed = experiment(seed)
    found = find_clocks(LITE6, joints, time, position)
    bound = NOISE / np.sqrt(np.sum(speed**2))  # were frame and tool known
    return found, offset(found.middle), bound, len(time)


def test_offset_and_drift_are_as_exact_as_the_noise_allows():
    scores = []
    for seed in range(5):
        found, offset, bound, rows = found_in(seed)
        scores.append((found.offset - offset) / found.offset_std)
        scores.append((found.drift - DRIFT / (1 - DRIFT)) / found.drift_std)
        assert 0.9 * bound < found.offset_std < 4 * bound
        assert found.error == pytest.approx(1.54 * NOISE, rel=0.1)
        assert found.rows == rows
    assert np.abs(scores).max() < 4
    assert 0.2 < np.sqrt(np.mean(np.square(scores))) < 1.8


@pytest.mark.parametrize("seed", [0, 1])
def test_errors_of_the_arm_widen_the_deviations(seed):
    joints, time, position, offset, _ = experiment(seed, systematic=1e-3)
    found = find_clocks(LITE6, joints, time, position)
    assert abs(found.offset - offset(found.middle)) < 4 * found.offset_std
    assert found.offset_std > 3 * found_in(seed)[0].offset_std


@pytest.mark.parametrize("part", [slice(0, 250), slice(600, None)])
def test_the_sensor_may_have_run_in_a_part_of_the_log_only(part):
    joints, time, position, offset, _ = experiment(7)
    found = find_clocks(LITE6, joints, time[part], position[part])
    assert abs(found.offset - offset(found.middle)) < 4 * found.offset_std < 1e-3


def test_the_robot_may_have_logged_a_part_only():
    joints, time, position, offset, _ = experiment(8)
    some = (joints.time > 12) & (joints.time < 22)
    found = find_clocks(LITE6, JointStream.of(joints.time[some], joints.position[some]), time, position)
    assert abs(found.offset - offset(found.middle)) < 4 * found.offset_std < 1e-3
    assert found.rows < 0.4 * len(time)


def test_another_motion_is_refused():
    joints, time, _, _, _ = experiment(1)
    with pytest.raises(InputError, match="agree at no offset"):
        find_clocks(LITE6, joints, time, experiment(2)[2])
