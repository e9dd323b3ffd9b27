"""Orthonormal bases, rank, and projections onto complements."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.lapack import get_lapack_funcs

from lite6jax.array_types import Array, Integers, Mask

ROUNDING = 1e-13
"""Relative eigenvalue of a matrix of unit diagonal below which a direction is rounding."""
_MANY = 20
_CLEARLY = 100.0
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
        columns = columns[norms > 0]
        norms = norms[norms > 0]
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


def diagonal_root(H: Array) -> Array:
    """`(number,)`, the root of the diagonal of H, never zero: its outer product scales H to unit diagonal."""
    return np.sqrt(np.maximum(np.diagonal(H), np.finfo(float).tiny))


def half_inverse(H: Array, rounding: float) -> tuple[Array, float]:
    """T `(number, rank)` with T Tᵀ the inverse of a positive semidefinite H, and the logarithm of its determinant.

    Directions without information, after H is scaled to unit diagonal, count in neither.
    """
    root = diagonal_root(H)
    C = H / np.outer(root, root)
    factor = _cholesky(C, _CLEARLY * rounding)
    if factor is not None:
        T = solve_triangular(factor, np.eye(len(C)), lower=True).T
        return T / root[:, None], 2 * float(np.sum(np.log(np.diagonal(factor))) + np.sum(np.log(root)))
    eigenvalues, V = np.linalg.eigh(C)
    determined = eigenvalues > rounding * eigenvalues.max(initial=0.0)
    volume = float(np.sum(np.log(eigenvalues[determined])) + 2 * np.sum(np.log(root)))
    return V[:, determined] / (np.sqrt(eigenvalues[determined]) * root[:, None]), volume


def rank(columns: Array, rounding: float) -> int:
    """The numerical rank of columns `(number, reading)`."""
    return len(orthonormal(unit_rows(columns), rounding))


def outside(columns: Array, basis: Array) -> Array:
    """Columns `(number, reading)` less their projection on an orthonormal basis `(rank, reading)`."""
    return columns - (columns @ basis.T) @ basis


@final
@dataclass(frozen=True, eq=False)
class Span:
    """The span of some rows `(number, reading)`, or what becomes of it as rows go and others come.

    A projection on what remains is that on all directions, less that on those which the rows that went had alone. So
    sums of products with the many directions are taken once, and changed by those with few.

    Attributes:
        whole: `(k, reading)`, orthonormal, of all rows.
        coordinates: `(number, k)`, in it, of the rows that stay, of unit length.
        changes: `(change, reading)`, orthonormal directions in the whole that go, and directions beside it that come.
        sign: `(change,)`, -1 of those that go, 1 of those that come.
    """

    whole: Array
    coordinates: Array
    changes: Array
    sign: Array

    @classmethod
    def of_rows(cls, rows: Array, rounding: float) -> "Span":
        """Takes the span of unit rows `(number, reading)`, `rounding` as of `orthonormal`."""
        whole = orthonormal(rows, rounding)
        return cls(whole, rows @ whole.T, np.zeros((0, rows.shape[1])), np.zeros(0))

    @cached_property
    def basis(self) -> Array:
        """An orthonormal basis `(rank, reading)`: directions that go are reflected onto the first ones of the whole."""
        basis = self.whole
        going = self.changes[self.sign < 0]
        if len(going):
            reflectors, tau, *_ = _geqrf(basis @ going.T)
            basis = _ormqr("R", "N", reflectors, tau, basis.T, _BLOCK * basis.shape[1])[0][:, len(going) :].T
        coming = self.changes[self.sign > 0]
        return np.concatenate([basis, coming]) if len(coming) else basis

    def part(self, stays: Mask, rounding: float) -> "Span":
        """The span of those rows alone that stay, `(number,)`."""
        if len(self.changes):
            basis = self.basis
            rows = np.concatenate([self.coordinates @ self.whole, self.changes[self.sign > 0]])
            unchanged = Span(basis, rows @ basis.T, self.changes[:0], self.sign[:0])
            return unchanged.part(stays, rounding)
        if stays.all():
            return self
        count = len(self.coordinates)
        if not stays.any():
            going = np.eye(len(self.whole))
        elif count == len(self.whole):
            going = np.linalg.qr(np.linalg.solve(self.coordinates, np.eye(count)[:, ~stays]))[0].T
        else:
            staying = orthonormal(self.coordinates[stays], rounding)
            going = np.linalg.qr(staying.T, mode="complete")[0][:, len(staying) :].T
        return replace(
            self, coordinates=self.coordinates[stays], changes=going @ self.whole, sign=np.full(len(going), -1.0)
        )

    def extended(self, rows: Array, rounding: float) -> "Span":
        """The span with more rows `(number, reading)`, as directions of their own."""
        further = orthonormal(self.outside(unit_rows(rows)), rounding)
        changes = np.concatenate([self.changes, further])
        return replace(self, changes=changes, sign=np.append(self.sign, np.ones(len(further))))

    def outside(self, columns: Array) -> Array:
        """Columns `(number, reading)` less their projection on it."""
        beside = outside(columns, self.whole)
        if len(self.changes):
            return beside - ((columns @ self.changes.T) * self.sign) @ self.changes
        return beside


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


def schur_complement(G: Array, known: Integers, rounding: float = 1e-12) -> Array:
    """The Schur complement `(number, number)` of a Gram matrix G: products of columns outside the span of `known`."""
    size = diagonal_root(G)
    C = G / np.outer(size, size)
    inverse = np.linalg.pinv(C[np.ix_(known, known)], rcond=rounding, hermitian=True)
    return (C - C[:, known] @ inverse @ C[known]) * np.outer(size, size)


def _cholesky(C: Array, regular: float) -> Array | None:
    """The lower factor of a matrix of unit diagonal that is clearly regular; None of others, and of small ones."""
    if len(C) <= _MANY:
        return None
    factor, singular = _potrf(C, lower=True, clean=False)
    if not singular and np.diagonal(factor).min() ** 2 > regular:
        return factor
    return None


def _scales(H: Array) -> Array:
    """What H is divided by for a unit diagonal; infinity where its diagonal is zero, so that the quotient is zero."""
    size = np.diagonal(H)
    return np.sqrt(np.where(size > np.finfo(float).tiny, size, np.inf))
