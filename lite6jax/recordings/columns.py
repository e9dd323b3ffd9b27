"""The columns of a recording: which quantity, joint and unit a name means, all that is wrong, and orientations."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.errors import InputError

# quantity -> accepted units, the SI one first, each with the divisor that leads to it: dividing by 1000 rounds
# correctly, multiplying by 0.001 does not
_ANGLE = {"rad": 1.0, "deg": 180 / pi}
_PER_JOINT = {
    "q": _ANGLE,
    "dq": {"rad_per_s": 1.0, "deg_per_s": 180 / pi},
    "ddq": {"rad_per_s2": 1.0, "deg_per_s2": 180 / pi},
    "tau": {"Nm": 1.0, "mNm": 1e3},
    "current": {"A": 1.0, "mA": 1e3},
    "temp": {"degC": 1.0},
    "cmd": _ANGLE,
}
_SLIDE = {
    "q": {"m": 1.0, "mm": 1e3},
    "cmd": {"m": 1.0, "mm": 1e3},
    "dq": {"m_per_s": 1.0, "mm_per_s": 1e3},
    "ddq": {"m_per_s2": 1.0, "mm_per_s2": 1e3},
    "tau": {"N": 1.0, "kN": 1e-3},
}
"""The units of the same quantities of a prismatic joint."""
QUATERNION = ("qw", "qx", "qy", "qz")
ANGLES = (("rx", "ry", "rz"), ("roll", "pitch", "yaw"), ("rotx", "roty", "rotz"), ("alpha", "beta", "gamma"))
"""The other forms of an orientation (`quaternions`)."""
_OF_ANGLES = tuple(part for form in ANGLES for part in form)
_ONLY_WITH_UNIT = (*_OF_ANGLES, "cmd", "distance", "axis", "u", "v")
"""Quantities that without their unit are any column of the user's own."""
MATRIX = tuple(f"r{row}{column}" for row in "123" for column in "123")
"""A rotation matrix, row by row."""
_SCALAR = {
    "time": {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9},
    **{axis: {"m": 1.0, "mm": 1e3} for axis in "xyz"},
    **{part: {"": 1.0} for part in (*QUATERNION, *MATRIX)},
    **dict.fromkeys(_OF_ANGLES, _ANGLE),
    "ambient": {"degC": 1.0},
    "payload": {"kg": 1.0},
    "run": {"": 1.0},
    "missing": {"": 1.0},
    "distance": {"m": 1.0, "mm": 1e3},
    "axis": {"m": 1.0, "mm": 1e3},
    "corner": {"": 1.0},
    "u": {"px": 1.0},
    "v": {"px": 1.0},
    **{label: {"": 1.0} for label in ("contact", "plane", "anchor", "image")},
}
READINGS = {
    "contact": ("contact",),
    "plane": ("plane",),
    "distance": ("distance", "anchor"),
    "axis": ("axis",),
    "camera": ("u", "v", "image", "corner"),
}
"""The quantities of each kind of reading; the first tells of the kind."""
LABELS = ("contact", "plane", "anchor", "image")
"""Columns of words that tell rows of one point, plane, anchor or image from the others."""
_TEXTS = ("gap",)
"""Columns of words, for people."""
_STD = re.compile(r"[a-z]+\d*_std_[a-zA-Z]+")
"""Standard deviations, as `predict` and `compensate` write them beside what can be read again."""
IGNORED = "ignore"
"""What a sidecar says of a column that is not to be read."""
_NAME = re.compile(r"(?P<quantity>[a-z]+?)(?P<joint>\d*)(?:_(?P<unit>.*))?", re.IGNORECASE | re.DOTALL | re.ASCII)
_SHOWN = 8


@dataclass(frozen=True)
class Column:
    """A recognised column: its name and place in the file, and what it holds, in SI once divided by `divisor`."""

    name: str
    index: int
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
        return self.unit in _SLIDE.get(self.quantity, ())


class Recognised(NamedTuple):
    """What the columns of a table mean.

    Attributes:
        columns: by their SI name.
        joints: how many.
        ignored: names that mean nothing here, without those that are to be ignored.
        problems: what makes the table unusable, each with its remedy; empty where nothing does.
    """

    columns: dict[str, Column]
    joints: int
    ignored: list[str]
    problems: list[str]

    @property
    def sliding(self) -> tuple[int, ...]:
        """The joints, counted from 0, whose positions are lengths."""
        return sliding_of(self.columns)


def recognise(
    names: Sequence[str],
    dof: int | None = None,
    joints_optional: bool = False,
    renamed: Mapping[str, str] | None = None,
) -> Recognised:
    """What the columns of a table mean.

    Problems are a unit that is missing or unknown, a quantity given twice, a joint left out, a position or an
    orientation in part, no joint positions, another number of joints than `dof`, and absent names in `renamed`.

    Args:
        names: the column names, in order.
        dof: the number of joints expected, where known.
        joints_optional: whether joint positions may be absent; then `dof` is to be known.
        renamed: of columns with names of their own, the names that they would have here, or `IGNORED`.
    """
    own = renamed or {}
    found: dict[str, Column] = {}
    ignored: list[str] = []
    problems = _Problems()
    for name in own:
        if name not in names and name.strip() not in map(str.strip, names):
            problems.say(f"column {name[:60]!r} of the sidecar is not in the table; it has {_listed(names)}")
    for index, raw in enumerate(names):
        name = own.get(raw, own.get(raw.strip(), raw.strip()))
        if name == IGNORED or name in _TEXTS or _STD.fullmatch(name):
            continue
        column = _column(name, raw.strip(), index, problems)
        if column is None:
            if not problems.about(index):
                ignored.append(raw)
        elif (twin := found.get(column.si_name)) is None:
            found[column.si_name] = column
        elif twin.name == column.name:
            problems.say(f"column {column.name} stands there twice; keep one")
        else:
            problems.say(f"columns {twin.name} and {column.name} give the same quantity; keep one")
    joints = _joints(found, names, dof if joints_optional else None, problems)
    if joints and dof is not None and joints != dof:
        problems.say(f"has {joints} joints (q1 ... q{joints}), the arm has {dof}; choose the arm it is of")
    _check_joints(found, joints, problems)
    _check_kinds(found, problems)
    _check_groups(found, problems)
    return Recognised(found, joints, ignored, problems.listed())


def one_line(source: str, problems: Sequence[str], remedy: str = "") -> str:
    """The message that names all problems of a table, numbered where there are several."""
    if len(problems) == 1:
        return f"{source}: {problems[0]}{remedy}"
    numbered = " ".join(f"({number}) {problem}." for number, problem in enumerate(problems, 1))
    return f"{source}: {len(problems)} problems of its columns: {numbered.removesuffix('.')}{remedy}"


def sliding_of(columns: Mapping[str, Column]) -> tuple[int, ...]:
    """The joints, counted from 0, whose positions are lengths."""
    return tuple(sorted(column.joint - 1 for column in columns.values() if column.quantity == "q" and column.slides))


class _Problems:
    """Problems in the order in which they were found; those of columns that differ in their number only are one."""

    def __init__(self) -> None:
        self._texts: list[str] = []
        self._alike: dict[tuple[str, str], tuple[int, list[str]]] = {}
        self._indices: set[int] = set()
        self.quantities: set[str] = set()

    def say(self, text: str) -> None:
        self._texts.append(text)

    def column(self, name: str, index: int, quantity: str, problem: str, remedy: str) -> None:
        """A problem of one column; of the next ones with the same only the names are added."""
        self._indices.add(index)
        self.quantities.add(quantity)
        group = self._group(quantity)
        if (group, problem) in self._alike:
            self._alike[group, problem][1].append(name)
            return
        self._alike[group, problem] = (len(self._texts), [])
        self._texts.append(f"column {name[:60]!r}: {problem}; write {remedy}")

    def about(self, index: int) -> bool:
        return index in self._indices

    def listed(self) -> list[str]:
        texts = list(self._texts)
        for place, others in self._alike.values():
            if others:
                texts[place] += f" (and likewise {_listed(others)})"
        return texts

    @staticmethod
    def _group(quantity: str) -> str:
        return next((group[0] for group in (("x", "y", "z"), QUATERNION) if quantity in group), quantity)


def _column(name: str, own: str, index: int, problems: _Problems) -> Column | None:
    """The column that a name means; `own` is its name in the file, for messages."""
    if name in MATRIX:
        return Column(own, index, name, 0, "", 1.0)
    match = _NAME.fullmatch(name)
    quantity = match["quantity"].lower() if match else ""
    per_joint = quantity in _PER_JOINT
    known = match is not None and (per_joint or (quantity in _SCALAR and not match["joint"]))
    if known:
        assert match is not None
        joint = int(match["joint"][:9] or 0)
        for number, (accepted, divisor) in enumerate(units_of(quantity).items()):
            if name == spelled(quantity, joint, number) and (joint or not per_joint):
                return Column(own, index, quantity, joint, accepted, divisor)
        for accepted, divisor in _SLIDE.get(quantity, {}).items():
            if joint and name == f"{quantity}{joint}_{accepted}":
                return Column(own, index, quantity, joint, accepted, divisor)
    if known and quantity not in _ONLY_WITH_UNIT:
        assert match is not None
        forms = _forms(quantity, int(match["joint"][:9] or 0) or 1)
        problem = _misspelling(match, quantity, per_joint)
        problems.column(_shown(own, name), index, quantity, problem, forms)
    elif name != own:
        near = nearest_known(name)
        remedy = f"{near or 'q1_rad, x_m, tau1_Nm and the like'}, or {IGNORED}"
        problems.column(own, index, name, f"the sidecar names it {name[:40]!r}, which means nothing here", remedy)
    return None


def _shown(own: str, name: str) -> str:
    return own if own == name else f"{own} ({name})"


def _misspelling(match: re.Match[str], quantity: str, per_joint: bool) -> str:
    units, unit = units_of(quantity), match["unit"]
    if per_joint and not int(match["joint"][:9] or 0):
        return "joints are numbered from 1"
    if match["quantity"] != quantity or (unit or "") in units:
        return "is not spelled as it must be"
    if unit:
        return f"the unit {unit[:40]!r} is unknown"
    return "the unit is missing" if "" not in units else "has no unit"


def _joints(found: dict[str, Column], names: Sequence[str], dof: int | None, problems: _Problems) -> int:
    """How many joints there are; `dof` where that is known and there need be no columns of them."""
    joints = {column.joint for column in found.values() if column.quantity == "q"}
    if not joints:
        if dof is None and "q" not in problems.quantities:
            problems.say(
                f"has no joint positions; name their columns q1_rad ... qN_rad (or q1_deg ...); it has {_listed(names)}"
            )
        return dof or 0
    if "q" not in problems.quantities:
        for joint in range(1, max(joints)):
            if joint not in joints:
                problems.say(f"{_forms('q', joint)} is missing while q{max(joints)} is there; give every joint")
    return max(joints)


def _check_joints(found: Mapping[str, Column], joints: int, problems: _Problems) -> None:
    for quantity in _PER_JOINT:
        present = {column.joint for column in found.values() if column.quantity == quantity}
        if not joints or quantity in problems.quantities or "q" in problems.quantities:
            continue
        if surplus := present - set(range(1, joints + 1)):
            problems.say(
                f"column {_forms(quantity, min(surplus))}: the joint positions end with q{joints}; "
                f"add q{min(surplus)} or remove the column"
            )
        if quantity != "q" and present and (missing := set(range(1, joints + 1)) - present):
            problems.say(f"{_forms(quantity, min(missing))} is missing beside its like; give it for all joints")


def _check_kinds(found: Mapping[str, Column], problems: _Problems) -> None:
    """What is of a prismatic joint beside what is of a revolute one."""
    slides = {column.joint: column for column in found.values() if column.quantity == "q"}
    for column in found.values():
        position = slides.get(column.joint)
        if column.quantity in _SLIDE and position is not None and column.slides != position.slides:
            units = _SLIDE[column.quantity] if position.slides else _PER_JOINT[column.quantity]
            forms = " or ".join(f"{column.quantity}{column.joint}_{unit}" for unit in units)
            problems.say(f"column {column.name} does not fit {position.name}; write {forms}")


def _check_groups(found: Mapping[str, Column], problems: _Problems) -> None:
    given = []
    for group in (("x", "y", "z"), QUATERNION, MATRIX, *ANGLES):
        missing = [quantity for quantity in group if spelled(quantity) not in found]
        if len(missing) < len(group) and group != ("x", "y", "z"):
            given.append(group)
        if missing and len(missing) < len(group) and not problems.quantities & set(group):
            problems.say(f"{_forms(missing[0], 0)} is missing; give all of {_together(group)}, or none")
    if len(given) > 1:
        problems.say(f"has the orientation twice, {_together(given[0])} and {_together(given[1])}; keep one")
    if given and "x_m" not in found and not problems.quantities & {"x", "y", "z"}:
        problems.say(f"has the orientation {_together(given[0])} without a position; add x_m y_m z_m")


def _together(group: Iterable[str]) -> str:
    return " ".join(map(spelled, group))


def _listed(names: Sequence[str]) -> str:
    return ", ".join(repr(name[:40]) for name in names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def spelled(quantity: str, joint: int = 0, number: int = 0) -> str:
    """The name of a column: of a joint counted from 1, and in the unit of this number in `units_of`."""
    unit = list(units_of(quantity))[number]
    return f"{quantity}{joint or ''}" + (f"_{unit}" if unit else "")


def _forms(quantity: str, joint: int) -> str:
    if quantity not in _PER_JOINT:
        joint = 0
    return " or ".join(spelled(quantity, joint, number) for number in range(len(units_of(quantity))))


def units_of(quantity: str, slides: bool = False) -> dict[str, float]:
    """The accepted units of a quantity, the SI one first, with what to divide by to get there.

    Args:
        quantity: such as `q` or `x`.
        slides: whether it is that of a prismatic joint.
    """
    if slides and quantity in _SLIDE:
        return _SLIDE[quantity]
    return _PER_JOINT[quantity] if quantity in _PER_JOINT else _SCALAR[quantity]


def differs_by_joint(quantity: str) -> bool:
    """Whether a prismatic joint has other units of it than a revolute one."""
    return quantity in _SLIDE


def is_per_joint(quantity: str) -> bool:
    """Whether there is one column for each joint."""
    return quantity in _PER_JOINT


def is_standard(name: str) -> bool:
    """Whether a table's column of this name is read, or passed over, without a sidecar's help."""
    return name in _TEXTS or _STD.fullmatch(name) is not None or _column(name, name, 0, _Problems()) is not None


def known_column(name: str) -> Column | None:
    """What a name of a recording's column says; None where it is none."""
    return _column(name, name, 0, _Problems())


def reading_of(name: str) -> str:
    """The kind of reading that a column of this name belongs to; empty of any other."""
    column = known_column(name)
    return next((kind for kind, parts in READINGS.items() if column and column.quantity in parts), "")


def is_refused(name: str) -> bool:
    """Whether a table's column of this name has to be named or ignored by a sidecar."""
    if _STD.fullmatch(name):
        return False
    _column(name, name, 0, problems := _Problems())
    return bool(problems.listed())


def nearest_known(name: str) -> str | None:
    """The column that an ignored one may have meant."""
    if name in _OF_ANGLES:
        return spelled(name)
    known = [spelled(quantity, 1 if quantity in _PER_JOINT else 0) for quantity in (*_PER_JOINT, *_SCALAR)]
    return next(iter(get_close_matches(name, known, n=1, cutoff=0.8)), None)


# ------------------------------------------------------------------ forms of orientations


Array = NDArray[np.floating]

VECTOR, RPY, XYZ, ZYZ = ANGLES
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

    found = np.full((len(values), 4), np.nan)
    given = np.isfinite(values).all(axis=1)
    if not given.any():
        return found
    rows = values[given]
    if form == MATRIX:
        left, _, right = np.linalg.svd(rows.reshape(-1, 3, 3))
        rotation = Rotation.from_matrix(left * np.linalg.det(left @ right)[:, None, None] @ right)
    elif form == VECTOR:
        rotation = Rotation.from_rotvec(rows)
    else:
        rotation = Rotation.from_euler(_EULER[form], rows[:, ::-1] if form == RPY else rows)
    found[given] = np.roll(rotation.as_quat(), 1, axis=1)
    return found


def is_no_rotation(matrix: Array) -> NDArray[np.bool_]:
    """Of which rows `(sample, 9)`, without gaps, the matrix is no rotation: not orthogonal, or mirrored."""
    R = matrix.reshape(-1, 3, 3)
    with np.errstate(all="ignore"):
        far = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0) > NEARLY
        return np.isfinite(matrix).all(1) & (far | (np.linalg.det(R) < 0))


def with_quaternions(values: Mapping[str, Array], source: str = "recording") -> dict[str, Array]:
    """Columns in SI units by their names, with an orientation in another form replaced by its quaternions.

    Raises:
        InputError: a matrix that is no rotation.
    """
    told = dict(values)
    for form in (*ANGLES, MATRIX):
        names = [spelled(part) for part in form]
        if all(name in told for name in names):
            parts = np.stack([told.pop(name) for name in names], axis=1)
            if form == MATRIX and (wrong := np.flatnonzero(is_no_rotation(parts))).size:
                turned = np.linalg.det(parts[wrong[0]].reshape(3, 3)) > 0
                raise InputError(
                    f"{source}: row {wrong[0] + 1}: r11 … r33 {'is not orthogonal' if turned else 'is mirrored'}, so "
                    "it is no rotation; name its columns row by row, or remove the row"
                )
            told |= dict(zip(QUATERNION, quaternions(form, parts).T, strict=True))
    return told
