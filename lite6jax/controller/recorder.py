"""A recording of a live arm: the 250 Hz report and the slow one, row for row, onto the disk and off it whole."""

import queue
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
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

FIRST_REPORT_S = 5.0
GATHER_S = 0.05
MOST_WAITING = 150_000
"""Rows, ten minutes: so many are kept in memory while the disk is full, before the recording ends."""

Columns = Mapping[str, NDArray]


@dataclass(frozen=True)
class Progress:
    """How a recording stands.

    Attributes:
        rows: so far.
        time: s, of the last row.
        rate: rows a second over the last few, by the controller's clock.
        run: of the last row.
        missing: reports that the controller's clock has passed over.
        trouble: what is wrong at present; empty where nothing is.
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
    """Records an arm as it moves, or stands; it sends nothing to it.

    Rows are written as they come. The connection may drop: another is made, and `run` counts up. The disk may be full:
    rows wait in memory, and what it never takes is counted. It ends at `stop` or after `seconds`.

    Args:
        address: the controller's.
        out: a `.csv` or `.parquet` file. Its sidecar, and the arm's calibration where there is one, stand beside it.
        station: what is known of the arm, from `read_station`.
        seconds: by the controller's clock; without, until `stop`.
        overwrite: whether the files may be replaced.
        stop: ends the recording when set, from any thread.
        show: called a few times a second.

    Raises:
        InputError: the targets cannot be written, the port cannot be reached, or its reports hold no joints.
    """
    check_targets(out, overwrite, station.calibration is not None)
    if seconds is not None and not 0 < seconds < float("inf"):
        raise InputError(f"--seconds {seconds:g}: give more than zero")
    stop = stop or threading.Event()
    rows = Rows(station, seconds)
    sheet = _Sheet(growing_table(out, overwrite, SOURCES))
    written: list[Path] = []
    with ReportPort(address, protocol.REALTIME) as fast, ReportPort(address, protocol.RICH) as slow:
        try:
            _stream(fast, slow, rows, sheet, lambda: written.extend(_declare(out, station, overwrite)), stop, show)
        finally:
            unwritten, refusal = sheet.finish()
    taken = rows.count - unwritten
    notes = (*station.notes, *rows.notes())
    if seconds is not None and not rows.complete and not stop.is_set() and not refusal:
        notes += (
            f"ended without all {seconds:g} s: the connection was gone too long, or the controller's clock is slow",
        )
    return Recorded(
        written=(out, *written) if taken else tuple(written),
        rows=taken,
        unwritten=unwritten,
        refusal=refusal,
        duration=rows.time,
        rate=rows.rate,
        runs=rows.run + 1 if rows.count else 0,
        missing=rows.missing,
        repeated=rows.repeated,
        sources={name: SOURCES[name] for name in rows.names},
        settings=station.settings_beside(out),
        notes=notes,
    )


def _stream(
    fast: ReportPort,
    slow: ReportPort,
    rows: Rows,
    sheet: "_Sheet",
    declare: Callable[[], None],
    stop: threading.Event,
    show: Callable[[Progress], object],
) -> None:
    started = shown = time.monotonic()
    trouble = ""
    while not stop.is_set() and not rows.complete:
        if (condition := _latest(slow)) is not None:
            rows.condition = condition
        events = _gathered(fast)
        now = time.monotonic()
        for event in events:
            trouble = event.reason if isinstance(event, Lost) else ""
            if isinstance(event, Lost):
                if not rows.count:
                    raise InputError(_no_reports(fast, trouble))
                continue
            first = not rows.count
            if (columns := rows.take(event)) is not None:
                if first:
                    declare()
                sheet.add(columns)
        if not rows.count and now - started > FIRST_REPORT_S:
            raise InputError(_no_reports(fast, trouble))
        if rows.seconds is not None and now - started > rows.seconds + FIRST_REPORT_S:
            break  # a clock that stands still, or no connection any more
        sheet.write()
        if sheet.waiting > MOST_WAITING and sheet.refusal:
            break
        if now - shown > 0.2:
            shown = now
            full = f"the disk takes nothing ({sheet.refusal}): {sheet.waiting} rows wait in memory"
            said = full if sheet.refusal else trouble
            show(Progress(rows.count, rows.time, rows.recent_rate, rows.run, rows.missing, said))


def _gathered(port: ReportPort) -> list[Reports | Lost]:
    """What has come over a moment, those of one connection together: one by one they would cost far more."""
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
            with suppress(InputError):  # a report without it; what was known before still holds
                condition = condition_of(protocol.read_report(slow.port, event.reports[-1]), slow.address.host)


def _no_reports(port: ReportPort, reason: str) -> str:
    said = reason or f"{port.address.host}: port {port.port}: no report within {FIRST_REPORT_S:g} s"
    return said if ";" in said else f"{said}; check that the firmware has this port (2.x), and restart the control box"


def _declare(out: Path, station: Station, overwrite: bool) -> list[Path]:
    """Writes what stands beside the rows, before the first of them: a recording that breaks off is one."""
    files = []
    if station.calibration is not None:
        files.append(write_factory(station.calibration.kinematics, factory_path(out), overwrite=overwrite))
    return [write_settings(station.settings_beside(out), sidecar_path(out), overwrite), *files]


class _Sheet:
    """Rows on their way to the disk, which may be slow, or full."""

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
        """Gives the disk what is worth it, without waiting for it."""
        if self._writing is not None and self._writing.done():
            self._collect()
        if self._writing is None and self.waiting >= self._table.rows_at_once and time.monotonic() >= self._not_before:
            self._piece, rest = _split(self._pending, self._table.rows_at_once)
            self._pending = [rest]
            self._writing = self._pool.submit(self._table.append, self._piece)

    def finish(self) -> tuple[int, str]:
        """Writes all that is left, or as much of it as the disk takes: how many rows it did not take, and why."""
        if self._writing is not None:
            self._collect()
        size = self._table.rows_at_once
        try:
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
            self._table.close()
        except OSError as error:
            self.refusal = error.strerror or str(error)
        finally:
            self._pool.shutdown()
        if not self.waiting:
            self.refusal = ""
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
    """The first `size` rows, and the others."""
    parts = [part for part in parts if _length(part)]
    if not parts:
        return {}, {}
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return {name: values[:size] for name, values in whole.items()}, {
        name: values[size:] for name, values in whole.items()
    }
