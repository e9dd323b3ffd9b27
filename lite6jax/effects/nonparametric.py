"""Physics without a name: at one site, a function of one driver (spline, harmonics, hysteresis) or of several."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import chain, combinations, combinations_with_replacement, product
from typing import ClassVar, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.deferred import Array, jit, jnp, lax
from lite6jax.effects.deflection import Deflection, at_joint, library_of, twist
from lite6jax.effects.drivers import Driver, driver_of
from lite6jax.effects.effect import Bending, Coordinate, Part
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Loads
from lite6jax.errors import InputError

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
"""Of a twist: a translation in m and a rotation vector in rad."""

SCALE = "scale"
"""The component of a sensor whose readings grow: what it shows moves away from its origin, in proportion."""

_MEASURES = {**dict.fromkeys("xyz", ("m", "_m", np.inf)), SCALE: ("1", "", 1.0)}
"""Unit of a component that is no rotation, how the names of its coefficients end, and what no curve reaches:
coefficients are larger where no sample determines them.
"""

_PIECES = (8, 16)
"""Intervals of the splines that are tried where a plainer function of their driver was found."""
_HIGHEST_DEGREE = 4

_TOGETHER = ("x y z", "rx ry rz", "rx ry")
"""Components of a twist that are one displacement of their own: a shift, a turn, a tilt."""

_SITE = re.compile(r"joint([1-9]\d*)|link([1-9]\d*)|base|tool|sensor")


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


Products = tuple[tuple[int, ...], ...]
"""Of drivers, by their indices; the constant is the empty product."""


@cache
def products_of(drivers: tuple[Driver, ...], degree: int, power: int = 0) -> Products:
    """All products of up to `degree` drivers, the constant first.

    A direction of motion is in a product once at most: its square is the constant. Any other driver is there `power`
    times at most, where that is not 0.
    """
    most = [1 if driver.discrete else power or degree for driver in drivers]
    orders = (combinations_with_replacement(range(len(drivers)), order) for order in range(degree + 1))
    return tuple(which for found in orders for which in found if _within(which, most))


def _within(which: tuple[int, ...], most: Sequence[int]) -> bool:
    """Whether a product has no driver more often than allowed."""
    return all(which.count(k) <= most[k] for k in which)


def polynomial_basis(values: Array, ranges: NDArray, products: Products) -> Array:
    """The products of drivers, `(product, sample)`.

    Each driver is scaled so that its range is from -1 to 1, and keeps its value beyond. Of NumPy values on the host.

    Args:
        values: `(driver, sample)`.
        ranges: `(driver, 2)`, lower and upper.
        products: which.
    """
    xp = library_of(values)
    lower, upper = ranges.T[..., None]
    u = xp.clip(2 * (values - lower) / (upper - lower) - 1, -1.0, 1.0)
    return xp.stack([xp.prod(u[np.array(which, int)], 0) for which in products])


class Form(NamedTuple):
    """A part of a function without a name: components, drivers by their indices, degree, and power of one driver.

    `numbers` are the coefficients of the whole that it has.
    """

    component: str
    drivers: tuple[int, ...]
    degree: int
    power: int
    numbers: tuple[int, ...]


@cache
def _contained_forms(
    component: str, drivers: tuple[Driver, ...], degree: int, power: int, least: int, pieces: int
) -> tuple[Form, ...]:
    """The parts of a function: of all or some components, of all drivers (or one or two of three), of a lower degree.

    The whole itself is not among them.
    Of two drivers, neither of which is a direction of motion, there is also the one without their squares.

    Args:
        component: of the whole.
        drivers: of the whole.
        degree: of the whole; 0 where it has none.
        power: of the whole.
        least: lowest degree of polynomials.
        pieces: functions of each component, where the whole has no degree.
    """
    components, every = component.split(), tuple(range(len(drivers)))
    together = [one for one in _TOGETHER if set(one.split()) < set(components)]
    of = [every, *chain.from_iterable(combinations(every, n) for n in range(1, len(every)) if len(every) > 2)]
    products = products_of(drivers, degree, power) if degree else ((),) * pieces
    plain = [(n, min(power, n)) for n in range(min(degree, least), degree + 1)]
    bilinear = degree > 1 and not power and not any(driver.discrete for driver in drivers)
    forms = []
    for parts, which in product(dict.fromkeys((component, *together, *components)), of):
        for highest, most in [*plain, *([(2, 1)] if bilinear and len(which) == 2 else [])]:
            if (parts, which, highest, most) == (component, every, degree, power):
                continue
            allowed = [(most or highest) * (k in which) for k in every]
            kept = [k for k, one in enumerate(products) if len(one) <= highest and _within(one, allowed)]
            blocks = [components.index(one) * len(products) for one in parts.split()]
            forms.append(Form(parts, which, highest, most, tuple(start + k for start in blocks for k in kept)))
    return tuple(forms)


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


@final
@dataclass(frozen=True)
class Unnamed(Bending):
    """δ = Σ coefficient · B(driver): whatever one driver, or several, do at one site.

    B are cubic B-splines; with `orders`, the sine and cosine of each order of the driver, an angle; with `memory`, what
    follows the driver with so much play each; with `degree`, products of one or several drivers. Splines of a driver
    and a direction of motion are those of the driver, multiplied by the direction.

    Attributes:
        where: `jointN` (an angle), `linkN`, `base`, `tool` or `sensor` (components of a twist).
        driver: the phrase of a `Driver`, such as "position of joint 3"; of several, joined by " and ".
        lower: of the first driver's range, in its unit; beyond the range the curve is constant.
        upper: of the first driver's range.
        pieces: the intervals of the spline; it has three more coefficients.
        component: of the twist, one or several of x y z rx ry rz, separated by blanks, each with coefficients of its
            own; at a joint it is rz. That of the sensor may be `scale` instead, by which its readings grow.
        orders: of the waves, that are there instead of a spline.
        trust: by how much to believe waves, from 0 to 1, at equal steps of the driver from `lower` to `upper`: they
            mean nothing where nothing was measured.
        spread: one standard deviation of the coefficients, where that is known beforehand.
        rolloff: corner c and slope s, by which the variance of waves of order k falls, as 1 / (1 + (k / c)ˢ); none
            where it does not.
        memory: half the widths of the plays, in the driver's unit, that are there instead of a spline.
        degree: of polynomials, that are there instead of a spline; 0 for none.
        power: highest power of each driver in these; 0 where the degree alone limits it.
        further: lower and upper of each further driver.

    Raises:
        InputError: no such site, driver or component, or an empty range.
    """

    where: str
    driver: str
    lower: float
    upper: float
    pieces: int = 8
    component: str = "rz"
    orders: tuple[float, ...] = ()
    trust: tuple[float, ...] = ()
    spread: float | None = None
    memory: tuple[float, ...] = ()
    degree: int = 0
    further: tuple[float, ...] = ()
    rolloff: tuple[float, ...] = ()
    power: int = 0

    name: ClassVar[str] = "unnamed"
    nonparametric: ClassVar[bool] = True
    shrinking: ClassVar[bool] = True
    specificity: ClassVar[int] = 17
    counted = staticmethod(lambda effect: len(effect.components) * effect.functions)
    contained_functions = staticmethod(
        lambda effect: tuple(Part(form.numbers, partial(effect.of_form, form)) for form in effect.forms)
    )
    finer_functions = staticmethod(lambda effect: effect.of_more_numbers)

    def __post_init__(self) -> None:
        if not _SITE.fullmatch(self.where):
            raise InputError(f"unnamed: no site is called {self.where!r}; choose jointN, linkN, base, tool or sensor")
        joint, grows = self.where.startswith("joint"), self.where == "sensor" and self.component == SCALE
        strange = not self.components or set(self.components) - set(COMPONENTS)
        if (strange and not grows) or (joint and self.component != "rz"):
            wanted = "rz" if joint else "one or several of " + " ".join(COMPONENTS)
            wanted += f", or {SCALE}" if self.where == "sensor" else ""
            raise InputError(f"unnamed:{self.where}: component {self.component!r} is not possible there; give {wanted}")
        if not self.lower < self.upper or self.pieces < 1:
            raise InputError(
                f"unnamed:{self.where}: {self.pieces} pieces from {self.lower:g} to {self.upper:g} are no curve; give "
                "lower < upper and at least one piece"
            )
        if bool(self.orders) != (len(self.trust) > 1):
            raise InputError(
                f"unnamed:{self.where}: {len(self.orders)} orders and {len(self.trust)} numbers of trust; give both, "
                "two of these at least, or none"
            )
        if self.memory and (self.orders or min(self.memory) < 0):
            raise InputError(
                f"unnamed:{self.where}: memory {self.memory} is not possible; give widths from 0 on, and no orders"
            )
        several = len(self.drivers) - 1
        directed = several == 1 and self.drivers[1].discrete and not self.orders + self.memory
        if len(self.further) != 2 * several or (several and not self.degree and not directed):
            raise InputError(
                f"unnamed:{self.where}: {several + 1} drivers and {len(self.further)} further bounds; give lower and "
                "upper of each driver but the first, and a degree unless the second is a direction of motion"
            )
        if self.rolloff and (len(self.rolloff) != 2 or self.rolloff[0] <= 0 or self.spread is None or not self.orders):
            raise InputError(
                f"unnamed:{self.where}: rolloff {self.rolloff} is not possible; give a positive corner order and a "
                "slope, beside orders and their spread"
            )
        if self.power and (self.power < 0 or self.power > self.degree):
            raise InputError(
                f"unnamed:{self.where}: power {self.power} of degree {self.degree}; give one from 1 to the degree, or 0"
            )
        if self.degree and (self.orders or self.memory):
            raise InputError(f"unnamed:{self.where}: a degree beside orders or memory; give one of them")

    @property
    def components(self) -> tuple[str, ...]:
        """The components of the twist, one after another."""
        return tuple(self.component.split())

    @property
    def site(self) -> str:
        """Where it acts."""
        return self.where

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coefficients."""
        return self._coordinates

    @cached_property
    def _coordinates(self) -> tuple[Coordinate, ...]:
        names = [f"{wave}_{order:g}" for order in self.orders for wave in ("sine", "cosine")]
        names = names or [f"coefficient{i + 1}" for i in range(self.functions)]
        several = len(self.components) > 1
        return tuple(
            Coordinate(f"{f'{component}_' if several else ''}{name}{end}", unit, 1e-4, spread, -limit, limit)
            for component in self.components
            for unit, end, limit in (_MEASURES.get(component, ("rad", "_rad", 2 * np.pi)),)
            for name, spread in zip(names, self._spreads, strict=True)
        )

    @property
    def _spreads(self) -> list[float]:
        """Of each function's coefficient."""
        if self.spread is None:
            return [float("inf")] * self.functions
        if not self.rolloff:
            return [self.spread] * self.functions
        corner, slope = self.rolloff
        return [self.spread / (1 + (order / corner) ** slope) ** 0.5 for order in self.orders for _ in range(2)]

    @property
    def functions(self) -> int:
        """How many functions of the drivers there are, and so coefficients of each component."""
        if self.degree:
            return len(self.products)
        return 2 * len(self.orders) or len(self.memory) or self.pieces + 3

    @property
    def products(self) -> Products:
        """Of the drivers; the constant alone where there is no degree."""
        return products_of(self.drivers, self.degree, self.power)

    @property
    def functions_alone(self) -> tuple[object, ...]:
        """The same for all that have these functions, wherever they act and whatever is known of their coefficients."""
        curve = self.pieces, self.orders, self.trust, self.memory, self.degree, self.power
        return self.driver, self.lower, self.upper, self.further, *curve

    @property
    def forms(self) -> tuple[Form, ...]:
        """Those with fewer numbers: of some components, of fewer of three drivers, of a lower degree, or no squares.

        Lines are not among those of a joint, where the catalogue has names for them.
        """
        least = 2 if self.where.startswith("joint") else 1
        pieces = 0 if self.degree else self.functions
        return _contained_forms(self.component, self.drivers, self.degree, self.power, least, pieces)

    @property
    def displacements(self) -> "tuple[Unnamed, ...]":
        """Of a function that both shifts and turns, its shift, its turn and its tilt; of any other, itself."""
        there = set(self.components)
        if not {"x", "rx"} <= there:
            return (self,)
        return tuple(replace(self, component=one) for one in _TOGETHER if set(one.split()) <= there)

    def of_form(self, form: Form) -> "Unnamed":
        """The function of one of `forms`."""
        ranges = ((self.lower, self.upper), *zip(self.further[::2], self.further[1::2], strict=True))
        (lower, upper), *others = (ranges[k] for k in form.drivers)
        return replace(
            self,
            driver=" and ".join(self.drivers[k].phrase for k in form.drivers),
            lower=lower,
            upper=upper,
            component=form.component,
            degree=form.degree,
            power=form.power,
            further=tuple(chain.from_iterable(others)),
        )

    @property
    def of_more_numbers(self) -> "tuple[Unnamed, ...]":
        """Splines of more pieces over one driver; of several, products of one more of them, and their squares."""
        if self.orders or self.memory:
            return ()
        if len(self.drivers) > 1:
            squares = (replace(self, power=0),) if self.power else ()
            further = (replace(self, degree=self.degree + 1, power=0),) if 0 < self.degree < _HIGHEST_DEGREE else ()
            return squares + further
        return tuple(replace(self, degree=0, power=0, pieces=n) for n in _PIECES if n + 3 > self.functions)

    def part(self, component: int) -> slice:
        """Where the coefficients of a component stand, counted from 0."""
        return slice(component * self.functions, (component + 1) * self.functions)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        """The driver, or several."""
        return self._drivers

    @cached_property
    def _drivers(self) -> tuple[Driver, ...]:
        return tuple(driver_of(phrase) for phrase in self.driver.split(" and "))

    @property
    def of(self) -> tuple[Driver, ...]:
        """What the functions run over: the drivers, but for a direction that multiplies splines."""
        return self.drivers if self.degree else self.drivers[:1]

    def values_at(self, motion: Motion, loads: Loads | None) -> Array:
        """The values of the driver `(sample,)`, or of several `(driver, sample)`."""
        values = [driver.values(motion, loads) for driver in self.drivers]
        return values[0] if len(values) == 1 else library_of(values[0]).stack(values)

    def basis(self, driver: Array, run: Array | None = None) -> Array:
        """The functions that coefficients multiply, `(function, sample)`, at values `(sample,)` of the driver.

        Args:
            driver: its values, one after another; `(driver, sample)` of several.
            run: `(2, sample)`, where runs begin and end, which a hysteresis requires; one run where not given.
        """
        if self.degree:
            ranges = np.array((self.lower, self.upper, *self.further)).reshape(-1, 2)
            return polynomial_basis(library_of(driver).atleast_2d(driver), ranges, self.products)
        if self.memory:
            one = np.zeros((2, driver.size), int)
            return plays(driver, np.array(self.memory), one if run is None else run)  # type: ignore[arg-type]
        if not self.orders:
            first, *direction = library_of(driver).atleast_2d(driver)
            splines = spline_basis(first, self.lower, self.upper, self.pieces)
            return splines * direction[0] if direction else splines
        xp = library_of(driver)
        turned = np.array(self.orders)[:, None] * driver
        waves = xp.stack([xp.sin(turned), xp.cos(turned)], 1).reshape(self.functions, -1)
        at = np.linspace(self.lower, self.upper, len(self.trust))
        return waves * xp.interp(driver, at, np.array(self.trust), left=0.0, right=0.0)

    def units(self, basis: NDArray[np.floating], motion: Motion) -> Deflection:
        """The deflection by each coefficient, per unit of it, from `basis`; a leading axis `(coordinate, …)`."""
        units = [(component, function) for component in self.components for function in basis]
        parts = zip(*(self._at_site({c: shift}, motion) for c, shift in units), strict=True)  # type: ignore[arg-type]
        return Deflection(*(None if part[0] is None else np.stack(part) for part in parts))  # type: ignore[arg-type]

    def curve(self, values: Array, driver: Array, run: Array | None = None) -> Array:
        """The curve's value `(sample,)`, m or rad, at values of the drivers; `run` as in `basis`.

        Of several components it is `(component, sample)`.
        """
        curves = values.reshape(len(self.components), -1) @ self.basis(driver, run)
        return curves[0] if len(self.components) == 1 else curves

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        """The curves at their site."""
        return self.by_functions(jnp.asarray(values), self.basis(self.values_at(motion, loads), motion.run), motion)

    def by_functions(self, values: Array, basis: Array, motion: Motion) -> Deflection:
        """The curves at their site, from the functions `(function, sample)` of `basis`."""
        curves = values.reshape(len(self.components), -1) @ basis
        return self._at_site(dict(zip(self.components, curves, strict=True)), motion)

    def _at_site(self, shifts: "dict[str, Array]", motion: Motion) -> Deflection:
        """Curves `(sample,)` by component, where this effect is."""
        kind, number = self.where.rstrip("0123456789"), int("0" + "".join(filter(str.isdecimal, self.where)))
        if kind == "joint":
            return Deflection(joint=at_joint(motion.dof, number, shifts["rz"]))
        if SCALE in shifts:
            return Deflection(scale=library_of(shifts[SCALE]).broadcast_to(shifts[SCALE], (motion.samples,)))
        displaced = twist(motion.samples, **shifts)
        if kind == "link":
            return Deflection(link=at_joint(motion.dof, number, displaced))
        return Deflection(**{kind: displaced})
