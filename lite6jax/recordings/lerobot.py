"""LeRobot data sets: a folder with `meta/info.json` and Parquet files whose state is a list of numbers a frame."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from lite6jax.errors import InputError
from lite6jax.recordings.columns import Column
from lite6jax.recordings.naming import unit_of
from lite6jax.recordings.raw import RawTable, is_list, parquet_schema, read_parquet, within
from lite6jax.recordings.table import Loaded, no_numbers
from lite6jax.storage import read_text

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
    """The units of a feature's numbers as they stand behind names, ` [degrees]`; empty where unstated."""
    info = feature.get("info")
    stated = [of.get(key) for of in (feature, info if isinstance(info, dict) else {}) for key in ("units", "unit")]
    units = next((unit for unit in stated if isinstance(unit, str | list)), "")
    units = [units] * size if isinstance(units, str) else units
    return [f" [{unit}]" if unit_of(f"x [{unit}]") else "" for unit in units] if len(units) == size else [""] * size
