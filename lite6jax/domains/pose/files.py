"""Motions from files for a diagnosed arm, and the columns in which its poses are written."""

from dataclasses import replace
from pathlib import Path
from typing import Protocol

import jax
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.se3 import quaternion_from_rotation
from lite6jax.recordings import (
    ArmJoints,
    Recording,
    RecordingSettings,
    read_recording,
    read_settings,
    sidecar_path,
)
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
    return declare_anew(recording, settings)


def declare_anew(recording: Recording, settings: RecordingSettings) -> Recording:
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
