"""What the screen reports of all diagnoses share: bars, remedies with commands, and what is folded away."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from lite6jax.recordings.fault import DataFault
from lite6jax.report import next_steps, statements, worth
from lite6jax.report.cells import capital, listed
from lite6jax.report.data_faults import ruled_out_statements
from lite6jax.report.next_steps import Files
from lite6jax.report.reference import Compared

_NARROW, _WIDE = 8, 40
"""Characters of the longest bar, on a narrow and on a wide terminal."""
_MOST = 12
"""Findings that are drawn."""


class TextBar:
    """A bar of a share of its column; it has one character at least."""

    def __init__(self, share: float) -> None:
        self.share = share

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = min(options.max_width, _WIDE)
        yield Segment(("#" if options.ascii_only else "█") * max(round(self.share * width), 1))

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(min(_NARROW, options.max_width), min(_WIDE, options.max_width))


def against(seen: Compared | None) -> Iterator[RenderableType]:
    """A comparison with a reference; nothing where there is none."""
    if seen is not None:
        yield Text(seen.headline)
        yield from map(indented, (*seen.differences, *seen.notes, seen.statement))
        yield ""


def chart(document: Mapping[str, Any], findings: Sequence[Mapping[str, Any]]) -> Iterator[RenderableType]:
    """The findings with a bar each, in their order; nothing where there are none.

    Args:
        document: of poses or of torques.
        findings: all of them, ranked, with titles.
    """
    bars = worth.bars(document)
    if not bars:
        return
    yield ""
    yield Text(f"What each finding moves ({f'{worth.unit_of(document)} RMS'.strip()}):")
    table = Table.grid(padding=(0, 1, 0, 0))
    table.add_column(justify="right", no_wrap=True)
    table.add_column(max_width=44)
    table.add_column(min_width=_NARROW)
    table.add_column(justify="right", no_wrap=True)
    for bar, finding in zip(bars[:_MOST], findings, strict=False):
        table.add_row(Text(f"{bar.number}."), Text(finding["title"]), TextBar(bar.share), Text(bar.size))
    yield table
    if len(bars) > _MOST:
        yield Text(f"and {len(bars) - _MOST} more, which move less")


def finding_list(
    findings: Sequence[Mapping[str, Any]], undistinguished: Callable[[Mapping[str, Any]], list[str]]
) -> Iterator[RenderableType]:
    """The findings with their statements, and for each the effects that the recording does not distinguish from it."""
    if not findings:
        return
    table = Table.grid(padding=(0, 1, 0, 0))
    for k, finding in enumerate(findings, 1):
        lines = [f"{finding['statement']} {statements.p_value_statement(finding)}"]
        rivals = undistinguished(finding)
        if rivals:
            lines.append(f"Not distinguished from {', '.join(rivals)}.")
        table.add_row(Text(f"{k}."), Text("\n".join(lines)))
    yield ""
    yield Text("Findings:")
    yield table


def fault_line(entry: Mapping[str, Any]) -> str:
    """A data fault with its rows."""
    rows = f" Rows {listed(entry['rows'])}." if entry["rows"] else ""
    return f"{entry['statement']}{rows}"


def what_to_do(document: Mapping[str, Any], files: Files | None) -> Iterator[RenderableType]:
    """Remedies of the findings, each once, and commands to copy."""
    several = len(document["findings"]) > 1
    lines = [f"{listed(ranks)}. {action}" if several else action for ranks, action in next_steps.actions(document)]
    yield from headed("What to do:", lines)
    steps = [] if files is None else next_steps.steps(document, files)
    if steps:
        yield ""
        yield Text("Commands to copy:")
    for step in steps:
        yield indented(f"{capital(step.purpose)}:")
        yield Text(f"    {step.command}", no_wrap=True, overflow="ignore")


def ruled_out(
    document: Mapping[str, Any], untested: Sequence[statements.Untested], details: bool
) -> Iterator[RenderableType]:
    """What was ruled out and what was not tested: their number and the option that lists them, or the lists."""
    entries = document["ruled_out"]
    if details:
        faults = (DataFault(entry["fault"], (), entry["numbers"]) for entry in entries)
        yield from headed("Data faults tested and ruled out:", ruled_out_statements(faults))
        yield from headed("Effects not tested:", map(_untested, untested))
        return
    effects = len({(entry["effect"], entry["site"]) for group in untested for entry in group.entries})
    said = [
        *([f"{len(entries)} data fault{'s' * (len(entries) != 1)} ruled out"] if entries else []),
        *([f"{effects} effect{'s' * (effects != 1)} not tested"] if effects else []),
    ]
    if said:
        yield ""
        yield Text(f"{' and '.join(said)}: --details lists them.")


def _untested(group: statements.Untested) -> str:
    names = ", ".join(f"{name} at {sites}" for name, sites in statements.by_site(group.entries))
    return f"{capital(names)}. {group.reason}"


def headed(heading: str, lines: Iterable[str]) -> Iterator[RenderableType]:
    """A heading with indented lines; nothing where there are none."""
    for k, line in enumerate(lines):
        if not k:
            yield ""
            yield Text(heading)
        yield indented(line)


def indented(line: str) -> RenderableType:
    """A line two characters from the margin."""
    return Padding(Text(line), (0, 0, 0, 2))
