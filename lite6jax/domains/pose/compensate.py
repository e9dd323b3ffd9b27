"""Joint positions at which a diagnosed arm reaches given poses: the compensation of the errors that were found.

They are searched for from many starts; of the solutions, those on the path of least motion are selected, and solved
again until the directions of approach are those of the joint positions found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Literal, NamedTuple

import jax
import numpy as np
from jax.typing import ArrayLike
from numpy.typing import NDArray

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.calibration.start import measured_rotations
from lite6jax.domains.pose import inverse
from lite6jax.domains.pose.inverse import InverseSolution, Target
from lite6jax.domains.pose.kinematics import unit_quaternions
from lite6jax.domains.pose.predict import DiagnosedArm, predict_deviations, require_model, zeros_text
from lite6jax.effects.kinematic import BaseDrift
from lite6jax.effects.motion import Motion
from lite6jax.errors import InputError
from lite6jax.model import ArmModel, predict_poses
from lite6jax.recordings import ArmJoints, Recording, Targets, assemble_motion, read_targets, sidecar_path
from lite6jax.recordings.columns import sizes
from lite6jax.recordings.columns.inspection import inspect
from lite6jax.recordings.files import declare_anew, open_table, require_table
from lite6jax.recordings.settings import read_sidecar
from lite6jax.results import PublicResult
from lite6jax.sensors.pose import PoseSensor
from lite6jax.storage import exists

TargetFrame = Literal["sensor", "base"]

REACHED = (1e-6, 1e-5)
"""m and rad: a target is reached where the model's pose differs from it by no more."""
_SINGULAR = 2e-3
"""m: with a smaller error inside the joint limits, a target is next to a singular position; else out of reach."""
_FAR = 0.2
"""rad: a solution further than this from the joint positions given is reported."""
_STARTS = (8, 24, 96)
"""Random joint positions to start from where none are given, and how many more where these do not converge."""
_NEAR = 1e-2
"""m: a target that the rigid arm misses by no more may be in reach of the arm with effects."""
_SAME = 1e-3
"""rad: joint positions no further apart are one solution."""
_SETTLINGS = 12
"""Rounds in which directions and velocities follow the joint positions found."""


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
    """Joint positions for targets, one row per target: as the arm's controller counts them, to be sent to it.

    Attributes:
        recording: the joint positions as a motion for `predict`, row by row; NaN where a row has no target.
        position_error: `(row,)` m, between the model's pose and the target.
        orientation_error: `(row,)` rad; None where the targets are positions.
        reached: `(row,)` bool.
        reason: `(row,)`; None where there is nothing to report.
        correction: `(row, joint)` rad, from the joint positions given to these; None where none were given.
        omitted: labels of effects that concern the sensor and not where the arm is; they are left out.
        notes: of the targets, as they were read, and of the zeros of joints that are off.
        position_std: `(row, 3)` m, of the pose that is reached, along the axes of the targets' frame, as those of
            `predicted`; None where the diagnosis does not say.
        orientation_std: `(row, 3)` rad, about the tool's axes; None also where no orientation was recorded.
        outside: `(row,)` bool, as of `Prediction`; None where the diagnosis does not say.
    """

    recording: Recording
    position_error: Array
    orientation_error: Array | None
    reached: Mask
    reason: tuple[Reason | None, ...]
    correction: Array | None
    omitted: tuple[str, ...]
    notes: tuple[str, ...]
    position_std: Array | None = None
    orientation_std: Array | None = None
    outside: Mask | None = None

    @property
    def joint_position(self) -> Array:
        """`(row, joint)` rad, as the controller counts."""
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
    """The joint positions at which the arm with its effects reaches the targets, as its controller counts them.

    They are to be sent to the controller whose joint positions were recorded, and `predict` takes them as they are:
    where the diagnosis found that the zero of a joint is off, `model.joint_zero` is subtracted already. Joint positions
    that are given are taken likewise.

    With joint positions given for a target, the search starts from them and ends on their branch. Without, it starts
    from many, and selects the solutions that move the joints least from row to row, of those inside what was recorded
    where there are some. Directions of approach, and
    velocities that are not recorded, follow from the joint positions found, as `predict` takes them; the search is
    repeated until they no longer change.

    Args:
        model: the arm, from a diagnosis.
        targets: poses of the measured tool point: `(row, 4, 4)`, or positions `(row, 3)` in m with any orientation, or
            the path of a table of them, as `lite6jax compensate` reads it.
        start: `(row, joint)` rad, beside targets that are an array; as the controller counts.
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
    limits = _limits(model)
    zero = np.asarray(model.joint_zero)
    if not isinstance(targets, Targets):
        targets = _targets_of(model, targets, start, circumstances)
    elif start is not None or circumstances:
        raise InputError("compensate: these targets have their own joint positions; give the poses as an array")
    if targets.start is None:
        targets = targets._replace(recording=replace(targets.recording, sliding=model.sliding))
    model, omitted = _without_sensor(model, frame)
    recording = targets.recording
    filled = {name: column for name, column in recording.columns().items() if not name.startswith("q")}
    complete = np.logical_and.reduce([np.isfinite(column) for column in filled.values()])
    if recording.quaternion is not None:
        complete &= np.isfinite(recording.quaternion).all(1)
    if not complete.any():
        raise InputError(f"{recording.source}: every row has an empty field; fill one row at least")
    search = _Search(model, recording.select(complete), limits, approach)
    first = None if targets.start is None else targets.start[complete] + zero
    solved, reverses = search.settle(search.branches(first))

    def spread(values: NDArray) -> Array:
        """Row for row of the targets, NaN where a row has none."""
        full = np.full((recording.samples, *values.shape[1:]), np.nan)
        full[complete] = values
        return full

    q = spread(solved.joint_position.T) - zero
    hit = _reached(solved)
    correction = None if targets.start is None else q - targets.start
    reasons: list[Reason | None] = [Reason("empty_field")] * recording.samples
    for k, row in enumerate(np.flatnonzero(complete)):
        reasons[row] = None
        if reverses[k]:
            reasons[row] = Reason("reverses")
        elif not hit[k]:
            reasons[row] = _missed(solved, k, limits, zero)
        elif correction is not None and np.abs(correction[row]).max() > _FAR:
            joint = int(np.argmax(np.abs(correction[row])))
            reasons[row] = Reason("far_from_start", (joint + 1,), (float(correction[row, joint]),))
    std, turned_std, outside = predict_deviations(model, search.motion(solved.joint_position.T))
    return Compensation(
        recording=recording.made_anew(joint_position=q, position=None, quaternion=None),
        position_error=spread(solved.position_error),
        orientation_error=None if recording.quaternion is None else spread(solved.orientation_error),
        reached=spread(hit) == 1.0,
        reason=tuple(reasons),
        correction=correction,
        omitted=omitted,
        notes=(*recording.notes, *_notes_of_zeros(model)),
        position_std=None if std is None else spread(std),
        orientation_std=None if turned_std is None else spread(turned_std),
        outside=None if outside is None else spread(outside) == 1.0,
    )


def _limits(model: DiagnosedArm) -> Array:
    """`(joint, 2)` rad as the arm's description counts: its own limits, and inside those that the controller checks."""
    if model.joint_limits is None:
        raise InputError("compensate: the model has no joint limits; run `lite6jax diagnose` again")
    limits = np.asarray(model.joint_limits)
    checked = model.controller_limits(limits) + np.asarray(model.joint_zero)[:, None]
    return np.stack([np.maximum(limits[:, 0], checked[:, 0]), np.minimum(limits[:, 1], checked[:, 1])], 1)


def _notes_of_zeros(model: DiagnosedArm) -> tuple[str, ...]:
    """That joint positions are not those of the arm's description; empty where they are."""
    if not np.any(model.joint_zero):
        return ()
    zeros = zeros_text(-np.asarray(model.joint_zero))
    return (f"the zeros of joints are off; joint positions are written as the controller counts them, with {zeros}",)


def _targets_of(
    model: DiagnosedArm, poses: ArrayLike, start: ArrayLike | None, circumstances: dict[str, ArrayLike]
) -> Targets:
    T = np.asarray(poses, float)
    if T.ndim not in (2, 3) or T.shape[1:] not in ((3,), (4, 4)) or not len(T):
        raise InputError(f"compensate: targets have the shape {T.shape}; give (row, 4, 4), or (row, 3) positions in m")
    q = np.zeros((len(T), model.dof)) if start is None else np.asarray(start, float)
    if q.shape != (len(T), model.dof):
        raise InputError(f"compensate: start has the shape {q.shape}; give {(len(T), model.dof)} in rad")
    position = T
    quaternion = None
    if T.ndim == 3:
        position = T[:, :3, 3]
        quaternion = unit_quaternions(T[:, :3, :3])
    recording = assemble_motion(model, q, position=position, quaternion=quaternion, **circumstances)
    return Targets(recording, None if start is None else q)


def _without_sensor(model: DiagnosedArm, frame: TargetFrame) -> tuple[DiagnosedArm, tuple[str, ...]]:
    """The model without what concerns the sensor's readings and not where the arm is."""
    sites = ("clock",)
    if frame == "base":
        sites = ("clock", "sensor")
        rigid = ArmModel(model.model.geometry, np.eye(4), model.model.T_flange_tool)  # type: ignore[arg-type]
        uncertainty = None
        if model.uncertainty is not None:
            uncertainty = model.uncertainty.without_base()
        model = replace(model, model=rigid, uncertainty=uncertainty)
    effects = model.physics.effects
    without = [effect.site in sites or (frame == "base" and isinstance(effect, BaseDrift)) for effect in effects]
    omitted = tuple(effect.label for effect, left_out in zip(effects, without, strict=True) if left_out)
    return model.keeping([not left_out for left_out in without]), omitted


def _missed(solved: InverseSolution, k: int, limits: Array, zero: Array) -> Reason:
    """Why the k-th target is not reached; a limit is said as the controller counts, which is less by `zero`."""
    joints = np.flatnonzero(solved.pressed[:, k])
    if joints.size:
        at = solved.joint_position[joints, k]
        upper = np.abs(limits[joints, 1] - at) < np.abs(limits[joints, 0] - at)
        angles = np.where(upper, limits[joints, 1], limits[joints, 0]) - zero[joints]
        return Reason("at_limit", tuple(map(int, joints + 1)), tuple(map(float, angles)))
    return Reason("near_singular" if solved.cost[k] < _SINGULAR**2 else "out_of_reach")


def read_pose_targets(path: str | Path, model: DiagnosedArm, given: Mapping[str, str] | None = None) -> Targets:
    """Targets for `compensate`; what their own sidecar does not declare is taken from the diagnosed recording.

    Args:
        path: the table. Names of its own, such as X, Y and Z, are recognised as by `inspect`; the arm's reach says
            whether positions are in m or mm.
        model: the arm.
        given: columns with the names that they have in a recording, where the caller knows better; or `ignore`.

    Raises:
        InputError: as `read_targets`; or what a column means, or its unit, is not certain.
    """
    path = require_table(path)
    reach = float(np.linalg.norm(np.asarray(model.model.geometry).reshape(-1, 6)[:, :3], axis=1).sum())
    reach += float(np.linalg.norm(np.asarray(model.model.T_flange_tool)[:3, 3]))
    columns, notes = _name_targets(path, model, reach, given or {})
    recording, start = read_targets(path, model.dof, model.joint_limits, reach, columns)
    recording = replace(recording, notes=(*notes, *recording.notes))
    settings = recording.settings
    if not exists(sidecar_path(path)):
        settings = replace(settings, reference_temperature_degC=model.reference_temperature)
    if settings.motion is None:
        settings = replace(settings, motion=model.motion)  # type: ignore[arg-type]
    return Targets(declare_anew(recording, settings), start)


def _name_targets(
    path: Path, model: DiagnosedArm, reach: float, meanings: Mapping[str, str]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """The names in a recording of a table's own names, and a note; empty where it has a recording's names already."""
    declared = read_sidecar(sidecar_path(path)).columns
    _, table = open_table(path, (), ArmJoints(model.dof), [])
    if not meanings and (declared or {"x_m", "x_mm"} & {*table.names}):
        return {}, ()
    columns = dict(table.numbers())
    inspection = inspect(list(columns.items()), given={**declared, **meanings}, source=str(path))
    place = inspection.of("position")
    turned = inspection.of("rotation")
    if place is None:
        if {"x_m", "x_mm"} & set(inspection.columns.values()):
            return inspection.columns, ()
        raise InputError(
            f"{path}: no columns look like positions to reach; say which they are: --column NAME=x_mm, and likewise "
            "y_mm and z_mm (x_m … in metres), or `columns:` in its sidecar"
        )
    if turned is not None and turned.form is not None and turned.form.sure != "certain":
        first = turned.columns[0]
        raise InputError(
            f"{path}: what the angles {', '.join(turned.columns)} mean is not certain; say it: --column "
            f"{first}=roll_deg (or yaw_deg, rx_rad, alpha_deg, ignore), and likewise the others, or "
            "`columns:` in its sidecar"
        )
    assert place.unit is not None
    unit = place.unit.choice
    if place.unit.reason != "name":
        numbers = {name: values for name, values in columns.items() if values is not None}
        sensor = np.asarray(model.model.T_sensor_base)[:3, 3]
        reachable = sizes.unit_within_reach(place.values(numbers), reach, (np.zeros(3), sensor))
        if reachable is None:
            name = place.columns[0]
            raise InputError(
                f"{path}: whether {', '.join(place.columns)} are in m or mm is not certain; say it: --column "
                f"{name}=x_mm (or x_m), and likewise the others, or `columns:` in its sidecar"
            )
        unit = reachable
    meant = inspection.columns | place.renamed(unit=unit)
    pairs = ", ".join(f"{column}={name}" for column, name in meant.items() if name != "ignore" and column != name)
    return meant, ((f"columns are read as {pairs}",) if pairs else ())


def _reached(solved: InverseSolution) -> Mask:
    """`(sample,)`, whether the errors are within `REACHED`."""
    return (solved.position_error <= REACHED[0]) & (solved.orientation_error <= REACHED[1])


@dataclass(frozen=True, eq=False)
class _Search:
    """A model, targets without empty fields, joint limits. Joint positions are as the arm's description counts them.

    Attributes:
        model: the arm.
        targets: poses.
        limits: `(joint, 2)` rad.
        approach: for each joint -1, 0 or 1; None where each row is approached from the one before.
    """

    model: DiagnosedArm
    targets: Recording
    limits: Array
    approach: Sequence[int] | None

    def motion(self, q: Array) -> Motion:
        """The motion through joint positions `(row, joint)`: what is not recorded of it follows from them."""
        recorded = q - np.asarray(self.model.joint_zero)
        motion = self.model.motion_of(self.targets.made_anew(joint_position=recorded, position=None, quaternion=None))
        if self.approach is None:
            return motion
        direction = np.broadcast_to(np.array(self.approach, float)[:, None], q.T.shape)
        return motion._replace(direction=direction)  # type: ignore[arg-type]

    def solve(self, motion: Motion, rows: Integers, q: Array, **options: int) -> InverseSolution:
        """From `q` `(start, joint)` for `rows` `(start,)`, each under the circumstances of its row in `motion`."""
        m = self.model
        target = self._target(rows)
        at = jax.tree.map(lambda leaf: np.asarray(leaf)[..., rows], motion)._replace(joint_position=q.T)
        return inverse.solve(m.physics, m.model, m.values, at, m.inertia, target, self.limits, **options)

    def branches(self, start: Array | None) -> Array:
        """`(row, joint)`: for each row a solution, or the nearest found; on the branch of `start`, or a short path."""
        count = self.targets.samples
        dof = self.model.dof
        has_start = np.zeros(count, bool) if start is None else np.asarray(np.isfinite(start).all(1))
        at = np.zeros((count, dof)) if start is None else np.where(has_start[:, None], start, 0.0)
        motion = self.motion(at)
        unsolved = np.ones(count, bool)
        solutions: list[tuple[Integers, Array, Array]] = []

        def solve(rows: Integers, q: Array) -> None:
            solved = self.solve(motion, rows, q)
            solutions.append((rows, solved.joint_position.T, solved.cost))
            unsolved[rows[_reached(solved)]] = False

        if has_start.any():
            solve(np.flatnonzero(has_start), at[has_start])
        for k, starts in enumerate(_STARTS):
            if not unsolved.any():
                break
            attempted = np.repeat(np.flatnonzero(unsolved), starts)
            rigid, missed = self._rigid(attempted, self._random(len(attempted), k), unlimited=k > 0)
            smallest = np.full(count, np.inf)
            np.minimum.at(smallest, attempted, missed)
            promising = (missed < _NEAR**2) | (missed == smallest[attempted])
            attempted = attempted[promising]
            rigid = rigid[promising]
            key = np.column_stack([attempted, np.round(rigid / _SAME / 4).astype(int)])
            _, distinct = np.unique(key, axis=0, return_index=True)
            solve(attempted[distinct], rigid[distinct])
        rows, positions, costs = (np.concatenate(parts) for parts in zip(*solutions, strict=True))
        return _least_motion(rows, positions, costs, at, has_start, self._usual())

    def settle(self, q: Array) -> tuple[InverseSolution, Mask]:
        """Solved until directions and velocities are those of the joint positions found; errors are of that motion.

        Also `(row,)`, where that does not converge: the direction in which a row is approached leads to joint positions
        that are approached from the other side.
        """
        rows = np.arange(len(q))
        motion = self.motion(q)
        solved = self.solve(motion, rows, q)
        for _ in range(_SETTLINGS):
            before = motion
            motion = self.motion(solved.joint_position.T)
            changed = np.flatnonzero(self._differ(before, motion))
            if not changed.size:
                break
            again = self.solve(motion, changed, solved.joint_position.T[changed])
            for full, part in zip(solved, again, strict=True):
                full[..., changed] = part
        q = solved.joint_position.T
        evaluated = self._evaluated(q)
        return evaluated._replace(pressed=solved.pressed), _reached(solved) & ~_reached(evaluated)

    def _evaluated(self, q: Array) -> InverseSolution:
        """The errors of the motion through joint positions `(row, joint)`; effects with memory see all of it."""
        motion = self.motion(q)
        m = self.model
        solved = self.solve(motion, np.arange(len(q)), q, steps=0)
        if not any(effect.hysteretic for effect in m.physics.effects):
            return solved
        poses = np.asarray(predict_poses(motion.chain, m.physics, m.model, m.values, motion, m.inertia))
        position, rotation = self._target(np.arange(len(q)))
        target = PoseSensor(position, np.zeros((3, 3, 0)) if rotation is None else rotation, np.ones(2))
        missed = target.differences(poses)
        position_error, orientation_error = (np.linalg.norm(part, axis=0) for part in (missed[:3], missed[3:]))
        return solved._replace(position_error=position_error, orientation_error=orientation_error)

    def _target(self, rows: Integers) -> Target:
        assert self.targets.position is not None
        R = measured_rotations(self.targets)
        rotation = None if R is None else np.moveaxis(R[rows], 0, -1)
        return Target(self.targets.position[rows].T, rotation)  # type: ignore[arg-type]

    def _rigid(self, rows: Integers, q: Array, unlimited: bool) -> tuple[Array, Array]:
        """Where the arm without effects ends from `q` `(start, joint)`, and the squared errors `(start,)` in m².

        Without limits it does not stop at one of them; its joints are then returned by whole turns.
        """
        turns = ~np.isin(np.arange(self.model.dof), self.model.sliding)
        limits = np.where(turns[:, None] & unlimited, [-1e3, 1e3], self.limits)
        m = self.model
        solved = inverse.solve_rigid(m.model, self._target(rows), q, limits, m.sliding)
        q = solved.joint_position.T
        whole_turns = 2 * np.pi * np.round((q - self.limits.mean(1)) / (2 * np.pi))
        q = np.where(turns & unlimited, q - whole_turns, q)
        inside = ((q >= self.limits[:, 0]) & (q <= self.limits[:, 1])).all(1)
        return np.clip(q, *self.limits.T), np.where(inside, solved.cost, 1.0 + solved.cost)

    def _differ(self, before: Motion, after: Motion) -> Mask:
        """`(row,)`, where two motions differ in what effects depend on and the joints' own movement determines."""
        differ = np.zeros(before.samples, bool)
        drivers = {driver.quantity for effect in self.model.physics.effects for driver in effect.drivers}
        for quantity, values_before, values_after, within in (
            ("direction of motion", before.direction, after.direction, 0.0),
            ("velocity", before.joint_velocity, after.joint_velocity, 1e-9),
        ):
            if quantity in drivers:
                change = np.abs(np.asarray(values_before) - np.asarray(values_after))
                differ |= (change > within).any(0)
        return differ

    def _random(self, count: int, seed: int) -> Array:
        lower, upper = (self._usual() if seed == 0 else self._middle_turn()).T
        lower, upper = np.where(lower < upper, (lower, upper), self.limits.T)  # limits beyond half a turn
        return np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))

    def _usual(self) -> Array:
        """`(joint, 2)`, the range that was recorded, where the model is known; without one `_middle_turn`."""
        uncertainty = self.model.uncertainty
        if uncertainty is None:
            return self._middle_turn()
        lower, upper = np.clip(uncertainty.recorded.joints.T, *self.limits.T)
        return np.stack([lower, upper], 1)

    def _middle_turn(self) -> Array:
        """`(joint, 2)`, the limits within half a turn of zero; of prismatic joints all of them."""
        slides = np.isin(np.arange(self.model.dof), self.model.sliding)[:, None]
        return np.where(slides, self.limits, np.clip(self.limits, -np.pi, np.pi))


def _least_motion(rows: Integers, q: Array, cost: Array, start: Array, has_start: Mask, usual: Array) -> Array:
    """`(row, joint)`: of the solutions of each row the one on the path that moves the joints least, by squares.

    The shortest path through the rows (R. Bellman, 1957). Where a row has solutions in the usual range, it takes one of
    these. A row with joint positions given takes the solution nearest to them, and one without a solution the joint
    positions nearest to its target.

    Args:
        rows: `(candidate,)`, the row of each.
        q: `(candidate, joint)`.
        cost: `(candidate,)` m², its squared error.
        start: `(row, joint)`, the joint positions given.
        has_start: `(row,)`, whether they were.
        usual: `(joint, 2)`, the usual range, from whose middle the first row is approached.
    """
    order = np.argsort(rows, kind="stable")
    groups = np.split(order, np.searchsorted(rows[order], np.arange(1, len(start))))
    layers = []
    inside = np.all((q >= usual[:, 0]) & (q <= usual[:, 1]), axis=1)
    for row, group in enumerate(groups):
        solutions = group[cost[group] < REACHED[0] ** 2]
        if not solutions.size:
            solutions = group[[np.argmin(cost[group])]]
        elif inside[solutions].any() and not has_start[row]:
            solutions = solutions[inside[solutions]]
        if has_start[row]:
            solutions = solutions[[np.argmin(np.abs(q[solutions] - start[row]).max(1))]]
        layers.append(solutions)
    length = np.sum((q[layers[0]] - usual.mean(1)) ** 2, 1)
    before = []
    for previous, current in pairwise(layers):
        steps = length[:, None] + np.sum((q[previous][:, None] - q[current]) ** 2, 2)
        before.append(np.argmin(steps, 0))
        length = np.min(steps, 0)
    at = int(np.argmin(length))
    path = [at]
    for predecessor in reversed(before):
        at = int(predecessor[at])
        path.append(at)
    return np.stack([q[group[at]] for group, at in zip(layers, reversed(path), strict=True)])
