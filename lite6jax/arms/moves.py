"""Elementary transformations of a frame about its own axes, and their twists: the factors of a chain.

The sample is the last axis of every array, so that a transformation is one vector instruction over samples.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lite6jax.deferred import Array, ArrayLike, jnp

X, Y, Z = 0, 1, 2


class Frame(NamedTuple):
    """A moving frame: its axes and its origin in fixed coordinates, each `(3, sample)`."""

    x: Array
    y: Array
    z: Array
    origin: Array


class Twist(NamedTuple):
    """The motion per unit of one parameter, at the fixed origin: `(3, sample)` each; a translation has no `angular`."""

    linear: Array
    angular: Array | None


class Turn(NamedTuple):
    """The cosine and sine of a rotation angle.

    Of a joint's motion also its shift along its axis in m; None where no joint of the chain is prismatic, so that a
    chain of revolute joints pays nothing for the others.
    """

    cos: Array
    sin: Array
    shift: Array | None = None


def turn(angle: ArrayLike) -> Turn:
    """The cosine and sine of `angle` rad."""
    return Turn(jnp.cos(angle), jnp.sin(angle))


def joint_turn(position: Array, sliding: tuple[int, ...], turned: Callable[[Array], Turn] = turn) -> Turn:
    """The motions of joints about and along their axes.

    Args:
        position: `(..., joint, sample)` rad, or m of a prismatic joint.
        sliding: the prismatic joints, counted from 0.
        turned: what computes cosines and sines.
    """
    if not sliding:
        return turned(position)
    slides = np.isin(np.arange(position.shape[-2]), sliding)[:, None]
    return turned(jnp.where(slides, 0.0, position))._replace(shift=jnp.where(slides, position, 0.0))


def joint_rate(joint: Turn, direction: Array, sliding: tuple[int, ...]) -> Turn:
    """The derivative of `joint_turn` along `direction` `(joint,)`, of joints at `joint` `(joint, sample)`."""
    d = direction[:, None]
    if joint.shift is None:
        return Turn(-d * joint.sin, d * joint.cos)
    slides = np.isin(np.arange(len(direction)), sliding)[:, None]
    turning = Turn(jnp.where(slides, 0.0, -d * joint.sin), jnp.where(slides, 0.0, d * joint.cos))
    return turning._replace(shift=jnp.where(slides, d, jnp.zeros_like(joint.shift)))


def rotate(frame: Frame, axis: int, by: Turn) -> Frame:
    """The frame rotated about its own axis."""
    axes = [frame.x, frame.y, frame.z]
    b, c = (axis + 1) % 3, (axis + 2) % 3
    axes[b], axes[c] = by.cos * axes[b] + by.sin * axes[c], by.cos * axes[c] - by.sin * axes[b]
    return Frame(axes[0], axes[1], axes[2], frame.origin)


def translate(frame: Frame, axis: int, by: Array) -> Frame:
    """The frame shifted along its own axis, by m."""
    return frame._replace(origin=frame.origin + by * frame[axis])


def displace(frame: Frame, twist: Array) -> Frame:
    """The frame shifted along its own axes by `twist[:3]` m, then rotated by the rotation vector `twist[3:]` rad."""
    shifted = translate(translate(translate(frame, X, twist[0]), Y, twist[1]), Z, twist[2])
    w = twist[3:]
    angle2 = jnp.sum(w * w, 0)
    small = angle2 < 1e-8  # where two terms of the series are exact to rounding
    angle = jnp.sqrt(jnp.where(small, 1.0, angle2))
    half = jnp.sin(angle / 2) / angle
    sine = jnp.where(small, 1 - angle2 / 6, jnp.sin(angle) / angle)
    versine = jnp.where(small, 0.5 - angle2 / 24, 2 * half * half)
    axes = []
    for i in range(3):  # column i of 1 + sine [w] + versine (w wᵀ − |w|²), Rodrigues' formula
        j, k = (i + 1) % 3, (i + 2) % 3
        along = 1 - versine * (w[j] * w[j] + w[k] * w[k])
        axes.append(
            along * frame[i]
            + (versine * w[i] * w[j] + sine * w[k]) * frame[j]
            + (versine * w[i] * w[k] - sine * w[j]) * frame[k]
        )
    return Frame(axes[0], axes[1], axes[2], shifted.origin)


def rotation_twist(frame: Frame, axis: int) -> Twist:
    """The twist of a rotation about the frame's own axis."""
    return Twist(cross(frame.origin, frame[axis]), frame[axis])


def cross(a: Array, b: Array) -> Array:
    """The cross product over the first axis."""
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def base_frame(T: Array, samples: int) -> Frame:
    """A fixed transform `(4, 4)` as the frame of every sample."""
    columns = jnp.broadcast_to(T[:3, :, None], (3, 4, samples))
    return Frame(columns[:, 0], columns[:, 1], columns[:, 2], columns[:, 3])
