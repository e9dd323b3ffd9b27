"""The catalogue: every effect that the library can test, and those that a recording leaves untestable."""

import types
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from lite6jax.effects.composition import missing
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Effect
from lite6jax.effects.kinematic import bounds
from lite6jax.effects.kinematic.gears import JointBacklash, JointWindup
from lite6jax.effects.kinematic.joints import (
    JointCompliance,
    JointCoupling,
    JointHarmonic,
    JointLag,
    JointOffset,
    JointScale,
    JointThermalOffset,
    JointWarmUp,
    SlideBacklash,
    SlideCompliance,
    SlideOffset,
    SlideScale,
)
from lite6jax.effects.kinematic.links import AxisWobble, FrameOffset, LinkCompliance, LinkThermalExpansion
from lite6jax.effects.kinematic.surroundings import (
    BaseCompliance,
    BaseDrift,
    GravityDirection,
    MeasurementScale,
    PayloadCom,
    PayloadError,
    SensorDrift,
    TimeOffset,
    ToolCompliance,
    ToolOffset,
)
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.statics import Loads

_ALL: tuple[type[Effect], ...] = (
    *(JointOffset, JointScale, JointCompliance, JointHarmonic, JointBacklash, JointLag, JointCoupling),
    *(LinkCompliance, LinkThermalExpansion, FrameOffset, BaseCompliance, BaseDrift, ToolOffset),
    *(MeasurementScale, TimeOffset, PayloadError, JointThermalOffset, JointWarmUp, JointWindup, AxisWobble),
    *(ToolCompliance, GravityDirection, PayloadCom, SensorDrift, Unnamed),
    *(SlideOffset, SlideScale, SlideCompliance, SlideBacklash),
)
BUILT_IN: Mapping[str, type[Effect]] = types.MappingProxyType({kind.name: kind for kind in _ALL})
"""The classes of the catalogue by name."""

_FRICTIONS = (0.05, 0.1, 0.2, 0.4, 0.7)
"""Shares of the largest gravity torque of a joint: between two of them a step or a play is about the same."""
_TIME_CONSTANTS = (0.1, 0.3, 1.0)
"""Shares of a recording's duration: a shorter warm-up is over at once, and a longer one is a drift."""
_LEAST_TORQUE = 5e-3
"""Of the largest torque on any joint: an axis that is upright but for its making bears less."""


class Untestable(NamedTuple):
    """An effect that cannot be tested with a recording, and the driver that the recording lacks."""

    effect: Effect
    driver: Driver


def catalogue(
    dof: int, *, orders: Sequence[float] = (1.0, 2.0), turned_tool: bool = False, sliding: Sequence[int] = ()
) -> tuple[Effect, ...]:
    """Every named effect of an arm at every site, without those of `shaped`.

    Args:
        dof: number of joints.
        orders: of the harmonics of each joint, per turn; other orders, as of gears, follow from the spectrum.
        turned_tool: whether the tool's orientation is measured.
        sliding: the prismatic joints, counted from 0.
    """
    links, slides = range(1, dof + 1), [joint + 1 for joint in sliding]
    joints = [joint for joint in links if joint not in slides]
    simple = (JointOffset, JointScale, JointCompliance, JointBacklash, JointLag, JointThermalOffset, AxisWobble)
    return (
        *(kind(joint) for kind in simple for joint in joints),
        *(JointHarmonic(joint, order) for joint in joints for order in orders),
        *(JointCoupling(joint, source) for joint in joints for source in joints if source != joint),
        *(kind(joint) for kind in (SlideOffset, SlideScale, SlideCompliance, SlideBacklash) for joint in slides),
        *(LinkCompliance(link) for link in links),
        *(LinkThermalExpansion(link) for link in (None, *range(1, dof))),
        *(FrameOffset(link) for link in (None, *links)),
        *(BaseCompliance(), BaseCompliance(cross=True), BaseCompliance(cross=True, shift=True), BaseDrift()),
        *(ToolOffset(turned_tool), ToolCompliance(), MeasurementScale(), SensorDrift(), TimeOffset()),
        *(PayloadError(), PayloadCom(), GravityDirection()),
    )


def shaped(motion: Motion, loads: Loads | None, dof: int) -> tuple[Effect, ...]:
    """Named effects with a number in which they are not linear, at a few of its values, as far as a motion shows them.

    The friction of loaded backlash and of wind-up is tried at shares of the joint's largest gravity torque, that of
    backlash at zero too; the time constant of warm-up at shares of the duration, where no temperature is recorded.

    Args:
        motion: what was recorded.
        loads: of gravity in it; None where the masses are not known.
        dof: number of joints.
    """
    found: list[Effect] = []
    slides = motion.sliding.mask(dof)
    largest = np.zeros(dof) if loads is None else np.where(slides, 0.0, np.abs(np.asarray(loads.torque)).max(1))
    for joint, torque in enumerate(largest, 1):
        if slides[joint - 1] or torque <= _LEAST_TORQUE * largest.max():
            continue
        frictions = [_short(share * torque) for share in _FRICTIONS]
        found.append(JointBacklash(joint, 0.0))
        if motion.direction is not None:
            found += [JointBacklash(joint, friction) for friction in frictions]
        found += [JointWindup(joint, friction) for friction in frictions]
    if motion.time is not None and motion.temperature_rise is None:
        duration = float(np.ptp(np.asarray(motion.time)))
        constants = [_short(share * duration) for share in _TIME_CONSTANTS]
        possible = [constant for constant in constants if constant >= bounds.WARM_UP[0]]
        turning = np.flatnonzero(~slides) + 1
        found += [JointWarmUp(int(joint), constant) for joint in turning for constant in possible]
    return tuple(found)


def _short(number: float) -> float:
    return float(f"{number:.3g}")


def untestable(effects: Iterable[Effect], motion: Motion, loads_known: bool) -> list[Untestable]:
    """The effects of which a motion lacks a driver, with the driver.

    Args:
        effects: the candidates.
        motion: what was recorded.
        loads_known: whether the masses of the arm's links are known.
    """
    lacking = ((effect, missing(effect, motion, loads_known)) for effect in effects)
    return [Untestable(effect, driver) for effect, driver in lacking if driver is not None]


def kinds_of(effects: Iterable[Effect] = ()) -> dict[str, type[Effect]]:
    """The classes of the catalogue and of a user's `effects`, by name."""
    return {**BUILT_IN, **{effect.name: type(effect) for effect in effects}}
