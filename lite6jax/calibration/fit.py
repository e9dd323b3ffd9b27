"""The fit of one arm's geometry, to its factory calibration or to a recording of measured poses.

Of a recording: which parameters it identifies, the noise level, held-out errors, and the covariance.
"""

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lite6jax import threads
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_of
from lite6jax.arms.factory import FactoryCalibration, recognise
from lite6jax.array_types import Array, Mask
from lite6jax.calibration.problem import (
    TOLERANCE,
    UNDECLARED_NOISE,
    CalibrationProblem,
    Geometry,
    recording_problem,
)
from lite6jax.calibration.quality import NOISES, Result, spread_of
from lite6jax.calibration.residual import POSE, POSITION
from lite6jax.calibration.solution import Errors, FixedParameter, Noise, Solution, prediction_errors
from lite6jax.calibration.solve import MAX_STEPS, ArmEstimate, Solver, invert, solve
from lite6jax.calibration.start import SAMPLES, calibration_poses, check_positions, sample_within_limits
from lite6jax.errors import InputError
from lite6jax.estimation.robust import FREEDOM, gaussian_t_scale, t_scale, variance_factor, weights_left
from lite6jax.model import LEVER, ArmModel, ModelForm
from lite6jax.recordings import Recording
from lite6jax.recordings.sequence import spread_rows

Loss = Literal["student_t", "least_squares"]

ROUNDING = 1e-15
"""Rounding error of a residual, in m and rad: the smallest noise that can be estimated."""
FOLDS = 5
MOST_SPREAD = 50_000
"""Samples, spread evenly, to which all fits are made but that of the result: 34 numbers estimated from so many of six
numbers add less than 0.02 % to a held-out error, and the others are a start or have fewer numbers."""
_INDEPENDENT = 1e-10
"""Squared sine of a column to the span of others, above which it is independent of them; rounding leaves 1e-15."""
_OBSERVED = 1e-20
"""A column's square over the largest of its unit below which the parameter is not observable."""
_CONFOUNDED = 0.05
_EXCESS = 2.0
"""Ratio of the residual variance to the declared one above which the difference is attributed to the model."""


# ------------------------------------------------------------------ a calibration


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
    form = ModelForm(arm.form)
    start = ArmModel(arm.hayati, np.eye(4), arm.T_joint_flange)  # type: ignore[arg-type]
    nothing = np.zeros(form.size)
    all_free = np.ones(form.size, bool)
    problem = CalibrationProblem(arm, form, start, q[:samples], pose[:samples], (1.0, 1 / LEVER), nothing, all_free)
    estimate = solve(problem, solver=solver, max_steps=max_steps)
    errors = prediction_errors(form, estimate.model, q, pose)
    return Solution(
        arm=arm,
        form=form,
        model=estimate.model,
        result=estimate.result,
        steps=estimate.steps,
        covariance=None,
        free=all_free,
        held=(),
        errors=errors.select(slice(0, samples)),
        nominal_errors=prediction_errors(form, start, q, pose).select(slice(samples, None)),
        checked=errors.select(slice(samples, None)),
        noise=None,
        weight=np.ones(samples),
        tolerance=nothing,
    )


def calibration_from_array(kinematics: ArrayLike, arm: Arm | None = None) -> FactoryCalibration:
    """A calibration from `(joint, 6)` numbers: x y z (m) roll pitch yaw (rad) of each joint.

    Raises:
        InputError: a wrong shape, numbers that are not finite, joints that the arm does not have.
    """
    kinematics = np.asarray(kinematics, float)
    if kinematics.ndim != 2 or kinematics.shape[1] != 6 or not np.isfinite(kinematics).all():
        raise InputError(f"calibration of shape {kinematics.shape}: give (joint, 6) finite numbers, m and rad")
    joints = len(kinematics)
    if arm is not None and arm.dof != joints:
        raise InputError(f"calibration: has {joints} joints, but {arm.name} has {arm.dof}; name another arm")
    if arm is None and not bundled_of(joints):
        raise InputError(f"calibration: has {joints} joints, as no bundled arm has; give `nominal`")
    recognised = recognise(kinematics, [f"joint{i + 1}" for i in range(joints)], "calibration", arm)
    return FactoryCalibration(kinematics, recognised, recognised.T_joint_flange, "array")


# ------------------------------------------------------------------ a recording


def fit_recording(
    recording: Recording,
    nominal: Arm | None = None,
    *,
    geometry: Geometry = "declared",
    loss: Loss = "student_t",
    solver: Solver = "gauss_newton",
    max_steps: int = MAX_STEPS,
) -> Solution:
    """The fit of a recording; `checked` on contiguous fifths, each predicted by a fit of the other four. See `fit`.

    Model error may be far larger than the noise, and correlated otherwise: where the residuals of a first fit exceed
    the declared noise, their excess variance is added to it, isotropic, before the final fit. Unknown geometry has a
    prior about nominal, `TOLERANCE`: what the data do not determine stays there.
    """
    problem = recording_problem(recording, nominal, geometry)
    form = problem.form
    chain = problem.form.chain
    subset = spread_rows(recording.samples, MOST_SPREAD)
    spread = subset if len(subset) < recording.samples else slice(None)
    information = _information(problem.select(subset), recording.source)
    free, held_parameters = _without_scale(problem, *_free_of_frames(problem, information))
    tolerance = np.zeros(form.size)
    tolerance[: chain.size] = [TOLERANCE[unit] ** -2.0 for unit in chain.units]
    tolerance[~problem.movable | (problem.precision != 0)] = 0.0
    problem = replace(problem, precision=problem.precision + tolerance)
    # the parameters that the data determine: each less the share of the prior's variance that is left to it
    from_prior = np.diagonal(invert((information + np.diag(tolerance))[np.ix_(free, free)])) * tolerance[free]
    fitted = float(free.sum() - from_prior.sum())
    samples = recording.samples
    rows = problem.rows
    parameters = round(fitted)
    if parameters and samples * rows * (FOLDS - 1) <= FOLDS * parameters:
        raise InputError(
            f"{recording.source}: {samples} samples give {samples * rows} numbers, too few to fit {parameters} "
            f"parameters and hold a fifth back; record at least {parameters * FOLDS // (rows * (FOLDS - 1)) + 1} "
            f"samples"
        )

    freedom = FREEDOM if loss == "student_t" else None
    estimate = partial(solve, freedom=freedom, max_steps=max_steps)
    first = estimate(problem.select(subset), free)
    residual = prediction_errors(form, first.model, problem.joint_position, problem.pose)
    problem = _with_noise(problem, residual)
    reduced = problem.select(subset)
    weight = np.ones((FOLDS, recording.samples))
    for k, fold in enumerate(recording.contiguous_folds(FOLDS)):
        weight[k, fold] = 0.0
    start = {"start": first.model, "solver": solver}
    if len(subset) < recording.samples:
        start["start"] = estimate(reduced, free, **start).model
    final = estimate(problem, free, **start)
    folds = threads.by_parts(lambda row: estimate(reduced, free, weight=row[spread], **start), list(weight))
    frames_only = free & (np.arange(form.size) >= chain.size)
    nominal_fit = estimate(reduced, frames_only)
    notes = problem.notes
    if count := sum(fold.result != Result.CONVERGED for fold in folds):
        notes += (
            f"{count} of the {FOLDS} held-out fits did not converge: without their block the other rows do not "
            "identify every parameter, and the held-out errors are unreliable; mix the poses when recording",
        )

    errors = prediction_errors(form, final.model, problem.joint_position, problem.pose)
    return Solution(
        arm=problem.arm,
        form=form,
        model=final.model,
        result=final.result,
        steps=first.steps + final.steps,
        covariance=_covariance(problem, free, final, freedom, fitted),
        free=free,
        held=held_parameters,
        tolerance=tolerance,
        errors=errors,
        nominal_errors=prediction_errors(form, nominal_fit.model, problem.joint_position, problem.pose),
        checked=_held_out_errors(problem, folds, weight),
        noise=Noise(problem.declared_noise if any(problem.declared_noise) else None, *_noise_level(errors)),
        weight=weights_left(final.squares / final.scale**2, freedom),
        notes=notes,
        recording=recording,
    )


def _information(problem: CalibrationProblem, source: str) -> Array:
    """Information of the data and the declared prior on the movable entries of a step `(size, size)`, at the start."""
    information = solve(problem, max_steps=0).information
    if not np.isfinite(information).all():
        raise InputError(f"{source}: holds numbers too large to work with; check the units of its columns")
    return np.where(np.outer(problem.movable, problem.movable), information, 0.0)


def _free_of_frames(problem: CalibrationProblem, information: Array) -> tuple[Mask, tuple[FixedParameter, ...]]:
    """The entries of a step that can be estimated beside the sensor's frame and the tool, and those held at nominal.

    Nothing is known of an unknown frame or tool beforehand. So a number of the geometry that does what they do is held,
    or they would take over its uncertainty; and of a frame or a tool, what the data do not show.
    """
    form = problem.form
    movable = problem.movable
    size = form.size
    geometry = form.chain.size
    scale = np.sqrt(np.maximum(np.diagonal(information), np.finfo(float).tiny))
    H = information / scale[:, None] / scale
    units = np.array(form.units)
    largest = np.array([np.max(np.diagonal(information)[units == unit], initial=0.0) for unit in units])
    observed = np.diagonal(information) > _OBSERVED * largest
    free = movable.copy()
    held_parameters = list[FixedParameter]()
    frame_columns = list[int]()
    for k in (k for k in (*range(geometry, size), *range(geometry)) if movable[k]):
        share = np.zeros(len(frame_columns))
        if observed[k]:
            share = np.linalg.solve(H[np.ix_(frame_columns, frame_columns)], H[frame_columns, k])
        independent = observed[k] and H[k, k] - share @ H[frame_columns, k] > _INDEPENDENT
        if k >= geometry and independent:
            frame_columns.append(k)
        elif k >= geometry or (observed[k] and not independent):
            free[k] = False
            strong = np.abs(share) > _CONFOUNDED * max(float(np.abs(share).max(initial=0.0)), 1e-6)
            held_parameters.append(
                FixedParameter(form.names[k], tuple(form.names[frame_columns[i]] for i in np.flatnonzero(strong)))
            )
    return free, tuple(sorted(held_parameters, key=lambda h: form.names.index(h.name)))


def _without_scale(
    problem: CalibrationProblem, free: Mask, held_parameters: tuple[FixedParameter, ...]
) -> tuple[Mask, tuple[FixedParameter, ...]]:
    """The same with the longest length held, where the data set no scale, and noise alone would shrink the chain.

    That is so where the measured positions are one point of an unknown frame and no length is known: any chain that
    keeps the point in place does so at any size (J. Hollerbach and C. Wampler, Int. J. Robotics Research 15, 1996).
    """
    form = problem.form
    position = problem.pose if problem.pose.ndim == 2 else problem.pose[:, :3, 3]
    chain = form.chain
    lengths = np.where(free[: chain.size] & (np.array(chain.units) == "m"), np.abs(problem.start.geometry), 0.0)
    one_point = spread_of(position) <= NOISES * (problem.declared_noise[0] or UNDECLARED_NOISE[0])
    known_tool = not form.tool and np.any(problem.start.T_flange_tool[:3, 3] != problem.arm.T_joint_flange[:3, 3])
    if not (one_point and form.frame) or known_tool or chain.sliding or not lengths.any():
        return free, held_parameters
    longest = int(np.argmax(lengths))
    comparable = np.flatnonzero(lengths > _CONFOUNDED * lengths.max())
    scaled = tuple(form.names[k] for k in comparable if k != longest)
    return free & (np.arange(free.size) != longest), (*held_parameters, FixedParameter(form.names[longest], scaled))


def _with_noise(problem: CalibrationProblem, residual: Errors) -> CalibrationProblem:
    """With the noise that the residuals of a first fit show.

    Noise that is not declared is what they have; variance by which they clearly exceed the declared noise is added to
    it.
    """
    shown = _noise_level(residual)
    position, orientation = (
        level if declared is None else declared for declared, level in zip(problem.declared_noise, shown, strict=True)
    )
    assert position is not None
    problem = replace(problem, noise=(position, orientation))
    variances = np.diagonal(problem.covariance, axis1=-2, axis2=-1).reshape(-1, problem.rows)
    expected = variances.reshape(len(variances), -1, 3).mean((0, 2))
    observed = np.square([level for level in shown if level is not None])
    excess = np.where(observed > _EXCESS * expected, observed - expected, 0.0)
    noise = [
        float(np.hypot(level, np.sqrt(more)))
        for level, more in zip((position, orientation or 0.0), excess, strict=False)
    ]
    return replace(problem, noise=(noise[0], noise[1] if problem.rows == POSE else None))


def _noise_level(errors: Errors) -> tuple[float, float | None]:
    """Robust standard deviations per axis of position (m) and orientation (rad) errors; not below rounding."""
    unit = gaussian_t_scale(POSITION, FREEDOM)
    position = max(t_scale(errors.position**2, POSITION, FREEDOM) / unit, ROUNDING)
    if errors.orientation is None:
        return position, None
    return position, max(t_scale(errors.orientation**2, POSITION, FREEDOM) / unit, ROUNDING)


def _held_out_errors(problem: CalibrationProblem, folds: list[ArmEstimate], weight: Array) -> Errors:
    """Each sample's error under the fit that did not use it; `weight` `(fold, sample)` is zero where held out."""
    samples = len(problem.pose)
    position = np.empty(samples)
    orientation = None if problem.pose.ndim == 2 else np.empty(samples)
    for fold, row in zip(folds, weight, strict=True):
        part = problem.select(row == 0)
        errors = prediction_errors(part.form, fold.model, part.joint_position, part.pose, of=samples)
        position[row == 0] = errors.position
        if orientation is not None:
            orientation[row == 0] = errors.orientation
    return Errors(position, orientation, problem.joint_position)


def _covariance(
    problem: CalibrationProblem, free: Mask, estimate: ArmEstimate, freedom: float | None, fitted: float
) -> Array:
    """The covariance of the entries of a step; the prior's precision is added to the data's information."""
    inside = np.ix_(free, free)
    prior = np.diag(problem.precision[free])
    numbers = len(problem.pose) * problem.rows
    if freedom is None:
        factor = estimate.scale**2 * numbers / max(numbers - fitted, 1)
    else:
        factor = variance_factor(estimate.squares / estimate.scale**2, problem.rows, freedom, fitted)
    covariance = np.zeros_like(estimate.information)
    covariance[inside] = invert((estimate.information[inside] - prior) / factor + prior)
    return covariance
