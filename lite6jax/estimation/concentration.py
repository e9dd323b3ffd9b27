"""The site at which what a fit leaves acts, where it is one: no driver and no function has to be known for that."""

from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import ScoreTest, score_test

Array = NDArray[np.floating]


@final
class Concentration(NamedTuple):
    """A site along whose direction most of the residuals lie.

    Attributes:
        site: which.
        share: of the squared residuals, that a deflection there with a number of its own in each sample explains.
        expected: the share of white noise that it explains.
        gain: in log-likelihood, of a deflection there with a number of its own in each sample, beyond what noise gains.
    """

    site: str
    share: float
    expected: float
    gain: float


class _Remainder(NamedTuple):
    """The squared residuals that a model leaves, and their degrees of freedom."""

    squares: float
    freedom: int


class _Products(NamedTuple):
    """Products of a model's columns and residuals, over some directions of each sample's rows.

    What lies along a direction is subtracted from the products, so that columns of hundreds of numbers are not copied.

    Attributes:
        gram: `(k, k)`, of the columns.
        inner: `(k,)`, of columns and residuals.
        squares: of the residuals.
        readings: how many.
    """

    gram: Array
    inner: Array
    squares: float
    readings: int

    @classmethod
    def of(cls, test: ScoreTest) -> "_Products":
        """Over all directions."""
        basis, residual = test.basis, test.residual
        readings = len(residual) - test.problem.rows * int((~test.fit.training).sum())
        return cls(basis @ basis.T, basis @ residual, float(residual @ residual), readings)

    def across(self, test: ScoreTest, column: Array) -> "_Products":
        """Over the directions of each training sample's rows that are across that of a column `(row, sample)`."""
        direction = column / np.maximum(np.linalg.norm(column, axis=0), 1e-300)
        measured = test.basis[:, : column.size].reshape(-1, *column.shape)
        columns = np.einsum("rs,krs->ks", direction, measured)
        residual = np.sum(direction * test.residual[: column.size].reshape(column.shape), 0)
        return _Products(
            self.gram - columns @ columns.T,
            self.inner - columns @ residual,
            max(self.squares - float(residual @ residual), 0.0),
            self.readings - int(test.fit.training.sum()),
        )

    def remainder(self, options: EngineOptions) -> _Remainder:
        """What the model leaves when it is refitted to these directions alone."""
        if not len(self.gram):
            return _Remainder(self.squares, self.readings)
        eigenvalues, V = np.linalg.eigh(self.gram)
        kept = eigenvalues > options.rounding * eigenvalues[-1]
        fitted = float(np.sum((V[:, kept].T @ self.inner) ** 2 / eigenvalues[kept]))
        return _Remainder(max(self.squares - fitted, 0.0), self.readings - int(kept.sum()))


def concentration(problem: Problem, fit: Fit, options: EngineOptions) -> Concentration | None:
    """The site whose deflections the residuals look like; None where noise alone, or several sites, could explain them.

    To first order, a deflection at a site moves the rows of each sample in one known direction. What is left across
    these directions, with the model refitted to that alone, is the same for any deflections. In isotropic noise the
    ratio of the mean squares along and across the directions follows an F distribution. Of correlated noise the
    innovations are taken, with the direction of each sample: that is exact where directions change slowly. Noise of the
    same size at several sites gives None, and so does noise of one axis of a sensor, whose direction is the same in all
    samples. Of many samples in white noise, one in several is looked at, and stands for those between.

    Args:
        problem: the data. The sites are those of its periodic families that move several rows.
        fit: the model.
        options: thresholds.
    """
    every = max(fit.training.size // options.first_samples, 1) if fit.noise.white else 1
    if every > 1:
        problem, fit = problem.thinned(every), fit.thinned(every)
    families = [family for family in problem.periodic if np.count_nonzero(family.column.any(1)) > 1]
    if not families:
        return None
    test = score_test(problem, fit, options)
    products = _Products.of(test)
    whole = products.remainder(options)
    found = [(products.across(test, family.column).remainder(options), family.site) for family in families]
    rest, site = min(found, key=lambda pair: pair[0].squares)
    along = whole.freedom - rest.freedom
    if rest.freedom <= 0 or along <= 0 or rest.squares <= options.rounding * whole.squares:
        return None
    noise = rest.squares / rest.freedom
    ratio = (whole.squares - rest.squares) / along / noise
    p_value = float(fdtrc(along / test.time, rest.freedom / test.time, ratio)) * len(families)
    if ratio < options.concentrated or p_value > options.level:
        return None
    measured = test.residual[: problem.rows * problem.samples].reshape(problem.rows, problem.samples)
    axis = np.linalg.eigh(measured @ measured.T)[1][:, -1:]
    of_axis = products.across(test, np.broadcast_to(axis, measured.shape)).remainder(options)
    nearest = min(one.squares for one in (of_axis, *(one for one, where in found if where != site)))
    if 0.5 * every * rest.freedom / test.time * np.log(nearest / rest.squares) < options.close:
        return None
    share, expected = 1 - rest.squares / whole.squares, along / whole.freedom
    return Concentration(site, share, expected, 0.5 * every * (whole.squares - rest.squares - along * noise))
