"""Effects of what weighs on the arm: a payload and a direction of gravity that differ from those declared."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from lite6jax.arms.se3 import rotation_exp
from lite6jax.deferred import Array, jnp
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Coordinate, Loading
from lite6jax.effects.kinematic import bounds
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Inertia


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
