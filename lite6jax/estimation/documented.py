"""Numbers that decide, each documented where it is declared: its value, what it means, and why it has that value."""

from dataclasses import field, fields
from typing import Any, NamedTuple


def option(value: Any, meaning: str, why: str) -> Any:
    """A field of an options object, with its documentation."""
    return field(default=value, metadata={"meaning": meaning, "why": why})


class Documented(NamedTuple):
    """An option as it is documented.

    Attributes:
        name: of the field.
        value: its default.
        meaning: what it is, with its unit.
        why: the reason for the value.
    """

    name: str
    value: Any
    meaning: str
    why: str


def documented(options: Any) -> list[Documented]:
    """The options of an object or class, in the order in which they are declared; groups of options are left out."""
    return [
        Documented(f.name, getattr(options, f.name, f.default), f.metadata["meaning"], f.metadata["why"])
        for f in fields(options)
        if "meaning" in f.metadata
    ]
