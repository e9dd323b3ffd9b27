"""What each kind of public result can do: its figures, its table and its files, a function each.

To add a kind, let its class inherit `lite6jax.results.PublicResult`, and register a function with `draw` and with
`tabulate` here and with `describe` in `summaries`. A result is saved as JSON where `documents` has a document of its
class, as a table, and a diagnosis as a page; a class whose file is another one registers a function with `write`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lite6jax.calibration.fleet import Comparison, FleetSolution
from lite6jax.calibration.quality import Result
from lite6jax.calibration.solution import Solution, write_solution
from lite6jax.design.identify import Identification
from lite6jax.design.poses import DiscriminationPlan, Plan
from lite6jax.design.sensitivity import Sensitivity
from lite6jax.diagnosis.combined import CombinedDiagnosis
from lite6jax.diagnosis.document import document_text
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.domains.pose.compensate import Compensation
from lite6jax.domains.pose.predict import Prediction, prediction_columns
from lite6jax.domains.pose.registration import Registration
from lite6jax.domains.torque.predict import TorquePrediction, torque_columns
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, write_recording
from lite6jax.recordings.files import write_table
from lite6jax.report import diagnosis_figures, figures
from lite6jax.report.canvas import AFTER, BEFORE, STYLE, dots, panels_in_rows, titled
from lite6jax.report.compensation import compensation_columns
from lite6jax.report.diagnosis_figures import PREFIX, ranking_figure
from lite6jax.report.documents import document, text
from lite6jax.report.pages import page_text
from lite6jax.report.statements import with_statements
from lite6jax.report.words import joint_units, torque_units
from lite6jax.results import Figures, PublicResult, draw, tabulate, write
from lite6jax.storage import check_writable, write_atomically

Array = NDArray[np.floating]
Columns = dict[str, Any]

# ------------------------------------------------------------------ figures


class Panel(NamedTuple):
    """A quantity over the rows of a table: its name with unit, and `(row,)` values in that unit."""

    label: str
    values: Array


@draw.register
def _recording(recording: Recording, title: str) -> Figures:
    title = title or Path(recording.source).name
    joints = _of_joints("joint", recording.joint_position, *joint_units(recording.sliding, recording.dof))
    drawn = {"joints": over_rows(joints, recording.row, f"{title}: joint positions")}
    if recording.position is not None:
        axes = [Panel(f"{axis} (mm)", 1e3 * values) for axis, values in zip("xyz", recording.position.T, strict=True)]
        drawn["positions"] = over_rows(axes, recording.row, f"{title}: measured positions")
    return Figures(drawn)


@draw.register
def _solution(solution: Solution, title: str) -> Figures:
    recording = solution.recording
    title = title or (solution.arm.name if recording is None else Path(recording.source).name)
    return Figures({"error_by_joint": figures.error_by_joint(solution, title)})


@draw.register
def _fleet(fleet: FleetSolution, title: str) -> Figures:
    arms = np.arange(1, len(fleet.result) + 1)
    panels = [
        Panel("position error (mm RMS)", 1e3 * fleet.position_rms),
        Panel("orientation error (deg RMS)", np.rad2deg(fleet.orientation_rms)),
    ]
    return Figures({"errors": over_rows(panels, arms, title or "Fits of a fleet", across="arm")})


@draw.register
def _comparison(found: Comparison, title: str) -> Figures:
    drawn = {"parameters": figures.parameter_differences(found), "distances": figures.distance_between(found)}
    for figure in drawn.values():
        if title:
            figure.suptitle(f"{title}: {figure.get_suptitle()}", fontsize=15)
    return Figures(drawn)


@draw.register
def _identification(found: Identification, title: str) -> Figures:
    title = title or found.experiment.arm.name
    return Figures({"deviations": figures.deviations(found, title)})


@draw.register(Plan)
@draw.register(DiscriminationPlan)
def _plan(found: Plan | DiscriminationPlan, title: str) -> Figures:
    name = "accuracy" if isinstance(found, Plan) else "distance"
    return Figures({name: figures.accuracy_by_count(found, title or found.experiment.arm.name)})


@draw.register
def _sensitivity(found: Sensitivity, title: str) -> Figures:
    title = title or "Tolerances"
    over = {
        "by_joint": figures.sensitivity_by_joint(found, title),
        "workspace": figures.sensitivity_over_workspace(found, title),
    }
    return Figures(over)


@draw.register
def _prediction(found: Prediction, title: str) -> Figures:
    title, row = title or "Prediction", np.arange(1, len(found.poses) + 1)
    positions = zip("xyz", found.poses[:, :3, 3].T, strict=True)
    panels = [Panel(f"{axis} (mm)", 1e3 * values) for axis, values in positions]
    drawn = {"positions": over_rows(panels, row, f"{title}: positions", found.outside)}
    if found.position_std is not None:
        std = [Panel("std. deviation (mm)", 1e3 * np.linalg.norm(found.position_std, axis=1))]
        drawn["std"] = over_rows(std, row, f"{title}: standard deviation of a position", found.outside)
    return Figures(drawn)


@draw.register
def _torque_prediction(found: TorquePrediction, title: str) -> Figures:
    row, joints = np.arange(1, len(found.torque) + 1), found.torque.shape[1]
    panels = _of_joints("motor", found.torque, np.ones(joints), torque_units(found.sliding, joints))
    return Figures({"torques": over_rows(panels, row, title or "Predicted torques", found.outside)})


@draw.register
def _compensation(found: Compensation, title: str) -> Figures:
    title, row = title or "Compensation", found.recording.row
    error = [Panel("distance from the target (mm)", 1e3 * found.position_error)]
    drawn = {"error": over_rows(error, row, f"{title}: what is reached", ~found.reached, "not reached")}
    if found.correction is not None:
        units = joint_units(found.recording.sliding, found.correction.shape[1])
        panels = _of_joints("joint", found.correction, *units)
        drawn["correction"] = over_rows(panels, row, f"{title}: from the joints given", ~found.reached, "not reached")
    return Figures(drawn)


@draw.register
def _registration(found: Registration, title: str) -> Figures:
    row = np.arange(1, len(found.weight) + 1)
    distance = [Panel("position error (mm)", 1e3 * found.distance)]
    title = title or "Registration"
    return Figures({"error": over_rows(distance, row, f"{title}: distance from the model", ~found.kept, "outlier")})


@draw.register(Diagnosis)
@draw.register(TorqueDiagnosis)
def _diagnosis(found: Diagnosis | TorqueDiagnosis, title: str) -> Figures:
    data = found.problem.data if isinstance(found, TorqueDiagnosis) else found.problem
    title, document = title or Path(data.recording.source).name, found.to_dict()
    ranked = {"ranking": ranking_figure(document, title)} if document["findings"] else {}
    return Figures({**ranked, **dict(diagnosis_figures.drawings(found, title, document))})


@draw.register
def _combined(found: CombinedDiagnosis, title: str) -> Figures:
    torques = {} if found.torques is None else draw(found.torques, title)
    return Figures({**draw(found.poses, title), **{PREFIX + name: figure for name, figure in torques.items()}})


def _of_joints(what: str, values: Array, scales: Array, units: Sequence[str]) -> list[Panel]:
    """A panel of each joint, of `(row, joint)` values that `scales` carries to `units`."""
    return [Panel(f"{what} {j + 1} ({unit})", scales[j] * values[:, j]) for j, unit in enumerate(units)]


@rc_context(STYLE)
def over_rows(
    panels: Sequence[Panel],
    row: NDArray[np.integer],
    title: str,
    marked: NDArray[np.bool_] | None = None,
    mark: str = "outside what was recorded",
    across: str = "row",
) -> Figure:
    """Quantities against the row, a panel each.

    Args:
        panels: at least one.
        row: `(row,)` numbers of the rows.
        title: of the figure.
        marked: `(row,)`, rows in another colour; None for none.
        mark: what is true of these.
        across: what a row is of.
    """
    other = np.zeros(len(row), bool) if marked is None else marked
    figure, axes = panels_in_rows(len(panels), wide=len(panels) == 1)
    for axis, panel in zip(axes, panels, strict=True):
        for rows, color in ((~other, AFTER), (other, BEFORE)):
            dots(axis, row[rows].astype(float), panel.values[rows], color)
        axis.set(xlabel=across, ylabel=panel.label)
        axis.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    if other.any():
        axes[0].plot([], [], "o", color=BEFORE, label=mark)
        figure.legend(loc="outside lower center", frameon=False)
    return titled(figure, title)


# ------------------------------------------------------------------ tables


tabulate.register(Recording, lambda found: found.columns())
tabulate.register(TorquePrediction, torque_columns)
tabulate.register(Compensation, compensation_columns)


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
def _prediction_table(found: Prediction) -> Columns:
    return dict(prediction_columns(found, orientation=found.orientation_std is not None))


@tabulate.register
def _registration_table(found: Registration) -> Columns:
    columns: Columns = dict(zip(("dx_m", "dy_m", "dz_m"), found.missed.T, strict=True))
    if found.turned is not None:
        columns |= dict(zip(("drx_rad", "dry_rad", "drz_rad"), found.turned.T, strict=True))
    return {**columns, "distance_m": found.distance, "weight": found.weight, "outlier": ~found.kept}


_PARAMETER = ("of", "finding", "effect", "site", "driver", "parameter", "value", "std", "p_value")


@tabulate.register(Diagnosis)
@tabulate.register(TorqueDiagnosis)
@tabulate.register(CombinedDiagnosis)
def _diagnosis_table(found: Diagnosis | TorqueDiagnosis | CombinedDiagnosis) -> Columns:
    """A row for each parameter of each finding; findings are numbered from 1."""
    parts = (found.poses, found.torques) if isinstance(found, CombinedDiagnosis) else (found,)
    rows = [
        (of, number, finding.effect.name, finding.effect.site, driver, name, *estimate, finding.p_value)
        for part in parts
        if part is not None
        for of in ("torques" if isinstance(part, TorqueDiagnosis) else "poses",)
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
    if document.dispatch(type(result)) is not document.dispatch(object):
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


@write.register(Diagnosis)
@write.register(TorqueDiagnosis)
@write.register(CombinedDiagnosis)
def _saved_diagnosis(found: Any, path: Path, overwrite: bool) -> Path:
    """As `lite6jax diagnose --out` and `--report` write them: what `read_model` reads, and a page."""
    suffix = path.suffix.lower()
    _check_suffix(found, path, (".json", ".html", *_TABLES))
    if suffix in _TABLES:
        return _saved(found, path, overwrite)
    check_writable(path, overwrite)
    stated = with_statements(found.to_dict())
    if suffix == ".json":
        return write_atomically(path, document_text(stated), overwrite)
    return write_atomically(path, page_text(found, stated), overwrite)


def _check_suffix(result: object, path: Path, forms: Sequence[str]) -> None:
    if path.suffix.lower() not in forms:
        named = ", ".join(forms[:-1]) + f" or {forms[-1]}"
        raise InputError(f"{path}: a {type(result).__name__} is saved as {named}; let the name end so")
