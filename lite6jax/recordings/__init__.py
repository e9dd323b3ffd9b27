"""Recordings: the samples of one arm's motion and measured poses, their files, and what is wrong with them."""

from lite6jax.recordings.checks import (
    check_torque_scale,
    check_velocity_scale,
    estimated_torque,
    outside_limits,
    repeated_rows,
    require_samples,
    time_disorder,
)
from lite6jax.recordings.files import (
    Targets,
    assemble_motion,
    read_motion,
    read_recording,
    read_targets,
    recording_file,
    stranger,
    write_recording,
)
from lite6jax.recordings.readings import Readings, readings_from_arrays
from lite6jax.recordings.recording import (
    Recording,
    check_scale,
    drop_missing,
    join_recordings,
)
from lite6jax.recordings.ros import ArmJoints
from lite6jax.recordings.settings import (
    FactoryUncertainty,
    RecordingSettings,
    read_settings,
    sidecar_path,
    write_settings,
)
from lite6jax.recordings.units import require_radians

__all__ = [
    "ArmJoints",
    "FactoryUncertainty",
    "Readings",
    "Recording",
    "RecordingSettings",
    "Targets",
    "assemble_motion",
    "check_scale",
    "check_torque_scale",
    "check_velocity_scale",
    "drop_missing",
    "estimated_torque",
    "join_recordings",
    "outside_limits",
    "read_motion",
    "read_recording",
    "read_settings",
    "read_targets",
    "readings_from_arrays",
    "recording_file",
    "repeated_rows",
    "require_radians",
    "require_samples",
    "sidecar_path",
    "stranger",
    "time_disorder",
    "write_recording",
    "write_settings",
]
