"""Columns by their documented names, or by those that a sidecar gives them: what they hold, or all that is wrong."""

import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import NamedTuple

from lite6jax.recordings.columns.column import (
    ANGLES,
    DEVIATION,
    IGNORED,
    MATRIX,
    PLACE,
    QUANTITIES,
    QUATERNION,
    READINGS,
    Column,
    is_per_joint,
    spelled,
    units_of,
)

TEXTS = ("gap",)
"""Columns of words, for people."""
_STD = re.compile(r"[a-z]+\d*_std_[a-zA-Z]+")
"""Standard deviations, as `predict` and `compensate` write them beside what can be read again."""
_NAME = re.compile(
    r"(?P<quantity>(?:cmd_)?[a-z]+?)(?P<joint>\d*)(?:_(?P<unit>.*))?", re.IGNORECASE | re.DOTALL | re.ASCII
)
_TORQUE_COMMAND = re.compile(r"cmd_tau\d+_.*")
"""A commanded torque of a joint, which is diagnosed as a torque where nothing else is."""
_SHOWN = 8


class _Misspelling(NamedTuple):
    """A name that is nearly one of a recording's: of which quantity, what is wrong, and what to write."""

    quantity: str
    problem: str
    remedy: str


def _parse_name(name: str) -> Column | _Misspelling | None:
    """What a name means; None where nothing."""
    if name in MATRIX:
        return Column(name, name)
    match = _NAME.fullmatch(name)
    quantity = match["quantity"].lower() if match else ""
    if match is None or quantity not in QUANTITIES or (match["joint"] and not is_per_joint(quantity)):
        return None
    joint = int(match["joint"][:3] or 0)
    definition = QUANTITIES[quantity]
    for unit in (*definition.units, *definition.of_slide):
        if name == spelled(quantity, joint, unit) and (joint or not definition.per_joint):
            return Column(name, quantity, joint, unit)
    if not definition.common:
        return None
    if definition.per_joint and not joint:
        problem = "joints are numbered from 1"
    elif match["quantity"] != quantity or (match["unit"] or "") in definition.units:
        problem = "is not spelled as it must be"
    elif match["unit"]:
        problem = f"the unit {match['unit'][:40]!r} is unknown"
    else:
        problem = "has no unit" if "" in definition.units else "the unit is missing"
    return _Misspelling(quantity, problem, _forms(quantity, joint or 1))


def known_column(name: str) -> Column | None:
    """What a name of a recording's column says; None where it is none."""
    parsed = _parse_name(name)
    return parsed if isinstance(parsed, Column) else None


def is_standard(name: str) -> bool:
    """Tells whether a table's column of this name is read, or passed over, without a sidecar's help."""
    return name in TEXTS or _STD.fullmatch(name) is not None or known_column(name) is not None


def is_refused(name: str) -> bool:
    """Tells whether a table's column of this name has to be named or ignored by a sidecar."""
    return not _STD.fullmatch(name) and isinstance(_parse_name(name), _Misspelling)


def reading_of(name: str) -> str:
    """The kind of reading that a column of this name belongs to; empty of any other."""
    column = known_column(name)
    return next((kind for kind, parts in READINGS.items() if column and column.quantity in parts), "")


def nearest_known(name: str) -> str | None:
    """The column that an ignored one may have meant."""
    if name in {part for form in ANGLES for part in form}:
        return spelled(name)
    spellings = [spelled(quantity, int(is_per_joint(quantity))) for quantity in QUANTITIES]
    return next(iter(get_close_matches(name, spellings, n=1, cutoff=0.8)), None)


def list_names(names: Sequence[str]) -> str:
    """The first of the names of a table, for messages."""
    return ", ".join(repr(name[:40]) for name in names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def _forms(quantity: str, joint: int) -> str:
    units = units_of(quantity, fine=False)
    return " or ".join(spelled(quantity, joint * is_per_joint(quantity), unit) for unit in units)


# ------------------------------------------------------------------ all columns of a table


def parse_columns(
    names: Sequence[str],
    dof: int | None = None,
    joints_optional: bool = False,
    renamed: Mapping[str, str] | None = None,
) -> tuple[dict[str, Column], int, list[str], list[str]]:
    """What the columns of a table mean.

    Problems are a unit that is missing or unknown, a quantity given twice, a joint left out, a position or an
    orientation in part, no joint positions, another number of joints than `dof`, and absent names in `renamed`.

    Args:
        names: the column names, in order.
        dof: the number of joints expected, where known.
        joints_optional: whether joint positions may be absent; then `dof` is to be known.
        renamed: of columns with names of their own, the names that they would have here, or `IGNORED`.

    Returns:
        the columns by their SI name; how many joints; names that mean nothing here and are not to be ignored; and what
        makes the table unusable, each with its remedy.
    """
    declared = renamed or {}
    present = {*names, *(name.strip() for name in names)}
    recognised: dict[str, Column] = {}
    ignored: list[str] = []
    problems = [
        f"column {name[:60]!r} of the sidecar is not in the table; it has {list_names(names)}"
        for name in declared
        if name.strip() not in present and name not in present
    ]
    by_problem: dict[
        tuple[str, str], tuple[int, list[str]]
    ] = {}  # the place of a problem, and the next columns with it
    unclear: set[str] = set()
    for place, raw in enumerate(names):
        stripped = raw.strip()
        name = declared.get(raw, declared.get(stripped, stripped))
        if name == IGNORED or name in TEXTS or _STD.fullmatch(name):
            continue
        meant = _parse_name(name)
        if meant is None and name != stripped:
            problem = f"the sidecar names it {name[:40]!r}, which means nothing here"
            remedy = f"{nearest_known(name) or 'q1_rad, x_m, tau1_Nm and the like'}, or {IGNORED}"
            meant = _Misspelling(name, problem, remedy)
            name = stripped
        if meant is None:
            ignored.append(raw)
        elif isinstance(meant, _Misspelling):
            unclear.add(meant.quantity)
            group = next((parts[0] for parts in (PLACE, QUATERNION) if meant.quantity in parts), meant.quantity)
            shown = stripped if stripped == name else f"{stripped} ({name})"
            if (key := (group, meant.problem)) in by_problem:
                by_problem[key][1].append(shown)
                continue
            by_problem[key] = len(problems), []
            problems.append(f"column {shown[:60]!r}: {meant.problem}; write {meant.remedy}")
        elif (twin := recognised.get(meant.si_name)) is None:
            recognised[meant.si_name] = meant._replace(name=stripped, place=place)
        elif twin.name == stripped:
            problems.append(f"column {stripped} stands there twice; keep one")
        else:
            problems.append(f"columns {twin.name} and {stripped} give the same quantity; keep one")
    for number, further in by_problem.values():
        problems[number] += f" (and likewise {list_names(further)})" if further else ""
    joints = max((column.joint for column in recognised.values() if column.quantity == "q"), default=0)
    if not joints and not joints_optional and "q" not in unclear:
        problems.append(
            f"has no joint positions; name their columns q1_rad ... qN_rad (or q1_deg ...); it has {list_names(names)}"
        )
    highest_joint = joints
    joints = joints or (dof or 0) * joints_optional
    if "q" not in unclear:
        problems += _check_joints(recognised, highest_joint, joints, unclear)
    if joints and dof is not None and joints != dof:
        problems.append(f"has {joints} joints (q1 ... q{joints}), the arm has {dof}; choose the arm it is of")
    quantities = {column.quantity for column in recognised.values()}
    torques = [name for name in ignored if _TORQUE_COMMAND.fullmatch(name.strip())]
    if torques and not quantities & {"cmd", "cmd_dq", "tau", "current"}:
        problems.append(
            f"columns {list_names(torques)}: commands of torque are diagnosed as torques; write tau1_Nm ... in place "
            "of cmd_tau1_Nm ..."
        )
    return recognised, joints, ignored, problems + _check_groups(recognised, unclear)


def sliding_of(columns: Mapping[str, Column]) -> tuple[int, ...]:
    """The joints, counted from 0, whose positions are lengths."""
    return tuple(sorted(column.joint - 1 for column in columns.values() if column.quantity == "q" and column.slides))


def _check_joints(recognised: Mapping[str, Column], highest_joint: int, joints: int, unclear: set[str]) -> list[str]:
    """What is wrong with columns of some joints, or of another kind of joint than its position is."""
    problems = []
    expected = set(range(1, joints + 1))
    positions = {c.joint: c for c in recognised.values() if c.quantity == "q"}
    problems += [
        f"{_forms('q', joint)} is missing while q{highest_joint} is there; give every joint"
        for joint in sorted(set(range(1, highest_joint)) - positions.keys())
    ]
    for quantity in (name for name, definition in QUANTITIES.items() if definition.per_joint and name != "q"):
        present = {column.joint for column in recognised.values() if column.quantity == quantity}
        if not joints or not present or quantity in unclear:
            continue
        if surplus := present - expected:
            problems.append(
                f"column {_forms(quantity, min(surplus))}: the joint positions end with q{joints}; "
                f"add q{min(surplus)} or remove the column"
            )
        if missing := expected - present:
            problems.append(f"{_forms(quantity, min(missing))} is missing beside its like; give it for all joints")
    for column in recognised.values():
        position = positions.get(column.joint)
        slide_units = QUANTITIES[column.quantity].of_slide
        if slide_units and position is not None and column.slides != position.slides:
            forms = " or ".join(spelled(column.quantity, column.joint, unit)
                                for unit in units_of(column.quantity, position.slides))  # fmt: skip
            problems.append(f"column {column.name} does not fit {position.name}; write {forms}")
    return problems


def _check_groups(recognised: Mapping[str, Column], unclear: set[str]) -> list[str]:
    """What is wrong with positions and orientations in part, twice, or without each other."""
    problems = []
    orientations = []
    for group in (PLACE, DEVIATION, QUATERNION, MATRIX, *ANGLES):
        missing = [quantity for quantity in group if spelled(quantity) not in recognised]
        if len(missing) < len(group) and group not in (PLACE, DEVIATION):
            orientations.append(group)
        if 0 < len(missing) < len(group) and not unclear & set(group):
            problems.append(f"{_forms(missing[0], 0)} is missing; give all of {_together(group)}, or none")
    if len(orientations) > 1:
        problems.append(
            f"has the orientation twice, {_together(orientations[0])} and {_together(orientations[1])}; keep one"
        )
    if orientations and "x_m" not in recognised and not unclear & set(PLACE):
        problems.append(f"has the orientation {_together(orientations[0])} without a position; add x_m y_m z_m")
    if spelled(DEVIATION[0]) in recognised and "x_m" not in recognised and not unclear & set(PLACE):
        problems.append(f"has deviations {_together(DEVIATION)} without the nominal positions; add x_m y_m z_m")
    return problems


def _together(group: Iterable[str]) -> str:
    return " ".join(map(spelled, group))
