"""What a person reads of a diagnosis, top to bottom: verdict, before and after, findings, what cannot be told."""

import re
from collections.abc import Iterator

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from lite6jax.diagnosis.diagnose import Diagnosis, statement
from lite6jax.physics.catalogue import effect_as_dict
from lite6jax.report.cells import listing, number

VERDICTS = {
    "consistent": "Nothing is missing: the recording is what this arm's model and the sensor's noise make.",
    "explained": "Explained: with the physics below, what is left is the sensor's noise.",
    "partly_explained": "Partly explained: the physics below is there, and more is left than noise.",
    "unnamed": "Something real is there that no entry of the catalogue explains.",
}
NAMED = 6


def chance(p: float) -> str:
    """A probability in a phrase; one below what floats hold is not zero."""
    return f"p = {p:.1e}" if p > 0 else "p < 1e-300"


def diagnosis_report(found: Diagnosis, source: str) -> Iterator[RenderableType]:
    """The page."""
    case = found.case
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(f"{case.arm.name}, {case.samples} samples ({case.recording.motion}).")
    yield ""
    yield Text(VERDICTS[found.verdict])
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
