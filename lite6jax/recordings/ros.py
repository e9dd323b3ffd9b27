"""Logs of ROS, which the package rosbags reads: joint states and stamped poses or transforms as one table."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm, joint_unit
from lite6jax.errors import InputError
from lite6jax.recordings.columns import PLACE, QUATERNION, spelled
from lite6jax.recordings.streams import join, said_of

Array = NDArray[np.floating]

JOINT_STATE = "sensor_msgs/JointState"
POSE_STAMPED = "geometry_msgs/PoseStamped"
TRANSFORM = "geometry_msgs/TransformStamped"
TF = "tf2_msgs/TFMessage"
"""Of whose transforms poses are taken only where no topic has the others, or by name."""
UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Along Universal Robots' arms, whose drivers publish them in alphabetical order."""
METADATA = "metadata.yaml"
"""In the folder of a rosbag2."""
_SHOWN = 8


class ArmJoints(NamedTuple):
    """What an arm says of its joints and joint states do not.

    Attributes:
        dof: how many; None where the arm is not known.
        sliding: those that are prismatic, counted from 0, whose positions are in m and efforts in N.
        names: along the arm; empty where they are not known.
    """

    dof: int | None = None
    sliding: tuple[int, ...] = ()
    names: tuple[str, ...] = ()

    @classmethod
    def of(cls, arm: "Arm | ArmJoints | None") -> "ArmJoints":
        """Of an arm, or of none; these as they are."""
        if isinstance(arm, Arm):
            return cls(arm.dof, arm.sliding, arm.joint_names)
        return cls() if arm is None else arm


class _Topic(NamedTuple):
    """A topic, and of transforms the frame whose poses are wanted; None where there is only one."""

    topic: str
    child: str | None = None

    @property
    def name(self) -> str:
        return self.topic + (f":{self.child}" if self.child else "")


class _Series(NamedTuple):
    """Messages of one topic in the order of the log, their stamps in ns, and by what clock they are stamped."""

    messages: list[Any]
    stamp: NDArray[np.int64]
    clock: str


def read_bag(path: Path, topics: Sequence[str], of_arm: ArmJoints, notes: list[str]) -> dict[str, Array]:
    """The table of a rosbag2 folder, a `.mcap` or `.db3` file, or a ROS 1 `.bag`: a row per pose.

    The joints are interpolated to its stamp (`streams.join`). They are named q1 … qN by the names of the arm's joints,
    along Universal Robots' arm, by the numbers in their names, or in order of appearance. Positions of prismatic joints
    are in m. Times count from the first row. Velocities and efforts are taken along where every message has them.
    Efforts of the only joint states are read without poses.

    Args:
        path: of the log.
        topics: of the joint states and of the poses, where there are several of a type; `/tf:tool0` for the poses of a
            frame; of the joint states alone for a motion without poses; none where the types decide.
        of_arm: what is known of the arm's joints, to put them in order and to leave a gripper's out.
        notes: what was chosen, assumed and dropped is added here.

    Returns:
        SI column name to `(sample,)` values.

    Raises:
        InputError: the package rosbags is missing, the log is damaged or of another kind, topics are missing or
            several, or poses and joint states do not overlap in time.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(f"{path}: bags take the package rosbags; pip install 'lite6jax[rosbag]'") from error
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            types = {
                connection.topic: str(connection.msgtype).replace("/msg/", "/") for connection in reader.connections
            }
            joints, poses = _choose(path, dict(sorted(types.items())), topics)
            messages: dict[str, list[tuple[Any, int, int]]] = {
                choice.topic: [] for choice in (joints, poses) if choice is not None
            }
            connections = [connection for connection in reader.connections if connection.topic in messages]
            for connection, logged, content in reader.messages(connections=connections):
                message: Any = reader.deserialize(content, connection.msgtype)
                for part in getattr(message, "transforms", [message]):
                    stamp = part.header.stamp
                    header = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
                    messages[connection.topic].append((part, header, logged))
    except InputError:
        raise
    except Exception as error:  # the package raises whatever the damaged bytes lead to
        problem = " ".join(f"{type(error).__name__} {error}".split())[:100]
        tool = {".mcap": "recover what is left with `mcap recover`", ".bag": "check it with `rosbag info`"}
        remedy = tool.get(path.suffix.lower(), "recover what is left with `ros2 bag reindex`")
        raise InputError(f"{path}: is no bag, truncated or damaged ({problem}); {remedy}, or record again") from error
    moved = _series(path, joints, messages[joints.topic])
    measured = None if poses is None else _series(path, poses, messages[poses.topic])
    stamp, columns = _joint_states(path, joints.topic, moved, of_arm, notes)
    clock_note = f"times are {moved.clock} of {joints.topic}"
    notes.append(clock_note + (f", {measured.clock} of {poses.name}" if poses and measured else ""))
    if poses is None or measured is None:
        if not topics and not any(name.startswith("tau") for name in columns):
            raise InputError(
                f"{path}: has no topic of {POSE_STAMPED}; {_topics_of(types)}; record one with these types, or name "
                f"{path.name}#{joints.name} for a motion or torques without poses"
            )
        if not topics:
            notes.append(f"there are no poses: {joints.topic} is read for its efforts, as {path.name}#{joints.name}")
        return {"time_s": _seconds(stamp, stamp[0]), **columns}
    if types[poses.topic] == TF:
        parent, child = _frames(measured.messages[0])
        notes.append(
            f"the poses are those of {child} in {parent} on {poses.topic}; a robot_state_publisher computes such "
            "transforms from the joints, which measures nothing"
        )
    inside, columns = _at_poses(path, stamp, columns, measured.stamp, notes)
    at = measured.stamp[inside]
    position, quaternion = (part[inside] for part in _poses(measured.messages))
    table = {"time_s": _seconds(at, at[0]), **columns, **dict(zip(map(spelled, PLACE), position.T, strict=True))}
    if (quaternion == quaternion[0]).all() and len(measured.messages) > 1:
        notes.append(f"the orientations of {poses.name} never change: they are taken as not measured")
        return table
    return table | dict(zip(QUATERNION, quaternion.T, strict=True))


# ------------------------------------------------------------------ topics


def _choose(path: Path, types: Mapping[str, str], topics: Sequence[str]) -> tuple[_Topic, _Topic | None]:
    """The topics of the joint states and of the poses; None for poses where only joint states are there, or named."""
    available = _topics_of(types)
    chosen = []
    for name in topics:
        topic, mark, child = name.partition(":")  # a topic has no colon, and the name of a frame may
        chosen.append(_Topic(topic, child) if mark and types.get(topic) == TF else _Topic(name))
        if types.get(chosen[-1].topic) not in (JOINT_STATE, POSE_STAMPED, TRANSFORM, TF):
            raise InputError(
                f"{path}: no topic {name} of {JOINT_STATE} or {POSE_STAMPED}; {available}; name those to be read"
            )
    candidates = chosen or [_Topic(topic) for topic in types]
    joints = [choice for choice in candidates if types[choice.topic] == JOINT_STATE]
    poses = [choice for choice in candidates if types[choice.topic] in (POSE_STAMPED, TRANSFORM)]
    poses = poses or [
        choice for choice in candidates if types[choice.topic] == TF and (topics or choice.topic != "/tf_static")
    ]
    if not joints:
        raise InputError(f"{path}: has no topic of {JOINT_STATE}; {available}; record one with these types")
    pair = ",".join(choice.name for choice in (*joints[:1], *poses[:1]))
    for listed in (joints, poses):
        if len(listed) > 1:
            raise InputError(
                f"{path}: has {len(listed)} topics of {types[listed[0].topic]}: "
                f"{', '.join(choice.name for choice in listed)}; choose, as in {path.name}#{pair}"
            )
    return joints[0], poses[0] if poses else None


def _topics_of(types: Mapping[str, str]) -> str:
    shown = _listed([f"{topic} ({kind or 'no type'})" for topic, kind in sorted(types.items())], " and {} more")
    return f"it has {shown}" if types else "it has no topics at all"


def _listed(parts: Sequence[str], more: str = ", and {} more") -> str:
    return ", ".join(parts[:_SHOWN]) + (more.format(len(parts) - _SHOWN) if len(parts) > _SHOWN else "")


def _series(path: Path, chosen: _Topic, messages: list[tuple[Any, int, int]]) -> _Series:
    """The messages of a topic with their stamps: the headers', or the log's where no header has any.

    Raises:
        InputError: there are none, or transforms to several frames of which none is chosen.
    """
    if not messages:
        raise InputError(f"{path}: topic {chosen.topic} has no messages; record again")
    pairs = list(dict.fromkeys(_frames(part) for part, _, _ in messages if not hasattr(part, "name")))
    listed = _listed([f"{child} in {parent}" for parent, child in pairs])
    if chosen.child is not None:
        messages = [entry for entry in messages if _frames(entry[0])[1] == chosen.child]
        parents = [parent for parent, child in pairs if child == chosen.child]
        if len(parents) != 1:
            problem = f"no transform to {chosen.child}" if not parents else f"{chosen.child} in {', '.join(parents)}"
            raise InputError(f"{path}: topic {chosen.topic} has {problem}; it has {listed}")
    elif len(pairs) > 1:
        raise InputError(
            f"{path}: topic {chosen.topic} has {len(pairs)} transforms: {listed}; choose the "
            f"frame that was measured, as in {path.name}#/joint_states,{chosen.topic}:{pairs[0][1]}"
        )
    stamped = any(header for _, header, _ in messages)
    clock = "the header stamps" if stamped else "the log times (no header stamps)"
    stamps = [header if stamped else logged for _, header, logged in messages]
    return _Series([part for part, _, _ in messages], np.array(stamps, np.int64), clock)


def _frames(message: Any) -> tuple[str, str]:
    """The frame in which a pose is, and the one that it is of, where that is said."""
    return str(getattr(message.header, "frame_id", "")), str(getattr(message, "child_frame_id", ""))


def _poses(messages: Sequence[Any]) -> tuple[Array, Array]:
    """Positions `(message, 3)` and quaternions `(message, 4)`, scalar first, of stamped poses or transforms."""
    if hasattr(messages[0], "pose"):
        parts = [(message.pose.position, message.pose.orientation) for message in messages]
    else:
        parts = [(message.transform.translation, message.transform.rotation) for message in messages]
    position = [(at.x, at.y, at.z) for at, _ in parts]
    quaternion = [(turn.w, turn.x, turn.y, turn.z) for _, turn in parts]
    return np.array(position, float), np.array(quaternion, float)


# ------------------------------------------------------------------ joints


def _joint_states(
    path: Path, topic: str, series: _Series, of_arm: ArmJoints, notes: list[str]
) -> tuple[NDArray[np.int64], dict[str, Array]]:
    """What the joints did, in order of time: the stamps, and the columns to be interpolated."""
    joint_names = list(dict.fromkeys(str(name) for message in series.messages for name in message.name))
    if not joint_names:
        raise InputError(f"{path}: the messages of {topic} name no joints; record them with names")
    names, order = _ordered(joint_names, of_arm)
    left_out = [name for name in joint_names if name not in names]
    notes.append(
        f"joints of {topic} {order}: "
        + ", ".join(f"q{number} is {name}" for number, name in enumerate(names, 1))
        + (f"; left out: {', '.join(left_out)}" if left_out else "")
    )
    complete = [
        k
        for k, m in enumerate(series.messages)
        if len(m.position) == len(m.name) == len(set(m.name)) and set(names) <= set(m.name)
    ]
    if skipped := len(series.messages) - len(complete):
        notes.append(f"passed over {skipped} messages of {topic} without the positions of all these joints")
    if not complete:
        raise InputError(f"{path}: no message of {topic} has the positions of all of {', '.join(names)}; record again")
    complete = [
        complete[k] for k in np.unique(series.stamp[complete], return_index=True)[1]
    ]  # in order of time, each once
    messages = [series.messages[k] for k in complete]
    place = [[list(message.name).index(name) for name in names] for message in messages]
    slides = [name for joint, name in enumerate(names) if joint in of_arm.sliding]
    if slides:
        notes.append(f"positions of {_listed(slides)} are taken as lengths in m: prismatic joints of the arm")
    columns: dict[str, Array] = {}
    for field, pattern in (("position", "q{}_rad"), ("velocity", "dq{}_rad_per_s"), ("effort", "tau{}_Nm")):
        if any(len(getattr(message, field)) != len(message.name) for message in messages):
            continue
        block = np.array([np.asarray(getattr(m, field), float)[at] for m, at in zip(messages, place, strict=True)])
        if field != "position" and not (block.any() and np.isfinite(block).all()):
            continue
        for joint, column in enumerate(block.T):
            columns[joint_unit(pattern.format(joint + 1), joint in of_arm.sliding)] = column
        if field == "effort":
            forces = f", those of {_listed(slides)} as forces in N" if slides else ""
            notes.append(f"the efforts of {topic} are taken as torques in N m{forces}: assumed, as they state no unit")
    return series.stamp[complete], columns


def _ordered(joint_names: Sequence[str], of_arm: ArmJoints) -> tuple[list[str], str]:
    """The arm's joints along it, and in words by what order."""
    if of_arm.names and set(of_arm.names) <= set(joint_names):
        return list(of_arm.names), "by the names of the arm's joints"
    along = {part: [name for name in joint_names if re.fullmatch(rf"(.*?){part}(_joint)?", name)] for part in UR_JOINTS}
    if all(len(matches) == 1 for matches in along.values()):
        return [matches[0] for matches in along.values()], "in the order of Universal Robots' arms"
    groups: dict[str, list[tuple[int, str]]] = {}
    for name in joint_names:
        if numbers := re.findall(r"\d+", name):
            groups.setdefault(re.sub(r"\d+(?!.*\d)", "#", name), []).append((int(numbers[-1]), name))
    numbered = sorted(max(groups.values(), key=len, default=[]))
    complete = [number for number, _ in numbered] in ([*range(1, len(numbered) + 1)], [*range(len(numbered))])
    all_numbered = len(numbered) in (len(joint_names), of_arm.dof) or (
        of_arm.dof is None and complete and len(numbered) > 1
    )
    if numbered and all_numbered:
        return [name for _, name in numbered], "by the numbers in their names"
    return list(joint_names), "in order of appearance"


def _at_poses(
    path: Path, stamp: NDArray[np.int64], columns: Mapping[str, Array], at: NDArray[np.int64], notes: list[str]
) -> tuple[NDArray[np.bool_], dict[str, Array]]:
    """Which poses have joint states around them, and the joints' columns there."""
    if len(stamp) < 2:
        raise InputError(f"{path}: has {len(stamp)} joint states at different times; record at least 2")
    base = min(stamp[0], at.min())
    times = _seconds(stamp, base), _seconds(at, base)
    joined = join(times[0], columns, [name for name in columns if re.match(r"q\d", name)], times[1])
    if not joined.usable.any():
        moved, measured = (f"{time.min():.3f} to {time.max():.3f} s" for time in times)
        raise InputError(
            f"{path}: no pose lies between joint states (joints {moved}, poses {measured}); stamp both by one clock"
        )
    notes += said_of(joined)
    return joined.usable, joined.columns


def _seconds(stamp: NDArray[np.int64], start: np.int64) -> Array:
    """Seconds from a start: the difference is taken in whole ns, of which a float would lose hundreds."""
    return (stamp - start) / 1e9
