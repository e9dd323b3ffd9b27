"""A camera and a board: the corners of each image become one pose with its covariance.

A corner b of the board at the pose (R, t) in the camera is seen where OpenCV's model projects R b + t. To first order
an image's residuals are r = J ξ + C ν of a displacement ξ of its pose and of constant errors ν, those of the board's
corners and of the intrinsics. With J = Q U, the rows of Qᵀ r are a pose with the whitener U and the columns Qᵀ C of ν;
what is orthogonal to Q says something of ν alone, and is its prior. Hundreds of images cost as much as so many poses.
"""

from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np

from lite6jax.arms.se3 import rotation_exp
from lite6jax.array_types import Array, Mask
from lite6jax.deferred import JaxArray, jax, jit, jnp
from lite6jax.levenberg_marquardt import Linearised, minimise

Mounted = Literal["fixed", "on_flange"]

FEWEST_CORNERS = 6
"""Of an image whose pose is determined with some to spare."""
_TURNED = 0.1
"""rad, the most standard deviation of an image's orientation with which it counts."""
_STEPS = 25
_UNDISTORTED = 30
_FREEDOM = 4.0
"""Of Student's t, by which corners count."""
_MATTERS = 0.1
"""Standard deviations of a pose, over all images, by which an error of the board must move them to be estimated."""
_FOCAL = 0.1
"""Of the focal length and of the image: one sigma of the prior of intrinsics that are refined; wide."""
_FLAT = 1e-3
_RIDGE = 1e-12
"""Information added to each number of a pose: one that corners in one line leave open stays finite."""
_QUICKLY_COMPILED = {"xla_backend_optimization_level": 0}
"""To optimise the fit of poses takes the compiler longer than it saves, were there a thousand images."""


class Lens(NamedTuple):
    """Intrinsics by OpenCV's model: `(4,)` fx, fy, cx, cy in pixels, and `(5,)` k1, k2, p1, p2, k3. A pytree."""

    pinhole: Array
    distortion: Array


class BoardPoses(NamedTuple):
    """Poses of a board in a camera, or of a camera in its board, and how constant errors change them.

    Attributes:
        T: `(image, 4, 4)`, NaN where too few corners were seen, or all nearly in one line.
        whitener: `(image, 6, 6)`: times a displacement (m in the fixed axes, rad in the moved ones) it is one of unit
            noise, if that of pixels is as declared.
        by_numbers: `(image, 6, number)`, the whitened change by constant errors, each of unit prior.
        mean: `(number,)`, their means by what no pose explains, in which they are uncorrelated.
        deviation: `(number,)`, of their prior.
        noise: px, estimated from what no pose explains.
    """

    T: Array
    whitener: Array
    by_numbers: Array
    mean: Array
    deviation: Array
    noise: float

    def select(self, rows: object) -> "BoardPoses":
        """Those of some images."""
        return self._replace(T=self.T[rows], whitener=self.whitener[rows], by_numbers=self.by_numbers[rows])  # type: ignore[index]


def project(lens: Lens, points: Any) -> JaxArray:
    """The pixels `(…, 2)` of points `(…, 3)` in the camera's frame (OpenCV, calib3d, projectPoints)."""
    x = points[..., 0] / points[..., 2]
    y = points[..., 1] / points[..., 2]
    k1, k2, p1, p2, k3 = lens.distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    fx, fy, cx, cy = lens.pinhole
    return jnp.stack([fx * u + cx, fy * v + cy], -1)


def seen_corners(mounted: Mounted, lens: Lens, corners: Any, T: Any, twist: Any) -> JaxArray:
    """The pixels `(corner, 2)` of corners `(corner, 3)` at the pose `T` `(4, 4)` displaced by `twist` `(6,)`."""
    p = T[:3, 3] + twist[:3]
    R = T[:3, :3] @ rotation_exp(twist[3:])
    return project(lens, corners @ R.T + p if mounted == "fixed" else (corners - p) @ R)


@partial(jit, static_argnums=0)
def linearise_corners(
    mounted: Mounted, lens: Lens, corners: Any, pixels: Any, T: Any, twist: Any
) -> tuple[JaxArray, JaxArray]:
    """Residuals `(image, corner, 2)`, predicted less measured, and their slopes `(image, corner, 2, 6)` by the twist.

    They are zero where a corner was not seen. The poses `T` are displaced by the twist `(image, 6)`.
    """

    def residual(twist: Any, T: Any, pixels: Any) -> JaxArray:
        missed = seen_corners(mounted, lens, corners, T, twist) - pixels
        return jnp.where(jnp.isfinite(pixels).all(1)[:, None], missed, 0.0)

    return jax.vmap(residual)(twist, T, pixels), jax.vmap(jax.jacfwd(residual))(twist, T, pixels)


@partial(jit, static_argnums=0)
def _by_constants(mounted: Mounted, lens: Lens, corners: Any, T: Any) -> tuple[JaxArray, JaxArray]:
    """How pixels change with the pinhole `(image, corner, 2, 4)` and with each corner's place `(…, 2, 3)`."""

    def at(T: Any, pinhole: Any, shift: Any) -> JaxArray:
        return seen_corners(mounted, Lens(pinhole, lens.distortion), corners + shift, T, jnp.zeros(6))

    slopes = jax.vmap(jax.jacfwd(at, (1, 2)), (0, None, None))
    return slopes(T, jnp.asarray(lens.pinhole), jnp.zeros(3))  # of a corner by its own shift


def board_poses(
    mounted: Mounted,
    lens: Lens,
    corners: Array,
    pixels: Array,
    noise: float | None,
    corner_noise: float = 0.0,
    refined: bool = False,
) -> BoardPoses:
    """The pose of each image.

    Args:
        mounted: `fixed`, of the board in the camera; `on_flange`, of the camera in the board.
        corners: `(corner, 3)` m, in one plane.
        pixels: `(image, corner, 2)`, NaN where a corner was not seen.
        noise: px, one sigma; what the corners show where None.
        corner_noise: m, one sigma of each coordinate of a corner.
        refined: whether focal lengths and centre are to be estimated.
    """
    visible = np.isfinite(pixels[..., 0] + pixels[..., 1])
    good = visible.sum(1) >= FEWEST_CORNERS
    count = len(pixels)
    empty = BoardPoses(
        np.full((count, 4, 4), np.nan), np.zeros((count, 6, 6)), np.zeros((count, 6, 0)), np.zeros(0), np.zeros(0), 0.0
    )
    if not good.any():
        return empty
    usable_pixels = pixels[good]
    starts = _starts(mounted, lens, corners, usable_pixels)
    fit = partial(_fit_poses, mounted, lens, corners, usable_pixels)
    fits = [fit(T, 1.0, _STEPS) for T in starts]
    candidates, costs, residuals, _ = map(np.stack, zip(*fits, strict=True))
    likelier = np.argmin(costs, 0), np.arange(len(usable_pixels))
    _, shown = _weights(residuals[likelier], visible[good])
    T = np.asarray(fit(candidates[likelier], shown, _STEPS)[0])
    r, J = map(np.asarray, fit(T, shown, 0)[2:])
    weight, shown = _weights(r, visible[good])
    sigma = noise or shown
    root = np.sqrt(weight)[..., None] / sigma
    r = (root * r).reshape(len(usable_pixels), -1)
    J = (root[..., None] * J).reshape(len(usable_pixels), -1, 6)
    Q, U = np.linalg.qr(J)
    variance = np.linalg.inv(np.swapaxes(U, 1, 2) @ U + 1e-9 * np.eye(6))[:, [3, 4, 5], [3, 4, 5]]
    determined = ((variance > 0) & (variance < _TURNED**2)).all(1)  # corners in one line determine no pose
    good[good] = determined
    if not determined.any():
        return empty
    T = T[determined]
    r = r[determined]
    Q = Q[determined]
    U = U[determined]
    root = root[determined]
    columns, prior = _constants(mounted, lens, corners, T, root, corner_noise, refined)
    inside = np.swapaxes(Q, 1, 2) @ columns
    remainder = columns - Q @ inside
    H = np.einsum("ikn,ikm->nm", remainder, remainder) + np.diag(prior)
    pull = np.einsum("ikn,ik->n", remainder, r)
    eigenvalues, V = np.linalg.eigh(H)
    by_numbers = inside @ V
    deviation = eigenvalues**-0.5
    matters = deviation * np.sqrt(np.einsum("ikn,ikn->n", by_numbers, by_numbers)) > _MATTERS
    significant = np.flatnonzero(matters)
    poses = empty._replace(by_numbers=np.zeros((count, 6, len(significant))))
    poses.T[good], poses.whitener[good], poses.by_numbers[good] = T, U, by_numbers[..., significant]
    mean = -(V.T @ pull)[significant] / eigenvalues[significant]
    return poses._replace(mean=mean, deviation=deviation[significant], noise=shown)


def _constants(
    mounted: Mounted, lens: Lens, corners: Array, T: Array, root: Array, corner_noise: float, refined: bool
) -> tuple[Array, Array]:
    """The whitened columns `(image, pixel, number)` of constant errors, and their prior's precision `(number,)`."""
    images = len(T)
    count = len(corners)
    pinhole, place = map(np.asarray, _by_constants(mounted, lens, corners, T))
    columns: list[Array] = [np.zeros((images, count * 2, 0))]
    prior: list[Array] = [np.zeros(0)]
    if refined:
        columns.append((root[..., None] * pinhole).reshape(images, -1, 4))
        prior.append((_FOCAL * np.asarray(lens.pinhole)) ** -2.0)
    if corner_noise:
        corner_columns = np.einsum("icak,cd->icadk", root[..., None] * place, np.eye(count))
        columns.append(corner_columns.reshape(images, count * 2, count * 3))
        prior.append(np.full(3 * count, corner_noise**-2.0))
    return np.concatenate(columns, 2), np.concatenate(prior)


def _weights(r: Array, visible: Mask) -> tuple[Array, float]:
    """`(image, corner)` by Student's t, zero where a corner was not seen, and the noise, px."""
    freedom = np.maximum(1 - 3 / np.maximum(visible.sum(1), 4), 0.1)[:, None]
    squares = np.sum(r**2, 2) / freedom
    shown = float(np.sqrt(np.median(squares[visible]) / (2 * np.log(2)))) or 1e-6
    return np.where(visible, (_FREEDOM + 2) / (_FREEDOM + squares / shown**2), 0.0), shown


@partial(jit, static_argnums=0, compiler_options=_QUICKLY_COMPILED)
def _fit_poses(
    mounted: Mounted, lens: Lens, corners: Any, pixels: Any, T: Any, scale: Any, steps: Any
) -> tuple[JaxArray, ...]:
    """The likeliest pose of each image after some steps from a start `(image, 4, 4)`; with no steps the start.

    Corners count by Student's t of a scale in pixels.

    Returns:
        the poses; their costs `(image,)`; residuals there and slopes by a twist of the start, as of
        `linearise_corners`.
    """
    freedom = _FREEDOM * scale**2

    def linearise(twist: JaxArray) -> Linearised:
        linearised = linearise_corners(mounted, lens, corners, pixels, T, twist.T)
        r, J = (jnp.moveaxis(part, 0, -1) for part in linearised)
        squares = jnp.sum(r**2, 1)
        weighed = J / (freedom + squares)[:, None, None]
        H = jnp.einsum("caki,cali->kli", weighed, J) + _RIDGE * jnp.eye(6)[:, :, None]
        gradient = jnp.einsum("caki,cai->ki", weighed, r)
        return Linearised(jnp.sum(jnp.log1p(squares / freedom), 0), gradient, H, jnp.einsum("kki->ki", H), (r, J))

    twist, linearised, *_ = minimise(linearise, jnp.add, jnp.zeros((6, len(T))), steps)
    R = T[:, :3, :3] @ rotation_exp(twist[3:].T)
    poses = T.at[:, :3].set(jnp.concatenate([R, (T[:, :3, 3] + twist[:3].T)[..., None]], 2))
    return poses, linearised.cost, *(jnp.moveaxis(part, -1, 0) for part in linearised.detail)


def _starts(mounted: Mounted, lens: Lens, corners: Array, pixels: Array) -> list[Array]:
    """The pose `(image, 4, 4)` by each image's homography, and the other that a flat board hardly tells from it."""
    centre = corners.mean(0)
    _, spread, axes = np.linalg.svd(corners - centre)
    axes[2] = np.cross(axes[0], axes[1])
    if spread[2] > _FLAT * spread[0]:
        raise ValueError("corners are not in one plane")
    flat = (corners - centre) @ axes[:2].T / spread[0]
    rays = _undistorted(lens, pixels)
    visible = np.isfinite(pixels[..., 0] + pixels[..., 1])
    candidate_poses = np.tile(np.eye(4), (2, len(pixels), 1, 1))
    for k in range(len(pixels)):
        x, y = flat[visible[k]].T
        row = np.stack([x, y, np.ones_like(x)], 1)
        none = np.zeros((len(x), 3))
        u, v = rays[k, visible[k]].T
        A = np.concatenate([np.hstack([row, none, -u[:, None] * row]), np.hstack([none, row, -v[:, None] * row])])
        H = np.linalg.svd(A)[2][-1].reshape(3, 3)
        H = H * np.sign(H[2, 2]) / np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
        U, _, Vt = np.linalg.svd(H[:, :2], full_matrices=False)
        a, b = (U @ Vt).T
        R = np.stack([a, b, np.cross(a, b)], 1)
        t = H[:, 2] * spread[0]
        sight = t / np.linalg.norm(t)
        # the other: turned half about the line of sight, and half about the normal
        mirrored = (2 * np.outer(sight, sight) - np.eye(3)) @ R @ np.diag([-1.0, -1.0, 1.0])
        for place, turned in enumerate((R, mirrored)):
            inside = turned @ axes
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = inside, t - inside @ centre
            candidate_poses[place, k] = T if mounted == "fixed" else np.linalg.inv(T)
    return list(candidate_poses)


def _undistorted(lens: Lens, pixels: Array) -> Array:
    """The rays `(…, 2)` of pixels by fixed-point iteration (OpenCV, undistortPoints)."""
    fx, fy, cx, cy = np.asarray(lens.pinhole)
    k1, k2, p1, p2, k3 = np.asarray(lens.distortion)
    x0 = (pixels[..., 0] - cx) / fx
    y0 = (pixels[..., 1] - cy) / fy
    x = x0
    y = y0
    for _ in range(_UNDISTORTED):
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        x = (x0 - dx) / radial
        y = (y0 - dy) / radial
    return np.stack([x, y], -1)
