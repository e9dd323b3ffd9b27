"""Arms for these tests: emulated controllers on addresses of their own, and sockets that misbehave on purpose."""

import itertools
import os
import socket
import threading
from contextlib import closing, contextmanager, suppress

import numpy as np

from lite6jax.arms.description import load_bundled
from lite6jax.controller import protocol
from lite6jax.controller.connection import Address
from lite6jax.emulator import Body, Controller
from tests.oracles.arms import perturbed

ARM = load_bundled("lite6")
KINEMATICS = perturbed(np.random.default_rng(3), ARM.kinematics).astype(np.float32).astype(float)
"""What an arm's own calibration can hold: 32-bit numbers."""
PORT = 15021
_HOSTS = itertools.count(1)


def new_host():
    """An address of loopback that no other test has, in this process or another."""
    worker = int("".join(filter(str.isdigit, os.environ.get("PYTEST_XDIST_WORKER", "0"))) or 0)
    return f"127.{160 + worker}.{os.getpid() % 254 + 1}.{next(_HOSTS)}"


@contextmanager
def emulated(**options):
    """A controller of the calibrated arm, and its address."""
    body = options.pop("body", None) or Body(ARM, KINEMATICS)
    options = {"address": new_host(), "control_port": PORT} | options
    with Controller(body, **options) as controller:
        yield controller, Address(controller.address, controller.control_port)


@contextmanager
def serving(answer, port=PORT):
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


def reply(rows=KINEMATICS, valid=1, dof=6, kind=9, transaction=1, proto=2, register=8, status=0, payload=None):
    """A reply to the calibration read, right where nothing else is given."""
    if payload is None:
        payload = protocol.Calibration(valid, dof, kind, np.asarray(rows)).encode()
    return protocol.Frame(register, bytes([status]) + payload, transaction, proto).encode()
