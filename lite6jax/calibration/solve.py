"""One arm's fit under Student's t: damped Gauss–Newton on the host, and the solver of record, optimistix'
Levenberg–Marquardt.

Samples are looked at slice by slice and on every core. Slices of long recordings are of one size, so that one function
is compiled, and are added in order, so that sums do not depend on the threads. The scale of the noise follows the
residuals of every step.
"""

from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import NDArray

from lite6jax import threads
from lite6jax.calibration.compiled import SINGLE_THREADED
from lite6jax.calibration.gauss_newton import DECREMENT, FLAT, MAX_STEPS, ROUNDING, SINGULAR_ABOVE
from lite6jax.calibration.problem import Problem
from lite6jax.calibration.quality import Result
from lite6jax.calibration.residual import (
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
from lite6jax.estimation.robust import curvature_share, t_scale
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


def solve(
    problem: Problem,
    free: NDArray[np.bool_] | None = None,
    *,
    start: ArmModel | None = None,
    weight: Array | None = None,
    freedom: float | None = None,
    solver: Solver = "gauss_newton",
    max_steps: int = MAX_STEPS,
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
    """
    free = problem.movable if free is None else free
    samples = _Samples(problem, np.ones(len(problem.pose)) if weight is None else weight, freedom)
    first: ArmModel = jax.tree.map(np.asarray, problem.start if start is None else start)
    if solver == "levenberg_marquardt" and max_steps:
        end, scale, result, steps = _solve_by_record(samples, free, first, max_steps)
    else:
        end, scale, result, steps = _solve_by_gauss_newton(samples, free, first, max_steps)
    seen = samples.look(*end, scale, curved=True)
    curvature = seen.curvature + np.diag(problem.precision)
    information = np.where(np.outer(free, free), curvature, np.diag(1.0 - free))
    if result != Result.NOT_FINITE:
        # how much its correlation with the others inflates a parameter's variance
        inflation = (np.diagonal(inverse(information)) * np.diagonal(information))[free]
        if not ((inflation > 0.5) & (inflation < SINGULAR_ABOVE)).all():
            result = Result.SINGULAR
    return Estimate(seen.model, information, seen.squares, samples.scale(seen.squares), result, steps)


def inverse(H: Array) -> Array:
    """The inverse of a symmetric matrix, taken after scaling to unit diagonal; NaN where there is none."""
    with np.errstate(all="ignore"):
        root = np.sqrt(np.diagonal(H))
        scale = np.outer(root, root)
        try:
            return np.linalg.inv(H / scale) / scale
        except np.linalg.LinAlgError:
            return np.full_like(H, np.nan)


class _Look(NamedTuple):
    """A model, and the gradient, the data's curvature (zero if not wanted) and squared whitened residuals there."""

    model: ArmModel
    gradient: Array
    curvature: Array
    squares: Array


class _Samples:
    """The samples of a problem, their weights `(sample,)` and their loss: Student's t, or least squares."""

    def __init__(self, problem: Problem, weight: Array, freedom: float | None) -> None:
        self.problem, self.weight, self.freedom = problem, weight, freedom
        self.center, self.whitener = np.asarray(problem.start.geometry), problem.whitener
        count = len(weight)
        size = SLICE if count > SLICE else padded_size(count)[0]
        self._slices = [self.padded(slice(first, first + size), size) for first in range(0, count, size)]

    def padded(self, some: slice, size: int) -> tuple[Array, ...]:
        """Joint positions, poses, weights and whitener of some samples, and zeros up to a size."""
        leaves = [self.problem.joint_position, self.problem.pose, self.weight]
        whitener = self.whitener if self.whitener.ndim == 1 else pad(self.whitener[some], 0, size)
        return (*(pad(leaf[some], 0, size) for leaf in leaves), whitener)

    def look(self, model: ArmModel, step: Array, scale: float, curved: bool) -> _Look:
        """What the samples, and the prior's gradient, say of the model a step away, at noise of a scale."""
        problem, robust = self.problem, _robust(self.freedom or _GAUSSIAN, scale)
        totals_of = _totals_of_few if len(self.weight) <= _FEW else _totals

        def part(data: tuple[Array, ...]) -> tuple[ArmModel, tuple[Array, ...], Array]:
            return jax.tree.map(np.asarray, totals_of(problem.form, curved, model, step, *data, robust))

        models, totals, squares = zip(*threads.by_parts(part, self._slices), strict=True)
        gradient, *curvature = (np.asarray(sum(each)) for each in zip(*totals, strict=True))
        pull = problem.precision[: self.center.size] * (models[0].geometry - self.center)
        gradient = gradient + np.pad(pull, (0, problem.form.size - pull.size))
        H = curvature[0] if curved else np.zeros((gradient.size, gradient.size))
        return _Look(models[0], gradient, H, np.concatenate(squares)[: len(self.weight)])

    def cost(self, at: _Look, scale: float) -> float:
        """Half the negative log-likelihood at noise of a scale, and the prior's, up to a constant."""
        scaled = at.squares / scale**2
        if self.freedom is not None:
            scaled = (self.freedom + self.problem.rows) * np.log1p(scaled / self.freedom)
        away = at.model.geometry - self.center
        return 0.5 * float(self.weight @ scaled + self.problem.precision[: away.size] @ away**2)

    def scale(self, squares: Array) -> float:
        """Of the noise of squared whitened residuals."""
        return t_scale(squares[self.weight > 0], self.problem.rows, self.freedom)

    def first_scale(self, model: ArmModel) -> float:
        """What Student's t begins with; one of least squares, which knows no scale."""
        still = np.zeros(self.problem.form.size)
        return 1.0 if self.freedom is None else self.scale(self.look(model, still, 1.0, curved=False).squares)

    def curved_share(self, squares: Array, scale: float) -> float:
        """The curvature of the loss over that of its weighted squares."""
        if self.freedom is None:
            return 1.0
        scaled = squares[self.weight > 0] / scale**2
        return max(curvature_share(scaled, self.problem.rows, self.freedom), _LEAST_CURVED)


def _robust(freedom: float, scale: float) -> Robust:
    return Robust(np.asarray(freedom), np.asarray(scale))  # type: ignore[arg-type]


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


_totals, _totals_of_few = (
    jax.jit(_slice_totals, static_argnums=(0, 1), compiler_options=SINGLE_THREADED | options)
    for options in ({}, {"xla_backend_optimization_level": 0})
)


def _solve_by_gauss_newton(
    samples: _Samples, free: NDArray[np.bool_], start: ArmModel, max_steps: int
) -> tuple[tuple[ArmModel, Array], float, Result, int]:
    """A model and the last step from there, the scale of the noise, how it ended, and the number of steps."""
    precision, inside, still = samples.problem.precision, np.ix_(free, free), np.zeros(free.size)
    prior, squares = np.diag(precision[free]), samples.whitener**2
    per_sample = 3 * np.sum(squares) if squares.ndim == 1 else np.sum(squares, (1, 2))
    floor = float(np.sum(samples.weight * per_sample)) * ROUNDING**2
    scale = samples.first_scale(start)
    at, model, step, steps, damping, decrement = None, start, still, 0, 0.0, 0.0
    while True:
        seen = samples.look(model, step, scale, curved=True)
        cost, now = samples.cost(seen, scale), np.inf if at is None else samples.cost(at, scale)
        if at is None and not np.isfinite(cost):
            return (start, still), scale, Result.NOT_FINITE, steps
        # so near the solution that rounding decides which cost is lower, the step is taken on the gradient's word
        better = np.isfinite(cost) and (cost <= now or abs(decrement) <= FLAT * now + floor)
        damping = (damping / 10 if damping >= 1e-9 else 0.0) if better else max(10 * damping, 1e-4)
        at = seen if better or at is None else at
        before, scale = scale, samples.scale(at.squares) if better and samples.freedom is not None else scale
        # Student's loss curves less than its weighted squares, by a share that the residuals show
        H = samples.curved_share(at.squares, scale) * at.curvature[inside] + prior
        step = still.copy()
        step[free] = -_damped_solve(H, at.gradient[free], damping)
        last, decrement = decrement, float(-step @ at.gradient)
        model = at.model
        if not np.isfinite(step).all():
            return (model, still), scale, Result.SINGULAR, steps
        if steps >= max_steps:
            return (model, still), scale, Result.STEPS_EXHAUSTED, steps
        steps += 1
        # what the step after this one would gain, if steps go on shrinking as they last did
        gain = abs(decrement * (decrement / last if decrement < last else 1.0))
        if gain <= max(DECREMENT * samples.cost(at, scale), floor) and abs(scale / before - 1) < _SCALE_TOLERANCE:
            return (model, step), scale, Result.CONVERGED, steps


def _damped_solve(H: Array, gradient: Array, damping: float) -> Array:
    """The solution of (H + damping diag(H)) x = gradient, NaN where there is none."""
    root = np.sqrt(np.maximum(np.diagonal(H), np.finfo(float).tiny))
    try:
        return np.linalg.solve(H / np.outer(root, root) + damping * np.eye(len(H)), gradient / root) / root
    except np.linalg.LinAlgError:
        return np.full_like(gradient, np.nan)


def _solve_by_record(
    samples: _Samples, free: NDArray[np.bool_], start: ArmModel, max_steps: int
) -> tuple[tuple[ArmModel, Array], float, Result, int]:
    """As `_solve_by_gauss_newton`, by solves of record at one scale after the other, until the scale has converged."""
    form, still = samples.problem.form, np.zeros(free.size)
    size, block = padded_size(len(samples.weight))
    q, pose, weight, whitener = map(jnp.asarray, samples.padded(slice(None), size))
    observed = observe(form, q, pose, weight, whitener, block)
    model, steps, scale, result = start, 0, samples.first_scale(start), Result.STEPS_EXHAUSTED
    for _ in range(_MAX_SCALES):
        robust = None if samples.freedom is None else _robust(samples.freedom, scale)
        known = samples.center, samples.problem.precision, free.astype(float)
        found = _solve_of_record(form, max_steps, model, observed, robust, *known)
        model, cost, good, more = jax.tree.map(np.asarray, found)
        result = Result.CONVERGED if good else Result.STEPS_EXHAUSTED
        result, steps = result if np.isfinite(cost) else Result.NOT_FINITE, steps + int(more)
        if robust is None or result == Result.NOT_FINITE:
            break
        before, scale = scale, samples.scale(samples.look(model, still, scale, curved=False).squares)
        if abs(scale / before - 1) < _SCALE_TOLERANCE:
            break
    return (model, still), scale, result, steps


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
