"""The report of a diagnosis, of poses, torques or both, built of sections: how each looks on a terminal and on a page.

To add a section, write a class with one or both looks and put it into `SECTIONS`, which is the order of both reports.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from lite6jax.recordings.fault import DataFault
from lite6jax.report import ranking, reference, statements
from lite6jax.report.faults import fault_name, ruled_out_statements
from lite6jax.report.ranking import Files, of_torques
from lite6jax.report.remedies import by_site, remedy_of
from lite6jax.report.screen import headed, indented
from lite6jax.report.words import capital, counted, fixed, joint_units, listed, listing, number, significant

Document = Mapping[str, Any]

_NARROW, _WIDE = 8, 40
"""Characters of the longest bar, on a narrow and on a wide terminal."""
_MOST = 12
"""Findings that are drawn."""
_ERRORS = ("rms", "p95", "max")


class Picture(NamedTuple):
    """A figure on a page.

    Attributes:
        data: the whole image, as a `data:` address.
        caption: one sentence.
        narrow: whether it has one panel.
    """

    data: str
    caption: str
    narrow: bool


@final
@dataclass(frozen=True)
class Report:
    """Of what a report is made.

    Attributes:
        document: of one domain, as in the JSON file, with statements; all text is made from it.
        source: the recording's name, of any characters.
        files: for commands to copy; without them there are none.
        details: whether a terminal lists also what was ruled out and what was not tested.
        pictures: of a page, by the name of the figure, or of one of `finding1`, `finding2` … by rank.
        anchor: begins the names of places on a page, which is of both domains.
    """

    document: Document
    source: str
    files: Files | None = None
    details: bool = False
    pictures: Mapping[str, Picture] = field(default_factory=dict)
    anchor: str = ""

    @cached_property
    def findings(self) -> list[dict[str, Any]]:
        """Ranked, with what is said of each."""
        return statements.findings_of(self.document)

    def page(self, sections: "Sequence[Section]") -> list[dict[str, Any]]:
        """What `page.html` shows of those of some sections that have something to show."""
        filled = [{"title": each.title, "kind": each.kind, "blocks": list(each.page(self))} for each in sections]
        return [section for section in filled if section["blocks"]]

    def screen(self) -> Iterator[RenderableType]:
        """What a terminal shows of the document."""
        yield Text(self.source, no_wrap=True, overflow="ignore")
        yield Text(statements.setting_statement(self.document))
        yield ""
        for section in (*HEADER, *SECTIONS):
            yield from section.screen(self)
        yield ""


Block = tuple[str, Any]
"""A part of a section on a page: a macro of `blocks.html`, and what it shows."""


class Section:
    """One part of a report. A look that yields nothing is not shown.

    Attributes:
        title: the heading on a page.
        kind: the class of its element on a page; that of most has none.
    """

    title, kind = "", ""

    def screen(self, of: Report) -> Iterator[RenderableType]:
        """What a terminal shows."""
        yield from ()

    def page(self, of: Report) -> Iterator[Block]:
        """What a page shows below the title."""
        yield from ()


@final
class Against(Section):
    """The comparison with a reference recording, where there is one."""

    title, kind = "Difference from the reference", "against"

    def screen(self, of: Report) -> Iterator[RenderableType]:
        if comparison := of.document.get("against"):
            yield Text(self._headline(of.document))
            lines = (*self._said(comparison, "differences"), *self._said(comparison, "notes"), comparison["statement"])
            yield from map(indented, lines)
            yield ""

    def page(self, of: Report) -> Iterator[Block]:
        if comparison := of.document.get("against"):
            yield "text", self._headline(of.document)
            yield "bullets", self._said(comparison, "differences")
            yield "soft_bullets", self._said(comparison, "notes")
            yield "text", comparison["statement"]

    def _headline(self, document: Document) -> str:
        return reference.headline(document["against"], ranking.units(document) if of_torques(document) else ())

    def _said(self, comparison: Document, key: str) -> list[str]:
        return [entry["statement"] for entry in comparison.get(key, ())]


@final
class Cause(Section):
    """The first sentence, the verdict and what qualifies it; on a page also the arm, and how much was recorded."""

    def screen(self, of: Report) -> Iterator[RenderableType]:
        yield Text(ranking.headline(of.document))
        yield ""
        yield from map(Text, self._verdict(of))

    def page(self, of: Report) -> Iterator[Block]:
        setting = statements.setting_statement(of.document)
        if not of_torques(of.document):
            model, numbers = of.document["model"], of.document["nuisance"]["numbers"]
            measured = "positions and orientations" if model["orientation"] else "positions"
            known = "the geometry is taken as given"
            fitted = f"{numbers} numbers of frames and geometry are fitted" if numbers else known
            setting = f"{setting.removesuffix('.')} of {measured}; {fitted}."
        yield "cause", (of.document["verdict"], ranking.headline(of.document))
        yield from (("text", line) for line in (*self._verdict(of), setting))

    def _verdict(self, of: Report) -> list[str]:
        return [statements.verdict_statement(of.document), *statements.cautions(of.document)]


@final
class Ranking(Section):
    """The contributions of the findings, a bar each."""

    title = "What each finding moves"

    def screen(self, of: Report) -> Iterator[RenderableType]:
        bars = ranking.bars(of.document)
        if not bars:
            return
        yield ""
        yield Text(f"{self.title} ({self._unit(of)}):")
        table = Table.grid(padding=(0, 1, 0, 0))
        table.add_column(justify="right", no_wrap=True)
        table.add_column(max_width=44)
        table.add_column(min_width=_NARROW)
        table.add_column(justify="right", no_wrap=True)
        for rank, (bar, finding) in enumerate(zip(bars[:_MOST], of.findings, strict=False), 1):
            table.add_row(Text(f"{rank}."), Text(finding["title"]), _TextBar(bar.share), Text(bar.size))
        yield table
        if len(bars) > _MOST:
            yield Text(f"and {len(bars) - _MOST} more, which move less")

    def page(self, of: Report) -> Iterator[Block]:
        pairs = zip(ranking.bars(of.document), of.findings, strict=False)
        rows = [(finding["title"], f"{100 * bar.share:.1f}", bar.size) for bar, finding in pairs]
        if rows:
            yield "ranking", (rows, self._unit(of), of.anchor)

    def _unit(self, of: Report) -> str:
        return f"{ranking.unit_of(of.document)} RMS".strip()


class _TextBar:
    """A bar of a share of its column; it has one character at least."""

    def __init__(self, share: float) -> None:
        self.share = share

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = min(options.max_width, _WIDE)
        yield Segment(("#" if options.ascii_only else "█") * max(round(self.share * width), 1))

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(min(_NARROW, options.max_width), min(_WIDE, options.max_width))


@final
class Errors(Section):
    """Held-out errors before and after, and the noise."""

    title = "Held-out errors before and after"

    def screen(self, of: Report) -> Iterator[RenderableType]:
        document = of.document
        yield ""
        if of_torques(document):  # by joint, one a line: seven joints side by side do not fit a narrow terminal
            common = ranking.common_unit(document)
            rows = (
                (name if common else f"{name} ({unit})", *map(significant, sizes))
                for name, unit, _, *sizes in statements.errors(document, ["rms"])
            )
            yield listing(f"held-out error ({f'{common} RMS'.strip()})", "before", "after", rows=rows)
        else:
            rows = ((stage, *map(number, self._positions(document, stage))) for stage in ("before", "after"))
            yield listing("held-out position error (mm)", *_ERRORS, rows=rows, wrapped=[0])
        yield Text(statements.held_out_statement(document))
        noise = [statements.noise_statement(document)]
        yield from map(Text, statements.assumptions(document) if of_torques(document) else noise)

    def page(self, of: Report) -> Iterator[Block]:
        document, named = of.document, [statements.STATISTICS[key] for key in _ERRORS]
        if of_torques(document):
            common = ranking.common_unit(document)
            columns = [f"{stage} ({common})" if common else stage for stage in ("before", "after")]
            rows = [
                [f"{name}, {statements.STATISTICS[key]}{'' if common else f' ({unit})'}", f"{own:.3g}", f"{left:.3g}"]
                for name, unit, key, own, left in statements.errors(document, _ERRORS)
            ]
            yield "table", (["held-out torque error", *columns], rows)
        else:
            before, after = (self._positions(document, stage) for stage in ("before", "after"))
            rows = [[name, *map(number, values)] for name, values in (("before", before), ("after", after))]
            if document["findings"]:
                pairs = zip(before, after, strict=True)
                rows.append(["after / before", *(f"{100 * left / own:.0f} %" if own else "–" for own, left in pairs)])
            yield "table", (["held-out position error", *(f"{name} (mm)" for name in named)], rows)
        yield "text", statements.held_out_statement(document)
        yield "text", statements.noise_statement(document)
        yield from (("picture", of.pictures[name]) for name in ("error_by_joint", "over_time") if name in of.pictures)

    def _positions(self, document: Document, stage: str) -> list[float]:
        """mm."""
        return [1e3 * document[stage][f"heldout_position_{key}_m"] for key in _ERRORS]


@final
class Faults(Section):
    """Data faults; on a page also what the tests rest on."""

    title = "Data faults"

    def screen(self, of: Report) -> Iterator[RenderableType]:
        rows = (f" Rows {listed(entry['rows'])}." if entry["rows"] else "" for entry in of.document["data_faults"])
        lines = (entry["statement"] + at for entry, at in zip(of.document["data_faults"], rows, strict=True))
        yield from headed("Data faults:", lines)

    def page(self, of: Report) -> Iterator[Block]:
        for entry in of.document["data_faults"]:
            yield "fault", (fault_name(entry["fault"]), entry["statement"], listed(entry["rows"]))
        if not of.document["data_faults"]:
            yield "text", "None found."
        if lines := statements.assumptions(of.document):
            yield "heading", "Assumptions"
            yield "bullets", lines


@final
class Findings(Section):
    """Each finding with its statement and the effects that the recording does not distinguish from it."""

    title = "Findings"

    def screen(self, of: Report) -> Iterator[RenderableType]:
        if not of.findings:
            return
        table = Table.grid(padding=(0, 1, 0, 0))
        for rank, finding in enumerate(of.findings, 1):
            said = f"{finding['statement']} {statements.p_value_statement(finding)}"
            rivals = f"\nNot distinguished from {', '.join(finding['rivals'])}." if finding["rivals"] else ""
            table.add_row(Text(f"{rank}."), Text(said + rivals))
        yield ""
        yield Text("Findings:")
        yield table

    def page(self, of: Report) -> Iterator[Block]:
        for rank, finding in enumerate(of.findings, 1):
            yield (
                "finding",
                {
                    **finding,
                    "rank": rank,
                    "id": f"{of.anchor}finding{rank}",
                    "remedy": remedy_of(finding, of_torques(of.document)).action,
                    "significance": f"{statements.p_value_statement(finding)} Its log evidence is "
                    f"{finding['log_likelihood_gain']:.1f}.",
                    "picture": of.pictures[f"finding{rank}"],
                },
            )
        if not of.findings:
            yield (
                "text",
                "None: no effect of the catalogue, and no function of what was recorded, is significant.",
            )


@final
class Actions(Section):
    """Remedies of the findings, each once, and commands to copy; a page has the remedies with the findings."""

    title = "Commands to copy"

    def screen(self, of: Report) -> Iterator[RenderableType]:
        several = len(of.document["findings"]) > 1
        actions = ranking.actions(of.document)
        yield from headed("What to do:", (f"{listed(at)}. {said}" if several else said for at, said in actions))
        steps = self._steps(of)
        if steps:
            yield ""
            yield Text(f"{self.title}:")
        for step in steps:
            yield indented(f"{capital(step.purpose)}:")
            yield Text(f"    {step.command}", no_wrap=True, overflow="ignore")

    def page(self, of: Report) -> Iterator[Block]:
        yield from (("command", (capital(step.purpose), step.command)) for step in self._steps(of))

    def _steps(self, of: Report) -> list[ranking.Step]:
        return [] if of.files is None else ranking.steps(of.document, of.files)


@final
class Assumptions(Section):
    """On a terminal, what the tests of poses rest on."""

    def screen(self, of: Report) -> Iterator[RenderableType]:
        if not of_torques(of.document):
            yield from headed("Assumptions:", statements.assumptions(of.document))


@final
class Drawn(Section):
    """On a page, figures with a heading of their own."""

    def __init__(self, title: str, *names: str) -> None:
        self.title, self.names = title, names

    def page(self, of: Report) -> Iterator[Block]:
        yield from (("picture", of.pictures[name]) for name in self.names if name in of.pictures)


@final
class ToRecord(Section):
    """What another recording would answer, and the poses that separate rival effects."""

    title = "What to record next"

    def screen(self, of: Report) -> Iterator[RenderableType]:
        yield from headed(f"{self.title}:", statements.what_to_record(of.document))
        for title, joints, rows in self._poses(of.document):
            yield ""
            yield Text(f"{title}:")
            numbered = ((str(k), *row) for k, row in enumerate(rows, 1))
            yield listing("", *(f"q{joint}" for joint in joints), rows=numbered)
        if of.document.get("separating_poses"):
            yield Text(statements.NOT_CHECKED)

    def page(self, of: Report) -> Iterator[Block]:
        if lines := statements.what_to_record(of.document):
            yield "bullets", lines
        else:
            yield "text", "Nothing: this recording leaves no question open that another one would answer."
        for title, joints, rows in self._poses(of.document):
            yield "heading", title
            numbered = [[str(k), *row] for k, row in enumerate(rows, 1)]
            yield "table", (["pose", *(f"joint {joint}" for joint in joints)], numbered)
        if of.document.get("separating_poses"):
            yield "soft", statements.NOT_CHECKED

    def _poses(self, document: Document) -> Iterator[tuple[str, Sequence[int], list[list[str]]]]:
        """For each table its title, the numbers of the joints, and the rows in deg or mm."""
        for item in document.get("separating_poses", ()):
            position = np.array(item["joint_position_rad"])
            scales, units = joint_units(ranking.sliding(document), position.shape[1])
            rows = [[fixed(float(value), 1) for value in row] for row in scales * position]
            one, other = (label.replace("_", " ").replace(":", " at ") for label in item["effects"])
            title = f"Poses that separate {one} from {other} ({', '.join(dict.fromkeys(units))})"
            yield title, range(1, position.shape[1] + 1), rows


@final
class Tested(Section):
    """What was ruled out and what was not tested; on a terminal their number, where details are not asked for."""

    kind = "folded"

    def screen(self, of: Report) -> Iterator[RenderableType]:
        entries, untested = of.document["ruled_out"], statements.untested(of.document)
        if of.details:
            faults = (DataFault(entry["fault"], (), entry["numbers"]) for entry in entries)
            yield from headed("Data faults tested and ruled out:", ruled_out_statements(faults))
            named = [(", ".join(self._effects(group)), group.reason) for group in untested]
            yield from headed("Effects not tested:", (f"{capital(names)}. {reason}" for names, reason in named))
            return
        effects = len({(entry["effect"], entry["site"]) for group in untested for entry in group.entries})
        said = [f"{counted(len(entries), 'data fault')} ruled out"] if entries else []
        said += [f"{counted(effects, 'effect')} not tested"] if effects else []
        if said:
            yield ""
            yield Text(f"{' and '.join(said)}: --details lists them.")

    def page(self, of: Report) -> Iterator[Block]:
        entries, groups = of.document["ruled_out"], statements.untested(of.document)
        effects = {(entry["effect"], entry["site"]) for group in groups for entry in group.entries}
        count = f"{len(entries)} data faults ruled out, {len(effects)} effects not tested"
        yield "summary", f"Tested and ruled out, and not tested: {count}"
        if entries:
            yield "heading", "Data faults tested and ruled out"
            yield "checked", [(fault_name(entry["fault"]), entry["statement"]) for entry in entries]
        yield "heading", "Effects not tested"
        yield from (("untested", (group.reason, "; ".join(self._effects(group)))) for group in groups)
        if not groups:
            yield "text", "All effects of the catalogue were tested."

    def _effects(self, group: statements.Untested) -> list[str]:
        return [f"{name} at {sites}" for name, sites in by_site(group.entries)]


HEADER: tuple[Section, ...] = (Against(), Cause())
SECTIONS: tuple[Section, ...] = (
    *(Ranking(), Errors(), Faults(), Findings(), Actions(), Assumptions()),
    Drawn("Explained variance by site, driver and order", "where", "orders"),
    *(Drawn("Friction", "friction"), Drawn("Filter", "spectra")),
    *(ToRecord(), Tested()),
)


def diagnosis_report(
    document: Document, source: str, files: Files | None = None, details: bool = False
) -> Iterator[RenderableType]:
    """What a terminal shows of a diagnosis; of both domains the poses, the torques, and what both depend on.

    Args:
        document: as in the JSON file, with statements.
        source: the recording.
        files: for commands to copy; without them there are none.
        details: whether to list also what was ruled out and what was not tested.
    """
    both = "torques" in document or "torques_refused" in document
    if both:
        yield Text("Poses", style="bold")
    yield from Report(document, source, files, details).screen()
    if "torques" in document:
        yield Text("Torques", style="bold")
        yield from Report(document["torques"], source, None, details).screen()
        yield Text(f"{reference.SHARED}:")
        yield from map(indented, reference.shared_statements(document))
        yield ""
    elif both:
        yield Text(reference.refusal(document))
        yield ""
