"""Joint positions at which a diagnosed arm reaches given poses: the compensation of the errors that were found."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jax.typing import ArrayLike
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.domains.pose.compensation_search import CompensationSearch, reached
from lite6jax.domains.pose.files import read_pose_targets
from lite6jax.domains.pose.inverse import Solved
from lite6jax.domains.pose.predict import Bars, DiagnosedArm, bars_of, recording_of, require_model
from lite6jax.effects.kinematic.surroundings import BaseDrift
from lite6jax.errors import InputError
from lite6jax.model import ArmModel
from lite6jax.recordings import Recording, Targets
from lite6jax.results import PublicResult

Array = NDArray[np.floating]
Flags = NDArray[np.bool_]
TargetFrame = Literal["sensor", "base"]

_SINGULAR = 2e-3
"""m: with a smaller error inside the joint limits, a target is next to a singular position; else out of reach."""
_FAR = 0.2
"""rad: a solution further than this from the joint positions given is reported."""


class Reason(NamedTuple):
    """Why a target is not reached, or what is to be noted of one that is.

    Attributes:
        code: what.
        joints: from 1: those at a limit, or the one that is far from its start.
        angles: rad of each: the limit, or the distance from the start.
    """

    code: Literal["empty_field", "reverses", "at_limit", "near_singular", "out_of_reach", "far_from_start"]
    joints: tuple[int, ...] = ()
    angles: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Compensation(PublicResult):
    """Joint positions for targets, one row per target.

    Attributes:
        recording: the joint positions as a motion for `predict`, row by row; NaN where a row has no target.
        position_error: `(row,)` m, between the model's pose and the target.
        orientation_error: `(row,)` rad; None where the targets are positions.
        reached: `(row,)` bool.
        reason: `(row,)`; None where there is nothing to report.
        correction: `(row, joint)` rad, from the joint positions given to these; None where none were given.
        omitted: labels of effects that concern the sensor and not where the arm is; they are left out.
        notes: of the targets, as they were read.
        position_std: `(row, 3)` m, of the pose that is reached, along the axes of the targets' frame, as those of
            `predicted`; None where the diagnosis does not say.
        orientation_std: `(row, 3)` rad, about the tool's axes; None also where no orientation was recorded.
        outside: `(row,)` bool, as of `Prediction`; None where the diagnosis does not say.
    """

    recording: Recording
    position_error: Array
    orientation_error: Array | None
    reached: Flags
    reason: tuple[Reason | None, ...]
    correction: Array | None
    omitted: tuple[str, ...]
    notes: tuple[str, ...]
    position_std: Array | None = None
    orientation_std: Array | None = None
    outside: Flags | None = None

    @property
    def joint_position(self) -> Array:
        """`(row, joint)` rad."""
        return self.recording.joint_position


def compensate(
    model: DiagnosedArm,
    targets: Targets | str | Path | ArrayLike,
    *,
    start: ArrayLike | None = None,
    frame: TargetFrame = "sensor",
    approach: Sequence[int] | None = None,
    **circumstances: ArrayLike,
) -> Compensation:
    """The joint positions at which the arm with its effects reaches the targets.

    With joint positions given for a target, the search starts from them and ends on their branch. Without, it starts
    from many, and selects the solutions that move the joints least from row to row, of those inside what was recorded
    where there are some. Directions of approach, and
    velocities that are not recorded, follow from the joint positions found, as `predict` takes them; the search is
    repeated until they no longer change.

    Args:
        model: the arm, from a diagnosis.
        targets: poses of the measured tool point: `(row, 4, 4)`, or positions `(row, 3)` in m with any orientation, or
            the path of a table of them, as `lite6jax compensate` reads it.
        start: `(row, joint)` rad, beside targets that are an array.
        frame: the frame of the targets: the sensor's, with its scale and drift; or the arm's base.
        approach: for each joint -1, 0 or 1, the direction from which it approaches every target; by default each row
            is approached from the one before, the first from zero.
        circumstances: beside targets that are an array, further ones, as in `predict`.

    Raises:
        InputError: the targets lack what an effect needs, by name; arrays of another shape; degrees; `approach` of
            another length; or a model without joint limits.
    """
    require_model(model)
    if isinstance(targets, str | Path):
        targets = read_pose_targets(targets, model)
    if approach is not None and (len(approach) != model.dof or not set(approach) <= {-1, 0, 1}):
        raise InputError(f"approach: give -1, 0 or 1 for each of the {model.dof} joints")
    if model.joint_limits is None:
        raise InputError("compensate: the model has no joint limits; run `lite6jax diagnose` again")
    if not isinstance(targets, Targets):
        targets = _targets_of(model, targets, start, circumstances)
    elif start is not None or circumstances:
        raise InputError("compensate: these targets have their own joint positions; give the poses as an array")
    if targets.start is None:
        targets = targets._replace(recording=replace(targets.recording, sliding=model.sliding))
    model, omitted = _without_sensor(model, frame)
    recording = targets.recording
    complete = _complete(recording)
    if not complete.any():
        raise InputError(f"{recording.source}: every row has an empty field; fill one row at least")
    search = CompensationSearch(model, recording.select(complete), np.asarray(model.joint_limits), approach)
    first = None if targets.start is None else targets.start[complete]
    solved, reverses = search.settled(search.branches(first))
    found = _compensation(targets, complete, solved, reverses, search.limits, omitted)
    bars = bars_of(model, search.motion(solved.joint_position.T))
    return found if bars is None else _with_bars(found, complete, bars, model.orientation)


def _targets_of(
    model: DiagnosedArm, poses: ArrayLike, start: ArrayLike | None, circumstances: dict[str, ArrayLike]
) -> Targets:
    T = np.asarray(poses, float)
    if T.ndim not in (2, 3) or T.shape[1:] not in ((3,), (4, 4)) or not len(T):
        raise InputError(f"compensate: targets have the shape {T.shape}; give (row, 4, 4), or (row, 3) positions in m")
    q = np.zeros((len(T), model.dof)) if start is None else np.asarray(start, float)
    if q.shape != (len(T), model.dof):
        raise InputError(f"compensate: start has the shape {q.shape}; give {(len(T), model.dof)} in rad")
    position, quaternion = T, None
    if T.ndim == 3:
        position = T[:, :3, 3]
        quaternion = np.roll(Rotation.from_matrix(T[:, :3, :3]).as_quat(), 1, axis=1)
    recording = recording_of(model, q, position=position, quaternion=quaternion, **circumstances)
    return Targets(recording, None if start is None else q)


def _without_sensor(model: DiagnosedArm, frame: TargetFrame) -> tuple[DiagnosedArm, tuple[str, ...]]:
    """The model without what concerns the sensor's readings and not where the arm is."""
    sites = ("clock",)
    if frame == "base":
        sites = ("clock", "sensor")
        rigid = ArmModel(model.model.geometry, np.eye(4), model.model.T_flange_tool)  # type: ignore[arg-type]
        known = None if model.uncertainty is None else model.uncertainty.without_base()
        model = replace(model, model=rigid, uncertainty=known)
    effects = model.physics.effects
    without = [effect.site in sites or (frame == "base" and isinstance(effect, BaseDrift)) for effect in effects]
    omitted = tuple(effect.label for effect, left_out in zip(effects, without, strict=True) if left_out)
    return model.keeping([not left_out for left_out in without]), omitted


def _complete(recording: Recording) -> Flags:
    """`(row,)`, rows in which everything but the joint positions is given."""
    columns = {name: column for name, column in recording.columns().items() if not name.startswith("q")}
    if recording.quaternion is not None:
        columns |= dict(enumerate(recording.quaternion.T))  # type: ignore[arg-type]
    return np.logical_and.reduce([np.isfinite(column) for column in columns.values()])


def _compensation(
    targets: Targets, complete: Flags, solved: Solved, reverses: Flags, limits: Array, omitted: tuple[str, ...]
) -> Compensation:
    """Row for row of the targets."""
    recording, start = targets

    def spread(values: NDArray) -> Array:
        full = np.full((recording.samples, *values.shape[1:]), np.nan)
        full[complete] = values
        return full

    q, hit = spread(solved.joint_position.T), spread(reached(solved)) == 1.0
    correction = None if start is None else q - start
    reasons: list[Reason | None] = [Reason("empty_field")] * recording.samples
    for k, row in enumerate(np.flatnonzero(complete)):
        reasons[row] = None
        if reverses[k]:
            reasons[row] = Reason("reverses")
        elif not hit[row]:
            reasons[row] = _missed(solved, k, limits)
        elif correction is not None and np.abs(correction[row]).max() > _FAR:
            joint = int(np.argmax(np.abs(correction[row])))
            reasons[row] = Reason("far_from_start", (joint + 1,), (float(correction[row, joint]),))
    return Compensation(
        recording=recording.made_anew(joint_position=q, position=None, quaternion=None),
        position_error=spread(np.asarray(solved.position_error)),
        orientation_error=None if recording.quaternion is None else spread(np.asarray(solved.orientation_error)),
        reached=hit,
        reason=tuple(reasons),
        correction=correction,
        omitted=omitted,
        notes=recording.notes,
    )


def _with_bars(found: Compensation, complete: Flags, bars: Bars, orientation: bool) -> Compensation:
    """With the bars of the complete rows."""
    outside = np.zeros(len(complete), bool)
    position, turned = np.full((2, len(complete), 3), np.nan)
    position[complete], turned[complete], outside[complete] = bars
    return replace(found, position_std=position, orientation_std=turned if orientation else None, outside=outside)


def _missed(solved: Solved, k: int, limits: Array) -> Reason:
    joints = np.flatnonzero(solved.pressed[:, k])
    if joints.size:
        at = solved.joint_position[joints, k]
        upper = np.abs(limits[joints, 1] - at) < np.abs(limits[joints, 0] - at)
        angles = np.where(upper, limits[joints, 1], limits[joints, 0])
        return Reason("at_limit", tuple(map(int, joints + 1)), tuple(map(float, angles)))
    return Reason("near_singular" if solved.cost[k] < _SINGULAR**2 else "out_of_reach")
