"""What gravity, and the inertia of what moves, does to the arm: torques on joints, moments on links and on the base."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from numpy.typing import ArrayLike

from lite6jax.arms.chains import Form, HayatiForm
from lite6jax.arms.moves import Frame, Turn, base_frame, cross
from lite6jax.errors import InputError

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
"""m/s² in the base frame of an arm that stands upright, the default of recordings."""


class Inertia(NamedTuple):
    """Masses and the gravity that pulls them. A pytree; build it with `inertia_of`.

    Attributes:
        mass: `(joint,)` kg of the link that each joint moves.
        center_of_mass: `(joint, 3)` m, in the frame after that joint's rotation.
        payload_center: `(3,)` m, the payload's centre of mass in the last joint's frame.
        gravity: `(3,)` m/s² in the base frame.
    """

    mass: Array
    center_of_mass: Array
    payload_center: Array
    gravity: Array


class Loads(NamedTuple):
    """The moments of gravity on everything outboard, links and payload; N·m, as gravity exerts them. A pytree.

    Where the arm accelerates, and that is to count, what it holds against is added: m (g − a) in place of m g.

    Attributes:
        moment: `(joint, 3, sample)` about the origin of the frame after each joint's rotation, in that frame's axes.
        base_moment: `(3, sample)` about the base's origin, in the base's axes.
    """

    moment: Array
    base_moment: Array

    @property
    def torque(self) -> Array:
        """`(joint, sample)` about each joint's +z; the joint's motor exerts the opposite."""
        return self.moment[:, 2]


def inertia_of(
    mass: ArrayLike,
    center_of_mass: ArrayLike,
    payload_center: ArrayLike = (0.0, 0.0, 0.0),
    gravity: ArrayLike = STANDARD_GRAVITY,
) -> Inertia:
    """An `Inertia` of arrays of its shapes and units.

    Raises:
        InputError: shapes that do not fit together, or a number that is not finite.
    """
    masses = np.asarray(mass, float)
    if masses.ndim != 1:
        raise InputError(f"inertia: mass has the shape {masses.shape}; give (joint,)")
    given = {"mass": mass, "center_of_mass": center_of_mass, "payload_center": payload_center, "gravity": gravity}
    wanted = {"mass": masses.shape, "center_of_mass": (masses.size, 3), "payload_center": (3,), "gravity": (3,)}
    for name, value in given.items():
        array = np.asarray(value, float)
        if array.shape != wanted[name]:
            raise InputError(f"inertia: {name} has the shape {array.shape}; give {wanted[name]}")
        if not np.isfinite(array).all():
            raise InputError(f"inertia: {name} has a number that is not finite; correct it")
    return Inertia(**{name: jnp.asarray(np.asarray(value, float)) for name, value in given.items()})


def loads(
    form: Form,
    kinematics: Array,
    joint: Turn,
    payload: Array,
    inertia: Inertia,
    velocity: Array | None = None,
    acceleration: Array | None = None,
) -> Loads:
    """The loads on a rigid chain; plain JAX, to be called inside a jitted function.

    One walk outwards for the frames, then sums over what is outboard of each: with F and P the force and its moment
    (about the base's origin) of all that is outboard of the origin o, M = P − o × F. A body of mass m whose centre c
    accelerates by a exerts m (g − a) there (Newton and Euler; J. Luh, M. Walker and R. Paul, 1980); how bodies resist
    to be turned about their own centres is left out, as descriptions do not say it.

    Args:
        form: a six-parameter chain.
        kinematics: its parameters `(size,)`.
        joint: the joints' angles, each `(joint, sample)`.
        payload: `(sample,)` kg.
        inertia: masses and gravity.
        velocity: `(joint, sample)` rad/s.
        acceleration: `(joint, sample)` rad/s²; without it the arm is at rest, or what it accelerates does not count.

    Raises:
        InputError: a Hayati chain, whose frames are not those in which centres of mass are given; or another number
            of masses than joints.
    """
    if isinstance(form, HayatiForm):
        raise InputError(
            "gravity's loads need the frames of the links; use the six-parameter chain, to which "
            "hayati_to_six_parameter converts a Hayati chain exactly, or give the loads themselves"
        )
    if inertia.mass.shape != (form.dof,):
        raise InputError(
            f"inertia: {inertia.mass.size} masses for an arm of {form.dof} joints; give one per joint, a tool's mass "
            "within the last"
        )
    samples = joint.cos.shape[1]

    def outwards(frame: Frame, row: tuple[Array, Array, Array]) -> tuple[Frame, Frame]:
        values, cos, sin = row
        frame, _ = form.step(frame, values, jnp.zeros((), bool), Turn(cos, sin))
        return frame, frame

    rows = kinematics[form.walking_order].reshape(form.dof, 6)
    _, frames = lax.scan(outwards, base_frame(jnp.eye(4), samples), (rows, joint.cos, joint.sin))
    x, y, z, origin = (jnp.moveaxis(part, 1, 0) for part in frames)  # (3, joint, sample)

    def arm_to(center: Array, last: slice) -> Array:
        a, b, c = jnp.moveaxis(center, -1, 0)[..., None]
        return a * x[:, last] + b * y[:, last] + c * z[:, last]

    links, end = slice(None), slice(-1, None)
    to_link, to_payload = arm_to(inertia.center_of_mass, links), arm_to(inertia.payload_center[None], end)
    felt = _felt(z, origin, velocity, acceleration, inertia.gravity)
    force, held = inertia.mass[:, None] * felt(to_link, links), payload * felt(to_payload, end)
    moment = cross(origin + to_link, force).at[:, -1:].add(cross(origin[:, end] + to_payload, held))
    outboard = partial(lax.cumsum, axis=1, reverse=True)
    pull, about_base = outboard(force.at[:, -1:].add(held)), outboard(moment)
    about = about_base - cross(origin, pull)
    return Loads(jnp.stack([jnp.sum(axis * about, 0) for axis in (x, y, z)], 1), about_base[:, 0])


def _felt(
    axis: Array, origin: Array, velocity: Array | None, acceleration: Array | None, gravity: Array
) -> Callable[[Array, slice], Array]:
    """Of an arm `(3, joint, sample)` from the origins of some frames, g − a at its end.

    Args:
        axis: `(3, joint, sample)` of each joint.
        origin: `(3, joint, sample)` of each joint's frame.
        velocity: `(joint, sample)` rad/s.
        acceleration: `(joint, sample)` rad/s².
        gravity: `(3,)` m/s².
    """
    g = gravity[:, None, None]
    if velocity is None or acceleration is None:
        return lambda arm, _: jnp.broadcast_to(g, arm.shape)
    outwards = partial(lax.cumsum, axis=1)
    turning = axis * velocity
    omega = outwards(turning)
    alpha = outwards(axis * acceleration + cross(omega, turning))  # a joint's own turn changes nothing of its axis

    def swung(arm: Array, at: slice) -> Array:
        return cross(alpha[:, at], arm) + cross(omega[:, at], cross(omega[:, at], arm))

    between = swung(jnp.diff(origin, axis=1), slice(-1))
    carried = jnp.concatenate([jnp.zeros_like(origin[:, :1]), outwards(between)], 1)
    return lambda arm, at: g - carried[:, at] - swung(arm, at)
