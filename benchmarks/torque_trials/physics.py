"""What the motors of an arm with hidden physics exert, in plain NumPy."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.concealed.chain import Array, rotation_from_vector
from benchmarks.torque_trials.arms import Arm, inverse_dynamics
from benchmarks.torque_trials.effects import NAMED, Hidden, Scene
from benchmarks.torque_trials.motion import Motion
from benchmarks.torque_trials.outside import FAMILIES

BODIES = ("link_mass", "link_com", "payload_error", "base_tilt")
RIGID = (*BODIES, "time_offset")
"""The effects that change what the rigid bodies ask for."""


@dataclass(frozen=True, eq=False)
class Setup:
    """An arm where it stands.

    Attributes:
        arm: the arm as it is, but for what is hidden.
        gravity: `(3,)` m/s² in the base's axes, as declared.
        payload_center: `(3,)` m in the last frame.
    """

    arm: Arm
    gravity: Array
    payload_center: Array


def torques(setup: Setup, hidden: Sequence[Hidden], motion: Motion, scene: Scene | None = None) -> Array:
    """`(sample, joint)` Nm as a sensor without noise reads them.

    Friction and springs add to what the rigid bodies ask for (the scene, where it is known already); what is outside
    to both; then come a sensor's scale and the lag of what it shows.
    """
    scene = scene or rigid(setup, hidden, motion)
    exerted = scene.load.copy()
    for effect in hidden:
        torque = NAMED[effect.name].torque if effect.name in NAMED else None
        if torque is None:
            continue
        joints = {effect.number, int(effect.values.get("source_joint", effect.number))}
        for joint in joints:
            # the other joint of a pair feels the same
            sibling = effect if joint == effect.number else effect.moved(source_joint=float(effect.number))
            exerted[:, joint - 1] += torque(sibling.values, joint - 1, scene)
    for effect in hidden:
        if effect.name in FAMILIES:
            joint = effect.number - 1
            added = FAMILIES[effect.name].torque(effect.fixed, joint, scene, exerted[:, joint])
            exerted[:, joint] += effect.values["size"] * added
    for effect in hidden:
        if effect.name == "torque_scale":
            exerted[:, effect.number - 1] *= 1 + effect.values["scale"]
    for joint in {effect.number - 1 for effect in hidden if effect.name == "torque_lag"}:
        late = [effect for effect in hidden if effect.name == "torque_lag" and effect.number - 1 == joint]
        others = tuple(effect for effect in hidden if effect not in late)
        before = motion.later(-sum(effect.values["lag_s"] for effect in late))
        exerted[:, joint] = torques(setup, others, before)[:, joint]
    return exerted


def rigid(setup: Setup, hidden: Sequence[Hidden], motion: Motion) -> Scene:
    """The motion that the torques belong to, with what the rigid bodies ask for."""
    changed, added = changed_bodies(setup, hidden)
    for effect in hidden:
        if effect.name == "time_offset":
            motion = motion.later(effect.values["offset_s"])
    q, dq, ddq, payload = motion.q, motion.dq, motion.ddq, motion.payload + added
    load = inverse_dynamics(changed.arm, q, dq, ddq, changed.gravity, payload, setup.payload_center)
    return Scene(motion.time, q, dq, ddq, motion.temperature, load)


def changed_bodies(setup: Setup, hidden: Sequence[Hidden]) -> tuple[Setup, float]:
    """The arm with its hidden masses, centres and tilt, and what its payload weighs more than declared, kg."""
    arm, gravity, added = setup.arm, setup.gravity, 0.0
    for effect in hidden:
        values = effect.values
        match effect.name:
            case "link_mass":
                arm = arm.with_link(effect.number, mass=values["mass_kg"])
            case "link_com":
                arm = arm.with_link(effect.number, center=np.array([values[f"{axis}_m"] for axis in "xyz"]))
            case "payload_error":
                added += values["mass_kg"]
            case "base_tilt":
                tilt = rotation_from_vector(np.array([values["tilt_x_rad"], values["tilt_y_rad"], 0.0]))
                gravity = tilt.T @ gravity
    return replace(setup, arm=arm, gravity=gravity), added
