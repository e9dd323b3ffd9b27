"""The sentences about faults of the data and about causes of an error, each from a code and its numbers alone."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from lite6jax.arms.description import VARIANTS, bundled_arms
from lite6jax.recordings.fault import DataFault
from lite6jax.report import pose_faults, torque_faults
from lite6jax.report.pose_faults import MISMATCHES, mismatch_ruled_out
from lite6jax.report.screen import indented
from lite6jax.report.words import SCREEN, capital, joints_named, milli, rows_named

if TYPE_CHECKING:
    from lite6jax.domains.pose.check import Cause, RecordingCheck  # which fits, and what words faults does not

_FAULTS = pose_faults.FAULTS | torque_faults.FAULTS


def fault_name(code: str) -> str:
    """A fault in two or three words."""
    return _FAULTS[code].name if code in _FAULTS else code.replace("_", " ").capitalize()


def fault_statement(fault: DataFault) -> str:
    """What is wrong, by how much, how it was corrected, and the remedy."""
    known = _FAULTS.get(fault.code)
    if known is None:
        return f"{fault_name(fault.code)}."
    return _filled(known.found, fault) if isinstance(known.found, str) else known.found(fault.rows, fault.numbers)


def ruled_out_statement(fault: DataFault) -> str:
    """Why a fault that was tested for is not there, with the number that rules it out."""
    known = _FAULTS.get(fault.code)
    if known is None or known.ruled_out is None:
        return f"{fault_name(fault.code)}: none was found."
    return _filled(known.ruled_out, fault) if isinstance(known.ruled_out, str) else known.ruled_out(fault.numbers)


def _filled(text: str, fault: DataFault) -> str:
    named = joints_named(fault.numbers.get("joints", ()))
    return text.format(**{**fault.numbers, "joints": named, "Joints": capital(named)})


def ruled_out_statements(faults: Iterable[DataFault]) -> list[str]:
    """The same for several; faults that the same numbers rule out share a sentence."""
    groups: dict[tuple[object, ...], list[DataFault]] = {}
    for fault in faults:
        column = fault.code in MISMATCHES
        groups.setdefault(tuple(fault.numbers.values()) if column else (fault.code,), []).append(fault)
    lines = []
    for group in groups.values():
        if group[0].code in MISMATCHES:
            lines.append(mismatch_ruled_out([fault.code for fault in group], group[0].numbers))
        else:
            lines += map(ruled_out_statement, group)
    return lines


def with_statements(document: Mapping[str, Any]) -> dict[str, Any]:
    """A diagnosis as in its JSON file, with a `statement` added to each data fault, found or ruled out."""
    sentences = (("data_faults", fault_statement), ("ruled_out", ruled_out_statement))
    return dict(document) | {
        key: [
            {**entry, "statement": sentence(DataFault(entry["fault"], tuple(entry["rows"]), entry["numbers"]))}
            for entry in document[key]
        ]
        for key, sentence in sentences
    }


# ------------------------------------------------------------------ possible causes of an error


_CAUSES = {
    "default_table": "Nominal table",
    "nominal_table": "Nominal table",
    "tool_offset": "Tool offset",
    "joint_limits": "Joint limits",
    "geometry": "Geometry",
    "one_point": "Positions",
    "outliers": "Outliers",
}


def check_report(path: str | Path, found: "Sequence[Cause] | RecordingCheck") -> Iterator[RenderableType]:
    """A line for each possible cause, with a mark before those to be removed first."""
    yield Text(str(path), no_wrap=True, overflow="ignore")
    if isinstance(found, Sequence):
        causes = found
    else:
        causes = found.causes
        yield from (_line(True, "Note", note) for note in found.notes)
        yield from fault_lines(found.faults)
        yield from (_line(False, "Data", sentence) for sentence in ruled_out_statements(found.ruled_out))
    yield from (_line(cause.suspicious, _CAUSES[cause.code], _cause_statement(cause)) for cause in causes)


def fault_lines(faults: Iterable[DataFault]) -> Iterator[RenderableType]:
    """A line for each fault of the data."""
    for fault in faults:
        rows = f" {capital(rows_named(fault.rows))}." if fault.rows else ""
        yield _line(True, fault_name(fault.code), fault_statement(fault) + rows)


def _line(suspicious: bool, name: str, sentence: str) -> RenderableType:
    return indented(f"{'!' if suspicious else '·'} {name}: {sentence}")


def _cause_statement(cause: "Cause") -> str:
    """What the data say of a possible cause, and the remedy where there is one."""
    n = cause.numbers
    if cause.code in ("default_table", "nominal_table"):
        distances = "; ".join(
            f"{_named(t['table'])} {milli(t['rms_m'])} mm RMS, {milli(t['largest_m'])} mm at most" for t in n["tables"]
        )
        if cause.code == "default_table":
            return f"This is {_named(n['nearest'])}, not the calibration of one arm ({distances})."
        other = "" if n["nearest"] == n["tables"][0]["table"] else f", but {_named(n['nearest'])} is nearer"
        return f"This is a calibration of a {n['arm']}{other}: {distances}."
    if cause.code == "tool_offset":
        shift = ", ".join(map(milli, n["shift_m"]))
        share = f"a shift of ({shift}) mm in the flange frame explains {_percent(n['explained'])} of the squared error"
        if n["likely"]:
            return f"A tool offset is likely: {share}. Set the tool offset (TCP) to zero, or declare it."
        if cause.suspicious:
            return f"A tool offset is possible: {share}. Check that the tool offset (TCP) is zero."
        declared = float(np.linalg.norm(n.get("declared_m", 0.0)))
        beyond = f"No tool offset beyond the declared {milli(declared)} mm" if declared else "No tool offset"
        return f"{beyond}: {share}."
    if cause.code == "joint_limits":
        unit = "m" if "largest_excess_m" in n else "rad"
        scale, shown = SCREEN[unit]
        beyond = scale * n[f"largest_excess_{unit}"]
        return f"Joint {n['joint']} is beyond its limits by up to {beyond:.3g} {shown} in {rows_named(cause.rows)}."
    if cause.code == "outliers":
        if not cause.rows:
            return "There are no outliers."
        one = len(cause.rows) == 1
        name, verb, them = rows_named(cause.rows), "is an outlier" if one else "are outliers", "it" if one else "them"
        return f"{capital(name)} {verb}, by up to {milli(n['largest_m'])} mm. Check {them}."
    if cause.code == "one_point":
        return (
            "The measured positions are one point, the same in every row: a touched point or a fixed target. They show "
            f"neither a scale nor axes. With the nominal arm the tool misses the point by {milli(n['before_m'])} mm "
            f"(median), with a fitted geometry by {milli(n['fitted_m'])} mm, of which much is not determined. Touch "
            "several points, or measure positions, to calibrate the arm."
        )
    start = "factory calibration" if n["start"] == "factory_calibration" else "nominal arm"
    share = (
        f"a change of geometry explains {_percent(n['explained'])} of the squared error ({milli(n['before_rms_m'])} mm "
        f"RMS before, {milli(n['heldout_rms_m'])} mm on held-out rows)"
    )
    if n["kind"] == "none":
        return f"The {start} is correct to within the sensor noise: {share}."
    if n["kind"] == "geometry":
        return f"The error is a calibration error: {share}."
    if n["kind"] == "too_far":
        return (
            f"The poses are {milli(n['before_rms_m'])} mm RMS from the {start}: further than any calibration is off. "
            "A change of geometry explains them, but the arm, its zeros or the frames are not what is declared. Check "
            "these first."
        )
    part = "partly" if n["kind"] == "partly" else "not"
    return f"The error is {part} a calibration error: {share}. Diagnose the recording."


def _named(table: str) -> str:
    if table in VARIANTS:
        return f"the vendor's ROS default ({table})"
    return f"the published table ({table})" if table in bundled_arms() else f"the table of {table}"


def _percent(share: float) -> str:
    """A share that is not quite whole is not shown as whole."""
    return f"{100 * share:.1f} %" if 0.99 < share < 0.9995 else f"{100 * share:.0f} %"
