"""Every file of a folder fitted: a row each with its result, in batches by type of arm; a bad file stops nothing."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration, read_factory
from lite6jax.errors import InputError
from lite6jax.fitting.calibration_fit import CHECK_SAMPLES, SAMPLES
from lite6jax.fitting.chunks import CHUNK
from lite6jax.fitting.fleet import fit_fleet
from lite6jax.fitting.problem import calibration_poses, sample_within_limits
from lite6jax.fitting.quality import Quality, quality_of_calibration
from lite6jax.fitting.recording_fit import fit_recording
from lite6jax.fitting.solution import Errors, Result, Solution, prediction_errors
from lite6jax.fitting.source import read_source
from lite6jax.model import ArmModel, ModelForm
from lite6jax.recordings import Recording

Array = NDArray[np.floating]
Kind = Literal["calibration", "recording", "other"]
Progress = Callable[[int], object]
RecordingFit = Callable[[Recording, Arm | None], Solution]
T = TypeVar("T")

CALIBRATIONS = (".yaml", ".yml", ".json")
RECORDINGS = (".csv", ".parquet")


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
    fitted: Errors | None = None
    checked: Errors | None = None
    nominal: Errors | None = None


def folder_files(folder: str | Path, leave_out: Path | None = None) -> list[Path]:
    """The calibrations and recordings of a folder by name; a recording's sidecar belongs to it and is not listed.

    Raises:
        InputError: not a folder, or none in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: {'is not a folder' if folder.exists() else 'no such folder'}; name one")
    out = leave_out.resolve() if leave_out else None
    files = sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in CALIBRATIONS + RECORDINGS
        and path.is_file()
        and not path.name.startswith(".")
        and path.resolve() != out
    )
    recordings = {path.stem for path in files if path.suffix.lower() in RECORDINGS}
    files = [path for path in files if path.suffix.lower() != ".yaml" or path.stem not in recordings]
    if not files:
        accepted = ", ".join(CALIBRATIONS + RECORDINGS)
        raise InputError(f"{folder}: has no calibration or recording ({accepted}); name another folder")
    return files


def fit_folder(
    files: Sequence[Path],
    nominal: Arm | None = None,
    progress: Progress = lambda done: None,
    fit_one: RecordingFit = fit_recording,
) -> list[Row]:
    """Fits every file: calibrations together by type of arm, recordings one by one.

    Args:
        files: as `folder_files` lists them.
        nominal: the arm of all of them; recognised file by file where not given.
        progress: called with the number of files done since the last call.
        fit_one: the fit of a recording, such as one that screens it for data faults first.

    Returns:
        a row a file, in their order.
    """
    rows: dict[Path, Row] = {}
    batches: dict[str, list[tuple[Path, FactoryCalibration]]] = {}
    for path in (path for path in files if path.suffix.lower() in CALIBRATIONS):
        calibration = _attempt(path, lambda path=path: _read_calibration(path, nominal))
        if isinstance(calibration, Row):
            rows[path] = calibration
            progress(1)
        else:
            batches.setdefault(calibration.arm.name, []).append((path, calibration))
    for batch in batches.values():
        paths, calibrations = [path for path, _ in batch], [calibration for _, calibration in batch]
        rows |= zip(paths, _fit_batch(paths, calibrations, progress), strict=True)
    for path in (path for path in files if path.suffix.lower() in RECORDINGS):
        rows[path] = _attempt(path, lambda path=path: _fit_recording(path, nominal, fit_one))
        progress(1)
    return [rows[path] for path in files]


class _NotOneError(InputError):
    """A file of the right suffix that does not mean to be a calibration."""


def _attempt(path: Path, work: Callable[[], T]) -> T | Row:
    kind: Kind = "recording" if path.suffix.lower() in RECORDINGS else "calibration"
    try:
        return work()
    except _NotOneError as error:
        return Row(path.name, "other", Result.UNREADABLE, str(error))
    except InputError as error:
        return Row(path.name, kind, Result.UNREADABLE, str(error))
    except Exception as error:  # a defect of ours, met on one file, is no reason to lose the others
        found = " ".join(f"{type(error).__name__}: {error}".split())
        return Row(path.name, kind, Result.UNREADABLE, f"{path}: unexpected {found}; please report it with this file")


def _read_calibration(path: Path, nominal: Arm | None) -> FactoryCalibration:
    if path.suffix.lower() != ".json":
        content = storage.read_yaml(path)
        if not isinstance(content, dict) or "kinematics" not in content:
            raise _NotOneError(f"{path}: not a calibration (it has no key 'kinematics'); passed over")
        if "name" in content:
            raise _NotOneError(f"{path}: not a calibration but the description of a type of arm; passed over")
    return read_factory(path, nominal)


def _fit_batch(paths: Sequence[Path], calibrations: Sequence[FactoryCalibration], progress: Progress) -> Iterable[Row]:
    """Arms of one type in one call; filled up to whole chunks, so that batches of any size share compiled code."""
    arm, count = calibrations[0].arm, len(calibrations)
    filled = [calibrations[min(i, count - 1)] for i in range(-(-count // CHUNK) * CHUNK)]
    q = sample_within_limits(arm, SAMPLES, 0)
    fresh = sample_within_limits(arm, CHECK_SAMPLES, 1)
    done = [0]

    def report(more: int) -> None:
        before, done[0] = done[0], done[0] + more
        progress(min(done[0], count) - min(before, count))

    form = ModelForm(arm.form)
    poses = np.stack([calibration_poses(calibration, q) for calibration in filled])
    solution = fit_fleet(q, poses, nominal=arm, progress=report)
    start = ArmModel(arm.hayati, np.eye(4), arm.T_joint_flange)  # type: ignore[arg-type]
    for i, (path, calibration) in enumerate(zip(paths, calibrations, strict=True)):
        result = Result(int(solution.result[i]))
        model = start._replace(geometry=solution.parameters[i])
        pose = calibration_poses(calibration, fresh)
        checked = prediction_errors(form, model, fresh, pose)
        quality = quality_of_calibration(checked.position)
        yield Row(
            file=path.name,
            kind="calibration",
            result=result,
            message=result.message + _qualified(quality),
            quality=quality.verdict,
            arm=arm.name,
            joints=arm.dof,
            samples=SAMPLES,
            steps=int(solution.steps[i]),
            parameters=_named(form, solution.parameters[i]),
            fitted=prediction_errors(form, model, q, poses[i]),
            checked=checked,
            nominal=prediction_errors(form, start, fresh, pose),
        )


def _fit_recording(path: Path, nominal: Arm | None, fit_one: RecordingFit) -> Row:
    recording = read_source(path, nominal)
    assert isinstance(recording, Recording)
    solution = fit_one(recording, nominal)
    faults = f"; data faults: {', '.join(fault.code for fault in solution.faults)}" if solution.faults else ""
    return Row(
        file=path.name,
        kind="recording",
        result=solution.result,
        message=solution.result.message + _qualified(solution.quality) + faults,
        quality=solution.quality.verdict,
        arm=solution.arm.name,
        joints=solution.arm.dof,
        samples=recording.samples,
        steps=solution.steps,
        parameters=_named(ModelForm(solution.form.chain), solution.parameters),
        fitted=solution.errors,
        checked=solution.checked,
        nominal=solution.nominal_errors,
    )


def _qualified(quality: Quality) -> str:
    return "; but the model does not describe the data" if quality.verdict == "bad" else ""


def _named(form: ModelForm, parameters: Array) -> tuple[tuple[str, float], ...]:
    return tuple(
        (f"{name}_{unit}", float(value)) for name, unit, value in zip(form.names, form.units, parameters, strict=True)
    )


def write_rows(rows: Sequence[Row], path: str | Path, overwrite: bool = False) -> Path:
    """Writes rows as Parquet, SI units in the column names; what a row does not have is null.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    import pyarrow
    import pyarrow.parquet

    names = list(dict.fromkeys(name for row in rows for name, _ in row.parameters))
    columns: dict[str, pyarrow.Array] = {
        "file": pyarrow.array([row.file for row in rows]),
        "kind": pyarrow.array([row.kind for row in rows]),
        "result": pyarrow.array([int(row.result) for row in rows], pyarrow.int32()),
        "quality": pyarrow.array([row.quality or None for row in rows], pyarrow.string()),
        "message": pyarrow.array([row.message for row in rows]),
        "arm": pyarrow.array([row.arm or None for row in rows], pyarrow.string()),
        "joints": pyarrow.array([row.joints or None for row in rows], pyarrow.int32()),
        "samples": pyarrow.array([row.samples or None for row in rows], pyarrow.int64()),
        "steps": pyarrow.array([row.steps if row.parameters else None for row in rows], pyarrow.int32()),
    }
    for prefix in ("fitted", "checked", "nominal"):
        for name, values in _statistics([getattr(row, prefix) for row in rows]).items():
            columns[f"{prefix}_{name}"] = pyarrow.array(values, pyarrow.float64())
    for name in names:
        columns[name] = pyarrow.array([dict(row.parameters).get(name) for row in rows], pyarrow.float64())
    table = pyarrow.table(columns)
    return storage.write_atomically(path, lambda target: pyarrow.parquet.write_table(table, target), overwrite)


def _statistics(found: Sequence[Errors | None]) -> dict[str, list[float | None]]:
    def rms(values: Array | None) -> float | None:
        return None if values is None else float(np.sqrt(np.mean(values**2)))

    def largest(values: Array | None) -> float | None:
        return None if values is None else float(values.max())

    position = [errors and errors.position for errors in found]
    orientation = [errors and errors.orientation for errors in found]
    return {
        "position_rms_m": [rms(values) for values in position],
        "position_max_m": [largest(values) for values in position],
        "orientation_rms_rad": [rms(values) for values in orientation],
        "orientation_max_rad": [largest(values) for values in orientation],
    }


def failed(rows: Sequence[Row]) -> list[Row]:
    """Those that a person should look at: not readable, not converged, or with a model that is not one of the data."""
    return [row for row in rows if row.result != Result.CONVERGED or row.quality == "bad"]
