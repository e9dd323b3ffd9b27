"""Who the controller says it is, and what it refuses, as the unmodified SDK reads it."""

import numpy as np
import pytest
from live import CONTROL_PORT, Line, new_host, snapshot

from lite6jax.controller import protocol
from lite6jax.emulator import Controller


@pytest.fixture(scope="module")
def controller(lite6):
    with Controller(lite6, address=new_host(), control_port=CONTROL_PORT, speed=5.0) as running:
        yield running


@pytest.fixture(scope="module")
def arm(controller, connect):
    return connect(controller)


# ------------------------------------------------------------------------------------------ who it is


def test_version_and_serial_number(arm):
    assert arm.get_version() == (0, "6,9,LI1006,DL1000,v2.7.1")
    assert (arm.axis, arm.device_type, arm.version_number) == (6, 9, (2, 7, 1))
    assert arm.arm.is_lite6
    assert arm.get_robot_sn() == (0, "LI1006230801E01")
    assert arm.arm.control_box_sn == "DL1000230801E02"


# ------------------------------------------------------------------------------------------ what is not emulated


def test_what_is_not_emulated_is_called_invalid(arm, controller):
    assert arm.get_gripper_position()[0] != 0
    assert arm.get_dh_params()[0] != 0  # 28 numbers, the longest that the SDK unpacks
    before = snapshot(controller)
    for change in (arm.motion_enable, arm.clean_error, arm.clean_warn):
        assert change() != 0
    after = snapshot(controller)
    assert (before.state, before.joints.tolist()) == (after.state, after.joints.tolist())
    with Line(controller) as line:
        assert line.send(protocol.Message(199))[7] & 8
        assert line.send(protocol.Message(44, bytes(5)))[7] & 8  # a size that is none
        assert line.send(protocol.Message(42, b"\7"))[7] & 8
        assert line.ask(13)[8] in (1, 2, 4, 5)


def test_garbage_on_the_control_port_hangs_up(controller):
    rng = np.random.default_rng(0)
    with Line(controller) as line:
        line.socket.sendall(bytes(64))
        assert line.socket.recv(10) == b""
    for size in range(0, 200, 7):
        with Line(controller) as line:
            line.socket.sendall(rng.bytes(size))
    with Line(controller) as line:
        assert line.ask(13)[6] == 13
