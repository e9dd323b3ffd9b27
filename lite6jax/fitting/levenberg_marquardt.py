"""The solver of record: optimistix' Levenberg–Marquardt on the plain residual, differentiated automatically."""

from functools import partial

import jax
import jax.numpy as jnp
import optimistix
from jax import Array

from lite6jax.fitting.gauss_newton import CONVERGED, NOT_FINITE, STEPS_EXHAUSTED, Prior, Solved
from lite6jax.fitting.residual import Observations, Robust, residuals
from lite6jax.model import ArmModel, ModelForm

RELATIVE, ABSOLUTE = 1e-12, 1e-13


@partial(jax.jit, static_argnums=(0, 5))
def solve_one(
    form: ModelForm,
    start: ArmModel,
    observed: Observations,
    robust: Robust | None,
    prior: Prior,
    max_steps: int,
) -> Solved:
    """Fits one arm. Arguments and answer as in `gauss_newton.solve_chunk`, without the arm axis."""
    n = form.chain.size

    def whole_residual(step: Array, _: None) -> Array:
        model = form.retract(start, step * prior.free)
        rows = jax.lax.map(lambda block: _robust_residuals(form, model, block, robust), observed)
        pull = jnp.sqrt(prior.precision[:n]) * (model.geometry - prior.center)
        return jnp.concatenate([rows.reshape(-1), pull * prior.free[:n], step * (1 - prior.free)])

    solution = optimistix.least_squares(
        whole_residual,
        optimistix.LevenbergMarquardt(RELATIVE, ABSOLUTE, norm=optimistix.max_norm),
        jnp.zeros(form.size),
        options={"jac": "fwd"},
        max_steps=max_steps,
        throw=False,
    )
    J = jax.jacfwd(whole_residual)(solution.value, None)
    cost = 0.5 * jnp.sum(whole_residual(solution.value, None) ** 2)
    status = jnp.where(solution.result == optimistix.RESULTS.successful, CONVERGED, STEPS_EXHAUSTED)
    status = jnp.where(jnp.isfinite(cost), status, NOT_FINITE)
    return Solved(form.retract(start, solution.value * prior.free), J.T @ J, cost, status, solution.stats["num_steps"])


def _robust_residuals(form: ModelForm, model: ArmModel, block: Observations, robust: Robust | None) -> Array:
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
