"""`plot()` of each kind of diagnosis: its figures by name. `lite6jax.summary.Plotted` loads this module by its name."""

from functools import singledispatch
from pathlib import Path
from typing import Any

from lite6jax.diagnosis.document import to_document
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_document import to_torque_document
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.report import diagnosis_figures, torque_figures, worth
from lite6jax.report.ranking_figure import ranking_figure
from lite6jax.summary import Figures


@singledispatch
def plotted(result: Any, title: str) -> Figures:
    """The figures of a result by name.

    Raises:
        TypeError: a class for which no function is registered here.
    """
    raise TypeError(f"{type(result).__name__} has no figures in lite6jax.report.plots; register a function")


@plotted.register
def _diagnosis(found: Diagnosis, title: str) -> Figures:
    document, title = to_document(found), title or Path(found.problem.recording.source).name
    ranking = {"ranking": ranking_figure(document, title)} if found.findings else {}
    return Figures({**ranking, **dict(diagnosis_figures.drawings(found, title, worth.order(document)))})


@plotted.register
def _torque_diagnosis(found: TorqueDiagnosis, title: str) -> Figures:
    document, title = to_torque_document(found), title or Path(found.problem.data.recording.source).name
    ranking = {"ranking": ranking_figure(document, title)} if found.findings else {}
    return Figures({**ranking, **dict(torque_figures.drawings(found, title, worth.order(document)))})
