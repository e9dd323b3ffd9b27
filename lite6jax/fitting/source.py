"""What is to be fitted, by the file's suffix: a calibration or a recording, with its nominal arm."""

from pathlib import Path

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration, read_factory
from lite6jax.arms.files import read_arm
from lite6jax.recordings import Recording, read_recording, read_settings, recording_file, sidecar_path


def load_nominal(nominal: Arm | str | None) -> Arm | None:
    """An arm by name, or as it is."""
    return read_arm(nominal) if isinstance(nominal, str) else nominal


def read_source(
    path: str | Path, arm: Arm | None, *, assume_degrees: bool = False, assume_millimetres: bool = False
) -> FactoryCalibration | Recording:
    """A calibration or a recording, by the file's suffix.

    Args:
        path: the file.
        arm: its nominal arm; recognised, or taken from the sidecar, where not given.
        assume_degrees: of a recording, as in `read_recording`.
        assume_millimetres: likewise.

    Raises:
        InputError: as their readers.
    """
    file = recording_file(path)
    if file is None:
        return read_factory(path, arm)
    arm = arm or read_arm(read_settings(sidecar_path(file)).arm_reference(file.parent))
    return read_recording(
        path,
        dof=arm.dof,
        assume_degrees=assume_degrees,
        assume_millimetres=assume_millimetres,
        joint_limits=arm.joint_limits,
        reach=arm.reach,
    )
