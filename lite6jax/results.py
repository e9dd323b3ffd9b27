"""What every public result can do: `summary()`, which printing it shows, `plot()`, `to_frame()` and `save(path)`.

A result stands below the report in the order of the parts and knows nothing of it. How a class is described, drawn,
tabulated and saved are functions that the report registers with the four generic ones here. `lite6jax/__init__.py`,
which may know all parts, enters in `registering` which modules do so; each is imported when it is first needed.
"""

from collections.abc import Iterable, Mapping
from functools import cached_property, singledispatch
from html import escape
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

from lite6jax.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import pandas
    from matplotlib.figure import Figure

registering: dict[str, str] = {}
"""By the name of a generic function, the module that registers what it does with each class of result."""
MOST_NOTES = 4
_DPI = 64
"""Of figures that a notebook shows by itself: legible on a screen, small in the file."""


class Description(NamedTuple):
    """What a person reads of a result.

    Attributes:
        title: a few words.
        sentences: whole ones, with units.
        notes: what was assumed, a sentence each.
    """

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
        from matplotlib.image import imsave

        if not self:
            return None
        drawn = [_pixels(figure) for figure in self.values()]
        width = max(image.shape[1] for image in drawn)
        wide = [np.pad(i, ((0, 0), (0, width - i.shape[1]), (0, 0)), constant_values=1.0) for i in drawn]
        held = BytesIO()
        imsave(held, np.ascontiguousarray(np.vstack(wide)), format="png")
        return held.getvalue()


def _pixels(figure: "Figure") -> "np.ndarray":
    """`(row, column, 3)` from 0 to 1."""
    from matplotlib.image import imread

    held = BytesIO()
    figure.savefig(held, format="png", dpi=_DPI)
    held.seek(0)
    return imread(held)[..., :3]


@singledispatch
def describe(result: Any) -> Description:
    """The description of a result."""
    raise _unregistered("describe", result)


@singledispatch
def draw(result: Any, title: str) -> Figures:
    """The figures of a result by name.

    Args:
        title: what begins the title of each; empty for the result's own.
    """
    raise _unregistered("draw", result)


@singledispatch
def tabulate(result: Any) -> Mapping[str, Any]:
    """The table of a result: column name with its unit to `(row,)` values."""
    raise _unregistered("tabulate", result)


@singledispatch
def write(result: Any, path: Path, overwrite: bool) -> Path:
    """Writes a result into a file, in the form that the file's suffix names.

    Raises:
        InputError: a suffix that no form of this result has, or as `storage.write_atomically`.
    """
    raise _unregistered("write", result)


def _unregistered(function: str, result: Any) -> TypeError:
    where = registering.get(function, "no module")
    return TypeError(f"{type(result).__name__} has no function `{function}` in {where}; register one")


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
        import_module(registering["draw"])
        return draw(self, title)

    def to_frame(self) -> "pandas.DataFrame":
        """The result's table as a pandas data frame; the columns' names have their units, as in files.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            from pandas import DataFrame
        except ImportError as error:
            raise InputError("to_frame() needs pandas; install it with: pip install pandas") from error
        import_module(registering["tabulate"])
        return DataFrame(dict(tabulate(self)))

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Writes the result: as JSON, as a table (`.csv`, `.parquet`), of a diagnosis also as a page (`.html`).

        Args:
            path: whose suffix says in which form.
            overwrite: whether a file that exists is replaced.

        Raises:
            InputError: another suffix, a file that exists while `overwrite` is false, or a disk that refuses.
        """
        import_module(registering["write"])
        return write(self, Path(path), overwrite)

    def __repr__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        """The sentences and the notes, each an entry of a list, without styles, scripts or links."""
        title, sentences, notes = self._description
        more = [f"{len(notes) - MOST_NOTES} more notes"] if len(notes) > MOST_NOTES else []
        lists = (sentences, [*notes[:MOST_NOTES], *more])
        shown = ("".join(f"<li>{escape(line)}</li>" for line in lines) for lines in lists if lines)
        return f"<p><b>{escape(title)}</b></p>" + "".join(f"<ul>{entries}</ul>" for entries in shown)

    @cached_property
    def _description(self) -> Description:
        import_module(registering["describe"])
        return describe(self)
