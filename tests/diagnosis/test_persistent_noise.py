"""Read-outs that wander: noise of a joint, and processes that resemble it."""

import numpy as np
import pytest
from diagnosis.recorded import OPTIONS, Made, moving_motion

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.terms import Terms
from lite6jax.search.select import Selector
from lite6jax.search.state import SelectedTerm, State, refitted

SAMPLES, COEFFICIENT, SIZE = 240, 0.97, 2e-4


@pytest.mark.parametrize("seed", [1, 3, 4])
def test_two_processes_that_describe_a_wandering_read_out_together_do_not_stand(tmp_path, seed):
    """Each explains more than noise would beside the other: the spectrum of a gear, and a process of loads."""
    motion, steps = moving_motion(seed, SAMPLES), SIZE * np.random.default_rng(seed).standard_normal(SAMPLES)
    moved = motion["joint_position"].copy()
    for k in range(1, SAMPLES):
        steps[k] = COEFFICIENT * steps[k - 1] + np.sqrt(1 - COEFFICIENT**2) * steps[k]
    moved[:, 1] += steps
    made = Made(tmp_path, seed=1, orientation=False)
    problem = pose_problem(made.recording(motion, poses=made.poses({**motion, "joint_position": moved})))
    selector, bare = Selector(problem, OPTIONS), fit(problem, Terms(), OPTIONS)
    component = next(one for one in problem.components if one.site == "joint2")
    quantities = {one.driver.phrase: one for one in problem.quantities}
    loads = [quantities["gravity torque of joint 3"], quantities["velocity of joint 6"]]
    terms = (
        problem.process(component, loads, "rough*rough", 1e-4),
        problem.process(component, [quantities["position of joint 2"]], "spectrum", 1e-4, (8.0, 2.0)),
    )
    state = refitted(problem, State(bare, bare), [SelectedTerm(term, cost=12.0) for term in terms], OPTIONS)
    state = selector.weighed(state)
    assert min(one.net for one in state.tested) > OPTIONS.margin
    assert selector.above_noise(state).tested == ()
