"""Campaigns of poses and torques: sealed first, opened last, kept as they come, told in tables and stories."""

import ast
import hashlib
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from trial_answers import (
    CONTACT,
    TRUTH,
    WAVE,
    a_finding,
    a_hidden,
    a_row,
    dying,
    listing,
    refusing,
    the_oracle,
    the_prediction,
)

from benchmarks import __main__ as harness
from benchmarks.campaigns.campaign import open_truth, sealed_in
from benchmarks.campaigns.command import differences
from benchmarks.campaigns.report import markdown, sections, tables
from benchmarks.campaigns.rounds import KINDS
from benchmarks.concealed import plans
from benchmarks.concealed.campaign import NOISY, POSES, READINGS
from benchmarks.measure import DONE
from benchmarks.torque_trials import plans as torque_plans
from benchmarks.torque_trials import trials as torque_trials
from benchmarks.torque_trials.campaign import TORQUES
from benchmarks.torque_trials.effects import NAMED

RECORD = Path(__file__).resolve().parents[1] / "benchmarks/records/concealed_0.1.0_seed8.parquet"
OURS = ("lite6jax", "jax", "tests")
DOMAINS = pytest.mark.parametrize("campaign", [POSES, TORQUES], ids=lambda campaign: campaign.name)


def test_drawing_a_trial_takes_nothing_of_the_library():
    """Nothing of it is loaded, and no module of the generator imports it anywhere."""
    said = (
        "import json, sys; from benchmarks.concealed import trials; from benchmarks.torque_trials import trials as t;"
    )
    said += "trials.draw(0, 5), trials.draw_reading('plane', 0, 0), t.draw(0, 1);"
    said += " loaded = {name: str(getattr(module, '__file__', ''))"
    said += " for name, module in sys.modules.items()}; print(json.dumps(loaded))"
    run = subprocess.run([sys.executable, "-c", said], cwd=RECORD.parents[2], capture_output=True, text=True)
    loaded = json.loads(run.stdout)
    assert not [name for name in loaded if name.split(".")[0] in OURS]
    generator = {name: path for name, path in loaded.items() if name.split(".")[0] == "benchmarks"}
    assert len(generator) > 25
    for name, path in generator.items():
        for node in ast.walk(ast.parse(Path(path).read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [each for each in names if each.split(".")[0] in OURS], name
            assert not [each for each in names if each.startswith("benchmarks.") and each not in generator], name


def quietly(campaign, seed, wanted, out, **options):
    return campaign.run(seed, wanted, out, 0, lambda said: None, lambda *counts: None, **options)


@pytest.fixture(scope="module")
def rows():
    """Truths with their rows, a trial of every kind, by the name of the campaign."""
    clean = [a_row(kind="clean", index=i, noise=noise) for i, noise in enumerate(plans.NOISES * 2)]
    said = dict.fromkeys(("order", "amplitude_rad", "phase_rad"), 0.0) | {"order": 12.0, "phase_rad": 3.0}
    wave = a_finding("joint_harmonic", "joint3", **said)
    hit = [a_row([WAVE], wave, size=s, index=50 + i) for i, s in enumerate(plans.SIZES)]
    bump = a_hidden("joint_bump", "joint3", {"height_rad": 1e-3}, drivers=[["position of joint 3"]])
    unnamed = a_finding("unnamed", "joint3", driver="position of joint 3")
    out = [a_row([bump], unnamed, kind="outside", size=5.0, index=80)]
    bad = [a_row(kind="faulty", fault="swapped_joints", faults=["swapped_joints"], index=90)]
    both = [a_row([WAVE, WAVE], wave, kind="mixture", index=91)]
    poses = [(TRUTH | {"hidden": [WAVE]}, row) for row in hit]
    poses += [(TRUTH | {"hidden": []}, row) for row in clean + bad]
    poses += [(TRUTH | {"hidden": [bump]}, row) for row in out] + [(TRUTH | {"hidden": [WAVE] * 2}, *both)]
    indices = [CONTACT, *(torque_plans.ROUNDS.indices(4, 1, kind)[0] for kind in KINDS)]
    truths = [torque_trials.draw(4, index).truth for index in dict.fromkeys(indices)]
    rng = np.random.default_rng(0)
    torques = [
        (t, TORQUES.score(t, the_oracle(t, rng), the_prediction(t), 1.0, "") | {"sha256": "0" * 64}) for t in truths
    ]
    return {"concealed": poses, "torque": torques}


@DOMAINS
def test_every_round_has_every_kind_in_its_share(campaign):
    rounds, count = campaign.rounds, sum(campaign.rounds.shares.values())
    kinds = [rounds.kind_of(3, index) for index in range(2 * count)]
    assert {kind: kinds.count(kind) for kind in KINDS} == {kind: 2 * rounds.shares[kind] for kind in KINDS}
    assert rounds.indices(3, 2, "faulty") == [index for index, kind in enumerate(kinds) if kind == "faulty"][:2]
    assert [rounds.ordinal(3, index, kind) for index, kind in enumerate(kinds) if kind == "clean"] == list(range(20))


@pytest.mark.parametrize(
    ("drawn", "kind", "part", "all_of_them"),
    [
        (plans, "single", lambda plan: plan.sizes[0], plans.SIZES),
        (plans, "faulty", lambda plan: plan.fault, plans.FAULTS),
        (torque_plans, "clean", lambda plan: plan.noise, torque_plans.NOISES),
        (torque_plans, "single", lambda plan: plan.effects[0], NAMED),
    ],
    ids=["sizes", "faults", "noises", "names"],
)
def test_what_is_drawn_goes_round(drawn, kind, part, all_of_them):
    indices = drawn.ROUNDS.indices(3, len(all_of_them), kind)
    found = [part(drawn.draw_plan(3, index, np.random.default_rng(0))) for index in indices]
    assert sorted(found) == sorted(all_of_them)


@DOMAINS
def test_tables_are_made_of_every_kind(campaign, rows):
    found = [row for _, row in rows[campaign.name]]
    shown = list(sections(campaign, found))
    assert {title for title, *_ in shown} >= {
        *("Goals", "Nothing hidden", "One effect hidden, by size", "Several hidden", "Outside the catalogue"),
        *("Something wrong with the data", "The run"),
    }
    assert "| false alarms, upper end of the interval: 1 % |" in markdown(shown)
    assert "| NO |" in markdown(shown)
    assert all(table.row_count for table in tables(shown))
    assert all(goal.met is None for goal in campaign.goals([]))


@DOMAINS
def test_results_keep_their_types_and_are_read_again(campaign, rows, tmp_path):
    found = sorted((row for _, row in rows[campaign.name]), key=lambda row: row["index"])
    campaign.write_rows(found, tmp_path / "a.parquet")
    again = campaign.read_rows(tmp_path / "a.parquet")
    assert set(again[0]) == set(found[0])
    assert again == found
    assert json.loads(json.dumps(again))
    assert not list(tmp_path.glob(".*"))


@DOMAINS
def test_the_diagnosis_is_given_no_truth_and_a_touched_one_is_not_opened(campaign, tmp_path):
    index = campaign.rounds.indices(4, 1, "single")[0]
    (row,) = quietly(replace(campaign, answer=listing), 4, [index], tmp_path / "a.parquet")
    _, *given = row["error"].split()
    assert {*given} - {"arm.yaml", "factory.yaml"} == {"recording.csv", "recording.yaml", "unseen.csv"}
    folder, digest = tmp_path / "a.trials", row["sha256"]
    assert open_truth(folder, index, digest)["index"] == index
    sealed = sealed_in(folder, index)
    assert hashlib.sha256(sealed.read_bytes()).hexdigest() == digest
    sealed.write_text(sealed.read_text().replace("4", "5", 1))
    with pytest.raises(ValueError, match="is not what was sealed"):
        open_truth(folder, index, digest)


def test_a_worker_that_dies_costs_its_trial_only(tmp_path):
    poses = replace(POSES, answer=dying)
    (row,) = poses.run(0, [5], tmp_path / "a.parquet", 1, lambda said: None, lambda *_: None)
    assert (row["index"], row["error"]) == (5, "WorkerDiedError: the process died")


@DOMAINS
def test_a_campaign_goes_on_where_it_stopped(campaign, tmp_path):
    out = tmp_path / "a.parquet"
    first, second, third = campaign.rounds.indices(4, 3, "clean")
    asked = []
    refused = replace(campaign, answer=refusing)

    def stop(what, done, total):
        asked.append((what, done, total))
        if (what, done) == ("diagnosed", 1):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        refused.run(4, [first, second], out, 0, lambda said: None, stop)
    rows = refused.run(4, [first, second], out, 0, lambda said: None, lambda *counts: asked.append(counts))
    assert asked == [
        *(("sealed", 1, 2), ("sealed", 2, 2), ("diagnosed", 1, 2)),
        *(("diagnosed", 1, 2), ("diagnosed", 2, 2)),
    ]
    assert [row["error"] for row in rows] == ["OSError: no diagnosis here"] * 2
    listed = [line.split("  ")[1] for line in out.with_suffix(".sha256").read_text().splitlines()]
    assert listed == [f"a.trials/sealed/{index:05d}.json" for index in (first, second)]
    assert subprocess.run(["sha256sum", "-c", "a.sha256"], cwd=tmp_path, capture_output=True).returncode == 0
    again = replace(campaign, answer=lambda given: pytest.fail("was done before"))
    assert quietly(again, 4, [first, second], out) == rows
    more = quietly(refused, 4, [second, third], out)
    assert more[0] == rows[1]
    assert [row["index"] for row in campaign.read_rows(out)] == [first, second, third]
    with pytest.raises(ValueError, match="another seed"):
        quietly(refused, 1, [first], out)


def test_results_of_another_sensor_are_not_continued(tmp_path):
    out = tmp_path / "a.parquet"
    refused = {name: replace(each, answer=refusing) for name, each in {"": POSES, **READINGS}.items()}
    (index,) = READINGS["contact"].rounds.indices(4, 1, "clean")
    rows = quietly(refused["contact"], 4, [index], out)
    assert quietly(refused["contact"], 4, [index], out) == rows
    for name in ("", "distance"):
        with pytest.raises(ValueError, match=r"another sensor \(contact\); give that, or another file"):
            quietly(refused[name], 4, [index], out)
    with pytest.raises(ValueError, match="another campaign than torque; give another file"):
        quietly(replace(TORQUES, answer=refusing), 4, [index], out)


def test_results_of_another_noise_are_not_continued(tmp_path):
    out = tmp_path / "a.parquet"
    wandering = replace(NOISY["wandering"], answer=refusing)
    (row,) = quietly(wandering, 4, [0], out)
    assert (row["kind"], row["noise"]) == ("clean", "wandering")
    assert quietly(wandering, 4, [0], out) == [row]
    for other in (POSES, NOISY["heavy_tails"]):
        with pytest.raises(ValueError, match=r"another noise \(wandering\); give that, or another file"):
            quietly(replace(other, answer=refusing), 4, [0], out)


def test_a_noise_is_chosen_by_its_name_and_hides_nothing(tmp_path, capsys):
    given = ["concealed", "--noise", "heavy_tails", "--seed", "4"]
    assert harness.main([*given, "--trials", "2", "--export", str(tmp_path)]) == DONE
    truths = [json.loads((case / "truth.json").read_text()) for case in sorted(tmp_path.iterdir())]
    assert [truth["index"] for truth in truths] == [0, 1]
    assert sorted(truth.get("over_declared", 1.0) for truth in truths) == [*plans.TAILS]
    assert not any(truth["hidden"] for truth in truths)
    for more, said in (
        (["--sensor", "contact"], "--noise: is of sensors that measure poses; leave --sensor out"),
        (["--kind", "single"], "--kind: with this --noise only clean"),
    ):
        with pytest.raises(SystemExit):
            harness.main([*given, *more])
        assert said in capsys.readouterr().err


def test_the_goal_of_hard_noise_counts_the_answers_with_a_finding(rows):
    clean = [row for _, row in rows["concealed"] if row["kind"] == "clean"]
    alarm = clean[0] | {"detected": True}
    (goal,) = NOISY["wandering"].goals([*clean, alarm, clean[0] | {"error": "none"}])
    assert goal.reached.endswith(f"of {len(clean) + 1}")
    assert goal.met is False
    assert NOISY["wandering"].goals(clean)[0].met


def test_trials_are_exported_with_their_truth(tmp_path, capsys):
    for name, index in (("concealed", 5), ("torque", CONTACT)):
        folder = tmp_path / name
        assert harness.main([name, "--seed", "4", "--trial", str(index), "--export", str(folder)]) == DONE
        (case,) = folder.iterdir()
        assert str(case.name) in capsys.readouterr().out.replace("\n", "")
        assert json.loads((case / "truth.json").read_text())["index"] == index
        assert (case / "recording.csv").exists()


def test_what_differs_from_the_record_of_an_earlier_version_is_named():
    record = POSES.read_rows(RECORD)
    assert list(differences(record, record)) == [
        f"{len(record)} of {len(record)} trials have the same findings and data faults."
    ]
    found = next(row for row in record if row["findings"])
    changed = [row | {"findings": []} if row is found else row for row in record]
    line, agreeing = differences(record, changed)
    assert line.startswith(f"trial {found['index']} ({found['kind']}): before (['{found['findings'][0]['effect']}:")
    assert agreeing.startswith(f"{len(record) - 1} of {len(record)} trials")
    others = [row | {"sha256": "0"} for row in record]  # of another truth
    assert list(differences(record, others)) == ["0 of 0 trials have the same findings and data faults."]
