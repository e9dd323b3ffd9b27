"""Pictures of a figure in few bytes, and whether two show the same data, whatever the font in which they are labelled.

A font moves the panels of a figure and changes their size, so that pictures are compared panel by panel, each scaled to
one grid. A panel is what a left and a bottom axis enclose; a picture without axes is one panel. Letters and grid lines
are left out, and what is left may be off by one cell of the grid.
"""

import io
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

Array = NDArray[np.floating]

COLOURS = 48
"""Of a stored picture: enough for smooth edges of a few colours."""
_GRID = (96, 64)
"""Cells of a panel, across and down."""
_DARK = 170
"""Of 255, below which all channels of an axis are."""
_PALE = 215
"""Of 255, above which all channels of a grid line and of paper are."""
_GREY = 24
"""Of 255, by which the channels of letters and grid lines differ at most."""
_LETTER = 0.035
"""Of the picture's width: a dark shape that is smaller both ways is a letter."""
_SHORTEST = 0.06
"""Of the picture's width and height: the shortest axis of a panel."""
_TICK = 9
"""Pixels: the longest tick, by which one at the corner lengthens an axis."""
_APART = 0.15
"""Of white to black, by which a cell of the one picture differs from all cells of the other near it."""
_TOLERATED = 0.01
"""Share of such cells."""


class Panel(NamedTuple):
    """What is inside two axes, in pixels: left, upper, right, lower."""

    left: int
    upper: int
    right: int
    lower: int


def in_few_colours(picture: bytes) -> bytes:
    """A picture in PNG with few colours."""
    small = io.BytesIO()
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
    return small.getvalue()


def difference(stored: bytes, now: bytes) -> str:
    """What differs between two pictures in PNG; nothing where they show the same.

    Args:
        stored: in few colours.
        now: as it was drawn.
    """
    pictures = [
        np.asarray(Image.open(io.BytesIO(one)).convert("RGB"), np.uint8) for one in (stored, in_few_colours(now))
    ]
    own, other = (panels(picture) for picture in pictures)
    if len(own) != len(other):
        return f"{len(own)} panels were stored, and there are {len(other)} now"
    grids = [[_grid(picture, panel) for panel in found] for picture, found in zip(pictures, (own, other), strict=True)]
    for number, (one, two) in enumerate(zip(*grids, strict=True), 1):
        share = float(np.mean((_away(one, two) > _APART) | (_away(two, one) > _APART)))
        if share > _TOLERATED:
            return f"panel {number} of {len(own)} differs in {100 * share:.1f} % of its area"
    return ""


def panels(picture: NDArray[np.uint8]) -> list[Panel]:
    """The panels of a picture `(row, column, 3)`, from top to bottom and from left to right."""
    height, width = picture.shape[:2]
    dark = (picture < _DARK).all(-1)
    down, across = _runs(dark.T, int(_SHORTEST * height)), _runs(dark, int(_SHORTEST * width))
    found: list[Panel] = []
    for x, upper, lower in down:
        ends = [(right, y) for y, left, right in across if -2 <= x - left <= _TICK and -2 <= lower - y <= _TICK]
        if not ends:
            continue
        right, y = max(ends)
        if not any(abs(x - one.left) <= _TICK and abs(y - one.lower) <= _TICK for one in found):
            found.append(Panel(x, upper, right, y))
    found.sort(key=lambda one: (round(one.lower / (0.05 * height)), one.left))
    return found or [Panel(0, 0, width - 1, height - 1)]


def _runs(dark: NDArray[np.bool_], least: int) -> list[tuple[int, int, int]]:
    """Row, first and last column of the runs of dark pixels along the rows that are at least so long."""
    found = []
    for row in np.flatnonzero(dark.sum(1) >= least):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], dark[row].astype(int), [0]])))
        found += [(int(row), int(a), int(b) - 1) for a, b in edges.reshape(-1, 2) if b - a >= least]
    return found


def _grid(picture: NDArray[np.uint8], panel: Panel) -> Array:
    """The data inside a panel, white paper elsewhere: `(row, column, 3)` from 0 to 1."""
    inside = picture[panel.upper : panel.lower - 2, panel.left + 3 : panel.right + 1].astype(float)
    grey = np.ptp(inside, axis=-1) < _GREY
    shapes, count = ndimage.label(grey & (inside < _PALE).all(-1), np.ones((3, 3)))
    size = _LETTER * picture.shape[1]
    boxes = ndimage.find_objects(shapes, count)
    small = [k for k, box in enumerate(boxes, 1) if all(part.stop - part.start < size for part in box)]
    inside[np.isin(shapes, small) | (grey & (inside >= _PALE).all(-1))] = 255.0
    image = Image.fromarray(inside.astype(np.uint8)).resize(_GRID, Image.Resampling.BOX)
    return np.asarray(image, float) / 255


def _away(one: Array, other: Array) -> Array:
    """`(row, column)` by how much each cell of the one differs from the nearest cell of the other around it."""
    padded = np.pad(other, ((1, 1), (1, 1), (0, 0)), "edge")
    rows, columns = one.shape[:2]
    shifted = [padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
    return np.min([np.abs(one - near).max(-1) for near in shifted], axis=0)
