"""Where what a fit leaves acts: at the one site that moves as if of its own accord, and nowhere in noise."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.recorded import OPTIONS, Made, fitted_to, static_motion

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.estimation.concentration import concentration
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms

SAMPLES = 120
NOISE = 2e-5
"""m per axis, as declared."""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("concentration"), seed=4, orientation=False)


def restless(arm, angles, seed=8, samples=SAMPLES):
    """What the joints of an arm leave that stand angles `(sample, joint)` rad beside what the encoders say."""
    still = static_motion(seed, samples)
    truly = {**still, "joint_position": still["joint_position"] + angles}
    recording = replace(arm.recording(truly), joint_position=still["joint_position"])
    case = pose_problem(recording)
    return case, fitted_to(case, Terms())


@pytest.mark.parametrize("joint", [1, 2, 3, 4, 5])
def test_it_is_the_joint_that_is_restless(arm, joint):
    angles = np.random.default_rng(joint).normal(size=(SAMPLES, 6)) * 3e-3 * (np.arange(6) == joint - 1)
    found = concentration(*restless(arm, angles), OPTIONS)
    assert found is not None
    assert found.site == f"joint{joint}"
    assert found.expected < 0.5 < 0.95 < found.share <= 1.0
    assert found.gain > 0


def test_what_is_left_across_a_joint_is_that_of_least_squares(arm):
    angles = np.random.default_rng(0).normal(size=(40, 6)) * 1e-3 * (np.arange(6) == 1)
    case, fit = restless(arm, angles, samples=40)
    test = score_test(case, fit, OPTIONS)
    column = next(family.column for family in case.periodic if family.site == "joint2")
    own = np.zeros((len(test.residual), 40))
    for k in range(40):
        own[k : 3 * 40 : 40, k] = column[:, k]
    own /= np.linalg.norm(own, axis=0)
    model = np.concatenate([test.basis.T, own], 1)
    left = test.residual - model @ np.linalg.lstsq(model, test.residual, rcond=None)[0]
    found = concentration(case, fit, OPTIONS)
    assert 1 - found.share == pytest.approx(left @ left / (test.residual @ test.residual), rel=1e-6)


def test_noise_acts_nowhere(arm):
    """In so few poses noise often has four times the mean square along one direction: the test has to allow for it."""
    found = [concentration(*restless(arm, np.zeros((6, 6)), seed, 6), OPTIONS) for seed in range(40)]
    assert sum(one is not None for one in found) <= 1


@pytest.mark.parametrize("size", [1e-4, 1e-3])
def test_noise_of_all_encoders_alike_acts_nowhere(arm, size):
    angles = np.random.default_rng(3).normal(size=(SAMPLES, 6)) * size
    assert concentration(*restless(arm, angles), OPTIONS) is None


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_noise_of_one_axis_of_the_sensor_acts_nowhere(arm, axis):
    """A camera knows depth less well than the rest. In a small range one joint moves the tool much that way."""
    still = static_motion(8, SAMPLES)
    middle = still["joint_position"].mean(0)
    recording = arm.recording({**still, "joint_position": middle + 0.1 * (still["joint_position"] - middle)})
    noisy = np.random.default_rng(axis).normal(size=SAMPLES)[:, None] * 8 * NOISE * (np.arange(3) == axis)
    case = pose_problem(replace(recording, position=recording.position + noisy))
    assert concentration(case, fitted_to(case, Terms()), OPTIONS) is None


def test_poses_that_the_frames_alone_fit_say_nothing(tmp_path_factory):
    """Four poses have twelve numbers: an angle of each and nine numbers of sensor and tool leave none to judge by."""
    unplaced = Made(tmp_path_factory.mktemp("unplaced"), seed=4, frame=True, tool=True, orientation=False)
    angles = np.random.default_rng(5).normal(size=(4, 6)) * 1e-3 * (np.arange(6) == 1)
    assert concentration(*restless(unplaced, angles, samples=4), OPTIONS) is None
