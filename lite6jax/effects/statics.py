"""Loads of gravity and of inertial forces: torques on the joints, moments on the links and on the base."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.chains import Form, HayatiForm, link_frames
from lite6jax.arms.se3 import Turn, base_frame, cross
from lite6jax.deferred import JaxArray, jnp, lax
from lite6jax.effects.motion import Sliding
from lite6jax.errors import InputError

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
"""m/s² in the base frame of an upright arm, the default of recordings."""


class Inertia(NamedTuple):
    """Masses and gravity. A pytree; `inertia_of` builds and checks it.

    Attributes:
        mass: `(joint,)` kg, of the link after each joint.
        center_of_mass: `(joint, 3)` m, of that link, in the frame after the joint's rotation.
        payload_center: `(3,)` m, the centre of mass of the payload in the frame after the last joint.
        gravity: `(3,)` m/s² in the base frame.
    """

    mass: JaxArray
    center_of_mass: JaxArray
    payload_center: JaxArray
    gravity: JaxArray


class Loads(NamedTuple):
    """The moments that gravity exerts on all outboard links and the payload, N·m. A pytree.

    With accelerations the inertial forces are included: m (g − a) replaces m g.

    Attributes:
        moment: `(joint, 3, sample)` about the origin of the frame after each joint's rotation, in the axes of that
            frame.
        base_moment: `(3, sample)` about the origin of the base frame, in its axes.
        payload_moment: `(3, sample)` of the payload alone about the flange's origin, in the flange's axes; None where
            not given.
        effort: `(joint, sample)`, `torque` where a joint is prismatic; None where none is.
    """

    moment: JaxArray
    base_moment: JaxArray
    payload_moment: JaxArray | None = None
    effort: JaxArray | None = None

    @property
    def torque(self) -> JaxArray:
        """`(joint, sample)` N·m about the +z axis of each joint, N along it of a prismatic one; the motor exerts the
        opposite."""
        return self.moment[:, 2] if self.effort is None else self.effort


def inertia_of(
    mass: ArrayLike,
    center_of_mass: ArrayLike,
    payload_center: ArrayLike = (0.0, 0.0, 0.0),
    gravity: ArrayLike = STANDARD_GRAVITY,
) -> Inertia:
    """An `Inertia` from arrays with the shapes and units of its attributes.

    Raises:
        InputError: inconsistent shapes, or a number that is not finite.
    """
    masses = np.asarray(mass, float)
    if masses.ndim != 1:
        raise InputError(f"inertia: mass has the shape {masses.shape}; give (joint,)")
    arrays = {"mass": mass, "center_of_mass": center_of_mass, "payload_center": payload_center, "gravity": gravity}
    shapes = {"mass": masses.shape, "center_of_mass": (masses.size, 3), "payload_center": (3,), "gravity": (3,)}
    for name, value in arrays.items():
        array = np.asarray(value, float)
        if array.shape != shapes[name]:
            raise InputError(f"inertia: {name} has the shape {array.shape}; give {shapes[name]}")
        if not np.isfinite(array).all():
            raise InputError(f"inertia: {name} has a number that is not finite; correct it")
    return Inertia(**{name: jnp.asarray(np.asarray(value, float)) for name, value in arrays.items()})


def with_mass_errors(inertia: Inertia, errors: ArrayLike, payload: float = 0.0) -> Inertia:
    """The masses as they are where those declared are off. Loads change in proportion to the errors.

    Args:
        inertia: as declared.
        errors: `(joint, 4)`: of each mass, relative to it; and of its first moment, beyond that of the mass, along each
            axis, relative to the mass times the distance of its centre from the origin, or times the mean such
            distance of the arm where that is larger: a centre near an axis is not better known.
        payload: kg by which it is heavier than declared, put into the last link at the payload's centre.
    """
    e = jnp.asarray(errors)
    mass = jnp.asarray(inertia.mass)
    center = jnp.asarray(inertia.center_of_mass)
    distance = jnp.linalg.norm(center, axis=1, keepdims=True)
    lever = jnp.maximum(distance, distance.mean())
    heavier = mass * (1 + e[:, 0])
    moment = heavier[:, None] * center + mass[:, None] * lever * e[:, 1:]
    heavier = heavier.at[-1].add(payload)
    moment = moment.at[-1].add(payload * jnp.asarray(inertia.payload_center))
    weightless = heavier == 0
    center = jnp.where(weightless[:, None], center, moment / jnp.where(weightless, 1.0, heavier)[:, None])
    return inertia._replace(mass=heavier, center_of_mass=center)


def loads(
    form: Form,
    kinematics: JaxArray,
    joint: Turn,
    payload: JaxArray,
    inertia: Inertia,
    velocity: JaxArray | None = None,
    acceleration: JaxArray | None = None,
) -> Loads:
    """The loads on a rigid chain, for use inside a jitted function.

    The frames follow from one forward recursion, the loads from sums over the outboard bodies: with F the force on all
    bodies outboard of the origin o and P its moment about the base's origin, M = P − o × F. A body of mass m with the
    acceleration a of its centre contributes m (g − a) (recursive Newton–Euler; J. Luh, M. Walker and R. Paul, 1980).
    The moments of the bodies' inertia tensors are omitted, because descriptions do not contain these tensors.

    All is summed in the axes of the base: a joint whose axis is vertical has a torque of exactly zero.

    Args:
        form: a six-parameter chain.
        kinematics: `(size,)`, its parameters.
        joint: the joints' motions, each `(joint, sample)`.
        payload: `(sample,)` kg.
        inertia: masses and gravity.
        velocity: `(joint, sample)` rad/s.
        acceleration: `(joint, sample)` rad/s²; None omits inertial forces, as at standstill.

    Raises:
        InputError: a Hayati chain, whose frames differ from those in which centres of mass are given; or the number of
            masses differs from the number of joints.
    """
    if isinstance(form, HayatiForm):
        raise InputError(
            "the loads of gravity require the frames of the links; use the six-parameter chain, to which "
            "hayati_to_six_parameter converts a Hayati chain exactly, or give the loads themselves"
        )
    if inertia.mass.shape != (form.dof,):
        raise InputError(
            f"inertia: {inertia.mass.size} masses for an arm of {form.dof} joints; give one per joint, a tool's mass "
            "within the last"
        )
    samples = joint.cos.shape[1]

    frames = link_frames(form, kinematics, joint, base_frame(jnp.eye(4), samples))
    x, y, z, origin = (jnp.moveaxis(part, 1, 0) for part in frames)  # (3, joint, sample)

    def arm_to(center: JaxArray, last: slice) -> JaxArray:
        a, b, c = jnp.moveaxis(center, -1, 0)[..., None]
        return a * x[:, last] + b * y[:, last] + c * z[:, last]

    links = slice(None)
    end = slice(-1, None)
    to_link = arm_to(inertia.center_of_mass, links)
    to_payload = arm_to(inertia.payload_center[None], end)
    specific_force = _specific_force(form, z, origin, velocity, acceleration, inertia.gravity)
    force = inertia.mass[:, None] * specific_force(to_link, links)
    weight = payload * specific_force(to_payload, end)
    moment = cross(origin + to_link, force).at[:, -1:].add(cross(origin[:, end] + to_payload, weight))
    outboard = partial(lax.cumsum, axis=1, reverse=True)
    outboard_force = outboard(force.at[:, -1:].add(weight))
    about_base = outboard(moment)
    about = about_base - cross(origin, outboard_force)
    about_flange = cross(to_payload, weight)[:, 0]
    of_payload = jnp.stack([jnp.sum(axis[:, -1] * about_flange, 0) for axis in (x, y, z)])
    about_axes = jnp.stack([jnp.sum(axis * about, 0) for axis in (x, y, z)], 1)
    revolute_loads = Loads(about_axes, about_base[:, 0], of_payload)
    if not form.sliding:
        return revolute_loads
    slides = Sliding(form.sliding).mask(form.dof)[:, None]
    return revolute_loads._replace(effort=jnp.where(slides, jnp.sum(z * outboard_force, 0), about_axes[:, 2]))


def _specific_force(
    form: Form,
    axis: JaxArray,
    origin: JaxArray,
    velocity: JaxArray | None,
    acceleration: JaxArray | None,
    gravity: JaxArray,
) -> Callable[[JaxArray, slice], JaxArray]:
    """The specific force g − a at points of the links, as a function.

    The function takes the vectors `(3, joint, sample)` m from the origins of some frames to points fixed in them, and
    the slice of joints to which they belong, and gives g − a of the points in m/s².

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
    slides = Sliding(form.sliding).mask(form.dof)[:, None]
    shifting = (velocity, acceleration)
    if form.sliding:
        velocity, acceleration = (jnp.where(slides, 0.0, rate) for rate in shifting)
    rates = axis * velocity
    omega = outwards(rates)
    alpha = outwards(axis * acceleration + cross(omega, rates))  # a joint's own rotation leaves its axis unchanged

    def relative(arm: JaxArray, at: slice) -> JaxArray:
        return cross(alpha[:, at], arm) + cross(omega[:, at], cross(omega[:, at], arm))

    steps = relative(jnp.diff(origin, axis=1), slice(-1))
    of_origin = jnp.concatenate([jnp.zeros_like(origin[:, :1]), outwards(steps)], 1)
    if form.sliding:  # what a slide adds in the frame before it, which turns
        along, along_rate = (jnp.where(slides, rate, 0.0) for rate in shifting)
        of_origin = of_origin + outwards(axis * along_rate + 2 * cross(omega, axis * along))
    return lambda arm, at: g - of_origin[:, at] - relative(arm, at)
