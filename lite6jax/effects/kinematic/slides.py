"""Effects of prismatic joints: what adds to the position that an encoder says, in m."""

from dataclasses import dataclass
from typing import ClassVar, final

from lite6jax.deferred import Array
from lite6jax.effects.deflection import library_of
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Coordinate, JointEffect
from lite6jax.effects.kinematic import bounds
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Loads


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
class SlideScale(JointEffect):
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

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        return values[0] * self.drivers[0].values(motion, loads)


@final
@dataclass(frozen=True)
class SlideCompliance(JointEffect):
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

    def angle(self, values: Array, motion: Motion, loads: Loads | None) -> Array:
        return values[0] * self.drivers[0].values(motion, loads)


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
