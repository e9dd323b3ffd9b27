"""Which poses to record to discriminate between two rival models of the physics."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.design.criteria import determined_coordinates, discrimination
from lite6jax.design.design import Design, choose
from lite6jax.design.evaluation import (
    RANDOM_DRAWS,
    criterion_values,
    cumulative_information,
    known_information,
    refined_poses,
)
from lite6jax.design.information import Experiment
from lite6jax.design.refine import Refinement
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.results import PublicResult

Array = NDArray[np.floating]


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
    feasible: Callable[[Array], NDArray[np.bool_]] | None = None,
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
        InputError: as `choose`; the first has no size, or no candidate separates them.
    """
    (one, one_values), (other, other_values) = ((e, np.asarray(v, float)) for e, v in rivals)
    if not one_values.any():
        raise InputError(f"{one.label}: has no size; give a value of its parameters")
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
    rows, prior = experiment.rows(q), known_information(experiment, recorded)
    design = choose(rows, count, by, prior=prior, seed=seed)
    chosen, refinement = refined_poses(experiment, q[design.indices], by, prior, refined, limits, feasible)
    random = np.random.default_rng(seed)
    draws = np.stack([random.choice(len(q), count, replace=False) for _ in range(RANDOM_DRAWS)])
    coordinates = determined_coordinates(rows, prior)
    inside = by.within(coordinates)

    def distances(informations: Array) -> Array:
        return np.sqrt(criterion_values(inside, informations, np.nan))

    at_random = np.stack([cumulative_information(rows[draw], prior, coordinates)[-1] for draw in draws])
    return DiscriminationPlan(
        experiment=experiment,
        joint_position=chosen,
        rivals=(one.label, other.label),
        both_ways=bool(other_values.any()),
        design=design,
        candidates=len(q),
        refinement=refinement,
        distance=distances(cumulative_information(experiment.rows(chosen), prior, coordinates)),
        random_distance=distances(at_random),
    )
