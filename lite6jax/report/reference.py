"""Sentences of comparisons: with a reference recording, of poses or torques, and of the poses with the torques.

Each is made from the codes and numbers of the JSON document.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from lite6jax.errors import command_line
from lite6jax.report.remedies import effect_title
from lite6jax.report.words import OF_TORQUES, capital, each_with_unit, joined, milli, number, quantity

Document = Mapping[str, Any]
Entry = Mapping[str, Any]

_CHAINS = {
    "factory_calibration": "the factory calibration",
    "reference_factory_calibration": "its own factory calibration",
    "published_table": "the published table",
    "ros_default_table": "the vendor's ROS default table",
    "nominal_table": "the nominal table",
}


def with_statements(comparison: Document) -> dict[str, Any]:
    """The comparison as in the JSON file, with a `statement` for each difference, each note and the whole."""
    stated, file = {**comparison}, comparison["file"]
    if "by" in comparison:
        if "differences" in comparison:
            entries = comparison["differences"]
            stated["differences"] = [{**entry, "statement": _torque_difference(entry)} for entry in entries]
        return {**stated, "statement": torque_model_statement(file, comparison["by"])}
    stated["differences"] = list(_differences(comparison["differences"], file))
    stated["notes"] = [{**entry, "statement": _note(entry, file)} for entry in comparison["notes"]]
    return {**stated, "statement": model_statement(file, comparison["rigid"])}


def headline(comparison: Document, units: Sequence[str] = ()) -> str:
    """What was compared, and how far apart it is; of poses, whether the model reproduces the reference.

    Args:
        comparison: as in the JSON file.
        units: of each joint, where it is of torques.
    """
    file = comparison["file"]
    if comparison.get("by") == "effects":
        return f"Reference {file}: another motion, so that each recording was diagnosed on its own."
    count, rows = comparison["matched_rows"], comparison["rows"]
    of = f"{count} rows" if count == rows else f"{count} of {rows} rows"
    if "by" in comparison:
        apart, own = (each_with_unit(comparison[f"{key}_rms_by_joint_Nm"], units) for key in ("apart", "reference"))
        return (
            f"Reference {file}, {of} of the same motion. Its torques differ from this recording by {apart} RMS (each "
            f"joint in turn), and from the declared rigid arm by {own}."
        )
    verb = "reproduces" if comparison["reproduced"] else "does not reproduce"
    rms, most, remaining = (
        number(1e3 * comparison[key]) for key in ("position_rms_m", "position_max_m", "left_position_rms_m")
    )
    after = f" With the differences below, {remaining} mm RMS remain." if comparison["differences"] else ""
    return (
        f"Reference {file}, {of}: the model {verb} it, with position errors of {rms} mm RMS and {most} mm at most."
        f"{after}"
    )


def model_statement(file: str, rigid: bool) -> str:
    """What a model that was estimated relative to a reference contains."""
    if rigid:
        return f"{file} has no effects beyond a rigid arm, so this is the complete model of the arm."
    return (
        f"The model is the rigid arm with the difference from {file}: effects that both recordings have are not in "
        f"it, and effects of {file} alone are in it with reversed sign."
    )


def torque_model_statement(file: str, by: str) -> str:
    """The same of a model of torques, and of the findings; `by` is what was compared."""
    if by == "effects":
        return f"Findings and model are those of this recording alone; what differs from {file} is said above."
    return (
        f"Findings and model are the difference from {file}: effects that both recordings have are not in them, and "
        f"effects of {file} alone are in them with reversed sign."
    )


def _differences(entries: Sequence[Entry], file: str) -> Iterator[dict[str, Any]]:
    """The entries with a sentence each; the last of those found together says by how much they reduce the error."""
    for (before, after), group in groupby(
        entries, key=lambda entry: (entry.get("position_rms_before_m"), entry["position_rms_after_m"])
    ):
        together = list(group)
        for entry in together:
            said = _difference(entry, file)
            if before is not None and entry is together[-1]:
                subject = "Together they reduce" if len(together) > 1 else "This reduces"
                said += f" {subject} the position error from {milli(before)} mm to {milli(after)} mm RMS."
            yield {**entry, "statement": said}


def _difference(entry: Entry, file: str) -> str:
    match entry["difference"]:
        case "other_table":
            used, own = (f"{_CHAINS[entry[of]['kind']]} ({entry[of]['name']})" for of in ("reference", "model"))
            return f"{file} uses {used}; this model uses {own}."
        case "other_frame" | "other_tool":
            what = "tool" if entry["difference"] == "other_tool" else "base frame"
            length, angle = ", ".join(map(milli, entry["translation_m"])), entry["rotation_rad"]
            turned = "" if angle is None else f" and rotated by {milli(angle)} mrad"
            return f"Its {what} is displaced from the declared one by ({length}) mm{turned}."
        case "other_geometry":
            links = [
                f"{'link ' + str(link['link']) if link['link'] else 'the base'} by {milli(link['distance_m'])} mm and "
                f"{milli(link['rotation_rad'])} mrad"
                for link in entry["links"]
            ]
            return f"Its geometry differs; the smallest displacements that explain it are {', '.join(links)}."
        case "unknown_geometry":
            return (
                "No nominal table explains it. The geometry of this arm is not known: the one fitted to "
                f"{file}, with {milli(entry['position_rms_after_m'])} mm RMS, is used for both recordings."
            )
        case "not_rigid":
            noise = "; if this is noise, declare position_noise_m in its sidecar"
            return (
                f"No rigid arm explains it completely: {milli(entry['position_rms_after_m'])} mm RMS remain, whose "
                f"causes `{command_line('diagnose', file)}` would find{'' if entry['noise_declared'] else noise}."
            )
    raise ValueError(entry["difference"])


def _note(entry: Entry, file: str) -> str:
    match entry["note"]:
        case "unmatched_rows":
            return f"{entry['count']} of {entry['rows']} rows have no row of {file} at the same joint positions."
        case "positions_only":
            return "Only one of the recordings has orientations: only positions are compared."
        case "outlying_rows":
            return f"{entry['count']} of {entry['rows']} rows of {file} are outliers and excluded from these figures."
        case "equal_drivers":
            drivers = joined(driver.replace("_", " ") for driver in entry["drivers"])
            return (
                f"Equal in both recordings: {drivers}. Effects of nothing else cancel where both recordings have them."
            )
        case "payload_differs":
            return (
                f"The payload differs in {entry['count']} rows: there, compliance that both arms have does not cancel."
            )
        case "direction_of_motion_differs":
            return (
                f"The direction of motion differs in {entry['count']} rows: there, backlash that both arms have does "
                "not cancel."
            )
        case "temperature_differs":
            return (
                f"The mean temperature is {entry['mean_degC']:.1f} °C here and {entry['reference_mean_degC']:.1f} °C "
                "in the reference: expansion is estimated from the difference."
            )
        case "one_temperature":
            return "Only one of the recordings has temperatures: expansion that both arms have does not cancel."
    raise ValueError(entry["note"])


def _torque_difference(entry: Entry) -> str:
    """An effect that one of two recordings shows, as each shows it."""
    title = capital(effect_title({"effect": entry["effect"], "site": entry["site"]}))
    if "driver" in entry:
        title = f"Unnamed effect at {entry['site']} over {entry['driver']}"
    here, there = (_numbers(entry[side], chosen=False) for side in ("recording", "reference"))
    if entry["differs"] is None:
        silent = "the reference" if entry["reference"] is None else "this recording"
        return f"{title}: {here or there}; {silent} does not show it."
    if entry["differs"]:
        return f"{title} differs (p = {entry['p_value']:.2g}): {here} here, {there} in the reference."
    return f"{title} does not differ beyond the uncertainty: {here} here, {there} in the reference."


def _numbers(known: Entry | None, chosen: bool = True) -> str:
    """The parameters that one side shows; those without a standard deviation were chosen and not estimated."""
    parameters = {} if known is None else known["parameters"]
    return ", ".join(
        str(quantity(name, estimate, OF_TORQUES)) for name, estimate in parameters.items() if chosen or estimate["std"]
    )


# ------------------------------------------------------------------ what poses and torques share


SHARED = "What poses and torques both depend on"
"""The heading of these sentences."""
_LEAST = 1e-16
"""Probability below which a number says no more."""
_QUANTITIES = {
    "payload_mass": (
        "the payload's mass",
        "Check payload_kg and payload_com_m: a payload whose centre of mass is elsewhere shows as another mass to "
        "each.",
    ),
    "gravity_direction": (
        "the direction of gravity",
        "Check gravity_m_per_s2, and whether the base moves under load.",
    ),
    "clock_offset": (
        "the clock's offset",
        "Poses and torques have clocks of their own: check the stamps of both sensors.",
    ),
}
"""The name of each, and what to do where poses and torques disagree about it."""


def refusal(document: Document) -> str:
    """Why the torques of a recording were not diagnosed."""
    return f"The torques of this recording are not diagnosed: {document['torques_refused']}."


def shared_statements(document: Document) -> list[str]:
    """What poses and torques say of each quantity on which both depend, and whether they agree."""
    return [shared_statement(entry) for entry in document["shared"]] or [
        "No finding concerns a quantity on which both poses and torques depend."
    ]


def shared_statement(entry: Entry) -> str:
    """What both say of one quantity."""
    name, remedy = _QUANTITIES[entry["quantity"]]
    poses, torques = (_numbers(entry[side]) for side in ("poses", "torques"))
    if entry["agree"] is None:
        shown, silent = ("torques", "poses") if entry["poses"] is None else ("poses", "torques")
        return f"Of {name}, only the {shown} say something: {poses or torques}; the {silent} do not show it."
    said = f"poses say {poses}, torques say {torques}"
    if entry["agree"]:
        return f"Of {name}, {said}: they agree, and it is one finding that both sensors see."
    return f"Of {name}, {said}: they disagree ({_chance(entry)}). {remedy}"


def _chance(entry: Entry) -> str:
    p = entry["p_value"]
    return f"p = {p:.2g}" if p > _LEAST else f"p < {_LEAST:g}"
