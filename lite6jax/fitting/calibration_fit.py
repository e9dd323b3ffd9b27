"""The fit of the Hayati model to a factory calibration, whose poses are computed and free of noise."""

import jax
import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import bundled_of
from lite6jax.arms.factory import FactoryCalibration, recognise
from lite6jax.errors import InputError
from lite6jax.fitting.chunks import MAX_STEPS
from lite6jax.fitting.problem import calibration_poses, calibration_problem, whitener_of
from lite6jax.fitting.residual import POSE
from lite6jax.fitting.sampling import SAMPLES, check_positions, sample_within_limits
from lite6jax.fitting.solution import Result, Solution, prediction_errors
from lite6jax.fitting.solve import Solver, solve


def fit_calibration(
    calibration: FactoryCalibration,
    *,
    solver: Solver = "gauss_newton",
    samples: int = SAMPLES,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
) -> Solution:
    """The Hayati model that reproduces a calibration; `checked` on 1000 fresh samples. See `fit`."""
    arm = calibration.arm
    if seed < 0:
        raise InputError(f"seed {seed}: give zero or more")
    fewest = -(-arm.form.size // POSE)
    if samples < fewest:
        raise InputError(
            f"samples {samples}: too few for {arm.form.size} parameters; give at least {fewest}, better 300"
        )
    # the fitted and the fresh samples in one array: the chain is then compiled for one shape
    q = np.concatenate([sample_within_limits(arm, samples, seed), check_positions(arm, seed)])
    pose = calibration_poses(calibration, q)
    problem = calibration_problem(calibration, q[:samples], pose[:samples])
    whitener = whitener_of(problem.covariance())
    estimates = solve(problem, problem.movable, whitener, np.ones((1, samples)), None, problem.start, solver, max_steps)
    model = jax.tree.map(lambda leaf: leaf[0], estimates.model)
    both = prediction_errors(problem.form, model, q, pose)
    return Solution(
        arm=arm,
        form=problem.form,
        model=model,
        result=Result(int(estimates.status[0])),
        steps=int(estimates.steps[0]),
        covariance=None,
        free=problem.movable,
        held=(),
        errors=both.select(slice(0, samples)),
        nominal_errors=prediction_errors(problem.form, problem.start, q, pose).select(slice(samples, None)),
        checked=both.select(slice(samples, None)),
        noise=None,
        weight=np.ones(samples),
        tolerance=problem.tolerance,
    )


def calibration_of_array(kinematics: ArrayLike, arm: Arm | None = None) -> FactoryCalibration:
    """A calibration from `(joint, 6)` numbers: x y z (m) roll pitch yaw (rad) of each joint.

    Raises:
        InputError: a wrong shape, numbers that are not finite, joints that the arm does not have.
    """
    kinematics = np.asarray(kinematics, float)
    if kinematics.ndim != 2 or kinematics.shape[1] != 6 or not np.isfinite(kinematics).all():
        raise InputError(f"calibration of shape {kinematics.shape}: give (joint, 6) finite numbers, m and rad")
    if arm is not None and arm.dof != len(kinematics):
        raise InputError(f"calibration: has {len(kinematics)} joints, but {arm.name} has {arm.dof}; name another arm")
    if arm is None and not bundled_of(len(kinematics)):
        raise InputError(f"calibration: has {len(kinematics)} joints, as no bundled arm has; give `nominal`")
    known = recognise(kinematics, [f"joint{i + 1}" for i in range(len(kinematics))], "calibration", arm)
    return FactoryCalibration(kinematics, known, known.T_joint_flange, "array")
