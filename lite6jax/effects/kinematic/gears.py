"""Effects of a joint's gear that depend on friction: play between its flanks, and what dry friction holds back."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from lite6jax.deferred import Array, jnp, lax
from lite6jax.effects.deflection import library_of
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Choice, Coordinate, Effect, JointEffect, Reporting, tried, with_field
from lite6jax.effects.kernels import plays
from lite6jax.effects.kinematic import bounds
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Loads
from lite6jax.errors import InputError

_TRANSITION = 0.05
"""Of the largest torque: a step has no derivative by the friction that places it, so that of a ramp as wide as this is
taken. It is about the spacing of the torques of some dozens of poses, between which the step may be."""

_GAP = Coordinate("gap_rad", "rad", 1e-4, lower=0.0, upper=bounds.GAP)
_FRICTION = Coordinate("friction_torque_Nm", "Nm", 0.1, lower=0.0, upper=bounds.FRICTION, linear=False)


def _check_friction(effect: "JointBacklash | JointWindup") -> None:
    friction = effect.friction_torque_Nm
    if friction is not None and not 0 <= friction < np.inf:
        raise InputError(f"{effect.label}: friction_torque_Nm is {friction:g}; give zero or a positive number")


def _released_backlash(effect: Effect) -> Effect:
    assert isinstance(effect, JointBacklash)
    return _FreeBacklash(effect.joint)


@final
@dataclass(frozen=True)
class JointBacklash(JointEffect):
    """δq = ½·gap·sign(τ − f·direction): gravity presses the gear to a flank, unless friction f carries it to the other.

    Without f, friction is above every torque: δq = −½·gap·sign(direction), the gear lies against the flank that it
    came from. One class serves both, because a name of the catalogue is one class in files.

    Attributes:
        friction_torque_Nm: f in Nm; with 0 the direction does not matter. None for more than every torque, and not for
            a number to be fitted.
    """

    friction_torque_Nm: float | None = None  # noqa: N815  # as the parameter is called in files

    name: ClassVar[str] = "joint_backlash"
    specificity: ClassVar[int] = 3
    choice: ClassVar[Choice | None] = tried("friction_torque_Nm", 0.0, _released_backlash)
    reporting: ClassVar[Reporting] = with_field("friction_torque_Nm")

    def __post_init__(self) -> None:
        _check_friction(self)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (_GAP,)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        direction, torque = Driver("direction of motion", self.joint), Driver("gravity torque", self.joint)
        if self.friction_torque_Nm is None:
            return (direction,)
        return (torque, direction) if self.friction_torque_Nm else (torque,)

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        free = self.friction_torque_Nm is None
        flank = -self.drivers[0].values(motion, loads) if free else self._pressing(motion, loads)
        return 0.5 * values[0] * library_of(flank).sign(flank)

    def _pressing(self, motion: Motion, loads: Loads | None) -> Array:
        """`(sample,)` Nm towards the flank at a larger angle, friction overcome."""
        torque, *direction = [driver.values(motion, loads) for driver in self.drivers]
        return torque - (self.friction_torque_Nm or 0.0) * direction[0] if direction else torque


@final
@dataclass(frozen=True)
class _FreeBacklash(JointEffect):
    """A `JointBacklash` whose friction is fitted as well; never in a file, where friction is fixed."""

    name: ClassVar[str] = "joint_backlash"
    specificity: ClassVar[int] = 3

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (_GAP, _FRICTION)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("gravity torque", self.joint), Driver("direction of motion", self.joint))

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        torque, direction = (driver.values(motion, loads) for driver in self.drivers)
        pressed = torque - jnp.maximum(values[1], 0.0) * direction
        ramp = jnp.clip(pressed / (_TRANSITION * jnp.maximum(jnp.max(jnp.abs(torque)), 1e-300)), -1.0, 1.0)
        return 0.5 * values[0] * (jnp.sign(pressed) + ramp - lax.stop_gradient(ramp))


@final
@dataclass(frozen=True)
class JointWindup(JointEffect):
    """δq = c·p(τ): p is the play operator of half-width f on gravity's torque. Dry friction f holds the gear back.

    A run begins unwound, as nearly as friction allows. The search tries some f, in which it is not linear; without a
    fixed one f is its second number.

    Attributes:
        friction_torque_Nm: f in Nm, where it is fixed.
    """

    friction_torque_Nm: float | None = None  # noqa: N815  # as the parameter is called in files

    name: ClassVar[str] = "joint_windup"
    specificity: ClassVar[int] = 5
    hysteretic: ClassVar[bool] = True
    """It depends on the samples before."""
    choice: ClassVar[Choice | None] = tried("friction_torque_Nm", 0.0)
    reporting: ClassVar[Reporting] = with_field("friction_torque_Nm")

    def __post_init__(self) -> None:
        _check_friction(self)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        compliance = Coordinate("compliance_rad_per_Nm", "rad/Nm", 1e-5, lower=0.0, upper=bounds.COMPLIANCE)
        return (compliance,) if self.friction_torque_Nm is not None else (compliance, _FRICTION)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("gravity torque", self.joint),)

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        torque = self.drivers[0].values(motion, loads)
        xp = library_of(values, torque)
        friction = xp.maximum(values[1], 0.0) if self.friction_torque_Nm is None else self.friction_torque_Nm
        return values[0] * xp.asarray(plays(torque, xp.asarray(friction)[None], motion.run))[0]
