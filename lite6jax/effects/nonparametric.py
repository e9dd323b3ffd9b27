"""Nonparametric effects: at one site, a Gaussian process of one driver or of two."""

import re
from abc import ABC, abstractmethod
from functools import lru_cache
from typing import ClassVar

import numpy as np

from lite6jax.array_types import Array
from lite6jax.deferred import JaxArray, jnp
from lite6jax.effects import kernels
from lite6jax.effects.deflection import Deflection, library_of, place_at_site, twist
from lite6jax.effects.drivers import Driver, driver_of
from lite6jax.effects.effect import Bending, Coordinate, Effect, final_effect
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Loads
from lite6jax.errors import InputError

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
"""Of a twist: a translation in m and a rotation vector in rad."""

SCALE = "scale"
"""The component of a sensor whose readings grow: what it shows moves away from its origin, in proportion."""

_MOST = 0.5
"""rad, m, or a share of the readings: the largest coefficient that is possible."""
_MEASURES = {**dict.fromkeys("xyz", ("m", "_m")), SCALE: ("1", "")}
"""Unit of a component that is no rotation, and how the names of its coefficients end."""
_SITE = re.compile(r"joint([1-9]\d*)|link([1-9]\d*)|base|tool|sensor")


@lru_cache(maxsize=4096)
def drivers_of(phrase: str) -> tuple[Driver, ...]:
    """One driver, or two that are joined by " and "."""
    return tuple(map(driver_of, phrase.split(" and ")))


@lru_cache(maxsize=1024)
def _coefficients(coefficient: Coordinate, count: int) -> tuple[Coordinate, ...]:
    return tuple(coefficient._replace(name=f"coefficient{k + 1}{coefficient.name}") for k in range(count))


class Process(Effect, ABC):
    """What nonparametric effects have in common: a Gaussian process f = Σ coefficient · φ(drivers).

    Attributes:
        driver: the phrase of a `Driver`, such as "position of joint 3"; two are joined by " and ".
        lower: of the first driver's range, in its unit; beyond it the process goes back to its prior.
        upper: of the first driver's range.
        kernel: of `kernels`; for two drivers one of each, such as "smooth*line".
        further: lower and upper of the second driver.
        spread: the prior's standard deviation of a coefficient; None where nothing is known of it.
        rolloff: the `numbers` of its kernel, such as corner and slope of a spectrum; empty for a kernel without any.

    Raises:
        InputError: no such kernel or driver, bounds that are not those of the drivers, or an empty range.
    """

    driver: str
    lower: float
    upper: float
    kernel: str
    further: tuple[float, ...]
    spread: float | None
    rolloff: tuple[float, ...]

    name: ClassVar[str] = "unnamed"
    nonparametric: ClassVar[bool] = True
    specificity: ClassVar[int] = 17

    def __post_init__(self) -> None:
        count = len(self.drivers)
        bounds = self.bounds
        if not kernels.is_kernel(self.kernel, count):
            of_one_driver = f"one of {', '.join(kernels.KERNELS)}"
            of_two_drivers = "two that are joined by *, such as smooth*line"
            raise InputError(
                f"{self.label}: kernel {self.kernel!r} is not possible with {count} drivers; give "
                f"{of_one_driver if count == 1 else of_two_drivers}"
            )
        if len(bounds) != 2 * count or not all(low < high for low, high in zip(bounds[::2], bounds[1::2], strict=True)):
            raise InputError(
                f"{self.label}: the bounds {bounds} are not those of {count} drivers; give lower < upper of each"
            )
        fault = self.covariance.fault(bounds, self.rolloff)
        if fault:
            raise InputError(f"{self.label}: {fault}")

    @property
    def covariance(self) -> kernels.Kernel:
        """The kernel."""
        return kernels.kernel_of(self.kernel)

    @property
    @abstractmethod
    def coefficient(self) -> Coordinate:
        """Any of the coefficients, its name without a number."""

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coefficients."""
        return _coefficients(self.coefficient, self.size)

    @property
    def size(self) -> int:
        """How many coefficients it has: thousands of such effects are counted, and few have their coordinates."""
        return self.covariance.size(self.bounds, self.rolloff)

    @property
    def bounds(self) -> tuple[float, ...]:
        """Lower and upper of the first driver's range, and of the second's."""
        return self.lower, self.upper, *self.further

    @property
    def process(self) -> tuple[object, ...]:
        """The same for all that have these functions, wherever they act and whatever their prior is."""
        return self.driver, self.bounds, self.kernel, self.rolloff

    @property
    def drivers(self) -> tuple[Driver, ...]:
        """The driver, or two."""
        return drivers_of(self.driver)

    @property
    def hysteretic(self) -> bool:
        """Tells whether it depends on the way to a value of its driver."""
        return self.covariance.hysteretic

    def values_at(self, motion: Motion, loads: Loads | None) -> JaxArray:
        """The values of the drivers, `(driver, sample)`."""
        values = [driver.values(motion, loads) for driver in self.drivers]
        return library_of(values[0]).stack(values)

    def functions_at(self, values: JaxArray, run: JaxArray | None = None) -> JaxArray:
        """The functions `(function, sample)` at values `(driver, sample)` of the drivers; `run` as of a `Motion`."""
        return self.covariance.features(values, self.bounds, run, self.rolloff)

    def unknown_at(self, values: JaxArray) -> JaxArray:
        """The variance `(sample,)` of what the coefficients do not say of the process: beyond its range.

        None of a process without a prior, of which nothing is known there.
        """
        return self.covariance.unknown(values, self.bounds) * (self.spread or 0.0) ** 2


@final_effect
class Unnamed(Process, Bending):
    """δ = Σ coefficient · φ(drivers): a Gaussian process of one driver or of two, at one component of a site.

    Attributes:
        where: `jointN` (an angle), `linkN`, `base`, `tool` or `sensor` (a component of a twist).
        component: of the twist, x y z rx ry rz; at a joint it is rz. That of the sensor may be `scale`, by which its
            readings grow.
        driver, lower, upper, kernel, further, spread, rolloff: as of `Process`.

    Raises:
        InputError: no such site, component, driver or kernel, or an empty range.
    """

    where: str
    driver: str
    lower: float
    upper: float
    kernel: str = "smooth"
    component: str = "rz"
    further: tuple[float, ...] = ()
    spread: float | None = None
    rolloff: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not _SITE.fullmatch(self.where):
            raise InputError(f"unnamed: no site is called {self.where!r}; choose jointN, linkN, base, tool or sensor")
        joint = self.where.startswith("joint")
        grows = self.where == "sensor" and self.component == SCALE
        if (self.component not in COMPONENTS and not grows) or (joint and self.component != "rz"):
            accepted = "rz" if joint else "one of " + " ".join(COMPONENTS)
            accepted += f", or {SCALE}" if self.where == "sensor" else ""
            raise InputError(f"{self.label}: component {self.component!r} is not possible there; give {accepted}")
        super().__post_init__()

    @property
    def site(self) -> str:
        """Where it acts."""
        return self.where

    @property
    def unit(self) -> str:
        """The unit of what it adds."""
        return _MEASURES.get(self.component, ("rad", ""))[0]

    @property
    def coefficient(self) -> Coordinate:
        unit, end = _MEASURES.get(self.component, ("rad", "_rad"))
        return Coordinate(end, unit, 1e-4, np.inf if self.spread is None else float(self.spread), -_MOST, _MOST)

    def units(self, functions: Array, motion: Motion) -> Deflection:
        """The deflection by each coefficient, per unit of it; a leading axis `(coefficient, …)`."""
        parts = zip(*(self._at_site(function, motion) for function in functions), strict=True)  # type: ignore[arg-type]
        return Deflection(*(None if part[0] is None else np.stack(part) for part in parts))  # type: ignore[arg-type]

    def deflect(self, values: JaxArray, motion: Motion, loads: Loads | None) -> Deflection:
        """The process at its site."""
        return self.by_functions(
            jnp.asarray(values), self.functions_at(self.values_at(motion, loads), motion.run), motion
        )

    def by_functions(self, values: JaxArray, functions: JaxArray, motion: Motion) -> Deflection:
        """The process at its site, from its functions `(function, sample)`."""
        return self._at_site(values @ functions, motion)

    def _at_site(self, moved: JaxArray, motion: Motion) -> Deflection:
        """What adds `(sample,)`, where this effect is."""
        if self.component == SCALE:
            return Deflection(scale=library_of(moved).broadcast_to(moved, (motion.samples,)))
        if not self.where.startswith("joint"):
            moved = twist(motion.samples, **{self.component: moved})
        return place_at_site(motion.dof, self.where, moved)
