"""Effects on how servos follow their commands: of the servo, of its command, of its encoder, and of the clock.

An effect changes the numbers of a `Servo`. Friction and rotors of joints, payloads and everything else that exerts
torques are the effects of `lite6jax.effects.dynamic`.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, final

import numpy as np

from lite6jax.array_types import Array
from lite6jax.effects.effect import Coordinate, Effect, OfJoint, SimulatorParameters, final_effect, symmetric

UNLIMITED = 1e9
"""rad/s or Nm, a limit that is never reached."""
RIGID_GRIP = 1e9
"""kg·m², of friction that holds without creeping."""


@final
class Servo(NamedTuple):
    """The numbers of servos and joints, each `(…,)` of one shape; SI units, revolute joints.

    Attributes:
        stiffness: kp, Nm/rad.
        damping: kd, Nm·s/rad.
        integral: ki, Nm/(rad·s).
        feedforward: kf, Nm·s/rad.
        delay: d, s.
        clock_rate: r, 1.
        time_constant: of the low pass, s.
        rate_limit: of the filtered command, rad/s.
        dead_band: half its width, rad.
        torque_limit: Nm.
        torque_droop: share of the limit that is lost per rad/s in the direction of the torque, s/rad.
        viscous: b, Nm·s/rad.
        coulomb: c, Nm.
        stribeck: s, Nm.
        stribeck_speed: v, rad/s.
        load_friction: μ, 1.
        grip: G, kg·m².
        inertia: A, kg·m².
        spring: k, Nm/rad.
        spring_torque: Nm at q = 0.
        backlash: half its width, rad.
        offset: rad, of the read-out.
        scale: of the read-out, 1.
        sine, cosine: rad, of a wave of the read-out that repeats with a turn.
    """

    stiffness: Any
    damping: Any
    integral: Any
    feedforward: Any
    delay: Any
    clock_rate: Any
    time_constant: Any
    rate_limit: Any
    dead_band: Any
    torque_limit: Any
    torque_droop: Any
    viscous: Any
    coulomb: Any
    stribeck: Any
    stribeck_speed: Any
    load_friction: Any
    grip: Any
    inertia: Any
    spring: Any
    spring_torque: Any
    backlash: Any
    offset: Any
    scale: Any
    sine: Any
    cosine: Any

    @classmethod
    def ideal(cls, stiffness: Array, damping: Array) -> "Servo":
        """Without delay, limits, friction and inertia of its own; arguments `(…,)`. The grip is nearly rigid."""
        kp = np.asarray(stiffness, float)
        zero = {name: np.zeros(kp.shape) for name in cls._fields}
        limits = {name: np.full(kp.shape, UNLIMITED) for name in ("rate_limit", "torque_limit")}
        speed = np.full(kp.shape, 0.1)
        return cls(
            **zero
            | limits
            | {
                "stiffness": kp,
                "damping": np.asarray(damping, float),
                "stribeck_speed": speed,
                "grip": np.full(kp.shape, RIGID_GRIP),
            }
        )

    def take(self, index: Any) -> "Servo":
        """Some of them."""
        return Servo(*(np.asarray(field)[index] for field in self))


class TrackingEffect(Effect, ABC):
    """An effect on how servos follow their commands."""

    domain: ClassVar[str] = "tracking"

    @abstractmethod
    def alter(self, values: Array, servo: Servo) -> Servo:
        """The numbers `(joint,)` as they really are, by `values` `(coordinate,)`."""


@dataclass(frozen=True)
class ServoEffect(OfJoint, TrackingEffect, ABC):
    """An effect on one joint, which adds its numbers to fields of a `Servo`, or changes them otherwise."""

    fields: ClassVar[tuple[str, ...]] = ()

    def alter(self, values: Array, servo: Servo) -> Servo:
        """Adds one number to each field."""
        return change(servo, self.joint, dict(zip(self.fields, values, strict=True)))


def change(servo: Servo, joint: int, added: Mapping[str, float], factors: Mapping[str, float] | None = None) -> Servo:
    """A servo with numbers of a joint, counted from 1, added or multiplied."""
    is_joint = np.arange(len(servo.stiffness)) == joint - 1
    present = servo._asdict()
    more = {name: present[name] + np.where(is_joint, number, 0.0) for name, number in added.items()}
    times = {name: present[name] * np.where(is_joint, number, 1.0) for name, number in (factors or {}).items()}
    return servo._replace(**more, **times)


# ------------------------------------------------------------------ of the command


def _number(name: str, unit: str, typical: float, upper: float, lower: float = 0.0) -> Coordinate:
    """A number in which the rollout is not linear."""
    return Coordinate(name, unit, typical, lower=lower, upper=upper, linear=False)


@final_effect
class CommandTimeOffset(TrackingEffect):
    """All joints follow u(t − offset): the clocks of commands and read-outs differ, or all servos wait."""

    name: ClassVar[str] = "time_offset"
    specificity: ClassVar[int] = 1
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        mujoco="delay of each actuator",
        isaac_lab="min_delay, max_delay",
    )
    at: ClassVar[str] = "clock"
    quantities: ClassVar[tuple[str, ...]] = ("time",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("offset_s", "s", 5e-3, 0.5, -0.1),)

    def alter(self, values: Array, servo: Servo) -> Servo:
        return servo._replace(delay=servo.delay + values[0])


@final_effect
class ClockDrift(TrackingEffect):
    """All joints follow u(t·(1 + rate)): one of the two clocks is faster."""

    name: ClassVar[str] = "clock_drift"
    specificity: ClassVar[int] = 3
    at: ClassVar[str] = "clock"
    quantities: ClassVar[tuple[str, ...]] = ("time",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("rate", "1", 1e-4, 0.05, -0.05),)

    def alter(self, values: Array, servo: Servo) -> Servo:
        return servo._replace(clock_rate=servo.clock_rate + values[0])


@final_effect
class CommandDelay(ServoEffect):
    """A joint follows u(t − delay)."""

    name: ClassVar[str] = "command_delay"
    specificity: ClassVar[int] = 2
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        mujoco="delay",
        isaac_lab="min_delay, max_delay",
    )
    fields: ClassVar[tuple[str, ...]] = ("delay",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("delay_s", "s", 5e-3, 0.3, -0.02),)


@final_effect
class CommandFilter(ServoEffect):
    """A joint follows a first-order low pass of its command, T·u̇_c = u − u_c."""

    name: ClassVar[str] = "command_filter"
    specificity: ClassVar[int] = 4
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(mujoco="timeconst, or dyntype and dynprm")
    fields: ClassVar[tuple[str, ...]] = ("time_constant",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("time_constant_s", "s", 1e-2, 0.5),)


@dataclass(frozen=True)
class Limit(ServoEffect, ABC):
    """A limit, whose coordinate is one over it: zero is none."""

    limited: ClassVar[str]

    def alter(self, values: Array, servo: Servo) -> Servo:
        """Takes the lower limit."""
        is_joint = np.arange(len(servo.stiffness)) == self.joint - 1
        limit = np.where(is_joint & (values[0] > 0), 1 / max(float(values[0]), 1 / UNLIMITED), UNLIMITED)
        return servo._replace(**{self.limited: np.minimum(servo._asdict()[self.limited], limit)})

    @property
    @abstractmethod
    def parameters(self) -> tuple[str, ...]: ...

    def to_parameters(self, values: Array) -> tuple[Array, Array]:
        inverse = max(float(values[0]), 1 / UNLIMITED)
        jacobian = np.eye(len(values))
        jacobian[0, 0] = -1 / inverse**2
        return np.r_[1 / inverse, values[1:]], jacobian

    def from_parameters(self, given: Mapping[str, float]) -> Array:
        limit, *further_names = self.parameters
        return np.array(
            [1 / given[limit] if given.get(limit, 0.0) > 0 else 0.0, *(given.get(n, 0.0) for n in further_names)]
        )


@final_effect
class RateLimit(Limit):
    """The command of a joint moves at most at a velocity, |u̇_c| ≤ v."""

    name: ClassVar[str] = "rate_limit"
    specificity: ClassVar[int] = 3
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        isaac_lab="velocity_limit_sim, of the joint",
        urdf="limit velocity, of the joint",
    )
    limited: ClassVar[str] = "rate_limit"
    quantities: ClassVar[tuple[str, ...]] = ("velocity",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("slowness_s_per_rad", "s/rad", 0.5, 1e3),)

    @property
    def parameters(self) -> tuple[str, ...]:
        return ("velocity_rad_per_s",)


# ------------------------------------------------------------------ of the servo


@final_effect
class ServoStiffness(ServoEffect):
    """kp ← ratio·kp: a servo is stiffer or softer than declared, or than a servo that was fitted.

    Its coordinate is ln ratio.
    """

    name: ClassVar[str] = "servo_stiffness"
    specificity: ClassVar[int] = 2
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(mujoco="kp", isaac_lab="stiffness")
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("log_ratio", "1", 0.1, 2.303, -2.303),)

    def alter(self, values: Array, servo: Servo) -> Servo:
        return change(servo, self.joint, {}, {"stiffness": float(np.exp(values[0]))})

    @property
    def parameters(self) -> tuple[str, ...]:
        return ("ratio",)

    def to_parameters(self, values: Array) -> tuple[Array, Array]:
        return np.exp(values), np.diag(np.exp(values))

    def from_parameters(self, given: Mapping[str, float]) -> Array:
        return np.log([max(given.get("ratio", 1.0), 1e-9)])


@final_effect
class ServoDamping(ServoEffect):
    """kd ← ratio·kd: a servo damps more or less than declared, or than a servo that was fitted.

    Its coordinate is ratio − 1.
    """

    name: ClassVar[str] = "servo_damping"
    specificity: ClassVar[int] = 2
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(mujoco="kv", isaac_lab="damping")
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("excess", "1", 0.1, 9.0, -0.9),)

    def alter(self, values: Array, servo: Servo) -> Servo:
        return change(servo, self.joint, {}, {"damping": 1 + float(values[0])})

    @property
    def parameters(self) -> tuple[str, ...]:
        return ("ratio",)

    def to_parameters(self, values: Array) -> tuple[Array, Array]:
        return 1 + np.asarray(values), np.eye(1)

    def from_parameters(self, given: Mapping[str, float]) -> Array:
        return np.array([given.get("ratio", 1.0) - 1])


@final_effect
class ServoIntegral(ServoEffect):
    """A servo has an integral part, τₛ += ki·∫e dt."""

    name: ClassVar[str] = "servo_integral"
    specificity: ClassVar[int] = 3
    fields: ClassVar[tuple[str, ...]] = ("integral",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("integral_Nm_per_rad_s", "Nm/rad/s", 10.0, 1e5),)


@final_effect
class ServoFeedforward(ServoEffect):
    """A servo feeds the velocity of its command forward, τₛ += kf·u̇_c."""

    name: ClassVar[str] = "servo_feedforward"
    specificity: ClassVar[int] = 4
    fields: ClassVar[tuple[str, ...]] = ("feedforward",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("feedforward_Nm_s_per_rad", "Nm·s/rad", 1.0, 1e3, -1e3),)


@final_effect
class DeadBand(ServoEffect):
    """e ← e − clip(e, ±w): a servo does not see errors within a dead band."""

    name: ClassVar[str] = "dead_band"
    specificity: ClassVar[int] = 3
    fields: ClassVar[tuple[str, ...]] = ("dead_band",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("half_width_rad", "rad", 1e-3, 0.05),)


@final_effect
class TorqueLimit(Limit):
    """|τₛ| ≤ τ₀: a servo exerts at most a torque, beside its damping."""

    name: ClassVar[str] = "torque_limit"
    specificity: ClassVar[int] = 3
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        mujoco="forcerange",
        isaac_lab="effort_limit",
        urdf="limit effort",
    )
    limited: ClassVar[str] = "torque_limit"
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("inverse_per_Nm", "1/Nm", 0.05, 1e3),)

    @property
    def parameters(self) -> tuple[str, ...]:
        return ("torque_Nm",)


@final_effect
class TorqueSpeedLimit(Limit):
    """The limit of a servo's torque falls with speed: |τₛ| ≤ τ₀·(1 − q̇·sign(τₛ)/v₀).

    Its coordinates are 1/τ₀ and 1/v₀.
    """

    name: ClassVar[str] = "torque_speed_limit"
    specificity: ClassVar[int] = 4
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(
        isaac_lab="saturation_effort, velocity_limit of DCMotorCfg"
    )
    limited: ClassVar[str] = "torque_limit"
    quantities: ClassVar[tuple[str, ...]] = ("velocity",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (
        _number("inverse_per_Nm", "1/Nm", 0.05, 1e3),
        _number("droop_s_per_rad", "s/rad", 0.1, 10.0),
    )

    @property
    def includes(self) -> tuple[Effect, ...]:
        return (TorqueLimit(self.joint, of_slide=self.of_slide),)

    @property
    def parameters(self) -> tuple[str, ...]:
        return ("torque_Nm", "droop_s_per_rad")

    def alter(self, values: Array, servo: Servo) -> Servo:
        return change(super().alter(values, servo), self.joint, {"torque_droop": float(values[1])})


# ------------------------------------------------------------------ between drive and read-out


@final_effect
class EncoderBacklash(ServoEffect):
    """y = play(q): the read-out follows the drive with a play of half a width w to either side."""

    name: ClassVar[str] = "backlash"
    specificity: ClassVar[int] = 3
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(mujoco="a second joint with a range")
    quantities: ClassVar[tuple[str, ...]] = ("direction of motion",)
    fields: ClassVar[tuple[str, ...]] = ("backlash",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (_number("half_width_rad", "rad", 1e-3, 0.05),)


@final_effect
class EncoderOffset(ServoEffect):
    """y = q + offset: the read-out is offset from the angle that the servo holds."""

    name: ClassVar[str] = "encoder_offset"
    specificity: ClassVar[int] = 1
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(mujoco="ref", urdf="calibration")
    fields: ClassVar[tuple[str, ...]] = ("offset",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("offset_rad", "rad", 1e-3, 1.0),)


@final_effect
class EncoderScale(ServoEffect):
    """y = (1 + scale)·q: the read-out grows by more or less than the angle that the servo holds."""

    name: ClassVar[str] = "encoder_scale"
    specificity: ClassVar[int] = 3
    in_simulators: ClassVar[SimulatorParameters] = SimulatorParameters(mujoco="gear")
    quantities: ClassVar[tuple[str, ...]] = ("position",)
    fields: ClassVar[tuple[str, ...]] = ("scale",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("scale", "1", 1e-3, 0.1),)


@final_effect
class EncoderEccentricity(ServoEffect):
    """y = q + A·sin(q + φ): the read-out errs by a wave of one turn.

    Its coordinates are A cos φ and A sin φ.

    Encoders that are off their axis err by some mrad. One degree is taken as the most: a larger wave stands for what
    the model of a real arm lacks.
    """

    name: ClassVar[str] = "encoder_eccentricity"
    specificity: ClassVar[int] = 5
    quantities: ClassVar[tuple[str, ...]] = ("position",)
    fields: ClassVar[tuple[str, ...]] = ("sine", "cosine")
    numbers: ClassVar[tuple[Coordinate, ...]] = (
        symmetric("sine_rad", "rad", 1e-3, 0.02),
        symmetric("cosine_rad", "rad", 1e-3, 0.02),
    )

    @property
    def parameters(self) -> tuple[str, ...]:
        return ("amplitude_rad", "phase_rad")

    def to_parameters(self, values: Array) -> tuple[Array, Array]:
        sine, cosine = values
        size = np.hypot(sine, cosine)
        if not size:
            return np.zeros(2), np.array([[1.0, 0.0], [1e300, 1e300]])
        jacobian = np.array([[sine / size, cosine / size], [-cosine / size**2, sine / size**2]])
        return np.array([size, np.arctan2(cosine, sine)]), jacobian

    def from_parameters(self, given: Mapping[str, float]) -> Array:
        size = given.get("amplitude_rad", 0.0)
        phase = given.get("phase_rad", 0.0)
        return size * np.array([np.cos(phase), np.sin(phase)])


OF_JOINTS = (
    *(CommandDelay, CommandFilter, RateLimit, ServoStiffness, ServoDamping, ServoIntegral, ServoFeedforward, DeadBand),
    *(TorqueLimit, TorqueSpeedLimit, EncoderBacklash, EncoderOffset, EncoderScale, EncoderEccentricity),
)
"""The effects of one joint."""
