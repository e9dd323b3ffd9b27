"""The forms in which a table may give orientations; a recording holds unit quaternions, scalar first.

| columns | R of the tool in the sensor's frame |
|---|---|
| `qw qx qy qz` | the unit quaternion |
| `rx_rad ry_rad rz_rad` | the rotation vector: the axis times the angle (Universal Robots) |
| `roll_rad pitch_rad yaw_rad` | Rz(yaw) Ry(pitch) Rx(roll) (UFACTORY, URDF; KUKA's C B A, Fanuc's W P R) |
| `rotx_rad roty_rad rotz_rad` | Rx(rotx) Ry(roty) Rz(rotz) (Staubli, Mecademic) |
| `alpha_rad beta_rad gamma_rad` | Rz(alpha) Ry(beta) Rz(gamma) (Kawasaki, Doosan) |
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lite6jax.recordings.columns import ANGLES, QUATERNION, spelled

Array = NDArray[np.floating]

VECTOR, RPY, XYZ, ZYZ = ANGLES
_EULER: dict[tuple[str, ...], str] = {RPY: "ZYX", XYZ: "XYZ", ZYZ: "ZYZ"}
"""Intrinsic sequences in SciPy's spelling, in the order of the columns; of `RPY` in the reverse order."""


def quaternions(form: tuple[str, ...], angles: Array) -> Array:
    """`(sample, 4)` unit quaternions, scalar first, of `(sample, 3)` rad of one of `ANGLES`; NaN where one is."""
    from scipy.spatial.transform import Rotation

    found = np.full((len(angles), 4), np.nan)
    given = np.isfinite(angles).all(axis=1)
    if not given.any():
        return found
    rows = angles[given]
    if form == VECTOR:
        rotation = Rotation.from_rotvec(rows)
    else:
        rotation = Rotation.from_euler(_EULER[form], rows[:, ::-1] if form == RPY else rows)
    found[given] = np.roll(rotation.as_quat(), 1, axis=1)
    return found


def with_quaternions(values: Mapping[str, Array]) -> dict[str, Array]:
    """Columns in SI units by their names, with an orientation in another form replaced by its quaternions."""
    told = dict(values)
    for form in ANGLES:
        names = [spelled(part) for part in form]
        if all(name in told for name in names):
            angles = np.stack([told.pop(name) for name in names], axis=1)
            told |= dict(zip(QUATERNION, quaternions(form, angles).T, strict=True))
    return told
