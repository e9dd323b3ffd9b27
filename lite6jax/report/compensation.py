"""What a terminal shows of predictions: of a registration, and of a compensation which targets are reached, and why."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from rich.text import Text

from lite6jax.arms import frames
from lite6jax.domains.pose.compensate import REACHED, Compensation, Reason, TargetFrame
from lite6jax.domains.pose.predict import DiagnosedArm, deviation_columns
from lite6jax.domains.pose.registration import Registration
from lite6jax.report import screen
from lite6jax.report.screen import indented
from lite6jax.report.words import SCREEN, counted, fixed, joint_units, listing, number, rows_named

NO_BARS = (
    "the diagnosis does not say how uncertain its model is, so there are no standard deviations; run `lite6jax "
    "diagnose` again"
)
_SHOWN = 0.05
"""deg or mm, that a joint is beyond its recorded range at least to be named."""
_ROWS_NAMED = 8


def compensation_columns(found: Compensation) -> dict[str, NDArray]:
    """Column name to values: a motion for `predict`, and for each target whether it is reached, its error and why."""
    columns: dict[str, NDArray] = dict(found.recording.columns())
    columns["ok"] = found.reached.astype(int)
    columns["position_error_mm"] = 1e3 * found.position_error
    if found.orientation_error is not None:
        columns["orientation_error_deg"] = np.rad2deg(found.orientation_error)
    columns |= deviation_columns(found)
    sliding = found.recording.sliding
    columns["reason"] = np.array([reason_text(reason, sliding) for reason in found.reason], object)
    return columns


def reason_text(reason: Reason | None, sliding: Sequence[int] = ()) -> str:
    """A phrase; empty where there is nothing to report."""
    if reason is None:
        return ""
    scales, units = joint_units(sliding, max(reason.joints, default=0))
    there = [joint - 1 for joint in reason.joints]
    shown = [(value * scales[j], units[j]) for j, value in zip(there, reason.angles, strict=True)]
    match reason.code:
        case "empty_field":
            return "an empty field"
        case "reverses":
            return "the direction of approach reverses; approach it from one side"
        case "at_limit":
            sides = zip(reason.joints, shown, strict=True)
            return " and ".join(f"joint {joint} at its limit of {at:.4g} {unit}" for joint, (at, unit) in sides)
        case "near_singular":
            return "next to a singular position"
        case "out_of_reach":
            return "out of reach"
        case "far_from_start":
            return f"joint {reason.joints[0]} is {shown[0][0]:.0f} {shown[0][1]} from where it was given"


def compensation_report(
    found: Compensation, model: DiagnosedArm, source: str, frame: TargetFrame
) -> Iterator[RenderableType]:
    """What a terminal shows of a compensation: which targets are reached, why others are not, and how accurately."""
    count, hit = len(found.reached), int(found.reached.sum())
    kind = "positions" if found.orientation_error is None else "positions and orientations"
    where = "the sensor's frame" if frame == "sensor" else "the arm's base"
    effects = len(model.physics.effects)
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(
        f"{counted(count, 'target')} ({kind} in {where}) for a {model.arm} with {counted(effects, 'effect')} "
        "beyond its geometry."
    )
    yield ""
    yield Text(
        f"{counted(hit, 'target')} reached" + (f", {counted(count - hit, 'target')} not:" if hit < count else ".")
    )
    texts = np.array([reason_text(reason, model.sliding) for reason in found.reason], object)
    yield from _groups(found, texts, ~found.reached)
    if texts[found.reached].any():
        yield Text("Reached, but to be noted:")
        yield from _groups(found, texts, found.reached)
    if found.correction is not None and hit:
        scales, units = joint_units(model.sliding, model.dof)
        moved, named = scales * np.abs(found.correction[found.reached]), ", ".join(dict.fromkeys(units))
        rows = ((name, *map(fixed, of(moved, axis=0))) for name, of in (("median", np.median), ("max", np.max)))
        yield ""
        # rather wrap the name than cut numbers short
        joints = (f"q{joint}" for joint in range(1, model.dof + 1))
        yield listing(f"correction of the joints ({named})", *joints, rows=rows, wrapped=[0])
    yield from screen.notes(found.notes)
    if found.omitted:
        verb = "concerns" if len(found.omitted) == 1 else "concern"
        omitted = f"omitted: {' and '.join(found.omitted)}, which {verb} the sensor and not the arm's position"
        yield from screen.notes([omitted])
    if found.position_std is None or found.outside is None:
        yield from screen.notes([NO_BARS])
    else:
        yield Text(outside_sentence(int(found.outside.sum()), len(found.outside), "target"))
        if hit:
            std = 1e3 * found.position_std[found.reached]
            rms, most = (number(float(one)) for one in (np.sqrt(np.mean(std**2)), std.max()))
            yield Text(f"Standard deviation of the positions reached: {rms} mm RMS per axis, at most {most} mm.")
    if model.heldout_rms is not None:
        before, after = (number(1e3 * rms) for rms in model.heldout_rms)
        yield ""
        yield Text(
            f"Expected accuracy: in cross-validation this model had position errors of {after} mm RMS, and {before} mm "
            "without its effects."
        )


def _groups(found: Compensation, texts: NDArray, chosen: NDArray) -> Iterator[RenderableType]:
    """A line per reason, with the rows and the largest error."""
    reasons = Counter(text for text in texts[chosen] if text)
    for reason, _ in reasons.most_common(_ROWS_NAMED):
        rows = np.flatnonzero(chosen & (texts == reason))
        named = ", ".join(str(found.recording.row[k]) for k in rows[:_ROWS_NAMED])
        more = ", …" if len(rows) > _ROWS_NAMED else ""
        yield indented(f"{reason}: row{'' if len(rows) == 1 else 's'} {named}{more}{_missed(found, rows)}")
    rest = sum(reasons.values()) - sum(n for _, n in reasons.most_common(_ROWS_NAMED))
    if rest:
        yield indented(f"and {rest} more, which are in the file")


def _missed(found: Compensation, rows: NDArray) -> str:
    """The largest error; rows without a target have none."""
    largest = []
    for errors, scale, unit, least in (
        (found.position_error, 1e3, " mm", REACHED[0]),
        (found.orientation_error, 180 / np.pi, " deg", REACHED[1]),
    ):
        most = 0.0 if errors is None else float(np.nan_to_num(errors[rows]).max())
        if most > least:
            largest.append(f"{number(scale * most)}{unit}")
    return f", with errors up to {' and '.join(largest)}" if largest else ""


def outside_sentence(outside: int, rows: int, noun: str) -> str:
    """How many rows are outside what was recorded; `noun` is what a row is called."""
    if not outside:
        return f"No {noun} is outside what was recorded."
    return (
        f"{outside} of {counted(rows, noun)} {'is' if outside == 1 else 'are'} outside what was recorded, beyond its "
        "range or in its gaps: the standard deviations are large there."
    )


def outside_warning(found: Compensation, model: DiagnosedArm) -> str:
    """Which targets leave the recorded range, and by how much; empty where none does."""
    if found.outside is None or model.uncertainty is None or not found.outside.any():
        return ""
    rows = found.recording.row[found.outside].tolist()
    lower, upper = model.uncertainty.recorded.joints.T
    q = found.joint_position[found.outside]
    scales, units = joint_units(model.sliding, model.dof)
    beyond = scales * np.nanmax(np.maximum(lower - q, q - upper), axis=0)
    joints = [
        f"joint {joint} by up to {excess:.3g} {unit}"
        for joint, (excess, unit) in enumerate(zip(beyond, units, strict=True), 1)
        if excess > _SHOWN
    ]
    where = f" ({', '.join(joints)})" if joints else ""
    verb = "is" if len(rows) == 1 else "are"
    return (
        f"{rows_named(rows)} {verb} outside what was recorded{where}: there the compensation extrapolates; record "
        "poses there, or keep targets inside"
    )


def registration_report(found: Registration) -> Iterator[RenderableType]:
    """The frames that were fitted, and the remaining errors."""
    kept = found.kept
    turned = ""
    if found.turned is not None:
        turned = f" and {number(float(np.rad2deg(np.sqrt(np.mean(np.sum(found.turned[kept] ** 2, 1))))))} deg"
    yield Text(f"The registration on {len(kept)} rows leaves errors of {number(1e3 * found.rms)} mm{turned} RMS.")
    if not kept.all():
        yield Text(f"{np.sum(~kept)} rows are outliers and have little weight.")
    table = listing("", "x", "y", "z", "roll", "pitch", "yaw")
    for name, T in (("sensor to base", found.T_sensor_base), ("flange to tool", found.T_flange_tool)):
        row = frames.row_from_transform(T) * np.repeat([SCREEN["m"][0], SCREEN["rad"][0]], 3)
        table.add_row(f"{name} (mm, deg)", *(fixed(float(value), 3) for value in row))
    yield table
    if found.turned is None:
        yield Text("Positions do not determine the tool's rotation: only its offset is fitted.")
    if not found.determined:
        yield Text("These poses do not determine every number of the two frames.")
