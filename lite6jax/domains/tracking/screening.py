"""Data faults of logs of commands and measured joints: what cannot be diagnosed, and what is located and corrected.

Where columns are exchanged, or one has its sign reversed, commands and read-outs alike may be the wrong ones. The arm
as it is declared tells: its weight pulls one way. Of both corrections the one is taken whose rollout is nearer to the
read-outs; without masses it is that of the read-outs.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.domains.torque.rows import require_joints
from lite6jax.domains.tracking.problem import tracking_problem
from lite6jax.domains.tracking.rows import TrackingRows, even_rows, lagged_correlation, quantum, tracking_rows
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault, row_numbers

Array = NDArray[np.floating]

_SAME = 1e-6
"""rad, by which commands and read-outs differ at most where they are one."""
_SHIFTED = 5
"""Rows by which commands are compared with read-outs: logs of learned policies hold the next read-out as a command."""
_FOLLOWS = 0.9
"""Correlation, at the best lag, from which a read-out follows a command."""
_UNRELATED = 0.5
"""Correlation below which it does not."""
_MOVING = 1e-2
"""rad, the standard deviation from which commands and read-outs are compared."""
_STALE_STEPS = 4.0
"""Quanta, or standard deviations of the noise, that an arm moves beyond a row that repeats the one before it."""
_ROUNDING = 1e-9
"""rad, by which numbers of a file differ at most that are the same to all digits."""
_STUCK = 0.1
"""Of a command's standard deviation: a read-out that moves less while its command moves does not follow."""
_MOST_STALE = 0.5
"""Share of rows that repeat the one before, above which nothing else would be left."""


class ScreenedTracking(NamedTuple):
    """A recording as it is diagnosed.

    Attributes:
        data: on an even grid, with corrected columns.
        stale: `(sample,)` bool of the grid, rows whose read-outs are those of the row before.
        found: data faults.
        ruled_out: faults that were tested for and are not there.
    """

    data: TrackingRows
    stale: NDArray[np.bool_]
    found: tuple[DataFault, ...]
    ruled_out: tuple[DataFault, ...]


def screen_tracking(recording: Recording, arm: Arm) -> ScreenedTracking:
    """Refuses what cannot be diagnosed, and corrects columns that are exchanged or have a reversed sign.

    Args:
        recording: with commands.
        arm: the declared arm.

    Raises:
        InputError: as `tracking_rows`; commands that are the read-outs of rows before or after; or joints that do not
            follow, as where the torque is off.
    """
    require_joints(recording, arm)
    found: list[DataFault] = []
    ruled_out: list[DataFault] = []
    if recording.commanded_position is not None and recording.time is not None:
        _require_other_readouts(recording)
        recording, corrected = _with_order(recording, arm)
        found += corrected
        recording, corrected = _with_signs(recording, arm)
        found += corrected
        known = {fault.code for fault in found}
        ruled_out += [DataFault(code) for code in ("joints_swapped", "joint_sign") if code not in known]
    data = tracking_rows(recording, arm)
    stale = _stale_rows(data)
    if stale.any():
        rows = row_numbers(data.recording.row[stale])
        found.append(DataFault("stale_rows", rows, {"count": int(stale.sum())}))
    else:
        ruled_out.append(DataFault("stale_rows"))
    return ScreenedTracking(data, stale, tuple(found), tuple(ruled_out))


def _require_other_readouts(recording: Recording) -> None:
    """Refuses commands that are the read-outs of another row, to all digits."""
    command = np.asarray(recording.commanded_position)
    measured = recording.joint_position
    for shift in range(1, min(_SHIFTED, len(command) - 1) + 1):
        pairs = {"before": (command[shift:], measured[:-shift]), "after": (command[:-shift], measured[shift:])}
        for side, (u, y) in pairs.items():
            moves = np.ptp(y, 0) > _MOVING
            if moves.any() and np.max(np.abs(u - y)[:, moves]) < _SAME:
                raise InputError(
                    f"{recording.source}: each command is the read-out of {shift} rows {side}: the log holds "
                    "measurements twice; record what the controller was sent as cmd1_rad ..."
                )


def _correlations(recording: Recording) -> tuple[NDArray[np.integer], Array]:
    """The joints, from 0, that move, and how read-outs of each `(row)` follow commands of each `(column)`."""
    even = even_rows(recording)
    command = np.asarray(even.commanded_position)
    measured = even.joint_position
    moving = np.flatnonzero((np.std(command, 0) > _MOVING) & (np.std(measured, 0) > _MOVING))
    _require_motion(even, command, measured)
    assert even.time is not None
    period = float(np.median(np.diff(even.time)))
    return moving, lagged_correlation(command[:, moving], measured[:, moving], period)


def _require_motion(even: Recording, command: Array, measured: Array) -> None:
    """Refuses joints that are commanded to move and do not."""
    asked = np.std(command, 0)
    stuck = (asked > _MOVING) & (np.std(measured, 0) < _STUCK * asked)
    if stuck.any():
        columns = ", ".join(f"q{joint + 1}_rad" for joint in np.flatnonzero(stuck))
        raise InputError(
            f"{even.source}: {columns} hardly moves while its command does: its torque may be off, or the column is "
            "another quantity; leave out such rows, or name the columns anew"
        )


def _with_order(recording: Recording, arm: Arm) -> tuple[Recording, list[DataFault]]:
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
                    "measured": _with_readouts(recording, recording.joint_position[:, order]),
                    "commanded": replace(
                        recording, commanded_position=np.asarray(recording.commanded_position)[:, order]
                    ),
                }
                side, recording = _nearer(choices, arm)
                found.append(DataFault("joints_swapped", (), {"joints": [joint + 1 for joint in pair], "side": side}))
    return recording, found


def _with_signs(recording: Recording, arm: Arm) -> tuple[Recording, list[DataFault]]:
    """The recording with joints that move against their commands turned round."""
    moving, best = _correlations(recording)
    found = []
    for joint in moving[np.diagonal(best) < -_FOLLOWS].tolist():
        sign = np.where(np.arange(recording.dof) == joint, -1.0, 1.0)
        choices = {
            "measured": _with_readouts(recording, recording.joint_position * sign),
            "commanded": replace(recording, commanded_position=np.asarray(recording.commanded_position) * sign),
        }
        side, recording = _nearer(choices, arm)
        found.append(DataFault("joint_sign", (), {"joints": [joint + 1], "side": side}))
    return recording, found


def _with_readouts(recording: Recording, position: Array) -> Recording:
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
    errors = [_rollout_error(choice, arm) for choice in choices.values()]
    side = sides[int(np.argmin(errors))]
    return side, choices[side]


def _rollout_error(recording: Recording, arm: Arm) -> float:
    """rad RMS of the rollout of the servos as declared; infinite of what is no recording."""
    try:
        problem = tracking_problem(tracking_rows(recording, arm))
    except InputError:
        return np.inf
    rows = problem.residual(np.zeros(len(problem.unknowns)), Terms(), np.zeros(0)) * problem.sigma
    return float(np.sqrt(np.mean(rows**2)))


def _stale_rows(data: TrackingRows) -> NDArray[np.bool_]:
    """`(sample,)`, rows whose read-outs repeat those of the row before, to all digits, while the arm moves."""
    q = data.recording.joint_position
    run = data.recording.run
    same_run = np.diff(run) == 0
    repeated = np.r_[False, (np.abs(np.diff(q, axis=0)).max(1) < _ROUNDING) & same_run]
    if not repeated.any():
        return repeated
    quanta = np.array([quantum(column) for column in q.T])
    size = np.maximum(np.maximum(quanta, data.noise), _SAME)
    later = np.minimum(np.arange(len(q)) + 1, len(q) - 1)
    moved = np.max(np.abs(q[later] - q) / size, 1)
    stale = repeated & (moved > _STALE_STEPS)
    # rows before the jump repeat as well, back to the last one that was fresh
    for row in range(len(q) - 2, 0, -1):
        if stale[row + 1] and repeated[row]:
            stale[row] = True
    if np.mean(stale) > _MOST_STALE:
        return np.zeros(len(q), bool)
    return stale
