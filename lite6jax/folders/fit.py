"""Files of a folder read and fitted: calibrations together by type of arm, recordings one by one."""

import warnings
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
from lite6jax.arms.bundled import bundled_of
from lite6jax.arms.dh import is_table
from lite6jax.arms.factory import FactoryCalibration, factory_from, nearest_arms, read_factory
from lite6jax.errors import InputError, InputWarning
from lite6jax.fitting.fleet import fit_calibrations
from lite6jax.fitting.quality import Quality, Result, quality_of_calibration
from lite6jax.fitting.start import SAMPLES
from lite6jax.folders.place import kind_of
from lite6jax.folders.rows import Row, Statistics
from lite6jax.model import ModelForm

Array = NDArray[np.floating]
T = TypeVar("T")


class _Content(NamedTuple):
    """What a calibration file holds: the parsed YAML and its rows `(joint, 6)`; nothing of a JSON table."""

    parsed: Any
    kinematics: Array | None


class _NotOneError(InputError):
    """A file of the right suffix that does not mean to be a calibration."""


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

    def attempt(path: Path, work: Callable[[], T]) -> T | None:
        """What comes of the work; None where nothing does, and the row says why."""
        kind = kind_of(path)
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", InputWarning)
                done = work()
        except InputError as error:
            kind, said = "other" if isinstance(error, _NotOneError) else kind, str(error)
        except Exception as error:  # a defect of ours, met on one file, is no reason to lose the others
            found = " ".join(f"{type(error).__name__}: {error}".split())
            said = f"{path}: unexpected {found}; please report it with this file"
        else:
            remarks[path] += [str(each.message) for each in caught if issubclass(each.category, InputWarning)]
            return done
        rows[path], remarks[path] = Row(path.name, kind, Result.UNREADABLE, as_shown(said)), []
        return None

    read: dict[Path, _Content] = {}
    for path in files:
        if kind_of(path) == "recording":
            if (row := attempt(path, partial(_fit_recording, path, nominal))) is not None:
                rows[path] = row
        elif (content := attempt(path, partial(_read, path))) is not None:
            read[path] = content
    types: dict[str, dict[Path, FactoryCalibration]] = {}
    for path, near in _recognise(read, nominal).items():
        calibration = attempt(path, partial(_calibration, path, read[path], near, nominal))
        if calibration is not None:
            types.setdefault(calibration.arm.name, {})[path] = calibration
    for alike in types.values():
        rows |= _fit_calibrations(alike)
    for path, said in remarks.items():
        if said:
            message = f"{rows[path].message}; {as_shown('; '.join(dict.fromkeys(said)))}"
            rows[path] = replace(rows[path], message=message)
    return [rows[path] for path in files]


def _read(path: Path) -> _Content:
    if path.suffix.lower() not in (".yaml", ".yml"):
        return _Content(None, None)
    content = storage.read_yaml(path)
    if is_table(content):
        return _Content(None, None)
    if not isinstance(content, dict) or "kinematics" not in content:
        raise _NotOneError(f"{path}: not a calibration (it has no key 'kinematics'); passed over")
    if "name" in content:
        raise _NotOneError(f"{path}: not a calibration but the description of a type of arm; passed over")
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
    for i, path in enumerate(alike):
        result = Result(int(fitted.result[i]))
        errors = [Statistics(*map(float, part[i])) for part in (fitted.fitted, fitted.checked, fitted.nominal)]
        quality = quality_of_calibration(fitted.checked[i, 1:2])
        yield (
            path,
            Row(
                file=path.name,
                kind="calibration",
                result=result,
                message=result.message + _remark(quality),
                quality=quality.verdict,
                arm=arm.name,
                joints=arm.dof,
                samples=SAMPLES,
                steps=int(fitted.steps[i]),
                parameters=_parameters(form, fitted.parameters[i]),
                fitted=errors[0],
                checked=errors[1],
                nominal=errors[2],
            ),
        )


def _fit_recording(path: Path, nominal: Arm | None) -> Row:
    # a folder of calibrations does not import what recordings take
    from lite6jax.domains.pose.fit import fit_recording
    from lite6jax.fitting.source import read_source
    from lite6jax.recordings import Recording

    recording = read_source(path, nominal)
    assert isinstance(recording, Recording)
    solution = fit_recording(recording, nominal)
    faults = f"; data faults: {', '.join(fault.code for fault in solution.faults)}" if solution.faults else ""
    return Row(
        file=path.name,
        kind="recording",
        result=solution.result,
        message=solution.result.message + _remark(solution.quality) + faults,
        quality=solution.quality.verdict,
        arm=solution.arm.name,
        joints=solution.arm.dof,
        samples=recording.samples,
        steps=solution.steps,
        parameters=_parameters(ModelForm(solution.form.chain), solution.parameters),
        fitted=Statistics.of(solution.errors),
        checked=Statistics.of(solution.checked),
        nominal=Statistics.of(solution.nominal_errors),
    )


def _parameters(form: ModelForm, parameters: Array) -> tuple[tuple[str, float], ...]:
    """Parameters by their names with the unit."""
    values = np.asarray(parameters).tolist()
    return tuple((f"{name}_{unit}", value) for name, unit, value in zip(form.names, form.units, values, strict=True))


def _remark(quality: Quality) -> str:
    return "; but the model does not describe the data" if quality.verdict == "bad" else ""
