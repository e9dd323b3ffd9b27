"""Workers that are processes of this machine; one that dies, or takes much memory, is replaced."""

import multiprocessing
import os
import signal
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

from lite6jax import interruption
from lite6jax.errors import InputError

if TYPE_CHECKING:
    from lite6jax.distribution.worker import Function

MOST_RESIDENT = 2 << 30
"""Bytes of a process that has no batch in hand, above which another takes its place: compiled code, and freed memory
between what stays, are not given back. One diagnosis leaves less than half of that."""
_MOST_FAILED_STARTS = 3
_ENDS_WITHIN = 1.0
"""s, in which a process is gone whose connection is."""


class Died:
    """In the place of a batch's rows: the worker that had it came to its end."""


Outcome = bytes | Died


class _Job(NamedTuple):
    """A function of a module, with what it is given besides a batch, as `worker.work` takes them."""

    function: "Function"
    given: tuple[Any, ...]


def pickled(function: "Function", given: tuple[Any, ...]) -> bytes:
    """What `Processes.begin_pickled` takes, arguments as of `Processes.begin`: what is given may change afterwards."""
    return bytes(ForkingPickler.dumps(_Job(function, given)))


@final
class _Worker:
    """A process, the connection to it, and the batch that it has in hand."""

    def __init__(self, job: bytes | None, imports: tuple[str, ...]) -> None:
        self.batch: int | None = None
        self.inputs: list[Any] = []
        self.ready = False
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(target=_serve, args=(theirs, imports), daemon=True)
        # it inherits a blocked Ctrl-C, which is this process's to answer
        blocks = hasattr(signal, "pthread_sigmask")
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]) if blocks else ()
        try:
            self.process.start()
        finally:
            if blocks:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        if job is not None:
            self.tell(job)

    def tell(self, job: bytes) -> None:
        """Says what is to be done with the batches that follow."""
        with suppress(OSError):  # one that was ended is replaced where it is to have a batch
            self.connection.send_bytes(job)

    @property
    def is_large(self) -> bool:
        """Whether it has worked and keeps more memory than `MOST_RESIDENT`; unknown, so False, but on Linux."""
        try:
            pages = int(Path(f"/proc/{self.process.pid}/statm").read_bytes().split()[1])
        except (OSError, ValueError, IndexError):
            return False
        return self.ready and pages * os.sysconf("SC_PAGE_SIZE") > MOST_RESIDENT

    def end(self, within: float = 0.0) -> int | None:
        """Ends the process, if it does not end within so many seconds; returns its exit code."""
        self.connection.close()
        self.process.join(within)
        self.process.kill()
        self.process.join()
        # a thread that waited for it too may have been told of its end, and not have noted that yet
        until = time.monotonic() + _ENDS_WITHIN
        while (code := self.process.exitcode) is None and time.monotonic() < until:
            time.sleep(0.001)
        self.process.close()
        return code


@final
class Processes:
    """Processes of this machine, started by the `with` statement: they import what they need while the program reads.

    `begin` says what they are to do.

    This module imports little, for the same reason. Every process computes with one thread.
    """

    def __init__(self, count: int, imports: tuple[str, ...] = ()) -> None:
        """Starts nothing.

        Args:
            count: of the processes.
            imports: modules that they import at once, where `begin` comes later than that.
        """
        self._count, self._imports = count, imports
        self._job: bytes | None = None
        self._workers: list[_Worker] = []
        self._failed_starts = 0
        self._is_over = False

    def __enter__(self) -> "Processes":
        self._undone = interruption.undone(self._kill)
        self._undone.__enter__()
        self._workers = [self._started() for _ in range(self._count)]
        return self

    def __exit__(self, *error: object) -> None:
        self._is_over = True
        for worker in self._workers:
            worker.end()
        self._workers = []
        self._undone.__exit__(None, None, None)

    def _kill(self) -> None:
        for worker in self._workers:
            worker.process.kill()

    def _started(self) -> _Worker:
        return _Worker(self._job, self._imports)

    def begin(self, function: "Function", given: tuple[Any, ...]) -> None:
        """Says what is to be done with the batches that follow; what is still in hand is forgotten.

        Args:
            function: of a module.
            given: to it besides a batch.
        """
        self.begin_pickled(pickled(function, given))

    def begin_pickled(self, job: bytes) -> None:
        """As `begin`, of what `pickled` made."""
        self._job = job
        for place, worker in enumerate(self._workers):
            if worker.batch is None:
                worker.tell(self._job)
            else:
                self._renew(place)

    @property
    def has_room(self) -> bool:
        """Whether a process has nothing to do."""
        return any(worker.batch is None for worker in self._workers)

    def submit(self, number: int, inputs: Sequence[Any]) -> None:
        """Gives a batch to a process that has nothing to do."""
        self._send(next(i for i, worker in enumerate(self._workers) if worker.batch is None), number, list(inputs))

    def _send(self, place: int, number: int, inputs: list[Any]) -> None:
        if self._workers[place].is_large:
            self._renew(place)
        while True:
            worker = self._workers[place]
            try:
                worker.connection.send(inputs)
                break
            except OSError:  # it was ended while it had nothing to do
                self._replace(place)
        worker.batch, worker.inputs = number, inputs

    def next(self) -> tuple[int, Outcome]:
        """Waits for the next batch: its number, and its rows or that its worker died.

        Raises:
            RuntimeError: no process has a batch in hand; the processes may have been ended meanwhile.
            Exception: what the function raised.
        """
        while True:
            busy = [worker.connection for worker in self._workers if worker.batch is not None]
            if not busy:
                raise RuntimeError("no process has a batch in hand")
            wait(busy)
            for place, worker in enumerate(self._workers):
                if worker.batch is None or not worker.connection.poll():
                    continue
                number = worker.batch
                try:
                    said = worker.connection.recv()
                except (EOFError, OSError):
                    if self._is_over:
                        return number, Died()
                    self._replace(place)
                    if worker.ready:
                        return number, Died()
                    self._send(place, number, worker.inputs)  # it ended before it looked at the batch
                    continue
                worker.ready, self._failed_starts = True, 0
                if isinstance(said, Exception):
                    raise said
                if said is not None:
                    worker.batch = None
                    return number, said

    def _renew(self, place: int) -> None:
        """Ends a process and starts another in its place."""
        self._workers[place].end()
        self._workers[place] = self._started()

    def _replace(self, place: int) -> None:
        """Starts another process in the place of one that ended.

        Raises:
            InputError: no process gets as far as to ask for its first batch.
        """
        worker = self._workers.pop(place)
        code = worker.end(_ENDS_WITHIN)
        self._failed_starts += not worker.ready
        if self._failed_starts >= _MOST_FAILED_STARTS:
            how = signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"
            raise InputError(
                f"the processes that are to do the work end as they start ({how}); free memory, or give --processes 1"
            )
        self._workers.insert(place, self._started())


def _serve(connection: Connection, imports: tuple[str, ...]) -> None:
    """Works on the batches that come until the other process closes the connection, or ends."""
    from lite6jax.distribution.worker import set_up, work

    try:
        set_up()
        for module in imports:
            import_module(module)
        job: _Job | None = None
        while True:
            try:
                message = connection.recv()
            except (ImportError, AttributeError) as error:  # a module that is not whole, or not found from here
                connection.send(error)
                return
            if isinstance(message, _Job):
                job = message
                connection.send(None)
                continue
            assert job is not None
            try:
                said = work(job.function, message, job.given)
            except Exception as error:
                said = error
            try:
                connection.send(said)
            except (TypeError, AttributeError, ValueError):  # an exception that cannot be sent
                connection.send(RuntimeError(f"{type(said).__name__}: {said}"))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
