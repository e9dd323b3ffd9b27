"""What the name of a recording names: the kind of its file or folder, its table, and what helps where it is none."""

import os
import re
from collections.abc import Sequence
from pathlib import Path

from lite6jax.errors import InputError, command_line
from lite6jax.recordings import raw, stream
from lite6jax.recordings.csv_tables import of_csv
from lite6jax.recordings.lerobot import INFO, of_lerobot
from lite6jax.recordings.raw import RawTable, one_line
from lite6jax.recordings.ros import METADATA, ArmJoints, read_bag
from lite6jax.storage import check_readable, exists

LOGS = (".mcap", ".db3", ".bag")
TEXTS = (".csv", ".tsv", ".txt", ".dat", ".log")
TABLES = (*TEXTS, ".parquet")
SUFFIXES = (*TABLES, stream.SUFFIX, *LOGS)
"""Of the files that are recordings."""
KINDS = "a recording ends in .csv, .txt, .parquet or .mcap, or is the folder of a rosbag2 or of a LeRobot data set"
_LOG = re.compile(r"(.+(?:\.mcap|\.db3|\.bag))#(.*)", re.IGNORECASE | re.DOTALL)
_ARMS = (".urdf", ".xacro", ".xml", ".mjcf")
_EXCEL = (".xlsx", ".xls", ".xlsm", ".ods")
_ARRAYS = (".npy", ".npz", ".mat", ".h5", ".hdf5", ".pkl", ".pickle", ".feather")


def split_topics(path: str | Path) -> tuple[Path, tuple[str, ...]]:
    """The file or folder and the topics of `run.mcap#/joint_states,/pose`; no topics where none are named."""
    file, topics = str(path), ""
    if match := _LOG.fullmatch(file):
        file, topics = match.groups()
    elif "#/" in file and os.path.isdir(file.partition("#/")[0]):
        file, _, topics = file.partition("#")
    return Path(file), tuple(filter(None, (topic.strip() for topic in topics.split(","))))


def recording_file(path: str | Path) -> Path | None:
    """The file or folder that a recording's name names, without topics; None where it is no recording's name."""
    file, _ = split_topics(path)
    return file if file.suffix.lower() in SUFFIXES or _is_bag(file) or _is_lerobot(file) else None


def is_log(path: Path) -> bool:
    """Whether a file or folder is a log of ROS."""
    return path.suffix.lower() in LOGS or _is_bag(path)


def open_table(
    path: Path, topics: Sequence[str], of_arm: ArmJoints, notes: list[str], kinds: Sequence[str] = SUFFIXES
) -> tuple[Path, RawTable]:
    """The table of a recording and where it is: of a Parquet file that was not completed, the stream of its stem.

    Args:
        path: the file or folder.
        topics: of a log, as in `ros.read_log`.
        of_arm: the joints of the arm, as far as known, of which a log says less than a table.
        notes: what was chosen, assumed and dropped is added here.
        kinds: the suffixes accepted.

    Raises:
        InputError: not there, of another kind (with what helps), or as the reader of its kind.
    """
    suffix = path.suffix.lower()
    if suffix == ".parquet" and not exists(path) and exists(growing := stream.stream_path(path)):
        notes.append(f"the recording was ended before it was complete; its rows are those of {growing.name}")
        path, suffix = growing, stream.SUFFIX
    try:
        if os.path.isdir(path) and set(LOGS) <= set(kinds) and suffix not in SUFFIXES:
            return path, _of_folder(path, topics, of_arm, notes)
        if not suffix and not exists(path):
            raise InputError(f"{path}: no such file or folder; check the name")
        if suffix not in kinds:
            raise InputError(f"{path}: {stranger(path) or _other(kinds)}")
        check_readable(path)
        if suffix in LOGS:
            return path, _of_log(path, topics, of_arm, notes)
        if suffix == ".parquet":
            return path, raw.of_parquet(path)
        return path, of_csv(path, notes) if suffix in TEXTS else raw.of_stream(path, notes)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({one_line(error.strerror or error)}); check the file") from error


def _of_log(path: Path, topics: Sequence[str], of_arm: ArmJoints, notes: list[str]) -> RawTable:
    """The table of a log, in whose joint states nothing says the unit of efforts."""
    columns = read_bag(path, topics, of_arm, notes)
    return raw.of_arrays(columns, [name for name in columns if name.startswith("tau")])


def _other(kinds: Sequence[str]) -> str:
    if set(LOGS) <= set(kinds):
        return f"{KINDS}; convert it or correct the name"
    return "targets end in .csv or .parquet; convert it or correct the name"


def stranger(path: str | Path) -> str:
    """What helps where a file or folder is of a kind that people take for a recording's; empty for every other."""
    path = Path(str(path).partition("#")[0])
    suffix, name = path.suffix.lower(), path.name
    if os.path.isdir(path):
        return _of_no_recording(path)
    if suffix in _ARMS:
        return f"describes an arm and holds no measurements; name a recording, and the arm with --arm {name}"
    if suffix in _EXCEL:
        table = path.with_suffix(".csv")
        return f"is a workbook; save its sheet as CSV (UTF-8), and name its columns by `{command_line('init', table)}`"
    if suffix in _ARRAYS:
        return f"is no recording; write it as {path.stem}.csv or .parquet with a name for each column"
    return ""


def _of_folder(path: Path, topics: Sequence[str], of_arm: ArmJoints, notes: list[str]) -> RawTable:
    if _is_lerobot(path):
        return of_lerobot(path)
    if exists(path / METADATA):
        return _of_log(path, topics, of_arm, notes)
    logs = _logs(path)
    if len(logs) == 1:  # a recorder that was ended writes no metadata
        return _of_log(logs[0], topics, of_arm, notes)
    if logs:
        raise InputError(f"{path}: a rosbag2 without {METADATA}; write that with `ros2 bag reindex {path.name}`")
    raise InputError(f"{path}: {_of_no_recording(path)}")


def _of_no_recording(path: Path) -> str:
    tables = sorted(file.name for file in path.iterdir() if file.suffix.lower() in (".csv", ".parquet", ".mcap"))
    if not tables:
        return (
            "is a folder without a recording: no rosbag2 (metadata.yaml and .db3 or .mcap), no LeRobot data set "
            "(meta/info.json), no table; name the file of a recording"
        )
    all_of_them = command_line("fleet", path)
    return f"is a folder; name a file in it, such as {tables[0]}, or fit all of them with `{all_of_them}`"


def _is_lerobot(path: Path) -> bool:
    return exists(path / INFO)


def _is_bag(path: Path) -> bool:
    return os.path.isdir(path) and (exists(path / METADATA) or bool(_logs(path)))


def _logs(path: Path) -> list[Path]:
    return sorted(file for file in path.iterdir() if file.suffix.lower() in (".db3", ".mcap"))
