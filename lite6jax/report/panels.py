"""Panels in rows with a common legend, samples as dots, and binned medians, for the figures of fits and diagnoses."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lite6jax.report.canvas import blank, thinned

Array = NDArray[np.floating]

GREY = "#8a8a8a"
BINS = 20
_LEAST_IN_BIN = 5
_WIDE = ((1, (1, 7.5, 4.2)), (6, (2, 6.0, 4.2)), (15, (3, 5.0, 3.6)), (np.inf, (4, 4.6, 3.2)))
"""Layouts by the largest number of panels: the number of columns, and the width and height of a panel in inches."""
_SEPARATE, _CROWDED = 50, 1000
"""Numbers of samples up to which dots are as large and opaque as they get, and from which they are smallest."""


def dots(panel: Axes, x: Array, y: Array, color: str, zorder: float = 2) -> None:
    """Draws samples `(sample,)` as dots, evenly thinned where there are many; the fewer, the larger and more opaque."""
    crowded = np.log(max(len(x), 1) / _SEPARATE) / np.log(_CROWDED / _SEPARATE)
    few = 1 - float(np.clip(crowded, 0, 1))
    shown = thinned(len(x))
    panel.plot(
        x[shown], y[shown], ".", color=color, markersize=5 + 5 * few, alpha=0.35 + 0.45 * few, markeredgewidth=0,
        rasterized=True, zorder=zorder,
    )  # fmt: skip


def medians(x: Array, y: Array, count: int = BINS, share: float = 0.0) -> tuple[Array, Array, Array]:
    """Centres of bins of equal width, medians and their standard errors; NaN where a bin has too few samples.

    Args:
        x: `(sample,)`, which is binned.
        y: `(sample,)`.
        count: the number of bins.
        share: of the samples that an even distribution would have, what a bin has at least beside `_LEAST_IN_BIN`.
    """
    if not len(x):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    edges = np.linspace(x.min(), max(x.max(), x.min() + 1e-9), count + 1)
    at = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, count - 1)
    middle, error = np.full(count, np.nan), np.full(count, np.nan)
    for k in range(count):
        inside = y[at == k]
        if len(inside) >= max(_LEAST_IN_BIN, share * len(x) / count):
            middle[k] = np.median(inside)
            deviation = 1.4826 * np.median(np.abs(inside - middle[k]))
            error[k] = np.sqrt(np.pi / 2 / len(inside)) * deviation  # the standard error of a median of normal noise
    return (edges[1:] + edges[:-1]) / 2, middle, error


def panels_in_rows(count: int, shared: bool = False, wide: bool = False) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels in rows.

    Args:
        count: the number of panels.
        shared: whether the panels share their vertical axis.
        wide: whether panels are wide, as for curves; their size decreases with their number.
    """
    columns = min(count, 4 if count > 6 else 3)
    width, height = 3.0 + 3.0 / columns, 3.2
    if wide:
        columns, width, height = next(layout for most, layout in _WIDE if count <= most)
    rows = -(-count // columns)
    figure = blank(width * columns, height * rows + 1.0)
    panels = figure.subplots(rows, columns, sharey=shared, squeeze=False).ravel()
    for panel in panels[count:]:
        panel.set_visible(False)
    return figure, list(panels[:count])


def label_first_column(panel: Axes, label: str) -> None:
    """Labels the vertical axis of the first column, whose scale the others share."""
    if panel.get_subplotspec().is_first_col():  # type: ignore[union-attr]
        panel.set_ylabel(label)


def legend_below(figure: Figure, panel: Axes, columns: int) -> None:
    """A legend below all panels, with the entries of one of them."""
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
