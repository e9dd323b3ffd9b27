"""The torques that an effect adds to a motion, per unit of its numbers, without a recording."""

from collections.abc import Callable
from functools import partial

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.dynamics import link_parameters
from lite6jax.design.torque.columns import TorqueModel, link_columns
from lite6jax.design.torque.fourier import Motion
from lite6jax.effects.dynamic.bodies import BaseTilt, LinkCom
from lite6jax.effects.dynamic.friction import LoadFriction
from lite6jax.effects.dynamic.motors import TorqueScale
from lite6jax.effects.dynamic.torque_effect import Delaying, Dynamics, TorqueEffect
from lite6jax.effects.effect import require_kind
from lite6jax.effects.motion import motion_of
from lite6jax.errors import InputError

Array = NDArray[np.floating]


def effect_columns(
    effect: TorqueEffect, values: ArrayLike, model: TorqueModel
) -> tuple[Callable[[Motion], Array], NDArray[np.integer]]:
    """The columns of an effect's linear coordinates, as a function of a motion, and which coordinates they are.

    Args:
        effect: on torques.
        values: `(coordinate,)`, at which what is not linear stays.
        model: the arm, its gravity.

    Raises:
        InputError: a joint or link that the arm does not have, or a joint of the other kind; an effect that needs
            inertia of an arm without; temperatures; or a shift of time, which is no column.
    """
    at = np.asarray(values, float)
    arm = model.arm
    if any(getattr(effect, name, 1) > arm.dof for name in ("joint", "link", "source_joint")):
        raise InputError(f"{effect.label}: {arm.name} has {arm.dof} joints; choose one of these")
    require_kind(effect, arm.sliding)
    if isinstance(effect, Delaying) or any("temperature" in driver.quantity for driver in effect.drivers):
        raise InputError(f"{effect.label}: depends on more than the motion of the joints; choose another")
    linear = np.array([i for i, coordinate in enumerate(effect.coordinates) if coordinate.linear], int)
    for i, coordinate in enumerate(effect.coordinates):
        if not coordinate.linear and not at[i]:
            raise InputError(f"{effect.label}: {coordinate.name} is not given; it has to be known to plan with")
    return partial(_columns, effect, at, linear, model, _links(effect, model)), linear


def _columns(
    effect: TorqueEffect, at: Array, linear: NDArray[np.integer], model: TorqueModel, links: Array, motion: Motion
) -> Array:
    dynamics = _dynamics(model, links, motion)
    found = []
    for i in linear:
        unit = np.where(np.arange(len(at)) == i, 1.0, np.where(np.isin(np.arange(len(at)), linear), 0.0, at))
        found.append(np.asarray(effect.torque(unit, dynamics)))
    return np.stack(found, 1)


def _links(effect: TorqueEffect, model: TorqueModel) -> Array:
    """The links' numbers `(joint, 10)`; zero for an arm that declares none, if the effect does not depend on them."""
    try:
        return link_parameters(model.arm)
    except InputError as error:
        if isinstance(effect, TorqueScale | LoadFriction | BaseTilt | LinkCom):
            raise InputError(f"{effect.label}: depends on the arm's inertia; {error}") from error
        return np.zeros((model.arm.dof, 10))


def _dynamics(model: TorqueModel, links: Array, motion: Motion) -> Dynamics:
    regressors: dict[str, Array] = {}
    arm, samples = model.arm, np.shape(motion.q)[1]

    def of(kind: str, moved: Motion, gravity: Array, numbers: Array) -> Array:
        if kind not in regressors:
            regressors[kind] = link_columns(arm, moved, gravity)
        return np.einsum("jps,p->js", regressors[kind], np.asarray(numbers, float).ravel())

    def of_gravity(gravity: Array) -> Array:
        still = np.zeros_like(motion.q)
        turned = [of(f"axis{i}", Motion(motion.q, still, still), np.eye(3)[i], links) for i in range(3)]
        return np.tensordot(gravity, np.stack(turned), 1)

    def of_inertia(numbers: Array) -> Array:
        return of("motion", motion, model.gravity, numbers)

    q, dq, ddq = (np.asarray(part) for part in motion)
    moving = motion_of(q.T, joint_velocity=dq.T, direction=np.sign(dq).T, sliding=arm.sliding)
    moving = moving._replace(joint_acceleration=jnp.asarray(ddq))
    center = arm.T_joint_flange[:3, 3]
    return Dynamics(
        motion=moving,
        torque=of_inertia(links) if links.any() else np.zeros((arm.dof, samples)),
        links=links,
        payload_center=center,
        of_inertia=of_inertia,
        of_gravity=of_gravity,
        gravity=model.gravity,
    )
