"""Output to the terminal: text without markup, unbroken paths, and progress, as a bar or as lines."""

import re
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

_BLANKS = re.compile(r" +$", re.MULTILINE)


def console(stderr: bool = False) -> Console:
    """A console that interprets no character of a file name as markup."""
    return Console(stderr=stderr, highlight=False, markup=False, emoji=False)


def show(parts: Iterable[RenderableType]) -> None:
    """Prints parts below each other; into a file or a pipe without the blanks that fill lines on a terminal."""
    screen = console()
    for part in parts:
        with screen.capture() as printed:
            screen.print(part, soft_wrap=isinstance(part, Text) and bool(part.no_wrap))
        text = printed.get()
        screen.file.write(text if screen.is_terminal else _BLANKS.sub("", text))


def notes(said: Iterable[str]) -> Iterator[Text]:
    """Remarks, a line each, such as those of a recording; a full stop at their end is added where there is none."""
    yield from (Text(f"Note: {note.removesuffix('.')}.") for note in said)


def written(paths: Iterable[Path]) -> None:
    """Prints the written files, one line each without wrapping."""
    screen = console()
    for path in paths:
        screen.print(f"Wrote {path}", soft_wrap=True)


EVERY = 10.0
"""Seconds between two lines of progress where stderr is no terminal; what takes less says nothing."""


def minutes(seconds: float) -> str:
    """A duration as minutes and seconds: 1:05."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


@contextmanager
def repeated(line: Callable[[], str]) -> Iterator[None]:
    """Prints a line on stderr every ten seconds, until the end of the context."""
    screen, ended = console(stderr=True), threading.Event()

    def report() -> None:
        while not ended.wait(EVERY):
            screen.print(line(), soft_wrap=True)

    reporter = threading.Thread(target=report, daemon=True)
    reporter.start()
    try:
        yield
    finally:
        ended.set()
        reporter.join()


@contextmanager
def progress(total: int, what: str) -> Iterator[Callable[[int], None]]:
    """Progress on stderr: a transient bar on a terminal, else a line every ten seconds.

    Yields:
        a thread-safe function that advances it.
    """
    screen = console(stderr=True)
    if not screen.is_terminal:
        with _lines(total, what) as advance:
            yield advance
        return
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=screen, transient=True) as bar:
        task = bar.add_task("", total=total)
        yield lambda done: bar.advance(task, done)


@contextmanager
def progress_of_many(what: str) -> Iterator[Callable[[int, int], None]]:
    """As `progress`, of work whose amount is known only once it has begun.

    Yields:
        a function that advances it by so many of so many.
    """
    with ExitStack() as stack:
        advance: Callable[[int], None] | None = None

        def first_or_next(done: int, total: int) -> None:
            nonlocal advance
            if advance is None:
                advance = stack.enter_context(progress(total, what))
            advance(done)

        yield first_or_next


@contextmanager
def _lines(total: int, what: str) -> Iterator[Callable[[int], None]]:
    began, lock, done = time.monotonic(), threading.Lock(), [0]

    def advance(more: int) -> None:
        with lock:
            done[0] += more

    def line() -> str:
        so_far = time.monotonic() - began
        ahead = f", about {minutes(so_far * (total - done[0]) / done[0])} to go" if done[0] else ""
        return f"{what}: {done[0]} of {total}, {minutes(so_far)} so far{ahead}"

    with repeated(line):
        yield advance
