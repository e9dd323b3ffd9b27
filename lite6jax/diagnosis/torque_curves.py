"""What the figures of a diagnosis of torques show: torques over time, friction over velocity, findings over drivers.

Partial residuals are what was measured, less the whole model without what is shown; see `diagnosis.partial_residuals`.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.joint_units import as_revolute
from lite6jax.diagnosis.partial_residuals import FindingCurve
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.domains.torque import filtering
from lite6jax.effects.drivers import Driver
from lite6jax.effects.dynamic.friction import (
    CoulombFriction,
    CoupledFriction,
    FrictionTemperature,
    LoadFriction,
    StribeckFriction,
    ViscousFriction,
)
from lite6jax.effects.dynamic.torque_effect import Dynamics, JointTorque, Scaling, TorqueEffect
from lite6jax.effects.dynamic.unnamed import UnnamedTorque
from lite6jax.effects.motion import Motion, motion_of

Array = NDArray[np.floating]

_LONGEST = 400
"""Samples of a run that are shown over time: more are not legible."""
_POINTS = 400
_FRICTION = (ViscousFriction, CoulombFriction, StribeckFriction, LoadFriction, FrictionTemperature)


class TorquesOverTime(NamedTuple):
    """A part of a recording, filtered.

    Attributes:
        time: `(sample,)` s since the start of the recording.
        measured: `(joint, sample)` Nm, N of prismatic joints as in all of these.
        rigid: `(joint, sample)` Nm, of the rigid arm alone, its inertial numbers fitted where they are not declared.
        modelled: `(joint, sample)` Nm, with the findings.
    """

    time: Array
    measured: Array
    rigid: Array
    modelled: Array


class JointFriction(NamedTuple):
    """The friction of one joint.

    Attributes:
        velocity: `(sample,)` rad/s, or m/s.
        partial: `(sample,)` Nm, what was measured, less the model without friction of this joint.
        at: `(point,)` rad/s, ascending; none where no friction was found.
        friction: `(point,)` Nm, as found, at the median of load and temperature, with the other joints at rest.
    """

    velocity: Array
    partial: Array
    at: Array
    friction: Array


class Spectra(NamedTuple):
    """Power spectral densities of what was recorded, without spikes and before any filter.

    Attributes:
        frequency: `(frequency,)` Hz.
        velocity: `(joint, frequency)` (rad/s)²/Hz, (m/s)²/Hz of prismatic joints.
        torque: `(joint, frequency)` Nm²/Hz, N²/Hz of prismatic joints.
    """

    frequency: Array
    velocity: Array
    torque: Array


def spectra(found: TorqueDiagnosis) -> Spectra | None:
    """Of each joint; None of static postures."""
    data = found.problem.data
    if data.recording.motion == "static":
        return None
    frequency, velocity = filtering.spectra(data.recording.velocities().T, data.filter)
    return Spectra(frequency, velocity, filtering.spectra(data.torque, data.filter)[1])


def torques_over_time(found: TorqueDiagnosis) -> TorquesOverTime:
    """The middle of the longest run."""
    problem, state = found.problem, found.selection.state
    edges = np.concatenate([[0], np.flatnonzero(np.diff(problem.run)) + 1, [problem.samples]])
    longest = int(np.argmax(np.diff(edges)))
    start, stop = edges[longest], edges[longest + 1]
    start = start + max(0, stop - start - _LONGEST) // 2
    shown = slice(start, min(start + _LONGEST, stop))
    recorded = problem.data.recording.time
    assert recorded is not None
    rigid, modelled = (problem.torque(fit.nuisance, fit.terms, fit.values) for fit in (state.baseline, state.fit))
    time = problem.data.time[problem.chosen][shown] - recorded[0]
    return TorquesOverTime(time, problem.measured[:, shown], rigid[:, shown], modelled[:, shown])


def joint_frictions(found: TorqueDiagnosis) -> tuple[JointFriction, ...]:
    """The friction of each joint."""
    problem, fit = found.problem, found.fit
    used = problem.valid
    velocity = np.asarray(problem.data.motion.joint_velocity)[:, problem.data.filter.kept][:, problem.chosen]
    left = problem.measured - problem.torque(fit.nuisance, fit.terms, fit.values)
    shown = []
    for j in range(problem.rows):
        own = [k for k, effect in enumerate(fit.terms.terms) if _is_friction(effect, j + 1)]
        partial = left[j] + _part(found, own)[j]
        at = np.linspace(velocity[j].min(), velocity[j].max(), _POINTS) if own else np.zeros(0)
        at = np.sort(np.append(at, [-1e-9, 1e-9])) if own else at  # so that a step at zero is one
        friction = _friction_at(found, own, j, at) if own else at
        shown.append(JointFriction(velocity[j, used], partial[used], at, friction))
    return tuple(shown)


def finding_curve(found: TorqueDiagnosis, k: int) -> FindingCurve:
    """A finding of one joint over its driver; another over the torque that it adds where it adds most.

    A finding of several drivers, or of one times the load, has no curve over one of them: it has a point for each
    sample.
    """
    problem, fit, finding = found.problem, found.fit, found.findings[k]
    effect, used = finding.effect, problem.valid
    assert isinstance(effect, TorqueEffect)
    moved = _part(found, [k])
    j = int(np.argmax(np.sum(as_revolute(moved[:, used], "Nm", problem.data.arm.slides) ** 2, 1)))
    unit: Literal["N", "Nm"] = "N" if problem.data.arm.slides[j] else "Nm"
    left = problem.measured - problem.torque(fit.nuisance, fit.terms, fit.values)
    partial = (left + moved)[j, used]
    if not isinstance(effect, JointTorque) or isinstance(effect, Scaling):
        columns = problem.columns([effect], finding.values, (fit.terms, fit.values))[:, j] * problem.sigma[j]
        at, std = moved[j, used], _deviation(columns[:, used], finding.covariance)
        order = np.argsort(at, kind="stable")
        x = at[order]
        return FindingCurve(k, "displacement", None, ("joint", j, 0), unit, at, partial, x, x, std[order])
    dynamics = problem.dynamics
    choices = effect.of if isinstance(effect, UnnamedTorque) else effect.drivers or (Driver("time"),)
    driver, loads = choices[0], dynamics.loads
    values = np.asarray(driver.values(dynamics.motion, loads))
    x = values[problem.data.filter.kept][problem.chosen][used]
    several = len(choices) > 1 or (isinstance(effect, UnnamedTorque) and effect.full_load > 0)
    key = ("joint", j, 0)
    if isinstance(effect, UnnamedTorque) and not several:
        sign = dynamics.direction(j + 1)[problem.data.filter.kept][problem.chosen][used] if effect.signed else 1.0
        at = np.linspace(x.min(), x.max(), _POINTS)
        slope = effect.functions_of(at[None])
        std = _deviation(slope, finding.covariance)
        return FindingCurve(k, "driver", driver, key, unit, x, sign * partial, at, finding.values @ slope, std)
    if several:
        own = moved[j, used]
        return FindingCurve(k, "driver", driver, key, unit, x, partial, x, own, np.zeros_like(own), hysteresis=True)
    # not filtered, so that it is a function of its driver
    order = np.argsort(values, kind="stable")
    curve, slope = effect.at_joint(finding.values, dynamics), _slopes(effect, finding.values, dynamics)
    std = _deviation(slope, finding.covariance)
    return FindingCurve(k, "driver", driver, key, unit, x, partial, values[order], curve[order], std[order])


def _is_friction(effect: object, joint: int) -> bool:
    if isinstance(effect, CoupledFriction):
        return joint in (effect.joint, effect.source_joint)
    if isinstance(effect, UnnamedTorque):
        own = [(effect.own_driver(quantity),) for quantity in ("velocity", "speed")]
        return effect.joint == joint and effect.of in own
    return isinstance(effect, _FRICTION) and effect.joint == joint


def _part(found: TorqueDiagnosis, chosen: Sequence[int]) -> Array:
    """Torques `(joint, sample)` that some of the findings add to the others, filtered."""
    problem, fit = found.problem, found.fit
    without = fit.values.copy()
    for k in chosen:
        without[fit.terms.slices[k]] = 0.0
    whole, rest = (problem.torque(fit.nuisance, fit.terms, values) for values in (fit.values, without))
    return whole - rest


def _friction_at(found: TorqueDiagnosis, chosen: Sequence[int], j: int, velocity: Array) -> Array:
    """Friction `(point,)` Nm of joint j, from 0, at velocities, with everything else as it typically is."""
    fit, dynamics = found.fit, found.problem.dynamics
    typical = _still(dynamics, j, velocity)
    total = np.zeros_like(velocity)
    for k in chosen:
        effect = fit.terms.terms[k]
        assert isinstance(effect, TorqueEffect)
        total = total + effect.torque(fit.values[fit.terms.slices[k]], typical)[j]
    scales = zip(fit.terms.terms, fit.terms.slices, strict=True)
    return total * (1 + sum(fit.values[part][0] for e, part in scales if isinstance(e, Scaling) and e.joint == j + 1))


def _still(dynamics: Dynamics, j: int, velocity: Array) -> Dynamics:
    """The dynamics in which only joint j, from 0, moves, its load and all temperatures at their medians."""
    shape = (len(dynamics.torque), len(velocity))
    own = np.arange(shape[0])[:, None] == j
    moving = np.where(own, velocity, 0.0)
    rise = dynamics.motion.joint_temperature_rise
    warm = None if rise is None else np.median(np.asarray(rise), axis=1, keepdims=True) * np.ones(shape)
    overall = dynamics.motion.temperature_rise
    motion: Motion = motion_of(np.zeros(shape).T, sliding=dynamics.motion.sliding.joints)._replace(
        joint_velocity=moving,  # type: ignore[arg-type]
        joint_temperature_rise=warm,  # type: ignore[arg-type]
        temperature_rise=None if overall is None else np.full(shape[1], np.median(np.asarray(overall))),  # type: ignore[arg-type]
    )
    load = np.where(own, np.median(np.abs(dynamics.torque[j])), 0.0) * np.ones(shape)
    return dynamics._replace(motion=motion, torque=load)


def _slopes(effect: JointTorque, values: Array, dynamics: Dynamics) -> Array:
    """Derivatives `(number, sample)` of an effect's torque by its numbers, by central differences."""
    steps = 1e-4 * np.array([number.typical for number in effect.coordinates])
    moved = [(effect.at_joint(values + s, dynamics), effect.at_joint(values - s, dynamics)) for s in np.diag(steps)]
    return np.stack([(up - down) / (2 * step) for (up, down), step in zip(moved, steps, strict=True)])


def _deviation(slope: Array, covariance: Array) -> Array:
    """One standard deviation `(sample,)` of what has derivatives `(number, sample)` by numbers of a covariance."""
    return np.sqrt(np.maximum(np.einsum("is,ij,js->s", slope, covariance, slope), 0.0))
