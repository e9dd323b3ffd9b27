"""A diagnosis as one HTML page that needs no other file: verdict, numbers, rivals, faults, the figures inside."""

import base64
import re
from collections.abc import Iterable, Mapping
from functools import cache
from io import BytesIO
from typing import Any, NamedTuple

import jax.numpy as jnp
import jinja2
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lite6jax.diagnosis.case import Case
from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.diagnosis.selection import Step
from lite6jax.physics.catalogue import Untestable
from lite6jax.physics.effect import Effect
from lite6jax.physics.unnamed import Unnamed
from lite6jax.report import diagnosis_figures
from lite6jax.report.canvas import STYLE
from lite6jax.report.cells import number, plus_minus
from lite6jax.report.diagnosis_tables import NAMED as NEAR
from lite6jax.report.diagnosis_tables import VERDICTS, chance

Array = NDArray[np.floating]

_MOST_ROWS = 40
_DPI = 120
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
    "orders": "Share of the residual's variance that a harmonic of each order explains at each joint; the dotted line "
    "is what white noise reaches.",
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


def diagnosis_page(found: Diagnosis, source: str, figures: Mapping[str, Figure]) -> str:
    """The page, HTML; the same diagnosis gives the same bytes.

    Args:
        found: the diagnosis.
        source: the recording's name, of any characters.
        figures: those of `diagnosis_figures.drawings`.
    """

    def picture(figure: Figure, caption: str) -> Picture:
        return Picture(_embedded(figure), caption, sum(panel.get_visible() for panel in figure.axes) == 1)

    report = found.to_dict()
    pictures = {name: picture(figures[name], caption) for name, caption in _CAPTIONS.items()}
    findings = []
    fitted = found.selection.fitted
    for k, (step, entry) in enumerate(zip(found.selection.steps, report["findings"], strict=True)):
        part = fitted.physics.slices[k]
        figure = diagnosis_figures.finding_curves(found, "", [k])
        seen = picture(figure, _caption(entry))
        findings.append(
            _finding(found.selection.case, step, entry, fitted.values[part], fitted.covariance[part, part], seen)
        )
    return _template().render(
        source=source,
        verdict=VERDICTS[found.verdict],
        verdict_word=found.verdict,
        setting=_setting(found),
        errors=_errors(report),
        held=f"{report['heldout_rows']} rows, in contiguous blocks that the fit and the search did not see.",
        noise=_noise(found),
        figures=pictures,
        findings=findings,
        faults=[{"statement": f["statement"], "rows": _listed(f["rows"])} for f in report["data_faults"]],
        notes=found.case.notes,
        untested=_untested(found),
    )


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


def _finding(
    case: Case, step: Step, entry: dict[str, Any], values: Array, covariance: Array, figure: Picture
) -> dict[str, Any]:
    unnamed = isinstance(step.effect, Unnamed)
    numbers = _swing(case, step.effect, values, covariance) if isinstance(step.effect, Unnamed) else entry["parameters"]
    rivals = sorted(step.rivals, key=lambda rival: rival.gap)
    near, far = ([r for r in rivals if (r.gap < NEAR) is close] for close in (True, False))
    driver = "" if entry["driver"] == "none" else f", by {entry['driver']}"
    statement = f"Acts at {entry['site']}{driver}."
    return {
        "title": f"{_worded(entry['effect'])} at {entry['site']}",
        "statement": entry["statement"] if unnamed else statement,
        "parameters": [_parameter(name, e) for name, e in numbers.items()],
        "chance": f"Chance alone explains as much with {chance(step.p)}, over everything that was searched; "
        f"log-likelihood {step.score.gain:+.1f}.",
        "rivals": [f"{_named(r.effect)} ({r.gap:+.1f})" for r in near],
        "rejected": ", ".join(f"{_named(r.effect)} ({r.gap:+.1f})" for r in far),
        "figure": figure,
    }


def _swing(case: Case, effect: Unnamed, values: Array, covariance: Array) -> dict[str, dict[str, float]]:
    """How far a curve goes from its lowest to its highest where data determine it, in place of its coefficients."""
    driver = np.asarray(effect.drivers[0].values(case.motion, case.loads))
    low, high = np.percentile(driver, (2, 98))
    at = jnp.linspace(float(low), float(high), 400)
    basis = np.asarray(effect.basis(at))
    curve = values @ basis
    apart = basis[:, np.argmax(curve)] - basis[:, np.argmin(curve)]
    std = np.sqrt(max(float(apart @ covariance @ apart), 0.0))
    return {f"peak_to_peak_{effect.coordinates[0].unit}": {"value": float(apart @ values), "std": float(std)}}


def _caption(entry: dict[str, Any]) -> str:
    driver = "" if entry["driver"] == "none" else f" over {entry['driver']}"
    return (
        f"The fitted {_worded(entry['effect']).lower()} at {entry['site']}{driver}, with two standard deviations, over "
        "what the data without it show there."
    )


def _parameter(name: str, estimate: dict[str, float]) -> dict[str, str]:
    value, std, unit = estimate["value"], estimate["std"], ""
    scale, unit = _RATIOS.get(name) or next(((s, u) for end, s, u in _UNITS if name.endswith(end)), (1.0, ""))
    words = name
    for end, _, _ in _UNITS:
        words = words.removesuffix(end if end != "phase_rad" else "_rad")
    value, std = scale * value, scale * std
    if not std:
        return {"name": words.replace("_", " "), "value": f"{value:.6g}", "std": "–", "unit": unit}
    if not np.isfinite(std) or std < 1e-4:
        return {"name": words.replace("_", " "), "value": f"{value:.6g}", "std": f"{std:.1e}", "unit": unit}
    decimals = max(0, 1 - int(np.floor(np.log10(std))))
    return {"name": words.replace("_", " "), "value": f"{value:.{decimals}f}", "std": plus_minus(std), "unit": unit}


def _untested(found: Diagnosis) -> list[dict[str, str]]:
    groups: dict[str, list[Untestable]] = {}
    for item in found.untestable:
        groups.setdefault(re.sub(r"\d+", "", item.reason), []).append(item)
    told = []
    for items in groups.values():
        reason = items[0].reason
        if any(item.reason != reason for item in items):  # alike but for the number of the joint
            reason = re.sub(r"of (joint|link) \d+", r"of its \1", reason)
        effects = ", ".join(dict.fromkeys(_named(item.effect) for item in items))
        told.append({"reason": reason[:1].upper() + reason[1:], "effects": effects})
    hidden = [_named(effect) for effect in found.selection.hidden]
    if hidden:
        reason = "The frames and geometry that are fitted can do the same, or the sensor does not see it"
        told.append({"reason": reason, "effects": ", ".join(dict.fromkeys(hidden))})
    return told


def _named(effect: Effect) -> str:
    return f"{effect.name.replace('_', ' ')} at {effect.site}"


def _worded(name: str) -> str:
    return {"unnamed": "Unnamed physics"}.get(name, name.replace("_", " ").capitalize())


def _listed(rows: Iterable[int]) -> str:
    rows = list(rows)
    return ", ".join(map(str, rows[:_MOST_ROWS])) + (
        f" and {len(rows) - _MOST_ROWS} more" if len(rows) > _MOST_ROWS else ""
    )
