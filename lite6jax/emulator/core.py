"""The emulated controller without its sockets: states, queue of moves, and the commanded, measured and true arm."""

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.controller import protocol
from lite6jax.controller.protocol import Frame, Status
from lite6jax.emulator.body import BLOCK, SPACING_S, Body, Sample
from lite6jax.emulator.faults import Faults
from lite6jax.emulator.paths import MAX_ACCELERATION, MAX_SPEED, Path, PointToPoint, Servo
from lite6jax.emulator.timeline import Timeline

Array = NDArray[np.floating]

MOVING, READY, PAUSED, STOPPED, RESET = 1, 2, 3, 4, 5
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
AMPERE_PER_NM: Final = 0.08
AMPERE_PER_RAD_PER_S: Final = 0.05
"""The assumed motor: current per torque, and per velocity for friction."""

JOINT_LIMIT_ERROR: Final = 23
"""ControllerError 23 of the SDK: "Joints Angle Exceed Limit"."""


class RefusedError(Exception):
    """A command that the controller refuses in its present state; the reply has the status `INVALID`."""


@dataclass
class Move:
    """A queued joint move with the connection to notify; without a goal, only a request to notify."""

    request: Frame
    goal: Array | None
    speed: float
    acceleration: float
    feedback: int
    send: Callable[[Frame], None]
    start: float = 0.0
    end: float = 0.0
    begun: bool = False


@dataclass
class Client:
    """A connection to port 502: how to send to it, and its kinds of feedback."""

    send: Callable[[Frame], None]
    feedback: int = 0


@dataclass(eq=False)
class Core:
    """The controller without its sockets, in emulated time, which `advance` increases.

    With effects the poses that the controller computes differ from the true ones: `computed_pose` is by the kinematics
    of its calibration, `true` the pose of the body. The class has more than twelve methods because all of them read or
    change one state, which must be consistent at each request; ten of them are one-line readings of it.

    Attributes:
        body: the arm.
        faults: of the controller.
        timeline: the commanded positions of the joints.
        time: s since the start.
        requests: the number of requests of each register.
        tool: `(6,)` the tool offset in mm and rad, as set by `set_load`.
        payload: `(4,)` kg and centre of mass in mm, likewise.
    """

    body: Body
    faults: Faults = field(default_factory=Faults)
    start: Array = field(default_factory=lambda: np.zeros(0))
    tool: Array = field(default_factory=lambda: np.zeros(6))
    payload: Array = field(default_factory=lambda: np.zeros(4))
    time: float = 0.0
    requests: Counter[int] = field(default_factory=Counter)
    state: int = STOPPED
    mode: int = POSITIONS
    enabled: int = 0
    error: int = 0
    warning: int = 0
    collision_sensitivity: int = 3
    teach_sensitivity: int = 3

    def __post_init__(self) -> None:
        self.start = self.start if self.start.size else np.zeros(self.body.arm.dof)
        self.timeline = Timeline(self.start)
        self.direction = np.zeros(self.body.arm.dof)
        self.queue: deque[Move] = deque()
        self.following = False
        self.error, self.warning = self.faults.error, self.faults.warning
        self.set_load(self.tool, self.payload)

    # ---------------------------------------------------------------------------------------- time and motion

    def follow(self, path: Path) -> None:
        """Follows a path, which must start at the present position, until a command stops it."""
        self.enabled = self.every_motor
        self.state, self.following = MOVING, True
        self.timeline.then(path, self.time)

    def advance(self, time: float) -> None:
        """Advances the clock to `time` s, and notifies of the moves that have begun or ended."""
        passed = np.linspace(self.time, time, 1 + math.ceil((time - self.time) / SPACING_S))[1:]
        self.direction = _directions(self.measured(passed)[1], self.direction)[-1]
        self.time = time
        while self.queue and self.queue[0].start <= time:
            move = self.queue[0]
            if not move.begun:
                move.begun = True
                self._notify(move, protocol.MOTION_STARTED, 0)
            if move.end > time:
                break
            self.queue.popleft()
            self._notify(move, protocol.MOTION_ENDED, 0)
        if self.following and self.timeline.end <= time:
            self.following = False
        if self.state == MOVING and not self.following and self.timeline.end <= time:
            self.state = READY

    def _notify(self, move: Move, kind: int, code: int) -> None:
        if move.feedback & kind:
            event = protocol.Feedback(move.request.register, 0, code, self.clock_us(self.time))
            move.send(protocol.feedback(move.request, kind, event))

    def clock_us(self, time: float) -> int:
        """µs, the controller's clock."""
        return BOOT_US + round(time * 1e6)

    def halt(self, state: int) -> None:
        """Stops, discards the queue with feedback, and changes to `state`."""
        self.timeline.stop(self.time)
        self.following = False
        while self.queue:
            self._notify(self.queue.popleft(), protocol.MOTION_ENDED, 2)
        self.state = state

    def pause(self) -> None:
        """Stops and keeps the queue."""
        self.timeline.stop(self.time)
        self.following = False
        self.state = PAUSED

    def resume(self) -> None:
        """Resumes the queue."""
        self.state = READY
        moves, self.queue = self.queue, deque()
        for move in moves:
            self.enqueue(move)

    def move(self, goal: Array, speed: float, acceleration: float, request: Frame, client: Client) -> None:
        """Queues a move if the arm can move. A goal beyond the limits is error 23 and stops the arm, as on a real one.

        Args:
            goal: `(joint,)` rad.
            speed: rad/s, limited to that of the arm; 0 for 20 °/s.
            acceleration: rad/s², likewise; 0 for 500 °/s².
            request: the request for it.
            client: the connection to notify.

        Raises:
            RefusedError: another mode than `POSITIONS`, or a full queue.
        """
        if not self._may_move(goal, POSITIONS):
            return
        if self.following:
            self.halt(READY)
        speed = min(speed, MAX_SPEED) if speed > 0 else math.radians(20)
        acceleration = min(acceleration, MAX_ACCELERATION) if acceleration > 0 else math.radians(500)
        self.enqueue(Move(request, goal, speed, acceleration, client.feedback, client.send))

    def servo(self, goal: Array) -> None:
        """Moves to `(joint,)` rad immediately, within the limit of speed.

        Raises:
            RefusedError: another mode than `SERVO`.
        """
        if self._may_move(goal, SERVO):
            here = self.commanded(np.array([self.time]))[0][0]
            self.timeline.then(Servo(here, goal, 1 / protocol.RATES[protocol.REALTIME]), self.time)
            self.state = MOVING

    def _may_move(self, goal: Array, mode: int) -> bool:
        """Whether the arm can move to `goal`; if not, the status of the reply states the reason."""
        if not self.can_move:
            return False
        if self.mode != mode:
            raise RefusedError
        if self.beyond_limits(goal):
            self.error = JOINT_LIMIT_ERROR
            self.halt(STOPPED)
            return False
        return True

    def enqueue(self, move: Move) -> None:
        """Appends a move after all planned ones.

        Raises:
            RefusedError: a full queue.
        """
        if len(self.queue) >= MOST_COMMANDS:
            raise RefusedError
        move.start = move.end = max(self.time, self.timeline.end)
        if move.goal is not None:
            path = PointToPoint(self._final_position(), move.goal, move.speed, move.acceleration)
            self.timeline.then(path, move.start)
            move.end += path.duration
            self.state = MOVING
        self.queue.append(move)

    def _final_position(self) -> Array:
        """`(joint,)` rad, after all planned moves."""
        return self.timeline.at(np.array([max(self.time, self.timeline.end)]))[0][0]

    # ------------------------------------------------------------------------------------------ readings

    @property
    def can_move(self) -> bool:
        """Motors on, no error, not stopped."""
        return self.state < STOPPED and self.enabled == self.every_motor and not self.error

    @property
    def every_motor(self) -> int:
        """`enabled` with all motors on."""
        return (1 << self.body.arm.dof) - 1

    def set_load(self, tool: Array, payload: Array) -> None:
        """Sets the tool offset `(6,)` in mm and rad, and the payload `(4,)` in kg and mm."""
        T_flange_tool = protocol.transform_of_wire_pose(tool)
        self.tool, self.payload = tool, payload
        self.carried = self.body.carrying(T_flange_tool, float(payload[0]), payload[1:] / protocol.MM)

    def commanded(self, time: Array) -> tuple[Array, Array]:
        """The commanded positions and velocities `(sample, joint)` at `(sample,)` s."""
        return self.timeline.at(time)

    def measured(self, time: Array) -> tuple[Array, Array]:
        """The measured positions and velocities `(sample, joint)`: the commands delayed by `LAG_S`."""
        return self.timeline.at(time - LAG_S)

    def computed_pose(self, q: ArrayLike) -> Array:
        """`(..., 4, 4)` the tool pose by the controller's kinematics: its calibration and the tool offset."""
        return self.body.flange(q, self.faults.nominal_kinematics) @ self.carried.T_flange_tool

    def true(self, time: Array) -> Array:
        """`(sample, 4, 4)` the true tool poses with all effects, at the measured joints."""
        around = math.ceil(abs(self.body.clock_offset) / SPACING_S) + 1 if self.body.clock_offset else 0
        steps = SPACING_S * np.arange(1, around + 1)
        poses, last, size = [], self.direction, BLOCK - 2 * around
        for part in np.split(time, range(size, len(time), size)):
            instants = np.concatenate([part[0] - steps[::-1], part, part[-1] + steps])
            position, velocity = self.measured(instants)
            direction = _directions(velocity, last)
            last = direction[around + len(part) - 1]
            found = self.body.true_poses(Sample(instants, position, velocity, direction), self.carried)
            poses.append(found[around : around + len(part)])
        return np.concatenate(poses)

    def torque(self, time: Array) -> Array:
        """`(sample, joint)` N·m, the motor torques as they are read at `(sample,)` s: with effects and noise."""
        motors = self.body.motors
        offsets, torque = motors.offsets, motors.noise_at(time)
        for offset in np.unique(offsets):
            joints = np.flatnonzero(offsets == offset)
            torque[:, joints] += self._exerted(time + offset)[:, joints]
        return torque

    def _exerted(self, time: Array) -> Array:
        """`(sample, joint)` N·m that the sensors show of what the motors exert at `(sample,)` s."""
        q, dq = self.measured(time)
        later, earlier = (self.measured(time + sign * DIFFERENCE_S / 2)[1] for sign in (1, -1))
        sample = Sample(time, q, dq, np.sign(dq))
        return self.body.torque(sample, (later - earlier) / DIFFERENCE_S, self.carried)

    def current(self, torque: Array, velocity: Array) -> Array:
        """`(sample, joint)` A of the assumed motor."""
        return AMPERE_PER_NM * torque + AMPERE_PER_RAD_PER_S * velocity

    @property
    def status(self) -> int:
        """The status of every reply."""
        return (
            self.faults.status
            | (Status.ERROR if self.error else 0)
            | (Status.WARNING if self.warning else 0)
            | (0 if self.can_move else Status.CANNOT_MOVE)
        )

    def beyond_limits(self, q: Array) -> bool:
        """Whether a joint exceeds its limits by more than 0.1° or is not finite."""
        lower, upper = self.body.arm.joint_limits.T
        return bool(((q < lower - LIMIT_TOLERANCE) | (q > upper + LIMIT_TOLERANCE)).any() or not np.isfinite(q).all())


def _directions(velocity: Array, last: Array) -> Array:
    """`(sample, joint)` signs of the velocity; at standstill that of the last motion, initially `last`."""
    direction = np.sign(velocity)
    if not (direction == 0).any():
        return direction
    for k in range(len(direction)):
        before = direction[k - 1] if k else last
        direction[k] = np.where(direction[k] == 0, before, direction[k])
    return direction
