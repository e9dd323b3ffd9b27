"""What the arm exerts on each joint along a motion, and rollouts of the coupled arm by iterating it.

Of joint i the rest of the arm exerts L = τ(q, q̇, q̈) − M·q̈ᵢ, with the inverse dynamics τ of rigid bodies and M the
diagonal of the mass matrix. L is taken along one rollout of all joints and held in the next one, in which it changes
with the accelerations at every step: L + O·(q̈ − q̈ before), O being the mass matrix less its diagonal. The iteration
then only has to correct how torques of gravity, Coriolis terms and O vary with the motion, which is little: two to four
rollouts converge. The fixed point is the coupled arm for any choice of O.
"""

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.arms.dynamics import declared_links, recorded_torques
from lite6jax.array_types import Array
from lite6jax.domains.tracking.rollout import GRIP, Commands, Coupling, Rolled, roll
from lite6jax.effects.dynamic import OfLink, point_mass
from lite6jax.effects.servo import RIGID_GRIP, Servo

_SWEEPS = 12
"""Rollouts at most, each along the motion of the one before."""
_FIRST_SHARE = 0.5
"""Of the change of a first sweep, by which a second one is taken to change read-outs."""
_SLOWEST = 0.95
"""Of such shares, the largest that is reckoned with."""
SETTLED = 1e-8
"""rad RMS, by which further sweeps would change read-outs."""
_NEAR = 1e-3
"""rad RMS, by which two sweeps differ at most where further rollouts may begin with the loads of the last one."""
_APART = 10.0
"""rad RMS, from which two sweeps are of an arm that its servos do not hold: further ones do not settle."""


@final
@dataclass(frozen=True, eq=False)
class Bodies:
    """The rigid bodies of an arm with a payload.

    Attributes:
        kinematics: `(joint, 6)` m and rad.
        links: `(joint, 10)` inertial numbers, with the payload's.
        payload_center: `(3,)` m, in the frame after the last joint.
        gravity: `(3,)` m/s² in the base frame.
        payload: kg of the payload in `links`.
        added: `(sample,)` kg at the payload's centre beside `links`, in motions of so many samples, or of so many times
            as many steps; None where the payload is one.
    """

    kinematics: Array
    links: Array
    payload_center: Array
    gravity: Array
    payload: float = 0.0
    added: Array | None = None

    @classmethod
    def of_arm(cls, arm: Arm, payload: float, center: Array, gravity: Array) -> "Bodies":
        """Takes an arm, and a payload in kg with its centre `(3,)` m in the flange's frame; without masses, none."""
        at = arm.T_joint_flange[:3, :3] @ np.asarray(center, float) + arm.T_joint_flange[:3, 3]
        links = declared_links(arm)
        links[-1] += point_mass(payload, at)
        return cls(np.asarray(arm.kinematics), links, at, np.asarray(gravity, float), payload)

    @property
    def joints(self) -> int:
        return len(self.links)

    def with_payload(self, mass: float) -> "Bodies":
        """With more kg at the payload's centre."""
        links = self.links.copy()
        links[-1] += point_mass(mass, self.payload_center)
        return replace(self, links=links, payload=self.payload + mass)

    def with_link(self, effect: OfLink, values: Array) -> "Bodies":
        """With another link, by the numbers `(coordinate,)` of an effect on its inertia."""
        bare = self.links.copy()
        bare[-1] -= point_mass(self.payload, self.payload_center)
        links = self.links.copy()
        links[effect.link - 1] += effect.inertial(values, bare)
        return replace(self, links=links)

    def tilted(self, tilt: Array) -> "Bodies":
        """With the base tilted by a rotation vector whose parts about x and y are `(2,)` rad."""
        turn = np.array([tilt[0], tilt[1], 0.0])
        angle = float(np.linalg.norm(turn))
        once = np.cross(turn, self.gravity)
        twice = np.cross(turn, once)
        # sinc of NumPy is that of π times its argument
        turned = self.gravity - np.sinc(angle / np.pi) * once + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * twice
        return replace(self, gravity=turned)

    def torques(self, q: Array, dq: Array, ddq: Array) -> Array:
        """`(joint, sample)` Nm along a motion of that shape."""
        return self._inverse_dynamics(q, dq, ddq, self.gravity)

    def _inverse_dynamics(self, q: Array, dq: Array, ddq: Array, gravity: Array) -> Array:
        torque = recorded_torques(self.kinematics, self.links, (q, dq, ddq), gravity)
        if self.added is None:
            return torque
        links = np.zeros_like(self.links)
        links[-1] = point_mass(1.0, self.payload_center)
        unit = recorded_torques(self.kinematics, links, (q, dq, ddq), gravity)
        return torque + np.repeat(self.added, q.shape[1] // len(self.added)) * unit

    def mass_matrix(self, q: Array) -> Array:
        """`(joint, joint, sample)` kg·m², at positions `(joint, sample)`."""
        still = np.zeros_like(q)
        columns = []
        for joint in range(self.joints):
            unit = still.copy()
            unit[joint] = 1.0
            columns.append(self._inverse_dynamics(q, still, unit, np.zeros(3)))
        return np.stack(columns, 1)

    def masses(self, q: Array) -> Array:
        """`(joint, sample)` kg·m², the diagonal of the mass matrix."""
        return np.diagonal(self.mass_matrix(q), axis1=0, axis2=1).T

    @property
    def grip(self) -> Array:
        """`(joint,)` kg·m², how firmly friction holds joints that stick; that of no masses is nearly rigid."""
        if not self.links.any():
            return np.full(self.joints, RIGID_GRIP)
        M = replace(self, added=None).mass_matrix(np.zeros((self.joints, 1)))[..., 0]
        return GRIP / np.diagonal(np.linalg.pinv(M))


@final
@dataclass(frozen=True, eq=False)
class JointLoads:
    """What acts on each joint beside its servo, at every step.

    Attributes:
        load: `(joint, step)` Nm, L.
        mass: `(joint, step)` kg·m², M.
        weight: `(joint, sample)` Nm, what L is at rest where runs begin; of other samples zero.
        coupling: how L changes with accelerations; None of no masses.
    """

    load: Array
    mass: Array
    weight: Array
    coupling: Coupling | None = None


def interpolate(values: Array, commands: Commands) -> Array:
    """Values `(joint, sample)` on a line from sample to sample, `(joint, step)`; the last of a run holds."""
    ends = np.r_[commands.reset[1:], True]
    following = np.where(ends, values, np.roll(values, -1, 1))
    share = np.arange(commands.steps) / commands.steps
    return (values[:, :, None] + share * (following - values)[:, :, None]).reshape(len(values), -1)


def loads_along(bodies: Bodies, commands: Commands, q: Array, dq: Array, ddq: Array) -> JointLoads:
    """The loads along a motion `(joint, sample)`, between its samples on a line."""
    matrix = bodies.mass_matrix(q)
    mass = np.diagonal(matrix).T
    load = bodies.torques(q, dq, ddq) - mass * ddq
    coupling = None
    if bodies.links.any():
        coupling = Coupling(_beside_diagonal(matrix), interpolate(ddq, commands))
    return JointLoads(interpolate(load, commands), interpolate(mass, commands), _weights(bodies, commands), coupling)


def _beside_diagonal(matrix: Array) -> Array:
    """`(sample, joint, joint)`, matrices `(joint, joint, sample)` less their diagonal."""
    others = np.moveaxis(matrix, 2, 0).copy()
    joints = np.arange(len(matrix))
    others[:, joints, joints] = 0.0
    return others


def _weights(bodies: Bodies, commands: Commands) -> Array:
    """As `JointLoads.weight`."""
    begins = np.flatnonzero(commands.reset)
    there = bodies if bodies.added is None else replace(bodies, added=bodies.added[begins])
    start = commands.start[begins].T
    still = np.zeros_like(start)
    weights = np.zeros((commands.joints, commands.samples))
    weights[:, begins] = there.torques(start, still, still)
    return weights


def roll_coupled(
    servo: Servo,
    commands: Commands,
    bodies: Bodies,
    loads: JointLoads,
    extra: Array | None = None,
    settled: float | Array = SETTLED,
) -> tuple[Rolled, JointLoads]:
    """The coupled arm, and the loads along it; those that were given where rollouts do not come closer to each other.

    Args:
        servo: each `(joint,)`.
        commands: of all joints.
        bodies: the arm.
        loads: to begin with.
        extra: `(joint, channel, sample)`, as of `roll`.
        settled: rad RMS, of each joint or of all, by which further sweeps would change read-outs at most.
    """
    joints = np.arange(bodies.joints)
    given = loads
    weight = _weights(bodies, commands)

    def rolled_along(loads: JointLoads) -> Rolled:
        terms = loads.load, loads.mass
        return roll(servo, commands, joints, *terms, None, extra, weight, fine=True, coupling=loads.coupling)

    rolled = rolled_along(loads)
    if not bodies.links.any():
        return rolled, loads
    matrix = bodies.mass_matrix(rolled.position[:, :: commands.steps])
    mass = interpolate(np.diagonal(matrix).T, commands)
    others = _beside_diagonal(matrix)
    change = np.full(bodies.joints, np.nan)
    for _ in range(_SWEEPS):
        before = rolled.readout
        last_change = change
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):  # of an arm that its servos do not hold
            load = bodies.torques(rolled.position, rolled.velocity, rolled.acceleration) - mass * rolled.acceleration
            loads = JointLoads(load, mass, weight, Coupling(others, rolled.acceleration))
            rolled = rolled_along(loads)
            change = np.sqrt(np.mean((rolled.readout - before) ** 2, 1))
            # further sweeps change by this share of the one before each
            share = np.clip(np.nan_to_num(change / last_change, nan=_FIRST_SHARE), 0.0, _SLOWEST)
        if np.all(change * share / (1 - share) < settled) or not np.all(change < _APART):
            break
    return rolled, loads if np.all(change < _NEAR) else given
