"""Tables of a terminal, and texts of `templates` filled with numbers."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import yaml
from rich import box
from rich.table import Table
from rich.text import Text

from lite6jax.formatting import be, capital, counted, joined, joints_named, milli, number, significant
from lite6jax.storage import YAML_LOADER


def listing(
    *headers: str,
    rows: Iterable[Iterable[str | Text]] = (),
    left: Sequence[int] = (),
    wrapped: Sequence[int] = (),
) -> Table:
    """A table of numbers whose first column names the row; further columns may be aligned to the left, or wrapped."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False, header_style="")
    for i, header in enumerate(headers):
        justify = "left" if i == 0 or i in left else "right"
        table.add_column(Text(header), justify=justify, no_wrap=i not in wrapped)
    for row in rows:
        table.add_row(*row)
    return table


# ------------------------------------------------------------------ texts of `templates`


@cache
def read_texts(name: str) -> dict[str, Any]:
    """The texts of a file in `templates`."""
    text = (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8")
    return yaml.load(text, YAML_LOADER)


def fill(text: str, numbers: Mapping[str, Any], /, **more: object) -> str:
    """A text with its numbers, and one blank between words but those of a name.

    Raises:
        KeyError: a number is missing.
    """
    try:
        return " ".join(_template(text).render(numbers, **more).split()).replace("\0", " ")
    except jinja2.UndefinedError as error:
        raise KeyError(str(error)) from error


def say(texts: str | Iterable[str], numbers: Mapping[str, Any], /, **more: object) -> Iterator[str]:
    """A text or several, a line each, but for those that are empty."""
    for text in [texts] if isinstance(texts, str) else texts:
        if line := fill(text, numbers, **more):
            yield line


def _count_of(function: Callable[..., str]) -> Callable[..., str]:
    """A function of a number, which takes a list in its place."""
    return lambda of, *more: function(len(of) if isinstance(of, Sized) else of, *more)


@cache
def _template(text: str) -> jinja2.Template:
    return _environment().from_string(text)


@cache
def _environment() -> jinja2.Environment:
    keep_spaces = lambda value: value.replace("  ", " \0") if isinstance(value, str) else value  # noqa: E731
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, autoescape=False, finalize=keep_spaces)
    environment.filters |= {
        "g": significant,
        "mm": milli,
        "joined": lambda parts, last="and": joined(map(str, parts), last),
        "count_of": _count_of(counted),
        **{of.__name__: of for of in (capital, joints_named, number)},
    }
    environment.globals |= {
        "be": _count_of(be),
        "deg": lambda angle: float(np.rad2deg(angle)),
        "plain": lambda numbers: ", ".join(f"{value:g}" for value in numbers),
    }
    return environment
