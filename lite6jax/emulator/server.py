"""An emulated controller whose sockets run in a separate thread."""

import asyncio
import errno
import ipaddress
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from types import TracebackType
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.controller import protocol
from lite6jax.emulator.body import Body
from lite6jax.emulator.core import STOPPED, Core
from lite6jax.emulator.faults import Faults
from lite6jax.emulator.paths import Path
from lite6jax.emulator.registers import PLAUSIBLE
from lite6jax.emulator.reports import report
from lite6jax.emulator.sockets import Sockets
from lite6jax.errors import InputError

Array = NDArray[np.floating]
_T = TypeVar("_T")

CALL_S = 30.0
"""s, the time limit of a call between threads."""
_PRIVILEGED = 1024


class Snapshot(NamedTuple):
    """The state of a controller at an instant.

    Attributes:
        time: s on its clock.
        state: 1 moving, 2 ready, 3 paused, 4 stopped, 5 reset.
        mode: 0 position, 1 servo.
        error: its code, or 0.
        joints: `(joint,)` rad, measured.
        requests: the number of requests of each register.
        connections: the number of connections to each port, the control port being 502 whatever its number.
        unsent: the number of bytes that wait for clients to read them, of all connections, at the last look.
        given_up: the number of connections closed because their clients did not read.
        lost: the number of reports of each port that these were not sent, in part or at all.
    """

    time: float
    state: int
    mode: int
    error: int
    joints: Array
    requests: dict[int, int]
    connections: dict[int, int]
    unsent: int
    given_up: int
    lost: dict[int, int]


class Controller:
    """An emulated UFACTORY controller on loopback, to which the unmodified xarm-python-sdk connects.

    ```python
    with Controller(body, address="127.0.0.5", control_port=5020) as controller:
        XCONF.SocketConf.TCP_CONTROL_PORT = controller.control_port
        arm = XArmAPI(controller.address)
    ```

    The report ports are 30000 to 30003 of that address, which are fixed in the SDK, so that each controller needs
    an address of its own. The effects of the body appear only in the pose on port 30000; the module `reports` describes
    each port. All methods may be called from any thread.
    """

    def __init__(
        self,
        body: Body,
        *,
        path: Path | None = None,
        start: ArrayLike | None = None,
        faults: Faults = Faults(),  # noqa: B008 (frozen)
        tool: ArrayLike = (0.0,) * 6,
        payload: ArrayLike = (0.0,) * 4,
        address: str = "127.0.0.1",
        control_port: int = protocol.CONTROL_PORT,
        report_ports: Iterable[int] = tuple(protocol.RATES),
        speed: float | int = 1.0,
    ) -> None:
        """Nothing is opened before `open` or the `with` statement.

        Args:
            body: the arm.
            path: the motion from the start; None for rest.
            start: `(joint,)` rad, the position at rest; None for zero.
            faults: of the controller; `set_faults` changes them.
            tool: `(6,)` mm and rad, the tool offset.
            payload: `(4,)` kg at the flange and its centre of mass in mm.
            address: on loopback.
            control_port: 502 requires privileges; 0 selects a free port.
            report_ports: the emulated report ports.
            speed: of the controller's clock relative to real time; it waits for slow readers.

        Raises:
            InputError: an address outside loopback, a speed that is not positive, or an invalid tool or payload.
        """
        try:
            if not ipaddress.IPv4Address(address).is_loopback:
                raise InputError(
                    f"{address}: is not on loopback: an emulator must not be reachable from a network; choose 127.x.y.z"
                )
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{address!r}: is not an address; write it like 127.0.0.1") from error
        if not 0 < speed < np.inf:
            raise InputError(f"speed {speed}: the clock runs forward; give a number above 0")
        if not 0 <= control_port <= 65535:
            raise InputError(f"control port {control_port}: is not a port; give 0 to 65535")
        for name, values in (("tool", np.array(tool, float)), ("payload", np.array(payload, float))):
            if not (np.abs(values) < PLAUSIBLE).all():
                shown = " ".join(f"{value:g}" for value in values)
                raise InputError(f"{name} {shown}: is implausible for an arm; give mm, radians and kg")
        position = np.zeros(body.arm.dof) if start is None else np.asarray(start, float)
        self.body = body
        self._core = Core(
            body, faults, path.start if path else position,
            np.array(tool, float), np.array(payload, float),
        )  # fmt: skip
        if path is not None and not faults.error:
            self._core.follow(path)
        self.address, self.speed = address, speed
        self._sockets = Sockets(self._core, address, control_port, report_ports, float(speed))
        self._thread: threading.Thread | None = None
        self._failure: Exception | None = None
        report(self._core, protocol.REALTIME, np.zeros(1))  # compiled before a client waits for it

    @property
    def control_port(self) -> int:
        """The bound control port."""
        return self._sockets.control_port

    def open(self) -> "Controller":
        """Starts the thread and listens.

        Raises:
            InputError: a port is unavailable; the message names an alternative.
        """
        listening: Future[None] = Future()

        def serve() -> None:
            try:
                asyncio.run(self._sockets.serve(lambda: listening.set_result(None)))
            except Exception as error:
                if listening.done():
                    self._failure = error
                else:
                    listening.set_exception(error)

        self._failure = None
        self._thread = threading.Thread(target=serve, name=f"emulator {self.address}", daemon=True)
        self._thread.start()
        try:
            listening.result()
        except OSError as error:
            self._thread.join()
            raise InputError(self._refusal(error)) from error
        return self

    def close(self) -> None:
        """Closes all connections and ends the thread.

        Raises:
            Exception: the one that ended the thread.
        """
        if self._thread is not None:
            self._sockets.stop()
            self._thread.join()
        if self._failure is not None:
            raise self._failure

    def __enter__(self) -> "Controller":
        return self.open()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def call(self, do: Callable[[Core], _T]) -> _T:
        """The result of `do` for the controller's core, between two steps of its clock."""
        loop = self._sockets.loop
        if loop is None or self._thread is None or not self._thread.is_alive():
            return do(self._core)
        done: Future[_T] = Future()

        def act() -> None:
            try:
                done.set_result(do(self._core))
            except BaseException as error:
                done.set_exception(error)

        loop.call_soon_threadsafe(act)
        return done.result(CALL_S)

    def set_faults(self, faults: Faults) -> None:
        """Replaces the faults."""

        def change(core: Core) -> None:
            core.faults, core.error, core.warning = faults, faults.error, faults.warning

        self.call(change)

    def fail(self, code: int) -> None:
        """Raises a controller error, which stops the arm; 0 clears it."""

        def change(core: Core) -> None:
            core.error = code
            core.halt(STOPPED)

        self.call(change)

    def close_connections(self) -> None:
        """Closes all connections; new ones are accepted."""

        self.call(lambda _: self._sockets.close_connections())

    def snapshot(self) -> Snapshot:
        """The present state.

        Raises:
            Exception: the one that ended the thread.
        """
        if self._failure is not None:
            raise self._failure

        def seen(core: Core) -> Snapshot:
            joints = core.measured(np.array([core.time]))[0][0]
            readers = {port: len(writers) for port, writers in self._sockets.readers.items()}
            connections = {protocol.CONTROL_PORT: len(self._sockets.clients)} | readers
            sockets = self._sockets
            return Snapshot(
                core.time, core.state, core.mode, core.error, joints, dict(core.requests), connections,
                sockets.unsent, sockets.given_up, dict(sockets.lost),
            )  # fmt: skip

        return self.call(seen)

    def _refusal(self, error: OSError) -> str:
        where = f"{self.address}:{self.control_port}"
        if error.errno in (errno.EACCES, errno.EPERM) and self.control_port < _PRIVILEGED:
            return (
                f"{where}: ports below {_PRIVILEGED} require privileges; add --control-port 5020, and before the "
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
