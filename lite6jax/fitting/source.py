"""What is to be fitted, by the file's suffix: a calibration or a recording, with its nominal arm."""

from pathlib import Path

from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import bundled_of
from lite6jax.arms.factory import FactoryCalibration, read_factory
from lite6jax.arms.files import read_arm
from lite6jax.errors import InputError, wrong_type
from lite6jax.fitting.recognition import declared_arm, widest_limits, with_arm
from lite6jax.recordings import (
    Recording,
    check_joint_scale,
    check_position_scale,
    read_recording,
    read_settings,
    recording_file,
    sidecar_path,
    stranger,
)


def load_nominal(nominal: Arm | str | Path | None) -> Arm | None:
    """An arm by its name or from its file, or as it is.

    Raises:
        InputError: another type, or as `read_arm`.
    """
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
    """A recording as it is, or from its file.

    Args:
        recording: either.
        arm, assume_degrees, assume_millimetres: of a file, as in `read_source`.

    Raises:
        InputError: another type, a calibration's file, or as `read_source`.
    """
    if isinstance(recording, Recording):
        return recording
    if not isinstance(recording, str | Path):
        raise wrong_type("recording", recording, f"the path of a recording, or {_MADE}")
    source = read_source(recording, arm, assume_degrees=assume_degrees, assume_millimetres=assume_millimetres)
    if not isinstance(source, Recording):
        raise InputError(f"{recording}: is a calibration; give a recording (.csv, .parquet, .mcap, .bag)")
    return source


_MADE = "a Recording as Recording.from_arrays and Recording.from_dataframe make it"


def read_source(
    path: str | Path, arm: Arm | None, *, assume_degrees: bool = False, assume_millimetres: bool = False
) -> FactoryCalibration | Recording:
    """A calibration or a recording, by the file's suffix.

    Args:
        path: the file.
        arm: its nominal arm; taken from the sidecar, or recognised, where not given.
        assume_degrees: of a recording, as in `read_recording`.
        assume_millimetres: likewise.

    Raises:
        InputError: as their readers; or a recording declares no arm and fits no bundled one, or several alike.

    Warns:
        InputWarning: a recording declares no arm and looks like a bundled one, which is then taken as declared.
    """
    file = recording_file(path)
    if file is None:
        if helps := stranger(path):
            raise InputError(f"{path}: {helps}")
        return read_factory(path, arm)
    arm = arm or declared_arm(read_settings(sidecar_path(file)), file.parent)
    if arm is None:
        return _of_undeclared_arm(path, assume_degrees, assume_millimetres)
    return read_recording(
        path,
        arm=arm,
        assume_degrees=assume_degrees,
        assume_millimetres=assume_millimetres,
        joint_limits=arm.possible_positions,
        reach=arm.reach,
    )


def _of_undeclared_arm(path: str | Path, assume_degrees: bool, assume_millimetres: bool) -> Recording:
    """A recording that says nothing of its arm, with the bundled arm that it looks like; without poses, as it is."""
    recording = read_recording(path, assume_degrees=assume_degrees, assume_millimetres=assume_millimetres)
    known = bundled_of(recording.dof)
    if known:  # a wrong unit is no reason to find no arm
        check_joint_scale(recording, widest_limits(known), assumed=assume_degrees)
        check_position_scale(recording, max(arm.reach for arm in known), assumed=assume_millimetres)
    return recording if recording.position is None else with_arm(recording, warn=True)
