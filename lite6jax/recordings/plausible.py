"""Numbers that no arm and no sensor can give: their rows count as missing, before anything is computed from them.

One such number spoils what a robust fit makes of all others: the squares of 1e160 are infinite.
"""

from collections.abc import Mapping
from math import pi
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from lite6jax.errors import InputError
from lite6jax.recordings.arguments import LARGEST_MISSING_SHARE

MOST_TURNS = 1000
"""Turns of a joint that counts them on and on."""
LONGEST_DISTANCE_M = 100.0
"""From the median of the positions, which may be far from the sensor; a laser tracker measures to 80 m."""
WIDEST_SPREAD = 100.0
"""The same in median distances, so that positions in millimetres are recognised as such and not dropped."""
LONGEST_TIME_S = 1e9
"""From the median of the times: thirty years."""
_MOST = {
    "joint_position": ("q{}_rad", 2 * pi * MOST_TURNS),
    "joint_velocity": ("dq{}_rad_per_s", 1e4),
    "joint_acceleration": ("ddq{}_rad_per_s2", 1e7),
    "joint_torque": ("tau{}_Nm", 1e5),
    "motor_current": ("current{}_A", 1e5),
    "joint_temperature": ("temp{}_degC", 1e4),
    "commanded_position": ("cmd{}_rad", 2 * pi * MOST_TURNS),
    "ambient_temperature": ("ambient_degC", 1e4),
    "payload": ("payload_kg", 1e5),
    "time": ("time_s", 1e12),
    "position": ("{}_m", 1e7),
}
"""The column names of each array, and the largest magnitude: of m, one that a float still resolves to nanometres."""
_SHOWN = 12


def without_implausible(
    arrays: Mapping[str, Any], source: str, spelling: Mapping[str, str], notes: list[str]
) -> dict[str, Any]:
    """The same arrays with NaN in place of implausible numbers.

    Args:
        arrays: arguments of `Recording.assembled`, float64 or None where absent; those of other lengths than the joint
            positions are left alone, because `assembled` refuses them.
        source: what messages begin with.
        spelling: column name in SI units to the name in the file; empty for arrays.
        notes: gets a sentence that names the rows.

    Raises:
        InputError: over half of the rows have such a number.
    """
    samples = len(np.atleast_1d(arrays["joint_position"]))
    blanked: dict[str, Any] = dict(arrays)
    bad, first = np.zeros(samples, bool), ""
    for name, (pattern, _) in _MOST.items():
        array = arrays.get(name)
        if array is None or array.ndim not in (1, 2) or len(array) != samples or not array.size:
            continue
        table = array.reshape(samples, -1)
        found = implausible(name, table)
        if not found.any():
            continue
        row, index = np.argwhere(found)[0]
        column = pattern.format("xyz"[index] if name == "position" else index + 1)
        first = first or f"{table[row, index]:.5g} in column {spelling.get(column, column)}, row {row + 1}"
        bad |= found.any(1)
        blanked[name] = np.where(found, np.nan, table).reshape(array.shape)
    if not first:
        return blanked
    rows = np.flatnonzero(bad) + 1
    if len(rows) > LARGEST_MISSING_SHARE * samples:
        raise InputError(
            f"{source}: {len(rows)} of {samples} rows have numbers beyond any arm or sensor ({first}); check the unit "
            "and the column"
        )
    more = f" and {len(rows) - _SHOWN} more" if len(rows) > _SHOWN else ""
    listed = f"; rows {', '.join(map(str, rows[:_SHOWN]))}{more}" if len(rows) > 1 else ""
    notes.append(f"numbers beyond any arm or sensor count as missing: {first}{listed}")
    return blanked


def implausible(name: str, table: Float[np.ndarray, "sample column"]) -> Bool[np.ndarray, "sample column"]:
    """Which finite numbers of an argument of `Recording.assembled` are; what is not finite is missing already."""
    with np.errstate(over="ignore"):
        beyond = np.isfinite(table) & (np.abs(table) > _MOST[name][1])
        if name in ("position", "time"):
            distance = _distance(np.where(beyond, np.nan, table))
            spread = _median(distance.max(1, keepdims=True)).item()
            farthest = LONGEST_TIME_S if name == "time" else max(LONGEST_DISTANCE_M, WIDEST_SPREAD * spread)
            beyond |= distance > farthest
    return beyond


def _distance(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of each number from the median of its column; NaN where it is not finite."""
    finite = np.where(np.isfinite(table), table, np.nan)
    return np.abs(finite - _median(finite))


def _median(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """`(column,)` of the numbers that are not NaN; zero where there are none."""
    there = [column[~np.isnan(column)] for column in table.T]
    return np.array([np.median(column) if len(column) else 0.0 for column in there])
