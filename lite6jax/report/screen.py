"""Output to the terminal: text without markup, unbroken paths, and progress, as a bar or as lines."""

import re
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import final

from rich.console import Console, RenderableType
from rich.live import Live
from rich.padding import Padding
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from lite6jax.progress import Code, Stage

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


def indented(line: str, characters: int = 2) -> RenderableType:
    """A line so many characters from the margin."""
    return Padding(Text(line), (0, 0, 0, characters))


def headed(heading: str, lines: Iterable[str]) -> Iterator[RenderableType]:
    """An empty line and a heading with indented lines; nothing where there are none."""
    for k, line in enumerate(lines):
        if not k:
            yield ""
            yield Text(heading)
        yield indented(line)


# ------------------------------------------------------------------ progress


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
    if screen.is_terminal:
        columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=screen, transient=True) as bar:
            task = bar.add_task("", total=total)
            yield lambda done: bar.advance(task, done)
        return
    began, lock, done = time.monotonic(), threading.Lock(), 0

    def advance(more: int) -> None:
        nonlocal done
        with lock:
            done += more

    def line() -> str:
        so_far = time.monotonic() - began
        ahead = f", about {minutes(so_far * (total - done) / done)} to go" if done else ""
        return f"{what}: {done} of {total}, {minutes(so_far)} so far{ahead}"

    with repeated(line):
        yield advance


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


# ------------------------------------------------------------------ the stages of a diagnosis


_STAGES: dict[Code, str] = {
    "screening": "looking for data faults",
    "linearising": "fitting frames and clock offset",
    "selecting": "searching for physics",
    "naming": "testing names",
    "estimating": "computing the final estimates",
    "planning": "choosing poses that separate the alternatives",
}
_SHARE = 0.5
"""Of the time for all rows, what a held-out block takes, as long as none has been measured."""


@final
class Clock:
    """Where a computation is and how long it still takes, from the times of its parts so far.

    The functions take the present time in seconds.
    """

    def __init__(self, now: float) -> None:
        self.stage: Stage | None = None
        self._began = [now]

    def entered(self, stage: Stage, now: float) -> None:
        """A stage begins."""
        self.stage = stage
        while len(self._began) <= stage.part:
            self._began.append(now)

    def to_go(self, now: float) -> float | None:
        """Seconds to go; None as long as all rows are searched, which takes a time that nothing measured tells."""
        if self.stage is None or self.stage.part == 0:
            return None
        began, part, left = self._began, self.stage.part, self.stage.parts - self.stage.part
        if left == 0:
            return 0.0
        block = (began[part] - began[1]) / (part - 1) if part > 1 else _SHARE * (began[1] - began[0])
        return max(block - (now - began[part]), 0.0) + (left - 1) * block

    def line(self, now: float) -> str:
        """The stage, the time since the beginning and the time to go, in words."""
        if self.stage is None:
            return f"reading rows, {minutes(now - self._began[0])} so far"
        block = f", without block {self.stage.part} of {self.stage.parts - 1}" if self.stage.part > 0 else ""
        block = block if self.stage.part < self.stage.parts else ""
        to_go = self.to_go(now)
        if to_go is None:  # the held-out blocks take at least this, were all rows searched now
            ahead = f"more than {minutes(_SHARE * (self.stage.parts - 1) * (now - self._began[0]))} to go"
        else:
            ahead = f"about {minutes(to_go)} to go"
        return f"{_STAGES[self.stage.code]}{block}: {minutes(now - self._began[0])} so far, {ahead}"


@contextmanager
def stages() -> Iterator[Callable[[Stage], None]]:
    """Shows the stages that the yielded function is called with, until the end of the context."""
    clock, screen = Clock(time.monotonic()), console(stderr=True)

    def follow(stage: Stage) -> None:
        clock.entered(stage, time.monotonic())

    if screen.is_terminal:
        line = lambda: Text(clock.line(time.monotonic()), overflow="ellipsis", no_wrap=True)  # noqa: E731
        with Live(get_renderable=line, console=screen, transient=True, refresh_per_second=2):
            yield follow
        return
    with repeated(lambda: clock.line(time.monotonic())):
        yield follow
