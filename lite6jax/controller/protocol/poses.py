"""Poses as on the wire: x y z in mm and roll pitch yaw in rad, R = Rz(yaw) Ry(pitch) Rx(roll), and rotation vectors."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating]

MM = 1e3
"""Millimetres in a metre."""


def wire_pose(transform: ArrayLike) -> Array:
    """`(..., 6)` x y z roll pitch yaw in mm and rad of `(..., 4, 4)` in m.

    Pitch is within ±90°. At ±90°, where only roll ∓ yaw is defined, yaw is zero.
    """
    T = np.asarray(transform, float)
    R = T[..., :3, :3]
    cos_pitch = np.hypot(R[..., 0, 0], R[..., 1, 0])
    yaw = np.where(cos_pitch > 1e-15, np.arctan2(R[..., 1, 0], R[..., 0, 0]), 0.0)
    c, s = np.cos(yaw), np.sin(yaw)
    # roll from Ry(pitch) Rx(roll), without a division by cos(pitch), which vanishes at ±90°
    roll = np.arctan2(s * R[..., 0, 2] - c * R[..., 1, 2], c * R[..., 1, 1] - s * R[..., 0, 1])
    pitch = np.arctan2(-R[..., 2, 0], cos_pitch)
    return np.concatenate([MM * T[..., :3, 3], np.stack([roll, pitch, yaw], -1)], axis=-1)


def axis_angle_of_wire_pose(pose: ArrayLike) -> Array:
    """`(..., 6)` x y z rx ry rz of a wire pose, with the rotation vector in rad, its angle within [0, π]."""
    T = transform_of_wire_pose(pose)
    R = T[..., :3, :3]
    # from the quaternion's largest component, which is accurate near a half turn
    w, x, y, z = R.trace(axis1=-2, axis2=-1), *np.moveaxis(R.diagonal(axis1=-2, axis2=-1), -1, 0)
    square = np.stack([1 + w, 1 + 2 * x - w, 1 + 2 * y - w, 1 + 2 * z - w], -1)
    a, b, c = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    d, e, f = R[..., 1, 0] + R[..., 0, 1], R[..., 0, 2] + R[..., 2, 0], R[..., 2, 1] + R[..., 1, 2]
    rows = np.stack(
        [
            np.stack([square[..., 0], a, b, c], -1),
            np.stack([a, square[..., 1], d, e], -1),
            np.stack([b, d, square[..., 2], f], -1),
            np.stack([c, e, f, square[..., 3]], -1),
        ],
        -2,
    )
    best = np.argmax(square, -1)[..., None, None]
    quaternion = np.take_along_axis(rows, best, -2)[..., 0, :]
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion *= np.where(quaternion[..., :1] < 0, -1.0, 1.0)
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, quaternion[..., :1])
    vector = quaternion[..., 1:] * np.where(sine > 0, angle / np.where(sine > 0, sine, 1.0), 2.0)
    return np.concatenate([np.asarray(pose, float)[..., :3], vector], -1)


def transform_of_wire_pose(pose: ArrayLike) -> Array:
    """`(..., 4, 4)` in m of `(..., 6)` x y z roll pitch yaw in mm and rad."""
    x, y, z, roll, pitch, yaw = np.moveaxis(np.asarray(pose, float), -1, 0)
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (roll, pitch, yaw))
    o, i = np.zeros_like(x), np.ones_like(x)
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x / MM),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y / MM),
        (-sp, cp * sr, cp * cr, z / MM),
        (o, o, o, i),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)
