"""Paths: motions of the joints as functions of time."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from lite6jax.simulation.motions import RUN_UP_S

Array = NDArray[np.floating]

MAX_SPEED = float(np.deg2rad(180.0))
MAX_ACCELERATION = float(np.deg2rad(1146.0))
"""rad/s and rad/s², the limits of every joint of a Lite 6."""


class Path(ABC):
    """A motion that starts at time 0, with standstill before and after."""

    @property
    @abstractmethod
    def duration(self) -> float:
        """s, until standstill; infinite for an endless motion."""

    @abstractmethod
    def at(self, time: Array) -> tuple[Array, Array]:
        """Positions and velocities `(sample, joint)` in rad and rad/s at `(sample,)` s."""

    @property
    @final
    def start(self) -> Array:
        """`(joint,)` rad."""
        return self.at(np.zeros(1))[0][0]

    @property
    @final
    def end(self) -> Array:
        """`(joint,)` rad, the final position."""
        return self.at(np.array([self.duration]))[0][0]


@final
@dataclass(frozen=True, eq=False)
class Rest(Path):
    """Standstill for a time."""

    position: Array
    length: float = 0.0

    @property
    def duration(self) -> float:
        """As given."""
        return self.length

    def at(self, time: Array) -> tuple[Array, Array]:
        """The position, and zero velocity."""
        position = np.broadcast_to(self.position, (len(time), len(self.position)))
        return position, np.zeros_like(position)


@final
@dataclass(frozen=True, eq=False)
class PointToPoint(Path):
    """From rest to rest, with all joints synchronous; the joint with the longest way determines the limits.

    The profile of the speed is a trapezoid, or a triangle on a short way.
    """

    origin: Array
    goal: Array
    speed: float = MAX_SPEED
    acceleration: float = MAX_ACCELERATION

    @cached_property
    def _times(self) -> tuple[float, float]:
        """s, the durations of the acceleration and of the constant speed."""
        way = float(np.abs(self.goal - self.origin).max())
        ramp = min(self.speed / self.acceleration, np.sqrt(way / self.acceleration))
        return (ramp, way / (self.acceleration * ramp) - ramp) if ramp else (0.0, 0.0)

    @property
    def duration(self) -> float:
        """Both ramps and the constant speed."""
        ramp, level = self._times
        return 2 * ramp + level

    def at(self, time: Array) -> tuple[Array, Array]:
        """A straight line in joint space."""
        ramp, level = self._times
        change = self.goal - self.origin
        if not ramp:
            return Rest(self.goal).at(time)
        t = np.clip(time, 0.0, self.duration)
        remaining = self.duration - t
        pace = np.minimum(np.minimum(t, remaining) / ramp, 1.0) / (ramp + level)
        share = np.where(
            t <= ramp,
            t**2 / (2 * ramp),
            np.where(remaining <= ramp, ramp + level - remaining**2 / (2 * ramp), t - ramp / 2),
        ) / (ramp + level)
        inside = (time >= 0) & (time <= self.duration)
        # from the nearer end, so that both ends are exact
        near, after = np.outer(share, change), np.outer(1 - share, change)
        position = np.where((share > 0.5)[:, None], self.goal - after, self.origin + near)
        return position, np.outer(pace * inside, change)


@final
@dataclass(frozen=True, eq=False)
class Brake(Path):
    """From motion to rest at constant deceleration, with all joints synchronous."""

    origin: Array
    velocity: Array
    deceleration: float = MAX_ACCELERATION

    @property
    def duration(self) -> float:
        """The braking time of the fastest joint."""
        return float(np.abs(self.velocity).max()) / self.deceleration

    def at(self, time: Array) -> tuple[Array, Array]:
        """A parabola."""
        t, T = np.clip(time, 0.0, self.duration), max(self.duration, 1e-9)
        return self.origin + np.outer(t - t**2 / (2 * T), self.velocity), np.outer(1 - t / T, self.velocity)


@final
@dataclass(frozen=True, eq=False)
class Servo(Path):
    """To a position at constant speed within one control period, or longer by the limit of speed."""

    origin: Array
    goal: Array
    period: float

    @property
    def duration(self) -> float:
        """At least one period."""
        return max(self.period, float(np.abs(self.goal - self.origin).max()) / MAX_SPEED)

    def at(self, time: Array) -> tuple[Array, Array]:
        """A line."""
        share = np.clip(time / self.duration, 0.0, 1.0)
        moving = (time >= 0) & (time < self.duration)
        change = self.goal - self.origin
        return self.goal - np.outer(1 - share, change), np.outer(moving / self.duration, change)


@final
@dataclass(frozen=True, eq=False)
class Sines(Path):
    """An endless sum of sines for each joint, from rest, within the limits of range and speed.

    Attributes:
        centre: `(joint,)` rad.
        amplitude: `(sine, joint)` rad.
        rate: `(sine, joint)` rad/s.
        phase: `(sine, joint)` rad.
    """

    centre: Array
    amplitude: Array
    rate: Array
    phase: Array

    @property
    def duration(self) -> float:
        """Infinite."""
        return np.inf

    def at(self, time: Array) -> tuple[Array, Array]:
        """The sines, with a time scaling that starts from rest."""
        x = np.clip(time / RUN_UP_S, 0.0, 1.0)
        pace = x**3 * (10 - 15 * x + 6 * x * x)
        clock = RUN_UP_S * x**4 * (2.5 - 3 * x + x * x) + np.maximum(time - RUN_UP_S, 0.0)
        angle = clock[:, None, None] * self.rate + self.phase
        velocity = (self.amplitude * self.rate * np.cos(angle)).sum(1)
        return self.centre + (self.amplitude * np.sin(angle)).sum(1), pace[:, None] * velocity


@final
@dataclass(frozen=True, eq=False)
class Visits(Path):
    """An endless cycle of motions and pauses."""

    parts: tuple[Path, ...]

    @property
    def duration(self) -> float:
        """Infinite."""
        return np.inf

    @cached_property
    def _starts(self) -> Array:
        return np.cumsum([0.0, *(part.duration for part in self.parts)])

    def at(self, time: Array) -> tuple[Array, Array]:
        """That of the part at this time of the cycle."""
        within = np.where(time > 0, time % self._starts[-1], 0.0)
        part = np.clip(np.searchsorted(self._starts, within, side="right") - 1, 0, len(self.parts) - 1)
        dof = len(self.parts[0].start)
        position, velocity = np.empty((len(time), dof)), np.empty((len(time), dof))
        for i in np.unique(part):
            rows = part == i
            position[rows], velocity[rows] = self.parts[i].at(within[rows] - self._starts[i])
        return position, velocity


def visits(places: ArrayLike, pause: float = 1.0, speed: float = MAX_SPEED / 2, acceleration: float = 10.0) -> Visits:
    """A cycle through positions `(place, joint)` rad with a pause of `pause` s at each."""
    stops = np.asarray(places, float)
    parts: list[Path] = []
    for here, there in zip(stops, np.roll(stops, -1, axis=0), strict=True):
        parts += [Rest(here, pause), PointToPoint(here, there, speed, acceleration)]
    return Visits(tuple(parts))


@final
@dataclass(frozen=True, eq=False)
class Played(Path):
    """An interpolation of samples, once."""

    spline: CubicSpline

    @property
    def duration(self) -> float:
        """The time of the last sample."""
        return float(self.spline.x[-1])

    def at(self, time: Array) -> tuple[Array, Array]:
        """The cubic spline through the samples."""
        t = np.clip(time, 0.0, self.duration)
        inside = ((time >= 0) & (time <= self.duration))[:, None]
        return self.spline(t), self.spline(t, 1) * inside


def played(time: ArrayLike, position: ArrayLike) -> Played:
    """The interpolation of samples `(sample, joint)` rad at increasing times `(sample,)` s, from rest to rest."""
    t = np.asarray(time, float)
    return Played(CubicSpline(t - t[0], np.asarray(position, float), bc_type="clamped"))
