"""Faults of an emulated controller and of its connection, selected by name."""

from collections.abc import Callable, Iterable
from dataclasses import Field, dataclass, field, fields, replace
from typing import Any

from lite6jax.arms.entries import suggestion
from lite6jax.errors import InputError

ALL = -1
"""Stands for every register in `Faults.silent`."""
NAN_PLACES = ("calibration", "kinematics", "reports")


def _integer(lowest: int, highest: int = 10**9) -> Callable[[str, str], int]:
    def parse(name: str, text: str) -> int:
        if not text.isdecimal() or not lowest <= int(text) <= highest:
            raise InputError(f"fault {name}: {text!r} is not a whole number from {lowest} to {highest}")
        return int(text)

    return parse


def _register(name: str, text: str) -> frozenset[int]:
    return frozenset([_integer(0, 255)(name, text) if text else ALL])


def _seconds(name: str, text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = float("nan")
    if not 0 <= seconds < float("inf"):
        raise InputError(f"fault {name}: {text!r} is not a number of 0 or more")
    return seconds


def _place(name: str, text: str) -> frozenset[str]:
    if text not in NAN_PLACES:
        raise InputError(f"fault {name}: {text!r} is not a place; choose one of {', '.join(NAN_PLACES)}")
    return frozenset([text])


def _model(name: str, text: str) -> tuple[int, int]:
    axes, _, kind = text.partition("/")
    return _integer(0, 255)(name, axes), _integer(0, 255)(name, kind)


def _version(name: str, text: str) -> tuple[int, ...]:
    parts = text.lstrip("vV").split(".")
    if len(parts) != 3 or not all(part.isdecimal() for part in parts):
        raise InputError(f"fault {name}: {text!r} is not a version; write it like 1.12.1")
    return tuple(map(int, parts))


_Parse = Callable[[str, str], Any]
"""The field of `Faults` by the fault's name and the text of its value."""


def _fault(default: Any, name: str, words: str, value: str = "", example: str = "", parse: _Parse | None = None) -> Any:
    """A field: its value without the fault; the fault's name, effect, name of the value, and value if none is given."""
    kind = {"name": name, "words": words, "value": value, "example": example, "parse": parse}
    return field(default=default, metadata=kind)


@dataclass(frozen=True)
class Faults:
    """The faults of an emulated controller; by default none. `describe_faults` describes them.

    With `ALL` in `silent` no register has a reply; connections are accepted all the same. NaN in `kinematics` are those
    of registers 41 to 45, 55 and 91. `stated_model` are the axes and the type that registers 1 and 8 state.
    """

    silent: frozenset[int] = _fault(
        frozenset(), "silence", "does not reply, or not for this register", "REGISTER", "", _register
    )
    silent_reports: bool = _fault(False, "silent_reports", "report ports accept connections and send nothing")
    fragment: int = _fault(0, "fragments", "sends parts of so many bytes", "BYTES", "1", _integer(1))
    close_after: int | None = _fault(None, "close", "closes after so many bytes of a reply", "BYTES", "90", _integer(0))
    close_reports_after: int | None = _fault(
        None,
        "close_reports",
        "closes the connection in the middle of a report after so many",
        "REPORTS",
        "500",
        _integer(0),
    )
    lose_every: int = _fault(0, "lose", "does not send every n-th report of port 30000", "EVERY", "100", _integer(2))
    garbage: bool = _fault(False, "garbage", "replies with random bytes")
    invalid: bool = _fault(False, "invalid", "reports that the arm has no calibration")
    error: int = _fault(0, "error", "has this error, which persists after clearing", "CODE", "2", _integer(1, 255))
    warning: int = _fault(0, "warning", "has this warning", "CODE", "11", _integer(1, 255))
    status: int = _fault(0, "status", "adds bits to every status", "BITS", "8", _integer(0, 255))
    latency: float = _fault(0.0, "latency", "delays each reply", "S", "0.5", _seconds)
    nan: frozenset[str] = _fault(
        frozenset(), "nan", f"gives NaN in {', '.join(NAN_PLACES)}", "WHERE", "calibration", _place
    )
    stated_model: tuple[int, int] | None = _fault(None, "type", "reports another model", "AXES/TYPE", "6/6", _model)
    firmware: tuple[int, int, int] = _fault(
        (2, 7, 1), "firmware", "is older: no calibration below 2.3.0, no reply to its request from 1.12.1", "VERSION",
        "1.12.1", _version,
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
    kinds: dict[str, Field[Any]] = {item.metadata["name"]: item for item in fields(Faults)}
    faults = Faults()
    for text in texts:
        name, colon, value = text.partition(":")
        if name not in kinds:
            raise InputError(f"no fault {name!r}; {suggestion(name, kinds)}")
        kind, key = kinds[name].metadata, kinds[name].name
        if colon and not kind["value"]:
            raise InputError(f"fault {name}: takes no value; leave {value!r} out")
        found = kind["parse"](name, value or kind["example"]) if kind["value"] else True
        if isinstance(found, frozenset):
            found |= getattr(faults, key)
        faults = replace(faults, **{key: found})
    return faults
