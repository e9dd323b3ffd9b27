"""Autocorrelated noise: its model for each group of rows, and the filter that whitens it.

Noise that is the sum of a first-order autoregression and white noise is an ARMA(1, 1) process, whose innovations are
white (G. Box and G. Jenkins, Time Series Analysis, A4.4).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise, product
from typing import final

import numpy as np
import scipy  # whose parts are imported where they are first used: `signal` alone takes most of a second

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.projection import half_inverse
from lite6jax.estimation.thresholds import EIGENVALUE_ROUNDING

_LAGS = 32
"""Lags of the portmanteau statistic, which cover autocorrelation times to about ten samples."""
_SUSPICIOUS = 2.5
"""Standard deviations of summed autocorrelations below which noise is taken as white; saves time."""
_LEAST_IN_RUN = 4
"""Mean samples of a run from which autocorrelation is estimated, as it has two parameters."""
_MOST_FOR_NOISE = 2000
"""Samples from which the noise model is estimated; it is then known to 3 %."""

_COEFFICIENTS = (0.3, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 0.98, 0.99, 0.995, 0.999)
_FORGOTTEN = 3.0
"""Times in the samples, at least, that noise takes to forget: what stays longer is an offset or a drift."""
_SCALINGS = 3
"""Estimates of the variance, each with the numbers that the last one determines."""
_SHARES = (0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)
_LEAST_WHITE = 1e-3
"""Share of the variance that counts as white at least where the white part has a least size."""


@final
@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """The autocorrelation of one group of rows, independent between runs.

    Attributes:
        coefficient: of the autoregressive part, from 0 to 1.
        share: of the variance that is autoregressive, from 0 to 1; the rest is white.
    """

    coefficient: float
    share: float

    def whitened(self, rows: Array, starts: Sequence[int]) -> Array:
        """Innovations of rows `(…, sample)`, scaled so that noise of this model keeps its variance.

        Args:
            rows: the sample last.
            starts: the first sample of each run.
        """
        if not self.share or not rows.size:
            return rows
        theta, sigma = self._innovation
        first = np.asarray(starts)
        out = np.empty_like(rows)
        ahead = self._ahead
        for begin, end in pairwise([*starts, rows.shape[-1]]):
            before = rows[..., begin : begin + 1] * (ahead / sigma)
            run = scipy.signal.lfilter(
                [1 / sigma, -self.coefficient / sigma], [1.0, theta], rows[..., begin:end], zi=before
            )
            out[..., begin:end] = run[0]
        out[..., first] = rows[..., first]
        return out

    def transposed(self, rows: Array, starts: Sequence[int]) -> Array:
        """The transpose of `whitened`: sums of products with rows `(…, sample)` of whitened ones are those with this.

        Args:
            rows: the sample last.
            starts: the first sample of each run.
        """
        if not self.share or not rows.size:
            return rows
        theta, sigma = self._innovation
        out = np.empty_like(rows)
        for begin, end in pairwise([*starts, rows.shape[-1]]):
            later = rows[..., begin + 1 : end][..., ::-1]
            first = rows[..., begin]
            if later.shape[-1]:
                run = scipy.signal.lfilter([1 / sigma, -self.coefficient / sigma], [1.0, theta], later)
                out[..., begin + 1 : end] = run[..., ::-1]
                echoes = scipy.signal.lfilter([1.0], [1.0, theta], later)[..., -1]
                first = first + self._after_first * echoes
            out[..., begin] = first
        return out

    def log_volume(self, samples: int, runs: int) -> float:
        """The logarithm of the determinant of the whitening filter of a row."""
        if self.share:
            return -(samples - runs) * float(np.log(self._innovation[1]))
        return 0.0

    @property
    def time(self) -> float:
        """The autocorrelation time in samples: the noise's spectrum at frequency zero over that of white noise."""
        return 1 + 2 * self.share * self.coefficient / (1 - self.coefficient)

    @property
    def _ahead(self) -> float:
        """What the state of the filter is before a run, over its first sample and by σ.

        The second sample is then predicted from the first by their correlation.
        """
        theta, _ = self._innovation
        return ((self.share - 1) * self.coefficient / theta if theta else 1.0) - 1

    @property
    def _after_first(self) -> float:
        """What the state of the filter is after the first sample of a run, over it."""
        theta, sigma = self._innovation
        return (-self.coefficient - theta * (1 + self._ahead)) / sigma

    @cached_property
    def _innovation(self) -> tuple[float, float]:
        """θ of x_t − coefficient·x_{t−1} = e_t + θ e_{t−1}, and the standard deviation of e where x has 1."""
        white = 1 - self.share
        variance = self.share * (1 - self.coefficient**2) + white * (1 + self.coefficient**2)
        neighbour = -white * self.coefficient
        theta = 2 * neighbour / (variance + np.sqrt(max(variance**2 - 4 * neighbour**2, 0.0)))
        return float(theta), float(np.sqrt(variance / (1 + theta**2)))


UNCORRELATED = Autocorrelation(0.0, 0.0)


@final
@dataclass(frozen=True, eq=False)
class NoiseModel:
    """The autocorrelation of every group of rows.

    Attributes:
        models: one for each group.
        groups: `(row,)` int, the group of each row.
        starts: the first sample of each run.
        price: −ln of the prior probability of the groups that are autocorrelated, any of the models tried.
    """

    models: tuple[Autocorrelation, ...]
    groups: Integers
    starts: tuple[int, ...] = (0,)
    price: float = 0.0

    @property
    def white(self) -> bool:
        """Tells whether no group is autocorrelated."""
        return not any(model.share for model in self.models)

    def least_scales(self, declared: float) -> Array:
        """The least scale of each group `(group,)` at which the white part of its noise is not less than declared.

        What is autocorrelated comes on top of what a read-out does from sample to sample.
        """
        white_shares = np.array([1 - model.share for model in self.models])
        return declared / np.sqrt(np.maximum(white_shares, _LEAST_WHITE))

    def of_row(self, row: int) -> "NoiseModel":
        """The model of one row alone."""
        return replace(self, groups=self.groups[row : row + 1])

    def between(self, every: int, run: Integers) -> "NoiseModel":
        """The model of all samples, of which this is that of one in `every`.

        Args:
            every: how many samples are between two of these.
            run: `(sample,)` of all, changes where a sample is independent of those before it.
        """
        if self.white:
            return self
        models = (replace(model, coefficient=model.coefficient ** (1 / every)) for model in self.models)
        return NoiseModel(tuple(models), self.groups, run_starts(run), self.price)

    def transposed(self, rows: Array) -> Array:
        """The transpose of `whitened`, of rows `(…, row, sample)`."""
        if self.white:
            return rows
        out = np.empty_like(rows)
        for group, model in enumerate(self.models):
            in_group = self.groups == group
            out[..., in_group, :] = model.transposed(rows[..., in_group, :], self.starts)
        return out

    def whitened(self, rows: Array) -> Array:
        """Innovations of rows `(…, row, sample)`."""
        if self.white:
            return rows
        out = np.empty_like(rows)
        for group, model in enumerate(self.models):
            in_group = self.groups == group
            group_rows = rows[..., in_group, :]
            acting = group_rows.any((-2, -1))  # most terms act on few groups
            group_rows[acting] = model.whitened(group_rows[acting], self.starts)
            out[..., in_group, :] = group_rows
        return out

    def log_volume(self, training: Mask) -> float:
        """The logarithm of the determinant of the whitening filter of all rows, of the samples `(sample,)` used."""
        counts = np.bincount(self.groups, minlength=len(self.models))
        samples = int(training.sum())
        runs = int(training[list(self.starts)].sum())
        return float(sum(n * m.log_volume(samples, runs) for n, m in zip(counts, self.models, strict=True)))


def white_noise(groups: Integers) -> NoiseModel:
    """The model without autocorrelation, of rows in these groups."""
    return NoiseModel((UNCORRELATED,) * (int(groups.max(initial=0)) + 1), groups)


def noise_model(
    rows: Array,
    columns: Array,
    prior: Array,
    groups: Integers,
    run: Integers,
    options: EngineOptions,
    start: NoiseModel | None = None,
    declared: Array | None = None,
) -> NoiseModel:
    """The most likely noise model of residuals; a group stays white where the likelihood gains less than the price.

    The noise that a fit has absorbed is accounted for by the restricted likelihood (REML; D. Harville, Journal of the
    American Statistical Association 72, 1977, eq. 3.2), in which numbers with a prior are random.

    Args:
        rows: residuals `(row, sample)`, of one variance in each group.
        columns: `(number, row, sample)`, of what has been fitted, in the unit of the residuals.
        prior: `(number,)`, one over the standard deviation of each number's prior.
        groups: `(row,)`.
        run: `(sample,)`, changes where a sample is independent of those before it.
        options: thresholds.
        start: of a similar fit: where a group is autocorrelated there, its model is improved, and no other is tried.
        declared: `(group,)`, in the unit of the residuals, what the white part of the noise has at least; zero where
            not given.
    """
    models = list[Autocorrelation]()
    total_price = 0.0
    for group in range(int(groups.max(initial=0)) + 1):
        in_group = groups == group
        samples = slice(None, _MOST_FOR_NOISE)
        group_columns = columns[:, in_group, samples]
        acting = group_columns.any((1, 2))  # numbers that do not act on this group change all likelihoods alike
        before = UNCORRELATED if start is None else start.models[group]
        least = 0.0 if declared is None else float(declared[group])
        model, price = _autocorrelation(
            rows[in_group, samples], group_columns[acting], prior[acting], run[samples], options, before, least
        )
        models.append(model)
        total_price = total_price + price
    return NoiseModel(tuple(models), groups, run_starts(run), total_price)


def _autocorrelation(
    rows: Array,
    columns: Array,
    prior: Array,
    run: Integers,
    options: EngineOptions,
    before: Autocorrelation,
    declared: float,
) -> tuple[Autocorrelation, float]:
    """The most likely model of a group, and its price."""
    starts = run_starts(run)
    if not _suspicious(rows) or len(starts) * _LEAST_IN_RUN > rows.shape[1]:
        return UNCORRELATED, 0.0

    @cache
    def likelihood(pair: tuple[float, float]) -> float:
        model = Autocorrelation(*pair)
        X = model.whitened(columns, starts).reshape(len(columns), rows.size)
        y = model.whitened(rows, starts).ravel()
        measured = X @ X.T
        target = X @ y
        least = declared**2 / max(1 - model.share, _LEAST_WHITE)
        scale = max(float(y @ y) / rows.size, least)
        filtered = len(rows) * model.log_volume(rows.shape[1], len(starts))
        log_likelihood = -np.inf
        for _ in range(_SCALINGS):
            # a prior is in absolute units: beside noise of another variance it weighs otherwise
            G = measured + scale * np.diag(prior**2)
            T, volume = half_inverse(G, EIGENVALUE_ROUNDING)
            residual_sum = max(float(y @ y - np.sum((T.T @ target) ** 2)), 1e-300)
            freedom = rows.size - T.shape[1]
            log_likelihood = -0.5 * freedom * np.log(scale) - 0.5 * volume - 0.5 * residual_sum / scale + filtered
            # tr measured G⁻¹: the numbers that are determined, less what of them the prior is
            determined = T.shape[1] - scale * float(prior**2 @ np.sum(T**2, 1))
            scale = max(residual_sum / max(rows.size - determined, 1.0), least)
        return log_likelihood

    coefficient_grid = coefficients(min(rows.shape[1], _FORGOTTEN * options.longest_memory))
    best_pair = (before.coefficient, before.share)
    climbed = None
    if not before.share or before.coefficient not in coefficient_grid:
        best_pair = max(product(coefficient_grid[1::3], _SHARES[1::3]), key=likelihood)
    while best_pair != climbed:
        climbed = coefficient, share = best_pair
        near = [(neighbour, share) for neighbour in _near(coefficient_grid, coefficient)]
        near += [(coefficient, neighbour) for neighbour in _near(_SHARES, share)]
        best_pair = max(near, key=likelihood)
    price = options.prior.cost("autocorrelated_noise") + float(np.log(len(coefficient_grid) * len(_SHARES)))
    if likelihood(best_pair) > likelihood((0.0, 0.0)) + price:
        return Autocorrelation(*best_pair), price
    return UNCORRELATED, 0.0


def coefficients(samples: float) -> Sequence[float]:
    """Coefficients of autoregressions, those that forget within so many samples, and two at least."""
    return _COEFFICIENTS[: max(sum((1 - coefficient) * samples >= _FORGOTTEN for coefficient in _COEFFICIENTS), 2)]


def run_starts(run: Integers) -> tuple[int, ...]:
    """The first sample of each run."""
    return (0, *(int(start) for start in np.flatnonzero(np.diff(run)) + 1))


def autocorrelation(rows: Array, most: int) -> Array:
    """The autocorrelation of rows `(row, sample)` at lags 0, 1, … `most`, mean over rows; 1 at lag 0."""
    centred = rows - rows.mean(1, keepdims=True)
    power = np.abs(np.fft.rfft(centred, 2 * rows.shape[1], axis=1)) ** 2
    covariance = np.fft.irfft(power.sum(0))[: most + 1]
    return covariance / max(float(covariance[0]), np.finfo(float).tiny)


def autocorrelation_time(rows: Array) -> float:
    """The autocorrelation time of rows `(row, sample)` in samples, 1 for white noise: the sum over significant lags."""
    n = rows.shape[1]
    correlation = autocorrelation(rows, max(n // 4, 2) - 1)
    insignificant = correlation < 2 / np.sqrt(n)
    last = int(np.argmax(insignificant)) if insignificant.any() else len(correlation)
    return float(1 + 2 * correlation[1:last].sum())


def _suspicious(rows: Array) -> bool:
    summed = np.cumsum(autocorrelation(rows, min(_LAGS, rows.shape[1] // 4))[1:])
    return bool((summed * np.sqrt(rows.size / np.arange(1, len(summed) + 1)) > _SUSPICIOUS).any())


def _near(grid: Sequence[float], value: float) -> Sequence[float]:
    at = grid.index(value)
    return grid[max(at - 1, 0) : at + 2]
