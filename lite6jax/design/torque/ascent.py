"""Gradient ascent of a criterion over motions that keep their limits, away from obstacles."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from lite6jax.design.candidates import Filter, all_pass
from lite6jax.design.criteria import Criterion, determined_value
from lite6jax.design.torque.fourier import PEAK_POINTS, Free, Motion, MotionLimits, within

Matrix = NDArray[np.floating]
Columns = Callable[[Motion], Matrix | Array]
"""Whitened torques per unit of some parameters, of a motion: `(joint, column, sample)`, each sample by itself."""

POINTS = 16
"""Samples per period of the highest harmonic, over which the information is summed."""
CHECKED = 4096
"""Samples of a period at which obstacles are checked: 10 mm apart at the tip of an arm of 1 m at full speed."""
KEPT_CLEAR = 0.03
"""m, from an obstacle, below which the ascent turns away; the check itself allows any distance above zero."""
_STEP = 1e-6
"""rad, rad/s, rad/s²: of the difference quotients."""
_WEIGHT = 2.0
"""Of one sample's whole penetration of `KEPT_CLEAR`, in units of the criterion, averaged over the samples."""
_FIRST_RATE, _LAST_RATE = 0.1, 0.005


@final
class Excitation(NamedTuple):
    """How a motion is judged.

    Attributes:
        columns: of a motion; NumPy or JAX.
        criterion: of the information, in coordinates.
        outward: `(column, k)`, the determined directions (see `Coordinates`); None where they are the columns' own.
        limits: that every motion keeps.
        filters: that every position passes.
        period: s.
        harmonics: of the series.
        samples: that are recorded of a period; the information is that of so many.
    """

    columns: Columns
    criterion: Criterion
    outward: Matrix | None
    limits: MotionLimits
    filters: Sequence[Filter]
    period: float
    harmonics: int
    samples: int

    def motion(self, free: Free, count: int) -> Motion:
        """Its motion at so many equidistant instants of a period; NumPy."""
        return Motion(*(np.asarray(part) for part in _motion(free, self._room(), self.harmonics, count)))

    def about(self, middle: Matrix, free: Free) -> Free:
        """The motion moved to have its middle at joint positions `(joint,)`, or as near as the limits allow."""
        lower, upper = self.limits.position.T
        half = np.ptp(self.motion(free, PEAK_POINTS * self.harmonics).q, axis=1) / 2
        share = (middle - lower - half) / np.maximum(upper - lower - 2 * half, _STEP)
        share = np.clip(share, 1e-3, 1 - 1e-3)
        return free._replace(place=jnp.asarray(np.log(share / (1 - share))))

    def passes(self, free: Free) -> bool:
        """Whether every filter accepts the whole motion."""
        if not self.filters:
            return True
        return bool(all_pass(self.filters, np.asarray(self.motion(free, CHECKED).q).T).all())

    def value(self, free: Free) -> float:
        """The criterion of the recorded samples; −inf where the motion does not determine all directions."""
        columns = np.asarray(self.columns(self.motion(free, POINTS * self.harmonics)))
        return float(_value(self.criterion, self._gram(columns)[1]))

    def _room(self) -> tuple[Matrix, ...]:
        return (*self.limits.position.T, self.limits.velocity, self.limits.acceleration, np.asarray(self.period))

    def _gram(self, columns: Matrix) -> tuple[Matrix, Matrix]:
        """Columns in coordinates `(joint, k, sample)`, and their information `(k, k)`."""
        rows = columns if self.outward is None else self.outward.T @ columns
        return rows, (rows @ rows.transpose(0, 2, 1)).sum(0) * (self.samples / columns.shape[2])

    def ascent(self, free: Free) -> tuple[float, float, Free]:
        """The criterion, the penalty of obstacles, and the gradient of the smooth criterion less that penalty.

        The columns are differenced by each joint's position, velocity and acceleration, sample by sample, so that they
        need not be traceable; the rest of the gradient is exact.
        """
        motion = self.motion(free, POINTS * self.harmonics)
        numbers = np.concatenate(motion)
        size, count = numbers.shape
        shifts = _STEP * np.concatenate([np.zeros((1, size)), np.eye(size)]).T
        around = (numbers[:, None] + shifts[:, :, None]).reshape(size, -1)
        columns = np.asarray(self.columns(Motion(*np.split(around, 3))))
        rows, M = self._gram(columns[:, :, :count])
        value, slope = (np.asarray(part) for part in _value_and_slope(self.criterion, M))
        to_columns = 2 * self.samples / count * (slope @ rows)  # of M, a sum over rows wᵀw
        if self.outward is not None:
            to_columns = self.outward @ to_columns
        change = np.einsum("jcns,jcs->ns", columns.reshape(*columns.shape[:2], 1 + size, count), to_columns)
        change = (change[1:] - change[0]) / _STEP
        penalty, push = self._penalty(numbers[: size // 3])
        change[: size // 3] -= push
        uphill = _pull_back(free, self._room(), self.harmonics, Motion(*np.split(change, 3)))
        return float(value), penalty, uphill

    def _penalty(self, q: Matrix) -> tuple[float, Matrix]:
        """How far the motion enters what it is to keep clear of, and its gradient `(joint, sample)`."""
        dof, count = q.shape
        total, push = 0.0, np.zeros_like(q)
        shifts = _STEP * np.concatenate([np.zeros((1, dof)), np.eye(dof)])
        around = (q.T[None] + shifts[:, None]).reshape(-1, dof)
        for condition in self.filters:
            if condition.distance is None:
                continue
            distance = condition.distance(around).reshape(dof + 1, count)
            into = np.maximum(1 - distance[0] / KEPT_CLEAR, 0.0)
            if not into.any():  # an arm without two links that could meet is infinitely far from itself
                continue
            total += _WEIGHT * float(np.sum(into**2)) / self.harmonics
            slope = (distance[1:] - distance[0]) / _STEP
            push += -2 * _WEIGHT / self.harmonics / KEPT_CLEAR * into * slope
        return total, push


def ascend(excitation: Excitation, start: Free, steps: int) -> tuple[Free, float, int]:
    """Moves uphill from a motion that passes the filters, by Adam (D. Kingma, J. Ba, 2015) with a falling rate.

    Returns:
        the best motion met that passes, its criterion, and how many steps led to a better one.
    """
    best, best_value, improved = start, excitation.value(start), 0
    free, first, second = start, *(jax.tree.map(jnp.zeros_like, start) for _ in range(2))
    for i in range(steps):
        value, penalty, uphill = excitation.ascent(free)
        if value > best_value and penalty < _WEIGHT and excitation.passes(free):
            best, best_value, improved = free, value, improved + 1
        rate = _LAST_RATE + (_FIRST_RATE - _LAST_RATE) * (1 + np.cos(np.pi * i / steps)) / 2
        free, first, second = _adam(free, uphill, first, second, i + 1, rate)
    return best, best_value, improved


@jax.jit
def _adam(free: Free, uphill: Free, first: Free, second: Free, i: Array, rate: Array) -> tuple[Free, Free, Free]:
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, uphill)
    second = jax.tree.map(lambda v, g: 0.99 * v + 0.01 * g * g, second, uphill)

    def moved(x: Array, m: Array, v: Array) -> Array:
        return x + rate * (m / (1 - 0.9**i)) / (jnp.sqrt(v / (1 - 0.99**i)) + 1e-12)

    free = jax.tree.map(moved, free, first, second)
    return free._replace(shape=free.shape / jnp.sqrt(jnp.mean(free.shape**2, 1, keepdims=True))), first, second


@partial(jax.jit, static_argnames=("harmonics", "count"))
def _motion(free: Free, room: tuple[Array, ...], harmonics: int, count: int) -> Motion:
    return within(free, *room, harmonics).at(room[-1] * jnp.arange(count) / count)


@partial(jax.jit, static_argnames="harmonics")
def _pull_back(free: Free, room: tuple[Array, ...], harmonics: int, change: Motion) -> Free:
    """The gradient by the free numbers of what has the gradient `change` by the motion."""
    count = change.q.shape[1]
    return jax.vjp(lambda free: _motion(free, room, harmonics, count), free)[1](change)[0]


@jax.jit
def _value(criterion: Criterion, M: Array) -> Array:
    return determined_value(criterion, M)


@jax.jit
def _value_and_slope(criterion: Criterion, M: Array) -> tuple[Array, Array]:
    return determined_value(criterion, M), jax.grad(criterion.smooth)(M)
