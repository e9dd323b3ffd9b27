"""Output to the terminal: text without markup, unbroken paths, and progress, as a bar or as lines."""

import re
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console, RenderableType
from rich.live import Live
from rich.padding import Padding
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


def notes(remarks: Iterable[str]) -> Iterator[str]:
    """Remarks, a line each, such as those of a recording; a full stop at their end is added where there is none."""
    return (f"Note: {note.removesuffix('.')}." for note in remarks)


def written(paths: Iterable[Path]) -> None:
    """Prints the written files, one line each without wrapping."""
    screen = console()
    for path in paths:
        screen.print(f"Wrote {path}", soft_wrap=True)


def unbroken(line: str) -> Text:
    """A path or a command, which is not wrapped."""
    return Text(line, no_wrap=True, overflow="ignore")


def indented(line: str, characters: int = 2) -> RenderableType:
    """A line so many characters from the margin."""
    return Padding(Text(line), (0, 0, 0, characters))


def headed(heading: str, lines: Iterable[str]) -> Iterator[RenderableType]:
    """An empty line and a heading with indented lines; nothing where there are none."""
    for k, line in enumerate(lines):
        if not k:
            yield from ("", heading)
        yield indented(line)


# ------------------------------------------------------------------ progress


EVERY = 10.0
"""Seconds between two lines of progress where stderr is no terminal; what takes less says nothing."""


def minutes(seconds: float) -> str:
    """A duration as minutes and seconds: 1:05."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


@contextmanager
def repeated(line: Callable[[], str]) -> Iterator[None]:
    """Shows a line on stderr until the end of the context: updated on a terminal, else printed every ten seconds."""
    screen = console(stderr=True)
    ended = threading.Event()
    if screen.is_terminal:
        drawn = lambda: Text(line(), overflow="ellipsis", no_wrap=True)  # noqa: E731
        with Live(get_renderable=drawn, console=screen, transient=True, refresh_per_second=2):
            yield
        return

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
def progress(total: int | None, task: str) -> Iterator[Callable[..., None]]:
    """How much of an amount of work is done, on stderr; None of work whose amount is known only once it has begun.

    Yields:
        a thread-safe function that advances it by so many, of so many where that is given.
    """
    began = time.monotonic()
    lock = threading.Lock()
    done = 0

    def advance(more: int, of: int | None = None) -> None:
        nonlocal done, total
        with lock:
            done = done + more
            total = of or total

    def line() -> str:
        so_far = time.monotonic() - began
        share = "" if total is None else f"{done} of {total}, "
        ahead = ""
        if total and done:
            ahead = f", about {minutes(so_far * (total - done) / done)} to go"
        return f"{task}: {share}{minutes(so_far)} so far{ahead}"

    with repeated(line):
        yield advance


# ------------------------------------------------------------------ the stages of a diagnosis


_STAGES: dict[Code, str] = {
    "screening": "looking for data faults",
    "linearising": "fitting frames and clock offset",
    "servos": "fitting stiffness and damping of the servos",
    "selecting": "searching for physics",
    "naming": "testing names",
    "estimating": "computing the final estimates",
    "planning": "choosing poses that separate the alternatives",
}


@contextmanager
def stages() -> Iterator[Callable[[Stage], None]]:
    """Shows the stages that the yielded function is called with, until the end of the context."""
    began = time.monotonic()
    reached = list[Stage]()

    def line() -> str:
        so_far = f"{minutes(time.monotonic() - began)} so far"
        if not reached:
            return f"reading rows, {so_far}"
        stage = reached[-1]
        block = ""
        if 0 < stage.part < stage.parts:
            block = f", without block {stage.part} of {stage.parts - 1}"
        return f"{_STAGES[stage.code]}{block}: {so_far}"

    with repeated(line):
        yield reached.append
