"""Drivers: the quantities on which effects depend, with their units, their values and how to record them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple, final

from lite6jax.arms.arm import joint_unit
from lite6jax.deferred import JaxArray, jnp
from lite6jax.effects.deflection import library_of
from lite6jax.effects.motion import Motion, since_reversal
from lite6jax.effects.statics import Loads
from lite6jax.errors import InputError


class _Source(NamedTuple):
    """How to read a quantity.

    `values` gives an array with one row per joint or link where `place` names one of these, else a single row. `remedy`
    says how to record the quantity; `loaded` marks those that follow from the loads of gravity. `at_slide` is what the
    quantity is called at a prismatic joint, where it has another unit.
    """

    values: Callable[[Motion, Loads | None], JaxArray | None]
    unit: str
    place: str
    remedy: str
    loaded: bool = False
    at_slide: str = ""


def _joint_temperatures(motion: Motion, _: Loads | None) -> JaxArray | None:
    """Temperatures of each joint; that of the whole arm where only that is known."""
    if motion.joint_temperature_rise is None and motion.temperature_rise is not None:
        return jnp.broadcast_to(motion.temperature_rise, motion.joint_position.shape)
    return motion.joint_temperature_rise


def _tool_moment(axis: int, _: Motion, loads: Loads | None) -> JaxArray | None:
    if loads is None or loads.payload_moment is None:
        return None
    return loads.payload_moment[axis]


def _of_sight(read: Callable[[Any, JaxArray], JaxArray]) -> Callable[[Motion, Loads | None], JaxArray | None]:
    """What follows from the measured position; `read` takes NumPy or JAX's, and `(3, sample)` m."""

    def values(motion: Motion, _: Loads | None) -> JaxArray | None:
        position = motion.measured_position
        if position is None:
            return None
        return read(library_of(position), position)

    return values


def _speed(motion: Motion, _: Loads | None) -> JaxArray | None:
    if motion.joint_velocity is None:
        return None
    return abs(motion.joint_velocity)


_MASSES = "the masses of the links; add `inertial` to the arm's description"
_DIRECTIONS = "the directions of motion; keep the rows in the order of recording"
_VELOCITIES = "the velocities of a moving arm; record a trajectory with time_s or dq1_rad_per_s …"
_COMMANDS = "the commands of a moving arm; record a trajectory with time_s and cmd1_rad …"
_ACCELERATIONS = "the accelerations of a moving arm; record a trajectory with time_s, or ddq1_rad_per_s2 …"
_TRAVELS = "the motion of the arm between its reversals; keep the rows in the order of recording, with velocities"
_WARMTH = "the temperature of each joint; record temp1_degC … or ambient_degC"
_MEASURED = "the measured positions; record x_m, y_m, z_m"
_FROM_SENSOR = "the measured positions, from the sensor's origin; record x_m, y_m, z_m"
_SIGHT = "the measured positions, in the axes of a sensor whose z is upright; record x_m, y_m, z_m"

_SOURCES = {
    "position": _Source(
        lambda m, _: m.joint_position, "rad", "joint", "the joint positions; add q1_rad …", at_slide="slide position"
    ),
    "direction of motion": _Source(lambda m, _: m.direction, "1", "joint", _DIRECTIONS),
    "velocity": _Source(lambda m, _: m.joint_velocity, "rad/s", "joint", _VELOCITIES, at_slide="slide velocity"),
    "speed": _Source(_speed, "rad/s", "joint", _VELOCITIES, at_slide="slide speed"),
    "travel since reversal": _Source(
        lambda m, _: None if m.joint_velocity is None else since_reversal(m),
        "rad",
        "joint",
        _TRAVELS,
        at_slide="slide travel since reversal",
    ),
    "acceleration": _Source(
        lambda m, _: m.joint_acceleration, "rad/s²", "joint", _ACCELERATIONS, at_slide="slide acceleration"
    ),
    "command velocity": _Source(lambda m, _: m.command_velocity, "rad/s", "joint", _COMMANDS),
    "gravity torque": _Source(
        lambda _, l: l.torque if l else None, "Nm", "joint", _MASSES, True, at_slide="gravity force"
    ),
    "gravity moment x": _Source(lambda _, l: l.moment[:, 0] if l else None, "Nm", "link", _MASSES, True),
    "gravity moment y": _Source(lambda _, l: l.moment[:, 1] if l else None, "Nm", "link", _MASSES, True),
    "base moment x": _Source(lambda _, l: l.base_moment[0] if l else None, "Nm", "", _MASSES, True),
    "base moment y": _Source(lambda _, l: l.base_moment[1] if l else None, "Nm", "", _MASSES, True),
    "tool moment x": _Source(partial(_tool_moment, 0), "Nm", "", _MASSES, True),
    "tool moment y": _Source(partial(_tool_moment, 1), "Nm", "", _MASSES, True),
    "temperature rise": _Source(
        lambda m, _: m.temperature_rise, "K", "", "a temperature; record temp1_degC … or ambient_degC"
    ),
    "temperature": _Source(_joint_temperatures, "K", "joint", _WARMTH),
    "time": _Source(lambda m, _: m.time, "s", "", "the times of the samples; record time_s"),
    "order of recording": _Source(lambda m, _: m.sequence, "1", "", "the rows in the order of recording"),
    "payload": _Source(lambda m, _: m.payload, "kg", "", "the payload; add payload_kg"),
    "measured position x": _Source(_of_sight(lambda xp, position: position[0]), "m", "", _MEASURED),
    "measured position y": _Source(_of_sight(lambda xp, position: position[1]), "m", "", _MEASURED),
    "measured position z": _Source(_of_sight(lambda xp, position: position[2]), "m", "", _MEASURED),
    "measured position's distance": _Source(
        _of_sight(lambda xp, position: xp.sqrt((position**2).sum(0))), "m", "", _FROM_SENSOR
    ),
    "measured position's azimuth": _Source(
        _of_sight(lambda xp, position: xp.arctan2(position[1], position[0])), "rad", "", _SIGHT
    ),
    "measured position's elevation": _Source(
        _of_sight(lambda xp, position: xp.arctan2(position[2], xp.hypot(position[0], position[1]))), "rad", "", _SIGHT
    ),
}
_OF_SLIDE = {quantity: source.at_slide for quantity, source in _SOURCES.items() if source.at_slide}
_GENERALISED = {slide_quantity: quantity for quantity, slide_quantity in _OF_SLIDE.items()}
_SOURCES |= {
    source.at_slide: source._replace(
        unit=joint_unit(source.unit, True), remedy=joint_unit(source.remedy, True), at_slide=""
    )
    for source in tuple(_SOURCES.values())
    if source.at_slide
}
QUANTITIES = tuple(_SOURCES)
"""The quantities that a driver can be."""


@final
@dataclass(frozen=True)
class Driver:
    """A quantity that varies over a motion: of one joint, of one link or of the whole arm.

    Attributes:
        quantity: one of `QUANTITIES`.
        place: the joint or link, counted from 1; 0 for a quantity of the whole arm.

    Raises:
        InputError: an unknown quantity, a joint or link that is missing, or one for a quantity of the whole arm.
    """

    quantity: str
    place: int = 0

    def __post_init__(self) -> None:
        if self.quantity not in _SOURCES:
            raise InputError(f"driver {self.quantity!r}: unknown; choose one of {', '.join(_SOURCES)}")
        kind = _SOURCES[self.quantity].place
        if kind and self.place < 1:
            raise InputError(f"driver {self.quantity!r}: its {kind} is missing; write '{self.quantity} of {kind} 1'")
        if self.place and not kind:
            raise InputError(f"driver {self.quantity!r}: is a quantity of the whole arm; give no joint")

    @property
    def phrase(self) -> str:
        """The driver in words, such as "gravity torque of joint 2"."""
        kind = _SOURCES[self.quantity].place
        if kind:
            return f"{self.quantity} of {kind} {self.place}"
        return self.quantity

    @property
    def unit(self) -> str:
        """The unit of the values."""
        return _SOURCES[self.quantity].unit

    @property
    def discrete(self) -> bool:
        """Tells whether it is a direction of motion, which has two or three values."""
        return self.quantity == "direction of motion"

    @property
    def is_angle(self) -> bool:
        """Tells whether it repeats after a turn."""
        return self.quantity in ("position", "measured position's azimuth", "measured position's elevation")

    @property
    def is_remembered(self) -> bool:
        """Tells whether what it drives may lag behind it, as hysteresis does."""
        return self.generalised in ("position", "gravity torque", "gravity moment x", "gravity moment y")

    @property
    def is_order(self) -> bool:
        """Tells whether it is but the order of recording, in which what nobody recorded may wander."""
        return self.quantity == "order of recording"

    @property
    def is_time(self) -> bool:
        """Tells whether it is the time, in which what is read out may jump."""
        return self.quantity == "time"

    @property
    def turns(self) -> str:
        """The site whose own turns it counts, where errors may be of any order; empty where there is none."""
        return f"joint{self.place}" if self.quantity == "position" else ""

    @property
    def of_slide(self) -> bool:
        """Tells whether it is a quantity of a prismatic joint alone."""
        return self.quantity in _GENERALISED

    @property
    def generalised(self) -> str:
        """The quantity without the kind of its joint: `velocity` is that of a revolute and of a prismatic joint."""
        return _GENERALISED.get(self.quantity, self.quantity)

    @property
    def remedy(self) -> str:
        """What to record or to add where the quantity is missing."""
        return _SOURCES[self.quantity].remedy

    @property
    def loaded(self) -> bool:
        """Tells whether the quantity follows from the loads of gravity."""
        return _SOURCES[self.quantity].loaded

    def known(self, motion: Motion, loads: Loads | None) -> bool:
        """Tells whether the motion and the loads contain the quantity."""
        return _SOURCES[self.quantity].values(motion, loads) is not None

    def values(self, motion: Motion, loads: Loads | None) -> JaxArray:
        """`(sample,)` in `unit`.

        Raises:
            InputError: the quantity is missing, or the arm has no such joint.
        """
        values = _SOURCES[self.quantity].values(motion, loads)
        if values is None:
            raise InputError(f"{self.phrase}: is required but missing; give {self.remedy}")
        if self.place > motion.dof:
            raise InputError(f"{self.phrase}: the arm has {motion.dof} joints; choose one of them")
        return values[self.place - 1] if self.place else values


def place_of(quantity: str) -> str:
    """What a quantity is of: a `joint`, a `link`, or, empty, the whole arm."""
    return _SOURCES[quantity].place


def joint_driver(quantity: str, joint: int, slides: bool) -> Driver:
    """A generalised quantity of a joint, counted from 1, that is prismatic where it `slides`."""
    return Driver(_OF_SLIDE.get(quantity, quantity) if slides else quantity, joint)


@lru_cache(maxsize=1024)  # hundreds of functions without a name are made in each fold
def driver_of(phrase: str) -> Driver:
    """The driver with this `phrase`, the inverse of `Driver.phrase`.

    Raises:
        InputError: no driver has this phrase.
    """
    quantity, _, where = phrase.partition(" of joint " if " of joint " in phrase else " of link ")
    if where and not where.isdecimal():
        raise InputError(f"driver {phrase!r}: does not end in a number; write it like 'gravity torque of joint 2'")
    return Driver(quantity, int(where or 0))
