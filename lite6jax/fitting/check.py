"""The easy causes of a mismatch, before calibration is blamed: which nominal table, tool offset, smooth or jumping."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm, sample_joints
from lite6jax.arms.bundled import VARIANTS, bundled_arms, load_bundled
from lite6jax.arms.factory import FactoryCalibration, read_factory
from lite6jax.arms.files import read_arm
from lite6jax.arms.se3 import rotation_from_quaternion, rotation_from_rpy, transform
from lite6jax.fitting.recording_fit import fit_recording
from lite6jax.fitting.start import frames_from_poses
from lite6jax.recordings import Recording, outside_limits, repeated_rows, require_samples, time_disorder

Array = NDArray[np.floating]

DOWNWEIGHTED = 0.3
"""Weight below which the robust loss has all but left a sample out; of a Gaussian sensor's about four in a million."""
_SAMPLES = 1000
_ROUNDED = 2e-5
"""m: files with angles rounded to four decimals are up to 8.4 µm from exact quarter turns."""
_SAME_TABLE = 1e-7
_MOSTLY = 0.8
_PARTLY = 0.3
_ROWS_NAMED = 5


@dataclass(frozen=True)
class Finding:
    """One question and its answer.

    Attributes:
        question: a few words.
        verdict: one sentence.
        suspicious: whether it is a cause to remove before anything is fitted.
    """

    question: str
    verdict: str
    suspicious: bool


def check_calibration(calibration: FactoryCalibration) -> list[Finding]:
    """The easy causes in a calibration: its distance to each nominal table, and a constant shift of the flange."""
    arm = calibration.arm
    q = sample_joints(arm.dof, _SAMPLES)
    links = np.stack([frames.transform_from_row(row) for row in calibration.kinematics])
    pose = frames.chain(links, q) @ calibration.T_joint_flange
    tables = _tables(arm)
    nominal = [frames.chain(table.links, q) @ table.T_joint_flange for table in tables]
    distances = [np.linalg.norm(pose[:, :3, 3] - T[:, :3, 3], axis=1) for T in nominal]
    nearest = int(np.argmin([distance.max() for distance in distances]))
    said = "; ".join(
        f"{_named(table)} {_mm(np.sqrt(np.mean(d**2)))} mm RMS, {_mm(d.max())} mm at most"
        for table, d in zip(tables, distances, strict=True)
    )
    worst = float(distances[nearest].max())
    if worst < _ROUNDED:
        exact = "exactly" if worst < _SAME_TABLE else "to the rounding of its angles"
        return [
            Finding(
                "Nominal table",
                f"This is {_named(tables[nearest])} {exact}: a default, not the calibration of one arm ({said}).",
                True,
            )
        ]
    other = f", but {_named(tables[nearest])} is nearer" if nearest else ""
    table = Finding("Nominal table", f"A calibration of a {arm.name}{other}: {said}.", False)
    difference = pose[:, :3, 3] - nominal[0][:, :3, 3]
    in_flange = np.einsum("sji,sj->si", nominal[0][:, :3, :3], difference)
    smooth = Finding(
        "Smooth or jumping",
        "Smooth: two chains of fixed links differ smoothly at every joint position; if your own FK jumps against"
        " this file, the FK is wrong.",
        False,
    )
    shift = in_flange.mean(0)
    offset = _offset_finding(shift, np.sum(in_flange**2, 1), np.sum((in_flange - shift) ** 2, 1))
    return [table, offset, smooth]


def check_recording(recording: Recording, nominal: Arm | None = None) -> list[Finding]:
    """The easy causes in a recording: data faults, nominal table, tool offset, and whether geometry explains the error.

    Raises:
        InputError: as `fit_recording`.
    """
    settings, folder = recording.settings, Path(recording.source).parent
    require_samples(recording, 1)
    arm = nominal or read_arm(settings.arm_reference(folder))
    return [
        _data_finding(recording, arm),
        _table_finding(recording, arm),
        *_tool_findings(recording, arm),
        *_error_findings(recording, arm),
    ]


def _data_finding(recording: Recording, arm: Arm) -> Finding:
    faults = [note[0].upper() + note[1:] for note in recording.notes if note.startswith("dropped")]
    disorder = time_disorder(recording)
    if disorder.rows.size:
        faults.append(
            f"{_rows(disorder.rows)} out of time order, by up to {disorder.largest_step_back_s:.3g} s: sort them"
        )
    repeated = repeated_rows(recording)
    if repeated.rows.size:
        faults.append(f"{_rows(repeated.rows)} the same as an earlier row to the last digit: were they copied?")
    for outside in outside_limits(recording, arm.joint_limits):
        beyond = np.rad2deg(outside.largest_excess_rad)
        faults.append(f"{_rows(outside.rows)} outside joint {outside.joint}'s limits, by up to {beyond:.3g}°")
    return Finding(
        "Data", ("; ".join(faults) or "In time order, no row twice, inside the joint limits") + ".", bool(faults)
    )


def _table_finding(recording: Recording, arm: Arm) -> Finding:
    """Distance to each nominal table with sensor frame and tool, where unknown, at their best for it."""
    tables = _tables(arm)
    spread = []
    for table in tables:
        spread.append(_rms(_residual(recording, table.links, table.T_joint_flange, recording.settings.tool)[0]))
    said = "; ".join(f"{_named(table)} {_mm(rms)} mm RMS" for table, rms in zip(tables, spread, strict=True))
    nearest = int(np.argmin(spread))
    if nearest and spread[nearest] < 0.7 * spread[0]:
        return Finding("Nominal table", f"{_named(tables[nearest])} fits clearly better: {said}.", True)
    return Finding("Nominal table", f"{said}.", False)


def _tool_findings(recording: Recording, arm: Arm) -> list[Finding]:
    settings = recording.settings
    if settings.tool == "unknown":
        return [Finding("Tool offset", "The tool is declared unknown, so that a fit finds its offset.", False)]
    path = settings.factory_path(Path(recording.source).parent)
    links, after = arm.links, arm.T_joint_flange
    if path is not None:
        factory = read_factory(path, arm)
        links = np.stack([frames.transform_from_row(row) for row in factory.kinematics])
        after = factory.T_joint_flange
    before, declared = _residual(recording, links, after, settings.tool)
    rest, tool = _residual(recording, links, after, "unknown")
    shift = tool[:3, 3] - declared[:3, 3]
    return [_offset_finding(shift, np.sum(before**2, 1), np.sum(rest**2, 1))]


def _error_findings(recording: Recording, arm: Arm) -> list[Finding]:
    solution = fit_recording(recording, arm, geometry="free")
    before, after = (
        float(np.median(errors.position)) * _RMS_OF_MEDIAN for errors in (solution.nominal_errors, solution.checked)
    )
    explained = 1 - min(after / before, 1.0) ** 2 if before > 0 else 0.0
    found = (
        f"a change of geometry explains {_percent(explained)} of the squared error"
        f" ({_mm(before)} mm RMS, {_mm(after)} mm on rows held out)"
    )
    noise = solution.noise
    declared = noise.declared[0] * np.sqrt(3) if noise and noise.declared else 0.0
    start = "factory calibration" if recording.settings.factory_calibration else "nominal arm"
    if before <= 2 * declared:
        smooth = Finding("Smooth or jumping", f"The {start} is right to within the sensor's noise: {found}.", False)
    elif explained >= _MOSTLY:
        smooth = Finding("Smooth or jumping", f"Smooth, as calibration error is: {found}.", False)
    else:
        rest = "partly geometry" if explained >= _PARTLY else "not geometry"
        smooth = Finding(
            "Smooth or jumping", f"The error is {rest}: {found}; look at --figures for where it stands.", True
        )
    wild = np.flatnonzero(solution.weight < DOWNWEIGHTED)
    if not wild.size:
        return [smooth, Finding("Outliers", "No row stands out from its like.", False)]
    order = wild[np.argsort(solution.weight[wild])]
    worst = float(solution.errors.position[order[0]])
    return [
        smooth,
        Finding(
            "Outliers",
            f"{_rows(recording.row[order])} far off the others (up to {_mm(worst)} mm): look at them.",
            True,
        ),
    ]


_RMS_OF_MEDIAN = 1.1260
"""Of the length of an isotropic Gaussian 3-vector: √3 / √(median of χ²₃); wild rows move the median little."""


def _residual(recording: Recording, links: Array, after: Array, tool: object) -> tuple[Array, Array]:
    """Measured minus predicted positions `(sample, 3)` m with unknown frames at their best, and the tool `(4, 4)`."""
    position = recording.position
    assert position is not None
    rotation = None if recording.quaternion is None else np.asarray(rotation_from_quaternion(recording.quaternion))
    flange = frames.chain(links, recording.joint_position) @ after
    known = None if tool == "unknown" else _known_tool(tool)
    frame = np.eye(4) if recording.settings.pose_frame == "base" else None
    T_sensor_base, T_flange_tool = frames_from_poses(flange, position, rotation, frame, known)
    predicted = T_sensor_base @ flange @ T_flange_tool
    return position - predicted[:, :3, 3], T_flange_tool


def _known_tool(tool: object) -> Array:
    if not isinstance(tool, tuple):
        return np.eye(4)
    return np.asarray(transform(rotation_from_rpy(np.array(tool[3:])), np.array(tool[:3])))


def _offset_finding(shift: Array, before: Array, rest: Array) -> Finding:
    """`before` and `rest`: squared distances without and with the shift; medians, so that wild rows do not decide."""
    explained = max(0.0, 1 - float(np.median(rest)) / max(float(np.median(before)), np.finfo(float).tiny))
    where = f"a shift of ({', '.join(_mm(v) for v in shift)}) mm in the flange's frame explains {_percent(explained)}"
    if explained >= _MOSTLY:
        return Finding(
            "Tool offset",
            f"Likely: {where} of the squared error; set the tool offset (TCP) to zero or declare it.",
            True,
        )
    if explained >= _PARTLY:
        return Finding(
            "Tool offset", f"Possible: {where} of the squared error; check that the tool offset (TCP) is zero.", True
        )
    return Finding("Tool offset", f"None seen: {where} of the squared error.", False)


def _tables(arm: Arm) -> list[Arm]:
    """The arm's own nominal table first, then those of the same model that the vendor publishes elsewhere."""
    family = arm.name.split("_")[0]
    same = [name for name in bundled_arms() if name != arm.name and name.split("_")[0] == family]
    return [arm, *(load_bundled(name) for name in same if load_bundled(name).dof == arm.dof)]


def _named(arm: Arm) -> str:
    if arm.name in VARIANTS:
        return f"the vendor's ROS default ({arm.name})"
    return f"the published table ({arm.name})" if arm.name in bundled_arms() else f"the table of {arm.name}"


def _rms(difference: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, 1))))


def _rows(rows: Sequence[int] | NDArray[np.int64]) -> str:
    shown = ", ".join(str(row) for row in rows[:_ROWS_NAMED])
    if len(rows) == 1:
        return f"row {shown} is"
    return f"{len(rows)} rows ({shown}{', …' if len(rows) > _ROWS_NAMED else ''}) are"


def _percent(share: float) -> str:
    """A share that is not quite whole is not shown as whole."""
    return f"{100 * share:.1f} %" if 0.99 < share < 0.9995 else f"{100 * share:.0f} %"


def _mm(length: float) -> str:
    return f"{1e3 * length:.3g}"
