"""The controller behind its sockets: its states, its queue of moves, and what it and its encoders see of the arm."""

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
"""The modes in which joints move here."""

LAG_S: Final = 0.008
"""By which the joints follow their commands: two periods of the control loop."""
LIMIT_SLACK: Final = math.radians(0.1)
BOOT_US: Final = 60_000_000
"""The controller's clock at the emulation's start."""
MOST_COMMANDS: Final = 2048
AMPERE_PER_NM: Final = 0.08
AMPERE_PER_RAD_PER_S: Final = 0.05
"""A made-up motor: current for torque and for friction."""

JOINT_LIMIT_ERROR: Final = 23
"""ControllerError 23 of the SDK: "Joints Angle Exceed Limit"."""


class RefusedError(Exception):
    """What the controller does not do as it stands; the reply is called invalid."""


@dataclass
class Move:
    """A joint move in the queue, or without a goal a question when all before it is done; and whom to tell."""

    request: Frame
    goal: Array | None
    speed: float
    acceleration: float
    feedback: int
    tell: Callable[[Frame], None]
    start: float = 0.0
    end: float = 0.0
    begun: bool = False


@dataclass
class Client:
    """A connection to port 502, as far as the controller remembers it."""

    tell: Callable[[Frame], None]
    feedback: int = 0


@dataclass(eq=False)
class Core:
    """The controller without its sockets. Time is emulated: `advance` moves it on.

    What it believes and what is true differ where the body has physics: `believed` is the kinematics of its
    calibration at the commanded joints, `true` the body's pose.

    Attributes:
        body: the arm.
        faults: what is wrong.
        timeline: where the joints are commanded to be.
        time: s since the start.
        asked: how often each register was asked for.
        tool: `(6,)` the tool offset in mm and rad, as set by `carry`.
        payload: `(4,)` kg and its centre in mm, likewise.
    """

    body: Body
    faults: Faults = field(default_factory=Faults)
    start: Array = field(default_factory=lambda: np.zeros(0))
    tool: Array = field(default_factory=lambda: np.zeros(6))
    payload: Array = field(default_factory=lambda: np.zeros(4))
    time: float = 0.0
    asked: Counter[int] = field(default_factory=Counter)
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
        self.roaming = False
        self.error, self.warning = self.faults.error, self.faults.warning
        self.carry(self.tool, self.payload)

    # ---------------------------------------------------------------------------------------- time and motion

    def roam(self, path: Path) -> None:
        """Follows a path from its start on, which must be where the arm stands, until something stops it."""
        self.enabled = self.every_motor
        self.state, self.roaming = MOVING, True
        self.timeline.then(path, self.time)

    def advance(self, time: float) -> None:
        """The clock goes on; moves that have begun or ended meanwhile are told of."""
        passed = np.linspace(self.time, time, 1 + math.ceil((time - self.time) / SPACING_S))[1:]
        self.direction = _directions(self.measured(passed)[1], self.direction)[-1]
        self.time = time
        while self.queue and self.queue[0].start <= time:
            move = self.queue[0]
            if not move.begun:
                move.begun = True
                self._tell(move, protocol.MOTION_STARTED, 0)
            if move.end > time:
                break
            self.queue.popleft()
            self._tell(move, protocol.MOTION_ENDED, 0)
        if self.roaming and self.timeline.end <= time:
            self.roaming = False
        if self.state == MOVING and not self.roaming and self.timeline.end <= time:
            self.state = READY

    def _tell(self, move: Move, kind: int, code: int) -> None:
        if move.feedback & kind:
            told = protocol.Feedback(move.request.register, 0, code, self.clock_us(self.time))
            move.tell(protocol.feedback(move.request, kind, told))

    def clock_us(self, time: float) -> int:
        """The controller's own clock."""
        return BOOT_US + round(time * 1e6)

    def halt(self, state: int) -> None:
        """Stops, forgets what was to come (feedback: discarded), and goes to a state."""
        self.timeline.stop(self.time)
        self.roaming = False
        while self.queue:
            self._tell(self.queue.popleft(), protocol.MOTION_ENDED, 2)
        self.state = state

    def pause(self) -> None:
        """Stops and remembers what is to come."""
        self.timeline.stop(self.time)
        self.roaming = False
        self.state = PAUSED

    def resume(self) -> None:
        """Ready; goes on with what was to come."""
        self.state = READY
        moves, self.queue = self.queue, deque()
        for move in moves:
            self.enqueue(move)

    def move(self, goal: Array, speed: float, acceleration: float, request: Frame, client: Client) -> None:
        """Queues a move, if it can move; a goal beyond the limits is error 23 and stops all, as on a real one.

        Args:
            goal: `(joint,)` rad.
            speed: rad/s, the arm's own at most; 20 °/s where it is 0.
            acceleration: rad/s², likewise; 500 °/s² where it is 0.
            request: what asked for it.
            client: who is told when it is done.

        Raises:
            RefusedError: not in the mode of positions, or too many are queued.
        """
        if not self._free_to_move(goal, POSITIONS):
            return
        if self.roaming:
            self.halt(READY)
        speed = min(speed, MAX_SPEED) if speed > 0 else math.radians(20)
        acceleration = min(acceleration, MAX_ACCELERATION) if acceleration > 0 else math.radians(500)
        self.enqueue(Move(request, goal, speed, acceleration, client.feedback, client.tell))

    def servo(self, goal: Array) -> None:
        """Goes to `(joint,)` rad at once, as fast as the limit of speed lets it.

        Raises:
            RefusedError: not in the mode of servo.
        """
        if self._free_to_move(goal, SERVO):
            here = self.commanded(np.array([self.time]))[0][0]
            self.timeline.then(Servo(here, goal, 1 / protocol.RATES[protocol.REALTIME]), self.time)
            self.state = MOVING

    def _free_to_move(self, goal: Array, mode: int) -> bool:
        """False where the reply's status says why not."""
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
        """After all that is planned.

        Raises:
            RefusedError: too many are queued.
        """
        if len(self.queue) >= MOST_COMMANDS:
            raise RefusedError
        move.start = move.end = max(self.time, self.timeline.end)
        if move.goal is not None:
            path = PointToPoint(self._standing_at(), move.goal, move.speed, move.acceleration)
            self.timeline.then(path, move.start)
            move.end += path.duration
            self.state = MOVING
        self.queue.append(move)

    def _standing_at(self) -> Array:
        """`(joint,)` rad, where all that is planned ends."""
        return self.timeline.at(np.array([max(self.time, self.timeline.end)]))[0][0]

    # ------------------------------------------------------------------------------------------ what is seen

    @property
    def can_move(self) -> bool:
        """Motors on, no error, not stopped."""
        return self.state < STOPPED and self.enabled == self.every_motor and not self.error

    @property
    def every_motor(self) -> int:
        """`enabled` with all motors on."""
        return (1 << self.body.arm.dof) - 1

    def carry(self, tool: Array, payload: Array) -> None:
        """Another tool offset `(6,)` in mm and rad, and payload `(4,)` in kg and mm."""
        T_flange_tool = protocol.transform_of_wire_pose(tool)
        self.tool, self.payload = tool, payload
        self.carried = self.body.carrying(T_flange_tool, float(payload[0]), payload[1:] / protocol.MM)

    def commanded(self, time: Array) -> tuple[Array, Array]:
        """Positions and velocities `(sample, joint)` that the controller asks for."""
        return self.timeline.at(time)

    def measured(self, time: Array) -> tuple[Array, Array]:
        """Positions and velocities `(sample, joint)` that the encoders show: the commands, a little late."""
        return self.timeline.at(time - LAG_S)

    def believed(self, q: ArrayLike) -> Array:
        """`(..., 4, 4)` the tool's pose by the controller's kinematics: its calibration and the tool offset."""
        return self.body.flange(q, self.faults.nominal_kinematics) @ self.carried.T_flange_tool

    def true(self, time: Array) -> Array:
        """`(sample, 4, 4)` where the tool truly is: with the physics, at what the encoders show."""
        around = math.ceil(abs(self.body.clock_offset) / SPACING_S) + 1 if self.body.clock_offset else 0
        steps = SPACING_S * np.arange(1, around + 1)
        poses, last, most = [], self.direction, BLOCK - 2 * around
        for part in np.split(time, range(most, len(time), most)):
            instants = np.concatenate([part[0] - steps[::-1], part, part[-1] + steps])
            position, velocity = self.measured(instants)
            direction = _directions(velocity, last)
            last = direction[around + len(part) - 1]
            found = self.body.true_poses(Sample(instants, position, velocity, direction), self.carried)
            poses.append(found[around : around + len(part)])
        return np.concatenate(poses)

    def torque(self, q: Array) -> Array:
        """`(sample, joint)` N·m that hold `(sample, joint)` rad."""
        return self.body.holding_torque(q, self.carried)

    def current(self, torque: Array, velocity: Array) -> Array:
        """`(sample, joint)` A of a made-up motor."""
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
        """Whether a joint is outside its limits, give or take 0.1°."""
        lower, upper = self.body.arm.joint_limits.T
        return bool(((q < lower - LIMIT_SLACK) | (q > upper + LIMIT_SLACK)).any() or not np.isfinite(q).all())


def _directions(velocity: Array, last: Array) -> Array:
    """`(sample, joint)` signs; where a joint stands, that of its last move."""
    direction = np.sign(velocity)
    if not (direction == 0).any():
        return direction
    for k in range(len(direction)):
        before = direction[k - 1] if k else last
        direction[k] = np.where(direction[k] == 0, before, direction[k])
    return direction
