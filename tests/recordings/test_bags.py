"""Bags as ROS writes them, by the package's own writers: SQLite and MCAP folders of ROS 2, files of ROS 1."""

import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lite6jax.arms.arm import Arm
from lite6jax.errors import InputError
from lite6jax.recordings import read_recording, recording_file
from lite6jax.recordings.files import split_topics

rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="the package of the extra `rosbag` is not installed")
rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="the package of the extra `rosbag` is not installed")
typesys = pytest.importorskip("rosbags.typesys", reason="the package of the extra `rosbag` is not installed")

STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
STORE1 = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
START = 1_760_000_000_123_456_789
T = np.arange(8) / 10
Q = np.stack([1 + T, 2 - 3 * T], 1)
AT = T[:-1] + 0.05
P = np.stack([AT, 2 * AT, 3 * AT], 1)
TURNED = Rotation.from_rotvec(np.outer(AT, [1.0, 0.2, -0.4]))


def messages(store):
    """What makes messages of a typestore: headers, joint states, poses, transforms."""
    types = store.types
    header = types["std_msgs/msg/Header"]
    stamp = types["builtin_interfaces/msg/Time"]

    def headed(t, frame="world"):
        ns = START + round(t * 1e9)
        extra = {"seq": 0} if "seq" in header.__dataclass_fields__ else {}
        return header(stamp=stamp(sec=ns // 10**9, nanosec=ns % 10**9), frame_id=frame, **extra)

    def joints(t, q):
        empty = np.array([])
        return types["sensor_msgs/msg/JointState"](
            header=headed(t), name=["joint2", "joint1"], position=np.array(q[::-1]), velocity=empty, effort=empty
        )

    def vector(kind, p):
        return types[f"geometry_msgs/msg/{kind}"](**dict(zip("xyz", map(float, p), strict=True)))

    def turn(r):
        return types["geometry_msgs/msg/Quaternion"](**dict(zip("xyzw", map(float, r.as_quat()), strict=True)))

    def pose(t, p, r):
        inner = types["geometry_msgs/msg/Pose"](position=vector("Point", p), orientation=turn(r))
        return types["geometry_msgs/msg/PoseStamped"](header=headed(t), pose=inner)

    def transform(t, p, r, child="marker"):
        inner = types["geometry_msgs/msg/Transform"](translation=vector("Vector3", p), rotation=turn(r))
        kind = types["geometry_msgs/msg/TransformStamped"]
        return kind(header=headed(t), child_frame_id=child, transform=inner)

    def tf(*transforms):
        return types["tf2_msgs/msg/TFMessage"](transforms=list(transforms))

    return joints, pose, transform, tf


def topics_of(store, poses="pose", frames=("marker",)):
    """Topic to (time, message) pairs."""
    joints, pose, transform, tf = messages(store)
    found = {"/joint_states": [(t, joints(t, q)) for t, q in zip(T, Q, strict=True)]}
    measured = list(zip(AT, P, TURNED, strict=True))
    if poses == "pose":
        found["/tracker"] = [(t, pose(t, p, r)) for t, p, r in measured]
    elif poses == "transform":
        found["/vicon"] = [(t, transform(t, p, r)) for t, p, r in measured]
    else:
        moved = [(t, tf(*(transform(t, p + k, r, child) for k, child in enumerate(frames)))) for t, p, r in measured]
        found["/tf"] = moved
    return found


def bag2(path, topics, plugin="SQLITE3"):
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[plugin]) as writer:
        for topic, content in topics.items():
            kind = content[0][1].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for t, message in content:
                writer.write(connection, START + round(t * 1e9), STORE.serialize_cdr(message, kind))
    return path


def bag1(path, topics):
    with rosbag1.Writer(path) as writer:
        for topic, content in topics.items():
            kind = content[0][1].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=STORE1)
            for t, message in content:
                writer.write(connection, START + round(t * 1e9), STORE1.serialize_ros1(message, kind))
    return path


def refusal(path):
    with pytest.raises(InputError) as caught:
        read_recording(path)
    file, _ = split_topics(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{file}: ")
    return str(caught.value).removeprefix(f"{file}: ")


def holds_the_motion(recording):
    np.testing.assert_allclose(recording.joint_position, np.stack([1 + AT, 2 - 3 * AT], 1), atol=1e-9)
    np.testing.assert_allclose(recording.position, P, atol=1e-12)
    turned = Rotation.from_quat(recording.quaternion, scalar_first=True)
    np.testing.assert_allclose((turned.inv() * TURNED).magnitude(), 0, atol=1e-7)
    np.testing.assert_allclose(recording.time, AT - AT[0], atol=1e-9)


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
@pytest.mark.parametrize("poses", ["pose", "transform", "tf"])
def test_folders_of_ros_2(tmp_path, plugin, poses):
    path = bag2(tmp_path / "run7", topics_of(STORE, poses), plugin)
    (tmp_path / "run7.yaml").write_text("recording: {motion: trajectory}\n")
    recording = read_recording(path)
    holds_the_motion(recording)
    assert recording_file(path) == path
    assert recording.source == str(path)
    assert recording.settings.motion == "trajectory"
    assert any("robot_state_publisher" in note for note in recording.notes) == (poses == "tf")


def test_a_file_of_ros_1(tmp_path):
    path = bag1(tmp_path / "run7.bag", topics_of(STORE1))
    path.with_suffix(".yaml").write_text("recording: {motion: trajectory}\n")
    holds_the_motion(read_recording(path))
    path.write_bytes(path.read_bytes()[:3000])
    assert refusal(path).startswith("is no bag, truncated or damaged (")


def test_a_file_within_a_folder_needs_no_metadata(tmp_path):
    path = bag2(tmp_path / "run7", topics_of(STORE))
    (part,) = path.glob("*.db3")
    part.with_suffix(".yaml").write_text("recording: {motion: trajectory}\n")
    holds_the_motion(read_recording(part))
    (path / "metadata.yaml").unlink()
    holds_the_motion(read_recording(part))
    (path / "run7_1.db3").write_bytes(part.read_bytes())
    assert refusal(path) == "a rosbag2 without metadata.yaml; write that with `ros2 bag reindex run7`"


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_a_folder_whose_recorder_was_ended_is_read_by_its_file(tmp_path, plugin):
    path = bag2(tmp_path / "run7", topics_of(STORE), plugin)
    (path / "metadata.yaml").unlink()
    holds_the_motion(read_recording(path))


def test_frames_of_tf_are_named(tmp_path):
    path = bag2(tmp_path / "run7", topics_of(STORE, "tf", ("base", "marker")))
    assert refusal(path) == (
        "topic /tf has 2 transforms: base in world, marker in world; choose the frame that was measured, as in "
        "run7#/joint_states,/tf:base"
    )
    recording = read_recording(f"{path}#/joint_states,/tf:marker")
    np.testing.assert_allclose(recording.position, P + 1, atol=1e-12)
    assert refusal(f"{path}#/joint_states,/tf:tool") == (
        "topic /tf has no transform to tool; it has base in world, marker in world"
    )
    assert read_recording(f"{path}#/joint_states").position is None


def test_the_name_of_a_frame_may_have_colons_and_slashes(tmp_path):
    path = bag2(tmp_path / "run7", topics_of(STORE, "tf", ("tag36h11:7", "tag36h11:8/left:x")))
    for k, child in enumerate(("tag36h11:7", "tag36h11:8/left:x")):
        recording = read_recording(f"{path}#/joint_states,/tf:{child}")
        np.testing.assert_allclose(recording.position, P + k, atol=1e-12)
    assert "has no transform to tag36h11:9; it has tag36h11:7 in" in refusal(f"{path}#/joint_states,/tf:tag36h11:9")


def test_folders_that_are_damaged_and_packages_that_are_missing(tmp_path, monkeypatch):
    path = bag2(tmp_path / "run7", topics_of(STORE))
    (part,) = path.glob("*.db3")
    part.write_bytes(part.read_bytes()[:5000])
    assert refusal(path).startswith("is no bag, truncated or damaged (")
    (path / "metadata.yaml").write_text("{")
    assert refusal(path).startswith("is no bag, truncated or damaged (")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    assert refusal(path) == "bags take the package rosbags; pip install 'lite6jax[rosbag]'"


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP", None])
def test_a_prismatic_joint_of_the_arm_is_in_metres(tmp_path, plugin):
    if plugin is None:
        path = bag1(tmp_path / "run.bag", topics_of(STORE1))
    else:
        path = bag2(tmp_path / "run", topics_of(STORE), plugin)
    arm = Arm("lift", np.array([[0, 0, 0.2, 0, 0, 0], [0.3, 0, 0, 0, 0, 0]], float), sliding=(0,))
    found = read_recording(path, arm=arm)
    assert found.sliding == (0,)
    assert {"q1_m", "q2_rad"} <= found.columns().keys()
    np.testing.assert_allclose(found.joint_position, np.stack([1 + AT, 2 - 3 * AT], 1), atol=1e-9)
    assert read_recording(path).sliding == ()
