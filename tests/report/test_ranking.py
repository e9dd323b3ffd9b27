"""The first sentence, the ranking, the remedies and the commands of a diagnosis say what the document holds."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from diagnosed import documented

from lite6jax.effects import catalogue
from lite6jax.report import ranking
from lite6jax.report.ranking import Files, steps
from lite6jax.report.remedies import OF_POSES, OF_TORQUES, cause_of, remedy_of
from lite6jax.report.words import quantity


def ranked(document):
    return [document["findings"][k] for k in ranking.order(document)]


def words_of(document, *files):
    """The words of each command to copy, without the program's name."""
    return [shlex.split(step.command)[1:] for step in steps(document, Files(*files))]


@pytest.mark.parametrize(
    ("known", "remedies"), [(catalogue.POSE_EFFECTS, OF_POSES), (catalogue.TORQUE_EFFECTS, OF_TORQUES)]
)
def test_every_effect_of_a_catalogue_has_a_remedy(known, remedies):
    assert set(remedies) == set(known)
    for name, remedy in remedies.items():
        cause = remedy.cause.format(place="joint 2", source="joint 1", exerted="torque")
        assert cause[0].islower(), name
        assert not cause.endswith("."), name
        assert remedy.action.endswith("."), name
        assert remedy.action[0].isupper(), name


def test_an_effect_of_ones_own_has_a_general_one():
    entry = {"effect": "cable_drag", "site": "joint3", "parameters": {}}
    assert cause_of(entry) == "joint 3 has cable drag"
    assert "effect of your own" in remedy_of(entry).action


def test_all_links_together_are_the_arm():
    assert cause_of({"effect": "link_thermal_expansion", "site": "links"}) == "the arm grows as it warms"


def test_the_source_of_a_coupling_is_named():
    entry = {"effect": "joint_coupling", "site": "joint3", "parameters": {"source_joint": {"value": 2.0, "std": 0.0}}}
    assert cause_of(entry) == "the motion of joint 2 turns joint 3 as well"


def test_a_payload_is_said_by_its_mass_and_its_centre():
    numbers = {"mass_kg": 0.6197, "x_m": 0.0309, "y_m": 0.0, "z_m": 0.07}
    entry = {"effect": "payload", "site": "payload", "parameters": {k: {"value": v} for k, v in numbers.items()}}
    assert cause_of(entry, torques=True) == "0.62 kg more than declared hang on the flange, at (31, 0, 70) mm"


def test_what_a_finding_moves_is_the_displacement_that_it_alone_causes(found):
    """Of a known geometry nothing is taken up: by the deflected chain itself, without the engine."""
    problem, kept = found.problem, ~found.outliers
    for k, (finding, moves) in enumerate(zip(found.findings, found.moves, strict=True)):
        values = np.zeros_like(found.fit.values)
        values[found.fit.terms.slices[k]] = finding.values
        none, alone = (
            problem.position_errors(found.fit.nuisance, found.fit.terms, v) for v in (np.zeros_like(values), values)
        )
        moved = np.linalg.norm(alone - none, axis=0)[kept]
        assert moves.position == pytest.approx(np.sqrt(np.mean(moved**2)), rel=2e-3)


def test_findings_are_ranked_by_what_they_move(found):
    document = documented(found)
    sizes = [finding["moves_rms_m"] for finding in ranked(document)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > 1.05 * sizes[1]
    bars = ranking.bars(document)
    assert len(bars) == 2
    assert bars[0].share == 1
    assert bars[1].share == pytest.approx(sizes[1] / sizes[0])
    assert float(bars[0].size) == pytest.approx(1e3 * sizes[0], rel=0.05)


def test_the_first_sentence_is_the_cause_and_its_worth(compliant):
    document = documented(compliant)
    moved = 1e3 * document["findings"][0]["moves_rms_m"]
    before, after = (1e3 * document[stage]["heldout_position_rms_m"] for stage in ("before", "after"))
    assert ranking.headline(document) == (
        f"Joint 2 gives way to gravity: {moved:.2g} of {before:.2g} mm; compensated, {after:.3f} mm is left, "
        "the sensor's noise."
    )
    scaled = {**document, "findings": [{**document["findings"][0], "effect": "measurement_scale", "site": "sensor"}]}
    assert ranking.headline(scaled).startswith("The sensor's lengths are off: ")
    assert "; with it in the model, " in ranking.headline(scaled)
    larger = {**document, "findings": [{**document["findings"][0], "moves_rms_m": 1.0}]}
    assert "1000 mm, which others partly cancel" in ranking.headline(larger)


def test_effects_that_only_turn_the_tool_are_ranked_in_degrees(found):
    document = documented(found)
    turning = [
        {**finding, "moves_rms_m": 1e-9, "moves_rms_rad": 1e-3 * k} for k, finding in enumerate(document["findings"], 1)
    ]
    errors = {stage: {**document[stage], "heldout_orientation_rms_rad": 2e-3} for stage in ("before", "after")}
    turned = {**document, "findings": turning, **errors}
    assert ranking.unit_of(turned) == "deg"
    assert ranked(turned)[0] == turning[1]
    assert "0.11 of 0.11 deg" in ranking.headline(turned)


@pytest.mark.parametrize(
    ("verdict", "says"),
    [
        ("consistent", "Nothing is missing from the model: the error of 0.034 mm RMS is the sensor's noise."),
        ("unexplained", "The error of 0.034 mm RMS is not the noise of the poses alone, and nothing explains it."),
        ("undetermined", "The recording is too short to tell what the error of 0.034 mm RMS is."),
    ],
)
def test_without_findings_the_first_sentence_is_the_verdict(verdict, says):
    document = {
        "verdict": verdict, "findings": [], "data_faults": [{"fault": "outliers"}],
        "before": {"heldout_position_rms_m": 3.4e-5}, "after": {"heldout_position_rms_m": 3.4e-5},
        "noise": {"declared_position_m": 2e-5}, "nearest": None,
    }  # fmt: skip
    assert ranking.headline(document) == says
    nearly = {**document, "nearest": {"effect": "joint_scale", "site": "joint1", "p_value": 0.02}}
    open_still = "The error of 0.034 mm RMS is noise, or noise and one more effect, which is nearly significant."
    assert ranking.headline(nearly) == (open_still if verdict == "undetermined" else says)
    faulty = {**document, "data_faults": [{"fault": "swapped_joints"}]}
    assert ranking.headline(faulty).startswith("The data have a fault (swapped joints); with this corrected, ")
    if verdict == "consistent":
        assert ranking.headline({**document, "noise": {"declared_position_m": None}}) == (
            "No effect is significant, and the error of 0.034 mm RMS looks like noise; declare position_noise_m to "
            "test this."
        )
        for computed in ({"pose_source": "controller_fk"}, {"data_faults": [{"fault": "computed_pose"}]}):
            assert ranking.headline({**document, **computed}) == (
                "The poses are the controller's own computation: the arm's table reproduces them to 0.034 mm RMS."
            )


@pytest.mark.parametrize(
    "at", [{"effect": "measurement_scale", "site": "sensor"}, {"effect": "sensor_drift", "site": "sensor"},
           {"effect": "unnamed", "site": "sensor"}, {"effect": "lens", "site": "sensor"},
           {"effect": "time_offset", "site": "clock"}, {"effect": "base_drift", "site": "base"}],
)  # fmt: skip
def test_what_is_no_error_of_the_arm_is_not_compensated(found, at):
    """A finding at the sensor: no sentence and no command says that joint positions compensate it."""
    document = documented(found)
    first, second = document["findings"]
    alone = {**document, "findings": [{**first, **at}]}
    said = [ranking.headline(alone), *(action for _, action in ranking.actions(alone))]
    said += [step.command for step in ranking.steps(alone, Files(Path("run.csv"), Path("d.json")))]
    assert not any("compensat" in line.lower() for line in said)
    assert "compensated" not in ranking.headline({**document, "findings": [{**first, **at}, second]})


def test_of_torques_the_worth_is_that_at_the_joint(motors):
    document = documented(motors)
    main = ranked(document)[0]
    assert main["joints"] == [2]
    before, after = (document[stage]["heldout_torque_rms_by_joint_Nm"][1] for stage in ("before", "after"))
    said = ranking.headline(document)
    assert f" of {before:.2g} Nm; with both findings in the model, {after:.2g}" in said
    assert said.startswith("Joint 2 rubs")


def test_a_compliance_is_a_stiffness_too_and_a_rate_a_drift_per_day():
    soft = quantity("compliance_rad_per_Nm", {"value": 1e-4, "std": 1e-6})
    assert soft.also == "stiffness 10000 ± 100 Nm/rad"
    assert str(soft) == "compliance 100.0 ± 1.0 µrad/Nm (stiffness 10000 ± 100 Nm/rad)"
    assert quantity("compliance_rad_per_Nm", {"value": 1e-6, "std": 1e-6}).also == ""
    assert quantity("vx_m_per_s", {"value": 1e-8, "std": 1e-9}).also == "0.864 ± 0.086 mm a day"
    assert quantity("velocity_rad_per_s", {"value": 0.1, "std": 0.01}).also == ""


def test_each_remedy_is_said_once_with_the_findings_that_it_is_for(motors, found):
    assert [ranks for ranks, _ in ranking.actions(documented(motors))] == [[1, 2]]
    assert sorted(rank for ranks, _ in ranking.actions(documented(found)) for rank in ranks) == [1, 2]


def test_commands_name_the_files_at_hand(found, motors, tmp_path):
    recording, diagnosis, other = tmp_path / "my run.csv", tmp_path / "d.json", tmp_path / "other" / "d.json"
    document = documented(found)
    compensate, view, report = words_of(document, recording, diagnosis)
    assert compensate[:3] == ["compensate", str(diagnosis), str(recording)]
    assert view == ["view", str(diagnosis)]  # it is beside
    assert report[0] == "report"
    assert words_of(document, recording, other)[1][1:] == [str(other), str(recording)]
    assert words_of(document, recording)[0] == ["diagnose", str(recording), "--out", "my run_diagnosis.json"]
    of_torques = words_of(documented(motors), recording, diagnosis)
    assert [line[0] for line in of_torques] == ["predict", "convert", "view", "report"]
    own = {**document, "findings": [{**document["findings"][0], "effect": "cable_drag"}]}
    assert [line[0] for line in words_of(own, recording, diagnosis)] == ["report"]
    mine = tmp_path / "mine.py"
    assert words_of(own, recording, diagnosis, mine)[0][-4:-2] == ["--effects", str(mine)]


def test_commands_on_torques_name_the_effects_of_ones_own(motors, tmp_path):
    recording, diagnosis, mine = (tmp_path / name for name in ("run.csv", "d.json", "mine.py"))
    document = documented(motors)
    own = {**document, "findings": [{**document["findings"][0], "effect": "air_drag"}, *document["findings"][1:]]}
    # without the file of the effect, no command reads the model
    assert [line[0] for line in words_of(own, recording, diagnosis)] == ["report"]
    lines = words_of(own, recording, None, mine)
    assert [line[0] for line in lines] == ["diagnose", "predict", "convert", "view", "report"]
    for line in lines[:4]:
        assert line[line.index("--effects") + 1] == str(mine)
    assert "--effects" not in lines[4]


def test_a_prismatic_joint_has_a_screw_and_no_gear():
    backlash = {"effect": "joint_backlash", "site": "joint3", "parameters": {"gap_m": {"value": 1e-3, "std": 1e-4}}}
    assert cause_of(backlash) == "joint 3 has play in its screw, belt or rack"
    assert "Service the screw, the belt or the guide" in remedy_of(backlash).action
    scale = {"effect": "joint_scale", "site": "joint3", "driver": "slide position of joint 3", "parameters": {}}
    assert cause_of(scale) == "joint 3 moves by another length than its encoder says"
    assert cause_of(scale | {"driver": "position of joint 3"}) == "joint 3 turns by another angle than its encoder says"
