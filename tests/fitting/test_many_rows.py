"""What is done block by block, or with rows that are spread evenly, is what all rows at once would give."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.bundled import load_bundled
from lite6jax.domains.pose import kinematics
from lite6jax.domains.pose.screening import rows
from lite6jax.fitting import many_samples, recording_fit, solution
from lite6jax.fitting.problem import recording_problem, whitener_of
from lite6jax.simulation import simulate


@pytest.mark.parametrize("sliding", [(), (0, 3)])
def test_a_chain_is_the_product_of_its_transforms_whatever_the_block(monkeypatch, sliding):
    rng = np.random.default_rng(3)
    links = np.stack([frames.transform_from_row(row) for row in rng.uniform(-1, 1, (6, 6))])
    q = rng.uniform(-2, 2, (3, 11, 6))
    motions = frames.joint_motions(q, sliding)
    expected = np.eye(4)
    for i in range(6):
        expected = expected @ links[i] @ motions[..., i, :, :]
    for block in (4, 4096):
        monkeypatch.setattr(frames, "BLOCK", block)
        found = frames.chain(links, q, sliding)
        assert found.shape == (3, 11, 4, 4)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


def test_rotation_vectors_are_scipys_at_every_angle():
    rng = np.random.default_rng(4)
    axis = rng.standard_normal((400, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.concatenate([np.geomspace(1e-12, 1, 200), np.linspace(1, np.pi - 1e-9, 200)])
    angle[0] = 0.0
    vector = axis * angle[:, None]
    R = Rotation.from_rotvec(vector).as_matrix()
    found = kinematics._rotation_vector(np.moveaxis(R, 0, -1))
    np.testing.assert_allclose(found.T, vector, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.T[:200], vector[:200], rtol=0, atol=1e-15)


def test_rows_are_distinct_as_numpy_says():
    rng = np.random.default_rng(5)
    q = rng.integers(-2, 3, (500, 4)) * 0.1
    q[0], q[1] = 0.0, -0.0
    assert rows._distinct(q) == len(np.unique(q, axis=0)) < 500


@pytest.fixture(scope="module")
def outlying():
    """A recording with an unknown sensor frame and outliers, for the robust loss to work on."""
    recording = simulate("lite6", samples=400, sensor="motion_capture", seed=6)
    position = recording.position.copy()
    position[::23] += 2e-3
    return replace(recording, position=position)


def test_a_fit_begun_on_spread_rows_is_that_of_all_rows(monkeypatch, outlying):
    whole = recording_fit.fit_recording(outlying, load_bundled("lite6"))
    ended = []

    def counted(*arguments):
        ended.append(many_samples.finished_on_all(*arguments))
        return ended[-1]

    monkeypatch.setattr(recording_fit, "finished_on_all", counted)
    monkeypatch.setattr(recording_fit, "MOST_SPREAD", 200)
    monkeypatch.setattr(many_samples, "_SLICE", many_samples.BLOCK)
    monkeypatch.setattr(solution, "_AT_ONCE", 150)
    spread = recording_fit.fit_recording(outlying, load_bundled("lite6"))
    assert [found is not None for found in ended] == [True]
    assert spread.result == whole.result
    deviation = np.sqrt(np.diagonal(whole.covariance))
    n = len(whole.parameters)
    shown = deviation[:n] > 0
    assert np.abs((spread.parameters - whole.parameters)[shown] / deviation[:n][shown]).max() < 3e-3
    np.testing.assert_allclose(np.sqrt(np.diagonal(spread.covariance)), deviation, rtol=3e-3)
    np.testing.assert_allclose(spread.weight, whole.weight, atol=1e-3)
    assert spread.checked.position_rms == pytest.approx(whole.checked.position_rms, rel=0.05)
    assert spread.checked.position_rms != whole.checked.position_rms
    assert np.corrcoef(spread.checked.position, whole.checked.position)[0, 1] > 0.95
    assert spread.quality.verdict == whole.quality.verdict
    np.testing.assert_allclose(spread.quality.explained, whole.quality.explained)


def test_sums_over_slices_depend_neither_on_threads_nor_on_padding(monkeypatch, outlying):
    problem = recording_problem(outlying, load_bundled("lite6"), "declared")
    whitener, block = whitener_of(problem.covariance()), many_samples.BLOCK
    many = replace(
        problem, joint_position=np.tile(problem.joint_position, (20, 1)), pose=np.tile(problem.pose, (20, 1, 1))
    )
    found = []
    for threads in (1, 3):
        monkeypatch.setattr("lite6jax.threads.available", lambda count=threads: count)
        monkeypatch.setattr(many_samples, "_SLICE", block)
        found.append(many_samples._all(many.form, True, many.start, many, whitener, 15.0, 1.1))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1], found[1][1])
    curvature, squares = many_samples._all(problem.form, True, problem.start, problem, whitener, 15.0, 1.1)
    np.testing.assert_allclose(found[0][0], 20 * curvature, rtol=1e-9, atol=1e-6 * np.abs(curvature).max())
    np.testing.assert_allclose(found[0][1], np.tile(squares, 20), rtol=1e-9)


def test_where_the_steps_do_not_lead_to_it_all_rows_are_fitted_as_few_are(monkeypatch, outlying):
    whole = recording_fit.fit_recording(outlying, load_bundled("lite6"))
    monkeypatch.setattr(recording_fit, "MOST_SPREAD", 200)
    monkeypatch.setattr(many_samples, "_MOST_STEPS", 1)
    again = recording_fit.fit_recording(outlying, load_bundled("lite6"))
    deviation = np.sqrt(np.diagonal(whole.covariance))[: len(whole.parameters)]
    assert np.abs(again.parameters - whole.parameters)[deviation > 0].max() < 1e-3 * deviation.max()
