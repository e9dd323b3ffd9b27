"""What `--json` prints of a command whose result has no file format of its own: plain values, SI units in the names.

To add a kind of result, write its fields into `_FIELDS`.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from functools import singledispatch
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from lite6jax.arms.files import Conversion
from lite6jax.calibration.fleet import Comparison
from lite6jax.calibration.quality import Result
from lite6jax.calibration.solution import Errors, Solution
from lite6jax.controller.station import CalibrationRead
from lite6jax.design.command_plans import CommandPlan
from lite6jax.design.identify import Identification, Sensitivity
from lite6jax.design.poses import DiscriminationPlan, Plan
from lite6jax.design.torques import TorquePlan
from lite6jax.domains.pose.check import RecordingCheck
from lite6jax.domains.pose.compensate import Compensation
from lite6jax.domains.pose.predict import Prediction
from lite6jax.domains.pose.registration import Registration
from lite6jax.domains.torque.predict import TorquePrediction
from lite6jax.domains.tracking.predict import CorrectedCommands, TrackedMotion
from lite6jax.fleet.folder import ERRORS, columns
from lite6jax.fleet.folder import STATISTICS as OF_FILES
from lite6jax.formatting import STATISTICS
from lite6jax.report.compensations import reason_text


def text(content: Mapping[str, Any], written: Sequence[Path] | None = ()) -> str:
    """A document as JSON, with the files that the command wrote, or None; a number that is not finite is null."""
    files = {}
    if written is not None:
        files = {"written": [str(path) for path in written]}
    return json.dumps(_plain({**content, **files}), indent=1, allow_nan=False)


def line(content: Mapping[str, Any]) -> str:
    """A document as JSON on one line."""
    return json.dumps(_plain(content), allow_nan=False)


_FIELDS: dict[type, tuple[str, str]] = {
    Comparison: ("comparison", "arm=arm.name files=sources between_max_m=between"),
    Plan: (
        "design",
        "arm=experiment.arm.name poses=count candidates criterion rank=design.rank position_std_m=accuracy"
        " random_position_std_m=random_median worth_random_poses=worth needed joint_position_rad=joint_position",
    ),
    DiscriminationPlan: (
        "discrimination",
        "arm=experiment.arm.name poses=count candidates rivals distance random_distance"
        " joint_position_rad=joint_position",
    ),
    TorquePlan: (
        "motion",
        "duration_s=room.duration harmonics=room.harmonics identification"
        " log_determinant=identification.log_determinant random_log_determinant",
    ),
    CommandPlan: (
        "command_design",
        "arm=experiment.model.arm.name duration_s=room.duration rate_hz=room.rate payloads_kg=experiment.carried"
        " noise_rad=experiment.noise velocity_rad_per_s=fastest acceleration_rad_per_s2=strongest candidates",
    ),
    Conversion: ("conversion", "arm=arm.name form left_out difference_m=difference"),
    RecordingCheck: ("check", "data_faults=faults ruled_out causes notes"),
    CalibrationRead: (
        "calibration",
        "arm=calibration.arm.name kinematics=calibration.kinematics controller_error=error",
    ),
    Solution: (
        "fit",
        "arm=arm.name steps quality held T_sensor_base=model.T_sensor_base"
        " T_flange_tool=model.T_flange_tool before=nominal_errors fitted=errors after=checked noise data_faults=faults"
        " notes",
    ),
    Compensation: ("compensation", "omitted notes"),
    CorrectedCommands: (
        "commands",
        "rms_before_rad=error_before rms_after_rad=error_after rows outside=rows_outside beyond=beyond.counts",
    ),
    Sensitivity: ("sensitivity", ""),
}
"""For each class the name of its schema, and the keys of its document.

A key may be followed by `=` and the attribute that it holds. `_more` adds what no attribute holds.
"""


@singledispatch
def _more(result: Any) -> dict[str, Any]:
    """What a document has beside attributes of the result."""
    return {}


def document(result: Any) -> dict[str, Any]:
    """The document of a result.

    Raises:
        TypeError: a class that has none.
    """
    if isinstance(result, Identification):
        return result.to_dict()
    if isinstance(result, list):  # possible causes of an error of a calibration
        return {"schema": "lite6jax/check/1", "causes": result}
    if not has_document(type(result)):
        raise TypeError(f"{type(result).__name__} has no document in lite6jax.report.documents; add its fields")
    schema, fields = _FIELDS[type(result)]
    pairs = (field.partition("=") for field in fields.split())
    values = {key: attrgetter(attribute or key)(result) for key, _, attribute in pairs}
    return {"schema": f"lite6jax/{schema}/1", **values, **_more(result)}


def has_document(kind: type) -> bool:
    """Tells whether results of a class have a document."""
    return kind in _FIELDS or kind is Identification


@_more.register
def _solution(solution: Solution) -> dict[str, Any]:
    chain = solution.form.chain
    deviation = [None] * chain.size if solution.standard_deviation is None else solution.standard_deviation
    columns = {
        "name": chain.names, "unit": chain.units, "value": solution.parameters, "std": deviation, "free": solution.free,
        "determined": solution.determined, "prior_share": solution.prior_share,
    }  # fmt: skip
    return {"result": solution.result.name.lower(), "parameters": list(_rows(**columns))}


@_more.register
def _command_plan(plan: CommandPlan) -> dict[str, Any]:
    motions = [{"kind": kind, "begin_s": begin, "end_s": end} for kind, begin, end in plan.parts]
    pairs = plan.pairs if plan.experiment.of_findings else plan.hardest
    alike = sorted({tuple(sorted((pair.effect.label, pair.rival.label))) for pair in plan.alike})
    return {"motions": motions, "pairs": [pair.to_dict() for pair in pairs], "alike": alike, "unseen": plan.unseen}


@_more.register
def _sensitivity(sensitivity: Sensitivity) -> dict[str, Any]:
    moved, turned = (np.sqrt(np.mean(movement**2, 0)) for movement in (sensitivity.position, sensitivity.orientation))
    parameters = _rows(
        name=sensitivity.names, unit=sensitivity.units, tolerance=sensitivity.tolerance, per_unit=sensitivity.per_unit,
        position_rms_m=moved, orientation_rms_rad=turned, share=sensitivity.share,
    )  # fmt: skip
    expected = float(np.sqrt(np.mean(sensitivity.expected_error**2)))
    return {"expected_position_rms_m": expected, "parameters": list(parameters)}


@_more.register
def _comparison(comparison: Comparison) -> dict[str, Any]:
    form = comparison.arm.form
    parameters = _rows(name=form.names, unit=form.units, difference=comparison.difference.T, std=comparison.spread)
    distances = [
        {key: float(statistic(distance)) for key, statistic in STATISTICS} for distance in comparison.from_nominal
    ]
    return {"parameters": list(parameters), "from_nominal_m": distances}


@_more.register
def _compensation(compensation: Compensation) -> dict[str, Any]:
    missed = np.flatnonzero(~compensation.reached)
    sliding = compensation.recording.sliding
    not_reached = _rows(
        row=compensation.recording.row[missed],
        reason=[reason_text(compensation.reason[k], sliding) for k in missed],
        position_error_m=compensation.position_error[missed],
    )
    return {
        "targets": len(compensation.reached),
        "reached": int(compensation.reached.sum()),
        "outside": None if compensation.outside is None else int(compensation.outside.sum()),
        "not_reached": list(not_reached),
    }


def _rows(**columns: Any) -> Iterator[dict[str, Any]]:
    """A dictionary for each row of columns by name; the shortest column ends them."""
    return (dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=False))


def _errors(errors: Errors) -> dict[str, float]:
    """Mean, median, 95th percentile, maximum and root mean square of errors."""
    summary: dict[str, float] = {}
    for name, unit, values in (("position", "m", errors.position), ("orientation", "rad", errors.orientation)):
        if values is not None:
            summary |= {f"{name}_{key}_{unit}": float(statistic(values)) for key, statistic in STATISTICS}
            summary[f"{name}_rms_{unit}"] = float(np.sqrt(np.mean(values**2)))
    return summary


def of_folder(rows: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """The document of the fits of a folder, of the rows of its table."""
    fixed = columns()

    def file(row: Mapping[str, Any]) -> dict[str, Any]:
        errors = ({name.rpartition("_")[0]: row[f"{part}_{name}"] for name in OF_FILES} for part in ERRORS)
        return {
            **{name: row[name] for name in ("file", "kind", "message")},
            "result": Result(row["result"]).name.lower(),
            **{name: row[name] or "" for name in ("quality", "arm")},
            **{name: row[name] or 0 for name in ("joints", "samples", "steps")},
            "parameters": {name: value for name, value in row.items() if name not in fixed and value is not None},
            **{part: error if row["arm"] else None for part, error in zip(ERRORS, errors, strict=True)},
        }

    return {"schema": "lite6jax/folder/1", "files": list(map(file, rows))}


def of_diagnoses(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The document of the diagnoses of a folder's recordings."""
    return {"schema": "lite6jax/diagnoses/1", "recordings": list(rows)}


def prediction_document(
    prediction: Prediction | TorquePrediction | TrackedMotion, registration: Registration | None
) -> dict[str, Any]:
    """The document of a prediction: rows outside what was recorded, and the frames that were fitted."""
    fitted = None
    if registration is not None:
        frames = {"T_sensor_base": registration.T_sensor_base, "T_flange_tool": registration.T_flange_tool}
        fitted = {**frames, "position_rms_m": registration.rms, "outliers": int(np.sum(~registration.kept))}
    beyond = {}
    if isinstance(prediction, TrackedMotion):
        beyond = {"beyond": prediction.beyond.counts}
    return {
        "schema": "lite6jax/prediction/1",
        "rows": len(prediction.empty),
        "empty_rows": int(prediction.empty.sum()),
        "outside": None if prediction.outside is None else int(prediction.outside.sum()),
        **beyond,
        "registration": fitted,
    }


def _plain(value: Any) -> Any:
    """Values of JSON alone."""
    if isinstance(value, Mapping):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, Errors):
        return _plain(_errors(value))
    if callable(getattr(value, "to_dict", None)):
        return _plain(value.to_dict())
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, np.ndarray) or hasattr(value, "__array__"):
        return _plain(np.asarray(value).tolist())
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)
