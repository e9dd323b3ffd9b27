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
from lite6jax.calibration.solution import Errors, Solution, write_solution
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
from lite6jax.recordings import Recording, write_recording
from lite6jax.recordings.files import write_table
from lite6jax.report import diagnosis_figures, faults, figures, fits, ranking, statements, study, tracking
from lite6jax.report.compensations import (
    compensation_columns,
    corrected_sentences,
    outside_sentence,
    registration_report,
)
from lite6jax.report.documents import document, has_document, text
from lite6jax.report.faults import fault_name
from lite6jax.report.figures import AFTER, BEFORE, STYLE, dots, panels_in_rows, titled
from lite6jax.report.pages import diagnosis_page
from lite6jax.report.words import (
    SCREEN,
    be,
    counted,
    each_with_unit,
    fill,
    joint_units,
    number,
    read_texts,
    say,
    torque_units,
)
from lite6jax.results import Description, Figures, PublicResult
from lite6jax.storage import check_writable, write_atomically

Columns = dict[str, Any]


def _unregistered(what: str, result: Any, *_: object) -> Any:
    raise TypeError(f"{type(result).__name__} has no function of {what} in {__name__}; register one")


describe = singledispatch(partial(_unregistered, "describe"))
"""`describe(result) -> Description`."""
draw = singledispatch(partial(_unregistered, "draw"))
"""`draw(result, title) -> Figures`; the title begins that of each figure, and is the result's own where it is empty."""
tabulate = singledispatch(partial(_unregistered, "tabulate"))
"""`tabulate(result)`: by the name of a column with its unit, `(row,)` values."""
write = singledispatch(partial(_unregistered, "write"))
"""`write(result, path, overwrite) -> Path`, in the form that the suffix names; refuses others with an `InputError`."""


# ------------------------------------------------------------------ summaries


_TEXTS = read_texts("results.yaml")
_MOST_FINDINGS = 4


def _fill(name: str, found: Any, notes: Sequence[str] = (), **facts: object) -> Description:
    """The texts of a kind of result, filled with it and with these facts."""
    texts, facts = _TEXTS[name], {"found": found, "errors": _errors, **facts}
    return Description(fill(texts["title"], facts), tuple(say(texts["said"], facts)), tuple(notes))


def _errors(errors: Errors) -> str:
    turned = errors.orientation
    shown = "" if turned is None else f" and {number(float(np.rad2deg(np.sqrt(np.mean(turned**2)))), 3)} deg RMS"
    return f"{number(1e3 * errors.position_rms)} mm RMS{shown}"


def _outside(found: Prediction | TorquePrediction | TrackedMotion | Compensation) -> str:
    outside = found.outside
    return _TEXTS["unsaid"] if outside is None else outside_sentence(int(outside.sum()), len(outside), "row")


@describe.register
def _recording(found: Recording) -> Description:
    scales, units = joint_units(found.sliding, found.dof)
    span = scales * np.ptp(found.joint_position, axis=0)
    least, most = (f"{span[joint]:.0f} {units[joint]}" for joint in (np.argmin(span), np.argmax(span)))
    extent = [] if found.position is None else [f"{x:.3f}" for x in np.ptp(found.position, axis=0)]
    runs, measured = 1 + int(np.count_nonzero(np.diff(found.run))), fits.what_is_measured(found)
    return _fill("recording", found, found.notes, measured=measured, runs=runs, least=least, most=most, extent=extent)


@describe.register
def _solution(found: Solution) -> Description:
    return _fill(
        "solution",
        found,
        found.notes,
        data="calibration" if found.noise is None else "recording",
        noise=found.noise,
        quality=faults.quality_statement(found.quality.to_dict()),
        held=[each.name for each in found.held],
        unsure=[found.form.names[k] for k in np.flatnonzero(found.free & ~found.determined)],
    )


@describe.register
def _fleet(found: FleetSolution) -> Description:
    good = found.result == Result.CONVERGED
    position = found.position_rms[good]
    said = _fill("fleet", found, position=position, median=np.median(position) if len(position) else 0.0)
    failed = (
        f"For {counted(int((found.result == code).sum()), 'arm')} the fit {Result(code).message}."
        for code in sorted(set(found.result[~good].tolist()))
    )
    return said._replace(sentences=(*said.sentences, *failed))


def _as_shown(title: str, report: Iterable[RenderableType], *before: str) -> Description:
    """The sentences of a terminal's report, without its tables and headings; its notes apart."""
    said = [part for part in report if isinstance(part, str) and part.endswith(".")]
    notes = [line.removeprefix("Note: ") for line in said if line.startswith("Note: ")]
    return Description(title, (*before, *(line for line in said if not line.startswith("Note: "))), tuple(notes))


@describe.register
def _comparison(found: Comparison) -> Description:
    return _as_shown(
        f"Comparison of {len(found.names)} arms, {found.arm.name}", fits.comparison_report(found, width=80)
    )


@describe.register
def _sensitivity(found: Sensitivity) -> Description:
    return _as_shown("Sensitivity of the flange to the tolerances", study.sensitivity_report(found, ""))


@describe.register
def _registration(found: Registration) -> Description:
    return _as_shown("Registration of sensor and tool", registration_report(found))


@describe.register
def _identification(found: Identification) -> Description:
    name = found.experiment.arm.name
    return _as_shown(f"Identifiability, {name}", study.identification_report(found, name, drawn=False))


@describe.register
def _plan(found: Plan | DiscriminationPlan) -> Description:
    chosen = f"{counted(found.count, 'pose')} of {counted(found.candidates, 'candidate')} {be(found.count)} chosen."
    report = study.plan_report(found) if isinstance(found, Plan) else study.discrimination_report(found)
    return _as_shown(f"Poses to record, {found.experiment.arm.name}", report, chosen)


@describe.register
def _prediction(found: Prediction) -> Description:
    std = np.zeros(1) if found.position_std is None else np.sqrt(np.nansum(found.position_std**2, 1))
    facts = {"empty": int(found.empty.sum()), "median": np.median(std), "most": std.max()}
    return _fill("prediction", found, outside=_outside(found), **facts)


@describe.register
def _torque_prediction(found: TorquePrediction) -> Description:
    units = torque_units(found.sliding, found.torque.shape[1])
    largest = each_with_unit(np.nanmax(np.abs(found.torque), 0).tolist(), units)
    std = None if found.std is None else each_with_unit(np.nanmedian(found.std, 0).tolist(), units)
    return _fill("torques", found, largest=largest, deviations=std, outside=_outside(found))


@describe.register
def _tracked_motion(found: TrackedMotion) -> Description:
    rows, joints = found.position.shape
    said = f"Joints {', '.join(map(str, range(1, joints + 1)))} in {counted(rows, 'row')}, rolled out from commands."
    return Description("Predicted joints", (said, _outside(found)))


@describe.register
def _corrected_commands(found: CorrectedCommands) -> Description:
    return Description("Corrected commands", tuple(corrected_sentences(found)))


@describe.register
def _compensation(found: Compensation) -> Description:
    hit, largest = int(found.reached.sum()), ""
    most = float(np.nanmax(found.position_error[found.reached])) if hit else 0.0
    if found.correction is not None:
        scales, units = joint_units(found.recording.sliding, found.correction.shape[1])
        largest = each_with_unit((scales * np.nanmax(np.abs(found.correction), 0)).tolist(), units)
    return _fill("compensation", found, found.notes, hit=hit, most=most, largest=largest, outside=_outside(found))


@describe.register
def _tracking_diagnosis(found: TrackingDiagnosis) -> Description:
    document = found.to_dict()
    said = [tracking.headline(document), tracking.verdict_statement(document), *tracking.cautions(document)]
    said += [tracking.finding_statement(finding) for finding in tracking.ranked(document)[:_MOST_FINDINGS]]
    title = f"Diagnosis of how a {document['model']['arm']} follows its commands"
    return Description(title, tuple(said), tuple(tracking.what_to_record(document)))


@describe.register
def _diagnosis(found: DomainDiagnosis) -> Description:
    document = found.to_dict()
    findings = statements.findings_of(document)
    hidden, stages = len(findings) - _MOST_FINDINGS, (document["before"], document["after"])
    if found.domain == "torques":
        start, units = "torque errors of the joints are", ranking.units(document)
        sizes = [each_with_unit(stage["heldout_torque_rms_by_joint_Nm"], units) for stage in stages]
    else:
        start = "position error is"
        sizes = [f"{number(1e3 * stage['heldout_position_rms_m'])} mm" for stage in stages]
    left = f"{sizes[1]} RMS with these effects and " if findings else ""
    faults = [fault_name(entry["fault"]).lower() for entry in document["data_faults"]]
    notes = [*statements.say_about(document, "assumptions"), *statements.what_to_record(document)]
    what, beside = "the torques of " if found.domain == "torques" else "", []
    for part in found.parts[1:]:
        what, other = "the poses and torques of ", describe(part)
        beside = [*other.sentences, *map(statements.agreement_statement, document["shared"])]
        notes += other.notes
    said = [ranking.headline(document), statements.verdict_statement(document), *statements.cautions(document)]
    said += [finding["statement"] for finding in findings[:_MOST_FINDINGS]]
    said += [f"{counted(hidden, 'more finding')} {be(hidden)} in `findings`."] if hidden > 0 else []
    said += [f"The held-out {start} {left}{sizes[0]} RMS with the model of the arm alone."]
    said += [f"The data have {counted(len(faults), 'fault')}: {', '.join(faults)}."] if faults else []
    said += statements.say_about(document, "refusal") if "torques_refused" in document else []
    return Description(f"Diagnosis of {what}a {document['model']['arm']}", (*said, *beside), tuple(notes))


# ------------------------------------------------------------------ figures


_MARKED = {"outside": "outside what was recorded", "outlier": "outlier"}
"""Columns that are not zero in rows that have another colour, and what these are."""


def _over_rows(matching: str, what: str) -> Callable[[PublicResult, str], Figure | None]:
    """How the columns of a table that match an expression are drawn, a panel each, in mm and deg, if there are any."""

    @rc_context(STYLE)
    def drawn(found: PublicResult, title: str) -> Figure | None:
        table = tabulate(found)
        columns = [column for column in table if re.fullmatch(matching, column)]
        if not columns:
            return None
        row = found.row if isinstance(found, Recording) else np.arange(1, len(table[columns[0]]) + 1)
        marked = next((name for name in _MARKED if name in table), "")
        other = np.asarray(table.get(marked, np.zeros(len(row)))) > 0
        figure, axes = panels_in_rows(len(columns), wide=len(columns) == 1)
        for axis, column in zip(axes, columns, strict=True):
            of, _, unit = column.rpartition("_")
            scale, shown = SCREEN.get(unit, (1.0, unit))
            for rows, color in ((~other, AFTER), (other, BEFORE)):
                dots(axis, row[rows].astype(float), scale * np.asarray(table[column])[rows], color)
            across = "arm" if isinstance(found, FleetSolution) else "row"
            axis.set(xlabel=across, ylabel=f"{of.replace('_', ' ')} ({shown})")
            axis.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        if other.any():
            axes[0].plot([], [], "o", color=BEFORE, label=_MARKED[marked])
            figure.legend(loc="outside lower center", frameon=False)
        return titled(figure, f"{title}: {what}")

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


def _draw(found: Any, title: str) -> Figures:
    own = type(found).__name__
    if isinstance(found, Recording):
        own = Path(found.source).name
    elif isinstance(found, Solution):
        own = found.arm.name if found.recording is None else Path(found.recording.source).name
    elif isinstance(found, Comparison):
        own = f"{len(found.names)} × {found.arm.name}"
        title = title and f"{title}: {own}"
    elif isinstance(found, Sensitivity):
        own = "Tolerances"
    elif isinstance(found, Identification | Plan | DiscriminationPlan):
        own = found.experiment.arm.name
    drawn = {name: figure(found, title or own) for name, figure in _FIGURES[type(found)].items()}
    return Figures({name: figure for name, figure in drawn.items() if figure is not None})


for kind in _FIGURES:
    draw.register(kind, _draw)


@draw.register
def _draw_diagnosis(found: DomainDiagnosis, title: str) -> Figures:
    return Figures(diagnosis_figures.drawings(found, title or Path(found.recording.source).name, found.to_dict()))


# ------------------------------------------------------------------ tables


tabulate.register(Compensation, compensation_columns)
for kind in (Recording, Prediction, TorquePrediction, TrackedMotion, CorrectedCommands):
    tabulate.register(kind, lambda found: found.columns())


@tabulate.register
def _parameter_table(found: Solution | Identification | Sensitivity) -> Columns:
    rows = document(found)["parameters"]
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
def _comparison_table(found: Comparison) -> Columns:
    form = found.arm.form
    columns: Columns = {"arm": list(found.names), "from_nominal_max_m": found.from_nominal.max(1)}
    return columns | {f"{n}_{u}": v for n, u, v in zip(form.names, form.units, found.difference.T, strict=True)}


@tabulate.register
def _plan_table(found: Plan | DiscriminationPlan) -> Columns:
    joints, sliding = found.joint_position.T, found.experiment.arm.sliding
    columns: Columns = {f"q{j + 1}_{'m' if j in sliding else 'rad'}": values for j, values in enumerate(joints)}
    accuracy = {"position_std_m": found.accuracy} if isinstance(found, Plan) else {"distance": found.distance}
    return columns | accuracy


@tabulate.register
def _registration_table(found: Registration) -> Columns:
    columns: Columns = dict(zip(("dx_m", "dy_m", "dz_m"), found.missed.T, strict=True))
    if found.turned is not None:
        columns |= dict(zip(("drx_rad", "dry_rad", "drz_rad"), found.turned.T, strict=True))
    return {**columns, "distance_m": found.distance, "weight": found.weight, "outlier": ~found.kept}


_PARAMETER = ("of", "finding", "effect", "site", "driver", "parameter", "value", "std", "p_value")


@tabulate.register
def _diagnosis_table(found: DomainDiagnosis) -> Columns:
    """A row for each parameter of each finding; findings are numbered from 1."""
    rows = [
        (part.domain, number, finding.effect.name, finding.effect.site, driver, name, *estimate, finding.p_value)
        for part in found.parts
        for number, finding in enumerate(part.findings, 1)
        for driver in (", ".join(each.phrase for each in finding.effect.drivers) or "none",)
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
def _write_diagnosis(found: DomainDiagnosis, path: Path, overwrite: bool) -> Path:
    """As `lite6jax diagnose --out` and `--report` write them: what `read_model` reads, and a page."""
    suffix = path.suffix.lower()
    _check_suffix(found, path, (".json", ".html", *suffixes.WRITTEN_TABLES))
    if suffix in suffixes.WRITTEN_TABLES:
        return _write(found, path, overwrite)
    check_writable(path, overwrite)
    stated = statements.with_statements(found.to_dict())
    shown = document_text(stated) if suffix == ".json" else diagnosis_page(found, stated)
    return write_atomically(path, shown, overwrite)


def _check_suffix(result: object, path: Path, forms: Sequence[str]) -> None:
    if path.suffix.lower() not in forms:
        named = ", ".join(forms[:-1]) + f" or {forms[-1]}"
        raise InputError(f"{path}: a {type(result).__name__} is saved as {named}; let the name end so")
