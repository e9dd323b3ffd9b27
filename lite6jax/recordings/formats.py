"""The formats of recordings: how each is told from the others, by suffix and content, and the function that reads it.

This is the one table of readers. A reader takes a path and what was asked, and returns named columns; what they mean is
decided by `recordings.columns`. The first format whose suffix and content match is taken.
"""

import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from lite6jax import suffixes
from lite6jax.errors import InputError
from lite6jax.recordings.containers import (
    read_document,
    read_echo,
    read_file_storage,
    read_hdf5,
    read_matlab,
    read_numpy,
    read_workbook,
)
from lite6jax.recordings.parquet import INFO, open_lerobot, open_part
from lite6jax.recordings.programs import holds_program, read_program
from lite6jax.recordings.ros import METADATA, ArmJoints, read_bag
from lite6jax.recordings.table import RawTable
from lite6jax.recordings.texts import open_text
from lite6jax.storage import exists

_START = 1 << 16
"""Bytes of a file by which its content is told."""
_PAIR = re.compile(
    r"gripper2base|base2gripper|target2cam|cam2target|\w_wrt_\w|hand_world|camera_marker|\b(?:tracking|optical)\"?\s*:\s*[{\n]"
)
_RECORDS = re.compile(r"\s*\[\s*\{")
_MESSAGE = re.compile(r"\s*(header|transforms|transform|pose|name|position)\s*:")


class Asked(NamedTuple):
    """What is asked of a reader.

    Attributes:
        notes: what was chosen, assumed and dropped is added here.
        topics: of a log, as in `ros.read_bag`.
        of_arm: the joints of the arm, as far as known, of which a log says less than a table.
        growing: whether a text is of a recording that was not completed.
    """

    notes: list[str]
    topics: Sequence[str] = ()
    of_arm: ArmJoints = ArmJoints()
    growing: bool = False


class Format(NamedTuple):
    """A format of recordings.

    Attributes:
        kind: in words.
        suffixes: of its files.
        read: the columns of a file or folder.
        holds: whether the start of a text is of this format, where other files have these suffixes too.
        is_folder: whether a folder is of this format; None of files.
        is_log: whether it may hold several topics.
    """

    kind: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, Asked], RawTable]
    holds: Callable[[str], bool] | None = None
    is_folder: Callable[[Path], bool] | None = None
    is_log: bool = False

    @property
    def is_table(self) -> bool:
        """Tells whether it is one file with a row for each sample."""
        return not self.is_log and self.is_folder is None


def _is_echo(start: str) -> bool:
    return _MESSAGE.match(start) is not None and re.search(r"^---\s*$", start, re.MULTILINE) is not None


def _is_storage(start: str) -> bool:
    return start.startswith("%YAML:1.0") or "<opencv_storage>" in start or "opencv-matrix" in start


def _is_samples(start: str) -> bool:
    return _RECORDS.match(start) is not None or ('"schema"' not in start and _PAIR.search(start) is not None)


def _logs(path: Path) -> list[Path]:
    return sorted(file for file in path.iterdir() if file.suffix.lower() in suffixes.LOGS)


def _read_log(path: Path, request: Asked) -> RawTable:
    """A log, by its file or folder; a recorder that was ended writes no metadata."""
    log = path
    if os.path.isdir(path) and not exists(path / METADATA):
        log, *more = _logs(path)
        if more:
            raise InputError(f"{path}: a rosbag2 without {METADATA}; write that with `ros2 bag reindex {path.name}`")
    columns = read_bag(log, request.topics, request.of_arm, request.notes)
    # nothing says the unit of efforts
    return RawTable.of_arrays(columns, [name for name in columns if name.startswith("tau")])


FORMATS = (
    Format(
        "a topic of ROS, echoed",
        (*suffixes.YAML, ".txt", ".log"),
        lambda path, request: read_echo(path, request.notes),
        _is_echo,
    ),
    Format(
        "OpenCV's storage",
        (*suffixes.YAML, suffixes.XML, suffixes.JSON),
        lambda path, request: read_file_storage(path, request.notes),
        _is_storage,
    ),
    Format(
        "samples in JSON or YAML",
        (*suffixes.YAML, suffixes.JSON),
        lambda path, request: read_document(path, request.notes),
        _is_samples,
    ),
    Format(
        "a list of points of KUKA",
        (suffixes.DATA_LIST,),
        lambda path, request: read_program(path, request.notes),
        holds_program,
    ),
    Format("a program of a robot", suffixes.PROGRAMS, lambda path, request: read_program(path, request.notes)),
    Format(
        "a table of text", suffixes.TEXT_TABLES, lambda path, request: open_text(path, request.notes, request.growing)
    ),
    Format("Parquet", (suffixes.PARQUET,), lambda path, request: open_part(path)),
    Format("HDF5", suffixes.HDF5, lambda path, request: read_hdf5(path, request.notes)),
    Format("arrays of NumPy", suffixes.NUMPY, lambda path, request: read_numpy(path, request.notes)),
    Format("arrays of MATLAB", suffixes.MATLAB, lambda path, request: read_matlab(path, request.notes)),
    Format("a workbook", suffixes.WORKBOOKS, lambda path, request: read_workbook(path, request.notes)),
    Format(
        "a LeRobot data set",
        (),
        lambda path, request: open_lerobot(path),
        is_folder=lambda path: exists(path / INFO),
    ),
    Format(
        "a log of ROS",
        suffixes.LOGS,
        _read_log,
        is_folder=lambda path: exists(path / METADATA) or bool(_logs(path)),
        is_log=True,
    ),
)
"""All formats, in the order in which they are tried."""


def find_format(path: Path) -> Format | None:
    """The format of a file or folder by its suffix and, where others have it too, its content; None of none."""
    suffix = path.suffix.lower()
    start = None
    for candidate in FORMATS:
        if suffix not in candidate.suffixes:
            continue
        if candidate.holds is None:
            return candidate
        start = _read_start(path) if start is None else start
        if candidate.holds(start):
            return candidate
    if os.path.isdir(path):
        return next(
            (candidate for candidate in FORMATS if candidate.is_folder is not None and candidate.is_folder(path)), None
        )
    return None


def _read_start(path: Path) -> str:
    """The first characters of a regular file; none of all else, which its reader refuses."""
    if not os.path.isfile(path):
        return ""
    try:
        with open(path, "rb") as file:
            return file.read(_START).decode("utf-8-sig", "replace")
    except OSError:
        return ""
