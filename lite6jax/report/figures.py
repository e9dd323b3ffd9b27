"""The style of figures and their writing without a display; figures of fits, comparisons, studies and designs."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator

from lite6jax import storage
from lite6jax.array_types import Array
from lite6jax.calibration.fleet import Comparison
from lite6jax.calibration.solution import Solution
from lite6jax.controller.sdk import GATE_M, KinematicsCheck
from lite6jax.errors import InputError
from lite6jax.formatting import SCREEN, joint_units
from lite6jax.recordings.sequence import spread_rows

if TYPE_CHECKING:  # what studies take, and fits do not
    from lite6jax.design.command_plans import CommandPlan
    from lite6jax.design.identify import Identification, Sensitivity
    from lite6jax.design.poses import DiscriminationPlan, Plan
    from lite6jax.design.torques import TorquePlan


# M. Okabe, K. Ito, Color Universal Design, 2002: distinguishable with colour blindness and in grey
BEFORE = "#D55E00"
AFTER = "#0072B2"
OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
MARKERS = "os^Dv<>P"
SUFFIXES = (".png", ".svg")

STYLE: dict[Any, Any] = {
    "font.size": 13,
    "axes.titlesize": 13,
    "axes.labelsize": 13,
    "legend.fontsize": 12,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "svg.hashsalt": "lite6jax",
}
"""Legible at half size. The hash salt makes the bytes of an SVG reproducible."""
FRAMED: dict[Any, Any] = {**STYLE, "axes.grid": False, "axes.spines.top": True, "axes.spines.right": True}
"""The style of images."""

GREY = "#8a8a8a"
BINS = 20
_LEAST_IN_BIN = 5
_MOST_POINTS = 2000
_WIDE = ((1, (1, 7.5, 4.2)), (6, (2, 6.0, 4.2)), (15, (3, 5.0, 3.6)), (np.inf, (4, 4.6, 3.2)))
"""Layouts by the largest number of panels: the number of columns, and the width and height of a panel in inches."""
_SEPARATE = 50
_CROWDED = 1000
"""Numbers of samples up to which dots are as large and opaque as they get, and from which they are smallest."""


def check_names(folder: str | Path, names: Sequence[str], overwrite: bool = False) -> None:
    """Creates the folder and checks that figures of these names can be saved there; call it before a long computation.

    Raises:
        InputError: a file exists and `overwrite` is false, or the folder cannot be created.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: this folder cannot be created ({error.strerror}); choose another") from error
    for file in (f"{name}{suffix}" for name in names for suffix in SUFFIXES):
        storage.check_writable(folder / file, overwrite)


def save(figures: Mapping[str, Figure], folder: str | Path, overwrite: bool = False) -> list[Path]:
    """Writes figures by name as PNG and SVG, atomically and reproducibly.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    written = []
    for name, figure in figures.items():
        for suffix in SUFFIXES:
            metadata = {"Date": None} if suffix == ".svg" else {"Software": None}
            write = partial(figure.savefig, format=suffix[1:], dpi=120, metadata=metadata)
            with rc_context(STYLE):
                written.append(storage.write_atomically(Path(folder, f"{name}{suffix}"), write, overwrite))
    return written


def blank(width: float, height: float) -> Figure:
    """An empty figure of this width and height in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def degree_ticks(panel: Axes) -> MultipleLocator | MaxNLocator:
    """Ticks at round angles for an axis in degrees."""
    low, high = panel.get_xlim()
    for step in (5, 10, 15, 30, 45, 90, 180):
        if (high - low) / step <= 5:
            return MultipleLocator(step)
    return MultipleLocator(180) if high - low < 1000 else MaxNLocator(5)


# ------------------------------------------------------------------ panels


def panels_in_rows(count: int, shared: bool = False, wide: bool = False) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels in rows.

    They may share their vertical axis. Wide panels, as for curves, are smaller the more there are.
    """
    columns = min(count, 4 if count > 6 else 3)
    width = 3.0 + 3.0 / columns
    height = 3.2
    if wide:
        columns, width, height = next(layout for panel_limit, layout in _WIDE if count <= panel_limit)
    rows = -(-count // columns)
    figure = blank(width * columns, height * rows + 1.0)
    panels = figure.subplots(rows, columns, sharey=shared, squeeze=False).ravel()
    for panel in panels[count:]:
        panel.set_visible(False)
    return figure, list(panels[:count])


def titled(figure: Figure, title: str) -> Figure:
    """The figure with its title above all panels."""
    figure.suptitle(title, fontsize=15)
    return figure


def label_first_column(panel: Axes, label: str) -> None:
    """Labels the vertical axis of the first column, whose scale the others share."""
    if panel.get_subplotspec().is_first_col():  # type: ignore[union-attr]
        panel.set_ylabel(label)


def label_joints(panels: Sequence[Axes], units: Sequence[str], label: str) -> None:
    """Names the axes of panels of one joint each, in deg with round angles or in mm, after these are drawn."""
    for joint, (panel, unit) in enumerate(zip(panels, units, strict=True), 1):
        panel.set_xlabel(f"joint {joint} ({unit})")
        panel.xaxis.set_major_locator(degree_ticks(panel) if unit == "deg" else MaxNLocator(5))
        label_first_column(panel, label)


def legend_below(figure: Figure, panel: Axes, columns: int) -> None:
    """A legend below all panels, with the entries of one of them."""
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)


def dots(panel: Axes, x: Array, y: Array, color: str, zorder: float = 2) -> None:
    """Draws samples `(sample,)` as dots, evenly thinned where there are many; the fewer, the larger and more opaque."""
    crowded = np.log(max(len(x), 1) / _SEPARATE) / np.log(_CROWDED / _SEPARATE)
    sparseness = 1 - float(np.clip(crowded, 0, 1))
    shown = spread_rows(len(x), _MOST_POINTS)
    panel.plot(
        x[shown], y[shown], ".", color=color, markersize=5 + 5 * sparseness, alpha=0.35 + 0.45 * sparseness,
        markeredgewidth=0, rasterized=True, zorder=zorder,
    )  # fmt: skip


def medians(x: Array, y: Array, count: int = BINS, share: float = 0.0) -> tuple[Array, Array, Array]:
    """Centres of bins of equal width, medians `(bin,)` and their standard errors; NaN where a bin has too few samples.

    Args:
        x: `(sample,)`, which is binned.
        y: `(sample,)`.
        count: the number of bins.
        share: of the samples of an even distribution, which a bin has at least beside `_LEAST_IN_BIN`.
    """
    if not len(x):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    edges = np.linspace(x.min(), max(x.max(), x.min() + 1e-9), count + 1)
    at = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, count - 1)
    middle = np.full(count, np.nan)
    error = np.full(count, np.nan)
    for k in range(count):
        inside = y[at == k]
        if len(inside) >= max(_LEAST_IN_BIN, share * len(x) / count):
            middle[k] = np.median(inside)
            deviation = 1.4826 * np.median(np.abs(inside - middle[k]))
            error[k] = np.sqrt(np.pi / 2 / len(inside)) * deviation  # the standard error of a median of normal noise
    return (edges[1:] + edges[:-1]) / 2, middle, error


@rc_context(STYLE)
def errors_over_joints(
    stages: Sequence[tuple[Array, Array, str]], sliding: Sequence[int], title: str, share: float = 0.0
) -> Figure:
    """Position errors against each joint, before and after; lines are medians, where samples are enough.

    Each stage has positions of the joints `(sample, joint)`, errors `(sample,)` m and a label; `share` as of `medians`.
    """
    joints = stages[0][0].shape[1]
    scales, units = joint_units(sliding, joints)
    figure, panels = panels_in_rows(joints, shared=True)
    styles = list(zip(stages, (BEFORE, AFTER), (2, 3), strict=True))
    line = False
    for joint, panel in enumerate(panels):
        for (q, errors, _), colour, zorder in styles:
            dots(panel, scales[joint] * q[:, joint], 1e3 * errors, colour, zorder)
            at, middle, _ = medians(scales[joint] * q[:, joint], 1e3 * errors, share=share)
            panel.plot(at, middle, color=colour, linewidth=2.5, zorder=5, clip_on=False)
            line |= bool(np.isfinite(middle).any())
    label_joints(panels, units, "position error (mm)")
    tops = [1e3 * float(np.percentile(errors, 99.5)) for _, errors, _ in stages if len(errors)]
    panels[0].set_ylim(0, 1.1 * max(tops, default=1.0) or 1.0)
    for (_, _, label), colour, _ in styles:
        panels[0].plot([], [], "-o" if line else "o", color=colour, linewidth=2.5, label=label)
    legend_below(figure, panels[0], 2)
    return titled(figure, title)


# ------------------------------------------------------------------ fits and comparisons


_MOST_NAMED = 12
_MOST_CURVES = 5


def error_by_joint(solution: Solution, title: str) -> Figure:
    """Position error against each joint, with medians: of the nominal arm, and of the fitted one on other samples."""
    where = "on held-out blocks" if solution.noise else "on fresh samples"
    stages = []
    for name, errors in (("nominal", solution.nominal_errors), (f"fitted, {where}", solution.checked)):
        sizes = (1e3 * errors.position_rms, 1e3 * float(errors.position.max()))
        rms, largest = (f"{size:.1e}" if 0 < size < 1e-3 else f"{size:#.3g}" for size in sizes)
        stages.append((errors.joint_position, errors.position, f"{name}: {rms} mm RMS, {largest} mm at most"))
    return errors_over_joints(stages, solution.arm.sliding, title)


@rc_context(STYLE)
def parameter_differences(comparison: Comparison, title: str) -> Figure:
    """The difference of each arm's parameters from nominal: lengths in the upper panel, angles in the lower."""
    form = comparison.arm.form
    count = len(comparison.names)
    units = np.array(form.units)
    figure = blank(12.0, 8.4)
    for panel, (unit, (scale, shown)) in zip(figure.subplots(2, 1), SCREEN.items(), strict=True):
        chosen = np.flatnonzero(units == unit)
        values = scale * comparison.difference[:, chosen]
        for k in range(count):
            spread = 0.5 * ((k + 0.5) / count - 0.5)
            name = None
            colour = AFTER
            marker = "o"
            if count <= len(OKABE_ITO):
                name = _short(comparison.names[k], k)
                colour = OKABE_ITO[k]
                marker = MARKERS[k]
            panel.plot(
                np.arange(len(chosen)) + spread, values[k], marker, color=colour, label=name,
                markersize=6, alpha=0.85 if name else 0.5, markeredgewidth=0,
            )  # fmt: skip
        panel.axhline(0, color="black", linewidth=1)
        panel.set_xticks(np.arange(len(chosen)), [form.names[i] for i in chosen], rotation=45, ha="right")
        panel.set_ylabel(f"difference ({shown})")
        panel.set_xlim(-0.6, len(chosen) - 0.4)
    if figure.axes[0].get_legend_handles_labels()[0]:
        legend_below(figure, figure.axes[0], 2)
    return titled(figure, f"{title}: parameters minus nominal")


@rc_context(FRAMED)
def distance_between(comparison: Comparison, title: str) -> Figure:
    """The largest distance between the flanges of each two arms, and of each from nominal."""
    count = len(comparison.names)
    table = np.zeros((count + 1, count + 1))
    table[1:, 1:] = 1e3 * comparison.between
    table[0, 1:] = table[1:, 0] = 1e3 * comparison.from_nominal.max(1)
    labels = ["nominal", *(_short(name, k) for k, name in enumerate(comparison.names))]
    figure = blank(9.5, 6.5)
    panel = figure.subplots()
    image = panel.imshow(table, cmap="cividis", vmin=0)
    if count <= _MOST_NAMED:
        for i, j in np.ndindex(table.shape):
            light = table[i, j] > 0.6 * table.max()
            if i != j:
                panel.text(j, i, f"{table[i, j]:.2f}", ha="center", va="center", color="black" if light else "white")
        panel.set_xticks(range(count + 1), ["nominal", *map(str, range(1, count + 1))])
        panel.set_yticks(range(count + 1), labels)
    else:
        panel.set(xlabel="arm (0: nominal)", ylabel="arm (0: nominal)")
    figure.colorbar(image, label="largest distance of the flanges (mm)")
    return titled(figure, f"{title}: largest distance")


def _short(name: str, k: int) -> str:
    return f"{k + 1} {name if len(name) <= 28 else name[:27] + '…'}"


@rc_context(STYLE)
def verification_figure(verification: KinematicsCheck, title: str) -> Figure:
    """The position difference from the controller against each joint, in nm, µm or mm."""
    q = np.rad2deg(verification.joint_position)
    position = verification.position
    largest = float(position.max())
    unit = "mm"
    if largest < 1e-6:
        unit = "nm"
    elif largest < 1e-3:
        unit = "µm"
    scale = {"mm": 1e3, "µm": 1e6, "nm": 1e9}[unit]
    figure, panels = panels_in_rows(q.shape[1], shared=True)
    for joint, panel in enumerate(panels):
        dots(panel, q[:, joint], scale * position, AFTER)
        if 2 * largest > GATE_M:
            panel.axhline(scale * GATE_M, color="black", linewidth=1.5)
    label_joints(panels, ["deg"] * len(panels), f"difference ({unit})")
    panels[0].set_ylim(0, 1.08 * scale * largest or 1.0)
    return titled(figure, f"{title}: controller's forward kinematics against the calibration")


# ------------------------------------------------------------------ studies and designs


@rc_context(STYLE)
def deviations(identification: "Identification", title: str) -> Figure:
    """The predicted standard deviation of each parameter against its tolerance: lengths, angles, then effects."""
    d = identification.determination
    effect = np.array([":" in name for name in d.names])
    units = np.array(d.units)
    groups = [(f" ({shown})", scale, (units == unit) & ~effect) for unit, (scale, shown) in SCREEN.items()]
    groups = [group for group in (*groups, ("\n(of typical size)", 1.0, effect)) if group[2].any()]
    figure = blank(12.0, 3.6 * len(groups) + 0.8)
    panels = figure.subplots(len(groups), 1, squeeze=False).ravel()
    for panel, (label, scale, chosen) in zip(panels, groups, strict=True):
        typical = d.scale[chosen] if effect[chosen].all() else np.ones(chosen.sum())
        values = scale * d.standard_deviation[chosen] / typical
        tolerance = float(scale * (d.scale[chosen] / typical)[0])
        free = d.free[chosen]
        at = np.arange(len(values))
        shown = np.append(values[free], tolerance)
        low = 0.3 * float(shown.min())
        panel.bar(at[free], values[free] - low, bottom=low, width=0.7, color=AFTER)
        panel.plot(at[~free], np.full((~free).sum(), tolerance), "X", color=BEFORE, markersize=9, clip_on=False)
        panel.axhline(tolerance, color="black", linestyle="--", linewidth=1.5)
        panel.set_yscale("log")
        panel.set_ylim(low, 2.5 * float(shown.max()))
        names = [d.names[i].replace(":", "\n", 1).split(":")[0] for i in np.flatnonzero(chosen)]
        panel.set_xticks(at, names, rotation=45, ha="right")
        panel.set_xlim(-0.7, len(at) - 0.3)
        panel.set_ylabel(f"std. deviation{label}")
        panel.grid(axis="x", visible=False)
    panels[0].plot([], [], color=AFTER, linewidth=8, label="predicted")
    panels[0].plot([], [], color="black", linestyle="--", label="tolerance of assembly")
    if not d.free.all():
        panels[0].plot([], [], "X", color=BEFORE, markersize=9, label="held")
    legend_below(figure, panels[0], 3)
    return titled(figure, f"{title}: how well {d.samples} poses determine each parameter")


@rc_context(STYLE)
def accuracy_by_count(plan: "Plan | DiscriminationPlan", title: str) -> Figure:
    """Accuracy, or distance between two models, against the number of poses: designed and drawn at random."""
    from lite6jax.design.poses import Plan

    figure = blank(9.0, 5.4)
    subject = f"{plan.count} poses"
    panel = figure.subplots()
    if isinstance(plan, Plan):
        shown = slice(0, min(2 * plan.count, plan.random_accuracy.shape[1]))
        random = 1e3 * plan.random_accuracy[:, shown]
        low, middle, high = np.quantile(random, (0.05, 0.5, 0.95), axis=0, method="nearest")
        at = np.arange(1, len(middle) + 1)
        finite = np.isfinite(middle)
        # infinite for draws that do not determine all parameters
        high = np.where(np.isfinite(high), high, middle[finite].max())
        panel.fill_between(at[finite], low[finite], high[finite], color=BEFORE, alpha=0.2, linewidth=0)
        panel.plot(at[finite], middle[finite], "--", color=BEFORE, linewidth=2.5, label="random, median and 90 %")
        designed = 1e3 * plan.accuracy
        panel.set_yscale("log")
        label = "predicted positions over the workspace\n(mm, one std. deviation)"
    else:
        designed = plan.distance
        low, middle, high = np.quantile(plan.random_distance, (0.05, 0.5, 0.95))
        panel.errorbar(
            [plan.count], [middle], [[middle - low], [high - middle]], fmt="s", color=BEFORE, capsize=5,
            markersize=8, label="random, median and 90 %",
        )  # fmt: skip
        label = "distance between the models\n(standard deviations)"
        subject += f" to discriminate between {plan.rivals[0]} and {plan.rivals[1]}"
    count = np.arange(1, plan.count + 1)
    determined = np.isfinite(designed)
    panel.plot(count[determined], designed[determined], "-", color=AFTER, linewidth=2.5)
    panel.plot(count[-1], designed[-1], "o", color=AFTER, markersize=9)
    panel.plot([], [], "-o", color=AFTER, linewidth=2.5, label="designed")
    panel.set(xlabel="poses", ylabel=label)
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.legend(frameon=False)
    return titled(figure, f"{title}: {subject}")


@rc_context(STYLE)
def sensitivity_by_joint(sensitivity: "Sensitivity", title: str) -> Figure:
    """How far the flange moves per tolerance of the parameters that matter most, over each joint."""
    middles, means = sensitivity.by_joint()
    scales, units = joint_units(sensitivity.sliding, len(middles))
    # those whose share depends on where the arm is: what moves the flange alike everywhere is a straight line
    order = np.argsort(-np.nanmax(means, (0, 1)), kind="stable")[:_MOST_CURVES]
    figure, panels = panels_in_rows(len(middles), shared=True)
    for j, panel in enumerate(panels):
        for k, (i, colour, marker) in enumerate(zip(order, OKABE_ITO, MARKERS, strict=False)):
            panel.plot(
                scales[j] * middles[j], 1e3 * means[j, :, i], color=colour, linewidth=2.2, marker=marker,
                markevery=(k, 6), markersize=6, label=sensitivity.names[i],
            )  # fmt: skip
    label_joints(panels, units, "flange moves (mm)\nper tolerance")
    panels[0].set_ylim(bottom=0)
    legend_below(figure, panels[0], _MOST_CURVES)
    return titled(figure, f"{title}: which parameters move the flange, and where")


@rc_context(FRAMED)
def sensitivity_over_workspace(sensitivity: "Sensitivity", title: str) -> Figure:
    """The expected error of an arm as assembled, over the plane of its reach, and each parameter's share of it."""
    across, up, expected = sensitivity.over_workspace()
    figure = blank(12.0, 5.6)
    workspace_axes, share_axes = figure.subplots(1, 2, width_ratios=(1, 1.6))  # the workspace is tall
    image = workspace_axes.pcolormesh(1e3 * across, 1e3 * up, 1e3 * expected.T, cmap="cividis")
    workspace_axes.set(xlabel="distance from the base's axis (mm)", ylabel="height (mm)", aspect="equal")
    figure.colorbar(image, ax=workspace_axes, label="expected error, RMS (mm)")
    order = np.argsort(-sensitivity.share, kind="stable")[:12][::-1]
    share_axes.barh(np.arange(len(order)), 100 * sensitivity.share[order], color=AFTER)
    even = 100 / len(sensitivity.names)
    share_axes.axvline(even, color="black", linestyle="--", linewidth=1.5, label="even shares")
    share_axes.legend(frameon=False, loc="lower right", fontsize=11)
    share_axes.set_yticks(np.arange(len(order)), [sensitivity.names[i] for i in order])
    share_axes.set(xlabel="share of the mean squared error (%)")
    share_axes.spines[["top", "right"]].set_visible(False)
    return titled(figure, f"{title}: where the error of assembly is largest, and its sources")


@rc_context(STYLE)
def designed_motion(plan: "TorquePlan", title: str) -> Figure:
    """Joint positions over time; below, standard deviations: designed and random."""
    figure = blank(11.0, 8.4)
    upper, lower = figure.subplots(2, 1)
    scales, units = joint_units(plan.room.arm.sliding, plan.room.arm.dof)
    for joint, q in enumerate(np.asarray(plan.motion.q)):
        colour = OKABE_ITO[joint % len(OKABE_ITO)]
        upper.plot(plan.time, scales[joint] * q, color=colour, linewidth=2, label=f"joint {joint + 1}")
    upper.set(xlabel="time (s)", ylabel=f"position ({' or '.join(dict.fromkeys(units))})")
    upper.legend(frameon=False, ncols=2, loc="center left", bbox_to_anchor=(1.0, 0.5))
    base = plan.identification.model.base
    scale = plan.identification.model.base_scale
    random = np.array([identification.standard_deviation for identification in plan.random]) / scale
    low, middle, high = np.quantile(random, (0.05, 0.5, 0.95), axis=0, method="nearest")
    at = np.arange(len(base))
    finite = np.isfinite(high)
    lower.vlines(at[finite], low[finite], high[finite], color=BEFORE, alpha=0.4, linewidth=5)
    lower.plot(at, np.where(np.isfinite(middle), middle, np.nan), "_", color=BEFORE, label="random, median, 90 %")
    designed = plan.identification.standard_deviation / scale
    lower.plot(at, np.where(np.isfinite(designed), designed, np.nan), "o", color=AFTER, label="designed")
    lower.set_yscale("log")
    lower.set_xticks(at, [item.name for item in base], rotation=90, fontsize=8)
    lower.set_ylabel("std. deviation\n(of typical size)")
    lower.legend(frameon=False)
    return titled(figure, f"{title}: motion whose torques determine the arm")


_MOST_PAIRS = 24
"""Pairs of explanations that a figure shows, those that are least apart."""


@rc_context(STYLE)
def designed_commands(plan: "CommandPlan", title: str) -> Figure:
    """Commands over time with the kinds of their motions; below, how far apart explanations are."""
    shown = [pair for pair in plan.pairs if not pair.alike] if plan.experiment.of_findings else plan.hardest
    pairs = sorted(shown, key=lambda pair: pair.designed)[:_MOST_PAIRS]
    figure = blank(11.0, 5.0 + 0.25 * len(pairs))
    upper, lower = figure.subplots(2, 1, height_ratios=(4.0, 1.0 + 0.25 * len(pairs)))
    for joint, command in enumerate(plan.command.T):
        colour = OKABE_ITO[joint % len(OKABE_ITO)]
        upper.plot(plan.time, np.rad2deg(command), color=colour, linewidth=1.5, label=f"joint {joint + 1}")
    for kind, begin, end in plan.parts:
        upper.axvspan(begin, end, color="0.94", zorder=0)
        upper.text(
            (begin + end) / 2, 1.02, kind.replace(" ", "\n"), transform=upper.get_xaxis_transform(), ha="center",
            va="bottom", fontsize=8, color="0.35",
        )  # fmt: skip
    upper.set(xlabel="time (s)", ylabel="command (deg)", xlim=(0.0, plan.time[-1]))
    upper.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    at = np.arange(len(pairs))
    log = plan.experiment.recorded is not None
    before = [(pair.recorded or 0.0) if log else pair.compared for pair in pairs]
    lower.plot(np.maximum(before, 0.1), at, "_", color=BEFORE, markersize=9, markeredgewidth=3,
               label="log" if log else "drawn at random")  # fmt: skip
    lower.plot(np.maximum([pair.designed for pair in pairs], 0.1), at, "o", color=AFTER, label="designed")
    lower.axvline(5.0, color="0.6", linewidth=1, linestyle="--")
    names = [(pair.effect.label, pair.rival.label) for pair in pairs]
    lower.set_yticks(at, [" or ".join(label.replace("_", " ").replace(":", " ") for label in pair) for pair in names])
    lower.tick_params(axis="y", labelsize=8)
    lower.set(xscale="log", xlabel="standard deviations apart; distinguished from 5 on")
    lower.invert_yaxis()
    lower.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return titled(figure, f"{title}: commands that tell effects apart")
