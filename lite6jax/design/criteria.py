"""What makes one information matrix better than another: the criteria of optimal design, as pure functions of it.

Every criterion has two functions of an information matrix M: `value`, by which designs are judged, higher being better;
and `smooth`, which rises with it and has a gradient everywhere, by which they are sought. Both are plain JAX.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import cho_factor, cho_solve, solve_triangular
from numpy.typing import ArrayLike, NDArray

from lite6jax.errors import InputError

_SHARP = 16
"""Kiefer's p for the smallest eigenvalue: at 34 parameters the p-mean is within 25 % of it, and smooth."""
_SHARES = 1e-9
"""What share of a quadratic form may lie in directions that nothing determines; rounding leaves 1e-12."""
DETERMINED = 1e-10
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
        """How many times the poses of `value` a design of `reference` would have to repeat to reach it."""
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
        if W.shape != (len(T), len(T)):
            raise InputError(f"weight of shape {W.shape}: the rows have {len(T)} parameters; give one weight for each")
        V = T @ coordinates.basis  # orthonormal
        lost = 1 - np.trace(V.T @ W @ V) / max(np.trace(W), np.finfo(float).tiny)
        if lost > _SHARES:
            raise InputError(
                f"criterion I: {100 * lost:.2g} % of the workspace's error lies in directions that no candidate"
                " determines; give a prior for them, a sensor that observes them, or leave these errors out"
            )
        return Average(jnp.asarray(T.T @ W @ T))

    def efficiency(self, value: float, reference: float, rank: int) -> float:
        """How many times the poses of `value` a design of `reference` would have to repeat to reach it."""
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
        """How many times the poses of `value` a design of `reference` would have to repeat to reach it."""
        return float(np.divide(value, reference))


class Discrimination(NamedTuple):
    """T: how far the data of one model is from all that its rival can explain (A. Atkinson, V. Fedorov, 1975).

    Linearised: with u what the hypothesised effect adds to the parameters, and Q spanning those that the rival may
    move, the noncentrality Δ = min_γ (u − Qγ)ᵀ M (u − Qγ) = uᵀMu − uᵀMQ (QᵀMQ)⁻¹ QᵀMu; a χ² test between the models has
    this noncentrality. Of several directions (a against b, b against a) the smallest counts. (Biometrika 62, eq. 2.3;
    for normal linear models Dₛ with one contrast.)

    Attributes:
        effects: u of each direction, `(parameter,)`.
        rivals: Q of each direction, `(parameter, free)`.
    """

    effects: tuple[Array, ...]
    rivals: tuple[Array, ...]

    def noncentralities(self, M: Array) -> Array:
        """Δ of each direction."""

        def unexplained(u: Array, Q: Array) -> Array:
            if Q.shape[1] == 0:
                return u @ M @ u
            factor = cho_factor(Q.T @ M @ Q, lower=True)
            rest = u - Q @ cho_solve(factor, Q.T @ (M @ u))
            return rest @ M @ rest  # free of the cancellation in the difference of two large numbers

        return jnp.stack([unexplained(u, Q) for u, Q in zip(self.effects, self.rivals, strict=True)])

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
        effects, rivals = [], []
        for u, Q in zip(self.effects, self.rivals, strict=True):
            u, Q = np.asarray(u, float), np.asarray(Q, float)
            if u.shape != (S.shape[1],) or Q.shape[:1] != u.shape:
                raise InputError(
                    f"criterion T: effects of shape {u.shape} and rivals {Q.shape}: the rows have {S.shape[1]}"
                    " parameters; make both for these"
                )
            U, sizes, _ = np.linalg.svd(S @ Q, full_matrices=False)
            U = U[:, sizes > 1e-10 * max(sizes.max(initial=0.0), np.finfo(float).tiny)]
            shown = S @ u
            rest = shown - U @ (U.T @ shown)
            if not rest @ rest > _SHARES * (shown @ shown):
                raise InputError(
                    "criterion T: no candidate separates the rivals: what one model predicts the other explains; give"
                    " other candidates, another sensor, or fewer free parameters"
                )
            effects.append(jnp.asarray(shown))
            rivals.append(jnp.asarray(U))
        return Discrimination(tuple(effects), tuple(rivals))

    def efficiency(self, value: float, reference: float, rank: int) -> float:
        """How many times the poses of `value` a design of `reference` would have to repeat to reach it."""
        return float(np.divide(value, reference))


Criterion = Determinant | Average | Smallest | Discrimination
"""A pytree, so that its arrays may change without compiling anew, and its kind may not."""

CRITERIA = {"D": Determinant(), "A": Average(), "E": Smallest()}
"""The criteria that need nothing further, by the letter the literature gives them."""


def workspace(rows: ArrayLike) -> Average:
    """I-optimality: minus the mean variance of the errors `(pose, row, parameter)` summed over their rows.

    Raises:
        InputError: another shape, no pose, or a number that is not finite.
    """
    J = np.asarray(rows, float)
    if J.ndim != 3 or 0 in J.shape or not np.isfinite(J).all():
        raise InputError(f"workspace rows of shape {J.shape}: give finite (pose, row, parameter)")
    flat = J.reshape(-1, J.shape[2])
    return Average(jnp.asarray(flat.T @ flat / len(J)))


def discrimination(
    parameters: int, rival_a: ArrayLike, rival_b: ArrayLike, beta_a: ArrayLike, beta_b: ArrayLike | None = None
) -> Discrimination:
    """The criterion that separates two rival models, which share all parameters but their own.

    Args:
        parameters: how many columns the rows have.
        rival_a: the columns that only model a has.
        rival_b: the columns that only model b has.
        beta_a: a's hypothesised values, in the scaled units of the columns.
        beta_b: b's; None tests b against a only.

    Raises:
        InputError: columns that are not there or that both claim, a value missing, or all values zero.
    """
    columns = [np.atleast_1d(np.asarray(rival)) for rival in (rival_a, rival_b)]
    claimed = np.concatenate(columns)
    if claimed.dtype.kind not in "iu" or claimed.min() < 0 or claimed.max() >= parameters:
        raise InputError(f"criterion T: the rivals' columns are {claimed.tolist()}; name some of 0 to {parameters - 1}")
    if len(set(claimed.tolist())) != len(claimed):
        raise InputError(f"criterion T: the rivals' columns {claimed.tolist()} repeat; what both have is common")
    effects, rivals = [], []
    for own, beta, name in zip(columns, (beta_a, beta_b), "ab", strict=True):
        if beta is None:
            continue
        beta = np.atleast_1d(np.asarray(beta, float))
        if beta.shape != own.shape or not np.isfinite(beta).all() or not beta.any():
            raise InputError(
                f"criterion T: beta_{name} of shape {beta.shape} for {len(own)} columns; give one finite value for"
                " each, not all zero"
            )
        u = np.zeros(parameters)
        u[own] = beta
        effects.append(jnp.asarray(u))
        rivals.append(jnp.asarray(np.delete(np.eye(parameters), own, axis=1)))
    return Discrimination(tuple(effects), tuple(rivals))


def inverse(M: Array) -> Array:
    """The inverse of a symmetric positive matrix, exactly symmetric."""
    L = jnp.linalg.cholesky(M)
    half = solve_triangular(L, jnp.eye(len(M)), lower=True)
    return half.T @ half


def determined_coordinates(rows: ArrayLike, prior: ArrayLike | None = None) -> Coordinates:
    """The directions of parameter space that candidates and a prior determine.

    Args:
        rows: `(candidate, row, parameter)`, whitened, columns scaled to be comparable.
        prior: `(parameter, parameter)` information beside the candidates', if any.

    Raises:
        InputError: a wrong shape, a number that is not finite, a prior that is no information, nothing determined.
    """
    J, P = checked_rows(rows, prior)
    flat = J.reshape(-1, J.shape[2])
    return coordinates_of(P + flat.T @ flat, len(J))


def checked_rows(rows: ArrayLike, prior: ArrayLike | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows and prior in double precision, the prior symmetric, or zero where there is none.

    Raises:
        InputError: as `determined_coordinates`.
    """
    J = np.asarray(rows, np.float64)
    if J.ndim != 3 or 0 in J.shape:
        raise InputError(f"rows of shape {J.shape}: give (candidate, row, parameter), none of them empty")
    if not np.isfinite(np.sum(J)) and not np.isfinite(J).all():
        worst = int(np.argmin(np.isfinite(J).all((1, 2))))
        raise InputError(f"rows of candidate {worst} have a number that is not finite; leave it out")
    size = J.shape[2]
    P = np.zeros((size, size)) if prior is None else np.asarray(prior, np.float64)
    if P.shape != (size, size) or not np.isfinite(P).all():
        raise InputError(f"prior of shape {P.shape}: give a finite ({size}, {size}) for the rows' {size} parameters")
    largest = np.abs(P).max()
    if np.abs(P - P.T).max() > 1e-9 * largest or np.linalg.eigvalsh(P)[0] < -1e-9 * largest:
        raise InputError("prior: no information matrix (not symmetric, or a negative eigenvalue); give JᵀJ or C⁻¹")
    return J, (P + P.T) / 2


def coordinates_of(information: NDArray[np.float64], candidates: int) -> Coordinates:
    """The coordinates of an information matrix, so scaled that the mean of `candidates` is the identity.

    Raises:
        InputError: it is zero.
    """
    squares = np.diagonal(information)
    observable = squares > _OBSERVABLE * squares.max()  # the others are rounding, which must not be scaled up
    units = np.sqrt(np.where(observable, squares, max(float(squares.max()), np.finfo(float).tiny)))
    eigenvalues, V = np.linalg.eigh(information / units[:, None] / units)  # in units of the columns' own lengths
    kept = eigenvalues > DETERMINED * max(eigenvalues[-1], 0.0)
    if not kept.any():
        raise InputError("rows: all zero; no candidate depends on any parameter")
    scale, V = np.sqrt(eigenvalues[kept] / candidates), V[:, kept]
    inward = scale[:, None] * V.T * units
    determined, _ = np.linalg.qr(V * units[:, None])  # the undetermined directions are orthogonal to these
    outward = determined @ (determined.T @ (V / units[:, None] / scale))
    return Coordinates(outward, inward, inward @ determined)


def determined_value(criterion: Criterion, M: Array) -> Array:
    """The criterion, or −inf where M does not determine all directions."""
    eigenvalues = jnp.linalg.eigvalsh(M)
    value = criterion.value(M)
    return jnp.where((eigenvalues[0] > DESIGN_DETERMINES * eigenvalues[-1]) & jnp.isfinite(value), value, -jnp.inf)
