"""Faults of an emulated controller and of its connection, selected by name."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

from lite6jax.arms.entries import suggestion
from lite6jax.errors import InputError

ALL = -1
"""Stands for every register in `Faults.silent`."""
NAN_PLACES = ("calibration", "kinematics", "reports")


@dataclass(frozen=True)
class Faults:
    """The faults of an emulated controller; by default none.

    Attributes:
        silent: registers without a reply; with `ALL` no register has one. Connections are accepted.
        silent_reports: report ports accept connections and send nothing.
        fragment: the largest number of bytes sent at once, with a pause after each part of a reply; 0 for no limit.
        close_after: the number of bytes of a reply after which the connection is closed; None for never.
        close_reports_after: the number of reports after which a connection is closed in the middle of the next one.
        lose_every: every n-th report of port 30000 is not sent, as by a busy controller; 0 for none.
        garbage: replies are random bytes.
        invalid: register 8 states that the arm has no calibration.
        status: additional bits of every status.
        error: the error code of the controller, which persists after clearing.
        warning: its warning code.
        latency: s before each reply.
        nan: where values are NaN: calibration, kinematics (registers 41 to 45, 55 and 91), reports.
        stated_model: (axes, type) that registers 1 and 8 state instead of the arm's.
        firmware: the version in register 1; no calibration below 2.3.0, and no reply to register 8 from 1.12.1.
        nominal_kinematics: the controller computes with the nominal chain instead of its calibration.
        rotation_vectors: the poses on port 30000 contain a rotation vector. The vendor calls its numbers rx ry rz
            without a definition, and roll, pitch and yaw elsewhere.
    """

    silent: frozenset[int] = frozenset()
    silent_reports: bool = False
    fragment: int = 0
    close_after: int | None = None
    close_reports_after: int | None = None
    lose_every: int = 0
    garbage: bool = False
    invalid: bool = False
    status: int = 0
    error: int = 0
    warning: int = 0
    latency: float = 0.0
    nan: frozenset[str] = frozenset()
    stated_model: tuple[int, int] | None = None
    firmware: tuple[int, int, int] = (2, 7, 1)
    nominal_kinematics: bool = False
    rotation_vectors: bool = False

    @property
    def calibrated(self) -> bool:
        """Whether the controller provides a calibration."""
        return not self.invalid and self.firmware >= (2, 3, 0)

    def answers(self, register: int) -> bool:
        """Whether a request to this register has a reply."""
        if self.silent & {ALL, register}:
            return False
        return register != 8 or self.firmware != (1, 12, 1)


class _Kind(NamedTuple):
    """A named fault: the name and the default of its value, its description, and the function that sets it."""

    value: str
    default: str
    words: str
    into: Callable[[Faults, str], Faults]


def _flag(field: str, words: str) -> _Kind:
    return _Kind("", "", words, lambda faults, _: replace(faults, **{field: True}))


def _whole(name: str, field: str, value: str, default: str, words: str, lowest: int, highest: int) -> _Kind:
    def into(faults: Faults, text: str) -> Faults:
        return replace(faults, **{field: _integer(name, text, lowest, highest)})

    return _Kind(value, default, words, into)


def _integer(name: str, text: str, lowest: int, highest: int) -> int:
    if not text.isdecimal() or not lowest <= int(text) <= highest:
        raise InputError(f"fault {name}: {text!r} is not a whole number from {lowest} to {highest}")
    return int(text)


def _silence(faults: Faults, text: str) -> Faults:
    register = _integer("silence", text, 0, 255) if text else ALL
    return replace(faults, silent=faults.silent | {register})


def _latency(faults: Faults, text: str) -> Faults:
    try:
        seconds = float(text)
    except ValueError:
        seconds = float("nan")
    if not 0 <= seconds < float("inf"):
        raise InputError(f"fault latency: {text!r} is not a number of 0 or more")
    return replace(faults, latency=seconds)


def _nan(faults: Faults, where: str) -> Faults:
    if where not in NAN_PLACES:
        raise InputError(f"fault nan: {where!r} is not a place; choose one of {', '.join(NAN_PLACES)}")
    return replace(faults, nan=faults.nan | {where})


def _firmware(faults: Faults, version: str) -> Faults:
    parts = version.lstrip("vV").split(".")
    if len(parts) != 3 or not all(part.isdecimal() for part in parts):
        raise InputError(f"fault firmware: {version!r} is not a version; write it like 1.12.1")
    major, minor, patch = map(int, parts)
    return replace(faults, firmware=(major, minor, patch))


def _type(faults: Faults, text: str) -> Faults:
    axes, _, kind = text.partition("/")
    return replace(faults, stated_model=(_integer("type", axes, 0, 255), _integer("type", kind, 0, 255)))


MOST = 10**9
_FAULTS: Mapping[str, _Kind] = MappingProxyType(
    {
        "silence": _Kind("REGISTER", "", "does not reply, or not for this register", _silence),
        "silent_reports": _flag("silent_reports", "report ports accept connections and send nothing"),
        "fragments": _whole("fragments", "fragment", "BYTES", "1", "sends parts of so many bytes", 1, MOST),
        "close": _whole("close", "close_after", "BYTES", "90", "closes after so many bytes of a reply", 0, MOST),
        "close_reports": _whole(
            "close_reports", "close_reports_after", "REPORTS", "500",
            "closes the connection in the middle of a report after so many", 0, MOST,
        ),
        "lose": _whole(
            "lose", "lose_every", "EVERY", "100", "does not send every n-th report of port 30000", 2, MOST
        ),
        "garbage": _flag("garbage", "replies with random bytes"),
        "invalid": _flag("invalid", "reports that the arm has no calibration"),
        "error": _whole("error", "error", "CODE", "2", "has this error, which persists after clearing", 1, 255),
        "warning": _whole("warning", "warning", "CODE", "11", "has this warning", 1, 255),
        "status": _whole("status", "status", "BITS", "8", "adds bits to every status", 0, 255),
        "latency": _Kind("S", "0.5", "delays each reply", _latency),
        "nan": _Kind("WHERE", "calibration", f"gives NaN in {', '.join(NAN_PLACES)}", _nan),
        "type": _Kind("AXES/TYPE", "6/6", "reports another model", _type),
        "firmware": _Kind(
            "VERSION", "1.12.1", "is older: no calibration below 2.3.0, no reply to its request from 1.12.1", _firmware
        ),
        "nominal": _flag("nominal_kinematics", "computes with the nominal chain instead of its calibration"),
        "rotation_vectors": _flag("rotation_vectors", "orientations on port 30000 are rotation vectors"),
    }
)  # fmt: skip


def describe_faults() -> list[tuple[str, str]]:
    """Each fault: its name with its value, and its description."""
    described = []
    for name, kind in _FAULTS.items():
        description = f"{kind.words} (default {kind.default})" if kind.default else kind.words
        described.append((f"{name}:{kind.value}" if kind.value else name, description))
    return described


def parse_faults(texts: Iterable[str]) -> Faults:
    """The faults named by texts such as `silence:8` or `latency:0.5`.

    Raises:
        InputError: an unknown name, or an invalid value.
    """
    faults = Faults()
    for text in texts:
        name, colon, value = text.partition(":")
        if name not in _FAULTS:
            raise InputError(f"no fault {name!r}; {suggestion(name, _FAULTS)}")
        kind = _FAULTS[name]
        if colon and not kind.value:
            raise InputError(f"fault {name}: takes no value; leave {value!r} out")
        faults = kind.into(faults, value or kind.default)
    return faults
