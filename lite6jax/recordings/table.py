"""From the columns of a table to the arrays of a recording: the same for files and for data frames in memory."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import types

from lite6jax.errors import InputError, command_line
from lite6jax.recordings.columns.column import LABELS, OF_ARRAY, Column, is_scalar, name_columns, spelled
from lite6jax.recordings.columns.documented import nearest_known, parse_columns, sliding_of
from lite6jax.recordings.columns.orientations import add_deviations, with_quaternions
from lite6jax.recordings.readings import with_readings
from lite6jax.recordings.sequence import integrate_commands, run_segments
from lite6jax.recordings.streams import hold_commands, merge
from lite6jax.recordings.units import LARGEST_MISSING_SHARE, implausible
from lite6jax.storage import exists

Values = pa.Array | pa.ChunkedArray | str
"""A column, or what is wrong with it."""
Load = Callable[[Mapping[int, str]], Mapping[int, Values]]
"""Columns by their place, of which the quantity is given: a time may be a clock's, and labels are words."""
LATEST_START_S = 1e8  # three years: such a time is a clock's, not counted from a start
_FORM = re.compile(
    r"(\d{4}-\d\d-\d\d)[Tt ] *(\d\d:\d\d:\d\d)(?:[.,](\d{1,9})\d*)? *(Z|z|UTC|GMT|[+-]\d\d(?::?\d\d)?)?", re.ASCII
)
_LIKE_A_CLOCK = re.compile(r"\d:\d|\d[-/.]\d+[-/.]\d")
_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


class RawTable(NamedTuple):
    """The columns of a file or folder, by whatever names, read when they are asked for.

    Attributes:
        names: of all columns, in order.
        load: the values of some.
        nameless: whether the file names no column, so that they are `column_1`, `column_2`, ….
        assumed: names whose unit the file does not state.
    """

    names: Sequence[str]
    load: Load
    nameless: bool = False
    assumed: tuple[str, ...] = ()

    @classmethod
    def of_arrays(cls, values: Mapping[str, np.ndarray], assumed: Sequence[str] = ()) -> "RawTable":
        """Columns in memory."""
        arrays = list(values.values())
        return cls([*values], lambda indices: {k: pa.array(arrays[k]) for k in indices}, assumed=tuple(assumed))

    def renamed(self, source: str, meanings: Mapping[str, str]) -> dict[str, str]:
        """The names that columns are to have, by those that they have in the table.

        Args:
            source: what messages begin with.
            meanings: by the name of a column, or by the part of it before its unit, ` [mm]`, where that is of one.

        Raises:
            InputError: a table without names gets none.
        """
        if self.nameless and not meanings:
            command = command_line("init", source, "--names", "q1_deg,q2_deg,...")
            raise InputError(f"{source}: its first row holds numbers, and no line names the columns; `{command}` does")
        return resolve_names(self.names, meanings)

    def numbers(self) -> list[tuple[str, np.ndarray | None]]:
        """Every column with `(sample,)` float64, NaN where empty; None where it does not hold numbers.

        Of clock times the numbers are seconds since 1970.
        """
        columns = []
        for index, values in self.load(dict.fromkeys(range(len(self.names)), "time")).items():
            read = _read(values, "time")
            read = read.start + read.seconds if isinstance(read, ClockTimes) else read
            columns.append((self.names[index].strip(), None if isinstance(read, str) else read))
        return columns

    def words(self, columns: Iterable[str]) -> dict[str, list[str]]:
        """Those of some columns that are of text, one word a row; empty where a cell is."""
        listed = {*columns}
        quantities = {place: LABELS[0] for place, name in enumerate(self.names) if name.strip() in listed}
        read = {self.names[place].strip(): values for place, values in self.load(quantities).items()}
        texts = {name: _strings(values) for name, values in read.items() if is_text(values)}
        return {name: [word.strip("'\" ") for word in cells] for name, cells in texts.items()}


def resolve_names(names: Iterable[str], meanings: Mapping[str, str]) -> dict[str, str]:
    """What is given by names of columns, or by the part of a name before its unit, ` [mm]`, where that is of one."""
    listed = [*names]
    of_part: dict[str, list[str]] = {}
    for name in listed:
        of_part.setdefault(re.sub(r" \[[^\[\]]*\]$", "", name), []).append(name)
    resolved = {}
    for name, meaning in meanings.items():
        full_names = [] if name in listed else of_part.get(name, [])
        resolved[full_names[0] if len(full_names) == 1 else name] = meaning
    return resolved


# ------------------------------------------------------------------ clock times


class ClockTimes(NamedTuple):
    """A column of clock times.

    Attributes:
        seconds: `(sample,)` since the earliest; NaN where the column has none.
        start: of the earliest, s since 1970; without a zone, as if it were UTC.
        first: the earliest, to be shown; empty where the column has none at all.
    """

    seconds: np.ndarray
    start: float
    first: str


def like_a_clock(text: str) -> bool:
    """Tells whether text that is no number may be a date or a time of day, in whatever form."""
    return _LIKE_A_CLOCK.search(text) is not None


def clock_times(column: pa.Array | pa.ChunkedArray) -> ClockTimes | str:
    """The seconds in a column of text or of timestamps, or what is wrong with it.

    What would be a guess is refused: the order of day and month, a time of day alone, a zone in some rows only.
    """
    ticks: list[int | None]
    if types.is_timestamp(column.type):
        ticks = column.cast(pa.int64()).to_pylist()
        per_second = _PER_SECOND[column.type.unit]
        texts = ["" if tick is None else str(np.datetime64(tick, column.type.unit)) for tick in ticks]
    else:
        ticks = []
        per_second = 10**9
        zoned = set()
        texts = [(text or "").strip() for text in column.to_pylist()]
        for row, text in enumerate(texts, 1):
            moment = _parse_moment(text) if text else (None, None)
            if moment is None:
                return (
                    f"row {row} holds {text[:40]!r}, which is no clock time of one meaning; write it as "
                    "2026-11-21T10:00:00.123Z, with or without a zone, or as seconds"
                )
            ticks.append(moment[0])
            zoned |= {moment[1]} - {None}
            if len(zoned) > 1:
                return f"row {row} holds {text!r}, but not all rows have a zone; give each row one, or none"
    first = min((tick for tick in ticks if tick is not None), default=0)
    seconds = np.array([np.nan if tick is None else (tick - first) / per_second for tick in ticks])
    return ClockTimes(seconds, first / per_second, texts[ticks.index(first)] if first in ticks else "")


def _parse_moment(text: str) -> tuple[int, bool] | None:
    """Nanoseconds, and whether the text has a zone; None where it is of another form, or no day or hour there is."""
    if (match := _FORM.fullmatch(text)) is None:
        return None
    day, time, part, zone = match.groups()
    with suppress(ValueError):
        moment = datetime.fromisoformat(f"{day}T{time}{zone if zone and zone[0] in '+-' else '+00:00'}")
        return 10**9 * round(moment.timestamp()) + int((part or "0").ljust(9, "0")), zone is not None
    return None


def is_text(values: Values) -> bool:
    """Tells whether a column holds text."""
    if isinstance(values, str):
        return False
    kind = values.type
    return (
        types.is_string(kind) or types.is_large_string(kind) or types.is_string_view(kind) or types.is_dictionary(kind)
    )


def _strings(values: pa.Array | pa.ChunkedArray) -> list[str]:
    return [(word or "").strip() for word in values.cast(pa.string()).to_pylist()]


def _read(values: Values, quantity: str) -> np.ndarray | ClockTimes | str:
    """A column as `(sample,)` float64, NaN where empty; or what is wrong with it. A time may be given by a clock."""
    if isinstance(values, str):
        return values
    kind = values.type
    if quantity == "time" and (is_text(values) or types.is_timestamp(kind)):
        return clock_times(values)
    if types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind) or types.is_null(kind):
        return _as_numpy(values.cast(pa.float64(), safe=False))
    return f"holds {kind}, not numbers; write it as float64"


def _as_numpy(numbers: pa.Array | pa.ChunkedArray) -> np.ndarray:
    """Numbers `(sample,)`, NaN where there is none."""
    if numbers.null_count:
        return numbers.to_numpy(zero_copy_only=False)  # imports pandas, which takes half a second
    chunks = numbers.chunks if isinstance(numbers, pa.ChunkedArray) else [numbers]
    return np.concatenate([np.zeros(0), *map(np.from_dlpack, chunks)])


def _count_words(values: pa.Array | pa.ChunkedArray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Words as the number of each among all, in the order in which they first stand there; NaN of missing ones."""
    words = _strings(values)
    names = tuple(dict.fromkeys(filter(None, words)))
    place = {name: float(k) for k, name in enumerate(names)} | {"": np.nan}
    return np.array([place[word] for word in words]), names


# ------------------------------------------------------------------ columns and arrays


class Table(NamedTuple):
    """Recognised columns and their values.

    Attributes:
        columns: by their names in SI units.
        joints: how many.
        values: `(sample,)` float64 in SI units, by the same names; NaN where absent.
        row: `(sample,)` of the table, counted from 1; None where every row is a sample.
        labels: of columns of words, the words that their values count.
    """

    columns: dict[str, Column]
    joints: int
    values: dict[str, np.ndarray]
    row: np.ndarray | None = None
    labels: Mapping[str, tuple[str, ...]] = MappingProxyType({})

    @property
    def spelling(self) -> dict[str, str]:
        """The name in SI units to the column's own, for messages."""
        return {name: column.name for name, column in self.columns.items()}

    def converts(self, name: str) -> bool:
        """Tells whether the column of this name in SI units is in another unit, and says so."""
        return name in self.columns and self.columns[name].divisor != 1


def tabulate(
    raw: RawTable,
    source: str,
    notes: list[str],
    *,
    dof: int | None = None,
    renamed: Mapping[str, str] | None = None,
    joints_optional: bool = False,
) -> Table:
    """The columns of a table that a recording has, or one line with all that is wrong with them.

    Args:
        raw: the table.
        source: what messages begin with.
        notes: gets a sentence on the columns that are ignored, and on clock times.
        dof, renamed, joints_optional: as in `parse_columns`.

    Raises:
        InputError: problems of names as `parse_columns`, columns that hold no numbers, no rows; where there are several
            problems, or several columns are over half empty, all are named.
    """
    columns, joints, ignored, of_names = parse_columns(raw.names, dof, joints_optional, renamed)
    problems = [*of_names]
    values = {}
    labels = {}
    row = None
    try:
        loaded = raw.load({column.place: column.quantity for column in columns.values()})
        for name, column in columns.items():
            array = loaded[column.place]
            if column.quantity in LABELS and not isinstance(array, str):
                values[name], labels[name] = _count_words(array)
                continue
            read = _read(array, column.quantity)
            if isinstance(read, str):
                problems.append(f"column {column.name}: {read}")
            elif isinstance(read, ClockTimes):
                values[name] = read.seconds
                notes.append(f"{column.name} holds clock times: they are counted from the first, {read.first}")
            else:
                values[name] = read if column.divisor == 1.0 else read / column.divisor
    except InputError as error:  # of the table as a whole
        if not problems:
            raise
        problems.append(str(error).removeprefix(f"{source}: "))
    lengths = {len(column) for column in values.values()}
    if len(lengths) > 1:
        problems.append(f"its columns have unequal lengths, {min(lengths)} to {max(lengths)}; give one each")
    elif lengths == {0} and not problems:
        problems.append("has column names but no rows; record again")
    else:
        try:  # where joints and poses stand in different rows
            moved, places = name_columns("joint_position", joints), name_columns("position")
            if (merged := merge(values, moved, places, "time_s", notes)) is not None:
                values, row = merged[0], merged[1] + 1
            commands = [*name_columns("commanded_position", joints), *_velocity_commands(joints)]
            sent = [name for name in commands if name in values]
            if (held := hold_commands(values, moved, sent, "time_s", notes)) is not None:
                values = held[0]
                row = held[1] + 1 if row is None else row[held[1]]
        except InputError as error:
            raise InputError(f"{source}: {error}") from error
        empty = []
        for name, column in values.items():
            count = int(np.sum(~np.isfinite(column)))
            if count > LARGEST_MISSING_SHARE * len(column):
                problem = f"{count} of {len(column)} rows are NaN, infinite or empty; fill it or leave it out"
                empty.append(f"column {columns[name].name}: {problem}")
        # one alone is reported with the rows that are left out for it; targets keep their rows
        problems += empty if problems or (len(empty) > 1 and not joints_optional) else []
    if problems:
        init_helps = any("write " in problem or "name their columns" in problem for problem in of_names)
        remedy = (
            f"; `{command_line('init', source)}` names columns as they are" if init_helps and exists(source) else ""
        )
        if len(problems) == 1:
            raise InputError(f"{source}: {problems[0]}{remedy}")
        numbered = " ".join(f"({number}) {problem}." for number, problem in enumerate(problems, 1))
        raise InputError(f"{source}: {len(problems)} problems of its columns: {numbered.removesuffix('.')}{remedy}")
    if ignored:
        shown = ", ".join(
            f"{n[:40]!r}" + (f" (meant {near}?)" if (near := nearest_known(n)) else "") for n in ignored[:6]
        )
        more = f" and {len(ignored) - 6} more" if len(ignored) > 6 else ""
        notes.append(f"ignored columns that mean nothing here: {shown}{more}")
    return Table(columns, joints, values, row, labels)


def read_frame(frame: Any, source: str, notes: list[str], renamed: Mapping[str, str] | None = None) -> Table:
    """The columns of a data frame that a recording has.

    Args:
        frame: anything with named columns: a pandas or polars `DataFrame`, a pyarrow `Table`, a mapping of names to
            arrays, or what has `__arrow_c_stream__`.
        source: for messages.
        notes: gets a sentence on the columns that are ignored.
        renamed: of columns with names of their own, the names that a recording has, as in a sidecar.

    Raises:
        InputError: no named columns, no rows, columns of unequal length, or a column that does not hold numbers; names
            as `parse_columns`.
    """
    names = list(frame) if isinstance(frame, Mapping) else None
    for attribute in ("column_names", "columns"):
        names = getattr(frame, attribute, None) if names is None else names
    if names is None and hasattr(frame, "__arrow_c_stream__"):
        frame = pa.table(frame)
        names = frame.column_names
    names = [] if names is None else list(names)
    if not names or not all(isinstance(name, str) for name in names):
        raise InputError(
            f"{source}: a {type(frame).__name__} has no named columns; give a data frame with columns q1_rad ... qN_rad"
        )
    raw = RawTable(names, lambda indices: {index: _arrow(frame[names[index]]) for index in indices})
    return tabulate(raw, source, notes, renamed=renamed)


def _arrow(values: Any) -> Values:
    """One column of any data frame as Arrow's, or what is wrong with it."""
    try:
        if isinstance(values, pa.Array | pa.ChunkedArray):
            return values
        if hasattr(values, "__arrow_c_stream__"):
            return pa.chunked_array(values)
        return pa.array(values, from_pandas=True)
    except (pa.ArrowException, TypeError, ValueError):
        kind = getattr(values, "dtype", type(values).__name__)
        return f"holds {kind}, not numbers; give it as float64"


def _velocity_commands(joints: int) -> list[str]:
    """The columns of commanded velocities."""
    return [spelled("cmd_dq", joint + 1) for joint in range(joints)]


def _commanded_positions(arrays: Mapping[str, Any], table: Table, commanded: str, source: str, notes: list[str]) -> Any:
    """`(sample, joint)` rad, as commanded or, of commanded velocities, integrated; None where there are no commands.

    Args:
        arrays: those of a recording.
        table: where they are from.
        commanded: what the sidecar says of commands.
        source: what messages begin with.
        notes: gets a sentence on the integration.

    Raises:
        InputError: velocities without times, or positions that are said to be velocities.
    """
    positions = arrays["commanded_position"]
    velocities = [table.values[name] for name in _velocity_commands(table.joints) if name in table.values]
    if not velocities:
        if positions is not None and commanded == "velocity":
            raise InputError(
                f"{source}: the sidecar says command: velocity, but its commands are positions; name velocities "
                f"{spelled('cmd_dq', 1)} ..., or leave command out"
            )
        return positions
    if positions is not None and commanded == "position":
        return positions
    if arrays["time"] is None:
        raise InputError(f"{source}: commands of velocity need times; add time_s")
    notes.append(
        "commands of velocity are taken as commands of position: they are integrated over time from the first joint "
        "positions of each run, as controllers of velocity do"
    )
    joint_position = arrays["joint_position"]
    run = np.zeros(len(joint_position), np.int64) if arrays["run"] is None else arrays["run"]
    return integrate_commands(np.stack(velocities, 1), joint_position, arrays["time"], run_segments(run))


def make_arrays(table: Table, source: str, notes: list[str], commanded: str = "position") -> dict[str, Any]:
    """The arguments of `Recording.assembled` that a table holds.

    Commanded velocities become positions, where no positions were commanded or `commanded` is "velocity".

    Raises:
        InputError: a run that is not a whole number, or commanded velocities without times.
    """
    values = with_quaternions(add_deviations(table.values, notes), source)
    arrays = {}
    for name in OF_ARRAY:
        listed = name_columns(name, table.joints)
        block = [values[column] for column in listed if column in values]
        arrays[name] = None if not block else block[0] if is_scalar(name) else np.stack(block, 1)
    joint_position = arrays["joint_position"]
    assert joint_position is not None  # `parse_columns` requires it
    if (missing := values.get("missing")) is not None and (gaps := int((missing > 0).sum())):
        total = f"{np.nansum(missing):.0f} reports of the controller are missing"
        notes.append(f"{total}, in {gaps} gap{'s' if gaps > 1 else ''}; the columns missing and gap say where and why")
    if (run := arrays["run"]) is not None:
        finite = np.isfinite(run)
        wrong = np.flatnonzero(finite & ((run != np.round(run)) | (np.abs(run) > 2**53)))
        if wrong.size:
            raise InputError(f"{source}: column run: row {wrong[0] + 1} is {run[wrong[0]]:g}; give whole numbers")
        # a row without a run belongs to none and is dropped with its joints; meanwhile it must not split its neighbours
        joint_position[~finite] = np.nan
        last = np.maximum.accumulate(np.where(finite, np.arange(len(run)), 0))
        arrays["run"] = np.where(finite[last], run[last], 0.0).astype(np.int64)
    if (time := arrays["time"]) is not None:
        start = np.min(time, where=np.isfinite(time) & ~implausible("time", time[:, None])[:, 0], initial=np.inf)
        if LATEST_START_S < start < np.inf:
            arrays["time"] = time - start
            name = table.columns["time_s"].name
            notes.append(f"{name} is a clock's: times are counted from the first, {start:.0f} s")
    arrays["commanded_position"] = _commanded_positions(arrays, table, commanded, source, notes)
    arrays |= {"sliding": sliding_of(table.columns), "row": table.row}
    return with_readings(arrays, values, table.labels, source, notes)
