"""The whole diagnosis: what is said of clean recordings, of named physics and of physics without a name."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from diagnosis.recorded import NOISE, Made, check_values, found, static_motion, with_effects

from lite6jax.arms.factory import write_factory
from lite6jax.diagnosis.case import case_of
from lite6jax.diagnosis.diagnose import FOLDS, diagnose, statement
from lite6jax.diagnosis.faults import jumps
from lite6jax.diagnosis.selection import search_of
from lite6jax.errors import InputError
from lite6jax.recordings import Recording

SAMPLES = 300
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


def test_held_out_errors_are_those_of_the_rest(arm, still, monkeypatch):
    """An error that only one block has is no reason to believe in physics, and stays in the errors of that block."""
    monkeypatch.setattr("lite6jax.diagnosis.faults.jumps.seek_jump", lambda rigid: jumps.Sought(None, 1.0, False))
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

    case = case_of(arm.recording(still, bump=(3, curve)))
    selection = search_of(case).run()
    largest = max(selection.steps, key=lambda step: step.score.gain)
    assert (largest.effect.name, largest.effect.site) == ("unnamed", "joint3")
    assert largest.effect.drivers[0].phrase == "position of joint 3"
    assert found(selection) == [("unnamed", "joint3")]
    values = selection.fitted.values[selection.fitted.physics.slices[0]]
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
        case_of(Made(arm.folder, seed=1, geometry="free").recording(still), geometry="exact")


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


def test_one_frame_that_is_off_is_physics(tmp_path):
    text = "frame_offset:link=3,x_m=1e-4,y_m=-1e-4,z_m=0,rx_rad=2e-4,ry_rad=0,rz_rad=0"
    seen = diagnose(Made(tmp_path, (text,), seed=5).recording(static_motion(5, 300)))
    assert [step.effect.label for step in seen.selection.steps] == ["frame_offset:link3"]
    assert not seen.faults
