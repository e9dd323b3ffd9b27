"""Faults of columns: swapped, mirrored, in another unit, with another zero, orientations in another convention."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.domains.pose.rigid_arm import RigidArm, rigid_arm
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.screened import Detection, Screened
from lite6jax.fitting.start import frames_from_poses
from lite6jax.model import LEVER
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault

Array = NDArray[np.floating]

_CODES = ("swapped_joints", "mirrored_joint", "joint_unit", "orientation_convention")
_SCALAR_FIRST, _SCALAR_LAST = (0, 1, 2, 3), (3, 0, 1, 2)


@final
@dataclass(frozen=True)
class ColumnCorrection:
    """Corrected columns: joint i is `factor[i]·column[order[i]] + offset[i]`.

    Attributes:
        order: of the columns, from 0.
        factor, offset: per joint; rad.
        quaternion: of the recorded components, scalar first, which are the true w, x, y, z.
        inverted: whether the recorded orientation is that of the sensor's frame in the tool's.
    """

    order: tuple[int, ...]
    factor: tuple[float, ...]
    offset: tuple[float, ...]
    quaternion: tuple[int, int, int, int] = _SCALAR_FIRST
    inverted: bool = False

    def then(self, other: "ColumnCorrection") -> "ColumnCorrection":
        """This one, and another after it."""
        return ColumnCorrection(
            tuple(self.order[i] for i in other.order),
            tuple(other.factor[k] * self.factor[i] for k, i in enumerate(other.order)),
            tuple(other.factor[k] * self.offset[i] + other.offset[k] for k, i in enumerate(other.order)),
            self.quaternion if other.quaternion == _SCALAR_FIRST else other.quaternion,
            self.inverted != other.inverted,
        )

    def faults(self) -> list[DataFault]:
        """The faults that it corrects."""
        found = [
            DataFault("swapped_joints", (), {"joints": [i + 1, column + 1]})
            for i, column in enumerate(self.order)
            if i < column
        ]
        found += [DataFault("mirrored_joint", (), {"joint": i + 1}) for i, f in enumerate(self.factor) if f == -1.0]
        found += [
            DataFault("joint_unit", (), {"joint": i + 1, "unit": "deg" if factor < 1 else "rad"})
            for i, factor in enumerate(self.factor)
            if factor not in (1.0, -1.0)
        ]
        convention = "_".join(
            [*(["inverted"] if self.inverted else []), *(["scalar_last"] if self.quaternion == _SCALAR_LAST else [])]
        )
        if convention:
            found.append(DataFault("orientation_convention", (), {"convention": convention}))
        found += [
            DataFault("joint_turns", (), {"joint": i + 1, "added_rad": offset})
            for i, offset in enumerate(self.offset)
            if offset
        ]
        return found

    def joints(self, position: Array) -> Array:
        """The joint positions `(sample, joint)`."""
        return position[:, list(self.order)] * np.array(self.factor) + np.array(self.offset)

    def rotations(self, quaternion: Array) -> Array:
        """The measured orientations `(sample, 3, 3)`."""
        w, *vector = (quaternion[:, i] for i in self.quaternion)
        R = Rotation.from_quat(np.stack([*vector, w], 1)).as_matrix()
        return np.swapaxes(R, 1, 2) if self.inverted else R

    def applied(self, recording: Recording) -> Recording:
        """The recording with its columns corrected: what else is per joint is changed as the positions are."""
        order, factor = list(self.order), np.array(self.factor)
        changed = {"joint_position": self.joints(recording.joint_position)}
        changed["direction_of_motion"] = recording.direction_of_motion[:, order] * np.sign(factor)
        for name, scale in (
            ("joint_velocity", factor),
            ("joint_acceleration", factor),
            ("joint_torque", np.sign(factor)),
            ("motor_current", np.sign(factor)),
            ("joint_temperature", 1.0),
        ):
            column = getattr(recording, name)
            if column is not None:
                changed[name] = column[:, order] * scale
        if recording.quaternion is not None:
            turned = Rotation.from_matrix(self.rotations(recording.quaternion)).as_quat()
            unit = np.roll(turned, 1, axis=1)
            leading = np.argmax(np.abs(np.sign(unit)), axis=1)
            changed["quaternion"] = unit * np.sign(unit[np.arange(len(unit)), leading, None])
        return replace(recording, **changed)


@final
class Comparison(NamedTuple):
    """How corrections of columns compare.

    Attributes:
        error: m, the median of the nominal arm with the columns as recorded.
        limit: m above which columns are suspected.
        correction: the one to be made; None where the columns are right, or none helps.
        corrected_error: m, the median with the best correction, fitted; None where none was tried.
        alternatives: corrections that are indistinguishable from it.
    """

    error: float
    limit: float
    correction: ColumnCorrection | None = None
    corrected_error: float | None = None
    alternatives: tuple[ColumnCorrection, ...] = ()


def detect_columns(state: Screened, options: ScreeningOptions) -> Detection:
    """Columns that miss the poses grossly, unless their order, sign, unit, zero or convention is another."""
    compared = compare_corrections(state.rigid_arm, options)
    if compared.correction is not None:
        return Detection(compared)
    numbers: dict[str, Any] = {"median_error_m": compared.error, "suspected_above_m": compared.limit}
    if compared.corrected_error is not None:
        numbers["best_alternative_m"] = compared.corrected_error
    codes = _CODES if state.rigid_arm.rows == 6 else _CODES[:-1]
    return Detection(None, tuple(DataFault(code, (), numbers) for code in codes))


def correct_columns(state: Screened, compared: Comparison, options: ScreeningOptions) -> Screened:
    """The columns as the best correction has them, and the frames anew in closed form."""
    assert compared.correction is not None
    arm = state.rigid_arm
    alternatives = [
        [{"fault": fault.code, **fault.numbers} for fault in other.faults()] for other in compared.alternatives
    ]
    rigid = rigid_arm(compared.correction.applied(arm.recording), arm.arm, state.geometry, state.factory)
    for fault in compared.correction.faults():
        errors = {"median_error_m": compared.error, "corrected_error_m": compared.corrected_error}
        state = state.corrected(fault.with_numbers(**errors, alternatives=alternatives), rigid=rigid)
    return state.transformed(compared.correction.applied)


def single_corrections(dof: int, orientation: bool) -> Iterator[ColumnCorrection]:
    """Every correction of one fault, the simplest first."""
    same = ColumnCorrection(tuple(range(dof)), (1.0,) * dof, (0.0,) * dof)

    def with_joint(values: tuple[float, ...], joint: int, value: float) -> tuple[float, ...]:
        return (*values[:joint], value, *values[joint + 1 :])

    for i, j in combinations(range(dof), 2):
        order = list(same.order)
        order[i], order[j] = j, i
        yield replace(same, order=tuple(order))
    for i in range(dof):
        yield replace(same, factor=with_joint(same.factor, i, -1.0))
    for i in range(dof):
        for factor in (np.pi / 180, 180 / np.pi):
            yield replace(same, factor=with_joint(same.factor, i, factor))
    if orientation:
        yield replace(same, inverted=True)
        yield replace(same, quaternion=_SCALAR_LAST)
        yield replace(same, quaternion=_SCALAR_LAST, inverted=True)
    for i in range(dof):
        for quarters in (2, -2, 1, -1):
            yield replace(same, offset=with_joint(same.offset, i, quarters * np.pi / 2))


def compare_corrections(arm: RigidArm, options: ScreeningOptions) -> Comparison:
    """The correction of columns with which a recording fits, where as recorded it misses grossly.

    All are compared on some rows of the nominal arm, frames in closed form; the best are fitted, and must leave a share
    of the error at most, and be likelier than a fit of the columns as recorded. Pairs are compared where no single one
    suffices.

    Args:
        arm: not fitted yet, of a recording with poses.
        options: the thresholds.
    """
    limit = max(options.suspect_reach * arm.arm.reach, options.suspect_noise * arm.noise[0])
    few = _spread_rows(arm, options.column_rows)
    error = _median_error(few)
    if error <= limit:
        return Comparison(error, limit)
    allowed = min(error / options.column_gain, options.corrected_reach * arm.arm.reach)
    singles = list(single_corrections(arm.recording.dof, arm.rows == 6))
    compared = [(_median_error(_corrected(few, one)), one) for one in singles]
    first = sorted(compared, key=lambda item: item[0])[: options.pairs_first]
    if first[0][0] > options.unfitted_ratio * allowed:
        few = _spread_rows(arm, options.pair_rows)
        pairs = {tuple(sorted(map(singles.index, (a, b)))) for _, a in first for b in singles if not _overlap(a, b)}
        joined = [singles[a].then(singles[b]) for a, b in sorted(pairs)]
        compared = [(_median_error(_corrected(few, pair)), pair) for pair in joined]
        first = sorted(compared, key=lambda item: item[0])[: options.pairs_first]
    near = [
        one for left, one in first if left <= max(options.unfitted_ratio * allowed, options.fitted_ratio * first[0][0])
    ]
    fits = [(_median_error(_corrected(arm, one).fitted(options.most_fitted)), k, one) for k, one in enumerate(near)]
    least = min(fits)[0]
    if least > allowed:
        return Comparison(error, limit, corrected_error=least)
    equal = [
        one
        for left, _, one in fits
        if left <= max(options.equal_ratio * least, least + options.equal_noise * arm.noise[0])
    ]
    rank = {one: k for k, one in enumerate(singles)}
    chosen = min(equal, key=lambda one: (_outside_limits(arm, one, options), rank.get(one, 0), near.index(one)))
    # a chain that is not known may be further from its table than the limit, and fit the columns as recorded
    corrected, recorded = _corrected(arm, chosen).fitted(options.most_fitted), arm.fitted(options.most_fitted)
    scale = min(corrected.scale, recorded.scale)
    gain = corrected.log_likelihood(scale) - recorded.log_likelihood(scale)
    if gain < options.trusted_log_likelihood:
        return Comparison(_median_error(recorded), limit)
    distinct = [chosen]
    for one in equal:
        if not any(_whole_turns_apart(one, other) for other in distinct):
            distinct.append(one)
    return Comparison(error, limit, chosen, least, tuple(distinct[1:]))


def _spread_rows(arm: RigidArm, count: int) -> RigidArm:
    """The arm with some rows of its recording."""
    return arm.select(np.unique(np.linspace(0, arm.samples - 1, count).astype(int)))


def _corrected(arm: RigidArm, correction: ColumnCorrection) -> RigidArm:
    """With the columns corrected, and frames in closed form."""
    recording = correction.applied(arm.recording)
    flange = frames.chain(arm.links, recording.joint_position, recording.sliding) @ arm.arm.T_joint_flange
    assert recording.position is not None
    rotation = None if recording.quaternion is None else Rotation.from_quat(np.roll(recording.quaternion, -1, 1))
    free_frame = recording.settings.pose_frame != "base"
    free_tool = recording.settings.tool == "unknown"
    known_tool = np.linalg.inv(arm.arm.T_joint_flange) @ arm.T_flange_tool
    T_frame, T_tool = frames_from_poses(
        flange,
        recording.position,
        None if rotation is None else rotation.as_matrix(),
        None if free_frame else arm.T_sensor_base,
        None if free_tool else known_tool,
    )
    tool = arm.arm.T_joint_flange @ T_tool
    start = arm.start._replace(T_sensor_base=T_frame, T_flange_tool=tool)  # type: ignore[arg-type]
    return replace(arm, recording=recording, start=start)


def _median_error(arm: RigidArm) -> float:
    return float(np.median(np.hypot(arm.distance, LEVER * arm.turn)))


def _outside_limits(arm: RigidArm, correction: ColumnCorrection, options: ScreeningOptions) -> int:
    """How many joint positions a correction puts outside the limits."""
    slack = options.limit_slack_rad
    q, (low, high) = correction.joints(arm.recording.joint_position), arm.arm.joint_limits.T
    return int(np.sum((q < low - slack) | (q > high + slack)))


def _whole_turns_apart(a: ColumnCorrection, b: ColumnCorrection) -> bool:
    """Whether two corrections differ by whole turns of joints, or not at all."""
    turns = (np.array(a.offset) - np.array(b.offset)) / (2 * np.pi)
    return replace(a, offset=b.offset) == b and bool(np.allclose(turns, np.round(turns)))


def _overlap(a: ColumnCorrection, b: ColumnCorrection) -> bool:
    """Whether two corrections change the same columns."""
    return bool(_touched(a) & _touched(b))


def _touched(correction: ColumnCorrection) -> set[int]:
    changed = zip(correction.order, correction.factor, correction.offset, strict=True)
    joints = {i for i, (order, factor, offset) in enumerate(changed) if (order, factor, offset) != (i, 1.0, 0.0)}
    return joints or {-1}
