"""Diagnoses of simulated torques without a search, for what a report shows."""

from unittest.mock import patch

import numpy as np
from report.diagnosed import found_without_search, held_out

from lite6jax.arms.description import load_bundled
from lite6jax.arms.dynamics import inverse_dynamics, link_parameters
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.torque_diagnosis import TorqueDiagnosis
from lite6jax.domains.torque import screening
from lite6jax.domains.torque.problem import torque_problem
from lite6jax.effects.dynamic import (
    CoulombFriction,
    CoupledFriction,
    JointSpring,
    TorqueOffset,
    TorqueRipple,
    TorqueScale,
    TorqueTimeOffset,
    ViscousFriction,
)
from lite6jax.recordings import Recording, RecordingSettings
from lite6jax.search.state import Alternative

LITE6 = load_bundled("lite6")
NOISE = (0.06, 0.08, 0.05, 0.02, 0.02, 0.015)
VISCOUS, COULOMB = 2.0, 1.5
EFFECTS = (
    *(ViscousFriction(2), CoulombFriction(2), TorqueOffset(3), TorqueScale(1), JointSpring(4)),
    *(TorqueRipple(5, 3.0), CoupledFriction(6, 5), TorqueTimeOffset()),
)
"""One of each kind of curve."""


def moved(duration=16.0, rate=100.0):
    """Times, positions, velocities and accelerations of a sum of sines, `(joint, sample)`."""
    t = np.arange(0, duration, 1 / rate)
    rng = np.random.default_rng(4)
    w = 2 * np.pi * np.array([0.13, 0.21, 0.34])
    A, phase = rng.uniform(0.15, 0.4, (6, 3, 1)), rng.uniform(0, 2 * np.pi, (6, 3, 1))
    wave = w[:, None] * t + phase
    middle = LITE6.joint_limits.mean(1)[:, None]
    q = middle + np.sum(A * np.sin(wave), 1)
    return t, q, np.sum(A * w[:, None] * np.cos(wave), 1), -np.sum(A * w[:, None] ** 2 * np.sin(wave), 1)


def recorded(declared=True, friction=True, extra=None):
    """A recording of a Lite 6 whose joint 2 has friction, and `extra` `(joint, sample)` Nm where that is given."""
    t, q, dq, ddq = moved()
    torque = np.array(inverse_dynamics(LITE6.kinematics, link_parameters(LITE6), q, dq, ddq, np.array([0, 0, -9.81])))
    if friction:
        torque[1] += VISCOUS * dq[1] + COULOMB * np.sign(dq[1])
    torque += 0.0 if extra is None else extra
    torque += np.array(NOISE)[:, None] * np.random.default_rng(5).standard_normal(torque.shape)
    settings = RecordingSettings(arm="lite6", motion="trajectory", torque_source="measured")
    if declared:
        settings = RecordingSettings(arm="lite6", motion="trajectory", torque_source="measured", torque_noise_Nm=NOISE)
    return Recording.from_arrays(q.T, time=t, joint_velocity=dq.T, joint_torque=torque.T, settings=settings)


def diagnosed(recording, effects=(), faults=(), arm=LITE6):
    """The result of a search that adds just these effects: nothing is searched for, nor held out."""
    with patch.object(screening, "correct_faults", lambda screened: screened):
        problem = torque_problem(screening.screen_torques(recording, arm).data)
    rivals = (Alternative(TorqueOffset(1), 1.5), Alternative(TorqueOffset(6), 44.0))
    selection, findings = found_without_search(problem, effects, lambda _: rivals)
    folds = tuple(np.arange(problem.samples) * 5 // problem.samples == np.arange(5)[:, None])
    fits = selection.state.baseline, selection.state.fit
    errors = held_out(*(each.residuals.rows * problem.noise[:, None] for each in fits))
    return TorqueDiagnosis(problem, selection, findings, errors, faults, (), Options(), folds, ~problem.valid)
