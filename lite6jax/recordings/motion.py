"""What a recording says of the motion and the masses, in the form that effects depend on."""

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.effects.motion import Motion, motion_of
from lite6jax.effects.statics import Inertia, inertia_of
from lite6jax.recordings.recording import Recording
from lite6jax.recordings.settings import RecordingSettings


def motion_of_recording(recording: Recording) -> Motion:
    """The motion; without velocities where the arm stood still at each sample."""
    moving = recording.motion == "trajectory" and recording.joint_velocity is not None
    return motion_of(
        recording.joint_position,
        joint_velocity=recording.joint_velocity if moving else None,
        direction=recording.direction_of_motion,
        time=recording.time,
        run=recording.run,
        joint_temperature=recording.joint_temperature,
        ambient_temperature=recording.ambient_temperature,
        reference_temperature=recording.settings.reference_temperature_degC,
        payload=recording.payload,
        sliding=recording.sliding,
    )


def inertia_of_arm(arm: Arm, settings: RecordingSettings) -> Inertia | None:
    """The arm's masses with the payload's centre and the gravity that settings declare; None where unknown."""
    if arm.mass is None or arm.center_of_mass is None:
        return None
    center = arm.T_joint_flange[:3, :3] @ np.array(settings.payload_com_m) + arm.T_joint_flange[:3, 3]
    return inertia_of(arm.mass, arm.center_of_mass, center, np.array(settings.gravity_m_per_s2))
