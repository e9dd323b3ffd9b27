"""Which poses to record of an arm, how much better they are than poses drawn at random, and how many are enough."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.fitting.start import sample_within_limits
from lite6jax.identifiability.criteria import CRITERIA, Criterion, determined_coordinates, workspace
from lite6jax.identifiability.design import Design, choose
from lite6jax.identifiability.evaluation import (
    RANDOM_DRAWS,
    SINGULAR,
    criterion_values,
    cumulative_information,
    known_information,
    refined_poses,
)
from lite6jax.identifiability.identify import WORKSPACE
from lite6jax.identifiability.information import Experiment
from lite6jax.identifiability.refine import Refinement
from lite6jax.identifiability.sensor import BARE
from lite6jax.results import PublicResult

Array = NDArray[np.floating]
CriterionName = Literal["D", "A", "E", "I"]

MOST_POSES = 400
"""The largest number of poses that designs and random selections are compared at."""
_UNDETERMINED = 1e-6
"""Share of what moves positions over the workspace that may lie in directions no candidate determines: rounding."""


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
        accuracy: m, a target: how many poses reach it is found by designs of more poses where these do not.
        feasible: which of `(sample, joint)` rad may be recorded, `(sample,)` bool; all where not given.
        seed: of the random comparison and of the workspace.

    Raises:
        InputError: as `choose`.
    """
    q = np.asarray(candidates, float)
    experiment = replace(experiment, approach="zero")  # which pose precedes a candidate is not known
    rows = experiment.rows(q)
    prior = known_information(experiment, recorded)
    over = _workspace_rows(experiment, seed)
    by = workspace(over) if criterion == "I" else CRITERIA[criterion]
    design = choose(rows, count, by, prior=prior, seed=seed)
    chosen, refinement = refined_poses(experiment, q[design.indices], by, prior, refined, limits, feasible)
    curve = _Curve(rows, prior, over)
    random = np.random.default_rng(seed)
    length = min(max(count, min(max(4 * count, 60), MOST_POSES)), len(q))
    draws = np.stack([random.choice(len(q), length, replace=False) for _ in range(RANDOM_DRAWS)])
    chosen_rows = experiment.rows(chosen)
    achieved = curve(chosen_rows)
    needed, more, reached = None, count, achieved
    while accuracy is not None:
        needed = _first_within(reached, accuracy)
        if needed is not None:
            break
        if more >= min(MOST_POSES, len(q)) or not curve.determined:
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


def _first_within(curve: Array, accuracy: float) -> int | None:
    """After how many poses a curve is as low as that; None where it never is."""
    enough = np.flatnonzero(curve <= accuracy)
    return int(enough[0]) + 1 if len(enough) else None


@final
class _Curve:
    """The accuracy over a workspace after the first 1, 2, … of some poses."""

    def __init__(self, rows: Array, prior: Array, over: Array) -> None:
        self.coordinates, self.prior = determined_coordinates(rows, prior), prior
        flat = over.reshape(-1, over.shape[2])
        basis = np.linalg.qr(self.coordinates.outward)[0]
        lost = np.linalg.norm(flat - flat @ basis @ basis.T)
        self.determined = bool(lost <= _UNDETERMINED * np.linalg.norm(flat))
        flat = flat @ self.coordinates.outward
        self.weight = flat.T @ flat / len(over)

    def __call__(self, rows: Array) -> Array:
        eigenvalues, V = np.linalg.eigh(cumulative_information(rows, self.prior, self.coordinates))
        determined = (eigenvalues[:, 0] > SINGULAR * eigenvalues[:, -1]) & self.determined
        spread = np.einsum("nij,ik,nkj->nj", V, self.weight, V) / np.where(determined[:, None], eigenvalues, 1.0)
        return np.where(determined, np.sqrt(spread.sum(1)), np.inf)


def _workspace_rows(experiment: Experiment, seed: int) -> Array:
    """`(pose, 3, size)`: how predicted positions move with the parameters, m per tolerance."""
    q = sample_within_limits(experiment.arm, WORKSPACE, seed + 1)
    return experiment.with_sensor(BARE).rows(q)[:, :3]


def _efficiency(by: Criterion, rows: Array, prior: Array, draws: NDArray[np.integer], chosen: Array) -> Array:
    """Of the chosen poses relative to each random draw of as many, by the criterion, `(draw,)`."""
    coordinates = determined_coordinates(rows, prior)
    inside, rank = by.within(coordinates), coordinates.outward.shape[1]

    ends = [cumulative_information(some, prior, coordinates)[-1] for some in (chosen, *(rows[draw] for draw in draws))]
    reached, *others = criterion_values(inside, np.stack(ends), -np.inf)
    # a draw that does not determine all parameters does not reach the design, however often it is repeated
    return np.array([
        by.efficiency(float(reached), float(value), rank) if np.isfinite(value) else np.inf for value in others
    ])  # fmt: skip
