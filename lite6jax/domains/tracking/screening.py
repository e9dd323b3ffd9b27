"""Data faults of logs of commands and measured joints: what cannot be diagnosed, and what is located and corrected."""

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.domains.faults import Screened
from lite6jax.domains.torque.rows import require_joints
from lite6jax.domains.tracking.column_faults import correct_columns
from lite6jax.domains.tracking.row_faults import (
    ScreenedTracking,
    drop_moving_starts,
    drop_rows_without_torque,
    drop_saturated_rows,
    drop_stale_rows,
    require_torque,
    with_one_zero,
)
from lite6jax.domains.tracking.rows import MOVING, SAME, tracking_rows, with_known_masses
from lite6jax.domains.tracking.stamps import read_stamps
from lite6jax.errors import InputError
from lite6jax.recordings import Recording

_SHIFTED = 5
"""Rows by which commands are compared with read-outs: logs of learned policies hold the next read-out as a command."""
_CODES = (
    *("other_clock", "joints_swapped", "joint_sign", "degrees", "gear"),
    *("stale_rows", "saturated_readout", "torque_off", "zero_per_run"),
)
"""Of the faults, in the order in which they are looked for."""


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
    arm = with_known_masses(recording, arm)
    columns = Screened(recording)
    if recording.commanded_position is not None and recording.time is not None:
        _require_other_readouts(recording)
        columns = correct_columns(recording, arm)
    data = tracking_rows(columns.data, arm)
    require_torque(data)
    found = (*read_stamps(recording).faults(), *columns.found)
    state = ScreenedTracking(data, found, unusable=np.zeros(data.commands.samples, bool))
    screens = (drop_stale_rows, drop_saturated_rows, drop_rows_without_torque, drop_moving_starts, with_one_zero)
    for screen in screens:
        state = screen(state)
    several_runs = len(np.unique(data.recording.run)) > 1
    return state.rule_out(*(code for code in _CODES if several_runs or code != "zero_per_run"))


def _require_other_readouts(recording: Recording) -> None:
    """Refuses commands that are the read-outs of another row, to all digits."""
    command = np.asarray(recording.commanded_position)
    measured = recording.joint_position
    for shift in range(1, min(_SHIFTED, len(command) - 1) + 1):
        pairs = {"before": (command[shift:], measured[:-shift]), "after": (command[:-shift], measured[shift:])}
        for side, (u, y) in pairs.items():
            moves = np.ptp(y, 0) > MOVING
            if moves.any() and np.max(np.abs(u - y)[:, moves]) < SAME:
                raise InputError(
                    f"{recording.source}: each command is the read-out of {shift} rows {side}: the log holds "
                    "measurements twice; record what the controller was sent as cmd1_rad ..."
                )
