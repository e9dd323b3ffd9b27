"""From the columns of a table to the arrays of a recording: the same for files and for data frames in memory."""

import re
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from lite6jax.errors import InputError, command_line
from lite6jax.recordings import streams
from lite6jax.recordings.columns import (
    LABELS,
    Column,
    Recognised,
    nearest_known,
    one_line,
    recognise,
    sliding_of,
    with_quaternions,
)
from lite6jax.recordings.readings import with_readings
from lite6jax.recordings.units import LARGEST_MISSING_SHARE, implausible
from lite6jax.storage import exists

_FORM = re.compile(
    r"(\d{4}-\d\d-\d\d)[Tt ] *(\d\d:\d\d:\d\d)(?:[.,](\d{1,9})\d*)? *(Z|z|UTC|GMT|[+-]\d\d(?::?\d\d)?)?", re.ASCII
)
_LIKE_A_CLOCK = re.compile(r"\d:\d|\d[-/.]\d+[-/.]\d")
_REMEDY = "write it as 2026-11-21T10:00:00.123Z, with or without a zone, or as seconds"
_EPOCH = datetime(1970, 1, 1)
_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


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


def holds_clock_times(kind: pa.DataType) -> bool:
    """Whether columns of a type may hold clock times."""
    text = pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind)
    return text or pa.types.is_timestamp(kind)


def like_a_clock(text: str) -> bool:
    """Whether text that is no number may be a date or a time of day, in whatever form."""
    return _LIKE_A_CLOCK.search(text) is not None


def clock_times(column: pa.Array | pa.ChunkedArray) -> ClockTimes | str:
    """The seconds in a column of text or of timestamps, or what is wrong with it.

    What would be a guess is refused: the order of day and month, a time of day alone, a zone in some rows only.
    """
    if pa.types.is_timestamp(column.type):
        ticks, per_second = column.cast(pa.int64()).to_pylist(), _PER_SECOND[column.type.unit]
        return _since_first(ticks, per_second, lambda row: str(np.datetime64(ticks[row], column.type.unit)))
    texts = [(text or "").strip() for text in column.to_pylist()]
    ticks: list[int | None] = []
    zoned: set[bool] = set()
    for row, text in enumerate(texts, 1):
        if not text:
            ticks.append(None)
            continue
        found = _moment(text)
        if found is None:
            return f"row {row} holds {text[:40]!r}, which is no clock time of one meaning; {_REMEDY}"
        ticks.append(found[0])
        zoned.add(found[1])
        if len(zoned) > 1:
            return f"row {row} holds {text!r}, but not all rows have a zone; give each row one, or none"
    return _since_first(ticks, 10**9, texts.__getitem__)


def _since_first(ticks: Sequence[int | None], per_second: int, shown: Callable[[int], str]) -> ClockTimes:
    there = [tick for tick in ticks if tick is not None]
    if not there:
        return ClockTimes(np.full(len(ticks), np.nan), 0.0, "")
    first = min(there)
    seconds = [np.nan if tick is None else (tick - first) / per_second for tick in ticks]
    return ClockTimes(np.array(seconds), first / per_second, shown(ticks.index(first)))


def _moment(text: str) -> tuple[int, bool] | None:
    """Nanoseconds, and whether the text has a zone; None where it is of another form, or no day or hour there is."""
    match = _FORM.fullmatch(text)
    if match is None:
        return None
    day, time, part, zone = match.groups()
    try:
        since = datetime.fromisoformat(f"{day}T{time}") - _EPOCH
    except ValueError:
        return None
    seconds = 86400 * since.days + since.seconds - _later(zone or "")
    return 10**9 * seconds + int((part or "0").ljust(9, "0")), zone is not None


def _later(zone: str) -> int:
    """The seconds by which a zone such as +01:00 is later than UTC."""
    if zone[:1] not in ("+", "-"):
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    return (1 if zone[0] == "+" else -1) * (3600 * int(digits[:2]) + 60 * int(digits[2:]))


# ------------------------------------------------------------------ columns and arrays


LATEST_START_S = 1e8  # three years: such a time is a clock's, not counted from a start


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


Loaded = Mapping[str, pa.Array | pa.ChunkedArray | str]
"""A column, or what is wrong with it, by its SI name."""


def tabulated(
    names: Sequence[str],
    source: str,
    load: Callable[[Mapping[str, Column]], Loaded],
    notes: list[str],
    *,
    dof: int | None = None,
    renamed: Mapping[str, str] | None = None,
    joints_optional: bool = False,
) -> Table:
    """The columns of a table that a recording has, or one line with all that is wrong with them.

    Args:
        names: of all columns.
        source: what messages begin with.
        load: of recognised columns, their values.
        notes: gets a sentence on the columns that are ignored.
        dof, renamed, joints_optional: as in `recognise`.

    Raises:
        InputError: problems of names as `recognise`, columns that hold no numbers, no rows; where there are several
            problems, or several columns are over half empty, all are named.
    """
    found = recognise(names, dof, joints_optional, renamed)
    problems, arrays = list(found.problems), {}
    try:
        for name, array in (load(found.columns) if found.columns else {}).items():
            column = found.columns[name]
            read = array if isinstance(array, str) or column.quantity in LABELS else _numbers(array, column, notes)
            if isinstance(read, str):
                problems.append(f"column {column.name}: {read}")
            else:
                arrays[name] = read
    except InputError as error:  # of the table as a whole
        if not problems:
            raise
        problems.append(str(error).removeprefix(f"{source}: "))
    labels, row = {}, None
    for name in LABELS:
        if name in arrays:
            arrays[name], labels[name] = _counted(arrays[name])
    values = si_values(found.columns, arrays)
    lengths = {len(column) for column in values.values()}
    if len(lengths) > 1:
        problems.append(f"its columns have unequal lengths, {min(lengths)} to {max(lengths)}; give one each")
    elif lengths == {0} and not problems:
        problems.append("has column names but no rows; record again")
    else:
        try:
            if (whole := _with_joined_streams(values, found.joints)) is not None:
                values, row = whole.columns, whole.rows + 1
                notes += streams.said_of_merged(whole)
        except InputError as error:
            raise InputError(f"{source}: {error}") from error
        empty = [_empty(found.columns[name].name, column) for name, column in values.items()]
        empty = [said for said in empty if said]
        # one alone is reported with the rows that are left out for it; targets keep their rows
        problems += empty if problems or (len(empty) > 1 and not joints_optional) else []
    if problems:
        raise InputError(one_line(source, problems, _remedy(source, found)))
    if found.ignored:
        shown = ", ".join(
            f"{n[:40]!r}" + (f" (meant {near}?)" if (near := nearest_known(n)) else "") for n in found.ignored[:6]
        )
        rest = f" and {len(found.ignored) - 6} more" if len(found.ignored) > 6 else ""
        notes.append(f"ignored columns that mean nothing here: {shown}{rest}")
    return Table(found.columns, found.joints, values, row, labels)


def _with_joined_streams(values: Mapping[str, np.ndarray], joints: int) -> streams.Merged | None:
    """The rows with poses, where joints and poses stand in different rows: the joints are interpolated there."""
    if "time_s" not in values:
        return None
    return streams.merged(values, [f"q{joint}_rad" for joint in range(1, joints + 1)], ("x_m", "y_m", "z_m"), "time_s")


def _numbers(array: pa.Array | pa.ChunkedArray, column: Column, notes: list[str]) -> pa.Array | pa.ChunkedArray | str:
    """The column as numbers in its unit: of clock times since the first of them; or what is wrong with it."""
    if not holds_clock_times(array.type):
        return array
    times = clock_times(array)
    if isinstance(times, str):
        return times
    notes.append(f"{column.name} holds clock times: they are counted from the first, {times.first}")
    return pa.array(times.seconds * column.divisor)


def _remedy(source: str, found: Recognised) -> str:
    """What names the columns of a file, where their names are the problem."""
    named = any("write " in problem or "name their columns" in problem for problem in found.problems)
    return f"; `{command_line('init', source)}` names columns as they are" if named and exists(source) else ""


def _empty(name: str, column: np.ndarray) -> str:
    count = int(np.sum(~np.isfinite(column)))
    if count <= LARGEST_MISSING_SHARE * len(column):
        return ""
    return f"column {name}: {count} of {len(column)} rows are NaN, infinite or empty; fill it or leave it out"


def read_frame(frame: Any, source: str, notes: list[str], renamed: Mapping[str, str] | None = None) -> Table:
    """The columns of a data frame that a recording has.

    Args:
        frame: anything with named columns: a pandas or polars `DataFrame`, a pyarrow `Table`, a mapping of names to
            arrays, or what has `__arrow_c_stream__` or `__dataframe__`.
        source: for messages.
        notes: gets a sentence on the columns that are ignored.
        renamed: of columns with names of their own, the names that a recording has, as in a sidecar.

    Raises:
        InputError: no named columns, no rows, columns of unequal length, or a column that does not hold numbers; names
            as `recognise`.
    """
    frame, names = _named(frame)
    if not names or not all(isinstance(name, str) for name in names):
        raise InputError(
            f"{source}: a {type(frame).__name__} has no named columns; give a data frame with columns q1_rad ... qN_rad"
        )
    return tabulated(
        names,
        source,
        lambda columns: {name: _arrow(frame[column.name], column.quantity) for name, column in columns.items()},
        notes,
        renamed=renamed,
    )


def _named(frame: Any) -> tuple[Any, list[Any]]:
    """What gives a column by its name, and the names."""
    if isinstance(frame, Mapping):
        return frame, list(frame)
    listed = getattr(frame, "column_names", None)
    listed = getattr(frame, "columns", None) if listed is None else listed
    if listed is not None:
        return frame, list(listed)
    try:
        if hasattr(frame, "__arrow_c_stream__"):
            frame = pa.table(frame)
        elif hasattr(frame, "__dataframe__"):
            from pyarrow.interchange import from_dataframe  # files do without it

            frame = from_dataframe(frame)
    except (pa.ArrowException, TypeError, ValueError, NotImplementedError):
        return frame, []
    return (frame, frame.column_names) if isinstance(frame, pa.Table) else (frame, [])


def no_numbers(kind: pa.DataType, quantity: str) -> str:
    """What is wrong with a column of text, truth values, dates or complex numbers; empty where it may be read.

    A time may be given by a clock.
    """
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind) or pa.types.is_null(kind):
        return ""
    if quantity == "time" and holds_clock_times(kind):
        return ""
    if quantity in LABELS and (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return ""
    return f"holds {kind}, not numbers; write it as float64"


def _counted(array: pa.Array | pa.ChunkedArray) -> tuple[pa.Array, tuple[str, ...]]:
    """Words as the number of each among all, in the order in which they first stand there; missing ones are null."""
    words = [None if word is None or not word.strip() else word.strip() for word in array.cast(pa.string()).to_pylist()]
    names = tuple(dict.fromkeys(word for word in words if word is not None))
    place = {name: k for k, name in enumerate(names)}
    return pa.array([None if word is None else float(place[word]) for word in words], pa.float64()), names


def si_values(columns: Mapping[str, Column], table: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """`(sample,)` float64 in SI units of Arrow columns; an absent value becomes NaN."""
    values = {}
    for name, arrow in table.items():
        array = arrow.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        divisor = columns[name].divisor
        values[name] = array if divisor == 1.0 else array / divisor
    return values


def arrays_of(table: Table, source: str, notes: list[str]) -> dict[str, Any]:
    """The arguments of `Recording.assembled` that a table holds.

    Raises:
        InputError: a run that is not a whole number.
    """
    columns, joints = table.columns, table.joints
    values = with_quaternions(table.values, source)

    def block(*names: str) -> np.ndarray | None:
        return np.column_stack([values[name] for name in names]) if names[0] in values else None

    def per_joint(pattern: str) -> np.ndarray | None:
        return block(*(pattern.format(joint) for joint in range(1, joints + 1)))

    joint_position = per_joint("q{}_rad")
    assert joint_position is not None  # `recognise` requires it
    if (missing := values.get("missing")) is not None and (gaps := int((missing > 0).sum())):
        total = f"{np.nansum(missing):.0f} reports of the controller are missing"
        notes.append(f"{total}, in {gaps} gap{'s' if gaps > 1 else ''}; the columns missing and gap say where and why")
    run = values.get("run")
    if run is not None:
        given = np.isfinite(run)
        wrong = np.flatnonzero(given & ((run != np.round(run)) | (np.abs(run) > 2**53)))
        if wrong.size:
            raise InputError(f"{source}: column run: row {wrong[0] + 1} is {run[wrong[0]]:g}; give whole numbers")
        # a row without a run belongs to none and is dropped with its joints; meanwhile it must not split its neighbours
        joint_position[~given] = np.nan
        last = np.maximum.accumulate(np.where(given, np.arange(len(run)), 0))
        run = np.where(given[last], run[last], 0.0).astype(np.int64)
    time = values.get("time_s")
    if time is not None:
        start = np.min(time, where=np.isfinite(time) & ~implausible("time", time[:, None])[:, 0], initial=np.inf)
        if LATEST_START_S < start < np.inf:
            time = time - start
            notes.append(f"{columns['time_s'].name} is a clock's: times are counted from the first, {start:.0f} s")
    arrays = {
        "sliding": sliding_of(columns),
        "joint_position": joint_position,
        "position": block("x_m", "y_m", "z_m"),
        "quaternion": block("qw", "qx", "qy", "qz"),
        "time": time,
        "joint_velocity": per_joint("dq{}_rad_per_s"),
        "joint_acceleration": per_joint("ddq{}_rad_per_s2"),
        "joint_torque": per_joint("tau{}_Nm"),
        "motor_current": per_joint("current{}_A"),
        "joint_temperature": per_joint("temp{}_degC"),
        "commanded_position": per_joint("cmd{}_rad"),
        "ambient_temperature": values.get("ambient_degC"),
        "payload": values.get("payload_kg"),
        "run": run,
        "row": table.row,
    }
    return with_readings(arrays, values, table.labels, source, notes)


def _arrow(values: Any, quantity: str) -> pa.Array | pa.ChunkedArray | str:
    """One column of any data frame as Arrow's, or what is wrong with it."""
    try:
        if isinstance(values, pa.Array | pa.ChunkedArray):
            array = values
        elif hasattr(values, "__arrow_c_stream__"):
            array = pa.chunked_array(values)
        else:
            array = pa.array(values, from_pandas=True)
    except (pa.ArrowException, TypeError, ValueError):
        kind = getattr(values, "dtype", type(values).__name__)
        return f"holds {kind}, not numbers; give it as float64"
    return no_numbers(array.type, quantity) or array
