"""Which poses to record of an arm: to identify its parameters, or to discriminate between two models of its physics.

A design is built greedily from candidates and improved by exchange: each pose in turn is taken out and the best
candidate put in, until none improves (V. Fedorov, 1972, in the cyclic order of R. Cook and C. Nachtsheim, Technometrics
22, 1980). With M the information of the other poses, C = M⁻¹ and S = I + J C Jᵀ, a pose with whitened rows J adds

    log det S                 to log det M         (D; the matrix determinant lemma),
    tr(S⁻¹ J C W C Jᵀ)        to −tr(W C)          (A, I, T; Sherman, Morrison and Woodbury).

A design is compared with as many poses drawn at random, and put into an order in which the arm moves little.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.array_types import Array, Integers
from lite6jax.calibration.start import sample_within_limits
from lite6jax.design.identify import WORKSPACE
from lite6jax.design.information import Experiment
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.results import PublicResult

_OBSERVABLE = 1e-20
"""A parameter's information over the largest, under which no candidate depends on it."""
_DETERMINED = 1e-10
"""An eigenvalue of the information (columns of unit size) over the largest, above which a direction is determined."""
_DESIGN_DETERMINES = 1e-12
"""The same of a design's information, whose poses are few."""
_LOST = 1e-9
"""What share of a weight may lie in directions that nothing determines; rounding leaves 1e-12."""
_RIDGE = 1e-7
"""Of a candidate's mean information: keeps M invertible while poses are few; what is reported is without it."""
_FOREMOST = 1500
"""How many of the candidates an exchange looks at until the foremost are chosen anew; in the end none improves."""
_TOGETHER = 5
"""Poses built between two such choices."""
_CYCLES = 60
"""The most times that the exchange goes through all poses."""
_IMPROVES = 1e-9
_BLOCK = 4096
"""Candidates that are ranked together, within a core's cache."""


@final
@dataclass(frozen=True, eq=False)
class Criterion:
    """What makes one information matrix M better than another; the higher, the better.

    Attributes:
        weight: W `(parameter, parameter)` of −tr(W M⁻¹), minus a weighted sum of variances (H. Chernoff, Ann. Math.
            Stat. 24, 1953): the identity of A-optimality, the mean information Σ JᵀJ / count of the errors that matter
            of I-optimality. None is D-optimality, log det M (A. Wald, 1943).
        confounded: what is said where `weight` has a direction that neither data nor prior determine.
    """

    weight: Array | None = None
    confounded: str = "criterion: a direction of its weight is determined by no candidate; give others"

    def value(self, M: Array) -> Array:
        """The criterion of matrices `(…, k, k)`; −inf where one does not determine all directions."""
        sizes = np.linalg.eigvalsh(M)
        determined = sizes[..., 0] > _DESIGN_DETERMINES * sizes[..., -1]
        M = np.where(determined[..., None, None], M, np.eye(M.shape[-1]))
        value = np.linalg.slogdet(M)[1] if self.weight is None else -np.sum(self.weight * np.linalg.inv(M), (-2, -1))
        return np.where(determined, value, -np.inf)

    def gains(self, rows: Array, M: Array) -> Array:
        """What each pose `(pose, row, k)` adds to the criterion of M, `(pose,)`."""
        C = np.linalg.inv(M)
        S = np.eye(rows.shape[1]) + _products(rows, C)
        if self.weight is None:
            return np.linalg.slogdet(S)[1]
        return np.sum(np.linalg.inv(S) * _products(rows, C @ self.weight @ C), (1, 2))

    def approximate_gains(self, rows: Array, M: Array) -> Array:
        """As `gains`, with each row of a pose by itself: exact for a single row, and fast."""
        C = np.linalg.inv(M)
        weighted = None if self.weight is None else C @ self.weight @ C

        def gains(flat: Array) -> Array:
            leverage = np.einsum("nk,nk->n", flat @ C, flat)
            if weighted is None:
                return np.log1p(leverage)
            return np.einsum("nk,nk->n", flat @ weighted, flat) / (1 + leverage)

        blocks = (rows[first : first + _BLOCK] for first in range(0, len(rows), _BLOCK))
        return np.concatenate([gains(block.reshape(-1, len(M))).reshape(len(block), -1).sum(1) for block in blocks])


def _products(J: Array, C: Array) -> Array:
    """J C Jᵀ of each pose `(pose, row, k)`."""
    flat = J.reshape(-1, J.shape[2]) @ C
    return np.einsum("nrk,nsk->nrs", flat.reshape(J.shape), J)


def accuracy_criterion(rows: Array) -> Criterion:
    """I-optimality: minus the mean variance of the errors `(pose, row, parameter)` summed over their rows."""
    flat = rows.reshape(-1, rows.shape[2])
    return Criterion(
        flat.T @ flat / len(rows),
        confounded="criterion I: the workspace's error has directions that no candidate determines; give a prior for"
        " them, a sensor that observes them, or leave these errors out",
    )


@final
class Pool:
    """The candidates of a design, in coordinates of the directions that they and a prior determine.

    Attributes:
        outward: `(parameter, k)`, parameters of coordinates, so scaled that the mean information is the identity.
        rows: `(candidate, row, k)` whitened.
        base: `(k, k)` information of the prior.
    """

    def __init__(self, rows: ArrayLike, prior: ArrayLike | None = None) -> None:
        """Takes the candidates.

        Args:
            rows: `(candidate, row, parameter)`, whitened, columns scaled to be comparable (m and rad are not): A
                depends on the scale. Directions that no candidate determines are left out of the criterion.
            prior: `(parameter, parameter)`, information that is there already: a prior, or poses that are recorded.

        Raises:
            InputError: a number that is not finite, or nothing determined.
        """
        J = np.asarray(rows, np.float64)
        if not np.isfinite(np.sum(J)) and not np.isfinite(J).all():
            worst = int(np.argmin(np.isfinite(J).all((1, 2))))
            raise InputError(f"rows of candidate {worst} have a number that is not finite; leave it out")
        flat = J.reshape(-1, J.shape[2])
        P = np.zeros((flat.shape[1],) * 2) if prior is None else np.asarray(prior, np.float64)
        information = P + flat.T @ flat
        squares = np.diagonal(information)
        if not squares.any():
            raise InputError("rows: all zero; no candidate depends on any parameter")
        observable = squares > _OBSERVABLE * squares.max()  # the others are rounding, which must not be scaled up
        self._unit = np.sqrt(np.where(observable, squares, squares.max()))
        sizes, V = np.linalg.eigh(information / self._unit[:, None] / self._unit)
        determined = sizes > _DETERMINED * sizes[-1]
        self._basis = V[:, determined]
        scale = np.sqrt(sizes[determined] / len(J))
        # in the parameters' own units the undetermined directions are orthogonal to these
        Q, _ = np.linalg.qr(self._basis * self._unit[:, None])
        self.outward = Q @ (Q.T @ (self._basis / self._unit[:, None] / scale))
        self.base = self.outward.T @ P @ self.outward
        self.rows = (flat @ self.outward).reshape(*J.shape[:2], -1)

    def apply(self, criterion: Criterion) -> Criterion:
        """The criterion of an information matrix in coordinates.

        Raises:
            InputError: a weight with directions that neither data nor prior determine.
        """
        if criterion.weight is None:  # log det M but for a constant
            return criterion
        W = criterion.weight / self._unit[:, None] / self._unit
        if np.trace(W) - np.trace(self._basis.T @ W @ self._basis) > _LOST * np.trace(W):
            raise InputError(criterion.confounded)
        return Criterion(self.outward.T @ criterion.weight @ self.outward)

    def curve(self, criterion: Criterion, chosen: ArrayLike) -> Array:
        """The criterion of the prior and the first 1, 2, … of some candidates, `(pose,)`."""
        rows = self.rows[np.asarray(chosen, int)]
        return criterion.value(self.base + np.cumsum(np.einsum("nri,nrj->nij", rows, rows), 0))

    def information(self, chosen: ArrayLike) -> Array:
        """The information of the prior and some candidates, with what keeps it invertible."""
        flat = self.rows[np.asarray(chosen, int)].reshape(-1, self.rows.shape[2])
        return self.base + _RIDGE * np.eye(len(self.base)) + flat.T @ flat

    def foremost(self, criterion: Criterion, chosen: Integers) -> Integers:
        """`chosen`, and the candidates that rank first beside them."""
        gains = criterion.approximate_gains(self.rows, self.information(chosen))
        gains[chosen] = np.inf
        size = min(_FOREMOST + len(chosen), len(gains))
        among = np.argpartition(-gains, size - 1)[:size]
        return np.concatenate([chosen, np.setdiff1d(among, chosen)])


class Design(NamedTuple):
    """Chosen poses, best first.

    Attributes:
        indices: `(pose,)`, of the candidates, each once, ordered so that each beginning of them is as good as can be.
        rank: how many directions of parameter space the candidates (and the prior) determine.
        exchanges: poses that were exchanged.
        cycles: how often the exchange went through all poses, the last time in vain unless the limit was reached.
    """

    indices: Integers
    rank: int
    exchanges: int
    cycles: int


def choose(pool: Pool, count: int, criterion: Criterion) -> Design:
    """The `count` candidates whose information is best by `criterion`, which is in the pool's coordinates.

    Raises:
        InputError: more poses than candidates, or too few for the parameters.
    """
    total, height, rank = pool.rows.shape
    if not 1 <= count <= total:
        raise InputError(f"{count} poses out of {total} candidates: choose 1 to {total}, or give more candidates")
    sizes = np.linalg.eigvalsh(pool.base)
    determined_by_prior = int(np.sum(sizes > _DESIGN_DETERMINES * max(sizes[-1], 0.0)))
    needed = -(-(rank - determined_by_prior) // height)
    if count < needed:
        raise InputError(
            f"{count} poses: too few for the {rank} directions that the candidates determine; choose at least"
            f" {needed}, or give a prior"
        )
    chosen = np.zeros(0, np.int64)
    while len(chosen) < count:
        among = pool.foremost(criterion, chosen)
        chosen = among[_build(pool, criterion, among, len(chosen), min(len(chosen) + _TOGETHER, count))]
    chosen, exchanges, cycles = exchange(pool, criterion, chosen)
    return Design(chosen[_build(pool, criterion, chosen, 0, count)], rank, exchanges, cycles)


def _build(pool: Pool, criterion: Criterion, among: Integers, already: int, count: int) -> list[int]:
    """`count` of `among`, which begin with those `already` chosen: each the best beside the ones before it."""
    rows = pool.rows[among]
    chosen = list(range(already))
    while len(chosen) < count:
        gains = criterion.gains(rows, pool.information(among[chosen]))
        gains[chosen] = -np.inf
        chosen.append(int(np.argmax(gains)))
    return chosen


def exchange(pool: Pool, criterion: Criterion, chosen: Integers) -> tuple[Integers, int, int]:
    """A design `(pose,)` improved until no exchange with the foremost candidates does, the exchanges and cycles."""
    exchanges = cycles = 0
    count = len(chosen)
    while cycles < _CYCLES:
        among = pool.foremost(criterion, chosen)
        at = list(range(count))
        rows = pool.rows[among]
        made = 0
        visited = 0
        in_vain = 0
        while in_vain < count and cycles + visited // count < _CYCLES:
            i = visited % count
            retained = at[:i] + at[i + 1 :]
            gains = criterion.gains(rows, pool.information(among[retained]))
            gains[retained] = -np.inf
            candidate = int(np.argmax(gains))
            better = gains[candidate] > gains[at[i]] * (1 + _IMPROVES)
            at[i] = candidate if better else at[i]
            made = made + better
            in_vain = 0 if better else in_vain + 1
            visited = visited + 1
        chosen = among[at]
        exchanges = exchanges + made
        cycles = cycles + -(-visited // count)
        if not made or len(among) == len(pool.rows):
            break
    return chosen, int(exchanges), cycles


# ------------------------------------------------------------------ poses to record


CriterionName = Literal["D", "A", "I"]

MOST_POSES = 400
"""The most poses that are tried for a given accuracy, or drawn at random, unless more are asked for."""
_RANDOM_DRAWS = 50
"""Random selections of as many poses that a design is compared with."""
_ROUNDING = 1e-12
"""rad: a shorter route by less than this is rounding."""


@dataclass(frozen=True, eq=False, repr=False)
class _PlannedPoses:
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
class Plan(_PlannedPoses, PublicResult):
    """Poses that determine an arm's parameters best.

    Attributes:
        experiment, joint_position, design, candidates: as of every design.
        criterion: by which they were chosen.
        accuracy: `(pose,)` m: standard deviation of predicted positions after the first 1, 2, … poses, root mean square
            over the workspace in 3-D. Infinite where these do not determine it.
        random_accuracy: `(draw, count)` m, the same of poses drawn at random from the candidates.
        needed: how many poses reach the accuracy given. None where none was given, or the most poses that were tried do
            not reach it.
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
class DiscriminationPlan(_PlannedPoses, PublicResult):
    """Poses that discriminate between two rival models of the physics.

    Attributes:
        experiment, joint_position, design, candidates: as of every design; the experiment has both effects.
        rivals: the labels of the two effects.
        distance: `(pose,)`, after the first 1, 2, … poses: from the readings with the first effect to the closest that
            the other explains, all other unknowns refitted. In standard deviations; NaN where these poses do not
            determine the parameters.
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
    # A: minus the sum of the variances of the determined directions
    by = Criterion(pool.outward.T @ pool.outward) if criterion == "A" else Criterion()
    by = pool.apply(error) if criterion == "I" else by
    design = choose(pool, count, by)
    try:
        judged = pool.apply(error)
    except InputError:  # positions depend on what no candidate determines
        judged = None

    def curve(indices: Integers) -> Array:
        """The accuracy after the first 1, 2, … of some candidates."""
        if judged is None:
            return np.full(len(indices), np.inf)
        return np.sqrt(-pool.curve(judged, indices))

    achieved = reached = curve(design.indices)
    needed = None
    more = count
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

    The criterion is T-optimality (A. Atkinson, V. Fedorov, Biometrika 62, 1975), linearised. One number scales the
    first effect from its hypothesised size, and all numbers of the other are unknown. The distance is one over the
    standard deviation of that number.

    Args:
        experiment: what is unknown beside the two effects.
        rivals: the first effect with its hypothesised values in SI units, and the effect that might explain it.
        candidates, count, recorded, seed: as in `plan_poses`.

    Raises:
        InputError: as `plan_poses`; the first has no size, or no candidate separates them.
    """
    (first_effect, values), second_effect = rivals
    values = np.asarray(values, float)
    if not values.any():
        raise InputError(f"{first_effect.label}: has no size; give a value of its parameters")
    at = np.concatenate([experiment.values, np.zeros(first_effect.size + second_effect.size)])
    experiment = replace(experiment, approach="zero").with_physics(
        [*experiment.physics.effects, first_effect, second_effect], at
    )
    first = experiment.size - first_effect.size - second_effect.size
    first_numbers = slice(first, first + first_effect.size)
    scaled = np.delete(np.eye(experiment.size), np.arange(first + 1, first + first_effect.size), axis=1)
    scaled[first_numbers, first] = values / experiment.unit[first_numbers]
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

    def distances(indices: Integers) -> Array:
        variances = -pool.curve(by, indices)
        return 1 / np.sqrt(np.where(np.isfinite(variances), variances, np.nan))

    return DiscriminationPlan(
        experiment=experiment,
        joint_position=q[design.indices],
        design=design,
        candidates=len(q),
        rivals=(first_effect.label, second_effect.label),
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


def _random_draws(candidates: int, count: int, seed: int) -> Sequence[Integers]:
    """`count` candidates drawn at random, `_RANDOM_DRAWS` times."""
    random = np.random.default_rng(seed)
    return [random.choice(candidates, count, replace=False) for _ in range(_RANDOM_DRAWS)]


def short_path(joint_position: Array) -> Integers:
    """An order `(pose,)` in which an arm moves little from where all joints are at zero through `(pose, joint)` rad.

    From each pose to the nearest, then improved two by two. The distance is the largest move of any joint, which is
    what takes the time.
    """
    points = np.vstack([np.zeros(joint_position.shape[1]), joint_position])
    distance = np.abs(points[:, None] - points[None]).max(-1)
    order = [0]
    unvisited = set(range(1, len(points)))
    while unvisited:
        order.append(min(unvisited, key=lambda k: distance[order[-1], k]))
        unvisited.remove(order[-1])
    tour = np.array(order)
    improved = True
    while improved:  # 2-opt of an open path: turn a stretch round where that shortens it
        improved = False
        for i in range(1, len(tour) - 1):
            ends = tour[i + 1 :]
            ahead = np.append(tour[i + 2 :], -1)
            gain = distance[tour[i - 1], tour[i]] - distance[tour[i - 1], ends]
            gain = gain + np.where(ahead < 0, 0.0, distance[ends, ahead] - distance[tour[i], ahead])
            stretch = int(np.argmax(gain))
            if gain[stretch] > _ROUNDING:
                tour[i : i + 2 + stretch] = tour[i : i + 2 + stretch][::-1]
                improved = True
    return tour[1:] - 1
