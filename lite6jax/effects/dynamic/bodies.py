"""Effects of what the motors carry: masses, centres of mass, the payload, the direction of gravity."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from lite6jax.effects.drivers import Driver
from lite6jax.effects.dynamic import bounds
from lite6jax.effects.dynamic.torque_effect import Array, Dynamics, TorqueEffect, point_mass
from lite6jax.effects.effect import Coordinate


@dataclass(frozen=True)
class _OfLink(TorqueEffect):
    """An effect on the inertia of one link.

    Attributes:
        link: that moves with joint N, counted from 1.
    """

    link: int

    @property
    @final
    def site(self) -> str:
        """`linkN`."""
        return f"link{self.link}"

    @property
    @final
    def drivers(self) -> tuple[Driver, ...]:
        """The acceleration of its own joint, on which its torque depends in every position."""
        return (Driver("acceleration", self.link),)

    @final
    def _heavier(self, dynamics: Dynamics, numbers: Array) -> Array:
        """Torques `(joint, sample)` by a change of the link's inertial numbers `(10,)`."""
        change = np.zeros_like(dynamics.links)
        change[self.link - 1] = numbers
        return dynamics.of_inertia(change)


@final
@dataclass(frozen=True)
class LinkMass(_OfLink):
    """A link's mass differs from the declared one; its centre of mass does not."""

    name: ClassVar[str] = "link_mass"
    specificity: ClassVar[int] = 3

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("mass_kg", "kg", 0.1, lower=-bounds.MASS, upper=bounds.MASS),)

    def numbers(self, values: Array, links: Array) -> Array:
        """`(10,)`, the change of the inertial numbers of its link, beside `links` `(joint, 10)` as they are."""
        own = links[self.link - 1]
        center = own[1:4] / own[0] if own[0] > 0 else np.zeros(3)
        return point_mass(float(values[0]), center)

    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        return self._heavier(dynamics, self.numbers(values, dynamics.links))


@final
@dataclass(frozen=True)
class LinkCom(_OfLink):
    """A link's centre of mass is displaced, in the axes of its frame; its mass is as declared."""

    name: ClassVar[str] = "link_com"
    specificity: ClassVar[int] = 4

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        most = bounds.LENGTH
        return tuple(Coordinate(f"{axis}_m", "m", 1e-2, lower=-most, upper=most) for axis in "xyz")

    def numbers(self, values: Array, links: Array) -> Array:
        """`(10,)`, the change of the inertial numbers of its link, beside `links` `(joint, 10)` as they are."""
        m, *first = links[self.link - 1, :4]
        center = np.array(first) / m if m > 0 else np.zeros(3)
        # to first order: the square of the shift is a thousandth of the inertia
        moved = np.asarray(values, float)
        tensor = 2 * (moved @ center) * np.eye(3) - np.outer(moved, center) - np.outer(center, moved)
        return m * np.array([0.0, *moved, *np.diagonal(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]])

    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        return self._heavier(dynamics, self.numbers(values, dynamics.links))


@final
@dataclass(frozen=True)
class PayloadTorque(TorqueEffect):
    """The mass at the flange differs from the declared one, at the declared centre of mass."""

    name: ClassVar[str] = "payload_error"
    specificity: ClassVar[int] = 2

    @property
    def site(self) -> str:
        """`payload`."""
        return "payload"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("mass_kg", "kg", 0.1, lower=-bounds.MASS, upper=bounds.MASS),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("acceleration", 1),)

    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        change = np.zeros_like(dynamics.links)
        change[-1] = point_mass(float(values[0]), dynamics.payload_center)
        return dynamics.of_inertia(change)


@final
@dataclass(frozen=True)
class BaseTilt(TorqueEffect):
    """The base is tilted from what is declared, by small rotations about x and y: g ← R(tilt)ᵀ g."""

    name: ClassVar[str] = "base_tilt"
    specificity: ClassVar[int] = 3

    @property
    def site(self) -> str:
        """`base`."""
        return "base"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        most = bounds.TILT
        return tuple(Coordinate(f"tilt_{axis}_rad", "rad", 1e-2, lower=-most, upper=most) for axis in "xy")

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return ()

    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        tilt = np.array([values[0], values[1], 0.0])
        return dynamics.of_gravity(-np.cross(tilt, dynamics.gravity))  # R(tilt)ᵀ g − g, to first order
