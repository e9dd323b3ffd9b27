"""What each kind of public result can do: its summary, its figures, its table and its files, a function each.

To add a kind, let its class inherit `lite6jax.results.PublicResult`, and register a function with `describe`, `draw`
and `tabulate`. A result is saved as JSON where `documents` has a document of its class, as a table, and a diagnosis as
a page; a class whose file is another one registers a function with `write`.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial, singledispatch
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.console import RenderableType

from lite6jax import suffixes
from lite6jax.calibration.fleet import Comparison, FleetSolution
from lite6jax.calibration.quality import Result
from lite6jax.calibration.solution import Solution, write_solution
from lite6jax.design.identify import Identification, Sensitivity
from lite6jax.design.poses import DiscriminationPlan, Plan
from lite6jax.diagnosis.document import document_text
from lite6jax.diagnosis.result import DomainDiagnosis
from lite6jax.diagnosis.tracking_diagnosis import TrackingDiagnosis
from lite6jax.domains.pose.compensate import Compensation
from lite6jax.domains.pose.predict import Prediction
from lite6jax.domains.pose.registration import Registration
from lite6jax.domains.torque.predict import TorquePrediction
from lite6jax.domains.tracking.predict import CorrectedCommands, TrackedMotion
from lite6jax.errors import InputError
from lite6jax.formatting import SCREEN, be, counted, each_with_unit, joint_units, torque_units
from lite6jax.recordings import Recording, write_recording
from lite6jax.recordings.files import write_table
from lite6jax.report import diagnosis_figures, figures, fits, ranking, statements, study, tracking
from lite6jax.report.compensations import (
    compensation_columns,
    corrected_sentences,
    outside_sentence,
    registration_report,
    rolled_sentence,
)
from lite6jax.report.documents import document, has_document, text
from lite6jax.report.faults import fault_name
from lite6jax.report.figures import AFTER, BEFORE, STYLE, dots, panels_in_rows, titled
from lite6jax.report.pages import diagnosis_page
from lite6jax.report.sentences import diagnosis as diagnosis_sentences
from lite6jax.report.sentences.document import words_of
from lite6jax.report.sentences.results import (
    NOT_SAID,
    describe_compensation,
    describe_fleet,
    describe_prediction,
    describe_recording,
    describe_solution,
    describe_torques,
)
from lite6jax.results import Description, Figures, PublicResult
from lite6jax.storage import check_writable, write_atomically

Columns = dict[str, Any]


def _unregistered(operation: str, result: Any, *_: object) -> Any:
    raise TypeError(f"{type(result).__name__} has no function of {operation} in {__name__}; register one")


describe = singledispatch(partial(_unregistered, "describe"))
"""`describe(result) -> Description`."""
draw = singledispatch(partial(_unregistered, "draw"))
"""`draw(result, title) -> Figures`; the title begins that of each figure, and is the result's own where it is empty."""
tabulate = singledispatch(partial(_unregistered, "tabulate"))
"""`tabulate(result)`: by the name of a column with its unit, `(row,)` values."""
write = singledispatch(partial(_unregistered, "write"))
"""`write(result, path, overwrite) -> Path`, in the form that the suffix names; refuses others with an `InputError`."""


# ------------------------------------------------------------------ summaries


_MOST_FINDINGS = 4


def _outside(result: Prediction | TorquePrediction | Compensation) -> str:
    outside = result.outside
    if outside is None:
        return NOT_SAID
    return outside_sentence(int(outside.sum()), len(outside), "row")


@describe.register
def _recording(recording: Recording) -> Description:
    scales, units = joint_units(recording.sliding, recording.dof)
    span = scales * np.ptp(recording.joint_position, axis=0)
    least_span, largest_span = (f"{span[joint]:.0f} {units[joint]}" for joint in (np.argmin(span), np.argmax(span)))
    sentences = describe_recording(recording, fits.what_is_measured(recording), least_span, largest_span)
    return Description(f"Recording of {recording.settings.arm or 'an arm'}", tuple(sentences), tuple(recording.notes))


@describe.register
def _solution(solution: Solution) -> Description:
    data = "calibration" if solution.noise is None else "recording"
    title = f"Fit of a {data}, {solution.arm.name}"
    return Description(title, tuple(describe_solution(solution, data)), tuple(solution.notes))


@describe.register
def _fleet(fleet_solution: FleetSolution) -> Description:
    return Description("Fits of a fleet", tuple(describe_fleet(fleet_solution)))


def _as_shown(title: str, report: Iterable[RenderableType], *before: str) -> Description:
    """The sentences of a terminal's report, without its tables and headings; its notes apart."""
    sentences = [part for part in report if isinstance(part, str) and part.endswith(".")]
    notes = [line.removeprefix("Note: ") for line in sentences if line.startswith("Note: ")]
    return Description(title, (*before, *(line for line in sentences if not line.startswith("Note: "))), tuple(notes))


@describe.register
def _comparison(comparison: Comparison) -> Description:
    return _as_shown(
        f"Comparison of {len(comparison.names)} arms, {comparison.arm.name}",
        fits.comparison_report(comparison, width=80),
    )


@describe.register
def _sensitivity(sensitivity: Sensitivity) -> Description:
    return _as_shown("Sensitivity of the flange to the tolerances", study.sensitivity_report(sensitivity, ""))


@describe.register
def _registration(registration: Registration) -> Description:
    return _as_shown("Registration of sensor and tool", registration_report(registration))


@describe.register
def _identification(identification: Identification) -> Description:
    name = identification.experiment.arm.name
    return _as_shown(f"Identifiability, {name}", study.identification_report(identification, name, drawn=False))


@describe.register
def _plan(plan: Plan | DiscriminationPlan) -> Description:
    chosen = f"{counted(plan.count, 'pose')} of {counted(plan.candidates, 'candidate')} {be(plan.count)} chosen."
    report = study.plan_report(plan) if isinstance(plan, Plan) else study.discrimination_report(plan)
    return _as_shown(f"Poses to record, {plan.experiment.arm.name}", report, chosen)


@describe.register
def _prediction(prediction: Prediction) -> Description:
    return Description("Predicted poses", tuple(describe_prediction(prediction, _outside(prediction))))


@describe.register
def _torque_prediction(prediction: TorquePrediction) -> Description:
    units = torque_units(prediction.sliding, prediction.torque.shape[1])
    largest = each_with_unit(np.nanmax(np.abs(prediction.torque), 0).tolist(), units)
    deviations = ""
    if prediction.std is not None:
        deviations = each_with_unit(np.nanmedian(prediction.std, 0).tolist(), units)
    sentences = describe_torques(prediction, largest, deviations, _outside(prediction))
    return Description("Predicted torques", tuple(sentences))


@describe.register
def _tracked_motion(tracked: TrackedMotion) -> Description:
    rows, joints = tracked.position.shape
    sentence = (
        f"Joints {', '.join(map(str, range(1, joints + 1)))} in {counted(rows, 'row')}, rolled out from commands."
    )
    return Description("Predicted joints", (sentence, rolled_sentence(tracked)))


@describe.register
def _corrected_commands(corrected: CorrectedCommands) -> Description:
    return Description("Corrected commands", tuple(corrected_sentences(corrected)))


@describe.register
def _compensation(compensation: Compensation) -> Description:
    largest = ""
    if compensation.correction is not None:
        scales, units = joint_units(compensation.recording.sliding, compensation.correction.shape[1])
        largest = each_with_unit((scales * np.nanmax(np.abs(compensation.correction), 0)).tolist(), units)
    sentences = describe_compensation(compensation, largest, _outside(compensation))
    return Description("Compensation", tuple(sentences), tuple(compensation.notes))


@describe.register
def _tracking_diagnosis(diagnosis: TrackingDiagnosis) -> Description:
    document = diagnosis.to_dict()
    sentences = [tracking.headline(document), tracking.following_statement(document)]
    sentences += [tracking.verdict_statement(document), *tracking.cautions(document)]
    sentences += [tracking.finding_statement(finding) for finding in tracking.ranked(document)[:_MOST_FINDINGS]]
    title = f"Diagnosis of how a {document['model']['arm']} follows its commands"
    return Description(title, tuple(sentences), tuple(tracking.what_to_record(document)))


@describe.register
def _diagnosis(diagnosis: DomainDiagnosis) -> Description:
    document = diagnosis.to_dict()
    findings = statements.findings_of(document)
    hidden = len(findings) - _MOST_FINDINGS
    words = words_of(document)
    subject = words.subject
    errors_are, before, after = words.overall_error(document)
    after_effects = ""
    if findings:
        after_effects = f"{after} RMS with these effects and "
    faults = [fault_name(entry["fault"]).lower() for entry in document["data_faults"]]
    notes = [*words.assumptions(document), *statements.what_to_record(document)]
    beside = []
    for part in diagnosis.beside:
        subject = f"the {diagnosis_sentences.measured(document)} of "
        of_domain = describe(part)
        beside += of_domain.sentences
        notes += of_domain.notes
    beside += map(statements.agreement_statement, document.get("shared", ()))
    sentences = [
        ranking.headline(document),
        diagnosis_sentences.verdict_statement(document),
        *statements.cautions(document),
    ]
    sentences += [finding["statement"] for finding in findings[:_MOST_FINDINGS]]
    sentences += [f"{counted(hidden, 'more finding')} {be(hidden)} in `findings`."] if hidden > 0 else []
    sentences += [f"The held-out {errors_are} {after_effects}{before} RMS with the model of the arm alone."]
    sentences += [f"The data have {counted(len(faults), 'fault')}: {', '.join(faults)}."] if faults else []
    sentences += [diagnosis_sentences.refusal(domain, reason) for domain, reason in diagnosis.refused.items()]
    return Description(f"Diagnosis of {subject}a {document['model']['arm']}", (*sentences, *beside), tuple(notes))


# ------------------------------------------------------------------ figures


_MARKED = {"outside": "outside what was recorded", "outlier": "outlier"}
"""Columns that are not zero in rows that have another colour, and what these are."""


def _over_rows(matching: str, subject: str) -> Callable[[PublicResult, str], Figure | None]:
    """How the columns of a table that match an expression are drawn, a panel each, in mm and deg, if there are any."""

    @rc_context(STYLE)
    def drawn(result: PublicResult, title: str) -> Figure | None:
        table = tabulate(result)
        columns = [column for column in table if re.fullmatch(matching, column)]
        if not columns:
            return None
        row = result.row if isinstance(result, Recording) else np.arange(1, len(table[columns[0]]) + 1)
        marked = next((name for name in _MARKED if name in table), "")
        marked_rows = np.asarray(table.get(marked, np.zeros(len(row)))) > 0
        figure, axes = panels_in_rows(len(columns), wide=len(columns) == 1)
        for axis, column in zip(axes, columns, strict=True):
            of, _, unit = column.rpartition("_")
            scale, shown = SCREEN.get(unit, (1.0, unit))
            for rows, color in ((~marked_rows, AFTER), (marked_rows, BEFORE)):
                dots(axis, row[rows].astype(float), scale * np.asarray(table[column])[rows], color)
            across = "arm" if isinstance(result, FleetSolution) else "row"
            axis.set(xlabel=across, ylabel=f"{of.replace('_', ' ')} ({shown})")
            axis.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        if marked_rows.any():
            axes[0].plot([], [], "o", color=BEFORE, label=_MARKED[marked])
            figure.legend(loc="outside lower center", frameon=False)
        return titled(figure, f"{title}: {subject}")

    return drawn


_JOINTS = _over_rows(r"q\d+_(rad|m)", "joint positions")
_FIGURES: dict[type, dict[str, Callable[[Any, str], Figure | None]]] = {
    Recording: {"joints": _JOINTS, "positions": _over_rows(r"[xyz]_m", "measured positions")},
    FleetSolution: {"errors": _over_rows(r"(position|orientation)_rms_(m|rad)", "errors of the fits")},
    Prediction: {
        "positions": _over_rows(r"[xyz]_m", "predicted positions"),
        "std": _over_rows(r"[xyz]_std_m", "standard deviation of a position"),
    },
    TorquePrediction: {"torques": _over_rows(r"tau\d+_Nm?", "predicted torques")},
    TrackedMotion: {"joints": _over_rows(r"q\d+_rad", "predicted joints")},
    CorrectedCommands: {"commands": _over_rows(r"cmd\d+_rad", "corrected commands")},
    Compensation: {"error": _over_rows(r"position_error_mm", "distance from the target"), "joints": _JOINTS},
    Registration: {"error": _over_rows(r"distance_m", "distance from the model")},
    Solution: {"error_by_joint": figures.error_by_joint},
    Comparison: {"parameters": figures.parameter_differences, "distances": figures.distance_between},
    Identification: {"deviations": figures.deviations},
    Plan: {"accuracy": figures.accuracy_by_count},
    DiscriminationPlan: {"distance": figures.accuracy_by_count},
    Sensitivity: {"by_joint": figures.sensitivity_by_joint, "workspace": figures.sensitivity_over_workspace},
}
"""The figures of each kind of result by name; a figure is None where the result lacks what it shows."""


def _draw(result: Any, title: str) -> Figures:
    default_title = type(result).__name__
    if isinstance(result, Recording):
        default_title = Path(result.source).name
    elif isinstance(result, Solution):
        default_title = result.arm.name if result.recording is None else Path(result.recording.source).name
    elif isinstance(result, Comparison):
        default_title = f"{len(result.names)} × {result.arm.name}"
        title = title and f"{title}: {default_title}"
    elif isinstance(result, Sensitivity):
        default_title = "Tolerances"
    elif isinstance(result, Identification | Plan | DiscriminationPlan):
        default_title = result.experiment.arm.name
    drawn = {name: figure(result, title or default_title) for name, figure in _FIGURES[type(result)].items()}
    return Figures({name: figure for name, figure in drawn.items() if figure is not None})


for kind in _FIGURES:
    draw.register(kind, _draw)


@draw.register
def _draw_diagnosis(diagnosis: DomainDiagnosis, title: str) -> Figures:
    return Figures(
        diagnosis_figures.drawings(diagnosis, title or Path(diagnosis.recording.source).name, diagnosis.to_dict())
    )


# ------------------------------------------------------------------ tables


tabulate.register(Compensation, compensation_columns)
for kind in (Recording, Prediction, TorquePrediction, TrackedMotion, CorrectedCommands):
    tabulate.register(kind, lambda result: result.columns())


@tabulate.register
def _parameter_table(result: Solution | Identification | Sensitivity) -> Columns:
    rows = document(result)["parameters"]
    return {name: [row[name] for row in rows] for name in rows[0]}


@tabulate.register
def _fleet_table(fleet: FleetSolution) -> Columns:
    chain = fleet.form.chain
    columns: Columns = {
        "arm": np.arange(1, len(fleet.result) + 1),
        "result": [Result(code).name.lower() for code in fleet.result],
        "steps": fleet.steps,
        "position_rms_m": fleet.position_rms,
        "orientation_rms_rad": fleet.orientation_rms,
    }
    for kind, table in (("", fleet.parameters), ("_std", fleet.standard_deviation)):
        columns |= {f"{n}{kind}_{u}": v for n, u, v in zip(chain.names, chain.units, table.T, strict=True)}
    return columns


@tabulate.register
def _comparison_table(comparison: Comparison) -> Columns:
    form = comparison.arm.form
    columns: Columns = {"arm": list(comparison.names), "from_nominal_max_m": comparison.from_nominal.max(1)}
    return columns | {f"{n}_{u}": v for n, u, v in zip(form.names, form.units, comparison.difference.T, strict=True)}


@tabulate.register
def _plan_table(plan: Plan | DiscriminationPlan) -> Columns:
    joints = plan.joint_position.T
    sliding = plan.experiment.arm.sliding
    columns: Columns = {f"q{j + 1}_{'m' if j in sliding else 'rad'}": values for j, values in enumerate(joints)}
    accuracy = {"position_std_m": plan.accuracy} if isinstance(plan, Plan) else {"distance": plan.distance}
    return columns | accuracy


@tabulate.register
def _registration_table(registration: Registration) -> Columns:
    columns: Columns = dict(zip(("dx_m", "dy_m", "dz_m"), registration.missed.T, strict=True))
    if registration.turned is not None:
        columns |= dict(zip(("drx_rad", "dry_rad", "drz_rad"), registration.turned.T, strict=True))
    return {
        **columns,
        "distance_m": registration.distance,
        "weight": registration.weight,
        "outlier": ~registration.kept,
    }


_PARAMETER = ("of", "finding", "effect", "site", "driver", "parameter", "value", "std", "p_value")


@tabulate.register
def _diagnosis_table(diagnosis: DomainDiagnosis) -> Columns:
    """A row for each parameter of each finding; findings are numbered from 1."""
    rows = [
        (part.domain, number, finding.effect.name, finding.effect.site, driver, name, *estimate, finding.p_value)
        for part in diagnosis.parts
        for number, finding in enumerate(part.findings, 1)
        for driver in (", ".join(effect_driver.phrase for effect_driver in finding.effect.drivers) or "none",)
        for name, estimate in finding.parameters.items()
    ]
    return {name: [row[k] for row in rows] for k, name in enumerate(_PARAMETER)}


# ------------------------------------------------------------------ files


@write.register
def _write(result: PublicResult, path: Path, overwrite: bool) -> Path:
    """A table, or the document of a class that has one."""
    _check_suffix(result, path, (*suffixes.WRITTEN_TABLES, *([".json"] if has_document(type(result)) else [])))
    if path.suffix.lower() == ".json":
        return write_atomically(path, text(document(result), None) + "\n", overwrite)
    columns = pa.table({name: pa.array(values) for name, values in tabulate(result).items()})
    return write_atomically(path, lambda target: write_table(columns, target), overwrite)


@write.register
def _write_recording(recording: Recording, path: Path, overwrite: bool) -> Path:
    return write_recording(recording, path, overwrite)  # with the sidecar that makes it one


@write.register
def _write_solution(solution: Solution, path: Path, overwrite: bool) -> Path:
    """As `lite6jax fit --out`: the effective table, which other commands read."""
    return (write_solution if path.suffix.lower() == ".json" else _write)(solution, path, overwrite)


@write.register
def _write_diagnosis(diagnosis: DomainDiagnosis, path: Path, overwrite: bool) -> Path:
    """As `lite6jax diagnose --out` and `--report` write them: what `read_model` reads, and a page."""
    suffix = path.suffix.lower()
    _check_suffix(diagnosis, path, (".json", ".html", *suffixes.WRITTEN_TABLES))
    if suffix in suffixes.WRITTEN_TABLES:
        return _write(diagnosis, path, overwrite)
    check_writable(path, overwrite)
    stated = statements.with_statements(diagnosis.to_dict())
    shown = document_text(stated) if suffix == ".json" else diagnosis_page(diagnosis, stated)
    return write_atomically(path, shown, overwrite)


def _check_suffix(result: object, path: Path, forms: Sequence[str]) -> None:
    if path.suffix.lower() not in forms:
        listed = ", ".join(forms[:-1]) + f" or {forms[-1]}"
        raise InputError(f"{path}: a {type(result).__name__} is saved as {listed}; let the name end so")
