"""Workers: processes of this machine, or those of a Dask cluster. Each computes one batch at a time with one thread.

Little is imported here: processes start, and import what they need, while the program reads its inputs.
"""

import ctypes
import gc
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, final

from lite6jax import interruption, threads
from lite6jax.calibration import compiled
from lite6jax.calibration.compiled import keep_compiled_code
from lite6jax.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

Function = Callable[..., "pa.Table"]
"""Of the inputs of a batch and what is given to all: a row an input, in their order. It stands in a module, so that
other processes find it."""

MOST_RESIDENT = 2 << 30
"""Bytes of a process above which another takes its place before the next batch: compiled code, and freed memory between
what stays, are not given back. One diagnosis leaves less than half of that."""
ANSWERS_WITHIN = 10.0
"""s; a scheduler that takes longer is not there."""
WORKERS_WITHIN = 60.0
"""s; a cluster that adapts to its load needs a while to start workers."""
_MOST_STARTS = 3
_ENDS_WITHIN = 5.0
"""s, in which a process undoes what it has begun."""
_MOST_MAPPINGS = 40_000
"""Of memory; Linux lets a process have 65 530, and every compiled function takes several."""
_SENT_AHEAD = 2
"""Batches for each thread of a cluster: what a scheduler holds does not grow with their number."""


_one_at_a_time = threading.Lock()
_job: tuple[Function, tuple[Any, ...]] | None = None


def work(job: bytes | None, inputs: Sequence[Any], expected: tuple[str, ...] | None = None) -> "tuple[pa.Table, int]":
    """What a worker does with a batch.

    A worker of a cluster may call this from several threads: one computes, as compiled code and what libraries set for
    a whole process are shared.

    Args:
        job: the pickled function and what is given to it besides a batch; None where they are those of the last call.
        inputs: of the batch.
        expected: the versions of the program that asks: with others a worker might compute other numbers.

    Returns:
        the rows, and the bytes of memory that the worker has then; 0 where the system does not say.

    Raises:
        InputError: the versions are others.
        Exception: what the function raised; a `RuntimeError` with its message where it cannot be sent.
    """
    global _job
    with _one_at_a_time:
        if expected is not None and expected != compiled.versions():
            raise InputError(
                "a worker of the cluster has another version of lite6jax, of Python or of a library than this program; "
                "install the same in both places, and start the workers again"
            )
        set_up()
        if job is not None:
            _job = None
            _job = pickle.loads(job)
        assert _job is not None
        try:
            rows = _job[0](inputs, *_job[1])
        except Exception as error:
            try:
                pickle.loads(pickle.dumps(error))
            except Exception:
                raise RuntimeError(f"{type(error).__name__}: {error}") from None
            raise
        with suppress(OSError):  # a system without /proc
            if Path("/proc/self/maps").read_bytes().count(b"\n") > _MOST_MAPPINGS:
                import jax

                jax.clear_caches()
        with suppress(OSError, AttributeError, TypeError):  # glibc: a heap in fragments else grows with every batch
            ctypes.CDLL(None).malloc_trim(0)
        try:
            return rows, int(Path("/proc/self/statm").read_bytes().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        except OSError:
            return rows, 0


@cache
def set_up() -> None:
    """One thread, and the compiled code of all workers of this user on this machine."""
    threads.limit(1)  # before what computes is loaded
    keep_compiled_code()
    gc.set_threshold(200_000)  # tracing makes objects that stay


class WorkerDiedError(Exception):
    """The process that had a batch came to its end."""


@final
class Process:
    """A process of this machine, in whose place another comes where it died or has grown."""

    def __init__(self, imports: tuple[str, ...]) -> None:
        """Starts it; it imports these modules at once."""
        self._imports = imports
        self._one_at_a_time = threading.Lock()
        self._is_over = False
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        ends, self._lifeline = context.Pipe(duplex=False)
        self._process = context.Process(target=_serve, args=(theirs, ends, self._imports), daemon=True)
        self._told: bytes | None = None
        self._is_ready, self._resident = False, 0
        # it inherits a blocked Ctrl-C, which is this process's to answer
        blocks = hasattr(signal, "pthread_sigmask")
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT]) if blocks else ()
        try:
            self._process.start()
        finally:
            if blocks:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        ends.close()

    def work(self, job: bytes, inputs: Sequence[Any]) -> "pa.Table":
        """The rows of a batch, of a pickled function and what is given to it; waits for the batch of another thread.

        Raises:
            WorkerDiedError: the process died, or was ended.
            InputError: no process gets as far as to ask for a batch.
            Exception: what the function raised.
        """
        with self._one_at_a_time:
            if self._resident > MOST_RESIDENT:
                self._restart()
            for _ in range(_MOST_STARTS):
                try:
                    if not self._is_ready:
                        self._is_ready = self._connection.recv()
                    self._connection.send((None if job is self._told else job, list(inputs)))
                    break
                except (EOFError, OSError):  # it ended before it had a batch
                    self._restart()
            else:
                raise InputError(
                    "the processes that are to do the work end as they start; free memory, or give --processes 1"
                )
            self._told = job
            try:
                said = self._connection.recv()
            except (EOFError, OSError) as error:
                self._restart()
                raise WorkerDiedError from error
        if isinstance(said, Exception):
            raise said
        rows, self._resident = said
        return rows

    def _restart(self) -> None:
        self._stop()
        self._connection.close()
        if self._is_over:
            raise WorkerDiedError
        self._start()

    def end(self) -> None:
        """Ends it at once, whatever it works on; no other comes in its place."""
        self._is_over = True
        self._stop()

    def _stop(self) -> None:
        self._lifeline.close()
        self._process.join(_ENDS_WITHIN if self._is_ready else 0)
        self._process.kill()
        self._process.join()


def _serve(connection: Connection, lifeline: Connection, imports: tuple[str, ...]) -> None:
    """Works on the batches that come, until the lifeline is closed at its other end, or the process there ends."""

    def end() -> None:
        with suppress(EOFError, OSError):
            lifeline.recv_bytes()
        interruption.undo()
        os._exit(0)

    threading.Thread(target=end, daemon=True).start()
    set_up()
    for module in imports:
        with suppress(Exception):  # where it is not whole, work says so
            import_module(module)
    with suppress(EOFError, OSError):  # the process at the other end has ended
        connection.send(True)
        while True:
            message = connection.recv_bytes()
            try:
                said = work(*pickle.loads(message))
            except Exception as error:
                said = error
            connection.send(said)


@final
class Processes:
    """Processes of this machine, started by the `with` statement, and a thread here for each.

    Attributes:
        room: the batches that are given to them at a time.
    """

    def __init__(self, count: int, imports: tuple[str, ...] = ()) -> None:
        """Starts nothing; the modules `imports` are imported by each at once."""
        self.room, self._imports = count, imports

    def __enter__(self) -> "Processes":
        self._all = [Process(self._imports) for _ in range(self.room)]
        self._threads = ThreadPoolExecutor(self.room)
        self._idle: SimpleQueue[Process] = SimpleQueue()
        for process in self._all:
            self._idle.put(process)
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._all:
            process.end()
        self._threads.shutdown()

    def each(self, function: Callable[[Process], Any]) -> list[Future[Any]]:
        """Calls a function with each process, side by side."""
        return [self._threads.submit(function, process) for process in self._all]

    def submit(self, job: bytes, inputs: Sequence[Any]) -> Future[Any]:
        """Gives a batch to a process that has nothing to do, as `Process.work` takes it."""
        return self._threads.submit(self._work, job, inputs)

    def _work(self, job: bytes, inputs: Sequence[Any]) -> "pa.Table":
        process = self._idle.get()
        try:
            return process.work(job, inputs)
        finally:
            self._idle.put(process)

    def take(self, future: Future[Any]) -> "pa.Table | None":
        """The rows of a batch that is done; None where its worker died.

        Raises:
            Exception: as `Process.work`.
        """
        try:
            return future.result()
        except WorkerDiedError:
            return None


@final
class Cluster:
    """The Dask cluster behind the address of a scheduler, connected by the `with` statement.

    Dask sends a batch to another worker where one dies, and gives it up after so many deaths as its setting
    `distributed.scheduler.allowed-failures` says.
    """

    def __init__(self, address: str) -> None:
        """Connects to nothing."""
        self._address = address

    def __enter__(self) -> "Cluster":
        """Connects.

        Raises:
            InputError: Dask is not installed, or no scheduler answers.
        """
        try:
            from distributed import Client
        except ImportError as error:
            raise self._error("takes Dask; pip install 'lite6jax[distributed]', or leave it out") from error
        try:
            self._client = Client(self._address, timeout=ANSWERS_WITHIN, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise self._error(
                "no scheduler answers there; start one by `dask scheduler`, or correct the address (tcp://HOST:8786)"
            ) from error
        self._executor = self._client.get_executor(pure=False)
        self._versions = compiled.versions()
        return self

    def __exit__(self, *error: object) -> None:
        self._client.close(timeout=ANSWERS_WITHIN)

    @property
    def room(self) -> int:
        """The batches that are sent ahead: what the workers have soon done."""
        counts: Any = self._client.nthreads()
        self._threads = sum(counts.values())
        return _SENT_AHEAD * max(self._threads, 1)

    def submit(self, job: bytes, inputs: Sequence[Any]) -> Future[Any]:
        """Sends a batch to the scheduler, as `work` takes it.

        Raises:
            InputError: the cluster has no worker.
        """
        future = self._executor.submit(work, job, list(inputs), self._versions)
        if not self._threads:  # a cluster that adapts to its load starts some for what it has
            try:
                self._client.wait_for_workers(1, timeout=WORKERS_WITHIN)
            except TimeoutError as error:
                raise self._error(
                    f"the cluster has no worker; start some by `dask worker {self._address} --nthreads 1`"
                ) from error
        return future

    def take(self, future: Future[Any]) -> "pa.Table | None":
        """As `Processes.take`.

        Raises:
            InputError: a worker has another version of the package or of a library, or the scheduler is gone.
            Exception: what the function raised.
        """
        from distributed import KilledWorker

        try:
            return future.result()[0]
        except KilledWorker:
            return None
        except CancelledError as error:
            raise self._error("the scheduler is gone; start it, and give the same command again") from error

    def _error(self, what: str) -> InputError:
        return InputError(f"--scheduler {self._address}: {what}")
