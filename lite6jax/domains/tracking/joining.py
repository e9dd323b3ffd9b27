"""The commands of one file beside the measured joints of another: each command is held until the next.

Both files must be stamped by one clock. The file with the commands is found by the names of its columns, else by its
own name, else by a text column that says so in all rows.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.joining import File
from lite6jax.errors import InputError
from lite6jax.recordings import naming
from lite6jax.recordings.naming import Block
from lite6jax.recordings.streams import Held, hold, in_order, said_of_commands

Array = NDArray[np.floating]

_SENDS = frozenset(("control", "controls", "ctrl", "commanding"))
"""Words by which files of commands are called beside those of columns."""


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


def find_commands(files: Sequence[File]) -> int | None:
    """Which of two files with joint positions has the commands; None where nothing says it of one alone."""
    for says in (_by_columns, _by_name, _by_cells):
        commanded = [says(file) for file in files]
        if sum(commanded) == 1:
            return commanded.index(True)
    return None


def join_commands(states: File, commands: File) -> JoinedCommands:
    """The rows of the measured joints with the commands in force.

    Raises:
        InputError: a file without times, another number of joints, or times that do not overlap.
    """
    sent = _joints(commands)
    measured = _joints(states)
    if len(sent) != len(measured):
        raise InputError(
            f"{commands.source}: has {len(sent)} joints and {states.source} {len(measured)}; leave out what is no "
            "joint by --column NAME=ignore"
        )
    clocks = [_times(file) for file in (commands, states)]
    runs = [_runs(file) for file in (commands, states)]
    if None in [file.found.of("run") for file in (commands, states)]:
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
    time_column = states.found.of("time")
    assert time_column is not None
    columns = {name: column[used] for name, column in states.columns.items() if name not in time_column.columns}
    names = [_command_name(name, columns) for name in sent]
    columns = {"time_s": clocks[1][used], **columns, **dict(zip(names, joined[used].T, strict=True))}
    dropped = said_of_commands(Held(used, np.empty(0, int), early, late))
    return JoinedCommands(columns, int(np.sum(complete)), dropped)


def _joints(file: File) -> list[str]:
    """The columns of joint positions, along the arm."""
    blocks = [block for block in file.found.blocks if block.kind == "q"]
    numbered = [pair for block in blocks for pair in zip(block.joints, block.columns, strict=True)]
    return [name for _, name in sorted(numbered)]


def _times(file: File) -> Array:
    """`(row,)` s.

    Raises:
        InputError: no column looks like times.
    """
    block: Block | None = file.found.of("time")
    if block is None:
        raise InputError(
            f"{file.source}: has no times, by which commands and joints are joined; say which column they are, "
            "--column NAME=time_s"
        )
    return block.in_si(file.columns)[:, 0]


def _runs(file: File) -> Array:
    """`(row,)`, zero where there is one."""
    block = file.found.of("run")
    if block is None:
        return np.zeros(len(next(iter(file.columns.values()))))
    return file.columns[block.columns[0]]


def _command_name(name: str, columns: dict[str, Array]) -> str:
    """A name that says that a column is commanded, and that none of the columns has."""
    if naming.says_commanded(name) and name not in columns:
        return name
    return f"commanded.{name}"


def _by_columns(file: File) -> bool:
    q = file.found.of("q")
    return q is not None and q.rank == 2


def _by_name(file: File) -> bool:
    return naming.says_commanded(file.stem) or bool(naming.spoken_words(file.stem) & _SENDS)


def _by_cells(file: File) -> bool:
    single = [{*cells} for cells in file.words.values()]
    spoken = [naming.spoken_words(word) for cells in single if len(cells) == 1 for word in cells]
    return any(bool(words & _SENDS) or any(map(naming.says_commanded, words)) for words in spoken)
