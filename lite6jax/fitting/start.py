"""A start for the sensor frame and the tool, wherever they are, in closed form from the nominal chain."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

_ROUNDS = 12
_MOST_SAMPLES = 3000


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
    for _ in range(_ROUNDS):
        if frame is None and tool is None:
            T_frame[:3, :3] = _frame_rotation_beside_tool(R, p, position, weight)
            columns = np.concatenate([T_frame[:3, :3] @ R, np.broadcast_to(np.eye(3), R.shape)], 2)
            found = _solve(columns, position - p @ T_frame[:3, :3].T, weight)
            T_tool[:3, 3], T_frame[:3, 3] = found[:3], found[3:]
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


def _frame_rotation_beside_tool(R: Array, p: Array, position: Array, weight: Array) -> Array:
    center = position.mean(0)
    size = max(float(np.abs(position - center).max()), 1e-9)
    y = (position - center) / size
    rows = np.zeros((len(p), 3, 15))
    for i in range(3):
        rows[:, i, 3 * i : 3 * i + 3] = y
        rows[:, i, 9 + i] = -1.0
    rows[:, :, 12:] = -R
    A = _solve(rows, p, weight)[:9].reshape(3, 3)
    return _nearest_rotation(A).T


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
