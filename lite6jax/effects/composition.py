"""A set of effects: one vector of all their coordinates, and the sum of their deflections."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.deferred import JaxArray, jnp
from lite6jax.effects.deflection import Deflection
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Altering, Bending, Effect, Estimate, Loading, require_kind
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Inertia, Loads
from lite6jax.errors import InputError


@final
@dataclass(frozen=True)
class Physics:
    """The effects of an arm beyond its rigid model. Hashable, so that it can be a static argument of `jax.jit`.

    The coordinates of all effects are concatenated in `values` `(size,)`; at zero the arm is rigid.

    Attributes:
        effects: in any order, which changes nothing but the layout of `values`; an effect may occur more than once, as
            two harmonics of one joint do.
    """

    effects: tuple[Effect, ...] = ()

    @cached_property
    def size(self) -> int:
        """The number of coordinates of all effects."""
        return sum(effect.size for effect in self.effects)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Such as `joint_compliance:joint2:compliance_rad_per_Nm`; a label that repeats is numbered, `…:joint2#2:…`."""
        label_counts: Counter[str] = Counter()
        names = []
        for effect in self.effects:
            label_counts[effect.label] += 1
            label = effect.label + (f"#{label_counts[effect.label]}" if label_counts[effect.label] > 1 else "")
            names += [f"{label}:{coordinate.name}" for coordinate in effect.coordinates]
        return tuple(names)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """The unit of each coordinate."""
        return tuple(coordinate.unit for effect in self.effects for coordinate in effect.coordinates)

    @cached_property
    def typical(self) -> NDArray:
        """`(size,)`, the typical magnitude of each coordinate in real arms."""
        return np.array([coordinate.typical for effect in self.effects for coordinate in effect.coordinates])

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """The part of `values` that belongs to each effect."""
        ends = np.cumsum([0] + [effect.size for effect in self.effects]).tolist()
        return tuple(slice(start, end) for start, end in pairwise(ends))

    @cached_property
    def pairs(self) -> tuple[tuple[Effect, slice], ...]:
        """Each effect with the part of `values` that belongs to it."""
        return tuple(zip(self.effects, self.slices, strict=True))

    @property
    def loaded(self) -> bool:
        """Tells whether any effect depends on the loads of gravity."""
        return any(isinstance(e, Bending) and any(driver.loaded for driver in e.drivers) for e in self.effects)

    @property
    def altering(self) -> tuple[Altering, ...]:
        """The effects of the clock, the payload and gravity, which change the motion and its loads."""
        return tuple(effect for effect in self.effects if isinstance(effect, Altering))

    def join(self, values: Sequence[ArrayLike]) -> NDArray:
        """`(size,)`, the values of all effects concatenated."""
        return np.concatenate([np.zeros(0), *(np.asarray(value, float) for value in values)])

    def part(self, values: NDArray, selected: Sequence[bool]) -> "tuple[Physics, NDArray]":
        """A subset of the effects with its part of `values`.

        Args:
            values: `(size,)`, of all effects.
            selected: for each effect, whether the subset contains it.
        """
        subset = [
            (effect, values[at]) for effect, at, stays in zip(self.effects, self.slices, selected, strict=True) if stays
        ]
        physics = Physics(tuple(effect for effect, _ in subset))
        return physics, physics.join([value for _, value in subset])

    def check(self, motion: Motion, loads_known: bool) -> None:
        """Checks that a motion has every quantity on which the effects depend.

        Args:
            motion: only which of its arrays are given and the number of its joints are used.
            loads_known: whether masses or loads are given.

        Raises:
            InputError: a driver is missing, or an effect acts at a joint that the arm does not have. The message names
                the effect, the quantity and how to record it.
        """
        for effect in self.effects:
            if effect.joints_needed > motion.dof:
                raise InputError(
                    f"{effect.label}: acts at joint {effect.joints_needed}, but the arm has {motion.dof} joints; "
                    "choose one of them"
                )
            require_kind(effect, motion.sliding.joints)
            driver = missing(effect, motion, loads_known)
            if driver is not None:
                raise InputError(f"{effect.label}: needs the {driver.phrase}: give {driver.remedy}")

    def alter(self, values: JaxArray, motion: Motion) -> Motion:
        """The true motion, by the effects of the clock and of the payload."""
        for effect, part in self.pairs:
            if isinstance(effect, Altering):
                motion = effect.alter(values[part], motion)
        return motion

    def alter_inertia(self, values: JaxArray, inertia: Inertia) -> Inertia:
        """The true masses and gravity, by the effects of the payload and of gravity."""
        for effect, part in self.pairs:
            if isinstance(effect, Loading):
                inertia = effect.alter_inertia(values[part], inertia)
        return inertia

    def deflect(self, values: JaxArray, motion: Motion, loads: Loads | None) -> Deflection:
        """The sum of all deflections in a motion returned by `alter`."""
        total = Deflection()
        for effect, part in self.pairs:
            if isinstance(effect, Bending):
                total = total + effect.deflect(values[part], motion, loads)
        return total

    def beyond(self, values: JaxArray, motion: Motion) -> JaxArray:
        """`(sample,)` bool: rows whose prediction requires the motion beyond the ends of its run, by a clock offset."""
        outside = jnp.zeros(motion.samples, bool)
        for effect, part in self.pairs:
            if isinstance(effect, Altering):
                outside = outside | effect.beyond(values[part], motion)
        return outside

    def reported(self, values: ArrayLike, covariance: ArrayLike | None = None) -> list[dict[str, Estimate]]:
        """The parameters of each effect with their standard deviations.

        Args:
            values: `(size,)`.
            covariance: `(size, size)`, of all coordinates.
        """
        values = np.asarray(values, float)
        C = None if covariance is None else np.asarray(covariance, float)
        return [effect.reported(values[part], None if C is None else C[part, part]) for effect, part in self.pairs]


def missing(effect: Effect, motion: Motion, loads_known: bool) -> Driver | None:
    """The first driver of an effect that a motion lacks, so that the effect cannot be tested; or None."""
    for driver in effect.drivers:
        if not (loads_known if driver.loaded else driver.known(motion, None)):
            return driver
    return None
