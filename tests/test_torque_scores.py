"""The scores of torque trials: an oracle that has seen the truth passes, one that says nothing or lies does not."""

import json
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from torque_answers import a_document, a_finding, nothing_said, the_oracle, the_prediction, wrongly_named

from benchmarks import __main__ as harness
from benchmarks.campaigns import tables
from benchmarks.campaigns.campaign import given_in, opened, sealed_in
from benchmarks.campaigns.columns import csv_text
from benchmarks.ending import DONE, UNUSABLE
from benchmarks.torque_trials import command, plans, report, scores, trials
from benchmarks.torque_trials.campaign import SCHEMA, TORQUES

CONTACT = next(
    i for i in plans.indices(4, 30, "faulty") if plans.draw_plan(4, i, np.random.default_rng(0)).fault == "contact"
)


@pytest.fixture(scope="module")
def truths():
    """Of two trials of each kind, and of a contact."""
    return [trials.draw(4, i).truth for i in [*(i for kind in plans.KINDS for i in plans.indices(4, 2, kind)), CONTACT]]


def rows_of(truths, answer, off=0.0):
    rng = np.random.default_rng(0)
    return [scores.scored(t, answer(t, rng), the_prediction(t, off), 1.0, "") | {"sha256": "0" * 64} for t in truths]


def met(rows):
    return {goal.asked.partition(":")[0]: goal.met for goal in scores.goals(rows)}


def a_truth(*hidden, kind="single", **more):
    base = {"seed": 0, "index": 0, "kind": kind, "engine": "plain", "arm": "lite6", "inertial": "declared"}
    base |= {"source": "torque", "noise": "white", "edge": "", "fault": "", "sealed": False, "rows": 1000}
    base |= {
        "sizes": [2.0] if hidden else [],
        "hidden": list(hidden),
        "fault_rows": [],
        "fault_joints": [],
        "fault_numbers": {},
    }
    base |= {"unseen_bound_Nm": 0.01}
    return base | {"unseen_torque_Nm": [[1.0, 2.0], [3.0, 4.0]]} | more


def a_hidden(name, site, parameters, **more):
    rest = {"fixed": {}, "bound": dict.fromkeys(parameters, 0.1), "size": 4.0, "seen": 1.0, "moved_Nm": 0.1}
    return {"effect": name, "site": site, "parameters": parameters, "rival": None} | rest | more


def judged(truth, *findings, **more):
    return scores.scored(truth, a_document(list(findings), **more), the_prediction(truth), 1.0, "")


FRICTION = a_hidden("coulomb_friction", "joint3", {"coulomb_Nm": 0.5})
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
        assert row["honest"] is True
        assert row["unseen_Nm"] == pytest.approx(0, abs=1e-12)
        nameless = any(effect.get("nameless") for effect in truth["hidden"])
        assert row["exact"] == (not nameless)
        assert row["fault_found"] == bool(truth["fault"]) or truth["fault"] == "torque_unit"  # which is refused
    assert scores.covered(rows).value > 0.5


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
    assert all(goal.met is None for goal in scores.goals([]))


def test_false_alarms_need_many_clean_trials():
    clean = [a_truth(kind="clean") for _ in range(400)]
    assert met(rows_of(clean, nothing_said))["false alarms, upper end of the interval"] is True
    assert met(rows_of(clean[:40], nothing_said))["false alarms, upper end of the interval"] is False
    assert met(rows_of(clean, wrongly_named))["false alarms, upper end of the interval"] is False


def test_intervals_that_are_too_narrow_are_seen():
    rng = np.random.default_rng(1)
    rows = []
    for factor in (1.0, 0.3):
        said = []
        for _ in range(600):
            parameters = {"coulomb_Nm": {"value": 0.5 + 0.1 * rng.normal(), "std": 0.1 * factor}}
            said.append(judged(a_truth(FRICTION), a_finding("coulomb_friction", "joint3", parameters)))
        rows.append(scores.covered(said).value)
    assert rows[0] == pytest.approx(0.95, abs=0.03)
    assert rows[1] < 0.6


def test_a_name_is_right_by_site_order_and_source():
    ripple = a_hidden("torque_ripple", "joint1", {"order": 8.0, "amplitude_Nm": 0.1, "phase_rad": 3.1})
    numbers = {"order": {"value": 8.1, "std": 0.1}, "phase_rad": {"value": -3.1, "std": 0.1}}
    row = judged(a_truth(ripple), a_finding("torque_ripple", "joint1", numbers))
    assert row["exact"]
    offs = {number["name"]: number["off"] for number in row["hidden"][0]["numbers"]}
    assert offs["phase_rad"] == pytest.approx(2 * np.pi - 6.2)  # a phase goes round
    other = a_finding("torque_ripple", "joint1", numbers | {"order": {"value": 9.0, "std": 0.1}})
    assert judged(a_truth(ripple), other)["wrong_name"]
    pair = a_hidden("coupled_friction", "joint6", {"coulomb_Nm": 0.1, "source_joint": 5.0})
    for source, right in ((5.0, True), (4.0, False)):
        said = {"coulomb_Nm": {"value": 0.1, "std": 0.1}, "source_joint": {"value": source, "std": 0.0}}
        assert judged(a_truth(pair), a_finding("coupled_friction", "joint6", said))["exact"] is right


def test_a_finding_admits_what_it_says_it_cannot_be_told_from():
    said = a_finding("viscous_friction", "joint3")
    assert judged(a_truth(FRICTION), said)["wrong_name"]
    admitted = said | {"confusable_with": [{"effect": "coulomb_friction", "site": "joint3", "log_likelihood_gap": 1.0}]}
    row = judged(a_truth(FRICTION), admitted)
    assert (row["found"], row["top_in_set"], row["exact"], row["wrong_name"]) == (True, True, False, False)


def test_outside_a_curve_is_right_and_a_name_only_beside_it():
    truth = a_truth(ZONE, kind="outside")
    curve = a_finding("unnamed", "joint2", driver="position of joint 2 and direction of motion of joint 2")
    straight = a_finding("coulomb_friction", "joint2", {"coulomb_Nm": {"value": 0.3, "std": 0.1}})
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
        row = judged(truth, faults=[{"fault": "contact", "rows": list(rows)}])
        assert row["fault_found"] is right
    assert not judged(truth, faults=[{"fault": "outliers", "rows": list(range(100, 200))}])["fault_found"]


def test_a_wrong_column_is_found_by_its_joints():
    truth = a_truth(kind="faulty", fault="swapped_torques", fault_joints=[2, 3])
    for joints, right in (([3, 2], True), ([2, 4], False), ([2], False)):
        row = judged(truth, faults=[{"fault": "swapped_torques", "rows": [], "numbers": {"joints": joints}}])
        assert row["fault_found"] is right
    assert not judged(truth, faults=[{"fault": "reversed_torque", "rows": [], "numbers": {"joints": [2, 3]}}])[
        "fault_found"
    ]


@pytest.mark.parametrize(
    ("fault", "numbers", "said", "right"),
    [
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
    assert scores.scored(unit, None, None, 1.0, "InputError: they are in another unit")["fault_found"]
    assert not scores.scored(unit, None, None, 1.0, "InputError: no times")["fault_found"]
    for mass, absurd in ((0.2, False), (13.0, True)):
        heavy = a_finding("link_mass", "link3", {"mass_kg": {"value": mass, "std": 0.1}})
        assert judged(a_truth(kind="clean"), heavy)["absurd"] is absurd


def test_a_trial_without_an_answer_counts_as_wrong():
    row = scores.scored(a_truth(FRICTION), None, None, 2.0, "InputError: no")
    assert (row["exact"], row["found"], row["unseen_Nm"], row["honest"]) == (False, False, None, None)
    assert met([row])["single effects at twice the threshold, found"] is False


def test_predictions_of_the_wrong_shape_or_with_gaps_are_none():
    truth = a_truth(FRICTION)
    for said in (
        {"tau1_Nm": [1.0, 3.0]},
        {"tau1_Nm": [1.0], "tau2_Nm": [2.0]},
        {"tau1_Nm": [np.nan] * 2, "tau2_Nm": [2.0, 4.0]},
    ):
        assert scores.scored(truth, a_document([]), said, 1.0, "")["unseen_Nm"] is None
    assert scores.scored(truth, a_document([]), the_prediction(truth, 0.02), 1.0, "")["unseen_Nm"] == pytest.approx(
        0.02
    )


def test_held_out_errors_are_to_fall_where_something_is_hidden_and_to_stay_where_not():
    assert judged(a_truth(FRICTION), after=0.9)["honest"]
    assert not judged(a_truth(FRICTION), after=1.0)["honest"]
    assert judged(a_truth(kind="clean"), after=1.04)["honest"]
    assert not judged(a_truth(kind="clean"), after=0.9)["honest"]


def test_tables_and_stories_are_told_of_every_kind(truths):
    rows = rows_of(truths, the_oracle)
    titles = [title for title, *_ in report.sections(rows)]
    assert titles == [
        *("Goals", "Nothing hidden", "One effect hidden, by size", "One effect hidden, twice the threshold or more"),
        *(
            "Several hidden",
            "Outside the catalogue",
            "Something wrong",
            "Numbers, from four thresholds on",
            "Unseen motion",
        ),
        "The run",
    ]
    assert "| false alarms, upper end of the interval: 1 % |" in tables.markdown(report.sections(rows))
    for truth, row in zip(truths, rows, strict=True):
        told = "\n".join(report.story(truth, row))
        assert told.startswith(truth["kind"].capitalize())
        assert all(effect["effect"] in told for effect in truth["hidden"])


def test_results_keep_their_types_and_are_read_again(truths, tmp_path):
    rows = rows_of(truths, the_oracle)
    assert set(rows[0]) == set(SCHEMA.names)
    TORQUES.write_rows(rows, tmp_path / "a.parquet")
    again = TORQUES.read_rows(tmp_path / "a.parquet")
    assert sorted(again, key=lambda row: row["index"]) == sorted(rows, key=lambda row: row["index"])


def silent(given):
    (given / "diagnosis.json").write_text(json.dumps(nothing_said(None, None)))
    (given / "predicted.csv").write_text(csv_text({"tau1_Nm": [0.0]}))


def test_a_campaign_seals_first_and_goes_on_where_it_stopped(tmp_path):
    out = tmp_path / "a.parquet"
    wanted = plans.indices(4, 2, "clean")
    rows = replace(TORQUES, answer=silent).run(4, wanted, out, 0, lambda _: None, lambda *_: None)
    assert [row["index"] for row in rows] == wanted
    assert not any(row["detected"] or row["error"] for row in rows)
    assert subprocess.run(["sha256sum", "-c", "a.sha256"], cwd=tmp_path, capture_output=True).returncode == 0
    again = replace(TORQUES, answer=lambda given: pytest.fail("was done before"))
    assert again.run(4, wanted, out, 0, lambda _: None, lambda *_: None) == rows


def test_the_diagnosis_is_given_no_truth_and_a_touched_one_is_not_opened(tmp_path):
    index = plans.indices(4, 1, "single")[0]
    digest = TORQUES.seal(4, index, tmp_path)
    given = {path.name for path in given_in(tmp_path, index).iterdir()}
    assert given == {"arm.yaml", "recording.csv", "recording.yaml", "unseen.csv"}
    assert opened(tmp_path, index, digest)["index"] == index
    sealed = sealed_in(tmp_path, index)
    sealed.write_text(sealed.read_text().replace("joint", "link", 1))
    with pytest.raises(ValueError, match="is not what was sealed"):
        opened(tmp_path, index, digest)


def test_trials_are_exported_with_their_truth(tmp_path, capsys):
    arguments = ["torque", "--seed", "4", "--trial", str(CONTACT), "--export", str(tmp_path)]
    assert harness.main(arguments) == DONE
    (case,) = tmp_path.iterdir()
    assert str(case.name) in capsys.readouterr().out.replace("\n", "")
    truth = json.loads((case / "truth.json").read_text())
    (touched,) = truth["effects"]
    span = touched["args"]
    times = [float(line.split(",")[0]) for line in (case / "recording.csv").read_text().splitlines()[1:]]
    assert [k for k, t in enumerate(times) if span["start"] < t < span["stop"]] == truth["fault_rows"]


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--trial", "1", "--out", "a.parquet"], "leave --kind and --out out"),
        (["--out", "a.csv"], "end its name in .parquet"),
        (["--trials", "0"], "invalid whole number from 1"),
        (["--kind", "dirty"], "invalid choice"),
        (["--figures", "here"], "unrecognized arguments"),
    ],
)
def test_arguments_that_cannot_be_used_are_said(arguments, why, capsys):
    with pytest.raises(SystemExit, match="2"):
        command.main(arguments)
    assert why in capsys.readouterr().err


def test_a_file_of_another_seed_is_not_overwritten(tmp_path, capsys):
    out = tmp_path / "a.parquet"
    TORQUES.write_rows(rows_of([a_truth(FRICTION)], the_oracle), out)
    assert command.main(["--seed", "7", "--trials", "1", "--out", str(out)]) == UNUSABLE
    assert "has trials of another seed" in capsys.readouterr().err
