"""The first sentence, the ranking, the remedies and the commands of a diagnosis say what the document holds."""

import re
import shlex
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from diagnosed import documented
from domains.torque import slid
from report.torque_diagnosed import diagnosed as undetected

from lite6jax.arms.arm import Arm
from lite6jax.arms.dynamics import inverse_dynamics, link_parameters
from lite6jax.effects import catalogue
from lite6jax.effects.dynamic import PayloadTorque, ViscousFriction
from lite6jax.recordings import Recording
from lite6jax.report import ranking
from lite6jax.report.diagnosis_figures import drawings
from lite6jax.report.ranking import Files, contribution, headline, steps
from lite6jax.report.remedies import REMEDIES, cause_of, remedy_of
from lite6jax.report.statements import with_statements


def ranked(document):
    return [document["findings"][k] for k in ranking.order(document)]


def words_of(document, *files):
    """The words of each command to copy, without the program's name."""
    return [shlex.split(step.command)[1:] for step in steps(document, Files(*files))]


@pytest.mark.parametrize(
    ("known", "remedies"),
    [(catalogue.POSE_EFFECTS, REMEDIES["poses"]), (catalogue.TORQUE_EFFECTS, REMEDIES["torques"])],
)
def test_every_effect_of_a_catalogue_has_a_remedy(known, remedies):
    assert set(remedies) == set(known)
    for name, remedy in remedies.items():
        cause = remedy.cause.format(place="joint 2", source="joint 1", exerted="torque")
        assert cause[0].islower(), name
        assert not cause.endswith("."), name
        assert remedy.action.endswith("."), name
        assert remedy.action[0].isupper(), name


def test_a_payload_is_said_by_its_mass_and_its_centre():
    numbers = {"mass_kg": 0.6197, "x_m": 0.0309, "y_m": 0.0, "z_m": 0.07}
    entry = {"effect": "payload", "site": "payload", "parameters": {k: {"value": v} for k, v in numbers.items()}}
    assert cause_of(entry | {"domain": "torques"}) == "0.62 kg more than declared hang on the flange, at (31, 0, 70) mm"


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
        assert moves["moves_rms_m"] == pytest.approx(np.sqrt(np.mean(moved**2)), rel=2e-3)


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
        "domain": "poses", "model": {"effects": []}, "source": "unknown",
        "verdict": verdict, "findings": [], "data_faults": [{"fault": "outliers"}],
        "before": {"heldout_position_rms_m": 3.4e-5}, "after": {"heldout_position_rms_m": 3.4e-5},
        "noise": {"declared": {"position_m": 2e-5}}, "nearest": None, "left": {"over_noise": {"position": 1.0}},
    }  # fmt: skip
    assert ranking.headline(document) == says
    nearly = {**document, "nearest": {"effect": "joint_scale", "site": "joint1", "p_value": 0.02}}
    open_still = "The error of 0.034 mm RMS is noise, or noise and one more effect, which is nearly significant."
    assert ranking.headline(nearly) == (open_still if verdict == "undetermined" else says)
    faulty = {**document, "data_faults": [{"fault": "swapped_joints"}]}
    assert ranking.headline(faulty).startswith("The data have a fault (swapped joints); with this corrected, ")
    if verdict == "consistent":
        assert ranking.headline({**document, "noise": {"declared": {"position_m": None}}}) == (
            "No effect is significant, and the error of 0.034 mm RMS looks like noise; declare position_noise_m to "
            "test this."
        )
        for computed in ({"source": "controller_fk"}, {"data_faults": [{"fault": "computed_pose"}]}):
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
    assert said.startswith("Joint 2 has friction")


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


def test_a_prismatic_joint_has_a_screw_and_no_gear():
    at = {"domain": "poses", "site": "joint3"}
    backlash = {**at, "effect": "joint_backlash", "parameters": {"gap_m": {"value": 1e-3, "std": 1e-4}}}
    assert cause_of(backlash) == "joint 3 has play in its screw, belt or rack"
    assert "Service the screw, the belt or the guide" in remedy_of(backlash).action
    scale = {**at, "effect": "joint_scale", "driver": "slide position of joint 3", "parameters": {}}
    assert cause_of(scale) == "joint 3 moves by another length than its encoder says"
    assert cause_of(scale | {"driver": "position of joint 3"}) == "joint 3 turns by another angle than its encoder says"


# ------------------------------------------------------------------ forces of prismatic joints


def test_an_arm_of_slides_alone_is_said_in_newtons():
    arm = Arm(
        "gantry",
        np.array([[0, 0, 0.5, 0, slid.HALF, 0], [0, 0, 0, -slid.HALF, 0, 0], [0, 0, 0, 0, slid.HALF, 0]]),
        joint_limits=np.tile([-1.0, 1.0], (3, 1)),
        mass=np.array([5.0, 3.0, 2.0]),
        center_of_mass=np.zeros((3, 3)),
        inertia=np.tile(1e-3 * np.eye(3), (3, 1, 1)),
        sliding=(0, 1, 2),
    )
    t, q, dq, ddq = slid.moved()
    rng = np.random.default_rng(0)
    forces = np.array(inverse_dynamics(arm.kinematics, link_parameters(arm), q.T, dq.T, ddq.T, slid.GRAVITY, (0, 1, 2)))
    forces[1] += 30 * dq[:, 1]
    recording = Recording.from_arrays(
        q, time=t, joint_velocity=dq, joint_torque=(forces + rng.normal(0, 0.2, forces.shape)).T, sliding=(0, 1, 2),
        motion="trajectory", torque_noise_Nm=(0.2, 0.2, 0.2), torque_source="measured",
    )  # fmt: skip
    found = undetected(recording, (ViscousFriction(2, of_slide=True),), arm=arm)
    document = with_statements(found.to_dict())
    assert not [key for key in document["before"] if key.endswith("_Nm") and "by_joint" not in key]
    assert re.match(
        r"Joint 2 has friction that grows with its speed: \d+ of \d+ N; with it in the model,", headline(document)
    )
    assert re.search(r"held-out torque errors of the joints are [\d., e-]+ N RMS with these effects", found.summary())
    figures = dict(drawings(found, "gantry"))
    assert "(N RMS)" in figures["error_by_joint"].axes[0].get_ylabel()
    assert figures["friction"].axes[1].get_xlabel() == "velocity of joint 2 (mm/s)"
    assert figures["friction"].axes[1].get_ylabel() == "force left at joint 2 (N)"
    assert figures["findings"].axes[0].get_ylabel() == "force at joint 2 (N)"
    assert figures["findings"].axes[0].get_xlabel() == "slide velocity of joint 2 (mm/s)"
    for figure in figures.values():
        plt.close(figure)


def test_what_moves_both_kinds_is_said_in_both_units():
    found = undetected(
        slid.recorded(slid.friction), (PayloadTorque(), ViscousFriction(3, of_slide=True)), arm=slid.arm()
    )
    document = with_statements(found.to_dict())
    payload, friction = ranking.detailed(document)
    assert {"moves_rms_Nm", "moves_rms_N"} <= set(payload)
    assert re.search(r"contributes \S+ Nm RMS to the torque and \S+ N RMS to the force\.", payload["statement"])
    assert " Nm and " in contribution(document, payload)
    assert contribution(document, friction).endswith(" N")
    assert "check the lubrication of the screw, the belt or the guide" in remedy_of(friction).action
