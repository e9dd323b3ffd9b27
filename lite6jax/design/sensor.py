"""What a sensor reads off the tool, with which noise, and how its reading changes as the tool moves."""

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, final

import jax.numpy as jnp
import numpy as np
from jax import Array

from lite6jax.arms.se3 import Frame, Twist, cross
from lite6jax.errors import InputError

Quantity = Literal["position", "pose", "axis", "distance"]


@final
@dataclass(frozen=True)
class Sensor:
    """A sensor that stands still. Hashable: a static argument of jitted functions.

    Attributes:
        quantity: `position` (3 numbers), `pose` (6), the position along one `axis` (1: a dial gauge, an
            interferometer), or the `distance` to a point (1: a ball bar, a draw wire).
        position_noise: one standard deviation of a length, per axis, m.
        orientation_noise: one standard deviation of a turn, per axis, rad; of a pose only.
        direction: of the axis, a unit vector in the sensor's frame.
        center: the point that the distance is taken to, in the sensor's frame, m.
        joint_noise: one standard deviation of each joint's read-out, rad; it reaches the reading through the arm.

    Raises:
        InputError: noise that is not positive, no orientation noise for a pose, a direction of no length.
    """

    quantity: Quantity
    position_noise: float
    orientation_noise: float | None = None
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    joint_noise: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.position_noise) and self.position_noise > 0):
            raise InputError(f"position noise {self.position_noise}: give one standard deviation in m, above 0")
        if self.quantity == "pose":
            if self.orientation_noise is None or not (
                np.isfinite(self.orientation_noise) and self.orientation_noise > 0
            ):
                raise InputError(
                    f"orientation noise {self.orientation_noise}: a sensor of poses needs one standard deviation in "
                    f"rad, above 0"
                )
        elif self.orientation_noise is not None:
            raise InputError(
                f"orientation noise {self.orientation_noise}: a sensor of {self.quantity} measures no orientation; "
                f"leave it out"
            )
        if not (np.isfinite(self.joint_noise) and self.joint_noise >= 0):
            raise InputError(f"joint noise {self.joint_noise}: give one standard deviation in rad, not below 0")
        if not np.isfinite(self.center).all():
            raise InputError(f"center {self.center}: give three finite numbers, in m")
        length = float(np.linalg.norm(self.direction))
        if not (np.isfinite(length) and length > 0):
            raise InputError(f"direction {self.direction}: give three numbers that are not all zero")
        if abs(length - 1) > 1e-15:  # so that to normalise twice changes nothing
            object.__setattr__(self, "direction", tuple(float(c) / length for c in self.direction))

    @property
    def rows(self) -> int:
        """How many numbers a reading has."""
        return {"position": 3, "pose": 6, "axis": 1, "distance": 1}[self.quantity]

    def with_noise(
        self, position: float | None = None, orientation: float | None = None, joint: float | None = None
    ) -> "Sensor":
        """The sensor with another noise (m, rad, rad); what is None stays."""
        return replace(
            self,
            position_noise=self.position_noise if position is None else position,
            orientation_noise=self.orientation_noise if orientation is None else orientation,
            joint_noise=self.joint_noise if joint is None else joint,
        )

    def to_dict(self) -> dict[str, Any]:
        """What it reads and how well, in SI units, without what does not concern it."""
        concerns = {"direction": "axis", "center": "distance", "orientation_noise": "pose"}
        return {
            name: value for name, value in asdict(self).items() if concerns.get(name, self.quantity) == self.quantity
        }

    @property
    def noise(self) -> np.ndarray:
        """`(row,)` one standard deviation of each number, m or rad."""
        turns = [self.orientation_noise] * 3 if self.quantity == "pose" else []
        return np.array([self.position_noise] * (self.rows - len(turns)) + turns, float)

    def change(self, tool: Frame, twist: Twist) -> Array:
        """How the whitened reading changes with a motion of the tool.

        Args:
            tool: its frame in the sensor's coordinates.
            twist: of the motion, at the sensor's origin.

        Returns:
            `(row, sample)`, in standard deviations; the orientation's as a rotation vector in the sensor's axes.
        """
        spin = twist.angular
        shift = twist.linear if spin is None else twist.linear + cross(spin, tool.origin)
        if self.quantity == "position":
            return shift / self.position_noise
        if self.quantity == "pose":
            assert self.orientation_noise is not None
            turning = jnp.zeros_like(shift) if spin is None else spin
            return jnp.concatenate([shift / self.position_noise, turning / self.orientation_noise])
        if self.quantity == "axis":
            along = jnp.array(self.direction)[:, None]
        else:
            along = tool.origin - jnp.array(self.center)[:, None]
            along = along / jnp.sqrt(jnp.sum(along**2, 0))
        return jnp.sum(along * shift, 0, keepdims=True) / self.position_noise


BARE = Sensor("pose", 1.0, 1.0)
"""Reads poses in m and rad: what it sees of a motion of the tool is that motion."""
SENSORS = {
    "tracker": Sensor("position", 2e-5),
    "tracker_6d": Sensor("pose", 2e-5, 1e-4),
    "motion_capture": Sensor("pose", 2e-4, 1e-3),
    "camera": Sensor("pose", 5e-4, 2e-3),
    "dial_gauge": Sensor("axis", 5e-6),
    "ball_bar": Sensor("distance", 1e-6),
}
"""Sensors as they are usually declared, one standard deviation per axis: a laser tracker of 20 µm (with a 6-D target,
0.1 mrad), motion capture of 0.2 mm and 1 mrad, a camera on a target of 0.5 mm and 2 mrad, a dial gauge of 5 µm, a
telescoping ball bar of 1 µm. Orders of magnitude to plan with: pass the figures of your own."""


def sensor_named(name: str) -> Sensor:
    """One of `SENSORS`.

    Raises:
        InputError: another name.
    """
    if name not in SENSORS:
        raise InputError(f"sensor {name!r}: is none of {', '.join(SENSORS)}")
    return SENSORS[name]
