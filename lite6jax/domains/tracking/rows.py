"""The rows of a tracking recording on an even grid: commands, read-outs, the declared servos and the rigid bodies."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import jax
import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.arms.dynamics import declared_links
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.torque.filtering import low_pass, runs_of, smoothed, spectra
from lite6jax.domains.torque.rows import RigidBodies, require_joints
from lite6jax.domains.tracking.coupling import Bodies
from lite6jax.domains.tracking.ranges import differentiate_runs
from lite6jax.domains.tracking.rollout import LONGEST_STEP, Commands, hold_commands
from lite6jax.domains.tracking.stamps import read_stamps
from lite6jax.effects.dynamic import Dynamics, direction
from lite6jax.effects.motion import Motion
from lite6jax.effects.servo import Servo
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.motion import motion_of_recording
from lite6jax.recordings.sequence import held_rows, interpolate_columns
from lite6jax.recordings.settings import RecordingSettings, ServoSettings

FLOOR = 3e-5
"""rad, by which rollouts of two simulators of the same arm differ; noise counts as at least that."""
INEXACT = 1e-5
"""rad RMS at a joint, by which rollouts differ all along a motion, most where friction lets go: steps of integration a
fourth as long move them by 8 µrad. What moves every joint by less is no effect that is known to be there."""
COARSE = 3e-4
"""rad of noise, from which integration steps beside unknown servos are `_LONG`, and loads stay those along the measured
motion."""
_FINE = 5e-5
"""rad of noise, below which integration steps are half as long: light joints and rate limits are off by up to 30 µrad
at the longest step, and by a quarter of that at half of it."""
_SHORT_LOG = 12.0
"""s of motion, up to which steps are halved: a log of 40 s of six joints would take 86 s in place of 38."""
_LONG = 0.005
"""s, of an integration step of recordings with that noise."""
_ROUGH = 0.01
"""s, likewise, while servos are looked for, and of arms that no simulation describes to `COARSE`."""
_STILL = 0.2
"""s at the beginning of a run over which a resting arm is averaged."""
_MOVED = 5.0
"""Standard deviations of the noise within which an arm rests."""
SAME = 1e-6
"""rad, by which commands and read-outs differ at most where they are one."""
MOVING = 1e-2
"""rad, standard deviation or range of commands and read-outs, from which a joint moves and they are compared."""
LATEST = 0.5
"""s, by which a read-out follows its command at most."""
FOLLOWS = 0.9
"""Correlation from which a read-out follows a command."""
UNRELATED = 0.5
"""Correlation below which it does not."""
_LAGS = 26
"""Lags at which read-outs and commands are correlated."""
_ALIKE = 0.03
"""By which correlations at two lags differ at most where both suit alike: of a motion of 3 Hz, that of half the step
between lags."""
LEAST_GEAR = 1.7
"""Ratio of read-outs to commands beyond which they have other units or gears: the least gear is 2 : 1."""
_UNITS = (0.5, np.pi / 180)
"""Gains of gears and units that are less than one."""
_NEAR = 0.1
"""Share of such a gain within which a joint may have it."""
_ROUNDING = 2e-9
"""rad, by which two values differ at most that are the same but for the digits of a file."""
_LEAST_STEPS = 5
"""Differences of values from which a read-out may be known to have a step."""
_MULTIPLES = 50
"""Multiples of a step that tell it; values without one are seldom so near each other."""
_WHOLE = 0.1
_MOSTLY = 0.95
"""By which multiples are whole, and the share of them that is."""
_ABOVE_NOISE = 10.0
"""Power spectral density over that of white noise, from which read-outs show something beside a rollout: of noise one
frequency in 20 000 has as much."""
_WIDER = 1.5
"""Of that band, the low pass."""
_LEAST_BAND = 2.0
"""Hz of it at least."""


@final
@dataclass(frozen=True, eq=False)
class TrackingRows:
    """What a tracking recording holds, on an even grid.

    Attributes:
        recording: its rows on the grid, `row` the data row of each.
        arm: the declared arm.
        bodies: its rigid bodies, without masses where it has none.
        commands: held between samples.
        measured: `(joint, sample)` rad.
        noise: `(joint,)` rad, one sigma of read-outs, their quantum and `FLOOR` included.
        servo: each `(joint,)`, as declared, with friction and rotors of the arm's description.
        declared: whether the servo is declared.
        coupled: whether rollouts are those of the coupled arm.
        rolled: `(joint, sample)` rad, where a rollout has the encoders; None where none is taken for the motion.
    """

    recording: Recording
    arm: Arm
    bodies: Bodies
    commands: Commands
    measured: Array
    noise: Array
    servo: Servo
    declared: bool
    coupled: bool
    rolled: Array | None = None

    @property
    def has_masses(self) -> bool:
        """Tells whether the masses of the arm's links are known."""
        return self.arm.mass is not None and bool(self.bodies.links.any())

    @cached_property
    def coarse(self) -> "TrackingRows":
        """The same, rolled out in long steps along the loads of the measured motion."""
        return replace(self, commands=_held(self.recording, self.noise, _ROUGH), coupled=False)

    @cached_property
    def finer(self) -> "TrackingRows":
        """The same, rolled out in half of the longest steps."""
        return replace(self, commands=_held(self.recording, self.noise, 0.5 * LONGEST_STEP))

    @cached_property
    def motion(self) -> Motion:
        """The measured motion, smoothed, with accelerations; NumPy arrays."""
        return measured_motion(self.recording, self.rolled, self.noise)

    @cached_property
    def dynamics(self) -> Dynamics:
        """The arm along the measured motion."""
        arm = self.arm
        settings = self.recording.settings
        links = declared_links(arm)
        center = self.bodies.payload_center
        gravity = np.array(settings.gravity_m_per_s2)
        return RigidBodies(self.motion, links, center, gravity, np.asarray(arm.kinematics)).dynamics(links)


def measured_motion(recording: Recording, rolled: Array | None = None, noise: Array | None = None) -> Motion:
    """The motion of an even recording, low-passed, with accelerations.

    A motion of steps needs a band in which accelerations hold the noise of the read-outs. Functions of the load would
    explain that noise by itself. Beside a rollout, only the difference from it is measured, up to where that exceeds
    the noise.

    Args:
        recording: with times.
        rolled: `(joint, sample)` rad, where a rollout has the encoders; the motion is all measured where not given.
        noise: `(joint,)` rad, of the read-outs beside a rollout.
    """
    rate = 1 / period_of(recording)
    chosen = low_pass(recording.velocities().T, rate, runs_of(recording, rate))
    smooth = smoothed(recording, chosen)
    if rolled is not None and noise is not None:
        of_rollout = smoothed(_moved(recording, rolled.T), chosen, smooth.cutoff)
        rest = recording.joint_position - rolled.T
        frequency, power = spectra(rest.T, chosen)
        above = np.flatnonzero((power > _ABOVE_NOISE * (2 * noise**2 / rate)[:, None]).any(0))
        band = float(frequency[above[-1]]) if above.size else 0.0
        cutoff = min(max(_WIDER * band, _LEAST_BAND), smooth.cutoff)
        beyond = smoothed(_moved(recording, rest), chosen, cutoff)
        smooth = smooth._replace(
            position=of_rollout.position + beyond.position,
            velocity=of_rollout.velocity + beyond.velocity,
            acceleration=of_rollout.acceleration + beyond.acceleration,
        )
    return jax.tree.map(np.asarray, motion_of_recording(recording))._replace(
        joint_position=smooth.position,
        joint_velocity=smooth.velocity,
        direction=direction(smooth.velocity),
        joint_acceleration=smooth.acceleration,
        command_velocity=differentiate_runs(np.asarray(recording.commanded_position).T, 1 / rate, recording.run),
    )


def _moved(recording: Recording, position: Array) -> Recording:
    """A trajectory at the times of a recording, of other positions `(sample, joint)` rad."""
    return Recording.assembled(
        joint_position=position,
        time=recording.time,
        run=recording.run,
        settings=recording.settings,
        source=recording.source,
        sliding=recording.sliding,
    )


def period_of(even: Recording) -> float:
    """s between the samples of an even recording."""
    assert even.time is not None
    return float(np.median(np.diff(even.time)))


def even_rows(recording: Recording) -> Recording:
    """The rows on an even grid: read-outs on lines between rows, all else held from the row before.

    Of rows with one stamp the last one counts. A gap of more than ten samples, or a time that goes back, begins a run.

    Raises:
        InputError: as `read_stamps`.
    """
    stamps = read_stamps(recording)
    time = stamps.time
    period = stamps.period
    names = ("commanded_position", "payload", "joint_temperature", "ambient_temperature")
    parts: dict[str, list[Array]] = {name: [] for name in ("time", "joint_position", *names)}
    rows: list[Integers] = []
    runs: list[Integers] = []
    for number, piece in enumerate(stamps.pieces):
        t = time[piece]
        grid = t[0] + period * np.arange(int(np.floor((t[-1] - t[0]) / period + 1e-6)) + 1)
        held = piece[held_rows(t, grid, period)]
        rows.append(recording.row[held])
        runs.append(np.full(len(grid), number))
        parts["time"].append(grid)
        parts["joint_position"].append(interpolate_columns(grid, t, recording.joint_position[piece]))
        for name, values in zip(names, _held_columns(recording), strict=True):
            if values is not None:
                parts[name].append(values[held])
    arrays: dict[str, Any] = {name: np.concatenate(part) for name, part in parts.items() if part}
    return Recording.assembled(
        **arrays,
        run=np.concatenate(runs),
        row=np.concatenate(rows),
        settings=replace(recording.settings, motion="trajectory"),
        source=recording.source,
        sliding=recording.sliding,
    )


def _held_columns(recording: Recording) -> tuple[Array | None, ...]:
    """What holds from a row to the next, `(sample, …)`: commands, payload and temperatures."""
    return (
        recording.commanded_position,
        recording.payload,
        recording.joint_temperature,
        recording.ambient_temperature,
    )


def declared_servo(settings: RecordingSettings, arm: Arm, bodies: Bodies) -> tuple[Servo, bool]:
    """The servos `(joint,)` of a sidecar, and whether it declares them; with the friction and rotors of the arm."""
    joints = arm.dof
    given = settings.servo
    fields = {"viscous": arm.viscous_friction, "coulomb": arm.coulomb_friction, "inertia": arm.rotor_inertia}
    of_arm = {name: np.array(numbers, float) for name, numbers in fields.items() if numbers is not None}
    if arm.spring_stiffness is not None and arm.spring_rest is not None:
        of_arm["spring"] = np.array(arm.spring_stiffness)
        of_arm["spring_torque"] = -arm.spring_stiffness * arm.spring_rest
    if not isinstance(given, ServoSettings):
        # its damping is that of the servo and of friction: nothing in a log tells one from the other
        of_arm.pop("viscous", None)
        usual = Servo.ideal(np.full(joints, 100.0), np.full(joints, 5.0))
        return usual._replace(delay=np.zeros(joints), grip=bodies.grip, **of_arm), False
    if given.torque_limit_Nm is not None:
        of_arm["torque_limit"] = np.array(given.torque_limit_Nm)
    if given.time_constant_s is not None:
        of_arm["time_constant"] = np.array(given.time_constant_s)
    servo = Servo.ideal(np.array(given.stiffness_Nm_per_rad), np.array(given.damping_Nm_s_per_rad))
    return servo._replace(delay=np.full(joints, given.delay_s), grip=bodies.grip, **of_arm), True


def quantum(values: Array) -> float:
    """The step of a read-out `(sample,)`, of which differences of its values are multiples; zero where it has none."""
    apart = np.diff(np.unique(np.round(values, 9)))
    apart = apart[apart > _ROUNDING]
    if len(apart) < _LEAST_STEPS:
        return 0.0
    step = float(np.mean(apart[apart < 1.5 * np.min(apart)]))
    multiples = apart / step
    # of longer differences the error of the step itself is too large a part
    short = multiples < _MULTIPLES
    whole = np.abs(multiples - np.round(multiples))[short] < _WHOLE
    return step if np.mean(short) > 0.5 and np.mean(whole) > _MOSTLY else 0.0


def _beginnings(even: Recording) -> list[Array]:
    """Read-outs `(sample, joint)` rad of the first `_STILL` of each run."""
    period = period_of(even)
    long = max(int(_STILL / period), 1)
    beginnings = []
    for first in np.flatnonzero(np.r_[True, np.diff(even.run) != 0]):
        part = even.joint_position[first : first + long]
        beginnings.append(part[even.run[first : first + long] == even.run[first]])
    return beginnings


def begins_at_rest(even: Recording, noise: Array) -> Mask:
    """`(joint, run)`, whether joints rest where runs of an even recording begin, in noise `(joint,)` rad."""
    return np.stack([np.ptp(part, 0) < 2 * _MOVED * noise for part in _beginnings(even)], 1)


def _start(even: Recording, noise: Array) -> Array:
    """`(sample, joint)` rad, from which runs begin: of an arm that rests there, the mean over `_STILL`."""
    start = even.joint_position.copy()
    first = np.flatnonzero(np.r_[True, np.diff(even.run) != 0])
    means = np.stack([part.mean(0) for part in _beginnings(even)])
    start[first] = np.where(begins_at_rest(even, noise).T, means, start[first])
    return start


def lagged_correlation(command: Array, measured: Array, period: float) -> Array:
    """How read-outs follow commands, `(read-out, command)`, each at the lag of at most `LATEST` that suits it best.

    A motion to and fro follows itself with either sign, half a period later: of lags that suit alike the sign is that
    of the shortest.

    Args:
        command: `(sample, column)`.
        measured: `(sample, column)`.
        period: s between samples.
    """
    count = measured.shape[1]
    if not count:
        return np.zeros((0, 0))
    lags = np.unique(np.linspace(0, min(LATEST / period, len(command) // 2), _LAGS).astype(int))
    correlations = np.zeros((len(lags), count, count))
    for place, lag in enumerate(lags):
        with np.errstate(divide="ignore", invalid="ignore"):  # of a column that stands still
            both = np.corrcoef(measured[lag:].T, command[: len(command) - lag].T)
        correlations[place] = np.nan_to_num(np.atleast_2d(both)[:count, count:])
    size = np.abs(correlations)
    largest = size.max(0)
    earliest = np.argmax(size >= largest - _ALIKE, axis=0)
    sign = np.sign(np.take_along_axis(correlations, earliest[None], 0)[0])
    return sign * largest


def _check_commands(even: Recording) -> None:
    """Refuses read-outs that follow commands with another sign, or those of another joint.

    Read-outs and commands are correlated at the lag of at most `LATEST` that suits each pair best.
    """
    command = np.asarray(even.commanded_position)
    measured = even.joint_position
    moving = np.flatnonzero((np.std(command, 0) > MOVING) & (np.std(measured, 0) > MOVING))
    period = period_of(even)
    best = lagged_correlation(command[:, moving], measured[:, moving], period)
    for place, joint in enumerate(moving.tolist()):
        follows = best[place, place]
        other = int(np.argmax(best[place]))
        column = joint + 1
        if follows < -FOLLOWS:
            raise InputError(
                f"{even.source}: q{column}_rad moves against cmd{column}_rad; change the sign of one of them"
            )
        if abs(follows) < UNRELATED and best[place, other] > FOLLOWS:
            raise InputError(
                f"{even.source}: q{column}_rad follows cmd{moving[other] + 1}_rad and not cmd{column}_rad; exchange "
                "the columns"
            )


def gains_of_other_units(even: Recording) -> dict[int, float]:
    """The joints, from 0, that follow their commands as in another unit or after a gear: how far, over the commands."""
    command = np.asarray(even.commanded_position)
    gains = {}
    for joint in np.flatnonzero((np.std(command, 0) > MOVING) & (np.std(even.joint_position, 0) > MOVING)).tolist():
        measured = even.joint_position[:, [joint]]
        follows = float(lagged_correlation(command[:, [joint]], measured, period_of(even))[0, 0])
        gain = follows * float(np.std(measured) / np.std(command[:, joint]))
        # one below all of these is that of a soft servo, or of friction that holds the joint
        is_of_unit = gain >= LEAST_GEAR or min(abs(gain / unit - 1) for unit in _UNITS) <= _NEAR
        if follows > FOLLOWS and is_of_unit:
            gains[joint] = gain
    return gains


def _held(even: Recording, noise: Array, longest: float) -> Commands:
    """The commands of an even recording, in integration steps of at most so many s."""
    period = period_of(even)
    servo = even.settings.servo
    interpolated = isinstance(servo, ServoSettings) and servo.hold == "interpolated"
    command = np.asarray(even.commanded_position)
    return hold_commands(command, even.run, period, _start(even, noise), None, interpolated, longest)


def usual_payload(recording: Recording) -> float:
    """kg, the payload of a recording, or the median of several; it is that of some row."""
    return float(np.quantile(recording.payload, 0.5, method="lower"))


def with_known_masses(recording: Recording, arm: Arm) -> Arm:
    """The arm, without its masses where the sidecar says that they are not known.

    Raises:
        InputError: masses that are uncertain by a share, which are not fitted.
    """
    inertial = recording.settings.inertial
    if inertial == "declared":
        return arm
    if inertial != "unknown":
        raise InputError(
            f"{recording.source}: recording.inertial is {inertial:g}: beside commands masses are taken as exact or as "
            "unknown; write inertial: declared, or inertial: unknown"
        )
    return replace(arm, mass=None, center_of_mass=None, inertia=None)


def tracking_rows(recording: Recording, arm: Arm) -> TrackingRows:
    """The rows of a recording with commands.

    Raises:
        InputError: no commands, no times, too few rows, joints of another kind or number, commands that are the
            read-outs again, or as `with_known_masses`.
    """
    require_joints(recording, arm)
    arm = with_known_masses(recording, arm)
    if arm.sliding:
        raise InputError(f"{recording.source}: has prismatic joints, whose commands are not diagnosed; leave them out")
    if recording.commanded_position is None:
        raise InputError(f"{recording.source}: has no commands; add cmd1_rad ... beside q1_rad ...")
    if np.max(np.abs(recording.commanded_position - recording.joint_position)) < SAME:
        raise InputError(
            f"{recording.source}: commands and read-outs are equal to {SAME:g} rad: the log holds commands twice, or "
            "a simulator without dynamics; record measured joints as q1_rad ..."
        )
    still = np.ptp(recording.commanded_position, 0) < SAME
    if still.all():
        raise InputError(f"{recording.source}: its commands never move; record a motion")
    even = even_rows(recording)
    _check_commands(even)
    settings = even.settings
    quanta = np.array([quantum(column) for column in recording.joint_position.T])
    noise = np.sqrt(settings.joint_noise_rad**2 + quanta**2 / 12 + FLOOR**2)
    center = np.array(settings.payload_com_m)
    compensated = isinstance(settings.servo, ServoSettings) and settings.servo.gravity_compensation
    gravity = np.zeros(3) if compensated else np.array(settings.gravity_m_per_s2)
    payload = usual_payload(even)
    bodies = Bodies.of_arm(arm, payload, center, gravity)
    if np.any(even.payload != payload):
        bodies = replace(bodies, added=even.payload - payload)
    servo, known = declared_servo(settings, arm, bodies)
    is_exact = known or bool(np.max(noise) < COARSE)
    step = _LONG
    if is_exact:
        is_short = even.samples * period_of(even) < _SHORT_LOG
        step = 0.5 * LONGEST_STEP if is_short and np.min(noise) < _FINE else LONGEST_STEP
    commands = _held(even, noise, step)
    return TrackingRows(even, arm, bodies, commands, even.joint_position.T.copy(), noise, servo, known, is_exact)
