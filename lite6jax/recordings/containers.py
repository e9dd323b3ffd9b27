"""Files of named arrays and of samples one after the other: HDF5, NumPy, MATLAB, workbooks, JSON, YAML, OpenCV's
storage and topics of ROS as they are echoed. Each is read by its own library: one function from a path to columns.
"""

import csv
import io
import json
import re
import zipfile
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lite6jax.array_types import AnyArray
from lite6jax.errors import InputError
from lite6jax.recordings.arrays import LARGEST, WIDEST, tabulate_arrays
from lite6jax.recordings.parquet import one_line
from lite6jax.recordings.table import RawTable
from lite6jax.recordings.texts import open_text
from lite6jax.storage import YAML_SIZE_LIMIT, parse_yaml, read_text

TEXT_LIMIT = 1 << 26
"""Bytes of a document, and of all that a workbook holds once it is unpacked."""
_EPISODE = re.compile(r"(?:^|/)((?:demo|episode|traj|trajectory|ep|seq|rollout)_?(\d+))(?=/)", re.IGNORECASE)
_HDF5_MARK = b"\x89HDF\r\n\x1a\n"


def require_library(module: str, extra: str, path: Path, kind: str) -> Any:
    """A library that is an extra.

    Raises:
        InputError: it is missing; with the command that installs it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise InputError(f"{path}: {kind} takes the package {package}; pip install 'lite6jax[{extra}]'") from error


@contextmanager
def refuse_damage(path: Path, kind: str) -> Iterator[None]:
    """Within, whatever a library raises of damaged bytes is one line."""
    try:
        yield
    except InputError:
        raise
    except (MemoryError, RecursionError) as error:
        raise InputError(f"{path}: is too large or too deep for {kind}; write the part that is needed") from error
    except Exception as error:  # libraries raise whatever the damaged bytes lead to
        problem = one_line(f"{type(error).__name__} {error}")
        raise InputError(f"{path}: is no {kind}, truncated or damaged ({problem}); write it again") from error


def _require_size(numbers: int, path: Path) -> None:
    if numbers > LARGEST:
        raise InputError(
            f"{path}: its arrays have {numbers} numbers, and {LARGEST} are read; write the part that is needed"
        )


# ------------------------------------------------------------------ arrays


class _Episode(NamedTuple):
    """Where a data set of HDF5 is: in which episode, numbered, and by what name there."""

    number: int
    name: str


def read_hdf5(path: Path, notes: list[str]) -> RawTable:
    """The data sets of an HDF5 file, as of ALOHA, robomimic and AgiBot; episodes one after the other."""
    h5py = require_library("h5py", "hdf5", path, "HDF5")
    episodes: defaultdict[int, dict[str, AnyArray]] = defaultdict(dict)
    with refuse_damage(path, "HDF5 file"), h5py.File(path, "r") as file:
        sets: dict[str, Any] = {}
        # what lies in other files is not read
        file.visititems(
            lambda name, dataset: (
                sets.update({name: dataset})
                if isinstance(dataset, h5py.Dataset) and not dataset.is_virtual and not dataset.external
                else None
            )
        )
        small = {
            name: dataset
            for name, dataset in sets.items()
            if dataset.ndim
            and _is_narrow(dataset.shape)
            and dataset.dtype.names is None
            and not _is_derived(name, sets)
        }
        _require_size(sum(dataset.size for dataset in small.values()), path)
        for name, dataset in small.items():
            episode = _episode_of(name)
            episodes[episode.number][episode.name] = dataset[()]
        left_out = [name.replace("/", ".") for name in sets if name not in small]
    if left_out:
        notes.append(f"left out, as they are no columns: {', '.join(left_out[:4])}{', …' * (len(left_out) > 4)}")
    if len(episodes) < 2:
        return tabulate_arrays(next(iter(episodes.values()), {}), str(path), notes)
    return _concatenate(dict(sorted(episodes.items())), path, notes)


def _is_narrow(shape: Sequence[int]) -> bool:
    """Tells whether an array has at most as many numbers as a sample may have, for the longest of its axes."""
    return int(np.prod(shape, dtype=object)) <= WIDEST * max(shape)


def _is_derived(name: str, names: Collection[str]) -> bool:
    """Tells whether an array is the sine or cosine of another one, as robomimic keeps of joint positions."""
    base, _, function = name.rpartition("_")
    return function in ("sin", "cos") and base in names


def _episode_of(name: str) -> _Episode:
    match = _EPISODE.search(name)
    if match is None:
        return _Episode(-1, name.replace("/", "."))
    return _Episode(int(match[2]), name[match.end() + 1 :].replace("/", "."))


def _concatenate(episodes: Mapping[int, Mapping[str, AnyArray]], path: Path, notes: list[str]) -> RawTable:
    """Episodes that have the same arrays, one after the other, numbered in a column `episode`."""
    parts = {number: arrays for number, arrays in episodes.items() if number >= 0}
    first = next(iter(parts.values()))
    names = [name for name in first if all(name in arrays for arrays in parts.values())]
    lengths = {number: max((len(arrays[name]) for name in names), default=0) for number, arrays in parts.items()}
    concatenated = {
        name: np.concatenate([arrays[name] for arrays in parts.values()])
        for name in names
        if all(
            len(arrays[name]) == lengths[number] and arrays[name].shape[1:] == first[name].shape[1:]
            for number, arrays in parts.items()
        )
    }
    notes.append(f"{len(parts)} episodes are read one after the other, as the column 'episode' says")
    counted = np.repeat([*lengths], [*lengths.values()])
    return tabulate_arrays(concatenated | {"episode": counted}, str(path), notes)


def read_numpy(path: Path, notes: list[str]) -> RawTable:
    """The arrays of a `.npz`, or the one of a `.npy`, whose columns have names only where it is structured."""
    with refuse_damage(path, "NumPy file"):
        with open(path, "rb") as file:
            if file.read(4) == b"PK\x03\x04":
                with zipfile.ZipFile(path) as packed:
                    _require_size(sum(member.file_size for member in packed.infolist()) // 8, path)
            else:
                file.seek(0)
                version = np.lib.format.read_magic(file)
                header = (
                    np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                )
                _require_size(int(np.prod(header(file)[0], dtype=object)), path)
        loaded = np.load(path, allow_pickle=False)
        arrays = dict(loaded) if isinstance(loaded, np.lib.npyio.NpzFile) else {"": loaded}
    alone = arrays.get("")
    if alone is not None and alone.dtype.names is None:
        if alone.ndim != 2 or alone.dtype.kind not in "iuf" or not 0 < alone.shape[1] <= WIDEST:
            shape = " x ".join(map(str, alone.shape))
            raise InputError(f"{path}: holds an array {shape} of {alone.dtype}; save (sample, column) of numbers")
        columns = {f"column_{k + 1}": column for k, column in enumerate(alone.astype(float).T)}
        return RawTable.of_arrays(columns)._replace(nameless=True)
    if alone is not None:
        arrays = {name: alone[name] for name in alone.dtype.names or ()}
    return tabulate_arrays(arrays, str(path), notes)


def read_matlab(path: Path, notes: list[str]) -> RawTable:
    """The arrays and structs of a `.mat`, of any version."""
    with open(path, "rb") as file:
        start = file.read(1024)
    if _HDF5_MARK in start:  # version 7.3
        return read_hdf5(path, notes)
    from scipy.io import loadmat, whosmat

    with refuse_damage(path, "MATLAB file"):
        listed = [(name, shape) for name, shape, _ in whosmat(path)]
        _require_size(sum(int(np.prod(shape, dtype=object)) for _, shape in listed), path)
        loaded = loadmat(path, variable_names=[name for name, _ in listed], simplify_cells=True)
        arrays = dict(_walk({name: value for name, value in loaded.items() if not name.startswith("__")}))
    return tabulate_arrays(arrays, str(path), notes)


# ------------------------------------------------------------------ workbooks


def read_workbook(path: Path, notes: list[str]) -> RawTable:
    """The sheet of a workbook that holds most numbers, as a table of text."""
    openpyxl = require_library("openpyxl", "excel", path, "a workbook")
    with refuse_damage(path, "workbook"):
        with zipfile.ZipFile(path) as packed:
            unpacked = sum(member.file_size for member in packed.infolist())
        if unpacked > TEXT_LIMIT:
            raise InputError(f"{path}: is {unpacked} bytes once it is unpacked; save its sheet as CSV")
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheets = {sheet.title: [list(row) for row in sheet.iter_rows(values_only=True)] for sheet in book.worksheets}
        book.close()

    def count_numbers(title: str) -> int:
        return sum(isinstance(cell, int | float) for row in sheets[title] for cell in row)

    title = max(sheets, key=count_numbers, default=None)
    if title is None or not count_numbers(title):
        raise InputError(f"{path}: no sheet holds numbers; name the workbook that was measured")
    if len(sheets) > 1:
        unread = ", ".join(repr(sheet_title) for sheet_title in sheets if sheet_title != title)
        notes.append(f"the sheet {title!r} is read, and not {unread}")
    written = io.StringIO()
    rows = csv.writer(written, lineterminator="\n")
    for row in sheets[title]:
        rows.writerow([cell.isoformat() if hasattr(cell, "isoformat") else cell for cell in row])
    return open_text(path, notes, content=written.getvalue().encode())


# ------------------------------------------------------------------ documents


def read_document(path: Path, notes: list[str]) -> RawTable:
    """Samples in JSON or YAML: a list of records, or a list for each quantity."""
    if path.suffix.lower() == ".json":
        text = read_text(path, TEXT_LIMIT)
        with refuse_damage(path, "JSON"):
            content = json.loads(text)
    else:
        content = parse_yaml(read_text(path, YAML_SIZE_LIMIT), path)
    with refuse_damage(path, "list of samples"):
        arrays = dict(_walk(content))
    return tabulate_arrays(arrays, str(path), notes)


def _walk(value: Any, name: str = "") -> Iterator[tuple[str, AnyArray]]:
    """The arrays in nested mappings and lists; a list of records is an array for each of their keys."""
    if isinstance(value, Mapping):
        for key, member in value.items():
            yield from _walk(member, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list) and value and all(isinstance(record, Mapping) for record in value):
        keys = dict.fromkeys(key for record in value for key in record)
        for key in keys:
            members = [record.get(key) for record in value]
            if all(member is not None for member in members):
                yield from _walk(members, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list | np.ndarray) and len(value):
        try:
            yield name, np.asarray(value)
        except ValueError:  # lists of unequal length
            return


def read_file_storage(path: Path, notes: list[str]) -> RawTable:
    """The matrices of OpenCV's storage, in YAML, XML or JSON."""
    cv2 = require_library("cv2", "camera", path, "OpenCV's storage")
    read_text(path, TEXT_LIMIT)
    with refuse_damage(path, "storage of OpenCV"):
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        arrays = dict(_walk({key: _node(storage.getNode(key)) for key in storage.root().keys()}))  # noqa: SIM118
        storage.release()
    return tabulate_arrays(arrays, str(path), notes)


def _node(node: Any) -> Any:
    """What a node of OpenCV's storage holds: a matrix, numbers, text, or a list or mapping of these."""
    if node.isMap():
        keys = node.keys()
        if {"rows", "cols", "data"} <= {*keys}:
            return np.asarray(node.mat())
        return {key: _node(node.getNode(key)) for key in keys}
    if node.isSeq():
        members = [_node(node.at(k)) for k in range(node.size())]
        return np.stack(members) if members and isinstance(members[0], np.ndarray) else members
    return node.real() if node.isReal() or node.isInt() else node.string()


# ------------------------------------------------------------------ topics of ROS, echoed


def read_echo(path: Path, notes: list[str]) -> RawTable:
    """The messages of `rostopic echo` or `ros2 topic echo`, a row each; of transforms the columns of each frame.

    Numbers of a message that names them, as joint states do, are called by these names. The last message may be cut
    off, and is then left out.
    """
    rows: list[dict[str, Any]] = []
    messages = [part for part in re.split(r"(?m)^---\s*$", read_text(path, TEXT_LIMIT)) if part.strip()]
    for number, message in enumerate(messages, 1):
        try:
            content = parse_yaml(message, path)
            flat = dict(_message_columns(content))
        except (InputError, RecursionError) as error:
            if number == len(messages) and rows:
                notes.append("the last message is cut off and left out")
                break
            raise InputError(
                f"{path}: message {number} is no YAML ({one_line(error)}); echo the topic again"
            ) from error
        rows.append(flat)
    if len(rows) > 1 and not set.intersection(*map(set, rows[:-1])) <= set(rows[-1]):
        notes.append("the last message is cut off and left out")
        rows.pop()
    names = list(dict.fromkeys(name for row in rows for name in row))
    _require_size(len(names) * len(rows), path)
    columns = {name: np.array([row.get(name, np.nan) for row in rows], float) for name in names}
    if not columns:
        raise InputError(f"{path}: its messages hold no numbers; echo a topic of joint states or poses")
    return RawTable.of_arrays(columns)


def _message_columns(message: Any) -> Iterator[tuple[str, float]]:
    """The numbers of a message, by the way to them."""
    if not isinstance(message, Mapping):
        return
    for transform in message.get("transforms") or ():
        frame = str(transform.get("child_frame_id", "")).strip("/") if isinstance(transform, Mapping) else ""
        yield from _numbers_in({"transform": transform.get("transform")} if frame else {}, frame)
        yield from _stamp(transform, "header")
    yield from _stamp(message, "header")
    fields = {key: value for key, value in message.items() if key not in ("header", "transforms", "name")}
    names = message.get("name", message.get("joint_names"))
    yield from _numbers_in(fields, "", [str(name) for name in names] if isinstance(names, list) else ())


def _numbers_in(value: Any, name: str, joints: Sequence[str] = ()) -> Iterator[tuple[str, float]]:
    """The numbers of nested mappings and lists of at most `WIDEST`; those of as many joints by their names."""
    if isinstance(value, list) and joints and len(value) == len(joints):
        value = dict(zip(joints, value, strict=True))
    if isinstance(value, Mapping):
        for key, member in value.items():
            yield from _numbers_in(member, f"{name}.{key}" if name else str(key), joints)
    elif isinstance(value, list) and len(value) <= WIDEST:
        for k, member in enumerate(value):
            yield from _numbers_in(member, f"{name}[{k}]")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield name, float(value)


def _stamp(message: Any, key: str) -> Iterator[tuple[str, float]]:
    """The stamp of a header, in seconds: ROS 1 writes secs and nsecs, ROS 2 sec and nanosec."""
    header = message.get(key) if isinstance(message, Mapping) else None
    stamp = header.get("stamp") if isinstance(header, Mapping) else None
    if not isinstance(stamp, Mapping):
        return
    seconds, part = (
        stamp.get(ros2_key, stamp.get(ros1_key)) for ros2_key, ros1_key in (("sec", "secs"), ("nanosec", "nsecs"))
    )
    if isinstance(seconds, int | float) and isinstance(part, int | float):
        yield f"{key}.stamp [s]", float(seconds) + 1e-9 * float(part)
