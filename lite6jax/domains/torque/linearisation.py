"""The inertial numbers about which torques are linearised, and the width of the prior of those that are unknown."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.effects.dynamic import CoulombFriction, RotorInertia, TorqueOffset, ViscousFriction
from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Mask
from lite6jax.estimation.projection import schur_complement
from lite6jax.estimation.score_test import longest_time, remaining_noise_model
from lite6jax.estimation.terms import Terms

Array = NDArray[np.floating]

_EVERYWHERE = (ViscousFriction, CoulombFriction, TorqueOffset, RotorInertia)
"""What every joint has, to some degree."""
_WIDTHS = (0.03, 0.1, 0.3, 1.0, 3.0)
"""Relative standard deviations of inertial numbers that are unknown: from another series of the arm to another arm."""
_BETWEEN = 2
"""Widths that are tried between two of these."""


def linearised(problem: TorqueProblem, options: EngineOptions, training: Mask | None = None) -> TorqueProblem:
    """The problem at the inertial numbers that fit best beside the effects that every arm has.

    Without these they would be those of an arm whose weight does what friction does, and so would its loads be. The
    `training` `(sample,)` bool is all that is valid where not given.
    """
    if not len(problem.directions):
        return problem
    training = problem.valid if training is None else training
    return problem.relinearised(fit(problem, _everywhere(problem), options, training=training).nuisance)


def with_likely_prior(problem: TorqueProblem, options: EngineOptions) -> TorqueProblem:
    """The problem with a likely width of the prior of inertial numbers, where these are unknown.

    Widths are compared by their marginal likelihood (D. MacKay, Bayesian Interpolation, Neural Computation 4, 1992) in
    the noise model of what the widest leaves. Of those that the data do not distinguish from the most likely one it is
    the widest: a prior that is too narrow leaves torques of the links, which then look like ripple or springs.
    """
    if not len(problem.directions) or problem.data.recording.settings.inertial != "unknown":
        return problem
    terms = _everywhere(problem)

    def of_width(width: float) -> TorqueProblem:
        return replace(problem, precision=problem.precision / width**2)

    widest = of_width(_WIDTHS[-1])
    noise = remaining_noise_model(widest, fit(widest, terms, options, training=problem.valid), options)
    found = fit(widest, terms, options, training=problem.valid, noise=noise)
    time = max(longest_time(widest, found, options), 1.0)

    def judged(width: float) -> float:
        each = of_width(width)
        return _evidence(each, fit(each, terms, options, training=problem.valid, noise=noise), time)

    evidence = {width: judged(width) for width in _WIDTHS[:-1]} | {_WIDTHS[-1]: _evidence(widest, found, time)}
    least = max(evidence.values()) - options.close
    likely = max(width for width, one in evidence.items() if one > least)
    # the grid is coarse, and a prior half as wide as it should be already causes false findings
    wider = [width for width in _WIDTHS if width > likely]
    for width in np.geomspace(likely, wider[0], _BETWEEN + 2)[1:-1] if wider else ():
        if judged(float(width)) <= least:
            break
        likely = float(width)
    return of_width(likely)


def _everywhere(problem: TorqueProblem) -> Terms:
    slides = problem.data.arm.slides.tolist()
    return Terms(tuple(kind(j, of_slide=own) for kind in _EVERYWHERE for j, own in enumerate(slides, 1)))


def _evidence(problem: TorqueProblem, found: Fit, time: float) -> float:
    """The logarithm of the marginal likelihood of a prior's width, in the noise model of the fit.

    What no effect explains yet is not independent from sample to sample. What the noise model leaves of that is: so
    many samples as its autocorrelation `time` says count as one. If each counted, inertial numbers would be taken as
    less certain for what is missing beside them, and would follow it.
    """
    root = np.sqrt(np.where(found.training, found.residuals.row_weight / time, 0.0))
    columns = np.concatenate([problem.nuisance_columns(found.terms, found.values), problem.columns(found.terms.terms)])
    flat = (found.noise.whitened(columns) * root).reshape(len(columns), -1)
    k = len(problem.precision)
    S = schur_complement(flat @ flat.T, np.arange(k, len(columns)))[:k, :k] / np.sqrt(
        np.outer(problem.precision, problem.precision)
    )
    volume = float(np.linalg.slogdet(np.eye(k) + S)[1])
    return found.log_likelihood(found.scale) / time - 0.5 * volume
