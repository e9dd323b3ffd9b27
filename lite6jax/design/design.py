"""Which poses to record: those, out of many candidates, whose information is best by a criterion."""

from dataclasses import dataclass
from functools import partial
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from numpy.typing import ArrayLike, NDArray

from lite6jax.design.criteria import (
    DESIGN_DETERMINES,
    Coordinates,
    Criterion,
    checked_rows,
    coordinates_of,
    determined_value,
)
from lite6jax.design.exchange import RIDGE, Pool, build_greedily, exchange, one_by_one
from lite6jax.errors import InputError


@final
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
    pool = Pool(reduced)
    ridged = base + RIDGE * np.eye(rank)

    rng = np.random.default_rng(seed)
    ends: list[Design] = []
    for attempt in range(starts):
        if attempt:
            chosen = rng.choice(total, count, replace=False)
        elif begin is not None:
            chosen = begin
        else:
            chosen = build_greedily(criterion, pool, ridged, count)
        improved, exchanges, made = exchange(criterion, pool, ridged, chosen, cycles)
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
        values = one_by_one(criterion.smooth, M + products)
        values = jnp.where(jnp.isfinite(values), values, -jnp.finfo(float).max).at[order].set(-jnp.inf)
        new = jnp.argmax(values)
        return order.at[i].set(new), M + products[new]

    count = len(rows)
    ridged = base + RIDGE * jnp.eye(len(base))
    order, _ = lax.fori_loop(0, count, body, (jnp.full(count, count), ridged))
    return order, one_by_one(partial(determined_value, criterion), base + jnp.cumsum(products[order], 0))


@jax.jit
def _values_of(criterion: Criterion, rows: Array, base: Array, designs: Array) -> Array:
    def of(indices: Array) -> Array:
        flat = rows[indices].reshape(-1, rows.shape[2])
        return determined_value(criterion, base + flat.T @ flat)

    return one_by_one(of, designs)
