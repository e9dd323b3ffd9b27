"""Every register as the unmodified SDK asks for it."""

import numpy as np
import pytest
from live import CONTROL_PORT, Line, new_host, until
from scipy.spatial.transform import Rotation

from lite6jax.arms.description import load_bundled
from lite6jax.controller import protocol
from lite6jax.emulator import Body, Controller
from tests.oracles.chains import six_parameter_poses


@pytest.fixture(scope="module")
def controller(lite6):
    with Controller(lite6, address=new_host(), control_port=CONTROL_PORT, speed=5.0) as running:
        yield running


@pytest.fixture(scope="module")
def arm(controller, connect):
    return connect(controller)


@pytest.fixture
def ready(arm, controller):
    """The arm, enabled and without error."""
    controller.call(lambda core: core.__setattr__("error", 0))
    assert arm.motion_enable(True) == 0
    assert arm.set_mode(0) == 0
    assert arm.set_state(0) == 0
    return arm


def pose_difference(pose, T):
    """mm and rad between wire poses `(..., 6)` and transforms `(..., 4, 4)` in metres."""
    pose = np.asarray(pose)
    turn = Rotation.from_euler("xyz", pose[..., 3:]).inv() * Rotation.from_matrix(T[..., :3, :3])
    return np.linalg.norm(pose[..., :3] - 1e3 * T[..., :3, 3], axis=-1), turn.magnitude()


# ------------------------------------------------------------------------------------------ who it is


def test_version_and_serial_number(arm):
    assert arm.get_version() == (0, "6,9,LI1006,DL1000,v2.7.1")
    assert (arm.axis, arm.device_type, arm.version_number) == (6, 9, (2, 7, 1))
    assert arm.arm.is_lite6
    assert arm.get_robot_sn() == (0, "LI1006230801E01")
    assert arm.arm.control_box_sn == "DL1000230801E02"


def test_the_calibration_is_served_while_the_sdk_is_connected(arm, controller):
    with Line(controller) as line:
        message = line.ask(8)
    assert len(message) == 179
    assert message[:11] == bytes.fromhex("0001 0002 00AD 08 10 01 06 09".replace(" ", ""))
    rows = np.frombuffer(message[11:], "<f4").reshape(7, 6)
    np.testing.assert_array_equal(rows[:6], controller.body.kinematics.astype(np.float32))
    assert not rows[6].any()
    assert arm.connected


def test_the_dh_table_of_an_xarm6_is_the_one_the_vendor_prints(connect):
    """Register 67 in the vendor's protocol document: modified DH, theta d alpha a of each joint."""
    printed = bytes.fromhex(
        "00000000008085430000000000000000FD44B1BF00000000DB0FC9BF00000000FD44B13F000000000000000049BE904300000000"
        "0040AB43DB0FC9BF00009B420000000000000000DB0FC93F00000000000000000000C242DB0FC9BF0000984200000000000000000000"
        "000000000000"
    )
    expected = np.frombuffer(printed, "<f4").reshape(7, 4)
    nominal = load_bundled("xarm6")
    with Controller(Body(nominal, nominal.kinematics), address=new_host(), control_port=CONTROL_PORT) as controller:
        code, table = connect(controller).get_dh_params()
    assert code == 0
    np.testing.assert_allclose(np.reshape(table, (7, 4)), expected, atol=2e-5)


# ------------------------------------------------------------------------------------------ kinematics


def test_forward_kinematics_at_the_precision_of_the_wire(arm, controller):
    """The floor of lite6.md, through the SDK: joints rounded to fp32 on the way there, the pose on the way back.

    The largest of 4000 depends on the draw and the arm: 1.15e-4 to 1.4e-4 mm in twelve draws over four arms.
    """
    lower, upper = controller.body.arm.joint_limits.T
    q = np.random.default_rng(4).uniform(lower, upper, (4000, 6))
    T = six_parameter_poses(controller.body.kinematics, q)
    T_rounded = six_parameter_poses(controller.body.kinematics, q.astype(np.float32).astype(float))
    codes, poses = zip(*(arm.get_forward_kinematics(joints.tolist()) for joints in q), strict=True)
    assert set(codes) == {0}
    distance, turn = pose_difference(poses, T)
    assert np.quantile(distance, 0.999) < 1.2e-4
    assert distance.max() < 1.4e-4
    assert distance.mean() < 3.4e-5
    assert turn.max() < 1e-6
    assert pose_difference(poses, T_rounded)[0].max() < 3.5e-5


def test_inverse_kinematics_goes_back_through_the_forward_one(arm, controller):
    lower, upper = controller.body.arm.joint_limits.T
    joints = np.random.default_rng(7).uniform(lower, upper, (12, 6))
    for q, near in zip(joints, np.clip(joints + 0.3, lower, upper), strict=True):
        pose = arm.get_forward_kinematics(q.tolist())[1]
        code, found = arm.get_inverse_kinematics(pose)
        assert code == 0
        assert ((found[:6] >= lower - 1e-6) & (found[:6] <= upper + 1e-6)).all()
        back = np.array(arm.get_forward_kinematics(found)[1])
        assert np.linalg.norm(back[:3] - pose[:3]) < 2e-3
        # firmware 2.7.103 on takes a reference to stay near; the SDK decides by the version whether it sends one
        with Line(controller) as line:
            asked = protocol.encode_floats(pose) + b"\1" + protocol.encode_floats(protocol.pad_joints(near))
            given = np.frombuffer(line.send(protocol.Frame(43, asked))[8:], "<f4")
        there = six_parameter_poses(controller.body.kinematics, given[None, :6])[0, :3, 3]
        np.testing.assert_allclose(1e3 * there, pose[:3], atol=2e-3)


def test_tool_offset_and_payload(ready, controller):
    before = ready.get_forward_kinematics([0.1, 0.2, 0.9, 0, 0.3, 0])[1]
    holds = ready.get_joints_torque()[1]
    assert ready.set_tcp_offset([0, 0, 100, 0, 0, 0.5], wait=False) == 0
    assert ready.set_tcp_load(0.5, [0, 0, 30]) == 0
    after = ready.get_forward_kinematics([0.1, 0.2, 0.9, 0, 0.3, 0])[1]
    assert np.linalg.norm(np.subtract(after[:3], before[:3])) == pytest.approx(100, abs=1e-3)
    assert not np.allclose(ready.get_joints_torque()[1], holds, atol=0.05)
    until(lambda: ready.tcp_offset == [0, 0, 100, 0, 0, 0.5])
    until(lambda: ready.tcp_load == [0.5, [0, 0, 30]])
    # the tool is part of inverse kinematics too
    code, q = ready.get_inverse_kinematics(after)
    assert code == 0
    np.testing.assert_allclose(ready.get_forward_kinematics(q)[1][:3], after[:3], atol=2e-3)
    assert ready.set_tcp_offset([0] * 6, wait=False) == 0
    assert ready.set_tcp_load(0, [0, 0, 0]) == 0


# ------------------------------------------------------------------------------------------ states and moves


def test_a_move_takes_the_time_of_its_limits(ready, controller):
    """A trapezoid: way over speed plus speed over acceleration; the emulated clock says how long it took."""
    assert ready.set_servo_angle(angle=[0] * 6, speed=3, wait=True) == 0
    start = controller.snapshot().time
    assert ready.set_servo_angle(angle=[1.0, 0, 0.5, 0, 0, 0], speed=0.5, mvacc=2.0, wait=False) == 0
    assert ready.get_state() == (0, 1)
    moves = controller.call(lambda core: [(move.start, move.end) for move in core.queue])
    assert moves[0][1] - moves[0][0] == pytest.approx(1.0 / 0.5 + 0.5 / 2.0)
    assert start <= moves[0][0] <= start + 2
    until(lambda: ready.get_state() == (0, 2))
    there = [1.0, 0, 0.5, 0, 0, 0, 0]
    np.testing.assert_allclose(ready.get_servo_angle()[1], there, atol=1e-6)
    until(lambda: np.allclose(ready.get_servo_angle(is_real=True)[1], there, rtol=0, atol=1e-6))  # servos follow


def test_a_joint_beyond_its_limit_is_an_error_that_stops_it(ready, controller):
    assert ready.set_servo_angle(angle=[0, 2.7, 1, 0, 0, 0]) == -8  # the SDK looks itself
    message = protocol.Frame(23, protocol.encode_floats([0, 2.7, 1, 0, 0, 0, 0, 1, 1, 0]))
    with Line(controller) as line:
        status = line.send(message)[7]
    assert status & 0x50 == 0x50
    assert ready.get_err_warn_code() == (0, [23, 0])
    assert ready.get_state() == (0, 4)
    assert ready.clean_error() == 0
    assert ready.get_err_warn_code() == (0, [0, 0])
    assert ready.clean_warn() == 0
    assert ready.motion_enable(True) == 0
    assert ready.set_state(0) == 0
    assert ready.get_state() == (0, 2)


# ------------------------------------------------------------------------------------------ what is not emulated


def test_what_is_not_emulated_is_called_invalid(arm, controller):
    assert arm.get_gripper_position()[0] != 0
    with Line(controller) as line:
        assert line.send(protocol.Frame(199))[7] & 8
        assert line.send(protocol.Frame(44, bytes(5)))[7] & 8  # a size that is none
        assert line.send(protocol.Frame(11))[7] & 8
        assert line.send(protocol.Frame(42, b"\7"))[7] & 8
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
