"""Held-out folds that are worked on side by side: by other processes where the program has some, else by threads.

Two threads of one process gain little where there are few rows: most of the time goes into the interpreter, which they
share. Each process computes with one thread, so that it does not matter which of them works on which fold.
"""

import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from typing import Any, Protocol, TypeVar

from lite6jax import threads
from lite6jax.progress import part

Fold = TypeVar("Fold")
Result = TypeVar("Result")


class FoldWorkers(Protocol):
    """Processes that a program has started for the folds, as `lite6jax.workers.Processes`."""

    def submit(self, job: bytes, inputs: Sequence[Any], /) -> Future[Any]:
        """Gives a process the pickled `(function, arguments)`, of which it returns `function(inputs, *arguments)`."""
        ...


_at_hand: ContextVar[FoldWorkers | None] = ContextVar("fold_workers", default=None)


@contextmanager
def folds_shared_with(processes: FoldWorkers) -> Iterator[None]:
    """Has the folds of the diagnoses within worked on by other processes too. The caller computes with one thread."""
    before = _at_hand.set(processes)
    try:
        yield
    finally:
        _at_hand.reset(before)


def work_on_folds(
    function: Callable[..., Result], given: tuple[Any, ...], folds: Sequence[Fold], anywhere: bool = True
) -> list[Result]:
    """The results `function(fold, *given)`, in the order of the folds; the stages belong to part 1 + those completed.

    Where other processes are at hand, and may work on a function (which is one of a module) `anywhere`, they take the
    first folds, and this one the last. Else as many threads as `threads.available` says share compiled functions and
    what is known of all rows.
    """
    processes = _at_hand.get() if anywhere else None
    with part(1, 1 + len(folds)) as going:
        if processes is None:
            pool = ThreadPoolExecutor(min(len(folds), threads.available()))
            try:
                # each in a copy of this context, which says who follows the progress
                begun = [pool.submit(copy_context().run, function, fold, *given) for fold in folds]
                for completed in as_completed(begun):
                    completed.result()
                    going.number += 1
                return [future.result() for future in begun]
            finally:
                pool.shutdown(wait=False, cancel_futures=True)  # after an interrupt, nobody waits for the others
        # now: while this process works, it adds to what is given
        job = pickle.dumps((work_on_one, (function, *given)))
        results = dict[int, Any]()
        begun = [processes.submit(job, [fold]) for fold in folds]
        try:
            for k in reversed(range(len(folds))):
                if begun[k].cancel():
                    results[k] = function(folds[k], *given)
                    going.number += 1
            for k in sorted(set(range(len(folds))) - set(results)):
                try:
                    results[k] = begun[k].result()
                except Exception:  # what it is shows where this process works on the fold again
                    results[k] = function(folds[k], *given)
                going.number += 1
        finally:
            for future in begun:
                future.cancel()
        return [results[k] for k in range(len(folds))]


def work_on_one(inputs: Sequence[Any], function: Callable[..., Any], *given: Any) -> Any:
    """What a process does with a batch, which is one fold."""
    (fold,) = inputs
    return function(fold, *given)
