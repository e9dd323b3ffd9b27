"""The sentences about faults of the data and about causes of an error, each from a code and its numbers alone.

Their texts are in `templates/faults.yaml`. To add a fault, write its texts there.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import pass_context
from jinja2.runtime import Context
from rich.console import RenderableType

from lite6jax.arms.description import VARIANTS, bundled_arms
from lite6jax.recordings.fault import DataFault
from lite6jax.report.screen import indented, unbroken
from lite6jax.report.words import capital, fill, joined, milli, read_texts, rows_named

if TYPE_CHECKING:
    from lite6jax.domains.pose.check import Cause, RecordingCheck  # which fits, and what words faults does not

_TEXTS = read_texts("faults.yaml")
POSE_FAULTS: Mapping[str, Mapping[str, str]] = _TEXTS["poses"]
TORQUE_FAULTS: Mapping[str, Mapping[str, str]] = {
    code: texts for code, texts in _TEXTS["torques"].items() if "name" in texts
}
"""The texts of faults by code."""
TRACKING_FAULTS: Mapping[str, Mapping[str, str]] = _TEXTS["tracking"]
_FAULTS: Mapping[str, Mapping[str, str]] = POSE_FAULTS | _TEXTS["torques"] | TRACKING_FAULTS
_MISMATCHES = frozenset(code for code, texts in POSE_FAULTS.items() if "clause" in texts and "ruled_out" not in texts)
"""Those that make poses miss the arm grossly; the same numbers rule out all of them."""


def fault_name(code: str) -> str:
    """A fault in two or three words."""
    return _FAULTS.get(code, {}).get("name") or code.replace("_", " ").capitalize()


def fault_statement(fault: DataFault) -> str:
    """What is wrong, by how much, how it was corrected, and the remedy."""
    texts = _FAULTS.get(fault.code, {})
    numbers = fault.numbers
    if "found" in texts and not ("clause" in texts and "added_rad" in numbers and fault.code in POSE_FAULTS):
        return _fill(texts["found"], numbers, rows=fault.rows)
    if "clause" not in texts:
        return f"{fault_name(fault.code)}."
    remedy = texts.get("remedy", "Correct the columns in the file")
    return _fill(_TEXTS["mismatch"], numbers, said=_clause({**numbers, "fault": fault.code}), remedy=remedy)


def ruled_out_statements(faults: Iterable[DataFault]) -> list[str]:
    """Why faults that were tested for are not there; those that the same numbers rule out share a sentence."""
    groups: dict[str, list[DataFault]] = {}
    for number, fault in enumerate(faults):
        groups.setdefault(str(fault.numbers) if fault.code in _MISMATCHES else str(number), []).append(fault)
    sentences = []
    for group in groups.values():
        names = ", ".join(fault_name(fault.code) for fault in group)
        text = _TEXTS["no_mismatch"]
        if group[0].code not in _MISMATCHES:
            text = _FAULTS.get(group[0].code, {}).get("ruled_out")
        sentences.append(f"{names}: none was found." if text is None else _fill(text, group[0].numbers, names=names))
    return sentences


def is_granted(fault: DataFault) -> bool:
    """Whether a fault that was ruled out says how far a fitted arm is from the nominal one."""
    return fault.code == "arm_deviation" and fault.numbers.get("reason") == "granted"


def check_report(path: str | Path, check: "Sequence[Cause] | RecordingCheck") -> Iterator[RenderableType]:
    """A line for each possible cause of an error, with a mark before those to be removed first."""
    yield unbroken(str(path))
    causes = check if isinstance(check, Sequence) else check.causes
    if not isinstance(check, Sequence):
        yield from (_line(True, "Note", note) for note in check.notes)
        yield from fault_lines(check.faults)
        yield from (_line(False, "Data", sentence) for sentence in ruled_out_statements(check.ruled_out))
    for cause in causes:
        yield _line(cause.suspicious, _TEXTS["causes"][cause.code]["name"], cause_statement(cause))


def fault_lines(faults: Iterable[DataFault]) -> Iterator[RenderableType]:
    """A line for each fault of the data."""
    for fault in faults:
        rows = f" {capital(rows_named(fault.rows))}." if fault.rows else ""
        yield _line(True, fault_name(fault.code), fault_statement(fault) + rows)


def cause_statement(cause: "Cause") -> str:
    """What the data say of a possible cause of an error, and the remedy where there is one."""
    text = _TEXTS["causes"][cause.code]["found"]
    return _fill(text, cause.numbers, rows=cause.rows, suspicious=cause.suspicious)


def _line(suspicious: bool, name: str, sentence: str) -> RenderableType:
    return indented(f"{'!' if suspicious else '·'} {name}: {sentence}")


# ------------------------------------------------------------------ how texts are filled


def quality_statement(quality: Mapping[str, Any]) -> str | None:
    """Why a model does not describe the poses it was fitted to, and what to check; None where it does."""
    return fill(_TEXTS["quality"], quality) if quality["verdict"] == "bad" else None


def _fill(text: str, numbers: Mapping[str, Any], **more: object) -> str:
    return fill(text, {**_HELPERS, **numbers}, **more)


def _clause(part: Mapping[str, Any]) -> str:
    """A correction within a list of those that explain the data."""
    return _fill(_FAULTS[part["fault"]]["clause"], part)


def _frame(rotation: Sequence[float], translation: Sequence[float]) -> str:
    """How the base of the arm is turned and where it stands in the frame of the poses."""
    vector, shift = np.array(rotation), np.array(translation)
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 0 else vector
    main = int(np.argmax(np.abs(axis)))
    about = f"about {'xyz'[main]}" if abs(axis[main]) > 0.999 else f"about ({', '.join(f'{a:.2f}' for a in axis)})"
    placement = f": the base is turned by {np.rad2deg(angle):.4g} deg {about} in it"
    if np.linalg.norm(shift) > 2e-3:
        placement += f" and stands at ({', '.join(milli(x, 4) for x in shift)}) mm"
    if about == "about z" and abs(angle - np.pi) < 0.02:
        placement += ", as base_link and base of Universal Robots are to each other"
    return placement


def _mark(array: str, column: int | None, value: float | None, unit: str) -> str:
    """What stands in the place of a measurement."""
    axis = "" if column is None else "xyz"[column - 1] if array == "position" else f"joint {column}"
    if value is None:
        quantities = "joints" if array == "joint_position" else "coordinates" if array == "position" else "torques"
        return f"all {quantities} are those of another row"
    of_joints = f"the torque of {axis}" if axis and array not in ("joint_position", "position") else axis
    quantities = {"joint_position": "joints", "position": "coordinates"}.get(array, "torques")
    shown = f"{value:.6g} {unit}"
    if unit == "rad" and value:
        shown += f" ({np.rad2deg(value):.6g} deg)"
    if unit == "m" and value:
        shown += f" ({1e3 * value:.6g} mm)"
    return f"{of_joints} is {shown}" if axis else f"all {quantities} are {shown}"


def _table_name(table: str) -> str:
    if table in VARIANTS:
        return f"the vendor's ROS default ({table})"
    return f"the published table ({table})" if table in bundled_arms() else f"the table of {table}"


def _percent(share: float) -> str:
    """A share that is not quite whole is not shown as whole."""
    return f"{100 * share:.1f} %" if 0.99 < share < 0.9995 else f"{100 * share:.0f} %"


_UNITS = {"inches and millimetres": 25.4, "inches and metres": 39.37, "feet and metres": 3.2808}
_POWERS = {"millimetres and centimetres": 10.0, "centimetres and metres": 100.0, "millimetres and metres": 1000.0}


def _unit_ratio(factor: float) -> str:
    """The two units that differ by a factor or its inverse; none where it is no such factor."""
    ratio = max(factor, 1 / factor)
    near = (units for units, size in (_UNITS | _POWERS).items() if abs(ratio / size - 1) < 0.01)
    return next(near, "")


def _deviation(distance: float, factor: float, granted: float, granted_rad: float) -> str:
    """How far a fitted arm is from the nominal one, beside what factories grant."""
    beside = "within" if factor <= 1 else f"{factor:g} times"
    return (
        f"The fitted arm is {milli(distance)} mm from the nominal one (median of the recorded poses), {beside} what is "
        f"granted ({milli(granted)} mm and {np.rad2deg(granted_rad):.2g} deg)."
    )


@pass_context
def _furthest(context: Context) -> str:
    """The frame that is furthest from where the table has it, beside what is granted."""
    numbers = context.get_all()
    where = "the base" if numbers["frame"] == 0 else f"the frame after joint {numbers['frame']}"
    if "largest_m" in numbers:
        return f"{where}, by {milli(numbers['largest_m'])} mm along its {numbers['axis']}"
    return f"{where}, by {np.rad2deg(numbers['largest_rad']):.2g} deg about its {numbers['axis']}"


@pass_context
def _tables(context: Context) -> str:
    """How well each of two nominal tables fits."""
    return _fill(_TEXTS["tables"], context.get_all())


@pass_context
def _compared(context: Context, otherwise: str) -> str:
    """How much less likely the poses are without a fault, where that was compared."""
    return _fill(_TEXTS["compared"], context.get_all(), otherwise=otherwise)


_HELPERS: Mapping[str, Any] = {
    "either": lambda alternatives: "; or ".join(joined(map(_clause, parts)) for parts in alternatives),
    "terms": lambda labels: ", ".join(labels) or "no effect",
    "percent": _percent,
    "length_of": lambda vector: float(np.linalg.norm(vector)),
    "tables_compared": _tables,
    "compared": _compared,
    "frame": _frame,
    "mark": _mark,
    "table_name": _table_name,
    "table_of": {
        "nominal": "the nominal table",
        "factory": "the calibration file",
        "fitted": "a table that was fitted to them",
    }.__getitem__,
    "unit_ratio": _unit_ratio,
    "ratio": lambda factor: f"{max(factor, 1 / factor):.4g}",
    "deviation": _deviation,
    "furthest": _furthest,
    "distances": lambda tables: "; ".join(
        f"{_table_name(t['table'])} {milli(t['rms_m'])} mm RMS, {milli(t['largest_m'])} mm at most" for t in tables
    ),
}
