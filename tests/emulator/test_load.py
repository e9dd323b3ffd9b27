"""Many clients at once, and clients that do not read: bounded memory, counted losses, and others undisturbed."""

import gc
import socket
from contextlib import ExitStack, suppress

import numpy as np
import pytest
from live import CONTROL_PORT, Line, new_host, read_reports, until

from lite6jax.controller import protocol
from lite6jax.emulator import Controller, server

MOST = 100_000


def idle(controller, port):
    """A connection that never reads, with as little of it held by this side's system as may be."""
    line = socket.socket()
    line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    line.connect((controller.address, port))
    return line


@pytest.mark.parametrize("speed", [1.0, 20.0])
def test_clients_that_never_read_are_closed_and_others_undisturbed(lite6, monkeypatch, speed):
    monkeypatch.setattr(server, "MOST_UNSENT", MOST)
    monkeypatch.setattr(server, "KERNEL_BUFFER", 4096)
    with (
        Controller(lite6, address=new_host(), control_port=CONTROL_PORT, speed=speed) as controller,
        ExitStack() as stack,
    ):
        asking = [stack.enter_context(Line(controller)) for _ in range(20)]
        for _ in range(20):
            stack.enter_context(idle(controller, protocol.REALTIME))
        waiting = []

        def closed():
            writers = [*controller._readers]
            waiting.append(
                controller.call(lambda _: max((w.transport.get_write_buffer_size() for w in writers), default=0))
            )
            return controller.slow_readers == 20

        until(closed, 30.0)
        assert MOST / 4 < max(waiting) < 6 * MOST  # what is sent in a round comes on top
        assert {line.ask(13)[6] for line in asking} == {13}
        monkeypatch.undo()  # on a busy machine this reader itself is slow at times
        assert set(np.diff(read_reports(controller, protocol.REALTIME, 100)["time_us"].astype(np.int64))) == {4000}


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
