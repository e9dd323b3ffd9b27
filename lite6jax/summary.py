"""`summary()`, `plot()` and a notebook's table for results of the library, which `lite6jax.report` words and draws.

A result stands below the report in the order of the parts and imports nothing of it. `Summarised` and `Plotted` load
the report by its name when it is first requested; `report/summaries.py` and `report/plots.py` hold one function for
each kind of result.
"""

from collections.abc import Iterable
from importlib import import_module
from io import BytesIO
from typing import TYPE_CHECKING, final

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RENDERER = "lite6jax.report.summaries"
PLOTTER = "lite6jax.report.plots"
_DPI = 64
"""Of figures that a notebook shows by itself: legible on a screen, small in the file."""


class Summarised:
    """What a result inherits to be read by a person. The report words it; nothing here is overridden."""

    def summary(self) -> str:
        """A few whole sentences with the main numbers, in mm, degrees and the other units of the screen."""
        return import_module(RENDERER).summary(self)

    def _repr_html_(self) -> str:
        return import_module(RENDERER).html(self)


@final
class Figures(dict[str, "Figure"]):
    """Figures by name, which a notebook shows below each other where they are a cell's value."""

    def only(self, names: Iterable[str]) -> "Figures":
        """Those of some names, in their order.

        Raises:
            KeyError: there is none of such a name.
        """
        return Figures({name: self[name] for name in names})

    def _repr_png_(self) -> bytes | None:
        from matplotlib.image import imsave

        if not self:
            return None
        drawn = [_pixels(figure) for figure in self.values()]
        width = max(image.shape[1] for image in drawn)
        wide = [np.pad(i, ((0, 0), (0, width - i.shape[1]), (0, 0)), constant_values=1.0) for i in drawn]
        held = BytesIO()
        imsave(held, np.ascontiguousarray(np.vstack(wide)), format="png")
        return held.getvalue()


def _pixels(figure: "Figure") -> np.ndarray:
    """`(row, column, 3)` from 0 to 1."""
    from matplotlib.image import imread

    held = BytesIO()
    figure.savefig(held, format="png", dpi=_DPI)
    held.seek(0)
    return imread(held)[..., :3]


class Plotted:
    """What a result inherits to be drawn. The report draws it; nothing here is overridden."""

    def plot(self, title: str = "") -> Figures:
        """Matplotlib figures by name, such as `error_by_joint`; save one with its `savefig`.

        In a notebook `found.plot()` shows all of them, and `found.plot().only(["error_by_joint"])` some.

        Args:
            title: what begins the title of each figure; the recording's name where not given.
        """
        return import_module(PLOTTER).plotted(self, title)
