"""Several stations: poses that a sensor measured from several places are carried into one frame before screening."""

from dataclasses import replace
from functools import partial

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array
from lite6jax.calibration.start import measured_rotations
from lite6jax.domains.pose.kinematics import rigid_frames, unit_quaternions
from lite6jax.domains.pose.rigid_arm import RigidArm, rigid_arm
from lite6jax.domains.pose.screening import hypotheses
from lite6jax.domains.pose.screening.screened import ScreenedPoses
from lite6jax.errors import InputError, command_line
from lite6jax.recordings import Recording
from lite6jax.recordings.alignment import frames_from_poses

FEWEST_POSES = 8
"""Of a station: its frame has six numbers, and some poses must show what the others determine."""


def join_stations(state: ScreenedPoses) -> ScreenedPoses:
    """The poses of all stations in the first one's frame, as far as the arm as declared shows them.

    Each station is a recording of its own, in which gross faults are corrected before its frame is found; the joined
    recording is screened for these faults afterwards. What is left of its frame is a nuisance (`sensors.pose`).

    Raises:
        InputError: too few poses of a station, or poses that are mirrored, inverted or of another convention.
    """
    recording = state.recording
    station = state.recording.station
    parts: list[RigidArm] = []
    for k in range(len(recording.stations) + 1):
        part = replace(recording.select(station == k), stations=())
        if part.samples < FEWEST_POSES:
            raise InputError(
                f"{recording.source}: {part.samples} poses of file {k + 1} do not determine where its sensor stood; "
                f"record {FEWEST_POSES} or more from each place"
            )
        parts.append(_without_gross_faults(state, part))
    largest = max(parts, key=lambda part: part.samples)
    frames = [_sensor_frame(part, largest.T_flange_tool) for part in parts]
    carried = partial(_carry, to_first=frames[0] @ np.linalg.inv(frames))
    return replace(state, data=carried(recording)).transformed(carried)


def _without_gross_faults(state: ScreenedPoses, part: Recording) -> RigidArm:
    """The rigid arm of one station, with its frames in closed form."""

    def rigid(recording: Recording, arm: Arm | None = state.arm) -> RigidArm:
        return rigid_arm(recording, arm, state.geometry, state.factory)

    begun = rigid(part)
    corrected = hypotheses.correct_mismatch(replace(state, data=part, rigid=begun, arm=begun.arm)).recording
    changed = [
        code
        for code, before, after in (
            ("positions", part.position, corrected.position),
            ("orientations", part.quaternion, corrected.quaternion),
        )
        if before is not None and after is not None and not np.array_equal(before, after)
    ]
    if changed:
        raise InputError(
            f"{part.source}: the {changed[0]} of rows {part.row[0]} to {part.row[-1]} are not as declared; "
            f"`{command_line('check', part.source)}` of each file alone says how"
        )
    return rigid(corrected, begun.arm)


def _sensor_frame(arm: RigidArm, T_flange_tool: Array) -> Array:
    """`T_sensor_base` with the tool that all stations share."""
    if not arm.form.frame:
        return arm.T_sensor_base
    in_base = arm.start._replace(T_sensor_base=np.eye(4))  # type: ignore[arg-type]
    flange = rigid_frames(in_base, arm.joint_position, arm.recording.sliding).frames[-1]
    assert arm.recording.position is not None
    return frames_from_poses(flange, arm.recording.position, None, None, T_flange_tool)[0]


def _carry(recording: Recording, to_first: Array) -> Recording:
    """The recording with each station's poses in the first one's frame, by `to_first` `(station, 4, 4)`."""
    T = to_first[recording.station]
    assert recording.position is not None
    position = np.einsum("sab,sb->sa", T[:, :3, :3], recording.position) + T[:, :3, 3]
    rotation = measured_rotations(recording)
    quaternion = None
    if rotation is not None:
        quaternion = unit_quaternions(T[:, :3, :3] @ rotation)
    return replace(recording, position=position, quaternion=quaternion)
