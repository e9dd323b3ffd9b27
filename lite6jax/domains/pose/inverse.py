"""Joint positions at which an arm with effects reaches given poses: damped least squares within limits, batched."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike
from numpy.typing import NDArray

from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.se3 import rotation_log_components
from lite6jax.effects.composition import Physics
from lite6jax.effects.motion import Motion, Sliding
from lite6jax.effects.statics import Inertia
from lite6jax.model import LEVER, ArmModel, predict_frames_with

STEPS = 300
"""Steps that a row next to a singular position takes; `_MOST_NEED` suffice nearly everywhere."""
_MOST_NEED = 16
_CHUNKS = (64, 1024)
"""Rows solved together, few or many: two compiled functions serve any number, and Jacobians stay in cache."""
_FINE = 1e-11
"""m: an error below this is rounding, …"""
_STILL = 1e-12
"""… and a step below this, in rad, is rounding."""
_CREEPING = 1e-8
"""Relative decrease of the cost below which a step is the last."""
_LONGEST = 0.5
"""rad, the longest step of a joint."""
_TRIES = 12
"""Starts from which a target is sought."""
REACHED = 1e-7
"""m, and rad at `LEVER`: a target that is missed by less is reached."""


class Target(NamedTuple):
    """Poses to be reached, the sample last.

    Attributes:
        position: `(3, sample)` m, sensor frame.
        rotation: `(3, 3, sample)`, the tool's axes in the sensor's frame as columns; None where any will do.
    """

    position: Array
    rotation: Array | None


class Solved(NamedTuple):
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
    def cost(self) -> NDArray[np.floating]:
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
) -> Solved:
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

    def solve_rows(start: Motion, rows: np.ndarray, steps: int) -> Solved:
        size = next(size for size in _CHUNKS if size >= min(len(rows), _CHUNKS[-1]))
        parts = []
        for first in range(0, len(rows), size):
            chunk = rows[np.minimum(np.arange(first, first + size), len(rows) - 1)]  # the last fills it
            picked, wanted = jax.tree.map(lambda leaf, chunk=chunk: np.asarray(leaf)[..., chunk], (start, target))
            alone = picked._replace(run=np.tile(np.arange(size), (2, 1)))
            parts.append(_solve(start.chain, physics, model, values, alone, inertia, wanted, limits, steps))
        return Solved(*(np.concatenate(leaves, -1)[..., : len(rows)] for leaves in zip(*parts, strict=True)))  # type: ignore[arg-type]

    found = solve_rows(motion, np.arange(motion.samples), min(steps, _MOST_NEED))
    if steps > _MOST_NEED and not found.ended.all():  # only those continue
        rows = np.flatnonzero(~found.ended)
        onward = motion._replace(joint_position=found.joint_position)  # type: ignore[arg-type]
        later = solve_rows(onward, rows, steps - _MOST_NEED)
        for whole, part in zip(found, later, strict=True):
            whole[..., rows] = part
    return found


def reach(
    model: ArmModel,
    target: Target,
    start: NDArray[np.floating],
    limits: NDArray[np.floating],
    sliding: Sequence[int],
    rng: np.random.Generator,
) -> tuple[NDArray[np.floating], NDArray[np.bool_]]:
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
    q, reached = start.copy(), np.zeros(len(start), bool)
    for attempt in range(_TRIES):
        rows = np.flatnonzero(~reached)
        if not rows.size:
            break
        trial = q[rows] if attempt == 0 else rng.uniform(lower, upper, (len(rows), len(limits)))
        at: Any = trial.T
        still = Motion(at, None, None, None, np.zeros((2, len(rows)), int), None, np.zeros(len(rows)))  # type: ignore[arg-type]
        still = still._replace(sliding=Sliding(tuple(sliding)))
        own = Target(*(None if part is None else np.asarray(part)[..., rows] for part in target))  # type: ignore[arg-type]
        found = solve(Physics(()), model, np.zeros(0), still, None, own, limits, _MOST_NEED)
        there = (found.cost < REACHED**2) & ~found.pressed.any(0)
        q[rows[there]], reached[rows[there]] = found.joint_position.T[there], True
    return q, reached


class _State(NamedTuple):
    """Each sample's joints and where to try next; normal equations, residual, cost; damping, and whether it is done."""

    joints: Array
    trial: Array
    curvature: Array
    gradient: Array
    missed: Array
    cost: Array
    damping: Array
    done: Array
    step: Array


@partial(jax.jit, static_argnums=(0, 1))
def _solve(
    chain: SixParameterForm,
    physics: Physics,
    model: ArmModel,
    values: Array,
    motion: Motion,
    inertia: Inertia | None,
    target: Target,
    limits: Array,
    steps: ArrayLike,
) -> Solved:
    dof = motion.dof
    lower, upper = limits[:, :1], limits[:, 1:]

    def residual(q: Array) -> Array:
        at = motion._replace(joint_position=q)
        _, tool = predict_frames_with(chain, physics, model, values, at, inertia)
        missed = tool.origin - target.position
        if target.rotation is None:
            return missed
        axes = (tool.x, tool.y, tool.z)
        relative = [[jnp.sum(target.rotation[:, i] * axes[j], 0) for j in range(3)] for i in range(3)]
        return jnp.concatenate([missed, LEVER * jnp.stack(rotation_log_components(relative))])

    def normal(q: Array) -> tuple[Array, Array, Array]:
        directions = jnp.broadcast_to(jnp.eye(dof)[:, :, None], (dof, *q.shape))
        r, J = jax.vmap(lambda along: jax.jvp(residual, (q,), (along,)), out_axes=(None, 0))(directions)
        return jnp.sum(J[:, None] * J, 2), jnp.sum(J * r, 1), r

    def held(q: Array, gradient: Array) -> Array:
        return ((q <= lower) & (gradient > 0)) | ((q >= upper) & (gradient < 0))

    def improve(state: _State) -> _State:
        new = normal(state.trial)
        cost = jnp.sum(new[2] ** 2, 0)
        better = cost < state.cost
        now, before = (state.trial, *new, cost), (state.joints, *state[2:6])
        q, H, g, r, least = (jnp.where(better, a, b) for a, b in zip(now, before, strict=True))
        damping = jnp.clip(jnp.where(better, state.damping / 8, state.damping * 4), 1e-14, 1e4)
        free = 1.0 - held(q, g)
        move = _solve_spd(H * free * free[:, None] + eye * (damping + (1 - free)), -g * free)
        move = move * jnp.minimum(1.0, _LONGEST / jnp.maximum(jnp.abs(move).max(0), _STILL))
        trial = jnp.clip(q + move, lower, upper)
        crept = better & (state.cost - cost < _CREEPING * cost)
        done = state.done | crept | (least < _FINE**2) | (jnp.abs(trial - q).max(0) < _STILL)
        return _State(q, jnp.where(done, q, trial), H, g, r, least, damping, done, state.step + 1)

    eye = jnp.eye(dof)[:, :, None]
    start = jnp.clip(motion.joint_position, lower, upper)
    samples, rows = start.shape[1], 3 if target.rotation is None else 6
    nowhere, undone = jnp.full(samples, jnp.inf), jnp.zeros(samples, bool)
    flat, none, unmet = (jnp.zeros((*shape, samples)) for shape in ((dof, dof), (dof,), (rows,)))
    damping = jnp.full(samples, 1e-3)
    state = _State(start, start, flat, none, unmet, nowhere, damping, undone, jnp.zeros((), int))
    state = lax.while_loop(lambda s: (s.step <= steps) & ~s.done.all(), improve, state)
    return Solved(
        state.joints,
        jnp.sqrt(jnp.sum(state.missed[:3] ** 2, 0)),
        jnp.sqrt(jnp.sum(state.missed[3:] ** 2, 0)) / LEVER,
        held(state.joints, state.gradient),
        state.done,
    )


def _solve_spd(A: Array, b: Array) -> Array:
    """x `(n, sample)` with A x = b for positive definite `(n, n, sample)`: elimination without pivots, unrolled."""
    system = jnp.concatenate([A, b[:, None]], 1)
    for k in range(len(b)):
        row = system[k] / system[k, k]
        system = (system - system[:, k, None] * row).at[k].set(row)
    return system[:, -1]
