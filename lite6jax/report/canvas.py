"""The common style of figures: size, fonts and colours, and atomic writing as PNG and SVG without a display."""

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

_MOST_POINTS = 2000


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
    return [
        storage.write_atomically(Path(folder, f"{name}{suffix}"), partial(_draw, figure, suffix[1:]), overwrite)
        for name, figure in figures.items()
        for suffix in SUFFIXES
    ]


def _draw(figure: Figure, kind: str, target: Path) -> None:
    with rc_context(STYLE):
        figure.savefig(target, format=kind, dpi=120, metadata={"Date": None} if kind == "svg" else {"Software": None})


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


def thinned(count: int) -> NDArray[np.int64]:
    """Indices of the points to draw of `count`: evenly spaced, at most `_MOST_POINTS`."""
    return np.unique(np.linspace(0, max(count - 1, 0), min(count, _MOST_POINTS)).astype(int))
