"""The nuisance and the physics fitted together, robustly: Gauss–Newton on exact residuals."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.problem import Case
from lite6jax.effects.composition import Physics
from lite6jax.estimation.noise import WHITE, Colour
from lite6jax.estimation.robust import FREEDOM, gaussian_t_scale, t_scale, variance_factor

Array = NDArray[np.floating]

_STEPS = 25
_SETTLED = 1e-3
"""Length of a step, in standard deviations of what it estimates, under which a refit has settled."""
_EXACT_STEPS, _ENOUGH = 8, 0.02
"""The same by differences, of which each step takes many: a search has been there before."""
_HALVINGS = 6
_STEP, _TYPICAL = 1e-6, 1e-4
"""m and rad of a difference, and of what a number of typical size does."""


class Weighed(NamedTuple):
    """Residuals and what a robust loss makes of them.

    Attributes:
        rows: `(row, sample)`, whitened by what the sensor's noise is said to be.
        innovations: `(row, sample)`, what of them cannot be foretold from the rows before.
        scale: of the noise, over the whitener's.
        weight: `(sample,)`, 1 for a sample as expected, down to 0.
    """

    rows: Array
    innovations: Array
    scale: float
    weight: Array

    @property
    def squares(self) -> Array:
        """`(sample,)`, over the scale."""
        return np.sum(self.rows**2, 0) / self.scale**2


@dataclass(frozen=True, eq=False)
class Fitted:
    """A case with some physics, fitted.

    Attributes:
        physics: which.
        moved: `(unknown,)` the nuisance, from the case's start.
        values: `(physics.size,)`.
        covariance: `(physics.size, physics.size)` of the values, the nuisance's uncertainty included.
        residual: of all rows, those left out of the fit too.
        used: `(sample,)` bool, the rows it was fitted to.
        parameters: how many numbers were fitted, those that only the prior determines not counted.
        converged: whether it settled.
        colour: of the noise.
        surprise: squared standard deviations by which all numbers are off what is known of them beforehand.
    """

    physics: Physics
    moved: Array
    values: Array
    covariance: Array
    residual: Weighed
    used: NDArray[np.bool_]
    parameters: float
    converged: bool
    colour: Colour
    surprise: float

    @property
    def freedom(self) -> float:
        """Numbers it was fitted to, less those fitted."""
        return float(len(self.residual.rows) * self.used.sum()) - self.parameters

    def log_likelihood(self, scale: float) -> float:
        """Of the rows used, Student's t, the noise given as a multiple of the whitener's, and what is known before."""
        squares = np.sum(self.residual.innovations[:, self.used] ** 2, 0) / scale**2
        rows = len(self.residual.rows)
        return float(
            -0.5 * (FREEDOM + rows) * np.sum(np.log1p(squares / FREEDOM))
            - squares.size * rows * np.log(scale)
            - 0.5 * self.surprise
        )


def refit(
    case: Case,
    physics: Physics,
    values: Array | None = None,
    moved: Array | None = None,
    used: NDArray[np.bool_] | None = None,
    colour: Colour = WHITE,
    exact: bool = False,
) -> Fitted:
    """Fits what is unknown of the geometry, the frames and the numbers of `physics` together.

    The loss is Student's t, its scale estimated. Derivatives are those at the case's start, residuals are exact: a step
    leaves a thousandth of the error, or what the start is off in radians. That finds what is there; but where some
    mixture of the nuisance does nearly what an effect does, even a hundredth that the derivatives are off makes
    information of nothing, and `exact` ones are needed to say how sure a number is.

    Args:
        case: the data.
        physics: the effects.
        values: `(physics.size,)` where to start; neutral where not given.
        moved: `(unknown,)` where to start; the case's start where not given.
        used: `(sample,)` bool; all where not given.
        colour: of the noise.
        exact: whether derivatives are those where the fit stands, by differences: one residual a number and step.
    """
    values = np.zeros(physics.size) if values is None else np.array(values, float)
    moved = np.zeros(len(case.unknown)) if moved is None else np.array(moved, float)
    used = np.ones(case.samples, bool) if used is None else used
    nuisance = colour.whitened(case.nuisance)
    k = len(nuisance)
    precision = np.concatenate([case.precision, physics.prior**-2.0])
    offset = np.concatenate([case.offset, np.zeros(physics.size)])

    def weighed(rows: Array) -> Weighed:
        innovations = colour.whitened(rows)
        squares = np.sum(innovations**2, 0)
        scale = t_scale(squares[used], case.rows, FREEDOM) / gaussian_t_scale(case.rows, FREEDOM)
        return Weighed(rows, innovations, scale, (FREEDOM + case.rows) / (FREEDOM + squares / scale**2))

    def cost(rows: Array, at: Array, scale: float) -> float:
        squares = np.sum(colour.whitened(rows)[:, used] ** 2, 0) / scale**2
        prior = np.sum(precision * (offset + at) ** 2)
        return float((FREEDOM + case.rows) * np.sum(np.log1p(squares / FREEDOM)) + prior)

    at = np.concatenate([moved, values])
    state = weighed(case.residual(moved, physics, values))
    converged, H = False, np.eye(0)
    for _ in range(_EXACT_STEPS if exact else _STEPS):
        columns = nuisance
        if exact:
            columns = colour.whitened(_differences(case, physics, at, state.rows))
        elif physics.size:
            columns = np.concatenate([nuisance, colour.whitened(case.columns(physics.effects, at[k:]))])
        if not len(columns):
            converged = True
            break
        w = np.where(used, state.weight, 0.0) / state.scale**2
        weighted = (columns * w).reshape(len(columns), -1)
        H = weighted @ columns.reshape(len(columns), -1).T
        gradient = weighted @ state.innovations.ravel() + precision * (offset + at)
        H[np.diag_indices_from(H)] += precision
        change = -_solve(H, gradient)
        length = float(np.sqrt(max(-change @ gradient, 0.0)))
        before = cost(state.rows, at, state.scale)
        rows = case.residual(at[:k] + change[:k], physics, at[k:] + change[k:])
        for _ in range(_HALVINGS):
            if cost(rows, at + change, state.scale) <= before + 1e-9 * abs(before):
                break
            change = change / 2
            rows = case.residual(at[:k] + change[:k], physics, at[k:] + change[k:])
        at, state = at + change, weighed(rows)
        if length < (_ENOUGH if exact else _SETTLED):
            converged = True
            break
    factor = variance_factor(state.squares[used], case.rows, FREEDOM, 0)
    covariance = _inverse(H)[k:, k:] * factor if len(H) else np.zeros((0, 0))
    surprise = float(np.sum(precision * (offset + at) ** 2))
    told = _determined(H, precision)
    return Fitted(physics, at[:k], at[k:], covariance, state, used, told, converged, colour, surprise)


def without(case: Case, fitted: Fitted, k: int) -> Fitted:
    """The fit without the k-th effect, from where it stands."""
    rest, values = fitted.physics.part(fitted.values, [i != k for i in range(len(fitted.physics.effects))])
    return refit(case, rest, values, fitted.moved, fitted.used, fitted.colour)


def _differences(case: Case, physics: Physics, at: Array, rows: Array) -> Array:
    """How residuals `rows` change with all numbers where they stand, `(number, row, sample)`."""
    k = len(at) - physics.size
    steps = np.concatenate([np.full(k, _STEP), _STEP / _TYPICAL * physics.typical])
    columns = np.empty((len(at), *rows.shape))
    for i, step in enumerate(steps):
        moved = at.copy()
        moved[i] += step
        columns[i] = (case.residual(moved[:k], physics, moved[k:]) - rows) / step
    return columns


def _solve(H: Array, gradient: Array) -> Array:
    root = np.sqrt(np.maximum(np.diagonal(H), np.finfo(float).tiny))
    scaled = H / np.outer(root, root)
    return np.linalg.lstsq(scaled, gradient / root, rcond=1e-13)[0] / root


def _inverse(H: Array) -> Array:
    root = np.sqrt(np.maximum(np.diagonal(H), np.finfo(float).tiny))
    return np.linalg.pinv(H / np.outer(root, root), rcond=1e-13, hermitian=True) / np.outer(root, root)


def _determined(H: Array, precision: Array) -> float:
    """The effective number of parameters: the trace of what the data alone has of the information."""
    if not len(H):
        return 0.0
    return float(len(H) - np.sum(precision * np.diagonal(_inverse(H))))
