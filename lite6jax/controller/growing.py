"""Tables on the disk that grow while they are recorded, and are whole when the disk is full."""

import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, runtime_checkable

import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv as pa_csv
from pyarrow import parquet as pa_parquet

from lite6jax.errors import InputError
from lite6jax.storage import check_writable

Columns = Mapping[str, NDArray]


@runtime_checkable
class GrowingTable(Protocol):
    """A table that rows are added to at its end.

    A failed `append` adds nothing and may be tried again.
    """

    rows_at_once: int
    """How many rows are worth an `append`."""

    def append(self, columns: Columns) -> None:
        """Adds rows; the first call makes the file.

        Raises:
            OSError: the disk refuses; the rows before stand.
        """
        ...

    def close(self) -> None:
        """Makes the file whole and readable; nothing where no row was added.

        Raises:
            OSError: the disk refuses.
        """
        ...


def growing_table(path: Path, overwrite: bool, sources: Mapping[str, str]) -> "GrowingTable":
    """A CSV or Parquet table, by the suffix.

    Args:
        path: the file; it is made by the first `append`.
        overwrite: whether it may replace one that exists.
        sources: where each column's numbers come from, in words; Parquet keeps them with the columns.

    Raises:
        InputError: another suffix, or the file cannot be written there.
    """
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise InputError(f"{path}: a recording ends in .csv or .parquet; choose such a name")
    check_writable(path, overwrite)
    mode = "w+" if overwrite else "x+"
    return GrowingCsv(path, mode) if path.suffix.lower() == ".csv" else GrowingParquet(path, mode, sources)


class GrowingCsv:
    """Lines of text: whole after every `append`, whatever happens to the process afterwards."""

    rows_at_once = 250

    def __init__(self, path: Path, mode: str) -> None:
        self._path, self._mode = path, mode
        self._file: io.FileIO | None = None
        self._end = 0

    def append(self, columns: Columns) -> None:
        text = pa.BufferOutputStream()
        if not self._end:
            text.write(",".join(columns).encode() + b"\n")
        pa_csv.write_csv(pa.table(dict(columns)), text, pa_csv.WriteOptions(include_header=False))
        if self._file is None:
            self._file = io.FileIO(self._path, self._mode)
        lines = memoryview(text.getvalue())
        try:
            self._file.seek(self._end)
            _write_all(self._file, lines)
        except OSError:
            self._file.truncate(self._end)
            raise
        self._end += len(lines)

    def close(self) -> None:
        if self._file is not None:
            with self._file:
                os.fsync(self._file.fileno())


class GrowingParquet:
    """Row groups, and at the end the list of them without which none can be read.

    So room for that list, and for the next row group, is taken from the disk before a row group is begun: where there
    is none the file can still be finished.
    """

    rows_at_once = 2500

    def __init__(self, path: Path, mode: str, sources: Mapping[str, str]) -> None:
        self._path, self._mode, self._sources = path, mode, sources
        self._file: _Reserved | None = None
        self._writer: pa_parquet.ParquetWriter | None = None
        self._listing = 0  # bytes that the list of row groups may take

    def append(self, columns: Columns) -> None:
        fields = [
            pa.field(name, pa.from_numpy_dtype(values.dtype), metadata={"source": self._sources.get(name, "")})
            for name, values in columns.items()
        ]
        table = pa.table(dict(columns), schema=pa.schema(fields))
        if self._file is None:
            self._file = _Reserved(self._path, self._mode)
        listing = self._listing + _LISTED * len(fields)
        # compressed, random bytes grow by less than a twentieth; each column has a header
        self._file.reserve(table.nbytes * 21 // 20 + _LISTED * len(fields) + 2 * _LISTED * len(fields) + listing)
        if self._writer is None:
            sink = pa.PythonFile(self._file, mode="w")
            self._writer = pa_parquet.ParquetWriter(sink, table.schema, use_dictionary=False, compression="zstd")
        self._writer.write_table(table)
        self._listing = listing

    def close(self) -> None:
        if self._file is None:
            return
        if self._writer is None:  # there was never room for a row
            self._file.close()
            self._path.unlink(missing_ok=True)
            return
        self._writer.close()
        self._file.finish()


_LISTED = 1000
"""Bytes, more than a column of a row group takes in the list of them (about 200), or in front of its numbers."""


class _Reserved:
    """A file, as Arrow writes to one, in room taken from the disk before."""

    def __init__(self, path: Path, mode: str) -> None:
        self._raw = io.FileIO(path, mode)
        self._end = self._taken = 0

    @property
    def closed(self) -> bool:
        return self._raw.closed

    def flush(self) -> None:
        """Every write goes to the system."""

    def reserve(self, size: int) -> None:
        """Takes room for `size` bytes more, by writing zeros: no system call says so on all systems.

        Raises:
            OSError: there is none; the file is as before.
        """
        taken = max(self._taken, self._end + size)
        try:
            self._raw.seek(self._taken)
            _write_all(self._raw, memoryview(bytes(taken - self._taken)))
        except OSError:
            self._raw.truncate(self._taken)
            raise
        self._taken = taken

    def write(self, data: bytes) -> int:
        self._raw.seek(self._end)
        _write_all(self._raw, memoryview(data))
        self._end += len(data)
        return len(data)

    def finish(self) -> None:
        """Gives the room back that was not needed."""
        self._raw.truncate(self._end)
        os.fsync(self._raw.fileno())
        self._raw.close()

    def close(self) -> None:
        self._raw.close()


def _write_all(file: io.FileIO, data: memoryview) -> None:
    """All of it: a disk that fills up takes a part and says nothing."""
    while len(data):
        data = data[file.write(data) or 0 :]
