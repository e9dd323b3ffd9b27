"""Plans beat chance, keep what they promise, and count what is there already; their order is a short route."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from lite6jax.arms.description import load_bundled
from lite6jax.calibration.start import sample_within_limits
from lite6jax.design.identify import WORKSPACE
from lite6jax.design.information import plan_experiment
from lite6jax.design.poses import plan_discrimination, plan_poses, shortest_round
from lite6jax.design.sensor import BARE
from lite6jax.effects.kinematic import JointCompliance, JointHarmonic, JointOffset
from lite6jax.errors import InputError
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
    J = SETUP.with_sensor(BARE).rows(sample_within_limits(LITE6, WORKSPACE, 1))[:, :3] / SETUP.unit
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


def test_a_short_round():
    """Against every order of few poses, and against chance for many."""

    def length(order, q):
        points = np.vstack([np.zeros(q.shape[1]), q[list(order)]])
        return np.abs(np.diff(points, axis=0)).max(1).sum()

    rng = np.random.default_rng(5)
    few, many = rng.uniform(-1, 1, (7, 3)), rng.uniform(-3, 3, (60, 6))
    assert sorted(shortest_round(few)) == list(range(7))
    assert length(shortest_round(few), few) <= 1.15 * min(length(order, few) for order in permutations(range(7)))
    assert length(shortest_round(many), many) < 0.6 * length(range(60), many)
