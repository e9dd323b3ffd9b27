"""Standard deviations of fitted numbers from their scatter as blocks of samples are left out.

A standard deviation from a fit holds if the model does, but for noise. What the model lacks differs from one part of a
recording to another, and so do numbers that are fitted without that part.
"""

from collections.abc import Sequence

import numpy as np

from lite6jax.array_types import Array, Mask
from lite6jax.estimation.least_squares import Fit, linear_columns
from lite6jax.estimation.problem import LinearisedProblem, linearised_at, prior_precision
from lite6jax.estimation.projection import scaled_inverse
from lite6jax.estimation.robust import FREEDOM, variance_factor
from lite6jax.estimation.terms import Terms

_FEWEST = 4.0
"""Least effective number of blocks, (Σv)² / Σv² of the expected squares v, from which their scatter says something."""
_ROUNDING = 1e-9
"""Relative, by which rounding may make a number more certain without a block than with it."""


def stds_over_blocks(
    problem: LinearisedProblem, fitted: Fit, terms: Terms, values: Array, blocks: Sequence[Mask]
) -> Array:
    """The standard deviation `(terms.size,)` of each number from its scatter over blocks of samples.

    σ² = f · diag(H⁻¹) · Σ_b δ_b² / Σ_b E[δ_b²]

    H is the information of all samples, and f the factor of the weights of Student's t. Each block b is left out once,
    and numbers and nuisance are fitted to the others, to first order: δ_b = (H − H_b)⁻¹ g_b is by how much the estimate
    changes, with g the weighted residuals along the columns. In independent noise of variance s its expected square is
    s · diag((H − H_b)⁻¹ − H⁻¹). The ratio of sums has blocks which know much and little of a number count alike (the
    jackknife by groups: J. Shao and C. Wu, The Annals of Statistics 17, 1989).

    Args:
        problem: that was fitted.
        fitted: with its noise model and weights.
        terms: of the model, or the same with numbers released that were held fixed.
        values: `(terms.size,)`, their numbers at the estimate.
        blocks: `(sample,)` each; samples in none of them always stay.

    Returns:
        about those of the fit where the model holds, and larger where it does not; those of the fit where too few
        blocks determine a number to say.
    """
    nuisance = fitted.nuisance
    columns = linear_columns(linearised_at(problem, nuisance), terms, values)
    for row in range(problem.rows):  # all at once would take as much memory again
        columns[:, [row]] = fitted.noise.of_row(row).whitened(columns[:, [row]])
    count = len(columns)
    row_weight = np.where(fitted.training, fitted.residuals.row_weight, 0.0)
    pull = row_weight * fitted.residuals.innovations
    # variance of a weighted residual over its weight, which the weights of Student's t make less than one
    unit = float(np.sum(pull**2) / np.sum(row_weight))
    precision = np.concatenate([problem.precision, prior_precision(problem, terms.terms)])
    H = np.diag(precision)
    blocks = [block & fitted.training for block in blocks]
    stays = fitted.training & ~np.any(blocks, axis=0)
    information = [_products(columns[..., part], row_weight[:, part]) for part in (*blocks, stays)]
    H = H + np.sum(information, 0)
    numbers = np.arange(count - terms.size, count)
    variance = np.diagonal(scaled_inverse(H))[numbers]
    squares = np.zeros(terms.size)
    expected = np.zeros((len(blocks), terms.size))
    everywhere = np.ones(terms.size, bool)
    for k, block in enumerate(blocks):
        inverse = scaled_inverse(H - information[k])
        gradient = np.tensordot(columns[..., block], pull[:, block], 2)
        moved = (inverse @ gradient)[numbers]
        gained = np.diagonal(inverse)[numbers] - variance
        # of what no other block determines the inverse is zero, or what rounding leaves of it
        everywhere &= gained > -_ROUNDING * variance
        expected[k] = unit * np.maximum(gained, 0.0)
        squares += moved**2
    total = expected.sum(0)
    alike = np.divide(total**2, np.sum(expected**2, 0), out=np.zeros_like(total), where=total > 0)
    enough = everywhere & (alike >= _FEWEST)
    scatter = np.divide(squares, total, out=np.ones_like(total), where=enough)
    factor = variance_factor(fitted.residuals.squares[fitted.training], problem.rows, FREEDOM, 0)
    return np.sqrt(scatter * variance * factor)


def _products(columns: Array, weight: Array) -> Array:
    """The information `(number, number)` of columns `(number, row, sample)` with weights `(row, sample)`."""
    flat = (columns * np.sqrt(weight)).reshape(len(columns), -1)
    return flat @ flat.T
