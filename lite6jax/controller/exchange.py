"""Sockets with one deadline: reach a controller, read just so many bytes, and say in a line why that failed."""

import ipaddress
import socket
import time
from dataclasses import dataclass
from typing import NamedTuple

from lite6jax.controller.protocol import CONTROL_PORT
from lite6jax.errors import InputError


@dataclass(frozen=True)
class Address:
    """Where a controller is: an IPv4 address, and its control port where that is not 502 (an emulator's may not be)."""

    host: str
    port: int = CONTROL_PORT

    def __str__(self) -> str:
        return self.host if self.port == CONTROL_PORT else f"{self.host}:{self.port}"


def parse_address(text: str) -> Address:
    """An address as it is typed: `192.168.1.185`, `localhost`, `127.0.0.1:1502`.

    Names are not looked up: that has no deadline, and the SDK takes none.

    Raises:
        InputError: it is no such address.
    """
    host, colon, port = text.strip().partition(":")
    host = "127.0.0.1" if host == "localhost" else host
    try:
        ipaddress.IPv4Address(host)
        if colon and not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
            raise ValueError
    except ValueError as error:
        raise InputError(
            f"--ip {text}: is no IPv4 address; give the one that the control box shows, such as 192.168.1.185"
        ) from error
    return Address(host, int(port) if colon else CONTROL_PORT)


class Deadline(NamedTuple):
    """One moment by which all of an exchange must have happened, however many bytes it takes."""

    end: float

    @classmethod
    def after(cls, seconds: float) -> "Deadline":
        """`seconds` from now."""
        return cls(time.monotonic() + seconds)

    def left(self) -> float:
        """Seconds until then; zero or less when it has passed."""
        return self.end - time.monotonic()


class BrokenOffError(Exception):
    """Bytes stopped coming. `received` is what came; `closed` whether the other side hung up, or fell silent."""

    def __init__(self, received: bytes, closed: bool) -> None:
        super().__init__(received, closed)
        self.received, self.closed = received, closed


def connect(host: str, port: int, deadline: Deadline) -> socket.socket:
    """A connected socket.

    Raises:
        InputError: nothing listens there, no answer by the deadline, or no way there.
    """
    place = f"{host}: port {port}"
    connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    connection.settimeout(max(deadline.left(), 1e-3))
    try:
        connection.connect((host, port))
    except TimeoutError as error:
        connection.close()
        raise InputError(
            f"{place}: no answer to the call; check the address, that the control box is on, and that this computer is "
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
    """Just so many bytes, in whatever pieces they come.

    Args:
        connection: a socket.
        count: how many.
        deadline: for all of them together.
        before: what of the same message came before, for `BrokenOffError`.

    Raises:
        BrokenOffError: the deadline passed, or the other side closed.
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
        except OSError as error:  # reset by the other side
            raise BrokenOffError(before + bytes(received), closed=True) from error
        if not piece:
            raise BrokenOffError(before + bytes(received), closed=True)
        received += piece
    return bytes(received)
