"""Rigid transforms and rigid bodies in NumPy, so that reading a file compiles nothing."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.array_types import Array

BLOCK = 4096
"""Samples whose frames stay in a core's cache: those of all samples would also take a kilobyte each."""

# Quarter turns, frequent in files, are exact: cos(pi / 2) is 6e-17 in floats, and 0 is meant.
_QUARTER = np.pi / 2


def _cos_sin(angle: Array) -> tuple[Array, Array]:
    turns = angle / _QUARTER
    exact = (turns == np.round(turns)) & (np.abs(turns) < 8)
    quarter = np.where(exact, turns, 0.0).astype(int) % 4
    cos = np.array([1.0, 0.0, -1.0, 0.0])[quarter]
    sin = np.array([0.0, 1.0, 0.0, -1.0])[quarter]
    return np.where(exact, cos, np.cos(angle)), np.where(exact, sin, np.sin(angle))


def rotation_from_rpy(rpy: ArrayLike) -> Array:
    """Rotations `(..., 3, 3)`, `Rz(yaw) Ry(pitch) Rx(roll)`, of roll, pitch, yaw `(..., 3)` in rad.

    They are exact at multiples of a quarter turn.
    """
    cos, sin = _cos_sin(np.asarray(rpy, float))
    cr, cp, cy = np.moveaxis(cos, -1, 0)
    sr, sp, sy = np.moveaxis(sin, -1, 0)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def rpy_from_rotation(rotation: ArrayLike) -> Array:
    """Roll, pitch and yaw `(..., 3)` of rotations `(..., 3, 3)`, accurate at every pitch.

    Yaw follows from the first column. `Rz(-yaw) R` is `Ry(pitch) Rx(roll)`. Its middle row gives roll without a
    division by cos(pitch), which vanishes at +-90 deg.

    Returns:
        rad, pitch within +-pi/2; yaw is zero at the poles, where only roll -+ yaw is defined.
    """
    R = np.asarray(rotation, float)
    cos_pitch = np.hypot(R[..., 0, 0], R[..., 1, 0])
    yaw = np.where(cos_pitch > 1e-15, np.arctan2(R[..., 1, 0], R[..., 0, 0]), 0.0)
    c, s = _cos_sin(yaw)
    roll = np.arctan2(s * R[..., 0, 2] - c * R[..., 1, 2], c * R[..., 1, 1] - s * R[..., 0, 1])
    return np.stack([roll, np.arctan2(-R[..., 2, 0], cos_pitch), yaw], -1) + 0.0  # no minus zeros


def transform_from_row(row: ArrayLike) -> Array:
    """Transforms `(..., 4, 4)` of rows x y z roll pitch yaw `(..., 6)`, in m and rad."""
    row = np.asarray(row, float)
    T = np.zeros((*row.shape[:-1], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = rotation_from_rpy(row[..., 3:]), row[..., :3], 1.0
    return T


def row_from_transform(transform: ArrayLike) -> Array:
    """Rows x y z roll pitch yaw `(..., 6)` of transforms `(..., 4, 4)`, in m and rad."""
    T = np.asarray(transform, float)
    return np.concatenate([T[..., :3, 3], rpy_from_rotation(T[..., :3, :3])], -1)


def compare_transforms(a: ArrayLike, b: ArrayLike) -> tuple[Array, Array]:
    """Distances `(...,)` in m and angles `(...,)` in rad between transforms `(..., 4, 4)`.

    For rotation blocks A and B, ‖A − B‖ = 2 √2 sin(angle / 2), which small angles do not round away; the arccos of
    the trace is zero below 1e-8.
    """
    difference = np.asarray(a, float) - np.asarray(b, float)
    chord = np.linalg.norm(difference[..., :3, :3], axis=(-2, -1))
    distance = np.linalg.norm(difference[..., :3, 3], axis=-1)
    return np.asarray(distance), np.asarray(2 * np.arcsin(np.minimum(chord / np.sqrt(8), 1.0)))


def frames_at_zero(kinematics: ArrayLike) -> Array:
    """`(..., joint, 4, 4)`, each joint's frame in the base where every joint is at zero.

    Its z is the joint's axis. `kinematics` `(..., joint, 6)` are rows x y z (m) roll pitch yaw (rad).
    """
    T = transform_from_row(kinematics)
    for i in range(1, T.shape[-3]):
        T[..., i, :, :] = T[..., i - 1, :, :] @ T[..., i, :, :]
    return T


def is_rotation(matrix: ArrayLike) -> bool:
    """Tells whether `(3, 3)` numbers are a rotation: orthonormal to 1e-9, and no reflection."""
    R = np.asarray(matrix, float)
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= 1e-9 and np.linalg.det(R) > 0)


def chain(links: Array, joint_position: ArrayLike, sliding: tuple[int, ...] = ()) -> Array:
    """`T_base_flange` of a chain of fixed links, each followed by a joint about its z: `T = prod_i links_i Rz(q_i)`.

    Links are (joint, 4, 4), or with leading axes of many chains; positions are (..., joint) rad, or m of the joints in
    `sliding`, counted from 0, which move along their z. The axes of many chains come before those of the positions.
    """
    position = np.asarray(joint_position, float)
    flat_positions = position.reshape(-1, position.shape[-1])
    T = np.empty((*links.shape[:-3], len(flat_positions), 4, 4))
    for first in range(0, len(flat_positions), BLOCK):
        *_, T[..., first : first + BLOCK, :, :] = walk(
            np.moveaxis(links, -3, 0), flat_positions[first : first + BLOCK], sliding
        )
    return T.reshape(*links.shape[:-3], *position.shape[:-1], 4, 4)


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
    """The frames of a chain one after the other: the base, and the frame after each joint's motion, `(..., sample, 4,
    4)`.

    A link is one product of two matrices for all samples, and a joint combines two columns: products of small matrices
    take several times as long. Links are `(..., 4, 4)` each, leading axes being those of many chains, and positions
    `(sample, joint)` rad, or m of the joints in `sliding`. The base is at `start` `(4, 4)` in the frame that is wanted.
    """
    samples = len(joint_position)
    T = np.broadcast_to(np.eye(4) if start is None else start, (samples, 4, 4))
    yield T
    for i, link in enumerate(links):
        T = (T.reshape(*T.shape[:-3], 4 * samples, 4) @ link).reshape(*link.shape[:-2], samples, 4, 4)
        q = joint_position[:, i, None]
        if i in sliding:
            T[..., 3] += q * T[..., 2]
        else:
            cos = np.cos(q)
            sin = np.sin(q)
            x = T[..., 0]
            y = T[..., 1]
            T[..., 0], T[..., 1] = cos * x + sin * y, cos * y - sin * x
        yield T


def links_from_dh(dh: ArrayLike, convention: str = "standard") -> tuple[Array, Array]:
    """The links of `chain` `(joint, 4, 4)` for a DH table `(joint, 4)`, and the transform after the last joint `(4,
    4)`.

    The table has theta_off, d, a, alpha in rad and m. Standard: `A_i = Rz(q + theta_off) Tz(d) Tx(a) Rx(alpha)`.
    Modified (J. Craig, Introduction to Robotics, 1986): `A_i = Rx(alpha) Tx(a) Rz(q + theta_off) Tz(d)`, whose alpha
    and a precede the joint.
    """
    theta, d, a, alpha = np.asarray(dh, float).T
    zero = np.zeros_like(theta)
    along = transform_from_row(np.stack([zero, zero, d, zero, zero, theta], -1))
    across = transform_from_row(np.stack([a, zero, zero, alpha, zero, zero], -1))
    if convention == "modified":
        return across @ along, np.eye(4)
    return np.concatenate([along[:1], across[:-1] @ along[1:]]), across[-1]


def align_frames(links: Array, nominal: Array | None = None) -> Array:
    """The same chain with each joint's frame, but the last one's, moved along and turned about the joint's own axis.

    Where a frame stands on its axis is free. It goes where the nominal chain `(joint, 4, 4)` has it, or without one
    next to the frame before, without a turn: standard DH of axes that are nearly parallel puts it hundreds of metres
    away, and other tables elsewhere than a URDF. Flange poses stay the same, to rounding of the largest length.
    """
    T = N = before = np.eye(4)
    moved = []
    for i, link in enumerate(links):
        shift = np.eye(4)
        near = (T @ before)[:3, 3]
        T = T @ link
        if nominal is not None:
            N = N @ nominal[i]
            near = N[:3, 3]
            turn = T[:3, :3].T @ N[:3, :3]
            shift = transform_from_row([0, 0, 0, 0, 0, np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])])
        shift[2, 3] = T[:3, 2] @ (near - T[:3, 3])
        shift = shift if i < len(links) - 1 else np.eye(4)
        moved.append(np.linalg.inv(before) @ link @ shift)
        before = shift
    return np.stack(moved)


# ------------------------------------------------------------------ rigid bodies

TENSOR_ENTRIES = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
"""The order of a tensor's six numbers in descriptions and in link parameters."""
_ROWS = (0, 1, 2, 0, 0, 1)
_COLUMNS = (0, 1, 2, 1, 2, 2)

ROUNDED = 1e-3
"""Of the largest principal moment: how far files that round to three or four digits miss the triangle inequality."""


class Body(NamedTuple):
    """A rigid body.

    Attributes:
        mass: kg.
        center: (3,) m, its centre of mass.
        inertia: (3, 3) kg·m² about the centre of mass, in the axes in which `center` is given.
    """

    mass: float
    center: Array
    inertia: Array


def tensor(six: ArrayLike) -> Array:
    """(..., 3, 3) of `TENSOR_ENTRIES` (..., 6); the products have the tensor's sign, as in URDF."""
    six = np.asarray(six, float)
    full = np.empty((*six.shape[:-1], 3, 3))
    full[..., _ROWS, _COLUMNS] = six
    full[..., _COLUMNS, _ROWS] = six
    return full


def six_entries(inertia: ArrayLike) -> Array:
    """(..., 6) entries of tensors (..., 3, 3) in the order `TENSOR_ENTRIES`."""
    return np.asarray(inertia, float)[..., _ROWS, _COLUMNS]


def point_tensor(mass: ArrayLike | float, position: ArrayLike) -> Array:
    """(..., 3, 3) kg·m² about the origin of points of `mass` (...) kg at `position` (..., 3) m."""
    p = np.asarray(position, float)
    squared = (p * p).sum(-1)[..., None, None]
    return np.asarray(mass, float)[..., None, None] * (squared * np.eye(3) - p[..., :, None] * p[..., None, :])


def transform_body(body: Body, T: Array) -> Body:
    """The body in the axes to which the rigid transform `T` (4, 4) takes its coordinates."""
    R = T[:3, :3]
    return Body(body.mass, R @ body.center + T[:3, 3], R @ body.inertia @ R.T)


def lump(bodies: Iterable[Body]) -> Body:
    """Bodies that are fixed to each other as one, by the parallel-axis theorem; a single one unchanged."""
    bodies = list(bodies)
    if len(bodies) == 1:
        return bodies[0]
    mass = sum(body.mass for body in bodies)
    center = sum((body.mass * body.center for body in bodies), np.zeros(3)) / (mass or 1.0)
    inertia = sum((b.inertia + point_tensor(b.mass, b.center - center) for b in bodies), np.zeros((3, 3)))
    return Body(mass, center, inertia)


def defect(inertia: Array) -> str:
    """Why no rigid body has this tensor (3, 3) about its centre of mass; empty where one has, within `ROUNDED`.

    The principal moments of a body are not negative, and none exceeds the sum of the other two; zeros are a point's or
    a thin rod's.
    """
    scale = np.abs(inertia).max()
    if np.abs(inertia - inertia.T).max() > 1e-9 * scale:
        return "is not symmetric"
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] < -ROUNDED * scale:
        return f"has the negative principal moment {moments[0]:.4g} kg·m²"
    if moments[2] > moments[0] + moments[1] + ROUNDED * scale:
        return (
            f"has the principal moments {', '.join(f'{moment:.4g}' for moment in moments)} kg·m², the largest of which"
            " exceeds the sum of the others, as no body's does"
        )
    return ""
