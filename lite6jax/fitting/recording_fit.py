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
from lite6jax.fitting.many_samples import finished_on_all
from lite6jax.fitting.problem import UNDECLARED_NOISE, Geometry, Problem, recording_problem, whitener_of
from lite6jax.fitting.quality import NOISES, spread_of
from lite6jax.fitting.residual import POSITION
from lite6jax.fitting.solution import Errors, Held, Noise, Result, Solution, prediction_errors
from lite6jax.fitting.solve import RobustFits, Solver, solve, solve_robustly, unweighted
from lite6jax.model import ArmModel, ModelForm
from lite6jax.recordings import Recording

Array = NDArray[np.floating]
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
    covariance = problem.covariance()
    freedom = FREEDOM if loss == "student_t" else None
    few = np.unique(np.linspace(0, recording.samples - 1, min(MOST_SPREAD, recording.samples)).astype(int))
    information = _information(problem, covariance, freedom, few, recording.source)
    free, held = _free_of_frames(problem.form, problem.movable, information)
    free, held = _without_scale(problem, free, held)
    tolerance = problem.tolerance
    problem = replace(problem, precision=problem.precision + tolerance)
    share = _prior_share(tolerance, free, information + np.diag(tolerance))
    _require_samples(recording, problem.rows, round(float(free.sum() - share.sum())))
    everything = np.ones((1, recording.samples))
    training = np.ones((FOLDS, recording.samples))
    for k, fold in enumerate(recording.contiguous_folds(FOLDS)):
        training[k, fold] = 0.0

    first = _estimate(problem, free, covariance, everything, problem.start, "gauss_newton", freedom, max_steps, few)
    residual = _errors_of(problem, first, 0)
    # the first fit assumed the noise that is not declared; its residuals show it
    position, orientation = (
        estimated if declared is None else declared
        for declared, estimated in zip(problem.declared_noise, _noise_level(residual), strict=True)
    )
    assert position is not None
    problem = replace(problem, noise=(position, orientation))
    covariance = problem.covariance()
    covariance = covariance + np.diag(np.repeat(_excess(problem, covariance, residual), 3)[: problem.rows])
    estimate = partial(_estimate, problem, freedom=freedom, max_steps=max_steps)
    fits, start = None, first.model(0)
    if solver == "gauss_newton" and len(few) < recording.samples and freedom is not None:
        begun = estimate(free, covariance, everything, start, solver, few=few)
        fits = finished_on_all(problem, free, covariance, begun, len(few), freedom)
    fits = fits or estimate(free, covariance, everything, start, solver)
    folds = estimate(free, covariance, training, start, solver, few=few)
    frames_only = free & (np.arange(free.size) >= problem.form.chain.size)
    nominal_fit = estimate(frames_only, covariance, everything, problem.start, "gauss_newton", few=few)

    fitted = _errors_of(problem, fits, 0)
    return Solution(
        arm=problem.arm,
        form=problem.form,
        model=fits.model(0),
        result=Result(int(fits.estimates.status[0])),
        steps=int(first.estimates.steps[0] + fits.estimates.steps[0]),
        covariance=_covariance(problem, free, fits, freedom, float(free.sum() - share.sum())),
        free=free,
        held=held,
        tolerance=tolerance,
        errors=fitted,
        nominal_errors=_errors_of(problem, nominal_fit, 0),
        checked=_held_out_errors(problem, folds, training),
        noise=Noise(problem.declared_noise if any(problem.declared_noise) else None, *_noise_level(fitted)),
        weight=weights_left(fits.estimates.squares[0] / fits.scale[0] ** 2, freedom),
        notes=(*problem.notes, *_unconverged_folds(folds)),
        recording=recording,
    )


def _estimate(
    problem: Problem,
    free: NDArray[np.bool_],
    covariance: Array,
    training: Array,
    start: ArmModel,
    solver: Solver,
    freedom: float | None,
    max_steps: int,
    few: NDArray[np.integer] | None = None,
) -> RobustFits:
    """As `solve_robustly`, of all samples or of `few`."""
    if few is not None:
        problem, covariance, training = _spread(problem, covariance, training, few)
    return solve_robustly(problem, free, covariance, training, start, solver, freedom, max_steps)


def _spread(
    problem: Problem, covariance: Array, training: Array, few: NDArray[np.integer]
) -> tuple[Problem, Array, Array]:
    """The problem with those samples, their covariance and their training weights."""
    if len(few) == len(problem.pose):
        return problem, covariance, training
    return problem.select(few), covariance if covariance.ndim == 2 else covariance[few], training[:, few]


def _information(
    problem: Problem, covariance: Array, freedom: float | None, few: NDArray[np.integer], source: str
) -> Array:
    """Of the data and the declared prior on the movable entries of a step `(size, size)`, at the start."""
    movable = problem.movable
    problem, covariance, everything = _spread(problem, covariance, np.ones((1, len(problem.pose))), few)
    whitener = whitener_of(covariance)
    loss = unweighted(freedom, 1)
    curvature = solve(problem, movable, whitener, everything, loss, problem.start, "gauss_newton", 0).curvature[0]
    if not np.isfinite(curvature).all():
        raise InputError(f"{source}: holds numbers too large to work with; check the units of its columns")
    return np.where(np.outer(movable, movable), curvature, 0.0)


def _free_of_frames(
    form: ModelForm, movable: NDArray[np.bool_], information: Array
) -> tuple[NDArray[np.bool_], tuple[Held, ...]]:
    """The entries of a step that can be estimated beside the sensor's frame and the tool, and those held at nominal.

    Nothing is known of an unknown frame or tool beforehand. So a number of the geometry that does what they do is held,
    or they would take over its uncertainty; and of a frame or a tool, what the data do not show.
    """
    size, geometry = form.size, form.chain.size
    scale = np.sqrt(np.maximum(np.diagonal(information), np.finfo(float).tiny))
    H = information / scale[:, None] / scale
    units = np.array(form.units)
    largest = np.array([np.max(np.diagonal(information)[units == unit], initial=0.0) for unit in units])
    observed = np.diagonal(information) > _OBSERVED * largest
    free, held, taken = movable.copy(), list[Held](), list[int]()
    for k in (k for k in (*range(geometry, size), *range(geometry)) if movable[k]):
        share = np.linalg.solve(H[np.ix_(taken, taken)], H[taken, k]) if observed[k] else np.zeros(len(taken))
        independent = observed[k] and H[k, k] - share @ H[taken, k] > _INDEPENDENT
        if k >= geometry and independent:
            taken.append(k)
        elif k >= geometry or (observed[k] and not independent):
            free[k] = False
            strong = np.abs(share) > _CONFOUNDED * max(float(np.abs(share).max(initial=0.0)), 1e-6)
            held.append(Held(form.names[k], tuple(form.names[taken[i]] for i in np.flatnonzero(strong))))
    return free, tuple(sorted(held, key=lambda h: form.names.index(h.name)))


def _without_scale(
    problem: Problem, free: NDArray[np.bool_], held: tuple[Held, ...]
) -> tuple[NDArray[np.bool_], tuple[Held, ...]]:
    """The same with the longest length held, where the data set no scale, and noise alone would shrink the chain.

    That is so where the measured positions are one point of an unknown frame and no length is known: any chain that
    keeps the point in place does so at any size (J. Hollerbach and C. Wampler, Int. J. Robotics Research 15, 1996).
    """
    form, position = problem.form, problem.pose if problem.pose.ndim == 2 else problem.pose[:, :3, 3]
    chain = form.chain
    lengths = np.where(free[: chain.size] & (np.array(chain.units) == "m"), np.abs(problem.start.geometry), 0.0)
    one_point = spread_of(position) <= NOISES * (problem.declared_noise[0] or UNDECLARED_NOISE[0])
    known_tool = not form.tool and np.any(problem.start.T_flange_tool[:3, 3] != problem.arm.T_joint_flange[:3, 3])
    if not (one_point and form.frame) or known_tool or chain.sliding or not lengths.any():
        return free, held
    longest, others = int(np.argmax(lengths)), np.flatnonzero(lengths > _CONFOUNDED * lengths.max())
    scaled = tuple(form.names[k] for k in others if k != longest)
    return free & (np.arange(free.size) != longest), (*held, Held(form.names[longest], scaled))


def _prior_share(tolerance: Array, free: NDArray[np.bool_], information: Array) -> Array:
    """`(size,)`, the variance of each free entry with the prior's precision in the information, over the prior's."""
    share = np.zeros(free.size)
    inside = np.ix_(free, free)
    share[free] = np.diagonal(_inverse(information[inside])) * tolerance[free]
    return share


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
    samples = len(problem.pose)
    position, orientation = np.empty(samples), None if problem.pose.ndim == 2 else np.empty(samples)
    for k, row in enumerate(training):
        held_out = np.flatnonzero(row == 0)
        part = problem.select(held_out)
        errors = prediction_errors(part.form, fits.model(k), part.joint_position, part.pose, of=samples)
        position[held_out] = errors.position
        if orientation is not None:
            orientation[held_out] = errors.orientation
    return Errors(position, orientation, problem.joint_position)


def _unconverged_folds(fits: RobustFits) -> list[str]:
    count = int((fits.estimates.status != Result.CONVERGED).sum())
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


def _covariance(problem: Problem, free: NDArray, fits: RobustFits, freedom: float | None, fitted: float) -> Array:
    """The covariance of the entries of a step; the prior's precision is added to the data's information."""
    rows, scale = problem.rows, fits.scale[0]
    prior = np.diag(problem.precision * free)
    information = (np.asarray(fits.estimates.curvature[0]) - prior) * np.outer(free, free)
    numbers = fits.estimates.squares.shape[1] * rows
    if freedom is None:
        factor = scale**2 * numbers / max(numbers - fitted, 1)
    else:
        factor = variance_factor(fits.estimates.squares[0] / scale**2, rows, freedom, fitted)
    covariance = np.zeros_like(prior)
    if free.any():
        covariance[np.ix_(free, free)] = _inverse((information / factor + prior)[np.ix_(free, free)])
    return covariance


def _inverse(H: Array) -> Array:
    """The inverse, taken after scaling to unit diagonal; a pseudo-inverse would leave out what only the prior knows."""
    root = np.sqrt(np.diagonal(H))
    scale = np.outer(root, root)
    return np.linalg.inv(H / scale) / scale
