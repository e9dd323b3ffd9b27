import dataclasses

import numpy as np
import pytest
from typed import refusal

import lite6jax
from lite6jax.arms.description import load_bundled
from lite6jax.errors import InputError
from lite6jax.recordings import (
    Recording,
    RecordingSettings,
    check_scale,
    check_torque_scale,
    check_velocity_scale,
    outside_limits,
    repeated_rows,
    require_samples,
    time_disorder,
)

LITE6 = np.deg2rad([[-360, 360], [-150, 150], [-3.5, 300], [-360, 360], [-124, 124], [-360, 360]])
REACH = 0.7


@pytest.fixture
def plausible():
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(200, 3))
    position = direction / np.linalg.norm(direction, axis=1, keepdims=True) * rng.uniform(0.1, REACH, (200, 1))
    return Recording.from_arrays(rng.uniform(LITE6[:, 0], LITE6[:, 1], (200, 6)), position=position)


def with_joints(recording, joint_position):
    return dataclasses.replace(recording, joint_position=joint_position)


def test_faults_that_the_diagnosis_must_see_are_not_taken_for_degrees(plausible):
    q = plausible.joint_position
    mirrored, swapped, turned, outliers = q.copy(), q.copy(), q.copy(), q.copy()
    mirrored[:, 2] *= -1
    swapped[:, [1, 2]] = swapped[:, [2, 1]]
    turned[:, 0] += 2 * np.pi
    outliers[:19] = 500.0
    for faulty in (mirrored, swapped, turned, outliers):
        check_scale(with_joints(plausible, faulty), LITE6)
        assert outside_limits(with_joints(plausible, faulty), LITE6)


def test_degrees_are_refused_even_in_one_joint_and_beside_endless_ones(plausible):
    q = plausible.joint_position.copy()
    q[:, 3] = np.rad2deg(q[:, 3])
    with pytest.raises(InputError, match=r"recording: column q4_rad: row \d+ is at .* are these degrees\?"):
        check_scale(with_joints(plausible, q), LITE6)
    endless = LITE6.copy()
    endless[5] = [-np.inf, np.inf]
    with pytest.raises(InputError, match=r"column q4_rad: .* joint 4 goes from -6\.283 to 6\.283 rad"):
        check_scale(with_joints(plausible, q), endless)
    check_scale(plausible, endless)


def test_a_distant_tracker_is_not_taken_for_millimetres_but_a_distant_base_is(plausible):
    far = plausible.position + np.array([30.0, 0, 0])
    check_scale(dataclasses.replace(plausible, position=far), reach=REACH)
    declared = dataclasses.replace(plausible, position=far, settings=RecordingSettings(pose_frame="base"))
    with pytest.raises(
        InputError, match=r"the positions lie .* m from the base \(median\) while the arm reaches 0\.7 m"
    ):
        check_scale(declared, reach=REACH)
    few = plausible.position.copy()
    few[:50] *= 1000  # outliers, for the diagnosis
    check_scale(dataclasses.replace(plausible, position=few), reach=REACH)
    with pytest.raises(InputError, match=r"m from their middle .* are these millimetres\?"):
        check_scale(dataclasses.replace(plausible, position=plausible.position * 1000), reach=REACH)
    check_scale(dataclasses.replace(plausible, position=None), reach=REACH)


@pytest.mark.parametrize(
    ("oriented", "unknowns", "message"),
    [
        (False, 13, "4 samples of 3 numbers (position without orientation) give 12 numbers, fewer than the 13 to"),
        (False, 28, "fewer than the 28 to determine; record at least 10 samples"),
        (True, 28, "4 samples of 6 numbers (position and orientation) give 24 numbers, fewer than the 28 to determine"),
        (True, 30, "fewer than the 30 to determine; record at least 5 samples"),
    ],
)
def test_too_few_samples_give_both_counts(oriented, unknowns, message):
    quaternion = np.tile([1.0, 0, 0, 0], (4, 1)) if oriented else None
    recording = Recording.from_arrays(
        np.zeros((4, 6)), position=np.zeros((4, 3)), quaternion=quaternion, source="a.csv"
    )
    said = refusal(require_samples, recording, unknowns)
    assert said.startswith("a.csv: ")
    assert message in said
    require_samples(recording, 24 if oriented else 12)


@pytest.mark.parametrize("number", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["position", "joint_position", "payload"])
def test_a_fit_names_the_first_number_that_is_none(plausible, name, number):
    values = getattr(plausible, name).astype(type(number))
    values[[7, 9]] = number
    said = refusal(lite6jax.fit, dataclasses.replace(plausible, **{name: values}))
    column = {"position": "x_m", "joint_position": "q1_rad", "payload": "payload_kg"}[name]
    assert said == (
        f"recording: row 8 has {number} in column {column}; give finite real numbers, as Recording.from_arrays does, "
        "which leaves out rows without"
    )


def test_time_disorder_agrees_with_a_plain_loop():
    rng = np.random.default_rng(1)
    time, run = rng.integers(0, 50, 300) * 0.5, np.sort(rng.integers(0, 6, 300))[::-1]
    late = [k for k in range(300) if any(run[j] == run[k] and time[j] > time[k] for j in range(k))]
    assert time_disorder(Recording.from_arrays(np.zeros((300, 1)), time=time, run=run))[0].tolist() == late


def test_repeated_rows_are_found_with_their_first(plausible):
    rows = np.r_[0:200, 17, 42, 17]
    again, first = repeated_rows(plausible.select(rows))
    assert again.tolist() == [200, 201, 202]
    assert first.tolist() == [17, 42, 17]
    # the same joints with another measured pose, or the same pose at other joints, are no repetition
    again = plausible.select(np.r_[0:200, 0:200])
    assert len(repeated_rows(dataclasses.replace(again, position=again.position + np.r_[0:400][:, None]))[0]) == 0
    assert len(repeated_rows(with_joints(again, again.joint_position + np.r_[0:400][:, None]))[0]) == 0
    assert len(repeated_rows(again)[0]) == 200


def swinging(torque_factor=1.0, velocity_factor=1.0, time_factor=1.0, **declared):
    """Two joints that swing, with currents of 2 A and torques of up to 6 N m; one row in nine is an outlier."""
    time = np.arange(0.0, 8.0, 0.01)
    q = np.stack([np.sin(time), 0.3 * np.cos(2 * time)] + [np.zeros_like(time)] * 4, 1)
    dq = np.stack([np.cos(time), -0.6 * np.sin(2 * time)] + [np.zeros_like(time)] * 4, 1)
    torque = np.tile([0.5, 6.0, 3.0, 0.4, 0.2, 0.0], (len(time), 1))
    torque[::9], dq[::9] = 9e4, 300.0
    measured = {"motor_current": np.full((len(time), 6), 2.0)} if declared else {"joint_torque": torque_factor * torque}
    return Recording.from_arrays(
        q, time=time_factor * time, joint_velocity=velocity_factor * dq, motion="trajectory", **measured, **declared
    )


def test_torques_and_velocities_in_their_units_pass():
    arm = load_bundled("lite6")
    check_torque_scale(swinging(), arm)
    check_torque_scale(swinging(torque_constant_Nm_per_A=[10.0] * 6), arm)
    check_torque_scale(swinging(1e3), dataclasses.replace(arm, mass=None, center_of_mass=None, inertia=None))
    check_velocity_scale(swinging())
    check_velocity_scale(swinging(time_factor=2.0))  # a clock that is off is for a diagnosis to find
    check_velocity_scale(Recording.from_arrays(np.zeros((9, 6)), time=np.arange(9.0), motion="trajectory"))


def test_torques_in_another_unit_are_asked_about():
    arm = load_bundled("lite6")
    message = refusal(check_torque_scale, swinging(900.0), arm)  # outliers are then beyond any arm, and dropped
    assert message.startswith(
        "recording: column tau2_Nm: the torque of joint 2 is 5400 N m (median) while the weight of"
    )
    assert message.endswith("N m at most; are these mN m? name the columns tau1_mNm ...")
    with pytest.raises(InputError, match=r"column current1_A: .* at most; are these mA\? .* torque_constant_Nm_per_A"):
        check_torque_scale(swinging(torque_constant_Nm_per_A=[1e4, 1, 1, 1, 1, 1]), arm)
    with pytest.raises(InputError, match="has no joint torques; add tau1_Nm"):
        check_torque_scale(Recording.from_arrays(np.zeros((3, 6))), arm)


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        ({"velocity_factor": 180 / np.pi}, "57.3 times what the positions change per second (median); are these"),
        ({"time_factor": 1e3}, "1e+03 times what the positions change per second (median); check their unit and"),
        ({"velocity_factor": 0.0}, "0 times what the positions change per second"),
    ],
)
def test_velocities_that_contradict_the_positions_are_asked_about(factors, message):
    said = refusal(check_velocity_scale, swinging(**factors))
    assert said.startswith(f"recording: columns dq1_rad_per_s ...: the velocities are {message}")


def test_a_joint_that_stands_still_has_no_velocity_whatever_the_times():
    """Rounding would give it a direction of motion."""
    time = np.cumsum(np.random.default_rng(3).uniform(0.02, 0.04, 200))
    joints = np.column_stack([np.sin(time), np.full(200, 0.3)])
    recording = Recording.from_arrays(joints, time=time, motion="trajectory")
    assert recording.joint_velocity is not None
    assert not recording.joint_velocity[:, 1].any()
    assert not recording.direction_of_motion[:, 1].any()
