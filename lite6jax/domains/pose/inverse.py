"""Joint positions at which an arm with effects reaches given poses: damped least squares within limits, batched.

A controller computes its pose from the joints, so the joints of a recording of poses alone follow from these but for
the branch: shoulder left or right, elbow up or down, wrist flipped or not. `joint_path` takes one at the first row and
keeps it from row to row.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.se3 import rotation_log_components
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.effects.composition import Physics
from lite6jax.effects.motion import Motion, Sliding
from lite6jax.effects.statics import Inertia
from lite6jax.levenberg_marquardt import Linearised, minimise
from lite6jax.model import LEVER, ArmModel, arm_model, predict_frames_with

STEPS = 300
"""Steps that a row next to a singular position takes; `_MOST_NEED` suffice nearly everywhere."""
_MOST_NEED = 16
_CHUNKS = (64, 1024)
"""Rows solved together, few or many: two compiled functions serve any number, and Jacobians stay in cache."""
_FINE = 1e-11
"""m: an error below this is rounding."""
_CREEPING = 1e-8
"""Relative decrease of the cost below which a step is the last."""
_LONGEST = 0.5
"""rad, the longest step of a joint."""
_RIGID_STEPS = 40
"""Steps of the arm without effects, from where little is known."""
_TRIES = 12
"""Starts from which a target is sought."""
REACHED = 1e-7
"""m, and rad at `LEVER`: a target that is missed by less is reached."""

_WRITTEN = (2e-4, 1e-3)
"""m and rad: poses as controllers write them are rounded to 0.1 mm and 0.001 rad."""
_STARTS = 192
"""Random joint positions from which the branches of the first row are found."""
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


class Target(NamedTuple):
    """Poses to be reached, the sample last.

    Attributes:
        position: `(3, sample)` m, sensor frame.
        rotation: `(3, 3, sample)`, the tool's axes in the sensor's frame as columns; None where any will do.
    """

    position: jax.Array
    rotation: jax.Array | None


class InverseSolution(NamedTuple):
    """Joint positions found; NumPy arrays outside of jitted functions.

    Attributes:
        joint_position: `(joint, sample)` rad, inside the limits.
        position_error: `(sample,)` m.
        orientation_error: `(sample,)` rad; zero where any orientation will do.
        pressed: `(joint, sample)`, joints at a limit beyond which the error would decrease.
        ended: `(sample,)`, whether it converged.
    """

    joint_position: Any
    position_error: Any
    orientation_error: Any
    pressed: Any
    ended: Any

    @property
    def cost(self) -> Array:
        """`(sample,)` m²."""
        return self.position_error**2 + (LEVER * self.orientation_error) ** 2


def solve(
    physics: Physics,
    model: ArmModel,
    values: np.ndarray,
    motion: Motion,
    inertia: Inertia | None,
    target: Target,
    limits: np.ndarray,
    steps: int = STEPS,
) -> InverseSolution:
    """Joint positions, from those of `motion`, at which the sensor shows `target`, or with the smallest error.

    Levenberg–Marquardt for each sample by itself, with exact derivatives and projection into the limits (C. Kanzow,
    N. Yamashita, M. Fukushima, J. Comput. Appl. Math. 172, 2004): a joint at a limit that would have to go beyond is
    held. Velocity, direction, time, load and temperature stay those of `motion`.

    Args:
        physics: without effects of a whole sequence.
        model: the rigid arm.
        values: `(physics.size,)`.
        motion: the start, and everything that effects depend on.
        inertia: the masses, or None where no effect needs them.
        target: the poses, as many samples.
        limits: `(joint, 2)` rad.
        steps: the most; with zero the joint positions stay, and their errors are evaluated.

    Raises:
        InputError: as `predict_frames_with`.
    """

    def solve_rows(start: Motion, rows: np.ndarray, steps: int) -> InverseSolution:
        size = next(size for size in _CHUNKS if size >= min(len(rows), _CHUNKS[-1]))
        parts = []
        for first in range(0, len(rows), size):
            chunk = rows[np.minimum(np.arange(first, first + size), len(rows) - 1)]  # the last fills it
            picked, goal = jax.tree.map(lambda leaf, chunk=chunk: np.asarray(leaf)[..., chunk], (start, target))
            alone = picked._replace(run=np.tile(np.arange(size), (2, 1)))
            parts.append(_solve(start.chain, physics, model, values, alone, inertia, goal, limits, steps))
        return InverseSolution(*(np.concatenate(leaves, -1)[..., : len(rows)] for leaves in zip(*parts, strict=True)))  # type: ignore[arg-type]

    solved = solve_rows(motion, np.arange(motion.samples), min(steps, _MOST_NEED))
    if steps > _MOST_NEED and not solved.ended.all():  # only those continue
        rows = np.flatnonzero(~solved.ended)
        onward = motion._replace(joint_position=solved.joint_position)  # type: ignore[arg-type]
        later = solve_rows(onward, rows, steps - _MOST_NEED)
        for full, part in zip(solved, later, strict=True):
            full[..., rows] = part
    return solved


def solve_rigid(
    model: ArmModel,
    target: Target,
    start: Array,
    limits: Array,
    sliding: Sequence[int],
    steps: int = _RIGID_STEPS,
) -> InverseSolution:
    """As `solve`, of the arm without effects, whose joints `sliding` are prismatic, from `start` `(sample, joint)`."""
    count = len(start)
    motion = Motion(start.T, None, None, None, np.zeros((2, count), int), None, np.zeros(count))  # type: ignore[arg-type]
    motion = motion._replace(sliding=Sliding(tuple(sliding)))
    return solve(Physics(), model, np.zeros(0), motion, None, target, limits, steps)


def reach(
    model: ArmModel,
    target: Target,
    start: Array,
    limits: Array,
    sliding: Sequence[int],
    rng: np.random.Generator,
) -> tuple[Array, Mask]:
    """Joint positions at which the rigid arm reaches targets, from a start and then from others inside its limits.

    Args:
        model: its chain, of six parameters, with the sensor's frame and the tool.
        target: the poses.
        start: `(sample, joint)` rad.
        limits: `(joint, 2)` rad.
        sliding: the prismatic joints, counted from 0.
        rng: draws the other starts.

    Returns:
        `(sample, joint)`, the start where none leads there, and where that succeeded `(sample,)`.
    """
    lower, upper = limits.T
    q = start.copy()
    reached = np.zeros(len(start), bool)
    for attempt in range(_TRIES):
        rows = np.flatnonzero(~reached)
        if not rows.size:
            break
        guess = q[rows] if attempt == 0 else rng.uniform(lower, upper, (len(rows), len(limits)))
        goal = Target(*(None if part is None else np.asarray(part)[..., rows] for part in target))  # type: ignore[arg-type]
        solved = solve_rigid(model, goal, guess, limits, sliding, _MOST_NEED)
        succeeded = (solved.cost < REACHED**2) & ~solved.pressed.any(0)
        q[rows[succeeded]] = solved.joint_position.T[succeeded]
        reached[rows[succeeded]] = True
    return q, reached


_Reached = tuple[Array, Mask]
"""Joint positions `(row, joint)`, and whether they reach the poses of the rows."""
_Solve = Callable[[Integers, Array], _Reached]


class JointPath(NamedTuple):
    """Joint positions along poses.

    Attributes:
        position: `(row, joint)` in rad, or m; NaN where the pose is not reached on the branch.
        reached: `(row,)` bool.
        branches: how many were found at the first row.
    """

    position: Array
    reached: Mask
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
    p = position[rows]
    solved = _solver(arm, p, R.as_matrix())
    turned = np.concatenate([[0.0], (R[:-1].inv() * R[1:]).magnitude()])
    moved = np.concatenate([[0.0], np.linalg.norm(np.diff(p, axis=0), axis=1)])
    branches = _branches(arm, solved)
    for start in branches:
        q, reached = _followed(solved, start, moved, turned)
        if reached.mean() >= _FOLLOWED:
            joints = np.full((len(position), arm.dof), np.nan)
            followed = np.zeros(len(position), bool)
            joints[rows[reached]] = q[reached]
            followed[rows[reached]] = True
            return JointPath(joints, followed, len(branches))
    return None


def capture_joints(arm: Arm, position: Array, quaternion: Array) -> JointPath | None:
    """The joints of a nominal arm at poses between which it moved far; None where most are not reached.

    Each pose is solved from many joints. Of what reaches it, the nearest to the joints at the row before is taken, and
    at the first row the nearest to the middle of the limits. Arguments as of `joint_path`.
    """
    from scipy.spatial.transform import Rotation

    rows = np.flatnonzero(np.isfinite(position).all(axis=1) & np.isfinite(quaternion).all(axis=1))
    if not rows.size:
        return None
    solved = _solver(arm, position[rows], Rotation.from_quat(quaternion[rows], scalar_first=True).as_matrix())
    indices = np.arange(len(rows))
    ends = [solved(indices, np.tile(start, (len(rows), 1))) for start in _starts(arm)]
    q = np.stack([joints for joints, _ in ends], 1)
    reached = np.stack([mask for _, mask in ends], 1)
    if reached.any(1).mean() < _FOLLOWED:
        return None
    last = arm.joint_limits.mean(1)
    joints = np.full((len(position), arm.dof), np.nan)
    solvable = np.zeros(len(position), bool)
    for k in np.flatnonzero(reached.any(1)):
        candidates = q[k, reached[k]]
        last = candidates[np.argmin(np.sum((candidates - last) ** 2, 1))]
        joints[rows[k]] = last
        solvable[rows[k]] = True
    first = q[np.argmax(reached.any(1))][reached[np.argmax(reached.any(1))]]
    circle = np.where(arm.slides, first, np.exp(1j * first))  # whole turns are one branch
    return JointPath(joints, solvable, len(np.unique(np.round(circle, 1), axis=0)))


def _solver(arm: Arm, position: Array, matrices: Array) -> _Solve:
    """What solves some of the poses of a nominal arm's flange from given joints."""
    model = arm_model(arm.kinematics.ravel(), T_flange_tool=arm.T_joint_flange)

    def solved(chosen: Integers, start: Array) -> _Reached:
        target = Target(position[chosen].T, np.moveaxis(matrices[chosen], 0, -1))  # type: ignore[arg-type]
        solution = solve_rigid(model, target, start, arm.joint_limits, arm.sliding)
        reached = (solution.position_error <= _WRITTEN[0]) & (solution.orientation_error <= _WRITTEN[1])
        return solution.joint_position.T, np.asarray(reached)

    return solved


def _starts(arm: Arm) -> Array:
    """`(start, joint)`, all over the limits."""
    limits = np.where(arm.slides[:, None], arm.joint_limits, np.clip(arm.joint_limits, -np.pi, np.pi))
    return np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], (_STARTS, arm.dof))


def _branches(arm: Arm, solved: _Solve) -> list[Array]:
    """The joints `(joint,)` at the first row, the nearest to the middle of the limits first."""
    middle = np.where(arm.slides, arm.joint_limits.mean(1), np.clip(arm.joint_limits.mean(1), -np.pi, np.pi))
    starts = _starts(arm)
    parts = [solved(np.zeros(len(part), int), part) for part in np.split(starts, _STARTS // _TOGETHER)]
    ends = np.concatenate([q[reached] for q, reached in parts])
    turn = np.where(arm.slides, 0.0, 2 * np.pi)
    branches = []
    for end in sorted(ends, key=lambda end: float(np.sum((end - middle) ** 2))):
        apart = (end - branch for branch in branches)
        if all(np.abs(d - turn * np.round(d / (2 * np.pi))).max() > _SAME for d in apart):
            branches.append(end)
    return branches


def _followed(solved: _Solve, start: Array, moved: Array, turned: Array) -> _Reached:
    """`(row, joint)` from the joints of the first row on, and where the poses are reached without a jump."""
    count = len(moved)
    q = np.zeros((count, len(start)))
    reached = np.zeros(count, bool)
    last = start
    first = 0
    while first < count:
        travelled = np.cumsum(moved[first + 1 : first + _TOGETHER]), np.cumsum(turned[first + 1 : first + _TOGETHER])
        together = 1 + int(np.sum((travelled[0] <= _NEAR[0]) & (travelled[1] <= _NEAR[1])))
        rows = np.arange(first, first + together)
        q[rows], reached[rows] = solved(rows, np.tile(last, (together, 1)))
        reached[rows[1:]] &= np.abs(q[rows[1:]] - last).max(1) <= _JUMP
        arrived = rows[reached[rows]]
        if arrived.size:
            last = q[arrived[-1]]
        first += together
    return q, reached


@partial(jax.jit, static_argnums=(0, 1))
def _solve(
    chain: SixParameterForm,
    physics: Physics,
    model: ArmModel,
    values: jax.Array,
    motion: Motion,
    inertia: Inertia | None,
    target: Target,
    limits: jax.Array,
    steps: ArrayLike,
) -> InverseSolution:
    lower = limits[:, :1]
    upper = limits[:, 1:]
    eye = jnp.eye(motion.dof)[:, :, None]

    def residual(q: jax.Array) -> jax.Array:
        at = motion._replace(joint_position=q)
        _, tool = predict_frames_with(chain, physics, model, values, at, inertia)
        missed = tool.origin - target.position
        if target.rotation is None:
            return missed
        axes = (tool.x, tool.y, tool.z)
        relative = [[jnp.sum(target.rotation[:, i] * axes[j], 0) for j in range(3)] for i in range(3)]
        return jnp.concatenate([missed, LEVER * jnp.stack(rotation_log_components(relative))])

    def linearise(q: jax.Array) -> Linearised:
        directions = jnp.broadcast_to(eye, (motion.dof, *q.shape))
        r, J = jax.vmap(lambda along: jax.jvp(residual, (q,), (along,)), out_axes=(None, 0))(directions)
        gradient = jnp.sum(J * r, 1)
        pressed = ((q <= lower) & (gradient > 0)) | ((q >= upper) & (gradient < 0))
        free = 1.0 - pressed
        curvature = jnp.sum(J[:, None] * J, 2) * free * free[:, None] + eye * (1 - free)
        return Linearised(jnp.sum(r**2, 0), gradient * free, curvature, jnp.ones_like(q), (r, pressed))

    def advance(q: jax.Array, step: jax.Array) -> jax.Array:
        shortened = step * (_LONGEST / jnp.maximum(jnp.abs(step).max(0), _LONGEST))
        return jnp.clip(q + shortened, lower, upper)

    start = jnp.clip(motion.joint_position, lower, upper)
    minimum = minimise(linearise, advance, start, steps, _FINE**2, _CREEPING)
    missed, pressed = minimum.linearised.detail
    position_error = jnp.sqrt(jnp.sum(missed[:3] ** 2, 0))
    orientation_error = jnp.sqrt(jnp.sum(missed[3:] ** 2, 0)) / LEVER
    return InverseSolution(minimum.numbers, position_error, orientation_error, pressed, minimum.ended)
