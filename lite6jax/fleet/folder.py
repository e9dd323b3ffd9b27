"""Every file of a folder fitted into one table: a row a file, and of a bad file one that says why.

Calibrations are fitted together by type of arm, recordings one by one.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lite6jax import storage, suffixes
from lite6jax.calibration.quality import Quality, Result, quality_of_calibration
from lite6jax.deferred import import_lazily
from lite6jax.fleet.place import DIED, StorageFolder, attempt, divide, guess_kind, list_fleet
from lite6jax.workers import run_batches

with import_lazily():  # a program that has others do this does not import what it takes
    import numpy as np

    from lite6jax import recordings
    from lite6jax.arms import dh, factory
    from lite6jax.calibration import fleet, solution, source, start
    from lite6jax.domains.pose import fit as pose_fit

if TYPE_CHECKING:
    import pyarrow as pa

    from lite6jax.arms.arm import Arm
    from lite6jax.arms.chains import HayatiForm, SixParameterForm

Row = dict[str, Any]
"""One file of a folder by the columns of the table: those of `columns`, then the parameters, in m and rad."""
ERRORS = ("fitted", "checked", "nominal")
"""Errors of the data fitted, of data not fitted (fresh samples, or held-out blocks), and of the nominal geometry."""
STATISTICS = ("position_rms_m", "position_max_m", "orientation_rms_rad", "orientation_max_rad")


def columns() -> "dict[str, pa.DataType]":
    """The columns of every table, in their order; those of the parameters come after them."""
    import pyarrow as pa

    return {
        "file": pa.string(), "kind": pa.string(), "result": pa.int32(), "quality": pa.string(), "message": pa.string(),
        "arm": pa.string(), "joints": pa.int32(), "samples": pa.int64(), "steps": pa.int32(),
        **{f"{part}_{name}": pa.float64() for part in ERRORS for name in STATISTICS},
    }  # fmt: skip


def has_failed(row: Mapping[str, Any]) -> bool:
    """Tells whether a person should look at it: not readable, not converged, or its model is none of the data."""
    return row["result"] != Result.CONVERGED or row["quality"] == "bad"


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

    The folder is a path or a URL, and its subfolders are not read. Without a `nominal` arm that of each file is
    recognised. `progress` is called with the number of files done since the last call, and of all; the other arguments
    are those of `run_batches`.

    Raises:
        InputError: as `StorageFolder.of`, `list_fleet` and `run_batches`.
    """
    place = StorageFolder.of(folder)
    out = Path(out)
    names = list_fleet(place, out)
    return run_batches(
        fit_names,
        divide(names),
        (place, nominal),
        out=out,
        died=lambda name: tabulate_rows([_refusal(name, f"{name}: {DIED}")]),
        scheduler=scheduler,
        processes=processes,
        progress=lambda done: progress(done, len(names)),
        overwrite=overwrite,
    )


def fit_names(names: Sequence[str], place: StorageFolder, nominal: "Arm | None") -> "pa.Table":
    """The rows of some files of a folder, in their order."""
    with place.local_folder(names) as folder:
        rows = fit_files([folder / name for name in names], nominal, lambda message: place.show(message, folder))
    return tabulate_rows(rows)


def tabulate_rows(rows: Sequence[Row]) -> "pa.Table":
    """Rows as a table; what a row does not have is null."""
    import pyarrow as pa

    fixed = columns()
    parameters = dict.fromkeys((name for row in rows for name in row if name not in fixed), pa.float64())
    # bytes of a file's name that are not UTF-8 are spelled out
    escaped = (
        {name: row[name].encode(errors="backslashreplace").decode() for name in ("file", "message")} for row in rows
    )
    return pa.Table.from_pylist(
        [row | more for row, more in zip(rows, escaped, strict=True)], pa.schema(fixed | parameters)
    )


def read_rows(path: str | Path, parameters: bool = True) -> Iterator[Row]:
    """The rows of a table that a run wrote, a group of them in memory at a time; faster without `parameters`."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        for group in range(file.num_row_groups):
            yield from file.read_row_group(group, columns=None if parameters else list(columns())).to_pylist()


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
        outcome, remark = attempt(path, partial(fit, path, nominal))
        if outcome is None:
            rows[path] = _refusal(path.name, as_shown(remark))
        elif isinstance(outcome, str):
            rows[path] = _refusal(path.name, as_shown(outcome), "other")
        else:
            remarks[path] = f"; {as_shown(remark)}" if remark else ""
            if isinstance(outcome, dict):
                rows[path] = outcome
            else:
                types.setdefault(outcome.arm.name, {})[path] = outcome
    for calibrations in types.values():
        rows |= _fit_calibrations(calibrations)
    for path, remark in remarks.items():
        rows[path]["message"] += remark
    return [rows[path] for path in files]


def _read_calibration(path: Path, nominal: "Arm | None") -> "factory.FactoryCalibration | str":
    """The calibration in a file, or why it is none."""
    if path.suffix.lower() in suffixes.YAML and not dh.is_table(content := storage.read_yaml(path)):
        if not isinstance(content, dict) or "kinematics" not in content:
            return f"{path}: not a calibration (it has no key 'kinematics'); passed over"
        if "name" in content:
            return f"{path}: not a calibration but the description of a type of arm; passed over"
        return factory.factory_from(content, path, nominal)
    return factory.read_factory(path, nominal)


def _fit_calibrations(calibration_of: "Mapping[Path, factory.FactoryCalibration]") -> Iterator[tuple[Path, Row]]:
    """The rows of arms of one type, fitted in one call."""
    calibrations = list(calibration_of.values())
    arm = calibrations[0].arm
    kinematics = np.stack([calibration.kinematics for calibration in calibrations])
    flanges = np.stack([calibration.T_joint_flange for calibration in calibrations])
    fitted = fleet.fit_calibrations(kinematics, flanges, arm)
    for path, result, steps, parameters, errors in zip(calibration_of, *fitted, strict=True):
        quality = quality_of_calibration(errors[1, 1:2])
        row = {"file": path.name, "kind": "calibration", "samples": start.SAMPLES, "steps": int(steps)}
        yield path, row | _fitted(Result(int(result)), arm, arm.form, parameters, quality, errors.ravel().tolist())


def _fit_recording(path: Path, nominal: "Arm | None") -> Row:
    recording = source.read_source(path, nominal)
    assert isinstance(recording, recordings.Recording)
    fit = pose_fit.fit_recording(recording, nominal)
    errors = chain.from_iterable(map(_statistics, (fit.errors, fit.checked, fit.nominal_errors)))
    row = {"file": path.name, "kind": "recording", "samples": recording.samples, "steps": fit.steps}
    row |= _fitted(fit.result, fit.arm, fit.form.chain, fit.parameters, fit.quality, errors)
    if fit.faults:
        row["message"] += f"; data faults: {', '.join(fault.code for fault in fit.faults)}"
    return row


def _statistics(errors: "solution.Errors") -> list[float | None]:
    """The `STATISTICS`, without orientation where none was measured."""
    statistics: list[float | None] = [errors.position_rms, float(errors.position.max())]
    turned = errors.orientation
    return statistics + ([None, None] if turned is None else [float(np.sqrt(np.mean(turned**2))), float(turned.max())])


def _fitted(
    result: Result, arm: "Arm", form: "HayatiForm | SixParameterForm", parameters: Any, quality: Quality,
    errors: Iterable[float | None],
) -> Row:  # fmt: skip
    """What was fitted of an arm, as part of a row; `errors` are the `STATISTICS` of each of `ERRORS`."""
    misfit = ""
    if quality.verdict == "bad":
        misfit = "; but the model does not describe the data"
    row: Row = {"result": int(result), "quality": quality.verdict, "message": result.message + misfit}
    row |= {"arm": arm.name, "joints": arm.dof}
    row |= zip((f"{part}_{name}" for part in ERRORS for name in STATISTICS), errors, strict=True)
    values = zip(form.names, form.units, np.asarray(parameters).tolist(), strict=True)
    return row | {f"{name}_{unit}": value for name, unit, value in values}


def _refusal(name: str, message: str, kind: str | None = None) -> Row:
    """The row of a file that was not fitted, and why."""
    return {"file": name, "kind": kind or guess_kind(name), "result": int(Result.UNREADABLE), "message": message}
