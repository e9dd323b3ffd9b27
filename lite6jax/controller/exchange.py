"""Connections to a controller with one deadline for a whole exchange, and messages with the cause of a failure."""

import ipaddress
import socket
import time
from dataclasses import dataclass
from typing import NamedTuple

from lite6jax.controller.protocol import CONTROL_PORT
from lite6jax.errors import InputError


@dataclass(frozen=True)
class Address:
    """The IPv4 address of a controller, and its control port, which may differ from 502 for an emulator."""

    host: str
    port: int = CONTROL_PORT

    def __str__(self) -> str:
        return self.host if self.port == CONTROL_PORT else f"{self.host}:{self.port}"


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
    return Address(host, int(port) if colon else CONTROL_PORT)


class Deadline(NamedTuple):
    """The instant by which a whole exchange must be complete."""

    end: float

    @classmethod
    def after(cls, seconds: float) -> "Deadline":
        """The deadline in `seconds` from now."""
        return cls(time.monotonic() + seconds)

    def left(self) -> float:
        """The remaining time in s; zero or less after the deadline."""
        return self.end - time.monotonic()


class BrokenOffError(Exception):
    """A message ended early. `received` is its first part; `closed` whether the peer closed the connection."""

    def __init__(self, received: bytes, closed: bool) -> None:
        super().__init__(received, closed)
        self.received, self.closed = received, closed


def connect(host: str, port: int, deadline: Deadline) -> socket.socket:
    """A connected socket.

    Raises:
        InputError: connection refused, no reply by the deadline, or an unreachable network.
    """
    place = f"{host}: port {port}"
    connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    connection.settimeout(max(deadline.left(), 1e-3))
    try:
        connection.connect((host, port))
    except TimeoutError as error:
        connection.close()
        raise InputError(
            f"{place}: no reply; check the address, that the control box is on, and that this computer is "
            "on its network (ping it)"
        ) from error
    except ConnectionRefusedError as error:
        connection.close()
        raise InputError(
            f"{place}: nothing listens there; check the address, and that the control box has finished starting (a "
            "minute)"
        ) from error
    except OSError as error:
        connection.close()
        raise InputError(
            f"{place}: cannot be reached ({error.strerror or error}); check the address and this computer's network"
        ) from error
    return connection


def receive(connection: socket.socket, count: int, deadline: Deadline, before: bytes = b"") -> bytes:
    """Exactly `count` bytes, however they are fragmented.

    Args:
        connection: a socket.
        count: the number of bytes.
        deadline: for all of them together.
        before: the first part of the same message, for `BrokenOffError`.

    Raises:
        BrokenOffError: the deadline passed, or the peer closed the connection.
    """
    received = bytearray()
    while len(received) < count:
        left = deadline.left()
        if left <= 0:
            raise BrokenOffError(before + bytes(received), closed=False)
        connection.settimeout(left)
        try:
            piece = connection.recv(count - len(received))
        except TimeoutError:
            continue
        except OSError as error:  # reset by the peer
            raise BrokenOffError(before + bytes(received), closed=True) from error
        if not piece:
            raise BrokenOffError(before + bytes(received), closed=True)
        received += piece
    return bytes(received)
