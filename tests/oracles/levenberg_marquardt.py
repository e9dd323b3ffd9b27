"""The solver of record: optimistix' Levenberg–Marquardt on the plain residual, differentiated automatically."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from lite6jax.calibration.residual import observe, residuals
from lite6jax.estimation.robust import t_scale

_TOLERANCES = 1e-12, 1e-13
_SCALES = 30
"""The most solves, each at another scale of the noise."""


def fit_of_record(problem, start, freedom=None):
    """The likeliest model of a problem, and whether the last solve converged.

    Under Student's t of `freedom` degrees it solves at one scale of the noise after the other.
    """
    form, free = problem.form, problem.movable.astype(float)
    data = (jnp.asarray(part) for part in (problem.joint_position, problem.pose, np.ones(len(problem.pose))))
    observed = observe(form, *data, jnp.asarray(problem.whitener), len(problem.pose))
    observed = jax.tree.map(lambda leaf: leaf[0], observed)

    def every_residual(step, arguments):
        """Residuals whose halved squares are the cost."""
        start, scale = arguments
        model = form.retract(start, step * free)
        rows = residuals(form, model, observed)
        if freedom is not None:
            u = jnp.sum(rows**2, 0) / scale**2 / freedom
            rows = rows * jnp.sqrt((freedom + len(rows)) / freedom * jnp.log1p(u) / u) / scale
        pull = jnp.sqrt(problem.precision[: form.chain.size]) * (model.geometry - problem.start.geometry)
        return jnp.concatenate([rows.ravel(), pull * free[: form.chain.size], step * (1 - free)])

    @jax.jit
    def solved(start, scale):
        method = optimistix.LevenbergMarquardt(*_TOLERANCES, norm=optimistix.max_norm)
        options, zero = {"jac": "fwd"}, jnp.zeros(form.size)
        found = optimistix.least_squares(every_residual, method, zero, (start, scale), options, max_steps=100)
        model = form.retract(start, found.value * free)
        return model, jnp.sum(residuals(form, model, observed) ** 2, 0), found.result == optimistix.RESULTS.successful

    model, scale = jax.tree.map(jnp.asarray, start), 1.0
    if freedom is not None:
        scale = t_scale(np.asarray(jnp.sum(residuals(form, model, observed) ** 2, 0)), problem.rows, freedom)
    for _ in range(_SCALES if freedom else 1):
        model, squares, converged = solved(model, scale)
        if freedom is not None:
            before, scale = scale, t_scale(np.asarray(squares), problem.rows, freedom)
            if abs(scale / before - 1) < 1e-6:
                break
    return jax.tree.map(np.asarray, model), bool(converged)
