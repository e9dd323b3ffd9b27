"""Tables with a row for each point of a state, such as markers on one body or tags on several."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array
from lite6jax.recordings.alignment import median_distance
from lite6jax.recordings.columns.cells import Points, Words, is_label, spread_points
from lite6jax.recordings.columns.column import list_columns
from lite6jax.recordings.columns.inspection import InspectedTable, Inspection
from lite6jax.recordings.reflectors import FEWEST_POINTS, WithPose, with_pose_of_reflectors

_STILL = 1e-3
"""Of the way of the joints: what they change within a state where they are read anew for each point."""
_ONE_PLACE = 0.01
"""Of the way of the points: the distance of two readings of one point."""
_TRIED = 8
"""Points of which the arm's kinematics are asked, the most often seen first."""


class StatesOfPoints(NamedTuple):
    """A table with a row for each state.

    Attributes:
        columns: of the table.
        found: how its rows were found.
        pose: of the body on which the points are; None where they are on none.
        taken: of these the label of the one whose readings are in the table.
    """

    columns: dict[str, Array]
    found: Points
    pose: WithPose | None = None
    taken: str = ""


def gather_points(
    columns: Mapping[str, Array], words: Mapping[str, Words], arm: Arm | None, meanings: Mapping[str, str], source: str
) -> StatesOfPoints | None:
    """A row for each state of a table with a row for each point; None where it is no such table.

    Three or more points on one body become its pose. Else, and where orientations stand beside the points, the one is
    taken with which the arm agrees best. Repeated readings of one point stay as they are.

    Args:
        columns: `(row,)` numbers by name.
        words: of its columns of text.
        arm: whose joints they are, where known.
        meanings: of columns.
        source: what messages begin with.
    """
    if not words and not any(map(is_label, columns)):
        return None
    inspection = InspectedTable.of(columns, source, arm, meanings).inspection
    joints = list_columns(inspection.blocks, "q")
    values = [name for pose in inspection.sources for name in pose.columns]
    for state in _possible_states(inspection, joints, columns, words):
        points = spread_points(columns, words, state, values, () if state == joints else joints)
        if points is None:
            continue
        moved = [columns[name] - points.columns[name][points.state] for name in joints]
        if any(np.nanmax(np.abs(m)) > _STILL * np.ptp(columns[name]) for name, m in zip(joints, moved, strict=True)):
            continue
        if all(len(names) == FEWEST_POINTS for names in points.points):
            body = with_pose_of_reflectors(points.columns, points.points)  # type: ignore[arg-type]
            if body is not None:
                return StatesOfPoints(body.columns, points, body)
        if joints and not _is_one_place(points):
            return _take_one(points, arm, meanings, source)
    return None


def _possible_states(
    inspection: Inspection, joints: list[str], columns: Mapping[str, Array], words: Mapping[str, Words]
) -> Iterator[list[str]]:
    """Columns that may be equal in all rows of a state: the joints, the times, or those that name poses."""
    yield joints
    yield list_columns(inspection.blocks, "time")
    used = {name for pose in inspection.sources for name in pose.columns} | {*joints}
    yield from ([name] for name in (*words, *filter(is_label, columns)) if name not in used)


def _is_one_place(points: Points) -> bool:
    """Tells whether the points that are seen most often are repeated readings of one."""
    first, second = (_place(points, k) for k in _most_seen(points)[:2])
    complete = np.isfinite(first + second).all(axis=1)
    distance = np.linalg.norm(first[complete] - second[complete], axis=1)
    return not len(distance) or float(np.median(distance)) < _ONE_PLACE * median_distance(first[complete])


def _place(points: Points, point: int) -> Array:
    """`(state, 3)`, the first three numbers of a point, in whatever unit."""
    return np.stack([points.columns[name] for name in points.points[point][:3]], 1)


def _most_seen(points: Points) -> list[int]:
    return sorted(range(len(points.labels)), key=lambda k: -points.counts[k])


def _take_one(points: Points, arm: Arm | None, meanings: Mapping[str, str], source: str) -> StatesOfPoints:
    """The states with the readings of one point: the one with which the arm agrees best, or that is seen most often."""
    tables = {k: _with_point(points, points.points[k]) for k in _most_seen(points)[:_TRIED]}
    errors = {k: InspectedTable.of(table, source, arm, meanings).inspection.error for k, table in tables.items()}
    closest = min(errors, key=lambda k: errors[k])
    return StatesOfPoints(tables[closest], points, taken=points.labels[closest])


def _with_point(points: Points, names: Sequence[str]) -> dict[str, Array]:
    """The columns of the states and those of one point, by the names that these had."""
    of_points = {name for columns in points.points for name in columns}
    remaining = {name: column for name, column in points.columns.items() if name not in of_points}
    return remaining | {value_name: points.columns[name] for value_name, name in zip(points.values, names, strict=True)}
