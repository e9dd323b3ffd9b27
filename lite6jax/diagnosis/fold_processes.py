"""Other processes of this machine that work on held-out folds beside this one, where a command has started some.

Two threads of one process gain little where there are few rows: most of the time goes into the interpreter, which they
share. Each process computes with one thread, so that it does not matter which of them works on which fold.
"""

import pickle
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Generic, NamedTuple, TypeVar, final

from lite6jax import interruption, threads
from lite6jax.distribution.workers import Process, Processes

Fold = TypeVar("Fold")
Result = TypeVar("Result")

_MOST = 4
"""Most other processes: five folds are held out, and this process works on at least one."""
_IMPORTS = ("lite6jax.diagnosis.heldout",)
"""Modules that other processes import as they start, which takes most of a second."""


@contextmanager
def fold_processes(count: int | None = None) -> Iterator[None]:
    """Has the folds of the diagnoses within worked on by so many processes, of which this is one.

    The others import what they need while this one reads. All of them compute with one thread from here on.

    Args:
        count: how many, at most five. Where not given, one a core of a command, and none beside a program that imports
            the library.
    """
    if count is None and not interruption.is_command_line():
        yield
        return
    others = min(count or threads.available(), 1 + _MOST) - 1
    threads.limit(1)
    if not others:
        yield
        return
    with FoldProcesses(others) as processes:
        before = _at_hand.set(processes)
        try:
            yield
        finally:
            _at_hand.reset(before)


def at_hand() -> "FoldProcesses | None":
    """The other processes of the surrounding `fold_processes`; None outside one."""
    return _at_hand.get()


class RemoteWork(NamedTuple, Generic[Result]):
    """How another process works on a fold.

    Attributes:
        function: of a module; `function(fold, *given)` is the result.
        given: further arguments of `function`; compared by identity or equality.
    """

    function: Callable[..., Result]
    given: tuple[Any, ...]


class _Job(Generic[Fold, Result]):
    """The folds that are still to be worked on, and the results of the others, by the folds' numbers."""

    def __init__(self, how: RemoteWork[Result], folds: Sequence[Fold]) -> None:
        self.how, self.folds = how, folds
        # now: while this process works, it adds to what is given
        self.pickled = pickle.dumps((work_on_one, (how.function, *how.given)))
        self.todo, self.results = deque(range(len(folds))), dict[int, Result]()

    def is_of(self, how: RemoteWork[Any], folds: Sequence[Any]) -> bool:
        """Whether it is the same work on the same folds."""
        given = zip(self.how.given, how.given, strict=True)
        return (
            self.how.function is how.function
            and all(ours is theirs or ours == theirs for ours, theirs in given)
            and len(self.folds) == len(folds)
            and all((a == b).all() for a, b in zip(self.folds, folds, strict=True))
        )

    def take(self, pop: Callable[[], int]) -> int | None:
        """The number of a fold of `todo`; None where another took the last."""
        try:
            return pop()
        except IndexError:
            return None

    def work_by(self, process: Process) -> None:
        """Gives a process the last folds until none is left; one at which it fails is for this process to work on."""
        while (k := self.take(self.todo.pop)) is not None:
            try:
                self.results[k] = process.work(self.pickled, [self.folds[k]])  # type: ignore[assignment]
            except Exception:  # what it is shows where the fold is worked on again
                self.todo.appendleft(k)
                return


def work_on_one(inputs: Sequence[Any], function: Callable[..., Any], *given: Any) -> Any:
    """What a process does with a batch, which is one fold."""
    (fold,) = inputs
    return function(fold, *given)


@final
class FoldProcesses:
    """Processes that take the last of the folds while this process takes the first; started by the `with` statement."""

    def __init__(self, count: int) -> None:
        """Starts nothing."""
        self._processes = Processes(count, _IMPORTS)
        self._job: _Job[Any, Any] | None = None
        self._working: list[Future[None]] = []

    def __enter__(self) -> "FoldProcesses":
        self._processes.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._forget()
        self._processes.__exit__(*error)

    def ahead(self, how: RemoteWork[Any], folds: Sequence[Any]) -> None:
        """Begins work on folds before it is known that their results are needed.

        `results` takes them where it is called with the same work and folds.
        """
        self._forget()
        self._job = _Job(how, folds)
        self._working = self._processes.each(self._job.work_by)

    def results(
        self,
        own: Callable[[Fold], Result],
        how: RemoteWork[Result],
        folds: Sequence[Fold],
        done: Callable[[int], object],
    ) -> list[Result]:
        """The result of each fold, in their order.

        Args:
            own: works on a fold in this process.
            how: works on one in another.
            folds: all.
            done: called with how many are done.
        """
        if self._job is None or not self._job.is_of(how, folds):
            self.ahead(how, folds)
        job = self._job
        assert job is not None
        while job.todo or any(not one.done() for one in self._working):
            while job.todo:
                done(len(job.results))
                if (k := job.take(job.todo.popleft)) is not None:
                    job.results[k] = own(folds[k])
            done(len(job.results))
            for one in self._working:
                one.cancel()  # one that has not begun stands behind work that is no longer needed
            wait(self._working)  # what one could not do is here again
            done(len(job.results))
        self._job = None
        return [job.results[k] for k in range(len(folds))]

    def _forget(self) -> None:
        if self._job is not None:
            self._job.todo.clear()
        self._job = None


_at_hand: ContextVar[FoldProcesses | None] = ContextVar("fold_processes", default=None)
