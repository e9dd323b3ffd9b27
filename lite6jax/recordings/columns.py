"""The column names of a recording: which quantity, which joint, which unit."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from math import pi

from lite6jax.errors import InputError

# quantity -> accepted units, the SI one first, each with the divisor that leads to it: dividing by 1000 rounds
# correctly, multiplying by 0.001 does not
_PER_JOINT = {
    "q": {"rad": 1.0, "deg": 180 / pi},
    "dq": {"rad_per_s": 1.0, "deg_per_s": 180 / pi},
    "ddq": {"rad_per_s2": 1.0, "deg_per_s2": 180 / pi},
    "tau": {"Nm": 1.0, "mNm": 1e3},
    "current": {"A": 1.0, "mA": 1e3},
    "temp": {"degC": 1.0},
}
_SCALAR = {
    "time": {"s": 1.0, "ms": 1e3, "us": 1e6},
    **{axis: {"m": 1.0, "mm": 1e3} for axis in "xyz"},
    **{part: {"": 1.0} for part in ("qw", "qx", "qy", "qz")},
    "ambient": {"degC": 1.0},
    "payload": {"kg": 1.0},
    "run": {"": 1.0},
    "missing": {"": 1.0},
}
_TEXTS = ("gap",)
"""Columns of words, for people."""
_NAME = re.compile(r"(?P<quantity>[a-z]+?)(?P<joint>\d*)(?:_(?P<unit>.*))?", re.IGNORECASE | re.DOTALL | re.ASCII)


@dataclass(frozen=True)
class Column:
    """A recognised column: its name and place in the file, and what it holds, in SI once divided by `divisor`."""

    name: str
    index: int
    quantity: str
    joint: int  # 1-based, 0 for a quantity that is not per joint
    unit: str
    divisor: float

    @property
    def si_name(self) -> str:
        return _spelled(self.quantity, self.joint, 0)


def recognise(
    names: Sequence[str], source: str, dof: int | None = None, joints_optional: bool = False
) -> tuple[dict[str, Column], int, list[str]]:
    """What the columns of a table mean.

    Args:
        names: the column names, in order.
        source: the file's name, for messages.
        dof: the number of joints expected, where known.
        joints_optional: whether joint positions may be absent; then `dof` is to be known.

    Returns:
        the recognised columns by their SI name, the number of joints, and the names that mean nothing here.

    Raises:
        InputError: a unit missing or unknown, a quantity given twice, a joint left out, a position or quaternion in
            part, no joint positions, or another number of joints than `dof`.
    """
    found: dict[str, Column] = {}
    ignored: list[str] = []
    for index, raw in enumerate(names):
        if raw.strip() in _TEXTS:
            continue
        column = _column(raw.strip(), index, source)
        if column is None:
            ignored.append(raw)
        elif (twin := found.get(column.si_name)) is None:
            found[column.si_name] = column
        elif twin.name == column.name:
            raise InputError(f"{source}: column {column.name} stands there twice; keep one")
        else:
            raise InputError(f"{source}: columns {twin.name} and {column.name} give the same quantity; keep one")
    without = joints_optional and not any(column.quantity == "q" for column in found.values())
    joints = dof if without and dof is not None else _joint_count(found, names, source)
    if dof is not None and joints != dof:
        raise InputError(
            f"{source}: has {joints} joints (q1 ... q{joints}), the arm has {dof}; choose the arm it is of"
        )
    for quantity in _PER_JOINT:
        present = {column.joint for column in found.values() if column.quantity == quantity}
        if surplus := present - set(range(1, joints + 1)):
            raise InputError(
                f"{source}: column {_forms(quantity, min(surplus))}: the joint positions end with q{joints}; "
                f"add q{min(surplus)} or remove the column"
            )
        if present and (missing := set(range(1, joints + 1)) - present):
            raise InputError(
                f"{source}: {_forms(quantity, min(missing))} is missing beside its like; give it for all joints"
            )
    for group in (["x", "y", "z"], ["qw", "qx", "qy", "qz"]):
        missing = [quantity for quantity in group if _spelled(quantity, 0, 0) not in found]
        if missing and len(missing) < len(group):
            needed = " ".join(_spelled(quantity, 0, 0) for quantity in group)
            raise InputError(f"{source}: {_forms(missing[0], 0)} is missing; give all of {needed}, or none")
    if "qw" in found and "x_m" not in found:
        raise InputError(f"{source}: has the orientation qw qx qy qz without a position; add x_m y_m z_m")
    return found, joints, ignored


def _column(name: str, index: int, source: str) -> Column | None:
    match = _NAME.fullmatch(name)
    quantity = match["quantity"].lower() if match else ""
    per_joint = quantity in _PER_JOINT
    if match is None or not (per_joint or (quantity in _SCALAR and not match["joint"])):
        return None
    units = _units(quantity)
    joint, unit = int(match["joint"][:9] or 0), match["unit"]
    for number, (accepted, divisor) in enumerate(units.items()):
        if name == _spelled(quantity, joint, number) and (joint or not per_joint):
            return Column(name, index, quantity, joint, accepted, divisor)
    forms = _forms(quantity, joint or 1)
    if per_joint and not joint:
        problem = "joints are numbered from 1"
    elif match["quantity"] != quantity or (unit or "") in units:
        problem = "is not spelled as it must be"
    else:
        problem = (
            f"the unit {unit[:40]!r} is unknown"
            if unit
            else "the unit is missing"
            if "" not in units
            else "has no unit"
        )
    raise InputError(f"{source}: column {name[:60]!r}: {problem}; write {forms}")


def _joint_count(found: dict[str, Column], names: Sequence[str], source: str) -> int:
    joints = {column.joint for column in found.values() if column.quantity == "q"}
    if not joints:
        shown = ", ".join(repr(name[:40]) for name in names[:8]) + (", ..." if len(names) > 8 else "")
        raise InputError(
            f"{source}: has no joint positions; name their columns q1_rad ... qN_rad (or q1_deg ...); it has {shown}"
        )
    for joint in range(1, max(joints)):
        if joint not in joints:
            raise InputError(
                f"{source}: {_forms('q', joint)} is missing while q{max(joints)} is there; give every joint"
            )
    return max(joints)


def _spelled(quantity: str, joint: int, number: int) -> str:
    unit = list(_units(quantity))[number]
    return f"{quantity}{joint or ''}" + (f"_{unit}" if unit else "")


def _forms(quantity: str, joint: int) -> str:
    if quantity not in _PER_JOINT:
        joint = 0
    return " or ".join(_spelled(quantity, joint, number) for number in range(len(_units(quantity))))


def _units(quantity: str) -> dict[str, float]:
    return _PER_JOINT[quantity] if quantity in _PER_JOINT else _SCALAR[quantity]


def nearest_known(name: str) -> str | None:
    """The column that an ignored one may have meant."""
    known = [_spelled(quantity, 1 if quantity in _PER_JOINT else 0, 0) for quantity in (*_PER_JOINT, *_SCALAR)]
    return next(iter(get_close_matches(name, known, n=1, cutoff=0.8)), None)
