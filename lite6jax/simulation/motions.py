"""Motions to simulate: drawn over the joints' ranges or given, with their times, payloads and temperatures."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import bundled_arms
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, RecordingSettings, require_radians
from lite6jax.recordings.units import real_array
from lite6jax.simulation.draws import generator

Array = NDArray[np.floating]
MotionKind = Literal["static", "trajectory"]

SAMPLES = {"static": 400, "trajectory": 3000}
"""Drawn where no number is given."""
STEP_S = {"static": 8.0, "trajectory": 0.02}
"""From sample to sample where no step is given."""
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
        arm: its joints and limits are used.
        kind: static (the arm stands still at each sample) or trajectory.
        samples: of all runs together, which are of equal length; 400 static poses, 3000 of a trajectory by default.
        runs: how many; the time goes on from one to the next.
        step: from sample to sample, s; 8 of a static recording, 0.02 of a trajectory where not given.
        speed: that no joint of a trajectory exceeds, rad/s.
        payload: `()` or `(part,)` kg at the flange, in equal parts of the recording one after the other.
        warm_up: temperature rise of the first joint at the end, K: exponential from the reference temperature with a
            third of the duration as time constant; the last joint reaches 0.8 of it, those between in proportion. Not
            given: no temperatures are recorded.
        settings: declared arm, geometry, gravity, payload centre and reference temperature; the arm's name and the
            defaults where not given.
        seed: of the random numbers.

    Raises:
        InputError: fewer samples than the runs need, or a number out of its range.
    """
    samples = SAMPLES[kind] if samples is None else samples
    fewest = 2 if kind == "trajectory" else 1
    if runs < 1 or samples < fewest * runs:
        raise InputError(f"simulation: {samples} samples in {runs} runs; give at least {fewest} a run, and one run")
    step = STEP_S[kind] if step is None else step
    for name, value in (("step", step), ("speed", speed)):
        if not 0 < value < np.inf:
            raise InputError(f"simulation: {name} is {value}; give a number above 0")
    rng = generator(seed, "motion")
    run = np.arange(samples) * runs // samples
    centre, half = _ranges(arm)
    velocity = None
    if kind == "static":
        order = np.argsort(rng.random((samples, arm.dof)), axis=0)
        position = centre + half * (2 * (order + rng.random((samples, arm.dof))) / samples - 1)
        time = step * np.arange(samples)
    else:
        starts = np.searchsorted(run, np.arange(runs))
        within = step * (np.arange(samples) - starts[run])
        time = step * (np.arange(samples) - run) + PAUSE_S * run
        fastest = np.where(arm.slides, SLIDE_SPEED, speed)
        parts = [_multi_sine(rng, centre, half, within[run == number], fastest) for number in range(runs)]
        position, velocity = (np.concatenate(part) for part in zip(*parts, strict=True))
    return _motion(arm, kind, position, velocity, time, run, payload, warm_up, settings)


def given_motion(
    arm: Arm,
    joint_position: ArrayLike,
    kind: MotionKind = "static",
    *,
    time: ArrayLike | None = None,
    payload: float | Sequence[float] | Array = 0.0,
    warm_up: float | None = None,
    settings: RecordingSettings | None = None,
) -> Recording:
    """A motion through given joint positions; the velocities of a trajectory are differentiated.

    Args:
        arm: its limits reveal degrees.
        joint_position: `(sample, joint)` rad, and m of prismatic joints.
        kind, payload, warm_up, settings: as in `draw_motion`.
        time: `(sample,)` s; equal steps as in `draw_motion` where not given.

    Raises:
        InputError: another shape, numbers that are not finite or not real, or degrees.
    """
    q = real_array("joint_position", joint_position)
    if q.ndim != 2 or q.shape[1] != arm.dof or not len(q):
        raise InputError(f"joint_position of shape {q.shape}: {arm.name} takes (sample, {arm.dof})")
    if not np.isfinite(q).all():
        raise InputError(f"joint_position: row {int(np.argmin(np.isfinite(q).all(1))) + 1} is not finite; leave it out")
    require_radians(q, arm.joint_limits)
    t = STEP_S[kind] * np.arange(len(q)) if time is None else real_array("time", time)
    if t.shape != (len(q),) or not np.isfinite(t).all():
        raise InputError(f"time of shape {t.shape}: give ({len(q)},) finite numbers, in s")
    return _motion(arm, kind, q, None, t, np.zeros(len(q), np.int64), payload, warm_up, settings)


def _motion(
    arm: Arm,
    kind: MotionKind,
    position: Array,
    velocity: Array | None,
    time: Array,
    run: NDArray[np.integer],
    payload: float | Sequence[float] | Array,
    warm_up: float | None,
    settings: RecordingSettings | None,
) -> Recording:
    samples = len(position)
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
        duration = max(time[-1] - time[0], STEP_S[kind])
        rise = warm_up * -np.expm1(-3 * (time - time[0]) / duration)
        temperature = settings.reference_temperature_degC + np.outer(rise, np.linspace(1.0, 0.8, arm.dof))
    return Recording.assembled(
        position,
        time=time,
        joint_velocity=velocity,
        joint_temperature=temperature,
        payload=masses[np.arange(samples) * masses.size // samples],
        run=run,
        settings=replace(settings, motion=kind),
        source="simulation",
        sliding=arm.sliding,
    )


def _ranges(arm: Arm) -> tuple[Array, Array]:
    """`(joint,)` each: the middle of a joint's range and half its width, rad, and m of prismatic joints."""
    lower, upper = np.where(np.isfinite(arm.joint_limits), arm.joint_limits, [-np.pi, np.pi]).T
    widest = np.where(arm.slides, np.inf, np.pi)
    return (lower + upper) / 2, np.minimum((upper - lower) / 2, widest) * (1 - 2 * MARGIN)


def _multi_sine(rng: np.random.Generator, centre: Array, half: Array, time: Array, speed: Array) -> tuple[Array, Array]:
    """Positions (rad) and velocities (rad/s), `(sample, joint)`: sums of sines within range and speed, from rest."""
    shape = (SINES, len(centre))
    amplitude = rng.uniform(0.2, 1.0, shape)
    amplitude *= half / amplitude.sum(0)
    rate = 2 * np.pi / np.exp(rng.uniform(np.log(PERIODS_S[0]), np.log(PERIODS_S[1]), shape))
    rate *= np.minimum(1.0, speed / (amplitude * rate).sum(0))
    phase = rng.uniform(-np.pi, np.pi, shape)
    # a path parameter that starts from rest takes the place of time: limits and speed hold whatever its rate in 0…1
    x = np.minimum(time / RUN_UP_S, 1.0)
    pace = x**3 * (10 - 15 * x + 6 * x * x)
    clock = RUN_UP_S * x**4 * (2.5 - 3 * x + x * x) + np.maximum(time - RUN_UP_S, 0.0)
    angle = clock[:, None, None] * rate + phase
    position = centre + (amplitude * np.sin(angle)).sum(1)
    return position, pace[:, None] * (amplitude * rate * np.cos(angle)).sum(1)
