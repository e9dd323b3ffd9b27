"""What effects make of servos and arm, and the rollout of that."""

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from lite6jax.array_types import Array
from lite6jax.domains.tracking.coupling import SETTLED, Bodies, JointLoads, roll_coupled
from lite6jax.domains.tracking.rollout import CHANNELS, COMMAND, FRICTION, READ_OUT, TORQUE, Commands, roll
from lite6jax.effects.dynamic import (
    BaseTilt,
    CoulombFriction,
    Dynamics,
    JointSpring,
    LoadFriction,
    OfLink,
    PayloadTorque,
    RotorInertia,
    StribeckFriction,
    TorqueEffect,
    UnnamedInLoop,
    ViscousFriction,
)
from lite6jax.effects.effect import Effect, OfJoint
from lite6jax.effects.servo import Servo, TrackingEffect, change
from lite6jax.estimation.terms import Terms

_FIELDS: dict[type[Effect], tuple[str, ...]] = {
    ViscousFriction: ("viscous",),
    CoulombFriction: ("coulomb",),
    LoadFriction: ("load_friction",),
    RotorInertia: ("inertia",),
    JointSpring: ("spring", "spring_torque"),
}
"""Of effects on torques that act within a step, the fields of a servo that their numbers add to."""

Driven = TorqueEffect | UnnamedInLoop
"""What adds to joints along a motion, by `CHANNELS`."""
_TORQUES = slice(TORQUE, FRICTION + 1)
_CHANNELS = {"": _TORQUES, "command": slice(COMMAND, COMMAND + 1), "read-out": slice(READ_OUT, READ_OUT + 1)}
"""By the component of a nonparametric effect."""

_POSITIVE = (
    *("damping", "integral", "time_constant", "dead_band", "viscous", "coulomb", "stribeck", "load_friction"),
    *("inertia", "backlash", "torque_droop"),
)
"""Fields of a servo that cannot be negative, whatever a step of a fit tries."""


@final
@dataclass(frozen=True, eq=False)
class TrackingModel:
    """An arm with its servos.

    Attributes:
        servo: each `(joint,)`.
        bodies: the arm.
        driven: what adds to joints along a motion, each with its numbers.
    """

    servo: Servo
    bodies: Bodies
    driven: tuple[tuple[Driven, Array], ...] = ()

    def added(self, dynamics: Dynamics, known: dict[Driven, Array] | None = None) -> Array | None:
        """`(joint, channel, sample)`, what is added along a motion, by `CHANNELS`; None where there is nothing.

        Args:
            dynamics: along the motion.
            known: `units_along` it, to which this one adds.
        """
        if not self.driven:
            return None
        total = np.zeros((len(dynamics.torque), CHANNELS, dynamics.torque.shape[1]))
        for effect, numbers in self.driven:
            if isinstance(effect, UnnamedInLoop):
                total[acted_on(effect)] += np.tensordot(numbers, units_along(effect, dynamics, known), 1)
            else:
                total[:, TORQUE] += effect.torque(numbers, dynamics)
        return total


def acted_on(effect: Driven) -> tuple[slice, slice]:
    """The joints and the channels, of all, that an effect adds to."""
    if isinstance(effect, UnnamedInLoop):
        return slice(effect.joint - 1, effect.joint), _CHANNELS[effect.component]
    return effect.acts_on, _TORQUES


def units_along(effect: Driven, dynamics: Dynamics, known: dict[Driven, Array] | None = None) -> Array:
    """What each number of a linear effect adds along a motion, `(number, joint, channel, sample)` where it acts.

    A torque that depends on the direction of motion is friction: half of what differs between the directions resists,
    and holds a joint at rest, and what they have in common acts.

    Args:
        effect: of the catalogue of this domain.
        dynamics: along a motion.
        known: what is known of effects along it, to which this one adds.
    """
    if known is not None and effect in known:
        return known[effect]
    if not isinstance(effect, UnnamedInLoop):
        torques = effect.unit_torques(dynamics)
        units = np.stack([torques, np.zeros_like(torques)], 2)
    elif effect.component:
        units = effect.functions_of(dynamics)[:, None, None]
    elif any(driver.discrete for driver in effect.drivers):
        ones = np.ones_like(np.asarray(dynamics.motion.joint_position))
        forward, back = (
            effect.functions_of(dynamics._replace(motion=dynamics.motion._replace(direction=side * ones)))
            for side in (1, -1)
        )
        units = np.stack([0.5 * (forward + back), 0.5 * (forward - back)], 1)[:, None]
    else:
        functions = effect.functions_of(dynamics)
        units = np.stack([functions, np.zeros_like(functions)], 1)[:, None]
    if known is not None:
        known[effect] = units
    return units


def with_effect(model: TrackingModel, effect: Effect, values: Array, coupled: bool = True) -> TrackingModel:
    """A model with one more effect.

    Args:
        model: without it.
        effect: of the catalogue of this domain.
        values: `(coordinate,)`.
        coupled: whether payload, links and tilt change the bodies, and not what is exerted along the measured motion.
    """
    if isinstance(effect, TrackingEffect):
        return replace(model, servo=effect.alter(values, model.servo))
    if isinstance(effect, StribeckFriction):
        speed = float(values[1]) if effect.velocity_rad_per_s is None else effect.velocity_rad_per_s
        here = np.arange(len(model.servo.stiffness)) == effect.joint - 1
        servo = change(model.servo, effect.joint, {"stribeck": float(values[0])})
        return replace(model, servo=servo._replace(stribeck_speed=np.where(here, speed, servo.stribeck_speed)))
    fields = _FIELDS.get(type(effect))
    if fields is not None and isinstance(effect, OfJoint) and effect.fixed_number is None:
        return replace(model, servo=change(model.servo, effect.joint, dict(zip(fields, values, strict=False))))
    if coupled and isinstance(effect, PayloadTorque):
        return replace(model, bodies=model.bodies.with_payload(float(values[0])))
    if coupled and isinstance(effect, OfLink):
        return replace(model, bodies=model.bodies.with_link(effect, values))
    if coupled and isinstance(effect, BaseTilt):
        return replace(model, bodies=model.bodies.tilted(values))
    assert isinstance(effect, Driven)
    return replace(model, driven=(*model.driven, (effect, np.asarray(values, float))))


def compose(base: TrackingModel, terms: Terms, values: Array, coupled: bool = True) -> TrackingModel:
    """A model with the effects that are some terms; arguments as of `with_effect`."""
    model = base
    for term, part in terms.pairs:
        assert isinstance(term, Effect)
        model = with_effect(model, term, np.asarray(values[part], float), coupled)
    numbers = model.servo._asdict()
    positive = {name: np.maximum(numbers[name], 0.0) for name in _POSITIVE}
    return replace(model, servo=model.servo._replace(**positive))


def roll_out(
    model: TrackingModel,
    commands: Commands,
    loads: JointLoads,
    extra: Array | None,
    coupled: bool,
    settled: float | Array = SETTLED,
) -> tuple[Array, JointLoads]:
    """Read-outs `(joint, sample)` rad, and the loads along them.

    Args:
        model: the arm with its servos.
        commands: of all joints.
        loads: those that are held, or where the coupled arm is iterated from.
        extra: `(joint, channel, sample)`, as of `roll`.
        coupled: whether to iterate.
        settled: rad RMS at which the iteration ends, as of `roll_coupled`.
    """
    if not coupled:
        joints = np.arange(commands.joints)
        rolled = roll(model.servo, commands, joints, loads.load, loads.mass, extra=extra, weight=loads.weight)
        return rolled.readout, loads
    rolled, along = roll_coupled(model.servo, commands, model.bodies, loads, extra, settled)
    return rolled.readout, along
