"""Logs of ROS, which the package rosbags reads: joint states and stamped poses, transforms or commands as one table."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm, joint_unit
from lite6jax.array_types import Array, Mask
from lite6jax.errors import InputError
from lite6jax.formatting import shortened
from lite6jax.recordings.columns.column import PLACE, QUATERNION, spelled
from lite6jax.recordings.columns.names import UR_JOINTS
from lite6jax.recordings.streams import hold, join, said_of, said_of_commands

JOINT_STATE = "sensor_msgs/JointState"
POSE_STAMPED = "geometry_msgs/PoseStamped"
TRANSFORM = "geometry_msgs/TransformStamped"
TF = "tf2_msgs/TFMessage"
"""Of whose transforms poses are taken only where no topic has the others, or by name."""
CONTROLLER_STATE = "control_msgs/JointTrajectoryControllerState"
"""Of a joint trajectory controller of ros2_control: commands (`reference`) and measured joints (`feedback`)."""
TRAJECTORY = "trajectory_msgs/JointTrajectory"
"""A stream of commands where each message has one point."""
ARRAY = "std_msgs/Float64MultiArray"
"""Commands of a forward command controller, without names and stamps."""
_SENT = re.compile(r"command|cmd|desired|target|setpoint|reference", re.IGNORECASE)
"""In names of topics of commands."""
_POSITION = "position"
_VELOCITY = "velocity"
_IN_NAMES = {_POSITION: re.compile("position", re.IGNORECASE), _VELOCITY: re.compile("veloc", re.IGNORECASE)}
"""What names of topics say that numbers are."""
_PLURAL = {_POSITION: "positions", _VELOCITY: "velocities"}
_NO_MOTION = re.compile(r"effort|torque|current", re.IGNORECASE)
"""In names of topics whose numbers are neither."""
_SAME_CLOCK = 100_000_000
"""ns, within which stamps of headers and of the log may be of one clock."""
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
        """Takes the joints of an arm, or of none; these as they are."""
        if isinstance(arm, Arm):
            return cls(arm.dof, arm.sliding, arm.joint_names)
        return cls() if arm is None else arm


class _Topic(NamedTuple):
    """A topic as it is named.

    Attributes:
        topic: its name.
        child: of transforms the frame whose poses are wanted; None where there is only one.
        quantity: of commands, whether they are positions or velocities; None where their messages say it.
    """

    topic: str
    child: str | None = None
    quantity: str | None = None

    @property
    def name(self) -> str:
        chosen = self.child or self.quantity
        return self.topic + (f":{chosen}" if chosen else "")

    def names(self, quantity: str) -> bool:
        """Tells whether the topic's name says that its numbers are positions or velocities."""
        return _IN_NAMES[quantity].search(self.topic) is not None


class _Series(NamedTuple):
    """Messages of one topic in the order of the log, their stamps in ns, and by what clock they are stamped."""

    messages: list[Any]
    stamp: NDArray[np.int64]
    clock: str


class _Joints(NamedTuple):
    """What a message says of joints; names and numbers are empty where it does not say them."""

    name: Sequence[str]
    position: Sequence[float]
    velocity: Sequence[float] = ()
    effort: Sequence[float] = ()


class _Choice(NamedTuple):
    """The topics that are read; None where there is none. That of joints and of commands may be the same."""

    joints: _Topic
    poses: _Topic | None
    commands: _Topic | None

    @property
    def topics(self) -> set[str]:
        return {choice.topic for choice in (self.joints, self.poses, self.commands) if choice is not None}


def read_bag(path: Path, topics: Sequence[str], of_arm: ArmJoints, notes: list[str]) -> dict[str, Array]:
    """The table of a rosbag2 folder, a `.mcap` or `.db3` file, or a ROS 1 `.bag`: a row per pose, or per joint state.

    Where there are no poses and one topic has commands, these stand beside the joints as cmd1 … cmdN, each held until
    the next. Commanded velocities are cmd_dq1 … cmd_dqN.

    The joints are interpolated to its stamp (`streams.join`). They are named q1 … qN by the names of the arm's joints,
    along Universal Robots' arm, by the numbers in their names, or in order of appearance. Positions of prismatic joints
    are in m. Times count from the first row. Velocities and efforts are taken along where every message has them.
    Efforts of the only joint states are read without poses.

    Args:
        path: of the log.
        topics: of the joint states and of the poses or the commands, where there are several of a type; `/tf:tool0`
            for the poses of a frame, `/commands:velocity` for numbers that are velocities; of the joint states alone
            for a motion without poses; none where the types decide.
        of_arm: what is known of the arm's joints, to put them in order and to leave a gripper's out.
        notes: what was chosen, assumed and dropped is added here.

    Returns:
        SI column name to `(sample,)` values.

    Raises:
        InputError: the package rosbags is missing, the log is damaged or of another kind, topics are missing or
            several, commands are positions or velocities and nothing says which, or poses and joint states do not
            overlap in time.
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
            choice = _choose(path, dict(sorted(types.items())), topics)
            joints, poses, commands = choice
            messages: dict[str, list[tuple[Any, int, int]]] = {topic: [] for topic in sorted(choice.topics)}
            connections = [connection for connection in reader.connections if connection.topic in messages]
            for connection in connections:
                if connection.msgtype not in reader.typestore.types:
                    raise InputError(
                        f"{path}: does not say what messages of {types[connection.topic]} on {connection.topic} hold; "
                        "record as MCAP, which does, or convert it with `ros2 bag convert`"
                    )
            for connection, logged, content in reader.messages(connections=connections):
                message: Any = reader.deserialize(content, connection.msgtype)
                for part in getattr(message, "transforms", [message]):
                    stamp = part.header.stamp if hasattr(part, "header") else None
                    header = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec) if stamp else 0
                    messages[connection.topic].append((part, header, logged))
    except InputError:
        raise
    except Exception as error:  # the package raises whatever the damaged bytes lead to
        problem = " ".join(f"{type(error).__name__} {error}".split())[:100]
        tool = {".mcap": "recover what is left with `mcap recover`", ".bag": "check it with `rosbag info`"}
        remedy = tool.get(path.suffix.lower(), "recover what is left with `ros2 bag reindex`")
        raise InputError(f"{path}: is no bag, truncated or damaged ({problem}); {remedy}, or record again") from error
    moved = _series(path, joints, messages[joints.topic])
    sent = None
    if commands is not None:
        sent = _series(path, commands, messages[commands.topic])
        if "log" in sent.clock and _clock_ahead(messages[joints.topic]) > _SAME_CLOCK:
            moved = _series(path, joints, [(part, 0, logged) for part, _, logged in messages[joints.topic]])
        sent = sent._replace(messages=[_commanded(message) for message in sent.messages])
    moved = moved._replace(messages=[_measured(message) for message in moved.messages])
    measured = None if poses is None else _series(path, poses, messages[poses.topic])
    among = {name for message in sent.messages for name in message.name} if sent else set()
    names, stamp, columns = _joint_states(path, joints.topic, moved, of_arm, notes, among)
    clock_note = f"times are {moved.clock} of {joints.topic}"
    if poses is not None and measured is not None:
        clock_note += f", {measured.clock} of {poses.name}"
    if commands is not None and sent is not None and commands.topic != joints.topic:
        clock_note += f", {sent.clock} of {commands.topic}"
    notes.append(clock_note)
    if commands is not None and sent is not None:
        stamp, columns = _with_commands(path, commands, sent, names, stamp, columns, of_arm, notes)
    if poses is None or measured is None:
        if not topics and not any(name.startswith(("tau", "cmd")) for name in columns):
            raise InputError(
                f"{path}: has no topic of {POSE_STAMPED}; {_topics_of(types)}; record one with these types, or name "
                f"{path.name}#{joints.name} for a motion or torques without poses"
            )
        if not topics and commands is None:
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


def _choose(path: Path, types: Mapping[str, str], topics: Sequence[str]) -> _Choice:
    """The topics of the joint states, and of the poses or the commands where these are there, or named."""
    available = _topics_of(types)
    chosen = []
    for name in topics:
        topic, mark, child = name.partition(":")  # a topic has no colon, and the name of a frame may
        kind = types.get(topic)
        if mark and kind == TF:
            chosen.append(_Topic(topic, child))
        elif child in _IN_NAMES and kind in (JOINT_STATE, CONTROLLER_STATE, TRAJECTORY, ARRAY):
            chosen.append(_Topic(topic, quantity=child))
        else:
            chosen.append(_Topic(name))
        if types.get(chosen[-1].topic) not in (
            *(JOINT_STATE, POSE_STAMPED, TRANSFORM, TF),
            *(CONTROLLER_STATE, TRAJECTORY, ARRAY),
        ):
            raise InputError(
                f"{path}: no topic {name} of {JOINT_STATE} or {POSE_STAMPED}; {available}; name those to be read"
            )
    candidates = chosen or [_Topic(topic) for topic in types]
    joints = [choice for choice in candidates if types[choice.topic] == JOINT_STATE]
    commands = [choice for choice in joints if _SENT.search(choice.topic) or choice.quantity is not None]
    commands = commands if len(commands) < len(joints) else []
    joints = [choice for choice in joints if choice not in commands]
    commands = _commands_among(candidates, types, commands, bool(topics))
    poses = [choice for choice in candidates if types[choice.topic] in (POSE_STAMPED, TRANSFORM)]
    poses = poses or [
        choice for choice in candidates if types[choice.topic] == TF and (topics or choice.topic != "/tf_static")
    ]
    joints = joints or [choice for choice in commands if types[choice.topic] == CONTROLLER_STATE]
    if poses and commands and topics:
        raise InputError(
            f"{path}: poses and commands are diagnosed apart, and {poses[0].name} and {commands[0].name} are named; "
            "name the joint states and one of them"
        )
    commands = [] if poses else commands
    if not joints:
        raise InputError(f"{path}: has no topic of {JOINT_STATE}; {available}; record one with these types")
    pair = ",".join(dict.fromkeys(choice.name for choice in (*joints[:1], *poses[:1], *commands[:1])))
    for listed in (joints, poses, commands):
        if len(listed) > 1:
            raise InputError(
                f"{path}: has {len(listed)} topics of {types[listed[0].topic]}: "
                f"{', '.join(choice.name for choice in listed)}; choose, as in {path.name}#{pair}"
            )
    return _Choice(joints[0], poses[0] if poses else None, commands[0] if commands else None)


def _commands_among(
    candidates: Sequence[_Topic], types: Mapping[str, str], joint_states: Sequence[_Topic], named: bool
) -> list[_Topic]:
    """The topics of commanded positions or velocities: of the kind that says most of them.

    Args:
        candidates: the topics.
        types: of all topics.
        joint_states: those of joint states that are commands by their names.
        named: whether the candidates are named; else a topic of numbers is one of commands only where its name says so.
    """
    of_kind = {kind: [choice for choice in candidates if types[choice.topic] == kind] for kind in (ARRAY, TRAJECTORY)}
    states = [choice for choice in candidates if types[choice.topic] == CONTROLLER_STATE]
    if not named:
        sent = [
            choice for choice in of_kind[ARRAY] if _SENT.search(choice.topic) and not _NO_MOTION.search(choice.topic)
        ]
        of_kind[ARRAY] = [choice for choice in sent if not choice.names(_VELOCITY)] or sent
    return next(filter(None, (states, [*joint_states], of_kind[ARRAY], of_kind[TRAJECTORY])), [])


def _topics_of(types: Mapping[str, str]) -> str:
    shown = shortened([f"{topic} ({kind or 'no type'})" for topic, kind in sorted(types.items())], _SHOWN)
    return f"it has {shown}" if types else "it has no topics at all"


def _listed(parts: Sequence[str]) -> str:
    return ", ".join(parts[:_SHOWN]) + (f", and {len(parts) - _SHOWN} more" if len(parts) > _SHOWN else "")


def _series(path: Path, chosen: _Topic, messages: list[tuple[Any, int, int]]) -> _Series:
    """The messages of a topic with their stamps: the headers', or the log's where no header has any.

    Raises:
        InputError: there are none, or transforms to several frames of which none is chosen.
    """
    if not messages:
        raise InputError(f"{path}: topic {chosen.topic} has no messages; record again")
    posed = [part for part, _, _ in messages if hasattr(part, "pose") or hasattr(part, "transform")]
    pairs = list(dict.fromkeys(map(_frames, posed)))
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


def _measured(message: Any) -> _Joints:
    """The measured joints of a message."""
    if hasattr(message, "name"):
        return _Joints(message.name, message.position, message.velocity, message.effort)
    point = _point(message, "feedback", "actual")
    return _Joints(message.joint_names, point.positions, point.velocities, point.effort)


def _commanded(message: Any) -> _Joints:
    """The commanded joints of a message; those of a trajectory of several points are none."""
    if hasattr(message, "name"):
        return _Joints(message.name, message.position, message.velocity)
    if hasattr(message, "data"):
        return _Joints((), message.data, message.data)
    if hasattr(message, "points"):
        if len(message.points) != 1:
            return _Joints(message.joint_names, ())
        point = message.points[0]
    else:
        point = _point(message, "reference", "desired")
    return _Joints(message.joint_names, point.positions, point.velocities)


def _commanded_quantity(path: Path, chosen: _Topic, messages: Sequence[_Joints]) -> str:
    """What commands are, positions or velocities: as the topic is named, or as their messages or its name say.

    Raises:
        InputError: they may be either.
    """
    if chosen.quantity is not None:
        return chosen.quantity
    has_positions = any(np.isfinite(message.position).any() for message in messages)
    has_velocities = any(np.isfinite(message.velocity).any() for message in messages)
    if has_positions != has_velocities:
        return _POSITION if has_positions else _VELOCITY
    by_name = [quantity for quantity in _IN_NAMES if chosen.names(quantity)]
    labelled = any(len(message.name) for message in messages)
    if len(by_name) == 1 and not (labelled and by_name == [_VELOCITY]):
        return by_name[0]
    if labelled and _VELOCITY not in by_name:
        return _POSITION
    raise InputError(
        f"{path}: the commands of {chosen.topic} may be positions or velocities; name {chosen.topic}:{_POSITION} or "
        f"{chosen.topic}:{_VELOCITY} beside the joint states"
    )


def _point(message: Any, *names: str) -> Any:
    """The point of a controller's state under the first of some names that has positions; names differ by version."""
    points = [getattr(message, name) for name in names if hasattr(message, name)]
    return next((point for point in points if len(point.positions)), points[0])


def _clock_ahead(messages: Sequence[tuple[Any, int, int]]) -> float:
    """ns, the median magnitude between stamps of headers and of the log."""
    return float(np.median([abs(header - logged) for _, header, logged in messages]))


def _with_commands(
    path: Path,
    chosen: _Topic,
    series: _Series,
    names: Sequence[str],
    stamp: NDArray[np.int64],
    columns: Mapping[str, Array],
    of_arm: ArmJoints,
    notes: list[str],
) -> tuple[NDArray[np.int64], dict[str, Array]]:
    """The joint states with a command in force: their stamps and columns, the commands beside them.

    Raises:
        InputError: no message has the positions or the velocities of all joints, it is not known which of them, or none
            was sent before a joint state.
    """
    topic = chosen.topic
    quantity = _commanded_quantity(path, chosen, series.messages)
    numbers = [message.velocity if quantity == _VELOCITY else message.position for message in series.messages]
    unnamed = not any(len(message.name) for message in series.messages)
    complete = []
    for k, message in enumerate(series.messages):
        listed = list(names) if unnamed else list(message.name)
        if len(numbers[k]) == len(listed) and {*names} <= {*listed}:
            complete.append(k)
    if not complete:
        raise InputError(
            f"{path}: no message of {topic} has the {_PLURAL[quantity]} of all of {', '.join(names)}, one for each; "
            f"name a topic that streams the commanded {_PLURAL[quantity]} of these joints, as a controller's state does"
        )
    if skipped := len(series.messages) - len(complete):
        notes.append(f"passed over {skipped} messages of {topic} without one {quantity} of each of these joints")
    complete = [complete[k] for k in np.unique(series.stamp[complete], return_index=True)[1]]
    messages = [series.messages[k] for k in complete]
    places = [[list(message.name).index(name) for name in names] for message in messages if not unnamed]
    places = places or [[*range(len(names))]] * len(messages)
    sent = np.array([np.asarray(numbers[k], float)[at] for k, at in zip(complete, places, strict=True)])
    start = min(stamp[0], series.stamp[complete[0]])
    times = _seconds(series.stamp[complete], start)
    held = hold(times, _seconds(stamp, start))
    if not held.usable.any():
        moved, commanded = (f"{time.min():.3f} to {time.max():.3f} s" for time in (_seconds(stamp, start), times))
        raise InputError(
            f"{path}: no joint state lies between commands (joints {moved}, commands {commanded}); stamp both by one "
            "clock"
        )
    kind = f"the velocities of {topic}" if quantity == _VELOCITY else f"those of {topic}"
    notes.append(f"the commands are {kind}, each held until the next")
    if unnamed:
        notes.append(f"the numbers of {topic} are taken in the order of the joints: assumed, as they state no names")
    notes += said_of_commands(held)
    at_states = {name: column[held.usable] for name, column in columns.items()}
    pattern = "cmd_dq{}_rad_per_s" if quantity == _VELOCITY else "cmd{}_rad"
    for joint, column in enumerate(sent[held.sent].T):
        at_states[joint_unit(pattern.format(joint + 1), joint in of_arm.sliding)] = column
    return stamp[held.usable], at_states


def _joint_states(
    path: Path, topic: str, series: _Series, of_arm: ArmJoints, notes: list[str], among: set[str]
) -> tuple[list[str], NDArray[np.int64], dict[str, Array]]:
    """What the joints did, in order of time: their names, the stamps, and the columns to be interpolated.

    Of joints that are commanded (`among`) all others, such as a gripper's, are left out.
    """
    all_names = list(dict.fromkeys(str(name) for message in series.messages for name in message.name))
    joint_names = list(dict.fromkeys(name for name in all_names if name in among)) or all_names
    if not joint_names:
        raise InputError(f"{path}: the messages of {topic} name no joints; record them with names")
    names, order = _ordered(joint_names, of_arm)
    left_out = [name for name in all_names if name not in names]
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
    return names, series.stamp[complete], columns


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
) -> tuple[Mask, dict[str, Array]]:
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
