"""A recording in memory: joint positions and measured poses of one arm in SI arrays, checked as files are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, final

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_of
from lite6jax.arms.files import read_arm
from lite6jax.errors import InputError
from lite6jax.fields import field_values
from lite6jax.recordings.columns.column import MATRIX, OF_ARRAY, is_scalar, name_columns
from lite6jax.recordings.columns.orientations import quaternions
from lite6jax.recordings.readings import Readings
from lite6jax.recordings.sequence import contiguous_blocks, differentiate, directions, inferred_motion, run_segments
from lite6jax.recordings.settings import Motion, RecordingSettings, declared_settings
from lite6jax.recordings.table import Table, make_arrays, read_frame
from lite6jax.recordings.units import (
    FAR_REACHES,
    FIND_UNIT,
    LARGEST_MISSING_SHARE,
    blank_implausible,
    other_joints,
    real_array,
    require_near,
    unit_quaternions,
)
from lite6jax.results import PublicResult
from lite6jax.sensors.camera import FEWEST_CORNERS
from lite6jax.sensors.kinds import KINDS


@final
@dataclass(frozen=True, eq=False, repr=False)
class Recording(PublicResult):
    """One row per sample, float64, SI: m, rad, s, N·m, A, °C, kg; of prismatic joints m for rad and N for N·m.

    Build it with `Recording.from_arrays`, `Recording.from_dataframe` or `read_recording`.

    Attributes:
        joint_position: `(sample, joint)`, as measured by the encoders (or as commanded, where only that was recorded).
        direction_of_motion: `(sample, joint)`, -1, 0 or 1. Static: `sign(q[k] - q[k-1])`, from zero in the first row of
            a run; trajectory: the sign of the velocity. It belongs to the whole sequence: a selection keeps it.
        motion: "static" (the arm stood still at each row) or "trajectory", as declared or inferred (then `notes` says).
        position: `(sample, 3)` measured tool point in the sensor's frame, or None (a motion only to be predicted).
        quaternion: `(sample, 4)` measured orientation, unit, scalar first, or None. Its first non-zero component is
            positive, so that the sign does not depend on the neighbours.
        time: `(sample,)` from `time_s = 0`, or None: the row order is the sequence.
        joint_velocity: `(sample, joint)` or None. In a trajectory with times it is always there.
        velocity_differentiated: whether `joint_velocity` was derived from position and time, not recorded.
        joint_acceleration, joint_torque, motor_current, joint_temperature: `(sample, joint)` as recorded, or None.
        commanded_position: `(sample, joint)` that the controller asked for beside the measured positions, or None.
        ambient_temperature: `(sample,)` or None.
        payload: `(sample,)` mass at the flange.
        run: `(sample,)` int, as in the file: a new run starts where it changes.
        row: `(sample,)` int, the data row that each sample came from, counted from 1.
        settings: what the sidecar declares.
        source: the file's name, or what made the recording; messages begin with it.
        notes: what was dropped, assumed or normalised, one sentence each.
        sliding: the prismatic joints, counted from 0.
        readings: what was read where no poses were; of a camera beside the poses that they give.
        stations: the first row of each further file of poses, whose sensor has a frame of its own.
    """

    joint_position: Float[np.ndarray, "sample joint"]
    direction_of_motion: Float[np.ndarray, "sample joint"]
    motion: Motion
    position: Float[np.ndarray, "sample 3"] | None
    quaternion: Float[np.ndarray, "sample 4"] | None
    time: Float[np.ndarray, " sample"] | None
    joint_velocity: Float[np.ndarray, "sample joint"] | None
    velocity_differentiated: bool
    joint_acceleration: Float[np.ndarray, "sample joint"] | None
    joint_torque: Float[np.ndarray, "sample joint"] | None
    motor_current: Float[np.ndarray, "sample joint"] | None
    joint_temperature: Float[np.ndarray, "sample joint"] | None
    commanded_position: Float[np.ndarray, "sample joint"] | None
    ambient_temperature: Float[np.ndarray, " sample"] | None
    payload: Float[np.ndarray, " sample"]
    run: Int[np.ndarray, " sample"]
    row: Int[np.ndarray, " sample"]
    settings: RecordingSettings
    source: str
    notes: tuple[str, ...]
    sliding: tuple[int, ...] = ()
    readings: Readings | None = None
    stations: tuple[int, ...] = ()

    @classmethod
    def from_arrays(
        cls,
        joint_position: ArrayLike,
        position: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        *,
        arm: Arm | str | None = None,
        sliding: tuple[int, ...] | None = None,
        time: ArrayLike | None = None,
        joint_velocity: ArrayLike | None = None,
        joint_acceleration: ArrayLike | None = None,
        joint_torque: ArrayLike | None = None,
        motor_current: ArrayLike | None = None,
        joint_temperature: ArrayLike | None = None,
        commanded_position: ArrayLike | None = None,
        ambient_temperature: ArrayLike | None = None,
        payload: ArrayLike | None = None,
        run: ArrayLike | None = None,
        readings: Readings | None = None,
        settings: RecordingSettings | None = None,
        source: str = "recording",
        **declared: Any,
    ) -> "Recording":
        """A recording from arrays, checked as a file is.

        Args:
            joint_position: `(sample, joint)` rad, as measured by the encoders (or as commanded).
            position: `(sample, 3)` m, the measured tool point in the sensor's frame.
            quaternion: `(sample, 4)`, the measured orientation of the tool in the sensor's frame, unit, scalar first.
            arm: the arm's type, an `Arm` or what `read_arm` takes; its limits and reach reveal a wrong unit.
            sliding: the prismatic joints, counted from 0, whose positions are in m; the arm's where not given.
            joint_velocity, joint_acceleration: `(sample, joint)` rad/s, rad/s².
            joint_torque, motor_current, joint_temperature: `(sample, joint)` N·m, A, °C.
            commanded_position: `(sample, joint)` rad, what the controller asked for.
            time, ambient_temperature, payload: `(sample,)` s, °C, kg at the flange (zero where not given).
            run: `(sample,)` int, which changes where a new run starts.
            readings: what was read where no poses were, by `readings_from_arrays`.
            settings: what a sidecar would declare; the defaults where not given.
            source: what messages begin with.
            declared: single keys of the sidecar, such as `pose_frame="base"`, `tool="none"`, `position_noise_m=2e-5`.

        Returns:
            the recording without the rows that hold NaN, infinite numbers, or numbers that no arm or sensor can give;
            its `notes` count them.

        Raises:
            InputError: arrays that do not fit together or do not hold real numbers, degrees for radians, millimetres
                for metres, a quaternion whose length is more than 1 % off, more than half of the rows not finite, or
                an unknown key of the sidecar.
        """
        arrays = {name: value for name, value in dict(locals()).items() if name in OF_ARRAY}
        settings = declared_settings(settings, arm, declared)
        recording = cls.assembled(
            **arrays, sliding=sliding, readings=readings, settings=settings, source=source, spelling={}
        )
        return drop_missing(_of_arm(recording, arm, sliding))

    @classmethod
    def from_dataframe(
        cls,
        frame: Any,
        settings: RecordingSettings | None = None,
        *,
        arm: Arm | str | None = None,
        columns: Mapping[str, str] | None = None,
        source: str = "recording",
        **declared: Any,
    ) -> "Recording":
        """A recording from a data frame with the columns of a recording's file, read and checked as a file is.

        Args:
            frame: a pandas or polars `DataFrame`, a pyarrow `Table`, a mapping of column names to `(sample,)` arrays,
                or what has `__arrow_c_stream__`. Units stand in the names: `q1_rad` or `q1_deg`,
                `x_m` or `x_mm`.
            columns: of columns with names of their own, the names that a recording has, as in a sidecar:
                `{"actual_q_0": "q1_rad", "robot_mode": "ignore"}`.
            settings, arm, source, declared: as in `from_arrays`.

        Raises:
            InputError: as `from_arrays`; a column missing, misspelt, without unit or not of numbers.
        """
        notes: list[str] = []
        settings = declared_settings(settings, arm, declared)
        table = read_frame(frame, source, notes, columns)
        recording = cls.from_table(table, settings, source, notes)
        return drop_missing(_of_arm(recording, arm, recording.sliding, table), table.spelling)

    @classmethod
    def from_table(cls, table: Table, settings: RecordingSettings, source: str, notes: list[str]) -> "Recording":
        """As `assembled`, of the columns of a table, with numbers missing that no arm or sensor can give.

        Raises:
            InputError: as `make_arrays` and `assembled`.
        """
        arrays = make_arrays(table, source, notes, settings.command)
        settings = replace(settings, command="position")  # velocities are integrated
        return cls.assembled(**arrays, settings=settings, source=source, notes=notes, spelling=table.spelling)

    @classmethod
    def assembled(
        cls,
        joint_position: ArrayLike,
        *,
        run: ArrayLike | None = None,
        row: ArrayLike | None = None,
        settings: RecordingSettings | None = None,
        source: str = "recording",
        notes: Sequence[str] = (),
        sliding: tuple[int, ...] | None = None,
        readings: Readings | None = None,
        stations: tuple[int, ...] = (),
        spelling: Mapping[str, str] | None = None,
        **optional: ArrayLike | None,
    ) -> "Recording":
        """As `from_arrays`, of numbers whose units are known: rows with NaN stay, and units are not checked.

        The direction and the differentiated velocity of the other rows pass over those whose joints or time are NaN.
        `row` is `(sample,)` int, the data row of each sample in its file, from 1; `notes` say what was done before.
        With `spelling`, the names of columns in the file by those in SI units, implausible numbers count as missing.

        Raises:
            InputError: arrays that do not fit together, orientation without position, quaternions of another length,
                settings with a number per joint that are of another number of joints, or over half of the rows with
                implausible numbers.
        """
        sentences = [*notes]
        q = real_array(f"{source}: joint_position", joint_position)
        if q.ndim != 2 or 0 in q.shape:
            raise InputError(f"{source}: joint_position has the shape {q.shape}; give (sample, joint), neither zero")
        samples, dof = q.shape
        settings = (settings or RecordingSettings()).for_joints(dof, source)
        if settings.command == "velocity" and optional.get("commanded_position") is not None:
            raise InputError(f"{source}: commanded_position is given, and command: velocity; leave command out")
        if readings is not None and len(readings.group) != samples:
            raise InputError(f"{source}: {len(readings.group)} readings of {samples} samples; give one each")
        supplied = {"joint_position": q, "payload": np.zeros(samples)}
        supplied |= {name: value for name, value in optional.items() if value is not None}
        if unknown := supplied.keys() - OF_ARRAY.keys():
            raise TypeError(f"{min(unknown)}: a recording has no such array")
        arrays: dict[str, Any] = dict.fromkeys(OF_ARRAY)
        for name, value in supplied.items():
            shape = (samples,) if is_scalar(name) else (samples, len(name_columns(name, dof)))
            arrays[name] = real_array(f"{source}: {name}", value)
            if arrays[name].shape != shape:
                raise InputError(f"{source}: {name} has the shape {arrays[name].shape}; give {shape}")
        if spelling is not None:
            sentences += blank_implausible(arrays, source, spelling)
            q = arrays["joint_position"]
        for name, counted, usual in (("run", run, np.zeros(samples, int)), ("row", row, np.arange(1, samples + 1))):
            array = usual if counted is None else np.asarray(counted)
            if array.shape != (samples,):
                raise InputError(f"{source}: {name} has the shape {array.shape}; give {(samples,)}")
            if array.dtype.kind not in "iu":
                raise InputError(f"{source}: {name} has the type {array.dtype}; give integers")
            arrays[name] = array.astype(np.int64, copy=False)
        if readings is not None and readings.kind == "camera" and arrays["position"] is None:
            readings = readings.with_poses(settings, source)
            assert readings.seen is not None
            T = readings.seen.T
            arrays |= {"position": T[:, :3, 3], "quaternion": quaternions(MATRIX, T[:, :3, :3].reshape(-1, 9))}
            shown = int(np.isfinite(T[:, 0, 3]).sum())
            if shown < samples:
                problem = f"fewer than {FEWEST_CORNERS} corners, or all in one line"
                sentences.append(f"{samples - shown} of {samples} images show {problem}: they are left out")
        if arrays["quaternion"] is not None:
            if arrays["position"] is None:
                raise InputError(f"{source}: has measured orientations without positions; add x_m y_m z_m")
            arrays["quaternion"], note = unit_quaternions(arrays["quaternion"], arrays["row"], source)
            sentences += [note] if note else []
        motion = settings.motion
        time = arrays["time"]
        velocity = arrays["joint_velocity"]
        if motion is None:
            motion, reason = inferred_motion(time, velocity)
            sentences.append(f"the motion is not declared and is taken as {motion}: {reason}")
        segment = run_segments(arrays["run"])
        differentiated = False
        if velocity is None and time is not None and motion == "trajectory":
            velocity = differentiate(q, time, segment)
            differentiated = True
            arrays["joint_velocity"] = velocity
            sentences.append(
                "the joint velocities were not recorded and come from differentiating the positions over time"
            )
        elif velocity is None and motion == "trajectory":
            sentences.append(
                "the trajectory has neither times nor velocities: directions of motion follow the row order"
            )
        return cls(
            **arrays,
            direction_of_motion=directions(q, velocity, segment, motion),
            motion=motion,
            velocity_differentiated=differentiated,
            settings=settings,
            source=source,
            notes=tuple(dict.fromkeys(sentences)),
            sliding=sliding or (),
            readings=readings,
            stations=stations,
        )

    @property
    def samples(self) -> int:
        return self.joint_position.shape[0]

    @property
    def dof(self) -> int:
        return self.joint_position.shape[1]

    @property
    def numbers_per_sample(self) -> int:
        """How many numbers a sample measures: 6 with orientation, 3 with position only, 0 of a motion alone."""
        if self.readings is not None:
            return self.readings.numbers
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

    @property
    def has_torques(self) -> bool:
        """Tells whether it holds joint torques or motor currents."""
        return self.joint_torque is not None or self.motor_current is not None

    def torques(self) -> Float[np.ndarray, "sample joint"]:
        """Joint torques in N·m: those recorded, else motor currents times the declared torque constants.

        Raises:
            InputError: neither torques nor currents, or currents without torque constants.
        """
        if self.joint_torque is not None:
            return self.joint_torque
        if self.motor_current is None:
            raise InputError(
                f"{self.source}: has no joint torques; add tau1_Nm ..., or current1_A ... and "
                "torque_constant_Nm_per_A in the sidecar"
            )
        constants = self.settings.torque_constant_Nm_per_A
        if constants is None:
            commands = ""
            if self.commanded_position is not None:
                commands = ", or diagnose its commands alone (--tracking or domain='tracking')"
            raise InputError(
                f"{self.source}: has motor currents without torque constants; declare torque_constant_Nm_per_A in the "
                f"sidecar, one number per joint{commands}"
            )
        return self.motor_current * np.array(constants)

    def select(self, rows: Bool[np.ndarray, " sample"] | Int[np.ndarray, " chosen"]) -> "Recording":
        """The samples of a boolean mask or of indices; direction, velocity and row number stay those of the whole."""
        return replace(self, **self._chosen(rows))

    def _chosen(self, rows: Any) -> dict[str, Any]:
        """All that has a sample a row, of these rows."""
        readings = {} if self.readings is None else {"readings": self.readings.select(rows)}
        return {
            name: array[rows] for name, array in field_values(self).items() if isinstance(array, np.ndarray)
        } | readings

    @property
    def station(self) -> Int[np.ndarray, " sample"]:
        """From which station each sample was measured, counted from 0; each has a sensor's frame of its own."""
        return np.searchsorted(self.stations, self.row, side="right")

    @property
    def touches(self) -> Readings | None:
        """Its readings where they are no poses; None of poses, those of a camera among them."""
        return None if self.position is not None else self.readings

    def contiguous_folds(self, count: int) -> list[Bool[np.ndarray, " sample"]]:
        """`count` masks, each a block of neighbouring rows to hold out; together they cover every row once.

        Neighbouring rows share drifts and dwells, so random folds would test a fit on what it has seen. Of touches, a
        block is one of the rows of each point or plane: without any of them nothing is known of that. Of poses from
        several stations it is one of the rows of each.

        Raises:
            InputError: fewer than two folds or fewer samples than folds.
        """
        if not 2 <= count <= self.samples:
            raise InputError(f"{self.source}: {count} folds of {self.samples} samples; choose 2 to {self.samples}")
        if self.touches is None and not self.stations:
            return contiguous_blocks(self.samples, count)
        groups = self.station if self.touches is None else self.touches.group
        order = np.argsort(groups, kind="stable")
        place = np.empty(self.samples, np.int64)
        for group in np.unique(groups):
            rows = order[groups[order] == group]
            place[rows] = np.arange(len(rows)) * count // len(rows)
        return [mask for mask in (place == k for k in range(count)) if mask.any()]

    def sorted_by_time(self) -> "Recording":
        """The rows of each run in time order, directions and differentiated velocities anew; itself when in order."""
        if self.time is None:
            return self
        segment = run_segments(self.run)
        order = np.lexsort((self.time, segment))
        if np.array_equal(order, np.arange(self.samples)):
            return self
        arrays = self._chosen(order)
        self._derive_motion(arrays, segment)
        moved = int(np.sum(order != np.arange(self.samples)))
        return replace(self, **arrays, notes=(*self.notes, f"{moved} rows were out of time order and have been sorted"))

    def without_rows(self, rows: Bool[np.ndarray, " sample"]) -> "Recording":
        """Without rows that were not measured: directions and differentiated velocities are those of the others."""
        arrays = self._chosen(~rows)
        self._derive_motion(arrays, run_segments(arrays["run"]))
        return replace(self, **arrays)

    def _derive_motion(self, arrays: dict[str, Any], segment: Int[np.ndarray, " sample"]) -> None:
        """Puts differentiated velocities and directions of the positions in `arrays` into these."""
        if self.velocity_differentiated:
            arrays["joint_velocity"] = differentiate(arrays["joint_position"], arrays["time"], segment)
        arrays["direction_of_motion"] = directions(
            arrays["joint_position"], arrays.get("joint_velocity"), segment, self.motion
        )

    def made_anew(self, **changes: Any) -> "Recording":
        """With other arguments of `assembled`; directions, and velocities that were not recorded, follow from them.

        Accelerations, torques, currents and commands are left out, as they belong to the motion as it was, and notes.

        Raises:
            InputError: as `assembled`.
        """
        retained = ("joint_position", "position", "quaternion", "time", "joint_temperature", "ambient_temperature")
        retained = (*retained, "payload", "run", "row", "settings", "source", "sliding", "readings", "stations")
        velocity = None if self.velocity_differentiated else self.joint_velocity
        values = field_values(self)
        arguments: dict[str, Any] = {name: values[name] for name in retained} | {"joint_velocity": velocity}
        return Recording.assembled(**(arguments | changes))

    def columns(self) -> dict[str, np.ndarray]:
        """The table that a file of this recording holds: column name in SI units to `(sample,)` values.

        What follows from the rest is left out: differentiated velocities, a payload or a run that is zero throughout.
        """
        table: dict[str, np.ndarray] = {}
        values = field_values(self)
        for name in OF_ARRAY:
            block = values[name]
            if block is None or (name in ("payload", "run") and not block.any()):
                continue
            if (name == "joint_velocity" and self.velocity_differentiated) or (
                name in ("position", "quaternion") and self.readings is not None
            ):
                continue
            table |= dict(zip(name_columns(name, self.dof, self.sliding), np.atleast_2d(block.T), strict=True))
        return table if self.readings is None else table | self.readings.columns()


# ------------------------------------------------------------------ units


Given = Literal["file", "table", "arrays"]
"""Where numbers are from, on which it depends what remedies a wrong unit."""


def _of_arm(
    recording: Recording,
    arm: Arm | str | None,
    sliding: tuple[int, ...] | None,
    table: Table | None = None,
) -> Recording:
    """A recording of a table or, without `table`, of arrays, whose arm shows that a unit is wrong.

    Args:
        arm: the arm; that of the settings, or of the bundled ones the one with the longest reach, where none is given.
        sliding: the prismatic joints; the arm's where None.

    Raises:
        InputError: an arm of other joints, degrees, or millimetres.
    """
    if isinstance(arm, Arm):
        reference_arm = arm
    elif recording.settings.arm is not None:
        reference_arm = read_arm(recording.settings.arm_reference(Path(recording.source).parent))
    else:
        reference_arm = max(
            bundled_of(0 if sliding else recording.dof), key=lambda candidate: candidate.reach, default=None
        )
    if reference_arm is None:
        return recording
    if recording.dof != reference_arm.dof:
        raise InputError(
            f"{recording.source}: has {recording.dof} joints, but {reference_arm.name} has {reference_arm.dof}; give "
            "the arm that it is of"
        )
    if sliding is not None and sliding != reference_arm.sliding:
        raise InputError(f"{recording.source}: {other_joints(sliding, reference_arm.sliding, reference_arm.name)}")
    recording = replace(recording, sliding=reference_arm.sliding)
    check_scale(
        recording, reference_arm.possible_positions, reference_arm.reach, table, "arrays" if table is None else "table"
    )
    return recording


def check_scale(
    recording: Recording,
    joint_limits: ArrayLike | None = None,
    reach: float | None = None,
    table: Table | None = None,
    provenance: Given = "file",
    degrees: bool = False,
    millimetres: bool = False,
) -> None:
    """Refuses joint positions that must be degrees (`units.require_near`), and poses that must be millimetres.

    Of poses medians decide, so outliers pass. Only `pose_frame: base` says where the base is; a tracker may stand
    anywhere.

    Args:
        recording: with positions in rad and m.
        joint_limits: `(joint, 2)` lowest and highest position in rad; infinite for a joint without end.
        reach: of the arm in m, without a tool.
        table: that it was read from, for the names of columns in messages.
        provenance: where the numbers are from.
        degrees, millimetres: whether these have been assumed already, so that the message does not ask.

    Raises:
        InputError: a tenth of the rows or more are beyond twice the widest limit of the arm, or the median distance of
            the positions from their middle (or the base) is over five reaches.
    """
    spelling = {} if table is None else table.spelling
    given_as: Given = provenance
    unit_remedy = "check the unit"
    if provenance == "file":
        given_as = "table"
        unit_remedy = FIND_UNIT

    def said(joint: int) -> tuple[str, str]:
        name = spelling.get(f"q{joint + 1}_rad", f"q{joint + 1}_rad")
        remedy = _ask_about("degrees", "q1_deg ...", "radians: np.deg2rad(joint_position)", provenance)
        if joint in recording.sliding:
            metres = f"metres: joint_position[:, {joint}] / 1000"
            remedy = _ask_about("millimetres", f"q{joint + 1}_mm", metres, given_as)
        elif degrees or (table is not None and table.converts(f"q{joint + 1}_rad")):
            remedy = unit_remedy
        return f"{recording.source}: " + ("joint_position" if provenance == "arrays" else f"column {name}"), remedy

    if joint_limits is not None:
        limits = np.asarray(joint_limits, dtype=float)
        if limits.shape != (recording.dof, 2):
            raise InputError(
                f"{recording.source}: has {recording.dof} joints, the arm {len(limits)}; choose the arm it is of"
            )
        require_near(recording.joint_position, limits, said, recording.row, recording.sliding)
    position = np.empty((0, 3)) if recording.position is None else recording.position
    finite = position[np.isfinite(position).all(1)]
    if reach is None or not len(finite):
        return
    with np.errstate(over="ignore"):
        middle = np.median(finite, axis=0)
        distance = float(np.median(np.linalg.norm(finite - middle, axis=1)))
        origin = "from their middle"
    if recording.settings.pose_frame == "base" and np.linalg.norm(middle) > distance:
        distance = float(np.linalg.norm(middle))
        origin = "from the base"
    if distance > FAR_REACHES * reach:
        names = [spelling.get(name, name) for name in name_columns("position")]
        place = "position" if provenance == "arrays" else f"columns {' '.join(names)}"
        remedy = _ask_about("millimetres", "x_mm y_mm z_mm", "metres: position / 1000", provenance)
        converted = millimetres or (table is not None and table.converts("x_m"))
        raise InputError(
            f"{recording.source}: {place}: the positions lie {distance:.4g} m {origin} (median) while the arm reaches "
            f"{reach:.3g} m; {unit_remedy if converted else remedy}"
        )


def _ask_about(unit: str, columns: str, numbers: str, provenance: Given) -> str:
    option = f" or add `assume_{unit}=True`" if provenance == "file" else ""
    remedy = (
        f"give {numbers}" if provenance == "arrays" else f"name the column{'s' * (' ' in columns)} {columns}{option}"
    )
    return f"are these {unit}? {remedy}"


# ------------------------------------------------------------------ rows


def drop_missing(recording: Recording, spelling: Mapping[str, str] | None = None) -> Recording:
    """The rows in which every recorded number is finite, with a note that counts the others.

    Args:
        spelling: column name in SI units to the name in the file, for the message.

    Raises:
        InputError: over half of the rows would go; the message names the column with most gaps.
    """
    columns = {name: column for name, column in recording.columns().items() if column.dtype != object}
    if recording.readings is not None:
        position = recording.position
        label = KINDS[recording.readings.kind].label or "u_px"
        columns[label] = recording.readings.value if position is None else position[:, 0]
    missing = {name: ~np.isfinite(column) for name, column in columns.items()}
    bad = np.logical_or.reduce(list(missing.values()))
    if not (count := int(bad.sum())):
        return recording
    first = recording.row[np.argmax(bad)]
    if count > LARGEST_MISSING_SHARE * recording.samples:
        worst = max(missing, key=lambda name: int(missing[name].sum()))
        raise InputError(
            f"{recording.source}: {count} of {recording.samples} rows have NaN, infinite or empty fields, the first is "
            f"row {first}, most of them in column {(spelling or {}).get(worst, worst)} ({int(missing[worst].sum())}); "
            "fill or remove that column, or record again"
        )
    rows, verb = ("row", "that is") if count == 1 else ("rows", "the first is")
    note = f"dropped {count} {rows} with NaN, infinite or empty fields, {verb} row {first}"
    return replace(recording.select(~bad), notes=(*recording.notes, note))


_TORQUES = ("joint_torque", "motor_current")
"""Arrays that logs of commands are joined without."""


def join_recordings(recordings: Sequence[Recording]) -> Recording:
    """One recording of poses, of touches of one kind, distances, or commands, with the arm, its effects and the tool
    shared.

    Each file is a run of its own, and rows are counted through all of them. Poses that are not in the arm's base frame
    are from several stations: the sensor's frame is another one in each file. Points, planes and anchors get the name
    of their file before their own.

    Raises:
        InputError: neither poses nor touches nor commands, several kinds, files that disagree on the arm, the tool or
            a noise, heights, images.
    """
    usual = {field.name: field.default for field in fields(RecordingSettings)}
    # keys of which each file has its own; of all others they have the same
    merged: dict[str, Any] = {"contact_distances": (), "contact_points": {}, "planes": {}, "anchor_m": {}}
    first = recordings[0]
    touched = [recording.touches for recording in recordings if recording.touches is not None]
    kinds = {_kind_of(recording) for recording in recordings}
    if len(kinds) > 1 or not kinds <= {"poses", "contact", "plane", "distance", "commands"}:
        raise InputError(
            f"{', '.join(recording.source for recording in recordings)}: hold {' and '.join(sorted(kinds))}; several "
            "files of one arm are diagnosed together where all are poses, touches of points, touches of planes, "
            "distances, or logs of commands"
        )
    first_settings = field_values(first.settings)
    for recording in recordings[1:]:
        for key, value in field_values(recording.settings).items():
            if key not in merged and value != first_settings[key]:
                raise InputError(
                    f"{recording.source}: its sidecar says {key}: {value}, and that of {first.source} "
                    f"{first_settings[key]}; let them agree"
                )
        if recording.dof != first.dof:
            raise InputError(
                f"{recording.source}: has {recording.dof} joints, and {first.source} {first.dof}; name files of one arm"
            )
    stems = [Path(recording.source).stem for recording in recordings]
    if len({*stems}) < len(stems):
        raise InputError(f"{first.source}: two files are called {stems[0]}; give each a name of its own")
    before = np.concatenate([[0], np.cumsum([recording.row.max() for recording in recordings])])
    notes = [note for recording in recordings for note in recording.notes] + _describe_join(recordings, before)
    arrays: dict[str, Any] = {
        "row": np.concatenate([recording.row + k for recording, k in zip(recordings, before, strict=False)])
    }
    left_out = _TORQUES if kinds == {"commands"} else ()
    recorded = [field_values(recording) for recording in recordings]
    for name in (name for name in OF_ARRAY if name not in left_out):
        parts = [values[name] for values in recorded]
        derived = name == "joint_velocity" and first.velocity_differentiated
        if all(array is not None for array in parts) and not derived:
            arrays[name] = np.concatenate(parts)
    arrays["run"] = np.concatenate([recording.run + 1_000_000 * k for k, recording in enumerate(recordings)])
    names: list[str] = []
    groups = []
    for recording, touches, stem in zip(recordings, touched, stems, strict=False):
        groups.append(touches.group + len(names))
        names += [f"{stem}/{name}" for name in touches.names]
        merged["contact_distances"] += tuple(
            msgspec.structs.replace(distance, between=tuple(f"{stem}/{name}" for name in distance.between))
            for distance in recording.settings.contact_distances
        )
        settings = recording.settings
        by_key = {"contact_points": settings.contact_points, "planes": settings.planes, "anchor_m": settings.anchor_m}
        for key, declared in by_key.items():
            declared = dict.fromkeys(touches.names, declared) if isinstance(declared, tuple) else declared
            merged[key] |= (
                {f"{stem}/{name}": value for name, value in declared.items()} if isinstance(declared, Mapping) else {}
            )
    readings = None
    if touched:
        value = np.concatenate([touches.value for touches in touched])
        pixels = np.concatenate([touches.pixels for touches in touched])
        readings = Readings(touched[0].kind, np.concatenate(groups), tuple(names), value, pixels)
    return Recording.assembled(
        **arrays,
        settings=replace(first.settings, **{key: declared or usual[key] for key, declared in merged.items()}),
        source=first.source,
        notes=notes,
        sliding=first.sliding,
        readings=readings,
        stations=tuple((before[1:-1] + 1).tolist()) if _has_stations(first) else (),
    )


def _kind_of(recording: Recording) -> str:
    """What a recording measured, for files that are joined."""
    if recording.touches is not None:
        return recording.touches.kind
    if recording.readings is not None:
        return "images"
    if recording.position is not None:
        return "poses"
    if recording.commanded_position is not None:
        return "commands"
    return "torques" if recording.has_torques else "joints alone"


def _has_stations(recording: Recording) -> bool:
    """Tells whether further files of such a recording are measured in frames of their own."""
    return recording.position is not None and recording.settings.pose_frame != "base"


def _describe_join(recordings: Sequence[Recording], before: Int[np.ndarray, " file"]) -> list[str]:
    """What was done to join files, in sentences; `before` are the rows before each."""
    first, *later_names = (Path(recording.source).name for recording in recordings)
    counted = ", ".join(f"those of {name} from {rows + 1}" for name, rows in zip(later_names, before[1:], strict=False))
    sentences = [f"rows are counted through all files, {counted}"]
    if _has_stations(recordings[0]):
        listed = ", ".join(later_names)
        frames = "a frame of its own" if len(later_names) == 1 else "frames of their own"
        sentences.append(
            f"the sensor of {listed} has {frames}, which the poses determine; all that is said or predicted in a "
            f"sensor's frame is in that of {first}"
        )
    if _kind_of(recordings[0]) == "commands" and any(recording.has_torques for recording in recordings):
        sentences.append("torques are left out, as several logs are diagnosed by their commands")
    if len({recording.quaternion is None for recording in recordings}) == 2:
        lacking = next(Path(recording.source).name for recording in recordings if recording.quaternion is None)
        sentences.append(f"orientations are left out, as {lacking} has none")
    return sentences
