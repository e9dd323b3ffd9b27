"""What a terminal shows of predictions, compensations and registrations: in mm and degrees, for 60 columns."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType

from lite6jax.arms import frames
from lite6jax.domains.pose.compensate import REACHED, Compensation, Reason, TargetFrame
from lite6jax.domains.pose.predict import DiagnosedArm, deviation_columns
from lite6jax.domains.pose.registration import Registration
from lite6jax.domains.tracking.predict import CorrectedCommands, TrackedMotion
from lite6jax.formatting import SCREEN, fixed, joint_units, number
from lite6jax.report import screen
from lite6jax.report.faults import fault_name
from lite6jax.report.sentences import compensations as sentences
from lite6jax.report.words import fill, listing, read_texts

_SAID = read_texts("screens.yaml")["compensation"]
NO_BARS = (
    "the diagnosis does not say how uncertain its model is, so there are no standard deviations; run `lite6jax "
    "diagnose` again"
)
_JOINT_COLUMNS = ("swapped_joints", "joint_unit", "mirrored_joint", "coupled_joint")
"""Faults of the joint columns, which another file from the same source has too. Zeros that are off are in the model."""
_SHOWN = 0.05
"""deg or mm, that a joint is beyond its recorded range at least to be named."""
_ROWS_NAMED = 8


def corrected_columns(document: Mapping[str, Any], written: bool = False) -> str:
    """Says that a diagnosis corrected faults of its columns, which another file's may have; empty where it did not.

    Args:
        document: of the diagnosis.
        written: whether the other file's joint positions are written, not read.
    """
    said = []
    columns = [
        entry["fault"]
        for entry in document.get("data_faults", ())
        if entry["fault"] in _JOINT_COLUMNS or _is_missing_zero(entry, document)
    ]
    if columns:
        names = ", ".join(dict.fromkeys(fault_name(code).lower() for code in columns))
        remedy = "these are taken as they are: where they come from the same source, correct them likewise"
        if written:
            remedy = "joint positions are written as it corrected them: for that source, undo the correction"
        said.append(f"the diagnosis corrected its joint columns ({names}), and {remedy}")
    if any(entry["fault"] == "sensor_scale" for entry in document.get("data_faults", ())):
        said.append("positions are in true metres, not in those of the sensor, whose scale the diagnosis corrected")
    return "; ".join(said)


def _is_missing_zero(entry: Mapping[str, Any], document: Mapping[str, Any]) -> bool:
    """Tells whether a fault is a zero that is off, and the model lacks it: earlier versions did not write it."""
    of_all_rows = entry["fault"] == "joint_turns" and "added_rad" in entry["numbers"]
    return of_all_rows and "joint_zero_rad" not in document["model"]


def compensation_columns(compensation: Compensation) -> dict[str, NDArray]:
    """Column name to values: a motion for `predict`, and for each target whether it is reached, its error and why."""
    columns: dict[str, NDArray] = dict(compensation.recording.columns())
    columns["ok"] = compensation.reached.astype(int)
    columns["position_error_mm"] = 1e3 * compensation.position_error
    if compensation.orientation_error is not None:
        columns["orientation_error_deg"] = np.rad2deg(compensation.orientation_error)
    columns |= deviation_columns(compensation)
    sliding = compensation.recording.sliding
    columns["reason"] = np.array([reason_text(reason, sliding) for reason in compensation.reason], object)
    return columns


def reason_text(reason: Reason | None, sliding: Sequence[int] = ()) -> str:
    """A phrase; empty where there is nothing to report."""
    if reason is None:
        return ""
    scales, units = joint_units(sliding, max(reason.joints, default=0))
    pairs = zip(reason.joints, reason.angles, strict=True)
    shown = [(j, scales[j - 1] * at, units[j - 1]) for j, at in pairs]
    if reason.code == "at_limit":
        return sentences.joints_at_limit(shown)
    return fill(_SAID["reasons"][reason.code], {"shown": shown})


def compensation_report(
    compensation: Compensation, model: DiagnosedArm, source: str, frame: TargetFrame
) -> Iterator[RenderableType]:
    """What a terminal shows of a compensation: which targets are reached, why others are not, and how accurately."""
    hit = int(compensation.reached.sum())
    yield screen.unbroken(source)
    yield from (sentences.targets(compensation, model, frame), "")
    yield sentences.targets_reached(hit, len(compensation.reached) - hit)
    texts = np.array([reason_text(reason, model.sliding) for reason in compensation.reason], object)
    yield from _groups(compensation, texts, ~compensation.reached)
    if texts[compensation.reached].any():
        yield "Reached, but to be noted:"
        yield from _groups(compensation, texts, compensation.reached)
    if compensation.correction is not None and hit:
        scales, units = joint_units(model.sliding, model.dof)
        moved = scales * np.abs(compensation.correction[compensation.reached])
        unit_names = ", ".join(dict.fromkeys(units))
        rows = ((name, *map(fixed, of(moved, axis=0))) for name, of in (("median", np.median), ("max", np.max)))
        yield ""
        # rather wrap the name than cut numbers short
        joints = (f"q{joint}" for joint in range(1, model.dof + 1))
        yield listing(f"correction of the joints ({unit_names})", *joints, rows=rows, wrapped=[0])
    yield from screen.notes(compensation.notes)
    if compensation.omitted:
        yield from screen.notes([sentences.omitted_effects(compensation.omitted)])
    if compensation.position_std is None or compensation.outside is None:
        yield from screen.notes([NO_BARS])
    else:
        yield outside_sentence(int(compensation.outside.sum()), len(compensation.outside), "target")
        std = compensation.position_std[compensation.reached]
        yield from filter(None, [sentences.deviation_of_targets(std)])
    if model.heldout_rms is not None:
        before, after = model.heldout_rms
        yield from ("", fill(_SAID["expected"], {"before": before, "after": after}))


def _groups(compensation: Compensation, texts: NDArray, chosen: NDArray) -> Iterator[RenderableType]:
    """A line per reason, with the rows and the largest error."""
    reasons = Counter(text for text in texts[chosen] if text)
    for reason, _ in reasons.most_common(_ROWS_NAMED):
        rows = np.flatnonzero(chosen & (texts == reason))
        row_numbers = ", ".join(str(compensation.recording.row[k]) for k in rows[:_ROWS_NAMED])
        more = ", …" if len(rows) > _ROWS_NAMED else ""
        yield screen.indented(
            f"{reason}: row{'' if len(rows) == 1 else 's'} {row_numbers}{more}{_missed(compensation, rows)}"
        )
    if further_rows := reasons.total() - sum(n for _, n in reasons.most_common(_ROWS_NAMED)):
        yield screen.indented(f"and {further_rows} more, which are in the file")


def _missed(compensation: Compensation, rows: NDArray) -> str:
    """The largest error; rows without a target have none."""
    largest = []
    errors = (compensation.position_error, compensation.orientation_error)
    for error, (scale, unit), tolerance in zip(errors, SCREEN.values(), REACHED, strict=True):
        worst = 0.0
        if error is not None:
            worst = float(np.nan_to_num(error[rows]).max())
        if worst > tolerance:
            largest.append(f"{number(scale * worst)} {unit}")
    if largest:
        return f", with errors up to {' and '.join(largest)}"
    return ""


def corrected_sentences(found: CorrectedCommands) -> list[str]:
    """What corrected commands are worth by the model, and which rows it was not fitted to."""
    before, after = (float(1e3 * np.sqrt(np.mean(part**2))) for part in (found.error_before, found.error_after))
    gain = fill(_SAID["corrected"], {"found": found, "before": before, "after": after})
    return [gain, sentences.rolled_rows_outside(found.beyond)]


def corrected_report(found: CorrectedCommands, source: str) -> Iterator[RenderableType]:
    """What a terminal shows of corrected commands: the errors of each joint, as predicted."""
    yield screen.unbroken(source)
    joints = enumerate(zip(found.error_before, found.error_after, strict=True), 1)
    rows = [(f"joint {joint}", *(fixed(1e3 * error) for error in errors)) for joint, errors in joints]
    yield listing("predicted error (mrad RMS)", "before", "after", rows=rows)
    yield ""
    yield from corrected_sentences(found)


def outside_sentence(outside: int, rows: int, noun: str) -> str:
    """How many rows are outside what was recorded; `noun` is what a row is called."""
    return sentences.rows_outside(outside, rows, noun)


def rolled_sentence(tracked: TrackedMotion) -> str:
    """How many rows of a rollout are outside what was recorded, and by what of which joints."""
    return sentences.rolled_rows_outside(tracked.beyond)


def frame_of_stations(document: Mapping[str, Any]) -> str:
    """In which of several stations' frames a diagnosed model predicts; empty where there is one frame."""
    if "stations" not in document.get("nuisance", {}):
        return ""
    files = [entry["file"] for entry in document.get("inputs", ()) if entry["role"] == "recording"]
    first = files[0] if files else "the first recording"
    other_files = ", ".join(files[1:]) or "another"
    return (
        f"Poses are in the sensor's frame of {first}; with --register they are in that of the motion's own poses, such "
        f"as those of {other_files}."
    )


def outside_warning(compensation: Compensation, model: DiagnosedArm) -> str:
    """Which targets leave the recorded range, and by how much; empty where none does."""
    if compensation.outside is None or model.uncertainty is None or not compensation.outside.any():
        return ""
    lower, upper = model.uncertainty.recorded.joints.T
    q = compensation.joint_position[compensation.outside] + np.asarray(model.joint_zero)
    scales, units = joint_units(model.sliding, model.dof)
    beyond = scales * np.nanmax(np.maximum(lower - q, q - upper), axis=0)
    joints = [
        f"joint {joint} by up to {excess:.3g} {unit}"
        for joint, (excess, unit) in enumerate(zip(beyond, units, strict=True), 1)
        if excess > _SHOWN
    ]
    return sentences.beyond_range(compensation.recording.row[compensation.outside].tolist(), joints)


def registration_report(registration: Registration) -> Iterator[RenderableType]:
    """The frames that were fitted, and the remaining errors."""
    yield from sentences.registered(registration)
    table = listing("", "x", "y", "z", "roll", "pitch", "yaw")
    for name, T in (("sensor to base", registration.T_sensor_base), ("flange to tool", registration.T_flange_tool)):
        row = frames.row_from_transform(T) * np.repeat([scale for scale, _ in SCREEN.values()], 3)
        table.add_row(f"{name} (mm, deg)", *(fixed(float(value), 3) for value in row))
    yield table
    yield from sentences.undetermined_frames(registration)
