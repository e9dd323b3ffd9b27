"""Where the joints are commanded to be at any instant: paths, each a function of time, and their sequence."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from lite6jax.arms.arm import Arm
from lite6jax.errors import InputError
from lite6jax.recordings import outside_limits, read_recording, recording_file
from lite6jax.simulation.motions import MARGIN, PERIODS_S, RUN_UP_S, SINES, SPEED

Array = NDArray[np.floating]

MAX_SPEED = float(np.deg2rad(180.0))
MAX_ACCELERATION = float(np.deg2rad(1146.0))
"""rad/s and rad/s² of every joint of a Lite 6."""


class Path(ABC):
    """A motion from time 0 on; it stands still before and after."""

    @property
    @abstractmethod
    def duration(self) -> float:
        """s, until it stands; infinite for one that never does."""

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
        """`(joint,)` rad, where it comes to stand."""
        return self.at(np.array([self.duration]))[0][0]


@final
@dataclass(frozen=True, eq=False)
class Rest(Path):
    """Standing at one place for a while."""

    position: Array
    length: float = 0.0

    @property
    def duration(self) -> float:
        """As given."""
        return self.length

    def at(self, time: Array) -> tuple[Array, Array]:
        """The place, and no velocity."""
        position = np.broadcast_to(self.position, (len(time), len(self.position)))
        return position, np.zeros_like(position)


@final
@dataclass(frozen=True, eq=False)
class PointToPoint(Path):
    """From rest to rest: all joints start and arrive together, the one with the furthest way keeps to the limits.

    Speed rises at constant acceleration, stays, and falls (a trapezoid; a triangle on a short way).
    """

    origin: Array
    goal: Array
    speed: float = MAX_SPEED
    acceleration: float = MAX_ACCELERATION

    @cached_property
    def _times(self) -> tuple[float, float]:
        """The time spent speeding up, and that between speeding up and slowing down."""
        way = float(np.abs(self.goal - self.origin).max())
        ramp = min(self.speed / self.acceleration, np.sqrt(way / self.acceleration))
        return (ramp, way / (self.acceleration * ramp) - ramp) if ramp else (0.0, 0.0)

    @property
    def duration(self) -> float:
        """Two ramps and what is between."""
        ramp, level = self._times
        return 2 * ramp + level

    def at(self, time: Array) -> tuple[Array, Array]:
        """A straight line in joint space."""
        ramp, level = self._times
        change = self.goal - self.origin
        if not ramp:
            return Rest(self.goal).at(time)
        t = np.clip(time, 0.0, self.duration)
        left = self.duration - t
        pace = np.minimum(np.minimum(t, left) / ramp, 1.0) / (ramp + level)
        gone = np.where(
            t <= ramp,
            t**2 / (2 * ramp),
            np.where(left <= ramp, ramp + level - left**2 / (2 * ramp), t - ramp / 2),
        ) / (ramp + level)
        inside = (time >= 0) & (time <= self.duration)
        # from the nearer end, so that both are met to the last bit
        near, after = np.outer(gone, change), np.outer(1 - gone, change)
        position = np.where((gone > 0.5)[:, None], self.goal - after, self.origin + near)
        return position, np.outer(pace * inside, change)


@final
@dataclass(frozen=True, eq=False)
class Brake(Path):
    """From full motion to rest at constant deceleration, all joints together."""

    origin: Array
    velocity: Array
    deceleration: float = MAX_ACCELERATION

    @property
    def duration(self) -> float:
        """As the fastest joint needs."""
        return float(np.abs(self.velocity).max()) / self.deceleration

    def at(self, time: Array) -> tuple[Array, Array]:
        """A parabola."""
        t, T = np.clip(time, 0.0, self.duration), max(self.duration, 1e-9)
        return self.origin + np.outer(t - t**2 / (2 * T), self.velocity), np.outer(1 - t / T, self.velocity)


@final
@dataclass(frozen=True, eq=False)
class Servo(Path):
    """Straight to a place at constant speed within one control period, or as long as the limit of speed asks."""

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
    """Every joint follows a sum of sines for ever, from rest; limits of range and speed hold at all times.

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
        """Without end."""
        return np.inf

    def at(self, time: Array) -> tuple[Array, Array]:
        """The path is walked by a clock that starts from rest."""
        x = np.clip(time / RUN_UP_S, 0.0, 1.0)
        pace = x**3 * (10 - 15 * x + 6 * x * x)
        clock = RUN_UP_S * x**4 * (2.5 - 3 * x + x * x) + np.maximum(time - RUN_UP_S, 0.0)
        angle = clock[:, None, None] * self.rate + self.phase
        velocity = (self.amplitude * self.rate * np.cos(angle)).sum(1)
        return self.centre + (self.amplitude * np.sin(angle)).sum(1), pace[:, None] * velocity


def draw_sines(limits: Array, seed: int = 0, speed: float = SPEED) -> Sines:
    """Sines as those of a simulated trajectory, over nine tenths of each joint's range (one turn at most).

    Args:
        limits: `(joint, 2)` rad.
        seed: of what is drawn.
        speed: rad/s that no joint exceeds.
    """
    rng = np.random.default_rng([seed, 0])
    centre, half = _ranges(limits)
    shape = (SINES, len(limits))
    amplitude = rng.uniform(0.2, 1.0, shape)
    amplitude *= half / amplitude.sum(0)
    shortest, longest = np.log(PERIODS_S)
    rate = 2 * np.pi / np.exp(rng.uniform(shortest, longest, shape))
    rate *= np.minimum(1.0, speed / (amplitude * rate).sum(0))
    return Sines(centre, amplitude, rate, rng.uniform(-np.pi, np.pi, shape))


def draw_places(limits: Array, count: int = 200, seed: int = 0) -> Array:
    """`(count, joint)` rad, drawn evenly over nine tenths of each joint's range (one turn at most)."""
    centre, half = _ranges(limits)
    return centre + half * np.random.default_rng([seed, 1]).uniform(-1, 1, (count, len(limits)))


def _ranges(limits: Array) -> tuple[Array, Array]:
    lower, upper = np.clip(limits, -2 * np.pi, 2 * np.pi).T
    return (lower + upper) / 2, np.minimum((upper - lower) / 2, np.pi) * (1 - 2 * MARGIN)


@final
@dataclass(frozen=True, eq=False)
class Visits(Path):
    """From place to place, a while at each, round and round without end."""

    parts: tuple[Path, ...]

    @property
    def duration(self) -> float:
        """Without end."""
        return np.inf

    @cached_property
    def _starts(self) -> Array:
        return np.cumsum([0.0, *(part.duration for part in self.parts)])

    def at(self, time: Array) -> tuple[Array, Array]:
        """Of the part that has its turn."""
        within = np.where(time > 0, time % self._starts[-1], 0.0)
        part = np.clip(np.searchsorted(self._starts, within, side="right") - 1, 0, len(self.parts) - 1)
        dof = len(self.parts[0].start)
        position, velocity = np.empty((len(time), dof)), np.empty((len(time), dof))
        for i in np.unique(part):
            mine = part == i
            position[mine], velocity[mine] = self.parts[i].at(within[mine] - self._starts[i])
        return position, velocity


def visits(places: ArrayLike, pause: float = 1.0, speed: float = MAX_SPEED / 2, acceleration: float = 10.0) -> Visits:
    """To each place `(place, joint)` in turn and back to the first, `pause` s at each."""
    stops = np.asarray(places, float)
    parts: list[Path] = []
    for here, there in zip(stops, np.roll(stops, -1, axis=0), strict=True):
        parts += [Rest(here, pause), PointToPoint(here, there, speed, acceleration)]
    return Visits(tuple(parts))


@final
@dataclass(frozen=True, eq=False)
class Played(Path):
    """Samples, smoothly joined, once."""

    spline: CubicSpline

    @property
    def duration(self) -> float:
        """To the last sample."""
        return float(self.spline.x[-1])

    def at(self, time: Array) -> tuple[Array, Array]:
        """The cubic spline through the samples."""
        t = np.clip(time, 0.0, self.duration)
        inside = ((time >= 0) & (time <= self.duration))[:, None]
        return self.spline(t), self.spline(t, 1) * inside


def played(time: ArrayLike, position: ArrayLike) -> Played:
    """Samples `(sample, joint)` rad at rising times `(sample,)` s; it starts and ends at rest."""
    t = np.asarray(time, float)
    return Played(CubicSpline(t - t[0], np.asarray(position, float), bc_type="clamped"))


class Timeline:
    """What the joints did and are to do: paths one after the other, each from an instant on until the next starts."""

    KEEP = 5.0
    """s for which the past is remembered."""

    def __init__(self, position: ArrayLike) -> None:
        """Stands at `(joint,)` rad."""
        self._paths: list[tuple[float, Path]] = [(-np.inf, Rest(np.array(position, float)))]

    @property
    def end(self) -> float:
        """s, when the last path comes to stand; infinite where it does not."""
        start, path = self._paths[-1]
        return start + path.duration if path.duration else start

    def then(self, path: Path, start: float) -> None:
        """Goes on with `path` from `start` on, which is not before another's start."""
        while len(self._paths) > 1 and self._paths[1][0] < start - self.KEEP:
            del self._paths[0]
        self._paths.append((start, path))

    def stop(self, now: float) -> None:
        """Drops what is to come and brakes."""
        position, velocity = (part[0] for part in self.at(np.array([now])))
        self._paths = [entry for entry in self._paths if entry[0] <= now]
        self.then(Brake(position, velocity), now)

    def at(self, time: Array) -> tuple[Array, Array]:
        """Positions and velocities `(sample, joint)` at rising times `(sample,)` s."""
        cuts = np.searchsorted(time, [start for start, _ in self._paths[1:]], side="left")
        pieces = np.split(time, cuts)
        parts = [
            path.at(piece - start if np.isfinite(start) else piece)
            for (start, path), piece in zip(self._paths, pieces, strict=True)
            if len(piece)
        ]
        if len(parts) == 1:
            return parts[0]
        positions, velocities = zip(*parts, strict=True)
        return np.concatenate(positions), np.concatenate(velocities)


def peak_speed(path: Path, time: ArrayLike | None = None) -> float:
    """rad/s, the highest speed of any joint at `time` `(sample,)` s; all along a path that ends where not given."""
    times = np.linspace(0.0, path.duration, 20001) if time is None else np.asarray(time)
    return float(np.abs(path.at(times)[1]).max())


PROGRAMS = ("rest", "sines", "poses")


def read_path(what: str, arm: Arm, seed: int = 0) -> Path | None:
    """What an arm is to do: a program by name, or the motion in a recording.

    Args:
        what: `rest`; `sines`, a smooth motion without end; `poses`, from pose to pose all over the joints' ranges; or a
            recording's file: a trajectory is played once, static poses are visited round and round.
        arm: its joints and limits.
        seed: of what is drawn.

    Returns:
        None for rest.

    Raises:
        InputError: neither a program nor a recording, one of another arm, beyond its limits, or too fast for it.
    """
    if what == "rest":
        return None
    if what == "sines":
        return draw_sines(arm.joint_limits, seed)
    if what == "poses":
        return visits(draw_places(arm.joint_limits, seed=seed))
    if recording_file(what) is None:
        raise InputError(f"--motion {what!r}: is neither {', '.join(PROGRAMS)} nor a recording's file")
    recording = read_recording(what, dof=arm.dof, joint_limits=arm.joint_limits)
    for outside in outside_limits(recording, arm.joint_limits):
        raise InputError(
            f"{what}: joint {outside.joint} is {np.rad2deg(outside.largest_excess_rad):.3g}° beyond its limits in row "
            f"{outside.rows[0]}; give a motion that this arm can do"
        )
    if recording.motion == "static" or recording.time is None or recording.samples == 1:
        return visits(recording.joint_position)
    if (np.diff(recording.time) <= 0).any():
        raise InputError(f"{what}: time does not rise from row to row; sort the rows, and keep one run")
    path = played(recording.time, recording.joint_position)
    knots = path.spline.x
    speed = peak_speed(path, np.sort(np.concatenate([knots, (knots[1:] + knots[:-1]) / 2])))
    if speed > 1.02 * MAX_SPEED:
        raise InputError(
            f"{what}: a joint turns at {np.rad2deg(speed):.0f}°/s, and the arm at {np.rad2deg(MAX_SPEED):.0f}°/s at "
            "most; give a slower motion"
        )
    return path
