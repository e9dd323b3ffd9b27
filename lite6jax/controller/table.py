"""Tables on disk that are appended to during a recording and remain valid when the disk is full."""

import io
import os
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv as pa_csv
from pyarrow import parquet as pa_parquet

from lite6jax.errors import InputError
from lite6jax.recordings.stream import stream_batch, stream_batches, stream_path, stream_start
from lite6jax.storage import write_atomically

Columns = Mapping[str, NDArray]

ROWS_AT_ONCE = 250
"""Rows for which writing is worth it: those of a second, which a kill may cost."""
MOST_AT_ONCE = 2500
"""Rows written together, where more wait."""
ROW_GROUP = 25_000
"""Rows of a complete Parquet file that are compressed together."""


class TableWriter:
    """A CSV or Parquet table, by the suffix of its path, to which rows are appended.

    What is on the disk is complete, even if the process is killed. Rows that a full disk refuses wait in memory. A
    Parquet file can be read once the list of its row groups is written at its end; until then the rows stand in an
    Arrow stream beside it. The stream is the recording where the process is killed, or where the disk has no room for
    the Parquet file.

    Attributes:
        file: where the rows are.
        waiting: the number of rows in memory.
        refusal: why the disk does not accept them; empty while it does.
    """

    def __init__(self, path: Path, overwrite: bool, sources: Mapping[str, str]) -> None:
        """Creates no file before the first rows, nor replaces one unless `overwrite`.

        `sources` are phrases by column, which Parquet stores as column metadata.
        """
        self._path, self._overwrite, self._sources = path, overwrite, sources
        self._parquet = path.suffix.lower() == ".parquet"
        self.file = stream_path(path) if self._parquet else path
        self.waiting, self.refusal = 0, ""
        self._parts: list[Columns] = []
        self._not_before = 0.0
        self._schema: pa.Schema | None = None
        self._open: io.FileIO | None = None
        self._size = 0

    def append(self, columns: Columns) -> None:
        """Appends rows, and writes where there are enough and the disk refused none within the last second."""
        self._parts.append(columns)
        self.waiting += len(next(iter(columns.values())))
        while self.waiting >= ROWS_AT_ONCE and time.monotonic() >= self._not_before and self.flush():
            pass

    def flush(self, most: int = MOST_AT_ONCE) -> bool:
        """Writes up to `most` rows, all or none; whether the disk took them."""
        columns = {name: np.concatenate([part[name] for part in self._parts]) for name in self._parts[0]}
        self._parts = [columns]
        try:
            self._write({name: values[:most] for name, values in columns.items()})
        except OSError as error:
            self.refusal, self._not_before = error.strerror or str(error), time.monotonic() + 1.0
            return False
        self._parts = [{name: values[most:] for name, values in columns.items()}]
        self.waiting, self.refusal = max(self.waiting - most, 0), ""
        return True

    def close(self) -> None:
        """Writes the remaining rows as far as possible, and completes the file; without rows there is none."""
        most = MOST_AT_ONCE
        while self.waiting and most:
            most = most if self.flush(most) else most // 2
        try:
            self._complete()
        except OSError as error:
            self.refusal = self.refusal or error.strerror or str(error)

    def _write(self, columns: Columns) -> None:
        """Writes all rows or none.

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

    def _complete(self) -> None:
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
