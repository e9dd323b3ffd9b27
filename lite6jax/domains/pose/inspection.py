"""What a table with column names of its own holds: by names, by the sizes of the numbers, and by an arm's kinematics.

Names come first; what they leave open, such as units and the form of a rotation, the arm decides where one is known or
recognised, and sizes decide elsewhere. Codes and numbers only: the words are those of `report.inspection`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import bundled_of
from lite6jax.arms.factory import RECOGNISED_WITHIN
from lite6jax.domains.pose.meanings import Key, Meaning, key, meanings_of, motion_of, without_unit
from lite6jax.domains.pose.readings import NO_AGREEMENT, Agreement, Pose, agreement
from lite6jax.errors import InputError
from lite6jax.recordings import naming, streams
from lite6jax.recordings.columns import (
    ANGLES,
    IGNORED,
    QUATERNION,
    differs_by_joint,
    is_per_joint,
    is_refused,
    is_standard,
    nearest_known,
)
from lite6jax.recordings.naming import Block

Array = NDArray[np.floating]

ALIKE = 2.0
"""Times the error of the best arm, within which another one is as likely, as in `fitting.recognition`."""


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
        taken = {without_unit(name) for name in self.given.values()}
        told = {own: IGNORED if without_unit(name) in taken else name for own, name in told.items()} | dict(self.given)
        unused = {name: IGNORED for name in (*self.unused, *self.texts) if not is_standard(name)}
        needed = any(own != name for own, name in told.items()) or any(map(is_refused, unused))
        return told | unused if needed else {}

    def of(self, kind: str) -> Meaning | None:
        """The meaning of a kind of block: of revolute joints where there are some."""
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
        InputError: a column that is given is not there, or there are no rows.
    """
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
    numbers = _at_poses(numbers, named)
    blocks = {key(block): block for block in named}
    values = {of: np.stack([numbers[name] for name in block.columns], 1) for of, block in blocks.items()}
    pose = _pose(blocks, values)
    tried = _tried(arm, pose, blocks)
    arm, agreed = _chosen(arm, tried)
    turned = blocks.get(("rotation", False))
    if turned is not None and all(name in given for name in turned.columns):
        agreed = agreed._replace(form=None, turn=None)
    meanings = meanings_of(blocks, values, agreed)
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
        motion=motion_of(meanings, values),
    )


def _at_poses(numbers: Mapping[str, Array], blocks: Sequence[Block]) -> Mapping[str, Array]:
    """The rows with poses, where joints and poses stand in different rows: the joints are interpolated there."""
    of = {kind: [name for block in blocks if block.kind == kind for name in block.columns]
          for kind in ("q", "position", "time")}  # fmt: skip
    found = streams.merged(numbers, of["q"], of["position"], of["time"][0]) if of["time"] else None
    return numbers if found is None else found.columns


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
    blocks = _with_given(blocks, given)
    q = next((block for block in blocks if block.kind == "q"), None)
    dof = arm.dof if arm is not None else len(q.columns) if q is not None else 0
    sliding = _sliding(q, given) if arm is None else arm.sliding
    found = []
    for block in blocks:
        if is_per_joint(block.kind):
            columns = block.columns[: dof or None]
            if len(columns) < dof and block.kind != "q":
                continue
            block = replace(block, columns=columns, joints=tuple(range(1, len(columns) + 1)))
        for part in _by_joint(block, sliding):
            units = {_unit_of(part, given.get(name, "")) for name in part.columns}
            if len(units) == 1 and None not in units:
                part = replace(part, unit=units.pop())
            form = tuple(without_unit(given.get(name, "")) for name in part.columns)
            turned = part.kind == "rotation" and (form in ANGLES or {*form} == {*QUATERNION})
            found.append(replace(part, form=form) if turned else part)
    placed = any(block.kind == "position" for block in found)
    return [block for block in found if placed or block.kind != "rotation"]


def _with_given(blocks: Sequence[Block], given: Mapping[str, str]) -> list[Block]:
    """With the joint positions and the place of the tool that are given throughout, in place of what names say."""
    own = {without_unit(name): column for column, name in given.items()}
    joints = sum(name.startswith("q") and name[1:].isdecimal() for name in own)
    found = []
    for kind, names in (("q", [f"q{joint}" for joint in range(1, joints + 1)]), ("position", list("xyz"))):
        if names and own.keys() >= set(names):
            found.append(Block(kind, tuple(own[name] for name in names)))
    kinds = {block.kind for block in found}
    return [*found, *(block for block in blocks if block.kind not in kinds)]


def _sliding(q: Block | None, given: Mapping[str, str]) -> tuple[int, ...]:
    """The joints, counted from 0, whose columns are lengths by what is given or by their names."""
    if q is None:
        return ()
    units = [given[name].partition("_")[2] if name in given else naming.unit_of(name) for name in q.columns]
    return tuple(joint for joint, unit in enumerate(units) if unit in naming.units_allowed("q", True))


def _by_joint(block: Block, sliding: Sequence[int]) -> list[Block]:
    """A block whose units depend on the kind of a joint as one of the revolute and one of the prismatic joints."""
    if not (sliding and differs_by_joint(block.kind)):
        return [block]
    parts = []
    for slides in (False, True):
        own = [place for place, joint in enumerate(block.joints) if (joint - 1 in sliding) == slides]
        if own:
            columns = tuple(block.columns[place] for place in own)
            units = {naming.unit_of(name) for name in columns}
            unit = units.pop() if len(units) == 1 else None
            unit = unit if unit in naming.units_allowed(block.kind, slides) else None
            joints = tuple(block.joints[place] for place in own)
            parts.append(replace(block, columns=columns, joints=joints, slides=slides, unit=unit))
    return parts


def _unit_of(block: Block, name: str) -> str | None:
    """The unit in a name of a recording's column, where the block may have it."""
    unit = name.partition("_")[2]
    return unit if unit and unit in naming.units_allowed(block.kind, block.slides) else None


def _pose(blocks: Mapping[Key, Block], values: Mapping[Key, Array]) -> Pose | None:
    """The rows without gaps of joints and poses."""
    of_joints = [(joint, column) for of in (("q", False), ("q", True)) if of in blocks
                 for joint, column in zip(blocks[of].joints, values[of].T, strict=True)]  # fmt: skip
    if not of_joints or ("position", False) not in blocks:
        return None
    parts = [np.stack([column for _, column in sorted(of_joints, key=lambda pair: pair[0])], 1)]
    parts += [values[of] for of in (("position", False), ("rotation", False)) if of in blocks]
    whole = np.logical_and.reduce([np.isfinite(part).all(axis=1) for part in parts])
    joint, position, *rotation = (part[whole] for part in parts)
    return Pose(joint, position, rotation[0] if rotation else None)


def _tried(arm: Arm | None, pose: Pose | None, blocks: Mapping[Key, Block]) -> list[tuple[Arm, Agreement]]:
    if pose is None:
        return []
    slides = blocks.get(("q", True))
    sliding = () if slides is None else tuple(joint - 1 for joint in slides.joints)
    arms = [arm] if arm is not None else bundled_of(pose.joint.shape[1])
    rotation = blocks.get(("rotation", False))
    turn = None if rotation is None or len(rotation.columns) == 4 else rotation.unit
    angle, slide, length = (
        None if (block := blocks.get(of)) is None else block.unit
        for of in (("q", False), ("q", True), ("position", False))
    )
    found = [
        (one, agreement(one, pose, angle, slide, length, turn))
        for one in arms
        if one.dof == pose.joint.shape[1] and one.sliding == sliding
    ]
    return sorted(found, key=lambda entry: entry[1].error)


def _chosen(arm: Arm | None, tried: Sequence[tuple[Arm, Agreement]]) -> tuple[Arm | None, Agreement]:
    """The arm whose kinematics decide, where it agrees; the nearest bundled one where no other is as near."""
    if not tried:
        return arm, NO_AGREEMENT
    first, found = tried[0]
    if arm is not None:
        return arm, found if found.close else _undecided(found)
    alone = len(tried) == 1 or tried[1][1].error > max(ALIKE * found.error, 1e-9)
    if not found.close or found.error > RECOGNISED_WITHIN:
        return None, _undecided(found)
    return (first if alone else None), found  # arms that are alike agree on the units


def _undecided(found: Agreement) -> Agreement:
    """The same where an arm is not near enough to decide anything."""
    return found._replace(angle=None, slide=None, length=None, form=None, turn=None)
