"""What chosen poses are worth: the information of the first 1, 2, … of them, and a criterion of it."""

from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.design.criteria import Coordinates, Criterion
from lite6jax.design.information import Experiment
from lite6jax.design.refine import Refinement, refine

Array = NDArray[np.floating]

RANDOM_DRAWS = 50
"""Random selections of as many poses that a design is compared with."""
SINGULAR = 1e-12
"""Smallest over largest eigenvalue of an information matrix, below which it does not determine all parameters."""


def known_information(experiment: Experiment, recorded: ArrayLike | None) -> Array:
    """The information of the prior and of poses that are recorded already, `(parameter, parameter)`."""
    if recorded is None or not len(np.asarray(recorded)):
        return experiment.prior
    return replace(experiment, approach="sequence").information(recorded)


def refined_poses(
    experiment: Experiment,
    chosen: Array,
    by: Criterion,
    prior: Array,
    move: bool,
    limits: ArrayLike | None,
    feasible: Callable[[Array], NDArray[np.bool_]] | None,
) -> tuple[Array, Refinement | None]:
    """Chosen poses `(pose, joint)` rad, moved by gradient between the candidates if `move`, and what that gained."""
    if not move:
        return chosen, None
    within = experiment.arm.joint_limits if limits is None else limits
    moved = refine(chosen, experiment.traced_rows, by, within, prior=prior, feasible=feasible)
    return moved.joint_position, moved


def cumulative_information(rows: Array, prior: Array, coordinates: Coordinates) -> Array:
    """The information of the first 1, 2, … poses and the prior, in coordinates, `(pose, k, k)`."""
    T = coordinates.outward
    J = rows @ T
    return T.T @ prior @ T + np.cumsum(np.einsum("nri,nrj->nij", J, J), 0)


def criterion_values(criterion: Criterion, informations: Array, otherwise: float) -> Array:
    """The criterion of each information matrix that determines all directions, in its own coordinates."""
    determined = np.linalg.cond(informations) < 1 / SINGULAR
    safe = np.where(determined[:, None, None], informations, np.eye(informations.shape[1]))
    return np.where(determined, np.asarray(_values(criterion, safe)), otherwise)


@jax.jit
def _values(criterion: Criterion, informations: jax.Array) -> jax.Array:
    # one after the other: batched LAPACK calls that do not depend on each other can wait for each other for ever
    return jax.lax.map(criterion.value, informations)
