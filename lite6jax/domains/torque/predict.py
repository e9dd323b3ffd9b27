"""The torques of a diagnosed arm's motors in any motion."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.joint_units import joint_unit
from lite6jax.domains.pose.files import read_motion
from lite6jax.domains.torque.composition import composed, offsets_of
from lite6jax.domains.torque.filtering import interpolant
from lite6jax.domains.torque.rows import RigidBodies, bodies_of
from lite6jax.domains.torque.uncertainty import TorqueUncertainty, bars_of
from lite6jax.effects.dynamic.torque_effect import Dynamics
from lite6jax.errors import InputError, wrong_type
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording
from lite6jax.results import PublicResult

Array = NDArray[np.floating]

_LINE = 10
"""Samples over which the slope is taken by which delayed torques go on beyond the ends of a run."""


@final
@dataclass(frozen=True, eq=False, repr=False)
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
        uncertainty: from which standard deviations of predictions follow; None where the diagnosis does not say.
        relative_to: the recording beyond which the effects were found; None where they are all that there is.
    """

    arm: Arm
    links: Array
    payload_center: Array
    gravity: Array
    terms: Terms
    values: Array
    reference_temperature: float
    uncertainty: TorqueUncertainty | None = None
    relative_to: str | None = None

    def __repr__(self) -> str:
        effects = ", ".join(str(getattr(term, "label", term)) for term in self.terms.terms) or "no effects"
        return f"model of the motors of a {self.arm.name} with {effects}"

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.arm.dof

    @property
    def sliding(self) -> tuple[int, ...]:
        """The prismatic joints, counted from 0."""
        return self.arm.sliding

    @property
    def motion(self) -> str:
        """Torques are of a moving arm."""
        return "trajectory"


@final
@dataclass(frozen=True, eq=False, repr=False)
class TorquePrediction(PublicResult):
    """Predicted torques with standard deviations.

    Attributes:
        torque: `(sample, joint)` Nm, N of prismatic joints.
        std: `(sample, joint)` Nm, of what a sensor shows from what is predicted: what was estimated is uncertain, not
            all is explained, and the sensor has noise; None where the diagnosis says nothing of it.
        outside: `(sample,)` bool, rows in which a joint's position, velocity or acceleration, or a quantity on which an
            effect depends, is beyond what was recorded; None where the diagnosis does not say what was.
        sliding: the prismatic joints, counted from 0.
    """

    torque: Array
    std: Array | None
    outside: NDArray[np.bool_] | None
    sliding: tuple[int, ...] = ()


def predict_torques(model: DiagnosedMotors, recording: Recording | str | Path) -> Array:
    """The torques `(sample, joint)` Nm that the sensors of a diagnosed recording would show in a motion.

    Args:
        model: as diagnosed.
        recording: joint positions with times, and with the drivers of its effects; or the path of their file.

    Raises:
        InputError: no times, steps that vary, or a driver that the model needs and the motion lacks.
    """
    return _torques(model, *_along(model, recording))


def predicted_torques(model: DiagnosedMotors, recording: Recording | str | Path) -> TorquePrediction:
    """The torques of a motion as `predict_torques`, with their standard deviations.

    Rows outside what was recorded are marked, and their standard deviations grow as those of `predicted` do.

    Raises:
        InputError: as `predict_torques`.
    """
    bodies, runs = _along(model, recording)
    torque, bars = _torques(model, bodies, runs), bars_of(model, bodies, runs)
    std, outside = (None, None) if bars is None else (bars.std.T, bars.outside)
    return TorquePrediction(torque, std, outside, model.sliding)


def torque_columns(found: TorquePrediction) -> dict[str, Array | NDArray[np.integer]]:
    """Column name to values: `tau1_Nm` …, and `tau1_std_Nm` … and `outside`, 0 or 1, where these are known.

    Those of prismatic joints are `tau3_N` and `tau3_std_N`.
    """
    units = [joint_unit("Nm", joint in found.sliding) for joint in range(found.torque.shape[1])]
    columns: dict[str, Array | NDArray[np.integer]] = {
        f"tau{joint}_{unit}": row for joint, (unit, row) in enumerate(zip(units, found.torque.T, strict=True), 1)
    }
    if found.std is not None and found.outside is not None:
        pairs = zip(units, found.std.T, strict=True)
        columns |= {f"tau{joint}_std_{unit}": row for joint, (unit, row) in enumerate(pairs, 1)}
        columns["outside"] = found.outside.astype(int)
    return columns


def _along(model: DiagnosedMotors, recording: Recording | str | Path) -> tuple[RigidBodies, NDArray[np.integer]]:
    """The dynamics of the model's links along a motion, and the run of each sample."""
    if not isinstance(model, DiagnosedMotors):
        raise wrong_type("model", model, "lite6jax.read_torque_model('d.json'), or the `model` of a TorqueDiagnosis")
    if isinstance(recording, str | Path):
        recording = read_motion(recording, model)
    if not isinstance(recording, Recording):
        raise wrong_type("recording", recording, "the path of a recording, or a Recording")
    if recording.dof != model.dof:
        raise InputError(f"{recording.source}: has {recording.dof} joints, the diagnosed arm {model.dof}")
    bodies, chosen, _ = bodies_of(recording, model.arm)
    for effect in model.terms.terms:
        for driver in getattr(effect, "drivers", ()):
            if not driver.loaded and not driver.known(bodies.motion, None):
                raise InputError(f"{recording.source}: has no {driver.phrase}; give {driver.remedy}")
    moved = replace(bodies, links=model.links, payload_center=model.payload_center, gravity=model.gravity)
    return moved, chosen.runs


def _torques(model: DiagnosedMotors, bodies: RigidBodies, runs: NDArray[np.integer]) -> Array:
    dynamics, time = bodies.dynamics(model.links), np.asarray(bodies.motion.time)
    return shown_torques(model.terms, model.values, dynamics, time, runs).T


def shown_torques(terms: Terms, values: Array, dynamics: Dynamics, time: Array, runs: NDArray[np.integer]) -> Array:
    """`(joint, sample)` Nm that the sensors show in a motion, as their stamps say.

    Args:
        terms: effects.
        values: `(terms.size,)`.
        dynamics: of the arm without them.
        time: `(sample,)` s.
        runs: `(sample,)`, the run of each sample.
    """
    torque = composed(terms, values, dynamics)
    offsets = offsets_of(terms, values, len(torque))
    later = torque.copy()
    for offset in np.unique(offsets[offsets != 0]):
        joints = np.flatnonzero(offsets == offset)
        later[joints] = _later(torque[joints], float(offset), time, runs)
    return later


def _later(torque: Array, offset: float, time: Array, runs: NDArray[np.integer]) -> Array:
    """Torques `(joint, sample)` of the motion `offset` s later."""
    later = torque.copy()
    for rows, spline in interpolant(torque, time, runs):
        t, part = time[rows], torque[:, rows]
        at = np.clip(t + offset, t[0], t[-1])
        # beyond the ends along the line through some samples: a cubic would follow their noise
        near, far = ((0, _LINE), (-1 - _LINE, -1))[offset > 0], (0, -1)[offset > 0]
        slope = (part[:, near[1]] - part[:, near[0]]) / (t[near[1]] - t[near[0]])
        beyond = t + offset - at
        later[:, rows] = np.where(beyond != 0, part[:, [far]] + slope[:, None] * beyond, spline(at))
    return later
