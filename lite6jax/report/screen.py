"""The terminal: plain text as it is given, paths in one piece, a progress bar where someone looks."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text


def console(stderr: bool = False) -> Console:
    """A console that takes no character of a file's name for markup."""
    return Console(stderr=stderr, highlight=False, markup=False, emoji=False)


def show(parts: Iterable[RenderableType]) -> None:
    """Prints parts one below the other."""
    screen = console()
    for part in parts:
        screen.print(part, soft_wrap=isinstance(part, Text) and bool(part.no_wrap))


def written(paths: Iterable[Path]) -> None:
    """Says what was written, a line a file however long its path."""
    screen = console()
    for path in paths:
        screen.print(f"Wrote {path}", soft_wrap=True)


@contextmanager
def progress(total: int, what: str) -> Iterator[Callable[[int], None]]:
    """A bar on stderr, gone when done; nothing where stderr is no terminal. Gives what advances it, from any thread."""
    screen = console(stderr=True)
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as bar:
        task = bar.add_task("", total=total)
        yield lambda done: bar.advance(task, done)
