"""How uncertain the model of a diagnosis is: the covariance of all its numbers, and what is left of it."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from lite6jax.domains.pose.kinematics import whitened
from lite6jax.domains.pose.uncertainty import Derivatives, PerAxis, RecordedRange, Uncertainty, distance_to, freed
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.problem import Mask
from lite6jax.estimation.projection import scaled_inverse
from lite6jax.estimation.robust import FREEDOM, variance_factor
from lite6jax.estimation.terms import Terms

if TYPE_CHECKING:
    from lite6jax.diagnosis.result import Diagnosis
    from lite6jax.domains.pose.predict import DiagnosedArm

Array = NDArray[np.floating]
Rows = NDArray[np.integer]

_ROWS = 200
"""Recorded rows that are kept to measure the distance from."""
_MOST = 2000
"""Rows of which the distance from the others is measured."""
_BLOCK = 2000
"""Rows of which products are formed at once: the derivatives of hundreds of numbers take half a gigabyte."""
LEVEL, _SQUARE = 0.95, 7.8147
"""The share of rows within so many squared standard deviations per axis, of a normal distribution in three axes."""


def uncertainty_of(found: "Diagnosis", model: "DiagnosedArm") -> Uncertainty:
    """How uncertain predictions of a diagnosed model are.

    The information of the fit is that of its weights, its noise model and its priors, with the derivatives
    that predictions use. What is left of the model is calibrated on held-out rows: with it, with the sensor's noise and
    with the uncertainty of the numbers, 95 % of their errors are as large as they are.

    Args:
        found: the diagnosis.
        model: its model; its own uncertainty is not used.
    """
    problem = found.problem
    sites, kept = (*problem.frames, *problem.masses), ~found.outliers
    change = Derivatives(model, problem.motion, sites)
    J = change.all()
    C = _covariance(found, model, J)
    blocks = np.split(J, range(_BLOCK, J.shape[2], _BLOCK), axis=2)
    estimated = np.concatenate([np.sum(np.tensordot(C, block, 1) * block, 0) for block in blocks], 1)
    left, unseen, noise = _left(found, estimated)
    curves: list[PerAxis | None] = []
    for effect, part in zip(model.physics.effects, model.physics.slices, strict=True):
        if isinstance(effect, Unnamed):
            at = slice(len(sites) + part.start, len(sites) + part.stop)
            moved = np.tensordot(np.asarray(model.values)[part], J[at], 1)[:, kept]
            curves.append((float(np.sqrt(np.mean(moved[:3] ** 2))), float(np.sqrt(np.mean(moved[3:] ** 2)))))
        else:
            curves.append(None)
    typical = [
        float(np.sqrt(np.median(estimated[rows][:, kept].mean(0)) + left[k] ** 2)) if kept.any() else np.inf
        for k, rows in enumerate((slice(0, 3), slice(3, 6)))
    ]
    usual = (typical[0], typical[1]) if np.isfinite(typical).all() and min(typical) > 0 else None
    return Uncertainty(sites, C, left, unseen, noise, tuple(curves), _recorded(found, change), usual)


def _covariance(found: "Diagnosis", model: "DiagnosedArm", J: Array) -> Array:
    """`(number, number)`, of the nuisance and of the effects' numbers, by derivatives `(number, 6, sample)`."""
    if not len(J):
        return np.zeros((0, 0))
    problem = found.problem
    frames, masses = len(problem.frames), len(problem.masses)
    moved = problem.frame_columns[frames:]  # by frame jumps: no prediction has them, but they are fitted beside
    columns = np.concatenate([whitened(J[:, : problem.rows], problem.measured.whitener), moved])
    prior = Terms(tuple(freed(effect) for effect in model.physics.effects), found.fit.terms.bounded).precision
    known = problem.precision
    precision = np.concatenate([known[:frames], known[len(known) - masses :], prior, 0 * moved[:, 0, 0]])
    return covariance_of(found.fit, problem.valid, columns, precision)[: len(J), : len(J)]


def covariance_of(fit: Fit, valid: Mask, columns: Array, precision: Array) -> Array:
    """The covariance `(number, number)` of fitted numbers: of the weights of a fit, its noise model and its priors.

    Args:
        fit: all of it.
        valid: `(sample,)`, the samples that are not left out.
        columns: `(number, row, sample)`, the derivative of each row over its noise by each number.
        precision: `(number,)`, one over the variance of the prior.
    """
    if not len(columns):
        return np.zeros((0, 0))
    used = fit.training & valid
    innovations = columns if fit.noise.white else fit.noise.whitened(np.where(used, columns, 0.0))
    root = np.sqrt(np.where(used, fit.residuals.row_weight, 0.0))
    H = np.diag(np.asarray(precision, float))
    for first in range(0, root.shape[1], _BLOCK):
        flat = (innovations[..., first : first + _BLOCK] * root[:, first : first + _BLOCK]).reshape(len(columns), -1)
        H += flat @ flat.T
    return scaled_inverse(H) * variance_factor(fit.residuals.squares[used], columns.shape[1], FREEDOM, 0)


def _left(found: "Diagnosis", estimated: Array) -> tuple[PerAxis, PerAxis, PerAxis]:
    """What is left per axis, what may be left unseen, and the noise; by variances `(6, sample)` of the prediction.

    The noise is the declared one, or less where the residuals are less: whatever they are more is left of the model.
    """
    problem, fit, kept = found.problem, found.fit, ~found.outliers
    count = max(int(kept.sum()), 1)
    scales = fit.scale[problem.groups[[0, -1]]]
    scale = [
        float(s if declared is None else min(s, 1.0))
        for s, declared in zip(scales, problem.declared_noise, strict=True)
    ]
    noise = scale[0] * problem.noise[0], scale[1] * (problem.noise[1] or 0.0)
    folds = len(found.folds)
    fewer = folds / (folds - 1)  # numbers that were estimated without a block
    squares = found.after[kept] ** 2 / _SQUARE
    position = excess(squares - fewer * estimated[:3, kept].mean(0), noise[0], 3 * count)
    orientation = 0.0
    if problem.rows == 6 and problem.noise[1]:
        lost = max(1 - fit.parameters / max(problem.rows * count, 1), 0.1)
        turned = problem.noise[1] ** 2 * np.sum(fit.residuals.rows[3:, kept] ** 2, 0) / lost
        lever = np.sqrt(np.mean(np.sum((problem.rigid.tool[:, :3, 3] - problem.rigid.frames[0, :, :3, 3]) ** 2, 1)))
        # an angle inside the arm that displaces the tool by what is left of positions turns it too
        orientation = max(excess(turned / _SQUARE, noise[1], 3 * count), position / max(lever, 1e-3))
    left = position, orientation
    unseen = [float(np.sqrt(relative_error(3 * count) * (n**2 + s**2))) for n, s in zip(noise, left, strict=True)]
    return left, (unseen[0], unseen[1]), noise


def relative_error(numbers: float) -> float:
    """The standard error of a variance, over the variance, from so many independent numbers."""
    return float(np.sqrt(2 / max(numbers, 1.0)))


def excess(variance: Array, noise: float, numbers: float) -> float:
    """The standard deviation that, beside the noise, is enough for 95 % of rows that each ask for a variance.

    What the rows ask for is uncertain, and an excess is not negative: its mean given both (of a truncated normal
    distribution; N. Johnson, S. Kotz and N. Balakrishnan, Continuous Univariate Distributions, 1994, 13.10).

    Args:
        variance: `(row,)`.
        noise: one standard deviation.
        numbers: that the rows are worth, if they were independent.
    """
    if not variance.size:
        return 0.0
    asked = float(np.quantile(variance, LEVEL)) - noise**2
    error = max(relative_error(numbers) * (noise**2 + max(asked, 0.0)), np.finfo(float).tiny)
    z = asked / error
    return float(np.sqrt(error * max(z + np.exp(-0.5 * z**2 - log_ndtr(z)) / np.sqrt(2 * np.pi), 0.0)))


def rows_kept(rows: Rows) -> Rows:
    """Those of the indices of rows that a model keeps, from which the distance is measured."""
    return np.unique(rows[np.linspace(0, len(rows) - 1, min(_ROWS, len(rows))).astype(int)])


def spacing_of(q: Array, rows: Rows, kept: Rows, folds: Iterable[Mask]) -> float:
    """The distance from a row to the nearest kept one of other blocks that 95 % of rows do not exceed, rad.

    Args:
        q: `(sample, joint)` rad.
        rows: indices.
        kept: indices of those that the model keeps.
        folds: the blocks, `(sample,)` each.
    """
    distances = []
    for fold in folds:
        held, others = rows[fold[rows]], kept[~fold[kept]]
        if held.size and others.size:
            distances.append(distance_to(q[others], q[held]))
    return float(np.quantile(np.concatenate(distances), LEVEL)) if distances else 0.0


def _recorded(found: "Diagnosis", change: Derivatives) -> RecordedRange:
    problem, kept = found.problem, np.flatnonzero(~found.outliers)
    kept = kept if kept.size else np.arange(problem.samples)
    q = problem.recording.joint_position
    rows = rows_kept(kept)
    some = kept[np.linspace(0, len(kept) - 1, min(_MOST, len(kept))).astype(int)]
    return RecordedRange(
        joints=np.stack([q[kept].min(0), q[kept].max(0)], 1),
        positions=np.round(q[rows], 5),
        spacing=spacing_of(q, some, rows, found.folds),
        drivers={
            phrase: (float(values[kept].min()), float(values[kept].max()))
            for phrase, values in change.driver_values().items()
        },
    )
