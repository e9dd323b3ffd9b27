"""What the sensors of a diagnosed arm show in a motion: its poses, or the torques of its motors."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import overload

from jax.typing import ArrayLike

from lite6jax.array_types import Array
from lite6jax.domains.base import DomainModel
from lite6jax.domains.pose.predict import DiagnosedArm, Prediction
from lite6jax.domains.torque.predict import DiagnosedMotors, TorquePrediction
from lite6jax.domains.tracking.predict import DiagnosedServos, TrackedMotion
from lite6jax.errors import InputError, wrong_type
from lite6jax.recordings import Recording, assemble_motion

Motion = Recording | str | Path | ArrayLike


def predict(
    model: DiagnosedArm | DiagnosedMotors | DiagnosedServos, motion: Motion, **circumstances: ArrayLike
) -> Array:
    """The poses `T_sensor_tool` `(sample, 4, 4)`, the torques `(sample, joint)` Nm, or the joints `(sample, joint)` rad
    that follow commands, that the sensors of a diagnosed recording would show in a motion.

    Rows are NaN where a clock's offset reaches beyond the ends of a run. Torques are also NaN in long gaps between
    uneven times.

    Args:
        model: of poses, of torques or of servos, from a diagnosis.
        motion: a recording, the path of its file, or joint positions `(sample, joint)` in rad. A recording's settings
            say at which temperature the geometry holds, and whether the arm stands still at each row. For joint
            positions the settings of the diagnosed recording are taken. Torques of joint positions are those of a
            moving arm, and need `time`; those of static postures need a `Recording` with `motion="static"`.
        circumstances: beside joint positions, arrays by the names of `Recording.from_arrays` in its shapes and units:
            `payload`, `time`, `run`, `joint_velocity`, `joint_temperature`, `ambient_temperature`.

    Raises:
        InputError: another number of joints, degrees, no times, more gaps than motion, or the motion lacks what an
            effect needs, by name.
    """
    bare = replace(model, uncertainty=None) if isinstance(model, DomainModel) else model
    return predicted(bare, motion, **circumstances).shown


@overload
def predicted(model: DiagnosedArm, motion: Motion, **circumstances: ArrayLike) -> Prediction: ...
@overload
def predicted(model: DiagnosedMotors, motion: Motion, **circumstances: ArrayLike) -> TorquePrediction: ...
@overload
def predicted(model: DiagnosedServos, motion: Motion, **circumstances: ArrayLike) -> TrackedMotion: ...
def predicted(
    model: DiagnosedArm | DiagnosedMotors | DiagnosedServos, motion: Motion, **circumstances: ArrayLike
) -> Prediction | TorquePrediction | TrackedMotion:
    """The poses or the torques that the sensors show in a motion, with their standard deviations.

    Standard deviations of poses are those of the true pose. Those of torques contain the sensor's noise.

    Rows outside what was recorded are marked. There the error that the model leaves is taken to grow with the distance
    in joint space to the nearest recorded rows, beyond their spacing. Its variance grows by the square of the ratio of
    that distance to `LENGTH` of `lite6jax.domains.uncertainty`. It grows likewise with what an effect depends on.

    Args:
        model: as in `predict`.
        motion: as in `predict`.
        circumstances: as in `predict`.

    Raises:
        InputError: as `predict`.
    """
    if not isinstance(model, DomainModel):
        raise wrong_type("model", model, "lite6jax.read_model('diagnosis.json'), or the `model` of a diagnosis")
    if isinstance(motion, str | Path):
        motion = model.read_motion(motion)
    if isinstance(motion, Recording):
        if circumstances:
            names = ", ".join(circumstances)
            raise InputError(f"motion: is a recording, and arrays go with joint positions only; leave out {names}")
        remedy = "add time_s"
    else:
        if not (isinstance(motion, Sequence) or hasattr(motion, "__array__")):
            raise wrong_type("motion", motion, "a Recording, the path of its file, or an array of joint positions")
        motion = assemble_motion(model, motion, **circumstances)
        remedy = "give time=…"
    return model.predicted(motion, remedy)
