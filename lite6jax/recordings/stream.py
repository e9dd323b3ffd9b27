"""Recordings that grow: Arrow streams whose batches are each whole or absent, whatever ends the process that writes."""

import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import pyarrow as pa

from lite6jax.errors import InputError

SUFFIX = ".arrows"
_CHECKSUM = b"lite6jax.crc32"
_UNREADABLE = (pa.ArrowException, OSError, ValueError)  # ValueError: names that are not UTF-8
_OPTIONS = pa.ipc.IpcWriteOptions(compression="zstd")


def stream_path(recording: str | Path) -> Path:
    """Where the rows of a Parquet recording stand until it is complete: the same stem, `.arrows`."""
    return Path(recording).with_suffix(SUFFIX)


def stream_start(schema: pa.Schema) -> bytes:
    """The bytes with which a stream begins."""
    return schema.serialize().to_pybytes()


def stream_batch(batch: pa.RecordBatch) -> bytes:
    """The bytes of a batch within a stream, with a checksum of its values."""
    sink = pa.BufferOutputStream()
    writer = pa.ipc.new_stream(sink, batch.schema, options=_OPTIONS)
    writer.write_batch(batch, custom_metadata={_CHECKSUM: str(_checksum(batch)).encode()})
    start, end = len(stream_start(batch.schema)), sink.tell()
    writer.close()
    return sink.getvalue()[start:end].to_pybytes()


def stream_batches(path: Path, notes: list[str]) -> Iterator[pa.RecordBatch]:
    """The whole batches of a stream, in order.

    Args:
        path: of the stream.
        notes: gets a sentence where the last batch was cut short, which is left out.

    Raises:
        InputError: not such a stream, or a batch whose values are not those that were written.
        OSError: the disk fails.
    """
    with pa.OSFile(str(path)) as file:
        try:
            reader = pa.ipc.open_stream(file)
        except _UNREADABLE as error:
            _reraise_the_disks(error)
            raise InputError(f"{path}: is not an Arrow stream, or was cut short before its first row") from error
        number, longest, end = 0, 0, file.tell()
        while end < file.size():
            try:
                batch, metadata = reader.read_next_batch_with_custom_metadata()
            except StopIteration:  # zeros, of a file that the disk had made longer but not filled
                break
            except _UNREADABLE as error:
                _reraise_the_disks(error)
                break
            number += 1
            if not _as_written(batch, metadata):
                raise InputError(f"{path}: batch {number} is damaged (its checksum differs); restore it from a copy")
            longest, end = max(longest, file.tell() - end), file.tell()
            yield batch
        if file.size() - end > 4 * longest:
            raise InputError(f"{path}: is damaged after batch {number}; restore it from a copy")
        if file.size() > end:
            notes.append("the recording was ended while rows were being written; the last of them are cut off")


def read_stream(path: Path, notes: list[str]) -> pa.Table:
    """All whole batches of a stream as one table; arguments and errors are those of `stream_batches`.

    Raises:
        InputError: there is no batch.
    """
    batches = list(stream_batches(path, notes))
    if not batches:
        raise InputError(f"{path}: has column names but no rows; record again")
    return pa.Table.from_batches(batches)


def _as_written(batch: pa.RecordBatch, metadata: Mapping[bytes, bytes] | None) -> bool:
    try:
        batch.validate(full=True)
        return metadata is not None and metadata.get(_CHECKSUM) == str(_checksum(batch)).encode()
    except _UNREADABLE:
        return False


def _reraise_the_disks(error: Exception) -> None:
    if isinstance(error, OSError) and error.errno:  # not Arrow's
        raise error


def _checksum(batch: pa.RecordBatch) -> int:
    found = zlib.crc32(repr(batch.schema.names).encode())
    for column in batch.columns:
        values = column.to_numpy(zero_copy_only=False)
        found = zlib.crc32(repr(values.tolist()).encode() if values.dtype == object else values.tobytes(), found)
    return found
