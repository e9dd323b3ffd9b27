"""Figures of a diagnosis: errors before and after, where and which orders, findings over the data, what is left."""

from collections.abc import Iterator, Sequence

import jax.numpy as jnp
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray
from scipy.special import chdtri

from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.domains.pose.problem import Case
from lite6jax.effects.drivers import Driver
from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.effects.nonparametric import Unnamed, spline_basis
from lite6jax.estimation.least_squares import Fitted
from lite6jax.estimation.noise import autocorrelation
from lite6jax.estimation.score_test import Evidence, Score, evidence_of
from lite6jax.report.canvas import AFTER, BEFORE, FRAMED, STYLE, blank, degree_ticks, thinned
from lite6jax.report.finding_figures import finding_curves
from lite6jax.report.panels import GREY, legend_below, medians, panels_in_rows
from lite6jax.search.forward import LEVEL
from lite6jax.search.spectrum import spectrum

Array = NDArray[np.floating]

NAMES = ("error_by_joint", "where", "orders", "findings", "remaining")
"""What `drawings` may give."""

_PIECES = 8
"""Of the free-form curves of the map."""
_EXACT_BELOW = 12.0
"""Orders under which the nuisance is projected out of the spectrum, and the effects; more where waves are found."""
_AT_ONCE = 32
_LAGS = 40

_PER_JOINT = {
    "position": "position",
    "direction of motion": "direction\nof motion",
    "velocity": "velocity",
    "gravity torque": "gravity\nload",
}
_OF_ALL = {"temperature rise": "temperature", "time": "time", "payload": "payload"}


def drawings(found: Diagnosis, title: str) -> Iterator[tuple[str, Figure]]:
    """Every figure by its name, one of `NAMES`; without findings none of these is drawn."""
    yield "error_by_joint", error_by_joint(found, title)
    yield "where", explained_map(found, title)
    yield "orders", order_spectrum(found, title)
    if found.selection.steps:
        yield "findings", finding_curves(found, title)
    yield "remaining", remaining(found, title)


def error_by_joint(found: Diagnosis, title: str) -> Figure:
    """Held-out position error against each joint, before and after; lines are medians."""
    kept = ~found.outliers & np.isfinite(found.before) & np.isfinite(found.after)
    q = np.rad2deg(np.asarray(found.case.motion.joint_position)[:, kept])
    both = [
        (name, 1e3 * e[kept], c) for name, e, c in (("before", found.before, BEFORE), ("after", found.after, AFTER))
    ]
    with rc_context(STYLE):
        figure, panels = panels_in_rows(len(q), shared=True)
        shown = thinned(q.shape[1])
        for joint, panel in enumerate(panels):
            for _, error, colour in both:
                panel.plot(
                    q[joint, shown], error[shown], ".", color=colour, markersize=5, alpha=0.35, markeredgewidth=0,
                    rasterized=True, zorder=3,
                )  # fmt: skip
                at, middle, _ = medians(q[joint], error)
                panel.plot(at, middle, color=colour, linewidth=2.5, zorder=5)
            panel.set_xlabel(f"joint {joint + 1} (deg)")
            panel.xaxis.set_major_locator(degree_ticks(panel))
            if panel.get_subplotspec().is_first_col():  # type: ignore[union-attr]
                panel.set_ylabel("position error (mm)")
        top = max((float(np.percentile(error, 99.5)) for _, error, _ in both if len(error)), default=1.0)
        panels[0].set_ylim(0, 1.1 * top or 1.0)
        for name, error, colour in both:
            rms = float(np.sqrt(np.mean(error**2))) if len(error) else 0.0
            panels[0].plot([], [], "-o", color=colour, linewidth=2.5, label=f"{name}: {rms:.3g} mm RMS, held out")
        legend_below(figure, panels[0], 2)
        figure.suptitle(f"{title}: position error before and after", fontsize=15)
    return figure


def explained_map(found: Diagnosis, title: str) -> Figure:
    """How much of what the baseline leaves a free-form curve over each driver explains at each joint and the base."""
    rows, columns, shares = explained_shares(found)
    with rc_context(FRAMED):
        figure = blank(3.5 + 1.35 * len(columns), 2.2 + 0.62 * len(rows))
        panel = figure.subplots()
        colours = panel.imshow(
            np.ma.masked_invalid(100 * shares), cmap="cividis", vmin=0, vmax=100, aspect="auto", interpolation="nearest"
        )
        panel.set_facecolor("#eeeeee")  # of what is masked
        for (i, j), share in np.ndenumerate(shares):
            text, colour = "–", GREY
            if np.isfinite(share):
                text, colour = f"{100 * share:.0f}", "black" if share > 0.55 else "white"
            panel.text(j, i, text, ha="center", va="center", color=colour, fontsize=14)
        panel.set_xticks(range(len(columns)), columns)
        panel.set_yticks(range(len(rows)), rows)
        panel.set(xlabel="driver of the curve", ylabel="site")
        panel.tick_params(length=0)
        figure.colorbar(colours, label="residual explained (%)")
        figure.suptitle(f"{title}: where the mismatch is", fontsize=15)
    return figure


def explained_shares(found: Diagnosis) -> tuple[list[str], list[str], Array]:
    """Names of sites and of drivers, and the share of the baseline residual's variance that a curve explains there.

    Returns:
        Sites, drivers, and `(site, driver)` shares from 0 to 1 less what as many numbers explain of noise; NaN where
        the driver is not known, does not vary, or where the nuisance can do the same.
    """
    case = found.selection.plain
    evidence = evidence_of(case, found.selection.baseline)
    dof = case.motion.dof
    total = _left(evidence)

    def basis(driver: Driver, pieces: int) -> Array | None:
        if (driver.loaded and case.loads is None) or not driver.known(case.motion, case.loads):
            return None
        values = driver.values(case.motion, case.loads)
        if float(jnp.ptp(values)) < 1e-6:
            return None
        return np.asarray(spline_basis(values, float(values.min()), float(values.max()), pieces))

    def share(groups: Sequence[Array]) -> float:
        score = evidence.score_columns([np.concatenate(groups)])[0] if groups else None
        return np.nan if score is None or score.hidden else _adjusted(score, total, evidence.freedom)

    def at_site(keys: Sequence[tuple[str, int, int]], driver: Driver) -> list[Array]:
        curves = basis(driver, 1 if driver.quantity == "direction of motion" else _PIECES)
        return [] if curves is None else [case.sites[key] * curves[:, None] for key in keys]

    columns = {**_PER_JOINT, **_OF_ALL}
    shares = np.full((dof + 1, len(columns)), np.nan)
    for j, quantity in enumerate(columns):
        alone = quantity in _OF_ALL
        for i in range(dof):
            shares[i, j] = share(at_site([("joint", i, 0)], Driver(quantity, 0 if alone else i + 1)))
        if alone:
            shares[dof, j] = share(at_site([("base", 0, k) for k in range(6)], Driver(quantity)))
        elif quantity == "gravity torque":
            pairs = (("x", 3), ("y", 4))
            parts = [at_site([("base", 0, k)], Driver(f"base moment {axis}")) for axis, k in pairs]
            shares[dof, j] = share([part for found_parts in parts for part in found_parts])
    known = np.any(np.isfinite(shares), axis=0, keepdims=True)[0]
    known[0] = True
    rows = [*(f"joint {i + 1}" for i in range(dof)), "base"]
    return rows, [name for name, there in zip(columns.values(), known, strict=True) if there], shares[:, known]


def order_spectrum(found: Diagnosis, title: str) -> Figure:
    """What a harmonic of each order of each joint's angle explains, of the baseline's residual and of what is left."""
    selection = found.selection
    case = selection.case
    dof = case.motion.dof
    both = [(evidence_of(seen, fitted), colour) for seen, fitted, colour in _stages(found)]
    waves = [order for step in selection.steps if isinstance(step.effect, Unnamed) for order in step.effect.orders]
    exact_below = max([_EXACT_BELOW, *waves])
    with rc_context(STYLE):
        figure, panels = panels_in_rows(dof, shared=True)
        noise = 0.0
        for joint, panel in enumerate(panels, 1):
            for evidence, colour in both:
                orders, shares = _spectrum(evidence, joint, exact_below)
                panel.plot(orders, 100 * shares, color=colour, linewidth=1.4, zorder=3, rasterized=len(orders) > 3000)
                noise = float(chdtri(2, LEVEL / (dof * len(orders) / 2))) / _left(evidence)
            panel.axhline(100 * noise, color="black", linestyle=":", linewidth=1.8, zorder=4)
            if not case.sites["joint", joint - 1, 0].any():
                panel.text(0.5, 0.5, "not seen by the sensor", ha="center", color=GREY, transform=panel.transAxes)
            for step in selection.steps:
                if isinstance(step.effect, JointHarmonic) and step.effect.joint == joint and step.effect.order:
                    panel.axvline(step.effect.order, color="black", linestyle="--", linewidth=1.8, zorder=2)
                    panel.text(
                        step.effect.order, 0.97, f" {step.effect.order:.4g}", fontsize=13, fontweight="bold", va="top",
                        transform=panel.get_xaxis_transform(), ha="left" if step.effect.order < 60 else "right",
                    )  # fmt: skip
                if isinstance(step.effect, Unnamed) and step.effect.where == f"joint{joint}" and step.effect.orders:
                    panel.plot(
                        step.effect.orders, np.full(len(step.effect.orders), 0.97), "v", color="black", markersize=6,
                        transform=panel.get_xaxis_transform(), zorder=5,
                    )  # fmt: skip
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.set_xlabel(f"order, of joint {joint}'s angle")
            panel.xaxis.set_major_locator(FixedLocator([1, 2, 5, 10, 20, 50, 100, 200]))
            panel.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            panel.xaxis.set_minor_formatter(NullFormatter())
            panel.set_xlim(1, 200)
            if panel.get_subplotspec().is_first_col():  # type: ignore[union-attr]
                panel.set_ylabel("residual explained (%)")
        panels[0].set_ylim(max(3.0 * noise, 1e-3), 150)
        panels[0].yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        for name, (_, colour) in zip(("before", "after"), both, strict=False):
            panels[0].plot([], [], color=colour, linewidth=2.5, label=name)
        panels[0].plot(
            [], [], ":", color="black", linewidth=1.8, label=f"noise reaches this once in {1 / LEVEL:.0f} recordings"
        )
        if any(isinstance(step.effect, JointHarmonic) for step in selection.steps):
            panels[0].plot([], [], "--", color="black", linewidth=1.8, label="order found")
        if waves:
            panels[0].plot([], [], "v", color="black", markersize=6, label="orders of an unnamed curve")
        legend_below(figure, panels[0], 4)
        figure.suptitle(f"{title}: orders of the joints' angles", fontsize=15)
    return figure


def remaining(found: Diagnosis, title: str) -> Figure:
    """What is left against the sensor's noise: how large it is, and whether neighbouring rows are alike."""
    case = found.selection.case
    kept = ~found.outliers
    declared = case.declared
    with rc_context(STYLE):
        figure = blank(12.0, 5.0)
        left, right = figure.subplots(1, 2)
        bins = np.linspace(-5, 5, 61)
        for (_, fitted, colour), name in zip(_stages(found), ("before", "after"), strict=False):
            rows = fitted.residual.rows[:, kept]
            unit = 1.0 if declared else found.selection.fitted.residual.scale
            heights = np.histogram(rows / unit, bins)[0] / max(rows.size, 1) / (bins[1] - bins[0])
            rms = float(np.sqrt(np.mean((rows / unit) ** 2)))
            left.stairs(heights, bins, color=colour, linewidth=2, label=f"{name}: {rms:.3g} RMS")
            alike = autocorrelation(rows, max(1, min(_LAGS, rows.shape[1] // 4)))[1:]
            lags = np.arange(1, len(alike) + 1)
            right.plot(lags, alike, "-o", color=colour, markersize=5, linewidth=1.5)
        at = np.linspace(-5, 5, 201)
        left.plot(at, np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi), "--", color="black", linewidth=2, label="noise alone")
        left.set(
            xlabel="residual over the declared noise" if declared else "residual over the estimated noise",
            ylabel="density",
            xlim=(-5, 5),
        )
        left.set_ylim(0, 1.5 * left.get_ylim()[1])
        left.legend(frameon=False, loc="upper right")
        bound = 2 / np.sqrt(case.rows * max(int(kept.sum()), 1))
        right.axhspan(-bound, bound, color="black", alpha=0.15, linewidth=0)
        right.axhline(0, color="black", linewidth=1)
        right.plot([], [], color="black", alpha=0.15, linewidth=9, label="noise alone, 95 %")
        right.set(xlabel="rows apart", ylabel="correlation of the residuals")
        low, high = right.get_ylim()
        right.set_ylim(min(low, -0.3), min(max(high, 0.3) + 0.1, 1.1))
        right.legend(frameon=False, loc="upper right")
        figure.suptitle(f"{title}: what is left, against the sensor's noise", fontsize=15)
    return figure


def _stages(found: Diagnosis) -> list[tuple[Case, Fitted, str]]:
    """What was fitted to which case, in which colour it is drawn."""
    selection = found.selection
    after = [(selection.case, selection.fitted, AFTER)] if selection.steps else []
    return [(selection.plain, selection.baseline, BEFORE), *after]


def _spectrum(evidence: Evidence, joint: int, exact_below: float) -> tuple[Array, Array]:
    """Orders and the share that each explains; the nuisance taken out where it matters, of the low ones."""
    orders, gains = spectrum(evidence, joint)
    low = int(np.searchsorted(orders, exact_below, side="right"))
    for start in range(0, low, _AT_ONCE):
        part = slice(start, min(start + _AT_ONCE, low))
        gains[part] = evidence.gains(evidence.case.harmonics(joint, orders[part]))
    return orders, 2 * gains / _left(evidence)


def _left(evidence: Evidence) -> float:
    """The sum of squares of what the nuisance leaves."""
    rest = evidence.residual - (evidence.basis @ evidence.residual) @ evidence.basis
    return max(float(rest @ rest), np.finfo(float).tiny)


def _adjusted(score: Score, total: float, freedom: float) -> float:
    """The share explained, less what as many numbers explain of noise."""
    left = 1 - min(2 * score.gain / total, 1.0)
    return float(max(1 - left * freedom / max(freedom - score.size, 1.0), 0.0))
