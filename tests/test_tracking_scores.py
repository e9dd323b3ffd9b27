"""The scores of logs of commands: an oracle that has seen the truth passes, one that says nothing or lies does not."""

import numpy as np
import pytest
from trial_answers import COMMON, a_diagnosis, a_finding, a_hidden

from benchmarks.campaigns.judgement import covered
from benchmarks.campaigns.report import markdown, sections
from benchmarks.tracking_trials.campaign import TRACKING, score

TRACKING_TRUTH = COMMON | {
    "arm": "serial3",
    "servo": "declared",
    "noise": "white",
    "edge": "",
    "sealed": False,
    "rows": 800,
    "sizes": [10.0],
    "fault_rows": [],
    "fault_joints": [],
    "noise_rad": 1e-4,
    "commanded_rms_rad": 0.03,
    "unseen_limit_rad": 2e-4,
    "unseen_readout_rad": [[0.1, 0.2], [0.3, 0.4]],
}


def a_tracking_hidden(name, site, parameters, size=10.0, moved=1e-3, **more):
    return a_hidden(name, site, parameters, size=size, moved_rad=moved, **more)


FRICTION = a_tracking_hidden("coulomb_friction", "joint2", {"coulomb_Nm": 0.5}, bound={"coulomb_Nm": 0.01})
ZONE = a_tracking_hidden(
    *("sticky_zone", "joint2", {"size": 0.8}),
    drivers=[["position of joint 2"], ["direction of motion of joint 2"]],
    beside=["coulomb_friction"],
    nameless=False,
)


def a_truth(*hidden, kind="single", **more):
    return TRACKING_TRUTH | {"kind": kind, "sizes": [10.0] if hidden else [], "hidden": list(hidden)} | more


def said(*findings, faults=(), before=1e-3, after=1e-4, verdict=None):
    errors = {"before": {"heldout_rollout_rms_rad": before}, "after": {"heldout_rollout_rms_rad": after}}
    answer = a_diagnosis(*findings, faults=faults) | errors
    return answer if verdict is None else answer | {"verdict": verdict}


def the_prediction(truth, off=0.0):
    q = np.array(truth["unseen_readout_rad"]) + off
    return {f"q{i + 1}_rad": column.tolist() for i, column in enumerate(q.T)}


def judged(truth, *findings, off=0.0, **more):
    return score(truth, said(*findings, **more), the_prediction(truth, off), 1.0, "")


def friction(value=0.5, std=0.01):
    return a_finding("coulomb_friction", "joint2", coulomb_Nm=value, std=std)


def met(rows):
    return {goal.asked.partition(":")[0]: goal.met for goal in TRACKING.goals(rows)}


def test_what_is_hidden_is_found_with_its_numbers():
    row = judged(a_truth(FRICTION), friction(0.51))
    assert (row["exact"], row["statement"], row["value"], row["honest"]) == (True, "right", True, True)
    assert row["unseen_rad"] == pytest.approx(0.0, abs=1e-12)
    assert row["hidden"][0]["numbers"][0]["off"] == pytest.approx(0.01)


@pytest.mark.parametrize(("value", "std", "right"), [(0.52, 1e-4, True), (0.6, 0.03, True), (0.6, 1e-3, False)])
def test_a_number_is_right_within_a_share_or_its_deviations(value, std, right):
    assert judged(a_truth(FRICTION), friction(value, std))["value"] is right


def test_deviations_beyond_a_third_of_a_number_excuse_nothing():
    assert judged(a_truth(FRICTION), friction(0.7, 1.0))["value"] is False


def test_phases_are_compared_on_the_circle():
    wave = a_tracking_hidden("encoder_eccentricity", "joint2", {"amplitude_rad": 1e-3, "phase_rad": 3.1})
    for phase, right in ((-3.1, True), (2.0, False)):
        named = a_finding("encoder_eccentricity", "joint2", amplitude_rad=1e-3, phase_rad=phase, std=0.0)
        assert judged(a_truth(wave), named)["value"] is right


def test_a_false_finding_misleads_and_so_does_a_verdict_that_nothing_is_left():
    other = a_finding("encoder_offset", "joint1", offset_rad=1e-3)
    row = judged(a_truth(FRICTION), friction(), other)
    assert (row["statement"], row["false"]) == ("misleading", ["encoder_offset@joint1"])
    assert judged(a_truth(kind="clean"), other)["statement"] == "misleading"
    assert judged(a_truth(FRICTION), verdict="consistent")["statement"] == "misleading"
    assert judged(a_truth(FRICTION), verdict="unexplained")["statement"] == "partial"
    small = a_tracking_hidden("coulomb_friction", "joint2", {"coulomb_Nm": 1e-3}, size=1.0, moved=1e-5)
    assert judged(a_truth(small), verdict="consistent")["statement"] == "right"


def test_the_truth_among_what_is_said_to_be_inseparable_is_in_the_set():
    alike = a_finding("backlash", "joint2", rivals=[("coulomb_friction", "joint2", 1.0)], half_width_rad=1e-3)
    row = judged(a_truth(FRICTION), alike)
    assert (row["exact"], row["top_in_set"], row["statement"]) == (False, True, "right")


def test_outside_a_curve_is_right_and_a_name_only_beside_it():
    truth = a_truth(ZONE, kind="outside")
    curve = a_finding("unnamed", "joint2", driver="position of joint 2")
    assert judged(truth, curve)["hidden"][0]["named"]
    assert judged(truth, curve, friction())["false"] == []
    assert judged(truth, friction())["statement"] == "misleading"


def test_errors_fall_or_stay():
    clean = a_truth(kind="clean")
    assert judged(clean, before=1e-4, after=1.01e-4)["honest"] is True
    assert judged(clean, before=1e-4, after=0.5e-4)["honest"] is False
    assert judged(a_truth(FRICTION), friction(), before=1e-3, after=1.1e-3)["honest"] is False


@pytest.mark.parametrize(
    ("fault", "answer", "error", "right"),
    [
        ("joints_swapped", {"fault": "joints_swapped", "numbers": {"joints": [1, 2]}}, "", True),
        ("joints_swapped", {"fault": "joints_swapped", "numbers": {"joints": [1, 3]}}, "", False),
        ("joint_sign", {"fault": "joint_sign", "joints": ["joint1", "joint2"]}, "", True),
        ("stale_rows", {"fault": "stale_rows", "rows": [4]}, "", True),
        ("stale_rows", {"fault": "outliers", "rows": [4]}, "", False),
        ("gear", None, "InputError: give both in the same unit, after the same gear", True),
        ("torque_off", None, "InputError: its torque may be off", True),
        ("torque_off", None, "InputError: no times", False),
    ],
)
def test_a_fault_is_said_with_its_joints_or_the_log_is_refused_for_it(fault, answer, error, right):
    truth = a_truth(kind="faulty", fault=fault, fault_joints=[1, 2])
    diagnosis = None if answer is None else said(faults=[answer])
    row = score(truth, diagnosis, None, 1.0, error)
    assert row["fault_found"] is right
    wrong = "misleading" if diagnosis is None else "partial"
    assert row["statement"] == ("right" if right else wrong)


def test_commands_of_another_clock_are_an_offset_of_the_clock():
    truth = a_truth(kind="faulty", fault="other_clock")
    assert judged(truth, a_finding("time_offset", "clock", offset_s=-0.2))["fault_found"]
    assert not judged(truth)["fault_found"]


def test_a_trial_without_an_answer_counts_as_wrong():
    row = score(a_truth(FRICTION), None, None, 2.0, "InputError: no")
    assert (row["exact"], row["found"], row["unseen_rad"], row["statement"]) == (False, False, None, "misleading")


def test_predictions_of_the_wrong_shape_or_with_gaps_are_none():
    truth = a_truth(FRICTION)
    for columns in (
        {"q1_rad": [1.0, 3.0]},
        {"q1_rad": [1.0], "q2_rad": [2.0]},
        {"q1_rad": [np.nan] * 2, "q2_rad": [2.0, 4.0]},
    ):
        assert score(truth, said(), columns, 1.0, "")["unseen_rad"] is None
    assert judged(truth, off=0.02)["unseen_rad"] == pytest.approx(0.02)


def test_goals_tell_an_oracle_from_silence_and_lies():
    truth = a_truth(FRICTION)
    lie = a_finding("rotor_inertia", "joint1", inertia_kg_m2=0.1)
    answers = {"oracle": [friction()], "silence": [], "lie": [lie]}
    goals = {name: met([judged(truth, *findings)] * 40) for name, findings in answers.items()}
    for name, right in (("oracle", True), ("silence", False), ("lie", False)):
        assert goals[name]["single effects from 10 thresholds on, found"] is right
        assert goals[name]["— right site and name, or within the set said inseparable"] is right
        assert goals[name]["unseen rollouts within their limit"] is True
        assert goals[name]["misleading, of all"] is right
    far = met([judged(truth, friction(), off=0.01)])
    assert far["unseen rollouts within their limit"] is False
    assert all(goal.met is None for goal in TRACKING.goals([]))


def test_intervals_that_are_too_narrow_are_seen():
    rng = np.random.default_rng(1)
    offs = 0.5 + 0.01 * rng.normal(size=600)
    for std, least, most in ((0.01, 0.92, 0.98), (0.003, 0.0, 0.6)):
        rows = [judged(a_truth(FRICTION), friction(off, std)) for off in offs]
        assert least <= covered(rows, TRACKING.known).value <= most


def test_results_are_kept_and_told_in_tables(tmp_path):
    truths = [a_truth(FRICTION), a_truth(kind="clean"), a_truth(ZONE, kind="outside")]
    truths += [a_truth(FRICTION, FRICTION, kind="mixture"), a_truth(kind="faulty", fault="gear")]
    rows = [judged(truth | {"index": k}, friction()) | {"sha256": "0" * 64} for k, truth in enumerate(truths)]
    TRACKING.write_rows(rows, tmp_path / "a.parquet")
    assert TRACKING.read_rows(tmp_path / "a.parquet") == rows
    shown = list(sections(TRACKING, rows))
    assert {title for title, *_ in shown} >= {"Goals", "Nothing hidden", "Unseen motion and statements", "The run"}
    assert "| misleading, of all: 2 % |" in markdown(shown)
