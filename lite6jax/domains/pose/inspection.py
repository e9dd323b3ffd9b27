"""What a table with column names of its own holds: by names, by the sizes of the numbers, and by an arm's kinematics.

Names come first; what they leave open, such as units and the form of a rotation, the arm decides where one is known or
recognised, and sizes decide elsewhere. Codes and numbers only: the words are those of `report.inspection`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import bundled_of
from lite6jax.arms.factory import RECOGNISED_WITHIN
from lite6jax.domains.pose.readings import NO_AGREEMENT, Agreement, Pose, agreement
from lite6jax.errors import InputError
from lite6jax.recordings import naming, sizes
from lite6jax.recordings.columns import (
    ANGLES,
    IGNORED,
    QUATERNION,
    is_per_joint,
    is_refused,
    is_standard,
    nearest_known,
    spelled,
    units_of,
)
from lite6jax.recordings.naming import Block
from lite6jax.recordings.sequence import inferred_motion
from lite6jax.recordings.sizes import Decision

Array = NDArray[np.floating]

_XYZ = ("x", "y", "z")
_SCALAR_FIRST, _SCALAR_LAST = "scalar_first", "scalar_last"

ALIKE = 2.0
"""Times the error of the best arm, within which another one is as likely, as in `fitting.recognition`."""


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
        quantities = parts or tuple(_without_unit(name) for name in self.names)
        unit = unit or self.unit.choice
        return {own: f"{part}_{unit}" for own, part in zip(self.block.columns, quantities, strict=True)}

    @property
    def units(self) -> tuple[str, ...]:
        """The units in which the columns may be."""
        return tuple(unit for unit in units_of(_letters(self.names[0])) if unit)

    @property
    def forms(self) -> tuple[str, ...]:
        """The forms of which a rotation may be; none of anything else."""
        if self.form is None:
            return ()
        return (_SCALAR_FIRST, _SCALAR_LAST) if len(self.names) == 4 else tuple(parts[0] for parts in ANGLES)

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values."""
        form = None if self.form is None else self.form._asdict()
        columns = dict(zip(self.block.columns, self.names, strict=True))
        return {"kind": self.block.kind, "columns": columns, "unit": self.unit._asdict(), "form": form}


@final
@dataclass(frozen=True)
class Inspection:
    """What a table holds.

    Attributes:
        meanings: of the blocks that were recognised.
        given: columns whose meaning was given.
        unused: columns of numbers that mean nothing here, and `texts` those without numbers.
        samples: rows.
        arm: given or recognised; None where it is neither.
        arms: name and error in m of the bundled arms that were tried, the nearest first.
        error: m, the median error of the arm as read; infinite where there is none, or no poses.
        motion: `static` or `trajectory`, and why in words.
    """

    meanings: tuple[Meaning, ...]
    given: Mapping[str, str]
    unused: tuple[str, ...]
    texts: tuple[str, ...]
    samples: int
    arm: Arm | None
    arms: tuple[tuple[str, float], ...]
    error: float
    motion: tuple[str, str]

    @property
    def columns(self) -> dict[str, str]:
        """The sidecar's `columns`; empty where every name is one of a recording already."""
        told = {
            own: name
            for meaning in self.meanings
            for own, name in zip(meaning.block.columns, meaning.names, strict=True)
        }
        taken = {_without_unit(name) for name in self.given.values()}
        told = {own: IGNORED if _without_unit(name) in taken else name for own, name in told.items()} | dict(self.given)
        unused = {name: IGNORED for name in (*self.unused, *self.texts) if not is_standard(name)}
        needed = any(own != name for own, name in told.items()) or any(map(is_refused, unused))
        return told | unused if needed else {}

    def of(self, kind: str) -> Meaning | None:
        """The meaning of a kind of block."""
        return next((meaning for meaning in self.meanings if meaning.block.kind == kind), None)

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values; the reasons are codes."""
        return _finite(
            {
                "columns": self.columns,
                "blocks": [meaning.to_dict() for meaning in self.meanings],
                "unused": [*self.unused, *self.texts],
                "samples": self.samples,
                "arm": None if self.arm is None else self.arm.name,
                "arms_m": dict(self.arms),
                "motion": self.motion[0],
            }
        )


def inspect(
    columns: Sequence[tuple[str, Array | None]],
    arm: Arm | None = None,
    given: Mapping[str, str] | None = None,
    source: str = "recording",
) -> Inspection:
    """What a table holds.

    Args:
        columns: names, and `(sample,)` numbers; None where a column holds none.
        arm: whose recording it is; where not given, every bundled one of as many joints is tried.
        given: columns with the names that they have in a recording, where the caller knows better; or `IGNORED`.
        source: what messages begin with.

    Raises:
        InputError: a column that is given is not there, there are no rows, or the arm has prismatic joints.
    """
    if arm is not None and arm.sliding:
        joint = arm.sliding[0] + 1
        raise InputError(
            f"{source}: joint {joint} of {arm.name} is prismatic, and columns are recognised for revolute joints only; "
            f"write a sidecar with `arm:`, and `columns:` with a line such as `name in the table: q{joint}_m`"
        )
    given = dict(given or {})
    samples = max((len(values) for _, values in columns if values is not None), default=1)
    if not samples:
        raise InputError(f"{source}: has column names but no rows; record again")
    numbers = {name: values for name, values in columns if values is not None and np.isfinite(values).any()}
    texts = tuple(name for name, values in columns if name not in numbers)
    for name in given:
        if name not in dict(columns):
            raise InputError(f"{source}: has no column {name[:60]!r}; {_near(name, list(dict(columns)))}")
    named = _fitting(naming.blocks([name for name in numbers if given.get(name) != IGNORED]), given, arm)
    blocks = {block.kind: block for block in named}
    values = {kind: np.stack([numbers[name] for name in block.columns], 1) for kind, block in blocks.items()}
    pose = _pose(blocks, values)
    tried = _tried(arm, pose, blocks)
    arm, agreed = _chosen(arm, tried)
    if "rotation" in blocks and all(name in given for name in blocks["rotation"].columns):
        agreed = agreed._replace(form=None, turn=None)
    meanings = _meanings(blocks, values, agreed)
    used = {name for block in named for name in block.columns} | set(given)
    return Inspection(
        meanings=meanings,
        given=given,
        unused=tuple(name for name in numbers if name not in used),
        texts=tuple(name for name in texts if name not in given),
        samples=samples,
        arm=arm,
        arms=tuple((one.name, found.error) for one, found in tried),
        error=agreed.error,
        motion=_motion(meanings, values),
    )


def _finite(value: Any) -> Any:
    """The same with None in place of numbers that JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _near(name: str, names: Sequence[str]) -> str:
    near = nearest_known(name)
    shown = ", ".join(repr(other[:40]) for other in names[:8]) + (", ..." if len(names) > 8 else "")
    return f"it has {shown}" if near is None else f"write COLUMN=MEANING, such as joint_1={near}; it has {shown}"


def _fitting(blocks: Sequence[Block], given: Mapping[str, str], arm: Arm | None) -> list[Block]:
    """Without joints that the arm does not have, such as a gripper's, and with the units of names that are given."""
    q = next((block for block in blocks if block.kind == "q"), None)
    dof = arm.dof if arm is not None else len(q.columns) if q is not None else 0
    found = []
    for block in blocks:
        if is_per_joint(block.kind) and dof:
            block = replace(block, columns=block.columns[:dof])
            if len(block.columns) < dof and block.kind != "q":
                continue
        units = {_unit_of(block, given.get(name, "")) for name in block.columns}
        block = replace(block, unit=units.pop()) if len(units) == 1 and None not in units else block
        form = tuple(_without_unit(given.get(name, "")) for name in block.columns)
        turned = block.kind == "rotation" and (form in ANGLES or {*form} == {*QUATERNION})
        found.append(replace(block, form=form) if turned else block)
    placed = any(block.kind == "position" for block in found)
    return [block for block in found if placed or block.kind != "rotation"]


def _unit_of(block: Block, name: str) -> str | None:
    """The unit in a name of a recording's column, where the block may have it."""
    unit = name.partition("_")[2]
    return unit if unit and unit in naming.units_allowed(block.kind) else None


def _without_unit(name: str) -> str:
    return name.partition("_")[0]


def _letters(name: str) -> str:
    """The quantity in the name of a recording's column."""
    return _without_unit(name).rstrip("0123456789")


def _of_quaternion(form: str) -> tuple[str, ...]:
    return QUATERNION if form == _SCALAR_FIRST else (*QUATERNION[1:], QUATERNION[0])


def _pose(blocks: Mapping[str, Block], values: Mapping[str, Array]) -> Pose | None:
    """The rows without gaps of joints and poses."""
    if "q" not in blocks or "position" not in blocks:
        return None
    parts = [values["q"], values["position"], *([values["rotation"]] if "rotation" in blocks else [])]
    whole = np.logical_and.reduce([np.isfinite(part).all(axis=1) for part in parts])
    joint, position, *rotation = (part[whole] for part in parts)
    return Pose(joint, position, rotation[0] if rotation else None)


def _tried(arm: Arm | None, pose: Pose | None, blocks: Mapping[str, Block]) -> list[tuple[Arm, Agreement]]:
    if pose is None:
        return []
    arms = [arm] if arm is not None else bundled_of(pose.joint.shape[1])
    rotation = blocks.get("rotation")
    turn = None if rotation is None or len(rotation.columns) == 4 else rotation.unit
    found = [
        (one, agreement(one, pose, blocks["q"].unit, blocks["position"].unit, turn))
        for one in arms
        if one.dof == pose.joint.shape[1]
    ]
    return sorted(found, key=lambda entry: entry[1].error)


def _chosen(arm: Arm | None, tried: Sequence[tuple[Arm, Agreement]]) -> tuple[Arm | None, Agreement]:
    """The arm whose kinematics decide, where it agrees; the nearest bundled one where no other is as near."""
    if not tried:
        return arm, NO_AGREEMENT
    first, found = tried[0]
    if arm is not None:
        return arm, found if found.close else found._replace(angle=None, length=None, form=None, turn=None)
    alone = len(tried) == 1 or tried[1][1].error > max(ALIKE * found.error, 1e-9)
    if not found.close or found.error > RECOGNISED_WITHIN:
        return None, found._replace(angle=None, length=None, form=None, turn=None)
    return (first if alone else None), found  # arms that are alike agree on the units


def _meanings(blocks: Mapping[str, Block], values: Mapping[str, Array], agreed: Agreement) -> tuple[Meaning, ...]:
    found: dict[str, Meaning] = {}
    joint: Array | None = None
    angle = "rad"
    if "q" in blocks:
        unit = _named(blocks["q"]) or agreed.angle or sizes.angle_unit(values["q"])
        found["q"], angle = _per_joint(blocks["q"], unit), unit.choice
        joint = values["q"] / units_of("q")[angle]
    time: Array | None = None
    if "time" in blocks:
        unit = _named(blocks["time"]) or sizes.time_unit(values["time"][:, 0], joint)
        found["time"] = Meaning(blocks["time"], (_with_unit("time", 0, unit.choice),), unit)
        time = values["time"][:, 0] / units_of("time")[unit.choice]
    for kind in ("dq", "ddq"):
        if kind in blocks and joint is not None:
            before = values["dq"] / units_of("dq")[found["dq"].unit.choice] if kind == "ddq" and "dq" in found else None
            unit = _named(blocks[kind]) or _rate(kind, values[kind], joint if kind == "dq" else before, angle, time)
            found[kind] = _per_joint(blocks[kind], unit)
    for kind, decide in (("tau", sizes.torque_unit), ("current", sizes.current_unit)):
        if kind in blocks:
            found[kind] = _per_joint(blocks[kind], _named(blocks[kind]) or decide(values[kind]))
    if "temp" in blocks:
        found["temp"] = _per_joint(blocks["temp"], _named(blocks["temp"]) or Decision("degC", "assumed", "usual", {}))
    if "position" in blocks:
        unit = _named(blocks["position"]) or agreed.length or sizes.length_unit(values["position"])
        names = tuple(_with_unit(axis, 0, unit.choice) for axis in _XYZ)
        found["position"] = Meaning(blocks["position"], names, unit)
    if "rotation" in blocks:
        found["rotation"] = _rotation(blocks["rotation"], values["rotation"], agreed)
    for kind, unit in (("payload", "kg"), ("ambient", "degC"), ("run", "")):
        if kind in blocks:
            names = (_with_unit(kind, 0, unit),)
            found[kind] = Meaning(blocks[kind], names, _named(blocks[kind]) or Decision(unit, "assumed", "usual", {}))
    return tuple(found[kind] for kind in naming.KINDS if kind in found)


def _named(block: Block) -> Decision | None:
    return None if block.unit is None else sizes.by_name(block.unit)


def _rate(kind: str, rate: Array, position: Array | None, angle: str, time: Array | None) -> Decision:
    suffix = "_per_s" if kind == "dq" else "_per_s2"
    if position is None:
        return Decision(f"{angle}{suffix}", "assumed", "as_positions", {})
    decided = sizes.rate_unit(rate, position, angle, time)
    return decided._replace(choice=f"{decided.choice}{suffix}")


def _rotation(block: Block, values: Array, agreed: Agreement) -> Meaning:
    form, unit = sizes.rotation_form(values, block.unit, block.form)
    doubted = agreed.form is not None and agreed.form.choice != form.choice
    if agreed.form is not None and not (block.form == QUATERNION and doubted):
        form = form if form.sure == "certain" and not doubted else agreed.form
    if agreed.turn is not None and block.unit is None:
        unit = agreed.turn
    if values.shape[1] == 4:
        return Meaning(block, _of_quaternion(form.choice), sizes.by_name(""), form)
    parts = next(parts for parts in ANGLES if parts[0] == form.choice)
    return Meaning(block, tuple(_with_unit(part, 0, unit.choice) for part in parts), unit, form)


def _per_joint(block: Block, unit: Decision) -> Meaning:
    joints = range(1, len(block.columns) + 1)
    return Meaning(block, tuple(_with_unit(block.kind, joint, unit.choice) for joint in joints), unit)


def _with_unit(quantity: str, joint: int, unit: str) -> str:
    return spelled(quantity, joint, list(units_of(quantity)).index(unit))


def _motion(meanings: Sequence[Meaning], values: Mapping[str, Array]) -> tuple[str, str]:
    found = {meaning.block.kind: meaning for meaning in meanings}

    def si(kind: str) -> Array | None:
        if kind not in found:
            return None
        return values[kind] / units_of(kind)[found[kind].unit.choice]

    time = si("time")
    return inferred_motion(None if time is None else time[:, 0], si("dq"))
