"""Joint positions whose real pose is the wanted one, from the model in a diagnosis file: a found error removed."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.se3 import rotation_from_quaternion
from lite6jax.domains.pose import inverse
from lite6jax.domains.pose.inverse import Reached, Target
from lite6jax.domains.pose.predict import Enriched
from lite6jax.effects.composition import Physics
from lite6jax.effects.kinematic.surroundings import BaseDrift, MeasurementScale, TimeOffset
from lite6jax.effects.motion import Motion
from lite6jax.errors import InputError
from lite6jax.model import ArmModel
from lite6jax.recordings import Recording, Targets, read_targets, sidecar_path
from lite6jax.storage import read_text

Array = NDArray[np.floating]
Flags = NDArray[np.bool_]

REACHED = (1e-6, 1e-5)
"""m and rad: a target is reached where the model's pose misses it by no more."""
_STARTS = (8, 24, 96)
"""Random joint positions to start from where none are given, and how many more where these do not arrive."""
_TRIED = 40
"""Steps from each of them."""
_NEAR = 1e-2
"""m: what the rigid arm misses by no more may be in reach of the bent one."""
_SINGULAR = 2e-3
"""m: what is missed by no more, inside the limits, is hard to get nearer to rather than far."""
_SAME = 1e-3
"""rad: joint positions no further apart are one solution."""
_FAR = 0.2
"""rad: a solution further than this from the joints given is worth a word."""
_SETTLINGS = 12
_SIZE_LIMIT = 1 << 26


@dataclass(frozen=True, eq=False)
class Compensation:
    """Joints for targets, a row a target.

    Attributes:
        recording: the joints as the motion that `predict` takes, row for row; NaN where a row has no target.
        position_error: `(row,)` m, between the model's pose and the target.
        orientation_error: `(row,)` rad; None where the targets are positions.
        reached: `(row,)` bool.
        reason: why a row is not reached, or what is worth knowing of one that is; else empty.
        correction: `(row, joint)` rad, from the joints given to these; None where none were.
        notes: what was left out or assumed, in sentences.
    """

    recording: Recording
    position_error: Array
    orientation_error: Array | None
    reached: Flags
    reason: tuple[str, ...]
    correction: Array | None
    notes: tuple[str, ...]

    @property
    def joint_position(self) -> Array:
        """`(row, joint)` rad."""
        return self.recording.joint_position

    def table(self) -> dict[str, NDArray]:
        """Column name to values: a motion, and whether and how nearly each target is reached."""
        columns: dict[str, NDArray] = dict(self.recording.columns())
        columns["ok"] = self.reached.astype(int)
        columns["position_error_mm"] = 1e3 * self.position_error
        if self.orientation_error is not None:
            columns["orientation_error_deg"] = np.rad2deg(self.orientation_error)
        columns["reason"] = np.array(self.reason, object)
        return columns


def read_limits(path: str | Path, model: Enriched) -> tuple[Array, dict[str, Any]]:
    """The joint limits `(joint, 2)` rad in the diagnosis file that `model` was read from, and all that is in it.

    Raises:
        InputError: they are missing or damaged.
    """
    try:
        document = json.loads(read_text(path, _SIZE_LIMIT))
        limits = np.asarray(document["model"]["joint_limits"], float)
        if limits.shape != (model.dof, 2) or not (np.isfinite(limits).all() and (limits[:, 0] < limits[:, 1]).all()):
            raise ValueError("joint_limits are not the lower and the upper one of each joint")
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: its model is damaged ({error}); run `lite6jax diagnose` again") from error
    return limits, document


def read_wanted(path: str | Path, model: Enriched, limits: Array) -> Targets:
    """Targets from a file; what its own sidecar does not say is as it was in the diagnosed recording.

    Raises:
        InputError: as `read_targets`.
    """
    reach = float(np.linalg.norm(np.asarray(model.model.geometry).reshape(-1, 6)[:, :3], axis=1).sum())
    reach += float(np.linalg.norm(np.asarray(model.model.T_flange_tool)[:3, 3]))
    recording, start = read_targets(path, model.dof, limits, reach)
    settings = recording.settings
    if not sidecar_path(path).exists():
        settings = replace(settings, reference_temperature_degC=model.reference_temperature)
    if settings.motion is None:
        settings = replace(settings, motion=model.motion)  # type: ignore[arg-type]
    return Targets(recording.made_anew(settings=settings), start)


def compensate(
    model: Enriched,
    targets: Targets,
    limits: Array,
    *,
    frame: Literal["sensor", "base"] = "sensor",
    approach: Sequence[int] | None = None,
) -> Compensation:
    """The joints at which the enriched arm shows the targets.

    Where joints are given beside a target the search starts from them and ends on their branch. Where none are, it
    starts from many, and of the solutions those are taken that move the joints least from row to row. What depends on
    the joints' own motion (directions of approach, velocities that are not recorded) follows from the joints found, as
    `predict` would take it from them, and the search is repeated until it stays.

    Args:
        model: the arm, from a diagnosis.
        targets: poses of the measured tool point.
        limits: `(joint, 2)` rad.
        frame: whose coordinates the targets are in: the sensor's, with its scale and drift; or the arm's base.
        approach: for each joint -1, 0 or 1, the direction in which it comes to every target; by default each row is
            approached from the one before, the first from zero.

    Raises:
        InputError: the targets lack what an effect of the model needs, by name; or `approach` is of another length.
    """
    if approach is not None and (len(approach) != model.dof or not set(approach) <= {-1, 0, 1}):
        raise InputError(f"approach: give -1, 0 or 1 for each of the {model.dof} joints")
    model, notes = _without_sensor(model, frame)
    recording = targets.recording
    whole = _whole(recording)
    if not whole.any():
        raise InputError(f"{recording.source}: every row has an empty field; fill one row at least")
    search = _Search(model, recording.select(whole), limits, approach)
    start = None if targets.start is None else targets.start[whole]
    found, turned = search.settled(search.branches(start))
    return _told(recording, whole, found, turned, targets.start, limits, (*recording.notes, *notes))


def _without_sensor(model: Enriched, frame: str) -> tuple[Enriched, list[str]]:
    """The model without what concerns the sensor's readings and not where the arm is."""
    dropped: tuple[type, ...] = (TimeOffset,)
    notes = []
    if frame == "base":
        dropped = (TimeOffset, MeasurementScale, BaseDrift)
        rigid = ArmModel(model.model.geometry, np.eye(4), model.model.T_flange_tool)  # type: ignore[arg-type]
        model = replace(model, model=rigid)
    kept = [(e, part) for e, part in zip(model.physics.effects, model.physics.slices, strict=True)]
    left_out = [effect.label for effect, _ in kept if isinstance(effect, dropped)]
    kept = [(e, part) for e, part in kept if not isinstance(e, dropped)]
    if left_out:
        verb = "concerns" if len(left_out) == 1 else "concern"
        notes.append(f"left out: {' and '.join(left_out)}, which {verb} the sensor and not where the arm is")
    physics = Physics(tuple(effect for effect, _ in kept))
    return replace(model, physics=physics, values=physics.join([model.values[part] for _, part in kept])), notes


def _whole(recording: Recording) -> Flags:
    """`(row,)`, rows in which all but the joints is there; those can be searched for."""
    columns = {name: column for name, column in recording.columns().items() if not name.startswith("q")}
    if recording.quaternion is not None:
        columns |= dict(enumerate(recording.quaternion.T))  # type: ignore[arg-type]
    return np.logical_and.reduce([np.isfinite(column) for column in columns.values()])


@dataclass(frozen=True, eq=False)
class _Search:
    """One model, targets without gaps, limits."""

    model: Enriched
    targets: Recording
    limits: Array
    approach: Sequence[int] | None

    def motion(self, q: Array) -> Motion:
        """What the arm does if it goes through these joints `(row, joint)`."""
        at = moved(self.targets, q)
        motion = self.model.motion_of(at)
        if self.approach is None:
            return motion
        towards = np.broadcast_to(np.array(self.approach, float)[:, None], q.T.shape)
        return motion._replace(direction=towards)  # type: ignore[arg-type]

    def target(self, rows: NDArray[np.integer]) -> Target:
        assert self.targets.position is not None
        rotation = None
        if self.targets.quaternion is not None:
            R = np.asarray(_rotations(self.targets.quaternion))[rows]
            rotation = np.moveaxis(R, 0, -1)
        return Target(self.targets.position[rows].T, rotation)  # type: ignore[arg-type]

    def solve(self, motion: Motion, rows: NDArray[np.integer], q: Array, **options: int) -> Reached:
        """From `q` `(start, joint)` for the rows, each in the circumstances that the row has in `motion`."""
        picked = jax.tree.map(lambda leaf: np.asarray(leaf)[..., rows], motion)._replace(joint_position=q.T)
        m, target = self.model, self.target(rows)
        return inverse.solve(m.physics, m.model, m.values, picked, m.inertia, target, self.limits, **options)

    def branches(self, start: Array | None) -> Array:
        """`(row, joint)`: for each row a solution, or what comes nearest; on the branch of `start`, or a short way."""
        count, dof = self.targets.samples, self.model.dof
        everywhere = np.arange(count)
        given = np.zeros(count, bool) if start is None else np.asarray(np.isfinite(start).all(1))
        at = np.zeros((count, dof)) if start is None else np.where(given[:, None], start, 0.0)
        motion = self.motion(at)
        rows, found = everywhere[given], at[given]
        first = self.solve(motion, rows, found) if given.any() else None
        lost = ~given
        if first is not None:
            lost[rows] = ~reached(first)
        if not lost.any():
            assert first is not None
            return first.joint_position.T
        where: list[NDArray] = [rows]
        q, cost = [found if first is None else first.joint_position.T], [_cost(first)]
        for k, starts in enumerate(_STARTS):
            tried = np.repeat(everywhere[lost], starts)
            near, missed = self._rigid(motion, tried, self._random(len(tried), k), free=k > 0)
            best = np.full(count, np.inf)
            np.minimum.at(best, tried, missed)
            kept = (missed < _NEAR**2) | (missed == best[tried])
            tried, near = _distinct(tried[kept], near[kept])
            bent = self.solve(motion, tried, near)
            where.append(tried)
            q.append(bent.joint_position.T)
            cost.append(bent.cost)
            lost[tried[reached(bent)]] = False
            if not lost.any():
                break
        middle = np.clip(self.limits, -np.pi, np.pi).mean(1)
        return _least_motion(np.concatenate(where), np.concatenate(q), np.concatenate(cost), at, given, middle)

    def _rigid(self, motion: Motion, rows: NDArray[np.integer], q: Array, free: bool) -> tuple[Array, Array]:
        """Where the arm without its effects ends from `q` `(start, joint)`, and what it misses, `(start,)` m².

        Free of limits it does not come to rest at one of them; its joints are then turned back by whole turns.
        """
        limits = np.tile([-1e3, 1e3], (self.model.dof, 1)) if free else self.limits
        m = self.model
        picked = jax.tree.map(lambda leaf: np.asarray(leaf)[..., rows], motion)._replace(joint_position=q.T)
        bare = (Physics(), m.model, np.zeros(0), picked, None, self.target(rows), limits)
        found = inverse.solve(*bare, steps=_TRIED)
        q = found.joint_position.T
        q = q - 2 * np.pi * np.round((q - self.limits.mean(1)) / (2 * np.pi)) if free else q
        inside = ((q >= self.limits[:, 0]) & (q <= self.limits[:, 1])).all(1)
        return np.clip(q, *self.limits.T), np.where(inside, found.cost, 1.0 + found.cost)

    def settled(self, q: Array) -> tuple[Reached, Flags]:
        """Solved again until directions and velocities are those of the joints found; errors are of that motion.

        Also `(row,)`, where that does not come to rest: with the direction that a row's joints ask for they are others.
        """
        rows = np.arange(len(q))
        motion = self.motion(q)
        found = self.solve(motion, rows, q)
        for _ in range(_SETTLINGS):
            before, motion = motion, self.motion(found.joint_position.T)
            stirred = np.flatnonzero(self._differ(before, motion))
            if not stirred.size:
                break
            again = self.solve(motion, stirred, found.joint_position.T[stirred])
            for whole, part in zip(found, again, strict=True):
                whole[..., stirred] = part
        q = found.joint_position.T
        at_last = self.solve(self.motion(q), rows, q, steps=0)
        return at_last._replace(pressed=found.pressed), reached(found) & ~reached(at_last)

    def _differ(self, one: Motion, other: Motion) -> Flags:
        """`(row,)`, where two motions differ in what the effects make of the joints' own movement."""
        differ = np.zeros(one.samples, bool)
        drivers = {driver.quantity for effect in self.model.physics.effects for driver in effect.drivers}
        for quantity, name, within in (("direction of motion", "direction", 0.0), ("velocity", "joint_velocity", 1e-9)):
            if quantity in drivers:
                moved = np.abs(np.asarray(getattr(one, name)) - np.asarray(getattr(other, name)))
                differ |= (moved > within).any(0)
        return differ

    def _random(self, count: int, seed: int) -> Array:
        lower, upper = np.clip(self.limits, -np.pi, np.pi).T
        lower, upper = np.where(lower < upper, (lower, upper), self.limits.T)  # limits beyond half a turn
        return np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))


_rotations = jax.jit(rotation_from_quaternion)


def _cost(found: Reached | None) -> Array:
    return np.zeros(0) if found is None else np.asarray(found.cost)


def reached(found: Reached) -> Flags:
    """`(sample,)`, whether the errors are within `REACHED`."""
    return (found.position_error <= REACHED[0]) & (found.orientation_error <= REACHED[1])


def moved(recording: Recording, q: Array) -> Recording:
    """The recording without poses at other joints: directions and velocities that were not recorded follow anew."""
    return recording.made_anew(joint_position=q, position=None, quaternion=None)


def _distinct(rows: NDArray[np.integer], q: Array) -> tuple[NDArray[np.integer], Array]:
    """One of those that are the same joints for the same row."""
    key = np.column_stack([rows, np.round(q / _SAME / 4).astype(int)])
    _, first = np.unique(key, axis=0, return_index=True)
    return rows[first], q[first]


def _least_motion(rows: NDArray[np.integer], q: Array, cost: Array, start: Array, given: Flags, middle: Array) -> Array:
    """`(row, joint)`: of the solutions of each row the one on the path that moves the joints least, by squares.

    The shortest path through the rows (R. Bellman, 1957); a row whose joints were given takes the solution nearest to
    them, and one without a solution what comes nearest to its target.

    Args:
        rows: `(candidate,)`, the row of each.
        q: `(candidate, joint)`.
        cost: `(candidate,)` m², what it misses.
        start: `(row, joint)`, the joints given.
        given: `(row,)`, whether they were.
        middle: `(joint,)`, where the first row is approached from.
    """
    order = np.argsort(rows, kind="stable")
    groups = np.split(order, np.searchsorted(rows[order], np.arange(1, len(start))))
    kept = []
    for row, group in enumerate(groups):
        hit = group[cost[group] < REACHED[0] ** 2]
        if not hit.size:
            hit = group[[np.argmin(cost[group])]]
        if given[row]:
            hit = hit[[np.argmin(np.abs(q[hit] - start[row]).max(1))]]
        kept.append(hit)
    length, before = np.sum((q[kept[0]] - middle) ** 2, 1), []
    for previous, here in pairwise(kept):
        steps = length[:, None] + np.sum((q[previous][:, None] - q[here]) ** 2, 2)
        before.append(np.argmin(steps, 0))
        length = np.min(steps, 0)
    at = int(np.argmin(length))
    path = [at]
    for came_from in reversed(before):
        at = int(came_from[at])
        path.append(at)
    return np.stack([q[group[at]] for group, at in zip(kept, reversed(path), strict=True)])


def _told(
    recording: Recording,
    whole: Flags,
    found: Reached,
    turned: Flags,
    start: Array | None,
    limits: Array,
    notes: tuple[str, ...],
) -> Compensation:
    """Row for row of the file, with words for what is to be known."""
    count = recording.samples

    def spread(values: NDArray) -> Array:
        full = np.full((count, *values.shape[1:]), np.nan)
        full[whole] = values
        return full

    ok, q, near = reached(found), found.joint_position.T, found.cost < _SINGULAR**2
    reason = np.full(count, "an empty field", object)
    correction = None if start is None else spread(q) - start
    for k, row in enumerate(np.flatnonzero(whole)):
        reason[row] = ""
        pressed = np.flatnonzero(found.pressed[:, k])
        if turned[k]:
            reason[row] = "turns back on its way here; approach it from one side"
        elif not ok[k]:
            side = [f"joint {j + 1} at its limit of {_limit(q[k, j], limits[j]):.4g} deg" for j in pressed]
            reason[row] = " and ".join(side) or ("next to a singular position" if near[k] else "out of reach")
        elif correction is not None and np.abs(correction[row]).max() > _FAR:
            joint = int(np.argmax(np.abs(correction[row])))
            reason[row] = f"joint {joint + 1} is {np.rad2deg(correction[row, joint]):.0f} deg from where it was given"
    return Compensation(
        recording=moved(recording, spread(q)),
        position_error=spread(np.asarray(found.position_error)),
        orientation_error=None if recording.quaternion is None else spread(np.asarray(found.orientation_error)),
        reached=spread(ok) == 1.0,
        reason=tuple(reason),
        correction=correction,
        notes=notes,
    )


def _limit(q: float, limits: Array) -> float:
    return float(np.rad2deg(limits[np.argmin(np.abs(limits - q))]))
