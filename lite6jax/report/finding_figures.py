"""Figures of findings: each fitted curve with its uncertainty over the partial residuals at its site."""

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from lite6jax.diagnosis import partial_residuals
from lite6jax.diagnosis.partial_residuals import FindingCurve
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.effects.dynamic.unnamed import UnnamedTorque
from lite6jax.report.canvas import AFTER, STYLE, degree_ticks
from lite6jax.report.panels import BINS, GREY, dots, legend_below, medians, panels_in_rows
from lite6jax.report.remedies import effect_name

_SAMPLES_PER_BIN = 12
_BINS_PER_WAVE = 4
_DRIVERS = {
    "rad": (180 / np.pi, "deg"),
    "rad/s": (180 / np.pi, "deg/s"),
    "1": (1.0, ""),
    "m": (1e3, "mm"),
    "m/s": (1e3, "mm/s"),
}
"""Factor and unit in which drivers are read."""
_DEFLECTIONS = {
    "m": (1e3, "mm"),
    "rad": (1e3, "mrad"),
    "1": (1e6, "ppm"),
    "Nm": (1.0, "Nm"),
    "N": (1.0, "N"),
    "sigma": (1.0, "std. deviations"),
}
_EXERTED = {"Nm": "torque", "N": "force"}
"""What a motor exerts, by its unit."""
_MOVEMENTS = {"joint": "joint deflection", "stretch": "growth of the links", "scale": "growth of the readings"}


def finding_figure(
    found: Diagnosis, title: str, chosen: Sequence[int] | None = None, order: Sequence[int] | None = None
) -> Figure:
    """Each finding's curve with two standard deviations, over its partial residuals.

    Args:
        found: with findings.
        title: of the figure.
        chosen: places of findings, from 0; all, in their order, where not given.
        order: places of all findings in the order in which they are numbered; theirs where not given.
    """
    order = range(len(found.findings)) if order is None else order
    places = order if chosen is None else chosen
    return _curves_figure(
        [curve for k in places for curve in partial_residuals.finding_curves(found, k)], found, title, order
    )


def torque_finding_figure(
    found: TorqueDiagnosis, title: str, chosen: Sequence[int] | None = None, order: Sequence[int] | None = None
) -> Figure:
    """As `finding_figure`, of a diagnosis of torques."""
    order = range(len(found.findings)) if order is None else order
    places = order if chosen is None else chosen
    return _curves_figure(
        [curve for k in places for curve in partial_residuals.finding_curves(found, k)], found, title, order
    )


def _curves_figure(
    curves: Sequence[FindingCurve], found: Diagnosis | TorqueDiagnosis, title: str, order: Sequence[int]
) -> Figure:
    """Curves of findings, a panel each."""
    with rc_context(STYLE):
        figure, panels = panels_in_rows(len(curves), wide=True)
        binned = False
        for panel, curve in zip(panels, curves, strict=True):
            binned |= _draw(panel, curve)
            effect = found.findings[curve.finding].effect
            if isinstance(effect, UnnamedTorque) and effect.signed and not curve.hysteresis:
                panel.set_ylabel(f"{_EXERTED[curve.unit]} × direction of motion ({curve.unit})")
            number = order.index(curve.finding) + 1
            panel.set_title(f"{number}. {effect_name(effect.name)}, {effect.site}", fontsize=13)
        panels[0].plot([], [], color=AFTER, linewidth=2.5, label="fitted")
        if not all(curve.hysteresis for curve in curves):
            panels[0].fill_between([], [], [], color=AFTER, alpha=0.3, linewidth=0, label="± 2 std. deviations")
        if binned:
            label = "partial residuals: medians ± std. error"
            panels[0].errorbar([], [], [], fmt="o", color="black", capsize=3, label=label)
        else:
            panels[0].plot([], [], ".", color=GREY, markersize=8, label="partial residuals")
        legend_below(figure, panels[0], 3)
        figure.suptitle(title, fontsize=15)
    return figure


def _draw(panel: Axes, curve: FindingCurve) -> bool:
    """Draws a curve into a panel, and says whether there are medians of the partial residuals beside it."""
    x_scale, across, angle = _across(curve)
    y_scale, up = _up(curve)
    x, seen, at, fitted, std = (
        x_scale * curve.driver, y_scale * curve.partial, x_scale * curve.at, y_scale * curve.curve, y_scale * curve.std
    )  # fmt: skip
    dots(panel, x, seen, GREY)
    panel.set(xlabel=across, ylabel=up)
    if curve.hysteresis:
        panel.plot(at, fitted, ".", color=AFTER, markersize=5, zorder=4)
        return False
    panel.fill_between(at, fitted - 2 * std, fitted + 2 * std, color=AFTER, alpha=0.3, linewidth=0, zorder=3)
    discrete = curve.quantity is not None and curve.quantity.discrete
    bins = int(np.clip(_BINS_PER_WAVE * curve.periods, BINS, max(len(x) // _SAMPLES_PER_BIN, BINS)))
    many = bins > BINS
    panel.plot(at, fitted, color=AFTER, linewidth=1.5 if many else 2.5, zorder=4)
    centre, middle, error = medians(x, seen, 3 if discrete else bins)
    centre = np.linspace(x.min(), x.max(), 3) if discrete and len(x) else centre
    panel.errorbar(
        centre, middle, error, fmt="o", color="black", markersize=3 if many else 5, capsize=0 if many else 3, zorder=5
    )
    inner = np.percentile(seen, (1, 99)) if len(seen) else np.zeros(2)
    low, high = min(inner[0], fitted.min(), 0.0), max(inner[1], fitted.max(), 0.0)
    margin = 0.1 * (high - low or 1.0)
    panel.set_ylim(low - margin, high + margin)
    if discrete:
        panel.set_xticks((-1, 0, 1))
    elif angle:
        panel.xaxis.set_major_locator(degree_ticks(panel))
    else:
        panel.xaxis.set_major_locator(MaxNLocator(4))
    return bool(np.isfinite(middle).any())


def _across(curve: FindingCurve) -> tuple[float, str, bool]:
    """Factor and label of the horizontal axis, and whether it is an angle."""
    if curve.over == "row":
        return 1.0, "row of the recording", False
    if curve.over == "displacement":
        scale, unit = _DEFLECTIONS[curve.unit]
        moved = "displacement of the measured pose" if curve.site is None else _exerted(curve)
        return scale, f"fitted {moved} ({unit})", False
    assert curve.quantity is not None
    if curve.over == "phase":
        return 180 / np.pi, f"phase of the harmonic, {curve.quantity.phrase} (deg)", True
    scale, unit = _DRIVERS.get(curve.quantity.unit, (1.0, curve.quantity.unit))
    return scale, f"{curve.quantity.phrase} ({unit})" if unit else curve.quantity.phrase, unit == "deg"


def _exerted(curve: FindingCurve) -> str:
    assert curve.site is not None
    return f"{_EXERTED[curve.unit]} at joint {curve.site[1] + 1}"


def _up(curve: FindingCurve) -> tuple[float, str]:
    """Factor and label of the vertical axis."""
    scale, unit = _DEFLECTIONS[curve.unit]
    if curve.site is None:
        return scale, f"displacement along it ({unit})"
    field, _, component = curve.site
    if curve.unit in _EXERTED:
        return scale, f"{_exerted(curve)} ({unit})"
    movement = f"{'translation along' if component < 3 else 'rotation about'} {'xyz'[component % 3]}"
    return scale, f"{_MOVEMENTS.get(field, movement)} ({unit})"
