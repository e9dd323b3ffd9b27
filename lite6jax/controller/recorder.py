"""Recording a live arm: the 250 Hz and the 5 Hz report as rows of a table that is written during the recording."""

import math
import queue
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.factory import write_factory
from lite6jax.controller import protocol
from lite6jax.controller.condition import Condition, condition_of
from lite6jax.controller.exchange import Address
from lite6jax.controller.growing import GrowingTable, growing_table
from lite6jax.controller.recorded import Recorded, check_targets, factory_path
from lite6jax.controller.rows import SOURCES, Rows
from lite6jax.controller.station import Station
from lite6jax.controller.stream import Lost, ReportPort, Reports
from lite6jax.errors import InputError
from lite6jax.recordings import sidecar_path, write_settings
from lite6jax.recordings.checksums import TABLES, table_checksum

FIRST_REPORT_S = 5.0
GATHER_S = 0.05
SLOW_S = 0.25
"""The time without a report after which the connection, not the controller's clock, is late."""
MOST_AT_ONCE = 2500
"""Rows written together, where more wait than are written every second."""
MOST_WAITING = 150_000
"""Rows, ten minutes: the largest number kept in memory on a full disk; then the recording ends."""

Columns = Mapping[str, NDArray]


@dataclass(frozen=True)
class Progress:
    """The progress of a recording.

    Attributes:
        rows: their number.
        time: s, of the last row.
        rate: Hz, the recent rate of rows by the controller's clock.
        run: of the last row.
        missing: the number of missing reports, by the controller's clock.
        trouble: the present problem; empty without one.
    """

    rows: int
    time: float
    rate: float
    run: int
    missing: int
    trouble: str


def record(
    address: Address,
    out: Path,
    station: Station,
    *,
    seconds: float | None = None,
    overwrite: bool = False,
    stop: threading.Event | None = None,
    show: Callable[[Progress], object] = lambda progress: None,
) -> Recorded:
    """Records an arm in motion or at standstill. Nothing is sent to it.

    Rows are written during the recording. A lost connection is replaced by a new one, with the next `run`. On a full
    disk rows are kept in memory; those that cannot be written are counted. The recording ends at `stop` or after
    `seconds`.

    Args:
        address: of the controller.
        out: a `.csv` or `.parquet` file; its sidecar, and the calibration of the arm if available, are written beside.
            A `.parquet` file is an `.arrows` file of the same stem until the recording has ended.
        station: the arm and its settings, from `read_station`.
        seconds: the duration by the controller's clock; None for until `stop`.
        overwrite: whether the files may be replaced.
        stop: ends the recording when set, from any thread.
        show: called with the progress a few times a second.

    Raises:
        InputError: the files cannot be written, no reports are received, or they contain no joints.
    """
    check_targets(out, overwrite, station.calibration is not None)
    if seconds is not None and not 0 < seconds < float("inf"):
        raise InputError(f"--seconds {seconds:g}: give more than zero")
    stop = stop or threading.Event()
    rows = Rows(station, seconds)
    table = growing_table(out, overwrite, SOURCES)
    buffer = _Buffer(table)
    written: list[Path] = []
    with ReportPort(address, protocol.REALTIME) as fast, ReportPort(address, protocol.RICH) as slow:
        try:
            ended = _stream(
                fast, slow, rows, buffer, lambda: written.extend(_declare(out, station, overwrite)), stop, show
            )
        finally:
            unwritten, refusal = buffer.finish()
    if unwritten:
        refusal = (
            f"{out}: the disk took {rows.count - unwritten} rows and not the last {unwritten} ({refusal}); free space"
            " before the next recording"
        )
    notes = (*station.notes, *rows.notes())
    if seconds is not None and not rows.complete:
        left = max(seconds - rows.time, 0.0) if rows.count else seconds
        notes += (f"ended {left:.3g} s before {seconds:g} s: {rows.stopped or ended}",)
    recorded = Recorded(
        written=(table.file, *written) if rows.count > unwritten else tuple(written),
        rows=rows.count - unwritten,
        unwritten=unwritten,
        refusal=refusal or rows.stopped,
        asked=None if seconds is None else math.ceil(seconds * protocol.RATES[protocol.REALTIME] - 1e-6),
        short=seconds is not None and bool(rows.missing or not rows.complete),
        duration=rows.time,
        rate=rows.rate,
        runs=rows.run + 1 if rows.count else 0,
        gaps=rows.gaps,
        repeated=rows.repeated,
        sources={name: SOURCES[name] for name in rows.names},
        settings=replace(
            station.settings_beside(out), torque_source="estimated" if rows.torques_computed else "unknown"
        ),
        notes=notes,
    )
    if written:
        with suppress(InputError):  # a full disk; the gaps are in the table as well
            tables = {TABLES[out.suffix.lower()]: table_checksum(out)} if out.exists() else None
            write_settings(recorded.settings, sidecar_path(out), True, tables, recorded.account())
    return recorded


def _stream(
    fast: ReportPort,
    slow: ReportPort,
    rows: Rows,
    buffer: "_Buffer",
    declare: Callable[[], None],
    stop: threading.Event,
    show: Callable[[Progress], object],
) -> str:
    """Records until an end, and returns the reason of it as a phrase."""
    started = shown = heard = time.monotonic()
    trouble = ""
    while not rows.complete and not rows.stopped:
        if stop.is_set():
            return "it was stopped"
        if (condition := _latest(slow)) is not None:
            rows.condition = condition
        events = _gathered(fast)
        now = time.monotonic()
        for event in events:
            trouble = event.reason if isinstance(event, Lost) else ""
            if isinstance(event, Lost):
                rows.lost = event.reason
                if not rows.count:
                    raise InputError(_no_reports(fast, trouble))
                continue
            heard, first = event.heard, not rows.count
            if (columns := rows.take(event)) is not None:
                if first:
                    declare()
                buffer.add(columns)
        if not rows.count and now - started > FIRST_REPORT_S:
            raise InputError(_no_reports(fast, trouble))
        if rows.seconds is not None and now - started > rows.seconds + FIRST_REPORT_S:
            silent = now - heard
            slow_clock = "the controller's clock is slow"
            return trouble or (f"no report for {silent:.1f} s" if silent > SLOW_S else slow_clock)
        buffer.write()
        if buffer.waiting > MOST_WAITING and buffer.refusal:
            return "the disk took no more rows"
        if now - shown > 0.2:
            shown = now
            full = f"the disk cannot be written ({buffer.refusal}): {buffer.waiting} rows are kept in memory"
            problem = full if buffer.refusal else trouble
            show(Progress(rows.count, rows.time, rows.recent_rate, rows.run, rows.missing, problem))
    return ""


def _gathered(port: ReportPort) -> list[Reports | Lost]:
    """The events of `GATHER_S`, with the reports of a connection merged, which is much faster to process."""
    time.sleep(GATHER_S)
    events: list[Reports | Lost] = []
    while True:
        try:
            event = port.events.get_nowait()
        except queue.Empty:
            return events
        last = events[-1] if events else None
        if isinstance(event, Reports) and isinstance(last, Reports) and event.connection == last.connection:
            last.reports.extend(event.reports)
            events[-1] = Reports(event.connection, last.reports, event.heard)
        else:
            events.append(event)


def _latest(slow: ReportPort) -> Condition | None:
    condition = None
    while True:
        try:
            event = slow.events.get_nowait()
        except queue.Empty:
            return condition
        if isinstance(event, Reports):
            with suppress(InputError):  # an incomplete report: the last condition remains valid
                condition = condition_of(protocol.read_report(slow.port, event.reports[-1]), slow.address.host)


def _no_reports(port: ReportPort, reason: str) -> str:
    problem = reason or f"{port.address.host}: port {port.port}: no report within {FIRST_REPORT_S:g} s"
    return (
        problem
        if ";" in problem
        else f"{problem}; check that the firmware has this port (2.x), and restart the control box"
    )


def _declare(out: Path, station: Station, overwrite: bool) -> list[Path]:
    """Writes the sidecar and the calibration before the first row, so that an interrupted recording is complete."""
    files = []
    if station.calibration is not None:
        files.append(write_factory(station.calibration.kinematics, factory_path(out), overwrite=overwrite))
    account = {"complete": False}  # until it is replaced at the end
    return [write_settings(station.settings_beside(out), sidecar_path(out), overwrite, account=account), *files]


class _Buffer:
    """Rows in memory until a slow or full disk accepts them."""

    def __init__(self, table: GrowingTable) -> None:
        self._table = table
        self._pool = ThreadPoolExecutor(1)
        self._writing: Future[None] | None = None
        self._piece: Columns = {}
        self._pending: list[Columns] = []
        self._not_before = 0.0
        self.waiting = 0
        self.refusal = ""

    def add(self, columns: Columns) -> None:
        self._pending.append(columns)
        self.waiting += _length(columns)

    def write(self) -> None:
        """Starts writing in another thread if there are enough rows."""
        if self._writing is not None and self._writing.done():
            self._collect()
        if self._writing is None and self.waiting >= self._table.rows_at_once and time.monotonic() >= self._not_before:
            self._piece, rest = _split(self._pending, MOST_AT_ONCE)
            self._pending = [rest]
            self._writing = self._pool.submit(self._table.append, self._piece)

    def finish(self) -> tuple[int, str]:
        """Writes the remaining rows as far as possible; returns the number of unwritten rows and the reason."""
        if self._writing is not None:
            self._collect()
        size = MOST_AT_ONCE
        while self.waiting and size:
            piece, rest = _split(self._pending, size)
            self._pending = [piece, rest]
            try:
                self._table.append(piece)
            except OSError as error:
                self.refusal = error.strerror or str(error)
                size //= 2
                continue
            self._pending = [rest]
            self.waiting -= _length(piece)
        if not self.waiting:
            self.refusal = ""
        try:
            self._table.close()
        except OSError as error:
            self.refusal = self.refusal or error.strerror or str(error)
        finally:
            self._pool.shutdown()
        return self.waiting, self.refusal

    def _collect(self) -> None:
        assert self._writing is not None
        writing, self._writing = self._writing, None
        try:
            writing.result()
        except OSError as error:
            self.refusal = error.strerror or str(error)
            self._pending = [self._piece, *self._pending]
            self._not_before = time.monotonic() + 1.0
        else:
            self.waiting -= _length(self._piece)
            self.refusal = ""


def _length(columns: Columns) -> int:
    return len(next(iter(columns.values()))) if columns else 0


def _split(parts: list[Columns], size: int) -> tuple[Columns, Columns]:
    """The first `size` rows, and the remaining ones."""
    parts = [part for part in parts if _length(part)]
    if not parts:
        return {}, {}
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return {name: values[:size] for name, values in whole.items()}, {
        name: values[size:] for name, values in whole.items()
    }
