"""What a terminal says of lists and of fleets, where a condition changes the words; the other texts are in
`templates/screens.yaml`."""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from lite6jax.arms.arm import Arm
from lite6jax.arms.files import Conversion
from lite6jax.formatting import chance, counted, joined, number, plural, quantity
from lite6jax.report.remedies import effect_title

if TYPE_CHECKING:
    from lite6jax.effects.catalogue import Listed  # which takes a second, and which arms do not need

Document = Mapping[str, Any]

_SIMULATORS = {"mujoco": "MuJoCo", "isaac_lab": "Isaac Lab", "urdf": "URDF"}
"""How simulators are called, by the fields of `SimulatorParameters`."""
_DIFFERENT = 0.01
"""p-value below which the arms of a fleet differ from each other."""


def listed_effect(effect: "Listed") -> list[str]:
    """Says what an effect is, where it acts, which numbers it has, what it is in simulators, and what looks like it."""
    drivers = ", ".join(effect.drivers) or "none"
    lines = [effect.description, f"Site: {', '.join(effect.sites)}. Driver: {drivers}."]
    if effect.parameters:
        numbers = zip(effect.parameters, effect.possible, strict=True)
        lines.append(f"Numbers: {'; '.join(_number_with_ends(name, *ends) for name, ends in numbers)}.")
    if effect.simulated:
        parameters = simulator_parameters(effect.in_simulators) or "No parameter of MuJoCo, Isaac Lab or URDF"
        lines.append(f"{parameters}.")
    lines += [
        f"Looks like {joined(group['effects'], 'or')} {group['alike']}. Told apart by {group['told_apart']}."
        for group in effect.resembles
    ]
    return lines


def _number_with_ends(name: str, least: float | None, largest: float | None) -> str:
    if least is None and largest is None:
        return name
    return f"{name}, {between(least, largest)}"


def between(least: float | None, largest: float | None) -> str:
    """Says between which values a number is; an end that is None is open."""
    if least is None:
        return f"at most {largest:g}"
    if largest is None:
        return f"at least {least:g}"
    return f"{least:g} to {largest:g}"


def simulator_parameters(in_simulators: Mapping[str, str]) -> str:
    """Says which parameter holds an effect in each simulator that has one, by the fields of `SimulatorParameters`."""
    return "; ".join(f"{_SIMULATORS[key]}: {parameter}" for key, parameter in in_simulators.items() if parameter)


def units_of_effects(domains: Collection[str]) -> list[str]:
    """Says how sites and units of listed effects of some domains are read."""
    lines = ["jointN and linkN stand for every joint and link of an arm; a number without a unit is a ratio."]
    if "dynamic" in domains:
        lines.append(
            "At a prismatic joint, effects on torques act on its force: read N for Nm, m for rad, kg for kg·m²."
        )
    if "tracking" in domains:
        lines.append("Effects on how joints follow their commands are of revolute joints.")
    return lines


def _inertia(given: bool) -> str:
    if given:
        return "with inertia"
    return "without inertia"


def arm_read(arm: Arm) -> list[str]:
    """Says which arm was read, how far it reaches, and where it is from."""
    lines = [
        f"{arm.name}: {counted(arm.dof, 'joint')}, reach up to {1e3 * arm.reach:.0f} mm, "
        f"{_inertia(arm.inertia is not None)}."
    ]
    if arm.source:
        lines.append(f"From: {arm.source}.")
    return lines


def bundled_arm(maker: str, joints: int, reach: float, inertia: bool) -> str:
    """Says who makes an arm, and how many joints and which reach, m, it has."""
    return f"{maker}, {joints} joints, {1e3 * reach:.0f} mm, {_inertia(inertia)}."


def table_of_arms(variants: Sequence[str]) -> list[str]:
    """Says how the table of bundled arms is read."""
    lines = ["reach: the sum of the links' lengths, which no flange exceeds."]
    if variants:
        lines.append(f"{', '.join(variants)}: the same model by another file of the vendor.")
    return lines


def converted(conversion: Conversion) -> list[str]:
    """Says which form was written, how far the flange moved by it, and what it cannot represent."""
    start = f"Form {conversion.form}, arm {conversion.arm.name}"
    if conversion.form in ("numpy", "isaac"):
        lines = [f"{start}."]
    else:
        difference = "0"
        if conversion.difference:
            difference = f"{1e3 * conversion.difference:.1e}"
        lines = [f"{start}; read back, the flange differs by at most {difference} mm."]
    if conversion.left_out:
        lines.append(f"Left out: {'; '.join(conversion.left_out)}.")
    return lines


# ------------------------------------------------------------------ fleets


def fleet_found(document: Document, pooled: int, outlying: Sequence[str]) -> list[str]:
    """Says how many recordings were pooled, what was found in them, and which arms differ."""
    lines = [f"{pooled} recordings of {document['arm']} arms were pooled."]
    if not document["effects"]:
        lines.append(
            "No effect is significant over all recordings, and none in one that the others could be compared with."
        )
        return lines
    sentence = f"{counted(len(document['effects']), 'effect')} found."
    if outlying:
        sentence += f" {', '.join(outlying)} {plural(len(outlying), 'differs', 'differ')} from the others."
    lines.append(sentence)
    return lines


def _size(name: str, value: float) -> str:
    readable = quantity(name, {"value": value, "std": 0.0})
    return f"{number(float(readable.value))} {readable.unit}"


def effect_of_fleet(effect: Document) -> list[str]:
    """Says what a pooled effect may be, how large it is over the arms, and whether these differ."""
    lines = []
    unnamed = effect["effect"] == "unnamed"
    nearest = effect.get("nearest")
    if unnamed and nearest:
        title = effect_title({**nearest, "parameters": {}})
        lines.append(
            f"No effect of the catalogue describes it; the nearest, {title}, explains {100 * nearest['share']:.0f} % "
            "of it."
        )
    elif unnamed:
        lines.append("No effect of the catalogue describes it.")
    if unnamed and "curve" in effect:
        curve = effect["curve"]
        lines.append(f"The range of its mean: {_size(curve['name'], max(curve['mean']) - min(curve['mean']))}.")
    for name in ("amplitude_rms_rad", "amplitude_rms_Nm"):
        if name in effect:
            lines.append(f"Root mean square of its amplitude over the arms: {_size(name, effect[name])}.")
    if effect["between_p_value"] < _DIFFERENT:
        lines.append(
            f"The arms differ from each other by more than their uncertainty ({chance(effect['between_p_value'])})."
        )
    return lines


def differing_arm(effect: Document, arm: Document) -> str:
    """Says that an arm differs from the others, and by which numbers of a named effect."""
    sentence = f"{arm['file']} differs from the others ({chance(arm['outlier_p_value'])})"
    if effect["effect"] == "unnamed":
        return f"{sentence}."
    numbers = ", ".join(str(quantity(name, estimate)) for name, estimate in arm["parameters"].items())
    return f"{sentence}: {numbers}."
