"""Motions of the emulated joints as functions of time: paths, and programs of them."""

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
    """A path of polynomials in time, or a cycle of them, of infinite duration (s)."""

    pieces: PPoly
    duration: float

    def at(self, time: Array) -> tuple[Array, Array]:
        """Positions and velocities `(sample, joint)` in rad and rad/s at `(sample,)` s from 0 to the duration."""
        return self.pieces(time), self.pieces(time, 1)


Path = Polynomials | Sines
"""A motion from time 0 on."""


def rest(position: ArrayLike) -> Polynomials:
    """Standstill at `(joint,)` rad."""
    return Polynomials(PPoly(np.array(position, float)[None, None], [0.0, 1.0]), 0.0)


def visit(
    places: ArrayLike, pause: float = 1.0, speed: float = MAX_SPEED / 2, acceleration: float = 10.0
) -> Polynomials:
    """An endless cycle through positions `(place, joint)` rad with a pause of `pause` s at each.

    Between them all joints are synchronous. The profile of the speed is a trapezoid, or a triangle on a short way, of
    which the joint with the longest way determines the limits.
    """
    stops = np.asarray(places, float)
    pieces, zero = [], np.zeros(stops.shape[1])  # duration, half the acceleration, velocity and position at the start
    for here, there in zip(stops, np.roll(stops, -1, axis=0), strict=True):
        if pause:
            pieces.append((pause, zero, zero, here))
        way = float(np.abs(there - here).max())
        ramp = min(speed / acceleration, np.sqrt(way / acceleration))
        if not ramp:
            continue
        level = max(way / (acceleration * ramp) - ramp, 0.0)
        peak = (there - here) / (ramp + level)
        half = peak / (2 * ramp)
        pieces.append((ramp, half, zero, here))
        if level:
            pieces.append((level, zero, peak, here + half * ramp**2))
        pieces.append((ramp, -half, peak, there - half * ramp**2))
    durations, *coefficients = zip(*pieces, strict=True)
    ends = np.cumsum([0.0, *durations])
    return Polynomials(PPoly(np.array(coefficients), ends, extrapolate="periodic"), np.inf)


def interpolate(time: ArrayLike, position: ArrayLike) -> Polynomials:
    """The cubic spline through samples `(sample, joint)` rad at increasing times `(sample,)` s, from rest to rest."""
    t = np.asarray(time, float)
    return Polynomials(CubicSpline(t - t[0], np.asarray(position, float), bc_type="clamped"), float(t[-1] - t[0]))


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
