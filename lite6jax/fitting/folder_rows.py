"""The table of a folder: a row a file with how its fit ended, as plain numbers and words."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lite6jax import storage
from lite6jax.fitting.solution import Errors, Result

Kind = Literal["calibration", "recording", "other"]

CALIBRATIONS = (".yaml", ".yml", ".json")
RECORDINGS = (".csv", ".parquet", ".arrows")
_ERRORS = ("fitted", "checked", "nominal")


@dataclass(frozen=True)
class Statistics:
    """Distances between prediction and measurement: their root mean square and largest, m and rad."""

    position_rms: float
    position_max: float
    orientation_rms: float | None
    orientation_max: float | None

    @classmethod
    def of(cls, errors: Errors) -> "Statistics":
        """Those of errors, without orientation where none was measured."""
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

    def as_json(self) -> dict[str, Any]:
        """Plain values, from which `from_json` makes the same row, bit for bit."""
        return asdict(self) | {"result": int(self.result)}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> "Row":
        """The row of `as_json`.

        Raises:
            KeyError, TypeError, ValueError: not such values.
        """
        made: dict[str, Any] = {"result": Result(values["result"])}
        made |= {name: values[name] and Statistics(**values[name]) for name in _ERRORS}
        made["parameters"] = tuple((str(name), float(value)) for name, value in values["parameters"])
        return cls(**(values | made))


def kind_of(path: Path) -> Kind:
    """What a file should be, by its name."""
    return "calibration" if path.suffix.lower() in CALIBRATIONS else "recording"


def write_rows(rows: Sequence[Row], path: str | Path, overwrite: bool = False) -> Path:
    """Writes rows as Parquet, SI units in the column names; what a row does not have is null.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    import pyarrow
    import pyarrow.parquet

    names = list(dict.fromkeys(name for row in rows for name, _ in row.parameters))
    columns: dict[str, pyarrow.Array] = {
        "file": pyarrow.array([_utf8(row.file) for row in rows]),
        "kind": pyarrow.array([row.kind for row in rows]),
        "result": pyarrow.array([int(row.result) for row in rows], pyarrow.int32()),
        "quality": pyarrow.array([row.quality or None for row in rows], pyarrow.string()),
        "message": pyarrow.array([_utf8(row.message) for row in rows]),
        "arm": pyarrow.array([row.arm or None for row in rows], pyarrow.string()),
        "joints": pyarrow.array([row.joints or None for row in rows], pyarrow.int32()),
        "samples": pyarrow.array([row.samples or None for row in rows], pyarrow.int64()),
        "steps": pyarrow.array([row.steps if row.parameters else None for row in rows], pyarrow.int32()),
    }
    for prefix in _ERRORS:
        for name, unit in (("position", "m"), ("orientation", "rad")):
            for statistic in ("rms", "max"):
                found = [getattr(getattr(row, prefix), f"{name}_{statistic}", None) for row in rows]
                columns[f"{prefix}_{name}_{statistic}_{unit}"] = pyarrow.array(found, pyarrow.float64())
    for name in names:
        columns[name] = pyarrow.array([dict(row.parameters).get(name) for row in rows], pyarrow.float64())
    table = pyarrow.table(columns)
    write = partial(pyarrow.parquet.write_table, table, write_page_checksum=True)
    return storage.write_atomically(path, write, overwrite)


def _utf8(text: str) -> str:
    """The text with bytes of a file's name that are not UTF-8 spelled out."""
    return text.encode(errors="backslashreplace").decode()


def failed(rows: Sequence[Row]) -> list[Row]:
    """Those that a person should look at: not readable, not converged, or with a model that is not one of the data."""
    return [row for row in rows if row.result != Result.CONVERGED or row.quality == "bad"]
