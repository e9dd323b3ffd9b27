"""Which candidates to take: those whose information is best by a criterion, and where they move from there.

A design is built greedily and then improved by exchange: each pose in turn is taken out and the best candidate put
in, until none improves (V. Fedorov, 1972, in the cyclic order of R. Cook and C. Nachtsheim, Technometrics 22, 1980).
One rule serves every criterion Φ(M). Its gradient G = ∂Φ/∂M gives each candidate's gain, damped by its leverage,

    Σ over rows j:  jᵀGj / (1 + jᵀM⁻¹j),

which for a single row is exact for A, I, T up to a monotone function, and D (Sherman–Morrison, or the determinant's
lemma). It ranks all candidates by two matrix products in single precision. Rounds of exchange evaluate the foremost of
them exactly, ranked anew for each pose by the same products, until the foremost of all improve nothing.
"""

from collections.abc import Callable
from functools import cached_property, partial
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from numpy.typing import ArrayLike, NDArray

from lite6jax.design.criteria import (
    DESIGN_DETERMINES,
    Criterion,
    coordinates_of,
    evaluate,
    evaluate_each,
    inverse,
    one_by_one,
)
from lite6jax.errors import InputError

Floats = NDArray[np.floating]
Indices = NDArray[np.integer]

_RIDGE = 1e-7
"""Of a candidate's mean information: keeps M invertible while poses are few; what is reported is without it."""
_CYCLES = 60
"""The most times that the exchange goes through all poses."""
_EXACT = 24
"""How many of the foremost candidates are evaluated exactly."""
_FOREMOST = 8192
"""How many of the candidates an exchange looks at until the foremost are chosen anew; in the end none improves."""
_TOGETHER = 5
"""Poses built between two such choices."""
_COLUMNS = 6000
"""Columns of a block of the matrix products: what keeps a block within a core's cache."""
_IMPROVES = 1e-9
_ITERATIONS = 60
"""Of a refinement: how often all rows are evaluated with their gradient."""
_FIRST_STEP, _LONGEST_STEP, _LAST_STEP = 0.02, 0.3, 1e-6  # rad


@final
class Pool:
    """The candidates of a design, in coordinates of the directions that they and a prior determine.

    Attributes:
        coordinates: of these directions.
        rows: `(candidate, row, k)` whitened.
        base: `(k, k)` information of the prior.
    """

    def __init__(self, rows: ArrayLike, prior: ArrayLike | None = None) -> None:
        """Takes the candidates.

        Args:
            rows: `(candidate, row, parameter)`, whitened, columns scaled to be comparable (m and rad are not): A and E
                depend on the scale. Directions that no candidate determines are left out of the criterion.
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
        self.coordinates = coordinates_of(P + flat.T @ flat, len(J))
        self.base = self.coordinates.outward.T @ P @ self.coordinates.outward
        self.rows = self.inside(J)
        self.size = min(_FOREMOST, len(J))

    def inside(self, rows: Floats) -> Floats:
        """Rows `(pose, row, parameter)` in coordinates, `(pose, row, k)`."""
        return (rows.reshape(-1, rows.shape[2]) @ self.coordinates.outward).reshape(*rows.shape[:2], -1)

    def accumulated(self, rows: Floats) -> Floats:
        """The information of the prior and of the first 1, 2, … of rows `(pose, row, k)`, `(pose, k, k)`."""
        return self.base + np.cumsum(np.einsum("nri,nrj->nij", rows, rows), 0)

    @cached_property
    def blocks(self) -> Array:
        """`_blocks` of all candidates."""
        return _blocks(self.rows)

    @property
    def ridged(self) -> Floats:
        """`base` with what keeps it invertible."""
        return self.base + _RIDGE * np.eye(len(self.base))

    def foremost(self, criterion: Criterion, chosen: Indices) -> tuple[Indices, tuple[Array, Array], Floats]:
        """`chosen` and the others with the largest gain beside them, `(size,)`; their rows, and `_blocks` of these; and
        the information of the chosen."""
        flat = self.rows[chosen].reshape(-1, self.rows.shape[2])
        M = self.ridged + flat.T @ flat
        gains = np.array(_gains_of(criterion, self.blocks, jnp.asarray(M)))[: len(self.rows)]
        gains[chosen] = np.inf
        names = np.argpartition(-gains, self.size - 1)[: self.size]
        names = np.concatenate([chosen, np.setdiff1d(names, chosen)])
        return names, (jnp.asarray(self.rows[names]), _blocks(self.rows[names])), M


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
    values: Floats
    rank: int
    exchanges: int
    cycles: int

    @property
    def value(self) -> float:
        """The criterion of them all."""
        return float(self.values[-1])


def choose(pool: Pool, count: int, criterion: Criterion, start: Indices | None = None) -> Design:
    """The `count` candidates whose information is best by `criterion`.

    Args:
        pool: the candidates.
        count: how many.
        criterion: which design is better.
        start: `(count,)` of them, from which exchanges begin; built one by one where not given.

    Raises:
        InputError: more poses than candidates, too few for the parameters, or what the criterion refuses.
    """
    total, height, rank = pool.rows.shape
    if not 1 <= count <= total:
        raise InputError(f"{count} poses out of {total} candidates: choose 1 to {total}, or give more candidates")
    eigenvalues = np.linalg.eigvalsh(pool.base)
    known = int(np.sum(eigenvalues > DESIGN_DETERMINES * max(eigenvalues[-1], 0.0)))
    needed = -(-(rank - known) // height)
    if count < needed:
        raise InputError(
            f"{count} poses: too few for the {rank} directions that the candidates determine; choose at least"
            f" {needed}, or give a prior"
        )
    criterion = criterion.within(pool.coordinates)
    built = _build(criterion, pool, count) if start is None else start
    improved, exchanges, cycles = exchange(criterion, pool, built)
    ends = []
    for chosen in (built, improved):
        order, values = _order(criterion, pool.rows[chosen], pool.base)
        ends.append((chosen[np.asarray(order)], np.asarray(values)))
    indices, values = max(ends, key=lambda end: end[1][-1])
    return Design(indices, values, rank, exchanges, cycles)


def _build(criterion: Criterion, pool: Pool, count: int) -> Indices:
    """Candidates chosen one after the other, `(count,)`."""
    chosen = np.zeros(0, np.int64)
    while len(chosen) < count:
        names, some, M = pool.foremost(criterion, chosen)
        taken = jnp.arange(count + _TOGETHER)  # those chosen stand first; the rest is out of range
        taken = jnp.where(taken < len(chosen), taken, len(names))
        new = np.asarray(_build_jitted(criterion, some, jnp.asarray(M), taken, len(chosen), _TOGETHER))
        chosen = np.concatenate([chosen, names[new]])
    return chosen[:count]


def exchange(criterion: Criterion, pool: Pool, chosen: Indices) -> tuple[Indices, int, int]:
    """A design improved until no exchange with the then foremost candidates does, the exchanges and rounds made.

    Args:
        criterion: in the pool's coordinates.
        pool: the candidates.
        chosen: `(pose,)` of them.
    """
    exchanges = made = 0
    count = len(chosen)
    while made < _CYCLES:
        names, some, _ = pool.foremost(criterion, chosen)
        base = jnp.asarray(pool.ridged)
        at, done, visited = _exchange_jitted(criterion, some, base, jnp.arange(count), _CYCLES - made)
        chosen = names[np.asarray(at)]
        exchanges += int(done)
        made += -(-int(visited) // count)
        if not done or pool.size == len(pool.rows):
            break
    return chosen, exchanges, made


def _blocks(rows: Floats) -> Array:
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


@jax.jit
def _order(criterion: Criterion, rows: Array, base: Array) -> tuple[Array, Array]:
    """Rows `(pose, row, k)` best first, and the criterion of each beginning of them."""
    products = jnp.einsum("nri,nrj->nij", rows, rows)

    def body(i: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        order, M = state
        values = one_by_one(criterion.smooth, M + products)
        values = jnp.where(jnp.isfinite(values), values, -jnp.finfo(float).max).at[order].set(-jnp.inf)
        new = jnp.argmax(values)
        return order.at[i].set(new), M + products[new]

    count = len(rows)
    ridged = base + _RIDGE * jnp.eye(len(base))
    order, _ = lax.fori_loop(0, count, body, (jnp.full(count, count), ridged))
    return order, evaluate_each(criterion, base + jnp.cumsum(products[order], 0))


class Refinement(NamedTuple):
    """Poses moved to where the criterion is better.

    Attributes:
        joint_position: `(pose, joint)` rad, in the order given.
        value: the criterion.
        start_value: of the poses given.
        values: `(iteration,)`, the best so far.
    """

    joint_position: Floats
    value: float
    start_value: float
    values: Floats


def refine(
    joint_position: ArrayLike,
    rows_of: Callable[[Array], Array],
    criterion: Criterion,
    limits: ArrayLike,
    prior: ArrayLike | None = None,
    feasible: Callable[[Floats], NDArray[np.bool_]] | None = None,
) -> Refinement:
    """Moves poses uphill in the criterion, inside the limits, and never to worse.

    Resilient propagation (M. Riedmiller, H. Braun, 1993): each joint of each pose has a step of its own, which grows
    while its gradient keeps its sign and shrinks where it turns, so that no scale has to be known. A pose that would
    leave the limits stops at them; one that would become infeasible stays, with smaller steps from then on. Steps that
    together do not improve are halved.

    Args:
        joint_position: `(pose, joint)` rad, inside the limits and feasible; they must determine what is to be judged.
        rows_of: traceable, `(sample, joint)` rad to `(sample, row, parameter)` as `Pool` takes them.
        criterion: by what they are judged.
        limits: `(joint, 2)` rad.
        prior: as for `Pool`.
        feasible: `(sample, joint)` to `(sample,)` bool.

    Raises:
        InputError: a pose outside the limits or infeasible, or what `Pool` and the criterion refuse.
    """
    q = np.array(joint_position, float)
    lower, upper = np.asarray(limits, float).T
    outside = ((q < lower) | (q > upper)).any(1)
    if outside.any():
        raise InputError(f"pose {int(np.argmax(outside))}: outside the limits; move it inside first")
    if feasible is not None and not feasible(q).all():
        raise InputError(f"pose {int(np.argmin(feasible(q)))}: not feasible; leave it out or loosen the filters")
    pool = Pool(np.asarray(jax.jit(rows_of)(jnp.asarray(q))), prior)
    outward, base = jnp.asarray(pool.coordinates.outward), jnp.asarray(pool.base)
    criterion = criterion.within(pool.coordinates)

    def judged(q: Array) -> tuple[Array, Array]:
        flat = rows_of(q).reshape(-1, outward.shape[0]) @ outward
        M = base + flat.T @ flat
        return criterion.smooth(M), evaluate(criterion, M)

    judge = jax.jit(jax.value_and_grad(judged, has_aux=True))
    (height, value), gradient = (jax.tree.map(np.asarray, part) for part in judge(q))
    best, best_value = q, float(value)
    start_value, history = best_value, []
    step, last = np.full(q.shape, _FIRST_STEP), np.zeros(q.shape)
    for _ in range(_ITERATIONS):
        agreement = np.sign(gradient) * last
        step = step * np.where(agreement > 0, 1.2, np.where(agreement < 0, 0.5, 1.0))
        step = np.clip(step, 0.0, _LONGEST_STEP)
        last = np.where(agreement < 0, 0.0, np.sign(gradient))
        trial = np.clip(q + step * last, lower, upper)
        if feasible is not None:
            barred = ~feasible(trial)
            trial[barred] = q[barred]
            step[barred] *= 0.5
        (reached, value), ahead = (jax.tree.map(np.asarray, part) for part in judge(trial))
        if reached > height:
            q, height, gradient = trial, reached, ahead
            if value > best_value:
                best, best_value = q, float(value)
        else:
            step, last = 0.5 * step, np.zeros(q.shape)
        history.append(best_value)
        if step.max() < _LAST_STEP:
            break
    return Refinement(best, best_value, start_value, np.array(history))
