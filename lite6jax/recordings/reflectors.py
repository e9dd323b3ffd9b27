"""Three or more points on one rigid body, measured in each row, become its pose.

The body's shape is the mean of all rows after each is carried onto it (J. C. Gower, Psychometrika 40, 1975); the pose
of a row carries the shape onto its points (W. Kabsch, Acta Cryst. A32, 1976). Axes are those of the sensor at the first
row in which all points are seen.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from lite6jax.array_types import Array, Mask
from lite6jax.recordings.alignment import median_distance
from lite6jax.recordings.columns import sizes
from lite6jax.recordings.columns.column import units_of
from lite6jax.recordings.columns.names import list_points, unit_of

FEWEST_POINTS = 3
_RIGID = 0.02
"""Of the way of the points: their distances from each other, which a rigid body keeps, vary by less."""
_FLAT = 0.05
"""Of the width of the body: the least that it is beside its longest axis."""
_ROUNDS = 10
_OUTLYING = 10.0
"""Times the usual misfit of a row, beyond which it shows another shape: exchanged points or a bumped reflector."""


class RigidPose(NamedTuple):
    """Poses of a rigid body.

    Attributes:
        rows: `(row,)` bool, where a pose was found.
        position: `(row, 3)`, the centre of all its points, in their unit; NaN elsewhere.
        quaternion: `(row, 4)`, unit, scalar first.
        misfit: RMS distance of the points from the shape, in their unit.
        size: RMS distance of the points of the shape from its centre.
        points: how many.
        outlying: rows whose points show another shape.
    """

    rows: Mask
    position: Array
    quaternion: Array
    misfit: float
    size: float
    points: int
    outlying: int

    @property
    def position_noise(self) -> float:
        """Noise of an axis, in the unit of the points: six of their numbers, three each, went into the pose."""
        return self.misfit / np.sqrt(3 * self.points - 6)

    @property
    def orientation_noise(self) -> float:
        """rad about an axis, roughly, as bodies are not as wide in all directions."""
        return self.misfit / (self.size * np.sqrt(2 * self.points - 4))


class WithPose(NamedTuple):
    """A table in which points were replaced by the pose of the body that they are on.

    Attributes:
        columns: of the table.
        points: the columns that were replaced.
        pose: of the body, in `unit`.
        unit: of the points.
    """

    columns: dict[str, Array]
    points: tuple[tuple[str, str, str], ...]
    pose: RigidPose
    unit: str


def with_pose_of_reflectors(
    columns: Mapping[str, Array], candidates: Sequence[tuple[str, str, str]] | None = None
) -> WithPose | None:
    """A table with a pose in place of three or more points of a rigid body; None where it has no such points.

    Args:
        columns: `(row,)` numbers by name.
        candidates: the columns x y z of each point; by their names where not given.
    """
    points = _rigid_points(list_points(list(columns)) if candidates is None else candidates, columns)
    if not points:
        return None
    body = _rigid_pose(np.stack([np.stack([columns[name] for name in point], 1) for point in points], 1))
    if body is None:
        return None
    names = {name for point in points for name in point}
    units = {unit for point in points if (unit := unit_of(point[0])) in units_of("x")}
    unit = units.pop() if len(units) == 1 else sizes.length_unit(body.position).choice
    pose = {f"{axis}_{unit}": column for axis, column in zip("xyz", body.position.T, strict=True)}
    pose |= dict(zip(("qw", "qx", "qy", "qz"), body.quaternion.T, strict=True))
    remaining = {name: column for name, column in columns.items() if name not in names | pose.keys()}
    return WithPose(remaining | pose, tuple(points), body, unit)


def _rigid_points(points: Sequence[tuple[str, str, str]], columns: Mapping[str, Array]) -> list[tuple[str, str, str]]:
    """Those of some points that keep their distances from each other while they move: the largest such group."""
    placed = {point: _seen(np.stack([columns[name] for name in point], 1)) for point in points}
    visible = map(sizes.complete_rows, placed.values())
    travel = max((median_distance(places) for places in visible if len(places)), default=0.0)

    def keeps(first: Array, second: Array) -> bool:
        distance = np.linalg.norm(first - second, axis=1)
        distance = distance[np.isfinite(distance)]
        if len(distance) < FEWEST_POINTS:
            return False
        usual = float(np.median(distance))
        varies = 1.4826 * float(np.median(np.abs(distance - usual)))
        return varies < _RIGID * travel and usual > 5 * varies and usual > 0

    groups: list[list[tuple[str, str, str]]] = []
    for point, place in placed.items():
        fitting = (group for group in groups if all(keeps(place, placed[member]) for member in group))
        if (group := next(fitting, None)) is None:
            groups.append(group := [])
        group.append(point)
    largest = max(groups, key=len, default=[])
    return largest if len(largest) >= FEWEST_POINTS else []


def _rigid_pose(points: Array) -> RigidPose | None:
    """The poses of a rigid body by its points; None where the points lie on a line, or no row has all of them.

    Args:
        points: `(row, point, 3)`; NaN, or zero throughout, where a point is not seen. Three points give a pose.
    """
    from scipy.spatial.transform import Rotation

    points = np.stack([_seen(points[:, k]) for k in range(points.shape[1])], 1)
    visible = np.isfinite(points.sum(axis=2))
    complete = np.flatnonzero(visible.all(axis=1))
    rows = visible.sum(1) >= FEWEST_POINTS
    if not complete.size:
        return None
    shape = points[complete[0]] - points[complete[0]].mean(0)
    spread = np.linalg.svd(shape, compute_uv=False)
    if spread[1] < _FLAT * spread[0]:
        return None
    axes = shape
    filled = np.nan_to_num(points[rows])
    weight = visible[rows].astype(float)
    for _ in range(_ROUNDS):
        R, t = _carried(shape, filled, weight)
        in_body = np.einsum("rji,rpj->rpi", R, filled - t[:, None])
        shape = np.einsum("rp,rpi->pi", weight, in_body) / np.maximum(weight.sum(0), 1)[:, None]
        turn, move = _carried(shape, axes[None], np.ones((1, len(axes))))  # the shape stays where it was first seen
        shape = shape @ turn[0].T + move[0]
        shape -= shape.mean(0)
    R, t = _carried(shape, filled, weight)
    missed = np.linalg.norm(filled - np.einsum("rij,pj->rpi", R, shape) - t[:, None], axis=2)
    of_row = np.sqrt((weight * missed**2).sum(1) / weight.sum(1))
    usual = max(float(np.median(of_row)), 1e-12)
    fits = of_row <= _OUTLYING * usual
    fitted_rows = np.flatnonzero(rows)[fits]
    is_fitted = np.isin(np.arange(len(points)), fitted_rows)
    pose = np.full((len(points), 7), np.nan)
    pose[fitted_rows, :3], pose[fitted_rows, 3:] = t[fits], Rotation.from_matrix(R[fits]).as_quat(scalar_first=True)
    misfit = float(np.sqrt(np.sum((weight * missed**2)[fits]) / max(np.sum(weight[fits]), 1)))
    size = float(np.sqrt(np.mean(np.sum(shape**2, 1))))
    return RigidPose(is_fitted, pose[:, :3], pose[:, 3:], misfit, size, points.shape[1], int(np.sum(~fits)))


def _carried(shape: Array, points: Array, weight: Array) -> tuple[Array, Array]:
    """The rotations `(row, 3, 3)` and translations `(row, 3)` that carry a shape onto the points of each row."""
    share = weight / weight.sum(1, keepdims=True)
    a = share @ shape
    b = np.einsum("rp,rpi->ri", share, points)
    M = np.einsum("rp,rpi,rpj->rij", share, points - b[:, None], shape - a[:, None])
    U, _, Vt = np.linalg.svd(M)
    U[..., 2] *= np.linalg.det(U @ Vt)[:, None]
    R = U @ Vt
    return R, b - np.einsum("rij,rj->ri", R, a)


def _seen(place: Array) -> Array:
    """`(row, 3)` with NaN where all three are zero, as trackers write what they do not see."""
    return np.where((place == 0).all(1, keepdims=True), np.nan, place)
