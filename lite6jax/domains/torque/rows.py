"""The rows of a torque recording: its motion, its rigid-body dynamics and its torques, filtered alike."""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import final

import jax
import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.arms.dynamics import declared_links, recorded_regressor
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.torque.filtering import (
    LowPass,
    Smoothed,
    each_posture,
    low_pass,
    modelled,
    runs_of,
    sample_rate,
    smoothed,
    without_ends,
)
from lite6jax.effects.dynamic import Dynamics, declared_torque, direction, point_mass
from lite6jax.effects.motion import Motion
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.motion import motion_of_recording
from lite6jax.recordings.units import other_joints


@final
@dataclass(frozen=True, eq=False)
class RigidBodies:
    """The rigid-body dynamics of an arm along a motion: torques are linear in its links' inertial numbers.

    Torques are in Nm, those of the prismatic joints of the motion are forces in N; so in all of this domain.

    Attributes:
        motion: smoothed, with accelerations; NumPy arrays.
        links: `(joint, 10)`, of the declared arm; zero where it has none.
        payload_center: `(3,)` m in the frame after the last joint.
        gravity: `(3,)` m/s² in the base frame.
        kinematics: `(joint, 6)`.
        drives: `(joint, sample)` Nm of the friction, rotors and springs that the arm's description declares.
        period: s, the time of a sample, as of `Dynamics`.
    """

    motion: Motion
    links: Array
    payload_center: Array
    gravity: Array
    kinematics: Array
    drives: Array | float = 0.0
    period: float = 0.0

    @property
    def moved(self) -> Array:
        """`(3, joint, sample)`: position, velocity and acceleration of each joint."""
        m = self.motion
        return np.stack([np.asarray(part) for part in (m.joint_position, m.joint_velocity, m.joint_acceleration)])

    @cached_property
    def regressor(self) -> Array:
        """`(joint, 10 joint, sample)`, torques by each inertial number."""
        return recorded_regressor(self.kinematics, self.moved, self.gravity, self.motion.sliding.joints)

    def of_inertia(self, numbers: Array) -> Array:
        """Torques `(joint, sample)` by inertial numbers `(joint, 10)`."""
        return np.asarray(numbers, float).ravel() @ self.regressor

    @cached_property
    def of_payload(self) -> Array:
        """Torques `(joint, sample)` by the payload as declared row by row."""
        payload = np.asarray(self.motion.payload)
        if payload.any():
            return self.of_inertia(self.at_flange) * payload
        return np.zeros(self.moved.shape[1:])

    @property
    def at_flange(self) -> Array:
        """`(joint, 10)`, inertial numbers of a kilogram at the payload's centre."""
        unit = np.zeros_like(self.links)
        unit[-1] = point_mass(1.0, self.payload_center)
        return unit

    def of_gravity(self, links: Array, gravity: Array) -> Array:
        """Torques `(joint, sample)` at rest of links `(joint, 10)` with the payload, by a gravity `(3,)` m/s²."""
        q = self.moved[0]
        at_rest = recorded_regressor(self.kinematics, (q, 0 * q, 0 * q), gravity, self.motion.sliding.joints)
        return links.ravel() @ at_rest + self.at_flange.ravel() @ at_rest * np.asarray(self.motion.payload)

    def dynamics(self, links: Array) -> Dynamics:
        """The dynamics of an arm whose links have these inertial numbers `(joint, 10)`."""
        return Dynamics(
            motion=self.motion,
            torque=self.of_inertia(links) + self.of_payload,
            links=links,
            payload_center=self.payload_center,
            of_inertia=self.of_inertia,
            of_gravity=partial(self.of_gravity, links),
            gravity=self.gravity,
            drives=self.drives,
            period=self.period,
        )


@final
@dataclass(frozen=True, eq=False)
class TorqueRows:
    """What a torque recording is compared with, row by row.

    Attributes:
        recording: its rows in the order of time.
        arm: the declared arm.
        bodies: its dynamics along the smoothed motion, at the samples of the model.
        torque: `(joint, row)` Nm, measured, without spikes.
        recorded: the filter of measured torques, which are of every row.
        filter: that of modelled torques, which are of every sample; it keeps the same moments.
        rows: `(sample,)`, the row of each sample: of fast recordings one in several.
        motion_cutoff: Hz, of the low pass of the motion.
        slack: `(joint, sample)` Nm, one sigma of what friction holds at rest and of what was interpolated across a
            bend; None where there is neither.
        turning: `(joint, sample)` Nm, one sigma of friction where the direction of motion is not known; or None.
        repeated: `(sample,)`, those that say again what another one says of the same rest; None where there are none.
    """

    recording: Recording
    arm: Arm
    bodies: RigidBodies
    torque: Array
    recorded: LowPass
    filter: LowPass
    rows: Integers
    motion_cutoff: float
    slack: Array | None = None
    turning: Array | None = None
    repeated: Mask | None = None

    @property
    def motion(self) -> Motion:
        """The motion of every sample."""
        return self.bodies.motion

    @cached_property
    def time(self) -> Array:
        """`(kept,)` s, of the samples that are kept."""
        assert self.recording.time is not None
        return self.recording.time[self.recorded.kept]

    @cached_property
    def runs(self) -> Integers:
        """`(kept,)`, the run of each sample that is kept."""
        return self.filter.runs[self.filter.kept]

    @cached_property
    def regressor(self) -> Array:
        """`(joint, 10 joint, kept)`, filtered."""
        return self.filter(self.bodies.regressor)

    @cached_property
    def measured(self) -> Array:
        """`(joint, kept)` Nm, filtered."""
        return self.recorded(self.torque)


def require_joints(recording: Recording, arm: Arm) -> None:
    """Refuses a recording whose joints are others than the arm's.

    Raises:
        InputError: another number of joints, or angles of prismatic joints, or lengths of revolute ones.
    """
    if recording.dof != arm.dof:
        raise InputError(
            f"{recording.source}: has {recording.dof} joints, the arm {arm.name} {arm.dof}; choose the arm it is of"
        )
    if recording.sliding != arm.sliding:
        raise InputError(f"{recording.source}: {other_joints(recording.sliding, arm.sliding, arm.name)}")


def bodies_of(recording: Recording, arm: Arm) -> tuple[RigidBodies, LowPass, float]:
    """The rigid-body dynamics along a recording's motion, the filter for its torques, and the motion's cutoff in Hz.

    Static postures are no motion: they have neither velocities nor accelerations, and are not filtered.

    Raises:
        InputError: no times, steps that vary, an arm at rest, or one whose prismatic joints are others.
    """
    require_joints(recording, arm)
    if recording.motion == "static":
        chosen = each_posture(recording.samples)
        q = recording.joint_position.T
        smooth = Smoothed(q, np.zeros_like(q), np.zeros_like(q), chosen.cutoff)
    else:
        rate = sample_rate(recording)
        chosen = low_pass(recording.velocities().T, rate, runs_of(recording, rate))
        smooth = smoothed(recording, chosen)
        chosen = without_ends(chosen, smooth.cutoff)
    motion = motion_of_recording(recording)
    moved = jax.tree.map(np.asarray, motion)._replace(
        joint_position=smooth.position,
        joint_velocity=smooth.velocity,
        direction=direction(smooth.velocity, arm.slides),
        joint_acceleration=smooth.acceleration,
    )
    settings = recording.settings
    center = arm.T_joint_flange[:3, :3] @ np.array(settings.payload_com_m) + arm.T_joint_flange[:3, 3]
    links = declared_links(arm)
    gravity = np.array(settings.gravity_m_per_s2)
    bodies = RigidBodies(moved, links, center, gravity, np.asarray(arm.kinematics), declared_torque(arm, moved))
    return bodies, chosen, smooth.cutoff


def torque_rows(recording: Recording, arm: Arm, torque: Array) -> TorqueRows:
    """The rows of a recording with times and velocities.

    Args:
        recording: in the order of time.
        arm: the declared arm.
        torque: `(joint, row)` Nm, without spikes.

    Raises:
        InputError: as `bodies_of`.
    """
    bodies, chosen, cutoff = bodies_of(recording, arm)
    if not len(chosen.kept):
        raise InputError(f"{recording.source}: every run is shorter than its filter; record runs of some seconds")
    samples, rows = modelled(chosen)
    if len(rows) < recording.samples:
        bodies = _thinned(bodies, arm, samples, rows)
    return TorqueRows(recording, arm, bodies, torque, chosen, samples, rows, cutoff)


def _thinned(bodies: RigidBodies, arm: Arm, samples: LowPass, rows: Integers) -> RigidBodies:
    """The dynamics at some rows, each of which stands for those around it."""
    motion = jax.tree.map(lambda leaf: leaf[..., rows], bodies.motion)
    first, end = (np.searchsorted(motion.run[0], motion.run[0], side) for side in ("left", "right"))
    motion = motion._replace(run=np.stack([first, end - 1]))
    period = 1 / samples.rate
    dq = motion.joint_velocity
    ddq = motion.joint_acceleration
    motion = motion._replace(direction=direction(dq, arm.slides, change=period * ddq))
    return replace(bodies, motion=motion, drives=declared_torque(arm, motion, period), period=period)
