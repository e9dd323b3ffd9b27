"""The forms in which a table may give orientations; a recording holds unit quaternions, scalar first.

| columns | R of the tool in the sensor's frame |
|---|---|
| `qw qx qy qz` | the unit quaternion |
| `rx_rad ry_rad rz_rad` | the rotation vector: the axis times the angle (Universal Robots) |
| `roll_rad pitch_rad yaw_rad` | Rz(yaw) Ry(pitch) Rx(roll) (UFACTORY, URDF; KUKA's C B A, Fanuc's W P R) |
| `rotx_rad roty_rad rotz_rad` | Rx(rotx) Ry(roty) Rz(rotz) (Staubli, Mecademic) |
| `alpha_rad beta_rad gamma_rad` | Rz(alpha) Ry(beta) Rz(gamma) (Kawasaki, Doosan) |
| `r11 r12 r13 r21 … r33` | the matrix, row by row (of T from the sensor to the tool) |
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lite6jax.errors import InputError
from lite6jax.recordings.columns import ANGLES, MATRIX, QUATERNION, spelled

Array = NDArray[np.floating]

VECTOR, RPY, XYZ, ZYZ = ANGLES
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

    found = np.full((len(values), 4), np.nan)
    given = np.isfinite(values).all(axis=1)
    if not given.any():
        return found
    rows = values[given]
    if form == MATRIX:
        left, _, right = np.linalg.svd(rows.reshape(-1, 3, 3))
        rotation = Rotation.from_matrix(left * np.linalg.det(left @ right)[:, None, None] @ right)
    elif form == VECTOR:
        rotation = Rotation.from_rotvec(rows)
    else:
        rotation = Rotation.from_euler(_EULER[form], rows[:, ::-1] if form == RPY else rows)
    found[given] = np.roll(rotation.as_quat(), 1, axis=1)
    return found


def is_no_rotation(matrix: Array) -> NDArray[np.bool_]:
    """Of which rows `(sample, 9)`, without gaps, the matrix is no rotation: not orthogonal, or mirrored."""
    R = matrix.reshape(-1, 3, 3)
    with np.errstate(all="ignore"):
        far = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0) > NEARLY
        return np.isfinite(matrix).all(1) & (far | (np.linalg.det(R) < 0))


def with_quaternions(values: Mapping[str, Array], source: str = "recording") -> dict[str, Array]:
    """Columns in SI units by their names, with an orientation in another form replaced by its quaternions.

    Raises:
        InputError: a matrix that is no rotation.
    """
    told = dict(values)
    for form in (*ANGLES, MATRIX):
        names = [spelled(part) for part in form]
        if all(name in told for name in names):
            parts = np.stack([told.pop(name) for name in names], axis=1)
            if form == MATRIX and (wrong := np.flatnonzero(is_no_rotation(parts))).size:
                turned = np.linalg.det(parts[wrong[0]].reshape(3, 3)) > 0
                raise InputError(
                    f"{source}: row {wrong[0] + 1}: r11 … r33 {'is not orthogonal' if turned else 'is mirrored'}, so "
                    "it is no rotation; name its columns row by row, or remove the row"
                )
            told |= dict(zip(QUATERNION, quaternions(form, parts).T, strict=True))
    return told
