"""The unit of the blocks of columns of a table, and the form of rotations.

Names decide where they say it. Else the readings are compared with the nominal forward kinematics of an arm, with the
sensor's frame and the tool fitted in closed form; where none agrees best, sizes decide.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array
from lite6jax.recordings.alignment import flange_poses, match_poses, median_distance
from lite6jax.recordings.columns import sizes
from lite6jax.recordings.columns.column import (
    ANGLES,
    COMMANDS,
    KINDS,
    MATRIX,
    Block,
    Decision,
    Sureness,
    in_si,
    units_of,
)
from lite6jax.recordings.columns.orientations import quaternions
from lite6jax.recordings.sequence import inferred_motion, spread_rows

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
_TURNS = ("q", False)
_SLIDES = ("q", True)
_PLACES = ("position", False)
_FIRST = ("q", "time", "dq", "ddq")
"""Kinds by whose units those of others are decided, in order."""
_BY_SIZE: Mapping[tuple[str, bool], Callable[[Array], Decision]] = {
    _SLIDES: sizes.length_unit,
    _PLACES: sizes.length_unit,
    ("tau", False): sizes.torque_unit,
    ("current", False): sizes.current_unit,
}
"""How the unit is decided by size, by `Block.key`; of what is not here it is the first of its quantity."""


class ArmAgreement(NamedTuple):
    """How the readings of a table agree with an arm.

    Attributes:
        units: of joints, positions and three numbers of a rotation, by `Block.key`, where they are distinguished.
        form: of the rotation, where it is.
        error: m, the median error of the best reading; infinite where too few rows tell.
        spread: m, of the positions in it.
    """

    units: Mapping[tuple[str, bool], Decision] = MappingProxyType({})
    form: Decision | None = None
    error: float = np.inf
    spread: float = 0.0

    @property
    def close(self) -> bool:
        """Tells whether the arm agrees with the poses at all."""
        return self.error <= CLOSE * self.spread

    def undecided(self) -> "ArmAgreement":
        """The same where an arm is not near enough to decide anything."""
        return self._replace(units={}, form=None)


def agreement(
    arm: Arm, joint: Array, position: Array, rotation: Array | None, stated_units: Mapping[tuple[str, bool], str]
) -> ArmAgreement:
    """The readings of a table with which an arm agrees best.

    Args:
        arm: of as many joints.
        joint: `(sample, joint)` in the table's unit, another of prismatic joints; no row has gaps.
        position: `(sample, 3)`, in a unit of its own.
        rotation: `(sample, 3 | 4)`, in the table's unit and convention, or None.
        stated_units: those that are known already, by `Block.key`.
    """
    if len(joint) < FEWEST:
        return ArmAgreement()
    rows = spread_rows(len(joint), ROWS)
    # a gantry that is a thousand times as large moves alike: the size decides the one unit, and that the other
    by_size = _PLACES not in stated_units and bool(arm.slides.all())
    possible = {
        _TURNS: [*sizes.possible_units("q", joint[:, ~arm.slides])],
        _SLIDES: [*sizes.possible_units("q", joint[:, arm.slides], slides=True)],
        _PLACES: [*sizes.possible_units("x", position)],
    }
    possible |= {of: [unit] for of, unit in stated_units.items() if of in possible}
    if arm.slides.all():
        possible[_TURNS] = ["rad"]
    if not arm.sliding:
        possible[_SLIDES] = ["m"]
    if by_size:
        possible[_PLACES] = [sizes.length_unit(position).choice]
    # a free tool takes up any scale where the axes cross, so that the size counts as well
    farthest = 2 * (arm.reach + max(arm.reach, LONGEST_TOOL_M))
    places = {unit: position[rows] / units_of("x")[unit] for unit in possible[_PLACES]}
    spreads = {unit: median_distance(points) for unit, points in places.items()}
    plausible = [unit for unit, spread in spreads.items() if LEAST_SPREAD_M < spread < farthest]
    by_size = by_size or not plausible
    possible[_PLACES] = plausible or possible[_PLACES]
    outcomes: dict[tuple[str, ...], tuple[float, float, float, Array]] = {}
    for turning, sliding in product(possible[_TURNS], possible[_SLIDES]):
        divisor = np.where(arm.slides, units_of("q", True)[sliding], units_of("q")[turning])
        flange = flange_poses(arm, joint[rows] / divisor)
        for unit in possible[_PLACES]:
            error, T_sensor_base = match_poses(flange, places[unit])
            spread = spreads[unit]
            outcomes[turning, sliding, unit] = (
                error / max(spread, 1e-9),
                error,
                spread,
                T_sensor_base[:3, :3] @ flange[:, :3, :3],
            )
    chosen = min(outcomes, key=lambda units: outcomes[units][0])
    score, error, spread, predicted = outcomes[chosen]
    decided: dict[tuple[str, bool], Decision | None] = {}
    for k, of in enumerate(possible):
        of_each: dict[str, list[float]] = {}
        for units, outcome in outcomes.items():
            of_each.setdefault(units[k], []).append(outcome[0])
        decided[of] = _decided(chosen[k], {unit: min(scores) for unit, scores in of_each.items()}, CLOSE)
    form = None
    if by_size:
        del decided[_PLACES]
    if rotation is not None and score <= CLOSE:
        form, decided["rotation", False] = _rotations(predicted, rotation[rows], stated_units.get(("rotation", False)))
    return ArmAgreement({of: unit for of, unit in decided.items() if unit}, form, error, spread)


def _rotations(predicted: Array, rotation: Array, unit: str | None) -> tuple[Decision | None, Decision | None]:
    """The form of a rotation and its unit, by how constant the tool is on the flange."""
    wobbles: dict[tuple[str, str], float] = {}
    if rotation.shape[1] == 4:
        for name, order in (("scalar_first", (1, 2, 3, 0)), ("scalar_last", (0, 1, 2, 3))):
            length = np.linalg.norm(rotation, axis=1, keepdims=True)
            wobbles[name, ""] = _wobble(predicted, rotation[:, order] / np.where(length > 0, length, 1.0) + 0.0)
    else:
        for form, angle in product(ANGLES, (unit,) if unit else sizes.possible_units("rx", rotation)):
            turns = quaternions(form, rotation / units_of(form[0])[angle])
            wobbles[form[0], angle] = _wobble(predicted, np.roll(turns, -1, axis=1))
    steadiest = min(wobbles, key=lambda reading: wobbles[reading])
    of_forms = {form: error for (form, angle), error in wobbles.items() if angle == steadiest[1]}
    of_units = {angle: error for (form, angle), error in wobbles.items() if form == steadiest[0]}
    form = _decided(steadiest[0], of_forms, CLOSE_RAD)
    return form, None if form is None or not steadiest[1] else _decided(steadiest[1], of_units, CLOSE_RAD)


def _wobble(predicted: Array, quaternion: Array) -> float:
    """rad, the median turn of the tool on the flange from its mean; `quaternion` scalar last."""
    from scipy.spatial.transform import Rotation  # takes longer than a look at positions

    usable = np.linalg.norm(quaternion, axis=1) > 0.5
    if usable.sum() < FEWEST:
        return np.pi
    relative = np.swapaxes(predicted[usable], 1, 2) @ Rotation.from_quat(quaternion[usable]).as_matrix()
    turned = Rotation.from_matrix(relative)
    return float(np.median((turned.mean().inv() * turned).magnitude()))


def _decided(choice: str, errors: dict[str, float], limit: float) -> Decision | None:
    """The best of some readings; None where it does not agree, or others do as well."""
    rivals = {name: error for name, error in errors.items() if name != choice}
    numbers = {"error": errors[choice], "others": rivals}
    if errors[choice] > limit:
        return None
    if not rivals:
        return Decision(choice, "certain", "kinematics", numbers)
    ratio = min(rivals.values()) / max(errors[choice], 1e-12)
    if ratio < SLIGHTLY:
        return None
    sure: Sureness = "certain" if ratio >= CLEARLY else "likely"
    return Decision(choice, sure, "kinematics", numbers)


def decide(
    blocks: Sequence[Block], numbers: Mapping[str, Array], agreed: ArmAgreement, arm: Arm | None
) -> tuple[Block, ...]:
    """Blocks with their units and forms, in the order of `KINDS`; no commands that the joints do not follow.

    Args:
        blocks: one of each `key`.
        numbers: `(sample,)` of each column.
        agreed: the units and forms with which an arm agrees.
        arm: as given, not as recognised; that a joint of it has no end matters for its unit.
    """
    decided: dict[tuple[str, bool], Block] = {}
    first = [block for kind in _FIRST for block in blocks if block.kind == kind]
    for block in (*first, *(block for block in blocks if block.kind not in _FIRST)):
        values = block.values(numbers)
        unit = block.unit
        form = None
        q = decided.get(("q", block.slides))
        if q is None and block.kind in ("dq", "ddq", *COMMANDS):
            continue
        if block.kind == "rotation":
            unit, form = _of_rotation(block, values, agreed)
        elif q is not None and block.kind == "cmd":
            named = block.rank == 2
            unit = sizes.unit_of_command(values, q.in_si(numbers), block.slides, unit and unit.choice, named)
            if unit is None:
                continue
        elif unit is None and block.kind == "deviation" and ("position", False) in decided:
            places = decided["position", False].unit
            unit = places and Decision(places.choice, "assumed", "as_positions", {})
        elif unit is None and block.kind == "time":
            unit = sizes.time_unit(values[:, 0], in_si(decided.values(), "q", numbers))
        elif q is not None and unit is None and block.kind in ("dq", "ddq", "cmd_dq"):
            slower = decided.get(("dq", block.slides)) if block.kind == "ddq" else q
            time = in_si(decided.values(), "time", numbers)
            unit = _of_rate(block, values, q, slower and slower.in_si(numbers), None if time is None else time[:, 0])
        decided[block.key] = replace(block, unit=unit or _unit(block, values, agreed, arm), form=form)
    return tuple(sorted(decided.values(), key=lambda block: (KINDS.index(block.kind), block.slides)))


def motion_of(blocks: Iterable[Block], numbers: Mapping[str, Array]) -> tuple[str, str]:
    """`static` or `trajectory`, and why in words."""
    time = in_si(blocks, "time", numbers)
    return inferred_motion(None if time is None else time[:, 0], in_si(blocks, "dq", numbers))


def _of_rate(block: Block, rate: Array, q: Block, slower: Array | None, time: Array | None) -> Decision:
    """The unit of velocities or accelerations, by the positions or velocities of the same joints."""
    assert q.unit is not None
    suffix = "_per_s2" if block.kind == "ddq" else "_per_s"
    decided = sizes.rate_unit(rate, slower, q.unit.choice, time, q.units)
    return decided._replace(choice=f"{decided.choice}{suffix}")


def _unit(block: Block, values: Array, agreed: ArmAgreement, arm: Arm | None) -> Decision:
    """The unit of what is neither a rotation, a rate, a command nor a time: by kinematics, or by size."""
    if block.key in agreed.units:
        return agreed.units[block.key]
    if block.key == _TURNS:
        servo = all(name.endswith(".pos") or name.startswith("observation.state") for name in block.columns)
        if arm is None or values.shape[1] != arm.dof:
            return sizes.angle_unit(values, servo)
        return sizes.angle_unit(values, servo, arm.endless, arm.joint_limits)
    if block.key in _BY_SIZE:
        return _BY_SIZE[block.key](values)
    return Decision(next(iter(block.units)), "assumed", "usual", {})


def _of_rotation(block: Block, values: Array, agreed: ArmAgreement) -> tuple[Decision, Decision]:
    """The unit and the form of a rotation."""
    form, unit = sizes.rotation_form(values, block.unit, block.form)
    # the names or the order of the columns of a quaternion and a matrix bind
    bound = block.form is not None and block.form.choice in ("scalar_first", MATRIX[0])
    if agreed.form is not None and agreed.form.choice == form.choice:
        if form.sure != "certain":
            form = agreed.form
    elif agreed.form is not None and not bound:
        form = agreed.form
    if block.unit is None:
        unit = agreed.units.get(block.key, unit)
    return unit, form
