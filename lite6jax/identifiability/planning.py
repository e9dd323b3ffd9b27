"""Which poses to record of an arm, how much better they are than poses drawn at random, and how many are enough."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import jax
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.fitting.fleet import sample_within_limits
from lite6jax.identifiability.criteria import (
    CRITERIA,
    Coordinates,
    Criterion,
    determined_coordinates,
    discrimination,
    workspace,
)
from lite6jax.identifiability.design import Design, choose
from lite6jax.identifiability.identify import WORKSPACE
from lite6jax.identifiability.information import Experiment
from lite6jax.identifiability.refine import Refinement, refine
from lite6jax.identifiability.sensor import BARE

Array = NDArray[np.floating]
CriterionName = Literal["D", "A", "E", "I"]

RANDOM = 50
"""Random selections that a design is compared with, at every number of poses."""
MOST_POSES = 400
"""How far their curves go."""
_NOTHING = 1e-12
_TOLD = 1e-6
"""Share of what moves positions over the workspace that may lie in directions no candidate determines."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Poses to record.

    Attributes:
        experiment: for which model and sensor.
        joint_position: `(pose, joint)` rad, best first.
        criterion: by which they were chosen.
        design: how, among the candidates.
        candidates: how many there were.
        refinement: what moving them on gained, or None.
        accuracy: `(pose,)` m: one standard deviation of predicted positions over the workspace (root mean square, in
            3-D) after the first 1, 2, … poses; infinite where these do not determine it.
        random_accuracy: `(draw, count)` m, the same of poses drawn at random from the candidates.
        efficiency: how many times the poses of each of those draws would have to be repeated to be worth the design,
            by the criterion, `(draw,)`; infinite where they do not determine all. None where something is known or
            recorded beforehand, which is not repeated.
        needed: how many poses reach the accuracy that was wished for; None where none was, or `MOST_POSES` do not.
    """

    experiment: Experiment
    joint_position: Array
    criterion: CriterionName
    design: Design
    candidates: int
    refinement: Refinement | None
    accuracy: Array
    random_accuracy: Array
    efficiency: Array | None
    needed: int | None = None

    @property
    def count(self) -> int:
        """How many poses."""
        return len(self.joint_position)

    @property
    def random_median(self) -> Array:
        """`(count,)` m, the middle of the random draws at 1, 2, … poses."""
        return np.median(self.random_accuracy, 0)

    @property
    def worth(self) -> int | None:
        """How many random poses are as accurate as these, by the median; None where more than were drawn."""
        return _first_within(self.random_median, self.accuracy[-1])

    def poses_for(self, accuracy: float) -> int | None:
        """How many of these, in their order, reach an accuracy in m; None where all of them do not."""
        return _first_within(self.accuracy, accuracy)


def plan_poses(
    experiment: Experiment,
    candidates: ArrayLike,
    count: int,
    *,
    criterion: CriterionName = "I",
    recorded: ArrayLike | None = None,
    refined: bool = True,
    limits: ArrayLike | None = None,
    feasible: Callable[[Array], NDArray[np.bool_]] | None = None,
    accuracy: float | None = None,
    seed: int = 0,
) -> Plan:
    """Chooses the poses to record, by exchange among candidates and then by gradient between them.

    Args:
        experiment: the model and the sensor, from `plan_experiment` or `recorded`; what it knows beforehand counts.
        candidates: `(candidate, joint)` rad, those that may be chosen.
        count: how many to choose.
        criterion: D: the volume of the parameters' confidence ellipsoid; A: their mean variance (in tolerances); E:
            their worst direction; I: the mean variance of positions predicted over the workspace.
        recorded: `(sample, joint)` rad, poses that are recorded already and count.
        refined: whether to move the chosen poses on, as long as the criterion gains.
        limits: `(joint, 2)` rad, inside which they may move; the arm's where not given.
        accuracy: m, a wish: how many poses reach it is found by designs of more poses where these do not.
        feasible: which of `(sample, joint)` poses may be recorded, `(sample,)` bool; all where not given.
        seed: of the random comparison and of the workspace.

    Raises:
        InputError: as `choose`.
    """
    q = np.asarray(candidates, float)
    experiment = replace(experiment, approach="zero")  # of a candidate it is not known which pose will be before it
    rows = experiment.rows(q)
    prior = _information_there(experiment, recorded)
    over = _workspace_rows(experiment, seed)
    by = workspace(over) if criterion == "I" else CRITERIA[criterion]
    design = choose(rows, count, by, prior=prior, seed=seed)
    chosen, refinement = _refined(experiment, q[design.indices], by, prior, refined, limits, feasible)
    curve = _Curve(rows, prior, over)
    random = np.random.default_rng(seed)
    length = min(max(count, min(max(4 * count, 60), MOST_POSES)), len(q))
    draws = np.stack([random.choice(len(q), length, replace=False) for _ in range(RANDOM)])
    chosen_rows = experiment.rows(chosen)
    achieved = curve(chosen_rows)
    needed, more, reached = None, count, achieved
    while accuracy is not None:
        needed = _first_within(reached, accuracy)
        if needed is not None:
            break
        if more >= min(MOST_POSES, len(q)) or not curve.told:
            break
        more = min(2 * more, MOST_POSES, len(q))
        reached = curve(rows[choose(rows, more, by, prior=prior, seed=seed).indices])
    alone = not prior.any()
    efficiency = _efficiency(by, rows, prior, draws[:, :count], chosen_rows) if alone else None
    return Plan(
        experiment=experiment,
        joint_position=chosen,
        criterion=criterion,
        design=design,
        candidates=len(q),
        refinement=refinement,
        accuracy=achieved,
        random_accuracy=np.stack([curve(rows[draw]) for draw in draws]),
        efficiency=efficiency,
        needed=needed,
    )


@dataclass(frozen=True, eq=False)
class Separation:
    """Poses that tell two rival kinds of physics apart.

    Attributes:
        experiment: the model with both rivals.
        joint_position: `(pose, joint)` rad, best first.
        rivals: what they are called.
        both_ways: whether each is asked to pass for the other, or only the second for the first.
        design: how they were chosen.
        candidates: among how many.
        refinement: what moving them on gained, or None.
        distance: `(pose,)`, after the first 1, 2, … poses: how many standard deviations the data of one stand from
            the nearest that the other, with everything else that is unknown, can explain; NaN where too few to say.
        random_distance: `(draw,)`, the same of as many poses drawn at random from the candidates.
    """

    experiment: Experiment
    joint_position: Array
    rivals: tuple[str, str]
    both_ways: bool
    design: Design
    candidates: int
    refinement: Refinement | None
    distance: Array
    random_distance: Array

    @property
    def count(self) -> int:
        """How many poses."""
        return len(self.joint_position)


def separate_poses(
    experiment: Experiment,
    rivals: Sequence[tuple[Effect, ArrayLike]],
    candidates: ArrayLike,
    count: int,
    *,
    recorded: ArrayLike | None = None,
    refined: bool = True,
    limits: ArrayLike | None = None,
    feasible: Callable[[Array], NDArray[np.bool_]] | None = None,
    seed: int = 0,
) -> Separation:
    """Chooses the poses at which two rivals differ most, whatever the rest of the model does to hide it.

    Args:
        experiment: what is unknown beside the rivals.
        rivals: two effects, each with its hypothesised values; values that are all zero for the second ask only whether
            it could pass for the first.
        candidates, count, recorded, refined, limits, feasible, seed: as in `plan_poses`.

    Raises:
        InputError: as `choose`; the first has no size, no candidate separates them.
    """
    (one, one_values), (other, other_values) = ((e, np.asarray(v, float)) for e, v in rivals)
    if not one_values.any():
        raise InputError(f"{one.label}: has no size to look for; give a value of its parameters")
    known = replace(experiment, approach="zero")
    at = np.concatenate([experiment.values, np.zeros(one.size + other.size)])
    experiment = known.with_physics([*experiment.physics.effects, one, other], at)
    size = experiment.size
    own, others = range(size - one.size - other.size, size - other.size), range(size - other.size, size)
    typical = experiment.unit
    by = discrimination(
        size,
        list(own),
        list(others),
        one_values / typical[own],
        other_values / typical[others] if other_values.any() else None,
    )
    q = np.asarray(candidates, float)
    rows, prior = experiment.rows(q), _information_there(experiment, recorded)
    design = choose(rows, count, by, prior=prior, seed=seed)
    chosen, refinement = _refined(experiment, q[design.indices], by, prior, refined, limits, feasible)
    random = np.random.default_rng(seed)
    draws = np.stack([random.choice(len(q), count, replace=False) for _ in range(RANDOM)])
    coordinates = determined_coordinates(rows, prior)
    inside = by.within(coordinates)

    def distances(informations: Array) -> Array:
        return np.sqrt(_judged(inside, informations, np.nan))

    at_random = np.stack([_informations(rows[draw], prior, coordinates)[-1] for draw in draws])
    return Separation(
        experiment=experiment,
        joint_position=chosen,
        rivals=(one.label, other.label),
        both_ways=bool(other_values.any()),
        design=design,
        candidates=len(q),
        refinement=refinement,
        distance=distances(_informations(experiment.rows(chosen), prior, coordinates)),
        random_distance=distances(at_random),
    )


def shortest_round(joint_position: Array, first: Array | None = None) -> NDArray[np.integer]:
    """An order `(pose,)` in which an arm moves little: from each pose to the nearest, then improved two by two.

    The distance is the largest move of any joint, which is what takes the time.

    Args:
        joint_position: `(pose, joint)` rad.
        first: `(joint,)` rad, where the arm stands; all joints at 0 where not given.
    """
    q = np.asarray(joint_position, float)
    start = np.zeros(q.shape[1]) if first is None else np.asarray(first, float)
    points = np.vstack([start, q])
    distance = np.abs(points[:, None] - points[None]).max(-1)
    order, left = [0], set(range(1, len(points)))
    while left:
        order.append(min(left, key=lambda k: distance[order[-1], k]))
        left.remove(order[-1])
    tour = np.array(order)
    for _ in range(20):  # 2-opt of an open path: turn a stretch round where that shortens it
        improved = False
        for i in range(1, len(tour) - 1):
            j = np.arange(i + 1, len(tour))
            after = np.where(j + 1 < len(tour), tour[np.minimum(j + 1, len(tour) - 1)], tour[j])
            now = distance[tour[i - 1], tour[i]] + distance[tour[j], after]
            turned = distance[tour[i - 1], tour[j]] + distance[tour[i], after] * (j + 1 < len(tour))
            gain = now - turned
            best = int(np.argmax(gain))
            if gain[best] > _NOTHING:
                tour[i : j[best] + 1] = tour[i : j[best] + 1][::-1]
                improved = True
        if not improved:
            break
    return tour[1:] - 1


def _first_within(curve: Array, accuracy: float) -> int | None:
    """After how many poses a curve is as low as that; None where it never is."""
    enough = np.flatnonzero(curve <= accuracy)
    return int(enough[0]) + 1 if len(enough) else None


def _information_there(experiment: Experiment, recorded: ArrayLike | None) -> Array:
    """What is known beforehand, and by poses that are recorded already."""
    if recorded is None or not len(np.asarray(recorded)):
        return experiment.prior
    return replace(experiment, approach="sequence").information(recorded)


def _refined(
    experiment: Experiment,
    chosen: Array,
    by: Criterion,
    prior: Array,
    asked: bool,
    limits: ArrayLike | None,
    feasible: Callable[[Array], NDArray[np.bool_]] | None,
) -> tuple[Array, Refinement | None]:
    if not asked:
        return chosen, None
    within = experiment.arm.joint_limits if limits is None else limits
    moved = refine(chosen, experiment.traced_rows, by, within, prior=prior, feasible=feasible)
    return moved.joint_position, moved


def _informations(rows: Array, prior: Array, coordinates: Coordinates) -> Array:
    """The information of the first 1, 2, … poses and the prior, in coordinates, `(pose, k, k)`."""
    T = coordinates.outward
    J = rows @ T
    return T.T @ prior @ T + np.cumsum(np.einsum("nri,nrj->nij", J, J), 0)


class _Curve:
    """The accuracy over a workspace after the first 1, 2, … of some poses."""

    def __init__(self, rows: Array, prior: Array, over: Array) -> None:
        self.coordinates, self.prior = determined_coordinates(rows, prior), prior
        flat = over.reshape(-1, over.shape[2])
        basis = np.linalg.qr(self.coordinates.outward)[0]
        lost = np.linalg.norm(flat - flat @ basis @ basis.T)
        self.told = bool(lost <= _TOLD * np.linalg.norm(flat))
        flat = flat @ self.coordinates.outward
        self.weight = flat.T @ flat / len(over)

    def __call__(self, rows: Array) -> Array:
        eigenvalues, V = np.linalg.eigh(_informations(rows, self.prior, self.coordinates))
        told = (eigenvalues[:, 0] > _NOTHING * eigenvalues[:, -1]) & self.told
        spread = np.einsum("nij,ik,nkj->nj", V, self.weight, V) / np.where(told[:, None], eigenvalues, 1.0)
        return np.where(told, np.sqrt(spread.sum(1)), np.inf)


def _workspace_rows(experiment: Experiment, seed: int) -> Array:
    """`(pose, 3, size)`: how predicted positions move with the parameters, m per tolerance."""
    q = sample_within_limits(experiment.arm, WORKSPACE, seed + 1)
    return experiment.with_sensor(BARE).rows(q)[:, :3]


def _efficiency(by: Criterion, rows: Array, prior: Array, draws: NDArray[np.integer], chosen: Array) -> Array:
    """Of the chosen poses against each draw of as many, by the criterion."""
    coordinates = determined_coordinates(rows, prior)
    inside, rank = by.within(coordinates), coordinates.outward.shape[1]

    ends = [_informations(some, prior, coordinates)[-1] for some in (chosen, *(rows[draw] for draw in draws))]
    reached, *others = _judged(inside, np.stack(ends), -np.inf)
    # a draw that does not determine all is worth nothing, however often it is repeated
    return np.array([
        by.efficiency(float(reached), float(value), rank) if np.isfinite(value) else np.inf for value in others
    ])  # fmt: skip


def _judged(criterion: Criterion, informations: Array, otherwise: float) -> Array:
    """The criterion of each information matrix that determines all directions, in its own coordinates."""
    told = np.linalg.cond(informations) < 1 / _NOTHING
    safe = np.where(told[:, None, None], informations, np.eye(informations.shape[1]))
    return np.where(told, np.asarray(_values(criterion, safe)), otherwise)


@jax.jit
def _values(criterion: Criterion, informations: jax.Array) -> jax.Array:
    # one after the other: batched LAPACK calls that do not depend on each other can wait for each other for ever
    return jax.lax.map(criterion.value, informations)
