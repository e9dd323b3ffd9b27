"""Measured poses as an estimation problem: one arm, its unknown frames and geometry, and the columns of effects."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple, Self, final

import jax
import jax.numpy as jnp
import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.calibration.problem import Geometry
from lite6jax.domains.pose.deflections import (
    Deflections,
    MassErrors,
    columns_of,
    components,
    mass_errors,
    physics_of,
    quantities,
    site_of,
)
from lite6jax.domains.pose.kinematics import (
    FRAMES,
    Site,
    bent_residual,
    rigid_tool,
    site_columns,
    unwhitened,
    whitened,
)
from lite6jax.domains.pose.rigid_arm import RigidArm, rigid_arm
from lite6jax.effects.catalogue import Untestable, catalogue, shaped, untestable
from lite6jax.effects.composition import Physics
from lite6jax.effects.deflection import Deflection, dense
from lite6jax.effects.effect import Bending, Effect, Loading
from lite6jax.effects.kernels import memory_of
from lite6jax.effects.kinematic import JointHarmonic, PayloadError, TimeOffset
from lite6jax.effects.motion import Motion, accelerated, beyond, select, shifted, thin
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.statics import Inertia, Loads
from lite6jax.estimation.problem import Component, DriverValues, PeriodicFamily
from lite6jax.estimation.terms import Factored, Term, Terms
from lite6jax.fields import field_values
from lite6jax.model import ArmModel
from lite6jax.recordings import Recording
from lite6jax.recordings.motion import inertia_of_arm, motion_of_recording
from lite6jax.recordings.settings import RecordingSettings
from lite6jax.sensors.sensor import Sensor

ONCE_PER_TURN = 2e-4
"""rad, one sigma of the sine and the cosine of a joint's error once a turn, which encoders off centre and gears have: a
disc of 20 mm radius is off by 4 µm. Of three Pandas touched at one place, it lowers the errors at others by a
twentieth."""

# type checkers do not accept a cached property where a protocol declares a property
lazy = property if TYPE_CHECKING else cached_property


class Memory(NamedTuple):
    """The time in which what wanders by itself forgets where it was.

    Attributes:
        samples: usual ones of the recording.
        seconds: None where it has no times.
    """

    samples: float
    seconds: float | None


@final
@dataclass(frozen=True, eq=False)
class PoseProblem(RigidArm):
    """A recording of poses, linearised about a rigid arm; `estimation.problem.Problem` describes the members it shares.

    Of a `RigidArm` it has all attributes: the recording, as screened, has a pose in every row. Further unknowns stand
    after the sensor's own: what encoders do once a turn; displacements after frame jumps, what is left of them in the
    recording; how read-outs wander; and errors of masses. Their `offset` leads to their values in the linearisation.

    Attributes:
        motion: of the whole recording, as declared.
        inertia: the arm's masses as declared, or None where they are not known.
        candidates: effects that are testable with this recording.
        untestable: those that are not, and why.
        clock_offset: s, from a pose's stamp to the instant at which it shows the arm, if set before the search; or 0.
        thinned_from: of a thinned problem, the motion that its rows are taken from, and their indices there: a clock
            offset interpolates between neighbouring rows.
        units: unit deflections and bases that depend on the motion alone, shared between linearisations.
        after: `(jump, sample)` bool, the samples after each frame jump.
        wandering: read-outs of joints that wander by themselves, as processes of the order of recording.
        bent: the deflections about which it is linearised; None about the rigid arm.
    """

    motion: Motion
    inertia: Inertia | None
    candidates: tuple[Effect, ...]
    untestable: tuple[Untestable, ...]
    after: Mask
    clock_offset: float = 0.0
    thinned_from: tuple[Motion, Integers] | None = None
    units: dict[Hashable, Any] = field(default_factory=dict)
    wandering: tuple[Unnamed, ...] = ()
    bent: Deflection | None = None

    @property
    def frames(self) -> tuple[Site, ...]:
        """The displacements of the arm's frames, the first of `unknown`."""
        return tuple(site for site in self.unknown if site[0] in FRAMES)

    @property
    def undeclared(self) -> int:
        """How many displacements of frames and unknowns of the sensor have no prior; the rows determine them."""
        counted = np.array([site[0] in (*FRAMES, "reading") for site in self.unknown], bool)
        return int(np.sum(counted & ~((self.precision > 0) & self.informative)))

    @property
    def masses(self) -> tuple[Site, ...]:
        """The errors of masses, the last of `unknown`."""
        return tuple(site for site in self.unknown if site[0] in ("mass", "payload"))

    @property
    def groups(self) -> Integers:
        """Position and orientation share one scale over their noise, unless that of one alone is declared."""
        apart = len({noise is None for noise in self.declared_noise[: -(-self.rows // 3)]}) == 2
        return np.repeat((0, int(apart)), 3)[: self.rows]

    @property
    def declared(self) -> bool:
        """Tells whether the noise of all that is measured is declared."""
        return None not in self.declared_noise[: -(-self.rows // 3)]

    @property
    def floored(self) -> bool:
        """Tells whether readings are touches whose noise is declared."""
        return self.declared and not self.measured.reads_poses

    @lazy
    def run(self) -> Integers:
        """`(sample,)`, the first sample of each sample's run; of touches each is one of its own, as it seats anew."""
        if not self.measured.reads_poses and self.recording.motion == "static":
            return np.arange(self.samples)
        return np.asarray(self.motion.run)[0]

    @lazy
    def valid(self) -> Mask:
        """`(sample,)`, the rows whose joints were recorded at the instant of the pose."""
        if not self.clock_offset:
            return np.ones(self.samples, bool)
        return ~np.asarray(beyond(self.motion, self.clock_offset))

    @property
    def preset(self) -> tuple[Terms, Array]:
        """A clock offset of several samples, further from zero than a score test reaches."""
        if not self.clock_offset:
            return Terms(), np.zeros(0)
        return Terms((TimeOffset(),)), np.array([self.clock_offset])

    @cached_property
    def time_shifted(self) -> Motion:
        """The motion at the clock offset of the linearisation."""
        if not self.clock_offset:
            return self.motion
        return _altered(self.motion, self.thinned_from, lambda motion: shifted(motion, self.clock_offset))

    @cached_property
    def deflections(self) -> Deflections:
        """Deflections by effects in the time-shifted motion."""
        kinematics = np.asarray(self.start.geometry).reshape(-1, 6)
        errors = self.mass_errors(np.zeros(len(self.unknown)))
        # what refers to the problem itself would keep its gigabyte of columns until the garbage collector runs
        altered = partial(_altered, self.motion, self.thinned_from)
        return Deflections(kinematics, self.inertia, self.time_shifted, altered, self.units, errors)

    @property
    def loads(self) -> Loads | None:
        """The loads on the rigid arm; None where its masses are not known."""
        return self.deflections.loads

    @property
    def joint_position(self) -> Array:
        """`(joint, sample)` rad, m of prismatic joints, of the time-shifted motion."""
        return np.asarray(self.time_shifted.joint_position)

    @cached_property
    def sites(self) -> dict[Site, Array]:
        """How residuals change with a deflection at each site, `(row, sample)`."""
        return site_columns(self.start, self.joint_position, self.measured, self.motion.sliding.joints, self.bent)

    @lazy
    def frame_columns(self) -> Array:
        """How residuals change with all of `unknown` but the masses, `(number, row, sample)`."""
        parts: list[Array] = [np.zeros((0, self.rows, self.samples))]
        by_reading = whitened(self.measured.by_numbers(self.rigid.tool), self.measured.whitener)
        for name, j, k in self.unknown[: len(self.unknown) - len(self.masses)]:
            if name in FRAMES:
                parts.append(self.sites[name, j, k][None])
            elif name == "reading":
                parts.append(by_reading[j][None])
            elif name == "wave":
                parts.append((self.sites["joint", j, 0] * self._waves[k][j])[None])
            elif name == "wander":
                effect = self.wandering[j]
                at = site_of(effect.where, effect.component)
                parts.append((self.sites[at] * self.deflections.basis(effect)[k])[None])
            else:
                parts.append(np.where(self.after[j], self.sites[name.removeprefix("moved "), 0, k], 0.0)[None])
        return np.concatenate(parts)

    def columns(
        self, terms: Sequence[Term], values: Array | None = None, beside: tuple[Terms, Array] | None = None
    ) -> Array:
        """How residuals change with the numbers of effects, `(number, row, sample)`; those of linear ones are kept.

        An error of the payload or of gravity acts through compliances: those of `beside`, or of `terms` where that is
        not given.
        """
        term_set = Terms(tuple(terms))
        values = np.zeros(term_set.size) if values is None else np.asarray(values, float)
        jacobian = np.empty(
            (term_set.size, self.rows, self.samples)
        )  # half a gigabyte of a real arm: written in its place
        for effect, part in term_set.pairs:
            assert isinstance(effect, Effect)
            if (factored := self.factored(effect)) is not None:
                block = jacobian[part].reshape(len(factored.site), -1, self.rows, self.samples)
                np.multiply(factored.site[:, None], factored.functions[:, None], out=block)
            elif isinstance(effect, Loading) or not (effect.linear or not values[part].any()):
                neighbours, at = (term_set, values) if beside is None else beside
                unit = self.deflections.by_each(effect, values[part], physics_of(neighbours), at)
                jacobian[part] = columns_of(unit, self.sites)
            else:
                if effect not in self._columns:
                    self._columns[effect] = columns_of(self.deflections.unit(effect), self.sites)
                jacobian[part] = self._columns[effect]
        return jacobian

    def factored(self, term: Term) -> Factored | None:
        """The columns of a function without a name, where those of a site and component share its column; else None."""
        if not isinstance(term, Unnamed):
            return None
        key = term.where, term.component
        if key not in self._columns:
            self._columns[key] = self.sites[site_of(*key)][None]
        return Factored(self._columns[key], self.deflections.basis(term))

    def nuisance_columns(self, terms: Terms, values: Array) -> Array:
        """How residuals change with `unknown`, `(unknown, row, sample)`: masses matter beside compliances alone."""
        if not self.masses:
            return self.frame_columns
        physics = physics_of(terms)
        at = self.deflections
        through = np.zeros((len(self.masses), self.rows, self.samples))

        def through_masses(effect: Effect, numbers: Array) -> Array:
            return columns_of(at.through_masses(self.masses, Physics((effect,)), numbers), self.sites)

        for effect, part in physics.pairs if physics.loaded else ():
            if isinstance(effect, Unnamed) or not Physics((effect,)).loaded:
                continue  # a function of the loads as declared, or of none
            numbers = np.asarray(values, float)[part]
            if not effect.linear:
                through += through_masses(effect, numbers)
                continue
            if ("mass", effect) not in self._columns:
                self._columns["mass", effect] = np.stack([through_masses(effect, unit) for unit in np.eye(effect.size)])
            through += np.tensordot(numbers, self._columns["mass", effect], 1)
        return np.concatenate([self.frame_columns, through])

    @cached_property
    def _columns(self) -> dict[Hashable, Array]:
        """Columns of linear effects, of sites, and of masses through effects, by these; computed once."""
        return {}

    @lazy
    def periodic(self) -> tuple[PeriodicFamily, ...]:
        """Harmonics of each revolute joint."""
        motion = self.deflections.host_motion
        families = []
        for j in map(int, np.flatnonzero(~motion.sliding.mask(motion.dof))):
            column = self.sites["joint", j, 0]
            q = np.asarray(motion.joint_position)[j]
            families.append(PeriodicFamily(f"joint{j + 1}", column, q, partial(JointHarmonic, j + 1), _order))
        return tuple(families)

    @lazy
    def shaped(self) -> tuple[Effect, ...]:
        """Named effects with a number that is tried at a few values, beside the candidates."""
        return shaped(self.time_shifted, self.loads, self.motion.dof)

    @lazy
    def components(self) -> tuple[Component, ...]:
        """The components of every site, as far as the sensor sees them."""
        candidates = components(self.sites, self.motion, 6 if self.rows == 6 else 3)
        return tuple(component for component in candidates if component.site != "sensor" or self.measured.reads_poses)

    @lazy
    def quantities(self) -> tuple[DriverValues, ...]:
        """As far as they are known and vary."""
        return quantities(self.deflections.host_motion, self.deflections.loads)

    @property
    def every_run(self) -> Integers:
        """`(2, sample)`, the first and the last sample of each sample's run."""
        return np.asarray(self.motion.run)

    def process(
        self,
        component: Component,
        quantities: Sequence[DriverValues],
        kernel: str,
        spread: float,
        rolloff: tuple[float, ...] = (),
    ) -> Unnamed:
        """A nonparametric effect over the ranges of these rows."""
        (lower, upper), *further = [quantity.bounds for quantity in quantities]
        driver = " and ".join(quantity.driver.phrase for quantity in quantities)
        further_bounds = tuple(chain.from_iterable(further))
        return Unnamed(component.site, driver, lower, upper, kernel, component.name, further_bounds, spread, rolloff)

    def seen(self, functions: Array) -> Array:
        """The same: nothing filters poses."""
        return functions

    def residual(self, nuisance: Array, terms: Terms, values: Array) -> Array:
        """Residuals `(row, sample)` over the declared noise, predicted minus measured."""
        still = not nuisance.any() and not self.joint_errors(nuisance).any()
        if not terms.terms and still and not self.clock_offset and not self._moved(nuisance):
            return whitened(self.measured.differences(self.rigid.tool), self.measured.whitener)
        motion, deflection = self._deflection(nuisance, terms, values)
        form = self.motion.chain
        start, measured = self._on_device
        if len(sensor_numbers := self.own_numbers(nuisance)):
            measured = measured.displaced(sensor_numbers)
        return np.asarray(bent_residual(form, start, motion.joint_position, deflection, measured))

    def position_errors(self, nuisance: Array, terms: Terms, values: Array) -> Array:
        """Predicted minus measured positions `(3, sample)` m; of touches what is read, `(row, sample)` m."""
        return unwhitened(self.residual(nuisance, terms, values), self.measured.whitener)[:3]

    def errors(self, nuisance: Array, terms: Terms, values: Array) -> tuple[Array, Array]:
        """Errors of position and of orientation `(2, sample)`, lengths in m and rad, and over the noise of each row.

        Errors of an orientation that was not measured are zero.
        """
        rows = self.residual(nuisance, terms, values)
        raw = unwhitened(rows, self.measured.whitener)
        lengths, over_noise = (
            np.stack([np.linalg.norm(part, axis=0) for part in (numbers[:3], numbers[3:])]) for numbers in (raw, rows)
        )
        return lengths, over_noise

    def once_per_turn(self, nuisance: Array) -> Array:
        """The sine and cosine of each joint's error once a turn, `(joint, 2)` rad, by the nuisance `(unknown,)`."""
        amplitudes = np.zeros((self.motion.dof, 2))
        for (name, j, k), value in zip(self.unknown, self.offset + nuisance, strict=True):
            if name == "wave":
                amplitudes[j, k] = value
        return amplitudes

    def joint_errors(self, nuisance: Array) -> Array:
        """What the nuisance `(unknown,)` adds to the joints' positions, `(joint, sample)` rad."""
        errors = np.einsum("jk,kjs->js", self.once_per_turn(nuisance), self._waves)
        total = self.offset + nuisance
        for number, effect in enumerate(self.wandering):
            mask = [name == "wander" and index == number for name, index, _ in self.unknown]
            _, joint, _ = site_of(effect.where, effect.component)
            errors[joint] += total[mask] @ self.deflections.basis(effect)
        return errors

    def memory_of(self, effect: Unnamed) -> Memory:
        """The memory of an effect that wanders by itself."""
        share = memory_of(effect.rolloff)
        time = self.motion.time
        seconds = None if time is None else share * float(np.ptp(np.asarray(time)))
        return Memory(share * self.samples, seconds)

    def with_nuisance(self, terms: Sequence[Term]) -> "PoseProblem":
        """The same with read-outs that wander as unknowns, under their priors, and no longer as terms."""
        effects = tuple(term for term in terms if isinstance(term, Unnamed))
        sites: tuple[Site, ...] = tuple(
            ("wander", number, k) for number, effect in enumerate(effects) for k in range(effect.size)
        )
        at = len(self.unknown) - len(self.masses)
        deviations = np.concatenate([np.zeros(0), *(np.full(effect.size, effect.spread or 1.0) for effect in effects)])
        return replace(
            self,
            unknown=(*self.unknown[:at], *sites, *self.unknown[at:]),
            precision=np.insert(self.precision, np.full(len(sites), at), deviations**-2.0),
            offset=np.insert(self.offset, np.full(len(sites), at), 0.0),
            informative=np.insert(self.informative, np.full(len(sites), at), True),
            wandering=effects,
        )

    @cached_property
    def _waves(self) -> Array:
        """`(2, joint, sample)`, sine and cosine of the joints' positions."""
        return np.stack([np.sin(self.joint_position), np.cos(self.joint_position)])

    def mass_errors(self, nuisance: Array) -> MassErrors | None:
        """By how much the masses differ from those declared, by the nuisance `(unknown,)`; None where they do not."""
        return mass_errors(self.unknown, self.offset + nuisance, self.motion.dof)

    def select(self, rows: Integers) -> Self:
        """Some of the samples, each a run of its own."""
        full_motion, at = self.thinned_from or (self.motion, np.arange(self.samples))
        bent = jax.tree.map(lambda part: part[..., rows], self.bent)
        per_sample = {"motion": select(self.motion, rows), "after": self.after[:, rows], "bent": bent}
        return replace(super().select(rows), **per_sample, thinned_from=(full_motion, at[rows]), units={})

    def relinearised(self, nuisance: Array, beside: tuple[Terms, Array] | None = None) -> Self:
        """The same problem linearised at `displaced(nuisance)`, and at the deflections by terms where given.

        What turns the arm by a milliradian turns all that is nearer to the tool: columns about the rigid arm are off by
        a thousandth then, which misleads fits of numbers that are nearly confounded.
        """
        problem = replace(super().relinearised(nuisance), bent=None)
        if beside is None or not beside[0].terms:
            return problem
        return replace(problem, bent=problem._deflection(np.zeros(len(self.unknown)), *beside)[1])

    def limits(self, term: Term) -> list[tuple[float, float]]:
        """Those of the effect; a payload is not less than nothing."""
        if isinstance(term, PayloadError):
            return [(-float(np.min(self.motion.payload)), term.coordinates[0].upper)]
        return [(number.lower, number.upper) for number in term.coordinates]

    def thinned(self, every: int) -> "PoseProblem":
        """One in `every` rows, in the runs that they belong to."""
        if every == 1:
            return self
        selected = self.select(np.arange(self.samples)[::every])
        return replace(selected, motion=thin(self.motion, every))

    def alternative(self, terms: Terms) -> "PoseProblem | None":
        """As `with_other_loads`; None also where none of the terms depends on loads."""
        if not physics_of(terms).loaded:
            return None
        return self.with_other_loads()

    def inputs(self, terms: Terms) -> list[Term]:
        """The payload's error, where terms depend on loads and the payload is not a term or a nuisance already."""
        if not physics_of(terms).loaded:
            return []
        return [term for term in self.candidates if isinstance(term, PayloadError) and term not in terms.terms]

    def with_loads(self, accelerated: bool) -> "PoseProblem":
        """With inertial forces in the loads, or without, where that is known of the arm."""
        if (self.motion.joint_acceleration is not None) == accelerated:
            return self
        return self.with_other_loads() or self

    def with_other_loads(self) -> "PoseProblem | None":
        """With inertial forces in the loads, or without; None for an arm at rest, or without masses or times."""
        if self.motion.joint_acceleration is None:
            motion = accelerated(self.motion)
        else:
            motion = self.motion._replace(joint_acceleration=None)
        if self.inertia is None or motion is self.motion:
            return None
        return replace(self, motion=motion, units={})

    def _deflection(self, nuisance: Array, terms: Terms, values: Array) -> tuple[Motion, Deflection]:
        """The altered motion, and in it the sum of the deflections by nuisance and effects, dense."""
        physics = physics_of(terms)
        values = np.asarray(values, float)
        dof = self.motion.dof
        motion = self.motion
        host_motion = self.deflections.host_motion
        on_arm = self.deflections.loads
        bent = self._undeflected
        heavier = physics.loaded and nuisance[len(nuisance) - len(self.masses) :].any()
        errors = self.mass_errors(nuisance) if heavier else None
        if physics.altering:
            motion = host_motion = self.deflections.altered_motion(physics, values)
        if physics.loaded and (physics.altering or errors is not None):
            on_arm = self.deflections.loads_in(host_motion, physics, values, errors)
        for effect, part in physics.pairs:
            heavy = not effect.nonparametric and any(driver.loaded for driver in effect.drivers)
            changed = physics.altering or (errors is not None and heavy)
            if effect.linear and not changed:
                bent = bent + self.deflections.by_linear(effect, values[part])
            elif isinstance(effect, Bending):
                bent = bent + effect.deflect(values[part], host_motion, on_arm)  # type: ignore[arg-type]
        if not self.unknown:
            return motion, bent
        shifts = {"base": np.zeros((6, 1)), "link": np.zeros((dof, 6, 1)), "tool": np.zeros((6, 1))}
        for (name, j, k), value in zip(self.unknown, nuisance, strict=True):
            if name in FRAMES:
                (shifts[name][j] if name == "link" else shifts[name])[k] = value
        for (name, j, k), value in self._moved(nuisance).items():
            place = name.removeprefix("moved ")
            shifts[place] = shifts[place] + np.outer(np.arange(6) == k, self.after[j] * value)
        errors = self.joint_errors(nuisance)
        if errors.any():
            shifts["joint"] = errors
        unshifted = bent._asdict()
        return motion, bent._replace(**{name: unshifted[name] + shift for name, shift in shifts.items()})

    def _moved(self, nuisance: Array) -> dict[Site, float]:
        """What is left of frame jumps, at a nuisance `(unknown,)`; where there is something left."""
        if not len(self.after):
            return {}
        total = self.offset + nuisance
        pairs = zip(self.unknown, total, strict=True)
        return {site: float(value) for site, value in pairs if site[0].startswith("moved") and value}

    @cached_property
    def _on_device(self) -> tuple[ArmModel, Sensor]:
        """The arm and the poses as compiled functions take them, copied once."""
        return jax.tree.map(jnp.asarray, (self.start, self.measured))

    @cached_property
    def _undeflected(self) -> Deflection:
        return dense(Deflection(), self.motion.dof, self.samples)


def _altered(motion: Motion, thinned_from: tuple[Motion, Integers] | None, alter: Callable[[Motion], Motion]) -> Motion:
    """The motion of a problem altered by an effect of the clock or the payload, at the rows of the problem."""
    if thinned_from is None:
        return alter(motion)
    full_motion, chosen = thinned_from
    return select(alter(full_motion), chosen)


def pose_problem(
    recording: Recording,
    arm: Arm | None = None,
    geometry: Geometry = "declared",
    effects: Sequence[Effect] = (),
    factory: FactoryCalibration | None = None,
    jumps: Sequence[tuple[int, str]] = (),
) -> PoseProblem:
    """The problem of a recording and its sidecar, linearised at the nominal arm with frames in closed form.

    Args:
        recording: measured poses.
        arm: the nominal arm; from the sidecar where not given.
        geometry: what is known of it, as in `fit`.
        effects: a user's own candidates, beside the catalogue's.
        factory: the arm's calibration; from the sidecar where not given.
        jumps: rows of the file from which on the "base" or the "tool" is displaced by what is to be fitted.

    Raises:
        InputError: as `rigid_arm`.
    """
    rigid = rigid_arm(recording, arm, geometry, factory)
    # where the sensor shows the tool by the rigid arm: a function of noise itself would fit that noise
    shown = rigid_tool(rigid.start, recording.joint_position.T, recording.sliding)[:, :3, 3].T
    motion = motion_of_recording(recording)._replace(measured_position=shown)  # type: ignore[arg-type]
    inertia = inertia_of_arm(rigid.arm, recording.settings)
    masses, deviations = _uncertain_masses(inertia, recording.settings)
    # of a tool that slipped only what is measured
    numbers = {"base": 6, "tool": rigid.rows}
    moved = tuple((f"moved {part}", j, k) for j, (_, part) in enumerate(jumps) for k in range(numbers[part]))
    # where touches alone determine a chain, encoders have the tolerance that its lengths and angles have
    touched = not rigid.measured.reads_poses
    tolerant = touched and recording.settings.factory_calibration is None and factory is None
    turning = ()
    if tolerant and geometry != "exact":
        turning = np.flatnonzero(~rigid.arm.slides)
    waves = tuple(("wave", int(j), k) for j in turning for k in range(2))
    precision = np.full(len(waves), ONCE_PER_TURN**-2.0)
    free = np.zeros(len(moved))
    none = np.zeros(len(masses))
    all_effects = (*catalogue(rigid.arm.dof, turned_tool=rigid.rows == 6, sliding=rigid.arm.sliding), *effects)
    if touched:  # sockets, plates and anchors have no frame of their own that could move
        all_effects = tuple(effect for effect in all_effects if effect.site != "sensor")
    missing = tuple(untestable(all_effects, motion, inertia is not None))
    lacking = {item.effect for item in missing}
    with_more = {
        "unknown": (*rigid.unknown, *waves, *moved, *masses),
        "precision": np.concatenate([rigid.precision, precision, free, deviations**-2.0]),
        "offset": np.concatenate([rigid.offset, 0 * precision, free, none]),
        "informative": np.concatenate([rigid.informative, precision > 0, free == 0, none == 0]),
    }
    return PoseProblem(
        **(field_values(rigid) | with_more),
        after=np.array([rigid.recording.row >= row for row, _ in jumps]).reshape(len(jumps), rigid.samples),
        motion=motion,
        inertia=inertia,
        candidates=tuple(effect for effect in all_effects if effect not in lacking),
        untestable=missing,
    )


def _uncertain_masses(inertia: Inertia | None, settings: RecordingSettings) -> tuple[tuple[Site, ...], Array]:
    """The errors of masses that are nuisance, and the standard deviation of each one's prior."""
    if inertia is None:
        return (), np.zeros(0)
    uncertain: list[tuple[Site, float]] = []
    if settings.inertial_uncertainty:
        links = np.flatnonzero(np.asarray(inertia.mass))
        uncertain += [(("mass", int(j), k), settings.inertial_uncertainty) for j in links for k in range(4)]
    if settings.payload_uncertainty_kg:
        uncertain.append((("payload", 0, 0), settings.payload_uncertainty_kg))
    return tuple(site for site, _ in uncertain), np.array([deviation for _, deviation in uncertain])


def _order(term: Term) -> float | None:
    assert isinstance(term, JointHarmonic)
    return None if term.order is None else float(term.order)
