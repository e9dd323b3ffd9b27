"""What is to be fitted: an arm, a calibration or a recording, by name or file; and which bundled arm a recording is of.

Where nobody says which arm a recording is of, each with as many joints is tried by its nominal table.
"""

import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lite6jax import suffixes
from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_of
from lite6jax.arms.factory import RECOGNISED_WITHIN, FactoryCalibration, read_factory
from lite6jax.arms.files import calibrated_arm, read_arm
from lite6jax.array_types import Array
from lite6jax.calibration.quality import upper_quartile
from lite6jax.calibration.start import declared_tool, frames_from_recording
from lite6jax.errors import InputError, InputWarning, wrong_type
from lite6jax.recordings import (
    Recording,
    RecordingSettings,
    check_scale,
    no_recording,
    read_recording,
    read_settings,
    recording_file,
    require_own_sidecar,
    require_radians,
    require_samples,
    sidecar_path,
)
from lite6jax.storage import check_readable, exists

ALIKE = 2.0
"""Times the error of the best arm, within which another one is as likely: the errors of two arms of one model differ by
as much. A real UR10 is 0.8 mm from its nominal table with the sensor's frame and the tool fitted."""
_SHOWN = 4
Match = tuple[Arm, float]


def load_nominal(nominal: Arm | str | Path | None) -> Arm | None:
    """An arm by its name or from its file, or as it is."""
    if nominal is None or isinstance(nominal, Arm):
        return nominal
    if not isinstance(nominal, str | Path):
        raise wrong_type("arm", nominal, "an Arm, the name of a bundled one, or the path of an arm's file")
    return read_arm(str(nominal))


def load_recording(
    recording: Recording | str | Path,
    arm: Arm | None = None,
    *,
    assume_degrees: bool = False,
    assume_millimetres: bool = False,
) -> Recording:
    """A recording as it is, or from its file, as `read_source` reads it."""
    if isinstance(recording, Recording):
        return recording
    if not isinstance(recording, str | Path):
        made = "a Recording as Recording.from_arrays and Recording.from_dataframe make it"
        raise wrong_type("recording", recording, f"the path of a recording, or {made}")
    if recording_file(recording) is None:
        raise InputError(f"{recording}: {_describe_other_file(recording)}")
    source = read_source(recording, arm, assume_degrees=assume_degrees, assume_millimetres=assume_millimetres)
    assert isinstance(source, Recording)
    return source


def _describe_other_file(path: str | Path) -> str:
    """What a file is that is no recording, and what is to be given."""
    if Path(path).suffix.lower() in suffixes.CALIBRATIONS and exists(path):
        check_readable(path)
        with suppress(InputError), warnings.catch_warnings(action="ignore"):
            read_factory(path)
            return "is a calibration; give a recording (.csv, .parquet, .mcap, .bag)"
    return no_recording(path)


def read_source(
    path: str | Path, arm: Arm | None, *, assume_degrees: bool = False, assume_millimetres: bool = False
) -> FactoryCalibration | Recording:
    """A calibration or a recording, by the file's suffix.

    Its nominal arm is taken from the sidecar, or recognised, where it is not given.

    Raises:
        InputError: as their readers; or a recording declares no arm and fits no bundled one, or several alike.

    Warns:
        InputWarning: a recording declares no arm and looks like a bundled one, which is then taken as declared.
    """
    file = recording_file(path)
    if file is None:
        if Path(path).suffix.lower() in ("", *suffixes.CALIBRATIONS) and not Path(path).is_dir():
            return read_factory(path, arm)
        raise InputError(f"{path}: {no_recording(path)}")
    require_own_sidecar(file)
    arm = arm or declared_arm(read_settings(sidecar_path(file)), file.parent)
    assumptions: dict[str, Any] = {"assume_degrees": assume_degrees, "assume_millimetres": assume_millimetres}
    if arm is not None:
        return read_recording(path, arm=arm, joint_limits=arm.possible_positions, reach=arm.reach, **assumptions)
    recording = read_recording(path, **assumptions)
    bundled = bundled_of(recording.dof)
    if bundled:  # a wrong unit is no reason to find no arm
        limits = _widest_limits(bundled)
        reach = max(arm.reach for arm in bundled)
        check_scale(recording, limits, reach, degrees=assume_degrees, millimetres=assume_millimetres)
    if not recording.numbers_per_sample:
        return recording
    return with_arm(recording, warn=True)


def arm_of(recording: Recording) -> Arm:
    """The nominal arm of a recording: the one that it declares, else the bundled one that it looks like.

    Raises:
        InputError: as `read_arm` and `read_factory`; no measured poses; no bundled arm fits, or several do alike.
    """
    declared = declared_arm(recording.settings, Path(recording.source).parent)
    return declared or _choose(recording, matches(recording))


def declared_arm_of(recording: Recording) -> Arm:
    """The nominal arm that a recording declares; refuses one that declares none, which only poses would show."""
    arm = declared_arm(recording.settings, Path(recording.source).parent)
    if arm is None:
        raise InputError(f"{recording.source}: declares no arm; name it with `arm=NAME`, or `arm:` in the sidecar")
    return arm


def with_calibration(arm: Arm, recording: Recording) -> Arm:
    """The arm with the chain of the factory calibration that a recording declares; itself where it declares none."""
    file = recording.settings.factory_calibration
    if file is None:
        return arm
    return calibrated_arm(read_factory(Path(recording.source).parent / file, arm))


def declared_arm(settings: RecordingSettings, folder: Path) -> Arm | None:
    """The nominal arm that settings in a folder declare, or that of the calibration that they do; None where they
    declare neither."""
    if settings.arm is not None:
        return read_arm(settings.arm_reference(folder))
    factory = settings.factory_path(folder)
    return None if factory is None else read_factory(factory).arm


def with_arm(recording: Recording, warn: bool = False) -> Recording:
    """The recording with its arm declared: as it is where it declares one or its calibration, else the recognised one.

    The arms that were tried are named in the recording's notes, or in a warning.

    Raises:
        InputError: as `arm_of`.
    """
    if recording.settings.arm is not None or recording.settings.factory_calibration is not None:
        return recording
    if recording.touches is not None:
        raise InputError(
            f"{recording.source}: declares no arm, which touches do not tell; name it with `arm=NAME`, or `arm:` in "
            "the sidecar"
        )
    candidates = matches(recording)
    name = _choose(recording, candidates).name
    recording = replace(recording, settings=replace(recording.settings, arm=name))
    note = f"no arm is declared, and this looks like a {_listed(candidates)}; say so by `arm: {name}` in a sidecar"
    if warn:
        warnings.warn(f"{recording.source}: {note}", InputWarning, stacklevel=3)
        return recording
    return replace(recording, notes=(*recording.notes, note))


def matches(recording: Recording) -> list[Match]:
    """The bundled arms of as many joints and their errors in a recording, the nearest first.

    An error, m, is what three quarters of the position errors do not exceed; the sensor's frame and the tool are fitted
    where they are unknown, the geometry is not. Refuses joint positions in degrees and what has no poses.
    """
    require_samples(recording, 1)
    bundled = bundled_of(recording.dof)
    if bundled:  # a wrong unit is no reason to find no arm
        require_radians(recording.joint_position, _widest_limits(bundled), f"{recording.source}: joint_position")
    tool = None
    if recording.settings.tool != "unknown":
        tool = declared_tool(recording)
    position = recording.position
    arm_errors = []
    assert position is not None
    for arm in bundled:
        flange = frames.chain(arm.links, recording.joint_position, arm.sliding) @ arm.T_joint_flange
        T_sensor_base, T_flange_tool = frames_from_recording(recording, flange, tool)
        point = (flange @ T_flange_tool)[:, :3, 3] @ T_sensor_base[:3, :3].T + T_sensor_base[:3, 3]
        arm_errors.append((arm, upper_quartile(np.linalg.norm(point - position, axis=1))))
    return sorted(arm_errors, key=lambda match: match[1])


def _widest_limits(arms: Sequence[Arm]) -> Array:
    """`(joint, 2)` rad, of several arms of as many joints together."""
    limits = np.stack([arm.joint_limits for arm in arms])
    return np.stack([limits[..., 0].min(0), limits[..., 1].max(0)], 1)


def _choose(recording: Recording, candidates: Sequence[Match]) -> Arm:
    undeclared = f"{recording.source}: declares no arm, and"
    remedy = "name it with `arm=NAME`, or `arm:` in the sidecar"
    if not candidates:
        raise InputError(f"{undeclared} no bundled one has {recording.dof} joints; {remedy}")
    nearest, error = candidates[0]
    if not error <= RECOGNISED_WITHIN:
        raise InputError(
            f"{undeclared} its poses fit no bundled one (nearest: {_listed(candidates)}); {remedy}, or check the "
            f"joints' order, signs and units"
        )
    similar = [match for match in candidates if match[1] <= max(ALIKE * error, 1e-9)]
    if len(similar) > 1:
        raise InputError(f"{undeclared} fits several alike ({_listed(similar)}); {remedy}")
    return nearest


def _listed(candidates: Sequence[Match]) -> str:
    """The nearest arms with their errors in mm."""
    shown = "; ".join(f"{arm.name}: {1e3 * error:.3g} mm" for arm, error in candidates[:_SHOWN])
    return shown + ("; …" if len(candidates) > _SHOWN else "")
