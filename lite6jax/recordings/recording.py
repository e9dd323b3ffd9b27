"""A recording in memory: joints and measured poses of one arm in SI arrays, with what follows from their order."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from lite6jax.errors import InputError
from lite6jax.recordings.settings import Motion, RecordingSettings

LONGEST_TRAJECTORY_STEP_S = 0.5  # samples further apart than this are taken as poses at which the arm stood still
STANDSTILL_RAD_PER_S = 1e-3
QUATERNION_TOLERANCE = 0.01
_ROUNDING = 1e-14  # a quaternion this close to unit length is left alone, so that normalising twice changes nothing


@dataclass(frozen=True, eq=False)
class Recording:
    """One row per sample, float64, SI: m, rad, s, N·m, A, °C, kg. Build it with `Recording.from_arrays`.

    Attributes:
        joint_position: `(sample, joint)`, as the encoders (or the commands) say.
        direction_of_motion: `(sample, joint)`, -1, 0 or 1. Static: `sign(q[k] - q[k-1])`, from zero in the first row of
            a run; trajectory: the sign of the velocity. It belongs to the whole sequence: a selection keeps it.
        motion: "static" (the arm stood still at each row) or "trajectory", as declared or inferred (then `notes` says).
        position: `(sample, 3)` measured tool point in the sensor's frame, or None (a motion only to be predicted).
        quaternion: `(sample, 4)` measured orientation, unit, scalar first, or None. Its first non-zero component is
            positive, so that the sign does not depend on the neighbours.
        time: `(sample,)` from `time_s = 0`, or None: the row order is the sequence.
        joint_velocity: `(sample, joint)` or None. In a trajectory with times it is always there.
        velocity_differentiated: whether `joint_velocity` was derived from position and time, not recorded.
        joint_torque, motor_current, joint_temperature: `(sample, joint)` or None.
        ambient_temperature: `(sample,)` or None.
        payload: `(sample,)` mass at the flange.
        run: `(sample,)` int, as in the file: a new run starts where it changes.
        row: `(sample,)` int, the 1-based data row of the file each sample came from.
        settings: what the sidecar declares.
        source: the file's name, or what made the recording; messages begin with it.
        notes: what was dropped, assumed or normalised, one sentence each.
    """

    joint_position: Float[np.ndarray, "sample joint"]
    direction_of_motion: Float[np.ndarray, "sample joint"]
    motion: Motion
    position: Float[np.ndarray, "sample 3"] | None
    quaternion: Float[np.ndarray, "sample 4"] | None
    time: Float[np.ndarray, " sample"] | None
    joint_velocity: Float[np.ndarray, "sample joint"] | None
    velocity_differentiated: bool
    joint_torque: Float[np.ndarray, "sample joint"] | None
    motor_current: Float[np.ndarray, "sample joint"] | None
    joint_temperature: Float[np.ndarray, "sample joint"] | None
    ambient_temperature: Float[np.ndarray, " sample"] | None
    payload: Float[np.ndarray, " sample"]
    run: Int[np.ndarray, " sample"]
    row: Int[np.ndarray, " sample"]
    settings: RecordingSettings
    source: str
    notes: tuple[str, ...]

    @classmethod
    def from_arrays(
        cls,
        joint_position: ArrayLike,
        *,
        position: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        time: ArrayLike | None = None,
        joint_velocity: ArrayLike | None = None,
        joint_torque: ArrayLike | None = None,
        motor_current: ArrayLike | None = None,
        joint_temperature: ArrayLike | None = None,
        ambient_temperature: ArrayLike | None = None,
        payload: ArrayLike | None = None,
        run: ArrayLike | None = None,
        row: ArrayLike | None = None,
        settings: RecordingSettings | None = None,
        source: str = "recording",
        notes: tuple[str, ...] = (),
    ) -> "Recording":
        """A recording from arrays of the shapes and units above; what is not given is absent, zero, or follows.

        Rows with NaN are kept (`drop_missing` drops them) but the direction and the differentiated velocity of the
        others pass over those whose joints or time are missing.

        Raises:
            InputError: arrays that do not fit together, orientation without position, or a quaternion whose length is
                more than 1 % off.
        """
        settings = settings or RecordingSettings()
        q = np.asarray(joint_position, dtype=np.float64)
        if q.ndim != 2 or 0 in q.shape:
            raise InputError(f"{source}: joint_position has the shape {q.shape}; give (sample, joint), neither zero")
        samples, dof = q.shape

        def shaped(name: str, value: ArrayLike | None, *rest: int, dtype: type = np.float64) -> np.ndarray | None:
            if value is None:
                return None
            array = np.asarray(value)
            if array.shape != (samples, *rest):
                raise InputError(f"{source}: {name} has the shape {array.shape}; give {(samples, *rest)}")
            if dtype is np.int64 and array.dtype.kind not in "iu":
                raise InputError(f"{source}: {name} has the type {array.dtype}; give integers")
            return array.astype(dtype, copy=False)

        quaternion = shaped("quaternion", quaternion, 4)
        if quaternion is not None and position is None:
            raise InputError(f"{source}: has measured orientations without positions; add x_m y_m z_m")
        row = shaped("row", row, dtype=np.int64)
        row = np.arange(1, samples + 1) if row is None else row
        run = shaped("run", run, dtype=np.int64)
        run = np.zeros(samples, dtype=np.int64) if run is None else run
        payload = shaped("payload", payload)
        time = shaped("time", time)
        velocity = shaped("joint_velocity", joint_velocity, dof)
        if quaternion is not None:
            quaternion, note = _unit_quaternions(quaternion, row, source)
            notes += (note,) if note else ()
        motion = settings.motion
        if motion is None:
            motion, reason = inferred_motion(time, velocity)
            notes += (f"the motion is not declared and is taken as {motion}: {reason}",)
        segment = run_segments(run)
        differentiated = False
        if velocity is None and time is not None and motion == "trajectory":
            velocity, differentiated = differentiate(q, time, segment), True
            notes += ("the joint velocities were not recorded and come from differentiating the positions over time",)
        elif velocity is None and motion == "trajectory":
            notes += ("the trajectory has neither times nor velocities: directions of motion follow the row order",)
        return cls(
            joint_position=q,
            direction_of_motion=_directions(q, velocity, segment, motion),
            motion=motion,
            position=shaped("position", position, 3),
            quaternion=quaternion,
            time=time,
            joint_velocity=velocity,
            velocity_differentiated=differentiated,
            joint_torque=shaped("joint_torque", joint_torque, dof),
            motor_current=shaped("motor_current", motor_current, dof),
            joint_temperature=shaped("joint_temperature", joint_temperature, dof),
            ambient_temperature=shaped("ambient_temperature", ambient_temperature),
            payload=np.zeros(samples) if payload is None else payload,
            run=run,
            row=row,
            settings=settings,
            source=source,
            notes=notes,
        )

    @property
    def samples(self) -> int:
        return self.joint_position.shape[0]

    @property
    def dof(self) -> int:
        return self.joint_position.shape[1]

    @property
    def numbers_per_sample(self) -> int:
        """How many numbers a sample measures: 6 with orientation, 3 with position only, 0 without a pose."""
        return 0 if self.position is None else 3 if self.quaternion is None else 6

    def velocities(self) -> Float[np.ndarray, "sample joint"]:
        """Joint velocities in rad/s: recorded or differentiated in a trajectory, zero where the arm stood still.

        Raises:
            InputError: a trajectory with neither velocities nor times.
        """
        if self.motion == "static":
            return np.zeros_like(self.joint_position)
        if self.joint_velocity is None:
            raise InputError(f"{self.source}: a trajectory without velocities; add time_s or dq1_rad_per_s ...")
        return self.joint_velocity

    def select(self, rows: Bool[np.ndarray, " sample"] | Int[np.ndarray, " chosen"]) -> "Recording":
        """The samples of a boolean mask or of indices; direction, velocity and row number stay those of the whole."""
        per_sample = {name: array[rows] for name, array in self._arrays().items()}
        return replace(self, **per_sample)

    def contiguous_folds(self, count: int) -> list[Bool[np.ndarray, " sample"]]:
        """`count` masks, each a block of neighbouring rows to hold out; together they cover every row once.

        Neighbouring rows share drifts and dwells, so random folds would test a fit on what it has seen.

        Raises:
            InputError: fewer than two folds or fewer samples than folds.
        """
        if not 2 <= count <= self.samples:
            raise InputError(f"{self.source}: {count} folds of {self.samples} samples; choose 2 to {self.samples}")
        block = np.arange(self.samples) * count // self.samples
        return [block == number for number in range(count)]

    def sorted_by_time(self) -> "Recording":
        """The rows of each run in time order, directions and differentiated velocities anew; itself when in order."""
        if self.time is None:
            return self
        segment = run_segments(self.run)
        order = np.lexsort((self.time, segment))
        if np.array_equal(order, np.arange(self.samples)):
            return self
        arrays = {name: array[order] for name, array in self._arrays().items()}
        if self.velocity_differentiated:
            arrays["joint_velocity"] = differentiate(arrays["joint_position"], arrays["time"], segment)
        arrays["direction_of_motion"] = _directions(
            arrays["joint_position"], arrays.get("joint_velocity"), segment, self.motion
        )
        moved = int(np.sum(order != np.arange(self.samples)))
        return replace(self, **arrays, notes=(*self.notes, f"{moved} rows were out of time order and have been sorted"))

    def made_anew(self, **changes: Any) -> "Recording":
        """With other arguments of `from_arrays`; directions, and velocities that were not recorded, follow from them.

        Torques and currents are left out, as they belong to the motion as it was, and notes as well.

        Args:
            changes: by name.

        Raises:
            InputError: as `from_arrays`.
        """
        kept = ("joint_position", "position", "quaternion", "time", "joint_temperature", "ambient_temperature")
        kept = (*kept, "payload", "run", "row", "settings", "source")
        velocity = None if self.velocity_differentiated else self.joint_velocity
        arguments: dict[str, Any] = {name: getattr(self, name) for name in kept} | {"joint_velocity": velocity}
        return Recording.from_arrays(**(arguments | changes))

    def columns(self) -> dict[str, np.ndarray]:
        """The table that a file of this recording holds: column name in SI units to `(sample,)` values.

        What follows from the rest is left out: differentiated velocities, a payload or a run that is zero throughout.
        """
        velocity = None if self.velocity_differentiated else self.joint_velocity
        table: dict[str, np.ndarray | None] = {"time_s": self.time}
        for pattern, joints in (
            ("q{}_rad", self.joint_position),
            ("dq{}_rad_per_s", velocity),
            ("tau{}_Nm", self.joint_torque),
            ("current{}_A", self.motor_current),
            ("temp{}_degC", self.joint_temperature),
        ):
            table |= {pattern.format(i + 1): column for i, column in enumerate(() if joints is None else joints.T)}
        table["ambient_degC"] = self.ambient_temperature
        table["payload_kg"] = self.payload if self.payload.any() else None
        table["run"] = self.run if self.run.any() else None
        for names, block in (("x_m y_m z_m", self.position), ("qw qx qy qz", self.quaternion)):
            table |= dict(zip(names.split(), () if block is None else block.T, strict=False))
        return {name: column for name, column in table.items() if column is not None}

    def _arrays(self) -> Mapping[str, Any]:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def run_segments(run: Int[np.ndarray, " sample"]) -> Int[np.ndarray, " sample"]:
    """Numbers the runs 0, 1, ... in order: `run` only says where a new one starts."""
    return np.concatenate([[0], np.cumsum(run[1:] != run[:-1])])


def inferred_motion(
    time: Float[np.ndarray, " sample"] | None, velocity: Float[np.ndarray, "sample joint"] | None
) -> tuple[Motion, str]:
    """Whether the arm stood still at each row, from velocities or else from the time step, and the reason in words."""
    if velocity is not None:
        moving = np.mean(np.nanmax(np.abs(velocity), axis=1, initial=0.0) > STANDSTILL_RAD_PER_S)
        return "trajectory" if moving > 0.05 else "static", f"the joints move in {moving:.0%} of the rows"
    if time is None:
        return "static", "it has neither times nor velocities"
    steps = np.diff(time[np.isfinite(time)])
    steps = steps[steps > 0]
    step = float(np.median(steps)) if steps.size else np.inf
    return "trajectory" if step <= LONGEST_TRAJECTORY_STEP_S else "static", f"its time step is {step:.3g} s"


def differentiate(
    joint_position: Float[np.ndarray, "sample joint"],
    time: Float[np.ndarray, " sample"],
    segment: Int[np.ndarray, " sample"],
) -> Float[np.ndarray, "sample joint"]:
    """Velocities by second-order differences over uneven times, within segments and in time order.

    Exact for a parabola, at the ends too; first order in a segment of two rows, zero in one of one row. Rows of equal
    time are passed over; rows with NaN get NaN and do not touch their neighbours.
    """
    velocity = np.full_like(joint_position, np.nan)
    usable = np.flatnonzero(np.isfinite(joint_position).all(axis=1) & np.isfinite(time))
    order = usable[np.lexsort((time[usable], segment[usable]))]
    if not order.size:
        return velocity
    q, t, s = joint_position[order], time[order], segment[order]
    step = np.diff(t)
    joined = (np.diff(s) == 0) & (step > 0)
    step = np.where(joined, step, 1.0)
    slope = np.where(joined[:, None], np.diff(q, axis=0) / step[:, None], 0.0)

    def padded(array: np.ndarray, before: int, after: int) -> np.ndarray:
        return np.pad(array, [(before, after)] + [(0, 0)] * (array.ndim - 1))

    # per row: the intervals before and after it, and those one further out for the ends of a segment
    has_left, has_right = padded(joined, 1, 0)[:, None], padded(joined, 0, 1)[:, None]
    h_left, h_right = padded(step, 1, 0)[:, None], padded(step, 0, 1)[:, None]
    v_left, v_right = padded(slope, 1, 0), padded(slope, 0, 1)
    inside = (h_right * v_left + h_left * v_right) / np.maximum(h_left + h_right, np.finfo(float).tiny)
    value = np.where(has_left & has_right, inside, v_left + v_right)
    starts = np.flatnonzero(~has_left[:-1, 0] & has_right[:-1, 0] & has_right[1:, 0])
    ends = 1 + np.flatnonzero(has_left[:-1, 0] & has_left[1:, 0] & ~has_right[1:, 0])
    for rows, near, far in ((starts, starts, starts + 1), (ends, ends - 1, ends - 2)):
        weight = (step[near] / (step[near] + step[far]))[:, None]
        value[rows] = slope[near] + (slope[near] - slope[far]) * weight
    velocity[order] = value
    return velocity


def _directions(
    joint_position: Float[np.ndarray, "sample joint"],
    velocity: Float[np.ndarray, "sample joint"] | None,
    segment: Int[np.ndarray, " sample"],
    motion: Motion,
) -> Float[np.ndarray, "sample joint"]:
    if motion == "trajectory" and velocity is not None:
        return np.sign(velocity)
    if motion == "trajectory":
        return np.sign(differentiate(joint_position, np.arange(float(len(segment))), segment))
    direction = np.full_like(joint_position, np.nan)
    usable = np.isfinite(joint_position).all(axis=1)
    q, s = joint_position[usable], segment[usable]
    previous = np.zeros_like(q)
    previous[1:] = np.where((np.diff(s) == 0)[:, None], q[:-1], 0.0)
    direction[usable] = np.sign(q - previous)
    return direction


def _unit_quaternions(
    quaternion: Float[np.ndarray, "sample 4"], row: Int[np.ndarray, " sample"], source: str
) -> tuple[Float[np.ndarray, "sample 4"], str | None]:
    given = np.all(np.isfinite(quaternion), axis=1)
    with np.errstate(over="ignore"):  # an absurdly long one is infinitely long, and refused as such
        length = np.sqrt(np.sum(np.where(given[:, None], quaternion, 0.5) ** 2, axis=1))
    off = np.abs(length - 1.0)
    beyond = np.flatnonzero(off > QUATERNION_TOLERANCE)
    if beyond.size:
        others = f" (and {beyond.size - 1} more rows)" if beyond.size > 1 else ""
        raise InputError(
            f"{source}: columns qw qx qy qz: row {row[beyond[0]]} has length {length[beyond[0]]:.6g}{others}, not 1; "
            "give unit quaternions, scalar first, and leave the fields empty where the sensor lost its target"
        )
    note = None
    if off.max() > 1e-6:  # below, it is the rounding of the file's decimals
        count = int(np.sum(off > 1e-6))
        note = f"normalised {count} quaternions, the furthest {off.max():.2g} from unit length"
    unit = np.where((off > _ROUNDING)[:, None], quaternion / length[:, None], quaternion)
    leading = np.argmax(np.abs(np.sign(unit)), axis=1)
    return np.where(unit[np.arange(len(unit)), leading, None] < 0, -unit, unit), note
