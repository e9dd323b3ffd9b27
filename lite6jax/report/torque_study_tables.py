"""Terminal reports on torques: what a motion determines of an arm's dynamics, and what a designed motion is worth."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from rich.text import Text

from lite6jax.arms.arm import Arm
from lite6jax.arms.joint_units import joint_sizes, joint_unit
from lite6jax.design.determination import NARROW
from lite6jax.design.motions import MotionRoom
from lite6jax.design.torques import (
    JOINT,
    JOINT_UNITS,
    WELL,
    Structure,
    TorqueDiscrimination,
    TorqueIdentification,
    TorqueModel,
    TorquePlan,
)
from lite6jax.report.cells import each_with_unit, joint_units, listing, plus_minus, ranges, torque_units

_MOST_GAINS = 8
_CLEAR = 5.0
"""Standard deviations between two models at which a test at a level of 1 % has a power of 99 % or more."""


def torque_noise(model: TorqueModel) -> str:
    """The noise of an arm's torques in a phrase."""
    noise, units = model.noise.tolist(), torque_units(model.arm.sliding, model.arm.dof)
    alike = len(set(zip(noise, units, strict=True))) == 1
    each = each_with_unit(*((noise[:1], units[:1]) if alike else (noise, units)))
    return f"torques to ±{each} (one standard deviation, white)"


def combination(terms: Sequence[tuple[str, float]]) -> str:
    """A base parameter as a sum, links with the same factor of the same quantity together: 0.2 link3–6 m."""
    groups: dict[tuple[str, str], list[str]] = {}
    for name, factor in terms:
        carrier, kind = name.split(" ", 1)
        groups.setdefault((f"{factor:.3g}", kind), []).append(carrier)
    text = ""
    for (factor, kind), carriers in groups.items():
        size = factor.removeprefix("-")
        word = carriers[0].rstrip("0123456789")
        numbers = ",".join(shown for shown, _ in ranges(int(carrier.removeprefix(word)) for carrier in carriers))
        sign = " − " if factor.startswith("-") else " + "
        text += f"{sign}{'' if size == '1' else f'{size} '}{word}{numbers} {kind}"
    return text.removeprefix(" + ")


def torque_identification_report(found: TorqueIdentification, source: str, motion: str) -> Iterator[RenderableType]:
    """What a motion determines: the rank, the base parameters in words, friction, what is not determined and why.

    Args:
        found: the study.
        source: the arm or the file.
        motion: which motion, in a phrase.
    """
    model, structure = found.model, found.structure
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(f"{model.arm.name}, {motion}; {torque_noise(model)}.")
    yield ""
    yield Text(_rank(found))
    yield from map(Text, _undetermined(found))
    yield from map(Text, _structure(structure))
    yield ""
    if model.inertial:
        yield Text("Base parameters of the links, standard deviation and unit (factors in m and m²)")
        yield ""
        table = listing("combination", "±", "typical", "unit")
        table.columns[0].no_wrap = False
        for item, deviation, there in zip(structure.base, found.standard_deviation, found.determined, strict=True):
            if item.name.startswith("link"):
                shown = plus_minus(float(deviation)) if there else "not"
                table.add_row(combination(item.terms), shown, f"{item.scale:.2g}", item.unit)
        yield table
        yield ""
    kinds = [
        (own, label) for own, label in ((False, ""), (True, "of prismatic joints, P: ")) if own in model.arm.slides
    ]
    units = "; ".join(label + ", ".join(joint_unit(unit, own) for unit in JOINT_UNITS) for own, label in kinds)
    yield Text(f"Friction and rotors, standard deviations ({units})")
    yield ""
    table = listing("joint", *JOINT)
    carried = dict(structure.confounded)
    for joint in range(model.arm.dof):
        cells = []
        for kind in JOINT:
            deviation = found.deviation_of(joint, kind)
            within = carried.get(f"joint{joint + 1} {kind}")
            cells.append(plus_minus(deviation) if deviation is not None else f"in {within[0]}" if within else "not")
        table.add_row(f"J{joint + 1}{' P' * bool(model.arm.slides[joint])}", *cells)
    yield table
    yield Text(
        f"Condition number {found.condition:.4g} (regressor in standard deviations, parameters in typical sizes)."
        if np.isfinite(found.condition)
        else "Nothing is determined."
    )
    weak = [item.name for item, is_weak in zip(structure.base, found.weak, strict=True) if is_weak]
    if weak:
        yield Text(f"Weak: {', '.join(weak)} (over {100 * WELL:.0f} % of the typical size).")
    yield from (Text(f"Note: {note[0].upper()}{note[1:]}{'' if note.endswith('.') else '.'}") for note in found.notes)


def _rank(found: TorqueIdentification) -> str:
    structure, rank = found.structure, int(found.determined.sum())
    whole = "all" if rank == len(structure.base) else f"{rank} of"
    of = f"{structure.inertial} of the links, " if found.model.inertial else ""
    joints = len(structure.base) - structure.inertial
    return f"This motion determines {whole} {len(structure.base)} base parameters ({of}{joints} of the joints)."


def _undetermined(found: TorqueIdentification) -> Iterator[str]:
    missed = [item.name for item, there in zip(found.structure.base, found.determined, strict=True) if not there]
    if not missed:
        return
    yield f"Not determined apart from others: {', '.join(missed)}."
    narrow, arm = found.narrow(), found.model.arm
    scales, units = joint_units(arm.sliding, arm.dof)
    narrowest = joint_sizes(NARROW, "rad", arm.slides)
    if len(narrow) == found.model.arm.dof:
        least = {units[j]: f"{scales[j] * size:.2g} {units[j]}" for j, size in enumerate(narrowest)}
        most = " or ".join(least.values())
        yield f"No joint moves over more than {most}: record a motion of all joints (lite6jax design --torque)."
    elif narrow:
        which = " and ".join(f"joint {j + 1} moves over {scales[j] * span:.2g} {units[j]}" for j, span in narrow)
        yield f"{which[0].upper()}{which[1:]} only; move it further."
    elif found.at_rest:
        yield "The arm stands still in all samples, which show gravity only: record it in motion."
    else:
        yield "Another motion determines them: record a longer one, or that of lite6jax design --torque."


def _structure(structure: Structure) -> Iterator[str]:
    if structure.silent:
        yield f"No torque changes with {', '.join(structure.silent)}."
    rotors = [(name, carriers) for name, carriers in structure.confounded if name.startswith("joint")]
    for name, carriers in rotors:
        yield f"{name} is confounded with {' and '.join(carriers)}: only their sum is determined."
    links = [name for name, _ in structure.confounded if name.startswith("link")]
    if links:
        yield f"Only in combinations: {', '.join(links)}."


def torque_plan_report(found: TorquePlan, disabled: Sequence[tuple[str, str]], source: str) -> Iterator[RenderableType]:
    """What a designed motion determines, beside random ones of the same limits.

    Args:
        found: the design.
        disabled: pairs of links that are not checked against each other.
        source: the arm.
    """
    designed, random = found.identification, found.random
    yield from _motion_report(found.room, designed.model, disabled, source)
    yield Text(_rank(designed))
    middle, best = np.median(found.random_log_determinant), np.max(found.random_log_determinant)
    if np.isfinite(best):
        times = f"{found.gain(float(middle)):.2f} times" if np.isfinite(middle) else "much"
        yield Text(
            f"In the geometric mean its standard deviations are {times} smaller than those of a random motion of the"
            f" same limits (the median of {len(random)}), {found.gain(float(best)):.2f} times smaller than those of the"
            " best of them."
        )
    else:
        yield Text(f"None of {len(random)} random motions of the same limits determines all of them.")
    yield ""
    table = listing("", "designed", "random, median", "random, best")
    for name, own, others, best_of in (
        ("log determinant", designed.log_determinant, found.random_log_determinant, np.max),
        ("condition number", designed.condition, found.random_condition, np.min),
        ("weakly determined", designed.weak.sum(), np.array([other.weak.sum() for other in random]), np.min),
    ):
        table.add_row(name, *(f"{value:.4g}" for value in (own, np.median(others), best_of(others))))
    yield table
    yield ""
    yield from _gains(found)


def _gains(found: TorquePlan) -> Iterator[RenderableType]:
    designed, base = found.identification, found.identification.structure.base
    scale = np.array([item.scale for item in base])
    random = found.random_deviation
    gained = np.flatnonzero((random > WELL * scale) & designed.determined & ~designed.weak)
    if len(gained):
        yield Text(
            "Weakly determined by random motions and well by this one:"
            f" {', '.join(base[i].name for i in gained)} (to a tenth of their typical sizes)."
        )
        yield ""
    table = listing("most gained", "designed ±", "random ±", "ratio", "unit")
    ratio = random / designed.standard_deviation
    for i in np.argsort(-ratio, kind="stable")[:_MOST_GAINS]:
        if np.isfinite(designed.standard_deviation[i]):
            shown = [
                plus_minus(float(value)) if np.isfinite(value) else "–"
                for value in (designed.standard_deviation[i], random[i])
            ]
            table.add_row(base[i].name, *shown, f"{ratio[i]:.2f}" if np.isfinite(ratio[i]) else "–", base[i].unit)
    yield table


def torque_discrimination_report(
    found: TorqueDiscrimination, disabled: Sequence[tuple[str, str]], source: str
) -> Iterator[RenderableType]:
    """How far a designed motion separates two models of the torques, beside random ones of the same limits."""
    yield from _motion_report(found.room, found.model, disabled, source)
    one, other = found.rivals
    random = float(np.median(found.random_distance))
    hypothesis, alternative = ("either effect", "the other") if found.both_ways else (one, other)
    ratio = f" (ratio {found.distance / random:.2f})" if random > 0 else ""
    yield Text(
        f"If {hypothesis} has the size given, the torques of this motion are {found.distance:.1f} standard deviations"
        f" from the closest that {alternative} explains with all other unknowns refitted; {random:.1f} in a random"
        f" motion of the same limits{ratio}, {np.max(found.random_distance):.1f} in the best of"
        f" {len(found.random_distance)}."
    )
    yield Text(f"Unknown beside them: {'the links, ' * found.model.inertial}friction, offset and rotor of each joint.")
    if found.distance < _CLEAR:
        yield Text(f"A reliable decision takes {_CLEAR:g}: record the motion several times, or a longer one.")


def _greatest(arm: Arm, limits: NDArray[np.floating]) -> list[str]:
    """The greatest of the limits `(joint,)` of revolute joints, and that of prismatic ones, in deg and mm."""
    scales, units = joint_units(arm.sliding, arm.dof)
    of = {unit: max(scales[j] * limits[j] for j in range(arm.dof) if units[j] == unit) for unit in units}
    return [f"{of[unit]:.4g} {unit}" for unit in ("deg", "mm") if unit in of]


def _motion_report(
    room: MotionRoom, model: TorqueModel, disabled: Sequence[tuple[str, str]], source: str
) -> Iterator[RenderableType]:
    yield Text(source, no_wrap=True, overflow="ignore")
    limits = [
        " and ".join(f"{size}{per}" for size in _greatest(room.arm, limit))
        for limit, per in ((room.limits.velocity, "/s"), (room.limits.acceleration, "/s²"))
    ]
    yield Text(
        f"A motion of {room.duration:g} s from rest to rest, {room.harmonics} harmonics, {room.samples + 1} samples, up"
        f" to {' and '.join(limits)}; {torque_noise(model)}."
    )
    if disabled:
        pairs = ", ".join(f"{a} with {b}" for a, b in disabled)
        yield Text(f"Not checked for collision, as they overlap nearly always: {pairs}.")
    yield ""
