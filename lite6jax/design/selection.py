"""Which candidates to take: those whose information is best by a criterion.

A design is built greedily and then improved by exchange: each pose in turn is taken out and the best candidate put in,
until none improves (V. Fedorov, 1972, in the cyclic order of R. Cook and C. Nachtsheim, Technometrics 22, 1980). With M
the information of the other poses, C = M⁻¹ and S = I + J C Jᵀ, a pose with the whitened rows J adds

    log det S                 to log det M         (D; the matrix determinant lemma),
    tr(S⁻¹ J C W C Jᵀ)        to −tr(W C)          (A, I, T; Sherman, Morrison and Woodbury).
"""

from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.errors import InputError

Array = NDArray[np.floating]
Indices = NDArray[np.integer]

_OBSERVABLE = 1e-20
"""A parameter's information over the largest, under which no candidate depends on it."""
_DETERMINED = 1e-10
"""An eigenvalue of the information (columns of unit size) over the largest, above which a direction is determined."""
_DESIGN_DETERMINES = 1e-12
"""The same of a design's information, whose poses are few."""
_LOST = 1e-9
"""What share of a weight may lie in directions that nothing determines; rounding leaves 1e-12."""
_RIDGE = 1e-7
"""Of a candidate's mean information: keeps M invertible while poses are few; what is reported is without it."""
_FOREMOST = 1500
"""How many of the candidates an exchange looks at until the foremost are chosen anew; in the end none improves."""
_TOGETHER = 5
"""Poses built between two such choices."""
_CYCLES = 60
"""The most times that the exchange goes through all poses."""
_IMPROVES = 1e-9
_BLOCK = 4096
"""Candidates that are ranked together, within a core's cache."""


@final
@dataclass(frozen=True, eq=False)
class Criterion:
    """What makes one information matrix M better than another; the higher, the better.

    Attributes:
        weight: W `(parameter, parameter)` of −tr(W M⁻¹), minus a weighted sum of variances (H. Chernoff, Ann. Math.
            Stat. 24, 1953): the identity of A-optimality, the mean information Σ JᵀJ / count of the errors that matter
            of I-optimality. None is D-optimality, log det M (A. Wald, 1943).
        offset: added to log det M.
        confounded: what is said where `weight` has a direction that neither data nor prior determine.
    """

    weight: Array | None = None
    offset: float = 0.0
    confounded: str = "criterion: a direction of its weight is determined by no candidate; give others"

    def value(self, M: Array) -> Array:
        """The criterion of matrices `(…, k, k)`; −inf where one does not determine all directions."""
        sizes = np.linalg.eigvalsh(M)
        determined = sizes[..., 0] > _DESIGN_DETERMINES * sizes[..., -1]
        M = np.where(determined[..., None, None], M, np.eye(M.shape[-1]))
        if self.weight is None:
            value = self.offset + np.linalg.slogdet(M)[1]
        else:
            value = -np.sum(self.weight * np.linalg.inv(M), (-2, -1))
        return np.where(determined, value, -np.inf)

    def gains(self, rows: Array, M: Array) -> Array:
        """What each pose `(pose, row, k)` adds to the criterion of M, `(pose,)`."""
        C = np.linalg.inv(M)
        S = np.eye(rows.shape[1]) + _products(rows, C)
        if self.weight is None:
            return np.linalg.slogdet(S)[1]
        return np.sum(np.linalg.inv(S) * _products(rows, C @ self.weight @ C), (1, 2))

    def rank(self, rows: Array, M: Array) -> Array:
        """As `gains`, with each row of a pose by itself: exact for a single row, and fast."""
        C = np.linalg.inv(M)
        weighted, found = None if self.weight is None else C @ self.weight @ C, np.empty(len(rows))
        for first in range(0, len(rows), _BLOCK):
            block = rows[first : first + _BLOCK]
            flat = block.reshape(-1, len(M))
            leverage = np.einsum("nk,nk->n", flat @ C, flat)
            if weighted is None:
                each = np.log1p(leverage)
            else:
                each = np.einsum("nk,nk->n", flat @ weighted, flat) / (1 + leverage)
            found[first : first + _BLOCK] = each.reshape(len(block), -1).sum(1)
        return found


def _products(J: Array, C: Array) -> Array:
    """J C Jᵀ of each pose `(pose, row, k)`."""
    flat = J.reshape(-1, J.shape[2]) @ C
    return np.einsum("nrk,nsk->nrs", flat.reshape(J.shape), J)


def accuracy_criterion(rows: Array) -> Criterion:
    """I-optimality: minus the mean variance of the errors `(pose, row, parameter)` summed over their rows."""
    flat = rows.reshape(-1, rows.shape[2])
    return Criterion(
        flat.T @ flat / len(rows),
        confounded="criterion I: the workspace's error has directions that no candidate determines; give a prior for"
        " them, a sensor that observes them, or leave these errors out",
    )


@final
class Pool:
    """The candidates of a design, in coordinates of the directions that they and a prior determine.

    Attributes:
        outward: `(parameter, k)`, parameters of coordinates, so scaled that the mean information is the identity.
        rows: `(candidate, row, k)` whitened.
        base: `(k, k)` information of the prior.
    """

    def __init__(self, rows: ArrayLike, prior: ArrayLike | None = None) -> None:
        """Takes the candidates.

        Args:
            rows: `(candidate, row, parameter)`, whitened, columns scaled to be comparable (m and rad are not): A
                depends on the scale. Directions that no candidate determines are left out of the criterion.
            prior: `(parameter, parameter)`, information that is there already: a prior, or poses that are recorded.

        Raises:
            InputError: a number that is not finite, or nothing determined.
        """
        J = np.asarray(rows, np.float64)
        if not np.isfinite(np.sum(J)) and not np.isfinite(J).all():
            worst = int(np.argmin(np.isfinite(J).all((1, 2))))
            raise InputError(f"rows of candidate {worst} have a number that is not finite; leave it out")
        flat = J.reshape(-1, J.shape[2])
        P = np.zeros((flat.shape[1],) * 2) if prior is None else np.asarray(prior, np.float64)
        information = P + flat.T @ flat
        squares = np.diagonal(information)
        if not squares.any():
            raise InputError("rows: all zero; no candidate depends on any parameter")
        observable = squares > _OBSERVABLE * squares.max()  # the others are rounding, which must not be scaled up
        self._unit = np.sqrt(np.where(observable, squares, squares.max()))
        sizes, V = np.linalg.eigh(information / self._unit[:, None] / self._unit)
        determined = sizes > _DETERMINED * sizes[-1]
        self._basis = V[:, determined]
        scale = np.sqrt(sizes[determined] / len(J))
        # in the parameters' own units the undetermined directions are orthogonal to these
        Q, _ = np.linalg.qr(self._basis * self._unit[:, None])
        self.outward = Q @ (Q.T @ (self._basis / self._unit[:, None] / scale))
        self.base = self.outward.T @ P @ self.outward
        self.rows = self.express(J)

    def express(self, rows: Array) -> Array:
        """Rows `(pose, row, parameter)` in coordinates, `(pose, row, k)`."""
        return (rows.reshape(-1, rows.shape[2]) @ self.outward).reshape(*rows.shape[:2], -1)

    def apply(self, criterion: Criterion) -> Criterion:
        """The criterion of an information matrix in coordinates.

        Raises:
            InputError: a weight with directions that neither data nor prior determine.
        """
        if criterion.weight is None:
            return Criterion(offset=-2 * float(np.log(np.abs(np.diagonal(np.linalg.qr(self.outward).R))).sum()))
        W = criterion.weight / self._unit[:, None] / self._unit
        if np.trace(W) - np.trace(self._basis.T @ W @ self._basis) > _LOST * np.trace(W):
            raise InputError(criterion.confounded)
        return Criterion(self.outward.T @ criterion.weight @ self.outward)

    def average(self) -> Criterion:
        """A-optimality: minus the sum of the variances of the determined directions."""
        return Criterion(self.outward.T @ self.outward)

    def accumulate(self, rows: Array) -> Array:
        """The information of the prior and of the first 1, 2, … of rows `(pose, row, k)`, `(pose, k, k)`."""
        return self.base + np.cumsum(np.einsum("nri,nrj->nij", rows, rows), 0)

    def information(self, chosen: ArrayLike) -> Array:
        """The information of the prior and some candidates, with what keeps it invertible."""
        flat = self.rows[np.asarray(chosen, int)].reshape(-1, self.rows.shape[2])
        return self.base + _RIDGE * np.eye(len(self.base)) + flat.T @ flat

    def foremost(self, criterion: Criterion, chosen: Indices) -> Indices:
        """`chosen`, and the candidates that rank first beside them."""
        gains = criterion.rank(self.rows, self.information(chosen))
        gains[chosen] = np.inf
        size = min(_FOREMOST + len(chosen), len(gains))
        names = np.argpartition(-gains, size - 1)[:size]
        return np.concatenate([chosen, np.setdiff1d(names, chosen)])


class Design(NamedTuple):
    """Chosen poses, best first.

    Attributes:
        indices: `(pose,)`, of the candidates, each once, ordered so that each beginning of them is as good as can be.
        values: `(pose,)`, the criterion of the first 1, 2, … of them; −inf where they do not determine all directions.
        rank: how many directions of parameter space the candidates (and the prior) determine.
        exchanges: poses that were exchanged.
        cycles: how often the exchange went through all poses, the last time in vain unless the limit was reached.
    """

    indices: Indices
    values: Array
    rank: int
    exchanges: int
    cycles: int


def choose(pool: Pool, count: int, criterion: Criterion) -> Design:
    """The `count` candidates whose information is best by `criterion`, which is in the pool's coordinates.

    Raises:
        InputError: more poses than candidates, or too few for the parameters.
    """
    total, height, rank = pool.rows.shape
    if not 1 <= count <= total:
        raise InputError(f"{count} poses out of {total} candidates: choose 1 to {total}, or give more candidates")
    sizes = np.linalg.eigvalsh(pool.base)
    known = int(np.sum(sizes > _DESIGN_DETERMINES * max(sizes[-1], 0.0)))
    needed = -(-(rank - known) // height)
    if count < needed:
        raise InputError(
            f"{count} poses: too few for the {rank} directions that the candidates determine; choose at least"
            f" {needed}, or give a prior"
        )
    chosen = np.zeros(0, np.int64)
    while len(chosen) < count:
        names = pool.foremost(criterion, chosen)
        chosen = names[_build(pool, criterion, names, len(chosen), min(len(chosen) + _TOGETHER, count))]
    chosen, exchanges, cycles = exchange(pool, criterion, chosen)
    chosen = chosen[_build(pool, criterion, chosen, 0, count)]
    return Design(chosen, criterion.value(pool.accumulate(pool.rows[chosen])), rank, exchanges, cycles)


def _build(pool: Pool, criterion: Criterion, names: Indices, already: int, count: int) -> list[int]:
    """`count` of `names`, which begin with those `already` chosen: each the best beside the ones before it."""
    rows, chosen = pool.rows[names], list(range(already))
    while len(chosen) < count:
        gains = criterion.gains(rows, pool.information(names[chosen]))
        gains[chosen] = -np.inf
        chosen.append(int(np.argmax(gains)))
    return chosen


def exchange(pool: Pool, criterion: Criterion, chosen: Indices) -> tuple[Indices, int, int]:
    """A design `(pose,)` improved until no exchange with the foremost candidates does, the exchanges and cycles."""
    exchanges = cycles = 0
    count = len(chosen)
    while cycles < _CYCLES:
        names, at = pool.foremost(criterion, chosen), list(range(count))
        rows, made, visited, in_vain = pool.rows[names], 0, 0, 0
        while in_vain < count and cycles + visited // count < _CYCLES:
            i = visited % count
            others = at[:i] + at[i + 1 :]
            gains = criterion.gains(rows, pool.information(names[others]))
            gains[others] = -np.inf
            best = int(np.argmax(gains))
            better = gains[best] > gains[at[i]] * (1 + _IMPROVES)
            at[i] = best if better else at[i]
            made, in_vain, visited = made + better, 0 if better else in_vain + 1, visited + 1
        chosen, exchanges, cycles = names[at], exchanges + made, cycles + -(-visited // count)
        if not made or len(names) == len(pool.rows):
            break
    return chosen, int(exchanges), cycles
