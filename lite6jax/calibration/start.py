"""What fits start from: joint positions and poses of calibrated chains, and frames of recordings in closed form.

All of it is NumPy, so that nothing is compiled.
"""

from typing import TYPE_CHECKING

import numpy as np
import scipy  # whose parts are imported where they are first used: `spatial` takes half a second

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.array_types import Array
from lite6jax.recordings.alignment import frames_from_poses

if TYPE_CHECKING:  # a fleet of calibrations does not import what recordings take
    from lite6jax.recordings import Recording


SAMPLES = 300
"""Joint positions that a calibration is fitted at."""
CHECK_SAMPLES = 1000
"""Other joint positions, at which the models of calibrations are compared: fitted, nominal, and of another arm."""


def sample_within_limits(arm: Arm, samples: int, seed: int) -> Array:
    """Joint positions `(sample, joint)`, uniform inside the arm's limits."""
    lower, upper = arm.joint_limits.T
    return np.random.default_rng(seed).uniform(lower, upper, (samples, arm.dof))


def check_positions(arm: Arm, seed: int = 0) -> Array:
    """`CHECK_SAMPLES` joint positions beside those that are drawn by `seed`: by default the same in every command, so
    that a distance between two geometries is one number."""
    return sample_within_limits(arm, CHECK_SAMPLES, seed + 1)


def nominal_calibration(arm: Arm) -> FactoryCalibration:
    """The nominal chain, as the calibration of an arm that does not deviate."""
    return FactoryCalibration(arm.kinematics, arm, arm.T_joint_flange, arm.name)


def calibration_poses(calibration: FactoryCalibration, joint_position: Array) -> Array:
    """The calibrated chain's flange poses `(sample, 4, 4)`."""
    links = np.array([frames.transform_from_row(row) for row in calibration.kinematics])
    return frames.chain(links, joint_position, calibration.arm.sliding) @ calibration.T_joint_flange


def measured_rotations(recording: "Recording") -> Array | None:
    """The measured orientations `(sample, 3, 3)` of a recording, whose quaternions may have any norm; None without."""
    if recording.quaternion is None:
        return None
    return scipy.spatial.transform.Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()


def declared_tool(recording: "Recording") -> Array:
    """`T_flange_tool` `(4, 4)` as the settings declare it, the identity where they declare none."""
    tool = recording.settings.tool
    if isinstance(tool, str):
        return np.eye(4)
    return frames.transform_from_row(tool)


def frames_from_recording(recording: "Recording", flange: Array, tool: Array | None) -> tuple[Array, Array]:
    """As `frames_from_poses`, with the sensor frame known where the settings say that it is the arm's base."""
    frame = np.eye(4) if recording.settings.pose_frame == "base" else None
    position = recording.position
    assert position is not None
    return frames_from_poses(flange, position, measured_rotations(recording), frame, tool)
