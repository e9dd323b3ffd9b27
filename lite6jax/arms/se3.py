"""Rigid motions in JAX: conversions of rotations, and elementary transformations of frames with their twists.

Matrices occupy the last two axes, `(..., 3, 3)` and `(..., 4, 4)`, vectors the last one. Of frames and twists, the
factors of a chain, the sample is the last axis, so that a transformation is one vector instruction over samples.
Radians and metres.
"""

from typing import NamedTuple

import numpy as np

from lite6jax.deferred import ArrayLike, JaxArray, jnp

_SERIES_BELOW = 1e-4
"""rad; for smaller angles a two-term series is exact to rounding."""


def rotation_from_rpy(rpy: ArrayLike) -> JaxArray:
    """Rotation matrices `(..., 3, 3)` from roll, pitch, yaw `(..., 3)`: Rz(yaw) Ry(pitch) Rx(roll), as in URDF."""
    rpy = jnp.asarray(rpy)
    sr, sp, sy = jnp.moveaxis(jnp.sin(rpy), -1, 0)
    cr, cp, cy = jnp.moveaxis(jnp.cos(rpy), -1, 0)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def quaternion_components(R) -> tuple[JaxArray, JaxArray, JaxArray, JaxArray]:
    """The unit quaternion w, x, y, z with w ≥ 0 of a rotation given as nine arrays `R[i][j]` of equal shape.

    The largest pivot is chosen, which is accurate and differentiable at every angle (S. Shepperd, J. Guidance and
    Control 1(3), 1978).
    """
    trace = R[0][0] + R[1][1] + R[2][2]
    pivots = [1 + trace, *(1 + 2 * R[i][i] - trace for i in range(3))]
    a = R[2][1] - R[1][2]
    b = R[0][2] - R[2][0]
    c = R[1][0] - R[0][1]
    d = R[1][0] + R[0][1]
    e = R[0][2] + R[2][0]
    f = R[2][1] + R[1][2]
    candidates = [(pivots[0], a, b, c), (a, pivots[1], d, e), (b, d, pivots[2], f), (c, e, f, pivots[3])]
    chosen = candidates[0]
    pivot = pivots[0]
    for i in range(1, 4):
        larger = pivots[i] > pivot
        pivot = jnp.where(larger, pivots[i], pivot)
        chosen = tuple(jnp.where(larger, new, old) for new, old in zip(candidates[i], chosen, strict=True))
    factor = jnp.where(chosen[0] < 0, -0.5, 0.5) / jnp.sqrt(pivot)
    w, x, y, z = (factor * q for q in chosen)
    return w, x, y, z


def rotation_log_components(R) -> tuple[JaxArray, JaxArray, JaxArray]:
    """The rotation vector, its angle in [0, π], of a rotation given as nine arrays `R[i][j]`; smooth at identity.

    v = 4 arctan(t)/t · q⃗/(1 + w) with t = |q⃗|/(1 + w), the tangent of a quarter angle. Two halvings reduce t below
    0.2, where twelve terms of the series are exact to rounding. It is free of branches and faster than an arctangent.
    """
    w, x, y, z = quaternion_components(R)
    inverse = 1 / (1 + w)
    x = x * inverse
    y = y * inverse
    z = z * inverse
    t2 = x * x + y * y + z * z
    factor = 4.0
    for _ in range(2):  # arctan t = 2 arctan(t / h), h = 1 + √(1 + t²)
        h = 1 / (1 + jnp.sqrt(1 + t2))
        t2 = t2 * h * h
        factor = 2 * factor * h
    series = jnp.zeros(())
    for k in reversed(range(12)):
        series = series * t2 + (-1) ** k / (2 * k + 1)
    factor = factor * series
    return factor * x, factor * y, factor * z


def rotation_log(R: ArrayLike) -> JaxArray:
    """Rotation vectors `(..., 3)` of rotations `(..., 3, 3)`; angle in [0, π] rad."""
    return jnp.stack(rotation_log_components(jnp.moveaxis(jnp.asarray(R), (-2, -1), (0, 1))), -1)


def rotation_exp(rotation_vector: ArrayLike) -> JaxArray:
    """Rotations `(..., 3, 3)` of rotation vectors `(..., 3)` (Rodrigues), smooth at zero."""
    w = jnp.asarray(rotation_vector)
    sine, versine = _rodrigues(jnp.sum(w * w, -1)[..., None, None])
    K = skew(w)
    return jnp.eye(3) + sine * K + versine * (K @ K)


def _rodrigues(square: JaxArray) -> tuple[JaxArray, JaxArray]:
    """sin(n) / n and (1 - cos(n)) / n² by the square of the angle n, smooth at zero."""
    small = square < _SERIES_BELOW**2
    n = jnp.sqrt(jnp.where(small, 1.0, square))
    half = jnp.sin(n / 2) / n
    return jnp.where(small, 1 - square / 6, jnp.sin(n) / n), jnp.where(small, 0.5 - square / 24, 2 * half * half)


def skew(w: ArrayLike) -> JaxArray:
    """The matrices `(..., 3, 3)` that map v to w × v."""
    x, y, z = jnp.moveaxis(jnp.asarray(w), -1, 0)
    o = jnp.zeros_like(x)
    return jnp.stack([jnp.stack(row, -1) for row in ([o, -z, y], [z, o, -x], [-y, x, o])], -2)


def quaternion_from_rotation(R: ArrayLike) -> JaxArray:
    """Unit quaternions `(..., 4)`, scalar first and not negative, of rotations `(..., 3, 3)`."""
    return jnp.stack(quaternion_components(jnp.moveaxis(jnp.asarray(R), (-2, -1), (0, 1))), -1)


def transform(R: ArrayLike, p: ArrayLike) -> JaxArray:
    """Rigid transforms `(..., 4, 4)` of rotations `(..., 3, 3)` and translations `(..., 3)` in m."""
    R = jnp.asarray(R)
    p = jnp.asarray(p)
    shape = jnp.broadcast_shapes(R.shape[:-2], p.shape[:-1])
    top = jnp.concatenate([jnp.broadcast_to(R, (*shape, 3, 3)), jnp.broadcast_to(p, (*shape, 3))[..., None]], -1)
    bottom = jnp.broadcast_to(jnp.array([0.0, 0.0, 0.0, 1.0]), (*shape, 1, 4))
    return jnp.concatenate([top, bottom], -2)


X = 0
Y = 1
Z = 2


class Frame(NamedTuple):
    """A moving frame: its axes and its origin in fixed coordinates, each `(3, sample)`."""

    x: JaxArray
    y: JaxArray
    z: JaxArray
    origin: JaxArray


class Twist(NamedTuple):
    """The motion per unit of one parameter, at the fixed origin: `(3, sample)` each; a translation has no `angular`."""

    linear: JaxArray
    angular: JaxArray | None


class Turn(NamedTuple):
    """The cosine and sine of a rotation angle.

    Of a joint's motion also its shift along its axis in m; None where no joint of the chain is prismatic, so that a
    chain of revolute joints pays nothing for the others.
    """

    cos: JaxArray
    sin: JaxArray
    shift: JaxArray | None = None


def turn(angle: ArrayLike) -> Turn:
    """The cosine and sine of `angle` rad."""
    return Turn(jnp.cos(angle), jnp.sin(angle))


def joint_turn(position: JaxArray, sliding: tuple[int, ...]) -> Turn:
    """The motions of joints about and along their axes at positions `(..., joint, sample)` rad, or m of those in
    `sliding`."""
    if not sliding:
        return turn(position)
    slides = np.isin(np.arange(position.shape[-2]), sliding)[:, None]
    return turn(jnp.where(slides, 0.0, position))._replace(shift=jnp.where(slides, position, 0.0))


def rotate(frame: Frame, axis: int, by: Turn) -> Frame:
    """The frame rotated about its own axis."""
    axes = [frame.x, frame.y, frame.z]
    b = (axis + 1) % 3
    c = (axis + 2) % 3
    axes[b], axes[c] = by.cos * axes[b] + by.sin * axes[c], by.cos * axes[c] - by.sin * axes[b]
    return Frame(axes[0], axes[1], axes[2], frame.origin)


def translate(frame: Frame, axis: int, by: JaxArray) -> Frame:
    """The frame shifted along its own axis, by m."""
    return frame._replace(origin=frame.origin + by * frame[axis])


def displace(frame: Frame, twist: JaxArray) -> Frame:
    """The frame shifted along its own axes by `twist[:3]` m, then rotated by the rotation vector `twist[3:]` rad."""
    shifted = translate(translate(translate(frame, X, twist[0]), Y, twist[1]), Z, twist[2])
    w = twist[3:]
    sine, versine = _rodrigues(jnp.sum(w * w, 0))
    axes = []
    for i in range(3):  # column i of 1 + sine [w] + versine (w wᵀ − |w|²), Rodrigues' formula
        j = (i + 1) % 3
        k = (i + 2) % 3
        along = 1 - versine * (w[j] * w[j] + w[k] * w[k])
        axes.append(
            along * frame[i]
            + (versine * w[i] * w[j] + sine * w[k]) * frame[j]
            + (versine * w[i] * w[k] - sine * w[j]) * frame[k]
        )
    return Frame(axes[0], axes[1], axes[2], shifted.origin)


def rotation_twist(frame: Frame, axis: int) -> Twist:
    """The twist of a rotation about the frame's own axis."""
    return Twist(cross(frame.origin, frame[axis]), frame[axis])


def cross(a: JaxArray, b: JaxArray) -> JaxArray:
    """The cross product over the first axis."""
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def frame_transform(frame: Frame) -> JaxArray:
    """The transforms `(sample, 4, 4)` of a frame."""
    R = jnp.stack([frame.x, frame.y, frame.z], 1)
    return transform(jnp.moveaxis(R, -1, 0), frame.origin.T)


def base_frame(T: JaxArray, samples: int) -> Frame:
    """A fixed transform `(4, 4)` as the frame of every sample."""
    columns = jnp.broadcast_to(T[:3, :, None], (3, 4, samples))
    return Frame(columns[:, 0], columns[:, 1], columns[:, 2], columns[:, 3])
