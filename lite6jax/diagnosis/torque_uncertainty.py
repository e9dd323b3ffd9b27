"""How uncertain the model of a diagnosis of torques is: the covariance of all its numbers, and what is left of it."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.joint_units import as_revolute
from lite6jax.diagnosis.uncertainty import covariance_of, excess, relative_error, rows_kept, spacing_of
from lite6jax.domains.torque.predict import shown_torques
from lite6jax.domains.torque.uncertainty import (
    RecordedMotion,
    TorqueUncertainty,
    driver_values,
    states_of,
    with_free_numbers,
)
from lite6jax.effects.dynamic.unnamed import UnnamedTorque

if TYPE_CHECKING:
    from lite6jax.diagnosis.torque_result import TorqueDiagnosis

Array = NDArray[np.floating]

_SQUARE = 3.8415
"""Squared standard deviations within which a share of `uncertainty.LEVEL` of a normal distribution lies."""


def torque_uncertainty_of(found: "TorqueDiagnosis") -> TorqueUncertainty:
    """How uncertain predictions of a diagnosed model of torques are.

    What is left of the model is calibrated on held-out rows: with it, with the noise of a row and with the uncertainty
    of the numbers, 95 % of the errors of each joint are as large as they are.
    """
    problem, fit = found.problem, found.fit
    terms, values = with_free_numbers(fit.terms, fit.values)
    columns = problem.nuisance_columns(fit.terms, fit.values)
    if terms.size:
        columns = np.concatenate([columns, problem.columns(terms.terms, values, (fit.terms, fit.values))])
    C = covariance_of(fit, problem.valid, columns, np.concatenate([problem.precision, terms.precision]))
    moved = columns * problem.sigma
    estimated = np.einsum("ias,ij,jas->as", moved, C, moved, optimize=True)
    left, unseen, noise = _left(found, estimated)
    curves = tuple(
        _size(found, k) if isinstance(effect, UnnamedTorque) else None for k, effect in enumerate(fit.terms.terms)
    )
    return TorqueUncertainty(len(problem.directions) > 0, C, left, unseen, noise, curves, _recorded(found))


def _left(found: "TorqueDiagnosis", estimated: Array) -> tuple[Array, Array, Array]:
    """What is left, what may be left unseen, and the noise of a row, `(joint,)` Nm each.

    Held-out errors are those of filtered torques. What the filter takes from a row is added: a prediction is not
    filtered. The noise is the declared one, or less where the residuals are less.
    """
    problem, fit, kept = found.problem, found.fit, found.problem.valid
    data = problem.data
    dynamics = data.bodies.dynamics(problem.links_at(fit.nuisance))
    time = np.asarray(dynamics.motion.time)
    rough = shown_torques(fit.terms, fit.values, dynamics, time, data.filter.runs) - data.torque
    fine = (rough - data.filter.whole(rough))[:, data.filter.kept[problem.chosen]]
    squares = (found.after + fine)[:, kept] ** 2 / _SQUARE
    spread = 1.4826 * np.median(np.abs(rough), axis=1)
    declared = problem.noise * np.sqrt(data.filter.every)
    noise = np.minimum(spread, declared) if problem.declared else spread
    folds = len(found.folds)
    fewer = folds / (folds - 1)  # numbers that were estimated without a block
    left, unseen = np.zeros((2, problem.rows))
    moving = problem.sigma[:, kept] <= 1.01 * problem.noise[:, None]  # not held at rest by friction
    for j in range(problem.rows):
        worth = moving[j].sum() / fit.noise.models[j].time
        left[j] = excess((squares[j] - fewer * estimated[j, kept])[moving[j]], float(noise[j]), worth)
        unseen[j] = np.sqrt(relative_error(worth) * (noise[j] ** 2 + left[j] ** 2))
    return left, unseen, noise


def _size(found: "TorqueDiagnosis", k: int) -> float:
    """Nm RMS that an effect adds to its joint."""
    problem, fit = found.problem, found.fit
    effect, part = fit.terms.terms[k], fit.terms.slices[k]
    assert isinstance(effect, UnnamedTorque)
    moved = np.tensordot(fit.values[part], problem.columns([effect]), 1) * problem.sigma
    return float(np.sqrt(np.mean(moved[effect.joint - 1, problem.valid] ** 2)))


def _recorded(found: "TorqueDiagnosis") -> RecordedMotion:
    problem = found.problem
    kept = np.flatnonzero(problem.valid)
    at = problem.data.filter.kept[problem.chosen]
    dynamics = problem.data.bodies.dynamics(problem.links_at(found.fit.nuisance))
    states = states_of(dynamics)[..., at]
    q = states[0].T
    rows = rows_kept(kept)
    return RecordedMotion(
        ranges=np.stack([states[..., kept].min(-1), states[..., kept].max(-1)], -1),
        positions=np.round(q[rows], 5),
        spacing=spacing_of(as_revolute(q.T, "rad", problem.data.arm.slides).T, kept, rows, found.folds),
        drivers={
            phrase: (float(values[at][kept].min()), float(values[at][kept].max()))
            for phrase, values in driver_values(found.fit.terms, dynamics).items()
        },
    )
