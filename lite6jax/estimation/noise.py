"""Noise that remembers: how much of it does, for how long, and the filter that makes it white.

Noise of which one part is an autoregression of first order and the rest is white is an ARMA(1, 1), whose innovations
are white (G. Box and G. Jenkins, Time Series Analysis, A4.4).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

Array = NDArray[np.floating]

_MEMORIES = (0.3, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 0.98, 0.99, 0.995, 0.999)
_SLOW = (0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)
_CLEARLY = 6.0
"""Log-likelihood that noise must gain by remembering, which has two numbers."""
_LAGS = 32
_SUSPICIOUS = 2.5
"""Standard deviations of the first autocorrelations, added up, under which noise is white without a closer look."""
_LEAST = 4
"""Samples in a stretch, in the mean, that remembering can be seen in."""
_MOST = 2000
"""Samples that are looked at."""


@dataclass(frozen=True, eq=False)
class Colour:
    """How noise remembers, in stretches of samples that know nothing of each other.

    Attributes:
        memory: correlation of the slow part with itself a sample later, from 0 to 1.
        slow: share of the variance that is slow, from 0 to 1.
        starts: the first sample of each stretch.
    """

    memory: float
    slow: float
    starts: tuple[int, ...] = (0,)

    def whitened(self, rows: Array) -> Array:
        """Innovations of rows `(…, sample)`, scaled so that noise of this colour keeps its variance."""
        if not self.slow:
            return rows
        theta, sigma = self._innovation
        if not rows.size:
            return rows
        change = rows.copy()
        change[..., 1:] -= self.memory * rows[..., :-1]
        band = np.stack([np.ones(rows.shape[-1]), np.full(rows.shape[-1], theta)])
        starts = np.array(self.starts)
        band[1, starts - 1] = 0.0
        # so that what the first sample of a stretch foretells of the second is their correlation
        change[..., starts] = rows[..., starts] * ((self.slow - 1) * self.memory / theta if theta else 1.0)
        flat = change.reshape(-1, rows.shape[-1]).T
        out = (solve_banded((1, 0), band, flat, check_finite=False) / sigma).T.reshape(rows.shape)
        out[..., starts] = rows[..., starts]
        return out

    def log_volume(self, samples: int) -> float:
        """The logarithm of the determinant of the filter on a row."""
        return -(samples - len(self.starts)) * float(np.log(self._innovation[1])) if self.slow else 0.0

    @property
    def length(self) -> float:
        """How many samples count as one where a signal is slow: the noise's spectrum at its lower end."""
        return 1 + 2 * self.slow * self.memory / (1 - self.memory)

    @cached_property
    def _innovation(self) -> tuple[float, float]:
        """θ of x_t − memory x_{t−1} = e_t + θ e_{t−1}, and the standard deviation of e where x has 1."""
        fast = 1 - self.slow
        same = self.slow * (1 - self.memory**2) + fast * (1 + self.memory**2)
        neighbour = -fast * self.memory
        theta = 2 * neighbour / (same + np.sqrt(max(same**2 - 4 * neighbour**2, 0.0)))
        return float(theta), float(np.sqrt(same / (1 + theta**2)))


WHITE = Colour(0.0, 0.0)


def colour_of(rows: Array, columns: Array, prior: Array, run: NDArray[np.integer]) -> Colour:
    """The likeliest colour of residuals; `WHITE` where another is not clearly likelier.

    What a fit has taken away of the noise is allowed for by the restricted likelihood (D. Harville, Journal of the
    American Statistical Association 72, 1977, eq. 3.2).

    Args:
        rows: `(row, sample)`, of one variance.
        columns: `(number, row, sample)`, what has been fitted.
        prior: `(number,)` what is known of each number beforehand: one over its standard deviation.
        run: `(sample,)`, changes where a sample knows nothing of those before it.
    """
    rows, columns, starts = rows[:, :_MOST], columns[..., :_MOST], stretches(run[:_MOST])
    if not _suspicious(rows) or len(starts) * _LEAST > rows.shape[1]:
        return WHITE

    def likelihood(colour: Colour) -> float:
        X = colour.whitened(columns).reshape(len(columns), rows.size)
        y = colour.whitened(rows).ravel()
        G = X @ X.T
        G[np.diag_indices_from(G)] += prior**2
        root = np.sqrt(np.maximum(np.diagonal(G), np.finfo(float).tiny))
        eigenvalues, V = np.linalg.eigh(G / np.outer(root, root))
        told = eigenvalues > 1e-12 * eigenvalues.max(initial=0.0)
        pull = V[:, told].T @ ((X @ y) / root)
        left = float(y @ y - np.sum(pull**2 / eigenvalues[told]))
        freedom = rows.size - int(told.sum())
        volume = float(np.sum(np.log(eigenvalues[told])) + 2 * np.sum(np.log(root)))
        return -0.5 * freedom * np.log(max(left, 1e-300)) - 0.5 * volume + len(rows) * colour.log_volume(rows.shape[1])

    coarse = [Colour(memory, slow, starts) for memory, slow in product(_MEMORIES[1::3], _SLOW[1::3])]
    best = max(coarse, key=likelihood)
    around = [
        Colour(memory, slow, starts) for memory, slow in product(_near(_MEMORIES, best.memory), _near(_SLOW, best.slow))
    ]
    best = max(around, key=likelihood)
    return replace(best, starts=stretches(run)) if likelihood(best) > likelihood(WHITE) + _CLEARLY else WHITE


def stretches(run: NDArray[np.integer]) -> tuple[int, ...]:
    """The first sample of each stretch."""
    return (0, *(int(start) for start in np.flatnonzero(np.diff(run)) + 1))


def autocorrelation(rows: Array, most: int) -> Array:
    """Of rows `(row, sample)` with what follows 0, 1, … `most` samples later, the mean over rows; 1 at none."""
    centred = rows - rows.mean(1, keepdims=True)
    power = np.abs(np.fft.rfft(centred, 2 * rows.shape[1], axis=1)) ** 2
    alike = np.fft.irfft(power.sum(0))[: most + 1]
    return alike / max(float(alike[0]), np.finfo(float).tiny)


def correlation_length(rows: Array) -> float:
    """Over how many samples residuals `(row, sample)` remember: the sum of their autocorrelation, 1 for white noise."""
    n = rows.shape[1]
    alike = autocorrelation(rows, max(n // 4, 2) - 1)
    forgotten = alike < 2 / np.sqrt(n)
    last = int(np.argmax(forgotten)) if forgotten.any() else len(alike)
    return float(1 + 2 * alike[1:last].sum())


def _suspicious(rows: Array) -> bool:
    added = np.cumsum(autocorrelation(rows, min(_LAGS, rows.shape[1] // 4))[1:])
    return bool((added * np.sqrt(rows.size / np.arange(1, len(added) + 1)) > _SUSPICIOUS).any())


def _near(grid: Sequence[float], value: float) -> Sequence[float]:
    at = grid.index(value)
    return grid[max(at - 2, 0) : at + 3]
