"""Rows in which the bus did not answer: what repeats exactly and contradicts the arm is no measurement."""

import numpy as np
import pytest
from typed import flat, run

from lite6jax.arms.description import load_bundled
from lite6jax.domains.pose.screening.screen import screen
from lite6jax.recordings import Recording, read_recording
from tests.oracles.arms import lite6_positions
from tests.oracles.chains import six_parameter_poses
from tests.oracles.transforms import random_transform, shift

LITE6 = load_bundled("lite6").kinematics
SILENT = np.array([5, 6, 20, 40])


def measured(homes=()):
    """Joints, and positions by a sensor somewhere, of a tool on the arm; at home in some rows."""
    rng = np.random.default_rng(2)
    q = lite6_positions(rng, 60)
    q[list(homes)] = 0.0
    poses = random_transform(rng, 2.0) @ six_parameter_poses(LITE6, q) @ shift(0.03, 0.01, 0.12)
    return q, poses[:, :3, 3] + 1e-4 * rng.normal(size=(60, 3))


def placeholders(q, position):
    """The rows of each mark that is found."""
    recording = Recording.from_arrays(joint_position=q, position=position, arm="lite6", motion="static")
    screened = screen(recording, allow_undecided=True, coarse=True)
    found = [fault for fault in screened.found if fault.code == "placeholder"]
    assert screened.recording.samples == 60 - sum(len(fault.rows) for fault in found)
    return [fault.rows for fault in found]


@pytest.mark.parametrize("value", [np.deg2rad(-1000.0), np.deg2rad(999.0), -1.0, 0.0])
def test_joints_that_all_hold_one_number_are_left_out(value):
    q, position = measured()
    q[SILENT] = value
    assert placeholders(q, position) == [tuple(SILENT + 1)]


@pytest.mark.parametrize("value", [0.0, -1e-3, -1.0])
def test_positions_that_all_hold_one_number_are_left_out(value):
    q, position = measured()
    position[SILENT] = value
    assert placeholders(q, position) == [tuple(SILENT + 1)]


@pytest.mark.parametrize("joint", [0, 5])
def test_one_joint_that_was_not_read_is_left_out(joint):
    q, position = measured()
    q[SILENT, joint] = np.deg2rad(-1000.0)
    assert placeholders(q, position) == [tuple(SILENT + 1)]


def test_joints_that_were_read_last_are_left_out_where_the_arm_has_moved():
    q, position = measured()
    q[21:24] = q[20]
    assert placeholders(q, position) == [(22, 23, 24)]


def test_home_taken_again_is_a_measurement():
    q, position = measured(homes=(3, 17, 33, 50))
    assert placeholders(q, position) == []
    q[40:43] = 0.0  # where it is not at home
    assert placeholders(q, position) == [(41, 42, 43)]


def test_a_silent_bus_does_not_hide_a_reversed_joint():
    q, position = measured()
    q[:, 2] *= -1.0
    q[SILENT] = np.deg2rad(-1000.0)
    recording = Recording.from_arrays(joint_position=q, position=position, arm="lite6", motion="static")
    codes = [fault.code for fault in screen(recording, coarse=True).found]
    assert codes == ["placeholder", "mirrored_joint"]


def test_every_command_lists_the_rows(tmp_path, capsys):
    q, position = measured()
    degrees = np.rad2deg(q)
    degrees[SILENT] = -1000.0
    path = tmp_path / "log.csv"
    header = ",".join([*(f"angle{k}" for k in range(1, 7)), "cam_x", "cam_y", "cam_z"])
    np.savetxt(path, np.column_stack([degrees, 1e3 * position]), "%.4f", ",", header=header, comments="")
    said = "4 rows hold no measurement: all joints are -17.4533 rad (-1000 deg)"
    for command in (["init", path, "--arm", "lite6", "--yes"], ["check", path]):
        _, out, _ = run(capsys, *command, width=200)
        assert said in flat(out)
        assert "Rows 6, 7, 21, 41." in flat(out)
        assert "turns were removed" not in flat(out)
    assert read_recording(path).samples == 60
