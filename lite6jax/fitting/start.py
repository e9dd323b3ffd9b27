"""A start for the sensor frame and the tool, wherever they are, in closed form from the nominal chain."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.floating]

_ROUNDS = 12
_MOST_SAMPLES = 3000
_DETERMINED = 0.01
"""Least singular value over the largest: below, as in motions about two axes, nine cosines are not determined, from
which the rotation would come; it is 2e-4 for a positioner of two axes and above 0.1 for arms."""
_FEW = 40
"""Samples that tell rotations apart."""


def frames_from_poses(
    flange: Array, position: Array, rotation: Array | None, frame: Array | None, tool: Array | None
) -> tuple[Array, Array]:
    """The sensor frame and the tool that carry nominal flange poses to measured ones.

    With both unknown, p_k = A y_k − b − R_k t is linear in A = R_sensor_baseᵀ, b = A t_sensor_base and the tool's
    translation t; A is projected on the rotations and the rest solved again. Samples are reweighted (Cauchy, scale from
    the median) so that outliers have little weight.

    Args:
        flange: nominal `T_base_flange` `(sample, 4, 4)`.
        position: measured, `(sample, 3)` m, sensor frame.
        rotation: measured, `(sample, 3, 3)`, or None.
        frame: `T_sensor_base` `(4, 4)`, or None where unknown.
        tool: `T_flange_tool` `(4, 4)`, or None where unknown; its rotation is the identity where none was measured.

    Returns:
        `T_sensor_base` and `T_flange_tool`, `(4, 4)` each.
    """
    if len(flange) > _MOST_SAMPLES:
        chosen = np.linspace(0, len(flange) - 1, _MOST_SAMPLES).astype(int)
        flange, position = flange[chosen], position[chosen]
        rotation = None if rotation is None else rotation[chosen]
    R, p = flange[:, :3, :3], flange[:, :3, 3]
    weight = np.ones(len(p))
    T_frame = np.eye(4) if frame is None else frame.copy()
    T_tool = np.eye(4) if tool is None else tool.copy()
    determined = frame is not None or tool is not None or _cosines(R, p, position, weight)[1] > _DETERMINED
    if not determined:
        T_frame[:3, :3], T_tool[:3, 3], T_frame[:3, 3] = _best_of_many(R, p, position)
    for k in range(_ROUNDS):
        if frame is None and tool is None:
            if determined and k < _ROUNDS // 2:
                T_frame[:3, :3] = _nearest_rotation(_cosines(R, p, position, weight)[0]).T
            else:
                T_frame[:3, :3] = _turned_frame(R, p, position, weight, T_frame, T_tool)
            T_tool[:3, 3], T_frame[:3, 3] = _translations(R, p, position, weight, T_frame[:3, :3])
        elif frame is None:
            points = p + R @ T_tool[:3, 3]
            T_frame = _registration(points, position, weight)
        elif tool is None:
            seen = (position - T_frame[:3, 3]) @ T_frame[:3, :3]
            T_tool[:3, 3] = _solve(R, seen - p, weight)
        distance = np.linalg.norm(position - (p + R @ T_tool[:3, 3]) @ T_frame[:3, :3].T - T_frame[:3, 3], axis=1)
        scale = max(float(np.median(distance)), 1e-9)
        weight = 1 / (1 + (distance / (2 * scale)) ** 2)
    if tool is None and rotation is not None:
        relative = np.swapaxes(T_frame[:3, :3] @ R, 1, 2) @ rotation
        T_tool[:3, :3] = _nearest_rotation(np.einsum("s,sij->ij", weight, relative))
    return T_frame, T_tool


def _cosines(R: Array, p: Array, position: Array, weight: Array) -> tuple[Array, float]:
    """The nine of the base's axes in the sensor's, and how well they are determined, from 1 down to 0."""
    center = position.mean(0)
    size = max(float(np.abs(position - center).max()), 1e-9)
    y = (position - center) / size
    rows = np.zeros((len(p), 3, 15))
    for i in range(3):
        rows[:, i, 3 * i : 3 * i + 3] = y
        rows[:, i, 9 + i] = -1.0
    rows[:, :, 12:] = -R
    A = (np.sqrt(weight)[:, None, None] * rows).reshape(-1, 15)
    found, _, _, singular = np.linalg.lstsq(A, (np.sqrt(weight)[:, None] * p).ravel(), rcond=1e-9)
    determined = float(singular[-1] / singular[0]) if A.shape[0] >= 15 else 0.0
    return found[:9].reshape(3, 3), determined


def _best_of_many(R: Array, p: Array, position: Array) -> tuple[Array, Array, Array]:
    """The sensor frame's rotation and both translations from the best of many rotations, on some of the samples."""
    few = np.unique(np.linspace(0, len(p) - 1, _FEW).astype(int))
    R, p, position, weight = R[few], p[few], position[few], np.ones(len(few))
    found = []
    for start in Rotation.create_group("O").as_matrix():
        T_frame, T_tool = np.eye(4), np.eye(4)
        T_frame[:3, :3] = start
        for _ in range(_ROUNDS // 2):
            T_tool[:3, 3], T_frame[:3, 3] = _translations(R, p, position, weight, T_frame[:3, :3])
            T_frame[:3, :3] = _turned_frame(R, p, position, weight, T_frame, T_tool)
        T_tool[:3, 3], T_frame[:3, 3] = _translations(R, p, position, weight, T_frame[:3, :3])
        missed = position - (p + R @ T_tool[:3, 3]) @ T_frame[:3, :3].T - T_frame[:3, 3]
        found.append((float(np.median(np.linalg.norm(missed, axis=1))), len(found), T_frame, T_tool))
    _, _, T_frame, T_tool = min(found, key=lambda one: one[:2])
    return T_frame[:3, :3], T_tool[:3, 3], T_frame[:3, 3]


def _translations(R: Array, p: Array, position: Array, weight: Array, R_frame: Array) -> tuple[Array, Array]:
    """Of the tool and the sensor frame, whose rotation is given."""
    columns = np.concatenate([R_frame @ R, np.broadcast_to(np.eye(3), R.shape)], 2)
    found = _solve(columns, position - p @ R_frame.T, weight)
    return found[:3], found[3:]


def _turned_frame(R: Array, p: Array, position: Array, weight: Array, T_frame: Array, T_tool: Array) -> Array:
    """A Gauss–Newton step of the sensor frame's rotation, with both translations free."""
    turned = (p + R @ T_tool[:3, 3]) @ T_frame[:3, :3].T
    x, y, z = turned.T
    o = np.zeros_like(x)
    cross = np.stack([np.stack(row, -1) for row in ([o, z, -y], [-z, o, x], [y, -x, o])], -2)
    columns = np.concatenate([cross, T_frame[:3, :3] @ R, np.broadcast_to(np.eye(3), R.shape)], 2)
    step = _solve(columns, position - turned - T_frame[:3, 3], weight)[:3]
    return Rotation.from_rotvec(step).as_matrix() @ T_frame[:3, :3]


def _registration(points: Array, position: Array, weight: Array) -> Array:
    """The rigid transform that carries points to positions (Kabsch, Acta Cryst. A32, 1976)."""
    w = weight / weight.sum()
    a, b = w @ points, w @ position
    T = np.eye(4)
    T[:3, :3] = _nearest_rotation(np.einsum("s,si,sj->ij", w, position - b, points - a))
    T[:3, 3] = b - T[:3, :3] @ a
    return T


def _solve(columns: Array, target: Array, weight: Array) -> Array:
    """Weighted least squares of `(sample, 3, unknown)` columns; the shortest solution where it is not unique."""
    root = np.sqrt(weight)[:, None]
    A = (root[:, :, None] * columns).reshape(-1, columns.shape[2])
    return np.linalg.lstsq(A, (root * target).reshape(-1), rcond=1e-9)[0]


def _nearest_rotation(M: Array) -> Array:
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
