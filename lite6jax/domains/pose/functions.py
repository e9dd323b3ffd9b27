"""Functions without a name that are tried in poses, at every site and of every driver, and their columns."""

from collections.abc import Sequence
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import COMPONENTS, SCALE, Unnamed
from lite6jax.effects.statics import Loads

Array = NDArray[np.floating]

_TILT, _SHIFT, _TURN = "rx ry", "x y z", "rx ry rz"
_TWIST = " ".join(COMPONENTS)
_EVERYWHERE = tuple(map(Driver, ("temperature rise", "time", "payload")))
"""Drivers of the whole arm."""
_OWN = ("gravity torque", "velocity", "direction of motion", "temperature")
"""Quantities of a joint beside its position."""
_WOBBLE = (1.0, 2.0)
"""Orders of what turns with a joint but is no angle of it: tilts of its axis, of the base or of the tool."""
_TURNS = (-4 * np.pi, 4 * np.pi)
"""rad: no joint turns farther."""
_LEAST_VARIED = 1e-6
_TIME = Driver("time")


def flexible(motion: Motion, loads: Loads | None, rows: int, sites: dict[Site, Array]) -> tuple[Unnamed, ...]:
    """Functions of every driver at every site, as far as drivers are known and vary, and the sensor sees the site.

    Parts of them, such as one component of a displacement, are not among them: `Unnamed.plainer` gives these.

    Args:
        motion: time-shifted.
        loads: on the rigid arm, or None.
        rows: 3, or 6 where orientations are measured.
        sites: columns of each site.
    """
    slides = motion.sliding.mask(motion.dof)
    positions = [Driver("slide position" if slide else "position", j) for j, slide in enumerate(slides, 1)]
    turning = [driver for driver, slide in zip(positions, slides, strict=True) if not slide]
    tried = _Tried(motion, loads, sites)
    for driver in turning:
        _at_joint(tried, driver.place, positions)
        if motion.dof > 1:
            _at_link(tried, driver.place, positions)
    _at_base(tried, turning)
    _at_tool(tried, turning, motion.dof, _SHIFT if rows == 3 else _TWIST)
    _at_sensor(tried)
    return tuple(tried.functions)


class _Tried:
    """The functions whose drivers are known and vary in a motion, and whose sites the sensor sees.

    Attributes:
        functions: those that were added.
    """

    def __init__(self, motion: Motion, loads: Loads | None, sites: dict[Site, Array]) -> None:
        self.functions: list[Unnamed] = []
        self._motion, self._loads, self._sites = motion, loads, sites
        self._ranges: dict[Driver, tuple[float, float] | None] = {}

    def polynomial(self, site: str, component: str, degree: int, *drivers: Driver) -> None:
        """All products of the drivers up to a degree."""
        self._add(site, component, drivers, degree=degree)

    def spline(self, site: str, component: str, pieces: int, *drivers: Driver) -> None:
        """A spline over the first driver, times the second where there is one, a direction of motion."""
        self._add(site, component, drivers, pieces=pieces)

    def waves(self, site: str, component: str, angle: Driver) -> None:
        """Waves of the first orders of an angle."""
        if self._seen(site, component) and self._range(angle) is not None:
            lower, upper = _TURNS
            self.functions.append(
                Unnamed(site, angle.phrase, lower, upper, component=component, orders=_WOBBLE, trust=(1.0, 1.0))
            )

    def _add(self, site: str, component: str, drivers: Sequence[Driver], degree: int = 0, pieces: int = 8) -> None:
        ranges = [self._range(driver) for driver in drivers]
        known = [one for one in ranges if one is not None]
        if len(known) < len(ranges) or not self._seen(site, component):
            return
        (lower, upper), *others = known
        further = tuple(bound for one in others for bound in one)
        phrase = " and ".join(driver.phrase for driver in drivers)
        self.functions.append(Unnamed(site, phrase, lower, upper, pieces, component, degree=degree, further=further))

    def _seen(self, site: str, component: str) -> bool:
        return any(self._sites[site_of(site, one)].any() for one in component.split())

    def _range(self, driver: Driver) -> tuple[float, float] | None:
        """Lower and upper of a driver; None where it is not known or does not vary."""
        if driver not in self._ranges:
            loads = self._loads if driver.loaded else None
            self._ranges[driver] = None
            if driver.known(self._motion, loads) and not (driver.loaded and loads is None):
                values = np.asarray(driver.values(self._motion, loads))
                if np.ptp(values) > _LEAST_VARIED:
                    self._ranges[driver] = float(values.min()), float(values.max())
        return self._ranges[driver]


def _at_joint(tried: _Tried, j: int, positions: Sequence[Driver]) -> None:
    """An angle: by the position of any joint or two, the joint's own loads and motion, time and temperature."""
    site, rz = f"joint{j}", "rz"
    own, load, warmth = Driver("position", j), Driver("gravity torque", j), Driver("temperature", j)
    velocity, direction = Driver("velocity", j), Driver("direction of motion", j)
    for driver in positions:
        tried.spline(site, rz, 5, driver)
        tried.polynomial(site, rz, 2, driver)
    for driver in (*(Driver(quantity, j) for quantity in _OWN), *_EVERYWHERE):
        tried.polynomial(site, rz, 3, driver)
    # drag, and springs that harden or yield, change too quickly for a cubic
    for driver in (load, velocity):
        tried.spline(site, rz, 8, driver)
    # what swings or drags elsewhere on the arm
    for other in (driver for driver in positions if driver.place != j):
        tried.polynomial(site, rz, 2, joint_driver("velocity", other.place, other.of_slide))
        tried.polynomial(site, rz, 1, Driver("direction of motion", other.place))
    for pair in combinations(positions, 2):
        tried.polynomial(site, rz, 3, *pair)
    # friction that sticks in one place, and play that a load takes up
    for driver, degree in product((own, load), (2, 3)):
        tried.polynomial(site, rz, degree, driver, direction)
    tried.spline(site, rz, 8, own, direction)
    # a spring that is softer in one place, and what a gear does as it warms
    for pair in ((own, load), (own, warmth), (own, _TIME), (load, warmth)):
        tried.polynomial(site, rz, 2, *pair)


def _at_link(tried: _Tried, j: int, positions: Sequence[Driver]) -> None:
    """Mostly tilts: by the position of the link's joint, its moments, time and temperature, and other joints."""
    site, own = f"link{j}", Driver("position", j)
    bending = [Driver(f"gravity moment {axis}", j) for axis in "xy"]
    tried.waves(site, _TILT, own)
    tried.spline(site, _TILT, 5, own)
    tried.polynomial(site, _TILT, 2, *bending)
    tried.polynomial(site, _SHIFT, 1, *bending)
    for driver in _EVERYWHERE:
        tried.polynomial(site, _TILT, 3, driver)
        tried.polynomial(site, _SHIFT, 2, driver)
    # a flange gapes to one side
    for axis, moment in zip("xy", bending, strict=True):
        tried.spline(site, f"r{axis}", 8, moment)
    # cables and belts of other joints
    for driver in (driver for driver in positions if driver.place != j):
        tried.polynomial(site, _TILT, 3, driver)
        tried.polynomial(site, _TILT, 1, Driver("direction of motion", driver.place))


def _at_base(tried: _Tried, turning: Sequence[Driver]) -> None:
    """All components by the first joints, the moments, time and temperature; a mount mostly tilts."""
    moments = [Driver(f"base moment {axis}") for axis in "xy"]
    for driver in turning[:3]:
        tried.waves("base", _TWIST, driver)
    for driver in turning:
        tried.polynomial("base", _TILT, 2, driver)
    for components, degree in product((_TWIST, _TILT, "rz"), (1, 2)):
        tried.polynomial("base", components, degree, *moments)
    for axis, moment in zip("xy", moments, strict=True):
        tried.spline("base", f"r{axis}", 8, moment)
    for driver in _EVERYWHERE:
        tried.polynomial("base", _TWIST, 3, driver)
        tried.polynomial("base", _TURN, 3, driver)
    _along_time(tried, "base", _TWIST)


def _at_tool(tried: _Tried, turning: Sequence[Driver], dof: int, components: str) -> None:
    """All components that are seen, by any joint, the moments at the flange, time and temperature."""
    for driver in turning:
        tried.waves("tool", components, driver)
    for driver in turning:
        tried.polynomial("tool", components, 2, driver)
    moments = Driver("gravity moment x", dof), Driver("gravity moment y", dof), Driver("gravity torque", dof)
    for degree in (1, 2):
        tried.polynomial("tool", components, degree, *moments)
    for driver in _EVERYWHERE:
        tried.polynomial("tool", components, 3, driver)
    _along_time(tried, "tool", components)


def _at_sensor(tried: _Tried) -> None:
    """All components by time and temperature; shifts by the measured position, as lenses and scales have them."""
    for driver in _EVERYWHERE:
        tried.polynomial("sensor", _TWIST, 3, driver)
        # a stand that bends, or a tripod that sinks, turns what it holds more than it shifts it
        tried.polynomial("sensor", _TURN, 3, driver)
    _along_time(tried, "sensor", _TWIST)
    axes = [Driver(f"measured position {axis}") for axis in "xyz"]
    for degree in (1, 2, 3):
        tried.polynomial("sensor", _SHIFT, degree, *axes)
    for axis, degree in product(axes, (1, 3)):
        tried.polynomial("sensor", axis.quantity[-1], degree, axis)
    # lenses distort in proportion to powers of the distance
    tried.polynomial("sensor", SCALE, 3, Driver("measured position's distance"))
    for driver in _EVERYWHERE:
        tried.polynomial("sensor", SCALE, 2, driver)


def _along_time(tried: _Tried, site: str, components: str) -> None:
    """Each component alone: what sways, creeps or lets go changes too quickly for a cubic."""
    for component in components.split():
        tried.spline(site, component, 8, _TIME)


def site_of(where: str, component: str) -> Site:
    """The key of the site at which a component of a function without a name acts; at a joint there is but one."""
    if component == SCALE:
        return SCALE, 0, 0
    kind, number = where.rstrip("0123456789"), int("0" + "".join(filter(str.isdecimal, where)))
    return kind, max(number - 1, 0), 0 if kind == "joint" else COMPONENTS.index(component)


def unnamed_columns(effect: Unnamed, basis: Array, sites: dict[Site, Array], out: Array | None = None) -> Array:
    """How residuals change with the coefficients of an effect without a name, `(number, row, sample)`; into `out`."""
    if out is None:
        out = np.empty((effect.size, *sites["scale", 0, 0].shape))
    for k, component in enumerate(effect.components):
        np.multiply(sites[site_of(effect.where, component)], basis[:, None], out=out[effect.part(k)])
    return out
