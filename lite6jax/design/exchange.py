"""Building a design candidate by candidate, and exchanging its poses until no exchange improves it.

The design is built greedily and then improved by exchange: each pose in turn is taken out and the best candidate put
in, until none improves (V. Fedorov, 1972, in the cyclic order of R. Cook and C. Nachtsheim, Technometrics 22, 1980).
One rule serves every criterion Φ(M). Its gradient G = ∂Φ/∂M gives each candidate's gain, damped by its leverage,

    Σ over rows j:  jᵀGj / (1 + jᵀM⁻¹j),

which for a single row is exact for A, I, T up to a monotone function, and D (Sherman–Morrison, or the determinant's
lemma). It ranks all candidates by two matrix products in single precision. Rounds of exchange evaluate the foremost of
them exactly, ranked anew for each pose by the same products, until the foremost of all improve nothing.
"""

from collections.abc import Callable
from functools import partial
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from numpy.typing import NDArray

from lite6jax.design.criteria import Criterion, inverse

RIDGE = 1e-7
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


@final
class Pool:
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


def build_greedily(criterion: Criterion, pool: Pool, base: NDArray[np.float64], count: int) -> NDArray[np.integer]:
    """Candidates chosen one after the other, `(count,)`."""
    chosen = np.zeros(0, np.int64)
    while len(chosen) < count:
        M = base + _information_of(pool.rows[chosen])
        names, some = pool.foremost(criterion, M, chosen)
        taken = jnp.arange(count + _TOGETHER)  # those chosen stand first; the rest is out of range
        taken = jnp.where(taken < len(chosen), taken, len(names))
        new = np.asarray(_build_jitted(criterion, some, jnp.asarray(M), taken, len(chosen), _TOGETHER))
        chosen = np.concatenate([chosen, names[new]])
    return chosen[:count]


def exchange(
    criterion: Criterion, pool: Pool, base: NDArray[np.float64], chosen: NDArray[np.integer], cycles: int
) -> tuple[NDArray[np.integer], int, int]:
    """A design improved until no exchange with the then foremost candidates does, the exchanges and rounds made."""
    exchanges = made = 0
    count = len(chosen)
    while made < cycles:
        names, some = pool.foremost(criterion, base + _information_of(pool.rows[chosen]), chosen)
        at, done, visited = _exchange_jitted(criterion, some, jnp.asarray(base), jnp.arange(count), cycles - made)
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


def one_by_one(judge: Callable[[Array], Array], arrays: Array) -> Array:
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
    values = one_by_one(lambda J: judge(M + J.T @ J), rows[jnp.minimum(foremost, len(rows) - 1)])
    values = jnp.where(jnp.isfinite(values) & (gains > -jnp.inf), values, -jnp.inf)
    best = jnp.argmax(values)
    return foremost[best], values[best]


@partial(jax.jit, static_argnames="count")
def _build_jitted(
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
def _exchange_jitted(
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
