"""Simulated readings that are no poses: an arm that touches sockets or plates, is gauged, or shows a board to a camera.

The tool is led to where it is to be: in a socket, on a plate, or where the board is in sight. The inverse kinematics of
the rigid chain lead there, and again from where its effects have left the tool.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array
from lite6jax.design.readings import target_of
from lite6jax.domains.pose.inverse import REACHED, reach
from lite6jax.errors import InputError
from lite6jax.model import ArmModel
from lite6jax.recordings import Recording
from lite6jax.recordings.readings import readings_from_arrays
from lite6jax.recordings.settings import declared_settings
from lite6jax.sensors.points import poses_at
from lite6jax.sensors.usual import READINGS

Poses = Callable[[Recording], Array]

_CORRECTIONS = 6
"""Times that the rigid arm is led to where it and its effects are in the place."""


def read(
    reading: str, motion: Recording, arm: Arm, model: ArmModel, poses: Poses, noise: float | None, seed: int
) -> Recording:
    """A recording of readings; rows whose place the arm does not reach are dropped.

    Args:
        reading: which.
        motion: joint positions to start from, and what effects depend on.
        arm: its limits.
        model: the rigid arm and its tool, in the base's frame.
        poses: the tool's poses `(sample, 4, 4)` in a motion, with all effects.
        noise: one sigma in place of the usual one; zero is none, and declared as the usual one.
        seed: of the places and the noise.

    Raises:
        InputError: an arm that reaches too few of the places.
    """
    rng = np.random.default_rng([seed, 50])
    kind = READINGS[reading]
    usual = kind.usual_noise
    true_noise = usual if noise is None else noise
    sensor, target_poses, error = kind.simulate(rng, motion.samples, arm.reach, true_noise, noise or usual)
    turned = sensor.turned
    q = motion.joint_position
    reached = np.ones(motion.samples, bool)
    if target_poses is not None:
        q, reached = reach(model, target_of(target_poses, turned), q, arm.joint_limits, arm.sliding, rng)
    if reached.sum() < 2:
        raise InputError(
            f"simulation: the {arm.name} reaches no place where it could read a {reading}; take another arm"
        )
    chosen = np.flatnonzero(reached)
    moved = motion.select(reached).made_anew(joint_position=q[reached], row=np.arange(1, len(chosen) + 1))
    if target_poses is not None:
        target_poses = led = target_poses[chosen]
        for _ in range(_CORRECTIONS):
            tool = poses(moved)
            off = np.linalg.inv(tool if turned else poses_at(tool[:, :3, 3])) @ target_poses
            if np.abs(off - np.eye(4)).max() < REACHED:
                break
            led = led @ off
            q, _ = reach(model, target_of(led, turned), moved.joint_position, arm.joint_limits, arm.sliding, rng)
            moved = moved.made_anew(joint_position=q)
    tools = np.tile(np.eye(4), (motion.samples, 1, 1))  # places and noise belong to samples of the motion
    tools[chosen] = poses(moved)
    declared = {"pose_source": kind.source, "tool": "unknown", **sensor.declared()}
    settings = declared_settings(moved.settings, None, declared)
    simulated_readings = readings_from_arrays(kind.kind, **sensor.record(tools, error)).select(chosen)  # type: ignore[arg-type]
    return replace(
        moved.made_anew(settings=settings, position=None, quaternion=None, readings=simulated_readings),
        notes=motion.notes,
    )


def tool_of(reading: str) -> Array:
    """`T_flange_tool` `(4, 4)` of a reading's point, board or camera."""
    return frames.transform_from_row([*READINGS[reading].usual_tool, 0.0, 0.0, 0.0])
