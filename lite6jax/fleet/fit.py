"""Files of a folder read and fitted: calibrations together by type of arm, recordings one by one."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.arms import entries
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_of
from lite6jax.arms.dh import is_table
from lite6jax.arms.factory import FactoryCalibration, factory_from, nearest_arms, read_factory
from lite6jax.calibration.fleet import fit_calibrations
from lite6jax.calibration.quality import Quality, Result, quality_of_calibration
from lite6jax.calibration.start import SAMPLES
from lite6jax.deferred import import_lazily
from lite6jax.fleet.folder import Row, Statistics
from lite6jax.fleet.place import attempt, guess_kind
from lite6jax.model import ModelForm

with import_lazily():  # a folder of calibrations does not wait for what recordings take
    from lite6jax import recordings
    from lite6jax.calibration import source
    from lite6jax.domains.pose import fit as pose_fit

Array = NDArray[np.floating]
T = TypeVar("T")


class _Content(NamedTuple):
    """What a calibration file holds: the parsed YAML and its rows `(joint, 6)`; nothing of a JSON table."""

    parsed: Any
    kinematics: Array | None


def fit_files(
    files: Sequence[Path], nominal: Arm | None, as_shown: Callable[[str], str] = lambda message: message
) -> list[Row]:
    """Fits files, none of which stops the others.

    Args:
        files: calibrations and recordings.
        nominal: the arm of all of them; recognised file by file where not given.
        as_shown: a message as the user is to read it.

    Returns:
        a row a file, in their order.
    """
    rows: dict[Path, Row] = {}
    remarks: dict[Path, list[str]] = {path: [] for path in files}

    def try_work(path: Path, work: Callable[[], T]) -> T | None:
        """What comes of the work; None where nothing does, and the row says why."""
        done, said = attempt(path, work)
        if done is None:
            rows[path] = Row(path.name, guess_kind(path), Result.UNREADABLE, as_shown(said))
        elif said:
            remarks[path].append(said)
        return done

    read: dict[Path, _Content] = {}
    for path in files:
        if guess_kind(path) == "recording":
            if (row := try_work(path, partial(_fit_recording, path, nominal))) is not None:
                rows[path] = row
        elif isinstance(content := try_work(path, partial(_read, path)), str):
            rows[path] = Row(path.name, "other", Result.UNREADABLE, as_shown(content))
        elif content is not None:
            read[path] = content
    types: dict[str, dict[Path, FactoryCalibration]] = {}
    for path, near in _recognise(read, nominal).items():
        calibration = try_work(path, partial(_calibration, path, read[path], near, nominal))
        if calibration is not None:
            types.setdefault(calibration.arm.name, {})[path] = calibration
    for alike in types.values():
        rows |= _fit_calibrations(alike)
    for path, row in rows.items():
        if remarks[path] and row.result != Result.UNREADABLE:
            message = f"{row.message}; {as_shown('; '.join(dict.fromkeys(remarks[path])))}"
            rows[path] = replace(row, message=message)
    return [rows[path] for path in files]


def _read(path: Path) -> _Content | str:
    """What the file of a calibration holds, or why it is none."""
    if path.suffix.lower() not in (".yaml", ".yml"):
        return _Content(None, None)
    content = storage.read_yaml(path)
    if is_table(content):
        return _Content(None, None)
    if not isinstance(content, dict) or "kinematics" not in content:
        return f"{path}: not a calibration (it has no key 'kinematics'); passed over"
    if "name" in content:
        return f"{path}: not a calibration but the description of a type of arm; passed over"
    entries.mapping(content, f"{path}:", ("kinematics",))
    return _Content(content, entries.kinematics(content["kinematics"], str(path))[0])


def _recognise(read: Mapping[Path, _Content], nominal: Arm | None) -> dict[Path, Arm | None]:
    """The arm that each calibration is near; None where it takes a closer look."""
    found: dict[Path, Arm | None] = dict.fromkeys(read)
    by_joints: dict[int, dict[Path, Array]] = {}
    for path, (_, kinematics) in read.items():
        if kinematics is not None:
            by_joints.setdefault(len(kinematics), {})[path] = kinematics
    for joints, chains in by_joints.items():
        arms = bundled_of(joints) if nominal is None else [nominal] * (nominal.dof == joints and not nominal.sliding)
        if arms:
            found |= zip(chains, nearest_arms(np.stack([*chains.values()]), arms), strict=True)
    return found


def _calibration(path: Path, content: _Content, near: Arm | None, nominal: Arm | None) -> FactoryCalibration:
    if near is not None and content.kinematics is not None:
        return FactoryCalibration(content.kinematics, near, near.T_joint_flange, str(path))
    return read_factory(path, nominal) if content.parsed is None else factory_from(content.parsed, path, nominal)


def _fit_calibrations(alike: Mapping[Path, FactoryCalibration]) -> Iterator[tuple[Path, Row]]:
    """The rows of arms of one type, fitted in one call."""
    calibrations = list(alike.values())
    arm = calibrations[0].arm
    form = ModelForm(arm.form)
    kinematics = np.stack([calibration.kinematics for calibration in calibrations])
    flanges = np.stack([calibration.T_joint_flange for calibration in calibrations])
    fitted = fit_calibrations(kinematics, flanges, arm)
    for i, (path, result, steps) in enumerate(zip(alike, fitted.result, fitted.steps, strict=True)):
        errors = (Statistics(*map(float, part[i])) for part in (fitted.fitted, fitted.checked, fitted.nominal))
        quality = quality_of_calibration(fitted.checked[i, 1:2])
        row = Row(path.name, "calibration", Result(int(result)), "", samples=SAMPLES, steps=int(steps))
        yield path, _complete(row, arm, form, fitted.parameters[i], quality, *errors)


def _fit_recording(path: Path, nominal: Arm | None) -> Row:
    recording = source.read_source(path, nominal)
    assert isinstance(recording, recordings.Recording)
    found = pose_fit.fit_recording(recording, nominal)
    errors = map(Statistics.of, (found.errors, found.checked, found.nominal_errors))
    faults = f"; data faults: {', '.join(fault.code for fault in found.faults)}" if found.faults else ""
    row = Row(path.name, "recording", found.result, faults, samples=recording.samples, steps=found.steps)
    return _complete(row, found.arm, ModelForm(found.form.chain), found.parameters, found.quality, *errors)


def _complete(row: Row, arm: Arm, form: ModelForm, parameters: Array, quality: Quality, *errors: Statistics) -> Row:
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
        **dict(zip(("fitted", "checked", "nominal"), errors, strict=True)),
    )
