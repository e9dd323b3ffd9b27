"""The ± of a finding: the larger of the fit's and of that from blocks of the recording."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.recorded import NOISE, Made, fitted_to, moving_motion, truth
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from lite6jax.diagnosis.block_intervals import block_stds, interval_blocks
from lite6jax.diagnosis.result import Finding
from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.terms import Terms
from lite6jax.search.search import Selection
from lite6jax.search.state import SelectedTerm, State

HARMONIC = "joint_harmonic:joint=1,order=2.3,amplitude_rad=4e-4,phase_rad=0.5"
COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"
TEXTS = (COMPLIANCE, HARMONIC)
TERMS = Terms(tuple(truth(text)[0] for text in TEXTS))
VALUES = np.array([9e-5, 4e-4 * np.cos(0.5), 4e-4 * np.sin(0.5)])
MEMORY = 2
"""Samples that the noise remembers, of which some hundred are a swing of the joints."""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), TEXTS)


@pytest.fixture(scope="module")
def moving():
    return moving_motion(1, 600)


def selected(recording, terms=TERMS, chosen_std=0.0):
    """The selection of a search that adds just these terms, in white noise."""
    problem = pose_problem(recording)
    fitted = fitted_to(problem, terms)
    stds = [chosen_std if term.chosen is not None else 0.0 for term in terms.terms]
    tested = tuple(SelectedTerm(term, chosen_std=std) for term, std in zip(terms.terms, stds, strict=True))
    return Selection(problem, problem, State(fitted_to(problem), fitted, tested))


def autocorrelated(poses, seed):
    """The poses with noise of the declared size that the sensor has for some samples."""
    remains = np.exp(-1 / MEMORY)
    shocks = np.random.default_rng(700 + seed).standard_normal((6, len(poses) + 100))
    noise = lfilter([np.sqrt(1 - remains**2)], [1.0, -remains], shocks)[:, 100:]
    noisy = poses.copy()
    noisy[:, :3, 3] += NOISE[0] * noise[:3].T
    noisy[:, :3, :3] = Rotation.from_rotvec(NOISE[1] * noise[3:].T).as_matrix() @ poses[:, :3, :3]
    return noisy


@pytest.mark.parametrize("is_white", [True, False])
def test_the_larger_covers_the_truth_in_noise_that_the_fit_takes_for_white(arm, moving, is_white):
    poses = arm.poses(moving)
    by_fit = []
    by_larger = []
    ratios = []
    for seed in range(40):
        if is_white:
            recording = arm.recording(moving, poses=poses, seed=seed)
        else:
            recording = arm.recording(moving, noise=None, poses=autocorrelated(poses, seed))
        selection = selected(recording)
        fit_std = np.sqrt(np.diagonal(selection.state.fit.covariance))
        stds = np.concatenate(block_stds(selection))
        off = np.abs(selection.state.fit.values - VALUES)
        by_fit.append(off < 1.96 * fit_std)
        by_larger.append(off < 1.96 * np.maximum(fit_std, stds))
        ratios.append(stds / fit_std)
    assert 0.88 < np.mean(by_larger) < 0.99
    if is_white:
        assert np.mean(ratios) == pytest.approx(1.0, abs=0.06)
    else:
        assert np.mean(by_fit) < 0.8
        assert np.mean(ratios) > 1.5


def test_a_finding_says_the_larger_and_that_of_the_fit_beside_it(arm, moving):
    selection = selected(arm.recording(moving, noise=None, poses=autocorrelated(arm.poses(moving), 3)))
    fitted = selection.state.fit
    by_blocks = block_stds(selection)
    findings = [
        Finding(term, fitted.values[at], fitted.covariance[at, at], 1e-9, 50.0, (), block_std=stds)
        for term, at, stds in zip(TERMS.terms, fitted.terms.slices, by_blocks, strict=True)
    ]
    compliance = findings[0]
    std = compliance.parameters["compliance_rad_per_Nm"].std
    assert std == pytest.approx(max(by_blocks[0][0], np.sqrt(compliance.covariance[0, 0])))
    for finding in findings:
        alone = replace(finding, block_std=np.zeros(0))
        assert alone.fit_std == {}
        for name, estimate in finding.parameters.items():
            assert estimate.value == alone.parameters[name].value
            assert finding.fit_std.get(name, estimate.std) == alone.parameters[name].std
            assert estimate.std >= alone.parameters[name].std
    assert any(finding.fit_std for finding in findings)


def test_an_order_with_a_standard_deviation_has_one_from_blocks(arm, moving):
    recording = arm.recording(moving, seed=2)
    without, whole = block_stds(selected(recording))
    assert (len(without), len(whole)) == (1, 2)
    _, harmonic = block_stds(selected(recording, chosen_std=1e-3))
    assert len(harmonic) == 3
    assert 0 < harmonic[2] < 0.1


def test_functions_without_a_name_and_short_recordings_have_none(arm, moving, monkeypatch):
    unnamed = Unnamed("joint3", "position of joint 3", -1.0, 1.0, "smooth", spread=1e-4)
    both = selected(arm.recording(moving), Terms((TERMS.terms[0], unnamed)))
    named, nothing = block_stds(both)
    assert named.size == 1
    assert nothing.size == 0
    monkeypatch.setattr("lite6jax.diagnosis.block_intervals._MOST", 4)
    assert [stds.size for stds in block_stds(both)] == [0, 0]


def test_blocks_are_longer_than_the_noise_remembers():
    training = np.ones(400, bool)
    training[::7] = False
    blocks = interval_blocks(training, 1.0)
    assert len(blocks) == 20
    assert np.array_equal(np.sum(blocks, 0), training)
    blocks = interval_blocks(training, 19.0)
    assert len(blocks) == 6
    assert min(block.sum() for block in blocks) >= 57
