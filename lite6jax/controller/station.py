"""The connected arm before a recording: calibration, tool, payload and mounting, as the content of a sidecar."""

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
"""m and rad, one standard deviation: the rounding of joints and poses in reports to 32 bits."""
FK_NOISE = 3e-8, 3e-7
"""m and rad, one standard deviation: the rounding of poses alone."""


@dataclass(frozen=True, eq=False)
class Station:
    """A connected arm and its settings.

    Attributes:
        arm: the nominal arm.
        arm_name: the bundled arm's name, or the path of a description.
        calibration: the factory calibration, or None if the controller provides none.
        condition: from the 5 Hz report, or None without one.
        notes: missing data and their consequences, one sentence each.
    """

    arm: Arm
    arm_name: str
    calibration: FactoryCalibration | None
    condition: Condition | None
    notes: tuple[str, ...]

    @property
    def T_flange_tool(self) -> np.ndarray:
        """`(4, 4)` m, the tool in the flange's frame; the identity if the tool is unknown."""
        return np.eye(4) if self.condition is None else self.condition.T_flange_tool

    def settings_beside(self, out: Path, joints: str = "measured") -> RecordingSettings:
        """The content of the sidecar of a recording of this arm.

        Args:
            out: the recording; sidecar and calibration are beside it.
            joints: "measured" for a recorded motion, "commanded" for poses that the controller computed.
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
        computed = joints == "commanded"
        noise = FK_NOISE if computed else STREAM_NOISE
        return RecordingSettings(
            arm=arm,
            factory_calibration=None if self.calibration is None else factory_path(out).name,
            joint_source="commanded" if computed else "measured",
            pose_source="controller_fk",
            motion="static" if computed else "trajectory",
            pose_frame="base" if base else "unknown",
            tool=tool,
            position_noise_m=noise[0],
            orientation_noise_rad=noise[1],
            payload_com_m=com,
            gravity_m_per_s2=gravity,
        )


def read_station(address: Address, arm: Arm, arm_name: str) -> Station:
    """Reads calibration and condition of an arm from its controller, with passive requests only.

    Raises:
        InputError: as `read_calibration`, except that a missing calibration is noted.
    """
    notes = []
    calibration = condition = None
    try:
        read = read_calibration(address, arm)
        calibration = read.calibration
    except (UncalibratedError, SilentError) as error:
        reason = str(error).partition(": ")[2].partition(";")[0]
        notes.append(f"the geometry stays unknown: {reason}")
    try:
        condition = read_condition(address)
    except InputError as error:
        notes.append(f"no temperatures, and the tool stays unknown: {str(error).partition(';')[0]}")
    else:
        if condition.error:
            notes.append(f"the controller reports error {condition.error}; clear it with the vendor's program")
        if condition.has_world:
            notes.append("a base offset is set in the controller, so that the pose frame in the sidecar is unknown")
    return Station(arm, arm_name, calibration, condition, tuple(notes))
