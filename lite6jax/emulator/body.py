"""The arm under the controller: what its kinematics say, what holds it up, and where it truly is."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.factory import recognise
from lite6jax.controller import protocol
from lite6jax.effects.composition import Physics
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import STANDARD_GRAVITY, Inertia, inertia_of
from lite6jax.errors import InputError
from lite6jax.model import ArmModel, predict_poses

Array = NDArray[np.floating]

TYPES = {"lite6": 9, "xarm5": 5, "xarm6": 6, "xarm7": 7, "uf850": 12}
"""The vendor's numbers of the bundled arms that have such a controller."""

SPACING_S = 0.02
"""Of the samples around a block that an effect of the clock looks at."""
LONGEST_OFFSET_S = 1.0
MOST_WARM_UP = 100.0
"""K; reports hold temperatures from -128 to 127 °C."""
BLOCK = 128
"""Samples that are compiled for; fewer are filled up."""


class Sample(NamedTuple):
    """The body over some instants; each `(sample, joint)` but time `(sample,)` s."""

    time: Array
    position: Array
    velocity: Array
    direction: Array


class Carried(NamedTuple):
    """What is at the flange; `Body.carrying` makes it.

    Attributes:
        T_flange_tool: `(4, 4)` m.
        payload: kg.
        center: `(3,)` m, the payload's centre of mass in the last joint's frame.
        model: the chain to the tool.
        inertia: the masses, where they are known.
    """

    T_flange_tool: Array
    payload: float
    center: Array
    model: ArmModel
    inertia: Inertia | None


@dataclass(frozen=True, eq=False)
class Body:
    """An emulated arm. Immutable: where it stands is the timeline's business.

    Attributes:
        arm: the nominal arm: limits, masses, flange.
        kinematics: `(joint, 6)` its own chain, m and rad: what register 8 gives, and so rounded to fp32.
        physics: what it does beyond that chain, which its controller does not know.
        values: `(physics.size,)`.
        warm_up: K by which it warms up in the end, with a time constant of 20 min from 25 °C.

    Raises:
        InputError: an arm that has no such controller, a chain or values of another size, physics that this arm
            cannot show, or a warm-up that no report holds.
    """

    arm: Arm
    kinematics: Array
    physics: Physics = Physics()  # noqa: RUF009 (frozen)
    values: Array = field(default_factory=lambda: np.zeros(0))
    warm_up: float = 12.0

    def __post_init__(self) -> None:
        if self.arm.dof not in (5, 6, 7):
            raise InputError(f"{self.arm.name}: has {self.arm.dof} joints, and a UFACTORY controller drives 5, 6 or 7")
        object.__setattr__(self, "kinematics", self.kinematics.astype(np.float32).astype(float))
        if self.kinematics.shape != (self.arm.dof, 6):
            raise InputError(
                f"{self.arm.name}: a calibration {self.kinematics.shape}; it must be {(self.arm.dof, 6)}: give this "
                "arm's own"
            )
        if self.values.shape != (self.physics.size,):
            raise InputError(f"{self.arm.name}: {self.values.size} values of effects that take {self.physics.size}")
        if not abs(self.warm_up) <= MOST_WARM_UP:
            raise InputError(
                f"{self.arm.name}: warms up by {self.warm_up:g} K; give at most {MOST_WARM_UP:g} either way"
            )
        if abs(self.clock_offset) > LONGEST_OFFSET_S:
            raise InputError(f"time_offset: an emulator looks {LONGEST_OFFSET_S:g} s ahead at most; give a smaller one")
        if self.physics.effects:
            zero = np.zeros((1, self.arm.dof))
            self.physics.check(self._motion(Sample(np.zeros(1), zero, zero, zero), 0.0, 1), self.arm.mass is not None)

    @cached_property
    def type(self) -> int:
        """The vendor's number of the model; that of the xArm of as many joints where it is none of the vendor's."""
        if self.arm.name in TYPES:
            return TYPES[self.arm.name]
        names = [f"joint{i + 1}" for i in range(self.arm.dof)]
        try:
            model = recognise(self.arm.kinematics, names, self.arm.name, None, self.arm.T_joint_flange).name
        except InputError:
            return self.arm.dof
        return TYPES.get(model, self.arm.dof)

    @property
    def clock_offset(self) -> float:
        """s by which an effect of the clock shifts what is seen."""
        offsets = [
            values[0]
            for effect, values in zip(self.physics.effects, self._split, strict=True)
            if effect.name == "time_offset"
        ]
        return float(sum(offsets))

    @property
    def _split(self) -> list[Array]:
        return [self.values[part] for part in self.physics.slices]

    @cached_property
    def _links(self) -> Array:
        return np.stack([frames.transform_from_row(row) for row in self.kinematics])

    def flange(self, q: ArrayLike, nominal: bool = False) -> Array:
        """`(..., 4, 4)` T_base_flange that the controller computes for `(..., joint)` rad, from one chain or other."""
        return frames.chain(self.arm.links if nominal else self._links, q) @ self.arm.T_joint_flange

    def joint_frames(self, q: Array) -> Array:
        """`(joint, ..., 4, 4)` the frame after each joint's rotation in the base's."""
        turns = frames.joint_rotations(q)
        T, found = np.eye(4), []
        for i, link in enumerate(self._links):
            T = T @ link @ turns[..., i, :, :]
            found.append(T)
        return np.stack(found)

    def carrying(self, T_flange_tool: Array, payload: float, center: Array) -> "Carried":
        """The tool and the payload at the flange, made ready for what is asked often.

        Args:
            T_flange_tool: `(4, 4)` m.
            payload: kg.
            center: `(3,)` m, its centre of mass in the flange's frame.
        """
        T_flange = self.arm.T_joint_flange
        held = T_flange[:3, :3] @ center + T_flange[:3, 3]
        inertia = None
        if self.arm.mass is not None and self.arm.center_of_mass is not None:
            inertia = inertia_of(self.arm.mass, self.arm.center_of_mass, held)
        arrays: Any = (self.kinematics.ravel(), np.eye(4), T_flange @ T_flange_tool)  # become JAX's at the call
        return Carried(T_flange_tool, payload, held, ArmModel(*arrays), inertia)

    def holding_torque(self, q: Array, carried: "Carried") -> Array:
        """`(sample, joint)` N·m with which the motors hold `(sample, joint)` rad; zero where masses are unknown."""
        if self.arm.mass is None or self.arm.center_of_mass is None:
            return np.zeros_like(q)
        T = self.joint_frames(q)
        R, o = T[..., :3, :3], T[..., :3, 3]
        mass = self.arm.mass[:, None, None]
        moment = mass * ((R @ self.arm.center_of_mass[:, None, :, None])[..., 0] + o)
        moment[-1] += carried.payload * (R[-1] @ carried.center + o[-1])
        outboard = np.cumsum(moment[::-1], axis=0)[::-1]
        weight = np.cumsum(mass[::-1], axis=0)[::-1] + carried.payload
        pull = np.cross(outboard - weight * o, np.array(STANDARD_GRAVITY))
        return -np.sum(R[..., :, 2] * pull, -1).T

    def temperature(self, time: Array, reference: float = 25.0) -> Array:
        """`(sample, joint)` °C, the last joint at 0.8 of the first's rise."""
        rise = self.warm_up * -np.expm1(-np.asarray(time) / 1200.0)
        return reference + np.outer(rise, np.linspace(1.0, 0.8, self.arm.dof))

    def true_poses(self, sample: Sample, carried: "Carried") -> Array:
        """`(sample, 4, 4)` where the tool truly is: with the physics.

        Args:
            sample: `BLOCK` instants at most; where the clock is off, with those of `clock_offset` before and after what
                is asked for, which the caller cuts away.
            carried: tool and payload.
        """
        if not self.physics.effects:
            return self.flange(sample.position) @ carried.T_flange_tool
        motion = self._motion(sample, carried.payload, BLOCK)
        form = SixParameterForm(self.arm.dof)
        poses = predict_poses(form, self.physics, carried.model, self.values, motion, carried.inertia)
        return np.asarray(poses)[: len(sample.time)]

    def _motion(self, sample: Sample, payload: float, size: int) -> Motion:
        """The samples, filled up with the last one to `size`."""
        pad = ((0, size - len(sample.time)), (0, 0))
        position, velocity, direction, temperature = (
            np.pad(values, pad, "edge").T for values in (*sample[1:], self.temperature(sample.time) - 25.0)
        )
        # beyond the last sample the clock goes on, so that times stay in order
        ahead = np.arange(1, size - len(sample.time) + 1) * SPACING_S
        time = np.concatenate([sample.time, sample.time[-1] + ahead])
        run = np.stack([np.zeros(size, int), np.full(size, len(sample.time) - 1)])
        # NumPy's arrays become JAX's at the call
        arrays: Any = (position, velocity, direction, time, run, temperature.mean(0), np.full(size, payload))
        return Motion(*arrays)

    def inverse(self, goal: Array, reference: Array, limited: bool = True) -> Array | None:
        """`(joint,)` rad that bring the flange to `goal` `(4, 4)`: near the reference if it can be, else the nearest.

        Gauss-Newton with a little damping, from the reference and, where that ends elsewhere, from 64 other places.

        Args:
            goal: T_base_flange.
            reference: `(joint,)` rad.
            limited: whether joints stay within their limits.

        Returns:
            None where there is no such position.
        """
        lower, upper = self.arm.joint_limits.T
        rng = np.random.default_rng(0)
        elsewhere = rng.uniform(np.maximum(lower, -np.pi), np.minimum(upper, np.pi), (64, self.arm.dof))
        for starts in (reference[None], elsewhere):
            q = self._approach(goal, starts)
            q = q + 2 * np.pi * np.round((reference - q) / (2 * np.pi))
            if limited:
                q = q - 2 * np.pi * (q > upper + 1e-9) + 2 * np.pi * (q < lower - 1e-9)
                q = q[((q >= lower - 1e-9) & (q <= upper + 1e-9)).all(axis=1)]
            if len(q):
                return q[np.argmin(np.abs(q - reference).max(axis=1))]
        return None

    def _approach(self, goal: Array, q: Array) -> Array:
        """Those of the starts `(start, joint)` that arrive, where they arrive."""
        for _ in range(60):
            T = self.joint_frames(q)
            flange = T[-1] @ self.arm.T_joint_flange
            error = _twist(flange, goal)
            axis = np.moveaxis(T[..., :3, 2], 0, -1)
            lever = flange[..., :3, 3, None] - np.moveaxis(T[..., :3, 3], 0, -1)
            J = np.concatenate([np.cross(axis, lever, axis=1), _REACH * axis], axis=1)
            normal = np.swapaxes(J, 1, 2) @ J + 1e-9 * np.eye(q.shape[1])
            step = np.linalg.solve(normal, np.swapaxes(J, 1, 2) @ error[..., None])[..., 0]
            q = q + step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / 0.5)
        return q[np.linalg.norm(_twist(self.flange(q), goal), axis=1) < 1e-8]


_REACH = 0.1
"""m per rad: what weighs as much of a turn as of a translation."""


def _twist(here: Array, goal: Array) -> Array:
    """`(..., 6)` from one frame to another: translation in m, rotation vector in rad times `_REACH`."""
    R = goal[:3, :3] @ np.swapaxes(here[..., :3, :3], -1, -2)
    axis = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, (np.trace(R, axis1=-2, axis2=-1)[..., None] - 1) / 2)
    turn = axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 1.0)
    return np.concatenate([goal[:3, 3] - here[..., :3, 3], _REACH * turn], -1)


def identity_of(body: Body, firmware: Sequence[int], says: tuple[int, int] | None = None) -> protocol.Identity:
    """What register 1 says of a body, or of the (axes, type) it says it is."""
    dof, kind = says or (body.arm.dof, body.type)
    major, minor, patch = firmware
    prefix = {9: "LI", 12: "FX"}.get(kind, "XI")
    return protocol.Identity(dof, kind, f"{prefix}1006", "DL1000" if kind == 9 else "AC1300", (major, minor, patch))
