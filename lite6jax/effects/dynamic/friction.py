"""Friction of joints: viscous, Coulomb, Stribeck, of the load, of the temperature, and of motors that drive two joints.

Viscous and Coulomb friction and their dependence on the load: P. Hamon et al., IROS 2010, eq. 6; the decay at low
speed: B. Armstrong-Hélouvry, Control of Machines with Friction, 1991, ch. 2.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.dynamic import bounds
from lite6jax.effects.dynamic.torque_effect import Array, Dynamics, JointTorque, OfJoint, direction
from lite6jax.effects.effect import DIRECT, Choice, Coordinate, Reporting, tried, with_field
from lite6jax.errors import InputError

SHARP = 0.0
"""A transition of Coulomb friction that is as sharp as encoders show."""


@final
@dataclass(frozen=True)
class ViscousFriction(JointTorque):
    """τ += b·q̇."""

    name: ClassVar[str] = "viscous_friction"
    specificity: ClassVar[int] = 1
    usual: ClassVar[bool] = True

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (self.number("viscous_Nm_s_per_rad", "Nm·s/rad", 0.1, lower=0.0, upper=bounds.VISCOUS),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (self.own_driver("velocity"),)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return values[0] * dynamics.velocity(self.joint)


def _of_transition(effect: Any) -> Reporting:
    """The reporting of Coulomb friction: a transition that is as sharp as encoders show is no number of it."""
    return DIRECT if effect.transition_rad_per_s == SHARP else with_field("transition_rad_per_s")


@final
@dataclass(frozen=True)
class CoulombFriction(JointTorque):
    """τ += c·tanh(q̇/v): c·sign(q̇) but near standstill, where friction of gears and belts turns within a speed v.

    It is not linear in v: the search tries some values of v, and v without a fixed value is its second coordinate.

    Attributes:
        transition_rad_per_s: v, where it is fixed; `SHARP` for a few mrad/s; in m/s of a prismatic joint, in whose
            files it is `transition_m_per_s`.
    """

    transition_rad_per_s: float | None = SHARP

    name: ClassVar[str] = "coulomb_friction"
    specificity: ClassVar[int] = 1
    usual: ClassVar[bool] = True
    choice: ClassVar[Choice | None] = tried("transition_rad_per_s", bounds.TRANSITION[0], unit="rad/s")._replace(
        searched=lambda effect: bool(effect.transition_rad_per_s)  # type: ignore[attr-defined]
    )
    reporting: ClassVar[Reporting] = Reporting(
        names=lambda effect: _of_transition(effect).names(effect),
        parameters=lambda effect, values: _of_transition(effect).parameters(effect, values),
        values=lambda effect, given: _of_transition(effect).values(effect, given),
    )
    special_cases = staticmethod(lambda effect: effect.sharp)

    def __post_init__(self) -> None:
        v = self.transition_rad_per_s
        if v is not None and not 0 <= v < np.inf:
            raise InputError(f"{self.label}: {self.own('transition_rad_per_s')} is {v:g}; give a positive number")

    @property
    def sharp(self) -> "tuple[CoulombFriction, ...]":
        """The friction with a sharp transition, of which this one is a smooth form; none if it is that itself."""
        wide = self.transition_rad_per_s != SHARP
        return (CoulombFriction(self.joint, of_slide=self.of_slide),) if wide else ()

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        torque = self.number("coulomb_Nm", "Nm", 0.1, lower=0.0, upper=bounds.TORQUE)
        low, high = bounds.TRANSITION
        speed = self.number("transition_rad_per_s", "rad/s", 0.1, lower=low, upper=high, linear=False)
        return (torque,) if self.transition_rad_per_s is not None else (torque, speed)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (self.own_driver("direction of motion"),)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        v = max(values[1], 1e-9) if self.transition_rad_per_s is None else self.transition_rad_per_s
        return values[0] * dynamics.direction(self.joint, v)


@final
@dataclass(frozen=True)
class StribeckFriction(JointTorque):
    """τ += s·exp(−(q̇/v)²)·sign(q̇), beside Coulomb friction.

    It is not linear in v: the search tries some values of v, and v without a fixed value is its second coordinate.

    Attributes:
        velocity_rad_per_s: v, where it is fixed; in m/s of a prismatic joint, in whose files it is `velocity_m_per_s`.
    """

    velocity_rad_per_s: float | None = None

    name: ClassVar[str] = "stribeck_friction"
    specificity: ClassVar[int] = 4
    choice: ClassVar[Choice | None] = tried("velocity_rad_per_s", bounds.STRIBECK[0], unit="rad/s")
    reporting: ClassVar[Reporting] = with_field("velocity_rad_per_s")

    def __post_init__(self) -> None:
        v = self.velocity_rad_per_s
        if v is not None and not 0 < v < np.inf:
            raise InputError(f"{self.label}: {self.own('velocity_rad_per_s')} is {v:g}; give a positive number")

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        torque = self.number("stribeck_Nm", "Nm", 0.1, lower=0.0, upper=bounds.TORQUE)
        low, high = bounds.STRIBECK
        speed = self.number("velocity_rad_per_s", "rad/s", 0.01, lower=low, upper=high, linear=False)
        return (torque,) if self.velocity_rad_per_s is not None else (torque, speed)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (self.own_driver("velocity"), self.own_driver("direction of motion"))

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        v = max(values[1], 1e-9) if self.velocity_rad_per_s is None else self.velocity_rad_per_s
        speed = dynamics.velocity(self.joint)
        return values[0] * np.exp(-((speed / v) ** 2)) * dynamics.direction(self.joint)


@final
@dataclass(frozen=True)
class LoadFriction(JointTorque):
    """τ += μ·|τ_rigid|·sign(q̇): friction of a gear in proportion to its load."""

    name: ClassVar[str] = "load_friction"
    specificity: ClassVar[int] = 2

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (self.number("coefficient", "1", 0.01, lower=0.0, upper=bounds.COEFFICIENT),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (self.own_driver("gravity torque"), self.own_driver("direction of motion"))

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return values[0] * np.abs(dynamics.torque[self.joint - 1]) * dynamics.direction(self.joint)


@final
@dataclass(frozen=True)
class FrictionTemperature(JointTorque):
    """τ += k·(T − T₀)·q̇, T the temperature of this joint; k is negative where grease becomes thinner."""

    name: ClassVar[str] = "friction_temperature"
    specificity: ClassVar[int] = 3

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        most = bounds.VISCOUS_PER_KELVIN
        return (self.number("viscous_Nm_s_per_rad_K", "Nm·s/rad/K", 0.01, lower=-most, upper=most),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (self.own_driver("temperature"), self.own_driver("velocity"))

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        rise = np.asarray(self.drivers[0].values(dynamics.motion, None))
        return values[0] * rise * dynamics.velocity(self.joint)


@final
@dataclass(frozen=True)
class CoupledFriction(OfJoint):
    """τ += b·(q̇_N + q̇_M) + c·sign(q̇_N + q̇_M) on both joints: a motor of the wrist that drives both.

    Joint N is the outer one. Both are revolute, or both prismatic, as those of a gantry whose belt passes over both.

    Attributes:
        source_joint: M.
    """

    source_joint: int

    name: ClassVar[str] = "coupled_friction"
    specificity: ClassVar[int] = 3
    reporting: ClassVar[Reporting] = with_field("source_joint")

    def __post_init__(self) -> None:
        if self.source_joint >= self.joint:
            raise InputError(
                f"{self.label}: source_joint {self.source_joint} is not before joint {self.joint}; name the outer "
                "joint as joint"
            )

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (
            self.number("viscous_Nm_s_per_rad", "Nm·s/rad", 0.1, lower=0.0, upper=bounds.VISCOUS),
            self.number("coulomb_Nm", "Nm", 0.1, lower=0.0, upper=bounds.TORQUE),
        )

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (self.own_driver("velocity"), joint_driver("velocity", self.source_joint, self.of_slide))

    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        speed = dynamics.velocity(self.joint) + dynamics.velocity(self.source_joint)
        total = np.zeros_like(dynamics.torque)
        friction = values[0] * speed + values[1] * direction(speed, self.of_slide)
        total[[self.joint - 1, self.source_joint - 1]] = friction
        return total
