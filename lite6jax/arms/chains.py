"""Serial chains as forms of their parameters: the six-parameter chain of factory files and URDF, and the Hayati chain.

`forward_kinematics` evaluates a form. The sample is the last axis of every array.
"""

from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from lite6jax.arms.moves import Frame, Turn, Twist, X, Y, Z, rotate, rotation_twist, translate, turn
from lite6jax.errors import InputError

PARALLEL_WITHIN = np.deg2rad(5.0)
"""rad; neighbouring axes within this angle of the nominal geometry count as parallel. Assembly tolerances are far
smaller."""


@dataclass(frozen=True)
class SixParameterForm:
    """The chain of factory files and URDF: x y z roll pitch yaw, then the joint's rotation.

    T = ∏ Trans(xᵢ, yᵢ, zᵢ) Rz(yawᵢ) Ry(pitchᵢ) Rx(rollᵢ) Rz(qᵢ). Flange poses identify 4 n + 2 of its 6 n parameters
    (26 for six joints): 4 for each joint's axis, a line, and the flange's height and angle on the last one. The other
    2 (n − 1) directions are unidentifiable: a joint's frame can be shifted along and rotated about its own axis, and
    the next joint's origin compensates it.
    """

    dof: int

    base_size = 0

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
        """The places in `names` of the parameters in order of application: yaw before pitch before roll."""
        return (6 * np.arange(self.dof)[:, None] + np.array([0, 1, 2, 5, 4, 3])).ravel()

    @property
    def flags(self) -> np.ndarray:
        """False for every joint, because all have the same parameters."""
        return np.zeros(self.dof, bool)

    def apply_base(self, frame: Frame, values: Array) -> tuple[Frame, tuple[Twist, ...]]:
        """The frame unchanged: no transformation precedes joint 1."""
        return frame, ()

    def step(
        self, frame: Frame, values: Array | tuple[Array, ...], flag: Array, joint: Turn
    ) -> tuple[Frame, tuple[Twist, ...]]:
        """The frame after the origin and the rotation of one joint, and the twists of the joint's parameters."""
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
    """The minimal chain: a base, then standard DH, with Hayati's beta where neighbouring axes are parallel.

    T = Base ∏ Aᵢ, Base = Trans(x, y, 0) Ry(pitch) Rx(roll), Aᵢ = Rz(qᵢ + theta_offᵢ) Tz(dᵢ) Tx(aᵢ) Rx(alphaᵢ);
    for a joint in `parallel` d is zero and Ry(betaᵢ) follows (S. Hayati, CDC 1983). Flange poses identify
    all 4 n + 4 parameters (28 for six joints): 4 for each joint's axis and 4 for the flange on the last one. A flange
    frame that is free in all six coordinates, a general tool, adds two: 4 n + 6 = 30, the full model.

    Attributes:
        dof: number of joints.
        parallel: the joints, counted from 0, whose axis is nominally parallel to the next one's.
    """

    dof: int
    parallel: tuple[int, ...] = ()

    base_size = 4

    def __post_init__(self) -> None:
        if any(not 0 <= i < self.dof - 1 for i in self.parallel) or list(self.parallel) != sorted(set(self.parallel)):
            raise InputError(f"parallel joints {self.parallel}: give each once, in order, from 0 to {self.dof - 2}")

    @property
    def size(self) -> int:
        """4 n + 4."""
        return 4 * self.dof + 4

    @cached_property
    def names(self) -> tuple[str, ...]:
        """`base_x base_y base_roll base_pitch`, `theta_off1 d1 a1 alpha1` …, `beta2` …; beta replaces its joint's d."""
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
        """The places in `names` in order of application: base x, y, pitch, roll; each theta, d or beta, a, alpha."""
        order = ["base_x", "base_y", "base_pitch", "base_roll"]
        for i in range(self.dof):
            order += [f"{name}{i + 1}" for name in ("theta_off", "beta" if i in self.parallel else "d", "a", "alpha")]
        return np.array([self.names.index(name) for name in order])

    @cached_property
    def flags(self) -> np.ndarray:
        """Whether beta replaces d, for each joint."""
        return np.isin(np.arange(self.dof), self.parallel)

    def apply_base(self, frame: Frame, values: Array) -> tuple[Frame, tuple[Twist, ...]]:
        """The frame after the base transformation, and the twists of the base parameters."""
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
        """The frame after the rotation and the link of one joint, and the twists of the joint's parameters."""
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
        """Parameters `(size,)` from base (x, y, roll, pitch), DH table `(joint, 4)` and one beta per parallel joint.

        Raises:
            InputError: a wrong shape, or a non-zero d at a parallel joint.
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
"""The parameterisation of a chain. It is hashable, so that it can be a static argument of a jitted function.

`apply_base` applies the first `base_size` parameters, then `step` an equal number at each joint, which its entry of
`flags` interprets; `walking_order[k]` is the place in `names` of the k-th parameter applied.
"""


def joint_axes(kinematics: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """The joint axes at q = 0 as lines in the base frame: points in m and unit directions, `(..., joint, 3)` each.

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
    """The Hayati form for a nominal six-parameter chain `(joint, 6)`, by the angles between neighbouring axes."""
    _, directions = joint_axes(kinematics)
    sines = np.linalg.norm(np.cross(directions[:-1], directions[1:]), axis=1)
    return HayatiForm(len(directions), tuple(int(i) for i in np.flatnonzero(sines < np.sin(PARALLEL_WITHIN))))
