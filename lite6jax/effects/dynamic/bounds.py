"""Bounds on the parameters of effects on torques: those of the heaviest arms, of bodies those of the arm at hand.

Beyond them a name is implausible: a centre of mass outside its link is evidence for something else.
"""

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm

Array = NDArray[np.floating]

TORQUE = 2000.0
"""Nm, of friction, offsets and ripple."""

VISCOUS = 3000.0
"""Nm·s/rad."""

VISCOUS_PER_KELVIN = 100.0
"""Nm·s/rad/K, of either sign."""

COEFFICIENT = 1.0
"""Of friction by load."""

STRIBECK = (1e-3, 2.0)
"""rad/s, the speed over which Stribeck friction vanishes."""

TRANSITION = (0.02, 1.0)
"""rad/s, the speed within which Coulomb friction turns: less is sharp in most logs, more is nearly viscous."""

SCALE = 0.9
"""Of a measured torque, relative; a reversed sign is a data fault."""

ROTOR = 500.0
"""kg·m², reflected to the joint."""

STIFFNESS = 1e4
"""Nm/rad, of cables, hoses and balancers."""

MASS = 500.0
"""kg, where the arm has no masses."""

LENGTH = 2.0
"""m, by which a centre of mass may be displaced, where the arm has no masses."""

PAYLOAD_LENGTH = 0.5
"""m, of a payload's centre of mass from where it is declared."""

_GROWTH, _MOUNTED = 3.0, 0.5
"""Times its own mass, or of the arm's, that what is mounted on a link weighs at most."""
_AROUND = 0.15
"""Of the arm's reach, by which a link extends beyond the line between its joints."""

TILT = 0.5
"""rad, by which a base may be tilted from what is declared."""

DELAY = 0.5
"""s."""


def heaviest(arm: Arm, link: int) -> float:
    """kg that are mounted on a link, counted from 1, at most: less than the arm weighs."""
    if arm.mass is None:
        return MASS
    total = float(np.sum(arm.mass))
    return min(max(_GROWTH * float(arm.mass[link - 1]), _MOUNTED * total), total)


def payload(arm: Arm) -> float:
    """kg that hang on the flange at most: no arm carries more than it weighs."""
    return MASS if arm.mass is None else float(np.sum(arm.mass))


def displacement(arm: Arm, link: int) -> Array:
    """`(3, 2)` m by which the centre of mass of a link, counted from 1, may be displaced and still be in the link.

    The link goes from its joint to the next one, or the flange, and some way around these and its declared centre.
    """
    if arm.center_of_mass is None:
        return np.tile([-LENGTH, LENGTH], (3, 1))
    end = arm.kinematics[link, :3] if link < arm.dof else arm.T_joint_flange[:3, 3]
    center = arm.center_of_mass[link - 1]
    inside = np.stack([np.zeros(3), end, center])
    around = _AROUND * arm.reach
    return np.stack([inside.min(0) - around - center, inside.max(0) + around - center], 1)
