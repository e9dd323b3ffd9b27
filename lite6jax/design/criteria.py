"""What makes one information matrix better than another: the criteria of optimal design, as pure functions of it.

Every criterion has two functions of an information matrix M: `value`, by which designs are judged, higher being better;
and `smooth`, which rises with it and has a gradient everywhere, by which they are sought. Both are plain JAX.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.scipy.linalg import cho_factor, cho_solve, solve_triangular
from numpy.typing import ArrayLike, NDArray

from lite6jax.errors import InputError

_SHARP = 16
"""Kiefer's p for the smallest eigenvalue: at 34 parameters the p-mean is within 25 % of it, and smooth."""
_SHARES = 1e-9
"""What share of a quadratic form may lie in directions that nothing determines; rounding leaves 1e-12."""
_DETERMINED = 1e-10
"""An eigenvalue of the information (columns of unit size) over the largest, above which a direction is determined."""
_OBSERVABLE = 1e-20
"""A parameter's information over the largest, under which no candidate depends on it."""
DESIGN_DETERMINES = 1e-12
"""The same of a design's information, whose poses are few."""


class Coordinates(NamedTuple):
    """The directions of parameter space that data determines, scaled so that their mean information is the identity.

    Attributes:
        outward: `(parameter, k)`, parameters of coordinates.
        inward: `(k, parameter)`, coordinates of parameters.
        basis: `(k, k)`, coordinates of an orthonormal basis of the determined directions: information there is
            basisᵀ M basis of information M in coordinates.
    """

    outward: NDArray[np.floating]
    inward: NDArray[np.floating]
    basis: NDArray[np.floating]


class Determinant(NamedTuple):
    """D: the logarithm of the information's determinant, the volume of the confidence ellipsoid (A. Wald, 1943)."""

    offset: Array | float = 0.0

    def value(self, M: Array) -> Array:
        """log det M."""
        return self.offset + 2 * jnp.sum(jnp.log(jnp.diagonal(jnp.linalg.cholesky(M))))

    def smooth(self, M: Array) -> Array:
        """The same."""
        return self.value(M)

    def within(self, coordinates: Coordinates) -> "Determinant":
        """The same of an information matrix in `coordinates`."""
        return Determinant(jnp.asarray(2 * np.linalg.slogdet(coordinates.basis)[1]))

    def efficiency(self, value: float, reference: float, rank: int) -> float:
        """How often a design of `reference` would have to be repeated to reach `value`, of `rank` directions."""
        return float(np.exp((value - reference) / rank))


class Average(NamedTuple):
    """A and I: minus the weighted sum of the variances, −tr(W M⁻¹) (H. Chernoff, Ann. Math. Stat. 24, 1953).

    Attributes:
        weight: W `(parameter, parameter)`; none is the identity, A-optimality. The mean information of the errors that
            matter, Σ JᵀJ / count over a workspace, is I-optimality: minus their mean variance.
    """

    weight: Array | None = None

    def value(self, M: Array) -> Array:
        """−tr(W M⁻¹)."""
        C = inverse(M)
        return -(jnp.trace(C) if self.weight is None else jnp.sum(self.weight * C))

    def smooth(self, M: Array) -> Array:
        """−log tr(W M⁻¹)."""
        return -jnp.log(-self.value(M))

    def within(self, coordinates: Coordinates) -> "Average":
        """The same of an information matrix in `coordinates`.

        Raises:
            InputError: the weight has a direction that neither data nor prior determine.
        """
        T = coordinates.outward
        if self.weight is None:
            return Average(jnp.asarray(T.T @ T))
        W = np.asarray(self.weight, float)
        V = T @ coordinates.basis  # orthonormal
        lost = 1 - np.trace(V.T @ W @ V) / max(np.trace(W), np.finfo(float).tiny)
        if lost > _SHARES:
            raise InputError(
                f"criterion I: {100 * lost:.2g} % of the workspace's error lies in directions that no candidate"
                " determines; give a prior for them, a sensor that observes them, or leave these errors out"
            )
        return Average(jnp.asarray(T.T @ W @ T))

    def efficiency(self, value: float, reference: float, rank: int) -> float:
        """How often a design of `reference` would have to be repeated to reach `value`, of `rank` directions."""
        return float(np.divide(reference, value))


class Smallest(NamedTuple):
    """E: the information's smallest eigenvalue, along the direction known worst (S. Ehrenfeld, 1955).

    Its smooth kin is Kiefer's mean of order −p of the eigenvalues (J. Kiefer, Ann. Stat. 2, 1974).

    Attributes:
        basis: `(k, direction)`, in whose orthonormal directions the eigenvalues are meant; none is M's own.
    """

    basis: Array | None = None

    def _matrix(self, M: Array) -> Array:
        return M if self.basis is None else self.basis.T @ M @ self.basis

    def value(self, M: Array) -> Array:
        """The smallest eigenvalue of M."""
        return jnp.linalg.eigvalsh(self._matrix(M))[0]

    def smooth(self, M: Array) -> Array:
        """−log(tr M⁻ᵖ) / p."""
        power = inverse(self._matrix(M))
        size = jnp.trace(power)
        log_size = jnp.log(size)
        power = power / size
        for _ in range(_SHARP.bit_length() - 1):  # squared, and held to unit trace
            power = power @ power
            size = jnp.trace(power)
            log_size = 2 * log_size + jnp.log(size)
            power = power / size
        return -log_size / _SHARP

    def within(self, coordinates: Coordinates) -> "Smallest":
        """The same of an information matrix in `coordinates`."""
        return Smallest(jnp.asarray(coordinates.basis))

    def efficiency(self, value: float, reference: float, rank: int) -> float:
        """How often a design of `reference` would have to be repeated to reach `value`, of `rank` directions."""
        return float(np.divide(value, reference))


class Discrimination(NamedTuple):
    """T: how far the data of one model is from all that its rival can explain (A. Atkinson, V. Fedorov, 1975).

    Linearised: with u what the hypothesised effect adds to the parameters, and Q spanning those that the rival may
    move, the noncentrality Δ = min_γ (u − Qγ)ᵀ M (u − Qγ) = uᵀMu − uᵀMQ (QᵀMQ)⁻¹ QᵀMu; a χ² test between the models has
    this noncentrality. Of several directions (a against b, b against a) the smallest counts. (Biometrika 62, eq. 2.3;
    for normal linear models Dₛ with one contrast.)

    Attributes:
        effects: u of each direction, `(parameter,)`.
        alternatives: Q of each direction, `(parameter, free)`.
    """

    effects: tuple[Array, ...]
    alternatives: tuple[Array, ...]

    def noncentralities(self, M: Array) -> Array:
        """Δ of each direction."""

        def unexplained(u: Array, Q: Array) -> Array:
            if Q.shape[1] == 0:
                return u @ M @ u
            factor = cho_factor(Q.T @ M @ Q, lower=True)
            rest = u - Q @ cho_solve(factor, Q.T @ (M @ u))
            return rest @ M @ rest  # free of the cancellation in the difference of two large numbers

        return jnp.stack([unexplained(u, Q) for u, Q in zip(self.effects, self.alternatives, strict=True)])

    def value(self, M: Array) -> Array:
        """The smallest Δ."""
        return jnp.min(self.noncentralities(M))

    def smooth(self, M: Array) -> Array:
        """−log(Σ Δ⁻ᵖ) / p with p = 4."""
        logs = jnp.log(self.noncentralities(M))
        least = jnp.min(logs)
        return least - jnp.log(jnp.sum(jnp.exp(-4 * (logs - least)))) / 4

    def within(self, coordinates: Coordinates) -> "Discrimination":
        """The same of an information matrix in `coordinates`.

        Raises:
            InputError: effects that no candidate shows, or that the rival explains wholly.
        """
        S = coordinates.inward
        effects, alternatives = [], []
        for u, Q in zip(self.effects, self.alternatives, strict=True):
            U, sizes, _ = np.linalg.svd(S @ np.asarray(Q, float), full_matrices=False)
            U = U[:, sizes > 1e-10 * max(sizes.max(initial=0.0), np.finfo(float).tiny)]
            shown = S @ np.asarray(u, float)
            rest = shown - U @ (U.T @ shown)
            if not rest @ rest > _SHARES * (shown @ shown):
                raise InputError(
                    "criterion T: no candidate separates the rivals: what one model predicts the other explains; give"
                    " other candidates, another sensor, or fewer free parameters"
                )
            effects.append(jnp.asarray(shown))
            alternatives.append(jnp.asarray(U))
        return Discrimination(tuple(effects), tuple(alternatives))

    def efficiency(self, value: float, reference: float, rank: int) -> float:
        """How often a design of `reference` would have to be repeated to reach `value`, of `rank` directions."""
        return float(np.divide(value, reference))


Criterion = Determinant | Average | Smallest | Discrimination
"""A pytree, so that its arrays may change without compiling anew, and its kind may not."""

CRITERIA = {"D": Determinant(), "A": Average(), "E": Smallest()}
"""The criteria that need nothing further, by the letter the literature gives them."""


def workspace(rows: Array | NDArray[np.floating]) -> Average:
    """I-optimality: minus the mean variance of the errors `(pose, row, parameter)` summed over their rows."""
    flat = rows.reshape(-1, rows.shape[2])
    return Average(jnp.asarray(flat.T @ flat / len(rows)))


def discrimination(scale: NDArray[np.floating], *models: tuple[ArrayLike, ArrayLike]) -> Discrimination:
    """The criterion that separates two models, which share all parameters but their own.

    Args:
        scale: `(parameter,)` SI, the units of the rows' columns.
        models: of each the columns that only it has, and its hypothesised values in SI units. A model whose values are
            all zero is only what another is tested against.
    """
    effects, alternatives = [], []
    for own, values in ((np.asarray(own, int), np.asarray(values, float)) for own, values in models):
        if values.any():
            effect = np.zeros(len(scale))
            effect[own] = values / scale[own]
            effects.append(jnp.asarray(effect))
            alternatives.append(jnp.asarray(np.delete(np.eye(len(scale)), own, axis=1)))
    return Discrimination(tuple(effects), tuple(alternatives))


def inverse(M: Array) -> Array:
    """The inverse of a symmetric positive matrix, exactly symmetric."""
    L = jnp.linalg.cholesky(M)
    half = solve_triangular(L, jnp.eye(len(M)), lower=True)
    return half.T @ half


def coordinates_of(information: NDArray[np.float64], candidates: int) -> Coordinates:
    """The coordinates of an information matrix, so scaled that the mean of `candidates` is the identity.

    Raises:
        InputError: it is zero.
    """
    squares = np.diagonal(information)
    observable = squares > _OBSERVABLE * squares.max()  # the others are rounding, which must not be scaled up
    units = np.sqrt(np.where(observable, squares, max(float(squares.max()), np.finfo(float).tiny)))
    eigenvalues, V = np.linalg.eigh(information / units[:, None] / units)  # in units of the columns' own lengths
    kept = eigenvalues > _DETERMINED * max(eigenvalues[-1], 0.0)
    if not kept.any():
        raise InputError("rows: all zero; no candidate depends on any parameter")
    scale, V = np.sqrt(eigenvalues[kept] / candidates), V[:, kept]
    inward = scale[:, None] * V.T * units
    determined, _ = np.linalg.qr(V * units[:, None])  # the undetermined directions are orthogonal to these
    outward = determined @ (determined.T @ (V / units[:, None] / scale))
    return Coordinates(outward, inward, inward @ determined)


def evaluate(criterion: Criterion, M: Array) -> Array:
    """The criterion, or −inf where M does not determine all directions."""
    eigenvalues = jnp.linalg.eigvalsh(M)
    value = criterion.value(M)
    return jnp.where((eigenvalues[0] > DESIGN_DETERMINES * eigenvalues[-1]) & jnp.isfinite(value), value, -jnp.inf)


def one_by_one(judge: Callable[[Array], Array], arrays: Array) -> Array:
    """`judge` of each array, one after the other: as fast as jax.vmap at these sizes, and it always returns.

    On a CPU a batched factorisation waits, on a thread of XLA's pool, for tasks in that same pool; two independent ones
    on two cores wait for ever (jaxlib 0.10, `ParallelBatchMap`). A single matrix needs no task.
    """
    return lax.map(judge, arrays)


@jax.jit
def evaluate_each(criterion: Criterion, informations: Array) -> Array:
    """As `evaluate`, of each of some matrices `(…, k, k)`."""
    return one_by_one(partial(evaluate, criterion), informations)
