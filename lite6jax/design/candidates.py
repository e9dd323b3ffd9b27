"""Joint positions among which a design may choose: inside the limits, clear of the arm itself, and as filters allow.

Distances between links, capsules around the chain, are array code of NumPy and of JAX alike: filters take them of many
poses, and designs of motions with their gradient.
"""

import os
import runpy
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm, joint_sizes, sample_joints
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.errors import InputError
from lite6jax.recordings import require_radians

SLENDERNESS = 20.0
"""Reach over radius where no radius is given: 4 cm on a Lite 6, 10 cm on a UR10e; an assumption, not a measurement."""
ALWAYS = 0.95
"""A pair that overlaps in more than this share of poses overlaps by construction (MoveIt's setup assistant does so)."""
_SAMPLES = 2048
_SMALLEST = 1e-30
"""m²; the root of a squared distance of zero has no gradient."""


class Capsule(NamedTuple):
    """All points within `radius`, m, of a segment between two points `(3,)` m in the frame of the link that carries it.

    Link 0 is the base; link i is what joint i moves, its frame that after the joint's motion.
    """

    name: str
    link: int
    start: Array
    end: Array
    radius: float


def chain_capsules(arm: Arm, radius: float | None = None, tool_point: ArrayLike = (0.0, 0.0, 0.0)) -> list[Capsule]:
    """Straight capsules between successive joint origins, from the base to the tool: all that a bare chain tells.

    Args:
        arm: the chain. A link without length, two axes that meet, has no capsule of its own.
        radius: of all capsules, m; an assumption: a twentieth of the reach if not given.
        tool_point: `(3,)` m in the flange's frame, where the last capsule ends.

    Raises:
        InputError: a radius that is not positive.
    """
    if radius is None and not arm.reach:
        return []
    radius = arm.reach / SLENDERNESS if radius is None else radius
    if not 0 < radius < np.inf:
        raise InputError(f"capsule radius {radius:g} m: give a positive length")
    tool = arm.T_joint_flange[:3, :3] @ np.asarray(tool_point, float) + arm.T_joint_flange[:3, 3]
    ends = [*arm.kinematics[:, :3], tool]
    names = ["base", *(f"link{i + 1}" for i in range(arm.dof))]
    return [
        Capsule(name, link, np.zeros(3), end, float(radius))
        for link, (name, end) in enumerate(zip(names, ends, strict=True))
        if np.linalg.norm(end) > 1e-6
    ]


class SelfCollision(NamedTuple):
    """The capsules of an arm and the pairs of them that must stay apart.

    Attributes:
        arm: whose joints move the capsules.
        capsules: one or more on each link that has a shape.
        pairs: `(pair, 2)` capsules; never those of one link or of neighbours.
        disabled: the names of the pairs that overlap in nearly every pose and are not tested.
    """

    arm: Arm
    capsules: tuple[Capsule, ...]
    pairs: Integers
    disabled: tuple[tuple[str, str], ...]

    def clearance(self, joint_position: Any) -> Any:
        """The least distance between surfaces of any pair, `(sample,)` m, negative where they overlap."""
        return self.pair_clearances(joint_position).min(0, initial=np.inf)

    def pair_clearances(self, joint_position: Any) -> Any:
        """Each pair's distance of surfaces, m, `(pair, sample)`."""
        if not len(self.pairs):
            return np.zeros((0, len(joint_position)))
        q = joint_position if hasattr(joint_position, "__array_namespace__") else np.asarray(joint_position, float)
        xp = q.__array_namespace__()
        walked = walk_chain(self.arm, q)
        p, r = (
            xp.stack([walked[c.link][:, :3, :3] @ c[end] + walked[c.link][:, :3, 3] for c in self.capsules])
            for end in (2, 3)
        )
        i, j = self.pairs.T
        radius = np.array([c.radius for c in self.capsules])
        apart = segment_distance(*(xp.moveaxis(points, -1, 0) for points in (p[i], r[i], p[j], r[j])))
        return apart - (radius[i] + radius[j])[:, None]


def self_collision(arm: Arm, capsules: Sequence[Capsule] | None = None) -> SelfCollision:
    """What must be apart on an arm: all pairs of links but neighbours, and but those that overlap nearly always.

    Args:
        arm: whose limits say which poses there are.
        capsules: `chain_capsules` if not given.
    """
    capsules = tuple(chain_capsules(arm) if capsules is None else capsules)
    pairs = [
        (i, j)
        for i, capsule in enumerate(capsules)
        for j, earlier_capsule in enumerate(capsules[:i])
        if capsule.link - earlier_capsule.link not in (-1, 0, 1) and capsule.radius + earlier_capsule.radius > 0
    ]
    collision = SelfCollision(arm, capsules, np.array(pairs, int).reshape(-1, 2), ())
    lower, upper = arm.joint_limits.T
    q = lower + (upper - lower) * (sample_joints(arm.dof, _SAMPLES) / (2 * np.pi) + 0.5)
    always = np.mean(collision.pair_clearances(q) < 0, axis=1) > ALWAYS
    disabled = tuple((capsules[j].name, capsules[i].name) for i, j in collision.pairs[always])
    return collision._replace(pairs=collision.pairs[~always], disabled=disabled)


def link_frames(arm: Arm, joint_position: ArrayLike) -> Array:
    """The frames after each joint's rotation, and the flange's: `T_base_link` `(joint + 1, 3, 4, sample)`.

    Args:
        arm: the chain.
        joint_position: `(sample, joint)` rad.

    Raises:
        InputError: joint positions in degrees.
    """
    require_radians(joint_position, arm.joint_limits)
    _, *moved = walk_chain(arm, np.asarray(joint_position, float))
    return np.moveaxis(np.stack(moved)[:, :, :3], 1, -1)


def walk_chain(arm: Arm, q: Any) -> list[Any]:
    """`T_base_link` `(sample, 4, 4)` of the base, each link after its joint, and the flange, at `(sample, joint)`."""
    xp = q.__array_namespace__()
    walked = [xp.broadcast_to(xp.eye(4), (len(q), 4, 4))]
    for link, position, slides in zip(arm.links, q.T, arm.slides, strict=True):
        x, y, z, p = (column for column in xp.moveaxis(walked[-1] @ link, -1, 0))
        if slides:
            p = p + position[:, None] * z
        else:
            cos = xp.cos(position)[:, None]
            sin = xp.sin(position)[:, None]
            x, y = cos * x + sin * y, cos * y - sin * x
        walked.append(xp.stack([x, y, z, p], -1))
    return [*walked, walked[-1] @ arm.T_joint_flange]


def segment_distance(p1: Any, q1: Any, p2: Any, q2: Any) -> Any:
    """The distance between segments p1 q1 and p2 q2; each end `(3, …)`, points and parallels included.

    The least of what each end is from the other segment and, where the common perpendicular of the lines meets both
    segments, of its length (C. Ericson, Real-Time Collision Detection, 2005, 5.1.9, its cases taken at once). Lines
    within 1 µrad of parallel are left to their ends: nothing is divided by what rounding made.
    """
    xp = p1.__array_namespace__()
    d1 = q1 - p1
    d2 = q2 - p2
    between = p2 - p1
    a = xp.sum(d1 * d1, 0)
    e = xp.sum(d2 * d2, 0)
    n = xp.cross(d1, d2, axis=0)
    n2 = xp.sum(n * n, 0)
    oblique = n2 > 1e-12 * a * e
    safe = xp.where(oblique, n2, 1.0)
    s, t = (xp.sum(xp.cross(between, d, axis=0) * n, 0) / safe for d in (d2, d1))
    meets = oblique & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    squares = [xp.where(meets, xp.sum(between * n, 0) ** 2 / safe, np.inf)]
    for p, start, d, length2 in ((p1, p2, d2, e), (q1, p2, d2, e), (p2, p1, d1, a), (q2, p1, d1, a)):
        to = p - start
        along = xp.clip(xp.sum(to * d, 0) / xp.where(length2 > 0, length2, 1.0), 0.0, 1.0)
        squares.append(xp.sum((to - along * d) ** 2, 0))
    return xp.sqrt(xp.maximum(xp.stack(squares).min(0), _SMALLEST))


# ------------------------------------------------------------------ joint positions and filters


_BATCH = 16384
_FEWEST = 1e-3
"""A smaller share that passes indicates a mistake in the filters."""
_ENOUGH_TRIED = 100_000


class Filter(NamedTuple):
    """A condition on joint positions.

    Attributes:
        name: what messages call it.
        accepts: `(sample, joint)` rad to `(sample,)` bool.
        distance: `(sample, joint)` rad to `(sample,)` m from what is refused, negative inside it, of NumPy and JAX
            alike; None where unknown.
    """

    name: str
    accepts: Callable[[Array], Mask]
    distance: Callable[[Any], Any] | None = None


class Candidates(NamedTuple):
    """Positions `(candidate, joint)` rad that pass every filter, how many were drawn, and how many each refused."""

    joint_position: Array
    tried: int
    refused: dict[str, int]


def candidates(
    arm: Arm, count: int, seed: int = 0, filters: Sequence[Filter] = (), limit_margin: float = 0.0
) -> Candidates:
    """Joint positions drawn evenly inside the limits, until `count` pass all filters.

    Args:
        arm: whose limits.
        count: how many.
        seed: the same gives the same.
        filters: applied in this order.
        limit_margin: rad, how far each joint stays from its limits.

    Raises:
        InputError: no room between the limits, or fewer than one in a thousand passes: the line names the filter that
            refused most.
    """
    if count < 1:
        raise InputError(f"{count} candidates: give 1 or more")
    lower, upper = inside_limits(arm, limit_margin).T
    rng = np.random.default_rng(seed)
    refused = {condition.name: 0 for condition in filters}
    accepted_batches: list[Array] = []
    drawn = passed = 0
    while passed < count:
        q = rng.uniform(lower, upper, (_BATCH, arm.dof))
        drawn += len(q)
        for condition in filters:
            accepted = condition.accepts(q)
            refused[condition.name] += int(np.sum(~accepted))
            q = q[accepted]
        accepted_batches.append(q)
        passed += len(q)
        if drawn >= _ENOUGH_TRIED and passed < min(_FEWEST * drawn, count):
            worst = max(refused, key=lambda name: refused[name])
            raise InputError(
                f"candidates: {passed} of {drawn} joint positions pass; {worst} refused"
                f" {100 * refused[worst] / drawn:.3g} % of them; widen it"
            )
    return Candidates(np.concatenate(accepted_batches)[:count], drawn, refused)


def inside_limits(arm: Arm, margin: float = 0.0) -> Array:
    """The joint limits drawn in by a margin in rad, of prismatic joints at `LEVER`; `(joint, 2)` rad, or m.

    Raises:
        InputError: a margin below zero, or one that leaves a joint no room.
    """
    if not 0 <= margin < np.inf:
        raise InputError(f"limit margin {margin:g} rad: give zero or more")
    limits = arm.joint_limits + np.outer(joint_sizes(margin, "rad", arm.slides), [1, -1])
    for i, (lower, upper) in enumerate(limits):
        if not lower < upper:
            raise InputError(f"limit margin {np.rad2deg(margin):g}°: leaves joint{i + 1} no room; give a smaller one")
    return limits


def all_pass(filters: Sequence[Filter], joint_position: ArrayLike) -> Mask:
    """Which joint positions pass every filter.

    Args:
        filters: in the order in which they are applied.
        joint_position: `(sample, joint)` rad.

    Returns:
        `(sample,)` bool.
    """
    q = np.asarray(joint_position, float)
    passed = np.ones(len(q), bool)
    for condition in filters:
        passed[passed] = condition.accepts(q[passed])
    return passed


def inside_box(arm: Arm, lower: ArrayLike, upper: ArrayLike, tool_point: ArrayLike = (0.0, 0.0, 0.0)) -> Filter:
    """The tool point `(3,)` m, in the flange's frame, is in a box, such as what a sensor sees.

    The box is from its least x, y, z to the greatest, m in the base's frame.

    Raises:
        InputError: the box is empty.
    """
    low, high, point = (np.asarray(corner, float) for corner in (lower, upper, tool_point))
    if not (low < high).all():
        corners = f"{tuple(low.tolist())} to {tuple(high.tolist())}"
        raise InputError(f"box {corners} m: empty; give the least x, y, z, then the greatest")

    def into_box(q: Any) -> Any:
        T = walk_chain(arm, q)[-1]
        position = T[:, :3, :3] @ point + T[:, :3, 3]
        return q.__array_namespace__().minimum(position - low, high - position).min(1)

    return _keep_distance("box", into_box)


def above_floor(arm: Arm, height: float, tool_point: ArrayLike = (0.0, 0.0, 0.0)) -> Filter:
    """Every joint that moves, the flange and the tool point are above a height.

    Args:
        arm: its chain.
        height: in the base's frame, m.
        tool_point: `(3,)` m in the flange's frame.
    """
    point = np.asarray(tool_point, float)

    def over_floor(q: Any) -> Any:
        _, _, *moved, flange = walk_chain(arm, q)
        heights = [T[:, 2, 3] for T in (*moved, flange)]
        return q.__array_namespace__().stack([*heights, flange[:, 2, :3] @ point + flange[:, 2, 3]]).min(0) - height

    return _keep_distance("floor", over_floor)


def clear_of_itself(collision: SelfCollision, margin: float = 0.0) -> Filter:
    """The arm's capsules keep a clearance of more than `margin`, m."""
    return _keep_distance("self-collision", lambda q: collision.clearance(q) - margin)


def _keep_distance(name: str, distance: Callable[[Any], Any]) -> Filter:
    """The condition that a distance is positive."""
    return Filter(name, lambda q: distance(q) > 0, distance)


def user_filter(reference: str) -> Filter:
    """A function of the user's own, from `FILE.py:function`: `(sample, joint)` rad to `(sample,)` bool.

    Loading it runs the file.

    Raises:
        InputError: no such file or function, or an error in either; here, or where the filter is applied.
    """
    file, separator, name = reference.rpartition(":")
    if not separator or not file.endswith(".py") or not name.isidentifier():
        raise InputError(f"filter {reference!r}: write FILE.py:function")
    if not os.path.isfile(file):
        raise InputError(f"{file}: no such file; a filter is FILE.py:function")
    try:
        function = runpy.run_path(file).get(name)
    except Exception as error:
        raise InputError(f"{file}: cannot be loaded ({_one_line(error)}); correct it") from error
    if not callable(function):
        raise InputError(f"{file}: has no function {name!r}; write one, or name another")

    def accepts(q: Array) -> Mask:
        try:
            mask = np.asarray(function(q.copy()))
        except Exception as error:
            raise InputError(f"{reference}: fails ({_one_line(error)}); correct it") from error
        if mask.shape != (len(q),) or mask.dtype != bool:
            raise InputError(
                f"{reference}: returns {mask.dtype} of shape {mask.shape} for {len(q)} samples; return ({len(q)},) bool"
            )
        return mask

    return Filter(reference, accepts)


def _one_line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
