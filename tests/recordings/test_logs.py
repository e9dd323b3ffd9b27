"""Logs of ROS 1 and 2, by the package's own writers, and what is made of them."""

import sys

import numpy as np
import pytest
from domains.torque import slid
from scipy.spatial.transform import Rotation
from typed import unread

from lite6jax.arms.description import write_arm
from lite6jax.arms.files import read_arm
from lite6jax.calibration.source import read_source
from lite6jax.domains.torque.screening import screen_torques
from lite6jax.errors import InputError
from lite6jax.recordings import read_recording, recording_file
from lite6jax.recordings.ros import UR_JOINTS
from tests.logs import joints, poses, write
from tests.oracles import sliding_arms

pytest.importorskip("rosbags.rosbag2", reason="the package of the extra `rosbag` is not installed")


def test_joints_stand_at_the_poses_stamps(tmp_path):
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.008, 0.012, 60))
    at = np.sort(rng.uniform(t[0], t[-1], 25))
    q, dq, tau = rng.normal(size=(3, 60, 3))
    p, quaternion = rng.normal(size=(25, 3)), rng.normal(size=(25, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    names = ("arm_joint1", "arm_joint2", "arm_joint3")
    path = write(
        tmp_path / "run.mcap", {"/joint_states": joints(t, q, names, dq, tau), "/tool": poses(at, p, quaternion)}
    )
    recording = read_recording(path)

    # the stamps are whole nanoseconds: the oracle sees the same
    t, at = np.round(t * 1e9) / 1e9, np.round(at * 1e9) / 1e9
    np.testing.assert_allclose(recording.time, at - at[0], atol=1e-12)
    for found, wanted in ((recording.joint_position, q), (recording.joint_velocity, dq), (recording.joint_torque, tau)):
        oracle = np.stack([np.interp(at, t, column) for column in wanted.T], 1)
        np.testing.assert_allclose(found, oracle, atol=1e-9)
    np.testing.assert_array_equal(recording.position, p)
    np.testing.assert_allclose(np.abs(np.sum(recording.quaternion * quaternion, 1)), 1, atol=1e-14)
    assert recording.motion == "trajectory"
    assert recording.source == str(path)
    *others, joined, doubt = recording.notes
    assert doubt.startswith("joint states are too far apart to follow the motion")  # these are random
    assert joined.startswith("the joints are interpolated linearly to the times of the poses (between joint states at ")
    assert tuple(others) == (
        "joints of /joint_states by the numbers in their names: q1 is arm_joint1, q2 is arm_joint2, q3 is arm_joint3",
        "the efforts of /joint_states are taken as torques in N m: assumed, as they state no unit",
        "times are the header stamps of /joint_states, the header stamps of /tool",
    )


def test_poses_without_joints_around_them_are_dropped_and_counted(tmp_path):
    t = np.array([0.0, 0.1, 0.2, 0.3, 0.9, 1.0, 1.1])
    at = np.array([-0.05, 0.05, 0.25, 0.5, 0.6, 0.9, 1.05, 1.2])
    q = np.stack([t, t], 1)
    topics = {"/joint_states": joints(t, q), "/tool": poses(at, np.stack([at, at, at], 1))}
    recording = read_recording(write(tmp_path / "run.mcap", topics))
    np.testing.assert_allclose(recording.position[:, 0], [0.05, 0.25, 0.9, 1.05], atol=1e-12)
    np.testing.assert_allclose(recording.joint_position[:, 0], [0.05, 0.25, 0.9, 1.05], atol=1e-9)
    assert "dropped 2 poses before the first or after the last joint state" in recording.notes
    assert "dropped 2 poses between joint states over 2 median steps apart" in recording.notes


@pytest.mark.parametrize(
    ("names", "dof", "wanted", "order"),
    [
        (("joint10", "joint2", "joint1"), None, ["joint1", "joint2", "joint10"], "by the numbers in their names"),
        (("a2_joint_3", "a2_joint_1", "a2_joint_2"), 3, ["a2_joint_1", "a2_joint_2", "a2_joint_3"], "by the numbers"),
        (("finger", "joint2", "joint1"), None, ["joint1", "joint2"], "by the numbers in their names"),
        (("gripper_1", "joint2", "joint1"), 2, ["joint1", "joint2"], "by the numbers in their names"),
        (("waist", "joint_3", "joint_2"), None, ["waist", "joint_3", "joint_2"], "in order of appearance"),
        (("waist", "arm", "wrist"), 3, ["waist", "arm", "wrist"], "in order of appearance"),
        (
            tuple(sorted(f"{part}_joint" for part in UR_JOINTS)),
            6,
            [f"{part}_joint" for part in UR_JOINTS],
            "in the order of Universal Robots' arms",
        ),
    ],
)  # fmt: skip
def test_joints_are_put_in_order(tmp_path, names, dof, wanted, order):
    t = np.arange(4) / 10
    q = 0.1 * np.arange(len(names)) + 0 * t[:, None]
    topics = {"/joint_states": joints(t, q, names), "/tool": poses(t, np.outer(t, [1, 2, 3]))}
    recording = read_recording(write(tmp_path / "run.mcap", topics), dof=dof)
    np.testing.assert_array_equal(recording.joint_position[0], [q[0, names.index(name)] for name in wanted])
    said = ", ".join(f"q{i + 1} is {name}" for i, name in enumerate(wanted))
    assert recording.notes[0].startswith(f"joints of /joint_states {order}")
    assert said in recording.notes[0]
    if len(wanted) < len(names):
        assert recording.notes[0].endswith(f"; left out: {names[0]}")


def test_topics_are_named_where_there_are_several(tmp_path):
    t = np.arange(5) / 10
    topics = {
        "/left/joint_states": joints(t, np.stack([t, t], 1)),
        "/right/joint_states": joints(t, np.stack([-t, -t], 1)),
        "/left/tool": poses(t, np.outer(t, [1, 0, 0])),
        "/right/tool": poses(t, np.outer(t, [0, 1, 0])),
    }
    path = write(tmp_path / "run.mcap", topics)
    recording = read_recording(f"{path}#/right/joint_states,/left/tool")
    np.testing.assert_allclose(recording.joint_position[:, 0], -t, atol=1e-9)
    np.testing.assert_allclose(recording.position, np.outer(t, [1, 0, 0]), atol=1e-12)
    assert recording.source == str(path)
    assert recording.motion == "trajectory"  # the sidecar is that of the file

    only = read_recording(f"{path}#/left/joint_states")  # a motion to be predicted
    assert only.position is None
    np.testing.assert_allclose(only.joint_position[:, 0], t, atol=1e-12)

    assert unread(path) == (
        "has 2 topics of sensor_msgs/JointState: /left/joint_states, /right/joint_states; choose, as in "
        "run.mcap#/left/joint_states,/left/tool"
    )
    assert unread(f"{path}#/left/joint_states,/left/tool,/right/tool") == (
        "has 2 topics of geometry_msgs/PoseStamped: /left/tool, /right/tool; choose, as in "
        "run.mcap#/left/joint_states,/left/tool"
    )
    assert unread(f"{path}#/left/joint_states,/middle").startswith(
        "no topic /middle of sensor_msgs/JointState or geometry_msgs/PoseStamped; it has /left/joint_states "
        "(sensor_msgs/JointState), /left/tool (geometry_msgs/PoseStamped), "
    )


def test_efforts_are_torques_without_poses_too(tmp_path):
    t = np.arange(5) / 10
    q, tau = np.stack([t, -t], 1), np.stack([3 + t, 1 - t], 1)
    path = write(tmp_path / "run.mcap", {"/joint_states": joints(t, q, efforts=tau)})
    for name in (f"{path}#/joint_states", path):
        recording = read_recording(name)
        np.testing.assert_array_equal(recording.torques(), tau)
        assert recording.position is None
    assert recording.notes[3] == "there are no poses: /joint_states is read for its efforts, as run.mcap#/joint_states"
    two = {f"/{side}/joint_states": joints(t, q, efforts=tau) for side in ("left", "right")}
    assert unread(write(path, two)).startswith("has 2 topics of sensor_msgs/JointState: /left/joint_states, /right")


def test_clocks_that_do_not_overlap(tmp_path):
    t = np.arange(5) / 10
    topics = {"/joint_states": joints(t, np.stack([t, t], 1)), "/tool": poses(t + 100, np.outer(t, [1, 0, 0]))}
    assert unread(write(tmp_path / "run.mcap", topics)) == (
        "no pose lies between joint states (joints 0.000 to 0.400 s, poses 100.000 to 100.400 s); stamp both by one "
        "clock"
    )


def sliding_log(folder, names=("joint1", "joint2", "joint3"), sidecar=None):
    """Joint states of the telescope without poses: rad and Nm, but m and N of its third joint."""
    t, q, dq, ddq = slid.moved(seconds=3.0)
    efforts = slid.exerted(q, dq, ddq)
    order = np.argsort(names)  # as a joint_state_broadcaster publishes them
    topic = joints(t, q[:, order], [names[k] for k in order], dq[:, order], efforts[:, order])
    write(folder / "run.mcap", {"/joint_states": topic}, sidecar=sidecar)
    return f"{folder}/run.mcap#/joint_states", (t, q, dq, efforts)


def test_a_prismatic_joint_is_in_metres_and_newtons(tmp_path):
    write_arm(slid.arm(), tmp_path / "telescope.yaml")
    path, (_, q, dq, efforts) = sliding_log(tmp_path, sidecar="recording: {arm: telescope.yaml, motion: trajectory}\n")
    declared = read_recording(path)
    assert declared.sliding == (2,)
    assert {"q2_rad", "q3_m", "dq3_m_per_s", "tau2_Nm", "tau3_N"} <= declared.columns().keys()
    assert "positions of joint3 are taken as lengths in m: prismatic joints of the arm" in declared.notes
    forces = "the efforts of /joint_states are taken as torques in N m, those of joint3 as forces in N"
    assert f"{forces}: assumed, as they state no unit" in declared.notes
    for found in (declared, read_source(path, slid.arm())):
        np.testing.assert_allclose(found.joint_position, q, atol=1e-12)
        np.testing.assert_allclose(found.joint_velocity, dq, atol=1e-12)
        np.testing.assert_allclose(found.torques(), efforts, atol=1e-12)
        assert screen_torques(found, slid.arm()).data.arm.sliding == (2,)  # accepted as one of this arm
    (tmp_path / "run.yaml").unlink()
    with pytest.raises(InputError, match="name the column q3_m or q3_mm, or declare the arm in the sidecar of a log"):
        screen_torques(read_recording(path), slid.arm())


RAIL = sliding_arms.ARMS["rail"]
NAMES = ("rail", "waist", "shoulder", "elbow", "roll", "pitch", "flange")


def test_joints_are_in_the_order_of_the_arm_that_names_them(tmp_path):
    text = RAIL
    for number, name in enumerate(NAMES, 1):
        text = text.replace(f'name="j{number}"', f'name="{name}"')
    (tmp_path / "rail.urdf").write_text(text)
    there = sorted((*NAMES, "gripper"))  # the rail, on which all others stand, is none of the first
    q = np.linspace(0.0, 0.1, 20)[:, None] + np.arange(8)
    path = write(tmp_path / "run.mcap", {"/joint_states": joints(np.arange(20) / 10, q, there)}, sidecar=None)
    found = read_source(f"{path}#/joint_states", read_arm(str(tmp_path / "rail.urdf")))
    assert found.sliding == (0,)
    np.testing.assert_allclose(found.joint_position, q[:, [there.index(name) for name in NAMES]], atol=1e-12)
    (note,) = (note for note in found.notes if note.startswith("joints of"))
    assert note.startswith("joints of /joint_states by the names of the arm's joints: q1 is rail, q2 is waist, ")
    assert note.endswith("left out: gripper")


# ------------------------------------------------------------------ kinds of logs


T = np.arange(8) / 10
Q = np.stack([1 + T, 2 - 3 * T], 1)
AT = T[:-1] + 0.05
P = np.stack([AT, 2 * AT, 3 * AT], 1)
TURNED = Rotation.from_rotvec(np.outer(AT, [1.0, 0.2, -0.4]))


def topics_of(kind="PoseStamped", frames=("marker",)):
    """Joint states, whose joints are not in order, and poses."""
    measured = poses(AT, P, TURNED.as_quat(scalar_first=True), kind, frames)
    topic = {"PoseStamped": "/tracker", "TransformStamped": "/vicon", "TFMessage": "/tf"}[kind]
    return {"/joint_states": joints(T, Q[:, ::-1], ("joint2", "joint1")), topic: measured}


def holds_the_motion(recording):
    np.testing.assert_allclose(recording.joint_position, np.stack([1 + AT, 2 - 3 * AT], 1), atol=1e-9)
    np.testing.assert_allclose(recording.position, P, atol=1e-12)
    turned = Rotation.from_quat(recording.quaternion, scalar_first=True)
    np.testing.assert_allclose((turned.inv() * TURNED).magnitude(), 0, atol=1e-7)
    np.testing.assert_allclose(recording.time, AT - AT[0], atol=1e-9)


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
@pytest.mark.parametrize("kind", ["PoseStamped", "TransformStamped", "TFMessage"])
def test_folders_of_ros_2(tmp_path, plugin, kind):
    path = write(tmp_path / "run7", topics_of(kind), plugin=plugin)
    recording = read_recording(path)
    holds_the_motion(recording)
    assert recording_file(path) == path
    assert recording.source == str(path)
    assert recording.settings.motion == "trajectory"
    assert any("robot_state_publisher" in note for note in recording.notes) == (kind == "TFMessage")


def test_frames_of_tf_are_named(tmp_path):
    path = write(tmp_path / "run7", topics_of("TFMessage", ("base", "marker")))
    assert unread(path) == (
        "topic /tf has 2 transforms: base in world, marker in world; choose the frame that was measured, as in "
        "run7#/joint_states,/tf:base"
    )
    recording = read_recording(f"{path}#/joint_states,/tf:marker")
    np.testing.assert_allclose(recording.position, P + 1, atol=1e-12)
    assert unread(f"{path}#/joint_states,/tf:tool") == (
        "topic /tf has no transform to tool; it has base in world, marker in world"
    )
    assert read_recording(f"{path}#/joint_states").position is None


def test_folders_that_are_damaged_and_packages_that_are_missing(tmp_path, monkeypatch):
    path = write(tmp_path / "run7", topics_of())
    (part,) = path.glob("*.db3")
    part.write_bytes(part.read_bytes()[:5000])
    assert unread(path).startswith("is no bag, truncated or damaged (")
    (path / "metadata.yaml").write_text("{")
    assert unread(path).startswith("is no bag, truncated or damaged (")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    assert unread(path) == "bags take the package rosbags; pip install 'lite6jax[rosbag]'"
