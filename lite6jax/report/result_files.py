"""`to_frame()` and `save(path)` of each kind of result: its table, and the files that hold it.

A result is saved as JSON where `documents.document` has a document of its class, as a table where `tabulate` has one
here, and a diagnosis as a page. A class whose file is another one registers a function with `write`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lite6jax.design.identify import Identification
from lite6jax.design.poses import DiscriminationPlan, Plan
from lite6jax.design.sensitivity import GlobalSensitivity, Sensitivity
from lite6jax.diagnosis.combined import CombinedDiagnosis
from lite6jax.diagnosis.document import document_text
from lite6jax.diagnosis.result import Diagnosis, Finding
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.domains.pose.compensate import Compensation
from lite6jax.domains.pose.predict import Prediction, prediction_columns
from lite6jax.domains.pose.registration import Registration
from lite6jax.domains.torque.predict import TorquePrediction, torque_columns
from lite6jax.errors import InputError
from lite6jax.fitting.fleet import Comparison, FleetSolution
from lite6jax.fitting.quality import Result
from lite6jax.fitting.solution import Solution, write_solution
from lite6jax.recordings import Recording, write_recording
from lite6jax.recordings.writing import write_table
from lite6jax.report import combined, documents, page, torque_page
from lite6jax.report.compensation_tables import compensation_columns
from lite6jax.report.next_steps import Files
from lite6jax.results import PublicResult, tabulate, write
from lite6jax.storage import check_writable, exists, write_atomically

Array = NDArray[np.floating]
Columns = dict[str, Any]


# ------------------------------------------------------------------ tables


@tabulate.register
def _recording(recording: Recording) -> Columns:
    return dict(recording.columns())


@tabulate.register
def _solution(solution: Solution) -> Columns:
    return _by_row(documents.document(solution)["parameters"])


@tabulate.register
def _fleet(fleet: FleetSolution) -> Columns:
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
def _comparison(found: Comparison) -> Columns:
    form = found.arm.form
    columns: Columns = {"arm": list(found.names), "from_nominal_max_m": found.from_nominal.max(1)}
    return columns | {f"{n}_{u}": v for n, u, v in zip(form.names, form.units, found.difference.T, strict=True)}


@tabulate.register
def _identification(found: Identification) -> Columns:
    return _by_row(found.to_dict()["parameters"])


@tabulate.register
def _plan(found: Plan) -> Columns:
    return {**_joints(found.joint_position, found.experiment.arm.sliding), "position_std_m": found.accuracy}


@tabulate.register
def _discrimination(found: DiscriminationPlan) -> Columns:
    return {**_joints(found.joint_position, found.experiment.arm.sliding), "distance": found.distance}


@tabulate.register
def _sensitivity(found: Sensitivity) -> Columns:
    return _by_row(documents.document(found)["parameters"])


@tabulate.register
def _global_sensitivity(found: GlobalSensitivity) -> Columns:
    parts = ("first", "first_interval", "total", "total_interval")
    return {"name": list(found.names), **{part: getattr(found, part) for part in parts}}


@tabulate.register
def _prediction(found: Prediction) -> Columns:
    return dict(prediction_columns(found, orientation=found.orientation_std is not None))


@tabulate.register
def _torque_prediction(found: TorquePrediction) -> Columns:
    return dict(torque_columns(found))


@tabulate.register
def _compensation(found: Compensation) -> Columns:
    return dict(compensation_columns(found))


@tabulate.register
def _registration(found: Registration) -> Columns:
    columns: Columns = dict(zip(("dx_m", "dy_m", "dz_m"), found.missed.T, strict=True))
    if found.turned is not None:
        columns |= dict(zip(("drx_rad", "dry_rad", "drz_rad"), found.turned.T, strict=True))
    return {**columns, "distance_m": found.distance, "weight": found.weight, "outlier": ~found.kept}


@tabulate.register
def _diagnosis(found: Diagnosis) -> Columns:
    return _by_row(_parameters("poses", found.findings), _PARAMETER)


@tabulate.register
def _torque_diagnosis(found: TorqueDiagnosis) -> Columns:
    return _by_row(_parameters("torques", found.findings), _PARAMETER)


@tabulate.register
def _combined(found: CombinedDiagnosis) -> Columns:
    torques = () if found.torques is None else found.torques.findings
    return _by_row([*_parameters("poses", found.poses.findings), *_parameters("torques", torques)], _PARAMETER)


_PARAMETER = ("of", "finding", "effect", "site", "driver", "parameter", "value", "std", "p_value")


def _parameters(of: str, findings: Sequence[Finding]) -> list[Columns]:
    """A row for each parameter of each finding; findings are numbered from 1."""
    return [
        dict(zip(_PARAMETER, (of, number, finding.effect.name, finding.effect.site, driver, name, *estimate,
                              finding.p_value), strict=True))
        for number, finding in enumerate(findings, 1)
        for driver in (", ".join(each.phrase for each in finding.effect.drivers) or "none",)
        for name, estimate in finding.parameters.items()
    ]  # fmt: skip


def _by_row(rows: Sequence[Mapping[str, Any]], names: Sequence[str] = ()) -> Columns:
    """Columns of rows that have the same entries; those of `names` where there is no row."""
    return {name: [row[name] for row in rows] for name in (rows[0] if rows else names)}


def _joints(joint_position: Array, sliding: Sequence[int]) -> Columns:
    return {f"q{j + 1}_{'m' if j in sliding else 'rad'}": values for j, values in enumerate(joint_position.T)}


# ------------------------------------------------------------------ files


_TABLES = (".csv", ".parquet")


@write.register
def _saved(result: PublicResult, path: Path, overwrite: bool) -> Path:
    """A table, or the document of a class that has one."""
    suffix, forms = path.suffix.lower(), [str(form) for form in _TABLES]
    if documents.document.dispatch(type(result)) is not documents.document.dispatch(object):
        forms.append(".json")
    _check_suffix(result, path, forms)
    if suffix == ".json":
        return write_atomically(path, documents.text(documents.document(result), None) + "\n", overwrite)
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
    document = combined.stated_document(found)
    text = document_text(document) if suffix == ".json" else page_text(found, document)
    return write_atomically(path, text, overwrite)


def page_text(
    found: Diagnosis | TorqueDiagnosis | CombinedDiagnosis, document: dict[str, Any], files: Files | None = None
) -> str:
    """The page of any diagnosis, HTML.

    Args:
        found: the diagnosis.
        document: as in its JSON file, with statements.
        files: for commands to copy; the recording's, where that is a file, where not given.
    """
    poses = found.poses if isinstance(found, CombinedDiagnosis) else found
    source = (poses.problem.data if isinstance(poses, TorqueDiagnosis) else poses.problem).recording.source
    drawn = {name: figure for name, figure in found.plot(Path(source).name).items() if not name.endswith("ranking")}
    if files is None and exists(source):
        files = Files(Path(source))
    if isinstance(poses, TorqueDiagnosis):
        return torque_page.torque_page(poses, document, source, drawn, files)
    if isinstance(found, CombinedDiagnosis) and found.torques is not None:
        return combined.combined_page(found, document, source, drawn, files)
    return page.diagnosis_page(poses, document, source, drawn, files)


def _check_suffix(result: object, path: Path, forms: Sequence[str]) -> None:
    if path.suffix.lower() not in forms:
        named = ", ".join(forms[:-1]) + f" or {forms[-1]}"
        raise InputError(f"{path}: a {type(result).__name__} is saved as {named}; let the name end so")
