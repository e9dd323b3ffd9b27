"""Logs of ROS, which the package rosbags reads: joint states and stamped poses or transforms as one table."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm, joint_unit
from lite6jax.errors import InputError
from lite6jax.recordings import streams

Array = NDArray[np.floating]
Stamps = NDArray[np.int64]

JOINT_STATE = "sensor_msgs/JointState"
POSE_STAMPED = "geometry_msgs/PoseStamped"
TRANSFORM = "geometry_msgs/TransformStamped"
TF = "tf2_msgs/TFMessage"
POSES = (POSE_STAMPED, TRANSFORM, TF)
"""Messages from which poses are taken; transforms of TF only where no topic has the others, or by name."""
UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Along Universal Robots' arms, whose drivers publish them in alphabetical order."""
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

    def named_as(self, other: "ArmJoints") -> "ArmJoints":
        """These with the names of others, where these are as many."""
        return self._replace(names=other.names) if len(other.names) == self.dof else self


class _JointState(NamedTuple):
    name: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]


class _Pose(NamedTuple):
    position: tuple[float, ...]
    quaternion: tuple[float, ...]
    frames: tuple[str, str]


class _Series(NamedTuple):
    """Messages of one topic in the order of the log, and by what clock they are stamped."""

    messages: list[Any]
    stamp: Stamps
    clock: str


class _Chosen(NamedTuple):
    """A topic, and of transforms the frame whose poses are wanted; None where there is only one."""

    topic: str
    child: str | None = None

    @property
    def name(self) -> str:
        return self.topic + (f":{self.child}" if self.child else "")


@final
class Messages:
    """What a log says on some topics, as it is read message by message."""

    def __init__(self, topics: Sequence[str]) -> None:
        self._found: dict[str, list[tuple[Any, int, int]]] = {topic: [] for topic in topics}

    def add(self, topic: str, logged: int, message: Any) -> None:
        """One message: decoded, of any of the types here, and the ns at which it was logged."""
        for part in getattr(message, "transforms", [message]):
            stamp = part.header.stamp
            header = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
            self._found[topic].append((_plain(part), header, logged))

    def series(self, path: Path, chosen: _Chosen) -> _Series:
        """The messages of a topic with their stamps in ns: the headers', or the log's where no header has any.

        Raises:
            InputError: there are none, or transforms to several frames of which none is chosen.
        """
        found = self._found[chosen.topic]
        if not found:
            raise InputError(f"{path}: topic {chosen.topic} has no messages; record again")
        pairs = list(dict.fromkeys(part.frames for part, _, _ in found if isinstance(part, _Pose)))
        children = list(dict.fromkeys(child for _, child in pairs))
        if chosen.child is not None:
            found = [entry for entry in found if entry[0].frames[1] == chosen.child]
            parents = [parent for parent, child in pairs if child == chosen.child]
            if len(parents) != 1:
                said = f"no transform to {chosen.child}" if not parents else f"{chosen.child} in {', '.join(parents)}"
                raise InputError(f"{path}: topic {chosen.topic} has {said}; it has {_listed(_arrows(pairs))}")
        elif len(pairs) > 1:
            raise InputError(
                f"{path}: topic {chosen.topic} has {len(pairs)} transforms: {_listed(_arrows(pairs))}; choose the "
                f"frame that was measured, as in {path.name}#/joint_states,{chosen.topic}:{children[0]}"
            )
        stamped = any(header for _, header, _ in found)
        clock = "the header stamps" if stamped else "the log times (no header stamps)"
        stamps = [header if stamped else logged for _, header, logged in found]
        return _Series([part for part, _, _ in found], np.array(stamps, np.int64), clock)


Read = Callable[[Sequence[str]], Messages]
"""The messages on topics of a log."""


def read_log(
    path: Path,
    types: Mapping[str, str],
    read: Read,
    topics: Sequence[str],
    of_arm: ArmJoints,
    notes: list[str],
) -> dict[str, Array]:
    """The table of a log: a row per pose, with the joints interpolated to its stamp (`streams.join`).

    Joints are named q1 … qN by the names of the arm's joints, along Universal Robots' arm, by the numbers in their
    names, or in order of appearance. Positions of prismatic joints are in m.
    Times count from the first row. Velocities and efforts are taken along where every message has them. Efforts of the
    only joint states are read without poses.

    Args:
        path: of the log, for messages.
        types: of each topic, `sensor_msgs/JointState` or with `/msg/`.
        read: the messages on topics.
        topics: of the joint states and of the poses, where there are several of a type; `/tf:tool0` for the poses of a
            frame; of the joint states alone for a motion without poses; none where the types decide.
        of_arm: what is known of the arm's joints, to put them in order and to leave a gripper's out.
        notes: what was chosen, assumed and dropped is added here.

    Returns:
        SI column name to `(sample,)` values.

    Raises:
        InputError: topics are missing or several, or poses and joint states do not overlap in time.
    """
    short = {topic: kind.replace("/msg/", "/") for topic, kind in sorted(types.items())}
    joints, poses = _chosen(path, short, topics)
    messages = read([choice.topic for choice in (joints, poses) if choice is not None])
    moved = messages.series(path, joints)
    measured = None if poses is None else messages.series(path, poses)
    state = _joint_states(path, joints.topic, moved, of_arm, notes)
    said = f"times are {moved.clock} of {joints.topic}"
    notes.append(said + (f", {measured.clock} of {poses.name}" if poses and measured else ""))
    if poses is None and not topics:
        if not any(name.startswith("tau") for name in state.columns):
            raise InputError(
                f"{path}: has no topic of {POSE_STAMPED}; {_topics_of(short)}; record one with these types, or name "
                f"{path.name}#{joints.name} for a motion or torques without poses"
            )
        notes.append(f"there are no poses: {joints.topic} is read for its efforts, as {path.name}#{joints.name}")
    if poses is None or measured is None:
        return {"time_s": _seconds(state.stamp, state.stamp[0]), **state.columns}
    if short[poses.topic] == TF:
        parent, child = measured.messages[0].frames
        notes.append(
            f"the poses are those of {child} in {parent} on {poses.topic}; a robot_state_publisher computes such "
            "transforms from the joints, which measures nothing"
        )
    kept, columns = _at_poses(path, state, measured.stamp, notes)
    stamp = measured.stamp[kept]
    table = {"time_s": _seconds(stamp, stamp[0]), **columns}
    position, quaternion = (
        np.array([getattr(message, part) for message in measured.messages], float)
        for part in ("position", "quaternion")
    )
    table |= dict(zip(("x_m", "y_m", "z_m"), position[kept].T, strict=True))
    if (quaternion == quaternion[0]).all() and len(quaternion) > 1:
        notes.append(f"the orientations of {poses.name} never change: they are taken as not measured")
    else:
        table |= dict(zip(("qw", "qx", "qy", "qz"), quaternion[kept].T, strict=True))
    return table


METADATA = "metadata.yaml"
"""In the folder of a rosbag2."""


def read_bag(path: Path, topics: Sequence[str], of_arm: ArmJoints, notes: list[str]) -> dict[str, Array]:
    """The table of a log, as `read_log`: of a rosbag2 folder, a `.mcap` or `.db3` file, or a ROS 1 `.bag`.

    Raises:
        InputError: the package rosbags is missing, the log is damaged or of another kind, or as `read_log`.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(f"{path}: bags take the package rosbags; pip install 'lite6jax[rosbag]'") from error

    def read(chosen: Sequence[str]) -> Messages:
        messages = Messages(chosen)
        connections = [connection for connection in reader.connections if connection.topic in chosen]
        try:
            for connection, logged, content in reader.messages(connections=connections):
                messages.add(connection.topic, logged, reader.deserialize(content, connection.msgtype))
        except Exception as error:  # the package raises whatever the damaged bytes lead to
            raise _damaged(path, error) from error
        return messages

    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except Exception as error:  # as above
        raise _damaged(path, error) from error
    try:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
        return read_log(path, types, read, topics, of_arm, notes)
    finally:
        reader.close()


def _damaged(path: Path, error: Exception) -> InputError:
    problem = " ".join(f"{type(error).__name__} {error}".split())[:100]
    tool = {".mcap": "recover what is left with `mcap recover`", ".bag": "check it with `rosbag info`"}
    remedy = tool.get(path.suffix.lower(), "recover what is left with `ros2 bag reindex`")
    return InputError(f"{path}: is no bag, truncated or damaged ({problem}); {remedy}, or record again")


def _chosen(path: Path, types: Mapping[str, str], named: Sequence[str]) -> tuple[_Chosen, _Chosen | None]:
    """The topics of the joint states and of the poses; None for poses where only joint states are there, or named."""
    there = _topics_of(types)
    wanted = [_split(name, types) for name in named]
    for choice in wanted:
        if types.get(choice.topic) not in (JOINT_STATE, *POSES):
            raise InputError(
                f"{path}: no topic {choice.topic} of {JOINT_STATE} or {POSE_STAMPED}; {there}; name those to be read"
            )
    candidates = wanted or [_Chosen(topic) for topic in types]
    joints = [choice for choice in candidates if types[choice.topic] == JOINT_STATE]
    poses = [choice for choice in candidates if types[choice.topic] in (POSE_STAMPED, TRANSFORM)]
    poses = poses or [
        choice for choice in candidates if types[choice.topic] == TF and (named or choice.topic != "/tf_static")
    ]
    if not joints:
        raise InputError(f"{path}: has no topic of {JOINT_STATE}; {there}; record one with these types")
    pair = [*(choice.name for choice in joints[:1]), *(choice.name for choice in poses[:1])]
    if len(joints) > 1:
        raise InputError(_several(path, JOINT_STATE, joints, pair))
    if len(poses) > 1:
        raise InputError(_several(path, types[poses[0].topic], poses, pair))
    return joints[0], poses[0] if poses else None


def _topics_of(types: Mapping[str, str]) -> str:
    shown = _listed([f"{topic} ({kind or 'no type'})" for topic, kind in types.items()], " and {} more")
    return f"it has {shown}" if types else "it has no topics at all"


def _split(name: str, types: Mapping[str, str]) -> _Chosen:
    topic, mark, child = name.partition(":")  # a topic has no colon, and the name of a frame may
    return _Chosen(topic, child) if mark and types.get(topic) == TF else _Chosen(name)


def _several(path: Path, kind: str, found: Sequence[_Chosen], pair: Sequence[str]) -> str:
    return (
        f"{path}: has {len(found)} topics of {kind}: {', '.join(choice.name for choice in found)}; choose, as in "
        f"{path.name}#{','.join(pair)}"
    )


def _listed(parts: Sequence[str], more: str = ", and {} more") -> str:
    return ", ".join(parts[:_SHOWN]) + (more.format(len(parts) - _SHOWN) if len(parts) > _SHOWN else "")


def _arrows(pairs: Sequence[tuple[str, str]]) -> list[str]:
    return [f"{child} in {parent}" for parent, child in pairs]


class _JointStates(NamedTuple):
    """What the joints did, in order of time: the columns to be interpolated."""

    stamp: Stamps
    columns: dict[str, Array]


def _plain(message: Any) -> _JointState | _Pose:
    frames = (str(getattr(message.header, "frame_id", "")), str(getattr(message, "child_frame_id", "")))
    if hasattr(message, "pose"):
        return _pose(message.pose.position, message.pose.orientation, frames)
    if hasattr(message, "transform"):
        return _pose(message.transform.translation, message.transform.rotation, frames)
    numbers = (tuple(map(float, part)) for part in (message.position, message.velocity, message.effort))
    return _JointState(tuple(map(str, message.name)), *numbers)


def _pose(at: Any, turn: Any, frames: tuple[str, str]) -> _Pose:
    return _Pose((float(at.x), float(at.y), float(at.z)), tuple(map(float, (turn.w, turn.x, turn.y, turn.z))), frames)


def _joint_states(path: Path, topic: str, series: _Series, of_arm: ArmJoints, notes: list[str]) -> _JointStates:
    seen = list(dict.fromkeys(name for message in series.messages for name in message.name))
    if not seen:
        raise InputError(f"{path}: the messages of {topic} name no joints; record them with names")
    names, order = _ordered(seen, of_arm)
    left_out = [name for name in seen if name not in names]
    notes.append(
        f"joints of {topic} {order}: "
        + ", ".join(f"q{number} is {name}" for number, name in enumerate(names, 1))
        + (f"; left out: {', '.join(left_out)}" if left_out else "")
    )
    whole = [
        k
        for k, m in enumerate(series.messages)
        if len(m.position) == len(m.name) == len(set(m.name)) and set(names) <= set(m.name)
    ]
    if skipped := len(series.messages) - len(whole):
        notes.append(f"passed over {skipped} messages of {topic} without the positions of all these joints")
    if not whole:
        raise InputError(f"{path}: no message of {topic} has the positions of all of {', '.join(names)}; record again")
    whole = [whole[k] for k in np.unique(series.stamp[whole], return_index=True)[1]]  # in order of time, each once
    slides = [name for joint, name in enumerate(names) if joint in of_arm.sliding]
    if slides:
        notes.append(f"positions of {_listed(slides)} are taken as lengths in m: prismatic joints of the arm")
    columns: dict[str, Array] = {}
    for field, pattern in (("position", "q{}_rad"), ("velocity", "dq{}_rad_per_s"), ("effort", "tau{}_Nm")):
        block = _block([series.messages[k] for k in whole], names, field)
        if field != "position" and (block is None or not block.any() or not np.isfinite(block).all()):
            continue
        assert block is not None
        for joint in range(len(names)):
            columns[joint_unit(pattern.format(joint + 1), joint in of_arm.sliding)] = block[:, joint]
        if field == "effort":
            forces = f", those of {_listed(slides)} as forces in N" if slides else ""
            notes.append(f"the efforts of {topic} are taken as torques in N m{forces}: assumed, as they state no unit")
    return _JointStates(series.stamp[whole], columns)


def _block(messages: Sequence[Any], names: Sequence[str], field: str) -> Array | None:
    """`(message, joint)`; None where a message does not give the field of every joint."""
    if any(len(getattr(message, field)) != len(message.name) for message in messages):
        return None
    rows = []
    for message in messages:
        place = {name: index for index, name in enumerate(message.name)}
        rows.append([getattr(message, field)[place[name]] for name in names])
    return np.array(rows, float)


def _ordered(seen: Sequence[str], of_arm: ArmJoints) -> tuple[list[str], str]:
    """The arm's joints along it, and in words by what order."""
    dof = of_arm.dof
    if of_arm.names and set(of_arm.names) <= set(seen):
        return list(of_arm.names), "by the names of the arm's joints"
    along = {part: [name for name in seen if re.fullmatch(rf"(.*?){part}(_joint)?", name)] for part in UR_JOINTS}
    if all(len(found) == 1 for found in along.values()):
        return [found[0] for found in along.values()], "in the order of Universal Robots' arms"
    groups: dict[str, list[str]] = {}
    for name in seen:
        if re.search(r"\d", name):
            groups.setdefault(re.sub(r"\d+(?!.*\d)", "#", name), []).append(name)
    numbered = sorted(max(groups.values(), key=len, default=[]), key=_number)
    complete = [_number(name) for name in numbered] in ([*range(1, len(numbered) + 1)], [*range(len(numbered))])
    if numbered and (len(numbered) in (len(seen), dof) or (dof is None and complete and len(numbered) > 1)):
        return numbered, "by the numbers in their names"
    return list(seen), "in order of appearance"


def _number(name: str) -> int:
    return int(re.findall(r"\d+", name)[-1])


def _at_poses(
    path: Path, state: _JointStates, stamp: Stamps, notes: list[str]
) -> tuple[NDArray[np.bool_], dict[str, Array]]:
    """Which poses have joint states around them, and the joints' columns there."""
    if len(state.stamp) < 2:
        raise InputError(f"{path}: has {len(state.stamp)} joint states at different times; record at least 2")
    base = min(state.stamp[0], stamp.min())
    times = _seconds(state.stamp, base), _seconds(stamp, base)
    joints = [name for name in state.columns if re.match(r"q\d", name)]
    joined = streams.join(times[0], state.columns, joints, times[1])
    if not joined.kept.any():
        moved, measured = (f"{time.min():.3f} to {time.max():.3f} s" for time in times)
        raise InputError(
            f"{path}: no pose lies between joint states (joints {moved}, poses {measured}); stamp both by one clock"
        )
    notes += streams.said_of(joined)
    return joined.kept, joined.columns


def _seconds(stamp: Any, start: Any) -> Any:
    """Seconds from a start: the difference is taken in whole ns, of which a float would lose hundreds."""
    return (stamp - start) / 1e9
