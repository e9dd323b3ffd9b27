"""Standard deviations of predicted torques: of what was estimated, of noise, of what is left, and outside its range.

They follow as those of predicted poses do (`domains.pose.uncertainty`), but are those of what a sensor shows: its noise
is part of them. Far from every recorded state of the joints, what is left of the model is taken to grow.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.joint_units import as_revolute, joint_sizes
from lite6jax.domains.pose.uncertainty import DRIVEN, LENGTH, MARGIN, beyond_range, distance_to, freed
from lite6jax.domains.torque.composition import composed, scales_of, without_sensors
from lite6jax.domains.torque.families import joints_of, unit_torques
from lite6jax.domains.torque.filtering import interpolant
from lite6jax.domains.torque.rows import RigidBodies
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.dynamic.torque_effect import Delaying, Dynamics, Scaling, TorqueEffect
from lite6jax.effects.dynamic.unnamed import UnnamedTorque
from lite6jax.effects.effect import Effect
from lite6jax.estimation.terms import Terms, join

if TYPE_CHECKING:
    from lite6jax.domains.torque.predict import DiagnosedMotors

Array = NDArray[np.floating]
Flags = NDArray[np.bool_]

_STEP = 1e-4
"""Of a number's typical size, by which it is changed for a derivative."""
_OF_STATE = {"position": 0.02, "velocity": 0.02, "acceleration": 0.2}
"""Quantities whose ranges are kept for every joint; the range of a joint that rests, rad, rad/s and rad/s²."""
_UNITS = ("rad", "rad/s", "rad/s²")


@final
@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """Where a model of torques was recorded.

    Attributes:
        ranges: `(3, joint, 2)`, the least and the greatest position (rad), velocity (rad/s) and acceleration (rad/s²),
            of prismatic joints in m.
        positions: `(row, joint)` rad, or m, of some recorded rows.
        spacing: rad, as of `pose.uncertainty.RecordedRange`; a prismatic joint counts by `arms.joint_units.LEVER`.
        drivers: the least and the greatest value of each further quantity on which an effect depends, by its phrase.
    """

    ranges: Array
    positions: Array
    spacing: float
    drivers: dict[str, tuple[float, float]]


@final
@dataclass(frozen=True, eq=False)
class TorqueUncertainty:
    """What standard deviations of predicted torques follow from.

    Attributes:
        inertial: whether the inertial numbers of the links were fitted.
        covariance: `(number, number)`, of the links' inertial numbers where these were fitted, and of the numbers of
            all effects, each as `freed`.
        left: `(joint,)` Nm, what is left of the model on rows that were not fitted; as in all of these, N of prismatic
            joints.
        unseen: `(joint,)` Nm, what may be left without showing there: one standard error of the noise and of `left`.
        noise: `(joint,)` Nm, of one row of the sensor.
        curves: for each effect the torque that it adds, Nm RMS, where it is a curve without a name; else None.
        recorded: the range.
    """

    inertial: bool
    covariance: Array
    left: Array
    unseen: Array
    noise: Array
    curves: tuple[float | None, ...]
    recorded: RecordedMotion


class TorqueBars(NamedTuple):
    """Standard deviations of predicted torques.

    Attributes:
        std: `(joint, sample)` Nm.
        outside: `(sample,)`, where a joint's state or a driver is beyond its recorded range.
    """

    std: Array
    outside: Flags


def with_free_numbers(terms: Terms, values: Array) -> tuple[Terms, Array]:
    """The terms with the numbers that were chosen for them as their last ones, unless these are whole and so exact."""
    pairs = []
    for term, part in zip(terms.terms, terms.slices, strict=True):
        assert isinstance(term, Effect)
        one, at = freed(term), np.asarray(values[part], float)
        pairs.append((one, at if one is term else np.append(at, float(term.chosen or 0.0))))
    return Terms(tuple(one for one, _ in pairs)), join(at for _, at in pairs)


def bars_of(model: "DiagnosedMotors", bodies: RigidBodies, runs: NDArray[np.integer]) -> TorqueBars | None:
    """The bars of a model's torques along a motion; None where its diagnosis says nothing of uncertainty.

    Args:
        model: as diagnosed.
        bodies: of its links, along the motion.
        runs: `(sample,)`, the run of each sample.
    """
    known = model.uncertainty
    if known is None:
        return None
    dynamics = bodies.dynamics(model.links)
    variance = _estimated(model, known, bodies, dynamics, runs)
    further, curved, outside = _departures(model, known, dynamics)
    left, unseen, noise = (part[:, None] ** 2 for part in (known.left, known.unseen, known.noise))
    variance += noise + left + further * (left + unseen)
    for effect, moved, share in zip(model.terms.terms, known.curves, curved, strict=True):
        if moved is not None:
            assert isinstance(effect, UnnamedTorque)
            variance[effect.joint - 1] += moved**2 * share
    return TorqueBars(np.sqrt(variance), outside)


def _estimated(
    model: "DiagnosedMotors", known: TorqueUncertainty, bodies: RigidBodies, dynamics: Dynamics, runs: NDArray
) -> Array:
    """`(joint, sample)` Nm², by the covariance of the numbers; of one effect after the other, in its directions."""
    scale = scales_of(model.terms, model.values, model.dof)
    root = np.sqrt(np.maximum(np.diagonal(known.covariance), np.finfo(float).tiny))
    # inertial numbers that no torque shows are as uncertain as their prior, and cancel in independent directions
    eigenvalues, V = np.linalg.eigh(known.covariance / np.outer(root, root))
    directions = (V * np.sqrt(np.maximum(eigenvalues, 0.0)) * root[:, None]).T
    moved = np.zeros((len(directions), *dynamics.torque.shape))
    first = 0
    if known.inertial:
        first = model.links.size
        moved += np.einsum("dp,jps->djs", directions[:, :first], bodies.regressor) * scale
    terms, values = with_free_numbers(model.terms, model.values)
    whole = without_sensors(model.terms, model.values, dynamics)
    for effect, part in zip(terms.terms, terms.slices, strict=True):
        assert isinstance(effect, TorqueEffect)
        own = directions[:, first + part.start : first + part.stop]
        if isinstance(effect, Scaling):
            moved[:, effect.joint - 1] += own * whole[effect.joint - 1]
        elif isinstance(effect, Delaying):
            slope = _slope_in_time(composed(model.terms, model.values, dynamics), dynamics, runs)
            moved += own[:, :, None] * effect.offset(1.0, model.dof)[:, None] * slope
        elif effect.linear:
            joints, units = joints_of(effect), unit_torques(effect, dynamics, lambda rows: rows)
            moved[:, joints] += np.tensordot(own, units, 1) * scale[joints]
        else:
            moved += np.tensordot(own, _derivatives(effect, values[part], dynamics), 1) * scale
    return np.sum(moved**2, 0)


def _derivatives(effect: TorqueEffect, values: Array, dynamics: Dynamics) -> Array:
    """`(number, joint, sample)` Nm by each number of an effect that is not linear, by central differences."""
    found = []
    for k, number in enumerate(effect.coordinates):
        step = np.eye(effect.size)[k] * _STEP * number.typical
        up, down = (effect.torque(values + sign * step, dynamics) for sign in (1, -1))
        found.append((up - down) / (2 * step[k]))
    return np.stack(found)


def _slope_in_time(torque: Array, dynamics: Dynamics, runs: NDArray[np.integer]) -> Array:
    """`(joint, sample)` Nm/s; zero in runs that are too short to say."""
    time, slope = np.asarray(dynamics.motion.time), np.zeros_like(torque)
    for rows, spline in interpolant(torque, time, runs):
        slope[:, rows] = spline(time[rows], 1)
    return slope


def driver_values(terms: Terms, dynamics: Dynamics) -> dict[str, Array]:
    """`(sample,)` of each quantity on which an effect depends and of which no range is kept anyway, by its phrase.

    The time of a delay is no such quantity: it acts at any time.
    """
    drivers: dict[str, Driver] = {}
    for effect in terms.terms:
        assert isinstance(effect, TorqueEffect)
        if not isinstance(effect, Delaying):
            drivers |= {driver.phrase: driver for driver in effect.drivers}
    loads = dynamics.loads
    return {
        phrase: np.asarray(driver.values(dynamics.motion, loads))
        for phrase, driver in drivers.items()
        if driver.generalised not in (*_OF_STATE, "direction of motion") and driver.known(dynamics.motion, loads)
    }


def states_of(dynamics: Dynamics) -> Array:
    """`(3, joint, sample)`: position, velocity and acceleration of each joint."""
    m = dynamics.motion
    return np.stack([np.asarray(part) for part in (m.joint_position, m.joint_velocity, m.joint_acceleration)])


def _departures(
    model: "DiagnosedMotors", known: TorqueUncertainty, dynamics: Dynamics
) -> tuple[Array, list[Array], Flags]:
    """How far a motion departs from what was recorded; as `pose.uncertainty._departures`."""
    recorded, states, slides = known.recorded, states_of(dynamics), model.arm.slides
    known_at, q = (as_revolute(joints.T, "rad", slides).T for joints in (recorded.positions, states[0].T))
    further = (np.maximum(distance_to(known_at, q) - recorded.spacing, 0.0) / LENGTH) ** 2
    over = [  # (sample, joint) each
        beyond_range(state.T, ranges[:, 0], ranges[:, 1], joint_sizes(least, unit, slides)) / DRIVEN
        for state, ranges, least, unit in zip(states, recorded.ranges, _OF_STATE.values(), _UNITS, strict=True)
    ]
    outside: Flags = np.asarray(np.max(over, axis=(0, 2)) > MARGIN / DRIVEN)
    for motion in over[1:]:  # the distance in joint space contains the positions
        further = further + np.sum(motion**2, 1)
    places = {
        joint_driver(quantity, j + 1, bool(slides[j])).phrase: part[:, j]
        for quantity, part in zip(_OF_STATE, over, strict=True)
        for j in range(q.shape[1])
    }
    for phrase, values in driver_values(model.terms, dynamics).items():
        if phrase in recorded.drivers:
            places[phrase] = beyond_range(values, *recorded.drivers[phrase]) / DRIVEN
            outside = outside | (places[phrase] > MARGIN / DRIVEN)
            further = further + places[phrase] ** 2
    curved = []
    for effect in model.terms.terms:
        assert isinstance(effect, TorqueEffect)
        beyond = [places[driver.phrase] ** 2 for driver in effect.drivers if driver.phrase in places]
        curved.append(-np.expm1(-sum(beyond, np.zeros(len(q)))))
    return further, curved, outside
