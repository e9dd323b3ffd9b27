"""The simple causes of a mismatch, before calibration is suspected: codes and numbers; `report.faults` words them.

A recording is screened for data faults as in a fit and a diagnosis; what remains is compared with a constant tool
offset, with a change of geometry, and with outliers. A calibration is compared with the nominal tables and with a
constant tool offset.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration, read_factory
from lite6jax.array_types import Array
from lite6jax.calibration.fit import fit_recording
from lite6jax.calibration.source import with_arm
from lite6jax.calibration.start import (
    calibration_poses,
    check_positions,
    declared_tool,
    frames_from_recording,
    nominal_calibration,
)
from lite6jax.domains.pose.fit import fit_touches
from lite6jax.domains.pose.registration import noise_of
from lite6jax.domains.pose.rigid_arm import rigid_arm
from lite6jax.domains.pose.screening.hypotheses import tables_of_model, touches_one_point
from lite6jax.domains.pose.screening.screen import screen
from lite6jax.domains.pose.screening.thresholds import AS_NOISE_RATIO, PUBLISHED_TOLERANCE
from lite6jax.recordings import Recording, outside_limits, require_one_station
from lite6jax.recordings.fault import DataFault, row_numbers

_MOSTLY_EXPLAINED = 0.8
"""Share of the squared error at which a cause is likely, set on real arms."""
_PARTLY_EXPLAINED = 0.3
"""Share of the squared error at which a cause is possible, set on real arms."""

_RMS_OF_MEDIAN = 1.1260
"""Of the length of an isotropic Gaussian 3-vector: √3 / √(median of χ²₃). Outliers move the median little."""
_RMS_OF_ONE = 1.4826
"""The same of one number."""


@final
@dataclass(frozen=True)
class Cause:
    """One simple cause of a mismatch.

    Attributes:
        code: `default_table`, `nominal_table`, `tool_offset`, `joint_limits`, `geometry`, `one_point`, `outliers` or
            `missing_rows`.
        suspicious: whether it is to be removed before anything is fitted.
        rows: of the file, from 1; empty where all or none are concerned.
        numbers: in SI units, plain JSON values.
    """

    code: str
    suspicious: bool
    rows: tuple[int, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class RecordingCheck:
    """What a check of a recording found.

    Attributes:
        faults: of the data, as in a diagnosis; what follows is without them.
        ruled_out: faults that were tested for and are not there.
        causes: what else may explain a mismatch.
        notes: of the reader, a sentence each.
    """

    faults: tuple[DataFault, ...]
    ruled_out: tuple[DataFault, ...]
    causes: tuple[Cause, ...]
    notes: tuple[str, ...]


def check_calibration(calibration: FactoryCalibration) -> list[Cause]:
    """A calibration's distance to each nominal table, and a constant displacement of the flange."""
    arm = calibration.arm
    q = check_positions(arm)
    pose = calibration_poses(calibration, q)
    # the arm's own nominal table first, then those of the same model that the vendor publishes elsewhere
    tables = [arm, *(table for table in tables_of_model(arm.name) if table.name != arm.name and table.dof == arm.dof)]
    nominal = [calibration_poses(nominal_calibration(table), q) for table in tables]
    distances = [np.linalg.norm(pose[:, :3, 3] - T[:, :3, 3], axis=1) for T in nominal]
    nearest = int(np.argmin([distance.max() for distance in distances]))
    compared = [
        {"table": table.name, "rms_m": float(np.sqrt(np.mean(d**2))), "largest_m": float(d.max())}
        for table, d in zip(tables, distances, strict=True)
    ]
    numbers = {"arm": arm.name, "nearest": tables[nearest].name, "tables": compared}
    if distances[nearest].max() < PUBLISHED_TOLERANCE:
        return [Cause("default_table", True, (), numbers)]
    difference = pose[:, :3, 3] - nominal[0][:, :3, 3]
    in_flange = np.einsum("sji,sj->si", nominal[0][:, :3, :3], difference)
    shift = in_flange.mean(0)
    offset = _tool_offset(shift, np.sum(in_flange**2, 1), np.sum((in_flange - shift) ** 2, 1))
    return [Cause("nominal_table", False, (), numbers), offset]


def check_recording(recording: Recording, nominal: Arm | None = None) -> RecordingCheck:
    """Data faults, joint limits, tool offset, outliers, and how much of the error a change of geometry explains.

    Args:
        recording: measured poses.
        nominal: the nominal arm; from the sidecar where not given.

    Raises:
        InputError: as `fit_recording`.
    """
    require_one_station(recording)
    if nominal is None:
        recording = with_arm(recording)
    screened = screen(recording, nominal, allow_undecided=True)
    recording = screened.recording
    arm = screened.arm
    assert arm is not None
    causes = []
    for outside in outside_limits(recording, arm.joint_limits):
        excess = f"largest_excess_{arm.joint_units[outside.joint - 1]}"
        numbers = {"joint": outside.joint, excess: outside.largest_excess_rad}
        causes.append(Cause("joint_limits", True, row_numbers(outside.rows), numbers))
    # of a mismatch that nothing explains, and of poses that were computed, no share of the error means anything
    if not any(screened.count(code) for code in ("undecided", "other_arm", "unexplained", "computed_pose")):
        causes += _recorded_tool_offset(recording, arm)
        causes += _geometry_and_outliers(recording, arm)
    return RecordingCheck(screened.found, screened.ruled_out, tuple(causes), recording.notes)


def _recorded_tool_offset(recording: Recording, arm: Arm) -> list[Cause]:
    """A constant displacement of the measured point on the flange; none where the tool is fitted."""
    settings = recording.settings
    if settings.tool == "unknown" or recording.touches or touches_one_point(recording, noise_of(settings)[0]):
        return []
    path = settings.factory_path(Path(recording.source).parent)
    calibration = nominal_calibration(arm) if path is None else read_factory(path, arm)
    flange = calibration_poses(calibration, recording.joint_position)
    declared = declared_tool(recording)
    position = recording.position
    assert position is not None
    squares = []
    tools = []
    for tool in (declared, None):
        T_sensor_base, T_flange_tool = frames_from_recording(recording, flange, tool)
        missed = position - (T_sensor_base @ flange @ T_flange_tool)[:, :3, 3]
        squares.append(np.sum(missed**2, 1))
        tools.append(T_flange_tool)
    cause = _tool_offset(tools[1][:3, 3] - tools[0][:3, 3], squares[0], squares[1])
    return [replace(cause, numbers={**cause.numbers, "declared_m": declared[:3, 3].tolist()})]


def _tool_offset(shift: Array, before: Array, after: Array) -> Cause:
    """`before` and `after`: squared distances without and with the shift; medians, so that outliers do not decide."""
    share = max(0.0, 1 - float(np.median(after)) / max(float(np.median(before)), np.finfo(float).tiny))
    numbers = {"shift_m": shift.tolist(), "explained": share, "likely": share >= _MOSTLY_EXPLAINED}
    return Cause("tool_offset", share >= _PARTLY_EXPLAINED, (), numbers)


def _geometry_and_outliers(recording: Recording, arm: Arm) -> list[Cause]:
    """How much a change of geometry explains, of an error that a tool offset may explain as well; and outliers."""
    touches = recording.touches is not None
    geometry = "prior" if recording.settings.factory_calibration else "free"  # where that alone has a known length
    if touches:
        solution = fit_touches(rigid_arm(recording, arm, geometry))
    else:
        solution = fit_recording(recording, arm, geometry="free")
    if not touches and touches_one_point(recording, noise_of(recording.settings)[0]):
        before, after = (float(np.median(e.position)) for e in (solution.nominal_errors, solution.errors))
        return [Cause("one_point", True, (), {"before_m": before, "fitted_m": after})]
    of_median = _RMS_OF_MEDIAN if recording.numbers_per_sample > 1 else _RMS_OF_ONE
    pair = solution.nominal_errors, solution.checked
    before, after = (float(np.median(errors.position)) * of_median for errors in pair)
    share = 1 - min(after / before, 1.0) ** 2 if before > 0 else 0.0
    noise = solution.noise
    length = np.sqrt(min(recording.numbers_per_sample, 3))
    declared = 0.0
    if noise and noise.declared:
        declared = (noise.declared[0] or 0.0) * length
    if before <= AS_NOISE_RATIO * declared:
        kind = "none"
    elif share < _MOSTLY_EXPLAINED:
        kind = "partly" if share >= _PARTLY_EXPLAINED else "other"
    else:
        kind = "geometry"
    numbers = {
        "kind": kind,
        "explained": share,
        "before_rms_m": before,
        "heldout_rms_m": after,
        "start": "factory_calibration" if recording.settings.factory_calibration else "nominal_arm",
    }
    geometry = Cause("geometry", kind in ("partly", "other"), (), numbers)
    outlying = np.flatnonzero(solution.outlying)
    if not outlying.size:
        return [geometry, Cause("outliers", False)]
    worst = float(solution.errors.position[outlying].max())
    return [geometry, Cause("outliers", True, row_numbers(recording.row[outlying]), {"largest_m": worst})]
