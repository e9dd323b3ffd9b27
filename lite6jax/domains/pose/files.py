"""Motions and targets from files for a diagnosed arm, and the columns in which its poses are written."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import jax
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.se3 import quaternion_from_rotation
from lite6jax.domains.pose.inspection import inspect
from lite6jax.errors import InputError
from lite6jax.model import ArmModel
from lite6jax.recordings import (
    ArmJoints,
    Recording,
    RecordingSettings,
    Targets,
    read_recording,
    read_settings,
    read_targets,
    sidecar_path,
)
from lite6jax.recordings.sidecar import read_sidecar
from lite6jax.recordings.sources import TABLES, open_table
from lite6jax.storage import exists

Array = NDArray[np.floating]


class Diagnosed(Protocol):
    """What a motion inherits from the recording that was diagnosed.

    Attributes:
        dof: number of joints.
        motion: "static" or "trajectory".
        reference_temperature: °C.
        sliding: the prismatic joints, counted from 0.
    """

    @property
    def dof(self) -> int: ...
    @property
    def motion(self) -> str: ...
    @property
    def reference_temperature(self) -> float: ...
    @property
    def sliding(self) -> tuple[int, ...]: ...


class DiagnosedPoses(Diagnosed, Protocol):
    """What targets inherit beside.

    Attributes:
        model: the rigid part of the arm.
        joint_limits: `(joint, 2)` rad, m of prismatic joints, or None.
    """

    @property
    def model(self) -> ArmModel: ...
    @property
    def joint_limits(self) -> ArrayLike | None: ...


_NEAREST = 0.03
"""Of the reach, that points lie from the base at least: taken a thousand times too small, they all lie within."""


def read_motion(path: str | Path, model: Diagnosed) -> Recording:
    """A motion to predict; what its own sidecar does not declare is taken from the diagnosed recording.

    Raises:
        InputError: as `read_recording`.
    """
    sidecar = sidecar_path(path)
    settings = (
        read_settings(sidecar)
        if exists(sidecar)
        else RecordingSettings(reference_temperature_degC=model.reference_temperature)
    )
    recording = read_recording(path, arm=ArmJoints(model.dof, model.sliding))
    if settings.motion is None and recording.motion != model.motion:
        settings = replace(settings, motion=model.motion)  # type: ignore[arg-type]
    return _declared_anew(recording, settings)


def read_pose_targets(path: str | Path, model: DiagnosedPoses, given: Mapping[str, str] | None = None) -> Targets:
    """Targets for `compensate`; what their own sidecar does not declare is taken from the diagnosed recording.

    Args:
        path: the table. Names of its own, such as X, Y and Z, are recognised as by `inspect`; the arm's reach says
            whether positions are in m or mm.
        model: the arm.
        given: columns with the names that they have in a recording, where the caller knows better; or `ignore`.

    Raises:
        InputError: as `read_targets`; or what a column means, or its unit, is not certain.
    """
    reach = float(np.linalg.norm(np.asarray(model.model.geometry).reshape(-1, 6)[:, :3], axis=1).sum())
    reach += float(np.linalg.norm(np.asarray(model.model.T_flange_tool)[:3, 3]))
    columns, said = _recognised(Path(path), model, reach, given or {})
    recording, start = read_targets(path, model.dof, model.joint_limits, reach, columns)
    recording = replace(recording, notes=(*said, *recording.notes))
    settings = recording.settings
    if not exists(sidecar_path(path)):
        settings = replace(settings, reference_temperature_degC=model.reference_temperature)
    if settings.motion is None:
        settings = replace(settings, motion=model.motion)  # type: ignore[arg-type]
    return Targets(_declared_anew(recording, settings), start)


def _recognised(
    path: Path, model: DiagnosedPoses, reach: float, given: Mapping[str, str]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """The names in a recording of a table's own names, and a note; empty where it has a recording's names already."""
    declared = read_sidecar(sidecar_path(path)).columns
    _, table = open_table(path, (), ArmJoints(model.dof), [], TABLES)
    if not given and (declared or any(name in ("x_m", "x_mm") for name in table.names)):
        return {}, ()
    columns = dict(table.numbers())
    found = inspect(list(columns.items()), given={**declared, **given}, source=str(path))
    place, turned = found.of("position"), found.of("rotation")
    if place is None:
        if {"x_m", "x_mm"} & set(found.columns.values()):
            return found.columns, ()
        raise InputError(
            f"{path}: no columns look like positions to reach; say which they are: --column NAME=x_mm, and likewise "
            "y_mm and z_mm (x_m … in metres)"
        )
    if turned is not None and turned.form is not None and turned.form.sure != "certain":
        first = turned.block.columns[0]
        raise InputError(
            f"{path}: what the angles {', '.join(turned.block.columns)} mean is not certain; say it: --column "
            f"{first}=roll_deg (or yaw_deg, rx_rad, alpha_deg, ignore), and likewise the others"
        )
    unit = place.unit.choice
    if place.unit.reason != "name":
        points = np.stack([np.asarray(columns[name], float) for name in place.block.columns], 1)
        T = np.asarray(model.model.T_sensor_base)
        units = [name for name, size in (("m", 1.0), ("mm", 1e3)) if _can_be_reached(points / size, reach, T)]
        if len(units) != 1:
            name = place.block.columns[0]
            raise InputError(
                f"{path}: whether {', '.join(place.block.columns)} are in m or mm is not certain; say it: --column "
                f"{name}=x_mm (or x_m), and likewise the others"
            )
        unit = units[0]
    meant = found.columns | place.renamed(unit=unit)
    told = ", ".join(f"{own}={name}" for own, name in meant.items() if name != "ignore" and own != name)
    return meant, ((f"columns are read as {told}",) if told else ())


def _can_be_reached(points: Array, reach: float, T_sensor_base: Array) -> bool:
    """Whether most points `(row, 3)` m, in the base's frame or the sensor's, are where an arm can work."""
    far = [np.nanmedian(np.linalg.norm(points - centre, axis=1)) for centre in (np.zeros(3), T_sensor_base[:3, 3])]
    return any(_NEAREST * reach < distance < 1.1 * reach for distance in far)


def _declared_anew(recording: Recording, settings: RecordingSettings) -> Recording:
    """With other settings; notes on the file stay, except those on what was not declared."""
    undeclared = ("there is no sidecar", *recording.made_anew().notes)
    kept = tuple(note for note in recording.notes if not note.startswith(undeclared))
    anew = recording.made_anew(settings=settings)
    return replace(anew, notes=(*kept, *anew.notes))


def pose_columns(poses: Array, orientation: bool) -> dict[str, Array]:
    """Column name to values, as in a file of a recording; a pose of NaN gives NaN.

    Args:
        poses: `(sample, 4, 4)`.
        orientation: whether to give quaternions as well.
    """
    columns: dict[str, Array] = dict(zip(("x_m", "y_m", "z_m"), poses[:, :3, 3].T, strict=True))
    if orientation:
        columns.update(zip(("qw", "qx", "qy", "qz"), np.asarray(_quaternions(poses[:, :3, :3])).T, strict=True))
    return columns


def bar_columns(
    position_std: Array | None, orientation_std: Array | None, outside: NDArray[np.bool_] | None
) -> dict[str, Array | NDArray[np.integer]]:
    """Column name to values, of what is not None: `x_std_m` …, `rx_std_rad` … and `outside`, 0 or 1.

    Args:
        position_std: `(sample, 3)` m.
        orientation_std: `(sample, 3)` rad.
        outside: `(sample,)`.
    """
    columns: dict[str, Array | NDArray[np.integer]] = {}
    for std, names in ((position_std, ("x_std_m", "y_std_m", "z_std_m")), (orientation_std, TURNED)):
        if std is not None:
            columns.update(zip(names, std.T, strict=True))
    if outside is not None:
        columns["outside"] = outside.astype(int)
    return columns


TURNED = ("rx_std_rad", "ry_std_rad", "rz_std_rad")
"""Columns of the standard deviations of orientations, about the axes of the predicted tool."""


_quaternions = jax.jit(quaternion_from_rotation)
