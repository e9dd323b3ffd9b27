"""Sensors by name, as they are usually declared, and sensors to plan with; a further sensor is one more entry here."""

from collections.abc import Mapping
from typing import Literal, get_args

import numpy as np

from lite6jax.errors import InputError
from lite6jax.sensors.board import Camera, FixedCamera, FlangeCamera
from lite6jax.sensors.points import POINT_SENSORS, Axis, Distance, PointSensor
from lite6jax.sensors.pose import PoseSensor
from lite6jax.sensors.sensor import Point, Sensor, positive_noise

Quantity = Literal["position", "pose", "axis", "distance"]

READINGS: Mapping[str, type[PointSensor | Camera]] = {
    **POINT_SENSORS,
    "fixed_camera": FixedCamera,
    "flange_camera": FlangeCamera,
}
"""Sensors with unknowns of their own, by the name that commands give them."""
ADVICE: Mapping[str, str] = {sensor.kind: sensor.advice for sensor in READINGS.values()}
"""How to record more, by the kind of reading in a recording."""


def plan_sensor(
    quantity: Quantity,
    position_noise: float,
    orientation_noise: float | None = None,
    *,
    direction: Point = (0.0, 0.0, 1.0),
    center: Point = (0.0, 0.0, 0.0),
    joint_noise: float = 0.0,
    source: str = "unknown",
) -> Sensor:
    """A sensor that stands still, to plan or simulate with; it has no samples and no unknowns.

    Args:
        quantity: `position` (3 numbers), `pose` (6), the position along one `axis` (1: a dial gauge, an
            interferometer), or the `distance` to a point (1: a ball bar, a draw wire).
        position_noise: one standard deviation of a length, per axis, m.
        orientation_noise: one standard deviation of a turn, per axis, rad; of a pose only.
        direction: of the axis, a vector of any length in the sensor's frame.
        center: the point that the distance is taken to, in the sensor's frame, m.
        joint_noise: one standard deviation of each joint's read-out, rad.
        source: of a sensor of positions or poses, `pose_source` of its recordings.

    Raises:
        InputError: another quantity, noise that is not positive, no orientation noise for a pose, a direction of no
            length.
    """
    if quantity not in get_args(Quantity):
        raise InputError(f"quantity {quantity!r}: give one of {', '.join(get_args(Quantity))}")
    sigma = positive_noise("position noise", position_noise, "m")
    if not np.isfinite(center).all():
        raise InputError(f"center {center}: give three finite numbers, in m")
    if not 0 < float(np.linalg.norm(direction)) < np.inf:
        raise InputError(f"direction {direction}: give three numbers that are not all zero")
    if quantity == "pose" and orientation_noise is None:
        raise InputError("orientation noise None: a sensor of poses needs one standard deviation in rad, above 0")
    if quantity == "axis":
        sensor: Sensor = Axis.along(direction, sigma)
    elif quantity == "distance":
        sensor = Distance.to_point(center, sigma)
    else:
        oriented = quantity == "pose"
        none = np.zeros((3, 0)), np.zeros((3, 3, 0))
        sensor = PoseSensor(*none, np.full(2, 1 / sigma), oriented=oriented, source=source)
    return sensor.with_noise(None, orientation_noise, joint_noise)


SENSORS: Mapping[str, Sensor] = {
    "tracker": plan_sensor("position", 2e-5, source="laser_tracker"),
    "tracker_6d": plan_sensor("pose", 2e-5, 1e-4, source="laser_tracker"),
    "motion_capture": plan_sensor("pose", 2e-4, 1e-3, source="motion_capture"),
    "camera": plan_sensor("pose", 5e-4, 2e-3, source="camera"),
    "dial_gauge": plan_sensor("axis", 5e-6),
    "ball_bar": plan_sensor("distance", 1e-6),
    # 32-bit floats on the wire: 3.4e-8 m on average, 6e-7 rad at most
    "controller_fk": plan_sensor("pose", 3e-8, 3e-7, source="controller_fk"),
}
"""Sensors as they are usually declared, one standard deviation per axis: a laser tracker of 20 µm (with a 6-D target,
0.1 mrad), motion capture of 0.2 mm and 1 mrad, a camera on a target of 0.5 mm and 2 mrad, a dial gauge of 5 µm, a
telescoping ball bar of 1 µm, and the controller's own kinematics. Orders of magnitude to plan with: pass your own
figures."""


def sensor_named(name: str) -> Sensor:
    """One of `SENSORS`.

    Raises:
        InputError: another name.
    """
    if name not in SENSORS:
        raise InputError(f"sensor {name!r}: is none of {', '.join(SENSORS)}")
    return SENSORS[name]


def place_sensor(name: str, direction: Point, center: Point) -> Sensor:
    """One of `SENSORS`, where it reads along an axis along this one, and a distance from this point, m.

    Raises:
        InputError: another name, or a direction of no length.
    """
    usual = sensor_named(name)
    if usual.reads_poses:
        return usual
    quantity: Quantity = "axis" if isinstance(usual, Axis) else "distance"
    return plan_sensor(quantity, usual.position_noise, direction=direction, center=center)
