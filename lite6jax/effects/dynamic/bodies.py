"""Effects of what the motors carry: masses, centres of mass, the payload, the direction of gravity."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from lite6jax.effects.drivers import Driver
from lite6jax.effects.dynamic import bounds
from lite6jax.effects.dynamic.torque_effect import Array, Dynamics, TorqueEffect, point_mass
from lite6jax.effects.effect import Coordinate, Effect, Reporting


def first_moment(moment: Array, center: Array) -> Array:
    """`(10,)`, the change of inertial numbers by a first moment `(3,)` kg·m about a centre, to first order."""
    tensor = 2 * (moment @ center) * np.eye(3) - np.outer(moment, center) - np.outer(center, moment)
    return np.array([0.0, *moment, *np.diagonal(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]])


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
        return first_moment(m * np.asarray(values, float), center)

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


def _reported_payload(effect: Effect, values: Array) -> tuple[Array, Array]:
    """Mass and centre of a payload by its mass and first moments, and their derivatives `(4, 4)`."""
    mass, moments = float(values[0]), np.asarray(values[1:], float)
    over = 1 / mass if mass else 1e300  # without a mass its place is anything: a huge derivative is no knowledge
    jacobian = np.eye(4)
    jacobian[1:, 1:] *= over
    center = moments * over if mass else np.zeros(3)
    jacobian[1:, 0] = -center * over
    return np.r_[mass, center], jacobian


def _payload_values(effect: Effect, given: Mapping[str, float]) -> Array:
    mass = given.get("mass_kg", 0.0)
    return np.array([mass, *(mass * given.get(f"{axis}_m", 0.0) for axis in "xyz")])


_MASSLESS = 0.01
"""kg below which a payload has moments alone: without a mass its distance is anything, and its square nothing."""
_PAYLOAD_NAMES = ("mass_kg", "x_m", "y_m", "z_m")


@final
@dataclass(frozen=True)
class PayloadBody(TorqueEffect):
    """Another body at the flange: a mass, and its centre, in m from the declared payload's, in the last link's axes.

    Its coordinates are the mass and its first moments about the declared centre, which have a meaning without a mass.
    """

    name: ClassVar[str] = "payload"
    specificity: ClassVar[int] = 3
    reporting: ClassVar[Reporting] = Reporting(lambda effect: _PAYLOAD_NAMES, _reported_payload, _payload_values)
    special_cases = staticmethod(lambda effect: (PayloadTorque(),))

    @property
    def site(self) -> str:
        """`payload`."""
        return "payload"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        mass = Coordinate("mass_kg", "kg", 0.1, lower=-bounds.MASS, upper=bounds.MASS, linear=False)
        most = bounds.MASS * bounds.PAYLOAD_LENGTH
        moments = [f"moment_{axis}_kg_m" for axis in "xyz"]
        return (mass, *(Coordinate(name, "kg m", 1e-2, lower=-most, upper=most, linear=False) for name in moments))

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("acceleration", 1),)

    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        mass, moment, center = float(values[0]), np.asarray(values[1:], float), dynamics.payload_center
        change = np.zeros_like(dynamics.links)
        change[-1] = point_mass(mass, center) + first_moment(moment, center)
        change[-1, 4:] += point_mass(mass / (mass**2 + _MASSLESS**2), moment)[4:]  # of its distance from that centre
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
