"""Frames of port 502: requests to registers of the controller and their replies, as bytes and back."""

import struct
from collections.abc import Iterator
from enum import IntEnum, IntFlag
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating]

CONTROL_PORT = 502
JOINTS = 7
"""The number of joints in every message, whatever the arm has."""


class MalformedError(ValueError):
    """Bytes that do not follow the protocol."""


STANDARD, PRIVATE, PRIVATE_ALIVE = 0, 2, 3
"""Protocol numbers in the header: Modbus TCP; the vendor's, of all registers here; the same as the SDK numbers it from
firmware 1.8.6 on. A reply repeats the number of its request."""


class Register(IntEnum):
    """The quantity or the action to which a request refers."""

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
    """Never requested: the controller sends it when a move ends."""


class Status(IntFlag):
    """The status byte of a reply, after its register."""

    OK = 0
    INVALID = 0x08
    CANNOT_MOVE = 0x10
    WARNING = 0x20
    ERROR = 0x40


class Frame(NamedTuple):
    """A message on port 502. `body` follows the register: parameters of a request, or status and payload of a reply."""

    transaction: int
    protocol: int
    register: int
    body: bytes

    @property
    def status(self) -> int:
        """The status byte of a reply.

        Raises:
            MalformedError: the reply has none.
        """
        if not self.body:
            raise MalformedError(f"a reply to register {self.register} without a status")
        return self.body[0]

    @property
    def payload(self) -> bytes:
        """The bytes after the status of a reply."""
        return self.body[1:]

    def encode(self) -> bytes:
        """The bytes: u16 transaction, u16 protocol, u16 length from the register on, u8 register, body."""
        header = _HEADER.pack(self.transaction, self.protocol, len(self.body) + 1)
        return header + bytes([self.register]) + self.body

    def reply(self, payload: bytes = b"", status: int = Status.OK) -> "Frame":
        """The reply to this request, with the same transaction, protocol and register."""
        return self._replace(body=bytes([status]) + payload)


_HEADER = struct.Struct(">HHH")


def request(register: int, parameters: bytes = b"", transaction: int = 1, protocol: int = PRIVATE) -> Frame:
    """A request with the bytes of its parameters."""
    return Frame(transaction, protocol, register, parameters)


def take_frames(received: bytearray) -> Iterator[Frame]:
    """Removes the complete frames from the start of `received` and yields them; an incomplete one remains.

    Raises:
        MalformedError: a length of zero, which leaves no byte for the register.
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
    """The values as little-endian fp32."""
    return np.asarray(values, "<f4").tobytes()


def read_floats(payload: bytes, count: int | None = None) -> Array:
    """Little-endian fp32 values as float64.

    Args:
        payload: the bytes.
        count: the required number of values; None for any.

    Raises:
        MalformedError: the wrong number of bytes.
    """
    if len(payload) % 4 or (count is not None and len(payload) != 4 * count):
        wanted = "a multiple of 4" if count is None else f"{4 * count}"
        raise MalformedError(f"{len(payload)} bytes of floats; they must be {wanted}")
    return np.frombuffer(payload, "<f4").astype(float)


def seven(joints: ArrayLike) -> Array:
    """`(..., 7)` joint values as on the wire: those of the arm `(..., joint)`, then zeros."""
    values = np.asarray(joints, float)
    return np.concatenate([values, np.zeros((*values.shape[:-1], JOINTS - values.shape[-1]))], axis=-1)
