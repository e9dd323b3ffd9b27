"""Gross errors that a fitted arm takes up: they are said beside what factories grant, by check, fit and diagnosis."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lite6jax.arms.description import load_bundled
from lite6jax.domains.pose.check import check_recording
from lite6jax.domains.pose.fit import fit
from lite6jax.domains.pose.screening.screen import screen
from lite6jax.recordings import Recording, RecordingSettings
from lite6jax.report.faults import fault_statement, ruled_out_statements
from tests.oracles.chains import six_parameter_poses
from tests.oracles.transforms import perturb_poses

MADE = (3e-4, 1e-3)
"""m and rad, one sigma of each number of an arm that a factory has made."""
CAMERA = (3e-4, 1e-3)


def turned(vector, shift=(0, 0, 0)):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(vector).as_matrix()
    T[:3, 3] = shift
    return T


def recorded(arm="lite6", samples=80, noise=CAMERA, frame="unknown", tool="unknown", made=MADE, seed=3, of_base=None):
    """A recording of an arm that deviates from its table as `made` says, and the rotations of its flange."""
    rng = np.random.default_rng(seed)
    nominal = load_bundled(arm)
    low = np.maximum(nominal.joint_limits[:, 0], -np.pi)
    high = np.minimum(nominal.joint_limits[:, 1], np.pi)
    q = rng.uniform(low, high, (samples, nominal.dof))
    rows = nominal.kinematics + np.concatenate(
        [rng.normal(0, made[0], (nominal.dof, 3)), rng.normal(0, made[1], (nominal.dof, 3))], 1
    )
    flange = six_parameter_poses(rows, q) @ nominal.T_joint_flange
    where = (
        of_base if of_base is not None else np.eye(4) if frame == "base" else turned([0.3, -0.2, 1.1], [0.8, 0.4, 0.1])
    )
    T_tool = turned([0.4, 0.1, -0.6], [0.03, 0.05, 0.04])
    poses = where @ flange @ T_tool
    if noise is not None:
        poses = perturb_poses(rng, poses, *noise)
    declared = tuple(np.concatenate([T_tool[:3, 3], Rotation.from_matrix(T_tool[:3, :3]).as_euler("xyz")]).tolist())
    settings = RecordingSettings(
        arm=arm,
        motion="static",
        pose_source="camera",
        pose_frame=frame,
        tool="unknown" if tool == "unknown" else declared,
    )
    recording = Recording.from_arrays(
        q,
        position=poses[:, :3, 3],
        quaternion=np.roll(Rotation.from_matrix(poses[:, :3, :3]).as_quat(), 1, 1),
        settings=settings,
    )
    return recording, flange[:, :3, :3]


def without_zero(recording, joint, degrees):
    """The column of a joint is smaller by as much as its zero is lost."""
    q = recording.joint_position.copy()
    q[:, joint - 1] -= np.deg2rad(degrees)
    return replace(recording, joint_position=q)


def only(screened, code):
    assert [fault.code for fault in screened.found] == [code]
    return screened.found[0]


def deviation(screened):
    return next(fault for fault in screened.ruled_out if fault.code == "arm_deviation")


@pytest.mark.parametrize("arm", ["lite6", "ur5e", "xarm7"])
def test_an_arm_as_factories_make_it_has_no_fault(arm):
    screened = screen(recorded(arm)[0])
    assert screened.found == ()
    (sentence,) = ruled_out_statements([deviation(screened)])
    assert "mm from the nominal one" in sentence
    assert "within what is granted (1 mm and 0.29 deg)" in sentence


@pytest.mark.parametrize(("arm", "joint", "degrees"), [("lite6", 5, 12.5), ("ur5e", 3, -4.0), ("lite6", 2, 2.5)])
def test_a_lost_zero(arm, joint, degrees):
    fault = only(screen(without_zero(recorded(arm)[0], joint, degrees)), "joint_turns")
    assert fault.numbers["joint"] == joint
    assert np.rad2deg(fault.numbers["added_rad"]) == pytest.approx(degrees, abs=0.6)


def test_two_lost_zeros():
    recording = without_zero(without_zero(recorded()[0], 3, 5.0), 5, -8.0)
    found = {fault.numbers["joint"]: np.rad2deg(fault.numbers["added_rad"]) for fault in screen(recording).found}
    assert found == pytest.approx({3: 5.0, 5: -8.0}, abs=0.6)


@pytest.mark.parametrize("factor", [0.9, 1.03, 1.1, 25.4])
def test_the_scale_of_the_sensor(factor):
    recording, _ = recorded()
    screened = screen(replace(recording, position=factor * recording.position))
    assert only(screened, "sensor_scale").numbers["factor"] == pytest.approx(factor, rel=5e-3)
    np.testing.assert_allclose(screened.recording.position, recording.position, rtol=5e-3)


def test_the_scale_is_worded_by_what_may_have_caused_it():
    settings = replace(recorded()[0].settings, board={"columns": 6, "rows": 4, "square_m": 0.025})
    assert settings.board is not None
    numbers = {"factor": 1.25, "median_error_m": 0.05, "corrected_error_m": 5e-4, "alternatives": []}
    screened = screen(recorded()[0])
    fault = replace(deviation(screened), code="sensor_scale", numbers=numbers)
    assert "a marker or board of another size than declared" in fault_statement(fault)
    of_board = fault.with_numbers(declared_m=0.025, square_m=0.02)
    assert "a board whose squares are 20 mm and not the declared 25 mm" in fault_statement(of_board)
    assert "inches and millimetres" in fault_statement(fault.with_numbers(factor=1 / 25.4))


def test_a_frame_that_is_declared_wrongly_by_centimetres():
    recording, _ = recorded(frame="base", tool="known", of_base=turned([0.0, 0.02, -0.01], [0.02, -0.015, 0.03]))
    fault = only(screen(recording), "declared_frame")
    assert np.linalg.norm(fault.numbers["translation_m"]) == pytest.approx(0.039, abs=0.002)


def test_a_table_that_is_fitted_shows_that_poses_were_computed():
    """The controller computes with the arm's own calibrated table, which the nominal one misses by a millimetre."""
    screened = screen(recorded("ur5e", noise=None)[0])
    fault = only(screened, "computed_pose")
    assert fault.numbers["chain"] == "fitted"
    assert fault.numbers["median_error_m"] < 1e-8
    assert "a table that was fitted to them computes" in fault_statement(fault)


@pytest.mark.parametrize("chain", ["nominal", "fitted"])
def test_orientations_of_a_controller_beside_positions_of_a_tracker(chain):
    recording, own = recorded("ur5e", noise=(3e-5, 1e-4))
    nominal = load_bundled("ur5e")
    table = six_parameter_poses(nominal.kinematics, recording.joint_position) @ nominal.T_joint_flange
    R = table[:, :3, :3] if chain == "nominal" else own
    screened = screen(replace(recording, quaternion=np.roll(Rotation.from_matrix(R).as_quat(), 1, 1)))
    fault = only(screened, "computed_orientation")
    assert fault.numbers["chain"] == chain
    assert screened.recording.quaternion is None
    np.testing.assert_array_equal(screened.recording.position, recording.position)


def test_check_and_fit_say_the_same():
    recording = without_zero(recorded()[0], 5, 12.5)
    checked = check_recording(recording)
    solution = fit(recording)
    assert [fault.code for fault in checked.faults] == ["joint_turns"]
    assert solution.faults == checked.faults
    assert [fault for fault in solution.ruled_out if fault.code == "arm_deviation"] == [
        fault for fault in checked.ruled_out if fault.code == "arm_deviation"
    ]
    assert solution.nominal_errors.position_rms < 2e-3  # what is left is the arm's own


def test_a_zero_of_an_arm_that_nobody_has_measured_well_is_its_own():
    """Of an arm whose numbers are all off by several times what factories grant, one angle more is nothing unusual."""
    screened = screen(without_zero(recorded(made=(4e-3, 0.02))[0], 5, 2.0))
    assert screened.found == ()
    assert deviation(screened).numbers["factor"] > 1
