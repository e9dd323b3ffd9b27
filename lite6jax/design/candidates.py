"""Joint positions among which a design may choose: inside the limits, and where every filter lets them be."""

import os
import runpy
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm, joint_sizes
from lite6jax.design.clearance import SelfCollision, walk_chain
from lite6jax.errors import InputError

Array = NDArray[np.floating]

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
    accepts: Callable[[Array], NDArray[np.bool_]]
    distance: Callable[[Any], Any] | None = None


class Candidates(NamedTuple):
    """Joint positions that pass every filter.

    Attributes:
        joint_position: `(candidate, joint)` rad.
        tried: how many were drawn for them.
        refused: of each filter, how many it was the first to refuse.
    """

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
    kept: list[Array] = []
    tried = passed = 0
    while passed < count:
        q = rng.uniform(lower, upper, (_BATCH, arm.dof))
        tried += len(q)
        for condition in filters:
            accepted = condition.accepts(q)
            refused[condition.name] += int(np.sum(~accepted))
            q = q[accepted]
        kept.append(q)
        passed += len(q)
        if tried >= _ENOUGH_TRIED and passed < min(_FEWEST * tried, count):
            worst = max(refused, key=lambda name: refused[name])
            raise InputError(
                f"candidates: {passed} of {tried} joint positions pass; {worst} refused"
                f" {100 * refused[worst] / tried:.3g} % of them; widen it"
            )
    return Candidates(np.concatenate(kept)[:count], tried, refused)


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


def all_pass(filters: Sequence[Filter], joint_position: ArrayLike) -> NDArray[np.bool_]:
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
    """The tool point is in a box, such as what a sensor sees.

    Args:
        arm: its chain.
        lower: `(3,)` m, the least x, y, z of the box in the base's frame.
        upper: the greatest.
        tool_point: `(3,)` m in the flange's frame.

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

    def accepts(q: Array) -> NDArray[np.bool_]:
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
