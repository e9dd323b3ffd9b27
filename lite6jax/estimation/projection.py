"""Orthonormal bases, rank, and projections of columns onto the orthogonal complement of others."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.linalg.lapack import get_lapack_funcs

Array = NDArray[np.floating]

ROUNDING = 1e-13
"""Relative eigenvalue of a matrix of unit diagonal below which a direction is rounding."""
_MANY, _CLEARLY = 20, 100.0
"""Numbers from which a Cholesky factor is tried before eigenvalues, and the least square on its diagonal over rounding.

Either way rounding leaves an error of 1e-16 over the least eigenvalue, relative to the solution.
"""
(_potrf,) = get_lapack_funcs(("potrf",), dtype=float)


def unit_rows(columns: Array) -> Array:
    """Rows `(number, reading)` of unit length; those that are zero are left out."""
    norms = np.linalg.norm(columns, axis=1)
    if not (norms > 0).all():
        columns, norms = columns[norms > 0], norms[norms > 0]
    return columns / norms[:, None]


def orthonormal(rows: Array, rounding: float) -> Array:
    """An orthonormal basis `(rank, reading)` of the span of unit rows.

    A basis from eigenvectors of the Gram matrix departs from orthonormality by rounding times the ratio of the
    eigenvalues. Multiplied by the inverse Cholesky factor of its own Gram matrix, which is near the identity, it is
    orthonormal, in a fraction of the time of Householder reflections (Y. Yamamoto et al., Electronic Transactions on
    Numerical Analysis 44, 2015).

    Args:
        rows: `(number, reading)`, of similar length each.
        rounding: eigenvalue of their Gram matrix, over the largest, below which a direction does not count.
    """
    if not len(rows):
        return rows
    eigenvalues, V = np.linalg.eigh(rows @ rows.T)
    kept = eigenvalues > rounding * eigenvalues[-1]
    basis = (V[:, kept] / np.sqrt(eigenvalues[kept])).T @ rows
    return np.linalg.inv(np.linalg.cholesky(basis @ basis.T)) @ basis


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
    kept = eigenvalues > rounding * eigenvalues[-1]
    return V[:, kept] @ ((V[:, kept].T @ (b / root)) / eigenvalues[kept]) / root


def scaled_inverse(H: Array, rounding: float = ROUNDING) -> Array:
    """The pseudo-inverse of a positive semidefinite H, taken after scaling it to unit diagonal.

    It is zero for numbers without information, whose rows of H are zero.
    """
    root = _scales(H)
    C, scale = H / np.outer(root, root), np.outer(root, root)
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
