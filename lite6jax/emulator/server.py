"""An emulated controller, to be opened and closed: a thread around its sockets."""

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
"""For the thread to answer another one."""
_PRIVILEGED = 1024


class Seen(NamedTuple):
    """A controller at a moment.

    Attributes:
        time: s on its clock.
        state: 1 moves, 2 ready, 3 paused, 4 stopped, 5 reset.
        mode: 0 positions, 1 servo.
        error: its code, or 0.
        joints: `(joint,)` rad that the encoders show.
        asked: how often each register was asked for.
        connections: how many are connected to each port; the control port is 502 here, whatever it is.
    """

    time: float
    state: int
    mode: int
    error: int
    joints: Array
    asked: dict[int, int]
    connections: dict[int, int]


class Controller:
    """An emulated UFACTORY controller on loopback, to which the unmodified xarm-python-sdk connects.

    ```python
    with Controller(body, address="127.0.0.5", control_port=5020) as controller:
        XCONF.SocketConf.TCP_CONTROL_PORT = controller.control_port
        arm = XArmAPI(controller.address)
    ```

    The report ports are 30000 to 30003 of that address, as the SDK has them fixed: one controller an address. What the
    body's physics does is in the pose on port 30000 and nowhere else; `reports` says what each port shows, and why. All
    methods may be called from any thread while it runs.
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
        """Opens nothing yet; `with`, or `open` and `close`.

        Args:
            body: the arm.
            path: what it does from the start; it rests where not given.
            start: `(joint,)` rad where it stands, if there is no path; zero where not given.
            faults: what is wrong with it; `set_faults` changes that.
            tool: `(6,)` mm and rad, the tool offset that is set.
            payload: `(4,)` kg at the flange and its centre of mass in mm.
            address: of loopback.
            control_port: 502 needs the right to it; 0 takes any that is free.
            report_ports: those that listen.
            speed: how much faster than real time the controller's clock runs; it waits for readers that cannot follow.

        Raises:
            InputError: an address that is not of loopback, a speed that is not above 0, or a tool or payload that is
                none.
        """
        try:
            if not ipaddress.IPv4Address(address).is_loopback:
                raise InputError(
                    f"{address}: is not of loopback: an emulator is nothing to put on a network; choose 127.x.y.z"
                )
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{address!r}: is no address; write it like 127.0.0.1") from error
        if not 0 < speed < np.inf:
            raise InputError(f"speed {speed}: the clock runs forward; give a number above 0")
        if not 0 <= control_port <= 65535:
            raise InputError(f"control port {control_port}: is none; give 0 to 65535")
        for name, values in (("tool", np.array(tool, float)), ("payload", np.array(payload, float))):
            if not (np.abs(values) < PLAUSIBLE).all():
                shown = " ".join(f"{value:g}" for value in values)
                raise InputError(f"{name} {shown}: is none that an arm could have; give mm, radians and kg")
        stands = np.zeros(body.arm.dof) if start is None else np.asarray(start, float)
        self.body = body
        self._core = Core(
            body, faults, path.start if path else stands,
            np.array(tool, float), np.array(payload, float),
        )  # fmt: skip
        if path is not None and not faults.error:
            self._core.roam(path)
        self.address, self.speed = address, speed
        self._sockets = Sockets(self._core, address, control_port, report_ports, float(speed))
        self._thread: threading.Thread | None = None
        self._failure: Exception | None = None
        report(self._core, protocol.REALTIME, np.zeros(1))  # compiled before anyone waits for it

    @property
    def control_port(self) -> int:
        """As bound."""
        return self._sockets.control_port

    def open(self) -> "Controller":
        """Listens.

        Raises:
            InputError: a port that may not or cannot be had; the line says which to take instead.
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
            Exception: that on which the thread had ended.
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
        """What `do` gives of the controller's core, between two of its moments."""
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
        """Other faults from now on."""

        def change(core: Core) -> None:
            core.faults, core.error, core.warning = faults, faults.error, faults.warning

        self.call(change)

    def fail(self, code: int) -> None:
        """A controller error, which stops the arm; 0 clears it."""

        def change(core: Core) -> None:
            core.error = code
            core.halt(STOPPED)

        self.call(change)

    def hang_up(self) -> None:
        """Closes every connection there is; new ones are welcome."""

        self.call(lambda _: self._sockets.hang_up())

    def look(self) -> Seen:
        """What is going on at this moment.

        Raises:
            Exception: that on which the emulator's thread ended.
        """
        if self._failure is not None:
            raise self._failure

        def seen(core: Core) -> Seen:
            joints = core.measured(np.array([core.time]))[0][0]
            readers = {port: len(writers) for port, writers in self._sockets.readers.items()}
            connections = {protocol.CONTROL_PORT: len(self._sockets.clients)} | readers
            return Seen(core.time, core.state, core.mode, core.error, joints, dict(core.asked), connections)

        return self.call(seen)

    def _refusal(self, error: OSError) -> str:
        where = f"{self.address}:{self.control_port}"
        if error.errno in (errno.EACCES, errno.EPERM) and self.control_port < _PRIVILEGED:
            return (
                f"{where}: ports below {_PRIVILEGED} need the right to them; add --control-port 5020, and before the "
                "SDK connects say from xarm.core.config.x_config import XCONF; XCONF.SocketConf.TCP_CONTROL_PORT = 5020"
            )
        if error.errno == errno.EADDRINUSE:
            return (
                f"{self.address}: its control port {self.control_port} or a report port 30000 to 30003 is in use, by "
                "another emulator perhaps; choose another address, such as 127.0.0.9"
            )
        if error.errno == errno.EADDRNOTAVAIL:
            return (
                f"{self.address}: this system has only 127.0.0.1 unless told (macOS: sudo ifconfig lo0 alias "
                f"{self.address}); choose that or add it"
            )
        return f"{where}: {error.strerror or error}; choose another address or --control-port"
