"""The stream of a report port: complete reports in order, with automatic reconnection."""

import queue
import threading
import time
from dataclasses import dataclass

import numpy as np

from lite6jax.controller import protocol
from lite6jax.controller.exchange import Address, Deadline, connect
from lite6jax.controller.protocol import MalformedError
from lite6jax.errors import InputError

SILENCE_S = 2.0
"""The time without a report, ten periods of the slowest port, after which the connection counts as lost."""
CONNECT_S = 3.0
RETRY_S = 0.25
_CHUNK = 1 << 16


@dataclass(frozen=True)
class Reports:
    """Complete reports of one connection, in order.

    Attributes:
        connection: the index of the connection among those with reports, from 0.
        reports: each starting with its length.
        heard: s, the arrival of the last byte by this computer's monotonic clock.
    """

    connection: int
    reports: list[bytes]
    heard: float


@dataclass(frozen=True)
class Lost:
    """The reason why a connection ended or failed; the port reconnects."""

    reason: str


class ReportPort:
    """Reads one report port in a separate thread, so that the controller never waits for a reader.

    `events` contains `Reports` and `Lost` in order of arrival. Nothing is sent.
    """

    def __init__(self, address: Address, port: int) -> None:
        self.address, self.port = address, port
        self.events: queue.SimpleQueue[Reports | Lost] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._connections = 0
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> "ReportPort":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join(1.0)  # the thread may be connecting; as a daemon it need not end

    def _run(self) -> None:
        while not self._stop.is_set():
            started = time.monotonic()
            reason = self._connection()
            if self._stop.is_set():
                return
            self.events.put(Lost(reason))
            self._stop.wait(max(0.0, started + RETRY_S - time.monotonic()))

    def _connection(self) -> str:
        """Reads one connection to its end; returns the reason of the end."""
        try:
            connection = connect(self.address.host, self.port, Deadline.after(CONNECT_S))
        except InputError as error:
            return str(error)
        place = f"{self.address.host}: port {self.port}"
        received, heard, given = bytearray(), time.monotonic(), False
        with connection:
            connection.settimeout(0.1)  # the delay of a stop
            while not self._stop.is_set():
                try:
                    chunk = connection.recv(_CHUNK)
                except TimeoutError:
                    if time.monotonic() - heard > SILENCE_S:
                        return f"{place}: no report for {SILENCE_S:g} s"
                    continue
                except OSError as error:
                    return f"{place}: {error.strerror or error}"
                if not chunk:
                    return f"{place}: closed by the controller"
                heard = time.monotonic()
                received += chunk
                whole, fault = _whole_reports(self.port, received)
                if whole:
                    self._connections += not given
                    given = True
                    self.events.put(Reports(self._connections - 1, whole, heard))
                if fault:
                    return f"{place}: {fault}"
        return f"{place}: stopped"


def _whole_reports(port: int, received: bytearray) -> tuple[list[bytes], str]:
    """The reports before the first invalid one, and the fault of that one; empty without."""
    whole: list[bytes] = []
    try:
        for report in protocol.take_reports(received):
            protocol.report_layout(port, len(report))
            whole.append(report)
    except MalformedError as error:
        return whole, str(error)
    return whole, ""


def first_report(address: Address, port: int, seconds: float) -> np.void:
    """The fields of the next report of a port, by name.

    Raises:
        InputError: no connection, or no report within `seconds`.
    """
    deadline, reason = Deadline.after(seconds), ""
    with ReportPort(address, port) as stream:
        while (left := deadline.left()) > 0:
            try:
                event = stream.events.get(timeout=left)
            except queue.Empty:
                break
            if isinstance(event, Reports):
                return protocol.read_report(port, event.reports[-1])
            reason = event.reason  # a single reading does not reconnect
            break
    problem = reason or f"{address.host}: port {port}: no report within {seconds:g} s"
    raise InputError(
        problem if ";" in problem else f"{problem}; check that the controller has finished starting, and try again"
    )
