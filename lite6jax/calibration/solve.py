"""One arm's fit under Student's t, by the fast solver or by that of record, optimistix' Levenberg–Marquardt.

Each solves at one scale of the noise after the other, until the scale that the residuals show stays the same.
"""

from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import NDArray

from lite6jax.calibration.compiled import SINGLE_THREADED
from lite6jax.calibration.gauss_newton import MAX_STEPS, SINGULAR_ABOVE, Known, Solved, solve_chunk
from lite6jax.calibration.problem import Problem
from lite6jax.calibration.quality import Result
from lite6jax.calibration.residual import (
    Observations,
    Robust,
    differences,
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

_GAUSSIAN = 1e15
"""Degrees of freedom at which Student's t is least squares to rounding: another loss would be compiled for seconds."""
_SCALE_TOLERANCE = 1e-6
"""Relative change of the noise scale below which it has converged."""
_MAX_SCALES = 30
"""Most solves, each at another scale."""
_FEW = 1500
"""Samples up to which the compiler's optimisation takes longer than it saves, were it a hundred looks."""
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
        max_steps: most steps at one scale; zero only evaluates residuals and information at the start.
    """
    form, count = problem.form, len(problem.pose)
    solve_one = _solve_one_of_few if count <= _FEW else _solve_one
    free = problem.movable if free is None else free
    weight = np.ones(count) if weight is None else weight
    size, block = padded_size(count)
    leaves = [problem.joint_position, problem.pose, weight]
    leaves += [problem.whitener] if problem.whitener.ndim > 1 else []
    data = [pad(leaf, 0, size) for leaf in leaves]
    observed = _observe(form, *data[:3], data[3] if len(data) > 3 else problem.whitener, block)

    def measure(model: ArmModel) -> Array:
        """`(sample,)`, squared whitened residuals."""
        return np.asarray(_squares(form, model, observed)).reshape(-1)[:count]

    def scale_of(squares: Array) -> float:
        return t_scale(squares[weight > 0], problem.rows, freedom)

    model: ArmModel = jax.tree.map(np.asarray, problem.start if start is None else start)
    squares, steps, result = measure(model), 0, Result.STEPS_EXHAUSTED
    scale = 1.0 if freedom is None else scale_of(squares)
    known = Known(free.astype(float), np.asarray(problem.start.geometry), problem.precision)
    for _ in range(_MAX_SCALES):
        robust = Robust(np.asarray(freedom or _GAUSSIAN), np.asarray(scale))  # type: ignore[arg-type]
        # Student's loss curves less than its weighted squares, by a share that the residuals show
        scaled = squares[weight > 0] / scale**2
        share = 1.0 if freedom is None else max(curvature_share(scaled, problem.rows, freedom), _LEAST_CURVED)
        known = known._replace(robust=robust, share=share)
        if solver == "levenberg_marquardt" and max_steps:
            found = _solve_of_record(form, max_steps, model, observed, known)
            model, cost, good, more = jax.tree.map(np.asarray, found)
            result = Result.CONVERGED if good else Result.STEPS_EXHAUSTED
            result = result if np.isfinite(cost) else Result.NOT_FINITE
        else:
            found = jax.tree.map(np.asarray, solve_one(form, model, observed, max_steps, known))
            model, result, more = found.model, Result(int(found.status)), found.steps
        squares, steps = measure(model), steps + int(more)
        if freedom is None or result == Result.NOT_FINITE:
            break
        before, scale = scale, scale_of(squares)
        if abs(scale / before - 1) < _SCALE_TOLERANCE:
            break
    robust = Robust(np.asarray(freedom or _GAUSSIAN), np.asarray(scale))  # type: ignore[arg-type]
    at_end = solve_one(form, model, observed, 0, known._replace(robust=robust, share=1.0))
    information = np.asarray(at_end.curvature)
    if result != Result.NOT_FINITE:
        # how much its correlation with the others inflates a parameter's variance
        inflation = (np.diagonal(inverse(information)) * np.diagonal(information))[free]
        if not ((inflation > 0.5) & (inflation < SINGULAR_ABOVE)).all():
            result = Result.SINGULAR
    return Estimate(model, information, squares, scale_of(squares), result, steps)


def inverse(H: Array) -> Array:
    """The inverse of a symmetric matrix, taken after scaling to unit diagonal; NaN where there is none."""
    with np.errstate(all="ignore"):
        root = np.sqrt(np.diagonal(H))
        scale = np.outer(root, root)
        try:
            return np.linalg.inv(H / scale) / scale
        except np.linalg.LinAlgError:
            return np.full_like(H, np.nan)


_observe = jax.jit(observe, static_argnums=(0, 5))


def _solve_arm(form: ModelForm, start: ArmModel, observed: Observations, max_steps: int, known: Known) -> Solved:
    """Of one arm, without the axis of arms."""
    one = jax.tree.map(lambda leaf: leaf[None], (start, observed))
    return jax.tree.map(lambda leaf: leaf[0], solve_chunk(form, *one, max_steps, known))


_solve_one, _solve_one_of_few = (
    jax.jit(_solve_arm, static_argnums=0, compiler_options=SINGLE_THREADED | options)
    for options in ({}, {"xla_backend_optimization_level": 0})
)


@partial(jax.jit, static_argnums=0, compiler_options=SINGLE_THREADED)
def _squares(form: ModelForm, model: ArmModel, observed: Observations) -> jax.Array:
    """`(block, sample)`, squared whitened residuals, zero of a sample of weight zero."""

    def of_block(block: Observations) -> jax.Array:
        rows = whiten(block.whitener, differences(block, predict_frames(form, model, block.joint)[1]))
        return jnp.where(block.weight > 0, jnp.sum(rows**2, 0), 0.0)

    return lax.map(of_block, observed)


@partial(jax.jit, static_argnums=(0, 1))
def _solve_of_record(
    form: ModelForm, max_steps: int, start: ArmModel, observed: Observations, known: Known
) -> tuple[ArmModel, jax.Array, jax.Array, jax.Array]:
    """The model, its cost, whether it converged, and the steps: by the plain residual, differentiated automatically."""
    import optimistix  # which takes 0.3 s

    n, robust = form.chain.size, known.robust
    assert robust is not None
    free, precision = jnp.asarray(known.free), jnp.asarray(known.precision)

    def robust_residuals(model: ArmModel, block: Observations) -> jax.Array:
        """Residuals `(row, sample)` whose halved squares are the robust cost: any least-squares solver minimises it."""
        rows = residuals(form, model, block)
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
        pull = jnp.sqrt(precision[:n]) * (model.geometry - known.center)
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
