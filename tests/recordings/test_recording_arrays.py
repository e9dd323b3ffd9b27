from itertools import pairwise

import numpy as np
import pytest
from typed import refusal

from lite6jax.errors import InputError
from lite6jax.recordings import Recording, RecordingSettings, drop_missing

STATIC = RecordingSettings(motion="static")
TRAJECTORY = RecordingSettings(motion="trajectory")


def swing(time):
    """An analytic motion of two joints and its velocity."""
    q = np.column_stack([np.sin(2 * time), 0.3 * np.cos(time) + 0.1 * time])
    dq = np.column_stack([2 * np.cos(2 * time), -0.3 * np.sin(time) + 0.1])
    return q, dq


def uneven_times(count, step, seed=0):
    return np.arange(count) * step + np.random.default_rng(seed).uniform(-0.3, 0.3, count) * step


def test_trajectory_without_times_takes_the_direction_from_the_row_order_and_says_so():
    recording = Recording.from_arrays([[0.0], [1.0], [3.0], [1.0], [0.0]], settings=TRAJECTORY)
    assert recording.direction_of_motion.ravel().tolist() == [1, 1, 0, -1, -1]
    assert recording.joint_velocity is None
    assert recording.notes == (
        "the trajectory has neither times nor velocities: directions of motion follow the row order",
    )
    with pytest.raises(InputError, match=r"recording: a trajectory without velocities; add time_s or dq1_rad_per_s"):
        recording.velocities()


def test_a_dropped_row_does_not_change_its_neighbours_direction_or_velocity():
    q = np.array([[0.0], [2.0], [1.0], [3.0]])
    position = np.array([[0.1, 0, 0], [np.nan, 0, 0], [0.2, 0, 0], [0.3, 0, 0]])
    # the arm did go to 2.0, whether or not the sensor saw it: 1.0 was reached downwards
    recording = drop_missing(Recording.assembled(q, position=position, settings=STATIC))
    assert recording.row.tolist() == [1, 3, 4]
    assert recording.direction_of_motion.ravel().tolist() == [0, -1, 1]
    # where the joints themselves are missing the last known ones count
    q[1] = np.nan
    recording = drop_missing(Recording.assembled(q, position=np.nan_to_num(position), settings=STATIC))
    assert recording.direction_of_motion.ravel().tolist() == [0, 1, 1]
    time = uneven_times(30, 0.02)
    q, _ = swing(time)
    seen = np.ones((30, 3))
    seen[[7, 8, 20]] = np.inf
    whole = Recording.from_arrays(q, time=time, settings=TRAJECTORY)
    part = drop_missing(Recording.assembled(q, time=time, position=seen, settings=TRAJECTORY))
    np.testing.assert_array_equal(part.velocities(), np.delete(whole.velocities(), [7, 8, 20], axis=0))
    assert part.notes[-1] == "dropped 3 rows with NaN, infinite or empty fields, the first is row 8"


def test_differentiation_is_exact_for_parabolas_and_agrees_with_numpy():
    time = uneven_times(25, 0.1)
    q = np.column_stack([3 * time**2 - time, -(time**2), 0 * time, 5 * time])
    velocity = Recording.from_arrays(q, time=time, settings=TRAJECTORY).velocities()
    exact = np.column_stack([6 * time - 1, -2 * time, 0 * time, 5 + 0 * time])
    np.testing.assert_allclose(velocity, exact, atol=1e-11)
    q, _ = swing(time)
    velocity = Recording.from_arrays(q, time=time, settings=TRAJECTORY).velocities()
    np.testing.assert_allclose(velocity, np.gradient(q, time, axis=0, edge_order=2), atol=1e-12)


def test_differentiation_does_not_cross_runs_and_does_not_need_sorted_rows():
    time = np.concatenate([uneven_times(20, 0.05, 1), uneven_times(30, 0.05, 2), [0.0], [0.0, 0.1]])
    run = np.repeat([0, 1, 2, 3], [20, 30, 1, 2])
    q, _ = swing(time + 0.7 * run)
    expected = np.vstack(
        [
            np.gradient(q[:20], time[:20], axis=0, edge_order=2),
            np.gradient(q[20:50], time[20:50], axis=0, edge_order=2),
            np.zeros((1, 2)),
            np.repeat((q[52:53] - q[51:52]) / 0.1, 2, axis=0),
        ]
    )
    recording = Recording.from_arrays(q, time=time, run=run, settings=TRAJECTORY)
    np.testing.assert_allclose(recording.velocities(), expected, atol=1e-12)
    order = np.concatenate([np.random.default_rng(3).permutation(20), np.arange(20, 53)])
    mixed = Recording.from_arrays(q[order], time=time[order], run=run, settings=TRAJECTORY)
    np.testing.assert_allclose(mixed.velocities(), expected[order], atol=1e-12)


@pytest.mark.parametrize(
    ("time", "velocity", "motion", "reason"),
    [
        (None, None, "static", "it has neither times nor velocities"),
        (np.arange(5) * 8.0, None, "static", "its time step is 8 s"),
        (np.arange(5) * 0.02, None, "trajectory", "its time step is 0.02 s"),
        (np.arange(5) * 8.0, np.ones((5, 1)), "trajectory", "the joints move in 100% of the rows"),
        (np.arange(5) * 0.02, np.zeros((5, 1)), "static", "the joints move in 0% of the rows"),
        (np.zeros(5), None, "static", "its time step is inf s"),
    ],
)
def test_an_undeclared_motion_is_inferred_and_said(time, velocity, motion, reason):
    recording = Recording.from_arrays(np.arange(5.0)[:, None], time=time, joint_velocity=velocity)
    assert recording.motion == motion
    assert recording.notes[0] == f"the motion is not declared and is taken as {motion}: {reason}"
    declared = Recording.from_arrays(np.arange(5.0)[:, None], time=time, settings=STATIC)
    assert (declared.motion, declared.notes) == ("static", ())


def test_folds_are_neighbours_of_equal_size_and_cover_every_row_once():
    recording = Recording.from_arrays(np.zeros((13, 2)))
    folds = recording.contiguous_folds(5)
    assert np.sum(folds, axis=0).tolist() == [1] * 13
    assert sorted(int(fold.sum()) for fold in folds) == [2, 2, 3, 3, 3]
    for earlier, later in pairwise(folds):
        assert np.flatnonzero(earlier)[-1] + 1 == np.flatnonzero(later)[0]
    for count in (1, 14):
        with pytest.raises(InputError, match=rf"recording: {count} folds of 13 samples; choose 2 to 13"):
            recording.contiguous_folds(count)


def test_sorting_puts_each_run_in_order_and_derives_anew():
    time = np.array([0.0, 0.2, 0.1, 0.3, 0.0, 0.1])
    run = np.array([0, 0, 0, 0, 1, 1])
    q = np.sin(time)[:, None] + run[:, None]
    mixed = Recording.from_arrays(q, time=time, run=run, settings=STATIC)
    order = [0, 2, 1, 3, 4, 5]
    straight = Recording.from_arrays(q[order], time=time[order], run=run, settings=STATIC)
    tidy = mixed.sorted_by_time()
    assert tidy.row.tolist() == [1, 3, 2, 4, 5, 6]
    np.testing.assert_array_equal(tidy.direction_of_motion, straight.direction_of_motion)
    assert not np.array_equal(mixed.direction_of_motion[order], tidy.direction_of_motion)
    assert tidy.notes[-1] == "2 rows were out of time order and have been sorted"
    assert tidy.sorted_by_time() is tidy
    moving = Recording.from_arrays(q, time=time, run=run, settings=TRAJECTORY).sorted_by_time()
    expected = Recording.from_arrays(q[order], time=time[order], run=run, settings=TRAJECTORY)
    np.testing.assert_array_equal(moving.velocities(), expected.velocities())
    np.testing.assert_array_equal(moving.direction_of_motion, expected.direction_of_motion)
    untimed = Recording.from_arrays(q)
    assert untimed.sorted_by_time() is untimed


def test_quaternions_are_normalised_within_one_per_cent_and_get_one_sign():
    unit = np.array([[0.5, 0.5, 0.5, 0.5], [-0.6, 0.8, 0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]])
    scaled = unit * np.array([1.005, 0.995, 1.0, 1.0 + 1e-9])[:, None]
    recording = Recording.from_arrays(np.zeros((4, 6)), position=np.zeros((4, 3)), quaternion=scaled, settings=STATIC)
    expected = [[0.5, 0.5, 0.5, 0.5], [0.6, -0.8, 0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]]
    np.testing.assert_allclose(recording.quaternion, expected, atol=1e-15)
    assert recording.notes == ("normalised 2 quaternions, the furthest 0.005 from unit length",)
    again = Recording.from_arrays(np.zeros((4, 6)), position=np.zeros((4, 3)), quaternion=recording.quaternion)
    np.testing.assert_array_equal(again.quaternion, recording.quaternion)


def test_a_quaternion_beyond_one_per_cent_is_refused_with_its_row():
    quaternion = np.tile([1.0, 0, 0, 0], (5, 1))
    quaternion[2] *= 1.02
    quaternion[4] = 0
    given = {"position": np.zeros((5, 3)), "quaternion": quaternion}
    assert refusal(Recording.from_arrays, np.zeros((5, 6)), **given, source="a.csv") == (
        "a.csv: columns qw qx qy qz: row 3 has length 1.02 (and 1 more rows), not 1; give unit quaternions, scalar "
        "first, and leave the fields empty where the sensor lost its target"
    )
    quaternion[2:] = 1e200
    with pytest.raises(InputError, match="row 3 has length inf"):
        Recording.from_arrays(np.zeros((5, 6)), position=np.zeros((5, 3)), quaternion=quaternion)
