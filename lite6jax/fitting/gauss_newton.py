"""The fast solver: damped Gauss–Newton for a chunk of arms at once, with a curvature that is kept while it is good.

The gradient is exact at every step, so the solution is the one Levenberg–Marquardt finds; the curvature only shapes the
path. A step of 1e-4 rad leaves it good to four digits. Where samples are many, the first step is that of one in four of
them: it ends within their noise, twice the final standard deviation, and an error of second order as that of all would.
Where these are below 1e-4, a fit from nominal needs the curvature of all samples once, and every other step costs only
two walks of the chain.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.typing import ArrayLike

from lite6jax.fitting.residual import POSE, POSITION, Observations, Robust, block_cost, evaluate, linearise, over_blocks
from lite6jax.fitting.status import CONVERGED, NOT_FINITE, RUNNING, SINGULAR, STEPS_EXHAUSTED
from lite6jax.model import ArmModel, ModelForm

_REFRESH_ABOVE = 1e-4
"""A step above this, in m or rad, or one that shrinks too slowly, calls for a new curvature."""
_SLOW = 0.03
_STRIDE = 4
"""The first step is that of every so many samples, …"""
_NUMBERS_EACH = 8
"""… where these have this many numbers for each parameter, …"""
_DETERMINED = 1e6
"""… and determine each parameter: its variance is at most this many times what it would be if the others were known."""
_BY_CHANCE = 10.0
"""… and where that lowers their cost by this many times what it would from the solution of all, by noise alone."""
_DECREMENT = 1e-17
"""Converged when the step after the next is to gain less than this part of the cost, …"""
_ROUNDING = 2e-16
"""… or less than residuals of this size, in m and rad, have by rounding."""


class Prior(NamedTuple):
    """What is known beforehand, and what is held.

    Attributes:
        center: the geometry `(geometry,)` that the prior is about.
        precision: `(size,)`, inverse variance of each entry of the step from there; zero is no prior. Frames have none.
        free: `(size,)`, one where the fit may move, zero where it may not.
    """

    center: Array
    precision: Array
    free: Array


class Solved(NamedTuple):
    """What a solver returns of a chunk of arms.

    Attributes:
        model: the models, a leading arm axis on each leaf.
        curvature: `(arm, size, size)`, the information of data and prior, to about four digits; identity where held.
        cost: `(arm,)`.
        status: `(arm,)`, one of `CONVERGED`, `STEPS_EXHAUSTED`, `NOT_FINITE`, `SINGULAR`.
        steps: `(arm,)`.
    """

    model: ArmModel
    curvature: Array
    cost: Array
    status: Array
    steps: Array


class _State(NamedTuple):
    model: ArmModel
    candidate: ArmModel
    cost: Array
    gradient: Array
    curvature: Array
    inverse: Array
    renew: Array
    damping: Array
    decrement: Array
    moved: Array
    status: Array
    steps: Array


def solve_chunk(
    form: ModelForm,
    start: ArmModel,
    observed: Observations,
    robust: Robust | None,
    prior: Prior,
    max_steps: ArrayLike,
    keep_curvature: bool = True,
) -> Solved:
    """Fits a chunk of arms.

    Args:
        form: what moves.
        start: where from; a leading arm axis on every leaf.
        observed: arm and block axes lead.
        robust: the loss; a leading arm axis.
        prior: a leading arm axis.
        max_steps: most steps an arm may take; zero only evaluates cost and curvature at the start.
        keep_curvature: false makes it anew at every step: slower to run, faster to compile.
    """
    arms = start.geometry.shape[0]
    floor = jax.vmap(partial(over_blocks, _rounding_floor))(observed)
    at = partial(_with_prior, form, prior, robust)
    begun = jnp.zeros(arms, jnp.int32)
    if keep_curvature:
        start, begun = _begin(form, start, observed, robust, prior, max_steps)

    def body(state: _State) -> _State:
        renewed = jnp.any(state.renew) if keep_curvature else jnp.array(True)
        cost, gradient, H = (
            lax.cond(
                renewed,
                lambda: at(linearise, state.candidate, observed),
                lambda: (*at(evaluate, state.candidate, observed), state.curvature),
            )
            if keep_curvature
            else at(linearise, state.candidate, observed)
        )
        running = state.status == RUNNING
        # so near the solution that rounding decides which cost is lower, the step is taken on the gradient's word
        flat = jnp.abs(state.decrement) <= 1e-10 * state.cost + floor
        better = jnp.isfinite(cost) & ((cost <= state.cost) | flat)
        taken = running & better
        model, cost, gradient, H = jax.tree.map(
            _choose(taken),
            (state.candidate, cost, gradient, H),
            (state.model, state.cost, state.gradient, state.curvature),
        )
        relaxed = jnp.where(state.damping < 1e-9, 0.0, 0.1 * state.damping)
        damping = jnp.where(running, jnp.where(better, relaxed, jnp.maximum(10 * state.damping, 1e-4)), state.damping)
        kept = lax.cond(
            renewed | jnp.any(damping != state.damping), lambda: jax.vmap(inverse)(H, damping), lambda: state.inverse
        )
        step = -jnp.einsum("aij,aj->ai", kept, gradient)
        decrement = -jnp.sum(step * gradient, 1)
        moved = jnp.max(jnp.abs(step), 1)
        # what the step after this one would gain, if steps go on shrinking as they last did
        shrinking = jnp.minimum(decrement / jnp.maximum(state.decrement, jnp.finfo(cost.dtype).tiny), 1.0)
        small = jnp.abs(decrement * shrinking) <= jnp.maximum(_DECREMENT * cost, floor)
        singular = ~jnp.all(jnp.isfinite(step), 1)
        broken = ~jnp.isfinite(cost) | singular
        status = jnp.where(running & small, CONVERGED, state.status)
        status = jnp.where(running & (state.steps >= max_steps), STEPS_EXHAUSTED, status)
        status = jnp.where(running & broken, jnp.where(jnp.isfinite(cost), SINGULAR, NOT_FINITE), status)
        going = status == RUNNING
        candidate = jax.tree.map(_choose(running & ~broken), jax.vmap(form.retract)(model, step), model)
        # the last step of a converged arm needs no look at where it leads: its own quadratic tells the cost
        arrived = running & (status == CONVERGED)
        model = jax.tree.map(_choose(arrived), candidate, model)
        cost = jnp.where(arrived, jnp.maximum(cost - 0.5 * decrement, 0.0), cost)
        slow = (moved > _REFRESH_ABOVE) | (moved > _SLOW * state.moved)
        return _State(
            model, candidate, cost, gradient, H, kept, going & slow, damping, decrement,
            jnp.where(taken, moved, state.moved), status, state.steps + (going | arrived),
        )  # fmt: skip

    nothing = jnp.zeros(arms)
    state = _State(
        model=start,
        candidate=start,
        cost=jnp.full(arms, jnp.inf),
        gradient=jnp.zeros((arms, form.size)),
        curvature=jnp.zeros((arms, form.size, form.size)),
        inverse=jnp.zeros((arms, form.size, form.size)),
        renew=jnp.full(arms, True),
        damping=nothing,
        decrement=nothing,
        moved=jnp.full(arms, jnp.inf),
        status=jnp.full(arms, RUNNING),
        steps=begun,
    )
    state = lax.while_loop(lambda s: jnp.any(s.status == RUNNING), body, state)
    return Solved(state.model, state.curvature, state.cost, state.status, state.steps)


def _with_prior(
    form: ModelForm,
    prior: Prior,
    robust: Robust | None,
    function: Callable[..., tuple[Array, ...]],
    model: ArmModel,
    observed: Observations,
) -> tuple[Array, ...]:
    """Cost, gradient and, of `linearise`, curvature of data and prior of each arm; identity where held."""
    n = form.chain.size

    def one(model: ArmModel, observed: Observations, robust: Robust | None, prior: Prior) -> tuple[Array, ...]:
        cost, gradient, *curvature = over_blocks(partial(function, form, model, robust=robust), observed)
        away = model.geometry - prior.center
        pull = prior.precision[:n] * away
        both_free = prior.free[:, None] * prior.free > 0
        held = [jnp.where(both_free, H + jnp.diag(prior.precision), jnp.diag(1 - prior.free)) for H in curvature]
        return (cost + 0.5 * jnp.sum(pull * away), gradient.at[:n].add(pull) * prior.free, *held)

    return jax.vmap(one)(model, observed, robust, prior)


def _begin(
    form: ModelForm,
    start: ArmModel,
    observed: Observations,
    robust: Robust | None,
    prior: Prior,
    max_steps: ArrayLike,
) -> tuple[ArmModel, Array]:
    """The model after one Gauss–Newton step of every fourth sample, and the steps taken, `(arm,)`.

    An arm stays where it is if these samples are too few, do not determine the step, or gain no more by it than they
    would by fitting their own noise: a robust fit begins at a solution, from which the step would only lead away.
    Samples of several blocks are left to the solver, as are whiteners of each sample's own: neither is fitted by the
    hundred.
    """
    arms, blocks, samples = observed.weight.shape
    rows = POSITION if observed.rotation.shape[-1] == 0 else POSE
    none = jnp.zeros(arms, jnp.int32)
    if blocks > 1 or observed.whitener.ndim > 3 or samples // _STRIDE * rows < _NUMBERS_EACH * form.size:
        return start, none
    few = jax.tree.map(lambda leaf: leaf[..., ::_STRIDE], observed._replace(whitener=jnp.zeros(0)))
    few = few._replace(whitener=observed.whitener)
    at = partial(_with_prior, form, prior, robust)
    before, gradient, H = at(linearise, start, few)
    inverted = jax.vmap(inverse)(H)
    step = -jnp.einsum("aij,aj->ai", inverted, gradient)
    model = jax.vmap(form.retract)(start, step)
    inflation = jnp.diagonal(inverted, axis1=1, axis2=2) * jnp.diagonal(H, axis1=1, axis2=2)
    determined = jnp.all((inflation > 0.5) & (inflation < _DETERMINED), 1)
    numbers = jnp.sum(few.weight > 0, (1, 2)) * rows
    after = at(_cost_alone, model, few)[0]
    far = before - after > _BY_CHANCE * form.size / numbers * after
    enough = numbers >= _NUMBERS_EACH * form.size
    taken = (jnp.asarray(max_steps) > 0) & determined & enough & far & jnp.all(jnp.isfinite(step), 1)
    return jax.tree.map(_choose(taken), model, start), none + taken


def _cost_alone(form: ModelForm, model: ArmModel, observed: Observations, robust: Robust | None) -> tuple[Array, Array]:
    return block_cost(form, model, observed, robust), jnp.zeros(form.size)


def _choose(which: Array) -> Callable[[Array, Array], Array]:
    return lambda new, old: jnp.where(which.reshape(-1, *[1] * (new.ndim - 1)), new, old)


def _rounding_floor(observed: Observations) -> Array:
    squares = observed.whitener**2
    per_sample = 3 * jnp.sum(squares) if observed.whitener.ndim == 1 else jnp.sum(squares, (0, 1))
    return jnp.sum(observed.weight * per_sample) * _ROUNDING**2


def inverse(H: Array, damping: ArrayLike = 0.0) -> Array:
    """The inverse of H + damping diag(H), by Gauss–Jordan elimination with rows and columns scaled to unit diagonal.

    Plain array code on purpose: XLA's batched LAPACK calls share a thread pool with the computation that waits for
    them, and two chunks solved from two threads then wait for each other for ever (seen with jax 0.10 on 2 cores).
    """
    scale = lax.rsqrt(jnp.maximum(jnp.diagonal(H), jnp.finfo(H.dtype).tiny))
    scaled = H * scale[:, None] * scale + damping * jnp.eye(H.shape[0])

    places = jnp.arange(H.shape[0])

    def eliminate(k: Array, A: Array) -> Array:
        """One pass over the matrix; updates of a row and a column after it would copy it twice."""
        here, pivot = places == k, 1 / A[k, k]
        row, column = jnp.where(here, pivot, A[k] * pivot), jnp.where(here, 0.0, A[:, k])
        rest = jnp.where(here | here[:, None], 0.0, A) - column[:, None] * row
        return rest + jnp.where(here[:, None], row, 0.0)

    return lax.fori_loop(0, H.shape[0], eliminate, scaled) * scale[:, None] * scale
