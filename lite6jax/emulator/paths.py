"""Motions of the emulated joints as functions of time: paths, one after the other, and programs of them."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, PPoly

from lite6jax.arms.arm import Arm
from lite6jax.errors import InputError
from lite6jax.recordings import outside_limits, read_recording, recording_file
from lite6jax.simulation.motions import Sines, draw_motion, draw_sines

Array = NDArray[np.floating]

MAX_SPEED = float(np.deg2rad(180.0))
MAX_ACCELERATION = float(np.deg2rad(1146.0))
"""rad/s and rad/s², the limits of every joint of a Lite 6."""


@final
@dataclass(frozen=True, eq=False)
class Polynomials:
    """A path of polynomials in time, of which the last is constant, or a cycle of them, of infinite duration (s)."""

    pieces: PPoly
    duration: float

    def at(self, time: Array) -> tuple[Array, Array]:
        """Positions and velocities `(sample, joint)` in rad and rad/s at `(sample,)` s from 0 on."""
        return self.pieces(time), self.pieces(time, 1)


Path = Polynomials | Sines
"""A motion from time 0 on."""

_Piece = tuple[float, ArrayLike, ArrayLike, ArrayLike]
"""Duration in s, half the acceleration, velocity at the start, position at the start, `(joint,)` each."""


def _join(pieces: Iterable[_Piece], goal: Array) -> Polynomials:
    """A path of pieces, and then standstill at `goal`."""
    kept = [piece for piece in pieces if piece[0] > 0]
    times = np.cumsum([0.0, *(piece[0] for piece in kept), 1.0])
    zero = np.zeros_like(goal)
    rows = [[np.broadcast_to(part, goal.shape) for part in piece[1:]] for piece in kept]
    return Polynomials(PPoly(np.swapaxes([*rows, [zero, zero, goal]], 0, 1), times), float(times[-2]))


def rest(position: ArrayLike) -> Polynomials:
    """Standstill at `(joint,)` rad."""
    return _join([], np.array(position, float))


def move(origin: Array, goal: Array, speed: float = MAX_SPEED, acceleration: float = MAX_ACCELERATION) -> Polynomials:
    """From rest to rest, with all joints synchronous; the joint with the longest way determines the limits.

    The profile of the speed is a trapezoid, or a triangle on a short way.
    """
    return _join(_ramps(origin, goal, speed, acceleration), goal)


def _ramps(origin: Array, goal: Array, speed: float, acceleration: float) -> list[_Piece]:
    way = float(np.abs(goal - origin).max())
    ramp = min(speed / acceleration, np.sqrt(way / acceleration))
    if not ramp:
        return []
    level = max(way / (acceleration * ramp) - ramp, 0.0)
    peak = (goal - origin) / (ramp + level)
    half, zero = peak / (2 * ramp), np.zeros_like(goal)
    return [
        (ramp, half, zero, origin),
        (level, zero, peak, origin + half * ramp**2),
        (ramp, -half, peak, goal - half * ramp**2),
    ]


def brake(origin: Array, velocity: Array, deceleration: float = MAX_ACCELERATION) -> Polynomials:
    """From motion to rest at constant deceleration, with all joints synchronous."""
    duration = float(np.abs(velocity).max()) / deceleration
    half = velocity / (2 * duration) if duration else 0.0
    return _join([(duration, -np.asarray(half), velocity, origin)], origin + velocity * duration / 2)


def servo(origin: Array, goal: Array, period: float) -> Polynomials:
    """To a position at constant speed within one control period in s, or longer by the limit of speed."""
    duration = max(period, float(np.abs(goal - origin).max()) / MAX_SPEED)
    return _join([(duration, 0.0, (goal - origin) / duration, origin)], goal)


def visit(
    places: ArrayLike, pause: float = 1.0, speed: float = MAX_SPEED / 2, acceleration: float = 10.0
) -> Polynomials:
    """An endless cycle through positions `(place, joint)` rad with a pause of `pause` s at each."""
    stops, pieces = np.asarray(places, float), []
    for here, there in zip(stops, np.roll(stops, -1, axis=0), strict=True):
        pieces += [(pause, 0.0, 0.0, here), *_ramps(here, there, speed, acceleration)]
    once = _join(pieces, stops[0]).pieces
    return Polynomials(PPoly(once.c[:, :-1], once.x[:-1], extrapolate="periodic"), np.inf)


def interpolate(time: ArrayLike, position: ArrayLike) -> Polynomials:
    """The cubic spline through samples `(sample, joint)` rad at increasing times `(sample,)` s, from rest to rest."""
    t, q = np.asarray(time, float), np.asarray(position, float)
    spline = CubicSpline(t - t[0], q, bc_type="clamped")
    duration = float(spline.x[-1])
    spline.extend(np.stack([*np.zeros((3, 1, q.shape[1])), q[-1:]]), [duration + 1.0])
    return Polynomials(spline, duration)


class Timeline:
    """A sequence of paths, each valid from its start until that of the next one."""

    KEEP = 5.0
    """s, for which past paths are kept."""

    def __init__(self, position: ArrayLike) -> None:
        """Starts at rest at `(joint,)` rad."""
        self._paths: list[tuple[float, Path]] = [(-np.inf, rest(position))]

    @property
    def end(self) -> float:
        """s, the end of the last path; infinite for an endless one."""
        start, path = self._paths[-1]
        return start + path.duration if path.duration else start

    def append(self, path: Path, start: float) -> None:
        """Appends `path` from `start` s on, not before the start of the last one."""
        while len(self._paths) > 1 and self._paths[1][0] < start - self.KEEP:
            del self._paths[0]
        self._paths.append((start, path))

    def stop(self, now: float) -> None:
        """Removes later paths and brakes."""
        position, velocity = (part[0] for part in self.at(np.array([now])))
        self._paths = [entry for entry in self._paths if entry[0] <= now]
        self.append(brake(position, velocity), now)

    def at(self, time: Array) -> tuple[Array, Array]:
        """Positions and velocities `(sample, joint)` at increasing times `(sample,)` s."""
        pieces = np.split(time, np.searchsorted(time, [start for start, _ in self._paths[1:]], side="left"))
        parts = [
            path.at(piece - start if np.isfinite(start) else piece)
            for (start, path), piece in zip(self._paths, pieces, strict=True)
            if len(piece)
        ]
        positions, velocities = zip(*parts, strict=True)
        return np.concatenate(positions), np.concatenate(velocities)


PROGRAMS = ("rest", "sines", "poses")


def read_path(what: str, arm: Arm, seed: int = 0) -> Path | None:
    """The motion of an arm: a program by name, or the motion in a recording.

    Args:
        what: `rest`; `sines`, an endless smooth motion; `poses`, an endless cycle of poses over the joints' ranges; or
            the file of a recording: a trajectory is played once, static poses are repeated in a cycle.
        arm: its joints and limits.
        seed: of the drawing.

    Returns:
        None for rest.

    Raises:
        InputError: neither a program nor a recording, or a recording of another arm, beyond its limits or too fast.
    """
    if what == "rest":
        return None
    if what == "sines":
        return draw_sines(arm, seed)
    if what == "poses":
        return visit(draw_motion(arm, samples=200, seed=seed).joint_position)
    if recording_file(what) is None:
        raise InputError(f"--motion {what!r}: is neither {', '.join(PROGRAMS)} nor a recording's file")
    recording = read_recording(what, arm=arm, joint_limits=arm.joint_limits)
    for outside in outside_limits(recording, arm.joint_limits):
        raise InputError(
            f"{what}: joint {outside.joint} is {np.rad2deg(outside.largest_excess_rad):.3g}° beyond its limits in row "
            f"{outside.rows[0]}; give a motion that this arm can do"
        )
    if recording.motion == "static" or recording.time is None or recording.samples == 1:
        return visit(recording.joint_position)
    if (np.diff(recording.time) <= 0).any():
        raise InputError(f"{what}: time does not increase from row to row; sort the rows, and keep one run")
    path = interpolate(recording.time, recording.joint_position)
    knots = path.pieces.x
    speed = np.abs(path.at(np.concatenate([knots, (knots[1:] + knots[:-1]) / 2]))[1]).max()
    if speed > 1.02 * MAX_SPEED:
        raise InputError(
            f"{what}: a joint moves at {np.rad2deg(speed):.0f}°/s, but the limit is {np.rad2deg(MAX_SPEED):.0f}°/s; "
            "give a slower motion"
        )
    return path
