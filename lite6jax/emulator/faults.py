"""What can be wrong with a controller or the line to it, chosen by name."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

from lite6jax.arms.entries import suggestion
from lite6jax.errors import InputError

ALL = -1
"""Among silent registers: every one."""
NAN_PLACES = ("calibration", "kinematics", "reports")


@dataclass(frozen=True)
class Faults:
    """Everything an emulated controller does wrong; the defaults are a sound one on a good line.

    Attributes:
        silent: registers that are never answered; with `ALL` among them none is. Connections are accepted.
        silent_reports: report ports accept, and say nothing.
        fragment: bytes at most that are sent at a time, with a pause after each piece of a reply; 0: whole messages.
        close_after: bytes of a reply after which the connection is closed; None: never.
        close_reports_after: whole reports after which a report connection is closed half-way through the next.
        lose_every: of the reports on port 30000, every so-many-th is never sent, as a busy controller does; 0: none.
        garbage: replies are random bytes instead.
        invalid: register 8 says that the arm has no calibration.
        status: bits that every reply's status has on top.
        error: the controller's error code, from the start and again after it was cleared.
        warning: its warning code.
        latency: s before each reply.
        nan: where numbers are NaN: calibration, kinematics (registers 41 to 45, 55 and 91), reports.
        says: (axes, type) that registers 1 and 8 say instead of the arm's own.
        firmware: version that registers 1 says; below 2.3.0 there is no calibration, and 1.12.1 does not answer 8.
        nominal_kinematics: the controller computes with the nominal chain, and not with the calibration it holds.
        rotation_vectors: the poses on port 30000 end in a rotation vector. The vendor calls them rx ry rz there, and
            nobody has said whether they are not roll, pitch and yaw as everywhere else.
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
    says: tuple[int, int] | None = None
    firmware: tuple[int, int, int] = (2, 7, 1)
    nominal_kinematics: bool = False
    rotation_vectors: bool = False

    @property
    def calibrated(self) -> bool:
        """Whether the controller has a calibration to give."""
        return not self.invalid and self.firmware >= (2, 3, 0)

    def answers(self, register: int) -> bool:
        """Whether a request to this register gets a reply."""
        if self.silent & {ALL, register}:
            return False
        return register != 8 or self.firmware != (1, 12, 1)


class _Kind(NamedTuple):
    """A fault by name: the word for its value and the one taken where none is given, what it does, how it is set."""

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
        raise InputError(f"fault nan: {where!r} is no place; choose one of {', '.join(NAN_PLACES)}")
    return replace(faults, nan=faults.nan | {where})


def _firmware(faults: Faults, version: str) -> Faults:
    parts = version.lstrip("vV").split(".")
    if len(parts) != 3 or not all(part.isdecimal() for part in parts):
        raise InputError(f"fault firmware: {version!r} is no version; write it like 1.12.1")
    major, minor, patch = map(int, parts)
    return replace(faults, firmware=(major, minor, patch))


def _type(faults: Faults, text: str) -> Faults:
    axes, _, kind = text.partition("/")
    return replace(faults, says=(_integer("type", axes, 0, 255), _integer("type", kind, 0, 255)))


MOST = 10**9
_FAULTS: Mapping[str, _Kind] = MappingProxyType(
    {
        "silence": _Kind("REGISTER", "", "answers nothing, or not this register", _silence),
        "silent_reports": _flag("silent_reports", "report ports accept and say nothing"),
        "fragments": _whole("fragments", "fragment", "BYTES", "1", "sends in pieces of so many bytes", 1, MOST),
        "close": _whole("close", "close_after", "BYTES", "90", "hangs up after so many bytes of a reply", 0, MOST),
        "close_reports": _whole(
            "close_reports", "close_reports_after", "REPORTS", "500",
            "hangs up half-way through a report after so many", 0, MOST,
        ),
        "lose": _whole(
            "lose", "lose_every", "EVERY", "100", "never sends every so-many-th report of port 30000", 2, MOST
        ),
        "garbage": _flag("garbage", "replies with random bytes"),
        "invalid": _flag("invalid", "says that the arm has no calibration"),
        "error": _whole("error", "error", "CODE", "2", "has this error, whatever clears it", 1, 255),
        "warning": _whole("warning", "warning", "CODE", "11", "has this warning", 1, 255),
        "status": _whole("status", "status", "BITS", "8", "adds bits to every status", 0, 255),
        "latency": _Kind("S", "0.5", "takes so long to answer", _latency),
        "nan": _Kind("WHERE", "calibration", f"gives NaN in {', '.join(NAN_PLACES)}", _nan),
        "type": _Kind("AXES/TYPE", "6/6", "says it is another arm", _type),
        "firmware": _Kind(
            "VERSION", "1.12.1", "is older: below 2.3.0 without a calibration, 1.12.1 silent about it", _firmware
        ),
        "nominal": _flag("nominal_kinematics", "computes with the nominal chain, not with its calibration"),
        "rotation_vectors": _flag("rotation_vectors", "turns on port 30000 are rotation vectors, not roll pitch yaw"),
    }
)  # fmt: skip


def describe_faults() -> list[tuple[str, str]]:
    """Each fault: its name with what may follow it, and what it does."""
    described = []
    for name, kind in _FAULTS.items():
        said = f"{kind.words} ({kind.default} where not given)" if kind.default else kind.words
        described.append((f"{name}:{kind.value}" if kind.value else name, said))
    return described


def parse_faults(texts: Iterable[str]) -> Faults:
    """The faults that texts such as `silence:8` or `latency:0.5` name.

    Raises:
        InputError: an unknown name, or a value that it does not take.
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
