"""Commands of velocity and of torque: what a table of them is read as, and refused for."""

import numpy as np
import pytest
from typed import unread

from lite6jax.errors import InputError
from lite6jax.recordings import Recording, read_recording

PERIOD = 0.02
ROWS = 80
NOTE = "commands of velocity are taken as commands of position"
TIME = PERIOD * np.arange(ROWS)
SPEED = np.stack([np.cos(3 * TIME), -0.3 + 0 * TIME], 1)
JOINTS = np.stack([np.sin(3 * TIME) / 3 + 0.2, 0.5 - 0.3 * TIME], 1)
COLUMNS = {"time_s": TIME, "q1_rad": JOINTS[:, 0], "q2_rad": JOINTS[:, 1]} | {
    f"cmd_dq{joint}_rad_per_s": SPEED[:, joint - 1] for joint in (1, 2)
}


def held(begins):
    """Each velocity held until the next row, from the joints where a run begins."""
    expected = []
    for row in range(ROWS):
        if row in begins:
            expected.append(JOINTS[row])
        else:
            expected.append(expected[-1] + PERIOD * SPEED[row - 1])
    return np.array(expected)


def write(folder, columns, *keys):
    lines = [",".join(columns)]
    lines += [",".join(repr(float(value)) for value in row) for row in zip(*columns.values(), strict=True)]
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".yaml").write_text("\n".join(["recording:", "  motion: trajectory", *keys]) + "\n")
    return path


@pytest.mark.parametrize("keys", [(), ("  command: velocity",)])
def test_velocities_are_integrated_from_the_first_joints(tmp_path, keys):
    recording = read_recording(write(tmp_path, COLUMNS, *keys))
    assert recording.commanded_position == pytest.approx(held({0}), abs=1e-12)
    assert [note for note in recording.notes if note.startswith(NOTE)]
    assert recording.settings.command == "position"


def test_each_run_begins_anew_and_so_does_a_row_after_a_gap(tmp_path):
    runs = read_recording(write(tmp_path, COLUMNS | {"run": (np.arange(ROWS) >= 30).astype(float)}))
    assert runs.commanded_position == pytest.approx(held({0, 30}), abs=1e-12)
    for jump in (1.0, -1.0):
        path = write(tmp_path, COLUMNS | {"time_s": TIME + jump * (np.arange(ROWS) >= 50) + 2})
        assert read_recording(path).commanded_position == pytest.approx(held({0, 50}), abs=1e-12)


def test_a_row_without_a_velocity_is_left_out_and_the_one_before_holds(tmp_path):
    speed = SPEED[:, 1].copy()
    speed[10] = np.nan
    recording = read_recording(write(tmp_path, COLUMNS | {"cmd_dq2_rad_per_s": speed}))
    assert recording.samples == ROWS - 1
    assert recording.commanded_position[:, 1] == pytest.approx(np.delete(held({0})[:, 1], 10), abs=1e-12)


def test_degrees_a_second_are_converted(tmp_path):
    columns = {name: column for name, column in COLUMNS.items() if not name.startswith("cmd")}
    columns |= {f"cmd_dq{joint}_deg_per_s": np.rad2deg(SPEED[:, joint - 1]) for joint in (1, 2)}
    assert read_recording(write(tmp_path, columns)).commanded_position == pytest.approx(held({0}), abs=1e-12)


def test_of_positions_and_velocities_the_sidecar_chooses(tmp_path):
    both = COLUMNS | {"cmd1_rad": TIME, "cmd2_rad": -TIME}
    recording = read_recording(write(tmp_path, both))
    assert recording.commanded_position == pytest.approx(np.stack([TIME, -TIME], 1))
    assert not [note for note in recording.notes if note.startswith(NOTE)]
    recording = read_recording(write(tmp_path, both, "  command: velocity"))
    assert recording.commanded_position == pytest.approx(held({0}), abs=1e-12)


def test_frames_are_read_likewise():
    recording = Recording.from_dataframe(COLUMNS, motion="trajectory", command="velocity")
    assert recording.commanded_position == pytest.approx(held({0}), abs=1e-12)


def test_velocities_that_cannot_be_integrated_are_refused(tmp_path):
    without = {name: column for name, column in COLUMNS.items() if name != "time_s"}
    assert unread(write(tmp_path, without)) == "commands of velocity need times; add time_s"
    one = {name: column for name, column in COLUMNS.items() if name != "cmd_dq2_rad_per_s"}
    assert "cmd_dq2_rad_per_s" in unread(write(tmp_path, one))


def test_positions_that_are_declared_velocities_are_refused(tmp_path):
    columns = {name: column for name, column in COLUMNS.items() if not name.startswith("cmd")}
    columns |= {"cmd1_rad": TIME, "cmd2_rad": TIME}
    said = unread(write(tmp_path, columns, "  command: velocity"))
    assert "its commands are positions; name velocities cmd_dq1_rad_per_s ..., or leave command out" in said
    with pytest.raises(InputError, match="leave command out"):
        Recording.from_arrays(JOINTS, time=TIME, commanded_position=JOINTS, command="velocity")


def test_torques_are_sent_to_the_diagnosis_of_torques(tmp_path):
    columns = {name: column for name, column in COLUMNS.items() if not name.startswith("cmd")}
    torques = {f"cmd_tau{joint}_Nm": TIME for joint in (1, 2)}
    said = unread(write(tmp_path, columns | torques))
    assert "commands of torque are diagnosed as torques; write tau1_Nm ... in place of cmd_tau1_Nm ..." in said
    path = write(tmp_path, columns | torques, "  command: torque")
    with pytest.raises(InputError, match=r"name their columns tau1_Nm \.\.\., and leave this key out"):
        read_recording(path)
    # beside other commands they mean nothing
    assert read_recording(write(tmp_path, COLUMNS | torques)).commanded_position is not None
    renamed = {f"tau{joint}_Nm": TIME for joint in (1, 2)}
    assert read_recording(write(tmp_path, columns | renamed)).has_torques
