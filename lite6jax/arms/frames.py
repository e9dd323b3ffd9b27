"""Rigid transforms in NumPy, so that reading a file compiles nothing."""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating]

BLOCK = 4096
"""Samples whose frames stay in a core's cache: those of all samples would also take a kilobyte each."""

# Quarter turns, frequent in files, are exact: cos(pi / 2) is 6e-17 in floats, and 0 is meant.
_QUARTER = np.pi / 2


def _cos_sin(angle: float) -> tuple[float, float]:
    turns = angle / _QUARTER
    if turns == round(turns) and abs(turns) < 8:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(turns) % 4]
    return float(np.cos(angle)), float(np.sin(angle))


def rotation_from_rpy(rpy: ArrayLike) -> Array:
    """The rotation `Rz(yaw) Ry(pitch) Rx(roll)`, exact at multiples of a quarter turn.

    Args:
        rpy: (3,) roll, pitch, yaw in rad.

    Returns:
        (3, 3) rotation.
    """
    (cr, sr), (cp, sp), (cy, sy) = (_cos_sin(float(angle)) for angle in np.asarray(rpy, float))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_from_rotation(rotation: ArrayLike) -> Array:
    """Roll, pitch and yaw of a rotation, the inverse of `rotation_from_rpy`, accurate at every pitch.

    Yaw follows from the first column. `Rz(-yaw) R` is `Ry(pitch) Rx(roll)`, whose middle row gives roll without a
    division by cos(pitch), which vanishes at +-90 deg.

    Returns:
        (3,) rad, pitch within +-pi/2; yaw is zero at the poles, where only roll -+ yaw is defined.
    """
    R = np.asarray(rotation, float)
    cos_pitch = np.hypot(R[0, 0], R[1, 0])
    yaw = np.arctan2(R[1, 0], R[0, 0]) if cos_pitch > 1e-15 else 0.0
    c, s = _cos_sin(float(yaw))
    roll = np.arctan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return np.array([roll, np.arctan2(-R[2, 0], cos_pitch), yaw]) + 0.0  # no minus zeros


def transform_from_row(row: ArrayLike) -> Array:
    """(4, 4) transform of one row x y z roll pitch yaw, in m and rad."""
    row = np.asarray(row, float)
    T = np.eye(4)
    T[:3, :3] = rotation_from_rpy(row[3:])
    T[:3, 3] = row[:3]
    return T


def row_from_transform(transform: ArrayLike) -> Array:
    """(6,) x y z roll pitch yaw of a (4, 4) transform, in m and rad."""
    T = np.asarray(transform, float)
    return np.concatenate([T[:3, 3], rpy_from_rotation(T[:3, :3])])


def is_rotation(matrix: ArrayLike) -> bool:
    """Whether `(3, 3)` numbers are a rotation: orthonormal to 1e-9, and no reflection."""
    R = np.asarray(matrix, float)
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= 1e-9 and np.linalg.det(R) > 0)


def joint_motions(position: ArrayLike, sliding: tuple[int, ...] = ()) -> Array:
    """`Rz(q)`, or `Tz(q)` for the prismatic joints in `sliding`, as transforms: (..., joint) rad, m to (..., 4, 4)."""
    position = np.asarray(position, float)
    slides = np.isin(np.arange(position.shape[-1]), sliding)
    angle = np.where(slides, 0.0, position)
    T = np.zeros((*angle.shape, 4, 4))
    T[..., 0, 0] = T[..., 1, 1] = np.cos(angle)
    T[..., 1, 0] = np.sin(angle)
    T[..., 0, 1] = -T[..., 1, 0]
    T[..., 2, 2] = T[..., 3, 3] = 1.0
    T[..., 2, 3] = np.where(slides, position, 0.0)
    return T


def chain(links: Array, joint_position: ArrayLike, sliding: tuple[int, ...] = ()) -> Array:
    """The flange of a chain of fixed links, each followed by a joint about its z: `T = prod_i links_i Rz(q_i)`.

    Args:
        links: (joint, 4, 4).
        joint_position: (..., joint) rad, and m of prismatic joints.
        sliding: the prismatic joints, counted from 0, which move along their z.

    Returns:
        `T_base_flange` (..., 4, 4).
    """
    position = np.asarray(joint_position, float)
    each = position.reshape(-1, position.shape[-1])
    T = np.empty((len(each), 4, 4))
    for first in range(0, len(each), BLOCK):
        *_, last = walk(links, each[first : first + BLOCK], sliding)
        T[first : first + BLOCK] = last
    return T.reshape(*position.shape[:-1], 4, 4)


def sample_joints(dof: int, count: int = 64) -> Array:
    """(count, dof) rad, or m: joint positions that fill +-pi evenly and do not depend on random numbers.

    The additive recurrence of the generalised golden ratio (M. Roberts, 2018).
    """
    ratio = 2.0
    for _ in range(60):
        ratio = (1 + ratio) ** (1 / (dof + 1))
    steps = ratio ** -np.arange(1.0, dof + 1)
    return 2 * np.pi * (np.outer(np.arange(1, count + 1), steps) % 1.0) - np.pi


def walk(
    links: Iterable[Array], joint_position: Array, sliding: tuple[int, ...] = (), start: Array | None = None
) -> Iterator[Array]:
    """The frames of a chain one after the other: the base, and the frame after each joint's motion, `(sample, 4, 4)`.

    A link is one product of two matrices for all samples, and a joint combines two columns: products of small matrices
    take several times as long.

    Args:
        links: `(4, 4)` each.
        joint_position: `(sample, joint)` rad, and m of prismatic joints.
        sliding: the prismatic joints, counted from 0.
        start: `(4, 4)`, the base in the frame that is wanted; its own where not given.
    """
    samples = len(joint_position)
    T = np.broadcast_to(np.eye(4) if start is None else start, (samples, 4, 4))
    yield T
    for i, link in enumerate(links):
        T = (T.reshape(-1, 4) @ link).reshape(-1, 4, 4)
        q = joint_position[:, i, None]
        if i in sliding:
            T[:, :, 3] += q * T[:, :, 2]
        else:
            cos, sin, x, y = np.cos(q), np.sin(q), T[:, :, 0], T[:, :, 1]
            T[:, :, 0], T[:, :, 1] = cos * x + sin * y, cos * y - sin * x
        yield T


def links_from_dh(dh: ArrayLike, convention: str = "standard") -> tuple[Array, Array]:
    """The links of `chain` for a DH table.

    Standard: `A_i = Rz(q + theta_off) Tz(d) Tx(a) Rx(alpha)`. Modified (J. Craig, Introduction to Robotics, 1986):
    `A_i = Rx(alpha) Tx(a) Rz(q + theta_off) Tz(d)`, whose alpha and a precede the joint.

    Args:
        dh: (joint, 4) theta_off, d, a, alpha in rad and m.
        convention: `standard` or `modified`.

    Returns:
        the links (joint, 4, 4), and the transform after the last joint (4, 4).
    """
    links, before = [], np.eye(4)
    for theta, d, a, alpha in np.asarray(dh, float):
        across = transform_from_row([a, 0, 0, alpha, 0, 0])
        along = transform_from_row([0, 0, d, 0, 0, theta])
        links.append((across if convention == "modified" else before) @ along)
        before = np.eye(4) if convention == "modified" else across
    return np.stack(links), before


def aligned(links: Array, nominal: Array | None = None) -> Array:
    """The same chain with each joint's frame, but the last one's, moved along and turned about the joint's own axis.

    Where a frame stands on its axis is free. It goes where the nominal chain has it: standard DH of axes that are
    nearly parallel puts it hundreds of metres away, and other tables elsewhere than a URDF.

    Args:
        links: (joint, 4, 4).
        nominal: (joint, 4, 4) of the same joints; None for the point next to the frame before, without a turn.

    Returns:
        (joint, 4, 4) links of the same flange poses, to rounding of the largest length.
    """
    T = N = before = np.eye(4)
    moved = []
    for i, link in enumerate(links):
        shift = np.eye(4)
        near = (T @ before)[:3, 3]
        T = T @ link
        if nominal is not None:
            N = N @ nominal[i]
            near, turn = N[:3, 3], T[:3, :3].T @ N[:3, :3]
            shift = transform_from_row([0, 0, 0, 0, 0, np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])])
        shift[2, 3] = T[:3, 2] @ (near - T[:3, 3])
        shift = shift if i < len(links) - 1 else np.eye(4)
        moved.append(np.linalg.inv(before) @ link @ shift)
        before = shift
    return np.stack(moved)
