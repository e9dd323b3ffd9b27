"""Which poses to record of an arm: to identify its parameters, or to discriminate between two models of its physics.

Poses are chosen by exchange among candidates and moved on by gradient between them. They are compared with as many
drawn at random, and put into an order in which the arm moves little.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.calibration.start import sample_within_limits
from lite6jax.design.criteria import CRITERIA, Criterion, discrimination, evaluate_each, workspace
from lite6jax.design.identify import WORKSPACE
from lite6jax.design.information import Experiment
from lite6jax.design.selection import Design, Pool, Refinement, choose, refine
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.results import PublicResult

Array = NDArray[np.floating]
CriterionName = Literal["D", "A", "E", "I"]
Feasible = Callable[[Array], NDArray[np.bool_]]

MOST_POSES = 400
"""The largest number of poses that designs and random selections are compared at."""
_RANDOM_DRAWS = 50
"""Random selections of as many poses that a design is compared with."""
_ROUNDING = 1e-12
"""rad: a shorter route by less than this is rounding."""


@final
@dataclass(frozen=True, eq=False, repr=False)
class Plan(PublicResult):
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
        needed: how many poses reach the accuracy given; None where none was given, or `MOST_POSES` do not reach it.
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


def plan_poses(
    experiment: Experiment,
    candidates: ArrayLike,
    count: int,
    *,
    criterion: CriterionName = "I",
    recorded: ArrayLike | None = None,
    refined: bool = True,
    limits: ArrayLike | None = None,
    feasible: Feasible | None = None,
    accuracy: float | None = None,
    seed: int = 0,
) -> Plan:
    """Chooses the poses to record, by exchange among candidates and then by gradient between them.

    Args:
        experiment: the model and the sensor, as `plan_experiment` makes it; what it knows beforehand counts.
        candidates: `(candidate, joint)` rad, those that may be chosen.
        count: how many to choose.
        criterion: D: the volume of the parameters' confidence ellipsoid; A: their mean variance (in tolerances); E:
            their worst direction; I: the mean variance of positions predicted over the workspace.
        recorded: `(sample, joint)` rad, poses that are recorded already and count.
        refined: whether to move the chosen poses on, as long as the criterion gains.
        limits: `(joint, 2)` rad, inside which they may move; the arm's where not given.
        accuracy: m, a target: how many poses reach it is found by designs of more poses where these do not.
        feasible: which of `(sample, joint)` rad may be recorded, `(sample,)` bool; all where not given.
        seed: of the random comparison and of the workspace.

    Raises:
        InputError: more poses than candidates, too few for the parameters, a pose outside the limits or not feasible,
            or a workspace whose errors the criterion I cannot judge.
    """
    q = np.asarray(candidates, float)
    experiment = replace(experiment, approach="zero")  # which pose precedes a candidate is not known
    prior = _prior_information(experiment, recorded)
    rows = experiment.rows(q)
    pool = Pool(rows, prior)
    anywhere = sample_within_limits(experiment.arm, WORKSPACE, seed + 1)
    error = workspace(experiment.error_rows(anywhere)[:, :3])  # m per tolerance
    by = error if criterion == "I" else CRITERIA[criterion]
    start = None
    if experiment.own:  # one reading of a place tells nothing but the place: as if others had told that
        start = choose(Pool(experiment.outside_places(rows), prior), count, by).indices
    design = choose(pool, count, by, start)
    chosen, refinement, rows = _refine_chosen(experiment, q[design.indices], pool, by, prior, refined, limits, feasible)
    try:
        judged = error.within(pool.coordinates)
    except InputError:  # positions depend on what no candidate determines
        judged = None

    def curve(rows: Array) -> Array:
        """The accuracy after the first 1, 2, … of some poses, by their rows in coordinates."""
        if judged is None:
            return np.full(len(rows), np.inf)
        return np.sqrt(-np.asarray(evaluate_each(judged, pool.accumulated(rows))))

    achieved = curve(rows)
    needed, more, reached = None, count, achieved
    while accuracy is not None:
        needed = _first_within(reached, accuracy)
        if needed is not None or more >= min(MOST_POSES, len(q)) or judged is None:
            break
        more = min(2 * more, MOST_POSES, len(q))
        reached = curve(pool.rows[choose(pool, more, by).indices])
    draws = _random_draws(len(q), min(max(count, min(max(4 * count, 60), MOST_POSES)), len(q)), seed)
    efficiency = None
    if not prior.any():
        inside, rank = by.within(pool.coordinates), design.rank
        ends = [pool.accumulated(some)[-1] for some in (rows, *(pool.rows[draw[:count]] for draw in draws))]
        own, *others = np.asarray(evaluate_each(inside, np.stack(ends))).tolist()
        # a draw that does not determine all parameters does not reach the design, however often it is repeated
        efficiency = np.array([by.efficiency(own, value, rank) if np.isfinite(value) else np.inf for value in others])
    return Plan(
        experiment=experiment,
        joint_position=chosen,
        criterion=criterion,
        design=design,
        candidates=len(q),
        refinement=refinement,
        accuracy=achieved,
        random_accuracy=np.stack([curve(pool.rows[draw]) for draw in draws]),
        efficiency=efficiency,
        needed=needed,
    )


@final
@dataclass(frozen=True, eq=False, repr=False)
class DiscriminationPlan(PublicResult):
    """Poses that discriminate between two rival models of the physics.

    Attributes:
        experiment: the model with both effects.
        joint_position: `(pose, joint)` rad, best first.
        rivals: the labels of the two effects.
        both_ways: whether each is tested against the other, or only the second against the first.
        design: how they were chosen.
        candidates: among how many.
        refinement: what moving them on gained, or None.
        distance: `(pose,)`, after the first 1, 2, … poses: how many standard deviations the readings of one model
            are from the closest that the other, with everything else that is unknown, explains; NaN where these poses
            do not determine the parameters.
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


def plan_discrimination(
    experiment: Experiment,
    rivals: Sequence[tuple[Effect, ArrayLike]],
    candidates: ArrayLike,
    count: int,
    *,
    recorded: ArrayLike | None = None,
    refined: bool = True,
    limits: ArrayLike | None = None,
    feasible: Feasible | None = None,
    seed: int = 0,
) -> DiscriminationPlan:
    """Chooses the poses at which two rival models differ most after everything else that is unknown is refitted.

    The criterion is T-optimality (A. Atkinson, V. Fedorov, Biometrika 62, 1975), linearised.

    Args:
        experiment: what is unknown beside the two effects.
        rivals: two effects, each with its hypothesised values in SI units; values that are all zero for the second
            test it against the first only.
        candidates, count, recorded, refined, limits, feasible, seed: as in `plan_poses`.

    Raises:
        InputError: as `plan_poses`; the first has no size, or no candidate separates them.
    """
    (one, one_values), (other, other_values) = ((e, np.asarray(v, float)) for e, v in rivals)
    if not one_values.any():
        raise InputError(f"{one.label}: has no size; give a value of its parameters")
    at = np.concatenate([experiment.values, np.zeros(one.size + other.size)])
    experiment = replace(experiment, approach="zero").with_physics([*experiment.physics.effects, one, other], at)
    first, second = experiment.size - one.size - other.size, experiment.size - other.size
    own, others = np.arange(first, second), np.arange(second, experiment.size)
    by = discrimination(experiment.unit, (own, one_values), (others, other_values))
    q = np.asarray(candidates, float)
    prior = _prior_information(experiment, recorded)
    pool = Pool(experiment.rows(q), prior)
    design = choose(pool, count, by)
    chosen, refinement, rows = _refine_chosen(experiment, q[design.indices], pool, by, prior, refined, limits, feasible)
    inside = by.within(pool.coordinates)

    def distances(informations: Array) -> Array:
        squares = np.asarray(evaluate_each(inside, informations))
        return np.sqrt(np.where(np.isfinite(squares), squares, np.nan))

    draws = _random_draws(len(q), count, seed)
    return DiscriminationPlan(
        experiment=experiment,
        joint_position=chosen,
        rivals=(one.label, other.label),
        both_ways=bool(other_values.any()),
        design=design,
        candidates=len(q),
        refinement=refinement,
        distance=distances(pool.accumulated(rows)),
        random_distance=distances(np.stack([pool.accumulated(pool.rows[draw])[-1] for draw in draws])),
    )


def _first_within(curve: Array, accuracy: float) -> int | None:
    """After how many poses a curve is as low as that; None where it never is."""
    enough = np.flatnonzero(curve <= accuracy)
    return int(enough[0]) + 1 if len(enough) else None


def _prior_information(experiment: Experiment, recorded: ArrayLike | None) -> Array:
    """The information of the prior and of poses that are recorded already, `(parameter, parameter)`."""
    if recorded is None or not len(np.asarray(recorded)):
        return experiment.prior
    return replace(experiment, approach="sequence").information(recorded)


def _refine_chosen(
    experiment: Experiment,
    chosen: Array,
    pool: Pool,
    by: Criterion,
    prior: Array,
    move: bool,
    limits: ArrayLike | None,
    feasible: Feasible | None,
) -> tuple[Array, Refinement | None, Array]:
    """Chosen poses, moved by gradient if `move`, what that gained, and their rows in the pool's coordinates."""
    moved = None
    if move:
        within = experiment.arm.joint_limits if limits is None else limits
        moved = refine(chosen, experiment.traceable_rows, by, within, prior=prior, feasible=feasible)
        chosen = moved.joint_position
    return chosen, moved, pool.inside(experiment.rows(chosen))


def _random_draws(candidates: int, count: int, seed: int) -> NDArray[np.integer]:
    """`(draw, count)` candidates drawn at random."""
    random = np.random.default_rng(seed)
    return np.stack([random.choice(candidates, count, replace=False) for _ in range(_RANDOM_DRAWS)])


def shortest_round(joint_position: Array) -> NDArray[np.integer]:
    """An order `(pose,)` in which an arm moves little from where all joints are at zero through `(pose, joint)` rad.

    From each pose to the nearest, then improved two by two. The distance is the largest move of any joint, which is
    what takes the time.
    """
    points = np.vstack([np.zeros(joint_position.shape[1]), joint_position])
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
            if gain[best] > _ROUNDING:
                tour[i : j[best] + 1] = tour[i : j[best] + 1][::-1]
                improved = True
        if not improved:
            break
    return tour[1:] - 1
