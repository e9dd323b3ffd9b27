"""`plot()` of each kind of diagnosis: its figures by name. `lite6jax.summary.Plotted` loads this module by its name."""

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any, TypeVar

from matplotlib import rc_context
from matplotlib.figure import Figure

from lite6jax.diagnosis.combined import CombinedDiagnosis
from lite6jax.diagnosis.document import to_document
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_document import to_torque_document
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.report import diagnosis_figures, statements, torque_figures, torque_statements, worth
from lite6jax.report.canvas import AFTER, STYLE, blank
from lite6jax.report.combined import PREFIX
from lite6jax.summary import Figures

_Found = TypeVar("_Found")
_MOST = 20
"""Findings that are drawn."""


@singledispatch
def plotted(result: Any, title: str) -> Figures:
    """The figures of a result by name.

    Raises:
        TypeError: a class for which no function is registered here.
    """
    raise TypeError(f"{type(result).__name__} has no figures in lite6jax.report.plots; register a function")


@plotted.register
def _diagnosis(found: Diagnosis, title: str) -> Figures:
    title = title or Path(found.problem.recording.source).name
    return _drawn(found, to_document(found), diagnosis_figures.drawings, title)


@plotted.register
def _torque_diagnosis(found: TorqueDiagnosis, title: str) -> Figures:
    title = title or Path(found.problem.data.recording.source).name
    return _drawn(found, to_torque_document(found), torque_figures.drawings, title)


@plotted.register
def _combined(found: CombinedDiagnosis, title: str) -> Figures:
    torques = {} if found.torques is None else plotted(found.torques, title)
    named = {PREFIX + name: figure for name, figure in torques.items()}
    return Figures({**plotted(found.poses, title), **named})


def _drawn(
    found: _Found,
    document: Mapping[str, Any],
    drawings: Callable[[_Found, str, Sequence[int]], Iterable[tuple[str, Figure]]],
    title: str,
) -> Figures:
    ranking = {"ranking": ranking_figure(document, title)} if document["findings"] else {}
    return Figures({**ranking, **dict(drawings(found, title, worth.order(document)))})


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
