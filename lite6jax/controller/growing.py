"""Tables on disk that are appended to during a recording and remain valid when the disk is full."""

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
    """A table to which rows are appended.

    A failed `append` adds nothing and may be repeated.
    """

    rows_at_once: int
    """The number of rows for an efficient `append`."""

    def append(self, columns: Columns) -> None:
        """Appends rows; the first call creates the file.

        Raises:
            OSError: the disk is full or fails; earlier rows remain.
        """
        ...

    def close(self) -> None:
        """Completes the file; without rows there is none.

        Raises:
            OSError: the disk fails.
        """
        ...


def growing_table(path: Path, overwrite: bool, sources: Mapping[str, str]) -> "GrowingTable":
    """A CSV or Parquet table, by the suffix of `path`.

    Args:
        path: the file, created by the first `append`.
        overwrite: whether an existing file may be replaced.
        sources: the source of each column as a phrase, stored as column metadata in Parquet.

    Raises:
        InputError: another suffix, or the file cannot be written there.
    """
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise InputError(f"{path}: a recording ends in .csv or .parquet; choose such a name")
    check_writable(path, overwrite)
    mode = "w+" if overwrite else "x+"
    return GrowingCsv(path, mode) if path.suffix.lower() == ".csv" else GrowingParquet(path, mode, sources)


class GrowingCsv:
    """A CSV file, complete after every `append` even if the process is killed."""

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
    """A Parquet file. Its row groups are readable only with the list of them at the end of the file.

    The space for this list and for the next row group is therefore allocated before the row group is written, so that
    the file can be completed on a full disk.
    """

    rows_at_once = 2500

    def __init__(self, path: Path, mode: str, sources: Mapping[str, str]) -> None:
        self._path, self._mode, self._sources = path, mode, sources
        self._file: _Reserved | None = None
        self._writer: pa_parquet.ParquetWriter | None = None
        self._listing = 0  # bytes, an upper bound of the list of row groups

    def append(self, columns: Columns) -> None:
        fields = [
            pa.field(name, pa.from_numpy_dtype(values.dtype), metadata={"source": self._sources.get(name, "")})
            for name, values in columns.items()
        ]
        table = pa.table(dict(columns), schema=pa.schema(fields))
        if self._file is None:
            self._file = _Reserved(self._path, self._mode)
        listing = self._listing + _LISTED * len(fields)
        # compression enlarges random bytes by less than a twentieth; each column has a header
        self._file.reserve(table.nbytes * 21 // 20 + _LISTED * len(fields) + 2 * _LISTED * len(fields) + listing)
        if self._writer is None:
            sink = pa.PythonFile(self._file, mode="w")
            self._writer = pa_parquet.ParquetWriter(
                sink, table.schema, use_dictionary=False, compression="zstd", write_page_checksum=True
            )
        self._writer.write_table(table)
        self._listing = listing

    def close(self) -> None:
        if self._file is None:
            return
        if self._writer is None:  # no row fitted on the disk
            self._file.close()
            self._path.unlink(missing_ok=True)
            return
        self._writer.close()
        self._file.finish()


_LISTED = 1000
"""Bytes, an upper bound of a column's entry in the list of row groups (about 200) and of its header."""


class _Reserved:
    """A file object for Arrow that writes into allocated disk space."""

    def __init__(self, path: Path, mode: str) -> None:
        self._raw = io.FileIO(path, mode)
        self._end = self._allocated = 0

    @property
    def closed(self) -> bool:
        return self._raw.closed

    def flush(self) -> None:
        """Nothing to do: the file is unbuffered."""

    def reserve(self, size: int) -> None:
        """Allocates `size` bytes more by writing zeros, as no system call does so on all systems.

        Raises:
            OSError: the disk is full; the file is unchanged.
        """
        allocated = max(self._allocated, self._end + size)
        try:
            self._raw.seek(self._allocated)
            _write_all(self._raw, memoryview(bytes(allocated - self._allocated)))
        except OSError:
            self._raw.truncate(self._allocated)
            raise
        self._allocated = allocated

    def write(self, data: bytes) -> int:
        self._raw.seek(self._end)
        _write_all(self._raw, memoryview(data))
        self._end += len(data)
        return len(data)

    def finish(self) -> None:
        """Releases unused space and closes the file."""
        self._raw.truncate(self._end)
        os.fsync(self._raw.fileno())
        self._raw.close()

    def close(self) -> None:
        self._raw.close()


def _write_all(file: io.FileIO, data: memoryview) -> None:
    """Writes all bytes: on a disk that becomes full, a write may be partial without an error."""
    while len(data):
        data = data[file.write(data) or 0 :]
