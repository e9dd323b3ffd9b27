"""Every file of a folder fitted into one table: a row a file, and of a bad file one that says why.

Calibrations are fitted together by type of arm, recordings one by one.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from lite6jax import storage
from lite6jax.calibration.quality import Quality, Result, quality_of_calibration
from lite6jax.deferred import import_lazily
from lite6jax.fleet.place import DIED, Place, attempt, divide, guess_kind, list_fleet
from lite6jax.workers import run_batches

with import_lazily():  # a program that has others do this does not import what it takes
    import numpy as np

    from lite6jax import model, recordings
    from lite6jax.arms import dh, factory
    from lite6jax.calibration import fleet, source, start
    from lite6jax.domains.pose import fit as pose_fit

if TYPE_CHECKING:
    import pyarrow as pa

    from lite6jax.arms.arm import Arm
    from lite6jax.calibration.solution import Errors

T = TypeVar("T")

_ERRORS = ("fitted", "checked", "nominal")
_STATISTICS = ("position_rms_m", "position_max_m", "orientation_rms_rad", "orientation_max_rad")


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
        turned = errors.orientation
        rms, most = (None, None) if turned is None else (float(np.sqrt(np.mean(turned**2))), float(turned.max()))
        return cls(errors.position_rms, float(errors.position.max()), rms, most)


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
    kind: Literal["calibration", "recording", "other"]
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


def fit_folder(
    folder: str | Path,
    out: str | Path,
    nominal: "Arm | None" = None,
    *,
    scheduler: str | None = None,
    processes: int | None = None,
    progress: Callable[[int, int], object] = lambda done, total: None,
    overwrite: bool = False,
) -> Path:
    """Fits every calibration and recording of a folder, and writes a row a file, in the order of their names.

    Args:
        folder: a path, or a URL; its subfolders are not read.
        out: the Parquet file to write.
        nominal: the arm of all of them; recognised file by file where not given.
        scheduler, processes: as `run_batches`.
        progress: called with the number of files done since the last call, and of all.
        overwrite: whether a file that is there may be replaced.

    Raises:
        InputError: as `Place.of`, `list_fleet` and `run_batches`.
    """
    place, out = Place.of(folder), Path(out)
    names = list_fleet(place, out)
    return run_batches(
        fit_names,
        divide(names),
        (place, nominal),
        out=out,
        died=lambda name: tabulate_rows([Row(name, guess_kind(name), Result.UNREADABLE, f"{name}: {DIED}")]),
        scheduler=scheduler,
        processes=processes,
        progress=lambda done: progress(done, len(names)),
        overwrite=overwrite,
    )


def fit_names(names: Sequence[str], place: Place, nominal: "Arm | None") -> "pa.Table":
    """The rows of some files of a folder, in their order."""
    with place.local_folder(names) as folder:
        rows = fit_files([folder / name for name in names], nominal, lambda said: place.show(said, folder))
    return tabulate_rows(rows)


# ------------------------------------------------------------------ the fits


def fit_files(
    files: Sequence[Path], nominal: "Arm | None", as_shown: Callable[[str], str] = lambda message: message
) -> list[Row]:
    """Fits calibrations and recordings, none of which stops the others: a row a file, in their order.

    `as_shown` makes of a message what the user is to read.
    """
    rows: dict[Path, Row] = {}
    remarks: dict[Path, str] = {}
    types: dict[str, dict[Path, factory.FactoryCalibration]] = {}
    for path in files:
        fit = _fit_recording if guess_kind(path) == "recording" else _read_calibration
        found, remarks[path] = attempt(path, partial(fit, path, nominal))
        if found is None:
            rows[path] = Row(path.name, guess_kind(path), Result.UNREADABLE, as_shown(remarks[path]))
        elif isinstance(found, str):
            rows[path] = Row(path.name, "other", Result.UNREADABLE, as_shown(found))
        elif isinstance(found, Row):
            rows[path] = found
        else:
            types.setdefault(found.arm.name, {})[path] = found
    for alike in types.values():
        rows |= _fit_calibrations(alike)
    for path, row in rows.items():
        if remarks[path] and row.result != Result.UNREADABLE:
            rows[path] = replace(row, message=f"{row.message}; {as_shown(remarks[path])}")
    return [rows[path] for path in files]


def _read_calibration(path: Path, nominal: "Arm | None") -> "factory.FactoryCalibration | str":
    """The calibration in a file, or why it is none."""
    if path.suffix.lower() in (".yaml", ".yml") and not dh.is_table(content := storage.read_yaml(path)):
        if not isinstance(content, dict) or "kinematics" not in content:
            return f"{path}: not a calibration (it has no key 'kinematics'); passed over"
        if "name" in content:
            return f"{path}: not a calibration but the description of a type of arm; passed over"
        return factory.factory_from(content, path, nominal)
    return factory.read_factory(path, nominal)


def _fit_calibrations(alike: "Mapping[Path, factory.FactoryCalibration]") -> Iterator[tuple[Path, Row]]:
    """The rows of arms of one type, fitted in one call."""
    calibrations = list(alike.values())
    arm = calibrations[0].arm
    form = model.ModelForm(arm.form)
    kinematics = np.stack([calibration.kinematics for calibration in calibrations])
    flanges = np.stack([calibration.T_joint_flange for calibration in calibrations])
    fitted = fleet.fit_calibrations(kinematics, flanges, arm)
    for i, (path, result, steps) in enumerate(zip(alike, fitted.result, fitted.steps, strict=True)):
        errors = (Statistics(*map(float, part[i])) for part in (fitted.fitted, fitted.checked, fitted.nominal))
        quality = quality_of_calibration(fitted.checked[i, 1:2])
        row = Row(path.name, "calibration", Result(int(result)), "", samples=start.SAMPLES, steps=int(steps))
        yield path, _complete(row, arm, form, fitted.parameters[i], quality, *errors)


def _fit_recording(path: Path, nominal: "Arm | None") -> Row:
    recording = source.read_source(path, nominal)
    assert isinstance(recording, recordings.Recording)
    found = pose_fit.fit_recording(recording, nominal)
    errors = map(Statistics.of, (found.errors, found.checked, found.nominal_errors))
    faults = f"; data faults: {', '.join(fault.code for fault in found.faults)}" if found.faults else ""
    row = Row(path.name, "recording", found.result, faults, samples=recording.samples, steps=found.steps)
    return _complete(row, found.arm, model.ModelForm(found.form.chain), found.parameters, found.quality, *errors)


def _complete(
    row: Row, arm: "Arm", form: "model.ModelForm", parameters: Any, quality: Quality, *errors: Statistics
) -> Row:
    """A row with what was fitted of an arm; `errors` are those of the fitted and of other data, and of the nominal."""
    values = zip(form.names, form.units, np.asarray(parameters).tolist(), strict=True)
    misfit = "; but the model does not describe the data" if quality.verdict == "bad" else ""
    return replace(
        row,
        message=row.result.message + misfit + row.message,
        quality=quality.verdict,
        arm=arm.name,
        joints=arm.dof,
        parameters=tuple((f"{name}_{unit}", value) for name, unit, value in values),
        **dict(zip(_ERRORS, errors, strict=True)),
    )


# ------------------------------------------------------------------ the table


def tabulate_rows(rows: Sequence[Row]) -> "pa.Table":
    """Rows as columns, SI units in their names; what a row does not have is null."""
    import pyarrow as pa

    found: list[dict[str, Any]] = []
    for row in rows:
        values = {name: getattr(row, name) or None for name in ("quality", "arm", "joints", "samples")}
        values |= {"file": _utf8(row.file), "kind": row.kind, "result": int(row.result), "message": _utf8(row.message)}
        values["steps"] = row.steps if row.parameters else None
        for part in _ERRORS:
            if (errors := getattr(row, part)) is not None:
                values |= zip((f"{part}_{name}" for name in _STATISTICS), vars(errors).values(), strict=True)
        found.append(values | dict(row.parameters))
    parameters = dict.fromkeys(name for row in rows for name, _ in row.parameters)
    return pa.Table.from_pylist(found, pa.schema(_columns() | dict.fromkeys(parameters, pa.float64())))


def read_rows(path: str | Path, parameters: bool = True) -> Iterator[Row]:
    """The rows of a table that a run wrote, a group of them in memory at a time; faster without `parameters`."""
    import pyarrow.parquet as pq

    fixed = _columns()
    with pq.ParquetFile(path) as file:
        for group in range(file.num_row_groups):
            for values in file.read_row_group(group, columns=None if parameters else list(fixed)).to_pylist():
                row = {name: values.pop(name) for name in fixed}
                for part in _ERRORS:
                    errors = [row.pop(f"{part}_{name}") for name in _STATISTICS]
                    row[part] = None if errors[0] is None else Statistics(*errors)
                row |= {name: row[name] or "" for name in ("quality", "arm")}
                row |= {name: row[name] or 0 for name in ("joints", "samples", "steps")}
                row["result"] = Result(row["result"])
                yield Row(**row, parameters=tuple(pair for pair in values.items() if pair[1] is not None))


def _columns() -> "dict[str, pa.DataType]":
    """Those of every table, in their order; those of the parameters come after them."""
    import pyarrow as pa

    return {
        "file": pa.string(), "kind": pa.string(), "result": pa.int32(), "quality": pa.string(), "message": pa.string(),
        "arm": pa.string(), "joints": pa.int32(), "samples": pa.int64(), "steps": pa.int32(),
        **{f"{part}_{name}": pa.float64() for part in _ERRORS for name in _STATISTICS},
    }  # fmt: skip


def _utf8(text: str) -> str:
    """The text with bytes of a file's name that are not UTF-8 spelled out."""
    return text.encode(errors="backslashreplace").decode()
