"""Programs of robots, whose points are the joints at which something was measured: of KUKA, Fanuc and ABB."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lite6jax.errors import InputError
from lite6jax.recordings.table import RawTable

SIZE_LIMIT = 1 << 24
_FLOAT = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_NUMBER = re.compile(_FLOAT)
_KUKA = re.compile(
    rf"(?:(\w+)\s*=\s*)?\{{((?:\s*(?:E6AXIS|E6POS)\s*:)?\s*(?:A1|X)\s+{_FLOAT}[^{{}}]*)\}}", re.IGNORECASE
)
_KUKA_PART = re.compile(rf"\b([A-Z]\w?)\s+({_FLOAT})")
_FANUC = re.compile(r"\bP\[(\d+)(?:\s*:\s*\"[^\"]*\")?\]\s*\{(.*?)\}\s*;", re.DOTALL)
_FANUC_PART = re.compile(rf"\b(J\d|[XYZWPR])\s*=\s*({_FLOAT})\s*(deg|mm)")
_ABB = re.compile(
    r"(?:\b(?:joint|rob)target\s+(\w+)\s*:=|\bMove\w+)\s*\[\s*\[([^\[\]]*)\]\s*,\s*\[([^\[\]]*)\]", re.IGNORECASE
)
_ABB_POSE = ("x [mm]", "y [mm]", "z [mm]", "qw", "qx", "qy", "qz")


class _Point(NamedTuple):
    """A point of a program: its name, and its numbers by the columns that they are."""

    name: str
    numbers: Mapping[str, float]


def read_program(path: Path, notes: list[str]) -> RawTable:
    """The points of a program in order: joints where it has some, else the poses of the tool that was programmed.

    Raises:
        InputError: too large, or without points.
    """
    with open(path, "rb") as file:
        content = file.read(SIZE_LIMIT + 1)
    if len(content) > SIZE_LIMIT:
        raise InputError(f"{path}: larger than {SIZE_LIMIT} bytes, so it is no program of a robot; check the name")
    text = content.decode("latin-1")
    points = [point for read in _READERS.get(path.suffix.lower(), ()) for point in read(text)]
    joints = [point for point in points if any(name.endswith("[deg]") and name[0] in "AJ" for name in point.numbers)]
    joints = [point for point in joints if "x [mm]" not in point.numbers]
    chosen = joints or points
    if not chosen:
        raise InputError(
            f"{path}: has no points of joints (KUKA's E6AXIS, Fanuc's P[n] with J1, ABB's jointtarget); write the "
            "joints as CSV"
        )
    longest = max(map(len, (point.numbers for point in chosen)))
    names = list(next(point.numbers for point in chosen if len(point.numbers) == longest))
    columns = {name: np.array([point.numbers.get(name, np.nan) for point in chosen]) for name in names}
    if len(chosen) < len(points):
        notes.append(f"{len(points) - len(chosen)} points of the program give a pose and no joints, and are left out")
    kind = "joints" if joints else "poses of its tool"
    notes.append(f"the {len(chosen)} {kind} are those of a program, as commanded: `joint_source: commanded` says so")
    labels = np.array([point.name for point in chosen], dtype=object)
    return RawTable.of_arrays({"point": labels, **columns} if any(labels) else columns)


def holds_program(text: str) -> bool:
    """Tells whether a text is KUKA's list of points, and no table: both end in .dat."""
    return re.search(r"^\s*DEFDAT\b|\bE6(AXIS|POS)\b|\{\s*A1\s", text, re.IGNORECASE | re.MULTILINE) is not None


def _kuka_points(text: str) -> Iterator[_Point]:
    for name, inside in _KUKA.findall(text):
        numbers = {key.upper(): float(value) for key, value in _KUKA_PART.findall(inside.upper())}
        axes = {f"A{k} [deg]": numbers[f"A{k}"] for k in range(1, 8) if f"A{k}" in numbers}
        if axes:
            yield _Point(name, axes)
        elif {*"XYZABC"} <= numbers.keys():
            yield _Point(name, _tool(numbers, "ABC"))


def _fanuc_points(text: str) -> Iterator[_Point]:
    for name, inside in _FANUC.findall(text):
        parts = {key: (float(value), unit) for key, value, unit in _FANUC_PART.findall(inside)}
        axes = {f"{key} [{unit}]": value for key, (value, unit) in parts.items() if key.startswith("J")}
        numbers = {key: value for key, (value, _) in parts.items()}
        if axes:
            yield _Point(f"P{name}", axes)
        elif {*"XYZWPR"} <= numbers.keys():
            yield _Point(f"P{name}", _tool(numbers, "WPR"))


def _tool(numbers: Mapping[str, float], angles: str) -> dict[str, float]:
    """The columns of a programmed pose of the tool."""
    place = {f"{axis.lower()} [mm]": numbers[axis] for axis in "XYZ"}
    return place | {f"{axis} [deg]": numbers[axis] for axis in angles}


def _abb_points(text: str) -> Iterator[_Point]:
    for name, first, second in _ABB.findall(text):
        values, turned = ([float(number) for number in _NUMBER.findall(part)] for part in (first, second))
        if len(values) == 3 and len(turned) == 4:
            yield _Point(name, dict(zip(_ABB_POSE, [*values, *turned], strict=True)))
        elif len(values) == 6:
            yield _Point(name, {f"J{k} [deg]": value for k, value in enumerate(values, 1)})


_READERS: Mapping[str, Sequence[Callable[[str], Iterator[_Point]]]] = {
    ".src": (_kuka_points,),
    ".dat": (_kuka_points,),
    ".ls": (_fanuc_points,),
    ".mod": (_abb_points,),
}
