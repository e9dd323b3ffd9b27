"""Loads of gravity and of inertial forces: torques on the joints, moments on the links and on the base."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.chains import Form, HayatiForm
from lite6jax.arms.dynamics import wrenches
from lite6jax.arms.se3 import Turn
from lite6jax.deferred import Array, jnp
from lite6jax.effects.deflection import library_of
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

    mass: Array
    center_of_mass: Array
    payload_center: Array
    gravity: Array


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

    moment: Array
    base_moment: Array
    payload_moment: Array | None = None
    effort: Array | None = None

    @property
    def torque(self) -> Array:
        """`(joint, sample)` N·m about the +z axis of each joint, N along it of a prismatic one; the motor exerts the
        opposite."""
        return self.moment[:, 2] if self.effort is None else self.effort


def point_mass(mass: Any, center: Any) -> Any:
    """`(…, 10)` inertial numbers of point masses `(…)` kg at `(…, 3)` m: as `arms.dynamics.PARAMETERS`."""
    xp = library_of(mass, center)
    c = xp.asarray(center, float)
    squares = xp.sum(c * c, -1, keepdims=True) - c * c
    products = -c[..., np.array([0, 0, 1])] * c[..., np.array([1, 2, 2])]
    return xp.asarray(mass)[..., None] * xp.concatenate([xp.ones_like(c[..., :1]), c, squares, products], -1)


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
    given = {"mass": mass, "center_of_mass": center_of_mass, "payload_center": payload_center, "gravity": gravity}
    wanted = {"mass": masses.shape, "center_of_mass": (masses.size, 3), "payload_center": (3,), "gravity": (3,)}
    for name, value in given.items():
        array = np.asarray(value, float)
        if array.shape != wanted[name]:
            raise InputError(f"inertia: {name} has the shape {array.shape}; give {wanted[name]}")
        if not np.isfinite(array).all():
            raise InputError(f"inertia: {name} has a number that is not finite; correct it")
    return Inertia(**{name: jnp.asarray(np.asarray(value, float)) for name, value in given.items()})


def with_mass_errors(inertia: Inertia, errors: ArrayLike, payload: float = 0.0) -> Inertia:
    """The masses as they are where those declared are off. Loads change in proportion to the errors.

    Args:
        inertia: as declared.
        errors: `(joint, 4)`: of each mass, relative to it; and of its first moment, beyond that of the mass, along each
            axis, relative to the mass times the distance of its centre from the origin, or times the mean such
            distance of the arm where that is larger: a centre near an axis is not better known.
        payload: kg by which it is heavier than declared, put into the last link at the payload's centre.
    """
    e, mass, center = jnp.asarray(errors), jnp.asarray(inertia.mass), jnp.asarray(inertia.center_of_mass)
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
    kinematics: Array,
    joint: Turn,
    payload: Array,
    inertia: Inertia,
    velocity: Array | None = None,
    acceleration: Array | None = None,
) -> Loads:
    """The loads on a rigid chain, for use inside a jitted function.

    They are the opposite of what holds point masses in their motion: a mass m with the acceleration a contributes
    m (g − a) (`arms.dynamics.wrenches`). Inertia tensors are omitted, because descriptions need not contain them.

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
    still = jnp.zeros_like(joint.cos)
    rates = (still, still) if velocity is None or acceleration is None else (velocity, acceleration)
    links = point_mass(inertia.mass, inertia.center_of_mass)[..., None]
    carried = point_mass(payload, jnp.broadcast_to(inertia.payload_center, (len(payload), 3))).T
    chain, gravity, sliding = kinematics.reshape(-1, 6), inertia.gravity, form.sliding
    force, moment, base, flange = wrenches(chain, links, joint, *rates, gravity, sliding, carried)
    slides = np.isin(np.arange(form.dof), sliding)[:, None]
    return Loads(-moment, -base, -flange, -jnp.where(slides, force[:, 2], moment[:, 2]) if sliding else None)
