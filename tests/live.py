"""Emulated controllers on addresses of their own, plain sockets that ask them, and servers that misbehave."""

import itertools
import os
import socket
import threading
import time
from collections import Counter
from contextlib import closing, contextmanager, suppress
from functools import partial
from types import SimpleNamespace
from unittest import mock
from weakref import WeakKeyDictionary

import numpy as np

from lite6jax.arms.description import load_bundled
from lite6jax.controller import protocol
from lite6jax.controller.connection import Address
from lite6jax.emulator import Controller, EmulatedArm, server
from tests.oracles.arms import perturbed

ARM = load_bundled("lite6")
KINEMATICS = perturbed(np.random.default_rng(3), ARM.kinematics).astype(np.float32).astype(float)
"""What an arm's own calibration can hold: 32-bit numbers."""
CONTROL_PORT = 15021
_HOSTS = itertools.count(1)
_REQUESTS = WeakKeyDictionary()
"""Of each emulated controller, how often each register was asked for."""


def new_host():
    """An address of loopback that no other test has, in this process or another."""
    worker = int("".join(filter(str.isdigit, os.environ.get("PYTEST_XDIST_WORKER", "0"))) or 0)
    return f"127.{64 + worker}.{os.getpid() % 254 + 1}.{next(_HOSTS)}"


def _count(answer, core, request):
    """The emulator's reply; the request is counted."""
    _REQUESTS.setdefault(core, Counter())[request.register] += 1
    return answer(core, request)


@contextmanager
def emulated(body=None, **options):
    """A controller, of the calibrated arm where no body is given, and its address."""
    options = {"address": new_host(), "control_port": CONTROL_PORT} | options
    counting = mock.patch.object(server, "answer", partial(_count, server.answer))
    with counting, Controller(body or EmulatedArm(ARM, KINEMATICS), **options) as controller:
        yield controller, Address(controller.address, controller.control_port)


def snapshot(controller):
    """Time, state, joints and requests of a controller, between two steps of its clock."""

    def look(core):
        joints = core.read_encoders(np.array([core.time]))[0][0]
        return SimpleNamespace(time=core.time, state=core.state, joints=joints, requests=dict(_REQUESTS.get(core, {})))

    return controller.call(look)


@contextmanager
def serving(answer, port=CONTROL_PORT):
    """A server that gives each connection to `answer`, and its address."""
    host = new_host()
    with closing(socket.create_server((host, port))) as server:
        stopped = threading.Event()

        def serve():
            while not stopped.is_set():
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                threading.Thread(target=converse, args=(connection,), daemon=True).start()

        def converse(connection):
            with closing(connection), suppress(OSError):
                answer(connection)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        try:
            yield Address(host, port)
        finally:
            stopped.set()
            server.shutdown(socket.SHUT_RDWR)
            thread.join()


def until(condition, seconds=60.0):
    """Waits for something to become true."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.005)


def reply(rows=KINEMATICS, valid=1, dof=6, kind=9, transaction=1, proto=2, register=8, status=0, payload=None):
    """A reply to the calibration read, right where nothing else is given."""
    if payload is None:
        payload = protocol.Calibration(valid, dof, kind, np.asarray(rows)).encode()
    return protocol.Message(register, bytes([status]) + payload, transaction, proto).encode()


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


class Line:
    """A plain socket to the control port."""

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
        return self.send(protocol.Message(register))

    def _exactly(self, count):
        received = b""
        while len(received) < count:
            chunk = self.socket.recv(count - len(received))
            if not chunk:
                raise EOFError(received)
            received += chunk
        return received
