"""`plot()` of each kind of result: its figures by name, one function each.

To add a kind, let its class inherit `lite6jax.results.PublicResult` and register a function with `draw` here.
"""

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lite6jax.design.identify import Identification
from lite6jax.design.poses import DiscriminationPlan, Plan
from lite6jax.design.sensitivity import GlobalSensitivity, Sensitivity
from lite6jax.diagnosis.combined import CombinedDiagnosis
from lite6jax.diagnosis.document import to_document
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.domains.pose.compensate import Compensation
from lite6jax.domains.pose.predict import Prediction
from lite6jax.domains.pose.registration import Registration
from lite6jax.domains.torque.predict import TorquePrediction
from lite6jax.fitting.fleet import Comparison, FleetSolution
from lite6jax.fitting.solution import Solution
from lite6jax.recordings import Recording
from lite6jax.report import (
    diagnosis_figures,
    figures,
    statements,
    study_figures,
    torque_figures,
    torque_statements,
    worth,
)
from lite6jax.report.canvas import AFTER, BEFORE, STYLE, blank
from lite6jax.report.cells import joint_units, torque_units
from lite6jax.report.combined import PREFIX
from lite6jax.report.panels import dots, panels_in_rows
from lite6jax.results import Figures, draw

Array = NDArray[np.floating]
_Found = TypeVar("_Found")
_MOST_BARS = 12
_MOST = 20
"""Findings that are drawn."""


class Panel(NamedTuple):
    """A quantity over the rows of a table.

    Attributes:
        label: its name and unit.
        values: `(row,)` in that unit.
    """

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
    drawn = {"error_by_joint": figures.error_by_joint(solution, title)}
    if recording is not None:
        drawn["error_distribution"] = figures.error_distribution(solution, recording, title)
    return Figures(drawn)


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
    named = ("singular_values", "correlation", "deviations")
    return Figures({name: getattr(study_figures, name)(found, title) for name in named})


@draw.register
def _plan(found: Plan, title: str) -> Figures:
    return Figures({"accuracy": study_figures.accuracy_by_count(found, title or found.experiment.arm.name)})


@draw.register
def _discrimination(found: DiscriminationPlan, title: str) -> Figures:
    return Figures({"distance": study_figures.accuracy_by_count(found, title or found.experiment.arm.name)})


@draw.register
def _sensitivity(found: Sensitivity, title: str) -> Figures:
    title = title or "Tolerances"
    named = {"by_joint": study_figures.sensitivity_by_joint, "workspace": study_figures.sensitivity_over_workspace}
    return Figures({name: drawn(found, title) for name, drawn in named.items()})


@draw.register
def _global_sensitivity(found: GlobalSensitivity, title: str) -> Figures:
    order = np.argsort(-found.total, kind="stable")[:_MOST_BARS][::-1]
    at = np.arange(len(order))
    with rc_context(STYLE):
        figure = blank(9.0, 1.2 + 0.42 * len(order))
        panel = figure.subplots()
        for part, half, label, color, up in (
            (found.total, found.total_interval, "with others", AFTER, 0.2),
            (found.first, found.first_interval, "alone", BEFORE, -0.2),
        ):
            panel.barh(at + up, part[order], 0.38, xerr=half[order], color=color, label=label, error_kw={"capsize": 2})
        panel.set_yticks(at, [found.names[i] for i in order])
        panel.set(xlabel="share of the variance of the error over arms")
        panel.legend(frameon=False, loc="lower right")
        figure.suptitle(f"{title or 'Tolerances'}: Sobol's indices", fontsize=15)
    return Figures({"indices": figure})


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


@draw.register
def _diagnosis(found: Diagnosis, title: str) -> Figures:
    title = title or Path(found.problem.recording.source).name
    return _drawn(found, to_document(found), diagnosis_figures.drawings, title)


@draw.register
def _torque_diagnosis(found: TorqueDiagnosis, title: str) -> Figures:
    title = title or Path(found.problem.data.recording.source).name
    return _drawn(found, to_document(found), torque_figures.drawings, title)


@draw.register
def _combined(found: CombinedDiagnosis, title: str) -> Figures:
    torques = {} if found.torques is None else draw(found.torques, title)
    named = {PREFIX + name: figure for name, figure in torques.items()}
    return Figures({**draw(found.poses, title), **named})


def _drawn(
    found: _Found,
    document: Mapping[str, Any],
    drawings: Callable[[_Found, str, Sequence[int]], Iterable[tuple[str, Figure]]],
    title: str,
) -> Figures:
    ranking = {"ranking": ranking_figure(document, title)} if document["findings"] else {}
    return Figures({**ranking, **dict(drawings(found, title, worth.order(document)))})


def _of_joints(what: str, values: Array, scales: Array, units: Sequence[str]) -> list[Panel]:
    """A panel of each joint, of `(row, joint)` values that `scales` carries to `units`."""
    return [Panel(f"{what} {j + 1} ({unit})", scales[j] * values[:, j]) for j, unit in enumerate(units)]


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
    with rc_context(STYLE):
        figure, axes = panels_in_rows(len(panels), wide=len(panels) == 1)
        for axis, panel in zip(axes, panels, strict=True):
            for rows, color in ((~other, AFTER), (other, BEFORE)):
                dots(axis, row[rows].astype(float), panel.values[rows], color)
            axis.set(xlabel=across, ylabel=panel.label)
            axis.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        if other.any():
            axes[0].plot([], [], "o", color=BEFORE, label=mark)
            figure.legend(loc="outside lower center", frameon=False)
        figure.suptitle(title, fontsize=15)
    return figure


def ranking_figure(document: Mapping[str, Any], title: str) -> Figure:
    """What each finding moves, beside the error before and after.

    Args:
        document: of poses or of torques, with findings.
        title: of the figure.
    """
    measures, named = worth.measures_of(document), torque_statements if worth.of_torques(document) else statements
    findings, shown = named.findings_of(document)[:_MOST], worth.bars(document)[:_MOST]
    if len(measures) == 1:
        sizes = [measures[0].scale * finding[measures[0].moves] for finding in findings]
        label = f"moves {measures[0].what} ({measures[0].unit} RMS)"
    else:
        sizes = [bar.share for bar in shown]
        label = f"moves {' or '.join(measure.what for measure in measures)} (RMS over the error before, largest: 1)"
    names = [f"{k}. {textwrap.fill(finding['title'], 44)}" for k, finding in enumerate(findings, 1)]
    with rc_context(STYLE):
        figure = blank(9.0, 1.7 + 0.42 * len(findings))
        panel = figure.subplots()
        bars = panel.barh(range(len(findings)), sizes, color=AFTER, zorder=3)
        panel.bar_label(bars, [bar.size for bar in shown], padding=4)
        panel.set_yticks(range(len(findings)), names)
        panel.invert_yaxis()
        panel.set_xlim(0, 1.15 * max(sizes) or 1.0)
        panel.set_xlabel(label)
        panel.grid(visible=False, axis="y")
        figure.suptitle(f"{title}: what each finding moves", fontsize=15)
    return figure
