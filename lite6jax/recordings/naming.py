"""What people's own column names say: which columns are joint positions, poses, torques, times, and in which unit.

Names are split into words (`actual_TCP_pose_0`, `joint_1.position`, `/arm/q[3]`), words into a quantity, a number or a
component, and columns that differ only in that are one block. What no name says is left to the numbers (`sizes.py`).
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple, final

from lite6jax.recordings.columns import ANGLES, QUATERNION, units_of
from lite6jax.recordings.ros import UR_JOINTS

VECTOR, RPY, XYZ, ZYZ = ANGLES

_MEASURED = {"actual", "measured", "feedback", "real", "act", "meas", "present"}
_WANTED = {"target", "commanded", "command", "cmd", "desired", "goal", "setpoint", "reference", "ref", "action", "des"}
_UNUSED = {
    *("force", "wrench", "ft", "error", "err", "residual", "std", "sigma", "var", "cov", "covariance", "status"),
    *("mode", "bits", "voltage", "digital", "analog", "power", "gripper", "finger", "reward", "done", "success"),
    *("task", "next"),
    *("frame", "accelerometer", "momentum", "sec", "nanosec", "secs", "nsecs", "seq", "twist", "linear", "angular"),
    *("offset", "inertia", "cog"),
}
_QUANTITIES = {
    "temp": {"temp", "temperature", "temperatures"},
    "current": {"current", "currents", "amps"},
    "tau": {"tau", "torque", "torques", "effort", "efforts", "trq", "moment", "moments"},
    "ddq": {"ddq", "qdd", "qddot", "acc", "accel", "acceleration", "accelerations", "ddot"},
    "dq": {"dq", "qd", "qdot", "vel", "velocity", "velocities", "speed", "speeds", "dot"},
}
_JOINT = {"q", "joint", "joints", "jnt", "axis", "achse", "gelenk", "theta", "th", "angle", "angles", "servo", "motor"}
_PLACE = {"position", "positions", "pos", "translation"}
_POSE = {"pose", "tcp", "tool", "ee", "eef", "effector", "flange", "cartesian", "cart", "tracker", "marker", "point"}
_TURNED = {"orientation", "quaternion", "quat", "rotation", "rot", "rotvec", "euler", "rpy", "attitude", "ori"}
_SCALARS = {
    "time": {"time", "timestamp", "datetime", "t", "stamp", "elapsed", "clock"},
    "payload": {"payload"},
    "ambient": {"ambient"},
    "run": {"run", "episode", "trial", "segment"},
}
_UNITS = {
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), "deg"),
    **dict.fromkeys(("rad_per_s", "rad/s", "rads", "radps"), "rad_per_s"),
    **dict.fromkeys(("deg_per_s", "deg/s", "dps", "degps"), "deg_per_s"),
    **dict.fromkeys(("rad_per_s2", "rad/s2", "rad/s^2", "rad/s²"), "rad_per_s2"),
    **dict.fromkeys(("deg_per_s2", "deg/s2", "deg/s^2", "deg/s²"), "deg_per_s2"),
    **dict.fromkeys(("m_per_s", "m/s", "mps"), "m_per_s"),
    **dict.fromkeys(("mm_per_s", "mm/s"), "mm_per_s"),
    **dict.fromkeys(("m_per_s2", "m/s2", "m/s^2", "m/s²"), "m_per_s2"),
    **dict.fromkeys(("mm_per_s2", "mm/s2", "mm/s^2", "mm/s²"), "mm_per_s2"),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("nm", "n_m", "n.m", "n*m"), "Nm"),
    **dict.fromkeys(("mnm",), "mNm"),
    **dict.fromkeys(("n", "newton", "newtons"), "N"),
    **dict.fromkeys(("kn",), "kN"),
    **dict.fromkeys(("a", "amp", "amps", "ampere"), "A"),
    **dict.fromkeys(("ma",), "mA"),
    **dict.fromkeys(("s", "sec", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "usec", "µs", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nanoseconds"), "ns"),
    **dict.fromkeys(("degc", "c", "celsius", "°c"), "degC"),
    **dict.fromkeys(("kg",), "kg"),
}
_UNIT = re.compile(
    rf"[\s_.\[(/-]+({'|'.join(sorted(map(re.escape, _UNITS), key=len, reverse=True))})[\])]*\s*$", re.IGNORECASE
)
_SPLIT_STAMP = re.compile(r"stamp\W*_?n?(?:ano)?secs?\s*$", re.IGNORECASE)
_ROBOTS = (UR_JOINTS, ("base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3"))
"""Names of all joints in their order: of Universal Robots' driver, and on their teach pendant."""
_LETTERS = {
    "a": re.compile(r"curr|amp", re.IGNORECASE),
    "c": re.compile(r"temp|ambient", re.IGNORECASE),
    "n": re.compile(r"tau|torque|effort|trq|force", re.IGNORECASE),
}
"""Units that are letters by which columns are numbered too, with the words beside which they are units."""
_ALLOWED = {
    "q": {"rad", "deg"},
    "dq": {"rad_per_s", "deg_per_s"},
    "ddq": {"rad_per_s2", "deg_per_s2"},
    "tau": {"Nm", "mNm"},
    "current": {"A", "mA"},
    "temp": {"degC"},
    "position": {"m", "mm"},
    "rotation": {"rad", "deg"},
    "time": {"s", "ms", "us", "ns"},
    "payload": {"kg"},
    "ambient": {"degC"},
    "run": set(),
}
KINDS = tuple(_ALLOWED)
_AXES = {axis: k for k, axis in enumerate("xyz")}
_COMPONENTS = {"qw": "w", "qx": "x", "qy": "y", "qz": "z", "ow": "w", "ox": "x", "oy": "y", "oz": "z"}
_NUMBERS = "abcdefgh"
"""Letters that number joints."""
_SEPARATE = {"rx": 0, "ry": 1, "rz": 2}
_NAMED = {"roll": 0, "pitch": 1, "yaw": 2}


@final
@dataclass(frozen=True)
class Block:
    """Columns that belong together.

    Attributes:
        kind: one of `KINDS`; `position` and `rotation` of the tool, the others as in `columns.py`.
        columns: along the arm; x y z; the rotation's components, a quaternion's as `form` says.
        unit: that the names say; None where they do not.
        form: of a rotation, the names that it has in `columns.py`; None where names do not say it.
        rivals: the first columns of blocks that may be meant instead.
        joints: whose the columns are, counted from 1; empty where they are of all joints in order, or of none.
        slides: whether these joints are prismatic.
    """

    kind: str
    columns: tuple[str, ...]
    unit: str | None = None
    form: tuple[str, ...] | None = None
    rivals: tuple[str, ...] = ()
    joints: tuple[int, ...] = ()
    slides: bool = False


class _Word(NamedTuple):
    """A name taken apart: what its block shares, the number or component, and the unit."""

    name: str
    words: tuple[str, ...]
    number: int | None
    component: str | None
    unit: str | None


def blocks(names: Sequence[str]) -> list[Block]:
    """The blocks that names show, at most one of each kind: what was measured rather than what was wanted.

    Args:
        names: of the columns that hold numbers, in order.
    """
    words = [_taken_apart(name) for name in names]
    found = [*_of_robots_with_names(words)]
    used = {name for block in found for name in block[2].columns}
    words = [word for word in words if word.name not in used and not _UNUSED & set(word.words)]
    found += [*_scalars(words), *_components(words), *_numbered(words)]
    return _chosen(found)


_Ranked = tuple[int, int, Block]
"""How far from measured, how weak the name is, and the block."""


def units_allowed(kind: str, slides: bool = False) -> set[str]:
    """The units that a kind of block may have."""
    return set(units_of(kind, True)) if slides else _ALLOWED[kind]


def unit_of(name: str) -> str | None:
    """The unit that a column's name states; None where it states none."""
    return _taken_apart(name).unit


def _taken_apart(name: str) -> _Word:
    text, unit = name, None
    match = _UNIT.search(name)
    if match and _SPLIT_STAMP.search(name):
        match = None  # whole seconds alone are no time
    letter = None if match is None else _LETTERS.get(match[1])  # pose_a, pose_b, pose_c are angles
    if match and (letter is None or letter.search(name)):
        text, unit = name[: match.start()], _UNITS[match[1].lower()]
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", text)
    parts = re.findall(r"[a-z]+|\d+", spaced.lower())
    number, component = None, None
    letters = [k for k, part in enumerate(parts) if part in _NUMBERS] if _JOINT & set(parts) else []
    if len(letters) == 1 and not any(map(str.isdecimal, parts)):  # axis_A … axis_F
        number = _NUMBERS.index(parts.pop(letters[0])) + 1
    elif parts and parts[-1] in {*_AXES, "w", *_COMPONENTS, *_SEPARATE, *_NAMED, "a", "b", "c", "p", "r"}:
        component = parts.pop()
    else:
        at = [k for k, part in enumerate(parts) if part.isdecimal()]
        if at:
            number = int(parts.pop(at[-1])[:9])
    return _Word(name, tuple(parts), number, component, unit)


def _quantity(words: Iterable[str]) -> str | None:
    """What words say is measured at a joint; None where they say nothing of one."""
    listed = list(words)
    present = set(listed)
    if listed and listed[0] == "current" and present & {*_JOINT, *_PLACE, *_POSE}:
        present = present - {"current"} if not present <= {"current", "joint", "motor"} else present
    for quantity, said in _QUANTITIES.items():
        if said & present:
            return quantity
    return "q" if present & {*_JOINT, *_PLACE, "j", "a", "state"} else None


def _rank(words: Iterable[str]) -> int:
    present = set(words)
    return 2 if present & _WANTED else 0 if present & _MEASURED else 1


def _unit_of(kind: str, words: Sequence[_Word]) -> str | None:
    units = {word.unit for word in words}
    unit = units.pop() if len(units) == 1 else None
    return unit if unit in _ALLOWED[kind] else None


def _of_robots_with_names(words: Sequence[_Word]) -> list[_Ranked]:
    """Joints without numbers: Universal Robots' names, and those of a LeRobot data set's state, in their order."""
    found: list[_Ranked] = []
    by_frame: dict[tuple[tuple[str, ...], str, str], dict[str, str]] = {}
    for robot, word in product(_ROBOTS, words):
        text = "_".join(re.findall(r"[a-z]+|\d+", word.name.lower()))
        for part in robot:
            if part in text:
                before, _, after = text.partition(part)
                by_frame.setdefault((robot, before, after), {})[part] = word.name
    for (robot, before, after), joints in by_frame.items():
        if len(joints) == len(robot):
            said = [*before.split("_"), *after.split("_")]
            columns = tuple(joints[part] for part in robot)
            members = [word for word in words if word.name in columns]
            kind = _quantity([part for part in said if part]) or "q"
            found.append((_rank(said), 0, Block(kind, columns, _unit_of(kind, members))))
    taken = {name for _, _, block in found for name in block.columns}
    for prefix, rank in ((("observation", "state"), 0), (("action",), 2)):
        members = [
            word
            for word in words
            if word.words[: len(prefix)] == prefix
            and len(word.words) > len(prefix)
            and word.number is None
            and word.component is None
            and word.name not in taken
            and not _UNUSED & set(word.words)
        ]
        if len(members) > 1:
            columns = tuple(word.name for word in members)
            found.append((rank, 1, Block("q", columns, _unit_of("q", members))))
    return found


def _scalars(words: Sequence[_Word]) -> list[_Ranked]:
    found: list[_Ranked] = []
    for word in words:
        if word.component is not None or (word.number is not None and len(word.words) > 1):
            continue
        for kind, said in _SCALARS.items():
            if said & set(word.words) and word.number is None:
                weak = len(set(word.words) - said - {"index", "s", "header"})
                found.append((1, weak, Block(kind, (word.name,), _unit_of(kind, [word]))))
                break
    return found


def _components(words: Sequence[_Word]) -> list[_Ranked]:
    """Positions and rotations whose columns end in x, y, z, w, roll, rx and the like."""
    groups: dict[tuple[str, ...], dict[str, _Word]] = {}
    for word in words:
        if word.component is not None and _quantity(set(word.words) - {*_POSE, *_PLACE}) in (None, "q"):
            groups.setdefault(word.words, {}).setdefault(word.component, word)
    found: list[_Ranked] = []
    for said, group in groups.items():
        turned = bool(_TURNED & set(said))
        rank, weak = _rank(said), 0 if _POSE & set(said) or not said else 1
        separate = {_COMPONENTS[part]: word for part, word in group.items() if part in _COMPONENTS}
        quaternion = separate or ({part: group[part] for part in "wxyz" if part in group} if turned else {})
        if {*quaternion} == {*"wxyz"}:
            members = [quaternion[part] for part in "wxyz"]
            found.append((rank, weak, Block("rotation", _names(members), None, QUATERNION)))
        elif turned and {*"xyz"} <= {*group}:
            members = [group[part] for part in "xyz"]
            form = VECTOR if "rotvec" in said else RPY if "rpy" in said else None
            found.append((rank, weak, Block("rotation", _names(members), _unit_of("rotation", members), form)))
        if not turned and {*"xyz"} <= {*group}:
            members = [group[part] for part in "xyz"]
            found.append((rank, weak, Block("position", _names(members), _unit_of("position", members))))
        for parts, form in (
            (tuple(_NAMED), RPY),
            (tuple(_SEPARATE), None),
            (("w", "p", "r"), RPY),
            (("c", "b", "a"), RPY),
        ):
            if {*parts} <= {*group}:
                members = [group[part] for part in parts]
                found.append((rank, weak, Block("rotation", _names(members), _unit_of("rotation", members), form)))
    return found


def _numbered(words: Sequence[_Word]) -> list[_Ranked]:
    """Blocks whose columns differ in a number: joints, or a pose of six or seven numbers."""
    groups: dict[tuple[str, ...], dict[int, _Word]] = {}
    for word in words:
        if word.number is not None:
            groups.setdefault(word.words, {}).setdefault(word.number, word)
    found: list[_Ranked] = []
    for said, group in groups.items():
        count, rank = len(group), _rank(said)
        if sorted(group) not in ([*range(count)], [*range(1, count + 1)]):
            continue
        members = [group[number] for number in sorted(group)]
        posed = bool(_POSE & set(said))
        kind = _quantity(set(said) - _POSE if posed else said)
        if posed and kind in (None, "q") and not _JOINT & set(said):
            found += [(rank, 0, block) for block in _of_pose(members)]
        elif posed:
            continue  # velocities and forces of the tool
        elif _TURNED & set(said) and count in (3, 4):
            found += [(rank, 0, Block("rotation", _names(members), _unit_of("rotation", members)))]
        elif kind is not None:
            strong = kind != "q" or bool({*_JOINT} & set(said))
            found.append((rank, 0 if strong else 1, Block(kind, _names(members), _unit_of(kind, members))))
    return found


def _of_pose(members: Sequence[_Word]) -> list[Block]:
    """Three numbers of a position, and three or four of a rotation."""
    if len(members) not in (3, 6, 7):
        return []
    position, rotation = members[:3], members[3:]
    blocks = [Block("position", _names(position), _unit_of("position", position))]
    return blocks + ([Block("rotation", _names(rotation), _unit_of("rotation", rotation))] if rotation else [])


def _chosen(found: Sequence[_Ranked]) -> list[Block]:
    """Of each kind the block that was measured and is named most clearly, with what it was preferred to."""
    chosen = []
    joints = {block.columns for _, _, block in found if block.kind == "q"}
    for kind in KINDS:
        candidates = sorted((entry for entry in found if entry[2].kind == kind), key=lambda entry: entry[:2])
        if kind == "position" and not candidates:  # position_0 … position_2 beside joints of another name
            candidates = [entry for entry in found if entry[2].kind == "q" and len(entry[2].columns) == 3]
            candidates = [entry for entry in candidates if entry[1] == 1 and len(joints) > 1]
            candidates = [(rank, weak, replace(block, kind=kind)) for rank, weak, block in candidates]
        if not candidates:
            continue
        rank, weak, block = candidates[0]
        rivals = tuple(other.columns[0] for r, w, other in candidates[1:] if (r, w) == (rank, weak))
        chosen.append(replace(block, rivals=rivals))
    return chosen


def _names(members: Iterable[_Word]) -> tuple[str, ...]:
    return tuple(word.name for word in members)
