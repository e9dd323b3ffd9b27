"""Tables of columns with any names, read when they are asked for: Parquet, growing streams, LeRobot's data sets."""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pa_compute
import pyarrow.parquet as pa_parquet

from lite6jax.errors import InputError, command_line
from lite6jax.recordings.columns import IGNORED, Column
from lite6jax.recordings.naming import unit_of
from lite6jax.recordings.table import Loaded, clock_times, holds_clock_times, no_numbers
from lite6jax.storage import read_text

LONGEST_LIST = 64
"""Numbers in a list that are a column each; longer ones, such as pictures, are none."""
_SAMPLE = 1000
"""Rows by which the length of lists is found."""
Load = Callable[[Mapping[str, Column]], Loaded]


class RawTable(NamedTuple):
    """The columns of a file or folder.

    Attributes:
        names: of all columns, in order.
        load: the values of some, by any keys: of each an array, or what is wrong with it.
        nameless: whether the file names no column, so that they are `column_1`, `column_2`, ….
        assumed: names whose unit the file does not state.
    """

    names: Sequence[str]
    load: Load
    nameless: bool = False
    assumed: tuple[str, ...] = ()

    def renamed(self, source: str, given: Mapping[str, str], in_order: str = "") -> dict[str, str]:
        """The names that columns are to have, by those that they have in the table.

        Args:
            source: what messages begin with.
            given: by the name of a column, or by the part of it before its unit, ` [mm]`, where that is of one alone.
            in_order: of a table without names, the names of all columns between commas, empty for `IGNORED`.

        Raises:
            InputError: a table without names gets none, or not one for each column; or a table has them already.
        """
        listed = [name.strip() or IGNORED for name in in_order.split(",")] if in_order else []
        if listed and not self.nameless:
            raise InputError(f"{source}: names its columns already; say what they are by --column NAME=MEANING")
        if listed and len(listed) != len(self.names):
            raise InputError(
                f"{source}: --names gives {len(listed)} names for {len(self.names)} columns; give each one"
            )
        if self.nameless and not (listed or given):
            command = command_line("init", source, "--names", "q1_deg,q2_deg,...")
            raise InputError(f"{source}: its first row holds numbers, and no line names the columns; `{command}` does")
        of_part: dict[str, list[str]] = {}
        for name in self.names:
            of_part.setdefault(re.sub(r" \[[^\[\]]*\]$", "", name), []).append(name)
        found = {}
        for name, meaning in given.items():
            alike = [] if name in self.names else of_part.get(name, [])
            found[alike[0] if len(alike) == 1 else name] = meaning
        return dict(zip(self.names, listed, strict=False)) | found

    def numbers(self) -> Iterator[tuple[str, np.ndarray | None]]:
        """Every column with `(sample,)` float64, NaN where empty; None where it does not hold numbers.

        Of clock times the numbers are seconds since 1970.
        """
        every = {str(k): Column(name.strip(), k, "time", 0, "s", 1.0) for k, name in enumerate(self.names)}
        loaded = self.load(every)
        for key, column in every.items():
            values = loaded[key]
            if not isinstance(values, str) and holds_clock_times(values.type):
                times = clock_times(values)
                yield column.name, None if isinstance(times, str) else times.start + times.seconds
                continue
            array = None if isinstance(values, str) else values.cast(pa.float64(), safe=False)
            yield column.name, None if array is None else array.to_numpy(zero_copy_only=False)


def of_arrays(values: Mapping[str, np.ndarray], assumed: Sequence[str] = ()) -> RawTable:
    """Columns in memory; the units in the names `assumed` are."""
    names = list(values)

    def load(columns: Mapping[str, Column]) -> Loaded:
        return {key: pa.array(values[names[column.index]]) for key, column in columns.items()}

    return RawTable(names, load, assumed=tuple(assumed))


def of_stream(path: Path, notes: list[str]) -> RawTable:
    """The table of a recording that is being written.

    Raises:
        InputError: as `read_stream`.
    """
    table = read_stream(path, notes)

    def load(columns: Mapping[str, Column]) -> Loaded:
        return {
            key: no_numbers(table.schema.field(column.index).type, column.quantity) or table.column(column.index)
            for key, column in columns.items()
        }

    return RawTable(table.column_names, load)


def of_parquet(path: Path) -> RawTable:
    """The table of a Parquet file; only the columns asked for are read.

    Members of structs and elements of lists are a column each: `pose.position.x`, `q[0]`.

    Raises:
        InputError: damaged, or another kind of file; here and in `load`.
    """
    schema = parquet_schema(path)
    nested = [field.name for field in schema if field.type.num_fields]
    first = _parquet(path, lambda file: next(file.iter_batches(_SAMPLE, columns=nested), None)) if nested else None
    leaves = [
        leaf
        for field in schema
        for leaf in _leaves(
            field.name, first[field.name] if first is not None and field.name in nested else pa.nulls(0, field.type)
        )
    ]

    def load(columns: Mapping[str, Column]) -> Loaded:
        loaded: dict[str, pa.Array | pa.ChunkedArray | str] = {}
        wanted = {key: leaves[column.index] for key, column in columns.items()}
        for key, leaf in wanted.items():
            loaded[key] = no_numbers(leaf.kind, columns[key].quantity)
        names = dict.fromkeys(leaf.path[0] for key, leaf in wanted.items() if not loaded[key])
        table = read_parquet(path, [*map(str, names)])
        for key, leaf in wanted.items():
            top, *parts = leaf.path
            loaded[key] = loaded[key] or within(table.column(table.column_names.index(str(top))), parts)
        return loaded

    return RawTable([leaf.name for leaf in leaves], load)


class _Leaf(NamedTuple):
    """Numbers within the structs and lists of a column: their name, the way to them, and their type."""

    name: str
    path: tuple[str | int, ...]
    kind: pa.DataType


def _leaves(name: str, values: pa.Array, path: tuple[str | int, ...] = ()) -> Iterator[_Leaf]:
    """What a column holds, by its first rows."""
    path, kind = path or (name,), values.type
    if pa.types.is_struct(kind):
        for field in kind:
            yield from _leaves(f"{name}.{field.name}", within(values, [field.name]), (*path, field.name))
        return
    first = values.drop_null()[:1] if is_list(kind) else values[:0]
    size = len(first[0]) if len(first) else 0
    if not 0 < size <= LONGEST_LIST:
        yield _Leaf(name, path, kind)
    for part in range(size if size <= LONGEST_LIST else 0):
        yield from _leaves(f"{name}[{part}]" if size > 1 else name, within(first, [part]), (*path, part))


def is_list(kind: pa.DataType) -> bool:
    """Whether the values of a type are lists."""
    return pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind)


def within(values: Any, path: Sequence[str | int]) -> Any:
    """What stands in a column under these names of members and numbers of elements; or what is wrong with its lists."""
    for part in path:
        if isinstance(part, str):
            values = pa_compute.call_function("struct_field", [values], pa_compute.StructFieldOptions([part]))
            continue
        sizes = pa_compute.call_function("min_max", [pa_compute.call_function("list_value_length", [values])])
        least, most = sizes["min"].as_py(), sizes["max"].as_py()
        if least is not None and least != most:
            return f"its lists hold {least} to {most} numbers; give each row as many"
        values = pa_compute.call_function("list_element", [values, part])
    return values


def parquet_schema(path: Path) -> pa.Schema:
    """The columns of a Parquet file.

    Raises:
        InputError: as `read_parquet`.
    """
    return _parquet(path, lambda file: file.schema_arrow)


def read_parquet(path: Path, columns: Sequence[str]) -> pa.Table:
    """Columns of a Parquet file, its checksums verified.

    Raises:
        InputError: a name that is not UTF-8, damaged, or another kind of file.
    """
    return _parquet(path, lambda file: file.read(columns=list(columns)))


def _parquet(path: Path, read: Callable[[pa_parquet.ParquetFile], Any]) -> Any:
    try:
        with pa_parquet.ParquetFile(path, page_checksum_verification=True) as file:
            return read(file)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: a column name is not UTF-8; write the file again with other names") from error
    except (pa.ArrowException, OSError) as error:
        if isinstance(error, OSError) and error.errno:  # the disk's refusal, not Parquet's
            raise
        with open(path, "rb") as content:
            start = content.read(4)
        problem = "is truncated or damaged" if start == b"PAR1" else "is not Parquet, whatever its name says"
        raise InputError(f"{path}: {problem} ({one_line(error)}); write it again") from error


def one_line(error: object) -> str:
    """What a library says of a file, shortened."""
    text = " ".join(str(error).split())
    return text if len(text) <= 120 else f"{text[:117]}..."


# ------------------------------------------------------------------ recordings that grow


SUFFIX = ".arrows"
_UNREADABLE = (pa.ArrowException, OSError, ValueError)  # ValueError: names that are not UTF-8
_OPTIONS = pa.ipc.IpcWriteOptions(compression="zstd")


def stream_path(recording: str | Path) -> Path:
    """Where the rows of a Parquet recording stand until it is complete: the same stem, `.arrows`."""
    return Path(recording).with_suffix(SUFFIX)


def stream_start(schema: pa.Schema) -> bytes:
    """The bytes with which a stream begins."""
    return schema.serialize().to_pybytes()


def stream_batch(batch: pa.RecordBatch) -> bytes:
    """The bytes of a batch within a stream."""
    sink = pa.BufferOutputStream()
    writer = pa.ipc.new_stream(sink, batch.schema, options=_OPTIONS)
    writer.write_batch(batch)
    start, end = len(stream_start(batch.schema)), sink.tell()
    writer.close()
    return sink.getvalue()[start:end].to_pybytes()


def stream_batches(path: Path, notes: list[str]) -> Iterator[pa.RecordBatch]:
    """The whole batches of a stream, in order.

    Args:
        path: of the stream.
        notes: gets a sentence where the last batch was cut short, which is left out.

    Raises:
        InputError: not such a stream, or more than its last batch cannot be read.
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
                batch = reader.read_next_batch()
                batch.validate(full=True)
            except StopIteration:  # zeros, of a file that the disk had made longer but not filled
                break
            except _UNREADABLE as error:
                _reraise_the_disks(error)
                break
            number += 1
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


def _reraise_the_disks(error: Exception) -> None:
    if isinstance(error, OSError) and error.errno:  # not Arrow's
        raise error


# ------------------------------------------------------------------ LeRobot's data sets


INFO = Path("meta") / "info.json"
_INFO_LIMIT = 1 << 22


def of_lerobot(folder: Path) -> RawTable:
    """The frames of all episodes in order; a feature of several numbers is a column for each, by its own names.

    A unit that `info.json` states stands behind the name of the column.

    Args:
        folder: of versions 2 and 3: `meta/info.json`, and the frames in `data/**/*.parquet`.

    Raises:
        InputError: `info.json` is none of a data set, there are no Parquet files, or they lack its features.
    """
    features = _features(folder / INFO)
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise InputError(f"{folder}: has no Parquet files below data; fetch the whole data set (by `git lfs pull`)")
    kinds = parquet_schema(files[0])
    columns: list[tuple[str, str, int | None]] = []
    for name in kinds.names:
        size = _size(features.get(name, {}))
        if is_list(kinds.field(name).type):
            parts, units = _parts(features.get(name, {}), size), _units(features.get(name, {}), size)
            named = enumerate(zip(parts, units, strict=True))
            columns += [(f"{name}.{part}{unit}", name, k) for k, (part, unit) in named]
        else:
            columns.append((name, name, None))

    def load(wanted: Mapping[str, Column]) -> Loaded:
        chosen = {key: columns[column.index] for key, column in wanted.items()}
        names = list(dict.fromkeys(name for _, name, _ in chosen.values()))
        table = pa.concat_tables([_read(path, names) for path in files])
        return {key: _part(table[name], k) for key, (_, name, k) in chosen.items()}

    return RawTable([name for name, _, _ in columns], load)


def _read(path: Path, names: Sequence[str]) -> pa.Table:
    lacking = set(names) - set(parquet_schema(path).names)
    if lacking:
        raise InputError(f"{path}: lacks the column {min(lacking)} of the other episodes; restore the file")
    return read_parquet(path, names)


def _part(column: pa.ChunkedArray, index: int | None) -> pa.ChunkedArray | str:
    """One number of a list, or the column itself."""
    part = within(column, [] if index is None else [index])
    return part if isinstance(part, str) else no_numbers(part.type, "") or part


def _features(path: Path) -> Mapping[str, Mapping[str, Any]]:
    try:
        content = json.loads(read_text(path, _INFO_LIMIT))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is not JSON; restore the file") from error
    features = content.get("features") if isinstance(content, dict) else None
    if not isinstance(features, dict) or not all(isinstance(feature, dict) for feature in features.values()):
        raise InputError(f"{path}: names no features, so it is of no LeRobot data set of version 2 or 3")
    return features


def _size(feature: Mapping[str, Any]) -> int:
    shape = feature.get("shape")
    return int(shape[0]) if isinstance(shape, list) and len(shape) == 1 and isinstance(shape[0], int) else 0


def _parts(feature: Mapping[str, Any], size: int) -> list[str]:
    """The names of a feature's numbers, which data sets give as a list or below a heading; else 0, 1, …."""
    names = feature.get("names")
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    if isinstance(names, list) and len(names) == size and all(isinstance(name, str) for name in names):
        return [*map(str, names)] if len(set(names)) == size else [str(k) for k in range(size)]
    return [str(k) for k in range(size)]


def _units(feature: Mapping[str, Any], size: int) -> list[str]:
    """The suffix of a feature's names with their unit, ` [degrees]`; empty where none is stated."""
    info = feature.get("info")
    stated = [of.get(key) for of in (feature, info if isinstance(info, dict) else {}) for key in ("units", "unit")]
    units = next((unit for unit in stated if isinstance(unit, str | list)), "")
    units = [units] * size if isinstance(units, str) else units
    return [f" [{unit}]" if unit_of(f"x [{unit}]") else "" for unit in units] if len(units) == size else [""] * size
