"""Programs of an emulated arm: drawn motions, and the motion in a recording."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm
from lite6jax.emulator.paths import MAX_SPEED, Path, Sines, played, visits
from lite6jax.errors import InputError
from lite6jax.recordings import outside_limits, read_recording, recording_file
from lite6jax.simulation.motions import MARGIN, PERIODS_S, SINES, SPEED

Array = NDArray[np.floating]

PROGRAMS = ("rest", "sines", "poses")


def draw_sines(limits: Array, seed: int = 0, speed: float = SPEED) -> Sines:
    """Random sines as in a simulated trajectory, over nine tenths of each joint's range (at most one turn).

    Args:
        limits: `(joint, 2)` rad.
        seed: of the drawing.
        speed: rad/s, the largest of any joint.
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
    """`(count, joint)` rad, drawn uniformly over nine tenths of each joint's range (at most one turn)."""
    centre, half = _ranges(limits)
    return centre + half * np.random.default_rng([seed, 1]).uniform(-1, 1, (count, len(limits)))


def _ranges(limits: Array) -> tuple[Array, Array]:
    lower, upper = np.clip(limits, -2 * np.pi, 2 * np.pi).T
    return (lower + upper) / 2, np.minimum((upper - lower) / 2, np.pi) * (1 - 2 * MARGIN)


def peak_speed(path: Path, time: ArrayLike | None = None) -> float:
    """rad/s, the highest speed of any joint at `time` `(sample,)` s; None for the whole of a finite path."""
    times = np.linspace(0.0, path.duration, 20001) if time is None else np.asarray(time)
    return float(np.abs(path.at(times)[1]).max())


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
        return draw_sines(arm.joint_limits, seed)
    if what == "poses":
        return visits(draw_places(arm.joint_limits, seed=seed))
    if recording_file(what) is None:
        raise InputError(f"--motion {what!r}: is neither {', '.join(PROGRAMS)} nor a recording's file")
    recording = read_recording(what, arm=arm, joint_limits=arm.joint_limits)
    for outside in outside_limits(recording, arm.joint_limits):
        raise InputError(
            f"{what}: joint {outside.joint} is {np.rad2deg(outside.largest_excess_rad):.3g}° beyond its limits in row "
            f"{outside.rows[0]}; give a motion that this arm can do"
        )
    if recording.motion == "static" or recording.time is None or recording.samples == 1:
        return visits(recording.joint_position)
    if (np.diff(recording.time) <= 0).any():
        raise InputError(f"{what}: time does not increase from row to row; sort the rows, and keep one run")
    path = played(recording.time, recording.joint_position)
    knots = path.spline.x
    speed = peak_speed(path, np.sort(np.concatenate([knots, (knots[1:] + knots[:-1]) / 2])))
    if speed > 1.02 * MAX_SPEED:
        raise InputError(
            f"{what}: a joint moves at {np.rad2deg(speed):.0f}°/s, but the limit is {np.rad2deg(MAX_SPEED):.0f}°/s; "
            "give a slower motion"
        )
    return path
