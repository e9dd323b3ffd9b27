"""From a calibration or a recording to what is to be solved: data, noise, what is known and where to start."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm, fk
from lite6jax.arms.factory import FactoryCalibration, hayati_of, read_factory
from lite6jax.arms.se3 import joint_rate, rotation_from_quaternion, rotation_from_rpy, transform
from lite6jax.errors import InputError
from lite6jax.fitting.chunks import observe, pad, padded_size
from lite6jax.fitting.recognition import arm_of
from lite6jax.fitting.residual import POSE, POSITION, Observations, differences, predict_frames
from lite6jax.fitting.start import frames_from_poses
from lite6jax.model import LEVER, ArmModel, ModelForm
from lite6jax.recordings import Recording, require_samples
from lite6jax.recordings.units import other_joints

Array = NDArray[np.floating]
Geometry = Literal["declared", "exact", "prior", "free"]

UNDECLARED_NOISE = (1e-4, 1e-3)
"""Position (m) and orientation (rad) noise per axis of the first fit, each where a recording does not declare it."""
TOLERANCE = {"m": 0.02, "rad": 0.05}
"""Standard deviation of the prior of each number of an unknown chain about nominal. It is wide enough for any arm: real
ones are up to 10 mm and 1° off. What the data do not determine stays near nominal by it."""
DEFAULT_UNCERTAINTY = (1e-4, 1e-4)
"""Prior standard deviation of a factory number (m, rad) where geometry is `prior` and none is declared."""


@dataclass(frozen=True)
class Problem:
    """One arm's fit, ready to solve.

    Attributes:
        arm: the nominal arm.
        form: what may move.
        start: where from: nominal geometry, frames where the data puts them.
        joint_position: `(sample, joint)` rad.
        pose: `(sample, 4, 4)`, or `(sample, 3)` where only positions were measured.
        noise: one standard deviation per axis of position (m) and orientation (rad), None where that is not measured.
        joint_noise: of a joint's read-out, rad.
        precision: `(size,)` of the prior that is declared; zero is none.
        movable: `(size,)` bool, the parameters to estimate.
        declared_noise: the noise as declared, each None where it is not, or not measured.
        exact: whether the poses have no noise: they are computed from a calibration.
        notes: what was assumed.
    """

    arm: Arm
    form: ModelForm
    start: ArmModel
    joint_position: Array
    pose: Array
    noise: tuple[float, float | None]
    joint_noise: float
    precision: Array
    movable: NDArray[np.bool_]
    declared_noise: tuple[float | None, float | None]
    exact: bool = False
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """Numbers a sample gives: 3 or 6."""
        return POSITION if self.pose.ndim == 2 else POSE

    @property
    def tolerance(self) -> Array:
        """`(size,)`, the precision of the prior of what is fitted and nothing is declared of; zero of frames."""
        chain, precision = self.form.chain, np.zeros(self.form.size)
        if not self.exact:
            precision[: chain.size] = [TOLERANCE[unit] ** -2.0 for unit in chain.units]
        return np.where(self.movable & (self.precision == 0), precision, 0.0)

    def select(self, samples: NDArray[np.integer]) -> "Problem":
        """With some of the samples."""
        return replace(self, joint_position=self.joint_position[samples], pose=self.pose[samples])

    def covariance(self) -> Array:
        """Of a sample's residual, as declared: `(row, row)`, or `(sample, row, row)` with read-out noise of the joints.

        It is Σ + σ_q² J Jᵀ with J the residual's derivative by the joint positions, the manipulator Jacobian in the
        residual's axes. Prismatic joints are read without noise.
        """
        position, orientation = self.noise
        sensor = np.diag(np.repeat(np.square((position, orientation or position)), 3)[: self.rows])
        if not self.joint_noise:
            return sensor
        size, block = padded_size(len(self.pose))
        J = _residual_by_joints(
            self.form, self.start, pad(self.joint_position, 0, size), pad(self.pose, 0, size), block
        )
        J = np.asarray(J)[: len(self.pose)][..., ~self.arm.slides]
        return sensor + self.joint_noise**2 * J @ np.swapaxes(J, 1, 2)


def whitener_of(covariance: Array) -> Array:
    """The whitener of a `(row, row)` covariance, isotropic in each part, or of `(sample, row, row)` ones."""
    if covariance.ndim == 2:
        return 1 / np.sqrt(np.diagonal(covariance)[[0, -1]])
    return np.linalg.inv(np.linalg.cholesky(covariance))


def calibration_problem(calibration: FactoryCalibration, joint_position: Array, pose: Array) -> Problem:
    """The Hayati model that reproduces a calibrated chain's poses `(sample, 4, 4)`, from nominal."""
    arm = calibration.arm
    form = ModelForm(arm.form)
    return Problem(
        arm=arm,
        form=form,
        start=ArmModel(arm.hayati, np.eye(4), arm.T_joint_flange),  # type: ignore[arg-type]
        joint_position=joint_position,
        pose=pose,
        noise=(1.0, 1 / LEVER),
        joint_noise=0.0,
        precision=np.zeros(form.size),
        movable=np.ones(form.size, bool),
        declared_noise=(None, None),
        exact=True,
    )


def calibration_poses(calibration: FactoryCalibration, joint_position: Array) -> Array:
    """The calibrated chain's flange poses `(sample, 4, 4)`."""
    links = np.array([frames.transform_from_row(row) for row in calibration.kinematics])
    return frames.chain(links, joint_position, calibration.arm.sliding) @ calibration.T_joint_flange


def recording_problem(
    recording: Recording, arm: Arm | None, geometry: Geometry, factory: FactoryCalibration | None = None
) -> Problem:
    """What a recording and its sidecar say is to be fitted.

    Geometry: with a factory calibration it is that (`exact`), with `factory_uncertainty` near it (`prior`: the
    six-parameter chain, each number with its standard deviation), without one it is unknown (`free`: the Hayati chain
    from nominal). Frames that the sidecar calls unknown start where a closed form puts them. A `factory` calibration
    that is given replaces the sidecar's, its uncertainty included.

    Raises:
        InputError: no measured poses, too few of them, joints that the arm does not have, a `geometry` that needs a
            factory calibration where there is none.
    """
    settings, folder = recording.settings, Path(recording.source).parent
    arm = arm or arm_of(recording)
    if recording.dof != arm.dof:
        raise InputError(
            f"{recording.source}: has {recording.dof} joints, but {arm.name} has {arm.dof}; name the arm with --arm"
        )
    if recording.sliding != arm.sliding:
        raise InputError(f"{recording.source}: {other_joints(recording.sliding, arm.sliding, arm.name)}")
    require_samples(recording, 1)
    notes: list[str] = []
    factory_path, uncertainty = settings.factory_path(folder), settings.factory_uncertainty
    if factory is not None:
        factory_path, uncertainty = factory.source, None
    elif factory_path is not None:
        factory = read_factory(factory_path, arm)
    if factory is not None and not np.allclose(factory.T_joint_flange, arm.T_joint_flange, rtol=0, atol=1e-12):
        raise InputError(
            f"{factory_path}: holds a transform after the last joint (a{arm.dof}, alpha{arm.dof}), where a recording "
            f"has its tool; give the six-parameter file, or the tool in the sidecar"
        )
    if geometry == "declared":
        geometry = "free" if factory is None else "exact" if uncertainty is None else "prior"
    if geometry in ("exact", "prior") and factory is None:
        raise InputError(
            f"{recording.source}: geometry {geometry!r} needs a factory_calibration in the sidecar; use --geometry free"
        )

    frame, tool = settings.pose_frame != "base", settings.tool == "unknown"
    T_joint_flange = arm.T_joint_flange if factory is None else factory.T_joint_flange
    if geometry == "free":
        form = ModelForm(arm.form, frame, tool)
        values = arm.hayati if factory is None else hayati_of(factory)
    else:
        form = ModelForm(SixParameterForm(arm.dof, arm.sliding), frame, tool)
        assert factory is not None
        values = factory.kinematics.ravel()
    movable = np.ones(form.size, bool)
    precision = np.zeros(form.size)
    if geometry == "exact":
        movable[: form.chain.size] = False
    if geometry == "prior":
        sigma = DEFAULT_UNCERTAINTY if uncertainty is None else (uncertainty.position_m, uncertainty.rotation_rad)
        precision[: form.chain.size] = [1 / sigma[unit == "rad"] ** 2 for unit in form.chain.units]

    position = recording.position
    assert position is not None
    rotation = None if recording.quaternion is None else np.asarray(rotation_from_quaternion(recording.quaternion))
    pose = position if rotation is None else np.asarray(transform(rotation, position))
    known_tool = np.eye(4)
    if not isinstance(settings.tool, str):
        known_tool = np.asarray(transform(rotation_from_rpy(np.array(settings.tool[3:])), np.array(settings.tool[:3])))
    flange = np.asarray(fk(form.chain, values, recording.joint_position)) @ T_joint_flange
    T_sensor_base, T_flange_tool = frames_from_poses(
        flange, position, rotation, None if frame else np.eye(4), None if tool else known_tool
    )
    start = ArmModel(values, T_sensor_base, T_joint_flange @ T_flange_tool)  # type: ignore[arg-type]
    declared = (settings.position_noise_m, None if rotation is None else settings.orientation_noise_rad)
    noise = (declared[0] or UNDECLARED_NOISE[0], None if rotation is None else declared[1] or UNDECLARED_NOISE[1])
    lacking = [declared[0] is None, rotation is not None and declared[1] is None]
    if any(lacking):
        what = "positions" if not lacking[1] else "all that is measured" if lacking[0] else "orientations"
        notes.append(f"the sidecar does not declare the noise of {what}: it is taken from the residuals")
    return Problem(
        arm=arm,
        form=form,
        start=start,
        joint_position=recording.joint_position,
        pose=pose,
        noise=noise,
        joint_noise=settings.joint_noise_rad,
        precision=precision,
        movable=movable,
        declared_noise=declared,
        notes=(*recording.notes, *notes),
    )


@partial(jax.jit, static_argnums=(0, 4))
def _residual_by_joints(
    form: ModelForm, model: ArmModel, joint_position: jax.Array, pose: jax.Array, block: int
) -> jax.Array:
    observed = observe(form, joint_position, pose, jnp.ones(len(pose)), jnp.ones(2), block)

    def one(part: Observations) -> jax.Array:
        def by_joint(direction: jax.Array) -> jax.Array:
            turning = joint_rate(part.joint, direction, form.chain.sliding)
            return jax.jvp(
                lambda joint: differences(part, predict_frames(form, model, joint)[1]), (part.joint,), (turning,)
            )[1]

        return jnp.transpose(jax.vmap(by_joint)(jnp.eye(form.chain.dof)), (2, 1, 0))

    J = jax.lax.map(one, observed)
    return J.reshape(-1, *J.shape[2:])
