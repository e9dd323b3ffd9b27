"""The fit of one arm, from its calibration or from a recording, through one residual."""

from pathlib import Path

import jax
import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import JOINTS, FactoryCalibration, recognise
from lite6jax.errors import InputError
from lite6jax.fitting.chunks import MAX_STEPS
from lite6jax.fitting.problem import (
    Geometry,
    calibration_poses,
    calibration_problem,
    sample_within_limits,
    whitener_of,
)
from lite6jax.fitting.recording_fit import Loss, fit_recording
from lite6jax.fitting.residual import POSE
from lite6jax.fitting.solution import Result, Solution, prediction_errors
from lite6jax.fitting.solve import Solver, solve
from lite6jax.fitting.source import load_nominal, read_source
from lite6jax.recordings import Recording

SAMPLES = 300
CHECK_SAMPLES = 1000


def fit(
    source: str | Path | FactoryCalibration | Recording | ArrayLike,
    nominal: Arm | str | None = None,
    *,
    geometry: Geometry = "declared",
    loss: Loss = "student_t",
    solver: Solver = "gauss_newton",
    samples: int = SAMPLES,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
) -> Solution:
    """Fits one arm.

    Args:
        source: a calibration (file, `FactoryCalibration` or `(joint, 6)` numbers in m and rad), or a recording (file or
            `Recording`).
        nominal: the arm's type, an `Arm` or a bundled name; recognised, or taken from the sidecar, where not given.
        geometry: of a recording; `declared` does what its sidecar says.
        loss: of a recording; Student's t loses 3 % of precision on clean data and is blind to wild samples.
        solver: `gauss_newton` is the fast one, `levenberg_marquardt` optimistix'. They agree to 1e-12 by least squares;
            with Student's t to 1e-5 standard deviations, as the second stops where rounding hides the cost's fall.
        samples: of a calibration's chain, inside the arm's limits.
        seed: of those.
        max_steps: most steps of one solve.

    Raises:
        InputError: the source cannot be used; see `read_factory`, `read_recording` and `recording_problem`.
    """
    arm = load_nominal(nominal)
    if isinstance(source, str | Path):
        source = read_source(source, arm)
    if isinstance(source, Recording):
        return fit_recording(source, arm, geometry=geometry, loss=loss, solver=solver, max_steps=max_steps)
    if not isinstance(source, FactoryCalibration):
        kinematics = np.asarray(source, float)
        if kinematics.ndim != 2 or kinematics.shape[1] != 6 or not np.isfinite(kinematics).all():
            raise InputError(f"calibration of shape {kinematics.shape}: give (joint, 6) finite numbers, m and rad")
        if arm is not None and arm.dof != len(kinematics):
            raise InputError(
                f"calibration: has {len(kinematics)} joints, but {arm.name} has {arm.dof}; name another arm"
            )
        if arm is None and len(kinematics) not in JOINTS:
            raise InputError(f"calibration: has {len(kinematics)} joints, as no bundled arm has; give `nominal`")
        known = recognise(kinematics, [f"joint{i + 1}" for i in range(len(kinematics))], "calibration", arm)
        source = FactoryCalibration(kinematics, known, known.T_joint_flange, "array")
    return fit_calibration(source, solver=solver, samples=samples, seed=seed, max_steps=max_steps)


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
    # fitted and fresh samples in one array, so that the chains are compiled once
    q = np.concatenate([sample_within_limits(arm, samples, seed), sample_within_limits(arm, CHECK_SAMPLES, seed + 1)])
    pose = calibration_poses(calibration, q)
    problem = calibration_problem(calibration, q[:samples], pose[:samples])
    whitener = whitener_of(problem.covariance())
    solved = solve(problem, problem.movable, whitener, np.ones((1, samples)), None, problem.start, solver, max_steps)
    model = jax.tree.map(lambda leaf: leaf[0], solved.model)
    everywhere = prediction_errors(problem.form, model, q, pose)
    return Solution(
        arm=arm,
        form=problem.form,
        model=model,
        result=Result(int(solved.status[0])),
        steps=int(solved.steps[0]),
        covariance=None,
        free=problem.movable,
        held=(),
        errors=everywhere.select(slice(0, samples)),
        nominal_errors=prediction_errors(problem.form, problem.start, q, pose).select(slice(samples, None)),
        checked=everywhere.select(slice(samples, None)),
        noise=None,
        weight=np.ones(samples),
    )
