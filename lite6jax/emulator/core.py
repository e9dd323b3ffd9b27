"""The emulated controller without sockets: faults, state, the reply to each register, and the reports of each port.

Like the commands that read it, it is read only: a request that would move or set something is invalid. Registers follow
the vendor's documents and the SDK. Where these specify nothing, the reply is an assumption with which the SDK works,
and the comment says so. Register 44 always gives the controller's kinematics by its calibration, without effects. The
reports are such that an arm with hidden effects can be recorded and diagnosed:

- 30000, `target_…`: the commanded joints and the controller's kinematics of them, without effects.
- 30000, joints and velocities: the readings of encoders, 8 ms after the commands. They do not contain the effects,
  because compliance or backlash acts between encoder and link.
  Those of an arm with servos are read-outs of the joints that follow the commands, each held until the next report.
- Every port and the registers 42 and 55, torques: those of the rigid arm and its payload in the motion of the encoders.
  They contain the effects on torques and their noise. Currents follow them.
- 30000, `pose`: the true pose of the tool *with* all effects, as measured by a perfect sensor. This is the only
  deviation from a real controller, which computes this pose from the encoders. It replaces a laser tracker.
- 30001, 30002, 30003 and the registers 41 and 42: the commanded joints and the controller's kinematics of them.
  Register 42 with a parameter gives the encoder readings.
"""

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.entries import suggestion
from lite6jax.array_types import Array
from lite6jax.controller import protocol
from lite6jax.controller.protocol import Message, Register, Status
from lite6jax.emulator.body import SPACING_S, EmulatedArm, Load, Sample
from lite6jax.emulator.follower import ServoedJoints
from lite6jax.errors import InputError
from lite6jax.fields import field_values
from lite6jax.simulation.motions import MAX_ACCELERATION, MAX_SPEED, Path, rest

ALL = -1
"""Stands for every register in `Faults.silent`."""
NAN_PLACES = ("calibration", "kinematics", "reports")


def _fault(
    default: Any, name: str, words: str, value: str = "", default_value: str = "", lowest: int = 0, highest: int = 10**9
) -> Any:
    """A field with its value without the fault.

    Its metadata are the fault's name and effect, and of its value the name, what it is where none is given, and bounds.
    """
    kind = {"name": name, "words": words, "value": value, "given": default_value, "bounds": (lowest, highest)}
    return field(default=default, metadata=kind)


@dataclass(frozen=True)
class Faults:
    """The faults of an emulated controller; by default none. `describe_faults` describes them.

    With `ALL` in `silent` no register has a reply; connections are accepted all the same. NaN in `kinematics` are those
    of registers 41, 42, 44 and 55.
    """

    silent: frozenset[int] = _fault(
        frozenset(), "silence", "does not reply, or not for this register", "REGISTER", highest=255
    )
    silent_reports: bool = _fault(False, "silent_reports", "report ports accept connections and send nothing")
    close_reports_after: int | None = _fault(
        None, "close_reports", "closes the connection in the middle of a report after so many", "REPORTS", "500"
    )
    lose_every: int = _fault(0, "lose", "does not send every n-th report of port 30000", "EVERY", "100", lowest=2)
    invalid: bool = _fault(False, "invalid", "reports that the arm has no calibration")
    error: int = _fault(0, "error", "has this error, and stands still", "CODE", "2", 1, 255)
    warning: int = _fault(0, "warning", "has this warning", "CODE", "11", 1, 255)
    latency: float = _fault(0.0, "latency", "delays each reply", "S", "0.5")
    nan: frozenset[str] = _fault(frozenset(), "nan", f"gives NaN in {', '.join(NAN_PLACES)}", "WHERE", "calibration")
    firmware: tuple[int, int, int] = _fault(
        (2, 7, 1), "firmware", "is older: no calibration below 2.3.0, no reply to its request from 1.12.1", "VERSION",
        "1.12.1",
    )  # fmt: skip
    nominal_kinematics: bool = _fault(False, "nominal", "computes with the nominal chain instead of its calibration")

    @property
    def calibrated(self) -> bool:
        """Tells whether the controller provides a calibration."""
        return not self.invalid and self.firmware >= (2, 3, 0)

    def answers(self, register: int) -> bool:
        """Tells whether a request to this register has a reply."""
        return not self.silent & {ALL, register} and (register != 8 or self.firmware != (1, 12, 1))


def describe_faults() -> list[tuple[str, str]]:
    """Each fault: its name with its value, and its description."""
    described = []
    for kind in (item.metadata for item in fields(Faults)):
        name = f"{kind['name']}:{kind['value']}" if kind["value"] else kind["name"]
        described.append((name, kind["words"] + (f" (default {kind['given']})" if kind["given"] else "")))
    return described


def parse_faults(texts: Iterable[str]) -> Faults:
    """The faults named by texts such as `silence:8` or `latency:0.5`.

    Raises:
        InputError: an unknown name, or an invalid value.
    """
    kinds = {item.metadata["name"]: item for item in fields(Faults)}
    faults = Faults()
    for text in texts:
        name, colon, value = text.partition(":")
        if name not in kinds:
            raise InputError(f"no fault {name!r}; {suggestion(name, kinds)}")
        kind = kinds[name].metadata
        key = kinds[name].name
        if colon and not kind["value"]:
            raise InputError(f"fault {name}: takes no value; leave {value!r} out")
        parsed = True
        if kind["value"]:
            parsed = _parse_value(name, value or kind["given"], *kind["bounds"])
        if isinstance(parsed, frozenset):
            parsed |= field_values(faults)[key]
        faults = replace(faults, **{key: parsed})
    return faults


def _parse_value(name: str, text: str, lowest: int, highest: int) -> Any:
    """The field of a fault with a value."""

    def parse_integer(text: str) -> int:
        if not text.isdecimal() or not lowest <= int(text) <= highest:
            raise InputError(f"fault {name}: {text!r} is not a whole number from {lowest} to {highest}")
        return int(text)

    match name:
        case "silence":
            return frozenset([parse_integer(text) if text else ALL])
        case "latency":
            try:
                seconds = float(text)
            except ValueError:
                seconds = math.nan
            if not 0 <= seconds < math.inf:
                raise InputError(f"fault {name}: {text!r} is not a number of 0 or more")
            return seconds
        case "nan":
            if text not in NAN_PLACES:
                raise InputError(f"fault {name}: {text!r} is not a place; choose one of {', '.join(NAN_PLACES)}")
            return frozenset([text])
        case "firmware":
            parts = text.lstrip("vV").split(".")
            if len(parts) != 3 or not all(part.isdecimal() for part in parts):
                raise InputError(f"fault {name}: {text!r} is not a version; write it like 1.12.1")
            return tuple(map(int, parts))
    return parse_integer(text)


# ------------------------------------------------------------------ the controller


LAG_S: Final = 0.008
"""s, the delay of the joints relative to their commands: two periods of the control loop."""
DIFFERENCE_S: Final = 1e-3
"""s, the step of the finite differences for speeds and accelerations."""
BOOT_US: Final = 60_000_000
"""µs, the controller's clock at the start of the emulation."""


class ControllerState(IntEnum):
    """The state of the controller, as it is reported."""

    MOVING = 1
    READY = 2
    STOPPED = 4


@dataclass(eq=False)
class Core:
    """The controller without its sockets, in emulated time, which `advance` increases.

    With effects the poses that the controller computes differ from the true ones: `compute_pose` is by the kinematics
    of its calibration, `true_poses` those of the body.

    Attributes:
        path: the motion from the start; None for rest at zero.
        tool, payload: `(6,)` mm and rad, and `(4,)` kg and centre of mass in mm.
        time: s since the start.
        stopped: s, when an error began to stop the arm; infinite without one.
    """

    body: EmulatedArm
    faults: Faults = field(default_factory=Faults)
    path: Path | None = None
    tool: Array = field(default_factory=lambda: np.zeros(6))
    payload: Array = field(default_factory=lambda: np.zeros(4))
    time: float = 0.0
    stopped: float = np.inf

    def __post_init__(self) -> None:
        self._motion = rest(np.zeros(self.body.arm.dof)) if self.path is None else self.path
        self.direction = np.zeros(self.body.arm.dof)
        self._servoed: ServoedJoints | None = None
        self.set_faults(self.faults)
        T_flange = self.body.arm.T_joint_flange
        center = T_flange[:3, :3] @ self.payload[1:] / protocol.MM + T_flange[:3, 3]
        self.load = Load(protocol.read_pose(self.tool), float(self.payload[0]), center)
        if self.body.servos is not None:
            self._servoed = ServoedJoints(self.body.servos, lambda time: self.read_commands(time)[0])

    def set_faults(self, faults: Faults) -> None:
        """Replaces the faults; one with an error stops the arm for good."""
        self.faults = faults
        if faults.error:
            self.stopped = min(self.stopped, self.time)
            if self._servoed is not None:
                self._servoed.forget_after(self.stopped)

    def advance(self, time: float) -> None:
        """Advances the clock to `time` s."""
        instants = np.linspace(self.time, time, 1 + math.ceil((time - self.time) / SPACING_S))[1:]
        self.direction = _directions(self.read_encoders(instants)[1], self.direction)[-1]
        self.time = time

    @property
    def state(self) -> ControllerState:
        """The state: the arm moves, has moved, or neither did nor can."""
        if self.path is None or self.stopped < np.inf:
            return ControllerState.STOPPED
        if self.time < self.path.duration:
            return ControllerState.MOVING
        return ControllerState.READY

    @property
    def enabled(self) -> int:
        """The motors that are on, a bit each: all of an arm that can move, else none."""
        if self.state == ControllerState.STOPPED:
            return 0
        return (1 << self.body.arm.dof) - 1

    @property
    def identity(self) -> protocol.Identity:
        """The content of register 1."""
        dof = self.body.arm.dof
        kind = self.body.type
        prefix = {9: "LI", 12: "FX"}.get(kind, "XI")
        box = "DL1000" if kind == 9 else "AC1300"
        return protocol.Identity(dof, kind, f"{prefix}1006", box, self.faults.firmware)

    @property
    def status(self) -> int:
        """The status of every reply."""
        return (
            (Status.ERROR if self.faults.error else 0)
            | (Status.WARNING if self.faults.warning else 0)
            | (Status.CANNOT_MOVE if self.state == ControllerState.STOPPED else 0)
        )

    def read_commands(self, time: Array) -> tuple[Array, Array]:
        """The commanded positions and velocities `(sample, joint)` at `(sample,)` s: at rest but for the motion.

        An error ends it at once.
        """
        end = min(self.stopped, self._motion.duration)
        position, velocity = self._motion.at(np.clip(time, 0.0, end))
        return position, np.where(((time > 0) & (time < end))[:, None], velocity, 0.0)

    def read_encoders(self, time: Array) -> tuple[Array, Array]:
        """The measured positions and velocities `(sample, joint)`: of servos, else the commands delayed by `LAG_S`."""
        if self._servoed is not None:
            return self._servoed.read_encoders(time)
        return self.read_commands(time - LAG_S)

    def read_joints(self, time: Array) -> tuple[Array, Array]:
        """The true positions and velocities `(sample, joint)`, which differ from the measured ones with servos only."""
        if self._servoed is not None:
            return self._servoed.read_joints(time)
        return self.read_encoders(time)

    def compute_pose(self, q: ArrayLike) -> Array:
        """`(..., 4, 4)` the tool pose by the controller's kinematics: its calibration and the tool offset."""
        return self.body.flange(q, self.faults.nominal_kinematics) @ self.load.T_flange_tool

    def true_poses(self, time: Array) -> Array:
        """`(sample, 4, 4)` the true tool poses with all effects."""
        position, velocity = self.read_joints(time + self.body.clock_offset)
        sample = Sample(time, position, velocity, _directions(velocity, self.direction))
        return self.body.true_poses(sample, self.load)

    def torque(self, time: Array) -> Array:
        """`(sample, joint)` N·m, the motor torques as they are read at `(sample,)` s: with effects and noise."""
        offsets = self.body.torque_offset
        torque = self.body.draw_torque_noise(time)
        for offset in np.unique(offsets):
            q, dq = self.read_joints(time + offset)
            half = DIFFERENCE_S / 2
            later, earlier = (self.read_joints(time + offset + shift)[1] for shift in (half, -half))
            sample = Sample(time + offset, q, dq, np.sign(dq))
            exerted = self.body.torque(sample, (later - earlier) / DIFFERENCE_S, self.load)
            torque[:, offsets == offset] += exerted[:, offsets == offset]
        return torque


def _directions(velocity: Array, last: Array) -> Array:
    """`(sample, joint)` signs of the velocity; at standstill that of the last motion, initially `last`."""
    direction = np.sign(velocity)
    for k in range(len(direction) if (direction == 0).any() else 0):
        before = direction[k - 1] if k else last
        direction[k] = np.where(direction[k] == 0, before, direction[k])
    return direction


# ------------------------------------------------------------------ replies


UNPACKED: Final = 4 * 28
"""Zeros in an invalid reply: the SDK unpacks the payload before the status and fails on a shorter one."""
SENSITIVITY: Final = 3
"""Of collisions and of teaching, which is not emulated."""
AMPERE_PER_NM: Final = 0.08
AMPERE_PER_RAD_PER_S: Final = 0.05
"""The assumed motor: current per torque, and per velocity for friction."""


def answer(core: Core, request: Message) -> Message | None:
    """The reply to a request, or None for no reply.

    The reply to a request of a wrong size or of a register that is not emulated is invalid (an assumption).
    """
    if not core.faults.answers(request.register):
        return None
    if request.protocol == protocol.STANDARD:  # standard Modbus: "illegal function"; the SDK would wait 3 h for a reply
        return request._replace(body=bytes([(request.body or b"\0")[0] | 0x80, 1]))
    if request.protocol not in (protocol.PRIVATE, protocol.PRIVATE_ALIVE):
        return None  # the SDK's heartbeat
    invalid = Status.OK
    try:
        with np.errstate(all="ignore"):  # joints that are not finite give such a pose
            payload = _read(core, request)
            if isinstance(payload, np.ndarray):
                payload = protocol.encode_floats(payload * np.nan if "kinematics" in core.faults.nan else payload)
    except ValueError:
        payload = bytes(UNPACKED)
        invalid = Status.INVALID
    return request.reply(payload, invalid | core.status)


def _read(core: Core, request: Message) -> bytes | Array:
    """The payload of the reply to a request, of kinematics and torques as numbers.

    Raises:
        ValueError: the register is not emulated, or parameters of a wrong size.
    """
    body = request.body
    now = np.array([core.time])
    match request.register:
        case Register.VERSION:
            return core.identity.encode()
        case Register.SERIAL_NUMBER:
            return protocol.encode_text(f"{core.identity.arm}230801E01\0{core.identity.box}230801E02\n")
        case Register.CALIBRATION:
            valid = core.faults.calibrated
            identity = core.identity
            rows = core.body.kinematics if valid else np.zeros((0, 6))
            if "calibration" in core.faults.nan:
                rows = rows * np.nan
            return protocol.Calibration(int(valid), identity.dof, identity.type, rows).encode()
        case Register.STATE:
            return bytes([core.state])
        case Register.COMMAND_COUNT:
            return struct.pack(">H", 0)
        case Register.ERROR_WARNING:
            return bytes([core.faults.error, core.faults.warning])
        case Register.POSE:
            return protocol.encode_pose(core.compute_pose(core.read_commands(now)[0][0]))
        case Register.JOINTS:
            if not body:
                return protocol.pad_joints(core.read_commands(now)[0][0])
            blocks = body[0] & 0x0F
            if not 1 <= blocks <= 3:
                raise ValueError(f"{blocks} blocks of joints")
            return protocol.pad_joints(np.concatenate([*core.read_encoders(now), core.torque(now)])[:blocks])
        case Register.FORWARD_KINEMATICS:
            q = protocol.read_floats(body[: 4 * protocol.JOINTS], protocol.JOINTS)[: core.body.arm.dof]
            return protocol.encode_pose(core.compute_pose(q))
        case Register.TORQUE:
            return protocol.pad_joints(core.torque(now)[0])
    raise ValueError(f"register {request.register}")


# ------------------------------------------------------------------ reports


def report(core: Core, port: int, time: Array) -> bytes:
    """The concatenated reports of a port at increasing instants `(sample,)` s."""
    records = np.zeros(len(time), protocol.report_layout(port))
    records["length"] = records.dtype.itemsize
    records["state_mode"] = core.state
    commanded = core.read_commands(time)
    measured = core.read_encoders(time)
    torque = core.torque(time)
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
            records["error"], records["warning"] = core.faults.error, core.faults.warning
            records["tool_offset"], records["payload"] = core.tool, core.payload
            records["collision_sensitivity"] = records["teach_sensitivity"] = SENSITIVITY
            records["gravity_direction"] = [0, 0, -1]
        if "temperature" in names:
            identity = core.identity
            records["dof"], records["type"] = identity.dof, identity.type
            records["master"] = 0xAA
            records["slave"] = 0x55
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
    records["time_us"] = np.round(time * 1e6).astype(np.uint64) + np.uint64(BOOT_US)
    # accelerations are one-sided, so that a later error does not change earlier reports
    earlier = [read(time - DIFFERENCE_S)[1] for read in (core.read_commands, core.read_encoders)]
    T, speed = _pose_and_speed(core, *map(np.concatenate, zip(commanded, measured, strict=True)))
    if core.body.physics.effects or core.body.servos is not None or core.faults.nominal_kinematics:
        T[len(time) :] = core.true_poses(time)
    records["target_pose"], records["pose"] = np.split(protocol.encode_pose(T), 2)
    records["target_pose_speed"], records["pose_speed"] = np.split(speed, 2)
    for prefix, (q, dq), before in zip(("target", "joint"), (commanded, measured), earlier, strict=True):
        records[f"{prefix}_position"] = protocol.pad_joints(q)
        records[f"{prefix}_velocity"] = protocol.pad_joints(dq)
        records[f"{prefix}_acceleration"] = protocol.pad_joints((dq - before) / DIFFERENCE_S)


def _pose_and_speed(core: Core, q: Array, dq: Array) -> tuple[Array, Array]:
    """Poses `(sample, 4, 4)` m by the controller's kinematics, and their speeds `(sample, 6)`, mm/s and rad/s."""
    half = DIFFERENCE_S / 2 * dq
    before, pose, after = np.split(core.compute_pose(np.concatenate([q - half, q, q + half])), 3)
    shift = (after[:, :3, 3] - before[:, :3, 3]) * protocol.MM
    turn = (after[:, :3, :3] - before[:, :3, :3]) @ np.swapaxes(pose[:, :3, :3], 1, 2)
    spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], -1)
    return pose, np.concatenate([shift, spin], -1) / DIFFERENCE_S
