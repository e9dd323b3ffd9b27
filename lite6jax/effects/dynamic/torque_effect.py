"""What an effect on torques is: a function of an arm's motion and rigid-body torques that adds to what motors exert.

Everything is on the host: each column is evaluated once per recording, and nearly all effects are linear.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import as_revolute, joint_size
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.effect import Coordinate, Effect
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import Process, require_process
from lite6jax.effects.statics import Loads

Array = NDArray[np.floating]

DIRECTION_SPEED = 0.002
"""rad/s, the speed v over which the direction of motion changes its sign, as tanh(q̇ / v); of a prismatic joint it is
0.2 mm/s (`arms.arm`)."""

POINT_MASS = 10
"""Numbers of a link's inertia: m, m·c, and the tensor about the frame's origin (xx yy zz xy xz yz)."""


class Dynamics(NamedTuple):
    """An arm's motion and the rigid-body torques in it, on the host. Of prismatic joints torques are forces in N.

    Attributes:
        motion: with velocities and accelerations; NumPy arrays.
        torque: `(joint, sample)` Nm that motors exert about +z of the joints on the rigid arm with its payload.
        links: `(joint, 10)` inertial numbers of each link, its payload left out; see `POINT_MASS`.
        payload_center: `(3,)` m, of the payload, in the frame after the last joint.
        of_inertia: torques `(joint, sample)` by inertial numbers `(joint, 10)` in this motion.
        of_gravity: torques `(joint, sample)` of this arm by a gravity `(3,)` m/s² in the base frame, at rest.
        gravity: `(3,)` m/s², as declared.
        drives: `(joint, sample)` Nm that motors exert beside `torque` for the friction, rotors and springs that the
            arm's description declares; 0 where it declares none.
    """

    motion: Motion
    torque: Array
    links: Array
    payload_center: Array
    of_inertia: Callable[[Array], Array]
    of_gravity: Callable[[Array], Array]
    gravity: Array
    drives: Array | float = 0.0

    @property
    def declared(self) -> Array:
        """`(joint, sample)` Nm that motors exert on the arm as its description declares it."""
        return self.torque + self.drives

    @property
    def loads(self) -> Loads:
        """The moments about the joints' axes that links and payload exert, the opposite of the motors' torques."""
        return loads_of(self.torque)

    def direction(self, joint: int, transition: float = 0.0) -> Array:
        """`(sample,)`, from -1 to 1, of a joint counted from 1; `transition` as of the function `direction`."""
        return direction(self.velocity(joint), joint - 1 in self.motion.sliding.joints, transition)

    def velocity(self, joint: int) -> Array:
        """`(sample,)` rad/s, or m/s, of a joint counted from 1."""
        assert self.motion.joint_velocity is not None
        return np.asarray(self.motion.joint_velocity)[joint - 1]


def loads_of(torque: Array) -> Loads:
    """The loads in which drivers find what acts on each joint: the opposite of what motors exert, `(joint, sample)`."""
    moment = np.zeros((len(torque), 3, torque.shape[1]))
    moment[:, 2] = -torque
    return Loads(moment, np.zeros((3, torque.shape[1])))  # type: ignore[arg-type]


def direction(velocity: Array, slides: bool | NDArray[np.bool_] = False, transition: float = 0.0) -> Array:
    """The direction of motion, -1 to 1, tanh(q̇ / v): encoders have no exact zero.

    Args:
        velocity: `(sample,)` or `(joint, sample)` rad/s, m/s of prismatic joints.
        slides: whether the joint is prismatic, or `(joint,)`, which joints are.
        transition: v in the unit of the velocity; `DIRECTION_SPEED` if 0.
    """
    return np.tanh(velocity / transition if transition else as_revolute(velocity, "rad/s", slides) / DIRECTION_SPEED)


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


@dataclass(frozen=True)
class OfJoint(TorqueEffect, ABC):
    """An effect at a joint, in the units of that joint: those of a prismatic joint follow from a revolute one's.

    Attributes:
        joint: counted from 1.
        of_slide: whether the joint is prismatic; a model, or the arm of a command, says it.
    """

    joint: int
    of_slide: bool = field(default=False, kw_only=True)

    @property
    @final
    def site(self) -> str:
        """`jointN`."""
        return f"joint{self.joint}"

    @final
    def own_driver(self, quantity: str) -> Driver:
        """A quantity of this joint, such as `velocity`."""
        return joint_driver(quantity, self.joint, self.of_slide)

    @final
    def number(
        self,
        name: str,
        unit: str,
        typical: float,
        spread: float = np.inf,
        lower: float = -np.inf,
        upper: float = np.inf,
        linear: bool = True,
    ) -> Coordinate:
        """A `Coordinate` given as that of a revolute joint, with the name, the unit and the sizes of this joint.

        `spread` is a size that was measured here, and stays as it is.
        """
        typical, lower, upper = (joint_size(size, unit, self.of_slide) for size in (typical, lower, upper))
        return Coordinate(self.own(name), self.own(unit), typical, spread, lower, upper, linear)


@dataclass(frozen=True)
class JointTorque(OfJoint, ABC):
    """An effect on the torque of one joint, or on the force of a prismatic one."""

    @abstractmethod
    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        """`(sample,)` Nm, or N, that add to this joint's torque."""

    @final
    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        """The torque at its joint, zero at the others."""
        total = np.zeros_like(dynamics.torque)
        total[self.joint - 1] = self.at_joint(np.asarray(values, float), dynamics)
        return total


@dataclass(frozen=True)
class Scaling(JointTorque, ABC):
    """An effect that multiplies the torque of its joint, whatever causes that torque.

    `at_joint` takes the whole torque from `dynamics.torque`.
    """


@dataclass(frozen=True)
class Delaying(TorqueEffect, ABC):
    """An effect by which torques belong to another time than their rows; its only coordinate is a time in s."""

    @abstractmethod
    def offset(self, value: float, joints: int) -> Array:
        """`(joint,)` s by which each joint's torques belong to a later motion, proportional to the coordinate."""

    @final
    def torque(self, values: Array, dynamics: Dynamics) -> Array:
        """Nothing: a domain shifts what was measured."""
        return np.zeros_like(dynamics.torque)

    @property
    @final
    def drivers(self) -> tuple[Driver, ...]:
        """The time of each sample."""
        return (Driver("time"),)


@final
@dataclass(frozen=True)
class UnnamedTorque(Process, JointTorque):
    """τ += Σ coefficient · φ(drivers): a Gaussian process of one driver or of two.

    Friction that no name describes is a product with the direction of motion, such as "smooth*line" of "speed of
    joint 2 and direction of motion of joint 2".

    Attributes:
        driver, lower, upper, kernel, further, spread, rolloff: as of `Process`; spread in Nm, or N.

    Raises:
        InputError: no such driver or kernel, or an empty range.
    """

    driver: str
    lower: float
    upper: float
    kernel: str = "smooth"
    further: tuple[float, ...] = ()
    spread: float | None = None
    rolloff: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        require_process(self.label, self.driver, self.kernel, self.bounds, self.rolloff)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coefficients."""
        return self._coordinates

    @cached_property
    def _coordinates(self) -> tuple[Coordinate, ...]:
        deviation = np.inf if self.spread is None else self.spread
        return tuple(self.number(f"coefficient{k + 1}_Nm", "Nm", 0.1, deviation) for k in range(self.functions))

    @property
    def is_friction(self) -> bool:
        """Whether it depends on the motion of its own joint alone, as friction does."""
        own = [self.own_driver(quantity) for quantity in ("velocity", "speed", "direction of motion")]
        return set(self.drivers) <= set(own)

    def values_in(self, dynamics: Dynamics) -> Array:
        """The values of the drivers, `(driver, sample)`."""
        loads = dynamics.loads if any(driver.loaded for driver in self.drivers) else None
        return np.stack([np.asarray(driver.values(dynamics.motion, loads)) for driver in self.drivers])

    def functions_of(self, dynamics: Dynamics) -> Array:
        """The functions that coefficients multiply, `(function, sample)`."""
        return np.asarray(self.functions_at(self.values_in(dynamics), dynamics.motion.run))  # type: ignore[arg-type]

    def at_joint(self, values: Array, dynamics: Dynamics) -> Array:
        return values @ self.functions_of(dynamics)
