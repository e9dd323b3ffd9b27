"""The site at which what a model leaves acts, where it is one: no driver and no function has to be known for that."""

from typing import NamedTuple, final

import numpy as np

from lite6jax.estimation.evidence import Marginal
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import score_test


@final
class Concentration(NamedTuple):
    """A site along whose component most of the residuals lie.

    Attributes:
        site: which.
        share: of the squared residuals, along that component.
        expected: the share of white noise there.
        gain: log evidence of a deflection there with a number of its own in each sample.
    """

    site: str
    share: float
    expected: float
    gain: float


def concentration(problem: Problem, fit: Fit, options: EngineOptions) -> Concentration | None:
    """The site whose deflections the residuals look like; None where noise alone, or several sites, explain as much.

    A deflection moves the rows of each sample in one known direction, whatever its size is there. Of many samples one
    in several is looked at, and stands for those between.

    Args:
        problem: the data.
        fit: the model.
        options: thresholds.
    """
    every = max(fit.training.size // options.first_samples, 1) if fit.noise.white else 1
    if every > 1:
        problem, fit = problem.thinned(every), fit.thinned(every)
    several = [one for one in problem.components if np.count_nonzero(one.column.any(1)) > 1]
    if not several:
        return None
    test = score_test(problem, fit, options)
    marginal = Marginal(test)
    gains = [float(marginal.of_noise(one.column).gain) for one in several]
    best = int(np.argmax(gains))
    elsewhere = max((g for g, one in zip(gains, several, strict=True) if one.site != several[best].site), default=0.0)
    if gains[best] < options.margin + np.log(len(several)) or gains[best] < elsewhere + options.close:
        return None
    left = test.left[: problem.rows * problem.samples].reshape(problem.rows, problem.samples)
    column = test.whitened(several[best].column)
    length = np.sqrt(np.sum(column**2, 0))
    along = np.sum(column * left, 0) / np.where(length > 0, length, 1.0)
    share = float(np.sum(along**2) / max(float(np.sum(left**2)), 1e-300))
    return Concentration(several[best].site, share, 1 / problem.rows, every * gains[best])
