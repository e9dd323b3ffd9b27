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
    measure, named = worth.measure_of(document), torque_statements if worth.of_torques(document) else statements
    findings = named.findings_of(document)[:_MOST]
    sizes = [measure.scale * finding[measure.moves] for finding in findings]
    names = [f"{k}. {textwrap.fill(finding['title'], 44)}" for k, finding in enumerate(findings, 1)]
    with rc_context(STYLE):
        figure = blank(9.0, 1.7 + 0.42 * len(findings))
        panel = figure.subplots()
        bars = panel.barh(range(len(findings)), sizes, color=AFTER, zorder=3)
        panel.bar_label(bars, [bar.size for bar in worth.bars(document)[:_MOST]], padding=4)
        panel.set_yticks(range(len(findings)), names)
        panel.invert_yaxis()
        panel.set_xlim(0, 1.15 * max(sizes) or 1.0)
        panel.set_xlabel(f"moves {measure.what} ({measure.unit} RMS)")
        panel.grid(visible=False, axis="y")
        figure.suptitle(f"{title}: what each finding moves", fontsize=15)
    return figure
