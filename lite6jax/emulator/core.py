"""The emulated controller without sockets: faults, states, queue of moves, and the commanded, measured and true arm."""

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.entries import suggestion
from lite6jax.controller import protocol
from lite6jax.controller.protocol import Frame, Status
from lite6jax.emulator.body import SPACING_S, Body, Load, Sample
from lite6jax.emulator.paths import MAX_ACCELERATION, MAX_SPEED, Path, Timeline, move, servo
from lite6jax.errors import InputError

ALL = -1
"""Stands for every register in `Faults.silent`."""
NAN_PLACES = ("calibration", "kinematics", "reports")


def _fault(
    default: Any, name: str, words: str, value: str = "", example: str = "", lowest: int = 0, highest: int = 10**9
) -> Any:
    """A field: its value without the fault; the fault's name and effect; of its value the name, default and bounds."""
    kind = {"name": name, "words": words, "value": value, "example": example, "bounds": (lowest, highest)}
    return field(default=default, metadata=kind)


@dataclass(frozen=True)
class Faults:
    """The faults of an emulated controller; by default none. `describe_faults` describes them.

    With `ALL` in `silent` no register has a reply; connections are accepted all the same. NaN in `kinematics` are those
    of registers 41 to 45, 55 and 91. `model` are the axes and the type that registers 1 and 8 state.
    """

    silent: frozenset[int] = _fault(
        frozenset(), "silence", "does not reply, or not for this register", "REGISTER", highest=255
    )
    silent_reports: bool = _fault(False, "silent_reports", "report ports accept connections and send nothing")
    fragment: int = _fault(0, "fragments", "sends parts of so many bytes", "BYTES", "1", lowest=1)
    close_after: int | None = _fault(None, "close", "closes after so many bytes of a reply", "BYTES", "90")
    close_reports_after: int | None = _fault(
        None, "close_reports", "closes the connection in the middle of a report after so many", "REPORTS", "500"
    )
    lose_every: int = _fault(0, "lose", "does not send every n-th report of port 30000", "EVERY", "100", lowest=2)
    garbage: bool = _fault(False, "garbage", "replies with random bytes")
    invalid: bool = _fault(False, "invalid", "reports that the arm has no calibration")
    error: int = _fault(0, "error", "has this error, which persists after clearing", "CODE", "2", 1, 255)
    warning: int = _fault(0, "warning", "has this warning", "CODE", "11", 1, 255)
    status: int = _fault(0, "status", "adds bits to every status", "BITS", "8", 0, 255)
    latency: float = _fault(0.0, "latency", "delays each reply", "S", "0.5")
    nan: frozenset[str] = _fault(frozenset(), "nan", f"gives NaN in {', '.join(NAN_PLACES)}", "WHERE", "calibration")
    model: tuple[int, int] | None = _fault(None, "type", "reports another model", "AXES/TYPE", "6/6", 0, 255)
    firmware: tuple[int, int, int] = _fault(
        (2, 7, 1), "firmware", "is older: no calibration below 2.3.0, no reply to its request from 1.12.1", "VERSION",
        "1.12.1",
    )  # fmt: skip
    nominal_kinematics: bool = _fault(False, "nominal", "computes with the nominal chain instead of its calibration")
    # the vendor calls the numbers rx ry rz without a definition, and roll, pitch and yaw elsewhere
    rotation_vectors: bool = _fault(False, "rotation_vectors", "orientations on port 30000 are rotation vectors")

    @property
    def calibrated(self) -> bool:
        """Whether the controller provides a calibration."""
        return not self.invalid and self.firmware >= (2, 3, 0)

    def answers(self, register: int) -> bool:
        """Whether a request to this register has a reply."""
        return not self.silent & {ALL, register} and (register != 8 or self.firmware != (1, 12, 1))


def describe_faults() -> list[tuple[str, str]]:
    """Each fault: its name with its value, and its description."""
    described = []
    for kind in (item.metadata for item in fields(Faults)):
        name = f"{kind['name']}:{kind['value']}" if kind["value"] else kind["name"]
        described.append((name, kind["words"] + (f" (default {kind['example']})" if kind["example"] else "")))
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
        kind, key = kinds[name].metadata, kinds[name].name
        if colon and not kind["value"]:
            raise InputError(f"fault {name}: takes no value; leave {value!r} out")
        found = _parse_value(name, value or kind["example"], *kind["bounds"]) if kind["value"] else True
        if isinstance(found, frozenset):
            found |= getattr(faults, key)
        faults = replace(faults, **{key: found})
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
        case "type":
            axes, _, kind = text.partition("/")
            return parse_integer(axes), parse_integer(kind)
        case "firmware":
            parts = text.lstrip("vV").split(".")
            if len(parts) != 3 or not all(part.isdecimal() for part in parts):
                raise InputError(f"fault {name}: {text!r} is not a version; write it like 1.12.1")
            return tuple(map(int, parts))
    return parse_integer(text)


# ------------------------------------------------------------------ the controller


Array = NDArray[np.floating]

POSITIONS, SERVO = 0, 1
"""The emulated modes in which joints move."""

LAG_S: Final = 0.008
"""s, the delay of the joints relative to their commands: two periods of the control loop."""
DIFFERENCE_S: Final = 1e-3
"""s, the step of the finite differences for speeds and accelerations."""
LIMIT_TOLERANCE: Final = math.radians(0.1)
BOOT_US: Final = 60_000_000
"""µs, the controller's clock at the start of the emulation."""
MOST_COMMANDS: Final = 2048
JOINT_LIMIT_ERROR: Final = 23
"""ControllerError 23 of the SDK: "Joints Angle Exceed Limit"."""


class State(IntEnum):
    """The state of the controller, as it is reported."""

    MOVING = 1
    READY = 2
    PAUSED = 3
    STOPPED = 4
    RESET = 5


class RefusedError(Exception):
    """A command that the controller refuses in its present state; the reply has the status `INVALID`."""


@dataclass
class Client:
    """A connection to port 502: how to send to it, and its kinds of feedback."""

    send: Callable[[Frame], None]
    feedback: int = 0


@dataclass
class Move:
    """A queued joint move with the connection to notify; without a goal, only a request to notify."""

    request: Frame
    client: Client
    feedback: int
    goal: Array | None = None
    speed: float = 0.0
    acceleration: float = 0.0
    start: float = 0.0
    end: float = 0.0
    begun: bool = False


@dataclass(eq=False)
class Core:
    """The controller without its sockets, in emulated time, which `advance` increases.

    With effects the poses that the controller computes differ from the true ones: `compute_pose` is by the kinematics
    of its calibration, `true_poses` those of the body.

    Attributes:
        path: the motion from the start; None for rest at zero.
        tool, payload: `(6,)` mm and rad, and `(4,)` kg and centre of mass in mm, as set by `set_load`.
        time: s since the start.
        requests: the number of requests of each register.
    """

    body: Body
    faults: Faults = field(default_factory=Faults)
    path: Path | None = None
    tool: Array = field(default_factory=lambda: np.zeros(6))
    payload: Array = field(default_factory=lambda: np.zeros(4))
    time: float = 0.0
    requests: Counter[int] = field(default_factory=Counter)
    state: State = State.STOPPED
    mode: int = POSITIONS
    enabled: int = 0
    error: int = 0
    warning: int = 0

    def __post_init__(self) -> None:
        start = np.zeros(self.body.arm.dof) if self.path is None else self.path.at(np.zeros(1))[0][0]
        self.timeline = Timeline(start)
        self.direction = np.zeros(self.body.arm.dof)
        self.queue: deque[Move] = deque()
        self.following = False
        self.set_faults(self.faults)
        self.set_load(self.tool, self.payload)
        if self.path is not None and not self.error:
            self.follow(self.path)

    def set_faults(self, faults: Faults) -> None:
        """Replaces the faults; one with an error stops the arm."""
        self.faults, self.error, self.warning = faults, faults.error, faults.warning
        if self.error:
            self.halt(State.STOPPED)

    def set_load(self, tool: Array, payload: Array) -> None:
        """Sets the tool offset `(6,)` in mm and rad, and the payload `(4,)` in kg and mm."""
        self.tool, self.payload = tool, payload
        T_flange = self.body.arm.T_joint_flange
        center = T_flange[:3, :3] @ payload[1:] / protocol.MM + T_flange[:3, 3]
        self.load = Load(protocol.read_pose(tool), float(payload[0]), center)

    def follow(self, path: Path) -> None:
        """Follows a path, which must start at the present position, until a command stops it."""
        self.enabled = self.every_motor
        self.state, self.following = State.MOVING, True
        self.timeline.append(path, self.time)

    def advance(self, time: float) -> None:
        """Advances the clock to `time` s, and notifies of the moves that have begun or ended."""
        instants = np.linspace(self.time, time, 1 + math.ceil((time - self.time) / SPACING_S))[1:]
        self.direction = _directions(self.read_encoders(instants)[1], self.direction)[-1]
        self.time = time
        while self.queue and self.queue[0].start <= time:
            queued = self.queue[0]
            if not queued.begun:
                queued.begun = True
                self._notify(queued, protocol.MOTION_STARTED, 0)
            if queued.end > time:
                break
            self.queue.popleft()
            self._notify(queued, protocol.MOTION_ENDED, 0)
        if self.timeline.end <= time:
            self.following = False
            if self.state == State.MOVING:
                self.state = State.READY

    def _notify(self, queued: Move, kind: int, code: int) -> None:
        if queued.feedback & kind:
            queued.client.send(protocol.encode_feedback(queued.request, kind, code, self.clock_us(self.time)))

    def clock_us(self, time: float) -> int:
        """µs, the controller's clock."""
        return BOOT_US + round(time * 1e6)

    def pause(self, state: State = State.PAUSED) -> None:
        """Stops, keeps the queue, and changes to `state`."""
        self.timeline.stop(self.time)
        self.following, self.state = False, state

    def halt(self, state: State) -> None:
        """Stops, discards the queue with feedback, and changes to `state`."""
        self.pause(state)
        while self.queue:
            self._notify(self.queue.popleft(), protocol.MOTION_ENDED, 2)

    def resume(self) -> None:
        """Resumes the queue."""
        self.state = State.READY
        moves, self.queue = self.queue, deque()
        for queued in moves:
            self.enqueue(queued)

    def move(self, goal: Array, speed: float, acceleration: float, request: Frame, client: Client) -> None:
        """Queues a move if the arm can move. A goal beyond the limits is error 23 and stops the arm, as on a real one.

        The goal is `(joint,)` rad. Speed (rad/s; 0 for 20 °/s) and acceleration (rad/s²; 0 for 500 °/s²) are limited to
        those of the arm.

        Raises:
            RefusedError: another mode than `POSITIONS`, or a full queue.
        """
        if not self._may_move(goal, POSITIONS):
            return
        if self.following:
            self.halt(State.READY)
        speed = min(speed, MAX_SPEED) if speed > 0 else math.radians(20)
        acceleration = min(acceleration, MAX_ACCELERATION) if acceleration > 0 else math.radians(500)
        self.enqueue(Move(request, client, client.feedback, goal, speed, acceleration))

    def servo(self, goal: Array) -> None:
        """Moves to `(joint,)` rad immediately, within the limit of speed; refused in another mode than `SERVO`."""
        if self._may_move(goal, SERVO):
            here = self.read_commands(np.array([self.time]))[0][0]
            self.timeline.append(servo(here, goal, 1 / protocol.RATES[protocol.REALTIME]), self.time)
            self.state = State.MOVING

    def _may_move(self, goal: Array, mode: int) -> bool:
        """Whether the arm can move to `goal`; if not, the status of the reply states the reason."""
        if not self.can_move:
            return False
        if self.mode != mode:
            raise RefusedError
        if self.exceeds_limits(goal):
            self.error = JOINT_LIMIT_ERROR
            self.halt(State.STOPPED)
            return False
        return True

    def enqueue(self, queued: Move) -> None:
        """Appends a move after all planned ones; refused by a full queue."""
        if len(self.queue) >= MOST_COMMANDS:
            raise RefusedError
        queued.start = queued.end = max(self.time, self.timeline.end)
        if queued.goal is not None:
            here = self.read_commands(np.array([queued.start]))[0][0]
            path = move(here, queued.goal, queued.speed, queued.acceleration)
            self.timeline.append(path, queued.start)
            queued.end += path.duration
            self.state = State.MOVING
        self.queue.append(queued)

    @property
    def can_move(self) -> bool:
        """Motors on, no error, not stopped."""
        return self.state < State.STOPPED and self.enabled == self.every_motor and not self.error

    @property
    def every_motor(self) -> int:
        """`enabled` with all motors on."""
        return (1 << self.body.arm.dof) - 1

    @property
    def identity(self) -> protocol.Identity:
        """The content of register 1."""
        dof, kind = self.faults.model or (self.body.arm.dof, self.body.type)
        prefix, box = {9: "LI", 12: "FX"}.get(kind, "XI"), "DL1000" if kind == 9 else "AC1300"
        return protocol.Identity(dof, kind, f"{prefix}1006", box, self.faults.firmware)

    @property
    def status(self) -> int:
        """The status of every reply."""
        return (
            self.faults.status
            | (Status.ERROR if self.error else 0)
            | (Status.WARNING if self.warning else 0)
            | (0 if self.can_move else Status.CANNOT_MOVE)
        )

    def exceeds_limits(self, q: Array) -> bool:
        """Whether a joint exceeds its limits by more than 0.1° or is not finite."""
        lower, upper = self.body.arm.joint_limits.T
        return not ((q >= lower - LIMIT_TOLERANCE) & (q <= upper + LIMIT_TOLERANCE) & np.isfinite(q)).all()

    def read_commands(self, time: Array) -> tuple[Array, Array]:
        """The commanded positions and velocities `(sample, joint)` at `(sample,)` s."""
        return self.timeline.at(time)

    def read_encoders(self, time: Array) -> tuple[Array, Array]:
        """The measured positions and velocities `(sample, joint)`: the commands delayed by `LAG_S`."""
        return self.timeline.at(time - LAG_S)

    def compute_pose(self, q: ArrayLike) -> Array:
        """`(..., 4, 4)` the tool pose by the controller's kinematics: its calibration and the tool offset."""
        return self.body.flange(q, self.faults.nominal_kinematics) @ self.load.T_flange_tool

    def true_poses(self, time: Array) -> Array:
        """`(sample, 4, 4)` the true tool poses with all effects, at the measured joints."""
        position, velocity = self.read_encoders(time + self.body.clock_offset)
        sample = Sample(time, position, velocity, _directions(velocity, self.direction))
        return self.body.true_poses(sample, self.load)

    def torque(self, time: Array) -> Array:
        """`(sample, joint)` N·m, the motor torques as they are read at `(sample,)` s: with effects and noise."""
        offsets, torque = self.body.torque_offset, self.body.draw_torque_noise(time)
        for offset in np.unique(offsets):
            (q, dq), half = self.read_encoders(time + offset), DIFFERENCE_S / 2
            later, earlier = (self.read_encoders(time + offset + shift)[1] for shift in (half, -half))
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
