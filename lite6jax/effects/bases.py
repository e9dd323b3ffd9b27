"""Bases over drivers: splines, waves, plays and polynomials, with the names and the priors of their coefficients."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from lite6jax.deferred import Array, jit, jnp, lax
from lite6jax.effects.deflection import library_of
from lite6jax.effects.drivers import Driver
from lite6jax.effects.polynomials import Products, Subset, polynomial_basis, polynomials_within, products_of

_PIECES = (8, 16)
"""Intervals of the splines that are tried where a plainer function of their driver was found."""
_LOCAL_PIECES = 4
"""Intervals of the splines that describe a step or a bump, at most."""
_HIGHEST_DEGREE = 4


def spline_basis(values: Array, lower: float | Array, upper: float | Array, pieces: int) -> Array:
    """The cubic B-splines on `pieces` equal intervals from `lower` to `upper`, `(pieces + 3, sample)`.

    They add up to 1; before `lower` and beyond `upper` they keep their values there. Of NumPy values on the host.

    Args:
        values: `(sample,)`.
        lower: the first interval's start.
        upper: the last interval's end.
        pieces: the number of intervals.
    """
    xp = library_of(values)
    u = xp.clip((values - lower) / (upper - lower), 0.0, 1.0) * pieces
    t = xp.abs(u - np.arange(-1.0, pieces + 2.0)[:, None])
    near, far = xp.maximum(1 - t, 0.0), xp.maximum(2 - t, 0.0)
    return (far**3 - 4 * near**3) / 6  # the fourth difference of cubes (C. de Boor, A Practical Guide to Splines, IX)


@jit
def plays(values: Array, widths: Array, run: Array) -> Array:
    """What follows a driver with play, `(width, sample)`: pushed along, and left behind by `width` at most.

    Sums of such plays are all hysteresis whose loops close and do not depend on speed (I. Mayergoyz, Mathematical
    Models of Hysteresis, 1991, ch. 1; of L. Prandtl and A. Ishlinskii). Each run begins at 0, as nearly as it can.

    Args:
        values: `(sample,)`, of the driver.
        widths: `(width,)` in its unit, from 0.
        run: `(2, sample)`, the first and the last sample of the run of each.
    """

    def pushed(left: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        value, begins = now
        left = jnp.clip(jnp.where(begins, 0.0, left), value - widths, value + widths)
        return left, left

    begins = run[0] == jnp.arange(run.shape[1])
    return lax.scan(pushed, jnp.zeros_like(widths), (values, begins))[1].T


@dataclass(frozen=True)
class Basis(ABC):
    """Functions of drivers, and what is known beforehand of the coefficients that multiply them.

    Attributes:
        drivers: of which the functions are.
        bounds: lower and upper of the first driver's range, in its unit, of the second's, …
        spread: one standard deviation of the coefficients; None where nothing is known.
    """

    drivers: tuple[Driver, ...]
    bounds: tuple[float, ...]
    spread: float | None

    several: ClassVar[bool] = False
    """Whether the functions can run over several drivers."""

    @property
    @abstractmethod
    def size(self) -> int:
        """How many functions there are."""

    @abstractmethod
    def at(self, values: Array, run: Array | None = None) -> Array:
        """The functions `(function, sample)` at values of the drivers. Of NumPy values on the host.

        Args:
            values: `(sample,)` of one driver, `(driver, sample)` of several.
            run: `(2, sample)`, where runs begin and end, which plays require; one run where not given.
        """

    @property
    def of(self) -> tuple[Driver, ...]:
        """The drivers that the functions run over."""
        return self.drivers

    @property
    def names(self) -> tuple[str, ...]:
        """Of the coefficients."""
        return tuple(f"coefficient{i + 1}" for i in range(self.size))

    @property
    def spreads(self) -> tuple[float, ...]:
        """The prior's standard deviation of each coefficient."""
        return (float("inf") if self.spread is None else self.spread,) * self.size

    @property
    def products(self) -> Products:
        """Of the drivers, where the functions are such."""
        return ()

    @property
    def finer(self) -> tuple[Mapping[str, Any], ...]:
        """Bases of the same drivers with more functions: the fields in which they differ from this one."""
        return ()

    def subsets(self, least: int) -> tuple[Subset, ...]:
        """The functions that are a basis of their own, all of them among these; polynomials from a `least` degree."""
        return (Subset(tuple(range(len(self.drivers))), 0, 0, tuple(range(self.size))),)

    @property
    def mistake(self) -> str:
        """What does not fit in its drivers, bounds and fields, and what to give instead; empty where all does."""
        if len(self.bounds) == 2 * len(self.drivers) and (self.several or len(self.of) == 1):
            return ""
        return (
            f"{len(self.drivers)} drivers and {len(self.bounds) - 2} further bounds; give lower and upper of each "
            "driver but the first, and a degree where there are more than two"
        )


@dataclass(frozen=True)
class _Varying(Basis):
    """Functions of one driver, or these multiplied by a second one, whose coefficient then varies with the first.

    The second driver is over its greatest size (T. Hastie, R. Tibshirani, Varying-Coefficient Models, Journal of the
    Royal Statistical Society B 55, 1993).
    """

    @property
    def of(self) -> tuple[Driver, ...]:
        return self.drivers[:1] if len(self.drivers) == 2 else self.drivers

    def at(self, values: Array, run: Array | None = None) -> Array:
        first, *factor = library_of(values).atleast_2d(values)
        functions = self._of_first(first)
        return functions * (factor[0] / max(map(abs, self.bounds[2:]))) if factor else functions

    @abstractmethod
    def _of_first(self, values: Array) -> Array:
        """The functions `(function, sample)` at values `(sample,)` of the first driver."""

    @property
    def mistake(self) -> str:
        if len(self.drivers) == 2 and len(self.bounds) == 4 and not any(self.bounds[2:]):
            return f"{self.drivers[1].phrase} is always 0; leave it out"
        return super().mistake


@final
@dataclass(frozen=True)
class Spline(_Varying):
    """Cubic B-splines of a driver, or these multiplied by a second one.

    Attributes:
        pieces: its intervals; there are three more functions.
    """

    pieces: int

    @property
    def size(self) -> int:
        return self.pieces + 3

    @property
    def finer(self) -> tuple[Mapping[str, Any], ...]:
        """None of a spline of few intervals, a local form over a part of the driver's range, nor beside a direction."""
        plain = self.pieces > _LOCAL_PIECES and not any(driver.discrete for driver in self.drivers[1:])
        return tuple({"pieces": n} for n in _PIECES if n > self.pieces and plain)

    def _of_first(self, values: Array) -> Array:
        return spline_basis(values, self.bounds[0], self.bounds[1], self.pieces)


@final
@dataclass(frozen=True)
class Waves(_Varying):
    """The sine and cosine of each order of an angle, or these multiplied by a second driver.

    Attributes:
        orders: of the waves.
        trust: by how much to believe them, from 0 to 1, at equal steps over the range; 0 beyond.
        rolloff: corner c and slope s, by which the variance of waves of order k falls, as 1 / (1 + (k / c)ˢ); none
            where it does not.
    """

    orders: tuple[float, ...]
    trust: tuple[float, ...]
    rolloff: tuple[float, ...]

    @property
    def size(self) -> int:
        return 2 * len(self.orders)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{wave}_{order:g}" for order in self.orders for wave in ("sine", "cosine"))

    @property
    def spreads(self) -> tuple[float, ...]:
        if self.spread is None or not self.rolloff:
            return super().spreads
        corner, slope = self.rolloff
        return tuple(self.spread / (1 + (order / corner) ** slope) ** 0.5 for order in self.orders for _ in range(2))

    def _of_first(self, values: Array) -> Array:
        xp = library_of(values)
        turned = np.array(self.orders)[:, None] * values
        waves = xp.stack([xp.sin(turned), xp.cos(turned)], 1).reshape(self.size, -1)
        steps = np.linspace(self.bounds[0], self.bounds[1], len(self.trust))
        return waves * xp.interp(values, steps, np.array(self.trust), left=0.0, right=0.0)

    @property
    def mistake(self) -> str:
        if self.rolloff and (len(self.rolloff) != 2 or self.rolloff[0] <= 0 or self.spread is None or not self.orders):
            return (
                f"rolloff {self.rolloff} is not possible; give a positive corner order and a slope, beside orders and "
                "their spread"
            )
        if not self.orders or len(self.trust) < 2:
            return (
                f"{len(self.orders)} orders and {len(self.trust)} numbers of trust; give both, two of these at least, "
                "or none"
            )
        return super().mistake


@final
@dataclass(frozen=True)
class Plays(Basis):
    """What follows a driver with so much play each, as hysteresis does.

    Attributes:
        widths: half the widths of the plays, in the driver's unit, from 0.
    """

    widths: tuple[float, ...]

    @property
    def size(self) -> int:
        return len(self.widths)

    def at(self, values: Array, run: Array | None = None) -> Array:
        one = np.zeros((2, values.size), int)
        return plays(values, np.array(self.widths), one if run is None else run)  # type: ignore[arg-type]


@final
@dataclass(frozen=True)
class Polynomial(Basis):
    """Products of one or several drivers.

    Attributes:
        degree: how many drivers a product has at most.
        power: the highest power of each driver in a product; 0 where the degree alone limits it.
    """

    degree: int
    power: int

    several: ClassVar[bool] = True

    @property
    def size(self) -> int:
        return len(self.products)

    @property
    def products(self) -> Products:
        return products_of(self.drivers, self.degree, self.power)

    @property
    def finer(self) -> tuple[Mapping[str, Any], ...]:
        """Splines of one driver that is no direction; of several, their squares, and products of one more of them."""
        if len(self.drivers) == 1:
            if self.drivers[0].discrete:
                return ()
            return tuple({"degree": 0, "power": 0, "pieces": n} for n in _PIECES if n + 3 > self.size)
        squares = ({"power": 0},) if self.power else ()
        return squares + (({"degree": self.degree + 1, "power": 0},) if self.degree < _HIGHEST_DEGREE else ())

    def at(self, values: Array, run: Array | None = None) -> Array:
        ranges = np.array(self.bounds).reshape(-1, 2)
        return polynomial_basis(library_of(values).atleast_2d(values), ranges, self.products)

    def subsets(self, least: int) -> tuple[Subset, ...]:
        return polynomials_within(self.drivers, self.degree, self.power, least)

    @property
    def mistake(self) -> str:
        if self.power and (self.power < 0 or self.power > self.degree):
            return f"power {self.power} of degree {self.degree}; give one from 1 to the degree, or 0"
        return super().mistake
