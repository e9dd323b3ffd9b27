"""The wire format against bytes written by hand, the vendor's printed examples, and the structures of the SDK."""

import ctypes
import struct

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

from lite6jax.controller import protocol
from lite6jax.controller.protocol import Calibration, MalformedError, Message, Register


def bytes_of(text):
    return bytes.fromhex(text)


# Requests and replies as the vendor's "Private TCP protocol" prints them.
ENABLE = bytes_of("00 01 00 02 00 03 0B 08 01")


def only(received):
    buffer = bytearray(received)
    (frame,) = protocol.take_frames(buffer)
    assert not buffer
    return frame


def test_a_request_is_header_register_and_parameters():
    assert protocol.Message(11, bytes([8, 1])).encode() == ENABLE
    assert only(ENABLE) == Message(11, b"\x08\x01")
    # the calibration read of the vendor's own script
    assert protocol.Message(Register.CALIBRATION).encode() == bytes([0, 1, 0, 2, 0, 1, 8])
    assert protocol.Message(13, transaction=0x1234, protocol=3).encode() == bytes_of("12 34 00 03 00 01 0D")


@given(st.lists(st.tuples(st.integers(0, 65535), st.integers(0, 255), st.binary(max_size=60)), max_size=5), st.data())
def test_frames_survive_any_fragmentation(messages, data):
    frames = [Message(register, body, transaction) for transaction, register, body in messages]
    stream = b"".join(frame.encode() for frame in frames)
    buffer, found, sent = bytearray(), [], 0
    while sent < len(stream):
        size = data.draw(st.integers(1, len(stream) - sent))
        buffer += stream[sent : sent + size]
        sent += size
        found += protocol.take_frames(buffer)
    assert found == frames
    assert not buffer


def test_the_calibration_reply_is_179_bytes():
    rows = np.arange(36.0).reshape(6, 6) / 64  # exact in fp32
    message = protocol.Message(Register.CALIBRATION).reply(Calibration(1, 6, 9, rows).encode()).encode()
    assert len(message) == 179 == protocol.CALIBRATION_REPLY
    assert message[:11] == bytes_of("00 01 00 02 00 AD 08 00 01 06 09")
    assert message[11:] == struct.pack("<42f", *rows.ravel(), *[0] * 6)
    read = Calibration.decode(only(message).body[1:])
    assert read[:3] == (1, 6, 9)
    np.testing.assert_array_equal(read.rows, [*rows, np.zeros(6)])
    with pytest.raises(MalformedError, match="170 bytes"):
        Calibration.decode(bytes(170))


def test_poses_are_millimetres_and_fixed_angles():
    rng = np.random.default_rng(1)
    angles = np.concatenate([rng.uniform(-np.pi, np.pi, (50, 3)) * [1, 0.499, 1], [[0.3, np.pi / 2, 0.0]]])
    T = np.tile(np.eye(4), (51, 1, 1))
    T[:, :3, :3] = Rotation.from_euler("xyz", angles).as_matrix()  # lower case: about fixed axes
    T[:, :3, 3] = rng.normal(size=(51, 3))
    pose = protocol.encode_pose(T)
    np.testing.assert_allclose(pose[:, :3], 1000 * T[:, :3, 3], rtol=1e-15)
    np.testing.assert_allclose(pose[:50, 3:], angles[:50], atol=1e-12)
    np.testing.assert_allclose(protocol.read_pose(pose), T, atol=1e-14)
    rotation_vector = protocol.encode_axis_angle(T)
    np.testing.assert_allclose(rotation_vector[:, 3:], Rotation.from_matrix(T[:, :3, :3]).as_rotvec(), atol=1e-12)
    np.testing.assert_array_equal(rotation_vector[:, :3], pose[:, :3])


SDK_NAMES = {
    30000: {
        "length": "data_size", "time_us": "timestamp", "state_mode": "state_mode", "commands": "cmd_num",
        "target_position": "target_joint_angle", "target_velocity": "target_joint_velocity",
        "target_acceleration": "target_joint_acceleration", "joint_position": "actual_joint_angle",
        "joint_velocity": "actual_joint_velocity", "joint_acceleration": "actual_joint_acceleration",
        "current": "actual_joint_current", "torque": "estimated_joint_torque", "target_pose": "target_tcp_pose",
        "target_pose_speed": "target_tcp_speed", "pose": "actual_tcp_pose", "pose_speed": "actual_tcp_speed",
    },
    30002: {
        "length": "data_size", "state_mode": "state_mode", "commands": "cmd_num",
        "joint_position": "actual_joint_angle", "pose": "actual_tcp_pose", "torque": "estimated_joint_torque",
        "brakes": "motor_brake_status", "enabled": "motor_enable_status", "error": "error_code",
        "warning": "warn_code", "tool_offset": "tcp_offset", "payload": "tcp_payload",
        "collision_sensitivity": "collision_sens", "teach_sensitivity": "teaching_sens",
        "gravity_direction": "gravity_direction", "type": "robot_type", "dof": "robot_axis", "master": "master_id",
        "slave": "slave_id", "version": "version", "servo_status": "servo_status_codes",
        "temperature": "temperatures", "pose_speed": "target_tcp_speed", "joint_velocity": "target_joint_speed",
        "counter": "counter", "world_offset": "world_offset", "voltage": "joint_voltages",
        "current": "joint_currents", "axis_angle": "axis_angle",
    },
}  # fmt: skip
SDK_NAMES[30001] = {ours: theirs for ours, theirs in SDK_NAMES[30002].items() if ours in (
    protocol.report_layout(30001).names or ())}  # fmt: skip
SDK_NAMES[30003] = {name: SDK_NAMES[30002][name] for name in protocol.report_layout(30003).names or ()}
GROUPED = {"pose_limits": ("tcp_jerk", 20), "joint_limits": ("joint_jerk", 20), "turn_limits": ("rot_jerk", 8)}


@pytest.mark.parametrize("port", list(protocol.RATES))
def test_reports_are_laid_out_as_the_sdk_reads_them(port, sdk_reports):
    theirs = type(sdk_reports.create(port))
    layout = protocol.report_layout(port)
    assert layout.fields is not None
    for name in layout.names or ():
        dtype, offset = layout.fields[name][:2]
        if name in GROUPED:
            first, size = GROUPED[name]
            assert (offset, dtype.itemsize) == (getattr(theirs, f"_{first}").offset, size)
            continue
        field = getattr(theirs, f"_{SDK_NAMES[port][name]}")
        assert (offset, dtype.itemsize) == (field.offset, field.size), name
    whole = ctypes.sizeof(theirs)
    # newer firmware appends general inputs and outputs to port 30000
    assert layout.itemsize == {30000: whole - 20}.get(port, whole)


@pytest.mark.parametrize("start", [b"\0\0\0\0", b"\0\0\0\4", b"\xff\0\0\0", b"GET "])
def test_a_stream_that_is_none_is_refused(start):
    with pytest.raises(MalformedError, match="a report of"):
        list(protocol.take_reports(bytearray(start + bytes(100))))
