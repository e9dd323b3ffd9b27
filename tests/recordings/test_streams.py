"""Streams at times of their own: joints and poses in different rows of a table, joined at the times of the poses."""

import numpy as np
import pytest

from lite6jax.errors import InputError
from lite6jax.recordings import Recording, streams
from lite6jax.recordings.streams import join


def motion(t, joints=6):
    """Smooth joint positions and velocities `(sample, joint)` at times."""
    rate, phase = np.linspace(0.5, 1.9, joints), np.arange(joints)
    return np.sin(np.outer(t, rate) + phase), rate * np.cos(np.outer(t, rate) + phase)


def table(t, q, dq, at, p):
    """Columns of a table in which joint states and poses stand in different rows, in order of time."""
    order = np.argsort(np.concatenate([t, at]), kind="stable")
    empty = np.full((len(at), q.shape[1]), np.nan)
    columns = {"time_s": np.concatenate([t, at])[order]}
    for name, values in (("q{}_rad", q), ("dq{}_rad_per_s", dq)):
        rows = np.concatenate([values, empty])[order]
        columns |= {name.format(k + 1): rows[:, k] for k in range(q.shape[1])}
    rows = np.concatenate([np.full((len(t), 3), np.nan), p])[order]
    columns |= {f"{axis}_m": rows[:, k] for k, axis in enumerate("xyz")}
    return columns, order


@pytest.fixture
def sparse():
    rng = np.random.default_rng(3)
    t = 1.76e9 + np.cumsum(rng.uniform(0.018, 0.022, 200))
    at = np.sort(rng.uniform(t[0] - 0.05, t[-1] + 0.05, 80))
    q, dq = motion(t - 1.76e9)
    return t, q, dq, at, rng.normal(size=(80, 3))


def test_joints_are_interpolated_at_the_times_of_the_poses(sparse):
    t, _, _, at, p = sparse
    columns, order = table(*sparse)
    recording = Recording.from_dataframe(columns)
    inside = (at >= t[0]) & (at <= t[-1])
    assert 70 < inside.sum() < 80
    wanted, rate = motion(at[inside] - 1.76e9)
    np.testing.assert_array_equal(recording.position, p[inside])
    np.testing.assert_allclose(recording.joint_position, wanted, atol=2e-6)  # a straight line is off by 2e-4
    np.testing.assert_allclose(recording.joint_velocity, rate, atol=5e-4)
    np.testing.assert_array_equal(order[recording.row - 1], len(t) + np.flatnonzero(inside))
    note = next(note for note in recording.notes if "different rows" in note)
    assert note.startswith(
        "80 poses and 200 joint states stand in different rows: the joints are interpolated by cubics"
    )
    assert f"dropped {80 - inside.sum()} poses before the first or after the last joint state" in recording.notes


def test_nothing_is_interpolated_where_rows_hold_both(sparse):
    t, q, dq, _, _ = sparse
    columns, _ = table(t, q, dq, t, np.random.default_rng(0).normal(size=(200, 3)))
    both = {name: np.concatenate([values[::2], [np.nan]])[:200] for name, values in columns.items()}
    both |= {f"{axis}_m": columns[f"{axis}_m"][1::2] for axis in "xyz"}
    both = {name: values[:200] for name, values in both.items()}
    both["x_m"][:90] = np.nan  # the sensor lost the tool in many rows
    recording = Recording.from_dataframe(both)
    assert recording.samples == 110
    assert not any("interpolated" in note for note in recording.notes)


def test_poses_in_long_gaps_are_left_out_unless_the_arm_stood_still():
    t = np.concatenate([np.arange(0, 2, 0.02), np.arange(2.1, 4, 0.02), np.arange(4.1, 6, 0.02)])
    q = np.minimum(np.outer(t, [1.0, 0.5]), [3.0, 1.5])  # it stands still from 3 s on
    found = join(t, {"q1": q[:, 0], "q2": q[:, 1]}, ["q1", "q2"], np.array([1.005, 2.05, 3.505, 4.05, 7.0]))
    np.testing.assert_array_equal(found.usable, [True, False, True, True, False])
    assert (found.wide, found.outside) == (1, 1)
    np.testing.assert_allclose(found.columns["q1"], [1.005, 3.0, 3.0], atol=1e-12)


def test_captures_are_paired_with_the_pose_beside_them():
    rng = np.random.default_rng(1)
    t = np.arange(40) * 5.0
    q = rng.uniform(-2, 2, (40, 6))
    columns = {f"q{k}": q[:, k] for k in range(6)}
    at = np.concatenate([t + rng.uniform(-0.1, 0.1, 40), [52.5]])
    found = join(t, columns, list(columns), at)
    assert found.method == "nearest"
    np.testing.assert_array_equal(np.stack(list(found.columns.values()), 1), q)
    np.testing.assert_array_equal(np.flatnonzero(~found.usable), [40])


def test_joint_states_that_do_not_follow_the_motion_are_not_interpolated():
    rng = np.random.default_rng(4)
    t, at = np.arange(40) * 5.0, np.sort(rng.uniform(0, 195, 60))
    columns, _ = table(t, rng.uniform(-2, 2, (40, 6)), np.zeros((40, 6)), at, rng.normal(size=(60, 3)))
    with pytest.raises(InputError, match="the joints move too far from one to the next; record both in one row"):
        Recording.from_dataframe(columns)
    columns, _ = table(
        np.arange(40) * 0.1, motion(np.arange(40) * 0.1)[0], np.zeros((40, 6)), at + 10, rng.normal(size=(60, 3))
    )
    with pytest.raises(InputError, match="no pose lies between joint states"):
        Recording.from_dataframe(columns)


def test_each_run_has_its_own_clock():
    """Times begin anew in each run: its poses take its own joints; without a column of runs that is refused."""
    t = np.arange(0, 5, 0.02)
    at = np.arange(0.11, 4.8, 0.1)
    parts = []
    for run in (1, 2):
        joint = {"time": t, "q1": np.sin(t) + 0.5 * run, "x": np.full(len(t), np.nan), "run": np.full(len(t), run)}
        pose = {"time": at, "q1": np.full(len(at), np.nan), "x": at, "run": np.full(len(at), run)}
        parts += [joint, pose]
    columns = {name: np.concatenate([part[name] for part in parts]).astype(float) for name in parts[0]}
    found = streams.merge(columns, ["q1"], ["x"], "time", [])
    assert found is not None
    wanted = np.sin(found[0]["time"]) + 0.5 * found[0]["run"]
    np.testing.assert_allclose(found[0]["q1"], wanted, atol=1e-5)
    assert len(wanted) == 2 * len(at)
    del columns["run"]
    with pytest.raises(InputError, match="number the runs in a column `run`"):
        streams.merge(columns, ["q1"], ["x"], "time", [])
