"""Residuals without what known columns can do, and what other columns explain of the rest, with honest deviations."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.rigid_arm import RigidArm
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.estimation.options import DEFAULTS
from lite6jax.estimation.projection import orthonormal, outside, unit_rows

Array = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Projected:
    """Residuals from which all that known columns can do is taken out; samples far off count for less.

    Attributes:
        arm: fitted.
        known: `(number, row, sample)`, beside the arm's own unknowns.
        options: the thresholds.
    """

    arm: RigidArm
    known: Array
    options: ScreeningOptions

    @cached_property
    def weight(self) -> Array:
        """`(sample,)` square root of Huber's."""
        length = np.sqrt(self.arm.squares / self.arm.rows) / self.arm.scale
        return np.sqrt(np.minimum(1.0, self.options.huber_sigmas / np.maximum(length, 1e-300)))

    @cached_property
    def basis(self) -> Array:
        """`(rank, row sample)`, orthonormal, of the known columns."""
        columns = np.concatenate([self.arm.nuisance, self.known]) * self.weight
        flat = columns.reshape(len(columns), self.arm.rows * self.arm.samples)
        return orthonormal(unit_rows(flat), DEFAULTS.rounding)

    @cached_property
    def residual(self) -> Array:
        """`(row sample)`."""
        return self.without(self.arm.residuals[None])[0]

    @cached_property
    def freedom(self) -> int:
        """Residual degrees of freedom."""
        return self.arm.rows * self.arm.samples - len(self.basis)

    def without(self, columns: Array) -> Array:
        """Weighted columns `(number, row, sample)` less what the known ones can do, `(number, row sample)`."""
        return outside((columns * self.weight).reshape(len(columns), -1), self.basis)

    def regression(self, columns: Array) -> tuple[Array, Array, float]:
        """Numbers `(number,)` of columns that explain the residual, their covariance, and the squares they explain.

        The covariance is the larger of that of white noise and that of samples of unequal noise (H. White,
        Econometrica 48, 1980).
        """
        X = self.without(columns)
        size = np.linalg.norm((columns * self.weight).reshape(len(columns), -1), axis=1)
        G = X @ X.T
        confounded = np.sqrt(np.diagonal(G)) <= np.sqrt(self.options.observable_share) * size
        G[confounded, confounded] = (
            np.inf if confounded.all() else np.maximum(G[confounded, confounded], size[confounded] ** 2 * 1e9 + 1e300)
        )
        inverse = np.linalg.pinv(np.where(np.isfinite(G), G, 0.0)) if confounded.all() else np.linalg.inv(G)
        if confounded.any():
            inverse[confounded] = inverse[:, confounded] = 0.0
        values = -inverse @ (X @ self.residual)
        left = self.residual + values @ X
        white = inverse * max(float(left @ left) / max(self.freedom - len(X), 1), 1e-300)
        pulls = (X * left).reshape(len(X), self.arm.rows, -1).sum(1)
        uneven = inverse @ (pulls @ pulls.T) @ inverse
        grown = np.sqrt(np.maximum(1.0, np.diagonal(uneven) / np.maximum(np.diagonal(white), 1e-300)))
        covariance = white * np.outer(grown, grown)
        covariance[confounded, confounded] = np.inf
        explained = float(values @ (X @ X.T) @ values)
        return values, covariance, explained / max(float(left @ left) / max(self.freedom - len(X), 1), 1e-300)


def estimated(arm: RigidArm, known: Array, columns: Array, options: ScreeningOptions) -> tuple[Array, Array]:
    """The numbers of `columns` `(number, row, sample)` and their standard deviations, beside the known ones."""
    values, covariance, _ = Projected(arm, known, options).regression(columns)
    return values, np.sqrt(np.diagonal(covariance))


def thinned(samples: int, options: ScreeningOptions) -> NDArray[np.integer]:
    """Some thousand samples, evenly."""
    return np.unique(np.linspace(0, samples - 1, min(samples, options.most_samples)).astype(int))
