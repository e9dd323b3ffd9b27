"""The nominal arm that each of many calibrated chains is near, at once: the common case of `factory.recognise`."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm, sample_joints
from lite6jax.arms.factory import PROBE, RECOGNISED_WITHIN

Array = NDArray[np.floating]


@np.errstate(over="ignore", invalid="ignore")  # absurd numbers are far from every arm
def nearest_arms(kinematics: Array, arms: Sequence[Arm]) -> list[Arm | None]:
    """The nearest arm of each chain; None where none is near enough, of which `factory.recognise` says why.

    Args:
        kinematics: `(chain, joint, 6)` m and rad, of revolute joints.
        arms: with as many of them.
    """
    q = sample_joints(kinematics.shape[1])
    own = _points(_links(kinematics), arms[0].T_joint_flange, q)
    squares = [
        np.mean(np.sum((_points(arm.links[None], arm.T_joint_flange, q) - own) ** 2, -1), (1, 2)) for arm in arms
    ]
    distance = np.sqrt(np.stack(squares, 1))
    best = np.argmin(np.where(np.isfinite(distance), distance, np.inf), 1)
    return [arms[i] if row[i] <= RECOGNISED_WITHIN else None for row, i in zip(distance, best, strict=True)]


def _links(kinematics: Array) -> Array:
    """(chain, joint, 4, 4) of rows x y z roll pitch yaw."""
    (cr, cp, cy), (sr, sp, sy) = (np.moveaxis(f(kinematics[..., 3:]), -1, 0) for f in (np.cos, np.sin))
    T = np.zeros((*kinematics.shape[:-1], 4, 4))
    T[..., 0, 0], T[..., 0, 1], T[..., 0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    T[..., 1, 0], T[..., 1, 1], T[..., 1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    T[..., 2, 0], T[..., 2, 1], T[..., 2, 2] = -sp, cp * sr, cp * cr
    T[..., :3, 3] = kinematics[..., :3]
    T[..., 3, 3] = 1.0
    return T


def _points(links: Array, after: Array, q: Array) -> Array:
    """(chain, sample, 3, 3) the flange's origin and two points beside it, in the base frame."""
    samples = len(q)
    # rows of every sample below each other, so that a link is one matrix product
    T = np.broadcast_to(np.eye(4)[:3], (len(links), samples, 3, 4))
    for i in range(links.shape[1]):
        T = (T.reshape(len(links), -1, 4) @ links[:, i]).reshape(T.shape)
        x, y = T[..., 0].copy(), T[..., 1].copy()
        c, s = np.cos(q[:, i])[:, None], np.sin(q[:, i])[:, None]
        T[..., 0], T[..., 1] = c * x + s * y, c * y - s * x
    T = (T.reshape(len(links), -1, 4) @ after).reshape(T.shape)
    origin = T[..., 3]
    return np.stack([origin, origin + PROBE * T[..., 0], origin + PROBE * T[..., 1]], 2)
