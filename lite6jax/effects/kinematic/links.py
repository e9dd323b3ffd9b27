"""Effects of links and axes: compliance, thermal expansion, offsets of frames and wobble."""

from dataclasses import dataclass
from typing import ClassVar, final

from lite6jax.deferred import Array
from lite6jax.effects.deflection import Deflection, library_of, place_at_joint, twist
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Bending, Coordinate
from lite6jax.effects.kinematic import bounds
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Loads
from lite6jax.errors import InputError

TWIST = (
    *(Coordinate(f"{axis}_m", "m", 1e-4) for axis in "xyz"),
    *(Coordinate(f"r{axis}_rad", "rad", 1e-4) for axis in "xyz"),
)
"""A translation and a rotation vector."""

_SPREAD = {"m": 0.02, "rad": 0.05}
"""The prior standard deviation of frame offsets; it determines the directions that the sensor cannot observe."""


@final
@dataclass(frozen=True)
class LinkCompliance(Bending):
    """A link's frame rotates about its x and y axes by a compliance times the moment of gravity about them.

    Attributes:
        link: counted from 1; link N follows joint N.
    """

    link: int

    name: ClassVar[str] = "link_compliance"
    specificity: ClassVar[int] = 15

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return tuple(
            Coordinate(f"compliance_{axis}_rad_per_Nm", "rad/Nm", 1e-5, lower=0.0, upper=bounds.COMPLIANCE)
            for axis in "xy"
        )

    @property
    def site(self) -> str:
        return f"link{self.link}"

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return Driver("gravity moment x", self.link), Driver("gravity moment y", self.link)

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        about_x, about_y = (driver.values(motion, loads) for driver in self.drivers)
        rotation = twist(motion.samples, rx=values[0] * about_x, ry=values[1] * about_y)
        return Deflection(link=place_at_joint(motion.dof, self.link, rotation))


@final
@dataclass(frozen=True)
class LinkThermalExpansion(Bending):
    """The vector from a link's frame to the origin of the next joint grows by α times the temperature rise.

    Attributes:
        link: counted from 1, without the last link, which no joint follows; None for every vector of the chain.
    """

    link: int | None = None

    name: ClassVar[str] = "link_thermal_expansion"
    specificity: ClassVar[int] = 9

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("expansion_per_K", "1/K", 1e-5, lower=0.0, upper=bounds.EXPANSION),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("temperature rise"),)

    @property
    def site(self) -> str:
        return "links" if self.link is None else f"link{self.link}"

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        growth = values[0] * self.drivers[0].values(motion, loads)
        if self.link is None:
            return Deflection(stretch=library_of(growth).broadcast_to(growth, (motion.dof, motion.samples)))
        if self.link >= motion.dof:
            raise InputError(f"{self.label}: no joint follows the last link; choose a link from 1 to {motion.dof - 1}")
        return Deflection(stretch=place_at_joint(motion.dof, self.link + 1, growth))


@final
@dataclass(frozen=True)
class FrameOffset(Bending):
    """A constant twist of a link's frame, after its joint's rotation and in its own axes, or of the base frame.

    Attributes:
        link: counted from 1; None for the base.
    """

    link: int | None = None

    name: ClassVar[str] = "frame_offset"
    specificity: ClassVar[int] = 16

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return tuple(
            c._replace(spread=_SPREAD[c.unit], lower=-bounds.FRAME[c.unit], upper=bounds.FRAME[c.unit]) for c in TWIST
        )

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return ()

    @property
    def site(self) -> str:
        return "base" if self.link is None else f"link{self.link}"

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        displaced = library_of(values).broadcast_to(values[:, None], (6, motion.samples))
        if self.link is None:
            return Deflection(base=displaced)
        return Deflection(link=place_at_joint(motion.dof, self.link, displaced))


@final
@dataclass(frozen=True)
class AxisWobble(Bending):
    """A joint's frame tilts about its x and y, before the joint's rotation, by Fourier series in the joint's position.

    The tilt about x is Σ cosine·cos(n·q) + sine·sin(n·q) over n = 1 and 2, and likewise that about y. The eight numbers
    are `x_cosine1_rad`, `x_sine1_rad`, `x_cosine2_rad`, `x_sine2_rad` and the same of y. A tilt ε before the rotation
    is a tilt by Rz(−q) ε after it. Of order 1, the part that turns with the joint is a `frame_offset` of its link; the
    prior determines it.

    Attributes:
        joint: counted from 1.
    """

    joint: int

    name: ClassVar[str] = "axis_wobble"
    specificity: ClassVar[int] = 15

    @property
    def site(self) -> str:
        return f"joint{self.joint}"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return tuple(
            Coordinate(f"{axis}_{wave}{order}_rad", "rad", 1e-4, _SPREAD["rad"], -bounds.WAVE, bounds.WAVE)
            for axis in "xy"
            for order in (1, 2)
            for wave in ("cosine", "sine")
        )

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("position", self.joint),)

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        q = self.drivers[0].values(motion, loads)
        xp = library_of(q)
        cosine, sine = xp.cos(q), xp.sin(q)
        waves = (cosine, sine, xp.cos(2 * q), xp.sin(2 * q))
        about_x = sum(value * wave for value, wave in zip(values[:4], waves, strict=True))
        about_y = sum(value * wave for value, wave in zip(values[4:], waves, strict=True))
        tilt = twist(motion.samples, rx=cosine * about_x + sine * about_y, ry=cosine * about_y - sine * about_x)
        return Deflection(link=place_at_joint(motion.dof, self.joint, tilt))
