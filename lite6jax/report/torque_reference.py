"""The sentences on a comparison of torques with a reference recording, made from the codes and numbers of its JSON."""

from collections.abc import Mapping, Sequence
from typing import Any

from lite6jax.report.cells import capital, each_with_unit
from lite6jax.report.quantities import OF_TORQUES, quantity
from lite6jax.report.statements import effect_title

Document = Mapping[str, Any]


def with_statements(comparison: Document) -> dict[str, Any]:
    """The comparison as in the JSON file, with a `statement` for each difference and for the whole."""
    stated = {**comparison, "statement": model_statement(comparison["file"], comparison["by"])}
    if "differences" in comparison:
        stated["differences"] = [{**entry, "statement": difference(entry)} for entry in comparison["differences"]]
    return stated


def headline(comparison: Document, units: Sequence[str]) -> str:
    """What was compared, and how far apart it is, in the units of each joint."""
    file = comparison["file"]
    if comparison["by"] == "effects":
        return f"Reference {file}: another motion, so that each recording was diagnosed on its own."
    count, rows = comparison["matched_rows"], comparison["rows"]
    of = f"{count} rows" if count == rows else f"{count} of {rows} rows"
    apart, own = (each_with_unit(comparison[f"{key}_rms_by_joint_Nm"], units) for key in ("apart", "reference"))
    return (
        f"Reference {file}, {of} of the same motion. Its torques differ from this recording by {apart} RMS (each joint "
        f"in turn), and from the declared rigid arm by {own}."
    )


def model_statement(file: str, by: str) -> str:
    """What the findings and the model are."""
    if by == "effects":
        return f"Findings and model are those of this recording alone; what differs from {file} is said above."
    return (
        f"Findings and model are the difference from {file}: effects that both recordings have are not in them, and "
        f"effects of {file} alone are in them with reversed sign."
    )


def difference(entry: Document) -> str:
    """An effect that one of two recordings shows, as each shows it."""
    title = capital(effect_title({"effect": entry["effect"], "site": entry["site"]}))
    if "driver" in entry:
        title = f"Unnamed effect at {entry['site']} over {entry['driver']}"
    here, there = (_numbers(entry[side]) for side in ("recording", "reference"))
    if entry["differs"] is None:
        silent = "the reference" if entry["reference"] is None else "this recording"
        return f"{title}: {here or there}; {silent} does not show it."
    if entry["differs"]:
        return f"{title} differs (p = {entry['p_value']:.2g}): {here} here, {there} in the reference."
    return f"{title} does not differ beyond the uncertainty: {here} here, {there} in the reference."


def _numbers(known: Document | None) -> str:
    if known is None:
        return ""
    return ", ".join(str(quantity(name, each, OF_TORQUES)) for name, each in known["parameters"].items() if each["std"])
