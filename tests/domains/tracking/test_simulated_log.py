"""Simulated logs of commands and joints: against a plain oracle, what is drawn, written, refused, and found again."""

import json

import numpy as np
import pytest
from typed import flat, refusal, refused, run

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import load_bundled, write_arm
from lite6jax.effects.servo import CommandDelay
from lite6jax.recordings import RecordingSettings, read_recording
from lite6jax.recordings.settings import ServoSettings, read_settings
from lite6jax.simulation import draw_commands, simulate_tracking, usual_servo
from lite6jax.simulation.motions import joint_ranges
from tests.domains.tracking.test_servo_fit import PENDULUM, PERIOD, SERVO, TRUE, commands_of
from tests.oracles.servos import follow

LITE6 = load_bundled("lite6")
NOISE_DEG = 0.01
DECLARED = ServoSettings(
    stiffness_Nm_per_rad=tuple(SERVO["stiffness_Nm_per_rad"]), damping_Nm_s_per_rad=tuple(SERVO["damping_Nm_s_per_rad"])
)


@pytest.mark.parametrize("seed", [0, 3])
def test_commands_stay_within_ranges_and_speeds_and_begin_at_rest(seed):
    time, command, runs = draw_commands(LITE6, 1200, runs=2, step=0.01, speed=1.0, seed=seed)
    center, half = joint_ranges(LITE6)
    assert np.all(np.abs(command - center) <= 0.5 * half + 1e-12)
    for number in range(2):
        rows = np.flatnonzero(runs == number)
        assert np.diff(time[rows]) == pytest.approx(0.01)
        velocity = np.diff(command[rows], axis=0) / 0.01
        assert np.all(velocity[:20] == 0.0)
        sines, trapezoids, steps = velocity[:199], velocity[200:399], velocity[400:]
        assert 0.9 < np.abs(sines).max() < 1.0 + 1e-9
        assert 0.9 < np.abs(trapezoids).max() < 1.0 + 1e-9
        assert np.mean(steps != 0.0) < 0.05
        assert np.abs(steps).max() <= 0.2 / 0.01
        assert np.ptp(command[rows], 0).min() > 0.05
    assert np.array_equal(draw_commands(LITE6, 1200, runs=2, step=0.01, speed=1.0, seed=seed)[1], command)


def test_a_simulated_pendulum_is_that_of_the_oracle():
    command = commands_of(300)
    effects = ["coulomb_friction:joint=1,coulomb_Nm=0.3", (CommandDelay(1), [0.02])]
    simulated = simulate_tracking(PENDULUM, command[:, None], effects=effects, servo=DECLARED)
    truth = follow(command, PERIOD, **(TRUE | {"coulomb": 0.5, "delay": 0.02}), fine=1000)
    errors = simulated.recording.joint_position[:, 0] - truth
    assert np.sqrt(np.mean(errors**2)) < 2e-5
    assert np.abs(errors).max() < 1e-4
    without = follow(command, PERIOD, **TRUE, fine=1000)
    assert simulated.moved[0] == pytest.approx(np.sqrt(np.mean((truth - without) ** 2)), rel=0.02)


def test_read_outs_scatter_and_are_rounded_as_asked():
    command = commands_of(600)[:, None]
    clean = simulate_tracking(PENDULUM, command, servo=DECLARED).recording
    noisy = simulate_tracking(PENDULUM, command, servo=DECLARED, joint_noise=1e-3, seed=4).recording
    assert np.std(noisy.joint_position - clean.joint_position) == pytest.approx(1e-3, rel=0.1)
    assert noisy.settings.joint_noise_rad == 1e-3
    ticks = simulate_tracking(PENDULUM, command, servo=DECLARED, joint_quantum=2e-3).recording.joint_position / 2e-3
    assert ticks == pytest.approx(np.round(ticks), abs=1e-9)
    assert np.abs(2e-3 * ticks - clean.joint_position).max() <= 1e-3 + 1e-12


def test_usual_servos_hold_what_they_carry():
    servo = usual_servo(LITE6)
    stiffness, damping = np.array(servo.stiffness_Nm_per_rad), np.array(servo.damping_Nm_s_per_rad)
    assert stiffness.min() > 0.04 * stiffness.max()
    assert np.all(damping >= 0.0199 * stiffness)
    log = simulate_tracking(LITE6, samples=300, payload=0.3).recording
    assert log.commanded_position is not None
    assert np.sqrt(np.mean((log.joint_position - log.commanded_position) ** 2, 0)).max() < 0.1


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"samples": 99}, "simulation: 99 samples in 1 runs; give at least 100 a run, and one run"),
        ({"step": 0.0}, "simulation: step is 0.0; give a number above 0"),
        ({"joint_noise": -1.0}, "simulation: joint_noise is -1.0; give 0 or more"),
        (
            {"effects": ["backlash:joint=3,half_width_rad=1e-3"]},
            "backlash:joint3: is of a joint that pendulum does not",
        ),
        ({"effects": 2 * ["backlash:joint=1,half_width_rad=1e-3"]}, "backlash:joint1: is given twice; keep one"),
        ({"effects": ["unnamed:joint=1"]}, "effect 'unnamed': unknown; the catalogue has time_offset, "),
        (
            {"servo": ServoSettings((1.0, 2.0), (1.0, 2.0))},
            "simulation: recording.servo.stiffness_Nm_per_rad has 2 numbers for 1 joints; give one per joint",
        ),
    ],
)
def test_what_cannot_be_simulated_is_refused(changed, message):
    assert refusal(simulate_tracking, PENDULUM, **changed).startswith(message)


def test_arms_without_masses_or_with_slides_are_refused():
    bare = Arm("bare", np.zeros((1, 6)))
    assert refusal(simulate_tracking, bare) == (
        "bare: has no masses, without which no rollout is simulated; give mass_kg of each link"
    )
    slide = Arm("slide", np.zeros((1, 6)), sliding=(0,))
    assert refusal(draw_commands, slide) == (
        "slide: has prismatic joints, whose commands are not simulated; choose another arm"
    )


# ------------------------------------------------------------------ the command


def test_the_command_writes_what_the_library_simulates(capsys, tmp_path):
    write_arm(PENDULUM, tmp_path / "arm.yaml")
    out = tmp_path / "log.csv"
    code, said, _ = run(
        capsys, "simulate", tmp_path / "arm.yaml", "--tracking", "--samples", 300, "--runs", 2, "--seed", 5,
        "--effect", "backlash:joint=1,half_width_rad=2e-3", "--stiffness", 200, "--damping", 8,
        "--joint-noise", NOISE_DEG, "--payload", 0.2, "--payload-at", 0, -100, 0, "--out", out,
    )  # fmt: skip
    assert code == 0
    said = flat(said)
    assert said.startswith(
        "Simulated 300 samples of commands and measured joints of a pendulum in 2 runs: sines, trapezoids and steps. "
        "Servos, as declared: stiffness 200 Nm/rad, damping 8 Nm·s/rad. Noise, as declared: joints 0.01 deg."
    )
    assert "backlash at joint1: half_width_rad = 0.002" in said
    settings = RecordingSettings(arm="arm.yaml", payload_com_m=(0.0, -0.1, 0.0))
    simulated = simulate_tracking(
        PENDULUM, effects=["backlash:joint=1,half_width_rad=2e-3"], samples=300, runs=2, seed=5, payload=0.2,
        servo=DECLARED, joint_noise=np.deg2rad(NOISE_DEG), settings=settings,
    )  # fmt: skip
    assert f"The effects move the joints by {1e3 * simulated.moved[0]:.4f} mrad RMS." in said
    read = read_recording(out, arm=PENDULUM)
    assert read.settings == simulated.recording.settings
    for name in ("joint_position", "commanded_position", "time", "run", "payload"):
        np.testing.assert_array_equal(getattr(read, name), getattr(simulated.recording, name))


def test_what_was_simulated_is_found_again(capsys, tmp_path):
    write_arm(PENDULUM, tmp_path / "arm.yaml")
    out = tmp_path / "log.csv"
    code, _, _ = run(
        capsys, "simulate", tmp_path / "arm.yaml", "--tracking", "--samples", 400, "--stiffness", 200, "--damping", 8,
        "--effect", "coulomb_friction:joint=1,coulomb_Nm=0.6", "--joint-noise", NOISE_DEG, "--out", out,
    )  # fmt: skip
    assert code == 0
    code, _, _ = run(capsys, "diagnose", out, "--out", tmp_path / "d.json")
    document = json.loads((tmp_path / "d.json").read_text())
    assert [(one["effect"], one["site"]) for one in document["findings"]] == [("coulomb_friction", "joint1")]
    assert document["findings"][0]["parameters"]["coulomb_Nm"]["value"] == pytest.approx(0.6, abs=0.03)


def test_servos_may_be_hidden(capsys, tmp_path):
    write_arm(PENDULUM, tmp_path / "arm.yaml")
    code, said, _ = run(
        capsys, "simulate", tmp_path / "arm.yaml", "--tracking", "--samples", 120, "--servo", "unknown",
        "--joint-quantum", 0.1, "--out", tmp_path / "log.csv",
    )  # fmt: skip
    assert code == 0
    assert "Servos: not declared. Noise, as declared: joints 0 deg, rounded to 0.1 deg." in flat(said)
    assert "No effects: the arm follows its commands as its servos do." in flat(said)
    assert read_settings(tmp_path / "log.yaml").servo == "unknown"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--tracking", "--tool", "unknown"], "--tool: is of poses, and --tracking of commands; keep one"),
        (["--tracking", "--sensor", "camera"], "--sensor: is of poses, and --tracking of commands; keep one"),
        (["--stiffness", "3"], "--stiffness: is of servos; add --tracking"),
        (["--joint-quantum", "0.1"], "--joint-quantum: is of servos; add --tracking"),
        (["--tracking", "--payload", "1", "2"], "--payload: a log of commands has one; give one"),
        (
            ["--tracking", "--stiffness", "3", "4"],
            "--stiffness 3 4: give one number above 0, or one for each of the 6 joints",
        ),
    ],
)
def test_options_of_something_else_are_refused(capsys, tmp_path, options, message):
    assert refused(capsys, "simulate", "lite6", *options, "--out", tmp_path / "log.csv") == message
    assert not (tmp_path / "log.csv").exists()


# ------------------------------------------------------------------ what a sidecar says of servos


def test_limits_and_filters_of_a_sidecar_act(tmp_path):
    sidecar = tmp_path / "log.yaml"
    text = "recording:\n  servo: {stiffness_Nm_per_rad: [200.0], damping_Nm_s_per_rad: [8.0], "
    sidecar.write_text(text + "torque_limit_Nm: [3.0], time_constant_s: [0.05]}\n")
    servo = read_settings(sidecar).servo
    assert isinstance(servo, ServoSettings)
    assert (servo.torque_limit_Nm, servo.time_constant_s) == ((3.0,), (0.05,))
    command = commands_of(300)[:, None]
    limited = simulate_tracking(PENDULUM, command, servo=servo)
    assert np.asarray(limited.model.model.servo.torque_limit) == pytest.approx([3.0])
    same = simulate_tracking(
        PENDULUM, command, servo=DECLARED,
        effects=["torque_limit:joint=1,torque_Nm=3", "command_filter:joint=1,time_constant_s=0.05"],
    )  # fmt: skip
    assert limited.recording.joint_position == pytest.approx(same.recording.joint_position, abs=1e-9)
    sidecar.write_text(text + "torque_limit_Nm: [0.0]}\n")
    assert "torque_limit_Nm: is zero" in refusal(read_settings, sidecar)
