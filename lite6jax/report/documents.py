"""What `--json` prints of a command whose result has no file format of its own: plain values, SI units in the names.

To add a kind of result, register a function with `document` here.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np

from lite6jax.arms.files import Conversion
from lite6jax.calibration.fleet import Comparison
from lite6jax.calibration.solution import Errors, Solution
from lite6jax.controller.station import CalibrationRead
from lite6jax.design.identify import Identification
from lite6jax.design.poses import DiscriminationPlan, Plan
from lite6jax.design.sensitivity import Sensitivity
from lite6jax.design.torques import TorquePlan
from lite6jax.domains.pose.check import RecordingCheck
from lite6jax.domains.pose.compensate import Compensation
from lite6jax.domains.pose.predict import Prediction
from lite6jax.domains.pose.registration import Registration
from lite6jax.fleet.folder import Row
from lite6jax.report.compensation import reason_text
from lite6jax.report.words import STATISTICS


def text(found: Mapping[str, Any], written: Sequence[Path] | None = ()) -> str:
    """A document as JSON, with the files that the command wrote, or None; a number that is not finite is null."""
    files = {} if written is None else {"written": [str(path) for path in written]}
    return json.dumps(_plain({**found, **files}), indent=1, allow_nan=False)


def line(found: Mapping[str, Any]) -> str:
    """A document as JSON on one line."""
    return json.dumps(_plain(found), allow_nan=False)


@singledispatch
def document(result: Any) -> dict[str, Any]:
    """The document of a result.

    Raises:
        TypeError: a class for which no function is registered here.
    """
    raise TypeError(f"{type(result).__name__} has no document in lite6jax.report.documents; register a function")


@document.register
def _solution(found: Solution) -> dict[str, Any]:
    chain = found.form.chain
    deviation = [None] * chain.size if found.standard_deviation is None else found.standard_deviation
    columns = {
        "name": chain.names, "unit": chain.units, "value": found.parameters, "std": deviation, "free": found.free,
        "determined": found.determined, "prior_share": found.prior_share,
    }  # fmt: skip
    return {
        "schema": "lite6jax/fit/1",
        "arm": found.arm.name,
        "result": found.result.name.lower(),
        "steps": found.steps,
        "quality": found.quality.to_dict(),
        "parameters": list(_rows(**columns)),
        "held": [asdict(each) for each in found.held],
        "T_sensor_base": found.model.T_sensor_base,
        "T_flange_tool": found.model.T_flange_tool,
        "before": _errors(found.nominal_errors),
        "fitted": _errors(found.errors),
        "after": _errors(found.checked),
        "noise": None if found.noise is None else asdict(found.noise),
        "data_faults": [fault.to_dict() for fault in found.faults],
        "notes": found.notes,
    }


def _rows(**columns: Any) -> Iterator[dict[str, Any]]:
    """A dictionary for each row of columns by name; the shortest column ends them."""
    return (dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=False))


def _errors(errors: Errors) -> dict[str, float]:
    """Mean, median, 95th percentile, maximum and root mean square of errors."""
    found: dict[str, float] = {}
    for name, unit, values in (("position", "m", errors.position), ("orientation", "rad", errors.orientation)):
        if values is not None:
            found |= {f"{name}_{key}_{unit}": float(statistic(values)) for key, statistic in STATISTICS}
            found[f"{name}_rms_{unit}"] = float(np.sqrt(np.mean(values**2)))
    return found


@document.register
def _comparison(found: Comparison) -> dict[str, Any]:
    form = found.arm.form
    return {
        "schema": "lite6jax/comparison/1",
        "arm": found.arm.name,
        "files": found.sources,
        "parameters": [
            {"name": name, "unit": unit, "difference": found.difference[:, i], "std": found.spread[i]}
            for i, (name, unit) in enumerate(zip(form.names, form.units, strict=True))
        ],
        "from_nominal_m": [{key: float(statistic(own)) for key, statistic in STATISTICS} for own in found.from_nominal],
        "between_max_m": found.between,
    }


def of_folder(rows: Sequence[Row]) -> dict[str, Any]:
    """The document of the fits of a folder."""
    return {
        "schema": "lite6jax/folder/1",
        "files": [
            {**asdict(row), "result": row.result.name.lower(), "parameters": dict(row.parameters)} for row in rows
        ],
    }


def of_diagnoses(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The document of the diagnoses of a folder's recordings."""
    return {"schema": "lite6jax/diagnoses/1", "recordings": list(rows)}


@document.register
def _sensitivity(found: Sensitivity) -> dict[str, Any]:
    moved, turned = (np.sqrt(np.mean(each**2, 0)) for each in (found.position, found.orientation))
    parameters = _rows(
        name=found.names, unit=found.units, tolerance=found.tolerance, per_unit=found.per_unit, position_rms_m=moved,
        orientation_rms_rad=turned, share=found.share,
    )  # fmt: skip
    return {
        "schema": "lite6jax/sensitivity/1",
        "expected_position_rms_m": float(np.sqrt(np.mean(found.expected_error**2))),
        "parameters": list(parameters),
    }


document.register(Identification, Identification.to_dict)


@document.register(Plan)
@document.register(DiscriminationPlan)
def _design(found: Plan | DiscriminationPlan) -> dict[str, Any]:
    about = {"arm": found.experiment.arm.name, "poses": found.count, "candidates": found.candidates}
    if isinstance(found, DiscriminationPlan):
        about = {"schema": "lite6jax/discrimination/1", **about}
        about |= {name: getattr(found, name) for name in ("rivals", "distance", "random_distance")}
    else:
        about = {
            "schema": "lite6jax/design/1",
            **about,
            "criterion": found.criterion,
            "rank": found.design.rank,
            "position_std_m": found.accuracy,
            "random_position_std_m": found.random_median,
            "worth_random_poses": found.worth,
            "needed": found.needed,
        }
    return {**about, "joint_position_rad": found.joint_position}


@document.register
def _motion(found: TorquePlan) -> dict[str, Any]:
    return {
        "schema": "lite6jax/motion/1",
        "duration_s": found.room.duration,
        "harmonics": found.room.harmonics,
        "identification": found.identification.to_dict(),
        "log_determinant": found.identification.log_determinant,
        "random_log_determinant": found.random_log_determinant,
    }


@document.register
def _conversion(done: Conversion) -> dict[str, Any]:
    return {
        "schema": "lite6jax/conversion/1",
        "arm": done.arm.name,
        "form": done.form,
        "left_out": done.left_out,
        "difference_m": done.difference,
    }


@document.register
def _compensation(found: Compensation) -> dict[str, Any]:
    return {
        "schema": "lite6jax/compensation/1",
        "targets": len(found.reached),
        "reached": int(found.reached.sum()),
        "outside": None if found.outside is None else int(found.outside.sum()),
        "omitted": found.omitted,
        "not_reached": [
            {
                "row": found.recording.row[k],
                "reason": reason_text(found.reason[k], found.recording.sliding),
                "position_error_m": found.position_error[k],
            }
            for k in np.flatnonzero(~found.reached)
        ],
        "notes": found.notes,
    }


@document.register
def _check(found: RecordingCheck) -> dict[str, Any]:
    return {
        "schema": "lite6jax/check/1",
        "data_faults": [fault.to_dict() for fault in found.faults],
        "ruled_out": [fault.to_dict() for fault in found.ruled_out],
        "causes": [asdict(cause) for cause in found.causes],
        "notes": found.notes,
    }


@document.register
def _causes(found: list) -> dict[str, Any]:
    return {"schema": "lite6jax/check/1", "causes": [asdict(cause) for cause in found]}


@document.register
def _calibration(read: CalibrationRead) -> dict[str, Any]:
    return {
        "schema": "lite6jax/calibration/1",
        "arm": read.calibration.arm.name,
        "kinematics": read.calibration.kinematics,
        "controller_error": read.error,
    }


def prediction_document(found: Prediction, registration: Registration | None) -> dict[str, Any]:
    """The document of a prediction: how many rows are outside what was recorded, and the frames that were fitted."""
    fitted = None
    if registration is not None:
        frames = {name: getattr(registration, name) for name in ("T_sensor_base", "T_flange_tool")}
        fitted = {**frames, "position_rms_m": registration.rms, "outliers": int(np.sum(~registration.kept))}
    return {
        "schema": "lite6jax/prediction/1",
        "rows": len(found.poses),
        "empty_rows": int(np.isnan(found.poses[:, 0, 0]).sum()),
        "outside": None if found.outside is None else int(found.outside.sum()),
        "registration": fitted,
    }


def _plain(value: Any) -> Any:
    """Values of JSON alone."""
    if isinstance(value, Mapping):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, np.ndarray) or hasattr(value, "__array__"):
        return _plain(np.asarray(value).tolist())
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
