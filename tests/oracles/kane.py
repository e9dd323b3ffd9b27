"""Torques and forces of a serial arm of revolute and prismatic joints, in plain NumPy, by Kane's equations.

τ_j = Σ over bodies of m (a − g) · ∂v/∂q̇_j + (I α + ω × I ω) · ∂ω/∂q̇_j, in the axes of the base (T. Kane, D. Levinson,
Dynamics: Theory and Applications, 1985, ch. 6); the library uses recursive Newton–Euler in moving axes.
"""

import numpy as np

GRAVITY = np.array([0.0, 0.0, -9.81])


def rotation(axis, angle):
    """Rodrigues: `(sample, 3, 3)` of a unit axis `(3,)` and angles `(sample,)`."""
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + s * K + (1 - c) * (K @ K)


def turned(roll, pitch, yaw):
    """(3, 3), Rz(yaw) Ry(pitch) Rx(roll)."""
    parts = [rotation(axis, np.array([angle]))[0] for axis, angle in zip(np.eye(3), (roll, pitch, yaw), strict=True)]
    return parts[2] @ parts[1] @ parts[0]


def torques(rows, sliding, bodies, q, dq, ddq, gravity=GRAVITY):
    """`(sample, joint)` Nm, N of prismatic joints, that motors exert along or about z of their joints.

    Args:
        rows: for each joint x y z roll pitch yaw of its frame in the previous one.
        sliding: the prismatic joints, from 0.
        bodies: for each link its mass, its centre `(3,)` and its inertia `(3, 3)` about that, in the joint's frame.
        q, dq, ddq: `(sample, joint)`.
    """
    samples, joints = q.shape
    R, p = np.tile(np.eye(3), (samples, 1, 1)), np.zeros((samples, 3))
    v, a, w, alpha = (np.zeros((samples, 3)) for _ in range(4))
    linear, angular = np.zeros((samples, joints, 3)), np.zeros((samples, joints, 3))  # of the origin, by each rate
    total = np.zeros((samples, joints))
    for i, (row, (mass, center, inertia)) in enumerate(zip(rows, bodies, strict=True)):
        frame = turned(*row[3:])
        axis = R @ frame[:, 2]
        offset = R @ np.asarray(row[:3], float)
        if i in sliding:
            offset = offset + q[:, i, None] * axis
        # a point fixed in the link before, and then what the joint itself adds
        linear = linear + np.cross(angular, offset[:, None])
        v = v + np.cross(w, offset)
        a = a + np.cross(alpha, offset) + np.cross(w, np.cross(w, offset))
        p = p + offset
        if i in sliding:
            linear[:, i] = axis
            a = a + ddq[:, i, None] * axis + 2 * dq[:, i, None] * np.cross(w, axis)
            v = v + dq[:, i, None] * axis
            R = R @ frame
        else:
            angular[:, i] = axis
            alpha = alpha + ddq[:, i, None] * axis + dq[:, i, None] * np.cross(w, axis)
            w = w + dq[:, i, None] * axis
            R = R @ frame @ rotation(np.array([0.0, 0.0, 1.0]), q[:, i])
        c = R @ np.asarray(center, float)
        acceleration = a + np.cross(alpha, c) + np.cross(w, np.cross(w, c)) - gravity
        tensor = R @ inertia @ np.swapaxes(R, 1, 2)
        moment = np.einsum("sij,sj->si", tensor, alpha) + np.cross(w, np.einsum("sij,sj->si", tensor, w))
        total += mass * np.einsum("sjk,sk->sj", linear + np.cross(angular, c[:, None]), acceleration)
        total += np.einsum("sjk,sk->sj", angular, moment)
    return total
