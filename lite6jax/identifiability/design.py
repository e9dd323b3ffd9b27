"""Which poses to record: those, out of many candidates, whose information is best; and where exactly to put them.

A design is built greedily and then improved by exchange: each pose in turn is taken out and the best candidate put in,
until none improves (V. Fedorov, 1972, in the cyclic order of R. Cook and C. Nachtsheim, Technometrics 22, 1980). One
rule serves every criterion Φ(M). Its gradient G = ∂Φ/∂M gives each candidate's gain, damped by its leverage,

    Σ over rows j:  jᵀGj / (1 + jᵀM⁻¹j),

which for a single row is exact for A, I, T up to a monotone function, and D (Sherman–Morrison, or the determinant's
lemma). It ranks all candidates by two matrix products in single precision. Rounds of exchange look at the foremost of
them, ranked anew for each pose by the same products and then evaluated exactly, until the foremost of all improve
nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from numpy.typing import ArrayLike, NDArray

from lite6jax.errors import InputError
from lite6jax.identifiability.criteria import (
    DESIGN_DETERMINES,
    Coordinates,
    Criterion,
    checked_rows,
    coordinates_of,
    determined_value,
    inverse,
)

_RIDGE = 1e-7
"""Of a candidate's mean information: keeps M invertible while poses are few; what is reported is without it."""
_EXACT = 24
"""How many of the foremost candidates are evaluated exactly."""
_FOREMOST = 8192
"""How many of the candidates an exchange looks at until the foremost are chosen anew; in the end none improves."""
_TOGETHER = 5
"""Poses built between two such choices."""
_COLUMNS = 6000
"""Columns of a block of the matrix products: what keeps a block within a core's cache."""
_IMPROVES = 1e-9


@dataclass(frozen=True, eq=False)
class Design:
    """Chosen poses, best first.

    Attributes:
        indices: `(pose,)`, of the candidates, each once, ordered so that each beginning of them is as good as can be.
        value: the criterion of them all.
        values: `(pose,)`, the criterion of the first 1, 2, … of them; −inf where they do not determine all directions.
        start_value: of the design that the exchange began with: the given one, or the greedy one.
        rank: how many directions of parameter space the candidates (and the prior) determine.
        exchanges: poses that were exchanged.
        cycles: how often the exchange went through all poses, the last time in vain unless the limit was reached.
    """

    indices: NDArray[np.integer]
    value: float
    values: NDArray[np.floating]
    start_value: float
    rank: int
    exchanges: int
    cycles: int


def choose(
    rows: ArrayLike,
    count: int,
    criterion: Criterion,
    prior: ArrayLike | None = None,
    start: ArrayLike | None = None,
    starts: int = 1,
    seed: int = 0,
    cycles: int = 60,
) -> Design:
    """The `count` candidates whose information is best by `criterion`.

    Args:
        rows: `(candidate, row, parameter)`, whitened, columns scaled to be comparable (m and rad are not): A and E
            depend on the scale. Directions that no candidate determines are left out of the criterion.
        count: how many.
        criterion: by what they are judged.
        prior: `(parameter, parameter)`, information that is there already: a prior, or poses that are recorded.
        start: `(count,)` candidates to begin with; greedy choice if not given.
        starts: how many beginnings to try, the others drawn at random; the best end counts. A single exchange can be
            caught by E, which has ridges, where poses are hardly more than needed.
        seed: of the random beginnings.
        cycles: the most times that the exchange goes through all poses.

    Raises:
        InputError: as `determined_coordinates`; more poses than candidates, too few for the parameters, a start that
            repeats or names no candidate, or what the criterion refuses.
    """
    J, P = checked_rows(rows, prior)
    total = len(J)
    if not 1 <= count <= total:
        raise InputError(f"{count} poses out of {total} candidates: choose 1 to {total}, or give more candidates")
    if starts < 1:
        raise InputError(f"starts = {starts}: give 1 or more")
    begin = None if start is None else _start(start, count, total)
    flat = J.reshape(-1, J.shape[2])
    coordinates = coordinates_of(P + flat.T @ flat, total)
    reduced, base = _reduced(J, P, coordinates)
    rank = len(base)
    _check_count(count, J.shape[1], base)
    criterion = criterion.within(coordinates)
    pool = _Pool(reduced)
    ridged = base + _RIDGE * np.eye(rank)

    rng = np.random.default_rng(seed)
    ends: list[Design] = []
    for attempt in range(starts):
        if attempt:
            chosen = rng.choice(total, count, replace=False)
        elif begin is not None:
            chosen = begin
        else:
            chosen = _built(criterion, pool, ridged, count)
        improved, exchanges, made = _exchanged(criterion, pool, ridged, chosen, cycles)
        ordered = [_ordered(criterion, reduced, base, stage) for stage in (chosen, improved)]
        indices, values = max(ordered, key=lambda design: design[1][-1])
        begun = float(ordered[0][1][-1]) if not ends else ends[0].start_value
        ends.append(Design(indices, float(values[-1]), values, begun, rank, exchanges, made))
    return max(ends, key=lambda end: end.value)


def random_designs(
    rows: ArrayLike,
    count: int,
    criterion: Criterion,
    designs: int = 200,
    prior: ArrayLike | None = None,
    seed: int = 0,
) -> NDArray[np.floating]:
    """The criterion of designs drawn at random, `(design,)`; −inf of those that do not determine all directions.

    Args and errors are those of `choose`.
    """
    J, P = checked_rows(rows, prior)
    if not 1 <= count <= len(J) or designs < 1:
        raise InputError(
            f"{designs} designs of {count} poses out of {len(J)} candidates: give 1 or more of 1 to {len(J)} poses"
        )
    flat = J.reshape(-1, J.shape[2])
    coordinates = coordinates_of(P + flat.T @ flat, len(J))
    reduced, base = _reduced(J, P, coordinates)
    rng = np.random.default_rng(seed)
    chosen = np.stack([rng.choice(len(J), count, replace=False, shuffle=False) for _ in range(designs)])
    return np.asarray(_values_of(criterion.within(coordinates), jnp.asarray(reduced), jnp.asarray(base), chosen))


def _reduced(
    J: NDArray[np.float64], P: NDArray[np.float64], coordinates: Coordinates
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows `(candidate, row, k)` and prior `(k, k)` in coordinates."""
    T = coordinates.outward
    return (J.reshape(-1, J.shape[2]) @ T).reshape(*J.shape[:2], -1), T.T @ P @ T


def _check_count(count: int, rows: int, base: NDArray[np.float64]) -> None:
    eigenvalues = np.linalg.eigvalsh(base)
    known = int(np.sum(eigenvalues > DESIGN_DETERMINES * max(eigenvalues[-1], 0.0)))
    needed = -(-(len(base) - known) // rows)
    if count < needed:
        raise InputError(
            f"{count} poses: too few for the {len(base)} directions that the candidates determine; choose at least"
            f" {needed}, or give a prior"
        )


def _start(start: ArrayLike, count: int, total: int) -> NDArray[np.int64]:
    begin = np.asarray(start)
    if begin.shape != (count,) or begin.dtype.kind not in "iu":
        raise InputError(f"start of shape {begin.shape} and type {begin.dtype}: give {count} candidates' numbers")
    if begin.min() < 0 or begin.max() >= total or len(np.unique(begin)) < count:
        raise InputError(f"start: each of 0 to {total - 1} at most once; correct it")
    return begin.astype(np.int64)


class _Pool:
    """The candidates, and those of them that are foremost for an information matrix."""

    def __init__(self, rows: NDArray[np.float64]) -> None:
        self.rows = rows
        self.blocks = _blocks(rows)
        self.size = min(_FOREMOST, len(rows))

    def foremost(
        self, criterion: Criterion, M: NDArray[np.float64], chosen: NDArray[np.integer]
    ) -> tuple[NDArray[np.integer], tuple[Array, Array]]:
        """`chosen` and the others with the largest gain, `(size,)`; their rows, and `_blocks` of these."""
        gains = np.array(_gains_of(criterion, self.blocks, jnp.asarray(M)))[: len(self.rows)]
        gains[chosen] = np.inf
        names = np.argpartition(-gains, self.size - 1)[: self.size]
        names = np.concatenate([chosen, np.setdiff1d(names, chosen)])
        return names, (jnp.asarray(self.rows[names]), _blocks(self.rows[names]))


def _built(criterion: Criterion, pool: _Pool, base: NDArray[np.float64], count: int) -> NDArray[np.integer]:
    """Candidates chosen one after the other, `(count,)`."""
    chosen = np.zeros(0, np.int64)
    while len(chosen) < count:
        M = base + _information_of(pool.rows[chosen])
        names, some = pool.foremost(criterion, M, chosen)
        taken = jnp.arange(count + _TOGETHER)  # those chosen stand first; the rest is out of range
        taken = jnp.where(taken < len(chosen), taken, len(names))
        new = np.asarray(_build(criterion, some, jnp.asarray(M), taken, len(chosen), _TOGETHER))
        chosen = np.concatenate([chosen, names[new]])
    return chosen[:count]


def _exchanged(
    criterion: Criterion, pool: _Pool, base: NDArray[np.float64], chosen: NDArray[np.integer], cycles: int
) -> tuple[NDArray[np.integer], int, int]:
    """A design improved until no exchange with the then foremost candidates does, the exchanges and rounds made."""
    exchanges = made = 0
    count = len(chosen)
    while made < cycles:
        names, some = pool.foremost(criterion, base + _information_of(pool.rows[chosen]), chosen)
        at, done, visited = _exchange(criterion, some, jnp.asarray(base), jnp.arange(count), cycles - made)
        chosen = names[np.asarray(at)]
        exchanges += int(done)
        made += -(-int(visited) // count)
        if not done or pool.size == len(pool.rows):
            break
    return chosen, exchanges, made


def _information_of(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    flat = rows.reshape(-1, rows.shape[2])
    return flat.T @ flat


def _blocks(rows: NDArray[np.float64]) -> Array:
    """`(block, k, row, candidate)` in single precision, filled up with zeros."""
    total, height, k = rows.shape
    width = min(max(_COLUMNS // height, 1), total)
    padded = np.zeros((-(-total // width) * width, height, k), np.float32)
    padded[:total] = rows
    return jnp.asarray(np.ascontiguousarray(padded.reshape(-1, width, height, k).transpose(0, 3, 2, 1)))


def _gains(criterion: Criterion, blocks: Array, M: Array) -> Array:
    """The damped first-order gain of each candidate, `(candidate,)` with the filling."""
    k = len(M)
    G = jax.grad(criterion.smooth)(M)
    both = jnp.concatenate([inverse(M), (G + G.T) / jnp.trace(G)]).astype(jnp.float32)

    def of_block(block: Array) -> Array:
        flat = block.reshape(k, -1)
        products = both @ flat
        leverage, gain = (jnp.sum(flat * part, 0) for part in (products[:k], products[k:]))
        return jnp.sum((gain / (1 + leverage)).reshape(block.shape[1:]), 0)

    return lax.map(of_block, blocks).reshape(-1)


_gains_of = jax.jit(_gains)


def _each(judge: Callable[[Array], Array], arrays: Array) -> Array:
    """`judge` of each array, one after the other: as fast as jax.vmap at these sizes, and it always returns.

    On a CPU a batched factorisation waits, on a thread of XLA's pool, for tasks in that same pool; two independent ones
    on two cores wait for ever (jaxlib 0.10, `ParallelBatchMap`). A single matrix needs no task.
    """
    return lax.map(judge, arrays)


def _best_addition(
    judge: Callable[[Array], Array], criterion: Criterion, pool: tuple[Array, Array], M: Array, taken: Array
) -> tuple[Array, Array]:
    """The candidate, none of `taken`, that is best to add to M, and the judgement of their sum."""
    rows, blocks = pool
    gains = _gains(criterion, blocks, M)
    gains = jnp.where(jnp.arange(gains.size) < len(rows), gains, -jnp.inf).at[taken].set(-jnp.inf)
    gains, foremost = lax.top_k(gains, min(_EXACT, len(rows)))
    values = _each(lambda J: judge(M + J.T @ J), rows[jnp.minimum(foremost, len(rows) - 1)])
    values = jnp.where(jnp.isfinite(values) & (gains > -jnp.inf), values, -jnp.inf)
    best = jnp.argmax(values)
    return foremost[best], values[best]


@partial(jax.jit, static_argnames="count")
def _build(
    criterion: Criterion, pool: tuple[Array, Array], M: Array, taken: Array, already: Array | int, count: int
) -> Array:
    """`count` more candidates, one after the other; `taken` `(any,)` holds those `already` chosen, then fillers."""
    rows, _ = pool

    def body(i: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        taken, M = state
        new, _ = _best_addition(criterion.smooth, criterion, pool, M, taken)
        return taken.at[already + i].set(new), M + rows[new].T @ rows[new]

    taken, _ = lax.fori_loop(0, count, body, (taken, M))
    return lax.dynamic_slice_in_dim(taken, already, count)


@jax.jit
def _exchange(
    criterion: Criterion, pool: tuple[Array, Array], base: Array, indices: Array, cycles: int | Array
) -> tuple[Array, Array, Array]:
    """Improves a design until no exchange does. Returns it, the exchanges made and the poses visited."""
    rows, _ = pool
    count = len(indices)

    def go_on(state: tuple[Array, ...]) -> Array:
        _, _, _, visited, in_vain, _ = state
        return (in_vain < count) & (visited < cycles * count)

    def visit(state: tuple[Array, ...]) -> tuple[Array, ...]:
        indices, M, value, visited, in_vain, exchanges = state
        i = visited % count
        old = rows[indices[i]]
        without = M - old.T @ old
        new, reached = _best_addition(criterion.value, criterion, pool, without, indices)
        better = reached > value + _IMPROVES * jnp.maximum(jnp.abs(value), 1e-6)
        indices = indices.at[i].set(jnp.where(better, new, indices[i]))
        M = jnp.where(better, without + rows[new].T @ rows[new], M)
        value = jnp.where(better, reached, value)
        return indices, M, value, visited + 1, jnp.where(better, 0, in_vain + 1), exchanges + better

    M = base + jnp.einsum("nri,nrj->ij", rows[indices], rows[indices])
    zero = jnp.zeros((), jnp.int32)
    first = (indices.astype(jnp.int32), M, criterion.value(M), zero, zero, zero)
    indices, _, _, visited, _, exchanges = lax.while_loop(go_on, visit, first)
    return indices, exchanges, visited


def _ordered(
    criterion: Criterion, reduced: NDArray[np.float64], base: NDArray[np.float64], indices: NDArray[np.integer]
) -> tuple[NDArray[np.integer], NDArray[np.float64]]:
    """The design best first, and the criterion of each of its beginnings."""
    order, values = _order(criterion, jnp.asarray(reduced[indices]), jnp.asarray(base))
    return indices[np.asarray(order)], np.asarray(values)


@jax.jit
def _order(criterion: Criterion, rows: Array, base: Array) -> tuple[Array, Array]:
    products = jnp.einsum("nri,nrj->nij", rows, rows)

    def body(i: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        order, M = state
        values = _each(criterion.smooth, M + products)
        values = jnp.where(jnp.isfinite(values), values, -jnp.finfo(float).max).at[order].set(-jnp.inf)
        new = jnp.argmax(values)
        return order.at[i].set(new), M + products[new]

    count = len(rows)
    ridged = base + _RIDGE * jnp.eye(len(base))
    order, _ = lax.fori_loop(0, count, body, (jnp.full(count, count), ridged))
    return order, _each(partial(determined_value, criterion), base + jnp.cumsum(products[order], 0))


@jax.jit
def _values_of(criterion: Criterion, rows: Array, base: Array, designs: Array) -> Array:
    def of(indices: Array) -> Array:
        flat = rows[indices].reshape(-1, rows.shape[2])
        return determined_value(criterion, base + flat.T @ flat)

    return _each(of, designs)
