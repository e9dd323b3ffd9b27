"""The motion of an arm, sample by sample: every quantity on which an effect may depend, and its shift in time."""

from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.arm import joint_sizes
from lite6jax.arms.chains import SixParameterForm
from lite6jax.array_types import Mask
from lite6jax.deferred import JaxArray, jax, jit, jnp, lax, register_static
from lite6jax.errors import InputError

_HALF_WINDOW = 0.05
"""s, half the window of `accelerated`: encoder noise dominates a shorter one, and a longer one smooths the motion."""

_ELSEWHERE = 2.0
"""Of the order of recording, which is from 0 to 1: any value beyond."""
_LEAST_REVERSAL = 1e-4
"""rad: a joint that moves back by less did not reverse."""


@final
@register_static
@dataclass(frozen=True)
class Sliding:
    """The prismatic joints of a chain, counted from 0: known when a function is compiled. A pytree without leaves.

    Attributes:
        joints: in order.
    """

    joints: tuple[int, ...] = ()

    def mask(self, dof: int) -> Mask:
        """`(joint,)`, true for prismatic joints."""
        return np.isin(np.arange(dof), self.joints)


class Motion(NamedTuple):
    """A sequence of samples with the sample as the last axis; `motion_of` builds it. A pytree; None is unknown.

    Attributes:
        joint_position: `(joint, sample)` rad, and m of prismatic joints, as in all derivatives.
        joint_velocity: `(joint, sample)` rad/s.
        direction: `(joint, sample)`, the direction in which each joint moves or last moved: -1, 0 or 1.
        time: `(sample,)` s, non-decreasing within a run.
        run: `(2, sample)` int, for each sample the indices of the first and the last sample of its run.
        temperature_rise: `(sample,)` K above the temperature at which the geometry is valid.
        payload: `(sample,)` kg at the flange.
        joint_acceleration: `(joint, sample)` rad/s², given where the loads shall contain inertial forces; see
            `accelerated`.
        joint_temperature_rise: `(joint, sample)` K above that temperature at each joint; of the surroundings where no
            joint's temperature is known.
        measured_position: `(3, sample)` m, where the sensor shows the tool of the rigid arm, in its own frame.
        sliding: the prismatic joints.
        sequence: `(sample,)` from 0 to 1, when each sample was recorded: by its time where that is known, one run after
            another. Beyond 1 in another recording than that of which something is known.
        command_velocity: `(joint, sample)` rad/s, at which the commands of a log change.
    """

    joint_position: JaxArray
    joint_velocity: JaxArray | None
    direction: JaxArray | None
    time: JaxArray | None
    run: JaxArray
    temperature_rise: JaxArray | None
    payload: JaxArray
    joint_acceleration: JaxArray | None = None
    joint_temperature_rise: JaxArray | None = None
    measured_position: JaxArray | None = None
    sliding: Sliding = Sliding()
    sequence: JaxArray | None = None
    command_velocity: JaxArray | None = None

    @property
    def dof(self) -> int:
        """The number of joints."""
        return self.joint_position.shape[0]

    @property
    def samples(self) -> int:
        """The number of samples."""
        return self.joint_position.shape[1]

    @property
    def chain(self) -> SixParameterForm:
        """The six-parameter form of the chain that moves so."""
        return SixParameterForm(self.dof, self.sliding.joints)


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
    measured_position: ArrayLike | None = None,
    sliding: tuple[int, ...] = (),
) -> Motion:
    """A `Motion` from arrays whose first axis is the sample, as in a recording.

    Args:
        joint_position: `(sample, joint)` rad, and m of prismatic joints.
        joint_velocity: `(sample, joint)` rad/s; None where the arm was at standstill at each sample.
        direction: `(sample, joint)`, -1, 0 or 1.
        time: `(sample,)` s.
        run: `(sample,)`, a number that changes where a new run starts; None for a single run.
        joint_temperature: `(sample, joint)` °C, of each joint; the mean over joints is the temperature of the arm.
        ambient_temperature: `(sample,)` °C, that of every joint where `joint_temperature` is None.
        reference_temperature: °C, at which the geometry is valid.
        payload: `(sample,)` kg; None for 0.
        measured_position: `(sample, 3)` m in the sensor's frame, of the rigid arm.
        sliding: the prismatic joints, counted from 0.

    Raises:
        InputError: inconsistent shapes, a number that is not finite, or times that decrease within a run.
    """
    q = np.asarray(joint_position, float)
    if q.ndim != 2 or 0 in q.shape:
        raise InputError(f"motion: joint_position has the shape {q.shape}; give (sample, joint), neither of them zero")
    samples = len(q)

    def given(name: str, value: ArrayLike | None, shape: tuple[int, ...] = q.shape) -> np.ndarray | None:
        if value is None:
            return None
        array = np.asarray(value, float)
        if array.shape != shape:
            raise InputError(f"motion: {name} has the shape {array.shape}; give {shape}")
        if not np.isfinite(array).all():
            row = int(np.argwhere(~np.isfinite(array))[0, 0])
            raise InputError(f"motion: {name} is not finite in row {row + 1}; drop such rows first")
        return array

    given("joint_position", q)
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
        backward = np.flatnonzero((np.diff(clock) < 0) & ~starts[1:])
        if backward.size:
            raise InputError(f"motion: time goes back at row {backward[0] + 2}; sort the rows by time within each run")
    temperature = given("joint_temperature", joint_temperature)
    if temperature is None and (ambient := given("ambient_temperature", ambient_temperature, (samples,))) is not None:
        temperature = np.repeat(ambient[:, None], q.shape[1], 1)
    rise = None if temperature is None else temperature - reference_temperature

    def stored(array: np.ndarray | None) -> JaxArray | None:
        if array is None:
            return None
        return jnp.asarray(np.ascontiguousarray(array.T))

    return Motion(
        joint_position=jnp.asarray(np.ascontiguousarray(q.T)),
        joint_velocity=stored(given("joint_velocity", joint_velocity)),
        direction=stored(given("direction", direction)),
        time=stored(clock),
        run=jnp.asarray(np.stack([first, last])),
        temperature_rise=stored(None if rise is None else rise.mean(1)),
        payload=jnp.asarray(given("payload", np.zeros(samples) if payload is None else payload, (samples,))),
        joint_temperature_rise=stored(rise),
        measured_position=stored(None if measured_position is None else np.asarray(measured_position, float)),
        sliding=Sliding(sliding),
        sequence=stored(_sequence(clock, first)),
    )


def _sequence(time: np.ndarray | None, first: np.ndarray) -> np.ndarray:
    """`(sample,)` from 0 to 1, by the times `(sample,)` of each run, which begins at the sample `first` of each."""
    if time is None:
        return np.linspace(0.0, 1.0, len(first))
    steps = np.diff(time)
    inside = first[1:] == first[:-1]
    usual = float(np.median(steps[inside])) if inside.any() else 1.0
    elapsed = np.concatenate([[0.0], np.cumsum(np.where(inside, steps, usual))])
    if elapsed[-1] <= 0:
        return np.linspace(0.0, 1.0, len(first))
    return elapsed / elapsed[-1]


def in_another_recording(motion: Motion) -> Motion:
    """The motion as one of which a recording does not say what wandered by itself."""
    return motion._replace(sequence=jnp.full(motion.samples, _ELSEWHERE))


@jit
def shifted(motion: Motion, offset: JaxArray | float) -> Motion:
    """The motion at `time + offset`, with the time stamps `time`.

    Positions follow the cubic Hermite interpolant of the two samples around the instant and their velocities;
    velocities are its derivative and directions the sign of that. Temperatures and payload are those of the sample
    before; what the sensor shows stays, because its stamps do. Beyond the ends of a run the last cubic is extrapolated
    by at most one sample's step; `beyond` marks the rows that would lie further out.

    Args:
        motion: with time and velocity.
        offset: `()` s.
    """
    assert motion.time is not None
    assert motion.joint_velocity is not None
    before, u, step = _interval(motion, offset)
    after = jnp.minimum(before + 1, motion.run[1])

    def at(array: JaxArray, index: JaxArray) -> JaxArray:
        return array.at[..., index].get(mode="promise_in_bounds")

    start = at(motion.joint_position, before)
    end = at(motion.joint_position, after)
    v_start = at(motion.joint_velocity, before)
    v_end = at(motion.joint_velocity, after)
    # the weights are exactly 0 and 1 at the ends, so that a zero offset changes nothing
    to_end = u * u * (3 - 2 * u)
    to_start = (1 - u) * (1 - u) * (1 + 2 * u)
    position = to_start * start + to_end * end + step * u * (1 - u) * ((1 - u) * v_start - u * v_end)
    velocity = 6 * u * (1 - u) * (end - start) / step + (1 - u) * (1 - 3 * u) * v_start + u * (3 * u - 2) * v_end
    # at a sample's own instant its own values, at whichever end of the interval it lies
    source_sample = jnp.where(u < 1, before, after)
    stepwise = {
        "temperature_rise": motion.temperature_rise,
        "joint_temperature_rise": motion.joint_temperature_rise,
        "payload": motion.payload,
    }
    replaced = {name: at(value, source_sample) for name, value in stepwise.items() if value is not None}
    if motion.joint_acceleration is not None:
        a_start = at(motion.joint_acceleration, before)
        a_end = at(motion.joint_acceleration, after)
        replaced["joint_acceleration"] = (1 - u) * a_start + u * a_end
    direction = None if motion.direction is None else jnp.sign(velocity)
    return motion._replace(joint_position=position, joint_velocity=velocity, direction=direction, **replaced)


def accelerated(motion: Motion) -> Motion:
    """The motion with its accelerations, so that loads contain inertial forces; unchanged without velocity or time.

    The acceleration is the difference quotient of the velocity over `_HALF_WINDOW` s on either side, or over one
    sample's step where that is longer. It is one-sided at the ends of a run.
    """
    if motion.joint_velocity is None or motion.time is None:
        return motion
    time = np.asarray(motion.time)
    velocity = np.asarray(motion.joint_velocity)
    first, last = np.asarray(motion.run)
    acceleration = np.zeros_like(velocity)
    for start in np.unique(first):
        rows = slice(start, last[start] + 1)
        t = time[rows]
        if len(t) < 2:
            continue
        step = np.diff(t)
        reach = np.maximum(_HALF_WINDOW, np.maximum(np.append(step, 0), np.insert(step, 0, 0)))
        early = np.maximum(t - reach, t[0])
        late = np.minimum(t + reach, t[-1])
        duration = np.where(late > early, late - early, 1.0)
        for joint, v in enumerate(velocity[:, rows]):
            acceleration[joint, rows] = (np.interp(late, t, v) - np.interp(early, t, v)) / duration
    return motion._replace(joint_acceleration=jnp.asarray(acceleration))


def beyond(motion: Motion, offset: JaxArray | float) -> JaxArray:
    """`(sample,)` bool: `time + offset` lies more than one sample's step outside the run of the sample."""
    assert motion.time is not None
    first, last = motion.run
    second = jnp.minimum(first + 1, last)
    last_but_one = jnp.maximum(last - 1, first)
    t = motion.time
    # for rounding of the times
    instant = t + offset
    tolerance = 1e-9 * jnp.abs(t[-1] - t[0])
    early = instant < t[first] - (t[second] - t[first]) - tolerance
    late = instant > t[last] + (t[last] - t[last_but_one]) + tolerance
    return early | late


def _interval(motion: Motion, offset: JaxArray | float) -> tuple[JaxArray, JaxArray, JaxArray]:
    """The interval of samples that contains `time + offset`.

    Returns:
        the index of its first sample; the position in it, 0 to 1, or -1 to 2 beyond the run, which alone depends on
        `offset` differentiably; and its length in s.
    """
    assert motion.time is not None
    t = motion.time
    first, last = motion.run
    instant = lax.stop_gradient(t + offset)

    def halve(_: JaxArray, ends: tuple[JaxArray, JaxArray]) -> tuple[JaxArray, JaxArray]:
        low, high = ends
        middle = (low + high + 1) // 2
        reached = t.at[middle].get(mode="promise_in_bounds") <= instant
        return jnp.where(reached, middle, low), jnp.where(reached, high, middle - 1)

    last_interval = jnp.maximum(last - 1, first)
    before, _ = lax.fori_loop(0, int(np.ceil(np.log2(motion.samples + 1))), halve, (first, last_interval))
    start = t.at[before].get(mode="promise_in_bounds")
    step = t.at[jnp.minimum(before + 1, last)].get(mode="promise_in_bounds") - start
    step = jnp.where(step > 0, step, 1.0)  # a run of one sample, or two samples with equal times
    return before, jnp.clip((t + offset - start) / step, -1.0, 2.0), step


@jit
def since_reversal(motion: Motion) -> JaxArray:
    """How far each joint is from where it last reversed, or from where its run begins, `(joint, sample)` rad or m.

    A way back of less than `_LEAST_REVERSAL` rad, or what that is of a prismatic joint, is none: encoders jitter.
    """
    smallest_reversal = joint_sizes(_LEAST_REVERSAL, "rad", motion.sliding.mask(motion.dof))

    def moved(
        state: tuple[JaxArray, JaxArray, JaxArray], now: tuple[JaxArray, JaxArray]
    ) -> tuple[tuple[JaxArray, JaxArray, JaxArray], JaxArray]:
        turned_at, farthest, sense = state
        q, begins = now
        turned_at = jnp.where(begins, q, turned_at)
        farthest = jnp.where(begins, q, farthest)
        sense = jnp.where(begins | (sense == 0), jnp.sign(q - farthest), sense)
        retreat = sense * (farthest - q)
        turns = retreat > smallest_reversal
        turned_at = jnp.where(turns, farthest, turned_at)
        farthest = jnp.where(turns | (retreat < 0), q, farthest)
        return (turned_at, farthest, jnp.where(turns, -sense, sense)), abs(q - turned_at)

    begins = motion.run[0] == jnp.arange(motion.samples)
    start = jnp.zeros(motion.dof)
    return lax.scan(moved, (start, start, start), (motion.joint_position.T, begins))[1].T


def thin(motion: Motion, decimation: int) -> Motion:
    """One in `decimation` samples, in the runs that they belong to: what depends on the past follows the samples that
    stay.

    Args:
        motion: of all samples.
        decimation: from 1.
    """
    rows = np.arange(motion.samples)[::decimation]
    first, last = np.asarray(motion.run)[:, rows]
    run = np.stack([np.searchsorted(rows, first), np.searchsorted(rows, last, side="right") - 1])
    return select(motion, rows)._replace(run=jnp.asarray(run))


def select(motion: Motion, rows: ArrayLike) -> Motion:
    """The samples of a boolean mask or of indices, with their own velocities and directions.

    Each sample becomes a run of its own, because its neighbours are missing: a clock offset must not follow.
    """
    chosen = jax.tree.map(lambda leaf: leaf[..., np.asarray(rows)], motion)
    sample_numbers = jnp.arange(chosen.samples)
    return chosen._replace(run=jnp.stack([sample_numbers, sample_numbers]))
