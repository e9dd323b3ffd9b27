"""Figures of a diagnosis of torques: errors before and after by joint, torques over time, friction, findings."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, StrMethodFormatter

from lite6jax.diagnosis import evidence_map
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.report.canvas import AFTER, BEFORE, STYLE, blank
from lite6jax.report.cells import joint_units, torque_units
from lite6jax.report.finding_figures import torque_finding_figure
from lite6jax.report.panels import GREY, dots, legend_below, panels_in_rows

NAMES = ("error_by_joint", "over_time", "friction", "spectra", "findings")
"""The figures that `drawings` may give."""

_WIDTH = 0.38
"""Of a bar, over the distance of two joints."""
_LOWEST = 1e-4
"""Nm, the shortest bar."""


def drawings(found: TorqueDiagnosis, title: str, order: Sequence[int] | None = None) -> Iterator[tuple[str, Figure]]:
    """The figures by name, of `NAMES`; there is none of findings, or of spectra of postures, where there are none.

    Args:
        found: the diagnosis.
        title: of each figure.
        order: places of the findings, from 0, in which they are numbered; theirs where not given.
    """
    yield "error_by_joint", error_by_joint(found, title)
    yield "over_time", over_time(found, title)
    yield "friction", friction(found, title)
    if (shown := evidence_map.spectra(found)) is not None:
        yield "spectra", spectra(found, shown, title)
    if found.findings:
        yield "findings", torque_finding_figure(found, title, order=order)


def error_by_joint(found: TorqueDiagnosis, title: str) -> Figure:
    """Held-out errors of each joint, before and after, beside the standard deviation of what was measured."""
    kept = found.problem.valid
    spread = np.maximum(np.std(found.problem.measured[:, kept], axis=1), _LOWEST)
    at = np.arange(1, len(spread) + 1)
    with rc_context(STYLE):
        figure = blank(4.0 + 1.5 * len(at), 5.4)
        panel = figure.subplots()
        lowest = float(spread.min())
        for side, (name, colour, errors) in enumerate(
            (("before", BEFORE, found.before), ("after", AFTER, found.after))
        ):
            rms = np.maximum(np.sqrt(np.mean(errors[:, kept] ** 2, 1)), _LOWEST)
            lowest = min(lowest, float(rms.min()))
            bars = panel.bar(at + (side - 0.5) * _WIDTH, rms, _WIDTH, color=colour, label=f"{name}, held out", zorder=3)
            panel.bar_label(bars, [f"{value:.2g}" for value in rms], padding=2, fontsize=12)
        label = "standard deviation of the measured torque"
        panel.hlines(spread, at - 0.45, at + 0.45, color="black", linestyle="--", linewidth=2, label=label, zorder=4)
        panel.set_yscale("log")
        panel.set_ylim(0.4 * lowest, 2.5 * max(panel.get_ylim()[1] / 2.5, spread.max()))
        panel.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        exerted = _exerted(found)
        both = sorted({unit for _, unit in exerted}, reverse=True)  # Nm before N
        panel.set(xlabel="joint", ylabel=f"torque error ({' or '.join(both)} RMS)", xticks=at)
        if len(both) > 1:
            panel.set_xticks(at, [f"{joint} ({unit})" for joint, (_, unit) in enumerate(exerted, 1)])
        panel.grid(visible=False, axis="x")
        legend_below(figure, panel, 3)
        figure.suptitle(f"{title}: held-out torque error of each joint", fontsize=15)
    return figure


def over_time(found: TorqueDiagnosis, title: str) -> Figure:
    """Measured, rigid-body and modelled torques of each joint over a part of the recording."""
    shown, exerted = evidence_map.torques_over_time(found), _exerted(found)
    lines = (
        ("measured", shown.measured, {"color": "black", "linewidth": 3.5, "alpha": 0.35}),
        ("rigid body", shown.rigid, {"color": BEFORE, "linewidth": 1.6, "linestyle": "--"}),
        ("modelled, with the findings", shown.modelled, {"color": AFTER, "linewidth": 1.6}),
    )
    with rc_context(STYLE):
        figure, panels = panels_in_rows(len(shown.measured), wide=True)
        for j, panel in enumerate(panels):
            for name, torque, style in lines:
                panel.plot(shown.time, torque[j], label=name, **style)  # type: ignore[arg-type]
            what, unit = exerted[j]
            panel.set(xlabel="time (s)", ylabel=f"{what} of joint {j + 1} ({unit})")
            panel.xaxis.set_major_locator(MaxNLocator(5))
        legend_below(figure, panels[0], 3)
        figure.suptitle(f"{title}: measured and modelled torques", fontsize=15)
    return figure


def friction(found: TorqueDiagnosis, title: str) -> Figure:
    """The torque that the model without friction leaves at each joint over its velocity, and the friction found."""
    joints, exerted = evidence_map.joint_frictions(found), _exerted(found)
    scales, angles = joint_units(found.problem.data.arm.sliding, len(joints))
    with rc_context(STYLE):
        figure, panels = panels_in_rows(len(joints), wide=True)
        for j, (panel, joint) in enumerate(zip(panels, joints, strict=True)):
            _draw_friction(panel, joint, scales[j])
            what, unit = exerted[j]
            panel.set(
                xlabel=f"velocity of joint {j + 1} ({angles[j]}/s)", ylabel=f"{what} left at joint {j + 1} ({unit})"
            )
            panel.xaxis.set_major_locator(MaxNLocator(5))
        panels[0].plot([], [], ".", color=GREY, markersize=8, label="measured, less the model without friction")
        panels[0].plot([], [], color=AFTER, linewidth=2.5, label="friction found, at the median load")
        legend_below(figure, panels[0], 2)
        figure.suptitle(f"{title}: friction", fontsize=15)
    return figure


def spectra(found: TorqueDiagnosis, shown: evidence_map.Spectra, title: str) -> Figure:
    """Spectra of the recorded velocities and torques of each joint, and where the low passes cut them."""
    data = found.problem.data
    parts = (
        (
            "velocity",
            "(rad/s)²/Hz" if not data.arm.sliding else "(rad/s or m/s)²/Hz",
            shown.velocity,
            data.motion_cutoff,
        ),
        ("torque", "Nm²/Hz" if not data.arm.sliding else "Nm²/Hz or N²/Hz", shown.torque, data.filter.cutoff),
    )
    with rc_context(STYLE):
        figure, panels = panels_in_rows(len(parts), wide=True)
        for panel, (name, unit, power, cutoff) in zip(panels, parts, strict=True):
            for joint, row in enumerate(power, 1):
                panel.plot(shown.frequency, np.maximum(row, 1e-300), linewidth=1.2, label=f"joint {joint}")
            panel.axvline(cutoff, color="black", linestyle="--", linewidth=1.6, label="cutoff of the low pass")
            largest = float(power.max(initial=1e-12))
            panel.set(xscale="log", yscale="log", xlabel="frequency (Hz)", ylabel=f"power of the {name} ({unit})")
            panel.set_ylim(max(float(power.min(initial=largest)), 1e-9 * largest) / 2, 3 * largest)
            panel.set_title(f"{name}: {cutoff:.3g} Hz", fontsize=13)
        legend_below(figure, panels[0], 4)
        figure.suptitle(f"{title}: spectra, and what the low passes leave", fontsize=15)
    return figure


def _exerted(found: TorqueDiagnosis) -> list[tuple[str, str]]:
    """Of each joint what its motor exerts, and the unit."""
    units = torque_units(found.problem.data.arm.sliding, found.problem.rows)
    return [("force" if unit == "N" else "torque", unit) for unit in units]


def _draw_friction(panel: Axes, joint: evidence_map.JointFriction, scale: float) -> None:
    dots(panel, scale * joint.velocity, joint.partial, GREY)
    panel.axhline(0, color="black", linewidth=1)
    if len(joint.at):
        panel.plot(scale * joint.at, joint.friction, color=AFTER, linewidth=2.5, zorder=4)
    else:
        text = {"ha": "center", "va": "top", "color": "#5c5c5c", "transform": panel.transAxes}
        panel.margins(y=0.15)
        panel.text(0.5, 0.99, "no friction over velocity found", **text)  # type: ignore[arg-type]
