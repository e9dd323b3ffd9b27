"""Texts of `templates`, filled with numbers."""

from collections.abc import Callable, Mapping, Sequence, Sized
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import yaml

from lite6jax.report.words import (
    be,
    capital,
    chance,
    counted,
    joined,
    joints_named,
    milli,
    multiple,
    number,
    plus_minus,
    rows_named,
    significant,
)


@cache
def read_texts(name: str) -> dict[str, Any]:
    """The texts of a file in `templates`."""
    text = (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8")
    return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def fill(text: str, numbers: Mapping[str, Any], /, **more: object) -> str:
    """A text with its numbers, and one blank between words.

    Raises:
        KeyError: a number is missing.
    """
    try:
        return " ".join(_template(text).render(numbers, **more).split())
    except jinja2.UndefinedError as error:
        raise KeyError(str(error)) from error


def _count_of(function: Callable[..., str]) -> Callable[..., str]:
    """A function of a number, which takes rows or joints in its place."""
    return lambda of, *more: function(len(of) if isinstance(of, Sized) else of, *more)


def _vector(numbers: Sequence[float], digits: int = 3) -> str:
    return f"({', '.join(milli(value, digits) for value in numbers)})"


@cache
def _template(text: str) -> jinja2.Template:
    return _environment().from_string(text)


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, autoescape=False)
    environment.filters |= {
        "g": significant,
        "mm": milli,
        "mm_vector": _vector,
        "joined": lambda parts, last="and": joined(map(str, parts), last),
        "count_of": _count_of(counted),
        **{of.__name__: of for of in (capital, joints_named, number, multiple, rows_named)},
        "plus_minus": plus_minus,
    }
    environment.globals |= {
        "be": _count_of(be),
        "deg": lambda angle: float(np.rad2deg(angle)),
        "chance": chance,
        "plain": lambda numbers: ", ".join(f"{value:g}" for value in numbers),
    }
    return environment
