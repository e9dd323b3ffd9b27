"""Commands that tell effects apart: limits, what the oracle says of the two explanations, as a command, and refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.csv
import pytest
from typed import flat, refused, run

from lite6jax.arms.description import load_bundled, write_arm
from lite6jax.design.candidates import Filter
from lite6jax.design.command_plans import CLEAR, plan_commands
from lite6jax.design.commands import KINDS, connect, draw_segments, straight
from lite6jax.design.motions import MotionRoom
from lite6jax.design.tracking import CommandExperiment
from lite6jax.diagnosis.document import SCHEMA
from lite6jax.domains.tracking.coupling import Bodies
from lite6jax.domains.tracking.entry import model_entry
from lite6jax.domains.tracking.fit import fit_servos
from lite6jax.domains.tracking.predict import describe_servos
from lite6jax.domains.tracking.problem import tracking_problem
from lite6jax.domains.tracking.rows import tracking_rows
from lite6jax.effects.dynamic import PayloadTorque
from lite6jax.effects.servo import CommandDelay, CommandTimeOffset, ServoFeedforward, ServoStiffness
from lite6jax.errors import InputError
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.terms import Terms
from lite6jax.estimation.thresholds import CLOSE
from lite6jax.recordings import RecordingSettings, read_recording, write_recording
from lite6jax.recordings.files import read_commands
from lite6jax.recordings.settings import ServoSettings
from lite6jax.report import tracking as tracking_report
from lite6jax.simulation.motions import read_path
from tests.domains.tracking.test_servo_fit import PENDULUM, PERIOD, SERVO, record

LITE6 = load_bundled("lite6")
GRAVITY = np.array([0.0, 0.0, -9.81])
DECLARED = RecordingSettings(
    servo=ServoSettings(
        stiffness_Nm_per_rad=tuple(SERVO["stiffness_Nm_per_rad"]),
        damping_Nm_s_per_rad=tuple(SERVO["damping_Nm_s_per_rad"]),
    )
)
LIMITS = {"velocity": 2.0, "acceleration": 15.0}
DELAY = 0.004


def differences(position, period):
    """The greatest velocity and acceleration `(joint,)` of commands, by differences."""
    return [np.abs(np.diff(position, order, axis=0)).max(0) / period**order for order in (1, 2)]


# ------------------------------------------------------------------ candidates


def bodies_of(arm):
    return Bodies.of_arm(arm, 0.0, np.zeros(3), GRAVITY)


def test_candidates_keep_limits_and_go_from_rest_to_rest():
    room = MotionRoom(LITE6, [1.0, 2.0, 1.5, 3.0, 2.0, 0.5], 12.0, margin=0.05, rate=200.0)
    segments = draw_segments(room, bodies_of(LITE6), 400, seed=3)
    assert {part.kind for part in segments} == set(KINDS)
    lower, upper = room.position.T
    for part in segments:
        assert part.position.shape == (400, 6)
        assert np.all((part.position >= lower - 1e-9) & (part.position <= upper + 1e-9))
        velocity, acceleration = differences(part.position, 1 / 200)
        assert np.all(velocity <= room.velocity)
        assert np.all(acceleration <= room.acceleration)
        at_rest = 12.0 / 200**2  # a motion begins and ends with its acceleration
        assert np.abs(part.position[1] - part.position[0]).max() <= at_rest
        assert np.abs(part.position[-1] - part.position[-2]).max() <= at_rest
        assert np.ptp(part.position, axis=0).max() > 0.01
    again = draw_segments(room, bodies_of(LITE6), 400, seed=3)
    assert all(np.array_equal(a.position, b.position) for a, b in zip(segments, again, strict=True))


def test_candidates_pass_the_filters():
    room = MotionRoom(LITE6, 1.0, 12.0, filters=[Filter("half", lambda q: q[:, 0] > 0.3)], rate=100.0)
    segments = draw_segments(room, bodies_of(LITE6), 200)
    assert min(part.position[:, 0].min() for part in segments) > 0.3
    closed = replace(room, filters=[Filter("gap", lambda q: np.abs(q[:, 0]) > 0.3)])
    ends = np.zeros((2, 6))
    ends[:, 0] = -0.5, 0.5
    assert connect(closed, *ends) is None
    assert connect(closed, ends[1], ends[1] + 0.1) is not None


def test_the_way_between_places_is_a_trapezoid():
    places = np.array([[0.0, 0.0], [1.0, -0.2]])
    way = straight(places, [0.0], np.array([0.5, 1.0]), np.array([1.0, 1.0]), 0.001)
    # 1 rad at 0.5 rad/s with ramps of 0.5 s takes 2.5 s
    assert len(way) == 2501
    assert way[-1] == pytest.approx(places[1])
    assert way[1250, 0] == pytest.approx(0.5, abs=1e-9)
    assert way[250] == pytest.approx([0.5 * 0.25**2, -0.2 * 0.5 * 0.25**2])


# ------------------------------------------------------------------ what designed commands tell


def slowly(samples, seed=0):
    """Slow sines from rest, `(sample,)` rad, in which a delay and a feed-forward are one thing."""
    t = np.arange(samples) * PERIOD
    return np.clip(t / 2, 0, 1) * (0.3 * np.sin(2 * np.pi * 0.15 * t) + 0.15 * np.sin(2 * np.pi * 0.23 * t + seed))


def late(*commands):
    """The oracle's log of a pendulum whose commands `(sample,)` rad are late, one run for each."""
    # at 0.1 ms, its usual step, the oracle is wrong by 20 µrad RMS in fast motions, half of the noise
    parts = [record(command, SERVO, delay=DELAY, fine=400) for command in commands]
    command = np.concatenate(commands)
    return parts[0].made_anew(
        joint_position=np.concatenate([part.joint_position for part in parts]),
        commanded_position=command[:, None],
        time=np.concatenate([part.time + 100.0 * number for number, part in enumerate(parts)]),
        payload=np.zeros(len(command)),
        run=np.repeat(np.arange(len(parts)), [part.samples for part in parts]),
        row=np.arange(1, len(command) + 1),
    )


def gap(log):
    """By how much the log-likelihood of a log with a delay exceeds that with a feed-forward in its place."""
    problem = tracking_problem(tracking_rows(log, PENDULUM))
    costs = []
    for effect in (CommandDelay(1), ServoFeedforward(1)):
        fitted = fit(problem, Terms((effect,)), EngineOptions(), training=problem.valid)
        costs.append(0.5 * np.sum(fitted.residuals.rows**2))
    return costs[1] - costs[0]


@pytest.fixture(scope="module")
def slow():
    """A slow log of a late pendulum, and its fit with a delay."""
    log = late(slowly(1000))
    return log, fit_servos(log, PENDULUM, [CommandDelay(1)])


def experiment_of(slow, **changed):
    """The delay of the slow log, or a feed-forward."""
    log, fitted = slow
    undecided = ((0, ServoFeedforward(1)),)
    return CommandExperiment(fitted.diagnosed, True, fitted.problem.noise, undecided, log, **changed)


@pytest.fixture(scope="module")
def plan(slow):
    return plan_commands(experiment_of(slow), MotionRoom(PENDULUM, **LIMITS, duration=10.0, margin=0.05))


def test_the_oracle_tells_apart_what_designed_commands_tell_apart(slow, plan):
    log, _ = slow
    assert gap(log) < CLOSE
    # as long again
    assert gap(late(slowly(1000), slowly(1001, seed=1))) < CLOSE
    designed = gap(late(slowly(1000), plan.command[:, 0]))
    assert designed > 2 * CLOSE
    pair = plan.pairs[0]
    assert pair.clear
    assert pair.recorded < pair.compared < CLEAR < pair.designed
    # that is the distance that was predicted
    assert 2 * designed == pytest.approx(pair.designed**2, rel=0.25)


def test_designed_commands_keep_limits_and_duration(plan):
    assert plan.time[0] == 0.0
    assert plan.time[-1] == pytest.approx(10.0)
    assert plan.command.shape == (1001, 1)
    lower, upper = plan.room.position.T
    assert np.all((plan.command >= lower) & (plan.command <= upper))
    velocity, acceleration = differences(plan.command, PERIOD)
    assert velocity == pytest.approx(plan.fastest)
    assert acceleration == pytest.approx(plan.strongest)
    assert np.all(velocity <= LIMITS["velocity"])
    assert np.all(acceleration <= LIMITS["acceleration"])
    assert not np.diff(plan.command[:40], axis=0).any()
    assert all(end <= begin for (_, _, end), (_, begin, _) in zip(plan.parts, plan.parts[1:], strict=False))


def test_a_payload_that_is_known_tells_stiffness_from_payload():
    model = replace(describe_servos(PENDULUM, DECLARED, 0.0), terms=Terms((ServoStiffness(1),)), values=np.log([0.97]))
    once = CommandExperiment(model, True, np.array([1e-4]), ((0, PayloadTorque()),))
    room = MotionRoom(PENDULUM, 0.4, 2.0, duration=6.0, margin=0.05)
    # the frame of the pendulum's payload is on its axis, where a mass loads nothing
    hung = replace(model, payload_center=np.array([0.0, -0.15, 0.0]))
    once = replace(once, model=hung)
    alone, loaded = (
        plan_commands(replace(once, payloads=payloads), room).pairs[0].designed for payloads in ((0.0,), (0.0, 2.0))
    )
    # two logs tell more than one of twice the samples
    assert loaded > 1.25 * np.sqrt(2) * alone


def test_what_no_motion_tells_apart_is_refused(slow):
    log, fitted = slow
    always = CommandExperiment(fitted.diagnosed, True, fitted.problem.noise, ((0, CommandTimeOffset()),), log)
    with pytest.raises(InputError, match="command_delay:joint1 and time_offset:clock: are alike in every motion"):
        plan_commands(always, MotionRoom(PENDULUM, **LIMITS, duration=6.0))


# ------------------------------------------------------------------ as a command


@pytest.fixture(scope="module")
def files(slow, tmp_path_factory):
    """A folder with the pendulum, the slow log, and a diagnosis that leaves the two explanations undecided."""
    folder = tmp_path_factory.mktemp("slow")
    log, fitted = slow
    write_arm(PENDULUM, folder / "pendulum.yaml")
    write_recording(replace(log, settings=replace(log.settings, arm="pendulum.yaml")), folder / "slow.csv")
    rivals = [
        {"effect": "servo_feedforward", "site": "joint1", "driver": "none", "status": "undecided"},
        {"effect": "servo_damping", "site": "joint1", "driver": "none", "status": "rejected"},
        {"effect": "unnamed", "site": "joint1", "driver": "velocity of joint 1", "status": "undecided"},
    ]
    document = {
        "schema": SCHEMA,
        "domain": "tracking",
        "servo": "declared",
        "noise": {"estimated": {"joint_rad": [3.6e-5]}},
        "findings": [{"effect": "command_delay", "site": "joint1", "confusable_with": rivals}],
        "model": model_entry(fitted.diagnosed, [np.eye(1)]),
        "inputs": [{"role": "recording", "file": "slow.csv", "sha256": ""}],
    }
    (folder / "diagnosis.json").write_text(json.dumps(document))
    none = document | {"findings": [], "servo": "unknown"}
    (folder / "clean.json").write_text(json.dumps(none))
    return folder


SHORT = ("--tracking", "--duration", 8)


def read_columns(file):
    table = pyarrow.csv.read_csv(file)
    return table.column_names, np.stack([column.to_numpy() for column in table.columns], 1)


def test_commands_of_a_diagnosis(capsys, files, tmp_path):
    out = tmp_path / "next.csv"
    limits = ("--velocity", 115, "--acceleration", 850)
    arguments = ("design", files / "diagnosis.json", *SHORT, *limits, "--out", out, "--figures", tmp_path)
    code, said, err = run(capsys, *arguments, width=60)
    assert (code, err) == (0, "")
    assert all(len(line) <= 60 or "/" in line for line in said.splitlines())
    text = flat(said)
    assert "Distinguished: command delay at joint1 from servo feedforward at joint1, most by" in text
    assert "Command delay at joint1: ±" in text
    assert "unnamed" not in text
    names, values = read_columns(out)
    assert names == ["time_s", "cmd1_rad"]
    assert values.shape == (801, 2)
    assert (tmp_path / "next_commands.png").stat().st_size > 10_000
    # commands of it are followed by `simulate`, and by the emulator
    log = tmp_path / "log.csv"
    simulated = ("simulate", files / "pendulum.yaml", "--tracking", "--commands", out, "--stiffness", 200)
    assert run(capsys, *simulated, "--damping", 8, "--out", log)[0] == 0
    recording = read_recording(log)
    assert recording.commanded_position == pytest.approx(values[:, 1:])
    assert np.abs(recording.joint_position - values[:, 1:]).max() < 0.2
    path = read_path(str(out), PENDULUM)
    assert path.at(values[:5, 0])[0] == pytest.approx(values[:5, 1:], abs=1e-6)
    assert read_commands(out, PENDULUM).commanded_position == pytest.approx(values[:, 1:])


def test_all_named_effects_where_nothing_is_undecided(capsys, files, tmp_path):
    code, said, _ = run(
        capsys, "design", files / "clean.json", *SHORT, "--out", tmp_path / "next.csv", "--json", "--payloads", 0, 0.5
    )
    document = json.loads(said)
    assert code == 0
    assert document["schema"] == "lite6jax/command_design/1"
    assert document["payloads_kg"] == [0.0, 0.5]
    effects = {pair["effect"]["effect"] for pair in document["pairs"]}
    assert {"command_filter", "dead_band", "backlash", "payload_error"} <= effects
    # of unknown servos stiffness and damping are no effects but numbers beside
    assert not {"servo_stiffness", "servo_damping", "viscous_friction", "command_delay"} & effects
    offset = [p for p in document["pairs"] if p["effect"]["effect"] == "dead_band"]
    assert all(pair["distance"] >= pair["recorded_distance"] for pair in offset)
    assert max(motion["end_s"] for motion in document["motions"]) <= 8.0
    # no faster than the log
    assert 0.1 < document["velocity_rad_per_s"][0] < 0.6


def test_commands_of_an_arm_alone(capsys, files, tmp_path):
    limits = ("--velocity", 120, "--acceleration", 800, "--stiffness", 200, "--damping", 8)
    out = tmp_path / "next.csv"
    code, said, _ = run(capsys, "design", files / "pendulum.yaml", *SHORT, *limits, "--rate", 50, "--out", out)
    text = flat(said)
    assert code == 0
    assert "Read-outs are taken to scatter by 0.1 mrad" in text
    assert "Alike in every motion within these limits, at one joint or more:" in text
    assert "servo damping and viscous friction" in text
    _, values = read_columns(out)
    velocity, acceleration = differences(values[:, 1:], 0.02)
    assert velocity < np.deg2rad(120)
    assert acceleration < np.deg2rad(800)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("pendulum.yaml",), "declares no limit of these; give --velocity DEG/S and --acceleration DEG/S², one number"),
        (("pendulum.yaml", "--velocity", 90), "declares no limit of these; give --acceleration DEG/S²"),
        (("pendulum.yaml", "--velocity", 90, -5), "--velocity 90 -5: give one number above 0, or one for each"),
        (("pendulum.yaml", "--stiffness", 0), "--stiffness 0: give one number above 0, or one for each of the 1"),
        (("diagnosis.json", "--duration", 3), "--duration 3: commands take from 6 s, for three motions, to 120 s"),
        (("diagnosis.json", "--duration", 300), "--duration 300: commands take from 6 s"),
        (("diagnosis.json", "--stiffness", 9), "--stiffness: is of an arm, and"),
        (("diagnosis.json", "--payloads", -1), "--payloads -1: give masses in kg, 0 or more"),
        (("diagnosis.json", "--payloads", 1, 1), "--payloads 1 1: has one twice; give each once"),
        (("diagnosis.json", "--joint-noise", -1), "--joint-noise -1: give a standard deviation in degrees"),
        (("diagnosis.json", "--poses", 9), "--tracking: designs commands; leave --poses out"),
        (("diagnosis.json", "--torque"), "--tracking: designs commands; leave --torque out"),
        (("diagnosis.json", "--sensor", "camera"), "--tracking: designs commands; leave the options of a sensor out"),
        (("diagnosis.json", "--recorded", "pendulum.yaml"), "pendulum.yaml"),
        (("slow.csv", "--recorded", "slow.csv"), "is a log already"),
        (("poses.json",), "poses.json: is a diagnosis of poses; give one of tracking"),
        (("missing.json",), "missing.json"),
    ],
)
def test_what_is_refused(capsys, files, tmp_path, monkeypatch, arguments, says):
    monkeypatch.chdir(files)
    (files / "poses.json").write_text(json.dumps({"schema": SCHEMA, "domain": "poses", "model": {}}))
    message = refused(capsys, "design", *arguments, "--tracking", "--out", tmp_path / "next.csv")
    assert says in message
    assert not (tmp_path / "next.csv").exists()


def test_logs_without_declared_servos_or_commands_are_refused(capsys, slow, files, tmp_path):
    log, _ = slow
    unknown = replace(log, settings=replace(log.settings, arm="pendulum.yaml", servo="unknown"))
    write_recording(unknown, files / "unknown.csv")
    still = replace(log, commanded_position=None, settings=replace(log.settings, arm="pendulum.yaml"))
    write_recording(still, files / "joints.csv")
    for name, says in (
        ("unknown.csv", "its sidecar does not declare `servo`; give its diagnosis"),
        ("joints.csv", "is no log of commands; it needs time_s, q1_rad ... and cmd1_rad ..."),
    ):
        assert says in refused(capsys, "design", files / name, "--tracking", "--out", tmp_path / "next.csv")


def test_options_of_commands_alone_are_refused(capsys, tmp_path):
    out = tmp_path / "poses.csv"
    assert "--payloads: is for commands; add --tracking" in refused(
        capsys, "design", "lite6", "--payloads", 1, "--out", out
    )


def test_a_report_names_the_command_where_something_is_undecided():
    rival = {"effect": "servo_feedforward", "site": "joint1", "driver": "none", "log_likelihood_gap": 0.2}
    finding = {"effect": "command_delay", "site": "joint1", "driver": "none", "moves_rms_rad": 1e-3, "parameters": {}}

    def commands(status):
        alternatives = [{**rival, "status": status}]
        document = {"findings": [{**finding, "confusable_with": alternatives}]}
        return [command for _, command in tracking_report.steps(document, Path("log.csv"), Path("to/d.json"))]

    design = "lite6jax design to/d.json --tracking --out to/log_next.csv"
    assert commands("undecided")[0] == design
    assert design not in commands("rejected")
    assert len(commands("rejected")) == 1
