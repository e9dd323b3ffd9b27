"""Closed-form conversion between six-parameter chains and Hayati chains, from the joint axes as lines.

It involves no fit, so that it is an independent check of the fit and a fast path for many arms.
"""

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms import convert_sliding
from lite6jax.arms.chains import HayatiForm, joint_axes
from lite6jax.arms.moves import Frame, X, Y, Z, base_frame, rotate, translate, turn
from lite6jax.arms.se3 import rotation_from_rpy, rpy_from_rotation, transform
from lite6jax.deferred import Array, jit, jnp, lax
from lite6jax.errors import InputError


def six_parameter_to_hayati(form: HayatiForm, kinematics: ArrayLike, nominal: ArrayLike | None = None) -> np.ndarray:
    """The Hayati parameters of a six-parameter chain.

    Each DH row has two solutions, for the two directions of the common normal. The result is the one closest to
    `nominal`, or without it the one with theta_off within ±90°. Parameters of arms are comparable with the same
    `nominal` only.

    Args:
        form: the Hayati form.
        kinematics: `(joint, 6)`, or many arms `(arm, joint, 6)`; m and rad.
        nominal: `(size,)`, the parameters that determine the branch.

    Returns:
        `(size,)` or `(arm, size)`, in the order of `form.names`.

    Raises:
        InputError: joint 1 is revolute and its axis at right angles to the base's axis `form.first_axis`; axes that are
            parallel in the form are not in the chain, or the reverse; or parallel axes coincide.
    """
    kinematics = np.asarray(kinematics, float)
    if kinematics.shape[-2:] != (form.dof, 6):
        raise InputError(f"kinematics of shape {kinematics.shape}: this form takes ({form.dof}, 6)")
    if not np.isfinite(kinematics).all():
        raise InputError("kinematics: every number must be finite")
    arms = kinematics.reshape(-1, form.dof, 6)
    if form.sliding:
        found = convert_sliding.parameters(form, arms, None if nominal is None else np.asarray(nominal, float))
        return found.reshape(*kinematics.shape[:-2], form.size)
    if nominal is None:
        _, directions = joint_axes(arms[0])
        branch = np.zeros((form.dof, 2))
        for i in form.parallel:
            branch[i, 1] = 0.0 if directions[i] @ directions[i + 1] > 0 else np.pi
    else:
        branch = form.unpack(nominal)[1][:, [0, 3]]
    parameters, regularity = closed_form(form, np.ascontiguousarray(np.moveaxis(arms, 0, -1)), branch)
    _require_regular(form, [np.asarray(measure) for measure in regularity], alone=kinematics.ndim == 2)
    return np.ascontiguousarray(np.asarray(parameters).T).reshape(*kinematics.shape[:-2], form.size)


def _require_regular(form: HayatiForm, regularity: list[np.ndarray], alone: bool) -> None:
    upright, sine, distance = regularity

    def refuse(irregular: np.ndarray, message: str) -> None:
        if irregular.any():
            raise InputError(("" if alone else f"kinematics[{np.flatnonzero(irregular)[0]}]: ") + message)

    refuse(
        np.abs(upright) < convert_sliding.UPRIGHT,
        convert_sliding.ACROSS.format("xyz"[form.first_axis]),
    )
    for i in range(form.dof - 1):
        pair = f"joints {i + 1} and {i + 2}: their axes"
        if i in form.parallel:
            refuse(sine[i] > 0.5, f"{pair} are not parallel as this form expects; check the arm's model")
            refuse(distance[i] < 1e-4, f"{pair} coincide, so the two joints are indistinguishable; remove one")
        else:
            refuse(sine[i] < 1e-6, f"{pair} are parallel, which this form does not expect; add {i} to `parallel`")


@partial(jit, static_argnums=0)
def closed_form(form: HayatiForm, kinematics: Array, branch: Array) -> tuple[Array, tuple[Array, Array, Array]]:
    """Parameters `(size, arm)` of `kinematics` `(joint, 6, arm)`, closest to `branch` `(joint, 2)`, theta and alpha.

    Two frames advance joint by joint: that of the six-parameter chain, whose z is the next joint's axis, and the DH
    frame, which moves to that axis along the common normal. The last axis of the arrays is the arm. The second result
    holds the cosine between joint 1's axis and the base's `first_axis` `(arm,)`, and for each pair of neighbouring axes
    the sine of their angle and the distance of the next joint's origin from the first axis, `(pair, arm)`.
    """

    def to_joint(frame: Frame, row: Array) -> Frame:
        x, y, z, roll, pitch, yaw = row
        frame = translate(translate(translate(frame, X, x), Y, y), Z, z)
        return rotate(rotate(rotate(frame, Z, turn(yaw)), Y, turn(pitch)), X, turn(roll))

    def next_link(
        frames: tuple[Frame, Frame], given: tuple[Array, Array, Array]
    ) -> tuple[tuple[Frame, Frame], tuple[Array, ...]]:
        joint, dh = frames
        row, near, parallel = given
        joint = to_joint(joint, row)
        u = [jnp.sum(axis * joint.z, 0) for axis in dh[:3]]
        p = [jnp.sum(axis * (joint.origin - dh.origin), 0) for axis in dh[:3]]
        # where the axes are parallel: the point of the next axis in this frame's x-y plane
        foot = [
            component - p[2] / jnp.where(parallel, u[2], 1.0) * along for component, along in zip(p, u, strict=True)
        ]
        # where they are not: u = (sin θ sin α, −cos θ sin α, cos α); the sign of sin α is free, and turns θ by 180°
        along_x, along_y = jnp.where(parallel, foot[0], -u[1]), jnp.where(parallel, foot[1], u[0])
        c, s, _ = turn(near[0])
        side = jnp.where(c * along_x + s * along_y < 0, -1.0, 1.0)
        theta = jnp.arctan2(side * along_y, side * along_x)
        c, s, _ = turn(theta)
        sine = s * u[0] - c * u[1]
        alpha = jnp.arctan2(sine, u[2])
        a = jnp.where(parallel, c * foot[0] + s * foot[1], c * p[0] + s * p[1])
        d = jnp.where(parallel, 0.0, p[2] + u[2] * (c * p[1] - s * p[0]) / jnp.where(parallel, 1.0, sine))
        beta = jnp.where(parallel, jnp.arctan2(c * u[0] + s * u[1], jnp.hypot(sine, u[2])), 0.0)
        dh = rotate(translate(translate(rotate(dh, Z, turn(theta)), Z, d), X, a), X, turn(alpha))
        found = jnp.stack([_next_to(near[0], theta), d, a, _next_to(near[1], alpha), beta])
        return (joint, rotate(dh, Y, turn(beta))), (found, jnp.hypot(u[0], u[1]), jnp.hypot(p[0], p[1]))

    base = base_frame(jnp.eye(4), kinematics.shape[-1])
    joint = to_joint(base, kinematics[0])
    upright = joint.z[form.first_axis]
    foot = joint.origin - joint.origin[form.first_axis] / upright * joint.z
    given = dict(zip("xyz", foot, strict=True)) | convert_sliding.base_turns(form.first_axis, joint.z, jnp)
    of_base = [given[name] for name in form.of_link(-1)]
    dh, _ = form.apply_base(base, jnp.stack(of_base))
    flags = jnp.asarray(form.flags)
    (joint, dh), (links, sines, distances) = lax.scan(next_link, (joint, dh), (kinematics[1:], branch[:-1], flags[:-1]))

    theta = jnp.arctan2(jnp.sum(dh.y * joint.x, 0), jnp.sum(dh.x * joint.x, 0))
    d = jnp.sum(dh.z * (joint.origin - dh.origin), 0)
    nothing = jnp.zeros_like(d)
    links = jnp.concatenate([links, jnp.stack([_next_to(branch[-1, 0], theta), d, nothing, nothing, nothing])[None]])
    second = jnp.where(flags[:, None], links[:, 4], links[:, 1])  # d or beta
    applied = jnp.concatenate([
        jnp.stack(of_base),
        jnp.stack([links[:, 0], second, links[:, 2], links[:, 3]], 1).reshape(-1, links.shape[-1]),
    ])  # fmt: skip
    return applied[np.argsort(form.walking_order)], (upright, sines, distances)


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
        parameters: `(size,)` m and rad, in the order of `form.names`.

    Returns:
        kinematics `(joint, 6)` m and rad, and `T_joint_flange` `(4, 4)`, the last joint's a and alpha, or a and b: a
        six-parameter chain ends at the last joint and does not contain them.
    """
    (x, y, z, yaw, pitch, roll), links = form.spread(parameters)
    origin = transform(rotation_from_rpy(np.array([roll, pitch, yaw])), np.array([x, y, z])) @ form.T_axes
    rows = []
    for theta, d, a, b, alpha, tilt in links:
        origin = origin @ _link(*map(jnp.asarray, (theta, d, 0.0, 0.0, 0.0)))
        rows.append(np.concatenate([np.asarray(origin[:3, 3]), np.asarray(rpy_from_rotation(origin[:3, :3]))]))
        origin = _link(*map(jnp.asarray, (0.0, 0.0, a, alpha, tilt))).at[1, 3].set(b)
    return np.array(rows), np.asarray(origin)
