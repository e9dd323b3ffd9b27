"""The periodic terms of poses: harmonics of each revolute joint."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.effects.motion import Motion
from lite6jax.estimation.problem import PeriodicFamily
from lite6jax.estimation.terms import Term


def periodic(motion: Motion, sites: dict[Site, NDArray[np.floating]]) -> tuple[PeriodicFamily, ...]:
    """The harmonics of each revolute joint.

    Args:
        motion: time-shifted.
        sites: columns of each site.
    """
    found = []
    for j in map(int, np.flatnonzero(~motion.sliding.mask(motion.dof))):
        q = np.asarray(motion.joint_position)[j]
        found.append(PeriodicFamily(f"joint{j + 1}", sites["joint", j, 0], q, partial(_harmonic, j + 1), _order))
    return tuple(found)


def _harmonic(joint: int, order: float) -> JointHarmonic:
    return JointHarmonic(joint, order)


def _order(term: Term) -> float | None:
    assert isinstance(term, JointHarmonic)
    return None if term.order is None else float(term.order)
