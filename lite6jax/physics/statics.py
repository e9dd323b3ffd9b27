"""What gravity does to the arm: its torque on each joint and its moments on each link and on the base."""

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


def loads(form: Form, kinematics: Array, joint: Turn, payload: Array, inertia: Inertia) -> Loads:
    """The loads on a rigid chain at rest; plain JAX, to be called inside a jitted function.

    One walk outwards for the frames, then sums over what is outboard of each: with W and F the mass and the first
    moment (about the base's origin) of all that is outboard of the origin o, M = (F − W o) × g.

    Args:
        form: a six-parameter chain.
        kinematics: its parameters `(size,)`.
        joint: the joints' angles, each `(joint, sample)`.
        payload: `(sample,)` kg.
        inertia: masses and gravity.

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
    flange, frames = lax.scan(outwards, base_frame(jnp.eye(4), samples), (rows, joint.cos, joint.sin))

    def carried(center: Array, frame: Frame) -> Array:
        center = center[..., None, None]
        x, y, z = (jnp.take(center, i, axis=-3) for i in range(3))
        return frame.origin + x * frame.x + y * frame.y + z * frame.z

    first_moment = inertia.mass[:, None, None] * carried(inertia.center_of_mass, frames)
    first_moment = first_moment.at[-1].add(payload * carried(inertia.payload_center, flange))
    outboard = partial(lax.cumsum, axis=0, reverse=True)
    weight = outboard(inertia.mass)[:, None] + payload
    pulled = outboard(first_moment)
    lever = jnp.moveaxis(pulled - weight[:, None] * frames.origin, 1, 0)  # (3, joint, sample)
    g = inertia.gravity
    moment = cross(lever, g)
    in_frame = [jnp.sum(jnp.moveaxis(axis, 1, 0) * moment, 0) for axis in (frames.x, frames.y, frames.z)]
    return Loads(jnp.stack(in_frame, 1), cross(pulled[0], g))
