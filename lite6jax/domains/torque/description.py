"""What a function without a name looks like among the named effects of its joint."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.effects.dynamic.torque_effect import TorqueEffect

Array = NDArray[np.floating]

_DESCRIBES, _WORTH_ANOTHER = 0.8, 0.01
"""Share of a curve's mean square from which named effects are said to describe it, and that a second one must add."""


class Description(NamedTuple):
    """Named effects that together come near to a curve.

    Attributes:
        share: of the curve's mean square that they give, from 0 to 1.
        effects: one or two of its joint.
        values: `(effect,)`, their numbers in SI units.
    """

    share: float
    effects: tuple[TorqueEffect, ...]
    values: Array


def described(problem: TorqueProblem, joint: int, moved: Array) -> Description | None:
    """The one or two named effects of a joint that come nearest to what a curve adds to it, by least squares.

    A curve takes the place of names where these do not explain all of it. What they do explain is what a reader looks
    for first: how much of it is viscous friction, and how much Coulomb friction. None where they give too little of it.

    Args:
        problem: the data.
        joint: from 1.
        moved: `(joint, sample)` Nm, or N at a prismatic joint, by the curve.
    """
    there = [effect for effect in problem.simple if effect.site == f"joint{joint}"]
    target = moved[joint - 1, problem.valid]
    units = (problem.columns(there) * problem.sigma)[:, joint - 1, problem.valid]
    best = Description(0.0, (), np.zeros(0))
    for which in (*combinations(range(len(there)), 1), *combinations(range(len(there)), 2)):
        effects, columns = tuple(there[k] for k in which), units[list(which)]
        values = np.linalg.lstsq(columns.T, target, rcond=1e-9)[0]
        share = 1 - float(np.sum((target - values @ columns) ** 2) / max(np.sum(target**2), 1e-300))
        limits = [problem.limits(effect)[0] for effect in effects]
        possible = all(lower <= value <= upper for (lower, upper), value in zip(limits, values, strict=True))
        if possible and share > best.share + (_WORTH_ANOTHER if len(effects) > len(best.effects) else 0.0):
            best = Description(share, effects, values)
    return best if best.share >= _DESCRIBES else None
