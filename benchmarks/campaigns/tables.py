"""Tables of many trials, for the terminal and as Markdown."""

from collections.abc import Iterable, Iterator, Sequence

from rich import box
from rich.table import Table

Cells = Sequence[Sequence[str]]
Section = tuple[str, Sequence[str], Cells]
"""Title, head and rows of a table."""


def tables(sections: Iterable[Section]) -> Iterator[Table]:
    """For the terminal."""
    for title, head, cells in sections:
        table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
        for name in head:
            table.add_column(name, overflow="fold")
        for row in cells:
            table.add_row(*row, style="red" if row[-1] == "NO" else None)
        yield table


def markdown(sections: Iterable[Section]) -> str:
    """For the README."""
    parts = []
    for title, head, cells in sections:
        lines = [f"**{title}**", "", f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
        lines += [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in cells]
        parts.append("\n".join(lines))
    return "\n\n".join(parts)
