"""What the arm exerts on each joint along a motion, and rollouts of the coupled arm by iterating it.

Of joint i the rest of the arm exerts L = τ(q, q̇, q̈) − M·q̈ᵢ, with the inverse dynamics τ of rigid bodies and M the
diagonal of the mass matrix. L is taken along one rollout of all joints and held in the next one. Its fixed point is the
coupled arm, whatever M is taken.

Joints of which each moves the others by nearly as much as itself make that iteration go apart, for want of inertia of
their own. So M is taken larger there, and L is mixed with those of a few sweeps before, such that what is left is least
(D. G. Anderson, Journal of the ACM 12, 1965).

What is left, r, is answered by the joints: a change d of L changes the accelerations by −R·d, and with them what the
arm exerts by −O·R·d, O being the mass matrix less M. Nothing is left after d where

    (1 + O·R) d = r,  Rᵢ = s² / ((M + A) s² + (kd + b) s + kp).
"""

from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy  # whose parts are imported where they are first used
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.dynamics import inverse_dynamics, link_parameters
from lite6jax.domains.tracking.rollout import GRIP, Commands, Rolled, roll
from lite6jax.effects.dynamic import OfLink, point_mass
from lite6jax.effects.servo import RIGID_GRIP, Servo

Array = NDArray[np.floating]

_SWEEPS = 12
"""Rollouts at most, each along the motion of the one before."""
_MIXED = 6
"""Sweeps before the last one, whose loads are mixed with its own."""
_TERMS = 3
"""Of the series d = r − O·R·r + …; with twice as many no sweep is saved."""
_POSTURES = 20
"""Of a motion, in which the inertias of joints are compared."""
_ALIKE = 1e-10
"""Relative eigenvalue below which two of them are alike."""
SETTLED = 1e-8
"""rad RMS, by which read-outs of two sweeps differ at the end."""
_NEAR = 1e-3
"""rad RMS, by which they differ at most where further rollouts may begin with the loads of the last one."""
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
        """Of an arm, with a payload in kg whose centre `(3,)` m is in the flange's frame; without masses, of none."""
        at = arm.T_joint_flange[:3, :3] @ np.asarray(center, float) + arm.T_joint_flange[:3, 3]
        links = np.zeros((arm.dof, 10)) if arm.mass is None else np.array(link_parameters(arm))
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
        torque = np.asarray(inverse_dynamics(self.kinematics, self.links, q, dq, ddq, gravity))
        if self.added is None:
            return torque
        links = np.zeros_like(self.links)
        links[-1] = point_mass(1.0, self.payload_center)
        unit = np.asarray(inverse_dynamics(self.kinematics, links, q, dq, ddq, gravity))
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
    """

    load: Array
    mass: Array
    weight: Array


def interpolate(values: Array, commands: Commands) -> Array:
    """Values `(joint, sample)` on a line from sample to sample, `(joint, step)`; the last of a run holds."""
    ends = np.r_[commands.reset[1:], True]
    following = np.where(ends, values, np.roll(values, -1, 1))
    share = np.arange(commands.steps) / commands.steps
    return (values[:, :, None] + share * (following - values)[:, :, None]).reshape(len(values), -1)


def loads_along(bodies: Bodies, commands: Commands, q: Array, dq: Array, ddq: Array) -> JointLoads:
    """The loads along a motion `(joint, sample)`, between its samples on a line."""
    diagonal = bodies.masses(q)
    load = bodies.torques(q, dq, ddq) - diagonal * ddq
    return JointLoads(interpolate(load, commands), interpolate(diagonal, commands), _weights(bodies, commands))


def _weights(bodies: Bodies, commands: Commands) -> Array:
    """As `JointLoads.weight`."""
    begins = np.flatnonzero(commands.reset)
    there = bodies if bodies.added is None else replace(bodies, added=bodies.added[begins])
    start = commands.start[begins].T
    still = np.zeros_like(start)
    weights = np.zeros((commands.joints, commands.samples))
    weights[:, begins] = there.torques(start, still, still)
    return weights


def _own_masses(matrix: Array, servo: Servo) -> Array:
    """kg·m² `(joint, sample)`, M by which an iteration comes closer fastest, beside mass matrices.

    With the rotors it is the diagonal of the mass matrix times the middle of the eigenvalues of that matrix over it.

    Args:
        matrix: `(joint, joint, sample)` kg·m².
        servo: each `(joint,)`.
    """
    diagonal = np.diagonal(matrix).T
    rotor = np.asarray(servo.inertia, float)[:, None]
    some = slice(None, None, max(matrix.shape[2] // _POSTURES, 1))
    size = np.sqrt(np.maximum(diagonal + rotor, 1e-12))[:, some]
    with_rotors = matrix[:, :, some] + rotor[:, None] * np.eye(len(matrix))[:, :, None]
    scaled = with_rotors / (size[:, None] * size[None])
    eigenvalues = np.linalg.eigvalsh(np.moveaxis(np.nan_to_num(scaled), 2, 0))
    middle = max(float(np.max(eigenvalues[:, 0] + eigenvalues[:, -1])) / 2, 1.0)
    return middle * (diagonal + rotor) - rotor


class _Answer:
    """How an arm whose joints follow their servos linearly answers what is left of its loads.

    Args:
        matrix: `(joint, joint, sample)` kg·m², the mass matrix.
        own: `(joint, sample)` kg·m², M.
        servo: each `(joint,)`.
        commands: of all joints.
    """

    def __init__(self, matrix: Array, own: Array, servo: Servo, commands: Commands) -> None:
        joints = np.arange(len(matrix))
        self._others = matrix.copy()
        self._others[joints, joints] -= own
        self._steps = commands.steps
        inertia = own.mean(1) + servo.inertia
        drag = np.asarray(servo.damping) + servo.viscous
        # s = 2/h · (1 − z⁻¹) / (1 + z⁻¹)
        rate = 2 / commands.step
        twice = rate**2 * np.array([1.0, -2.0, 1.0])
        once = rate * np.array([1.0, 0.0, -1.0])
        filters = zip(inertia, drag, np.asarray(servo.stiffness), strict=True)
        self._numerator = twice
        self._denominators = [m * twice + c * once + k * np.array([1.0, 2.0, 1.0]) for m, c, k in filters]

    def change(self, left: Array) -> Array:
        """The change `(joint, step)` Nm of the loads that are held after which nothing is left; d."""
        change = left
        for _ in range(_TERMS):
            accelerations = [
                scipy.signal.lfilter(self._numerator, denominator, row)
                for denominator, row in zip(self._denominators, change, strict=True)
            ]
            by_sample = np.stack(accelerations).reshape(len(left), -1, self._steps)
            change = left - np.einsum("ijs,jsk->isk", self._others, by_sample).reshape(left.shape)
        return change


class _Mixture:
    """Anderson's mixture of the loads of several sweeps.

    Args:
        weights: `(joint,)` rad/Nm, by which what is left is compared between joints.
    """

    def __init__(self, weights: Array) -> None:
        self._weights = weights[:, None]
        self._last: tuple[Array, Array] | None = None
        self._moved: list[Array] = []
        self._left: list[Array] = []

    def next(self, held: Array, along: Array) -> Array:
        """The loads to hold next, after some `(joint, step)` Nm were held and others found along the rollout."""
        left = along - held
        if not np.isfinite(left).all():
            return along
        if self._last is not None:
            self._moved = [*self._moved, held - self._last[0]][-_MIXED:]
            self._left = [*self._left, left - self._last[1]][-_MIXED:]
        self._last = held, left
        if not self._left:
            return along
        columns = np.stack([(self._weights * part).ravel() for part in self._left])
        target = columns @ (self._weights * left).ravel()
        shares = np.linalg.lstsq(columns @ columns.T, target, rcond=_ALIKE)[0]
        pairs = zip(shares, self._moved, self._left, strict=True)
        return along - np.sum([share * (moved + change) for share, moved, change in pairs], 0)


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
        extra: `(joint, 2, sample)` Nm, as of `roll`.
        settled: rad RMS, of each joint or of all, by which read-outs of two sweeps differ at most at the end.
    """
    joints = np.arange(bodies.joints)
    given = loads
    change = np.full(bodies.joints, np.inf)
    weight = _weights(bodies, commands)
    rolled = roll(servo, commands, joints, loads.load, loads.mass, extra=extra, weight=weight, fine=True)
    if not bodies.links.any():
        return rolled, loads
    # of these bodies: rollouts with the inertia of an arm without its payload may go apart
    matrix = bodies.mass_matrix(rolled.position[:, :: commands.steps])
    own = _own_masses(matrix, servo)
    mass = interpolate(own, commands)
    load = loads.load + (loads.mass - mass) * rolled.acceleration
    mixture = _Mixture(1 / np.maximum(np.asarray(servo.stiffness, float), 1e-9))
    answer = None
    for sweep in range(_SWEEPS):
        before = rolled.readout
        with np.errstate(invalid="ignore", over="ignore"):  # of an arm that its servos do not hold
            along = bodies.torques(rolled.position, rolled.velocity, rolled.acceleration) - mass * rolled.acceleration
            if not sweep:  # this change is mostly that of the motion, which is slow: joints hardly answer it
                load = along
            else:
                answer = answer or _Answer(matrix, own, servo, commands)
                load = mixture.next(load, load + answer.change(along - load))
            loads = JointLoads(load, mass, weight)
            rolled = roll(servo, commands, joints, load, mass, extra=extra, weight=weight, fine=True)
            change = np.sqrt(np.mean((rolled.readout - before) ** 2, 1))
        if np.all(change < settled) or not np.all(change < _APART):
            break
    return rolled, loads if np.all(change < _NEAR) else given
