"""`summary()`, `plot()` and a notebook's table for results of the library, which `lite6jax.report` words and draws.

A result stands below the report in the order of the parts and imports nothing of it. `Summarised` and `Plotted` load
the report by its name when it is first requested; `report/summaries.py` and `report/plots.py` hold one function for
each kind of result.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RENDERER = "lite6jax.report.summaries"
PLOTTER = "lite6jax.report.plots"


class Summarised:
    """What a result inherits to be read by a person. The report words it; nothing here is overridden."""

    def summary(self) -> str:
        """A few whole sentences with the main numbers, in mm, degrees and the other units of the screen."""
        return import_module(RENDERER).summary(self)

    def _repr_html_(self) -> str:
        return import_module(RENDERER).html(self)


class Plotted:
    """What a result inherits to be drawn. The report draws it; nothing here is overridden."""

    def plot(self, title: str = "") -> "dict[str, Figure]":
        """Matplotlib figures by name, such as `error_by_joint`; save one with its `savefig`.

        Args:
            title: what begins the title of each figure; the recording's name where not given.
        """
        return import_module(PLOTTER).plotted(self, title)
