"""The position gain of a servo, from friction that torques show in Nm and commands show in radians.

A joint with Coulomb friction c stays behind its command by c / kp. A rollout from commands therefore shows c only
beside a gain kp that is declared or fitted, and a wrong gain makes the friction wrong by the same factor. Measured
torques show c itself. With c_τ from the torques, and c and kp from the commands:

    kp_τ = kp · c_τ / c

Its relative variance is that of c_τ and that of kp / c together.
"""

from typing import Any, NamedTuple

import numpy as np

from lite6jax.array_types import Array
from lite6jax.diagnosis.agreement import Agreement, EffectEstimate, compare_estimates
from lite6jax.diagnosis.result import DomainDiagnosis
from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.domains.tracking.problem import TrackingProblem
from lite6jax.effects.dynamic import CoulombFriction, Friction
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.effects.servo import ServoStiffness

_LARGEST_SPREAD = 0.2
"""Relative standard deviation of a friction, below which a ratio of two is nearly normal."""


class _Servo(NamedTuple):
    """What commands show of a joint's servo.

    Attributes:
        gain: Nm/rad, declared or fitted, with its standard deviation.
        friction: Nm, the Coulomb friction of the joint beside this gain.
        ratio_spread: relative standard deviation of the gain over the friction.
    """

    gain: Estimate
    friction: Estimate
    ratio_spread: float


def compare_gains(
    torques: DomainDiagnosis[TorqueProblem], commands: DomainDiagnosis[TrackingProblem]
) -> tuple[Agreement, ...]:
    """The position gain of each joint whose Coulomb friction both domains show, as `Agreement`.

    The side `torques` is kp_τ. The side `tracking` is the declared gain, or the fitted one where the arm has masses;
    else None, as commands then show gains only up to a factor. A joint is left out where the torques have no finding of
    Coulomb friction or one of a law that the commands do not show, and where either friction is vague.
    """
    problem = commands.problem
    frictions = {joint: _measured_friction(torques, joint) for joint in range(1, problem.rows + 1)}
    measured = {joint: friction for joint, friction in frictions.items() if friction is not None}
    if not measured:
        return ()
    covariance = _covariance(commands)
    is_gain_shown = problem.data.declared or problem.data.has_masses
    agreements = []
    for joint, friction in measured.items():
        if _friction_names(torques, joint) - _friction_names(commands, joint):
            continue
        servo = _servo(commands, joint, covariance)
        if not (_is_certain(friction) and _is_certain(servo.friction)):
            continue
        gain = servo.gain.value * friction.value / servo.friction.value
        spread = gain * float(np.hypot(friction.std / friction.value, servo.ratio_spread))
        sides = {
            "torques": _gain(Estimate(gain, spread)),
            "tracking": _gain(servo.gain) if is_gain_shown else None,
        }
        agreements.append(compare_estimates({"quantity": "position_gain", "site": f"joint{joint}"}, sides))
    return tuple(agreements)


def _is_certain(friction: Estimate) -> bool:
    return friction.std < _LARGEST_SPREAD * friction.value


def _gain(estimate: Estimate) -> EffectEstimate:
    covariance = np.array([[estimate.std**2]])
    return EffectEstimate(True, np.array([estimate.value]), covariance, {"stiffness_Nm_per_rad": estimate})


def _friction_names(diagnosis: DomainDiagnosis[Any], joint: int) -> set[str]:
    """The laws of friction that were found at a joint, but for Coulomb's and viscous friction."""
    common = {"coulomb_friction", "viscous_friction"}
    effects = [finding.effect for finding in diagnosis.findings]
    return {effect.name for effect in effects if isinstance(effect, Friction) and effect.joint == joint} - common


def _measured_friction(torques: DomainDiagnosis[TorqueProblem], joint: int) -> Estimate | None:
    """The Coulomb friction of a joint by the torques, Nm, what is declared included; None where no finding says it."""
    declared = torques.problem.data.arm.coulomb_friction
    label = CoulombFriction(joint).label
    finding = next((finding for finding in torques.findings if finding.effect.label == label), None)
    if finding is None:
        return None
    value = float(finding.values[0])
    if declared is not None:
        value += float(declared[joint - 1])
    return Estimate(value, float(np.sqrt(finding.covariance[0, 0])))


def _servo(commands: DomainDiagnosis[TrackingProblem], joint: int, covariance: Array) -> _Servo:
    """The gain and friction of a joint, by the fit of the unknown numbers of its servo and of the findings.

    The covariance is that of `_covariance`.
    """
    problem = commands.problem
    fit = commands.fit
    servo = problem.servo_at(fit.nuisance)
    log_gain = float(np.log(servo.stiffness[joint - 1]))
    friction = float(servo.coulomb[joint - 1])
    by_gain = np.zeros(len(covariance))
    by_friction = np.zeros(len(covariance))
    for k, unknown in enumerate(problem.unknowns):
        if unknown.joint == joint - 1:
            by_gain[k] = float(unknown.field == "stiffness")
            by_friction[k] = friction * float(unknown.field == "coulomb")
    unknown_count = len(problem.unknowns)
    for effect, numbers in fit.terms.pairs:
        if not isinstance(effect, Effect):
            continue
        if effect == ServoStiffness(joint):
            log_gain += float(fit.values[numbers][0])
            by_gain[unknown_count + numbers.start] = 1.0
        if effect.label == CoulombFriction(joint).label:
            friction += float(fit.values[numbers][0])
            by_friction[unknown_count + numbers.start] = 1.0
    friction_std = float(np.sqrt(by_friction @ covariance @ by_friction))
    gain = float(np.exp(log_gain))
    gain_std = gain * float(np.sqrt(by_gain @ covariance @ by_gain))
    ratio = by_gain - by_friction / max(friction, 1e-12)
    ratio_spread = float(np.sqrt(ratio @ covariance @ ratio))
    return _Servo(Estimate(gain, gain_std), Estimate(friction, friction_std), ratio_spread)


def _covariance(commands: DomainDiagnosis[TrackingProblem]) -> Array:
    """`(number, number)`, of the unknown numbers of servos and of the findings, in white noise of what is left."""
    problem = commands.problem
    fit = commands.fit
    scale = np.asarray(fit.scale)[:, None]
    blocks = [problem.nuisance_columns(fit.terms, fit.values)]
    if fit.terms.size:
        blocks.append(problem.columns(fit.terms.terms, fit.values))
    trained = np.concatenate(blocks)[:, :, fit.training] / scale
    columns = trained.reshape(len(trained), trained.shape[1] * trained.shape[2])
    spreads = [coordinate.spread for term in fit.terms.terms for coordinate in term.coordinates]
    prior = np.concatenate([problem.precision, np.array(spreads, float) ** -2])
    return np.linalg.pinv(columns @ columns.T + np.diag(prior))
