"""The sockets of an emulated controller: one event loop, one arm, one clock."""

import asyncio
import socket
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
"""s, the real time between two rounds of sending, and the step of the emulated time."""
MOST_AT_ONCE_S = 4.0
"""s, the largest emulated time in one round."""
CATCH_UP_S = 0.25
"""s, the largest delay of a round that later rounds compensate."""
FRAGMENT_PAUSE_S = 2e-4
FRAGMENTED = 16
"""The number of bytes at the start of a report that a fault fragments finely; the others are sent in larger parts,
because a report port sends 196 000 bytes a second."""
SLOW_READER = 1 << 25
"""The number of bytes waiting for a reader, three minutes of port 30000, after which its connection is closed. A fast
clock waits from an eighth of it on."""
GIVE_UP_S = 30.0
"""s, the real time that a fast clock waits for a reader."""
MOST_UNSENT = 1 << 26
"""The number of bytes waiting for all clients together; beyond it the connections with most of them are closed. A fast
clock waits from half of it on."""
LOOK_EVERY_S = 0.1
"""s, the real time between two looks at what waits in real time: where many do not read, a look takes longer than a
tick."""
KERNEL_BUFFER = 1 << 18
"""The number of bytes that the operating system may hold for a connection, beside those counted here."""

_Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class Sockets:
    """Serves a core on an address until `stop`, the only method to be called outside the event loop.

    Attributes:
        core: the controller.
        loop: the event loop, once it serves.
        control_port: the bound one.
        clients: connections to the control port.
        readers: connections to each report port.
        unsent: the number of bytes that waited for all clients at the last look.
        given_up: the number of connections closed because they did not read.
        lost: the number of reports of each port that these had not been sent, in part or at all.
    """

    def __init__(self, core: Core, address: str, control_port: int, report_ports: Iterable[int], speed: float) -> None:
        """Nothing is opened before `serve`."""
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
        self.unsent = self.given_up = 0
        self.lost = dict.fromkeys(self.readers, 0)
        self._looked = 0.0

    async def serve(self, listening: Callable[[], None]) -> None:
        """Listens, calls `listening`, and serves until `stop`.

        Raises:
            OSError: a port is unavailable.
            Exception: an error while serving.
        """
        self.loop, self._stopped = asyncio.get_running_loop(), asyncio.Event()
        servers: list[asyncio.Server] = []
        try:
            handlers: list[tuple[int, _Handler]] = [(self.control_port, self._control)]
            handlers += [(port, self._listener(port)) for port in self.readers]
            for port, handler in handlers:
                servers.append(await asyncio.start_server(self._tracked(handler), self._address, port))
            self.control_port = servers[0].sockets[0].getsockname()[1]
            listening()
            clock = asyncio.create_task(self._clock())
            self._tasks.add(clock)
            stopped = asyncio.create_task(self._stopped.wait())
            await asyncio.wait({clock, stopped}, return_when=asyncio.FIRST_COMPLETED)
            stopped.cancel()
            if clock.done():
                clock.result()  # raises its exception
        finally:
            for server in servers:
                server.close()
            self.close_connections()
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            self._tasks.clear()
            await asyncio.sleep(0)  # in which the connections are closed
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Ends `serve`; callable from any thread."""
        if self.loop is not None and self._stopped is not None:
            with suppress(RuntimeError):  # the loop has already ended
                self.loop.call_soon_threadsafe(self._stopped.set)

    def close_connections(self) -> None:
        """Closes all connections."""
        for writer in [*self.clients, *(writer for writers in self.readers.values() for writer in writers)]:
            writer.transport.abort()

    def _tracked(self, handler: _Handler) -> Callable[[asyncio.StreamReader, asyncio.StreamWriter], None]:
        """The handler with its connections tracked as tasks, which closing cancels."""

        async def guarded(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            try:
                await handler(reader, writer)
            except (ConnectionError, TimeoutError):
                pass
            except Exception as error:  # raised by `serve`
                self._failure = error

        def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            task = asyncio.ensure_future(guarded(reader, writer))
            if (line := writer.get_extra_info("socket")) is not None:
                line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, KERNEL_BUFFER)
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
            # not in the task, which does nothing at all where it is cancelled before its first step
            task.add_done_callback(lambda _: writer.close())

        return accept

    async def _clock(self) -> None:
        """At every tick, sends the due reports and advances the emulated time."""
        loop, core = asyncio.get_running_loop(), self.core
        tick = loop.time()
        origin = tick - core.time / self._speed
        while True:
            tick = max(tick + TICK_S, loop.time())
            await asyncio.sleep(tick - loop.time())
            due = min(self._speed * (loop.time() - origin), core.time + self._most_at_once())
            if self._held_up(loop.time()):
                due = core.time
            # a longer delay slows the emulated clock, so that readers lose no reports
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

    def _most_at_once(self) -> float:
        """s of emulated time, of which the reports to all readers are a quarter of `MOST_UNSENT` at most."""
        rate = sum(len(at) * protocol.LENGTHS[port] * protocol.RATES[port] for port, at in self.readers.items())
        return min(MOST_AT_ONCE_S, MOST_UNSENT / 4 / rate) if rate else MOST_AT_ONCE_S

    def _held_up(self, now: float) -> bool:
        """Whether a fast clock must wait for readers; closes the connections of those that do not read."""
        fast = self._speed > 1
        if not fast and now - self._looked < LOOK_EVERY_S:
            return False
        self._looked = now
        ports = {writer: port for port, writers in self.readers.items() for writer in writers}
        waiting = {writer: writer.transport.get_write_buffer_size() for writer in (*ports, *self.clients)}
        slow = [writer for writer in ports if waiting[writer] > (SLOW_READER // 8 if fast else SLOW_READER)]
        waits = fast and (bool(slow) or sum(waiting.values()) > MOST_UNSENT // 2)
        if not waits:
            self._held_since = now
        elif now - self._held_since <= GIVE_UP_S:
            slow = []
        for writer in slow:
            self._give_up(writer, ports.get(writer), waiting.pop(writer))
        # those that wait longest for their reader; a fast clock first waits for them too
        allowed = MOST_UNSENT // 2 if fast and now - self._held_since > GIVE_UP_S else MOST_UNSENT
        for writer in sorted(waiting, key=lambda writer: waiting[writer], reverse=True):
            if sum(waiting.values()) <= allowed:
                break
            self._give_up(writer, ports.get(writer), waiting.pop(writer))
        self.unsent = sum(waiting.values())
        return waits

    def _give_up(self, writer: asyncio.StreamWriter, port: int | None, waiting: int) -> None:
        if writer.transport.is_closing():
            return
        self.given_up += 1
        if port is not None:
            self.lost[port] += -(-waiting // protocol.LENGTHS[port])
        writer.transport.abort()

    def _send(self, port: int, index: NDArray[np.integer], reports: bytes) -> None:
        """Sends reports to all readers of a port, except those omitted by faults."""
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
                    pass  # a report port ignores input
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
                    return  # closes the connection
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
    """Reports of `size` bytes each, complete or fragmented."""
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
