"""The arrays of a recording before it is made: real numbers in the right units, finite rows, unit quaternions."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import bundled_of
from lite6jax.arms.files import read_arm
from lite6jax.errors import InputError
from lite6jax.recordings.settings import RecordingSettings
from lite6jax.recordings.units import far_joint, limits_of, other_joints, real_array, require_metres, unlikely_joint

LARGEST_MISSING_SHARE = 0.5
QUATERNION_TOLERANCE = 0.01
_ROUNDING = 1e-14  # a quaternion this close to unit length is left alone, so that normalising twice changes nothing


def checked_arrays(
    arrays: Mapping[str, Any],
    arm: Arm | str | None,
    settings: RecordingSettings,
    source: str,
    spelling: Mapping[str, str],
) -> dict[str, Any]:
    """The same arrays as float64, refused where the arm shows that a unit is wrong.

    Args:
        arrays: arguments of `Recording.assembled`, None where absent.
        arm: the arm, where the caller named it.
        settings: whose `arm` is taken otherwise.
        source: what messages begin with.
        spelling: column name in SI units to the name in a table; empty for arrays.

    Raises:
        InputError: numbers that are not real, an arm of another number of joints, degrees, or millimetres.
    """
    real: dict[str, Any] = {
        name: value
        if value is None or name in ("run", "row", "sliding", "readings")
        else real_array(f"{source}: {name}", value)
        for name, value in arrays.items()
    }
    q, position = real["joint_position"], real["position"]
    if q.ndim != 2:
        return real  # of a wrong shape, which `assembled` refuses
    given = real.get("sliding")
    known = arm if isinstance(arm, Arm) else _declared_arm(settings, source, 0 if given else q.shape[1])
    if known is None:
        return real
    if q.shape[1] != known.dof:
        raise InputError(
            f"{source}: has {q.shape[1]} joints, but {known.name} has {known.dof}; give the arm that it is of"
        )
    if given is None:
        real["sliding"] = known.sliding
    elif given != known.sliding:
        raise InputError(f"{source}: {other_joints(given, known.sliding, known.name)}")
    found = far_joint(q, known.possible_positions)
    if found is not None:
        sample, joint = found
        column = spelling.get(f"q{joint + 1}_rad", "")
        place = f"{source}: column {column}" if spelling else f"{source}: joint_position"
        remedy = "name the columns q1_deg ..." if spelling else "give radians: np.deg2rad(joint_position)"
        remedy = "check the unit" if column.endswith("_deg") else f"are these degrees? {remedy}"
        limits = limits_of(known.dof, known.joint_limits)
        raise InputError(unlikely_joint(place, f"row {sample + 1}", q[found], joint, limits, remedy))
    if position is not None and position.shape == (len(q), 3):
        columns = [spelling.get(name, "") for name in ("x_m", "y_m", "z_m")]
        place = f"{source}: columns {' '.join(columns)}" if spelling else f"{source}: position"
        remedy = "name the columns x_mm y_mm z_mm" if spelling else "give metres: position / 1000"
        remedy = "check the unit" if columns[0].endswith("_mm") else f"are these millimetres? {remedy}"
        require_metres(position, known.reach, from_base=settings.pose_frame == "base", remedy=remedy, place=place)
    return real


def _declared_arm(settings: RecordingSettings, source: str, joints: int) -> Arm | None:
    """The settings' arm; where none is declared, the bundled one of as many joints with the longest reach, if any."""
    if settings.arm is not None:
        return read_arm(settings.arm_reference(Path(source).parent))
    return max(bundled_of(joints), key=lambda arm: arm.reach, default=None)


def missing_rows(
    table: Mapping[str, np.ndarray], row: Int[np.ndarray, " sample"], source: str, spelling: Mapping[str, str]
) -> tuple[Bool[np.ndarray, " sample"], str]:
    """The rows with a number that is not finite, and a note that counts them; empty where there are none.

    Raises:
        InputError: over half of the rows; the message names the column with most gaps.
    """
    missing = {name: ~np.isfinite(column) for name, column in table.items()}
    bad = np.logical_or.reduce(list(missing.values()))
    count = int(bad.sum())
    if not count:
        return bad, ""
    first = row[np.argmax(bad)]
    if count > LARGEST_MISSING_SHARE * len(row):
        worst = max(missing, key=lambda name: int(missing[name].sum()))
        raise InputError(
            f"{source}: {count} of {len(row)} rows have NaN, infinite or empty fields, the first is row {first}, most "
            f"of them in column {spelling.get(worst, worst)} ({int(missing[worst].sum())}); fill or remove that "
            "column, or record again"
        )
    rows, verb = ("row", "that is") if count == 1 else ("rows", "the first is")
    return bad, f"dropped {count} {rows} with NaN, infinite or empty fields, {verb} row {first}"


def unit_quaternions(
    quaternion: Float[np.ndarray, "sample 4"], row: Int[np.ndarray, " sample"], source: str
) -> tuple[Float[np.ndarray, "sample 4"], str | None]:
    """Quaternions of unit length whose first non-zero component is positive, and a note where many were not.

    Raises:
        InputError: a length more than 1 % off; the message names the row.
    """
    given = np.all(np.isfinite(quaternion), axis=1)
    with np.errstate(over="ignore"):  # an absurdly long one is infinitely long, and refused as such
        length = np.sqrt(np.sum(np.where(given[:, None], quaternion, 0.5) ** 2, axis=1))
    off = np.abs(length - 1.0)
    beyond = np.flatnonzero(off > QUATERNION_TOLERANCE)
    if beyond.size:
        others = f" (and {beyond.size - 1} more rows)" if beyond.size > 1 else ""
        raise InputError(
            f"{source}: columns qw qx qy qz: row {row[beyond[0]]} has length {length[beyond[0]]:.6g}{others}, not 1; "
            "give unit quaternions, scalar first, and leave the fields empty where the sensor lost its target"
        )
    note = None
    if off.max() > 1e-6:  # below, it is the rounding of the file's decimals
        count = int(np.sum(off > 1e-6))
        note = f"normalised {count} quaternions, the furthest {off.max():.2g} from unit length"
    unit = np.where((off > _ROUNDING)[:, None], quaternion / length[:, None], quaternion)
    leading = np.argmax(np.abs(np.sign(unit)), axis=1)
    return np.where(unit[np.arange(len(unit)), leading, None] < 0, -unit, unit), note
