"""The emulated arm: its kinematics, its true poses, and the torques of its motors."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.dynamics import link_parameters
from lite6jax.array_types import Array
from lite6jax.controller import protocol
from lite6jax.domains.torque.rows import RigidBodies
from lite6jax.domains.tracking.predict import DiagnosedServos
from lite6jax.effects.composition import Physics
from lite6jax.effects.dynamic import (
    Delaying,
    PayloadTorque,
    Scaling,
    TorqueEffect,
    TorqueTimeOffset,
)
from lite6jax.effects.effect import Effect
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import STANDARD_GRAVITY, Inertia, inertia_of
from lite6jax.errors import InputError
from lite6jax.model import ArmModel, predict_poses

TYPES = {"lite6": 9, "lite6_ros": 9, "uf850": 12}
"""The vendor's numbers of the bundled models that are no xArms."""
SPACING_S = 0.02
"""s, between the instants at which directions of motion are looked at, and between those of padding."""
LONGEST_OFFSET_S = 1.0
"""s, the largest clock offset."""
MOST_WARM_UP = 100.0
"""K; the temperatures of reports range from -128 to 127 °C."""
BLOCK = 128
"""The number of samples of the compiled prediction; shorter blocks are padded."""
_GRAVITY = np.array(STANDARD_GRAVITY)
_CAUSES_OF_BOTH = {kind.name: kind for kind in (PayloadTorque, TorqueTimeOffset)}
"""Causes that a sensor of poses and one of torques both see: the same payload and the same clock."""


class Sample(NamedTuple):
    """The joints at instants `time` `(sample,)` s: positions, velocities and directions, each `(sample, joint)`."""

    time: Array
    position: Array
    velocity: Array
    direction: Array


class Load(NamedTuple):
    """Tool `(4, 4)` m at the flange, payload in kg, and its centre of mass `(3,)` m in the last joint's frame."""

    T_flange_tool: Array
    payload: float
    center: Array


@dataclass(frozen=True, eq=False)
class EmulatedArm:
    """An emulated arm.

    Attributes:
        arm: the nominal arm: limits, masses, flange.
        kinematics: `(joint, 6)` its calibrated chain, m and rad, rounded to fp32 as in register 8.
        physics: the effects beyond that chain, which the kinematics of the controller do not include.
        values: `(physics.size,)`.
        warm_up: K, the final temperature rise from 25 °C, with a time constant of 20 min.
        torque_effects: what adds to the torques of the motors, each with its values.
        torque_noise: `(joint,)` Nm, one sigma of torques as they are read; without noise they are what a controller
            computes from a model. Empty for none.
        servos: the arm with its servos, the payload that the controller is given, and the effects on how it follows its
            commands. None for joints that are where they were commanded a little before.

    Raises:
        InputError: an arm without such a controller or with prismatic joints, a chain, values or noise of the wrong
            size, effects that this arm cannot have, or a warm-up beyond the range of reports.
    """

    arm: Arm
    kinematics: Array
    physics: Physics = Physics()  # noqa: RUF009 (frozen)
    values: Array = field(default_factory=lambda: np.zeros(0))
    warm_up: float = 12.0
    torque_effects: Sequence[tuple[TorqueEffect, Array]] = ()
    torque_noise: Array = field(default_factory=lambda: np.zeros(0))
    servos: DiagnosedServos | None = None

    def __post_init__(self) -> None:
        name = self.arm.name
        dof = self.arm.dof
        if dof not in (5, 6, 7):
            raise InputError(f"{name}: has {dof} joints, but a UFACTORY controller drives 5, 6 or 7")
        if self.arm.sliding:
            raise InputError(
                f"{name}: joint {self.arm.sliding[0] + 1} is prismatic, and a UFACTORY controller drives "
                "revolute joints (its linear track is no joint of the arm); name the chain without it, such as "
                "robot.urdf#base:tip, or make recordings of the whole arm with `lite6jax simulate`"
            )
        object.__setattr__(self, "kinematics", protocol.round_floats(self.kinematics))
        if self.kinematics.shape != (dof, 6):
            raise InputError(
                f"{name}: a calibration {self.kinematics.shape}; it must be {(dof, 6)}: give that of this arm"
            )
        if self.values.shape != (self.physics.size,):
            raise InputError(f"{name}: {self.values.size} values of effects that take {self.physics.size}")
        noise = self.torque_noise if self.torque_noise.size else np.zeros(dof)
        object.__setattr__(self, "torque_noise", noise)
        if noise.shape != (dof,) or not ((noise >= 0) & np.isfinite(noise)).all():
            raise InputError(f"{name}: the noise of torques; give one Nm per joint, {dof}, 0 or more")
        if not abs(self.warm_up) <= MOST_WARM_UP:
            raise InputError(f"{name}: warms up by {self.warm_up:g} K; give at most {MOST_WARM_UP:g} either way")
        if abs(self.clock_offset) > LONGEST_OFFSET_S:
            raise InputError(f"time_offset: an emulator supports at most {LONGEST_OFFSET_S:g} s; give a smaller offset")
        if self.physics.effects:
            zero = np.zeros((1, dof))
            self.physics.check(self._motion(Sample(np.zeros(1), zero, zero, zero), 0.0), self.arm.mass is not None)
        for effect, _ in self.torque_effects:
            if effect.joints_needed > dof:
                raise InputError(
                    f"{effect.label}: acts at joint {effect.joints_needed}, but the arm has {dof} joints; choose "
                    "one of them"
                )
        if self.torque_effects and self.arm.mass is None:
            raise InputError(f"{name}: has no masses, which torques need; add `inertial` to its description")
        if self.servos is not None and self.servos.dof != dof:
            raise InputError(f"{name}: has {dof} joints, and servos of {self.servos.dof}; give those of this arm")
        if np.abs(self.torque_offset).max() > LONGEST_OFFSET_S:
            raise InputError(
                f"{name}: an emulator's torques are at most {LONGEST_OFFSET_S:g} s late or early; give a smaller "
                "time_offset or torque_lag"
            )

    @property
    def type(self) -> int:
        """The vendor's number of the model; for other arms that of the xArm with as many joints."""
        return TYPES.get(self.arm.name, self.arm.dof)

    @cached_property
    def links(self) -> Array:
        """`(joint, 4, 4)` m of the calibrated chain, before each joint's rotation."""
        return frames.transform_from_row(self.kinematics)

    def flange(self, q: ArrayLike, nominal: bool = False) -> Array:
        """`(..., 4, 4)` T_base_flange at `(..., joint)` rad by the calibrated or the nominal chain."""
        return frames.chain(self.arm.links if nominal else self.links, q) @ self.arm.T_joint_flange

    def temperature(self, time: Array) -> Array:
        """`(sample, joint)` °C; the rise decreases linearly to 0.8 of the first joint's at the last joint."""
        rise = self.warm_up * -np.expm1(-np.asarray(time) / 1200.0)
        return 25.0 + np.outer(rise, np.linspace(1.0, 0.8, self.arm.dof))

    @property
    def clock_offset(self) -> float:
        """s by which poses belong to a later motion than they are stamped with: the sum of the clock offsets."""
        return float(self.physics.part(self.values, [e.name == "time_offset" for e in self.physics.effects])[1].sum())

    @cached_property
    def _bending(self) -> tuple[Physics, Array]:
        """The effects on poses but clock offsets, with their values."""
        return self.physics.part(self.values, [e.name != "time_offset" for e in self.physics.effects])

    @cached_property
    def _inertia(self) -> Inertia | None:
        if self.arm.mass is None or self.arm.center_of_mass is None:
            return None
        return inertia_of(self.arm.mass, self.arm.center_of_mass)

    def true_poses(self, sample: Sample, load: Load) -> Array:
        """`(sample, 4, 4)` the true poses of the tool, with all effects; the joints are those after `clock_offset`."""
        physics, values = self._bending
        if not physics.effects:
            return self.flange(sample.position) @ load.T_flange_tool
        # JAX converts NumPy arrays at the call
        model: Any = (self.kinematics.ravel(), np.eye(4), self.arm.T_joint_flange @ load.T_flange_tool)
        inertia = self._inertia and self._inertia._replace(payload_center=load.center)
        form = SixParameterForm(self.arm.dof)
        poses = []
        for first in range(0, len(sample.time), BLOCK):
            block = Sample(*(part[first : first + BLOCK] for part in sample))
            motion = self._motion(block, load.payload, BLOCK)
            block_poses = predict_poses(form, physics, ArmModel(*model), values, motion, inertia)
            poses.append(np.asarray(block_poses)[: len(block.time)])
        return np.concatenate(poses)

    def _motion(self, sample: Sample, payload: float, size: int = 0, acceleration: Array | None = None) -> Motion:
        """The samples, padded with the last one to `size`."""
        count = len(sample.time)
        extra = max(size - count, 0)

        def padded(values: Array) -> Array:
            return np.pad(values, ((0, extra), (0, 0)), "edge").T

        position, velocity, direction = map(padded, sample[1:])
        rise = padded(self.temperature(sample.time) - 25.0)
        # the times of the padding increase, because times must be in order
        time = np.concatenate([sample.time, sample.time[-1] + SPACING_S * np.arange(1, extra + 1)])
        run = np.stack([np.zeros(len(time), int), np.full(len(time), count - 1)])
        ddq = None if acceleration is None else padded(acceleration)
        arrays: Any = (position, velocity, direction, time, run, rise.mean(0), np.full(len(time), payload), ddq, rise)
        return Motion(*arrays)

    @cached_property
    def _motor_effects(self) -> list[tuple[TorqueEffect, Array]]:
        """The effects on torques, and those on poses and on following of which the motors see the cause as well."""
        shared = (
            (_CAUSES_OF_BOTH[effect.name](), self.values[part])
            for effect, part in self.physics.pairs
            if effect.name in _CAUSES_OF_BOTH
        )
        followed = ((effect, values) for effect, values in self.followed if isinstance(effect, TorqueEffect))
        return [*self.torque_effects, *shared, *followed]

    @property
    def followed(self) -> list[tuple[Effect, Array]]:
        """The effects on how the arm follows its commands, each with its values."""
        if self.servos is None:
            return []
        servos = self.servos
        return [(term, servos.values[part]) for term, part in servos.terms.pairs if isinstance(term, Effect)]

    @property
    def torque_offset(self) -> Array:
        """`(joint,)` s by which torques belong to a later motion than they are stamped with."""
        dof = self.arm.dof
        zero = np.zeros(self.arm.dof)
        return sum((e.offset(values[0], dof) for e, values in self._motor_effects if isinstance(e, Delaying)), zero)

    @cached_property
    def _inertial_numbers(self) -> Array:
        """`(joint, 10)` of each link, as `link_parameters` gives them; links without tensors are points."""
        points = replace(self.arm, inertia=np.zeros((self.arm.dof, 3, 3)))
        return link_parameters(points if self.arm.inertia is None else self.arm)

    def torque(self, sample: Sample, acceleration: Array, load: Load) -> Array:
        """`(sample, joint)` N·m that the motors exert about +z of the joints, without noise; zero without masses.

        The acceleration is `(sample, joint)` rad/s².
        """
        torque = np.zeros_like(sample.position)
        for first in range(0, len(torque) if self.arm.mass is not None else 0, BLOCK):
            rows = slice(first, first + BLOCK)
            motion = self._motion(Sample(*(part[rows] for part in sample)), load.payload, BLOCK, acceleration[rows])
            links = self._inertial_numbers
            dynamics = RigidBodies(motion, links, load.center, _GRAVITY, self.kinematics).dynamics(links)
            added = [e.torque(values, dynamics) for e, values in self._motor_effects if not isinstance(e, Scaling)]
            total = dynamics.torque + sum(added)
            for effect, values in self._motor_effects:
                if isinstance(effect, Scaling):
                    total = total + effect.torque(values, dynamics._replace(torque=total))
            torque[rows] = total.T[: len(torque[rows])]
        return torque

    def draw_torque_noise(self, time: Array) -> Array:
        """`(sample, joint)` Nm at `(sample,)` s: the same at an instant, whoever reads it and how often."""
        if not self.torque_noise.any():
            return np.zeros((len(time), self.arm.dof))
        streams = (np.random.Philox(key=int(instant)) for instant in np.round(time * 1e6))
        return self.torque_noise * np.stack(
            [np.random.Generator(stream).standard_normal(self.arm.dof) for stream in streams]
        )
