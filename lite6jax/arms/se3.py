"""Rotations and rigid transforms in JAX: conversions of matrices, roll-pitch-yaw, quaternions and rotation vectors.

Matrices occupy the last two axes, `(..., 3, 3)` and `(..., 4, 4)`, vectors the last one. Radians and metres.
"""

from lite6jax.deferred import Array, ArrayLike, jnp

_SERIES_BELOW = 1e-4
"""rad; for smaller angles a two-term series is exact to rounding."""


def rotation_from_rpy(rpy: ArrayLike) -> Array:
    """Rotation matrices `(..., 3, 3)` from roll, pitch, yaw `(..., 3)`: Rz(yaw) Ry(pitch) Rx(roll), as in URDF."""
    rpy = jnp.asarray(rpy)
    (sr, sp, sy), (cr, cp, cy) = jnp.moveaxis(jnp.sin(rpy), -1, 0), jnp.moveaxis(jnp.cos(rpy), -1, 0)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def rpy_from_rotation(R: ArrayLike) -> Array:
    """Roll, pitch, yaw `(..., 3)` that reproduce rotations `(..., 3, 3)` to rounding, including pitch ±90°.

    Roll follows from Rz(−yaw) R, so that it is consistent with yaw where only their sum or difference is determined.
    """
    R = jnp.asarray(R)
    yaw = jnp.arctan2(R[..., 1, 0], R[..., 0, 0])
    s, c = jnp.sin(yaw), jnp.cos(yaw)
    pitch = jnp.arctan2(-R[..., 2, 0], c * R[..., 0, 0] + s * R[..., 1, 0])
    roll = jnp.arctan2(s * R[..., 0, 2] - c * R[..., 1, 2], c * R[..., 1, 1] - s * R[..., 0, 1])
    return jnp.stack([roll, pitch, yaw], -1)


def quaternion_components(R) -> tuple[Array, Array, Array, Array]:
    """The unit quaternion w, x, y, z with w ≥ 0 of a rotation given as nine arrays `R[i][j]` of equal shape.

    The largest pivot is chosen, which is accurate and differentiable at every angle (S. Shepperd, J. Guidance and
    Control 1(3), 1978).
    """
    trace = R[0][0] + R[1][1] + R[2][2]
    pivots = [1 + trace, *(1 + 2 * R[i][i] - trace for i in range(3))]
    a, b, c = R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1]
    d, e, f = R[1][0] + R[0][1], R[0][2] + R[2][0], R[2][1] + R[1][2]
    candidates = [(pivots[0], a, b, c), (a, pivots[1], d, e), (b, d, pivots[2], f), (c, e, f, pivots[3])]
    chosen, pivot = candidates[0], pivots[0]
    for i in range(1, 4):
        larger = pivots[i] > pivot
        pivot = jnp.where(larger, pivots[i], pivot)
        chosen = tuple(jnp.where(larger, new, old) for new, old in zip(candidates[i], chosen, strict=True))
    factor = jnp.where(chosen[0] < 0, -0.5, 0.5) / jnp.sqrt(pivot)
    w, x, y, z = (factor * q for q in chosen)
    return w, x, y, z


def rotation_log_components(R) -> tuple[Array, Array, Array]:
    """The rotation vector, its angle in [0, π], of a rotation given as nine arrays `R[i][j]`; smooth at identity.

    v = 4 arctan(t)/t · q⃗/(1 + w) with t = |q⃗|/(1 + w), the tangent of a quarter angle. Two halvings reduce t below
    0.2, where twelve terms of the series are exact to rounding. It is free of branches and faster than an arctangent.
    """
    w, x, y, z = quaternion_components(R)
    inverse = 1 / (1 + w)
    x, y, z = x * inverse, y * inverse, z * inverse
    t2, factor = x * x + y * y + z * z, 4.0
    for _ in range(2):  # arctan t = 2 arctan(t / h), h = 1 + √(1 + t²)
        h = 1 / (1 + jnp.sqrt(1 + t2))
        t2, factor = t2 * h * h, 2 * factor * h
    series = jnp.zeros(())
    for k in reversed(range(12)):
        series = series * t2 + (-1) ** k / (2 * k + 1)
    factor = factor * series
    return factor * x, factor * y, factor * z


def rotation_log(R: ArrayLike) -> Array:
    """Rotation vectors `(..., 3)` of rotations `(..., 3, 3)`; angle in [0, π] rad."""
    return jnp.stack(rotation_log_components(jnp.moveaxis(jnp.asarray(R), (-2, -1), (0, 1))), -1)


def rotation_exp(rotation_vector: ArrayLike) -> Array:
    """Rotations `(..., 3, 3)` of rotation vectors `(..., 3)` (Rodrigues), smooth at zero."""
    w = jnp.asarray(rotation_vector)
    n2 = jnp.sum(w * w, -1)[..., None, None]
    small = n2 < _SERIES_BELOW**2
    safe = jnp.where(small, 1.0, n2)
    n = jnp.sqrt(safe)
    sine = jnp.where(small, 1 - n2 / 6, jnp.sin(n) / n)
    half = jnp.sin(n / 2) / n
    versine = jnp.where(small, 0.5 - n2 / 24, 2 * half * half)
    K = skew(w)
    return jnp.eye(3) + sine * K + versine * (K @ K)


def skew(w: ArrayLike) -> Array:
    """The matrices `(..., 3, 3)` that map v to w × v."""
    x, y, z = jnp.moveaxis(jnp.asarray(w), -1, 0)
    o = jnp.zeros_like(x)
    return jnp.stack([jnp.stack(row, -1) for row in ([o, -z, y], [z, o, -x], [-y, x, o])], -2)


def quaternion_from_rotation(R: ArrayLike) -> Array:
    """Unit quaternions `(..., 4)`, scalar first and not negative, of rotations `(..., 3, 3)`."""
    return jnp.stack(quaternion_components(jnp.moveaxis(jnp.asarray(R), (-2, -1), (0, 1))), -1)


def rotation_from_quaternion(quaternion: ArrayLike) -> Array:
    """Rotations `(..., 3, 3)` of quaternions `(..., 4)`, scalar first, of any non-zero norm."""
    q = jnp.asarray(quaternion)
    w, x, y, z = jnp.moveaxis(q, -1, 0)
    s = 2 / jnp.sum(q * q, -1)
    rows = [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def transform(R: ArrayLike, p: ArrayLike) -> Array:
    """Rigid transforms `(..., 4, 4)` of rotations `(..., 3, 3)` and translations `(..., 3)` in m."""
    R, p = jnp.asarray(R), jnp.asarray(p)
    shape = jnp.broadcast_shapes(R.shape[:-2], p.shape[:-1])
    top = jnp.concatenate([jnp.broadcast_to(R, (*shape, 3, 3)), jnp.broadcast_to(p, (*shape, 3))[..., None]], -1)
    bottom = jnp.broadcast_to(jnp.array([0.0, 0.0, 0.0, 1.0]), (*shape, 1, 4))
    return jnp.concatenate([top, bottom], -2)


def inverse(T: ArrayLike) -> Array:
    """The inverses of rigid transforms `(..., 4, 4)`."""
    T = jnp.asarray(T)
    Rt = jnp.swapaxes(T[..., :3, :3], -1, -2)
    return transform(Rt, -(Rt @ T[..., :3, 3:])[..., 0])
