"""Tables on disk that are appended to during a recording and remain valid when the disk is full."""

import io
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol, runtime_checkable

import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv as pa_csv
from pyarrow import parquet as pa_parquet

from lite6jax.errors import InputError
from lite6jax.recordings.stream import stream_batch, stream_batches, stream_path, stream_start
from lite6jax.storage import check_writable, write_atomically

Columns = Mapping[str, NDArray]

ROW_GROUP = 25_000
"""Rows of a complete Parquet file that are compressed together."""


@runtime_checkable
class GrowingTable(Protocol):
    """A table to which rows are appended.

    A failed `append` adds nothing and may be repeated.
    """

    rows_at_once: int
    """The number of rows for which an `append` is worth it: those of a second, which a kill may cost."""
    file: Path
    """Where the rows are."""

    def append(self, columns: Columns) -> None:
        """Appends rows; the first call creates the file.

        Raises:
            OSError: the disk is full or fails; earlier rows remain.
        """
        ...

    def close(self) -> None:
        """Completes the file; without rows there is none.

        Raises:
            OSError: the disk is full or fails; the rows are in `file`.
        """
        ...


def growing_table(path: Path, overwrite: bool, sources: Mapping[str, str]) -> "GrowingTable":
    """A CSV or Parquet table, by the suffix of `path`.

    Args:
        path: the file, created by the first `append`.
        overwrite: whether an existing file may be replaced.
        sources: the source of each column as a phrase, stored as column metadata in Parquet.

    Raises:
        InputError: another suffix, or the file, or the stream beside a Parquet file, cannot be written there.
    """
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise InputError(f"{path}: a recording ends in .csv or .parquet; choose such a name")
    check_writable(path, overwrite)
    if path.suffix.lower() == ".csv":
        return GrowingCsv(path, overwrite)
    check_writable(stream_path(path), overwrite)
    return GrowingParquet(path, overwrite, sources)


class GrowingCsv:
    """A CSV file, complete after every `append` even if the process is killed."""

    rows_at_once = 250

    def __init__(self, path: Path, overwrite: bool) -> None:
        self.file = path
        self._lines = _Growing(path, "w+" if overwrite else "x+")

    def append(self, columns: Columns) -> None:
        text = pa.BufferOutputStream()
        if not self._lines.size:
            text.write(",".join(columns).encode() + b"\n")
        table = pa.table({name: pa.array(values, _arrow_type(values)) for name, values in columns.items()})
        pa_csv.write_csv(table, text, pa_csv.WriteOptions(include_header=False))
        self._lines.add(text.getvalue().to_pybytes())

    def close(self) -> None:
        self._lines.close()


class GrowingParquet:
    """A Parquet file, which can be read once the list of its row groups is written at its end.

    Until then the rows stand in an Arrow stream beside it, whole after every `append`. The stream is the recording
    where the process is killed, or where the disk has no room for the Parquet file.
    """

    rows_at_once = 250

    def __init__(self, path: Path, overwrite: bool, sources: Mapping[str, str]) -> None:
        self.file = stream_path(path)
        self._path, self._overwrite, self._sources = path, overwrite, sources
        self._schema: pa.Schema | None = None
        self._stream = _Growing(self.file, "w+" if overwrite else "x+")

    def append(self, columns: Columns) -> None:
        fields = [
            pa.field(name, _arrow_type(values), metadata={"source": self._sources.get(name, "")})
            for name, values in columns.items()
        ]
        self._schema = self._schema or pa.schema(fields)
        batch = pa.record_batch(dict(columns), schema=self._schema)
        first = not self._stream.size
        self._stream.add((stream_start(self._schema) if first else b"") + stream_batch(batch))
        if first and self._overwrite:  # from here on it would not belong to the sidecar
            self._path.unlink(missing_ok=True)

    def close(self) -> None:
        self._stream.close()
        if not self._stream.size:
            return
        try:
            write_atomically(self._path, self._complete, self._overwrite)
        except InputError as error:
            raise OSError(f"{error}; the rows are in {self.file}, which is read like it") from error
        self.file.unlink()
        self.file = self._path

    def _complete(self, target: Path) -> None:
        """Writes the stream as Parquet, row group by row group."""
        assert self._schema is not None
        writer = pa_parquet.ParquetWriter(
            target, self._schema, use_dictionary=False, compression="zstd", write_page_checksum=True
        )
        try:
            for group in self._row_groups():
                writer.write_table(pa.Table.from_batches(group))
            writer.close()
        except OSError:
            writer.is_open = False  # or its destructor would write to the full disk again
            raise

    def _row_groups(self) -> Iterator[list[pa.RecordBatch]]:
        group: list[pa.RecordBatch] = []
        for batch in stream_batches(self.file, []):
            group.append(batch)
            if sum(map(len, group)) >= ROW_GROUP:
                yield group
                group = []
        if group:
            yield group


class _Growing:
    """A file to which bytes are added, all or none of them."""

    def __init__(self, path: Path, mode: str) -> None:
        self._path, self._mode = path, mode
        self._file: io.FileIO | None = None
        self.size = 0

    def add(self, data: bytes) -> None:
        """Adds bytes; the first call creates the file.

        Raises:
            OSError: the disk is full or fails; what was added before remains.
        """
        if self._file is None:
            self._file = io.FileIO(self._path, self._mode)
        try:
            self._file.seek(self.size)
            rest = memoryview(data)
            while len(rest):  # on a disk that becomes full, a write may be partial without an error
                rest = rest[self._file.write(rest) or 0 :]
        except OSError:
            self._file.truncate(self.size)
            raise
        self.size += len(data)

    def close(self) -> None:
        """Completes the file; without bytes there is none.

        Raises:
            OSError: the disk fails.
        """
        if self._file is None:
            return
        with self._file:
            os.fsync(self._file.fileno())
        if not self.size:
            self._path.unlink(missing_ok=True)


def _arrow_type(values: NDArray) -> pa.DataType:
    return pa.string() if values.dtype == object else pa.from_numpy_dtype(values.dtype)
