"""From a calibration or a recording to what is to be solved: data, noise, what is known and where to start."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import convert
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm, Turn, fk, six_parameter_fk, turn
from lite6jax.arms.factory import FactoryCalibration, read_factory
from lite6jax.arms.files import read_arm
from lite6jax.arms.se3 import rotation_from_quaternion, rotation_from_rpy, transform
from lite6jax.errors import InputError
from lite6jax.fitting.fleet import LEVER, observe, sample_within_limits
from lite6jax.fitting.residual import POSE, Observations, differences, predict_frames
from lite6jax.fitting.start import frames_from_poses
from lite6jax.model import ArmModel, ModelForm
from lite6jax.recordings import Recording, require_samples

Array = NDArray[np.float64]
Geometry = Literal["declared", "exact", "prior", "free"]

UNDECLARED_NOISE = (1e-4, 1e-3)
"""Position (m) and orientation (rad) noise per axis where a recording declares none; only their ratio matters then."""
DEFAULT_UNCERTAINTY = (1e-4, 1e-4)
"""Prior of a factory number (m, rad) where `prior` is asked for and none is declared."""


@dataclass(frozen=True)
class Problem:
    """One arm's fit, ready to solve.

    Attributes:
        arm: the nominal arm.
        form: what may move.
        start: where from: nominal geometry, frames where the data puts them.
        joint_position: `(sample, joint)` rad.
        pose: `(sample, 4, 4)`, or `(sample, 3)` where only positions were measured.
        whitener: `(2,)` or `(sample, row, row)`.
        precision: `(size,)` of the prior; zero is none.
        movable: `(size,)` bool, what the fit is asked to move.
        noisy: whether the data is measured; a calibration's samples are exact.
        declared: whether the noise was.
        notes: what was assumed.
    """

    arm: Arm
    form: ModelForm
    start: ArmModel
    joint_position: Array
    pose: Array
    whitener: Array
    precision: Array
    movable: NDArray[np.bool_]
    noisy: bool
    declared: bool
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """Numbers a sample gives: 3 or 6."""
        return 3 if self.pose.ndim == 2 else POSE


def calibration_problem(calibration: FactoryCalibration, samples: int, seed: int) -> Problem:
    """The Hayati model that reproduces a calibrated chain, sampled inside the arm's limits as the seed does."""
    arm = calibration.arm
    form = ModelForm(arm.form)
    q = sample_within_limits(arm, samples, seed)
    return Problem(
        arm=arm,
        form=form,
        start=ArmModel(arm.hayati, np.eye(4), arm.T_joint_flange),  # type: ignore[arg-type]
        joint_position=q,
        pose=calibration_poses(calibration, q),
        whitener=np.array([1.0, LEVER]),
        precision=np.zeros(form.size),
        movable=np.ones(form.size, bool),
        noisy=False,
        declared=False,
    )


def calibration_poses(calibration: FactoryCalibration, joint_position: Array) -> Array:
    """The calibrated chain's flange poses `(sample, 4, 4)`."""
    return np.asarray(six_parameter_fk(calibration.kinematics, joint_position) @ calibration.T_joint_flange)


def recording_problem(recording: Recording, arm: Arm | None, geometry: Geometry) -> Problem:
    """What a recording and its sidecar say is to be fitted.

    Geometry: with a factory calibration it is that (`exact`), with `factory_uncertainty` near it (`prior`: the
    six-parameter chain, each number with its standard deviation), without one it is unknown (`free`: the Hayati chain
    from nominal). Frames that the sidecar calls unknown start where a closed form puts them.

    Raises:
        InputError: no measured poses, too few of them, joints that the arm does not have, a `geometry` that needs a
            factory calibration where there is none, nothing to fit.
    """
    settings, folder = recording.settings, Path(recording.source).parent
    arm = arm or read_arm(settings.arm_reference(folder))
    if recording.dof != arm.dof:
        raise InputError(f"{recording.source}: has {recording.dof} joints, but {arm.name} has {arm.dof}; name the arm with --arm")
    require_samples(recording, 1)
    notes: list[str] = []
    factory_path = settings.factory_path(folder)
    factory = read_factory(factory_path, arm) if factory_path else None
    uncertainty = settings.factory_uncertainty
    if geometry == "declared":
        geometry = "free" if factory is None else "exact" if uncertainty is None else "prior"
    if geometry in ("exact", "prior") and factory is None:
        raise InputError(f"{recording.source}: geometry {geometry!r} needs a factory_calibration in the sidecar; use --geometry free")

    frame, tool = settings.pose_frame != "base", settings.tool == "unknown"
    T_joint_flange = arm.T_joint_flange if factory is None else factory.T_joint_flange
    if geometry == "free":
        form = ModelForm(arm.form, frame, tool)
        values = arm.hayati if factory is None else convert.six_parameter_to_hayati(arm.form, factory.kinematics, arm.hayati)
    else:
        form = ModelForm(SixParameterForm(arm.dof), frame, tool)
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
    declared = settings.position_noise_m is not None
    sigma = (settings.position_noise_m or UNDECLARED_NOISE[0], settings.orientation_noise_rad or UNDECLARED_NOISE[1])
    if not declared:
        notes.append("The sidecar declares no noise: it is estimated from the residuals.")
    whitener = 1 / np.array(sigma)
    if settings.joint_noise_rad:
        whitener = joint_noise_whitener(form, start, recording.joint_position, pose, sigma, settings.joint_noise_rad)
    return Problem(
        arm=arm,
        form=form,
        start=start,
        joint_position=recording.joint_position,
        pose=pose,
        whitener=whitener,
        precision=precision,
        movable=movable,
        noisy=True,
        declared=declared,
        notes=(*recording.notes, *notes),
    )


def joint_noise_whitener(
    form: ModelForm, model: ArmModel, joint_position: Array, pose: Array, sigma: tuple[float, float], joint_sigma: float
) -> Array:
    """Whiteners `(sample, row, row)` of the sensor's noise plus the read-out noise of the joints.

    The residual's covariance is Σ + σ_q² J Jᵀ with J its derivative by the joint positions (the manipulator Jacobian in
    the residual's axes); the whitener is the inverse of its Cholesky factor.
    """
    J = np.asarray(_residual_by_joints(form, model, joint_position, pose))
    rows = J.shape[1]
    covariance = joint_sigma**2 * J @ np.swapaxes(J, 1, 2) + np.diag(np.repeat(np.square(sigma), 3)[:rows])
    return np.linalg.inv(np.linalg.cholesky(covariance))


@partial(jax.jit, static_argnums=0)
def _residual_by_joints(form: ModelForm, model: ArmModel, joint_position: jax.Array, pose: jax.Array) -> jax.Array:
    samples = len(pose)
    observed = observe(joint_position, pose, jnp.ones(samples), jnp.ones(2), samples)
    block: Observations = jax.tree.map(lambda leaf: leaf[0], observed)

    def by_joint(direction: jax.Array) -> jax.Array:
        def moved(by: jax.Array) -> jax.Array:
            joint: Turn = turn(joint_position.T + by * direction[:, None])
            return differences(block, predict_frames(form, model, joint)[1])

        return jax.jvp(moved, (0.0,), (1.0,))[1]

    return jnp.transpose(jax.vmap(by_joint)(jnp.eye(joint_position.shape[1])), (2, 1, 0))
