"""How the residuals of poses change with the numbers of effects: by names, and by processes of what may act where."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.deflections import Deflections
from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.composition import Physics
from lite6jax.effects.deflection import Deflection
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.effect import Effect, Loading
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import COMPONENTS, SCALE, Unnamed, place_of
from lite6jax.effects.statics import Loads
from lite6jax.estimation.problem import Component, Quantity
from lite6jax.estimation.terms import Factored, Term, Terms

Array = NDArray[np.floating]

_NEAR = 3
"""Joints next to the base, and next to the tool, on whose motion these depend as well."""
_WHOLE_ARM = ("temperature rise", "time", "payload")
_SIGHT = tuple(f"measured position{end}" for end in (" x", " y", " z", "'s distance", "'s azimuth", "'s elevation"))
_LEAST_VARIED = 1e-6
"""Range of a driver, in its unit, below which it did not vary."""


@final
@dataclass(frozen=True, eq=False)
class EffectColumns:
    """The columns of effects in one linearisation; those that do not depend on their numbers are computed once.

    Attributes:
        sites: how residuals change with a deflection at each site, `(row, sample)`.
        deflections: by effects.
        masses: the sites of uncertain masses.
    """

    sites: dict[Site, Array]
    deflections: Deflections
    masses: tuple[Site, ...]
    _linear: dict[Effect, Array] = field(default_factory=dict)
    _by_mass: dict[Effect, Array] = field(default_factory=dict)
    _sites: dict[tuple[str, str], Array] = field(default_factory=dict)

    def by_numbers(
        self, terms: Sequence[Term], values: Array | None = None, beside: tuple[Terms, Array] | None = None
    ) -> Array:
        """How residuals change with the numbers of effects, `(number, row, sample)`.

        An error of the payload or of gravity acts through compliances: those of `beside`, or of `terms` where that is
        not given.
        """
        own = Terms(tuple(terms))
        values = np.zeros(own.size) if values is None else np.asarray(values, float)
        found = np.empty((own.size, *self._shape))  # half a gigabyte of a real arm: each part is written in its place
        for effect, part in zip(own.terms, own.slices, strict=True):
            assert isinstance(effect, Effect)
            if isinstance(effect, Loading):
                others, at = (own, values) if beside is None else beside
                unit = self.deflections.through_loads(effect, values[part], physics_of(others), at)
                found[part] = columns_of(unit, self.sites)
            elif isinstance(effect, Unnamed):
                factored = self.factored(effect)
                np.multiply(
                    factored.site[:, None],
                    factored.functions[:, None],
                    out=found[part].reshape(len(factored.site), -1, *self._shape),
                )
            elif effect.linear or not values[part].any():
                if effect not in self._linear:
                    self._linear[effect] = columns_of(self.deflections.unit(effect), self.sites)
                found[part] = self._linear[effect]
            else:
                found[part] = columns_of(self.deflections.slope(effect, values[part]), self.sites)
        return found

    def factored(self, effect: Unnamed) -> Factored:
        """The columns of a function without a name; those of one site and component share the array of its columns."""
        return Factored(self._of_site(effect), self.deflections.basis(effect))

    def _of_site(self, effect: Unnamed) -> Array:
        """`(1, row, sample)`, the column of an effect's component."""
        key = effect.where, effect.component
        if key not in self._sites:
            self._sites[key] = self.sites[site_of(*key)][None]
        return self._sites[key]

    def by_masses(self, physics: Physics, values: Array) -> Array:
        """How residuals change with errors of masses through effects `(physics.size,)`, `(mass, row, sample)`."""
        values, total = np.asarray(values, float), np.zeros((len(self.masses), *self._shape))
        if not self.masses or not physics.loaded:
            return total
        for effect, part in zip(physics.effects, physics.slices, strict=True):
            if effect.linear:
                total += np.tensordot(values[part], self._by_unit_masses(effect), 1)
            else:
                total += self._through_masses(effect, values[part])
        return total

    def _by_unit_masses(self, effect: Effect) -> Array:
        """`(number, mass, row, sample)`, for unit numbers of a linear effect."""
        if effect not in self._by_mass:
            if isinstance(effect, Unnamed) or not Physics((effect,)).loaded:  # of the loads as declared
                found = np.zeros((effect.size, len(self.masses), 1, 1))
            else:
                found = np.stack([self._through_masses(effect, one) for one in np.eye(effect.size)])
            self._by_mass[effect] = found
        return self._by_mass[effect]

    def _through_masses(self, effect: Effect, values: Array) -> Array:
        return columns_of(self.deflections.through_masses(self.masses, Physics((effect,)), values), self.sites)

    @property
    def _shape(self) -> tuple[int, ...]:
        return self.sites["scale", 0, 0].shape


def physics_of(terms: Terms) -> Physics:
    """The effects that are the terms of a pose problem."""
    return Physics(tuple(term for term in terms.terms if isinstance(term, Effect)))


def columns_of(unit: Deflection, sites: dict[Site, Array]) -> Array:
    """The columns `(number, row, sample)` of unit deflections, from those of every site."""
    size = next(len(part) for part in unit if part is not None)
    out = np.zeros((size, *sites["scale", 0, 0].shape))
    for name, part in zip(Deflection._fields, unit, strict=True):
        if part is not None:
            for i in range(size):
                _accumulate(out[i], name, np.asarray(part[i]), sites)
    return out


def _accumulate(out: Array, name: str, shape: Array, sites: dict[Site, Array]) -> None:
    if name in ("joint", "stretch"):
        for j in range(len(shape)):
            if shape[j].any():
                out += sites[name, j, 0] * shape[j]
    elif name == "link":
        for j, k in zip(*np.nonzero(shape.any(-1)), strict=True):
            out += sites["link", int(j), int(k)] * shape[j, k]
    elif name == "scale":
        out += sites["scale", 0, 0] * shape
    else:
        for k in np.flatnonzero(shape.any(-1)):
            out += sites[name, 0, int(k)] * shape[k]


def components(sites: dict[Site, Array], motion: Motion, rows: int) -> tuple[Component, ...]:
    """The components that a sensor sees, those of joints first: of equals the first is chosen.

    A turn of a link about its joint's axis is an angle of the joint.

    Args:
        sites: `(row, sample)`, how residuals change with a deflection at each site.
        motion: of the arm.
        rows: 3, or 6 where orientations are measured.
    """
    dof = motion.dof
    found = [(f"joint{j + 1}", "rz") for j in range(dof) if not motion.sliding.mask(dof)[j]]
    found += [(f"link{j + 1}", one) for j in range(dof) if dof > 1 for one in COMPONENTS[:5]]
    found += [
        (where, one) for where in ("base", "tool", "sensor") for one in COMPONENTS[: rows if where == "tool" else 6]
    ]
    found += [("sensor", SCALE)]
    columns = ((where, one, sites[site_of(where, one)]) for where, one in found)
    return tuple(Component(where, one, column) for where, one, column in columns if column.any())


def quantities(motion: Motion, loads: Loads | None) -> tuple[Quantity, ...]:
    """The drivers that are known and vary, each with the sites whose own it is.

    Args:
        motion: time-shifted.
        loads: on the rigid arm, or None.
    """
    found = []
    for driver, own, only in _drivers(motion):
        if not driver.known(motion, loads):
            continue
        values = np.asarray(driver.values(motion, loads), float)
        if np.ptp(values) > _LEAST_VARIED and np.isfinite(values).all():
            found.append(Quantity(driver, values, own, only))
    return tuple(found)


def _drivers(motion: Motion) -> Iterator[tuple[Driver, frozenset[str], str]]:
    """All drivers, the sites whose own each is (all of them where that is `""`), and the one site where it can act."""
    dof, slides = motion.dof, motion.sliding.mask(motion.dof)
    rise = motion.joint_temperature_rise
    apart = rise is not None and np.ptp(np.asarray(rise), 0).any()  # else that of the whole arm would be there twice
    for j in range(1, dof + 1):
        own, last = {f"joint{j}", f"link{j}"}, {"tool"} if j == dof else set()
        ends = ({"base"} if j <= _NEAR else set()) | ({"tool"} if j > dof - _NEAR else set())
        moved: Callable[[str], Driver] = lambda quantity, j=j: joint_driver(quantity, j, bool(slides[j - 1]))  # noqa: E731
        for driver in (moved("position"), moved("velocity"), Driver("direction of motion", j)):
            yield driver, frozenset(own | ends), ""
        yield moved("gravity torque"), frozenset(own | last), ""
        for axis in "xy":
            yield Driver(f"gravity moment {axis}", j), frozenset({f"link{j}"} | last), ""
        if apart:
            yield Driver("temperature", j), frozenset(own | {f"link{j - 1}"}), ""
    for axis in "xy":
        yield Driver(f"base moment {axis}"), frozenset({"base", "sensor"}), ""
    for quantity in _WHOLE_ARM:
        yield Driver(quantity), frozenset({""}), ""
    for quantity in _SIGHT:
        yield Driver(quantity), frozenset({"sensor"}), "sensor"


def site_of(where: str, component: str) -> Site:
    """The key of the site at which a component of a nonparametric effect acts; at a joint there is but one."""
    if component == SCALE:
        return SCALE, 0, 0
    kind, number = place_of(where)
    return kind, max(number - 1, 0), 0 if kind == "joint" else COMPONENTS.index(component)
