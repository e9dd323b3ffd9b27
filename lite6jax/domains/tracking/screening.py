"""Data faults of logs of commands and measured joints: what cannot be diagnosed, and what is located and corrected."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.domains.torque.rows import require_joints
from lite6jax.domains.tracking.column_faults import correct_columns
from lite6jax.domains.tracking.row_faults import (
    drop_rows_without_torque,
    drop_saturated_rows,
    require_torque,
    stale_rows,
    with_one_zero,
)
from lite6jax.domains.tracking.rows import TrackingRows, tracking_rows
from lite6jax.errors import InputError
from lite6jax.estimation.problem import Mask
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault, row_numbers

Array = NDArray[np.floating]

_SAME = 1e-6
"""rad, by which commands and read-outs differ at most where they are one."""
_SHIFTED = 5
"""Rows by which commands are compared with read-outs: logs of learned policies hold the next read-out as a command."""
_MOVING = 1e-2
"""rad, the range from which commands and read-outs are compared."""
_CODES = (
    *("other_clock", "joints_swapped", "joint_sign", "degrees", "gear"),
    *("stale_rows", "saturated_readout", "torque_off", "zero_per_run"),
)
"""Of the faults, in the order in which they are looked for."""


class ScreenedTracking(NamedTuple):
    """A recording as it is diagnosed.

    Attributes:
        data: on an even grid, with corrected columns.
        unusable: `(sample,)` bool of the grid, rows that are left out.
        found: data faults.
        ruled_out: faults that were tested for and are not there.
    """

    data: TrackingRows
    unusable: Mask
    found: tuple[DataFault, ...]
    ruled_out: tuple[DataFault, ...]


def screen_tracking(recording: Recording, arm: Arm) -> ScreenedTracking:
    """Refuses what cannot be diagnosed, corrects columns, and leaves rows out that show no servo.

    Args:
        recording: with commands.
        arm: the declared arm.

    Raises:
        InputError: as `tracking_rows`; commands that are the read-outs of rows before or after; or joints that do not
            follow, as where the torque is off.
    """
    require_joints(recording, arm)
    found: list[DataFault] = []
    tested = set(_CODES)
    if recording.commanded_position is not None and recording.time is not None:
        _require_other_readouts(recording)
        recording, found = correct_columns(recording, arm)
    data = tracking_rows(recording, arm)
    require_torque(data)
    unusable = stale_rows(data)
    if unusable.any():
        rows = row_numbers(data.recording.row[unusable])
        found.append(DataFault("stale_rows", rows, {"count": int(unusable.sum())}))
    for drop in (drop_saturated_rows, drop_rows_without_torque):
        unusable, more = drop(data, unusable)
        found += more
    if len(np.unique(data.recording.run)) > 1:
        data, more = with_one_zero(data, unusable)
        found += more
    else:
        tested.discard("zero_per_run")
    codes = {fault.code for fault in found}
    ruled_out = tuple(DataFault(code) for code in _CODES if code in tested - codes)
    return ScreenedTracking(data, unusable, tuple(found), ruled_out)


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
