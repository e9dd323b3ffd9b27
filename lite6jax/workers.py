"""Work on many inputs, batch by batch: by processes of this machine, or by those of a Dask cluster.

Each worker computes one batch at a time with one thread, so that what is computed does not depend on the workers and
their number. Little is imported here: processes start, and import what they need, while the program reads its inputs.
"""

import ctypes
import gc
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from functools import cache
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, final

from lite6jax import interruption, storage, threads
from lite6jax.calibration import compiled
from lite6jax.calibration.compiled import keep_compiled_code
from lite6jax.errors import InputError

if TYPE_CHECKING:  # imported in functions, while processes start
    import pyarrow as pa

Function = Callable[..., Any]
"""A function of the inputs of one batch, and of what all batches are given. It returns a table with one row for each
input, in their order. For batches of one input it may return anything but None, which stands for a worker that died. It
is defined at the top of a module, so that other processes can import it."""

MOST_RESIDENT = 2 << 30
"""Bytes of memory above which a new process takes the place of a worker before its next batch. Compiled code is never
freed, and fragments of the heap are not returned to the system. One diagnosis leaves less than half of this."""
ANSWERS_WITHIN = 10.0
"""s; a scheduler that takes longer is not there."""
WORKERS_WITHIN = 60.0
"""s; a cluster that adapts to its load needs a while to start workers."""
ROW_GROUP = 4096
"""Rows of a table that are written together, whatever the batches."""
_MOST_STARTS = 3
_MOST_MAPPINGS = 40_000
"""Of memory; Linux lets a process have 65 530, and every compiled function takes several."""
_SENT_AHEAD = 2
"""Batches for each thread of a cluster: what a scheduler holds does not grow with their number."""


def run_batches(
    function: Function,
    batches: Sequence[Sequence[Any]],
    arguments: tuple[Any, ...] = (),
    *,
    out: Path,
    died: Callable[[Any], "pa.Table"],
    store: "Callable[[Sequence[Any], pa.Table], pa.Table]" = lambda inputs, rows: rows,
    scheduler: str | None = None,
    processes: int | None = None,
    progress: Callable[[int], object] = lambda done: None,
    overwrite: bool = False,
) -> Path:
    """Writes what a function makes of many inputs as one Parquet table, a row an input, in the order of the inputs.

    The table's bytes do not depend on the workers and their number.

    Args:
        function: of a module: `function(inputs, *arguments)` makes a row of each input of a batch.
        batches: the inputs.
        arguments: to the function with each batch.
        out: the table to write.
        died: the row of an input at which workers die.
        store: called with the inputs of a batch and its rows as they come; returns the rows of the table.
        scheduler: the address of the scheduler of a Dask cluster; processes of this machine where not given.
        processes: so many; one a core where not given, and none but this one for 0.
        progress: called with the number of inputs done since the last call.
        overwrite: whether a table that is there may be replaced.

    Raises:
        InputError: as `storage.write_atomically` and `Workers`.
        Exception: what the function raised.
    """
    tables: dict[int, pa.Table] = {}
    with Workers(scheduler, processes, len(batches)) as workers:
        for number, rows in workers.outcomes(function, enumerate(batches), arguments, died=died):
            tables[number] = store(batches[number], rows)
            progress(len(batches[number]))
    return write_tables([tables[number] for number in sorted(tables)], out, overwrite)


@final
class Workers:
    """Processes of this machine or a cluster, started by the `with` statement.

    Any number of functions can then be run by them, one after the other.
    """

    def __init__(
        self, scheduler: str | None = None, processes: int | None = None, batch_count: int | None = None
    ) -> None:
        """Starts nothing.

        Args:
            scheduler, processes: as of `run_batches`.
            batch_count: how many batches there are at most: more processes are not started.
        """
        self._pool: Processes | Cluster | None = None
        if scheduler is not None:
            self._pool = Cluster(scheduler)
        elif processes != 0:
            count = processes or threads.available()
            self._pool = Processes(count if batch_count is None else max(1, min(count, batch_count)))

    def __enter__(self) -> "Workers":
        """Starts processes, or connects.

        Raises:
            InputError: Dask is not installed, or no scheduler answers.
        """
        if self._pool is not None:
            self._pool.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        if self._pool is not None:
            self._pool.__exit__(*error)

    def outcomes(
        self,
        function: Function,
        batches: Iterable[tuple[int, Sequence[Any]]],
        arguments: tuple[Any, ...] = (),
        *,
        died: Callable[[Any], "pa.Table"],
    ) -> Generator[tuple[int, Any]]:
        """Batches by their numbers with what is made of them, as they come; read all before the next begin.

        A batch whose worker dies is tried again as a whole, as the reason may be another. Where that dies as well, its
        inputs are tried one by one, and those at which a worker dies get the row that `died` makes.

        Args:
            batches: numbers and inputs, taken as there is room for them.
            function, arguments, died: as of `run_batches`.

        Raises:
            InputError: no process starts, the cluster has no worker or one of another version, or its scheduler is
                gone.
            Exception: what the function raised.
        """
        pool = self._pool
        if pool is None:
            for number, inputs in batches:
                yield number, function(inputs, *arguments)
            return
        job = pickle.dumps((function, arguments))
        following = iter(batches)
        at_work: dict[Future[Any], tuple[int, Sequence[Any], bool]] = {}

        def alone(single_input: Any) -> "pa.Table":
            rows = pool.take(pool.submit(job, [single_input]))
            return died(single_input) if rows is None else rows

        def fill() -> None:
            while len(at_work) < pool.room and (batch := next(following, None)) is not None:
                at_work[pool.submit(job, batch[1])] = (*batch, False)

        fill()
        while at_work:
            for future in wait(at_work, return_when=FIRST_COMPLETED).done:
                number, inputs, is_again = at_work.pop(future)
                rows = pool.take(future)
                if rows is None and not is_again:
                    at_work[pool.submit(job, inputs)] = number, inputs, True
                    continue
                if rows is None:
                    rows = concatenate(map(alone, inputs)) if len(inputs) > 1 else died(inputs[0])
                yield number, rows
            fill()


def concatenate(tables: "Iterable[pa.Table]") -> "pa.Table":
    """The rows of tables one after the other; a column that one of them lacks is null there."""
    import pyarrow as pa

    return pa.concat_tables(tables, promote_options="default")


def write_tables(tables: "Iterable[pa.Table]", path: Path, overwrite: bool = False) -> Path:
    """Writes the rows of tables as one Parquet file, in groups of `ROW_GROUP` rows whatever the tables' sizes.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    import pyarrow.parquet as pq

    rows = concatenate(tables).combine_chunks()

    def write(target: Path) -> None:
        pq.write_table(rows, target, row_group_size=ROW_GROUP, write_page_checksum=True)

    return storage.write_atomically(path, write, overwrite)


# ------------------------------------------------------------------ what a worker does

_one_at_a_time = threading.Lock()
_job: tuple[bytes, Function, tuple[Any, ...]] | None = None


def work(job: bytes, inputs: Sequence[Any], expected: tuple[str, ...] | None = None) -> "tuple[pa.Table, int]":
    """What a worker does with a batch.

    A worker of a cluster may call this from several threads: one computes, as compiled code and what libraries set for
    a whole process are shared.

    Args:
        job: the pickled function and what is given to it besides a batch.
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
        if _job is None or _job[0] != job:
            _job = None  # what was given may be large
            _job = (job, *pickle.loads(job))
        _, function, arguments = _job
        try:
            rows = function(inputs, *arguments)
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


def _begin(lifeline: Connection, imports: tuple[str, ...]) -> None:
    """What a process does before its first batch. It ends when its lifeline is closed, or the process there dies."""

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


# ------------------------------------------------------------------ processes of this machine


class WorkerDiedError(Exception):
    """The process that had a batch came to its end."""


@final
class _Process:
    """A process of this machine, in whose place another comes where it died or has grown.

    Each is a pool of one: a death breaks a pool, and costs here the batch of the process that died alone.
    """

    def __init__(self, imports: tuple[str, ...]) -> None:
        self._imports = imports
        self._is_over = False
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        lifeline, self._lifeline = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(1, context, _begin, (lifeline, self._imports))
        self._resident = 0
        # it inherits a blocked Ctrl-C, which is this process's to answer
        blocks = hasattr(signal, "pthread_sigmask")
        before = ()
        if blocks:
            before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            self._first = self._pool.submit(set_up)  # for which the pool starts the process
        finally:
            if blocks:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
        lifeline.close()

    def work(self, job: bytes, inputs: Sequence[Any]) -> "pa.Table":
        """As `Processes.submit`; waits for the rows."""
        if self._resident > MOST_RESIDENT:
            self._restart()
        for _ in range(_MOST_STARTS):
            try:
                self._first.result()
                future = self._pool.submit(work, job, list(inputs))
                break
            except BrokenProcessPool:  # it ended before it had a batch
                self._restart()
        else:
            raise InputError(
                "the processes that are to do the work end as they start; free memory, or give --processes 1"
            )
        try:
            rows, self._resident = future.result()
        except BrokenProcessPool as error:
            self._restart()
            raise WorkerDiedError from error
        return rows

    def _restart(self) -> None:
        self._stop()
        if self._is_over:
            raise WorkerDiedError
        self._start()

    def end(self) -> None:
        """Ends it at once, whatever it works on; no other comes in its place."""
        self._is_over = True
        self._stop()

    def _stop(self) -> None:
        self._lifeline.close()
        self._pool.shutdown()


@final
class Processes:
    """Processes of this machine, started by the `with` statement, and a thread here for each.

    Attributes:
        room: the batches that are given to them at a time.
    """

    def __init__(self, count: int, imports: tuple[str, ...] = ()) -> None:
        """Starts nothing; the modules `imports` are imported by each at once."""
        self.room = count
        self._imports = imports

    def __enter__(self) -> "Processes":
        self._all = [_Process(self._imports) for _ in range(self.room)]
        self._threads = ThreadPoolExecutor(self.room)
        self._idle: SimpleQueue[_Process] = SimpleQueue()
        for process in self._all:
            self._idle.put(process)
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._all:
            process.end()
        self._threads.shutdown(cancel_futures=True)

    def submit(self, job: bytes, inputs: Sequence[Any]) -> Future[Any]:
        """Gives a batch of a pickled function and what is given to it to a process that has nothing to do.

        The result is its rows; or a `WorkerDiedError` where the process died or was ended, an `InputError` where none
        gets as far as to ask for a batch, or what the function raised.
        """
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
            Exception: as of `submit`.
        """
        try:
            return future.result()
        except WorkerDiedError:
            return None


# ------------------------------------------------------------------ a cluster


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

    def _error(self, problem: str) -> InputError:
        return InputError(f"--scheduler {self._address}: {problem}")
