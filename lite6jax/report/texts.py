"""Sentences that are filled with numbers: Jinja texts by name in the YAML files of `templates`."""

from collections.abc import Callable, Mapping, Sequence, Sized
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import yaml

from lite6jax.report import words


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
    return f"({', '.join(words.milli(value, digits) for value in numbers)})"


@cache
def _template(text: str) -> jinja2.Template:
    return _environment().from_string(text)


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, autoescape=False)
    environment.filters |= {
        "g": lambda value, digits=3: f"{value:.{digits}g}",
        "mm": words.milli,
        "mm_vector": _vector,
        "listed": ", ".join,
        "joined": lambda parts, last="and": words.joined(map(str, parts), last),
        "count_of": _count_of(words.counted),
        **{
            of.__name__: of
            for of in (words.capital, words.joints_named, words.number, words.multiple, words.rows_named)
        },
        "plus_minus": words.plus_minus,
    }
    environment.globals |= {
        "be": _count_of(words.be),
        "deg": lambda angle: float(np.rad2deg(angle)),
        "chance": words.chance,
        "plain": lambda numbers: ", ".join(f"{value:g}" for value in numbers),
    }
    return environment
