"""The search for joint positions that reach poses: many starts, the path of least motion, and settled directions."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import final

import jax
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms.se3 import rotation_from_quaternion
from lite6jax.domains.pose import inverse
from lite6jax.domains.pose.inverse import Solved, Target
from lite6jax.domains.pose.predict import DiagnosedArm, has_memory
from lite6jax.effects.composition import Physics
from lite6jax.effects.motion import Motion
from lite6jax.model import predict_poses
from lite6jax.recordings import Recording

Array = NDArray[np.floating]
Flags = NDArray[np.bool_]
Rows = NDArray[np.integer]

REACHED = (1e-6, 1e-5)
"""m and rad: a target is reached where the model's pose differs from it by no more."""
_STARTS = (8, 24, 96)
"""Random joint positions to start from where none are given, and how many more where these do not converge."""
_RIGID_STEPS = 40
"""Steps of the arm without effects from each of them."""
_NEAR = 1e-2
"""m: a target that the rigid arm misses by no more may be in reach of the arm with effects."""
_SAME = 1e-3
"""rad: joint positions no further apart are one solution."""
_SETTLINGS = 12
"""Rounds in which directions and velocities follow the joint positions found."""


def reached(solved: Solved) -> Flags:
    """`(sample,)`, whether the errors are within `REACHED`."""
    return (solved.position_error <= REACHED[0]) & (solved.orientation_error <= REACHED[1])


@final
@dataclass(frozen=True, eq=False)
class CompensationSearch:
    """A model, targets without empty fields, joint limits.

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
        at = self.targets.made_anew(joint_position=q, position=None, quaternion=None)
        motion = self.model.motion_of(at)
        if self.approach is None:
            return motion
        direction = np.broadcast_to(np.array(self.approach, float)[:, None], q.T.shape)
        return motion._replace(direction=direction)  # type: ignore[arg-type]

    def solve(self, motion: Motion, rows: Rows, q: Array, **options: int) -> Solved:
        """From `q` `(start, joint)` for `rows` `(start,)`, each under the circumstances of its row in `motion`."""
        m, target = self.model, self._target(rows)
        return inverse.solve(
            m.physics, m.model, m.values, _at(motion, rows, q), m.inertia, target, self.limits, **options
        )

    def branches(self, start: Array | None) -> Array:
        """`(row, joint)`: for each row a solution, or the nearest found; on the branch of `start`, or a short path."""
        count, dof = self.targets.samples, self.model.dof
        everywhere = np.arange(count)
        given = np.zeros(count, bool) if start is None else np.asarray(np.isfinite(start).all(1))
        at = np.zeros((count, dof)) if start is None else np.where(given[:, None], start, 0.0)
        motion = self.motion(at)
        rows, found = everywhere[given], at[given]
        first = self.solve(motion, rows, found) if given.any() else None
        unsolved = ~given
        if first is not None:
            unsolved[rows] = ~reached(first)
        if not unsolved.any():
            assert first is not None
            return first.joint_position.T
        where: list[NDArray] = [rows]
        q, cost = [found if first is None else first.joint_position.T], [_cost(first)]
        for k, starts in enumerate(_STARTS):
            tried = np.repeat(everywhere[unsolved], starts)
            rigid, missed = self._rigid(motion, tried, self._random(len(tried), k), unlimited=k > 0)
            best = np.full(count, np.inf)
            np.minimum.at(best, tried, missed)
            kept = (missed < _NEAR**2) | (missed == best[tried])
            tried, rigid = _distinct(tried[kept], rigid[kept])
            solved = self.solve(motion, tried, rigid)
            where.append(tried)
            q.append(solved.joint_position.T)
            cost.append(solved.cost)
            unsolved[tried[reached(solved)]] = False
            if not unsolved.any():
                break
        usual = self._usual()
        return _least_motion(np.concatenate(where), np.concatenate(q), np.concatenate(cost), at, given, usual)

    def settled(self, q: Array) -> tuple[Solved, Flags]:
        """Solved until directions and velocities are those of the joint positions found; errors are of that motion.

        Also `(row,)`, where that does not converge: the direction in which a row is approached leads to joint positions
        that are approached from the other side.
        """
        rows = np.arange(len(q))
        motion = self.motion(q)
        solved = self.solve(motion, rows, q)
        for _ in range(_SETTLINGS):
            before, motion = motion, self.motion(solved.joint_position.T)
            changed = np.flatnonzero(self._differ(before, motion))
            if not changed.size:
                break
            again = self.solve(motion, changed, solved.joint_position.T[changed])
            for whole, part in zip(solved, again, strict=True):
                whole[..., changed] = part
        q = solved.joint_position.T
        evaluated = self._evaluated(q)
        return evaluated._replace(pressed=solved.pressed), reached(solved) & ~reached(evaluated)

    def _evaluated(self, q: Array) -> Solved:
        """The errors of the motion through joint positions `(row, joint)`; effects with memory see all of it."""
        motion, m = self.motion(q), self.model
        solved = self.solve(motion, np.arange(len(q)), q, steps=0)
        if not any(has_memory(effect) for effect in m.physics.effects):
            return solved
        poses = np.asarray(predict_poses(motion.chain, m.physics, m.model, m.values, motion, m.inertia))
        position, rotation = self._target(np.arange(len(q)))
        errors = np.linalg.norm(poses[:, :3, 3] - np.asarray(position).T, axis=1)
        turned = np.zeros(len(q))
        if rotation is not None:
            relative = np.einsum("jis,sjk->sik", np.asarray(rotation), poses[:, :3, :3])
            turned = Rotation.from_matrix(relative).magnitude()
        return solved._replace(position_error=errors, orientation_error=turned)

    def _target(self, rows: Rows) -> Target:
        assert self.targets.position is not None
        rotation = None
        if self.targets.quaternion is not None:
            R = np.asarray(_rotations(self.targets.quaternion))[rows]
            rotation = np.moveaxis(R, 0, -1)
        return Target(self.targets.position[rows].T, rotation)  # type: ignore[arg-type]

    def _rigid(self, motion: Motion, rows: Rows, q: Array, unlimited: bool) -> tuple[Array, Array]:
        """Where the arm without effects ends from `q` `(start, joint)`, and the squared errors `(start,)` in m².

        Without limits it does not stop at one of them; its joints are then returned by whole turns.
        """
        turns = ~np.isin(np.arange(self.model.dof), self.model.sliding)
        limits = np.where(turns[:, None] & unlimited, [-1e3, 1e3], self.limits)
        bare = (Physics(), self.model.model, np.zeros(0), _at(motion, rows, q), None, self._target(rows), limits)
        solved = inverse.solve(*bare, steps=_RIGID_STEPS)
        q = solved.joint_position.T
        whole = 2 * np.pi * np.round((q - self.limits.mean(1)) / (2 * np.pi))
        q = np.where(turns & unlimited, q - whole, q)
        inside = ((q >= self.limits[:, 0]) & (q <= self.limits[:, 1])).all(1)
        return np.clip(q, *self.limits.T), np.where(inside, solved.cost, 1.0 + solved.cost)

    def _differ(self, one: Motion, other: Motion) -> Flags:
        """`(row,)`, where two motions differ in what effects depend on and the joints' own movement determines."""
        differ = np.zeros(one.samples, bool)
        drivers = {driver.quantity for effect in self.model.physics.effects for driver in effect.drivers}
        for quantity, name, within in (("direction of motion", "direction", 0.0), ("velocity", "joint_velocity", 1e-9)):
            if quantity in drivers:
                change = np.abs(np.asarray(getattr(one, name)) - np.asarray(getattr(other, name)))
                differ |= (change > within).any(0)
        return differ

    def _random(self, count: int, seed: int) -> Array:
        lower, upper = (self._usual() if seed == 0 else self._middle_turn()).T
        lower, upper = np.where(lower < upper, (lower, upper), self.limits.T)  # limits beyond half a turn
        return np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))

    def _usual(self) -> Array:
        """`(joint, 2)`, the range that was recorded, where the model is known; without one `_middle_turn`."""
        known = self.model.uncertainty
        if known is None:
            return self._middle_turn()
        lower, upper = np.clip(known.recorded.joints.T, *self.limits.T)
        return np.stack([lower, upper], 1)

    def _middle_turn(self) -> Array:
        """`(joint, 2)`, the limits within half a turn of zero; of prismatic joints all of them."""
        slides = np.isin(np.arange(self.model.dof), self.model.sliding)[:, None]
        return np.where(slides, self.limits, np.clip(self.limits, -np.pi, np.pi))


_rotations = jax.jit(rotation_from_quaternion)


def _at(motion: Motion, rows: Rows, q: Array) -> Motion:
    """Samples of a motion at other joint positions `(row, joint)`."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[..., rows], motion)._replace(joint_position=q.T)


def _cost(solved: Solved | None) -> Array:
    return np.zeros(0) if solved is None else np.asarray(solved.cost)


def _distinct(rows: Rows, q: Array) -> tuple[Rows, Array]:
    """One of those that are the same joint positions for the same row."""
    key = np.column_stack([rows, np.round(q / _SAME / 4).astype(int)])
    _, first = np.unique(key, axis=0, return_index=True)
    return rows[first], q[first]


def _least_motion(rows: Rows, q: Array, cost: Array, start: Array, given: Flags, usual: Array) -> Array:
    """`(row, joint)`: of the solutions of each row the one on the path that moves the joints least, by squares.

    The shortest path through the rows (R. Bellman, 1957). Where a row has solutions in the usual range, it takes one of
    these. A row with joint positions given takes the solution nearest to them, and one without a solution the joint
    positions nearest to its target.

    Args:
        rows: `(candidate,)`, the row of each.
        q: `(candidate, joint)`.
        cost: `(candidate,)` m², its squared error.
        start: `(row, joint)`, the joint positions given.
        given: `(row,)`, whether they were.
        usual: `(joint, 2)`, the usual range, from whose middle the first row is approached.
    """
    order = np.argsort(rows, kind="stable")
    groups = np.split(order, np.searchsorted(rows[order], np.arange(1, len(start))))
    kept, inside = [], np.all((q >= usual[:, 0]) & (q <= usual[:, 1]), axis=1)
    for row, group in enumerate(groups):
        solutions = group[cost[group] < REACHED[0] ** 2]
        if not solutions.size:
            solutions = group[[np.argmin(cost[group])]]
        elif inside[solutions].any() and not given[row]:
            solutions = solutions[inside[solutions]]
        if given[row]:
            solutions = solutions[[np.argmin(np.abs(q[solutions] - start[row]).max(1))]]
        kept.append(solutions)
    length, before = np.sum((q[kept[0]] - usual.mean(1)) ** 2, 1), []
    for previous, here in pairwise(kept):
        steps = length[:, None] + np.sum((q[previous][:, None] - q[here]) ** 2, 2)
        before.append(np.argmin(steps, 0))
        length = np.min(steps, 0)
    at = int(np.argmin(length))
    path = [at]
    for predecessor in reversed(before):
        at = int(predecessor[at])
        path.append(at)
    return np.stack([q[group[at]] for group, at in zip(kept, reversed(path), strict=True)])
