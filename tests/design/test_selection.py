"""Optimal design against exhaustive search and plain NumPy; laws of exchange; every refusal."""

from itertools import combinations

import numpy as np
import pytest

from lite6jax.design.poses import Criterion, Pool, accuracy_criterion, choose, exchange
from lite6jax.errors import InputError


def random_rows(seed, candidates=12, rows=1, parameters=4):
    rng = np.random.default_rng(seed)
    sizes = rng.uniform(0.3, 3, (candidates, 1, 1)) * np.geomspace(1, 3, parameters)
    return rng.standard_normal((candidates, rows, parameters)) * sizes


def information(rows):
    return np.einsum("nri,nrj->ij", rows, rows)


ERRORS = random_rows(99, candidates=7, rows=2)
ORACLES = {
    "D": lambda M: np.linalg.slogdet(M)[1],
    "A": lambda M: -np.trace(np.linalg.inv(M)),
    "I": lambda M: -np.mean([np.trace(J @ np.linalg.inv(M) @ J.T) for J in ERRORS]),
}


def apply(name, pool):
    """A criterion in the coordinates of a pool."""
    if name == "A":
        return pool.average()
    return pool.apply(Criterion() if name == "D" else accuracy_criterion(ERRORS))


NAMES = tuple(ORACLES)


@pytest.mark.parametrize("name", NAMES)
def test_gains_are_what_poses_add(name):
    rows = random_rows(11, candidates=40, rows=2)
    pool = Pool(rows)
    criterion, before = apply(name, pool), pool.accumulate(pool.rows[:5])[-1]
    each = [criterion.value(before + J.T @ J) - criterion.value(before) for J in pool.rows]
    np.testing.assert_allclose(criterion.gains(pool.rows, before), each, rtol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_exchange_finds_what_exhaustive_search_finds(name):
    for seed in range(6):
        rows = random_rows(seed, rows=2)
        best = max(ORACLES[name](information(rows[list(subset)])) for subset in combinations(range(12), 5))
        pool = Pool(rows)
        criterion = apply(name, pool)
        found = choose(pool, 5, criterion)
        assert found.values[-1] <= best + 1e-9 * abs(best)
        value = found.values[-1]
        assert (np.exp((value - best) / 4) if name == "D" else best / value) >= 0.99


@pytest.mark.parametrize("name", NAMES)
def test_values_are_those_of_the_first_poses_and_no_exchange_improves_them(name):
    rows = random_rows(7, rows=2)
    pool = Pool(rows)
    found = choose(pool, 5, apply(name, pool))
    assert len(set(found.indices.tolist())) == 5
    assert found.values[0] == -np.inf
    for n in range(2, 6):
        expected = ORACLES[name](information(rows[found.indices[:n]]))
        assert found.values[n - 1] == pytest.approx(expected, rel=1e-8)
    assert found.rank == 4
    _, exchanges, cycles = exchange(pool, apply(name, pool), found.indices)
    assert (exchanges, cycles) == (0, 1)


@pytest.mark.parametrize("name", ["D", "A"])
def test_directions_that_nothing_determines_drop_out(name):
    """Two columns that only ever act together, and one that never acts."""
    independent = random_rows(4, candidates=40, rows=2, parameters=3)
    rows = np.concatenate([independent, independent[:, :, :1], np.zeros((40, 2, 1))], axis=2)
    pool = Pool(rows)
    found = choose(pool, 6, apply(name, pool))
    assert found.rank == 3
    M = information(rows[found.indices])
    eigenvalues = np.linalg.eigvalsh(M)[2:]
    expected = {"D": np.log(eigenvalues).sum(), "A": -np.sum(1 / eigenvalues)}[name]
    assert found.values[-1] == pytest.approx(expected, rel=1e-8)


def test_poses_already_recorded_count_through_the_prior():
    rows = random_rows(8, candidates=15, rows=1)
    recorded = information(rows[[0, 1, 2, 3]])
    best = max(ORACLES["D"](recorded + information(rows[list(more)])) for more in combinations(range(15), 2))
    pool = Pool(rows, recorded)
    found = choose(pool, 2, apply("D", pool))
    assert found.values[-1] == pytest.approx(best, rel=1e-6)
    assert np.isfinite(found.values).all()


def test_of_many_candidates_the_same_call_chooses_the_same_better_than_chance():
    rows = random_rows(9, candidates=7000, rows=1, parameters=5)
    pool, rng = Pool(rows), np.random.default_rng(4)
    found, again = (choose(pool, 10, apply("A", pool)) for _ in range(2))
    np.testing.assert_array_equal(found.indices, again.indices)
    drawn = [ORACLES["A"](information(rows[rng.choice(7000, 10, replace=False)])) for _ in range(50)]
    assert found.values[-1] > max(drawn)


GOOD = random_rows(0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Pool(np.where(np.arange(12)[:, None, None] == 7, np.nan, GOOD)), "candidate 7"),
        (lambda: Pool(0 * GOOD), "rows: all zero"),
        (lambda: choose(Pool(GOOD), 0, Criterion()), "0 poses"),
        (lambda: choose(Pool(GOOD), 3, Criterion()), "choose at least 4, or give a prior"),
        (lambda: Pool(GOOD * [1, 1, 1, 0]).apply(accuracy_criterion(ERRORS)), "workspace's error has directions that"),
    ],
)
def test_refusals_are_one_line_with_the_remedy(call, words):
    with pytest.raises(InputError) as caught:
        call()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
