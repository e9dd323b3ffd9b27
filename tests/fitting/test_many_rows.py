"""What is done block by block, or with rows that are spread evenly, is what all rows at once would give."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.bundled import load_bundled
from lite6jax.domains.pose import kinematics
from lite6jax.domains.pose.screening import rows
from lite6jax.fitting import recording_fit, solution
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


def test_a_fit_with_folds_of_spread_rows_is_that_of_all_rows(monkeypatch):
    recording = simulate("lite6", samples=400, sensor="motion_capture", seed=6)
    whole = recording_fit.fit_recording(recording, load_bundled("lite6"))
    monkeypatch.setattr(recording_fit, "MOST_SPREAD", 200)
    monkeypatch.setattr(solution, "_AT_ONCE", 150)
    spread = recording_fit.fit_recording(recording, load_bundled("lite6"))
    assert spread.result == whole.result
    deviation = np.sqrt(np.diagonal(whole.covariance))
    apart = (spread.parameters - whole.parameters)[deviation[: len(whole.parameters)] > 0]
    assert np.abs(apart).max() < 1e-3 * deviation[deviation > 0].max()
    np.testing.assert_allclose(spread.errors.position, whole.errors.position, rtol=0, atol=1e-7)
    assert spread.checked.position_rms == pytest.approx(whole.checked.position_rms, rel=0.05)
    assert spread.checked.position_rms != whole.checked.position_rms
    assert np.corrcoef(spread.checked.position, whole.checked.position)[0, 1] > 0.95
