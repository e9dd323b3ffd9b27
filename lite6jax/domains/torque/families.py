"""Families of effects on torques that a search needs: ripple of every order, and where and on what others depend."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import as_revolute
from lite6jax.domains.torque.rows import TorqueRows
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.dynamic.motors import TorqueLag, TorqueRipple
from lite6jax.effects.dynamic.torque_effect import DIRECTION_SPEED, Dynamics, JointTorque, TorqueEffect, UnnamedTorque
from lite6jax.effects.waves import wave_angle
from lite6jax.estimation.problem import Component, PeriodicFamily, Quantity
from lite6jax.estimation.terms import Term

Array = NDArray[np.floating]

Waves = dict[tuple[int, float], Array]
"""Filtered sine and cosine `(2, sample)` by joint, from 1, and order."""

_HIGHEST = 1000.0
"""Waves along the stroke of a prismatic joint that are searched at most: a screw's lead of 1 mm on a metre."""
_FEWEST = 2.0
"""Waves along the stroke that pass the filter at least where any are searched: fewer are any function of it."""
_SLOW = 0.2
"""Quantile of the speeds of a prismatic joint that moves at which the shortest wave still passes the filter."""
_MOST_WAVES = 1 << 22
"""Numbers of waves that are kept: 32 MB."""
_QUANTITIES = ("position", "velocity", "speed", "direction of motion", "gravity torque", "travel since reversal")
"""Of each joint, beside its temperature."""
_OWN_ALONE = ("speed", "travel since reversal")
"""Quantities on which the torque of another joint does not depend."""
_ANYWHERE = ("time", "temperature rise")
_LEAST_VARIED = 1e-3
"""Range of a driver, in its unit, or that of a revolute joint, below which it did not vary."""


def periodic(data: TorqueRows, chosen: NDArray[np.integer], noise: Array, known: Waves) -> tuple[PeriodicFamily, ...]:
    """Ripple of each joint, whose waves pass the filter as torques do; `known` are of the chosen samples.

    A turn of a prismatic joint is its stroke: orders count the waves along what it moved over.
    """
    found = []
    for j, slides in enumerate(data.arm.slides.tolist()):
        q = np.asarray(data.motion.joint_position)[j]
        turn, highest = (float(np.ptp(q)), _resolved(data, j)) if slides else (1.0, None)
        if slides and highest is None:
            continue
        position = q[data.filter.kept][chosen]
        ripple = _Ripple(j + 1, slides, turn)
        found.append(
            PeriodicFamily(
                f"joint{j + 1}",
                torque_at(j, noise),
                wave_angle(position, slides) / turn,
                ripple.term,
                ripple.order,
                partial(_waves, data, ripple, chosen, known),
                whole=not slides,
                highest=highest,
            )
        )
    return tuple(found)


def _resolved(data: TorqueRows, j: int) -> float | None:
    """The most waves along a prismatic joint's stroke that pass the filter while it moves slowly; None for none."""
    speed = np.abs(np.asarray(data.motion.joint_velocity)[j])
    moving = speed[as_revolute(speed, "rad/s", True) > DIRECTION_SPEED]
    if not moving.size:
        return None
    stroke = float(np.ptp(np.asarray(data.motion.joint_position)[j]))
    highest = min(stroke * data.filter.cutoff / float(np.quantile(moving, _SLOW)), _HIGHEST)
    return highest if highest > _FEWEST else None


@final
@dataclass(frozen=True)
class _Ripple:
    """The ripple of a joint, its orders counted in a turn, or in the stroke of a prismatic joint."""

    joint: int
    of_slide: bool
    turn: float

    def term(self, order: float) -> TorqueRipple:
        """The ripple of an order."""
        return TorqueRipple(self.joint, order / self.turn, of_slide=self.of_slide)

    def order(self, term: Term) -> float | None:
        """The order of a ripple."""
        assert isinstance(term, TorqueRipple)
        return None if term.order is None else float(term.order) * self.turn


def components(noise: Array) -> tuple[Component, ...]:
    """The torque of each joint; `noise` is `(joint, sample)`."""
    return tuple(Component(f"joint{j + 1}", "", torque_at(j, noise)) for j in range(len(noise)))


def quantities(dynamics: Dynamics) -> tuple[Quantity, ...]:
    """The drivers that are known and vary, each with the joint whose own it is.

    Args:
        dynamics: of every sample.
    """
    motion, loads = dynamics.motion, dynamics.loads
    slides, rise = motion.sliding.mask(motion.dof).tolist(), motion.joint_temperature_rise
    apart = rise is not None and np.ptp(np.asarray(rise), 0).any()  # else that of the whole arm would be there twice
    tried = [
        (joint_driver(quantity, j, of_slide), f"joint{j}")
        for j, of_slide in enumerate(slides, 1)
        for quantity in (*_QUANTITIES, *(("temperature",) if apart else ()))
    ]
    found = []
    for driver, site in (*tried, *((Driver(quantity), "") for quantity in _ANYWHERE)):
        if not driver.known(motion, loads):
            continue
        values = np.asarray(driver.values(motion, loads), float)
        usual = Driver(driver.generalised, driver.place).unit
        if np.ptp(as_revolute(values, usual, driver.of_slide)) > _LEAST_VARIED:
            only = site if driver.generalised in _OWN_ALONE else ""
            found.append(Quantity(driver, values, frozenset({site}), only))
    return tuple(found)


def joints_of(effect: TorqueEffect) -> slice:
    """The joints, of all, that an effect acts on: most effects act on one."""
    return slice(effect.joint - 1, effect.joint) if isinstance(effect, JointTorque | TorqueLag) else slice(None)


def unit_torques(effect: TorqueEffect, dynamics: Dynamics, kept: Callable[[Array], Array]) -> Array:
    """Torques `(number, joint, sample)` by each number of a linear effect, of `joints_of` it, filtered by `kept`."""
    if not isinstance(effect, JointTorque):
        return kept(np.stack([effect.torque(unit, dynamics) for unit in np.eye(effect.size)]))
    if isinstance(effect, UnnamedTorque):
        rows = effect.functions_of(dynamics)
    else:
        rows = np.stack([effect.at_joint(unit, dynamics) for unit in np.eye(effect.size)])
    return kept(rows)[:, None]


def driver_values(driver: Driver, dynamics: Dynamics) -> Array | None:
    """`(sample,)` in the driver's unit; None where the motion or the loads do not contain it."""
    loads = dynamics.loads if driver.loaded else None
    return np.asarray(driver.values(dynamics.motion, loads)) if driver.known(dynamics.motion, loads) else None


def torque_at(j: int, noise: Array) -> Array:
    """How residuals change with a torque at a joint, counted from 0, `(joint, sample)`; `noise` likewise."""
    return np.where(np.arange(len(noise))[:, None] == j, 1 / noise, 0.0)


def _waves(data: TorqueRows, ripple: _Ripple, chosen: NDArray[np.integer], known: Waves, orders: Array) -> Array:
    """Sine and cosine `(order, 2, sample)`. Most of a search's time would go into filtering the same orders again."""
    keys = [(ripple.joint, float(order)) for order in orders]
    found = {key: waves for key in keys if (waves := known.get(key)) is not None}
    new = sorted(set(keys) - set(found))
    if new:
        q = np.asarray(data.motion.joint_position)[ripple.joint - 1]
        angle = wave_angle(q, ripple.of_slide) / ripple.turn
        turned = np.multiply.outer([order for _, order in new], angle)
        filtered = data.filter(np.stack([np.sin(turned), np.cos(turned)], 1))[..., chosen]
        if 2 * len(chosen) * (len(known) + len(new)) > _MOST_WAVES:
            known.clear()
        known.update(zip(new, filtered, strict=True))
        found.update(zip(new, filtered, strict=True))
    return np.stack([found[key] for key in keys])
