"""A diagnosis as one HTML page that needs no other file: verdict, numbers, rivals, faults, the figures inside."""

import base64
from collections.abc import Mapping
from functools import cache
from io import BytesIO
from typing import Any, NamedTuple

import jinja2
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.diagnosis.discrimination import Separation
from lite6jax.domains.pose.problem import Case
from lite6jax.domains.pose.reference import ReferenceComparison
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.report import diagnosis_words as words
from lite6jax.report import reference
from lite6jax.report.canvas import STYLE
from lite6jax.report.cells import fixed, number
from lite6jax.report.finding_figures import finding_curves
from lite6jax.search.backward import Step

Array = NDArray[np.floating]

_DPI = 120
_FEW = 3
"""Findings that are read one by one; more have an overview."""
_UNITS = (
    ("_rad_per_Nm", 1e6, "µrad/Nm"),
    ("_m_per_s", 1e6, "µm/s"),
    ("_per_K", 1e6, "ppm/K"),
    ("phase_rad", 180 / np.pi, "deg"),
    ("_rad", 1e3, "mrad"),
    ("_m", 1e3, "mm"),
    ("_s", 1e3, "ms"),
    ("_kg", 1.0, "kg"),
)
"""How the ends of parameters' names read on a page; the first that fits."""
_RATIOS = {"scale": (1e6, "ppm"), "coupling": (1e6, "ppm")}

_CAPTIONS = {
    "error_by_joint": "Held-out position error against each joint: dots are samples, lines are medians.",
    "where": "Share of the residual's variance that a free curve of each driver explains at each site, less what as "
    "many numbers explain of noise; a dash where that is not known, not varied or not seen.",
    "orders": "Share of the residual's variance that a harmonic of each order explains at each joint, before and "
    "after of the residual there is then; the dotted line is what white noise reaches.",
    "remaining": "Left, the residuals in units of the sensor's noise against noise alone; right, how alike those of "
    "neighbouring rows are.",
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


def diagnosis_page(
    found: Diagnosis, source: str, figures: Mapping[str, Figure], against: ReferenceComparison | None = None
) -> str:
    """The page, HTML; the same diagnosis gives the same bytes.

    Args:
        found: the diagnosis.
        source: the recording's name, of any characters.
        figures: those of `diagnosis_figures.drawings`.
        against: the other side, where there is one.
    """
    report = found.to_dict()
    findings = _findings(found, report)
    return _template().render(
        source=source,
        against=_against(against),
        verdict=words.verdict_of(found, against),
        verdict_word=found.verdict,
        setting=_setting(found),
        errors=_errors(report),
        held=f"{report['heldout_rows']} rows, in contiguous blocks that the fit and the search did not see.",
        noise=_noise(found),
        figures={name: _picture(figures[name], caption) for name, caption in _CAPTIONS.items()},
        faults=words.faults_of(found),
        notes=found.case.notes,
        findings=findings,
        overview=len(findings) > _FEW,
        checked=words.ruled_out(found),
        untested=_untested(found),
        to_record=words.to_record(found),
        separating=[_poses(item) for item in found.separating],
        not_checked=words.NOT_CHECKED,
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


def _setting(found: Diagnosis) -> str:
    case = found.case
    measured = "positions" if case.rows == 3 else "positions and orientations"
    known = f"{len(case.unknown)} numbers of frames and geometry fitted" if case.unknown else "geometry taken as given"
    return f"{case.arm.name}, {case.samples} samples ({case.recording.motion}) of {measured}; {known}."


def _errors(report: dict[str, Any]) -> list[dict[str, Any]]:
    keys = ("heldout_position_rms_m", "heldout_position_p95_m", "heldout_position_max_m")
    rows = [
        {"name": name, "numbers": [number(1e3 * report[name][key]) for key in keys]} for name in ("before", "after")
    ]
    if report["findings"]:
        ratios = [report["after"][key] / report["before"][key] if report["before"][key] else 1.0 for key in keys]
        rows.append({"name": "after / before", "numbers": [f"{100 * ratio:.0f} %" for ratio in ratios]})
    return rows


def _noise(found: Diagnosis) -> str:
    case = found.case
    seen = f"Noise per axis of position: {number(1e3 * found.estimated_noise)} mm, estimated from what is left"
    return seen + (f"; declared {number(1e3 * case.noise[0])} mm." if case.declared else "; none is declared.")


def _findings(found: Diagnosis, report: dict[str, Any]) -> list[dict[str, Any]]:
    fitted, told = found.selection.fitted, []
    for k, (step, entry) in enumerate(zip(found.selection.steps, report["findings"], strict=True)):
        part = fitted.physics.slices[k]
        figure = _picture(finding_curves(found, "", [k]), _caption(entry))
        told.append(
            _finding(found.selection.case, step, entry, fitted.values[part], fitted.covariance[part, part], figure)
        )
    return told


def _finding(
    case: Case, step: Step, entry: dict[str, Any], values: Array, covariance: Array, figure: Picture
) -> dict[str, Any]:
    numbers = entry["parameters"]
    driver = "" if entry["driver"] == "none" else f", by {entry['driver']}"
    statement = f"Acts at {entry['site']}{driver}."
    if isinstance(step.effect, Unnamed):
        swing, std = words.peak_to_peak(case, step.effect, values, covariance)
        numbers = {f"peak_to_peak_{step.effect.coordinates[0].unit}": {"value": swing, "std": std}}
        statement = entry["statement"]
    parameters = [_parameter(name, estimate) for name, estimate in numbers.items()]
    return {
        "title": words.capital(words.named(step.effect)),
        "statement": statement,
        "parameters": parameters,
        "sizes": [row for row in parameters if row["std"] != "–"],
        "gain": f"{step.score.gain:+.0f}",
        "chance": f"Chance alone explains as much with {words.chance(step.p)}, over everything that was searched; "
        f"log-likelihood {step.score.gain:+.1f}.",
        "rivals": words.near(step),
        "rejected": ", ".join(words.rejected(step)),
        "figure": figure,
    }


def _caption(entry: dict[str, Any]) -> str:
    driver = "" if entry["driver"] == "none" else f" over {entry['driver']}"
    return (
        f"The fitted {_worded(entry['effect']).lower()} at {entry['site']}{driver}, with two standard deviations, over "
        "what the data show there beside all else that was found."
    )


def _parameter(name: str, estimate: dict[str, float]) -> dict[str, str]:
    value, std, unit = estimate["value"], estimate["std"], ""
    scale, unit = _RATIOS.get(name) or next(((s, u) for end, s, u in _UNITS if name.endswith(end)), (1.0, ""))
    said = name
    for end, _, _ in _UNITS:
        said = said.removesuffix(end if end != "phase_rad" else "_rad")
    value, std = scale * value, scale * std
    if not std:
        return {"name": said.replace("_", " "), "value": f"{value:.6g}", "std": "–", "unit": unit}
    shown = words.rounded(value, std)
    return {"name": said.replace("_", " "), "value": shown[0], "std": shown[1], "unit": unit}


def _untested(found: Diagnosis) -> list[dict[str, str]]:
    return [
        {
            "reason": group.reason,
            "effects": "; ".join(
                f"{name.replace('_', ' ')} at {sites}" for name, sites in words.by_site(group.effects)
            ),
        }
        for group in words.untested(found)
    ]


def _poses(item: Separation) -> dict[str, Any]:
    return {
        "title": words.separation_title(item),
        "joints": [f"joint {joint + 1}" for joint in range(item.joint_position.shape[1])],
        "rows": [[fixed(float(angle), 1) for angle in row] for row in np.rad2deg(item.joint_position)],
    }


def _against(comparison: ReferenceComparison | None) -> dict[str, Any] | None:
    if comparison is None:
        return None
    codes = comparison.to_dict()
    return {
        "headline": reference.headline(codes),
        "differences": reference.difference_sentences(codes),
        "notes": reference.note_sentences(codes),
        "statement": reference.model_statement(comparison.file, comparison.rigid),
    }


def _worded(name: str) -> str:
    return {"unnamed": "Unnamed physics"}.get(name, name.replace("_", " ").capitalize())
