"""Every fault as the unmodified SDK and a plain socket meet it, and what refuses to be emulated."""

import math
import socket
import time

import numpy as np
import pytest
from live import CONTROL_PORT, Line, new_host, snapshot, until

from lite6jax.arms.description import load_bundled
from lite6jax.effects.composition import Physics
from lite6jax.effects.serialization import parse_effect
from lite6jax.emulator import Controller, EmulatedArm, Faults, describe_faults, draw_sines, parse_faults
from lite6jax.errors import InputError

Q = [0.1, 0.2, 0.9, 0.3, 0.4, 0.5]


def faulty(body, *texts, **options):
    return Controller(
        body, **{"faults": parse_faults(texts), "address": new_host(), "control_port": CONTROL_PORT} | options
    )


def test_every_fault_can_be_named():
    described = dict(describe_faults())
    for written in described:
        name = written.partition(":")[0]
        assert parse_faults([name]) != Faults()
    assert parse_faults([]) == Faults()
    assert parse_faults(["silence:8", "silence:44", "latency:0.1"]) == Faults(silent=frozenset({8, 44}), latency=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("silense", "no fault 'silense'; did you mean 'silence'? accepted are silence, silent_reports, close_reports"),
        ("silence:x", "fault silence: 'x' is not a whole number from 0 to 255"),
        ("invalid:3", "fault invalid: takes no value; leave '3' out"),
        ("latency:-1", "fault latency: '-1' is not a number of 0 or more"),
        ("latency:nan", "fault latency: 'nan' is not a number of 0 or more"),
        ("nan:here", "fault nan: 'here' is not a place; choose one of calibration, kinematics, reports"),
        ("firmware:2", "fault firmware: '2' is not a version; write it like 1.12.1"),
    ],
)
def test_faults_that_are_none(text, message):
    with pytest.raises(InputError) as raised:
        parse_faults([text])
    assert str(raised.value).startswith(message)


# ------------------------------------------------------------------------------------------ the line


def test_silence(lite6, connect):
    with faulty(lite6, "silence:44") as controller:
        arm = connect(controller)
        arm.arm.set_timeout(0.5)
        start = time.monotonic()
        assert arm.get_forward_kinematics(Q)[0] == 3  # the SDK's "no answer in time"
        assert time.monotonic() - start > 0.45
        assert arm.get_state()[0] == 0
        controller.set_faults(Faults(silent=frozenset({-1})))
        assert arm.get_state()[0] == 3
        with Line(controller) as line:
            line.socket.settimeout(0.2)
            with pytest.raises(TimeoutError):
                line.ask(8)
        controller.set_faults(Faults())
        assert arm.get_state()[0] == 0


# ------------------------------------------------------------------------------------------ the controller


def test_the_invalid_flag_and_old_firmware(lite6, connect):
    with faulty(lite6, "invalid") as controller, Line(controller) as line:
        message = line.ask(8)
        assert len(message) == 179
        assert message[8] == 0
        assert not any(message[11:])
    with faulty(lite6, "firmware:1.11.5") as controller, Line(controller) as line:
        assert line.ask(8)[8] == 0
        assert connect(controller).version_number == (1, 11, 5)
    with faulty(lite6, "firmware:1.12.1") as controller, Line(controller) as line:
        assert connect(controller).version_number == (1, 12, 1)
        line.socket.settimeout(0.2)
        with pytest.raises(TimeoutError):
            line.ask(8)


def test_a_controller_in_error(lite6, connect):
    """lite6.md: in error the SDK's tool offset stays zero, whatever is set."""
    tool = [0, 0, 100, 0, 0, 0]
    with faulty(lite6, "error:2", "warning:11", path=draw_sines(lite6.arm), tool=tool) as controller:
        arm = connect(controller)
        assert snapshot(controller).state == 4  # it does not move
        until(lambda: arm.error_code == 2)
        assert arm.get_err_warn_code() == (0, [2, 11])
        assert arm.tcp_offset == [0] * 6
        code, pose = arm.get_forward_kinematics(Q)  # masked on reads
        assert (code, len(pose)) == (0, 6)
        assert arm.set_servo_angle(angle=Q) == 1
        assert arm.clean_error() != 0  # still there
        controller.set_faults(Faults())
        assert arm.get_err_warn_code() == (0, [0, 0])
        until(lambda: arm.tcp_offset == tool)


# ------------------------------------------------------------------------------------------ how it is run


def test_it_can_be_opened_again_and_leaves_nothing_behind(lite6):
    controller = faulty(lite6)
    for _ in range(2):
        with controller, Line(controller) as line:
            assert line.ask(13)[6] == 13
            before = snapshot(controller).time
            until(lambda before=before: snapshot(controller).time > before + 0.1)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((controller.address, controller.control_port), timeout=1)
    controller.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"address": "localhost"}, "'localhost': is not an address; write it like 127.0.0.1"),
        ({"address": "::1"}, "'::1': is not an address"),
        ({"speed": 0.0}, "speed 0.0: the clock runs forward"),
        ({"control_port": 70000}, "control port 70000: is not a port"),
        ({"tool": [np.nan, 0, 0, 0, 0, 0]}, "tool nan 0 0 0 0 0: is implausible for an arm"),
        ({"payload": [0.5, np.inf, 0, 0]}, "payload 0.5 inf 0 0: is implausible for an arm"),
    ],
)
def test_what_cannot_be(lite6, options, message):
    with pytest.raises(InputError, match=message):
        faulty(lite6, **options)


def test_ports_in_use(lite6):
    with faulty(lite6) as controller:
        with pytest.raises(InputError, match=r"is in use, possibly by another emulator; choose another address"):
            faulty(lite6, address=controller.address).open()
        with pytest.raises(InputError, match="is in use"):
            faulty(lite6, address=controller.address, control_port=0).open()


def test_bodies_that_cannot_be():
    lite6 = load_bundled("lite6")
    with pytest.raises(InputError, match=r"a calibration \(5, 6\); it must be \(6, 6\)"):
        EmulatedArm(lite6, lite6.kinematics[:5])
    for rise in (math.nan, 1000.0):
        with pytest.raises(InputError, match=f"lite6: warms up by {rise:g} K; give at most 100"):
            EmulatedArm(lite6, lite6.kinematics, warm_up=rise)
    effect, values = parse_effect("joint_compliance:joint=7,compliance_rad_per_Nm=1e-5")
    with pytest.raises(InputError, match="acts at joint 7, but the arm has 6"):
        EmulatedArm(lite6, lite6.kinematics, Physics((effect,)), values)
    effect, values = parse_effect("time_offset:offset_s=3")
    with pytest.raises(InputError, match="supports at most 1 s"):
        EmulatedArm(lite6, lite6.kinematics, Physics((effect,)), values)
