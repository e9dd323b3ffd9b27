"""Work in processes of their own, of which one that dies costs its own trial only."""

import contextlib
import multiprocessing
import os
import queue
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any

_BATCH = 100
"""Trials that a process does; compiled code stays in its memory."""
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class WorkerDiedError(RuntimeError):
    """The process that worked on a trial came to its end, twice."""


def worked(
    work: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], names: Sequence[int], processes: int
) -> Iterator[tuple[int, Any]]:
    """Name and result as they come. A process that dies takes the trials of that moment along: they are tried again."""
    waiting = dict(zip(names, arguments, strict=True))
    suspects: list[int] = []
    while waiting:
        # each of those that may have killed a process has one of its own
        batch = [suspects.pop()] if suspects else list(waiting)[: _BATCH * processes]
        # one thread each: two libraries' threads on the same cores only wait for each other
        before = {name: os.environ.get(name) for name in _THREADS}
        os.environ.update((name, "1") for name in _THREADS)
        context = multiprocessing.get_context("spawn")
        cores = context.Queue()
        for core in sorted(os.sched_getaffinity(0))[:processes] if processes > 1 else ():
            cores.put(core)
        pool = ProcessPoolExecutor(processes, context, _settle, (cores,))
        try:
            futures: dict[Future[Any], int] = {pool.submit(work, *waiting[name]): name for name in batch}
            for future in as_completed(futures):
                name = futures[future]
                try:
                    result = future.result()
                except BrokenProcessPool:
                    break
                except Exception as problem:
                    result = problem
                del waiting[name]
                yield name, result
            left = [name for name in batch if name in waiting]
            if left and len(batch) == 1:
                del waiting[left[0]]
                yield left[0], WorkerDiedError("the process died")
            elif left:
                suspects = left[:processes]
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


def _settle(cores: Any) -> None:
    """A worker leaves Ctrl-C to its parent, and keeps to a core of its own where there are others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(queue.Empty):
        os.sched_setaffinity(0, {cores.get(timeout=0.2)})
