"""Poses that discriminate between two rival models: better than random ones, by the distance as it is defined."""

from dataclasses import replace

import numpy as np
import pytest

from lite6jax.arms.bundled import load_bundled
from lite6jax.design.discrimination import plan_discrimination
from lite6jax.design.information import plan_experiment
from lite6jax.effects.kinematic.joints import JointCompliance, JointHarmonic
from lite6jax.errors import InputError

LOWER, UPPER = load_bundled("lite6").joint_limits.T
CANDIDATES = np.random.default_rng(0).uniform(LOWER, UPPER, (400, 6))


@pytest.mark.long
def test_the_poses_discriminate_better_than_random_ones():
    setup = plan_experiment("lite6", "tracker", frame=False, tool_at=(0.06, 0.0, 0.04))
    compliance, harmonic = JointCompliance(2), JointHarmonic(2, 1.0)
    found = plan_discrimination(setup, [(compliance, [5e-5]), (harmonic, [0.0, 0.0])], CANDIDATES, 15, refined=False)
    assert found.distance[-1] > 1.5 * np.median(found.random_distance)
    assert not found.both_ways
    # the definition: what of the one effect's readings the other and all else do not explain, at the chosen poses
    both = replace(setup, approach="zero").with_physics([compliance, harmonic])
    J = both.rows(found.joint_position).reshape(-1, both.size) / both.unit
    effect = 5e-5 * J[:, 28]
    rest = np.delete(J, 28, axis=1)
    scaled = rest * np.delete(both.unit, 28)
    left = effect - scaled @ np.linalg.lstsq(scaled, effect, rcond=1e-9)[0]
    assert found.distance[-1] == pytest.approx(np.linalg.norm(left), rel=1e-4)


def test_rivals_both_ways():
    setup = plan_experiment("lite6", "tracker", frame=False, tool_at=(0.06, 0.0, 0.04))
    rivals = [(JointCompliance(2), [5e-5]), (JointHarmonic(2, 1.0), [0.0, 1e-4])]
    found = plan_discrimination(setup, rivals, CANDIDATES, 15, refined=False)
    assert found.both_ways
    assert found.rivals == ("joint_compliance:joint2", "joint_harmonic:joint2")
    assert found.distance[-1] > np.median(found.random_distance)


def test_the_first_rival_needs_a_size():
    setup = plan_experiment("lite6", "tracker_6d", frame=False)
    rivals = [(JointCompliance(2), [0.0]), (JointHarmonic(2, 1.0), [0.0, 0.0])]
    with pytest.raises(InputError, match="joint_compliance:joint2: has no size; give a value"):
        plan_discrimination(setup, rivals, CANDIDATES, 15)
