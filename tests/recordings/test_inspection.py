"""What is recognised in tables of an arm whose pose is read by a sensor anywhere: units, rotations, the arm itself."""

import contextlib

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from lite6jax.arms.description import load_bundled
from lite6jax.arms.urdf import read_urdf
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.columns.inspection import inspect
from lite6jax.recordings.table import RawTable, tabulate
from lite6jax.report.inspection import choice_of_pose, inspection_report, next_steps, sidecar_text
from tests.oracles.arms import lite6_positions, perturbed
from tests.oracles.chains import six_parameter_poses
from tests.oracles.pinocchio_arm import urdf_link_pose
from tests.oracles.sliding_arms import ARMS
from tests.oracles.transforms import random_transform, shift

LITE6 = load_bundled("lite6")
ROWS = 60


def measured(rows=ROWS, seed=0):
    """Joints, and poses of a tool on a Lite 6 as made, in the frame of a sensor some metres away."""
    rng = np.random.default_rng(seed)
    q = lite6_positions(rng, rows)
    poses = random_transform(rng, 2.0) @ six_parameter_poses(perturbed(rng, LITE6.kinematics), q)
    tool = shift(0.03, 0.01, 0.12)
    tool[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    return q, poses @ tool


Q, POSES = measured()
P, TURNED = POSES[:, :3, 3], Rotation.from_matrix(POSES[:, :3, :3])
ROTATIONS = {
    "quaternion w x y z": (TURNED.as_quat(scalar_first=True), ("qw", "qx", "qy", "qz")),
    "quaternion x y z w": (TURNED.as_quat(), ("qx", "qy", "qz", "qw")),
    "rotation vector": (TURNED.as_rotvec(), ("rx_rad", "ry_rad", "rz_rad")),
    "rotation vector, degrees": (TURNED.as_rotvec(degrees=True), ("rx_deg", "ry_deg", "rz_deg")),
    "roll pitch yaw": (TURNED.as_euler("xyz"), ("roll_rad", "pitch_rad", "yaw_rad")),
    "roll pitch yaw, degrees": (TURNED.as_euler("xyz", degrees=True), ("roll_deg", "pitch_deg", "yaw_deg")),
    "Rx Ry Rz": (TURNED.as_euler("XYZ"), ("rotx_rad", "roty_rad", "rotz_rad")),
    "Rz Ry Rz, degrees": (TURNED.as_euler("ZYZ", degrees=True), ("alpha_deg", "beta_deg", "gamma_deg")),
}


def table(joints="q_{}", pose="tool_pose_{}", angle=1.0, length=1.0, rotation=None):
    """A frame with columns of these names, and numbers in other units."""
    columns = dict(zip((joints.format(k) for k in range(6)), angle * Q.T, strict=True))
    parts = np.column_stack([length * P, *([] if rotation is None else [rotation])])
    return columns | dict(zip((pose.format(k) for k in range(parts.shape[1])), parts.T, strict=True))


def read(frame, arm=LITE6, **options):
    """The inspection, and the recording that it leads to."""
    found = inspect(list(frame.items()), arm, **options)
    return found, Recording.from_dataframe(frame, columns=found.columns, motion="static")


@pytest.mark.parametrize("case", ROTATIONS)
def test_the_arm_shows_units_and_the_form_of_a_rotation(case):
    rotation, names = ROTATIONS[case]
    found, recording = read(table(angle=180 / np.pi, length=1e3, rotation=rotation))
    assert tuple(found.columns.values())[6:9] == ("x_mm", "y_mm", "z_mm")
    assert tuple(found.columns.values())[9:] == names
    np.testing.assert_allclose(recording.joint_position, Q, atol=1e-13)
    np.testing.assert_allclose(recording.position, P, atol=1e-13)
    turned = Rotation.from_quat(recording.quaternion, scalar_first=True)
    np.testing.assert_allclose((turned.inv() * TURNED).magnitude(), 0, atol=1e-7)
    for block in found.blocks:
        assert block.unit.sure == "certain"
    assert found.of("q").unit.reason == found.of("rotation").form.reason == "kinematics"
    assert found.error < 5e-3


def test_numbers_that_size_alone_would_misread():
    """Degrees of joints that hardly move, and a sensor 30 m away."""
    small = np.random.default_rng(1).uniform(-0.09, 0.09, (ROWS, 6))
    poses = six_parameter_poses(LITE6.kinematics, small)
    frame = {f"q{k}": np.rad2deg(small[:, k]) for k in range(6)}
    assert inspect(list(frame.items())).of("q").unit[:2] == ("rad", "likely")
    frame |= {f"tcp_{axis}": poses[:, k, 3] + 30.0 for k, axis in enumerate("xyz")}
    found = inspect(list(frame.items()), LITE6)
    assert [found.of(kind).unit[:2] for kind in ("q", "position")] == [("deg", "certain"), ("m", "certain")]


def test_the_arm_is_recognised_where_only_one_agrees():
    found = inspect(list(table(angle=180 / np.pi, length=1e3).items()))
    assert found.arm is not None
    assert found.arm.name == found.arms[0][0] == "lite6"
    assert found.arms[0][1] < 5e-3 < found.arms[1][1]
    assert [*found.columns.values()] == [f"q{k}_deg" for k in range(1, 7)] + ["x_mm", "y_mm", "z_mm"]


def test_an_arm_that_does_not_agree_decides_nothing():
    found = inspect(list(table(rotation=ROTATIONS["rotation vector"][0]).items()), load_bundled("ur10"))
    assert found.error > 0.05
    assert [(block.unit.choice, block.unit.sure) for block in found.blocks] == [
        ("rad", "likely"),
        ("m", "likely"),
        ("rad", "likely"),
    ]
    assert found.of("rotation").form[:2] == ("rx", "assumed")


def test_without_poses_sizes_and_slopes_decide():
    t = np.arange(200) * 8.0  # ms
    q = np.stack([90 * np.sin(t / 1000 + k) for k in range(6)], 1)
    dq = np.deg2rad(np.stack([90 * np.cos(t / 1000 + k) for k in range(6)], 1))
    frame = {"t": t} | {f"q{k}": q[:, k] for k in range(6)} | {f"qd{k}": dq[:, k] for k in range(6)}
    frame |= {f"torque_{k}": 5e3 * np.sin(q[:, k]) for k in range(6)} | {f"current_{k}": q[:, k] / 50 for k in range(6)}
    found = inspect(list(frame.items()), LITE6)
    chosen = {block.kind: (block.unit.choice, block.unit.sure) for block in found.blocks}
    assert chosen == {
        "q": ("deg", "likely"),
        "dq": ("rad_per_s", "certain"),
        "tau": ("mNm", "likely"),
        "current": ("A", "assumed"),
        "time": ("ms", "likely"),
    }
    assert found.motion[0] == "trajectory"
    recording = Recording.from_dataframe(frame, columns=found.columns)
    np.testing.assert_allclose(recording.time, t / 1e3, atol=1e-12)


@pytest.mark.parametrize(("factor", "unit"), [(1, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_clocks_are_recognised(factor, unit):
    frame = {"stamp": (1.76e9 + np.arange(50.0)) * factor, "q0": np.linspace(0, 1, 50), "q1": np.zeros(50)}
    assert inspect(list(frame.items())).of("time").unit[:3] == (unit, "certain", "clock")


def test_what_is_given_comes_before_what_is_recognised():
    frame = table("J{}", "tool_pose_{}") | {"spindle_1": np.ones(ROWS), "label": None}
    given = {"J5": "q6_deg", "spindle_1": "ignore"}
    found = inspect(list(frame.items()), None, given)
    assert found.columns["J5"] == "q6_deg"
    assert found.columns["spindle_1"] == found.columns["label"] == "ignore"
    swapped = inspect(list(frame.items()), None, {"J0": "q2_rad", "J1": "q1_rad"}).columns
    assert (swapped["J0"], swapped["J1"]) == ("q2_rad", "q1_rad")
    other = inspect(list(frame.items()), None, {"spindle_1": "q6_rad"}).columns
    assert (other["J5"], other["spindle_1"]) == ("ignore", "q6_rad")
    degrees = inspect(list(frame.items()), None, {f"J{k}": f"q{k + 1}_deg" for k in range(6)})
    assert degrees.of("q").unit.reason == "name"
    with pytest.raises(InputError, match=r"recording: has no column 'J9'; it has 'J0', 'J1'"):
        inspect(list(frame.items()), None, {"J9": "q1_rad"})


def test_what_is_assumed_can_be_renamed():
    frame = table(rotation=ROTATIONS["quaternion w x y z"][0])
    found = inspect(list(frame.items()), load_bundled("ur10"))
    rotation = found.of("rotation")
    assert rotation.form[:2] == ("scalar_last", "assumed")
    assert rotation.forms == ("scalar_first", "scalar_last")
    given = rotation.renamed(form="scalar_first") | found.of("q").renamed(unit="deg")
    assert [*given.values()] == ["qw", "qx", "qy", "qz"] + [f"q{k}_deg" for k in range(1, 7)]
    again = inspect(list(frame.items()), LITE6, given)
    assert {own: again.columns[own] for own in given} == given
    assert again.of("rotation").form == ("scalar_first", "certain", "name", {})
    angles = table(rotation=ROTATIONS["rotation vector"][0])
    vector = inspect(list(angles.items()), load_bundled("ur10")).of("rotation")
    given = vector.renamed(form="alpha")
    assert [*given.values()] == ["alpha_rad", "beta_rad", "gamma_rad"]
    assert inspect(list(angles.items()), LITE6, given).of("rotation").renamed() == given


def test_a_gripper_behind_the_arm_is_left_out():
    frame = {f"joint_{k}": np.linspace(0, k, 30) for k in range(1, 8)}
    found = inspect(list(frame.items()), LITE6)
    assert found.columns["joint_7"] == "ignore"
    assert found.of("q").columns == tuple(f"joint_{k}" for k in range(1, 7))


def test_a_table_with_the_names_of_a_recording_needs_no_columns():
    frame = {"q1_rad": Q[:, 0], "q2_rad": Q[:, 1], "gap": None, "missing": np.zeros(ROWS), "note": None}
    assert inspect(list(frame.items())).columns == {}
    refused = inspect([*frame.items(), ("x", None)]).columns  # it would have to have a unit
    assert refused == {"q1_rad": "q1_rad", "q2_rad": "q2_rad", "note": "ignore", "x": "ignore"}


def sliding_table(tmp_path, name, joints="axis_{}", units=("deg", "mm"), trajectory=False):
    """An arm with prismatic joints, its joint positions in SI units, and a table in others of what Pinocchio says."""
    path = tmp_path / f"{name}.urdf"
    path.write_text(ARMS[name])
    arm, rng = read_urdf(path), np.random.default_rng(5)
    q = rng.uniform(*arm.joint_limits.T, (ROWS, arm.dof))
    if trajectory:
        time = 0.05 * np.arange(ROWS)
        q = arm.joint_limits.mean(1) + 0.4 * np.sin(time[:, None] * np.arange(1, arm.dof + 1))
    pose = urdf_link_pose(path, "tool")
    position = (random_transform(rng, 2.0) @ np.array([pose(row) for row in q]))[:, :3, 3]
    factor = np.where(arm.slides, {"mm": 1e3, "m": 1.0}[units[1]], {"deg": 180 / np.pi, "rad": 1.0}[units[0]])
    frame = dict(zip((joints.format(k) for k in range(arm.dof)), (factor * q).T, strict=True))
    if trajectory:
        v = 0.4 * np.arange(1, arm.dof + 1) * np.cos(time[:, None] * np.arange(1, arm.dof + 1))
        frame |= dict(zip((f"velocity_{k}" for k in range(arm.dof)), (factor * v).T, strict=True))
        frame |= {f"torque_{k}": np.ones(ROWS) for k in range(arm.dof)} | {"time": time}
    return arm, q, frame, dict(zip(("tcp_x", "tcp_y", "tcp_z"), position.T, strict=True))


@pytest.mark.parametrize("units", [("deg", "mm"), ("rad", "mm"), ("deg", "m")])
@pytest.mark.parametrize("name", ["rail", "scara"])
def test_the_arm_shows_the_unit_of_its_slides(tmp_path, name, units):
    arm, q, frame, position = sliding_table(tmp_path, name, units=units)
    found = inspect(list((frame | position).items()), arm)
    turning, slides = found.blocks[:2]
    assert (turning.slides, slides.slides) == (False, True)
    assert slides.columns == tuple(f"axis_{k}" for k in arm.sliding)
    assert (turning.unit.choice, slides.unit.choice) == units
    for block in found.blocks:
        assert block.unit[1:3] == ("certain", "kinematics")
    assert found.error < 1e-9
    recording = Recording.from_dataframe(frame | position, columns=found.columns, arm=arm, motion="static")
    assert recording.sliding == arm.sliding
    np.testing.assert_allclose(recording.joint_position, q, atol=1e-12)


@pytest.mark.parametrize("length", [1.0, 1e3])
def test_the_size_of_a_gantry_decides_its_unit(tmp_path, length):
    """Its kinematics are the same in millimetres throughout, but not with one of the two in metres."""
    arm, _, frame, position = sliding_table(tmp_path, "gantry", units=("deg", "m" if length == 1 else "mm"))
    found = inspect(list((frame | {axis: length * column for axis, column in position.items()}).items()), arm)
    slides, tool = found.blocks
    assert slides.unit.choice == tool.unit.choice == ("m" if length == 1 else "mm")
    assert (slides.unit.reason, tool.unit.reason) == ("kinematics", "within_reach" if length == 1 else "beyond_reach")
    assert found.error < 1e-9
    alone = inspect(list(frame.items()), arm)
    assert alone.of("q").unit.choice == slides.unit.choice
    assert alone.of("q").unit.reason == tool.unit.reason


def test_velocities_and_forces_of_slides(tmp_path):
    arm, _, frame, position = sliding_table(tmp_path, "scara", trajectory=True)
    found = inspect(list((frame | position).items()), arm)
    names = dict(found.columns)
    assert [names[f"velocity_{k}"] for k in (0, 2)] == ["dq1_deg_per_s", "dq3_mm_per_s"]
    assert [names[f"torque_{k}"] for k in range(4)] == ["tau1_Nm", "tau2_Nm", "tau3_N", "tau4_Nm"]
    assert names["time"] == "time_s"
    assert found.motion[0] == "trajectory"
    rate = next(m for m in found.blocks if m.kind == "dq" and m.slides)
    assert rate.unit[1:3] == ("certain", "slope")
    assert rate.unit.numbers["unit"] == "m"
    recording = Recording.from_dataframe(frame | position, columns=found.columns, arm=arm)
    np.testing.assert_allclose(recording.joint_velocity[:, 2], 1.2 * np.cos(3 * recording.time), atol=1e-12)


def test_names_say_which_joints_are_slides(tmp_path):
    _, q, frame, _ = sliding_table(tmp_path, "scara")
    named = dict(zip(("J1_deg", "J2_deg", "J3_mm", "J4_deg"), frame.values(), strict=True))
    found = inspect(list(named.items()))
    assert found.columns == dict(zip(named, ("q1_deg", "q2_deg", "q3_mm", "q4_deg"), strict=True))
    assert {block.unit.reason for block in found.blocks} == {"name"}
    given = {name: f"q{k}_{'mm' if k == 3 else 'deg'}" for k, name in enumerate(frame, 1)}
    assert inspect(list(frame.items()), None, given).columns == given
    torques = {f"tau{k}_{'N' if k == 3 else 'Nm'}": q[:, 0] for k in range(1, 5)}
    assert inspect(list((named | torques).items())).columns["tau3_N"] == "tau3_N"


# ------------------------------------------------------------------ numbers that object

JOINTS = dict(zip((f"J{k}" for k in range(1, 7)), np.rad2deg(Q.T), strict=True))
POINT = dict(zip("XYZ", 1e3 * P.T, strict=True))


def turned(recording):
    """rad, by how much the orientations of a recording are off."""
    return (Rotation.from_quat(recording.quaternion, scalar_first=True).inv() * TURNED).magnitude()


@pytest.mark.parametrize("order", ["scalar first", "scalar last"])
def test_four_numbers_of_unit_length_are_a_quaternion(order):
    quaternion = TURNED.as_quat(scalar_first=order == "scalar first")
    frame = JOINTS | POINT | dict(zip(("Q1", "Q2", "Q3", "Q4"), quaternion.T, strict=True))
    found, recording = read(frame)
    assert found.of("q").columns == tuple(JOINTS)
    assert found.of("rotation").form[1:3] == ("certain", "kinematics")
    np.testing.assert_allclose(turned(recording), 0, atol=1e-7)
    other = inspect(list((frame | {"Q4": 5 * frame["Q4"]}).items()), LITE6)
    assert other.of("rotation") is None
    assert inspect(list(frame.items())).arm.name == "lite6"  # recognised with six joints


@pytest.mark.parametrize(
    ("rotation", "names"),
    [
        ("ZYX", ("yaw_deg", "pitch_deg", "roll_deg")),  # KUKA
        ("xyz", ("roll_deg", "pitch_deg", "yaw_deg")),  # Mitsubishi
        ("XYZ", ("rotx_deg", "roty_deg", "rotz_deg")),
        ("ZYZ", ("alpha_deg", "beta_deg", "gamma_deg")),
    ],
)
def test_kinematics_decide_what_a_b_c_are(rotation, names):
    frame = JOINTS | POINT | dict(zip("ABC", TURNED.as_euler(rotation, degrees=True).T, strict=True))
    found, recording = read(frame)
    assert tuple(found.columns[name] for name in "ABC") == names
    assert found.of("rotation").form[1:3] == ("certain", "kinematics")
    np.testing.assert_allclose(turned(recording), 0, atol=1e-7)


MATRICES = {
    "libfranka, by columns": ([f"O_T_EE[{k}]" for k in range(16)], np.swapaxes(POSES, 1, 2)),
    "by rows": ([f"pose_{k}" for k in range(12)], POSES[:, :3]),
    "by two indices": ([f"T{i}{j}" for i in range(4) for j in range(4)], POSES),
    "the rotation": ([f"R{i}{j}" for i in "123" for j in "123"], POSES[:, :3, :3]),
    "the rotation, by columns": ([f"rot_{k}" for k in range(9)], np.swapaxes(POSES[:, :3, :3], 1, 2)),
}


@pytest.mark.parametrize("case", MATRICES)
def test_matrices_are_read_in_the_order_in_which_they_are_poses(case):
    names, entries = MATRICES[case]
    frame = JOINTS | dict(zip(names, entries.reshape(ROWS, -1).T, strict=True))
    found, recording = read(frame | (POINT if len(names) == 9 else {}))
    np.testing.assert_allclose(recording.position, P, atol=1e-13)
    np.testing.assert_allclose(turned(recording), 0, atol=1e-7)
    assert found.of("rotation").form.sure == "certain"
    broken = dict(zip(names, np.random.default_rng(0).normal(size=(len(names), ROWS)), strict=True))
    assert inspect(list((JOINTS | broken).items()), LITE6).of("rotation") is None


ROOM = 21 + np.round(0.3 * np.sin(np.arange(ROWS) / 9), 1)
CLOCK = 0.1 * np.arange(ROWS)


@pytest.mark.parametrize("name", ["T_room", "T_amb", "T (°C)", "T_room_degC", "temp", "T/°C", "room_temperature", "T"])
@pytest.mark.parametrize("values", [ROOM, 20 + 0.01 * np.arange(ROWS)], ids=["repeats", "increases"])
def test_a_temperature_is_no_time(name, values):
    found = inspect(list((JOINTS | POINT | {name: values}).items()), LITE6)
    assert (found.of("time") is None) == (name != "T" or values is ROOM)
    assert found.denied == ({"T": "time"} if name == "T" and values is ROOM else {})
    assert found.motion[0] == "static" if found.of("time") is None else "trajectory"


def test_a_time_increases():
    few = np.r_[CLOCK[:20], CLOCK[22], CLOCK[20:22], CLOCK[23:]]
    anew = {"time": np.tile(CLOCK[:3], ROWS // 3), "run": np.repeat(np.arange(ROWS // 3, dtype=float), 3)}
    for frame, name in (({"timestamp": few}, "timestamp"), (anew, "time"), ({"Zeit [ms]": 1e3 * CLOCK}, "Zeit [ms]")):
        found = inspect(list((JOINTS | frame).items()), LITE6)
        assert found.of("time").columns == (name,)
    for values in (np.floor(CLOCK), CLOCK[::-1], np.ones(ROWS), anew["time"]):
        found = inspect(list((JOINTS | {"time": values, "time_s": values}).items()), LITE6)
        assert found.of("time") is None
        assert found.denied == {"time": "time", "time_s": "time"}
        assert found.columns["time"] == found.columns["time_s"] == "ignore"
    both = inspect(list((JOINTS | {"time": ROOM, "stamp": CLOCK}).items()), LITE6)
    assert both.of("time").columns == ("stamp",)


def test_motion_is_decided_with_what_is_given():
    frame = JOINTS | {"tick": 1e3 * CLOCK, "time": np.arange(ROWS) * 60.0}
    assert inspect(list(frame.items()), LITE6).motion[0] == "static"
    assert inspect(list(frame.items()), LITE6, {"tick": "time_ms"}).motion[0] == "trajectory"
    assert inspect(list(frame.items()), LITE6, {"time": "time_ms"}).motion[0] == "trajectory"
    ignored = inspect(list((JOINTS | {"time": CLOCK}).items()), LITE6, {"time": "ignore"})
    assert ignored.motion == ("static", "it has neither times nor velocities")
    assert inspect(list((JOINTS | {"time": CLOCK}).items()), LITE6, motion="static").motion == ("static", "as given")


# ------------------------------------------------------------------ whose pose it is

EXACT = six_parameter_poses(LITE6.kinematics, Q)


def two_poses(controller="robot_{}", sensor="tracker_{}", exact=EXACT, digits=6):
    frame = dict(
        zip((controller.format(axis) for axis in "xyz"), np.round(1e3 * exact[:, :3, 3].T, digits), strict=True)
    )
    angles = Rotation.from_matrix(exact[:, :3, :3]).as_rotvec().T
    frame |= dict(zip((controller.format(f"r{axis}") for axis in "xyz"), angles, strict=True))
    return JOINTS | frame | dict(zip((sensor.format(axis) for axis in "xyz"), P.T, strict=True))


@pytest.mark.parametrize(
    ("controller", "sensor"),
    [
        ("robot_{}", "tracker_{}"),
        ("tcp_{}", "{}_meas"),
        ("ee.{}", "/vicon/pose/{}"),
        ("flange {}", "tag_{}"),
        ("{}", "LT_{}"),
        ("{}_robot", "{}_tracker"),
        ("{}", "mocap_p{}"),
    ],
)
def test_the_source_of_the_poses_decides_which_are_read(controller, sensor):
    frame = two_poses(controller, sensor, exact=perturb(EXACT))
    for source, taken in (("laser_tracker", sensor), ("motion_capture", sensor), ("camera", sensor),
                          ("controller_fk", controller)):  # fmt: skip
        found = inspect(list(frame.items()), LITE6, pose_source=source)
        assert found.of("position").columns == tuple(taken.format(axis) for axis in "xyz")
        assert (found.of("rotation") is None) == (taken == sensor)  # never of the other source
        assert len(found.sources) == 2
        left = controller if taken == sensor else sensor
        assert found.columns[left.format("x")] == "ignore"
    for source in (None, "unknown"):
        found = inspect(list(frame.items()), LITE6, pose_source=source)
        assert found.undecided
        assert found.of("position") is found.of("rotation") is None
    found = inspect(list(frame.items()), LITE6, {controller.format("x"): "ignore"})
    assert found.of("position").columns[0] == sensor.format("x")
    assert found.of("rotation") is None
    given = {sensor.format(axis): f"{axis}_m" for axis in "xyz"}
    found = inspect(list(frame.items()), LITE6, given)
    assert found.of("position").columns == tuple(given)
    assert found.of("rotation") is None


def perturb(poses):
    """With the error of a controller that knows its own arm."""
    return six_parameter_poses(perturbed(np.random.default_rng(3), LITE6.kinematics), Q)


def test_a_pose_that_the_arm_reproduces_to_rounding_was_computed():
    """Whatever its name, and whatever is declared."""
    for digits in (2, 3, 6):
        frame = two_poses("{}", "foo_{}", digits=digits)
        found = inspect(list(frame.items()), LITE6, pose_source="camera")
        assert [source.computed for source in found.sources] == [True, False]
        assert [source.role for source in found.sources] == ["controller", None]
        assert found.of("position").columns[0] == "foo_x"
        assert not found.computed
        alone = inspect([item for item in frame.items() if "foo" not in item[0]], None)
        assert alone.computed
    noise = 1e-5 * np.random.default_rng(0).normal(size=P.shape)  # as the best trackers have
    measured_ = JOINTS | dict(zip("XYZ", 1e3 * (EXACT[:, :3, 3] + noise).T, strict=True))
    assert not inspect(list(measured_.items()), LITE6).computed
    one = JOINTS | dict(
        zip("XYZ", np.tile(P[:1], (ROWS, 1)).T, strict=True)
    )  # a point that was touched again and again
    assert not inspect(list(one.items()), LITE6).computed


# ------------------------------------------------------------------ joints that are no angles

SERVOS = tuple(f"{name}.pos" for name in ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"))


def test_percent_and_ticks_are_no_degrees():
    percent = np.random.default_rng(0).uniform(-100, 100, (ROWS, 5))
    for values, reason in ((percent, "percent"), (np.round(2048 + 20 * percent), "ticks")):
        frame = dict(zip(SERVOS, values.T, strict=True)) | {"gripper.pos": ROOM}
        unit = inspect(list(frame.items())).of("q").unit
        assert (unit.sure, unit.reason) == ("assumed", reason)
        given = {name: f"q{k}_deg" for k, name in enumerate(SERVOS, 1)}
        assert inspect(list(frame.items()), None, given).of("q").unit[:3] == ("deg", "certain", "name")
    for factor, unit in ((1.5, ("deg", "certain")), (0.02, ("rad", "likely"))):
        scaled = dict(zip(SERVOS, factor * percent.T, strict=True))
        assert inspect(list(scaled.items())).of("q").unit[:2] == unit
    state = {f"observation.state[{k}]": column for k, column in enumerate(percent.T)}
    assert inspect(list(state.items())).of("q").unit.reason == "percent"
    others = {f"joint_{k}": column for k, column in enumerate(percent.T)}
    assert inspect(list(others.items())).of("q").unit[:2] == ("deg", "likely")


# ------------------------------------------------------------------ any table

NAMES = """
q joint J A axis theta pos position x y z w qx qy qz qw rx ry roll pitch yaw a b c T t time temp R O_T_EE tcp tracker
tool pose quat rvec run payload ambient vel tau current observation.state action S L U B E 0 1 2 3 11 12 13 [mm] (deg)
_rad °C kg ms _s /s ü θ
"""
WORDS = NAMES.split()
ENDS = (range(6), "xyz", "xyzw", ("rx", "ry", "rz"), [f"{i}{j}" for i in range(3) for j in range(3)], range(16), ("",))


@pytest.mark.parametrize("seed", range(24))
def test_any_table_is_looked_at(seed):
    """What `init` makes of it is words and a sidecar, and the table is read with it or refused in one line."""
    rng = np.random.default_rng(seed)
    rows = int(rng.choice([1, 2, 9, 20]))
    kinds = (
        lambda: rng.normal(0, 10.0 ** rng.integers(-3, 4), rows),
        lambda: np.full(rows, rng.choice([0.0, 0.5, np.nan, np.inf, 1e300])),
        lambda: 0.1 * np.arange(rows),
        lambda: rng.integers(0, 4096, rows).astype(float),
        lambda: np.where(rng.random(rows) < 0.3, np.nan, rng.normal(size=rows)),
    )
    frame = {}
    for _ in range(rng.integers(1, 6)):
        stem = rng.choice(["_", " ", ".", "/", ""]).join(rng.choice(WORDS, rng.integers(1, 4)))
        for end in ENDS[rng.integers(len(ENDS))]:
            frame[f"{stem}{rng.choice(['', '_'])}{end}"] = kinds[rng.integers(len(kinds))]()
    text = [(str(name), None) for name in rng.choice(WORDS, 2) if name not in frame]
    found = inspect([*text, *frame.items()], LITE6 if seed % 2 else None)
    said = [
        *inspection_report(found, "run7.csv"),
        *next_steps(found, {}, "run7.csv"),
        sidecar_text(found, {}, "run7.csv"),
    ]
    assert yaml.safe_load(said[-1])["recording"] == {}
    if found.undecided:
        assert choice_of_pose(found).startswith(f"it holds {len(found.sources)} poses.")
    if found.of("q") is not None:
        table = RawTable.of_arrays(frame)
        columns = {name: own for name, own in found.columns.items() if name in frame}
        with contextlib.suppress(InputError):  # of an empty column, or joints of which one is missing
            tabulate(table, "run7.csv", [], renamed=columns)
