"""What a column of a table holds (`Column`), and columns that are decided together, with how sure that is and why."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.recordings.columns.quantities import DEVIATION, FORMS, MATRIX, PLACE, QUANTITIES, spelled, units_of

Array = NDArray[np.floating]

Sureness = Literal["certain", "likely", "assumed"]
"""By name or by kinematics; by size; or the usual one, where neither tells."""
KINDS = (
    *("q", "dq", "ddq", "tau", "current", "temp", "cmd", "position", "deviation", "rotation"),
    *("time", "payload", "ambient", "run"),
)
OF_POSES = {"position": "x", "deviation": "devx", "rotation": "rx"}
"""Quantities of the units of poses."""


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
        """Whether its unit is one of a prismatic joint."""
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
        kind: one of `KINDS`; `position` and `rotation` of the tool, the others as in `QUANTITIES`.
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
    def members(self) -> tuple[Column, ...]:
        """Each of the columns, once unit and form are decided."""
        places = {"position": PLACE, "deviation": DEVIATION}
        parts = FORMS[self.form.choice] if self.form else places.get(self.kind, (self.kind,))
        unit = self.unit.choice if self.unit else ""
        held = product(parts, self.joints or (0,))
        return tuple(
            Column(name, quantity, joint, unit) for name, (quantity, joint) in zip(self.columns, held, strict=True)
        )

    @property
    def units(self) -> dict[str, float]:
        """The units in which the columns may be, as `units_of`."""
        quantity = FORMS[self.form.choice][0] if self.form else OF_POSES.get(self.kind, self.kind)
        return units_of(quantity, self.slides)

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
    return {unit for slide in slides or (False,) for unit in units_of(OF_POSES.get(kind, kind), slide) if unit}


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
