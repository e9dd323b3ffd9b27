"""Serial chains as pure functions: the six-parameter chain, the Hayati chain, and the twists of their parameters.

A chain is walked as a frame that moves along its own axes. Inside this module the sample is the last axis of every
array, so that an elementary move is a vector instruction over samples, and the joints are a loop, so that neither
compile time nor recomputed prefixes grow with their number.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array, lax
from jax.typing import ArrayLike

from lite6jax.arms.moves import (
    Frame,
    Turn,
    Twist,
    X,
    Y,
    Z,
    base_frame,
    displace,
    rotate,
    rotation_twist,
    translate,
    turn,
)
from lite6jax.arms.se3 import transform
from lite6jax.errors import InputError

PARALLEL_WITHIN = np.deg2rad(5.0)
"""Neighbouring axes closer than this in the nominal geometry count as parallel; what assembly tilts is far below."""


class Bend(NamedTuple):
    """What shifts the frames of a six-parameter chain away from its parameters, sample by sample; None is nothing.

    Attributes:
        stretch: `(joint, sample)`, the relative growth of the vector to each joint's origin.
        twist: `(joint, 6, sample)`, what `displace` does to each frame after its joint's rotation.
    """

    stretch: Array | None = None
    twist: Array | None = None


@dataclass(frozen=True)
class SixParameterForm:
    """The chain of factory files and URDF: x y z roll pitch yaw, then the joint's rotation.

    T = ∏ Trans(xᵢ, yᵢ, zᵢ) Rz(yawᵢ) Ry(pitchᵢ) Rx(rollᵢ) Rz(qᵢ). Of its 6 n parameters 4 n + 2 are determined by
    flange poses (26 for six joints): each joint's axis is a line (4 numbers), and the last joint fixes the flange's
    height and angle on it. The free directions: each joint's frame may slide along and turn about its own axis, which
    the next joint's origin undoes (2 (n − 1) of them).
    """

    dof: int

    entering = 0

    @property
    def size(self) -> int:
        """6 n."""
        return 6 * self.dof

    @cached_property
    def names(self) -> tuple[str, ...]:
        """`joint1_x` … `jointN_yaw`."""
        return tuple(f"joint{i + 1}_{n}" for i in range(self.dof) for n in ("x", "y", "z", "roll", "pitch", "yaw"))

    @cached_property
    def units(self) -> tuple[str, ...]:
        """`m` or `rad` for each."""
        return ("m", "m", "m", "rad", "rad", "rad") * self.dof

    @cached_property
    def walking_order(self) -> np.ndarray:
        """The walk meets yaw before pitch before roll."""
        return (6 * np.arange(self.dof)[:, None] + np.array([0, 1, 2, 5, 4, 3])).ravel()

    @property
    def flags(self) -> np.ndarray:
        """All joints are alike."""
        return np.zeros(self.dof, bool)

    def enter(self, frame: Frame, values: Array) -> tuple[Frame, tuple[Twist, ...]]:
        """Nothing stands before joint 1."""
        return frame, ()

    def step(
        self, frame: Frame, values: Array | tuple[Array, ...], flag: Array, joint: Turn
    ) -> tuple[Frame, tuple[Twist, ...]]:
        """Through one joint's origin and rotation."""
        x, y, z, yaw, pitch, roll = values
        shifts = tuple(Twist(frame[axis], None) for axis in (X, Y, Z))
        frame = translate(translate(translate(frame, X, x), Y, y), Z, z)
        about_z = rotation_twist(frame, Z)
        frame = rotate(frame, Z, turn(yaw))
        about_y = rotation_twist(frame, Y)
        frame = rotate(frame, Y, turn(pitch))
        about_x = rotation_twist(frame, X)
        frame = rotate(rotate(frame, X, turn(roll)), Z, joint)
        return frame, (*shifts, about_z, about_y, about_x)


@dataclass(frozen=True)
class HayatiForm:
    """The effective model: a base, then standard DH, with Hayati's parameter where neighbouring axes are parallel.

    T = Base ∏ Aᵢ, Base = Trans(x, y, 0) Ry(pitch) Rx(roll), Aᵢ = Rz(qᵢ + theta_offᵢ) Tz(dᵢ) Tx(aᵢ) Rx(alphaᵢ);
    for a joint in `parallel` d is zero and Ry(betaᵢ) follows (S. Hayati, CDC 1983). 4 n + 4 parameters (28 for six
    joints), all of them determined by flange poses: 4 for each joint's axis and 4 for the flange on the last one.
    A flange whose frame is free in all six numbers, a general tool, has two more: 4 n + 6 = 30, the full model.

    Attributes:
        dof: number of joints.
        parallel: the joints, counted from 0, whose axis is nominally parallel to the next one's.
    """

    dof: int
    parallel: tuple[int, ...] = ()

    entering = 4

    def __post_init__(self) -> None:
        if any(not 0 <= i < self.dof - 1 for i in self.parallel) or list(self.parallel) != sorted(set(self.parallel)):
            raise InputError(f"parallel joints {self.parallel}: give each once, in order, from 0 to {self.dof - 2}")

    @property
    def size(self) -> int:
        """4 n + 4."""
        return 4 * self.dof + 4

    @cached_property
    def names(self) -> tuple[str, ...]:
        """`base_x base_y base_roll base_pitch`, `theta_off1 d1 a1 alpha1` …, `beta2` …; no d where there is a beta."""
        joints = [
            f"{name}{i + 1}"
            for i in range(self.dof)
            for name in ("theta_off", "d", "a", "alpha")
            if not (name == "d" and i in self.parallel)
        ]
        betas = [f"beta{i + 1}" for i in self.parallel]
        return ("base_x", "base_y", "base_roll", "base_pitch", *joints, *betas)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """`m` or `rad` for each."""
        return tuple(
            "m" if name.rstrip("0123456789") in ("base_x", "base_y", "d", "a") else "rad" for name in self.names
        )

    @cached_property
    def walking_order(self) -> np.ndarray:
        """The walk meets base x, y, pitch, roll, then theta, d or beta, a, alpha at each joint."""
        order = ["base_x", "base_y", "base_pitch", "base_roll"]
        for i in range(self.dof):
            order += [f"{name}{i + 1}" for name in ("theta_off", "beta" if i in self.parallel else "d", "a", "alpha")]
        return np.array([self.names.index(name) for name in order])

    @cached_property
    def flags(self) -> np.ndarray:
        """Whether the joint has a beta for its d."""
        return np.isin(np.arange(self.dof), self.parallel)

    def enter(self, frame: Frame, values: Array) -> tuple[Frame, tuple[Twist, ...]]:
        """The base transform."""
        x, y, pitch, roll = values
        shifts = (Twist(frame.x, None), Twist(frame.y, None))
        frame = translate(translate(frame, X, x), Y, y)
        about_y = rotation_twist(frame, Y)
        frame = rotate(frame, Y, turn(pitch))
        about_x = rotation_twist(frame, X)
        return rotate(frame, X, turn(roll)), (*shifts, about_y, about_x)

    def step(
        self, frame: Frame, values: Array | tuple[Array, ...], flag: Array, joint: Turn
    ) -> tuple[Frame, tuple[Twist, ...]]:
        """Through one joint's rotation and link."""
        theta, second, a, alpha = values
        d, beta = jnp.where(flag, 0.0, second), jnp.where(flag, second, 0.0)
        offset = turn(theta)
        about_z, along_z = rotation_twist(frame, Z), frame.z
        frame = rotate(
            frame,
            Z,
            Turn(joint.cos * offset.cos - joint.sin * offset.sin, joint.sin * offset.cos + joint.cos * offset.sin),
        )
        along_x = Twist(frame.x, None)
        frame = translate(translate(frame, Z, d), X, a)
        about_x = rotation_twist(frame, X)
        frame = rotate(frame, X, turn(alpha))
        about_y = rotation_twist(frame, Y)
        frame = rotate(frame, Y, turn(beta))
        d_or_beta = Twist(jnp.where(flag, about_y.linear, along_z), jnp.where(flag, frame.y, 0.0))
        return frame, (about_z, d_or_beta, along_x, about_x)

    def pack(self, base: npt.ArrayLike, dh: npt.ArrayLike, beta: npt.ArrayLike = ()) -> np.ndarray:
        """Parameters `(size,)` from base (x, y, roll, pitch), the table `(joint, 4)` and one beta per parallel joint.

        Raises:
            InputError: a wrong shape, or a d that is not zero on a parallel joint.
        """
        base, dh, beta = np.asarray(base, float), np.asarray(dh, float), np.asarray(beta, float)
        if base.shape != (4,) or dh.shape != (self.dof, 4) or beta.shape != (len(self.parallel),):
            raise InputError(
                f"base {base.shape}, dh {dh.shape}, beta {beta.shape}: "
                f"this form takes (4,), ({self.dof}, 4) and ({len(self.parallel)},)"
            )
        for i in self.parallel:
            if dh[i, 1] != 0:
                raise InputError(f"joint {i + 1}: d must be 0 there (it has beta instead), not {dh[i, 1]}")
        keep = np.ones((self.dof, 4), bool)
        keep[list(self.parallel), 1] = False
        return np.concatenate([base, dh[keep], beta])

    def unpack(self, parameters: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The inverse of `pack`."""
        parameters = np.asarray(parameters, float)
        if parameters.shape != (self.size,):
            raise InputError(f"parameters of shape {parameters.shape}: this form takes ({self.size},)")
        keep = np.ones((self.dof, 4), bool)
        keep[list(self.parallel), 1] = False
        dh = np.zeros((self.dof, 4))
        end = 4 + int(keep.sum())
        dh[keep] = parameters[4:end]
        return parameters[:4], dh, parameters[end:]


Form = HayatiForm | SixParameterForm
"""What a chain's parameters are. A form is hashable, so that it can be a static argument of a jitted function.

The walk of a chain meets first the `entering` parameters of `enter`, then the same number at each joint in `step`,
which joint's entry of `flags` tells apart; `walking_order[k]` is the place in `names` of the k-th that it meets.
"""


def sweep(
    form: Form,
    parameters: Array,
    joint: Turn,
    start: Frame,
    emit: Callable[[Twist], Array] | None = None,
    bend: Bend | None = None,
) -> tuple[Frame, Array]:
    """Walks a chain.

    Args:
        form: which chain.
        parameters: `(size,)`.
        joint: the joints' angles, each `(joint, sample)`.
        start: the base frame in fixed coordinates.
        emit: maps the twist of a parameter to an array; all of one shape.
        bend: what shifts the frames of a six-parameter chain.

    Returns:
        The flange's frame, and what was emitted, `(size, …)` in *walking* order (empty without `emit`).

    Raises:
        InputError: a bend of a Hayati chain, whose frames are not those of the links.
    """
    if bend is not None and isinstance(form, HayatiForm):
        raise InputError(
            "the Hayati chain has no frames of links to bend; use the six-parameter chain, to which "
            "hayati_to_six_parameter converts it exactly"
        )
    values = parameters[form.walking_order]
    entering, steps = values[: form.entering], values[form.entering :].reshape(form.dof, -1)
    flags = jnp.asarray(form.flags)
    frame, twists = form.enter(start, entering)

    def record(collected: Array, at: int | Array, twists: tuple[Twist, ...]) -> Array:
        if emit is None or not twists:
            return collected
        rows = jnp.stack([emit(twist) for twist in twists])
        return lax.dynamic_update_slice_in_dim(collected, rows, at, 0)

    if emit is None:
        collected = jnp.zeros((0,))
    else:
        emitted = jax.eval_shape(lambda: emit(rotation_twist(start, Z)))
        collected = jnp.zeros((form.size, *emitted.shape), emitted.dtype)
    collected = record(collected, 0, twists)

    def body(i: Array, state: tuple[Frame, Array]) -> tuple[Frame, Array]:
        frame, collected = state
        pick = partial(lax.dynamic_index_in_dim, index=i, axis=0, keepdims=False)
        values, stretch = pick(steps), None
        if bend is not None and bend.stretch is not None:
            stretch = 1 + pick(bend.stretch)
            values = (*(stretch * value for value in values[:3]), *values[3:])
        frame, twists = form.step(frame, values, pick(flags), Turn(pick(joint.cos), pick(joint.sin)))
        if stretch is not None:
            twists = (*(Twist(stretch * twist.linear, None) for twist in twists[:3]), *twists[3:])
        if bend is not None and bend.twist is not None:
            frame = displace(frame, pick(bend.twist))
        return frame, record(collected, form.entering + i * steps.shape[1], twists)

    return lax.fori_loop(0, form.dof, body, (frame, collected))


def link_frames(form: Form, parameters: Array, joint: Turn, start: Frame) -> Frame:
    """The frame after each joint's rotation, in the coordinates of `start`: leaves `(joint, 3, sample)`; plain JAX."""
    values = parameters[form.walking_order]
    steps = values[form.entering :].reshape(form.dof, -1)
    frame, _ = form.enter(start, values[: form.entering])

    def walk(frame: Frame, at: tuple[Array, Array, Turn]) -> tuple[Frame, Frame]:
        frame, _ = form.step(frame, *at)
        return frame, frame

    return lax.scan(walk, frame, (steps, jnp.asarray(form.flags), joint))[1]


@partial(jax.jit, static_argnums=0)
def fk(form: Form, parameters: ArrayLike, joint_position: ArrayLike) -> Array:
    """Flange poses `T_base_flange` `(..., 4, 4)` of a chain.

    Args:
        form: which chain.
        parameters: `(size,)` in the order of `form.names`; m and rad.
        joint_position: `(..., joint)` rad.

    Raises:
        InputError: shapes that are not this chain's.
    """
    q = jnp.asarray(joint_position, float)
    if jnp.shape(parameters) != (form.size,) or q.shape[-1:] != (form.dof,):
        raise InputError(
            f"parameters {jnp.shape(parameters)} and joint_position {q.shape}: this chain takes ({form.size},) and "
            f"(..., {form.dof})"
        )
    joint = turn(q.reshape(-1, form.dof).T)
    frame, _ = sweep(form, jnp.asarray(parameters, float), joint, base_frame(jnp.eye(4), joint.cos.shape[1]))
    R = jnp.stack([frame.x, frame.y, frame.z], 1)
    T = transform(jnp.moveaxis(R, -1, 0), frame.origin.T)
    return T.reshape(*q.shape[:-1], 4, 4)


def six_parameter_fk(kinematics: ArrayLike, joint_position: ArrayLike) -> Array:
    """Flange poses `(..., 4, 4)` of a six-parameter chain.

    Args:
        kinematics: `(joint, 6)`, rows x y z (m) roll pitch yaw (rad).
        joint_position: `(..., joint)` rad.
    """
    kinematics = jnp.asarray(kinematics, float)
    if kinematics.ndim != 2 or kinematics.shape[1] != 6:
        raise InputError(f"kinematics of shape {kinematics.shape}: give (joint, 6), and use jax.vmap for many arms")
    return fk(SixParameterForm(kinematics.shape[0]), kinematics.reshape(-1), joint_position)


def hayati_fk(form: HayatiForm, parameters: ArrayLike, joint_position: ArrayLike) -> Array:
    """Flange poses `(..., 4, 4)` of a Hayati chain; `parameters` `(size,)` as in `form.names`."""
    return fk(form, parameters, joint_position)


def joint_axes(kinematics: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """The joints' axes at q = 0 as lines in the base frame: points in m and directions, `(..., joint, 3)` each.

    Args:
        kinematics: `(..., joint, 6)`, rows x y z (m) roll pitch yaw (rad).
    """
    kinematics = np.asarray(kinematics, float)
    (sr, sp, sy), (cr, cp, cy) = (np.moveaxis(f(kinematics[..., 3:]), -1, 0) for f in (np.sin, np.cos))
    rows = [  # Rz(yaw) Ry(pitch) Rx(roll)
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    turns = np.stack([np.stack(row, -1) for row in rows], -2)
    R, p = np.eye(3), np.zeros(3)
    points, directions = np.empty((2, *kinematics.shape[:-1], 3))
    for i in range(kinematics.shape[-2]):
        p = p + (R @ kinematics[..., i, :3, None])[..., 0]
        R = R @ turns[..., i, :, :]
        points[..., i, :], directions[..., i, :] = p, R[..., 2]
    return points, directions


def hayati_form_of(kinematics: npt.ArrayLike) -> HayatiForm:
    """The Hayati form of a nominal six-parameter chain `(joint, 6)`: which neighbouring axes are parallel."""
    _, directions = joint_axes(kinematics)
    sines = np.linalg.norm(np.cross(directions[:-1], directions[1:]), axis=1)
    return HayatiForm(len(directions), tuple(int(i) for i in np.flatnonzero(sines < np.sin(PARALLEL_WITHIN))))
