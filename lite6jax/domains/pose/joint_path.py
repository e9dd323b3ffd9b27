"""Joint positions of an arm whose recording holds only the poses of its flange, by its nominal kinematics.

A controller computes its pose from the joints, so the joints follow from the pose but for the branch: shoulder left or
right, elbow up or down, wrist flipped or not. One branch is taken at the first row and kept from row to row.
"""

from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.domains.pose.inverse import Solved, Target, solve
from lite6jax.effects.composition import Physics
from lite6jax.effects.motion import motion_of
from lite6jax.model import arm_model

Array = NDArray[np.floating]
Flags = NDArray[np.bool_]
Rows = NDArray[np.integer]

REACHED = (2e-4, 1e-3)
"""m and rad: poses as controllers write them are rounded to 0.1 mm and 0.001 rad."""
_STARTS = 192
"""Random joint positions from which the branches of the first row are found."""
_STEPS = 40
_SAME = 1e-2
"""rad: joint positions no further apart are one branch."""
_TOGETHER = 64
"""Rows that are solved by one compiled function, all from the joints of one row before them, …"""
_NEAR = (0.05, 0.15)
"""… where their poses differ from its by no more, in m and rad."""
_JUMP = 0.5
"""rad: a row that is further than this from one with nearly the same pose has left the branch."""
_FOLLOWED = 0.9
"""Share of the rows that a branch has to reach, to be taken."""


class JointPath(NamedTuple):
    """Joint positions along poses.

    Attributes:
        position: `(row, joint)` in rad, or m; NaN where the pose is not reached on the branch.
        reached: `(row,)` bool.
        branches: how many were found at the first row.
    """

    position: Array
    reached: Flags
    branches: int


def joint_path(arm: Arm, position: Array, quaternion: Array) -> JointPath | None:
    """The joints of a nominal arm along poses of its flange in its base; None where no branch follows them.

    Args:
        arm: the nominal arm.
        position: `(row, 3)` m.
        quaternion: `(row, 4)` unit, scalar first.
    """
    from scipy.spatial.transform import Rotation

    rows = np.flatnonzero(np.isfinite(position).all(axis=1) & np.isfinite(quaternion).all(axis=1))
    if not rows.size:
        return None
    R = Rotation.from_quat(quaternion[rows], scalar_first=True)
    poses = _Poses(arm, position[rows], R.as_matrix())
    middle = np.where(arm.slides, arm.joint_limits.mean(1), np.clip(arm.joint_limits.mean(1), -np.pi, np.pi))
    branches = _branches(poses, middle)
    turned = np.concatenate([[0.0], (R[:-1].inv() * R[1:]).magnitude()])
    moved = np.concatenate([[0.0], np.linalg.norm(np.diff(position[rows], axis=0), axis=1)])
    for start in branches:
        q, reached = _followed(poses, start, moved, turned)
        if reached.mean() >= _FOLLOWED:
            found, there = np.full((len(position), arm.dof), np.nan), np.zeros(len(position), bool)
            found[rows[reached]], there[rows[reached]] = q[reached], True
            return JointPath(found, there, len(branches))
    return None


class _Poses(NamedTuple):
    arm: Arm
    position: Array
    rotation: Array

    def solved(self, rows: Rows, start: Array) -> tuple[Array, Flags]:
        """`(row, joint)` from joints `(row, joint)`, and whether the poses of the rows are reached."""
        model = arm_model(self.arm.kinematics.ravel(), T_flange_tool=self.arm.T_joint_flange)
        motion = jax.tree.map(np.asarray, motion_of(start, sliding=self.arm.sliding))
        target = Target(self.position[rows].T, np.moveaxis(self.rotation[rows], 0, -1))  # type: ignore[arg-type]
        found: Solved = solve(Physics(), model, np.zeros(0), motion, None, target, self.arm.joint_limits, _STEPS)
        reached = (found.position_error <= REACHED[0]) & (found.orientation_error <= REACHED[1])
        return found.joint_position.T, np.asarray(reached)


def _branches(poses: _Poses, middle: Array) -> Array:
    """`(branch, joint)` of the first row, the nearest to the middle of the limits first."""
    arm = poses.arm
    limits = np.where(arm.slides[:, None], arm.joint_limits, np.clip(arm.joint_limits, -np.pi, np.pi))
    starts = np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], (_STARTS, arm.dof))
    parts = [poses.solved(np.zeros(len(part), int), part) for part in np.split(starts, _STARTS // _TOGETHER)]
    ends = np.concatenate([q[reached] for q, reached in parts])
    found: list[Array] = []
    for one in sorted(ends, key=lambda one: float(np.sum((one - middle) ** 2))):
        turns = 2 * np.pi * ~arm.slides
        apart = [
            np.abs((one - other + turns / 2) % np.where(turns, turns, np.inf) - turns / 2).max() for other in found
        ]
        if min(apart, default=np.inf) > _SAME:
            found.append(one)
    return np.array(found).reshape(-1, arm.dof)


def _followed(poses: _Poses, start: Array, moved: Array, turned: Array) -> tuple[Array, Flags]:
    """`(row, joint)` from the joints of the first row on, and where the poses are reached without a jump."""
    count = len(moved)
    q, reached = np.zeros((count, len(start))), np.zeros(count, bool)
    last, first = start, 0
    while first < count:
        way = np.cumsum(moved[first + 1 : first + _TOGETHER]), np.cumsum(turned[first + 1 : first + _TOGETHER])
        together = 1 + int(np.sum((way[0] <= _NEAR[0]) & (way[1] <= _NEAR[1])))
        rows = np.arange(first, first + together)
        q[rows], reached[rows] = poses.solved(rows, np.tile(last, (together, 1)))
        reached[rows[1:]] &= np.abs(q[rows[1:]] - last).max(1) <= _JUMP
        there = rows[reached[rows]]
        last = q[there[-1]] if there.size else last
        first += together
    return q, reached
