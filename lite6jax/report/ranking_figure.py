"""The figure of what each finding moves: a bar each, the largest above."""

import textwrap
from collections.abc import Mapping
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from lite6jax.report import statements, torque_statements, worth
from lite6jax.report.canvas import AFTER, STYLE, blank

_MOST = 20
"""Findings that are drawn."""


def ranking_figure(document: Mapping[str, Any], title: str) -> Figure:
    """What each finding moves, beside the error before and after.

    Args:
        document: of poses or of torques, with findings.
        title: of the figure.
    """
    measures, named = worth.measures_of(document), torque_statements if worth.of_torques(document) else statements
    findings, shown = named.findings_of(document)[:_MOST], worth.bars(document)[:_MOST]
    if len(measures) == 1:
        sizes = [measures[0].scale * finding[measures[0].moves] for finding in findings]
        label = f"moves {measures[0].what} ({measures[0].unit} RMS)"
    else:
        sizes = [bar.share for bar in shown]
        label = f"moves {' or '.join(measure.what for measure in measures)} (RMS over the error before, largest: 1)"
    names = [f"{k}. {textwrap.fill(finding['title'], 44)}" for k, finding in enumerate(findings, 1)]
    with rc_context(STYLE):
        figure = blank(9.0, 1.7 + 0.42 * len(findings))
        panel = figure.subplots()
        bars = panel.barh(range(len(findings)), sizes, color=AFTER, zorder=3)
        panel.bar_label(bars, [bar.size for bar in shown], padding=4)
        panel.set_yticks(range(len(findings)), names)
        panel.invert_yaxis()
        panel.set_xlim(0, 1.15 * max(sizes) or 1.0)
        panel.set_xlabel(label)
        panel.grid(visible=False, axis="y")
        figure.suptitle(f"{title}: what each finding moves", fontsize=15)
    return figure
