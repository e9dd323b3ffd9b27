"""The whole diagnosis: what is said of clean recordings, of named physics and of physics without a name."""

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from diagnosis.recorded import (
    NOISE,
    Made,
    check_values,
    drawn,
    found,
    moving_motion,
    static_motion,
    with_effects,
)
from rich.console import Console

from lite6jax.arms import frames
from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.explanation import Case
from lite6jax.diagnosis.explanation import explain as explain_with
from lite6jax.diagnosis.options import Options
from lite6jax.domains.pose.screening.screen import screen
from lite6jax.progress import Stage
from lite6jax.recordings import Recording
from lite6jax.report.sections import diagnosis_report
from lite6jax.report.statements import with_statements
from tests.oracles.transforms import quaternions

SAMPLES = 200
TWO_FOLDS = Options(folds=2)
"""What is held out is alike in each; the default of five takes twice as long."""
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


def diagnose(recording, **given):
    return diagnose_poses(recording, options=TWO_FOLDS, **given)


def explain(recording):
    return explain_with(Case(recording, None, "declared", Options()))


def rms(errors):
    return np.sqrt(np.mean(errors**2))


def test_a_clean_recording_is_consistent(arm, still):
    calls = []
    diagnosis = diagnose(arm.recording(still), progress=calls.append)
    assert diagnosis.verdict == "consistent"
    assert diagnosis.findings == ()
    parts = 1 + TWO_FOLDS.folds
    assert [stage.part for stage in calls] == sorted(stage.part for stage in calls)
    selecting = [stage for stage in calls if stage.code == "selecting"]
    assert {stage.parts for stage in selecting} == {parts}
    assert [stage.part for stage in selecting].count(0) == 1  # of all rows
    assert not [stage for stage in selecting if stage.part]  # nothing was found that is to be searched for again
    assert calls[-1] == Stage("planning", parts, parts)
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


def test_a_jump_is_said_beside_physics(arm, still):
    """What jumped stays a jump, also where an effect is found beside it, and says how unlikely it is without."""
    recording = with_effects(arm, COMPLIANCE).recording(still)
    position = recording.position.copy()
    position[100:] += np.array([2e-4, 0, 1e-4])
    explanation = explain(replace(recording, position=position))
    assert found(explanation.selection) == [("joint_compliance", "joint2")]
    check_values(explanation.selection, COMPLIANCE)
    (fault,) = explanation.screened.found
    assert (fault.code, fault.rows[0]) == ("frame_jump", 101)
    assert fault.numbers["log_likelihood_gap"] > 0


def test_physics_that_looks_like_joints_read_early_is_physics(tmp_path):
    """A coupling in 34 poses: the same rest of each move of its joint explained them by chance, and was put into the
    joint positions, where a backlash of twice its size undid it.
    """
    recording = drawn(tmp_path, 2240, 7)
    assert [fault.code for fault in screen(recording).found] == ["unsettled_readouts"]
    explanation = explain(recording)
    assert explanation.labels == ["joint_coupling:joint3"]
    assert explanation.screened.found == ()
    (ruled_out,) = (fault for fault in explanation.screened.ruled_out if fault.code == "unsettled_readouts")
    assert ruled_out.numbers["reason"] == "physics"
    assert ruled_out.numbers["log_likelihood_gap"] > 0
    assert ruled_out.numbers["rival_terms"] == explanation.labels


def test_held_out_errors_are_those_of_the_rest(arm, still):
    """An error that only one block has is not corrected from the others, and stays in the errors of that block."""
    recording = arm.recording(still)
    position = recording.position.copy()
    position[40:80] += np.array([1e-4, 0, 0])
    diagnosis = diagnose(replace(recording, position=position))
    assert rms(diagnosis.after[40:80]) > 0.9e-4


def test_a_fold_finds_faults_of_columns_by_itself(arm, still):
    """Two joints exchanged: every fold corrects them from its own training rows."""
    recording = with_effects(arm, COMPLIANCE).recording(still)
    exchanged = [0, 2, 1, 3, 4, 5]
    wrong = replace(
        recording,
        joint_position=recording.joint_position[:, exchanged],
        direction_of_motion=recording.direction_of_motion[:, exchanged],
        joint_temperature=recording.joint_temperature[:, exchanged],
    )
    diagnosis = diagnose(wrong)
    assert [fault.code for fault in diagnosis.faults] == ["swapped_joints"]
    assert [finding.effect.label for finding in diagnosis.findings] == ["joint_compliance:joint2"]
    assert (diagnosis.findings[0].name, diagnosis.findings[0].site) == ("joint_compliance", "joint2")
    assert rms(diagnosis.after) == pytest.approx(np.sqrt(3) * NOISE[0], rel=0.1)


def test_the_document(soft, wild):
    document = soft.to_dict()
    assert document["schema"] == "lite6jax/diagnosis/3"
    assert document["verdict"] == "explained"
    kept = ~soft.outliers
    for name, (errors, turned) in (("before", soft.errors.before), ("after", soft.errors.after)):
        assert document[name] == {
            f"heldout_{quantity}_{statistic}_{unit}": pytest.approx(of(values[kept]))
            for quantity, unit, values in (("position", "m", errors), ("orientation", "rad", turned))
            for statistic, of in (
                ("rms", rms),
                ("mean", np.mean),
                ("max", np.max),
                ("p95", lambda v: np.percentile(v, 95)),
            )
        }
    assert document["heldout_rows"] == SAMPLES - len(wild)
    assert document["noise"]["declared"]["position_m"] == NOISE[0]
    (fault,) = document["data_faults"]
    assert (fault["fault"], fault["rows"]) == ("outliers", [8, 71, 134])
    (finding,) = document["findings"]
    assert (finding["effect"], finding["site"]) == ("joint_compliance", "joint2")
    assert finding["driver"] == "gravity torque of joint 2"
    assert finding["p_value"] < 1e-3
    assert finding["parameters"]["compliance_rad_per_Nm"]["std"] < 1e-6
    assert "statement" not in finding
    lacking = {(item["effect"], item["site"]): item["driver"] for item in document["untestable"]}
    assert lacking["joint_lag", "joint2"] == "velocity of joint 2"
    assert ("time_offset", "clock") in lacking


def test_noise_that_is_not_as_declared(arm, still):
    """Three times the noise is not physics, and is not explained either; it is estimated."""
    diagnosis = diagnose(arm.recording(still, noise=(6e-5, 3e-4)))
    assert diagnosis.findings == ()
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.estimated_noise == pytest.approx(6e-5, rel=0.1)


@pytest.mark.long
def test_a_calibration_that_is_a_little_off_everywhere_is_a_fault_of_the_file(tmp_path):
    """Fifteen micrometres in each number, declared as exact: said with its size, and no physics is made of it."""
    made = Made(tmp_path, seed=5)
    recording = made.recording(static_motion(5, SAMPLES))
    path = recording.settings.factory_calibration
    off = 1.5e-5 * np.random.default_rng(0).standard_normal(made.kinematics.shape)
    write_factory(made.kinematics + off, path, overwrite=True)
    seen = diagnose(recording)
    assert [fault.code for fault in seen.faults] == ["calibration_off"]
    assert not seen.findings
    uncertainty = seen.problem.recording.settings.factory_uncertainty
    assert 7e-6 < uncertainty.position_m < 3e-5
    assert seen.faults[0].numbers["sigma_m"] == uncertainty.position_m


@pytest.mark.parametrize(("less_likely", "said"), [(8.0, "found"), (12.0, "physics"), (18.0, None)])
def test_of_a_stale_file_and_a_bent_link_the_likelier_is_said(tmp_path, less_likely, said):
    """The file is likelier by 10.4 at the usual prior probability; here that is less by some nats.

    The physics is said with the file as its alternative within 6 nats, and without a word of it beyond.
    """
    made = Made(tmp_path, seed=74)
    recording = made.recording(static_motion(74, SAMPLES))
    off = 6e-6 * np.random.default_rng(74).standard_normal(made.kinematics.shape)
    write_factory(made.kinematics + off, recording.settings.factory_calibration, overwrite=True)
    prior = Options().of(replace(recording.settings, prior={"calibration_off": 0.1 * float(np.exp(-less_likely))}))
    explanation = explain_with(Case(recording, None, "declared", prior))
    assert found(explanation.selection) == ([] if said == "found" else [("frame_offset", "link3")])
    faults = [
        fault
        for fault in (*explanation.screened.found, *explanation.screened.ruled_out)
        if fault.code == "calibration_off"
    ]
    assert [fault.numbers.get("reason", "found") for fault in faults] == ([] if said is None else [said])
    assert all(fault.numbers["rival_terms"] == ["frame_offset:link3"] for fault in faults)


def test_a_stale_file_is_an_alternative_of_the_link_that_it_would_explain(tmp_path):
    """Its prior probability is such that the bent link of the test before is likelier by 1.6 nats."""
    made = Made(tmp_path, seed=74)
    recording = made.recording(static_motion(74, SAMPLES))
    off = 6e-6 * np.random.default_rng(74).standard_normal(made.kinematics.shape)
    write_factory(made.kinematics + off, recording.settings.factory_calibration, overwrite=True)
    prior = {"calibration_off": 0.1 * float(np.exp(-12.0))}
    document = diagnose(replace(recording, settings=replace(recording.settings, prior=prior))).to_dict()
    (finding,) = document["findings"]
    assert (finding["effect"], finding["site"]) == ("frame_offset", "link3")
    (entry,) = [entry for entry in finding["confusable_with"] if "fault" in entry]
    assert (entry["fault"], entry["status"]) == ("calibration_off", "undecided")
    assert entry["log_likelihood_gap"] == pytest.approx(1.6, abs=0.1)
    assert 2e-6 < entry["numbers"]["sigma_m"] < 2e-5
    assert "instead_of" not in entry
    gaps = [entry["log_likelihood_gap"] for entry in finding["confusable_with"]]
    assert gaps == sorted(gaps)
    assert "calibration_off" not in [fault["fault"] for fault in document["ruled_out"]]
    printed = StringIO()
    Console(width=2000, file=printed).print(*diagnosis_report(with_statements(document), "poses.csv"))
    said = printed.getvalue()
    assert "a calibration file that is off everywhere by " in said
    assert "To separate frame offset at link3 from a calibration file that is off everywhere by " in said


def test_one_number_that_is_off_is_physics(tmp_path):
    made = Made(tmp_path, ("joint_offset:joint=3,offset_rad=1e-4",), seed=5)
    explanation = explain(made.recording(static_motion(5, SAMPLES)))
    assert found(explanation.selection) == [("joint_offset", "joint3")]
    assert explanation.screened.found == ()


def test_poses_that_a_controller_computed_hold_no_physics(tmp_path):
    """A nanometre that wanders is rounding: no sensor saw it."""
    samples = 80
    motion = static_motion(4, samples)
    poses = Made(tmp_path, seed=2).poses(motion)
    rounding = 2e-10 * np.random.default_rng(3).standard_normal((samples, 3))
    wandering = 1e-9 * np.sin(np.arange(samples) / 9)[:, None] * np.array([1.0, 0.3, -0.5])
    position = poses[:, :3, 3] + wandering + rounding
    declared = {
        "arm": "lite6",
        "motion": "static",
        "pose_frame": "base",
        "tool": "none",
        "pose_source": "laser_tracker",
    }
    recording = Recording.from_arrays(
        motion["joint_position"], position, quaternion=quaternions(poses[:, :3, :3]), **declared
    )
    diagnosis = diagnose(recording, geometry="free")
    assert [fault.code for fault in diagnosis.faults] == ["computed_pose"]
    assert diagnosis.findings == ()


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
        assert screen(recording).likelier_table == "lite6_ros"
        diagnosis = diagnose(recording)
        (fault,) = diagnosis.faults
        assert fault.code == "nominal_table"
        assert fault.numbers["chain"] == "as_published"
        assert diagnosis.verdict == "consistent"
        model = diagnosis.to_dict()["model"]
        assert model["arm"] == "lite6_ros"
        links = [frames.transform_from_row(row) for row in model["kinematics"]]
        np.testing.assert_allclose(links, load_bundled("lite6_ros").links, atol=1e-12)

    @pytest.mark.parametrize("table", ["lite6", "lite6_ros"])
    def test_the_right_one_in_the_file(self, captured, table):
        explanation = explain(captured(table, table, ("joint_offset:joint=3,offset_rad=1e-3",)))
        assert explanation.screened.found == ()
        assert found(explanation.selection) == [("joint_offset", "joint3")]

    def test_the_other_named_and_the_chain_fitted(self, captured):
        (fault,) = screen(captured("lite6_ros", "lite6", setup="free")).found
        assert fault.code == "nominal_table"
        assert screen(captured("lite6", "lite6", setup="free")).found == ()
