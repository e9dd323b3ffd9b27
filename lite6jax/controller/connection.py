"""Connections to a controller: its address, sockets with a deadline, and report ports that reconnect by themselves."""

import ipaddress
import queue
import socket
import threading
import time
from dataclasses import dataclass

from lite6jax.controller import protocol
from lite6jax.errors import InputError

SILENCE_S = 2.0
"""The time without a report, ten periods of the slowest port, after which the connection counts as lost."""
CONNECT_S = 3.0
RETRY_S = 0.25


@dataclass(frozen=True)
class Address:
    """The IPv4 address of a controller, and its control port, which may differ from 502 for an emulator."""

    host: str
    port: int = protocol.CONTROL_PORT

    def __str__(self) -> str:
        if self.port == protocol.CONTROL_PORT:
            return self.host
        return f"{self.host}:{self.port}"


def parse_address(text: str) -> Address:
    """An address as given by the user: `192.168.1.185`, `localhost`, `127.0.0.1:1502`.

    Host names are not resolved, because that has no deadline and the SDK does not accept them.

    Raises:
        InputError: not an IPv4 address, or an invalid port.
    """
    host, colon, port = text.strip().partition(":")
    if host == "localhost":
        host = "127.0.0.1"
    try:
        ipaddress.IPv4Address(host)
        if colon and not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
            raise ValueError
    except ValueError as error:
        raise InputError(
            f"--ip {text}: is not an IPv4 address; give the one that the control box shows, such as 192.168.1.185"
        ) from error
    return Address(host, int(port) if colon else protocol.CONTROL_PORT)


def connect(host: str, port: int, seconds: float) -> socket.socket:
    """A connected socket.

    Raises:
        InputError: connection refused, no reply within `seconds`, or an unreachable network.
    """
    connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    connection.settimeout(seconds)
    try:
        connection.connect((host, port))
    except OSError as error:
        connection.close()
        reason = f"cannot be reached ({error.strerror or error}); check the address and this computer's network"
        if isinstance(error, TimeoutError):
            reason = "no reply; check the address, that the control box is on, and that this computer is on its network"
            reason += " (ping it)"
        elif isinstance(error, ConnectionRefusedError):
            reason = "nothing listens there; check the address, and that the control box has finished starting"
            reason += " (a minute)"
        raise InputError(f"{host}: port {port}: {reason}") from error
    return connection


@dataclass(frozen=True)
class Reports:
    """Complete reports of one connection, in order, each starting with its length.

    `connection` counts the connections with reports, from 0. `heard` is when the last byte arrived, in s by this
    computer's monotonic clock.
    """

    connection: int
    reports: list[bytes]
    heard: float


class ReportPort:
    """Reads one report port in a separate thread, so that the controller never waits for a reader.

    `events` contains, in order of arrival, `Reports` and the reason of each end of a connection. Nothing is sent.
    """

    def __init__(self, address: Address, port: int) -> None:
        self.address = address
        self.port = port
        self.place = f"{address.host}: port {port}"
        self.events: queue.SimpleQueue[Reports | str] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._connections = 0
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> "ReportPort":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join(1.0)  # the thread may be connecting; as a daemon it need not end

    def drain(self) -> list[Reports | str]:
        """The events that wait, with the reports of a connection merged, which is much faster to process."""
        events: list[Reports | str] = []
        while not self.events.empty():
            event = self.events.get()
            last = events[-1] if events else None
            if isinstance(event, Reports) and isinstance(last, Reports) and event.connection == last.connection:
                events[-1] = Reports(event.connection, last.reports + event.reports, event.heard)
            else:
                events.append(event)
        return events

    def _run(self) -> None:
        while not self._stop.is_set():
            started = time.monotonic()
            reason = self._read_connection()
            if self._stop.is_set():
                return
            self.events.put(reason)
            self._stop.wait(max(0.0, started + RETRY_S - time.monotonic()))

    def _read_connection(self) -> str:
        """Reads one connection to its end; returns the reason of the end."""
        try:
            connection = connect(self.address.host, self.port, CONNECT_S)
        except InputError as error:
            return str(error)
        received = bytearray()
        heard = time.monotonic()
        index = self._connections
        with connection:
            connection.settimeout(0.1)  # the delay of a stop
            while not self._stop.is_set():
                try:
                    chunk = connection.recv(1 << 16)
                except TimeoutError:
                    if time.monotonic() - heard > SILENCE_S:
                        return f"{self.place}: no report for {SILENCE_S:g} s"
                    continue
                except OSError as error:
                    return f"{self.place}: {error.strerror or error}"
                if not chunk:
                    return f"{self.place}: closed by the controller"
                heard = time.monotonic()
                fault = ""
                reports = []
                received += chunk
                try:
                    for report in protocol.take_reports(received):
                        protocol.report_layout(self.port, len(report))
                        reports.append(report)
                except protocol.MalformedError as error:
                    fault = str(error)
                if reports:
                    self._connections = index + 1
                    self.events.put(Reports(index, reports, heard))
                if fault:
                    return f"{self.place}: {fault}"
        return f"{self.place}: stopped"
