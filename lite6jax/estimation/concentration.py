"""The site at which what a model leaves acts, where it is one: no driver and no function has to be known for that."""

from typing import NamedTuple, final

import numpy as np

from lite6jax.estimation.evidence import Marginal, best_amplitude
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.thresholds import CLOSE, MARGIN


@final
class Concentration(NamedTuple):
    """A site that turns, along whose component most of the residuals lie.

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
    """The turning site whose deflections the residuals look like; None where noise or another site explains them.

    A deflection moves the rows of each sample in one known direction, whatever its size is there. The likeliest site
    that turns must exceed the others that turn by `close`, no other site may exceed it by that, and what it leaves may
    act nowhere. Of many samples one in several is looked at, and stands for those between.

    Args:
        problem: the data.
        fit: the model.
        options: thresholds.
    """
    stride = 1
    if fit.noise.white:
        stride = max(fit.training.size // options.most_samples, 1)
    if stride > 1:
        problem = problem.thinned(stride)
        fit = fit.thinned(stride)
    turning = {quantity.driver.turns for quantity in problem.quantities}
    candidates = [
        component
        for component in problem.components
        if component.site in turning and np.count_nonzero(component.column.any(1)) > 1
    ]
    if not candidates:
        return None
    test = score_test(problem, fit, options)
    marginal = Marginal(test)
    gains = {id(component): float(marginal.of_noise(component.column).gain) for component in problem.components}
    likeliest = max(candidates, key=lambda component: gains[id(component)])
    gain = gains[id(likeliest)]
    beside = max((gains[id(component)] for component in candidates if component.site != likeliest.site), default=0.0)
    if gain < MARGIN + np.log(len(gains)) or gain < beside + CLOSE:
        return None
    if gain < max(gains.values()) - CLOSE:
        return None
    residuals = test.left_of_rows
    column = test.whitened(likeliest.column)
    direction = column / np.maximum(np.linalg.norm(column, axis=0), 1e-300)
    along = np.sum(direction * residuals, 0)
    across = residuals - direction * along
    for component in problem.components:  # what is left beside the site must be noise
        moved = test.whitened(component.column)
        moved = moved - direction * np.sum(direction * moved, 0)
        squares = np.sum(moved * across, 0) ** 2
        freedom = float(test.fit.freedom) - problem.samples
        further = best_amplitude(np.sum(moved**2, 0), squares, float(np.sum(across**2)), max(freedom, 1.0))
        if float(further.gain) > MARGIN + np.log(len(gains)):
            return None
    share = float(np.sum(along**2) / max(float(np.sum(residuals**2)), 1e-300))
    return Concentration(likeliest.site, share, 1 / problem.rows, stride * gain)
