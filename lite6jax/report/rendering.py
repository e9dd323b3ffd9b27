"""What the pages of all diagnoses share: templates, embedded figures, data faults and effects that were not tested."""

import base64
from collections.abc import Mapping, Sequence
from functools import cache
from io import BytesIO
from typing import Any, NamedTuple

import jinja2
from matplotlib import rc_context
from matplotlib.figure import Figure

from lite6jax.report import statements, worth
from lite6jax.report.canvas import STYLE
from lite6jax.report.cells import listed
from lite6jax.report.data_faults import fault_name
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


def fault_row(entry: Mapping[str, Any]) -> dict[str, str]:
    """A data fault, found or ruled out, of a document with statements."""
    return {"name": fault_name(entry["fault"]), "statement": entry["statement"], "rows": listed(entry["rows"])}


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


def ranking(document: Mapping[str, Any], findings: list[dict[str, Any]]) -> dict[str, Any]:
    """The findings of a page with a bar each, in the unit in which they are ranked; no bars in an old document."""
    bars = worth.bars(document)
    for bar, finding in zip(bars, findings, strict=False):
        finding |= {"size": bar.size, "width": f"{100 * bar.share:.1f}"}
    return {"unit": worth.measure_of(document).unit, "bars": bool(bars)}


def folded(checked: Sequence[object], document: Mapping[str, Any]) -> str:
    """What the folded part of a page holds."""
    effects = {(entry["effect"], entry["site"]) for key in ("untestable", "confounded") for entry in document[key]}
    return f"{len(checked)} data faults ruled out, {len(effects)} effects not tested"


def untested_row(group: statements.Untested) -> dict[str, str]:
    """Effects that a recording cannot show, with the reason."""
    effects = "; ".join(f"{name} at {sites}" for name, sites in statements.by_site(group.entries))
    return {"reason": group.reason, "effects": effects}


def _embedded(figure: Figure) -> str:
    with BytesIO() as held:
        with rc_context(STYLE):
            figure.savefig(held, format="png", dpi=_DPI, metadata={"Software": None})
        return "data:image/png;base64," + base64.b64encode(held.getvalue()).decode()
