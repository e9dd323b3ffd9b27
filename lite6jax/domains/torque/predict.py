"""What motors exert on an arm with effects, and the torques that sensors show in any motion with standard deviations.

Those follow as of predicted poses, but are of what a sensor shows: its noise is part of them.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np

from lite6jax.arms.arm import Arm, as_revolute, joint_sizes, joint_unit
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.joint_model import JointModel
from lite6jax.domains.torque.filtering import evenly_timed, interpolant
from lite6jax.domains.torque.rows import RigidBodies, bodies_of
from lite6jax.domains.uncertainty import (
    ReferenceOrigin,
    Uncertainty,
    beyond_range,
    distance_to,
    freed,
    independent_directions,
    widened,
)
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.dynamic import (
    Delaying,
    Dynamics,
    Scaling,
    TorqueEffect,
    UnnamedTorque,
    direction,
)
from lite6jax.effects.motion import Motion, motion_of
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms, join
from lite6jax.recordings import Recording, read_motion
from lite6jax.results import PublicResult

_LEAST = {"position": (0.02, "rad"), "velocity": (0.02, "rad/s"), "acceleration": (0.2, "rad/s²")}
"""Quantities whose ranges are kept for every joint: the range of a joint that rests, and its unit."""
_LINE = 10
"""Samples over which the slope is taken by which delayed torques go on beyond the ends of a run."""
_STEP = 1e-4
"""Of a number's typical size, by which it is changed for a derivative."""

# ------------------------------------------------------------------ what motors exert and sensors show


def pairs(terms: Terms) -> list[tuple[TorqueEffect, slice]]:
    """The effects that are the terms of a torque problem, each with the place of its numbers."""
    effects = []
    for term, part in terms.pairs:
        assert isinstance(term, TorqueEffect)
        effects.append((term, part))
    return effects


def exerted(terms: Terms, values: Array, dynamics: Dynamics) -> Array:
    """`(joint, sample)` Nm that the motors exert: without the scales and delays of what shows it."""
    total = dynamics.declared
    for effect, part in pairs(terms):
        if not isinstance(effect, Scaling | Delaying):
            total = total + effect.torque(np.asarray(values[part], float), dynamics)
    return total


def composed(terms: Terms, values: Array, dynamics: Dynamics) -> Array:
    """`(joint, sample)` Nm that a motor's sensor shows at each instant of a motion; delays are left out."""
    total = exerted(terms, values, dynamics)
    return scales_of(terms, values, len(total)) * total


def scales_of(terms: Terms, values: Array, joints: int) -> Array:
    """`(joint, 1)`, the measured torque over the true one."""
    scale = np.ones((joints, 1))
    for effect, part in pairs(terms):
        if isinstance(effect, Scaling):
            scale[effect.joint - 1] += values[part][0]
    return scale


def offsets_of(terms: Terms, values: Array, joints: int) -> Array:
    """`(joint,)` s by which each joint's torques belong to a later motion than their stamps say."""
    total = np.zeros(joints)
    for effect, part in pairs(terms):
        if isinstance(effect, Delaying):
            total += effect.offset(float(values[part][0]), joints)
    return total


def delayed(torque: Array, offsets: Array, time: Array, runs: Integers) -> Array:
    """Torques at another time than that of each sample, `(joint, sample)` Nm.

    Beyond the ends of a run they go on along the line through some samples: a cubic would follow their noise.

    Args:
        torque: `(joint, sample)` Nm; those of runs that are too short to say stay as they are.
        offsets: `(joint,)` s after the sample.
        time: `(sample,)` s.
        runs: `(sample,)`, the run of each sample.
    """
    value = np.array(torque)
    for offset in set(offsets[offsets != 0].tolist()):
        joints = np.flatnonzero(offsets == offset)
        for rows, spline in interpolant(torque[joints], time, runs):
            t = time[rows]
            part = torque[joints, rows]
            at = np.clip(t + offset, t[0], t[-1])
            beyond = t + offset - at
            shifted = spline(at)
            if beyond.any():
                near = ((0, _LINE), (-1 - _LINE, -1))[offset > 0]
                far = (0, -1)[offset > 0]
                along = (part[:, near[1]] - part[:, near[0]]) / (t[near[1]] - t[near[0]])
                shifted = np.where(beyond != 0, part[:, [far]] + along[:, None] * beyond, shifted)
            value[joints, rows] = shifted
    return value


def slope_of_delayed(torque: Array, offsets: Array, time: Array, runs: Integers) -> Array:
    """The derivatives by time of what `delayed` gives, `(joint, sample)` Nm/s; zero of runs that are too short."""
    slope = np.zeros(torque.shape)
    for offset in set(offsets.tolist()):
        joints = np.flatnonzero(offsets == offset)
        for rows, spline in interpolant(torque[joints], time, runs):
            t = time[rows]
            slope[joints, rows] = spline(np.clip(t + offset, t[0], t[-1]), 1)
    return slope


def slopes(effect: TorqueEffect, values: Array, dynamics: Dynamics) -> Array:
    """`(number, joint, sample)` Nm by each number of an effect that is not linear, by central differences."""
    derivatives = []
    for k, number in enumerate(effect.coordinates):
        step = np.eye(effect.size)[k] * _STEP * number.typical
        up, down = (effect.torque(values + sign * step, dynamics) for sign in (1, -1))
        derivatives.append((up - down) / (2 * step[k]))
    return np.stack(derivatives)


def motion_of_joint(j: int, velocity: Array, slides: Mask) -> Motion:
    """The motion through zero in which joint j alone, from 0, moves, by velocities `(sample,)` rad/s, or m/s.

    `slides` `(joint,)` is true for prismatic joints.
    """
    moving = np.where(np.arange(len(slides))[:, None] == j, velocity, 0.0)
    still = motion_of(np.zeros(moving.shape).T, sliding=tuple(np.flatnonzero(slides).tolist()))
    return still._replace(joint_velocity=moving, direction=direction(moving, slides))  # type: ignore[arg-type]


def read_driver(driver: Driver, dynamics: Dynamics) -> Array | None:
    """`(sample,)` in the driver's unit; None where the motion or the loads do not contain it."""
    loads = dynamics.loads if driver.loaded else None
    if driver.known(dynamics.motion, loads):
        return np.asarray(driver.values(dynamics.motion, loads))
    return None


# ------------------------------------------------------------------ the model of a diagnosis


@final
@dataclass(frozen=True, eq=False, repr=False)
class DiagnosedMotors(JointModel):
    """An arm with the effects on torques that were found.

    Attributes:
        arm: its chain.
        links: `(joint, 10)` inertial numbers, of the payload none.
        payload_center: `(3,)` m, of the payload, in the frame after the last joint.
        gravity: `(3,)` m/s² in the base frame.
        terms: the effects.
        values: `(terms.size,)`.
        reference_temperature: °C.
        uncertainty: from which standard deviations of predictions follow; None where the diagnosis does not say.
        reference: the recording beyond which the effects were found; None where they are all that there is.
    """

    arm: Arm
    links: Array
    payload_center: Array
    gravity: Array
    terms: Terms
    values: Array
    reference_temperature: float
    uncertainty: Uncertainty | None = None
    reference: ReferenceOrigin | None = None

    def __repr__(self) -> str:
        effects = ", ".join(effect.label for effect, _ in pairs(self.terms)) or "no effects"
        return f"model of the motors of a {self.arm.name} with {effects}"

    def read_motion(self, path: str | Path) -> Recording:
        """A motion to predict; as `recordings.read_motion`."""
        return read_motion(path, self)

    def predicted(self, motion: Recording, time_remedy: str = "add time_s") -> "TorquePrediction":
        """The torques that the sensors show in a motion, with their standard deviations.

        Raises:
            InputError: another number of joints, no times of a moving arm, or the motion lacks what an effect needs, by
                name.
        """
        if motion.time is None and motion.motion != "static":
            raise InputError(f"{motion.source}: torques of a motion need times; {time_remedy}")
        if motion.dof != self.dof:
            raise InputError(f"{motion.source}: has {motion.dof} joints, the diagnosed arm {self.dof}")
        # filters need even times
        even = motion if motion.motion == "static" else evenly_timed(motion).recording
        bodies, chosen, _ = bodies_of(even, self.arm)
        runs = chosen.runs
        for driver in (driver for effect, _ in pairs(self.terms) for driver in effect.drivers):
            if not driver.loaded and not driver.known(bodies.motion, None):
                raise InputError(f"{even.source}: has no {driver.phrase}; give {driver.remedy}")
        bodies = replace(bodies, links=self.links, payload_center=self.payload_center, gravity=self.gravity)
        dynamics = bodies.dynamics(self.links)
        time = np.asarray(bodies.motion.time)
        torque = _at_rows(shown_torques(self.terms, self.values, dynamics, time, runs).T, even, motion)
        if self.uncertainty is None:
            return TorquePrediction(torque, None, None, self.sliding)
        std, outside = _bars(self, self.uncertainty, bodies, dynamics, runs)
        flags = _at_rows(outside[:, None].astype(float), even, motion)[:, 0] != 0  # and where nothing is interpolated
        return TorquePrediction(torque, _at_rows(std, even, motion), flags, self.sliding)


@final
@dataclass(frozen=True, eq=False, repr=False)
class TorquePrediction(PublicResult):
    """Predicted torques with standard deviations.

    Attributes:
        torque: `(sample, joint)` Nm, N of prismatic joints.
        std: `(sample, joint)` Nm, of what a sensor shows from what is predicted: what was estimated is uncertain, not
            all is explained, and the sensor has noise; None where the diagnosis says nothing of it.
        outside: `(sample,)` bool, rows in which a joint's position, velocity or acceleration, or a quantity on which an
            effect depends, is beyond what was recorded; None where the diagnosis does not say what was.
        sliding: the prismatic joints, counted from 0.
    """

    torque: Array
    std: Array | None
    outside: Mask | None
    sliding: tuple[int, ...] = ()

    @property
    def shown(self) -> Array:
        """The torques."""
        return self.torque

    @property
    def empty(self) -> Mask:
        """`(sample,)`, rows of which nothing is predicted."""
        return np.isnan(self.torque[:, 0])

    def columns(self) -> dict[str, Array | Integers]:
        """Column name to values: `tau1_Nm` …, and `tau1_std_Nm` … and `outside`, 0 or 1, where these are known.

        Those of prismatic joints are `tau3_N` and `tau3_std_N`.
        """
        parts = [("", self.torque)] if self.std is None else [("", self.torque), ("_std", self.std)]
        columns: dict[str, Array | Integers] = {
            f"tau{j + 1}{std}_{joint_unit('Nm', j in self.sliding)}": row
            for std, values in parts
            for j, row in enumerate(values.T)
        }
        if self.outside is None:
            return columns
        return columns | {"outside": self.outside.astype(int)}


def _at_rows(values: Array, even: Recording, motion: Recording) -> Array:
    """Values `(sample, number)` at even times at those of a motion's rows, by lines; not a number in long gaps."""
    if even.row is motion.row:
        return values
    assert even.time is not None
    assert motion.time is not None
    resampled = np.full((motion.samples, values.shape[1]), np.nan)
    step = float(np.median(np.diff(even.time)))
    for run in np.unique(motion.run):
        rows = np.flatnonzero(motion.run == run)
        in_run = np.isin(even.row, motion.row[rows])
        if not in_run.any():
            continue
        at = motion.time[rows]
        t = even.time[in_run]
        near = np.abs(t[np.clip(np.searchsorted(t, at), 1, len(t) - 1) - np.array([[1], [0]])] - at).min(0) <= step
        columns = [np.interp(at[near], t, column) for column in values[in_run].T]
        resampled[rows[near]] = np.stack(columns, 1)
    return resampled


def shown_torques(terms: Terms, values: Array, dynamics: Dynamics, time: Array, runs: Integers) -> Array:
    """`(joint, sample)` Nm that the sensors show in a motion, as their stamps say: times and runs as of `delayed`."""
    torque = composed(terms, values, dynamics)
    return delayed(torque, offsets_of(terms, values, len(torque)), time, runs)


def _bars(
    model: DiagnosedMotors, uncertainty: Uncertainty, bodies: RigidBodies, dynamics: Dynamics, runs: Integers
) -> tuple[Array, Mask]:
    """Standard deviations `(sample, joint)` Nm, and whether a row is outside."""
    recorded = uncertainty.recorded
    slides = model.arm.slides
    states = bodies.moved
    beyond: dict[str, Array] = {}
    ranges = (recorded.joints, recorded.velocities, recorded.accelerations)
    for quantity, state, limits in zip(_LEAST, states, ranges, strict=True):
        assert limits is not None
        sizes = joint_sizes(*_LEAST[quantity], slides)
        over = beyond_range(state.T, limits[:, 0], limits[:, 1], sizes).T
        beyond |= {joint_driver(quantity, j + 1, bool(slides[j])).phrase: over[j] for j in range(len(over))}
    positions = list(beyond)[: len(slides)]
    beyond |= recorded.beyond(driver_values(model.terms, dynamics))
    rows, q = (as_revolute(joints.T, "rad", slides).T for joints in (recorded.positions, states[0].T))
    estimated = _estimated(model, uncertainty, bodies, dynamics, runs)
    variance, outside = widened(estimated, uncertainty, np.arange(model.dof), distance_to(rows, q), beyond, positions)
    return np.sqrt(variance + np.asarray(uncertainty.noise)[:, None] ** 2).T, outside


def _estimated(
    model: DiagnosedMotors, uncertainty: Uncertainty, bodies: RigidBodies, dynamics: Dynamics, runs: Integers
) -> Array:
    """`(joint, sample)` Nm², by the covariance of the numbers; of one effect after the other, in its directions.

    And of processes beyond the range of their drivers.
    """
    scale = scales_of(model.terms, model.values, model.dof)
    directions = independent_directions(uncertainty.covariance)
    moved = np.zeros((len(directions), *dynamics.torque.shape))
    first = len(uncertainty.sites)
    if first:
        moved += np.einsum("dp,jps->djs", directions[:, :first], bodies.regressor) * scale
    terms, values = with_free_numbers(model.terms, model.values)
    exerted_torque = exerted(model.terms, model.values, dynamics)
    for effect, part in pairs(terms):
        effect_directions = directions[:, first + part.start : first + part.stop]
        if isinstance(effect, Scaling):
            moved[:, effect.joint - 1] += effect_directions * exerted_torque[effect.joint - 1]
        elif isinstance(effect, Delaying):
            shown = composed(model.terms, model.values, dynamics)
            time = np.asarray(dynamics.motion.time)
            slope = slope_of_delayed(shown, np.zeros(model.dof), time, runs)
            moved += effect_directions[:, :, None] * effect.offset(1.0, model.dof)[:, None] * slope
        elif effect.linear:
            joints = effect.acts_on
            units = effect.unit_torques(dynamics)
            moved[:, joints] += np.tensordot(effect_directions, units, 1) * scale[joints]
        else:
            moved += np.tensordot(effect_directions, slopes(effect, values[part], dynamics), 1) * scale
    variance = np.sum(moved**2, 0)
    for effect in (term for term in model.terms.terms if isinstance(term, UnnamedTorque)):
        j = effect.joint - 1
        variance[j] += scale[j] ** 2 * np.asarray(effect.unknown_at(effect.values_in(dynamics)))  # type: ignore[arg-type]
    return variance


def driver_values(terms: Terms, dynamics: Dynamics) -> dict[str, Array]:
    """`(sample,)` of each quantity on which an effect depends and of which no range is kept anyway, by its phrase.

    The time of a delay is no such quantity: it acts at any time.
    """
    effects = (effect for effect, _ in pairs(terms) if not isinstance(effect, Delaying))
    drivers = {driver.phrase: driver for effect in effects for driver in effect.drivers}
    further_drivers = [
        driver for driver in drivers.values() if driver.generalised not in (*_LEAST, "direction of motion")
    ]
    return {
        driver.phrase: values for driver in further_drivers if (values := read_driver(driver, dynamics)) is not None
    }


def with_free_numbers(terms: Terms, values: Array) -> tuple[Terms, Array]:
    """The terms with the numbers that were chosen for them as their last ones, unless these are whole and so exact."""
    free = []
    numbers = []
    for effect, part in pairs(terms):
        free.append(freed(effect))
        order = [] if free[-1] is effect else [effect.chosen or 0.0]
        numbers.append(np.append(np.asarray(values[part], float), order))
    return Terms(tuple(free)), join(numbers)


def link_sites(joints: int) -> tuple[tuple[str, int, int], ...]:
    """The inertial numbers of the links, where these are fitted, as sites of an `Uncertainty`."""
    return tuple(("inertia", joint, k) for joint in range(joints) for k in range(10))
