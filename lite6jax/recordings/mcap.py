"""Recordings in MCAP files of ROS 2: joint states and stamped poses become the columns of one table."""

import re
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.errors import InputError

Array = NDArray[np.floating]
Stamps = NDArray[np.int64]

JOINT_STATE = "sensor_msgs/JointState"
POSE_STAMPED = "geometry_msgs/PoseStamped"
LONGEST_GAP = 2.0
"""Between joint states around a pose, in median steps; beyond, the joints at the pose are not known."""
UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Along Universal Robots' arms, whose drivers publish them in alphabetical order."""
_TOPICS_SHOWN = 8
_SUFFIX = ".mcap"


class _JointState(NamedTuple):
    name: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]


class _Pose(NamedTuple):
    position: tuple[float, ...]
    quaternion: tuple[float, ...]


class _Series(NamedTuple):
    """Messages of one topic in the order of the log, and by what clock they are stamped."""

    messages: list[Any]
    stamp: Stamps
    clock: str


def split_topics(path: str | Path) -> tuple[Path, tuple[str, ...]]:
    """The file and the topics of `run.mcap#/joint_states,/pose`; no topics where none are named."""
    file, mark, topics = str(path).partition(f"{_SUFFIX}#")
    if not mark:
        return Path(path), ()
    return Path(file + _SUFFIX), tuple(filter(None, (topic.strip() for topic in topics.split(","))))


def read_mcap(path: Path, topics: Sequence[str], dof: int | None, notes: list[str]) -> dict[str, Array]:
    """The table of a log: a row per pose, with the joints interpolated linearly to its stamp.

    Joints are named q1 … qN along Universal Robots' arm, by the numbers in their names, or in order of appearance.
    Times count from the first row. Velocities and efforts are taken along where every message has them.

    Args:
        path: the file.
        topics: of the joint states and of the poses, where there are several of a type; of the joint states alone for
            a motion without poses; none where the types decide.
        dof: how many joints the arm has, to leave a gripper's out.
        notes: what was chosen, assumed and dropped is added here.

    Returns:
        SI column name to `(sample,)` values.

    Raises:
        InputError: a package is missing, the file is no MCAP file or damaged, topics are missing or several, messages
            are not of ROS 2, or poses and joint states do not overlap in time.
    """
    with open(path, "rb") as file:
        joints, poses = _chosen(path, _topics(path, file), topics)
        wanted = [joints] if poses is None else [joints, poses]
        read = _series(path, file, wanted)
    state = _joint_states(path, joints, read[joints], dof, notes)
    notes.append(f"times are {read[joints].clock} of {joints}" + (f", {read[poses].clock} of {poses}" if poses else ""))
    if poses is None:
        return {"time_s": _seconds(state.stamp, state.stamp[0]), **state.columns}
    measured = read[poses]
    kept, columns = _interpolated(path, state, measured.stamp, notes)
    stamp = measured.stamp[kept]
    table = {"time_s": _seconds(stamp, stamp[0]), **columns}
    position, quaternion = (np.array(part, float) for part in zip(*measured.messages, strict=True))
    table |= dict(zip(("x_m", "y_m", "z_m"), position[kept].T, strict=True))
    if (quaternion == quaternion[0]).all() and len(quaternion) > 1:
        notes.append(f"the orientations of {poses} never change: they are taken as not measured")
    else:
        table |= dict(zip(("qw", "qx", "qy", "qz"), quaternion[kept].T, strict=True))
    return table


class _JointStates(NamedTuple):
    """What the joints did, in order of time: the columns to be interpolated."""

    stamp: Stamps
    columns: dict[str, Array]


def _packages(path: Path) -> Callable[[IO[bytes]], Any]:
    """What opens a stream as an MCAP reader that decodes messages of ROS 2."""
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise InputError(
            f"{path}: MCAP files take the packages mcap and mcap-ros2-support; pip install 'lite6jax[mcap]'"
        ) from error
    return lambda stream: make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])


def _damaged(path: Path, file: IO[bytes], error: Exception) -> InputError:
    file.seek(0)
    if file.read(8) != b"\x89MCAP0\r\n":
        return InputError(f"{path}: is not an MCAP file, whatever its name says; check the file")
    problem = " ".join(f"{type(error).__name__} {error}".split())[:100]
    return InputError(
        f"{path}: is truncated or damaged ({problem}); recover what is left with `mcap recover`, or record again"
    )


def _topics(path: Path, file: IO[bytes]) -> dict[str, str]:
    """The type of each topic, written the short way: geometry_msgs/PoseStamped."""
    open_log = _packages(path)
    types: dict[str, str] = {}
    try:
        reader = open_log(file)
        summary = reader.get_summary()
        if summary is not None:
            for channel in summary.channels.values():
                schema = summary.schemas.get(channel.schema_id)
                types[channel.topic] = "" if schema is None else schema.name
        if not types:
            file.seek(0)
            for schema, channel, _ in reader.iter_messages():
                types[channel.topic] = "" if schema is None else schema.name
    except Exception as error:  # the packages raise whatever the damaged bytes lead to
        raise _damaged(path, file, error) from error
    return {topic: kind.replace("/msg/", "/") for topic, kind in sorted(types.items())}


def _chosen(path: Path, types: dict[str, str], named: Sequence[str]) -> tuple[str, str | None]:
    """The topics of the joint states and of the poses; None for poses where only joint states are named."""
    shown = [f"{topic} ({kind or 'no type'})" for topic, kind in types.items()]
    more = f" and {len(shown) - _TOPICS_SHOWN} more" if len(shown) > _TOPICS_SHOWN else ""
    there = f"it has {', '.join(shown[:_TOPICS_SHOWN])}{more}" if shown else "it has no topics at all"
    for topic in named:
        if types.get(topic) not in (JOINT_STATE, POSE_STAMPED):
            raise InputError(
                f"{path}: no topic {topic} of {JOINT_STATE} or {POSE_STAMPED}; {there}; name those to be read"
            )
    chosen = []
    for kind in (JOINT_STATE, POSE_STAMPED):
        found = [topic for topic in named or types if types[topic] == kind]
        if not found and kind == POSE_STAMPED and named:
            return chosen[0], None
        if not found:
            remedy = "record one with these types"
            if chosen:
                remedy += f", or name {path.name}#{chosen[0]} for a motion or torques without poses"
            raise InputError(f"{path}: has no topic of {kind}; {there}; {remedy}")
        if len(found) > 1:
            others = [topic for topic, other in types.items() if other == POSE_STAMPED]
            pair = f"{found[0]},{others[0]}" if kind == JOINT_STATE and others else f"{chosen[0]},{found[0]}"
            raise InputError(
                f"{path}: has {len(found)} topics of {kind}: {', '.join(found)}; choose, as in {path.name}#{pair}"
            )
        chosen.append(found[0])
    return chosen[0], chosen[1]


def _series(path: Path, file: IO[bytes], topics: Sequence[str]) -> dict[str, _Series]:
    """The messages of topics with their stamps in ns: the headers', or the log's where no header has any."""
    from mcap.exceptions import DecoderNotFoundError

    open_log = _packages(path)
    messages: dict[str, list[Any]] = {topic: [] for topic in topics}
    header: dict[str, list[int]] = {topic: [] for topic in topics}
    logged: dict[str, list[int]] = {topic: [] for topic in topics}
    series = {}
    try:
        file.seek(0)
        with redirect_stderr(StringIO()):  # where the decoder prints what it cannot parse
            for _, channel, message, decoded in open_log(file).iter_decoded_messages(topics=list(topics)):
                stamp = decoded.header.stamp
                messages[channel.topic].append(_plain(decoded))
                header[channel.topic].append(stamp.sec * 1_000_000_000 + stamp.nanosec)
                logged[channel.topic].append(message.log_time)
        for topic, found in messages.items():
            stamped = any(header[topic])
            clock = "the header stamps" if stamped else "the log times (no header stamps)"
            series[topic] = _Series(found, np.array((header if stamped else logged)[topic], np.int64), clock)
    except DecoderNotFoundError as error:
        raise InputError(
            f"{path}: the messages of {' or '.join(topics)} are not CDR with a ros2msg definition, as ROS 2 writes; "
            "convert the log with `ros2 bag convert`"
        ) from error
    except Exception as error:  # the packages raise whatever the damaged bytes lead to
        raise _damaged(path, file, error) from error
    for topic, found in messages.items():
        if not found:
            raise InputError(f"{path}: topic {topic} has no messages; record again")
    return series


def _plain(message: Any) -> _JointState | _Pose:
    if hasattr(message, "pose"):
        at, turn = message.pose.position, message.pose.orientation
        return _Pose((float(at.x), float(at.y), float(at.z)), tuple(map(float, (turn.w, turn.x, turn.y, turn.z))))
    numbers = (tuple(map(float, part)) for part in (message.position, message.velocity, message.effort))
    return _JointState(tuple(map(str, message.name)), *numbers)


def _joint_states(path: Path, topic: str, series: _Series, dof: int | None, notes: list[str]) -> _JointStates:
    seen = list(dict.fromkeys(name for message in series.messages for name in message.name))
    if not seen:
        raise InputError(f"{path}: the messages of {topic} name no joints; record them with names")
    names, order = _ordered(seen, dof)
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
    columns: dict[str, Array] = {}
    for field, pattern in (("position", "q{}_rad"), ("velocity", "dq{}_rad_per_s"), ("effort", "tau{}_Nm")):
        block = _block([series.messages[k] for k in whole], names, field)
        if field != "position" and (block is None or not block.any() or not np.isfinite(block).all()):
            continue
        assert block is not None
        columns |= {pattern.format(joint + 1): block[:, joint] for joint in range(len(names))}
        if field == "effort":
            notes.append(f"the efforts of {topic} are taken as torques in N m")
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


def _ordered(seen: Sequence[str], dof: int | None) -> tuple[list[str], str]:
    """The arm's joints along it, and in words by what order."""
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


def _interpolated(
    path: Path, state: _JointStates, stamp: Stamps, notes: list[str]
) -> tuple[NDArray[np.bool_], dict[str, Array]]:
    """Which poses have joint states around them, and the joints' columns there."""
    if len(state.stamp) < 2:
        raise InputError(f"{path}: has {len(state.stamp)} joint states at different times; record at least 2")
    gap = np.diff(state.stamp)
    before = np.clip(np.searchsorted(state.stamp, stamp, side="right") - 1, 0, len(gap) - 1)
    outside = (stamp < state.stamp[0]) | (stamp > state.stamp[-1])
    exact = (stamp == state.stamp[before]) | (stamp == state.stamp[before + 1])
    wide = ~outside & ~exact & (gap[before] > LONGEST_GAP * np.median(gap))
    kept = ~(outside | wide)
    if not kept.any():
        base = min(state.stamp[0], stamp.min())
        joints, poses = (
            f"{_seconds(s.min(), base):.3f} to {_seconds(s.max(), base):.3f} s" for s in (state.stamp, stamp)
        )
        raise InputError(
            f"{path}: no pose lies between joint states (joints {joints}, poses {poses}); stamp both by one clock"
        )
    notes.append("the joints are interpolated linearly to the stamps of the poses")
    for count, reason in (
        (int(outside.sum()), "before the first or after the last joint state"),
        (int(wide.sum()), f"between joint states over {LONGEST_GAP:g} median steps apart"),
    ):
        if count:
            notes.append(f"dropped {count} poses {reason}")
    share = (stamp - state.stamp[before])[kept] / gap[before[kept]]
    low, high = before[kept] + (share == 1), before[kept] + (share > 0)  # at a joint state its neighbours do not matter
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite stays so, and its rows are dropped
        return kept, {name: column[low] * (1 - share) + column[high] * share for name, column in state.columns.items()}


def _seconds(stamp: Any, start: Any) -> Any:
    """Seconds from a start: the difference is taken in whole ns, of which a float would lose hundreds."""
    return (stamp - start) / 1e9
