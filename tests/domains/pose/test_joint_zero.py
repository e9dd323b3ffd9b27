"""A joint whose zero is off: the model of the diagnosis has it in all that is made of it."""

import copy
import json
from dataclasses import replace

import numpy as np
import pyarrow.csv
import pytest
from diagnosis.recorded import LITE6, Made, quaternions, static_motion
from domains.pose.documents import stored
from typed import flat, refusal, run

from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.document import model_from_document, read_model
from lite6jax.diagnosis.export import diagnosed_chain
from lite6jax.diagnosis.options import QUICK
from lite6jax.domains.pose.compensate import compensate
from lite6jax.domains.pose.registration import register_model
from lite6jax.domains.predict import predict, predicted
from lite6jax.recordings import Recording, write_recording
from lite6jax.report.compensations import corrected_columns
from lite6jax.report.faults import fault_name
from lite6jax.report.viewer import pose_scene
from tests.oracles.chains import six_parameter_poses

JOINT = 3
OFF = 0.02
"""rad, by which the controller counts the joint less than it stands."""
MISSING = OFF * np.eye(6)[JOINT - 1]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=1, geometry="prior", frame=True, tool=True)


def recorded(arm, motion):
    """What the controller and the sensor say of a motion."""
    recording = arm.recording(motion)
    return replace(recording, joint_position=recording.joint_position - MISSING)


@pytest.fixture(scope="module")
def diagnosis(arm, tmp_path_factory):
    found = diagnose_poses(recorded(arm, static_motion(1, 80)), options=QUICK)
    path = tmp_path_factory.mktemp("diagnosis") / "diagnosis.json"
    found.save(path)
    return path


@pytest.fixture(scope="module")
def content(diagnosis):
    return json.loads(diagnosis.read_text())


@pytest.fixture(scope="module")
def model(diagnosis):
    return read_model(diagnosis, domain="poses")


@pytest.fixture(scope="module")
def other():
    """Another motion of the arm."""
    return static_motion(2, 40)


@pytest.fixture(scope="module")
def targets(arm):
    """Joint positions as the arm has them, and its poses there."""
    motion = static_motion(4, 12)
    return motion["joint_position"], arm.poses(motion)


def written(recording, folder, name="motion.csv"):
    path = write_recording(recording, folder / name, overwrite=True)
    path.with_suffix(".yaml").unlink(missing_ok=True)
    return path


def distances(poses, wanted):
    return np.linalg.norm(poses[:, :3, 3] - wanted[:, :3, 3], axis=1)


def test_the_diagnosis_finds_it_and_its_document_has_it(content, model):
    numbers = [entry["numbers"] for entry in content["data_faults"] if entry["fault"] == "joint_turns"]
    assert [entry["joint"] for entry in numbers] == [JOINT]
    np.testing.assert_allclose(model.joint_zero, MISSING, rtol=0, atol=1e-3)
    assert model.joint_zero[JOINT - 1] == numbers[0]["added_rad"]
    assert content["model"]["joint_zero_rad"] == model.joint_zero.tolist()


def test_predictions_of_another_motion_are_within_their_bars(arm, model, other, tmp_path):
    recording = recorded(arm, other)
    truth = arm.poses(other)
    prediction = predicted(model, written(recording, tmp_path))
    inside = ~prediction.outside
    assert inside.sum() > 20
    errors = (prediction.poses[:, :3, 3] - truth[:, :3, 3]) / prediction.position_std
    assert np.sqrt(np.mean(errors[inside] ** 2)) < 1.5
    assert np.abs(errors[inside]).max() < 5
    without = predict(replace(model, joint_zero=np.zeros(6)), recording)
    assert np.median(distances(without, truth)) > 100 * np.median(distances(prediction.poses, truth))


def test_it_is_added_once_however_the_motion_is_given(arm, model, other, tmp_path):
    recording = recorded(arm, other)
    path = written(recording, tmp_path)
    poses = predict(model, recording)
    for motion in (path, model.read_motion(path), recording.joint_position):
        np.testing.assert_allclose(predict(model, motion), poses, rtol=0, atol=1e-12)
    np.testing.assert_allclose(model.predicted(model.read_motion(path)).poses, poses, rtol=0, atol=1e-12)
    np.testing.assert_allclose(model.pose(recording.joint_position), poses, rtol=0, atol=1e-12)


def test_predict_says_what_it_adds(capsys, arm, model, diagnosis, other, tmp_path):
    path = written(recorded(arm, other), tmp_path)
    degrees = np.rad2deg(model.joint_zero[JOINT - 1])
    note = (
        "the zeros of joints are off as in the diagnosed recording; joint positions are corrected by "
        f"{degrees:+.3f} deg at joint 3"
    )
    assert model.read_motion(path).notes[-1] == note
    code, said, err = run(capsys, "predict", diagnosis, path, "--out", tmp_path / "predicted.csv")
    assert (code, err) == (0, "")
    assert f"Note: {note}." in flat(said)
    table = pyarrow.csv.read_csv(tmp_path / "predicted.csv")
    shown = np.stack([table[name] for name in ("x_m", "y_m", "z_m")], 1)
    np.testing.assert_allclose(shown, predict(model, path)[:, :3, 3], rtol=0, atol=1e-9)


def test_another_set_up_is_registered(arm, model, other):
    moved = Made(arm.folder, seed=arm.seed, geometry="prior")
    again, registration = register_model(model, recorded(moved, other))
    assert registration.rms < 1e-4
    motion = static_motion(3, 30)
    assert np.median(distances(predict(again, recorded(moved, motion)), moved.poses(motion))) < 5e-5


class TestCompensate:
    def test_its_commands_reach_the_targets(self, arm, model, targets):
        joints, poses = targets
        start = joints - MISSING + 1e-3
        compensation = compensate(model, poses, start=start)
        assert compensation.reached.all()
        assert np.abs(compensation.correction).max() < 5e-3  # starts are as the controller counts
        motion = {**static_motion(4, 12), "joint_position": compensation.joint_position + MISSING}
        errors = (arm.poses(motion) - poses)[:, :3, 3] / compensation.position_std
        assert np.sqrt(np.mean(errors**2)) < 1.5
        np.testing.assert_allclose(predict(model, compensation.recording), poses, rtol=0, atol=1e-5)

    def test_without_starts(self, arm, model, targets):
        _, poses = targets
        compensation = compensate(model, poses)
        assert compensation.reached.all()
        motion = {**static_motion(4, 12), "joint_position": compensation.joint_position + MISSING}
        assert distances(arm.poses(motion), poses).max() < 1e-4

    def test_what_is_written_is_read_and_said(self, capsys, model, diagnosis, targets, tmp_path):
        _, poses = targets
        recording = Recording.from_arrays(np.zeros((12, 6)), position=poses[:, :3, 3], quaternion=quaternions(poses))
        names = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
        columns = recording.columns()
        pyarrow.csv.write_csv(pyarrow.table({name: columns[name] for name in names}), tmp_path / "targets.csv")
        out = tmp_path / "joints.csv"
        code, said, err = run(capsys, "compensate", diagnosis, tmp_path / "targets.csv", "--out", out)
        assert code == 0
        assert "corrected its joint columns" not in flat(err)
        degrees = np.rad2deg(model.joint_zero[JOINT - 1])
        assert (
            "Note: the zeros of joints are off; joint positions are written as the controller counts them, with "
            f"{-degrees:+.3f} deg at joint 3." in flat(said)
        )
        assert distances(predict(model, out), poses).max() < 1e-5

    @pytest.mark.parametrize("zero", [OFF, -OFF, np.pi / 2])
    def test_neither_the_arm_nor_its_controller_leaves_its_limits(self, model, targets, zero):
        """A zero that is lost leaves the controller its limits; another convention moves them."""
        joints, _ = targets
        model = replace(model, joint_zero=zero * np.eye(6)[0])
        limits = np.tile([-np.pi, np.pi], (6, 1))
        limits[0] = [-1.0, 1.0]
        model = replace(model, joint_limits=limits)
        at = joints[:2] - model.joint_zero
        at[:, 0] = [1.2 - zero, -1.2 - zero]
        compensation = compensate(model, predict(model, at), start=at)
        assert [reason.code for reason in compensation.reason] == ["at_limit", "at_limit"]
        upper, lower = (reason.angles[0] for reason in compensation.reason)
        if abs(zero) > 1:
            assert (upper, lower) == pytest.approx((1.0 - zero, -1.0 - zero))
        else:
            assert (upper, lower) == pytest.approx((1.0 - max(zero, 0.0), -1.0 - min(zero, 0.0)))


def test_the_viewer_shows_the_recorded_file_without_it(content, model, arm, other):
    scene = pose_scene(content, model, recorded(arm, other))
    assert np.linalg.norm(scene.poses[0].error, axis=1).max() < 2e-4
    still = pose_scene(content, replace(model, joint_zero=np.zeros(6)), arm.recording(other))
    np.testing.assert_allclose(scene.frames, still.frames, rtol=0, atol=2e-3)


def test_the_exported_arm_counts_as_the_controller(model, arm, other):
    chain, _ = diagnosed_chain(model)
    q = recorded(arm, other).joint_position
    tip = six_parameter_poses(chain.kinematics, q) @ chain.T_joint_flange
    wanted = np.linalg.inv(np.asarray(model.model.T_sensor_base)) @ predict(model, q)
    np.testing.assert_allclose(tip, wanted, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(chain.joint_limits, LITE6.joint_limits)


def test_limits_of_another_convention_are_exported_as_it_counts(model):
    turned = replace(model, joint_zero=np.pi / 2 * np.eye(6)[1])
    chain, _ = diagnosed_chain(turned)
    expected = LITE6.joint_limits - np.pi / 2 * np.eye(6)[1][:, None]
    np.testing.assert_allclose(chain.joint_limits, expected)


class TestDocuments:
    def test_an_earlier_one_has_none_and_is_warned_of(self, capsys, content, arm, other, tmp_path):
        content = copy.deepcopy(content)
        del content["model"]["joint_zero_rad"]
        assert not model_from_document(content).joint_zero.any()
        path = written(recorded(arm, other), tmp_path)
        code, said, err = run(capsys, "predict", stored(tmp_path, content), path, "--out", tmp_path / "predicted.csv")
        assert code == 0
        assert "corrected its joint columns (joint zero or whole turns), and these are taken as they are" in flat(err)
        assert "zeros of joints" not in said

    def test_other_faults_of_columns_are_still_warned_of(self, content):
        assert corrected_columns(content) == ""
        swapped = {"fault": "swapped_joints", "rows": [], "numbers": {"joints": [1, 2]}, "statement": "Said."}
        more = {**content, "data_faults": [*content["data_faults"], swapped]}
        assert corrected_columns(more).startswith(
            f"the diagnosis corrected its joint columns ({fault_name('swapped_joints').lower()}), and these are taken"
        )

    def test_a_damaged_one_is_refused(self, content):
        content = copy.deepcopy(content)
        content["model"]["joint_zero_rad"].pop()
        assert "joint_zero_rad is not a number of each joint" in refusal(model_from_document, content)
