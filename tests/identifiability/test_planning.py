"""Plans beat chance, keep what they promise, and count what is there already."""

import numpy as np
import pytest

from lite6jax.arms.bundled import load_bundled
from lite6jax.errors import InputError
from lite6jax.fitting.start import sample_within_limits
from lite6jax.identifiability.identify import WORKSPACE
from lite6jax.identifiability.information import plan_experiment
from lite6jax.identifiability.planning import plan_poses
from lite6jax.identifiability.sensor import BARE
from tests.oracles.arms import random_positions

LITE6 = load_bundled("lite6")
SETUP = plan_experiment("lite6", "tracker_6d", frame=False)
LOWER, UPPER = LITE6.joint_limits.T
CANDIDATES = np.random.default_rng(0).uniform(LOWER, UPPER, (400, 6))


@pytest.fixture(scope="module")
def found():
    return plan_poses(SETUP, CANDIDATES, 12, refined=False)


def workspace_accuracy(q):
    """By the definition: root mean square over the workspace of the standard deviation of a predicted position."""
    rows = SETUP.rows(q).reshape(-1, 28) / SETUP.unit
    covariance = np.linalg.inv(rows.T @ rows)
    J = SETUP.with_sensor(BARE).rows(sample_within_limits(LITE6, WORKSPACE, 1))[:, :3] / SETUP.unit
    return np.sqrt(np.mean(np.sum((J @ covariance) * J, (1, 2))))


def test_the_accuracy_is_that_of_the_poses(found):
    assert found.accuracy[-1] == pytest.approx(workspace_accuracy(found.joint_position), rel=1e-6)
    assert found.accuracy[7] == pytest.approx(workspace_accuracy(found.joint_position[:8]), rel=1e-6)
    assert np.isinf(found.accuracy[3])  # 4 poses have 24 numbers for 28 parameters


def test_a_plan_beats_every_random_draw(found):
    assert found.accuracy[-1] < found.random_accuracy[:, 11].min()
    assert (found.efficiency > 1).all()
    assert found.worth is not None
    assert found.random_median[found.worth - 1] <= found.accuracy[-1] < found.random_median[found.worth - 2]


def test_how_many_are_enough(found):
    wanted = 1.2 * found.accuracy[-1]
    n = found.poses_for(wanted)
    assert found.accuracy[n - 1] <= wanted < found.accuracy[n - 2]
    assert found.poses_for(0.5 * found.accuracy[-1]) is None


def test_refining_never_loses_and_stays_where_it_may():
    away = (CANDIDATES > LOWER + 0.1) & (CANDIDATES < UPPER - 0.1)
    inside = CANDIDATES[away.all(1) & (np.abs(CANDIDATES[:, 0]) < 3)]
    limits = LITE6.joint_limits + np.array([0.1, -0.1])
    plain = plan_poses(SETUP, inside, 12, refined=False)
    moved = plan_poses(SETUP, inside, 12, limits=limits, feasible=lambda q: np.abs(q[:, 0]) < 3)
    assert moved.accuracy[-1] < plain.accuracy[-1]
    assert moved.refinement.value > moved.refinement.start_value
    assert ((moved.joint_position >= limits[:, 0]) & (moved.joint_position <= limits[:, 1])).all()
    assert (np.abs(moved.joint_position[:, 0]) < 3).all()


def test_what_is_recorded_counts():
    """Recorded poses are never worse than none, and are not chosen for again."""
    recorded = random_positions(np.random.default_rng(3), 15, 6)
    more = plan_poses(SETUP, CANDIDATES, 6, recorded=recorded, refined=False)
    assert np.isfinite(more.accuracy).all()
    together = np.vstack([recorded, more.joint_position])
    assert more.accuracy[-1] == pytest.approx(workspace_accuracy(together), rel=1e-6)
    assert more.accuracy[-1] < workspace_accuracy(recorded)


@pytest.mark.parametrize("criterion", ["D", "A", "E"])
def test_other_criteria(criterion):
    found = plan_poses(SETUP, CANDIDATES, 10, criterion=criterion, refined=False)
    random = np.random.default_rng(0)
    rows = SETUP.rows(CANDIDATES)

    def value(indices):
        J = rows[indices].reshape(-1, 28)
        M = J.T @ J
        if criterion == "D":
            return np.linalg.slogdet(M)[1]
        eigenvalues = np.linalg.eigvalsh(M)
        return -np.sum(1 / eigenvalues) if criterion == "A" else eigenvalues[0]

    best = value(found.design.indices)
    assert best > max(value(random.choice(400, 10, replace=False)) for _ in range(100))


def test_too_few_poses():
    with pytest.raises(InputError, match="2 poses: too few for the 28 directions"):
        plan_poses(SETUP, CANDIDATES, 2)


@pytest.mark.long
def test_how_many_poses_reach_an_accuracy(monkeypatch):
    """By designs of more poses, not by a square root: where the first are hardly enough that would be far off."""
    monkeypatch.setattr("lite6jax.identifiability.planning.MOST_POSES", 24)
    first = plan_poses(SETUP, CANDIDATES, 6, refined=False)
    target = 0.4 * first.accuracy[-1]
    found = plan_poses(SETUP, CANDIDATES, 6, refined=False, accuracy=target)
    assert found.needed is not None
    assert found.needed > 6
    enough = plan_poses(SETUP, CANDIDATES, found.needed, refined=False)
    assert enough.accuracy[-1] <= 1.05 * target
    assert plan_poses(SETUP, CANDIDATES, 6, refined=False, accuracy=1e-9).needed is None


def test_no_accuracy_is_promised_of_what_no_pose_determines():
    setup = plan_experiment("lite6", "ball_bar", tool_at=(0.06, 0.0, 0.04))
    found = plan_poses(setup, CANDIDATES, 30, criterion="D", refined=False, accuracy=1e-3)
    assert np.isinf(found.accuracy).all()
    assert found.needed is None


def test_more_poses_than_the_curves_go_to(monkeypatch):
    monkeypatch.setattr("lite6jax.identifiability.planning.MOST_POSES", 10)
    found = plan_poses(SETUP, CANDIDATES, 12, refined=False)
    assert found.random_accuracy.shape[1] == 12


def test_poses_are_not_said_to_be_worth_others_where_something_is_recorded():
    recorded = random_positions(np.random.default_rng(3), 15, 6)
    assert plan_poses(SETUP, CANDIDATES, 6, recorded=recorded, refined=False).efficiency is None


def test_random_draws_that_do_not_determine_all_are_worth_nothing():
    same = np.vstack([np.repeat(CANDIDATES[:1], 300, 0), CANDIDATES[:20]])
    found = plan_poses(SETUP, same, 8, criterion="E", refined=False)
    assert np.isinf(found.efficiency).sum() > 25
