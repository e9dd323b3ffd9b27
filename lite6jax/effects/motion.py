"""What the arm did, sample by sample: all that an effect may depend on, and the same motion at another instant."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from numpy.typing import ArrayLike

from lite6jax.errors import InputError

_SLOPE = 0.05
"""s."""


class Motion(NamedTuple):
    """A whole sequence of samples, the sample last; build it with `motion_of`. A pytree; None is what is not known.

    Attributes:
        joint_position: `(joint, sample)` rad.
        joint_velocity: `(joint, sample)` rad/s.
        direction: `(joint, sample)`, the direction in which each joint moves or last moved: -1, 0 or 1.
        time: `(sample,)` s; in order within a run.
        run: `(2, sample)` int, the first and the last sample of the run of each.
        temperature_rise: `(sample,)` K above the temperature at which the geometry holds.
        payload: `(sample,)` kg at the flange.
        joint_acceleration: `(joint, sample)` rad/s², where loads are to hold what it takes; see `accelerated`.
    """

    joint_position: Array
    joint_velocity: Array | None
    direction: Array | None
    time: Array | None
    run: Array
    temperature_rise: Array | None
    payload: Array
    joint_acceleration: Array | None = None

    @property
    def dof(self) -> int:
        """The number of joints."""
        return self.joint_position.shape[0]

    @property
    def samples(self) -> int:
        """The number of samples."""
        return self.joint_position.shape[1]


def motion_of(
    joint_position: ArrayLike,
    *,
    joint_velocity: ArrayLike | None = None,
    direction: ArrayLike | None = None,
    time: ArrayLike | None = None,
    run: ArrayLike | None = None,
    joint_temperature: ArrayLike | None = None,
    ambient_temperature: ArrayLike | None = None,
    reference_temperature: float = 25.0,
    payload: ArrayLike | None = None,
) -> Motion:
    """The motion in arrays whose sample is the first axis, as a recording holds them.

    Args:
        joint_position: `(sample, joint)` rad.
        joint_velocity: `(sample, joint)` rad/s; leave it out where the arm stood still at each sample.
        direction: `(sample, joint)`, -1, 0 or 1.
        time: `(sample,)` s.
        run: `(sample,)`, a number that changes where a new run starts; one run without it.
        joint_temperature: `(sample, joint)` °C; their mean is the arm's temperature.
        ambient_temperature: `(sample,)` °C, taken where there is no `joint_temperature`.
        reference_temperature: °C, at which the geometry holds.
        payload: `(sample,)` kg; 0 without it.

    Raises:
        InputError: shapes that do not fit together, a number that is not finite, or times out of order within a run.
    """
    q = np.asarray(joint_position, float)
    if q.ndim != 2 or 0 in q.shape:
        raise InputError(f"motion: joint_position has the shape {q.shape}; give (sample, joint), neither zero")
    samples = len(q)

    def given(name: str, value: ArrayLike | None, shape: tuple[int, ...]) -> np.ndarray | None:
        if value is None:
            return None
        array = np.asarray(value, float)
        if array.shape != shape:
            raise InputError(f"motion: {name} has the shape {array.shape}; give {shape}")
        if not np.isfinite(array).all():
            row = int(np.argwhere(~np.isfinite(array))[0, 0])
            raise InputError(f"motion: {name} is not finite in row {row + 1}; drop such rows first")
        return array

    given("joint_position", q, q.shape)
    starts = np.zeros(samples, bool)
    starts[0] = True
    if run is not None:
        number = np.asarray(run)
        if number.shape != (samples,):
            raise InputError(f"motion: run has the shape {number.shape}; give {(samples,)}")
        starts[1:] = number[1:] != number[:-1]
    first = np.flatnonzero(starts)[np.cumsum(starts) - 1]
    last = np.append(np.flatnonzero(starts)[1:], samples)[np.cumsum(starts) - 1] - 1
    clock = given("time", time, (samples,))
    if clock is not None:
        back = np.flatnonzero((np.diff(clock) < 0) & ~starts[1:])
        if back.size:
            raise InputError(f"motion: time goes back at row {back[0] + 2}; sort the rows by time within each run")
    temperature = given("joint_temperature", joint_temperature, q.shape)
    temperature = given("ambient_temperature", ambient_temperature, (samples,)) if temperature is None else temperature
    if temperature is not None:
        temperature = temperature.reshape(samples, -1).mean(1) - reference_temperature
    mass = given("payload", payload, (samples,))
    velocity, direction = (
        given("joint_velocity", joint_velocity, q.shape),
        given("direction", direction, q.shape),
    )

    def stored(array: np.ndarray | None) -> Array | None:
        return None if array is None else jnp.asarray(np.ascontiguousarray(array.T))

    return Motion(
        joint_position=jnp.asarray(np.ascontiguousarray(q.T)),
        joint_velocity=stored(velocity),
        direction=stored(direction),
        time=stored(clock),
        run=jnp.asarray(np.stack([first, last])),
        temperature_rise=stored(temperature),
        payload=jnp.asarray(np.zeros(samples) if mass is None else mass),
    )


@jax.jit
def shifted(motion: Motion, offset: Array | float) -> Motion:
    """The motion `offset` s later: what the arm does at `time + offset`, stamped `time`.

    Positions follow the cubic through the two samples around the instant and their velocities (Hermite), velocities its
    derivative, directions their sign; temperature and payload are those of the sample before. Beyond the ends of a run
    the last cubic goes on for one sample's step, and stands still there: `beyond` tells which rows that concerns.

    Args:
        motion: with time and velocity.
        offset: `()` s.
    """
    assert motion.time is not None
    assert motion.joint_velocity is not None
    before, u, step = _interval(motion, offset)
    after = jnp.minimum(before + 1, motion.run[1])

    def at(array: Array, index: Array) -> Array:
        return array.at[..., index].get(mode="promise_in_bounds")

    start, end = at(motion.joint_position, before), at(motion.joint_position, after)
    v_start, v_end = at(motion.joint_velocity, before), at(motion.joint_velocity, after)
    # weights that are exactly 0 and 1 at the ends, so that no offset changes nothing
    risen, left = u * u * (3 - 2 * u), (1 - u) * (1 - u) * (1 + 2 * u)
    position = left * start + risen * end + step * u * (1 - u) * ((1 - u) * v_start - u * v_end)
    velocity = 6 * u * (1 - u) * (end - start) / step + (1 - u) * (1 - 3 * u) * v_start + u * (3 * u - 2) * v_end
    # a sample's own values where the instant is its own, whichever end of the interval that is
    own = jnp.where(u < 1, before, after)
    rest = {
        name: None if value is None else at(value, own)
        for name, value in (("temperature_rise", motion.temperature_rise), ("payload", motion.payload))
    }
    if motion.joint_acceleration is not None:
        a_start, a_end = at(motion.joint_acceleration, before), at(motion.joint_acceleration, after)
        rest["joint_acceleration"] = (1 - u) * a_start + u * a_end
    direction = None if motion.direction is None else jnp.sign(velocity)
    return motion._replace(joint_position=position, joint_velocity=velocity, direction=direction, **rest)


def accelerated(motion: Motion) -> Motion:
    """The motion with its accelerations, so that loads hold what they take; unchanged without velocities and times.

    They are the slopes of the velocity over `_SLOPE` s on either side, or a sample's step where that is longer: shorter
    ones would be noise of the encoders, longer ones miss what an arm does. At the ends of a run they are one-sided.
    """
    if motion.joint_velocity is None or motion.time is None:
        return motion
    time, velocity, (first, last) = np.asarray(motion.time), np.asarray(motion.joint_velocity), np.asarray(motion.run)
    found = np.zeros_like(velocity)
    for start in np.unique(first):
        rows = slice(start, last[start] + 1)
        t = time[rows]
        if len(t) < 2:
            continue
        step = np.diff(t)
        reach = np.maximum(_SLOPE, np.maximum(np.append(step, 0), np.insert(step, 0, 0)))
        early, late = np.maximum(t - reach, t[0]), np.minimum(t + reach, t[-1])
        apart = np.where(late > early, late - early, 1.0)
        for joint, v in enumerate(velocity[:, rows]):
            found[joint, rows] = (np.interp(late, t, v) - np.interp(early, t, v)) / apart
    return motion._replace(joint_acceleration=jnp.asarray(found))


def beyond(motion: Motion, offset: Array | float) -> Array:
    """`(sample,)` bool: `time + offset` lies more than one sample's step beyond the sample's run."""
    assert motion.time is not None
    first, last = motion.run
    second, last_but_one = jnp.minimum(first + 1, last), jnp.maximum(last - 1, first)
    t = motion.time
    instant, slack = t + offset, 1e-9 * jnp.abs(t[-1] - t[0])  # of rounding in the times
    early = instant < t[first] - (t[second] - t[first]) - slack
    late = instant > t[last] + (t[last] - t[last_but_one]) + slack
    return early | late


def _interval(motion: Motion, offset: Array | float) -> tuple[Array, Array, Array]:
    """The sample before the instant, where in the interval it lies (0 to 1, or one step beyond), and the step in s."""
    assert motion.time is not None
    t, (first, last) = motion.time, motion.run
    instant = lax.stop_gradient(t + offset)

    def halve(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high + 1) // 2
        reached = t.at[middle].get(mode="promise_in_bounds") <= instant
        return jnp.where(reached, middle, low), jnp.where(reached, high, middle - 1)

    last_interval = jnp.maximum(last - 1, first)
    before, _ = lax.fori_loop(0, int(np.ceil(np.log2(motion.samples + 1))), halve, (first, last_interval))
    start = t.at[before].get(mode="promise_in_bounds")
    step = t.at[jnp.minimum(before + 1, last)].get(mode="promise_in_bounds") - start
    step = jnp.where(step > 0, step, 1.0)  # a run of one sample, or two samples of one instant
    return before, jnp.clip((t + offset - start) / step, -1.0, 2.0), step


def select(motion: Motion, rows: ArrayLike) -> Motion:
    """The samples of a boolean mask or of indices, each keeping its own velocity and direction.

    For effects without a clock only: what is left has no neighbours, and each sample becomes a run of its own.
    """
    chosen = jax.tree.map(lambda leaf: leaf[..., np.asarray(rows)], motion)
    own = jnp.arange(chosen.samples)
    return chosen._replace(run=jnp.stack([own, own]))
