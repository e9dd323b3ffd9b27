"""An emulated controller on the network: one arm, one clock, and sockets on an event loop in a separate thread."""

import asyncio
import errno
import ipaddress
import socket
import threading
from collections.abc import Awaitable, Callable, Iterable
from concurrent.futures import Future
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.array_types import Integers
from lite6jax.controller import protocol
from lite6jax.emulator.body import EmulatedArm
from lite6jax.emulator.core import Core, Faults, answer, report
from lite6jax.errors import InputError
from lite6jax.simulation.motions import Path

_T = TypeVar("_T")
_Writer = asyncio.StreamWriter
_Handler = Callable[[asyncio.StreamReader, _Writer], Awaitable[None]]

PLAUSIBLE = 1e4
"""mm of a tool, kg of a payload; larger values and values that are not finite are refused."""
CALL_S = 30.0
"""s, the time limit of a call between threads."""
TICK_S = 1 / protocol.RATES[protocol.REALTIME]
"""s, the real time between two rounds of sending, and the step of the emulated time."""
MOST_AT_ONCE_S = 0.5
"""s, the largest emulated time in one round."""
CATCH_UP_S = 0.25
"""s, the largest delay of a round that later rounds compensate."""
MOST_UNSENT = 1 << 26
"""The number of bytes that may wait for a reader of reports, five minutes of port 30000. A connection with more is
closed: its reader does not read."""
KERNEL_BUFFER = 1 << 18
"""The number of bytes that the operating system may hold for a connection, beside those counted here."""


class Controller:
    """An emulated UFACTORY controller on loopback, to which the unmodified xarm-python-sdk connects.

    ```python
    with Controller(body, address="127.0.0.5", control_port=5020) as controller:
        XCONF.SocketConf.TCP_CONTROL_PORT = controller.control_port
        arm = XArmAPI(controller.address)
    ```

    The report ports are 30000 to 30003 of that address, which are fixed in the SDK, so that each controller needs
    an address of its own. The effects of the body appear only in the pose on port 30000; the module `core` describes
    each port. All public methods may be called from any thread.

    Attributes:
        slow_readers: the number of connections closed because their clients did not read.
    """

    def __init__(
        self,
        body: EmulatedArm,
        *,
        path: Path | None = None,
        faults: Faults = Faults(),  # noqa: B008 (frozen)
        tool: ArrayLike = (0.0,) * 6,
        payload: ArrayLike = (0.0,) * 4,
        address: str = "127.0.0.1",
        control_port: int = protocol.CONTROL_PORT,
        report_ports: Iterable[int] = tuple(protocol.RATES),
        speed: float = 1.0,
    ) -> None:
        """Nothing is opened before `open` or the `with` statement.

        Args:
            body: the arm.
            path: the motion from the start; None for rest at zero.
            faults: of the controller; `set_faults` changes them.
            tool: `(6,)` mm and rad, the tool offset.
            payload: `(4,)` kg at the flange and its centre of mass in mm.
            address: on loopback.
            control_port: 502 requires privileges; 0 selects a free port, which is then this attribute.
            report_ports: the emulated report ports.
            speed: of the controller's clock relative to real time.

        Raises:
            InputError: an address outside loopback, a speed that is not positive, or an invalid tool or payload.
        """
        try:
            loopback = ipaddress.IPv4Address(address).is_loopback
        except ValueError as error:
            raise InputError(f"{address!r}: is not an address; write it like 127.0.0.1") from error
        if not loopback:
            raise InputError(
                f"{address}: is not on loopback: an emulator must not be reachable from a network; choose 127.x.y.z"
            )
        if not 0 < speed < np.inf:
            raise InputError(f"speed {speed}: the clock runs forward; give a number above 0")
        if not 0 <= control_port <= 65535:
            raise InputError(f"control port {control_port}: is not a port; give 0 to 65535")
        offset = np.array(tool, float)
        load = np.array(payload, float)
        for name, values in (("tool", offset), ("payload", load)):
            if not (np.abs(values) < PLAUSIBLE).all():
                shown = " ".join(f"{value:g}" for value in values)
                raise InputError(f"{name} {shown}: is implausible for an arm; give mm, radians and kg")
        self.body = body
        self.address = address
        self.control_port = control_port
        self.speed = float(speed)
        self._core = Core(body, faults, path, offset, load)
        self._report_ports = tuple(report_ports)
        self._readers: dict[_Writer, int] = {}  # their ports
        self._sent: dict[_Writer, int] = {}
        self._clients: set[_Writer] = set()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._failure: Exception | None = None
        self.slow_readers = 0
        report(self._core, protocol.REALTIME, np.zeros(1))  # compiled before a client waits for it

    def open(self) -> "Controller":
        """Starts the thread and listens.

        Raises:
            InputError: a port is unavailable; the message names an alternative.
        """
        listening: Future[None] = Future()

        def serve() -> None:
            try:
                asyncio.run(self._serve(listening))
            except Exception as error:
                if listening.done():
                    self._failure = error
                else:
                    listening.set_exception(error)

        self._failure = None
        self._stop.clear()
        self._thread = threading.Thread(target=serve, name=f"emulator {self.address}", daemon=True)
        self._thread.start()
        try:
            listening.result()
        except OSError as error:
            self._thread.join()
            raise InputError(self._refusal(error)) from error
        return self

    def _refusal(self, error: OSError) -> str:
        where = f"{self.address}:{self.control_port}"
        if error.errno in (errno.EACCES, errno.EPERM) and self.control_port < 1024:
            return (
                f"{where}: ports below 1024 require privileges; add --control-port 5020, and before the "
                "SDK connects run from xarm.core.config.x_config import XCONF; XCONF.SocketConf.TCP_CONTROL_PORT = 5020"
            )
        if error.errno == errno.EADDRINUSE:
            return (
                f"{self.address}: its control port {self.control_port} or a report port 30000 to 30003 is in use, "
                "possibly by another emulator; choose another address, such as 127.0.0.9"
            )
        if error.errno == errno.EADDRNOTAVAIL:
            return (
                f"{self.address}: this system has only 127.0.0.1 by default (macOS: sudo ifconfig lo0 alias "
                f"{self.address}); choose that or add it"
            )
        return f"{where}: {error.strerror or error}; choose another address or --control-port"

    def close(self) -> None:
        """Closes all connections and ends the thread.

        Raises:
            Exception: the one that ended the thread.
        """
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        if self._failure is not None:
            raise self._failure

    def __enter__(self) -> "Controller":
        return self.open()

    def __exit__(self, *error: object) -> None:
        self.close()

    def call(self, do: Callable[[Core], _T]) -> _T:
        """The result of `do` for the controller's core, between two steps of its clock."""
        if self._loop is None or self._thread is None or not self._thread.is_alive():
            return do(self._core)

        async def act() -> _T:
            return do(self._core)

        return asyncio.run_coroutine_threadsafe(act(), self._loop).result(CALL_S)

    def set_faults(self, faults: Faults) -> None:
        """Replaces the faults; one with an error stops the arm."""
        self.call(lambda core: core.set_faults(faults))

    async def _serve(self, listening: "Future[None]") -> None:
        """Listens, and serves until it is stopped.

        Raises:
            OSError: a port is unavailable.
            Exception: an error while serving.
        """
        self._loop = asyncio.get_running_loop()
        servers: list[asyncio.Server] = []
        try:
            listeners = [(port, partial(self._listen, port)) for port in self._report_ports]
            for port, handler in [(self.control_port, self._control), *listeners]:
                servers.append(await asyncio.start_server(partial(self._handle, handler), self.address, port))
            self.control_port = servers[0].sockets[0].getsockname()[1]
            listening.set_result(None)
            await self._run_clock()
        finally:
            for server in servers:
                server.close()
            # in which connections begin that were just accepted: one that is cancelled before is never closed
            await asyncio.sleep(0.01)
            for writer in (*self._clients, *self._readers):
                writer.transport.abort()

    async def _handle(self, handler: _Handler, reader: asyncio.StreamReader, writer: _Writer) -> None:
        """Serves a connection until it ends, or the controller does."""
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, KERNEL_BUFFER)
        try:
            await handler(reader, writer)
        except (ConnectionError, TimeoutError, asyncio.CancelledError):
            pass
        except Exception as error:
            self._failure = error
        finally:
            writer.close()

    async def _run_clock(self) -> None:
        """Until it is stopped, sends the due reports and advances the emulated time at every tick.

        Closes connections for which too much waits.
        """
        loop = asyncio.get_running_loop()
        core = self._core
        tick = loop.time()
        origin = tick - core.time / self.speed
        while not self._stop.is_set():
            tick = max(tick + TICK_S, loop.time())
            await asyncio.sleep(tick - loop.time())
            for writer in self._readers:
                if writer.transport.get_write_buffer_size() > MOST_UNSENT:
                    self.slow_readers += not writer.transport.is_closing()
                    writer.transport.abort()
            due = min(self.speed * (loop.time() - origin), core.time + MOST_AT_ONCE_S)
            # a longer delay slows the emulated clock, so that readers lose no reports
            origin = max(origin, loop.time() - CATCH_UP_S - due / self.speed)
            due = float(np.floor(due / TICK_S + 1e-9) * TICK_S)
            if due <= core.time:
                continue
            for port in set(() if core.faults.silent_reports else self._readers.values()):
                rate = protocol.RATES[port]
                first, last = (int(np.floor(time * rate + 1e-6)) for time in (core.time, due))
                if last > first:
                    index = np.arange(first + 1, last + 1)
                    self._send(port, index, report(core, port, index / rate))
            core.advance(due)

    def _send(self, port: int, index: Integers, reports: bytes) -> None:
        """Sends reports to all readers of a port, except those omitted by faults."""
        faults = self._core.faults
        size = len(reports) // len(index)
        if faults.lose_every and port == protocol.REALTIME:
            delivered = [k for k, i in enumerate(index) if i % faults.lose_every]
            reports = b"".join(reports[k * size : (k + 1) * size] for k in delivered)
        for writer in [writer for writer, its in self._readers.items() if its == port]:
            if writer.transport.is_closing():
                continue
            if (reports_before_closing := faults.close_reports_after) is not None:
                bytes_remaining = reports_before_closing * size + size // 2 - self._sent[writer]
                if len(reports) >= bytes_remaining:
                    writer.write(reports[: max(bytes_remaining, 0)])
                    writer.close()
                    continue
            self._sent[writer] += len(reports)
            writer.write(reports)

    async def _listen(self, port: int, reader: asyncio.StreamReader, writer: _Writer) -> None:
        self._readers[writer] = port
        self._sent[writer] = 0
        try:
            while await reader.read(4096):
                pass  # a report port ignores input
        finally:
            del self._readers[writer], self._sent[writer]

    async def _control(self, reader: asyncio.StreamReader, writer: _Writer) -> None:
        received = bytearray()
        self._clients.add(writer)
        try:
            while chunk := await reader.read(65536):
                received += chunk
                for frame in protocol.take_frames(received):
                    reply = answer(self._core, frame)
                    if reply is not None:
                        await asyncio.sleep(self._core.faults.latency)
                        writer.write(reply.encode())
                        await writer.drain()
        except protocol.MalformedError:
            pass  # closes the connection
        finally:
            self._clients.remove(writer)
