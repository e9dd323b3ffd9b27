"""The fit of a recording: which parameters it identifies, the noise level, held-out errors, the covariance."""

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.errors import InputError
from lite6jax.estimation.robust import FREEDOM, gaussian_t_scale, t_scale, variance_factor, weights_left
from lite6jax.fitting.chunks import MAX_STEPS
from lite6jax.fitting.gauge import determined
from lite6jax.fitting.problem import Geometry, Problem, recording_problem, whitener_of
from lite6jax.fitting.residual import POSITION
from lite6jax.fitting.solution import Errors, Held, Noise, Result, Solution, prediction_errors
from lite6jax.fitting.solve import RobustFits, Solver, solve, solve_robustly
from lite6jax.recordings import Recording

Array = NDArray[np.floating]
Loss = Literal["student_t", "least_squares"]

ROUNDING = 1e-15
"""Rounding error of a residual, in m and rad: the smallest noise that can be estimated."""
FOLDS = 5
_EXCESS = 2.0
"""Ratio of the residual variance to the declared one above which the difference is attributed to the model."""


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
    the declared noise, their excess variance is added to it, isotropic, before the final fit.
    """
    problem = recording_problem(recording, nominal, geometry)
    covariance = problem.covariance()
    freedom = FREEDOM if loss == "student_t" else None
    free, held = _identifiable(problem, covariance, recording.source)
    _require_samples(recording, problem.rows, int(free.sum()))
    training = np.ones((FOLDS + 1, recording.samples))  # all samples, then all but one fold each
    for k, fold in enumerate(recording.contiguous_folds(FOLDS)):
        training[k + 1, fold] = 0.0

    estimate = partial(solve_robustly, problem, freedom=freedom, max_steps=max_steps)
    first = estimate(free, covariance, training[:1], problem.start, "gauss_newton")
    residual = _errors_of(problem, first, 0)
    if not problem.declared:  # the first fit assumed a ratio of the noises; its residuals show both
        problem = replace(problem, noise=_noise_level(residual))
        covariance = problem.covariance()
        estimate = partial(solve_robustly, problem, freedom=freedom, max_steps=max_steps)
    covariance = covariance + np.diag(np.repeat(_excess(problem, covariance, residual), 3)[: problem.rows])
    fits = estimate(free, covariance, training, first.model(0), solver)
    frames_only = free & (np.arange(free.size) >= problem.form.chain.size)
    nominal_fit = estimate(frames_only, covariance, training[:1], problem.start, "gauss_newton")

    fitted = _errors_of(problem, fits, 0)
    return Solution(
        arm=problem.arm,
        form=problem.form,
        model=fits.model(0),
        result=Result(int(fits.estimates.status[0])),
        steps=int(first.estimates.steps[0] + fits.estimates.steps[0]),
        covariance=_covariance(problem, free, fits, training[0] > 0, freedom),
        free=free,
        held=held,
        errors=fitted,
        nominal_errors=_errors_of(problem, nominal_fit, 0),
        checked=_held_out_errors(problem, fits, training[1:]),
        noise=Noise(problem.noise if problem.declared else None, *_noise_level(fitted)),
        weight=weights_left(fits.estimates.squares[0] / fits.scale[0] ** 2, freedom),
        notes=(*problem.notes, *_unconverged_folds(fits)),
        recording=recording,
    )


def _identifiable(problem: Problem, covariance: Array, source: str) -> tuple[NDArray[np.bool_], tuple[Held, ...]]:
    """Which of the movable parameters the data and the prior identify at the start, and those held at nominal."""
    movable = problem.movable
    everything = np.ones((1, len(problem.pose)))
    whitener = whitener_of(covariance)
    curvature = solve(problem, movable, whitener, everything, None, problem.start, "gauss_newton", 0).curvature[0]
    if not np.isfinite(curvature).all():
        raise InputError(f"{source}: holds numbers too large to work with; check the units of its columns")
    if not movable.any():
        return movable, ()
    free, held = determined(problem.form, np.where(np.outer(movable, movable), curvature, 0.0))
    return free & movable, tuple(h for h in held if movable[problem.form.names.index(h.name)])


def _require_samples(recording: Recording, rows: int, parameters: int) -> None:
    samples = recording.samples
    if parameters and samples * rows * (FOLDS - 1) <= FOLDS * parameters:
        raise InputError(
            f"{recording.source}: {samples} samples give {samples * rows} numbers, too few to fit {parameters} "
            f"parameters and hold a fifth back; record at least {parameters * FOLDS // (rows * (FOLDS - 1)) + 1} "
            f"samples"
        )


def _errors_of(problem: Problem, fits: RobustFits, k: int) -> Errors:
    return prediction_errors(problem.form, fits.model(k), problem.joint_position, problem.pose)


def _held_out_errors(problem: Problem, fits: RobustFits, training: Array) -> Errors:
    """Each sample's error under the fit that did not use it; `training` `(fold, sample)` is zero where held out."""
    folds = [_errors_of(problem, fits, k + 1) for k in range(len(training))]
    held_out = (np.argmin(training, 0), np.arange(training.shape[1]))
    orientation = [fold.orientation for fold in folds if fold.orientation is not None]
    return Errors(
        np.stack([fold.position for fold in folds])[held_out],
        np.stack(orientation)[held_out] if orientation else None,
        problem.joint_position,
    )


def _unconverged_folds(fits: RobustFits) -> list[str]:
    count = int((fits.estimates.status[1:] != Result.CONVERGED).sum())
    if not count:
        return []
    return [
        f"{count} of the {FOLDS} held-out fits did not converge: without their block the other rows do not identify "
        f"every parameter, and the held-out errors are unreliable; mix the poses when recording"
    ]


def _noise_level(fitted: Errors) -> tuple[float, float | None]:
    """Robust standard deviations per axis of position (m) and orientation (rad) errors; not below rounding."""
    unit = gaussian_t_scale(POSITION, FREEDOM)
    position = max(t_scale(fitted.position**2, POSITION, FREEDOM) / unit, ROUNDING)
    if fitted.orientation is None:
        return position, None
    return position, max(t_scale(fitted.orientation**2, POSITION, FREEDOM) / unit, ROUNDING)


def _excess(problem: Problem, covariance: Array, residual: Errors) -> Array:
    """Variance per axis of position and orientation by which residuals clearly exceed the noise; else zero."""
    variances = np.diagonal(covariance, axis1=-2, axis2=-1).reshape(-1, problem.rows)
    expected = variances.reshape(len(variances), -1, 3).mean((0, 2))
    observed = np.square([level for level in _noise_level(residual) if level is not None])
    return np.where(observed > _EXCESS * expected, observed - expected, 0.0)


def _covariance(problem: Problem, free: NDArray, fits: RobustFits, training: NDArray, freedom: float | None) -> Array:
    """The covariance of the entries of a step; the prior's precision is added to the data's information."""
    rows, scale = problem.rows, fits.scale[0]
    prior = np.diag(problem.precision * free)
    information = (np.asarray(fits.estimates.curvature[0]) - prior) * np.outer(free, free)
    numbers, fitted = int(training.sum()) * rows, int(free.sum())
    if freedom is None:
        factor = scale**2 * numbers / max(numbers - fitted, 1)
    else:
        factor = variance_factor(fits.estimates.squares[0][training] / scale**2, rows, freedom, fitted)
    covariance = np.zeros_like(prior)
    if free.any():
        covariance[np.ix_(free, free)] = np.linalg.inv((information / factor + prior)[np.ix_(free, free)])
    return covariance
