"""The whole diagnosis: what is said of clean recordings, of named physics and of physics without a name."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from diagnosis.recorded import NOISE, Made, check_values, found, moving_motion, static_motion, with_effects

from lite6jax.arms import frames
from lite6jax.arms.bundled import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.diagnosis.diagnose import FOLDS, diagnose, statement
from lite6jax.diagnosis.explanation import explain
from lite6jax.domains.pose.problem import pose_problem
from lite6jax.domains.pose.screening import frame_jumps as jumps
from lite6jax.domains.pose.screening.screen import examine
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.search.forward import search_of

SAMPLES = 300
MOTION_CAPTURE = (2e-4, 1e-3)
"""m and rad per axis."""
COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"


@pytest.fixture(scope="module")
def still():
    return static_motion(11, SAMPLES)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=1)


@pytest.fixture(scope="module")
def wild():
    return np.array([7, 70, 133])


@pytest.fixture(scope="module")
def soft(arm, still, wild):
    """The diagnosis of an arm with one effect and three wild rows among its samples."""
    recording = with_effects(arm, COMPLIANCE).recording(still)
    position = recording.position.copy()
    position[wild] += 0.02
    return diagnose(replace(recording, position=position))


def rms(errors):
    return np.sqrt(np.mean(errors**2))


def test_a_clean_recording_is_consistent(arm, still):
    calls = []
    diagnosis = diagnose(arm.recording(still), progress=calls.append)
    assert diagnosis.verdict == "consistent"
    assert diagnosis.selection.steps == ()
    assert calls == [1] * (FOLDS + 1)
    np.testing.assert_array_equal(diagnosis.before, diagnosis.after)
    assert not diagnosis.outliers.any()
    # nothing was fitted: what is left is the sensor's noise in three axes
    assert rms(diagnosis.before) == pytest.approx(np.sqrt(3) * NOISE[0], rel=0.1)
    assert diagnosis.estimated_noise == pytest.approx(NOISE[0], rel=0.06)
    assert diagnosis.to_dict()["findings"] == []


def test_one_effect_is_explained(soft, wild):
    assert soft.verdict == "explained"
    assert found(soft.selection) == [("joint_compliance", "joint2")]
    check_values(soft.selection, COMPLIANCE)
    np.testing.assert_array_equal(np.flatnonzero(soft.outliers), wild)
    kept = ~soft.outliers
    assert rms(soft.before[kept]) > 3 * rms(soft.after[kept])
    assert rms(soft.after[kept]) == pytest.approx(np.sqrt(3) * NOISE[0], rel=0.1)
    assert soft.estimated_noise == pytest.approx(NOISE[0], rel=0.1)


def test_a_frame_that_jumps_is_put_back_and_said(arm, still):
    recording = replace(arm, frame=True).recording(still)
    position = recording.position.copy()
    position[:60] += np.array([1e-4, 0, 0])
    diagnosis = diagnose(replace(recording, position=position))
    assert [fault["fault"] for fault in diagnosis.to_dict()["data_faults"]] == ["frame_jump"]
    assert diagnosis.verdict == "consistent"
    assert rms(diagnosis.after) == pytest.approx(np.sqrt(3) * NOISE[0], rel=0.1)


def test_a_jump_is_said_beside_physics(arm, still):
    """What jumped stays a jump, also where an effect is found beside it, and says how unlikely it is without."""
    recording = with_effects(arm, COMPLIANCE).recording(still)
    position = recording.position.copy()
    position[100:] += np.array([2e-4, 0, 1e-4])
    explanation = explain(replace(recording, position=position), None, "declared")
    assert found(explanation.selection) == [("joint_compliance", "joint2")]
    check_values(explanation.selection, COMPLIANCE)
    (fault,) = explanation.examined.faults
    assert (fault.fault, fault.rows[0]) == ("frame_jump", 101)
    assert "Without it the best explanation (" in fault.statement


def test_physics_that_looks_like_a_jump_is_physics(arm):
    """A step of a joint's transmission that the arm crosses: the poses after it are elsewhere, as if moved."""
    motion = moving_motion(21, 160)
    crossed = np.median(motion["joint_position"][:, 4])
    recording = arm.recording(motion, bump=(5, lambda q: 5e-4 * (q > crossed)))
    assert [fault.fault for fault in examine(recording).faults] == ["frame_jump"]
    explanation = explain(recording, None, "declared")
    assert [step.effect.site for step in explanation.selection.steps] == ["joint5"]
    assert explanation.examined.faults == ()
    (said,) = (fault for fault in explanation.examined.checked if fault.fault == "frame_jump")
    assert "What looks like a jump of a frame at row" in said.statement
    assert "unnamed:joint5" in said.statement


def test_held_out_errors_are_those_of_the_rest(arm, still, monkeypatch):
    """An error that only one block has is no reason to believe in physics, and stays in the errors of that block."""
    monkeypatch.setattr(
        "lite6jax.domains.pose.screening.frame_jumps.seek_jump", lambda rigid: jumps.Sought(None, 1.0, False)
    )
    recording = arm.recording(still)
    position = recording.position.copy()
    position[:60] += np.array([1e-4, 0, 0])
    diagnosis = diagnose(replace(recording, position=position))
    assert rms(diagnosis.after[:60]) > 0.9e-4


def test_the_document(soft, wild):
    document = soft.to_dict()
    assert document["schema"] == "lite6jax/diagnosis/1"
    assert document["verdict"] == "explained"
    kept = ~soft.outliers
    for name, errors in (("before", soft.before[kept]), ("after", soft.after[kept])):
        assert document[name] == {
            "heldout_position_rms_m": pytest.approx(rms(errors)),
            "heldout_position_p95_m": pytest.approx(np.percentile(errors, 95)),
            "heldout_position_max_m": pytest.approx(errors.max()),
        }
    assert document["heldout_rows"] == SAMPLES - len(wild)
    assert document["noise"]["declared_position_m"] == NOISE[0]
    (fault,) = document["data_faults"]
    assert (fault["fault"], fault["rows"]) == ("outliers", [8, 71, 134])
    (finding,) = document["findings"]
    assert (finding["effect"], finding["site"]) == ("joint_compliance", "joint2")
    assert finding["driver"] == "gravity torque of joint 2"
    assert finding["p_value"] < 1e-3
    assert finding["heldout_rms_after_m"] < finding["heldout_rms_before_m"]
    assert "compliance_rad_per_Nm" in finding["statement"]
    reasons = {(item["effect"], item["site"]): item["reason"] for item in document["untestable"]}
    assert reasons["joint_lag", "joint2"].startswith("needs the velocity of joint 2")
    assert ("time_offset", "clock") in reasons


def test_physics_without_a_name(arm, still):
    """A bump in one joint's transmission that no entry of the catalogue has."""

    def curve(q):
        return 1.5e-3 * np.exp(-0.5 * ((q - 1.4) / 0.12) ** 2)

    case = pose_problem(arm.recording(still, bump=(3, curve)))
    selection = search_of(case).run()
    largest = max(selection.steps, key=lambda step: step.score.gain)
    assert (largest.effect.name, largest.effect.site) == ("unnamed", "joint3")
    assert largest.effect.drivers[0].phrase == "position of joint 3"
    assert found(selection) == [("unnamed", "joint3")]
    values = selection.fitted.values[selection.fitted.terms.slices[0]]
    at = np.linspace(0.2, 2.8, 200)
    fitted = np.asarray(largest.effect.curve(jnp.asarray(values), jnp.asarray(at)))
    assert rms(fitted - curve(at)) < 1.5e-4
    said = statement(largest.effect, {})
    assert said == (
        "Something real at joint3, a function of position of joint 3, that no entry of the catalogue explains."
    )


def test_noise_that_is_not_as_declared(arm, still):
    """Three times the noise is not physics; it is estimated."""
    diagnosis = diagnose(arm.recording(still, noise=(6e-5, 3e-4)))
    assert diagnosis.verdict == "consistent"
    assert diagnosis.estimated_noise == pytest.approx(6e-5, rel=0.1)


def test_a_recording_without_poses_is_refused(arm, still):
    recording = Recording.from_arrays(still["joint_position"], source="motion.csv")
    with pytest.raises(InputError, match=r"motion.csv: has no measured positions; a fit needs the columns x_m y_m z_m"):
        diagnose(recording)


def test_a_sequence_whose_arm_is_not_known(arm, still):
    with pytest.raises(InputError, match=r"needs a factory_calibration in the sidecar; use --geometry free"):
        pose_problem(Made(arm.folder, seed=1, geometry="free").recording(still), geometry="exact")


def test_a_calibration_that_is_a_little_off_everywhere_is_a_fault_of_the_file(tmp_path):
    """Fifteen micrometres in each number, declared as exact: said with its size, and no physics is made of it."""
    made = Made(tmp_path, seed=5)
    recording = made.recording(static_motion(5, 300))
    path = recording.settings.factory_calibration
    off = 1.5e-5 * np.random.default_rng(0).standard_normal(made.kinematics.shape)
    write_factory(made.kinematics + off, path, overwrite=True)
    seen = diagnose(recording)
    assert [fault.fault for fault in seen.faults] == ["calibration_off"]
    assert not seen.selection.steps
    uncertainty = seen.case.recording.settings.factory_uncertainty
    assert 7e-6 < uncertainty.position_m < 3e-5
    assert "factory_uncertainty" in seen.faults[0].statement


def test_physics_is_found_beside_a_calibration_that_is_off(tmp_path):
    made = Made(tmp_path, (COMPLIANCE,), seed=5)
    recording = made.recording(static_motion(5, 200))
    off = 1.5e-5 * np.random.default_rng(0).standard_normal(made.kinematics.shape)
    write_factory(made.kinematics + off, recording.settings.factory_calibration, overwrite=True)
    explanation = explain(recording, None, "declared")
    assert [fault.fault for fault in explanation.examined.faults] == ["calibration_off"]
    assert found(explanation.selection) == [("joint_compliance", "joint2")]
    check_values(explanation.selection, COMPLIANCE)


def test_one_number_that_is_off_is_physics(tmp_path):
    made = Made(tmp_path, ("joint_offset:joint=3,offset_rad=1e-4",), seed=5)
    explanation = explain(made.recording(static_motion(5, 200)), None, "declared")
    assert found(explanation.selection) == [("joint_offset", "joint3")]
    assert explanation.examined.faults == ()


class TestPublishedTables:
    """A file that holds one of the two published tables, under motion capture: their difference is like physics'."""

    @pytest.fixture
    def captured(self, tmp_path):
        """Makes the recording of an arm of one table, whose file has the declared one."""

        def recorded(true, declared, effects=(), setup="exact"):
            made = Made(tmp_path, effects, seed=7, geometry=setup, frame=True)
            motion = moving_motion(8, 200)
            made.__dict__["kinematics"] = load_bundled(true).kinematics
            recording = made.recording(motion, noise=MOTION_CAPTURE)
            if setup == "exact":
                write_factory(load_bundled(declared).kinematics, recording.settings.factory_calibration, overwrite=True)
            noise = {"position_noise_m": MOTION_CAPTURE[0], "orientation_noise_rad": MOTION_CAPTURE[1]}
            return replace(recording, settings=replace(recording.settings, arm=declared, **noise))

        return recorded

    def test_the_other_in_the_file(self, captured):
        recording = captured("lite6_ros", "lite6")
        assert examine(recording).doubted == "lite6_ros"
        diagnosis = diagnose(recording)
        (fault,) = diagnosis.faults
        assert fault.fault == "nominal_table"
        assert "taken as published" in fault.statement
        assert diagnosis.verdict == "consistent"
        model = diagnosis.model()
        assert model["arm"] == "lite6_ros"
        links = [frames.transform_from_row(row) for row in model["kinematics"]]
        np.testing.assert_allclose(links, load_bundled("lite6_ros").links, atol=1e-12)

    @pytest.mark.parametrize("table", ["lite6", "lite6_ros"])
    def test_the_right_one_in_the_file(self, captured, table):
        explanation = explain(captured(table, table, ("joint_offset:joint=3,offset_rad=1e-3",)), None, "declared")
        assert explanation.examined.faults == ()
        assert found(explanation.selection) == [("joint_offset", "joint3")]

    def test_the_other_named_and_the_chain_fitted(self, captured):
        (fault,) = examine(captured("lite6_ros", "lite6", setup="free")).faults
        assert fault.fault == "nominal_table"
        assert examine(captured("lite6", "lite6", setup="free")).faults == ()


def test_one_frame_that_is_off_is_physics(tmp_path):
    text = "frame_offset:link=3,x_m=1e-4,y_m=-1e-4,z_m=0,rx_rad=2e-4,ry_rad=0,rz_rad=0"
    seen = diagnose(Made(tmp_path, (text,), seed=5).recording(static_motion(5, 300)))
    assert [step.effect.label for step in seen.selection.steps] == ["frame_offset:link3"]
    assert not seen.faults
