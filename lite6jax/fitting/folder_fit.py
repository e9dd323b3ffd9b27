"""The files of a folder read and fitted, in batches by type of arm; a bad file stops nothing."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration, read_factory
from lite6jax.errors import InputError
from lite6jax.fitting.calibration_fit import CHECK_SAMPLES, SAMPLES
from lite6jax.fitting.chunks import CHUNK
from lite6jax.fitting.fleet import fit_fleet
from lite6jax.fitting.folder_rows import Row, Statistics, kind_of
from lite6jax.fitting.problem import calibration_poses, sample_within_limits
from lite6jax.fitting.quality import Quality, quality_of_calibration
from lite6jax.fitting.solution import Result, Solution, prediction_errors
from lite6jax.fitting.source import read_source
from lite6jax.model import ArmModel, ModelForm
from lite6jax.recordings import Recording

Array = NDArray[np.floating]
RecordingFit = Callable[[Recording, Arm | None], Solution]
T = TypeVar("T")


def fit_files(
    files: Sequence[Path],
    nominal: Arm | None,
    fit_one: RecordingFit,
    at: Callable[[Path | None, int], object] = lambda path, done: None,
) -> list[Row]:
    """Fits calibrations together by type of arm, recordings one by one.

    Args:
        files: calibrations and recordings.
        nominal: the arm of all of them; recognised file by file where not given.
        fit_one: the fit of a recording.
        at: called with the file in hand, or None where it is a batch, and with the number of files done.

    Returns:
        a row a file, in their order.
    """
    rows: dict[Path, Row] = {}
    batches: dict[str, list[tuple[Path, FactoryCalibration]]] = {}
    for path in (path for path in files if kind_of(path) == "calibration"):
        at(path, len(rows))
        calibration = _attempt(path, lambda path=path: _read_calibration(path, nominal))
        if isinstance(calibration, Row):
            rows[path] = calibration
        else:
            batches.setdefault(calibration.arm.name, []).append((path, calibration))
    for batch in batches.values():
        paths, calibrations = [path for path, _ in batch], [calibration for _, calibration in batch]
        before = len(rows)
        rows |= zip(paths, _fit_batch(paths, calibrations, lambda done, n=before: at(None, n + done)), strict=True)
    for path in (path for path in files if kind_of(path) == "recording"):
        at(path, len(rows))
        rows[path] = _attempt(path, lambda path=path: _fit_recording(path, nominal, fit_one))
    at(None, len(rows))
    return [rows[path] for path in files]


class _NotOneError(InputError):
    """A file of the right suffix that does not mean to be a calibration."""


def _attempt(path: Path, work: Callable[[], T]) -> T | Row:
    try:
        return work()
    except _NotOneError as error:
        return Row(path.name, "other", Result.UNREADABLE, str(error))
    except InputError as error:
        return Row(path.name, kind_of(path), Result.UNREADABLE, str(error))
    except Exception as error:  # a defect of ours, met on one file, is no reason to lose the others
        found = " ".join(f"{type(error).__name__}: {error}".split())
        message = f"{path}: unexpected {found}; please report it with this file"
        return Row(path.name, kind_of(path), Result.UNREADABLE, message)


def _read_calibration(path: Path, nominal: Arm | None) -> FactoryCalibration:
    if path.suffix.lower() != ".json":
        content = storage.read_yaml(path)
        if not isinstance(content, dict) or "kinematics" not in content:
            raise _NotOneError(f"{path}: not a calibration (it has no key 'kinematics'); passed over")
        if "name" in content:
            raise _NotOneError(f"{path}: not a calibration but the description of a type of arm; passed over")
    return read_factory(path, nominal)


def _fit_batch(
    paths: Sequence[Path], calibrations: Sequence[FactoryCalibration], done: Callable[[int], object]
) -> Iterable[Row]:
    """Arms of one type in one call; filled up to whole chunks, so that batches of any size share compiled code."""
    arm, count = calibrations[0].arm, len(calibrations)
    filled = [calibrations[min(i, count - 1)] for i in range(-(-count // CHUNK) * CHUNK)]
    q = sample_within_limits(arm, SAMPLES, 0)
    fresh = sample_within_limits(arm, CHECK_SAMPLES, 1)
    form = ModelForm(arm.form)
    done(0)
    poses = np.stack([calibration_poses(calibration, q) for calibration in filled])
    solution = fit_fleet(q, poses, nominal=arm)
    start = ArmModel(arm.hayati, np.eye(4), arm.T_joint_flange)  # type: ignore[arg-type]
    for i, (path, calibration) in enumerate(zip(paths, calibrations, strict=True)):
        done(i)
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
            fitted=Statistics.of(prediction_errors(form, model, q, poses[i])),
            checked=Statistics.of(checked),
            nominal=Statistics.of(prediction_errors(form, start, fresh, pose)),
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
        fitted=Statistics.of(solution.errors),
        checked=Statistics.of(solution.checked),
        nominal=Statistics.of(solution.nominal_errors),
    )


def _qualified(quality: Quality) -> str:
    return "; but the model does not describe the data" if quality.verdict == "bad" else ""


def _named(form: ModelForm, parameters: Array) -> tuple[tuple[str, float], ...]:
    return tuple(
        (f"{name}_{unit}", float(value)) for name, unit, value in zip(form.names, form.units, parameters, strict=True)
    )
