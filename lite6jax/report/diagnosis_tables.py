"""What a person reads of a diagnosis, top to bottom: verdict, before and after, findings, what cannot be told."""

from collections.abc import Iterable, Iterator

import numpy as np
from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from lite6jax.arms import frames
from lite6jax.diagnosis.diagnose import Diagnosis, statement
from lite6jax.diagnosis.discrimination import Separation
from lite6jax.domains.pose.load_model import INERTIA_COUNTS
from lite6jax.domains.pose.reference import ReferenceComparison
from lite6jax.domains.pose.registration import Registration
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import effect_as_dict
from lite6jax.report import diagnosis_words as words
from lite6jax.report import reference
from lite6jax.report.cells import SCREEN, fixed, listing, number


def diagnosis_report(
    found: Diagnosis, source: str, against: ReferenceComparison | None = None
) -> Iterator[RenderableType]:
    """The page; with what the other side is, where there is one."""
    case = found.case
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(f"{case.arm.name}, {case.samples} samples ({case.recording.motion}).")
    yield ""
    if against is not None:
        yield from reference_report(against)
        yield ""
    yield Text(words.verdict_of(found, against))
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
    faults = [f"{told.statement}{f' Rows {told.rows}.' if told.rows else ''}" for told in words.faults_of(found)]
    yield from _headed("Data faults:", faults)
    if found.selection.steps:
        yield ""
        yield from _findings(found)
        if INERTIA_COUNTS in case.notes:
            yield Text(INERTIA_COUNTS)
    yield from _headed("Looked for in the data and not found:", words.ruled_out_in_short(found))
    groups = []
    for group in words.untested(found):
        names = ", ".join(f"{name}:{sites}" for name, sites in words.by_site(group.effects))
        groups.append(f"{group.reason}: {names}")
    yield from _headed("Not tested:", groups)
    yield from _headed("What to record next:", words.to_record(found))
    for item in found.separating:
        yield ""
        yield from _poses(item)
    if found.separating:
        yield Text(words.NOT_CHECKED)
    yield ""


def reference_report(comparison: ReferenceComparison) -> Iterator[RenderableType]:
    """How the reference differs from the model."""
    codes = comparison.to_dict()
    yield Text(reference.headline(codes))
    yield from map(_indented, reference.difference_sentences(codes) + reference.note_sentences(codes))
    yield _indented(reference.model_statement(comparison.file, comparison.rigid))


def _findings(found: Diagnosis) -> Iterator[RenderableType]:
    fitted = found.selection.fitted
    table = Table.grid(padding=(0, 1, 0, 0))
    for k, (step, part) in enumerate(zip(found.selection.steps, fitted.physics.slices, strict=True), 1):
        values, covariance = fitted.values[part], fitted.covariance[part, part]
        if isinstance(step.effect, Unnamed):
            swing, std = words.peak_to_peak(found.case, step.effect, values, covariance)
            unit = f"m{step.effect.coordinates[0].unit}"
            size = " ± ".join(words.rounded(1e3 * swing, 1e3 * std))
            told = f"{words.capital(words.named(step.effect))}: {size} {unit} peak to peak."
        else:
            told = statement(step.effect, effect_as_dict(step.effect, values, covariance)["parameters"])
        lines = [f"{told} Chance alone: {words.chance(step.p)} over all searched."]
        close = words.near(step)
        if close:
            lines.append(f"Not told apart from: {', '.join(close)} (log-likelihood less).")
        table.add_row(Text(f"{k}."), Text("\n".join(lines)))
    yield table


def _headed(heading: str, lines: Iterable[str]) -> Iterator[RenderableType]:
    """A heading and its lines below, further in; nothing where there are none."""
    for k, line in enumerate(lines):
        if not k:
            yield ""
            yield Text(heading)
        yield _indented(line)


def _indented(line: str) -> RenderableType:
    return Padding(Text(line), (0, 0, 0, 2))


def _poses(item: Separation) -> Iterator[RenderableType]:
    yield Text(f"{words.separation_title(item)}:")
    table = listing("", *(f"q{joint}" for joint in range(1, item.joint_position.shape[1] + 1)))
    for k, row in enumerate(np.rad2deg(item.joint_position), 1):
        table.add_row(str(k), *(fixed(float(angle), 1) for angle in row))
    yield table


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
