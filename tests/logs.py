"""Logs of ROS as the package rosbags writes them: SQLite and MCAP folders and files of ROS 2, files of ROS 1."""

import shutil
from typing import NamedTuple

import numpy as np

START = 1_760_000_000_123_456_789  # an epoch time whose nanoseconds no float holds
SECOND = 1_000_000_000
SIDECAR = "recording: {motion: trajectory}\n"


class Topic(NamedTuple):
    """Messages of one topic: stamps and log times in ns after START, and what they say."""

    kind: str
    stamp: list
    messages: list
    logged: list | None = None


def joints(times, positions, names=("joint1", "joint2"), velocities=None, efforts=None, **rest):
    """A topic of joint states at times in s."""
    rows = []
    for k, position in enumerate(positions):
        velocity = [] if velocities is None else list(velocities[k])
        effort = [] if efforts is None else list(efforts[k])
        rows.append({"name": list(names), "position": list(position), "velocity": velocity, "effort": effort})
    return Topic("sensor_msgs/msg/JointState", [round(t * SECOND) for t in times], rows, **rest)


def poses(times, positions, quaternions=None, kind="PoseStamped", frames=("",), **rest):
    """A topic of poses or transforms at times in s; quaternions scalar first."""
    if quaternions is None:
        quaternions = [[np.cos(a), np.sin(a), 0, 0] for a in np.linspace(0, 0.5, len(positions))]
    rows = [(np.array(p, float), np.array(q, float)) for p, q in zip(positions, quaternions, strict=True)]
    kind = f"geometry_msgs/msg/{kind}" if kind != "TFMessage" else "tf2_msgs/msg/TFMessage"
    return Topic(kind, [round(t * SECOND) for t in times], [{"pose": row, "frames": frames} for row in rows], **rest)


CONTROLLER_STATE = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint {commanded}
trajectory_msgs/JointTrajectoryPoint {measured}
trajectory_msgs/JointTrajectoryPoint error
"""
"""The parts of the state of a trajectory controller that are written here; their names differ by version."""


def _point(types, positions, velocities=()):
    empty = np.zeros(0)
    name = "builtin_interfaces/msg/Duration"
    span = types[name](sec=0, nanosec=0)
    return types["trajectory_msgs/msg/JointTrajectoryPoint"](
        positions=np.array(positions, float),
        velocities=np.array(velocities, float),
        accelerations=empty,
        effort=empty,
        time_from_start=span,
    )


def _message(types, kind, stamp, said):
    """A message of a typestore."""
    header = types["std_msgs/msg/Header"]
    extra = {"seq": 0} if "seq" in header.__dataclass_fields__ else {}
    time = types["builtin_interfaces/msg/Time"](sec=stamp // SECOND, nanosec=stamp % SECOND)
    headed = header(stamp=time, frame_id="world", **extra)
    if kind.endswith("JointState"):
        numbers = {field: np.array(said[field], float) for field in ("position", "velocity", "effort")}
        return types[kind](header=headed, name=said["name"], **numbers)

    if kind.endswith("Float64MultiArray"):
        layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        return types[kind](layout=layout, data=np.array(said["data"], float))
    if kind.endswith("JointTrajectory"):
        points = [_point(types, *point) for point in said["points"]]
        return types[kind](header=headed, joint_names=said["joint_names"], points=points)
    if kind.endswith("ControllerState"):
        points = {name: _point(types, positions) for name, positions in said.items() if name != "joint_names"}
        return types[kind](header=headed, joint_names=said["joint_names"], error=_point(types, []), **points)

    def vector(part, p):
        return types[f"geometry_msgs/msg/{part}"](x=float(p[0]), y=float(p[1]), z=float(p[2]))

    position, (w, x, y, z) = said["pose"]
    turn = types["geometry_msgs/msg/Quaternion"](x=float(x), y=float(y), z=float(z), w=float(w))
    if kind.endswith("PoseStamped"):
        pose = types["geometry_msgs/msg/Pose"](position=vector("Point", position), orientation=turn)
        return types[kind](header=headed, pose=pose)
    transforms = [
        types["geometry_msgs/msg/TransformStamped"](
            header=headed,
            child_frame_id=child,
            transform=types["geometry_msgs/msg/Transform"](translation=vector("Vector3", position + k), rotation=turn),
        )
        for k, child in enumerate(said["frames"])
    ]
    return types[kind](transforms=transforms) if kind.endswith("TFMessage") else transforms[0]


def write(path, topics, stamped=True, sidecar=SIDECAR, plugin=None):
    """A log in order of time, by the suffix: a folder of ROS 2 (none), a file within it (`.mcap`), or one of ROS 1.

    Without `stamped` the headers are zero and only the log knows the time. `plugin` is that of a folder.
    """
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    first = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    for one in topics.values():
        if one.kind.endswith("ControllerState"):
            commanded, measured = (name for name in one.messages[0] if name != "joint_names")
            text = CONTROLLER_STATE.format(commanded=commanded, measured=measured)
            store.register(get_types_from_msg(text, one.kind))
    rows = [
        (log, topic, kind, _message(store.types, kind, START + stamp if stamped else 0, said))
        for topic, (kind, stamps, messages, logged) in topics.items()
        for stamp, log, said in zip(stamps, logged or stamps, messages, strict=True)
    ]
    folder = path if first else path.with_suffix("")
    plugin = rosbag2.StoragePlugin[plugin or ("MCAP" if path.suffix == ".mcap" else "SQLITE3")]
    with rosbag1.Writer(path) if first else rosbag2.Writer(folder, version=9, storage_plugin=plugin) as writer:
        found = {topic: writer.add_connection(topic, one.kind, typestore=store) for topic, one in topics.items()}
        serialise = store.serialize_ros1 if first else store.serialize_cdr
        for log, topic, kind, message in sorted(rows, key=lambda row: row[0]):
            writer.write(found[topic], START + log, serialise(message, kind))
    if path.suffix == ".mcap":
        (part,) = folder.glob("*.mcap")
        part.replace(path)
        shutil.rmtree(folder)
    if sidecar:
        path.with_suffix(".yaml").write_text(sidecar)
    return path
