"""The columns of a recording: which quantity, joint and unit a name means, all that is wrong, and orientations."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.errors import InputError

Array = NDArray[np.floating]


class ColumnQuantity(NamedTuple):
    """What a column may hold.

    Attributes:
        units: by name, the SI one first, each with the divisor that leads to it: dividing by 1000 rounds correctly.
        of_slide: those of a prismatic joint; none where they are no others.
        per_joint: whether there is a column for each joint.
        array: of a recording, to which the column belongs.
        largest: magnitude in SI units, beyond which no arm or sensor gives it.
        common: whether the name without a unit is taken for a misspelling, and not for any column of the user's own.
        words: by which people call such a column, in lower case.
    """

    units: dict[str, float]
    of_slide: dict[str, float] = {}  # noqa: RUF012 (never changed)
    per_joint: bool = False
    array: str = ""
    largest: float = math.inf
    common: bool = True
    words: frozenset[str] = frozenset()

    def called(self, words: str) -> "ColumnQuantity":
        """The same, with the words by which people call it, between spaces."""
        return self._replace(words=frozenset(words.split()))


QUATERNION = ("qw", "qx", "qy", "qz")
ANGLES = (("rx", "ry", "rz"), ("roll", "pitch", "yaw"), ("rotx", "roty", "rotz"), ("alpha", "beta", "gamma"))
"""The other forms of an orientation (`quaternions`)."""
VECTOR, RPY, XYZ, ZYZ = ANGLES
MATRIX = tuple(f"r{row}{column}" for row in "123" for column in "123")
"""A rotation matrix, row by row."""
FORMS: Mapping[str, tuple[str, ...]] = {
    "scalar_first": QUATERNION,
    "scalar_last": (*QUATERNION[1:], QUATERNION[0]),
    **{form[0]: form for form in (MATRIX, *ANGLES)},
}
"""The parts of an orientation in the order of its columns, by the name of its form."""
PLACE = ("x", "y", "z")
DEVIATION = ("devx", "devy", "devz")
"""Of the measured position from a nominal one, which x y z are where they stand beside them."""
LABELS = ("contact", "plane", "anchor", "image")
"""Columns of words that tell rows of one point, plane, anchor or image from the others."""
READINGS = {
    "contact": ("contact",),
    "plane": ("plane",),
    "distance": ("distance", "anchor"),
    "axis": ("axis",),
    "camera": ("u", "v", "image", "corner"),
}
"""The quantities of each kind of reading; the first tells of the kind."""
IGNORED = "ignore"
"""What a sidecar says of a column that is not to be read."""

_USUAL_ANGLE = {"rad": 1.0, "deg": 180 / pi}
_USUAL_LENGTH = {"m": 1.0, "mm": 1e3}
_FINE_ANGLE = {"mrad": 1e3, "cdeg": 1.8e4 / pi, "mdeg": 1.8e5 / pi, "1e-4deg": 1.8e6 / pi}
_FINE_LENGTH = {"cm": 1e2, "dmm": 1e4, "um": 1e6}
"""Units of which devices write whole numbers; `dmm` is 0.1 mm."""
FINE = frozenset((*_FINE_ANGLE, *_FINE_LENGTH))
_ANGLE = _USUAL_ANGLE | _FINE_ANGLE
_LENGTH = _USUAL_LENGTH | _FINE_LENGTH


def _per(time: str) -> tuple[dict[str, float], dict[str, float]]:
    """The units of rates, of turning and of sliding joints."""
    turning = {f"{unit}_per_{time}": divisor for unit, divisor in _ANGLE.items()}
    sliding = {f"{unit}_per_{time}": divisor for unit, divisor in _LENGTH.items()}
    return turning, sliding


_NONE = {"": 1.0}
QUANTITIES: Mapping[str, ColumnQuantity] = {
    "time": ColumnQuantity({"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}, array="time", largest=1e12).called(
        "time timestamp datetime stamp elapsed clock duration"
    ),
    "q": ColumnQuantity(_ANGLE, _LENGTH, True, "joint_position", 2000 * pi).called(  # a joint that counts its turns on
        "q joint joints jnt jt axis achse gelenk qpos theta th angle angles servo motor j"
    ),
    "dq": ColumnQuantity(*_per("s"), True, "joint_velocity", 1e4).called(
        "dq qd qdot vel velocity velocities speed speeds dot dtheta qvel"
    ),
    "ddq": ColumnQuantity(*_per("s2"), True, "joint_acceleration", 1e7).called(
        "ddq qdd qddot acc accel acceleration accelerations ddot qacc"
    ),
    "tau": ColumnQuantity({"Nm": 1.0, "mNm": 1e3}, {"N": 1.0, "kN": 1e-3}, True, "joint_torque", 1e5).called(
        "tau torque torques effort efforts eff trq moment moments qfrc"
    ),
    "current": ColumnQuantity({"A": 1.0, "mA": 1e3}, {}, True, "motor_current", 1e5).called("current currents amps"),
    "temp": ColumnQuantity({"degC": 1.0}, {}, True, "joint_temperature", 1e4).called("temp temperature temperatures"),
    "cmd": ColumnQuantity(_ANGLE, _LENGTH, True, "commanded_position", 2000 * pi, common=False),
    "ambient": ColumnQuantity({"degC": 1.0}, array="ambient_temperature", largest=1e4).called(
        "ambient amb room air env environment"
    ),
    "payload": ColumnQuantity({"kg": 1.0}, array="payload", largest=1e5).called("payload"),
    "run": ColumnQuantity(_NONE, array="run").called("run episode trial segment"),
    **dict.fromkeys(
        PLACE, ColumnQuantity(_LENGTH, array="position", largest=1e7)
    ),  # which a float resolves to nanometres
    **dict.fromkeys(DEVIATION, ColumnQuantity(_LENGTH, common=False)),
    **dict.fromkeys(QUATERNION, ColumnQuantity(_NONE, array="quaternion")),
    **dict.fromkeys(MATRIX, ColumnQuantity(_NONE)),
    **{part: ColumnQuantity(_ANGLE, common=False) for form in ANGLES for part in form},
    "missing": ColumnQuantity(_NONE),
    "distance": ColumnQuantity(_LENGTH, common=False).called(
        "wire rope cable string draw distance dist length range extension seil seillänge länge abstand distanz"
    ),
    "axis": ColumnQuantity(_LENGTH, common=False).called(
        "dial gauge indicator height z plunger lvdt messuhr höhe taster uhr"
    ),
    "corner": ColumnQuantity(_NONE),
    **dict.fromkeys(("u", "v"), ColumnQuantity({"px": 1.0}, common=False)),
    **dict.fromkeys(LABELS, ColumnQuantity(_NONE)),
    "contact": ColumnQuantity(_NONE).called(
        "socket sockets contact contacts nest ball cone hole point points target feature touched fiducial "
        "punkt messpunkt kugel pfanne buchse"
    ),
    "plane": ColumnQuantity(_NONE).called(
        "plane planes plate plates face faces surface surfaces wall ebene fläche platte wand"
    ),
    "anchor": ColumnQuantity(_NONE).called("anchor anchors post anker"),
}
"""What columns may hold, by the beginning of their names in a recording: of poses, torques and commands alike."""
OF_ARRAY: dict[str, tuple[str, ...]] = {
    definition.array: tuple(name for name, sibling in QUANTITIES.items() if sibling.array == definition.array)
    for definition in QUANTITIES.values()
    if definition.array
}
"""The quantities of each array of a recording."""
TEXTS = ("gap",)
"""Columns of words, for people."""
_STD = re.compile(r"[a-z]+\d*_std_[a-zA-Z]+")
"""Standard deviations, as `predict` and `compensate` write them beside what can be read again."""
_NAME = re.compile(r"(?P<quantity>[a-z]+?)(?P<joint>\d*)(?:_(?P<unit>.*))?", re.IGNORECASE | re.DOTALL | re.ASCII)
_SHOWN = 8


def units_of(quantity: str, slides: bool = False, fine: bool = True) -> dict[str, float]:
    """The accepted units of a quantity, the SI one first, with what to divide by to get there.

    Args:
        quantity: such as `q` or `x`.
        slides: whether it is that of a prismatic joint.
        fine: whether those of `FINE` are among them.
    """
    definition = QUANTITIES[quantity]
    units = definition.of_slide if slides and definition.of_slide else definition.units
    return units if fine else {unit: divisor for unit, divisor in units.items() if unit.partition("_")[0] not in FINE}


def differs_by_joint(quantity: str) -> bool:
    """Whether a prismatic joint has other units of it than a revolute one."""
    return bool(QUANTITIES[quantity].of_slide)


def is_per_joint(quantity: str) -> bool:
    """Whether there is one column for each joint."""
    return quantity in QUANTITIES and QUANTITIES[quantity].per_joint


def spelled(quantity: str, joint: int = 0, unit: str | None = None, slides: bool = False) -> str:
    """The name of a column: of a joint counted from 1, in a unit, the SI one where none is given."""
    unit = next(iter(units_of(quantity, slides))) if unit is None else unit
    return f"{quantity}{joint or ''}" + (f"_{unit}" if unit else "")


def name_columns(array: str, joints: int = 0, sliding: Iterable[int] = ()) -> list[str]:
    """The names in SI units of the columns of an array of a recording; prismatic joints count from 0."""
    quantities = OF_ARRAY[array]
    if not is_per_joint(quantities[0]):
        return [spelled(quantity) for quantity in quantities]
    return [spelled(quantities[0], joint + 1, slides=joint in sliding) for joint in range(joints)]


def is_scalar(array: str) -> bool:
    """Whether an array of a recording has one number a sample, `(sample,)`."""
    return len(OF_ARRAY[array]) == 1 and not is_per_joint(OF_ARRAY[array][0])


class Column(NamedTuple):
    """A recognised column: its name and place in the file, and what it holds, in SI once divided by `divisor`."""

    name: str
    place: int
    quantity: str
    joint: int  # 1-based, 0 for a quantity that is not per joint
    unit: str
    divisor: float

    @property
    def si_name(self) -> str:
        """Its name in SI units; of a prismatic joint the name that a revolute one would have."""
        return spelled(self.quantity, self.joint)

    @property
    def slides(self) -> bool:
        """Whether its unit is one of a prismatic joint."""
        return self.unit in QUANTITIES[self.quantity].of_slide


class _Misspelling(NamedTuple):
    """A name that is nearly one of a recording's: of which quantity, what is wrong, and what to write."""

    quantity: str
    problem: str
    remedy: str


def _parse_name(name: str) -> Column | _Misspelling | None:
    """What a name means; None where nothing."""
    if name in MATRIX:
        return Column(name, 0, name, 0, "", 1.0)
    match = _NAME.fullmatch(name)
    quantity = match["quantity"].lower() if match else ""
    if match is None or quantity not in QUANTITIES or (match["joint"] and not is_per_joint(quantity)):
        return None
    joint = int(match["joint"][:3] or 0)
    definition = QUANTITIES[quantity]
    for unit, divisor in (*definition.units.items(), *definition.of_slide.items()):
        if name == spelled(quantity, joint, unit) and (joint or not definition.per_joint):
            return Column(name, 0, quantity, joint, unit, divisor)
    if not definition.common:
        return None
    if definition.per_joint and not joint:
        problem = "joints are numbered from 1"
    elif match["quantity"] != quantity or (match["unit"] or "") in definition.units:
        problem = "is not spelled as it must be"
    elif match["unit"]:
        problem = f"the unit {match['unit'][:40]!r} is unknown"
    else:
        problem = "has no unit" if "" in definition.units else "the unit is missing"
    return _Misspelling(quantity, problem, _forms(quantity, joint or 1))


def known_column(name: str) -> Column | None:
    """What a name of a recording's column says; None where it is none."""
    parsed = _parse_name(name)
    return parsed if isinstance(parsed, Column) else None


def is_standard(name: str) -> bool:
    """Whether a table's column of this name is read, or passed over, without a sidecar's help."""
    return name in TEXTS or _STD.fullmatch(name) is not None or known_column(name) is not None


def is_refused(name: str) -> bool:
    """Whether a table's column of this name has to be named or ignored by a sidecar."""
    return not _STD.fullmatch(name) and isinstance(_parse_name(name), _Misspelling)


def reading_of(name: str) -> str:
    """The kind of reading that a column of this name belongs to; empty of any other."""
    column = known_column(name)
    return next((kind for kind, parts in READINGS.items() if column and column.quantity in parts), "")


def nearest_known(name: str) -> str | None:
    """The column that an ignored one may have meant."""
    if name in {part for form in ANGLES for part in form}:
        return spelled(name)
    spellings = [spelled(quantity, int(is_per_joint(quantity))) for quantity in QUANTITIES]
    return next(iter(get_close_matches(name, spellings, n=1, cutoff=0.8)), None)


# ------------------------------------------------------------------ the columns of a table


def recognise(
    names: Sequence[str],
    dof: int | None = None,
    joints_optional: bool = False,
    renamed: Mapping[str, str] | None = None,
) -> tuple[dict[str, Column], int, list[str], list[str]]:
    """What the columns of a table mean.

    Problems are a unit that is missing or unknown, a quantity given twice, a joint left out, a position or an
    orientation in part, no joint positions, another number of joints than `dof`, and absent names in `renamed`.

    Args:
        names: the column names, in order.
        dof: the number of joints expected, where known.
        joints_optional: whether joint positions may be absent; then `dof` is to be known.
        renamed: of columns with names of their own, the names that they would have here, or `IGNORED`.

    Returns:
        the columns by their SI name; how many joints; names that mean nothing here and are not to be ignored; and what
        makes the table unusable, each with its remedy.
    """
    declared = renamed or {}
    present = {*names, *(name.strip() for name in names)}
    recognised: dict[str, Column] = {}
    ignored: list[str] = []
    problems = [
        f"column {name[:60]!r} of the sidecar is not in the table; it has {list_names(names)}"
        for name in declared
        if name.strip() not in present and name not in present
    ]
    by_problem: dict[
        tuple[str, str], tuple[int, list[str]]
    ] = {}  # the place of a problem, and the next columns with it
    unclear: set[str] = set()
    for place, raw in enumerate(names):
        stripped = raw.strip()
        name = declared.get(raw, declared.get(stripped, stripped))
        if name == IGNORED or name in TEXTS or _STD.fullmatch(name):
            continue
        meant = _parse_name(name)
        if meant is None and name != stripped:
            problem = f"the sidecar names it {name[:40]!r}, which means nothing here"
            remedy = f"{nearest_known(name) or 'q1_rad, x_m, tau1_Nm and the like'}, or {IGNORED}"
            meant = _Misspelling(name, problem, remedy)
            name = stripped
        if meant is None:
            ignored.append(raw)
        elif isinstance(meant, _Misspelling):
            unclear.add(meant.quantity)
            group = next((parts[0] for parts in (PLACE, QUATERNION) if meant.quantity in parts), meant.quantity)
            shown = stripped if stripped == name else f"{stripped} ({name})"
            if (key := (group, meant.problem)) in by_problem:
                by_problem[key][1].append(shown)
                continue
            by_problem[key] = len(problems), []
            problems.append(f"column {shown[:60]!r}: {meant.problem}; write {meant.remedy}")
        elif (twin := recognised.get(meant.si_name)) is None:
            recognised[meant.si_name] = meant._replace(name=stripped, place=place)
        elif twin.name == stripped:
            problems.append(f"column {stripped} stands there twice; keep one")
        else:
            problems.append(f"columns {twin.name} and {stripped} give the same quantity; keep one")
    for number, further in by_problem.values():
        problems[number] += f" (and likewise {list_names(further)})" if further else ""
    joints = max((column.joint for column in recognised.values() if column.quantity == "q"), default=0)
    if not joints and not joints_optional and "q" not in unclear:
        problems.append(
            f"has no joint positions; name their columns q1_rad ... qN_rad (or q1_deg ...); it has {list_names(names)}"
        )
    highest_joint = joints
    joints = joints or (dof or 0) * joints_optional
    if "q" not in unclear:
        problems += _check_joints(recognised, highest_joint, joints, unclear)
    if joints and dof is not None and joints != dof:
        problems.append(f"has {joints} joints (q1 ... q{joints}), the arm has {dof}; choose the arm it is of")
    return recognised, joints, ignored, problems + _check_groups(recognised, unclear)


def sliding_of(columns: Mapping[str, Column]) -> tuple[int, ...]:
    """The joints, counted from 0, whose positions are lengths."""
    return tuple(sorted(column.joint - 1 for column in columns.values() if column.quantity == "q" and column.slides))


def _check_joints(recognised: Mapping[str, Column], highest_joint: int, joints: int, unclear: set[str]) -> list[str]:
    """What is wrong with columns of some joints, or of another kind of joint than its position is."""
    problems = []
    expected = set(range(1, joints + 1))
    positions = {c.joint: c for c in recognised.values() if c.quantity == "q"}
    problems += [
        f"{_forms('q', joint)} is missing while q{highest_joint} is there; give every joint"
        for joint in sorted(set(range(1, highest_joint)) - positions.keys())
    ]
    for quantity in (name for name, definition in QUANTITIES.items() if definition.per_joint and name != "q"):
        present = {column.joint for column in recognised.values() if column.quantity == quantity}
        if not joints or not present or quantity in unclear:
            continue
        if surplus := present - expected:
            problems.append(
                f"column {_forms(quantity, min(surplus))}: the joint positions end with q{joints}; "
                f"add q{min(surplus)} or remove the column"
            )
        if missing := expected - present:
            problems.append(f"{_forms(quantity, min(missing))} is missing beside its like; give it for all joints")
    for column in recognised.values():
        position = positions.get(column.joint)
        slide_units = QUANTITIES[column.quantity].of_slide
        if slide_units and position is not None and column.slides != position.slides:
            forms = " or ".join(spelled(column.quantity, column.joint, unit)
                                for unit in units_of(column.quantity, position.slides))  # fmt: skip
            problems.append(f"column {column.name} does not fit {position.name}; write {forms}")
    return problems


def _check_groups(recognised: Mapping[str, Column], unclear: set[str]) -> list[str]:
    """What is wrong with positions and orientations in part, twice, or without each other."""
    problems = []
    orientations = []
    for group in (PLACE, DEVIATION, QUATERNION, MATRIX, *ANGLES):
        missing = [quantity for quantity in group if spelled(quantity) not in recognised]
        if len(missing) < len(group) and group not in (PLACE, DEVIATION):
            orientations.append(group)
        if 0 < len(missing) < len(group) and not unclear & set(group):
            problems.append(f"{_forms(missing[0], 0)} is missing; give all of {_together(group)}, or none")
    if len(orientations) > 1:
        problems.append(
            f"has the orientation twice, {_together(orientations[0])} and {_together(orientations[1])}; keep one"
        )
    if orientations and "x_m" not in recognised and not unclear & set(PLACE):
        problems.append(f"has the orientation {_together(orientations[0])} without a position; add x_m y_m z_m")
    if spelled(DEVIATION[0]) in recognised and "x_m" not in recognised and not unclear & set(PLACE):
        problems.append(f"has deviations {_together(DEVIATION)} without the nominal positions; add x_m y_m z_m")
    return problems


def _together(group: Iterable[str]) -> str:
    return " ".join(map(spelled, group))


def list_names(names: Sequence[str]) -> str:
    """The first of the names of a table, for messages."""
    return ", ".join(repr(name[:40]) for name in names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def _forms(quantity: str, joint: int) -> str:
    units = units_of(quantity, fine=False)
    return " or ".join(spelled(quantity, joint * is_per_joint(quantity), unit) for unit in units)


# ------------------------------------------------------------------ forms of orientations


_EULER: dict[tuple[str, ...], str] = {RPY: "ZYX", XYZ: "XYZ", ZYZ: "ZYZ"}
"""Intrinsic sequences in SciPy's spelling, in the order of the columns; of `RPY` in the reverse order."""
NEARLY = 0.02
"""Of R Rᵀ from the identity: as far off is a matrix of which two digits are written."""


def quaternions(form: tuple[str, ...], values: Array) -> Array:
    """`(sample, 4)` unit quaternions, scalar first, of a form in rad or without unit; NaN where a number is.

    Args:
        form: one of `ANGLES`, or `MATRIX`.
        values: `(sample, part)`; of a matrix the nearest rotation is taken.
    """
    from scipy.spatial.transform import Rotation

    quaternion = np.full((len(values), 4), np.nan)
    complete = np.isfinite(values).all(axis=1)
    if not complete.any():
        return quaternion
    rows = values[complete]
    if form == MATRIX:
        left_vectors, _, right = np.linalg.svd(rows.reshape(-1, 3, 3))
        rotation = Rotation.from_matrix(left_vectors * np.linalg.det(left_vectors @ right)[:, None, None] @ right)
    elif form == VECTOR:
        rotation = Rotation.from_rotvec(rows)
    else:
        rotation = Rotation.from_euler(_EULER[form], rows[:, ::-1] if form == RPY else rows)
    quaternion[complete] = np.roll(rotation.as_quat(), 1, axis=1)
    return quaternion


def is_no_rotation(matrix: Array) -> NDArray[np.bool_]:
    """Of which rows `(sample, 9)`, without gaps, the matrix is no rotation: not orthogonal, or mirrored."""
    R = matrix.reshape(-1, 3, 3)
    with np.errstate(all="ignore"):
        far = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0) > NEARLY
        return np.isfinite(matrix).all(1) & (far | (np.linalg.det(R) < 0))


def add_deviations(values: Mapping[str, Array], notes: list[str]) -> dict[str, Array]:
    """Columns in SI units by their names, with the measured position in place of a nominal one and its deviation."""
    columns = dict(values)
    for axis, deviation in zip(map(spelled, PLACE), map(spelled, DEVIATION), strict=True):
        if axis in columns and deviation in columns:
            columns[axis] = columns[axis] + columns.pop(deviation)
    if len(columns) < len(values):
        notes.append("the measured position is the sum of the nominal one, x y z, and the deviation, devx devy devz")
    return columns


def with_quaternions(values: Mapping[str, Array], source: str = "recording") -> dict[str, Array]:
    """Columns in SI units by their names, with an orientation in another form replaced by its quaternions.

    Raises:
        InputError: a matrix that is no rotation.
    """
    columns = dict(values)
    for form in (*ANGLES, MATRIX):
        names = [spelled(part) for part in form]
        if all(name in columns for name in names):
            parts = np.stack([columns.pop(name) for name in names], axis=1)
            if form == MATRIX and (wrong := np.flatnonzero(is_no_rotation(parts))).size:
                turned = np.linalg.det(parts[wrong[0]].reshape(3, 3)) > 0
                raise InputError(
                    f"{source}: row {wrong[0] + 1}: r11 … r33 {'is not orthogonal' if turned else 'is mirrored'}, so "
                    "it is no rotation; name its columns row by row, or remove the row"
                )
            columns |= dict(zip(QUATERNION, quaternions(form, parts).T, strict=True))
    return columns
