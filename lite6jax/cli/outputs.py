"""What `diagnose` writes and prints of what it found: the document, the figures, the page and the report."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from lite6jax.storage import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from lite6jax.cli.diagnose import Diagnose
    from lite6jax.recordings import Recording
    from lite6jax.report.ranking import Files

Document = Mapping[str, Any]


class Drawings(NamedTuple):
    """The figures of a diagnosis, and its page.

    Attributes:
        figures: by name; each is drawn when it is asked for.
        most: figures that there may be.
        page: makes the page from what was diagnosed, the figures and the files, HTML.
    """

    figures: "Iterator[tuple[str, Figure]]"
    most: int
    page: "Callable[[str, Mapping[str, Figure], Files], str]"


def check_figures(command: "Diagnose", names: Sequence[str]) -> None:
    """Checks that the figures can be written where the command asks for them; call it before a long computation.

    Args:
        command: as it was given.
        names: of the figures.

    Raises:
        InputError: as `canvas.check_names`.
    """
    if command.figures:
        from lite6jax.report import canvas

        canvas.check_names(command.figures, [_file_name(command, name) for name in names], command.force)


def present(
    command: "Diagnose",
    recording: "Recording",
    document: Document,
    report: "Callable[[Document, str, Files, bool], Iterator[RenderableType]]",
    drawings: Callable[[], Drawings],
    against: str | None = None,
) -> None:
    """Writes the document, the figures and the page where the command has places for them; prints report or document.

    Args:
        command: as it was given; its paths have been checked.
        recording: that was diagnosed.
        document: as in the JSON file, with statements.
        report: makes the screen report from document, source, files and whether details are shown.
        drawings: called where figures or the page are written: only these need what draws.
        against: the reference with which the recording was compared, if any.
    """
    from lite6jax.diagnosis.document import document_text, write_document
    from lite6jax.report import screen
    from lite6jax.report.ranking import Files

    files = Files(command.source, command.out, command.effects)
    written = [write_document(document, command.out, command.force)] if command.out else []
    if command.report or command.figures:
        sides = str(command.source) if against is None else f"{command.source} against {against}"
        written += _draw(command, drawings(), sides, files)
    if command.json:
        print(document_text(document))
        return
    screen.show(report(document, str(command.source), files, command.details))
    screen.show(screen.notes(recording.notes))
    screen.written(written)


def _draw(command: "Diagnose", drawings: Drawings, sides: str, files: "Files") -> list[Path]:
    from lite6jax.report import canvas, screen

    written, drawn = [], {}
    with screen.progress(2 * drawings.most + 1, "drawing") as advance:
        for name, figure in drawings.figures:
            drawn[name] = figure
            advance(1)
        if command.figures:
            named = {_file_name(command, name): figure for name, figure in drawn.items()}
            written += canvas.save(named, command.figures, command.force)
        advance(drawings.most)
        if command.report:
            written.append(write_atomically(command.report, drawings.page(sides, drawn, files), command.force))
    return written


def _file_name(command: "Diagnose", figure: str) -> str:
    return f"{command.source.stem}_{figure}"
