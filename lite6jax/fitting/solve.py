"""One problem solved for several sets of training weights, by either solver, with the scale of a robust loss."""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.estimation.robust import t_scale
from lite6jax.fitting.chunks import fit_chunks, observe, pad, padded_size
from lite6jax.fitting.gauss_newton import Prior
from lite6jax.fitting.problem import Problem, whitener_of
from lite6jax.fitting.residual import Robust
from lite6jax.fitting.solution import Result
from lite6jax.model import ArmModel

Array = NDArray[np.floating]
Solver = Literal["gauss_newton", "levenberg_marquardt"]

_MAX_SCALE_UPDATES = 30
_STEPS_OF_A_SCALE = 3
"""Steps between updates of the scale, until it has settled: no solution of a scale that is wrong need be exact."""
_FEW = 1500
"""Samples up to which the compiler's optimisation takes longer than it saves, were it a hundred solves."""
_GAUSSIAN = 1e15
"""Degrees of freedom at which Student's t is Gaussian to rounding: another loss would be compiled for seconds."""
_SCALE_TOLERANCE = 1e-3
"""Relative change of the noise scale below which its updates stop."""


class Estimates(NamedTuple):
    """Estimates of one problem for several sets of training weights; the set is the first axis.

    Attributes:
        model: the estimated models.
        curvature: `(set, size, size)`, the information of data and prior; identity where held.
        squares: `(set, sample)`, squared whitened residuals.
        status: `(set,)`, as in `gauss_newton.Solved`.
        steps: `(set,)`.
    """

    model: ArmModel
    curvature: Array
    squares: Array
    status: Array
    steps: Array


class RobustFits(NamedTuple):
    """Estimates with the scale `(set,)` of their noise, in units of the covariance they were whitened with."""

    estimates: Estimates
    scale: Array

    def model(self, k: int) -> ArmModel:
        """The model of one set of training weights."""
        return jax.tree.map(lambda leaf: np.asarray(leaf[k]), self.estimates.model)


def solve(
    problem: Problem,
    free: NDArray,
    whitener: Array,
    weight: Array,
    robust: Robust | None,
    start: ArmModel,
    solver: Solver,
    max_steps: int,
) -> Estimates:
    """Solves for each row of weights `(set, sample)`.

    Args:
        problem: data, prior and form.
        free: `(size,)` bool, the parameters to estimate.
        whitener: as in `Observations`.
        weight: `(set, sample)`; zero leaves a sample out.
        robust: the loss, leaves with or without the set axis; None is least squares.
        start: leaves with or without the set axis.
        solver: which; see `fit`.
        max_steps: most steps; zero only evaluates residuals and curvature at the start.
    """
    prior = Prior(np.asarray(problem.start.geometry), problem.precision, free.astype(float))  # type: ignore[arg-type]
    if solver == "levenberg_marquardt":
        return _solve_one_by_one(problem, prior, whitener, weight, robust, start, max_steps)
    sets = len(weight)
    summary = fit_chunks(
        problem.form,
        start,
        problem.joint_position,
        np.broadcast_to(problem.pose, (sets, *problem.pose.shape)),
        weight,
        whitener if whitener.ndim == 1 else np.broadcast_to(whitener, (sets, *whitener.shape)),
        robust,
        prior,
        chunk=1,
        once=problem.exact or len(problem.pose) <= _FEW,
        max_steps=max_steps,
    )
    solved = summary.solved
    return Estimates(solved.model, solved.curvature, summary.squares, solved.status, solved.steps)  # type: ignore[arg-type]


def unweighted(freedom: float | None, sets: int) -> Robust | None:
    """Least squares of so many sets of weights, compiled as what is solved with `freedom` degrees of freedom."""
    return None if freedom is None else Robust(np.full(sets, _GAUSSIAN), np.ones(sets))  # type: ignore[arg-type]


def _solve_one_by_one(
    problem: Problem,
    prior: Prior,
    whitener: Array,
    weight: Array,
    robust: Robust | None,
    start: ArmModel,
    max_steps: int,
) -> Estimates:
    from lite6jax.fitting.levenberg_marquardt import solve_one  # optimistix takes 0.3 s to import

    size, block = padded_size(len(problem.pose))
    q, pose = pad(problem.joint_position, 0, size), pad(problem.pose, 0, size)
    padded = whitener if whitener.ndim == 1 else pad(whitener, 0, size)
    parts = []
    for k, row in enumerate(weight):
        observed = observe(
            problem.form, jnp.asarray(q), jnp.asarray(pose), jnp.asarray(pad(row, 0, size)), jnp.asarray(padded), block
        )
        own_start = ArmModel(
            *(leaf[k] if np.ndim(leaf) > ndim else leaf for leaf, ndim in zip(start, (1, 2, 2), strict=True))
        )
        own_loss = robust and Robust(*(np.broadcast_to(leaf, len(weight))[k] for leaf in robust))
        parts.append(jax.tree.map(np.asarray, solve_one(problem.form, own_start, observed, own_loss, prior, max_steps)))
    solved = jax.tree.map(lambda *leaves: np.stack(leaves), *parts)
    # optimistix does not report a singular problem: the fast solver, allowed no step, does
    free = np.asarray(prior.free) > 0
    at_solution = solve(problem, free, whitener, weight, robust, solved.model, "gauss_newton", 0)
    singular = (solved.status == Result.CONVERGED) & (at_solution.status == Result.SINGULAR)
    status = np.where(singular, Result.SINGULAR, solved.status)
    return Estimates(solved.model, at_solution.curvature, at_solution.squares, status, solved.steps)


def solve_robustly(
    problem: Problem,
    free: NDArray,
    covariance: Array,
    training: Array,
    start: ArmModel,
    solver: Solver,
    freedom: float | None,
    max_steps: int,
) -> RobustFits:
    """Alternates the solve with the estimate of the noise scale until the scale converges.

    Args:
        problem: as in `solve`, as are `free`, `start`, `solver` and `max_steps`.
        free: parameters to estimate.
        covariance: of a sample's residual, `(row, row)` or `(sample, row, row)`.
        training: `(set, sample)` weights; a sample of weight zero is held out of the scale as well.
        start: where from.
        solver: which.
        freedom: degrees of freedom of Student's t; None is least squares, solved once.
        max_steps: of each solve.
    """
    whitener, used = whitener_of(covariance), training > 0

    def scales(estimates: Estimates) -> Array:
        pairs = zip(estimates.squares, used, strict=True)
        return np.array([t_scale(squares[rows], problem.rows, freedom) for squares, rows in pairs])

    if freedom is None:
        estimates = solve(problem, free, whitener, training, None, start, solver, max_steps)
        return RobustFits(estimates, scales(estimates))
    scale = scales(
        solve(problem, free, whitener, training, unweighted(freedom, len(training)), start, "gauss_newton", 0)
    )
    steps, updates, settled = 0, 0, False
    while True:
        robust = Robust(np.full(len(scale), freedom), scale)  # type: ignore[arg-type]
        most = max_steps if settled else min(_STEPS_OF_A_SCALE, max_steps)
        estimates = solve(problem, free, whitener, training, robust, start, solver, most)
        start, steps, before, scale = estimates.model, steps + estimates.steps, scale, scales(estimates)
        updates, whole = updates + 1, settled
        settled = updates >= _MAX_SCALE_UPDATES or bool((np.abs(scale / before - 1) < _SCALE_TOLERANCE).all())
        if settled and (whole or (estimates.status == Result.CONVERGED).all()):
            return RobustFits(estimates._replace(steps=steps), scale)
