"""Measured joints as an estimation problem: rollouts from commands alone, and the columns of effects as differences."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
import scipy  # whose parts are imported where they are first used

from lite6jax.arms.dynamics import declared_links
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.torque.predict import read_driver
from lite6jax.domains.tracking.coupling import Bodies, JointLoads, loads_along
from lite6jax.domains.tracking.model import (
    Driven,
    TrackingModel,
    acted_on,
    compose,
    roll_out,
    units_along,
    with_effect,
)
from lite6jax.domains.tracking.predict import DiagnosedServos, friction_share_of
from lite6jax.domains.tracking.ranges import range_of
from lite6jax.domains.tracking.rollout import CHANNELS, FRICTION, MOST_LANES, roll
from lite6jax.domains.tracking.rows import (
    LEAST_GEAR,
    TrackingRows,
    begins_at_rest,
    gains_of_other_units,
    usual_payload,
)
from lite6jax.domains.tracking.undetermined import LOADED, untestable_effects
from lite6jax.effects.catalogue import SPEEDS, Untestable, resolved_speeds, torque_shaped, tracking_catalogue
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.dynamic import (
    CoulombFriction,
    OfLink,
    RotorInertia,
    StribeckFriction,
    TorqueRipple,
    UnnamedInLoop,
    ViscousFriction,
    declared,
    inertial_limits,
)
from lite6jax.effects.effect import Effect, OfJoint
from lite6jax.effects.servo import (
    RIGID_GRIP,
    Limit,
    RateLimit,
    Servo,
    ServoDamping,
    ServoStiffness,
)
from lite6jax.errors import InputError
from lite6jax.estimation.problem import Component, DriverValues, PeriodicFamily
from lite6jax.estimation.terms import Term, Terms
from lite6jax.fields import field_values
from lite6jax.recordings.settings import ServoSettings

# type checkers do not accept a cached property where a protocol declares a property
lazy = property if TYPE_CHECKING else cached_property

_HIGH_SPEED = 0.8
"""Of the largest speed of a joint, that of a Stribeck friction that is nearly friction and less damping."""
_SHARE = 0.02
"""Of a number, by which it is changed for a derivative."""
_REACHED = 0.7
"""Of the largest speed or torque: the limit at which a first column is taken."""
_LIMITS = (0.9, 0.7, 0.45, 0.2)
"""Of the largest speed or torque: limits from which a fit starts."""
_OFTEN = 0.9
"""Quantile of the speeds or torques of a joint, and the share of it, that no limit is below."""
_APART_LIMITS = 1.12
_MOST_LIMITS = 30
"""Ratio of the limits that are tried, and how many of them at most. A limit that is a little too low stops a joint."""
_HARDLY_REACHED = (0.003, 0.01, 0.03)
"""Shares below what a joint is asked for at most, of limits that it seldom reaches."""
_FINER_STARTS = 6
"""Finer grids about the best start."""
_BETWEEN = 5
"""Starts of each."""
_SIZES = (0.2, 1.0, 5.0, 25.0)
"""Of the usual size of a number in which rollouts are not linear: from the best of these a fit starts."""
_PRIOR = 1.5
"""Standard deviation of the prior of the logarithm of a servo's unknown number; columns differ by 0.02 of it."""
NO_BODIES = Bodies(np.zeros((0, 6)), np.zeros((0, 10)), np.zeros(3), np.zeros(3))
_OF_ANY_JOINT = ("position", "velocity")
"""Of each joint, on which torques at other joints may depend as well: a cable is drawn along."""
_OF_OWN_JOINT = ("command velocity", "direction of motion", "gravity torque")
"""Of each joint, on which torques at other joints do not depend.

What depends on |load| × direction, or on speed, is a function of load or velocity and the direction of motion.
"""
_LEAST_VARIED = 1e-3
"""Range of a driver below which it did not vary."""
_FAR = 1e3
"""rad, where an arm counts as being that its servos do not hold."""
_KEPT = 4096
"""Columns that are kept."""
_ROLLOUTS_KEPT = 64
"""Of a log of 60 000 rows and six joints 180 MB."""
_UNITS_KEPT = 60
"""Effects whose functions along the motion are kept: of 100 coefficients and 2 000 rows 200 MB."""
_SETTLED = 0.003
"""Of the noise, RMS by which rollouts of the coupled arm differ in the last two sweeps: of 10 000 rows a tenth of what
one fitted number explains of noise."""
_AT_ONCE = 2e7
"""Steps of all lanes that are integrated in one call: 160 MB for each quantity of a lane."""


class Unknown(NamedTuple):
    """A number of the nuisance: the logarithm of a field of the servo of a joint, from 0."""

    field: str
    joint: int


@final
@dataclass(eq=False)
class RolloutCache:
    """What has been computed, shared between the problems of one recording.

    Attributes:
        columns: of effects and unknowns, `(every sample,)` rad by what they depend on.
        rollouts: read-outs `(joint, every sample)` rad by model.
        loads: along the latest rollout of a coupled arm.
        units: of effects, as of `units_along`.
    """

    columns: dict[Any, Array] = field(default_factory=dict)
    rollouts: dict[bytes, Array] = field(default_factory=dict)
    loads: JointLoads | None = None
    units: dict[Driven, Array] = field(default_factory=dict)

    def __reduce__(self) -> tuple[type["RolloutCache"], tuple[()]]:
        """Another process computes it anew, which is faster than to send it."""
        return RolloutCache, ()


class _RolloutInputs(NamedTuple):
    """What a rollout of one joint, from 0, needs: its servo, each `(1,)`, and `(channel, every sample)` of `roll`."""

    joint: int
    servo: Servo
    extra: Array | None

    @property
    def key(self) -> tuple[int, bytes, bytes]:
        """The same for the same rollout."""
        numbers = np.concatenate([np.asarray(part) for part in self.servo])
        return self.joint, numbers.tobytes(), b"" if self.extra is None else self.extra.tobytes()


class _Difference(NamedTuple):
    """The column `(every sample,)` rad of a number: a difference of rollouts over that of the number."""

    name: Any
    before: _RolloutInputs
    after: _RolloutInputs
    over: float

    @property
    def key(self) -> Any:
        """The same for the same column."""
        return self.name, self.before.key


@final
@dataclass(frozen=True, eq=False)
class TrackingProblem:
    """A tracking recording; `estimation.problem.Problem` describes the members it shares.

    Residuals are exact rollouts. Columns are differences of rollouts with one number changed, of joints along the loads
    of the latest rollout. At zero of a number in which they are not linear they are secants of a usual size, of a limit
    those of the limit with which joints are nearest to their read-outs.

    Attributes:
        data: the rows.
        chosen: `(sample,)`, which samples of the grid these are.
        servo: at the point of linearisation.
        unknowns: the nuisance.
        offset: `(number,)`, from the prior's mean to `servo`.
        candidates: effects that are testable with this recording.
        untestable: those that are not, and why.
        valid: `(sample,)`, those that may be used at all.
        coupled_columns: whether columns of effects on bodies hold what each joint does to the others, which takes a
            rollout of the whole arm for each number.
        known: what has been computed.
    """

    data: TrackingRows
    chosen: Integers
    servo: Servo
    unknowns: tuple[Unknown, ...]
    offset: Array
    candidates: tuple[Effect, ...]
    untestable: tuple[Untestable, ...]
    valid: Mask
    coupled_columns: bool = False
    known: RolloutCache = field(default_factory=RolloutCache)

    def __getstate__(self) -> dict[str, object]:
        """What another process is sent: the fields, and nothing that is cached."""
        return field_values(self)

    # ------------------------------------------------------------------ what rows, noise and runs are

    @property
    def rows(self) -> int:
        """One a joint."""
        return len(self.data.measured)

    @property
    def samples(self) -> int:
        return len(self.chosen)

    @lazy
    def groups(self) -> Integers:
        """Each joint has a noise of its own."""
        return np.arange(self.rows)

    @lazy
    def run(self) -> Integers:
        return self.data.recording.run[self.chosen]

    @property
    def every_run(self) -> Integers:
        return np.asarray(self.data.motion.run)

    @property
    def declared(self) -> bool:
        """Tells whether the sidecar declares the noise of encoders."""
        return self.data.recording.settings.joint_noise_rad > 0

    @property
    def floored(self) -> bool:
        """Rollouts are not more exact than declared."""
        return True

    @property
    def curved(self) -> bool:
        """Rollouts are linear in no number of a servo, and a limit or friction acts at once or not at all."""
        return True

    @property
    def noise(self) -> Array:
        """`(joint,)` rad."""
        return self.data.noise

    @property
    def sigma(self) -> Array:
        """`(joint, 1)` rad."""
        return self.data.noise[:, None]

    @property
    def measured(self) -> Array:
        """`(joint, sample)` rad."""
        return self.data.measured[:, self.chosen]

    @lazy
    def precision(self) -> Array:
        return np.full(len(self.unknowns), _PRIOR**-2)

    @lazy
    def informative(self) -> Mask:
        return np.zeros(len(self.unknowns), bool)

    @property
    def preset(self) -> tuple[Terms, Array]:
        """None."""
        return Terms(), np.zeros(0)

    # ------------------------------------------------------------------ residuals

    @cached_property
    def loads(self) -> JointLoads:
        """Along the measured motion."""
        motion = self.data.motion
        moved = (motion.joint_position, motion.joint_velocity, motion.joint_acceleration)
        return loads_along(self.data.bodies, self.data.commands, *(np.asarray(part) for part in moved))

    def model(self, nuisance: Array, terms: Terms, values: Array) -> TrackingModel:
        """The arm with its servos, by the nuisance `(number,)` and the numbers of terms."""
        base = TrackingModel(self.servo_at(nuisance), self.data.bodies)
        return compose(base, terms, values, self.data.coupled)

    def servo_at(self, nuisance: Array) -> Servo:
        """The servos at a nuisance `(number,)`."""
        numbers = self.servo._asdict()
        changed = {unknown.field: np.array(numbers[unknown.field]) for unknown in self.unknowns}
        for unknown, number in zip(self.unknowns, nuisance, strict=True):
            changed[unknown.field][unknown.joint] *= np.exp(np.clip(number, -20.0, 20.0))
        return self.servo._replace(**changed)

    def readouts(self, nuisance: Array, terms: Terms, values: Array) -> Array:
        """Rolled-out read-outs `(joint, every sample)` rad."""
        model = self.model(nuisance, terms, values)
        extra = self._added(model)
        parts = [*map(np.asarray, model.servo), model.bodies.links, model.bodies.gravity]
        key = b"".join(part.tobytes() for part in parts)
        if extra is not None:
            key += extra.tobytes()
        if key not in self.known.rollouts:
            if len(self.known.rollouts) > _ROLLOUTS_KEPT:
                self.known.rollouts.clear()
            start = self.known.loads or self.loads
            along = partial(roll_out, model, self.data.commands, settled=_SETTLED * self.noise)
            readouts, loads = along(loads=start, extra=extra, coupled=self.data.coupled)
            went_apart = self.data.coupled and loads is start
            if went_apart and start is not self.loads:  # along the loads of an arm that is quite another
                readouts, loads = along(loads=self.loads, extra=extra, coupled=self.data.coupled)
            self.known.loads = loads
            self.known.rollouts[key] = _bounded(readouts)
        return self.known.rollouts[key]

    def residual(self, nuisance: Array, terms: Terms, values: Array) -> Array:
        """`(joint, sample)` over `sigma`, rolled out minus measured."""
        return (self.readouts(nuisance, terms, values)[:, self.chosen] - self.measured) / self.sigma

    def errors(self, nuisance: Array, terms: Terms, values: Array) -> tuple[Array, Array]:
        """`(joint, sample)` rad of the rollout, and over `sigma`."""
        rows = self.residual(nuisance, terms, values)
        return rows * self.sigma, rows

    # ------------------------------------------------------------------ columns

    def columns(
        self, terms: Sequence[Term], values: Array | None = None, beside: tuple[Terms, Array] | None = None
    ) -> Array:
        """How residuals change with the numbers of effects, `(number, joint, sample)`."""
        own = Terms(tuple(terms))
        at = np.zeros(own.size) if values is None else np.asarray(values, float)
        others, numbers = beside or (own, at)
        wanted: list[tuple[int, list[_Difference]]] = []
        limits = [term for term, part in own.pairs if not at[part].any()]
        limits = [term for term in limits if isinstance(term, Limit)]
        starts: dict[Effect, Array] = {}
        if limits:
            starts = dict(zip(limits, self._likeliest_starts(limits, others, numbers), strict=True))
        columns = np.zeros((own.size, self.rows, self.samples))
        for effect, part in own.pairs:
            assert isinstance(effect, Effect)
            if self.coupled_columns and self.data.coupled and isinstance(effect, LOADED):
                columns[part] = self._coupled(effect, at[part], others, numbers)
                continue
            step = float(starts[effect][0]) or None if effect in starts else None
            wanted += enumerate(self._of_effect(effect, at[part], others, numbers, step), part.start)
        differences = self._computed([difference for _, by_joint in wanted for difference in by_joint])
        for number, by_joint in wanted:
            for difference in by_joint:
                joint = difference.before.joint
                columns[number, joint] = differences[difference.key][self.chosen] / self.noise[joint]
        return columns

    def _coupled(self, effect: Effect, at: Array, others: Terms, numbers: Array) -> Array:
        """The columns of an effect on bodies `(number, joint, sample)`, with what each joint does to the others."""
        none = np.zeros(len(self.unknowns))
        terms, values = others.part(numbers, [term != effect for term in others.terms])
        model = Terms((*terms.terms, effect))
        before = self.readouts(none, model, np.concatenate([values, at]))
        columns = []
        for k in range(effect.size):
            over = self.step_of(effect, k, float(at[k]))
            changed = at + over * np.eye(effect.size)[k]
            after = self.readouts(none, model, np.concatenate([values, changed]))
            columns.append((after - before)[:, self.chosen] / over / self.noise[:, None])
        return np.stack(columns)

    def _of_effect(
        self, effect: Effect, at: Array, others: Terms, numbers: Array, step: float | None = None
    ) -> list[list[_Difference]]:
        """The columns of an effect at some numbers of its own, beside others, one list for each number.

        The first is a difference of `step`, or of `step_of` where it is not given, as all others are.
        """
        terms, values = others.part(numbers, [term != effect for term in others.terms])
        none = np.zeros(len(self.unknowns))
        model = self.model(none, Terms((*terms.terms, effect)), np.concatenate([values, at]))
        extra = self._added(model)
        joints = [effect.joint - 1] if isinstance(effect, OfJoint) else list(range(self.rows))
        units = None
        if isinstance(effect, Driven) and effect.linear and _is_driven(effect):
            units = units_along(effect, self.data.dynamics, self.known.units)
            if isinstance(effect, OfLink):  # joints beyond a link do not carry it
                joints = joints[: effect.link]
        before = {joint: self._state(model.servo, extra, joint) for joint in joints}
        numbers_by_joint = []
        for k in range(effect.size):
            over = self.step_of(effect, k, float(at[k]))
            if step is not None and k == 0:
                over = step
            servo = model.servo
            total = extra
            if units is not None:
                assert isinstance(effect, Driven)
                more = np.zeros((self.rows, CHANNELS, self.data.commands.samples))
                more[acted_on(effect)] = over * units[k]
                total = more if extra is None else extra + more
            else:
                changed = at + over * np.eye(effect.size)[k]
                altered = self.model(none, Terms((*terms.terms, effect)), np.concatenate([values, changed]))
                servo = altered.servo
                if not effect.linear and altered.driven:
                    total = self._added(altered)
            name = effect, k, at.tobytes(), step
            after = {joint: self._state(servo, total, joint) for joint in joints}
            numbers_by_joint.append([_Difference(name, before[joint], after[joint], over) for joint in joints])
        return numbers_by_joint

    def _added(self, model: TrackingModel) -> Array | None:
        """`(joint, channel, every sample)`, as `TrackingModel.added` along the motion of the recording."""
        if len(self.known.units) > _UNITS_KEPT:
            self.known.units.clear()
        return model.added(self.data.dynamics, self.known.units)

    def state_of(self, model: TrackingModel, joint: int) -> _RolloutInputs:
        """What the rollout of a joint, from 0, needs in a model."""
        return self._state(model.servo, self._added(model), joint)

    def _state(self, servo: Servo, extra: Array | None, joint: int) -> _RolloutInputs:
        return _RolloutInputs(joint, servo.take([joint]), None if extra is None else extra[joint])

    def step_of(self, effect: Effect, k: int, at: float) -> float:
        """By how much a number is changed for its column: far enough that the rollout changes at all.

        A limit that is not reached changes nothing, nor does friction below none.
        """
        coordinate = effect.coordinates[k]
        if isinstance(effect, Limit) and k == 0:
            largest = self.largest(effect)
            if at * largest < 1:
                return 1 / self._reached(effect, largest) - at
        step = max(_SHARE * abs(at), _SHARE * coordinate.typical) if at else coordinate.typical
        lower = self.limits(effect)[k][0]
        if at < lower:
            return lower - at + step
        return step if at + step <= coordinate.upper else -step

    def _reached(self, effect: OfJoint, largest: float) -> float:
        """A limit that is reached: no joint moves much faster than its commands may."""
        reached = _REACHED * largest
        if not isinstance(effect, RateLimit):
            return reached
        speed = np.abs(np.asarray(self.data.motion.joint_velocity)[effect.joint - 1])
        return min(reached, max(float(np.quantile(speed, 0.99)), 0.1 * reached))

    def largest(self, effect: OfJoint) -> float:
        """The speed of a joint's command in rad/s, or its servo's torque in Nm, that is seldom exceeded."""
        j = effect.joint - 1
        command = np.asarray(self.data.recording.commanded_position)[:, j]
        if isinstance(effect, RateLimit):
            return max(float(np.quantile(np.abs(np.diff(command)), 0.99)) / self.data.commands.period, 1e-3)
        torque = self.servo.stiffness[j] * np.abs(command - self.data.measured[j])
        return max(float(np.quantile(torque, 0.99)), 1e-3)

    def starts(self, effect: Effect, stiffness: float | None = None) -> list[Array]:
        """Numbers `(effect.size,)` from which a fit may start: zero of those in which rollouts are linear.

        Args:
            effect: which.
            stiffness: Nm/rad, of the servo beside which; that of the point of linearisation where not given.
        """
        zero = np.zeros(effect.size)
        if isinstance(effect, Limit):
            largest = self.largest(effect)
            limits = {1 / self.step_of(effect, 0, 0.0), *(share * largest for share in _LIMITS)}
            over = 1.0
            if stiffness is not None and not isinstance(effect, RateLimit):  # torques are those of this stiffness
                over = stiffness / float(self.servo.stiffness[effect.joint - 1])
            return [np.r_[1 / (over * limit), zero[1:]] for limit in sorted(limits)]
        if effect.linear:
            return [zero]
        lower, upper = self.limits(effect)[0]
        typical = effect.coordinates[0].typical
        sizes = [sign * size * typical for size in _SIZES for sign in (1, -1)]
        return [np.r_[size, zero[1:]] for size in sizes if lower <= size <= upper]

    def likeliest_start(self, term: Term, model: Terms, values: Array) -> Array:
        """Zero, or the numbers of `starts`, or between them, with which joints are nearest to their read-outs.

        They are rolled out along the latest loads.
        """
        assert isinstance(term, Effect)
        (start,) = self._likeliest_starts([term], model, values)
        return start

    def _likeliest_starts(self, effects: Sequence[Effect], model: Terms, values: Array) -> list[Array]:
        """As `likeliest_start`, of each of some effects beside a model."""
        present = self.residual(np.zeros(len(self.unknowns)), model, values)[:, self.valid]
        shown = self.readouts(np.zeros(len(self.unknowns)), model, values)
        grids: list[Array] = [self._grid(effect, shown) for effect in effects]
        likeliest: list[Array] = [np.zeros(effect.size) for effect in effects]
        gained = np.zeros(len(effects))
        for _ in range(1 + _FINER_STARTS):
            for k, gains in enumerate(self._gains(effects, grids, model, values, present)):
                place = int(np.argmax(gains)) if gains.size else 0
                if not gains.size or gains[place] <= gained[k]:
                    grids[k] = grids[k][:0]
                    continue
                gained[k] = gains[place]
                likeliest[k] = np.r_[grids[k][place], np.zeros(effects[k].size - 1)]
                grids[k] = _between_neighbours(grids[k], place)
        return likeliest

    def _grid(self, effect: Effect, shown: Array) -> Array:
        """First numbers, ascending, from which a fit of an effect may start, beside a model that shows such read-outs.

        A limit lies between what the joint was seen to do and what it is asked for.
        """
        if not (isinstance(effect, Limit) and isinstance(effect, OfJoint)):
            return np.unique([start[0] for start in self.starts(effect) if start.any()])
        j = effect.joint - 1
        moved = self.data.dynamics.motion
        velocity = np.asarray(moved.joint_velocity)[j]
        command = np.asarray(self.data.recording.commanded_position)[:, j]
        done, asked = velocity, np.diff(command) / self.data.commands.period
        if not isinstance(effect, RateLimit):
            steps = self.data.commands.steps
            loads = self.loads
            inertia = loads.mass[j, ::steps] + self.servo.inertia[j]
            drag = self.servo.damping[j] + self.servo.viscous[j]
            done = loads.load[j, ::steps] + inertia * np.asarray(moved.joint_acceleration)[j] + drag * velocity
            asked = self.servo.stiffness[j] * (command - shown[j])
        lowest = _OFTEN * float(np.quantile(np.abs(done), _OFTEN))
        highest = float(np.max(np.abs(asked), initial=0.0))
        if not 0 < lowest < highest:
            return np.zeros(0)
        count = min(int(np.ceil(np.log(highest / lowest) / np.log(_APART_LIMITS))) + 1, _MOST_LIMITS)
        limits = np.r_[np.geomspace(highest, lowest, count), highest * (1 - np.array(_HARDLY_REACHED))]
        return 1 / np.unique(limits[limits >= lowest])[::-1]

    def _gains(
        self, effects: Sequence[Effect], grids: Sequence[Array], model: Terms, values: Array, present: Array
    ) -> list[Array]:
        """By how much each number of the grid of each effect makes a sum of squares less than that `present`."""
        trials: list[list[list[_Difference]]] = []
        for effect, grid in zip(effects, grids, strict=True):
            others, numbers = model.part(values, [term not in effect.includes for term in model.terms])
            zero = np.zeros(effect.size)
            trials.append([self._of_effect(effect, zero, others, numbers, float(number))[0] for number in grid])
        columns = self._computed([difference for of_effect in trials for trial in of_effect for difference in trial])
        gains: list[Array] = []
        for of_effect in trials:
            gains.append(np.zeros(len(of_effect)))
            for place, trial in enumerate(of_effect):
                for difference in trial:
                    joint = difference.before.joint
                    change = difference.over * columns[difference.key][self.chosen][self.valid] / self.noise[joint]
                    gains[-1][place] -= float(np.sum(change * (2 * present[joint] + change)))
        return gains

    def _computed(self, wanted: Sequence[_Difference]) -> dict[Any, Array]:
        """Columns `(every sample,)` rad by their keys."""
        known = self.known.columns
        missing = {each.key: each for each in wanted if each.key not in known}
        columns = {each.key: known[each.key] for each in wanted if each.key in known}
        if not missing:
            return columns
        states = {state.key: state for each in missing.values() for state in (each.before, each.after)}
        rolled = self.rolled(list(states.values()))
        readouts = {key: _bounded(readout) for key, readout in zip(states, rolled, strict=True)}
        if len(known) + len(missing) > _KEPT:
            known.clear()
        new = {key: (readouts[each.after.key] - readouts[each.before.key]) / each.over for key, each in missing.items()}
        known.update(new)
        return columns | new

    def in_likeliest_grip(
        self, nuisance: Array, terms: Terms, values: Array, of_terms_alone: bool = False
    ) -> "TrackingProblem":
        """The problem with the likeliest grip of each joint that dry friction acts on; itself where there is none.

        What holds one joint need not be what holds the others: it may creep at each load at a speed of its own.

        Args:
            nuisance: `(number,)`.
            terms: what is known to be there.
            values: `(terms.size,)`.
            of_terms_alone: whether only joints count whose friction terms add to.
        """
        model = self.model(nuisance, terms, values)
        described = self.servo_at(nuisance) if of_terms_alone else None
        joints = self._with_friction(model, described)
        if not len(joints):
            return self
        self.readouts(nuisance, terms, values)  # the loads, in which joints are rolled out
        grip = np.array(self.servo.grip)
        for joint in joints.tolist():
            here = np.array([joint])
            grip[here] = _likeliest_grip(self, model, here)
        return replace(self, servo=self.servo._replace(grip=grip))

    def _with_friction(self, model: TrackingModel, described: Servo | None) -> Integers:
        """The joints, from 0, on which dry friction acts in a model that `described` servos, or none, do not have."""
        acts = np.zeros(self.rows, bool)
        for name in ("coulomb", "stribeck", "load_friction"):
            before = np.zeros(self.rows) if described is None else np.asarray(described._asdict()[name])
            acts |= np.asarray(model.servo._asdict()[name]) != before
        added = self._added(model)
        if added is not None:
            acts |= np.any(added[:, FRICTION] != 0, axis=1)
        return np.flatnonzero(acts)

    def rolled(self, states: Sequence[_RolloutInputs]) -> Array:
        """Read-outs `(state, every sample)` rad along the latest loads."""
        loads = self.known.loads or self.loads
        commands = self.data.commands
        servo = Servo(*(np.concatenate(parts) for parts in zip(*(state.servo for state in states), strict=True)))
        joints = np.array([state.joint for state in states])
        extra = None
        if any(state.extra is not None for state in states):
            nothing = np.zeros((CHANNELS, commands.samples))
            extra = np.stack([nothing if state.extra is None else state.extra for state in states])
        parts = []
        most = min(max(int(_AT_ONCE / (commands.samples * commands.steps)), 12), MOST_LANES)
        for first in range(0, len(states), most):
            some = slice(first, first + most)
            more = None if extra is None else extra[some]
            lanes = servo.take(some), commands, joints[some], loads.load, loads.mass
            parts.append(roll(*lanes, extra=more, weight=loads.weight).readout)
        return np.concatenate(parts)

    def factored(self, term: Term) -> None:
        """None: a term acts through the loop."""
        return

    def nuisance_columns(self, terms: Terms, values: Array) -> Array:
        """How residuals change with the unknown numbers of servos, `(number, joint, sample)`."""
        columns = np.zeros((len(self.unknowns), self.rows, self.samples))
        if not self.unknowns:
            return columns
        model = self.model(np.zeros(len(self.unknowns)), terms, values)
        extra = self._added(model)
        wanted = []
        for unknown in self.unknowns:
            before = self._state(model.servo, extra, unknown.joint)
            changed = before.servo._asdict()[unknown.field] * np.exp(_SHARE)
            after = before._replace(servo=before.servo._replace(**{unknown.field: changed}))
            wanted.append(_Difference(unknown, before, after, _SHARE))
        differences = self._computed(wanted)
        for number, difference in enumerate(wanted):
            joint = difference.before.joint
            columns[number, joint] = differences[difference.key][self.chosen] / self.noise[joint]
        return columns

    def relinearised(self, nuisance: Array, beside: tuple[Terms, Array] | None = None) -> "TrackingProblem":
        """The same problem at other numbers of the servos: nuisance zero is then there, whatever is `beside`."""
        return replace(self, servo=self.servo_at(nuisance), offset=self.offset + nuisance)

    def limits(self, term: Term) -> list[tuple[float, float]]:
        """Those of the effect; no friction or rotor is less than nothing, and bodies are bounded by the arm."""
        assert isinstance(term, Effect)
        lightest = float(np.min(self.data.recording.payload))
        of_bodies = inertial_limits(term, self.data.arm, self.data.dynamics.links, lightest)
        if of_bodies is not None:
            return of_bodies
        first, *others = [(number.lower, number.upper) for number in term.coordinates]
        less = declared(self.data.arm, term) if term.chosen is None else 0.0
        return [(first[0] - less, first[1]), *others]

    # ------------------------------------------------------------------ what is tried

    @lazy
    def periodic(self) -> tuple[PeriodicFamily, ...]:
        """Ripple of the torque of each joint; waves of one turn of the read-out are candidates.

        Scores before a fit say less of an order than the fit does: none is likelier there for being whole.
        """
        families = []
        for component in self.components:
            joint = int(component.site.removeprefix("joint"))
            (position,) = self._through_loop(joint, self.data.dynamics.position(joint)[None])
            families.append(
                PeriodicFamily(
                    component.site,
                    component.column,
                    position[self.chosen],
                    partial(TorqueRipple, joint),
                    _order_of_ripple,
                    partial(self._waves, joint),
                    whole=False,
                )
            )
        return tuple(families)

    def _waves(self, joint: int, orders: Array) -> Array:
        """Sine and cosine `(order, 2, sample)` of the position of a joint, from 1, as they pass its servo."""
        turned = np.multiply.outer(orders, self.data.dynamics.position(joint))
        return self._through_loop(joint, np.stack([np.sin(turned), np.cos(turned)], 1))[..., self.chosen]

    def _through_loop(self, joint: int, torques: Array) -> Array:
        """How a joint, from 1, answers torques `(…, every sample)`, over that when they hardly change.

        Linear: of the inertia at the middle of the motion, and without friction that holds it.
        """
        j = joint - 1
        servo = self.servo
        middle = np.median(self.data.dynamics.motion.joint_position, axis=1)
        inertia = float(self.data.bodies.masses(middle[:, None])[j, 0] + servo.inertia[j])
        drag = float(servo.damping[j] + servo.viscous[j])
        stiffness = float(servo.stiffness[j])
        numerator, denominator = scipy.signal.bilinear(
            [stiffness], [max(inertia, 1e-9), drag, stiffness], 1 / self.data.commands.period
        )
        at_rest = scipy.signal.lfilter_zi(numerator, denominator)
        answers = np.empty(torques.shape)
        begins = np.flatnonzero(self.data.commands.reset)
        for first, last in zip(begins, [*begins[1:], torques.shape[-1]], strict=True):
            part = torques[..., first:last]
            state = part[..., :1] * at_rest
            answers[..., first:last], _ = scipy.signal.lfilter(numerator, denominator, part, zi=state)
        return answers

    def _through_delay_and_loop(self, joint: int, commands: Array) -> Array:
        """How a joint, from 1, answers commands `(…, every sample)`, as of `_through_loop`."""
        first = self.data.commands.first
        late = np.arange(commands.shape[-1]) - float(self.servo.delay[joint - 1]) / self.data.commands.period
        before = np.clip(np.floor(late).astype(int), first, self.data.commands.end - 1)
        after = np.minimum(before + 1, self.data.commands.end - 1)
        share = np.clip(late - before, 0.0, 1.0)
        return self._through_loop(joint, (1 - share) * commands[..., before] + share * commands[..., after])

    @lazy
    def shaped(self) -> tuple[Effect, ...]:
        """Stribeck friction at a few of its speeds."""
        motion = self.data.motion
        shaped = torque_shaped(motion, resolved_speeds(motion), (*SPEEDS, _HIGH_SPEED))
        return tuple(effect for effect in shaped if isinstance(effect, StribeckFriction))

    @lazy
    def components(self) -> tuple[Component, ...]:
        """The torque of each joint, as it shows while the joint moves slowly: over the stiffness.

        Beside it are shifts of its command and of its read-out, which then show alike.
        """
        torques = []
        for j in range(self.rows):
            site = f"joint{j + 1}"
            shift = np.zeros((self.rows, self.samples))
            shift[j] = 1 / self.noise[j]
            of_torque = None
            of_command = None
            if self.samples == self.data.commands.samples:
                of_torque = partial(self._through_loop, j + 1)
                of_command = partial(self._through_delay_and_loop, j + 1)
            command = Component(site, "command", shift, prior="command_shift", passed=of_command)
            readout = Component(site, "read-out", shift, prior="readout_shift")
            torques.append(Component(site, "", -shift / self.servo.stiffness[j], (command, readout), passed=of_torque))
        return tuple(torques)

    @lazy
    def quantities(self) -> tuple[DriverValues, ...]:
        """The drivers that are known and vary, each with the joint whose own it is."""
        rises = self.data.dynamics.motion.joint_temperature_rise
        differ = rises is not None and bool(np.ptp(np.asarray(rises), 0).any())  # else that of the arm is the same
        of_own_joint = (*_OF_OWN_JOINT, "temperature") if differ else _OF_OWN_JOINT
        possible = [(Driver("time"), "", ""), (Driver("temperature rise"), "", "")]
        for j in range(1, self.rows + 1):
            site = f"joint{j}"
            possible += [(joint_driver(quantity, j, False), site, "") for quantity in _OF_ANY_JOINT]
            possible += [(joint_driver(quantity, j, False), site, site) for quantity in of_own_joint]
        varied = []
        for driver, own, only in possible:
            values = read_driver(driver, self.data.dynamics)
            if values is not None and driver.discrete:
                values = self._direction_of_friction(driver.place)
            if values is not None and np.ptp(values) > _LEAST_VARIED:
                varied.append(DriverValues(driver, np.asarray(values, float), frozenset({own}), only))
        return tuple(varied)

    def _direction_of_friction(self, joint: int) -> Array:
        """`(every sample,)` from -1 to 1, the direction in which friction of a joint, from 1, holds it back.

        That is the direction of motion but where it sticks: by how much more friction there moves its rollout.
        """
        (by_joint,) = self._of_effect(CoulombFriction(joint), np.zeros(1), Terms(), np.zeros(0))
        column = self._computed(by_joint)[by_joint[0].key]
        return np.clip(-self.servo.stiffness[joint - 1] * column, -1.0, 1.0)

    def process(
        self,
        component: Component,
        quantities: Sequence[DriverValues],
        kernel: str,
        spread: float,
        rolloff: tuple[float, ...] = (),
    ) -> UnnamedInLoop:
        """A nonparametric torque, or shift, over the ranges of the recording."""
        joint = int(component.site.removeprefix("joint"))
        phrase = " and ".join(one.driver.phrase for one in quantities)
        (lower, upper), *further = (one.bounds for one in quantities)
        others = tuple(number for pair in further for number in pair)
        return UnnamedInLoop(joint, phrase, lower, upper, kernel, others, spread, rolloff, component.name)

    def seen(self, functions: Array) -> Array:
        return functions[..., self.chosen]

    # ------------------------------------------------------------------ other samples and models

    def select(self, rows: Integers) -> "TrackingProblem":
        """Some of the samples; all are rolled out."""
        return replace(self, chosen=self.chosen[rows], valid=self.valid[rows])

    def thinned(self, every: int) -> "TrackingProblem":
        return self if every == 1 else self.select(np.arange(self.samples)[::every])

    def alternative(self, terms: Terms) -> None:
        """None: there is one model of the inputs."""
        return

    def inputs(self, terms: Terms) -> tuple[Term, ...]:
        """None: commands are known."""
        return ()


def _between_neighbours(grid: Array, place: int) -> Array:
    """Numbers between those beside one of an ascending grid, whose signs are its own."""
    signs = np.sign(grid) == np.sign(grid[place])
    lower = grid[place - 1] if place > 0 and signs[place - 1] else 0.5 * grid[place]
    upper = grid[place + 1] if place + 1 < len(grid) and signs[place + 1] else grid[place]
    first, last = sorted((abs(lower), abs(upper)))
    return np.unique(np.sign(grid[place]) * np.geomspace(max(first, 1e-12), max(last, 1e-12), _BETWEEN + 2)[1:-1])


def _order_of_ripple(term: Term) -> float | None:
    """The order of a ripple, where it is fixed."""
    assert isinstance(term, TorqueRipple)
    return term.order


def _is_driven(effect: Effect) -> bool:
    """Tells whether an effect's columns are of what is added along the measured motion, not of a servo's numbers."""
    bare = TrackingModel(Servo.ideal(np.ones(effect.joints_needed), np.ones(effect.joints_needed)), NO_BODIES)
    return bool(with_effect(bare, effect, np.zeros(effect.size), coupled=False).driven)


def diagnosed_servos(
    problem: TrackingProblem, servo: Servo, terms: Terms, values: Array, readout: Array
) -> DiagnosedServos:
    """The model that predicts joints from commands.

    Args:
        problem: of the recording.
        servo: without the effects.
        terms: the effects.
        values: `(terms.size,)`.
        readout: `(joint, every sample)` rad, the rollout with them, of which the ranges are kept.
    """
    data = problem.data
    settings = data.recording.settings
    declared_servos = settings.servo if isinstance(settings.servo, ServoSettings) else None
    arm = data.arm
    links = declared_links(arm)
    first = np.flatnonzero(data.commands.reset)
    command = np.asarray(data.recording.commanded_position)[first].T
    bodies = data.bodies
    if bodies.added is not None:
        bodies = replace(bodies, added=bodies.added[first])
    share = friction_share_of(
        compose(TrackingModel(servo, bodies), terms, values),
        command,
        data.commands.start[first].T,
        begins_at_rest(data.recording, data.noise),
    )
    return DiagnosedServos(
        arm=arm,
        servo=Servo(*(np.asarray(part, float) for part in servo)),
        links=links,
        payload_center=data.bodies.payload_center,
        payload=usual_payload(data.recording),
        gravity=np.array(settings.gravity_m_per_s2),
        compensated=declared_servos is not None and declared_servos.gravity_compensation,
        terms=terms,
        values=np.asarray(values, float),
        step=data.commands.step,
        interpolated=declared_servos is not None and declared_servos.hold == "interpolated",
        ranges=range_of(data.bodies, readout, data.commands.period, data.recording.run),
        friction_share=share,
        reference_temperature=settings.reference_temperature_degC,
    )


def unknowns_of(data: TrackingRows) -> tuple[Unknown, ...]:
    """The stiffness and damping of servos that are not declared, and what the arm's description does not say either."""
    if data.declared:
        return ()
    names = ["stiffness", "damping"]
    names += ["inertia"] if data.arm.rotor_inertia is None else []
    names += ["coulomb"] if data.arm.coulomb_friction is None else []
    return tuple(Unknown(name, joint) for name in names for joint in range(data.arm.dof))


def candidates_beside(data: TrackingRows, unknowns: Sequence[Unknown]) -> tuple[Effect, ...]:
    """The named effects that a recording may show, but for those that unknown servos or masses contain."""
    fitted = (ServoStiffness, ServoDamping, ViscousFriction) if unknowns else ()
    fitted += (CoulombFriction,) if any(one.field == "coulomb" for one in unknowns) else ()
    fitted += (RotorInertia,) if any(one.field == "inertia" for one in unknowns) else ()
    fitted += () if data.has_masses else LOADED
    return tuple(effect for effect in tracking_catalogue(data.arm.dof) if not isinstance(effect, fitted))


def tracking_problem(data: TrackingRows) -> TrackingProblem:
    """The problem of a recording, at the declared servos, or at ones that are near those that fit best.

    Unknown servos are mostly those of a real arm: friction holds its joints rigidly until it is known better.

    Raises:
        InputError: a joint moves as in another unit than its command, and declared servos would not move it so.
    """
    unknowns = unknowns_of(data)
    candidates = candidates_beside(data, unknowns)
    missing = untestable_effects(data, candidates)
    lacking = {item.effect for item in missing}
    chosen = np.arange(data.commands.samples)
    problem = TrackingProblem(
        data=data,
        chosen=chosen,
        servo=data.servo,
        unknowns=unknowns,
        offset=np.zeros(len(unknowns)),
        candidates=tuple(effect for effect in candidates if effect not in lacking),
        untestable=missing,
        valid=np.ones(len(chosen), bool),
    )
    _require_one_unit(problem)
    if not unknowns:
        return problem
    rigid = np.full(problem.rows, RIGID_GRIP)
    return started(replace(problem, servo=problem.servo._replace(grip=rigid)))


def _require_one_unit(problem: TrackingProblem) -> None:
    even = problem.data.recording
    for joint, gain in gains_of_other_units(even).items():
        if problem.data.declared:
            described = problem.readouts(np.zeros(0), Terms(), np.zeros(0))[joint]
            expected = np.std(described) / np.std(np.asarray(even.commanded_position)[:, joint])
            if 1 / LEAST_GEAR < gain / expected < LEAST_GEAR:
                continue
        column = joint + 1
        raise InputError(
            f"{even.source}: q{column}_rad moves {gain:.3g} times as far as cmd{column}_rad; give both in the same "
            "unit, after the same gear"
        )


_GRIPS = np.geomspace(0.03, 1e4, 13)
"""Factors of MuJoCo's nominal grip that are tried first, from its defaults to nearly rigid."""
_FOLLOWS = 1.7
"""Times the noise, from which a joint does not follow as described, whatever the grip."""
_FINER = 2
"""Finer grids about the best one."""
_GRID = 9
"""Grips of each."""


def follows_as_described(problem: TrackingProblem) -> bool:
    """Tells whether any joint follows its commands as described, but for noise and the grip of its friction."""
    residual = problem.residual(np.zeros(len(problem.unknowns)), Terms(), np.zeros(0))[:, problem.valid]
    return bool(np.min(np.mean(residual**2, 1)) < _FOLLOWS**2)


def along_rollout(problem: TrackingProblem, terms: Terms, values: Array) -> TrackingProblem:
    """The problem whose drivers are those along a rollout, and along what read-outs clearly show beside it.

    Args:
        problem: of a recording.
        terms: what is known to be there.
        values: `(terms.size,)`.
    """
    rolled = problem.readouts(np.zeros(len(problem.unknowns)), terms, values)
    return replace(problem, data=replace(problem.data, rolled=rolled), known=RolloutCache(loads=problem.known.loads))


def with_likely_grip(
    problem: TrackingProblem, terms: Terms | None = None, values: Array | None = None
) -> TrackingProblem:
    """The problem with the grip by which friction of this recording holds joints, one factor for all.

    Joints of a real arm hardly creep while friction holds them, those of a simulator do, as its solver is set. That is
    no physics to be found, and a grip that is wrong by a fifth would be taken for some. The factor is that of the
    largest likelihood where each joint has noise of an unknown size: joints that follow as described decide.

    Args:
        problem: of a recording whose noise is small enough for the coupled arm; any other is returned as it is.
        terms: what is known to be there beside; nothing where not given.
        values: `(terms.size,)`.
    """
    friction = np.asarray(problem.servo.coulomb)
    if not problem.data.coupled or not friction.any():
        return problem
    none = np.zeros(len(problem.unknowns))
    beside = (terms or Terms(), np.zeros(0) if values is None else values)
    problem.readouts(none, *beside)  # the loads along the coupled arm, in which joints are rolled out
    grip = _likeliest_grip(problem, problem.model(none, *beside), np.arange(problem.rows))
    return replace(problem, servo=problem.servo._replace(grip=grip))


def _likeliest_grip(problem: TrackingProblem, model: TrackingModel, joints: Integers) -> Array:
    """The grip of some joints that makes their read-outs likeliest, one factor of that of MuJoCo for all."""
    nominal = np.asarray(problem.data.servo.grip)[joints]
    factors = _GRIPS
    best = 1.0
    for _ in range(1 + _FINER):
        likelihoods = _grip_likelihoods(problem, model, joints, factors)
        if not np.isfinite(likelihoods).any():
            return np.asarray(model.servo.grip)[joints]
        place = int(np.argmax(likelihoods))
        best = float(factors[place])
        lower = float(factors[max(place - 1, 0)])
        upper = float(factors[min(place + 1, len(factors) - 1)])
        factors = np.geomspace(lower, upper, _GRID)
    return best * nominal


def _grip_likelihoods(problem: TrackingProblem, model: TrackingModel, joints: Integers, factors: Array) -> Array:
    """The log likelihood `(factor,)` of joints, less a constant, where noise of each is of unknown size."""
    nominal = np.asarray(problem.data.servo.grip)
    extra = problem._added(model)
    states = [
        problem._state(model.servo._replace(grip=factor * nominal), extra, joint)
        for factor in factors
        for joint in joints.tolist()
    ]
    rolled = problem.rolled(states).reshape(len(factors), len(joints), -1)
    errors = (rolled - problem.data.measured[joints])[..., problem.chosen][..., problem.valid]
    total = -0.5 * errors.shape[-1] * np.sum(np.log(np.mean(errors**2, 2)), 1)
    return np.where(np.isfinite(total), total, -np.inf)


_STIFFNESSES = np.geomspace(0.3, 1500.0, 12)
_TIMES = (0.01, 0.025, 0.06, 0.15)
_INERTIAS = (1e-4, 6e-4, 3e-3)
_BANDS = (1e-3, 2e-2)
"""Of the grid from which a fit of unknown servos starts: Nm/rad, s of damping over stiffness, s² of inertia over
stiffness, rad of friction over stiffness."""
_LONGEST_START = 4000
"""Samples of the rollouts of that grid."""


def _bounded(readouts: Array) -> Array:
    """Readouts of an arm that its servos may not hold, at `_FAR` where they are farther, or no numbers."""
    return np.clip(np.nan_to_num(readouts, nan=_FAR, posinf=_FAR, neginf=-_FAR), -_FAR, _FAR)


def started(problem: TrackingProblem) -> TrackingProblem:
    """The problem at the numbers of a grid that fit best, joint by joint."""
    data = problem.data
    names = {one.field for one in problem.unknowns}
    inertias = _INERTIAS if "inertia" in names else (0.0,)
    bands = _BANDS if "coulomb" in names else (0.0,)
    grid = np.array(list(product(_STIFFNESSES, _TIMES, inertias, bands)))
    few = min(data.commands.samples, _LONGEST_START)
    commands = data.commands.cut(few)
    fine = few * commands.steps
    loads = problem.loads
    servo = {name: np.array(numbers) for name, numbers in problem.servo._asdict().items()}
    for joint in range(problem.rows):
        lanes = Servo(*(np.full(len(grid), numbers[joint]) for numbers in servo.values()))
        kp = grid[:, 0]
        fields = {"stiffness": kp, "damping": kp * grid[:, 1], "inertia": kp * grid[:, 2], "coulomb": kp * grid[:, 3]}
        lanes = lanes._replace(**{name: fields[name] for name in names})
        joints = np.full(len(grid), joint)
        rolled = roll(lanes, commands, joints, loads.load[:, :fine], loads.mass[:, :fine]).readout
        errors = np.mean((rolled - data.measured[joint, :few]) ** 2, 1)
        best = int(np.nanargmin(errors))
        for name in names:
            servo[name][joint] = fields[name][best]
    return replace(problem, servo=Servo(**servo))
