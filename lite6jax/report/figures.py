"""Figures of a fit, of a comparison, and of a verification by a controller."""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from lite6jax.controller.verification import GATE_M, Verification
from lite6jax.fitting.fleet import Comparison
from lite6jax.fitting.solution import Errors, Solution
from lite6jax.recordings import Recording
from lite6jax.report.canvas import AFTER, BEFORE, FRAMED, MARKERS, OKABE_ITO, STYLE, blank, degree_ticks, label_joint
from lite6jax.report.cells import joint_units
from lite6jax.report.panels import dots, label_first_column, medians, panels_in_rows

_MOST_NAMED = 12


def error_by_joint(solution: Solution, title: str) -> Figure:
    """Position error against each joint, with medians: of the nominal arm, and of the fitted one on other samples."""
    before, after = solution.nominal_errors, solution.checked
    joints = after.joint_position.shape[1]
    scales, units = joint_units(solution.arm.sliding, joints)
    with rc_context(STYLE):
        figure, panels = panels_in_rows(joints, shared=True)
        for joint, panel in enumerate(panels):
            for errors, colour, zorder in ((before, BEFORE, 2), (after, AFTER, 3)):
                position, millimetres = scales[joint] * errors.joint_position[:, joint], 1e3 * errors.position
                dots(panel, position, millimetres, colour, zorder)
                at, middle, _ = medians(position, millimetres)
                panel.plot(at, middle, color=colour, linewidth=2.5, zorder=5, clip_on=False)
            label_joint(panel, joint, units[joint])
            label_first_column(panel, "position error (mm)")
        panels[0].set_ylim(0, _upper(before, after))
        figure.suptitle(title, fontsize=15)
        _legend(figure, before, after, "on held-out blocks" if solution.noise else "on fresh samples")
    return figure


def error_distribution(solution: Solution, recording: Recording, title: str) -> Figure:
    """The distribution of the position errors, and the errors along the recording."""
    before, after = solution.nominal_errors, solution.checked
    with rc_context(STYLE):
        figure = blank(12.0, 4.6)
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.6))
        top = _upper(before, after)
        bins = np.linspace(0, top, 41)
        for errors, colour in ((before, BEFORE), (after, AFTER)):
            millimetres = np.minimum(1e3 * errors.position, top)  # larger errors are counted in the last bin
            left.hist(millimetres, bins, color=colour, alpha=0.45)
            left.hist(millimetres, bins, color=colour, histtype="step", linewidth=2)
            dots(right, recording.row, 1e3 * errors.position, colour)
        left.set(xlabel="position error (mm)", ylabel="samples", xlim=(0, top))
        right.set(xlabel="row of the recording", ylabel="position error (mm)")
        right.set_ylim(bottom=0)
        figure.suptitle(title, fontsize=15)
        _legend(figure, before, after, "on held-out blocks")
    return figure


def parameter_differences(comparison: Comparison) -> Figure:
    """The difference of each arm's parameters from nominal: lengths in the upper panel, angles in the lower."""
    form = comparison.arm.form
    units = np.array(form.units)
    count = len(comparison.names)
    with rc_context(STYLE):
        figure = blank(12.0, 8.4)
        for panel, unit, label, scale in zip(
            figure.subplots(2, 1),
            ("m", "rad"),
            ("difference (mm)", "difference (deg)"),
            (1e3, 180 / np.pi),
            strict=True,
        ):
            chosen = np.flatnonzero(units == unit)
            values = scale * comparison.difference[:, chosen]
            for k in range(count):
                spread = 0.5 * ((k + 0.5) / count - 0.5)
                name, colour, marker = None, "#0072B2", "o"
                if count <= len(OKABE_ITO):
                    name, colour, marker = _short(comparison.names[k], k), OKABE_ITO[k], MARKERS[k]
                panel.plot(
                    np.arange(len(chosen)) + spread, values[k], marker, color=colour, label=name,
                    markersize=6, alpha=0.85 if name else 0.5, markeredgewidth=0,
                )  # fmt: skip
            panel.axhline(0, color="black", linewidth=1)
            panel.set_xticks(np.arange(len(chosen)), [form.names[i] for i in chosen], rotation=45, ha="right")
            panel.set_ylabel(label)
            panel.set_xlim(-0.6, len(chosen) - 0.4)
        figure.suptitle(f"{count} × {comparison.arm.name}: parameters minus nominal", fontsize=15)
        handles, labels = figure.axes[0].get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    return figure


def distance_between(comparison: Comparison) -> Figure:
    """The largest distance between the flanges of each two arms, and of each from nominal."""
    count = len(comparison.names)
    table = np.zeros((count + 1, count + 1))
    table[1:, 1:] = 1e3 * comparison.between
    table[0, 1:] = table[1:, 0] = 1e3 * comparison.from_nominal.max(1)
    named = count <= _MOST_NAMED
    labels = ["nominal", *(_short(name, k) for k, name in enumerate(comparison.names))]
    with rc_context(FRAMED):
        figure = blank(9.5, 6.5)
        panel = figure.subplots()
        image = panel.imshow(table, cmap="cividis", vmin=0)
        if named:
            for i, j in np.ndindex(table.shape):
                light = table[i, j] > 0.6 * table.max()
                if i != j:
                    panel.text(
                        j, i, f"{table[i, j]:.2f}", ha="center", va="center", color="black" if light else "white"
                    )
            panel.set_xticks(range(count + 1), ["nominal", *map(str, range(1, count + 1))])
            panel.set_yticks(range(count + 1), labels)
        else:
            panel.set(xlabel="arm (0: nominal)", ylabel="arm (0: nominal)")
        figure.colorbar(image, label="largest distance of the flanges (mm)")
        figure.suptitle(f"{count} × {comparison.arm.name}: largest distance", fontsize=15)
    return figure


def _legend(figure: Figure, before: Errors, after: Errors, where: str) -> None:
    panel = figure.axes[0]
    for name, errors, colour in (("nominal", before, BEFORE), (f"fitted, {where}", after, AFTER)):
        rms, most = 1e3 * errors.position_rms, 1e3 * float(errors.position.max())
        label = f"{name}: {_figures(rms)} mm RMS, {_figures(most)} mm at most"
        panel.plot([], [], "-o", color=colour, linewidth=2.5, label=label)
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)


def _figures(value: float) -> str:
    return f"{value:.1e}" if 0 < value < 1e-3 else f"{value:#.3g}"


def _upper(*found: Errors) -> float:
    """The upper end of an axis in mm, above the 99.5th percentile of the errors."""
    return 1.1 * max(1e3 * float(np.percentile(errors.position, 99.5)) for errors in found) or 1.0


def _short(name: str, k: int) -> str:
    return f"{k + 1} {name if len(name) <= 28 else name[:27] + '…'}"


def verification_figure(verification: Verification, title: str) -> Figure:
    """The position difference from the controller against each joint, in nm, µm or mm."""
    q, position = verification.joint_position, verification.position
    joints = q.shape[1]
    most = float(position.max())
    scale, unit = (1e9, "nm") if most < 1e-6 else (1e6, "µm") if most < 1e-3 else (1e3, "mm")
    with rc_context(STYLE):
        figure, panels = panels_in_rows(joints, shared=True)
        for joint, panel in enumerate(panels):
            dots(panel, np.rad2deg(q[:, joint]), scale * position, AFTER)
            if 2 * most > GATE_M:
                panel.axhline(scale * GATE_M, color="black", linewidth=1.5)
            panel.set_xlabel(f"joint {joint + 1} (deg)")
            panel.xaxis.set_major_locator(degree_ticks(panel))
            label_first_column(panel, f"difference ({unit})")
        panels[0].set_ylim(0, 1.08 * scale * most or 1.0)
        figure.suptitle(f"{title}: controller's forward kinematics against the calibration", fontsize=15)
    return figure
