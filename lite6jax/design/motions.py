"""Motions from rest to rest that keep their limits, and gradient ascent of their information over them.

Motions are finite Fourier series of each joint as of J. Swevers et al., Optimal robot excitation and identification,
IEEE Transactions on Robotics and Automation 13 (1997), eq. 8, with angular frequency ω:

    q̇(t) = Σ aₖ cos kωt + bₖ sin kωt,    q and q̈ its integral and its derivative.

Rest at t = 0 and after each period takes Σ aₖ = 0 (velocity) and Σ k bₖ = 0 (acceleration).

A motion that keeps its limits is made of unbounded numbers `(joint, 2 harmonics)`: the direction of the coefficients,
whose length does not matter; where in the room that is left the joint's motion lies, 0 in its middle; and how much of
the greatest possible amplitude is used, 0 for a half.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from lite6jax.arms.arm import Arm, joint_sizes
from lite6jax.array_types import Array
from lite6jax.design.candidates import Filter, all_pass, candidates, inside_limits
from lite6jax.effects.motion import accelerated
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.motion import motion_of_recording

Numbers = jax.Array | Array
"""Of JAX where something is differentiated, of NumPy elsewhere."""

VELOCITY = float(np.deg2rad(180.0))
"""rad/s, the greatest of a Lite 6."""
ACCELERATION = float(np.deg2rad(1146.0))
"""rad/s², the greatest of a Lite 6."""
_PEAK_POINTS = 32
"""Points per period of the highest harmonic at which peaks are read."""
_POINTS = 16
"""Samples per period of the highest harmonic, over which the information is summed."""
_CHECKED = 4096
"""Samples of a period at which obstacles are checked: 10 mm apart at the tip of an arm of 1 m at full speed."""
_CLEAR = 0.03
"""m, from an obstacle, below which the ascent turns away; the check itself allows any distance above zero."""
_WEIGHT = 2.0
"""Of one sample's whole penetration of `_CLEAR`, in units of log det M, averaged over the samples."""
_FIRST_RATE = 0.1
_LAST_RATE = 0.005
_FULL = 7.0
"""Of the number for the amplitude: 99.9 % of the greatest."""
_SMALLEST = 2.0**-6
"""Of the greatest amplitude: a motion that is refused at this size starts where there is no room."""
_FEWEST = 20
"""Random motions of which one has to pass."""


class JointTrajectory(NamedTuple):
    """Joint positions, velocities and accelerations, `(joint, sample)` each; rad, rad/s, rad/s², or with m for rad."""

    q: Numbers
    dq: Numbers
    ddq: Numbers


def read_motion(recording: Recording) -> tuple[JointTrajectory, list[str]]:
    """The motion of a recording, and what was assumed of it, a sentence each.

    Raises:
        InputError: it has neither times nor accelerations.
    """
    recording = recording.sorted_by_time()
    q = recording.joint_position.T
    dq = recording.velocities().T
    if recording.motion == "static":
        return JointTrajectory(q, dq, np.zeros_like(q)), []
    if recording.joint_acceleration is not None:
        return JointTrajectory(q, dq, recording.joint_acceleration.T), []
    if recording.time is None:
        raise InputError(f"{recording.source}: has no accelerations; add time_s, or ddq1_rad_per_s2 …")
    acceleration = accelerated(motion_of_recording(recording)).joint_acceleration
    note = "the accelerations were not recorded and come from differences of the velocities over 0.1 s"
    return JointTrajectory(q, dq, np.asarray(acceleration)), [note]


@final
@dataclass(frozen=True, eq=False)
class MotionRoom:
    """Where and how fast a motion may be.

    One limit is of revolute joints, and of prismatic joints at `arms.arm.LEVER`: 180 deg/s is 0.31 m/s.

    Attributes:
        arm: that moves, inside its limits of position.
        velocity: greatest magnitude, rad/s, m/s of prismatic joints; `(joint,)`, made of one number or one per joint.
        acceleration: rad/s², likewise.
        margin: by which limits of position are drawn in, rad.
        filters: that every position passes.
        duration: of one period, s.
        harmonics: of the series.
        rate: samples a second that are recorded.

    Raises:
        InputError: a limit, duration or rate that is not positive, limits as many as neither one nor the joints, as
            `inside_limits`, fewer than two harmonics, or so few samples that the highest is not sampled ten times.
    """

    arm: Arm
    velocity: Any = VELOCITY
    acceleration: Any = ACCELERATION
    margin: float = 0.0
    filters: Sequence[Filter] = ()
    duration: float = 10.0
    harmonics: int = 5
    rate: float = 100.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity", per_joint(self.arm, self.velocity, "velocity limit", "rad/s"))
        acceleration = per_joint(self.arm, self.acceleration, "acceleration limit", "rad/s²")
        object.__setattr__(self, "acceleration", acceleration)
        for name, value, unit in (("duration", self.duration, "s"), ("rate", self.rate, "samples a second")):
            if not 0 < value < np.inf:
                raise InputError(f"{name} {value:g}: give a number of {unit}, above 0")
        if self.harmonics < 2:
            raise InputError(f"harmonics {self.harmonics}: a motion from rest to rest takes 2 or more")
        fewest_samples = 10 * self.harmonics
        if self.samples < fewest_samples:
            raise InputError(
                f"a motion of {self.duration:g} s at {self.rate:g} samples a second is too short for {self.harmonics}"
                f" harmonics: give a longer one, of {fewest_samples} samples or more"
            )
        inside_limits(self.arm, self.margin)

    @cached_property
    def position(self) -> Array:
        """`(joint, 2)` lower and upper, rad, m of prismatic joints; of more than one turn the middle one."""
        position = inside_limits(self.arm, self.margin)
        middle = position.mean(1, keepdims=True)
        widest = np.where(self.arm.slides, np.inf, np.pi)[:, None]
        return np.clip(position, middle - widest, middle + widest)

    @property
    def samples(self) -> int:
        """Number of samples of one period."""
        return round(self.duration * self.rate)

    def move(self, free: ArrayLike, time: ArrayLike) -> JointTrajectory:
        """The motion of unbounded numbers `(joint, 2 harmonics)` at times `(sample,)` s; plain JAX."""
        return _move(free, time, self.position, self.velocity, self.acceleration, self.duration)

    def move_evenly(self, free: ArrayLike, count: int) -> JointTrajectory:
        """The motion at so many equidistant instants of a period; plain JAX."""
        return self.move(free, self.duration * np.arange(count) / count)

    def passes(self, free: Array) -> bool:
        """Tells whether every filter accepts the whole motion."""
        return not self.filters or bool(all_pass(self.filters, np.asarray(self.move_evenly(free, _CHECKED).q).T).all())


def per_joint(arm: Arm, numbers: ArrayLike, name: str, unit: str, number: str = "number") -> Array:
    """A number above zero of each joint `(joint,)`, of one for all, of prismatic joints at `LEVER`, or of one for each.

    Raises:
        InputError: other numbers; it says the `name`, the unit, and which `number` to give.
    """
    values = np.atleast_1d(np.asarray(numbers, float))
    if values.shape not in ((1,), (arm.dof,)) or not (np.isfinite(values).all() and (values > 0).all()):
        shown = " ".join(f"{value:g}" for value in values.ravel())
        raise InputError(f"{name} {shown} {unit}: give one {number} above 0, or {arm.dof} of them")
    return joint_sizes(float(values[0]), unit, arm.slides) if values.shape == (1,) else values.copy()


@jax.jit
def _move(
    free: jax.Array,
    time: jax.Array,
    position: jax.Array,
    velocity: jax.Array,
    acceleration: jax.Array,
    period: jax.Array | float,
) -> JointTrajectory:
    """A trigonometric polynomial of degree K is nowhere larger than 1/cos(πK/N) times its largest value at N
    equidistant points of a period (H. Ehlich, K. Zeller, 1964): with that factor the limits hold at every instant."""
    harmonics = free.shape[1] // 2
    k = np.arange(1, harmonics + 1)
    count = _PEAK_POINTS * harmonics
    rest_conditions = np.stack([np.append(np.ones(harmonics), np.zeros(harmonics)), np.append(np.zeros(harmonics), k)])
    # orthonormal coefficients, a then b, of motions at rest at t = 0
    rest_to_rest = np.linalg.svd(rest_conditions)[2][2:]
    directions = free[:, :-2] / jnp.sqrt(jnp.sum(free[:, :-2] ** 2, 1, keepdims=True))
    a, b = jnp.split(directions @ rest_to_rest, 2, axis=1)
    rate = 2 * jnp.pi * k / period

    def series(time: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        angle = rate[:, None] * time
        cos = jnp.cos(angle)
        sin = jnp.sin(angle)
        return (a / rate) @ sin - (b / rate) @ cos, a @ cos + b @ sin, (b * rate) @ cos - (a * rate) @ sin

    between = 1 / np.cos(np.pi * harmonics / count)
    q, dq, ddq = series(period * jnp.arange(count) / count)
    lower, upper = position.T
    high = q.max(1)
    low = q.min(1)
    half = between * (high - low) / 2
    peaks = [half / ((upper - lower) / 2)]
    peaks += [
        between * jnp.abs(derivative).max(1) / limit for derivative, limit in ((dq, velocity), (ddq, acceleration))
    ]
    size = jax.nn.sigmoid(free[:, -1]) / jnp.max(jnp.stack(peaks), 0)
    middle = lower + size * half + jax.nn.sigmoid(free[:, -2]) * (upper - lower - 2 * size * half)
    q, dq, ddq = (size[:, None] * trajectory for trajectory in series(time))
    return JointTrajectory(q + (middle - size * (high + low) / 2)[:, None], dq, ddq)


def random_motions(room: MotionRoom, seed: int = 0, count: int = 50) -> list[Array]:
    """Motions of random direction about random positions that pass every filter, each as large as the limits allow,
    halved until the whole of it passes.

    Raises:
        InputError: as `candidates`; or fewer than one in `_FEWEST` passes at any size.
    """
    rng = np.random.default_rng(seed)
    middles = candidates(room.arm, _FEWEST * (count + 1), seed, room.filters).joint_position
    lower, upper = room.position.T
    passed: list[Array] = []
    for attempts, middle in enumerate(middles):
        if len(passed) == count:
            break
        if attempts >= _FEWEST * (len(passed) + 1):
            names = ", ".join(condition.name for condition in room.filters)
            raise InputError(
                f"motions: {len(passed)} of {attempts} random ones pass {names} at any amplitude; widen them"
            )
        free = np.zeros((room.arm.dof, 2 * room.harmonics))
        free[:, :-2] = rng.standard_normal((room.arm.dof, 2 * room.harmonics - 2))
        share = 1.0
        while share >= _SMALLEST:
            free[:, -1] = _FULL if share == 1 else np.log(share / (1 - share))
            half = np.ptp(np.asarray(room.move_evenly(free, _PEAK_POINTS * room.harmonics).q), axis=1) / 2
            place = np.clip((middle - lower - half) / np.maximum(upper - lower - 2 * half, 1e-6), 1e-3, 1 - 1e-3)
            free[:, -2] = np.log(place / (1 - place))
            if room.passes(free):
                passed.append(free)
                break
            share /= 2
    return passed


def ascend(
    room: MotionRoom, height: Callable[[JointTrajectory], jax.Array], starts: Sequence[Array], steps: int
) -> tuple[Array, float, int]:
    """Moves uphill from motions that pass the filters, by Adam (D. Kingma, J. Ba, 2015) with a falling rate.

    `height` is of a motion of few samples, traceable; each start is `(joint, 2 harmonics)`.

    Returns:
        the best motion met that passes, its height, and how many steps led to a better one.
    """
    distances = [condition.distance for condition in room.filters if condition.distance is not None]

    def climb(free: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        motion = room.move_evenly(free, _POINTS * room.harmonics)
        value = height(motion)
        penalty = jnp.zeros(())
        for distance in distances:
            into = jnp.maximum(1 - distance(jnp.asarray(motion.q).T) / _CLEAR, 0.0)
            penalty += _WEIGHT * jnp.sum(into**2) / room.harmonics
        return value - penalty, (value, penalty)

    judge = jax.jit(jax.value_and_grad(climb, has_aux=True))
    best_motion = starts[0]
    best_value = -np.inf
    improved = 0
    for start in starts:
        free = start
        first = np.zeros_like(start)
        second = np.zeros_like(start)
        for i in range(steps + 1):
            (_, (value, penalty)), uphill = judge(free)
            if value > best_value and (i == 0 or (penalty < _WEIGHT and room.passes(free))):
                best_motion = free
                best_value = float(value)
                improved = improved + (i > 0)
            first = 0.9 * first + 0.1 * np.asarray(uphill)
            second = 0.99 * second + 0.01 * np.asarray(uphill) ** 2
            rate = _LAST_RATE + (_FIRST_RATE - _LAST_RATE) * (1 + np.cos(np.pi * i / max(steps, 1))) / 2
            mean = first / (1 - 0.9 ** (i + 1))
            spread = second / (1 - 0.99 ** (i + 1))
            free = free + rate * mean / (np.sqrt(spread) + 1e-12)
            free[:, :-2] /= np.sqrt(np.mean(free[:, :-2] ** 2, 1, keepdims=True))  # the steps turn it alike
    return best_motion, best_value, improved
