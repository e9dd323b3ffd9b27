"""Student's t for whole samples: the scale of the noise, and the weight of each sample."""

from functools import cache

import numpy as np

from lite6jax.array_types import Array

FREEDOM = 15.0
"""Degrees of freedom of the robust loss: 97 % efficient on Gaussian noise; influence falls beyond four sigma."""
DOWNWEIGHTED = 0.3
"""Weight below which a sample is an outlier; of Gaussian samples of six numbers, about four in a million."""
_LEAST_SCALE2 = float(np.sqrt(np.finfo(float).tiny))
"""The least squared scale, of residuals that are exactly zero: 1.5e-154. Squared columns over it are still finite."""


def t_scale(squares: Array, rows: int, freedom: float | None) -> float:
    """The scale that best explains squared whitened residuals of `rows` numbers each.

    Of Student's t with `freedom` it solves mean(w s) = c² rows (K. Lange, R. Little, J. Taylor, J. Am. Stat. Assoc. 84,
    1989), by Newton's method in log c², as a fixed point takes tens of rounds; the root mean square where that is None.
    """
    if freedom is None:
        return float(np.sqrt(max(np.mean(squares) / rows, _LEAST_SCALE2)))
    if not squares.any():
        return float(np.sqrt(_LEAST_SCALE2))
    scale2 = max(float(np.median(squares) or np.mean(squares)) / rows, _LEAST_SCALE2)
    for _ in range(200):
        share = squares / (freedom * scale2 + squares)
        slope = (freedom + rows) * float(np.mean(share * (1 - share)))
        step = ((freedom + rows) * float(np.mean(share)) - rows) / max(slope, 1e-6)
        scale2 = max(scale2 * float(np.exp(np.clip(step, -1.0, 1.0))), _LEAST_SCALE2)
        if abs(step) < 1e-9:
            break
    return float(np.sqrt(scale2))


@cache
def gaussian_t_scale(rows: int, freedom: float) -> float:
    """The limit of `t_scale` on Gaussian noise of unit variance, by integration over the χ² distribution."""
    s = np.linspace(0, 80, 20001)[1:]
    density = s ** (rows / 2 - 1) * np.exp(-s / 2)
    density /= density.sum()
    scale2 = 1.0
    for _ in range(200):
        scale2 = float(density @ ((freedom + rows) / (freedom + s / scale2) * s)) / rows
    return float(np.sqrt(scale2))


def weights_left(scaled: Array, freedom: float | None) -> Array:
    """The weight of each sample under the robust loss, 1 at a zero residual, towards 0 for outliers."""
    if freedom is None:
        return np.ones_like(scaled)
    return freedom / (freedom + scaled)


def curvature_share(scaled: Array, rows: int, freedom: float) -> float:
    """The mean curvature of Student's loss over that of its weighted squares; arguments as of `variance_factor`."""
    w = (freedom + rows) / (freedom + scaled)
    return float(np.mean(w - 2 * w / (freedom + scaled) * scaled / rows) / np.mean(w))


def variance_factor(scaled: Array, rows: int, freedom: float, fitted: float) -> float:
    """The factor by which an M-estimator's covariance exceeds the inverse of its weighted information JᵀWJ.

    In a regression the covariance is (JᵀJ)⁻¹ c² E[ψ²] / E[ψ′]² (P. Huber, Robust Statistics, 1981, 7.6); the
    expectations are taken over the samples.

    Args:
        scaled: squared whitened residuals over the squared scale, `(sample,)`.
        rows: numbers a sample has.
        freedom: of Student's t.
        fitted: number of parameters that were fitted; those that only a prior determines do not count.
    """
    w = (freedom + rows) / (freedom + scaled)
    spread = np.mean(w**2 * scaled) / rows / np.mean(w) / curvature_share(scaled, rows, freedom) ** 2
    return float(spread) * scaled.size * rows / max(scaled.size * rows - fitted, 1)
