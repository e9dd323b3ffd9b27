"""Orientations and positions in every documented form, as unit quaternions and measured positions."""

from collections.abc import Mapping

import numpy as np

from lite6jax.array_types import Array, Mask
from lite6jax.errors import InputError
from lite6jax.recordings.columns.column import (
    ANGLES,
    DEVIATION,
    MATRIX,
    PLACE,
    QUATERNION,
    RPY,
    VECTOR,
    XYZ,
    ZYZ,
    spelled,
)

_EULER: dict[tuple[str, ...], str] = {RPY: "ZYX", XYZ: "XYZ", ZYZ: "ZYZ"}
"""Intrinsic sequences in SciPy's spelling, in the order of the columns; of `RPY` in the reverse order."""
NEARLY = 0.02
"""Of R Rᵀ from the identity: as far off is a matrix of which two digits are written."""


def quaternions(form: tuple[str, ...], values: Array) -> Array:
    """`(sample, 4)` unit quaternions, scalar first, of a form in rad or without unit; NaN where a number is.

    Args:
        form: one of `ANGLES`, or `MATRIX`.
        values: `(sample, part)`; of a matrix the nearest rotation is taken.
    """
    from scipy.spatial.transform import Rotation

    quaternion = np.full((len(values), 4), np.nan)
    complete = np.isfinite(values).all(axis=1)
    if not complete.any():
        return quaternion
    rows = values[complete]
    if form == MATRIX:
        left_vectors, _, right = np.linalg.svd(rows.reshape(-1, 3, 3))
        rotation = Rotation.from_matrix(left_vectors * np.linalg.det(left_vectors @ right)[:, None, None] @ right)
    elif form == VECTOR:
        rotation = Rotation.from_rotvec(rows)
    else:
        rotation = Rotation.from_euler(_EULER[form], rows[:, ::-1] if form == RPY else rows)
    quaternion[complete] = np.roll(rotation.as_quat(), 1, axis=1)
    return quaternion


def is_no_rotation(matrix: Array) -> Mask:
    """Rows of `(sample, 9)`, without gaps, whose matrix is no rotation: not orthogonal, or mirrored."""
    R = matrix.reshape(-1, 3, 3)
    with np.errstate(all="ignore"):
        far = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0) > NEARLY
        return np.isfinite(matrix).all(1) & (far | (np.linalg.det(R) < 0))


def add_deviations(values: Mapping[str, Array], notes: list[str]) -> dict[str, Array]:
    """Columns in SI units by their names, with the measured position in place of a nominal one and its deviation."""
    columns = dict(values)
    for axis, deviation in zip(map(spelled, PLACE), map(spelled, DEVIATION), strict=True):
        if axis in columns and deviation in columns:
            columns[axis] = columns[axis] + columns.pop(deviation)
    if len(columns) < len(values):
        notes.append("the measured position is the sum of the nominal one, x y z, and the deviation, devx devy devz")
    return columns


def with_quaternions(values: Mapping[str, Array], source: str = "recording") -> dict[str, Array]:
    """Columns in SI units by their names, with an orientation in another form replaced by its quaternions.

    Raises:
        InputError: a matrix that is no rotation.
    """
    columns = dict(values)
    for form in (*ANGLES, MATRIX):
        names = [spelled(part) for part in form]
        if all(name in columns for name in names):
            parts = np.stack([columns.pop(name) for name in names], axis=1)
            if form == MATRIX and (wrong := np.flatnonzero(is_no_rotation(parts))).size:
                turned = np.linalg.det(parts[wrong[0]].reshape(3, 3)) > 0
                raise InputError(
                    f"{source}: row {wrong[0] + 1}: r11 … r33 {'is not orthogonal' if turned else 'is mirrored'}, so "
                    "it is no rotation; name its columns row by row, or remove the row"
                )
            columns |= dict(zip(QUATERNION, quaternions(form, parts).T, strict=True))
    return columns
