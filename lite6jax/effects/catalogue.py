"""The catalogue: every effect that the library can test, at every site of an arm, and what of it a recording shows."""

import inspect
import re
import types
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from itertools import product
from typing import Any, NamedTuple, final

import numpy as np

from lite6jax.arms.arm import as_revolute, joint_size
from lite6jax.array_types import Array
from lite6jax.effects import dynamic, kinematic, servo
from lite6jax.effects.composition import missing
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Effect
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.resemblance import IN_TRACKING, Resemblance
from lite6jax.effects.statics import Loads

POSE_EFFECTS: Mapping[str, type[Effect]] = types.MappingProxyType({
    kind.name: kind
    for kind in (
        *(kinematic.JointOffset, kinematic.JointScale, kinematic.JointCompliance, kinematic.JointHarmonic),
        *(kinematic.JointBacklash, kinematic.JointLag, kinematic.JointCoupling, kinematic.LinkCompliance),
        *(kinematic.LinkThermalExpansion, kinematic.FrameOffset, kinematic.BaseCompliance, kinematic.BaseDrift),
        *(kinematic.ToolOffset, kinematic.MeasurementScale, kinematic.TimeOffset, kinematic.PayloadError),
        *(kinematic.JointThermalOffset, kinematic.JointWarmUp, kinematic.JointWindup, kinematic.AxisWobble),
        *(kinematic.ToolCompliance, kinematic.GravityDirection, kinematic.PayloadCom, kinematic.SensorDrift),
        Unnamed,
    )
})  # fmt: skip
"""The classes of effects on poses by name."""
TORQUE_EFFECTS: Mapping[str, type[Effect]] = types.MappingProxyType({
    kind.name: kind
    for kind in (
        *(dynamic.ViscousFriction, dynamic.CoulombFriction, dynamic.StribeckFriction, dynamic.LoadFriction),
        *(dynamic.FrictionTemperature, dynamic.CoupledFriction, dynamic.TorqueOffset, dynamic.TorqueScale),
        *(dynamic.RotorInertia, dynamic.JointSpring, dynamic.TorqueRipple, dynamic.LinkMass, dynamic.LinkCom),
        *(dynamic.LinkInertia, dynamic.PayloadTorque, dynamic.BaseTilt, dynamic.PayloadBody, dynamic.TorqueTimeOffset),
        *(dynamic.TorqueLag, dynamic.UnnamedTorque),
    )
})  # fmt: skip
"""The classes of effects on torques by name."""
_IN_BOTH = (
    *(dynamic.ViscousFriction, dynamic.CoulombFriction, dynamic.LoadFriction, dynamic.RotorInertia),
    dynamic.JointSpring,
)
"""Effects on the torque of a joint that a servo follows worse for."""
_OF_BODIES = (dynamic.LinkMass, dynamic.LinkCom)
"""Effects on what a link weighs, likewise."""
TRACKING_EFFECTS: Mapping[str, type[Effect]] = types.MappingProxyType({
    kind.name: kind
    for kind in (
        *(servo.CommandTimeOffset, servo.ClockDrift, *servo.OF_JOINTS),
        *(*_IN_BOTH, dynamic.StribeckFriction, dynamic.TorqueRipple, *_OF_BODIES, dynamic.PayloadTorque),
        *(dynamic.BaseTilt, dynamic.UnnamedInLoop),
    )
})  # fmt: skip
"""The classes of effects on how servos follow their commands, by name."""

_FRICTIONS = (0.05, 0.1, 0.2, 0.4, 0.7)
"""Shares of the largest gravity torque of a joint: between two of them a step or a play is about the same."""
_TIME_CONSTANTS = (0.1, 0.3, 1.0)
"""Shares of a recording's duration: a shorter warm-up is over at once, and a longer one is a drift."""
_LEAST_TORQUE = 5e-3
"""Of the largest torque on any joint: an axis that is upright but for its making bears less."""
SPEEDS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Shares of a joint's largest speed that the speeds of such friction are tried at."""
_BLURRED = 3.0
"""Times the speed over which the direction of motion changes its sign, within which it is not ±1 to half a per cent."""
_ENDLESS = 0.5 * servo.UNLIMITED
"""A number of this size is as good as none: the reciprocal of a limit that is never reached is rounded."""
_EXPONENTS = (0.4, 0.6, 0.8, 1.3, 1.7, 2.2)
"""Of viscous friction that are tried beside 1."""


class Untestable(NamedTuple):
    """An effect that cannot be tested with a recording, and the driver that the recording lacks."""

    effect: Effect
    driver: Driver


def kinds_of(effects: Iterable[Effect] = (), built_in: Mapping[str, type[Effect]] = POSE_EFFECTS) -> dict[str, type]:
    """The classes of a catalogue and of a user's `effects`, by name."""
    return {**built_in, **{effect.name: type(effect) for effect in effects}}


def untestable(effects: Iterable[Effect], motion: Motion, loads_known: bool) -> list[Untestable]:
    """The effects of which a motion lacks a driver, with the driver.

    Args:
        effects: the candidates.
        motion: what was recorded.
        loads_known: whether the masses of the arm's links are known.
    """
    lacking = ((effect, missing(effect, motion, loads_known)) for effect in effects)
    return [Untestable(effect, driver) for effect, driver in lacking if driver is not None]


def catalogue(dof: int, *, turned_tool: bool = False, sliding: Sequence[int] = ()) -> tuple[Effect, ...]:
    """Every named effect on poses of an arm at every site, without those of `shaped`.

    Args:
        dof: number of joints.
        turned_tool: whether the tool's orientation is measured.
        sliding: the prismatic joints, counted from 0.
    """
    k = kinematic
    links = range(1, dof + 1)
    slides = [joint + 1 for joint in sliding]
    joints = [joint for joint in links if joint not in slides]
    of_any = (k.JointOffset, k.JointScale, k.JointCompliance, k.JointBacklash)
    return (
        *(kind(joint) for kind in (*of_any, k.JointLag, k.JointThermalOffset, k.AxisWobble) for joint in joints),
        *(k.JointHarmonic(joint, order) for joint in joints for order in (1.0, 2.0)),  # others: from the spectrum
        *(k.JointCoupling(joint, source) for joint in joints for source in joints if source != joint),
        *(kind(joint, of_slide=True) for kind in of_any for joint in slides),
        *(k.LinkCompliance(link) for link in links),
        *(k.LinkThermalExpansion(link) for link in (None, *range(1, dof))),
        *(k.FrameOffset(link) for link in (None, *links)),
        *(k.BaseCompliance(), k.BaseCompliance(cross=True), k.BaseCompliance(cross=True, shift=True), k.BaseDrift()),
        *(k.ToolOffset(turned_tool), k.ToolCompliance(), k.MeasurementScale(), k.SensorDrift(), k.TimeOffset()),
        *(k.PayloadError(), k.PayloadCom(), k.GravityDirection()),
    )


def shaped(motion: Motion, loads: Loads | None, dof: int) -> tuple[Effect, ...]:
    """Effects on poses with a number in which they are not linear, at a few of its values, as a motion shows them.

    The friction of loaded backlash and of wind-up is tried at shares of the joint's largest gravity torque, that of
    backlash at zero too; the time constant of warm-up at shares of the duration, where no temperature is recorded.

    Args:
        motion: what was recorded.
        loads: of gravity in it; None where the masses are not known.
        dof: number of joints.
    """
    effects: list[Effect] = []
    slides = motion.sliding.mask(dof)
    largest = np.zeros(dof) if loads is None else np.where(slides, 0.0, np.abs(np.asarray(loads.torque)).max(1))
    for joint, torque in enumerate(largest, 1):
        if slides[joint - 1] or torque <= _LEAST_TORQUE * largest.max():
            continue
        frictions = [_short(share * torque) for share in _FRICTIONS]
        effects.append(kinematic.JointBacklash(joint, 0.0))
        if motion.direction is not None:
            effects += [kinematic.JointBacklash(joint, friction) for friction in frictions]
        effects += [kinematic.JointWindup(joint, friction) for friction in frictions]
    if motion.time is not None and motion.temperature_rise is None:
        duration = float(np.ptp(np.asarray(motion.time)))
        constants = [_short(share * duration) for share in _TIME_CONSTANTS]
        possible = [constant for constant in constants if constant >= kinematic.WARM_UP[0]]
        turning = np.flatnonzero(~slides) + 1
        effects += [kinematic.JointWarmUp(int(joint), constant) for joint in turning for constant in possible]
    return tuple(effects)


def _short(number: float) -> float:
    return float(f"{number:.3g}")


def torque_catalogue(dof: int, sliding: tuple[int, ...] = ()) -> tuple[dynamic.TorqueEffect, ...]:
    """Every named effect on torques of an arm at every site, without those of `torque_shaped` and ripple.

    Args:
        dof: number of joints.
        sliding: the prismatic joints, counted from 0.
    """
    d = dynamic
    joints = range(1, dof + 1)
    of_slide = {joint: joint - 1 in sliding for joint in range(1, dof + 1)}
    frictions = (d.ViscousFriction, d.CoulombFriction, d.LoadFriction, d.FrictionTemperature)
    motors = (d.TorqueOffset, d.TorqueScale, d.RotorInertia, d.JointSpring, d.TorqueLag)
    pairs = ((joint, source) for joint in joints for source in range(1, joint))
    return (
        *(kind(joint, of_slide=of_slide[joint]) for kind in (*frictions, *motors) for joint in joints),
        # one motor drives two joints of one kind
        *(d.CoupledFriction(a, b, of_slide=of_slide[a]) for a, b in pairs if of_slide[a] == of_slide[b]),
        *(kind(link) for kind in (d.LinkMass, d.LinkCom) for link in joints),
        *(d.LinkInertia(joint) for joint in joints if not of_slide[joint]),
        *(d.PayloadTorque(), d.PayloadBody(), d.BaseTilt(), d.TorqueTimeOffset()),
    )


def tracking_catalogue(dof: int) -> tuple[Effect, ...]:
    """Every named effect on how the servos of an arm follow their commands, without Stribeck friction and ripple.

    Args:
        dof: number of joints, all revolute.
    """
    kinds = (*servo.OF_JOINTS, *_IN_BOTH, *_OF_BODIES)
    return (
        *(kind(joint) for kind in kinds for joint in range(1, dof + 1)),
        *(servo.CommandTimeOffset(), servo.ClockDrift(), dynamic.PayloadTorque(), dynamic.BaseTilt()),
    )


def resolved_speeds(motion: Motion) -> Array:
    """`(joint,)` rad/s, m/s of prismatic joints, below which a motion shows nothing of how friction depends on speed.

    A speed that a joint passes within one sample where it reverses, in most reversals, leaves no sample below it. One
    at which the direction of motion is not known is not told from another form of its sign.
    """
    assert motion.joint_velocity is not None
    velocity = np.asarray(motion.joint_velocity)
    before = velocity[:, :-1]
    after = velocity[:, 1:]
    slides = motion.sliding.mask(len(velocity)).tolist()
    speeds = [joint_size(_BLURRED * dynamic.DIRECTION_SPEED, "rad/s", of_slide) for of_slide in slides]
    for joint, reverses in enumerate(before * after < 0):
        if reverses.any():
            speeds[joint] = max(speeds[joint], float(np.median(np.abs(after - before)[joint, reverses])))
    return np.array(speeds)


def torque_shaped(
    motion: Motion, resolved: Array, shares: Sequence[float] = SPEEDS
) -> tuple[dynamic.TorqueEffect, ...]:
    """Stribeck friction and Coulomb friction with a transition at a few of their speeds, viscous friction by exponents.

    The speeds are `shares` of the largest one of a joint.

    As a motion shows them: a speed below what is `resolved` `(joint,)` is not seen, nor is an exponent of a joint that
    does not move.
    """
    fastest = np.abs(np.asarray(motion.joint_velocity)).max(1)
    joint_speeds = [(joint, _short(share * v)) for joint, v in enumerate(fastest, 1) for share in shares]
    effects: list[dynamic.TorqueEffect] = []
    limits = {dynamic.StribeckFriction: dynamic.STRIBECK, dynamic.CoulombFriction: dynamic.TRANSITION}
    slides = np.isin(np.arange(len(fastest)), motion.sliding.joints)
    for (kind, bounds), (joint, speed) in product(limits.items(), joint_speeds):
        of_slide = bool(slides[joint - 1])
        low, high = (joint_size(bound, "rad/s", of_slide) for bound in bounds)
        if max(low, resolved[joint - 1]) <= speed <= high:
            effects.append(kind(joint, speed, of_slide=of_slide))
    moving = np.flatnonzero(as_revolute(fastest, "rad/s", slides) > dynamic.DIRECTION_SPEED)
    for joint, exponent in product(moving.tolist(), _EXPONENTS):
        effects.append(dynamic.ViscousFriction(joint + 1, exponent, of_slide=bool(slides[joint])))
    return tuple(effects)


# ------------------------------------------------------------------ a list for people


@final
@dataclass(frozen=True)
class Listed:
    """One effect of a catalogue.

    Attributes:
        domain: `kinematic` (moves the tool), `dynamic` (adds to the motors' torques) or `tracking` (changes how servos
            follow their commands). An effect of several catalogues is listed in each.
        name: as in files and with `simulate --effect`.
        sites: where it may act: `jointN`, `linkN`, `links`, `base`, `tool`, `sensor`, `clock`, `payload`.
        drivers: the quantities on which it depends; "any" of a function without a name.
        parameters: the numbers that a diagnosis reports, each with its unit in its name; none without a name.
        possible: the least and the largest value of each of them, as `possible_values`.
        units: of the numbers that a fit moves.
        description: its law, the first paragraph of its documentation.
        in_simulators: the parameter that holds it in MuJoCo, in Isaac Lab and in URDF; "" where none does.
        resembles: the effects of `tracking` that look like it, in which logs, and what tells them apart.
    """

    domain: str
    name: str
    sites: tuple[str, ...]
    drivers: tuple[str, ...]
    parameters: tuple[str, ...]
    possible: tuple[tuple[float | None, float | None], ...]
    units: tuple[str, ...]
    description: str
    in_simulators: dict[str, str]
    resembles: tuple[dict[str, Any], ...]

    @property
    def simulated(self) -> bool:
        """Tells whether it acts in motors or servos, as parameters of simulators do, and not on the arm's geometry."""
        return self.domain != "kinematic"

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values."""
        return asdict(self)


def listed() -> list[Listed]:
    """Every effect of the catalogues of poses, of torques and of commands, in their order."""
    # two joints are enough for an effect of one by another
    catalogues = (
        ("kinematic", POSE_EFFECTS, catalogue(2), ("jointN", "linkN", "base", "tool", "sensor"), ()),
        ("dynamic", TORQUE_EFFECTS, torque_catalogue(2), ("jointN",), ()),
        ("tracking", TRACKING_EFFECTS, tracking_catalogue(2), ("jointN",), IN_TRACKING),
    )
    return [
        _listed(domain, kind, [effect for effect in made if type(effect) is kind], sites, alike)
        for domain, built_in, made, sites, alike in catalogues
        for kind in built_in.values()
    ]


def possible_values(effect: Effect) -> dict[str, tuple[float | None, float | None]]:
    """The least and the largest value of each number that a diagnosis reports of an effect.

    An end is None where there is none, or where it depends on the other numbers.
    """
    coordinates = effect.coordinates
    typical = np.array([coordinate.typical for coordinate in coordinates])
    derivatives = effect.to_parameters(typical)[1]
    possible: dict[str, tuple[float | None, float | None]] = {}
    for place, name in enumerate(effect.parameters):
        moving = np.flatnonzero(derivatives[place])
        if len(moving) != 1:
            possible[name] = (None, None)
            continue
        ends = []
        for end in (coordinates[moving[0]].lower, coordinates[moving[0]].upper):
            values = typical.copy()
            values[moving[0]] = end
            ends.append(float(effect.to_parameters(values)[0][place]))
        least, largest = sorted(ends)
        possible[name] = (_end(least), _end(largest))
    return possible


def _end(value: float) -> float | None:
    """A limit as it is printed; None of one that is never reached."""
    if abs(value) >= _ENDLESS:
        return None
    return _short(value)


def _listed(
    domain: str, kind: type[Effect], made: list[Effect], sites: tuple[str, ...], alike: Sequence[Resemblance]
) -> Listed:
    """An effect of a domain, of which some are `made`; one without a name acts at `sites`."""
    description = " ".join((inspect.getdoc(kind) or "").partition("\n\n")[0].split())
    in_simulators = kind.in_simulators._asdict()
    resembles = tuple(group.describe(kind.name) for group in alike if kind.name in group.effects)
    if kind.nonparametric:
        return Listed(domain, kind.name, sites, ("any",), (), (), (), description, in_simulators, resembles)
    if not made:  # one that is tried at values that a recording shows
        made = [kind(**{field.name: 1 for field in fields(kind) if field.default is MISSING})]  # type: ignore[arg-type]
    possible = {name: ends for effect in made for name, ends in possible_values(effect).items()}

    def once(values: Iterable[str]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(values))

    return Listed(
        domain=domain,
        name=kind.name,
        sites=once(re.sub(r"\d+", "N", effect.site) for effect in made),
        drivers=once(driver.quantity for effect in made for driver in effect.drivers),
        parameters=tuple(possible),
        possible=tuple(possible.values()),
        units=once(number.unit for effect in made for number in effect.coordinates),
        description=description,
        in_simulators=in_simulators,
        resembles=resembles,
    )
