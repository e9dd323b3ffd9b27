"""Unit deflections: the deflections of an arm in one motion, per unit of each number of an effect."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from operator import itemgetter
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.chains import Form, joint_motion
from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.composition import Physics
from lite6jax.effects.deflection import Deflection
from lite6jax.effects.effect import Altering, Bending, Effect, Loading
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.statics import Inertia, Loads, loads, with_mass_errors

Array = NDArray[np.floating]
_STEP = 1e-2
"""Of a number's typical size: the step of difference quotients of loads."""


class MassErrors(NamedTuple):
    """By how much the masses differ from those declared.

    Attributes:
        links: `(joint, 4)`, as `with_mass_errors` takes it.
        payload: kg.
    """

    links: Array
    payload: float


def mass_errors(sites: Sequence[Site], values: Array, dof: int, beside: MassErrors | None = None) -> MassErrors | None:
    """The errors of masses among the values of sites, added to those `beside`; None where all are zero."""
    links, payload = (np.zeros((dof, 4)), 0.0) if beside is None else (beside.links.copy(), beside.payload)
    for (name, j, k), value in zip(sites, values, strict=True):
        if name == "mass":
            links[j, k] += value
        elif name == "payload":
            payload += float(value)
    return MassErrors(links, payload) if links.any() or payload else None


@final
@dataclass(frozen=True, eq=False)
class Deflections:
    """The deflections by effects in one motion of an arm.

    Attributes:
        kinematics: `(joint, 6)` of the arm on which the loads act.
        inertia: the arm's masses, or None where they are not known.
        motion: of the joints.
        altered: of a function of motions, what it returns for the declared motion, at the rows of `motion`.
        units: of effects that do not depend on loads their unit deflections, and of functions without a name their
            bases; arms of another geometry share them.
        errors: of the masses and the payload, if any.
    """

    kinematics: Array
    inertia: Inertia | None
    motion: Motion
    altered: Callable[[Callable[[Motion], Motion]], Motion]
    units: dict[Hashable, Any] = field(default_factory=dict)
    errors: MassErrors | None = None

    @cached_property
    def loads(self) -> Loads | None:
        """The loads of gravity, and of acceleration where the motion has it; None where the masses are not known."""
        return self.loads_in(self.motion)

    def loads_in(
        self,
        motion: Motion,
        physics: Physics | None = None,
        values: Array | None = None,
        errors: MassErrors | None = None,
    ) -> Loads | None:
        """The loads in another motion of the same arm, whose masses and gravity some effects alter, on the host.

        Args:
            motion: as altered by these effects.
            physics: effects, if any.
            values: `(physics.size,)`.
            errors: of the masses and the payload, instead of the arm's own.
        """
        if self.inertia is None:
            return None
        inertia, errors = self.inertia, errors or self.errors or self._exact
        if physics is not None and any(isinstance(effect, Loading) for effect in physics.effects):
            # an effect alters the masses as they are
            inertia, errors = _with_mass_errors(inertia, errors.links), errors._replace(links=self._exact.links)
            inertia = physics.alter_inertia(np.asarray(values, float), inertia)  # type: ignore[arg-type]
        return jax.tree.map(np.asarray, _loads(motion.chain, self.kinematics.ravel(), motion, inertia, errors))

    @property
    def _exact(self) -> MassErrors:
        """Masses as declared."""
        return MassErrors(np.zeros((len(self.kinematics), 4)), 0.0)

    def altered_motion(self, physics: Physics, values: Array) -> Motion:
        """The motion as effects of the clock and of the loads alter it, on the host."""
        shifting = [isinstance(e, Altering) and not isinstance(e, Loading) for e in physics.effects]
        motion = self.host_motion
        if any(shifting):
            clock, offsets = physics.part(values, shifting)
            motion = jax.tree.map(np.asarray, self.altered(partial(clock.alter, jnp.asarray(offsets))))
        loading, numbers = physics.part(values, [isinstance(effect, Loading) for effect in physics.effects])
        return loading.alter(numbers, motion)  # type: ignore[arg-type]

    def unit(self, effect: Effect) -> Deflection:
        """The deflection per unit of each number of an effect at zero, `(number, …)`; computed once.

        That of a function without a name is not kept: of a real arm they have thousands of coefficients, each of which
        moves one of many sites. Their bases are kept.
        """
        if isinstance(effect, Unnamed):
            return effect.units(self.basis(effect), self.host_motion)
        cache = self._cache(effect)
        if effect not in cache:
            if effect.linear:
                assert isinstance(effect, Bending)
                # on the host, one evaluation a number: traces of a hundred candidates would take seconds
                each = [effect.deflect(step, self.host_motion, self.host_loads) for step in np.eye(effect.size)]  # type: ignore[arg-type]
                parts = zip(*each, strict=True)
                cache[effect] = Deflection(*(None if p[0] is None else np.stack(p) for p in parts))  # type: ignore[arg-type]
            else:
                cache[effect] = self.slope(effect, np.zeros(effect.size))
        return cache[effect]

    def basis(self, effect: Unnamed) -> Array:
        """The functions `(function, sample)` that coefficients of an effect without a name multiply; computed once."""
        cache, key = self._cache(effect), effect.process
        if key not in cache:
            cache[key] = self._functions(effect, self.host_loads)
        return cache[key]

    def _functions(self, effect: Unnamed, on_arm: Loads | None) -> Array:
        """The functions of an effect without a name under some loads, `(function, sample)`."""
        return np.asarray(effect.functions_at(effect.values_at(self.host_motion, on_arm), self.host_motion.run))

    def by_linear(self, effect: Effect, values: Array) -> Deflection:
        """The deflection by a linear effect with these numbers `(number,)`."""
        if isinstance(effect, Unnamed):
            return effect.by_functions(values, self.basis(effect), self.host_motion)  # type: ignore[arg-type]
        parts = (None if part is None else np.tensordot(values, part, 1) for part in self.unit(effect))
        return Deflection(*parts)  # type: ignore[arg-type]

    def _cache(self, effect: Effect) -> dict[Hashable, Any]:
        return self._loaded if any(driver.loaded for driver in effect.drivers) else self.units

    def slope(self, effect: Effect, values: Array) -> Deflection:
        """The derivative of an effect's deflection by each of its numbers, at `values` `(number,)`."""
        at, steps = jnp.asarray(values), jnp.eye(len(values))

        def deflected(v: jax.Array) -> Deflection:
            if isinstance(effect, Altering):  # by the joint positions; the change of the loads is of second order
                return Deflection(joint=self.altered(partial(effect.alter, v)).joint_position)
            assert isinstance(effect, Bending)
            return effect.deflect(v, self.motion, self.loads)

        return _host(jax.vmap(lambda step: jax.jvp(deflected, (at,), (step,))[1])(steps))

    def through_loads(self, effect: Loading, at: Array, effects: Physics, values: Array) -> Deflection:
        """How the deflections that loads cause change with each number of an effect that alters the loads.

        Args:
            effect: which.
            at: `(number,)`, where its numbers are.
            effects: beside it; those that depend on loads deflect the arm, and further ones alter the loads as well.
            values: `(effects.size,)`.
        """
        pairs = [(one, np.asarray(values)[part]) for one, part in zip(effects.effects, effects.slices, strict=True)]
        bending = [
            (one, numbers)
            for one, numbers in pairs
            if isinstance(one, Bending) and any(driver.loaded for driver in one.drivers)
        ]
        if not bending:
            return Deflection(scale=np.zeros((effect.size, self.motion.samples)))  # type: ignore[arg-type]
        others = [(one, numbers) for one, numbers in pairs if isinstance(one, Loading) and one != effect]
        physics = Physics((effect, *(one for one, _ in others)))

        def deflected(numbers: Array) -> Deflection:
            every = physics.join([numbers, *(rest for _, rest in others)])
            motion = physics.alter(every, self.host_motion)  # type: ignore[arg-type]
            on_arm, total = self.loads_in(motion, physics, every), Deflection()
            for one, its_numbers in bending:
                total = total + one.deflect(its_numbers, motion, on_arm)  # type: ignore[arg-type]
            return total

        # loads are linear in masses and gravity, and deflections in loads except for curves, plays and steps
        slopes = []
        for step in np.diag([_STEP * number.typical for number in effect.coordinates]):
            less, more = deflected(at - step), deflected(at + step)
            pairs = zip(less, more, strict=True)
            slopes.append([None if a is None or b is None else (b - a) / (2 * step.sum()) for a, b in pairs])
        parts = zip(*slopes, strict=True)
        return Deflection(*(None if part[0] is None else np.stack(part) for part in parts))  # type: ignore[arg-type]

    def through_masses(self, masses: Sequence[Site], effects: Physics, values: Array) -> Deflection:
        """How the deflections that loads cause change with errors of masses, `(number, …)`.

        Args:
            masses: the sites of these errors.
            effects: those that depend on loads deflect the arm.
            values: `(effects.size,)`.
        """
        total = Deflection(scale=np.zeros((len(masses), self.motion.samples)))  # type: ignore[arg-type]
        for effect, part in zip(effects.effects, effects.slices, strict=True):
            if not isinstance(effect, Bending) or not any(driver.loaded for driver in effect.drivers):
                continue
            total = total + self._by_masses(masses, effect, values[part])
        return total

    def _by_masses(self, masses: Sequence[Site], effect: Bending, values: Array) -> Deflection:
        """Difference quotients, exact for what is proportional to the loads."""
        slopes = []
        for less, more, step in self._heavier(tuple(masses)):
            pair = (effect.deflect(values, self.host_motion, on_arm) for on_arm in (less, more))  # type: ignore[arg-type]
            slopes.append([None if a is None else (b - a) / (2 * step) for a, b in zip(*pair, strict=True)])
        parts = zip(*slopes, strict=True)
        return Deflection(*(None if part[0] is None else np.stack(part) for part in parts))  # type: ignore[arg-type]

    def _heavier(self, masses: tuple[Site, ...]) -> list[tuple[Loads | None, Loads | None, float]]:
        """For each mass the loads where it is smaller and where it is larger, and the step in its error."""
        if masses not in self._with_errors:
            self._with_errors[masses] = self._loads_by_mass(masses)
        return self._with_errors[masses]

    def _loads_by_mass(self, masses: tuple[Site, ...]) -> list[tuple[Loads | None, Loads | None, float]]:
        if self.inertia is None:
            return [(None, None, _STEP)] * len(masses)
        steps = [sign * _STEP * one for one in np.eye(len(masses)) for sign in (-1, 1)]
        dof = len(self.kinematics)
        errors = [mass_errors(masses, step, dof, self.errors) or self._exact for step in steps]
        stacked = MassErrors(np.stack([one.links for one in errors]), np.array([one.payload for one in errors]))  # type: ignore[arg-type]
        of_each = _loads_of_each(self.motion.chain, self.kinematics.ravel(), self.motion, self.inertia, stacked)
        found = jax.tree.map(np.asarray, of_each)
        each = [jax.tree.map(itemgetter(k), found) for k in range(len(steps))]
        return [(less, more, _STEP) for less, more in zip(each[::2], each[1::2], strict=True)]

    @cached_property
    def _with_errors(self) -> dict[tuple[Site, ...], list[tuple[Loads | None, Loads | None, float]]]:
        return {}

    @cached_property
    def host_motion(self) -> Motion:
        """The motion as NumPy arrays."""
        return jax.tree.map(np.asarray, self.motion)

    @cached_property
    def host_loads(self) -> Loads | None:
        return None if self.loads is None else jax.tree.map(np.asarray, self.loads)

    @cached_property
    def _loaded(self) -> dict[Hashable, Any]:
        return {}


def _host(deflection: Deflection) -> Deflection:
    return Deflection(*(None if part is None else np.asarray(part) for part in deflection))  # type: ignore[arg-type]


_with_mass_errors = jax.jit(with_mass_errors)


@partial(jax.jit, static_argnums=0)
def _loads(form: Form, kinematics: jax.Array, motion: Motion, inertia: Inertia, errors: MassErrors) -> Loads:
    """The loads on an arm whose masses are off by some errors."""
    position, velocity, acceleration = motion.joint_position, motion.joint_velocity, motion.joint_acceleration
    payload, inertia = motion.payload + errors.payload, with_mass_errors(inertia, errors.links)
    return loads(form, kinematics, joint_motion(form, position), payload, inertia, velocity, acceleration)


@partial(jax.jit, static_argnums=0)
def _loads_of_each(form: Form, kinematics: jax.Array, motion: Motion, inertia: Inertia, errors: MassErrors) -> Loads:
    """Those of several errors, each part of them `(case, …)`, in turn: of many rows they take much memory."""
    return jax.lax.map(lambda one: _loads(form, kinematics, motion, inertia, one), errors)
