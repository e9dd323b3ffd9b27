"""The robust fit of very many samples: begun on some of them, ended on all, slice by slice and on every core.

A fit of some samples is a few of its own standard deviations from that of all. From there Gauss–Newton needs the exact
gradient of all samples, and no curvature but that of the few: each step leaves a few per cent of the error. The
curvature of all is computed once, at the end, for the covariance. Slices are of one size whatever the recording's, so
that one function is compiled, and are added in order, so that sums do not depend on the threads.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import NDArray

from lite6jax import threads
from lite6jax.estimation.robust import curvature_share, t_scale
from lite6jax.fitting.chunks import BLOCK, SINGLE_THREADED, observe, pad
from lite6jax.fitting.compiled import Exported
from lite6jax.fitting.problem import Problem, whitener_of
from lite6jax.fitting.residual import Observations, Robust, differences, evaluate, linearise, predict_frames, whiten
from lite6jax.fitting.solution import Result
from lite6jax.fitting.solve import Estimates, RobustFits
from lite6jax.model import ArmModel, ModelForm

Array = NDArray[np.floating]

_SLICE = 10 * BLOCK
"""Samples of a slice: 3 MB of poses."""
_MOST_STEPS = 12
_CLOSE = 1e-10
"""Twice the log-likelihood that the next step is to gain at most: estimates are within 1e-5 standard deviations."""
_SCALE_CLOSE = 1e-6
"""Relative change of the scale, below which it has converged as well."""
_LEAST_CURVED = 0.5
"""Of the curvature of the loss over that of its weighted squares; of few outliers it is 0.9."""


def _totals(
    form: ModelForm,
    curved: bool,
    model: ArmModel,
    joint_position: jax.Array,
    pose: jax.Array,
    weight: jax.Array,
    whitener: jax.Array,
    robust: Robust,
) -> tuple[Any, jax.Array]:
    """The gradient of the samples' cost or, if `curved`, its curvature; and their squared whitened residuals."""
    observed = observe(form, joint_position, pose, weight, whitener, BLOCK)

    def one(total: jax.Array, block: Observations) -> tuple[jax.Array, jax.Array]:
        found = linearise(form, model, block, robust)[2] if curved else evaluate(form, model, block, robust)[1]
        rows = whiten(block.whitener, differences(block, predict_frames(form, model, block.joint)[1]))
        return total + found, jnp.where(block.weight > 0, jnp.sum(rows**2, 0), 0.0)

    shape = (form.size, form.size) if curved else (form.size,)
    total, squares = lax.scan(one, jnp.zeros(shape), observed)
    return total, squares.reshape(-1)


_slice_totals = Exported("slice_totals", _totals, (0, 1), SINGLE_THREADED)


def finished_on_all(
    problem: Problem, free: NDArray[np.bool_], covariance: Array, begun: RobustFits, few: int, freedom: float
) -> RobustFits | None:
    """The fit of all samples, or None where steps from the fit of some do not lead to it.

    Args:
        problem: with all samples.
        free: `(size,)` bool, the parameters to estimate.
        covariance: of a sample's residual, `(row, row)` or `(sample, row, row)`.
        begun: the fit of some of the samples.
        few: how many these were.
        freedom: degrees of freedom of Student's t.
    """
    if begun.estimates.status[0] != Result.CONVERGED or not free.any():
        return None
    form, whitener = problem.form, whitener_of(covariance)
    model, scale = begun.model(0), float(begun.scale[0])
    prior, center = problem.precision * free, np.asarray(problem.start.geometry)
    inverse = np.zeros((form.size, form.size))
    inside = np.ix_(free, free)
    expected = (np.asarray(begun.estimates.curvature[0]) - np.diag(prior))[inside] * (len(problem.pose) / few)
    before, steps = np.inf, begun.estimates.steps
    for _ in range(_MOST_STEPS):
        gradient, squares = _all(form, False, model, problem, whitener, freedom, scale)
        gradient[: center.size] += problem.precision[: center.size] * (np.asarray(model.geometry) - center)
        last, scale = scale, t_scale(squares, problem.rows, freedom)
        curved = max(curvature_share(squares / scale**2, problem.rows, freedom), _LEAST_CURVED)
        inverse[inside] = np.linalg.inv(expected * curved + np.diag(prior)[inside])
        change = -inverse @ (gradient * free)
        decrement = -float(change @ gradient)
        if not np.isfinite(decrement) or decrement > max(before, _CLOSE):
            return None
        model, steps = jax.tree.map(np.asarray, form.retract(model, jnp.asarray(change))), steps + 1
        # the next step shrinks as this one did; after the first nothing is known of that
        shrinking = min(decrement / before, 1.0) if np.isfinite(before) else 1.0
        if decrement * shrinking <= _CLOSE and abs(scale / last - 1) < _SCALE_CLOSE:
            break
        before = decrement
    else:
        return None
    curvature, squares = _all(form, True, model, problem, whitener, freedom, scale)
    held = np.where(np.outer(free, free), curvature + np.diag(prior), np.diag(1.0 - free))
    leading = jax.tree.map(lambda leaf: np.asarray(leaf)[None], model)
    estimates = Estimates(leading, held[None], squares[None], np.array([Result.CONVERGED]), steps)
    return RobustFits(estimates, np.array([scale]))


def _all(
    form: ModelForm, curved: bool, model: ArmModel, problem: Problem, whitener: Array, freedom: float, scale: float
) -> tuple[Array, Array]:
    """As `_totals`, of all samples of a problem."""
    robust = Robust(jnp.asarray(freedom), jnp.asarray(scale))

    def part(first: int) -> tuple[Array, Array]:
        some = slice(first, first + _SLICE)
        q = problem.joint_position[some]
        own = whitener if whitener.ndim == 1 else pad(whitener[some], 0, _SLICE)
        total, squares = _slice_totals(
            form, curved, model, pad(q, 0, _SLICE), pad(problem.pose[some], 0, _SLICE),
            pad(np.ones(len(q)), 0, _SLICE), own, robust,
        )  # fmt: skip
        return np.array(total), np.asarray(squares)[: len(q)]

    parts = threads.by_parts(part, range(0, len(problem.pose), _SLICE))
    return sum(total for total, _ in parts), np.concatenate([squares for _, squares in parts])  # type: ignore
