"""From the columns of a table to the arrays of a recording: the same for files and for data frames in memory."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from lite6jax.errors import InputError
from lite6jax.recordings.columns import Column, nearest_known, recognise
from lite6jax.recordings.plausible import implausible

LATEST_START_S = 1e8  # three years: such a time is a clock's, not counted from a start


class Table(NamedTuple):
    """Recognised columns and their values.

    Attributes:
        columns: by their names in SI units.
        joints: how many.
        values: `(sample,)` float64 in SI units, by the same names; NaN where absent.
    """

    columns: dict[str, Column]
    joints: int
    values: dict[str, np.ndarray]

    @property
    def spelling(self) -> dict[str, str]:
        """The name in SI units to the column's own, for messages."""
        return {name: column.name for name, column in self.columns.items()}


def read_frame(frame: Any, source: str, notes: list[str]) -> Table:
    """The columns of a data frame that a recording has.

    Args:
        frame: anything with named columns: a pandas or polars `DataFrame`, a pyarrow `Table`, or a mapping of names to
            arrays.
        source: for messages.
        notes: gets a sentence on the columns that are ignored.

    Raises:
        InputError: no named columns, no rows, columns of unequal length, or a column that does not hold numbers; names
            as `recognise`.
    """
    listed = getattr(frame, "column_names", None) or getattr(frame, "columns", None)
    names = list(frame) if isinstance(frame, Mapping) else [] if listed is None else list(listed)
    if not names or not all(isinstance(name, str) for name in names):
        raise InputError(
            f"{source}: a {type(frame).__name__} has no named columns; give a data frame with columns q1_rad ... qN_rad"
        )
    columns, joints = recognised(names, source, None, notes)
    arrays = {name: _arrow(frame[column.name], column, source) for name, column in columns.items()}
    lengths = {len(array) for array in arrays.values()}
    if len(lengths) > 1:
        raise InputError(f"{source}: its columns have unequal lengths, {min(lengths)} to {max(lengths)}; give one each")
    if lengths == {0}:
        raise InputError(f"{source}: has column names but no rows; record again")
    return Table(columns, joints, si_values(columns, arrays))


def recognised(
    names: Sequence[str], source: str, dof: int | None, notes: list[str], joints_optional: bool = False
) -> tuple[dict[str, Column], int]:
    """As `recognise`, with a note on the columns that are ignored."""
    columns, joints, ignored = recognise(names, source, dof, joints_optional)
    if ignored:
        shown = ", ".join(
            f"{n[:40]!r}" + (f" (meant {near}?)" if (near := nearest_known(n)) else "") for n in ignored[:6]
        )
        rest = f" and {len(ignored) - 6} more" if len(ignored) > 6 else ""
        notes.append(f"ignored columns that mean nothing here: {shown}{rest}")
    return columns, joints


def require_numbers(column: Column, kind: pa.DataType, source: str) -> None:
    """Refuses a column of text, truth values, times or complex numbers.

    Raises:
        InputError: as said, by name.
    """
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_null(kind)):
        raise InputError(f"{source}: column {column.name}: holds {kind}, not numbers; write it as float64")


def si_values(columns: Mapping[str, Column], table: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """`(sample,)` float64 in SI units of Arrow columns; an absent value becomes NaN."""
    values = {}
    for name, column in columns.items():
        array = table[name].cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        values[name] = array if column.divisor == 1.0 else array / column.divisor
    return values


def arrays_of(table: Table, source: str, notes: list[str]) -> dict[str, Any]:
    """The arguments of `Recording.assembled` that a table holds.

    Raises:
        InputError: a run that is not a whole number.
    """
    columns, joints, values = table

    def block(*names: str) -> np.ndarray | None:
        return np.column_stack([values[name] for name in names]) if names[0] in values else None

    def per_joint(pattern: str) -> np.ndarray | None:
        return block(*(pattern.format(joint) for joint in range(1, joints + 1)))

    joint_position = per_joint("q{}_rad")
    assert joint_position is not None  # `recognise` requires it
    if (missing := values.get("missing")) is not None and (gaps := int((missing > 0).sum())):
        total = f"{np.nansum(missing):.0f} reports of the controller are missing"
        notes.append(f"{total}, in {gaps} gap{'s' if gaps > 1 else ''}; the columns missing and gap say where and why")
    run = values.get("run")
    if run is not None:
        given = np.isfinite(run)
        wrong = np.flatnonzero(given & ((run != np.round(run)) | (np.abs(run) > 2**53)))
        if wrong.size:
            raise InputError(f"{source}: column run: row {wrong[0] + 1} is {run[wrong[0]]:g}; give whole numbers")
        # a row without a run belongs to none and is dropped with its joints; meanwhile it must not split its neighbours
        joint_position[~given] = np.nan
        last = np.maximum.accumulate(np.where(given, np.arange(len(run)), 0))
        run = np.where(given[last], run[last], 0.0).astype(np.int64)
    time = values.get("time_s")
    if time is not None:
        start = np.min(time, where=np.isfinite(time) & ~implausible("time", time[:, None])[:, 0], initial=np.inf)
        if LATEST_START_S < start < np.inf:
            time = time - start
            notes.append(f"{columns['time_s'].name} is a clock's: times are counted from the first, {start:.0f} s")
    return {
        "joint_position": joint_position,
        "position": block("x_m", "y_m", "z_m"),
        "quaternion": block("qw", "qx", "qy", "qz"),
        "time": time,
        "joint_velocity": per_joint("dq{}_rad_per_s"),
        "joint_acceleration": per_joint("ddq{}_rad_per_s2"),
        "joint_torque": per_joint("tau{}_Nm"),
        "motor_current": per_joint("current{}_A"),
        "joint_temperature": per_joint("temp{}_degC"),
        "ambient_temperature": values.get("ambient_degC"),
        "payload": values.get("payload_kg"),
        "run": run,
    }


def _arrow(values: Any, column: Column, source: str) -> pa.Array | pa.ChunkedArray:
    """One column of any data frame as Arrow's."""
    try:
        if isinstance(values, pa.Array | pa.ChunkedArray):
            array = values
        elif hasattr(values, "__arrow_c_stream__"):
            array = pa.chunked_array(values)
        else:
            array = pa.array(values, from_pandas=True)
    except (pa.ArrowException, TypeError, ValueError) as error:
        kind = getattr(values, "dtype", type(values).__name__)
        raise InputError(f"{source}: column {column.name}: holds {kind}, not numbers; give it as float64") from error
    require_numbers(column, array.type, source)
    return array
