"""Other processes of this machine that work on held-out folds beside this one, where a program has started some.

Two threads of one process gain little where there are few rows: most of the time goes into the interpreter, which they
share. Each process computes with one thread, so that it does not matter which of them works on which fold.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar, final

from lite6jax import interruption, threads
from lite6jax.distribution.processes import Died, Processes

if TYPE_CHECKING:
    import pyarrow as pa

Fold = TypeVar("Fold")
Result = TypeVar("Result")

_MOST = 4
"""Helpers: five folds are held out, and this process works on one at least."""
_IMPORTS = ("lite6jax.diagnosis.heldout", "lite6jax.diagnosis.torque_diagnosis")
"""What takes most of the second that a helper starts in."""


@contextmanager
def beside(processes: int | None = None) -> Iterator[None]:
    """Has the folds of diagnoses within worked on by so many processes, of which this is one.

    The others import what they need while this one reads. All of them compute with one thread from here on.

    Args:
        processes: how many, at most five. Where not given, one a core of a command, and none beside a program that
            calls one.
    """
    if processes is None and not interruption.is_program():
        yield
        return
    count = min(processes or threads.available(), 1 + _MOST) - 1
    threads.limit(1)
    if not count:
        yield
        return
    with Helpers(count) as helpers:
        before = _started.set(helpers)
        try:
            yield
        finally:
            _started.reset(before)


def started() -> "Helpers | None":
    """Those that are at hand."""
    return _started.get()


class Elsewhere(NamedTuple, Generic[Result]):
    """How another process works on a fold.

    Attributes:
        function: of a module; `function([fold], *given)` is a table.
        given: to it; compared by identity or equality.
        read: the result, of the table.
    """

    function: "Callable[..., pa.Table]"
    given: tuple[Any, ...]
    read: "Callable[[pa.Table], Result]"

    def is_same(self, other: "Elsewhere[Any]") -> bool:
        """Whether the other is the same work."""
        pairs = zip(self.given, other.given, strict=True)
        return self.function is other.function and all(ours is theirs or ours == theirs for ours, theirs in pairs)


class _Job(Generic[Fold, Result]):
    """The folds that are still to be worked on, and the results of the others, by the folds' numbers."""

    def __init__(self, how: Elsewhere[Result], folds: Sequence[Fold]) -> None:
        self.how, self.folds = how, folds
        self.todo, self.results = deque(range(len(folds))), dict[int, Result]()


@final
class Helpers:
    """Processes that take the last of the folds while this process takes the first; started by the `with` statement."""

    def __init__(self, count: int) -> None:
        """Starts nothing."""
        self._count = count
        self._held = ExitStack()
        self._pairs: list[tuple[Processes, ThreadPoolExecutor]] = []
        self._job: _Job[Any, Any] | None = None
        self._working: list[Future[None]] = []

    def __enter__(self) -> "Helpers":
        for _ in range(self._count):
            process = self._held.enter_context(Processes(1, _IMPORTS))
            self._pairs.append((process, ThreadPoolExecutor(1)))
        return self

    def __exit__(self, *error: object) -> None:
        self._forget()
        self._held.close()  # a thread that waits for an answer is told that its process has died
        for _, thread in self._pairs:
            thread.shutdown()

    def ahead(self, how: Elsewhere[Any], folds: Sequence[Any]) -> None:
        """Has folds worked on before it is known whether their results are wanted; `shared` takes them if they are."""
        self._forget()
        self._job = _Job(how, folds)
        self._working = [thread.submit(_serve, process, self._job) for process, thread in self._pairs]

    def shared(
        self,
        own: Callable[[Fold], Result],
        how: Elsewhere[Result],
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
        job = self._job
        if job is None or not job.how.is_same(how) or not _are_same(job.folds, folds):
            self.ahead(how, folds)
            job = self._job
        assert job is not None
        while job.todo or any(not one.done() for one in self._working):
            while job.todo:
                done(len(job.results))
                k = _taken(job.todo.popleft)
                if k is not None:
                    job.results[k] = own(folds[k])
            done(len(job.results))
            wait(self._working)  # what one could not do is here again
            done(len(job.results))
        self._job = None
        return [job.results[k] for k in range(len(folds))]

    def _forget(self) -> None:
        if self._job is not None:
            self._job.todo.clear()
        self._job = None


_started: ContextVar[Helpers | None] = ContextVar("helpers", default=None)


def _serve(process: Processes, job: _Job[Any, Any]) -> None:
    """Has a process work on the last folds of a job, until none is left or one fails: that is then tried here."""
    from lite6jax.distribution.worker import table_of

    begun = False
    while (k := _taken(job.todo.pop)) is not None:
        try:
            if not begun:
                process.begin(job.how.function, job.how.given)
                begun = True
            process.submit(k, [job.folds[k]])
            _, outcome = process.next()
            if isinstance(outcome, Died):
                raise RuntimeError("a helper died")
            job.results[k] = job.how.read(table_of(outcome))
        except Exception:  # what it is shows where the fold is worked on again
            job.todo.appendleft(k)
            return


def _taken(pop: Callable[[], int]) -> int | None:
    try:
        return pop()
    except IndexError:
        return None


def _are_same(folds: Sequence[Any], others: Sequence[Any]) -> bool:
    return len(folds) == len(others) and all((a == b).all() for a, b in zip(folds, others, strict=True))
