"""The emulated controller without its sockets: states, queue of moves, and the commanded, measured and true arm."""

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.controller import protocol
from lite6jax.controller.protocol import Frame, Status
from lite6jax.emulator.body import SPACING_S, Body, Load, Sample
from lite6jax.emulator.faults import Faults
from lite6jax.emulator.paths import MAX_ACCELERATION, MAX_SPEED, Path, Timeline, move, servo

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
