"""Which poses to record of an arm: to identify its parameters, or to discriminate between two models of its physics.

Poses are chosen by exchange among candidates, compared with as many drawn at random, and put into an order in which the
arm moves little.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.calibration.start import sample_within_limits
from lite6jax.design.identify import WORKSPACE
from lite6jax.design.information import Experiment
from lite6jax.design.selection import Criterion, Design, Pool, accuracy_criterion, choose
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.results import PublicResult

Array = NDArray[np.floating]
CriterionName = Literal["D", "A", "I"]

MOST_POSES = 400
"""The largest number of poses that designs and random selections are compared at."""
_RANDOM_DRAWS = 50
"""Random selections of as many poses that a design is compared with."""
_ROUNDING = 1e-12
"""rad: a shorter route by less than this is rounding."""


@dataclass(frozen=True, eq=False, repr=False)
class _Chosen:
    """Poses to record.

    Attributes:
        experiment: for which model and sensor.
        joint_position: `(pose, joint)` rad, best first.
        design: how they were chosen among the candidates.
        candidates: how many there were.
    """

    experiment: Experiment
    joint_position: Array
    design: Design
    candidates: int

    @property
    def count(self) -> int:
        """How many poses."""
        return len(self.joint_position)


@final
@dataclass(frozen=True, eq=False, repr=False)
class Plan(_Chosen, PublicResult):
    """Poses that determine an arm's parameters best.

    Attributes:
        experiment, joint_position, design, candidates: as of every design.
        criterion: by which they were chosen.
        accuracy: `(pose,)` m: one standard deviation of predicted positions over the workspace (root mean square, in
            3-D) after the first 1, 2, … poses; infinite where these do not determine it.
        random_accuracy: `(draw, count)` m, the same of poses drawn at random from the candidates.
        needed: how many poses reach the accuracy given; None where none was given, or `MOST_POSES` do not reach it.
    """

    criterion: CriterionName
    accuracy: Array
    random_accuracy: Array
    needed: int | None = None

    @property
    def random_median(self) -> Array:
        """`(count,)` m, the middle of the random draws at 1, 2, … poses."""
        return np.median(self.random_accuracy, 0)

    @property
    def worth(self) -> int | None:
        """How many random poses are as accurate as these, by the median; None where more than were drawn."""
        return _first_within(self.random_median, self.accuracy[-1])


@final
@dataclass(frozen=True, eq=False, repr=False)
class DiscriminationPlan(_Chosen, PublicResult):
    """Poses that discriminate between two rival models of the physics.

    Attributes:
        experiment, joint_position, design, candidates: as of every design; the experiment has both effects.
        rivals: the labels of the two effects.
        distance: `(pose,)`, after the first 1, 2, … poses: how many standard deviations the readings with the first
            effect are from the closest that the other, with everything else that is unknown, explains; NaN where these
            poses do not determine the parameters.
        random_distance: `(draw,)`, the same of as many poses drawn at random from the candidates.
    """

    rivals: tuple[str, str]
    distance: Array
    random_distance: Array


def plan_poses(
    experiment: Experiment,
    candidates: ArrayLike,
    count: int,
    *,
    criterion: CriterionName = "I",
    recorded: ArrayLike | None = None,
    accuracy: float | None = None,
    seed: int = 0,
) -> Plan:
    """Chooses the poses to record, by exchange among candidates.

    Args:
        experiment: the model and the sensor, as `plan_experiment` makes it; what it knows beforehand counts.
        candidates: `(candidate, joint)` rad, those that may be chosen.
        count: how many to choose.
        criterion: D: the volume of the parameters' confidence ellipsoid; A: their mean variance (in tolerances); I: the
            mean variance of positions predicted over the workspace.
        recorded: `(sample, joint)` rad, poses that are recorded already and count.
        accuracy: m, a target: how many poses reach it is found by designs of more poses where these do not.
        seed: of the random comparison and of the workspace.

    Raises:
        InputError: more poses than candidates, too few for the parameters, or a workspace whose errors the criterion I
            cannot judge.
    """
    q = np.asarray(candidates, float)
    experiment = replace(experiment, approach="zero")  # which pose precedes a candidate is not known
    prior = _prior_information(experiment, recorded)
    pool = Pool(experiment.rows(q), prior)
    anywhere = sample_within_limits(experiment.arm, WORKSPACE, seed + 1)
    error = accuracy_criterion(experiment.error_rows(anywhere)[:, :3])  # m per tolerance
    by = pool.average() if criterion == "A" else pool.apply(Criterion() if criterion == "D" else error)
    design = choose(pool, count, by)
    try:
        judged = pool.apply(error)
    except InputError:  # positions depend on what no candidate determines
        judged = None

    def curve(indices: NDArray[np.integer]) -> Array:
        """The accuracy after the first 1, 2, … of some candidates."""
        if judged is None:
            return np.full(len(indices), np.inf)
        return np.sqrt(-judged.value(pool.accumulate(pool.rows[indices])))

    achieved = reached = curve(design.indices)
    needed, more = None, count
    while accuracy is not None:
        needed = _first_within(reached, accuracy)
        if needed is not None or more >= min(MOST_POSES, len(q)) or judged is None:
            break
        more = min(2 * more, MOST_POSES, len(q))
        reached = curve(choose(pool, more, by).indices)
    draws = _random_draws(len(q), min(max(count, min(max(4 * count, 60), MOST_POSES)), len(q)), seed)
    return Plan(
        experiment=experiment,
        joint_position=q[design.indices],
        design=design,
        candidates=len(q),
        criterion=criterion,
        accuracy=achieved,
        random_accuracy=np.stack([curve(draw) for draw in draws]),
        needed=needed,
    )


def plan_discrimination(
    experiment: Experiment,
    rivals: tuple[tuple[Effect, ArrayLike], Effect],
    candidates: ArrayLike,
    count: int,
    *,
    recorded: ArrayLike | None = None,
    seed: int = 0,
) -> DiscriminationPlan:
    """Chooses the poses at which two rival models differ most after everything else that is unknown is refitted.

    The criterion is T-optimality (A. Atkinson, V. Fedorov, Biometrika 62, 1975), linearised: with one number for the
    first effect at its hypothesised size and all numbers of the other unknown, the distance is one over the standard
    deviation of that number.

    Args:
        experiment: what is unknown beside the two effects.
        rivals: the first effect with its hypothesised values in SI units, and the effect that might explain it.
        candidates, count, recorded, seed: as in `plan_poses`.

    Raises:
        InputError: as `plan_poses`; the first has no size, or no candidate separates them.
    """
    (one, values), other = rivals
    values = np.asarray(values, float)
    if not values.any():
        raise InputError(f"{one.label}: has no size; give a value of its parameters")
    at = np.concatenate([experiment.values, np.zeros(one.size + other.size)])
    experiment = replace(experiment, approach="zero").with_physics([*experiment.physics.effects, one, other], at)
    first = experiment.size - one.size - other.size
    own = slice(first, first + one.size)
    scaled = np.delete(np.eye(experiment.size), np.arange(first + 1, first + one.size), axis=1)
    scaled[own, first] = values / experiment.unit[own]
    q = np.asarray(candidates, float)
    prior = scaled.T @ _prior_information(experiment, recorded) @ scaled
    pool = Pool(experiment.rows(q) @ scaled, prior)
    by = pool.apply(
        Criterion(
            np.diag((np.arange(len(prior)) == first).astype(float)),
            confounded="criterion T: no candidate separates the rivals: what one model predicts the other explains;"
            " give other candidates, another sensor, or fewer free parameters",
        )
    )
    design = choose(pool, count, by)

    def distances(indices: NDArray[np.integer]) -> Array:
        variances = -by.value(pool.accumulate(pool.rows[indices]))
        return 1 / np.sqrt(np.where(np.isfinite(variances), variances, np.nan))

    return DiscriminationPlan(
        experiment=experiment,
        joint_position=q[design.indices],
        design=design,
        candidates=len(q),
        rivals=(one.label, other.label),
        distance=distances(design.indices),
        random_distance=np.array([distances(draw)[-1] for draw in _random_draws(len(q), count, seed)]),
    )


def _first_within(curve: Array, accuracy: float) -> int | None:
    """After how many poses a curve is as low as that; None where it never is."""
    enough = np.flatnonzero(curve <= accuracy)
    return int(enough[0]) + 1 if len(enough) else None


def _prior_information(experiment: Experiment, recorded: ArrayLike | None) -> Array:
    """The information of the prior and of poses that are recorded already, `(parameter, parameter)`."""
    if recorded is None or not len(np.asarray(recorded)):
        return experiment.prior
    R = replace(experiment, approach="sequence").root(recorded)
    return R.T @ R + experiment.prior


def _random_draws(candidates: int, count: int, seed: int) -> Sequence[NDArray[np.integer]]:
    """`count` candidates drawn at random, `_RANDOM_DRAWS` times."""
    random = np.random.default_rng(seed)
    return [random.choice(candidates, count, replace=False) for _ in range(_RANDOM_DRAWS)]


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
    tour, improved = np.array(order), True
    while improved:  # 2-opt of an open path: turn a stretch round where that shortens it
        improved = False
        for i in range(1, len(tour) - 1):
            ends, ahead = tour[i + 1 :], np.append(tour[i + 2 :], -1)
            gain = distance[tour[i - 1], tour[i]] - distance[tour[i - 1], ends]
            gain = gain + np.where(ahead < 0, 0.0, distance[ends, ahead] - distance[tour[i], ahead])
            best = int(np.argmax(gain))
            if gain[best] > _ROUNDING:
                tour[i : i + 2 + best] = tour[i : i + 2 + best][::-1]
                improved = True
    return tour[1:] - 1
