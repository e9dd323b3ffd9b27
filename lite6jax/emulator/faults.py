"""Faults of an emulated controller and of its connection, selected by name."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any

from lite6jax.arms.entries import suggestion
from lite6jax.errors import InputError

ALL = -1
"""Stands for every register in `Faults.silent`."""
NAN_PLACES = ("calibration", "kinematics", "reports")


def _fault(
    default: Any, name: str, words: str, value: str = "", example: str = "", lowest: int = 0, highest: int = 10**9
) -> Any:
    """A field: its value without the fault; the fault's name and effect; of its value the name, default and bounds."""
    kind = {"name": name, "words": words, "value": value, "example": example, "bounds": (lowest, highest)}
    return field(default=default, metadata=kind)


@dataclass(frozen=True)
class Faults:
    """The faults of an emulated controller; by default none. `describe_faults` describes them.

    With `ALL` in `silent` no register has a reply; connections are accepted all the same. NaN in `kinematics` are those
    of registers 41 to 45, 55 and 91. `model` are the axes and the type that registers 1 and 8 state.
    """

    silent: frozenset[int] = _fault(
        frozenset(), "silence", "does not reply, or not for this register", "REGISTER", highest=255
    )
    silent_reports: bool = _fault(False, "silent_reports", "report ports accept connections and send nothing")
    fragment: int = _fault(0, "fragments", "sends parts of so many bytes", "BYTES", "1", lowest=1)
    close_after: int | None = _fault(None, "close", "closes after so many bytes of a reply", "BYTES", "90")
    close_reports_after: int | None = _fault(
        None, "close_reports", "closes the connection in the middle of a report after so many", "REPORTS", "500"
    )
    lose_every: int = _fault(0, "lose", "does not send every n-th report of port 30000", "EVERY", "100", lowest=2)
    garbage: bool = _fault(False, "garbage", "replies with random bytes")
    invalid: bool = _fault(False, "invalid", "reports that the arm has no calibration")
    error: int = _fault(0, "error", "has this error, which persists after clearing", "CODE", "2", 1, 255)
    warning: int = _fault(0, "warning", "has this warning", "CODE", "11", 1, 255)
    status: int = _fault(0, "status", "adds bits to every status", "BITS", "8", 0, 255)
    latency: float = _fault(0.0, "latency", "delays each reply", "S", "0.5")
    nan: frozenset[str] = _fault(frozenset(), "nan", f"gives NaN in {', '.join(NAN_PLACES)}", "WHERE", "calibration")
    model: tuple[int, int] | None = _fault(None, "type", "reports another model", "AXES/TYPE", "6/6", 0, 255)
    firmware: tuple[int, int, int] = _fault(
        (2, 7, 1), "firmware", "is older: no calibration below 2.3.0, no reply to its request from 1.12.1", "VERSION",
        "1.12.1",
    )  # fmt: skip
    nominal_kinematics: bool = _fault(False, "nominal", "computes with the nominal chain instead of its calibration")
    # the vendor calls the numbers rx ry rz without a definition, and roll, pitch and yaw elsewhere
    rotation_vectors: bool = _fault(False, "rotation_vectors", "orientations on port 30000 are rotation vectors")

    @property
    def calibrated(self) -> bool:
        """Whether the controller provides a calibration."""
        return not self.invalid and self.firmware >= (2, 3, 0)

    def answers(self, register: int) -> bool:
        """Whether a request to this register has a reply."""
        return not self.silent & {ALL, register} and (register != 8 or self.firmware != (1, 12, 1))


def describe_faults() -> list[tuple[str, str]]:
    """Each fault: its name with its value, and its description."""
    described = []
    for kind in (item.metadata for item in fields(Faults)):
        name = f"{kind['name']}:{kind['value']}" if kind["value"] else kind["name"]
        described.append((name, kind["words"] + (f" (default {kind['example']})" if kind["example"] else "")))
    return described


def parse_faults(texts: Iterable[str]) -> Faults:
    """The faults named by texts such as `silence:8` or `latency:0.5`.

    Raises:
        InputError: an unknown name, or an invalid value.
    """
    kinds = {item.metadata["name"]: item for item in fields(Faults)}
    faults = Faults()
    for text in texts:
        name, colon, value = text.partition(":")
        if name not in kinds:
            raise InputError(f"no fault {name!r}; {suggestion(name, kinds)}")
        kind, key = kinds[name].metadata, kinds[name].name
        if colon and not kind["value"]:
            raise InputError(f"fault {name}: takes no value; leave {value!r} out")
        found = _parse_value(name, value or kind["example"], *kind["bounds"]) if kind["value"] else True
        if isinstance(found, frozenset):
            found |= getattr(faults, key)
        faults = replace(faults, **{key: found})
    return faults


def _parse_value(name: str, text: str, lowest: int, highest: int) -> Any:
    """The field of a fault with a value."""

    def parse_integer(text: str) -> int:
        if not text.isdecimal() or not lowest <= int(text) <= highest:
            raise InputError(f"fault {name}: {text!r} is not a whole number from {lowest} to {highest}")
        return int(text)

    match name:
        case "silence":
            return frozenset([parse_integer(text) if text else ALL])
        case "latency":
            try:
                seconds = float(text)
            except ValueError:
                seconds = math.nan
            if not 0 <= seconds < math.inf:
                raise InputError(f"fault {name}: {text!r} is not a number of 0 or more")
            return seconds
        case "nan":
            if text not in NAN_PLACES:
                raise InputError(f"fault {name}: {text!r} is not a place; choose one of {', '.join(NAN_PLACES)}")
            return frozenset([text])
        case "type":
            axes, _, kind = text.partition("/")
            return parse_integer(axes), parse_integer(kind)
        case "firmware":
            parts = text.lstrip("vV").split(".")
            if len(parts) != 3 or not all(part.isdecimal() for part in parts):
                raise InputError(f"fault {name}: {text!r} is not a version; write it like 1.12.1")
            return tuple(map(int, parts))
    return parse_integer(text)
