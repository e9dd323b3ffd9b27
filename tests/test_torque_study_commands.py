"""`identify --torque` and `design --torque` as they are typed: what is printed, written and refused."""

import json

import numpy as np
import pytest
from typed import flat, refused, run

from lite6jax.arms.arm import Arm
from lite6jax.arms.files import read_arm, write_arm
from lite6jax.recordings import Recording, RecordingSettings, read_recording, write_recording
from tests.oracles.arms import random_kinematics

SMALL = ("--duration", "4", "--harmonics", "3", "--rate", "50", "--link-radius", "0")


@pytest.fixture
def arm(tmp_path):
    return write_arm(Arm("small", random_kinematics(np.random.default_rng(4), 2)), tmp_path / "small.yaml")


@pytest.fixture
def recorded(tmp_path, arm):
    t = np.arange(300) / 50
    q = np.stack([np.sin(2 * t) + 0.3 * np.sin(5 * t), np.cos(3 * t)], 1)
    dq = np.stack([2 * np.cos(2 * t) + 1.5 * np.cos(5 * t), -3 * np.sin(3 * t)], 1)
    settings = RecordingSettings(arm="small.yaml", motion="trajectory", torque_noise_Nm=(0.2, 0.1))
    made = Recording.assembled(q, time=t, joint_velocity=dq, joint_torque=np.zeros_like(q), settings=settings)
    return write_recording(made, tmp_path / "run.csv")


def test_identify_an_arm(capsys):
    code, said, err = run(capsys, "identify", "lite6", "--torque", width=120)
    assert (code, err) == (0, "")
    text = flat(said)
    assert "lite6, a random motion of 10 s inside the limits, 1001 samples; torques to ±0.05 Nm" in text
    assert "This motion determines all 58 base parameters (36 of the links, 22 of the joints)." in text
    assert "joint1 rotor inertia is confounded with link1 Izz: only their sum is determined." in text
    assert "link2 m·cx + 0.2 link3–6 m" in text
    assert "No torque changes with link1 m, link1 m·cx" in text
    assert "Condition number " in text


def test_identify_a_recording_with_torques(capsys, recorded):
    code, said, err = run(capsys, "identify", recorded)
    assert (code, err) == (0, "")
    text = flat(said)
    assert "small, 300 samples of a recording; torques to ±0.2, 0.1 Nm" in text
    assert "Note: The accelerations were not recorded and come from differences of the velocities over 0.1 s." in text
    document = json.loads(run(capsys, "identify", recorded, "--torque", "--json", "--torque-noise", 0.4, 0.2)[1])
    half = json.loads(run(capsys, "identify", recorded, "--json")[1])
    assert document["schema"] == "lite6jax/torque_identification/1"
    assert document["torque_noise_Nm"] == [0.4, 0.2]
    for one, other in zip(document["base_parameters"], half["base_parameters"], strict=True):
        assert one["std"] == pytest.approx(2 * other["std"])


def test_a_recording_that_shows_little(capsys, tmp_path, arm):
    t = np.arange(200) / 50
    q = np.stack([np.sin(2 * t), np.full(200, 0.5)], 1)
    moving = Recording.assembled(q, time=t, settings=RecordingSettings(arm="small.yaml", motion="trajectory"))
    text = flat(run(capsys, "identify", write_recording(moving, tmp_path / "a.csv"), "--torque")[1])
    assert "Not determined apart from others: " in text
    assert "Joint 2 moves over 0 deg only; move it further." in text
    still = Recording.assembled(
        np.random.default_rng(0).uniform(-2, 2, (50, 2)), settings=RecordingSettings(arm="small.yaml", motion="static")
    )
    text = flat(run(capsys, "identify", write_recording(still, tmp_path / "b.csv"), "--torque")[1])
    assert "The arm stands still in all samples, which show gravity only: record it in motion." in text
    assert "0.05 Nm is assumed" in text


@pytest.mark.long
def test_design_a_motion(capsys, tmp_path, arm):
    out = tmp_path / "motion.csv"
    limits = ("--velocity", "90", "--acceleration", "400", "200")
    code, said, err = run(capsys, "design", arm, "--torque", *SMALL, *limits, "--out", out, "--figures", tmp_path)
    assert (code, err) == (0, "")
    text = flat(said)
    assert "A motion of 4 s from rest to rest, 3 harmonics, 201 samples, up to 90 deg/s and 400 deg/s²" in text
    assert "times smaller than those of a random motion of the same limits (the median of 50)" in text
    assert (tmp_path / "motion_motion.png").stat().st_size > 10_000
    made = read_recording(out)
    assert made.joint_position.shape == (201, 2)
    assert np.abs(made.joint_velocity).max() <= np.deg2rad(90)
    assert (np.abs(made.joint_acceleration).max(0) <= np.deg2rad([400, 200])).all()
    rest = np.stack([made.joint_velocity, made.joint_acceleration])[:, [0, -1]]
    np.testing.assert_allclose(rest, 0, atol=1e-12)
    assert made.settings.motion == "trajectory"
    # what it promises is what `identify` finds of the file
    promised = text.split("log determinant ")[1].split()[0]
    document = json.loads(run(capsys, "identify", out, "--torque", "--json")[1])
    assert document["log_determinant"] == pytest.approx(float(promised), rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--torque", "--duration", "0.1"), "a motion of 0.1 s at 100 samples a second is too short for 5 harmonics"),
        (("--torque", "--velocity", "0"), "velocity limit 0 rad/s: give one number above 0, or 6 of them"),
        (("--torque", "--torque-noise", "0.1", "0.2"), "torque noise 0.1 0.2 Nm: give one standard deviation"),
        (("--torque", "--limit-margin", "900"), "leaves joint1 no room; give a smaller one"),
        (("--torque", "--box", "5000", "0", "0", "6000", "10", "10"), "box refused 100 % of them; widen it"),
        (("--torque", "--poses", "9"), "--torque: designs a motion; leave --poses out"),
        (("--torque", "--sensor", "camera"), "--torque: designs a motion; leave the options of a sensor out"),
        (("--duration", "20"), "--duration: is for torques; add --torque"),
        (("--torque", "--discriminate", "a", "b"), "--torque: designs a motion; leave --discriminate out"),
    ],
)
def test_what_design_refuses(capsys, tmp_path, arguments, says):
    assert says in refused(capsys, "design", "lite6", *arguments, "--out", tmp_path / "motion.csv")
    assert not (tmp_path / "motion.csv").exists()


def test_what_identify_refuses(capsys, tmp_path, recorded):
    assert "--harmonics: is for torques; add --torque" in refused(capsys, "identify", "lite6", "--harmonics", "4")
    assert "torques are studied; leave out --poses" in refused(capsys, "identify", recorded, "--poses", "4")
    assert "gravity" in refused(capsys, "identify", "lite6", "--torque", "--gravity", "nan", "0", "0")
    q = np.zeros((40, 6)) + np.linspace(0, 1, 40)[:, None]
    settings = RecordingSettings(arm="lite6", motion="trajectory")
    untimed = write_recording(Recording.assembled(q, joint_velocity=q, settings=settings), tmp_path / "u.csv")
    assert "has no accelerations; add time_s, or ddq1_rad_per_s2" in refused(capsys, "identify", untimed, "--torque")
    short = Recording.assembled(q[:4], time=np.arange(4.0), settings=settings)
    line = refused(capsys, "identify", write_recording(short, tmp_path / "s.csv"), "--torque")
    assert line == "motion: 4 samples of 6 torques for 58 unknowns; record 10 samples or more"


def test_an_arm_without_inertia_serves(capsys, arm):
    assert read_arm(arm).mass is None
    assert run(capsys, "identify", arm, "--torque")[0] == 0
