"""Effects of the base, the tool, the sensor, its clock, and what weighs on the arm."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from lite6jax.arms.se3 import rotation_exp
from lite6jax.deferred import Array, jnp
from lite6jax.effects import motion as motions
from lite6jax.effects.deflection import Deflection, library_of, twist
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Altering, Bending, Coordinate, Loading
from lite6jax.effects.kinematic import bounds
from lite6jax.effects.kinematic.links import TWIST
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Inertia, Loads


@final
@dataclass(frozen=True)
class BaseCompliance(Bending):
    """The base tilts about its x and y axes by a compliance times the moment of links and payload about them.

    Attributes:
        cross: whether the mount is softest about other axes than x and y: rx follows the moment about y and ry that
            about x as well, both by `compliance_xy_rad_per_Nm`.
        shift: whether its origin shifts in the plane too, along the first axis by the moment about the second:
            `shift_xx_m_per_Nm`, `shift_xy_m_per_Nm`, `shift_yx_m_per_Nm` and `shift_yy_m_per_Nm`.
    """

    cross: bool = False
    shift: bool = False

    name: ClassVar[str] = "base_compliance"
    specificity: ClassVar[int] = 12
    special_cases = staticmethod(
        lambda effect: (BaseCompliance(), BaseCompliance(cross=True))[: int(effect.cross) + int(effect.shift)]
    )

    @property
    def site(self) -> str:
        return "base"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        least = {"x": 0.0, "y": 0.0, "xy": -bounds.COMPLIANCE}
        tilts = ("x", "y", "xy") if self.cross else ("x", "y")
        shifts = ("xx", "xy", "yx", "yy") if self.shift else ()
        return (
            *(Coordinate(f"compliance_{of}_rad_per_Nm", "rad/Nm", 1e-5, lower=least[of], upper=bounds.COMPLIANCE)
              for of in tilts),
            *(Coordinate(f"shift_{of}_m_per_Nm", "m/Nm", 1e-6, lower=-bounds.SHIFT, upper=bounds.SHIFT)
              for of in shifts),
        )  # fmt: skip

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("base moment x"), Driver("base moment y"))

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        about_x, about_y = (driver.values(motion, loads) for driver in self.drivers)
        rx, ry, x, y = values[0] * about_x, values[1] * about_y, None, None
        if self.cross:
            rx, ry = rx + values[2] * about_y, ry + values[2] * about_x
        if self.shift:
            xx, xy, yx, yy = values[-4:]
            x, y = xx * about_x + xy * about_y, yx * about_x + yy * about_y
        return Deflection(base=twist(motion.samples, x, y, rx=rx, ry=ry))


def _velocity(name: str, unit: str) -> Coordinate:
    return Coordinate(name, unit, 1e-7, lower=-bounds.DRIFT, upper=bounds.DRIFT)


@final
@dataclass(frozen=True)
class BaseDrift(Bending):
    """The base drifts relative to the sensor at a constant velocity, in the base's axes, from zero at time 0."""

    name: ClassVar[str] = "base_drift"
    specificity: ClassVar[int] = 13

    @property
    def site(self) -> str:
        return "base"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return tuple(_velocity(f"v{axis}_m_per_s", "m/s") for axis in "xyz")

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("time"),)

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        time = self.drivers[0].values(motion, loads)
        return Deflection(base=twist(motion.samples, *(velocity * time for velocity in values)))


@final
@dataclass(frozen=True)
class ToolOffset(Bending):
    """The measured point is displaced on the flange, along the flange's axes.

    Attributes:
        turned: whether its orientation differs as well, by a rotation vector in the flange's axes.
    """

    turned: bool = False

    name: ClassVar[str] = "tool_offset"
    specificity: ClassVar[int] = 7

    @property
    def site(self) -> str:
        return "tool"

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return ()

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        chosen = TWIST[: 6 if self.turned else 3]
        return tuple(c._replace(typical=1e-3, lower=-bounds.TOOL[c.unit], upper=bounds.TOOL[c.unit]) for c in chosen)

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        return Deflection(tool=twist(motion.samples, *values))


@final
@dataclass(frozen=True)
class ToolCompliance(Bending):
    """What is on the flange rotates about the flange's x and y by a compliance times the payload's moment about them.

    The moment is that of what is outboard of the flange, the payload alone, about the flange's origin and in its axes;
    where nothing is carried there is none. A tool whose mass is declared within the last link bends by a
    `link_compliance` of that link, whose moment contains that mass too.
    """

    name: ClassVar[str] = "tool_compliance"
    specificity: ClassVar[int] = 12

    @property
    def site(self) -> str:
        return "tool"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return tuple(
            Coordinate(f"compliance_{axis}_rad_per_Nm", "rad/Nm", 1e-5, lower=0.0, upper=bounds.TOOL_COMPLIANCE)
            for axis in "xy"
        )

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("tool moment x"), Driver("tool moment y"))

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        about_x, about_y = (driver.values(motion, loads) for driver in self.drivers)
        return Deflection(tool=twist(motion.samples, rx=values[0] * about_x, ry=values[1] * about_y))


@final
@dataclass(frozen=True)
class SensorDrift(Bending):
    """All that the sensor shows drifts at a constant velocity, in the sensor's axes, from zero at time 0.

    It also turns, about the origin of the sensor's frame, so that positions far from that move more.
    """

    name: ClassVar[str] = "sensor_drift"
    specificity: ClassVar[int] = 14

    @property
    def site(self) -> str:
        return "sensor"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (
            *(_velocity(f"v{axis}_m_per_s", "m/s") for axis in "xyz"),
            *(_velocity(f"w{axis}_rad_per_s", "rad/s") for axis in "xyz"),
        )

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("time"),)

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        time = self.drivers[0].values(motion, loads)
        return Deflection(sensor=twist(motion.samples, *(velocity * time for velocity in values)))


@final
@dataclass(frozen=True)
class MeasurementScale(Bending):
    """Positions measured by the sensor are scaled: p ← (1 + s)·p."""

    name: ClassVar[str] = "measurement_scale"
    specificity: ClassVar[int] = 8

    @property
    def site(self) -> str:
        return "sensor"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("scale", "1", 1e-4, lower=-bounds.RATIO, upper=bounds.RATIO),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return ()

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        return Deflection(scale=library_of(values).broadcast_to(values[0], (motion.samples,)))


@final
@dataclass(frozen=True)
class TimeOffset(Altering):
    """The pose with the time stamp t is that of the arm (joints, velocities, loads) at t + offset."""

    name: ClassVar[str] = "time_offset"
    specificity: ClassVar[int] = 6

    @property
    def site(self) -> str:
        return "clock"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("offset_s", "s", 1e-2, lower=-bounds.CLOCK, upper=bounds.CLOCK),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("time"), Driver("velocity", 1))

    def alter(self, values: Array, motion: Motion) -> Motion:
        return motions.shifted(motion, values[0])

    def beyond(self, values: Array, motion: Motion) -> Array:
        return motions.beyond(motion, values[0])


@final
@dataclass(frozen=True)
class PayloadError(Loading):
    """The payload differs from the declared mass; it is observable only through a compliance."""

    name: ClassVar[str] = "payload_error"
    specificity: ClassVar[int] = 11

    @property
    def site(self) -> str:
        return "payload"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("mass_kg", "kg", 0.1, lower=-bounds.MASS, upper=bounds.MASS),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("payload"), Driver("base moment x"))

    def alter(self, values: Array, motion: Motion) -> Motion:
        return motion._replace(payload=motion.payload + values[0])

    def alter_inertia(self, values: Array, inertia: Inertia) -> Inertia:
        return inertia


@final
@dataclass(frozen=True)
class PayloadCom(Loading):
    """The payload's centre of mass is elsewhere than declared, along the flange's axes; seen through a compliance."""

    name: ClassVar[str] = "payload_com"
    specificity: ClassVar[int] = 12

    @property
    def site(self) -> str:
        return "payload"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return tuple(Coordinate(f"{axis}_m", "m", 0.01, lower=-bounds.CENTER, upper=bounds.CENTER) for axis in "xyz")

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("payload"), Driver("base moment x"))

    def alter(self, values: Array, motion: Motion) -> Motion:
        return motion

    def alter_inertia(self, values: Array, inertia: Inertia) -> Inertia:
        return inertia._replace(payload_center=inertia.payload_center + values)


@final
@dataclass(frozen=True)
class GravityDirection(Loading):
    """Gravity as declared is turned by a small rotation about the base's x and y; seen through a compliance.

    The rotation vector (x, y, 0) turns the vector of gravity in the base's frame: a base that itself leans by some
    rotation sees gravity turned by the opposite one.
    """

    name: ClassVar[str] = "gravity_direction"
    specificity: ClassVar[int] = 12

    @property
    def site(self) -> str:
        return "base"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return tuple(
            Coordinate(f"tilt_{axis}_rad", "rad", 0.01, lower=-bounds.TILT, upper=bounds.TILT) for axis in "xy"
        )

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("base moment x"), Driver("base moment y"))

    def alter(self, values: Array, motion: Motion) -> Motion:
        return motion

    def alter_inertia(self, values: Array, inertia: Inertia) -> Inertia:
        if isinstance(values, np.ndarray):  # on the host nothing is compiled, in the course of hundreds of fits
            from scipy.spatial.transform import Rotation  # takes longer than a list of effects

            turned = Rotation.from_rotvec([*values, 0.0]).as_matrix() @ np.asarray(inertia.gravity)
            return inertia._replace(gravity=turned)  # type: ignore[arg-type]
        return inertia._replace(gravity=rotation_exp(jnp.append(values, 0.0)) @ inertia.gravity)
