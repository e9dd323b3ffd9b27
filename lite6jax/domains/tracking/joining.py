"""The commands of one file beside the measured joints of another: each command is held until the next.

Both files must be stamped by one clock.
"""

from typing import NamedTuple

import numpy as np

from lite6jax.array_types import Array
from lite6jax.errors import InputError
from lite6jax.recordings.columns.inspection import InspectedTable
from lite6jax.recordings.columns.names import says_commanded
from lite6jax.recordings.streams import Held, hold, in_order, said_of_commands


class JoinedCommands(NamedTuple):
    """A table of measured joints with the commands in force.

    Attributes:
        columns: of the measured joints, `time_s`, and the commands by their names or after `commanded`.
        commands: how many were sent.
        dropped: sentences on joint states without a command.
    """

    columns: dict[str, Array]
    commands: int
    dropped: list[str]


def join_commands(states: InspectedTable, commands: InspectedTable) -> JoinedCommands:
    """The rows of the measured joints with the commands in force.

    Raises:
        InputError: a file without times, another number of joints, or times that do not overlap.
    """
    sent = commands.list_columns("q")
    measured = states.list_columns("q")
    if len(sent) != len(measured):
        raise InputError(
            f"{commands.source}: has {len(sent)} joints and {states.source} {len(measured)}; leave out what is no "
            "joint by --column NAME=ignore"
        )
    clocks = [_times(file) for file in (commands, states)]
    numbered = [file.in_si("run") for file in (commands, states)]
    runs = [run[:, 0] for run in numbered if run is not None]
    if len(runs) < len(clocks):
        runs = [np.zeros(len(clock)) for clock in clocks]
    values = np.stack([commands.columns[name] for name in sent], 1)
    complete = np.isfinite(values).all(1)
    joined = np.full((len(clocks[1]), len(sent)), np.nan)
    used = np.zeros(len(clocks[1]), bool)
    early = 0
    late = 0
    for run in np.unique(runs[1][np.isfinite(runs[1])]):
        of_run = in_order(clocks[0], complete & (runs[0] == run))
        rows = np.flatnonzero((runs[1] == run) & np.isfinite(clocks[1]))
        if not len(of_run):
            early += len(rows)
            continue
        held = hold(clocks[0][of_run], clocks[1][rows])
        early += held.early
        late += held.late
        joined[rows[held.usable]] = values[of_run[held.sent]]
        used[rows[held.usable]] = True
    if not used.any():
        shown = [f"{np.nanmin(clock):.3f} to {np.nanmax(clock):.3f} s" for clock in clocks]
        raise InputError(
            f"{commands.source} and {states.source}: no joint state lies between commands (commands {shown[0]}, joints "
            f"{shown[1]}); stamp both by one clock"
        )
    times = states.list_columns("time")
    columns = {name: column[used] for name, column in states.columns.items() if name not in times}
    names = [_command_name(name, columns) for name in sent]
    columns = {"time_s": clocks[1][used], **columns, **dict(zip(names, joined[used].T, strict=True))}
    dropped = said_of_commands(Held(used, np.empty(0, int), early, late))
    return JoinedCommands(columns, int(np.sum(complete)), dropped)


def _times(file: InspectedTable) -> Array:
    """`(row,)` s.

    Raises:
        InputError: no column looks like times.
    """
    times = file.in_si("time")
    if times is None:
        raise InputError(
            f"{file.source}: has no times, by which commands and joints are joined; say which column they are, "
            "--column NAME=time_s"
        )
    return times[:, 0]


def _command_name(name: str, columns: dict[str, Array]) -> str:
    """A name that says that a column is commanded, and that none of the columns has."""
    if says_commanded(name) and name not in columns:
        return name
    return f"commanded.{name}"
