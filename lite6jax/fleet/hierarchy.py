"""The hierarchical model of one effect over arms: a mean of the type, arms that vary about it, and measurements.

The numbers of arm a are βₐ = μ + bₐ with bₐ ~ N(0, τ²D²): D holds the typical size of each number. What the recording
of an arm says of βₐ is a normal likelihood, which need not determine all of its numbers, so that everything is written
with its information Λₐ. τ is estimated by restricted maximum likelihood (D. Harville, Journal of the American
Statistical Association 72, 1977), the estimates of arms are those of empirical Bayes (C. Morris, ibid. 78, 1983), and
intervals of μ are those of J. Hartung and G. Knapp (Statistics in Medicine 20, 2001), never narrower than without their
scale (C. Röver et al., BMC Medical Research Methodology 15, 2015).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtrc, fdtrc, stdtrit

from lite6jax.array_types import Array
from lite6jax.estimation.projection import diagonal_root, scaled_inverse

_LEVEL = 0.95
_ROUNDING = 1e-12
_RANK = 1e-10
"""Eigenvalue of a matrix of unit diagonal below which a direction is not determined."""
_RANGE = 1e4
"""Between-arm standard deviations are looked for up to so many standard errors of an arm, and down to one over it."""
_STEPS = 33


@final
@dataclass(frozen=True, eq=False)
class ArmLikelihoods:
    """What each arm's recording says of the numbers of one effect.

    Attributes:
        score: `(arm, number)`, of the log-likelihood at zero.
        information: `(arm, number, number)`; zero of an arm that does not show the effect.
        typical: `(number,)`, common sizes: D.
        variance: of the mean's prior, as of the coefficients of a process; infinite of what is not known beforehand.
    """

    score: Array
    information: Array
    typical: Array
    variance: float = np.inf

    def without(self, arm: int) -> "ArmLikelihoods":
        """Those of all arms but one."""
        other_arms = np.arange(len(self.score)) != arm
        return replace(self, score=self.score[other_arms], information=self.information[other_arms])

    @cached_property
    def eigen(self) -> tuple[Array, Array, Array]:
        """Eigenvalues `(arm, number)` and vectors of the information in typical sizes, and the score along these."""
        D = self.typical
        values, U = np.linalg.eigh(self.information * np.outer(D, D))
        values = np.where(values > _ROUNDING * max(float(values.max(initial=0.0)), 1e-300), values, 0.0)
        along = np.einsum("aji,aj->ai", U, self.score * D)
        return values, U, np.where(values > 0, along, 0.0)

    def solved(self, tau: float) -> tuple[Array, Array, float, float]:
        """At one τ: the means `(number,)` in typical sizes, their information, and log-likelihoods.

        Returns:
            means, information, the log-likelihood with the means at their best, less that of no effect in any arm, and
            what is maximised over τ, the restricted log-likelihood.
        """
        values, U, along = self.eigen
        shrunk = 1 / (1 + tau**2 * values)
        M = np.einsum("aij,aj,akj->ik", U, values * shrunk, U) + np.diag(self.typical**2 / self.variance)
        v = np.einsum("aij,aj->i", U, shrunk * along)
        root = diagonal_root(M)
        scaled, V = np.linalg.eigh(M / np.outer(root, root))
        determined = scaled > _RANK
        inverse = (V[:, determined] / scaled[determined]) @ V[:, determined].T / np.outer(root, root)
        mean = inverse @ v
        without_mean = 0.5 * float(np.sum(tau**2 * shrunk * along**2) + np.sum(np.log(shrunk)))
        likely = without_mean + 0.5 * float(v @ mean)
        volume = float(np.sum(np.log(scaled[determined])) + 2 * np.sum(np.log(root[np.diagonal(M) > 0])))
        return mean, M, likely, likely - 0.5 * volume


@final
@dataclass(frozen=True, eq=False)
class Hierarchy:
    """The hierarchical model fitted.

    Attributes:
        arms: what it was fitted to.
        tau: between-arm standard deviation in typical sizes.
        mean: `(number,)`.
        covariance: `(number, number)`, of the mean.
        freedom: degrees of freedom of its intervals.
    """

    arms: ArmLikelihoods
    tau: float
    mean: Array
    covariance: Array
    freedom: float

    @property
    def between(self) -> Array:
        """`(number,)`, the standard deviation between arms."""
        return self.tau * self.arms.typical

    @property
    def std(self) -> Array:
        """`(number,)`, of the mean."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))

    @property
    def half_width(self) -> Array:
        """`(number,)`, half of the 95 % interval of the mean."""
        return float(stdtrit(self.freedom, 0.5 + _LEVEL / 2)) * self.std

    @property
    def between_p_value(self) -> float:
        """Probability of estimates that vary as much if all arms are alike (W. Cochran, Biometrics 10, 1954)."""
        arms = replace(self.arms, variance=np.inf)
        values, _, along = arms.eigen
        mean, M, *_ = arms.solved(0.0)
        root = diagonal_root(M)
        determined = np.linalg.matrix_rank(M / np.outer(root, root), _RANK, hermitian=True)
        shown = values > 0
        separate_statistic = float(np.sum(along[shown] ** 2 / values[shown]))
        freedom = int(shown.sum()) - int(determined)
        if freedom > 0:
            return float(chdtrc(freedom, max(separate_statistic - float(mean @ M @ mean), 0.0)))
        return 1.0

    def shrunken(self) -> tuple[Array, Array]:
        """The estimate of each arm `(arm, number)` and its covariance `(arm, number, number)`, by empirical Bayes.

        The covariance contains the uncertainty of the mean, and not that of τ.
        """
        values, U, along = self.arms.eigen
        D = self.arms.typical
        prior = self.mean / D
        residual = along - values * (prior @ U)
        variance = self.tau**2 / (1 + self.tau**2 * values)
        estimates = prior + np.einsum("aij,aj->ai", U, variance * residual)
        conditional_covariance = np.einsum("aij,aj,akj->aik", U, variance, U)
        keeps = np.einsum("aij,aj,akj->aik", U, 1 / (1 + self.tau**2 * values), U)
        of_mean = keeps @ (self.covariance / np.outer(D, D)) @ keeps.swapaxes(1, 2)
        return estimates * D, (conditional_covariance + of_mean) * np.outer(D, D)

    def outlier_p_value(self, arm: int) -> float:
        """Probability of an arm as far from what the others predict: a model of those is fitted without it.

        The squared distance over its variance is compared with F. An estimate of τ² has the uncertainty of a variance
        from as many arms, also where most of what it is estimated from is the uncertainty of each arm: so these are the
        degrees of freedom (F. Satterthwaite, Biometrics Bulletin 2, 1946).
        """
        values, U, along = (part[arm] for part in self.arms.eigen)
        leave_one_out = fitted(self.arms.without(arm))
        shown = values > 0
        if not shown.any() or leave_one_out is None:
            return 1.0
        D = self.arms.typical
        of_mean = leave_one_out.covariance / np.outer(D, D)
        off = along[shown] / values[shown] - U[:, shown].T @ (leave_one_out.mean / D)
        between = leave_one_out.tau**2 * np.eye(int(shown.sum())) + U[:, shown].T @ of_mean @ U[:, shown]
        predictive_covariance = between + np.diag(1 / values[shown])
        count = len(off)
        distance = float(off @ np.linalg.solve(predictive_covariance, off)) / count
        return float(fdtrc(count, leave_one_out.freedom * count, distance))


def fitted(arms: ArmLikelihoods) -> Hierarchy | None:
    """The hierarchical model by restricted maximum likelihood; None where no arm shows the effect, or too few do."""
    values, U, along = arms.eigen
    shown = int(np.sum((values > 0).any(1)))
    if shown < 2:
        return None
    unit = 1 / np.sqrt(np.median(values[values > 0]))
    grid = unit * np.geomspace(1 / _RANGE, _RANGE, _STEPS)
    log_likelihoods = [arms.solved(tau)[3] for tau in grid]
    peak = int(np.argmax(log_likelihoods))
    near = np.log(grid[[max(peak - 1, 0), min(peak + 1, _STEPS - 1)]])
    refined: Any = minimize_scalar(
        lambda log: -arms.solved(float(np.exp(log)))[3], bounds=tuple(near), method="bounded", options={"xatol": 1e-6}
    )
    tau = 0.0
    if -refined.fun > arms.solved(0.0)[3] + 1e-9:
        tau = float(np.exp(refined.x))
    mean, M, *_ = arms.solved(tau)
    D = arms.typical
    residual = along - values * (mean @ U)
    spread = np.sum(residual[values > 0] ** 2 / (values + tau**2 * values**2)[values > 0])
    freedom = max(int(np.sum(values > 0)) - len(D), 1)
    covariance = scaled_inverse(M, _RANK) * max(1.0, float(spread) / freedom) * np.outer(D, D)
    return Hierarchy(arms, tau, mean * D, covariance, float(shown - 1))
