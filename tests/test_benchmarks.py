"""The benchmarks' own honesty: what they simulate, when they call an answer wrong, and what they write."""

import json
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks import __main__ as harness
from benchmarks import (
    command,
    diagnose,
    fits,
    folders,
    measure,
    one_by_one,
    problem,
    profile,
    regressor,
    rivals,
    samples,
    seed_way,
)
from benchmarks.measure import Record
from lite6jax.arms import dynamics
from lite6jax.diagnosis.result import Finding
from lite6jax.effects.catalogue import catalogue
from lite6jax.effects.kinematic.surroundings import TimeOffset
from lite6jax.effects.serialization import parse_effect
from lite6jax.estimation.score_test import Score
from lite6jax.recordings.fault import DataFault
from lite6jax.report.data_faults import fault_statement
from lite6jax.search.state import SelectedTerm
from tests.oracles.arms import ASSEMBLY
from tests.oracles.chains import seed_poses, six_parameter_poses
from tests.oracles.effects import predicted_poses
from tests.oracles.transforms import displacement

KEYS = {"workload", "subject", "metric", "value", "unit", "better"}
RNG_SEED = 11


def some_parameters(rng):
    return seed_way.NOMINAL + 2e-3 * rng.standard_normal(28)


def test_a_record_is_six_keys_and_one_more_only_where_it_failed():
    record = Record("one", "lite6jax", "fit", 1.5, "ms", "lower")
    assert record.as_json().keys() == KEYS
    assert Record("one", "x", "fit", None, "ms", "lower", "off").as_json().keys() == KEYS | {"failed"}


def test_the_rivals_chains_are_those_of_the_oracle():
    rng = np.random.default_rng(RNG_SEED)
    kinematics, parameters = problem.simulated_arms(1, RNG_SEED)[0], some_parameters(rng)
    q = seed_way.sample_joints(20, rng)
    np.testing.assert_allclose(
        [seed_way.factory_pose(kinematics, each) for each in q], six_parameter_poses(kinematics, q), atol=1e-14
    )
    np.testing.assert_allclose(
        [seed_way.effective_pose(parameters, each) for each in q], seed_poses(parameters, q), atol=1e-14
    )
    np.testing.assert_allclose(
        [rivals.naive_pose(parameters, each) for each in q[:3]], seed_poses(parameters, q[:3]), atol=1e-14
    )


def test_the_simulated_sensor_has_the_noise_it_says():
    read = problem.measured(2, 2000, RNG_SEED)
    for arm in range(2):
        true = six_parameter_poses(read.kinematics[arm], read.joint_position[arm])
        shift = read.pose[arm, :, :3, 3] - true[:, :3, 3]
        relative = np.swapaxes(true[:, :3, :3], 1, 2) @ read.pose[arm, :, :3, :3]
        spin = np.stack([relative[:, 2, 1], relative[:, 0, 2], relative[:, 1, 0]], 1)
        np.testing.assert_allclose(shift.std(0), problem.NOISE[0], rtol=0.1)
        np.testing.assert_allclose(spin.std(0), problem.NOISE[1], rtol=0.1)
    assert np.abs(read.joint_position[0] - read.joint_position[1]).max() > 1


def test_the_seeds_way_finds_the_parameters_and_writes_the_seeds_table(tmp_path):
    rng = np.random.default_rng(RNG_SEED)
    parameters, q = some_parameters(rng), seed_way.sample_joints(12, rng)
    found = seed_way.fit(q, seed_poses(parameters, q))
    np.testing.assert_allclose(found, parameters, atol=1e-11)
    table = seed_way.as_table(found)
    assert table.keys() == {"units", "base", "dh", "beta_joint2"}
    assert table["dh"][1]["d"] == 0
    assert table["beta_joint2"] == pytest.approx(np.rad2deg(parameters[27]))


def test_a_table_is_wrong_unless_it_is_the_calibrations_chain(tmp_path):
    truth = problem.measured(1, 1, RNG_SEED)
    table = seed_way.as_table(fits.convert(truth)[0])
    path = tmp_path / "model.json"
    path.write_text(json.dumps(table))
    assert command.wrong_table(path, truth.kinematics[0]) == ""
    table["beta_joint2"] *= -1
    path.write_text(json.dumps(table))
    assert command.wrong_table(path, truth.kinematics[0]).startswith("flange poses off by ")


def test_an_answer_is_likely_or_not():
    rng = np.random.default_rng(RNG_SEED)
    root = rng.standard_normal((28, 28))
    covariance = np.broadcast_to(root @ root.T, (50, 28, 28))
    truth = rng.standard_normal((50, 28))
    fitted = truth + rng.standard_normal((50, 28)) @ root.T
    assert measure.unlikely(fitted, covariance, truth) == ""
    for wrong in (
        measure.unlikely(fitted, covariance / 4, truth),  # flatters itself
        measure.unlikely(fitted, covariance * 4, truth),  # knows more than it says
        measure.unlikely(fitted + 10 * root[:, 0] * (np.arange(50) == 7)[:, None], covariance, truth),  # one arm
        measure.unlikely(np.where(np.arange(50)[:, None] == 3, np.nan, fitted), covariance, truth),
    ):
        assert wrong.startswith("misses the truth")


def test_not_a_number_disagrees():
    assert measure.disagreement(np.array([0.0, np.nan]), np.zeros(2), 1.0, "numbers") != ""
    assert measure.disagreement(np.array([0.5]), np.zeros(1), 0.5, "numbers") == ""
    assert measure.disagreement(np.array([2.0]), np.zeros(1), 1.0, "numbers (m)") == "numbers (m) off by 2, more than 1"


def test_a_rival_that_finds_something_else_is_marked():
    honest = rivals.VECTORISED
    liar = honest._replace(name="liar", solve=lambda q, pose: honest.solve(q, pose) + 1e-8)
    records = list(fits.one(samples=40, repeats=1, rivals=(honest, liar)))
    assert {record.subject for record in records if record.failed} == {"liar", "lite6jax"}
    assert {r.metric for r in records if r.failed and r.subject == "lite6jax"} == {"faster than liar"}
    assert all(record.value is not None and record.value > 0 for record in records)


def test_a_fleet_is_compared_with_the_closed_form():
    records = list(fits.fleet(sizes=(1,), samples=40, repeats=1, rivals=()))
    assert [record.failed for record in records] == [""] * len(records)
    assert {record.subject for record in records} == {fits.OURS, fits.CLOSED_FORM}


@pytest.mark.long
def test_a_folder_is_fitted_alike_by_one_process_and_two():
    records = list(folders.folders(files=40, repeats=1))
    assert [record.failed for record in records] == [""] * len(records)
    assert {record.subject for record in records} >= {"PyYAML's C loader", "fleet, processes 2"}


def test_the_parts_of_a_fit_are_right():
    records = list(profile.profile(samples=40, repeats=1))
    assert [record.failed for record in records] == [""] * len(records)
    assert "whole fit over JᵀJ alone" in {record.metric for record in records}


def test_a_regressor_that_is_not_pinocchios_is_marked(monkeypatch):
    right = list(regressor.regressor(samples=30, repeats=1))
    assert [record.failed for record in right] == [""] * 4
    assert right[-1].value == pytest.approx(right[1].value / right[2].value)
    correct = dynamics.regressor
    monkeypatch.setattr(dynamics, "regressor", lambda *motion: correct(*motion) + 1e-9)
    wrong = list(regressor.regressor(samples=30, repeats=1))
    assert [record.subject for record in wrong if "the regressor off by 1e-09" in record.failed] == ["lite6jax"] * 3


def test_peak_memory_is_what_the_process_held_itself():
    ballast = np.ones(25_000_000)  # 200 MB that a child inherits in its parent's books, and must not count
    program = (
        "import numpy as np; from benchmarks.samples import peak_memory; before = peak_memory();"
        "held = np.ones(12_500_000); print(before, peak_memory())"
    )
    run = subprocess.run([sys.executable, "-c", program], cwd=samples.ROOT, capture_output=True, text=True, check=True)
    before, after = map(int, run.stdout.split())
    assert before < ballast.nbytes
    assert 95e6 < after - before < 110e6


def wrong_workload(failed):
    yield Record("w", "lite6jax", "fit", 1.0, "ms", "lower", failed)
    yield Record("w", "other", "fit", None, "", "higher", failed)


def test_the_exit_code_says_whether_every_answer_was_right(tmp_path, capsys):
    known = {"models": partial(wrong_workload, ""), "bad": partial(wrong_workload, "off by a lot")}
    out = tmp_path / "out.json"
    assert harness.main(["models", "--json", str(out)], known) == 0
    assert json.loads(out.read_text())[1] == {
        "workload": "w", "subject": "other", "metric": "fit", "value": None, "unit": "", "better": "higher",
    }  # fmt: skip
    assert harness.main(["--json", str(out)], known) == 1
    assert [record.get("failed") for record in json.loads(out.read_text())] == [None, None] + ["off by a lot"] * 2
    assert "wrong: w, lite6jax, fit: off by a lot" in capsys.readouterr().out
    assert harness.main(["--json", str(tmp_path / "no" / "out.json")], known) == 2
    assert capsys.readouterr().err.startswith("benchmarks: ")


def plain_parameters(effect, values):
    """As the oracle takes them: where the effect acts, and its parameters by name."""
    where = {name: value for name in ("joint", "link") if (value := getattr(effect, name, None)) is not None}
    return {**where, **{name: estimate.value for name, estimate in effect.reported(values).items()}}


def test_the_naive_search_bends_the_arm_as_the_oracle_does(tmp_path):
    rng = np.random.default_rng(RNG_SEED)
    arm, samples, dof = diagnose.LITE6, 5, 6
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = Rotation.from_rotvec([0.3, -0.2, 1.0]).as_matrix(), [1.0, -2.0, 0.1]
    tool = np.eye(4)
    tool[:3, 3] = 0.02, -0.01, 0.06
    q = seed_way.sample_joints(samples, rng)
    motion = {
        "joint_position": q,
        "joint_velocity": np.zeros_like(q),
        "direction": rng.choice([-1.0, 1.0], q.shape),
        "time": 8.0 * np.arange(samples),
        "joint_temperature": np.full(q.shape, 25.0),
        "payload": np.zeros(samples),
    }
    inertia = {
        "mass": arm.mass,
        "center_of_mass": arm.center_of_mass,
        "payload_center": np.zeros(3),
        "gravity": np.array([0.0, 0.0, -9.81]),
    }
    readings = one_by_one.Readings(
        q, motion["direction"], motion["time"], np.zeros((samples, 3)), 1.0, arm.kinematics, start, tool, False,
        arm.mass, arm.center_of_mass,
    )  # fmt: skip
    links = ASSEMBLY * rng.standard_normal((5, 6))
    frame = np.array([1e-3, -2e-3, 3e-3, 1e-3, -2e-3, 3e-3])
    shifted = [3e-3, -1e-3, 2e-3]
    T_sensor_base, T_flange_tool = start @ displacement(frame), tool.copy()
    T_flange_tool[:3, 3] += shifted
    skipped = ("joint_lag", "link_thermal_expansion", "joint_thermal_offset", "time_offset")
    tried = [effect for effect in catalogue(dof) if effect.name not in skipped]
    for effect in tried:
        values = rng.uniform(0.5, 1.0, effect.size) * [coordinate.typical for coordinate in effect.coordinates]
        # gravity's moments are those of the declared chain
        moved = np.zeros((5, 6)) if "compliance" in effect.name else links
        kinematics = arm.kinematics + np.concatenate([np.zeros((1, 6)), moved])
        predicted = readings.residual(np.concatenate([frame, shifted, moved.ravel(), values]), effect)
        expected = predicted_poses(
            kinematics, T_sensor_base, T_flange_tool, motion, inertia, [(effect.name, plain_parameters(effect, values))]
        )
        position = predicted[: 3 * samples].reshape(-1, 3)
        np.testing.assert_allclose(position, expected[:, :3, 3], atol=1e-13, err_msg=effect.label)
    with pytest.raises(NotImplementedError, match="time_offset"):
        readings.bent(TimeOffset(), np.zeros(1))


def test_the_naive_search_finds_what_is_hidden(tmp_path):
    recording = diagnose.hidden(tmp_path, "known", 60)
    case = diagnose.pose_problem(recording)
    texts = (diagnose.TRUE, "joint_compliance:joint=3", "joint_backlash:joint=2", "payload_error")
    candidates = tuple(parse_effect(text, neutral=True)[0] for text in texts)
    found, value = diagnose.refitted(diagnose.readings_of(case, "known"), candidates)
    assert found == candidates[0]
    np.testing.assert_allclose(value, 2e-5, rtol=0.1)


def test_every_kind_of_recording_comes_once_a_round_and_is_what_it_says(tmp_path):
    kinds = list(diagnose.clean_recordings(145))
    assert [clean.seed for clean in kinds] == list(range(145))
    assert len({clean[1:] for clean in kinds}) == 144
    assert kinds[0][1:] == next(diagnose.clean_recordings(1))[1:]
    for clean in kinds[:4] + kinds[72:76]:
        recording = clean.recording(tmp_path)
        settings = recording.settings
        assert recording.motion == clean.motion
        assert (settings.factory_calibration is None) == (clean.geometry == "unknown")
        assert (settings.factory_uncertainty is None) == (clean.geometry != "uncertain")
        assert (recording.quaternion is None) == (clean.sensor == "tracker")
        assert (settings.pose_frame, settings.tool) == (("unknown",) * 2 if clean.mounted else ("base", "none"))


def test_false_alarms_are_listed_and_too_many_are_wrong(tmp_path, monkeypatch):
    effect, _ = parse_effect(diagnose.TRUE)
    term = SelectedTerm(effect, 1e-4, Score(20.0, 1, 1e-8, False, np.zeros(1)))
    fault = DataFault("repeated_rows", (3,), {"first_rows": [1]})
    answers = iter([((term,), ()), ((), ()), ((), (fault,)), ((term,), ())])
    monkeypatch.setattr(diagnose, "searched", lambda recording: next(answers))
    records = list(diagnose.false_alarms(4, tmp_path))
    alarms = [record for record in records if record.workload == "false alarm"]
    assert [record.subject[:6] for record in alarms] == ["seed 0", "seed 2", "seed 3"]
    assert [record.metric for record in alarms] == [
        effect.label,
        f"repeated_rows: {fault_statement(fault)}",
        effect.label,
    ]
    counts = {record.metric: record for record in records if record.workload != "false alarm"}
    assert counts["with a finding"].value == 2
    assert counts["with a finding"].failed == "2 of 4 show something, more than 1"
    assert counts["with a fault of the data, other than outliers"].value == 1
    assert sum(record.value for name, record in counts.items() if name.startswith("— ")) == 2


def test_a_finding_is_right_only_where_it_is_what_was_hidden():
    effect, _ = parse_effect(diagnose.TRUE)
    other, _ = parse_effect("joint_harmonic:joint=2,order=2", neutral=True)
    findings = [Finding(each, np.zeros(each.size), np.eye(each.size), 1e-4, 20.0, ()) for each in (effect, other)]
    assert diagnose.wrong_findings(findings[:1]) == ""
    assert diagnose.wrong_findings([]) == "found nothing, not joint_compliance:joint2"
    assert "joint_harmonic:joint2, order 2" in diagnose.wrong_findings(findings)


def test_recordings_are_counted_for_the_diagnosis_alone(capsys):
    def counted(recordings=300):
        yield Record("diagnose", "lite6jax", "recordings", float(recordings), "", "lower")

    known = {"diagnose": counted, "models": partial(wrong_workload, "")}
    assert harness.main(["diagnose", "--recordings", "7"], known) == 0
    assert "7" in capsys.readouterr().out
    for refused in (["diagnose", "--recordings", "0"], ["models", "--recordings", "7"]):
        with pytest.raises(SystemExit):
            harness.main(refused, known)
        assert "--recordings: give 1 or more" in capsys.readouterr().err
