"""Effects of the base, the tool, the payload, the sensor and its clock."""

from dataclasses import dataclass
from typing import ClassVar, final

import jax.numpy as jnp
from jax import Array

from lite6jax.effects import motion as motions
from lite6jax.effects.deflection import Deflection, twist
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Altering, Bending, Coordinate
from lite6jax.effects.kinematic.links import TWIST
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Loads


@final
@dataclass(frozen=True)
class BaseCompliance(Bending):
    """The base tilts about its x and y axes by a compliance times the moment of links and payload about them."""

    name: ClassVar[str] = "base_compliance"
    specificity: ClassVar[int] = 12

    @property
    def site(self) -> str:
        return "base"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return tuple(Coordinate(f"compliance_{axis}_rad_per_Nm", "rad/Nm", 1e-5) for axis in "xy")

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("base moment x"), Driver("base moment y"))

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        about_x, about_y = (driver.values(motion, loads) for driver in self.drivers)
        return Deflection(base=twist(motion.samples, rx=values[0] * about_x, ry=values[1] * about_y))


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
        return tuple(Coordinate(f"v{axis}_m_per_s", "m/s", 1e-7) for axis in "xyz")

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
        return tuple(c._replace(typical=1e-3) for c in TWIST[: 6 if self.turned else 3])

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        return Deflection(tool=twist(motion.samples, *values))


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
        return (Coordinate("scale", "1", 1e-4),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return ()

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        return Deflection(scale=jnp.broadcast_to(values[0], (motion.samples,)))


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
        return (Coordinate("offset_s", "s", 1e-2),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("time"), Driver("velocity", 1))

    def alter(self, values: Array, motion: Motion) -> Motion:
        return motions.shifted(motion, values[0])

    def beyond(self, values: Array, motion: Motion) -> Array:
        return motions.beyond(motion, values[0])


@final
@dataclass(frozen=True)
class PayloadError(Altering):
    """The payload differs from the declared mass; it is observable only through a compliance."""

    name: ClassVar[str] = "payload_error"
    specificity: ClassVar[int] = 11

    @property
    def site(self) -> str:
        return "payload"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("mass_kg", "kg", 0.1),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("payload"), Driver("base moment x"))

    def alter(self, values: Array, motion: Motion) -> Motion:
        return motion._replace(payload=motion.payload + values[0])

    def beyond(self, values: Array, motion: Motion) -> Array:
        return jnp.zeros(motion.samples, bool)
