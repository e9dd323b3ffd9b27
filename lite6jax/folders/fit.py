"""Files of a folder read and fitted: calibrations together by type of arm, recordings one by one."""

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
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
from lite6jax.arms.factory import FactoryCalibration, factory_from, nearest_arms, read_factory
from lite6jax.arms.table import is_table
from lite6jax.errors import InputError, InputWarning
from lite6jax.fitting.fleet import fit_calibrations
from lite6jax.fitting.quality import Quality, Result, quality_of_calibration
from lite6jax.fitting.start import SAMPLES
from lite6jax.folders.place import kind_of
from lite6jax.folders.rows import Row, Statistics
from lite6jax.model import ModelForm

Array = NDArray[np.floating]
T = TypeVar("T")


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
    read: dict[Path, tuple[_Content, str]] = {}
    for path in files:
        work = _fit_recording if kind_of(path) == "recording" else _read
        done, said = _attempt(path, partial(work, path, nominal), as_shown)
        if isinstance(done, Row):
            rows[path] = replace(done, message=f"{done.message}; {said}") if said else done
        else:
            read[path] = done, said
    types: dict[str, list[tuple[Path, FactoryCalibration, str]]] = {}
    for path, near in _recognised({path: content for path, (content, _) in read.items()}, nominal).items():
        content, said = read[path]
        work = partial(_calibration, path, content, near, nominal)
        done, more = _attempt(path, work, as_shown)
        if isinstance(done, Row):
            rows[path] = done
        else:
            types.setdefault(done.arm.name, []).append((path, done, "; ".join(filter(None, (said, more)))))
    for alike in types.values():
        rows |= zip((path for path, _, _ in alike), _fit_calibrations(alike), strict=True)
    return [rows[path] for path in files]


class _Content(NamedTuple):
    """What a calibration file holds: the parsed YAML and its rows `(joint, 6)`; nothing of a JSON table."""

    parsed: Any
    kinematics: Array | None


class _NotOneError(InputError):
    """A file of the right suffix that does not mean to be a calibration."""


def _attempt(path: Path, work: Callable[[], T], as_shown: Callable[[str], str]) -> tuple[T | Row, str]:
    """What comes of the work, or the row that says why nothing does; and what was remarked on the way."""
    try:
        with warnings.catch_warnings(record=True) as remarks:
            warnings.simplefilter("always", InputWarning)
            done = work()
    except _NotOneError as error:
        return Row(path.name, "other", Result.UNREADABLE, as_shown(str(error))), ""
    except InputError as error:
        return Row(path.name, kind_of(path), Result.UNREADABLE, as_shown(str(error))), ""
    except Exception as error:  # a defect of ours, met on one file, is no reason to lose the others
        found = " ".join(f"{type(error).__name__}: {error}".split())
        message = as_shown(f"{path}: unexpected {found}; please report it with this file")
        return Row(path.name, kind_of(path), Result.UNREADABLE, message), ""
    said = dict.fromkeys(str(remark.message) for remark in remarks if issubclass(remark.category, InputWarning))
    return done, as_shown("; ".join(said))


def _read(path: Path, nominal: Arm | None) -> _Content:
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


def _recognised(read: Mapping[Path, _Content], nominal: Arm | None) -> dict[Path, Arm | None]:
    """The arm that each calibration is near; None where it takes a closer look."""
    found: dict[Path, Arm | None] = dict.fromkeys(read)
    by_joints: dict[int, list[tuple[Path, Array]]] = {}
    for path, (_, kinematics) in read.items():
        if kinematics is not None:
            by_joints.setdefault(len(kinematics), []).append((path, kinematics))
    for joints, chains in by_joints.items():
        arms = bundled_of(joints) if nominal is None else [nominal] * (nominal.dof == joints and not nominal.sliding)
        if arms:
            near = nearest_arms(np.stack([kinematics for _, kinematics in chains]), arms)
            found |= zip((path for path, _ in chains), near, strict=True)
    return found


def _calibration(path: Path, content: _Content, near: Arm | None, nominal: Arm | None) -> FactoryCalibration:
    if near is not None and content.kinematics is not None:
        return FactoryCalibration(content.kinematics, near, near.T_joint_flange, str(path))
    return read_factory(path, nominal) if content.parsed is None else factory_from(content.parsed, path, nominal)


def _fit_calibrations(alike: Sequence[tuple[Path, FactoryCalibration, str]]) -> Iterable[Row]:
    """Arms of one type in one call."""
    arm = alike[0][1].arm
    form = ModelForm(arm.form)
    kinematics = np.stack([calibration.kinematics for _, calibration, _ in alike])
    flanges = np.stack([calibration.T_joint_flange for _, calibration, _ in alike])
    fitted = fit_calibrations(kinematics, flanges, arm)
    named = [f"{name}_{unit}" for name, unit in zip(form.names, form.units, strict=True)]
    for i, (path, _, said) in enumerate(alike):
        result = Result(int(fitted.result[i]))
        errors = [Statistics(*map(float, part[i])) for part in (fitted.fitted, fitted.checked, fitted.nominal)]
        quality = quality_of_calibration(fitted.checked[i, 1:2])
        yield Row(
            file=path.name,
            kind="calibration",
            result=result,
            message=result.message + _qualified(quality) + (f"; {said}" if said else ""),
            quality=quality.verdict,
            arm=arm.name,
            joints=arm.dof,
            samples=SAMPLES,
            steps=int(fitted.steps[i]),
            parameters=tuple(zip(named, fitted.parameters[i].tolist(), strict=True)),
            fitted=errors[0],
            checked=errors[1],
            nominal=errors[2],
        )


def _fit_recording(path: Path, nominal: Arm | None) -> Row:
    # a folder of calibrations does not import what recordings take
    from lite6jax.domains.pose.fit import fit_recording
    from lite6jax.fitting.source import read_source
    from lite6jax.recordings import Recording

    recording = read_source(path, nominal)
    assert isinstance(recording, Recording)
    solution = fit_recording(recording, nominal)
    form = ModelForm(solution.form.chain)
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
        parameters=tuple(
            (f"{name}_{unit}", float(value))
            for name, unit, value in zip(form.names, form.units, solution.parameters, strict=True)
        ),
        fitted=Statistics.of(solution.errors),
        checked=Statistics.of(solution.checked),
        nominal=Statistics.of(solution.nominal_errors),
    )


def _qualified(quality: Quality) -> str:
    return "; but the model does not describe the data" if quality.verdict == "bad" else ""
