"""Connections to a controller: its address, sockets with a deadline, and report ports that reconnect by themselves."""

import ipaddress
import queue
import socket
import threading
import time
from dataclasses import dataclass

from lite6jax.controller import protocol
from lite6jax.controller.protocol import HEADER
from lite6jax.errors import InputError

SILENCE_S = 2.0
"""The time without a report, ten periods of the slowest port, after which the connection counts as lost."""
CONNECT_S = 3.0
ANSWER_S = 4.0
RETRY_S = 0.25


@dataclass(frozen=True)
class Address:
    """The IPv4 address of a controller, and its control port, which may differ from 502 for an emulator."""

    host: str
    port: int = protocol.CONTROL_PORT

    def __str__(self) -> str:
        return self.host if self.port == protocol.CONTROL_PORT else f"{self.host}:{self.port}"


def parse_address(text: str) -> Address:
    """An address as given by the user: `192.168.1.185`, `localhost`, `127.0.0.1:1502`.

    Host names are not resolved, because that has no deadline and the SDK does not accept them.

    Raises:
        InputError: not an IPv4 address, or an invalid port.
    """
    host, colon, port = text.strip().partition(":")
    host = "127.0.0.1" if host == "localhost" else host
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


class SilentError(InputError):
    """The controller accepts a request and does not reply, as with some firmware."""


class ControlPort:
    """A connection to the control port. What is asked here only reads: it neither moves nor sets anything."""

    def __init__(self, address: Address, seconds: float = ANSWER_S) -> None:
        """`seconds` limit the connecting, and each reply to its last byte; a controller replies within milliseconds."""
        self._address, self._seconds, self._transaction = address, seconds, 0

    def __enter__(self) -> "ControlPort":
        """Connects.

        Raises:
            InputError: as `connect`.
        """
        self._connection = connect(self._address.host, self._address.port, self._seconds)
        return self

    def __exit__(self, *error: object) -> None:
        self._connection.close()

    def ask(self, register: protocol.Register, size: int, parameters: bytes = b"") -> protocol.Frame:
        """The reply to a request, with a payload of `size` bytes unless its status is invalid.

        Raises:
            InputError: no reply (`SilentError`), an incomplete one, or one to something else.
        """
        self._transaction = self._transaction % 0xFFFF + 1
        request = protocol.Frame(register, parameters, self._transaction)
        received, end, whole = bytearray(), time.monotonic() + self._seconds, HEADER.size + 2 + size
        try:
            self._connection.sendall(request.encode())
            while len(received) < whole:
                if (left := end - time.monotonic()) <= 0:
                    raise TimeoutError
                self._connection.settimeout(left)
                piece = self._connection.recv(whole - len(received))
                if not piece:
                    raise ConnectionError
                received += piece
                whole = HEADER.size + self._check(request, received, 2 + size)
        except OSError as error:
            so_far = f"{len(received)} of {whole} bytes"
            if not isinstance(error, TimeoutError):
                raise InputError(
                    f"{self._address}: closed the connection after {so_far}; end other programs connected to the arm, "
                    "and if it persists restart the control box"
                ) from error
            if received:
                raise InputError(
                    f"{self._address}: stopped replying after {so_far}; check the cable and the network, and read again"
                ) from error
            raise SilentError(
                f"{self._address}: accepts the request and does not reply, as firmware 1.12.1 does; update the "
                "firmware, or check that the address is the arm's control box"
            ) from error
        return request._replace(body=bytes(received[HEADER.size + 1 :]))

    def _check(self, request: protocol.Frame, received: bytearray, wanted: int) -> int:
        """The length of a reply from its register on, after a check of the beginning as far as it is received."""
        if len(received) < HEADER.size:
            return wanted
        transaction, proto, length = HEADER.unpack_from(received)
        what = ""
        if (transaction, proto) != (request.transaction, request.protocol):
            expected = f"transaction {request.transaction}, protocol {request.protocol}"
            what = f"transaction {transaction}, protocol {proto} to {expected}"
        elif length < 2:
            what = f"a reply of {length} bytes"
        elif len(received) > HEADER.size + 1:
            register, status = received[HEADER.size : HEADER.size + 2]
            if register != request.register:
                what = f"register {register} to {int(request.register)}"
            elif status & protocol.Status.INVALID:
                return length
            elif length != wanted:
                what = f"a reply of {length} bytes, not {wanted}"
        if what:
            raise InputError(
                f"{self._address}: replies with {what} (it begins {received[:8].hex(' ')}), which is no reply to the "
                "request; check that the address is the arm's control box, and read again"
            )
        return wanted


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
        self.address, self.port, self.place = address, port, f"{address.host}: port {port}"
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
            event, last = self.events.get(), events[-1] if events else None
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
        received, heard, index = bytearray(), time.monotonic(), self._connections
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
                heard, fault, reports = time.monotonic(), "", []
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
