"""The table of a folder: a row a file with how its fit ended, as plain numbers and words."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import pyarrow as pa

from lite6jax.distribution.batches import write_tables
from lite6jax.fitting.quality import Result
from lite6jax.folders.place import kind_of

if TYPE_CHECKING:
    from lite6jax.fitting.solution import Errors

Kind = Literal["calibration", "recording", "other"]

_ERRORS = ("fitted", "checked", "nominal")
_STATISTICS = ("position_rms_m", "position_max_m", "orientation_rms_rad", "orientation_max_rad")
_FIXED = {
    "file": pa.string(), "kind": pa.string(), "result": pa.int32(), "quality": pa.string(), "message": pa.string(),
    "arm": pa.string(), "joints": pa.int32(), "samples": pa.int64(), "steps": pa.int32(),
    **{f"{prefix}_{name}": pa.float64() for prefix in _ERRORS for name in _STATISTICS},
}  # fmt: skip
"""The columns of every table; those of the parameters come after them."""


@dataclass(frozen=True)
class Statistics:
    """Distances between prediction and measurement: their root mean square and largest, m and rad."""

    position_rms: float
    position_max: float
    orientation_rms: float | None
    orientation_max: float | None

    @classmethod
    def of(cls, errors: "Errors") -> "Statistics":
        """Those of errors, without orientation where none was measured."""
        import numpy as np

        orientation = errors.orientation
        return cls(
            errors.position_rms,
            float(errors.position.max()),
            None if orientation is None else float(np.sqrt(np.mean(orientation**2))),
            None if orientation is None else float(orientation.max()),
        )


@dataclass(frozen=True)
class Row:
    """One file of a folder.

    Attributes:
        file: its name in the folder.
        kind: what it is.
        result: how its fit ended.
        quality: whether the model describes the data, a `QualityVerdict`; empty where nothing was fitted.
        message: the same in words; of a bad file, what is wrong with it.
        arm: the nominal arm's name; empty where unknown.
        joints: their number.
        samples: of a recording, or drawn from a calibration's chain.
        steps: of the solver.
        parameters: what was fitted, by name with the unit, m and rad; empty where nothing was.
        fitted: errors of the data fitted, or None.
        checked: of data not fitted: fresh samples, or held-out blocks.
        nominal: of the nominal geometry.
    """

    file: str
    kind: Kind
    result: Result
    message: str
    quality: str = ""
    arm: str = ""
    joints: int = 0
    samples: int = 0
    steps: int = 0
    parameters: tuple[tuple[str, float], ...] = ()
    fitted: Statistics | None = None
    checked: Statistics | None = None
    nominal: Statistics | None = None

    @property
    def failed(self) -> bool:
        """Whether a person should look at it: not readable, not converged, or with a model that is none of the data."""
        return self.result != Result.CONVERGED or self.quality == "bad"


def died(name: str) -> pa.Table:
    """The row of a file at which the process that read it was ended, time and again."""
    message = f"{name}: the process that read it was ended; the file is damaged or too large for this machine"
    return table_of_rows([Row(name, kind_of(name), Result.UNREADABLE, message)])


def table_of_rows(rows: Sequence[Row]) -> pa.Table:
    """Rows as columns, SI units in their names; what a row does not have is null."""
    columns: dict[str, list] = {
        "file": [_utf8(row.file) for row in rows],
        "kind": [row.kind for row in rows],
        "result": [int(row.result) for row in rows],
        "quality": [row.quality or None for row in rows],
        "message": [_utf8(row.message) for row in rows],
        "arm": [row.arm or None for row in rows],
        "joints": [row.joints or None for row in rows],
        "samples": [row.samples or None for row in rows],
        "steps": [row.steps if row.parameters else None for row in rows],
    }
    for prefix in _ERRORS:
        found = [getattr(row, prefix) for row in rows]
        for name in _STATISTICS:
            attribute = name.rpartition("_")[0]
            columns[f"{prefix}_{name}"] = [errors and getattr(errors, attribute) for errors in found]
    parameters = [dict(row.parameters) for row in rows]
    names = dict.fromkeys(name for own in parameters for name in own)
    fields = list(_FIXED.items()) + [(name, pa.float64()) for name in names]
    columns |= {name: [own.get(name) for own in parameters] for name in names}
    return pa.table(columns, schema=pa.schema(fields))


def rows_of(table: pa.Table) -> Iterator[Row]:
    """The rows of a table; without parameters where it has no such columns."""
    names = [name for name in table.column_names if name not in _FIXED]
    for values in table.to_pylist():
        errors = {}
        for prefix in _ERRORS:
            found = [values[f"{prefix}_{name}"] for name in _STATISTICS]
            errors[prefix] = None if found[0] is None else Statistics(found[0], found[1], found[2], found[3])
        yield Row(
            file=values["file"],
            kind=values["kind"],
            result=Result(values["result"]),
            message=values["message"],
            quality=values["quality"] or "",
            arm=values["arm"] or "",
            joints=values["joints"] or 0,
            samples=values["samples"] or 0,
            steps=values["steps"] or 0,
            parameters=tuple((name, values[name]) for name in names if values[name] is not None),
            **errors,
        )


def read_rows(path: str | Path, parameters: bool = True) -> Iterator[Row]:
    """The rows of a table that `write_rows` or a run wrote, a group of them in memory at a time.

    Args:
        path: of the file.
        parameters: whether they are wanted; to read the rest is faster.
    """
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        for group in range(file.num_row_groups):
            yield from rows_of(file.read_row_group(group, columns=None if parameters else list(_FIXED)))


def write_rows(rows: Sequence[Row], path: str | Path, overwrite: bool = False) -> Path:
    """Writes rows as Parquet.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    return write_tables(lambda: iter([table_of_rows(rows)]), Path(path), overwrite)


def _utf8(text: str) -> str:
    """The text with bytes of a file's name that are not UTF-8 spelled out."""
    return text.encode(errors="backslashreplace").decode()
