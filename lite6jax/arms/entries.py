"""Checks of the numbers and keys of a parsed file, with messages that name the entry."""

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms import frames
from lite6jax.errors import InputError

Array = NDArray[np.floating]

SIX = ("x", "y", "z", "roll", "pitch", "yaw")
UR_JOINTS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")

TYPES = ("revolute", "prismatic")
"""What the joints of a description can be; the first where nothing is said."""

STANDARD, MODIFIED = "standard", "modified"
_CONVENTIONS = {STANDARD: STANDARD, "dh": STANDARD, "sdh": STANDARD, "distal": STANDARD} | dict.fromkeys(
    (MODIFIED, "mdh", "craig", "proximal"), MODIFIED
)

# m and rad; larger values are in millimetres or degrees.
LENGTH_LIMIT = 10.0
ANGLE_LIMIT = 2 * math.pi + 1e-6

# YAML 1.1 reads 1e-5 as a string because it has no decimal point.
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def number(value: Any, where: str) -> float:
    """The value as a float.

    Raises:
        InputError: it is not a number (a boolean is not), or not finite.
    """
    if isinstance(value, str) and _NUMBER.fullmatch(value):
        value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        shown = repr(value) if len(repr(value)) <= 40 else repr(value)[:37] + "..."
        raise InputError(f"{where} is {shown}, which is not a number; write a plain number")
    try:
        value = float(value)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise InputError(f"{where} is {value}, which is not finite; read the file from its source again")
    return value


def numbers(value: Any, where: str, count: int) -> list[float]:
    """A list of `count` floats.

    Raises:
        InputError: not a list of that length, or as `number`.
    """
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != count:
        raise InputError(f"{where} must be a list of {count} numbers; write [{', '.join(['0.0'] * count)}]")
    return [number(entry, f"{where} number {i + 1}") for i, entry in enumerate(value)]


def mapping(value: Any, where: str, required: Sequence[str], optional: Sequence[str] = ()) -> Mapping[str, Any]:
    """The value as a mapping with these keys and no others.

    Raises:
        InputError: not a mapping, a missing key or an unknown key.
    """
    if not isinstance(value, Mapping):
        raise InputError(f"{where} must be a mapping with the keys {', '.join(required or optional)}")
    accepted = [*required, *optional]
    for key in value:
        if key not in accepted:
            raise InputError(f"{where} has the unknown key {str(key)!r}; {suggestion(str(key), accepted)}")
    for key in required:
        if key not in value:
            raise InputError(f"{where} lacks the key {key!r}; add it")
    return value


def suggestion(word: str, accepted: Iterable[str]) -> str:
    """`did you mean …? Accepted are …`, for the end of a message."""
    accepted = list(accepted)
    near = difflib.get_close_matches(word, accepted, n=1)
    return (f"did you mean {near[0]!r}? " if near else "") + f"accepted are {', '.join(accepted)}"


def six_numbers(value: Any, where: str) -> list[float]:
    """x y z roll pitch yaw of a mapping with exactly these keys, in m and rad.

    Raises:
        InputError: as `mapping` and `number`; an angle beyond a full turn (degrees?), a length of over 10 m
            (millimetres?).
    """
    row = _six(value, where)
    _require_short(row, where)
    return row


def _six(value: Any, where: str) -> list[float]:
    entry = mapping(value, where, SIX)
    row = [number(entry[key], f"{where}: {key}") for key in SIX]
    for key, angle in zip(SIX[3:], row[3:], strict=True):
        if abs(angle) > ANGLE_LIMIT:
            raise InputError(
                f"{where}: {key} is {angle:g}, more than a full turn, so it seems to be in degrees;"
                f" write radians ({math.radians(angle):.6g})"
            )
    return row


def _require_short(row: Sequence[float], where: str) -> None:
    for key, length in zip(SIX[:3], row[:3], strict=True):
        if abs(length) > LENGTH_LIMIT:
            raise InputError(
                f"{where}: {key} is {length:g}, longer than any arm's link, so it seems to be in millimetres;"
                f" write metres ({length / 1000:.6g})"
            )


@np.errstate(over="ignore", invalid="ignore")  # absurd numbers are out of reach
def within_reach(links: Array, limit: float = LENGTH_LIMIT) -> bool:
    """Whether the flange of a chain (joint, 4, 4) stays within `limit` m of the base: single long links may cancel.

    They do along axes that are nearly parallel, whose common normal is far away.
    """
    flange = frames.chain(links, frames.sample_joints(len(links)))[:, :3, 3]
    return bool(np.linalg.norm(flange, axis=1).max() <= limit)


def convention(value: Any, where: str) -> str | None:
    """The convention of a DH table, `STANDARD` or `MODIFIED` by any of its names; None where none is given.

    Raises:
        InputError: another word.
    """
    if value is None:
        return None
    if str(value).lower() not in _CONVENTIONS:
        raise InputError(f"{where} is {str(value)[:40]!r}; write {STANDARD} or {MODIFIED} (Craig's)")
    return _CONVENTIONS[str(value).lower()]


def sliding(value: Any, where: str) -> tuple[Any, tuple[int, ...]]:
    """A description's table `kinematics` without the joints' types, and its prismatic joints, counted from 0.

    Raises:
        InputError: a type that is none of `TYPES`, or a prismatic joint of another name than joint1, joint2, ….
    """
    if not isinstance(value, Mapping) or not any(isinstance(row, Mapping) and "type" in row for row in value.values()):
        return value, ()
    rest, found = {}, []
    for joint, row in value.items():
        kind = row.get("type", TYPES[0]) if isinstance(row, Mapping) else TYPES[0]
        if kind not in TYPES:
            raise InputError(f"{where}: {joint}: type is {str(kind)[:40]!r}; write {' or '.join(TYPES)}")
        if kind == TYPES[1]:
            found.append(str(joint))
        rest[joint] = {key: n for key, n in row.items() if key != "type"} if isinstance(row, Mapping) else row
    for joint in found:
        if not re.fullmatch(r"joint[1-9][0-9]?", joint):
            raise InputError(f"{where}: {joint} is prismatic; name the joints of such an arm joint1, joint2, …")
    return rest, tuple(sorted(int(joint[5:]) - 1 for joint in found))


def kinematics(value: Any, where: str) -> tuple[Array, tuple[str, ...]]:
    """The six-parameter table below a file's key `kinematics`, in the vendor's form or in Universal Robots'.

    Returns:
        (joint, 6) x y z roll pitch yaw in m and rad, and the joints' names for messages.

    Raises:
        InputError: a joint missing or unknown, or as `six_numbers`; the line names the joint.
    """
    if not isinstance(value, Mapping) or not value:
        raise InputError(
            f"{where}: kinematics must be a mapping with the joints joint1, joint2, …; write one per joint"
        )
    keys = {str(key): entry for key, entry in value.items()}
    if any(key in UR_JOINTS for key in keys):
        keys.pop("hash", None)  # it identifies the record in the controller and is not a parameter of the chain
        joints, names = UR_JOINTS, tuple(f"joint{i + 1} ({name})" for i, name in enumerate(UR_JOINTS))
    else:
        found = [int(key[5:]) for key in keys if re.fullmatch(r"joint[1-9][0-9]?", key)]
        joints = names = tuple(f"joint{i + 1}" for i in range(max(found, default=1)))
    for key in keys:
        if key not in joints:
            raise InputError(f"{where}: kinematics has the unknown joint {key!r}; {suggestion(key, joints)}")
    for joint, name in zip(joints, names, strict=True):
        if joint not in keys:
            raise InputError(f"{where}: {name} is missing from kinematics; add its {', '.join(SIX)}")
    places = [f"{where}: {name}" for name in names]
    rows = np.array([_six(keys[joint], place) for joint, place in zip(joints, places, strict=True)])
    if np.abs(rows[:, :3]).max() > LENGTH_LIMIT and not within_reach(
        np.array([frames.transform_from_row(row) for row in rows])
    ):
        for row, place in zip(rows, places, strict=True):
            _require_short(row.tolist(), place)
    return rows, names


def yaml_number(value: float) -> str:
    """The shortest decimal that every YAML reader reads as exactly this float."""
    text = repr(float(value))
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def yaml_row(keys: Sequence[str], values: ArrayLike) -> str:
    """`{key: number, …}` on one line."""
    row = np.asarray(values, float)
    return "{" + ", ".join(f"{key}: {yaml_number(value)}" for key, value in zip(keys, row, strict=True)) + "}"


def yaml_list(values: ArrayLike) -> str:
    """`[number, …]` on one line."""
    return "[" + ", ".join(yaml_number(value) for value in np.asarray(values, float)) + "]"
