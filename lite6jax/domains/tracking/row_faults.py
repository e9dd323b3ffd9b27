"""Faults of rows of logs of commands: read-outs that repeat or are at their end, no torque, zeros of runs."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np
from scipy import ndimage

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.faults import Screened
from lite6jax.domains.tracking.column_faults import with_readouts
from lite6jax.domains.tracking.following import fit_follower, past_commands, weight_features
from lite6jax.domains.tracking.problem import tracking_problem
from lite6jax.domains.tracking.ranges import run_ends
from lite6jax.domains.tracking.rows import FOLLOWS, SAME, TrackingRows, lagged_correlation, quantum, tracking_rows
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.recordings.sequence import stretches

_BEGINNING = 0.02
"""s, or one sample, of each of two steps with which a run begins."""
_STEADY_START = 0.6
"""Of the second step the first one at least, of an arm that moves already: from rest it is a third of it."""
_LEAST_STEP = 2e-3
_BEGUN_NOISES = 10.0
"""rad, and standard deviations of the noise, of the first step."""
_BEHIND = 0.5
"""Of the first step, by which a joint that moves is at least behind its command: one that begins at rest is at it."""
_UNKNOWN_PAST = 0.5
"""s, by which servos have forgotten what they were commanded before a run begins."""
_STALE_STEPS = 4.0
"""Quanta, or standard deviations of the noise, that an arm moves beyond a row that repeats the one before it."""
_TWICE = 1.4
"""Times the step after it, from which a step is two at once."""
_ROUNDING = 1e-9
"""rad, by which numbers of a file differ at most that are the same to all digits."""
_MOST_STALE = 0.5
"""Share of rows that repeat the one before, above which nothing else would be left."""
_LEVEL = 4.5
"""Standard deviations of the noise within which a saturated read-out is about its end."""
_BEYOND = 6.0
"""Times what a follower leaves of the usual rows, from which it is beyond the end of a read-out."""
_LEAST_BEYOND = 0.01
"""rad, likewise."""
_FEWEST = 8
"""Rows that a read-out that is saturated has beyond its end, and in other places, at least."""
_STAYS = 0.97
"""Share of the rows beyond the end in which the read-out is there."""
_EDGE = 0.1
"""s about the rows in which a read-out reaches its end and leaves it: it is as before up to there."""
_EDGES_FIT = 3.0
"""Times what the follower leaves of the usual rows, up to which a clipped follower describes those."""
_REFITS = 6
"""Fits of a follower to rows that it describes."""
_OUTLYING = 5.0
"""Standard deviations, beyond which rows do not count in the next fit."""
_FAR = 0.1
"""rad, from which a joint is not where it would be if it followed."""
_SHORTEST = 0.3
"""s, of a time without torque at least."""
_JOINED = 0.15
"""s, between times without torque that are one."""
_AT_REST = 2e-3
"""rad, the range of a joint at rest at most, beside its noise."""
_WEAK = 0.15
"""Of the torque that a joint has in other rows: one with less has none."""
_NEEDED = 0.2
"""Of the torque that the commanded motion needs: a joint that has less in all rows has none."""
_UNRELATED = 0.7
"""Correlation at the best lag, below which a joint does not follow for a while."""
_OF_ASKED = 0.03
"""Of the torque that declared servos are asked for: a joint that has less in all rows, not along it, has none."""
_ALONG = 0.5
"""Share of rows with a torque along the one that is asked for less that of others, up to which it is not at its limit;
share of rows at rest, from which joints are."""
_FEWEST_ROWS = 0.3
"""Share of rows that must remain."""
_ZERO = 5e-3
"""rad, the least difference of zeros of runs that is said."""
_HALVED = 0.5
"""Of what is left without zeros of the runs, what is left with them at most."""
_WIDER = 3.0
"""Times the difference of means over runs of read-outs less commands, up to which zeros are of the log."""
_STEADY = 0.25
"""Of the largest difference of zeros, by which halves of runs differ at most."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class ScreenedTracking(Screened[TrackingRows]):
    """Rows on an even grid, with corrected columns.

    Attributes:
        unusable: `(sample,)` bool of the grid, rows that are left out.
    """

    unusable: Mask

    def without(self, code: str, rows: Mask, **numbers: Any) -> "ScreenedTracking":
        """With more rows `(sample,)` left out, which have a fault."""
        fault = DataFault(code, row_numbers(self.data.recording.row[rows]), {**numbers, "count": int(rows.sum())})
        return replace(self.with_faults([fault]), unusable=self.unusable | rows)

    def can_spare(self, rows: Mask) -> bool:
        """Tells whether enough rows remain without more of them."""
        return bool(np.mean(self.unusable | rows) <= 1 - _FEWEST_ROWS)


def drop_moving_starts(state: ScreenedTracking) -> ScreenedTracking:
    """Leaves the first rows of runs out that begin while the arm moves: what it was commanded before is not known.

    A rollout begins at rest.
    """
    data = state.data
    period = data.commands.period
    command = np.asarray(data.recording.commanded_position)
    step = max(round(_BEGINNING / period), 1)
    past = round(_UNKNOWN_PAST / period)
    left_out = np.zeros(data.commands.samples, bool)
    runs = 0
    for first, last in zip(*run_ends(data.recording.run), strict=True):
        if last - first <= 2 * step:
            continue
        instants = [first, first + step, first + 2 * step]
        sooner, later = np.diff(data.measured[:, instants]).T
        size = np.abs(sooner)
        moves = (size > np.maximum(_LEAST_STEP, _BEGUN_NOISES * data.noise)) & (size > _STEADY_START * np.abs(later))
        behind = np.abs(command[first] - data.measured[:, first])
        if np.any(moves & (behind > _BEHIND * size)):
            left_out[first : min(first + past, last)] = True
            runs = runs + 1
    left_out &= ~state.unusable
    if not left_out.any() or not state.can_spare(left_out):
        return state
    return state.without("moving_start", left_out, runs=runs)


def drop_stale_rows(state: ScreenedTracking) -> ScreenedTracking:
    """Leaves rows out whose read-outs repeat those of the row before, to all digits, while the arm moves."""
    stale = _stale_rows(state.data)
    if not stale.any():
        return state
    return state.without("stale_rows", stale)


def _stale_rows(data: TrackingRows) -> Mask:
    q = data.recording.joint_position
    run = data.recording.run
    same_run = np.diff(run) == 0
    repeated = np.r_[False, (np.abs(np.diff(q, axis=0)).max(1) < _ROUNDING) & same_run]
    if not repeated.any():
        return repeated
    quanta = np.array([quantum(column) for column in q.T])
    size = np.maximum(np.maximum(quanta, data.noise), SAME)
    steps = np.max(np.abs(np.diff(q, axis=0)) / size, 1)  # from each row to the next
    step_to = np.r_[0.0, steps]
    step_from = np.r_[steps, 0.0]
    step_after = np.r_[steps[1:], 0.0, 0.0]
    # a motion that begins from rest grows, and one whose row is missing goes two steps at once
    fresh = np.maximum.accumulate(np.where(repeated, 0, np.arange(len(q))))
    goes_on = (step_to[fresh] > _STALE_STEPS) | (step_from > _TWICE * step_after)
    stale = repeated & (step_from > _STALE_STEPS) & goes_on
    # rows before the jump repeat as well, back to the last one that was fresh
    for row in range(len(q) - 2, 0, -1):
        if stale[row + 1] and repeated[row]:
            stale[row] = True
    if np.mean(stale) > _MOST_STALE:
        return np.zeros(len(q), bool)
    return stale


class _Followed(NamedTuple):
    """A joint as a linear follower of its command has it.

    Attributes:
        position: `(sample,)` rad.
        spread: rad, robust standard deviation of what it leaves of the usual rows.
        usual: `(sample,)`, rows that it describes.
    """

    position: Array
    spread: float
    usual: Mask


def _followed(data: TrackingRows, joint: int, rows: Mask) -> _Followed:
    """A joint, from 0, as its command moves it, fitted to those of some rows that agree."""
    measured = data.measured[joint]
    command = np.asarray(data.recording.commanded_position)[:, joint]
    past = past_commands(command, data.recording.run, data.commands.period)
    remaining = measured - command
    middle = float(np.median(remaining[rows]))
    spread = max(1.4826 * float(np.median(np.abs(remaining[rows] - middle))), data.noise[joint])
    usual = rows & (np.abs(remaining - middle) < _OUTLYING * spread)
    for _ in range(_REFITS):
        remaining = fit_follower(past, measured, None, usual).remaining
        middle = float(np.median(remaining[usual]))
        spread = max(1.4826 * float(np.median(np.abs(remaining[usual] - middle))), data.noise[joint])
        chosen = rows & (np.abs(remaining - middle) < _OUTLYING * spread)
        if np.mean(chosen) < _FEWEST_ROWS or np.array_equal(chosen, usual):
            break
        usual = chosen
    return _Followed(measured - remaining, spread, usual)


# ------------------------------------------------------------------ read-outs at their end


def drop_saturated_rows(state: ScreenedTracking) -> ScreenedTracking:
    """Leaves rows out in which a read-out stays at its largest or smallest value while the joint goes on.

    A joint that its servo cannot move further slows down before it stops, and stops elsewhere under another load. A
    read-out that is at its end follows up to there, and is at the same value whenever the joint is beyond.
    """
    data = state.data
    usable = ~state.unusable
    for joint in range(len(data.measured)):
        for sign in (1.0, -1.0):
            rows = _saturated(data, joint, sign, usable)
            if rows is not None and state.can_spare(rows):
                end = float(np.median(data.measured[joint][rows]))
                state = state.without("saturated_readout", rows, joints=[joint + 1], end_rad=end)
    return state


def _saturated(data: TrackingRows, joint: int, sign: float, rows: Mask) -> Mask | None:
    """The rows in which a joint, from 0, is at the largest (or by `sign` smallest) value; None where none is an end."""
    y = sign * data.measured[joint]
    noise = data.noise[joint]
    highest = float(y[rows].max())
    near = rows & (y > highest - 2 * _LEVEL * noise)
    if near.sum() < _FEWEST:
        return None
    level = float(np.median(y[near]))
    end = rows & (np.abs(y - level) < max(highest - level, _LEVEL * noise))
    resting = _from_the_start(end, data.recording.run)
    end &= ~resting
    rows = rows & ~resting
    if np.sum(rows & ~end) < _FEWEST:  # of a joint at rest
        return None
    followed = _followed(data, joint, rows & ~end)
    position = sign * followed.position
    spread = float(np.sqrt(np.mean((position - y)[followed.usual & ~end] ** 2)))
    margin = max(_BEYOND * spread, _LEAST_BEYOND)
    beyond = rows & (position > level + margin)
    if beyond.sum() < _FEWEST or np.mean(end[beyond]) < _STAYS:
        return None
    clipped = np.minimum(position, level)
    width = max(1, round(_EDGE / data.commands.period))
    edges = np.asarray(ndimage.binary_dilation(beyond, iterations=width), bool) & rows
    if np.sqrt(np.mean((clipped - y)[edges] ** 2)) > _EDGES_FIT * max(spread, noise):
        return None
    return end


def _from_the_start(rows: Mask, run: Integers) -> Mask:
    """The rows of some from the beginning of their run on: a joint that has not moved yet has reached no end."""
    begins = np.flatnonzero(np.diff(run, prepend=run[0] - 1))
    others = np.cumsum(~rows)
    before = np.repeat(others[begins] - ~rows[begins], np.diff(np.append(begins, len(run))))
    return rows & (others == before)


# ------------------------------------------------------------------ servos without torque


def require_torque(data: TrackingRows) -> None:
    """Refuses joints that have hardly any torque in the whole log while their commands move.

    Raises:
        InputError: as said.
    """
    if not data.has_masses:
        return
    command = np.asarray(data.recording.commanded_position).T
    error = command - data.measured
    suspects = np.flatnonzero((np.std(command, 1) > _FAR) & (np.sqrt(np.mean(error**2, 1)) > _FAR))
    if not len(suspects):
        return
    at_rest = np.zeros_like(command)
    needed = np.sqrt(np.mean(data.bodies.torques(command, at_rest, at_rest) ** 2, 1))
    period = data.commands.period
    off = []
    for joint in suspects.tolist():
        follows = lagged_correlation(command[joint][:, None], data.measured[joint][:, None], period)
        torques = [torque[joint] for torque in _torques(data)]
        size = min(float(np.median(np.abs(torque))) for torque in torques)
        asked = np.asarray(data.servo.stiffness)[joint] * np.median(np.abs(error[joint]))
        small = size < _NEEDED * needed[joint] or (data.declared and size < _OF_ASKED * asked)
        if follows[0, 0] < _UNRELATED and small and not _at_limit(torques[-1], error[joint]):
            off.append(f"q{joint + 1}_rad")
    if off:
        raise InputError(
            f"{data.recording.source}: {', '.join(off)} moves as if its servo did not act while its command moves: its "
            "torque may be off; leave out such rows, or declare the payload"
        )


def _torques(data: TrackingRows) -> list[Array]:
    """`(joint, sample)` Nm, what servos exert along the measured motion, by the declared arm and its friction.

    Motors without current may still brake: of declared servos it is given without their damping as well.
    """
    motion = data.motion
    moved = (motion.joint_position, motion.joint_velocity, motion.joint_acceleration)
    q, dq, ddq = (np.asarray(part) for part in moved)
    friction = data.servo.viscous[:, None] * dq + data.servo.coulomb[:, None] * np.asarray(motion.direction)
    torque = data.bodies.torques(q, dq, ddq) + data.servo.inertia[:, None] * ddq + friction
    return [torque, torque + data.servo.damping[:, None] * dq] if data.declared else [torque]


def _at_limit(torque: Array, error: Array) -> bool:
    """Tells whether a torque `(sample,)` Nm, without damping, is mostly along the one that is asked for.

    With the damping, a joint that falls and brakes would be as well.
    """
    return bool(np.mean(np.sign(torque * error)) > _ALONG)


def drop_rows_without_torque(state: ScreenedTracking) -> ScreenedTracking:
    """Leaves rows out in which joints fall or rest while their commands go on.

    Either all joints are at rest, as behind a protective stop; or a joint is far from where it would be, and has, by
    the masses of the arm, none of the torque that it has in other rows. One that is at its torque limit has that.
    """
    data = state.data
    period = data.commands.period
    run = data.recording.run
    joints = range(len(data.measured))
    followed = [_followed(data, joint, ~state.unusable) for joint in joints]
    limits = [max(_FAR, _BEYOND * one.spread) for one in followed]
    away = np.stack(
        [np.abs(one.position - y) > limit for one, y, limit in zip(followed, data.measured, limits, strict=True)]
    )
    away &= ~state.unusable
    if not away.any():
        return state
    off = away & _still(data).all(0)
    if data.has_masses:
        off |= away & _weak(data, followed)
    rows = np.zeros_like(state.unusable)
    assert data.recording.time is not None
    concerned: set[int] = set()
    for first, last in _intervals(np.asarray(off.any(0)), run, period):
        # a joint falls before it is far away, and needs time to come back
        begin, end = _whole_absence(np.asarray(away.any(0)), run, first, last, round(_SHORTEST / period))
        idle = [joint for joint in joints if off[joint, first:last].any() and _idle(data, joint, first, last)]
        if idle:
            rows[begin:end] = True
            concerned |= {joint + 1 for joint in idle}
    if not rows.any() or not state.can_spare(rows):
        return state
    time = data.recording.time[rows]
    return state.without("torque_off", rows, joints=sorted(concerned), from_s=float(time[0]), to_s=float(time[-1]))


def _weak(data: TrackingRows, followed: list[_Followed]) -> Mask:
    """`(joint, sample)`, where joints have hardly any torque: of what they have in usual rows, and of what is asked."""
    width = max(3, round(_SHORTEST / data.commands.period))
    torque = np.min([ndimage.median_filter(np.abs(torque), (1, width)) for torque in _torques(data)], 0)
    usual = np.array([np.percentile(size[one.usual], 95) for size, one in zip(torque, followed, strict=True)])
    weak = torque < _WEAK * usual[:, None]
    if data.declared:
        error = np.abs(np.asarray(data.recording.commanded_position).T - data.measured)
        weak &= torque < _WEAK * np.asarray(data.servo.stiffness)[:, None] * error
    return weak


def _idle(data: TrackingRows, joint: int, first: int, last: int) -> bool:
    """Tells whether a joint, from 0, does not follow its command, which moves, from a row up to another."""
    command = np.asarray(data.recording.commanded_position)[first:last, joint]
    measured = data.measured[joint, first:last]
    if np.ptp(command) < _FAR:
        return False
    follows = lagged_correlation(command[:, None], measured[:, None], data.commands.period)
    if follows[0, 0] > _UNRELATED:
        return False
    if not data.has_masses or _still(data)[:, first:last].all(0).mean() > _ALONG:
        return True
    return not _at_limit(_torques(data)[-1][joint, first:last], command - measured)


def _still(data: TrackingRows) -> Mask:
    """`(joint, sample)`, where joints are at rest for the shortest time that counts."""
    width = max(3, round(_SHORTEST / data.commands.period))
    size = (1, width)
    span = ndimage.maximum_filter(data.measured, size) - ndimage.minimum_filter(data.measured, size)
    return span < _AT_REST + 2 * _LEVEL * data.noise[:, None]


def _intervals(rows: Mask, run: Integers, period: float) -> list[tuple[int, int]]:
    """Where rows are true for long enough, from one up to another, within runs; short breaks do not count."""
    joined = np.asarray(ndimage.binary_closing(rows, iterations=max(1, round(_JOINED / period / 2))), bool) | rows
    return [
        (span.start, span.stop) for span in stretches(joined, run) if (span.stop - span.start) * period >= _SHORTEST
    ]


def _whole_absence(away: Mask, run: Integers, first: int, last: int, more: int) -> tuple[int, int]:
    """An interval with what is before and after it of the same absence, in its run."""
    rows = away.copy()
    rows[first:last] = True
    (absence,) = (span for span in stretches(rows, run) if span.start <= first < span.stop)
    in_run = np.flatnonzero(run == run[first])
    return max(absence.start - more, int(in_run[0])), min(absence.stop + more, int(in_run[-1]) + 1)


# ------------------------------------------------------------------ zeros of runs


def with_one_zero(state: ScreenedTracking) -> ScreenedTracking:
    """Takes zeros of joints away that differ from run to run.

    The zero of a run is what its read-outs have beyond a follower of its command with the weight and the direction of
    motion, of all runs together. It counts where it is the same in both halves of the run, and leaves less than half
    of what is left without it. The run whose zero is nearest to the description's keeps it.
    """
    data = state.data
    runs = np.unique(data.recording.run)
    offsets = np.zeros((len(data.measured), len(runs)))
    for joint in range(len(data.measured) if len(runs) > 1 else 0):
        zeros = _zeros_of_runs(data, joint, ~state.unusable)
        if zeros is not None:
            offsets[joint] = zeros
    changed = np.flatnonzero(offsets.any(1))
    if not changed.size:
        return state
    place = np.searchsorted(runs, data.recording.run)
    recording = with_readouts(data.recording, data.recording.joint_position - offsets.T[place])
    faults = [
        DataFault("zero_per_run", (), {"joints": [joint + 1], "zeros_rad": offsets[joint].tolist()})
        for joint in changed.tolist()
    ]
    return state.with_faults(faults, tracking_rows(recording, data.arm))


def _zeros_of_runs(data: TrackingRows, joint: int, rows: Mask) -> Array | None:
    """`(run,)` rad, the zeros of a joint, from 0, in each run; None where they do not differ.

    Of a declared servo the rollout is taken away first, for what is not linear in it.
    """
    even = data.recording
    period = data.commands.period
    command = np.asarray(even.commanded_position)
    past = past_commands(command[:, joint], even.run, period)
    late = np.stack([past_commands(column, even.run, period)[:-1].mean(0) for column in command.T], 1)
    weight = weight_features(even, data.bodies, joint, late)
    speed = np.gradient(late[:, joint], period)
    direction = np.tanh(speed / 0.01)[None]
    features = np.concatenate([weight, direction])
    number = np.searchsorted(np.unique(even.run), even.run)
    count = int(number.max()) + 1
    half = np.zeros(len(number), int)
    for k in range(count):
        members = np.flatnonzero((number == k) & rows)
        half[members[len(members) // 2 :]] = 1
    measured = data.measured[joint]
    apart = []
    for k in range(count):
        members = rows & (number == k)
        if members.sum() < _FEWEST:
            return None
        follows = lagged_correlation(command[members][:, [joint]], measured[members][:, None], period)
        if abs(follows[0, 0]) < FOLLOWS:
            return None
        apart.append(float(np.mean((measured - command[:, joint])[members])))
    plain = fit_follower(past, measured, features, rows)
    dummies = np.stack([(number == k).astype(float) for k in range(1, count)])
    zeros = fit_follower(past, measured, np.concatenate([features, dummies]), rows)
    without, remaining = (float(np.std(fit.remaining[rows])) for fit in (plain, zeros))
    offsets = np.r_[0.0, zeros.added[len(features) :]]
    if np.ptp(offsets) > min(_WIDER * np.ptp(apart), np.pi):  # not told apart from the weight
        return None
    if np.ptp(offsets) < _ZERO or remaining > _HALVED * without or np.ptp(offsets) < 3 * remaining:
        return None
    parts = 2 * number + half
    means = np.array([zeros.remaining[rows & (parts == part)].mean() for part in range(2 * count)])
    if np.abs(means).max() > _STEADY * np.ptp(offsets):
        return None
    if data.declared and data.has_masses:
        problem = tracking_problem(data)
        rolled = problem.readouts(np.zeros(len(problem.unknowns)), Terms(), np.zeros(0))[joint]
        away = measured - rolled
        middles = np.array([np.median(away[rows & (number == k)]) for k in range(count)])
        if np.median(np.abs(away - middles[number])[rows]) < remaining:
            offsets = middles - middles[0]
            if np.ptp(offsets) < _ZERO:
                return None
    return offsets - offsets[_nearest_run(data, joint, offsets, number)]


def _nearest_run(data: TrackingRows, joint: int, offsets: Array, number: Integers) -> int:
    """The run whose zero is nearest to the description's: its read-outs are nearest to its commands in the mean."""
    command = np.asarray(data.recording.commanded_position)[:, joint]
    shares = np.bincount(number) / len(number)
    error = float(np.mean(data.measured[joint] - command))
    return int(np.argmin(np.abs(error + offsets - shares @ offsets)))
