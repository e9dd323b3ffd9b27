"""The arrays of a recording before it is made: real numbers in the right units, plausible and finite, unit quaternions.

Every public call that takes joint positions comes here, and so does every reader of a file.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike, NDArray

from lite6jax.array_types import Integers
from lite6jax.errors import InputError
from lite6jax.formatting import shortened
from lite6jax.recordings.columns.column import OF_ARRAY, QUANTITIES, name_columns
from lite6jax.recordings.columns.sizes import without_marks

FAR_ROWS_SHARE = 0.1  # fewer far rows are outliers, which the diagnosis locates; a wrong unit affects most rows
FAR_LIMITS = 2.0  # in multiples of the arm's widest limit: no swapped, mirrored or once-turned joint exceeds that
FAR_REACHES = 5.0  # a tool adds to the reach, but less than this
FIND_UNIT = "`lite6jax init FILE --arm NAME --force` finds the unit, or asks for it"
FULL_TURN = (-2 * np.pi, 2 * np.pi)  # rad; the limits assumed of a joint without limits


def real_array(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """The value as float64.

    Raises:
        InputError: complex numbers, text, or rows of unequal length; the message begins with `name`.
    """
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise InputError(f"{name}: its rows have unequal lengths; give one array of numbers") from error
    if np.iscomplexobj(array):
        raise InputError(f"{name}: holds complex numbers; give real ones")
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name}: holds {array.dtype}, not numbers; give an array of floats")
    return array.astype(np.float64, copy=False)


def require_radians(
    joint_position: ArrayLike, joint_limits: ArrayLike | None = None, name: str = "joint_position"
) -> None:
    """Refuses joint positions that must be degrees, as every public call that takes them does.

    Args:
        joint_position: `(..., joint)` rad; numbers that are not finite are ignored.
        joint_limits: `(joint, 2)` lower and upper in rad; ±2π where not given, infinite of joints without end.
        name: of the argument, for the message; after a colon where it is an array of a file.

    Raises:
        InputError: complex numbers, or degrees as in `require_near`.
    """
    source, _, argument = name.rpartition(": ")
    remedy = f"are these degrees? {FIND_UNIT if Path(source).suffix else f'give radians: np.deg2rad({argument})'}"
    require_near(np.atleast_1d(real_array(name, joint_position)), joint_limits, lambda _: (name, remedy))


def require_near(
    q: NDArray[np.float64],
    joint_limits: ArrayLike | None,
    describe: Callable[[int], tuple[str, str]],
    row: Integers | None = None,
    sliding: Iterable[int] = (),
) -> None:
    """Refuses joint positions so far outside the limits that they must be degrees, or millimetres.

    That is where a tenth of the rows of any one arm or more exceed twice the arm's widest limit, and the limit by more
    than a turn; a joint without end says nothing. A few such rows are outliers and pass, and so do joints that are
    swapped, mirrored or a turn off: the diagnosis locates those.

    Args:
        q: `(joint,)`, `(sample, joint)` or `(arm, sample, joint)` rad; numbers that are not finite are ignored.
        joint_limits: as in `require_radians`.
        describe: of a joint, counted from 0, what the message begins with, and the remedy.
        row: the number of each sample; from 1 where not given.
        sliding: the prismatic joints.

    Raises:
        InputError: as said; the message names a row.
    """
    if not q.size:
        return
    limits = np.tile(FULL_TURN, (q.shape[-1], 1)) if joint_limits is None else np.asarray(joint_limits, float)
    ends = np.isfinite(limits).all(-1)
    limits = np.where(np.isfinite(limits), limits, FULL_TURN)
    widest = np.abs(limits).max()
    numbers = without_marks(q) if q.ndim == 2 else q
    far = (np.abs(numbers) > max(FAR_LIMITS * widest, widest + 2 * np.pi)) & ends
    if not (np.atleast_1d(far.any(-1)).mean(-1) >= FAR_ROWS_SHARE).any():
        return
    joint = int(np.argmax(far.reshape(-1, q.shape[-1]).sum(0)))
    at = tuple(map(int, np.argwhere(np.atleast_1d(far[..., joint]))[0]))[: q.ndim - 1]
    place, remedy = describe(joint)
    sample_name = f"sample {tuple(k + 1 for k in at)}" if at else "it"
    if len(at) == 1:
        sample_name = f"row {at[0] + 1 if row is None else row[at[0]]}"
    low, high = limits[joint]
    unit = "m" if joint in sliding else "rad"
    raise InputError(
        f"{place}: {sample_name} is at {q[(*at, joint)]:.5g} {unit} while the arm's joint {joint + 1} goes from "
        f"{low:.4g} to {high:.4g} {unit}; {remedy}"
    )


def other_joints(sliding: tuple[int, ...], expected: tuple[int, ...], arm: str) -> str:
    """What is wrong where the prismatic joints `sliding`, from 0, are not those of an arm, with the remedy."""
    joint = min(set(sliding) ^ set(expected)) + 1
    if joint - 1 in expected:
        return (
            f"q{joint} is an angle, but joint {joint} of {arm} is prismatic; name the column q{joint}_m or q{joint}_mm,"
            " or declare the arm in the sidecar of a log"
        )
    return f"q{joint} is a length, but joint {joint} of {arm} is revolute; name the column q{joint}_rad or q{joint}_deg"


# ------------------------------------------------------------------ numbers that no arm or sensor can give


LONGEST_DISTANCE_M = 100.0
"""From the median of the positions, which may be far from the sensor; a laser tracker measures to 80 m."""
WIDEST_SPREAD = 100.0
"""The same in median distances, so that positions in millimetres are recognised as such and not dropped."""
LONGEST_TIME_S = 1e9
"""From the median of the times: thirty years."""
_SHOWN = 12


def blank_implausible(arrays: dict[str, Any], source: str, spelling: Mapping[str, str]) -> list[str]:
    """Puts NaN in place of implausible numbers, and says in which rows; nothing where there are none.

    Args:
        arrays: those of `OF_ARRAY`, float64 or None where absent.
        source: what messages begin with.
        spelling: column name in SI units to the name in the file; empty for arrays.

    Raises:
        InputError: over half of the rows have such a number.
    """
    samples, dof = arrays["joint_position"].shape
    bad = np.zeros(samples, bool)
    first = ""
    for name, array in arrays.items():
        if array is None:
            continue
        table = array.reshape(samples, -1)
        beyond = implausible(name, table)
        if beyond.any():
            row, index = np.argwhere(beyond)[0]
            column = name_columns(name, dof)[index]
            first = first or f"{table[row, index]:.5g} in column {spelling.get(column, column)}, row {row + 1}"
            bad |= beyond.any(1)
            arrays[name] = np.where(beyond, np.nan, table).reshape(array.shape)
    if not first:
        return []
    rows = np.flatnonzero(bad) + 1
    if len(rows) > LARGEST_MISSING_SHARE * samples:
        raise InputError(
            f"{source}: {len(rows)} of {samples} rows have numbers beyond any arm or sensor ({first}); check the unit "
            "and the column"
        )
    listed = f"; rows {shortened(rows.tolist(), _SHOWN)}" if len(rows) > 1 else ""
    return [f"numbers beyond any arm or sensor count as missing: {first}{listed}"]


def implausible(name: str, table: Float[np.ndarray, "sample column"]) -> Bool[np.ndarray, "sample column"]:
    """Which finite numbers of an array of a recording are; what is not finite is missing already."""
    with np.errstate(over="ignore"):
        beyond = np.isfinite(table) & (np.abs(table) > QUANTITIES[OF_ARRAY[name][0]].largest)
        if name in ("position", "time"):
            near = np.where(np.isfinite(table) & ~beyond, table, np.nan)
            distance = np.abs(near - [_median(column) for column in near.T])
            farthest = max(LONGEST_DISTANCE_M, WIDEST_SPREAD * _median(distance.max(1)))
            beyond |= distance > (LONGEST_TIME_S if name == "time" else farthest)
    return beyond


def _median(values: NDArray[np.float64]) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else 0.0


# ------------------------------------------------------------------ the arguments of a recording


LARGEST_MISSING_SHARE = 0.5
QUATERNION_TOLERANCE = 0.01
_ROUNDING = 1e-14  # a quaternion this close to unit length is left alone, so that normalising twice changes nothing


def unit_quaternions(
    quaternion: Float[np.ndarray, "sample 4"], row: Int[np.ndarray, " sample"], source: str
) -> tuple[Float[np.ndarray, "sample 4"], str | None]:
    """Quaternions of unit length whose first non-zero component is positive, and a note where many were not.

    Raises:
        InputError: a length more than 1 % off; the message names the row.
    """
    complete = np.all(np.isfinite(quaternion), axis=1)
    with np.errstate(over="ignore"):  # an absurdly long one is infinitely long, and refused as such
        length = np.sqrt(np.sum(np.where(complete[:, None], quaternion, 0.5) ** 2, axis=1))
    off = np.abs(length - 1.0)
    beyond = np.flatnonzero(off > QUATERNION_TOLERANCE)
    if beyond.size:
        more = f" (and {beyond.size - 1} more rows)" if beyond.size > 1 else ""
        raise InputError(
            f"{source}: columns qw qx qy qz: row {row[beyond[0]]} has length {length[beyond[0]]:.6g}{more}, not 1; "
            "give unit quaternions, scalar first, and leave the fields empty where the sensor lost its target"
        )
    note = None
    if off.max() > 1e-6:  # below, it is the rounding of the file's decimals
        count = int(np.sum(off > 1e-6))
        note = f"normalised {count} quaternions, the furthest {off.max():.2g} from unit length"
    unit = np.where((off > _ROUNDING)[:, None], quaternion / length[:, None], quaternion)
    leading = np.argmax(np.abs(np.sign(unit)), axis=1)
    return np.where(unit[np.arange(len(unit)), leading, None] < 0, -unit, unit), note
