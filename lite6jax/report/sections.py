"""The report of a diagnosis, of poses, torques or both: sections of blocks, and how a terminal shows them.

To add a section, write a function that yields its blocks and put it into `sections_of`, which has the order of every
report. To add a kind of block, give it a look in `_LOOKS` here and a macro of its name in `templates/page.html`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from lite6jax.diagnosis.document import domain_of, domains_beside, refusals
from lite6jax.domains.base import DomainName
from lite6jax.domains.registry import DOMAINS
from lite6jax.domains.words import effort_units, sliding
from lite6jax.formatting import capital, counted, fixed, joint_units, row_ranges
from lite6jax.recordings.fault import DataFault
from lite6jax.report import ranking, statements
from lite6jax.report.faults import fault_name, is_granted, ruled_out_statements
from lite6jax.report.ranking import Files
from lite6jax.report.remedies import by_site
from lite6jax.report.reports import own_report
from lite6jax.report.screen import indented, unbroken
from lite6jax.report.sentences import diagnosis as sentences
from lite6jax.report.sentences.document import words_of
from lite6jax.report.words import listing

Document = Mapping[str, Any]
Block = tuple[str, Any]
"""A part of a section: its kind, and what it shows."""

_NARROW = 8
_WIDE = 40
"""Characters of the longest bar, on a narrow and on a wide terminal."""
_MOST = 12
"""Findings that are drawn as bars on a terminal."""


class Picture(NamedTuple):
    """A figure on a page: the image as a `data:` address, a sentence, and whether it has one panel."""

    data: str
    caption: str
    narrow: bool


class Section(NamedTuple):
    """A part of a report: its heading, or none, and blocks below each other; `kind` is its class on a page."""

    title: str
    blocks: Sequence[Block]
    kind: str = ""


def sections_of(
    document: Document,
    files: Files | None = None,
    details: bool = True,
    pictures: Mapping[str, Picture] | None = None,
    anchor: str = "",
) -> list[Section]:
    """The sections that have something to show.

    Args:
        document: of one domain, as in the JSON file, with statements; all text is made from it.
        files: for commands to copy; without them there are none.
        details: whether to list also the rejected alternatives, what was ruled out and what was not tested.
        pictures: of a page, by the name of the figure, or of one of `finding1`, `finding2` … by rank.
        anchor: begins the names of places on a page, which is of both domains.
    """
    pictures = pictures or {}
    own = own_report(document)
    if own is not None:
        made = [Section(title, blocks) for title, blocks in own.parts_of(document, files, details, pictures)]
        return [section for section in made if any(shown for _, shown in section.blocks)]
    drawn = lambda *names: [("picture", pictures[name]) for name in names if name in pictures]  # noqa: E731
    ranked = statements.findings_of(document)
    actions = ranking.actions(document)
    unit = ranking.unit_of(document)
    words = words_of(document)
    bars = [
        (finding["title"], finding["share"], finding["contribution"].removesuffix(f" {unit}")) for finding in ranked
    ]
    verdict = (sentences.verdict_statement(document), *statements.cautions(document))
    to_do = [f"{row_ranges(ranks)}. {action}" if len(ranked) > 1 else action for ranks, action in actions]
    commands = [] if files is None else ranking.steps(document, files)
    made = [
        Section("Difference from the reference", list(_comparison(document)), "against"),
        Section(
            "",
            [
                ("cause", (document["verdict"], ranking.headline(document))),
                *_texts(*verdict, sentences.setting(document)),
            ],
        ),
        Section(f"What each finding moves ({f'{unit} RMS'.strip()})", [("bars", (bars, anchor))] if bars else []),
        Section(
            "Held-out errors before and after",
            [
                ("table", statements.error_rows(document)),
                *_texts(sentences.held_out(document), words.noise(document), *words.assumptions(document)),
                *_texts(*_distance_from_table(document)),
                *drawn("error_by_joint", "over_time"),
            ],
        ),
        Section("Data faults", list(_faults(document, details))),
        Section("Findings", list(_findings(ranked, details, pictures, anchor))),
        Section("What to do", [("bullets", to_do)] if to_do else []),
        Section("Commands to copy", [("command", (capital(step.purpose), step.command)) for step in commands]),
        Section("Explained variance by site, driver and order", drawn("where", "orders")),
        Section("Friction", drawn("friction")),
        Section("Filter", drawn("spectra")),
        Section("What to record next", list(_next_recording(document))),
        Section("Tested and ruled out, and not tested", list(_tests(document, details)), "folded" if details else ""),
    ]
    return [section for section in made if section.blocks]


def parts_of(
    document: Document,
    files: Files | None = None,
    details: bool = True,
    pictures: Sequence[Mapping[str, Picture]] | None = None,
) -> list[tuple[str, list[Section]]]:
    """The sections of each domain of a document, and of both together, with titles where there are several parts.

    Arguments are those of `sections_of`, with the pictures of each domain.
    """
    beside = domains_beside(document)
    pictures = pictures or [{} for _ in range(1 + len(beside))]
    first = sections_of(document, files, details, pictures[0])
    refused = refusals(document)
    if not beside and not refused:
        return [("", first)]
    parts = [(_title(domain_of(document)), first)]
    for domain, of_domain in zip(beside, pictures[1:], strict=True):
        parts.append(
            (
                _title(domain),
                sections_of(document[domain], None, details, of_domain, f"{DOMAINS[domain].words.singular}-"),
            )
        )
    for domain, reason in refused.items():
        parts.append((_title(domain), [Section("", _texts(sentences.refusal(domain, reason)))]))
    if beside:
        agreements = [entry["statement"] for entry in document["shared"]] or [sentences.nothing_shared(document)]
        parts.append(
            ("Both", [Section(f"What {sentences.measured(document)} both depend on", [("bullets", agreements)])])
        )
    return parts


def _title(domain: DomainName) -> str:
    return capital(DOMAINS[domain].words.measured)


def _texts(*lines: str) -> list[Block]:
    return [("text", line) for line in lines]


def _comparison(document: Document) -> Iterator[Block]:
    if comparison := document.get("against"):
        yield "text", sentences.comparison_headline(comparison, effort_units(document))
        yield "bullets", [entry["statement"] for key in ("differences", "notes") for entry in comparison.get(key, ())]
        yield "text", comparison["statement"]


def _distance_from_table(document: Document) -> list[str]:
    """How far the fitted arm is from the nominal one; of a known chain nothing."""
    ruled_out = (DataFault(entry["fault"], (), entry["numbers"]) for entry in document["ruled_out"])
    return ruled_out_statements(fault for fault in ruled_out if is_granted(fault))


def _faults(document: Document, details: bool) -> Iterator[Block]:
    if faults := document["data_faults"]:
        yield (
            "faults",
            [(fault_name(fault["fault"]), fault["statement"], row_ranges(fault["rows"])) for fault in faults],
        )
    elif details:
        yield "text", "None found."


def _findings(
    ranked: Sequence[Document], details: bool, pictures: Mapping[str, Picture], anchor: str
) -> Iterator[Block]:
    entries = []
    for finding in ranked:
        lines = [f"{finding['statement']} {statements.p_value_statement(finding)}"]
        if finding["rivals"]:
            lines.append(f"Not distinguished from {', '.join(finding['rivals'])}.")
        if details and finding["rejected"]:
            lines.append(f"Nearest effects that were rejected: {', '.join(finding['rejected'])}.")
        entries.append({**finding, "lines": lines, "picture": pictures.get(f"finding{finding['rank']}")})
    if entries:
        yield "findings", (entries, anchor)
    elif details:
        yield "text", "None: no effect of the catalogue, and no function of what was recorded, is significant."


def _next_recording(document: Document) -> Iterator[Block]:
    if lines := statements.what_to_record(document):
        yield "bullets", lines
    for item in document["separating_poses"]:
        position = np.array(item["joint_position_rad"])
        scales, units = joint_units(sliding(document), position.shape[1])
        first_effect, second_effect = (label.replace("_", " ").replace(":", " at ") for label in item["effects"])
        yield "heading", f"Poses that separate {first_effect} from {second_effect} ({', '.join(dict.fromkeys(units))})"
        rows = [[str(k), *(fixed(float(value), 1) for value in row)] for k, row in enumerate(scales * position, 1)]
        yield "table", (["", *(f"q{joint}" for joint in range(1, position.shape[1] + 1))], rows)
    if document["separating_poses"]:
        yield "text", statements.NOT_CHECKED


def _tests(document: Document, details: bool) -> Iterator[Block]:
    entries = document["ruled_out"]
    untested = statements.untested(document)
    effects = len({(entry["effect"], entry["site"]) for group in untested for entry in group.entries})
    summary = []
    if entries:
        summary = [f"{counted(len(entries), 'data fault')} ruled out"]
    summary += [f"{counted(effects, 'effect')} not tested"] if effects else []
    if not details:
        yield from [("text", f"{' and '.join(summary)}: --details lists them.")] if summary else []
        return
    if entries:
        yield "heading", "Data faults tested and ruled out"
        yield "bullets", ruled_out_statements(DataFault(entry["fault"], (), entry["numbers"]) for entry in entries)
    if untested:
        yield "heading", "Effects not tested"
        named_groups = [
            (", ".join(f"{name} at {sites}" for name, sites in by_site(group.entries)), group) for group in untested
        ]
        yield "bullets", [f"{capital(names)}. {group.reason}" for names, group in named_groups]


# ------------------------------------------------------------------ on a terminal


class _TextBar:
    """A bar of a share of its column; it has one character at least."""

    def __init__(self, share: float) -> None:
        self.share = share

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = min(options.max_width, _WIDE)
        yield Segment(("#" if options.ascii_only else "█") * max(round(self.share * width), 1))

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(min(_NARROW, options.max_width), min(_WIDE, options.max_width))


def _bars(shown: Any) -> Iterator[RenderableType]:
    bars, _ = shown
    table = Table.grid(padding=(0, 1, 0, 0))
    table.add_column(justify="right", no_wrap=True)
    table.add_column(max_width=44)
    table.add_column(min_width=_NARROW)
    table.add_column(justify="right", no_wrap=True)
    for rank, (title, share, size) in enumerate(bars[:_MOST], 1):
        table.add_row(f"{rank}.", title, _TextBar(share), size)
    yield table
    if len(bars) > _MOST:
        yield f"and {len(bars) - _MOST} more, which move less"


def _grid(rows: Iterable[Iterable[str]], apart: int) -> Iterator[RenderableType]:
    table = Table.grid(padding=(0, apart, 0, 0))
    for row in rows:
        table.add_row(*map(Text, row))
    yield table


_LOOKS: Mapping[str, Callable[[Any], Iterator[RenderableType]]] = {
    "text": lambda line: iter([line]),
    "cause": lambda cause: iter([cause[1], ""]),
    "heading": lambda line: iter(["", f"{line}:"]),
    "bullets": lambda lines: map(indented, lines),
    "faults": lambda faults: (
        indented(statement + (f" Rows {rows}." if rows else "")) for _, statement, rows in faults
    ),
    "table": lambda shown: iter([listing(*shown[0], rows=shown[1], wrapped=[0])]),
    "pairs": lambda pairs: _grid(pairs, 2),
    "bars": _bars,
    "findings": lambda shown: _grid(((f"{finding['rank']}.", "\n".join(finding["lines"])) for finding in shown[0]), 1),
    "command": lambda step: iter([indented(f"{step[0]}:"), unbroken(f"    {step[1]}")]),
    "picture": lambda _: iter(()),
}
"""By the kind of a block, how a terminal shows it."""


def show_sections(sections: Sequence[Section]) -> Iterator[RenderableType]:
    """Sections on a terminal, an empty line before each."""
    for section in sections:
        if any(kind != "picture" for kind, _ in section.blocks):
            yield ""
            yield from [f"{section.title}:"] if section.title else []
            for kind, shown in section.blocks:
                yield from _LOOKS[kind](shown)


def diagnosis_report(
    document: Document, source: str, files: Files | None = None, details: bool = False
) -> Iterator[RenderableType]:
    """What a terminal shows of a document with statements; of several domains one after the other, and what they share.

    Without files there are no commands to copy. Details: rejected alternatives, what was ruled out and not tested.
    """
    yield unbroken(source)
    for title, sections in parts_of(document, files, details):
        yield from ["", Text(title, style="bold")] if title not in ("", "Both") else []
        yield from show_sections(sections)
    yield ""
