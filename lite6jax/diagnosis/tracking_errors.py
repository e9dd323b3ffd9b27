"""What figures show of a diagnosis of commands and joints, as tables: a held-out stretch, and errors over speed, load
and time since the last reversal.
"""

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.diagnosis.tracking_diagnosis import TrackingDiagnosis
from lite6jax.domains.tracking.ranges import differentiate_runs, resting_loads, reversals, run_ends

Quantity = Literal["speed", "load", "since_reversal"]

_LONGEST = 4.0
"""s of a stretch: in more of them a lag is not legible."""
_SHIFTS = 4
"""Stretches that begin within the length of one."""
_MOST_JOINTS = 3
_LEAST_GAIN = 0.01
"""Of the mean square by which the most improved joint improves, that another joint of a stretch does at least."""
_BINS = 12
_LEAST_IN_BIN = 20
_RESOLVED = 200
"""Parts of a range that are distinguished: all rows at rest are of one bin."""
_LEAST_LOAD = 0.01
"""Nm, by which a load varies at least where errors are shown over it."""


class Stretch(NamedTuple):
    """A part of a block that was held out, in which joints reverse if they do so anywhere.

    Attributes:
        time: `(sample,)` s since the recording began.
        joints: those that improve most, counted from 0, the most improved first.
        command: `(joint, sample)` rad.
        measured: likewise.
        before: likewise, rolled out without the findings.
        after: likewise, rolled out with them.
    """

    time: Array
    joints: tuple[int, ...]
    command: Array
    measured: Array
    before: Array
    after: Array


class BinnedErrors(NamedTuple):
    """Held-out errors of a joint over a quantity, each `(bin,)`, of as many samples as its values allow.

    There are no bins where the quantity does not vary, or is not known.

    Attributes:
        at: the mean of the quantity: rad/s, Nm, or s.
        before: rad RMS, without the findings.
        after: likewise, with them.
    """

    at: Array
    before: Array
    after: Array


def held_out_stretch(found: TrackingDiagnosis) -> Stretch:
    """The part of a held-out block in which the joints that improve most are furthest from their rollouts."""
    problem = found.problem
    recording = found.recording
    joints = _most_improved(found)
    time = np.asarray(recording.time)
    rollout = _rollout(found)
    length = max(round(_LONGEST / problem.data.commands.period), 2)
    reversed_at = _reversed_rows(rollout[joints[0]], problem.run)
    squares = np.sum(found.before[list(joints)] ** 2, 0)

    def merit(rows: slice) -> tuple[bool, float]:
        return bool(reversed_at[rows].any()), float(np.sum(squares[rows]))

    rows = max(_stretches(problem.run, found.folds, length), key=merit)
    command = np.asarray(recording.commanded_position).T
    shown = np.array(joints)
    parts = (command, problem.measured, problem.measured + found.before, problem.measured + found.after)
    return Stretch(time[rows] - time[0], joints, *(part[shown, rows] for part in parts))


def errors_over_motion(found: TrackingDiagnosis) -> list[dict[Quantity, BinnedErrors]]:
    """For each joint its errors over its speed, over what it carries at rest, and over the time since it last reversed.

    Speed, load and reversals are those of the rollout with the findings. Loads are left out of an arm without masses.
    """
    problem = found.problem
    data = problem.data
    rollout = _rollout(found)
    velocity = differentiate_runs(rollout, data.commands.period, problem.run)
    load = resting_loads(data.bodies, rollout)
    over_motion = []
    for joint, row in enumerate(rollout):
        quantities: dict[Quantity, Array] = {"speed": np.abs(velocity[joint])}
        if data.has_masses:
            varies = np.ptp(load[joint]) > _LEAST_LOAD
            quantities["load"] = load[joint] if varies else np.full(len(row), np.nan)
        reversed_at = _reversed_rows(row, problem.run)
        quantities["since_reversal"] = data.commands.period * _samples_since(reversed_at, problem.run)
        errors = (found.before[joint], found.after[joint])
        over_motion.append({name: _binned(at, ~found.outliers, *errors) for name, at in quantities.items()})
    return over_motion


def _rollout(found: TrackingDiagnosis) -> Array:
    """`(joint, sample)` rad, with the findings fitted to all rows: it has no noise, and no jumps between blocks."""
    fit = found.fit
    return found.problem.readouts(fit.nuisance, fit.terms, fit.values)


def _most_improved(found: TrackingDiagnosis) -> tuple[int, ...]:
    """Joints, from 0, by how much smaller their errors are with the findings; by their size where there are none."""
    gains = np.mean(found.before[:, ~found.outliers] ** 2, 1)
    if found.findings:
        gains = gains - np.mean(found.after[:, ~found.outliers] ** 2, 1)
    order = np.argsort(-gains, kind="stable")[:_MOST_JOINTS]
    return tuple(joint for joint in order.tolist() if gains[joint] >= _LEAST_GAIN * gains[order[0]])


def _stretches(run: Integers, folds: Sequence[Mask], length: int) -> Iterator[slice]:
    """Parts of `length` samples at most, each of one run and of rows that were held out together."""
    blocks = len(folds) * run.astype(int) + np.argmax(folds, axis=0)
    for first, last in zip(*run_ends(blocks), strict=True):
        step = max(length // _SHIFTS, 1)
        for begin in range(first, max(last - length, first) + 1, step):
            yield slice(begin, min(begin + length, last))


def _reversed_rows(position: Array, run: Integers) -> Mask:
    """`(sample,)`, where a joint with these positions `(sample,)` rad reverses."""
    rows = np.zeros(len(position), bool)
    for first, last in zip(*run_ends(run), strict=True):
        rows[first + reversals(position[first:last])] = True
    return rows


def _samples_since(marked: Mask, run: Integers) -> Array:
    """`(sample,)`, how many samples ago the last marked row of the run was; NaN before its first one."""
    since = np.full(len(marked), np.nan)
    for first, last in zip(*run_ends(run), strict=True):
        at = first + np.flatnonzero(marked[first:last])
        rows = np.arange(first, last)
        latest = np.searchsorted(at, rows, side="right") - 1
        after_one = latest >= 0
        since[rows[after_one]] = rows[after_one] - at[latest[after_one]]
    return since


def _binned(values: Array, used: Mask, before: Array, after: Array) -> BinnedErrors:
    """Errors `(sample,)` rad over values `(sample,)`; rows in which these are not known are left out."""
    rows = np.flatnonzero(used & np.isfinite(values))
    count = min(len(rows) // _LEAST_IN_BIN, _BINS)
    if not count:
        return BinnedErrors(*np.zeros((3, 0)))
    known = values[rows]
    resolution = max(float(np.ptp(known)), 1e-12) / _RESOLVED
    levels = np.round(known / resolution)
    edges = np.unique(np.quantile(levels, np.linspace(0, 1, count + 1)))
    bin_of_row = np.searchsorted(edges[1:-1], levels, side="right")
    filled = [bin_of_row == k for k in np.unique(bin_of_row)]
    at = np.array([np.mean(known[part]) for part in filled])
    rms = [np.array([np.sqrt(np.mean(errors[rows][part] ** 2)) for part in filled]) for errors in (before, after)]
    return BinnedErrors(at, *rms)
