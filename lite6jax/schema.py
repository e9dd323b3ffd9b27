"""Checks of JSON documents: what a value may be is a type of msgspec; what it is instead is said in one line."""

import re
import sys
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import msgspec
from msgspec import Meta, inspect

from lite6jax.errors import InputError

Positive = Annotated[float, Meta(ge=0.0)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
"""A share or a probability."""
Count = Annotated[int, Meta(ge=0)]
Number = Annotated[int, Meta(ge=1)]
"""Of a row or a joint, which count from 1; or of samples."""

_MESSAGE = re.compile(r"(.*?)(?: - at `\$(.*)`)?", re.DOTALL)
_STEP = re.compile(r"\.([^.\[]+)|\[(\d+|\.\.\.)\]")
_KEY = re.compile(r"(unknown|missing required) field `(.*)`")


def record(required: Mapping[str, Any], further: Mapping[str, Any] | None = None) -> Any:
    """The type of an object with all the required keys, some of the further ones, and no others.

    Args:
        required: types of values by key, in the order in which they are written.
        further: likewise.
    """
    fields = [*required.items(), *((key, kind, msgspec.UNSET) for key, kind in (further or {}).items())]
    return msgspec.defstruct("record", fields, forbid_unknown_fields=True)


PLACE: dict[str, Any] = {"effect": str, "site": str, "driver": str}
"""Keys of which effect, where it acts, and what it depends on."""
ESTIMATE = record({"value": float, "std": Positive})


class RepeatedKeyError(ValueError):
    """A key that an object has twice; the argument is the key."""


def unique_keys(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """The `object_pairs_hook` of `json.loads` that refuses an object with a key twice, of which it would drop one.

    Raises:
        RepeatedKeyError: as said.
    """
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise RepeatedKeyError(key)
        found[key] = value
    return found


def check(value: Any, kind: Any, place: str = "") -> None:
    """Refuses a value of JSON that is not of a type, or has a number that is not finite.

    Args:
        value: as `json` reads it.
        kind: a type that msgspec knows.
        place: what the value is.

    Raises:
        InputError: the message begins with the place in the document.
    """
    plain = require_finite(value, place)
    try:
        msgspec.convert(plain, kind)
    except msgspec.ValidationError as error:
        raise InputError(_refusal(plain, kind, str(error), place)) from error


def require_finite(value: Any, place: str) -> Any:
    """The value with numbers of Python in place of NumPy's.

    Raises:
        InputError: a number in it is not finite; the message begins with its place.
    """
    if isinstance(value, Mapping):
        return {name: require_finite(entry, f"{place}.{name}") for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [require_finite(entry, f"{place}[{i}]") for i, entry in enumerate(value)]
    if isinstance(value, int | float) and not abs(value) <= sys.float_info.max:
        raise InputError(f"{place.removeprefix('.')} is {str(value)[:40]}, which is not finite")
    return float(value) if isinstance(value, float) else value


def _refusal(value: Any, kind: Any, message: str, place: str) -> str:
    """What msgspec says of a value, with its place, the value there and what may be there."""
    found = _MESSAGE.fullmatch(message)
    assert found is not None
    what, path = found.groups()
    node: Any = inspect.type_info(kind)
    for key, index in _STEP.findall(path or ""):
        place += f".{key}" if key else f"[{index}]"
        node = _accepted(node)
        if index == "...":  # an entry of a mapping, whose name is not said
            return f"{place.removeprefix('.')}: {what}"
        if key:
            value, node = value[key], next(field.type for field in node.fields if field.name == key)
        else:
            value = value[int(index)]
            node = node.item_type if isinstance(node, inspect.ListType) else node.item_types[int(index)]
    place = place.removeprefix(".")
    if key := _KEY.search(what):
        if key[1] == "unknown":
            return f"{place} has the unknown key {key[2]!r}" if place else f"the key {key[2]!r} is unknown"
        return f"{place or 'it'} lacks the key {key[2]!r}"
    return f"{place or 'it'} {_departure(value, _accepted(node))}"


def _accepted(node: Any) -> Any:
    """The type beside null."""
    if isinstance(node, inspect.UnionType):
        return next(each for each in node.types if not isinstance(each, inspect.NoneType))
    return node


def _departure(value: Any, node: Any) -> str:
    """How a value is none of a type."""
    shown = repr(value)
    shown = shown if len(shown) <= 40 else f"{shown[:37]}..."
    match node:
        case inspect.LiteralType(values=values):
            return f"is {shown}, which is not one of {', '.join(map(str, values))}"
        case inspect.TupleType(item_types=types) if isinstance(value, list):
            return f"has {len(value)} entries, not {len(types)}"
        case inspect.ListType(min_length=length) if isinstance(value, list):
            return f"has {len(value)} entries, not {length}"
        case inspect.FloatType(ge=least, le=most) | inspect.IntType(ge=least, le=most):
            if isinstance(value, bool) or not isinstance(value, int | float):
                return f"is {shown}, which is no number"
            if isinstance(node, inspect.IntType) and not isinstance(value, int):
                return f"is {shown}, which is no whole number"
            return f"is {value:.6g}, which is not {_bounds(least, most)}"
        case inspect.BoolType():
            return f"is {shown}, which is neither true nor false"
        case inspect.StrType():
            return f"is {shown}, which is no text"
        case inspect.ListType() | inspect.TupleType():
            return f"is {shown}, which is no list"
    return f"is {shown}, which is no object"


def _bounds(least: float | None, most: float | None) -> str:
    if least is None or most is None:
        return f"{most:.6g} or less" if least is None else f"{least:.6g} or more"
    return f"between {least:.6g} and {most:.6g}"
