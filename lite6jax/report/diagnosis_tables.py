"""What a person reads of a diagnosis, top to bottom: verdict, before and after, findings, what cannot be told."""

import re
from collections.abc import Iterator

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from lite6jax.arms import frames
from lite6jax.diagnosis.against import Against
from lite6jax.diagnosis.diagnose import Diagnosis, statement
from lite6jax.diagnosis.registration import Registration
from lite6jax.physics.catalogue import effect_as_dict
from lite6jax.report.cells import SCREEN, fixed, listing, number

VERDICTS = {
    "consistent": "Nothing is missing: the recording is what this arm's model and the sensor's noise make.",
    "explained": "Explained: with the physics below, what is left is the sensor's noise.",
    "partly_explained": "Partly explained: the physics below is there, and more is left than noise.",
    "unnamed": "Something real is there that no entry of the catalogue explains.",
}
AGREE = "Beyond that both sides agree: what is left of their difference is noise."
NAMED = 6


def chance(p: float) -> str:
    """A probability in a phrase; one below what floats hold is not zero."""
    return f"p = {p:.1e}" if p > 0 else "p < 1e-300"


def diagnosis_report(found: Diagnosis, source: str, against: Against | None = None) -> Iterator[RenderableType]:
    """The page; with what the other side is, where there is one."""
    case = found.case
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(f"{case.arm.name}, {case.samples} samples ({case.recording.motion}).")
    yield ""
    if against is not None:
        yield from against_report(against)
        yield ""
    yield Text(AGREE if against is not None and found.verdict == "consistent" else VERDICTS[found.verdict])
    yield ""
    kept = ~found.outliers
    table = listing("held-out position error (mm)", "rms", "p95", "max")
    for name, errors in (("before", found.before), ("after", found.after)):
        values = 1e3 * errors[kept]
        table.add_row(
            name, *(number(float(v)) for v in (np.sqrt(np.mean(values**2)), np.percentile(values, 95), values.max()))
        )
    yield table
    declared = f", declared {number(1e3 * case.noise[0])} mm" if case.declared else ""
    yield Text(f"Noise per axis: {number(1e3 * found.estimated_noise)} mm estimated{declared}.")
    fitted = found.selection.fitted
    for step, part in zip(found.selection.steps, fitted.physics.slices, strict=True):
        entry = effect_as_dict(step.effect, fitted.values[part], fitted.covariance[part, part])
        yield ""
        yield Text(f"{statement(step.effect, entry['parameters'])} Chance alone: {chance(step.p)} over all searched.")
        near = [rival for rival in step.rivals if rival.gap < NAMED]
        if near:
            names = ", ".join(f"{rival.effect.label} ({rival.gap:+.1f})" for rival in near)
            yield Text(f"  Not told apart from: {names} (log-likelihood less).")
    if found.outliers.any():
        yield ""
        rows = case.recording.row[found.outliers]
        shown = ", ".join(map(str, rows[:NAMED])) + (", …" if len(rows) > NAMED else "")
        yield Text(f"{len(rows)} rows stand out of what noise allows: {shown}.")
    reasons = {}
    for item in found.untestable:
        reason = re.sub(r"(joint|link) \d+", r"the \1", item.reason)
        reasons.setdefault(reason, []).append(item.effect.label)
    if reasons:
        yield ""
        yield Text("Not tested:")
        for reason, labels in reasons.items():
            names = ", ".join(labels[:NAMED]) + (f" and {len(labels) - NAMED} more" if len(labels) > NAMED else "")
            yield Text(f"  {names}: {reason}")
    yield ""


def against_report(seen: Against) -> Iterator[RenderableType]:
    """What the other side is."""
    figures = seen.to_dict()
    makes = "reproduces" if seen.reproduced else "does not reproduce"
    yield Text(
        f"Against {seen.file}, {seen.matched} rows: the model {makes} it, "
        f"{number(1e3 * figures['position_rms_m'])} mm RMS and {number(1e3 * figures['position_max_m'])} mm at most."
    )
    for line in (*seen.differences, *seen.notes, seen.statement):
        yield Text(f"  {line}")


def registration_report(found: Registration) -> Iterator[RenderableType]:
    """The frames that were fitted, and what they leave."""
    kept = found.kept
    turned = ""
    if found.turned is not None:
        turned = f" and {number(float(np.rad2deg(np.sqrt(np.mean(np.sum(found.turned[kept] ** 2, 1))))))} deg"
    yield Text(f"Registered on {len(kept)} rows: {number(1e3 * found.rms)} mm{turned} RMS left.")
    if not kept.all():
        yield Text(f"{np.sum(~kept)} rows stand out and count for little.")
    table = listing("", "x", "y", "z", "roll", "pitch", "yaw")
    for name, T in (("sensor to base", found.T_sensor_base), ("flange to tool", found.T_flange_tool)):
        row = frames.row_from_transform(T) * np.repeat([SCREEN["m"][0], SCREEN["rad"][0]], 3)
        table.add_row(f"{name} (mm, deg)", *(fixed(float(value), 3) for value in row))
    yield table
    if found.turned is None:
        yield Text("Positions do not show the tool's rotation: only its offset is fitted.")
