"""Addresses of their own for emulated controllers, and plain sockets that ask them and read their reports."""

import itertools
import os
import socket
import time

import numpy as np

from lite6jax.controller import protocol

CONTROL_PORT = 15020
_ADDRESSES = itertools.count(1)


def new_address():
    """An address of loopback that no other test has, in this process or another."""
    worker = int("".join(filter(str.isdigit, os.environ.get("PYTEST_XDIST_WORKER", "0"))) or 0)
    return f"127.{64 + worker}.{os.getpid() % 254 + 1}.{next(_ADDRESSES)}"


def read_reports(controller, port, count, chunk=1 << 16):
    """`(count,)` records of a port."""
    buffer, reports = bytearray(), []
    with socket.create_connection((controller.address, port), timeout=10) as line:
        while len(reports) < count:
            received = line.recv(chunk)
            assert received, "it hung up"
            buffer += received
            reports += protocol.take_reports(buffer)
    return np.frombuffer(b"".join(reports[:count]), protocol.report_layout(port))


def until(condition, seconds=60.0):
    """Waits for something to become true."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.005)


class Line:
    """A plain socket to port 502."""

    def __init__(self, controller):
        self.socket = socket.create_connection((controller.address, controller.control_port), timeout=5)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def receive(self):
        """The next message, whole."""
        header = self._exactly(6)
        return header + self._exactly(int.from_bytes(header[4:6], "big"))

    def send(self, request):
        """The bytes of the reply."""
        self.socket.sendall(request.encode())
        return self.receive()

    def ask(self, register):
        """The bytes of the reply to a request of nothing but a register."""
        self.socket.sendall(bytes([0, 1, 0, 2, 0, 1, register]))
        return self.receive()

    def _exactly(self, count):
        received = b""
        while len(received) < count:
            chunk = self.socket.recv(count - len(received))
            if not chunk:
                raise EOFError(received)
            received += chunk
        return received
