"""What a view of a diagnosis shows, as arrays, against an oracle of the chain."""

import numpy as np
import pytest
from diagnosed import LITE6, documented

from lite6jax.diagnosis.document import model_from_document
from lite6jax.domains.pose.predict import predict
from lite6jax.report.viewer import MEDIAN_ARROW, WITH, WITHOUT, pose_scene
from tests.oracles.chains import joint_frames, six_parameter_poses


@pytest.fixture(scope="module")
def poses(found):
    """A document, its model and its recording."""
    document = {**documented(found), "data_faults": []}
    return document, model_from_document(document), found.problem.recording


@pytest.fixture(scope="module")
def scene(poses):
    return pose_scene(*poses)


def test_the_arm_stands_as_its_joints_say(scene, poses):
    _, _, recording = poses
    expected = [np.broadcast_to(np.eye(4), (recording.samples, 4, 4))]
    expected += joint_frames(LITE6.kinematics, recording.joint_position)
    np.testing.assert_allclose(scene.frames, np.stack(expected, 1), atol=1e-12)
    # each link ends where the next joint is, the last one where the tool is
    after = np.concatenate([scene.frames[:, 1:, :3, 3], scene.frames[:, -1:, :3, 3]], 1)
    for capsule in scene.capsules:
        T = scene.frames[:, capsule.link]
        np.testing.assert_allclose(T[:, :3, :3] @ capsule.start + T[:, :3, 3], T[:, :3, 3], atol=1e-12)
        np.testing.assert_allclose(T[:, :3, :3] @ capsule.end + T[:, :3, 3], after[:, capsule.link], atol=1e-12)


def test_arrows_lead_from_predicted_to_measured_points(scene, poses):
    _, model, recording = poses
    found, rigid = scene.poses
    assert (found.caption, rigid.caption) == (WITH, WITHOUT)
    flange = six_parameter_poses(LITE6.kinematics, recording.joint_position)[:, :3, 3]  # geometry and frames are known
    np.testing.assert_allclose(rigid.error, recording.position - flange, atol=1e-9)
    np.testing.assert_allclose(found.error, recording.position - predict(model, recording)[:, :3, 3], atol=1e-12)
    ends = rigid.arrows(100.0)
    assert ends.shape == (recording.samples, 2, 3)
    np.testing.assert_allclose(ends[:, 0], flange, atol=1e-9)
    np.testing.assert_allclose(ends[:, 1] - ends[:, 0], 100 * (recording.position - flange), atol=1e-7)
    for errors in (found, rigid):
        usual = np.linalg.norm(np.diff(errors.arrows(errors.scale), axis=1)[:, 0], axis=1)
        assert np.median(usual) == pytest.approx(MEDIAN_ARROW, rel=0.06)  # a scale of two digits
    assert found.median < 0.5 * rigid.median
