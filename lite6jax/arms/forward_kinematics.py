"""Forward kinematics of serial chains, and the twists of their parameters.

A frame moves along the chain by elementary transformations about its own axes. The sample is the last axis of every
array, so that each transformation is one vector instruction over all samples. The joints are a loop, so that neither
the compile time nor the recomputation of prefixes grows with their number.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from lite6jax.arms.chains import Form, HayatiForm, SixParameterForm, joint_motion
from lite6jax.arms.moves import Frame, Turn, Twist, base_frame, displace
from lite6jax.arms.se3 import transform
from lite6jax.deferred import Array, ArrayLike, jax, jit, jnp, lax
from lite6jax.errors import InputError


class Bend(NamedTuple):
    """Displacements of the frames of a six-parameter chain, sample by sample; None stands for zero.

    Attributes:
        stretch: `(joint, sample)`, the relative growth of the vector to each joint's origin.
        twist: `(joint, 6, sample)` m and rad, by which `displace` moves each frame after its joint's rotation.
    """

    stretch: Array | None = None
    twist: Array | None = None


def sweep(
    form: Form,
    parameters: Array,
    joint: Turn,
    start: Frame,
    emit: Callable[[Twist], Any] | None = None,
    bend: Bend | None = None,
) -> tuple[Frame, list[Any]]:
    """The flange frame of a chain, and a function of the twist of each parameter.

    Args:
        form: the parameterisation.
        parameters: `(size,)`.
        joint: the joints' motions, as `joint_motion` gives them, each `(joint, sample)`.
        start: the base frame in fixed coordinates.
        emit: maps the twist of a parameter to an array or a pytree of arrays.
        bend: displacements of the frames of a six-parameter chain.

    Returns:
        the flange frame, and the results of `emit`: with a leading axis of length one for each parameter of the base,
        then, for each parameter of a joint, those of all joints with a leading joint axis. Their parameters are those
        of `sweep_order`. Empty without `emit`. One array a parameter is faster to fill than one for all.

    Raises:
        InputError: a bend of a Hayati chain, whose frames are not those of the links.
    """
    if bend is not None and isinstance(form, HayatiForm):
        raise InputError(
            "the frames of a Hayati chain are not those of its links, so it cannot bend; use the six-parameter "
            "chain, to which hayati_to_six_parameter converts it exactly"
        )
    of_base, steps = _in_order(form, parameters)
    frame, twists = form.apply_base(start, of_base)
    of_frame = [] if emit is None else [jax.tree.map(lambda leaf: leaf[None], emit(twist)) for twist in twists]

    def walk(frame: Frame, at: tuple[Array, Array, Turn, Bend]) -> tuple[Frame, tuple[Any, ...]]:
        values, flag, motion, bent = at
        if bent.stretch is not None:
            values = (*((1 + bent.stretch) * value for value in values[:3]), *values[3:])
        frame, twists = form.step(frame, values, flag, motion)
        if bent.stretch is not None:
            twists = (*(Twist((1 + bent.stretch) * twist.linear, None) for twist in twists[:3]), *twists[3:])
        if bent.twist is not None:
            frame = displace(frame, bent.twist)
        return frame, () if emit is None else tuple(emit(twist) for twist in twists)

    each = (steps, jnp.asarray(form.flags), joint, Bend() if bend is None else bend)
    frame, of_joints = lax.scan(walk, frame, each)
    return frame, [*of_frame, *of_joints]


def sweep_order(form: Form) -> np.ndarray:
    """The place in `form.names` of the parameter of each result of `sweep`, `form.size` where it is always zero."""
    of_joints = form.walking_order[form.base_size :].reshape(form.dof, -1)
    return np.concatenate([form.walking_order[: form.base_size], of_joints.T.ravel()])


def link_frames(form: Form, parameters: Array, joint: Turn, start: Frame) -> Frame:
    """The frame after each joint's motion, in the coordinates of `start`; its leaves are `(joint, 3, sample)`."""
    of_base, steps = _in_order(form, parameters)

    def walk(frame: Frame, at: tuple[Array, Array, Turn]) -> tuple[Frame, Frame]:
        frame, _ = form.step(frame, *at)
        return frame, frame

    return lax.scan(walk, form.apply_base(start, of_base)[0], (steps, jnp.asarray(form.flags), joint))[1]


def _in_order(form: Form, parameters: Array) -> tuple[Array, Array]:
    """The parameters of the base `(base_size,)`, and those of the joints `(joint, …)`, in order of application."""
    if form.walking_order.max() == form.size:  # a parameter that is always zero
        parameters = jnp.append(parameters, 0.0)
    values = parameters[form.walking_order]
    return values[: form.base_size], values[form.base_size :].reshape(form.dof, -1)


@partial(jit, static_argnums=0)
def fk(form: Form, parameters: ArrayLike, joint_position: ArrayLike) -> Array:
    """Flange poses `T_base_flange` `(..., 4, 4)` of a chain.

    Args:
        form: the parameterisation.
        parameters: `(size,)` in the order of `form.names`; m and rad.
        joint_position: `(..., joint)` rad, and m of prismatic joints.

    Raises:
        InputError: shapes that do not fit the chain.
    """
    q = jnp.asarray(joint_position, float)
    if jnp.shape(parameters) != (form.size,) or q.shape[-1:] != (form.dof,):
        raise InputError(
            f"parameters {jnp.shape(parameters)} and joint_position {q.shape}: this chain takes ({form.size},) and "
            f"(..., {form.dof})"
        )
    joint = joint_motion(form, q.reshape(-1, form.dof).T)
    frame, _ = sweep(form, jnp.asarray(parameters, float), joint, base_frame(jnp.eye(4), joint.cos.shape[1]))
    R = jnp.stack([frame.x, frame.y, frame.z], 1)
    T = transform(jnp.moveaxis(R, -1, 0), frame.origin.T)
    return T.reshape(*q.shape[:-1], 4, 4)


def six_parameter_fk(kinematics: ArrayLike, joint_position: ArrayLike, sliding: tuple[int, ...] = ()) -> Array:
    """Flange poses `(..., 4, 4)` of a six-parameter chain.

    Args:
        kinematics: `(joint, 6)`, rows x y z (m) roll pitch yaw (rad).
        joint_position: `(..., joint)` rad, and m of prismatic joints.
        sliding: the prismatic joints, counted from 0.
    """
    kinematics = jnp.asarray(kinematics, float)
    if kinematics.ndim != 2 or kinematics.shape[1] != 6:
        raise InputError(f"kinematics of shape {kinematics.shape}: give (joint, 6), and use jax.vmap for many arms")
    return fk(SixParameterForm(kinematics.shape[0], sliding), kinematics.reshape(-1), joint_position)


def hayati_fk(form: HayatiForm, parameters: ArrayLike, joint_position: ArrayLike) -> Array:
    """The flange poses of a Hayati chain.

    Args:
        form: the Hayati form.
        parameters: `(size,)` m and rad, in the order of `form.names`.
        joint_position: `(..., joint)` rad, and m of prismatic joints.

    Returns:
        `(..., 4, 4)` T_base_flange, m.
    """
    return fk(form, parameters, joint_position)
