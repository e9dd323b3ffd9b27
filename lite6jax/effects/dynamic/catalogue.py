"""The catalogue of effects on torques: the named ones of an arm at every site, and those tried at a few values."""

import types
from collections.abc import Iterable, Mapping
from itertools import product

import numpy as np

from lite6jax.arms.arm import joint_size
from lite6jax.effects.dynamic import bounds
from lite6jax.effects.dynamic.bodies import BaseTilt, LinkCom, LinkMass, PayloadBody, PayloadTorque
from lite6jax.effects.dynamic.friction import (
    CoulombFriction,
    CoupledFriction,
    FrictionTemperature,
    LoadFriction,
    StribeckFriction,
    ViscousFriction,
)
from lite6jax.effects.dynamic.motors import (
    JointSpring,
    RotorInertia,
    TorqueLag,
    TorqueOffset,
    TorqueRipple,
    TorqueScale,
    TorqueTimeOffset,
)
from lite6jax.effects.dynamic.torque_effect import TorqueEffect, UnnamedTorque
from lite6jax.effects.effect import Effect
from lite6jax.effects.motion import Motion

_ALL: tuple[type[TorqueEffect], ...] = (
    *(ViscousFriction, CoulombFriction, StribeckFriction, LoadFriction, FrictionTemperature, CoupledFriction),
    *(TorqueOffset, TorqueScale, RotorInertia, JointSpring, TorqueRipple, LinkMass, LinkCom, PayloadTorque, BaseTilt),
    *(PayloadBody, TorqueTimeOffset, TorqueLag, UnnamedTorque),
)
BUILT_IN: Mapping[str, type[Effect]] = types.MappingProxyType({kind.name: kind for kind in _ALL})
"""The classes of the catalogue by name."""

_SPEEDS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Shares of a joint's largest speed that the speeds of such friction are tried at."""
_OF_SPEED = {StribeckFriction: bounds.STRIBECK, CoulombFriction: bounds.TRANSITION}
"""Frictions with a speed in which they are not linear, and its bounds."""


def torque_catalogue(dof: int, sliding: tuple[int, ...] = ()) -> tuple[TorqueEffect, ...]:
    """Every named effect on torques of an arm at every site, without those of `torque_shaped` and ripple.

    Args:
        dof: number of joints.
        sliding: the prismatic joints, counted from 0.
    """
    joints = range(1, dof + 1)
    simple = (ViscousFriction, CoulombFriction, LoadFriction, FrictionTemperature)
    motors = (TorqueOffset, TorqueScale, RotorInertia, JointSpring, TorqueLag)
    return (
        *(kind(joint, of_slide=joint - 1 in sliding) for kind in (*simple, *motors) for joint in joints),
        *(_coupled(joint, source, sliding) for joint in joints for source in _alike(joint, sliding)),
        *(kind(link) for kind in (LinkMass, LinkCom) for link in joints),
        *(PayloadTorque(), PayloadBody(), BaseTilt(), TorqueTimeOffset()),
    )


def _alike(joint: int, sliding: tuple[int, ...]) -> list[int]:
    """The joints before one that are of its kind: one motor drives two of these."""
    return [source for source in range(1, joint) if (source - 1 in sliding) == (joint - 1 in sliding)]


def _coupled(joint: int, source: int, sliding: tuple[int, ...]) -> CoupledFriction:
    return CoupledFriction(joint, source, of_slide=joint - 1 in sliding)


def torque_shaped(motion: Motion) -> tuple[TorqueEffect, ...]:
    """Stribeck friction, and Coulomb friction with a transition, at a few of their speeds, as a motion shows them.

    A speed that a joint passes within one sample where it reverses is not seen.
    """
    assert motion.joint_velocity is not None
    velocity = np.asarray(motion.joint_velocity)
    fastest = np.abs(velocity).max(1)
    step, reverses = np.abs(np.diff(velocity)), velocity[:, 1:] * velocity[:, :-1] < 0
    passed = [float(np.median(own[at])) if at.any() else 0.0 for own, at in zip(step, reverses, strict=True)]
    tried = [(joint, float(f"{share * v:.3g}")) for joint, v in enumerate(fastest, 1) for share in _SPEEDS]
    found: list[TorqueEffect] = []
    for (kind, limits), (joint, speed) in product(_OF_SPEED.items(), tried):
        slides = joint - 1 in motion.sliding.joints
        low, high = (joint_size(bound, "rad/s", slides) for bound in limits)
        if max(low, passed[joint - 1]) <= speed <= high:
            found.append(kind(joint, speed, of_slide=slides))
    return tuple(found)


def torque_kinds_of(effects: Iterable[Effect] = ()) -> dict[str, type[Effect]]:
    """The classes of the catalogue and of a user's `effects`, by name."""
    return {**BUILT_IN, **{effect.name: type(effect) for effect in effects}}
