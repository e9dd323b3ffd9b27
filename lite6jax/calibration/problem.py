"""From a calibration or a recording to what is to be solved: data, noise, what is known and where to start."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.factory import FactoryCalibration, hayati_of, read_factory
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.calibration.residual import POSE, POSITION
from lite6jax.calibration.source import arm_of
from lite6jax.calibration.start import (
    calibration_poses,
    declared_tool,
    frames_from_recording,
    measured_rotations,
    nominal_calibration,
)
from lite6jax.errors import InputError
from lite6jax.model import ArmModel, ModelForm
from lite6jax.recordings import FactoryUncertainty, Recording, require_samples
from lite6jax.recordings.units import other_joints
from lite6jax.sensors.pose import PoseSensor

Geometry = Literal["declared", "exact", "prior", "free"]

UNDECLARED_NOISE = (1e-4, 1e-3)
"""Position (m) and orientation (rad) noise per axis of the first fit, each where a recording does not declare it."""
TOLERANCE = {"m": 0.02, "rad": 0.05}
"""Standard deviation of the prior of each number of an unknown chain about nominal. It is wide enough for any arm: real
ones are up to 10 mm and 1° off. What the data do not determine stays near nominal by it."""
TOUCHED_TOLERANCE = (1e-3, 5e-3)
"""The same (m, rad) where touches are all that is measured: they are few, and bend a chain where nothing holds it. What
factories grant is 1 mm and 0.3°."""
DEFAULT_UNCERTAINTY = (1e-4, 1e-4)
"""Prior standard deviation of a factory number (m, rad) where geometry is `prior` and none is declared."""


@dataclass(frozen=True)
class CalibrationProblem:
    """One arm's fit, ready to solve.

    Attributes:
        arm: the nominal arm.
        form: what may move.
        start: where from: nominal geometry, frames where the data puts them.
        joint_position: `(sample, joint)` rad.
        pose: `(sample, 4, 4)`, or `(sample, 3)` where only positions were measured.
        noise: one standard deviation per axis of position (m) and orientation (rad), None where that is not measured.
        precision: `(size,)` of the prior about the start's geometry; zero is none.
        movable: `(size,)` bool, the parameters to estimate.
        declared_noise: the noise as declared, each None where it is not, or not measured.
        by_joints: `(sample, row, row)`, what the noise of the joints' read-out adds to the covariance of a sample's
            residual; None where there is none.
        spread: `(sample, row, row)`, the covariance of each measured pose; None where `noise` says it.
        notes: what was assumed.
    """

    arm: Arm
    form: ModelForm
    start: ArmModel
    joint_position: Array
    pose: Array
    noise: tuple[float, float | None]
    precision: Array
    movable: Mask
    declared_noise: tuple[float | None, float | None] = (None, None)
    by_joints: Array | None = None
    spread: Array | None = None
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """Numbers a sample gives: 3 or 6."""
        return POSITION if self.pose.ndim == 2 else POSE

    @property
    def covariance(self) -> Array:
        """Covariance of a sample's residual: `(row, row)`, or `(sample, row, row)` with read-out noise of joints."""
        position, orientation = self.noise
        variance = np.square((position, orientation or position))
        if self.spread is not None:  # what the noise is more than declared was added to it
            variance = np.maximum(variance - np.square(np.array(self.declared_noise, float)), 0.0)
        sensor = np.diag(np.repeat(variance, 3)[: self.rows])
        if self.spread is not None:
            sensor = sensor + self.spread
        if self.by_joints is None:
            return sensor
        return sensor + self.by_joints

    @cached_property
    def whitener(self) -> Array:
        """What makes the noise of a residual unit: `(2,)`, or `(sample, row, row)`."""
        covariance = self.covariance
        if covariance.ndim == 2:
            return 1 / np.sqrt(np.diagonal(covariance)[[0, -1]])
        return np.linalg.inv(np.linalg.cholesky(covariance))

    def select(self, samples: Integers | Mask) -> "CalibrationProblem":
        """With some of the samples."""
        by_joints, spread = (None if part is None else part[samples] for part in (self.by_joints, self.spread))
        q = self.joint_position[samples]
        pose = self.pose[samples]
        return replace(self, joint_position=q, pose=pose, by_joints=by_joints, spread=spread)


class DeclaredGeometry(NamedTuple):
    """What a recording and its sidecar say of the arm before anything is measured.

    Attributes:
        arm: the nominal arm.
        known: its calibration, or the nominal chain.
        form: what may move.
        values: of the chain.
        movable: `(size,)` bool.
        precision: `(size,)`, of the declared prior.
        uncertainty: of the calibration; None where none is declared.
        calibrated: whether there is one.
    """

    arm: Arm
    known: FactoryCalibration
    form: ModelForm
    values: Array
    movable: Mask
    precision: Array
    uncertainty: FactoryUncertainty | None
    calibrated: bool


def declared_geometry(
    recording: Recording, arm: Arm | None, geometry: Geometry, factory: FactoryCalibration | None = None
) -> DeclaredGeometry:
    """The chain of a recording, and what of it, of the sensor's frame and of the tool is unknown.

    Geometry: with a factory calibration it is that (`exact`), with `factory_uncertainty` near it (`prior`: the
    six-parameter chain, each number with its standard deviation), without one it is unknown (`free`: the Hayati chain
    from nominal; of touches the six-parameter chain, near nominal). A `factory` calibration that is given replaces the
    sidecar's, its uncertainty included.
    """
    settings = recording.settings
    folder = Path(recording.source).parent
    arm = arm or arm_of(recording)
    if recording.dof != arm.dof:
        raise InputError(
            f"{recording.source}: has {recording.dof} joints, but {arm.name} has {arm.dof}; name the arm with "
            "`arm=NAME`"
        )
    if recording.sliding != arm.sliding:
        raise InputError(f"{recording.source}: {other_joints(recording.sliding, arm.sliding, arm.name)}")
    require_samples(recording, 1)
    factory_path = settings.factory_path(folder)
    uncertainty = settings.factory_uncertainty
    if factory is not None:
        factory_path = factory.source
        uncertainty = None
    elif factory_path is not None:
        factory = read_factory(factory_path, arm)
    if factory is not None and not np.allclose(factory.T_joint_flange, arm.T_joint_flange, rtol=0, atol=1e-12):
        raise InputError(
            f"{factory_path}: holds a transform after the last joint (a{arm.dof}, alpha{arm.dof}), where a recording "
            f"has its tool; give the six-parameter file, or the tool in the sidecar"
        )
    if geometry == "declared":
        geometry = "exact" if uncertainty is None else "prior"
        if factory is None:
            geometry = "free"
    if geometry in ("exact", "prior") and factory is None:
        raise InputError(
            f"{recording.source}: geometry {geometry!r} needs a factory_calibration in the sidecar; use "
            "`geometry='free'`"
        )
    touches = recording.touches
    # touches tell nothing of a frame but where all points are known in it
    frame = settings.pose_frame != "base"
    tool = settings.tool == "unknown"
    if touches is not None:
        points = settings.contact_points or {}
        frame = (
            frame and touches.kind == "contact" and all(touches.names[k] in points for k in np.unique(touches.group))
        )
    prior_calibration = factory or nominal_calibration(arm)
    if geometry == "free" and touches is None:
        form = ModelForm(arm.form, frame, tool)
        values = arm.hayati if factory is None else hayati_of(factory)
    else:
        form = ModelForm(SixParameterForm(arm.dof, arm.sliding), frame, tool)
        values = prior_calibration.kinematics.ravel()
    movable = np.ones(form.size, bool)
    precision = np.zeros(form.size)
    if geometry == "exact":
        movable[: form.chain.size] = False
    if geometry == "prior":
        sigma = DEFAULT_UNCERTAINTY if uncertainty is None else (uncertainty.position_m, uncertainty.rotation_rad)
    elif geometry == "free" and touches is not None:
        sigma = TOUCHED_TOLERANCE
    else:
        sigma = None
    if sigma is not None:
        precision[: form.chain.size] = [1 / sigma[unit == "rad"] ** 2 for unit in form.chain.units]
    return DeclaredGeometry(arm, prior_calibration, form, values, movable, precision, uncertainty, factory is not None)


def recording_problem(
    recording: Recording, arm: Arm | None, geometry: Geometry, factory: FactoryCalibration | None = None
) -> CalibrationProblem:
    """What a recording of poses and its sidecar say is to be fitted.

    Frames that the sidecar calls unknown start where a closed form puts them.

    Raises:
        InputError: no measured poses, too few of them, joints that the arm does not have, a `geometry` that needs a
            factory calibration where there is none.
    """
    arm, prior_calibration, form, values, movable, precision, *_ = declared_geometry(recording, arm, geometry, factory)
    settings = recording.settings
    tool = form.tool
    notes: list[str] = []

    flange = calibration_poses(prior_calibration, recording.joint_position)
    T_sensor_base, T_flange_tool = frames_from_recording(recording, flange, None if tool else declared_tool(recording))
    T_flange_tool = prior_calibration.T_joint_flange @ T_flange_tool
    rotation = measured_rotations(recording)
    pose = recording.position
    assert pose is not None
    declared = (settings.position_noise_m, None)
    if rotation is not None:
        declared = (settings.position_noise_m, settings.orientation_noise_rad)
        T = np.zeros((recording.samples, 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = rotation, pose, 1.0
        pose = T
    observed = None if recording.readings is None else recording.readings.seen
    spread = None
    if observed is not None:
        U = np.linalg.inv(observed.whitener)
        spread = U @ np.swapaxes(U, 1, 2)
        variance = np.diagonal(spread, axis1=1, axis2=2)
        declared = float(np.sqrt(variance[:, :3].mean())), float(np.sqrt(variance[:, 3:].mean()))
    noise = (declared[0] or UNDECLARED_NOISE[0], None)
    lacking = [declared[0] is None, False]
    if rotation is not None:
        noise = (noise[0], declared[1] or UNDECLARED_NOISE[1])
        lacking[1] = declared[1] is None
    if any(lacking):
        quantities = "positions" if lacking[0] else "orientations"
        if all(lacking):
            quantities = "all that is measured"
        notes.append(f"the sidecar does not declare the noise of {quantities}: it is taken from the residuals")
    by_joints = None
    if settings.joint_noise_rad:
        parts = []
        for block in (slice(first, first + frames.BLOCK) for first in range(0, recording.samples, frames.BLOCK)):
            turned = None if rotation is None else rotation[block]
            q = recording.joint_position[block]
            parts.append(_residual_by_joints(prior_calibration, q, T_sensor_base, T_flange_tool, turned))
        J = np.concatenate(parts)
        by_joints = settings.joint_noise_rad**2 * J @ np.swapaxes(J, 1, 2)
    return CalibrationProblem(
        arm=arm,
        form=form,
        start=ArmModel(values, T_sensor_base, T_flange_tool),  # type: ignore[arg-type]
        joint_position=recording.joint_position,
        pose=pose,
        noise=noise,
        precision=precision,
        movable=movable,
        declared_noise=declared,
        by_joints=by_joints,
        spread=spread,
        notes=(*recording.notes, *notes),
    )


def _residual_by_joints(
    calibration: FactoryCalibration, q: Array, T_sensor_base: Array, T_flange_tool: Array, rotation: Array | None
) -> Array:
    """The residual's derivatives `(sample, row, joint)` by the revolute joints, which are not read without noise."""
    links = [frames.transform_from_row(row) for row in calibration.kinematics]
    arm = calibration.arm
    _, *walked = frames.walk(links, q, arm.sliding, T_sensor_base)
    tool = walked[-1] @ T_flange_tool
    joints = np.stack([walked[j] for j in np.flatnonzero(~arm.slides)])
    turn, origin = (np.moveaxis(joints[..., :3, k], 1, 2) for k in (2, 3))
    shift = np.cross(turn, tool[:, :3, 3].T - origin, axis=1)
    measured = PoseSensor(None, np.zeros((3, 3, 0)) if rotation is None else np.moveaxis(rotation, 0, -1), None)
    return np.moveaxis(measured.columns(tool, shift, turn), 2, 0).swapaxes(1, 2)
