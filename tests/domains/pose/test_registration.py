"""Sensor frame and tool of a chain that is known, from exact, noisy and insufficient poses."""

import numpy as np
import pytest
from diagnosis.recorded import LITE6

from lite6jax.domains.pose.registration import register
from tests.oracles.arms import random_positions
from tests.oracles.chains import six_parameter_poses
from tests.oracles.transforms import perturb_poses, random_transform

NOISE = (2e-5, 1e-4)


def posed(seed, samples):
    """Flange poses, frame and tool."""
    rng = np.random.default_rng(seed)
    flange = six_parameter_poses(LITE6.kinematics, random_positions(rng, samples, 6))
    return flange, random_transform(rng, 2.0), random_transform(rng, 0.1)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("samples", [3, 40])
@pytest.mark.parametrize("known", ["neither", "frame", "tool", "both"])
def test_exact_poses_give_exact_frames(seed, samples, known):
    flange, F, T = posed(seed, samples)
    seen = F @ flange @ T
    frame, tool = F if known in ("frame", "both") else None, T if known in ("tool", "both") else None
    found = register(flange, seen[:, :3, 3], seen[:, :3, :3], NOISE, frame, tool)
    np.testing.assert_allclose(found.T_sensor_base, F, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.T_flange_tool, T, rtol=0, atol=1e-12)
    assert found.determined
    assert found.distance.max() < 1e-12


@pytest.mark.parametrize("seed", range(5))
def test_exact_positions_give_the_frame_and_the_offset(seed):
    flange, F, T = posed(seed, 6)
    found = register(flange, (F @ flange @ T)[:, :3, 3], None, NOISE, tool_rotation=T[:3, :3])
    np.testing.assert_allclose(found.T_sensor_base, F, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.T_flange_tool, T, rtol=0, atol=1e-11)
    assert found.turned is None
    assert found.noise[1] is None


@pytest.mark.parametrize("orientation", [True, False])
def test_noise_is_estimated_and_weighs_position_against_orientation(orientation):
    """Over many draws, errors as an efficient estimate has them: orientations help the frame's rotation."""
    off, noises = [], []
    for seed in range(60):
        flange, F, T = posed(seed, 30)
        seen = perturb_poses(np.random.default_rng(seed), F @ flange @ T, *NOISE)
        rotation = seen[:, :3, :3] if orientation else None
        found = register(flange, seen[:, :3, 3], rotation, NOISE, tool_rotation=T[:3, :3])
        off.append(found.T_flange_tool[:3, 3] - T[:3, 3])
        noises.append(found.noise[0])
    # R_k t beside a constant in the sensor's axes: each axis of the tool is a mean of 30 readings
    assert np.sqrt(np.mean(np.square(off))) < 1.5 * NOISE[0] / np.sqrt(30)
    assert np.mean(noises) == pytest.approx(NOISE[0], rel=0.05)


def test_wild_poses_count_for_little():
    flange, F, T = posed(3, 50)
    seen = perturb_poses(np.random.default_rng(1), F @ flange @ T, *NOISE)
    seen[:5, :3, 3] += 0.05
    for rotation in (seen[:, :3, :3], None):
        found = register(flange, seen[:, :3, 3], rotation, NOISE, tool_rotation=T[:3, :3])
        assert np.abs(found.T_flange_tool[:3, 3] - T[:3, 3]).max() < 3e-5
        np.testing.assert_array_equal(np.flatnonzero(~found.kept), range(5))
        assert found.rms < 5e-5


def test_poses_that_turn_about_one_axis_leave_the_frames_open():
    rng = np.random.default_rng(2)
    q = np.tile(rng.uniform(-1, 1, 6), (30, 1))
    q[:, 5] = rng.uniform(-3, 3, 30)
    flange, (_, F, T) = six_parameter_poses(LITE6.kinematics, q), posed(2, 3)
    seen = F @ flange @ T
    for rotation in (seen[:, :3, :3], None):
        assert not register(flange, seen[:, :3, 3], rotation, NOISE).determined
        assert register(flange, seen[:, :3, 3], rotation, NOISE, frame=F).determined
