"""Simulated readings that are no poses: an arm that touches sockets or plates, is gauged, or shows a board to a camera.

The tool is led to where it is to be: in a socket, on a plate, or where the board is in sight. The inverse kinematics of
the rigid chain lead there, and again from where its effects have left the tool.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import final

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.design.readings import BOARD, CAMERA, DISTORTION, READERS, SOCKETS_APART, draw_place, draw_views
from lite6jax.domains.pose.inverse import REACHED, Target, reach
from lite6jax.errors import InputError
from lite6jax.model import ArmModel
from lite6jax.recordings import Recording
from lite6jax.recordings.readings import Readings, readings_from_arrays
from lite6jax.recordings.settings import CameraSettings, KnownDistance
from lite6jax.sensors.camera import Lens, project

Array = NDArray[np.floating]
Poses = Callable[[Recording], Array]

_CORRECTIONS = 6
"""Times that the rigid arm is led to where it and its effects are in the place."""
_PLATE = 0.25
"""Of the reach, half a plate's side."""


@final
@dataclass(frozen=True)
class _Scene:
    """What rows are to reach.

    Attributes:
        target: where the tool is to be, `(sample, 4, 4)`; None where that is anywhere.
        turned: whether its orientation matters.
        readings: of tools.
        settings: what a sidecar declares of it.
    """

    target: Array | None
    turned: bool
    readings: Callable[[Array], Readings]
    settings: Mapping[str, object]


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
    usual = READERS[reading].noise
    scene = _SCENES[reading](rng, motion.samples, arm, usual if noise is None else noise, noise or usual)
    target_poses = scene.target
    q = motion.joint_position
    reached = np.ones(motion.samples, bool)
    if target_poses is not None:
        q, reached = reach(model, _target(target_poses, scene.turned), q, arm.joint_limits, arm.sliding, rng)
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
            off = np.linalg.inv(tool if scene.turned else _shifts(tool[:, :3, 3])) @ target_poses
            if np.abs(off - np.eye(4)).max() < REACHED:
                break
            led = led @ off
            q, _ = reach(model, _target(led, scene.turned), moved.joint_position, arm.joint_limits, arm.sliding, rng)
            moved = moved.made_anew(joint_position=q)
    tools = np.tile(np.eye(4), (motion.samples, 1, 1))  # places and noise belong to samples of the motion
    tools[chosen] = poses(moved)
    settings = replace(moved.settings, pose_source=READERS[reading].source, tool="unknown", **scene.settings)
    simulated_readings = scene.readings(tools).select(chosen)
    return replace(
        moved.made_anew(settings=settings, position=None, quaternion=None, readings=simulated_readings),
        notes=motion.notes,
    )


def _target(T: Array, turned: bool) -> Target:
    return Target(T[:, :3, 3].T, np.moveaxis(T[:, :3, :3], 0, -1) if turned else None)  # type: ignore[arg-type]


def _shifts(at: Array) -> Array:
    """Poses `(sample, 4, 4)` at points `(sample, 3)`, not turned."""
    T = np.tile(np.eye(4), (len(at), 1, 1))
    T[:, :3, 3] = at
    return T


# ------------------------------------------------------------------ the scenes


def _contact(rng: np.random.Generator, samples: int, arm: Arm, noise: float, declared: float) -> _Scene:
    points = []
    names = []
    distances = []
    for k, angle in enumerate((-0.6, 0.7)):
        socket = draw_place(rng, arm, angle)
        along = rng.standard_normal(3)
        along = along / np.linalg.norm(along)
        points += [socket, socket + SOCKETS_APART * along]
        names += [f"plate{k + 1}_a", f"plate{k + 1}_b"]
        distances.append(KnownDistance((names[-2], names[-1]), SOCKETS_APART, 5e-5))
    group = np.arange(samples) * len(points) // max(samples, 1)
    target = np.array(points)[group] + noise * rng.standard_normal((samples, 3))
    labels = [names[k] for k in group]
    return _Scene(
        _shifts(target),
        False,
        lambda T: readings_from_arrays("contact", labels=labels),
        {"contact_noise_m": declared, "contact_distances": tuple(distances)},
    )


def _plane(rng: np.random.Generator, samples: int, arm: Arm, noise: float, declared: float) -> _Scene:
    normals = np.array([[0.0, 0.0, 1.0], [1.0, 0.1, 0.1], [0.1, 1.0, 0.2]])
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    centres = np.array([draw_place(rng, arm, angle) for angle in (0.0, 0.6, -0.9)])
    group = np.arange(samples) % 3
    error = noise * rng.standard_normal(samples)
    labels = [f"plate{k + 1}" for k in group]
    aside = _PLATE * arm.reach * rng.uniform(-1, 1, (samples, 3))
    aside += normals[group] * (error - np.sum(normals[group] * aside, 1))[:, None]
    return _Scene(
        _shifts(centres[group] + aside),
        False,
        lambda T: readings_from_arrays("plane", labels=labels),
        {"plane_noise_m": declared},
    )


def _distance(rng: np.random.Generator, samples: int, arm: Arm, noise: float, declared: float) -> _Scene:
    anchor = draw_place(rng, arm, 2.5) * 1.6
    error = noise * rng.standard_normal(samples)
    return _Scene(
        None,
        False,
        lambda T: readings_from_arrays("distance", value=np.linalg.norm(T[:, :3, 3] - anchor, axis=1) + error),
        {"distance_noise_m": declared},
    )


def _axis(rng: np.random.Generator, samples: int, arm: Arm, noise: float, declared: float) -> _Scene:
    error = 0.3 + noise * rng.standard_normal(samples)
    return _Scene(
        None,
        False,
        lambda T: readings_from_arrays("axis", value=T[:, 2, 3] + error),
        {"axis_noise_m": declared, "axis": (0.0, 0.0, 1.0)},
    )


def _camera(fixed: bool) -> Callable[[np.random.Generator, int, Arm, float, float], _Scene]:
    def scene(rng: np.random.Generator, samples: int, arm: Arm, noise: float, declared: float) -> _Scene:
        corners = np.array(BOARD.points)
        printed = corners + BOARD.noise_m * rng.standard_normal(corners.shape)
        view_poses, T = draw_views(rng, samples, arm, fixed)
        target = T @ (view_poses if fixed else np.linalg.inv(view_poses))
        lens = Lens(np.array([CAMERA[key] for key in ("fx", "fy", "cx", "cy")]), np.array(DISTORTION))
        error = noise * rng.standard_normal((samples, len(corners), 2))

        def readings(tool: Array) -> Readings:
            in_camera = np.linalg.inv(T) @ tool if fixed else np.linalg.inv(tool) @ T
            points = printed @ np.swapaxes(in_camera[:, :3, :3], 1, 2) + in_camera[:, None, :3, 3]
            pixels = np.asarray(project(lens, jnp.asarray(points))) + error
            inside = (pixels > 0).all(2) & (pixels < [CAMERA["width"], CAMERA["height"]]).all(2)
            pixels[~inside | (points[..., 2] <= 0)] = np.nan
            return readings_from_arrays("camera", pixels=pixels)

        mounted = "fixed" if fixed else "on_flange"
        fx, fy, cx, cy, width, height = CAMERA.values()
        camera = CameraSettings(mounted, fx, fy, cx, cy, DISTORTION, width, height)
        return _Scene(target, True, readings, {"pixel_noise_px": declared, "camera": camera, "board": BOARD})

    return scene


_SCENES: Mapping[str, Callable[[np.random.Generator, int, Arm, float, float], _Scene]] = {
    "contact": _contact,
    "plane": _plane,
    "distance": _distance,
    "axis": _axis,
    "fixed_camera": _camera(True),
    "flange_camera": _camera(False),
}


def tool_of(reading: str) -> Array:
    """`T_flange_tool` `(4, 4)` of a reading's point, board or camera."""
    return frames.transform_from_row([*READERS[reading].tool, 0.0, 0.0, 0.0])
