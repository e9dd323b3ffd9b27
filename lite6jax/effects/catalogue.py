"""The catalogue: every effect that the library can test, and those that a recording leaves untestable."""

import types
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from lite6jax.effects.composition import missing
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Effect
from lite6jax.effects.kinematic.joints import (
    JointBacklash,
    JointCompliance,
    JointCoupling,
    JointHarmonic,
    JointLag,
    JointOffset,
    JointScale,
)
from lite6jax.effects.kinematic.links import FrameOffset, LinkCompliance, LinkThermalExpansion
from lite6jax.effects.kinematic.surroundings import (
    BaseCompliance,
    BaseDrift,
    MeasurementScale,
    PayloadError,
    TimeOffset,
    ToolOffset,
)
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import Unnamed

_ALL: tuple[type[Effect], ...] = (
    *(JointOffset, JointScale, JointCompliance, JointHarmonic, JointBacklash, JointLag, JointCoupling),
    *(LinkCompliance, LinkThermalExpansion, FrameOffset, BaseCompliance, BaseDrift, ToolOffset),
    *(MeasurementScale, TimeOffset, PayloadError, Unnamed),
)
BUILT_IN: Mapping[str, type[Effect]] = types.MappingProxyType({kind.name: kind for kind in _ALL})
"""The classes of the catalogue by name."""


class Untestable(NamedTuple):
    """An effect that cannot be tested with a recording, and the driver that the recording lacks."""

    effect: Effect
    driver: Driver


def catalogue(dof: int, *, orders: Sequence[float] = (1.0, 2.0), turned_tool: bool = False) -> tuple[Effect, ...]:
    """Every named effect of an arm at every site.

    Args:
        dof: number of joints.
        orders: of the harmonics of each joint, per turn; other orders, as of gears, follow from the spectrum.
        turned_tool: whether the tool's orientation is measured.
    """
    joints = range(1, dof + 1)
    simple = (JointOffset, JointScale, JointCompliance, JointBacklash, JointLag)
    return (
        *(kind(joint) for kind in simple for joint in joints),
        *(JointHarmonic(joint, order) for joint in joints for order in orders),
        *(JointCoupling(joint, source) for joint in joints for source in joints if source != joint),
        *(LinkCompliance(link) for link in joints),
        *(LinkThermalExpansion(link) for link in (None, *range(1, dof))),
        *(FrameOffset(link) for link in (None, *joints)),
        *(BaseCompliance(), BaseDrift(), ToolOffset(turned_tool), MeasurementScale(), TimeOffset(), PayloadError()),
    )


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
