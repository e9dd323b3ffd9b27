"""Physics without a name: at one site, a function of one driver (spline, waves, hysteresis) or of several."""

import re
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache, partial
from itertools import chain, product
from typing import ClassVar, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.deferred import Array, jnp
from lite6jax.effects.bases import Basis, Plays, Polynomial, Spline, Waves
from lite6jax.effects.deflection import Deflection, library_of, place_at_joint, twist
from lite6jax.effects.drivers import Driver, driver_of
from lite6jax.effects.effect import Bending, Coordinate, Part
from lite6jax.effects.motion import Motion
from lite6jax.effects.polynomials import Products, Subset
from lite6jax.effects.statics import Loads
from lite6jax.errors import InputError

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
"""Of a twist: a translation in m and a rotation vector in rad."""

SCALE = "scale"
"""The component of a sensor whose readings grow: what it shows moves away from its origin, in proportion."""

_MOST = 0.5
"""rad, m, or a share of the readings: the largest coefficient of splines, plays and polynomials that is possible."""
_MOST_OF_WAVES = 2 * np.pi
"""That of waves, which may nearly cancel over a part of a turn."""
_MEASURES = {**dict.fromkeys("xyz", ("m", "_m")), SCALE: ("1", "")}
"""Unit of a component that is no rotation, and how the names of its coefficients end."""

_TOGETHER = ("x y z", "rx ry rz", "rx ry")
"""Components of a twist that are one displacement of their own: a shift, a turn, a tilt."""

_NAMED_LINES = {"gravity torque", "velocity", "temperature"}
"""Quantities of a joint to which an effect of the catalogue is proportional there: compliance, lag, thermal offset."""

_SITE = re.compile(r"joint([1-9]\d*)|link([1-9]\d*)|base|tool|sensor")


class Form(NamedTuple):
    """A part of a function without a name.

    Attributes:
        component: one or several of the whole's.
        functions: of the drivers, those that it has.
        numbers: the coefficients of the whole that it has.
    """

    component: str
    functions: Subset
    numbers: tuple[int, ...]


@cache
def _forms(component: str, subsets: tuple[Subset, ...]) -> tuple[Form, ...]:
    """Of all or some components, with all or some functions of each; all components with all functions are none."""
    components, size = component.split(), max(len(functions.numbers) for functions in subsets)
    together = [one for one in _TOGETHER if set(one.split()) < set(components)]
    forms = []
    for parts, functions in product(dict.fromkeys((component, *together, *components)), subsets):
        blocks = [size * components.index(one) for one in parts.split()]
        numbers = tuple(start + k for start in blocks for k in functions.numbers)
        if len(numbers) < size * len(components):
            forms.append(Form(parts, functions, numbers))
    return tuple(forms)


@lru_cache(maxsize=4096)  # thousands of functions have hundreds of drivers
def _drivers_of(phrase: str) -> tuple[Driver, ...]:
    """One driver, or several that are joined by " and "."""
    return tuple(map(driver_of, phrase.split(" and ")))


@cache
def place_of(where: str) -> tuple[str, int]:
    """The kind of a site, such as `link`, and the number of a joint or link; 0 of the others."""
    return where.rstrip("0123456789"), int("0" + "".join(filter(str.isdecimal, where)))


@cache
def _components_at(where: str, component: str) -> tuple[str, ...]:
    """The components of a twist, one after another, that a function has at its site.

    Raises:
        InputError: no such site, or a component that is not possible there.
    """
    if not _SITE.fullmatch(where):
        raise InputError(f"unnamed: no site is called {where!r}; choose jointN, linkN, base, tool or sensor")
    joint, components = where.startswith("joint"), tuple(component.split())
    grows = where == "sensor" and component == SCALE
    strange = not components or set(components) - set(COMPONENTS)
    if (strange and not grows) or (joint and component != "rz"):
        wanted = "rz" if joint else "one or several of " + " ".join(COMPONENTS)
        wanted += f", or {SCALE}" if where == "sensor" else ""
        raise InputError(f"unnamed:{where}: component {component!r} is not possible there; give {wanted}")
    return components


@final
@dataclass(frozen=True)
class Unnamed(Bending):
    """δ = Σ coefficient · B(driver): whatever one driver, or several, do at one site.

    B are cubic B-splines; with `orders`, the sine and cosine of each order of the driver, an angle; with `memory`, what
    follows the driver with so much play each; with `degree`, products of one or several drivers. Splines and waves of
    two drivers are those of the first, multiplied by the second over its greatest size.

    Attributes:
        where: `jointN` (an angle), `linkN`, `base`, `tool` or `sensor` (components of a twist).
        driver: the phrase of a `Driver`, such as "position of joint 3"; of several, joined by " and ".
        lower: of the first driver's range, in its unit; beyond it splines and polynomials are constant, waves zero.
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
        tried_as_rare: whether a search that tries it takes it for less likely beforehand than others: no part of what
            it is.

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
    tried_as_rare: bool = field(default=False, compare=False)

    name: ClassVar[str] = "unnamed"
    nonparametric: ClassVar[bool] = True
    shrinking: ClassVar[bool] = True
    specificity: ClassVar[int] = 17
    counted = staticmethod(lambda effect: len(effect.components) * effect.functions)
    contained_functions = staticmethod(
        lambda effect: tuple(Part(form.numbers, partial(effect.of_form, form)) for form in effect.forms)
    )
    unlikely = staticmethod(lambda effect: effect.tried_as_rare)
    finer_functions = staticmethod(lambda effect: effect.of_more_numbers)

    def __post_init__(self) -> None:
        _components_at(self.where, self.component)
        if mistake := self._contradiction or self.basis.mistake:
            raise InputError(f"{self.label}: {mistake}")

    @property
    def _contradiction(self) -> str:
        """Which fields do not fit each other, whatever the basis, and what to give instead; empty where all fit."""
        if not self.lower < self.upper or self.pieces < 1:
            return (
                f"{self.pieces} pieces from {self.lower:g} to {self.upper:g} are no curve; give lower < upper and at "
                "least one piece"
            )
        if self.memory and (self.orders or min(self.memory) < 0):
            return f"memory {self.memory} is not possible; give widths from 0 on, and no orders"
        if (self.degree or self.power) and (self.orders or self.memory):
            return "a degree beside orders or memory; give one of them"
        return ""

    @cached_property
    def basis(self) -> Basis:
        """The functions of the drivers."""
        over = self.drivers, (self.lower, self.upper, *self.further), self.spread
        if self.orders or self.trust or self.rolloff:
            return Waves(*over, self.orders, self.trust, self.rolloff)
        if self.memory:
            return Plays(*over, self.memory)
        if self.degree or self.power:
            return Polynomial(*over, self.degree, self.power)
        return Spline(*over, self.pieces)

    @property
    def components(self) -> tuple[str, ...]:
        """The components of the twist, one after another."""
        return _components_at(self.where, self.component)

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
        several, most = len(self.components) > 1, _MOST_OF_WAVES if self.orders else _MOST
        return tuple(
            Coordinate(f"{f'{component}_' if several else ''}{name}{end}", unit, 1e-4, spread, -most, most)
            for component in self.components
            for unit, end in (_MEASURES.get(component, ("rad", "_rad")),)
            for name, spread in zip(self.basis.names, self.basis.spreads, strict=True)
        )

    @property
    def functions(self) -> int:
        """How many functions of the drivers there are, and so coefficients of each component."""
        return self.basis.size

    @property
    def products(self) -> Products:
        """Of the drivers; none where there is no degree."""
        return self.basis.products

    @property
    def functions_alone(self) -> tuple[object, ...]:
        """The same for all that have these functions, wherever they act and whatever is known of their coefficients."""
        curve = self.pieces, self.orders, self.trust, self.memory, self.degree, self.power
        return self.driver, self.lower, self.upper, self.further, *curve

    @property
    def forms(self) -> tuple[Form, ...]:
        """Those with fewer numbers: of some components, of fewer of three drivers, of a lower degree, or no squares.

        Lines of a joint are not among them where the catalogue has a name for one.
        """
        least = 2 if self.where.startswith("joint") and self._has_named_line else 1
        return _forms(self.component, self.basis.subsets(least))

    @property
    def _has_named_line(self) -> bool:
        """Whether the catalogue has a name for what is in proportion to one of the drivers, of an angle of a joint."""
        own = {driver.generalised for driver in self.drivers if self.where == f"joint{driver.place}"}
        turns = any(driver.quantity == "position" for driver in self.drivers)
        warms = any(driver.quantity == "temperature rise" for driver in self.drivers)
        return turns or warms or bool(own & _NAMED_LINES)

    @property
    def displacements(self) -> "tuple[Unnamed, ...]":
        """Of a function that both shifts and turns, its shift, its turn and its tilt; of any other, itself."""
        there = set(self.components)
        if not {"x", "rx"} <= there:
            return (self,)
        return tuple(replace(self, component=one) for one in _TOGETHER if set(one.split()) <= there)

    def of_form(self, form: Form) -> "Unnamed":
        """The function of one of `forms`."""
        which = form.functions.drivers
        lower, upper, *further = chain.from_iterable(self.basis.bounds[2 * k : 2 * k + 2] for k in which)
        return replace(
            self,
            driver=" and ".join(self.drivers[k].phrase for k in which),
            lower=lower,
            upper=upper,
            component=form.component,
            degree=form.functions.degree,
            power=form.functions.power,
            further=tuple(further),
        )

    @property
    def of_more_numbers(self) -> "tuple[Unnamed, ...]":
        """Those of the same drivers that have more numbers."""
        return tuple(replace(self, **fields) for fields in self.basis.finer)

    def part(self, component: int) -> slice:
        """Where the coefficients of a component stand, counted from 0."""
        return slice(component * self.functions, (component + 1) * self.functions)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        """The driver, or several."""
        return _drivers_of(self.driver)

    @property
    def of(self) -> tuple[Driver, ...]:
        """What the functions run over: the drivers, but for a second one that multiplies splines or waves."""
        return self.basis.of

    def values_at(self, motion: Motion, loads: Loads | None) -> Array:
        """The values of the driver `(sample,)`, or of several `(driver, sample)`."""
        values = [driver.values(motion, loads) for driver in self.drivers]
        return values[0] if len(values) == 1 else library_of(values[0]).stack(values)

    def units(self, basis: NDArray[np.floating], motion: Motion) -> Deflection:
        """The deflection by each coefficient, per unit of it, from `basis`; a leading axis `(coordinate, …)`."""
        units = [(component, function) for component in self.components for function in basis]
        parts = zip(*(self._at_site({c: shift}, motion) for c, shift in units), strict=True)  # type: ignore[arg-type]
        return Deflection(*(None if part[0] is None else np.stack(part) for part in parts))  # type: ignore[arg-type]

    def curve(self, values: Array, driver: Array, run: Array | None = None) -> Array:
        """The curve's value `(sample,)`, m or rad, at values of the drivers; `run` as in `Basis.at`.

        Of several components it is `(component, sample)`.
        """
        curves = values.reshape(len(self.components), -1) @ self.basis.at(driver, run)
        return curves[0] if len(self.components) == 1 else curves

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        """The curves at their site."""
        return self.by_functions(jnp.asarray(values), self.basis.at(self.values_at(motion, loads), motion.run), motion)

    def by_functions(self, values: Array, basis: Array, motion: Motion) -> Deflection:
        """The curves at their site, from the functions `(function, sample)` of `basis`."""
        curves = values.reshape(len(self.components), -1) @ basis
        return self._at_site(dict(zip(self.components, curves, strict=True)), motion)

    def _at_site(self, shifts: "dict[str, Array]", motion: Motion) -> Deflection:
        """Curves `(sample,)` by component, where this effect is."""
        kind, number = place_of(self.where)
        if kind == "joint":
            return Deflection(joint=place_at_joint(motion.dof, number, shifts["rz"]))
        if SCALE in shifts:
            return Deflection(scale=library_of(shifts[SCALE]).broadcast_to(shifts[SCALE], (motion.samples,)))
        displaced = twist(motion.samples, **shifts)
        if kind == "link":
            return Deflection(link=place_at_joint(motion.dof, number, displaced))
        return Deflection(**{kind: displaced})
