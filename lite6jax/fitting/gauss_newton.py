"""The fast solver: damped Gauss–Newton for a chunk of arms at once, with a curvature that is kept while it is good.

The gradient is exact at every step, so the solution is the one Levenberg–Marquardt finds; the curvature only shapes the
path. A step of 1e-4 rad leaves it good to four digits, so a fit from nominal needs it twice, and the other steps cost
only two passes over the chain.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from lite6jax.fitting.residual import Observations, Robust, cost_and_gradient, curvature, over_blocks
from lite6jax.model import ArmModel, ModelForm

RUNNING, CONVERGED, STEPS_EXHAUSTED, NOT_FINITE = range(4)

_REFRESH_ABOVE = 1e-4
"""Steps above this, in m or rad, or that shrink too slowly, call for a new curvature."""
_SLOW = 0.03
_DECREMENT = 1e-18
"""Converged when a step was to gain less than this part of the cost, …"""
_ROUNDING = 1e-15
"""… or less than residuals of this size, in m and rad, have by rounding."""


class Prior(NamedTuple):
    """What is known beforehand, and what is held.

    Attributes:
        center: the model that the prior is about.
        precision: `(size,)`, inverse variance of each entry of the step from `center`'s geometry; zero is no prior.
        free: `(size,)`, one where the fit may move.
    """

    center: Array
    precision: Array
    free: Array


class State(NamedTuple):
    model: ArmModel
    cost: Array
    gradient: Array
    inverse: Array
    damping: Array
    moved: Array
    refresh: Array
    status: Array
    steps: Array


def solve_chunk(
    form: ModelForm, start: ArmModel, observed: Observations, robust: Robust, prior: Prior, max_steps: int
) -> tuple[ArmModel, Array, Array, Array, Array]:
    """Fits a chunk of arms.

    Args:
        form: what moves.
        start: where from; a leading arm axis on every leaf.
        observed: arm and block axes lead.
        robust: the loss, one for all.
        prior: `center` `(geometry,)`, `precision` and `free` `(size,)`, one for all or with a leading arm axis.
        max_steps: most steps an arm may take.

    Returns:
        The models, the curvature `(arm, size, size)` at them, the cost `(arm,)`, the status `(arm,)` and the steps
        `(arm,)`.
    """
    arms = start.geometry.shape[0]
    n = form.chain.size
    prior = Prior(*(jnp.broadcast_to(leaf, (arms, leaf.shape[-1])) for leaf in prior))
    floor = jax.vmap(lambda o: over_blocks(_rounding_floor, o))(observed)

    def evaluate(model: ArmModel) -> tuple[Array, Array]:
        def one(model: ArmModel, observed: Observations, prior: Prior) -> tuple[Array, Array]:
            cost, gradient = over_blocks(partial(cost_and_gradient, form, model, robust=robust), observed)
            away = model.geometry - prior.center
            pull = prior.precision[:n] * away
            return cost + 0.5 * jnp.sum(pull * away), (gradient.at[:n].add(pull)) * prior.free

        return jax.vmap(one)(model, observed, prior)

    def curvatures(model: ArmModel) -> Array:
        def one(model: ArmModel, observed: Observations, prior: Prior) -> Array:
            H = over_blocks(partial(curvature, form, model, robust=robust), observed)
            H = H + jnp.diag(prior.precision)
            return jnp.where(prior.free[:, None] * prior.free > 0, H, 0.0) + jnp.diag(1.0 - prior.free)

        return jax.vmap(one)(model, observed, prior)

    def body(state: State) -> State:
        inverse = lax.cond(
            jnp.any(state.refresh),
            lambda: jax.vmap(_damped_inverse)(curvatures(state.model), state.damping),
            lambda: state.inverse,
        )
        step = -jnp.einsum("aij,aj->ai", inverse, state.gradient)
        decrement = -jnp.sum(step * state.gradient, 1)
        candidate = jax.vmap(form.retract)(state.model, step)
        cost, gradient = evaluate(candidate)
        tolerance = jnp.maximum(_DECREMENT * state.cost, floor)
        # near the solution the cost is flat to rounding: a step that small is taken on the gradient's word
        better = (cost <= state.cost) | ((decrement <= 1e-10 * state.cost + floor) & jnp.isfinite(cost))
        running = state.status == RUNNING
        taken = running & better
        moved = jnp.max(jnp.abs(step), 1)
        finite = jnp.isfinite(state.cost) & jnp.all(jnp.isfinite(step), 1)
        converged = taken & (decrement <= tolerance)
        steps = state.steps + running
        status = jnp.where(running & converged, CONVERGED, state.status)
        status = jnp.where((status == RUNNING) & ~finite, NOT_FINITE, status)
        status = jnp.where((status == RUNNING) & (steps >= max_steps), STEPS_EXHAUSTED, status)
        keep = lambda new, old: jnp.where(taken.reshape(-1, *[1] * (new.ndim - 1)), new, old)
        slow = (moved > _REFRESH_ABOVE) | (moved > _SLOW * state.moved)
        refresh = (status == RUNNING) & (~better | slow)
        return State(
            jax.tree.map(keep, candidate, state.model),
            keep(cost, state.cost),
            keep(gradient, state.gradient),
            inverse,
            jnp.where(better, state.damping * 0.1, jnp.maximum(state.damping * 10, 1e-6)),
            jnp.where(taken, moved, state.moved),
            refresh,
            status,
            steps,
        )

    cost, gradient = evaluate(start)
    state = State(
        start,
        cost,
        gradient,
        jnp.zeros((arms, form.size, form.size)),
        jnp.full(arms, 1e-12),
        jnp.full(arms, jnp.inf),
        jnp.full(arms, True),
        jnp.where(jnp.isfinite(cost), RUNNING, NOT_FINITE),
        jnp.zeros(arms, jnp.int32),
    )
    state = lax.while_loop(lambda s: jnp.any(s.status == RUNNING), body, state)
    return state.model, curvatures(state.model), state.cost, state.status, state.steps


def _rounding_floor(observed: Observations) -> Array:
    squares = observed.whitener**2
    rows = squares.reshape(-1, 1) if observed.whitener.ndim == 1 else squares.sum(0)
    return jnp.sum(observed.weight * rows) * _ROUNDING**2


def _damped_inverse(H: Array, damping: Array) -> Array:
    """The inverse of H + damping diag(H), with rows and columns scaled to unit diagonal first."""
    scale = jax.lax.rsqrt(jnp.maximum(jnp.diagonal(H), jnp.finfo(H.dtype).tiny))
    scaled = H * scale[:, None] * scale + damping * jnp.eye(H.shape[0])
    factor = jax.scipy.linalg.cho_factor(scaled)
    return jax.scipy.linalg.cho_solve(factor, jnp.eye(H.shape[0])) * scale[:, None] * scale
