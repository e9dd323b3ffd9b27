"""The sentences on what poses and torques of one recording share, made from the codes and numbers of the JSON."""

from collections.abc import Mapping, Sequence
from typing import Any

from lite6jax.report.quantities import OF_TORQUES, quantity

Entry = Mapping[str, Any]

_LEAST = 1e-16
"""Probability below which a number says no more."""
HEADING = "What poses and torques both depend on"
NOTHING = "No finding concerns a quantity on which both poses and torques depend."
_NAMES = {
    "payload_mass": "the payload's mass",
    "gravity_direction": "the direction of gravity",
    "clock_offset": "the clock's offset",
}
_REMEDIES = {
    "payload_mass": "Check payload_kg and payload_com_m: a payload whose centre of mass is elsewhere shows as another "
    "mass to each.",
    "gravity_direction": "Check gravity_m_per_s2, and whether the base moves under load.",
    "clock_offset": "Poses and torques have clocks of their own: check the stamps of both sensors.",
}


def refusal(document: Mapping[str, Any]) -> str:
    """Why the torques of a recording were not diagnosed."""
    return f"The torques of this recording are not diagnosed: {document['torques_refused']}."


def with_statements(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """The entries as in the JSON file, with a `statement` each."""
    return [{**entry, "statement": statement(entry)} for entry in entries]


def statement(entry: Entry) -> str:
    """What both say of a quantity, and whether they agree."""
    if entry["quantity"] == "load":
        return _load(entry)
    name = _NAMES[entry["quantity"]]
    poses, torques = (_numbers(entry[side]) for side in ("poses", "torques"))
    if entry["agree"] is None:
        shown, silent = ("torques", "poses") if entry["poses"] is None else ("poses", "torques")
        return f"Of {name}, only the {shown} say something: {poses or torques}; the {silent} do not show it."
    said = f"poses say {poses}, torques say {torques}"
    if entry["agree"]:
        return f"Of {name}, {said}: they agree, and it is one finding that both sensors see."
    return f"Of {name}, {said}: they disagree ({_by_chance(entry)}). {_REMEDIES[entry['quantity']]}"


def _load(entry: Entry) -> str:
    joint, ratio = entry["joint"], entry["torques"]["parameters"]["load_ratio"]
    compliance = entry["poses"]["parameters"]["compliance_rad_per_Nm"]
    said = (
        f"The compliance of joint {joint} rests on the loads of the declared arm; by the torques, joint {joint} "
        f"carries {ratio['value']:.3f} ± {ratio['std']:.2g} times these"
    )
    if entry["agree"]:
        return f"{said}, which is within the uncertainty of the masses."
    corrected = {key: value / ratio["value"] for key, value in compliance.items()}
    return (
        f"{said}. They disagree ({_by_chance(entry)}): by the loads that the torques show, it is "
        f"{quantity('compliance_rad_per_Nm', corrected)}. Correct payload_kg, or the masses of the arm's description."
    )


def _by_chance(entry: Entry) -> str:
    p = entry["p_value"]
    return f"p = {p:.2g}" if p > _LEAST else f"p < {_LEAST:g}"


def _numbers(known: Entry | None) -> str:
    if known is None:
        return ""
    return ", ".join(str(quantity(name, estimate, OF_TORQUES)) for name, estimate in known["parameters"].items())
