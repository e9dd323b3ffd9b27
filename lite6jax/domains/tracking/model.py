"""What effects make of servos and arm, and the rollout of that."""

from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.tracking.coupling import SETTLED, Bodies, JointLoads, roll_coupled
from lite6jax.domains.tracking.rollout import Commands, roll
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
    ViscousFriction,
)
from lite6jax.effects.effect import Effect, OfJoint
from lite6jax.effects.servo import Servo, TrackingEffect, change
from lite6jax.estimation.terms import Terms

Array = NDArray[np.floating]

_FIELDS: dict[type[Effect], tuple[str, ...]] = {
    ViscousFriction: ("viscous",),
    CoulombFriction: ("coulomb",),
    LoadFriction: ("load_friction",),
    RotorInertia: ("inertia",),
    JointSpring: ("spring", "spring_torque"),
}
"""Of effects on torques that act within a step, the fields of a servo that their numbers add to."""

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
        torques: effects that exert torques along a motion, each with its numbers.
    """

    servo: Servo
    bodies: Bodies
    torques: tuple[tuple[TorqueEffect, Array], ...] = ()

    def exerted(self, dynamics: Dynamics, known: dict[TorqueEffect, Array] | None = None) -> Array | None:
        """`(joint, 2, sample)` Nm along a motion, torques and Coulomb friction; None where there is nothing.

        Args:
            dynamics: along the motion.
            known: `units_along` it, to which this one adds.
        """
        if not self.torques:
            return None
        total = np.zeros((len(dynamics.torque), 2, dynamics.torque.shape[1]))
        for effect, numbers in self.torques:
            units = units_along(effect, dynamics, known) if effect.nonparametric else None
            if units is None:
                total[:, 0] += effect.torque(numbers, dynamics)
            else:
                total[effect.acts_on] += np.tensordot(numbers, units, 1)
        return total


def units_along(effect: TorqueEffect, dynamics: Dynamics, known: dict[TorqueEffect, Array] | None = None) -> Array:
    """Torques and Coulomb friction `(number, joint, 2, sample)` Nm by each number of a linear effect, of its joints.

    What depends on the direction of motion is friction: half of what differs between the directions resists, and holds
    a joint at rest, and what they have in common acts.

    Args:
        effect: of the catalogue of this domain.
        dynamics: along a motion.
        known: what is known of effects along it, to which this one adds.
    """
    if known is not None and effect in known:
        return known[effect]
    if effect.nonparametric and any(driver.discrete for driver in effect.drivers):
        ones = np.ones_like(np.asarray(dynamics.motion.joint_position))
        forward, back = (
            effect.unit_torques(dynamics._replace(motion=dynamics.motion._replace(direction=side * ones)))
            for side in (1, -1)
        )
        units = np.stack([0.5 * (forward + back), 0.5 * (forward - back)], 2)
    else:
        torques = effect.unit_torques(dynamics)
        units = np.stack([torques, np.zeros_like(torques)], 2)
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
    assert isinstance(effect, TorqueEffect)
    return replace(model, torques=(*model.torques, (effect, np.asarray(values, float))))


def compose(base: TrackingModel, terms: Terms, values: Array, coupled: bool = True) -> TrackingModel:
    """A model with the effects that are some terms; arguments as of `with_effect`."""
    model = base
    for term, part in zip(terms.terms, terms.slices, strict=True):
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
        extra: `(joint, 2, sample)` Nm, as of `roll`.
        coupled: whether to iterate.
        settled: rad RMS at which the iteration ends, as of `roll_coupled`.
    """
    if not coupled:
        joints = np.arange(commands.joints)
        rolled = roll(model.servo, commands, joints, loads.load, loads.mass, extra=extra, weight=loads.weight)
        return rolled.readout, loads
    rolled, along = roll_coupled(model.servo, commands, model.bodies, loads, extra, settled)
    return rolled.readout, along
