"""What the sensors of a diagnosed arm show in a motion: its poses, or the torques of its motors."""

from dataclasses import replace
from pathlib import Path
from typing import overload

import numpy as np
from jax.typing import ArrayLike
from numpy.typing import NDArray

from lite6jax.domains.pose.predict import DiagnosedArm, Prediction, predicted_poses, recording_of
from lite6jax.domains.torque.predict import DiagnosedMotors, TorquePrediction, predicted_torques
from lite6jax.errors import InputError, wrong_type
from lite6jax.recordings import Recording, read_motion

Motion = Recording | str | Path | ArrayLike


def predict(model: DiagnosedArm | DiagnosedMotors, motion: Motion, **circumstances: ArrayLike) -> NDArray[np.floating]:
    """The poses `T_sensor_tool` `(sample, 4, 4)`, or the torques `(sample, joint)` Nm, that the sensors of a diagnosed
    recording would show in a motion.

    Rows are NaN where a clock's offset reaches beyond the ends of a run; of torques in long gaps of uneven times.

    Args:
        model: of poses or of torques, from a diagnosis.
        motion: a recording or the path of its file, whose settings say at which temperature the geometry holds and
            whether the arm stands still at each row; or joint positions `(sample, joint)` in rad, for which the
            diagnosed recording's hold. Torques need its times.
        circumstances: beside joint positions, arrays by the names of `Recording.from_arrays` in its shapes and units:
            `payload`, `time`, `run`, `joint_velocity`, `joint_temperature`, `ambient_temperature`.

    Raises:
        InputError: another number of joints, degrees, no times, more gaps than motion, or the motion lacks what an
            effect needs, by name.
    """
    bare = replace(model, uncertainty=None) if isinstance(model, DiagnosedArm | DiagnosedMotors) else model
    found = predicted(bare, motion, **circumstances)
    return found.poses if isinstance(found, Prediction) else found.torque


@overload
def predicted(model: DiagnosedArm, motion: Motion, **circumstances: ArrayLike) -> Prediction: ...
@overload
def predicted(model: DiagnosedMotors, motion: Motion, **circumstances: ArrayLike) -> TorquePrediction: ...
def predicted(
    model: DiagnosedArm | DiagnosedMotors, motion: Motion, **circumstances: ArrayLike
) -> Prediction | TorquePrediction:
    """The poses or the torques that the sensors show in a motion, with their standard deviations.

    Those of poses are of the true pose, and those of torques contain the sensor's noise. Rows outside what was recorded
    are marked. There what is left of the model is taken to grow: its variance by the square of the distance in joint
    space to the nearest recorded rows, beyond their spacing, over `LENGTH` of `lite6jax.domains.uncertainty`; and
    likewise with what an effect depends on.

    Args:
        model: as in `predict`.
        motion: as in `predict`.
        circumstances: as in `predict`.

    Raises:
        InputError: as `predict`.
    """
    if not isinstance(model, DiagnosedArm | DiagnosedMotors):
        raise wrong_type("model", model, "lite6jax.read_model('diagnosis.json'), or the `model` of a diagnosis")
    if isinstance(motion, str | Path):
        motion = read_motion(motion, model)
    if not isinstance(motion, Recording):
        motion = recording_of(model, motion, **circumstances)
    elif circumstances:
        raise InputError(f"predict: a recording has its own {', '.join(circumstances)}; give joint positions")
    return predicted_poses(model, motion) if isinstance(model, DiagnosedArm) else predicted_torques(model, motion)
