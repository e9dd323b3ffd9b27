"""The replies of the controller to each register, by the vendor's documents and the SDK.

Where these specify nothing, the reply is an assumption with which the SDK works, and the comment says so.
"""

import struct
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.controller import protocol
from lite6jax.controller.protocol import Frame, Register, Status
from lite6jax.emulator.body import identity_of
from lite6jax.emulator.core import (
    JOINT_LIMIT_ERROR,
    MOVING,
    PAUSED,
    READY,
    RESET,
    STOPPED,
    Client,
    Core,
    Move,
    RefusedError,
)
from lite6jax.emulator.inverse_kinematics import inverse_kinematics

Array = NDArray[np.floating]

HIGHEST_MODE: Final = 11
"""The SDK closes the connection on reports with a higher mode."""
PLAUSIBLE: Final = 1e4
"""mm of a tool or a pose, kg of a payload; larger values and values that are not finite are refused (an assumption)."""
UNPACKED: Final = 64
"""Zeros in an invalid reply: the SDK unpacks the payload before the status and fails on a shorter one."""


def answer(core: Core, frame: Frame, client: Client) -> Frame | None:
    """The reply to a request, or None for no reply.

    The reply to a request of a wrong size or of a register that is not emulated is invalid (an assumption).
    """
    core.requests[frame.register] += 1
    if not core.faults.answers(frame.register):
        return None
    if frame.protocol == protocol.STANDARD:  # standard Modbus: "illegal function"; the SDK would wait 3 h for a reply
        return frame._replace(body=bytes([(frame.body or b"\0")[0] | 0x80, 1]))
    if frame.protocol not in (protocol.PRIVATE, protocol.PRIVATE_ALIVE):
        return None  # the SDK's heartbeat
    try:
        with np.errstate(all="ignore"):  # joints that are not finite give such a pose
            payload, invalid = _ANSWERS[frame.register](core, frame, client), 0
    except (KeyError, IndexError, ValueError, RefusedError):  # unknown, of wrong size, or refused
        payload, invalid = bytes(UNPACKED), Status.INVALID
    return frame.reply(payload, invalid | core.status)


def _joints_in(core: Core, body: bytes, count: int) -> tuple[Array, Array]:
    """The joints of the arm in `count` floats, and the values after the seven joints on the wire."""
    values = protocol.read_floats(body[: 4 * count], count)
    return values[: core.body.arm.dof], values[protocol.JOINTS :]


def _with_fault(core: Core, where: str, values: ArrayLike) -> Array:
    """The values, or NaN by a fault."""
    values = np.asarray(values, float)
    return np.full_like(values, np.nan) if where in core.faults.nan else values


def _plausible(values: Array) -> Array:
    """The values in mm, kg or rad, after a check of their magnitude."""
    if not (np.abs(values) < PLAUSIBLE).all():
        raise RefusedError
    return values


def _commanded(core: Core) -> Array:
    """`(joint,)` rad, the commanded positions now."""
    return core.commanded(np.array([core.time]))[0][0]


_Answer = Callable[[Core, Frame, Client], bytes]
_ANSWERS: dict[int, _Answer] = {}


def _answers(*registers: Register) -> Callable[[_Answer], _Answer]:
    def enter(answer: _Answer) -> _Answer:
        for register in registers:
            _ANSWERS[register] = answer
        return answer

    return enter


@_answers(Register.VERSION)
def _version(core: Core, frame: Frame, client: Client) -> bytes:
    return identity_of(core.body, core.faults.firmware, core.faults.stated_model).encode()


@_answers(Register.SERIAL_NUMBER)
def _serial_number(core: Core, frame: Frame, client: Client) -> bytes:
    identity = identity_of(core.body, core.faults.firmware, core.faults.stated_model)
    return protocol.serial_numbers(f"{identity.arm}230801E01", f"{identity.box}230801E02")


@_answers(Register.CALIBRATION)
def _calibration(core: Core, frame: Frame, client: Client) -> bytes:
    dof, kind = core.faults.stated_model or (core.body.arm.dof, core.body.type)
    rows = _with_fault(core, "calibration", core.body.kinematics)
    valid = core.faults.calibrated
    return protocol.Calibration(int(valid), dof, kind, rows if valid else np.zeros((0, 6))).encode()


@_answers(Register.MOTION_ENABLE)
def _motion_enable(core: Core, frame: Frame, client: Client) -> bytes:
    joint, on = frame.body
    if not 1 <= joint <= 8:
        raise RefusedError
    chosen = core.every_motor if joint == 8 else 1 << (joint - 1)
    core.enabled = (core.enabled | chosen) if on else (core.enabled & ~chosen)
    core.halt(RESET if core.enabled == core.every_motor else STOPPED)
    return b""


@_answers(Register.SET_STATE)
def _set_state(core: Core, frame: Frame, client: Client) -> bytes:
    state = frame.body[0]
    if state == 0 and core.enabled == core.every_motor and not core.error:
        if core.state == PAUSED:
            core.resume()
        elif core.state != MOVING:
            core.state = READY
    elif state == PAUSED and core.state < STOPPED:
        core.pause()
    elif state == STOPPED:
        core.halt(STOPPED)
    return b""


@_answers(Register.STATE)
def _state(core: Core, frame: Frame, client: Client) -> bytes:
    return bytes([core.state])


@_answers(Register.COMMAND_COUNT)
def _command_count(core: Core, frame: Frame, client: Client) -> bytes:
    return _count(core)


@_answers(Register.ERROR_WARNING)
def _error_warning(core: Core, frame: Frame, client: Client) -> bytes:
    return bytes([core.error, core.warning])


@_answers(Register.CLEAR_ERROR)
def _clear_error(core: Core, frame: Frame, client: Client) -> bytes:
    core.error = core.faults.error
    core.halt(STOPPED)
    return b""


@_answers(Register.CLEAR_WARNING)
def _clear_warning(core: Core, frame: Frame, client: Client) -> bytes:
    core.warning = core.faults.warning
    return b""


@_answers(Register.SET_MODE)
def _set_mode(core: Core, frame: Frame, client: Client) -> bytes:
    if frame.body[0] > HIGHEST_MODE:
        raise RefusedError
    core.mode = frame.body[0]
    core.halt(RESET if core.state < STOPPED else core.state)
    return b""


def _count(core: Core) -> bytes:
    return struct.pack(">H", len(core.queue))


@_answers(Register.MOVE_JOINTS, Register.MOVE_JOINTS_BLENDED)
def _move_joints(core: Core, frame: Frame, client: Client) -> bytes:
    goal, (speed, acceleration, _) = _joints_in(core, frame.body, 10)  # the time is reserved; blending is not emulated
    if any(frame.body[40:41]):  # only a check is requested
        return _count(core) + bytes([JOINT_LIMIT_ERROR if core.beyond_limits(goal) else 0])
    core.move(goal, float(speed), float(acceleration), frame, client)
    return _count(core)


@_answers(Register.MOVE_HOME)
def _move_home(core: Core, frame: Frame, client: Client) -> bytes:
    speed, acceleration, _ = protocol.read_floats(frame.body[:12], 3)
    core.move(np.zeros(core.body.arm.dof), float(speed), float(acceleration), frame, client)
    return _count(core)


@_answers(Register.SERVO_JOINTS)
def _servo_joints(core: Core, frame: Frame, client: Client) -> bytes:
    core.servo(_joints_in(core, frame.body, 10)[0])
    return b""


@_answers(Register.SET_TOOL_OFFSET)
def _set_tool_offset(core: Core, frame: Frame, client: Client) -> bytes:
    core.set_load(_plausible(protocol.read_floats(frame.body, 6)), core.payload)
    return b""


@_answers(Register.SET_PAYLOAD)
def _set_payload(core: Core, frame: Frame, client: Client) -> bytes:
    core.set_load(core.tool, _plausible(protocol.read_floats(frame.body, 4)))
    return b""


@_answers(Register.SET_COLLISION_SENSITIVITY)
def _set_collision_sensitivity(core: Core, frame: Frame, client: Client) -> bytes:
    core.collision_sensitivity = min(frame.body[0], 5)
    return b""


@_answers(Register.SET_TEACH_SENSITIVITY)
def _set_teach_sensitivity(core: Core, frame: Frame, client: Client) -> bytes:
    core.teach_sensitivity = min(frame.body[0], 5)
    return b""


@_answers(Register.POSE)
def _pose(core: Core, frame: Frame, client: Client) -> bytes:
    q = _commanded(core)
    return protocol.floats(_with_fault(core, "kinematics", protocol.wire_pose(core.computed_pose(q))))


@_answers(Register.POSE_AXIS_ANGLE)
def _pose_axis_angle(core: Core, frame: Frame, client: Client) -> bytes:
    q = _commanded(core)
    pose = protocol.axis_angle_of_wire_pose(protocol.wire_pose(core.computed_pose(q)))
    return protocol.floats(_with_fault(core, "kinematics", pose))


@_answers(Register.JOINTS)
def _joints(core: Core, frame: Frame, client: Client) -> bytes:
    now = np.array([core.time])
    if not frame.body:
        return protocol.floats(_with_fault(core, "kinematics", protocol.seven(core.commanded(now)[0][0])))
    blocks = frame.body[0] & 0x0F
    if not 1 <= blocks <= 3:
        raise RefusedError
    q, dq = core.measured(now)
    values = (q, dq, core.torque(now))[:blocks]
    return b"".join(protocol.floats(_with_fault(core, "kinematics", protocol.seven(value[0]))) for value in values)


@_answers(Register.INVERSE_KINEMATICS)
def _inverse_kinematics(core: Core, frame: Frame, client: Client) -> bytes:
    pose = protocol.transform_of_wire_pose(_plausible(protocol.read_floats(frame.body[:24], 6)))
    limited = frame.body[24:25] != b"\0"
    reference = _commanded(core)
    if len(frame.body) > 25:
        reference = _plausible(protocol.read_floats(frame.body[25:], protocol.JOINTS))[: core.body.arm.dof]
    q = inverse_kinematics(core.body, pose @ np.linalg.inv(core.carried.T_flange_tool), reference, limited)
    if q is None:
        raise RefusedError
    return protocol.floats(_with_fault(core, "kinematics", protocol.seven(q)))


@_answers(Register.FORWARD_KINEMATICS)
def _forward_kinematics(core: Core, frame: Frame, client: Client) -> bytes:
    q, _ = _joints_in(core, frame.body, protocol.JOINTS)
    return protocol.floats(_with_fault(core, "kinematics", protocol.wire_pose(core.computed_pose(q))))


@_answers(Register.JOINT_LIMIT)
def _joint_limit(core: Core, frame: Frame, client: Client) -> bytes:
    q, _ = _joints_in(core, frame.body, protocol.JOINTS)
    return bytes([core.beyond_limits(q)])


@_answers(Register.TORQUE)
def _torque(core: Core, frame: Frame, client: Client) -> bytes:
    torque = core.torque(np.array([core.time]))[0]
    return protocol.floats(_with_fault(core, "kinematics", protocol.seven(torque)))


@_answers(Register.DH)
def _dh(core: Core, frame: Frame, client: Client) -> bytes:
    """Modified DH (Craig) of the nominal arm, theta d alpha a, rad and mm; alpha and a precede the joint."""
    if core.body.arm.dh is None:
        raise RefusedError
    theta, d, a, alpha = core.body.arm.dh.T
    before = np.stack([theta, d * protocol.MM, np.roll(alpha, 1), np.roll(a, 1) * protocol.MM], -1)
    before[0, 2:] = 0.0
    rows = np.zeros((protocol.JOINTS, 4))
    rows[: len(before)] = before
    return protocol.floats(rows)


@_answers(Register.CHECK_FEEDBACK)
def _check_feedback(core: Core, frame: Frame, client: Client) -> bytes:
    """Notifies when the queue is done, immediately if it is empty."""
    core.enqueue(Move(frame, None, 0.0, 0.0, client.feedback & protocol.MOTION_ENDED, client.send))
    return b""


@_answers(Register.FEEDBACK_TYPE)
def _feedback_type(core: Core, frame: Frame, client: Client) -> bytes:
    client.feedback = frame.body[0]
    return b""
