"""The condition of an arm from the 5 Hz report: errors, tool, payload, mounting and temperatures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lite6jax.controller import protocol
from lite6jax.controller.exchange import Address
from lite6jax.controller.stream import first_report
from lite6jax.errors import InputError

Array = NDArray[np.floating]

SECONDS = 3.0
"""The time limit for the first report; the rate is 5 Hz."""

NO_OFFSET_MM, NO_OFFSET_RAD = 1e-4, 1e-7
"""Smaller offsets count as zero: the rounding of decimetres to 32 bits."""


@dataclass(frozen=True, eq=False)
class Condition:
    """An arm's condition at one report.

    Attributes:
        error, warning: the codes of the controller; 0 for none.
        joint_position: `(7,)` rad, those of the arm first.
        tool_offset: `(6,)` x y z roll pitch yaw of the tool in the flange's frame, mm and rad.
        world_offset: `(6,)` likewise, of the base in the frame of the poses; zero if the report omits it.
        payload: `(4,)` kg and the centre of mass in the flange's frame, mm, as set in the controller.
        gravity_direction: `(3,)` unit vector in the base's frame, as set in the controller.
        temperature: `(7,)` °C, or None if the report omits it.
    """

    error: int
    warning: int
    joint_position: Array
    tool_offset: Array
    world_offset: Array
    payload: Array
    gravity_direction: Array
    temperature: Array | None

    @property
    def has_tool(self) -> bool:
        """Whether a tool offset is set."""
        return _is_offset(self.tool_offset)

    @property
    def has_world(self) -> bool:
        """Whether poses refer to another frame than the base."""
        return _is_offset(self.world_offset)

    @property
    def T_flange_tool(self) -> Array:
        """`(4, 4)` m, the tool in the flange's frame."""
        return protocol.transform_of_wire_pose(self.tool_offset)


def condition_of(report: np.void, place: str) -> Condition:
    """The condition in a report of port 30002 or 30001, from `protocol.read_report`.

    Raises:
        InputError: the report ends before the tool offset, or contains values that are not finite.
    """
    names = report.dtype.names or ()
    if "gravity_direction" not in names:
        raise InputError(
            f"{place}: reports of {report.dtype.itemsize} bytes end before the tool offset; update the firmware"
        )
    needed = ("joint_position", "tool_offset", "payload", *(["world_offset"] if "world_offset" in names else []))
    for name in needed:
        if not np.isfinite(report[name]).all():
            raise InputError(
                f"{place}: the report's {name.replace('_', ' ')} is not finite; restart the control box, and try again"
            )
    gravity = np.array(report["gravity_direction"], float)
    length = float(np.linalg.norm(gravity))
    upright = np.array([0.0, 0.0, -1.0])
    return Condition(
        error=int(report["error"]),
        warning=int(report["warning"]),
        joint_position=np.array(report["joint_position"], float),
        tool_offset=np.array(report["tool_offset"], float),
        world_offset=np.array(report["world_offset"], float) if "world_offset" in names else np.zeros(6),
        payload=np.array(report["payload"], float),
        gravity_direction=gravity / length if 0.5 < length < 2 else upright,
        temperature=np.array(report["temperature"], float) if "temperature" in names else None,
    )


def read_condition(address: Address, seconds: float = SECONDS) -> Condition:
    """The condition in the next report of port 30002.

    Raises:
        InputError: no report within `seconds`, or as `condition_of`.
    """
    return condition_of(first_report(address, protocol.RICH, seconds), f"{address.host}: port {protocol.RICH}")


def require_no_error(condition: Condition, address: Address) -> None:
    """Checks that the controller reports no error: tool offset and pose are unreliable otherwise.

    Raises:
        InputError: the controller reports an error.
    """
    if condition.error:
        raise InputError(
            f"{address}: the controller reports error {condition.error}, during which its tool offset is "
            "unreliable; clear the error with the vendor's program, and try again"
        )


def _is_offset(offset: Array) -> bool:
    return bool(np.abs(offset[:3]).max() > NO_OFFSET_MM or np.abs(offset[3:]).max() > NO_OFFSET_RAD)
