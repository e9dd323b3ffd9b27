"""Tables on disk that are appended to during a recording and remain valid when the disk is full."""

import io
import os
from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv as pa_csv
from pyarrow import parquet as pa_parquet

from lite6jax.errors import InputError
from lite6jax.recordings.stream import stream_batch, stream_batches, stream_path, stream_start
from lite6jax.storage import write_atomically

Columns = Mapping[str, NDArray]

ROW_GROUP = 25_000
"""Rows of a complete Parquet file that are compressed together."""


class TableWriter:
    """A CSV or Parquet table, by the suffix of its path, to which rows are appended.

    A failed `append` adds nothing and may be repeated. A CSV file is complete after every `append` even if the process
    is killed. A Parquet file can be read once the list of its row groups is written at its end; until then the rows
    stand in an Arrow stream beside it, whole after every `append`. The stream is the recording where the process is
    killed, or where the disk has no room for the Parquet file.

    Attributes:
        file: where the rows are.
    """

    def __init__(self, path: Path, overwrite: bool, sources: Mapping[str, str]) -> None:
        """Creates no file before the first `append`.

        Args:
            path: the table, `.csv` or `.parquet`.
            overwrite: whether an existing file may be replaced.
            sources: the source of each column as a phrase, stored as column metadata in Parquet.
        """
        self._path, self._overwrite, self._sources = path, overwrite, sources
        self._parquet = path.suffix.lower() == ".parquet"
        self.file = stream_path(path) if self._parquet else path
        self._schema: pa.Schema | None = None
        self._open: io.FileIO | None = None
        self._size = 0

    def append(self, columns: Columns) -> None:
        """Appends rows.

        Raises:
            OSError: the disk is full or fails; earlier rows remain.
        """
        fields = [
            pa.field(
                name,
                pa.string() if values.dtype == object else pa.from_numpy_dtype(values.dtype),
                metadata={"source": self._sources.get(name, "")},
            )
            for name, values in columns.items()
        ]
        self._schema = self._schema or pa.schema(fields)
        batch = pa.record_batch(dict(columns), schema=self._schema)
        first, sink = not self._size, pa.BufferOutputStream()
        if self._parquet:
            sink.write((stream_start(self._schema) if first else b"") + stream_batch(batch))
        else:
            sink.write(",".join(columns).encode() + b"\n" if first else b"")
            pa_csv.write_csv(batch, sink, pa_csv.WriteOptions(include_header=False))
        rest = memoryview(sink.getvalue())
        size = self._size + len(rest)
        if self._open is None:
            self._open = io.FileIO(self.file, "w+" if self._overwrite else "x+")
        try:
            self._open.seek(self._size)
            while len(rest):  # on a disk that becomes full, a write may be partial without an error
                rest = rest[self._open.write(rest) or 0 :]
        except OSError:
            self._open.truncate(self._size)
            raise
        self._size = size
        if first and self._parquet and self._overwrite:  # from here on it would not belong to the sidecar
            self._path.unlink(missing_ok=True)

    def close(self) -> None:
        """Completes the file; without rows there is none.

        Raises:
            OSError: the disk is full or fails; the rows are in `file`.
        """
        if self._open is None:
            return
        with self._open:
            os.fsync(self._open.fileno())
        if not self._size:
            self.file.unlink(missing_ok=True)
        elif self._parquet:
            try:
                write_atomically(self._path, self._write_parquet, self._overwrite)
            except InputError as error:
                raise OSError(f"{error}; the rows are in {self.file}, which is read like it") from error
            self.file.unlink()
            self.file = self._path

    def _write_parquet(self, target: Path) -> None:
        """Writes the stream as Parquet, row group by row group."""
        assert self._schema is not None
        writer = pa_parquet.ParquetWriter(
            target, self._schema, use_dictionary=False, compression="zstd", write_page_checksum=True
        )
        group: list[pa.RecordBatch] = []
        try:
            for batch in stream_batches(self.file, []):
                group.append(batch)
                if sum(map(len, group)) >= ROW_GROUP:
                    writer.write_table(pa.Table.from_batches(group))
                    group.clear()
            if group:
                writer.write_table(pa.Table.from_batches(group))
            writer.close()
        except OSError:
            writer.is_open = False  # or its destructor would write to the full disk again
            raise
