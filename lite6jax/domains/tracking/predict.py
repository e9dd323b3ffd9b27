"""Where the joints of a diagnosed arm are in a motion, rolled out from its commands alone; and commands that bring
them where they are wanted.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.arms.dynamics import declared_links
from lite6jax.array_types import AnyArray, Array, Integers, Mask
from lite6jax.domains.joint_model import JointModel
from lite6jax.domains.torque.rows import RigidBodies
from lite6jax.domains.tracking.coupling import Bodies, loads_along
from lite6jax.domains.tracking.inverse import correct, responses
from lite6jax.domains.tracking.model import TrackingModel, compose, roll_out
from lite6jax.domains.tracking.ranges import (
    Beyond,
    FittedRange,
    concatenate_beyond,
    differentiate,
    find_beyond,
    run_ends,
)
from lite6jax.domains.tracking.rollout import (
    LONGEST_STEP,
    READ_OUT,
    RETURN,
    Commands,
    hold_commands,
    invert_read_out,
    read_out,
)
from lite6jax.domains.tracking.rows import declared_servo
from lite6jax.domains.uncertainty import MARGIN, ReferenceOrigin, Uncertainty
from lite6jax.effects.dynamic import Dynamics, UnnamedInLoop, direction
from lite6jax.effects.motion import motion_of
from lite6jax.effects.servo import Servo
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording, RecordingSettings
from lite6jax.recordings.files import read_commands
from lite6jax.recordings.sequence import held_rows, interpolate_columns
from lite6jax.recordings.settings import ServoSettings
from lite6jax.results import PublicResult

Columns = dict[str, AnyArray]

_CREEPS_AT_LEAST = 100.0
"""s, the time constant of creeping from which friction holds a joint; MuJoCo's joints creep within some seconds."""
_SETTLING = 2.0
"""s for which the first command is held before a predicted run begins."""
_SWEEPS = 6
"""Rollouts at most, each with the torques along the one before."""
_SETTLED = 1e-6
"""rad RMS, by which two of them differ at most at the end."""


@final
@dataclass(frozen=True, eq=False, repr=False)
class TrackedMotion(PublicResult):
    """Joints that follow commands.

    Attributes:
        position: `(sample, joint)` rad, what encoders show.
        beyond: the rows in which a joint's speed, load, reversals or drivers are beyond what was fitted.
    """

    position: Array
    beyond: Beyond

    @property
    def outside(self) -> Mask:
        """`(sample,)`, rows in which anything is beyond what was fitted."""
        return self.beyond.any_joint

    @property
    def shown(self) -> Array:
        """The positions."""
        return self.position

    @property
    def empty(self) -> Mask:
        """`(sample,)`, rows of which nothing is predicted: none."""
        return np.zeros(len(self.position), bool)

    def columns(self) -> Columns:
        """Column name to values: `q1_rad` …, `outside` and, of what is beyond in any row, `outside_speed_joint1` …."""
        columns: Columns = {f"q{joint}_rad": row for joint, row in enumerate(self.position.T, 1)}
        return columns | _outside_columns(self.beyond)


@final
@dataclass(frozen=True, eq=False, repr=False)
class CorrectedCommands(PublicResult):
    """Commands by which joints are where they are wanted, as far as they can.

    Attributes:
        time: `(sample,)` s.
        run: `(sample,)`, which changes where a run begins.
        wanted: `(sample, joint)` rad, where encoders are to show the joints.
        command: `(sample, joint)` rad.
        before: `(sample, joint)` rad, where they show them if `wanted` is commanded.
        after: `(sample, joint)` rad, where they show them by `command`.
        beyond: the rows in which these by `command` are beyond what was fitted.
    """

    time: Array
    run: Integers
    wanted: Array
    command: Array
    before: Array
    after: Array
    beyond: Beyond

    @property
    def outside(self) -> Mask:
        """`(sample,)`, rows in which anything is beyond what was fitted."""
        return self.beyond.any_joint

    @property
    def rows(self) -> int:
        """Samples."""
        return len(self.time)

    @property
    def rows_outside(self) -> int:
        """Samples that are outside."""
        return int(self.outside.sum())

    @property
    def error_before(self) -> Array:
        """`(joint,)` rad RMS."""
        return np.sqrt(np.mean((self.before - self.wanted) ** 2, 0))

    @property
    def error_after(self) -> Array:
        """`(joint,)` rad RMS."""
        return np.sqrt(np.mean((self.after - self.wanted) ** 2, 0))

    def columns(self) -> Columns:
        """Column name to values: `time_s`, `cmd1_rad` …, `run` where there are several, and as of `TrackedMotion`."""
        columns: Columns = {"time_s": self.time}
        columns |= {f"cmd{joint}_rad": row for joint, row in enumerate(self.command.T, 1)}
        if np.any(np.diff(self.run)):
            columns["run"] = np.cumsum(np.r_[0, np.diff(self.run) != 0])
        return columns | _outside_columns(self.beyond)


def _outside_columns(beyond: Beyond) -> Columns:
    """The columns that mark rows beyond what was fitted."""
    by_joint = {f"outside_{name}": mask.astype(int) for name, mask in beyond.by_joint.items()}
    return {"outside": beyond.any_joint.astype(int)} | by_joint


class _GivenMotion(NamedTuple):
    """What is known of a motion before it is rolled out, on an even grid.

    Attributes:
        command: `(sample, joint)` rad.
        time: `(sample,)` s.
        period: s.
        temperature: `(sample, joint)` °C, or None.
    """

    command: Array
    time: Array
    period: float
    temperature: Array | None


def holds_rigidly(servo: Servo) -> Mask:
    """`(joint,)`, whether dry friction holds a joint at rest for longer than motions take; no integral part lets it.

    A joint that creeps comes to where servo and load balance with the time constant G·B/kp.
    """
    creeps_within = np.asarray(servo.grip) * RETURN / np.asarray(servo.stiffness)
    return (np.asarray(servo.coulomb) > 0) & (creeps_within > _CREEPS_AT_LEAST) & (np.asarray(servo.integral) == 0)


def resting_positions(model: TrackingModel, command: Array, friction_share: Array) -> Array:
    """Where joints rest under commands before a motion, `(joint, sample)` rad.

    Dry friction that does not let its joint creep holds it at q where

        q = u − L/kp + s·c/kp,  −1 ≤ s ≤ 1.

    What s is depends on how the joint came there. Other joints begin at their commands.

    Args:
        model: with kp and c of each joint, and the load L that its bodies exert at rest under the commands.
        command: `(joint, sample)` rad, u.
        friction_share: `(joint,)`, s.
    """
    servo = model.servo
    zero = np.zeros_like(command)
    load = model.bodies.torques(command, zero, zero)
    shift = (np.asarray(friction_share) * servo.coulomb)[:, None] - load
    held = holds_rigidly(servo)[:, None]
    return np.where(held, command + shift / np.asarray(servo.stiffness)[:, None], command)


def friction_share_of(model: TrackingModel, command: Array, readout: Array, at_rest: Mask) -> Array:
    """The mean `(joint,)` of s as of `resting_positions`; 0 of joints that do not rest so.

    Args:
        model: likewise.
        command: `(joint, sample)` rad.
        readout: likewise, what encoders show.
        at_rest: `(joint, sample)`, which of them are of a joint at rest.
    """
    servo = model.servo
    position = np.asarray(invert_read_out(readout.T, servo)).T
    balanced = resting_positions(model, command, np.zeros(len(command)))
    friction = np.maximum(np.asarray(servo.coulomb), 1e-12)
    shares = np.clip((position - balanced) * (np.asarray(servo.stiffness) / friction)[:, None], -1.0, 1.0)
    mean = np.sum(np.where(at_rest, shares, 0.0), 1) / np.maximum(at_rest.sum(1), 1)
    return np.where(holds_rigidly(servo), mean, 0.0)


@final
@dataclass(frozen=True, eq=False, repr=False)
class DiagnosedServos(JointModel):
    """An arm with its servos and the effects that were found on how it follows commands.

    Attributes:
        arm: its chain.
        servo: each `(joint,)`, without the effects.
        links: `(joint, 10)` inertial numbers, of the payload none; zero of an arm without masses.
        payload_center: `(3,)` m, in the frame after the last joint.
        payload: kg, as recorded.
        gravity: `(3,)` m/s² in the base frame.
        compensated: whether the servos carry the weight of the arm.
        terms: the effects.
        values: `(terms.size,)`.
        step: s, of integration at most.
        interpolated: whether commands go on a line to the next; else each holds.
        ranges: what was recorded.
        friction_share: `(joint,)`, s of `resting_positions`; where not given, joints rest at their commands.
        reference_temperature: °C.
        uncertainty: none; predictions of joints have no standard deviations.
        reference: none.
    """

    arm: Arm
    servo: Servo
    links: Array
    payload_center: Array
    payload: float
    gravity: Array
    compensated: bool
    terms: Terms
    values: Array
    step: float
    interpolated: bool
    ranges: FittedRange
    friction_share: Array | None = None
    reference_temperature: float = 20.0
    uncertainty: Uncertainty | None = None
    reference: ReferenceOrigin | None = None

    def __repr__(self) -> str:
        effects = ", ".join(term.label for term in self.terms.terms) or "no effects"
        return f"model of the servos of a {self.arm.name} with {effects}"

    def read_motion(self, path: str | Path) -> Recording:
        """Commands whose joints are to be predicted; as `recordings.files.read_commands`."""
        return read_commands(path, self)

    def predicted(self, motion: Recording, time_remedy: str = "add time_s") -> TrackedMotion:
        """The joints that follow the commands of a motion.

        Raises:
            InputError: another number of joints, no commands or no times, or as `predict`.
        """
        return self.predict(*_commands_in(self, motion))

    @cached_property
    def bodies(self) -> Bodies:
        """The rigid bodies, without the effects."""
        gravity = np.zeros(3) if self.compensated else self.gravity
        kinematics = np.asarray(self.arm.kinematics)
        return Bodies(kinematics, self.links, self.payload_center, gravity).with_payload(self.payload)

    @cached_property
    def model(self) -> TrackingModel:
        """With the effects."""
        return compose(TrackingModel(self.servo, self.bodies), self.terms, self.values)

    def predict(
        self,
        time: ArrayLike,
        command: ArrayLike,
        run: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
    ) -> TrackedMotion:
        """Where the joints are in a motion, rolled out from rest under its first command.

        Joints that friction holds rigidly rest beside it, as far as in the recording; the others at it.

        Args:
            time: `(sample,)` s.
            command: `(sample, joint)` rad.
            run: `(sample,)`, which changes where a run begins; one run where not given.
            temperature: `(sample, joint)` °C of each joint, which only effects need that depend on it.

        Raises:
            InputError: arrays of other shapes, numbers that are not finite, times that do not increase in a run, no
                temperatures where they are needed, or a motion along which the rollout is not finite.
        """
        t, u, runs = _checked(time, command, run, self.dof)
        warmth = _checked_temperature(temperature, u.shape)
        position = np.empty(u.shape)
        beyond = list[Beyond]()
        for first, last in zip(*run_ends(runs), strict=True):
            rows = slice(first, last)
            position[rows], beyond_in_run = self._predict_run(t[rows], u[rows], _rows_of(warmth, rows))
            beyond.append(beyond_in_run)
        return TrackedMotion(position, concatenate_beyond(beyond))

    def commands_for(
        self,
        time: ArrayLike,
        position: ArrayLike,
        run: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
    ) -> CorrectedCommands:
        """Commands by which encoders show the joints where they are wanted, at the times of the rows.

        They look ahead of delay and lag, and add what sag and friction take. Where the arm moves before they can, or
        faster than its servos follow, an error is left; so it is of joints that friction holds. Before a run its first
        command holds. Commands stay within the limits of the joints, and near where these are wanted.

        Args:
            time: `(sample,)` s, of the commands.
            position: `(sample, joint)` rad, where the joints are wanted; the commands as they would be given.
            run: `(sample,)`, which changes where a run begins; one run where not given.
            temperature: `(sample, joint)` °C, as of `predict`.

        Raises:
            InputError: as `predict`.
        """
        t, wanted, runs = _checked(time, position, run, self.dof)
        warmth = _checked_temperature(temperature, wanted.shape)
        command = wanted.copy()
        for first, last in zip(*run_ends(runs), strict=True):
            rows = slice(first, last)
            command[rows] = self._correct_run(t[rows], wanted[rows], _rows_of(warmth, rows))
        before = self.predict(t, wanted, runs, warmth).position
        after = self.predict(t, command, runs, warmth)
        return CorrectedCommands(t, runs, wanted, command, before, after.position, after.beyond)

    def _correct_run(self, time: Array, wanted: Array, warmth: Array | None) -> Array:
        """`(sample, joint)` rad, the commands of one run."""
        if len(time) == 1:
            twice = None if warmth is None else np.vstack([warmth, warmth])
            return self._correct_run(time[0] + np.array([0.0, self.step]), np.vstack([wanted, wanted]), twice)[:1]
        period = float(np.median(np.diff(time)))
        grid = time[0] + period * np.arange(int(np.ceil((time[-1] - time[0]) / period - 1e-6)) + 1)
        even = interpolate_columns(grid, time, wanted)
        held = held_rows(time, grid, period)
        even_warmth = None if warmth is None else warmth[held]

        def follow(command: Array) -> Array:
            return self._predict_run(grid, command, even_warmth)[0]

        model = self.model
        mass = model.bodies.masses(even.T).mean(1)
        response = responses(model.servo, mass, period, self.step, self.interpolated)
        command = correct(follow, even, response, period, self.joint_limits).command
        return interpolate_columns(time, grid, command)

    def _predict_run(self, time: Array, command: Array, warmth: Array | None) -> tuple[Array, Beyond]:
        """`(sample, joint)` rad, and where it is beyond what was fitted, of one run."""
        if len(time) == 1:
            time = time[0] + np.array([0.0, self.step])
            command = np.vstack([command, command])
            twice = None if warmth is None else np.vstack([warmth, warmth])
            position, beyond = self._predict_run(time, command, twice)
            return position[:1], beyond.at([0])
        period = float(np.median(np.diff(time)))
        before = int(np.ceil(_SETTLING / period))
        samples = int(np.ceil((time[-1] - time[0]) / period - 1e-6)) + 1
        # commands that are looked ahead to hold beyond the last row
        servo = self.model.servo
        ahead = np.max(servo.clock_rate) * (time[-1] - time[0]) - np.min(servo.delay)
        after = int(np.ceil(max(float(ahead), 0.0) / period))
        grid = time[0] + period * np.arange(-before, samples + after)
        held = held_rows(time, grid, period)
        u = command[held]
        if self.interpolated:
            u = interpolate_columns(grid, time, command)
        run = np.zeros(len(u), int)
        begun = u
        if self.friction_share is not None:
            begun = np.vstack([resting_positions(self.model, u[:1].T, self.friction_share)[:, 0], u[1:]])
        shown = np.asarray(read_out(begun, servo))
        commands = hold_commands(u, run, period, shown, interpolated=self.interpolated, longest=self.step)
        given = _GivenMotion(u, np.maximum(grid, time[0]), period, None if warmth is None else warmth[held])
        readout = self._rolled_out(commands, given, before * period)
        if not np.isfinite(readout).all():
            raise InputError("commands: the fitted servos cannot hold the arm along them; stay near what was fitted")
        of_driver = self._driver_beyond(readout, given)[before:]
        beyond = find_beyond(self.ranges, self.bodies, readout[:, before:], period)._replace(driver=of_driver)
        of_run = grid[before:]
        position = interpolate_columns(time, of_run, readout[:, before:].T)
        rows = held_rows(of_run, time, period)
        return position, beyond.at(rows)

    def _rolled_out(self, commands: Commands, given: "_GivenMotion", early: float) -> Array:
        """Read-outs `(joint, sample)` rad; what the motion adds to joints is that along the rollout before.

        The rollout begins some s before the run, at whose first row the two clocks agree.

        Args:
            commands: as they are rolled out.
            given: the same, with what else is known of the motion.
            early: s.
        """
        still = np.zeros_like(given.command.T)
        servo = self.model.servo
        model = replace(self.model, servo=servo._replace(delay=servo.delay + early * servo.clock_rate))
        coupled = bool(self.links.any())
        loads = loads_along(model.bodies, commands, given.command.T, still, still)
        readout, loads = roll_out(model, commands, loads, None, coupled)
        if not model.driven:
            return readout
        for _ in range(_SWEEPS):
            extra = model.added(self._dynamics_along(readout, given))
            assert extra is not None
            before = readout
            begun = commands._replace(start=commands.start + extra[:, READ_OUT].T)  # read-outs, as of commands
            readout, loads = roll_out(model, begun, loads, extra, coupled)
            if not np.sqrt(np.mean((readout - before) ** 2)) > _SETTLED:
                break
        return readout

    def _dynamics_along(self, position: Array, given: "_GivenMotion") -> Dynamics:
        """The arm along positions `(joint, sample)` rad."""
        velocity = np.gradient(position, given.period, axis=1)
        motion = motion_of(
            position.T,
            joint_velocity=velocity.T,
            time=given.time,
            joint_temperature=given.temperature,
            payload=np.full(position.shape[1], self.payload),
            reference_temperature=self.reference_temperature,
        )._replace(
            joint_position=position,
            joint_velocity=velocity,
            direction=direction(velocity),
            joint_acceleration=np.gradient(velocity, given.period, axis=1),
            command_velocity=differentiate(given.command.T, given.period),
        )
        kinematics = np.asarray(self.arm.kinematics)
        bodies = RigidBodies(motion, self.links, self.payload_center, self.gravity, kinematics)
        return bodies.dynamics(self.links)

    def _driver_beyond(self, readout: Array, given: "_GivenMotion") -> Mask:
        """`(sample, joint)`, where a quantity on which a process of the joint depends is beyond what was recorded."""
        beyond = np.zeros(readout.T.shape, bool)
        processes = [effect for effect, _ in self.model.driven if isinstance(effect, UnnamedInLoop)]
        if not processes:
            return beyond
        dynamics = self._dynamics_along(readout, given)
        for process in processes:
            lower, upper = np.reshape(process.bounds, (-1, 2)).T[..., None]
            margin = MARGIN * (upper - lower)
            values = process.values_in(dynamics)
            beyond[:, process.joint - 1] |= np.any((values < lower - margin) | (values > upper + margin), 0)
        return beyond


def describe_servos(
    arm: Arm, settings: RecordingSettings, payload: float, terms: Terms | None = None, values: Array | None = None
) -> DiagnosedServos:
    """An arm with the servos that a sidecar declares, as a model; what it is fitted to has no range.

    Args:
        arm: whose friction and rotors the servos have.
        settings: with declared servos.
        payload: kg at the flange.
        terms: effects; none where not given.
        values: `(terms.size,)`.

    Raises:
        InputError: the servos are not declared.
    """
    servo_settings = settings.servo
    if not isinstance(servo_settings, ServoSettings):
        raise InputError("servo: is not declared; give stiffness_Nm_per_rad and damping_Nm_s_per_rad of each joint")
    gravity = np.array(settings.gravity_m_per_s2)
    bodies = Bodies.of_arm(arm, payload, np.array(settings.payload_com_m), gravity)
    servo, _ = declared_servo(settings, arm, bodies)
    none = np.zeros((arm.dof, 2))
    return DiagnosedServos(
        arm=arm,
        servo=servo,
        links=declared_links(arm),
        payload_center=bodies.payload_center,
        payload=payload,
        gravity=gravity,
        compensated=servo_settings.gravity_compensation,
        terms=terms or Terms(),
        values=np.zeros(0) if values is None else values,
        step=LONGEST_STEP,
        interpolated=servo_settings.hold == "interpolated",
        ranges=FittedRange(none, none, np.full(arm.dof, np.inf)),
        reference_temperature=settings.reference_temperature_degC,
    )


def _checked(time: ArrayLike, command: ArrayLike, run: ArrayLike | None, joints: int) -> tuple[Array, Array, Integers]:
    """The arguments of `DiagnosedServos.predict` as arrays."""
    t = np.asarray(time, float)
    u = np.asarray(command, float)
    runs = np.zeros(len(t), int) if run is None else np.asarray(run)
    if t.ndim != 1 or u.shape != (len(t), joints) or runs.shape != t.shape or len(t) < 2:
        raise InputError(
            f"commands: time, command and run have the shapes {t.shape}, {u.shape} and {runs.shape}; give (sample,), "
            f"(sample, {joints}) and (sample,), of two samples or more"
        )
    if not (np.isfinite(t).all() and np.isfinite(u).all()):
        raise InputError("commands: hold numbers that are not finite; leave out such rows")
    if np.any((np.diff(t) <= 0) & (np.diff(runs) == 0)):
        row = int(np.flatnonzero((np.diff(t) <= 0) & (np.diff(runs) == 0))[0]) + 2
        raise InputError(f"commands: the time does not increase in row {row}; sort the rows, or begin a run there")
    return t, u, runs


def _checked_temperature(temperature: ArrayLike | None, shape: tuple[int, ...]) -> Array | None:
    """Temperatures of each joint as an array of a shape; None where there are none."""
    if temperature is None:
        return None
    degrees = np.asarray(temperature, float)
    if degrees.shape != shape or not np.isfinite(degrees).all():
        raise InputError(f"commands: temperature has the shape {degrees.shape}; give finite numbers {shape}")
    return degrees


def _rows_of(values: Array | None, rows: slice) -> Array | None:
    return None if values is None else values[rows]


def commands_to_follow(model: DiagnosedServos, motion: Recording) -> CorrectedCommands:
    """Commands by which the joints are where the commands of a motion want them.

    Raises:
        InputError: as `DiagnosedServos.predicted`.
    """
    return model.commands_for(*_commands_in(model, motion))


def _commands_in(model: DiagnosedServos, motion: Recording) -> tuple[Array, Array, Integers, Array | None]:
    """Times, commands, runs and, where they are known, temperatures of joints of a motion of the diagnosed arm."""
    if motion.dof != model.dof:
        raise InputError(f"{motion.source}: has {motion.dof} joints, the diagnosed arm {model.dof}")
    if motion.commanded_position is None:
        raise InputError(f"{motion.source}: has no commands; add cmd1_rad ...")
    if motion.time is None:
        raise InputError(f"{motion.source}: commands need times; add time_s")
    temperature = motion.joint_temperature
    if temperature is None and motion.ambient_temperature is not None:
        temperature = np.repeat(motion.ambient_temperature[:, None], motion.dof, 1)
    return motion.time, motion.commanded_position, motion.run, temperature
