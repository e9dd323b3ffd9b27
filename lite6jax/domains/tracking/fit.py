"""Servos, friction and delays of a log of commands and measured joints, fitted to rollouts, and what they predict."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array, Mask
from lite6jax.calibration.source import declared_arm_of
from lite6jax.domains.tracking.model import TrackingModel, compose
from lite6jax.domains.tracking.peers import best_delay
from lite6jax.domains.tracking.predict import DiagnosedServos, TrackedMotion
from lite6jax.domains.tracking.problem import TrackingProblem, diagnosed_servos, tracking_problem
from lite6jax.domains.tracking.ranges import run_ends
from lite6jax.domains.tracking.rows import TrackingRows, tracking_rows
from lite6jax.effects.catalogue import TRACKING_EFFECTS
from lite6jax.effects.dynamic import CoulombFriction, RotorInertia
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.effects.servo import CommandDelay, ServoDamping, ServoStiffness
from lite6jax.errors import InputError, require_type
from lite6jax.estimation.least_squares import Fit, fit, relinearise
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.score_test import remaining_noise_model
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording

_USUAL = (ServoStiffness, ServoDamping, CommandDelay, CoulombFriction, RotorInertia)
"""What is fitted of each joint where nothing else is asked for."""
_BLOCKS = 5
"""Of each run; every other one is held out of the fit that is judged."""
_STARTS = 8
"""Linearisations from the grid to the numbers of unknown servos."""


@final
@dataclass(frozen=True, eq=False)
class HeldOutTracking:
    """Errors of rollouts on blocks inside each run that were not fitted, RMS in rad by joint `(joint,)`.

    Attributes:
        before: of the description: of servos that are not declared that the arm is where it is commanded.
        after: of the fit to the other blocks.
        commanded: that the arm is where it is commanded.
        best_delay: that it is there after a time, which is fitted to the other blocks.
    """

    before: Array
    after: Array
    commanded: Array
    best_delay: Array


@final
@dataclass(frozen=True, eq=False)
class ServoFit:
    """The servos of a recording, fitted to rollouts from its commands alone.

    Attributes:
        problem: the recording.
        fit: of the numbers of all effects.
        heldout: errors on blocks that were not fitted.
    """

    problem: TrackingProblem
    fit: Fit
    heldout: HeldOutTracking

    @property
    def data(self) -> TrackingRows:
        """The rows that were fitted."""
        return self.problem.data

    @property
    def parameters(self) -> dict[str, dict[str, Estimate]]:
        """By effect and site, such as `command_delay:joint2`, its parameters with standard deviations.

        Those of stiffness and damping are ratios to `start`.
        """
        by_label = {}
        for term, part in self.fit.terms.pairs:
            assert isinstance(term, Effect)
            by_label[term.label] = term.reported(self.fit.values[part], self.fit.covariance[part, part])
        return by_label

    @cached_property
    def model(self) -> TrackingModel:
        """The arm with its servos as they were fitted."""
        base = TrackingModel(self.problem.servo, self.data.bodies)
        return compose(base, self.fit.terms, self.fit.values)

    @property
    def stiffness(self) -> Array:
        """`(joint,)` Nm/rad; without masses over an unknown factor."""
        return np.asarray(self.model.servo.stiffness)

    @property
    def lag(self) -> Array:
        """`(joint,)` s, by which a joint is late in slow motion beside its delay: (kd + b) / kp."""
        servo = self.model.servo
        return (np.asarray(servo.damping) + np.asarray(servo.viscous)) / self.stiffness

    @cached_property
    def diagnosed(self) -> DiagnosedServos:
        """The same as a model that predicts joints from commands."""
        readout = self.problem.readouts(np.zeros(0), self.fit.terms, self.fit.values)
        return diagnosed_servos(self.problem, self.problem.servo, self.fit.terms, self.fit.values, readout)

    def predict(self, time: ArrayLike, command: ArrayLike, run: ArrayLike | None = None) -> TrackedMotion:
        """Where the joints are in a motion, as `DiagnosedServos.predict`."""
        return self.diagnosed.predict(time, command, run)


def fit_servos(
    recording: Recording,
    arm: Arm | None = None,
    effects: Sequence[Effect] | None = None,
    options: EngineOptions | None = None,
) -> ServoFit:
    """Fits servos, friction and delays of each joint to rollouts from the commands alone.

    Servos that the sidecar does not declare, and friction and rotors that the arm's description does not, are first
    looked for in a grid. All numbers are then fitted in autocorrelated noise, from which their standard deviations are.
    Errors are those of a fit to three of five blocks in each run, on the other two.

    Args:
        recording: with times, measured joints and `commanded_position`.
        arm: the nominal arm, with masses; from the sidecar where not given.
        effects: what is fitted, of `lite6jax.effects.catalogue.tracking_catalogue`; stiffness, damping, delay, Coulomb
            friction and rotor inertia of each joint where not given.
        options: thresholds.

    Raises:
        InputError: no arm is declared, or as `tracking_rows`; an effect of a joint that the arm does not have, or two
            that are the same.
    """
    require_type("recording", recording, Recording, "lite6jax.read_recording('run7.csv')")
    arm = arm or declared_arm_of(recording)
    options = options or EngineOptions()
    terms = Terms(tuple(kind(joint) for kind in _USUAL for joint in range(1, arm.dof + 1)))
    if effects is not None:
        _check(effects, arm)
        terms = Terms(tuple(effects))
    data = tracking_rows(recording, arm)
    whole = tracking_problem(data)
    training = np.zeros(whole.samples, bool)
    for first, last in zip(*run_ends(whole.run), strict=True):
        edges = np.linspace(first, last, _BLOCKS + 1).astype(int)
        for block in range(0, _BLOCKS, 2):
            training[edges[block] : edges[block + 1]] = True
    part_problem, part_fit = _fitted(whole, terms, options, training)
    heldout = _heldout(whole, part_problem, part_fit, training)
    problem, whole_fit = _fitted(part_problem, terms, options, whole.valid, part_fit)
    return ServoFit(problem, whole_fit, heldout)


def _check(effects: Sequence[Any], arm: Arm) -> None:
    """Refuses effects that this arm cannot have, or that are none on servos."""
    for k, effect in enumerate(effects):
        named = isinstance(effect, Effect) and not effect.nonparametric
        if not named or TRACKING_EFFECTS.get(effect.name) is not type(effect):
            raise InputError(f"effects: {effect} is none on servos; take them from tracking_catalogue({arm.dof})")
        if effect.joints_needed > arm.dof:
            raise InputError(f"effects: {effect.label} is of a joint that {arm.name} does not have; it has {arm.dof}")
        if effect in effects[:k]:
            raise InputError(f"effects: {effect.label} is there twice; leave one out")


def _fitted(
    problem: TrackingProblem, terms: Terms, options: EngineOptions, training: Mask, start: Fit | None = None
) -> tuple[TrackingProblem, Fit]:
    """The problem at the numbers of unknown servos, which terms then change, and the fit of these in its noise."""
    if problem.unknowns:
        problem = relinearise(problem, options, training=training, steps=_STARTS)
        problem = replace(problem, unknowns=(), offset=np.zeros(0))
    values = None if start is None else start.values
    white = fit(problem, terms, options, values, training=training)
    noise = remaining_noise_model(problem, white, options)
    return problem, white if noise.white else fit(problem, terms, options, white.values, None, training, noise)


def _heldout(whole: TrackingProblem, problem: TrackingProblem, fitted: Fit, training: Mask) -> HeldOutTracking:
    """The errors on the samples that were not fitted."""
    data = whole.data
    commanded = np.asarray(data.recording.commanded_position).T
    after = problem.readouts(np.zeros(0), fitted.terms, fitted.values)
    before = whole.readouts(np.zeros(len(whole.unknowns)), Terms(), np.zeros(0)) if data.declared else commanded
    late = best_delay(commanded, data.measured, data.recording.run, data.commands.period, training)

    def rms(readouts: Array) -> Array:
        return np.sqrt(np.mean((readouts - data.measured)[:, ~training] ** 2, 1))

    return HeldOutTracking(rms(before), rms(after), rms(commanded), rms(late))
