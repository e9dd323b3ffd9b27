"""Recordings: the samples of one arm's motion and measured poses, their files, and what is wrong with them.

What the columns of a table hold is recognised in `recordings.columns` alone.
"""

# isort: off
from lite6jax.recordings.checks import (
    check_torque_scale as check_torque_scale,
    check_velocity_scale as check_velocity_scale,
    estimated_torque as estimated_torque,
    outside_limits as outside_limits,
    repeated_rows as repeated_rows,
    require_one_station as require_one_station,
    require_samples as require_samples,
    time_disorder as time_disorder,
)
from lite6jax.recordings.files import (
    Targets as Targets,
    assemble_motion as assemble_motion,
    no_recording as no_recording,
    read_motion as read_motion,
    read_recording as read_recording,
    read_targets as read_targets,
    recording_file as recording_file,
    require_own_sidecar as require_own_sidecar,
    write_recording as write_recording,
)
from lite6jax.recordings.readings import Readings as Readings, readings_from_arrays as readings_from_arrays
from lite6jax.recordings.recording import (
    Recording as Recording,
    check_scale as check_scale,
    drop_missing as drop_missing,
    join_recordings as join_recordings,
)
from lite6jax.recordings.ros import ArmJoints as ArmJoints
from lite6jax.recordings.settings import (
    FactoryUncertainty as FactoryUncertainty,
    RecordingSettings as RecordingSettings,
    read_settings as read_settings,
    sidecar_path as sidecar_path,
    write_settings as write_settings,
)
from lite6jax.recordings.units import require_radians as require_radians
