"""What a person reads of a comparison with a reference recording: sentences made from its codes and numbers."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from lite6jax.domains.pose.predict import ReferenceOrigin
from lite6jax.errors import command_line
from lite6jax.report.cells import number

_CHAINS = {
    "factory_calibration": "the factory calibration",
    "reference_factory_calibration": "its own factory calibration",
    "published_table": "the published table",
    "ros_default_table": "the vendor's ROS default table",
    "nominal_table": "the nominal table",
}
_DRIVERS = {"payload": "payload", "direction_of_motion": "direction of motion", "temperature": "temperature"}


def headline(comparison: Mapping[str, Any]) -> str:
    """Whether the model reproduces the reference, and with what error; `comparison` as in the JSON file."""
    count, rows = comparison["matched_rows"], comparison["rows"]
    of = f"{count} rows" if count == rows else f"{count} of {rows} rows"
    verb = "reproduces" if comparison["reproduced"] else "does not reproduce"
    rms, most, remaining = (
        number(1e3 * comparison[key]) for key in ("position_rms_m", "position_max_m", "left_position_rms_m")
    )
    after = f" With the differences below, {remaining} mm RMS remain." if comparison["differences"] else ""
    return (
        f"Reference {comparison['file']}, {of}: the model {verb} it, with position errors of {rms} mm RMS and {most} "
        f"mm at most.{after}"
    )


class Compared(NamedTuple):
    """What a person reads of a comparison with a reference.

    Attributes:
        headline: what was compared, and how far apart it is.
        differences: a sentence each.
        notes: a sentence each.
        statement: what the findings and the model are.
    """

    headline: str
    differences: list[str]
    notes: list[str]
    statement: str


def compared(document: Mapping[str, Any], headline: Callable[[Mapping[str, Any]], str] = headline) -> Compared | None:
    """The comparison in a document of poses or of torques; None where nothing was compared.

    Args:
        document: with statements.
        headline: makes that of a comparison.
    """
    if "against" not in document:
        return None
    comparison = document["against"]
    differences, notes = ([entry["statement"] for entry in comparison.get(key, ())] for key in ("differences", "notes"))
    return Compared(headline(comparison), differences, notes, comparison["statement"])


def model_statement(file: str, rigid: bool) -> str:
    """What a model that was estimated relative to a reference contains."""
    if rigid:
        return f"{file} has no effects beyond a rigid arm, so this is the complete model of the arm."
    return (
        f"The model is the rigid arm with the difference from {file}: effects that both recordings have are not in "
        f"it, and effects of {file} alone are in it with reversed sign."
    )


def origin_statement(origin: ReferenceOrigin) -> str:
    """The same of a model that was read from a file; a file of version 1 has the sentence itself."""
    return origin.statement if origin.rigid is None else model_statement(origin.file, origin.rigid)


def with_statements(comparison: Mapping[str, Any]) -> dict[str, Any]:
    """The comparison as in the JSON file, with a `statement` added to each difference, each note and the whole."""
    differences, notes = comparison["differences"], comparison["notes"]
    said = zip(differences, difference_sentences(comparison), strict=True)
    noted = zip(notes, note_sentences(comparison), strict=True)
    return {
        **comparison,
        "differences": [{**entry, "statement": sentence} for entry, sentence in said],
        "notes": [{**entry, "statement": sentence} for entry, sentence in noted],
        "statement": model_statement(comparison["file"], comparison["rigid"]),
    }


def difference_sentences(comparison: Mapping[str, Any]) -> list[str]:
    """A sentence per difference; the last of those that were found together says by how much they reduce the error."""
    entries: Sequence[Mapping[str, Any]] = comparison["differences"]
    sentences = [_difference(entry, comparison["file"]) for entry in entries]
    steps = [(entry.get("position_rms_before_m"), entry["position_rms_after_m"]) for entry in entries]
    for k, (step, following) in enumerate(pairwise([*steps, None])):
        assert step is not None
        before, after = step
        if before is not None and step != following:
            subject = "Together they reduce" if k and steps[k - 1] == step else "This reduces"
            sentences[k] += f" {subject} the position error from {_milli(before)} mm to {_milli(after)} mm RMS."
    return sentences


def note_sentences(comparison: Mapping[str, Any]) -> list[str]:
    """A sentence per note."""
    return [_note(entry, comparison["file"]) for entry in comparison["notes"]]


def _difference(entry: Mapping[str, Any], file: str) -> str:
    match entry["difference"]:
        case "other_table":
            return f"{file} uses {_chain(entry['reference'])}; this model uses {_chain(entry['model'])}."
        case "other_frame":
            return f"Its base frame is displaced from the declared one by {_displacement(entry)}."
        case "other_tool":
            return f"Its tool is displaced from the declared one by {_displacement(entry)}."
        case "other_geometry":
            links = [
                f"{'link ' + str(link['link']) if link['link'] else 'the base'} by {_milli(link['distance_m'])} mm and "
                f"{_milli(link['rotation_rad'])} mrad"
                for link in entry["links"]
            ]
            return f"Its geometry differs; the smallest displacements that explain it are {', '.join(links)}."
        case "unknown_geometry":
            return (
                "No nominal table explains it. The geometry of this arm is not known: the one fitted to "
                f"{file}, with {_milli(entry['position_rms_after_m'])} mm RMS, is used for both recordings."
            )
        case "not_rigid":
            noise = "; if this is noise, declare position_noise_m in its sidecar"
            return (
                f"No rigid arm explains it completely: {_milli(entry['position_rms_after_m'])} mm RMS remain, whose "
                f"causes `{command_line('diagnose', file)}` would find{'' if entry['noise_declared'] else noise}."
            )
    raise ValueError(entry["difference"])


def _note(entry: Mapping[str, Any], file: str) -> str:
    match entry["note"]:
        case "unmatched_rows":
            return f"{entry['count']} of {entry['rows']} rows have no row of {file} at the same joint positions."
        case "positions_only":
            return "Only one of the recordings has orientations: only positions are compared."
        case "outlying_rows":
            return f"{entry['count']} of {entry['rows']} rows of {file} are outliers and excluded from these figures."
        case "equal_drivers":
            *first, last = [_DRIVERS[driver] for driver in entry["drivers"]]
            drivers = f"{', '.join(first)} and {last}" if first else last
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


def _chain(entry: Mapping[str, str]) -> str:
    return f"{_CHAINS[entry['kind']]} ({entry['name']})"


def _displacement(entry: Mapping[str, Any]) -> str:
    length = f"({', '.join(_milli(value) for value in entry['translation_m'])}) mm"
    angle = entry["rotation_rad"]
    return length if angle is None else f"{length} and rotated by {_milli(angle)} mrad"


def _milli(value: float) -> str:
    """In thousandths, three digits; rounding errors show as zero."""
    return f"{1e3 * value:.3g}" if abs(value) > 1e-9 else "0"
