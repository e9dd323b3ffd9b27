"""The common style of figures, what their panels share, and atomic writing as PNG and SVG without a display."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.errors import InputError
from lite6jax.report.words import joint_units

Array = NDArray[np.floating]

# M. Okabe, K. Ito, Color Universal Design, 2002: distinguishable with colour blindness and in grey
BEFORE, AFTER = "#D55E00", "#0072B2"
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
_SEPARATE, _CROWDED = 50, 1000
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
    for name in names:
        for suffix in SUFFIXES:
            storage.check_writable(folder / f"{name}{suffix}", overwrite)


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


def label_joint(panel: Axes, joint: int, unit: str) -> None:
    """Names the horizontal axis after a joint counted from 0, in deg with round angles or in mm."""
    panel.set_xlabel(f"joint {joint + 1} ({unit})")
    panel.xaxis.set_major_locator(degree_ticks(panel) if unit == "deg" else MaxNLocator(5))


# ------------------------------------------------------------------ panels


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


def titled(figure: Figure, title: str) -> Figure:
    """The figure with its title above all panels."""
    figure.suptitle(title, fontsize=15)
    return figure


def label_first_column(panel: Axes, label: str) -> None:
    """Labels the vertical axis of the first column, whose scale the others share."""
    if panel.get_subplotspec().is_first_col():  # type: ignore[union-attr]
        panel.set_ylabel(label)


def legend_below(figure: Figure, panel: Axes, columns: int) -> None:
    """A legend below all panels, with the entries of one of them."""
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)


def dots(panel: Axes, x: Array, y: Array, color: str, zorder: float = 2) -> None:
    """Draws samples `(sample,)` as dots, evenly thinned where there are many; the fewer, the larger and more opaque."""
    crowded = np.log(max(len(x), 1) / _SEPARATE) / np.log(_CROWDED / _SEPARATE)
    few = 1 - float(np.clip(crowded, 0, 1))
    shown = np.unique(np.linspace(0, max(len(x) - 1, 0), min(len(x), _MOST_POINTS)).astype(int))
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


@rc_context(STYLE)
def errors_over_joints(
    stages: Sequence[tuple[Array, Array, str]], sliding: Sequence[int], title: str, share: float = 0.0
) -> Figure:
    """Position errors against each joint, before and after; lines are medians, where samples are enough.

    Args:
        stages: positions of the joints `(sample, joint)`, errors `(sample,)` m, and the label of each.
        sliding: the prismatic joints, from 0.
        title: of the figure.
        share: as of `medians`.
    """
    joints = stages[0][0].shape[1]
    scales, units = joint_units(sliding, joints)
    figure, panels = panels_in_rows(joints, shared=True)
    styles, line = list(zip(stages, (BEFORE, AFTER), (2, 3), strict=True)), False
    for joint, panel in enumerate(panels):
        for (q, errors, _), colour, zorder in styles:
            dots(panel, scales[joint] * q[:, joint], 1e3 * errors, colour, zorder)
            at, middle, _ = medians(scales[joint] * q[:, joint], 1e3 * errors, share=share)
            panel.plot(at, middle, color=colour, linewidth=2.5, zorder=5, clip_on=False)
            line |= bool(np.isfinite(middle).any())
        label_joint(panel, joint, units[joint])
        label_first_column(panel, "position error (mm)")
    tops = [1e3 * float(np.percentile(errors, 99.5)) for _, errors, _ in stages if len(errors)]
    panels[0].set_ylim(0, 1.1 * max(tops, default=1.0) or 1.0)
    for (_, _, label), colour, _ in styles:
        panels[0].plot([], [], "-o" if line else "o", color=colour, linewidth=2.5, label=label)
    legend_below(figure, panels[0], 2)
    return titled(figure, title)
