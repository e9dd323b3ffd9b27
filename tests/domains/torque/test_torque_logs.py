"""Torque logs as people have them: real friction, rests, uneven times, static postures, one motor, any rate."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from lite6jax.arms.urdf import read_urdf
from lite6jax.cli import main
from lite6jax.diagnosis.document import write_document
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
from lite6jax.domains.predict import predicted
from lite6jax.domains.torque.filtering import low_pass
from lite6jax.domains.torque.problem import torque_problem
from lite6jax.domains.torque.rows import bodies_of
from lite6jax.domains.torque.screening import contacts, screen_torques
from lite6jax.effects.dynamic import CoulombFriction, LoadFriction, TorqueOffset, TorqueScale, ViscousFriction
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.report.faults import fault_statement
from lite6jax.report.statements import with_statements

FEW = Options(folds=2)
PENDULUM = """<robot name="pendulum"><link name="base"/>
<link name="l1"><inertial><origin xyz="{length} 0 0"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="{kind}"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="40" velocity="9"/></joint></robot>"""
NOISE = 0.02


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "pendulum.urdf"
    path.write_text(PENDULUM.format(length=0.25, kind="revolute"))
    return read_urdf(path)


def swung(time):
    """Position, velocity and acceleration of a motion of up to 1 Hz."""
    q, dq, ddq = (np.zeros_like(time) for _ in range(3))
    for size, hertz, phase in ((0.7, 0.11, 0.3), (0.4, 0.31, 1.1), (0.2, 0.83, 2.0)):
        w = 2 * np.pi * hertz
        q += size * np.sin(w * time + phase)
        dq += size * w * np.cos(w * time + phase)
        ddq -= size * w**2 * np.sin(w * time + phase)
    return q, dq, ddq


def rigid(q, ddq, length=0.25):
    """Of a mass of 2 kg on a horizontal axis along +y, with its own inertia."""
    return (0.02 + 2 * length**2) * ddq - 2 * 9.81 * length * np.cos(q)


def made(time, moved, friction, seed=0, stamps=None, velocity_noise=1e-3):
    q, dq, ddq = moved
    rng = np.random.default_rng(seed)
    return Recording.from_arrays(
        (q + rng.normal(0, 2e-5, len(q)))[:, None],
        time=time if stamps is None else stamps,
        joint_velocity=(dq + rng.normal(0, velocity_noise, len(q)))[:, None],
        joint_torque=(rigid(q, ddq) + friction(dq) + rng.normal(0, NOISE, len(q)))[:, None],
        motion="trajectory",
    )


def both(dq):
    return 0.6 * np.sign(dq) + 0.15 * dq


def numbers(found):
    return {finding.effect: finding.parameters for finding in found.findings}


@pytest.fixture(scope="module")
def diagnosed(arm):
    time = np.arange(2000) / 100
    return diagnose_torques(made(time, swung(time), both), arm, options=FEW)


def test_the_two_names_of_a_joints_friction_are_named_and_exported(diagnosed, arm, tmp_path):
    said = numbers(diagnosed)
    assert set(said) == {CoulombFriction(1), ViscousFriction(1)}
    assert said[CoulombFriction(1)]["coulomb_Nm"].value == pytest.approx(0.6, abs=0.02)
    assert said[ViscousFriction(1)]["viscous_Nm_s_per_rad"].value == pytest.approx(0.15, abs=0.02)
    write_document(with_statements(diagnosed.to_dict()), tmp_path / "d.json")
    assert main(["convert", str(tmp_path / "d.json"), str(tmp_path / "out.urdf")]) == 0
    (entry,) = ET.parse(tmp_path / "out.urdf").getroot().iter("dynamics")
    assert float(entry.get("friction", "")) == pytest.approx(0.6, abs=0.02)
    assert float(entry.get("damping", "")) == pytest.approx(0.15, abs=0.02)


def test_a_wide_transition_of_coulomb_friction_is_a_number_of_it(arm, tmp_path):
    time = np.arange(3000) / 100
    found = diagnose_torques(made(time, swung(time), lambda dq: 0.6 * np.tanh(dq / 0.2)), arm, options=FEW)
    ((effect, parameters),) = numbers(found).items()
    assert isinstance(effect, CoulombFriction)
    assert parameters["coulomb_Nm"].value == pytest.approx(0.6, abs=0.02)
    assert parameters["transition_rad_per_s"].value == pytest.approx(0.2, abs=0.03)
    document = with_statements(found.to_dict())
    assert "transition" in document["findings"][0]["statement"]
    write_document(document, tmp_path / "d.json")
    assert main(["convert", str(tmp_path / "d.json"), str(tmp_path / "out.urdf")]) == 0


@pytest.mark.parametrize("exponent", [pytest.param(0.6, marks=pytest.mark.long), 1.6])
def test_an_exponent_of_viscous_friction_is_a_number_of_it(arm, tmp_path, exponent):
    time = np.arange(3000) / 100
    found = diagnose_torques(
        made(time, swung(time), lambda dq: 0.5 * np.sign(dq) * np.abs(dq) ** exponent), arm, options=FEW
    )
    ((effect, parameters),) = numbers(found).items()
    assert isinstance(effect, ViscousFriction)
    for name, truth in (("viscous_Nm_s_per_rad", 0.5), ("exponent", exponent)):
        assert abs(parameters[name].value - truth) < 4 * parameters[name].std
        assert parameters[name].std < 0.05
    write_document(with_statements(found.to_dict()), tmp_path / "d.json")
    assert main(["convert", str(tmp_path / "d.json"), str(tmp_path / "out.urdf")]) == 0
    (entry,) = ET.parse(tmp_path / "out.urdf").getroot().iter("dynamics")
    dq = np.linspace(-1, 1, 2001) * np.abs(swung(time)[1]).max()
    X = np.stack([dq, np.sign(dq)], 1)
    best, _ = nnls(X, 0.5 * np.sign(dq) * np.abs(dq) ** exponent)
    assert float(entry.get("damping", "")) == pytest.approx(
        best[0], abs=0.02
    )  # what fits it in proportion to the speed


def test_a_gear_that_loses_more_when_it_is_driven_is_told_by_its_efficiencies(arm):
    time = np.arange(3000) / 100
    q, dq, ddq = swung(time)
    load = rigid(q, ddq)
    measured = np.where(load * dq > 0, load / 0.8, load * 0.65)
    recording = replace(
        made(time, (q, dq, ddq), both),
        joint_torque=(measured + np.random.default_rng(3).normal(0, NOISE, len(q)))[:, None],
    )
    found = diagnose_torques(recording, arm, options=FEW)
    assert {type(effect) for effect in numbers(found)} == {LoadFriction, TorqueScale}
    document = with_statements(found.to_dict())
    (said,) = [one["statement"] for one in document["findings"] if one["effect"] == "load_friction"]
    (driving, std, driven, other) = map(float, re.findall(r"(\d+\.\d+)", said.partition("efficiency")[2]))
    assert abs(driving - 80) < 4 * std < 4
    assert abs(driven - 65) < 4 * other < 4


def test_friction_at_rest_says_little_of_friction_in_motion(arm):
    # a quarter of a turn and back with rests, in which friction holds the joint anywhere within its band
    time = np.arange(3000) / 100
    phase = np.mod(time, 10.0)
    going = np.clip(phase, 0, 3) - np.clip(phase - 5, 0, 3)
    q = 1.5 * np.sin(np.pi * going / 6) ** 2
    dq = np.gradient(q, time)
    ddq = np.gradient(dq, time)
    held = np.repeat(np.random.default_rng(1).uniform(-0.5, 0.5, 600), 250)[: len(time)]
    moving = np.abs(dq) > 1e-3
    recording = made(time, (q, dq, ddq), lambda v: np.where(moving, both(v), held), velocity_noise=1e-4)
    found = diagnose_torques(recording, arm, options=FEW)
    assert "held_by_friction" in {fault.code for fault in found.faults}
    said = numbers(found)
    assert set(said) == {CoulombFriction(1), ViscousFriction(1)}
    assert said[CoulombFriction(1)]["coulomb_Nm"].value == pytest.approx(0.6, abs=0.03)
    # nor does it say how large the noise is, which decides what is significant
    assert found.to_dict()["noise"]["estimated"]["torque_Nm"][0] == pytest.approx(NOISE, rel=0.15)


def test_a_quiet_rest_is_no_contact_and_leaves_the_motion_beside_it(arm):
    time = np.arange(2000) / 100
    going = np.clip(time, 0, 9) + np.clip(time - 12, 0, 8)  # three seconds of rest in a slow motion
    phase = 0.4 * going
    speed = np.where((time > 9) & (time < 12), 0.0, 0.4)
    q, dq, ddq = np.sin(phase), speed * np.cos(phase), -(speed**2) * np.sin(phase)
    held = np.where(speed > 0, both(dq), 0.35)
    recording = made(time, (q, dq, ddq), lambda _: held, velocity_noise=1e-4)
    recording = replace(recording, joint_torque=(rigid(q, ddq) + held + 1e-3 * np.sin(900 * time))[:, None])
    data = screen_torques(recording, arm).data
    pushed, events = contacts(torque_problem(data), Options().engine)
    assert (pushed.sum(), events) == (0, [])
    assert data.repeated is not None
    assert np.flatnonzero(data.repeated).min() > 890
    assert np.flatnonzero(data.repeated).max() < 1210


def test_a_bias_of_the_velocity_is_subtracted_and_said(arm):
    time = np.arange(3000) / 100
    going = np.clip(np.mod(time, 10.0), 0, 3) - np.clip(np.mod(time, 10.0) - 5, 0, 3)
    q = 1.5 * np.sin(np.pi * going / 6) ** 2
    dq = np.gradient(q, time)
    biased = made(time, (q, dq, np.gradient(dq, time)), both, velocity_noise=1e-4)
    assert biased.joint_velocity is not None
    biased = replace(biased, joint_position=q[:, None], joint_velocity=biased.joint_velocity - 0.005)
    screened = screen_torques(biased, arm)
    (fault,) = [one for one in screened.found if one.code == "velocity_bias"]
    assert fault.numbers["joints"] == [1]
    assert fault.numbers["bias_rad_per_s"][0] == pytest.approx(-0.005, abs=2e-4)
    still = screen_torques(made(time, swung(time), both), arm)
    assert "velocity_bias" not in {one.code for one in still.found}


def test_a_dead_zone_of_the_velocity_is_filled_from_the_positions_and_said(arm):
    time = np.arange(3000) / 100
    whole = made(time, swung(time), both, velocity_noise=1e-4)
    assert whole.joint_velocity is not None
    zone = np.where(np.abs(whole.joint_velocity) < 0.05, 0.0, whole.joint_velocity)
    screened = screen_torques(replace(whole, joint_velocity=zone), arm)
    (fault,) = [one for one in screened.found if one.code == "velocity_dead_zone"]
    assert fault.numbers["joints"] == [1]
    assert fault.numbers["width_rad_per_s"][0] == pytest.approx(0.05, abs=5e-3)
    filled = screened.data.recording.joint_velocity
    assert filled is not None
    assert np.abs(filled - whole.joint_velocity).max() < 0.02
    assert "velocity_dead_zone" not in {one.code for one in screen_torques(whole, arm).found}


@pytest.mark.parametrize("reason", ["samples", "stamps"])
def test_uneven_times_are_made_even_and_said(arm, reason):
    even = np.arange(1200) / 50
    jitter = np.sort(even + np.random.default_rng(2).uniform(-0.008, 0.008, len(even)))
    recording = (
        made(jitter, swung(jitter), both) if reason == "samples" else made(even, swung(even), both, stamps=jitter)
    )
    (fault,) = [fault for fault in screen_torques(recording, arm).found if fault.code == "uneven_times"]
    assert fault.numbers["reason"] == reason
    assert fault.numbers["rate_Hz"] == pytest.approx(50, rel=0.05)
    assert ("resampled to" if reason == "samples" else "the stamps jitter") in fault_statement(fault)
    if reason == "stamps":
        return
    found = diagnose_torques(recording, arm, options=FEW)
    friction = {type(effect): (effect, values) for effect, values in numbers(found).items()}
    assert set(friction) == {CoulombFriction, ViscousFriction}
    coulomb, values = friction[CoulombFriction]
    assert (coulomb.fixed_number or 0.0) <= 0.02  # interpolation passes a reversal in steps of a fiftieth of a second
    assert values["coulomb_Nm"].value == pytest.approx(0.6, abs=0.03)


def test_torques_are_predicted_at_uneven_times(diagnosed):
    uneven = np.sort(np.arange(600) / 50 + np.random.default_rng(5).uniform(-0.008, 0.008, 600))
    uneven = np.delete(uneven, np.arange(200, 300))  # two seconds are missing
    q, dq, ddq = swung(uneven)
    found = predicted(diagnosed.model, Recording.from_arrays(q[:, None], time=uneven, motion="trajectory"))
    assert found.std is not None
    assert found.outside is not None
    there = np.isfinite(found.torque[:, 0])
    assert there.mean() > 0.95
    assert found.outside[~there].all()
    off = (found.torque[:, 0] - rigid(q, ddq) - both(dq))[there]
    assert np.sqrt(np.mean(off**2)) < 0.1  # where the joint turns friction jumps by 1.2 Nm
    assert np.median(np.abs(off)) < 0.03


def test_gaps_that_are_too_long_for_the_motion_are_not_interpolated(arm):
    rng = np.random.default_rng(3)
    sparse = np.cumsum(rng.exponential(0.4, 400))
    with pytest.raises(InputError, match="gaps too long to interpolate this motion"):
        screen_torques(made(sparse, swung(sparse), both), arm)
    time = np.arange(2000) / 100 + rng.uniform(-0.004, 0.004, 2000)
    kept = (time < 8) | (time > 11)
    recording = made(time[kept], swung(time[kept]), both)
    (fault,) = [one for one in screen_torques(recording, arm).found if one.code == "uneven_times"]
    assert fault.numbers["gaps"] == 1


def test_static_postures_are_a_check_of_gravity(arm, tmp_path):
    rng = np.random.default_rng(4)
    q = rng.uniform(-2.5, 2.5, 40)
    torque = rigid(q, np.zeros(40)) + 0.8 + rng.normal(0, NOISE, 40)
    recording = Recording.from_arrays(q[:, None], joint_torque=torque[:, None], motion="static")
    found = diagnose_torques(recording, arm, options=FEW)
    ((effect, parameters),) = numbers(found).items()
    assert effect == TorqueOffset(1)
    assert parameters["offset_Nm"].value == pytest.approx(0.8, abs=0.02)
    document = with_statements(found.to_dict())
    assert document["filter"] is None
    assert {item["effect"] for item in document["untestable"]} >= {"coulomb_friction", "rotor_inertia"}
    few = recording.select(np.arange(8))
    with pytest.raises(InputError, match="holds 8 static postures; record 12 or more"):
        screen_torques(few, arm)


def test_the_same_motion_is_cut_alike_at_every_rate(arm):
    cuts = []
    for rate in (1000, 500, 250, 100):
        time = np.arange(20 * rate) / rate
        # a controller that differentiates positions and low-passes at 60 Hz leaves noise that is not white
        moved = swung(time)
        recording = made(time, moved, both, velocity_noise=2e-3 * np.sqrt(rate / 100))
        _, chosen, motion_cutoff = bodies_of(recording, arm)
        cuts.append((chosen.cutoff, motion_cutoff, rate / chosen.every))
    cutoff, motion, kept = np.transpose(cuts)
    assert np.ptp(cutoff) < 0.35 * cutoff.min()
    assert np.ptp(motion) < 0.35 * motion.min()
    assert np.ptp(kept) < 0.35 * kept.min()
    assert low_pass(np.zeros((1, 2000)), 100.0, np.zeros(2000, int)).cutoff > 0


def test_a_table_of_one_motor_that_turns_without_end(tmp_path, capsys):
    (tmp_path / "motor.urdf").write_text(PENDULUM.format(length=0, kind="continuous"))
    time = np.arange(600) / 50
    dq = 0.2 + 11 * np.abs(np.sin(np.pi * time / 6))
    q = np.cumsum(dq) / 50
    torque = 0.34 * np.sign(dq) + 0.021 * dq + 0.02 * np.gradient(dq, time)
    torque += np.random.default_rng(5).normal(0, NOISE, len(time))
    rows = np.column_stack([time, q, dq, torque])
    path = tmp_path / "sweep.csv"
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header="time,position,velocity,torque", comments="")
    assert main(["init", str(path), "--arm", str(tmp_path / "motor.urdf"), "--yes"]) == 0
    assert "the joint turns without end" in " ".join(capsys.readouterr().out.split())
    assert main(["diagnose", str(path), "--quick"]) in (0, 3)
    said = " ".join(capsys.readouterr().out.split())
    assert "Viscous friction at joint1" in said
    assert "contact" not in said
