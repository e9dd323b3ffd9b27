"""The emulated arm: its kinematics, motors, temperature and true poses."""

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
from lite6jax.effects.statics import Inertia, inertia_of
from lite6jax.emulator.motors import Hidden, Motors, inertial_numbers, seen_by_motors
from lite6jax.errors import InputError
from lite6jax.model import ArmModel, predict_poses

Array = NDArray[np.floating]

TYPES = {"lite6": 9, "xarm5": 5, "xarm6": 6, "xarm7": 7, "uf850": 12}
"""The vendor's numbers of the bundled models that have such a controller."""

SPACING_S = 0.02
"""s, the spacing of the samples around a block that a clock offset requires."""
LONGEST_OFFSET_S = 1.0
"""s, the largest clock offset."""
MOST_WARM_UP = 100.0
"""K; the temperatures of reports range from -128 to 127 °C."""
BLOCK = 128
"""The number of samples of the compiled prediction; shorter blocks are padded."""


class Sample(NamedTuple):
    """The joints at instants `time` `(sample,)` s: positions, velocities and directions, each `(sample, joint)`."""

    time: Array
    position: Array
    velocity: Array
    direction: Array


class Carried(NamedTuple):
    """Tool and payload at the flange, from `Body.carrying`.

    Attributes:
        T_flange_tool: `(4, 4)` m.
        payload: kg.
        center: `(3,)` m, the payload's centre of mass in the last joint's frame.
        model: the chain up to the tool.
        inertia: the masses, or None if they are unknown.
    """

    T_flange_tool: Array
    payload: float
    center: Array
    model: ArmModel
    inertia: Inertia | None


@dataclass(frozen=True, eq=False)
class Body:
    """An emulated arm. Immutable: its motion is in the timeline.

    Attributes:
        arm: the nominal arm: limits, masses, flange.
        kinematics: `(joint, 6)` its calibrated chain, m and rad, rounded to fp32 as in register 8.
        physics: the effects beyond that chain, which the kinematics of the controller do not include.
        values: `(physics.size,)`.
        warm_up: K, the final temperature rise from 25 °C, with a time constant of 20 min.
        torque_effects: what adds to the torques of the motors, each with its values.
        torque_noise: `(joint,)` Nm, one sigma of torques as they are read; without noise they are what a controller
            computes from a model. Empty for none.

    Raises:
        InputError: an arm without such a controller or with prismatic joints, a chain, values or noise of the wrong
            size, effects that this arm cannot have, or a warm-up beyond the range of reports.
    """

    arm: Arm
    kinematics: Array
    physics: Physics = Physics()  # noqa: RUF009 (frozen)
    values: Array = field(default_factory=lambda: np.zeros(0))
    warm_up: float = 12.0
    torque_effects: tuple[Hidden, ...] = ()
    torque_noise: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if self.arm.dof not in (5, 6, 7):
            raise InputError(f"{self.arm.name}: has {self.arm.dof} joints, but a UFACTORY controller drives 5, 6 or 7")
        if self.arm.sliding:
            raise InputError(
                f"{self.arm.name}: joint {self.arm.sliding[0] + 1} is prismatic, and a UFACTORY controller drives "
                "revolute joints (its linear track is no joint of the arm); name the chain without it, such as "
                "robot.urdf#base:tip, or make recordings of the whole arm with `lite6jax simulate`"
            )
        object.__setattr__(self, "kinematics", self.kinematics.astype(np.float32).astype(float))
        if self.kinematics.shape != (self.arm.dof, 6):
            raise InputError(
                f"{self.arm.name}: a calibration {self.kinematics.shape}; it must be {(self.arm.dof, 6)}: give that "
                "of this arm"
            )
        if self.values.shape != (self.physics.size,):
            raise InputError(f"{self.arm.name}: {self.values.size} values of effects that take {self.physics.size}")
        noise = self.torque_noise if self.torque_noise.size else np.zeros(self.arm.dof)
        object.__setattr__(self, "torque_noise", noise)
        if noise.shape != (self.arm.dof,) or not ((noise >= 0) & np.isfinite(noise)).all():
            raise InputError(f"{self.arm.name}: the noise of torques; give one Nm per joint, {self.arm.dof}, 0 or more")
        if not abs(self.warm_up) <= MOST_WARM_UP:
            raise InputError(
                f"{self.arm.name}: warms up by {self.warm_up:g} K; give at most {MOST_WARM_UP:g} either way"
            )
        if abs(self.clock_offset) > LONGEST_OFFSET_S:
            raise InputError(f"time_offset: an emulator supports at most {LONGEST_OFFSET_S:g} s; give a smaller offset")
        if self.physics.effects:
            zero = np.zeros((1, self.arm.dof))
            self.physics.check(self._motion(Sample(np.zeros(1), zero, zero, zero), 0.0, 1), self.arm.mass is not None)
        for effect, _ in self.torque_effects:
            if effect.joints_needed > self.arm.dof:
                raise InputError(
                    f"{effect.label}: acts at joint {effect.joints_needed}, but the arm has {self.arm.dof} joints; "
                    "choose one of them"
                )
        if self.torque_effects and self.arm.mass is None:
            raise InputError(f"{self.arm.name}: has no masses, which torques need; add `inertial` to its description")
        if np.abs(self.motors.offsets).max() > LONGEST_OFFSET_S:
            raise InputError(
                f"{self.arm.name}: an emulator's torques are at most {LONGEST_OFFSET_S:g} s late or early; give a "
                "smaller time_offset or torque_lag"
            )

    @cached_property
    def type(self) -> int:
        """The vendor's number of the model; for other arms that of the xArm with as many joints."""
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
        """s, the sum of the clock offsets."""
        offsets = [
            values[0]
            for effect, values in zip(self.physics.effects, self._split, strict=True)
            if effect.name == "time_offset"
        ]
        return float(sum(offsets))

    @cached_property
    def motors(self) -> Motors:
        """With effects on torques, and those on poses that motors see as well."""
        both = zip(self.physics.effects, self._split, strict=True)
        shared = [hidden for effect, values in both for hidden in seen_by_motors(effect, values)]
        numbers = inertial_numbers(self.arm)
        return Motors(self._links, numbers, (*self.torque_effects, *shared), self.torque_noise)

    @property
    def _split(self) -> list[Array]:
        return [self.values[part] for part in self.physics.slices]

    @cached_property
    def _links(self) -> Array:
        return np.stack([frames.transform_from_row(row) for row in self.kinematics])

    def flange(self, q: ArrayLike, nominal: bool = False) -> Array:
        """`(..., 4, 4)` T_base_flange at `(..., joint)` rad by the calibrated or the nominal chain."""
        return frames.chain(self.arm.links if nominal else self._links, q) @ self.arm.T_joint_flange

    def joint_frames(self, q: Array) -> Array:
        """`(joint, ..., 4, 4)` the frame after each joint's rotation, in the base frame."""
        turns = frames.joint_motions(q)
        T, found = np.eye(4), []
        for i, link in enumerate(self._links):
            T = T @ link @ turns[..., i, :, :]
            found.append(T)
        return np.stack(found)

    def carrying(self, T_flange_tool: Array, payload: float, center: Array) -> "Carried":
        """Tool and payload at the flange with the quantities derived from them.

        Args:
            T_flange_tool: `(4, 4)` m.
            payload: kg.
            center: `(3,)` m, its centre of mass in the flange's frame.
        """
        T_flange = self.arm.T_joint_flange
        payload_center = T_flange[:3, :3] @ center + T_flange[:3, 3]
        inertia = None
        if self.arm.mass is not None and self.arm.center_of_mass is not None:
            inertia = inertia_of(self.arm.mass, self.arm.center_of_mass, payload_center)
        arrays: Any = (self.kinematics.ravel(), np.eye(4), T_flange @ T_flange_tool)  # JAX converts them at the call
        return Carried(T_flange_tool, payload, payload_center, ArmModel(*arrays), inertia)

    def torque(self, sample: Sample, acceleration: Array, carried: "Carried") -> Array:
        """`(sample, joint)` N·m that the motors exert about +z of the joints, without noise; zero without masses.

        Args:
            sample: the joints.
            acceleration: `(sample, joint)` rad/s².
            carried: tool and payload.
        """
        if self.arm.mass is None:
            return np.zeros_like(sample.position)
        rise = self.temperature(sample.time).T - 25.0
        count = len(sample.time)
        arrays: Any = (  # NumPy arrays, of which all here is made
            *(part.T for part in sample[1:]),
            sample.time,
            np.stack([np.zeros(count, int), np.full(count, count - 1)]),
            rise.mean(0),
            np.full(count, carried.payload),
            acceleration.T,
            rise,
        )
        return self.motors.torque(Motion(*arrays), carried.center)

    def temperature(self, time: Array, reference: float = 25.0) -> Array:
        """`(sample, joint)` °C; the rise decreases linearly to 0.8 of the first joint's at the last joint."""
        rise = self.warm_up * -np.expm1(-np.asarray(time) / 1200.0)
        return reference + np.outer(rise, np.linspace(1.0, 0.8, self.arm.dof))

    def true_poses(self, sample: Sample, carried: "Carried") -> Array:
        """`(sample, 4, 4)` the true poses of the tool, with all effects.

        Args:
            sample: at most `BLOCK` instants. With a clock offset they include those of `clock_offset` before and after
                the requested ones, which the caller removes.
            carried: tool and payload.
        """
        if not self.physics.effects:
            return self.flange(sample.position) @ carried.T_flange_tool
        motion = self._motion(sample, carried.payload, BLOCK)
        form = SixParameterForm(self.arm.dof)
        poses = predict_poses(form, self.physics, carried.model, self.values, motion, carried.inertia)
        return np.asarray(poses)[: len(sample.time)]

    def _motion(self, sample: Sample, payload: float, size: int) -> Motion:
        """The samples, padded with the last one to `size`."""
        pad = ((0, size - len(sample.time)), (0, 0))
        position, velocity, direction, temperature = (
            np.pad(values, pad, "edge").T for values in (*sample[1:], self.temperature(sample.time) - 25.0)
        )
        # the times of the padding increase, because times must be in order
        ahead = np.arange(1, size - len(sample.time) + 1) * SPACING_S
        time = np.concatenate([sample.time, sample.time[-1] + ahead])
        run = np.stack([np.zeros(size, int), np.full(size, len(sample.time) - 1)])
        # JAX converts NumPy arrays at the call
        arrays: Any = (position, velocity, direction, time, run, temperature.mean(0), np.full(size, payload))
        return Motion(*arrays)


def identity_of(body: Body, firmware: Sequence[int], stated: tuple[int, int] | None = None) -> protocol.Identity:
    """The content of register 1 for a body, or for the (axes, type) that a fault states."""
    dof, kind = stated or (body.arm.dof, body.type)
    major, minor, patch = firmware
    prefix = {9: "LI", 12: "FX"}.get(kind, "XI")
    return protocol.Identity(dof, kind, f"{prefix}1006", "DL1000" if kind == 9 else "AC1300", (major, minor, patch))
