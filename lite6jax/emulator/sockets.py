"""The sockets of an emulated controller: one event loop, one arm, one clock."""

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Iterator
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from lite6jax.controller import protocol
from lite6jax.controller.protocol import Frame, MalformedError
from lite6jax.emulator.core import Client, Core
from lite6jax.emulator.registers import answer
from lite6jax.emulator.reports import report

TICK_S = 1 / protocol.RATES[protocol.REALTIME]
"""Real time between two rounds of sending, and the step of the emulated time."""
MOST_AT_ONCE_S = 4.0
"""Emulated time in one round."""
CATCH_UP_S = 0.25
"""Real time that is made up for when a round comes late."""
FRAGMENT_PAUSE_S = 2e-4
FRAGMENTED = 16
"""Bytes at the start of a report that a fault sends apart; what follows it sends in larger pieces, or no machine would
keep up with 196 000 bytes a second."""
SLOW_READER = 1 << 25
"""Bytes that wait for a reader before it is given up, some three minutes of port 30000. A fast clock waits at an eighth
of it."""
GIVE_UP_S = 30.0
"""Real time that a fast clock waits for a reader."""

_Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class Sockets:
    """Serves a core on an address until it is told to stop. Everything but `stop` happens within its event loop.

    Attributes:
        core: the controller.
        loop: the event loop, once it serves.
        control_port: as bound.
        clients: connections to the control port.
        readers: connections to each report port.
    """

    def __init__(self, core: Core, address: str, control_port: int, report_ports: Iterable[int], speed: float) -> None:
        """Nothing is opened yet."""
        self.core, self.control_port = core, control_port
        self.clients: list[asyncio.StreamWriter] = []
        self.readers: dict[int, list[asyncio.StreamWriter]] = {port: [] for port in report_ports}
        self.loop: asyncio.AbstractEventLoop | None = None
        self._address, self._speed = address, speed
        self._stopped: asyncio.Event | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._sent: dict[asyncio.StreamWriter, int] = {}
        self._failure: Exception | None = None
        self._held_since = 0.0
        self._garbage = np.random.default_rng(0)

    async def serve(self, listening: Callable[[], None]) -> None:
        """Listens, calls `listening`, and goes on until `stop`.

        Raises:
            OSError: a port cannot be had.
            Exception: whatever went wrong while it served.
        """
        self.loop, self._stopped = asyncio.get_running_loop(), asyncio.Event()
        servers: list[asyncio.Server] = []
        try:
            handlers: list[tuple[int, _Handler]] = [(self.control_port, self._control)]
            handlers += [(port, self._listener(port)) for port in self.readers]
            for port, handler in handlers:
                servers.append(await asyncio.start_server(self._kept(handler), self._address, port))
            self.control_port = servers[0].sockets[0].getsockname()[1]
            listening()
            clock = asyncio.create_task(self._clock())
            self._tasks.add(clock)
            stopped = asyncio.create_task(self._stopped.wait())
            await asyncio.wait({clock, stopped}, return_when=asyncio.FIRST_COMPLETED)
            stopped.cancel()
            if clock.done():
                clock.result()  # raises what ended it
        finally:
            for server in servers:
                server.close()
            self.hang_up()
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            self._tasks.clear()
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Ends `serve`; from any thread."""
        if self.loop is not None and self._stopped is not None:
            with suppress(RuntimeError):  # it has ended by itself
                self.loop.call_soon_threadsafe(self._stopped.set)

    def hang_up(self) -> None:
        """Closes every connection there is."""
        for writer in [*self.clients, *(writer for writers in self.readers.values() for writer in writers)]:
            writer.transport.abort()

    def _kept(self, handler: _Handler) -> Callable[[asyncio.StreamReader, asyncio.StreamWriter], None]:
        """Connections as tasks of ours, so that closing ends them."""

        async def guarded(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            try:
                await handler(reader, writer)
            except (ConnectionError, TimeoutError):
                pass
            except Exception as error:  # ours: `serve` raises it
                self._failure = error
            finally:
                writer.close()

        def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            task = asyncio.ensure_future(guarded(reader, writer))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

        return accept

    async def _clock(self) -> None:
        """Every tick the emulated time goes on, and what became due meanwhile is sent."""
        loop, core = asyncio.get_running_loop(), self.core
        tick = loop.time()
        origin = tick - core.time / self._speed
        while True:
            tick = max(tick + TICK_S, loop.time())
            await asyncio.sleep(tick - loop.time())
            due = min(self._speed * (loop.time() - origin), core.time + MOST_AT_ONCE_S)
            if self._held_up(loop.time()):
                due = core.time
            # what is later than can be made up for is lost to the clock, and not to those who read
            origin = max(origin, loop.time() - CATCH_UP_S - due / self._speed)
            due = float(np.floor(due / TICK_S + 1e-9) * TICK_S)
            if due <= core.time:
                continue
            for port in self.readers:
                if self.readers[port] and not core.faults.silent_reports:
                    rate = protocol.RATES[port]
                    first, last = (int(np.floor(time * rate + 1e-6)) for time in (core.time, due))
                    if last > first:
                        index = np.arange(first + 1, last + 1)
                        self._send(port, index, report(core, port, index / rate))
            core.advance(due)

    def _held_up(self, now: float) -> bool:
        """Whether a fast clock has to wait for a reader; those that do not read are given up."""
        waiting = {
            writer: writer.transport.get_write_buffer_size() for writers in self.readers.values() for writer in writers
        }
        slow = [writer for writer, size in waiting.items() if size > SLOW_READER // 8]
        if not slow:
            self._held_since = now
        hopeless = now - self._held_since > GIVE_UP_S and self._speed > 1
        for writer in slow:
            if hopeless or (self._speed <= 1 and waiting[writer] > SLOW_READER):
                writer.transport.abort()
        return bool(slow) and self._speed > 1

    def _send(self, port: int, index: NDArray[np.integer], reports: bytes) -> None:
        """To all readers of a port, less what faults leave out."""
        faults, size = self.core.faults, len(reports) // len(index)
        if faults.lose_every and port == protocol.REALTIME:
            kept = [k for k, i in enumerate(index) if i % faults.lose_every]
            reports = b"".join(reports[k * size : (k + 1) * size] for k in kept)
        for writer in list(self.readers[port]):
            if writer.transport.is_closing():
                continue
            whole = faults.close_reports_after
            if whole is not None:
                left = whole * size + size // 2 - self._sent[writer]
                if len(reports) >= left:
                    writer.write(reports[: max(left, 0)])
                    writer.close()
                    continue
            self._sent[writer] += len(reports)
            for piece in _pieces(reports, size, faults.fragment):
                writer.write(piece)

    def _listener(self, port: int) -> _Handler:
        async def listen(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            self._sent[writer] = 0
            self.readers[port].append(writer)
            try:
                while await reader.read(4096):
                    pass  # a report port hears nothing
            finally:
                self.readers[port].remove(writer)
                del self._sent[writer]

        return listen

    async def _control(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        received = bytearray()
        client = Client(lambda frame: None if writer.is_closing() else writer.write(frame.encode()))
        self.clients.append(writer)
        try:
            while chunk := await reader.read(65536):
                received += chunk
                try:
                    for frame in protocol.take_frames(received):
                        await self._reply(frame, client, writer)
                except MalformedError:
                    return  # hangs up
        finally:
            self.clients.remove(writer)

    async def _reply(self, frame: Frame, client: Client, writer: asyncio.StreamWriter) -> None:
        core, faults = self.core, self.core.faults
        reply = answer(core, frame, client)
        if reply is None:
            return
        if faults.latency:
            await asyncio.sleep(faults.latency)
        message = reply.encode()
        if faults.garbage:
            message = self._garbage.bytes(len(message))
        if faults.close_after is not None and len(message) > faults.close_after:
            writer.write(message[: faults.close_after])
            await writer.drain()
            writer.close()
            raise ConnectionAbortedError
        if not faults.fragment:
            writer.write(message)
        for first in range(0, len(message) if faults.fragment else 0, max(faults.fragment, 1)):
            writer.write(message[first : first + faults.fragment])
            await writer.drain()
            await asyncio.sleep(FRAGMENT_PAUSE_S)
        await writer.drain()


def _pieces(reports: bytes, size: int, fragment: int) -> Iterator[bytes]:
    """Reports of a size each, whole or cut up."""
    if not fragment:
        yield reports
        return
    coarse = max(fragment, size // 8)
    for start in range(0, len(reports), size):
        report = reports[start : start + size]
        for first in range(0, FRAGMENTED, fragment):
            yield report[first : min(first + fragment, FRAGMENTED)]
        for first in range(FRAGMENTED, size, coarse):
            yield report[first : first + coarse]
