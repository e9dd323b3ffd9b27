"""What a diagnosed arm's sensor would show in another motion, from the model in a diagnosis file."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.se3 import quaternion_from_rotation, rotation_from_quaternion
from lite6jax.domains.pose.registration import Registration, register
from lite6jax.effects.catalogue import kinds_of
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect
from lite6jax.effects.kinematic.surroundings import BaseDrift
from lite6jax.effects.motion import Motion, accelerated
from lite6jax.effects.serialization import effect_from_dict
from lite6jax.effects.statics import Inertia, inertia_of
from lite6jax.errors import InputError
from lite6jax.fitting.problem import UNDECLARED_NOISE
from lite6jax.model import ArmModel, predict_poses
from lite6jax.recordings import (
    Recording,
    RecordingSettings,
    read_recording,
    read_settings,
    require_samples,
    sidecar_path,
)
from lite6jax.recordings.motion import motion_of_recording
from lite6jax.storage import read_text

Array = NDArray[np.floating]

SCHEMA = "lite6jax/diagnosis/1"
_SIZE_LIMIT = 1 << 26
_TO_REGISTER = {3: 15, 6: 12}
"""Numbers that tell sensor frame and tool: with positions alone a closed form takes the frame's nine cosines first."""


@dataclass(frozen=True, eq=False)
class Enriched:
    """An arm with its physics, as a diagnosis left it.

    Attributes:
        arm: the nominal arm's name.
        model: the rigid part, NumPy leaves.
        physics: the effects.
        values: their numbers.
        inertia: masses, or None where none are known.
        orientation: whether the sensor showed orientations.
        reference_temperature: °C, at which the geometry holds.
        motion: of the diagnosed recording: "static" or "trajectory".
        accelerated: whether loads hold what it takes to accelerate the arm.
        remark: what a prediction means where the recording was diagnosed against another one; else empty.
    """

    arm: str
    model: ArmModel
    physics: Physics
    values: Array
    inertia: Inertia | None
    orientation: bool
    reference_temperature: float
    motion: str
    accelerated: bool = False
    remark: str = ""

    @property
    def dof(self) -> int:
        """The number of joints."""
        return np.asarray(self.model.geometry).size // 6

    def motion_of(self, recording: Recording) -> Motion:
        """The motion of a recording, with its accelerations where they count."""
        motion = motion_of_recording(recording)
        return accelerated(motion) if self.accelerated else motion


def read_model(path: str | Path, effects: tuple[Effect, ...] = ()) -> Enriched:
    """The model in a diagnosis file.

    Args:
        path: what `diagnose` wrote.
        effects: a user's own, where the model has them.

    Raises:
        InputError: no such file, not a diagnosis, or something in it is missing or not possible.
    """
    try:
        document = json.loads(read_text(path, _SIZE_LIMIT))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is no JSON ({error}); give what `lite6jax diagnose --out` wrote") from error
    if (
        not isinstance(document, dict)
        or document.get("schema") != SCHEMA
        or not isinstance(document.get("model"), dict)
    ):
        raise InputError(f"{path}: is no diagnosis ({SCHEMA} with a model); give what `lite6jax diagnose --out` wrote")
    model: dict[str, Any] = document["model"]
    try:
        kinematics = np.asarray(model["kinematics"], float)
        frames = [np.asarray(model[name], float) for name in ("T_sensor_base", "T_flange_tool")]
        if kinematics.ndim != 2 or kinematics.shape[1] != 6 or any(T.shape != (4, 4) for T in frames):
            raise ValueError("kinematics or a frame has another shape")
        if not all(np.isfinite(part).all() for part in (kinematics, *frames)):
            raise ValueError("a number is not finite")
        pairs = [effect_from_dict(entry, kinds_of(effects)) for entry in model["effects"]]
        physics = Physics(tuple(effect for effect, _ in pairs))
        masses = model["inertia"]
        inertia = None if masses is None else inertia_of(**{name: np.asarray(v, float) for name, v in masses.items()})
        return Enriched(
            arm=str(model["arm"]),
            model=ArmModel(kinematics.ravel(), *frames),  # type: ignore[arg-type]
            physics=physics,
            values=physics.join([value for _, value in pairs]),
            inertia=inertia,
            orientation=bool(model["orientation"]),
            reference_temperature=float(model["reference_temperature_degC"]),
            motion=str(model["motion"]),
            accelerated=bool(model.get("accelerated", False)),
            remark=str(document.get("against", {}).get("statement", "")),
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: its model is damaged ({error}); run `lite6jax diagnose` again") from error


def read_motion(path: str | Path, model: Enriched) -> Recording:
    """A motion to predict; what its own sidecar does not say is as it was in the diagnosed recording.

    Raises:
        InputError: as `read_recording`.
    """
    sidecar = sidecar_path(path)
    settings = (
        read_settings(sidecar)
        if sidecar.exists()
        else RecordingSettings(reference_temperature_degC=model.reference_temperature)
    )
    recording = read_recording(path, dof=model.dof)
    if settings.motion is None and recording.motion != model.motion:
        settings = replace(settings, motion=model.motion)  # type: ignore[arg-type]
    return recording.made_anew(settings=settings)


def register_motion(model: Enriched, recording: Recording) -> tuple[Enriched, Registration]:
    """The model with sensor frame and tool as in a recording of another set-up; all else stays, and how it fits.

    Where only positions were measured, the tool keeps its rotation, and the model shows positions only. How the old
    set-up drifted stays behind with it.

    Raises:
        InputError: no poses, too few of them (both counts), poses that leave a frame open, or as `predict_motion`.
    """
    require_samples(recording, _TO_REGISTER[recording.numbers_per_sample or 3])
    model = _without_drift(model)
    bare = [replace(model, model=ArmModel(model.model.geometry, _shift(x), np.eye(4))) for x in (0.0, 1.0)]  # type: ignore[arg-type]
    (flange, beyond), (shifted, _) = (predict_motion(one, recording) for one in bare)
    # a sensor's scale multiplies what it sees: it is how far a shift of the frame by a metre moves that
    growth = (shifted - flange)[:, 0, 3]
    flange = flange.copy()
    flange[:, :3, 3] /= growth[:, None]
    used = ~beyond
    require_samples(recording.select(used), _TO_REGISTER[recording.numbers_per_sample])
    position, rotation = recording.position, None
    assert position is not None
    if recording.quaternion is not None:
        rotation = np.asarray(rotation_from_quaternion(recording.quaternion))[used]
    settings = recording.settings
    noise = (
        settings.position_noise_m or UNDECLARED_NOISE[0],
        settings.orientation_noise_rad or UNDECLARED_NOISE[1],
    )
    before = np.asarray(model.model.T_flange_tool)[:3, :3]
    found = register(flange[used], (position / growth[:, None])[used], rotation, noise, tool_rotation=before)
    if not found.determined:
        raise InputError(
            f"{recording.source}: its poses leave sensor frame or tool open; record some that turn the flange about "
            "other axes"
        )
    frames = ArmModel(model.model.geometry, found.T_sensor_base, found.T_flange_tool)  # type: ignore[arg-type]
    return replace(model, model=frames, orientation=rotation is not None), found


def _without_drift(model: Enriched) -> Enriched:
    lasting = [not isinstance(effect, BaseDrift) for effect in model.physics.effects]
    physics, values = model.physics.part(model.values, lasting)
    return replace(model, physics=physics, values=values)


def _shift(x: float) -> Array:
    T = np.eye(4)
    T[0, 3] = x
    return T


def predict_motion(model: Enriched, recording: Recording) -> tuple[Array, NDArray[np.bool_]]:
    """The poses `T_sensor_tool` `(sample, 4, 4)` and which rows, `(sample,)`, the motion holds too little for.

    Raises:
        InputError: the motion lacks what an effect of the model needs, by name.
    """
    motion = model.motion_of(recording)
    chain = SixParameterForm(model.dof)
    poses = predict_poses(chain, model.physics, model.model, model.values, motion, model.inertia)
    beyond = np.asarray(_beyond(model.physics, model.values, motion))
    return np.asarray(poses), beyond


_beyond = jax.jit(Physics.beyond, static_argnums=0)
_quaternions = jax.jit(quaternion_from_rotation)


def table(poses: Array, beyond: NDArray[np.bool_], orientation: bool) -> dict[str, Array]:
    """Column name to values, as a recording has them; NaN where nothing can be said."""
    position = np.where(beyond[:, None], np.nan, poses[:, :3, 3])
    columns: dict[str, Array] = dict(zip(("x_m", "y_m", "z_m"), position.T, strict=True))
    if orientation:
        quaternion = np.where(beyond[:, None], np.nan, np.asarray(_quaternions(poses[:, :3, :3])))
        columns.update(zip(("qw", "qx", "qy", "qz"), quaternion.T, strict=True))
    return columns
