"""What a family of physics outside the catalogue is, what it can depend on, and the words for that.

Shares no code with the library; the names of drivers are those of its public documents. Every family is one number
times a signal without a unit, at a joint (an angle), at a link, the base, the tool or the sensor (one component of a
twist), or in the sensor's image (a shift that depends on the measured position).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain

import numpy as np

from benchmarks.concealed.chain import Array

Fixed = Mapping[str, float]
Drivers = tuple[tuple[str, ...], ...]
"""Each of these is a driver of the signal; one of several phrases is enough to name it."""

PRELOAD = 0.5
"""Of the load: the moment at which bolts that are tightened begin to give, or a detent does."""
CREEP = 4.0
"""Time constants of a creep that a recording lasts."""
ROCKING = 4.0
"""A moment of one part in so many of the load tips a base from one foot to another."""
WARMER = 10.0
"""K: temperatures count in these."""
_AMBIENT = 25.0
"""°C."""


@dataclass(frozen=True, eq=False)
class Signals:
    """What a signal can depend on; all arrays with the sample first.

    Attributes:
        q: `(sample, joint)` rad.
        dq: `(sample, joint)` rad/s.
        direction: `(sample, joint)`, -1, 0 or 1.
        time: `(sample,)` s.
        temperature: `(sample, joint)` °C.
        moment: `(sample, joint, 3)` Nm, of gravity about each frame's origin in its axes.
        base_moment: `(sample, 3)` Nm.
    """

    q: Array
    dq: Array
    direction: Array
    time: Array
    temperature: Array
    moment: Array
    base_moment: Array

    def warmth(self) -> Array:
        """`(sample,)`: the mean temperature above the ambient one, in tens of K."""
        return (self.temperature.mean(1) - _AMBIENT) / WARMER


@dataclass(frozen=True)
class Family:
    """A family of physics.

    Attributes:
        place: joint, link, base, tool, sensor or image.
        number: the name of its one number, with its unit.
        signal: `(sample,)` by which the number is multiplied; None where it depends on the way between the samples or
            on the measured position.
        keys: what is drawn for it beside the site.
        axes: the components of a twist (x y z, then turns about them) among which one is drawn.
        drivers: on what the signal depends.
        beside: effects of the catalogue that are true beside an unnamed one at the same site: they are its straight
            part.
        sum_of: effects of the catalogue, at the same site, of which it is the sum: they are true together.
        loaded: whether it needs gravity's moments.
        moving: whether it needs velocities.
        warm: whether it needs temperatures that vary.
        skipping: whether "by" is never the next joint, whose axis would wobble by its own position.
    """

    place: str
    number: str
    signal: Callable[[Fixed, Signals], Array] | None
    keys: tuple[str, ...]
    drivers: Callable[[Fixed], Drivers]
    axes: tuple[int, ...] = ()
    beside: tuple[str, ...] = ()
    sum_of: tuple[str, ...] = ()
    loaded: bool = False
    moving: bool = False
    warm: bool = False
    skipping: bool = False


def column(values: Array, fixed: Fixed, key: str = "joint") -> Array:
    """`(sample,)` of `(sample, joint)`: of the family's joint, or of the one that another key says."""
    return values[:, int(fixed[key]) - 1]


def signed_power(values: Array, power: float) -> Array:
    """`(sample,)`: a power of the size, with the sign of the value."""
    return np.sign(values) * np.abs(values) ** power


def beyond(values: Array, free: float) -> Array:
    """`(sample,)`: by how much values are beyond what is free, whichever way."""
    return np.sign(values) * np.maximum(np.abs(values) - free, 0.0)


def bump(values: Array, centre: float, width: float) -> Array:
    """`(sample,)`: 1 at the centre, and a half at 1.2 widths from it."""
    return np.exp(-0.5 * ((values - centre) / width) ** 2)


def torque(fixed: Fixed, s: Signals) -> Array:
    """`(sample,)`: gravity's torque at the family's joint, over the drawn `torque_Nm`."""
    return column(s.moment[..., 2], fixed) / fixed["torque_Nm"]


def own(quantity: str, key: str = "joint") -> Callable[[Fixed], Drivers]:
    """A quantity of the family's joint, or of the one that another key says."""
    return lambda fixed: ((f"{quantity} {int(fixed[key])}",),)


def either(*quantities: str, key: str = "joint") -> Callable[[Fixed], Drivers]:
    """One driver of a joint that any of some quantities names."""
    return lambda fixed: (tuple(f"{quantity} {int(fixed[key])}" for quantity in quantities),)


def together(*each: Callable[[Fixed], Drivers]) -> Callable[[Fixed], Drivers]:
    """All the drivers of each."""
    return lambda fixed: tuple(chain.from_iterable(drivers(fixed) for drivers in each))


def phrases(*words: str) -> Callable[[Fixed], Drivers]:
    """One driver of the whole arm, named by any of some phrases."""
    return lambda fixed: (words,)


TEMPERATURE = phrases("temperature")  # of the arm or of a joint: they rise together
TIME = phrases("time")
POSITION = "position of joint"
TORQUE = "gravity torque of joint"
DIRECTION = "direction of motion of joint"
VELOCITY = "velocity of joint"
SPEED = "speed of joint"
BY_JOINT = own(POSITION, "by")
