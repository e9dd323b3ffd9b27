"""Serial chains: the six-parameter chain of factory files and URDF, the Hayati chain, and where they lead.

A form says what a chain's parameters are. Joints are revolute, or prismatic where `sliding` counts them from 0: that is
part of the form, so that it is known when a chain is compiled. `sweep` moves a frame along the chain by elementary
transformations about its own axes. The sample is the last axis of every array, so that each is one vector instruction
over all samples. The joints are a loop, so that neither the compile time nor the recomputation of prefixes grows with
their number.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lite6jax.arms import frames
from lite6jax.arms.se3 import (
    Frame,
    Turn,
    Twist,
    X,
    Y,
    Z,
    base_frame,
    displace,
    frame_transform,
    joint_turn,
    rotate,
    rotation_twist,
    translate,
    turn,
)
from lite6jax.deferred import ArrayLike, JaxArray, jax, jit, jnp, lax
from lite6jax.errors import InputError

PARALLEL_WITHIN = np.deg2rad(5.0)
"""rad; neighbouring axes within this angle of the nominal geometry count as parallel. Assembly tolerances are far
smaller."""
_STEEP = np.cos(np.deg2rad(60.0))
"""Of joint 1's axis along the base's z, as an arm on a table has it; below that another axis of the base is nearer."""


@dataclass(frozen=True)
class SixParameterForm:
    """The chain of factory files and URDF: x y z roll pitch yaw, then the joint's rotation, or its shift along z.

    T = ∏ Trans(xᵢ, yᵢ, zᵢ) Rz(yawᵢ) Ry(pitchᵢ) Rx(rollᵢ) Rz(qᵢ), with Tz(qᵢ) for a prismatic joint. Flange poses
    identify 4 n + 2 of its 6 n parameters for revolute joints (26 for six): 4 for each joint's axis, a line, and the
    flange's height and angle on the last one. The other 2 (n − 1) directions are unidentifiable: a joint's frame can be
    shifted along and rotated about its own axis, and the next joint's origin compensates it. The frame of a prismatic
    joint can be shifted in every direction.

    Attributes:
        dof: number of joints.
        sliding: the prismatic joints, counted from 0.
    """

    dof: int
    sliding: tuple[int, ...] = ()

    base_size = 0

    def __post_init__(self) -> None:
        _require_joints(self.sliding, "sliding", 0, self.dof - 1)

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

    def apply_base(self, frame: Frame, values: JaxArray) -> tuple[Frame, tuple[Twist, ...]]:
        """The frame unchanged: no transformation precedes joint 1."""
        return frame, ()

    def step(
        self, frame: Frame, values: JaxArray | tuple[JaxArray, ...], flag: JaxArray, joint: Turn
    ) -> tuple[Frame, tuple[Twist, ...]]:
        """The frame after the origin and the rotation of one joint, and the twists of the joint's parameters."""
        x, y, z, yaw, pitch, roll = values
        shifts = tuple(Twist(frame[axis], None) for axis in (X, Y, Z))
        frame = translate(translate(translate(frame, X, x), Y, y), Z, z)
        frame, about_z = _turn_frame(frame, Z, yaw)
        frame, about_y = _turn_frame(frame, Y, pitch)
        frame, about_x = _turn_frame(frame, X, roll)
        frame = rotate(frame, Z, joint)
        if joint.shift is not None:
            frame = translate(frame, Z, joint.shift)
        return frame, (*shifts, about_z, about_y, about_x)


@dataclass(frozen=True)
class HayatiForm:
    """The minimal chain: a base, then standard DH, with Hayati's beta where neighbouring axes are parallel.

    T = Base ∏ Aᵢ with Base = Trans(x, y, z) Rz(yaw) Ry(pitch) Rx(roll) P and
    Aᵢ = Rz(qᵢ + theta_offᵢ) Tz(dᵢ) Tx(aᵢ) Rx(alphaᵢ);
    for a joint in `parallel` d is zero and Ry(betaᵢ) follows (S. Hayati, CDC 1983). Flange poses identify
    all 4 n + 4 parameters (28 for six joints): 4 for each joint's axis and 4 for the flange on the last one. A flange
    frame that is free in all six coordinates, a general tool, adds two: 4 n + 6 = 30, the full model.

    The base neither moves along nor turns about its axis `first_axis`, that nearest to joint 1's: d and theta_off of
    joint 1 do. P only renames axes, so that z is that one. Of an arm on a table it is the identity, and the base has
    x, y, roll and pitch; where joint 1's axis is horizontal, along the base's y, it has x, z, roll and yaw.

    Of a prismatic joint the direction matters and the position does not, so that R revolute and P prismatic joints have
    4 R + 2 P + 4 parameters (L. Everett, M. Driels, B. Mooring, ICRA 1987). Its axis is drawn through the origin of the
    frame before it (S. Hayati, M. Mirmirani, J. Robotic Systems 2(4), 1985). In all generality
    Aᵢ = Rz(qᵢ + theta_offᵢ) Tz(dᵢ) Tx(aᵢ) Ty(bᵢ) Rx(alphaᵢ) Ry(betaᵢ), with Rz(theta_offᵢ) Tz(dᵢ + qᵢ) for a prismatic
    joint i, and zero what is not in `names`:

    | the link after joint i leads to | axes not parallel | axes parallel |
    |---|---|---|
    | a revolute joint, i revolute | theta_off d a alpha | theta_off a alpha beta |
    | a revolute joint, i prismatic | theta_off d a alpha | a b alpha beta |
    | a prismatic joint | theta_off alpha | alpha beta |
    | the flange, i revolute | theta_off d a alpha | |
    | the flange, i prismatic | theta_off d a b | |

    The base leads to joint 1: as above to a revolute one, yaw roll to a prismatic one, and roll pitch where that is
    parallel to the base's z.

    Attributes:
        dof: number of joints.
        parallel: the joints, counted from 0, whose axis is nominally parallel to the next one's; -1 where the axis of
            a prismatic first joint is to the base's z.
        sliding: the prismatic joints, counted from 0.
        first_axis: the axis of the base, x y z counted from 0, along which joint 1's is drawn; z of a prismatic one.
    """

    dof: int
    parallel: tuple[int, ...] = ()
    sliding: tuple[int, ...] = ()
    first_axis: int = Z

    def __post_init__(self) -> None:
        _require_joints((self.first_axis,), "first_axis", Z if 0 in self.sliding else X, Z)
        _require_joints(self.sliding, "sliding", 0, self.dof - 1)
        _require_joints(self.parallel, "parallel", -1 if 0 in self.sliding else 0, self.dof - 2)

    @property
    def size(self) -> int:
        """4 R + 2 P + 4."""
        return 4 * self.dof + 4 - 2 * len(self.sliding)

    @property
    def base_size(self) -> int:
        """How many parameters `apply_base` takes."""
        return len(BASE) if self.sliding else 4

    @property
    def T_axes(self) -> np.ndarray:
        """(4, 4) P: the rotation that makes `first_axis` z."""
        P = np.eye(4)
        P[:3, :3] = np.roll(np.eye(3), self.first_axis - Z, 0)
        return P

    def of_link(self, joint: int) -> tuple[str, ...]:
        """The parameters of the link after a joint counted from 0, in order of application; of -1, of the base."""
        last = joint == self.dof - 1
        slides = joint in self.sliding
        parallel = joint in self.parallel
        if joint == -1:
            if 0 not in self.sliding:
                along = "xyz"[self.first_axis]
                about = ("roll", "pitch", "yaw")[self.first_axis]
                return tuple(name for name in BASE if name not in (along, about))
            return ("pitch", "roll") if parallel else ("yaw", "roll")
        if joint + 1 in self.sliding:
            if parallel:
                return ("alpha", "beta")
            return ("theta_off", "alpha")
        if last and slides:
            return "theta_off", "d", "a", "b"
        if parallel:
            if slides:
                return ("a", "b", "alpha", "beta")
            return ("theta_off", "beta", "a", "alpha")
        return "theta_off", "d", "a", "alpha"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """`base_x base_y base_roll base_pitch`, `theta_off1 d1 a1 alpha1` …, `beta2` …; beta replaces its joint's d."""
        base = [f"base_{name}" for name in ("x", "y", "z", "yaw", "roll", "pitch") if name in self.of_link(-1)]
        links = [f"{name}{i + 1}" for i in range(self.dof) for name in LINK[:-1] if name in self.of_link(i)]
        return (*base, *links, *(f"beta{i + 1}" for i in self.parallel if i >= 0))

    @cached_property
    def _places(self) -> np.ndarray:
        """`(size,)`, where each of `names` stands in `BASE` followed by `LINK` of every joint."""
        all_names = [*(f"base_{name}" for name in BASE), *(f"{name}{i + 1}" for i in range(self.dof) for name in LINK)]
        return np.array([all_names.index(name) for name in self.names])

    @cached_property
    def units(self) -> tuple[str, ...]:
        """`m` or `rad` for each."""
        lengths = ("x", "y", "z", "d", "a", "b")
        return tuple("m" if n.removeprefix("base_").rstrip("0123456789") in lengths else "rad" for n in self.names)

    @cached_property
    def walking_order(self) -> np.ndarray:
        """The places in `names` in order of application: of the base, then each theta, d or beta, a, alpha.

        With prismatic joints: `BASE`; each theta, d, a, b, alpha, beta; `size` for what is zero.
        """
        links = [LINK] * self.dof if self.sliding else [self.of_link(i) for i in range(self.dof)]
        order = [f"base_{name}" for name in self._applied_base]
        order += [f"{name}{i + 1}" for i, link in enumerate(links) for name in link]
        return np.array([self.names.index(name) if name in self.names else self.size for name in order])

    @cached_property
    def flags(self) -> np.ndarray:
        """Flags `(joint,)`, true where beta replaces d."""
        return np.isin(np.arange(self.dof), self.parallel)

    def apply_base(self, frame: Frame, values: JaxArray) -> tuple[Frame, tuple[Twist, ...]]:
        """The frame after the base transformation, and the twists of the base parameters."""
        twists = []
        for name, by in zip(self._applied_base, values, strict=True):
            if name in "xyz":
                axis = "xyz".index(name)
                twists.append(Twist(frame[axis], None))
                frame = translate(frame, axis, by)
            else:
                frame, twist = _turn_frame(frame, ("roll", "pitch", "yaw").index(name), by)
                twists.append(twist)
        x, y, z = (frame[(self.first_axis + i) % 3] for i in (1, 2, 3))
        return Frame(x, y, z, frame.origin), tuple(twists)

    @property
    def _applied_base(self) -> tuple[str, ...]:
        return BASE if self.sliding else self.of_link(-1)

    def step(
        self, frame: Frame, values: JaxArray | tuple[JaxArray, ...], flag: JaxArray, joint: Turn
    ) -> tuple[Frame, tuple[Twist, ...]]:
        """The frame after the motion and the link of one joint, and the twists of the joint's parameters."""
        theta = values[0]
        offset = turn(theta)
        about_z = rotation_twist(frame, Z)
        along_z = frame.z
        frame = rotate(
            frame,
            Z,
            Turn(joint.cos * offset.cos - joint.sin * offset.sin, joint.sin * offset.cos + joint.cos * offset.sin),
        )
        along_x = Twist(frame.x, None)
        along_y = Twist(frame.y, None)
        if joint.shift is not None:
            _, d, a, b, alpha, beta = values
            frame = translate(translate(translate(frame, Z, d + joint.shift), X, a), Y, b)
        else:
            _, second, a, alpha = values
            d = jnp.where(flag, 0.0, second)
            beta = jnp.where(flag, second, 0.0)
            frame = translate(translate(frame, Z, d), X, a)
        frame, about_x = _turn_frame(frame, X, alpha)
        frame, about_y = _turn_frame(frame, Y, beta)
        if joint.shift is not None:
            return frame, (about_z, Twist(along_z, None), along_x, along_y, about_x, about_y)
        d_or_beta = Twist(jnp.where(flag, about_y.linear, along_z), jnp.where(flag, frame.y, 0.0))
        return frame, (about_z, d_or_beta, along_x, about_x)

    def pack(self, base: npt.ArrayLike, links: npt.ArrayLike) -> np.ndarray:
        """Parameters `(..., size)` from those of bases `(..., 6)`, `BASE`, and of links `(..., joint, 6)`, `LINK`.

        Raises:
            InputError: a wrong shape, or a number that is not zero where the form has no parameter.
        """
        base = np.asarray(base, float)
        links = np.asarray(links, float)
        if base.shape[-1:] != (len(BASE),) or links.shape[-2:] != (self.dof, len(LINK)):
            raise InputError(f"base {base.shape}, links {links.shape}: this form takes (6,) and ({self.dof}, 6)")
        full_parameters = np.concatenate([base, links.reshape(*links.shape[:-2], -1)], -1)
        for place in np.setdiff1d(np.arange(full_parameters.shape[-1]), self._places):
            if np.any(full_parameters[..., place]):
                joint, k = divmod(place - len(BASE), len(LINK))
                name = f"base_{BASE[place]}" if joint < 0 else f"{LINK[k]}{joint + 1}"
                value = np.abs(full_parameters[..., place]).max()
                raise InputError(f"{name} is {value:g}, and this form has no such parameter; its are {self.names}")
        return full_parameters[..., self._places]

    def unpack(self, parameters: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """The inverse of `pack` for `(size,)`: base `(6,)` and links `(joint, 6)`, zero where there is no parameter."""
        parameters = np.asarray(parameters, float)
        if parameters.shape != (self.size,):
            raise InputError(f"parameters of shape {parameters.shape}: this form takes ({self.size},)")
        full_parameters = np.zeros(len(BASE) + self.dof * len(LINK))
        full_parameters[self._places] = parameters
        return full_parameters[: len(BASE)], full_parameters[len(BASE) :].reshape(self.dof, len(LINK))


BASE = ("x", "y", "z", "yaw", "pitch", "roll")
"""The parameters of any base, in order of application."""
LINK = ("theta_off", "d", "a", "b", "alpha", "beta")
"""The parameters of any link, in order of application."""
DH_COLUMNS = [0, 1, 2, 4]
"""The columns of `LINK` that a DH table has: theta_off d a alpha."""


def _turn_frame(frame: Frame, axis: int, angle: JaxArray) -> tuple[Frame, Twist]:
    """The frame turned about its own axis by rad, and the twist of that angle."""
    return rotate(frame, axis, turn(angle)), rotation_twist(frame, axis)


def _require_joints(joints: tuple[int, ...], kind: str, first: int, last: int) -> None:
    if any(not first <= i <= last for i in joints) or list(joints) != sorted(set(joints)):
        raise InputError(f"{kind} joints {joints}: give each once, in order, from {first} to {last}")


Form = HayatiForm | SixParameterForm
"""The parameterisation of a chain. It is hashable, so that it can be a static argument of a jitted function.

`apply_base` applies the first `base_size` parameters, then `step` an equal number at each joint, which its entry of
`flags` interprets; `walking_order[k]` is the place in `names` of the k-th parameter applied, and `size` where that is
always zero.
"""


def joint_motion(form: Form, position: npt.ArrayLike) -> Turn:
    """The motions of a chain's joints at positions `(..., joint, sample)`, rad and for prismatic joints m."""
    return joint_turn(jnp.asarray(position, float), form.sliding)


def hayati_form_of(kinematics: npt.ArrayLike, sliding: tuple[int, ...] = ()) -> HayatiForm:
    """The Hayati form for a nominal six-parameter chain `(joint, 6)`, by the directions of its axes."""
    directions = frames.frames_at_zero(kinematics)[:, :3, Z]
    sines = np.linalg.norm(np.cross(directions[:-1], directions[1:]), axis=1)
    parallel = tuple(int(i) for i in np.flatnonzero(sines < np.sin(PARALLEL_WITHIN)))
    if 0 in sliding and np.hypot(*directions[0, :2]) < np.sin(PARALLEL_WITHIN):
        parallel = (-1, *parallel)
    lies = 0 not in sliding and abs(directions[0, Z]) < _STEEP
    return HayatiForm(len(directions), parallel, sliding, int(np.argmax(np.abs(directions[0, :2]))) if lies else Z)


class Bend(NamedTuple):
    """Displacements of the frames of a six-parameter chain, sample by sample; None stands for zero.

    Attributes:
        stretch: `(joint, sample)`, the relative growth of the vector to each joint's origin.
        twist: `(joint, 6, sample)` m and rad, by which `displace` moves each frame after its joint's rotation.
    """

    stretch: JaxArray | None = None
    twist: JaxArray | None = None


def sweep(
    form: Form,
    parameters: JaxArray,
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
    of_frame = []
    if emit is not None:
        of_frame = [jax.tree.map(lambda leaf: leaf[None], emit(twist)) for twist in twists]

    def walk(frame: Frame, at: tuple[JaxArray, JaxArray, Turn, Bend]) -> tuple[Frame, tuple[Any, ...]]:
        values, flag, motion, bent = at
        if bent.stretch is not None:
            values = (*((1 + bent.stretch) * value for value in values[:3]), *values[3:])
        frame, twists = form.step(frame, values, flag, motion)
        if bent.stretch is not None:
            twists = (*(Twist((1 + bent.stretch) * twist.linear, None) for twist in twists[:3]), *twists[3:])
        if bent.twist is not None:
            frame = displace(frame, bent.twist)
        return frame, () if emit is None else tuple(emit(twist) for twist in twists)

    per_joint = (steps, jnp.asarray(form.flags), joint, Bend() if bend is None else bend)
    frame, of_joints = lax.scan(walk, frame, per_joint)
    return frame, [*of_frame, *of_joints]


def sweep_order(form: Form) -> np.ndarray:
    """The place in `form.names` of the parameter of each result of `sweep`, `form.size` where it is always zero."""
    of_joints = form.walking_order[form.base_size :].reshape(form.dof, -1)
    return np.concatenate([form.walking_order[: form.base_size], of_joints.T.ravel()])


def link_frames(form: Form, parameters: JaxArray, joint: Turn, start: Frame) -> Frame:
    """The frame after each joint's motion, in the coordinates of `start`; its leaves are `(joint, 3, sample)`."""
    of_base, steps = _in_order(form, parameters)

    def walk(frame: Frame, at: tuple[JaxArray, JaxArray, Turn]) -> tuple[Frame, Frame]:
        frame, _ = form.step(frame, *at)
        return frame, frame

    return lax.scan(walk, form.apply_base(start, of_base)[0], (steps, jnp.asarray(form.flags), joint))[1]


def _in_order(form: Form, parameters: JaxArray) -> tuple[JaxArray, JaxArray]:
    """The parameters of the base `(base_size,)`, and those of the joints `(joint, …)`, in order of application."""
    if form.walking_order.max() == form.size:  # a parameter that is always zero
        parameters = jnp.append(parameters, 0.0)
    values = parameters[form.walking_order]
    return values[: form.base_size], values[form.base_size :].reshape(form.dof, -1)


@partial(jit, static_argnums=0)
def fk(form: Form, parameters: ArrayLike, joint_position: ArrayLike) -> JaxArray:
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
    return frame_transform(frame).reshape(*q.shape[:-1], 4, 4)


def six_parameter_fk(kinematics: ArrayLike, joint_position: ArrayLike, sliding: tuple[int, ...] = ()) -> JaxArray:
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


def hayati_fk(form: HayatiForm, parameters: ArrayLike, joint_position: ArrayLike) -> JaxArray:
    """The flange poses of a Hayati chain.

    Args:
        form: the Hayati form.
        parameters: `(size,)` m and rad, in the order of `form.names`.
        joint_position: `(..., joint)` rad, and m of prismatic joints.

    Returns:
        `(..., 4, 4)` T_base_flange, m.
    """
    return fk(form, parameters, joint_position)
