"""`diagnose` and `predict` of logs of commands and measured joints: what is found, printed, written and refused."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.csv
import pytest
from typed import flat, refused, run

from lite6jax import cli
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import write_arm
from lite6jax.diagnosis.diagnose import diagnose, domains_of
from lite6jax.diagnosis.document import model_from_document
from lite6jax.domains.predict import predicted
from lite6jax.domains.tracking.problem import tracking_problem
from lite6jax.domains.tracking.screening import screen_tracking
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import join_recordings, read_recording
from tests.domains.tracking.test_servo_fit import LEVER, PENDULUM, PERIOD, SERVO, TRUE, commands_of
from tests.oracles.servos import follow

SAMPLES = 300
NOISE = 2e-4
"""rad, beside which the oracle and the rollout agree."""


def write_log(folder, columns, arm=PENDULUM, servo=SERVO, noise=2e-5):
    """A log with its sidecar and the description of its arm."""
    write_arm(arm, folder / "arm.yaml", overwrite=True)
    lines = [",".join(columns)] + [
        ",".join(f"{value:.9g}" for value in row) for row in np.column_stack([*columns.values()])
    ]
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    gains = "unknown" if servo is None else json.dumps(servo)
    path.with_suffix(".yaml").write_text(
        "recording:\n  arm: arm.yaml\n  joint_source: measured\n  motion: trajectory\n  command: position\n"
        f"  joint_noise_rad: {noise:.1e}\n  payload_com_m: [0.0, -0.1, 0.0]\n  servo: {gains}\n"
    )
    return path


def columns_of(command, noise=2e-5, **changed):
    """Times, a command and what the oracle makes of it with the noise of an encoder."""
    q = follow(command, PERIOD, **(TRUE | changed))
    errors = np.random.default_rng(5).normal(0.0, noise, len(q))
    return {"time_s": PERIOD * np.arange(len(q)), "q1_rad": q + errors, "cmd1_rad": command}


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """The folder of a log of a servo that is later than declared, and of its diagnosis."""
    folder = tmp_path_factory.mktemp("late")
    log = write_log(folder, columns_of(commands_of(SAMPLES), NOISE, delay=0.023), noise=NOISE)
    code = cli.main(["diagnose", str(log), "--out", str(folder / "d.json")])
    assert code == 0
    return folder


@pytest.fixture(scope="module")
def document(diagnosed):
    return json.loads((diagnosed / "d.json").read_text())


def test_a_late_servo_is_found_and_named(document):
    assert document["domain"] == "tracking"
    assert document["verdict"] == "explained"
    assert [(finding["effect"], finding["site"]) for finding in document["findings"]] == [("time_offset", "clock")]
    offset = document["findings"][0]["parameters"]["offset_s"]
    assert offset["value"] == pytest.approx(0.023, abs=3e-4)
    assert 0 < offset["std"] < 3e-4
    assert document["findings"][0]["joints"] == [1]
    assert document["servos"][0]["delay_s"] == pytest.approx(0.023, abs=3e-4)


def test_held_out_rollouts_and_their_peers_are_in_the_document(document):
    before, after = (document[stage]["heldout_rollout_rms_rad"] for stage in ("before", "after"))
    assert after < 1.5 * NOISE
    assert before > 20 * after
    peers = {name: one["heldout_rollout_rms_rad"] for name, one in document["peers"].items()}
    assert after < peers["second_order"]
    assert after < peers["best_delay"] < peers["commanded"]
    by_joint = document["after"]["heldout_rollout_rms_by_joint_rad"]
    assert by_joint == pytest.approx([after])


def test_the_report_says_the_cause_and_what_it_is_beside(capsys, diagnosed):
    code, out, _ = run(capsys, "report", diagnosed / "d.json", width=120)
    said = flat(out)
    assert code == 0
    assert "All joints are late, by one time" in said
    assert "measured = commanded" in said
    assert "best delay" in said
    assert "second order" in said
    assert "Declare the delay" in said
    assert "lite6jax predict" in said


def test_joints_are_predicted_from_commands_alone(capsys, diagnosed, document):
    command = commands_of(400, seed=4)
    time = PERIOD * np.arange(400)
    lines = ["time_s,cmd1_rad"] + [f"{t:.4f},{u:.9g}" for t, u in zip(time, command, strict=True)]
    unseen = diagnosed / "unseen.csv"
    unseen.write_text("\n".join(lines) + "\n")
    code, _, _ = run(capsys, "predict", diagnosed / "d.json", unseen, "--out", diagnosed / "p.csv")
    assert code == 0
    table = pyarrow.csv.read_csv(diagnosed / "p.csv")
    assert table.column_names[:2] == ["q1_rad", "outside"]
    assert all(name.startswith("outside_") and name.endswith("_joint1") for name in table.column_names[2:])
    truth = follow(command, PERIOD, **(TRUE | {"delay": 0.023}))
    errors = table["q1_rad"].to_numpy() - truth
    assert np.sqrt(np.mean(errors**2)) < NOISE
    found = predicted(model_from_document(document), unseen)
    assert found.position[:, 0] == pytest.approx(table["q1_rad"].to_numpy())
    assert "Joints 1 in 400 rows" in found.summary()


@pytest.mark.long
def test_a_clean_log_has_no_finding(tmp_path, capsys):
    # a step of the oracle is late by its half: 50 µs at its usual one is a lag that is found
    log = write_log(tmp_path, columns_of(commands_of(SAMPLES), NOISE, fine=1000), noise=NOISE)
    code, out, _ = run(capsys, "diagnose", log, "--out", tmp_path / "d.json", width=120)
    document = json.loads((tmp_path / "d.json").read_text())
    assert code == 0
    assert document["findings"] == []
    assert document["verdict"] == "consistent"
    before, after = (document[stage]["heldout_rollout_rms_rad"] for stage in ("before", "after"))
    assert before == after
    assert "nothing is missing from the model" in flat(out)


def two_joints(first, second):
    """The log of two servoed pendulums, each by its own oracle, as columns."""
    one, other = columns_of(first), columns_of(second)
    return {
        "time_s": one["time_s"],
        "q1_rad": one["q1_rad"],
        "q2_rad": other["q1_rad"],
        "cmd1_rad": one["cmd1_rad"],
        "cmd2_rad": other["cmd1_rad"],
    }


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        (lambda log: log | {"q1_rad": log["q2_rad"], "q2_rad": log["q1_rad"]}, ("joints_swapped", [1, 2])),
        (lambda log: log | {"q2_rad": -log["q2_rad"]}, ("joint_sign", [2])),
    ],
)
def test_columns_that_are_exchanged_or_reversed_are_corrected(tmp_path, changed, fault):
    t = PERIOD * np.arange(SAMPLES)
    log = two_joints(commands_of(SAMPLES), 0.3 * np.cos(2 * np.pi * 0.9 * t) - 0.3)
    massless = Arm("two", np.vstack([PENDULUM.kinematics, [[0.2, 0.0, 0.0, 0.0, 0.0, 0.0]]]))
    path = write_log(tmp_path, changed(log), massless, servo=None)
    screened = screen_tracking(read_recording(path, arm=massless), massless)
    assert [(one.code, one.numbers["joints"]) for one in screened.found] == [fault]
    restored = screened.data.recording.joint_position
    assert restored[:, 0] == pytest.approx(log["q1_rad"])
    assert restored[:, 1] == pytest.approx(log["q2_rad"])


def test_the_side_that_is_wrong_is_told_by_the_weight_of_the_arm(tmp_path):
    log = columns_of(commands_of(SAMPLES) + 0.8)
    # the same pendulum, at whose zero it does not hang: it is no mirror image of itself
    turned = replace(PENDULUM, center_of_mass=LEVER * np.array([[np.sin(0.8), -np.cos(0.8), 0.0]]))
    shifted = {"q1_rad": log["q1_rad"] - 0.8, "cmd1_rad": 0.8 - log["cmd1_rad"]}
    path = write_log(tmp_path, log | shifted, turned)
    screened = screen_tracking(read_recording(path, arm=turned), turned)
    assert [(one.code, one.numbers["side"]) for one in screened.found] == [("joint_sign", "commanded")]


def test_rows_that_repeat_while_the_arm_moves_are_left_out(tmp_path):
    log = columns_of(commands_of(SAMPLES))
    stale = log["q1_rad"].copy()
    for row in (100, 101, 250):
        stale[row] = stale[row - 1]
    path = write_log(tmp_path, log | {"q1_rad": stale})
    screened = screen_tracking(read_recording(path, arm=PENDULUM), PENDULUM)
    assert [(one.code, one.rows) for one in screened.found] == [("stale_rows", (101, 102, 251))]
    assert np.flatnonzero(screened.unusable).tolist() == [100, 101, 250]


@pytest.mark.parametrize("step", [3e-4, 2 * np.pi / 4096])
def test_the_step_of_an_encoder_is_noise_where_values_seldom_repeat(tmp_path, step):
    log = columns_of(commands_of(SAMPLES), 1e-4)
    rounded = step * np.round(log["q1_rad"] / step)
    assert np.mean(np.diff(np.unique(log["q1_rad"])) > 1e-8) > 0.9
    path = write_log(tmp_path, log | {"q1_rad": rounded}, noise=1e-4)
    screened = screen_tracking(read_recording(path), PENDULUM)
    assert screened.data.noise == pytest.approx([np.hypot(np.hypot(1e-4, step / np.sqrt(12)), 3e-5)], rel=1e-3)
    plain = write_log(tmp_path, log, noise=1e-4)
    assert screen_tracking(read_recording(plain), PENDULUM).data.noise == pytest.approx([np.hypot(1e-4, 3e-5)])


# ------------------------------------------------------------------ bad input


def shifted(log, rows):
    """A log whose commands are its own read-outs of some rows later."""
    q = log["q1_rad"]
    return log | {"cmd1_rad": np.r_[q[rows:], np.full(rows, q[-1])]}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        (
            lambda log: log | {"cmd1_rad": log["q1_rad"]},
            "commands and read-outs are equal to 1e-06 rad: the log holds commands twice, or a simulator without "
            "dynamics; record measured joints as q1_rad ...",
        ),
        (
            lambda log: {name: row[:-1] for name, row in shifted(log, 1).items()},
            "each command is the read-out of 1 rows after: the log holds measurements twice; record what the "
            "controller was sent as cmd1_rad ...",
        ),
        (
            lambda log: log | {"q1_rad": 0 * log["q1_rad"]},
            "q1_rad hardly moves while its command does: its torque may be off, or the column is another quantity; "
            "leave out such rows, or name the columns anew",
        ),
        (lambda log: log | {"cmd1_rad": 0 * log["q1_rad"]}, "its commands never move; record a motion"),
        (
            lambda log: {name: row for name, row in log.items() if name != "time_s"},
            "commands need times; add time_s",
        ),
        (
            lambda log: log | {"q1_rad": 2.5 * log["q1_rad"]},
            "q1_rad moves 2.46 times as far as cmd1_rad; give both in the same unit, after the same gear",
        ),
    ],
)
def test_logs_that_cannot_be_diagnosed_are_refused_in_one_line(capsys, tmp_path, changed, says):
    log = write_log(tmp_path, changed(columns_of(commands_of(SAMPLES))))
    assert refused(capsys, "diagnose", log, "--out", tmp_path / "d.json") == f"{log}: {says}"
    assert not (tmp_path / "d.json").exists()


def test_what_is_not_of_commands_is_refused(capsys, diagnosed, tmp_path):
    log = diagnosed / "log.csv"
    said = refused(capsys, "diagnose", log, "--poses")
    assert said == f"{log}: has commands and no poses; leave --poses or domain='poses' out"
    said = refused(capsys, "diagnose", log, "--reference", log)
    assert said.startswith("reference: is not of commands")
    said = refused(capsys, "diagnose", log, "--poses", "--tracking")
    assert said == "--poses and --tracking: give one of them, or none to diagnose all that was recorded"
    empty = tmp_path / "m.csv"
    empty.write_text("time_s,q1_rad\n0.0,0.1\n0.01,0.2\n")
    said = refused(capsys, "predict", diagnosed / "d.json", empty, "--out", tmp_path / "p.csv")
    assert said == f"{empty}: has no column cmd1_rad; give time_s and cmd1_rad … of every joint"
    said = refused(capsys, "predict", diagnosed / "d.json", log, "--register", "--out", tmp_path / "p.csv")
    assert said == "--register: a diagnosis of tracking has no sensor frame"


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda model: model["servo"].pop("delay"), "servo does not have a number of each kind for each joint"),
        (lambda model: model["links"].append(model["links"][0]), "other numbers of links or ranges"),
    ],
)
def test_a_damaged_model_is_refused(capsys, diagnosed, document, tmp_path, damage, says):
    damaged = json.loads(json.dumps(document))
    damage(damaged["model"])
    path = tmp_path / "d.json"
    path.write_text(json.dumps(damaged))
    said = refused(capsys, "predict", path, diagnosed / "log.csv", "--out", tmp_path / "p.csv")
    assert says in said
    assert said.endswith("run `lite6jax diagnose` again")


def test_the_prior_of_a_sidecar_holds_for_commands_too(capsys, tmp_path):
    log = write_log(tmp_path, columns_of(commands_of(60)))
    sidecar = log.with_suffix(".yaml")
    sidecar.write_text(sidecar.read_text() + "  prior: {calibration: 0.1}\n")
    said = refused(capsys, "diagnose", log, "--out", tmp_path / "d.json")
    assert said.startswith("prior: 'calibration' is no explanation; the names are named, wave")


def test_commands_are_viewed_by_the_errors_of_their_angles(diagnosed, document, capsys):
    pytest.importorskip("viser", reason="viser (extra view) is not installed")
    from lite6jax.report.viewer import joint_scene

    code, out, err = run(capsys, "view", diagnosed / "d.json", "--port", "0", "--duration", "0.1")
    assert (code, err) == (0, "")
    assert f"{SAMPLES} rows of" in flat(out)
    model = model_from_document(document, (), "d.json")
    scene = joint_scene(document, model, read_recording(diagnosed / "log.csv"))
    left, before = (float(np.sqrt(np.mean(errors.over_noise**2))) for errors in scene.joints)
    assert left < 1.3
    assert before > 3.0


def test_a_dead_band_in_place_of_friction_is_judged_by_its_own_rollout(tmp_path):
    # their columns agree where a joint reverses; at rest under load friction holds the joint, and a dead band does not
    # at 100 steps a sample the oracle is late by 50 µs, half a step, which is found
    log = write_log(tmp_path, columns_of(commands_of(2 * SAMPLES), NOISE, coulomb=0.6, fine=500), noise=NOISE)
    found = diagnose(read_recording(log)).to_dict()
    assert [(one["effect"], one["site"]) for one in found["findings"]] == [("coulomb_friction", "joint1")]
    rivals = {rival["effect"]: rival for rival in found["findings"][0]["confusable_with"]}
    near = [effect for effect, rival in rivals.items() if rival["log_likelihood_gap"] < 100.0]
    assert "dead_band" not in near


def test_logs_of_several_files_are_runs_of_one(tmp_path):
    logs = []
    for seed, name in enumerate(("sines", "steps"), 1):
        folder = tmp_path / name
        folder.mkdir()
        log = write_log(folder, columns_of(commands_of(SAMPLES, seed=seed), NOISE), noise=NOISE)
        log.with_suffix(".yaml").rename(folder / f"{name}.yaml")
        logs.append(read_recording(log.rename(folder / f"{name}.csv")))
    both = join_recordings(logs)
    assert both.samples == 2 * SAMPLES
    assert len(np.unique(both.run)) == 2
    assert both.commanded_position == pytest.approx(np.vstack([log.commanded_position for log in logs]))
    assert len(set(both.notes)) == len(both.notes)
    screened = screen_tracking(both, PENDULUM)
    assert not screened.found
    problem = tracking_problem(screened.data)
    residual = problem.residual(np.zeros(0), Terms(), np.zeros(0))
    for run_number in np.unique(problem.run):
        assert np.sqrt(np.mean(residual[:, problem.run == run_number] ** 2)) < 1.2


def test_several_logs_with_torques_are_joined_by_their_commands(tmp_path):
    logs = []
    for name in ("sines", "steps"):
        columns = columns_of(commands_of(SAMPLES), NOISE)
        file = tmp_path / name
        file.mkdir()
        log = read_recording(write_log(file, columns | {"tau1_Nm": np.zeros(SAMPLES)}, noise=NOISE))
        logs.append(replace(log, source=f"{name}.csv"))
        assert logs[-1].has_torques
    both = join_recordings(logs)
    assert not both.has_torques
    assert "torques are left out, as several logs are diagnosed by their commands" in both.notes
    assert domains_of(both) == ("tracking",)
