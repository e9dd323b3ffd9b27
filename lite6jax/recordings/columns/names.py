"""What people's own column names may say: all blocks of columns that could be joints, poses, torques or times.

Names are split into words (`actual_TCP_pose_0`, `joint_1.position`, `/arm/q[3]`), words into a quantity, a number or a
component, and columns that differ only in that are one block. A unit in a name binds: no other quantity may have it.
Which blocks are taken is decided for the table as a whole (`inspection`), where the numbers may object.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Literal, NamedTuple
from unicodedata import combining, normalize

import numpy as np

from lite6jax.recordings.columns.column import (
    ANGLES,
    COMMANDS,
    KINDS,
    MATRIX,
    OF_POSES,
    PLACE,
    QUANTITIES,
    Block,
    Decision,
    Sureness,
    by_name,
    is_per_joint,
    units_allowed,
)
from lite6jax.recordings.columns.documented import is_standard

Role = Literal["controller", "sensor"]


def _words(text: str) -> set[str]:
    return set(text.split())


_MEASURED = _words("actual measured feedback real act meas present ist gemessen mesure mesuree medido misurato")
_WANTED = _words(
    "target targets commanded command commands cmd cmds desired demanded goal setpoint setpoints sp reference ref "
    "action des computed leader master soll sollwert "
    "nominal nom nominale theoretical theo theorique teorico"
)
_WANTED |= {"d"}  # libfranka
_SENDS = _words("control controls ctrl commanding")
"""Words by which files of commands are called beside those of columns."""
_ERRORS = _words("err error errors")
_DEVIATIONS = _ERRORS | _words("deviation deviations dev abweichung abw difference diff delta ecart desviacion fehler")
_UNUSED = _words(
    "force wrench ft error err residual std sigma var cov covariance status mode bits voltage digital analog power "
    "gripper finger reward done success task next frame accelerometer momentum sec nanosec secs nsecs seq twist linear "
    "angular offset inertia cog com imu gyro mag gravity normal"
)
_QUANTITIES = {kind: QUANTITIES[kind].words for kind in ("temp", "current", "tau", "ddq", "dq")}
"""What is measured at a joint besides its position, in the order in which words are asked for."""
_JOINT = QUANTITIES["q"].words
_EXTERNAL = _words("ext external extax eax")
"""Axes beside the arm, and torques from outside."""
_PLACE = _words("position positions pos")
_MOVED = _words("translation trans tvec xyz")
_TURNED = _words("orientation quaternion quat rotation rot rotvec rvec euler rpy attitude ori")
_CONTROLLER = _words("tcp tool ee eef effector flange robot controller fk rtde")
_SENSOR = _words(
    "tracker marker leica laser lt faro vicon optitrack mocap motive qualisys tag apriltag aruco charuco board camera "
    "cam sensor reflector smr probe polaris ndi meas measured"
)
_POSE = _words("pose cartesian cart point tracker marker") | (_CONTROLLER - {"robot", "controller", "rtde"})
_SHARED = _PLACE | _MOVED | _TURNED | _words("pose cartesian cart point data header matrix transform")
"""Words that do not say whose a pose is."""
_TIMES = QUANTITIES["time"].words
_CLOCKS = _words("t index s header robot ros sys system host pc local unix epoch rel")
"""Beside which `t` is a time still."""
_AIR = QUANTITIES["ambient"].words
_RUNS = QUANTITIES["run"].words
_READINGS = {kind: QUANTITIES[kind].words for kind in ("contact", "plane", "anchor", "distance", "axis")}
"""Words by which people call readings that are no poses."""
_LENGTHS = {
    "rad": "rad radian radians",
    "deg": "deg degree degrees °",
    "m": "m meter meters metre metres",
    "mm": "mm millimeter millimeters millimetre millimetres",
    "mrad": "mrad milliradian milliradians",
    "cdeg": "cdeg centideg centidegree centidegrees 0.01deg 0.01°",
    "mdeg": "mdeg millideg millidegree millidegrees 0.001deg 0.001° m°",
    "1e-4deg": "1e-4deg 0.0001deg 0.0001°",
    "cm": "cm centimeter centimeters centimetre centimetres",
    "dmm": "dmm 0.1mm",
    "um": "um µm μm micron microns micrometer micrometers micrometre micrometres 0.001mm",
}
_RATES = {"per_s": "{}_per_s {}/s {}ps", "per_s2": "{}_per_s2 {}/s2 {}/s^2 {}/s²"}
_OTHERS = {
    "Nm": "nm n_m n.m n*m",
    "mNm": "mnm",
    "N": "n newton newtons",
    "kN": "kn",
    "A": "a amp amps ampere",
    "mA": "ma",
    "s": "s sec second seconds",
    "ms": "ms msec milliseconds",
    "us": "us usec µs microseconds",
    "ns": "ns nsec nanoseconds",
    "degC": "degc c celsius °c",
    "kg": "kg",
    "rad_per_s": "rads",
    "deg_per_s": "dps",
}
_UNITS = {word: unit for unit, words in (_LENGTHS | _OTHERS).items() for word in words.split()}
_UNITS |= {
    form.format(word): f"{unit}_{rate}"
    for (unit, words), (rate, forms) in product(_LENGTHS.items(), _RATES.items())
    for word, form in product(words.split(), forms.split())
}
_UNITS |= {re.sub(r"^([\d.]+)", r"\1 ", word): unit for word, unit in _UNITS.items() if word.startswith("0.")}
"""Units as `QUANTITIES` has them, by how people write them."""
_UNIT = re.compile(
    rf"[\s_.\[(/-]+({'|'.join(sorted(map(re.escape, _UNITS), key=len, reverse=True))})[\])]*\s*$", re.IGNORECASE
)
_SPLIT_STAMP = re.compile(r"stamp\W*_?n?(?:ano)?secs?\s*$", re.IGNORECASE)
_LETTERS = {
    "a": re.compile(r"curr|amp|[\[(]", re.IGNORECASE),
    "c": re.compile(r"temp|ambient|(?:^|_)t(?:_|$)|[\[(]", re.IGNORECASE),
    "n": re.compile(r"tau|torque|effort|trq|force|[\[(]", re.IGNORECASE),
    "s": re.compile(r"t|stamp|clock|elapsed|[\[(]", re.IGNORECASE),
}
"""Units that are letters by which columns are numbered too, with what stands beside them where they are units."""
_GREEK = str.maketrans(
    {"θ": " theta ", "ϑ": " theta ", "τ": " tau ", "Δ": " delta ", "ω": " dq ", "α": " alpha ", "β": " beta "}
)
_FRANKA_TWIST = re.compile(r"(?<![A-Za-z])d{1,2}P(?=_)")
"""Of libfranka's `O_dP_EE_d`, the velocity of the end effector, and `O_ddP_EE_c`, its acceleration."""
UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Along Universal Robots' arms, whose drivers publish them in alphabetical order."""
_ROBOTS = (
    UR_JOINTS,
    ("base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3"),
    ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"),
    tuple("sleurbt"),
    tuple("slurbt"),
)
"""Names of all joints in their order: Universal Robots' driver and teach pendant, LeRobot's SO-100, Yaskawa's axes."""
_AXIS = re.compile(r"(?P<point>.*?)[\s_.:/\[-]*(?P<axis>[xyz])[\s_.\[(/-]*(?P<unit>mm|m|met(?:er|re)s?)?[\])\s]*", re.I)
_NO_POINT = re.compile(r"rot|ori|quat|euler|rpy|vel|acc|force|torque|twist|angular|(?:^|[^a-z])[rqwa]$", re.I)
"""In names of triples that are no points."""
_NUMBERS = "abcdefgh"
"""Letters that number joints."""
_COMPONENT = re.compile(r"(?:p|t|pos|q|o|quat|r|rot)?[wxyz]|d[xyz]|roll|pitch|yaw|alpha|beta|gamma")
_IMPLIED = {"p": "position", "t": "translation", "pos": "position", "q": "quat", "o": "quat", "quat": "quat"}
_IMPLIED |= {"d": "delta"}
_TRIPLES: tuple[tuple[tuple[str, ...], str, Sureness], ...] = (
    (("roll", "pitch", "yaw"), "roll", "likely"),
    (("rx", "ry", "rz"), "", "assumed"),
    (("alpha", "beta", "gamma"), "", "assumed"),
    (("w", "p", "r"), "roll", "likely"),
    (("c", "b", "a"), "roll", "assumed"),
    (("a", "b", "c"), "roll", "assumed"),
)
"""Components of three angles, their usual form, and how sure that is: A B C is KUKA's order or Mitsubishi's."""


class Source(NamedTuple):
    """A pose by one source: its position, the readings of its orientation of which one is right, and a deviation.

    The deviation may be that of the measured position from this one.
    """

    position: Block
    rotations: tuple[Block, ...]
    deviation: Block | None = None

    @property
    def role(self) -> Role | None:
        """Whose the pose is by its name: the controller's, a sensor's, or not said."""
        words = set(self.position.source)
        if words & _CONTROLLER and not words & _SENSOR - _MEASURED:
            return "controller"  # `measured_tcp_x` too
        return "sensor" if words & _SENSOR else None


class _SplitName(NamedTuple):
    """A name taken apart: what its block shares, the number or component, the unit, and all of its words."""

    name: str
    words: tuple[str, ...]
    number: int | None
    component: str | None
    unit: str | None
    all_words: tuple[str, ...]


def candidate_blocks(names: Sequence[str], joint_names: Sequence[str] = ()) -> list[Block]:
    """The blocks that names may mean; a column may be in several.

    Args:
        names: of the columns that hold numbers, in order.
        joint_names: of the arm, along it, where it has some.
    """
    words = [_split_name(name) for name in names]
    blocks = [*_joint_labels(words, joint_names)]
    labelled = {name for block in blocks for name in block.columns}
    words = [word for word in words if word.name not in labelled and not _is_unused(word)]
    blocks += [*_matrices(words), *_scalars(words), *_components(words), *_numbers(words)]
    if not any(block.kind == "q" for block in blocks):
        blocks += _unnumbered(words)
    place = {name: k for k, name in enumerate(names)}
    return sorted(blocks, key=lambda block: min(place[name] for name in block.columns))


def _is_unused(word: _SplitName) -> bool:
    """Tells whether words say that a column is of nothing that is read here; errors of a position may be deviations."""
    unused = _UNUSED & {*word.all_words}
    return bool(unused - _ERRORS) or bool(unused and word.component not in PLACE)


def choose_blocks(blocks: Sequence[Block], dof: int | None = None, joints: Sequence[str] = ()) -> list[Block]:
    """Chooses of each kind but poses the measured block that is named most clearly, with what it was preferred to.

    What was commanded or computed is taken only where nothing measured says the same. Positions that were commanded
    beside measured ones are of the kind `cmd`, and velocities without such positions of the kind `cmd_dq`.

    Args:
        blocks: of `candidate_blocks`.
        dof: the number of joints, where known; fewer columns are not those of all joints.
        joints: columns that are said to be joint positions.
    """
    chosen: dict[str, Block] = {}
    driven = any(b.kind in ("tau", "current") and b.rank < 2 and len(b.columns) >= (dof or 0) for b in blocks)
    for kind in (kind for kind in KINDS if kind not in OF_POSES):
        q = chosen.get("q")
        moved = q is not None and q.rank < 2
        used = {name for block in chosen.values() for name in block.columns}
        pool = [block for block in blocks if block.kind == kind and not used & set(block.columns)]
        if kind == "cmd":  # beside measured positions
            pool += [block for block in blocks if block.kind == "q" and block.rank == 2 and not used & {*block.columns}]
            pool = [replace(block, kind=kind) for block in pool if moved]
        elif kind == "cmd_dq":
            pool += [
                block for block in blocks if block.kind == "dq" and block.rank == 2 and not used & {*block.columns}
            ]
            pool = [replace(block, kind=kind) for block in pool if moved and "cmd" not in chosen]
        elif (driven and kind in ("tau", "current")) or (moved and kind in ("dq", "ddq")):  # what was measured says it
            pool = [block for block in pool if block.rank < 2]
        side = {*q.source} if q is not None and is_per_joint(kind) else set()
        clear = {block.columns: (block.rank, -len(side & {*block.source}), block.weak) for block in pool}
        pool.sort(key=lambda block: clear[block.columns])
        if is_per_joint(kind):
            of_all = dof or len(q.columns if q is not None and kind in COMMANDS else ())
            pool.sort(key=lambda block: (len(block.columns) < of_all, block.rank == 2, len(block.columns) != of_all))
        if kind == "q" and joints:
            pool.sort(key=lambda block: not {*joints} <= {*block.columns})
        if pool:
            rivals = [block for block in pool[1:] if clear[block.columns] == clear[pool[0].columns]]
            chosen[kind] = replace(pool[0], rivals=tuple(block.columns[0] for block in rivals))
    return list(chosen.values())


def pose_sources(blocks: Sequence[Block]) -> list[Source]:
    """The poses among blocks, each of one source; what was commanded only where nothing was measured."""
    places = [block for block in blocks if block.kind == "position"]
    places = [block for block in places if block.weak < 2] or places
    places = [block for block in places if block.rank < 2] or places
    turns = [block for block in blocks if block.kind == "rotation"]
    listed = []
    for place in places:
        rotations = [block for block in turns if block.source == place.source]
        if not rotations and len(places) == 1 and {block.source for block in turns} == {()}:
            rotations = turns  # beside `tool_x tool_y tool_z` are `roll pitch yaw`
        deviations = [block for block in blocks if block.kind == "deviation" and block.source == of_whom(place.source)]
        listed.append(Source(place, tuple(rotations), deviations[0] if len(deviations) == 1 else None))
    return listed


def unit_of(name: str) -> str | None:
    """The unit that a column's name states; None where it states none."""
    return _split_name(name).unit


def reading_words(name: str) -> set[str]:
    """The quantities of readings that the words of a column's name may mean, of `READINGS`."""
    spoken = spoken_words(name)
    return {quantity for quantity, words in _READINGS.items() if words & spoken}


def spoken_words(name: str) -> set[str]:
    """The words of a name, whatever letters they are of."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", normalize("NFKC", name))
    return {*re.findall(r"[^\W\d_]+", spaced.lower())}


def list_points(names: Sequence[str]) -> list[tuple[str, str, str]]:
    """The columns x y z of each point that has a name, as of reflectors on a body."""
    by_point: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        if (match := _AXIS.fullmatch(name.strip())) and match["point"] and not _NO_POINT.search(match["point"]):
            key = match["point"], (match["unit"] or "").lower()
            by_point.setdefault(key, {}).setdefault(match["axis"].lower(), name)
    return [(axes["x"], axes["y"], axes["z"]) for axes in by_point.values() if len(axes) == 3]


def is_of_gripper(name: str) -> bool:
    """Tells whether a column's name is of a gripper, whose opening is no angle of an arm's joint."""
    return bool({"gripper", "finger", "jaw"} & {*_split_name(name).all_words})


def says_commanded(name: str) -> bool:
    """Tells whether a name is of what was commanded, and not of what was measured."""
    words = {*_split_name(name).all_words}
    return bool(words & _WANTED) and not words & _MEASURED


def tells_of_commands(text: str) -> bool:
    """Tells whether the name of a file, or a word in its cells, says that it has the commands."""
    return says_commanded(text) or not _SENDS.isdisjoint(spoken_words(text))


def says_torque(name: str) -> bool:
    """Tells whether a column's own name is of a torque, and not of an effort, which may be a current too."""
    return not {"effort", "efforts"} & {*_split_name(name).all_words} and not is_standard(name)


def source_words(names: Iterable[str]) -> tuple[str, ...]:
    """The words by which the columns of one pose say whose it is."""
    listed = [_split_name(name).words for name in names]
    return tuple(word for word in _source(listed[0]) if all(word in words for words in listed))


def _split_name(name: str) -> _SplitName:
    text = name
    unit = None
    match = _UNIT.search(name)
    if match and _SPLIT_STAMP.search(name):
        match = None  # whole seconds alone are no time
    letter = None if match is None else _LETTERS.get(match[1].lower())  # pose_a, pose_b, pose_c are angles
    if match and (letter is None or letter.search(name[: match.start(1)])):
        text = name[: match.start()]
        unit = _UNITS[match[1].lower()]
    plain = "".join(letter for letter in normalize("NFKD", text.translate(_GREEK)) if not combining(letter))
    plain = _FRANKA_TWIST.sub("twist", plain)
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", plain)
    all_words = tuple(re.findall(r"[a-z]+|\d+", spaced.lower()))
    parts = [*all_words]
    number = None
    component = None
    letters = [k for k, part in enumerate(parts) if part in _NUMBERS] if _JOINT & set(parts) else []
    places = [k for k, part in enumerate(parts) if _COMPONENT.fullmatch(part)]
    digits = [k for k, part in enumerate(parts) if part.isdecimal()]
    if len(letters) == 1 and not digits:  # axis_A … axis_F
        number = _NUMBERS.index(parts.pop(letters[0])) + 1
    elif places:
        component = parts.pop(at := places[-1])
        if at and len(component) == 1 and parts[at - 1] in {*"ptqrd"}:
            component = parts.pop(at - 1) + component  # q_w is qw
        implied = next((word for start, word in _IMPLIED.items() if component in {start + axis for axis in "wxyz"}), "")
        component, parts = (component[-1], [*parts, implied]) if implied else (component, parts)
    elif parts and parts[-1] in {*"abcpr"}:
        component = parts.pop()
    elif digits:
        number = int(parts.pop(digits[-1])[:9])
    return _SplitName(name, tuple(parts), number, component, unit, all_words)


def _quantity(words: Iterable[str], units: Iterable[str | None] = ()) -> str | None:
    """What words and units say is measured at a joint; None where they say nothing of one, or contradict."""
    listed = list(words)
    present = set(listed)
    if listed and listed[0] == "current" and present & {*_JOINT, *_PLACE, *_POSE}:
        present = present - {"current"} if not present <= {"current", "joint", "motor"} else present
    quantity = next((quantity for quantity, keywords in _QUANTITIES.items() if keywords & present), None)
    if "qfrc" in present and "actuator" not in present:
        return None  # MuJoCo's forces of gravity, constraints and the like
    if {"current", "as", "torque"} <= present:  # Universal Robots' actual_current_as_torque
        quantity = "tau"
    if quantity is None and present & {*_JOINT, *_PLACE, "a", "state"}:
        quantity = "q"
    stated = {*units} - {None}
    if not stated or (quantity is not None and stated <= units_allowed(quantity, False, True)):
        return quantity
    bound = [kind for kind in KINDS[:6] if stated <= units_allowed(kind)]
    return bound[0] if quantity in (None, "q") and len(bound) == 1 else None


def _block(kind: str, words: Sequence[_SplitName], stem: Sequence[str], **options: object) -> Iterator[Block]:
    """Columns as a block, unless their units are of something else."""
    units = {word.unit for word in words}
    unit = units.pop() if len(units) == 1 else None
    if not (units | {unit}) - {None} <= units_allowed(kind, False, True):
        return
    present = set(stem)
    rank = 1
    if present & _WANTED:
        rank = 2
    elif present & _MEASURED:
        rank = 0
    stated = by_name(unit) if unit in units_allowed(kind) else None
    options = {"rank": rank, "unit": stated, "source": _side(stem)} | options
    yield Block(kind, tuple(word.name for word in words), **options)  # type: ignore


def _side(words: Iterable[str]) -> tuple[str, ...]:
    """The words that say whose joints columns are, such as `left`."""
    spoken = {*_JOINT, *_PLACE, *_MEASURED, *_WANTED}.union(*_QUANTITIES.values())
    return tuple(sorted({*words} - spoken - {""}))


def _source(words: Iterable[str], letters: str = "") -> tuple[str, ...]:
    """The words that say whose a pose is; letters such as the T of `T00` do not."""
    return tuple(sorted(set(words) - _SHARED - {*letters}))


def of_whom(source: Iterable[str]) -> tuple[str, ...]:
    """Words of a source that do not say whether it is nominal, measured or the difference."""
    return tuple(sorted({*source} - _WANTED - _MEASURED - _DEVIATIONS))


def _form(words: Iterable[str]) -> Decision | None:
    """The form of three numbers of a rotation that words say, and how sure that is."""
    if {"rotvec", "rvec"} & {*words}:
        return by_name("rx")
    return by_name("roll", "likely") if "rpy" in words else None


def _grouped(
    words: Sequence[_SplitName], index: Literal["number", "component"]
) -> dict[tuple[str, ...], dict[Any, _SplitName]]:
    """Words that differ in their number or component alone, by what they share."""
    groups: dict[tuple[str, ...], dict[Any, _SplitName]] = {}
    for word in words:
        if (at := word._asdict()[index]) is not None:
            groups.setdefault(word.words, {}).setdefault(at, word)
    return groups


def _counts(numbers: Iterable[int]) -> bool:
    """Tells whether numbers count from 0 or 1 without a gap."""
    listed = sorted(numbers)
    return listed in ([*range(len(listed))], [*range(1, len(listed) + 1)])


def _joint_labels(words: Sequence[_SplitName], joint_names: Sequence[str]) -> Iterator[Block]:
    """Joints without numbers: by the arm's own names, of known robots, and of a LeRobot data set's state, in order."""
    used: set[str] = set()
    state = [
        "_".join(word.all_words[2:])
        for word in words
        if word.all_words[:2] == ("observation", "state") and word.number is word.component is None
        if not _UNUSED & set(word.all_words)
    ]
    for weak, names in ((-1, joint_names), *((0, robot) for robot in _ROBOTS), (1, state)):
        labels = [_split_name(name).all_words for name in names]
        labels = [label[:-1] if label[-1:] == ("joint",) else label for label in labels]
        if weak < 0 and not all(any(len(part) > 1 and part not in _JOINT for part in label) for label in labels):
            continue  # numbers say which joint it is
        groups: dict[tuple[str, ...], dict[int, _SplitName]] = {}
        for (k, label), word in product(enumerate(labels), words):
            at = next(
                (i for i in range(len(word.all_words)) if label and word.all_words[i : i + len(label)] == label), None
            )
            if at is not None and word.name not in used:
                stem = (*word.all_words[:at], "", *word.all_words[at + len(label) :])
                groups.setdefault(stem, {})[k] = word
        for stem, group in groups.items():
            kind = _quantity(stem, (word.unit for word in group.values())) or "q"
            if labels and len(group) == len(labels) and not (_UNUSED | _EXTERNAL) & set(stem):
                for block in _block(kind, [group[k] for k in range(len(labels))], stem, weak=weak):
                    used |= set(block.columns)
                    yield block


def _matrices(words: Sequence[_SplitName]) -> Iterator[Block]:
    """Homogeneous and rotation matrices, by two indices (`T00`, `r_1_1`) or by one in either order (`O_T_EE_0`)."""
    pairs: dict[tuple[str, ...], dict[tuple[int, int], _SplitName]] = {}
    for word in words:
        if match := re.fullmatch(r"(.*?) ?(\d) ?(\d)", " ".join(word.all_words)):
            pairs.setdefault(tuple(match[1].split()), {})[int(match[2]), int(match[3])] = word
    layouts = []
    for (stem, group), shape, first in product(pairs.items(), ((3, 3), (3, 4), (4, 4)), (0, 1)):
        if [*sorted(group)] == [(first + i, first + j) for i, j in np.ndindex(shape)]:
            layouts.append((stem, shape, [group[at] for at in sorted(group)], "likely"))
    for stem, group in _grouped(words, "number").items():
        shape = {9: (3, 3), 12: (3, 4), 16: (4, 4)}.get(len(group))
        if shape and _counts(group) and {*stem} & {*_TURNED, "r", "t", "pose", "matrix", "transform"}:
            layouts.append((stem, shape, [group[k] for k in sorted(group)], "assumed"))
    for (stem, shape, members, sure), turned in product(layouts, (False, True)):
        grid = np.empty(len(members), object)
        grid[:] = members
        grid = grid.reshape(shape[::-1]).T if turned else grid.reshape(shape)
        source = (*_source(stem, "rto"), *("turned",) * (turned and shape != (3, 3)))
        sure = sure if shape == (3, 3) else "certain"  # of others the numbers show the order
        options = {"source": source, "weak": int(turned), "unit": None}
        options |= {"matrix": tuple(word.name for word in grid.ravel())} | ({"rank": 2} if stem[-1:] == ("c",) else {})
        yield from _block("rotation", [*grid[:3, :3].ravel()], stem, form=by_name(MATRIX[0], sure), **options)
        if shape[1] == 4:
            yield from _block("position", [*grid[:3, 3]], stem, **options)


def _scalars(words: Sequence[_SplitName]) -> Iterator[Block]:
    for word in words:
        present = set(word.words)
        stated = word.unit
        if word.component is not None or word.number is not None or not present:
            continue
        timed = stated in units_allowed("time")
        weak = len(present - _TIMES - {"index", "s", "header"})
        if present & _TIMES or (present & {"t"} and present <= _CLOCKS) or timed:
            yield from _block("time", [word], (), weak=weak if present & _TIMES else weak + 1)
        elif present & _AIR and (stated == "degC" or present & {"t", "temp", "temperature", "ambient"}):
            yield from _block("ambient", [word], ())
        elif present & QUANTITIES["payload"].words:
            yield from _block("payload", [word], (), weak=len(present) - 1)
        elif present & _RUNS:
            yield from _block("run", [word], (), weak=len(present - _RUNS - {"index"}))


def _components(words: Sequence[_SplitName]) -> Iterator[Block]:
    """Positions and rotations whose columns end in x, y, z, w, roll, rx and the like."""
    for stem, group in _grouped(words, "component").items():
        if _quantity({*stem} - {*_POSE, *_PLACE}) not in (None, "q"):
            continue
        turned = bool(_TURNED & {*stem})
        source = _source(stem)
        place = [group[axis] for axis in "xyz" if axis in group]
        if turned and {*"wxyz"} <= {*group}:
            members = [group[part] for part in "wxyz"]
            yield from _block("rotation", members, stem, form=by_name("scalar_first"), source=source)
        elif turned and len(place) == 3 and not _DEVIATIONS & {*stem}:
            yield from _block("rotation", place, stem, source=source, form=_form(stem))
        elif turned and _DEVIATIONS & {*stem}:
            continue  # of an orientation none is read
        elif len(place) == 3 and _DEVIATIONS & {*stem}:
            yield from _block("deviation", place, stem, source=of_whom(source))
        elif len(place) == 3 and not (_JOINT - {"axis"}) & {*stem}:  # X_axis is a coordinate
            weak = 0 if {*stem} & (_POSE | _CONTROLLER | _SENSOR) or not source else 1
            yield from _block("position", place, stem, source=source, weak=weak)
        for parts, form, sure in _TRIPLES:
            if {*parts} <= {*group}:
                members = [group[part] for part in parts]
                if all(is_standard(word.name) for word in members):
                    form = parts[0] if parts in ANGLES else form
                    sure = "certain"
                yield from _block("rotation", members, stem, form=by_name(form, sure) if form else None, source=source)


def _unnumbered(words: Sequence[_SplitName]) -> list[Block]:
    """`position velocity torque` of the only joint there is; none without a position."""
    alone = [word for word in words if word.number is None and word.component is None and not _side(word.words)]
    kinds = [(word, _quantity(word.words, [word.unit])) for word in alone if word.words]
    blocks = [block for word, kind in kinds if kind for block in _block(kind, [word], word.words, weak=1)]
    return blocks if any(block.kind == "q" for block in blocks) else []


def _numbers(words: Sequence[_SplitName]) -> Iterator[Block]:
    """Blocks whose columns differ in a number: joints, or a pose of six or seven numbers."""
    for stem, group in _grouped(words, "number").items():
        count = len(group)
        present = set(stem)
        if not _counts(group):
            continue
        members = [group[number] for number in sorted(group)]
        options = {"source": _source(stem, "qrt")}
        posed = bool(_POSE & present)
        turned = bool(_TURNED & present)
        kind = _quantity(present - _POSE if posed else stem, (word.unit for word in members))
        if turned and count in (3, 4):
            yield from _block("rotation", members, stem, **options, form=_form(stem) if count == 3 else None)
            continue
        if count == 4 and present <= {"q"} | _TURNED:
            yield from _block("rotation", members, stem, weak=1, **options)  # if of unit length
        if (posed or _MOVED & present) and kind in (None, "q") and not _JOINT & present:
            if count in (3, 6, 7):
                yield from _block("position", members[:3], stem, **options)
                yield from _block("rotation", members[3:], stem, **options) if count > 3 else ()
        elif present - {"data"} in ({"action"}, {"ctrl"}):
            # of LeRobot and MuJoCo: positions, if the joints follow them
            yield from _block("cmd", members, stem, weak=2)
        elif not posed and kind is not None and not _EXTERNAL & present:
            strong = kind != "q" or bool(_JOINT & present)
            yield from _block(kind, members, stem, weak=0 if strong else 1)
            if kind == "q" and count == 3 and not strong:  # position_0 … position_2 beside joints of another name
                yield from _block("position", members, stem, weak=2, **options)
