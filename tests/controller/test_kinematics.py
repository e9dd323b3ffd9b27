"""Poses that a controller computes: what is asked, and the calibration beside them: the floor, the gate, tools."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from live import ARM, KINEMATICS, emulated, serving, snapshot

from lite6jax.arms.factory import FactoryCalibration
from lite6jax.controller import kinematics, protocol
from lite6jax.controller.connection import ControlPort
from lite6jax.controller.kinematics import FLOOR_M, GATE_M, compute_poses, verify
from lite6jax.emulator import Faults
from lite6jax.errors import InputError
from tests.oracles.chains import six_parameter_poses

Q = np.array([[0.3, -0.4, 1.2, 0.5, -0.6, 0.7]])
IDENTITY = protocol.Identity(6, 9, "LI1006", "DL1000", (2, 7, 1)).encode()
COUNTING = np.arange(6, dtype="<f4").tobytes()


def answering(*answers):
    """A controller that says who it is, and gives these replies, or what they return, to requests of poses."""
    waiting, asked = list(answers), []

    def answer(line):
        received = bytearray()
        while piece := line.recv(4096):
            received += piece
            for frame in protocol.take_frames(received):
                asked.append(frame.register)
                if frame.register == 1:
                    line.sendall(frame.reply(IDENTITY).encode())
                    continue
                said = waiting.pop(0) if waiting else lambda frame: frame.reply(COUNTING).encode()
                if (message := said(frame)) is None:
                    return
                line.sendall(message)

    return serving(answer), asked


def test_only_registers_that_read_are_asked_and_the_arm_does_not_move():
    with emulated(faults=Faults(warning=11)) as (controller, address):
        before = snapshot(controller)
        poses, failure, version = compute_poses(address, np.repeat(Q, 3, 0))
        seen = snapshot(controller)
    assert (failure, version, len(poses)) == ("", "6,9,LI1006,DL1000,v2.7.1", 3)
    assert seen.requests == {1: 1, 44: 3}
    assert seen.state == before.state
    np.testing.assert_array_equal(seen.joints, before.joints)


@pytest.mark.parametrize(
    ("payload", "status", "says"),
    [
        (np.full(6, np.nan, "<f4").tobytes(), 0, "a pose that is not finite"),
        (np.ones(6, "<f4").tobytes(), 0x08, "the controller calls it invalid"),
        (bytes(112), 0x08, "the controller calls it invalid"),
        (b"", 0x08, "the controller calls it invalid"),
    ],
)
def test_a_pose_that_is_none_is_refused_and_the_next_is_asked(payload, status, says):
    server, _ = answering(lambda frame: frame.reply(payload, status).encode())
    with server as address:
        (refused, pose), failure, _ = compute_poses(address, np.repeat(Q, 2, 0))
    assert (refused, failure) == (says, "")
    np.testing.assert_array_equal(pose, np.arange(6))


@pytest.mark.parametrize(
    ("reply", "says"),
    [
        (lambda frame: None, "closed the connection after 0 of 32 bytes; end other"),
        (lambda frame: frame._replace(transaction=7).reply(COUNTING).encode(), "replies with transaction 7, .*; check"),
        (lambda frame: frame.reply(bytes(10)).encode(), "replies with a reply of 12 bytes, not 26 .*; check that"),
        (lambda frame: b"\0", r"stopped replying after 1 of 32 bytes; check the cable"),
    ],
)
def test_a_row_is_asked_again_over_a_new_connection(reply, says, monkeypatch):
    monkeypatch.setattr(kinematics, "ControlPort", partial(ControlPort, seconds=0.3))
    monkeypatch.setattr(kinematics, "RETRY_S", 0.01)
    right = lambda frame: frame.reply(COUNTING).encode()  # noqa: E731
    server, asked = answering(right, reply)
    with server as address:
        poses, failure, _ = compute_poses(address, np.repeat(Q, 3, 0))
    assert (len(poses), failure) == (3, "")
    assert asked == [1, 44, 44, 1, 44, 44]
    server, asked = answering(right, *[reply] * 9)
    with server as address:
        poses, failure, _ = compute_poses(address, np.repeat(Q, 3, 0))
    assert len(poses) == 1
    assert asked.count(1) == 1 + kinematics.TRIES
    assert re.match(f"{address}: {says}", failure)


TOOL = [10.0, -20.0, 150.0, 0.1, -0.2, 0.3]


def calibration(kinematics=KINEMATICS):
    return FactoryCalibration(np.array(kinematics), ARM, ARM.T_joint_flange, "arm")


def test_the_precision_floor():
    with emulated() as (controller, address):
        found = verify(calibration(), address, samples=1500)
        assert set(snapshot(controller).requests) == {1, 44}
    assert found.passed
    assert found.position.max() <= FLOOR_M
    assert found.position.mean() < 2e-8
    assert found.orientation.max() < 6e-7
    # joints that are rounded on the wire cost more than poses that are
    assert found.position_unrounded.max() < 1.6e-7
    np.testing.assert_allclose(found.position_unrounded.mean(), 3.4e-8, rtol=0.15)
    limits = ARM.joint_limits
    assert (found.joint_position >= limits[:, 0]).all()
    assert (found.joint_position <= limits[:, 1]).all()
    assert found.version == "6,9,LI1006,DL1000,v2.7.1"
    assert found.tool == "none"


def test_another_chain_does_not_pass():
    with emulated(faults=Faults(nominal_kinematics=True)) as (_, address):
        found = verify(calibration(), address, samples=60)
    assert not found.passed
    assert (found.hidden_tool, found.other_chain) == (None, "lite6")
    q = found.joint_position.astype(np.float32).astype(float)
    apart = six_parameter_poses(KINEMATICS, q)[:, :3, 3] - six_parameter_poses(ARM.kinematics, q)[:, :3, 3]
    np.testing.assert_allclose(found.position, np.linalg.norm(apart, axis=1), atol=2e-7)


def test_a_tool_is_taken_into_account():
    with emulated(tool=TOOL) as (_, address):
        found = verify(calibration(), address, samples=40)
    assert found.passed
    assert found.tool == "applied"
    np.testing.assert_allclose(found.condition.tool_offset, TOOL, atol=1e-5)
    assert found.tool_agrees[0] < GATE_M


def report_with(monkeypatch, tool):
    """Lets the slow report say another tool than the controller computes with."""
    read = kinematics.read_condition
    changed = lambda address: replace(read(address), tool_offset=np.array(tool))  # noqa: E731
    monkeypatch.setattr(kinematics, "read_condition", changed)


def test_a_tool_that_the_kinematics_leave_out_is_said(monkeypatch):
    report_with(monkeypatch, TOOL)
    with emulated() as (_, address):
        found = verify(calibration(), address, samples=20)
    assert found.passed
    assert found.tool == "omitted by the controller"


def test_a_tool_that_no_report_shows_is_found(monkeypatch):
    report_with(monkeypatch, np.zeros(6))
    with emulated(tool=TOOL) as (_, address):
        found = verify(calibration(), address, samples=50)
    assert not found.passed
    assert found.tool_agrees[0] > 0.1
    np.testing.assert_allclose(found.hidden_tool, TOOL, atol=1e-3)


@pytest.mark.parametrize(
    ("faults", "says"),
    [
        (Faults(error=22), "reports error 22, .*; clear the error"),
        (Faults(silent_reports=True), r"port 30002: no report within 0\.4 s; check"),
        (Faults(nan=frozenset({"kinematics"})), "gives a pose that is not finite"),
        (Faults(nan=frozenset({"reports"})), "joint position is not finite; restart"),
    ],
)
def test_what_cannot_be_verified_says_why(faults, says, monkeypatch):
    monkeypatch.setattr(kinematics, "read_condition", partial(kinematics.read_condition, seconds=0.4))
    with emulated(faults=faults) as (_, address), pytest.raises(InputError, match=says) as error:
        verify(calibration(), address, samples=5)
    assert str(error.value).startswith(address.host)
