"""Many arms of one type fitted in one call, each with its own result code."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from lite6jax.arms import bundled
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import six_parameter_fk
from lite6jax.arms.factory import read_factory
from lite6jax.errors import InputError, require_type
from lite6jax.fitting.chunks import MAX_STEPS, fit_chunks
from lite6jax.fitting.gauss_newton import Prior
from lite6jax.fitting.residual import POSE
from lite6jax.fitting.sampling import sample_within_limits
from lite6jax.fitting.solution import FleetSolution, Result
from lite6jax.model import LEVER, ArmModel, ModelForm
from lite6jax.recordings import require_radians
from lite6jax.recordings.units import real_array


def fit_fleet(
    joint_position: ArrayLike,
    T_base_flange: ArrayLike,
    *,
    nominal: Arm | str,
    noise: tuple[float, float] | None = None,
    weight: ArrayLike | None = None,
    max_steps: int = MAX_STEPS,
    progress: Callable[[int], object] | None = None,
) -> FleetSolution:
    """Fits the Hayati model of many arms of one type to their flange poses, in one call.

    Args:
        joint_position: `(arm, sample, joint)` rad, or `(sample, joint)` for all arms.
        T_base_flange: `(arm, sample, 4, 4)` m; a pose that is not finite counts as missing.
        nominal: the arm's type, an `Arm` or the name of a bundled one.
        noise: one standard deviation of position (m, per axis) and orientation (rad, per axis). None weighs a radian
            like 0.1 m, as the seed does, and takes the covariance from the residuals.
        weight: `(arm, sample)`; zero for a sample that an arm does not have, so that ragged arms fit in one array.
        max_steps: most Gauss–Newton steps an arm may take.
        progress: called with the number of arms done since the last call.

    Returns:
        A `FleetSolution`. An arm whose fit fails has its `result` say so; the others are not affected.

    Raises:
        InputError: arrays whose shapes do not fit each other or the arm, noise that is not positive, negative weights.
    """
    require_type("nominal", nominal, Arm | str, "an Arm or the name of a bundled one")
    arm = bundled.load_bundled(nominal) if isinstance(nominal, str) else nominal
    q, T = real_array("joint_position", joint_position), real_array("T_base_flange", T_base_flange)
    if T.ndim != 4 or T.shape[2:] != (4, 4):
        raise InputError(f"T_base_flange of shape {T.shape}: give (arm, sample, 4, 4)")
    arms, samples = T.shape[:2]
    if q.shape not in ((arms, samples, arm.dof), (samples, arm.dof)):
        raise InputError(
            f"joint_position of shape {q.shape}: {arm.name} with these poses takes ({arms}, {samples}, {arm.dof}), "
            f"or ({samples}, {arm.dof}) shared by all arms"
        )
    require_radians(q, arm.joint_limits)
    w = np.ones((arms, samples)) if weight is None else np.asarray(weight, float)
    if w.shape != (arms, samples) or not (np.isfinite(w) & (w >= 0)).all():
        raise InputError(
            f"weight of shape {w.shape}: give ({arms}, {samples}) numbers that are finite and not negative"
        )
    sigma = np.asarray((1.0, 1 / LEVER) if noise is None else noise, float)
    if sigma.shape != (2,) or not (np.isfinite(sigma) & (sigma > 0)).all():
        raise InputError(
            f"noise {noise}: give two positive standard deviations, of position in m and orientation in rad"
        )
    if arms == 0 or samples == 0:
        raise InputError(f"T_base_flange of shape {T.shape}: give at least one arm and one sample")

    form = ModelForm(arm.form)
    prior = Prior(arm.hayati, np.zeros(form.size), np.ones(form.size))  # type: ignore[arg-type]
    start = ArmModel(arm.hayati, np.eye(4), arm.T_joint_flange)  # type: ignore[arg-type]
    summary = fit_chunks(
        form,
        start,
        q,
        T,
        w,
        1 / sigma,
        None,
        prior,
        max_steps=max_steps,
        progress=progress,  # type: ignore[arg-type]
    )
    solved = summary.solved
    numbers = POSE * np.asarray(summary.samples)
    result = np.where(numbers < form.size, Result.TOO_FEW_SAMPLES, solved.status).astype(np.int32)
    covariance = np.asarray(summary.covariance)
    if noise is None:
        spread = 2 * np.asarray(solved.cost) / np.maximum(numbers - form.size, 1)
        covariance = covariance * spread[:, None, None]
    return FleetSolution(
        form=form,
        parameters=np.asarray(solved.model.geometry),
        covariance=covariance,
        result=result,
        steps=np.asarray(solved.steps),
        position_rms=np.asarray(summary.position_rms),
        orientation_rms=np.asarray(summary.orientation_rms),
        cost=np.asarray(solved.cost),
    )


def fit_fleet_calibrations(
    factory: ArrayLike | Sequence[str | Path],
    *,
    nominal: Arm | str,
    samples: int = 300,
    seed: int = 0,
    progress: Callable[[int], object] | None = None,
) -> FleetSolution:
    """Fits the Hayati model of many arms to their six-parameter calibrations, by sampling the chains.

    Args:
        factory: `(arm, joint, 6)`, x y z (m) roll pitch yaw (rad) per joint; or the paths of calibrations.
        nominal: the arm's type, an `Arm` or the name of a bundled one.
        samples: joint positions, uniform inside the arm's limits, the same for all arms.
        seed: of those.
        progress: as in `fit_fleet`.

    Raises:
        InputError: a wrong shape or type, or as `read_factory`.
    """
    require_type("nominal", nominal, Arm | str, "an Arm or the name of a bundled one")
    arm = bundled.load_bundled(nominal) if isinstance(nominal, str) else nominal
    if isinstance(factory, list | tuple) and any(isinstance(each, str | Path) for each in factory):
        factory = np.stack([read_factory(path, arm).kinematics for path in factory])
    kinematics = real_array("factory", cast(ArrayLike, factory))
    if kinematics.ndim != 3 or kinematics.shape[1:] != (arm.dof, 6):
        raise InputError(f"factory of shape {kinematics.shape}: {arm.name} takes (arm, {arm.dof}, 6)")
    q = sample_within_limits(arm, samples, seed)
    poses = jax.vmap(lambda rows: six_parameter_fk(rows, q, arm.sliding))(jnp.asarray(kinematics)) @ arm.T_joint_flange
    solution = fit_fleet(q, poses, nominal=arm, progress=progress)
    broken = ~np.isfinite(kinematics).all((1, 2))
    return replace(solution, result=np.where(broken, Result.NOT_FINITE, solution.result).astype(np.int32))
