"""What every public result can do: `summary()`, which printing it shows, `plot()`, `to_frame()` and `save(path)`.

A result stands below the report in the order of the parts and knows nothing of it: `lite6jax/__init__.py`, which may
know all parts, names the module that describes, draws, tabulates and writes results.
"""

from collections.abc import Iterable
from functools import cached_property
from html import escape
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

from lite6jax.errors import InputError

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

reporting = ""
"""The module whose functions `describe`, `draw`, `tabulate` and `write` take any result; imported when first needed."""
MOST_NOTES = 4
_DPI = 64
"""Of figures that a notebook shows by itself: legible on a screen, small in the file."""


class Description(NamedTuple):
    """What a person reads of a result: a title of a few words, whole sentences with units, and what was assumed."""

    title: str
    sentences: tuple[str, ...]
    notes: tuple[str, ...] = ()


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
        import numpy as np
        from matplotlib.image import imread, imsave

        drawn = []
        for figure in self.values():
            figure.savefig(buffer := BytesIO(), format="png", dpi=_DPI)
            drawn.append(imread(BytesIO(buffer.getvalue()))[..., :3])
        if not drawn:
            return None
        width = max(image.shape[1] for image in drawn)
        wide = [np.pad(i, ((0, 0), (0, width - i.shape[1]), (0, 0)), constant_values=1.0) for i in drawn]
        imsave(buffer := BytesIO(), np.ascontiguousarray(np.vstack(wide)), format="png")
        return buffer.getvalue()


class PublicResult:
    """What a public result inherits. Nothing here is overridden, so a dataclass derived from it has `repr=False`."""

    def summary(self) -> str:
        """A few whole sentences with the main numbers, in mm, degrees and the other units of the screen."""
        return " ".join(self._description.sentences)

    def plot(self, title: str = "") -> Figures:
        """Matplotlib figures by name, such as `error_by_joint`; save one with its `savefig`.

        In a notebook `found.plot()` shows all of them, and `found.plot().only(["error_by_joint"])` some.

        Args:
            title: what begins the title of each figure; the recording's or the arm's name where not given.
        """
        return _report().draw(self, title)

    def to_frame(self) -> "pandas.DataFrame":
        """The result's table as a pandas data frame; the columns' names have their units, as in files.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            from pandas import DataFrame
        except ImportError as error:
            raise InputError("to_frame() needs pandas; install it with: pip install pandas") from error
        return DataFrame(dict(_report().tabulate(self)))

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Writes the result: as JSON, as a table (`.csv`, `.parquet`), of a diagnosis also as a page (`.html`).

        Args:
            path: whose suffix says in which form.
            overwrite: whether a file that exists is replaced.

        Raises:
            InputError: another suffix, a file that exists while `overwrite` is false, or a disk that refuses.
        """
        return _report().write(self, Path(path), overwrite)

    def __repr__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        """The sentences and the notes, each an entry of a list, without styles, scripts or links."""
        title, sentences, notes = self._description
        more = []
        if len(notes) > MOST_NOTES:
            more = [f"{len(notes) - MOST_NOTES} more notes"]
        lists = (sentences, [*notes[:MOST_NOTES], *more])
        shown = ("".join(f"<li>{escape(line)}</li>" for line in lines) for lines in lists if lines)
        return f"<p><b>{escape(title)}</b></p>" + "".join(f"<ul>{entries}</ul>" for entries in shown)

    @cached_property
    def _description(self) -> Description:
        return _report().describe(self)


def _report() -> Any:
    return import_module(reporting)
