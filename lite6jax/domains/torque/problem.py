"""Measured torques as an estimation problem: one arm, its inertial numbers, and the columns of effects on torques."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain
from typing import TYPE_CHECKING, final

import numpy as np

from lite6jax.arms.arm import as_revolute
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.torque.predict import (
    delayed,
    offsets_of,
    pairs,
    read_driver,
    scales_of,
    slope_of_delayed,
    slopes,
)
from lite6jax.domains.torque.rows import TorqueRows
from lite6jax.effects.catalogue import Untestable, resolved_speeds, torque_catalogue, torque_shaped, untestable
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.dynamic import (
    DIRECTION_SPEED,
    CoulombFriction,
    Delaying,
    Dynamics,
    JointTorque,
    LinkCom,
    LinkInertia,
    LinkMass,
    PayloadBody,
    PayloadTorque,
    Scaling,
    StribeckFriction,
    TorqueEffect,
    TorqueRipple,
    UnnamedTorque,
    declared,
    inertial_limits,
    point_mass,
)
from lite6jax.effects.effect import require_kind, wave_angle
from lite6jax.errors import InputError
from lite6jax.estimation.problem import Component, DriverValues, PeriodicFamily
from lite6jax.estimation.terms import Term, Terms
from lite6jax.fields import field_values

# type checkers do not accept a cached property where a protocol declares a property
lazy = property if TYPE_CHECKING else cached_property

FITTED = (LinkMass, LinkCom, LinkInertia, PayloadBody)
"""Effects that are confounded with inertial numbers that are fitted."""
_HEAVY = (LinkMass, LinkCom, PayloadTorque, PayloadBody)
"""Effects that weigh something at rest too."""
_MOVING = ("velocity", "speed", "direction of motion", "acceleration", "travel since reversal")
"""Drivers that postures at rest do not have."""
_ASSUMED = 0.02
"""Of a joint's torque: the noise that is assumed where none is declared; its scale is estimated in any case."""
_UNKNOWN_MASS = 3.0
_UNKNOWN_LEVER = 0.1
"""kg and m, of links about which nothing is declared."""
_HIGHEST = 1000.0
"""Waves along the stroke of a prismatic joint that are searched at most: a screw's lead of 1 mm on a metre."""
_FEWEST = 2.0
"""Waves along the stroke that pass the filter at least where any are searched: fewer are any function of it."""
_SLOW = 0.2
"""Quantile of the speeds of a prismatic joint that moves at which the shortest wave still passes the filter."""
_MOST_WAVES = 1 << 22
"""Numbers of waves that are kept: 32 MB."""
_QUANTITIES = ("position", "velocity", "speed", "direction of motion", "gravity torque", "travel since reversal")
"""Of each joint, beside its temperature."""
_OWN_ALONE = ("speed", "travel since reversal")
"""Quantities on which the torque of another joint does not depend."""
_LEAST_VARIED = 1e-3
"""Range of a driver, in its unit, or that of a revolute joint, below which it did not vary."""


@final
@dataclass(frozen=True, eq=False)
class TorqueCache:
    """What has been computed of some samples: folds of a cross-validation differ in the training mask alone.

    Attributes:
        units: filtered `unit_torques` of linear effects, and of processes, at some inertial numbers.
        everywhere: the same, of every sample.
        slopes: filtered `slopes` of the effects that are not linear, at zero and at the latest numbers.
        waves: filtered sine and cosine `(2, sample)` by joint, from 1, and order.
        thinned: of one in so many of the samples.
    """

    units: dict[Hashable, Array] = field(default_factory=dict)
    everywhere: dict[Hashable, Array] = field(default_factory=dict)
    slopes: dict[Hashable, tuple[bytes, Array]] = field(default_factory=dict)
    waves: dict[tuple[int, float], Array] = field(default_factory=dict)
    thinned: dict[int, "TorqueCache"] = field(default_factory=dict)

    def of_every(self, decimation: int) -> "TorqueCache":
        """The cache of one in `decimation` samples."""
        return self.thinned.setdefault(decimation, TorqueCache(everywhere=self.everywhere))

    def at_other_links(self) -> "TorqueCache":
        """What does not depend on inertial numbers."""
        thinned = {n: cached.at_other_links() for n, cached in list(self.thinned.items())}
        return TorqueCache(waves=self.waves, thinned=thinned)

    def __reduce__(self) -> tuple[type["TorqueCache"], tuple[()]]:
        """Another process computes it anew, which is faster than to send it."""
        return TorqueCache, ()


@final
@dataclass(frozen=True, eq=False)
class TorqueProblem:
    """A torque recording; `estimation.problem.Problem` describes the members it shares. A sample is one that is kept.

    Torques are linear in all numbers but a few of single effects, so that nothing is linearised but the part that
    effects of the load take from the inertial numbers.

    Attributes:
        data: the recording, filtered.
        chosen: `(sample,)`, which of the samples that the filter keeps.
        links: `(joint, 10)`, inertial numbers of the linearisation.
        directions: `(number, joint, 10)`, the nuisance: changes of inertial numbers.
        precision: `(number,)`, one over the variance of their prior.
        offset: `(number,)`, from the prior's mean to `links`.
        noise: `(joint,)` Nm, one sigma as declared or assumed.
        declared: whether the sidecar declares it.
        candidates: effects that are testable with this recording.
        untestable: those that are not, and why.
        valid: `(sample,)`, those that may be used at all.
        known: what has been computed of these samples, shared between the problems that have them.
    """

    data: TorqueRows
    chosen: Integers
    links: Array
    directions: Array
    precision: Array
    offset: Array
    noise: Array
    declared: bool
    candidates: tuple[TorqueEffect, ...]
    untestable: tuple[Untestable, ...]
    valid: Mask
    known: TorqueCache = field(default_factory=TorqueCache)

    def __getstate__(self) -> dict[str, object]:
        """What another process is sent: the fields, of which `data` has the regressor, and nothing that is cached."""
        return field_values(self)

    @property
    def rows(self) -> int:
        """One a joint."""
        return len(self.noise)

    @property
    def samples(self) -> int:
        """Number of samples that are kept."""
        return len(self.chosen)

    @cached_property
    def sigma(self) -> Array:
        """`(joint, sample)` Nm: as `stated`, and friction where the direction of motion is not known."""
        return self._with(self.stated, self.data.turning)

    @cached_property
    def stated(self) -> Array:
        """`(joint, sample)` Nm: the noise, and what data faults say of single samples, as of a joint held at rest."""
        return self._with(self.noise[:, None] * np.ones(self.samples), self.data.slack)

    def _with(self, sigma: Array, more: Array | None) -> Array:
        """Standard deviations of samples, and independently of them `more` of every sample."""
        if more is None:
            return sigma
        return np.hypot(sigma, more[:, self.data.filter.kept][:, self.chosen])

    @lazy
    def groups(self) -> Integers:
        """Each joint has a noise of its own."""
        return np.arange(self.rows)

    @lazy
    def run(self) -> Integers:
        """`(sample,)`."""
        return self.data.runs[self.chosen]

    @lazy
    def informative(self) -> Mask:
        """A prior of inertial numbers states knowledge."""
        return self.precision > 0

    @property
    def preset(self) -> tuple[Terms, Array]:
        """None."""
        return Terms(), np.zeros(0)

    @property
    def relative_std(self) -> float | None:
        """Standard deviation of the prior of inertial numbers, over what is declared; None where these are exact."""
        if not len(self.precision):
            return None
        _, deviations = uncertain(self.data.bodies.links, 1.0)
        return float(np.median(self.precision**-0.5 / deviations))

    @cached_property
    def dynamics(self) -> Dynamics:
        """The dynamics of every sample of the recording, at the linearisation."""
        return self.data.bodies.dynamics(self.links)

    @cached_property
    def rigid(self) -> Array:
        """`(joint, sample)` Nm of the arm as it is declared, filtered."""
        return self._kept(self.dynamics.declared)

    @lazy
    def periodic(self) -> tuple[PeriodicFamily, ...]:
        """Ripple of each joint. A turn of a prismatic joint is its stroke, along which orders count the waves."""
        families = []
        for j, slides in enumerate(self.data.arm.slides.tolist()):
            q = np.asarray(self.data.motion.joint_position)[j]
            turn, highest = (float(np.ptp(q)), _resolved_waves(self.data, j)) if slides else (1.0, None)
            if slides and highest is None:
                continue
            angle = wave_angle(q, slides) / turn
            families.append(
                PeriodicFamily(
                    f"joint{j + 1}",
                    self._at_joint(j),
                    angle[self.data.filter.kept][self.chosen],
                    partial(_ripple, j + 1, slides, turn),
                    partial(_ripple_order, turn),
                    partial(self._waves, j + 1, angle),
                    whole=not slides,
                    highest=highest,
                )
            )
        return tuple(families)

    def _waves(self, joint: int, angle: Array, orders: Array) -> Array:
        """Sine and cosine `(order, 2, sample)`, filtered. Most of a search's time would go into the same orders again.

        Args:
            joint: counted from 1.
            angle: `(every sample,)` rad.
            orders: `(order,)`.
        """
        cached = self.known.waves
        keys = [(joint, float(order)) for order in orders]
        waves_by_key = {key: waves for key in keys if (waves := cached.get(key)) is not None}
        new = sorted(set(keys) - set(waves_by_key))
        if new:
            turned = np.multiply.outer([order for _, order in new], angle)
            filtered = self._kept(np.stack([np.sin(turned), np.cos(turned)], 1))
            if 2 * self.samples * (len(cached) + len(new)) > _MOST_WAVES:
                cached.clear()
            cached.update(zip(new, filtered, strict=True))
            waves_by_key.update(zip(new, filtered, strict=True))
        return np.stack([waves_by_key[key] for key in keys])

    def _at_joint(self, j: int) -> Array:
        """How residuals change with a torque at a joint, counted from 0, `(joint, sample)`."""
        return np.where(np.arange(self.rows)[:, None] == j, 1 / self.sigma, 0.0)

    @cached_property
    def resolved_speeds(self) -> Array:
        """`(joint,)` rad/s, m/s of prismatic joints, below which the samples show nothing of friction over speed."""
        return resolved_speeds(self.data.motion)

    @lazy
    def shaped(self) -> tuple[TorqueEffect, ...]:
        """Stribeck friction and Coulomb friction with a transition at a few of their speeds, viscous by exponents."""
        return torque_shaped(self.data.motion, self.resolved_speeds)

    @property
    def simple(self) -> tuple[TorqueEffect, ...]:
        """The candidates that are one number of one joint and add to its torque: friction, offset, rotor."""
        joint_effects = [
            candidate
            for candidate in self.candidates
            if isinstance(candidate, JointTorque) and not isinstance(candidate, Scaling)
        ]
        return tuple(effect for effect in joint_effects if effect.size == 1 and effect.linear)

    @lazy
    def components(self) -> tuple[Component, ...]:
        """The torque of each joint."""
        return tuple(Component(f"joint{j + 1}", "", self._at_joint(j)) for j in range(self.rows))

    @lazy
    def quantities(self) -> tuple[DriverValues, ...]:
        """The drivers that are known and vary, each with the joint whose own it is."""
        motion = self.dynamics.motion
        rise = self.dynamics.motion.joint_temperature_rise
        apart = (
            rise is not None and np.ptp(np.asarray(rise), 0).any()
        )  # else that of the whole arm would be there twice
        possible_drivers = [
            (joint_driver(quantity, j, of_slide), f"joint{j}")
            for j, of_slide in enumerate(motion.sliding.mask(motion.dof).tolist(), 1)
            for quantity in (*_QUANTITIES, *(("temperature",) if apart else ()))
        ]
        varied = []
        for driver, site in (*possible_drivers, (Driver("time"), ""), (Driver("temperature rise"), "")):
            values = read_driver(driver, self.dynamics)
            if values is None:
                continue
            usual = Driver(driver.generalised, driver.place).unit
            if np.ptp(as_revolute(values, usual, driver.of_slide)) > _LEAST_VARIED:
                only = site if driver.generalised in _OWN_ALONE else ""
                varied.append(DriverValues(driver, np.asarray(values, float), frozenset({site}), only))
        return tuple(varied)

    @property
    def floored(self) -> bool:
        """Not: torques vary less than what is declared of them."""
        return False

    @property
    def curved(self) -> bool:
        return False

    @property
    def every_run(self) -> Integers:
        """`(2, every sample)`, the first and the last sample of each one's run."""
        return np.asarray(self.data.motion.run)

    def process(
        self,
        component: Component,
        quantities: Sequence[DriverValues],
        kernel: str,
        spread: float,
        rolloff: tuple[float, ...] = (),
    ) -> UnnamedTorque:
        """A nonparametric effect over the ranges of the recording."""
        joint = int(component.site.removeprefix("joint"))
        driver = " and ".join(quantity.driver.phrase for quantity in quantities)
        (lower, upper), *further = (quantity.bounds for quantity in quantities)
        further_bounds = tuple(chain.from_iterable(further))
        of_slide = bool(self.data.arm.slides[joint - 1])
        return UnnamedTorque(joint, driver, lower, upper, kernel, further_bounds, spread, rolloff, of_slide=of_slide)

    def seen(self, functions: Array) -> Array:
        """Functions `(…, every sample)` filtered, of the samples of this problem."""
        return self._kept(functions)

    def residual(self, nuisance: Array, terms: Terms, values: Array) -> Array:
        """Residuals `(joint, sample)` over `sigma`, predicted minus measured."""
        return (self.torque(nuisance, terms, values) - self.measured) / self.sigma

    def errors(self, nuisance: Array, terms: Terms, values: Array) -> tuple[Array, Array]:
        """`(joint, sample)` in Nm, N of prismatic joints, and over `sigma`."""
        rows = self.residual(nuisance, terms, values)
        return rows * self.sigma, rows

    @property
    def measured(self) -> Array:
        """`(joint, sample)` Nm, filtered."""
        return self.data.measured[:, self.chosen]

    def torque(self, nuisance: Array, terms: Terms, values: Array) -> Array:
        """Predicted torques `(joint, sample)` Nm, filtered, as their stamps say."""
        offsets = offsets_of(terms, values, self.rows)
        if offsets.any():
            data = self.data
            undelayed = self._shown_everywhere(nuisance, terms, values)
            return delayed(undelayed, offsets, self._time, data.filter.runs)[:, data.filter.kept[self.chosen]]
        total = self.rigid
        if nuisance.any():
            total = total + np.tensordot(nuisance, self._inertial, 1)
        return self._shown(total, nuisance, terms, values, everywhere=False)

    @property
    def _time(self) -> Array:
        """`(every sample,)` s."""
        return np.asarray(self.data.motion.time)

    def _shown_everywhere(self, nuisance: Array, terms: Terms, values: Array) -> Array:
        """As `torque`, `(joint, every sample)`, without delays."""
        data = self.data
        total = self._rigid_everywhere
        if nuisance.any():
            total = total + data.filter.whole(data.bodies.of_inertia(np.tensordot(nuisance, self.directions, 1)))
        return self._shown(total, nuisance, terms, values, everywhere=True)

    @cached_property
    def _rigid_everywhere(self) -> Array:
        """As `rigid`, of every sample."""
        return self.data.filter.whole(self.dynamics.declared)

    def _shown(self, rigid: Array, nuisance: Array, terms: Terms, values: Array, everywhere: bool) -> Array:
        """What effects make of the torques of rigid bodies, without delays; of every sample if `everywhere`."""
        dynamics = self.dynamics
        total = np.array(rigid)
        if nuisance.any() and any(_loaded(effect) or not effect.linear for effect, _ in pairs(terms)):
            dynamics = self.data.bodies.dynamics(self.links_at(nuisance))
        for effect, part in pairs(terms):
            joints = effect.acts_on
            numbers = np.asarray(values[part], float)
            if isinstance(effect, Scaling | Delaying):
                continue
            if effect.linear and (dynamics is self.dynamics or not _loaded(effect)):
                total[joints] += np.tensordot(numbers, self._units(effect, everywhere), 1)
            else:
                total[joints] += self._filtered(effect.torque(numbers, dynamics)[joints], everywhere)
        return scales_of(terms, values, self.rows) * total

    def columns(
        self, terms: Sequence[Term], values: Array | None = None, beside: tuple[Terms, Array] | None = None
    ) -> Array:
        """How residuals change with the numbers of effects, `(number, joint, sample)`.

        The scale of a torque acts on all that `beside`, or `terms` where that is not given, make of it.
        """
        column_terms = Terms(tuple(terms))
        at = np.zeros(column_terms.size) if values is None else np.asarray(values, float)
        acting_terms, numbers = beside or (column_terms, at)
        columns = np.zeros((column_terms.size, self.rows, self.samples))
        # by the time of torques that are late by that
        slope = columns[:0]
        late = None
        for effect, part in pairs(column_terms):
            joints = effect.acts_on
            if isinstance(effect, Scaling):
                additive = [not isinstance(acting, Scaling | Delaying) for acting, _ in pairs(acting_terms)]
                unscaled = self.torque(np.zeros(len(self.precision)), *acting_terms.part(numbers, additive))
                columns[part, joints] = unscaled[joints]
            elif isinstance(effect, Delaying):
                offsets = offsets_of(acting_terms, numbers, self.rows)
                if effect not in acting_terms.terms:
                    offsets = offsets + effect.offset(float(at[part][0]), self.rows)
                if late is None or not np.array_equal(offsets, late):
                    slope = self._slope(acting_terms, numbers, offsets)
                    late = offsets
                columns[part] = effect.offset(1.0, self.rows)[:, None] * slope
            elif effect.linear:
                columns[part, joints] = self._units(effect)
            else:
                columns[part, joints] = self._slopes(effect, at[part])
            columns[part, joints] /= self.sigma[joints]
        return columns

    def _slope(self, terms: Terms, values: Array, offsets: Array) -> Array:
        """`(joint, sample)` Nm/s, by the time, of torques that are late by `offsets` `(joint,)` s."""
        data = self.data
        undelayed = self._shown_everywhere(np.zeros(len(self.precision)), terms, values)
        return slope_of_delayed(undelayed, offsets, self._time, data.filter.runs)[:, data.filter.kept[self.chosen]]

    def factored(self, term: Term) -> None:
        """None: a term acts on one row, over which there is no sum."""
        return

    def nuisance_columns(self, terms: Terms, values: Array) -> Array:
        """How residuals change with the inertial numbers, `(number, joint, sample)`."""
        return self._inertial / self.sigma

    def relinearised(self, nuisance: Array, beside: tuple[Terms, Array] | None = None) -> "TorqueProblem":
        """The same problem at other inertial numbers: nuisance zero is then there, whatever terms are `beside`."""
        return replace(
            self, links=self.links_at(nuisance), offset=self.offset + nuisance, known=self.known.at_other_links()
        )

    def links_at(self, nuisance: Array) -> Array:
        """Inertial numbers `(joint, 10)` at a nuisance `(number,)`."""
        return self.links + np.tensordot(nuisance, self.directions, 1)

    def limits(self, term: Term) -> list[tuple[float, float]]:
        """Those of the effect; no payload, link, friction, rotor or spring is less than nothing.

        Bodies are bounded by the arm: no link weighs more than the arm, and its centre of mass is within the link.
        """
        assert isinstance(term, TorqueEffect)
        arm = self.data.arm
        lightest = float(np.min(np.asarray(self.data.motion.payload)))
        of_bodies = inertial_limits(term, arm, self.links, lightest)
        if of_bodies is not None:
            return of_bodies
        less, *further_limits = [(number.lower, number.upper) for number in term.coordinates]
        of_arm = declared(self.data.arm, term) if term.chosen is None else 0.0  # another curve than the declared one
        if isinstance(term, StribeckFriction | CoulombFriction):  # whose other number is a speed
            slowest = float(self.resolved_speeds[term.joint - 1])
            further_limits = [(max(lower, slowest), upper) for lower, upper in further_limits]
        return [(less[0] - of_arm, less[1]), *further_limits]

    def select(self, rows: Integers) -> "TorqueProblem":
        """Some of the samples."""
        return replace(self, chosen=self.chosen[rows], valid=self.valid[rows], known=TorqueCache())

    def thinned(self, every: int) -> "TorqueProblem":
        """One in `every` samples."""
        if every == 1:
            return self
        return replace(self.select(np.arange(self.samples)[::every]), known=self.known.of_every(every))

    def alternative(self, terms: Terms) -> None:
        """None: there is one model of the inputs."""
        return

    def inputs(self, terms: Terms) -> tuple[Term, ...]:
        """None: the torques themselves determine what is declared of masses."""
        return ()

    @cached_property
    def _inertial(self) -> Array:
        """Torques `(number, joint, sample)` by each nuisance number."""
        flat = self.directions.reshape(len(self.directions), self.links.size)
        return np.einsum("np,jps->njs", flat, self.data.regressor[..., self.chosen])

    def _kept(self, torque: Array) -> Array:
        """Torques `(…, joint, every sample)` filtered, of the samples of this problem."""
        return self.data.filter(torque)[..., self.chosen]

    def _filtered(self, torque: Array, everywhere: bool) -> Array:
        if everywhere:
            return self.data.filter.whole(torque)
        return self._kept(torque)

    def _units(self, effect: TorqueEffect, everywhere: bool = False) -> Array:
        """Torques `(number, joint, sample)` by each number of a linear effect, of the joints that it acts on."""
        units = self.known.everywhere if everywhere else self.known.units
        key = effect.process
        if key not in units:
            units[key] = self._filtered(effect.unit_torques(self.dynamics), everywhere)
        return units[key]

    def _slopes(self, effect: TorqueEffect, values: Array) -> Array:
        """As `_units`, by each number of an effect that is not linear, at some of its `values`."""
        key = (effect, bool(values.any()))
        at = values.tobytes()
        cached = self.known.slopes.get(key)  # a fold of another thread may keep its own any time
        if cached is None or cached[0] != at:
            cached = at, self._kept(slopes(effect, values, self.dynamics)[:, effect.acts_on])
            self.known.slopes[key] = cached
        return cached[1]


def _resolved_waves(data: TorqueRows, j: int) -> float | None:
    """The most waves along a prismatic joint's stroke that pass the filter while it moves slowly; None for none."""
    speed = np.abs(np.asarray(data.motion.joint_velocity)[j])
    moving = speed[as_revolute(speed, "rad/s", True) > DIRECTION_SPEED]
    if not moving.size:
        return None
    stroke = float(np.ptp(np.asarray(data.motion.joint_position)[j]))
    highest = min(stroke * data.filter.cutoff / float(np.quantile(moving, _SLOW)), _HIGHEST)
    return highest if highest > _FEWEST else None


def _ripple(joint: int, of_slide: bool, turn: float, order: float) -> TorqueRipple:
    """The ripple of an order that is counted in a `turn`, or in the stroke of a prismatic joint."""
    return TorqueRipple(joint, order / turn, of_slide=of_slide)


def _ripple_order(turn: float, term: Term) -> float | None:
    """The order of a ripple in a `turn`."""
    assert isinstance(term, TorqueRipple)
    return None if term.order is None else float(term.order) * turn


def torque_problem(data: TorqueRows, effects: Sequence[TorqueEffect] = ()) -> TorqueProblem:
    """The problem of a filtered recording and its sidecar, at the declared inertial numbers.

    A user's own `effects` are candidates beside the catalogue's.

    With `inertial: unknown` the combinations of inertial numbers that torques of this motion determine are fitted;
    with a relative uncertainty all of them, with that as their prior's standard deviation.

    Raises:
        InputError: an effect of a joint that the arm does not have, or that is of the other kind.
    """
    for effect in effects:
        if effect.joints_needed > data.arm.dof:
            raise InputError(
                f"{effect.label}: acts at joint {effect.joints_needed}, but the arm has {data.arm.dof} joints; remove "
                "it from EFFECTS"
            )
        require_kind(effect, data.arm.sliding)
    settings = data.recording.settings
    links = data.bodies.links
    inertial = settings.inertial
    if inertial == "declared":
        directions = np.zeros((0, *links.shape))
        deviations = np.zeros(0)
    else:
        directions, deviations = uncertain(links, 1.0 if inertial == "unknown" else float(inertial))
    candidates = (*torque_catalogue(data.arm.dof, data.arm.sliding), *effects)
    if len(directions):  # what is fitted is no effect, however far it is from what was declared
        candidates = tuple(effect for effect in candidates if not isinstance(effect, FITTED))
    missing = tuple(untestable(candidates, data.motion, bool(links.any()) or inertial == "unknown"))
    if data.recording.motion == "static":
        candidates = tuple(effect for effect in candidates if not isinstance(effect, Delaying))
        in_motion = [effect for effect in candidates if not isinstance(effect, _HEAVY)]
        needed = {effect: driver for effect in in_motion for driver in effect.drivers if driver.generalised in _MOVING}
        missing += tuple(
            Untestable(*effect_driver)
            for effect_driver in needed.items()
            if effect_driver[0] not in {item.effect for item in missing}
        )
    lacking = {item.effect for item in missing}
    declared = settings.torque_noise_Nm is not None
    noise = np.asarray(settings.torque_noise_Nm or _ASSUMED * np.std(data.torque, axis=1) + 1e-6, float)
    return TorqueProblem(
        data=data,
        chosen=np.arange(len(data.filter.kept)),
        links=links,
        directions=directions,
        precision=deviations**-2.0,
        offset=np.zeros(len(directions)),
        noise=noise / np.sqrt(data.recorded.every),  # white noise, of which the filter leaves one part in so many
        declared=declared,
        candidates=tuple(effect for effect in candidates if effect not in lacking),
        untestable=missing,
        valid=np.ones(len(data.filter.kept), bool) if data.repeated is None else ~data.repeated[data.filter.kept],
    )


def _loaded(effect: TorqueEffect) -> bool:
    """Tells whether an effect depends on what the links weigh."""
    return any(driver.loaded for driver in effect.drivers)


def uncertain(links: Array, relative: float) -> tuple[Array, Array]:
    """Changes `(number, joint, 10)` of inertial numbers, and the standard deviation `(number,)` of each's prior.

    They are those of each link's mass with its centre in place, of its centre of mass with its mass and tensor as they
    are, and of its tensor: what is uncertain by itself. A heavier link has larger first moments as well. The prior of a
    mass is relative to it, that of a centre to its distance from the joint, or to the mean such distance of the arm
    where that is larger, that of a tensor to it and to the mass at that distance. Links of unknown mass are taken as
    ones of `_UNKNOWN_MASS` at `_UNKNOWN_LEVER`.
    """
    mass = np.maximum(links[:, 0], _UNKNOWN_MASS * (not links.any()) + 0.05 * links[:, 0].mean())
    lever = np.linalg.norm(links[:, 1:4], axis=1) / mass
    lever = np.maximum(lever, lever.mean() if lever.any() else _UNKNOWN_LEVER)
    directions = np.zeros((len(links), 10, *links.shape))
    deviations = np.zeros((len(links), 10))
    for j, (m, length) in enumerate(zip(mass, lever, strict=True)):
        center = links[j, 1:4] / m
        central_moment = links[j, 4:7].sum() / 2 - point_mass(m, center)[4:7].sum() / 2
        directions[j, 0, j] = point_mass(1.0, center)
        for axis, step in enumerate(np.eye(3)):  # exact: a point's tensor is quadratic in its place
            directions[j, 1 + axis, j] = m * 0.5 * (point_mass(1.0, center + step) - point_mass(1.0, center - step))
        directions[j, 4:, j, 4:] = np.eye(6)
        deviations[j] = [m, *(3 * [length]), *(6 * [m * length**2 + max(central_moment, 0.0)])]
    return directions.reshape(-1, *links.shape), relative * deviations.ravel()
