"""What explains a log without a model of the arm: that joints are where they are commanded, late, or of second order.

They are fitted to some samples and compared on others, as the servos are.
"""

from typing import Any

import numpy as np
import scipy  # whose parts are imported where they are first used: `signal` alone takes most of a second

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.tracking.ranges import run_ends

_DELAYS = np.arange(0.0, 0.4, 0.004)
"""s, of which the best constant delay of a joint is chosen."""
_FREQUENCIES = (8.0, 25.0, 80.0)
"""rad/s, from which the fit of a second order begins."""
_STEPS = 60
"""Evaluations of a fit at most."""


def fit_peers(command: Array, measured: Array, runs: Integers, period: float, training: Mask) -> dict[str, Array]:
    """The peers of a log on an even grid, fitted to the `training` `(sample,)` samples.

    Args:
        command: `(joint, sample)` rad.
        measured: likewise.
        runs: `(sample,)`, which changes where a run begins.
        period: s between samples.
        training: `(sample,)` bool.

    Returns:
        where joints would be by each peer, `(joint, sample)` rad: `commanded`, where they are commanded; `best_delay`,
        there after a time of each joint; `second_order`, a linear system of each joint with a gain and an offset.
    """
    late = best_delay(command, measured, runs, period, training)
    linear = np.stack([_second_order(u, y, runs, period, training) for u, y in zip(command, measured, strict=True)])
    return {"commanded": command, "best_delay": late, "second_order": linear}


def best_delay(command: Array, measured: Array, runs: Integers, period: float, training: Mask) -> Array:
    """The commands `(joint, sample)` after the delay of each joint that fits the training samples best."""
    best = command.copy()
    least = np.full(len(command), np.inf)
    for delay in _DELAYS:
        late = np.empty_like(command)
        for first, last in zip(*run_ends(runs), strict=True):
            t = period * np.arange(last - first)
            late[:, first:last] = [np.interp(t - delay, t, row[first:last]) for row in command]
        errors = np.mean((late - measured)[:, training] ** 2, 1)
        better = errors < least
        best[better] = late[better]
        least = np.minimum(least, errors)
    return best


def _second_order(command: Array, measured: Array, runs: Integers, period: float, training: Mask) -> Array:
    """`(sample,)` rad of one joint: k·u/(s²/w² + 2·z·s/w + 1) + o with w, z, k and o that fit best."""

    def follow(numbers: Array) -> Array:
        w, z = np.exp(np.clip(numbers[:2], -10.0, 10.0))
        system: Any = scipy.signal.cont2discrete(([w * w], [1.0, 2 * z * w, w * w]), period)
        numerator = np.ravel(system[0])
        denominator = np.ravel(system[1])
        position = np.empty_like(command)
        for first, last in zip(*run_ends(runs), strict=True):
            u = command[first:last]
            position[first:last] = scipy.signal.lfilter(numerator, denominator, u - u[0]) + u[0]
        return numbers[2] * position + numbers[3]

    def errors(numbers: Array) -> Array:
        return np.nan_to_num((follow(numbers) - measured)[training], nan=1e3, posinf=1e3, neginf=-1e3)

    starts = (np.array([np.log(w), 0.0, 1.0, 0.0]) for w in _FREQUENCIES)
    fits = [scipy.optimize.least_squares(errors, start, max_nfev=_STEPS) for start in starts]
    return follow(min(fits, key=lambda one: one.cost).x)
