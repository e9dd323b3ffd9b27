"""What the blocks of columns of a table mean: the unit and the name of each column, and the form of rotations.

Names decide where they say it. Else the readings are compared with the nominal forward kinematics of an arm, with the
sensor's frame and the tool fitted in closed form; where none agrees best, sizes decide.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.calibration.start import frames_from_poses
from lite6jax.recordings import naming, sizes
from lite6jax.recordings.columns import ANGLES, MATRIX, QUATERNION, quaternions, units_of
from lite6jax.recordings.naming import Block
from lite6jax.recordings.sequence import inferred_motion, spread_rows
from lite6jax.recordings.sizes import Decision, Sureness

Array = NDArray[np.floating]
Key = tuple[str, bool]
"""The kind of a block, and whether it is of prismatic joints."""

ROWS = 400
"""Spread over the recording: enough to tell readings that differ by factors or by whole rotations."""
FEWEST = 8
"""Rows: the frame and the tool have nine numbers."""
CLOSE = 0.05
"""Of the spread of the positions, which errors of the right reading do not exceed: a nominal arm of 1 m is off by
millimetres. A wrong reading is off by as much as the arm moves."""
CLOSE_RAD = 0.2
"""The same for orientations."""
CLEARLY = 3.0
"""Times the error of the best reading, which all others have where it is certain."""
SLIGHTLY = 1.3
"""The same where it is likely."""
LEAST_SPREAD_M = 5e-3
"""Of positions that say something of an arm, from their median: those of one touched point set no scale."""
LONGEST_TOOL_M = 1.0
"""Or the reach of an arm, if that is longer."""
FINEST_SENSOR_M = 2e-5
"""Above, an error may be a sensor's noise."""
COMPUTED_M = 2e-6
"""Below, it is none: controllers compute in single precision too."""
LEAST_TRAVEL_M = 0.02
"""Of positions of which is said that they are computed."""
_XYZ = ("x", "y", "z")
_SCALAR_FIRST, _SCALAR_LAST = "scalar_first", "scalar_last"
_USUAL = {"temp": "degC", "payload": "kg", "ambient": "degC", "run": ""}
"""The unit of quantities that have one only."""


class Agreement(NamedTuple):
    """The readings that agree with an arm; None where they are not distinguished.

    Attributes:
        angle: `rad` or `deg` of the revolute joints.
        slide: `m` or `mm` of the prismatic joints.
        length: `m` or `mm` of the positions.
        form: of the rotation: the first name of one of `columns.ANGLES`, `scalar_first` or `scalar_last`.
        turn: `rad` or `deg` of three numbers of a rotation.
        error: m, the median error of the best reading; infinite where too few rows tell.
        spread: m, of the positions in it.
    """

    angle: Decision | None
    slide: Decision | None
    length: Decision | None
    form: Decision | None
    turn: Decision | None
    error: float
    spread: float

    @property
    def close(self) -> bool:
        """Whether the arm agrees with the poses at all."""
        return self.error <= CLOSE * self.spread


NO_AGREEMENT = Agreement(None, None, None, None, None, np.inf, 0.0)


def agreement(
    arm: Arm,
    joint: Array,
    position: Array,
    rotation: Array | None,
    angle: str | None,
    slide: str | None,
    length: str | None,
    turn: str | None,
) -> Agreement:
    """The readings of a table with which an arm agrees best.

    Args:
        arm: of as many joints.
        joint: `(sample, joint)` in the table's unit, rad or deg, and m or mm of prismatic joints; no row has gaps.
        position: `(sample, 3)`, m or mm.
        rotation: `(sample, 3 | 4)`, in the table's unit and convention, or None.
        angle, slide, length, turn: units that are known already, or None.
    """
    if len(joint) < FEWEST:
        return NO_AGREEMENT
    rows = spread_rows(len(joint), ROWS)
    # a gantry that is a thousand times as large moves alike: the size decides the one unit, and that the other
    by_size = length is None and bool(arm.slides.all())
    length = sizes.length_unit(position).choice if by_size else length

    def possible(known: str | None, quantity: str, slides: bool) -> tuple[str, ...]:
        return (known,) if known else tuple(units_of(quantity, slides))

    turns = ("rad",) if arm.slides.all() else possible(angle, "q", False)
    slides = possible(slide, "q", True) if arm.sliding else ("m",)
    tried: dict[tuple[str, ...], tuple[float, float, float, Array]] = {}
    for units in product(turns, slides, possible(length, "x", False)):
        divisor = np.where(arm.slides, units_of("q", True)[units[1]], units_of("q")[units[0]])
        places, flange = position[rows] / units_of("x")[units[2]], flange_poses(arm, joint[rows] / divisor)
        error, T_sensor_base = match_poses(flange, places)
        spread = median_distance(places)
        tried[units] = error / max(spread, 1e-9), error, spread, T_sensor_base[:3, :3] @ flange[:, :3, :3]
    # a free tool takes up any scale where the axes cross, so that the size counts as well
    farthest = 2 * (arm.reach + max(arm.reach, LONGEST_TOOL_M))
    plausible = {units: one for units, one in tried.items() if LEAST_SPREAD_M < one[2] < farthest}
    by_size, tried = by_size or not plausible, plausible or tried
    best = min(tried, key=lambda units: tried[units][0])
    score, error, spread, predicted = tried[best]
    decided: list[Decision | None] = []
    for k in range(3):
        of_each: dict[str, list[float]] = {}
        for units, one in tried.items():
            of_each.setdefault(units[k], []).append(one[0])
        decided.append(_decided(best[k], {unit: min(scores) for unit, scores in of_each.items()}, CLOSE))
    form, angle_of_turn = None, None
    if rotation is not None and score <= CLOSE:
        form, angle_of_turn = _rotations(predicted, rotation[rows], turn)
    of_turns, of_slides, of_places = decided
    return Agreement(of_turns, of_slides, None if by_size else of_places, form, angle_of_turn, error, spread)


def computed_by_controller(error: float, position: Array, joint: Array) -> bool:
    """Whether an arm reproduces positions as only the controller's own computation from the joints is reproduced.

    Args:
        error: m, the median distance of the positions from those of the arm's kinematics.
        position: `(sample, 3)` m.
        joint: `(sample, joint)` rad, and m of prismatic joints.
    """
    spread = median_distance(position)
    turn = max(digit_step(joint), np.deg2rad(digit_step(np.rad2deg(joint))))
    step = float(np.hypot(digit_step(position), turn * spread * joint.shape[1] ** 0.5))
    return spread > LEAST_TRAVEL_M and error <= min(max(COMPUTED_M, step), FINEST_SENSOR_M)


def digit_step(values: Array) -> float:
    """The place of the last digit with which numbers are written, such as 0.001; 0 beyond the ninth."""
    there = values[np.isfinite(values)]
    there = there[:: max(len(there) // 1000, 1)]
    digits = (k for k in range(10) if np.allclose(there, np.round(there, k), rtol=0, atol=1e-3 * 10.0**-k))
    place = next(digits, None)
    return 0.0 if place is None else 10.0**-place


def median_distance(position: Array) -> float:
    """m, of positions `(sample, 3)` from their median."""
    return float(np.median(np.linalg.norm(position - np.median(position, axis=0), axis=1)))


def flange_poses(arm: Arm, joint: Array) -> Array:
    """Nominal `T_base_flange` `(sample, 4, 4)` at joints `(sample, joint)` in SI units."""
    return frames.chain(arm.links, joint, arm.sliding) @ arm.T_joint_flange


def match_poses(flange: Array, position: Array) -> tuple[float, Array]:
    """The median error in m of positions `(sample, 3)` with frame and tool in closed form, and `T_sensor_base`."""
    T_sensor_base, T_flange_tool = frames_from_poses(flange, position, None, None, None)
    missed = position - (T_sensor_base @ flange @ T_flange_tool)[:, :3, 3]
    return float(np.median(np.linalg.norm(missed, axis=1))), T_sensor_base


def _rotations(predicted: Array, rotation: Array, unit: str | None) -> tuple[Decision | None, Decision | None]:
    """The form of a rotation and its unit, by how constant the tool is on the flange."""
    tried: dict[tuple[str, str], float] = {}
    if rotation.shape[1] == 4:
        for name, order in (("scalar_first", (1, 2, 3, 0)), ("scalar_last", (0, 1, 2, 3))):
            length = np.linalg.norm(rotation, axis=1, keepdims=True)
            tried[name, ""] = _wobble(predicted, rotation[:, order] / np.where(length > 0, length, 1.0) + 0.0)
    else:
        for form, angle in product(ANGLES, (unit,) if unit else ("rad", "deg")):
            given = quaternions(form, rotation / units_of(form[0])[angle])
            tried[form[0], angle] = _wobble(predicted, np.roll(given, -1, axis=1))
    best = min(tried, key=lambda reading: tried[reading])
    of_forms = {form: error for (form, angle), error in tried.items() if angle == best[1]}
    of_units = {angle: error for (form, angle), error in tried.items() if form == best[0]}
    form = _decided(best[0], of_forms, CLOSE_RAD)
    return form, None if form is None or not best[1] else _decided(best[1], of_units, CLOSE_RAD)


def _wobble(predicted: Array, quaternion: Array) -> float:
    """rad, the median turn of the tool on the flange from its mean; `quaternion` scalar last."""
    from scipy.spatial.transform import Rotation  # takes longer than a look at positions

    usable = np.linalg.norm(quaternion, axis=1) > 0.5
    if usable.sum() < FEWEST:
        return np.pi
    relative = np.swapaxes(predicted[usable], 1, 2) @ Rotation.from_quat(quaternion[usable]).as_matrix()
    turned = Rotation.from_matrix(relative)
    return float(np.median((turned.mean().inv() * turned).magnitude()))


def _decided(best: str, errors: dict[str, float], limit: float) -> Decision | None:
    """The best of some readings; None where it does not agree, or others do as well."""
    others = {name: error for name, error in errors.items() if name != best}
    numbers = {"error": errors[best], "others": others}
    if errors[best] > limit:
        return None
    if not others:
        return Decision(best, "certain", "kinematics", numbers)
    ratio = min(others.values()) / max(errors[best], 1e-12)
    if ratio < SLIGHTLY:
        return None
    sure: Sureness = "certain" if ratio >= CLEARLY else "likely"
    return Decision(best, sure, "kinematics", numbers)


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
    joints = [of for of in (("q", False), ("q", True)) if of in blocks]
    found = {of: _meaning(blocks[of], _unit_of(blocks[of], values[of], agreed)) for of in joints}
    moved = {slides: found["q", slides].in_si(values["q", slides]) for _, slides in found}
    time: Array | None = None
    if block := blocks.get(of := ("time", False)):
        position = np.hstack(list(moved.values())) if moved else None
        found[of] = _meaning(block, _named(block) or sizes.time_unit(values[of][:, 0], position))
        time = found[of].in_si(values[of])[:, 0]
    for of in ((kind, slides) for kind in ("dq", "ddq") for slides in moved):
        if block := blocks.get(of):
            before = found.get(("q" if of[0] == "dq" else "dq", of[1]))
            position = None if before is None else before.in_si(values[key(before.block)])
            usual = found["q", of[1]].unit.choice
            found[of] = _meaning(block, _named(block) or _rate(block, values[of], position, usual, time))
    for of in (("cmd", slides) for slides in moved):
        block = blocks.get(of)
        unit = block and sizes.unit_of_command(values[of], moved[of[1]], of[1], block.unit)
        if block and unit:
            found[of] = _meaning(block, unit)
    for of, block in blocks.items():
        if of not in found and block.kind not in ("dq", "ddq", "cmd"):
            turns = block.kind == "rotation"
            of_block = block, values[of], agreed
            found[of] = _rotation(*of_block) if turns else _meaning(block, _unit_of(*of_block))
    return tuple(found[kind, slides] for kind in naming.KINDS for slides in (False, True) if (kind, slides) in found)


def motion_of(meanings: Sequence[Meaning], values: Mapping[Key, Array]) -> tuple[str, str]:
    """`static` or `trajectory`, and why in words."""

    def si(kind: str) -> Array | None:
        found = [meaning.in_si(values[key(meaning.block)]) for meaning in meanings if meaning.block.kind == kind]
        return np.hstack(found) if found else None

    time = si("time")
    return inferred_motion(None if time is None else time[:, 0], si("dq"))


def _unit_of(block: Block, values: Array, agreed: Agreement) -> Decision:
    """Of what is neither a rotation, a rate, a command nor a time: by name, by kinematics, or by size."""
    if block.unit is not None:
        return sizes.by_name(block.unit)
    if block.kind == "q" and not block.slides:
        servo = all(name.endswith(".pos") or name.startswith("observation.state") for name in block.columns)
        return agreed.angle or sizes.angle_unit(values, servo)
    if block.kind in ("q", "position"):
        return (agreed.slide if block.slides else agreed.length) or sizes.length_unit(values)
    if block.kind == "tau" and not block.slides:
        return sizes.torque_unit(values)
    if block.kind == "current":
        return sizes.current_unit(values)
    return Decision(_USUAL.get(block.kind, "N"), "assumed", "usual", {})


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
    return Meaning(block, _with_unit(parts, unit), unit, form)


def _meaning(block: Block, unit: Decision) -> Meaning:
    """Of columns whose quantity is the block's kind."""
    named = tuple(f"{block.kind}{joint}" for joint in block.joints) or (block.kind,)
    return Meaning(block, _with_unit(_XYZ if block.kind == "position" else named, unit), unit)


def _with_unit(names: Sequence[str], unit: Decision) -> tuple[str, ...]:
    return tuple(f"{name}_{unit.choice}" if unit.choice else name for name in names)


def _of_quaternion(form: str) -> tuple[str, ...]:
    return QUATERNION if form == _SCALAR_FIRST else (*QUATERNION[1:], QUATERNION[0])
