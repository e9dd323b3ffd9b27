"""The clearance between the links of an arm: distances between the capsules around them, and which pairs to test."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike
from numpy import typing as npt

from lite6jax.arms.arm import Arm, sample_joints
from lite6jax.arms.moves import cross, joint_turn
from lite6jax.design.capsules import Capsule, chain_capsules
from lite6jax.recordings import require_radians

ALWAYS = 0.95
"""A pair that overlaps in more than this share of poses overlaps by construction (MoveIt's setup assistant does so)."""
_SAMPLES = 2048
_BLOCK = 4096


@final
@dataclass(frozen=True, eq=False)
class SelfCollision:
    """The capsules of an arm and the pairs of them that must stay apart.

    Attributes:
        arm: whose joints move the capsules.
        capsules: one or more on each link that has a shape.
        pairs: `(pair, 2)` capsules; never those of one link or of neighbours.
        disabled: the names of the pairs that overlap in nearly every pose and are not tested.
    """

    arm: Arm
    capsules: tuple[Capsule, ...]
    pairs: npt.NDArray[np.integer]
    disabled: tuple[tuple[str, str], ...]

    def clearance(self, joint_position: npt.ArrayLike) -> npt.NDArray[np.floating]:
        """The least distance between the surfaces of any pair, m, `(sample,)`: negative where they overlap.

        Args:
            joint_position: `(sample, joint)` rad.
        """
        q = np.asarray(joint_position, float)
        if len(self.pairs) == 0:
            return np.full(len(q), np.inf)
        return _pair_clearances(self.arm, self.capsules, self.pairs, q).min(0)


def self_collision(arm: Arm, capsules: Sequence[Capsule] | None = None) -> SelfCollision:
    """What must be apart on an arm: all pairs of links but neighbours, and but those that overlap nearly always.

    Args:
        arm: whose limits say which poses there are.
        capsules: `chain_capsules` if not given.
    """
    capsules = tuple(chain_capsules(arm) if capsules is None else capsules)
    pairs = [
        (i, j)
        for i, a in enumerate(capsules)
        for j, b in enumerate(capsules[:i])
        if abs(a.link - b.link) > 1 and a.radius + b.radius > 0
    ]
    if not pairs:
        return SelfCollision(arm, capsules, np.zeros((0, 2), np.int64), ())
    lower, upper = arm.joint_limits.T
    q = lower + (upper - lower) * (sample_joints(arm.dof, _SAMPLES) / (2 * np.pi) + 0.5)
    overlapping = np.mean(_pair_clearances(arm, capsules, np.array(pairs), q) < 0, axis=1)
    always = overlapping > ALWAYS
    disabled = tuple((capsules[j].name, capsules[i].name) for (i, j), off in zip(pairs, always, strict=True) if off)
    return SelfCollision(arm, capsules, np.array(pairs)[~always], disabled)


def link_frames(arm: Arm, joint_position: npt.ArrayLike) -> npt.NDArray[np.floating]:
    """The frames after each joint's rotation, and the flange's: `T_base_link` `(joint + 1, 3, 4, sample)`.

    Args:
        arm: the chain.
        joint_position: `(sample, joint)` rad.

    Raises:
        InputError: joint positions in degrees.
    """
    require_radians(joint_position, arm.joint_limits)
    F = _in_blocks(lambda q: _frames(arm.links, q, arm.sliding), joint_position)[1:]
    T = arm.T_joint_flange
    flange = np.einsum("ijs,jk->iks", F[-1][:, :3], T[:3])
    flange[:, 3] += F[-1][:, 3]
    return np.concatenate([F, flange[None]])


def segment_distance(p1: ArrayLike, q1: ArrayLike, p2: ArrayLike, q2: ArrayLike) -> Array:
    """The distance between segments p1 q1 and p2 q2; each end `(3, …)`, points and parallels included.

    The least of what each end is from the other segment and, where the common perpendicular of the lines meets both
    segments, of its length (C. Ericson, Real-Time Collision Detection, 2005, 5.1.9, its cases taken at once). Lines
    within 1 µrad of parallel are left to their ends: nothing is divided by what rounding made.
    """
    p1, q1, p2, q2 = (jnp.asarray(p) for p in (p1, q1, p2, q2))
    d1, d2, between = q1 - p1, q2 - p2, p2 - p1
    a, e, n = jnp.sum(d1 * d1, 0), jnp.sum(d2 * d2, 0), cross(d1, d2)
    n2 = jnp.sum(n * n, 0)
    oblique = n2 > 1e-12 * a * e
    safe = jnp.where(oblique, n2, 1.0)
    s, t = (jnp.sum(cross(between, d) * n, 0) / safe for d in (d2, d1))
    meets = oblique & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    squares = [jnp.where(meets, jnp.sum(between * n, 0) ** 2 / safe, jnp.inf)]
    for p, start, d, length2 in ((p1, p2, d2, e), (q1, p2, d2, e), (p2, p1, d1, a), (q2, p1, d1, a)):
        to = p - start
        along = jnp.clip(jnp.sum(to * d, 0) / jnp.where(length2 > 0, length2, 1.0), 0.0, 1.0)
        squares.append(jnp.sum((to - along * d) ** 2, 0))
    return jnp.sqrt(jnp.min(jnp.stack(squares), 0))


@partial(jax.jit, static_argnums=2)
def _frames(links: ArrayLike, q: ArrayLike, sliding: tuple[int, ...]) -> Array:
    """The base's frame and those after each joint, `(joint + 1, 3, 4, sample)`, of `(joint, sample)` rad or m."""
    links, q = jnp.asarray(links), jnp.asarray(q)
    count, samples = q.shape
    cos, sin, shift = joint_turn(q, sliding)
    first = jnp.broadcast_to(jnp.eye(3, 4)[:, :, None], (3, 4, samples))

    def body(i: Array, collected: Array) -> Array:
        F, L = collected[i], links[i]
        x, y, z, origin = (sum(F[:, j] * L[j, k] for j in range(3)) for k in range(4))
        origin = origin if shift is None else origin + shift[i] * z
        turned = jnp.stack([cos[i] * x + sin[i] * y, cos[i] * y - sin[i] * x, z, F[:, 3] + origin], 1)
        return collected.at[i + 1].set(turned)

    return lax.fori_loop(0, count, body, jnp.zeros((count + 1, 3, 4, samples)).at[0].set(first))


def _in_blocks(
    function: Callable[[npt.NDArray[np.floating]], Array], joint_position: npt.ArrayLike
) -> npt.NDArray[np.floating]:
    """A jitted function of `(joint, block)`, over samples `(sample, joint)`: one shape, so that it is compiled once."""
    q = np.asarray(joint_position, float)
    count = len(q)
    padded = np.zeros((q.shape[1], max(-(-count // _BLOCK), 1) * _BLOCK))
    padded[:, :count] = q.T
    found = [np.asarray(function(padded[:, i : i + _BLOCK])) for i in range(0, padded.shape[1], _BLOCK)]
    return np.concatenate(found, -1)[..., :count]


def _pair_clearances(
    arm: Arm, capsules: Sequence[Capsule], pairs: npt.NDArray[np.integer], q: npt.ArrayLike
) -> npt.NDArray[np.floating]:
    """Each pair's distance of surfaces, m, `(pair, sample)`."""
    carriers = np.array([capsule.link for capsule in capsules])
    segments = np.array([[capsule.start, capsule.end] for capsule in capsules], float)
    radii = np.array([capsule.radius for capsule in capsules], float)[pairs].sum(1)
    return _in_blocks(lambda block: _clearances(arm.sliding, arm.links, carriers, segments, radii, pairs, block), q)


@partial(jax.jit, static_argnums=0)
def _clearances(
    sliding: tuple[int, ...],
    links: ArrayLike,
    carriers: ArrayLike,
    segments: ArrayLike,
    radii: ArrayLike,
    pairs: ArrayLike,
    q: ArrayLike,
) -> Array:
    """The distance of each pair's surfaces, `(pair, sample)`, of `(joint, sample)` rad or m."""
    segments = jnp.asarray(segments)
    F = _frames(links, q, sliding)[carriers]
    ends = jnp.sum(F[:, None, :, :3] * segments[:, :, None, :, None], 3) + F[:, None, :, 3]

    def of_pair(both: tuple[Array, Array]) -> Array:
        pair, radius = both
        (p1, q1), (p2, q2) = ends[pair[0]], ends[pair[1]]
        return segment_distance(p1, q1, p2, q2) - radius

    return lax.map(of_pair, (jnp.asarray(pairs), jnp.asarray(radii)))
