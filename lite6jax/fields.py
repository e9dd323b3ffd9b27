"""The fields of a dataclass with what they hold."""

from dataclasses import fields
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def field_values(instance: "DataclassInstance") -> dict[str, Any]:
    """What each field of a dataclass holds, by its name; nothing that was computed of them, and no copies."""
    return {field.name: getattr(instance, field.name) for field in fields(instance)}
