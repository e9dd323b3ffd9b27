"""Optimal design against exhaustive search and plain NumPy; laws of exchange and refinement; every refusal."""

from itertools import combinations

import jax.numpy as jnp
import numpy as np
import pytest

from lite6jax.design import selection
from lite6jax.design.criteria import CRITERIA, Smallest, discrimination, evaluate_each, workspace
from lite6jax.design.selection import Pool, choose, exchange, refine
from lite6jax.errors import InputError

SPLIT = ([2], [0.7]), ([3], [1.3])
"""Columns of two models and their hypothesised values, where there are four columns."""
ONES = np.ones(4)


def random_rows(seed, candidates=12, rows=1, parameters=4):
    rng = np.random.default_rng(seed)
    sizes = rng.uniform(0.3, 3, (candidates, 1, 1)) * np.geomspace(1, 3, parameters)
    return rng.standard_normal((candidates, rows, parameters)) * sizes


def information(rows):
    return np.einsum("nri,nrj->ij", rows, rows)


def noncentrality(M, own, other, beta):
    """β̃ᵀ (M_aa − M_ac M_cc⁻¹ M_ca) β with c all columns but a."""
    c = [i for i in range(len(M)) if i not in own]
    schur = M[np.ix_(own, own)] - M[np.ix_(own, c)] @ np.linalg.solve(M[np.ix_(c, c)], M[np.ix_(c, own)])
    return beta @ schur @ beta


ERRORS = random_rows(99, candidates=7, rows=2)
ORACLES = {
    "D": lambda M: np.linalg.slogdet(M)[1],
    "A": lambda M: -np.trace(np.linalg.inv(M)),
    "E": lambda M: np.linalg.eigvalsh(M)[0],
    "I": lambda M: -np.mean([np.trace(J @ np.linalg.inv(M) @ J.T) for J in ERRORS]),
    "T": lambda M: min(noncentrality(M, [2], [3], np.array([0.7])), noncentrality(M, [3], [2], np.array([1.3]))),
    "T one way": lambda M: noncentrality(M, [2], [3], np.array([0.7])),
}
KINDS = {
    **CRITERIA,
    "I": workspace(ERRORS),
    "T": discrimination(ONES, *SPLIT),
    "T one way": discrimination(ONES, SPLIT[0], ([3], [0.0])),
}
NAMES = tuple(KINDS)


@pytest.mark.parametrize("name", NAMES)
def test_a_criterion_is_what_its_name_says(name):
    for seed in range(5):
        M = information(random_rows(seed, rows=3))
        assert KINDS[name].value(jnp.asarray(M)) == pytest.approx(ORACLES[name](M), rel=1e-10)


@pytest.mark.parametrize("name", NAMES)
def test_smooth_rises_with_value(name):
    """Along a path on which the information grows in every direction."""
    M, more = (information(random_rows(seed, rows=3)) for seed in (1, 2))
    heights = [float(KINDS[name].smooth(jnp.asarray(M + step * more))) for step in np.linspace(0, 1, 6)]
    assert np.all(np.diff(heights) > 0)


def test_the_smooth_smallest_eigenvalue_is_kiefers_mean_even_where_eigenvalues_are_tiny_or_equal():
    for eigenvalues in ([1e-9, 1.0, 2.0], [3.0, 3.0, 3.0], [1e-5, 1e-5, 4e7]):
        # sixteenth powers of 1e9 are within a float's range: the oracle may be written out
        expected = -np.log(np.sum(np.array(eigenvalues) ** -16.0)) / 16
        assert Smallest().smooth(jnp.diag(jnp.array(eigenvalues))) == pytest.approx(expected, rel=1e-12)


def test_noncentrality_is_the_squared_distance_to_what_the_rival_explains():
    rows = random_rows(3, candidates=6, rows=2)
    flat = rows.reshape(-1, 4)
    ours = KINDS["T"].noncentralities(jnp.asarray(information(rows)))
    for (own, beta), found in zip(SPLIT, ours, strict=True):
        rest = np.delete(flat, own, axis=1)
        effect = flat[:, own] @ beta
        explained = rest @ np.linalg.lstsq(rest, effect, rcond=None)[0]
        assert found == pytest.approx(np.sum((effect - explained) ** 2), rel=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_exchange_finds_what_exhaustive_search_finds(name):
    for seed in range(6):
        rows = random_rows(seed, rows=2)
        best = max(ORACLES[name](information(rows[list(subset)])) for subset in combinations(range(12), 5))
        found = choose(Pool(rows), 5, KINDS[name])
        assert found.value <= best + 1e-9 * abs(best)
        # E has ridges, by which a single exchange can be caught where poses are hardly more than needed
        assert KINDS[name].efficiency(found.value, best, found.rank) >= (0.8 if name == "E" else 0.99)


@pytest.mark.parametrize("name", NAMES)
def test_values_are_those_of_the_first_poses_and_no_exchange_improves_them(name):
    rows = random_rows(7, rows=2)
    pool = Pool(rows)
    found = choose(pool, 5, KINDS[name])
    assert len(set(found.indices.tolist())) == 5
    assert found.values[0] == -np.inf
    for n in range(2, 6):
        expected = ORACLES[name](information(rows[found.indices[:n]]))
        assert found.values[n - 1] == pytest.approx(expected, rel=1e-8)
    assert found.rank == 4
    _, exchanges, cycles = exchange(KINDS[name].within(pool.coordinates), pool, found.indices)
    assert (exchanges, cycles) == (0, 1)


@pytest.mark.parametrize("name", NAMES)
def test_an_exchange_never_ends_worse_than_it_began(name):
    rng = np.random.default_rng(5)
    for seed in range(8):
        rows = random_rows(seed, rows=2)
        pool, start = Pool(rows), rng.choice(12, 5, replace=False)
        improved, _, _ = exchange(KINDS[name].within(pool.coordinates), pool, start)
        before, after = (ORACLES[name](information(rows[which])) for which in (start, improved))
        assert after >= before - 1e-9 * abs(before)


@pytest.mark.parametrize("name", ["D", "A", "I", "T one way"])
def test_the_damped_gain_of_single_rows_ranks_as_the_exact_criterion_does(name):
    """The claim of the exchange's first lines; E and T both ways are sought by a smooth function and may differ."""
    rows = random_rows(11, candidates=40, rows=1)
    M = information(random_rows(12, rows=2))
    gains = np.asarray(selection._gains(KINDS[name], selection._blocks(rows), jnp.asarray(M)))[:40]
    exact = [ORACLES[name](M + J.T @ J) for J in rows]
    np.testing.assert_array_equal(np.argsort(gains), np.argsort(exact))


def test_choices_do_not_depend_on_the_units():
    rows, units = random_rows(1, candidates=200, rows=2, parameters=8), np.geomspace(1e-3, 1e3, 8)
    ours, theirs = (choose(Pool(r), 12, CRITERIA["D"]) for r in (rows, rows * units))
    np.testing.assert_array_equal(np.sort(ours.indices), np.sort(theirs.indices))
    assert theirs.value - ours.value == pytest.approx(2 * np.log(units).sum(), abs=1e-6)
    rows, units = random_rows(2, candidates=100, rows=2), np.array([1e-2, 1e2, 3.0, 0.2])
    ours = choose(Pool(rows), 8, discrimination(ONES, *SPLIT))
    theirs = choose(Pool(rows * units), 8, discrimination(units, *SPLIT))
    np.testing.assert_array_equal(np.sort(ours.indices), np.sort(theirs.indices))
    assert theirs.value == pytest.approx(ours.value, rel=1e-7)


@pytest.mark.parametrize("name", ["D", "A", "E"])
def test_directions_that_nothing_determines_drop_out(name):
    """Two columns that only ever act together, and one that never acts."""
    independent = random_rows(4, candidates=40, rows=2, parameters=3)
    rows = np.concatenate([independent, independent[:, :, :1], np.zeros((40, 2, 1))], axis=2)
    found = choose(Pool(rows), 6, CRITERIA[name])
    assert found.rank == 3
    M = information(rows[found.indices])
    eigenvalues = np.linalg.eigvalsh(M)[2:]
    expected = {"D": np.log(eigenvalues).sum(), "A": -np.sum(1 / eigenvalues), "E": eigenvalues[0]}[name]
    assert found.value == pytest.approx(expected, rel=1e-8)


def test_coordinates_make_the_mean_information_the_identity_and_invert_each_other():
    rows = random_rows(6, candidates=30, rows=2)
    rows = np.concatenate([rows, rows[:, :, :2]], axis=2)
    prior = np.diag([1.0, 0, 0, 0, 1.0, 0])
    coordinates = Pool(rows, prior).coordinates
    T, S = coordinates.outward, coordinates.inward
    np.testing.assert_allclose(S @ T, np.eye(5), atol=1e-12)
    np.testing.assert_allclose(T.T @ (information(rows) + prior) @ T / 30, np.eye(5), atol=1e-10)
    np.testing.assert_allclose(rows @ T @ S, rows, atol=1e-10)
    V = T @ coordinates.basis
    np.testing.assert_allclose(V.T @ V, np.eye(5), atol=1e-10)


def test_poses_already_recorded_count_through_the_prior():
    rows = random_rows(8, candidates=15, rows=1)
    recorded = information(rows[[0, 1, 2, 3]])
    best = max(ORACLES["D"](recorded + information(rows[list(more)])) for more in combinations(range(15), 2))
    found = choose(Pool(rows, recorded), 2, CRITERIA["D"])
    assert found.value == pytest.approx(best, rel=1e-6)
    assert np.isfinite(found.values).all()


def test_many_candidates_fill_several_blocks_and_the_same_call_gives_the_same():
    rows = random_rows(9, candidates=7000, rows=1, parameters=5)
    pool, rng = Pool(rows), np.random.default_rng(4)
    found, again = (choose(pool, 10, CRITERIA["A"]) for _ in range(2))
    np.testing.assert_array_equal(found.indices, again.indices)
    drawn = np.stack([information(rows[rng.choice(7000, 10, replace=False)]) for _ in range(50)])
    assert found.value > evaluate_each(CRITERIA["A"], drawn).max()
    assert found.indices.max() < 7000


def test_efficiency_counts_repetitions():
    """Poses recorded three times are worth three times as much, by every criterion."""
    M = information(random_rows(1, rows=3))
    for name in NAMES:
        once, thrice = (float(KINDS[name].value(jnp.asarray(n * M))) for n in (1, 3))
        assert KINDS[name].efficiency(thrice, once, 4) == pytest.approx(3, rel=1e-9)


def planar_rows(q):
    """Positions of a planar 2R arm by its lengths and angle offsets: `(sample, 2, 4)`, lengths 1 and 0.7."""
    a, ab = q[:, 0], q[:, 0] + q[:, 1]
    first, second = (jnp.stack([jnp.cos(angle), jnp.sin(angle)], 1) for angle in (a, ab))
    across = [jnp.stack([-v[:, 1], v[:, 0]], 1) for v in (first, second)]
    return jnp.stack([first, second, across[0] + 0.7 * across[1], 0.7 * across[1]], 2)


LIMITS = np.array([[-1.0, 1.0], [0.1, 1.2]])
PLANAR = {
    **CRITERIA,
    "I": workspace(np.asarray(planar_rows(np.random.default_rng(8).uniform(*LIMITS.T, (20, 2))))),
    "T": discrimination(ONES, ([1], [1.0]), ([3], [1.0])),
}


@pytest.mark.long
@pytest.mark.parametrize("name", PLANAR)
def test_refinement_gains_inside_the_limits_and_where_it_is_feasible(name):
    rng = np.random.default_rng(1)
    q = rng.uniform(*LIMITS.T, (6, 2))
    q[:, 0] = np.minimum(q[:, 0], 0.5)

    def feasible(q):
        return q[:, 0] <= 0.5

    moved = refine(q, planar_rows, PLANAR[name], LIMITS, feasible=feasible)
    assert moved.value > moved.start_value
    assert np.all(np.diff(moved.values) >= 0)
    assert moved.values[-1] == moved.value
    assert feasible(moved.joint_position).all()
    assert np.all((moved.joint_position >= LIMITS[:, 0]) & (moved.joint_position <= LIMITS[:, 1]))
    M = information(np.asarray(planar_rows(moved.joint_position)))
    start = information(np.asarray(planar_rows(q)))
    assert moved.value == pytest.approx(float(PLANAR[name].value(jnp.asarray(M))), rel=1e-8)
    assert moved.start_value == pytest.approx(float(PLANAR[name].value(jnp.asarray(start))), rel=1e-8)
    free = refine(q, planar_rows, PLANAR[name], LIMITS)
    grid = np.stack(np.meshgrid(*(np.linspace(*limit, 25) for limit in LIMITS)), -1).reshape(-1, 2)
    chosen = choose(Pool(np.asarray(planar_rows(grid))), 6, PLANAR[name])
    polished = refine(grid[chosen.indices], planar_rows, PLANAR[name], LIMITS)
    assert polished.value >= polished.start_value == pytest.approx(chosen.value, rel=1e-9)
    # from anywhere, the ascent nearly gets where the exchange over a fine grid does
    assert PLANAR[name].efficiency(free.value, chosen.value, 4) > 0.8


def test_refinement_uses_the_prior_and_stays_where_nothing_is_to_be_gained():
    q = np.array([[0.1, 0.5], [0.4, 0.9]])
    moved = refine(q, lambda q: 0 * q[:, :1, None] + jnp.eye(2), CRITERIA["D"], LIMITS, prior=np.eye(2))
    np.testing.assert_array_equal(moved.joint_position, q)
    assert moved.value == moved.start_value == pytest.approx(2 * np.log(3))


GOOD = random_rows(0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Pool(np.where(np.arange(12)[:, None, None] == 7, np.nan, GOOD)), "candidate 7"),
        (lambda: Pool(0 * GOOD), "rows: all zero"),
        (lambda: choose(Pool(GOOD), 13, CRITERIA["D"]), "13 poses out of 12 candidates: choose 1 to 12"),
        (lambda: choose(Pool(GOOD), 0, CRITERIA["D"]), "0 poses"),
        (lambda: choose(Pool(GOOD), 3, CRITERIA["D"]), "3 poses: too few for the 4 directions"),
        (lambda: choose(Pool(GOOD), 3, CRITERIA["D"]), "choose at least 4, or give a prior"),
        (
            lambda: choose(Pool(GOOD * [1, 1, 1, 0]), 5, workspace(ERRORS)),
            "workspace's error lies in directions that no candidate determines",
        ),
        (lambda: choose(Pool(GOOD * [1, 1, 0, 1]), 5, KINDS["T"]), "no candidate separates the rivals"),
        (lambda: choose(Pool(GOOD[:, :, [0, 1, 2, 2]]), 5, KINDS["T"]), "no candidate separates the rivals"),
        (lambda: refine(np.zeros((3, 2)), planar_rows, CRITERIA["D"], LIMITS), "pose 0: outside the limits"),
        (
            lambda: refine(np.ones((3, 2)), planar_rows, CRITERIA["D"], LIMITS, feasible=lambda q: q[:, 0] < 1),
            "pose 0: not feasible",
        ),
    ],
)
def test_refusals_are_one_line_with_the_remedy(call, words):
    with pytest.raises(InputError) as caught:
        call()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_criteria_in_coordinates_are_the_same_criteria():
    rows = random_rows(13, candidates=9, rows=3)
    pool = Pool(rows)
    M = information(rows[:5])
    reduced = pool.accumulated(pool.rows[:5])
    for name, kind in KINDS.items():
        assert evaluate_each(kind.within(pool.coordinates), reduced)[-1] == pytest.approx(ORACLES[name](M), rel=1e-9)
