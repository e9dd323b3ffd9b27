"""Motions from rest to rest that keep their limits, and gradient ascent of their information over them.

Motions are finite Fourier series of each joint as of J. Swevers et al., Optimal robot excitation and identification,
IEEE Transactions on Robotics and Automation 13 (1997), eq. 8, with angular frequency ω:

    q̇(t) = Σ aₖ cos kωt + bₖ sin kωt,    q and q̈ its integral and its derivative.

Rest at t = 0 and after each period takes Σ aₖ = 0 (velocity) and Σ k bₖ = 0 (acceleration).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm, joint_sizes
from lite6jax.design.candidates import Filter, all_pass, candidates, inside_limits
from lite6jax.design.criteria import Determinant, evaluate_each
from lite6jax.effects.motion import accelerated
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.motion import motion_of_recording

Matrix = NDArray[np.floating]
Numbers = Array | Matrix
"""Of JAX where something is differentiated, of NumPy elsewhere."""

VELOCITY = float(np.deg2rad(180.0))
"""rad/s, the greatest of a Lite 6."""
ACCELERATION = float(np.deg2rad(1146.0))
"""rad/s², the greatest of a Lite 6."""
DURATION, HARMONICS, RATE = 10.0, 5, 100.0
"""s of a period, harmonics of the series, samples a second."""
_PEAK_POINTS = 32
"""Points per period of the highest harmonic at which peaks are read."""
_POINTS = 16
"""Samples per period of the highest harmonic, over which the information is summed."""
_CHECKED = 4096
"""Samples of a period at which obstacles are checked: 10 mm apart at the tip of an arm of 1 m at full speed."""
_CLEAR = 0.03
"""m, from an obstacle, below which the ascent turns away; the check itself allows any distance above zero."""
_STEP = 1e-6
"""rad, rad/s, rad/s²: of the difference quotients."""
_WEIGHT = 2.0
"""Of one sample's whole penetration of `_CLEAR`, in units of log det M, averaged over the samples."""
_FIRST_RATE, _LAST_RATE = 0.1, 0.005
_FULL = 7.0
"""Of `Free.size`: 99.9 % of the greatest amplitude."""
_SMALLEST = 2.0**-6
"""Of the greatest amplitude: a motion that is refused at this size starts where there is no room."""
_FEWEST = 20
"""Random motions of which one has to pass."""


class Motion(NamedTuple):
    """Joint positions, velocities and accelerations, `(joint, sample)` each; rad, rad/s, rad/s², or with m for rad."""

    q: Numbers
    dq: Numbers
    ddq: Numbers


def read_motion(recording: Recording) -> tuple[Motion, list[str]]:
    """The motion of a recording, and what was assumed of it, a sentence each.

    Raises:
        InputError: it has neither times nor accelerations.
    """
    recording = recording.sorted_by_time()
    q, dq = recording.joint_position.T, recording.velocities().T
    if recording.motion == "static":
        return Motion(q, dq, np.zeros_like(q)), []
    if recording.joint_acceleration is not None:
        return Motion(q, dq, recording.joint_acceleration.T), []
    if recording.time is None:
        raise InputError(f"{recording.source}: has no accelerations; add time_s, or ddq1_rad_per_s2 …")
    found = accelerated(motion_of_recording(recording)).joint_acceleration
    note = "the accelerations were not recorded and come from differences of the velocities over 0.1 s"
    return Motion(q, dq, np.asarray(found)), [note]


Columns = Callable[[Motion], Numbers]
"""Whitened torques per unit of some parameters, of a motion: `(joint, column, sample)`, each sample by itself."""


class Series(NamedTuple):
    """A Fourier series per joint; a pytree.

    Attributes:
        centre: `(joint,)` rad, the mean position.
        cosine: `(joint, harmonic)` rad/s, aₖ.
        sine: `(joint, harmonic)` rad/s, bₖ.
        period: s.
    """

    centre: Numbers
    cosine: Numbers
    sine: Numbers
    period: Numbers | float

    def at(self, time: ArrayLike) -> Motion:
        """The motion at times `(sample,)` in s."""
        k = jnp.arange(1, self.cosine.shape[1] + 1)
        rate = 2 * jnp.pi * k / self.period
        angle = rate[:, None] * jnp.asarray(time)
        cos, sin = jnp.cos(angle), jnp.sin(angle)
        a, b = self.cosine, self.sine
        q = self.centre[:, None] + (a / rate) @ sin - (b / rate) @ cos
        return Motion(q, a @ cos + b @ sin, (b * rate) @ cos - (a * rate) @ sin)


class Free(NamedTuple):
    """Unbounded numbers from which `limit_series` makes a series that keeps its limits; a pytree.

    Attributes:
        shape: `(joint, 2 harmonics - 2)`: the direction of the coefficients; their length does not matter.
        place: `(joint,)`: where in the room that is left each joint's motion lies; 0 is its middle.
        size: `(joint,)`: how much of the greatest possible amplitude is used; 0 is a half.
    """

    shape: Numbers
    place: Numbers
    size: Numbers


@partial(jax.jit, static_argnames="harmonics")
def limit_series(
    free: Free, lower: Array, upper: Array, velocity: Array, acceleration: Array, period: Array, harmonics: int
) -> Series:
    """The series of unbounded numbers that keeps limits `(joint,)` of position, velocity and acceleration.

    A trigonometric polynomial of degree K is nowhere larger than 1/cos(πK/N) times its largest value at N equidistant
    points of a period (H. Ehlich, K. Zeller, 1964): with that factor the limits hold between the points as well.
    """
    count = _PEAK_POINTS * harmonics
    between = 1 / np.cos(np.pi * harmonics / count)
    k = np.arange(1, harmonics + 1)
    rest = np.stack([np.append(np.ones(harmonics), np.zeros(harmonics)), np.append(np.zeros(harmonics), k)])
    rest_to_rest = np.linalg.svd(rest)[2][2:]  # orthonormal coefficients, a then b, of motions at rest at t = 0
    directions = free.shape / jnp.sqrt(jnp.sum(free.shape**2, 1, keepdims=True))
    coefficients = directions @ jnp.asarray(rest_to_rest)
    plain = Series(jnp.zeros(len(directions)), coefficients[:, :harmonics], coefficients[:, harmonics:], period)
    q, dq, ddq = plain.at(period * jnp.arange(count) / count)
    high, low = q.max(1), q.min(1)
    half = between * (high - low) / 2
    peaks = [half / ((upper - lower) / 2)]
    peaks += [between * jnp.abs(rate).max(1) / limit for rate, limit in ((dq, velocity), (ddq, acceleration))]
    size = jax.nn.sigmoid(free.size) / jnp.max(jnp.stack(peaks), 0)
    slack = upper - lower - 2 * size * half
    middle = lower + size * half + jax.nn.sigmoid(free.place) * slack
    centre = middle - size * (high + low) / 2
    return Series(centre, size[:, None] * plain.cosine, size[:, None] * plain.sine, period)


class MotionLimits(NamedTuple):
    """What a motion keeps to.

    Attributes:
        position: `(joint, 2)` lower and upper, rad, m of prismatic joints as in all of these.
        velocity: `(joint,)` greatest magnitude, rad/s.
        acceleration: `(joint,)` greatest magnitude, rad/s².
    """

    position: Matrix
    velocity: Matrix
    acceleration: Matrix


def motion_limits(
    arm: Arm, velocity: ArrayLike = VELOCITY, acceleration: ArrayLike = ACCELERATION, margin: float = 0.0
) -> MotionLimits:
    """An arm's limits of position, drawn in by a margin (rad), with limits of velocity and acceleration.

    One number is of revolute joints, and of prismatic joints at `arms.arm.LEVER`: 180 deg/s is 0.31 m/s.

    Args:
        arm: whose limits of position; of a range of more than one turn its middle turn is used.
        velocity: rad/s, one number or one per joint, m/s of prismatic joints.
        acceleration: rad/s², likewise.
        margin: rad.

    Raises:
        InputError: a limit that is not positive, as many as neither one nor the joints, or as `inside_limits`.
    """
    limits = []
    for name, given, unit in (("velocity", velocity, "rad/s"), ("acceleration", acceleration, "rad/s²")):
        values = np.atleast_1d(np.asarray(given, float))
        if values.shape not in ((1,), (arm.dof,)) or not (np.isfinite(values).all() and (values > 0).all()):
            raise InputError(
                f"{name} limit {np.array2string(values, precision=4)} {unit}: give one number above 0, or"
                f" {arm.dof} of them"
            )
        limits.append(joint_sizes(float(values[0]), unit, arm.slides) if values.shape == (1,) else values.copy())
    position = inside_limits(arm, margin)
    middle, widest = position.mean(1, keepdims=True), np.where(arm.slides, np.inf, np.pi)[:, None]
    return MotionLimits(np.clip(position, middle - widest, middle + widest), *limits)


class Trajectory(NamedTuple):
    """A motion to execute, sample by sample, from rest to rest.

    Attributes:
        series: its Fourier series.
        time: `(sample,)` s, from 0 to one period.
        motion: `(joint, sample)` each; NumPy.
    """

    series: Series
    time: Matrix
    motion: Motion


@final
@dataclass(frozen=True, eq=False)
class MotionRoom:
    """Where and how fast a motion may be.

    Attributes:
        arm: that moves.
        limits: of each joint.
        filters: that every position passes.
        duration: of one period, s.
        harmonics: of the series.
        rate: samples a second that are recorded.

    Raises:
        InputError: a duration or rate that is not positive, fewer than two harmonics, or so few samples that the
            highest harmonic is not sampled ten times.
    """

    arm: Arm
    limits: MotionLimits
    filters: Sequence[Filter] = ()
    duration: float = DURATION
    harmonics: int = HARMONICS
    rate: float = RATE

    def __post_init__(self) -> None:
        for name, value, unit in (("duration", self.duration, "s"), ("rate", self.rate, "samples a second")):
            if not 0 < value < np.inf:
                raise InputError(f"{name} {value:g}: give a number of {unit}, above 0")
        if self.harmonics < 2:
            raise InputError(f"harmonics {self.harmonics}: a motion from rest to rest takes 2 or more")
        if self.samples < 10 * self.harmonics:
            raise InputError(
                f"a motion of {self.duration:g} s at {self.rate:g} samples a second is too short for"
                f" {self.harmonics} harmonics: give a longer one, of {10 * self.harmonics} samples or more"
            )

    @property
    def samples(self) -> int:
        """Of one period."""
        return round(self.duration * self.rate)

    @property
    def bounds(self) -> tuple[Matrix, ...]:
        """As `limit_series` takes them: positions, velocity, acceleration, period."""
        limits = self.limits
        return (*limits.position.T, limits.velocity, limits.acceleration, np.asarray(self.duration))

    def series(self, free: Free) -> Series:
        """The series of free numbers that keeps the limits."""
        return limit_series(free, *self.bounds, self.harmonics)

    def trajectory(self, free: Free) -> Trajectory:
        """The recorded samples of one period, both ends among them."""
        time, series = np.arange(self.samples + 1) * self.duration / self.samples, self.series(free)
        return Trajectory(series, time, Motion(*(np.asarray(part) for part in series.at(time))))

    def motion(self, free: Free, count: int) -> Motion:
        """The motion at so many equidistant instants of a period; NumPy."""
        return Motion(*(np.asarray(part) for part in _motion(free, self.bounds, self.harmonics, count)))

    def centre_at(self, middle: Matrix, free: Free) -> Free:
        """The motion moved to have its middle at joint positions `(joint,)`, or as near as the limits allow."""
        lower, upper = self.limits.position.T
        half = np.ptp(self.motion(free, _PEAK_POINTS * self.harmonics).q, axis=1) / 2
        share = (middle - lower - half) / np.maximum(upper - lower - 2 * half, _STEP)
        share = np.clip(share, 1e-3, 1 - 1e-3)
        return free._replace(place=np.log(share / (1 - share)))

    def passes(self, free: Free) -> bool:
        """Whether every filter accepts the whole motion."""
        return not self.filters or bool(all_pass(self.filters, np.asarray(self.motion(free, _CHECKED).q).T).all())


@partial(jax.jit, static_argnames=("harmonics", "count"))
def _motion(free: Free, bounds: tuple[Array, ...], harmonics: int, count: int) -> Motion:
    return limit_series(free, *bounds, harmonics).at(bounds[-1] * jnp.arange(count) / count)


def random_motions(room: MotionRoom, seed: int = 0, count: int = 50) -> list[Free]:
    """Motions of random direction about random positions that pass every filter, each as large as the limits allow,
    halved until the whole of it passes.

    Raises:
        InputError: as `candidates`; or fewer than one in `_FEWEST` passes at any size.
    """
    rng = np.random.default_rng(seed)
    dof = room.arm.dof
    middles = candidates(room.arm, _FEWEST * (count + 1), seed, room.filters).joint_position
    passed: list[Free] = []
    for tried, middle in enumerate(middles):
        if len(passed) == count:
            break
        if tried >= _FEWEST * (len(passed) + 1):
            names = ", ".join(condition.name for condition in room.filters)
            raise InputError(f"motions: {len(passed)} of {tried} random ones pass {names} at any amplitude; widen them")
        shape = rng.standard_normal((dof, 2 * room.harmonics - 2))
        share = 1.0
        while share >= _SMALLEST:
            size = _FULL if share == 1 else float(np.log(share / (1 - share)))
            free = room.centre_at(middle, Free(shape, np.zeros(dof), np.full(dof, size)))
            if room.passes(free):
                passed.append(free)
                break
            share /= 2
    return passed


@final
class Excitation(NamedTuple):
    """How a motion is judged: by log det M, with M the information of as many samples as are recorded of a period.

    Attributes:
        room: where it may be.
        columns: of a motion; NumPy or JAX.
    """

    room: MotionRoom
    columns: Columns

    def value(self, free: Free) -> float:
        """log det M; −inf where the motion does not determine all parameters."""
        columns = np.asarray(self.columns(self.room.motion(free, _POINTS * self.room.harmonics)))
        return float(evaluate_each(Determinant(), self._information(columns)[None])[0])

    def _information(self, columns: Matrix) -> Matrix:
        """M `(column, column)` of columns `(joint, column, sample)`."""
        return (columns @ columns.transpose(0, 2, 1)).sum(0) * (self.room.samples / columns.shape[2])

    def ascent(self, free: Free) -> tuple[float, float, Free]:
        """log det M, the penalty of obstacles, and the gradient of their difference.

        The columns are differenced by each joint's position, velocity and acceleration, sample by sample, so that they
        need not be traceable; the rest of the gradient is exact.
        """
        room = self.room
        motion = room.motion(free, _POINTS * room.harmonics)
        numbers = np.concatenate(motion)
        size, count = numbers.shape
        shifts = _STEP * np.concatenate([np.zeros((1, size)), np.eye(size)]).T
        around = (numbers[:, None] + shifts[:, :, None]).reshape(size, -1)
        columns = np.asarray(self.columns(Motion(*np.split(around, 3))))
        M = self._information(columns[:, :, :count])
        value = evaluate_each(Determinant(), M[None])[0]
        to_columns = 2 * room.samples / count * (np.linalg.inv(M) @ columns[:, :, :count])  # M is a sum over rows wᵀw
        change = np.einsum("jcns,jcs->ns", columns.reshape(*columns.shape[:2], 1 + size, count), to_columns)
        change = (change[1:] - change[0]) / _STEP
        penalty, push = self._penalty(numbers[: size // 3])
        change[: size // 3] -= push
        uphill = _pull_back(free, room.bounds, room.harmonics, Motion(*np.split(change, 3)))
        return float(value), penalty, uphill

    def _penalty(self, q: Matrix) -> tuple[float, Matrix]:
        """How far the motion enters what it is to keep clear of, and its gradient `(joint, sample)`."""
        dof, count = q.shape
        total, push = 0.0, np.zeros_like(q)
        shifts = _STEP * np.concatenate([np.zeros((1, dof)), np.eye(dof)])
        around = (q.T[None] + shifts[:, None]).reshape(-1, dof)
        harmonics = self.room.harmonics
        for condition in self.room.filters:
            if condition.distance is None:
                continue
            distance = condition.distance(around).reshape(dof + 1, count)
            into = np.maximum(1 - distance[0] / _CLEAR, 0.0)
            if not into.any():  # an arm without two links that could meet is infinitely far from itself
                continue
            total += _WEIGHT * float(np.sum(into**2)) / harmonics
            push += -2 * _WEIGHT / harmonics / _CLEAR * into * ((distance[1:] - distance[0]) / _STEP)
        return total, push


def ascend(excitation: Excitation, start: Free, steps: int) -> tuple[Free, float, int]:
    """Moves uphill from a motion that passes the filters, by Adam (D. Kingma, J. Ba, 2015) with a falling rate.

    Returns:
        the best motion met that passes, its log det M, and how many steps led to a better one.
    """
    best, best_value, improved = start, excitation.value(start), 0
    free, first, second = start, *(jax.tree.map(jnp.zeros_like, start) for _ in range(2))
    for i in range(steps):
        value, penalty, uphill = excitation.ascent(free)
        if value > best_value and penalty < _WEIGHT and excitation.room.passes(free):
            best, best_value, improved = free, value, improved + 1
        rate = _LAST_RATE + (_FIRST_RATE - _LAST_RATE) * (1 + np.cos(np.pi * i / steps)) / 2
        free, first, second = _adam(free, uphill, first, second, i + 1, rate)
    return jax.tree.map(np.asarray, best), best_value, improved


@jax.jit
def _adam(free: Free, uphill: Free, first: Free, second: Free, i: Array, rate: Array) -> tuple[Free, Free, Free]:
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, uphill)
    second = jax.tree.map(lambda v, g: 0.99 * v + 0.01 * g * g, second, uphill)

    def moved(x: Array, m: Array, v: Array) -> Array:
        return x + rate * (m / (1 - 0.9**i)) / (jnp.sqrt(v / (1 - 0.99**i)) + 1e-12)

    free = jax.tree.map(moved, free, first, second)
    return free._replace(shape=free.shape / jnp.sqrt(jnp.mean(free.shape**2, 1, keepdims=True))), first, second


@partial(jax.jit, static_argnames="harmonics")
def _pull_back(free: Free, bounds: tuple[Array, ...], harmonics: int, change: Motion) -> Free:
    """The gradient by the free numbers of what has the gradient `change` by the motion."""
    count = change.q.shape[1]
    return jax.vjp(lambda free: _motion(free, bounds, harmonics, count), free)[1](change)[0]


class MotionSearch(NamedTuple):
    """How the best motion is sought.

    Attributes:
        seed: of the random motions.
        draws: random motions, with which the best is compared too.
        starts: ascents, from the best of these.
        steps: of each ascent.
    """

    seed: int = 0
    draws: int = 50
    starts: int = 2
    steps: int = 150
