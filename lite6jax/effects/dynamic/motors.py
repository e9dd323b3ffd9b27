"""Effects of motors, gears and their sensors: offset, scale, rotor, springs, ripple, delays; and declared drives."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.effects.drivers import Driver
from lite6jax.effects.dynamic import bounds
from lite6jax.effects.dynamic.friction import CoulombFriction, ViscousFriction
from lite6jax.effects.dynamic.torque_effect import Array, Delaying, Dynamics, JointTorque, OfJoint, Scaling, direction
from lite6jax.effects.effect import Choice, Coordinate, Effect, Reporting
from lite6jax.effects.motion import Motion
from lite6jax.effects.waves import order_choice, wave_angle, wave_reporting
from lite6jax.errors import InputError


@final
@dataclass(frozen=True)
class TorqueOffset(JointTorque):
    """τ += o: the zero offset of a torque sensor or of a current."""

    name: ClassVar[str] = "torque_offset"
    specificity: ClassVar[int] = 0

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (self.number("offset_Nm", "Nm", 0.1, lower=-bounds.TORQUE, upper=bounds.TORQUE),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return ()

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return np.full(dynamics.motion.samples, values[0])


@final
@dataclass(frozen=True)
class TorqueScale(Scaling):
    """The measured torque is 1 + s times the true one, friction included: a wrong torque constant or gear ratio."""

    name: ClassVar[str] = "torque_scale"
    specificity: ClassVar[int] = 2

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (self.number("scale", "1", 0.01, lower=-bounds.SCALE, upper=10 * bounds.SCALE),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (self.own_driver("gravity torque"),)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return values[0] * dynamics.torque[self.joint - 1]


@final
@dataclass(frozen=True)
class RotorInertia(JointTorque):
    """τ += I·q̈, of the rotor, reflected to the joint; of a prismatic joint I is a mass."""

    name: ClassVar[str] = "rotor_inertia"
    specificity: ClassVar[int] = 1

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (self.number("inertia_kg_m2", "kg·m²", 0.01, lower=0.0, upper=bounds.ROTOR),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (self.own_driver("acceleration"),)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        assert dynamics.motion.joint_acceleration is not None
        return values[0] * np.asarray(dynamics.motion.joint_acceleration)[self.joint - 1]


def _spring_names(effect: Effect) -> tuple[str, ...]:
    return effect.own("stiffness_Nm_per_rad"), effect.own("rest_rad")


def _spring_parameters(effect: Effect, values: NDArray) -> tuple[NDArray, NDArray]:
    k, m = values
    rest = -m / k if k else 0.0
    slope = [rest / k * -1.0, -1.0 / k] if k else [0.0, 0.0]
    return np.array([k, rest]), np.array([[1.0, 0.0], slope])


def _spring_values(effect: Effect, given: Mapping[str, float]) -> NDArray:
    stiffness, rest = _spring_names(effect)
    k = given.get(stiffness, 0.0)
    return np.array([k, -k * given.get(rest, 0.0)])


@final
@dataclass(frozen=True)
class JointSpring(JointTorque):
    """τ += k·(q − q₀): a cable, a hose, a balancer.

    Its coordinates are k and −k·q₀, in which it is linear.
    """

    name: ClassVar[str] = "joint_spring"
    specificity: ClassVar[int] = 3
    reporting: ClassVar[Reporting] = Reporting(
        names=_spring_names, parameters=_spring_parameters, values=_spring_values
    )
    special_cases = staticmethod(lambda effect: (TorqueOffset(effect.joint, of_slide=effect.of_slide),))

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (
            self.number("stiffness_Nm_per_rad", "Nm/rad", 0.1, lower=0.0, upper=bounds.STIFFNESS),
            self.number("torque_at_zero_Nm", "Nm", 0.1, lower=-bounds.TORQUE, upper=bounds.TORQUE),
        )

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (self.own_driver("position"),)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return values[0] * np.asarray(dynamics.motion.joint_position)[self.joint - 1] + values[1]


@final
@dataclass(frozen=True)
class TorqueRipple(JointTorque):
    """τ += A·sin(n·q + φ): cogging, gear mesh; of a prismatic joint F += A·sin(2π·q/p + φ): a screw's lead p.

    Its coordinates are A cos φ and A sin φ, and n where it is not fixed.

    Attributes:
        order: n ≥ 1, where it is fixed, not necessarily an integer; of a prismatic joint 1/p, cycles per metre.
    """

    order: float | None = None

    name: ClassVar[str] = "torque_ripple"
    specificity: ClassVar[int] = 5
    choice: ClassVar[Choice | None] = order_choice()
    reporting: ClassVar[Reporting] = wave_reporting("amplitude_Nm")

    def __post_init__(self) -> None:
        if self.order is not None and not 0 < self.order < np.inf:
            raise InputError(f"{self.label}: order is {self.order:g}; give a positive number")

    @property
    def period_m(self) -> float | None:  # as the parameter is called in files
        """The length after which the force of a prismatic joint repeats; None where no order is fixed, or in turns."""
        return 1 / self.order if self.of_slide and self.order else None

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        most = bounds.TORQUE
        waves = tuple(self.number(f"{wave}_Nm", "Nm", 0.1, lower=-most, upper=most) for wave in ("sine", "cosine"))
        order = Coordinate("order", "1/m" if self.of_slide else "1", 0.1, lower=0.0, linear=False)
        return waves if self.order is not None else (*waves, order)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (self.own_driver("position"),)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        order = values[2] if self.order is None else self.order
        turned = order * wave_angle(np.asarray(dynamics.motion.joint_position)[self.joint - 1], self.of_slide)
        return values[0] * np.sin(turned) + values[1] * np.cos(turned)


@final
@dataclass(frozen=True)
class TorqueTimeOffset(Delaying):
    """The torque stamped t belongs to the motion at t + offset."""

    name: ClassVar[str] = "time_offset"
    specificity: ClassVar[int] = 1

    @property
    def site(self) -> str:
        """`clock`."""
        return "clock"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("offset_s", "s", 1e-3, lower=-bounds.DELAY, upper=bounds.DELAY, linear=False),)

    def offset(self, value: float, joints: int) -> Array:
        return np.full(joints, value)


@final
@dataclass(frozen=True)
class TorqueLag(OfJoint, Delaying):
    """The torque of one joint stamped t belongs to the motion at t − lag: its drive filters or sends it."""

    name: ClassVar[str] = "torque_lag"
    specificity: ClassVar[int] = 4

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("lag_s", "s", 1e-3, lower=-bounds.DELAY, upper=bounds.DELAY, linear=False),)

    def offset(self, value: float, joints: int) -> Array:
        return np.where(np.arange(joints) == self.joint - 1, -value, 0.0)


FIELDS: dict[type, str] = {
    ViscousFriction: "viscous_friction",
    CoulombFriction: "coulomb_friction",
    RotorInertia: "rotor_inertia",
    JointSpring: "spring_stiffness",
}
"""Where an `Arm` has the first number of an effect."""


def declared(arm: Arm, effect: object) -> float:
    """The number of the description from which an effect is a deviation; 0 where it declares none."""
    field = FIELDS.get(type(effect))
    values = None if field is None else getattr(arm, field)
    return 0.0 if values is None else float(values[effect.joint - 1])  # type: ignore[attr-defined]


def declared_torque(arm: Arm, motion: Motion) -> Array:
    """`(joint, sample)` Nm, N of prismatic joints, that motors exert beside those of rigid bodies, by the description.

    Args:
        arm: with `viscous_friction`, `coulomb_friction`, `rotor_inertia` and springs, as far as they are declared.
        motion: with velocities and accelerations; NumPy arrays.
    """
    q, dq, ddq = motion.joint_position, motion.joint_velocity, motion.joint_acceleration
    total = np.zeros_like(np.asarray(q, float))
    if arm.viscous_friction is not None:
        total += arm.viscous_friction[:, None] * np.asarray(dq)
    if arm.coulomb_friction is not None:
        total += arm.coulomb_friction[:, None] * direction(np.asarray(dq), arm.slides)
    if arm.rotor_inertia is not None:
        total += arm.rotor_inertia[:, None] * np.asarray(ddq)
    if arm.spring_stiffness is not None:
        assert arm.spring_rest is not None
        total += arm.spring_stiffness[:, None] * (np.asarray(q) - arm.spring_rest[:, None])
    return total
