"""What the controller says on the wire, byte by byte: frames and registers of port 502, reports of ports 30000-30003.

Pure: bytes in, values out, and back; no socket. Sources: the vendor's "Private TCP protocol" and "TCP port data"
(xArm-Developer/ufactory_docs), and what xarm-python-sdk 1.18.4 reads and writes, which the tests hold this to.

The header's numbers are big-endian, floats and int32 little-endian. On the wire joints are in rad, rad/s and N·m and
always seven, the arm's first; poses are x y z in mm and roll pitch yaw in rad, R = Rz(yaw) Ry(pitch) Rx(roll).
"""

import re
import struct
from collections.abc import Iterator
from enum import IntEnum, IntFlag
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating]

CONTROL_PORT = 502
JOINTS = 7
"""In every message, whatever the arm has."""


class MalformedError(ValueError):
    """Bytes that no controller sends."""


# ---------------------------------------------------------------------------------------------- frames of port 502

STANDARD, PRIVATE, PRIVATE_ALIVE = 0, 2, 3
"""Protocols in the header: Modbus TCP; the vendor's, which all registers here speak; the same, as the SDK says it from
firmware 1.8.6 on. Replies echo it."""


class Register(IntEnum):
    """What a request asks for or sets; the names say which."""

    VERSION = 1
    SERIAL_NUMBER = 2
    CALIBRATION = 8
    MOTION_ENABLE = 11
    SET_STATE = 12
    STATE = 13
    COMMAND_COUNT = 14
    ERROR_WARNING = 15
    CLEAR_ERROR = 16
    CLEAR_WARNING = 17
    SET_MODE = 19
    MOVE_JOINTS = 23
    MOVE_JOINTS_BLENDED = 24
    MOVE_HOME = 25
    SERVO_JOINTS = 29
    SET_TOOL_OFFSET = 35
    SET_PAYLOAD = 36
    SET_COLLISION_SENSITIVITY = 37
    SET_TEACH_SENSITIVITY = 38
    POSE = 41
    JOINTS = 42
    INVERSE_KINEMATICS = 43
    FORWARD_KINEMATICS = 44
    JOINT_LIMIT = 45
    TORQUE = 55
    DH = 67
    POSE_AXIS_ANGLE = 91
    CHECK_FEEDBACK = 253
    FEEDBACK_TYPE = 254
    FEEDBACK = 255
    """Never asked: what the controller sends by itself when a move ends."""


class Status(IntFlag):
    """The byte after a reply's register."""

    OK = 0
    INVALID = 0x08
    CANNOT_MOVE = 0x10
    WARNING = 0x20
    ERROR = 0x40


class Frame(NamedTuple):
    """A message on port 502. `body` follows the register: a request's parameters, or a reply's status and payload."""

    transaction: int
    protocol: int
    register: int
    body: bytes

    @property
    def status(self) -> int:
        """A reply's status byte.

        Raises:
            MalformedError: there is none.
        """
        if not self.body:
            raise MalformedError(f"a reply to register {self.register} without a status")
        return self.body[0]

    @property
    def payload(self) -> bytes:
        """What follows a reply's status."""
        return self.body[1:]

    def encode(self) -> bytes:
        """The bytes: u16 transaction, u16 protocol, u16 length from the register on, u8 register, body."""
        header = _HEADER.pack(self.transaction, self.protocol, len(self.body) + 1)
        return header + bytes([self.register]) + self.body

    def reply(self, payload: bytes = b"", status: int = Status.OK) -> "Frame":
        """The reply to this request: transaction, protocol and register are its own."""
        return self._replace(body=bytes([status]) + payload)


_HEADER = struct.Struct(">HHH")


def request(register: int, parameters: bytes = b"", transaction: int = 1, protocol: int = PRIVATE) -> Frame:
    """A request; `parameters` as `floats` or bytes."""
    return Frame(transaction, protocol, register, parameters)


def take_frames(received: bytearray) -> Iterator[Frame]:
    """The whole frames at the start of what was received, which are taken out of it; the rest waits for more.

    Raises:
        MalformedError: a length of zero, which has no room for the register.
    """
    while len(received) >= _HEADER.size:
        transaction, protocol, length = _HEADER.unpack_from(received)
        if length == 0:
            raise MalformedError("a frame of length 0")
        end = _HEADER.size + length
        if len(received) < end:
            return
        frame = Frame(transaction, protocol, received[_HEADER.size], bytes(received[_HEADER.size + 1 : end]))
        del received[:end]
        yield frame


def floats(values: ArrayLike) -> bytes:
    """fp32, little-endian, in order."""
    return np.asarray(values, "<f4").tobytes()


def read_floats(payload: bytes, count: int | None = None) -> Array:
    """The fp32 that bytes hold, as float64.

    Args:
        payload: the bytes.
        count: how many there must be; as many as there are where not given.

    Raises:
        MalformedError: another number of bytes.
    """
    if len(payload) % 4 or (count is not None and len(payload) != 4 * count):
        wanted = "a multiple of 4" if count is None else f"{4 * count}"
        raise MalformedError(f"{len(payload)} bytes of floats; they must be {wanted}")
    return np.frombuffer(payload, "<f4").astype(float)


def seven(joints: ArrayLike) -> Array:
    """`(..., 7)` joint values as on the wire, zero beyond the arm's own `(..., joint)`."""
    values = np.asarray(joints, float)
    return np.concatenate([values, np.zeros((*values.shape[:-1], JOINTS - values.shape[-1]))], axis=-1)


# ---------------------------------------------------------------------------------------------- poses

MM = 1e3
"""Millimetres in a metre."""


def wire_pose(transform: ArrayLike) -> Array:
    """`(..., 6)` x y z roll pitch yaw in mm and rad of `(..., 4, 4)` in m.

    Pitch within ±90°; at the poles, where only roll ∓ yaw is defined, yaw is zero.
    """
    T = np.asarray(transform, float)
    R = T[..., :3, :3]
    cos_pitch = np.hypot(R[..., 0, 0], R[..., 1, 0])
    yaw = np.where(cos_pitch > 1e-15, np.arctan2(R[..., 1, 0], R[..., 0, 0]), 0.0)
    c, s = np.cos(yaw), np.sin(yaw)
    # roll from Ry(pitch) Rx(roll), without the division by cos(pitch) that fails at the poles
    roll = np.arctan2(s * R[..., 0, 2] - c * R[..., 1, 2], c * R[..., 1, 1] - s * R[..., 0, 1])
    pitch = np.arctan2(-R[..., 2, 0], cos_pitch)
    return np.concatenate([MM * T[..., :3, 3], np.stack([roll, pitch, yaw], -1)], axis=-1)


def axis_angle_of_wire_pose(pose: ArrayLike) -> Array:
    """`(..., 6)` x y z rx ry rz of a wire pose, the orientation as a rotation vector in rad, up to a half turn."""
    T = transform_of_wire_pose(pose)
    R = T[..., :3, :3]
    # the quaternion's largest component first, so that nothing is lost near a half turn
    w, x, y, z = R.trace(axis1=-2, axis2=-1), *np.moveaxis(R.diagonal(axis1=-2, axis2=-1), -1, 0)
    square = np.stack([1 + w, 1 + 2 * x - w, 1 + 2 * y - w, 1 + 2 * z - w], -1)
    a, b, c = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    d, e, f = R[..., 1, 0] + R[..., 0, 1], R[..., 0, 2] + R[..., 2, 0], R[..., 2, 1] + R[..., 1, 2]
    rows = np.stack(
        [
            np.stack([square[..., 0], a, b, c], -1),
            np.stack([a, square[..., 1], d, e], -1),
            np.stack([b, d, square[..., 2], f], -1),
            np.stack([c, e, f, square[..., 3]], -1),
        ],
        -2,
    )
    best = np.argmax(square, -1)[..., None, None]
    quaternion = np.take_along_axis(rows, best, -2)[..., 0, :]
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion *= np.where(quaternion[..., :1] < 0, -1.0, 1.0)
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, quaternion[..., :1])
    vector = quaternion[..., 1:] * np.where(sine > 0, angle / np.where(sine > 0, sine, 1.0), 2.0)
    return np.concatenate([np.asarray(pose, float)[..., :3], vector], -1)


def transform_of_wire_pose(pose: ArrayLike) -> Array:
    """`(..., 4, 4)` in m of `(..., 6)` x y z roll pitch yaw in mm and rad."""
    x, y, z, roll, pitch, yaw = np.moveaxis(np.asarray(pose, float), -1, 0)
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (roll, pitch, yaw))
    o, i = np.zeros_like(x), np.ones_like(x)
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x / MM),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y / MM),
        (-sp, cp * sr, cp * cr, z / MM),
        (o, o, o, i),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


# ---------------------------------------------------------------------------------------------- what registers hold

TEXT = 40
"""Bytes of registers 1 and 2, filled up with NUL; a text must be shorter, or the SDK misreads it."""


class Identity(NamedTuple):
    """Which arm and controller, from register 1, such as `6,9,LI1006,DL1000,v2.7.1`.

    Attributes:
        dof: number of joints.
        type: the vendor's number of the model: 9 Lite 6, 12 UF 850, 5, 6 and 7 xArm 5, 6 and 7 (3: an older xArm 7).
        arm: the start of the arm's serial number.
        box: that of the control box.
        firmware: such as `(2, 7, 1)`.
    """

    dof: int
    type: int
    arm: str
    box: str
    firmware: tuple[int, int, int]

    def encode(self) -> bytes:
        """Register 1's payload."""
        text = f"{self.dof},{self.type},{self.arm},{self.box},v{'.'.join(map(str, self.firmware))}"
        return _padded(text.encode("ascii"))


_IDENTITY = re.compile(r"(\d+),(\d+),([^,]*),([^,]*),\s*[vV]?(\d+)\.(\d+)\.(\d+)")


def read_identity(payload: bytes) -> Identity:
    """What register 1 says.

    Raises:
        MalformedError: it is no such text.
    """
    text = payload.split(b"\0")[0].decode("ascii", "replace")
    match = _IDENTITY.match(text)
    if match is None:
        raise MalformedError(f"version {text!r}, which is not axes,type,arm,box,vX.Y.Z")
    dof, kind, arm, box, *firmware = match.groups()
    major, minor, patch = map(int, firmware)
    return Identity(int(dof), int(kind), arm, box, (major, minor, patch))


def serial_numbers(arm: str, box: str) -> bytes:
    """Register 2's payload."""
    return _padded(f"{arm}\0{box}\n".encode("ascii"))


def read_serial_numbers(payload: bytes) -> tuple[str, str]:
    """The arm's and the control box's serial numbers of register 2; empty where there is none."""
    arm, box = [*payload.split(b"\0"), b"", b""][:2]
    return arm.decode("ascii", "replace"), box.decode("ascii", "replace").strip()


def _padded(text: bytes) -> bytes:
    if len(text) >= TEXT:
        raise ValueError(f"{text!r} is not shorter than {TEXT} bytes")
    return text.ljust(TEXT, b"\0")


class Calibration(NamedTuple):
    """Register 8: the arm's own six-parameter chain. The reply that holds it is 179 bytes.

    Attributes:
        valid: 1, or 0 where the arm was never calibrated.
        dof: number of joints.
        type: the model's number, as `Identity.type`.
        rows: `(7, 6)` x y z roll pitch yaw of each joint's frame in the previous one, m and rad; the arm's joints
            first, zeros after them.
    """

    valid: int
    dof: int
    type: int
    rows: Array

    def encode(self) -> bytes:
        """Register 8's payload."""
        values = np.zeros((JOINTS, 6))
        values[: len(self.rows)] = self.rows
        return bytes([self.valid, self.dof, self.type]) + floats(values)


CALIBRATION_PAYLOAD = 3 + 4 * 6 * JOINTS
CALIBRATION_REPLY = 8 + CALIBRATION_PAYLOAD
"""Bytes; 179."""


def read_calibration(payload: bytes) -> Calibration:
    """What register 8 holds, unjudged.

    Raises:
        MalformedError: it has not 171 bytes.
    """
    if len(payload) != CALIBRATION_PAYLOAD:
        raise MalformedError(f"{len(payload)} bytes of calibration; they must be {CALIBRATION_PAYLOAD}")
    valid, dof, kind = payload[:3]
    return Calibration(valid, dof, kind, read_floats(payload[3:]).reshape(JOINTS, 6))


class Feedback(NamedTuple):
    """What the controller sends by itself about a command (register 255); `code` 0 done, 1 failed, 2 discarded."""

    register: int
    task: int
    code: int
    time_us: int


MOTION_STARTED, MOTION_ENDED = 1, 2
"""Kinds of feedback, which register 254 switches on."""


def feedback(command: Frame, kind: int, told: Feedback) -> Frame:
    """The message about a command of this connection."""
    body = struct.pack(">BBBHBQ", Status.OK, kind, told.register, told.task, told.code, told.time_us)
    return command._replace(register=Register.FEEDBACK, body=body)


# ---------------------------------------------------------------------------------------------- reports

REALTIME, NORMAL, RICH, REAL = 30000, 30001, 30002, 30003
RATES = {REALTIME: 250.0, NORMAL: 5.0, RICH: 5.0, REAL: 100.0}
"""Hz of each report port."""

_U8, _U16, _U32, _U64, _F = "u1", ">u2", ">u4", ">u8", "<f4"
_COMMON = {
    "length": (0, _U32, ()),
    "state_mode": (4, _U8, ()),
    "commands": (5, _U16, ()),
    "joint_position": (7, _F, JOINTS),
    "pose": (35, _F, 6),
    "torque": (59, _F, JOINTS),
}
_NORMAL = _COMMON | {
    "brakes": (87, _U8, ()),
    "enabled": (88, _U8, ()),
    "error": (89, _U8, ()),
    "warning": (90, _U8, ()),
    "tool_offset": (91, _F, 6),
    "payload": (115, _F, 4),
    "collision_sensitivity": (131, _U8, ()),
    "teach_sensitivity": (132, _U8, ()),
    "gravity_direction": (133, _F, 3),
}
_FIELDS: dict[int, dict[str, tuple[int, str, int | tuple[()]]]] = {
    REALTIME: {
        "length": (0, _U32, ()),
        "time_us": (4, _U64, ()),
        "state_mode": (12, _U8, ()),
        "commands": (13, _U16, ()),
        "target_position": (32, _F, JOINTS),
        "target_velocity": (60, _F, JOINTS),
        "target_acceleration": (88, _F, JOINTS),
        "joint_position": (116, _F, JOINTS),
        "joint_velocity": (144, _F, JOINTS),
        "joint_acceleration": (172, _F, JOINTS),
        "current": (200, _F, JOINTS),
        "torque": (228, _F, JOINTS),
        "target_pose": (424, _F, 6),
        "target_pose_speed": (448, _F, 6),
        "pose": (472, _F, 6),
        "pose_speed": (496, _F, 6),
    },
    NORMAL: _NORMAL,
    RICH: _NORMAL
    | {
        "type": (145, _U8, ()),
        "dof": (146, _U8, ()),
        "master": (147, _U8, ()),
        "slave": (148, _U8, ()),
        "version": (151, "S30", ()),
        "pose_limits": (181, _F, 5),
        "joint_limits": (201, _F, 5),
        "turn_limits": (221, _F, 2),
        "servo_status": (229, _U8, 14),
        "temperature": (245, "i1", JOINTS),
        "pose_speed": (252, _F, ()),
        "joint_velocity": (256, _F, JOINTS),
        "counter": (284, _U32, ()),
        "world_offset": (288, _F, 6),
        "voltage": (341, _U16, JOINTS),
        "current": (355, _F, JOINTS),
        "axis_angle": (482, _F, 3),
    },
    REAL: _COMMON,
}
LENGTHS = {REALTIME: 784, NORMAL: 145, RICH: 587, REAL: 135}
"""Bytes of each report as firmware 2.7 sends it; other versions send more or less, as the report itself says.

30000 — `joint_position`, `joint_velocity`, `joint_acceleration`, `pose` are the vendor's "actual" ones, `target_…` what
was commanded. RICH `pose_limits` and `joint_limits`: jerk, smallest and largest acceleration, smallest and largest
speed. `voltage` is in hundredths of a volt.
"""


@cache
def report_layout(port: int, length: int | None = None) -> np.dtype:
    """The fields of a report as a NumPy record type, by name and offset.

    `np.frombuffer(b"".join(reports), report_layout(port, length))` reads many reports of one length at once, and
    `np.zeros(count, report_layout(port))` is where to write them.

    Args:
        port: 30000 to 30003.
        length: what the report's first field says; fields beyond it are left out. As firmware 2.7 where not given.

    Raises:
        MalformedError: the length has no room for what every report of the port has.
    """
    length = LENGTHS[port] if length is None else length
    fields = {}
    for name, (offset, kind, shape) in _FIELDS[port].items():
        dtype = np.dtype((kind, shape))
        if offset + dtype.itemsize <= length:
            fields[name] = (dtype, offset)
    if "torque" not in fields or (port == REALTIME and "pose" not in fields):
        raise MalformedError(f"a report of {length} bytes on port {port}; it has {LENGTHS[port]}")
    formats, offsets = zip(*fields.values(), strict=True)
    return np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": length})


LONGEST_REPORT = 4096
"""Bytes; a length beyond it is no length."""


def take_reports(received: bytearray) -> Iterator[bytes]:
    """The whole reports at the start of what was received, which are taken out of it; the rest waits for more.

    Raises:
        MalformedError: a length that no report has: the stream is not at the start of a report.
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


def read_report(port: int, report: bytes) -> np.void:
    """One report's fields by name; those the report is too short for are not among `dtype.names`.

    Raises:
        MalformedError: too short, or not as long as it says.
    """
    if len(report) < 4 or int.from_bytes(report[:4], "big") != len(report):
        raise MalformedError(f"a report of {len(report)} bytes that says it has another length")
    return np.frombuffer(report, report_layout(port, len(report)))[0]


def state_of(state_mode: int | np.integer) -> tuple[int, int]:
    """State and mode of a report's byte: 1 moves, 2 ready, 3 paused, 4 stopped, 5 reset; mode 0 positions, 1 servo."""
    return int(state_mode) & 0x0F, int(state_mode) >> 4
