"""Readings that are no poses: what a sensor reads of a tool's poses, where its places are, and how an arm comes there.

Shares no code with the library.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.chain import Array, Chain, Poses, rotation_from_vector, vector_from_rotation
from benchmarks.concealed.plain_physics import Effects, Motion, Setup, poses
from benchmarks.concealed.view import Reading, transform

CONTACT_NOISE, PLANE_NOISE, DISTANCE_NOISE, AXIS_NOISE, PIXEL_NOISE = 1e-4, 2e-5, 5e-5, 2e-5, 0.15
"""One standard deviation, m, and px."""
APART, APART_NOISE = 0.05, 5e-5  # m, of two sockets on one plate, and its standard deviation
_PLATE = 0.15  # m, half a plate's side
_FOCUS, _CENTRE, _SIZE = np.array([1450.0, 1452.0]), np.array([958.0, 603.0]), np.array([1920.0, 1200.0])
_DISTORTION = (-0.11, 0.09, 4e-4, -3e-4, -0.02)
_COLUMNS, _ROWS, _SQUARE, _PRINTED = 6, 4, 0.02, 2e-5
"""Inner corners of the board, m, and m of each coordinate of a corner, one standard deviation."""
_FAR = (0.9, 0.35)  # m, of a camera that stands, and of one on the flange, from the board
_STARTS, _STEPS, _LONGEST, _REACHED = 4, 60, 0.3, 1e-7
"""Starts for each sample; steps; rad of a joint in one; m and rad."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Where a sensor's places are."""

    wanted: Array | None  # `(start, 4, 4)`, where the tool is to be in the base's frame; None where that is anywhere
    turned: bool  # whether its orientation matters
    group: NDArray[np.integer]  # `(start,)`, the place of each
    sensor: Array  # `(4, 4)` T_sensor_base
    reading: Callable[[NDArray[np.integer]], Reading]  # of groups `(sample,)`
    # of poses without noise and groups, what a table has of them; `inside` is which rows it has
    columns: Callable[[Poses, NDArray[np.integer]], Mapping[str, Any]]
    said: Mapping[str, Any]  # what a sidecar says
    noise_m: float  # what of a position is about the noise


def draw_scene(sensor: str, rng: np.random.Generator, chain: Chain, rows: int) -> Scene:
    """Places within reach of an arm for a sensor, a key of `READERS`, and its noise."""
    return READERS[sensor](rng, float(np.sum(np.linalg.norm(chain.rows[:, :3], axis=1))), _STARTS * rows)


def _place(rng: np.random.Generator, size: float, angle: float) -> Array:
    radius, height = size * rng.uniform(0.4, 0.55), size * rng.uniform(0.1, 0.4)
    return np.array([radius * np.cos(angle), radius * np.sin(angle), height])


def _contact(rng: np.random.Generator, size: float, starts: int) -> Scene:
    points = []
    for angle in (-0.7, 0.6):
        along = rng.normal(size=3)
        points.append(_place(rng, size, angle))
        points.append(points[-1] + APART * along / np.linalg.norm(along))
    at, names = np.array(points), np.array(["left_a", "left_b", "right_a", "right_b"])
    known = np.zeros((2, 12))
    for k in range(2):
        along = (at[2 * k + 1] - at[2 * k]) / APART / APART_NOISE
        known[k, 6 * k : 6 * k + 6] = np.concatenate([-along, along])
    group = np.arange(starts) % 4

    def reading(group: NDArray[np.integer]) -> Reading:
        return Reading(3, lambda shown, x: (shown[1] - x.reshape(-1, 3)[group]) / CONTACT_NOISE, at.ravel(), known)

    wanted = _points(at[group] + rng.normal(0, CONTACT_NOISE, (starts, 3)))
    distances = [
        {"between": names[2 * k : 2 * k + 2].tolist(), "distance_m": APART, "noise_m": APART_NOISE} for k in (0, 1)
    ]
    said = {"pose_source": "touch", "contact_noise_m": CONTACT_NOISE, "contact_distances": distances}
    columns = lambda shown, group: {"contact": names[group]}  # noqa: E731
    return Scene(wanted, False, group, np.eye(4), reading, columns, said, CONTACT_NOISE)


def _plane(rng: np.random.Generator, size: float, starts: int) -> Scene:
    normals = np.eye(3)[[2, 0, 1]] + rng.normal(0, 0.15, (3, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    centres, names = np.array([_place(rng, size, angle) for angle in (0.0, 0.6, -0.8)]), np.array(["a", "b", "c"])
    group = np.arange(starts) % 3
    aside = rng.uniform(-_PLATE, _PLATE, (starts, 3))
    off = rng.normal(0, PLANE_NOISE, starts) - np.sum(normals[group] * aside, 1)
    wanted = _points(centres[group] + aside + off[:, None] * normals[group])
    none = np.zeros((0, 9))  # a plane that is not through the base's origin is its normal, of any length

    def reading(group: NDArray[np.integer]) -> Reading:
        read = lambda shown, x: np.sum(x.reshape(-1, 3)[group] * shown[1], 1)[:, None] / PLANE_NOISE  # noqa: E731
        return Reading(1, read, normals.ravel(), none)

    said = {"pose_source": "touch", "plane_noise_m": PLANE_NOISE}
    columns = lambda shown, group: {"plane": names[group]}  # noqa: E731
    return Scene(wanted, False, group, np.eye(4), reading, columns, said, PLANE_NOISE)


def _distance(rng: np.random.Generator, size: float, starts: int) -> Scene:
    anchor = 1.6 * _place(rng, size, 2.5)
    said = {"pose_source": "draw_wire", "distance_noise_m": DISTANCE_NOISE, "anchor_m": "unknown"}
    error = rng.normal(0, DISTANCE_NOISE, starts)
    return _anywhere("distance_m", lambda p, x: np.linalg.norm(p - x, axis=1), anchor, DISTANCE_NOISE, error, said)


def _axis(rng: np.random.Generator, size: float, starts: int) -> Scene:
    turn, error = rotation_from_vector(rng.normal(0, 0.02, 3)), rng.normal(0, AXIS_NOISE, starts)
    axes, own = turn.T, np.array([0.0, 0.0, rng.uniform(0.1, 0.5)])
    said = {"pose_source": "height_gauge", "axis_noise_m": AXIS_NOISE, "axis": "unknown"}
    return _anywhere("axis_m", lambda p, x: p @ (axes[2] + x[:2] @ axes[:2]) + x[2], own, AXIS_NOISE, error, said)


def _anywhere(
    column: str, read: Callable[[Array, Array], Array], own: Array, noise: float, error: Array, said: Mapping[str, Any]
) -> Scene:
    """Of a sensor that reads one number of a position, by three of its own, wherever the tool is."""

    def reading(group: NDArray[np.integer]) -> Reading:
        return Reading(1, lambda shown, x: read(shown[1], x)[:, None] / noise, own, np.zeros((0, 3)))

    def columns(shown: Poses, group: NDArray[np.integer]) -> Mapping[str, Any]:
        return {column: read(shown[1], own) + error[: len(group)]}

    return Scene(None, False, np.zeros(len(error), int), np.eye(4), reading, columns, said, noise)


def _camera(rng: np.random.Generator, size: float, starts: int, fixed: bool) -> Scene:
    count = _COLUMNS * _ROWS
    corners = _SQUARE * np.array([[k % _COLUMNS, k // _COLUMNS, 0.0] for k in range(count)])
    printed = corners + rng.normal(0, _PRINTED, corners.shape)
    far, error = _FAR[not fixed], rng.normal(0, PIXEL_NOISE, (starts, count, 2))
    wide = 0.3 * size if fixed else 0.1
    seen = np.tile(np.eye(4), (starts, 1, 1))  # the board in the camera, towards which it is turned
    seen[:, :3, :3] = np.diag([1.0, -1, -1]) @ rotation_from_vector(rng.uniform(-0.6, 0.6, (starts, 3)) * [1, 1, 2])
    aside = np.column_stack([rng.uniform(-wide, wide, (starts, 2)), far + wide * rng.uniform(-1, 1, starts)])
    seen[:, :3, 3] = aside - seen[:, :3, :3] @ corners.mean(0)
    stands, centre = np.eye(4), _place(rng, size, 0.0)
    if fixed:  # looks back at the arm
        stands[:3, :3] = [[0.0, 0, -1], [1, 0, 0], [0, -1, 0]]
        stands[:3, 3] = centre + far * np.eye(3)[0]
    else:
        stands[:3, 3] = centre * [1, 1, 0.2]
    stands = stands @ transform(rng.uniform(-0.1, 0.1, 3), np.zeros(3))

    def pixels(shown: Poses, board: Array) -> Array:
        R, p = shown
        points = board @ np.swapaxes(R, 1, 2) + p[:, None] if fixed else (board - p[:, None]) @ R
        return _projected(points)

    def reading(group: NDArray[np.integer]) -> Reading:
        known = np.eye(3 * count) / _PRINTED
        read = lambda shown, x: pixels(shown, x.reshape(-1, 3)).reshape(len(group), -1) / PIXEL_NOISE  # noqa: E731
        return Reading(2 * count, read, printed.ravel(), known)

    def columns(shown: Poses, group: NDArray[np.integer]) -> Mapping[str, Any]:
        uv = (pixels(shown, printed) + error[: len(group)]).reshape(-1, 2)
        corner = np.tile(np.arange(count), len(group))
        images = np.repeat(np.arange(len(group)), count)
        inside = ((uv > 0) & (uv < _SIZE)).all(1)
        return {"image": images, "corner": corner, "u_px": uv[:, 0], "v_px": uv[:, 1], "inside": inside}

    (fx, fy), (cx, cy), (width, height) = (pair.tolist() for pair in (_FOCUS, _CENTRE, _SIZE))
    lens = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "distortion": list(_DISTORTION)}
    said = {
        "pose_source": "camera",
        "pixel_noise_px": PIXEL_NOISE,
        "camera": {"mounted": "fixed" if fixed else "on_flange"} | lens | {"width": int(width), "height": int(height)},
        "board": {"columns": _COLUMNS, "rows": _ROWS, "square_m": _SQUARE, "noise_m": _PRINTED},
    }
    wanted, noise = stands @ (seen if fixed else np.linalg.inv(seen)), PIXEL_NOISE * far / _FOCUS[0]
    return Scene(wanted, True, np.zeros(starts, int), np.linalg.inv(stands), reading, columns, said, float(noise))


def _projected(points: Array) -> Array:
    """Pixels of points in a camera (OpenCV, calib3d: radial of three, tangential of two)."""
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    k1, k2, p1, p2, k3 = _DISTORTION
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent = np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y], -1
    )
    return bent * _FOCUS + _CENTRE


def _points(at: Array) -> Array:
    T = np.tile(np.eye(4), (len(at), 1, 1))
    T[:, :3, 3] = at
    return T


READERS: Mapping[str, Callable[[np.random.Generator, float, int], Scene]] = {
    "contact": _contact,
    "plane": _plane,
    "distance": _distance,
    "axis": _axis,
    "fixed_camera": lambda rng, size, starts: _camera(rng, size, starts, True),
    "flange_camera": lambda rng, size, starts: _camera(rng, size, starts, False),
}


# ------------------------------------------------------------------ how an arm comes there


def led(
    setup: Setup, hidden: Effects, motion: Motion, scene: Scene, wanted: Array, bounds: Array
) -> tuple[Motion, NDArray[np.bool_]]:
    """The motion that brings the tool to where it is wanted, and which samples come there (damped least squares).

    Args:
        setup: the arm with its tool.
        hidden: what moves the tool beside the chain.
        motion: where the joints start.
        scene: whether orientations matter.
        wanted: `(sample, 4, 4)`, in the base's frame.
        bounds: `(joint, 2)` rad.
    """
    in_base, reached = replace(setup, sensor=np.eye(4)), np.zeros(len(wanted), bool)
    for _ in range(_STEPS):
        R, p = poses(in_base, hidden, motion)
        off = wanted[:, :3, 3] - p
        if scene.turned:
            turn = np.einsum("sab,sb->sa", R, vector_from_rotation(np.swapaxes(R, 1, 2) @ wanted[:, :3, :3]))
            off = np.concatenate([off, turn], 1)
        reached = np.abs(off).max(1) < _REACHED
        if reached.all():
            break
        axes, origins = setup.chain.frames(motion.q)
        z = axes[:, :, :, 2]
        J = np.swapaxes(np.cross(z, p[:, None] - origins), 1, 2)
        if scene.turned:
            J = np.concatenate([J, np.swapaxes(z, 1, 2)], 1)
        H = J @ np.swapaxes(J, 1, 2) + 1e-8 * np.eye(J.shape[1])
        step = np.einsum("sij,si->sj", J, np.linalg.solve(H, off[:, :, None])[:, :, 0])
        step *= np.minimum(1.0, _LONGEST / np.maximum(np.abs(step).max(1), 1e-12))[:, None]
        motion = at_rest(motion, np.clip(motion.q + step, *bounds.T))
    return motion, reached


def at_rest(motion: Motion, q: Array) -> Motion:
    """The motion from rest to rest through other joint positions."""
    direction = np.concatenate([np.zeros((1, q.shape[1])), np.sign(np.diff(q, axis=0))])
    return replace(motion, q=q, direction=direction)


def chosen(scene: Scene, reached: NDArray[np.bool_], rows: int) -> NDArray[np.integer] | None:
    """As many starts of each place, one place after the other; None where too few come there."""
    groups = int(scene.group.max()) + 1
    each = [np.flatnonzero(reached & (scene.group == k))[: rows // groups] for k in range(groups)]
    return np.concatenate(each) if all(len(part) == rows // groups for part in each) else None
