"""What each kind of public result can do: its figures, its table and its files, a function each.

To add a kind, let its class inherit `lite6jax.results.PublicResult`, and register a function with `draw` and with
`tabulate` here and with `describe` in `summaries`. A result is saved as JSON where `documents` has a document of its
class, as a table, and a diagnosis as a page; a class whose file is another one registers a function with `write`.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib import rc_context
from matplotlib.ticker import MaxNLocator

from lite6jax.calibration.fleet import Comparison, FleetSolution
from lite6jax.calibration.quality import Result
from lite6jax.calibration.solution import Solution, write_solution
from lite6jax.design.identify import Identification, Sensitivity
from lite6jax.design.poses import DiscriminationPlan, Plan
from lite6jax.diagnosis.document import document_text
from lite6jax.diagnosis.result import DomainDiagnosis
from lite6jax.domains.pose.compensate import Compensation
from lite6jax.domains.pose.predict import Prediction
from lite6jax.domains.pose.registration import Registration
from lite6jax.domains.torque.predict import TorquePrediction
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, write_recording
from lite6jax.recordings.files import write_table
from lite6jax.report import diagnosis_figures, figures
from lite6jax.report.compensation import compensation_columns
from lite6jax.report.documents import document, has_document, text
from lite6jax.report.figures import AFTER, BEFORE, STYLE, dots, panels_in_rows, titled
from lite6jax.report.pages import diagnosis_page
from lite6jax.report.statements import with_statements
from lite6jax.report.words import SCREEN
from lite6jax.results import Figures, PublicResult, draw, tabulate, write
from lite6jax.storage import check_writable, write_atomically

Columns = dict[str, Any]

# ------------------------------------------------------------------ figures


_DRAWINGS: dict[type, dict[str, tuple[str, str]]] = {
    Recording: {
        "joints": (r"q\d+_(rad|m)", "joint positions"),
        "positions": (r"[xyz]_m", "measured positions"),
    },
    FleetSolution: {"errors": (r"(position|orientation)_rms_(m|rad)", "errors of the fits")},
    Prediction: {
        "positions": (r"[xyz]_m", "predicted positions"),
        "std": (r"[xyz]_std_m", "standard deviation of a position"),
    },
    TorquePrediction: {"torques": (r"tau\d+_Nm?", "predicted torques")},
    Compensation: {
        "error": (r"position_error_mm", "distance from the target"),
        "joints": (r"q\d+_(rad|m)", "joint positions"),
    },
    Registration: {"error": (r"distance_m", "distance from the model")},
}
"""Of results that are tables of rows, the figures by name: an expression that matches their columns, and a title."""
_MARKED = {"outside": "outside what was recorded", "outlier": "outlier"}
"""Columns that are not zero in rows that have another colour, and what these are."""


@rc_context(STYLE)
def _draw_rows(found: PublicResult, title: str) -> Figures:
    """Columns of the table, a panel each, in mm and deg."""
    table, drawn = tabulate(found), {}
    across = "arm" if isinstance(found, FleetSolution) else "row"
    row = np.asarray(found.row) if isinstance(found, Recording) else np.arange(1, len(next(iter(table.values()))) + 1)
    source = Path(found.source).name if isinstance(found, Recording) else type(found).__name__
    marked = next((name for name in _MARKED if name in table), "")
    other = np.asarray(table.get(marked, np.zeros(len(row)))) > 0
    for name, (matching, what) in _DRAWINGS[type(found)].items():
        columns = [column for column in table if re.fullmatch(matching, column)]
        if not columns:
            continue
        figure, axes = panels_in_rows(len(columns), wide=len(columns) == 1)
        for axis, column in zip(axes, columns, strict=True):
            of, _, unit = column.rpartition("_")
            scale, shown = SCREEN.get(unit, (1.0, unit))
            for rows, color in ((~other, AFTER), (other, BEFORE)):
                dots(axis, row[rows].astype(float), scale * np.asarray(table[column])[rows], color)
            axis.set(xlabel=across, ylabel=f"{of.replace('_', ' ')} ({shown})")
            axis.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        if other.any():
            axes[0].plot([], [], "o", color=BEFORE, label=_MARKED[marked])
            figure.legend(loc="outside lower center", frameon=False)
        drawn[name] = titled(figure, f"{title or source}: {what}")
    return Figures(drawn)


for kind in _DRAWINGS:
    draw.register(kind, _draw_rows)


@draw.register
def _solution(solution: Solution, title: str) -> Figures:
    recording = solution.recording
    title = title or (solution.arm.name if recording is None else Path(recording.source).name)
    return Figures({"error_by_joint": figures.error_by_joint(solution, title)})


@draw.register
def _comparison(found: Comparison, title: str) -> Figures:
    drawn = {"parameters": figures.parameter_differences(found), "distances": figures.distance_between(found)}
    for figure in drawn.values():
        if title:
            figure.suptitle(f"{title}: {figure.get_suptitle()}", fontsize=15)
    return Figures(drawn)


@draw.register(Identification)
@draw.register(Plan)
@draw.register(DiscriminationPlan)
def _study(found: Identification | Plan | DiscriminationPlan, title: str) -> Figures:
    title = title or found.experiment.arm.name
    if isinstance(found, Identification):
        return Figures({"deviations": figures.deviations(found, title)})
    name = "accuracy" if isinstance(found, Plan) else "distance"
    return Figures({name: figures.accuracy_by_count(found, title)})


@draw.register
def _sensitivity(found: Sensitivity, title: str) -> Figures:
    title = title or "Tolerances"
    over = figures.sensitivity_over_workspace(found, title)
    return Figures({"by_joint": figures.sensitivity_by_joint(found, title), "workspace": over})


@draw.register
def _diagnosis(found: DomainDiagnosis, title: str) -> Figures:
    title = title or Path(found.recording.source).name
    return Figures(diagnosis_figures.drawings(found, title, found.to_dict()))


# ------------------------------------------------------------------ tables


tabulate.register(Compensation, compensation_columns)
for kind in (Recording, Prediction, TorquePrediction):
    tabulate.register(kind, lambda found: found.columns())


@tabulate.register(Solution)
@tabulate.register(Identification)
@tabulate.register(Sensitivity)
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


@tabulate.register(Plan)
@tabulate.register(DiscriminationPlan)
def _design_table(found: Plan | DiscriminationPlan) -> Columns:
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


_TABLES = (".csv", ".parquet")


@write.register
def _saved(result: PublicResult, path: Path, overwrite: bool) -> Path:
    """A table, or the document of a class that has one."""
    suffix, forms = path.suffix.lower(), [str(form) for form in _TABLES]
    if has_document(type(result)):
        forms.append(".json")
    _check_suffix(result, path, forms)
    if suffix == ".json":
        return write_atomically(path, text(document(result), None) + "\n", overwrite)
    columns = pa.table({name: pa.array(values) for name, values in tabulate(result).items()})
    return write_atomically(path, lambda target: write_table(columns, target), overwrite)


@write.register
def _saved_recording(recording: Recording, path: Path, overwrite: bool) -> Path:
    return write_recording(recording, path, overwrite)  # with the sidecar that makes it one


@write.register
def _saved_solution(solution: Solution, path: Path, overwrite: bool) -> Path:
    """As `lite6jax fit --out`: the effective table, which other commands read."""
    return (write_solution if path.suffix.lower() == ".json" else _saved)(solution, path, overwrite)


@write.register
def _saved_diagnosis(found: DomainDiagnosis, path: Path, overwrite: bool) -> Path:
    """As `lite6jax diagnose --out` and `--report` write them: what `read_model` reads, and a page."""
    suffix = path.suffix.lower()
    _check_suffix(found, path, (".json", ".html", *_TABLES))
    if suffix in _TABLES:
        return _saved(found, path, overwrite)
    check_writable(path, overwrite)
    stated = with_statements(found.to_dict())
    if suffix == ".json":
        return write_atomically(path, document_text(stated), overwrite)
    return write_atomically(path, diagnosis_page(found, stated), overwrite)


def _check_suffix(result: object, path: Path, forms: Sequence[str]) -> None:
    if path.suffix.lower() not in forms:
        named = ", ".join(forms[:-1]) + f" or {forms[-1]}"
        raise InputError(f"{path}: a {type(result).__name__} is saved as {named}; let the name end so")
