"""What a recording's numbers reveal: refused where nothing can be made of them, located where a fit can still cope."""

from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm, joint_unit
from lite6jax.array_types import Array
from lite6jax.errors import InputError
from lite6jax.recordings.recording import Recording
from lite6jax.recordings.sequence import differentiate, run_segments

HEAVIEST = 20.0
"""Times what the weight of an arm and its payload exerts at full reach: beyond, torques are in another unit. Torques in
mN m exceed that of a Lite 6 a hundredfold, and friction or acceleration is at most a few times as much as weight."""
UNLIKE = 10.0
"""Times what positions change per second, or a tenth of it: beyond, velocities are in another unit, or times are."""
_MOVING_SHARE = 0.1
"""Of the fastest motion of a joint, above which rows count: near rest, differences are noise."""


_FRICTION = 1.0
"""N m, or N, that friction may exert at any joint."""


def require_one_station(recording: Recording) -> None:
    """Refuses poses from several stations, which a diagnosis alone joins.

    Raises:
        InputError: as said.
    """
    if recording.stations:
        raise InputError(
            f"{recording.source}: its poses are from {len(recording.stations) + 1} stations, each in a frame of its "
            "own, which `diagnose` joins; give the poses of one station here"
        )


def check_torque_scale(recording: Recording, arm: Arm) -> None:
    """Refuses torques so large that they must be N mm or mN m. Medians decide, so outliers pass.

    Args:
        recording: with torques, or with currents and their constants.
        arm: with masses; without, nothing is known.

    Raises:
        InputError: as said, or as `Recording.torques`.
    """
    torque = np.median(np.abs(recording.torques()), axis=0)
    if arm.mass is None:
        return
    weight = 9.81 * (float(np.sum(arm.mass)) + float(recording.payload.max()))
    # of light links, and of a motor alone, friction is more than the weight
    weight_torque = np.maximum(weight * np.where(arm.slides, 1.0, arm.reach), _FRICTION)
    joint = int(np.argmax(torque / weight_torque))
    if torque[joint] > HEAVIEST * weight_torque[joint]:
        slides = bool(arm.slides[joint])
        computed = recording.joint_torque is None
        column = f"current{joint + 1}_A" if computed else joint_unit(f"tau{joint + 1}_Nm", slides)
        quantity, unit = ("force", "N") if slides else ("torque", "N m")
        remedy = "check the unit" if slides else "are these mN m? name the columns tau1_mNm ..."
        remedy = (
            "are these mA? name the columns current1_mA ..., or check torque_constant_Nm_per_A" if computed else remedy
        )
        raise InputError(
            f"{recording.source}: column {column}: the {quantity} of joint {joint + 1} is {torque[joint]:.4g} {unit} "
            f"(median) while the weight of the arm exerts {weight_torque[joint]:.3g} {unit} at most; {remedy}"
        )


def check_velocity_scale(recording: Recording) -> None:
    """Refuses recorded velocities that must be degrees per second, or that contradict the times. Medians decide.

    Raises:
        InputError: where a joint moves, its velocity is ten times what its position changes per second, or a tenth.
    """
    recorded = recording.joint_velocity
    time = recording.time
    if recorded is None or recording.velocity_differentiated or time is None or recording.motion == "static":
        return
    slope = differentiate(recording.joint_position, time, run_segments(recording.run))
    moving = np.abs(slope) > _MOVING_SHARE * np.abs(slope).max(0)
    ratio = np.median(np.abs(recorded[moving]) / np.abs(slope[moving])) if moving.any() else 1.0
    if not 1 / UNLIKE < ratio < UNLIKE:
        degrees = 0.9 < ratio / np.rad2deg(1.0) < 1.1
        remedy = "are these degrees? name the columns dq1_deg_per_s ..." if degrees else "check their unit and time_s"
        raise InputError(
            f"{recording.source}: columns dq1_rad_per_s ...: the velocities are {ratio:.3g} times what the positions "
            f"change per second (median); {remedy}"
        )


def require_samples(recording: Recording, unknowns: int) -> None:
    """Refuses a recording from which nothing can be estimated.

    Raises:
        InputError: a number that is not finite or not real, which `Recording.from_arrays` and the readers of files
            leave out or refuse; no measured pose; or fewer numbers than are to be determined, with both counts.
    """
    for name, column in recording.columns().items():
        if column.dtype != object and (np.iscomplexobj(column) or not np.isfinite(column).all()):
            row = int(np.argmax(~np.isfinite(column) | (np.imag(column) != 0)))
            raise InputError(
                f"{recording.source}: row {recording.row[row]} has {column[row]} in column {name}; give finite real "
                "numbers, as Recording.from_arrays does, which leaves out rows without"
            )
    per_sample = recording.numbers_per_sample
    if not per_sample:
        raise InputError(f"{recording.source}: has no measured positions; a fit needs the columns x_m y_m z_m")
    available = per_sample * recording.samples
    if available < unknowns:
        kind = "position and orientation" if per_sample == 6 else "position without orientation"
        raise InputError(
            f"{recording.source}: {recording.samples} samples of {per_sample} numbers ({kind}) give {available} "
            f"numbers, fewer than the {unknowns} to determine; record at least {-(-unknowns // per_sample)} samples"
        )


def time_disorder(recording: Recording) -> tuple[Int[np.ndarray, " found"], float]:
    """The samples whose time is before that of an earlier one of their run, and the largest such step back in s."""
    if recording.time is None:
        return np.empty(0, np.int64), 0.0
    runs = np.split(recording.time, np.flatnonzero(np.diff(recording.run)) + 1)
    step_back = np.concatenate([np.maximum.accumulate(time) - time for time in runs])
    return np.flatnonzero(step_back > 0), float(step_back.max())


def repeated_rows(recording: Recording) -> tuple[Int[np.ndarray, " found"], Int[np.ndarray, " found"]]:
    """The samples with exactly the joints and pose of an earlier one, which noise never gives twice, and that one."""
    blocks = (recording.joint_position, recording.position, recording.quaternion)
    table = np.column_stack([block for block in blocks if block is not None]) + 0.0  # -0.0 becomes 0.0
    # of whole rows as bytes; by `axis=0` it would take ten times as long
    rows = np.ascontiguousarray(table).view(np.dtype((np.void, table.itemsize * table.shape[1]))).ravel()
    _, first, inverse = np.unique(rows, return_index=True, return_inverse=True)
    earlier = first[inverse]
    again = np.flatnonzero(earlier != np.arange(recording.samples))
    return again, earlier[again]


class OutsideLimits(NamedTuple):
    """Rows of one joint (1-based) outside its limits, and by how much at most, in rad, m of a prismatic joint."""

    joint: int
    rows: Int[np.ndarray, " found"]
    largest_excess_rad: float


def outside_limits(recording: Recording, joint_limits: ArrayLike, margin_rad: float = 0.002) -> list[OutsideLimits]:
    """Finds joints beyond their limits by more than `margin_rad` (the Lite 6 enforces its own to 0.1 deg)."""
    limits = np.asarray(joint_limits, dtype=float)
    excess = np.maximum(limits[:, 0] - recording.joint_position, recording.joint_position - limits[:, 1])
    beyond = excess > margin_rad
    return [
        OutsideLimits(int(joint) + 1, recording.row[beyond[:, joint]], float(excess[:, joint].max()))
        for joint in np.flatnonzero(beyond.any(axis=0))
    ]


# ------------------------------------------------------------------ torques without noise


WINDOW = 50
"""Rows over which an arm is at rest or not: a fifth of a second of a Lite 6's reports."""
STILL_RAD = 1e-4
"""The range of each joint's position in a window at rest: encoders have some noise."""
NOISELESS = 1e-4
"""Range of a torque in a window at rest over its largest magnitude, below which it has no noise.

Sensors and currents have a hundredth. Gravity's torque changes by this much within `STILL_RAD`.
"""
QUANTISED = 1e-3
"""Smallest step of a torque over its largest magnitude, from which its noise may be lost in rounding."""
FEWEST = 4
"""Windows at rest that it takes to say anything."""


@final
@dataclass(eq=False)
class TorqueNoise:
    """What windows of `WINDOW` rows show of the noise of torques, while they are recorded or afterwards.

    Attributes:
        ranges: `(joint,)` Nm for each window at rest.
        largest: `(joint,)` Nm, magnitudes in all windows.
        step: `(joint,)` Nm, the smallest change from row to row that is not zero.
    """

    ranges: list[Array] = field(default_factory=list)
    largest: Array | float = 0.0
    step: Array | float = np.inf

    def add(self, position: Float[np.ndarray, "row joint"], torque: Float[np.ndarray, "row joint"]) -> None:
        """One window of consecutive rows: rad and Nm; one with numbers that are not finite says nothing."""
        if not (np.isfinite(position).all() and np.isfinite(torque).all()):
            return
        self.largest = np.maximum(self.largest, np.abs(torque).max(0))
        steps = np.abs(np.diff(torque, axis=0))
        self.step = np.minimum(self.step, np.where(steps > 0, steps, np.inf).min(0, initial=np.inf))
        if np.ptp(position, axis=0).max() <= STILL_RAD:
            self.ranges.append(np.ptp(torque, axis=0))

    @property
    def absent(self) -> bool:
        """Tells whether torques of an arm at rest are constant, and known finely enough for that to be no rounding."""
        if len(self.ranges) < FEWEST or not np.any(self.largest):
            return False
        acting = np.asarray(self.largest) > 0
        usual = np.quantile(self.ranges, 0.9, axis=0)[acting]
        largest = np.asarray(self.largest)[acting]
        step = np.asarray(self.step)[acting]
        rounded = np.isfinite(step) & (step > QUANTISED * largest)
        return bool((usual <= NOISELESS * largest).all() and not rounded.any())


def estimated_torque(recording: Recording) -> bool:
    """Tells whether the recorded torques have no noise: the controller's own model, which says nothing of the motors.

    False without torques, and where the arm is never at rest for long enough. False too where the steps of the torques
    are so coarse that they may hide noise.
    """
    noise = TorqueNoise()
    if recording.joint_torque is None:
        return False
    segment = run_segments(recording.run)
    for rows in np.split(np.arange(recording.samples), np.flatnonzero(np.diff(segment)) + 1):
        for start in range(0, len(rows) - WINDOW + 1, WINDOW):
            window = rows[start : start + WINDOW]
            noise.add(recording.joint_position[window], recording.joint_torque[window])
    return noise.absent
