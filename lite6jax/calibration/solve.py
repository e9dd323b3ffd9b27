"""Least squares of chains: the fast solver, of chunks of arms, the solver of record, and one arm's fit by either.

The fast solver is damped Gauss–Newton with a curvature that is kept while it is good. The gradient is exact at every
step, so the solution is the one Levenberg–Marquardt finds; the curvature only shapes the path. A step of 1e-4 rad
leaves it good to four digits, so that later steps cost only two walks of the chain. The solver of record is optimistix'
Levenberg–Marquardt. One arm is fitted under Student's t, at one scale of the noise after the other, until the scale
that the residuals show stays the same.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike

from lite6jax import threads
from lite6jax.array_types import Array, Mask
from lite6jax.calibration.compiled import SINGLE_THREADED
from lite6jax.calibration.executables import KeptJit
from lite6jax.calibration.quality import CONVERGED, NOT_FINITE, RUNNING, SINGULAR, STEPS_EXHAUSTED, Result
from lite6jax.calibration.residual import (
    Observations,
    Robust,
    differences,
    evaluate,
    linearise,
    observe,
    over_blocks,
    pad,
    padded_size,
    predict_frames,
    residuals,
    whiten,
)
from lite6jax.estimation.robust import curvature_share, t_scale
from lite6jax.model import ArmModel, ModelForm

if TYPE_CHECKING:  # a fleet of calibrations does not import what recordings take
    from lite6jax.calibration.problem import CalibrationProblem

Solver = Literal["gauss_newton", "levenberg_marquardt"]

CHUNK = 16
"""Arms solved together: their Jacobians of 300 poses (16 × 43 × 900 doubles, 5 MB) stay in a core's cache."""
ON_ACCELERATOR = 1024
"""The same on an accelerator, which works on all at once; not tuned, as none was at hand."""
MAX_STEPS = 100
SINGULAR_ABOVE = 1e11
"""Inflation of a variance by correlation beyond which rounding decides the parameter."""

_REFRESH_ABOVE = 1e-4
"""A step above this, in m or rad, or one that shrinks too slowly, calls for a new curvature."""
_SLOW = 0.03
DECREMENT = 1e-17
"""Converged when the step after the next is to gain less than this part of the cost, …"""
ROUNDING = 2e-16
"""… or less than residuals of this size, in m and rad, have by rounding."""
FLAT = 1e-10
"""Part of the cost, below which rounding may decide which of two costs is lower, and a step is taken all the same."""

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


class FitConditions(NamedTuple):
    """What a fit has besides its samples.

    Attributes:
        free: `(size,)`, one where it may move, zero where it may not.
        center: `(geometry,)`, the mean of the prior.
        precision: `(size,)` of the prior; zero is none.
        robust: the loss; None for least squares.
        share: the curvature of that loss over that of its weighted squares.
    """

    free: Any
    center: Any
    precision: Any
    robust: Robust | None = None
    share: Any = 1.0


class ChunkSolution(NamedTuple):
    """What a solver returns of a chunk of arms, a leading arm axis on each leaf.

    Attributes:
        model: the models.
        curvature: `(arm, size, size)`, the information of the data, to about four digits.
        cost: `(arm,)`.
        status: `(arm,)`, one of `CONVERGED`, `STEPS_EXHAUSTED`, `NOT_FINITE`, `SINGULAR`.
        steps: `(arm,)`.
    """

    model: ArmModel
    curvature: jax.Array
    cost: jax.Array
    status: jax.Array
    steps: jax.Array


class Fits(NamedTuple):
    """What is kept of arms, a row each: as of `ChunkSolution`, and the covariance, the number of samples that were
    used, and root-mean-square errors, m and rad."""

    model: ArmModel
    covariance: jax.Array
    cost: jax.Array
    status: jax.Array
    steps: jax.Array
    samples: jax.Array
    position_rms: jax.Array
    orientation_rms: jax.Array


def fit_chunks(
    form: ModelForm,
    start: ArmModel,
    joint_position: np.ndarray,
    pose: np.ndarray,
    weight: np.ndarray,
    whitener: np.ndarray,
    max_steps: int = MAX_STEPS,
    progress: Callable[[int], object] | None = None,
    prior: FitConditions | None = None,
) -> Fits:
    """Fits arms by least squares, chunk by chunk and on every core.

    Args:
        form: what moves.
        start: where from, one for all.
        joint_position: `(arm, sample, joint)`, or `(sample, joint)` shared.
        pose: `(arm, sample, 4, 4)` or `(arm, sample, 3)`.
        weight: `(arm, sample)`.
        whitener: `(2,)`, one for all.
        max_steps: most steps an arm may take.
        progress: called with the number of arms done since the last call.
        prior: besides the samples, of all; None for least squares without a prior.

    Returns:
        NumPy arrays, a row an arm.
    """
    arms, samples = weight.shape
    device: Any = getattr(jax.config, "jax_default_device", None)
    platform = jax.default_backend()
    if device is not None:
        platform = device if isinstance(device, str) else device.platform
    chunk = min(CHUNK if platform == "cpu" else ON_ACCELERATOR, arms)
    size, block = padded_size(samples)

    def part(array: np.ndarray, first: int) -> np.ndarray:
        """A chunk's arms of an array; the last chunk is filled up with its last arm."""
        arms = array[first : first + chunk]
        if len(arms) == chunk:
            return arms
        return np.concatenate([arms, np.repeat(arms[-1:], chunk - len(arms), 0)])

    def solve(first: int) -> Fits:
        q = joint_position if joint_position.ndim == 2 else part(joint_position, first)
        data = pad(q, q.ndim - 2, size), pad(part(pose, first), 1, size), pad(part(weight, first), 1, size)
        fits = _fit_chunk(form, block, start, *data, np.asarray(whitener, float), max_steps, prior)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: arms - first], fits)

    firsts = range(0, arms, chunk)
    parts = []
    with ThreadPoolExecutor(threads.available()) as pool:
        for fits in map(solve, firsts) if threads.available() == 1 else pool.map(solve, firsts):
            parts.append(fits)
            if progress:
                progress(len(fits.samples))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


@partial(jax.jit, static_argnums=(0, 1), compiler_options=SINGLE_THREADED)
def _fit_chunk(
    form: ModelForm,
    block: int,
    start: ArmModel,
    joint_position: jax.Array,
    pose: jax.Array,
    weight: jax.Array,
    whitener: jax.Array,
    max_steps: ArrayLike,
    prior: FitConditions | None,
) -> Fits:
    prepare = jax.vmap(
        partial(observe, form, block=block), in_axes=(0 if joint_position.ndim == 3 else None, 0, 0, None)
    )
    observed = prepare(joint_position, pose, weight, whitener)
    start = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (len(weight), *jnp.shape(leaf))), start)
    solved = solve_chunk(form, start, observed, max_steps, prior)
    covariance = jax.vmap(inverse)(solved.curvature)
    # how much its correlation with the others inflates a parameter's variance
    inflation = jnp.diagonal(covariance, axis1=1, axis2=2) * jnp.diagonal(solved.curvature, axis1=1, axis2=2)
    regular = jnp.all((inflation > 0.5) & (inflation < SINGULAR_ABOVE), 1)
    doubtful = (solved.status != NOT_FINITE) & ~regular
    covariance = jnp.where(regular[:, None, None], covariance, jnp.nan)
    status = jnp.where(doubtful, SINGULAR, solved.status)

    def squares(model: ArmModel, block: Observations) -> tuple[jax.Array, jax.Array]:
        """Sums of squares of all distances and of all angles, zero where missing."""
        raw = differences(block, predict_frames(form, model, block.joint)[1])
        present = block.weight > 0
        return tuple(jnp.sum(jnp.where(present, jnp.sum(part**2, 0), 0.0)) for part in (raw[:3], raw[3:]))  # type: ignore[return-value]

    totals = jax.vmap(lambda model, observed: over_blocks(partial(squares, model), observed))(solved.model, observed)
    used = jnp.sum(observed.weight > 0, (1, 2))
    rms = [jnp.sqrt(total / jnp.maximum(used, 1)) for total in totals]
    return Fits(solved.model, covariance, solved.cost, status, solved.steps, used, *rms)


class _FitState(NamedTuple):
    model: ArmModel
    candidate: ArmModel
    cost: jax.Array
    gradient: jax.Array
    curvature: jax.Array
    inverse: jax.Array
    renew: jax.Array
    damping: jax.Array
    decrement: jax.Array
    moved: jax.Array
    status: jax.Array
    steps: jax.Array


def solve_chunk(
    form: ModelForm, start: ArmModel, observed: Observations, max_steps: ArrayLike, prior: FitConditions | None = None
) -> ChunkSolution:
    """Fits a chunk of arms; the arm, and of what is observed then the block, are leading axes.

    With no steps only cost and curvature at the start are evaluated. The curvature contains that of the prior, and is
    the identity where nothing moves.
    """
    arms = observed.weight.shape[0]
    squares = observed.whitener**2
    per_sample = 3 * jnp.sum(squares, 2)[..., None] if squares.ndim == 3 else jnp.sum(squares, (2, 3))
    floor = jnp.sum(observed.weight * per_sample, (1, 2)) * ROUNDING**2  # what residuals of rounding cost

    def evaluated(
        function: Callable[..., tuple[jax.Array, ...]], model: ArmModel, observations: Observations
    ) -> tuple[jax.Array, ...]:
        """Cost, gradient and, of `linearise`, curvature of one arm."""
        robust = None if prior is None else prior.robust
        cost, gradient, *curvature = over_blocks(partial(function, form, model, robust=robust), observations)
        if prior is None:
            return cost, gradient, *curvature
        free = jnp.asarray(prior.free)
        precision = jnp.asarray(prior.precision)
        n = model.geometry.shape[0]
        away = model.geometry - prior.center
        cost += 0.5 * jnp.sum(precision[:n] * away**2)
        gradient = gradient.at[:n].add(precision[:n] * away) * free
        inside = free[:, None] * free > 0
        held_diagonal = jnp.diag(1 - free)
        prior_curvature = jnp.diag(precision)
        return cost, gradient, *(jnp.where(inside, prior.share * H + prior_curvature, held_diagonal) for H in curvature)

    def at(function: Callable[..., tuple[jax.Array, ...]], models: ArmModel) -> tuple[jax.Array, ...]:
        return jax.vmap(partial(evaluated, function))(models, observed)

    def choose(condition: jax.Array, new: Any, old: Any) -> Any:
        """The leaves of one tree or of the other, arm by arm."""
        return jax.tree.map(lambda a, b: jnp.where(condition.reshape(-1, *[1] * (a.ndim - 1)), a, b), new, old)

    def body(state: _FitState) -> _FitState:
        renewed = jnp.any(state.renew)
        cost, gradient, H = lax.cond(
            renewed, lambda: at(linearise, state.candidate), lambda: (*at(evaluate, state.candidate), state.curvature)
        )
        running = state.status == RUNNING
        # so near the solution that rounding decides which cost is lower, the step is taken on the gradient's word
        flat = jnp.abs(state.decrement) <= FLAT * state.cost + floor
        better = jnp.isfinite(cost) & ((cost <= state.cost) | flat)
        accepted = running & better
        before = state.model, state.cost, state.gradient, state.curvature
        model, cost, gradient, H = choose(accepted, (state.candidate, cost, gradient, H), before)
        relaxed = jnp.where(state.damping < 1e-9, 0.0, 0.1 * state.damping)
        damping = jnp.where(running, jnp.where(better, relaxed, jnp.maximum(10 * state.damping, 1e-4)), state.damping)
        inverses = lax.cond(
            renewed | jnp.any(damping != state.damping), lambda: jax.vmap(inverse)(H, damping), lambda: state.inverse
        )
        step = -jnp.einsum("aij,aj->ai", inverses, gradient)
        decrement = -jnp.sum(step * gradient, 1)
        moved = jnp.max(jnp.abs(step), 1)
        # what the step after this one would gain, if steps go on shrinking as they last did
        shrinking = jnp.minimum(decrement / jnp.maximum(state.decrement, jnp.finfo(cost.dtype).tiny), 1.0)
        small = jnp.abs(decrement * shrinking) <= jnp.maximum(DECREMENT * cost, floor)
        singular = ~jnp.all(jnp.isfinite(step), 1)
        broken = ~jnp.isfinite(cost) | singular
        status = jnp.where(running & small, CONVERGED, state.status)
        status = jnp.where(running & (state.steps >= max_steps), STEPS_EXHAUSTED, status)
        status = jnp.where(running & broken, jnp.where(jnp.isfinite(cost), SINGULAR, NOT_FINITE), status)
        going = status == RUNNING
        candidate = choose(running & ~broken, jax.vmap(form.retract)(model, step), model)
        # the last step of a converged arm needs no look at where it leads: its own quadratic tells the cost
        arrived = running & (status == CONVERGED)
        model = choose(arrived, candidate, model)
        cost = jnp.where(arrived, jnp.maximum(cost - 0.5 * decrement, 0.0), cost)
        slow = (moved > _REFRESH_ABOVE) | (moved > _SLOW * state.moved)
        return _FitState(
            model, candidate, cost, gradient, H, inverses, going & slow, damping, decrement,
            jnp.where(accepted, moved, state.moved), status, state.steps + (going | arrived),
        )  # fmt: skip

    row = jnp.zeros((arms, form.size))
    square = jnp.zeros((arms, form.size, form.size))
    none = jnp.zeros(arms)
    infinite = jnp.full(arms, jnp.inf)
    yes = jnp.full(arms, True)
    status = jnp.full(arms, RUNNING)
    steps = jnp.zeros(arms, jnp.int32)
    state = _FitState(start, start, infinite, row, square, square, yes, none, none, infinite, status, steps)
    state = lax.while_loop(lambda s: jnp.any(s.status == RUNNING), body, state)
    return ChunkSolution(state.model, state.curvature, state.cost, state.status, state.steps)


def inverse(H: jax.Array, damping: ArrayLike = 0.0) -> jax.Array:
    """The inverse of H + damping diag(H), by Gauss–Jordan elimination with rows and columns scaled to unit diagonal.

    Plain array code on purpose: XLA's batched LAPACK calls share a thread pool with the computation that waits for
    them, and two chunks solved from two threads then wait for each other for ever (seen with jax 0.10 on 2 cores).
    """
    scale = lax.rsqrt(jnp.maximum(jnp.diagonal(H), jnp.finfo(H.dtype).tiny))
    scaled = H * scale[:, None] * scale + damping * jnp.eye(H.shape[0])
    places = jnp.arange(H.shape[0])

    def eliminate(k: jax.Array, A: jax.Array) -> jax.Array:
        """One pass over the matrix; updates of a row and a column after it would copy it twice."""
        is_pivot = places == k
        pivot = 1 / A[k, k]
        row = jnp.where(is_pivot, pivot, A[k] * pivot)
        column = jnp.where(is_pivot, 0.0, A[:, k])
        reduced = jnp.where(is_pivot | is_pivot[:, None], 0.0, A) - column[:, None] * row
        return reduced + jnp.where(is_pivot[:, None], row, 0.0)

    return lax.fori_loop(0, H.shape[0], eliminate, scaled) * scale[:, None] * scale


# ------------------------------------------------------------------ one arm


class ArmEstimate(NamedTuple):
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
    problem: "CalibrationProblem",
    free: Mask | None = None,
    *,
    start: ArmModel | None = None,
    weight: Array | None = None,
    freedom: float | None = None,
    solver: Solver = "gauss_newton",
    max_steps: int = MAX_STEPS,
) -> ArmEstimate:
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
    form = problem.form
    count = len(problem.pose)
    solve_one = _solve_one_of_few if count <= _FEW else _solve_one
    if free is None:
        free = problem.movable
    if weight is None:
        weight = np.ones(count)
    size, block = padded_size(count)
    leaves = [problem.joint_position, problem.pose, weight]
    leaves += [problem.whitener] if problem.whitener.ndim > 1 else []
    data = [pad(leaf, 0, size) for leaf in leaves]
    whitener = data[3] if len(data) > 3 else problem.whitener
    observed = _observe(form, block, *data[:3], whitener)

    def measure(model: ArmModel) -> Array:
        """`(sample,)`, squared whitened residuals."""
        return np.asarray(_squares(form, model, observed)).reshape(-1)[:count]

    def scale_of(squares: Array) -> float:
        return t_scale(squares[weight > 0], problem.rows, freedom)

    model: ArmModel = jax.tree.map(np.asarray, problem.start if start is None else start)
    squares = measure(model)
    steps = 0
    result = Result.STEPS_EXHAUSTED
    scale = 1.0 if freedom is None else scale_of(squares)
    prior = FitConditions(free.astype(float), np.asarray(problem.start.geometry), problem.precision)
    for _ in range(_MAX_SCALES):
        robust = Robust(np.asarray(freedom or _GAUSSIAN), np.asarray(scale))  # type: ignore[arg-type]
        # Student's loss curves less than its weighted squares, by a share that the residuals show
        scaled = squares[weight > 0] / scale**2
        share = 1.0
        if freedom is not None:
            share = max(curvature_share(scaled, problem.rows, freedom), _LEAST_CURVED)
        prior = prior._replace(robust=robust, share=share)
        if solver == "levenberg_marquardt" and max_steps:
            solved = _solve_of_record(form, max_steps, model, observed, prior)
            model, cost, good, more = jax.tree.map(np.asarray, solved)
            result = Result.CONVERGED if good else Result.STEPS_EXHAUSTED
            if not np.isfinite(cost):
                result = Result.NOT_FINITE
        else:
            solved = jax.tree.map(np.asarray, solve_one(form, model, observed, max_steps, prior))
            model = solved.model
            result = Result(int(solved.status))
            more = solved.steps
        squares = measure(model)
        steps = steps + int(more)
        if freedom is None or result == Result.NOT_FINITE:
            break
        before = scale
        scale = scale_of(squares)
        if abs(scale / before - 1) < _SCALE_TOLERANCE or more <= 1:  # the scale of rounding errors never settles
            break
    robust = Robust(np.asarray(freedom or _GAUSSIAN), np.asarray(scale))  # type: ignore[arg-type]
    at_end = solve_one(form, model, observed, 0, prior._replace(robust=robust, share=1.0))
    information = np.asarray(at_end.curvature)
    if result != Result.NOT_FINITE:
        # how much its correlation with the others inflates a parameter's variance
        inflation = (np.diagonal(invert(information)) * np.diagonal(information))[free]
        if not ((inflation > 0.5) & (inflation < SINGULAR_ABOVE)).all():
            result = Result.SINGULAR
    return ArmEstimate(model, information, squares, scale_of(squares), result, steps)


def invert(H: Array) -> Array:
    """The inverse of a symmetric matrix, taken after scaling to unit diagonal; NaN where there is none."""
    with np.errstate(all="ignore"):
        root = np.sqrt(np.diagonal(H))
        scale = np.outer(root, root)
        try:
            return np.linalg.inv(H / scale) / scale
        except np.linalg.LinAlgError:
            return np.full_like(H, np.nan)


def _solve_arm(
    form: ModelForm, start: ArmModel, observed: Observations, max_steps: int, prior: FitConditions
) -> ChunkSolution:
    """Solves for one arm, without the axis of arms."""
    first, observations = jax.tree.map(lambda leaf: leaf[None], (start, observed))
    return jax.tree.map(lambda leaf: leaf[0], solve_chunk(form, first, observations, max_steps, prior))


def _observe_blocks(
    form: ModelForm, block: int, joint_position: jax.Array, pose: jax.Array, weight: jax.Array, whitener: jax.Array
) -> Observations:
    return observe(form, joint_position, pose, weight, whitener, block)


def _squares_of_rows(form: ModelForm, model: ArmModel, observed: Observations) -> jax.Array:
    """`(block, sample)`, squared whitened residuals, zero of a sample of weight zero."""

    def of_block(block: Observations) -> jax.Array:
        rows = whiten(block.whitener, differences(block, predict_frames(form, model, block.joint)[1]))
        return jnp.where(block.weight > 0, jnp.sum(rows**2, 0), 0.0)

    return lax.map(of_block, observed)


_observe = KeptJit(_observe_blocks, 2)
_squares = KeptJit(_squares_of_rows, 1, **SINGLE_THREADED)
_solve_one = KeptJit(_solve_arm, 1, **SINGLE_THREADED)
_solve_one_of_few = KeptJit(_solve_arm, 1, **SINGLE_THREADED, xla_backend_optimization_level=0)


@partial(jax.jit, static_argnums=(0, 1))
def _solve_of_record(
    form: ModelForm, max_steps: int, start: ArmModel, observed: Observations, prior: FitConditions
) -> tuple[ArmModel, jax.Array, jax.Array, jax.Array]:
    """The model, its cost, whether it converged, and the steps: by the plain residual, differentiated automatically."""
    import optimistix  # which takes 0.3 s

    n = form.chain.size
    robust = prior.robust
    assert robust is not None
    free = jnp.asarray(prior.free)
    precision = jnp.asarray(prior.precision)

    def robust_residuals(model: ArmModel, block: Observations) -> jax.Array:
        """Residuals `(row, sample)` whose halved squares are the robust cost: any least-squares solver minimises it."""
        rows = residuals(form, model, block)
        present = block.weight > 0
        squares = jnp.sum(rows**2, 0) / jnp.where(present, block.weight, 1.0) / robust.scale**2
        u = squares / robust.freedom
        small = u < 1e-5
        safe = jnp.where(small, 1.0, u)
        ratio = jnp.where(small, 1 - u / 2 + u * u / 3 - u**3 / 4, jnp.log1p(safe) / safe)
        return jnp.sqrt((robust.freedom + rows.shape[0]) / robust.freedom * ratio) / robust.scale * rows

    def every_residual(step: jax.Array, _: None) -> jax.Array:
        model = form.retract(start, step * free)
        rows = lax.map(partial(robust_residuals, model), observed)
        pull = jnp.sqrt(precision[:n]) * (model.geometry - prior.center)
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
