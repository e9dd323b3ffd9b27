"""Reading the factory calibration from a controller: one passive request, and checks of every field of the reply."""

import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import entries, frames
from lite6jax.arms.arm import Arm, sample_joints
from lite6jax.arms.bundled import load_bundled
from lite6jax.arms.factory import RECOGNISED_WITHIN, FactoryCalibration
from lite6jax.controller import protocol
from lite6jax.controller.connection import Address, connect
from lite6jax.controller.protocol import CALIBRATION_REPLY, HEADER, JOINTS, Calibration, Register, Status
from lite6jax.errors import InputError

REQUEST = protocol.Frame(Register.CALIBRATION)
"""`00 01 00 02 00 01 08`, the only bytes sent."""
_MODELS = {(6, 9): "lite6", (6, 12): "uf850"}
"""By the number of joints and the vendor's number of the model; all other pairs are xArms."""


class UncalibratedError(InputError):
    """The controller replies that it has no calibration."""


class SilentError(InputError):
    """The controller accepts the request and does not reply, as with some firmware."""


class CalibrationRead(NamedTuple):
    """A calibration, and whether the controller reported an error or a warning, which does not affect it."""

    calibration: FactoryCalibration
    error: bool


def read_calibration(address: Address, arm: Arm | None = None, seconds: float = 5.0) -> CalibrationRead:
    """Reads the calibrated six-parameter chain of an arm from its controller, over a separate connection.

    The request is passive: it neither moves nor sets anything, and is possible while the SDK is connected.

    Args:
        address: of the controller.
        arm: the expected nominal arm; None for a Lite 6.
        seconds: the time limit from the call to the last byte; a controller replies within milliseconds.

    Raises:
        InputError: no connection, no reply (`SilentError`), an incomplete reply, no calibration
            (`UncalibratedError`), another arm, or an invalid reply. The message names the address and the remedy.
    """
    where, received, end = str(address), bytearray(), time.monotonic() + seconds
    with connect(address.host, address.port, seconds) as connection:
        try:
            connection.sendall(REQUEST.encode())
            while len(received) < CALIBRATION_REPLY:
                if (left := end - time.monotonic()) <= 0:
                    raise TimeoutError
                connection.settimeout(left)
                piece = connection.recv(CALIBRATION_REPLY - len(received))
                if not piece:
                    raise ConnectionError
                received += piece
                _check_reply(received, where)
        except OSError as error:
            so_far = f"{len(received)} of {CALIBRATION_REPLY} bytes"
            if not isinstance(error, TimeoutError):
                raise InputError(
                    f"{where}: closed the connection after {so_far}; end other programs connected to the arm, and if "
                    "it persists restart the control box"
                ) from error
            if received:
                raise InputError(
                    f"{where}: stopped replying after {so_far}; check the cable and the network, and read again"
                ) from error
            raise SilentError(
                f"{where}: accepts the request and does not reply, as firmware 1.12.1 does; update the firmware, or "
                "check that the address is the arm's control box"
            ) from error
    nominal = load_bundled("lite6") if arm is None else arm
    rows = _read_rows(Calibration.decode(bytes(received[8:])), where, nominal)
    calibration = FactoryCalibration(rows, nominal, nominal.T_joint_flange, where)
    return CalibrationRead(calibration, bool(received[7] & (Status.ERROR | Status.WARNING)))


def _check_reply(received: bytearray, where: str) -> None:
    """Checks the beginning of the reply, as far as it is received: header, register, status and length."""
    if len(received) < HEADER.size:
        return
    transaction, proto, length = HEADER.unpack_from(received)
    what = ""
    if (transaction, proto) != (REQUEST.transaction, REQUEST.protocol):
        expected = f"transaction {REQUEST.transaction}, protocol {REQUEST.protocol}"
        what = f"transaction {transaction}, protocol {proto} to {expected}"
    elif length < 2:
        what = f"a reply of {length} bytes"
    elif len(received) > 7:
        register, status = received[6:8]
        if register != Register.CALIBRATION:
            what = f"register {register} to {int(Register.CALIBRATION)}"
        elif status & Status.INVALID:
            raise _uncalibrated(where)
        elif length != CALIBRATION_REPLY - HEADER.size:
            what = f"a reply of {length} bytes, not {CALIBRATION_REPLY - HEADER.size}"
    if what:
        raise _invalid(where, what, bytes(received))


def _read_rows(content: Calibration, where: str, nominal: Arm) -> NDArray[np.floating]:
    """`(joint, 6)` m and rad, after checks of model, finiteness and magnitude."""
    if not content.valid:
        raise _uncalibrated(where)
    model = _MODELS.get((content.dof, content.type), f"xarm{content.dof}")
    if not 5 <= content.dof <= JOINTS:
        raise _invalid(where, f"{content.dof} joints of type {content.type}", content.encode())
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
    q = sample_joints(nominal.dof)
    with np.errstate(over="ignore", invalid="ignore"):
        difference = frames.chain(frames.transform_from_row(rows), q) - frames.chain(nominal.links, q)
        distance = float(np.sqrt(np.mean(np.sum(difference[:, :3, 3] ** 2, axis=1))))
    largest = max(np.abs(rows[:, :3]).max(), distance if np.isfinite(distance) else np.inf)
    if largest > entries.LENGTH_LIMIT or np.abs(rows[:, 3:]).max() > 2 * np.pi + 1e-3:
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


def _uncalibrated(where: str) -> UncalibratedError:
    return UncalibratedError(
        f"{where}: the controller reports no valid calibration, as arms made before August 2023 and "
        "firmware older than 2.3.0 do; update the firmware, or fit a recording of measured poses"
    )


def _invalid(where: str, what: str, received: bytes) -> InputError:
    return InputError(
        f"{where}: replies with {what} (it begins {received[:8].hex(' ')}), which is not a calibration; check that the "
        "address is the arm's control box, and read again"
    )
