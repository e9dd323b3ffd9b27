"""Refinement of chosen poses by gradient ascent of a criterion, within limits and filters."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike, NDArray

from lite6jax.design.criteria import Criterion, checked_rows, coordinates_of, determined_value
from lite6jax.errors import InputError

_FIRST_STEP, _LONGEST_STEP, _LAST_STEP = 0.02, 0.3, 1e-6  # rad


@final
@dataclass(frozen=True, eq=False)
class Refinement:
    """Poses moved to where the criterion is better.

    Attributes:
        joint_position: `(pose, joint)` rad, in the order given.
        value: the criterion.
        start_value: of the poses given.
        values: `(iteration,)`, the best so far.
    """

    joint_position: NDArray[np.floating]
    value: float
    start_value: float
    values: NDArray[np.floating]


def refine(
    joint_position: ArrayLike,
    rows_of: Callable[[Array], Array],
    criterion: Criterion,
    limits: ArrayLike,
    prior: ArrayLike | None = None,
    feasible: Callable[[NDArray[np.floating]], NDArray[np.bool_]] | None = None,
    iterations: int = 60,
) -> Refinement:
    """Moves poses uphill in the criterion, inside the limits, and never to worse.

    Resilient propagation (M. Riedmiller, H. Braun, 1993): each joint of each pose has a step of its own, which grows
    while its gradient keeps its sign and shrinks where it turns, so that no scale has to be known. A pose that would
    leave the limits stops at them; one that would become infeasible stays, with smaller steps from then on. Steps that
    together do not improve are halved.

    Args:
        joint_position: `(pose, joint)` rad, inside the limits and feasible; they must determine what is to be judged.
        rows_of: traceable, `(sample, joint)` rad to `(sample, row, parameter)` as `choose` takes them.
        criterion: by what they are judged.
        limits: `(joint, 2)` rad.
        prior: as for `choose`.
        feasible: `(sample, joint)` to `(sample,)` bool.
        iterations: how often all rows are evaluated with their gradient.

    Raises:
        InputError: wrong shapes, a pose outside the limits or infeasible, or what `determined_coordinates` and the
            criterion refuse.
    """
    q, bounds = np.array(joint_position, float), np.asarray(limits, float)
    if q.ndim != 2 or len(q) == 0 or bounds.shape != (q.shape[1], 2):
        raise InputError(f"poses of shape {q.shape} and limits {bounds.shape}: give (pose, joint) and (joint, 2)")
    lower, upper = bounds.T
    outside = ((q < lower) | (q > upper)).any(1)
    if outside.any():
        raise InputError(f"pose {int(np.argmax(outside))}: outside the limits; move it inside first")
    if feasible is not None and not feasible(q).all():
        raise InputError(f"pose {int(np.argmin(feasible(q)))}: not feasible; leave it out or loosen the filters")
    rows, P = checked_rows(np.asarray(jax.jit(rows_of)(jnp.asarray(q))), prior)
    coordinates = coordinates_of(P + np.einsum("nri,nrj->ij", rows, rows), len(rows))
    outward = jnp.asarray(coordinates.outward)
    base = outward.T @ P @ outward
    criterion = criterion.within(coordinates)

    def judged(q: Array) -> tuple[Array, Array]:
        flat = rows_of(q).reshape(-1, outward.shape[0]) @ outward
        M = base + flat.T @ flat
        return criterion.smooth(M), determined_value(criterion, M)

    judge = jax.jit(jax.value_and_grad(judged, has_aux=True))
    (height, value), gradient = (jax.tree.map(np.asarray, part) for part in judge(q))
    best, best_value = q, float(value)
    start_value, history = best_value, []
    step, last = np.full(q.shape, _FIRST_STEP), np.zeros(q.shape)
    for _ in range(iterations):
        agreement = np.sign(gradient) * last
        step = np.clip(
            np.where(agreement > 0, 1.2 * step, np.where(agreement < 0, 0.5 * step, step)), 0.0, _LONGEST_STEP
        )
        last = np.where(agreement < 0, 0.0, np.sign(gradient))
        trial = np.clip(q + step * last, lower, upper)
        if feasible is not None:
            barred = ~feasible(trial)
            trial[barred] = q[barred]
            step[barred] *= 0.5
        (reached, value), ahead = (jax.tree.map(np.asarray, part) for part in judge(trial))
        if reached > height:
            q, height, gradient = trial, reached, ahead
            if value > best_value:
                best, best_value = q, float(value)
        else:
            step, last = 0.5 * step, np.zeros(q.shape)
        history.append(best_value)
        if step.max() < _LAST_STEP:
            break
    return Refinement(best, best_value, start_value, np.array(history))
