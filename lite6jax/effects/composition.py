"""Several effects at once: their numbers in one vector, their deflections added up."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import final

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike, NDArray

from lite6jax.effects.deflection import Deflection
from lite6jax.effects.effect import Altering, Bending, Effect, Estimate
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Loads
from lite6jax.errors import InputError


@final
@dataclass(frozen=True)
class Physics:
    """What the arm does beyond its rigid model. Hashable: a static argument of `jax.jit`.

    The numbers of all effects stand one after the other in `values` `(size,)`; zero is neutral.

    Attributes:
        effects: in any order: it does not matter; the same one may come twice, as two harmonics of one joint do.
    """

    effects: tuple[Effect, ...] = ()

    @cached_property
    def size(self) -> int:
        """How many numbers."""
        return sum(effect.size for effect in self.effects)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """`joint_compliance:joint2:compliance_rad_per_Nm` …; the second of one label is `…:joint2#2:…`."""
        seen: Counter[str] = Counter()
        names = []
        for effect in self.effects:
            seen[effect.label] += 1
            label = effect.label + (f"#{seen[effect.label]}" if seen[effect.label] > 1 else "")
            names += [f"{label}:{coordinate.name}" for coordinate in effect.coordinates]
        return tuple(names)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """The unit of each number."""
        return tuple(coordinate.unit for effect in self.effects for coordinate in effect.coordinates)

    @cached_property
    def typical(self) -> NDArray:
        """`(size,)`, the size of each number in real arms."""
        return np.array([coordinate.typical for effect in self.effects for coordinate in effect.coordinates])

    @cached_property
    def prior(self) -> NDArray:
        """`(size,)`, one standard deviation of each number about neutral, as known beforehand."""
        return np.array([coordinate.spread for effect in self.effects for coordinate in effect.coordinates])

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Where each effect's numbers stand."""
        ends = np.cumsum([0] + [effect.size for effect in self.effects]).tolist()
        return tuple(slice(start, end) for start, end in pairwise(ends))

    @property
    def loaded(self) -> bool:
        """Whether an effect depends on gravity's loads."""
        return any(isinstance(e, Bending) and any(driver.loaded for driver in e.drivers) for e in self.effects)

    @property
    def altering(self) -> tuple[Altering, ...]:
        """The effects of clock and payload, which change the motion and its loads."""
        return tuple(effect for effect in self.effects if isinstance(effect, Altering))

    def join(self, values: Sequence[ArrayLike]) -> NDArray:
        """`(size,)` from the values of each effect."""
        return np.concatenate([np.zeros(0), *(np.asarray(value, float) for value in values)])

    def part(self, values: NDArray, kept: Sequence[bool]) -> "tuple[Physics, NDArray]":
        """Some of the effects, and of `values` `(size,)` theirs.

        Args:
            values: of all effects.
            kept: of each effect, whether it stays.
        """
        rest = [
            (effect, values[at]) for effect, at, stays in zip(self.effects, self.slices, kept, strict=True) if stays
        ]
        physics = Physics(tuple(effect for effect, _ in rest))
        return physics, physics.join([value for _, value in rest])

    def check(self, motion: Motion, loads_known: bool) -> None:
        """Refuses a motion that lacks what an effect needs.

        Args:
            motion: only what it has and the number of its joints matter.
            loads_known: whether masses or loads are given.

        Raises:
            InputError: by name, the effect, what it needs and how to record it; or a joint that the arm has not.
        """
        for effect in self.effects:
            if effect.joints_needed > motion.dof:
                raise InputError(
                    f"{effect.label}: concerns joint {effect.joints_needed}, and the arm has {motion.dof}; choose one "
                    "of those"
                )
            reason = missing(effect, motion, loads_known)
            if reason is not None:
                raise InputError(f"{effect.label}: {reason}")

    def alter(self, values: Array, motion: Motion) -> Motion:
        """The motion as it really was, by the effects of clock and payload."""
        for effect, part in zip(self.effects, self.slices, strict=True):
            if isinstance(effect, Altering):
                motion = effect.alter(values[part], motion)
        return motion

    def deflect(self, values: Array, motion: Motion, loads: Loads | None) -> Deflection:
        """The sum of all deflections in a motion that `alter` has been through."""
        total = Deflection()
        for effect, part in zip(self.effects, self.slices, strict=True):
            if isinstance(effect, Bending):
                total = total + effect.deflect(values[part], motion, loads)
        return total

    def beyond(self, values: Array, motion: Motion) -> Array:
        """`(sample,)` bool: the rows for which the motion holds too little, a clock's beyond the ends of a run."""
        outside = jnp.zeros(motion.samples, bool)
        for effect, part in zip(self.effects, self.slices, strict=True):
            if isinstance(effect, Altering):
                outside = outside | effect.beyond(values[part], motion)
        return outside

    def reported(self, values: ArrayLike, covariance: ArrayLike | None = None) -> list[dict[str, Estimate]]:
        """Each effect's parameters with standard deviations.

        Args:
            values: `(size,)`.
            covariance: `(size, size)` of all numbers.
        """
        values = np.asarray(values, float)
        C = None if covariance is None else np.asarray(covariance, float)
        return [
            effect.reported(values[part], None if C is None else C[part, part])
            for effect, part in zip(self.effects, self.slices, strict=True)
        ]


def missing(effect: Effect, motion: Motion, loads_known: bool) -> str | None:
    """Why a motion cannot show an effect, in words, or None: the first driver that is not known."""
    for driver in effect.drivers:
        if not (loads_known if driver.loaded else driver.known(motion, None)):
            return f"needs the {driver.phrase}: give {driver.remedy}"
    return None
