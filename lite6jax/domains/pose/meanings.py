"""What blocks of columns mean: the unit and the name of each column, by names, by an arm's kinematics, or by size."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.readings import Agreement
from lite6jax.recordings import naming, sizes
from lite6jax.recordings.columns import ANGLES, MATRIX, QUATERNION, units_of
from lite6jax.recordings.naming import Block
from lite6jax.recordings.sequence import inferred_motion
from lite6jax.recordings.sizes import Decision

Array = NDArray[np.floating]
Key = tuple[str, bool]
"""The kind of a block, and whether it is of prismatic joints."""

_XYZ = ("x", "y", "z")
_SCALAR_FIRST, _SCALAR_LAST = "scalar_first", "scalar_last"
_USUAL = {"temp": "degC", "payload": "kg", "ambient": "degC", "run": ""}
"""The unit of quantities that have one only."""


class Meaning(NamedTuple):
    """What one block of columns means.

    Attributes:
        block: the columns.
        names: in a recording, one for each column.
        unit: in which unit, and why; of quaternions nothing.
        form: of a rotation, which form, and why.
    """

    block: Block
    names: tuple[str, ...]
    unit: Decision
    form: Decision | None = None

    def renamed(self, *, unit: str | None = None, form: str | None = None) -> dict[str, str]:
        """The columns with the names that they have in another unit, or as another of `forms`; for `given`."""
        if form in (_SCALAR_FIRST, _SCALAR_LAST):
            return dict(zip(self.block.columns, _of_quaternion(form), strict=True))
        parts = next((parts for parts in ANGLES if parts[0] == form), None)
        quantities = parts or tuple(without_unit(name) for name in self.names)
        unit = unit or self.unit.choice
        return {own: f"{part}_{unit}" for own, part in zip(self.block.columns, quantities, strict=True)}

    @property
    def units(self) -> tuple[str, ...]:
        """The units in which the columns may be."""
        quantity = without_unit(self.names[0]).rstrip("0123456789")
        return tuple(unit for unit in units_of(quantity, self.block.slides) if unit)

    @property
    def forms(self) -> tuple[str, ...]:
        """The forms of which a rotation may be; none of anything else."""
        if self.form is None or self.names == MATRIX:
            return ()
        return (_SCALAR_FIRST, _SCALAR_LAST) if len(self.names) == 4 else tuple(parts[0] for parts in ANGLES)

    def in_si(self, values: Array) -> Array:
        """Numbers `(sample, column)` in SI units, of a block whose quantity is its kind."""
        return values / units_of(self.block.kind, self.block.slides)[self.unit.choice]

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values."""
        form = None if self.form is None else self.form._asdict()
        columns = dict(zip(self.block.columns, self.names, strict=True))
        said = {"kind": self.block.kind, "columns": columns, "unit": self.unit._asdict(), "form": form}
        return said | ({"commanded": True} if self.block.rank == 2 else {})


def without_unit(name: str) -> str:
    """The name of a recording's column without its unit, such as `q1`."""
    return name.partition("_")[0]


def key(block: Block) -> Key:
    """By which a block is found: a recording has one of each."""
    return block.kind, block.slides


def meanings_of(blocks: Mapping[Key, Block], values: Mapping[Key, Array], agreed: Agreement) -> tuple[Meaning, ...]:
    """What blocks mean, in the order of `naming.KINDS`; commands that the joints do not follow mean nothing.

    Args:
        blocks: by `key`.
        values: `(sample, column)` of each.
        agreed: the units and forms with which an arm agrees.
    """
    found = {of: _position(blocks[of], values[of], agreed) for of in (("q", False), ("q", True)) if of in blocks}
    moved = {slides: found["q", slides].in_si(values["q", slides]) for _, slides in found}
    time: Array | None = None
    if block := blocks.get(of := ("time", False)):
        joints = np.hstack(list(moved.values())) if moved else None
        unit = _named(block) or sizes.time_unit(values[of][:, 0], joints)
        found[of] = _meaning(block, unit)
        time = found[of].in_si(values[of])[:, 0]
    for of in ((kind, slides) for kind in ("dq", "ddq") for slides in moved):
        if block := blocks.get(of):
            before = found.get(("dq", of[1]))
            position = (
                moved[of[1]] if of[0] == "dq" else None if before is None else before.in_si(values[key(before.block)])
            )
            usual = found["q", of[1]].unit.choice
            found[of] = _meaning(block, _named(block) or _rate(block, values[of], position, usual, time))
    for of in (("cmd", slides) for slides in moved):
        block = blocks.get(of)
        unit = block and sizes.unit_of_command(values[of], moved[of[1]], of[1], block.unit)
        if block and unit:
            found[of] = _meaning(block, unit)
    for of, block in blocks.items():
        if of not in found and block.kind not in ("dq", "ddq", "cmd"):
            found[of] = _other(block, values[of], agreed)
    return tuple(found[kind, slides] for kind in naming.KINDS for slides in (False, True) if (kind, slides) in found)


def motion_of(meanings: Sequence[Meaning], values: Mapping[Key, Array]) -> tuple[str, str]:
    """`static` or `trajectory`, and why in words."""

    def si(kind: str) -> Array | None:
        found = [meaning.in_si(values[key(meaning.block)]) for meaning in meanings if meaning.block.kind == kind]
        return np.hstack(found) if found else None

    time = si("time")
    return inferred_motion(None if time is None else time[:, 0], si("dq"))


def _position(block: Block, values: Array, agreed: Agreement) -> Meaning:
    if block.slides:
        return _meaning(block, _named(block) or agreed.slide or sizes.length_unit(values))
    servo = all(name.endswith(".pos") or name.startswith("observation.state") for name in block.columns)
    return _meaning(block, _named(block) or agreed.angle or sizes.angle_unit(values, servo))


def _other(block: Block, values: Array, agreed: Agreement) -> Meaning:
    """What is neither a position of joints, nor their rates, nor time."""
    if block.kind == "rotation":
        return _rotation(block, values, agreed)
    unit = _named(block)
    if block.kind == "position":
        unit = unit or agreed.length or sizes.length_unit(values)
        return Meaning(block, tuple(_with_unit(axis, unit.choice) for axis in _XYZ), unit)
    if block.kind == "tau" and not block.slides:
        return _meaning(block, unit or sizes.torque_unit(values))
    if block.kind == "current":
        return _meaning(block, unit or sizes.current_unit(values))
    return _meaning(block, unit or Decision(_USUAL.get(block.kind, "N"), "assumed", "usual", {}))


def _named(block: Block) -> Decision | None:
    return None if block.unit is None else sizes.by_name(block.unit)


def _rate(block: Block, rate: Array, position: Array | None, usual: str, time: Array | None) -> Decision:
    suffix = "_per_s" if block.kind == "dq" else "_per_s2"
    if position is None:
        return Decision(f"{usual}{suffix}", "assumed", "as_positions", {})
    decided = sizes.rate_unit(rate, position, usual, time, units_of("q", block.slides))
    return decided._replace(choice=f"{decided.choice}{suffix}")


def _rotation(block: Block, values: Array, agreed: Agreement) -> Meaning:
    form, unit = sizes.rotation_form(values, block.unit, block.form, block.sure)
    said = block.form in (QUATERNION, MATRIX)  # by the names or order of its columns
    if agreed.form is not None and (agreed.form.choice == form.choice if said else True):
        form = form if form.sure == "certain" and agreed.form.choice == form.choice else agreed.form
    if agreed.turn is not None and block.unit is None:
        unit = agreed.turn
    if block.form == MATRIX:
        return Meaning(block, MATRIX, unit, form)
    if values.shape[1] == 4:
        return Meaning(block, _of_quaternion(form.choice), unit, form)
    parts = next(parts for parts in ANGLES if parts[0] == form.choice)
    return Meaning(block, tuple(_with_unit(part, unit.choice) for part in parts), unit, form)


def _meaning(block: Block, unit: Decision) -> Meaning:
    """Of columns whose quantity is the block's kind."""
    names = [f"{block.kind}{joint}" for joint in block.joints] or [block.kind]
    return Meaning(block, tuple(_with_unit(name, unit.choice) for name in names), unit)


def _with_unit(name: str, unit: str) -> str:
    return f"{name}_{unit}" if unit else name


def _of_quaternion(form: str) -> tuple[str, ...]:
    return QUATERNION if form == _SCALAR_FIRST else (*QUATERNION[1:], QUATERNION[0])
