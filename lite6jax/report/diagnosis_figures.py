"""Figures of a diagnosis: errors, explained shares, orders, friction, spectra, and curves of findings."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from lite6jax.diagnosis import evidence_map, partial_residuals, tracking_errors
from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.diagnosis.evidence_map import JointSpectra
from lite6jax.diagnosis.partial_residuals import FindingCurve
from lite6jax.diagnosis.result import DomainDiagnosis
from lite6jax.diagnosis.torque_diagnosis import TorqueDiagnosis
from lite6jax.diagnosis.tracking_diagnosis import TrackingDiagnosis
from lite6jax.domains.base import DomainName
from lite6jax.domains.registry import DOMAINS
from lite6jax.domains.torque import filtering
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.formatting import SCREEN, joint_units, torque_units
from lite6jax.report import ranking
from lite6jax.report.figures import (
    AFTER,
    BEFORE,
    BINS,
    FRAMED,
    GREY,
    STYLE,
    blank,
    degree_ticks,
    dots,
    errors_over_joints,
    label_first_column,
    legend_below,
    medians,
    panels_in_rows,
    titled,
)
from lite6jax.report.remedies import effect_name, spaced

_STAGES = (("before", BEFORE), ("after", AFTER))
_COLUMNS = {
    "direction of motion": "direction\nof motion",
    "other positions": "other\npositions",
    "measured position": "measured\nposition",
    "two drivers": "two\ndrivers",
}
_THIN = 0.2
"""Of the samples that an even distribution would have, below which a bin's median is left out."""
_LEAST_SCALE = 2.0
"""Percent of the variance at which the colours of a map of noise end."""
_WIDTH = 0.38
"""Of a bar, over the distance of two joints."""
_LOWEST = 1e-4
"""Nm, the shortest bar."""


def figure_names(domains: Sequence[DomainName]) -> list[str]:
    """The figures that `drawings` may give of a diagnosis of these domains."""
    names = []
    for k, domain in enumerate(domains):
        prefix = prefix_of(domain) if k else ""
        figures = _FIGURES.get(domain, _NO_FIGURES)
        names += [prefix + name for name in figures.drawn]
        if figures.has_curves:
            names.append(f"{prefix}findings")
    return names


def prefix_of(domain: DomainName) -> str:
    """With which the names of figures of a domain begin that was diagnosed beside another."""
    return f"{DOMAINS[domain].words.singular}_"


def drawings(
    diagnosis: DomainDiagnosis[Any], title: str, document: Mapping[str, Any] | None = None
) -> Iterator[tuple[str, Figure]]:
    """The figures by name, those of domains beside with `prefix_of`; those of what there is not are left out.

    The document's ranking numbers the findings; without it they are in the order in which they were found.
    """
    figures = _FIGURES.get(diagnosis.domain, _NO_FIGURES)
    for name, draw in figures.drawn.items():
        if name != "spectra" or diagnosis.recording.motion != "static":
            yield name, draw(diagnosis, title)
    if diagnosis.findings and figures.has_curves:
        yield "findings", finding_figure(diagnosis, title, order=None if document is None else ranking.order(document))
    for other in diagnosis.beside:
        of_domain = None if document is None else document[other.domain]
        yield from ((prefix_of(other.domain) + name, figure) for name, figure in drawings(other, title, of_domain))


# ------------------------------------------------------------------ of poses


def error_by_joint(diagnosis: Diagnosis, title: str) -> Figure:
    """Held-out position error against each joint, before and after."""
    usable = ~diagnosis.outliers & np.isfinite(diagnosis.before) & np.isfinite(diagnosis.after)
    q = np.asarray(diagnosis.problem.motion.joint_position)[:, usable].T
    stages = []
    for name, errors in (("before", diagnosis.before[usable]), ("after", diagnosis.after[usable])):
        rms = 1e3 * float(np.sqrt(np.mean(errors**2))) if len(errors) else 0.0
        stages.append((q, errors, f"{name}: {rms:.3g} mm RMS, held out"))
    title = f"{title}: held-out position error before and after"
    return errors_over_joints(stages, diagnosis.problem.arm.sliding, title, share=_THIN)


@rc_context(FRAMED)
def explained_map(diagnosis: Diagnosis, title: str) -> Figure:
    """The share of the variance left by the nuisance that a process of each driver explains at each site.

    Colours end at the largest share: on an arm whose error has many causes, none alone explains much of it.
    """
    table = evidence_map.explained_shares(diagnosis)
    rows = len(table.sites)
    columns = len(table.drivers)
    finite = table.shares[np.isfinite(table.shares)]
    largest = max(100 * float(finite.max(initial=0.0)), _LEAST_SCALE)
    figure = blank(3.5 + 1.35 * columns, 2.2 + 0.45 * rows)
    panel = figure.subplots()
    percent = np.ma.masked_invalid(100 * table.shares)
    colours = panel.imshow(percent, cmap="cividis", vmin=0, vmax=largest, aspect="auto", interpolation="nearest")
    panel.set_facecolor("#eeeeee")
    for (i, j), share in np.ndenumerate(table.shares):
        text = "–"
        colour = GREY
        if np.isfinite(share):
            text = _percent(100 * float(share))
            colour = "black" if 100 * share > 0.55 * largest else "white"
        panel.text(j, i, text, ha="center", va="center", color=colour, fontsize=14)
    panel.set_xticks(range(columns), [_COLUMNS.get(name, name) for name in table.drivers])
    panel.set_yticks(range(rows), list(map(spaced, table.sites)))
    panel.set(xlabel="driver", ylabel="site")
    panel.tick_params(length=0)
    figure.colorbar(colours, label=f"explained variance (%), scaled to {_percent(largest)} %")
    return titled(figure, f"{title}: explained variance by site and driver")


def _percent(share: float) -> str:
    """Whole percents; a decimal below ten of what is not zero."""
    return f"{share:.1f}" if 0.05 <= share < 9.95 else f"{share:.0f}"


@rc_context(STYLE)
def order_spectrum(diagnosis: Diagnosis, title: str) -> Figure:
    """What a harmonic of each order of each joint explains, before and after."""
    spectra = evidence_map.joint_spectra(diagnosis)
    figure, panels = panels_in_rows(max(len(spectra), 1), shared=True)
    for panel, joint in zip(panels, spectra, strict=False):
        _draw_spectrum(panel, joint)
    if not spectra:
        panels[0].text(0.5, 0.5, "no joint turns", ha="center", color=GREY)
        return figure
    panels[0].set_ylim(max(3.0 * max(float(joint.noise.max()) for joint in spectra), 1e-3), 150)
    panels[0].yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    for name, colour in _STAGES[: 2 if diagnosis.findings else 1]:
        panels[0].plot([], [], color=colour, linewidth=2.5, label=name)
    level = f"exceeded by noise in one of {1 / diagnosis.options.engine.level:.0f} recordings"
    panels[0].plot([], [], ":", color="black", linewidth=1.8, label=level)
    if any(joint.harmonics for joint in spectra):
        panels[0].plot([], [], "--", color="black", linewidth=1.8, label="order found")
    if any(joint.spectra for joint in spectra):
        panels[0].plot([], [], color="black", linewidth=6, label="orders of an unnamed effect")
    legend_below(figure, panels[0], 4)
    return titled(figure, f"{title}: orders of the joints' positions")


def _draw_spectrum(panel: Axes, joint: JointSpectra) -> None:
    panel.set_ylim(1e-3, 150)  # of all panels together below; a spectrum of zeros has no limits of its own
    for (_, colour), spectrum in zip(_STAGES, (joint.before, joint.after), strict=True):
        if spectrum is not None:
            dense = len(spectrum.orders) > 3000
            panel.plot(spectrum.orders, 100 * spectrum.shares, color=colour, linewidth=1.4, zorder=3, rasterized=dense)
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
    for orders in joint.spectra:
        panel.plot(orders, (0.97, 0.97), color="black", linewidth=6, transform=panel.get_xaxis_transform(), zorder=5)
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_xlabel(f"order per turn of {joint.site.replace('joint', 'joint ')}")
    panel.xaxis.set_major_locator(FixedLocator([1, 2, 5, 10, 20, 50, 100, 400]))
    panel.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    panel.xaxis.set_minor_formatter(NullFormatter())
    panel.set_xlim(1, np.ceil(at[-1]))
    label_first_column(panel, "explained variance (%)")


# ------------------------------------------------------------------ of torques


@rc_context(STYLE)
def torque_error_by_joint(diagnosis: TorqueDiagnosis, title: str) -> Figure:
    """Held-out errors of each joint, before and after, beside the standard deviation of what was measured."""
    valid = diagnosis.problem.valid
    spread = np.maximum(np.std(diagnosis.problem.measured[:, valid], axis=1), _LOWEST)
    at = np.arange(1, len(spread) + 1)
    figure = blank(4.0 + 1.5 * len(at), 5.4)
    panel = figure.subplots()
    lowest = float(spread.min())
    for side, (name, colour, errors) in enumerate(
        (("before", BEFORE, diagnosis.before), ("after", AFTER, diagnosis.after))
    ):
        rms = np.maximum(np.sqrt(np.mean(errors[:, valid] ** 2, 1)), _LOWEST)
        lowest = min(lowest, float(rms.min()))
        bars = panel.bar(at + (side - 0.5) * _WIDTH, rms, _WIDTH, color=colour, label=f"{name}, held out", zorder=3)
        panel.bar_label(bars, [f"{value:.2g}" for value in rms], padding=2, fontsize=12)
    label = "standard deviation of the measured torque"
    panel.hlines(spread, at - 0.45, at + 0.45, color="black", linestyle="--", linewidth=2, label=label, zorder=4)
    panel.set_yscale("log")
    panel.set_ylim(0.4 * lowest, 2.5 * max(panel.get_ylim()[1] / 2.5, spread.max()))
    panel.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    exerted = _exerted(diagnosis)
    units = sorted({unit for _, unit in exerted}, reverse=True)  # Nm before N
    panel.set(xlabel="joint", ylabel=f"torque error ({' or '.join(units)} RMS)", xticks=at)
    if len(units) > 1:
        panel.set_xticks(at, [f"{joint} ({unit})" for joint, (_, unit) in enumerate(exerted, 1)])
    panel.grid(visible=False, axis="x")
    legend_below(figure, panel, 3)
    return titled(figure, f"{title}: held-out torque error of each joint")


@rc_context(STYLE)
def over_time(diagnosis: TorqueDiagnosis, title: str) -> Figure:
    """Measured, rigid-body and modelled torques of each joint over a part of the recording."""
    time, torques = evidence_map.torques_over_time(diagnosis)
    exerted = _exerted(diagnosis)
    styles: tuple[dict[str, Any], ...] = (
        {"color": "black", "linewidth": 3.5, "alpha": 0.35},
        {"color": BEFORE, "linewidth": 1.6, "linestyle": "--"},
        {"color": AFTER, "linewidth": 1.6},
    )
    figure, panels = panels_in_rows(len(exerted), wide=True)
    for j, panel in enumerate(panels):
        for (name, torque), style in zip(torques.items(), styles, strict=True):
            panel.plot(time, torque[j], label=name, **style)
        effort, unit = exerted[j]
        panel.set(xlabel="time (s)", ylabel=f"{effort} of joint {j + 1} ({unit})")
        panel.xaxis.set_major_locator(MaxNLocator(5))
    legend_below(figure, panels[0], 3)
    return titled(figure, f"{title}: measured and modelled torques")


@rc_context(STYLE)
def friction(diagnosis: TorqueDiagnosis, title: str) -> Figure:
    """The torque that the model without friction leaves at each joint over its velocity, and the friction found."""
    joints = evidence_map.joint_frictions(diagnosis)
    exerted = _exerted(diagnosis)
    scales, angles = joint_units(diagnosis.problem.data.arm.sliding, len(joints))
    figure, panels = panels_in_rows(len(joints), wide=True)
    for j, (panel, joint) in enumerate(zip(panels, joints, strict=True)):
        dots(panel, scales[j] * joint.velocity, joint.partial, GREY)
        panel.axhline(0, color="black", linewidth=1)
        if len(joint.at):
            panel.plot(scales[j] * joint.at, joint.friction, color=AFTER, linewidth=2.5, zorder=4)
        else:
            panel.margins(y=0.15)
            place: dict[str, Any] = {"ha": "center", "va": "top", "transform": panel.transAxes}
            panel.text(0.5, 0.99, "no friction over velocity found", color="#5c5c5c", **place)
        effort, unit = exerted[j]
        panel.set(
            xlabel=f"velocity of joint {j + 1} ({angles[j]}/s)", ylabel=f"{effort} left at joint {j + 1} ({unit})"
        )
        panel.xaxis.set_major_locator(MaxNLocator(5))
    panels[0].plot([], [], ".", color=GREY, markersize=8, label="measured, less the model without friction")
    panels[0].plot([], [], color=AFTER, linewidth=2.5, label="friction found, at the median load")
    legend_below(figure, panels[0], 2)
    return titled(figure, f"{title}: friction")


@rc_context(STYLE)
def spectra(diagnosis: TorqueDiagnosis, title: str) -> Figure:
    """Power spectra of the recorded velocities and torques, without spikes, and where the low passes cut them."""
    data = diagnosis.problem.data
    slides = bool(data.arm.sliding)
    of_velocity, of_torque = ("(rad/s or m/s)²/Hz", "Nm²/Hz or N²/Hz") if slides else ("(rad/s)²/Hz", "Nm²/Hz")
    frequency, velocity = filtering.spectra(data.recording.velocities().T, data.recorded)
    torque = filtering.spectra(data.torque, data.recorded)[1]
    parts = ("velocity", of_velocity, velocity, data.motion_cutoff), ("torque", of_torque, torque, data.filter.cutoff)
    figure, panels = panels_in_rows(len(parts), wide=True)
    for panel, (name, unit, power, cutoff) in zip(panels, parts, strict=True):
        for joint, row in enumerate(power, 1):
            panel.plot(frequency, np.maximum(row, 1e-300), linewidth=1.2, label=f"joint {joint}")
        panel.axvline(cutoff, color="black", linestyle="--", linewidth=1.6, label="cutoff of the low pass")
        largest = float(power.max(initial=1e-12))
        panel.set(xscale="log", yscale="log", xlabel="frequency (Hz)", ylabel=f"power of the {name} ({unit})")
        panel.set_ylim(max(float(power.min(initial=largest)), 1e-9 * largest) / 2, 3 * largest)
        panel.set_title(f"{name}: {cutoff:.3g} Hz", fontsize=13)
    legend_below(figure, panels[0], 4)
    return titled(figure, f"{title}: spectra, and what the low passes leave")


def _exerted(diagnosis: TorqueDiagnosis) -> list[tuple[str, str]]:
    """What the motor of each joint exerts, and the unit."""
    return [(_EXERTED[unit], unit) for unit in torque_units(diagnosis.problem.data.arm.sliding, diagnosis.problem.rows)]


# ------------------------------------------------------------------ of findings


_SAMPLES_PER_BIN = 12
_BINS_PER_WAVE = 4
_DRIVERS = {"1": (1.0, "")} | {
    f"{unit}{per}": (scale, f"{shown}{per}") for unit, (scale, shown) in SCREEN.items() for per in ("", "/s")
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


@rc_context(STYLE)
def finding_figure(
    diagnosis: DomainDiagnosis[Any],
    title: str,
    chosen: Sequence[int] | None = None,
    order: Sequence[int] | None = None,
) -> Figure:
    """Each finding's curve with its 95 % band, over its partial residuals.

    Args:
        diagnosis: with findings.
        title: of the figure.
        chosen: places of findings, from 0; all where not given.
        order: places of all findings in the order in which they are numbered; theirs where not given.
    """
    if order is None:
        order = range(len(diagnosis.findings))
    places = order if chosen is None else chosen
    curves = [curve for k in places for curve in partial_residuals.finding_curves(diagnosis, k)]
    figure, panels = panels_in_rows(len(curves), wide=True)
    binned = False
    for panel, curve in zip(panels, curves, strict=True):
        effect = diagnosis.findings[curve.finding].effect
        binned |= _draw(panel, curve, isinstance(effect, Unnamed))
        number = order.index(curve.finding) + 1
        name = "unnamed effect"
        if not effect.nonparametric:
            name = effect_name(effect.name)
        panel.set_title(f"{number}. {name}, {effect.site}", fontsize=13)
    panels[0].plot([], [], color=AFTER, linewidth=2.5, label="fitted")
    if not all(curve.scattered for curve in curves):
        panels[0].fill_between([], [], [], color=AFTER, alpha=0.3, linewidth=0, label="95 % band")
    if binned:
        label = "partial residuals: medians ± std. error"
        panels[0].errorbar([], [], [], fmt="o", color="black", capsize=3, label=label)
    else:
        panels[0].plot([], [], ".", color=GREY, markersize=8, label="partial residuals")
    legend_below(figure, panels[0], 3)
    return titled(figure, title)


def _draw(panel: Axes, curve: FindingCurve, unnamed: bool = False) -> bool:
    """Draws a curve into a panel, with medians of the partial residuals; says whether there are some.

    An unnamed effect of poses is about its mean.
    """
    x_scale, across, angle = _across(curve)
    y_scale, up = _up(curve, unnamed)
    panel.set(xlabel=across, ylabel=up)
    x = x_scale * curve.driver
    partial = y_scale * curve.partial
    at = x_scale * curve.at
    fitted = y_scale * curve.curve
    std = y_scale * curve.std
    binned = False
    discrete = curve.quantity is not None and curve.quantity.discrete
    dots(panel, x, partial, GREY)
    if curve.scattered:
        panel.plot(at, fitted, ".", color=AFTER, markersize=5, zorder=4)
    else:
        panel.fill_between(at, fitted - 2 * std, fitted + 2 * std, color=AFTER, alpha=0.3, linewidth=0, zorder=3)
        bins = int(np.clip(_BINS_PER_WAVE * curve.periods, BINS, max(len(x) // _SAMPLES_PER_BIN, BINS)))
        crowded = bins > BINS
        panel.plot(at, fitted, color=AFTER, linewidth=1.5 if crowded else 2.5, zorder=4)
        centre, middle, error = medians(x, partial, 3 if discrete else bins)
        if discrete and len(x):
            centre = np.linspace(x.min(), x.max(), 3)
        size, cap = (3, 0) if crowded else (5, 3)
        panel.errorbar(centre, middle, error, fmt="o", color="black", markersize=size, capsize=cap, zorder=5)
        binned = bool(np.isfinite(middle).any())
    inner = np.percentile(partial, (1, 99)) if len(partial) else np.zeros(2)
    low = min(0.0, float(inner[0]), float(fitted.min()))
    high = max(0.0, float(inner[1]), float(fitted.max()))
    margin = 0.1 * (high - low or 1.0)
    panel.set_ylim(low - margin, high + margin)
    if discrete:
        panel.set_xticks((-1, 0, 1))
    else:
        panel.xaxis.set_major_locator(degree_ticks(panel) if angle else MaxNLocator(4))
    return binned


def _across(curve: FindingCurve) -> tuple[float, str, bool]:
    """Factor and label of the horizontal axis, and whether it is an angle."""
    if curve.over == "row":
        return 1.0, "row of the recording", False
    if curve.over == "displacement":
        scale, unit = _DEFLECTIONS[curve.unit]
        moved = "displacement of the measured pose"
        if curve.site is not None:
            moved = _at_motor(curve)
        return scale, f"fitted {moved} ({unit})", False
    assert curve.quantity is not None
    if curve.over == "phase":
        return 180 / np.pi, f"phase of the harmonic, {curve.quantity.phrase} (deg)", True
    scale, unit = _DRIVERS.get(curve.quantity.unit, (1.0, curve.quantity.unit))
    return scale, f"{curve.quantity.phrase} ({unit})" if unit else curve.quantity.phrase, unit == "deg"


def _up(curve: FindingCurve, unnamed: bool) -> tuple[float, str]:
    """Factor and label of the vertical axis."""
    scale, unit = _DEFLECTIONS[curve.unit]
    if unnamed and curve.unit == "rad":  # as its peak to peak is read
        scale = 1e6
        unit = "µrad"
    if curve.site is None:
        return scale, f"displacement along it ({unit})"
    field, _, component = curve.site
    if curve.unit in _EXERTED:
        return scale, f"{_at_motor(curve)} ({unit})"
    movement = f"{'translation along' if component < 3 else 'rotation about'} {'xyz'[component % 3]}"
    return scale, f"{_MOVEMENTS.get(field, movement)}{' from its mean' if unnamed else ''} ({unit})"


def _at_motor(curve: FindingCurve) -> str:
    assert curve.site is not None
    return f"{_EXERTED[curve.unit]} at joint {curve.site[1] + 1}"


# ------------------------------------------------------------------ of commands and joints


_QUANTITIES: Mapping[tracking_errors.Quantity, tuple[str, float]] = {
    "speed": ("speed (deg/s)", 180 / np.pi),
    "load": ("torque of the weight (Nm)", 1.0),
    "since_reversal": ("time since the last reversal (s)", 1.0),
}
"""Over which errors are shown: the label of the axis, and the factor to its unit."""


@rc_context(STYLE)
def tracking_over_time(diagnosis: TrackingDiagnosis, title: str) -> Figure:
    """Command, log and rollouts of a few joints in a held-out stretch; below, the errors of the rollouts there."""
    stretch = tracking_errors.held_out_stretch(diagnosis)
    rollouts = (stretch.before, stretch.after)[: _stages_shown(diagnosis)]
    columns = len(stretch.joints)
    figure = blank(max(5.2 * columns, 7.5), 8.2)
    panels = figure.subplots(2, columns, squeeze=False, sharex=True)
    for k, (joint, upper, lower) in enumerate(zip(stretch.joints, *panels, strict=True)):
        upper.plot(stretch.time, np.rad2deg(stretch.command[k]), ":", color="black", linewidth=1.6, label="command")
        log = np.rad2deg(stretch.measured[k])
        upper.plot(stretch.time, log, color="black", linewidth=4.0, alpha=0.35, label="log")
        for (name, color), rollout, style in zip(_STAGES, rollouts, ("--", "-"), strict=False):
            upper.plot(
                stretch.time, np.rad2deg(rollout[k]), style, color=color, linewidth=1.6, label=f"{name}, held out"
            )
            lower.plot(stretch.time, 1e3 * (rollout[k] - stretch.measured[k]), style, color=color, linewidth=1.4)
        upper.set_title(f"joint {joint + 1}")
        lower.axhline(0, color="black", linewidth=1)
        lower.set_xlabel("time (s)")
        lower.xaxis.set_major_locator(MaxNLocator(5))
    panels[0, 0].set_ylabel("position (deg)")
    panels[1, 0].set_ylabel("rollout less log (mrad)")
    legend_below(figure, panels[0, 0], 4)
    return titled(figure, f"{title}: commands, log and held-out rollouts")


@rc_context(STYLE)
def error_over_motion(diagnosis: TrackingDiagnosis, title: str) -> Figure:
    """Held-out errors of each joint, in bins of its speed, of the torque of its weight, and of time from reversals."""
    by_joint = tracking_errors.errors_over_motion(diagnosis)
    names = list(by_joint[0])
    figure = blank(4.8 * len(names), 2.6 * len(by_joint) + 1.4)
    panels = figure.subplots(len(by_joint), len(names), squeeze=False, sharey="row")
    for joint, (over, row) in enumerate(zip(by_joint, panels, strict=True)):
        for name, panel in zip(names, row, strict=True):
            label, scale = _QUANTITIES[name]
            panel.set_xlabel(label)
            binned = over[name]
            if not len(binned.at):
                place: dict[str, Any] = {"ha": "center", "va": "center", "transform": panel.transAxes}
                panel.text(0.5, 0.5, "does not vary, or in too few rows", color="#5c5c5c", **place)
                panel.set_xticks([])
                continue
            rms = (binned.before, binned.after)[: _stages_shown(diagnosis)]
            for (stage, color), errors, marker in zip(_STAGES, rms, "os", strict=False):
                of_stage = f"{stage}, held out"
                panel.plot(scale * binned.at, 1e3 * errors, marker=marker, color=color, label=of_stage, clip_on=False)
            panel.xaxis.set_major_locator(MaxNLocator(5))
        row[0].set_yscale("log")
        row[0].set_ylim(_decade_around(row[0].get_ylim()))
        row[0].yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        row[0].yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        row[0].yaxis.set_minor_formatter(NullFormatter())
        row[0].set_ylabel(f"joint {joint + 1} (mrad RMS)")
    legend_below(figure, panels[0, 0], 2)
    return titled(figure, f"{title}: held-out errors over speed, load and reversals")


def _decade_around(limits: tuple[float, float]) -> tuple[float, float]:
    """The limits of a logarithmic axis, a decade apart at least, so that it has a tick."""
    lower, upper = limits
    wider = max(np.sqrt(10 * lower / upper), 1.0)
    return lower / wider, upper * wider


def _stages_shown(diagnosis: TrackingDiagnosis) -> int:
    """How many stages differ: without findings there is one."""
    return 2 if diagnosis.findings else 1


class _Figures(NamedTuple):
    """The figures of a domain.

    Attributes:
        drawn: by the name of a figure, how it is drawn; a recording at rest has no spectra.
        has_curves: whether findings have curves over partial residuals.
    """

    drawn: Mapping[str, Callable[[Any, str], Figure]]
    has_curves: bool = True


_FIGURES: Mapping[DomainName, _Figures] = {
    "poses": _Figures({"error_by_joint": error_by_joint, "where": explained_map, "orders": order_spectrum}),
    "torques": _Figures(
        {"error_by_joint": torque_error_by_joint, "over_time": over_time, "friction": friction, "spectra": spectra}
    ),
    "tracking": _Figures({"over_time": tracking_over_time, "error_over_motion": error_over_motion}, has_curves=False),
}
_NO_FIGURES = _Figures({}, has_curves=False)
"""Of a domain that has none."""
