"""The contents of registers 1, 2 and 8, and the feedback about commands, as bytes and back."""

import re
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.controller.protocol.frames import JOINTS, Frame, MalformedError, Register, Status, floats, read_floats

Array = NDArray[np.floating]

TEXT = 40
"""Bytes of registers 1 and 2, padded with NUL. The SDK misreads a text that is not shorter."""


class Identity(NamedTuple):
    """The model of the arm and the controller, from register 1, such as `6,9,LI1006,DL1000,v2.7.1`.

    Attributes:
        dof: number of joints.
        type: the vendor's number of the model: 9 Lite 6, 12 UF 850, 5, 6 and 7 xArm 5, 6 and 7 (3: an older xArm 7).
        arm: the first characters of the arm's serial number.
        box: those of the control box.
        firmware: such as `(2, 7, 1)`.
    """

    dof: int
    type: int
    arm: str
    box: str
    firmware: tuple[int, int, int]

    def encode(self) -> bytes:
        """The payload of register 1."""
        text = f"{self.dof},{self.type},{self.arm},{self.box},v{'.'.join(map(str, self.firmware))}"
        return _padded(text.encode("ascii"))


_IDENTITY = re.compile(r"(\d+),(\d+),([^,]*),([^,]*),\s*[vV]?(\d+)\.(\d+)\.(\d+)")


def read_identity(payload: bytes) -> Identity:
    """The content of register 1.

    Raises:
        MalformedError: the text has another form.
    """
    text = payload.split(b"\0")[0].decode("ascii", "replace")
    match = _IDENTITY.match(text)
    if match is None:
        raise MalformedError(f"version {text!r}, which is not axes,type,arm,box,vX.Y.Z")
    dof, kind, arm, box, *firmware = match.groups()
    major, minor, patch = map(int, firmware)
    return Identity(int(dof), int(kind), arm, box, (major, minor, patch))


def serial_numbers(arm: str, box: str) -> bytes:
    """The payload of register 2."""
    return _padded(f"{arm}\0{box}\n".encode("ascii"))


def read_serial_numbers(payload: bytes) -> tuple[str, str]:
    """The serial numbers of arm and control box from register 2; empty where missing."""
    arm, box = [*payload.split(b"\0"), b"", b""][:2]
    return arm.decode("ascii", "replace"), box.decode("ascii", "replace").strip()


def _padded(text: bytes) -> bytes:
    if len(text) >= TEXT:
        raise ValueError(f"{text!r} is not shorter than {TEXT} bytes")
    return text.ljust(TEXT, b"\0")


class Calibration(NamedTuple):
    """Register 8: the calibrated six-parameter chain of the arm, in a reply of 179 bytes.

    Attributes:
        valid: 1, or 0 if the arm was never calibrated.
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
        """The payload of register 8."""
        values = np.zeros((JOINTS, 6))
        values[: len(self.rows)] = self.rows
        return bytes([self.valid, self.dof, self.type]) + floats(values)


CALIBRATION_PAYLOAD = 3 + 4 * 6 * JOINTS
CALIBRATION_REPLY = 8 + CALIBRATION_PAYLOAD
"""Bytes; 179."""


def read_calibration(payload: bytes) -> Calibration:
    """The content of register 8, without a check of its values.

    Raises:
        MalformedError: the payload does not have 171 bytes.
    """
    if len(payload) != CALIBRATION_PAYLOAD:
        raise MalformedError(f"{len(payload)} bytes of calibration; they must be {CALIBRATION_PAYLOAD}")
    valid, dof, kind = payload[:3]
    return Calibration(valid, dof, kind, read_floats(payload[3:]).reshape(JOINTS, 6))


class Feedback(NamedTuple):
    """A notification about a command (register 255); `code` is 0 for done, 1 for failed, 2 for discarded."""

    register: int
    task: int
    code: int
    time_us: int


MOTION_STARTED, MOTION_ENDED = 1, 2
"""Kinds of feedback, enabled by register 254."""


def feedback(command: Frame, kind: int, event: Feedback) -> Frame:
    """The message with a notification about a command of this connection."""
    body = struct.pack(">BBBHBQ", Status.OK, kind, event.register, event.task, event.code, event.time_us)
    return command._replace(register=Register.FEEDBACK, body=body)
