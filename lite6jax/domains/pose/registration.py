"""Sensor frame and tool of a known chain from measured poses: a closed form, then robust Gauss–Newton."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms.se3 import rotation_from_quaternion
from lite6jax.domains.pose.predict import DiagnosedArm, predict
from lite6jax.effects.kinematic.surroundings import BaseDrift
from lite6jax.errors import InputError
from lite6jax.estimation.robust import DOWNWEIGHTED, FREEDOM, gaussian_t_scale, t_scale, weights_left
from lite6jax.fitting.problem import UNDECLARED_NOISE
from lite6jax.fitting.start import frames_from_poses
from lite6jax.model import ArmModel
from lite6jax.recordings import Recording, require_samples

Array = NDArray[np.floating]

_STEPS = 40
_SETTLED = 1e-4
"""Length of a step, in standard deviations of what it estimates."""
_DETERMINED = 1e-8
"""Least eigenvalue of the information of unit columns: below it a combination of numbers moves nothing."""
_NUMBERS = {3: 15, 6: 12}
"""Numbers that determine both frames: from positions alone, a closed form first finds the nine cosines of one."""


class Registration(NamedTuple):
    """The frames that carry a chain's flange poses to measured ones.

    Attributes:
        T_sensor_base: `(4, 4)`.
        T_flange_tool: `(4, 4)`; its rotation is what was given where no orientation was measured.
        missed: `(sample, 3)` m, predicted minus measured, sensor axes.
        turned: `(sample, 3)` rad, the rotation vector from measured to predicted, tool axes; None without orientation.
        weight: `(sample,)`, what the loss leaves of each, 1 down to 0.
        noise: robust standard deviations per axis of position (m) and orientation (rad), those fitted allowed for.
        determined: whether the poses tell every number that was fitted.
    """

    T_sensor_base: Array
    T_flange_tool: Array
    missed: Array
    turned: Array | None
    weight: Array
    noise: tuple[float, float | None]
    determined: bool

    @property
    def distance(self) -> Array:
        """`(sample,)` m."""
        return np.linalg.norm(self.missed, axis=1)

    @property
    def kept(self) -> NDArray[np.bool_]:
        """`(sample,)`, those that the loss has not all but left out."""
        return self.weight > DOWNWEIGHTED

    @property
    def rms(self) -> float:
        """m, of the samples kept."""
        return float(np.sqrt(np.mean(self.distance[self.kept] ** 2)))


def register(
    flange: Array,
    position: Array,
    rotation: Array | None,
    noise: tuple[float, float],
    frame: Array | None = None,
    tool: Array | None = None,
    tool_rotation: Array | None = None,
) -> Registration:
    """Fits what is unknown of `T_sensor_base` and `T_flange_tool` under Student's t, its scale estimated.

    Args:
        flange: `T_base_flange` `(sample, 4, 4)` of the chain.
        position: measured, `(sample, 3)` m, sensor frame.
        rotation: measured, `(sample, 3, 3)`, or None.
        noise: standard deviations per axis of position (m) and orientation (rad); only their ratio matters.
        frame: `(4, 4)`, or None where unknown.
        tool: `(4, 4)`, or None where unknown.
        tool_rotation: `(3, 3)` of an unknown tool whose rotation no orientation tells; the identity if not given.
    """
    F, T = _start(flange, position, rotation, frame, tool)
    if tool is None and rotation is None and tool_rotation is not None:
        T[:3, :3] = tool_rotation
    R, rows = flange[:, :3, :3], 3 if rotation is None else 6
    moved = [frame is None] * 6 + [tool is None] * 3 + [tool is None and rotation is not None] * 3
    free = np.flatnonzero(moved)
    J = np.zeros((len(flange), rows, 12))
    scale, w = 1.0, np.ones(len(flange))
    for _ in range(_STEPS):
        missed, turned = _missed(flange, position, rotation, F, T)
        errors = missed / noise[0] if turned is None else np.hstack([missed / noise[0], turned / noise[1]])
        squares = np.sum(errors**2, 1)
        scale = t_scale(squares, rows, FREEDOM)
        w = weights_left(squares / scale**2, FREEDOM)
        if not free.size:
            break
        arm = R @ T[:3, 3] + flange[:, :3, 3]
        J[:, :3, :3] = np.eye(3) / noise[0]
        J[:, :3, 3:6] = -F[:3, :3] @ _cross(arm) / noise[0]
        J[:, :3, 6:9] = F[:3, :3] @ R / noise[0]
        if rotation is not None:
            J[:, 3:, 3:6] = np.swapaxes(R @ T[:3, :3], 1, 2) / noise[1]
            J[:, 3:, 9:12] = np.eye(3) / noise[1]
        columns = J[:, :, free] * np.sqrt(w)[:, None, None]
        change = np.zeros(12)
        change[free], length = _step(
            columns.reshape(rows * len(flange), free.size), (errors * np.sqrt(w)[:, None]).ravel()
        )
        F[:3, 3] += change[:3]
        F[:3, :3] = F[:3, :3] @ Rotation.from_rotvec(change[3:6]).as_matrix()
        T[:3, 3] += change[6:9]
        T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(change[9:12]).as_matrix()
        if length < _SETTLED * scale or np.abs(change).max() < 1e-14:
            break
    missed, turned = _missed(flange, position, rotation, F, T)
    left = np.sqrt(rows * len(flange) / max(rows * len(flange) - free.size, 1))
    noises = [None if e is None else float(left * _spread(e)) for e in (missed, turned)]
    assert noises[0] is not None
    known = _determined(J[:, :, free].reshape(rows * len(flange), free.size))
    return Registration(F, T, missed, turned, w, (noises[0], noises[1]), known)


def register_model(model: DiagnosedArm, recording: Recording) -> tuple[DiagnosedArm, Registration]:
    """The model with sensor frame and tool fitted to a recording of another set-up, and that fit.

    All else stays, but for a drift of the old set-up, which is removed. Where only positions were measured, the tool
    keeps its rotation, and the model predicts positions only.

    Raises:
        InputError: no poses, too few of them (both counts), poses that do not determine a frame, or as `predict`.
    """
    require_samples(recording, _NUMBERS[recording.numbers_per_sample or 3])
    model = model.keeping([not isinstance(effect, BaseDrift) for effect in model.physics.effects])
    bare = [replace(model, model=ArmModel(model.model.geometry, _shift(x), np.eye(4))) for x in (0.0, 1.0)]  # type: ignore[arg-type]
    flange, shifted = (predict(one, recording) for one in bare)
    # an effect of the sensor's scale multiplies positions: by how much a frame shifted by a metre shows them moved
    growth = (shifted - flange)[:, 0, 3]
    flange[:, :3, 3] /= growth[:, None]
    used = np.isfinite(growth)
    require_samples(recording.select(used), _NUMBERS[recording.numbers_per_sample])
    position, rotation = recording.position, None
    assert position is not None
    if recording.quaternion is not None:
        rotation = np.asarray(rotation_from_quaternion(recording.quaternion))[used]
    settings = recording.settings
    noise = (
        settings.position_noise_m or UNDECLARED_NOISE[0],
        settings.orientation_noise_rad or UNDECLARED_NOISE[1],
    )
    before = np.asarray(model.model.T_flange_tool)[:3, :3]
    found = register(flange[used], (position / growth[:, None])[used], rotation, noise, tool_rotation=before)
    if not found.determined:
        raise InputError(
            f"{recording.source}: its poses do not determine sensor frame and tool; record some that turn the flange "
            "about other axes"
        )
    frames = ArmModel(model.model.geometry, found.T_sensor_base, found.T_flange_tool)  # type: ignore[arg-type]
    return replace(model, model=frames, orientation=rotation is not None), found


def _shift(x: float) -> Array:
    T = np.eye(4)
    T[0, 3] = x
    return T


def _start(
    flange: Array, position: Array, rotation: Array | None, frame: Array | None, tool: Array | None
) -> tuple[Array, Array]:
    if rotation is None or frame is not None or tool is not None:
        return frames_from_poses(flange, position, rotation, frame, tool)
    # M_k = S R_k U: vec(S) = (R_k ⊗ M_k) vec(Uᵀ) for every k, so both are singular vectors of the sum
    # (M. Shah, J. Mech. Robotics 5, 2013, equation 15)
    R, p = flange[:, :3, :3], flange[:, :3, 3]
    K = np.einsum("kij,kab->iajb", R, rotation).reshape(9, 9)
    left, _, right = np.linalg.svd(K)
    F, T = np.eye(4), np.eye(4)
    F[:3, :3] = _rotation(left[:, 0].reshape(3, 3).T)
    T[:3, :3] = _rotation(right[0].reshape(3, 3).T).T
    columns = np.concatenate([F[:3, :3] @ R, np.broadcast_to(np.eye(3), R.shape)], 2).reshape(-1, 6)
    found = np.linalg.lstsq(columns, (position - p @ F[:3, :3].T).ravel(), rcond=1e-9)[0]
    T[:3, 3], F[:3, 3] = found[:3], found[3:]
    return F, T


def _missed(flange: Array, position: Array, rotation: Array | None, F: Array, T: Array) -> tuple[Array, Array | None]:
    predicted = F @ flange @ T
    missed = predicted[:, :3, 3] - position
    if rotation is None:
        return missed, None
    return missed, Rotation.from_matrix(np.swapaxes(rotation, 1, 2) @ predicted[:, :3, :3]).as_rotvec()


def _step(columns: Array, errors: Array) -> tuple[Array, float]:
    """The Gauss–Newton step and its length in whitened units; the shortest where columns depend on each other."""
    unit = np.linalg.norm(columns, axis=0)
    unit = np.where(unit > 0, unit, 1.0)
    scaled = -np.linalg.lstsq(columns / unit, errors, rcond=1e-9)[0]
    return scaled / unit, float(np.linalg.norm(columns / unit @ scaled))


def _determined(columns: Array) -> bool:
    if not columns.shape[1]:
        return True
    unit = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(unit > 0, unit, 1.0)
    return bool(np.linalg.eigvalsh(scaled.T @ scaled)[0] > _DETERMINED)


def _spread(errors: Array) -> float:
    return t_scale(np.sum(errors**2, 1), 3, FREEDOM) / gaussian_t_scale(3, FREEDOM)


def _rotation(M: Array) -> Array:
    """The rotation nearest to a multiple, of either sign, of a matrix."""
    U, _, Vt = np.linalg.svd(M * np.sign(np.linalg.det(M)))
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


def _cross(vector: Array) -> Array:
    """`(sample, 3, 3)`, what takes u to vector × u."""
    x, y, z = vector.T
    o = np.zeros_like(x)
    return np.stack([np.stack(row, -1) for row in ([o, -z, y], [z, o, -x], [-y, x, o])], -2)
