"""Families of effects on torques that a search needs: ripple of every order, curves, and functions without a name."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, product
from typing import final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.joint_units import as_revolute
from lite6jax.domains.torque.rows import TorqueRows
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.dynamic.motors import TorqueLag, TorqueRipple
from lite6jax.effects.dynamic.torque_effect import DIRECTION_SPEED, Dynamics, JointTorque, TorqueEffect
from lite6jax.effects.dynamic.unnamed import UnnamedTorque, waves
from lite6jax.effects.waves import wave_angle
from lite6jax.estimation.problem import LOCAL_FORMS, CurveDriver, CurveFamily, Mask, PeriodicFamily
from lite6jax.estimation.terms import Term

Array = NDArray[np.floating]

_PIECES = {"position": (4, 8, 16), "velocity": (4, 8), "gravity torque": (4, 8)}
"""Numbers of intervals of the splines that are tried."""
_SIGNED_PIECES = {"position": (4, 8, 16), "speed": (2, 4), "gravity torque": (4, 8)}
"""Likewise of those times the direction of motion. Over the speed they are odd functions of the velocity, as friction
mostly is, so that what one direction shows holds for the other at speeds that only the first reached."""
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
_EVERYWHERE = ("time",)
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
                partial(ripple.curve, position),
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

    def curve(
        self,
        position: Array,
        orders: Sequence[float] | Array,
        training: Mask,
        prior: tuple[float, float, float] | None,
        fade: float,
    ) -> UnnamedTorque:
        """Several orders; nothing is known of coefficients beforehand, and it does not fade out."""
        return waves(self.joint, position[training], np.asarray(orders) / self.turn, self.of_slide)


def curves(dynamics: Dynamics, data: TorqueRows, chosen: NDArray[np.integer], noise: Array) -> tuple[CurveFamily, ...]:
    """The curves of each joint over its position, its speed and its load, and those times its direction of motion."""
    found = []
    for j, signed in product(range(len(noise)), (False, True)):
        drivers = []
        for quantity, pieces in (_SIGNED_PIECES if signed else _PIECES).items():
            of_slide = bool(data.arm.slides[j])
            driver = joint_driver(quantity, j + 1, of_slide)
            values = driver_values(driver, dynamics)
            if values is None:
                continue
            values = values[data.filter.kept][chosen]
            spline = partial(_spline, j + 1, driver.phrase, signed, float(sizes(data)[j]), of_slide)
            local = LOCAL_FORMS if quantity == "position" and not signed else ()
            drivers.append(CurveDriver(values, pieces, local, spline))
        column = torque_at(j, noise)
        if signed:
            column = column * dynamics.direction(j + 1)[data.filter.kept][chosen]
        found.append(CurveFamily(f"joint{j + 1}", column, tuple(drivers)))
    return tuple(found)


def flexible(dynamics: Dynamics, sizes: Array) -> tuple[UnnamedTorque, ...]:
    """Functions of every driver at every joint, as far as drivers are known and vary.

    They are of the position of any joint, of the joint's own velocity, load and temperature, and of time; those of
    position, load, temperature and speed also times the direction of motion, and the first three times the velocity, as
    friction is; of the travel since the last reversal times the direction, as friction before sliding is; and of the
    position times the load, as what meshing teeth do is.

    Args:
        dynamics: of every sample.
        sizes: `(joint,)` Nm, of the torques that were measured, which no curve exceeds by much.
    """
    dof = dynamics.torque.shape[0]
    slides = [False, *dynamics.motion.sliding.mask(dof).tolist()]  # joints count from 1
    ranges = {d: _range(d, dynamics) for j in range(1, dof + 1) for d in _own(j, slides[j])}
    ranges |= {Driver(quantity): _range(Driver(quantity), dynamics) for quantity in _EVERYWHERE}
    found: list[UnnamedTorque] = []

    def add(
        joint: int,
        drivers: Sequence[Driver],
        pieces: int = 8,
        signed: bool = False,
        degree: int = 0,
        full_load: float = 0.0,
    ) -> None:
        spans = [ranges.get(driver) for driver in drivers]
        if any(span is None for span in spans):
            return
        (lower, upper), *further = [span for span in spans if span is not None]
        phrase = " and ".join(driver.phrase for driver in drivers)
        bounds = tuple(bound for span in further for bound in span)
        spread = float(sizes[joint - 1])
        found.append(
            UnnamedTorque(
                *(joint, phrase, lower, upper, pieces, signed),
                spread=spread,
                degree=degree,
                further=bounds,
                full_load=full_load,
                of_slide=slides[joint],
            )
        )

    for j in range(1, dof + 1):
        position, velocity, speed, load, temperature, travel = _own(j, slides[j])
        for signed in (False, True):
            for pieces in (3, 10):
                add(j, [position], pieces, signed)
            add(j, [load], 4, signed)
            add(j, [temperature], 3, signed)
            for everywhere in _EVERYWHERE:
                add(j, [Driver(everywhere)], 4, signed)
        for pieces in (3, 8):
            add(j, [velocity], pieces)
        for pieces in (2, 4):
            add(j, [speed], pieces, signed=True)
        add(j, [travel], 8, signed=True)
        for other in (position, load, temperature):
            add(j, [velocity, other], degree=3)
        add(j, [position], degree=4)  # a cable that is drawn out
        # teeth that mesh under load
        if (bounds := ranges.get(load)) is not None:
            for pieces in (10, 40):
                add(j, [position], pieces, full_load=max(map(abs, bounds)))
        # a gain that drifts or warms, as of a sensor of torque or current
        for other in (Driver("time"), temperature):
            add(j, [load, other], degree=2)
        for k in range(1, dof + 1):
            if k != j:
                for quantity in ("position", "velocity"):
                    add(j, [joint_driver(quantity, k, slides[k])], 6)
        for a, b in combinations(range(1, dof + 1), 2):
            if j in (a, b):
                add(j, [joint_driver("position", k, slides[k]) for k in (a, b)], degree=3)
    return tuple(found)


def joints_of(effect: TorqueEffect) -> slice:
    """The joints, of all, that an effect acts on: most effects act on one."""
    return slice(effect.joint - 1, effect.joint) if isinstance(effect, JointTorque | TorqueLag) else slice(None)


def unit_torques(effect: TorqueEffect, dynamics: Dynamics, kept: Callable[[Array], Array]) -> Array:
    """Torques `(number, joint, sample)` by each number of a linear effect, of `joints_of` it, filtered by `kept`."""
    if not isinstance(effect, JointTorque):
        return kept(np.stack([effect.torque(unit, dynamics) for unit in np.eye(effect.size)]))
    if isinstance(effect, UnnamedTorque):
        rows = effect.basis(dynamics)
    else:
        rows = np.stack([effect.at_joint(unit, dynamics) for unit in np.eye(effect.size)])
    return kept(rows)[:, None]


def _own(j: int, of_slide: bool) -> list[Driver]:
    """Position, velocity, speed, load, temperature and travel since reversal of a joint."""
    quantities = ("position", "velocity", "speed", "gravity torque", "temperature", "travel since reversal")
    return [joint_driver(quantity, j, of_slide) for quantity in quantities]


def driver_values(driver: Driver, dynamics: Dynamics) -> Array | None:
    """`(sample,)` in the driver's unit; None where the motion or the loads do not contain it."""
    loads = dynamics.loads if driver.loaded else None
    return np.asarray(driver.values(dynamics.motion, loads)) if driver.known(dynamics.motion, loads) else None


def _range(driver: Driver, dynamics: Dynamics) -> tuple[float, float] | None:
    """Lower and upper of a driver; None where it is not known or does not vary."""
    values = driver_values(driver, dynamics)
    if values is None:
        return None
    usual = Driver(driver.generalised, driver.place).unit
    if np.ptp(as_revolute(values, usual, driver.of_slide)) < _LEAST_VARIED:
        return None
    return float(values.min()), float(values.max())


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


def sizes(data: TorqueRows) -> Array:
    """`(joint,)` Nm, the range of the torques that were measured, rounded."""
    return np.array([float(f"{max(size, 1e-6):.2g}") for size in np.ptp(data.measured, axis=1)])


def _spline(
    joint: int, driver: str, signed: bool, spread: float, of_slide: bool, lower: float, upper: float, pieces: int
) -> UnnamedTorque:
    return UnnamedTorque(joint, driver, lower, upper, pieces, signed, spread=spread, of_slide=of_slide)
