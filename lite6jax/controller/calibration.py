"""Reading the factory calibration from a controller: one passive request, and checks of every field of the reply."""

import socket
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import entries, frames
from lite6jax.arms.arm import Arm, sample_joints
from lite6jax.arms.bundled import load_bundled
from lite6jax.arms.factory import RECOGNISED_WITHIN, FactoryCalibration
from lite6jax.controller import protocol
from lite6jax.controller.exchange import Address, BrokenOffError, Deadline, connect, receive
from lite6jax.controller.protocol import MalformedError, Register, Status
from lite6jax.errors import InputError

SECONDS = 5.0
"""The time limit of the whole exchange; a controller replies within milliseconds."""

REQUEST = protocol.request(Register.CALIBRATION)
"""`00 01 00 02 00 01 08`, the only bytes sent."""

_HEADER = struct.Struct(">HHH")
_MODELS = {(6, 9): "lite6", (6, 12): "uf850"}
"""By the number of joints and the vendor's number of the model; all other pairs are xArms."""


class UncalibratedError(InputError):
    """The controller replies that it has no calibration."""


class SilentError(InputError):
    """The controller accepts the request and does not reply, as with some firmware."""


class CalibrationRead(NamedTuple):
    """A calibration that was read.

    Attributes:
        calibration: the calibrated chain and the nominal arm.
        error: whether the controller reported an error or a warning, which does not affect the calibration.
    """

    calibration: FactoryCalibration
    error: bool


def read_calibration(address: Address, arm: Arm | None = None, seconds: float = SECONDS) -> CalibrationRead:
    """Reads the calibrated six-parameter chain of an arm from its controller, over a separate connection.

    The request is passive: it neither moves nor sets anything, and is possible while the SDK is connected.

    Args:
        address: of the controller.
        arm: the expected nominal arm; None for a Lite 6.
        seconds: the time limit from the call to the last byte.

    Raises:
        InputError: no connection, no reply (`SilentError`), an incomplete reply, no calibration
            (`UncalibratedError`), another arm, or an invalid reply. The message names the address and the remedy.
    """
    deadline = Deadline.after(seconds)
    with connect(address.host, address.port, deadline) as connection:
        return request_calibration(connection, deadline, str(address), arm)


def request_calibration(
    connection: socket.socket, deadline: Deadline, where: str, arm: Arm | None = None
) -> CalibrationRead:
    """`read_calibration` over an existing connection.

    Args:
        connection: a connected socket.
        deadline: of the whole exchange.
        where: the address, for messages.
        arm: as in `read_calibration`.

    Raises:
        InputError: as `read_calibration`.
    """
    try:
        connection.settimeout(max(deadline.left(), 1e-3))
        connection.sendall(REQUEST.encode())
        head = receive(connection, _HEADER.size, deadline)
        length = _checked_header(head, where)
        head += receive(connection, 2, deadline, head)
        status = _checked_status(head, where)
        if length != protocol.CALIBRATION_REPLY - _HEADER.size:
            raise _garbage(where, f"a reply of {length} bytes, not {protocol.CALIBRATION_REPLY - _HEADER.size}", head)
        payload = receive(connection, protocol.CALIBRATION_PAYLOAD, deadline, head)
    except BrokenOffError as stop:
        raise _interrupted(where, stop) from stop
    except OSError as error:  # the request could not be sent
        raise _interrupted(where, BrokenOffError(b"", closed=True)) from error
    nominal = load_bundled("lite6") if arm is None else arm
    rows = _checked_rows(payload, where, nominal)
    calibration = FactoryCalibration(rows, nominal, nominal.T_joint_flange, where)
    return CalibrationRead(calibration, bool(status & (Status.ERROR | Status.WARNING)))


def _checked_header(head: bytes, where: str) -> int:
    """The length in the header."""
    transaction, proto, length = _HEADER.unpack(head)
    if (transaction, proto) != (REQUEST.transaction, REQUEST.protocol):
        expected = f"transaction {REQUEST.transaction}, protocol {REQUEST.protocol}"
        raise _garbage(where, f"transaction {transaction}, protocol {proto} to {expected}", head)
    if length < 2:
        raise _garbage(where, f"a reply of {length} bytes", head)
    return length


def _checked_status(head: bytes, where: str) -> int:
    register, status = head[-2:]
    if register != Register.CALIBRATION:
        raise _garbage(where, f"register {register} to {int(Register.CALIBRATION)}", head)
    if status & Status.INVALID:
        raise _uncalibrated(where)
    return status


def _checked_rows(payload: bytes, where: str, nominal: Arm) -> NDArray[np.floating]:
    """`(joint, 6)` m and rad, after checks of model, finiteness and magnitude."""
    try:
        content = protocol.read_calibration(payload)
    except MalformedError as error:  # cannot happen: the length is checked above
        raise _garbage(where, str(error), payload) from error
    if not content.valid:
        raise _uncalibrated(where)
    model = _MODELS.get((content.dof, content.type), f"xarm{content.dof}")
    if not 5 <= content.dof <= protocol.JOINTS:
        raise _garbage(where, f"{content.dof} joints of type {content.type}", payload)
    expected = nominal.name if nominal.name in ("lite6", "uf850", "xarm5", "xarm6", "xarm7") else None
    if content.dof != nominal.dof or (expected and model != expected):
        raise InputError(
            f"{where}: is an arm of {content.dof} joints, type {content.type} ({model}), not a {nominal.name}; check "
            f"the address, or name the arm with --arm {model}"
        )
    rows = content.rows[: content.dof]
    if not np.isfinite(rows).all():
        joint = int(np.argmax(~np.isfinite(rows).all(axis=1))) + 1
        raise InputError(
            f"{where}: joint{joint} has a number that is not finite; read again, and if it persists have the "
            "arm's calibration restored by the vendor"
        )
    distance = _distance(rows, nominal)
    if max(np.abs(rows[:, :3]).max(), distance) > entries.LENGTH_LIMIT or np.abs(rows[:, 3:]).max() > 2 * np.pi + 1e-3:
        raise InputError(
            f"{where}: contains numbers of an implausible size ({np.abs(rows).max():.3g} m or rad); read again, and if "
            "it persists have the arm's calibration restored by the vendor"
        )
    if distance > RECOGNISED_WITHIN:
        raise InputError(
            f"{where}: contains a chain whose flange is {1e3 * distance:.0f} mm RMS from a {nominal.name}'s, where "
            "tolerances explain a few; read again, and if it persists name the arm with --arm, or ask the vendor"
        )
    return rows


def _distance(rows: NDArray[np.floating], nominal: Arm) -> float:
    """m, the RMS distance of the flange from the nominal one."""
    q = sample_joints(nominal.dof)
    with np.errstate(over="ignore", invalid="ignore"):
        links = np.stack([frames.transform_from_row(row) for row in rows])
        apart = frames.chain(links, q)[:, :3, 3] - frames.chain(nominal.links, q)[:, :3, 3]
        distance = float(np.sqrt(np.mean(np.sum(apart**2, axis=1))))
    return distance if np.isfinite(distance) else np.inf


def _uncalibrated(where: str) -> UncalibratedError:
    return UncalibratedError(
        f"{where}: the controller reports no valid calibration, as arms made before August 2023 and "
        "firmware older than 2.3.0 do; update the firmware, or fit a recording of measured poses"
    )


def _garbage(where: str, what: str, received: bytes) -> InputError:
    return InputError(
        f"{where}: replies with {what} (it begins {received[:8].hex(' ')}), which is not a calibration; check that the "
        "address is the arm's control box, and read again"
    )


def _interrupted(where: str, stop: BrokenOffError) -> InputError:
    count = len(stop.received)
    so_far = f"{count} of {protocol.CALIBRATION_REPLY} bytes"
    if stop.closed:
        return InputError(
            f"{where}: closed the connection after {so_far}; end other programs connected to the arm, and if it "
            "persists restart the control box"
        )
    if not count:
        return SilentError(
            f"{where}: accepts the request and does not reply, as firmware 1.12.1 does; update the firmware, or check "
            "that the address is the arm's control box"
        )
    return InputError(f"{where}: stopped replying after {so_far}; check the cable and the network, and read again")
