"""Physics without a name: a curve over one driver at one site, as a cubic spline."""

import re
from dataclasses import dataclass
from typing import ClassVar, final

import jax.numpy as jnp
from jax import Array

from lite6jax.errors import InputError
from lite6jax.physics.deflection import Deflection, at_joint, twist
from lite6jax.physics.drivers import Driver, driver_of
from lite6jax.physics.effect import Bending, Coordinate
from lite6jax.physics.motion import Motion
from lite6jax.physics.statics import Loads

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
"""Of a twist: a translation in m and a rotation vector in rad."""

_SITE = re.compile(r"joint([1-9]\d*)|link([1-9]\d*)|base|tool")


def spline_basis(values: Array, lower: float, upper: float, pieces: int) -> Array:
    """The cubic B-splines on `pieces` equal intervals from `lower` to `upper`, `(pieces + 3, sample)`.

    They add up to 1; before `lower` and beyond `upper` they keep their values there.

    Args:
        values: `(sample,)`.
        lower: the first interval's start.
        upper: the last interval's end.
        pieces: the number of intervals.
    """
    u = jnp.clip((values - lower) / (upper - lower), 0.0, 1.0) * pieces
    t = jnp.abs(u - jnp.arange(-1.0, pieces + 2.0)[:, None])
    near, far = jnp.maximum(1 - t, 0.0), jnp.maximum(2 - t, 0.0)
    return (far**3 - 4 * near**3) / 6  # the fourth difference of cubes (C. de Boor, A Practical Guide to Splines, IX)


@final
@dataclass(frozen=True)
class Unnamed(Bending):
    """δ = Σ coefficient · B(driver): whatever one driver does at one site.

    Attributes:
        where: `jointN` (an angle), `linkN`, `base` or `tool` (one component of a twist).
        driver: the phrase of a `Driver`, such as "position of joint 3".
        lower: of the driver's range, in its unit; beyond the range the curve is constant.
        upper: of the driver's range.
        pieces: the intervals of the spline; it has three more coefficients.
        component: of the twist, one of x y z rx ry rz; at a joint it is rz.

    Raises:
        InputError: no such site, driver or component, or an empty range.
    """

    where: str
    driver: str
    lower: float
    upper: float
    pieces: int = 8
    component: str = "rz"

    name: ClassVar[str] = "unnamed"

    def __post_init__(self) -> None:
        if not _SITE.fullmatch(self.where):
            raise InputError(f"unnamed: no site is called {self.where!r}; choose jointN, linkN, base or tool")
        if self.component not in COMPONENTS or (self.where.startswith("joint") and self.component != "rz"):
            wanted = "rz" if self.where.startswith("joint") else "one of " + " ".join(COMPONENTS)
            raise InputError(f"unnamed:{self.where}: component {self.component!r} is not possible there; give {wanted}")
        if not self.lower < self.upper or self.pieces < 1:
            raise InputError(
                f"unnamed:{self.where}: {self.pieces} pieces from {self.lower:g} to {self.upper:g} are no curve; give "
                "lower < upper and at least one piece"
            )
        driver_of(self.driver)

    @property
    def site(self) -> str:
        """Where it acts."""
        return self.where

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The spline's coefficients."""
        unit = "m" if self.component in ("x", "y", "z") else "rad"
        return tuple(Coordinate(f"coefficient{i + 1}_{unit}", unit, 1e-4) for i in range(self.pieces + 3))

    @property
    def drivers(self) -> tuple[Driver, ...]:
        """The one driver."""
        return (driver_of(self.driver),)

    def curve(self, values: Array, driver: Array) -> Array:
        """The curve's value `(sample,)`, m or rad, at values `(sample,)` of the driver."""
        return values @ spline_basis(driver, self.lower, self.upper, self.pieces)

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        """The curve at its site."""
        shift = self.curve(values, self.drivers[0].values(motion, loads))
        kind, number = self.where.rstrip("0123456789"), int("0" + "".join(filter(str.isdecimal, self.where)))
        if kind == "joint":
            return Deflection(joint=at_joint(motion.dof, number, shift))
        displaced = twist(motion.samples, **{self.component: shift})
        if kind == "link":
            return Deflection(link=at_joint(motion.dof, number, displaced))
        return Deflection(**{kind: displaced})
