"""What the pages of all diagnoses share: templates, embedded figures, and the values of both domains."""

import base64
from collections.abc import Mapping, Sequence
from functools import cache
from io import BytesIO
from types import ModuleType
from typing import Any, NamedTuple

import jinja2
from matplotlib import rc_context
from matplotlib.figure import Figure

from lite6jax.report import next_steps, statements, worth
from lite6jax.report.canvas import STYLE
from lite6jax.report.cells import listed
from lite6jax.report.data_faults import fault_name
from lite6jax.report.next_steps import Files
from lite6jax.report.quantities import Quantity
from lite6jax.report.remedies import remedy_of

_DPI = 120


class Picture(NamedTuple):
    """A figure in the page.

    Attributes:
        data: the whole image, as a `data:` address.
        caption: one sentence.
        narrow: whether it has one panel.
    """

    data: str
    caption: str
    narrow: bool


def picture(figure: Figure, caption: str) -> Picture:
    """A figure with its caption."""
    return Picture(_embedded(figure), caption, sum(panel.get_visible() for panel in figure.axes) == 1)


@cache
def template(name: str) -> jinja2.Template:
    """A template of this package by the name of its file."""
    loader = jinja2.PackageLoader("lite6jax.report")
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template(name)


def whole_page(content: str, values: Mapping[str, Any]) -> str:
    """The page of one domain, HTML.

    Args:
        content: the template of what follows the header.
        values: that it and the header are filled with.
    """
    return template("diagnosis.html").render(values, content=content, anchor="")


def shared_values(
    document: Mapping[str, Any],
    words: ModuleType,
    source: str,
    findings: list[dict[str, Any]],
    figures: Mapping[str, Figure],
    captions: Mapping[str, str],
    files: Files | None,
) -> dict[str, Any]:
    """What the templates of poses and of torques are both filled with.

    Args:
        document: with statements.
        words: `statements` or `torque_statements`.
        source: the recording's name, of any characters.
        findings: as of `finding_row`, ranked.
        figures: by name.
        captions: of those that have a place of their own, by name.
        files: for commands to copy; without them there are none.
    """
    checked = [_fault_row(entry) for entry in document["ruled_out"]]
    return {
        "source": source,
        "headline": worth.headline(document),
        "cautions": [words.verdict_statement(document), *words.cautions(document)],
        "verdict_word": document["verdict"],
        "figures": {name: picture(figures[name], caption) for name, caption in captions.items()},
        "faults": [_fault_row(entry) for entry in document["data_faults"]],
        "findings": findings,
        "ranking": _ranking(document, findings),
        "steps": [] if files is None else next_steps.steps(document, files),
        "checked": checked,
        "folded": _folded(checked, document),
        "untested": [_untested_row(group) for group in words.untested(document)],
        "to_record": words.what_to_record(document),
    }


def finding_row(
    entry: Mapping[str, Any],
    quantities: list[Quantity],
    rivals: list[str],
    rejected: list[str],
    shown: Picture,
    torques: bool = False,
) -> dict[str, Any]:
    """A finding with its figure.

    Args:
        entry: of the document, with `title` and `statement`.
        quantities: its parameters as they are read.
        rivals: effects that the recording does not distinguish from it.
        rejected: the nearest effects that explain clearly less.
        shown: its figure.
        torques: whether it acts on torques.
    """
    gain = entry["log_likelihood_gain"]
    return {
        "title": entry["title"],
        "statement": entry["statement"],
        "remedy": remedy_of(entry, torques).action,
        "parameters": quantities,
        "significance": f"{statements.p_value_statement(entry)} It increases the log-likelihood by {gain:.1f}.",
        "rivals": rivals,
        "rejected": ", ".join(rejected),
        "figure": shown,
    }


def _fault_row(entry: Mapping[str, Any]) -> dict[str, str]:
    """A data fault, found or ruled out, of a document with statements."""
    return {"name": fault_name(entry["fault"]), "statement": entry["statement"], "rows": listed(entry["rows"])}


def _ranking(document: Mapping[str, Any], findings: list[dict[str, Any]]) -> dict[str, Any]:
    """The findings of a page with a bar each, in the unit in which they are ranked; no bars in an old document."""
    bars = worth.bars(document)
    for bar, finding in zip(bars, findings, strict=False):
        finding |= {"size": bar.size, "width": f"{100 * bar.share:.1f}"}
    return {"unit": worth.unit_of(document), "bars": bool(bars)}


def _folded(checked: Sequence[object], document: Mapping[str, Any]) -> str:
    """What the folded part of a page holds."""
    effects = {(entry["effect"], entry["site"]) for key in ("untestable", "confounded") for entry in document[key]}
    return f"{len(checked)} data faults ruled out, {len(effects)} effects not tested"


def _untested_row(group: statements.Untested) -> dict[str, str]:
    """Effects that a recording cannot show, with the reason."""
    effects = "; ".join(f"{name} at {sites}" for name, sites in statements.by_site(group.entries))
    return {"reason": group.reason, "effects": effects}


def _embedded(figure: Figure) -> str:
    with BytesIO() as held:
        with rc_context(STYLE):
            figure.savefig(held, format="png", dpi=_DPI, metadata={"Software": None})
        return "data:image/png;base64," + base64.b64encode(held.getvalue()).decode()
