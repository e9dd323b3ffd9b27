"""Clock times as text, or as timestamps of a table: seconds since the first of them."""

import re
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import NamedTuple

import numpy as np
import pyarrow as pa

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
