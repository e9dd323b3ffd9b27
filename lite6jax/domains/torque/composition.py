"""What motors exert on an arm with effects and what their sensors show of it, and how both change with the numbers."""

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.torque.filtering import interpolant
from lite6jax.effects.drivers import Driver
from lite6jax.effects.dynamic import Delaying, Dynamics, JointTorque, Scaling, TorqueEffect, TorqueLag, UnnamedTorque
from lite6jax.estimation.terms import Terms

Array = NDArray[np.floating]

_LINE = 10
"""Samples over which the slope is taken by which delayed torques go on beyond the ends of a run."""
_STEP = 1e-4
"""Of a number's typical size, by which it is changed for a derivative."""


def pairs(terms: Terms) -> list[tuple[TorqueEffect, slice]]:
    """The effects that are the terms of a torque problem, each with the place of its numbers."""
    found = []
    for term, part in zip(terms.terms, terms.slices, strict=True):
        assert isinstance(term, TorqueEffect)
        found.append((term, part))
    return found


def exerted(terms: Terms, values: Array, dynamics: Dynamics) -> Array:
    """`(joint, sample)` Nm that the motors exert: without the scales and delays of what shows it."""
    total = dynamics.declared
    for effect, part in pairs(terms):
        if not isinstance(effect, Scaling | Delaying):
            total = total + effect.torque(np.asarray(values[part], float), dynamics)
    return total


def composed(terms: Terms, values: Array, dynamics: Dynamics) -> Array:
    """`(joint, sample)` Nm that a motor's sensor shows at each instant of a motion; delays are left out."""
    total = exerted(terms, values, dynamics)
    return scales_of(terms, values, len(total)) * total


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


def delayed(torque: Array, offsets: Array, time: Array, runs: NDArray[np.integer]) -> Array:
    """Torques at another time than that of each sample, `(joint, sample)` Nm.

    Beyond the ends of a run they go on along the line through some samples: a cubic would follow their noise.

    Args:
        torque: `(joint, sample)` Nm; those of runs that are too short to say stay as they are.
        offsets: `(joint,)` s after the sample.
        time: `(sample,)` s.
        runs: `(sample,)`, the run of each sample.
    """
    value = np.array(torque)
    for offset in set(offsets[offsets != 0].tolist()):
        joints = np.flatnonzero(offsets == offset)
        for rows, spline in interpolant(torque[joints], time, runs):
            t, part = time[rows], torque[joints, rows]
            at = np.clip(t + offset, t[0], t[-1])
            beyond, found = t + offset - at, spline(at)
            if beyond.any():
                near, far = ((0, _LINE), (-1 - _LINE, -1))[offset > 0], (0, -1)[offset > 0]
                along = (part[:, near[1]] - part[:, near[0]]) / (t[near[1]] - t[near[0]])
                found = np.where(beyond != 0, part[:, [far]] + along[:, None] * beyond, found)
            value[joints, rows] = found
    return value


def slope_of_delayed(torque: Array, offsets: Array, time: Array, runs: NDArray[np.integer]) -> Array:
    """The derivatives by time of what `delayed` gives, `(joint, sample)` Nm/s; zero of runs that are too short."""
    slope = np.zeros(torque.shape)
    for offset in set(offsets.tolist()):
        joints = np.flatnonzero(offsets == offset)
        for rows, spline in interpolant(torque[joints], time, runs):
            t = time[rows]
            slope[joints, rows] = spline(np.clip(t + offset, t[0], t[-1]), 1)
    return slope


def joints_of(effect: TorqueEffect) -> slice:
    """The joints, of all, that an effect acts on: most effects act on one."""
    return slice(effect.joint - 1, effect.joint) if isinstance(effect, JointTorque | TorqueLag) else slice(None)


def unit_torques(effect: TorqueEffect, dynamics: Dynamics) -> Array:
    """Torques `(number, joint, sample)` by each number of a linear effect, of `joints_of` it."""
    if isinstance(effect, UnnamedTorque):
        return effect.functions_of(dynamics)[:, None]
    if isinstance(effect, JointTorque):
        return np.stack([effect.at_joint(unit, dynamics) for unit in np.eye(effect.size)])[:, None]
    return np.stack([effect.torque(unit, dynamics) for unit in np.eye(effect.size)])


def slopes(effect: TorqueEffect, values: Array, dynamics: Dynamics) -> Array:
    """`(number, joint, sample)` Nm by each number of an effect that is not linear, by central differences."""
    found = []
    for k, number in enumerate(effect.coordinates):
        step = np.eye(effect.size)[k] * _STEP * number.typical
        up, down = (effect.torque(values + sign * step, dynamics) for sign in (1, -1))
        found.append((up - down) / (2 * step[k]))
    return np.stack(found)


def read_driver(driver: Driver, dynamics: Dynamics) -> Array | None:
    """`(sample,)` in the driver's unit; None where the motion or the loads do not contain it."""
    loads = dynamics.loads if driver.loaded else None
    return np.asarray(driver.values(dynamics.motion, loads)) if driver.known(dynamics.motion, loads) else None
