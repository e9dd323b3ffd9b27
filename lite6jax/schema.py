"""Types of values in JSON documents, and their check by msgspec, whose messages name the place: `$.model.arm`."""

from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from lite6jax.errors import InputError

Kind = TypeVar("Kind")
NonNegative = Annotated[float, Meta(ge=0.0)]
Count = Annotated[int, Meta(ge=0)]
Number = Annotated[int, Meta(ge=1)]
"""Of a row or a joint, which count from 1; or of samples."""
FLEET = "lite6jax/fleet_diagnosis/1"
"""The key `schema` of the document of a fleet."""


class Strict(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """An object with these keys and no others."""


def check(value: Any, kind: type[Kind], place: str = "") -> Kind:
    """A value of JSON as one of a type.

    Args:
        value: as `json` or msgspec reads it; numbers may be NumPy's.
        kind: a type that msgspec knows.
        place: what the value is.

    Raises:
        InputError: it is none of the type, or has a number that is not finite; the message ends with its place.
    """
    try:
        # a number that is not finite becomes null
        return msgspec.json.decode(msgspec.json.encode(value, enc_hook=float), type=kind)
    except (msgspec.MsgspecError, TypeError, OverflowError, RecursionError) as error:
        raise InputError(f"{place}: {error}" if place else str(error)) from error
