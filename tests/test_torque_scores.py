"""The scores of torque trials: an oracle that has seen the truth passes, one that says nothing or lies does not."""

import itertools

import numpy as np
import pytest
from trial_answers import (
    CONTACT,
    TORQUE_TRUTH,
    a_diagnosis,
    a_finding,
    a_hidden,
    nothing_said,
    the_oracle,
    the_prediction,
    wrongly_named,
)

from benchmarks.campaigns.judgement import covered
from benchmarks.campaigns.rounds import KINDS
from benchmarks.torque_trials import plans, trials
from benchmarks.torque_trials.campaign import TORQUES, score


@pytest.fixture(scope="module")
def truths():
    """Of a trial or two of each kind, and of a contact."""
    of_kind = [plans.ROUNDS.indices(4, 2 if kind in ("single", "mixture") else 1, kind) for kind in KINDS]
    return [trials.draw(4, i).truth for i in (*itertools.chain(*of_kind), CONTACT)]


def rows_of(truths, answer, off=0.0):
    rng = np.random.default_rng(0)
    return [score(t, answer(t, rng), the_prediction(t, off), 1.0, "") | {"sha256": "0" * 64} for t in truths]


def met(rows):
    return {goal.asked.partition(":")[0]: goal.met for goal in TORQUES.goals(rows)}


def a_truth(*hidden, kind="single", **more):
    return TORQUE_TRUTH | {"kind": kind, "sizes": [2.0] if hidden else [], "hidden": list(hidden)} | more


def judged(truth, *findings, faults=()):
    return score(truth, a_diagnosis(*findings, faults=faults), the_prediction(truth), 1.0, "")


FRICTION = a_hidden("coulomb_friction", "joint3", {"coulomb_Nm": 0.5}, bound={"coulomb_Nm": 0.1}, size=4.0)
ZONE = a_hidden(
    *("sticky_zone", "joint2", {"size": 0.8}),
    drivers=[["position of joint 2"], ["direction of motion of joint 2"]],
    beside=["coulomb_friction"],
    nameless=False,
)


@pytest.mark.long
def test_an_oracle_is_right_in_every_trial(truths):
    rows = rows_of(truths, the_oracle)
    for row, truth in zip(rows, truths, strict=True):
        assert not row["false"]
        assert not row["wrong_name"]
        assert row["unseen_Nm"] == pytest.approx(0, abs=1e-12)
        nameless = any(effect.get("nameless") for effect in truth["hidden"])
        assert row["exact"] == (not nameless)
        assert row["fault_found"] == bool(truth["fault"]) or truth["fault"] == "torque_unit"  # which is refused
    assert covered(rows, TORQUES.known).value > 0.5


@pytest.mark.long
def test_goals_tell_an_oracle_from_silence_and_lies(truths):
    right, silent, lying = (met(rows_of(truths, answer)) for answer in (the_oracle, nothing_said, wrongly_named))
    assert right["unseen torques within their bound"] is True
    assert right["wrong names outside the catalogue"] is True
    assert right["contacts found, with their rows"] is True
    assert silent["wrong names outside the catalogue"] is True
    assert silent["contacts found, with their rows"] is False
    assert lying["wrong names outside the catalogue"] is False
    assert lying["false alarms, upper end of the interval"] is False
    far = met(rows_of(truths, the_oracle, off=10.0))
    assert far["unseen torques within their bound"] is False


def test_goals_of_detection_are_met_by_an_oracle_only():
    truth = a_truth(FRICTION)
    for answer, wanted in ((the_oracle, True), (nothing_said, False), (wrongly_named, False)):
        found = met(rows_of([truth] * 40, answer))
        assert found["single effects at twice the threshold, found"] is wanted
        assert found["— right site and name, or within the set said inseparable"] is wanted
    assert all(goal.met is None for goal in TORQUES.goals([]))


def test_false_alarms_need_many_clean_trials():
    clean = [a_truth(kind="clean") for _ in range(400)]
    assert met(rows_of(clean, nothing_said))["false alarms, upper end of the interval"] is True
    assert met(rows_of(clean[:40], nothing_said))["false alarms, upper end of the interval"] is False
    assert met(rows_of(clean, wrongly_named))["false alarms, upper end of the interval"] is False


def test_intervals_that_are_too_narrow_are_seen():
    rng = np.random.default_rng(1)
    rows = []
    for std in (0.1, 0.03):
        offs = 0.5 + 0.1 * rng.normal(size=600)
        said = [a_finding("coulomb_friction", "joint3", coulomb_Nm=off, std=std) for off in offs]
        rows.append(covered([judged(a_truth(FRICTION), each) for each in said], TORQUES.known).value)
    assert rows[0] == pytest.approx(0.95, abs=0.03)
    assert rows[1] < 0.6


def test_outside_a_curve_is_right_and_a_name_only_beside_it():
    truth = a_truth(ZONE, kind="outside")
    curve = a_finding("unnamed", "joint2", driver="position of joint 2 and direction of motion of joint 2")
    straight = a_finding("coulomb_friction", "joint2", coulomb_Nm=0.3)
    row = judged(truth, curve)
    assert (row["exact"], row["hidden"][0]["named"], row["wrong_name"]) == (True, True, False)
    assert not judged(truth, curve, straight)["wrong_name"]
    assert judged(truth, straight)["wrong_name"]
    elsewhere = judged(truth, a_finding("unnamed", "joint3", driver="position of joint 3"))
    assert elsewhere["false"] == ["unnamed@joint3"]
    assert not elsewhere["wrong_name"]  # it names nothing
    assert not elsewhere["hidden"][0]["named"]


def test_a_contact_is_found_by_half_its_rows_at_least():
    truth = a_truth(kind="faulty", fault="contact", fault_rows=list(range(100, 200)))
    for rows, right in ((range(110, 205), True), (range(100, 140), False), (range(1000), False)):
        assert judged(truth, faults=[{"fault": "contact", "rows": list(rows)}])["fault_found"] is right
    assert not judged(truth, faults=[{"fault": "outliers", "rows": list(range(100, 200))}])["fault_found"]


@pytest.mark.parametrize(
    ("fault", "numbers", "said", "right"),
    [
        ("swapped_torques", {}, {"joints": [2]}, True),
        ("swapped_torques", {}, {"joints": [2, 4]}, False),
        ("joint_zero", {"added_rad": -3.1}, {"joint": 2, "added_rad": 3.15}, True),
        ("joint_zero", {"added_rad": 0.5}, {"joint": 2, "added_rad": 0.7}, False),
        ("joint_zero", {"added_rad": 0.5}, {"joint": 3, "added_rad": 0.5}, False),
        ("wrong_torque_constant", {"factors": [4.0]}, {"joints": [2], "factors": [3.8]}, True),
        ("wrong_torque_constant", {"factors": [4.0]}, {"joints": [2], "factors": [2.0]}, False),
    ],
)
def test_a_fault_is_said_with_its_size_or_among_its_like(fault, numbers, said, right):
    truth = a_truth(kind="faulty", fault=fault, fault_joints=[2], fault_numbers=numbers)
    alone = {"fault": fault, "rows": [], "numbers": said}
    listed = {"fault": "undecided_torques", "rows": [], "numbers": {"alternatives": [[{"fault": fault} | said]]}}
    for given in (alone, listed):
        assert judged(truth, faults=[given])["fault_found"] is right


def test_another_unit_is_refused_and_a_heavy_link_is_absurd():
    unit = a_truth(kind="faulty", fault="torque_unit", fault_joints=[1, 2], fault_numbers={"factors": [1e3, 1e3]})
    assert score(unit, None, None, 1.0, "InputError: they are in another unit")["fault_found"]
    assert not score(unit, None, None, 1.0, "InputError: no times")["fault_found"]
    for mass, absurd in ((0.2, False), (13.0, True)):
        heavy = a_finding("link_mass", "link3", mass_kg=mass)
        assert judged(a_truth(kind="clean"), heavy)["absurd"] is absurd


def test_a_trial_without_an_answer_counts_as_wrong():
    row = score(a_truth(FRICTION), None, None, 2.0, "InputError: no")
    assert (row["exact"], row["found"], row["unseen_Nm"]) == (False, False, None)
    assert met([row])["single effects at twice the threshold, found"] is False


def test_predictions_of_the_wrong_shape_or_with_gaps_are_none():
    truth = a_truth(FRICTION)
    for said in (
        {"tau1_Nm": [1.0, 3.0]},
        {"tau1_Nm": [1.0], "tau2_Nm": [2.0]},
        {"tau1_Nm": [np.nan] * 2, "tau2_Nm": [2.0, 4.0]},
    ):
        assert score(truth, a_diagnosis(), said, 1.0, "")["unseen_Nm"] is None
    assert score(truth, a_diagnosis(), the_prediction(truth, 0.02), 1.0, "")["unseen_Nm"] == pytest.approx(0.02)
