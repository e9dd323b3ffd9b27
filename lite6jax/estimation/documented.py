"""Numbers that decide, each documented where it is declared: its value, what it means, and why it has that value."""

from dataclasses import field, fields
from typing import Any, NamedTuple

from lite6jax.fields import field_values


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
    """The options of an object, in the order in which they are declared; groups of options are left out."""
    values = field_values(options)
    return [
        Documented(f.name, values[f.name], f.metadata["meaning"], f.metadata["why"])
        for f in fields(options)
        if "meaning" in f.metadata
    ]
