"""The motion of a recording: in the form that effects depend on, and with joint positions that are others."""

from dataclasses import replace
from typing import Any

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array
from lite6jax.effects.motion import Motion, motion_of
from lite6jax.effects.statics import Inertia, inertia_of
from lite6jax.fields import field_values
from lite6jax.recordings.recording import Recording
from lite6jax.recordings.sequence import directions, run_segments, unwrap
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


# ------------------------------------------------------------------ other joint positions


def with_joints(recording: Recording, A: Array, b: Array, effort: Array | None = None) -> Recording:
    """The recording with the positions A q + b; velocities, accelerations and directions with them.

    Args:
        recording: any.
        A: `(joint, joint)`.
        b: `(joint,)` rad.
        effort: `(joint, joint)`, by which torques and currents are multiplied; they stay where it is not given.
    """
    exchange = np.abs(np.sign(A))
    moved = bool((exchange.sum(1) == 1).all())
    changed: dict[str, Any] = {"joint_position": recording.joint_position @ A.T + b}
    matrices = dict.fromkeys(("joint_velocity", "joint_acceleration", "commanded_position"), A)
    matrices |= {} if effort is None else {"joint_torque": effort, "motor_current": effort}
    matrices |= {"joint_temperature": exchange} if moved else {}
    recorded = field_values(recording)
    for name, matrix in matrices.items():
        column = recorded[name]
        if column is not None:
            changed[name] = column @ matrix.T + (b if name == "commanded_position" else 0.0)
    changed["direction_of_motion"] = recording.direction_of_motion @ np.sign(A).T
    if not moved:
        velocity = changed.get("joint_velocity")
        segment = run_segments(recording.run)
        changed["direction_of_motion"] = directions(changed["joint_position"], velocity, segment, recording.motion)
    return replace(recording, **changed)


def without_turns(recording: Recording, limits: Array, slack: float) -> Array:
    """Joint positions `(sample, joint)`, unwrapped within each run of a trajectory and turned back into the limits.

    Args:
        recording: any.
        limits: `(joint, 2)` rad.
        slack: rad, beyond which a position is outside them.
    """
    q = recording.joint_position.copy()
    low, high = limits.T
    trajectory = recording.motion == "trajectory" and recording.time is not None
    segment = run_segments(recording.run)
    runs = [segment == run for run in np.unique(segment)]
    turning = ~np.isin(np.arange(recording.dof), recording.sliding)
    for run in runs if trajectory else ():
        q[run] = np.where(turning, unwrap(q[run]), q[run])
    for joint in range(recording.dof):
        if joint in recording.sliding or not np.isfinite(high[joint] - low[joint]):
            continue
        middle = (low[joint] + high[joint]) / 2
        for part in runs if trajectory else [np.ones(recording.samples, bool)]:
            values = q[part, joint]
            reach = (high[joint] - low[joint]) / 2 + slack
            outside = np.abs(values - middle) > reach
            # a trajectory is continuous, so that all of a run is turned; at rest, each row for itself
            turned = np.median(values) if trajectory else np.where(outside, values, middle)
            unwound = values - 2 * np.pi * np.round((turned - middle) / (2 * np.pi))
            if outside.any() and (np.abs(unwound - middle) <= reach).all():
                q[part, joint] = unwound
    return q


def at_positions(recording: Recording, q: Array) -> Recording:
    """The recording with other joint positions, whole turns away; differentiated velocities are taken anew."""
    fresh = recording.made_anew(joint_position=q, settings=replace(recording.settings, motion=recording.motion))
    velocity = fresh.joint_velocity if recording.velocity_differentiated else recording.joint_velocity
    return replace(recording, joint_position=q, joint_velocity=velocity, direction_of_motion=fresh.direction_of_motion)
