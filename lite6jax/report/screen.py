"""Output to the terminal: text without markup, unbroken paths, and a progress bar."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text


def console(stderr: bool = False) -> Console:
    """A console that interprets no character of a file name as markup."""
    return Console(stderr=stderr, highlight=False, markup=False, emoji=False)


def show(parts: Iterable[RenderableType]) -> None:
    """Prints parts below each other."""
    screen = console()
    for part in parts:
        screen.print(part, soft_wrap=isinstance(part, Text) and bool(part.no_wrap))


def notes(said: Iterable[str]) -> Iterator[Text]:
    """Remarks, a line each, such as those of a recording; a full stop at their end is added where there is none."""
    yield from (Text(f"Note: {note.removesuffix('.')}.") for note in said)


def written(paths: Iterable[Path]) -> None:
    """Prints the written files, one line each without wrapping."""
    screen = console()
    for path in paths:
        screen.print(f"Wrote {path}", soft_wrap=True)


@contextmanager
def progress(total: int, what: str) -> Iterator[Callable[[int], None]]:
    """A transient progress bar on stderr if that is a terminal. Yields a thread-safe function that advances it."""
    screen = console(stderr=True)
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as bar:
        task = bar.add_task("", total=total)
        yield lambda done: bar.advance(task, done)
