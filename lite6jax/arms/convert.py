"""Six-parameter chains to Hayati chains and back, in closed form, from the joint axes as lines.

No fit is involved, which makes this the independent check of the fit, and the instant path for a fleet.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from lite6jax.arms.chains import HayatiForm, joint_axes
from lite6jax.arms.se3 import inverse, rotation_from_rpy, rpy_from_rotation, transform
from lite6jax.errors import InputError

_AXIS_1_UPRIGHT = np.cos(np.deg2rad(85.0))


def six_parameter_to_hayati(form: HayatiForm, kinematics: ArrayLike, nominal: ArrayLike | None = None) -> np.ndarray:
    """The Hayati parameters of a six-parameter chain.

    Each DH row has two solutions (the common normal may point either way); the one next to `nominal` is taken, or
    without it the one with theta_off in (−90°, 90°].

    Args:
        form: the Hayati form.
        kinematics: `(joint, 6)`, or many arms `(arm, joint, 6)`; m and rad.
        nominal: the parameters `(size,)` whose branch is wanted.

    Returns:
        `(size,)` or `(arm, size)`, in the order of `form.names`.

    Raises:
        InputError: joint 1's axis is nearly horizontal in the base frame (the base has no x, y intersection then), a
            pair that the form calls parallel is not, or one that it does not is, or parallel axes coincide.
    """
    kinematics = np.asarray(kinematics, float)
    if kinematics.shape[-2:] != (form.dof, 6):
        raise InputError(f"kinematics of shape {kinematics.shape}: this form takes ({form.dof}, 6)")
    if not np.isfinite(kinematics).all():
        raise InputError("kinematics: every number must be finite")
    _require_regular(form, kinematics)
    if nominal is None:
        _, directions = joint_axes(kinematics.reshape(-1, form.dof, 6)[0])
        branch = np.zeros((form.dof, 2))
        for i in form.parallel:
            branch[i, 1] = 0.0 if directions[i] @ directions[i + 1] > 0 else np.pi
    else:
        branch = form.unpack(nominal)[1][:, [0, 3]]
    convert = _convert if kinematics.ndim == 2 else jax.vmap(_convert, in_axes=(None, 0, None))
    return np.asarray(convert(form, kinematics, branch))


def _require_regular(form: HayatiForm, kinematics: np.ndarray) -> None:
    points, directions = joint_axes(kinematics)

    def refuse(irregular: np.ndarray | np.bool, message: str) -> None:
        if irregular.any():
            which = f"kinematics[{np.flatnonzero(irregular)[0]}]: " if kinematics.ndim == 3 else ""
            raise InputError(which + message)

    refuse(
        np.abs(directions[..., 0, 2]) < _AXIS_1_UPRIGHT,
        "joint 1: its axis lies in the base's x-y plane; turn the base frame so that z is near joint 1's axis",
    )
    for i in range(form.dof - 1):
        axis, following, gap = (
            directions[..., i, :],
            directions[..., i + 1, :],
            points[..., i + 1, :] - points[..., i, :],
        )
        sine = np.linalg.norm(np.cross(axis, following), axis=-1)
        distance = np.linalg.norm(np.cross(axis, gap), axis=-1)
        pair = f"joints {i + 1} and {i + 2}: their axes"
        if i in form.parallel:
            refuse(sine > 0.5, f"{pair} are not parallel as this form expects; check the arm's model")
            refuse(distance < 1e-4, f"{pair} coincide, so the two cannot be told apart; remove one joint")
        else:
            refuse(sine < 1e-6, f"{pair} are parallel, which this form does not expect; add {i} to `parallel`")


@partial(jax.jit, static_argnums=0)
def _convert(form: HayatiForm, kinematics: Array, branch: Array) -> Array:
    """`branch` `(joint, 2)`: the theta and alpha next to which those of a joint are wanted."""
    origins = transform(rotation_from_rpy(kinematics[:, 3:]), kinematics[:, :3])
    first = origins[0]
    direction, point = first[:3, 2], first[:3, 3]
    roll, pitch = -jnp.arcsin(direction[1]), jnp.arctan2(direction[0], direction[2])
    foot = point - point[2] / direction[2] * direction
    base_rotation = rotation_from_rpy(jnp.stack([roll, pitch, jnp.zeros(())]))
    T_base = transform(base_rotation, jnp.array([1.0, 1.0, 0.0]) * foot)
    # T_dh_joint: the six-parameter frame of joint i in the DH frame i - 1; both have the joint's axis as z at q = 0
    T_dh_joint = inverse(T_base) @ first
    rows, betas = [], []
    for i in range(form.dof - 1):
        T = T_dh_joint @ origins[i + 1]
        u, p = T[:3, 2], T[:3, 3]
        cn, sn = jnp.cos(branch[i, 0]), jnp.sin(branch[i, 0])
        if i in form.parallel:
            p = p - p[2] / u[2] * u
            side = jnp.where(cn * p[0] + sn * p[1] < 0, -1.0, 1.0)
            theta = jnp.arctan2(side * p[1], side * p[0])
            c, s = jnp.cos(theta), jnp.sin(theta)
            a, d = c * p[0] + s * p[1], jnp.zeros(())
            alpha, beta = (
                jnp.arctan2(s * u[0] - c * u[1], u[2]),
                jnp.arctan2(c * u[0] + s * u[1], jnp.hypot(s * u[0] - c * u[1], u[2])),
            )
            betas.append(beta)
        else:
            # u = (sin θ sin α, −cos θ sin α, cos α): the sign of sin α is free, and turns θ by 180°
            side = jnp.where(-cn * u[1] + sn * u[0] < 0, -1.0, 1.0)
            theta = jnp.arctan2(side * u[0], -side * u[1])
            c, s = jnp.cos(theta), jnp.sin(theta)
            sine = s * u[0] - c * u[1]
            alpha, beta = jnp.arctan2(sine, u[2]), jnp.zeros(())
            a = c * p[0] + s * p[1]
            d = p[2] + u[2] * (c * p[1] - s * p[0]) / sine
        theta, alpha = _next_to(branch[i, 0], theta), _next_to(branch[i, 1], alpha)
        rows.append(jnp.stack([theta, d, a, alpha]))
        A = _link(theta, d, a, alpha, beta)
        T_dh_joint = inverse(A) @ T
    theta = _next_to(branch[-1, 0], jnp.arctan2(T_dh_joint[1, 0], T_dh_joint[0, 0]))
    rows.append(jnp.stack([theta, T_dh_joint[2, 3], jnp.zeros(()), jnp.zeros(())]))
    keep = np.ones((form.dof, 4), bool)
    keep[list(form.parallel), 1] = False
    table = jnp.stack(rows)[keep]
    return jnp.concatenate([foot[:2], jnp.stack([roll, pitch]), table, *(jnp.atleast_1d(beta) for beta in betas)])


def _next_to(wanted: Array, angle: Array) -> Array:
    return angle + 2 * jnp.pi * jnp.round((wanted - angle) / (2 * jnp.pi))


def _link(theta: Array, d: Array, a: Array, alpha: Array, beta: Array) -> Array:
    ct, st, ca, sa, cb, sb = (
        jnp.cos(theta),
        jnp.sin(theta),
        jnp.cos(alpha),
        jnp.sin(alpha),
        jnp.cos(beta),
        jnp.sin(beta),
    )
    zero, one = jnp.zeros(()), jnp.ones(())
    Rz = jnp.array([[ct, -st, zero], [st, ct, zero], [zero, zero, one]])
    Rx = jnp.array([[one, zero, zero], [zero, ca, -sa], [zero, sa, ca]])
    Ry = jnp.array([[cb, zero, sb], [zero, one, zero], [-sb, zero, cb]])
    return transform(Rz @ Rx @ Ry, jnp.stack([a * ct, a * st, d]))


def hayati_to_six_parameter(form: HayatiForm, parameters: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """The six-parameter chain of Hayati parameters, exactly.

    Args:
        form: the Hayati form.
        parameters: `(size,)`.

    Returns:
        kinematics `(joint, 6)`, and `T_joint_flange` `(4, 4)`: the last joint's a and alpha, which a six-parameter
        chain, ending at the last joint, has no room for.
    """
    base, dh, beta = form.unpack(parameters)
    betas = np.zeros(form.dof)
    betas[list(form.parallel)] = beta
    origin = transform(rotation_from_rpy(np.array([base[2], base[3], 0.0])), np.array([base[0], base[1], 0.0]))
    rows = []
    for (theta, d, a, alpha), tilt in zip(dh, betas, strict=True):
        origin = origin @ _link(*map(jnp.asarray, (theta, d, 0.0, 0.0, 0.0)))
        rows.append(np.concatenate([np.asarray(origin[:3, 3]), np.asarray(rpy_from_rotation(origin[:3, :3]))]))
        origin = _link(*map(jnp.asarray, (0.0, 0.0, a, alpha, tilt)))
    return np.array(rows), np.asarray(origin)
