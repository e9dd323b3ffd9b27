"""An emulated arm that follows its commands as servos do, and the diagnosis of what is recorded of it."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from live import emulated
from typed import flat, refused, run

from lite6jax.arms.description import load_bundled
from lite6jax.controller import protocol
from lite6jax.controller.recorder import record
from lite6jax.controller.station import read_station
from lite6jax.emulator import EmulatedArm, Faults, interpolate
from lite6jax.emulator.core import Core, report
from lite6jax.errors import InputError
from lite6jax.recordings import RecordingSettings, read_recording, write_settings
from lite6jax.simulation import servos_with_effects, usual_servo

ARM = load_bundled("lite6")
SERVO = usual_servo(ARM)
PERIOD = 0.004
REST = 1.0
DURATION = 3.5
ROLLED = 2e-4
"""rad, by which rollouts of a light wrist may differ that begin at other times."""


def moving_path():
    """A rest, and a motion of every joint with reversals."""
    knots = np.linspace(REST, DURATION, 14)
    wave = 0.25 * np.random.default_rng(0).uniform(-1, 1, (len(knots), 6))
    wave[-1] = wave[-2]
    joints = np.array([0, 0.3, 1.2, 0, 0.5, 0]) + np.vstack([np.repeat(wave[:1], 5, 0), wave])
    return interpolate(np.r_[np.linspace(0, REST - 0.2, 5), knots], joints)


PATH = moving_path()


def body_with(*effects, kinematics=ARM.kinematics):
    settings = RecordingSettings(arm=ARM.name, servo=SERVO)
    made = replace(ARM, kinematics=kinematics, dh=None)
    return EmulatedArm(ARM, kinematics, servos=servos_with_effects(made, effects, settings))


def samples(seconds=DURATION):
    return PERIOD * np.arange(round(seconds / PERIOD))


def read_in_parts(core, times, parts=25):
    """What encoders show, asked for as time goes on."""
    return np.concatenate([core.read_encoders(part)[0] for part in np.array_split(times, parts)])


@pytest.mark.parametrize(
    "effects",
    [
        (),
        ("command_delay:joint=2,delay_s=0.02", "coulomb_friction:joint=2,coulomb_Nm=3"),
        ("backlash:joint=3,half_width_rad=2e-3", "encoder_offset:joint=1,offset_rad=0.01"),
    ],
)
def test_read_outs_piece_by_piece_are_those_of_one_rollout(effects):
    body = body_with(*effects)
    shown = read_in_parts(Core(body, path=PATH), samples())
    rolled = body.servos.predict(samples(), PATH.at(samples())[0]).position
    np.testing.assert_allclose(shown, rolled, atol=ROLLED)
    lag = np.sqrt(np.mean((shown - PATH.at(samples())[0]) ** 2, 0))
    assert (lag > 5e-3).all()


def test_an_arm_at_rest_stays_where_its_servos_balance_its_weight():
    core = Core(body_with("coulomb_friction:joint=2,coulomb_Nm=3"), path=PATH)
    times = np.linspace(DURATION + 3, DURATION + 30, 100)
    shown, velocity = core.read_encoders(times)
    assert np.ptp(shown, axis=0).max() < 1e-4
    assert np.abs(velocity).max() < 1e-3
    torque = core.torque(times)
    drive = np.array(SERVO.stiffness_Nm_per_rad) * (core.read_commands(times)[0] - shown)
    without_friction = [0, 2, 3, 4, 5]
    np.testing.assert_allclose(torque[:, without_friction], drive[:, without_friction], atol=2e-2)


def test_motors_exert_the_friction_that_the_joints_follow_with():
    moves = np.array([2.0, 2.5, 3.0])
    plain = Core(body_with(), path=PATH)
    rubbing = Core(body_with("viscous_friction:joint=2,viscous_Nm_s_per_rad=20"), path=PATH)
    slow = rubbing.read_joints(moves)[1][:, 1]
    assert np.abs(slow - plain.read_joints(moves)[1][:, 1]).min() > 1e-3
    (effect, _), *_ = rubbing.body.followed
    assert effect.name == "viscous_friction"
    bare = replace(rubbing.body, servos=plain.body.servos)
    unrubbed = Core(bare, path=PATH)
    unrubbed._servoed = rubbing._servoed
    np.testing.assert_allclose(rubbing.torque(moves)[:, 1] - unrubbed.torque(moves)[:, 1], 20 * slow, atol=1e-9)


def test_an_error_holds_the_last_command_and_changes_nothing_before_it():
    moved = Core(body_with(), path=PATH)
    stopped = Core(body_with(), path=PATH)
    before = samples(2.5)
    read_in_parts(stopped, before)
    stopped.advance(2.5)
    stopped.set_faults(Faults(error=22))
    np.testing.assert_allclose(stopped.read_encoders(before)[0], moved.read_encoders(before)[0], atol=1e-12)
    last = np.array([6.0])
    held = stopped.read_encoders(last)[0]
    still = body_with().servos.predict([0.0, 4.0], np.repeat(stopped.read_commands(last)[0], 2, 0)).position
    np.testing.assert_allclose(held[0], still[-1], atol=ROLLED)


def test_the_pose_that_is_reported_is_of_the_true_joints():
    shifted = Core(body_with("encoder_offset:joint=1,offset_rad=0.05"), path=PATH)
    plain = Core(body_with(), path=PATH)
    reports = [
        np.frombuffer(report(core, protocol.REALTIME, samples(0.1)), protocol.report_layout(protocol.REALTIME))
        for core in (shifted, plain)
    ]
    np.testing.assert_allclose(reports[0]["pose"], reports[1]["pose"], atol=1e-3)
    apart = reports[0]["joint_position"] - reports[1]["joint_position"]
    np.testing.assert_allclose(apart[:, 0], 0.05, atol=1e-6)


def test_what_no_arm_has_that_is_followed_as_it_moves():
    for effect in ("clock_drift:rate=1e-3", "time_offset:offset_s=-0.02"):
        with pytest.raises(InputError, match=r"clock_drift, or a delay below 0: is not emulated; leave it out"):
            Core(body_with(effect), path=PATH)
    with pytest.raises(InputError, match=r"torque_ripple:joint2.*: is not emulated; leave it out"):
        Core(body_with("torque_ripple:joint=2,order=3,amplitude_Nm=1,phase_rad=0"), path=PATH)
    other = load_bundled("xarm7")
    servos = servos_with_effects(other, (), RecordingSettings(arm=other.name, servo=usual_servo(other)))
    with pytest.raises(InputError, match="lite6: has 6 joints, and servos of 7; give those of this arm"):
        EmulatedArm(ARM, ARM.kinematics, servos=servos)


def test_a_recording_of_it_is_diagnosed_as_a_log_of_commands(tmp_path):
    """Over its sockets: what is recorded has commands beside joints, and the hidden effects are found."""
    body = body_with("command_delay:joint=2,delay_s=0.02", "coulomb_friction:joint=2,coulomb_Nm=3")
    with emulated(body, path=PATH) as (_, address):
        station = read_station(address, ARM, "lite6")
        record(address, tmp_path / "run.csv", station, seconds=DURATION - 0.5)
    log = read_recording(tmp_path / "run.csv")
    assert log.commanded_position is not None
    assert np.abs(log.commanded_position - log.joint_position).max() > 0.01
    # encoders of the emulator have no noise, and what rollouts of a light wrist differ by is declared in its place
    settings = replace(log.settings, servo=SERVO, joint_noise_rad=1e-4)
    write_settings(settings, tmp_path / "run.yaml", overwrite=True)
    named = {(finding["effect"], finding["site"]): finding["parameters"] for finding in diagnose(tmp_path)["findings"]}
    assert set(named) == {("command_delay", "joint2"), ("coulomb_friction", "joint2")}
    assert named["command_delay", "joint2"]["delay_s"]["value"] == pytest.approx(0.02, abs=2e-4)
    assert named["coulomb_friction", "joint2"]["coulomb_Nm"]["value"] == pytest.approx(3, rel=0.02)


def diagnose(folder):
    """The document of `run.csv`, by a process whose code is compiled to run fast: rollouts take longer than that."""
    command = [sys.executable, "-m", "lite6jax.cli", "diagnose", "run.csv", "--tracking", "--quick"]
    environment = os.environ | {"XLA_FLAGS": "", "PYTHONPATH": os.pathsep.join(sys.path)}
    options = ["--processes", "1", "--out", "d.json"]
    subprocess.run([*command, *options], cwd=folder, env=environment, check=True, capture_output=True)
    return json.loads((folder / "d.json").read_text())


# ------------------------------------------------------------------------------------------ as it is typed

TYPED = ("emulate", "--control-port", "15020", "--duration", "0.05")


def test_it_says_its_servos_as_a_sidecar_declares_them(capsys):
    effect = ("--effect", "command_delay:joint=2,delay_s=0.02")
    code, out, err = run(capsys, *TYPED, "--address", "127.0.0.77", "--tracking", *effect, width=200)
    assert (code, err) == (0, "")
    said = flat(out)
    stiffness = ", ".join(f"{size:g}" for size in SERVO.stiffness_Nm_per_rad)
    assert "servo: {stiffness_Nm_per_rad: [" in said
    assert stiffness.split(", ")[0] in said
    assert "Hidden effects, in how the joints follow their commands command_delay at joint2: delay_s = 0.02" in said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--effect", "command_delay:joint=2,delay_s=0.02"], "command_delay: is of servos; add --tracking"),
        (["--tracking", "--effects", "own.py"], "--effects: is of poses, and --tracking of commands; keep one"),
        (["--tracking", "--effect", "joint_backlash:joint=4,gap_rad=1e-3"], "joint_backlash"),
    ],
)
def test_effects_that_do_not_go_together(capsys, arguments, message):
    assert message in refused(capsys, *TYPED, *arguments)
