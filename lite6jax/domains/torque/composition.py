"""What effects add up to: the torques that the motors exert, and what their sensors show of these."""

import numpy as np
from numpy.typing import NDArray

from lite6jax.effects.dynamic.torque_effect import Delaying, Dynamics, Scaling, TorqueEffect
from lite6jax.estimation.terms import Terms

Array = NDArray[np.floating]


def composed(terms: Terms, values: Array, dynamics: Dynamics) -> Array:
    """`(joint, sample)` Nm that a motor's sensor shows at each instant of a motion; delays are left out."""
    total = without_sensors(terms, values, dynamics)
    return scales_of(terms, values, len(total)) * total


def without_sensors(terms: Terms, values: Array, dynamics: Dynamics) -> Array:
    """`(joint, sample)` Nm that the motors exert: without the scales and delays of what shows it."""
    total = dynamics.declared
    for effect, part in pairs(terms):
        if not isinstance(effect, Scaling | Delaying):
            total = total + effect.torque(np.asarray(values[part], float), dynamics)
    return total


def scales_of(terms: Terms, values: Array, joints: int) -> Array:
    """`(joint, 1)`, the measured torque over the true one."""
    scale = np.ones((joints, 1))
    for effect, part in pairs(terms):
        if isinstance(effect, Scaling):
            scale[effect.joint - 1] += values[part][0]
    return scale


def offsets_of(terms: Terms, values: Array, joints: int) -> Array:
    """`(joint,)` s by which each joint's torques belong to a later motion than their stamps say."""
    total = np.zeros(joints)
    for effect, part in pairs(terms):
        if isinstance(effect, Delaying):
            total += effect.offset(float(values[part][0]), joints)
    return total


def pairs(terms: Terms) -> list[tuple[TorqueEffect, slice]]:
    """The effects that are the terms of a torque problem, each with the place of its numbers."""
    found = []
    for term, part in zip(terms.terms, terms.slices, strict=True):
        assert isinstance(term, TorqueEffect)
        found.append((term, part))
    return found
