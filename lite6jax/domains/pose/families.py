"""The periodic and nonparametric terms of poses: harmonics of each joint, and curves over its drivers."""

from collections.abc import Sequence
from functools import partial
from itertools import combinations, product

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from lite6jax.domains.pose.deflections import Deflections
from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.drivers import Driver
from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import COMPONENTS, SCALE, Unnamed, plays
from lite6jax.effects.statics import Loads
from lite6jax.estimation.problem import CurveDriver, CurveFamily, Mask, PeriodicFamily
from lite6jax.estimation.terms import Term

Array = NDArray[np.floating]

_PIECES = {"position": (8, 24), "gravity torque": (1, 3, 8, 24), "velocity": (8, 24)}
"""Intervals of the splines over each driver: deflections by torques are often a cubic or two."""
_EVERYWHERE = ("temperature rise", "time", "payload")
"""Quantities of the whole arm."""
_OWN = ("gravity torque", "velocity", "direction of motion", "temperature")
"""Quantities of a joint beside its position."""
_WOBBLE = (1.0, 2.0)
"""Orders of what turns with a joint but is no angle of it: tilts of its axis, of the base or of the tool."""
_TURNS = (-4 * np.pi, 4 * np.pi)
"""rad: no joint turns farther."""
_LEAST_VARIED = 1e-6
_NEIGHBOURS = 8
"""Least number of training rows within about `fade` of a position for it to count as measured."""


def periodic(motion: Motion, sites: dict[Site, Array]) -> tuple[PeriodicFamily, ...]:
    """The harmonics of each revolute joint.

    Args:
        motion: time-shifted.
        sites: columns of each site.
    """
    found = []
    for j in map(int, np.flatnonzero(~motion.sliding.mask(motion.dof))):
        q = np.asarray(motion.joint_position)[j]
        term, curve = partial(_harmonic, j + 1), partial(waves, j + 1, q)
        found.append(PeriodicFamily(f"joint{j + 1}", sites["joint", j, 0], q, term, _order, curve))
    return tuple(found)


def curves(deflections: Deflections, sites: dict[Site, Array]) -> tuple[CurveFamily, ...]:
    """The curves of each revolute joint over its position, its gravity torque and its velocity, as far as known."""
    motion, found = deflections.host_motion, list[CurveFamily]()
    for j in map(int, np.flatnonzero(~motion.sliding.mask(motion.dof))):
        site, drivers = f"joint{j + 1}", []
        for quantity, pieces in _PIECES.items():
            driver = Driver(quantity, j + 1)
            loads = deflections.host_loads if driver.loaded else None
            if (driver.loaded and loads is None) or not driver.known(motion, loads):
                continue
            values = np.asarray(driver.values(motion, loads))
            spline = partial(_spline, site, driver.phrase)
            play = partial(_play, values, motion) if driver.loaded else None
            hysteresis = partial(_hysteresis, site, driver.phrase, values) if driver.loaded else None
            drivers.append(CurveDriver(values, pieces, quantity == "position", spline, play, hysteresis))
        found.append(CurveFamily(site, sites["joint", j, 0], tuple(drivers)))
    return tuple(found)


def flexible(motion: Motion, loads: Loads | None, rows: int, sites: dict[Site, Array]) -> tuple[Unnamed, ...]:
    """Functions of every driver at every site, as far as drivers are known and vary, and the sensor sees the site.

    At revolute joints they are of the position of any joint or two, of the joint's own loads and motion, and of time
    and temperature; at links, base and tool the tilts, or all components, by positions, moments, time and temperature.

    Args:
        motion: time-shifted.
        loads: on the rigid arm, or None.
        rows: 3, or 6 where orientations are measured.
        sites: columns of each site.
    """
    dof, ranges = motion.dof, _Ranges(motion, loads)
    slides = motion.sliding.mask(dof)
    positions = [Driver("slide position" if slides[k] else "position", k + 1) for k in range(dof)]
    turning = [driver for driver, slide in zip(positions, slides, strict=True) if not slide]
    everywhere = [Driver(q) for q in _EVERYWHERE]
    found: list[Unnamed] = []

    def add(site: str, drivers: Sequence[Driver], degree: int = 0, component: str = "rz", pieces: int = 0) -> None:
        spans = [ranges(driver) for driver in drivers]
        if any(span is None for span in spans) or not any(sites[site_of(site, c)].any() for c in component.split()):
            return
        phrase = " and ".join(driver.phrase for driver in drivers)
        if not degree and not pieces:
            found.append(Unnamed(site, phrase, *_TURNS, 8, component, orders=_WOBBLE, trust=(1.0, 1.0)))
            return
        (lower, upper), *further = [span for span in spans if span is not None]
        bounds = tuple(bound for span in further for bound in span)
        found.append(Unnamed(site, phrase, lower, upper, pieces or 8, component, degree=degree, further=bounds))

    for j in range(1, dof + 1):
        if slides[j - 1]:
            continue
        for driver in positions:
            add(f"joint{j}", [driver], pieces=5)
            add(f"joint{j}", [driver], 2)
        for driver in (*(Driver(q, j) for q in _OWN), *everywhere):
            add(f"joint{j}", [driver], 3)
        # drag, and springs that harden or yield, change too quickly for a cubic
        for quantity in ("gravity torque", "velocity"):
            add(f"joint{j}", [Driver(quantity, j)], pieces=8)
        for pair in combinations(positions, 2):
            add(f"joint{j}", pair, 3)
        # friction that sticks in one place, and play that a load takes up
        for quantity in ("position", "gravity torque"):
            for degree in (2, 3):
                add(f"joint{j}", [Driver(quantity, j), Driver("direction of motion", j)], degree)
        add(f"joint{j}", [Driver("position", j), Driver("direction of motion", j)], pieces=8)
        # a spring that is softer in one place, and what a gear does as it warms
        own, load, warmth = Driver("position", j), Driver("gravity torque", j), Driver("temperature", j)
        for pair in ((own, load), (own, warmth), (own, Driver("time")), (load, warmth)):
            add(f"joint{j}", pair, 2)
        if dof > 1:
            add(f"link{j}", [Driver("position", j)], 0, "rx ry")
            add(f"link{j}", [Driver("position", j)], 0, "rx ry", pieces=5)
            bending = [Driver(f"gravity moment {axis}", j) for axis in "xy"]
            add(f"link{j}", bending, 2, "rx ry")
            add(f"link{j}", bending, 1, "x y z")
            for driver in everywhere:
                add(f"link{j}", [driver], 3, "rx ry")
                add(f"link{j}", [driver], 2, "x y z")
            # cables that other joints pull
            for driver in (driver for k, driver in enumerate(positions, 1) if k != j):
                add(f"link{j}", [driver], 2, "rx ry")
    base, tool = " ".join(COMPONENTS), " ".join(COMPONENTS[: 3 if rows == 3 else 6])
    moments = [Driver(f"base moment {axis}") for axis in "xy"]
    at_flange = [Driver("gravity moment x", dof), Driver("gravity moment y", dof), Driver("gravity torque", dof)]
    # a mount mostly tilts
    for site, component, lean, angles, loaded in (
        ("base", base, "rx ry", turning[:3], moments),
        ("tool", tool, tool, turning, at_flange),
    ):
        for driver in angles:
            add(site, [driver], 0, component)
        for driver in turning:
            add(site, [driver], 2, lean)
        for degree in (1, 2):
            add(site, loaded, degree, component)
        for driver in everywhere:
            add(site, [driver], 3, component)
    for turns, degree in product(("rx ry", "rz"), (1, 2)):
        add("base", moments, degree, turns)
    for driver in everywhere:
        add("sensor", [driver], 3, base)
        # a stand that bends, or a tripod that sinks, turns what it holds more than it shifts it
        for site in ("base", "sensor"):
            add(site, [driver], 3, "rx ry rz")
    axes = [Driver(f"measured position {axis}") for axis in "xyz"]
    for degree in (1, 2, 3):
        add("sensor", axes, degree, "x y z")
    for axis, degree in product(axes, (1, 3)):
        add("sensor", [axis], degree, axis.quantity[-1])
    # lenses distort in proportion to powers of the distance
    add("sensor", [Driver("measured position's distance")], 3, SCALE)
    for driver in everywhere:
        add("sensor", [driver], 2, SCALE)
    return tuple(found)


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


class _Ranges:
    """Lower and upper of drivers in a motion; None where one is not known or does not vary."""

    def __init__(self, motion: Motion, loads: Loads | None) -> None:
        self._motion, self._loads = motion, loads
        self._found: dict[Driver, tuple[float, float] | None] = {}

    def __call__(self, driver: Driver) -> tuple[float, float] | None:
        if driver not in self._found:
            loads = self._loads if driver.loaded else None
            self._found[driver] = None
            if driver.known(self._motion, loads) and not (driver.loaded and loads is None):
                values = np.asarray(driver.values(self._motion, loads))
                if np.ptp(values) > _LEAST_VARIED:
                    self._found[driver] = float(values.min()), float(values.max())
        return self._found[driver]


def waves(
    joint: int,
    q: Array,
    orders: Sequence[float] | Array,
    training: Mask,
    prior: tuple[float, float, float] | None,
    fade: float,
) -> Unnamed:
    """The curve of some orders of a joint that fades out where there are no training rows.

    Args:
        joint: counted from 1.
        q: `(sample,)` rad, its positions.
        orders: of the harmonics in it.
        training: `(sample,)` bool.
        prior: of the coefficients: standard deviation in rad at low orders, corner order and slope; or None.
        fade: rad beyond the training rows within which the curve fades out.
    """
    q = q[training]
    lower, upper = float(q.min()) - 3 * fade, float(q.max()) + 3 * fade
    trust: tuple[float, ...] = (1.0, 1.0)  # waves with a prior go back to it by themselves
    if prior is None:
        at = np.linspace(lower, upper, int(np.ceil((upper - lower) / (fade / 4))))
        nth = min(max(_NEIGHBOURS, len(q) // 150), len(q))
        away = np.asarray(KDTree(q[:, None]).query(at[:, None], k=nth)[0])[:, -1]
        trust = tuple(float(t) for t in np.exp(-((away / fade) ** 2)).round(4))
    driver = Driver("position", joint).phrase
    spread, rolloff = (None, ()) if prior is None else (prior[0], prior[1:])
    waves = tuple(float(order) for order in orders)
    return Unnamed(f"joint{joint}", driver, lower, upper, orders=waves, trust=trust, spread=spread, rolloff=rolloff)


def _harmonic(joint: int, order: float) -> JointHarmonic:
    return JointHarmonic(joint, order)


def _order(term: Term) -> float | None:
    assert isinstance(term, JointHarmonic)
    return None if term.order is None else float(term.order)


def _spline(site: str, driver: str, lower: float, upper: float, pieces: int) -> Unnamed:
    return Unnamed(site, driver, lower, upper, pieces)


def _play(values: Array, motion: Motion, widths: Array) -> Array:
    return np.asarray(plays(jnp.asarray(values), jnp.asarray(widths), motion.run))


def _hysteresis(site: str, driver: str, values: Array, widths: tuple[float, ...]) -> Unnamed:
    return Unnamed(site, driver, float(values.min()), float(values.max()), memory=widths)
