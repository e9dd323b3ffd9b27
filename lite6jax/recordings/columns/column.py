"""What columns may hold, `QUANTITIES`, and what they do: a `Column` each, in a `Block` where they belong together."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import pi
from typing import Any, Literal, NamedTuple, final

import numpy as np

from lite6jax.array_types import Array


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
    "cmd_dq": ColumnQuantity(*_per("s"), True, largest=1e4, common=False),
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
    """Tells whether a prismatic joint has other units of it than a revolute one."""
    return bool(QUANTITIES[quantity].of_slide)


def is_per_joint(quantity: str) -> bool:
    """Tells whether there is one column for each joint."""
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
    """Tells whether an array of a recording has one number a sample, `(sample,)`."""
    return len(OF_ARRAY[array]) == 1 and not is_per_joint(OF_ARRAY[array][0])


# ------------------------------------------------------------------ what columns hold

Sureness = Literal["certain", "likely", "assumed"]
"""By name or by kinematics; by size; or the usual one, where neither tells."""
KINDS = (
    *("q", "dq", "ddq", "tau", "current", "temp", "cmd", "cmd_dq", "position", "deviation", "rotation"),
    *("time", "payload", "ambient", "run"),
)
COMMANDS = ("cmd", "cmd_dq")
"""Kinds that are commands of joints."""
OF_POSES = {"position": PLACE, "deviation": DEVIATION, "rotation": VECTOR}
"""The quantities of kinds that are no quantities, of rotations in one of their forms."""


class Column(NamedTuple):
    """What a column of a table holds.

    Attributes:
        name: in the table.
        quantity: of `QUANTITIES`.
        joint: counted from 1; 0 of a quantity that is not per joint.
        unit: of `units_of` the quantity; empty where it has none, or before it is decided.
        place: in the table, counted from 0.
    """

    name: str
    quantity: str
    joint: int = 0
    unit: str = ""
    place: int = 0

    @property
    def documented(self) -> str:
        """The name that says what it holds, as recordings have it: `q1_deg`."""
        return spelled(self.quantity, self.joint, self.unit)

    @property
    def si_name(self) -> str:
        """Its name in SI units; of a prismatic joint the name that a revolute one would have."""
        return spelled(self.quantity, self.joint)

    @property
    def slides(self) -> bool:
        """Tells whether its unit is one of a prismatic joint."""
        return self.unit in QUANTITIES[self.quantity].of_slide

    @property
    def divisor(self) -> float:
        """By which its numbers are divided to be in SI units."""
        return units_of(self.quantity, self.slides)[self.unit]


class Decision(NamedTuple):
    """A unit or a form, how sure it is, and why.

    Attributes:
        choice: such as `deg`.
        sure: how sure.
        reason: a code, for `report.inspection`.
        numbers: that the reason names.
    """

    choice: str
    sure: Sureness
    reason: str
    numbers: dict[str, Any]


def by_name(choice: str, sure: Sureness = "certain") -> Decision:
    """The unit or the form that the columns' names say, or assume.

    Of a matrix it is `orthogonal` whose numbers show in which order it is written.
    """
    orthogonal = choice == MATRIX[0] and sure == "certain"
    return Decision(choice, sure, "usual_name" if sure == "assumed" else "orthogonal" if orthogonal else "name", {})


@final
@dataclass(frozen=True)
class Block:
    """Columns that belong together, and what they mean.

    Attributes:
        kind: one of `KINDS`, or of readings; `position` and `rotation` of the tool, the others as in `QUANTITIES`.
        columns: along the arm; x y z; the rotation's components, a quaternion's as `form` says, a matrix row by row.
        unit: in which they are, and why; None before it is decided, where their names do not say it.
        form: of a rotation, the name that it has in `FORMS`, and why; None likewise.
        rank: 0 of what is called measured, 2 of what is called commanded, else 1.
        weak: how little the names say that it is of this kind.
        source: words that say whose a pose is, or which of several arms or legs.
        matrix: all columns of the matrix of which it is a part, row by row.
        rivals: the first columns of blocks that may be meant instead.
        joints: whose the columns are, counted from 1; empty where they are of all joints in order, or of none.
        slides: whether these joints are prismatic.
    """

    kind: str
    columns: tuple[str, ...]
    unit: Decision | None = None
    form: Decision | None = None
    rank: int = 1
    weak: int = 0
    source: tuple[str, ...] = ()
    matrix: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()
    joints: tuple[int, ...] = ()
    slides: bool = False

    @property
    def key(self) -> tuple[str, bool]:
        """By which it is found: a recording has one of each kind, of revolute and of prismatic joints."""
        return self.kind, self.slides

    @property
    def quantities(self) -> tuple[str, ...]:
        """Quantities of its columns, or of each joint's; of a rotation without a form, of one with the same units."""
        if self.form:
            return FORMS[self.form.choice]
        return OF_POSES.get(self.kind, (self.kind,))

    @property
    def members(self) -> tuple[Column, ...]:
        """Each of the columns, once unit and form are decided."""
        unit = self.unit.choice if self.unit else ""
        held = product(self.quantities, self.joints or (0,))
        return tuple(
            Column(name, quantity, joint, unit) for name, (quantity, joint) in zip(self.columns, held, strict=True)
        )

    @property
    def units(self) -> dict[str, float]:
        """The units in which the columns may be, as `units_of`."""
        return units_of(self.quantities[0], self.slides)

    @property
    def forms(self) -> tuple[str, ...]:
        """The forms of which a rotation may be; none where there is no choice."""
        parts = len(self.columns) if self.kind == "rotation" else 0
        return tuple(form for form, names in FORMS.items() if len(names) == parts) if parts in (3, 4) else ()

    def renamed(self, unit: str = "", form: str = "") -> dict[str, str]:
        """The columns with the names that they have in another of `units`, or as another of `forms`."""
        of_unit = self.unit and self.unit._replace(choice=unit or self.unit.choice)
        of_form = self.form and self.form._replace(choice=form or self.form.choice)
        members = replace(self, unit=of_unit, form=of_form).members
        return {column.name: column.documented for column in members}

    def values(self, numbers: Mapping[str, Array]) -> Array:
        """`(sample, column)` of the numbers of a table."""
        return np.stack([numbers[name] for name in self.columns], 1)

    def in_si(self, numbers: Mapping[str, Array]) -> Array:
        """The same in SI units, once the unit is decided."""
        return self.values(numbers) / self.units[self.unit.choice if self.unit else ""]

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values."""
        unit, form = (None if decision is None else decision._asdict() for decision in (self.unit, self.form))
        document = {"kind": self.kind, "columns": self.renamed(), "unit": unit, "form": form}
        return document | ({"commanded": True} if self.rank == 2 else {})


def units_allowed(kind: str, *slides: bool) -> set[str]:
    """The units that a kind of block may have, of revolute joints unless it is said of which."""
    return {unit for slide in slides or (False,) for unit in units_of(OF_POSES.get(kind, (kind,))[0], slide) if unit}


def list_columns(blocks: Iterable[Block], kind: str) -> list[str]:
    """The columns of all blocks of a kind: those of joints along the arm, all of a matrix."""
    of_kind = [block for block in blocks if block.kind == kind]
    names = [name for block in of_kind for name in block.matrix or block.columns]
    joints = [joint for block in of_kind for joint in block.joints]
    if joints:
        names = [names[k] for k in np.argsort(joints)]
    return list(dict.fromkeys(names))


def in_si(blocks: Iterable[Block], kind: str, numbers: Mapping[str, Array]) -> Array | None:
    """`(sample, column)` in SI units of blocks of a kind whose units are decided, along the arm; None of no blocks."""
    of_kind = [block for block in blocks if block.kind == kind]
    if not of_kind:
        return None
    values = np.hstack([block.in_si(numbers) for block in of_kind])
    joints = [joint for block in of_kind for joint in block.joints]
    if joints:
        values = values[:, np.argsort(joints)]
    return values
