"""Orthonormal bases, rank, and projections onto complements."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.lapack import get_lapack_funcs

Array = NDArray[np.floating]

ROUNDING = 1e-13
"""Relative eigenvalue of a matrix of unit diagonal below which a direction is rounding."""
_MANY, _CLEARLY = 20, 100.0
"""Numbers from which a Cholesky factor is tried before eigenvalues, and the least square on its diagonal over rounding.

Either way rounding leaves an error of 1e-16 over the least eigenvalue, relative to the solution.
"""
_BLOCK = 64
"""Reflections that are applied at once."""
_potrf, _geqrf, _ormqr = get_lapack_funcs(("potrf", "geqrf", "ormqr"), dtype=float)


def unit_rows(columns: Array) -> Array:
    """Rows `(number, reading)` of unit length; those that are zero are left out."""
    norms = np.linalg.norm(columns, axis=1)
    if not (norms > 0).all():
        columns, norms = columns[norms > 0], norms[norms > 0]
    return columns / norms[:, None]


def orthonormal(rows: Array, rounding: float) -> Array:
    """An orthonormal basis `(rank, reading)` of the span of unit rows.

    A basis from a factor of the Gram matrix departs from orthonormality by rounding times the ratio of the
    eigenvalues. Multiplied by the inverse Cholesky factor of its own Gram matrix, which is near the identity, it is
    orthonormal, in a fraction of the time of Householder reflections (Y. Yamamoto et al., Electronic Transactions on
    Numerical Analysis 44, 2015).

    Args:
        rows: `(number, reading)`, of similar length each.
        rounding: eigenvalue of their Gram matrix, over the largest, below which a direction does not count.
    """
    if not len(rows):
        return rows
    basis = half_inverse(rows @ rows.T, rounding)[0].T @ rows
    return np.linalg.inv(np.linalg.cholesky(basis @ basis.T)) @ basis


def half_inverse(H: Array, rounding: float) -> tuple[Array, float]:
    """T `(number, rank)` with T Tᵀ the inverse of a positive semidefinite H, and the logarithm of its determinant.

    Directions without information, after H is scaled to unit diagonal, count in neither.
    """
    root = np.sqrt(np.maximum(np.diagonal(H), np.finfo(float).tiny))
    C = H / np.outer(root, root)
    factor = _cholesky(C, _CLEARLY * rounding)
    if factor is not None:
        T = solve_triangular(factor, np.eye(len(C)), lower=True).T
        return T / root[:, None], 2 * float(np.sum(np.log(np.diagonal(factor))) + np.sum(np.log(root)))
    eigenvalues, V = np.linalg.eigh(C)
    determined = eigenvalues > rounding * eigenvalues.max(initial=0.0)
    volume = float(np.sum(np.log(eigenvalues[determined])) + 2 * np.sum(np.log(root)))
    return V[:, determined] / (np.sqrt(eigenvalues[determined]) * root[:, None]), volume


def part_of_span(basis: Array, coordinates: Array, kept: NDArray[np.bool_], rounding: float) -> tuple[Array, Array]:
    """An orthonormal basis `(rank, reading)` of the span of some of the rows of another, and their coordinates in it.

    Of independent rows, directions that those left out alone have are reflected onto the first ones, which then go:
    that costs as much as there are rows to leave out.

    Args:
        basis: `(k, reading)`, orthonormal.
        coordinates: `(number, k)`, of the rows in it, of unit length.
        kept: `(number,)`.
        rounding: as of `orthonormal`.
    """
    if kept.all():
        return basis, coordinates
    stay = coordinates[kept]
    if len(coordinates) != len(basis) or not len(stay):
        turn = orthonormal(stay, rounding)
        return turn @ basis, stay @ turn.T
    directions = np.linalg.solve(coordinates, np.eye(len(coordinates))[:, ~kept])
    reflectors, tau, *_ = _geqrf(directions)
    turned, of_rows = (_ormqr("R", "N", reflectors, tau, matrix, _BLOCK * len(matrix))[0] for matrix in (basis.T, stay))
    return turned[:, directions.shape[1] :].T, of_rows[:, directions.shape[1] :]


def rank(columns: Array, rounding: float) -> int:
    """The numerical rank of columns `(number, reading)`."""
    return len(orthonormal(unit_rows(columns), rounding))


def outside(columns: Array, basis: Array) -> Array:
    """Columns `(number, reading)` less their projection on an orthonormal basis `(rank, reading)`."""
    return columns - (columns @ basis.T) @ basis


def scaled_solve(H: Array, b: Array, rounding: float = ROUNDING) -> Array:
    """x of H x = b for a positive semidefinite H scaled to unit diagonal, of least norm where that is singular.

    Numbers without information, whose rows of H are zero, are zero.
    """
    root = _scales(H)
    C = H / np.outer(root, root)
    factor = _cholesky(C, _CLEARLY * rounding)
    if factor is not None:
        return cho_solve((factor, True), b / root) / root
    eigenvalues, V = np.linalg.eigh(C)
    determined = eigenvalues > rounding * eigenvalues[-1]
    return V[:, determined] @ ((V[:, determined].T @ (b / root)) / eigenvalues[determined]) / root


def scaled_inverse(H: Array, rounding: float = ROUNDING) -> Array:
    """The pseudo-inverse of a positive semidefinite H, taken after scaling it to unit diagonal.

    It is zero for numbers without information, whose rows of H are zero.
    """
    root = _scales(H)
    C = H / np.outer(root, root)
    scale = np.outer(root, root)
    factor = _cholesky(C, _CLEARLY * rounding)
    if factor is not None:
        return cho_solve((factor, True), np.eye(len(C))) / scale
    return np.linalg.pinv(C, rcond=rounding, hermitian=True) / scale


def schur_complement(G: Array, known: NDArray[np.integer], rounding: float = 1e-12) -> Array:
    """The Schur complement `(number, number)` of a Gram matrix G: products of columns outside the span of `known`."""
    size = np.sqrt(np.maximum(np.diagonal(G), np.finfo(float).tiny))
    C = G / np.outer(size, size)
    inverse = np.linalg.pinv(C[np.ix_(known, known)], rcond=rounding, hermitian=True)
    return (C - C[:, known] @ inverse @ C[known]) * np.outer(size, size)


def _cholesky(C: Array, regular: float) -> Array | None:
    """The lower factor of a matrix of unit diagonal that is clearly regular; None of others, and of small ones."""
    if len(C) <= _MANY:
        return None
    factor, singular = _potrf(C, lower=True, clean=False)
    return factor if not singular and np.diagonal(factor).min() ** 2 > regular else None


def _scales(H: Array) -> Array:
    """What H is divided by for a unit diagonal; infinity where its diagonal is zero, so that the quotient is zero."""
    size = np.diagonal(H)
    return np.sqrt(np.where(size > np.finfo(float).tiny, size, np.inf))
