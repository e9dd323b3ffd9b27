"""Sensor frame and tool of a known chain from measured poses: a closed form, then a robust fit."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import final

import numpy as np

from lite6jax.arms import frames
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.calibration.problem import UNDECLARED_NOISE
from lite6jax.calibration.start import measured_rotations
from lite6jax.domains.pose.kinematics import (
    RigidFrames,
    Site,
    rigid_columns,
    small_displacement,
    whitened,
)
from lite6jax.domains.pose.predict import Derivatives, DiagnosedArm, require_model, shown_poses
from lite6jax.domains.pose.rigid_arm import NuisanceProblem
from lite6jax.domains.uncertainty import Uncertainty
from lite6jax.effects.kinematic import BaseDrift, SensorDrift
from lite6jax.effects.motion import Motion
from lite6jax.errors import InputError, wrong_type
from lite6jax.estimation.least_squares import relinearise
from lite6jax.estimation.options import DEFAULTS
from lite6jax.estimation.projection import rank, scaled_inverse
from lite6jax.estimation.robust import DOWNWEIGHTED, FREEDOM, gaussian_t_scale, t_scale, weights_left
from lite6jax.estimation.terms import Terms
from lite6jax.model import ArmModel
from lite6jax.recordings import Recording, RecordingSettings, require_one_station, require_samples
from lite6jax.recordings.alignment import frames_from_poses
from lite6jax.results import PublicResult
from lite6jax.sensors.pose import PoseSensor

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
    def kept(self) -> Mask:
        """`(sample,)`, those that are no outliers."""
        return self.weight > DOWNWEIGHTED

    @property
    def rms(self) -> float:
        """m, outliers excluded."""
        return float(np.sqrt(np.mean(self.distance[self.kept] ** 2)))


def noise_of(settings: RecordingSettings) -> tuple[float, float]:
    """Standard deviations per axis of position (m) and orientation (rad), as declared or assumed."""
    position, orientation = UNDECLARED_NOISE
    return settings.position_noise_m or position, settings.orientation_noise_rad or orientation


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
    F, T = frames_from_poses(flange, position, rotation, frame, tool)
    if tool is None and rotation is None and tool_rotation is not None:
        T[:3, :3] = tool_rotation
    unknown = [frame is None] * 6 + [tool is None] * 3 + [tool is None and rotation is not None] * 3
    turned = np.zeros((3, 3, 0)) if rotation is None else np.moveaxis(rotation, 0, -1)
    measured = PoseSensor(position.T, turned, 1 / np.array(noise))
    problem = relinearise(_Frames(flange, measured, F, T, np.flatnonzero(unknown)), DEFAULTS)
    missed = problem.differences[:3].T
    turned = None if rotation is None else problem.differences[3:].T
    squares = np.sum(problem.residuals**2, 0)
    weight = weights_left(squares / t_scale(squares, problem.rows, FREEDOM) ** 2, FREEDOM)
    count = problem.rows * problem.samples
    parameters = len(problem.unknown)
    lost = np.sqrt(count / max(count - parameters, 1)) / gaussian_t_scale(3, FREEDOM)
    remaining_noise = [
        None if e is None else float(lost * t_scale(np.sum(e**2, 1), 3, FREEDOM)) for e in (missed, turned)
    ]
    assert remaining_noise[0] is not None
    determined = rank(problem.frame_columns.reshape(parameters, count), _DETERMINED) == parameters
    fitted = problem.T_sensor_base, problem.T_flange_tool
    return Registration(*fitted, missed, turned, weight, (remaining_noise[0], remaining_noise[1]), determined)


def register_model(model: DiagnosedArm, recording: Recording | str | Path) -> tuple[DiagnosedArm, Registration]:
    """The model with sensor frame and tool fitted to a recording of another set-up, or its file; and that fit.

    All else stays, but for a drift of the old set-up, which is removed. Where only positions were measured, the tool
    keeps its rotation, and the model predicts positions only.

    Raises:
        InputError: no poses, too few of them (both counts), poses that do not determine a frame, or as `predict`.
    """
    require_model(model)
    if isinstance(recording, str | Path):
        recording = model.read_motion(recording)
    if not isinstance(recording, Recording):
        raise wrong_type("recording", recording, "the path of a recording, or a Recording")
    require_one_station(recording)
    require_samples(recording, _NUMBERS[recording.numbers_per_sample or 3])
    model = model.keeping([not isinstance(effect, BaseDrift | SensorDrift) for effect in model.physics.effects])
    by_a_metre = frames.transform_from_row([1, 0, 0, 0, 0, 0])
    bare = [ArmModel(model.model.geometry, T, np.eye(4)) for T in (np.eye(4), by_a_metre)]  # type: ignore[arg-type]
    motion = model.motion_of(recording)
    flange, shifted = (shown_poses(replace(model, model=rigid), motion) for rigid in bare)
    # an effect of the sensor's scale multiplies positions: by how much a frame shifted by a metre shows them moved
    growth = (shifted - flange)[:, 0, 3]
    flange[:, :3, 3] /= growth[:, None]
    used = np.isfinite(growth)
    require_samples(recording.select(used), _NUMBERS[recording.numbers_per_sample])
    position = recording.position
    rotation = measured_rotations(recording)
    assert position is not None
    rotation = None if rotation is None else rotation[used]
    noise = noise_of(recording.settings)
    before = np.asarray(model.model.T_flange_tool)[:3, :3]
    registration = register(flange[used], (position / growth[:, None])[used], rotation, noise, tool_rotation=before)
    if not registration.determined:
        raise InputError(
            f"{recording.source}: its poses do not determine sensor frame and tool; record some that turn the flange "
            "about other axes"
        )
    rigid = ArmModel(model.model.geometry, registration.T_sensor_base, registration.T_flange_tool)  # type: ignore[arg-type]
    moved = replace(model, model=rigid, orientation=rotation is not None)
    noise = registration.noise[0], registration.noise[1] if rotation is not None else None
    return replace(
        moved, uncertainty=_with_own_frames(moved, moved.motion_of(recording.select(used)), noise)
    ), registration


def _with_own_frames(model: DiagnosedArm, motion: Motion, noise: tuple[float, float | None]) -> Uncertainty | None:
    """The uncertainty of a model whose frames were fitted anew to the poses of a motion, with noise in m and rad.

    These frames then follow whatever else of the model is off, as far as they can, and have the fit's own error.
    """
    uncertainty = model.uncertainty
    if uncertainty is None:
        return None
    rows = 3 if noise[1] is None else 6
    frames: list[Site] = [*(("base", 0, k) for k in range(6)), *(("tool", 0, k) for k in range(rows))]
    stays = [name not in ("base", "tool") for name, _, _ in uncertainty.sites]
    retained = tuple(site for site, remains in zip(uncertainty.sites, stays, strict=True) if remains)
    J = Derivatives(model, motion, (*frames, *retained)).all()[:, :rows]
    J = J / np.repeat([noise[0], noise[1] or 1.0], 3)[:rows, None]
    F, R = np.split(J.reshape(len(J), -1), [len(frames)])
    frame_covariance = scaled_inverse(F @ F.T)
    follow = frame_covariance @ (F @ R.T)
    numbers = np.flatnonzero([*stays, *([True] * (len(uncertainty.covariance) - len(stays)))])
    covariance = uncertainty.covariance[np.ix_(numbers, numbers)]
    together = -follow @ covariance
    C = np.block([[frame_covariance - together @ follow.T, together], [together.T, covariance]])
    return replace(
        uncertainty, sites=(*frames, *retained), covariance=C, typical=None
    )  # the new frames are less certain


@final
@dataclass(frozen=True, eq=False)
class _Frames(NuisanceProblem):
    """Sensor frame and tool of a chain whose flange is known, as a problem of least squares.

    Unknown are some of twelve numbers: a twist of the base and one of the flange, each in its own axes.
    """

    flange: Array
    measured: PoseSensor
    T_sensor_base: Array
    T_flange_tool: Array
    unknown: Integers

    @property
    def precision(self) -> Array:
        return np.zeros(len(self.unknown))

    offset = precision

    @cached_property
    def rigid(self) -> RigidFrames:
        flange = self.T_sensor_base @ self.flange
        base = np.broadcast_to(self.T_sensor_base, flange.shape)
        return RigidFrames(np.stack([base, flange]), flange @ self.T_flange_tool)

    @property
    def frame_columns(self) -> Array:
        twists = rigid_columns(self.rigid, self.measured).reshape(12, self.rows, -1)
        return whitened(twists[self.unknown], self.measured.whitener)

    def relinearised(self, nuisance: Array, beside: tuple[Terms, Array] | None = None) -> "_Frames":
        change = np.zeros(12)
        change[self.unknown] = nuisance
        F, T = (small_displacement(twist) for twist in (change[:6], change[6:]))
        return replace(self, T_sensor_base=self.T_sensor_base @ F, T_flange_tool=T @ self.T_flange_tool)
