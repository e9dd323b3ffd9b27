"""Effects that add to the torques that motors exert: friction, what motors carry, motors and their sensors.

Everything is on the host: each column is evaluated once per recording, and nearly all effects are linear. The limits of
numbers are those of the heaviest arms, of bodies those of the arm at hand. Beyond them a name is implausible: a centre
of mass outside its link is evidence for something else.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, final

import numpy as np

from lite6jax.arms.arm import Arm, as_revolute
from lite6jax.array_types import Array, Mask
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.effect import (
    Coordinate,
    Effect,
    OfJoint,
    SimulatorParameters,
    Wave,
    final_effect,
    positive,
    symmetric,
)
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import Process
from lite6jax.effects.statics import Loads
from lite6jax.errors import InputError

DIRECTION_SPEED = 0.002
"""rad/s, the speed v over which the direction of motion changes its sign, as tanh(q̇ / v); of a prismatic joint it is
0.2 mm/s (`arms.arm`)."""
_STEADY = 1e-4
"""Of a change of velocity over v, below which the direction of motion is that at the middle."""

# ------------------------------------------------------------------ what effects act on


class Dynamics(NamedTuple):
    """An arm's motion and the rigid-body torques in it, on the host. Of prismatic joints torques are forces in N.

    Attributes:
        motion: with velocities and accelerations; NumPy arrays.
        torque: `(joint, sample)` Nm that motors exert about +z of the joints on the rigid arm with its payload.
        links: `(joint, 10)` inertial numbers of each link, its payload left out: m, m·c, and the tensor about the
            frame's origin (xx yy zz xy xz yz).
        payload_center: `(3,)` m, of the payload, in the frame after the last joint.
        of_inertia: torques `(joint, sample)` by inertial numbers `(joint, 10)` in this motion.
        of_gravity: torques `(joint, sample)` of this arm by a gravity `(3,)` m/s² in the base frame, at rest.
        gravity: `(3,)` m/s², as declared.
        drives: `(joint, sample)` Nm that motors exert beside `torque` for the friction, rotors and springs that the
            arm's description declares; 0 where it declares none.
        period: s from one sample to the next where each stands for all that were recorded in this time: directions of
            motion are means over it. 0 where each stands for an instant.
    """

    motion: Motion
    torque: Array
    links: Array
    payload_center: Array
    of_inertia: Callable[[Array], Array]
    of_gravity: Callable[[Array], Array]
    gravity: Array
    drives: Array | float = 0.0
    period: float = 0.0

    @property
    def declared(self) -> Array:
        """`(joint, sample)` Nm that motors exert on the arm as its description declares it."""
        return self.torque + self.drives

    @property
    def loads(self) -> Loads:
        """The loads in which drivers find what acts on each joint: the opposite of what motors exert."""
        moment = np.zeros((len(self.torque), 3, self.torque.shape[1]))
        moment[:, 2] = -self.torque
        return Loads(moment, np.zeros((3, self.torque.shape[1])))  # type: ignore[arg-type]

    def direction(self, joint: int, transition: float = 0.0) -> Array:
        """`(sample,)`, from -1 to 1, of a joint counted from 1; `transition` as of the function `direction`."""
        slides = joint - 1 in self.motion.sliding.joints
        return direction(self.velocity(joint), slides, transition, self.change(joint))

    def position(self, joint: int) -> Array:
        """`(sample,)` rad, or m, of a joint counted from 1."""
        return np.asarray(self.motion.joint_position)[joint - 1]

    def velocity(self, joint: int) -> Array:
        """`(sample,)` rad/s, or m/s, of a joint counted from 1."""
        assert self.motion.joint_velocity is not None
        return np.asarray(self.motion.joint_velocity)[joint - 1]

    def change(self, joint: int) -> Array | float:
        """`(sample,)` rad/s, or m/s, by which the velocity of a joint changes within the time of a sample."""
        if self.period:
            return self.period * np.asarray(self.motion.joint_acceleration)[joint - 1]
        return 0.0


def direction(
    velocity: Array,
    slides: bool | Mask = False,
    transition: float = 0.0,
    change: Array | float = 0.0,
) -> Array:
    """The direction of motion, -1 to 1, tanh(q̇ / v): encoders have no exact zero.

    Where the velocity changes by Δ within the time of a sample, it is the mean over this time,
    v/Δ·(log cosh((q̇ + Δ/2)/v) - log cosh((q̇ - Δ/2)/v)).

    Args:
        velocity: `(sample,)` or `(joint, sample)` rad/s, m/s of prismatic joints.
        slides: whether the joint is prismatic, or `(joint,)`, which joints are.
        transition: v in the unit of the velocity; `DIRECTION_SPEED` if 0.
        change: Δ in the unit of the velocity, of its shape.
    """

    def scaled(speed: Array) -> Array:
        if transition:
            return speed / transition
        return as_revolute(speed, "rad/s", slides) / DIRECTION_SPEED

    x = scaled(velocity)
    if not np.any(change):
        return np.tanh(x)
    half = 0.5 * scaled(np.asarray(change, float))
    divisor = np.where(np.abs(half) < _STEADY, 1.0, half)
    return np.where(divisor == half, (_log_cosh(x + divisor) - _log_cosh(x - divisor)) / (2 * divisor), np.tanh(x))


def _log_cosh(x: Array) -> Array:
    """But for a constant; it does not overflow."""
    return np.abs(x) + np.log1p(np.exp(-2 * np.abs(x)))


def point_mass(mass: float, center: Array) -> Array:
    """`(10,)` inertial numbers of a point mass in kg at a place in m."""
    x, y, z = center
    tensor = [y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z]
    return mass * np.array([1.0, x, y, z, *tensor])


class TorqueEffect(Effect, ABC):
    """An effect on the torques that motors exert."""

    domain: ClassVar[str] = "dynamic"

    @abstractmethod
    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        """`(joint, sample)` Nm, N of prismatic joints, that add to the rigid arm's, by `values` `(coordinate,)`."""

    shown_over_driver: ClassVar[bool] = False
    """Whether it is a curve over its drivers, at one joint."""

    @property
    def process(self) -> Hashable:
        """The same for all that have these unit torques."""
        return self

    @property
    def acts_on(self) -> slice:
        """The joints, of all, that it acts on: most effects act on one."""
        return slice(None)

    def unit_torques(self, dynamics: Dynamics) -> Array:
        """Torques `(number, joint, sample)` by each number of a linear effect, of the joints that it acts on."""
        return np.stack([self.torque(unit, dynamics) for unit in np.eye(self.size)])

    def is_friction_of(self, joint: int) -> bool:
        """Tells whether it is friction of a joint, counted from 1: figures show it over the velocity of this joint."""
        return False


@dataclass(frozen=True)
class JointTorque(OfJoint, TorqueEffect, ABC):
    """An effect on the torque of one joint, or on the force of a prismatic one."""

    shown_over_driver: ClassVar[bool] = True

    @abstractmethod
    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        """`(sample,)` Nm, or N, that add to this joint's torque."""

    @property
    def acts_on(self) -> slice:
        return slice(self.joint - 1, self.joint)

    def unit_torques(self, dynamics: Dynamics) -> Array:
        return np.stack([self.at_joint(unit, dynamics) for unit in np.eye(self.size)])[:, None]

    @final
    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        """The torque at its joint, zero at the others."""
        total = np.zeros_like(dynamics.torque)
        total[self.joint - 1] = self.at_joint(np.asarray(values, float), dynamics)
        return total


@dataclass(frozen=True)
class Friction(JointTorque, ABC):
    """Friction of one joint.

    What follows its own motion alone is exported as viscous and Coulomb friction, as far as these fit it.
    """

    @final
    def is_friction_of(self, joint: int) -> bool:
        return self.joint == joint


@dataclass(frozen=True)
class Scaling(JointTorque, ABC):
    """An effect that multiplies the torque of its joint, whatever causes that torque.

    `at_joint` takes the whole torque from `dynamics.torque`.
    """

    shown_over_driver: ClassVar[bool] = False


@dataclass(frozen=True)
class Delaying(TorqueEffect, ABC):
    """An effect by which torques belong to another time than their rows; its only coordinate is a time in s."""

    quantities: ClassVar[tuple[str, ...]] = ("time",)

    @abstractmethod
    def offset(self, value: float, joints: int) -> Array:
        """`(joint,)` s by which each joint's torques belong to a later motion, proportional to the coordinate."""

    @final
    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        """Nothing: a domain shifts what was measured."""
        return np.zeros_like(dynamics.torque)


# ------------------------------------------------------------------ friction

_TORQUE = 2000.0
"""Nm, of friction, offsets and ripple."""
_INERTIA = 500.0
"""kg·m², of rotors and links."""
_VISCOUS = positive("viscous_Nm_s_per_rad", "Nm·s/rad", 0.1, 3000.0)
_COULOMB = positive("coulomb_Nm", "Nm", 0.1, _TORQUE)
STRIBECK = (1e-3, 2.0)
"""rad/s, the speed over which Stribeck friction vanishes."""
TRANSITION = (0.02, 1.0)
"""rad/s, the speed within which Coulomb friction turns: less is sharp in most logs, more is nearly viscous."""
SHARP = 0.0
"""A transition of Coulomb friction that is as sharp as encoders show."""
EXPONENT = (0.3, 2.5)
"""Of viscous friction over the speed: less is hardly to be told from Coulomb friction, more is no bearing's."""
LINEAR = 1.0
"""The exponent of viscous friction in proportion to the speed."""


@final_effect
class ViscousFriction(Friction):
    """τ += b·q̇·|q̇|ⁿ⁻¹, with q̇ in rad/s or m/s, so that b is the friction over the velocity at 1 rad/s or 1 m/s.

    It is not linear in n: the search tries some values beside 1, and n without a fixed value is its second coordinate
    (n = 1: P. Hamon et al., IROS 2010, eq. 6; n of harmonic drives: H. D. Taghirad and P. R. Bélanger, J. Dyn. Sys.,
    Meas., Control 120, 1998).

    Attributes:
        exponent: n, where it is fixed.
    """

    exponent: float | None = LINEAR

    name: ClassVar[str] = "viscous_friction"
    specificity: ClassVar[int] = 1
    common: ClassVar[bool] = True
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        mujoco="damping",
        isaac_lab="viscous_friction",
        urdf="dynamics damping",
    )
    fixed: ClassVar[str | None] = "exponent"
    plain: ClassVar[float | None] = LINEAR
    searched: ClassVar[bool] = True
    quantities: ClassVar[tuple[str, ...]] = ("velocity",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (
        _VISCOUS,
        Coordinate("exponent", "1", 0.1, lower=EXPONENT[0], upper=EXPONENT[1], linear=False),
    )

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        n = max(values[1], 1e-9) if self.exponent is None else self.exponent
        speed = dynamics.velocity(self.joint)
        return values[0] * np.sign(speed) * np.abs(speed) ** n


@final_effect
class CoulombFriction(Friction):
    """τ += c·tanh(q̇/v): c·sign(q̇) but near standstill, where friction of gears and belts turns within a speed v.

    It is not linear in v: the search tries some values of v, and v without a fixed value is its second coordinate.

    Attributes:
        transition_rad_per_s: v, where it is fixed; `SHARP` for a few mrad/s; in m/s of a prismatic joint, in whose
            files it is `transition_m_per_s`.
    """

    transition_rad_per_s: float | None = SHARP

    name: ClassVar[str] = "coulomb_friction"
    specificity: ClassVar[int] = 1
    common: ClassVar[bool] = True
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        mujoco="frictionloss",
        isaac_lab="friction",
        urdf="dynamics friction",
    )
    fixed: ClassVar[str | None] = "transition_rad_per_s"
    plain: ClassVar[float | None] = SHARP
    searched: ClassVar[bool] = True
    quantities: ClassVar[tuple[str, ...]] = ("direction of motion",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (
        _COULOMB,
        Coordinate("transition_rad_per_s", "rad/s", 0.1, lower=TRANSITION[0], upper=TRANSITION[1], linear=False),
    )

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        v = max(values[1], 1e-9) if self.transition_rad_per_s is None else self.transition_rad_per_s
        return values[0] * dynamics.direction(self.joint, v)


@final_effect
class StribeckFriction(Friction):
    """τ += s·exp(−(q̇/v)²)·sign(q̇), beside Coulomb friction.

    It is not linear in v: the search tries some values of v, and v without a fixed value is its second coordinate
    (B. Armstrong-Hélouvry, Control of Machines with Friction, 1991, ch. 2).

    Attributes:
        velocity_rad_per_s: v, where it is fixed; in m/s of a prismatic joint, in whose files it is `velocity_m_per_s`.
    """

    velocity_rad_per_s: float | None = None

    name: ClassVar[str] = "stribeck_friction"
    specificity: ClassVar[int] = 4
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(isaac_lab="friction above dynamic_friction")
    fixed: ClassVar[str | None] = "velocity_rad_per_s"
    searched: ClassVar[bool] = True
    quantities: ClassVar[tuple[str, ...]] = ("velocity", "direction of motion")
    numbers: ClassVar[tuple[Coordinate, ...]] = (
        positive("stribeck_Nm", "Nm", 0.1, _TORQUE),
        Coordinate("velocity_rad_per_s", "rad/s", 0.01, lower=STRIBECK[0], upper=STRIBECK[1], linear=False),
    )

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        v = max(values[1], 1e-9) if self.velocity_rad_per_s is None else self.velocity_rad_per_s
        speed = dynamics.velocity(self.joint)
        return values[0] * np.exp(-((speed / v) ** 2)) * dynamics.direction(self.joint)


@final_effect
class LoadFriction(Friction):
    """τ += μ·|τ_rigid|·sign(q̇): friction of a gear in proportion to its load."""

    name: ClassVar[str] = "load_friction"
    specificity: ClassVar[int] = 2
    quantities: ClassVar[tuple[str, ...]] = ("gravity torque", "direction of motion")
    numbers: ClassVar[tuple[Coordinate, ...]] = (positive("coefficient", "1", 0.01, 1.0),)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return values[0] * np.abs(dynamics.torque[self.joint - 1]) * dynamics.direction(self.joint)


@final_effect
class FrictionTemperature(Friction):
    """τ += k·(T − T₀)·q̇, T the temperature of this joint; k is negative where grease becomes thinner."""

    name: ClassVar[str] = "friction_temperature"
    specificity: ClassVar[int] = 3
    quantities: ClassVar[tuple[str, ...]] = ("temperature", "velocity")
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("viscous_Nm_s_per_rad_K", "Nm·s/rad/K", 0.01, 100.0),)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        rise = np.asarray(self.drivers[0].values(dynamics.motion, None))
        return values[0] * rise * dynamics.velocity(self.joint)


@final_effect
class CoupledFriction(OfJoint, TorqueEffect):
    """τ += b·(q̇_N + q̇_M) + c·sign(q̇_N + q̇_M) on both joints: a motor of the wrist that drives both.

    Joint N is the outer one. Both are revolute, or both prismatic, as those of a gantry whose belt passes over both.

    Attributes:
        source_joint: M.
    """

    source_joint: int

    name: ClassVar[str] = "coupled_friction"
    specificity: ClassVar[int] = 3
    fixed: ClassVar[str | None] = "source_joint"
    numbers: ClassVar[tuple[Coordinate, ...]] = (_VISCOUS, _COULOMB)

    def __post_init__(self) -> None:
        if self.source_joint >= self.joint:
            raise InputError(
                f"{self.label}: source_joint {self.source_joint} is not before joint {self.joint}; name the outer "
                "joint as joint"
            )

    @property
    def joints(self) -> tuple[int, ...]:
        return (self.joint, self.source_joint)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (self.own_driver("velocity"), joint_driver("velocity", self.source_joint, self.of_slide))

    def is_friction_of(self, joint: int) -> bool:
        return joint in (self.joint, self.source_joint)

    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        speed = dynamics.velocity(self.joint) + dynamics.velocity(self.source_joint)
        change = dynamics.change(self.joint) + dynamics.change(self.source_joint)
        total = np.zeros_like(dynamics.torque)
        friction = values[0] * speed + values[1] * direction(speed, self.of_slide, change=change)
        total[[self.joint - 1, self.source_joint - 1]] = friction
        return total


# ------------------------------------------------------------------ motors, gears and their sensors


@final_effect
class TorqueOffset(JointTorque):
    """τ += o: the zero offset of a torque sensor or of a current."""

    name: ClassVar[str] = "torque_offset"
    specificity: ClassVar[int] = 0
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("offset_Nm", "Nm", 0.1, _TORQUE),)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return np.full(dynamics.motion.samples, values[0])


@final_effect
class TorqueScale(Scaling):
    """The measured torque is 1 + s times the true one, friction included: a wrong torque constant or gear ratio."""

    name: ClassVar[str] = "torque_scale"
    specificity: ClassVar[int] = 2
    quantities: ClassVar[tuple[str, ...]] = ("gravity torque",)
    # a reversed sign is a data fault
    numbers: ClassVar[tuple[Coordinate, ...]] = (Coordinate("scale", "1", 0.01, lower=-0.9, upper=9.0),)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return values[0] * dynamics.torque[self.joint - 1]


@final_effect
class RotorInertia(JointTorque):
    """τ += I·q̈, of the rotor, reflected to the joint; of a prismatic joint I is a mass."""

    name: ClassVar[str] = "rotor_inertia"
    specificity: ClassVar[int] = 1
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(mujoco="armature", isaac_lab="armature")
    quantities: ClassVar[tuple[str, ...]] = ("acceleration",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (positive("inertia_kg_m2", "kg·m²", 0.01, _INERTIA),)

    @property
    def rivals(self) -> tuple[Effect, ...]:
        """The inertia of its link about the same axis, which where the base bears the joint is the same."""
        return () if self.of_slide else (LinkInertia(self.joint),)

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        assert dynamics.motion.joint_acceleration is not None
        return values[0] * np.asarray(dynamics.motion.joint_acceleration)[self.joint - 1]


@final_effect
class JointSpring(JointTorque):
    """τ += k·(q − q₀): a cable, a hose, a balancer.

    Its coordinates are k and −k·q₀, in which it is linear.
    """

    name: ClassVar[str] = "joint_spring"
    specificity: ClassVar[int] = 3
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(mujoco="stiffness, springref")
    quantities: ClassVar[tuple[str, ...]] = ("position",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (
        positive("stiffness_Nm_per_rad", "Nm/rad", 0.1, 1e4),
        symmetric("torque_at_zero_Nm", "Nm", 0.1, _TORQUE),
    )

    @property
    def includes(self) -> tuple[Effect, ...]:
        """The spring without stiffness."""
        return (TorqueOffset(self.joint, of_slide=self.of_slide),)

    @property
    def parameters(self) -> tuple[str, ...]:
        return self.own("stiffness_Nm_per_rad"), self.own("rest_rad")

    def to_parameters(self, values: Array) -> tuple[Array, Array]:
        k, m = values
        rest_position = -m / k if k else 0.0
        return np.array([k, rest_position]), np.array([[1.0, 0.0], [-rest_position / k, -1.0 / k] if k else [0.0, 0.0]])

    def from_parameters(self, given: Mapping[str, float]) -> Array:
        k, rest_position = (given.get(name, 0.0) for name in self.parameters)
        return np.array([k, -k * rest_position])

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return values[0] * dynamics.position(self.joint) + values[1]


@final_effect
class TorqueRipple(Wave, JointTorque):
    """τ += A·sin(n·q + φ): cogging, gear mesh; of a prismatic joint F += A·sin(2π·q/p + φ): a screw's lead p.

    Its coordinates are A cos φ and A sin φ, and n where it is not fixed.

    Attributes:
        order: n ≥ 1, where it is fixed, not necessarily an integer; of a prismatic joint 1/p, cycles per metre.
    """

    order: float | None = None

    name: ClassVar[str] = "torque_ripple"
    specificity: ClassVar[int] = 5
    quantities: ClassVar[tuple[str, ...]] = ("position",)
    amplitude: ClassVar[Coordinate] = symmetric("_Nm", "Nm", 0.1, _TORQUE)

    @property
    def period_m(self) -> float | None:  # as the parameter is called in files
        """The length after which the force of a prismatic joint repeats; None where no order is fixed, or in turns."""
        return 1 / self.order if self.of_slide and self.order else None

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return np.asarray(self.of_position(values, dynamics.position(self.joint)))  # type: ignore[arg-type]


@final_effect
class TorqueTimeOffset(Delaying):
    """The torque stamped t belongs to the motion at t + offset."""

    name: ClassVar[str] = "time_offset"
    specificity: ClassVar[int] = 1
    at: ClassVar[str] = "clock"
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("offset_s", "s", 1e-3, 0.5, linear=False),)

    def offset(self, value: float, joints: int) -> Array:
        return np.full(joints, value)


@final_effect
class TorqueLag(OfJoint, Delaying):
    """The torque of one joint stamped t belongs to the motion at t − lag: its drive filters or sends it."""

    name: ClassVar[str] = "torque_lag"
    specificity: ClassVar[int] = 4
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("lag_s", "s", 1e-3, 0.5, linear=False),)

    @property
    def acts_on(self) -> slice:
        return slice(self.joint - 1, self.joint)

    def offset(self, value: float, joints: int) -> Array:
        return np.where(np.arange(joints) == self.joint - 1, -value, 0.0)


# ------------------------------------------------------------------ what motors carry

_MASS = 500.0
"""kg, where the arm has no masses."""
_LENGTH = 2.0
"""m, by which a centre of mass may be displaced, where the arm has no masses."""
PAYLOAD_LENGTH = 0.5
"""m, of a payload's centre of mass from where it is declared."""
TILT = 0.5
"""rad, by which a base may be tilted from what is declared."""
_GROWTH = 3.0
_MOUNTED = 0.5
"""Times its own mass, or of the arm's, that what is mounted on a link weighs at most."""
_AROUND = 0.15
"""Of the arm's reach, by which a link extends beyond the line between its joints."""
_ABOUT_AXIS = 6
"""Of the inertial numbers of a link, that of the moment of inertia about the axis of its joint."""
_MASSLESS = 0.01
"""kg below which a payload has moments alone: without a mass its distance is anything, and its square nothing."""


def heaviest(arm: Arm, link: int) -> float:
    """kg that are mounted on a link, counted from 1, at most: less than the arm weighs."""
    if arm.mass is None:
        return _MASS
    total = float(np.sum(arm.mass))
    return min(max(_GROWTH * float(arm.mass[link - 1]), _MOUNTED * total), total)


def turning_inertia(arm: Arm, link: int, links: Array) -> tuple[float, float]:
    """kg·m² by which a link, counted from 1, may turn the harder or easier about its joint's axis.

    It has no less than none, and no more than its heaviest mass at half the arm's reach. The inertial numbers of the
    `links` are `(joint, 10)`.
    """
    largest = _INERTIA if arm.mass is None else heaviest(arm, link) * (0.5 * arm.reach) ** 2
    return -float(links[link - 1, _ABOUT_AXIS]), largest


def heaviest_payload(arm: Arm) -> float:
    """kg that hang on the flange at most: no arm carries more than it weighs."""
    return _MASS if arm.mass is None else float(np.sum(arm.mass))


def displacement(arm: Arm, link: int) -> Array:
    """`(3, 2)` m by which the centre of mass of a link, counted from 1, may be displaced and still be in the link.

    The link goes from its joint to the next one, or the flange, and some way around these and its declared centre.
    """
    if arm.center_of_mass is None:
        return np.tile([-_LENGTH, _LENGTH], (3, 1))
    end = arm.kinematics[link, :3] if link < arm.dof else arm.T_joint_flange[:3, 3]
    center = arm.center_of_mass[link - 1]
    inside = np.stack([np.zeros(3), end, center])
    extent = max(arm.reach, float(np.linalg.norm(inside, axis=1).max()))
    if not extent:
        extent = _LENGTH
    around = _AROUND * extent
    return np.stack([inside.min(0) - around - center, inside.max(0) + around - center], 1)


def inertial_limits(effect: Effect, arm: Arm, links: Array, lightest: float) -> list[tuple[float, float]] | None:
    """The least and the most that each number of an effect on bodies can be; None of any other effect.

    No payload or link is lighter than nothing or heavier than the arm, and a centre of mass is within its link.

    Args:
        effect: of a payload or of a link.
        arm: that has it.
        links: `(joint, 10)` inertial numbers, of the payload none.
        lightest: kg, the least payload of the motion.
    """
    if isinstance(effect, PayloadTorque | PayloadBody):
        heaviest_added = heaviest_payload(arm)
        moment = heaviest_added * PAYLOAD_LENGTH
        return [(-lightest, heaviest_added), *[(-moment, moment)] * (effect.size - 1)]
    if isinstance(effect, LinkMass):
        return [(-float(links[effect.link - 1, 0]), heaviest(arm, effect.link))]
    if isinstance(effect, LinkCom):
        return [(float(low), float(high)) for low, high in displacement(arm, effect.link)]
    if isinstance(effect, LinkInertia):
        return [turning_inertia(arm, effect.link, links)]
    return None


def first_moment(moment: Array, center: Array) -> Array:
    """`(10,)`, the change of inertial numbers by a first moment `(3,)` kg·m about a centre, to first order."""
    tensor = 2 * (moment @ center) * np.eye(3) - np.outer(moment, center) - np.outer(center, moment)
    return np.array([0.0, *moment, *np.diagonal(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]])


@dataclass(frozen=True)
class OfLink(TorqueEffect, ABC):
    """An effect on the inertia of one link.

    Attributes:
        link: that moves with joint N, counted from 1.
    """

    link: int

    at: ClassVar[str] = "link"
    quantities: ClassVar[tuple[str, ...]] = ("acceleration",)
    """Of its own joint, on which its torque depends in every position."""

    @abstractmethod
    def inertial(self, values: Array, links: Array) -> Array:
        """`(10,)`, the change of the inertial numbers of its link, beside `links` `(joint, 10)` as they are."""

    @final
    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        """Torques `(joint, sample)` by the change of its link."""
        change = np.zeros_like(dynamics.links)
        change[self.link - 1] = self.inertial(values, dynamics.links)
        return dynamics.of_inertia(change)


@final_effect
class LinkMass(OfLink):
    """A link's mass differs from the declared one; its centre of mass does not."""

    name: ClassVar[str] = "link_mass"
    specificity: ClassVar[int] = 3
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        mujoco="mass of inertial",
        isaac_lab="mass of the body",
        urdf="mass of inertial",
    )
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("mass_kg", "kg", 0.1, _MASS),)

    def inertial(self, values: Array, links: Array) -> Array:
        link_numbers = links[self.link - 1]
        return point_mass(float(values[0]), link_numbers[1:4] / link_numbers[0] if link_numbers[0] > 0 else np.zeros(3))


@final_effect
class LinkCom(OfLink):
    """A link's centre of mass is displaced, in the axes of its frame; its mass is as declared."""

    name: ClassVar[str] = "link_com"
    specificity: ClassVar[int] = 4
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        mujoco="pos of inertial",
        isaac_lab="centre of mass of the body",
        urdf="origin of inertial",
    )
    numbers: ClassVar[tuple[Coordinate, ...]] = tuple(symmetric(f"{axis}_m", "m", 1e-2, _LENGTH) for axis in "xyz")

    def inertial(self, values: Array, links: Array) -> Array:
        m, *first = links[self.link - 1, :4]
        center = np.array(first) / m if m > 0 else np.zeros(3)
        # to first order: the square of the shift is a thousandth of the inertia
        return first_moment(m * np.asarray(values, float), center)


@final_effect
class LinkInertia(OfLink):
    """A link's moment of inertia about its joint's axis, which is revolute, differs from the declared one.

    A rotor of the joint adds to the torque of that joint alone; a link turns with all joints before it too.
    """

    name: ClassVar[str] = "link_inertia"
    specificity: ClassVar[int] = 3
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        mujoco="fullinertia",
        isaac_lab="inertia of the body",
        urdf="inertia of inertial",
    )
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("inertia_kg_m2", "kg·m²", 0.01, _INERTIA),)

    @property
    def rivals(self) -> tuple[Effect, ...]:
        """The rotor of its joint."""
        return (RotorInertia(self.link),)

    def inertial(self, values: Array, links: Array) -> Array:
        change = np.zeros(10)
        change[_ABOUT_AXIS] = values[0]
        return change


@final_effect
class PayloadTorque(TorqueEffect):
    """The mass at the flange differs from the declared one, at the declared centre of mass."""

    name: ClassVar[str] = "payload_error"
    specificity: ClassVar[int] = 2
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        mujoco="mass of the last body",
        isaac_lab="mass of the last body",
        urdf="mass of the last link",
    )
    at: ClassVar[str] = "payload"
    quantities: ClassVar[tuple[str, ...]] = ("acceleration of joint 1",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("mass_kg", "kg", 0.1, _MASS),)

    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        change = np.zeros_like(dynamics.links)
        change[-1] = point_mass(float(values[0]), dynamics.payload_center)
        return dynamics.of_inertia(change)


@final_effect
class PayloadBody(TorqueEffect):
    """Another body at the flange: a mass, and its centre, in m from the declared payload's, in the last link's axes.

    Its coordinates are the mass and its first moments about the declared centre, which have a meaning without a mass.
    """

    name: ClassVar[str] = "payload"
    specificity: ClassVar[int] = 3
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        mujoco="a body at the flange",
        isaac_lab="a body at the flange",
        urdf="a link at the flange",
    )
    at: ClassVar[str] = "payload"
    quantities: ClassVar[tuple[str, ...]] = ("acceleration of joint 1",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (
        symmetric("mass_kg", "kg", 0.1, _MASS, linear=False),
        *(symmetric(f"moment_{a}_kg_m", "kg m", 1e-2, _MASS * PAYLOAD_LENGTH, linear=False) for a in "xyz"),
    )

    @property
    def parameters(self) -> tuple[str, ...]:
        return "mass_kg", "x_m", "y_m", "z_m"

    @property
    def includes(self) -> tuple[Effect, ...]:
        """The mass at the declared centre."""
        return (PayloadTorque(),)

    def to_parameters(self, values: Array) -> tuple[Array, Array]:
        mass = float(values[0])
        moments = np.asarray(values[1:], float)
        over = 1 / mass if mass else 1e300  # without a mass its place is anything: a huge derivative is no knowledge
        jacobian = np.eye(4)
        jacobian[1:, 1:] *= over
        center = moments * over if mass else np.zeros(3)
        jacobian[1:, 0] = -center * over
        return np.r_[mass, center], jacobian

    def from_parameters(self, given: Mapping[str, float]) -> Array:
        mass, *center = (given.get(name, 0.0) for name in self.parameters)
        return np.array([mass, *(mass * place for place in center)])

    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        mass = float(values[0])
        moment = np.asarray(values[1:], float)
        center = dynamics.payload_center
        change = np.zeros_like(dynamics.links)
        change[-1] = point_mass(mass, center) + first_moment(moment, center)
        change[-1, 4:] += point_mass(mass / (mass**2 + _MASSLESS**2), moment)[4:]  # of its distance from that centre
        return dynamics.of_inertia(change)


@final_effect
class BaseTilt(TorqueEffect):
    """The base is tilted from what is declared, by small rotations about x and y: g ← R(tilt)ᵀ g."""

    name: ClassVar[str] = "base_tilt"
    specificity: ClassVar[int] = 3
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        mujoco="gravity",
        isaac_lab="gravity of the scene",
        urdf="origin of the joint from world to base",
    )
    at: ClassVar[str] = "base"
    numbers: ClassVar[tuple[Coordinate, ...]] = tuple(symmetric(f"tilt_{a}_rad", "rad", 1e-2, TILT) for a in "xy")

    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        tilt = np.array([values[0], values[1], 0.0])
        return dynamics.of_gravity(-np.cross(tilt, dynamics.gravity))  # R(tilt)ᵀ g − g, to first order


# ------------------------------------------------------------------ a process, and what the arm declares


@dataclass(frozen=True)
class JointProcess(Process, OfJoint, ABC):
    """A Gaussian process of one driver or of two that adds to a joint along a motion.

    Attributes:
        driver, lower, upper, kernel, further, spread, rolloff: as of `Process`.
    """

    driver: str
    lower: float
    upper: float
    kernel: str = "smooth"
    further: tuple[float, ...] = ()
    spread: float | None = None
    rolloff: tuple[float, ...] = ()

    @property
    def coefficient(self) -> Coordinate:
        """The coordinate of a torque."""
        coordinate = Coordinate("_Nm", "Nm", 0.1, np.inf if self.spread is None else self.spread)
        return coordinate.at_slide() if self.of_slide else coordinate

    def values_in(self, dynamics: Dynamics) -> Array:
        """The values of the drivers, `(driver, sample)`."""
        loads = None
        if any(driver.loaded for driver in self.drivers):
            loads = dynamics.loads
        return np.asarray(self.values_at(dynamics.motion, loads))

    def functions_of(self, dynamics: Dynamics) -> Array:
        """The functions that coefficients multiply, `(function, sample)`."""
        return np.asarray(self.functions_at(self.values_in(dynamics), dynamics.motion.run))  # type: ignore[arg-type]

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        """`(sample,)`, what adds at its joint."""
        return values @ self.functions_of(dynamics)


@final_effect
class UnnamedTorque(JointProcess, JointTorque):
    """τ += Σ coefficient · φ(drivers): a Gaussian process of one driver or of two.

    Friction that no name describes is a product with the direction of motion, such as "smooth*line" of "speed of
    joint 2 and direction of motion of joint 2".

    Attributes:
        driver, lower, upper, kernel, further, spread, rolloff: as of `Process`; spread in Nm, or N.

    Raises:
        InputError: no such driver or kernel, or an empty range.
    """

    component: ClassVar[str] = ""  # a joint has one torque

    def is_friction_of(self, joint: int) -> bool:
        return self.joint == joint and self.follows_own_motion

    def unit_torques(self, dynamics: Dynamics) -> Array:
        return self.functions_of(dynamics)[:, None]


LOOP_COMPONENTS = ("", "command", "read-out")
"""What a nonparametric effect in the loop of a servo adds to: the torque, the command or the read-out."""


@final_effect
class UnnamedInLoop(JointProcess):
    """Σ coefficient · φ(drivers), a Gaussian process, adds to torque, command or read-out of a joint.

    Attributes:
        driver, lower, upper, kernel, further, spread, rolloff: as of `Process`; spread in Nm, or in rad of a shift.
        component: empty for a torque, `command` or `read-out`.

    Raises:
        InputError: no such component, driver or kernel, or an empty range.
    """

    component: str = ""

    domain: ClassVar[str] = "tracking"

    def __post_init__(self) -> None:
        if self.component not in LOOP_COMPONENTS:
            accepted = "command, read-out, or none for a torque"
            raise InputError(f"{self.label}: component {self.component!r} is not possible; give {accepted}")
        super().__post_init__()

    @property
    def coefficient(self) -> Coordinate:
        if not self.component:
            return super().coefficient
        return Coordinate("_rad", "rad", 1e-3, np.inf if self.spread is None else self.spread)


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
    values = None if field is None else arm.drives.get(field)
    return 0.0 if values is None else float(values[effect.joint - 1])  # type: ignore[attr-defined]


def declared_torque(arm: Arm, motion: Motion, period: float = 0.0) -> Array:
    """`(joint, sample)` Nm, N of prismatic joints, that motors exert beside those of rigid bodies, by the description.

    Args:
        arm: with `viscous_friction`, `coulomb_friction`, `rotor_inertia` and springs, as far as they are declared.
        motion: with velocities and accelerations; NumPy arrays.
        period: s, the time of a sample, as of `Dynamics`.
    """
    q, dq, ddq = (
        np.asarray(part, float) for part in (motion.joint_position, motion.joint_velocity, motion.joint_acceleration)
    )
    rest_position = np.zeros(arm.dof) if arm.spring_rest is None else arm.spring_rest
    parts = [
        (arm.viscous_friction, dq),
        (arm.coulomb_friction, direction(dq, arm.slides, change=period * ddq)),
        (arm.rotor_inertia, ddq),
        (arm.spring_stiffness, q - rest_position[:, None]),
    ]
    return sum((number[:, None] * part for number, part in parts if number is not None), np.zeros_like(q))
