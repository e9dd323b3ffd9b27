"""What is known of an arm before it is recorded: its calibration, tool, payload, mounting, in a sidecar's words."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import bundled_arms
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.controller.calibration import SilentError, UncalibratedError, read_calibration
from lite6jax.controller.condition import Condition, read_condition
from lite6jax.controller.exchange import Address
from lite6jax.controller.recorded import factory_path
from lite6jax.errors import InputError
from lite6jax.recordings import RecordingSettings
from lite6jax.recordings.settings import LONGEST_OFFSET_M

STREAM_NOISE = 5e-8, 5e-7
"""m and rad, one sigma: joints and poses of the reports are 32-bit numbers."""
FK_NOISE = 3e-8, 3e-7
"""The same of a pose alone."""


@dataclass(frozen=True, eq=False)
class Station:
    """An arm where it stands.

    Attributes:
        arm: the nominal arm.
        arm_name: the bundled arm's name, or the path of a description.
        calibration: the arm's own, or None where the controller has none to give.
        condition: what the slow report said, or None where there is none.
        notes: what is missing, and what follows from it, one sentence each.
    """

    arm: Arm
    arm_name: str
    calibration: FactoryCalibration | None
    condition: Condition | None
    notes: tuple[str, ...]

    @property
    def T_flange_tool(self) -> np.ndarray:
        """`(4, 4)` m; the identity where the tool is not known."""
        return np.eye(4) if self.condition is None else self.condition.T_flange_tool

    def settings_beside(self, out: Path, joints: str = "measured") -> RecordingSettings:
        """The sidecar of a recording of this arm.

        Args:
            out: the recording, beside which the sidecar and the calibration stand.
            joints: "measured" of a motion that is recorded, "commanded" of joints for which the controller was asked.
        """
        arm = self.arm_name
        if arm not in bundled_arms():
            arm = Path(os.path.relpath(Path(arm).resolve(), out.resolve().parent)).as_posix()
        tool = "unknown" if self.condition is None else "none"
        com, gravity = (0.0, 0.0, 0.0), (0.0, 0.0, -9.81)
        base = False
        if (condition := self.condition) is not None:
            base = not condition.has_world
            if condition.has_tool:
                tool = (*(condition.tool_offset[:3] / 1e3).tolist(), *condition.tool_offset[3:].tolist())
            if condition.payload[0] > 0 and np.linalg.norm(condition.payload[1:]) < 1e3 * LONGEST_OFFSET_M:
                com = tuple((condition.payload[1:] / 1e3).tolist())
            if np.abs(condition.gravity_direction - [0, 0, -1]).max() > 1e-6:
                gravity = tuple((9.81 * condition.gravity_direction).tolist())
        asked = joints == "commanded"
        noise = FK_NOISE if asked else STREAM_NOISE
        return RecordingSettings(
            arm=arm,
            factory_calibration=None if self.calibration is None else factory_path(out).name,
            joint_source="commanded" if asked else "measured",
            pose_source="controller_fk",
            motion="static" if asked else "trajectory",
            pose_frame="base" if base else "unknown",
            tool=tool,
            position_noise_m=noise[0],
            orientation_noise_rad=noise[1],
            payload_com_m=com,
            gravity_m_per_s2=gravity,
        )


def read_station(address: Address, arm: Arm, arm_name: str) -> Station:
    """Asks a controller for what a recording should say of its arm; passive throughout.

    Raises:
        InputError: as `read_calibration`, but for a controller that has no calibration or does not answer for it.
    """
    notes = []
    calibration = condition = None
    try:
        read = read_calibration(address, arm)
        calibration = read.calibration
    except (UncalibratedError, SilentError) as error:
        without = str(error).partition(": ")[2].partition(";")[0]
        notes.append(f"the geometry stays unknown: {without}")
    try:
        condition = read_condition(address)
    except InputError as error:
        notes.append(f"no temperatures, and the tool stays unknown: {str(error).partition(';')[0]}")
    else:
        if condition.error:
            notes.append(f"the controller reports error {condition.error}; clear it with the vendor's program")
        if condition.has_world:
            notes.append("the controller has a base offset set, so that the sidecar calls the pose frame unknown")
    return Station(arm, arm_name, calibration, condition, tuple(notes))
