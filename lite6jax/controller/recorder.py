"""Recording a live arm: its reports as rows of a growing table, or the poses that it computes for given joints."""

import io
import math
import os
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv as pa_csv
from pyarrow import parquet as pa_parquet
from scipy.spatial.transform import Rotation

from lite6jax import suffixes
from lite6jax.arms.factory import write_factory
from lite6jax.controller import protocol
from lite6jax.controller.connection import Address, ReportPort, Reports
from lite6jax.controller.rows import SOURCES, Rows
from lite6jax.controller.sdk import compute_poses
from lite6jax.controller.station import Station, factory_path, parse_condition
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, RecordingSettings, sidecar_path, write_recording, write_settings
from lite6jax.recordings.settings import growing_path
from lite6jax.storage import check_writable, write_atomically

Columns = Mapping[str, NDArray]

ROWS_AT_ONCE = 250
"""Rows for which writing is worth it: those of a second, which a kill may cost."""
GROUP_BYTES = 1 << 24
"""Of CSV, some 25 000 rows, which are compressed together in a complete Parquet file."""


class TableWriter:
    """A CSV or Parquet table, by the suffix of its path, to which rows are appended.

    Rows on the disk stay readable, even if the process is killed. Once a disk refuses rows, no more are written. A
    Parquet file can be read once the list of its row groups is written at its end; until then the rows stand in a CSV,
    `run.growing.csv` of `run.parquet`. That is the recording where the process is killed, or the disk has no room for
    the Parquet file.

    Attributes:
        file: where the rows are.
        waiting: the number of rows that are not written.
        refusal: why the disk does not accept them; empty while it does.
    """

    def __init__(self, path: Path, overwrite: bool, sources: Mapping[str, str]) -> None:
        """Creates no file before the first rows, nor replaces one unless `overwrite`.

        `sources` are phrases by column, which Parquet stores as column metadata.
        """
        self._path = path
        self._overwrite = overwrite
        self._sources = sources
        self._parquet = path.suffix.lower() == suffixes.PARQUET
        self.file = growing_path(path) if self._parquet else path
        self.waiting = 0
        self.refusal = ""
        self._parts: list[Columns] = []
        self._schema: pa.Schema | None = None
        self._open: io.FileIO | None = None
        self._size = 0

    def append(self, columns: Columns) -> None:
        """Appends rows, and writes where there are enough."""
        self._parts.append(columns)
        self.waiting += len(next(iter(columns.values())))
        if self.waiting >= ROWS_AT_ONCE:
            self.flush()

    def flush(self) -> None:
        """Writes the rows that wait, a second of them at a time, each all or none: many may have come after a stall."""
        if self.refusal or not self.waiting:
            return
        rows = {name: np.concatenate([part[name] for part in self._parts]) for name in self._parts[0]}
        try:
            while self.waiting:
                self._write({name: values[:ROWS_AT_ONCE] for name, values in rows.items()})
                rows = {name: values[ROWS_AT_ONCE:] for name, values in rows.items()}
                self.waiting = len(next(iter(rows.values())))
        except OSError as error:
            self.refusal = error.strerror or str(error)
        self._parts = [rows] if self.waiting else []

    def close(self) -> None:
        """Writes the remaining rows, and completes the file; without rows there is none."""
        self.flush()
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
        first = not self._size
        sink = pa.BufferOutputStream()
        sink.write(",".join(columns).encode() + b"\n" if first else b"")
        pa_csv.write_csv(batch, sink, pa_csv.WriteOptions(include_header=False))
        unwritten = memoryview(sink.getvalue())
        size = self._size + len(unwritten)
        if self._open is None:
            self._open = io.FileIO(self.file, "w+" if self._overwrite else "x+")
        try:
            self._open.seek(self._size)
            while len(unwritten):  # on a disk that becomes full, a write may be partial without an error
                unwritten = unwritten[self._open.write(unwritten) or 0 :]
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
            except (InputError, pa.ArrowException) as error:
                raise OSError(f"{error}; the rows are in {self.file}, which is read like it") from error
            self.file.unlink()
            self.file = self._path

    def _write_parquet(self, target: Path) -> None:
        """Writes the rows of the CSV as Parquet, row group by row group."""
        convert = pa_csv.ConvertOptions(column_types=self._schema, null_values=[""], strings_can_be_null=True)
        rows = pa_csv.open_csv(self.file, pa_csv.ReadOptions(block_size=GROUP_BYTES), convert_options=convert)
        writer = pa_parquet.ParquetWriter(
            target, self._schema, use_dictionary=False, compression="zstd", write_page_checksum=True
        )
        try:
            for batch in rows:
                writer.write_batch(batch)
            writer.close()
        except (OSError, pa.ArrowException):
            writer.is_open = False  # or its destructor would write to the full disk again
            raise


# ------------------------------------------------------------------ recording


FIRST_REPORT_S = 5.0
GATHER_S = 0.05
SLOW_S = 0.25
"""The time without a report after which the connection, not the controller's clock, is late."""


@dataclass(frozen=True, eq=False)
class LiveRecording:
    """The result of recording a live arm, whether or not it reached its end.

    Attributes:
        written: the files.
        rows: the number of rows on disk.
        sources: the source of each column, as a phrase.
        settings: the content of the sidecar.
        notes: remarks, one sentence each.
        gaps: their number; the columns `missing` and `gap` say where and why.
        missing_within, missing_between: the number of missing reports within and between runs, or of missing joint
            positions.
        duration: s, by the controller's clock; by this computer's for computed poses.
        asked: the number of rows asked for, or None.
        short: whether there are fewer.
        unwritten: the number of rows that could not be written.
        refusal: why rows are not written, or why no further ones could come.
        rate: Hz, the rate of rows within runs, by the controller's clock.
        runs: the number of connections with rows.
        repeated: the number of duplicate reports, which are removed.
    """

    written: tuple[Path, ...]
    rows: int
    sources: Mapping[str, str]
    settings: RecordingSettings
    notes: tuple[str, ...]
    gaps: int
    missing_within: int
    duration: float
    asked: int | None
    short: bool
    missing_between: int = 0
    unwritten: int = 0
    refusal: str = ""
    rate: float = 0.0
    runs: int = 1
    repeated: int = 0

    @property
    def missing(self) -> int:
        """The number of missing reports or joint positions."""
        return self.missing_within + self.missing_between

    def account(self) -> dict[str, Any]:
        """What the sidecar says about the recording itself, in plain numbers and phrases."""
        return {
            "complete": not self.short and not self.unwritten,
            "rows": self.rows,
            **({} if self.asked is None else {"rows_asked_for": self.asked}),
            "rows_not_written": self.unwritten,
            "runs": self.runs,
            "duplicates_removed": self.repeated,
            "reports_missing_within_runs": self.missing_within,
            "reports_missing_between_runs": self.missing_between,
            "gaps": self.gaps,
            "notes": list(self.notes),
        }


def list_targets(out: Path, factory: bool = True, live: bool = True) -> list[Path]:
    """The files that a recording of this name writes: of an arm in motion if `live`, else of computed poses."""
    growing = []
    if live and out.suffix.lower() == suffixes.PARQUET:
        growing = [growing_path(out)]
    return [out, *growing, sidecar_path(out), *([factory_path(out)] if factory else [])]


def check_targets(out: Path, overwrite: bool, factory: bool = True, live: bool = True) -> None:
    """Checks that the files of `list_targets` can be written, before the connection to the arm.

    Raises:
        InputError: a file exists and `overwrite` is false, another suffix, or no such folder.
    """
    if out.suffix.lower() not in suffixes.WRITTEN_TABLES:
        raise InputError(f"{out}: a recording ends in .csv or .parquet; choose such a name")
    for path in list_targets(out, factory, live):
        check_writable(path, overwrite)


def record(
    address: Address,
    out: Path,
    station: Station,
    *,
    seconds: float | None = None,
    overwrite: bool = False,
    stop: threading.Event | None = None,
    show: Callable[[Rows, str], object] = lambda rows, trouble: None,
) -> LiveRecording:
    """Records an arm in motion or at standstill. Nothing is sent to it.

    Rows are written during the recording. A lost connection is replaced by a new one, with the next `run`. It ends at
    `stop`, after `seconds`, or where the disk is full; rows that cannot be written are counted.

    Args:
        address: of the controller.
        out: a `.csv` or `.parquet` file; its sidecar, and the calibration of the arm if available, are written beside.
            The rows of `run.parquet` are in `run.growing.csv` until the recording has ended.
        station: the arm and its settings, from `read_station`.
        seconds: the duration by the controller's clock; None for until `stop`.
        overwrite: whether the files may be replaced.
        stop: ends the recording when set, from any thread.
        show: called a few times a second with the rows so far, and the present problem, empty without one.

    Raises:
        InputError: the files cannot be written, no reports are received, or they contain no joints.
    """
    check_targets(out, overwrite, station.calibration is not None)
    if seconds is not None and not 0 < seconds < float("inf"):
        raise InputError(f"--seconds {seconds:g}: give more than zero")
    settings = station.sidecar_settings(out)
    declared: list[Path] = []

    def declare() -> None:  # before the first row, so that the rows of an interrupted recording can be read
        files = []
        if station.calibration is not None:
            files.append(write_factory(station.calibration.kinematics, factory_path(out), overwrite=overwrite))
        account = {"complete": False}  # until it is replaced at the end
        declared.extend([write_settings(settings, sidecar_path(out), overwrite, account=account), *files])

    rows = Rows(station, seconds)
    table = TableWriter(out, overwrite, SOURCES)
    try:
        ended = _take_rows(address, rows, table, declare, stop or threading.Event(), show)
    finally:
        table.close()
    count = rows.count - table.waiting
    refusal = table.refusal
    if table.waiting:
        refusal = (
            f"{table.file}: the disk took {count} rows and not the last {table.waiting} ({refusal}); free space before "
            "the next recording"
        )
    notes = (*station.notes, *rows.notes())
    if seconds is not None and not rows.complete:
        seconds_missing = max(seconds - rows.time, 0.0) if rows.count else seconds
        notes += (f"ended {seconds_missing:.3g} s before {seconds:g} s: {rows.stopped or ended}",)
    recording = LiveRecording(
        written=(*([table.file] if count else []), *declared),
        rows=count,
        sources={name: SOURCES[name] for name in rows.names},
        settings=replace(settings, torque_source="estimated" if rows.torques_computed else "unknown"),
        notes=notes,
        gaps=rows.gaps,
        missing_within=rows.missing_within,
        missing_between=rows.missing_between,
        duration=rows.time,
        asked=None if seconds is None else math.ceil(seconds * protocol.RATES[protocol.REALTIME] - 1e-6),
        short=seconds is not None and bool(rows.missing or not rows.complete),
        unwritten=table.waiting,
        refusal=refusal or rows.stopped,
        rate=rows.rate,
        runs=rows.run + 1 if rows.count else 0,
        repeated=rows.repeated,
    )
    if declared:
        with suppress(InputError):  # a full disk; the gaps are in the table as well
            write_settings(recording.settings, sidecar_path(out), True, recording.account())
    return recording


def _take_rows(
    address: Address,
    rows: Rows,
    table: TableWriter,
    declare: Callable[[], None],
    stop: threading.Event,
    show: Callable[[Rows, str], object],
) -> str:
    """Records until an end, and returns the reason of it as a phrase."""
    with ReportPort(address, protocol.REALTIME) as fast, ReportPort(address, protocol.RICH) as slow:
        started = shown = heard = time.monotonic()
        trouble = ""
        while not rows.complete and not rows.stopped:
            if stop.is_set():
                return "it was stopped"
            time.sleep(GATHER_S)
            for event in slow.drain():
                if isinstance(event, Reports):
                    with suppress(InputError):  # an incomplete report: the last condition remains valid
                        rows.condition = parse_condition(event.reports[-1], slow.place)
            events = fast.drain()
            now = time.monotonic()
            for event in events:
                if isinstance(event, str):
                    trouble = rows.lost = event
                    continue
                trouble = ""
                heard = event.heard
                first = not rows.count
                if (columns := rows.take(event)) is not None:
                    if first:
                        declare()
                    table.append(columns)
            if not rows.count and (trouble or now - started > FIRST_REPORT_S):
                problem = trouble or f"{fast.place}: no report within {FIRST_REPORT_S:g} s"
                remedy = "; check that the firmware has this port (2.x), and restart the control box"
                raise InputError(problem if ";" in problem else problem + remedy)
            if rows.seconds is not None and now - started > rows.seconds + FIRST_REPORT_S:
                silence = f"no report for {now - heard:.1f} s"
                return trouble or (silence if now - heard > SLOW_S else "the controller's clock is slow")
            if table.refusal:
                return "the disk took no more rows"
            if now - shown > 0.2:
                shown = now
                show(rows, trouble)
        return ""


def record_poses(
    address: Address,
    out: Path,
    station: Station,
    poses: Recording,
    *,
    overwrite: bool = False,
    stop: threading.Event | None = None,
    advance: Callable[[int], object] = lambda done: None,
) -> LiveRecording:
    """Records the controller's forward kinematics of the flange, or of the tool, at given joint positions.

    The arm does not move. Joint positions are recorded as sent, rounded to 32 bits. After a lost connection the row is
    requested again; rows that the controller refuses are omitted and noted. Of `poses` the joint positions are taken,
    and the notes about omitted rows. `advance` is called with 1 after each row; the rest is as in `record`.

    Raises:
        InputError: the files cannot be written, the number of joints differs, or no pose was received.
    """
    check_targets(out, overwrite, station.calibration is not None, live=False)
    if poses.dof != station.arm.dof:
        raise InputError(f"{poses.source}: has {poses.dof} joints, the {station.arm.name} {station.arm.dof}")
    joints = protocol.round_floats(poses.joint_position)
    started = time.monotonic()
    stop = stop or threading.Event()
    answers, failure, _ = compute_poses(address, joints, stop, lambda row: advance(1))
    rows = [i for i, answer in enumerate(answers) if not isinstance(answer, str)]
    refused = [(int(poses.row[i]), answer) for i, answer in enumerate(answers) if isinstance(answer, str)]
    settings = station.sidecar_settings(out, computed=True)
    written = []
    sources = {}
    if not rows and not stop.is_set():
        first = f"the first with {refused[0][1]}" if refused else ""
        raise InputError(failure or f"{address}: refuses all joints of {poses.source}, {first}; check them")
    if rows:
        T = protocol.read_pose(np.array([answers[i] for i in rows]))
        quaternion = Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True)
        recording = Recording.assembled(
            joints[rows], position=T[:, :3, 3], quaternion=quaternion, settings=settings, source=str(address)
        )
        for name in recording.columns():
            requested = name[0] == "q" and name[1].isdigit()
            sources[name] = (
                "as requested, not measured" if requested else "computed by the controller, for these joints"
            )
        written += [write_recording(recording, out, overwrite), sidecar_path(out)]
        if station.calibration is not None:
            written.append(write_factory(station.calibration.kinematics, factory_path(out), overwrite=overwrite))
    notes = [*station.notes, *(note for note in poses.notes if note.startswith("dropped"))]
    if refused:
        row, reason = refused[0]
        notes.append(f"{len(refused)} rows were refused and are omitted, the first is row {row}: {reason}")
    missing = len(joints) - len(answers)
    return LiveRecording(
        written=tuple(written),
        rows=len(rows),
        sources=sources,
        settings=settings,
        notes=tuple(notes),
        gaps=int(missing > 0),
        missing_within=missing,
        duration=time.monotonic() - started,
        asked=len(joints),
        short=len(rows) < len(joints),
        refusal=failure,
    )
