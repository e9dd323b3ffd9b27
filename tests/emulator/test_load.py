"""Many clients at once, and clients that do not read: bounded memory, counted losses, and others undisturbed."""

import gc
import socket
from contextlib import ExitStack, suppress

import numpy as np
import pytest
from live import CONTROL_PORT, Line, new_host, read_reports, until

from lite6jax.controller import protocol
from lite6jax.emulator import Controller, server

CLIENTS = 200


def idle(controller, port):
    """A connection that never reads, with as little of it held by this side's system as may be."""
    line = socket.socket()
    line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    line.connect((controller.address, port))
    return line


def waiting(controller):
    """The bytes that the controller holds for its clients."""
    writers = [*controller._clients, *controller._readers]
    return controller.call(lambda _: sum(writer.transport.get_write_buffer_size() for writer in writers))


def connected(controller):
    """The connections to port 30000 that are or were there."""
    seen = controller.snapshot()
    return seen.connections[protocol.REALTIME] + seen.slow_readers


@pytest.mark.parametrize("speed", [1.0, 20.0])
def test_two_hundred_clients_of_which_most_never_read(lite6, monkeypatch, speed):
    most = 3_000_000
    monkeypatch.setattr(server, "MOST_UNSENT", most)
    monkeypatch.setattr(server, "KERNEL_BUFFER", 4096)
    monkeypatch.setattr(server, "GIVE_UP_S", 1.5)
    with (
        Controller(lite6, address=new_host(), control_port=CONTROL_PORT, speed=speed) as controller,
        ExitStack() as stack,
    ):
        asking = [stack.enter_context(Line(controller)) for _ in range(CLIENTS // 4)]
        lines, seen = [], []
        for _ in range(CLIENTS - len(asking)):
            lines.append(stack.enter_context(idle(controller, protocol.REALTIME)))
            seen.append(waiting(controller))

        def slow_readers():
            seen.append(waiting(controller))
            return controller.snapshot().slow_readers >= 20

        until(slow_readers, 30.0)
        # what is sent between two looks comes on top; a fast clock waits before much does
        assert (0 if speed > 1 else most / 4) < max(seen) < most + len(lines) * 200_000 / 2
        assert {line.ask(13)[6] for line in asking} == {13}
        assert set(np.diff(read_reports(controller, protocol.REALTIME, 100)["time_us"].astype(np.int64))) == {4000}
        until(lambda: connected(controller) == len(lines))


def test_a_connection_that_has_just_begun_is_closed_with_the_controller(lite6):
    """A task that is cancelled before its first step runs no `finally`."""
    for _ in range(5):
        with Controller(lite6, address=new_host(), control_port=CONTROL_PORT) as controller:
            lines = [socket.create_connection((controller.address, port)) for port in (CONTROL_PORT, 30000, 30003)]
        for line in lines:
            line.settimeout(5)
            with line, suppress(ConnectionError):
                while line.recv(4096):
                    pass
        gc.collect()  # a socket that nobody closed would warn
