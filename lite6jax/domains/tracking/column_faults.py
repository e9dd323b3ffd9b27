"""Faults of whole columns of logs of commands: another clock, exchanged joints, reversed signs, other units and gears.

Commands and read-outs alike may be the wrong ones. The arm as it is declared tells: its weight pulls one way. Of both
corrections the one is taken whose rollout is nearer to the read-outs; without masses it is that of the read-outs.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.faults import Screened, SuspectedFault
from lite6jax.domains.tracking.coupling import Bodies
from lite6jax.domains.tracking.following import (
    AHEAD,
    Lag,
    fit_follower,
    followed,
    likeliest_lag,
    past_commands,
    scan_lags,
    weight_features,
)
from lite6jax.domains.tracking.problem import tracking_problem
from lite6jax.domains.tracking.ranges import run_ends
from lite6jax.domains.tracking.rows import (
    FOLLOWS,
    LATEST,
    LEAST_GEAR,
    MOVING,
    UNRELATED,
    even_rows,
    lagged_correlation,
    period_of,
    tracking_rows,
)
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault
from lite6jax.recordings.settings import ServoSettings

_LEAST_MOVED = 1e-3
"""rad, the standard deviation of read-outs likewise: those of commands in degrees move little beside these."""
_STUCK = 0.1
"""Of a command's standard deviation: a read-out that moves less while its command moves does not follow."""
_EARLY = 0.05
"""s, or two samples, by which a read-out is ahead of its command at most: it is logged in the next row."""
_CERTAIN = 0.97
"""Correlation of read-outs with followers of late commands, from which their lag is that of another clock."""
_MUCH_CLOSER = float(np.log(10.0))
"""By which the logarithm of the variance that followers leave falls at least at that lag."""
_PIECES = (5.0, 60.0)
"""s, of the parts of a run whose lags are compared: short ones tell a drift, long ones long lags."""
_SHORTEST = 2.0
"""s of such a part at least: a follower has commands of half a second, and lags reach to half of the part."""
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


def correct_columns(recording: Recording, arm: Arm) -> Screened[Recording]:
    """Puts columns right that hold commands of another clock, or of other joints, signs, units or gears.

    Args:
        recording: with commands and times.
        arm: the declared arm.

    Raises:
        InputError: as `even_rows`; joints that do not follow, as where the torque is off.
    """
    require_motion(even_rows(recording))
    screened = _with_clock(Screened(recording), arm)
    for suspected in (_exchanged, _reversed, _rescaled):
        screened = _with_columns(screened, suspected(screened.data, arm), arm)
    return screened


def require_motion(even: Recording) -> None:
    """Refuses joints that are commanded to move and do not."""
    command = np.asarray(even.commanded_position)
    asked = np.std(command, 0)
    stuck = (asked > MOVING) & (np.std(even.joint_position, 0) < _STUCK * asked)
    for joint in np.flatnonzero(stuck).tolist():  # one in another unit follows, by less
        follows = lagged_correlation(command[:, [joint]], even.joint_position[:, [joint]], period_of(even))
        stuck[joint] = abs(float(follows[0, 0])) < FOLLOWS
    if stuck.any():
        columns = ", ".join(f"q{joint + 1}_rad" for joint in np.flatnonzero(stuck))
        raise InputError(
            f"{even.source}: {columns} hardly moves while its command does: its torque may be off, or the column is "
            "another quantity; leave out such rows, or name the columns anew"
        )


def _moving(even: Recording) -> Integers:
    """The joints, from 0, whose commands and read-outs move."""
    command = np.asarray(even.commanded_position)
    return np.flatnonzero((np.std(command, 0) > MOVING) & (np.std(even.joint_position, 0) > _LEAST_MOVED))


# ------------------------------------------------------------------ clocks


class _Piece(NamedTuple):
    """A part of a run, and how late its read-outs are: at the likeliest lag, and at that which servos may have."""

    middle: float
    run: int
    any: Lag
    usual: Lag


def _with_clock(screened: Screened[Recording], arm: Arm) -> Screened[Recording]:
    """The recording with commands at the times of the read-outs, where they are of another clock.

    Joints are behind their commands by half a second at most, and hardly ahead. Where all are not, by one lag or one
    that drifts, commands are of another clock.
    """
    recording = screened.data
    even = even_rows(recording)
    least = -max(_EARLY, 2 * period_of(even))
    model = None
    for long in _PIECES:
        model = model or _clock_of(_pieces(even, long, least), least, drifts=long == min(_PIECES))
    if model is None:
        return screened
    drift, constant = model
    lag = _remaining_lag(recording, arm, drift, constant)
    shifted, has = _at_times(recording, drift, constant - lag)
    numbers = {"shift_s": round(constant - lag, 4), "drift_s_per_s": round(drift, 6), "count": int(np.sum(~has))}
    return screened.with_faults([DataFault("other_clock", (), numbers)], shifted.select(has))


def _pieces(even: Recording, long: float, least: float) -> list[_Piece]:
    """The parts of runs, of about `long` s; a lag of at least `least` s is one that servos may have."""
    assert even.time is not None
    period = period_of(even)
    joints = _moving(even)
    pieces = []
    for first, last in zip(*run_ends(even.run), strict=True):
        count = max(1, round((last - first) * period / long))
        edges = np.linspace(first, last, count + 1).astype(int)
        for begin, end in itertools.pairwise(edges):
            rows = slice(int(begin), int(end))
            if not len(joints) or (end - begin) * period < _SHORTEST:
                continue
            lags, squares = scan_lags(even, joints, rows)
            usual = (lags >= least - 1e-9) & (lags <= LATEST + 1e-9)
            middle = float(even.time[rows].mean())
            any_lag, usual_lag = (likeliest_lag(lags, squares, within) for within in (np.full(len(lags), True), usual))
            of_any = followed(even, joints, rows, any_lag, any_lag - AHEAD)
            of_usual = followed(even, joints, rows, usual_lag, min(max(usual_lag - AHEAD, least), 0.0))
            pieces.append(_Piece(middle, int(even.run[first]), of_any, of_usual))
    return pieces


def _clock_of(pieces: list[_Piece], least: float, drifts: bool) -> tuple[float, float] | None:
    """The drift in s a second and the lag in s at time zero of commands of another clock; None where it is the same."""
    follows = [piece for piece in pieces if piece.any.correlation > FOLLOWS]
    if not follows:
        return None
    closer = np.array([piece.usual.missed - piece.any.missed for piece in follows])
    lags = np.array([piece.any.lag for piece in follows])
    outside = (lags < least) | (lags > LATEST)
    if not outside.any() or closer[outside].mean() < _MUCH_CLOSER:
        return None
    if min(piece.any.correlation for piece in follows) < _CERTAIN:
        return None
    constant = float(np.median(lags))
    if np.abs(lags - constant).max() <= _SAME_LAG:
        return None if drifts else (0.0, constant)
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
    period = period_of(recording)
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
    period = period_of(recording)
    taken = np.zeros(len(time), int)
    has = np.zeros(len(time), bool)
    for first, last in zip(*run_ends(recording.run), strict=True):
        t = time[first:last]
        wanted = t - constant - drift * t
        place = np.searchsorted(t, wanted + 1e-3 * period, side="right") - 1
        has[first:last] = (place >= 0) & (wanted <= t[-1] + 0.5 * period)
        taken[first:last] = first + np.clip(place, 0, last - first - 1)
    return replace(recording, commanded_position=command[taken]), has


# ------------------------------------------------------------------ order, signs, units and gears


def _correlations(recording: Recording) -> tuple[Integers, Array]:
    """The joints, from 0, that move, and how read-outs of each `(row)` follow commands of each `(column)`."""
    even = even_rows(recording)
    moving = _moving(even)
    command = np.asarray(even.commanded_position)
    return moving, lagged_correlation(command[:, moving], even.joint_position[:, moving], period_of(even))


def _exchanged(recording: Recording, arm: Arm) -> list[SuspectedFault]:
    """Pairs of joints that follow the command of each other."""
    moving, best = _correlations(recording)
    size = np.abs(best)
    return [
        SuspectedFault("joints_swapped", (int(moving[j]), int(moving[i])))
        for i in range(len(moving))
        for j in range(i)
        if min(size[i, j], size[j, i]) > FOLLOWS and max(size[i, i], size[j, j]) < UNRELATED
    ]


def _reversed(recording: Recording, arm: Arm) -> list[SuspectedFault]:
    """Joints that move against their commands."""
    moving, best = _correlations(recording)
    return [SuspectedFault("joint_sign", (joint,)) for joint in moving[np.diagonal(best) < -FOLLOWS].tolist()]


def _rescaled(recording: Recording, arm: Arm) -> list[SuspectedFault]:
    """Joints that move much further than commanded, or less."""
    even = even_rows(recording)
    settings = even.settings
    gravity = np.array(settings.gravity_m_per_s2)
    bodies = Bodies.of_arm(arm, float(np.median(even.payload)), np.array(settings.payload_com_m), gravity)
    suspected = (_ratio_of(even, bodies, joint) for joint in _moving(even).tolist())
    return [fault for fault in suspected if fault is not None]


def _with_columns(screened: Screened[Recording], suspected: Sequence[SuspectedFault], arm: Arm) -> Screened[Recording]:
    """The recording with the columns of one side put right, of each fault; joints of one ratio are one fault."""
    recording = screened.data
    faults: dict[tuple[Any, ...], DataFault] = {}
    for fault in suspected:
        A, _ = fault.of_positions(recording.dof)
        command = np.asarray(recording.commanded_position)
        choices = {
            "measured": with_readouts(recording, recording.joint_position @ A.T),
            "commanded": replace(recording, commanded_position=command @ np.linalg.inv(A).T),
        }
        side, decided = _wrong_side(choices, arm, fault)
        recording = choices[side]
        numbers: dict[str, Any] = {"joints": [joint + 1 for joint in fault.joints], "side": side}
        key = (fault.code, *fault.joints)
        if fault.kind.operation == "divide":
            key = (fault.code, side, fault.value)
            numbers["decided"] = decided
        if fault.kind.number:
            numbers[fault.kind.number] = fault.value
        if key in faults:
            numbers["joints"] = [*faults[key].numbers["joints"], *numbers["joints"]]
        faults[key] = DataFault(fault.code, (), numbers)
    return screened.with_faults(faults.values(), recording)


def _ratio_of(even: Recording, bodies: Bodies, joint: int) -> SuspectedFault | None:
    """What makes a joint, from 0, move further than its command or less; None where nothing in the file does.

    A soft servo moves less than commanded as well, by its sag: where that explains it nearly as well, nothing is said.
    """
    period = period_of(even)
    command = np.asarray(even.commanded_position)[:, joint]
    measured = even.joint_position[:, joint]
    past = past_commands(command, even.run, period)
    ratios = []
    for run in np.unique(even.run):
        rows = even.run == run
        if np.std(command[rows]) < MOVING:
            continue
        follower = fit_follower(past, measured, None, rows)
        if np.std(follower.remaining[rows]) > _LINEAR * np.std(measured[rows]):
            return None
        ratios.append(follower.gain)
    if not ratios:
        return None
    ratio = float(np.median(ratios))
    same = np.abs(np.array(ratios) / ratio - 1).max() < _SAME_RATIO
    if not same or 1 / LEAST_GEAR < ratio < LEAST_GEAR:
        return None
    degrees = float(np.rad2deg(1.0))
    for factor in (degrees, 1 / degrees):
        if 1 / LEAST_GEAR < ratio / factor < LEAST_GEAR:
            return SuspectedFault("degrees", (joint,), factor)
    gear = max(ratio, 1 / ratio)
    if round(gear) not in _GEARS or abs(gear / round(gear) - 1) > _NEAR_GEAR:
        return None
    if ratio < 1 and bodies.links.any():
        weight = weight_features(even, bodies, joint, np.asarray(even.commanded_position))
        free = np.std(fit_follower(past, measured).remaining)
        if np.std(fit_follower(past, measured, weight, gain=1.0).remaining) < _AS_GOOD * free:
            return None
    return SuspectedFault("gear", (joint,), float(round(gear)) if ratio > 1 else 1 / round(gear))


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


def _wrong_side(choices: dict[str, Recording], arm: Arm, fault: SuspectedFault) -> tuple[str, bool]:
    """The side after whose correction a rollout is nearer to the read-outs, and whether that decides.

    A ratio changes how far a joint moves: errors are shares of that, and have to differ clearly.
    """
    least_ratio = 1.0
    size = dict.fromkeys(choices, 1.0)
    if fault.kind.operation == "divide":
        plausible = _plausible_side(choices, arm, fault.joints[0])
        if plausible is not None:
            return plausible, True
        least_ratio = _DECIDED
        size = {side: float(np.std(choice.joint_position[:, fault.joints[0]])) for side, choice in choices.items()}
    if arm.mass is None:
        return "measured", False
    errors = {side: rollout_error(choice, arm) / size[side] for side, choice in choices.items()}
    nearest = min(errors, key=lambda side: errors[side])
    decided = bool(max(errors.values()) > least_ratio * errors[nearest])
    return (nearest if decided else "measured"), decided


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
