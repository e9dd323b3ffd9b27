"""The torques of a diagnosed arm's motors in any motion."""

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.domains.torque.filtering import interpolant
from lite6jax.domains.torque.problem import composed
from lite6jax.domains.torque.rows import RigidBodies, bodies_of
from lite6jax.effects.dynamic.torque_effect import Delaying
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording

Array = NDArray[np.floating]

_LINE = 10
"""Samples over which the slope is taken by which delayed torques go on beyond the ends of a run."""


@final
@dataclass(frozen=True, eq=False)
class DiagnosedMotors:
    """An arm with the effects on torques that were found.

    Attributes:
        arm: its chain.
        links: `(joint, 10)` inertial numbers, of the payload none.
        payload_center: `(3,)` m, of the payload, in the frame after the last joint.
        gravity: `(3,)` m/s² in the base frame.
        terms: the effects.
        values: `(terms.size,)`.
        reference_temperature: °C.
        heldout_rms: Nm, of held-out torques without and with the effects; None where not known.
    """

    arm: Arm
    links: Array
    payload_center: Array
    gravity: Array
    terms: Terms
    values: Array
    reference_temperature: float
    heldout_rms: tuple[float, float] | None = None

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.arm.dof

    @property
    def motion(self) -> str:
        """Torques are of a moving arm."""
        return "trajectory"


def predict_torques(model: DiagnosedMotors, recording: Recording) -> Array:
    """The torques `(sample, joint)` Nm that the sensors of a diagnosed recording would show in a motion.

    Args:
        model: as diagnosed.
        recording: joint positions with times, and with the drivers of its effects.

    Raises:
        InputError: no times, steps that vary, or a driver that the model needs and the motion lacks.
    """
    if recording.dof != model.dof:
        raise InputError(f"{recording.source}: has {recording.dof} joints, the diagnosed arm {model.dof}")
    if recording.motion != "trajectory":
        raise InputError(f"{recording.source}: is declared as static poses; torques are predicted for a trajectory")
    bodies, chosen, _ = bodies_of(recording, model.arm)
    declared = RigidBodies(bodies.motion, model.links, model.payload_center, model.gravity, bodies.kinematics)
    for effect in model.terms.terms:
        for driver in getattr(effect, "drivers", ()):
            if not driver.loaded and not driver.known(bodies.motion, None):
                raise InputError(f"{recording.source}: has no {driver.phrase}; give {driver.remedy}")
    torque = composed(model.terms, model.values, declared.dynamics(model.links))
    pairs = zip(model.terms.terms, model.terms.slices, strict=True)
    delay = sum(float(model.values[part][0]) for effect, part in pairs if isinstance(effect, Delaying))
    if not delay:
        return torque.T
    assert recording.time is not None
    later = torque.copy()
    for rows, spline in interpolant(torque, recording.time, chosen.runs):
        t, part = recording.time[rows], torque[:, rows]
        at = np.clip(t + delay, t[0], t[-1])
        # beyond the ends along the line through some samples: a cubic would follow their noise
        near, far = ((0, _LINE), (-1 - _LINE, -1))[delay > 0], (0, -1)[delay > 0]
        slope = (part[:, near[1]] - part[:, near[0]]) / (t[near[1]] - t[near[0]])
        beyond = t + delay - at
        later[:, rows] = np.where(beyond != 0, part[:, [far]] + slope[:, None] * beyond, spline(at))
    return later.T
