"""Standard deviations of predictions: of what was estimated, of what is left of the model, outside its range.

The numbers of a model are uncertain together: their covariance goes through the derivatives of the prediction. What is
left of the model is known from rows that were not fitted. Far from every recorded row it may be larger. Beyond the
range of its driver a nonparametric effect goes back to its prior, whose variance each domain adds.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.effects.effect import Effect
from lite6jax.estimation.projection import diagonal_root

Site = tuple[str, int, int]
"""A number of the nuisance: what it is of, of which joint or frame, from 0, and which number of that."""

LENGTH = 0.5
"""rad in joint space, beyond the spacing of the recorded rows, at which what is left of the model counts twice."""
DRIVEN = 0.25
"""Of the recorded range of a driver: so far beyond it what is left counts twice."""
MARGIN = 0.02
"""Of a recorded range: a row within this of its ends is not outside."""


Basis = Literal["rigid", "flexible", "rows", "effects"]


@final
@dataclass(frozen=True)
class ReferenceOrigin:
    """The reference recording relative to which a model was estimated.

    Attributes:
        file: the recording's name.
        basis: what the model contains. `rigid`: all, because the reference has no effects beyond a rigid arm;
            `flexible`: of poses, the difference from a reference that has some; `rows`: of torques, the difference in
            the same motion; `effects`: all that the recording shows, because the motions differ.
    """

    file: str
    basis: Basis


@final
@dataclass(frozen=True, eq=False)
class RecordedRange:
    """Where a model was recorded.

    Attributes:
        joints: `(joint, 2)` rad, m of prismatic joints, the least and the greatest position of each.
        positions: `(row, joint)` rad, or m, of some recorded rows.
        spacing: rad, the distance from a row to the nearest of `positions` in other blocks of the recording that 95 %
            of rows do not exceed: so far, errors on held-out rows tell what is left. Of torques a prismatic joint
            counts by `arms.arm.LEVER`.
        drivers: the least and the greatest value of each quantity on which an effect depends, by its phrase.
        velocities: as `joints`, rad/s; None of poses.
        accelerations: likewise, rad/s².
    """

    joints: Array
    positions: Array
    spacing: float
    drivers: dict[str, tuple[float, float]]
    velocities: Array | None = None
    accelerations: Array | None = None

    def beyond(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """By how much quantities `(sample,)` are beyond what was recorded of them, as `beyond_range`, by phrase."""
        recorded = {phrase: samples for phrase, samples in values.items() if phrase in self.drivers}
        return {phrase: beyond_range(samples, *self.drivers[phrase]) for phrase, samples in recorded.items()}


@final
@dataclass(frozen=True, eq=False)
class Uncertainty:
    """What standard deviations of a model's predictions follow from.

    The quantities of a prediction are position (m per axis) and orientation (rad per axis) of a pose, or the torques of
    the joints (Nm, N of prismatic joints).

    Attributes:
        sites: the nuisance that was fitted: displacements of frames, each about the frame as it is in the model, and
            errors of masses; of torques the inertial numbers of the links.
        covariance: `(number, number)`, of these and then of the numbers of all effects, each as `freed`.
        left: `(quantity,)`, what is left of the model, on rows that were not fitted.
        unseen: `(quantity,)`, what may be left of it without showing there: one standard error of `left`.
        noise: `(quantity,)`, of one row of the sensor.
        recorded: the range.
        typical: `(quantity,)`, the standard deviation of the recorded rows, their median; None where it is not known.
    """

    sites: tuple[Site, ...]
    covariance: Array
    left: Sequence[float] | Array
    unseen: Sequence[float] | Array
    noise: Sequence[float] | Array
    recorded: RecordedRange
    typical: Sequence[float] | Array | None = None

    def keeping(self, effects: Sequence[Effect], kept: Sequence[bool]) -> "Uncertainty":
        """That of the model with those of its effects that are kept; their numbers stay as uncertain as they are."""
        numbers = [True] * len(self.sites) + np.repeat(kept, [freed(effect).size for effect in effects]).tolist()
        return replace(self, covariance=self.covariance[np.ix_(numbers, numbers)])

    def without_base(self) -> "Uncertainty":
        """That of poses in the frame of the arm's own base, in which this frame's place does not matter."""
        sites = [site[0] != "base" for site in self.sites]
        numbers = sites + [True] * (len(self.covariance) - len(sites))
        remaining_sites = tuple(site for site in self.sites if site[0] != "base")
        return replace(self, sites=remaining_sites, covariance=self.covariance[np.ix_(numbers, numbers)])


def freed(effect: Effect) -> Effect:
    """The effect with the order that was found for it as its last number, unless that is whole and so exact."""
    if effect.chosen is not None and effect.chosen % 1:
        return effect.released()
    return effect


def independent_directions(covariance: Array) -> Array:
    """`(direction, number)`, whose squares sum up to a covariance `(number, number)`.

    Numbers that no row shows are as uncertain as their prior, and cancel: the directions are independent.
    """
    root = diagonal_root(covariance)
    eigenvalues, V = np.linalg.eigh(covariance / np.outer(root, root))
    return (V * np.sqrt(np.maximum(eigenvalues, 0.0)) * root[:, None]).T


def distance_to(positions: Array, joint_position: Array) -> Array:
    """`(sample,)` rad, from joint positions `(sample, joint)` to the nearest of `positions` `(row, joint)`."""
    return cdist(joint_position, positions).min(1)


def beyond_range(values: Array, lower: ArrayLike, upper: ArrayLike, least: ArrayLike = 1e-6) -> Array:
    """By how much values are beyond a range, over its length, `least` at least; over its ends where it has none."""
    lower = np.asarray(lower)
    upper = np.asarray(upper)
    length = np.maximum(np.maximum(upper - lower, 0.1 * np.maximum(np.abs(lower), np.abs(upper))), least)
    return np.maximum(np.maximum(lower - values, values - upper), 0.0) / length


def widened(
    variance: Array,
    known: Uncertainty,
    rows: Integers,
    distance: Array,
    beyond: Mapping[str, Array],
    contained: Collection[str],
) -> tuple[Array, Mask]:
    """The variance `(row, sample)` with that of what is left of the model, and where a motion leaves what was recorded.

    Args:
        variance: by the covariance of the model's numbers, and of nonparametric effects beyond their range.
        known: of the model.
        rows: `(row,)`, which quantity each row is of.
        distance: `(sample,)` rad in joint space to the nearest recorded rows.
        beyond: `(sample,)` of each quantity, by the phrase of its driver, as `beyond_range`.
        contained: phrases of what the distance contains already.
    """
    further = (np.maximum(distance - known.recorded.spacing, 0.0) / LENGTH) ** 2
    for phrase, part in beyond.items():
        if phrase not in contained:
            further = further + (part / DRIVEN) ** 2
    outside = np.any([np.zeros(len(distance), bool), *(part > MARGIN for part in beyond.values())], axis=0)
    residual_variance, unseen = (np.asarray(part, float)[rows, None] ** 2 for part in (known.left, known.unseen))
    return variance + residual_variance + further * (residual_variance + unseen), outside
