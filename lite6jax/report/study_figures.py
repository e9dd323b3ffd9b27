"""Figures of a study of an arm: what poses determine, which parameters matter where, how designs compare."""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lite6jax.design.identify import Identification
from lite6jax.design.poses import DiscriminationPlan, Plan
from lite6jax.design.sensitivity import Sensitivity
from lite6jax.design.torques import TorqueDiscrimination, TorquePlan
from lite6jax.report.canvas import AFTER, BEFORE, FRAMED, MARKERS, OKABE_ITO, STYLE, blank, label_joint
from lite6jax.report.cells import SCREEN, joint_units

Array = NDArray[np.floating]

_ROUNDING = 1e-16
_MOST_CURVES = 5


def singular_values(found: Identification, title: str) -> Figure:
    """Singular values of the scaled Jacobian, falling, with the line under which nothing is determined."""
    d = found.determination
    values = np.maximum(d.singular_values, _ROUNDING * d.singular_values[0])
    at = np.arange(1, d.size + 1)
    with rc_context(STYLE):
        figure = blank(9.0, 5.2)
        panel = figure.subplots()
        panel.axhline(1, color="black", linewidth=1, linestyle="--")
        panel.text(d.size + 0.6, 1, " noise as large\n as a tolerance", va="center", fontsize=11)
        determined = at <= d.rank
        panel.plot(at[determined], values[determined], "o", color=AFTER, markersize=8, label=f"determined: {d.rank}")
        if not determined.all():
            rounding = values[~determined]
            panel.plot(at[~determined], rounding, "X", color=BEFORE, markersize=9, label=f"rounding: {len(rounding)}")
        panel.set_yscale("log")
        panel.set(
            xlabel="direction of the parameters, best determined first",
            ylabel="singular value\n(standard deviations per tolerance)",
            xlim=(0.2, d.size + 0.8),
        )
        panel.legend(loc="best", frameon=False)
        figure.suptitle(f"{title}: {d.rank} of {d.size} determined by {d.samples} poses", fontsize=15)
    return figure


def correlation(found: Identification, title: str) -> Figure:
    """The correlations of the estimates, without those of parameters that are held."""
    d = found.determination
    free = np.flatnonzero(d.free)
    names = [d.names[i] for i in free]
    with rc_context(FRAMED):
        side = max(6.5, 0.26 * len(free) + 2.5)
        figure = blank(side + 1.2, side)
        panel = figure.subplots()
        image = panel.imshow(d.correlation[np.ix_(free, free)], cmap="PuOr", vmin=-1, vmax=1)
        panel.set_xticks(range(len(free)), names, rotation=90, fontsize=10)
        panel.set_yticks(range(len(free)), names, fontsize=10)
        held = d.size - len(free)
        figure.colorbar(image, label="correlation of the estimates", shrink=0.8)
        rest = f" ({held} held, not shown)" if held else ""
        figure.suptitle(f"{title}: correlations of the estimates{rest}", fontsize=15)
    return figure


def deviations(found: Identification, title: str) -> Figure:
    """The predicted standard deviation of each parameter against its tolerance: lengths, angles, then effects."""
    d = found.determination
    effect = np.array([":" in name for name in d.names])
    units = np.array(d.units)
    groups = [
        ("std. deviation (mm)", SCREEN["m"][0], (units == "m") & ~effect),
        ("std. deviation (deg)", SCREEN["rad"][0], (units == "rad") & ~effect),
        ("std. deviation\n(of typical size)", 1.0, effect),
    ]
    groups = [group for group in groups if group[2].any()]
    with rc_context(STYLE):
        figure = blank(12.0, 3.6 * len(groups) + 0.8)
        for panel, (label, scale, chosen) in zip(
            figure.subplots(len(groups), 1, squeeze=False).ravel(), groups, strict=True
        ):
            size = d.scale[chosen]
            values = scale * (
                d.standard_deviation[chosen] / size if effect[chosen].all() else d.standard_deviation[chosen]
            )
            tolerance = 1.0 if effect[chosen].all() else float(scale * size[0])
            free, at = d.free[chosen], np.arange(len(size))
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
            panel.set_ylabel(label)
            panel.grid(axis="x", visible=False)
        handles = [
            Line2D([], [], color=AFTER, linewidth=8, label="predicted"),
            Line2D([], [], color="black", linestyle="--", label="tolerance of assembly"),
        ]
        if not d.free.all():
            handles.append(Line2D([], [], color=BEFORE, marker="X", linestyle="", markersize=9, label="held"))
        figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
        figure.suptitle(f"{title}: how well {d.samples} poses determine each parameter", fontsize=15)
    return figure


def accuracy_by_count(found: Plan | DiscriminationPlan, title: str) -> Figure:
    """Accuracy, or distance between two models, against the number of poses: designed and drawn at random."""
    planned = isinstance(found, Plan)
    with rc_context(STYLE):
        figure = blank(9.0, 5.4)
        panel = figure.subplots()
        if planned:
            shown = slice(0, min(2 * found.count, found.random_accuracy.shape[1]))
            random = 1e3 * found.random_accuracy[:, shown]
            low, middle, high = np.quantile(random, (0.05, 0.5, 0.95), axis=0, method="nearest")
            at = np.arange(1, len(middle) + 1)
            there = np.isfinite(middle)
            high = np.where(
                np.isfinite(high), high, middle[there].max()
            )  # infinite for draws that do not determine all parameters
            panel.fill_between(at[there], low[there], high[there], color=BEFORE, alpha=0.2, linewidth=0)
            panel.plot(at[there], middle[there], "--", color=BEFORE, linewidth=2.5, label="random, median and 90 %")
            designed = 1e3 * found.accuracy
            panel.set_yscale("log")
            label = "predicted positions over the workspace\n(mm, one std. deviation)"
        else:
            designed = found.distance
            low, middle, high = np.quantile(found.random_distance, (0.05, 0.5, 0.95))
            panel.errorbar(
                [found.count], [middle], [[middle - low], [high - middle]], fmt="s", color=BEFORE, capsize=5,
                markersize=8, label="random, median and 90 %",
            )  # fmt: skip
            label = "distance between the models\n(standard deviations)"
        count = np.arange(1, found.count + 1)
        determined = np.isfinite(designed)
        panel.plot(count[determined], designed[determined], "-", color=AFTER, linewidth=2.5)
        panel.plot(count[-1], designed[-1], "o", color=AFTER, markersize=9)
        panel.plot([], [], "-o", color=AFTER, linewidth=2.5, label="designed")
        panel.set(xlabel="poses", ylabel=label)
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        panel.legend(frameon=False)
        what = f"{found.count} poses"
        if not planned:
            what += f" to discriminate between {found.rivals[0]} and {found.rivals[1]}"
        figure.suptitle(f"{title}: {what}", fontsize=15)
    return figure


def sensitivity_by_joint(found: Sensitivity, title: str) -> Figure:
    """How far the flange moves per tolerance of the parameters that matter most, over each joint."""
    middles, means = found.by_joint()
    joints = len(middles)
    scales, units = joint_units(found.sliding, joints)
    # those whose share depends on where the arm is: what moves the flange alike everywhere is a straight line
    varies = np.nanmax(means, (0, 1))
    order = np.argsort(-varies, kind="stable")[:_MOST_CURVES]
    columns = 4 if joints > 6 else 3
    rows = -(-joints // columns)
    with rc_context(STYLE):
        figure = blank(3.0 + 3.0 * columns, 3.2 * rows + 1.0)
        panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
        for j, panel in enumerate(panels[:joints]):
            for k, (i, colour, marker) in enumerate(zip(order, OKABE_ITO, MARKERS, strict=False)):
                panel.plot(
                    scales[j] * middles[j], 1e3 * means[j, :, i], color=colour, linewidth=2.2, marker=marker,
                    markevery=(k, 6), markersize=6, label=found.names[i],
                )  # fmt: skip
            label_joint(panel, j, units[j])
            if j % columns == 0:
                panel.set_ylabel("flange moves (mm)\nper tolerance")
        panels[0].set_ylim(bottom=0)
        for panel in panels[joints:]:
            panel.set_visible(False)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=_MOST_CURVES, frameon=False)
        figure.suptitle(f"{title}: which parameters move the flange, and where", fontsize=15)
    return figure


def sensitivity_over_workspace(found: Sensitivity, title: str) -> Figure:
    """The expected error of an arm as assembled, over the plane of its reach, and each parameter's share of it."""
    across, up, expected = found.over_workspace()
    with rc_context(FRAMED):
        figure = blank(12.0, 5.6)
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.15))
        image = left.pcolormesh(1e3 * across, 1e3 * up, 1e3 * expected.T, cmap="cividis")
        left.set(xlabel="distance from the base's axis (mm)", ylabel="height (mm)", aspect="equal")
        figure.colorbar(image, ax=left, label="expected error, RMS (mm)")
        order = np.argsort(-found.share, kind="stable")[:12][::-1]
        right.barh(np.arange(len(order)), 100 * found.share[order], color=AFTER)
        right.axvline(100 / len(found.names), color="black", linestyle="--", linewidth=1.5)
        right.text(100 / len(found.names), len(order) - 0.4, "even shares", fontsize=11, ha="center", va="bottom")
        right.set_yticks(np.arange(len(order)), [found.names[i] for i in order])
        right.set(xlabel="share of the mean squared error (%)")
        for side in ("top", "right"):
            right.spines[side].set_visible(False)
        figure.suptitle(f"{title}: where the error of assembly is largest, and its sources", fontsize=15)
    return figure


def designed_motion(found: TorquePlan | TorqueDiscrimination, title: str) -> Figure:
    """Joint positions over time; below, standard deviations or distances: designed and random."""
    made = found.trajectory
    with rc_context(STYLE):
        figure = blank(11.0, 8.4)
        upper, lower = figure.subplots(2, 1)
        scales, units = joint_units(found.room.arm.sliding, found.room.arm.dof)
        for joint, q in enumerate(np.asarray(made.motion.q)):
            upper.plot(
                made.time,
                scales[joint] * q,
                color=OKABE_ITO[joint % len(OKABE_ITO)],
                linewidth=2,
                label=f"joint {joint + 1}",
            )
        upper.set(xlabel="time (s)", ylabel=f"position ({' or '.join(dict.fromkeys(units))})")
        upper.legend(frameon=False, ncols=2, loc="center left", bbox_to_anchor=(1.0, 0.5))
        if isinstance(found, TorquePlan):
            base = found.identification.structure.base
            scale = np.array([item.scale for item in base])
            random = np.array([other.standard_deviation for other in found.random]) / scale
            low, middle, high = np.quantile(random, (0.05, 0.5, 0.95), axis=0, method="nearest")
            at = np.arange(len(base))
            there = np.isfinite(high)
            lower.vlines(at[there], low[there], high[there], color=BEFORE, alpha=0.4, linewidth=5)
            lower.plot(
                at, np.where(np.isfinite(middle), middle, np.nan), "_", color=BEFORE, label="random, median, 90 %"
            )
            designed = found.identification.standard_deviation / scale
            lower.plot(at, np.where(np.isfinite(designed), designed, np.nan), "o", color=AFTER, label="designed")
            lower.set_yscale("log")
            lower.set_xticks(at, [item.name for item in base], rotation=90, fontsize=8)
            lower.set_ylabel("std. deviation\n(of typical size)")
            what = "motion whose torques determine the arm"
        else:
            lower.hist(found.random_distance, bins=20, color=BEFORE, alpha=0.6, label="random")
            lower.axvline(found.distance, color=AFTER, linewidth=3, label="designed")
            lower.set(xlabel="distance between the models (standard deviations)", ylabel="motions")
            what = f"motion to discriminate between {found.rivals[0]} and {found.rivals[1]}"
        lower.legend(frameon=False)
        figure.suptitle(f"{title}: {what}", fontsize=15)
    return figure
