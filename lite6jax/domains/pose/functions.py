"""Functions without a name that are tried in poses: of the drivers that can act at each site, and of pairs of them."""

from collections.abc import Iterable, Sequence
from itertools import chain, combinations, product

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import COMPONENTS, SCALE, Unnamed
from lite6jax.effects.statics import Loads

Array = NDArray[np.floating]

_TILT, _SHIFT = "rx ry", "x y z"
_TWIST = " ".join(COMPONENTS)
_UPRIGHT = f"{_SHIFT} {_TILT}"
_TIME, _PAYLOAD = Driver("time"), Driver("payload")
_EVERYWHERE = (Driver("temperature rise"), _TIME, _PAYLOAD)
"""Drivers of the whole arm."""
_DIRECTION = "direction of motion"
_DEGREE = 3
"""Highest degree of products of drivers; those of lower degrees are parts of them."""
_PIECES = 5
"""Intervals of splines: those of more are tried where one of them was found."""
_WOBBLE = (1.0, 2.0)
"""Orders of what turns with a joint but is no angle of it: tilts of its axis, of the base or of the tool."""
_TURNS = (-4 * np.pi, 4 * np.pi)
"""rad: no joint turns farther."""
_NEAR = 3
"""Joints next to the base, and next to the tool, whose positions move these together with another driver."""
_LEAST_VARIED = 1e-6


def tried_functions(motion: Motion, loads: Loads | None, rows: int, sites: dict[Site, Array]) -> tuple[Unnamed, ...]:
    """Functions of the drivers that can act at each site, as far as they are known and vary, and the sensor sees it.

    Those of one driver are cubics and splines (of a direction of motion, a line), and waves of joint angles. Those of
    two are of a site's own drivers, such as the position and the load of a joint, of one of these and one of the whole
    arm, or of the positions of two joints. Parts of them, such as one component of a displacement, are not among them:
    `Unnamed.parts` gives these.

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
        _at_joint(tried, driver.place, positions, motion.joint_temperature_rise is not None)
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

    def singles(self, site: str, component: str, drivers: Iterable[Driver]) -> None:
        """A cubic and a spline over each driver; of a direction of motion, which has two or three values, a line."""
        for driver in drivers:
            self.polynomial(site, component, 1 if driver.discrete else _DEGREE, driver)
            if not driver.discrete:
                self.spline(site, component, driver)

    def pairs(self, site: str, component: str, pairs: Iterable[tuple[Driver, Driver]]) -> None:
        """All products of the two drivers of each pair, up to the third degree."""
        for pair in pairs:
            self.polynomial(site, component, _DEGREE, *pair)

    def polynomial(self, site: str, component: str, degree: int, *drivers: Driver) -> None:
        """All products of the drivers up to a degree."""
        self._add(site, component, drivers, degree=degree)

    def spline(self, site: str, component: str, *drivers: Driver) -> None:
        """A spline over the first driver, times the second where there is one, a direction of motion."""
        self._add(site, component, drivers)

    def waves(self, site: str, component: str, angle: Driver) -> None:
        """Waves of the first orders of an angle."""
        if self._seen(site, component) and self._range(angle) is not None:
            lower, upper = _TURNS
            self.functions.append(
                Unnamed(site, angle.phrase, lower, upper, component=component, orders=_WOBBLE, trust=(1.0, 1.0))
            )

    def _add(self, site: str, component: str, drivers: Sequence[Driver], degree: int = 0) -> None:
        ranges = [self._range(driver) for driver in drivers]
        known = [one for one in ranges if one is not None]
        if len(known) < len(ranges) or not self._seen(site, component):
            return
        (lower, upper), *others = known
        further = tuple(bound for one in others for bound in one)
        phrase = " and ".join(driver.phrase for driver in drivers)
        self.functions.append(Unnamed(site, phrase, lower, upper, _PIECES, component, degree=degree, further=further))

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


def _at_joint(tried: _Tried, j: int, positions: Sequence[Driver], own_temperatures: bool) -> None:
    """An angle: by the joint's own loads, motion and temperature, and by the motion of any other joint."""
    site, rz, own_position = f"joint{j}", "rz", positions[j - 1]
    own = [own_position, Driver("gravity torque", j), Driver("temperature", j)]
    direction = Driver(_DIRECTION, j)
    others = [driver for driver in positions if driver.place != j]
    velocities = [joint_driver("velocity", driver.place, driver.of_slide) for driver in positions]
    # without temperatures of joints, that of a joint is the whole arm's, which would be there twice
    everywhere = _EVERYWHERE if own_temperatures else (_TIME, _PAYLOAD)
    tried.singles(site, rz, [*own, direction, *others, *velocities, *_directions(others), *everywhere])
    # a spring that is softer in one place, play that a load takes up, friction that falls as the gear warms
    tried.pairs(site, rz, combinations([*own, direction], 2))
    tried.pairs(site, rz, product([*own, direction], everywhere))
    tried.pairs(site, rz, combinations(positions, 2))
    # play that differs from place to place, more sharply than a cubic
    tried.spline(site, rz, own_position, direction)


def _at_link(tried: _Tried, j: int, positions: Sequence[Driver]) -> None:
    """Tilts by the position of the link's joint, its moments and other joints, and shifts by what is the link's own."""
    site, own_position = f"link{j}", positions[j - 1]
    moments = [Driver(f"gravity moment {axis}", j) for axis in "xy"]
    own, direction = [own_position, *moments], Driver(_DIRECTION, j)
    # cables and belts of other joints
    others = [driver for driver in positions if driver.place != j]
    tried.waves(site, _TILT, own_position)
    tried.singles(site, _TILT, [*own, direction, *others, *_directions(others), *_EVERYWHERE])
    tried.pairs(site, _TILT, combinations([*own, direction], 2))
    tried.pairs(site, _TILT, product([*own, direction], _EVERYWHERE))
    tried.pairs(site, _TILT, product([own_position], others))
    tried.singles(site, _SHIFT, [*own, *_EVERYWHERE])
    tried.pairs(site, _SHIFT, combinations(moments, 2))


def _at_base(tried: _Tried, turning: Sequence[Driver]) -> None:
    """All components by the moments, time and temperature; by the motion of joints all but a turn about z.

    That is an angle of joint 1, if this joint stands upright.
    """
    moments = [Driver(f"base moment {axis}") for axis in "xy"]
    near = turning[:_NEAR]
    for driver in near:
        tried.waves("base", _UPRIGHT, driver)
    tried.singles("base", _TWIST, [*moments, *_EVERYWHERE])
    tried.singles("base", _UPRIGHT, [*turning, *_directions(turning)])
    tried.pairs("base", _TWIST, chain(combinations(moments, 2), product(moments, _EVERYWHERE)))
    tried.pairs("base", _UPRIGHT, chain(combinations(near, 2), product(near, _EVERYWHERE)))


def _at_tool(tried: _Tried, turning: Sequence[Driver], dof: int, components: str) -> None:
    """All components that are seen, by the moments at the flange, the positions of joints, time and temperature."""
    moments = Driver("gravity moment x", dof), Driver("gravity moment y", dof), Driver("gravity torque", dof)
    near = turning[-_NEAR:]
    for driver in turning:
        tried.waves("tool", components, driver)
    tried.singles("tool", components, [*moments, *turning, *_directions(turning), *_EVERYWHERE])
    tried.pairs("tool", components, combinations(near, 2))
    tried.pairs("tool", components, product([*moments, *near], _EVERYWHERE))
    tried.polynomial("tool", components, 2, *moments)


def _at_sensor(tried: _Tried) -> None:
    """All components by time and temperature; shifts by the measured position, as lenses and scales have them."""
    axes = [Driver(f"measured position {axis}") for axis in "xyz"]
    distance = Driver("measured position's distance")
    tried.singles("sensor", _TWIST, _EVERYWHERE)
    tried.singles("sensor", _SHIFT, axes)
    tried.pairs("sensor", _SHIFT, product(axes, _EVERYWHERE))
    tried.polynomial("sensor", _SHIFT, _DEGREE, *axes)
    # lenses distort in proportion to powers of the distance
    tried.singles("sensor", SCALE, [distance, *_EVERYWHERE])
    tried.pairs("sensor", SCALE, product([distance], _EVERYWHERE))


def _directions(joints: Iterable[Driver]) -> list[Driver]:
    return [Driver(_DIRECTION, joint.place) for joint in joints]


def site_of(where: str, component: str) -> Site:
    """The key of the site at which a component of a function without a name acts; at a joint there is but one."""
    if component == SCALE:
        return SCALE, 0, 0
    kind, number = where.rstrip("0123456789"), int("0" + "".join(filter(str.isdecimal, where)))
    return kind, max(number - 1, 0), 0 if kind == "joint" else COMPONENTS.index(component)
