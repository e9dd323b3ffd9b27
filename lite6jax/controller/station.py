"""The connected arm before a recording: its calibration and its condition, read passively, as a sidecar's content."""

import os
import queue
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lite6jax.arms import entries, frames
from lite6jax.arms.arm import Arm, sample_joints
from lite6jax.arms.description import bundled_arms, load_bundled
from lite6jax.arms.factory import RECOGNISED_WITHIN, FactoryCalibration
from lite6jax.array_types import Array
from lite6jax.controller import protocol
from lite6jax.controller.connection import Address, ReportPort, Reports, connect
from lite6jax.controller.protocol import CALIBRATION_REPLY, HEADER, JOINTS, Calibration, Register, Status
from lite6jax.errors import InputError
from lite6jax.recordings import RecordingSettings
from lite6jax.recordings.settings import LONGEST_OFFSET_M

REQUEST = protocol.Message(Register.CALIBRATION)
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
    where = str(address)
    received = bytearray()
    end = time.monotonic() + seconds
    with connect(address.host, address.port, seconds) as connection:
        try:
            connection.sendall(REQUEST.encode())
            while len(received) < CALIBRATION_REPLY:
                if (time_remaining := end - time.monotonic()) <= 0:
                    raise TimeoutError
                connection.settimeout(time_remaining)
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
    mismatch = ""
    if (transaction, proto) != (REQUEST.transaction, REQUEST.protocol):
        expected = f"transaction {REQUEST.transaction}, protocol {REQUEST.protocol}"
        mismatch = f"transaction {transaction}, protocol {proto} to {expected}"
    elif length < 2:
        mismatch = f"a reply of {length} bytes"
    elif len(received) > 7:
        register, status = received[6:8]
        if register != Register.CALIBRATION:
            mismatch = f"register {register} to {int(Register.CALIBRATION)}"
        elif status & Status.INVALID:
            raise _uncalibrated(where)
        elif length != CALIBRATION_REPLY - HEADER.size:
            mismatch = f"a reply of {length} bytes, not {CALIBRATION_REPLY - HEADER.size}"
    if mismatch:
        raise _invalid(where, mismatch, bytes(received))


def _read_rows(content: Calibration, where: str, nominal: Arm) -> Array:
    """`(joint, 6)` m and rad, after checks of model, finiteness and magnitude."""
    if not content.valid:
        raise _uncalibrated(where)
    model = _MODELS.get((content.dof, content.type), f"xarm{content.dof}")
    if not 5 <= content.dof <= JOINTS:
        raise _invalid(where, f"{content.dof} joints of type {content.type}", content.encode())
    expected = None
    if nominal.name in ("lite6", "uf850", "xarm5", "xarm6", "xarm7"):
        expected = nominal.name
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


def _invalid(where: str, mismatch: str, received: bytes) -> InputError:
    return InputError(
        f"{where}: replies with {mismatch} (it begins {received[:8].hex(' ')}), which is not a calibration; check "
        "that the address is the arm's control box, and read again"
    )


# ------------------------------------------------------------------ the condition


NO_OFFSET_MM = 1e-4
NO_OFFSET_RAD = 1e-7
"""Smaller offsets count as zero: the rounding of decimetres to 32 bits."""
STREAM_NOISE = 5e-8, 5e-7
"""m and rad, one standard deviation: the rounding of joints and poses in reports to 32 bits."""
FK_NOISE = 3e-8, 3e-7
"""m and rad, one standard deviation: the rounding of poses alone."""


@dataclass(frozen=True, eq=False)
class Condition:
    """An arm's condition at one 5 Hz report.

    Attributes:
        error, warning: the codes of the controller; 0 for none.
        joint_position: `(7,)` rad, those of the arm first.
        tool_offset: `(6,)` x y z roll pitch yaw of the tool in the flange's frame, mm and rad.
        world_offset: `(6,)` likewise, of the base in the frame of the poses; zero if the report omits it.
        payload: `(4,)` kg and the centre of mass in the flange's frame, mm, as set in the controller.
        gravity_direction: `(3,)` unit vector in the base's frame, as set in the controller.
        temperature: `(7,)` °C, or None if the report omits it.
    """

    error: int
    warning: int
    joint_position: Array
    tool_offset: Array
    world_offset: Array
    payload: Array
    gravity_direction: Array
    temperature: Array | None

    @property
    def has_tool(self) -> bool:
        """Tells whether a tool offset is set."""
        return _is_offset(self.tool_offset)

    @property
    def has_world(self) -> bool:
        """Tells whether poses refer to another frame than the base."""
        return _is_offset(self.world_offset)

    @property
    def T_flange_tool(self) -> Array:
        """`(4, 4)` m, the tool in the flange's frame."""
        return protocol.read_pose(self.tool_offset)


def _is_offset(offset: Array) -> bool:
    return bool(np.abs(offset[:3]).max() > NO_OFFSET_MM or np.abs(offset[3:]).max() > NO_OFFSET_RAD)


def parse_condition(message: bytes, place: str) -> Condition:
    """The condition in a whole report of port 30002.

    Raises:
        InputError: the report ends before the tool offset, or contains values that are not finite.
    """
    report = np.frombuffer(message, protocol.report_layout(protocol.RICH, len(message)))[0]
    names = report.dtype.names
    if "gravity_direction" not in names:
        raise InputError(f"{place}: reports of {len(message)} bytes end before the tool offset; update the firmware")
    for name in ("joint_position", "tool_offset", "payload", "world_offset"):
        if name in names and not np.isfinite(report[name]).all():
            raise InputError(
                f"{place}: the report's {name.replace('_', ' ')} is not finite; restart the control box, and try again"
            )
    gravity = np.array(report["gravity_direction"], float)
    length = float(np.linalg.norm(gravity))
    return Condition(
        error=int(report["error"]),
        warning=int(report["warning"]),
        joint_position=np.array(report["joint_position"], float),
        tool_offset=np.array(report["tool_offset"], float),
        world_offset=np.array(report["world_offset"], float) if "world_offset" in names else np.zeros(6),
        payload=np.array(report["payload"], float),
        gravity_direction=gravity / length if 0.5 < length < 2 else np.array([0.0, 0.0, -1.0]),
        temperature=np.array(report["temperature"], float) if "temperature" in names else None,
    )


def read_condition(address: Address, seconds: float = 3.0) -> Condition:
    """The condition in the next report of port 30002, which sends five a second.

    Raises:
        InputError: no report within `seconds`, or as `parse_condition`.
    """
    with ReportPort(address, protocol.RICH) as port:
        try:
            event = port.events.get(timeout=seconds)
        except queue.Empty:
            event = f"{port.place}: no report within {seconds:g} s"
    if isinstance(event, Reports):
        return parse_condition(event.reports[-1], port.place)
    remedy = "; check that the controller has finished starting, and try again"
    if ";" in event:
        remedy = ""
    raise InputError(event + remedy)


@dataclass(frozen=True, eq=False)
class Station:
    """A connected arm and its settings.

    Attributes:
        arm: the nominal arm.
        arm_name: the bundled arm's name, or the path of a description.
        calibration: the factory calibration, or None if the controller provides none.
        condition: from the 5 Hz report, or None without one.
        notes: missing data and their consequences, one sentence each.
    """

    arm: Arm
    arm_name: str
    calibration: FactoryCalibration | None
    condition: Condition | None
    notes: tuple[str, ...]

    def sidecar_settings(self, out: Path, computed: bool = False) -> RecordingSettings:
        """The content of the sidecar of a recording `out` of a motion, or of poses that the controller `computed`."""
        arm = self.arm_name
        if arm not in bundled_arms():
            arm = Path(os.path.relpath(Path(arm).resolve(), out.resolve().parent)).as_posix()
        settings = RecordingSettings(
            arm=arm,
            factory_calibration=None if self.calibration is None else factory_path(out).name,
            joint_source="commanded" if computed else "measured",
            pose_source="controller_fk",
            motion="static" if computed else "trajectory",
            position_noise_m=(FK_NOISE if computed else STREAM_NOISE)[0],
            orientation_noise_rad=(FK_NOISE if computed else STREAM_NOISE)[1],
            tool="unknown",
        )
        if (condition := self.condition) is None:
            return settings
        changed: dict[str, Any] = {"pose_frame": "unknown" if condition.has_world else "base", "tool": "none"}
        if condition.has_tool:
            changed["tool"] = (*(condition.tool_offset[:3] / protocol.MM).tolist(), *condition.tool_offset[3:].tolist())
        if condition.payload[0] > 0 and np.linalg.norm(condition.payload[1:]) < protocol.MM * LONGEST_OFFSET_M:
            changed["payload_com_m"] = tuple((condition.payload[1:] / protocol.MM).tolist())
        if np.abs(condition.gravity_direction - [0, 0, -1]).max() > 1e-6:
            changed["gravity_m_per_s2"] = tuple((9.81 * condition.gravity_direction).tolist())
        return replace(settings, **changed)


def factory_path(out: Path) -> Path:
    """The file beside a recording for the calibration of its arm."""
    return out.with_name(f"{out.stem}_factory.yaml")


def read_station(address: Address, arm: Arm, arm_name: str) -> Station:
    """Reads calibration and condition of an arm from its controller, with passive requests only.

    Raises:
        InputError: as `read_calibration`, except that a missing calibration is noted.
    """
    notes = []
    calibration = condition = None
    try:
        calibration = read_calibration(address, arm).calibration
    except (UncalibratedError, SilentError) as error:
        reason = str(error).partition(": ")[2].partition(";")[0]
        notes.append(f"the geometry stays unknown: {reason}")
    try:
        condition = read_condition(address)
    except InputError as error:
        notes.append(f"no temperatures, and the tool stays unknown: {str(error).partition(';')[0]}")
    else:
        if condition.error:
            notes.append(f"the controller reports error {condition.error}; clear it with the vendor's program")
        if condition.has_world:
            notes.append("a base offset is set in the controller, so that the pose frame in the sidecar is unknown")
    return Station(arm, arm_name, calibration, condition, tuple(notes))
