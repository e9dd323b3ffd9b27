"""Sensor frame and tool of a known chain from measured poses: a closed form, then a robust fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms.se3 import rotation_from_quaternion
from lite6jax.domains.pose.files import read_motion
from lite6jax.domains.pose.predict import DiagnosedArm, predict, registered, require_model
from lite6jax.effects.kinematic.surroundings import BaseDrift, SensorDrift
from lite6jax.errors import InputError, wrong_type
from lite6jax.estimation.least_squares import relinearise
from lite6jax.estimation.options import DEFAULTS
from lite6jax.estimation.projection import rank
from lite6jax.estimation.robust import DOWNWEIGHTED, FREEDOM, gaussian_t_scale, t_scale, weights_left
from lite6jax.estimation.terms import Term, Terms
from lite6jax.fitting.problem import UNDECLARED_NOISE
from lite6jax.fitting.start import frames_from_poses
from lite6jax.model import ArmModel
from lite6jax.recordings import Recording, require_samples
from lite6jax.results import PublicResult

Array = NDArray[np.floating]

_DETERMINED = 1e-8
"""Eigenvalue of the information of unit columns, over the largest, below which a combination is not determined."""
_NUMBERS = {3: 15, 6: 12}
"""Numbers that determine both frames: from positions alone, a closed form first finds the nine cosines of one."""


@final
@dataclass(frozen=True, eq=False, repr=False)
class Registration(PublicResult):
    """The frames that carry a chain's flange poses to measured ones.

    Attributes:
        T_sensor_base: `(4, 4)`.
        T_flange_tool: `(4, 4)`; its rotation is what was given where no orientation was measured.
        missed: `(sample, 3)` m, predicted minus measured, sensor axes.
        turned: `(sample, 3)` rad, the rotation vector from measured to predicted, tool axes; None without orientation.
        weight: `(sample,)`, of each in the loss, from 1 down to 0.
        noise: robust standard deviations per axis of position (m) and orientation (rad), for the degrees of freedom.
        determined: whether the poses determine every number that was fitted.
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
        """`(sample,)`, those that are no outliers."""
        return self.weight > DOWNWEIGHTED

    @property
    def rms(self) -> float:
        """m, outliers excluded."""
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
        tool_rotation: `(3, 3)` of an unknown tool, which positions do not determine; the identity if not given.
    """
    F, T = _start(flange, position, rotation, frame, tool)
    if tool is None and rotation is None and tool_rotation is not None:
        T[:3, :3] = tool_rotation
    unknown = [frame is None] * 6 + [tool is None] * 3 + [tool is None and rotation is not None] * 3
    problem = relinearise(_Frames(flange, position, rotation, noise, F, T, np.flatnonzero(unknown)), DEFAULTS)
    missed, turned = problem.differences
    squares = np.sum(problem.whitened**2, 0)
    weight = weights_left(squares / t_scale(squares, problem.rows, FREEDOM) ** 2, FREEDOM)
    count, parameters = problem.rows * problem.samples, len(problem.unknown)
    lost = np.sqrt(count / max(count - parameters, 1))
    scales = [None if errors is None else float(lost * _spread(errors)) for errors in (missed, turned)]
    assert scales[0] is not None
    determined = rank(problem.nuisance.reshape(parameters, count), _DETERMINED) == parameters
    return Registration(
        problem.T_sensor_base, problem.T_flange_tool, missed, turned, weight, (scales[0], scales[1]), determined
    )


def register_model(model: DiagnosedArm, recording: Recording | str | Path) -> tuple[DiagnosedArm, Registration]:
    """The model with sensor frame and tool fitted to a recording of another set-up, or its file; and that fit.

    All else stays, but for a drift of the old set-up, which is removed. Where only positions were measured, the tool
    keeps its rotation, and the model predicts positions only.

    Raises:
        InputError: no poses, too few of them (both counts), poses that do not determine a frame, or as `predict`.
    """
    require_model(model)
    if isinstance(recording, str | Path):
        recording = read_motion(recording, model)
    if not isinstance(recording, Recording):
        raise wrong_type("recording", recording, "the path of a recording, or a Recording")
    require_samples(recording, _NUMBERS[recording.numbers_per_sample or 3])
    model = model.keeping([not isinstance(effect, BaseDrift | SensorDrift) for effect in model.physics.effects])
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
    moved = replace(model, model=frames, orientation=rotation is not None)
    noise = found.noise[0], found.noise[1] if rotation is not None else None
    return replace(moved, uncertainty=registered(moved, moved.motion_of(recording.select(used)), noise)), found


def _shift(x: float) -> Array:
    T = np.eye(4)
    T[0, 3] = x
    return T


@final
@dataclass(frozen=True, eq=False)
class _Frames:
    """Sensor frame and tool of a known chain as a problem of least squares, whose nuisance they are.

    The nuisance's twelve numbers displace the sensor frame by a translation in its axes and a rotation in the base's,
    and the tool by a translation in the flange's axes and a rotation in its own.

    Attributes:
        flange: `(sample, 4, 4)`.
        position: `(sample, 3)`.
        rotation: `(sample, 3, 3)` or None.
        noise: of position and orientation.
        T_sensor_base: `(4, 4)`.
        T_flange_tool: `(4, 4)`.
        unknown: which of the twelve.
    """

    flange: Array
    position: Array
    rotation: Array | None
    noise: tuple[float, float]
    T_sensor_base: Array
    T_flange_tool: Array
    unknown: NDArray[np.integer]

    @property
    def rows(self) -> int:
        return 3 if self.rotation is None else 6

    @property
    def samples(self) -> int:
        return len(self.flange)

    @property
    def groups(self) -> NDArray[np.integer]:
        return np.zeros(self.rows, int)

    @property
    def precision(self) -> Array:
        return np.zeros(len(self.unknown))

    offset = precision

    @property
    def preset(self) -> tuple[Terms, Array]:
        return Terms(), np.zeros(0)

    @cached_property
    def differences(self) -> tuple[Array, Array | None]:
        """Predicted minus measured: `(sample, 3)` m in sensor axes, and rotation vectors in tool axes."""
        predicted = self.T_sensor_base @ self.flange @ self.T_flange_tool
        missed = predicted[:, :3, 3] - self.position
        if self.rotation is None:
            return missed, None
        relative = np.swapaxes(self.rotation, 1, 2) @ predicted[:, :3, :3]
        return missed, Rotation.from_matrix(relative).as_rotvec()

    @property
    def whitened(self) -> Array:
        """`(row, sample)`."""
        missed, turned = self.differences
        parts = [missed / self.noise[0]] + ([] if turned is None else [turned / self.noise[1]])
        return np.hstack(parts).T

    @property
    def nuisance(self) -> Array:
        """`(unknown, row, sample)`."""
        R, R_sensor = self.flange[:, :3, :3], self.T_sensor_base[:3, :3]
        arm = R @ self.T_flange_tool[:3, 3] + self.flange[:, :3, 3]
        J = np.zeros((self.samples, self.rows, 12))
        J[:, :3, :3] = np.eye(3) / self.noise[0]
        J[:, :3, 3:6] = -R_sensor @ _cross(arm) / self.noise[0]
        J[:, :3, 6:9] = R_sensor @ R / self.noise[0]
        if self.rotation is not None:
            J[:, 3:, 3:6] = np.swapaxes(R @ self.T_flange_tool[:3, :3], 1, 2) / self.noise[1]
            J[:, 3:, 9:12] = np.eye(3) / self.noise[1]
        return np.moveaxis(J[:, :, self.unknown], 0, -1).swapaxes(0, 1)

    def nuisance_columns(self, terms: Terms, values: Array) -> Array:
        """How residuals change with each nuisance number, whatever terms are beside it: `nuisance`."""
        return self.nuisance

    def residual(self, nuisance: Array, terms: Terms, values: Array) -> Array:
        return self.relinearised(nuisance).whitened

    def columns(
        self, terms: Sequence[Term], values: Array | None = None, beside: tuple[Terms, Array] | None = None
    ) -> Array:
        return np.zeros((0, self.rows, self.samples))

    def factored(self, term: Term) -> None:
        return

    def relinearised(self, nuisance: Array) -> "_Frames":
        if not nuisance.any():
            return self
        change = np.zeros(12)
        change[self.unknown] = nuisance
        F, T = self.T_sensor_base.copy(), self.T_flange_tool.copy()
        for frame, shift, turn in ((F, change[:3], change[3:6]), (T, change[6:9], change[9:])):
            frame[:3, 3] += shift
            frame[:3, :3] = frame[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
        return replace(self, T_sensor_base=F, T_flange_tool=T)


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
