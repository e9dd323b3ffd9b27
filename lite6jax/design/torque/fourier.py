"""Motions as finite Fourier series of each joint, that begin and end at rest and keep their limits at every instant.

The series is that of J. Swevers et al., Optimal robot excitation and identification, IEEE Transactions on Robotics and
Automation 13 (1997), eq. 8, with angular frequency ω:

    q̇(t) = Σ aₖ cos kωt + bₖ sin kωt,    q and q̈ its integral and its derivative.

Rest at t = 0 and after each period takes Σ aₖ = 0 (velocity) and Σ k bₖ = 0 (acceleration).
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.joint_units import joint_sizes
from lite6jax.design.candidates import inside_limits
from lite6jax.errors import InputError

VELOCITY = float(np.deg2rad(180.0))
"""rad/s, the greatest of a Lite 6."""
ACCELERATION = float(np.deg2rad(1146.0))
"""rad/s², the greatest of a Lite 6."""
PEAK_POINTS = 32
"""Points per period of the highest harmonic at which peaks are read."""


Numbers = Array | NDArray[np.floating]
"""Of JAX where something is differentiated, of NumPy elsewhere."""


class Motion(NamedTuple):
    """Joint positions, velocities and accelerations, `(joint, sample)` each; rad, rad/s, rad/s², or with m for rad."""

    q: Numbers
    dq: Numbers
    ddq: Numbers


@final
@dataclass(frozen=True, eq=False)
class MotionLimits:
    """What a motion keeps to.

    Attributes:
        position: `(joint, 2)` lower and upper, rad, m of prismatic joints as in all of these.
        velocity: `(joint,)` greatest magnitude, rad/s.
        acceleration: `(joint,)` greatest magnitude, rad/s².
    """

    position: NDArray[np.floating]
    velocity: NDArray[np.floating]
    acceleration: NDArray[np.floating]


def motion_limits(
    arm: Arm, velocity: ArrayLike = VELOCITY, acceleration: ArrayLike = ACCELERATION, margin: float = 0.0
) -> MotionLimits:
    """An arm's limits of position, drawn in by a margin (rad), with limits of velocity and acceleration.

    One number is of revolute joints, and of prismatic joints at `arms.joint_units.LEVER`: 180 deg/s is 0.31 m/s.

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
    """Unbounded numbers from which `within` makes a series that keeps its limits; a pytree.

    Attributes:
        shape: `(joint, 2 harmonics - 2)`: the direction of the coefficients; their length does not matter.
        place: `(joint,)`: where in the room that is left each joint's motion lies; 0 is its middle.
        size: `(joint,)`: how much of the greatest possible amplitude is used; 0 is a half.
    """

    shape: Numbers
    place: Numbers
    size: Numbers


@partial(jax.jit, static_argnames="harmonics")
def within(free: Free, lower: Array, upper: Array, velocity: Array, acceleration: Array, period: Array, harmonics: int):
    """The series of unbounded numbers that keeps limits `(joint,)` of position, velocity and acceleration.

    A trigonometric polynomial of degree K is nowhere larger than 1/cos(πK/N) times its largest value at N equidistant
    points of a period (H. Ehlich, K. Zeller, 1964): with that factor the limits hold between the points as well.

    Returns:
        a `Series`.
    """
    count = PEAK_POINTS * harmonics
    between = 1 / np.cos(np.pi * harmonics / count)
    directions = free.shape / jnp.sqrt(jnp.sum(free.shape**2, 1, keepdims=True))
    coefficients = directions @ jnp.asarray(_rest_to_rest(harmonics)).T
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


def _rest_to_rest(harmonics: int) -> NDArray[np.floating]:
    """`(2 harmonics, 2 harmonics - 2)` orthonormal coefficients, a then b, of motions at rest at t = 0."""
    k = np.arange(1, harmonics + 1)
    rest = np.stack([np.append(np.ones(harmonics), np.zeros(harmonics)), np.append(np.zeros(harmonics), k)])
    return np.linalg.svd(rest)[2][2:].T
