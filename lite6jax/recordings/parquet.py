"""Tables of Parquet files and LeRobot's data sets, whose columns are read when they are asked for."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pyarrow as pa
import pyarrow.compute as pa_compute
import pyarrow.parquet as pa_parquet
from pyarrow import types

from lite6jax.errors import InputError
from lite6jax.recordings.columns.names import unit_of
from lite6jax.recordings.table import RawTable, Values
from lite6jax.storage import exists, read_text

LONGEST_LIST = 64
"""Numbers in a list that are a column each; longer ones, such as pictures, are none."""
_SAMPLE = 1000
"""Rows by which the length of lists is found."""
Named = Callable[[str, int, int], str]
"""The name of an element of a list: by the list's name, its place, and how many there are."""


class _Leaf(NamedTuple):
    """Numbers within the structs and lists of a column: their name, and the way to them."""

    name: str
    path: tuple[str | int, ...]


def _name_element(name: str, place: int, size: int) -> str:
    return f"{name}[{place}]" if size > 1 else name


def open_parquet(*paths: Path, name_leaf: Named = _name_element) -> RawTable:
    """The table of a Parquet file, or of several one after the other; only the columns asked for are read.

    Members of structs and elements of lists are a column each: `pose.position.x`, `q[0]`.

    Raises:
        InputError: damaged, or another kind of file, or one without a column of the first; here and in `load`.
    """

    with _opened(paths[0]) as file:
        fields = list(file.schema_arrow)
        lists = [field.name for field in fields if "list<" in str(field.type)]
        first = next(file.iter_batches(_SAMPLE, columns=lists), None) if lists else None
    sampled = {} if first is None else dict(zip(first.schema.names, first.columns, strict=True))
    starts = [(field.name, sampled.get(field.name, pa.nulls(0, field.type))) for field in fields]
    leaves = [leaf for name, values in starts for leaf in _leaves(name, values, (name,), name_leaf)]

    def load(quantities: Mapping[int, str]) -> dict[int, Values]:
        names = list(dict.fromkeys(str(leaves[index].path[0]) for index in quantities))
        parts = []
        for path in paths:
            with _opened(path) as file:
                if lacking := set(names) - set(file.schema_arrow.names):
                    raise InputError(f"{path}: lacks the column {min(lacking)} of the other episodes; restore the file")
                parts.append(file.read(columns=names))
        table = pa.concat_tables(parts)
        places = {
            index: table.column_names.index(str(leaves[index].path[0])) for index in quantities
        }  # names may be twice
        return {index: _descend(table.column(place), leaves[index].path[1:]) for index, place in places.items()}

    return RawTable([leaf.name for leaf in leaves], load)


def _leaves(name: str, values: pa.Array, path: tuple[str | int, ...], name_leaf: Named) -> Iterator[_Leaf]:
    """What a column holds, by its first rows."""
    kind = values.type
    if types.is_struct(kind):
        for field in kind:
            yield from _leaves(f"{name}.{field.name}", _descend(values, [field.name]), (*path, field.name), name_leaf)
        return
    lists = types.is_list(kind) or types.is_fixed_size_list(kind) or types.is_large_list(kind)
    first = values.drop_null()[:1] if lists else values[:0]
    size = len(first[0]) if len(first) else 0
    if not 0 < size <= LONGEST_LIST:
        yield _Leaf(name, path)
    for part in range(size if size <= LONGEST_LIST else 0):
        yield from _leaves(name_leaf(name, part, size), _descend(first, [part]), (*path, part), name_leaf)


def _descend(values: Any, path: Sequence[str | int]) -> Any:
    """What stands in a column under these names of members and numbers of elements; or what is wrong with its lists."""
    for part in path:
        if isinstance(part, str):
            values = pa_compute.call_function("struct_field", [values], pa_compute.StructFieldOptions([part]))
            continue
        sizes = pa_compute.call_function("min_max", [pa_compute.call_function("list_value_length", [values])])
        shortest = sizes["min"].as_py()
        longest = sizes["max"].as_py()
        if shortest is not None and shortest != longest:
            return f"its lists hold {shortest} to {longest} numbers; give each row as many"
        values = pa_compute.call_function("list_element", [values, part])
    return values


@contextmanager
def _opened(path: Path) -> Iterator[pa_parquet.ParquetFile]:
    """A file whose checksums are verified as it is read."""
    try:
        with pa_parquet.ParquetFile(path, page_checksum_verification=True) as file:
            yield file
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


# ------------------------------------------------------------------ LeRobot's data sets


INFO = Path("meta") / "info.json"
_INFO_LIMIT = 1 << 22
_DEPTH = 2
"""Folders between a data set and its Parquet files: `data/chunk-000`."""


class _Info(msgspec.Struct):
    """What is read here of the meta/info.json of a data set."""

    features: dict[str, dict[str, Any]]


def open_lerobot(folder: Path) -> RawTable:
    """The frames of all episodes in order; a feature of several numbers is a column for each, by its own names.

    A unit that `info.json` states stands behind the name of the column.

    Args:
        folder: of versions 2 and 3: `meta/info.json`, and the frames in `data/**/*.parquet`.

    Raises:
        InputError: `info.json` is none of a data set, there are no Parquet files, or they lack its features.
    """
    features = _features(folder)
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise InputError(f"{folder}: has no Parquet files below data; fetch the whole data set (by `git lfs pull`)")
    return open_parquet(*files, name_leaf=lambda name, place, size: _feature(features.get(name, {}), name, place, size))


def open_part(path: Path) -> RawTable:
    """The table of a Parquet file; of a part of a LeRobot data set, with the names that the data set gives.

    Raises:
        InputError: as `open_parquet`, or as `open_lerobot` of `info.json`.
    """
    folder = next((parent for parent in path.absolute().parents[: _DEPTH + 1] if exists(parent / INFO)), None)
    if folder is None:
        return open_parquet(path)
    features = _features(folder)
    return open_parquet(path, name_leaf=lambda name, place, size: _feature(features.get(name, {}), name, place, size))


def _features(folder: Path) -> dict[str, dict[str, Any]]:
    """The features that `info.json` names."""
    path = folder / INFO
    try:
        return msgspec.convert(json.loads(read_text(path, _INFO_LIMIT)), _Info).features
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: names no features, so it is of no LeRobot data set of version 2 or 3") from error
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is not JSON; restore the file") from error


def _feature(feature: Mapping[str, Any], name: str, place: int, size: int) -> str:
    """The name of a number of a feature, whose names data sets give as a list or below a heading, and its unit."""
    names = feature.get("names")
    info = feature.get("info")
    names = next(iter(names.values()), None) if isinstance(names, dict) else names
    has_names = isinstance(names, list) and len({*map(str, names)}) == size == len(names)
    stated = [of.get(key) for of in (feature, info if isinstance(info, dict) else {}) for key in ("units", "unit")]
    units = next((unit for unit in stated if isinstance(unit, str | list)), "")
    unit = units[place] if isinstance(units, list) and len(units) == size else units
    suffix = f" [{unit}]" if isinstance(unit, str) and unit_of(f"x [{unit}]") else ""
    return f"{name}.{names[place] if has_names else place}{suffix}"  # type: ignore[index]
