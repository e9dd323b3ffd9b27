"""The inertial numbers about which torques are linearised, and the width of the prior of those that are unknown."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.effects.dynamic.friction import CoulombFriction, ViscousFriction
from lite6jax.effects.dynamic.motors import RotorInertia, TorqueOffset
from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Mask
from lite6jax.estimation.projection import schur_complement
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms

Array = NDArray[np.floating]

_EVERYWHERE = (ViscousFriction, CoulombFriction, TorqueOffset, RotorInertia)
"""What every joint has, to some degree."""
_WIDTHS = (0.03, 0.1, 0.3, 1.0, 3.0)
"""Relative standard deviations of inertial numbers that are unknown: from another series of the arm to another arm."""


def linearised(problem: TorqueProblem, options: EngineOptions, training: Mask | None = None) -> TorqueProblem:
    """The problem at the inertial numbers that fit best beside the effects that every arm has.

    Without these they would be those of an arm whose weight does what friction does, and so would its loads be. Where
    the numbers are unknown, the width of their prior is the most likely one (D. MacKay, Bayesian Interpolation, Neural
    Computation 4, 1992).

    Args:
        problem: at the declared numbers.
        options: thresholds.
        training: `(sample,)` bool; all where not given.
    """
    if not len(problem.directions):
        return problem
    slides = problem.data.arm.slides.tolist()
    terms = Terms(tuple(kind(j, of_slide=own) for kind in _EVERYWHERE for j, own in enumerate(slides, 1)))
    widths = _WIDTHS if problem.data.recording.settings.inertial == "unknown" else (1.0,)
    wider = [replace(problem, precision=problem.precision / width**2) for width in widths]
    fits = [fit(each, terms, options, training=training) for each in wider]
    time = max(score_test(wider[-1], fits[-1], options).time, 1.0)
    best = max(range(len(widths)), key=lambda k: _evidence(wider[k], fits[k], time))
    return wider[best].relinearised(fits[best].nuisance)


def _evidence(problem: TorqueProblem, found: Fit, time: float) -> float:
    """The logarithm of the marginal likelihood of a prior's width, in noise of the fit.

    What no effect explains yet is not independent from sample to sample: so many of them as their autocorrelation
    `time` says count as one. If each counted, inertial numbers would be taken as less certain for what is missing
    beside them, and would follow it.
    """
    root = np.sqrt(np.where(found.training, found.residuals.row_weight / time, 0.0))
    columns = np.concatenate([problem.nuisance_columns(found.terms, found.values), problem.columns(found.terms.terms)])
    flat = (columns * root).reshape(len(columns), -1)
    k = len(problem.precision)
    S = schur_complement(flat @ flat.T, np.arange(k, len(columns)))[:k, :k] / np.sqrt(
        np.outer(problem.precision, problem.precision)
    )
    volume = float(np.linalg.slogdet(np.eye(k) + S)[1])
    return found.log_likelihood(found.scale) / time - 0.5 * volume
