"""The site at which what a fit leaves acts, where it is one: no driver and no function has to be known for that."""

from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.projection import orthonormal
from lite6jax.estimation.score_test import ScoreTest, score_test

Array = NDArray[np.floating]


@final
class Concentration(NamedTuple):
    """A site along whose direction most of the residuals lie.

    Attributes:
        site: which.
        share: of the squared residuals, that a deflection there with a number of its own in each sample explains.
        expected: the share of noise that it explains.
        gain: in log-likelihood, of a deflection there with a number of its own in each sample, beyond what noise gains.
    """

    site: str
    share: float
    expected: float
    gain: float


def concentration(problem: Problem, fit: Fit, options: EngineOptions) -> Concentration | None:
    """The site at which what a fit leaves acts; None where noise may leave it, or where several sites are as likely.

    In each sample a deflection at a site moves the rows in one direction. What is left across these directions, once
    the model is refitted to that alone, does not depend on the deflections, whatever they are; in noise that is the
    same in all directions, what is left along them over that has an F distribution. Noise of the
    same size at several sites has no single direction, and that of one axis of a sensor has the same in all samples.

    Args:
        problem: the data; sites that move a single row cannot be tested.
        fit: the model.
        options: thresholds.
    """
    test = score_test(problem, fit, options)
    used = fit.training.sum()
    across, independent = (problem.rows - 1) * used - len(test.basis), used / test.time
    if across <= 0:
        return None
    total, found = float(np.sum(test.residual**2)), []
    measured = test.residual[: problem.rows * problem.samples].reshape(problem.rows, -1)
    main = np.linalg.eigh(measured @ measured.T)[1][:, -1:]
    noisy = _across(test, np.broadcast_to(main, measured.shape))
    for family in problem.curves:
        if np.count_nonzero(family.column.any(1)) > 1:
            found.append((_across(test, family.column), family.site))
    if not found:
        return None
    found.sort()
    rest, site = found[0]
    ratio = (total - rest) / used / (rest / across)
    p_value = float(fdtrc(independent, across / test.time, ratio)) * len(found)
    others = [0.5 * across / test.time * np.log(one / rest) for one in (noisy, *(one for one, _ in found[1:]))]
    if ratio < options.concentrated or p_value > options.level or min(others) < options.close:
        return None
    return Concentration(site, 1 - rest / total, 1 - across / test.freedom, 0.5 * (total - rest * (1 + used / across)))


def _across(test: ScoreTest, column: Array) -> float:
    """The squared residuals that are left where each sample has a deflection of its own, and the model is refitted."""
    rows, samples = column.shape
    direction = column / np.maximum(np.linalg.norm(column, axis=0), 1e-300)

    def without(readings: Array) -> Array:
        measured = readings[:, : rows * samples].reshape(-1, rows, samples)
        along = np.einsum("rs,krs->ks", direction, measured)
        moved = measured - direction * along[:, None]
        return np.concatenate([moved.reshape(len(readings), rows * samples), readings[:, rows * samples :]], 1)

    residual = without(test.residual[None])[0]
    inside = orthonormal(without(test.basis), test.options.rounding) @ residual
    return float(residual @ residual - inside @ inside)
