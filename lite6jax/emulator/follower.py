"""An emulated arm that follows its commands as servos do, rolled out piece by piece as time goes on.

Pieces overlap. Each begins 2 to 20 s before the part of it that is used, at the positions and velocities that joints
had there. By the time it is used, the unknown beginnings of delays, filters and integrals have faded.
"""

from collections.abc import Callable
from typing import NamedTuple, final

import numpy as np

from lite6jax.array_types import Array, Integers
from lite6jax.domains.tracking.coupling import loads_along, roll_coupled
from lite6jax.domains.tracking.predict import DiagnosedServos
from lite6jax.domains.tracking.rollout import Rolled, hold_commands, read_out
from lite6jax.effects.servo import Servo
from lite6jax.errors import InputError

PERIOD_S = 0.004
"""s, for which a command holds: commands are sent as often as they are reported."""
_STEPS = 4
"""Of integration while a command holds."""
_PIECE = 500
"""Commands that are followed at once: two seconds of them take about a tenth of a second."""
_FADED = 20.0
"""Time constants, after which a servo has forgotten what was before."""
_SHORTEST_S = 2.0
_LONGEST_S = 20.0
"""s, by which pieces begin early at least, and at most."""
_SETTLED = 1e-7
"""rad RMS, by which the last two rollouts of the coupled arm differ: as much as reports of 32 bits round."""
_NOT_EMULATED = "is not emulated; leave it out, or use `lite6jax simulate --tracking`"


@final
class _FollowedMotion(NamedTuple):
    """What was rolled out, each `(step, joint)`.

    Attributes:
        position, velocity: rad and rad/s, of the joints.
        drive: rad, of encoders, behind their play.
        shown, shown_velocity: rad and rad/s, by encoders.
    """

    position: Array
    velocity: Array
    drive: Array
    shown: Array
    shown_velocity: Array

    def rows(self, rows: slice) -> "_FollowedMotion":
        """Some of the steps."""
        return _FollowedMotion(*(values[rows] for values in self))

    def joined(self, later: "_FollowedMotion") -> "_FollowedMotion":
        """With the steps of another after these."""
        return _FollowedMotion(*(np.concatenate(pair) for pair in zip(self, later, strict=True)))


@final
class ServoedJoints:
    """Where the joints of an arm are, and what its encoders show, at any time up to the present and a little before.

    Args:
        servos: the arm with its servos, its payload and the effects on how it follows.
        commands: positions `(sample, joint)` rad at `(sample,)` s; before time 0 those at it.

    Raises:
        InputError: effects that no arm has that is followed as it moves, or servos that do not hold the arm.
    """

    def __init__(self, servos: DiagnosedServos, commands: Callable[[Array], Array]) -> None:
        self._commands = commands
        self._model = servos.model
        self._interpolated = servos.interpolated
        servo = self._model.servo
        for effect, _ in self._model.driven:
            raise InputError(f"{effect.label}: {_NOT_EMULATED}")
        if np.any(servo.clock_rate) or np.any(np.asarray(servo.delay) < 0):
            raise InputError(f"clock_drift, or a delay below 0: {_NOT_EMULATED}")
        self._early = round(_memory(servo) / PERIOD_S)
        self._begin = self._end = 0  # of the steps that are known, in commands since time 0
        none = np.zeros((0, len(servo.stiffness)))
        self._motion = _FollowedMotion(none, none, none, none, none)
        self._extend()

    def read_joints(self, time: Array) -> tuple[Array, Array]:
        """The true positions and velocities `(sample, joint)`, rad and rad/s, at `(sample,)` s."""
        steps, share = self._find(time)
        return _between(self._motion.position, steps, share), _between(self._motion.velocity, steps, share)

    def read_encoders(self, time: Array) -> tuple[Array, Array]:
        """What the encoders show of them at `(sample,)` s."""
        steps, share = self._find(time)
        return _between(self._motion.shown, steps, share), _between(self._motion.shown_velocity, steps, share)

    def forget_after(self, time: float) -> None:
        """Drops what follows from commands after a time in s, which are others now."""
        end = max(int(time / PERIOD_S), self._begin)
        if end < self._end:
            self._motion = self._motion.rows(slice((end - self._begin) * _STEPS))
            self._end = end

    def _find(self, time: Array) -> tuple[Integers, Array]:
        """The steps `(sample,)` before times in s, and the shares `(sample, 1)` of the step from there."""
        while np.max(time) >= (self._end - 1) * PERIOD_S:
            self._extend()
        step = np.clip(time / PERIOD_S - self._begin, 0.0, None) * _STEPS
        before = np.floor(step + 1e-6).astype(int)
        return before, np.clip(step - before, 0.0, 1.0)[:, None]

    def _extend(self) -> None:
        """Rolls out the next piece, and drops what is older than the one after it needs."""
        fresh = self._early * _STEPS
        begin = self._end - self._early
        u = self._commands(PERIOD_S * np.maximum(np.arange(begin, self._end + _PIECE), 0))
        position = u.copy()
        velocity = np.zeros_like(u)
        if not len(self._motion.position):
            fresh = 0
            self._begin = begin
        elif begin >= self._begin:
            position[0] = self._motion.position[(begin - self._begin) * _STEPS]
            velocity[0] = self._motion.velocity[(begin - self._begin) * _STEPS]
        rolled = self._roll(u, position, velocity)
        joints = rolled.position.T[fresh:]
        drives = self._play(joints)
        shown = np.asarray(read_out(drives, self._model.servo))
        before = self._motion.shown[-1:] if fresh else shown[:1]
        pace = np.diff(np.concatenate([before, shown]), axis=0) * (_STEPS / PERIOD_S)
        piece = _FollowedMotion(joints, rolled.velocity.T[fresh:], drives, shown, pace)
        self._end += _PIECE
        surplus = max(self._end - self._begin - self._early - 2 * _PIECE, 0)
        self._begin += surplus
        self._motion = self._motion.joined(piece).rows(slice(surplus * _STEPS, None))

    def _roll(self, u: Array, position: Array, velocity: Array) -> Rolled:
        """The arm under commands `(sample, joint)` rad, from the first of positions and velocities of that shape."""
        servo = self._model.servo
        bodies = self._model.bodies
        commands = hold_commands(
            u,
            np.zeros(len(u), int),
            PERIOD_S,
            np.asarray(read_out(position, servo)),
            velocity,
            interpolated=self._interpolated,
            longest=PERIOD_S / _STEPS,
        )
        still = np.zeros_like(u.T)
        loads = loads_along(bodies, commands, u.T, still, still)
        rolled, _ = roll_coupled(servo, commands, bodies, loads, settled=_SETTLED)
        if not np.isfinite(rolled.position).all():
            raise InputError("emulator: the servos cannot hold the arm in this motion; give weaker effects")
        return rolled

    def _play(self, joints: Array) -> Array:
        """Where the drives of encoders are `(step, joint)` rad, which follow joints with a play."""
        half_width = np.asarray(self._model.servo.backlash)
        if not half_width.any():
            return joints
        drives = np.empty_like(joints)
        drive = self._motion.drive[-1] if len(self._motion.drive) else joints[0]
        for step, position in enumerate(joints):
            drive = np.clip(drive, position - half_width, position + half_width)
            drives[step] = drive
        return drives


def _memory(servo: Servo) -> float:
    """s, after which servos have forgotten what was before."""
    integral = np.asarray(servo.integral)
    constants = [
        np.asarray(servo.time_constant),
        np.asarray(servo.damping) / servo.stiffness,
        np.where(integral > 0, servo.stiffness / np.where(integral > 0, integral, 1.0), 0.0),
    ]
    memory = np.max(servo.delay) + _FADED * np.max(constants)
    return float(np.clip(memory, _SHORTEST_S, _LONGEST_S))


def _between(values: Array, steps: Integers, share: Array) -> Array:
    """Values `(sample, joint)` at shares `(sample, 1)` of the way from steps `(sample,)` to the next."""
    return values[steps] + share * (values[steps + 1] - values[steps])
