"""The range of speeds, loads and reversals in the rollout of a log, and where another motion is beyond it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, final

import numpy as np

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.tracking.coupling import Bodies
from lite6jax.domains.uncertainty import MARGIN

_LEAST_RANGE = 1e-3
"""rad/s or Nm, that a fitted range counts as at least."""
_TURNED_BACK = 5e-3
"""rad, by which a joint turns back at least where it reverses. Ringing and creeping under friction are less."""


@final
@dataclass(frozen=True, eq=False)
class FittedRange:
    """What was in a recording, of each joint.

    Attributes:
        velocity: `(joint, 2)` rad/s, the least and the greatest.
        weight: `(joint, 2)` Nm, likewise, what the joint carries at rest.
        reversal: `(joint,)` s, the shortest time from one reversal to the next; infinite of a joint that reverses less
            than twice. None where it is not known.
    """

    velocity: Array
    weight: Array
    reversal: Array | None = None


class Beyond(NamedTuple):
    """Where a motion is beyond what was fitted, each `(sample, joint)`.

    Attributes:
        speed: the joint is faster, in that direction.
        load: it carries more at rest, or less.
        reversal: it is between two reversals that follow each other sooner; where the recording has no two of the
            joint, anywhere after the first one.
        driver: a quantity on which a nonparametric torque of the joint depends is beyond what it was.
    """

    speed: Mask
    load: Mask
    reversal: Mask
    driver: Mask

    @property
    def any_joint(self) -> Mask:
        """`(sample,)`, where any joint is beyond in any way."""
        return np.any(np.hstack(self), axis=1)

    def at(self, samples: Integers | Sequence[int]) -> "Beyond":
        """That of some of the samples."""
        return Beyond(*(mask[samples] for mask in self))

    @property
    def by_joint(self) -> dict[str, Mask]:
        """`(sample,)` by quantity and joint, such as `speed_joint2`, of those that are beyond in any sample."""
        return {
            f"{quantity}_joint{joint + 1}": mask[:, joint]
            for quantity, mask in zip(self._fields, self, strict=True)
            for joint in np.flatnonzero(mask.any(0)).tolist()
        }

    @property
    def counts(self) -> dict[str, int]:
        """The number of samples that are beyond, by quantity and joint, where there are any."""
        return {name: int(mask.sum()) for name, mask in self.by_joint.items()}


def range_of(bodies: Bodies, position: Array, period: float, runs: Integers) -> FittedRange:
    """The range of a rollout.

    Args:
        bodies: of the arm.
        position: `(joint, sample)` rad.
        period: s, from sample to sample.
        runs: `(sample,)`, which changes where a run begins.
    """
    velocity = differentiate_runs(position, period, runs)
    reversal = np.full(len(position), np.inf)
    for first, last in zip(*run_ends(runs), strict=True):
        for joint, row in enumerate(position[:, first:last]):
            shortest = np.min(period * np.diff(reversals(row)), initial=np.inf)
            reversal[joint] = min(reversal[joint], shortest)
    return FittedRange(_ends(velocity), _ends(resting_loads(bodies, position)), reversal)


def find_beyond(ranges: FittedRange, bodies: Bodies, position: Array, period: float) -> Beyond:
    """Where a rollout is beyond what was fitted, but for drivers; arguments as of `range_of`, of one run."""
    return Beyond(
        _beyond_ends(differentiate(position, period), ranges.velocity),
        _beyond_ends(resting_loads(bodies, position), ranges.weight),
        _reverses_sooner(position, period, ranges.reversal),
        np.zeros(position.T.shape, bool),
    )


def reversals(position: Array) -> Integers:
    """The samples at which a joint reverses, of its positions `(sample,)` rad: it turns back from there clearly."""
    steps = np.sign(np.diff(position))
    moving = np.flatnonzero(steps)
    turns = moving[1:][np.diff(steps[moving]) != 0]
    found = list[int]()
    corner = 0
    direction = 0.0
    for sample in (*turns.tolist(), len(position) - 1):
        moved = float(position[sample] - position[corner])
        if direction == 0:
            if abs(moved) >= _TURNED_BACK:
                direction = float(np.sign(moved))
                corner = sample
        elif direction * moved >= 0:
            corner = sample
        elif abs(moved) >= _TURNED_BACK:
            found.append(corner)
            direction = -direction
            corner = sample
    return np.array(found, int)


def run_ends(runs: Integers) -> tuple[list[int], list[int]]:
    """Where each run begins, and where it has ended."""
    begins = np.flatnonzero(np.r_[True, np.diff(runs) != 0])
    return begins.tolist(), [*begins[1:].tolist(), len(runs)]


def concatenate_beyond(parts: Sequence[Beyond]) -> Beyond:
    """Joins those of several motions, one after the other."""
    return Beyond(*(np.concatenate(of_quantity) for of_quantity in zip(*parts, strict=True)))


def differentiate(position: Array, period: float) -> Array:
    """`(joint, sample)` rad/s."""
    if position.shape[1] < 2:
        return np.zeros_like(position)
    return np.gradient(position, period, axis=1)


def differentiate_runs(position: Array, period: float, runs: Integers) -> Array:
    """`(joint, sample)` rad/s, each run on its own; arguments as of `range_of`."""
    velocity = np.empty(position.shape)
    for first, last in zip(*run_ends(runs), strict=True):
        velocity[:, first:last] = differentiate(position[:, first:last], period)
    return velocity


def resting_loads(bodies: Bodies, position: Array) -> Array:
    """`(joint, sample)` Nm, what joints carry at rest."""
    still = np.zeros_like(position)
    return bodies.torques(position, still, still)


def _ends(values: Array) -> Array:
    """`(joint, 2)`, the least and the greatest of values `(joint, sample)`."""
    return np.stack([values.min(1), values.max(1)], 1)


def _beyond_ends(values: Array, ends: Array) -> Mask:
    """`(sample, joint)`, where values `(joint, sample)` are beyond ends `(joint, 2)`."""
    lower, upper = ends.T
    margin = MARGIN * np.maximum(upper - lower, _LEAST_RANGE)
    by_sample = values.T
    return (by_sample < lower - margin) | (by_sample > upper + margin)


def _reverses_sooner(position: Array, period: float, shortest: Array | None) -> Mask:
    """As `Beyond.reversal`, of positions `(joint, sample)` rad and shortest times `(joint,)` s; nowhere without these.

    A reversal is known to a sample.
    """
    beyond = np.zeros(position.T.shape, bool)
    if shortest is None:
        return beyond
    for joint, row in enumerate(position):
        reversed_at = reversals(row)
        if np.isinf(shortest[joint]) and len(reversed_at):
            beyond[reversed_at[0] :, joint] = True
        for begin, end in pairwise(reversed_at):
            if period * (end - begin + 1) < (1 - MARGIN) * shortest[joint]:
                beyond[begin:end, joint] = True
    return beyond
