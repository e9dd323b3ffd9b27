"""Arrays whose kind or unit is plainly wrong, refused in one line: complex numbers, degrees for radians, millimetres
for metres. Every public call that takes joint positions comes here, and so does every reader of a file.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.errors import InputError

FAR_ROWS_SHARE = 0.1  # fewer far rows are outliers, which the diagnosis locates; a wrong unit affects most rows
FAR_LIMITS = 2.0  # in multiples of the arm's widest limit: no swapped, mirrored or once-turned joint exceeds that
FAR_REACHES = 5.0  # a tool adds to the reach, but less than this
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
        name: of the argument, for the message.

    Raises:
        InputError: complex numbers, or degrees by `far_joint`.
    """
    q = np.atleast_1d(real_array(name, joint_position))
    found = far_joint(q, joint_limits)
    if found is not None:
        *place, joint = found
        at = f"row {place[-1] + 1}" if len(place) == 1 else f"sample {tuple(k + 1 for k in place)}" if place else "it"
        limits = limits_of(q.shape[-1], joint_limits)
        remedy = f"are these degrees? give radians: np.deg2rad({name.rpartition(': ')[2]})"
        raise InputError(unlikely_joint(name, at, q[found], joint, limits, remedy))


def far_joint(joint_position: NDArray[np.float64], joint_limits: ArrayLike | None = None) -> tuple[int, ...] | None:
    """The index of the first joint position that shows degrees where radians belong; None where they are radians.

    Degrees are suspected where a tenth of the rows of any one arm or more exceed twice the arm's widest limit, and the
    limit by more than a turn; a joint without end says nothing. A few such rows are outliers and pass, and so do joints
    that are swapped, mirrored or a turn off: the diagnosis locates those.

    Args:
        joint_position: `(joint,)`, `(sample, joint)` or `(arm, sample, joint)` rad.
        joint_limits: as in `require_radians`.
    """
    q = joint_position
    if not q.size:
        return None
    widest = np.abs(limits_of(q.shape[-1], joint_limits)).max()
    far = np.abs(q) > max(FAR_LIMITS * widest, widest + 2 * np.pi)
    if joint_limits is not None:
        far &= np.isfinite(np.asarray(joint_limits, float)).all(-1)
    if not (np.atleast_1d(far.any(-1)).mean(-1) >= FAR_ROWS_SHARE).any():
        return None
    joint = int(np.argmax(far.reshape(-1, q.shape[-1]).sum(0)))
    first = np.argwhere(np.atleast_1d(far[..., joint]))[0]
    return (*map(int, first[: q.ndim - 1]), joint)


def unlikely_joint(
    place: str, row: str, value: float, joint: int, limits: NDArray[np.float64], remedy: str, unit: str = "rad"
) -> str:
    """The line that refuses a joint position; `joint` counts from 0."""
    return (
        f"{place}: {row} is at {value:.5g} {unit} while the arm's joint {joint + 1} goes from {limits[joint, 0]:.4g} "
        f"to {limits[joint, 1]:.4g} {unit}; {remedy}"
    )


def other_joints(given: tuple[int, ...], wanted: tuple[int, ...], arm: str) -> str:
    """What is wrong where the prismatic joints `given`, counted from 0, are not those of an arm, with the remedy."""
    joint = min(set(given) ^ set(wanted)) + 1
    if joint - 1 in wanted:
        return (
            f"q{joint} is an angle, but joint {joint} of {arm} is prismatic; name the column q{joint}_m or q{joint}_mm,"
            " or declare the arm in the sidecar of a log"
        )
    return f"q{joint} is a length, but joint {joint} of {arm} is revolute; name the column q{joint}_rad or q{joint}_deg"


def limits_of(joints: int, joint_limits: ArrayLike | None) -> NDArray[np.float64]:
    """`(joint, 2)` finite limits in rad: ±2π where none are given."""
    if joint_limits is None:
        return np.tile(FULL_TURN, (joints, 1))
    limits = np.asarray(joint_limits, float)
    return np.where(np.isfinite(limits), limits, FULL_TURN)


def require_metres(position: NDArray[np.float64], reach: float, *, from_base: bool, remedy: str, place: str) -> None:
    """Refuses measured positions that must be millimetres. Medians decide, so outliers pass.

    Args:
        position: `(sample, 3)` m; rows that are not finite are ignored.
        reach: of the arm without a tool, m.
        from_base: whether the positions are in the arm's base frame; else the sensor may stand anywhere, and only
            their spread counts.
        remedy: what the message recommends.
        place: what the message begins with.

    Raises:
        InputError: the median distance from their median (or from the base) exceeds five reaches.
    """
    there = position[np.isfinite(position).all(1)]
    if not len(there):
        return
    with np.errstate(over="ignore"):
        middle = np.median(there, axis=0)
        distance, origin = float(np.median(np.linalg.norm(there - middle, axis=1))), "from their middle"
    if from_base and np.linalg.norm(middle) > distance:
        distance, origin = float(np.linalg.norm(middle)), "from the base"
    if distance > FAR_REACHES * reach:
        raise InputError(
            f"{place}: the positions lie {distance:.4g} m {origin} (median) while the arm reaches {reach:.3g} m; "
            f"{remedy}"
        )
