"""Plans beat chance, keep what they promise, and count what is there already; their order is a short route."""

from dataclasses import replace
from itertools import combinations, permutations

import numpy as np
import pytest

from lite6jax.arms.description import load_bundled
from lite6jax.calibration.start import sample_within_limits
from lite6jax.design.identify import WORKSPACE
from lite6jax.design.information import plan_experiment
from lite6jax.design.poses import (
    Criterion,
    Pool,
    accuracy_criterion,
    choose,
    exchange,
    plan_discrimination,
    plan_poses,
    short_path,
)
from lite6jax.effects.kinematic import JointCompliance, JointHarmonic, JointOffset
from lite6jax.errors import InputError
from lite6jax.report.study import plan_report
from tests.oracles.arms import random_positions

LITE6 = load_bundled("lite6")
SETUP = plan_experiment("lite6", "tracker_6d", frame=False)
OFFSET = plan_experiment("lite6", "tracker", frame=False, tool_at=(0.06, 0.0, 0.04))
LOWER, UPPER = LITE6.joint_limits.T
CANDIDATES = np.random.default_rng(0).uniform(LOWER, UPPER, (400, 6))
RECORDED = random_positions(np.random.default_rng(3), 15, 6)


@pytest.fixture(scope="module")
def found():
    return plan_poses(SETUP, CANDIDATES, 12)


def workspace_accuracy(q):
    """By the definition: root mean square over the workspace of the standard deviation of a predicted position."""
    rows = SETUP.rows(q).reshape(-1, 28) / SETUP.unit
    covariance = np.linalg.inv(rows.T @ rows)
    J = SETUP.error_rows(sample_within_limits(LITE6, WORKSPACE, 1))[:, :3] / SETUP.unit
    return np.sqrt(np.mean(np.sum((J @ covariance) * J, (1, 2))))


def test_a_plan_beats_every_random_draw(found):
    assert found.accuracy[-1] < found.random_accuracy[:, 11].min()
    assert found.worth is not None
    assert found.random_median[found.worth - 1] <= found.accuracy[-1] < found.random_median[found.worth - 2]


def test_what_is_recorded_counts():
    """Recorded poses are never worse than none, are not chosen for again."""
    more = plan_poses(SETUP, CANDIDATES, 6, recorded=RECORDED)
    assert np.isfinite(more.accuracy).all()
    together = np.vstack([RECORDED, more.joint_position])
    assert more.accuracy[-1] == pytest.approx(workspace_accuracy(together), rel=1e-6)
    assert more.accuracy[-1] < workspace_accuracy(RECORDED)


@pytest.mark.parametrize("criterion", ["D", "A"])
def test_other_criteria(criterion):
    found = plan_poses(SETUP, CANDIDATES, 10, criterion=criterion)
    random = np.random.default_rng(0)
    rows = SETUP.rows(CANDIDATES)

    def value(indices):
        J = rows[indices].reshape(-1, 28)
        eigenvalues = np.linalg.eigvalsh(J.T @ J)
        return {"D": np.log(eigenvalues).sum(), "A": -np.sum(1 / eigenvalues)}[criterion]

    assert value(found.design.indices) > max(value(random.choice(400, 10, replace=False)) for _ in range(100))


@pytest.mark.long
def test_how_many_poses_reach_an_accuracy(monkeypatch):
    """By designs of more poses, not by a square root: where the first are hardly enough that would be far off."""
    monkeypatch.setattr("lite6jax.design.poses.MOST_POSES", 24)
    first = plan_poses(SETUP, CANDIDATES, 6)
    target = 0.4 * first.accuracy[-1]
    found = plan_poses(SETUP, CANDIDATES, 6, accuracy=target)
    assert found.needed is not None
    assert found.needed > 6
    enough = plan_poses(SETUP, CANDIDATES, found.needed)
    assert enough.accuracy[-1] <= 1.05 * target
    assert plan_poses(SETUP, CANDIDATES, 6, accuracy=1e-9).needed is None


@pytest.mark.parametrize(("candidates", "tried"), [(60, 60), (5000, 400), (5, 12)])
def test_how_many_poses_were_tried_in_vain(found, candidates, tried):
    """As many as there are candidates, or the most that are tried; those that were asked for in any case."""
    text = " ".join(str(part) for part in plan_report(replace(found, candidates=candidates), 1e-9))
    assert f"is not reached by {tried} poses either." in text


# ------------------------------------------------------------------ discrimination


def test_the_distance_of_an_effect_of_several_numbers_is_that_at_its_hypothesised_size():
    harmonic, compliance, size = JointHarmonic(2, 1.0), JointCompliance(2), np.array([5e-5, 1e-4])
    found = plan_discrimination(OFFSET, ((harmonic, size), compliance), CANDIDATES, 15)
    both = replace(OFFSET, approach="zero").with_physics([harmonic, compliance])
    J = both.rows(found.joint_position).reshape(-1, both.size) / both.unit
    effect, others = J[:, 28:30] @ size, np.delete(J, [28, 29], axis=1) * np.delete(both.unit, [28, 29])
    left = effect - others @ np.linalg.lstsq(others, effect, rcond=1e-9)[0]
    assert found.distance[-1] == pytest.approx(np.linalg.norm(left), rel=1e-4)


@pytest.mark.parametrize(
    ("one", "values", "says"),
    [
        (JointCompliance(2), [0.0], "joint_compliance:joint2: has no size; give a value"),
        (JointOffset(3), [1e-3], "criterion T: no candidate separates the rivals"),
    ],
)
def test_what_discrimination_refuses(one, values, says):
    with pytest.raises(InputError, match=says):
        plan_discrimination(SETUP, ((one, values), JointHarmonic(2, 1.0)), CANDIDATES, 15)


def test_a_short_path():
    """Against every order of few poses, and against chance for many."""

    def length(order, q):
        points = np.vstack([np.zeros(q.shape[1]), q[list(order)]])
        return np.abs(np.diff(points, axis=0)).max(1).sum()

    rng = np.random.default_rng(5)
    few, many = rng.uniform(-1, 1, (7, 3)), rng.uniform(-3, 3, (60, 6))
    assert sorted(short_path(few)) == list(range(7))
    assert length(short_path(few), few) <= 1.15 * min(length(order, few) for order in permutations(range(7)))
    assert length(short_path(many), many) < 0.6 * length(range(60), many)


# ------------------------------------------------------------------ selection among candidates


def random_rows(seed, candidates=12, rows=1, parameters=4):
    rng = np.random.default_rng(seed)
    sizes = rng.uniform(0.3, 3, (candidates, 1, 1)) * np.geomspace(1, 3, parameters)
    return rng.standard_normal((candidates, rows, parameters)) * sizes


def information(rows):
    return np.einsum("nri,nrj->ij", rows, rows)


def value(name, rows, chosen, recorded=0.0):
    """The criterion of some candidates by its definition."""
    return ORACLES[name](recorded + information(rows[chosen]))


ERRORS = random_rows(99, candidates=7, rows=2)
ORACLES = {
    "D": lambda M: np.linalg.slogdet(M)[1],
    "A": lambda M: -np.trace(np.linalg.inv(M)),
    "I": lambda M: -np.mean([np.trace(J @ np.linalg.inv(M) @ J.T) for J in ERRORS]),
}


def apply(name, pool):
    """A criterion in the coordinates of a pool."""
    if name == "A":
        return Criterion(pool.outward.T @ pool.outward)
    return pool.apply(Criterion() if name == "D" else accuracy_criterion(ERRORS))


NAMES = tuple(ORACLES)


@pytest.mark.parametrize("name", NAMES)
def test_gains_are_what_poses_add(name):
    rows = random_rows(11, candidates=40, rows=2)
    pool = Pool(rows)
    criterion, before = apply(name, pool), information(pool.rows[:5])
    each = [criterion.value(before + J.T @ J) - criterion.value(before) for J in pool.rows]
    np.testing.assert_allclose(criterion.gains(pool.rows, before), each, rtol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_exchange_finds_what_exhaustive_search_finds(name):
    for seed in range(6):
        rows = random_rows(seed, rows=2)
        best = max(ORACLES[name](information(rows[list(subset)])) for subset in combinations(range(12), 5))
        pool = Pool(rows)
        criterion = apply(name, pool)
        reached = value(name, rows, choose(pool, 5, criterion).indices)
        assert reached <= best + 1e-9 * abs(best)
        assert (np.exp((reached - best) / 4) if name == "D" else best / reached) >= 0.99


@pytest.mark.parametrize("name", NAMES)
def test_values_are_those_of_the_first_poses_and_no_exchange_improves_them(name):
    rows = random_rows(7, rows=2)
    pool = Pool(rows)
    found = choose(pool, 5, apply(name, pool))
    assert len(set(found.indices.tolist())) == 5
    curve = pool.curve(apply(name, pool), found.indices)
    assert curve[0] == -np.inf
    expected = [value(name, rows, found.indices[:n]) for n in range(2, 6)]
    constant = curve[-1] - expected[-1] if name == "D" else 0.0  # of the coordinates
    np.testing.assert_allclose(curve[1:] - constant, expected, rtol=1e-8)
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
    chosen = [found.indices, found.indices[:4]]
    eigenvalues = [np.linalg.eigvalsh(information(rows[some]))[2:] for some in chosen]
    expected = [{"D": np.log(sizes).sum(), "A": -np.sum(1 / sizes)}[name] for sizes in eigenvalues]
    reached = pool.curve(apply(name, pool), found.indices)[[5, 3]]
    assert reached[0] - reached[1] == pytest.approx(expected[0] - expected[1], rel=1e-8)


def test_poses_already_recorded_count_through_the_prior():
    rows = random_rows(8, candidates=15, rows=1)
    recorded = information(rows[[0, 1, 2, 3]])
    best = max(ORACLES["D"](recorded + information(rows[list(more)])) for more in combinations(range(15), 2))
    pool = Pool(rows, recorded)
    found = choose(pool, 2, apply("D", pool))
    assert value("D", rows, found.indices, recorded) == pytest.approx(best, rel=1e-6)
    assert np.isfinite(pool.curve(Criterion(), found.indices)).all()


def test_of_many_candidates_the_same_call_chooses_the_same_better_than_chance():
    rows = random_rows(9, candidates=7000, rows=1, parameters=5)
    pool, rng = Pool(rows), np.random.default_rng(4)
    found, again = (choose(pool, 10, apply("A", pool)) for _ in range(2))
    np.testing.assert_array_equal(found.indices, again.indices)
    drawn = [ORACLES["A"](information(rows[rng.choice(7000, 10, replace=False)])) for _ in range(50)]
    assert value("A", rows, found.indices) > max(drawn)


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
