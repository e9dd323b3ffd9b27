"""Lists of what there is, effects and arms, and what a conversion kept; nothing here takes JAX."""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.console import RenderableType
from rich.text import Text

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import VARIANTS, maker_of
from lite6jax.arms.files import Conversion
from lite6jax.report.screen import indented
from lite6jax.report.words import counted, listing

if TYPE_CHECKING:
    from lite6jax.effects.catalogue import Listed  # which takes a second, and which arms do not need

_DOMAINS = {
    "kinematic": "Effects on poses: what moves the tool (diagnose, simulate, identify)",
    "dynamic": "Effects on torques: what motors exert besides (diagnose, identify --torque)",
}


def effects_report(effects: "Sequence[Listed]") -> Iterator[RenderableType]:
    """The effects by domain, a paragraph each."""
    for domain, title in _DOMAINS.items():
        chosen = [effect for effect in effects if effect.domain == domain]
        if not chosen:
            continue
        yield Text(title)
        yield ""
        for effect in chosen:
            yield Text(effect.name)
            yield indented(effect.description)
            yield indented(f"Site: {', '.join(effect.sites)}. Driver: {', '.join(effect.drivers) or 'none'}.")
            if effect.parameters:
                yield indented(f"Numbers: {', '.join(effect.parameters)} ({', '.join(effect.units) or 'as fitted'}).")
        yield ""
    yield Text("jointN and linkN stand for every joint and link of an arm; a unit of 1 is a ratio.")
    if any(effect.domain == "dynamic" for effect in effects):
        yield Text("At a prismatic joint, effects on torques act on its force: read N for Nm, m for rad, kg for kg·m².")


class ArmEntry(NamedTuple):
    """A bundled arm as it is listed: reach in m, an upper bound; where its numbers are from."""

    name: str
    maker: str
    joints: int
    reach_m: float
    inertia: bool
    source: str


def arm_entry(arm: Arm) -> ArmEntry:
    """What is listed of an arm."""
    return ArmEntry(arm.name, maker_of(arm.name), arm.dof, round(arm.reach, 4), arm.inertia is not None, arm.source)


def joint_entries(arm: Arm) -> list[dict[str, Any]]:
    """What is listed of each joint of an arm: name, kind, and limits in rad or m."""
    names = arm.joint_names or tuple(f"joint{i + 1}" for i in range(arm.dof))
    kinds = ["prismatic" if slides else "revolute" for slides in arm.slides]
    rows = zip(names, kinds, arm.joint_limits.tolist(), arm.joint_units, strict=True)
    return [{"name": name, "kind": kind, "limits": limits, "unit": unit} for name, kind, limits, unit in rows]


def arm_report(arm: Arm) -> Iterator[RenderableType]:
    """One arm as it is read: where its chain begins and ends, and its joints in order."""
    inertia = "with inertia" if arm.inertia is not None else "without inertia"
    yield Text(f"{arm.name}: {counted(arm.dof, 'joint')}, reach up to {1e3 * arm.reach:.0f} mm, {inertia}.")
    if arm.source:
        yield Text(f"From: {arm.source}.")
    yield ""
    table = listing("", "joint", "kind", "lower", "upper", "unit", left=[1, 2, 5])
    for i, joint in enumerate(joint_entries(arm)):
        scale, unit = (1e3, "mm") if joint["unit"] == "m" else (math.degrees(1.0), "deg")
        lower, upper = (f"{scale * limit:.1f}" for limit in joint["limits"])
        table.add_row(f"q{i + 1}", Text(joint["name"]), joint["kind"], lower, upper, unit)
    yield table


def arms_report(arms: Sequence[ArmEntry], width: int) -> Iterator[RenderableType]:
    """The bundled arms, and below the table where their numbers are from."""
    if width < 60:
        for arm in arms:
            inertia = "with inertia" if arm.inertia else "without inertia"
            yield Text(arm.name)
            yield indented(f"{arm.maker}, {arm.joints} joints, {1e3 * arm.reach_m:.0f} mm, {inertia}.")
            yield indented(arm.source)
        return
    rows = (
        (arm.name, arm.maker, str(arm.joints), f"{1e3 * arm.reach_m:.0f}", "yes" if arm.inertia else "no")
        for arm in arms
    )
    yield listing("arm", "maker", "joints", "reach (mm)", "inertia", rows=rows, left=[1, 4])
    yield ""
    yield Text("reach: the sum of the links' lengths, which no flange exceeds.")
    variants = [arm.name for arm in arms if arm.name in VARIANTS]
    if variants:
        yield Text(f"{', '.join(variants)}: the same model by another file of the vendor.")
    yield ""
    yield Text("Sources")
    yield from (indented(f"{arm.name}: {arm.source}") for arm in arms)


def conversion_report(done: Conversion) -> Iterator[RenderableType]:
    """The largest change of the flange position by a conversion, and the parts that it omits."""
    kept = f"{1e3 * done.difference:.1e}" if done.difference else "0"
    yield Text(f"Form {done.form}, arm {done.arm.name}; read back, the flange differs by at most {kept} mm.")
    if done.left_out:
        yield Text(f"Left out: {'; '.join(done.left_out)}.")
