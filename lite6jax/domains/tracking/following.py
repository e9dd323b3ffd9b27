"""How joints follow commands without a model of the arm: the lag, how far, and what a linear follower leaves.

It is what data faults show in: clocks, units, gears and zeros change it by more than an arm can.
"""

import itertools
from typing import NamedTuple

import numpy as np

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.tracking.coupling import Bodies
from lite6jax.domains.tracking.ranges import resting_loads, run_ends
from lite6jax.domains.tracking.rows import period_of
from lite6jax.recordings import Recording

_EDGES = (0.0, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.5)
"""s, between which commands of the past are averaged: a servo answers in a part of that."""
_COARSE = 0.02
"""s, the grid on which lags are looked for at first."""
_LONGEST = 20.0
"""s, of a lag that is looked for, of either sign."""
_OVERLAP = 0.5
"""Share of a run that is compared at the longest lag."""
AHEAD = 0.04
"""s before the likeliest lag, at which the newest command of a follower is."""
_ALIKE = 0.02
"""By which squared correlations at two lags differ at most where a motion repeats itself."""
_RIDGE = 1e-8
"""Of the mean square of a column of the follower, beside which it is no information."""


class Follower(NamedTuple):
    """The linear follower of a joint.

    Attributes:
        gain: how far the joint moves for a slow motion of its command.
        added: `(feature,)`, the factors of what was fitted beside.
        remaining: `(sample,)` rad, measured less followed, of all rows.
    """

    gain: float
    added: Array
    remaining: Array


def past_commands(command: Array, run: Integers, period: float) -> Array:
    """Averages of a command `(sample,)` over intervals of the past, `(interval, sample)`, at rest before each run."""
    edges = np.unique([round(edge / period) for edge in _EDGES] + [1])
    averages = np.empty((len(edges) - 1, len(command)))
    for first, last in zip(*run_ends(run), strict=True):
        part = command[first:last]
        before = np.full(edges[-1], part[0])
        summed = np.r_[0.0, np.cumsum(np.r_[before, part])]
        newest = edges[-1] + np.arange(len(part)) + 1
        for k, (near, far) in enumerate(itertools.pairwise(edges)):
            averages[k, first:last] = (summed[newest - near] - summed[newest - far]) / (far - near)
    return averages


def fit_follower(
    past: Array, measured: Array, features: Array | None = None, rows: Mask | None = None, gain: float | None = None
) -> Follower:
    """The linear follower of a joint.

    Args:
        past: `(interval, sample)` rad, averages of the command.
        measured: `(sample,)` rad.
        features: `(feature, sample)`, what else is fitted; a constant always is.
        rows: `(sample,)`, which are fitted; all where not given.
        gain: that it is held at; free where not given.
    """
    samples = len(measured)
    more = np.zeros((0, samples)) if features is None else features
    chosen = np.ones(samples, bool) if rows is None else rows
    taps = past
    target = measured
    if gain is not None:  # the intervals differ from the newest one, which has what is missing of the gain
        taps = past[1:] - past[0]
        target = measured - gain * past[0]
    columns = np.concatenate([taps, more, np.ones((1, samples))])
    middle = columns[:, chosen].mean(1, keepdims=True)
    middle[-1] = 0.0
    shifted = columns - middle
    size = np.sqrt(np.mean(shifted[:, chosen] ** 2, 1))
    scaled = shifted / np.maximum(size, 1e-12)[:, None]
    squares = scaled[:, chosen] @ scaled[:, chosen].T
    squares[np.diag_indices(len(squares))] += _RIDGE * chosen.sum()
    factors = np.linalg.solve(squares, scaled[:, chosen] @ target[chosen])
    followed = factors @ scaled
    plain = factors / np.maximum(size, 1e-12)
    total = float(plain[: len(taps)].sum()) if gain is None else gain
    return Follower(total, plain[len(taps) : -1], target - followed)


def weight_features(even: Recording, bodies: Bodies, joint: int, late: Array) -> Array:
    """What the weight of the arm does at a joint, from 0, by late commands `(sample, joint)` rad: `(feature, sample)`.

    With masses that is its torque; without, sines and cosines of each sum of consecutive angles with this joint's.
    """
    if bodies.links.any():
        return resting_loads(bodies, late.T)[[joint]]
    sums = np.concatenate([np.zeros((len(late), 1)), np.cumsum(late, 1)], 1)
    angles = [sums[:, last] - sums[:, first] for first in range(joint + 1) for last in range(joint + 1, even.dof + 1)]
    return np.concatenate([np.sin(angles), np.cos(angles)])


class Lag(NamedTuple):
    """How read-outs follow commands that are so late, all joints together.

    Attributes:
        lag: s, at which commands and read-outs correlate best.
        missed: the mean over joints of the logarithm of the share of variance that linear followers leave.
        correlation: of followers and read-outs, root of the mean square over joints.
    """

    lag: float
    missed: float
    correlation: float


def scan_lags(even: Recording, joints: Integers, rows: slice) -> tuple[Array, Array]:
    """Lags `(lag,)` s of either sign, and squared correlations `(lag, joint)` of some rows of one run at each."""
    period = period_of(even)
    every = max(1, round(_COARSE / period))
    command = np.asarray(even.commanded_position)[rows][::every][:, joints]
    measured = even.joint_position[rows][::every][:, joints]
    count = len(command)
    most = int(min(_LONGEST / (every * period), (1 - _OVERLAP) * count))
    lags = np.arange(-most, most + 1)
    squares = np.zeros((len(lags), len(joints)))
    for place, lag in enumerate(lags):
        first = max(lag, 0)
        last = count + min(lag, 0)
        y = measured[first:last]
        u = command[first - lag : last - lag]
        squares[place] = _squared_correlations(u, y)
    return lags * every * period, squares


def _squared_correlations(u: Array, y: Array) -> Array:
    """`(joint,)` of `(sample, joint)`; zero of what is at rest."""
    u = u - u.mean(0)
    y = y - y.mean(0)
    sizes = (u * u).sum(0) * (y * y).sum(0)
    return (u * y).sum(0) ** 2 / np.where(sizes > 0, sizes, 1.0)


def likeliest_lag(lags: Array, squares: Array, within: Mask) -> float:
    """The lag, of some `(lag,)` s that are within a range, at which joints together correlate most.

    A motion that repeats itself correlates at several: the shortest is taken.
    """
    allowed = lags[within]
    missed = np.log(np.maximum(1 - squares[within], 1e-9)).mean(1)
    together = squares[within].mean(1)
    beside = np.pad(missed, 1, constant_values=np.inf)
    peaks = (missed <= beside[:-2]) & (missed <= beside[2:])
    alike = np.flatnonzero(peaks & (together >= together[np.argmin(missed)] - _ALIKE))
    return float(allowed[alike[np.argmin(np.abs(allowed[alike]))]])


def followed(even: Recording, joints: Integers, rows: slice, lag: float, newest: float) -> Lag:
    """How joints follow commands in some rows of one run.

    Commands that repeat themselves after a time are followed as closely at two lags: that tells nothing of their clock.

    Args:
        even: an even recording with commands.
        joints: from 0, those that move.
        rows: of one run.
        lag: s, of the likeliest lag in the range in question.
        newest: s, by which the newest command is late that a follower has; it has those of the half second before.
    """
    period = period_of(even)
    shift = round(newest / period)
    command = np.asarray(even.commanded_position)[rows][:, joints]
    measured = even.joint_position[rows][:, joints]
    count = len(command)
    first = max(shift, 0)
    last = count + min(shift, 0)
    earlier = command[first - shift : last - shift]
    later = measured[first:last]
    run = np.zeros(last - first, int)
    begun = np.arange(last - first) * period > _EDGES[-1]  # before that commands of the past are not all known
    shares = []
    for u, y in zip(earlier.T, later.T, strict=True):
        remaining = fit_follower(past_commands(u, run, period), y, rows=begun).remaining[begun]
        shares.append(np.var(remaining) / max(np.var(y[begun]), 1e-300))
    missed = np.log(np.maximum(shares, 1e-12))
    return Lag(lag, float(missed.mean()), float(np.sqrt(max(1 - np.mean(shares), 0.0))))
