"""Figures of a diagnosis: errors before and after, explained shares, spectra of orders, remaining residuals."""

import re
from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from lite6jax.diagnosis import evidence_map
from lite6jax.diagnosis.evidence_map import JointSpectra
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.report.canvas import AFTER, BEFORE, FRAMED, STYLE, blank, label_joint
from lite6jax.report.cells import joint_units
from lite6jax.report.finding_figures import finding_figure
from lite6jax.report.panels import GREY, dots, label_first_column, legend_below, medians, panels_in_rows

Array = NDArray[np.floating]

NAMES = ("error_by_joint", "where", "orders", "findings", "remaining")
"""The figures that `drawings` may give."""

_STAGES = (("before", BEFORE), ("after", AFTER))
_DRIVERS = {
    "direction of motion": "direction\nof motion",
    "other positions": "other\npositions",
    "measured position": "measured\nposition",
    "two drivers": "two\ndrivers",
}
_THIN = 0.2
"""Of the samples that an even distribution would have, below which a bin's median is left out."""
_LEAST_SCALE = 2.0
"""Percent of the variance at which the colours of a map of noise end."""


def drawings(found: Diagnosis, title: str, order: Sequence[int] | None = None) -> Iterator[tuple[str, Figure]]:
    """The figures by name, of `NAMES`; there is no figure of findings where there are none.

    Args:
        found: the diagnosis.
        title: of each figure.
        order: places of the findings, from 0, in which they are numbered; theirs where not given.
    """
    yield "error_by_joint", error_by_joint(found, title)
    yield "where", explained_map(found, title)
    yield "orders", order_spectrum(found, title)
    if found.findings:
        yield "findings", finding_figure(found, title, order=order)
    yield "remaining", remaining(found, title)


def error_by_joint(found: Diagnosis, title: str) -> Figure:
    """Held-out position error against each joint, before and after; lines are medians, where samples are enough."""
    kept = ~found.outliers & np.isfinite(found.before) & np.isfinite(found.after)
    scales, units = joint_units(found.problem.arm.sliding, found.problem.motion.dof)
    q = scales[:, None] * np.asarray(found.problem.motion.joint_position)[:, kept]
    errors = [1e3 * found.before[kept], 1e3 * found.after[kept]]
    with rc_context(STYLE):
        figure, panels = panels_in_rows(len(q), shared=True)
        line = False
        for joint, panel in enumerate(panels):
            for (_, colour), error in zip(_STAGES, errors, strict=True):
                dots(panel, q[joint], error, colour, 3)
                at, middle, _ = medians(q[joint], error, share=_THIN)
                panel.plot(at, middle, color=colour, linewidth=2.5, zorder=5)
                line |= bool(np.isfinite(middle).any())
            label_joint(panel, joint, units[joint])
            label_first_column(panel, "position error (mm)")
        top = max((float(np.percentile(error, 99.5)) for error in errors if len(error)), default=1.0)
        panels[0].set_ylim(0, 1.1 * top or 1.0)
        for (name, colour), error in zip(_STAGES, errors, strict=True):
            rms = float(np.sqrt(np.mean(error**2))) if len(error) else 0.0
            label, style = f"{name}: {rms:.3g} mm RMS, held out", "-o" if line else "o"
            panels[0].plot([], [], style, color=colour, linewidth=2.5, label=label)
        legend_below(figure, panels[0], 2)
        figure.suptitle(f"{title}: held-out position error before and after", fontsize=15)
    return figure


def explained_map(found: Diagnosis, title: str) -> Figure:
    """The share of the variance left by the nuisance that functions of each driver explain at each site.

    Colours end at the largest share: on an arm whose error has many causes, no curve alone explains much of it.
    """
    table = evidence_map.explained_shares(found)
    rows, columns = len(table.sites), len(table.drivers)
    known = table.shares[np.isfinite(table.shares)]
    most = max(100 * float(known.max(initial=0.0)), _LEAST_SCALE)
    with rc_context(FRAMED):
        figure = blank(3.5 + 1.35 * columns, 2.2 + 0.45 * rows)
        panel = figure.subplots()
        percent = np.ma.masked_invalid(100 * table.shares)
        colours = panel.imshow(percent, cmap="cividis", vmin=0, vmax=most, aspect="auto", interpolation="nearest")
        panel.set_facecolor("#eeeeee")
        for (i, j), share in np.ndenumerate(table.shares):
            text, colour = "–", GREY
            if np.isfinite(share):
                text, colour = _percent(100 * float(share)), "black" if 100 * share > 0.55 * most else "white"
            panel.text(j, i, text, ha="center", va="center", color=colour, fontsize=14)
        panel.set_xticks(range(columns), [_DRIVERS.get(name, name) for name in table.drivers])
        panel.set_yticks(range(rows), [re.sub(r"(\D)(\d)", r"\1 \2", name) for name in table.sites])
        panel.set(xlabel="driver of the function", ylabel="site")
        panel.tick_params(length=0)
        figure.colorbar(colours, label=f"explained variance (%), scaled to {_percent(most)} %")
        figure.suptitle(f"{title}: explained variance by site and driver", fontsize=15)
    return figure


def _percent(share: float) -> str:
    """Whole percents; a decimal below ten of what is not zero."""
    return f"{share:.1f}" if 0.05 <= share < 9.95 else f"{share:.0f}"


def order_spectrum(found: Diagnosis, title: str) -> Figure:
    """What a harmonic of each order of each joint explains, before and after."""
    spectra = evidence_map.joint_spectra(found)
    with rc_context(STYLE):
        figure, panels = panels_in_rows(max(len(spectra), 1), shared=True)
        for panel, joint in zip(panels, spectra, strict=False):
            _draw_spectrum(panel, joint)
        if not spectra:
            panels[0].text(0.5, 0.5, "no joint turns", ha="center", color=GREY)
            return figure
        panels[0].set_ylim(max(3.0 * max(joint.noise.max() for joint in spectra), 1e-3), 150)
        panels[0].yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        for name, colour in _STAGES[: 2 if found.findings else 1]:
            panels[0].plot([], [], color=colour, linewidth=2.5, label=name)
        level = f"exceeded by noise in one of {1 / found.options.engine.level:.0f} recordings"
        panels[0].plot([], [], ":", color="black", linewidth=1.8, label=level)
        if any(joint.harmonics for joint in spectra):
            panels[0].plot([], [], "--", color="black", linewidth=1.8, label="order found")
        if any(joint.curve for joint in spectra):
            panels[0].plot([], [], "v", color="black", markersize=6, label="orders of an unnamed curve")
        legend_below(figure, panels[0], 4)
        figure.suptitle(f"{title}: orders of the joints' positions", fontsize=15)
    return figure


def _draw_spectrum(panel: Axes, joint: JointSpectra) -> None:
    panel.set_ylim(1e-3, 150)  # of all panels together below; a spectrum of zeros has no limits of its own
    for (_, colour), spectrum in zip(_STAGES, (joint.before, joint.after), strict=True):
        if spectrum is not None:
            many = len(spectrum.orders) > 3000
            panel.plot(spectrum.orders, 100 * spectrum.shares, color=colour, linewidth=1.4, zorder=3, rasterized=many)
    at = (joint.after or joint.before).orders
    panel.plot(at, 100 * joint.noise, color="black", linestyle=":", linewidth=1.8, zorder=4)
    if not joint.observed:
        panel.text(0.5, 0.75, "not observed by the sensor", ha="center", color=GREY, transform=panel.transAxes)
    for order in joint.harmonics:
        panel.axvline(order, color="black", linestyle="--", linewidth=1.8, zorder=2)
        panel.text(
            order, 0.97, f" {order:.4g} ", fontsize=13, fontweight="bold", va="top",
            transform=panel.get_xaxis_transform(), ha="left" if order < 60 else "right",
        )  # fmt: skip
    panel.plot(
        joint.curve, np.full(len(joint.curve), 0.97), "v", color="black", markersize=6,
        transform=panel.get_xaxis_transform(), zorder=5,
    )  # fmt: skip
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_xlabel(f"order per turn of {joint.site.replace('joint', 'joint ')}")
    panel.xaxis.set_major_locator(FixedLocator([1, 2, 5, 10, 20, 50, 100, 400]))
    panel.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    panel.xaxis.set_minor_formatter(NullFormatter())
    panel.set_xlim(1, np.ceil(at[-1]))
    label_first_column(panel, "explained variance (%)")


def remaining(found: Diagnosis, title: str) -> Figure:
    """The residuals against the sensor's noise: their size, and the correlation of neighbouring rows."""
    residuals = evidence_map.remaining_residuals(found)
    unit = "declared" if found.problem.declared else "estimated"
    with rc_context(STYLE):
        figure = blank(12.0, 5.0)
        left, right = figure.subplots(1, 2)
        for (name, colour), part in zip(_STAGES, residuals, strict=False):
            left.stairs(part.density, part.edges, color=colour, linewidth=2, label=f"{name}: {part.rms:.3g} RMS")
            lags = np.arange(1, len(part.correlation) + 1)
            right.plot(lags, part.correlation, "-o", color=colour, markersize=5, linewidth=1.5)
        edges, bound = residuals[-1].edges, residuals[-1].bound
        at = np.linspace(edges[0], edges[-1], 201)
        left.plot(at, np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi), "--", color="black", linewidth=2, label="normal noise")
        left.set(xlabel=f"residual over the {unit} noise", ylabel="density", xlim=(edges[0], edges[-1]))
        left.set_ylim(0, 1.5 * left.get_ylim()[1])
        left.legend(frameon=False, loc="upper right")
        right.axhspan(-bound, bound, color="black", alpha=0.15, linewidth=0)
        right.axhline(0, color="black", linewidth=1)
        right.plot([], [], color="black", alpha=0.15, linewidth=9, label="white noise, 95 %")
        right.set(xlabel="lag (rows)", ylabel="autocorrelation of the residuals")
        low, high = right.get_ylim()
        right.set_ylim(min(low, -0.3), min(max(high, 0.3) + 0.1, 1.1))
        right.legend(frameon=False, loc="upper right")
        figure.suptitle(f"{title}: remaining residuals", fontsize=15)
    return figure
