"""What a family of physics outside the catalogue is, what it can depend on, and the words for that.

Shares no code with the library; the names of drivers are those of its public documents. Every family is one number
times a signal without a unit, at a joint (an angle), at a link, the base, the tool or the sensor (one component of a
twist), or in the sensor's image (a shift that depends on the measured position).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.chain import Array

Fixed = Mapping[str, float]
Curve = Callable[[Array], tuple[Array, Array]]
Drivers = tuple[tuple[str, ...], ...]
"""Each of these is a driver of the signal; one of several phrases is enough to name it."""

PRELOAD = 0.5  # of the load: the moment at which bolts that are tightened begin to give, or a detent does
ROCKING = 4.0  # a moment of one part in so many of the load tips a base from one foot to another
WARMER = 10.0  # K: temperatures count in these
_AMBIENT = 25.0  # °C


@dataclass(frozen=True, eq=False)
class Motion:
    """What the arm did; all arrays with the sample first."""

    q: Array  # `(sample, joint)` rad, as the encoders have it
    dq: Array  # `(sample, joint)` rad/s; zero where the arm stood still
    direction: Array  # `(sample, joint)`, -1, 0 or 1
    time: Array  # `(sample,)` s
    temperature: Array  # `(sample, joint)` °C
    payload: Array  # `(sample,)` kg
    curve: Curve | None = None  # joints and velocities at any instants, where the arm moved
    # `(sample, joint, 3)` Nm, of gravity about each frame's origin in its axes, once it is known
    moment: Array = field(default_factory=lambda: np.zeros((0, 0, 3)))
    base_moment: Array = field(default_factory=lambda: np.zeros((0, 3)))  # `(sample, 3)` Nm; likewise

    def warmth(self) -> Array:
        """`(sample,)`: the mean temperature above the ambient one, in tens of K."""
        return (self.temperature.mean(1) - _AMBIENT) / WARMER

    def later(self, offset: float) -> "Motion":
        """What the arm does `offset` s later."""
        if self.curve is None or offset == 0:
            return self
        q, dq = self.curve(self.time + offset)
        return replace(self, q=q, dq=dq, direction=np.sign(dq))

    def kept(self, most: int) -> NDArray[np.integer]:
        """So many of the samples' places at most, evenly over the motion."""
        return np.unique(np.linspace(0, len(self.q) - 1, most).astype(int))

    def thinned(self, most: int) -> "Motion":
        """So many of the samples at most, evenly over the motion."""
        kept = self.kept(most)
        names = ("q", "dq", "direction", "time", "temperature", "payload")
        return replace(self, **{name: getattr(self, name)[kept] for name in names})


@dataclass(frozen=True, eq=False)
class Scene:
    """What happens where a family is, of its own joint or of the one that a key says; what was drawn is its items."""

    fixed: Fixed  # what was drawn
    s: Motion  # what happens in the whole arm

    def __getitem__(self, key: str) -> float:
        return self.fixed[key]

    def q(self, key: str = "joint") -> Array:
        """`(sample,)` rad."""
        return column(self.s.q, self.fixed, key)

    def dq(self, key: str = "joint") -> Array:
        """`(sample,)` rad/s."""
        return column(self.s.dq, self.fixed, key)

    def side(self, key: str = "joint") -> Array:
        """`(sample,)`, -1, 0 or 1: the direction of motion."""
        return column(self.s.direction, self.fixed, key)

    def load(self, key: str = "joint") -> Array:
        """`(sample,)`: gravity's torque over the one that was drawn."""
        return column(self.s.moment[..., 2], self.fixed, key) / self[f"{'by_' if key == 'by' else ''}torque_Nm"]

    def moment(self, axis: str, at: str = "") -> Array:
        """`(sample,)`: gravity's moment about x or y of the link, "flange_" or "base_", over the one that was drawn."""
        whole = self.s.base_moment if at == "base_" else column(self.s.moment, self.fixed, at.strip("_") or "joint")
        return whole[:, "xy".index(axis)] / self[f"{at}moment_{'y_' if axis == 'y' else ''}Nm"]

    def share(self) -> Array:
        """`(sample,)`, 0 to 1: the part of the recording that is over."""
        return self.s.time / self["span_s"]

    def wave(self, turns: str = "turns") -> Array:
        """`(sample,)`: a sine of the time, as often as was drawn."""
        return np.sin(2 * np.pi * self[turns] * self.share() + self["phase"])


@dataclass(frozen=True)
class Family:
    """A family of physics."""

    place: str  # joint, link, base, tool, sensor or image
    # quantities on which the signal depends, as "torque, velocity/speed of by": of the family's own joint or of that of
    # a key, with a stroke between phrases of which one is enough
    on: str
    # `(sample,)` by which the number is multiplied, of what happens there; None where it depends on the way between the
    # samples or on the measured position alone
    signal: Callable[[Scene], Array] | None = None
    keys: str = ""  # words of what is drawn for it beside the site
    # words of effects of the catalogue that are true beside an unnamed one at the same site, as they are its straight
    # part; a constant or a scale is true as well. A tuple has all.
    beside: str | tuple[str, ...] = ""
    axes: tuple[int, ...] = ()  # the components of a twist (x y z, then turns about them) among which one is drawn
    # effects of the catalogue, at the same site, of which it is the sum: they are true together
    sum_of: tuple[str, ...] = ()
    height: bool = False  # whether its number is the height of a shape
    any_other: bool = False  # whether "by" may be the next joint too, whose axis would wobble by its own position
    drivers_of: Callable[[Fixed], Drivers] | None = None  # on what the signal depends, where `on` cannot say it
    # of the point that the sensor has at `(axis, sample)` m, the shift `(axis, sample)` m; None elsewhere
    image: Callable[[Array], Array] | None = None

    @property
    def number(self) -> str:
        """The name of its one number, with its unit."""
        if self.height:
            return "height_rad"
        return "turn_rad" if self.place == "joint" or min(self.axes, default=0) > 2 else "shift_m"

    @property
    def true_beside(self) -> tuple[str, ...]:
        """All that is true `beside` it."""
        constant = {"joint": "joint_offset", "tool": "tool_offset", "image": "measurement_scale"}
        constant |= dict.fromkeys(("link", "base"), "frame_offset")
        if isinstance(self.beside, tuple):
            return self.beside
        return (*self.beside.split(), *constant.get(self.place, "").split())

    @property
    def is_loaded(self) -> bool:
        """Whether it needs gravity's moments."""
        return "torque" in self.on or "moment" in self.on

    @property
    def is_carried(self) -> bool:
        """Whether it needs a payload that comes and goes."""
        return "payload" in self.on

    def drivers(self, fixed: Fixed) -> Drivers:
        """On what the signal depends."""
        if self.drivers_of:
            return self.drivers_of(fixed)
        each = (driver.partition(" of ") for driver in self.on.split(", "))
        return tuple(
            tuple(f"{_OF[w]} {int(fixed[key or 'joint'])}" if w in _OF else w for w in words.split("/"))
            for words, _, key in each
        )


joint, link, base, tool, sensor, image = (
    partial(Family, place) for place in ("joint", "link", "base", "tool", "sensor", "image")
)
"""Families of a place."""


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


def play(values: Array, half: float) -> Array:
    """`(sample,)`: what values push along that have so much play to either side of it."""
    return np.array([*accumulate(values, lambda x, now: min(max(x, now - half), now + half))])


def latch(values: Array, level: float) -> Array:
    """`(sample,)`, -1 or 1: the side on which values were last beyond a level, or where they began."""
    start = float(np.sign(values[0]))
    return np.array([*accumulate(values[1:], lambda x, v: np.sign(v) if abs(v) > level else x, initial=start)])


def lagged(values: Array, time: Array, constant: float) -> Array:
    """`(sample,)`: what comes after values with a time constant, from rest, where each has held since the last."""
    steps = zip(values[1:], -np.expm1(-np.diff(time) / constant), strict=True)
    return np.array([*accumulate(steps, lambda x, now: x + now[1] * (now[0] - x), initial=values[0])])


def wound(values: Array, run: float) -> Array:
    """`(sample,)`, -1 to 1: how far what slips along is wound up, the more slowly the more it is (P. Dahl, 1968)."""
    step = np.diff(values)
    ways = zip(np.sign(step), -np.expm1(-np.abs(step) / run), strict=True)
    return np.array([*accumulate(ways, lambda x, way: x + way[1] * (way[0] - x), initial=0.0)])


_OF = {
    "position": "position of joint",
    "torque": "gravity torque of joint",
    "direction": "direction of motion of joint",
    "velocity": "velocity of joint",
    "speed": "speed of joint",
    "travel": "travel since reversal of joint",
    "moment x": "gravity moment x of link",
    "moment y": "gravity moment y of link",
}
TILT = (3, 4)
X, Y, Z = np.eye(3)[:, :, None]
