"""Functions without a name, of the same form in all recordings: by them the names of a type's effects are tested."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.effects.bases import spline_basis
from lite6jax.effects.polynomials import Products, polynomial_basis
from lite6jax.populations.candidate import Candidate

Array = NDArray[np.floating]

_TYPICAL = 1e-4
"""Of a coefficient, in its unit; the same for all, so that it sets no more than the unit of their spread."""


@final
@dataclass(frozen=True)
class Function:
    """Σ coefficient · B(drivers) in each component of a deflection or torque at one site, or that times a direction.

    B are cubic B-splines of one driver, products of powers of several, or sine and cosine of orders of an angle.

    Attributes:
        site: where it acts.
        driver: what it depends on, in words.
        components: keys of the deflections or torques that it has, each with coefficients of its own.
        units: of these.
        drivers: keys of the quantities.
        ranges: lower and upper of each driver.
        pieces: intervals of the spline; 0 for none.
        products: of the drivers, by their indices; none where there are none.
        orders: of the waves.
        specificity: rank of its name, as in `Candidate`.
        direction: key of the direction of motion that multiplies it; empty for none.
    """

    site: str
    driver: str
    components: tuple[str, ...]
    units: tuple[str, ...]
    drivers: tuple[str, ...]
    ranges: tuple[tuple[float, float], ...]
    pieces: int = 0
    products: Products = ()
    orders: tuple[float, ...] = ()
    specificity: int = 0
    direction: str = ""

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> "Function":
        """From the JSON form of `asdict`."""
        lists = {name: tuple(stored[name]) for name in ("components", "units", "drivers", "orders")}
        lists["products"] = tuple(map(tuple, stored["products"]))
        return cls(**{**stored, **lists, "ranges": tuple((low, high) for low, high in stored["ranges"])})

    @cached_property
    def key(self) -> str:
        """Tells it from all others, whatever the ranges."""
        form = f"orders {self.orders}" if self.orders else f"{self.pieces} pieces, {len(self.products)} products"
        return f"unnamed:{self.site}:{' '.join(self.components)}:{self.driver}:{form}"

    @property
    def size(self) -> int:
        """The number of functions of the drivers."""
        if self.orders:
            return 2 * len(self.orders)
        return self.pieces + 3 if self.pieces else len(self.products)

    @property
    def is_curve(self) -> bool:
        """Whether it is one component over one driver."""
        return len(self.drivers) == len(self.components) == 1

    @property
    def candidate(self) -> Candidate:
        """As a report names it."""
        several = len(self.components) > 1
        names = tuple(
            f"{f'{component}_' if several else ''}coefficient{i + 1}_{unit}"
            for component, unit in zip(self.components, self.units, strict=True)
            for i in range(self.size)
        )
        count = len(names)
        free = (np.inf,) * count
        return Candidate(
            key=self.key,
            effect="unnamed",
            site=self.site,
            driver=self.driver,
            names=names,
            typical=(_TYPICAL,) * count,
            lower=tuple(-bound for bound in free),
            upper=free,
            specificity=self.specificity,
        )

    def basis(self, values: Array) -> Array:
        """The functions `(size, sample)` at values `(driver, sample)` of the drivers."""
        if self.orders:
            turned = np.array(self.orders)[:, None] * values[0]
            return np.stack([np.sin(turned), np.cos(turned)], 1).reshape(self.size, -1)
        if self.pieces:
            return np.asarray(spline_basis(values[0], *self.ranges[0], self.pieces))  # type: ignore[arg-type]
        return np.asarray(polynomial_basis(values, np.array(self.ranges), self.products))  # type: ignore[arg-type]

    def over(self, other: "Function") -> "Function":
        """The same over the ranges of both."""
        pairs = zip(self.ranges, other.ranges, strict=True)
        return replace(self, ranges=tuple((min(a[0], b[0]), max(a[1], b[1])) for a, b in pairs))


def in_common(functions: Iterable[Function]) -> dict[str, Function]:
    """By key, each over the ranges of all recordings: their coefficients then mean the same in each."""
    found: dict[str, Function] = {}
    for function in functions:
        known = found.get(function.key)
        found[function.key] = function if known is None else known.over(function)
    return found
