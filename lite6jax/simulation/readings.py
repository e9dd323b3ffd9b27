"""Simulated readings that are no poses: an arm that touches sockets or plates, is gauged, or shows a board to a camera.

The joints of each row are moved until the tool is where it is to be: in a socket, on a plate, or where the board is in
sight. The rigid chain leads there, and a few steps more the arm with its effects.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.readings import Kind, Readings, readings_from_arrays
from lite6jax.recordings.settings import BoardSettings, CameraSettings, KnownDistance, PoseSource
from lite6jax.sensors.camera import Lens, project

Array = NDArray[np.floating]
Poses = Callable[[Recording], Array]

_ROUNDS, _TRIES, _CORRECTIONS = 60, 12, 6
_STEP = 1e-6
_REACHED = 1e-7
_TILT = 0.6
"""rad, by which a board is turned from facing the camera."""
SOCKETS_APART = 0.05
_BOARD = BoardSettings(7, 5, 0.02, 2e-5)
_CAMERA = {"fx": 1450.0, "fy": 1452.0, "cx": 958.0, "cy": 603.0, "width": 1920.0, "height": 1200.0}
_DISTORTION = (-0.11, 0.09, 4e-4, -3e-4, -0.02)
TOOLS: Mapping[str, tuple[float, float, float]] = {
    "contact": (0.02, 0.0, 0.09),
    "plane": (0.0, 0.03, 0.06),
    "distance": (0.01, -0.02, 0.05),
    "axis": (0.02, 0.0, 0.05),
    "fixed_camera": (0.02, 0.0, 0.03),
    "flange_camera": (0.04, 0.0, 0.03),
}
"""m in the flange's frame, where the point or the board of each is, away from the last joint's axis."""


class Reader(NamedTuple):
    """A reading that can be simulated.

    Attributes:
        kind: of readings.
        noise: one sigma, m, and px of a camera.
        source: its name in a sidecar.
    """

    kind: Kind
    noise: float
    source: PoseSource


READERS: Mapping[str, Reader] = {
    "contact": Reader("contact", 1e-4, "touch"),
    "plane": Reader("plane", 2e-5, "touch"),
    "distance": Reader("distance", 5e-5, "draw_wire"),
    "axis": Reader("axis", 2e-5, "height_gauge"),
    "fixed_camera": Reader("camera", 0.15, "camera"),
    "flange_camera": Reader("camera", 0.15, "camera"),
}
"""By name."""


@final
@dataclass(frozen=True)
class _Scene:
    """What rows are to reach.

    Attributes:
        off: how far from there tools `(sample, 4, 4)` are, `(sample, number)` m and rad.
        readings: of tools.
        settings: what a sidecar declares of it.
    """

    off: Callable[[Array], Array]
    readings: Callable[[Array], Readings]
    settings: Mapping[str, object]


def read(
    reading: str, motion: Recording, arm: Arm, poses: Poses, rigid: Poses, noise: float | None, seed: int
) -> Recording:
    """A recording of readings; rows whose place the arm does not reach are dropped.

    Args:
        reading: which.
        motion: joint positions to start from, and what effects depend on.
        arm: its limits.
        poses: the tool's poses `(sample, 4, 4)` in a motion, with all effects, in the base's frame.
        rigid: without effects.
        noise: one sigma in place of the usual one; zero is none, and declared as the usual one.
        seed: of the places and the noise.

    Raises:
        InputError: an arm that reaches too few of the places.
    """
    rng = np.random.default_rng([seed, 50])
    usual = READERS[reading].noise
    scene = _SCENES[reading](rng, motion.samples, arm, usual if noise is None else noise, noise or usual)
    q, reached = _reached(motion, arm, rigid, scene, rng)
    if reached.sum() < 2:
        raise InputError(
            f"simulation: the {arm.name} reaches no place where it could read a {reading}; take another arm"
        )
    moved = motion.select(reached).made_anew(joint_position=q[reached], row=np.arange(1, int(reached.sum()) + 1))
    chosen = np.flatnonzero(reached)
    for _ in range(_CORRECTIONS):
        off = scene.off(_spread(poses(moved), chosen, motion.samples))[chosen]
        if not off.size or np.abs(off).max() < _REACHED:
            break
        step = _step(moved, rigid, lambda T: scene.off(_spread(T, chosen, motion.samples))[chosen], off)
        moved = moved.made_anew(joint_position=moved.joint_position - step)
    found = scene.readings(_spread(poses(moved), chosen, motion.samples)).select(chosen)
    settings = replace(moved.settings, pose_source=READERS[reading].source, tool="unknown", **scene.settings)
    return replace(
        moved.made_anew(settings=settings, position=None, quaternion=None, readings=found), notes=motion.notes
    )


def _spread(T: Array, chosen: NDArray[np.integer], samples: int) -> Array:
    """Poses of chosen samples among all, the identity elsewhere: places belong to samples."""
    every = np.tile(np.eye(4), (samples, 1, 1))
    every[chosen] = T
    return every


def _step(motion: Recording, rigid: Poses, off: Callable[[Array], Array], now: Array) -> Array:
    """The change of the joints by which the rigid chain would undo `now`, `(sample, joint)`."""
    q, base = motion.joint_position, off(rigid(motion))
    J = np.empty((*base.shape, motion.dof))
    for j in range(motion.dof):
        moved = motion.made_anew(joint_position=q + _STEP * np.eye(motion.dof)[j])
        J[..., j] = (off(rigid(moved)) - base) / _STEP
    H = J @ np.swapaxes(J, 1, 2) + 1e-8 * np.eye(now.shape[1])
    return np.einsum("skj,sk->sj", J, np.linalg.solve(H, now[..., None])[..., 0])


def _reached(
    motion: Recording, arm: Arm, rigid: Poses, scene: _Scene, rng: np.random.Generator
) -> tuple[Array, NDArray[np.bool_]]:
    """Joint positions that reach the place of each sample, from several starts, and where that succeeded."""
    lower, upper = arm.joint_limits.T
    q, reached = motion.joint_position.copy(), np.zeros(motion.samples, bool)
    if not scene.off(rigid(motion)).shape[1]:
        return q, ~reached
    for attempt in range(_TRIES):
        trial = q.copy()
        if attempt:
            trial[~reached] = rng.uniform(lower, upper, (int((~reached).sum()), arm.dof))
        for _ in range(_ROUNDS):
            at = motion.made_anew(joint_position=trial)
            off = scene.off(rigid(at))
            step = _step(at, rigid, scene.off, off)
            step[reached] = 0.0
            trial = trial - step * np.minimum(1.0, 0.3 / np.maximum(np.abs(step).max(1, keepdims=True), 1e-12))
            if np.abs(off[~reached]).max(initial=0.0) < _REACHED:
                break
        off = np.abs(scene.off(rigid(motion.made_anew(joint_position=trial)))).max(1)
        inside = ((trial > lower) & (trial < upper)).all(1)
        now = ~reached & (off < 10 * _REACHED) & inside
        q[now], reached = trial[now], reached | now
        if reached.all():
            break
    return q, reached


# ------------------------------------------------------------------ the scenes


def _place(rng: np.random.Generator, arm: Arm, angle: float) -> Array:
    """A point within reach, in front of the arm at an angle about its base."""
    radius, height = arm.reach * rng.uniform(0.45, 0.6), arm.reach * rng.uniform(0.1, 0.4)
    return np.array([radius * np.cos(angle), radius * np.sin(angle), height])


def _contact(rng: np.random.Generator, samples: int, arm: Arm, noise: float, declared: float) -> _Scene:
    points, names, distances = [], [], []
    for k, angle in enumerate((-0.6, 0.7)):
        one = _place(rng, arm, angle)
        along = rng.standard_normal(3)
        along = along / np.linalg.norm(along)
        points += [one, one + SOCKETS_APART * along]
        names += [f"plate{k + 1}_a", f"plate{k + 1}_b"]
        distances.append(KnownDistance((names[-2], names[-1]), SOCKETS_APART, 5e-5))
    group = np.arange(samples) * len(points) // max(samples, 1)
    target = np.array(points)[group] + noise * rng.standard_normal((samples, 3))
    labels = [names[k] for k in group]
    return _Scene(
        lambda T: T[:, :3, 3] - target,
        lambda T: readings_from_arrays("contact", labels=labels),
        {"contact_noise_m": declared, "contact_distances": tuple(distances)},
    )


def _plane(rng: np.random.Generator, samples: int, arm: Arm, noise: float, declared: float) -> _Scene:
    normals = np.array([[0.0, 0.0, 1.0], [1.0, 0.1, 0.1], [0.1, 1.0, 0.2]])
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    centres = np.array([_place(rng, arm, angle) for angle in (0.0, 0.6, -0.9)])
    group, error = np.arange(samples) % 3, noise * rng.standard_normal(samples)
    labels = [f"plate{k + 1}" for k in group]
    return _Scene(
        lambda T: (np.sum(normals[group] * (T[:, :3, 3] - centres[group]), 1) - error)[:, None],
        lambda T: readings_from_arrays("plane", labels=labels),
        {"plane_noise_m": declared},
    )


def _distance(rng: np.random.Generator, samples: int, arm: Arm, noise: float, declared: float) -> _Scene:
    anchor, error = _place(rng, arm, 2.5) * 1.6, noise * rng.standard_normal(samples)
    return _Scene(
        lambda T: np.zeros((len(T), 0)),
        lambda T: readings_from_arrays("distance", value=np.linalg.norm(T[:, :3, 3] - anchor, axis=1) + error),
        {"distance_noise_m": declared},
    )


def _axis(rng: np.random.Generator, samples: int, arm: Arm, noise: float, declared: float) -> _Scene:
    error = 0.3 + noise * rng.standard_normal(samples)
    return _Scene(
        lambda T: np.zeros((len(T), 0)),
        lambda T: readings_from_arrays("axis", value=T[:, 2, 3] + error),
        {"axis_noise_m": declared, "axis": (0.0, 0.0, 1.0)},
    )


def _camera(fixed: bool) -> Callable[[np.random.Generator, int, Arm, float, float], _Scene]:
    def scene(rng: np.random.Generator, samples: int, arm: Arm, noise: float, declared: float) -> _Scene:
        corners = np.array(_BOARD.points)
        printed = corners + _BOARD.noise_m * rng.standard_normal(corners.shape)
        middle = corners.mean(0)
        facing = np.diag([1.0, -1.0, -1.0])  # the board's z towards the camera
        turn = Rotation.from_rotvec(_TILT * rng.uniform(-1, 1, (samples, 3)) * [1, 1, 2]).as_matrix()
        wide = 0.3 * arm.reach if fixed else 0.1
        far = (0.9 if fixed else 0.35) + wide * rng.uniform(-1, 1, samples)
        seen = np.tile(np.eye(4), (samples, 1, 1))  # of the board in the camera
        seen[:, :3, :3] = facing @ turn
        aside = wide * rng.uniform(-1, 1, (samples, 2))
        centre = np.concatenate([aside, far[:, None]], 1)
        seen[:, :3, 3] = centre - seen[:, :3, :3] @ middle
        centre_of_work = _place(rng, arm, 0.0)
        T = np.eye(4)
        if fixed:  # looks along −x at the arm
            T[:3, :3] = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
            T[:3, 3] = centre_of_work + np.array([0.9, 0.0, 0.0])
            target = T @ seen
        else:  # the board lies on the table, its z upwards
            T[:3, 3] = centre_of_work * [1, 1, 0.2] - middle
            target = T @ np.linalg.inv(seen)
        lens = Lens(np.array([_CAMERA[key] for key in ("fx", "fy", "cx", "cy")]), np.array(_DISTORTION))
        error = noise * rng.standard_normal((samples, len(corners), 2))

        def off(tool: Array) -> Array:
            apart = Rotation.from_matrix(np.swapaxes(target[:, :3, :3], 1, 2) @ tool[:, :3, :3]).as_rotvec()
            return np.concatenate([tool[:, :3, 3] - target[:, :3, 3], apart], 1)

        def readings(tool: Array) -> Readings:
            in_camera = np.linalg.inv(T) @ tool if fixed else np.linalg.inv(tool) @ T
            points = printed @ np.swapaxes(in_camera[:, :3, :3], 1, 2) + in_camera[:, None, :3, 3]
            pixels = np.asarray(project(lens, jnp.asarray(points))) + error
            inside = (pixels > 0).all(2) & (pixels < [_CAMERA["width"], _CAMERA["height"]]).all(2)
            pixels[~inside | (points[..., 2] <= 0)] = np.nan
            return readings_from_arrays("camera", pixels=pixels)

        mounted = "fixed" if fixed else "on_flange"
        fx, fy, cx, cy, width, height = _CAMERA.values()
        camera = CameraSettings(mounted, fx, fy, cx, cy, _DISTORTION, width, height)
        return _Scene(off, readings, {"pixel_noise_px": declared, "camera": camera, "board": _BOARD})

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
    return frames.transform_from_row([*TOOLS[reading], 0.0, 0.0, 0.0])
