"""CSV: fields between commas, semicolons, tabs or single spaces, decimals with a point or a comma."""

import csv
import re
from collections.abc import Mapping, Sequence, Set
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pyarrow.csv as pa_csv

from lite6jax.errors import InputError
from lite6jax.recordings.clock_times import like_a_clock
from lite6jax.recordings.columns import Column
from lite6jax.recordings.raw import RawTable, one_line
from lite6jax.recordings.table import Loaded

HEADER_LIMIT = 1 << 20
_NUMBER = re.compile(r"\s*[-+]?[\d.]+(e[-+]?\d+)?\s*", re.IGNORECASE)


class _Layout(NamedTuple):
    """How fields are separated, and how their decimals are written."""

    names: list[str]
    delimiter: str
    decimal: str


class _NoNumberError(InputError):
    """A field that holds no number but a text, in the column of this index."""

    def __init__(self, message: str, index: int, text: str) -> None:
        super().__init__(message)
        self.index, self.text = index, text


def of_csv(path: Path, notes: list[str]) -> RawTable:
    """The table of a CSV file.

    Args:
        path: the file; UTF-8.
        notes: gets a sentence where the last line has no end.

    Raises:
        InputError: no table of text, no names in the first line; from `load`, rows of another length than the first.
    """
    layout, tail = _layout(path), _tail(path)
    if not tail.endswith((b"\n", b"\r")):
        notes.append("the file does not end with a line break: its last number may have been cut short")

    def load(columns: Mapping[str, Column]) -> Loaded:
        wanted, wrong = [column.index for column in columns.values()], {}
        times = {column.index for column in columns.values() if column.quantity == "time"}
        texts: set[int] = set()
        while True:
            try:
                table = _read(path, layout, wanted, tail, texts) if wanted else pa.table({})
                break
            except _NoNumberError as error:
                if error.index in times and like_a_clock(error.text):
                    texts.add(error.index)
                    continue
                wrong[error.index] = str(error)  # the others may hold numbers
                wanted.remove(error.index)
        return {key: wrong.get(column.index) or table[str(column.index)] for key, column in columns.items()}

    return RawTable(layout.names, load)


def _read(
    path: Path, layout: _Layout, indices: Sequence[int], tail: bytes, texts: Set[int], threads: bool = True
) -> pa.Table:
    """The columns wanted, named by their index: two ignored columns may share a name. Those of `texts` are of text."""
    wanted = [str(index) for index in indices]
    kinds = {str(index): pa.string() if index in texts else pa.float64() for index in indices}
    numbers = [str(index) for index in range(len(layout.names))]
    try:
        return pa_csv.read_csv(
            path,
            pa_csv.ReadOptions(column_names=numbers, skip_rows=1, use_threads=threads),
            pa_csv.ParseOptions(delimiter=layout.delimiter),
            pa_csv.ConvertOptions(
                include_columns=wanted,
                column_types=kinds,
                decimal_point=layout.decimal,
            ),
        )
    except pa.ArrowInvalid as error:
        if "Could not skip" in str(error):  # Arrow's word for a header and nothing after it
            raise InputError(f"{path}: has column names but no rows; record again") from error
        if threads:  # rows are numbered only when they are read in order
            return _read(path, layout, indices, tail, texts, threads=False)
        if match := re.search(r"Row #(\d+): Expected \d+ columns, got (\d+)", str(error)):
            raise InputError(_ragged(path, int(match[1]) - 1, int(match[2]), layout, tail)) from error
        if match := re.match(r"In CSV column #(\d+): Row #(\d+): .*?invalid value '(.*)'$", str(error), re.DOTALL):
            value = repr(match[3] if len(match[3]) <= 40 else f"{match[3][:37]}...")
            point = "point" if layout.decimal == "." else "comma"
            raise _NoNumberError(
                f"row {int(match[2]) - 1} holds {value}, which is no number; give numbers with a decimal {point}, and "
                "leave missing ones empty",
                int(match[1]),
                match[3],
            ) from error
        raise InputError(f"{path}: is not a table of numbers ({one_line(error)}); check the file") from error


def _ragged(path: Path, row: int, fields: int, layout: _Layout, tail: bytes) -> str:
    names = layout.names
    place = f"{path}: row {row} has {fields} of {len(names)} columns"
    if fields < len(names):
        last = tail.rstrip().rpartition(b"\n")[2]
        cut = last.count(layout.delimiter.encode()) + 1 == fields
        problem = "the file is truncated" if cut else "the row is cut short"
        first = names[fields].strip()
        return f"{place}, {first} is the first without a value: {problem}; complete the row or remove it"
    return f"{place}; remove the surplus fields, and write decimals with a point"


def _layout(path: Path) -> _Layout:
    with open(path, "rb") as file:
        start = file.read(HEADER_LIMIT)
    if not start.strip():
        raise InputError(f"{path}: is empty; record again")
    if start.startswith(b"PAR1"):
        raise InputError(f"{path}: is a Parquet file, whatever its name says; name it .parquet")
    line, *rows = re.split(rb"\r\n|[\r\n]", start, maxsplit=2)
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if b"\0" in start or "\0" in text or len(line) == HEADER_LIMIT:
        raise InputError(f"{path}: is not a CSV table but binary or of another encoding; write it as UTF-8 text")
    if not text.strip():
        raise InputError(f"{path}: line 1 is empty; it must name the columns")
    row = rows[0].decode("utf-8", "replace") if rows else ""
    delimiter = _delimiter(text, row)
    try:
        names = next(csv.reader([text], delimiter=delimiter))
    except csv.Error as error:
        raise InputError(f"{path}: line 1 is no list of column names ({error}); check the file") from error
    if all(_NUMBER.fullmatch(name.replace(",", ".") if delimiter != "," else name) for name in names):
        raise InputError(f"{path}: line 1 holds numbers; it must name the columns, q1_rad, q2_rad, ...")
    return _Layout(names, delimiter, _decimal(row, delimiter))


def _decimal(row: str, delimiter: str) -> str:
    """A comma where numbers of the first row have it, whatever stands in its texts and dates."""
    fields = [field.strip().strip('"') for field in row.split(delimiter)] if delimiter in ";\t" else []
    commas, points = (
        sum(re.fullmatch(rf"[-+]?\d*{mark}\d+(e[-+]?\d+)?", field, re.IGNORECASE) is not None for field in fields)
        for mark in (",", r"\.")
    )
    return "," if commas > points else "."


def _delimiter(header: str, row: str) -> str:
    """Commas, unless another separator is more frequent in the first line; spaces only where a row has as many."""
    for separator in ";\t":
        if header.count(separator) > header.count(","):
            return separator
    spaces = header.strip().count(" ")
    return " " if spaces and "," not in header + row and row.strip().count(" ") == spaces else ","


def _tail(path: Path) -> bytes:
    with open(path, "rb") as file:
        file.seek(0, 2)
        file.seek(max(0, file.tell() - HEADER_LIMIT))
        return file.read()
