"""Functions without a name that are tried in poses: of the drivers that can act at each site, and of pairs of them."""

from collections.abc import Iterable, Sequence
from itertools import chain, combinations, product

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import COMPONENTS, SCALE, Unnamed, place_of
from lite6jax.effects.polynomials import products_of
from lite6jax.effects.statics import Loads

Array = NDArray[np.floating]

_TILT, _TURN, _SHIFT = "rx ry", "rx ry rz", "x y z"
_TWIST = " ".join(COMPONENTS)
_UPRIGHT = f"{_SHIFT} {_TILT}"
_TIME, _PAYLOAD = Driver("time"), Driver("payload")
_EVERYWHERE = (Driver("temperature rise"), _TIME, _PAYLOAD)
"""Drivers of the whole arm."""
_AT_ONCE = tuple(combinations(_EVERYWHERE, 2))
"""Of what flows or creeps with time, the faster the warmer, or the more loaded, it is."""
_BASE_MOMENTS = tuple(Driver(f"base moment {axis}") for axis in "xy")
_DIRECTION = "direction of motion"
_DEGREE = 3
"""Highest degree of products of drivers; those of lower degrees are parts of them."""
_QUADRATIC = 2
"""Degree of products with a velocity: inertial forces are quadratic in the velocities."""
_PIECES = 5
"""Intervals of splines: those of more are tried where one of them was found."""
_WOBBLE = (1.0, 2.0)
"""Orders of what turns with a joint but is no angle of it: tilts of its axis, of the base or of the tool."""
_TURNS = (-4 * np.pi, 4 * np.pi)
"""rad, between which waves hold at least: most joints turn no farther."""
_NEAR = 3
"""Joints next to the base, and next to the tool, whose positions move these together with another driver."""
_LEAST_VARIED = 1e-6


def tried_functions(motion: Motion, loads: Loads | None, rows: int, sites: dict[Site, Array]) -> tuple[Unnamed, ...]:
    """Functions of the drivers that can act at each site, as far as they are known and vary, and the sensor sees it.

    Those of one driver are cubics and splines (of a direction of motion, a line), and waves of joint angles and of the
    angles of the line of sight. Those of several are products: of a site's own drivers, such as the position and the
    load of a joint; of one of these, or the position of any joint, and one of the whole arm; of two of the whole arm;
    and of the positions or the velocities, at a joint also the directions, of two joints.
    Those of every other quantity of a joint, and of a joint's or a link's own with every other, are tried as rare ones.
    Parts of them, such as one component of a displacement, are not among them: `Unnamed.parts` gives these.

    Args:
        motion: time-shifted.
        loads: on the rigid arm, or None.
        rows: 3, or 6 where orientations are measured.
        sites: columns of each site.
    """
    joints, tried = _Joints(motion), _Tried(motion, loads, sites)
    at_tool = _SHIFT if rows == 3 else _TWIST
    for driver in joints.turning:
        _at_joint(tried, driver.place, joints)
    if motion.dof > 1:
        for driver in joints.positions:
            _at_link(tried, driver.place, joints)
    _at_base(tried, joints)
    _at_tool(tried, joints, at_tool)
    _at_sensor(tried, joints)
    tried.rare = True
    _of_every_driver(tried, joints, at_tool)
    return tuple(tried.functions)


class _Joints:
    """Drivers of all joints.

    Attributes:
        positions: of each joint.
        velocities: of each joint.
        loads: of gravity on each joint.
        temperatures: of each joint; none where all joints have that of the whole arm, which would be there twice.
        directions: of motion, of each joint.
        turning: positions of the revolute joints.
        every: all of these, and those of the whole arm.
    """

    def __init__(self, motion: Motion) -> None:
        self._slides = [bool(slides) for slides in motion.sliding.mask(motion.dof)]
        self.positions, self.velocities, self.loads = map(self._each, ("position", "velocity", "gravity torque"))
        rise = motion.joint_temperature_rise
        self.temperatures = [] if rise is None or not np.ptp(np.asarray(rise), 0).any() else self._each("temperature")
        self.directions = [Driver(_DIRECTION, driver.place) for driver in self.positions]
        self.turning = [driver for driver, slides in zip(self.positions, self._slides, strict=True) if not slides]
        each = self.positions, self.velocities, self.directions, self.loads, self.temperatures
        self.every = [*chain.from_iterable(each), *_EVERYWHERE]

    def others(self, joint: int) -> list[Driver]:
        """The positions of all joints but one."""
        return [driver for driver in self.positions if driver.place != joint]

    def moving(self, but: int = 0) -> list[Driver]:
        """The velocities of all joints, and the directions of motion of all but one."""
        return [*self.velocities, *(driver for driver in self.directions if driver.place != but)]

    def with_every(self, own: Iterable[Driver]) -> list[tuple[Driver, Driver]]:
        """Pairs of each of a site's own drivers with every other."""
        return [(one, other) for one, other in product(own, self.every) if one != other]

    def _each(self, quantity: str) -> list[Driver]:
        return [joint_driver(quantity, j, slides) for j, slides in enumerate(self._slides, 1)]


class _Tried:
    """The functions whose drivers are known and vary in a motion, and whose sites the sensor sees, each once.

    Attributes:
        functions: those that were added.
        rare: whether those that are added next are rare.
    """

    def __init__(self, motion: Motion, loads: Loads | None, sites: dict[Site, Array]) -> None:
        self.functions: list[Unnamed] = []
        self.rare = False
        self._motion, self._loads, self._sites = motion, loads, sites
        self._ranges: dict[Driver, tuple[float, float] | None] = {}
        self._there: set[tuple[object, ...]] = set()

    def singles(self, site: str, component: str, drivers: Iterable[Driver]) -> None:
        """A cubic and a spline over each driver; of a direction of motion, which has two or three values, a line."""
        for driver in drivers:
            self.polynomial(site, component, 1 if driver.discrete else _DEGREE, driver)
            if not driver.discrete:
                self.spline(site, component, driver)

    def pairs(
        self, site: str, component: str, pairs: Iterable[tuple[Driver, Driver]], degree: int = _DEGREE, power: int = 0
    ) -> None:
        """All products of the two drivers of each pair, up to a degree, and each up to a power where it is given."""
        for pair in pairs:
            self.polynomial(site, component, degree, *pair, power=power)

    def polynomial(self, site: str, component: str, degree: int, *drivers: Driver, power: int = 0) -> None:
        """All products of the drivers up to a degree, and each up to a power where it is given."""
        self._add(site, component, drivers, degree, power)

    def spline(self, site: str, component: str, *drivers: Driver) -> None:
        """A spline over the first driver, times the second where there is one."""
        self._add(site, component, drivers)

    def waves(self, site: str, component: str, *drivers: Driver) -> None:
        """Waves of the first orders of an angle, times the second driver where there is one."""
        self._add(site, component, drivers, orders=_WOBBLE)

    def _add(
        self,
        site: str,
        component: str,
        drivers: Sequence[Driver],
        degree: int = 0,
        power: int = 0,
        orders: tuple[float, ...] = (),
    ) -> None:
        ranges = [self._range(driver) for driver in drivers]
        known = [one for one in ranges if one is not None]
        products = products_of(tuple(drivers), degree, power) if degree else ()
        over = frozenset(tuple(sorted(drivers[k].phrase for k in one)) for one in products) or tuple(drivers)
        function = site, component, orders, over
        if len(known) < len(ranges) or not self._seen(site, component) or function in self._there:
            return
        self._there.add(function)
        (lower, upper), *others = known
        if orders:
            lower, upper = min(_TURNS[0], lower), max(_TURNS[1], upper)
        further = tuple(bound for one in others for bound in one)
        phrase = " and ".join(driver.phrase for driver in drivers)
        form = {"degree": degree, "power": power, "further": further, "orders": orders}
        form |= {"trust": (1.0, 1.0)} if orders else {}
        self.functions.append(Unnamed(site, phrase, lower, upper, _PIECES, component, tried_as_rare=self.rare, **form))

    def _seen(self, site: str, component: str) -> bool:
        return any(self._sites[site_of(site, one)].any() for one in component.split())

    def _range(self, driver: Driver) -> tuple[float, float] | None:
        """Lower and upper of a driver; None where it is not known or does not vary."""
        if driver not in self._ranges:
            self._ranges[driver] = None
            if driver.known(self._motion, self._loads):
                values = np.asarray(driver.values(self._motion, self._loads))
                if np.ptp(values) > _LEAST_VARIED:
                    self._ranges[driver] = float(values.min()), float(values.max())
        return self._ranges[driver]


def _at_joint(tried: _Tried, j: int, joints: _Joints) -> None:
    """An angle: by the joint's own loads, motion and temperature, and by the motion and loads of any other joint."""
    site, rz = f"joint{j}", "rz"
    own_position, velocity, direction = joints.positions[j - 1], joints.velocities[j - 1], joints.directions[j - 1]
    own_temperature = joints.temperatures[j - 1 : j]
    own = [own_position, joints.loads[j - 1], *own_temperature]
    loads = [load for load in joints.loads if load.place != j]
    tried.singles(site, rz, [*own, direction, *joints.others(j), *joints.moving(but=j), *loads, *_EVERYWHERE])
    # a spring that is softer in one place, play that a load takes up
    tried.pairs(site, rz, combinations([*own, direction], 2))
    # a cable of another joint that creeps
    tried.pairs(site, rz, product([*own, direction, *joints.others(j)], _EVERYWHERE))
    tried.pairs(site, rz, combinations(joints.positions, 2))
    tried.pairs(site, rz, _AT_ONCE)
    # what several joints swing round at once
    tried.pairs(site, rz, combinations(joints.velocities, 2), _QUADRATIC)
    # play that the motors of two joints take up together, as in a differential
    tried.pairs(site, rz, combinations(joints.directions, 2), degree=2)
    # grease that thins with warmth; with squares, or other drivers, these would resemble zones of friction
    tried.pairs(site, rz, product([velocity], [*own_temperature, *_EVERYWHERE]), _QUADRATIC, power=1)
    # play that differs from place to place, more sharply than a cubic; friction that fades with speed
    tried.spline(site, rz, own_position, direction)
    tried.spline(site, rz, velocity, direction)


def _at_link(tried: _Tried, j: int, joints: _Joints) -> None:
    """Tilts by the link's moments, its joint's position, direction and temperature, and the motion of other joints.

    Shifts by the link's moments and its joint's position, and both by its joint's load, time, temperature and payload.
    """
    site, own_position, load = f"link{j}", joints.positions[j - 1], joints.loads[j - 1]
    moments = [Driver(f"gravity moment {axis}", j) for axis in "xy"]
    own, direction = [own_position, *moments], joints.directions[j - 1]
    if own_position in joints.turning:
        tried.waves(site, _TILT, own_position)
    # cables and belts of other joints, and what these swing round
    tried.singles(site, _TILT, [*own, direction, *joints.others(j), *joints.moving(but=j), *_EVERYWHERE])
    # the motors at both ends warm it
    ends = joints.temperatures[j - 1 : j + 1]
    tried.singles(site, _TILT, ends)
    tried.pairs(site, _TILT, combinations(ends, 2))
    tried.pairs(site, _TILT, combinations([*own, direction], 2))
    tried.pairs(site, _TILT, product([*own, direction, *joints.others(j)], _EVERYWHERE))
    tried.pairs(site, _TILT, combinations(joints.positions, 2))
    tried.pairs(site, _TILT, combinations(joints.velocities, 2), _QUADRATIC)
    tried.singles(site, _SHIFT, [*own, *_EVERYWHERE])
    tried.pairs(site, _SHIFT, combinations(moments, 2))
    # slanting teeth push their shaft along its axis, and tilt it
    tried.singles(site, _SHIFT, [load])
    tried.singles(site, _TILT, [load])
    tried.pairs(site, _TILT, _AT_ONCE)
    tried.pairs(site, _SHIFT, _AT_ONCE)


def _at_base(tried: _Tried, joints: _Joints) -> None:
    """All components by the moments, time, temperature and payload; by the motion of joints all but a turn about z.

    A turn about z is left out because it equals an angle of joint 1, where the axis of that joint is upright.
    """
    moments, near = _BASE_MOMENTS, joints.positions[:_NEAR]
    for driver in joints.turning[:_NEAR]:
        tried.waves("base", _UPRIGHT, driver)
    tried.singles("base", _TWIST, [*moments, *_EVERYWHERE])
    tried.singles("base", _UPRIGHT, [*joints.positions, *joints.moving()])
    tried.pairs("base", _TWIST, chain(combinations(moments, 2), product(moments, _EVERYWHERE), _AT_ONCE))
    tried.pairs("base", _UPRIGHT, chain(combinations(near, 2), product(joints.positions, _EVERYWHERE)))
    # what a joint swings round pulls at the base, in the direction in which it is then
    swinging = [(driver, joints.velocities[driver.place - 1]) for driver in near]
    tried.pairs("base", _UPRIGHT, swinging)


def _at_tool(tried: _Tried, joints: _Joints, components: str) -> None:
    """All components that are seen, by the moments at the flange, the motion of joints, time and temperature."""
    dof, near = len(joints.positions), joints.positions[-_NEAR:]
    moments = Driver("gravity moment x", dof), Driver("gravity moment y", dof), joints.loads[-1]
    for driver in joints.turning:
        tried.waves("tool", components, driver)
    tried.singles("tool", components, [*moments, *joints.positions, *joints.moving(), *_EVERYWHERE])
    tried.pairs("tool", components, combinations(near, 2))
    tried.pairs("tool", components, chain(product([*moments, *joints.positions], _EVERYWHERE), _AT_ONCE))
    tried.polynomial("tool", components, 2, *moments)


def _at_sensor(tried: _Tried, joints: _Joints) -> None:
    """All components by time, temperature, the moments at the base and the velocities, as one bench may bear both.

    Shifts and a scale by the measured position, as lenses have them, and turns by the angles of the line of sight.
    """
    axes = [Driver(f"measured position {axis}") for axis in "xyz"]
    distance, azimuth, elevation = (Driver(f"measured position's {k}") for k in ("distance", "azimuth", "elevation"))
    tried.singles("sensor", _TWIST, [*_EVERYWHERE, *_BASE_MOMENTS, *joints.velocities])
    tried.pairs("sensor", _TWIST, _AT_ONCE)
    tried.pairs("sensor", _TWIST, combinations(joints.velocities, 2), _QUADRATIC)
    tried.singles("sensor", _SHIFT, axes)
    tried.pairs("sensor", _SHIFT, product(axes, _EVERYWHERE))
    tried.polynomial("sensor", _SHIFT, _DEGREE, *axes)
    # the circles of a tracker: out of centre, or tilted
    for angle in (azimuth, elevation):
        tried.waves("sensor", _TURN, angle)
    # lenses distort in proportion to powers of the distance
    tried.singles("sensor", SCALE, [distance, *_EVERYWHERE])
    tried.pairs("sensor", SCALE, product([distance], _EVERYWHERE))


def _of_every_driver(tried: _Tried, joints: _Joints, at_tool: str) -> None:
    """Every quantity of a joint or the whole arm at each site but the sensor; at joints and links pairs with their own.

    What acts at a site mostly depends on what is tried there before; but a list of what may does not end.
    """
    for j, position in enumerate(joints.positions, 1):
        own = [position, joints.directions[j - 1]]
        if position in joints.turning:
            tried.singles(f"joint{j}", "rz", joints.every)
            own_of_joint = [*own, joints.loads[j - 1], *joints.temperatures[j - 1 : j]]
            tried.pairs(f"joint{j}", "rz", joints.with_every(own_of_joint))
            # a ring that warmth makes oval, a gear that a load or time wears in one place
            for factor in [*own_of_joint[2:], *_EVERYWHERE]:
                tried.waves(f"joint{j}", "rz", position, factor)
                tried.spline(f"joint{j}", "rz", position, factor)
            tried.spline(f"joint{j}", "rz", _TIME, joints.loads[j - 1])
        if len(joints.positions) > 1:
            tried.singles(f"link{j}", _TILT, joints.every)
            tried.singles(f"link{j}", _SHIFT, joints.every)
            own_of_link = [*own, *(Driver(f"gravity moment {axis}", j) for axis in "xy")]
            tried.pairs(f"link{j}", _TILT, joints.with_every(own_of_link))
            for moment in own_of_link[2:]:
                tried.spline(f"link{j}", _TILT, _TIME, moment)
    # at the base those of the whole arm are tried in all components, which contain these
    tried.singles("base", _UPRIGHT, [driver for driver in joints.every if driver not in _EVERYWHERE])
    tried.singles("tool", at_tool, joints.every)
    # springs that are now softer and now stiffer
    for moment in _BASE_MOMENTS:
        tried.spline("base", _UPRIGHT, _TIME, moment)


def site_of(where: str, component: str) -> Site:
    """The key of the site at which a component of a function without a name acts; at a joint there is but one."""
    if component == SCALE:
        return SCALE, 0, 0
    kind, number = place_of(where)
    return kind, max(number - 1, 0), 0 if kind == "joint" else COMPONENTS.index(component)
