"""How poses change with the numbers of effects: the deflections that they cause, and the columns of the residuals.

Unit deflections are those of an arm in one motion, per unit of each number of an effect. The columns are their products
with those of every site. Nonparametric effects act on components of sites, each over quantities that vary.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np

from lite6jax.arms.chains import Form, joint_motion
from lite6jax.array_types import Array
from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.composition import Physics
from lite6jax.effects.deflection import Deflection, place_of
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.effect import Altering, Bending, Effect, Loading
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import COMPONENTS, SCALE, Unnamed
from lite6jax.effects.statics import Inertia, Loads, loads, with_mass_errors
from lite6jax.estimation.problem import Component, DriverValues
from lite6jax.estimation.terms import Terms

_STEP = 1e-2
"""Of a number's typical size: the step of difference quotients of loads."""
_NEAR = 3
"""Joints next to the base, and next to the tool, on whose motion these depend as well."""
_WHOLE_ARM = ("temperature rise", "time", "payload")
_SIGHT = tuple(f"measured position{end}" for end in (" x", " y", " z", "'s distance", "'s azimuth", "'s elevation"))
_LEAST_VARIED = 1e-6
"""Range of a driver, in its unit, below which it did not vary."""


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
        inertia = self.inertia
        errors = errors or self.errors or self._exact
        if physics is not None and any(isinstance(effect, Loading) for effect in physics.effects):
            # an effect alters the masses as they are
            inertia = _with_mass_errors(inertia, errors.links)
            errors = errors._replace(links=self._exact.links)
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

        That of a nonparametric effect is not kept: of a real arm they have thousands of coefficients, each of which
        moves one of many sites. Their bases are kept.
        """
        if isinstance(effect, Unnamed):
            return effect.units(self.basis(effect), self.host_motion)
        cache = self._cache(effect)
        if effect not in cache:
            if effect.linear:
                assert isinstance(effect, Bending)
                # on the host, one evaluation a number: traces of a hundred candidates would take seconds
                deflections = (effect.deflect(step, self.host_motion, self.loads) for step in np.eye(effect.size))  # type: ignore[arg-type]
                cache[effect] = _stacked(deflections)
            else:
                cache[effect] = self.slope(effect, np.zeros(effect.size))
        return cache[effect]

    def basis(self, effect: Unnamed) -> Array:
        """The functions `(function, sample)` that coefficients of a nonparametric effect multiply; computed once."""
        cache = self._cache(effect)
        key = effect.process
        if key not in cache:
            values = effect.values_at(self.host_motion, self.loads)
            cache[key] = np.asarray(effect.functions_at(values, self.host_motion.run))
        return cache[key]

    def _cache(self, effect: Effect) -> dict[Hashable, Any]:
        if any(driver.loaded for driver in effect.drivers):
            return self._loaded
        return self.units

    def by_linear(self, effect: Effect, values: Array) -> Deflection:
        """The deflection by a linear effect with these numbers `(number,)`."""
        if isinstance(effect, Unnamed):
            return effect.by_functions(values, self.basis(effect), self.host_motion)  # type: ignore[arg-type]
        parts = (None if part is None else np.tensordot(values, part, 1) for part in self.unit(effect))
        return Deflection(*parts)  # type: ignore[arg-type]

    def slope(self, effect: Effect, values: Array) -> Deflection:
        """The derivative of an effect's deflection by each of its numbers, at `values` `(number,)`."""
        at = jnp.asarray(values)
        steps = jnp.eye(len(values))

        def deflected(v: jax.Array) -> Deflection:
            if isinstance(effect, Altering):  # by the joint positions; the change of the loads is of second order
                return Deflection(joint=self.altered(partial(effect.alter, v)).joint_position)
            assert isinstance(effect, Bending)
            return effect.deflect(v, self.motion, self.loads)

        return jax.tree.map(np.asarray, jax.vmap(lambda step: jax.jvp(deflected, (at,), (step,))[1])(steps))

    def by_each(self, effect: Effect, at: Array, beside: Physics, values: Array) -> Deflection:
        """How deflections change with each number of an effect at `at` `(number,)`, among effects `(beside.size,)`."""
        if isinstance(effect, Loading):
            return self.through_loads(effect, at, beside, values)
        if effect.linear or not at.any():
            return self.unit(effect)
        return self.slope(effect, at)

    def through_loads(self, effect: Loading, at: Array, effects: Physics, values: Array) -> Deflection:
        """How the deflections that loads cause change with each number of an effect that alters the loads.

        Args:
            effect: which.
            at: `(number,)`, where its numbers are.
            effects: beside it; those that depend on loads deflect the arm, and further ones alter the loads as well.
            values: `(effects.size,)`.
        """
        pairs = [(term, np.asarray(values)[part]) for term, part in effects.pairs]
        bending = [pair for pair in pairs if isinstance(pair[0], Bending) and any(d.loaded for d in pair[0].drivers)]
        if not bending:
            return Deflection(scale=np.zeros((effect.size, self.motion.samples)))  # type: ignore[arg-type]
        loadings = [(term, numbers) for term, numbers in pairs if isinstance(term, Loading) and term != effect]
        physics = Physics((effect, *(term for term, _ in loadings)))

        def deflected(numbers: Array) -> Deflection:
            all_numbers = physics.join([numbers, *(loading_numbers for _, loading_numbers in loadings)])
            motion = physics.alter(all_numbers, self.host_motion)  # type: ignore[arg-type]
            on_arm = self.loads_in(motion, physics, all_numbers)
            total = Deflection()
            for term, its_numbers in bending:
                total = total + term.deflect(its_numbers, motion, on_arm)  # type: ignore[arg-type]
            return total

        # loads are linear in masses and gravity, and deflections in loads except for curves, plays and steps
        steps = np.diag([_STEP * number.typical for number in effect.coordinates])
        return _stacked(_quotient(deflected(at - step), deflected(at + step), step.sum()) for step in steps)

    def through_masses(self, masses: Sequence[Site], effects: Physics, values: Array) -> Deflection:
        """How the deflections that loads cause change with errors of masses, `(number, …)`.

        Difference quotients, exact for what is proportional to the loads.

        Args:
            masses: the sites of these errors.
            effects: those that depend on loads deflect the arm.
            values: `(effects.size,)`.
        """
        total = Deflection(scale=np.zeros((len(masses), self.motion.samples)))  # type: ignore[arg-type]
        for effect, part in effects.pairs:
            if isinstance(effect, Bending) and any(driver.loaded for driver in effect.drivers):
                deflected = partial(effect.deflect, values[part], self.host_motion)  # type: ignore[arg-type]
                pairs = self._loads_by_mass(tuple(masses))
                total = total + _stacked(_quotient(deflected(less), deflected(more), _STEP) for less, more in pairs)
        return total

    def _loads_by_mass(self, masses: tuple[Site, ...]) -> list[tuple[Loads | None, Loads | None]]:
        """For each mass the loads where it is less by `_STEP` and where it is more; computed once."""
        if self.inertia is None:
            return [(None, None)] * len(masses)
        if masses not in self._loaded:
            steps = [sign * _STEP * unit for unit in np.eye(len(masses)) for sign in (-1, 1)]
            errors = (mass_errors(masses, step, len(self.kinematics), self.errors) or self._exact for step in steps)
            loads = [self.loads_in(self.motion, errors=mass_error) for mass_error in errors]
            self._loaded[masses] = [*zip(loads[::2], loads[1::2], strict=True)]
        return self._loaded[masses]

    @cached_property
    def host_motion(self) -> Motion:
        """The motion as NumPy arrays."""
        return jax.tree.map(np.asarray, self.motion)

    @cached_property
    def _loaded(self) -> dict[Hashable, Any]:
        return {}


def _stacked(deflections: Iterable[Deflection]) -> Deflection:
    """The deflections by several numbers, `(number, …)`."""
    parts = zip(*deflections, strict=True)
    return Deflection(*(None if part[0] is None else np.stack(part) for part in parts))  # type: ignore[arg-type]


def _quotient(less: Deflection, more: Deflection, step: float) -> Deflection:
    """The central difference quotient of two deflections, at a step less and a step more."""
    pairs = zip(less, more, strict=True)
    return Deflection(*(None if a is None or b is None else (b - a) / (2 * step) for a, b in pairs))


_with_mass_errors = jax.jit(with_mass_errors)


@partial(jax.jit, static_argnums=0)
def _loads(form: Form, kinematics: jax.Array, motion: Motion, inertia: Inertia, errors: MassErrors) -> Loads:
    """The loads on an arm whose masses are off by some errors."""
    position = motion.joint_position
    velocity = motion.joint_velocity
    acceleration = motion.joint_acceleration
    payload = motion.payload + errors.payload
    inertia = with_mass_errors(inertia, errors.links)
    return loads(form, kinematics, joint_motion(form, position), payload, inertia, velocity, acceleration)


def physics_of(terms: Terms) -> Physics:
    """The effects that are the terms of a pose problem."""
    return Physics(tuple(term for term in terms.terms if isinstance(term, Effect)))


def columns_of(unit: Deflection, sites: dict[Site, Array]) -> Array:
    """The columns `(number, row, sample)` of unit deflections, from those of every site."""
    size = next(len(part) for part in unit if part is not None)
    out = np.zeros((size, *sites["scale", 0, 0].shape))
    for name, part in zip(Deflection._fields, unit, strict=True):
        if part is None:
            continue
        # by number, and by place and component of a twist: what the field has of them
        twisted = 6 if name in ("base", "link", "tool", "sensor") else 1
        shapes = np.asarray(part).reshape(size, -1, twisted, part.shape[-1])
        for number, j, k in zip(*np.nonzero(shapes.any(-1)), strict=True):
            out[number] += sites[name, int(j), int(k)] * shapes[number, j, k]
    return out


def components(sites: dict[Site, Array], motion: Motion, rows: int) -> tuple[Component, ...]:
    """The components that a sensor sees, those of joints first: of equals the first is chosen.

    A turn of a link about its joint's axis is an angle of the joint.

    Args:
        sites: `(row, sample)`, how residuals change with a deflection at each site.
        motion: of the arm.
        rows: 3, or 6 where orientations are measured.
    """
    dof = motion.dof
    pairs = [(f"joint{j + 1}", "rz") for j in range(dof) if not motion.sliding.mask(dof)[j]]
    pairs += [(f"link{j + 1}", component) for j in range(dof) if dof > 1 for component in COMPONENTS[:5]]
    pairs += [("base", component) for component in COMPONENTS[:6]] + [
        ("tool", component) for component in COMPONENTS[:rows]
    ]
    pairs += [("sensor", component) for component in (*COMPONENTS[:6], SCALE)]
    columns = ((where, component, sites[site_of(where, component)]) for where, component in pairs)
    return tuple(Component(where, component, column) for where, component, column in columns if column.any())


def quantities(motion: Motion, loads: Loads | None) -> tuple[DriverValues, ...]:
    """The drivers that are known and vary, each with the sites whose own it is.

    Args:
        motion: time-shifted.
        loads: on the rigid arm, or None.
    """
    varied = []
    for driver, sites, only in _drivers(motion):
        if not driver.known(motion, loads):
            continue
        values = np.asarray(driver.values(motion, loads), float)
        if np.ptp(values) > _LEAST_VARIED and np.isfinite(values).all():
            varied.append(DriverValues(driver, values, sites, only))
    return tuple(varied)


def _drivers(motion: Motion) -> Iterator[tuple[Driver, frozenset[str], str]]:
    """All drivers, the sites whose own each is (all of them where that is `""`), and the one site where it can act."""
    dof = motion.dof
    slides = motion.sliding.mask(motion.dof)
    rise = motion.joint_temperature_rise
    apart = rise is not None and np.ptp(np.asarray(rise), 0).any()  # else that of the whole arm would be there twice
    for j in range(1, dof + 1):
        joint_sites = {f"joint{j}", f"link{j}"}
        last = {"tool"} if j == dof else set()
        ends = ({"base"} if j <= _NEAR else set()) | ({"tool"} if j > dof - _NEAR else set())
        moved: Callable[[str], Driver] = lambda quantity, j=j: joint_driver(quantity, j, bool(slides[j - 1]))  # noqa: E731
        for driver in (moved("position"), moved("velocity"), Driver("direction of motion", j)):
            yield driver, frozenset(joint_sites | ends), ""
        yield moved("gravity torque"), frozenset(joint_sites | last), ""
        for axis in "xy":
            yield Driver(f"gravity moment {axis}", j), frozenset({f"link{j}"} | last), ""
        if apart:
            yield Driver("temperature", j), frozenset(joint_sites | {f"link{j - 1}"}), ""
    for axis in "xy":
        yield Driver(f"base moment {axis}"), frozenset({"base", "sensor"}), ""
    for quantity in _WHOLE_ARM:
        yield Driver(quantity), frozenset({""}), ""
    for quantity in _SIGHT:
        yield Driver(quantity), frozenset({"sensor"}), "sensor"
    yield Driver("order of recording"), frozenset(f"joint{j + 1}" for j in np.flatnonzero(~slides)), ""


def site_of(where: str, component: str) -> Site:
    """The key of the site at which a component of a nonparametric effect acts; at a joint there is but one."""
    if component == SCALE:
        return SCALE, 0, 0
    kind, number = place_of(where)
    return kind, max(number - 1, 0), 0 if kind == "joint" else COMPONENTS.index(component)
