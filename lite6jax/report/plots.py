"""`plot()` of each kind of diagnosis: its figures by name. `lite6jax.summary.Plotted` loads this module by its name."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any, TypeVar

from matplotlib.figure import Figure

from lite6jax.diagnosis.combined import CombinedDiagnosis
from lite6jax.diagnosis.document import to_document
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_document import to_torque_document
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.report import diagnosis_figures, torque_figures, worth
from lite6jax.report.combined import PREFIX
from lite6jax.report.ranking_figure import ranking_figure
from lite6jax.summary import Figures

_Found = TypeVar("_Found")


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
