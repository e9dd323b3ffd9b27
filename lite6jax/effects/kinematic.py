"""Effects that move the tool: of joints, of links, and of what surrounds the arm.

The limits of numbers are far beyond what is made or wears, so that no real arm reaches them: they refuse a name, never
a value. Those of prismatic joints follow from a lever (`arms.arm.LEVER`).
"""

from abc import ABC
from typing import ClassVar

import numpy as np

from lite6jax.arms.se3 import rotation_exp
from lite6jax.deferred import JaxArray, jnp, lax
from lite6jax.effects import motion as motions
from lite6jax.effects.deflection import Deflection, library_of, place_at_joint, twist
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.effect import (
    Altering,
    Bending,
    Coordinate,
    Effect,
    FrameEffect,
    JointEffect,
    Loading,
    Wave,
    final_effect,
    positive,
    symmetric,
)
from lite6jax.effects.kernels import plays
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Inertia, Loads
from lite6jax.errors import InputError

_COMPLIANCE = 1e-3
"""rad/Nm: a gear, link or mount as soft as this sags by a degree under 20 Nm; those of arms are near 1e-5."""
_WAVE = 0.02
"""rad: the amplitude of a harmonic, of a wobble or of a warm-up; a gear's is below 1e-3."""
_RATIO = 0.02
"""Of a scale: a radian or a metre that is wrong by more is another unit."""
WARM_UP = (1.0, 1e6)
"""s: grams of metal warm up more slowly than the first, and an arm in less than the twelve days of the second."""

# ------------------------------------------------------------------ joints


class _Proportional(JointEffect, ABC):
    """δq = k·driver."""

    def angle(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        return values[0] * self.drivers[0].values(motion, loads)


@final_effect
class JointOffset(JointEffect):
    """δq = c: the encoder's zero is elsewhere."""

    name: ClassVar[str] = "joint_offset"
    specificity: ClassVar[int] = 0
    # more is another way to count the angle
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("offset_rad", "rad", 1e-4, 0.5),)

    def angle(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        return library_of(values).broadcast_to(values[0], (motion.samples,))


@final_effect
class JointScale(_Proportional):
    """δq = s·q: the encoder's radian is another.

    Of a prismatic joint the metre is, as of a screw's lead or of a scale that grew.
    """

    name: ClassVar[str] = "joint_scale"
    specificity: ClassVar[int] = 1
    quantities: ClassVar[tuple[str, ...]] = ("position",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("scale", "1", 1e-4, _RATIO),)


@final_effect
class JointCompliance(_Proportional):
    """δq = c·τ: the gear gives way to the torque that gravity exerts on it.

    Of a prismatic joint a screw, belt or rack gives way to the force along the joint's axis.
    """

    name: ClassVar[str] = "joint_compliance"
    specificity: ClassVar[int] = 2
    quantities: ClassVar[tuple[str, ...]] = ("gravity torque",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (positive("compliance_rad_per_Nm", "rad/Nm", 1e-5, _COMPLIANCE),)


@final_effect
class JointHarmonic(Wave, JointEffect):
    """δq = A·sin(n·q + φ): eccentric encoders and gears (n = 1, 2), gear teeth and wave generators (n up to 400).

    Its coordinates are A cos φ and A sin φ, in which it is linear; without a fixed `order` the order is the third, so
    that one compiled function serves every order.

    Attributes:
        order: n ≥ 1, where it is fixed; not necessarily an integer.
    """

    order: float | None = None

    name: ClassVar[str] = "joint_harmonic"
    specificity: ClassVar[int] = 5
    quantities: ClassVar[tuple[str, ...]] = ("position",)
    amplitude: ClassVar[Coordinate] = symmetric("_rad", "rad", 1e-4, _WAVE)

    @property
    def chosen(self) -> float | None:
        """The order, unless it is one of the two that are candidates of their own."""
        return None if self.order in (1.0, 2.0) else self.order

    def angle(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        return self.of_position(values, self.drivers[0].values(motion, loads))


@final_effect
class JointLag(JointEffect):
    """δq = −lag·dq: the joint is behind what its encoder says."""

    name: ClassVar[str] = "joint_lag"
    specificity: ClassVar[int] = 4
    quantities: ClassVar[tuple[str, ...]] = ("velocity",)
    # with more the servo of such an arm would not be stable
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("lag_s", "s", 1e-3, 0.2),)

    def angle(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        return -values[0] * self.drivers[0].values(motion, loads)


@final_effect
class JointCoupling(_Proportional):
    """δq = k·q_source: another joint's motion leaks into this one's, as through a shared gear or cable.

    Attributes:
        source_joint: the other joint, counted from 1.
    """

    source_joint: int

    name: ClassVar[str] = "joint_coupling"
    specificity: ClassVar[int] = 10
    fixed: ClassVar[str | None] = "source_joint"
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("coupling", "1", 1e-4, 0.05),)

    def __post_init__(self) -> None:
        if self.source_joint == self.joint:
            raise InputError(f"{self.label}: its source_joint is itself; that is joint_scale")

    @property
    def joints(self) -> tuple[int, ...]:
        return (self.joint, self.source_joint)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        return (joint_driver("position", self.source_joint, self.of_slide),)


@final_effect
class JointThermalOffset(_Proportional):
    """δq = k·(T − T₀): the encoder's zero moves with the joint's own temperature, or with that of the surroundings."""

    name: ClassVar[str] = "joint_thermal_offset"
    specificity: ClassVar[int] = 9
    quantities: ClassVar[tuple[str, ...]] = ("temperature",)
    # a degree in twenty kelvin
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("offset_rad_per_K", "rad/K", 1e-6, 1e-3),)


@final_effect
class JointWarmUp(JointEffect):
    """δq = A·(1 − exp(−time/τ)): the joint warms up from time 0, and nobody records its temperature.

    Its search tries some τ, in which it is not linear; without a fixed one τ is its second number.

    Attributes:
        time_constant_s: τ in s, where it is fixed.
    """

    time_constant_s: float | None = None

    name: ClassVar[str] = "joint_warm_up"
    specificity: ClassVar[int] = 10
    fixed: ClassVar[str | None] = "time_constant_s"
    searched: ClassVar[bool] = True
    quantities: ClassVar[tuple[str, ...]] = ("time",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (
        symmetric("amplitude_rad", "rad", 1e-4, _WAVE),
        Coordinate("time_constant_s", "s", 1e3, lower=WARM_UP[0], upper=WARM_UP[1], linear=False),
    )

    def angle(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        # at neutral τ is zero as well: any positive one then gives no angle, and no division by zero
        xp = library_of(values, motion.time)
        time = self.drivers[0].values(motion, loads)
        constant = self.time_constant_s or xp.where(values[1] > 0, values[1], 1.0)
        return -values[0] * xp.expm1(-time / constant)


# ------------------------------------------------------------------ gears with friction

_TRANSITION = 0.05
"""Of the largest torque: a step has no derivative by the friction that places it, so that of a ramp as wide as this is
taken. It is about the spacing of the torques of some dozens of poses, between which the step may be."""
_GAP = positive("gap_rad", "rad", 1e-4, 0.02)
"""More than a degree of play is a broken gear."""
_FRICTION = positive("friction_torque_Nm", "Nm", 0.1, 1e3, linear=False)
"""No motor of such an arm would turn a joint with more."""


@final_effect
class JointBacklash(JointEffect):
    """δq = ½·gap·sign(τ − f·direction): gravity presses the gear to a flank, unless friction f carries it to the other.

    Without f, friction is above every torque: δq = −½·gap·sign(direction), the gear lies against the flank that it
    came from. One class serves both, because a name of the catalogue is one class in files.

    Attributes:
        friction_torque_Nm: f in Nm; with 0 the direction does not matter. None for more than every torque, and not for
            a number to be fitted.
    """

    friction_torque_Nm: float | None = None  # noqa: N815  # as the parameter is called in files

    name: ClassVar[str] = "joint_backlash"
    specificity: ClassVar[int] = 3
    fixed: ClassVar[str | None] = "friction_torque_Nm"
    searched: ClassVar[bool] = True
    may_be_zero: ClassVar[bool] = True
    numbers: ClassVar[tuple[Coordinate, ...]] = (_GAP,)

    @property
    def drivers(self) -> tuple[Driver, ...]:
        direction = self.own_driver("direction of motion")
        torque = self.own_driver("gravity torque")
        if self.friction_torque_Nm is None:
            return (direction,)
        if self.friction_torque_Nm:
            return (torque, direction)
        return (torque,)

    def released(self) -> Effect:
        """With the friction as its last number."""
        return _FreeBacklash(self.joint, of_slide=self.of_slide)

    def angle(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        first, *direction = [driver.values(motion, loads) for driver in self.drivers]
        if self.friction_torque_Nm is None:
            pressing = -first
        else:  # Nm towards the flank at a larger angle, friction overcome
            pressing = first - self.friction_torque_Nm * direction[0] if direction else first
        return 0.5 * values[0] * library_of(pressing).sign(pressing)


@final_effect
class _FreeBacklash(JointEffect):
    """A `JointBacklash` whose friction is fitted as well; never in a file, where friction is fixed."""

    name: ClassVar[str] = "joint_backlash"
    specificity: ClassVar[int] = 3
    quantities: ClassVar[tuple[str, ...]] = ("gravity torque", "direction of motion")
    numbers: ClassVar[tuple[Coordinate, ...]] = (_GAP, _FRICTION)

    def angle(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        torque, direction = (driver.values(motion, loads) for driver in self.drivers)
        pressed = torque - jnp.maximum(values[1], 0.0) * direction
        ramp = jnp.clip(pressed / (_TRANSITION * jnp.maximum(jnp.max(jnp.abs(torque)), 1e-300)), -1.0, 1.0)
        return 0.5 * values[0] * (jnp.sign(pressed) + ramp - lax.stop_gradient(ramp))


@final_effect
class JointWindup(JointEffect):
    """δq = c·p(τ): p is the play operator of half-width f on gravity's torque. Dry friction f holds the gear back.

    A run begins unwound, as nearly as friction allows. The search tries some f, in which it is not linear; without a
    fixed one f is its second number.

    Attributes:
        friction_torque_Nm: f in Nm, where it is fixed.
    """

    friction_torque_Nm: float | None = None  # noqa: N815  # as the parameter is called in files

    name: ClassVar[str] = "joint_windup"
    specificity: ClassVar[int] = 5
    fixed: ClassVar[str | None] = "friction_torque_Nm"
    searched: ClassVar[bool] = True
    may_be_zero: ClassVar[bool] = True
    quantities: ClassVar[tuple[str, ...]] = ("gravity torque",)
    numbers: ClassVar[tuple[Coordinate, ...]] = (
        positive("compliance_rad_per_Nm", "rad/Nm", 1e-5, _COMPLIANCE),
        _FRICTION,
    )

    @property
    def hysteretic(self) -> bool:
        return True

    def angle(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        torque = self.drivers[0].values(motion, loads)
        xp = library_of(values, torque)
        friction = xp.maximum(values[1], 0.0) if self.friction_torque_Nm is None else self.friction_torque_Nm
        return values[0] * xp.asarray(plays(torque, xp.asarray(friction)[None], motion.run))[0]


# ------------------------------------------------------------------ links


_TWIST = (*((f"{axis}_m", "m") for axis in "xyz"), *((f"r{axis}_rad", "rad") for axis in "xyz"))
"""Names and units of a translation and a rotation vector."""
_SPREAD = {"m": 0.02, "rad": 0.05}
"""The prior standard deviation of frame offsets; it determines the directions that the sensor cannot observe."""
_FRAME = {"m": 0.1, "rad": 0.3}
"""Of a frame's displacement: more is another arm."""


class _Tilting(FrameEffect, ABC):
    """A frame that rotates about its x and y axes by a compliance times the moment about each."""

    def displace(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        about_x, about_y = (driver.values(motion, loads) for driver in self.drivers)
        return twist(motion.samples, rx=values[0] * about_x, ry=values[1] * about_y)


@final_effect
class LinkCompliance(_Tilting):
    """A link's frame rotates about its x and y axes by a compliance times the moment of gravity about them.

    Attributes:
        link: counted from 1; link N follows joint N.
    """

    link: int

    name: ClassVar[str] = "link_compliance"
    specificity: ClassVar[int] = 15
    at: ClassVar[str] = "link"
    quantities: ClassVar[tuple[str, ...]] = ("gravity moment x", "gravity moment y")
    numbers: ClassVar[tuple[Coordinate, ...]] = tuple(
        positive(f"compliance_{axis}_rad_per_Nm", "rad/Nm", 1e-5, _COMPLIANCE) for axis in "xy"
    )


@final_effect
class LinkThermalExpansion(Bending):
    """The vector from a link's frame to the origin of the next joint grows by α times the temperature rise.

    Attributes:
        link: counted from 1, without the last link, which no joint follows; None for every vector of the chain.
    """

    link: int | None = None

    name: ClassVar[str] = "link_thermal_expansion"
    specificity: ClassVar[int] = 9
    quantities: ClassVar[tuple[str, ...]] = ("temperature rise",)
    # that of plastics; metals have 1e-5 to 3e-5, and all of them grow
    numbers: ClassVar[tuple[Coordinate, ...]] = (positive("expansion_per_K", "1/K", 1e-5, 1e-4),)

    @property
    def site(self) -> str:
        return "links" if self.link is None else f"link{self.link}"

    def deflect(self, values: JaxArray, motion: Motion, loads: Loads | None) -> Deflection:
        growth = values[0] * self.drivers[0].values(motion, loads)
        if self.link is None:
            return Deflection(stretch=library_of(growth).broadcast_to(growth, (motion.dof, motion.samples)))
        if self.link >= motion.dof:
            raise InputError(f"{self.label}: no joint follows the last link; choose a link from 1 to {motion.dof - 1}")
        return Deflection(stretch=place_at_joint(motion.dof, self.link + 1, growth))


@final_effect
class FrameOffset(FrameEffect):
    """A constant twist of a link's frame, after its joint's rotation and in its own axes, or of the base frame.

    Attributes:
        link: counted from 1; None for the base.
    """

    link: int | None = None

    name: ClassVar[str] = "frame_offset"
    specificity: ClassVar[int] = 16
    numbers: ClassVar[tuple[Coordinate, ...]] = tuple(
        symmetric(name, unit, 1e-4, _FRAME[unit], spread=_SPREAD[unit]) for name, unit in _TWIST
    )

    @property
    def site(self) -> str:
        return "base" if self.link is None else f"link{self.link}"

    def displace(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        return library_of(values).broadcast_to(values[:, None], (6, motion.samples))


@final_effect
class AxisWobble(Bending):
    """A joint's frame tilts about its x and y, before the joint's rotation, by Fourier series in the joint's position.

    The tilt about x is Σ cosine·cos(n·q) + sine·sin(n·q) over n = 1 and 2, and likewise that about y. The eight numbers
    are `x_cosine1_rad`, `x_sine1_rad`, `x_cosine2_rad`, `x_sine2_rad` and the same of y. A tilt ε before the rotation
    is a tilt by Rz(−q) ε after it. Of order 1, the part that turns with the joint is a `frame_offset` of its link; the
    prior determines it.

    Attributes:
        joint: counted from 1.
    """

    joint: int

    name: ClassVar[str] = "axis_wobble"
    specificity: ClassVar[int] = 15
    at: ClassVar[str] = "joint"
    quantities: ClassVar[tuple[str, ...]] = ("position",)
    numbers: ClassVar[tuple[Coordinate, ...]] = tuple(
        symmetric(f"{axis}_{wave}{order}_rad", "rad", 1e-4, _WAVE, spread=_SPREAD["rad"])
        for axis in "xy"
        for order in (1, 2)
        for wave in ("cosine", "sine")
    )

    def deflect(self, values: JaxArray, motion: Motion, loads: Loads | None) -> Deflection:
        q = self.drivers[0].values(motion, loads)
        xp = library_of(q)
        cosine = xp.cos(q)
        sine = xp.sin(q)
        waves = (cosine, sine, xp.cos(2 * q), xp.sin(2 * q))
        about_x = sum(value * wave for value, wave in zip(values[:4], waves, strict=True))
        about_y = sum(value * wave for value, wave in zip(values[4:], waves, strict=True))
        tilt = twist(motion.samples, rx=cosine * about_x + sine * about_y, ry=cosine * about_y - sine * about_x)
        return Deflection(link=place_at_joint(motion.dof, self.joint, tilt))


# ------------------------------------------------------------------ base, tool and sensor


@final_effect
class BaseCompliance(FrameEffect):
    """The base tilts about its x and y axes by a compliance times the moment of links and payload about them.

    Attributes:
        cross: whether the mount is softest about other axes than x and y: rx follows the moment about y and ry that
            about x as well, both by `compliance_xy_rad_per_Nm`.
        shift: whether its origin shifts in the plane too, along the first axis by the moment about the second:
            `shift_xx_m_per_Nm`, `shift_xy_m_per_Nm`, `shift_yx_m_per_Nm` and `shift_yy_m_per_Nm`.
    """

    cross: bool = False
    shift: bool = False

    name: ClassVar[str] = "base_compliance"
    specificity: ClassVar[int] = 12
    at: ClassVar[str] = "base"
    quantities: ClassVar[tuple[str, ...]] = ("base moment x", "base moment y")

    @property
    def includes(self) -> tuple[Effect, ...]:
        """The mount about x and y, and that without shifts."""
        return (BaseCompliance(), BaseCompliance(cross=True))[: int(self.cross) + int(self.shift)]

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        tilts = [positive(f"compliance_{axis}_rad_per_Nm", "rad/Nm", 1e-5, _COMPLIANCE) for axis in "xy"]
        if self.cross:
            tilts.append(symmetric("compliance_xy_rad_per_Nm", "rad/Nm", 1e-5, _COMPLIANCE))
        shifts = ("xx", "xy", "yx", "yy") if self.shift else ()
        # a mount that gives way sideways by a centimetre under 10 Nm
        return (*tilts, *(symmetric(f"shift_{of}_m_per_Nm", "m/Nm", 1e-6, 1e-3) for of in shifts))

    def displace(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        about_x, about_y = (driver.values(motion, loads) for driver in self.drivers)
        rx = values[0] * about_x
        ry = values[1] * about_y
        x = None
        y = None
        if self.cross:
            rx = rx + values[2] * about_y
            ry = ry + values[2] * about_x
        if self.shift:
            xx, xy, yx, yy = values[-4:]
            x = xx * about_x + xy * about_y
            y = yx * about_x + yy * about_y
        return twist(motion.samples, x, y, rx=rx, ry=ry)


_VELOCITY = tuple(symmetric(f"v{axis}_m_per_s", "m/s", 1e-7, 1e-3) for axis in "xyz")
"""Of a drift: more is motion."""


class _Drifting(FrameEffect, ABC):
    """A frame that moves at a constant velocity, from zero at time 0."""

    quantities: ClassVar[tuple[str, ...]] = ("time",)

    def displace(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        time = self.drivers[0].values(motion, loads)
        return twist(motion.samples, *(velocity * time for velocity in values))


@final_effect
class BaseDrift(_Drifting):
    """The base drifts relative to the sensor at a constant velocity, in the base's axes, from zero at time 0."""

    name: ClassVar[str] = "base_drift"
    specificity: ClassVar[int] = 13
    at: ClassVar[str] = "base"
    numbers: ClassVar[tuple[Coordinate, ...]] = _VELOCITY


@final_effect
class SensorDrift(_Drifting):
    """All that the sensor shows drifts at a constant velocity, in the sensor's axes, from zero at time 0.

    It also turns, about the origin of the sensor's frame, so that positions far from that move more.
    """

    name: ClassVar[str] = "sensor_drift"
    specificity: ClassVar[int] = 14
    at: ClassVar[str] = "sensor"
    numbers: ClassVar[tuple[Coordinate, ...]] = (
        *_VELOCITY,
        *(symmetric(f"w{axis}_rad_per_s", "rad/s", 1e-7, 1e-3) for axis in "xyz"),
    )


@final_effect
class ToolOffset(FrameEffect):
    """The measured point is displaced on the flange, along the flange's axes.

    Attributes:
        turned: whether its orientation differs as well, by a rotation vector in the flange's axes.
    """

    turned: bool = False

    name: ClassVar[str] = "tool_offset"
    specificity: ClassVar[int] = 7
    at: ClassVar[str] = "tool"

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        largest = {"m": 1.0, "rad": 3.2}  # any rotation
        return tuple(symmetric(name, unit, 1e-3, largest[unit]) for name, unit in _TWIST[: 6 if self.turned else 3])

    def displace(self, values: JaxArray, motion: Motion, loads: Loads | None) -> JaxArray:
        return twist(motion.samples, *values)


@final_effect
class ToolCompliance(_Tilting):
    """What is on the flange rotates about the flange's x and y by a compliance times the payload's moment about them.

    The moment is that of what is outboard of the flange, the payload alone, about the flange's origin and in its axes;
    where nothing is carried there is none. A tool whose mass is declared within the last link bends by a
    `link_compliance` of that link, whose moment contains that mass too.
    """

    name: ClassVar[str] = "tool_compliance"
    specificity: ClassVar[int] = 12
    at: ClassVar[str] = "tool"
    quantities: ClassVar[tuple[str, ...]] = ("tool moment x", "tool moment y")
    # a gripper's wrist or a force sensor is softer than an arm, by ten times
    numbers: ClassVar[tuple[Coordinate, ...]] = tuple(
        positive(f"compliance_{axis}_rad_per_Nm", "rad/Nm", 1e-5, 1e-2) for axis in "xy"
    )


@final_effect
class MeasurementScale(Bending):
    """Positions measured by the sensor are scaled: p ← (1 + s)·p."""

    name: ClassVar[str] = "measurement_scale"
    specificity: ClassVar[int] = 8
    at: ClassVar[str] = "sensor"
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("scale", "1", 1e-4, _RATIO),)

    def deflect(self, values: JaxArray, motion: Motion, loads: Loads | None) -> Deflection:
        return Deflection(scale=library_of(values).broadcast_to(values[0], (motion.samples,)))


# ------------------------------------------------------------------ clock, payload and gravity


@final_effect
class TimeOffset(Altering):
    """The pose with the time stamp t is that of the arm (joints, velocities, loads) at t + offset."""

    name: ClassVar[str] = "time_offset"
    specificity: ClassVar[int] = 6
    at: ClassVar[str] = "clock"
    quantities: ClassVar[tuple[str, ...]] = ("time", "velocity of joint 1")
    # more is another recording
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("offset_s", "s", 1e-2, 60.0),)

    def alter(self, values: JaxArray, motion: Motion) -> Motion:
        return motions.shifted(motion, values[0])

    def beyond(self, values: JaxArray, motion: Motion) -> JaxArray:
        return motions.beyond(motion, values[0])


@final_effect
class PayloadError(Loading):
    """The payload differs from the declared mass; it is observable only through a compliance."""

    name: ClassVar[str] = "payload_error"
    specificity: ClassVar[int] = 11
    at: ClassVar[str] = "payload"
    quantities: ClassVar[tuple[str, ...]] = ("payload", "base moment x")
    # more than arms of this size carry
    numbers: ClassVar[tuple[Coordinate, ...]] = (symmetric("mass_kg", "kg", 0.1, 10.0),)

    def alter(self, values: JaxArray, motion: Motion) -> Motion:
        return motion._replace(payload=motion.payload + values[0])


@final_effect
class PayloadCom(Loading):
    """The payload's centre of mass is elsewhere than declared, along the flange's axes; seen through a compliance."""

    name: ClassVar[str] = "payload_com"
    specificity: ClassVar[int] = 12
    at: ClassVar[str] = "payload"
    quantities: ClassVar[tuple[str, ...]] = ("payload", "base moment x")
    numbers: ClassVar[tuple[Coordinate, ...]] = tuple(symmetric(f"{axis}_m", "m", 0.01, 0.5) for axis in "xyz")

    def alter_inertia(self, values: JaxArray, inertia: Inertia) -> Inertia:
        return inertia._replace(payload_center=inertia.payload_center + values)


@final_effect
class GravityDirection(Loading):
    """Gravity as declared is turned by a small rotation about the base's x and y; seen through a compliance.

    The rotation vector (x, y, 0) turns the vector of gravity in the base's frame: a base that itself leans by some
    rotation sees gravity turned by the opposite one.
    """

    name: ClassVar[str] = "gravity_direction"
    specificity: ClassVar[int] = 12
    at: ClassVar[str] = "base"
    quantities: ClassVar[tuple[str, ...]] = ("base moment x", "base moment y")
    # more is another way to mount the arm
    numbers: ClassVar[tuple[Coordinate, ...]] = tuple(symmetric(f"tilt_{axis}_rad", "rad", 0.01, 0.2) for axis in "xy")

    def alter_inertia(self, values: JaxArray, inertia: Inertia) -> Inertia:
        if isinstance(values, np.ndarray):  # on the host nothing is compiled, in the course of hundreds of fits
            from scipy.spatial.transform import Rotation  # takes longer than a list of effects

            turned = Rotation.from_rotvec([*values, 0.0]).as_matrix() @ np.asarray(inertia.gravity)
            return inertia._replace(gravity=turned)  # type: ignore[arg-type]
        return inertia._replace(gravity=rotation_exp(jnp.append(values, 0.0)) @ inertia.gravity)
