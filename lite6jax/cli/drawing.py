"""The figures and the page of a diagnosis, written where its command was given a place for them."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from lite6jax.storage import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lite6jax.cli.diagnose import Diagnose


def draw(
    command: "Diagnose",
    drawings: "Iterator[tuple[str, Figure]]",
    count: int,
    page: "Callable[[Mapping[str, Figure]], str]",
) -> list[Path]:
    """Draws, and writes the figures and the page. Returns the written paths.

    Args:
        command: as it was given.
        drawings: figures by name.
        count: of the figures, at most.
        page: makes the page from them, HTML.
    """
    from lite6jax.report import canvas, screen

    written, drawn = [], {}
    with screen.progress(2 * count + 1, "drawing") as advance:
        for name, figure in drawings:
            drawn[name] = figure
            advance(1)
        if command.figures:
            named = {f"{command.source.stem}_{name}": figure for name, figure in drawn.items()}
            written += canvas.save(named, command.figures, command.force)
        advance(count)
        if command.report:
            written.append(write_atomically(command.report, page(drawn), command.force))
    return written
