"""What the motors exert: rigid-body dynamics, hidden effects on torques, and noise.

The dynamics are those of Newton and Euler in the base frame, in NumPy. They share no code with the inverse dynamics by
which a recording is diagnosed, and take no time to compile.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.effects.dynamic.bodies import PayloadTorque
from lite6jax.effects.dynamic.motors import TorqueTimeOffset
from lite6jax.effects.dynamic.torque_effect import Delaying, Dynamics, Scaling, TorqueEffect, point_mass
from lite6jax.effects.effect import Effect
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import STANDARD_GRAVITY

Array = NDArray[np.floating]
Hidden = tuple[TorqueEffect, Array]
"""An effect with its values."""

_GRAVITY = np.array(STANDARD_GRAVITY)
_SEEN_BY_BOTH = {kind.name: kind for kind in (PayloadTorque, TorqueTimeOffset)}
"""Causes that a sensor of poses and one of torques both see."""


def seen_by_motors(effect: Effect, values: Array) -> tuple[Hidden, ...]:
    """What an effect on poses is to the motors: the same payload and the same clock; nothing else is."""
    kind = _SEEN_BY_BOTH.get(effect.name)
    return () if kind is None else ((kind(), values),)


def inertial_numbers(arm: Arm) -> Array:
    """`(joint, 10)` of each link about its frame's origin: m, m·c, and the tensor's xx yy zz xy xz yz.

    Links without tensors are points, and without masses they weigh nothing.
    """
    numbers = np.zeros((arm.dof, 10))
    if arm.mass is None or arm.center_of_mass is None:
        return numbers
    for i, (mass, center) in enumerate(zip(arm.mass, arm.center_of_mass, strict=True)):
        numbers[i] = point_mass(float(mass), center)
    if arm.inertia is not None:
        I = arm.inertia
        numbers[:, 4:] += np.stack([I[:, i, k] for i, k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))], 1)
    return numbers


class _Moving(NamedTuple):
    """Each link's frame in the base frame, and how it moves; the sample is the last axis.

    Attributes:
        R: `(joint, 3, 3, sample)` rotations.
        origin: `(joint, 3, sample)` m.
        spin: `(joint, 3, sample)` rad/s, the angular velocity.
        spin_rate: `(joint, 3, sample)` rad/s².
        acceleration: `(joint, 3, sample)` m/s², of the origin less gravity.
    """

    R: Array
    origin: Array
    spin: Array
    spin_rate: Array
    acceleration: Array

    @classmethod
    def of(cls, links: Array, q: Array, dq: Array, ddq: Array, gravity: Array) -> "_Moving":
        """From fixed transforms `(joint, 4, 4)` and joints `(joint, sample)`."""
        samples = q.shape[1]
        R = np.broadcast_to(np.eye(3)[..., None], (3, 3, samples))
        spin, rate, origin = np.zeros((3, 3, samples))
        acceleration = np.broadcast_to(-gravity[:, None], (3, samples))
        found = []
        for link, angle, speed, speed_rate in zip(links, q, dq, ddq, strict=True):
            arm = np.einsum("abs,b->as", R, link[:3, 3])
            origin = origin + arm
            acceleration = acceleration + _cross(rate, arm) + _cross(spin, _cross(spin, arm))
            x, y, z = np.einsum("abs,bc->cas", R, link[:3, :3])
            c, s = np.cos(angle), np.sin(angle)
            R = np.stack([c * x + s * y, c * y - s * x, z], 1)
            rate = rate + speed_rate * z + _cross(spin, speed * z)
            spin = spin + speed * z
            found.append((R, origin, spin, rate, acceleration))
        return cls(*(np.stack(part) for part in zip(*found, strict=True)))

    def torque(self, numbers: Array) -> Array:
        """`(joint, sample)` Nm of the motors by inertial numbers `(joint, 10)`."""
        w, dw, a = (np.einsum("jabs,jas->jbs", self.R, v) for v in (self.spin, self.spin_rate, self.acceleration))
        h, (xx, yy, zz, xy, xz, yz) = numbers[:, 1:4, None], numbers[:, 4:].T
        I = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], 1).reshape(-1, 3, 3)
        force = numbers[:, :1, None] * a + _cross(dw, h) + _cross(w, _cross(w, h))
        moment = I @ dw + _cross(w, I @ w) + _cross(h, a)
        F, M = (np.einsum("jabs,jbs->jas", self.R, v) for v in (force, moment))
        outboard_F, outboard_M = (np.cumsum(v[::-1], axis=0)[::-1] for v in (F, M + _cross(self.origin, F)))
        return np.sum(self.R[:, :, 2] * (outboard_M - _cross(self.origin, outboard_F)), 1)


def _cross(a: Array, b: Array) -> Array:
    """Of vectors `(..., 3, sample)`; `np.cross` takes ten times as long."""
    ax, ay, az = (a[..., i, :] for i in range(3))
    bx, by, bz = (b[..., i, :] for i in range(3))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -2)


@final
@dataclass(frozen=True, eq=False)
class Motors:
    """The motors of an arm.

    Attributes:
        links: `(joint, 4, 4)` of the calibrated chain, before each joint's rotation.
        numbers: `(joint, 10)`, from `inertial_numbers`.
        effects: what adds to the torques of the rigid arm.
        noise: `(joint,)` Nm, one sigma of each reading of a torque.
    """

    links: Array
    numbers: Array
    effects: Sequence[Hidden]
    noise: Array

    @property
    def offsets(self) -> Array:
        """`(joint,)` s by which torques belong to a later motion than they are stamped with."""
        late = ((effect, values) for effect, values in self.effects if isinstance(effect, Delaying))
        return sum((effect.offset(values[0], len(self.noise)) for effect, values in late), np.zeros(len(self.noise)))

    def torque(self, motion: Motion, payload_center: Array) -> Array:
        """`(sample, joint)` Nm that the motors exert about +z of the joints, without noise.

        Args:
            motion: of the joints, with velocities and accelerations, in NumPy arrays; its payload is constant.
            payload_center: `(3,)` m in the frame after the last joint.
        """
        q, dq, ddq = (
            np.asarray(part) for part in (motion.joint_position, motion.joint_velocity, motion.joint_acceleration)
        )
        moving = _Moving.of(self.links, q, dq, ddq, _GRAVITY)
        loaded = self.numbers.copy()
        loaded[-1] += point_mass(float(np.asarray(motion.payload)[0]), payload_center)
        total = moving.torque(loaded)
        if self.effects:
            still = np.zeros_like(q)
            dynamics = Dynamics(
                motion=motion,
                torque=total,
                links=self.numbers,
                payload_center=payload_center,
                of_inertia=moving.torque,
                of_gravity=lambda gravity: _Moving.of(self.links, q, still, still, gravity).torque(loaded),
                gravity=_GRAVITY,
            )
            plain = [(effect, values) for effect, values in self.effects if not isinstance(effect, Scaling)]
            total = total + sum(effect.torque(values, dynamics) for effect, values in plain)
            for effect, values in self.effects:
                if isinstance(effect, Scaling):
                    total = total + effect.torque(values, dynamics._replace(torque=total))
        return total.T

    def noise_at(self, time: Array) -> Array:
        """`(sample, joint)` Nm at `(sample,)` s: the same at an instant, whoever reads it and how often."""
        if not self.noise.any():
            return np.zeros((len(time), len(self.noise)))
        instant = np.round(time * 1e6).astype(np.int64).astype(np.uint64)
        joint = np.arange(len(self.noise), dtype=np.uint64)
        key = (instant[:, None] * np.uint64(len(joint)) + joint) * np.uint64(2)
        radius, angle = (_uniform(key + np.uint64(k)) for k in range(2))
        # G. Box and M. Muller, Annals of Mathematical Statistics 29, 1958
        return self.noise * np.sqrt(-2 * np.log(radius)) * np.cos(2 * np.pi * angle)


def _uniform(key: NDArray[np.uint64]) -> Array:
    """From 0 (exclusive) to 1, by a hash: the finaliser of G. Steele et al., OOPSLA 2014 (SplitMix64)."""
    z = key * np.uint64(0x9E3779B97F4A7C15)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        z = (z ^ (z >> np.uint64(shift))) * np.uint64(factor)
    return ((z ^ (z >> np.uint64(31))) >> np.uint64(11)).astype(float) * 2.0**-53 + 2.0**-54
