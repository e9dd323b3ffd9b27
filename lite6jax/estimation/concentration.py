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


def concentration(problem: Problem, fit: Fit, options: EngineOptions) -> Concentration | None:
    """The site whose deflections the residuals look like; None where noise alone, or several sites, could explain them.

    To first order, a deflection at a site moves the rows of each sample in one known direction. What is left across
    these directions, with the model refitted to that alone, is the same for any deflections. In isotropic noise the
    ratio of the mean squares along and across the directions follows an F distribution. Of correlated noise the
    innovations are taken, with the direction of each sample: that is exact where directions change slowly. Noise of the
    same size at several sites gives None, and so does noise of one axis of a sensor, whose direction is the same in all
    samples.

    Args:
        problem: the data. The sites are those of its `curves` that move several rows.
        fit: the model.
        options: thresholds.
    """
    families = [family for family in problem.curves if np.count_nonzero(family.column.any(1)) > 1]
    if not families:
        return None
    test = score_test(problem, fit, options)
    whole = _remainder(test)
    found = [(_remainder(test, family.column), family.site) for family in families]
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
    others = [_remainder(test, np.broadcast_to(axis, measured.shape)), *(one for one, where in found if where != site)]
    nearest = min(one.squares for one in others)
    if 0.5 * rest.freedom / test.time * np.log(nearest / rest.squares) < options.close:
        return None
    share, expected = 1 - rest.squares / whole.squares, along / whole.freedom
    return Concentration(site, share, expected, 0.5 * (whole.squares - rest.squares - along * noise))


def _remainder(test: ScoreTest, column: Array | None = None) -> _Remainder:
    """What the refitted model leaves, where a column is given across its direction in each sample."""
    rows, samples = test.problem.rows, test.problem.samples
    used = test.fit.training.sum()
    residual, basis, readings = test.residual, test.basis, len(test.residual) - rows * (samples - used)
    if column is not None:
        direction = column / np.maximum(np.linalg.norm(column, axis=0), 1e-300)
        residual, basis = (_across(direction, part) for part in (residual[None], basis))
        residual, readings = residual[0], readings - used
    inside = orthonormal(basis, test.options.rounding)
    fitted = inside @ residual
    return _Remainder(float(residual @ residual - fitted @ fitted), int(readings - len(inside)))


def _across(direction: Array, readings: Array) -> Array:
    """Readings `(number, reading)` without what lies along unit vectors `(row, sample)`; those of a prior stay."""
    count = direction.size
    measured = readings[:, :count].reshape(-1, *direction.shape)
    along = np.einsum("rs,krs->ks", direction, measured)
    moved = measured - direction * along[:, None]
    return np.concatenate([moved.reshape(len(readings), count), readings[:, count:]], 1)
