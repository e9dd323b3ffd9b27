"""One arm's fit under Student's t: damped Gauss–Newton on the host, and the solver of record, optimistix'
Levenberg–Marquardt.

Samples are looked at slice by slice and on every core. Slices of long recordings are of one size, so that one function
is compiled, and are added in order, so that sums do not depend on the threads. The scale of the noise follows the
residuals of every step.
"""

from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import export, lax
from numpy.typing import NDArray

from lite6jax import threads
from lite6jax.estimation.robust import curvature_share, t_scale
from lite6jax.fitting.compiled import SINGLE_THREADED, Exported
from lite6jax.fitting.gauss_newton import DECREMENT, FLAT, MAX_STEPS, ROUNDING, SINGULAR_ABOVE
from lite6jax.fitting.problem import Problem
from lite6jax.fitting.quality import Result
from lite6jax.fitting.residual import (
    BLOCK,
    Observations,
    Robust,
    differences,
    evaluate,
    linearise,
    observe,
    pad,
    padded_size,
    predict_frames,
    residuals,
    whiten,
)
from lite6jax.model import ArmModel, ModelForm

Array = NDArray[np.floating]
Solver = Literal["gauss_newton", "levenberg_marquardt"]

SLICE = 10 * BLOCK
"""Samples of a slice: 3 MB of poses."""
_GAUSSIAN = 1e15
"""Degrees of freedom at which Student's t is least squares to rounding: another loss would be compiled for seconds."""
_SCALE_TOLERANCE = 1e-6
"""Relative change of the noise scale below which it has converged."""
_FEW = 1500
"""Samples up to which the compiler's optimisation takes longer than it saves, were it a hundred looks."""
_MAX_SCALES = 30
"""Most solves of record, each at another scale."""
_LEAST_CURVED = 0.5
"""Of the curvature of the loss over that of its weighted squares; of few outliers it is 0.9."""
_RECORD = 1e-12, 1e-13
"""Relative and absolute tolerance of the solver of record."""


class Estimate(NamedTuple):
    """The solution of one problem.

    Attributes:
        model: NumPy leaves.
        information: `(size, size)` of data and prior; identity where held.
        squares: `(sample,)`, squared whitened residuals; zero for a sample of weight zero.
        scale: of the noise, in units of the covariance that residuals are whitened with.
        result: how it ended.
        steps: that were taken.
    """

    model: ArmModel
    information: Array
    squares: Array
    scale: float
    result: Result
    steps: int


class _Look(NamedTuple):
    """A model, and the gradient, the data's curvature (if wanted) and the squared whitened residuals there."""

    model: ArmModel
    gradient: Array
    curvature: Array | None
    squares: Array


def solve(
    problem: Problem,
    free: NDArray[np.bool_] | None = None,
    *,
    start: ArmModel | None = None,
    weight: Array | None = None,
    freedom: float | None = None,
    solver: Solver = "gauss_newton",
    max_steps: int = MAX_STEPS,
    begun: tuple[Estimate, float] | None = None,
) -> Estimate:
    """The parameters that a problem's samples and its prior make likeliest, and the scale of the noise.

    Args:
        problem: data, prior and form.
        free: `(size,)` bool, the parameters to estimate; those that are movable where not given.
        start: where from; that of the problem where not given.
        weight: `(sample,)`; zero holds a sample out, of the scale as well.
        freedom: degrees of freedom of Student's t; None is least squares.
        solver: which; see `fit`.
        max_steps: most steps; zero only evaluates residuals and information at the start.
        begun: an estimate from some of the samples, and how many times as many there are: its curvature serves for the
            steps until it leads no further.
    """
    free = problem.movable if free is None else free
    weight = np.ones(len(problem.pose)) if weight is None else weight
    start = jax.tree.map(np.asarray, problem.start if start is None else start)
    look = _looking(problem, weight, freedom)
    used = weight > 0

    def scale_of(squares: Array) -> float:
        return t_scale(squares[used], problem.rows, freedom)

    if solver == "levenberg_marquardt" and max_steps:
        model, scale, result, steps = _of_record(problem, free, start, weight, freedom, max_steps, look, scale_of)
        step = np.zeros(problem.form.size)
    else:
        model, step, scale, result, steps = _gauss_newton(
            problem, free, start, weight, freedom, max_steps, look, scale_of, begun
        )
    end = look(model, step, scale, True)
    assert end.curvature is not None
    prior = np.diag(problem.precision)
    information = np.where(np.outer(free, free), end.curvature + prior, np.diag(1.0 - free))
    if result != Result.NOT_FINITE:
        # how much its correlation with the others inflates a parameter's variance
        inflation = (np.diagonal(inverse(information)) * np.diagonal(information))[free]
        if not ((inflation > 0.5) & (inflation < SINGULAR_ABOVE)).all():
            result = Result.SINGULAR
    return Estimate(end.model, information, end.squares, scale_of(end.squares), result, steps)


def inverse(H: Array) -> Array:
    """The inverse of a symmetric matrix, taken after scaling to unit diagonal; NaN where there is none."""
    with np.errstate(all="ignore"):
        root = np.sqrt(np.diagonal(H))
        scale = np.outer(root, root)
        try:
            return np.linalg.inv(H / scale) / scale
        except np.linalg.LinAlgError:
            return np.full_like(H, np.nan)


def _looking(problem: Problem, weight: Array, freedom: float | None) -> Callable[..., _Look]:
    """What looks at the samples of a problem: `look(model, step, scale, curved)`, at the model a step away."""
    count, whitener, center = len(problem.pose), problem.whitener, np.asarray(problem.start.geometry)
    totals_of = _totals_of_few if count <= _FEW else _totals
    size = SLICE if count > SLICE else padded_size(count)[0]
    slices = [
        tuple(
            leaf if leaf is whitener and leaf.ndim == 1 else pad(leaf[first : first + size], 0, size)
            for leaf in (problem.joint_position, problem.pose, weight, whitener)
        )
        for first in range(0, count, size)
    ]

    def look(model: ArmModel, step: Array, scale: float, curved: bool) -> _Look:
        robust = Robust(np.asarray(freedom or _GAUSSIAN), np.asarray(scale))  # type: ignore[arg-type]

        def part(data: tuple[Array, ...]) -> tuple[ArmModel, tuple[Array, ...], Array]:
            return jax.tree.map(np.asarray, totals_of(problem.form, curved, model, step, *data, robust))

        models, totals, squares = zip(*threads.by_parts(part, slices), strict=True)
        gradient, *curvature = (sum(each) for each in zip(*totals, strict=True))
        pull = problem.precision[: center.size] * (models[0].geometry - center)
        gradient = gradient + np.pad(pull, (0, problem.form.size - center.size))
        return _Look(models[0], gradient, curvature[0] if curved else None, np.concatenate(squares)[:count])

    return look


def _slice_totals(
    form: ModelForm,
    curved: bool,
    model: ArmModel,
    step: jax.Array,
    joint_position: jax.Array,
    pose: jax.Array,
    weight: jax.Array,
    whitener: jax.Array,
    robust: Robust,
) -> tuple[ArmModel, tuple[jax.Array, ...], jax.Array]:
    """The model a step away, its gradient and, if `curved`, curvature, and each sample's squared whitened residual."""
    model = form.retract(model, step)
    observed = observe(form, joint_position, pose, weight, whitener, min(len(weight), BLOCK))

    def one(total: tuple[jax.Array, ...], block: Observations) -> tuple[tuple[jax.Array, ...], jax.Array]:
        _, *found = linearise(form, model, block, robust) if curved else evaluate(form, model, block, robust)
        rows = whiten(block.whitener, differences(block, predict_frames(form, model, block.joint)[1]))
        squares = jnp.where(block.weight > 0, jnp.sum(rows**2, 0), 0.0)
        return tuple(before + more for before, more in zip(total, found, strict=True)), squares

    zeros = (jnp.zeros(form.size), jnp.zeros((form.size, form.size)))
    totals, squares = lax.scan(one, zeros if curved else zeros[:1], observed)
    return model, totals, squares.reshape(-1)


export.register_namedtuple_serialization(Robust, serialized_name="lite6jax.Robust")
_totals = Exported(_slice_totals, 2, SINGLE_THREADED)
_totals_of_few = Exported(_slice_totals, 2, SINGLE_THREADED | {"xla_backend_optimization_level": 0})


def _gauss_newton(
    problem: Problem,
    free: NDArray[np.bool_],
    start: ArmModel,
    weight: Array,
    freedom: float | None,
    max_steps: int,
    look: Callable[..., _Look],
    scale_of: Callable[[Array], float],
    begun: tuple[Estimate, float] | None,
) -> tuple[ArmModel, Array, float, Result, int]:
    """A model, the last step from there, the scale, how it ended, and the number of steps.

    Student's loss curves less than its weighted squares, by a share that the residuals show; a step divides by it.
    """
    rows, center, precision = problem.rows, np.asarray(problem.start.geometry), problem.precision
    inside, prior = np.ix_(free, free), np.diag(precision[free])
    floor = _rounding_floor(problem.whitener, weight)
    still = np.zeros(problem.form.size)

    def cost(at: _Look, scale: float) -> float:
        scaled = at.squares / scale**2
        if freedom is not None:
            scaled = (freedom + rows) * np.log1p(scaled / freedom)
        away = np.asarray(at.model.geometry) - center
        return 0.5 * float(weight @ scaled + precision[: center.size] @ away**2)

    kept = None
    if begun is not None:
        estimate, times = begun
        kept, scale = times * (estimate.information - np.diag(precision))[inside], estimate.scale
    else:
        scale = 1.0 if freedom is None else scale_of(look(start, still, 1.0, False).squares)
    at, model, step, steps, damping, decrement = None, start, still, 0, 0.0, 0.0
    while True:
        seen = look(model, step, scale, kept is None)
        value, now = cost(seen, scale), np.inf if at is None else cost(at, scale)
        if at is None and not np.isfinite(value):
            return start, still, scale, Result.NOT_FINITE, steps
        # so near the solution that rounding decides which cost is lower, the step is taken on the gradient's word
        better = np.isfinite(value) and (value <= now or abs(decrement) <= FLAT * now + floor)
        damping = (damping / 10 if damping >= 1e-9 else 0.0) if better else max(10 * damping, 1e-4)
        at = seen if better or at is None else at
        before, scale = scale, scale_of(at.squares) if better and freedom is not None else scale
        curved = 1.0
        if freedom is not None:
            curved = max(curvature_share(at.squares[weight > 0] / scale**2, rows, freedom), _LEAST_CURVED)
        curvature = at.curvature[inside] if kept is None else kept  # type: ignore[index]
        step = still.copy()
        step[free] = -_damped_solve(curved * curvature + prior, at.gradient[free], damping)
        last, decrement = decrement, float(-step @ at.gradient)
        model = at.model
        if kept is not None and not (better and decrement <= (last / 2 or np.inf)):
            kept, step, decrement = None, still, 0.0  # the curvature of some samples leads no further
            continue
        # what the step after this one would gain, if steps go on shrinking as they last did
        shrinking = decrement / last if decrement < last else 1.0
        small = abs(decrement * shrinking) <= max(DECREMENT * cost(at, scale), floor)
        if not np.isfinite(step).all():
            return model, still, scale, Result.SINGULAR, steps
        if steps >= max_steps:
            return model, still, scale, Result.STEPS_EXHAUSTED, steps
        steps += 1
        if small and abs(scale / before - 1) < _SCALE_TOLERANCE:
            return model, step, scale, Result.CONVERGED, steps


def _damped_solve(H: Array, gradient: Array, damping: float) -> Array:
    """The solution of (H + damping diag(H)) x = gradient, NaN where there is none."""
    root = np.sqrt(np.maximum(np.diagonal(H), np.finfo(float).tiny))
    try:
        return np.linalg.solve(H / np.outer(root, root) + damping * np.eye(len(H)), gradient / root) / root
    except np.linalg.LinAlgError:
        return np.full_like(gradient, np.nan)


def _rounding_floor(whitener: Array, weight: Array) -> float:
    squares = whitener**2
    per_sample = 3 * np.sum(squares) if squares.ndim == 1 else np.sum(squares, (1, 2))
    return float(np.sum(weight * per_sample)) * ROUNDING**2


def _of_record(
    problem: Problem,
    free: NDArray[np.bool_],
    start: ArmModel,
    weight: Array,
    freedom: float | None,
    max_steps: int,
    look: Callable[..., _Look],
    scale_of: Callable[[Array], float],
) -> tuple[ArmModel, float, Result, int]:
    """The model, the scale, how it ended and the number of steps: solves at one scale after the other."""
    size, block = padded_size(len(problem.pose))
    leaves = (problem.joint_position, problem.pose, weight)
    data = [jnp.asarray(pad(leaf, 0, size)) for leaf in leaves]
    whitener = problem.whitener
    whitener = jnp.asarray(whitener if whitener.ndim == 1 else pad(whitener, 0, size))
    observed = observe(problem.form, *data, whitener, block)
    known = np.asarray(problem.start.geometry), problem.precision, free.astype(float)
    still = np.zeros(problem.form.size)
    model, steps = start, 0
    scale = 1.0 if freedom is None else scale_of(look(start, still, 1.0, False).squares)
    for _ in range(_MAX_SCALES):
        robust = None if freedom is None else Robust(np.asarray(freedom), np.asarray(scale))  # type: ignore[arg-type]
        model, cost, good, more = jax.tree.map(
            np.asarray, _solve_of_record(problem.form, max_steps, model, observed, robust, *known)
        )
        steps += int(more)
        result = Result.CONVERGED if good else Result.STEPS_EXHAUSTED
        if freedom is None or not np.isfinite(cost):
            break
        before, scale = scale, scale_of(look(model, still, scale, False).squares)
        if abs(scale / before - 1) < _SCALE_TOLERANCE:
            break
    return model, scale, result if np.isfinite(cost) else Result.NOT_FINITE, steps


@partial(jax.jit, static_argnums=(0, 1))
def _solve_of_record(
    form: ModelForm,
    max_steps: int,
    start: ArmModel,
    observed: Observations,
    robust: Robust | None,
    center: jax.Array,
    precision: jax.Array,
    free: jax.Array,
) -> tuple[ArmModel, jax.Array, jax.Array, jax.Array]:
    """The model, its cost, whether it converged, and the steps: by the plain residual, differentiated automatically."""
    import optimistix  # which takes 0.3 s

    n = form.chain.size

    def robust_residuals(model: ArmModel, block: Observations) -> jax.Array:
        """Residuals `(row, sample)` whose halved squares are the robust cost: any least-squares solver minimises it."""
        rows = residuals(form, model, block)
        if robust is None:
            return rows
        there = block.weight > 0
        squares = jnp.sum(rows**2, 0) / jnp.where(there, block.weight, 1.0) / robust.scale**2
        u = squares / robust.freedom
        small = u < 1e-5
        safe = jnp.where(small, 1.0, u)
        ratio = jnp.where(small, 1 - u / 2 + u * u / 3 - u**3 / 4, jnp.log1p(safe) / safe)
        return jnp.sqrt((robust.freedom + rows.shape[0]) / robust.freedom * ratio) / robust.scale * rows

    def every_residual(step: jax.Array, _: None) -> jax.Array:
        model = form.retract(start, step * free)
        rows = lax.map(partial(robust_residuals, model), observed)
        pull = jnp.sqrt(precision[:n]) * (model.geometry - center)
        return jnp.concatenate([rows.reshape(-1), pull * free[:n], step * (1 - free)])

    solution = optimistix.least_squares(
        every_residual,
        optimistix.LevenbergMarquardt(*_RECORD, norm=optimistix.max_norm),
        jnp.zeros(form.size),
        options={"jac": "fwd"},
        max_steps=max_steps,
        throw=False,
    )
    cost = 0.5 * jnp.sum(every_residual(solution.value, None) ** 2)
    good = solution.result == optimistix.RESULTS.successful
    return form.retract(start, solution.value * free), cost, good, solution.stats["num_steps"]
