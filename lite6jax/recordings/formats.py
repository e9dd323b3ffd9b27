"""Recordings in files: CSV, Parquet and MCAP with a sidecar, read whole or refused in one line, written exactly."""

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import pi
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
from numpy.typing import ArrayLike

from lite6jax.errors import InputError
from lite6jax.recordings import stream
from lite6jax.recordings.checks import check_joint_scale, check_position_scale
from lite6jax.recordings.columns import Column
from lite6jax.recordings.mcap import read_mcap, split_topics
from lite6jax.recordings.plausible import without_implausible
from lite6jax.recordings.recording import Recording, drop_missing
from lite6jax.recordings.settings import RecordingSettings, read_sidecar, sidecar_path
from lite6jax.recordings.table import Table, arrays_of, recognised, require_numbers, si_values
from lite6jax.recordings.writing import write_with_settings
from lite6jax.storage import check_readable, exists

HEADER_LIMIT = 1 << 20

SUFFIXES = (".csv", ".parquet", ".mcap", stream.SUFFIX)
"""Of the files that are recordings."""


def recording_file(path: str | Path) -> Path | None:
    """The file that a recording's name names, without the topics of a log; None where it is no recording's name."""
    file, _ = split_topics(path)
    return file if file.suffix.lower() in SUFFIXES else None


def read_recording(
    path: str | Path,
    *,
    dof: int | None = None,
    assume_degrees: bool = False,
    assume_millimetres: bool = False,
    joint_limits: ArrayLike | None = None,
    reach: float | None = None,
) -> Recording:
    """Reads a recording and its sidecar.

    Args:
        path: a `.csv`, `.parquet` or `.mcap` file; the sidecar is the `.yaml` of the same stem, if there is one. Of an
            MCAP file with several topics of a type, `run.mcap#/joint_states,/pose` names those to be read.
        dof: the number of joints expected, where the arm is known.
        assume_degrees: take joint columns that say `rad` (positions, velocities and accelerations) as degrees.
        assume_millimetres: take position columns that say `m` as millimetres.
        joint_limits: `(joint, 2)` in rad, to recognise degrees; unchecked without.
        reach: in m, to recognise millimetres; unchecked without.

    Returns:
        the recording; what was dropped, assumed or ignored on the way is in its `notes`.

    Raises:
        InputError: the file or its sidecar cannot be used; one line names file, place and remedy.
    """
    path, topics = split_topics(path)
    readers = {
        ".csv": _read_csv, ".parquet": _read_parquet, ".mcap": partial(_read_mcap, topics=topics),
        stream.SUFFIX: _read_stream,
    }  # fmt: skip
    notes: list[str] = []
    table = _read(path, readers, "a recording ends in .csv, .parquet or .mcap", dof, notes)
    columns, _, values = table
    settings = _settings_beside(path, notes)
    if not exists(sidecar_path(path)):
        notes.append(f"there is no sidecar {sidecar_path(path).name}: the defaults are assumed")

    degrees = [name for name, column in columns.items() if assume_degrees and column.unit.startswith("rad")]
    millimetres = [name for name, column in columns.items() if assume_millimetres and column.unit == "m"]
    for names, divisor, unit in ((degrees, 180 / pi, "degrees"), (millimetres, 1e3, "millimetres")):
        for name in names:
            values[name] = values[name] / divisor
        if names:
            notes.append(
                f"columns {columns[names[0]].name} ... {columns[names[-1]].name} are taken as {unit}, as asked"
            )
    recording = _assembled(table, path, settings, notes)

    spelling = table.spelling
    recording = drop_missing(recording, spelling)
    if joint_limits is not None:
        check_joint_scale(recording, joint_limits, spelling, assumed=assume_degrees)
    if reach is not None:
        check_position_scale(recording, reach, spelling, assumed=assume_millimetres)
    return recording


class Targets(NamedTuple):
    """Poses that an arm is to reach.

    Attributes:
        recording: the targets as its poses, a sample a row; joints are zero where `start` is None. Rows with NaN stay.
        start: `(sample, joint)` rad, the joints given beside them, or None.
    """

    recording: Recording
    start: np.ndarray | None


def read_targets(
    path: str | Path, dof: int, joint_limits: ArrayLike | None = None, reach: float | None = None
) -> Targets:
    """Reads poses to be reached, in the columns of a recording: positions, orientations or not, joints or not.

    Args:
        path: a `.csv` or `.parquet` file; the sidecar as in `read_recording`.
        dof: the arm's number of joints.
        joint_limits: `(joint, 2)` in rad, to recognise degrees; unchecked without.
        reach: in m, to recognise millimetres; unchecked without.

    Raises:
        InputError: as `read_recording`; or there are no positions, or none in any row.
    """
    path, notes = Path(path), []
    readers = {
        ".csv": partial(_read_csv, joints_optional=True),
        ".parquet": partial(_read_parquet, joints_optional=True),
    }
    table = _read(path, readers, "targets end in .csv or .parquet", dof, notes)
    columns, joints, values = table
    if "x_m" not in columns:
        raise InputError(f"{path}: has no positions to reach; name their columns x_m y_m z_m (or x_mm y_mm z_mm)")
    given = "q1_rad" in columns
    if not given:
        values |= {f"q{joint}_rad": np.zeros(len(values["x_m"])) for joint in range(1, joints + 1)}
    recording = _assembled(table, path, _settings_beside(path, notes), notes)
    assert recording.position is not None
    if not np.isfinite(recording.position).all(1).any():
        raise InputError(f"{path}: columns x_m y_m z_m: no row holds a whole position; fill them")
    if given and joint_limits is not None:
        check_joint_scale(recording, joint_limits, table.spelling, assumed=True)
    if reach is not None:
        check_position_scale(recording, reach, table.spelling, assumed=True)
    return Targets(recording, recording.joint_position if given else None)


def write_recording(recording: Recording, path: str | Path, overwrite: bool = False) -> Path:
    """Writes a recording as CSV or Parquet, by the suffix, and its sidecar beside it.

    Every number reads back bit for bit. Paths in the sidecar are rewritten where it moves to another folder. Not
    written: row numbers and notes, which belong to the file of origin, and what `Recording.columns` leaves out.

    Raises:
        InputError: another suffix, a file that exists while `overwrite` is false, or a disk that refuses.
    """
    path = Path(path)
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise InputError(f"{path}: a recording ends in .csv or .parquet; choose such a name")
    settings = recording.settings
    if exists(recording.source):
        settings = settings.moved(Path(recording.source).parent, path.parent)
    return write_with_settings(pa.table(recording.columns()), settings, path, overwrite)


def _assembled(table: Table, path: Path, settings: RecordingSettings, notes: list[str]) -> Recording:
    arrays = without_implausible(arrays_of(table, str(path), notes), str(path), table.spelling, notes)
    return Recording.assembled(**arrays, settings=settings, source=str(path), notes=tuple(notes))


def _settings_beside(path: Path, notes: list[str]) -> RecordingSettings:
    """What the sidecar declares, after a check that it was written with this table."""
    settings, checksums = read_sidecar(sidecar_path(path))
    checksums.check_table(path)
    notes += checksums.notes
    return settings


def _read(
    path: Path, readers: Mapping[str, Callable[..., Table]], kinds: str, dof: int | None, notes: list[str]
) -> Table:
    read = readers.get(path.suffix.lower())
    if read is None:
        raise InputError(f"{path}: {kinds}; convert it or correct the name")
    growing = stream.stream_path(path)
    if path.suffix.lower() == ".parquet" and not exists(path) and exists(growing):
        notes.append(f"the recording was ended before it was complete; its rows are those of {growing.name}")
        path, read = growing, _read_stream
    check_readable(path)
    try:
        table = read(path, dof, notes)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({_one_line(error.strerror or error)}); check the file") from error
    if not all(map(len, table.values.values())):
        raise InputError(f"{path}: has column names but no rows; record again")
    return table


def _read_parquet(path: Path, dof: int | None, notes: list[str], joints_optional: bool = False) -> Table:
    try:
        with pa_parquet.ParquetFile(path, page_checksum_verification=True) as file:
            schema = file.schema_arrow
            names = schema.names
            columns, joints = recognised(names, str(path), dof, notes, joints_optional)
            for column in columns.values():
                require_numbers(column, schema.field(column.index).type, str(path))
            table = file.read(columns=[names[column.index] for column in columns.values()])
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: a column name is not UTF-8; write the file again with other names") from error
    except (pa.ArrowException, OSError) as error:
        if isinstance(error, OSError) and error.errno:  # the disk's refusal, not Parquet's
            raise
        with open(path, "rb") as content:
            start = content.read(4)
        problem = "is truncated or damaged" if start == b"PAR1" else "is not Parquet, whatever its name says"
        raise InputError(f"{path}: {problem} ({_one_line(error)}); write it again") from error
    chosen = {name: table[names[column.index]] for name, column in columns.items()}
    return Table(columns, joints, si_values(columns, chosen))


def _read_stream(path: Path, dof: int | None, notes: list[str], joints_optional: bool = False) -> Table:
    table = stream.read_stream(path, notes)
    columns, joints = recognised(table.column_names, str(path), dof, notes, joints_optional)
    for column in columns.values():
        require_numbers(column, table.schema.field(column.index).type, str(path))
    return Table(columns, joints, si_values(columns, {name: table[column.name] for name, column in columns.items()}))


def _read_mcap(path: Path, dof: int | None, notes: list[str], topics: Sequence[str]) -> Table:
    values = read_mcap(path, topics, dof, notes)
    return Table(*recognised(list(values), str(path), dof, notes), values)


def _read_csv(path: Path, dof: int | None, notes: list[str], joints_optional: bool = False) -> Table:
    names, tail = _csv_header(path), _csv_tail(path)
    columns, joints = recognised(names, str(path), dof, notes, joints_optional)
    if not tail.endswith((b"\n", b"\r")):
        notes.append("the file does not end with a line break: its last number may have been cut short")
    table = _csv_table(path, names, columns, tail)
    chosen = {name: table[str(column.index)] for name, column in columns.items()}
    return Table(columns, joints, si_values(columns, chosen))


def _csv_table(
    path: Path, names: Sequence[str], columns: Mapping[str, Column], tail: bytes, threads: bool = True
) -> pa.Table:
    """The columns wanted, named by their index: two ignored columns may share a name."""
    wanted = [str(column.index) for column in columns.values()]
    try:
        return pa_csv.read_csv(
            path,
            pa_csv.ReadOptions(column_names=[str(i) for i in range(len(names))], skip_rows=1, use_threads=threads),
            convert_options=pa_csv.ConvertOptions(
                include_columns=wanted, column_types=dict.fromkeys(wanted, pa.float64())
            ),
        )
    except pa.ArrowInvalid as error:
        if "Could not skip" in str(error):  # Arrow's word for a header and nothing after it
            raise InputError(f"{path}: has column names but no rows; record again") from error
        if threads:  # rows are numbered only when they are read in order
            return _csv_table(path, names, columns, tail, threads=False)
        if match := re.search(r"Row #(\d+): Expected \d+ columns, got (\d+)", str(error)):
            raise InputError(_ragged(path, int(match[1]) - 1, int(match[2]), names, tail)) from error
        if match := re.match(r"In CSV column #(\d+): Row #(\d+): .*?invalid value '(.*)'$", str(error), re.DOTALL):
            column = next(column for column in columns.values() if column.index == int(match[1]))
            remedy = "give numbers with a decimal point, and leave missing ones empty"
            value = repr(match[3] if len(match[3]) <= 40 else f"{match[3][:37]}...")
            raise InputError(
                f"{path}: column {column.name}: row {int(match[2]) - 1} holds {value}, which is no number; {remedy}"
            ) from error
        raise InputError(f"{path}: is not a table of numbers ({_one_line(error)}); check the file") from error


def _ragged(path: Path, row: int, fields: int, names: Sequence[str], tail: bytes) -> str:
    place = f"{path}: row {row} has {fields} of {len(names)} columns"
    if fields < len(names):
        last = tail.rstrip().rpartition(b"\n")[2]
        cut = "the file is truncated" if last.count(b",") + 1 == fields else "the row is cut short"
        return f"{place}, {names[fields].strip()} is the first without a value: {cut}; complete the row or remove it"
    return f"{place}; remove the surplus fields, and write decimals with a point"


def _csv_header(path: Path) -> list[str]:
    with open(path, "rb") as file:
        start = file.read(HEADER_LIMIT)
    if not start.strip():
        raise InputError(f"{path}: is empty; record again")
    if start.startswith(b"PAR1"):
        raise InputError(f"{path}: is a Parquet file, whatever its name says; name it .parquet")
    line = re.split(rb"[\r\n]", start, maxsplit=1)[0]
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if b"\0" in start or "\0" in text or len(line) == HEADER_LIMIT:
        raise InputError(f"{path}: is not a CSV table but binary or of another encoding; write it as UTF-8 text")
    if not text.strip():
        raise InputError(f"{path}: line 1 is empty; it must name the columns")
    try:
        names = next(csv.reader([text]))
    except csv.Error as error:
        raise InputError(f"{path}: line 1 is no list of column names ({error}); check the file") from error
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if separator in text and (len(names) == 1 or text.count(separator) > text.count(",")):
            raise InputError(
                f"{path}: line 1: the fields are separated by {word}; write commas between them and decimal points"
            )
    if all(re.fullmatch(r"\s*[-+]?[\d.]+(e[-+]?\d+)?\s*", name, re.IGNORECASE) for name in names):
        raise InputError(f"{path}: line 1 holds numbers; it must name the columns, q1_rad, q2_rad, ...")
    return names


def _csv_tail(path: Path) -> bytes:
    with open(path, "rb") as file:
        file.seek(0, 2)
        file.seek(max(0, file.tell() - HEADER_LIMIT))
        return file.read()


def _one_line(error: object) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= 120 else f"{text[:117]}..."
