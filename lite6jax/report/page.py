"""A diagnosis as one self-contained HTML page: cause, ranking, errors, findings with figures, remedies, next steps."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lite6jax.diagnosis.result import Diagnosis
from lite6jax.report import reference, statements, worth
from lite6jax.report.cells import fixed, joint_units, number
from lite6jax.report.diagnosis_tables import ERRORS, noise_statement
from lite6jax.report.finding_figures import finding_figure
from lite6jax.report.next_steps import Files
from lite6jax.report.quantities import quantity
from lite6jax.report.rendering import finding_row, picture, shared_values, whole_page

Document = Mapping[str, Any]

_CAPTIONS = {
    "error_by_joint": "Held-out position error against each joint: dots are samples, lines are medians.",
    "where": "Share of the residual's variance that functions of each driver explain at each site, less what as many "
    "numbers explain of noise: of several functions the largest share. Each contains a constant, which is shown alone "
    "in the first column. A dash where no such function is tried, the driver is not recorded or does not vary, or the "
    "function is confounded with the nuisance.",
    "orders": "Share of the residual's variance that a harmonic of each order explains at each joint, before and after "
    "(of the residual at that stage); the dotted line is the family-wise limit of white noise.",
    "remaining": "Left, the residuals in units of the sensor's noise beside normal noise; right, their autocorrelation "
    "in the order of the rows.",
}


def diagnosis_page(
    found: Diagnosis, document: Document, source: str, figures: Mapping[str, Figure], files: Files | None = None
) -> str:
    """The page, HTML; the same diagnosis gives the same bytes.

    Args:
        found: the diagnosis, of which the figures of single findings are drawn.
        document: as in its JSON file, with statements; all text is made from it.
        source: the recording's name, of any characters.
        figures: those of `diagnosis_figures.drawings`.
        files: for commands to copy; without them there are none.
    """
    return whole_page("diagnosis_content.html", page_values(found, document, source, figures, files))


def page_values(
    found: Diagnosis, document: Document, source: str, figures: Mapping[str, Figure], files: Files | None = None
) -> dict[str, Any]:
    """What the templates of the page are filled with; arguments as of `diagnosis_page`."""
    order = worth.order(document)
    findings = [_finding(found, entry, order) for entry in statements.findings_of(document)]
    return {
        **shared_values(document, statements, source, findings, figures, _CAPTIONS, files),
        "against": reference.compared(document),
        "setting": _setting(document),
        "errors": _errors(document),
        "held": statements.held_out_statement(document, f"{document['heldout_rows']} rows"),
        "noise": noise_statement(document),
        "notes": statements.assumptions(document),
        "separating": [_poses(item, document) for item in document["separating_poses"]],
        "not_checked": statements.NOT_CHECKED,
    }


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


def _finding(found: Diagnosis, entry: Mapping[str, Any], order: Sequence[int]) -> dict[str, Any]:
    numbers = entry.get("peak_to_peak", entry["parameters"])
    quantities = [quantity(name, estimate) for name, estimate in numbers.items()]
    over = "" if entry["driver"] == "none" else f" over the {entry['driver']}"
    name = {"unnamed": "curve"}.get(entry["effect"], entry["effect"].replace("_", " "))
    caption = (
        f"The fitted {name} at {entry['site']}{over} with two standard deviations, beside "
        "the partial residuals: those of the whole model without it."
    )
    shown = picture(finding_figure(found, "", [entry["place"]], order), caption)
    return finding_row(entry, quantities, statements.undistinguished(entry), statements.rejected(entry), shown)


def _poses(item: Mapping[str, Any], document: Document) -> dict[str, Any]:
    scales, units = joint_units(statements.sliding(document), len(item["joint_position_rad"][0]))
    angles = scales * np.array(item["joint_position_rad"])
    return {
        "title": statements.separating_title(item, units),
        "joints": [f"joint {joint + 1}" for joint in range(angles.shape[1])],
        "rows": [[fixed(float(angle), 1) for angle in row] for row in angles],
    }
