"""Schemas of JSON documents: what each value may be, as functions that refuse any other in one line."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from lite6jax.errors import InputError

Check = Callable[[Any, str], None]
"""Of a value and its place in the document; raises `InputError`, whose message begins with the place."""


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


def number(lower: float = -math.inf, upper: float = math.inf) -> Check:
    """A finite number, which true and false are not, between two bounds."""

    def check(value: Any, place: str) -> None:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{place} is {_shown(value)}, which is no number")
        if not abs(value) < math.inf or value != value:
            raise InputError(f"{place} is {value}, which is not finite")
        if not lower <= value <= upper:
            raise InputError(f"{place} is {value:.6g}, which is not {_bounds(lower, upper)}")

    return check


def whole(lower: float = -math.inf, upper: float = math.inf) -> Check:
    """A whole number, written without a point."""
    between = number(lower, upper)

    def check(value: Any, place: str) -> None:
        between(value, place)
        if not isinstance(value, int):
            raise InputError(f"{place} is {_shown(value)}, which is no whole number")

    return check


def flag(value: Any, place: str) -> None:
    """True or false."""
    if not isinstance(value, bool):
        raise InputError(f"{place} is {_shown(value)}, which is neither true nor false")


def text(value: Any, place: str) -> None:
    """A text."""
    if not isinstance(value, str):
        raise InputError(f"{place} is {_shown(value)}, which is no text")


def one_of(*accepted: str) -> Check:
    """One of some texts."""

    def check(value: Any, place: str) -> None:
        if not isinstance(value, str) or value not in accepted:
            raise InputError(f"{place} is {_shown(value)}, which is not one of {', '.join(accepted)}")

    return check


def optional(check_: Check) -> Check:
    """Null, or what another check accepts."""
    return lambda value, place: None if value is None else check_(value, place)


def items(check_: Check, count: int | None = None) -> Check:
    """A list, of a certain length where `count` is given."""

    def check(value: Any, place: str) -> None:
        if not isinstance(value, list):
            raise InputError(f"{place} is {_shown(value)}, which is no list")
        if count is not None and len(value) != count:
            raise InputError(f"{place} has {len(value)} entries, not {count}")
        for i, entry in enumerate(value):
            check_(entry, f"{place}[{i}]")

    return check


def array(*shape: int | None, lower: float = -math.inf, upper: float = math.inf) -> Check:
    """Nested lists of numbers between two bounds; None in the shape stands for any length."""
    check: Check = number(lower, upper)
    for length in reversed(shape):
        check = items(check, length)
    return check


def mapping(check_: Check) -> Check:
    """An object of any names, whose values another check accepts."""

    def check(value: Any, place: str) -> None:
        if not isinstance(value, Mapping):
            raise InputError(f"{place} is {_shown(value)}, which is no object")
        for name, entry in value.items():
            check_(entry, f"{place}.{name}")

    return check


def record(required: Mapping[str, Check], further: Mapping[str, Check] | None = None) -> Check:
    """An object with all the required names, some of the further ones, and no others."""
    accepted = {**required, **(further or {})}

    def check(value: Any, place: str) -> None:
        if not isinstance(value, Mapping):
            raise InputError(f"{place} is {_shown(value)}, which is no object")
        for name in value:
            if name not in accepted:
                raise InputError(f"{place} has the unknown key {_shown(name)}")
        for name in required:
            if name not in value:
                raise InputError(f"{place} lacks the key {name!r}")
        for name, entry in value.items():
            accepted[name](entry, f"{place}.{name}")

    return check


def plain(value: Any, place: str) -> None:
    """Any value of JSON all of whose numbers are finite."""
    if isinstance(value, Mapping):
        mapping(plain)(value, place)
    elif isinstance(value, list):
        items(plain)(value, place)
    elif not (value is None or isinstance(value, bool | str)):
        number()(value, place)


def _shown(value: Any) -> str:
    shown = repr(value)
    return shown if len(shown) <= 40 else f"{shown[:37]}..."


def _bounds(lower: float, upper: float) -> str:
    if upper == math.inf:
        return f"{lower:g} or more"
    return f"{upper:g} or less" if lower == -math.inf else f"between {lower:.6g} and {upper:.6g}"
