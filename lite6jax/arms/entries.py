"""Entries of the files of an arm: checks of numbers and keys whose messages name the place, and YAML that is exact."""

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lite6jax import storage
from lite6jax.arms import frames
from lite6jax.array_types import Array
from lite6jax.errors import InputError

SIX = ("x", "y", "z", "roll", "pitch", "yaw")
UR_JOINTS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")

TYPES = ("revolute", "prismatic")
"""What the joints of a description can be; the first where nothing is said."""

STANDARD = "standard"
MODIFIED = "modified"
_CONVENTIONS = {STANDARD: STANDARD, "dh": STANDARD, "sdh": STANDARD, "distal": STANDARD} | dict.fromkeys(
    (MODIFIED, "mdh", "craig", "proximal"), MODIFIED
)

# m and rad; larger values are in millimetres or degrees.
LENGTH_LIMIT = 10.0
ANGLE_LIMIT = 2 * math.pi + 1e-6

# YAML 1.1 reads 1e-5 as a string because it has no decimal point.
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def number(value: Any, where: str) -> float:
    """The value as a float; refuses a boolean, what is not finite and what is no number."""
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
    """A list of `count` floats; refuses another length, or as `number`."""
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != count:
        raise InputError(f"{where} must be a list of {count} numbers; write [{', '.join(['0.0'] * count)}]")
    return [number(entry, f"{where} number {i + 1}") for i, entry in enumerate(value)]


def mapping(value: Any, where: str, required: Sequence[str], optional: Sequence[str] = ()) -> Mapping[str, Any]:
    """The value as a mapping with these keys; refuses one that is missing or unknown."""
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


def row(value: Any, where: str, keys: Sequence[str], optional: Sequence[str] = ()) -> list[float]:
    """The numbers under these keys of a mapping that has them, and may have others."""
    entry = mapping(value, where, keys, optional)
    return [number(entry[key], f"{where}: {key}") for key in keys]


def six_numbers(value: Any, where: str, optional: Sequence[str] = (), limit: float = LENGTH_LIMIT) -> list[float]:
    """x y z roll pitch yaw, m and rad, of a mapping with these keys, and perhaps those that are `optional`.

    Refuses angles beyond a full turn (degrees?) and lengths beyond `limit` m (millimetres?).
    """
    six = row(value, where, SIX, optional)
    for key, number in zip(SIX, six, strict=True):
        if key in SIX[3:] and abs(number) > ANGLE_LIMIT:
            raise InputError(
                f"{where}: {key} is {number:g}, more than a full turn, so it seems to be in degrees;"
                f" write radians ({math.radians(number):.6g})"
            )
        if key in SIX[:3] and abs(number) > limit:
            raise InputError(
                f"{where}: {key} is {number:g}, longer than any arm's link, so it seems to be in millimetres;"
                f" write metres ({number / 1000:.6g})"
            )
    return six


@np.errstate(over="ignore", invalid="ignore")  # absurd numbers are out of reach
def is_reachable(links: Array, limit: float = LENGTH_LIMIT) -> bool:
    """Tells whether the flange of a chain (joint, 4, 4) stays within `limit` m of the base; long links may cancel.

    They do along axes that are nearly parallel, whose common normal is far away.
    """
    flange = frames.chain(links, frames.sample_joints(len(links)))[:, :3, 3]
    return bool(np.linalg.norm(flange, axis=1).max() <= limit)


def convention(value: Any, where: str) -> str | None:
    """The convention of a DH table, `STANDARD` or `MODIFIED` by any of its names; None where none is given."""
    if value is None:
        return None
    if str(value).lower() not in _CONVENTIONS:
        raise InputError(f"{where} is {str(value)[:40]!r}; write {STANDARD} or {MODIFIED} (Craig's)")
    return _CONVENTIONS[str(value).lower()]


def kinematics(value: Any, where: str, typed: bool = False) -> tuple[Array, tuple[str, ...], tuple[int, ...]]:
    """The six-parameter table below a file's key `kinematics`, in the vendor's form or in Universal Robots'.

    Rows may have a `type`, one of `TYPES`, where they are `typed`.

    Returns:
        (joint, 6) x y z roll pitch yaw in m and rad, the joints' names for messages, and the prismatic joints, counted
        from 0.
    """
    if not isinstance(value, Mapping) or not value:
        raise InputError(
            f"{where}: kinematics must be a mapping with the joints joint1, joint2, …; write one per joint"
        )
    keys = {str(key): entry for key, entry in value.items()}
    if any(key in UR_JOINTS for key in keys):
        keys.pop("hash", None)  # it identifies the record in the controller and is not a parameter of the chain
        joints = UR_JOINTS
        names = tuple(f"joint{i + 1} ({name})" for i, name in enumerate(UR_JOINTS))
    else:
        joint_numbers = [int(key[5:]) for key in keys if re.fullmatch(r"joint[1-9][0-9]?", key)]
        joints = names = tuple(f"joint{i + 1}" for i in range(max(joint_numbers, default=1)))
    for key in keys:
        if key not in joints:
            raise InputError(f"{where}: kinematics has the unknown joint {key!r}; {suggestion(key, joints)}")
    rows = []
    sliding = []
    for i, (joint, name) in enumerate(zip(joints, names, strict=True)):
        if joint not in keys:
            raise InputError(f"{where}: {name} is missing from kinematics; add its {', '.join(SIX)}")
        rows.append(six_numbers(keys[joint], f"{where}: {name}", ("type",) if typed else (), math.inf))
        kind = keys[joint].get("type", TYPES[0])
        if kind not in TYPES:
            raise InputError(f"{where}: {name}: type is {str(kind)[:40]!r}; write {' or '.join(TYPES)}")
        sliding += [i] if kind == TYPES[1] else []
    table = np.array(rows)
    if np.abs(table[:, :3]).max() > LENGTH_LIMIT and not is_reachable(frames.transform_from_row(table)):
        for row, name in zip(rows, names, strict=True):  # says which is too long
            six_numbers(dict(zip(SIX, row, strict=True)), f"{where}: {name}")
    return table, names, tuple(sliding)


def write_yaml(content: Any, path: str | Path, overwrite: bool, flow: bool | None = False) -> Path:
    """Writes mappings, lists, text and numbers, of which every reader of YAML reads exactly these floats.

    With `flow` None the innermost mappings and lists are on one line, with False there is one entry a line.
    """
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    text = yaml.dump(
        content, Dumper=dumper, sort_keys=False, default_flow_style=flow, allow_unicode=True, width=1 << 20
    )
    return storage.write_atomically(path, text, overwrite)
