"""Effects of joints: what adds to the angle, or the position of a slide, that an encoder says."""

from abc import ABC
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.deferred import Array
from lite6jax.effects.deflection import library_of
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Choice, Coordinate, Effect, JointEffect, Reporting, tried, with_field
from lite6jax.effects.kinematic import bounds
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Loads
from lite6jax.effects.waves import order_choice, wave_reporting
from lite6jax.errors import InputError


class _Proportional(JointEffect, ABC):
    """δq = k·driver."""

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        return values[0] * self.drivers[0].values(motion, loads)


@final
@dataclass(frozen=True)
class JointOffset(JointEffect):
    """δq = c: the encoder's zero is elsewhere."""

    name: ClassVar[str] = "joint_offset"
    specificity: ClassVar[int] = 0

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("offset_rad", "rad", 1e-4, lower=-bounds.OFFSET, upper=bounds.OFFSET),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return ()

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        return library_of(values).broadcast_to(values[0], (motion.samples,))


@final
@dataclass(frozen=True)
class JointScale(_Proportional):
    """δq = s·q: the encoder's radian is another."""

    name: ClassVar[str] = "joint_scale"
    specificity: ClassVar[int] = 1

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("scale", "1", 1e-4, lower=-bounds.RATIO, upper=bounds.RATIO),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("position", self.joint),)


@final
@dataclass(frozen=True)
class JointCompliance(_Proportional):
    """δq = c·τ: the gear gives way to the torque that gravity exerts on it."""

    name: ClassVar[str] = "joint_compliance"
    specificity: ClassVar[int] = 2

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("compliance_rad_per_Nm", "rad/Nm", 1e-5, lower=0.0, upper=bounds.COMPLIANCE),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("gravity torque", self.joint),)


@final
@dataclass(frozen=True)
class JointHarmonic(JointEffect):
    """δq = A·sin(n·q + φ): eccentric encoders and gears (n = 1, 2), gear teeth and wave generators (n up to 400).

    Its coordinates are A cos φ and A sin φ, in which it is linear; without a fixed `order` the order is the third, so
    that one compiled function serves every order.

    Attributes:
        order: n ≥ 1, where it is fixed; not necessarily an integer.
    """

    order: float | None = None

    name: ClassVar[str] = "joint_harmonic"
    specificity: ClassVar[int] = 5
    choice: ClassVar[Choice | None] = order_choice(named=(1.0, 2.0))
    reporting: ClassVar[Reporting] = wave_reporting("amplitude_rad")

    def __post_init__(self) -> None:
        if self.order is not None and not 0 < self.order < np.inf:
            raise InputError(f"joint_harmonic:joint{self.joint}: order is {self.order:g}; give a positive number")

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        amplitudes = tuple(
            Coordinate(f"{wave}_rad", "rad", 1e-4, lower=-bounds.WAVE, upper=bounds.WAVE) for wave in ("sine", "cosine")
        )
        return (
            amplitudes
            if self.order is not None
            else (*amplitudes, Coordinate("order", "1", 0.1, lower=0.0, linear=False))
        )

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("position", self.joint),)

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        turned = (values[2] if self.order is None else self.order) * self.drivers[0].values(motion, loads)
        xp = library_of(turned)
        return values[0] * xp.sin(turned) + values[1] * xp.cos(turned)


@final
@dataclass(frozen=True)
class JointLag(JointEffect):
    """δq = −lag·dq: the joint is behind what its encoder says."""

    name: ClassVar[str] = "joint_lag"
    specificity: ClassVar[int] = 4

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("lag_s", "s", 1e-3, lower=-bounds.LAG, upper=bounds.LAG),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("velocity", self.joint),)

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        return -values[0] * self.drivers[0].values(motion, loads)


def _coupling_values(effect: Effect, given: Mapping[str, float]) -> NDArray:
    assert isinstance(effect, JointCoupling)
    source = given.get("source_joint", effect.source_joint)
    if source != effect.source_joint:
        raise InputError(
            f"{effect.label}: source_joint {source:g} beside joint {effect.source_joint}; give one of them"
        )
    return np.array([given.get("coupling", 0.0)])


@final
@dataclass(frozen=True)
class JointCoupling(_Proportional):
    """δq = k·q_source: another joint's motion leaks into this one's, as through a shared gear or cable.

    Attributes:
        source_joint: the other joint, counted from 1.
    """

    source_joint: int

    name: ClassVar[str] = "joint_coupling"
    specificity: ClassVar[int] = 10

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("coupling", "1", 1e-4, lower=-bounds.COUPLING, upper=bounds.COUPLING),)

    reporting: ClassVar[Reporting] = Reporting(
        names=lambda effect: ("coupling", "source_joint"),
        parameters=lambda effect, values: (
            np.array([values[0], effect.drivers[0].place]),
            np.array([[1.0], [0.0]]),
        ),
        values=_coupling_values,
    )

    def __post_init__(self) -> None:
        if self.source_joint == self.joint:
            raise InputError(f"joint_coupling:joint{self.joint}: its source_joint is itself; that is joint_scale")

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("position", self.source_joint),)


@final
@dataclass(frozen=True)
class JointThermalOffset(_Proportional):
    """δq = k·(T − T₀): the encoder's zero moves with the joint's own temperature, or with that of the surroundings."""

    name: ClassVar[str] = "joint_thermal_offset"
    specificity: ClassVar[int] = 9

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        most = bounds.THERMAL_OFFSET
        return (Coordinate("offset_rad_per_K", "rad/K", 1e-6, lower=-most, upper=most),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("temperature", self.joint),)


@final
@dataclass(frozen=True)
class JointWarmUp(JointEffect):
    """δq = A·(1 − exp(−time/τ)): the joint warms up from time 0, and nobody records its temperature.

    Its search tries some τ, in which it is not linear; without a fixed one τ is its second number.

    Attributes:
        time_constant_s: τ in s, where it is fixed.
    """

    time_constant_s: float | None = None

    name: ClassVar[str] = "joint_warm_up"
    specificity: ClassVar[int] = 10
    choice: ClassVar[Choice | None] = tried("time_constant_s", bounds.WARM_UP[0])
    reporting: ClassVar[Reporting] = with_field("time_constant_s")

    def __post_init__(self) -> None:
        if self.time_constant_s is not None and not 0 < self.time_constant_s < np.inf:
            raise InputError(
                f"joint_warm_up:joint{self.joint}: time_constant_s is {self.time_constant_s:g}; give a positive number"
            )

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        amplitude = Coordinate("amplitude_rad", "rad", 1e-4, lower=-bounds.WAVE, upper=bounds.WAVE)
        lower, upper = bounds.WARM_UP
        free = Coordinate("time_constant_s", "s", 1e3, lower=lower, upper=upper, linear=False)
        return (amplitude,) if self.time_constant_s is not None else (amplitude, free)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("time"),)

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        # at neutral τ is zero as well: any positive one then gives no angle, and no division by zero
        xp, time = library_of(values, motion.time), self.drivers[0].values(motion, loads)
        constant = self.time_constant_s or xp.where(values[1] > 0, values[1], 1.0)
        return -values[0] * xp.expm1(-time / constant)


@final
@dataclass(frozen=True)
class SlideOffset(JointEffect):
    """δq = c: the zero of the prismatic joint is elsewhere."""

    name: ClassVar[str] = "slide_offset"
    specificity: ClassVar[int] = 0
    of_slide: ClassVar[bool | None] = True

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("offset_m", "m", 1e-4, lower=-bounds.SLIDE_OFFSET, upper=bounds.SLIDE_OFFSET),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return ()

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        return library_of(values).broadcast_to(values[0], (motion.samples,))


@final
@dataclass(frozen=True)
class SlideScale(_Proportional):
    """δq = s·q: the metre of the prismatic joint is another, as of a screw's lead or a scale that grew."""

    name: ClassVar[str] = "slide_scale"
    specificity: ClassVar[int] = 1
    of_slide: ClassVar[bool | None] = True

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("scale", "1", 1e-4, lower=-bounds.RATIO, upper=bounds.RATIO),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("slide position", self.joint),)


@final
@dataclass(frozen=True)
class SlideCompliance(_Proportional):
    """δq = c·F: the screw, belt or rack gives way to the force that gravity exerts along the joint's axis."""

    name: ClassVar[str] = "slide_compliance"
    specificity: ClassVar[int] = 2
    of_slide: ClassVar[bool | None] = True

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("compliance_m_per_N", "m/N", 1e-7, lower=0.0, upper=bounds.SLIDE_COMPLIANCE),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("gravity force", self.joint),)


@final
@dataclass(frozen=True)
class SlideBacklash(JointEffect):
    """δq = −½·gap·sign(direction): the nut lies against the flank that it came from.

    That is so of a horizontal slide, or where friction exceeds gravity's force; otherwise the weight closes the gap.
    """

    name: ClassVar[str] = "slide_backlash"
    specificity: ClassVar[int] = 3
    of_slide: ClassVar[bool | None] = True

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (Coordinate("gap_m", "m", 1e-4, lower=0.0, upper=bounds.SLIDE_GAP),)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (Driver("direction of motion", self.joint),)

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        direction = self.drivers[0].values(motion, loads)
        return -0.5 * values[0] * library_of(direction).sign(direction)
