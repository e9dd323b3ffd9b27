"""How the residuals of poses change with the numbers of effects, and through effects with errors of masses."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose import functions
from lite6jax.domains.pose.deflections import Deflections
from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.composition import Physics
from lite6jax.effects.deflection import Deflection
from lite6jax.effects.effect import Effect, Loading
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.factored import Factored
from lite6jax.estimation.terms import Term, Terms

Array = NDArray[np.floating]


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
            self._sites[key] = self.sites[functions.site_of(*key)][None]
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
