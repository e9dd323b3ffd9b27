"""What the controller says: the reply to each register, and the reports of each port.

Registers follow the vendor's documents and the SDK. Where these specify nothing, the reply is an assumption with which
the SDK works, and the comment says so. Register 44 always gives the controller's kinematics by its calibration, without
effects. The reports are such that an arm with hidden effects can be recorded and diagnosed:

- 30000, `target_…`: the commanded joints and the controller's kinematics of them, without effects.
- 30000, joints and velocities: the readings of encoders, 8 ms after the commands. They do not contain the effects,
  because compliance or backlash acts between encoder and link.
- Every port and the registers 42 and 55, torques: what the motors exert in the motion of the encoders, by the dynamics
  of the rigid arm and its payload, with the effects on torques and their noise. Currents follow them.
- 30000, `pose`: the true pose of the tool *with* all effects, as measured by a perfect sensor. This is the only
  deviation from a real controller, which computes this pose from the encoders. It replaces a laser tracker.
- 30001, 30002, 30003 and the registers 41 and 42: the commanded joints and the controller's kinematics of them.
  Register 42 with a parameter gives the encoder readings.
"""

import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lite6jax.controller import protocol
from lite6jax.controller.protocol import Frame, Register, Status
from lite6jax.emulator.core import DIFFERENCE_S, JOINT_LIMIT_ERROR, Client, Core, Move, RefusedError, State
from lite6jax.emulator.paths import MAX_ACCELERATION, MAX_SPEED

Array = NDArray[np.floating]

HIGHEST_MODE: Final = 11
"""The SDK closes the connection on reports with a higher mode."""
PLAUSIBLE: Final = 1e4
"""mm of a tool or a pose, kg of a payload; larger values and values that are not finite are refused (an assumption)."""
UNPACKED: Final = 64
"""Zeros in an invalid reply: the SDK unpacks the payload before the status and fails on a shorter one."""
SENSITIVITY: Final = 3
"""Of collisions and of teaching, which is not emulated."""
AMPERE_PER_NM: Final = 0.08
AMPERE_PER_RAD_PER_S: Final = 0.05
"""The assumed motor: current per torque, and per velocity for friction."""


def answer(core: Core, request: Frame, client: Client) -> Frame | None:
    """The reply to a request, or None for no reply.

    The reply to a request of a wrong size or of a register that is not emulated is invalid (an assumption).
    """
    core.requests[request.register] += 1
    if not core.faults.answers(request.register):
        return None
    if request.protocol == protocol.STANDARD:  # standard Modbus: "illegal function"; the SDK would wait 3 h for a reply
        return request._replace(body=bytes([(request.body or b"\0")[0] | 0x80, 1]))
    if request.protocol not in (protocol.PRIVATE, protocol.PRIVATE_ALIVE):
        return None  # the SDK's heartbeat
    invalid = Status.OK
    try:
        with np.errstate(all="ignore"):  # joints that are not finite give such a pose
            payload = _execute(core, request, client)
            if isinstance(payload, np.ndarray):
                payload = protocol.encode_floats(payload * np.nan if "kinematics" in core.faults.nan else payload)
    except (IndexError, ValueError, RefusedError):  # of wrong size, or refused
        payload, invalid = bytes(UNPACKED), Status.INVALID
    return request.reply(payload, invalid | core.status)


def _execute(core: Core, request: Frame, client: Client) -> bytes | Array:
    """Does what a request asks for; the payload of its reply, of kinematics and torques as numbers.

    Raises:
        RefusedError: the register is not emulated, or the state of the controller does not permit it.
        ValueError, IndexError: parameters of a wrong size.
    """
    body, dof, now = request.body, core.body.arm.dof, np.array([core.time])
    match request.register:
        case Register.VERSION:
            return core.identity.encode()
        case Register.SERIAL_NUMBER:
            return protocol.encode_text(f"{core.identity.arm}230801E01\0{core.identity.box}230801E02\n")
        case Register.CALIBRATION:
            valid, identity = core.faults.calibrated, core.identity
            rows = core.body.kinematics if valid else np.zeros((0, 6))
            rows = rows * np.nan if "calibration" in core.faults.nan else rows
            return protocol.Calibration(int(valid), identity.dof, identity.type, rows).encode()
        case Register.MOTION_ENABLE:
            joint, on = body
            if not 1 <= joint <= 8:
                raise RefusedError
            motors = core.every_motor if joint == 8 else 1 << (joint - 1)
            core.enabled = (core.enabled | motors) if on else (core.enabled & ~motors)
            core.halt(State.RESET if core.enabled == core.every_motor else State.STOPPED)
            return b""
        case Register.SET_STATE:
            if body[0] == 0 and core.enabled == core.every_motor and not core.error:
                if core.state == State.PAUSED:
                    core.resume()
                elif core.state != State.MOVING:
                    core.state = State.READY
            elif body[0] == State.PAUSED and core.state < State.STOPPED:
                core.pause()
            elif body[0] == State.STOPPED:
                core.halt(State.STOPPED)
            return b""
        case Register.STATE:
            return bytes([core.state])
        case Register.COMMAND_COUNT:
            return struct.pack(">H", len(core.queue))
        case Register.ERROR_WARNING:
            return bytes([core.error, core.warning])
        case Register.CLEAR_ERROR:
            core.error = core.faults.error
            core.halt(State.STOPPED)
            return b""
        case Register.CLEAR_WARNING:
            core.warning = core.faults.warning
            return b""
        case Register.SET_MODE:
            if body[0] > HIGHEST_MODE:
                raise RefusedError
            core.mode = body[0]
            core.halt(State.RESET if core.state < State.STOPPED else core.state)
            return b""
        case Register.MOVE_JOINTS | Register.MOVE_JOINTS_BLENDED:  # the time is reserved; blending is not emulated
            *q, speed, acceleration, _ = protocol.read_floats(body[:40], 10)
            goal = np.array(q[:dof])
            if any(body[40:41]):  # only a check is requested
                error = JOINT_LIMIT_ERROR if core.exceeds_limits(goal) else 0
                return struct.pack(">HB", len(core.queue), error)
            core.move(goal, speed, acceleration, request, client)
            return struct.pack(">H", len(core.queue))
        case Register.MOVE_HOME:
            speed, acceleration, _ = protocol.read_floats(body[:12], 3)
            core.move(np.zeros(dof), float(speed), float(acceleration), request, client)
            return struct.pack(">H", len(core.queue))
        case Register.SERVO_JOINTS:
            core.servo(protocol.read_floats(body[:40], 10)[:dof])
            return b""
        case Register.SET_TOOL_OFFSET:
            core.set_load(_check_plausible(protocol.read_floats(body, 6)), core.payload)
            return b""
        case Register.SET_PAYLOAD:
            core.set_load(core.tool, _check_plausible(protocol.read_floats(body, 4)))
            return b""
        case Register.POSE:
            return protocol.encode_pose(core.compute_pose(core.read_commands(now)[0][0]))
        case Register.POSE_AXIS_ANGLE:
            return protocol.encode_axis_angle(core.compute_pose(core.read_commands(now)[0][0]))
        case Register.JOINTS:
            if not body:
                return protocol.pad_joints(core.read_commands(now)[0][0])
            blocks = body[0] & 0x0F
            if not 1 <= blocks <= 3:
                raise RefusedError
            return protocol.pad_joints(np.concatenate([*core.read_encoders(now), core.torque(now)])[:blocks])
        case Register.INVERSE_KINEMATICS:
            flange = protocol.read_pose(_check_plausible(protocol.read_floats(body[:24], 6)))
            reference = core.read_commands(now)[0][0]
            if len(body) > 25:
                reference = _check_plausible(protocol.read_floats(body[25:], protocol.JOINTS))[:dof]
            flange = flange @ np.linalg.inv(core.load.T_flange_tool)
            q = core.body.inverse_kinematics(flange, reference, limited=body[24:25] != b"\0")
            if q is None:
                raise RefusedError
            return protocol.pad_joints(q)
        case Register.FORWARD_KINEMATICS:
            q = protocol.read_floats(body[: 4 * protocol.JOINTS], protocol.JOINTS)[:dof]
            return protocol.encode_pose(core.compute_pose(q))
        case Register.JOINT_LIMIT:
            q = protocol.read_floats(body[: 4 * protocol.JOINTS], protocol.JOINTS)[:dof]
            return bytes([core.exceeds_limits(q)])
        case Register.TORQUE:
            return protocol.pad_joints(core.torque(now)[0])
        case Register.DH:  # modified DH (Craig) of the nominal arm, rad and mm; alpha and a precede the joint
            if core.body.arm.dh is None:
                raise RefusedError
            theta, d, a, alpha = core.body.arm.dh.T
            rows = np.zeros((protocol.JOINTS, 4))
            rows[:dof] = np.stack([theta, d * protocol.MM, np.roll(alpha, 1), np.roll(a, 1) * protocol.MM], -1)
            rows[0, 2:] = 0.0
            return protocol.encode_floats(rows)
        case Register.CHECK_FEEDBACK:  # notifies when the queue is done, immediately if it is empty
            core.enqueue(Move(request, client, client.feedback & protocol.MOTION_ENDED))
            return b""
        case Register.FEEDBACK_TYPE:
            client.feedback = body[0]
            return b""
    raise RefusedError


def _check_plausible(values: Array) -> Array:
    """The values in mm, kg or rad, after a check of their magnitude."""
    if not (np.abs(values) < PLAUSIBLE).all():
        raise RefusedError
    return values


def report(core: Core, port: int, time: Array) -> bytes:
    """The concatenated reports of a port at increasing instants `(sample,)` s."""
    records = np.zeros(len(time), protocol.report_layout(port))
    records["length"] = records.dtype.itemsize
    records["state_mode"] = core.state | core.mode << 4
    records["commands"] = len(core.queue)
    commanded, measured, torque = core.read_commands(time), core.read_encoders(time), core.torque(time)
    current = protocol.pad_joints(AMPERE_PER_NM * torque + AMPERE_PER_RAD_PER_S * measured[1])
    records["torque"] = protocol.pad_joints(torque)
    if port == protocol.REALTIME:
        records["current"] = current
        _fill_realtime(core, time, records, commanded, measured)
    else:
        T, speed = _pose_and_speed(core, *commanded)
        records["joint_position"] = protocol.pad_joints(commanded[0])
        records["pose"] = protocol.encode_pose(T)
        names = records.dtype.names or ()
        if "error" in names:
            records["brakes"] = records["enabled"] = core.enabled
            records["error"], records["warning"] = core.error, core.warning
            records["tool_offset"], records["payload"] = core.tool, core.payload
            records["collision_sensitivity"] = records["teach_sensitivity"] = SENSITIVITY
            records["gravity_direction"] = [0, 0, -1]
        if "temperature" in names:
            identity = core.identity
            records["dof"], records["type"] = identity.dof, identity.type
            records["master"], records["slave"] = 0xAA, 0x55
            records["version"] = identity.encode().rstrip(b"\0")[:30]
            records["pose_limits"] = [1000, 1, 50000, 0.1, 1000]  # mm and s, as the SDK assumes them
            records["joint_limits"] = [20, 0.01, MAX_ACCELERATION, 1e-4, MAX_SPEED]
            records["turn_limits"] = [2.3, 2.7]
            records["temperature"] = np.round(protocol.pad_joints(core.body.temperature(time)))
            records["joint_velocity"] = protocol.pad_joints(commanded[1])
            records["pose_speed"] = np.linalg.norm(speed[:, :3], axis=1)
            records["voltage"] = 2400
            records["current"] = current
            records["axis_angle"] = protocol.encode_axis_angle(T)[:, 3:]
    if "reports" in core.faults.nan:
        for name in ("joint_position", "pose"):
            records[name] = np.nan
    return records.tobytes()


def _fill_realtime(
    core: Core, time: Array, records: np.ndarray, commanded: tuple[Array, Array], measured: tuple[Array, Array]
) -> None:
    records["time_us"] = np.round(time * 1e6).astype(np.uint64) + core.clock_us(0.0)
    encode = protocol.encode_axis_angle if core.faults.rotation_vectors else protocol.encode_pose
    # accelerations are one-sided, so that a later command does not change earlier reports
    earlier = [read(time - DIFFERENCE_S)[1] for read in (core.read_commands, core.read_encoders)]
    T, speed = _pose_and_speed(core, *map(np.concatenate, zip(commanded, measured, strict=True)))
    if core.body.physics.effects or core.faults.nominal_kinematics:
        T[len(time) :] = core.true_poses(time)
    records["target_pose"], records["pose"] = np.split(encode(T), 2)
    records["target_pose_speed"], records["pose_speed"] = np.split(speed, 2)
    for prefix, (q, dq), before in zip(("target", "joint"), (commanded, measured), earlier, strict=True):
        records[f"{prefix}_position"] = protocol.pad_joints(q)
        records[f"{prefix}_velocity"] = protocol.pad_joints(dq)
        records[f"{prefix}_acceleration"] = protocol.pad_joints((dq - before) / DIFFERENCE_S)


def _pose_and_speed(core: Core, q: Array, dq: Array) -> tuple[Array, Array]:
    """Poses `(sample, 4, 4)` m by the controller's kinematics, and their speeds `(sample, 6)`, mm/s and rad/s."""
    half = DIFFERENCE_S / 2 * dq
    before, here, after = np.split(core.compute_pose(np.concatenate([q - half, q, q + half])), 3)
    shift = (after[:, :3, 3] - before[:, :3, 3]) * protocol.MM
    turn = (after[:, :3, :3] - before[:, :3, :3]) @ np.swapaxes(here[:, :3, :3], 1, 2)
    spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], -1)
    return here, np.concatenate([shift, spin], -1) / DIFFERENCE_S
