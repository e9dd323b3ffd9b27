"""Torques of what an arm's description declares of its joints' drives: friction, rotors and springs."""

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.effects.dynamic.friction import CoulombFriction, ViscousFriction
from lite6jax.effects.dynamic.motors import JointSpring, RotorInertia
from lite6jax.effects.dynamic.torque_effect import direction
from lite6jax.effects.motion import Motion

Array = NDArray[np.floating]

FIELDS: dict[type, str] = {
    ViscousFriction: "viscous_friction",
    CoulombFriction: "coulomb_friction",
    RotorInertia: "rotor_inertia",
    JointSpring: "spring_stiffness",
}
"""Where an `Arm` has the first number of an effect."""


def declared(arm: Arm, effect: object) -> float:
    """The number of the description from which an effect is a deviation; 0 where it declares none."""
    field = FIELDS.get(type(effect))
    values = None if field is None else getattr(arm, field)
    return 0.0 if values is None else float(values[effect.joint - 1])  # type: ignore[attr-defined]


def declared_torque(arm: Arm, motion: Motion) -> Array:
    """`(joint, sample)` Nm, N of prismatic joints, that motors exert beside those of rigid bodies, by the description.

    Args:
        arm: with `viscous_friction`, `coulomb_friction`, `rotor_inertia` and springs, as far as they are declared.
        motion: with velocities and accelerations; NumPy arrays.
    """
    q, dq, ddq = motion.joint_position, motion.joint_velocity, motion.joint_acceleration
    total = np.zeros_like(np.asarray(q, float))
    if arm.viscous_friction is not None:
        total += arm.viscous_friction[:, None] * np.asarray(dq)
    if arm.coulomb_friction is not None:
        total += arm.coulomb_friction[:, None] * direction(np.asarray(dq), arm.slides)
    if arm.rotor_inertia is not None:
        total += arm.rotor_inertia[:, None] * np.asarray(ddq)
    if arm.spring_stiffness is not None:
        assert arm.spring_rest is not None
        total += arm.spring_stiffness[:, None] * (np.asarray(q) - arm.spring_rest[:, None])
    return total
