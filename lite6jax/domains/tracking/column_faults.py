"""Faults of whole columns of logs of commands: another clock, exchanged joints, reversed signs, other units and gears.

Commands and read-outs alike may be the wrong ones. The arm as it is declared tells: its weight pulls one way. Of both
corrections the one is taken whose rollout is nearer to the read-outs; without masses it is that of the read-outs.
"""

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.domains.tracking.coupling import Bodies
from lite6jax.domains.tracking.following import (
    Lag,
    fit_follower,
    likeliest_lag,
    past_commands,
    scan_lags,
    weight_features,
)
from lite6jax.domains.tracking.predict import run_ends
from lite6jax.domains.tracking.problem import tracking_problem
from lite6jax.domains.tracking.rows import even_rows, lagged_correlation, tracking_rows
from lite6jax.errors import InputError
from lite6jax.estimation.problem import Mask
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault
from lite6jax.recordings.settings import ServoSettings

Array = NDArray[np.floating]

_FOLLOWS = 0.9
"""Correlation, at the best lag, from which a read-out follows a command."""
_UNRELATED = 0.5
"""Correlation below which it does not."""
_MOVING = 1e-2
"""rad, the standard deviation from which commands and read-outs are compared."""
_LEAST_MOVED = 1e-3
"""rad, the standard deviation of read-outs likewise: those of commands in degrees move little beside these."""
_STUCK = 0.1
"""Of a command's standard deviation: a read-out that moves less while its command moves does not follow."""
_EARLY = 0.05
"""s, or two samples, by which a read-out is ahead of its command at most: it is logged in the next row."""
_LATE = 0.5
"""s, by which it is behind at most."""
_CLOSER = float(np.log(3.0))
"""By which the logarithm of the remaining variance falls at least at the lag of another clock."""
_CERTAIN = 0.97
"""Correlation, and likewise ten times less variance, from which one lag for all rows is that of another clock: a motion
that is repeated follows itself at other lags."""
_MUCH_CLOSER = float(np.log(10.0))
_PIECES = (5.0, 60.0)
"""s, of the parts of a run whose lags are compared: short ones tell a drift, long ones long lags."""
_SAME_LAG = 0.1
"""s, by which lags of parts of one clock differ at most."""
_DIFFERENT = 1e-3
"""s a second, the least drift that is said."""
_USUAL_LAG = 0.02
"""s, by which joints of servos that are not declared are left behind."""
_LAGS = (-0.06, 0.2)
"""s, between which rollouts choose the lag that is left to declared servos, less that of the correlation."""
_LAG_STEP = 0.04
"""s, between rollouts of a first choice; it is halved down to a sample."""
_TRANSMITS = 1.7
"""Ratio of motions from which it is no property of a servo: the least gear is 2 : 1."""
_GEARS = range(2, 11)
"""Ratios of gears that are looked for."""
_NEAR_GEAR = 0.12
"""By which a ratio differs at most from that of its gear: sag under weight changes it."""
_SAME_RATIO = 0.15
"""By which ratios of runs differ at most."""
_LINEAR = 0.2
"""Of the standard deviation of a read-out, what a linear follower leaves at most where its ratio is one of gears."""
_AS_GOOD = 1.3
"""Times what a free ratio leaves, up to which a ratio of one with sag under weight is as good."""
_DECIDED = 1.5
"""Ratio of errors of rollouts from which the side of a fault is decided."""
_WIDEST = 4 * np.pi
"""rad, beyond which joints of an arm without end do not turn."""


class CorrectedColumns(NamedTuple):
    """A recording with corrected columns, and the faults."""

    recording: Recording
    found: list[DataFault]


def correct_columns(recording: Recording, arm: Arm) -> CorrectedColumns:
    """Puts columns right that hold commands of another clock, or of other joints, signs, units or gears.

    Args:
        recording: with commands and times.
        arm: the declared arm.

    Raises:
        InputError: as `even_rows`; joints that do not follow, as where the torque is off.
    """
    require_motion(even_rows(recording))
    found: list[DataFault] = []
    for correct in (_with_clock, _with_order, _with_signs, _with_ratios):
        recording, more = correct(recording, arm)
        found += more
    return CorrectedColumns(recording, found)


def require_motion(even: Recording) -> None:
    """Refuses joints that are commanded to move and do not."""
    command = np.asarray(even.commanded_position)
    asked = np.std(command, 0)
    stuck = (asked > _MOVING) & (np.std(even.joint_position, 0) < _STUCK * asked)
    for joint in np.flatnonzero(stuck).tolist():  # one in another unit follows, by less
        follows = lagged_correlation(command[:, [joint]], even.joint_position[:, [joint]], _period(even))
        stuck[joint] = abs(float(follows[0, 0])) < _FOLLOWS
    if stuck.any():
        columns = ", ".join(f"q{joint + 1}_rad" for joint in np.flatnonzero(stuck))
        raise InputError(
            f"{even.source}: {columns} hardly moves while its command does: its torque may be off, or the column is "
            "another quantity; leave out such rows, or name the columns anew"
        )


def _moving(even: Recording) -> NDArray[np.integer]:
    """The joints, from 0, whose commands and read-outs move."""
    command = np.asarray(even.commanded_position)
    return np.flatnonzero((np.std(command, 0) > _MOVING) & (np.std(even.joint_position, 0) > _LEAST_MOVED))


def _period(even: Recording) -> float:
    """s between samples."""
    assert even.time is not None
    return float(np.median(np.diff(even.time)))


# ------------------------------------------------------------------ clocks


class _Piece(NamedTuple):
    """A part of a run, and how late its read-outs are: at the likeliest lag, and at that which servos may have."""

    middle: float
    run: int
    any: Lag
    usual: Lag


def _with_clock(recording: Recording, arm: Arm) -> CorrectedColumns:
    """The recording with commands at the times of the read-outs, where they are of another clock.

    Joints are behind their commands by half a second at most, and hardly ahead. Where all are not, by one lag or one
    that drifts, commands are of another clock.
    """
    even = even_rows(recording)
    least = -max(_EARLY, 2 * _period(even))
    model = None
    for long in _PIECES:
        model = model or _clock_of(_pieces(even, long, least), least, drifts=long == min(_PIECES))
    if model is None:
        return CorrectedColumns(recording, [])
    drift, constant = model
    lag = _remaining_lag(recording, arm, drift, constant)
    shifted, has = _at_times(recording, drift, constant - lag)
    numbers = {"shift_s": round(constant - lag, 4), "drift_s_per_s": round(drift, 6), "count": int(np.sum(~has))}
    return CorrectedColumns(shifted.select(has), [DataFault("other_clock", (), numbers)])


def _pieces(even: Recording, long: float, least: float) -> list[_Piece]:
    """The parts of runs, of about `long` s; a lag of at least `least` s is one that servos may have."""
    assert even.time is not None
    period = _period(even)
    joints = _moving(even)
    pieces = []
    for first, last in zip(*run_ends(even.run), strict=True):
        count = max(1, round((last - first) * period / long))
        edges = np.linspace(first, last, count + 1).astype(int)
        for begin, end in itertools.pairwise(edges):
            rows = slice(int(begin), int(end))
            if len(joints) and end - begin > 10:
                lags, squares = scan_lags(even, joints, rows)
                usual = (lags >= least - 1e-9) & (lags <= _LATE + 1e-9)
                middle = float(even.time[rows].mean())
                all_lags = np.ones(len(lags), bool)
                pieces.append(
                    _Piece(
                        middle,
                        int(even.run[first]),
                        likeliest_lag(lags, squares, all_lags),
                        likeliest_lag(lags, squares, usual),
                    )
                )
    return pieces


def _clock_of(pieces: list[_Piece], least: float, drifts: bool) -> tuple[float, float] | None:
    """The drift in s a second and the lag in s at time zero of commands of another clock; None where it is the same."""
    follows = [piece for piece in pieces if piece.any.correlation > _FOLLOWS]
    if not follows:
        return None
    closer = np.array([piece.usual.missed - piece.any.missed for piece in follows])
    lags = np.array([piece.any.lag for piece in follows])
    outside = (lags < least) | (lags > _LATE)
    if not outside.any() or closer[outside].mean() < _CLOSER:
        return None
    constant = float(np.median(lags))
    if np.abs(lags - constant).max() <= _SAME_LAG:
        certain = min(piece.any.correlation for piece in follows) > _CERTAIN and closer.mean() > _MUCH_CLOSER
        return (0.0, constant) if certain and not drifts else None
    if not drifts or len(follows) < 3:
        return None
    middles = np.array([piece.middle for piece in follows])
    drift, start = np.polyfit(middles, lags, 1)
    if abs(drift) < _DIFFERENT or np.abs(lags - start - drift * middles).max() > 2 * _SAME_LAG:
        return None
    return float(drift), float(start)


def _remaining_lag(recording: Recording, arm: Arm, drift: float, constant: float) -> float:
    """s, by which joints are left behind: that of the declared servos whose rollout is nearest."""
    if arm.mass is None or not isinstance(recording.settings.servo, ServoSettings):
        return _USUAL_LAG
    period = _period(recording)
    step = _LAG_STEP
    errors: dict[float, float] = {}
    wanted = np.arange(*_LAGS, step)
    best = 0.0
    while len(wanted):
        for lag in wanted.tolist():  # no row is cut: all rollouts have one length
            shifted, has = _at_times(recording, drift, constant - lag)
            errors[lag] = rollout_error(shifted, arm, has)
        best = min(errors, key=lambda lag: errors[lag])
        step = period * round(0.5 * step / period)
        wanted = np.array([best - step, best + step]) if step else np.zeros(0)
    return best


def _at_times(recording: Recording, drift: float, constant: float) -> tuple[Recording, Mask]:
    """The recording with commands that are later by `constant + drift · time` s, and `(sample,)` where there is one."""
    assert recording.time is not None
    time = recording.time
    command = np.asarray(recording.commanded_position)
    period = _period(recording)
    taken = np.zeros(len(time), int)
    has = np.zeros(len(time), bool)
    for first, last in zip(*run_ends(recording.run), strict=True):
        t = time[first:last]
        wanted = t - constant - drift * t
        place = np.searchsorted(t, wanted + 1e-3 * period, side="right") - 1
        has[first:last] = (place >= 0) & (wanted <= t[-1] + 0.5 * period)
        taken[first:last] = first + np.clip(place, 0, last - first - 1)
    return replace(recording, commanded_position=command[taken]), has


# ------------------------------------------------------------------ order and signs


def _correlations(recording: Recording) -> tuple[NDArray[np.integer], Array]:
    """The joints, from 0, that move, and how read-outs of each `(row)` follow commands of each `(column)`."""
    even = even_rows(recording)
    moving = _moving(even)
    command = np.asarray(even.commanded_position)
    return moving, lagged_correlation(command[:, moving], even.joint_position[:, moving], _period(even))


def _with_order(recording: Recording, arm: Arm) -> CorrectedColumns:
    """The recording with columns that are exchanged put in order, in pairs."""
    moving, best = _correlations(recording)
    size = np.abs(best)
    found = []
    for one in range(len(moving)):
        for other in range(one):
            crossed = min(size[one, other], size[other, one])
            straight = max(size[one, one], size[other, other])
            if crossed > _FOLLOWS and straight < _UNRELATED:
                pair = [int(moving[other]), int(moving[one])]
                order = np.arange(recording.dof)
                order[pair] = order[pair[::-1]]
                choices = {
                    "measured": with_readouts(recording, recording.joint_position[:, order]),
                    "commanded": replace(
                        recording, commanded_position=np.asarray(recording.commanded_position)[:, order]
                    ),
                }
                side, recording = _nearer(choices, arm)
                found.append(DataFault("joints_swapped", (), {"joints": [joint + 1 for joint in pair], "side": side}))
    return CorrectedColumns(recording, found)


def _with_signs(recording: Recording, arm: Arm) -> CorrectedColumns:
    """The recording with joints that move against their commands turned round."""
    moving, best = _correlations(recording)
    found = []
    for joint in moving[np.diagonal(best) < -_FOLLOWS].tolist():
        sign = np.where(np.arange(recording.dof) == joint, -1.0, 1.0)
        choices = {
            "measured": with_readouts(recording, recording.joint_position * sign),
            "commanded": replace(recording, commanded_position=np.asarray(recording.commanded_position) * sign),
        }
        side, recording = _nearer(choices, arm)
        found.append(DataFault("joint_sign", (), {"joints": [joint + 1], "side": side}))
    return CorrectedColumns(recording, found)


# ------------------------------------------------------------------ units and gears


class _Ratio(NamedTuple):
    """How many times as far as its command a joint moves, and what it is."""

    code: str
    ratio: float


def _with_ratios(recording: Recording, arm: Arm) -> CorrectedColumns:
    """The recording with joints in radians after one gear, where they move much further than commanded, or less."""
    even = even_rows(recording)
    settings = even.settings
    gravity = np.array(settings.gravity_m_per_s2)
    bodies = Bodies.of_arm(arm, float(np.median(even.payload)), np.array(settings.payload_com_m), gravity)
    groups: dict[tuple[_Ratio, str], list[int]] = {}
    decisions: dict[tuple[_Ratio, str], bool] = {}
    for joint in _moving(even).tolist():
        ratio = _ratio_of(even, bodies, joint)
        if ratio is None:
            continue
        factor = np.where(np.arange(even.dof) == joint, ratio.ratio, 1.0)
        choices = {
            "measured": with_readouts(recording, recording.joint_position / factor),
            "commanded": replace(recording, commanded_position=np.asarray(recording.commanded_position) * factor),
        }
        side = _plausible_side(choices, arm, joint)
        decided = True
        if side is None:
            side, decided = _relative_side(choices, arm, joint)
        recording = choices[side]
        groups.setdefault((ratio, side), []).append(joint + 1)
        decisions[ratio, side] = decided
    found = []
    for (ratio, side), joints in groups.items():
        numbers = {"joints": joints, "side": side, "decided": decisions[ratio, side]}
        if ratio.code == "gear":
            numbers |= {"ratio": ratio.ratio}
        found.append(DataFault(ratio.code, (), numbers))
    return CorrectedColumns(recording, found)


def _ratio_of(even: Recording, bodies: Bodies, joint: int) -> _Ratio | None:
    """What makes a joint, from 0, move further than its command or less; None where nothing in the file does.

    A soft servo moves less than commanded as well, by its sag: where that explains it nearly as well, nothing is said.
    """
    period = _period(even)
    command = np.asarray(even.commanded_position)[:, joint]
    measured = even.joint_position[:, joint]
    past = past_commands(command, even.run, period)
    ratios = []
    for run in np.unique(even.run):
        rows = even.run == run
        if np.std(command[rows]) < _MOVING:
            continue
        follower = fit_follower(past, measured, None, rows)
        if np.std(follower.remaining[rows]) > _LINEAR * np.std(measured[rows]):
            return None
        ratios.append(follower.gain)
    if not ratios:
        return None
    ratio = float(np.median(ratios))
    same = np.abs(np.array(ratios) / ratio - 1).max() < _SAME_RATIO
    if not same or 1 / _TRANSMITS < ratio < _TRANSMITS:
        return None
    degrees = float(np.rad2deg(1.0))
    for factor in (degrees, 1 / degrees):
        if 1 / _TRANSMITS < ratio / factor < _TRANSMITS:
            return _Ratio("degrees", factor)
    gear = max(ratio, 1 / ratio)
    if round(gear) not in _GEARS or abs(gear / round(gear) - 1) > _NEAR_GEAR:
        return None
    if ratio < 1 and bodies.links.any():
        weight = weight_features(even, bodies, joint, np.asarray(even.commanded_position))
        free = np.std(fit_follower(past, measured).remaining)
        if np.std(fit_follower(past, measured, weight, gain=1.0).remaining) < _AS_GOOD * free:
            return None
    return _Ratio("gear", float(round(gear)) if ratio > 1 else 1 / round(gear))


def _plausible_side(choices: dict[str, Recording], arm: Arm, joint: int) -> str | None:
    """The side after whose correction alone commands and read-outs of a joint, from 0, are angles that it can have."""
    limits = np.asarray(arm.joint_limits)[joint]
    widest = _WIDEST if joint in arm.endless else float(np.abs(limits).max()) + 0.5 * float(np.ptp(limits))
    plausible = []
    for side, choice in choices.items():
        command = np.asarray(choice.commanded_position)[:, joint]
        if max(np.abs(command).max(), np.abs(choice.joint_position[:, joint]).max()) <= widest:
            plausible.append(side)
    return plausible[0] if len(plausible) == 1 else None


def _relative_side(choices: dict[str, Recording], arm: Arm, joint: int) -> tuple[str, bool]:
    """The side after whose correction a rollout is nearer, as a share of the motion, and whether that decides."""
    if arm.mass is None:
        return "measured", False
    errors = {
        side: rollout_error(choice, arm) / float(np.std(choice.joint_position[:, joint]))
        for side, choice in choices.items()
    }
    side = min(errors, key=lambda name: errors[name])
    decided = max(errors.values()) > _DECIDED * errors[side]
    return (side if decided else "measured"), bool(decided)


# ------------------------------------------------------------------ what corrections share


def with_readouts(recording: Recording, position: Array) -> Recording:
    """The recording with other read-outs `(sample, joint)` rad; velocities are differentiated anew."""
    return Recording.assembled(
        joint_position=position,
        time=recording.time,
        commanded_position=recording.commanded_position,
        payload=recording.payload,
        run=recording.run,
        row=recording.row,
        settings=recording.settings,
        source=recording.source,
        notes=recording.notes,
        sliding=recording.sliding,
    )


def _nearer(choices: dict[str, Recording], arm: Arm) -> tuple[str, Recording]:
    """The side that was corrected, and the recording, whose rollout is nearest to its read-outs."""
    sides = list(choices)
    if arm.mass is None:
        return sides[0], choices[sides[0]]
    errors = [rollout_error(choice, arm) for choice in choices.values()]
    side = sides[int(np.argmin(errors))]
    return side, choices[side]


def rollout_error(recording: Recording, arm: Arm, rows: Mask | None = None) -> float:
    """rad RMS of the rollout of the servos as declared, in all rows or in some; infinite of what is no recording."""
    try:
        problem = tracking_problem(tracking_rows(recording, arm))
    except InputError:
        return np.inf
    errors = problem.residual(np.zeros(len(problem.unknowns)), Terms(), np.zeros(0)) * problem.sigma
    if rows is not None and len(rows) == errors.shape[1]:
        errors = errors[:, rows]
    return float(np.sqrt(np.mean(errors**2)))
