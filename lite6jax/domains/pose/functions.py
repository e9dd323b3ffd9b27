"""Where and on what nonparametric effects of poses can depend: the components of every site, and all drivers."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.drivers import Driver, joint_driver
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import COMPONENTS, SCALE, place_of
from lite6jax.effects.statics import Loads
from lite6jax.estimation.problem import Component, Quantity

Array = NDArray[np.floating]

_NEAR = 3
"""Joints next to the base, and next to the tool, on whose motion these depend as well."""
_WHOLE_ARM = ("temperature rise", "time", "payload")
_SIGHT = tuple(f"measured position{end}" for end in (" x", " y", " z", "'s distance", "'s azimuth", "'s elevation"))
_LEAST_VARIED = 1e-6
"""Range of a driver, in its unit, below which it did not vary."""


def components(sites: dict[Site, Array], motion: Motion, rows: int) -> tuple[Component, ...]:
    """The components that a sensor sees, those of joints first: of equals the first is chosen.

    A turn of a link about its joint's axis is an angle of the joint.

    Args:
        sites: `(row, sample)`, how residuals change with a deflection at each site.
        motion: of the arm.
        rows: 3, or 6 where orientations are measured.
    """
    dof = motion.dof
    found = [(f"joint{j + 1}", "rz") for j in range(dof) if not motion.sliding.mask(dof)[j]]
    found += [(f"link{j + 1}", one) for j in range(dof) if dof > 1 for one in COMPONENTS[:5]]
    found += [
        (where, one) for where in ("base", "tool", "sensor") for one in COMPONENTS[: rows if where == "tool" else 6]
    ]
    found += [("sensor", SCALE)]
    columns = ((where, one, sites[site_of(where, one)]) for where, one in found)
    return tuple(Component(where, one, column) for where, one, column in columns if column.any())


def quantities(motion: Motion, loads: Loads | None) -> tuple[Quantity, ...]:
    """The drivers that are known and vary, each with the sites whose own it is.

    Args:
        motion: time-shifted.
        loads: on the rigid arm, or None.
    """
    found = []
    for driver, own, only in _drivers(motion):
        if not driver.known(motion, loads):
            continue
        values = np.asarray(driver.values(motion, loads), float)
        if np.ptp(values) > _LEAST_VARIED and np.isfinite(values).all():
            found.append(Quantity(driver, values, own, only))
    return tuple(found)


def _drivers(motion: Motion) -> Iterator[tuple[Driver, frozenset[str], str]]:
    """All drivers, the sites whose own each is (all of them where that is `""`), and the one site where it can act."""
    dof, slides = motion.dof, motion.sliding.mask(motion.dof)
    rise = motion.joint_temperature_rise
    apart = rise is not None and np.ptp(np.asarray(rise), 0).any()  # else that of the whole arm would be there twice
    for j in range(1, dof + 1):
        own, last = {f"joint{j}", f"link{j}"}, {"tool"} if j == dof else set()
        ends = ({"base"} if j <= _NEAR else set()) | ({"tool"} if j > dof - _NEAR else set())
        moved: Callable[[str], Driver] = lambda quantity, j=j: joint_driver(quantity, j, bool(slides[j - 1]))  # noqa: E731
        for driver in (moved("position"), moved("velocity"), Driver("direction of motion", j)):
            yield driver, frozenset(own | ends), ""
        yield moved("gravity torque"), frozenset(own | last), ""
        for axis in "xy":
            yield Driver(f"gravity moment {axis}", j), frozenset({f"link{j}"} | last), ""
        if apart:
            yield Driver("temperature", j), frozenset(own | {f"link{j - 1}"}), ""
    for axis in "xy":
        yield Driver(f"base moment {axis}"), frozenset({"base", "sensor"}), ""
    for quantity in _WHOLE_ARM:
        yield Driver(quantity), frozenset({""}), ""
    for quantity in _SIGHT:
        yield Driver(quantity), frozenset({"sensor"}), "sensor"


def site_of(where: str, component: str) -> Site:
    """The key of the site at which a component of a nonparametric effect acts; at a joint there is but one."""
    if component == SCALE:
        return SCALE, 0, 0
    kind, number = place_of(where)
    return kind, max(number - 1, 0), 0 if kind == "joint" else COMPONENTS.index(component)
