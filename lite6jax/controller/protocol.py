"""The wire protocol of the controller, as bytes and back, without a socket.

Sources: the vendor's "Private TCP protocol" and "TCP port data" (xArm-Developer/ufactory_docs), and the bytes that
xarm-python-sdk 1.18.4 sends and accepts, with which the tests compare. The numbers of headers are big-endian, floats
little-endian. Joint values are in rad, rad/s and N·m and always seven, those of the arm first.
"""

import struct
from collections.abc import Iterator
from enum import IntEnum, IntFlag
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.array_types import Array

CONTROL_PORT = 502
JOINTS = 7
"""The number of joints in every message, whatever the arm has."""
MM = 1e3
"""Millimetres in a metre."""
STANDARD = 0
PRIVATE = 2
PRIVATE_ALIVE = 3
"""Protocol numbers in the header: Modbus TCP; the vendor's, of all registers here; the same as the SDK numbers it from
firmware 1.8.6 on. A reply repeats the number of its request."""


class MalformedError(ValueError):
    """Bytes that do not follow the protocol."""


class Register(IntEnum):
    """The quantity that a request reads: of the vendor's registers those that are read or emulated here."""

    VERSION = 1
    SERIAL_NUMBER = 2
    CALIBRATION = 8
    STATE = 13
    COMMAND_COUNT = 14
    ERROR_WARNING = 15
    POSE = 41
    JOINTS = 42
    FORWARD_KINEMATICS = 44
    TORQUE = 55


class Status(IntFlag):
    """The status byte of a reply, after its register."""

    OK = 0
    INVALID = 0x08
    CANNOT_MOVE = 0x10
    WARNING = 0x20
    ERROR = 0x40


HEADER = struct.Struct(">HHH")
"""u16 transaction, u16 protocol, u16 length from the register on."""


class Message(NamedTuple):
    """A message on port 502. `body` follows the register: parameters of a request, or status and payload of a reply."""

    register: int
    body: bytes = b""
    transaction: int = 1
    protocol: int = PRIVATE

    def encode(self) -> bytes:
        """The bytes: header, u8 register, body."""
        return HEADER.pack(self.transaction, self.protocol, len(self.body) + 1) + bytes([self.register]) + self.body

    def reply(self, payload: bytes, status: int = Status.OK) -> "Message":
        """The reply to this request."""
        return self._replace(body=bytes([status]) + payload)


def take_frames(received: bytearray) -> Iterator[Message]:
    """Removes the complete frames from the start of `received` and yields them; an incomplete one remains.

    Raises:
        MalformedError: a length of zero, which leaves no byte for the register.
    """
    while len(received) >= HEADER.size:
        transaction, protocol, length = HEADER.unpack_from(received)
        if length == 0:
            raise MalformedError("a frame of length 0")
        end = HEADER.size + length
        if len(received) < end:
            return
        register, *body = received[HEADER.size : end]
        del received[:end]
        yield Message(register, bytes(body), transaction, protocol)


def encode_floats(values: ArrayLike) -> bytes:
    """The values as little-endian fp32."""
    return np.asarray(values, "<f4").tobytes()


def read_floats(payload: bytes, count: int) -> Array:
    """`count` little-endian fp32 values as float64.

    Raises:
        MalformedError: the wrong number of bytes.
    """
    if len(payload) != 4 * count:
        raise MalformedError(f"{len(payload)} bytes of floats; they must be {4 * count}")
    with np.errstate(invalid="ignore"):  # of a signalling NaN, which is then a quiet one
        return np.frombuffer(payload, "<f4").astype(float)


def round_floats(values: ArrayLike) -> Array:
    """The values as the other side reads them: rounded to fp32."""
    return np.asarray(values).astype(np.float32).astype(float)


def pad_joints(values: ArrayLike) -> Array:
    """`(..., 7)` joint values as on the wire: those of the arm `(..., joint)`, then zeros."""
    values = np.asarray(values, float)
    return np.concatenate([values, np.zeros((*values.shape[:-1], JOINTS - values.shape[-1]))], axis=-1)


def encode_pose(transform: ArrayLike) -> Array:
    """`(..., 6)` x y z roll pitch yaw in mm and rad of `(..., 4, 4)` in m; R = Rz(yaw) Ry(pitch) Rx(roll)."""
    return frames.row_from_transform(transform) * [MM, MM, MM, 1, 1, 1]


def encode_axis_angle(transform: ArrayLike) -> Array:
    """`(..., 6)` x y z in mm and rotation vector in rad, its angle within [0, π], of `(..., 4, 4)` in m."""
    T = np.asarray(transform, float)
    return np.concatenate([MM * T[..., :3, 3], Rotation.from_matrix(T[..., :3, :3]).as_rotvec()], -1)


def read_pose(pose: ArrayLike) -> Array:
    """`(..., 4, 4)` in m of `(..., 6)` x y z roll pitch yaw in mm and rad."""
    return frames.transform_from_row(np.asarray(pose, float) / [MM, MM, MM, 1, 1, 1])


class Identity(NamedTuple):
    """Register 1, such as `6,9,LI1006,DL1000,v2.7.1`: the number of joints, the model, the first characters of the
    serial numbers of arm and control box, and the firmware.

    The vendor's numbers of the models are 9 Lite 6, 12 UF 850, 5, 6 and 7 xArm 5, 6 and 7 (3: an older xArm 7).
    """

    dof: int
    type: int
    arm: str
    box: str
    firmware: tuple[int, int, int]

    def encode(self) -> bytes:
        """The payload of register 1."""
        return encode_text(f"{self.dof},{self.type},{self.arm},{self.box},v{'.'.join(map(str, self.firmware))}")


def encode_text(text: str) -> bytes:
    """The payload of registers 1 and 2: 40 bytes padded with NUL. The SDK misreads a text that is not shorter."""
    if len(text) >= 40:
        raise ValueError(f"{text!r} is not shorter than 40 bytes")
    return text.encode("ascii").ljust(40, b"\0")


class Calibration(NamedTuple):
    """Register 8: the calibrated six-parameter chain of the arm, in a reply of 179 bytes.

    `valid` is 0 if the arm was never calibrated, and `dof` and `type` are those of `Identity`. `rows` are `(7, 6)`
    x y z roll pitch yaw of each joint's frame in the previous one, m and rad, with zeros after the arm's.
    """

    valid: int
    dof: int
    type: int
    rows: Array

    def encode(self) -> bytes:
        """The payload of register 8."""
        values = np.zeros((JOINTS, 6))
        values[: len(self.rows)] = self.rows
        return bytes([self.valid, self.dof, self.type]) + encode_floats(values)

    @classmethod
    def decode(cls, payload: bytes) -> "Calibration":
        """The content of register 8, without a check of its values.

        Raises:
            MalformedError: the payload does not have 171 bytes.
        """
        if len(payload) != CALIBRATION_PAYLOAD:
            raise MalformedError(f"{len(payload)} bytes of calibration; they must be {CALIBRATION_PAYLOAD}")
        valid, dof, kind = payload[:3]
        return cls(valid, dof, kind, read_floats(payload[3:], 6 * JOINTS).reshape(JOINTS, 6))


CALIBRATION_PAYLOAD = 3 + 4 * 6 * JOINTS
CALIBRATION_REPLY = 8 + CALIBRATION_PAYLOAD
"""Bytes; 179."""

REALTIME = 30000
NORMAL = 30001
RICH = 30002
REAL = 30003
RATES = {REALTIME: 250.0, NORMAL: 5.0, RICH: 5.0, REAL: 100.0}
"""Hz of each report port."""
LENGTHS = {REALTIME: 784, NORMAL: 145, RICH: 587, REAL: 135}
"""Bytes of each report of firmware 2.7. Reports of other versions are longer or shorter; the first field is the
length."""
LONGEST_REPORT = 4096
"""Bytes; a larger length field is invalid."""

_COMMON = {
    "length": (0, ">u4"), "state_mode": (4, "u1"), "commands": (5, ">u2"), "joint_position": (7, "7<f4"),
    "pose": (35, "6<f4"), "torque": (59, "7<f4"),
}  # fmt: skip
_NORMAL = _COMMON | {
    "brakes": (87, "u1"), "enabled": (88, "u1"), "error": (89, "u1"), "warning": (90, "u1"),
    "tool_offset": (91, "6<f4"), "payload": (115, "4<f4"), "collision_sensitivity": (131, "u1"),
    "teach_sensitivity": (132, "u1"), "gravity_direction": (133, "3<f4"),
}  # fmt: skip
_FIELDS = {
    # joint_… and pose are the vendor's "actual" values
    REALTIME: {
        "length": (0, ">u4"), "time_us": (4, ">u8"), "state_mode": (12, "u1"), "commands": (13, ">u2"),
        "target_position": (32, "7<f4"), "target_velocity": (60, "7<f4"), "target_acceleration": (88, "7<f4"),
        "joint_position": (116, "7<f4"), "joint_velocity": (144, "7<f4"), "joint_acceleration": (172, "7<f4"),
        "current": (200, "7<f4"), "torque": (228, "7<f4"), "target_pose": (424, "6<f4"),
        "target_pose_speed": (448, "6<f4"), "pose": (472, "6<f4"), "pose_speed": (496, "6<f4"),
    },
    NORMAL: _NORMAL,
    # limits are jerk, smallest and largest acceleration, smallest and largest speed; voltage is in 0.01 V
    RICH: _NORMAL | {
        "type": (145, "u1"), "dof": (146, "u1"), "master": (147, "u1"), "slave": (148, "u1"), "version": (151, "S30"),
        "pose_limits": (181, "5<f4"), "joint_limits": (201, "5<f4"), "turn_limits": (221, "2<f4"),
        "servo_status": (229, "14u1"), "temperature": (245, "7i1"), "pose_speed": (252, "<f4"),
        "joint_velocity": (256, "7<f4"), "counter": (284, ">u4"), "world_offset": (288, "6<f4"),
        "voltage": (341, "7>u2"), "current": (355, "7<f4"), "axis_angle": (482, "3<f4"),
    },
    REAL: _COMMON,
}  # fmt: skip


@cache
def report_layout(port: int, length: int | None = None) -> np.dtype:
    """The fields of a report as a NumPy record type, by name and offset.

    Fields beyond the length in bytes are omitted; None is that of firmware 2.7.

    Raises:
        MalformedError: the length is too short for the fields that every report of the port has.
    """
    if length is None:
        length = LENGTHS[port]
    fields = [(name, np.dtype(kind), offset) for name, (offset, kind) in _FIELDS[port].items()]
    fields = [field for field in fields if field[2] + field[1].itemsize <= length]
    if ("pose" if port == REALTIME else "torque") not in [name for name, *_ in fields]:
        raise MalformedError(f"a report of {length} bytes on port {port}; it has {LENGTHS[port]}")
    names, formats, offsets = zip(*fields, strict=True)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": length})


def take_reports(received: bytearray) -> Iterator[bytes]:
    """Removes the complete reports from the start of `received` and yields them; an incomplete one remains.

    Raises:
        MalformedError: an invalid length field, so that the stream does not start with a report.
    """
    while len(received) >= 4:
        length = int.from_bytes(received[:4], "big")
        if not 4 < length <= LONGEST_REPORT:
            raise MalformedError(f"a report of {length} bytes")
        if len(received) < length:
            return
        report = bytes(received[:length])
        del received[:length]
        yield report
