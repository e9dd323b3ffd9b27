"""A diagnosis as one self-contained HTML page: verdict, errors, data faults, findings with figures, next steps."""

import base64
from collections.abc import Mapping
from functools import cache
from io import BytesIO
from typing import Any, NamedTuple

import jinja2
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from lite6jax.diagnosis.result import Diagnosis
from lite6jax.report import reference, statements
from lite6jax.report.canvas import STYLE
from lite6jax.report.cells import fixed, listed, number
from lite6jax.report.data_faults import fault_name
from lite6jax.report.diagnosis_tables import ERRORS, noise_statement
from lite6jax.report.finding_figures import finding_figure
from lite6jax.report.quantities import quantity

Document = Mapping[str, Any]

_DPI = 120
_FEW = 3
"""Findings that are read one by one; more have an overview."""
_CAPTIONS = {
    "error_by_joint": "Held-out position error against each joint: dots are samples, lines are medians.",
    "where": "Share of the residual's variance that a curve over each driver explains at each site, less what as many "
    "numbers explain of noise; a dash where the driver is not recorded or constant, or the curve is confounded with "
    "the nuisance.",
    "orders": "Share of the residual's variance that a harmonic of each order explains at each joint, before and after "
    "(of the residual at that stage); the dotted line is the family-wise limit of white noise.",
    "remaining": "Left, the residuals in units of the sensor's noise beside normal noise; right, their autocorrelation "
    "in the order of the rows.",
}


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


def diagnosis_page(found: Diagnosis, document: Document, source: str, figures: Mapping[str, Figure]) -> str:
    """The page, HTML; the same diagnosis gives the same bytes.

    Args:
        found: the diagnosis, of which the figures of single findings are drawn.
        document: as in its JSON file, with statements; all text is made from it.
        source: the recording's name, of any characters.
        figures: those of `diagnosis_figures.drawings`.
    """
    findings = [_finding(found, entry, k) for k, entry in enumerate(statements.findings_of(document))]
    return _template().render(
        source=source,
        against=_against(document),
        verdict=statements.verdict_statement(document),
        cautions=statements.cautions(document),
        verdict_word=document["verdict"],
        setting=_setting(document),
        errors=_errors(document),
        held=f"{document['heldout_rows']} rows, each predicted without the contiguous block that it belongs to: "
        "screening, search and fit did not use this block.",
        noise=noise_statement(document),
        figures={name: _picture(figures[name], caption) for name, caption in _CAPTIONS.items()},
        faults=[_fault(entry) for entry in document["data_faults"]],
        notes=statements.assumptions(document),
        findings=findings,
        overview=len(findings) > _FEW,
        checked=[_fault(entry) for entry in document["ruled_out"]],
        untested=[_untested(group) for group in statements.untested(document)],
        to_record=statements.what_to_record(document),
        separating=[_poses(item) for item in document["separating_poses"]],
        not_checked=statements.NOT_CHECKED,
    )


def _picture(figure: Figure, caption: str) -> Picture:
    return Picture(_embedded(figure), caption, sum(panel.get_visible() for panel in figure.axes) == 1)


@cache
def _template() -> jinja2.Template:
    loader = jinja2.PackageLoader("lite6jax.report")
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("diagnosis.html")


def _embedded(figure: Figure) -> str:
    with BytesIO() as held:
        with rc_context(STYLE):
            figure.savefig(held, format="png", dpi=_DPI, metadata={"Software": None})
        return "data:image/png;base64," + base64.b64encode(held.getvalue()).decode()


def _setting(document: Document) -> str:
    model, numbers = document["model"], document["nuisance"]["numbers"]
    measured = "positions and orientations" if model["orientation"] else "positions"
    fitted = f"{numbers} numbers of frames and geometry are fitted" if numbers else "the geometry is taken as given"
    return f"{model['arm']}, {document['samples']} samples ({model['motion']}) of {measured}; {fitted}."


def _errors(document: Document) -> list[dict[str, Any]]:
    rows = [
        {"name": name, "numbers": [number(1e3 * document[name][key]) for key in ERRORS]} for name in ("before", "after")
    ]
    if document["findings"]:
        pairs = [(document["after"][key], document["before"][key]) for key in ERRORS]
        ratios = [f"{100 * after / before:.0f} %" if before else "–" for after, before in pairs]
        rows.append({"name": "after / before", "numbers": ratios})
    return rows


def _fault(entry: Mapping[str, Any]) -> dict[str, str]:
    return {"name": fault_name(entry["fault"]), "statement": entry["statement"], "rows": listed(entry["rows"])}


def _finding(found: Diagnosis, entry: Mapping[str, Any], k: int) -> dict[str, Any]:
    numbers = entry.get("peak_to_peak", entry["parameters"])
    quantities = [quantity(name, estimate) for name, estimate in numbers.items()]
    gain = entry["log_likelihood_gain"]
    over = "" if entry["driver"] == "none" else f" over the {entry['driver']}"
    name = {"unnamed": "curve"}.get(entry["effect"], entry["effect"].replace("_", " "))
    caption = (
        f"The fitted {name} at {entry['site']}{over} with two standard deviations, beside "
        "the partial residuals: those of the whole model without it."
    )
    return {
        "title": entry["title"],
        "statement": entry["statement"],
        "parameters": quantities,
        "sizes": [each for each in quantities if each.std],
        "gain": f"{gain:+.0f}",
        "significance": f"{statements.p_value_statement(entry)} It increases the log-likelihood by {gain:.1f}.",
        "rivals": statements.undistinguished(entry),
        "rejected": ", ".join(statements.rejected(entry)),
        "figure": _picture(finding_figure(found, "", [k]), caption),
    }


def _untested(group: statements.Untested) -> dict[str, str]:
    effects = "; ".join(f"{name} at {sites}" for name, sites in statements.by_site(group.entries))
    return {"reason": group.reason, "effects": effects}


def _poses(item: Mapping[str, Any]) -> dict[str, Any]:
    angles = np.rad2deg(item["joint_position_rad"])
    return {
        "title": statements.separating_title(item),
        "joints": [f"joint {joint + 1}" for joint in range(angles.shape[1])],
        "rows": [[fixed(float(angle), 1) for angle in row] for row in angles],
    }


def _against(document: Document) -> dict[str, Any] | None:
    if "against" not in document:
        return None
    comparison = document["against"]
    return {
        "headline": reference.headline(comparison),
        "differences": [entry["statement"] for entry in comparison["differences"]],
        "notes": [entry["statement"] for entry in comparison["notes"]],
        "statement": comparison["statement"],
    }
