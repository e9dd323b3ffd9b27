"""The numerical inverse kinematics of an emulated arm."""

import numpy as np
from numpy.typing import NDArray

from lite6jax.emulator.body import Body

Array = NDArray[np.floating]

_REACH = 0.1
"""m per rad, the weight of orientation errors relative to position errors."""


def inverse_kinematics(body: Body, goal: Array, reference: Array, limited: bool = True) -> Array | None:
    """`(joint,)` rad at which the flange is at `goal` `(4, 4)`, close to the reference.

    Damped Gauss-Newton from the reference and, if that does not converge, from 64 other joint positions, of whose
    solutions the closest is chosen.

    Args:
        goal: T_base_flange.
        reference: `(joint,)` rad.
        limited: whether the joint limits hold.

    Returns:
        None if no solution is found.
    """
    lower, upper = body.arm.joint_limits.T
    rng = np.random.default_rng(0)
    others = rng.uniform(np.maximum(lower, -np.pi), np.minimum(upper, np.pi), (64, body.arm.dof))
    for starts in (reference[None], others):
        q = _converge(body, goal, starts)
        q = q + 2 * np.pi * np.round((reference - q) / (2 * np.pi))
        if limited:
            q = q - 2 * np.pi * (q > upper + 1e-9) + 2 * np.pi * (q < lower - 1e-9)
            q = q[((q >= lower - 1e-9) & (q <= upper + 1e-9)).all(axis=1)]
        if len(q):
            return q[np.argmin(np.abs(q - reference).max(axis=1))]
    return None


def _converge(body: Body, goal: Array, q: Array) -> Array:
    """The solutions `(solution, joint)` to which the starts `q` `(start, joint)` converge."""
    for _ in range(60):
        T = body.joint_frames(q)
        flange = T[-1] @ body.arm.T_joint_flange
        error = _twist(flange, goal)
        axis = np.moveaxis(T[..., :3, 2], 0, -1)
        lever = flange[..., :3, 3, None] - np.moveaxis(T[..., :3, 3], 0, -1)
        J = np.concatenate([np.cross(axis, lever, axis=1), _REACH * axis], axis=1)
        normal = np.swapaxes(J, 1, 2) @ J + 1e-9 * np.eye(q.shape[1])
        step = np.linalg.solve(normal, np.swapaxes(J, 1, 2) @ error[..., None])[..., 0]
        q = q + step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / 0.5)
    return q[np.linalg.norm(_twist(body.flange(q), goal), axis=1) < 1e-8]


def _twist(here: Array, goal: Array) -> Array:
    """`(..., 6)` from one frame to another: translation in m, then rotation vector in rad times `_REACH`."""
    R = goal[:3, :3] @ np.swapaxes(here[..., :3, :3], -1, -2)
    axis = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, (np.trace(R, axis1=-2, axis2=-1)[..., None] - 1) / 2)
    turn = axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 1.0)
    return np.concatenate([goal[:3, 3] - here[..., :3, 3], _REACH * turn], -1)
