"""What is drawn of a simulated arm: its geometry, where the sensor stands, and motions over the joints' ranges.

Those of an emulated arm are functions of time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PPoly

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_arms
from lite6jax.array_types import Array, Integers
from lite6jax.errors import InputError
from lite6jax.recordings import (
    Recording,
    RecordingSettings,
    outside_limits,
    read_recording,
    recording_file,
    require_radians,
)
from lite6jax.recordings.files import read_commands
from lite6jax.recordings.units import real_array

MotionKind = Literal["static", "trajectory"]

SAMPLES = {"static": 400, "trajectory": 3000}
STEP_S = {"static": 8.0, "trajectory": 0.02}
"""Number of samples, and the time from one to the next, where none is given."""
MARGIN = 0.05
"""Share of each joint's range that is left out at either end."""
SPEED = float(np.deg2rad(120.0))
"""rad/s that no joint exceeds in a trajectory; the Lite 6 reaches 180 deg/s."""
SLIDE_SPEED = 0.5
"""m/s that no prismatic joint exceeds."""
PERIODS_S = (3.0, 15.0)
"""Range of the periods of the sines that a trajectory is the sum of."""
SINES = 5
RUN_UP_S = 1.0
"""Time from rest to full speed at the start of a run."""
PAUSE_S = 5.0
"""Time between the runs of a trajectory."""
_PURPOSES = ("motion", "calibration", "uncertainty", "frame", "position", "orientation", "joints", "outliers")


def make_generator(seed: int, purpose: str) -> np.random.Generator:
    """A generator of its own for each purpose, so that another sensor leaves the motion as it was.

    Raises:
        InputError: a negative seed.
    """
    if seed < 0:
        raise InputError(f"seed {seed}: give zero or more")
    return np.random.default_rng([seed, _PURPOSES.index(purpose)])


def check_size(samples: int, runs: int, fewest: int, step: float, speed: float) -> None:
    """Checks how many samples and runs of them are asked for, and the numbers of their motion.

    Raises:
        InputError: fewer samples of a run than `fewest`, or a number out of its range.
    """
    if runs < 1 or samples < fewest * runs:
        raise InputError(f"simulation: {samples} samples in {runs} runs; give at least {fewest} a run, and one run")
    for name, value in (("step", step), ("speed", speed)):
        if not 0 < value < np.inf:
            raise InputError(f"simulation: {name} is {value}; give a number above 0")


def place_samples(samples: int, runs: int, step: float) -> tuple[Integers, Array, Array]:
    """`(sample,)`: the run of each of some samples, its time, and the time since the start of its run, both in s."""
    sample = np.arange(samples)
    run = sample * runs // samples
    since_start = step * (sample - np.searchsorted(run, run))
    return run, step * (sample - run) + PAUSE_S * run, since_start


def draw_calibration(arm: Arm, seed: int = 0, *, length: float = 0.8e-3, angle: float = np.deg2rad(0.15)) -> Array:
    """The kinematics of one arm as manufactured: the nominal one with a normal error in each number.

    Args:
        arm: the nominal arm.
        seed: of the random numbers.
        length: standard deviation of the error of x, y and z, m; that of a Lite 6 by default.
        angle: standard deviation of the error of roll, pitch and yaw, rad; likewise.

    Returns:
        `(joint, 6)` x y z roll pitch yaw of each joint's frame in the previous one, m and rad.

    Raises:
        InputError: a negative seed.
    """
    return perturb(arm.kinematics, length, angle, seed, "calibration")


def perturb(kinematics: Array, length: float, angle: float, seed: int, purpose: str = "uncertainty") -> Array:
    """Kinematics `(joint, 6)` with normal errors of standard deviation `length` (m) or `angle` (rad) in each number."""
    errors = make_generator(seed, purpose).standard_normal(kinematics.shape)
    return kinematics + np.array([length] * 3 + [angle] * 3) * errors


def draw_sensor_frame(seed: int = 0) -> Array:
    """The base's pose in the frame of a sensor that stands 1.5 to 3 m away.

    Any rotation about the vertical is equally likely; the tilt is at most 10° about each horizontal axis.

    Returns:
        `(4, 4)` T_sensor_base, m.

    Raises:
        InputError: a negative seed.
    """
    rng = make_generator(seed, "frame")
    distance, bearing, yaw = rng.uniform(1.5, 3.0), *rng.uniform(-np.pi, np.pi, 2)
    roll, pitch = rng.uniform(-1, 1, 2) * np.deg2rad(10)
    x = distance * np.cos(bearing)
    y = distance * np.sin(bearing)
    return frames.transform_from_row([x, y, rng.uniform(-1.0, 0.5), roll, pitch, yaw])


def joint_ranges(arm: Arm) -> tuple[Array, Array]:
    """`(joint,)` rad or m: the middle of each joint's range, one turn at most, and half its width less the margin."""
    lower, upper = np.where(np.isfinite(arm.joint_limits), arm.joint_limits, [-np.pi, np.pi]).T
    widest = np.where(arm.slides, np.inf, np.pi)
    return (lower + upper) / 2, np.minimum((upper - lower) / 2, widest) * (1 - 2 * MARGIN)


@final
@dataclass(frozen=True, eq=False)
class Sines:
    """An endless motion from rest: of each joint a sum of sines, within the limits of range and speed.

    Attributes:
        center: `(joint,)` rad, and m of prismatic joints, as in all of these.
        amplitude: `(sine, joint)` rad.
        rate: `(sine, joint)` rad/s.
        phase: `(sine, joint)` rad.
    """

    center: Array
    amplitude: Array
    rate: Array
    phase: Array
    duration = np.inf

    def at(self, time: Array) -> tuple[Array, Array]:
        """Positions (rad) and velocities (rad/s) `(sample, joint)` at `(sample,)` s."""
        # a path parameter that starts from rest takes the place of time: limits and speed hold whatever its rate in 0…1
        x = np.clip(time / RUN_UP_S, 0.0, 1.0)
        pace = x**3 * (10 - 15 * x + 6 * x * x)
        clock = RUN_UP_S * x**4 * (2.5 - 3 * x + x * x) + np.maximum(time - RUN_UP_S, 0.0)
        angle = clock[:, None, None] * self.rate + self.phase
        position = self.center + (self.amplitude * np.sin(angle)).sum(1)
        return position, pace[:, None] * (self.amplitude * self.rate * np.cos(angle)).sum(1)


def draw_sines(arm: Arm, seed: int | np.random.Generator = 0, speed: float = SPEED) -> Sines:
    """Random sines over the joints' ranges, in which no revolute joint exceeds `speed` in rad/s."""
    rng = seed if isinstance(seed, np.random.Generator) else make_generator(seed, "motion")
    center, half = joint_ranges(arm)
    amplitude = rng.uniform(0.2, 1.0, (SINES, arm.dof))
    amplitude *= half / amplitude.sum(0)
    rate = 2 * np.pi / np.exp(rng.uniform(np.log(PERIODS_S[0]), np.log(PERIODS_S[1]), (SINES, arm.dof)))
    rate *= np.minimum(1.0, np.where(arm.slides, SLIDE_SPEED, speed) / (amplitude * rate).sum(0))
    return Sines(center, amplitude, rate, rng.uniform(-np.pi, np.pi, (SINES, arm.dof)))


def draw_motion(
    arm: Arm,
    kind: MotionKind = "static",
    samples: int | None = None,
    *,
    runs: int = 1,
    step: float | None = None,
    speed: float = SPEED,
    payload: float | Sequence[float] | Array = 0.0,
    warm_up: float | None = None,
    settings: RecordingSettings | None = None,
    seed: int = 0,
) -> Recording:
    """A random motion that excites all joints: a recording without poses.

    Static: a Latin hypercube over the joints' ranges in random order, so that each joint covers its range evenly and is
    approached from below as often as from above. Trajectory: in every run each joint follows a sum of sines, from rest,
    with its true velocities. A joint's range is its limits less 5 % at either end, and one turn at most.

    Args:
        arm, kind, payload, warm_up, settings: as in `make_motion`.
        samples: of all runs together, which are of equal length; 400 static poses, 3000 of a trajectory by default.
        runs: how many; the time goes on from one to the next.
        step: from sample to sample, s; 8 of a static recording, 0.02 of a trajectory where not given.
        speed: that no joint of a trajectory exceeds, rad/s.
        seed: of the random numbers.

    Raises:
        InputError: fewer samples than the runs need, or a number out of its range.
    """
    if samples is None:
        samples = SAMPLES[kind]
    fewest = 2 if kind == "trajectory" else 1
    if step is None:
        step = STEP_S[kind]
    check_size(samples, runs, fewest, step, speed)
    rng = make_generator(seed, "motion")
    run, time, since_start = place_samples(samples, runs, step)
    velocity = None
    if kind == "static":
        center, half = joint_ranges(arm)
        order = np.argsort(rng.random((samples, arm.dof)), axis=0)
        position = center + half * (2 * (order + rng.random((samples, arm.dof))) / samples - 1)
        time = step * np.arange(samples)
    else:
        parts = [draw_sines(arm, rng, speed).at(since_start[run == number]) for number in range(runs)]
        position, velocity = (np.concatenate(part) for part in zip(*parts, strict=True))
    return make_motion(
        arm, position, kind, time=time, velocity=velocity, run=run, payload=payload, warm_up=warm_up, settings=settings
    )


def make_motion(
    arm: Arm,
    joint_position: ArrayLike,
    kind: MotionKind = "static",
    *,
    time: ArrayLike | None = None,
    velocity: Array | None = None,
    run: Integers | None = None,
    payload: float | Sequence[float] | Array = 0.0,
    warm_up: float | None = None,
    settings: RecordingSettings | None = None,
) -> Recording:
    """A motion through joint positions: a recording without poses.

    Args:
        arm: its limits reveal degrees.
        joint_position: `(sample, joint)` rad, and m of prismatic joints.
        kind: static (the arm stands still at each sample) or trajectory.
        time: `(sample,)` s; equal steps as in `draw_motion` where not given.
        velocity: `(sample, joint)` rad/s of a trajectory; differentiated where not given.
        run: `(sample,)`; one run where not given.
        payload: `()` or `(part,)` kg at the flange, in equal parts of the recording one after the other.
        warm_up: temperature rise of the first joint at the end, K: exponential from the reference temperature with a
            third of the duration as time constant; the last joint reaches 0.8 of it, those between in proportion. Not
            given: no temperatures are recorded.
        settings: declared arm, geometry, gravity, payload centre and reference temperature; the arm's name and the
            defaults where not given.

    Raises:
        InputError: another shape, numbers that are not finite or not real, degrees, or a number out of its range.
    """
    q = real_array("joint_position", joint_position)
    if q.ndim != 2 or q.shape[1] != arm.dof or not len(q):
        raise InputError(f"joint_position of shape {q.shape}: {arm.name} takes (sample, {arm.dof})")
    if not np.isfinite(q).all():
        raise InputError(f"joint_position: row {int(np.argmin(np.isfinite(q).all(1))) + 1} is not finite; leave it out")
    require_radians(q, arm.joint_limits)
    samples = len(q)
    t = STEP_S[kind] * np.arange(samples) if time is None else real_array("time", time)
    if t.shape != (samples,) or not np.isfinite(t).all():
        raise InputError(f"time of shape {t.shape}: give ({samples},) finite numbers, in s")
    masses = np.atleast_1d(np.asarray(payload, float))
    if masses.ndim != 1 or not 1 <= masses.size <= samples or not np.isfinite(masses).all() or masses.min() < 0:
        raise InputError(f"simulation: payload {np.asarray(payload).tolist()}; give masses in kg, 0 or more")
    if warm_up is not None and not abs(warm_up) < np.inf:
        raise InputError(f"simulation: warm_up is {warm_up}; give a number of K")
    settings = settings or RecordingSettings(arm=arm.name)
    if settings.arm is None and arm.name in bundled_arms():
        settings = replace(settings, arm=arm.name)
    temperature = None
    if warm_up is not None:
        rise = warm_up * -np.expm1(-3 * (t - t[0]) / max(t[-1] - t[0], STEP_S[kind]))
        temperature = settings.reference_temperature_degC + np.outer(rise, np.linspace(1.0, 0.8, arm.dof))
    return Recording.assembled(
        q,
        time=t,
        joint_velocity=velocity,
        joint_temperature=temperature,
        payload=masses[np.arange(samples) * masses.size // samples],
        run=np.zeros(samples, np.int64) if run is None else run,
        settings=replace(settings, motion=kind),
        source="simulation",
        sliding=arm.sliding,
    )


# ------------------------------------------------------------------ motions of an emulated arm

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
    # duration, half the acceleration, velocity and position at the start
    pieces = []
    zero = np.zeros(stops.shape[1])
    for start, end in zip(stops, np.roll(stops, -1, axis=0), strict=True):
        if pause:
            pieces.append((pause, zero, zero, start))
        distance = float(np.abs(end - start).max())
        ramp = min(speed / acceleration, np.sqrt(distance / acceleration))
        if not ramp:
            continue
        level = max(distance / (acceleration * ramp) - ramp, 0.0)
        peak = (end - start) / (ramp + level)
        half = peak / (2 * ramp)
        pieces.append((ramp, half, zero, start))
        if level:
            pieces.append((level, zero, peak, start + half * ramp**2))
        pieces.append((ramp, -half, peak, end - half * ramp**2))
    durations, *coefficients = zip(*pieces, strict=True)
    ends = np.cumsum([0.0, *durations])
    return Polynomials(PPoly(np.array(coefficients), ends, extrapolate="periodic"), np.inf)


def interpolate(time: ArrayLike, position: ArrayLike) -> Polynomials:
    """The cubic spline through samples `(sample, joint)` rad at increasing times `(sample,)` s, from rest to rest."""
    t = np.asarray(time, float)
    return Polynomials(CubicSpline(t - t[0], np.asarray(position, float), bc_type="clamped"), float(t[-1] - t[0]))


PROGRAMS = ("rest", "sines", "poses")


def _read_motion(file: str, arm: Arm) -> Recording:
    """The motion in a file: joints, or commands where there are no joints.

    Raises:
        InputError: as `read_recording`.
    """
    try:
        return read_recording(file, arm=arm, joint_limits=arm.joint_limits)
    except InputError as error:
        try:
            return read_commands(file, arm)
        except InputError:
            raise error from None


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
    recording = _read_motion(what, arm)
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
