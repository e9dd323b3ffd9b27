"""The periodic and nonparametric terms of poses: harmonics of each joint, and curves over its drivers."""

from collections.abc import Sequence
from functools import partial

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from lite6jax.domains.pose.deflections import Deflections
from lite6jax.domains.pose.kinematics import Site
from lite6jax.effects.bases import plays
from lite6jax.effects.drivers import Driver
from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.problem import LOCAL_FORMS, CurveDriver, CurveFamily, LocalForm, Mask, PeriodicFamily
from lite6jax.estimation.terms import Term

Array = NDArray[np.floating]

_PIECES = {"position": (8, 24), "gravity torque": (1, 3, 8, 24), "velocity": (8, 24), "time": ()}
"""Intervals of the splines over each driver: deflections by torques are often a cubic or two."""
_LOCAL: dict[str, tuple[LocalForm, ...]] = {"position": LOCAL_FORMS, "time": ("step",)}
"""A tooth that is skipped or an encoder that slips is a step in time; a bump in time is an outlier."""
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
    """The curves of each revolute joint over its position, gravity torque and velocity, and time, as far as known."""
    motion, found = deflections.host_motion, list[CurveFamily]()
    for j in map(int, np.flatnonzero(~motion.sliding.mask(motion.dof))):
        site, drivers = f"joint{j + 1}", []
        for quantity, pieces in _PIECES.items():
            driver = Driver(quantity, 0 if quantity == "time" else j + 1)
            loads = deflections.host_loads if driver.loaded else None
            if (driver.loaded and loads is None) or not driver.known(motion, loads):
                continue
            values = np.asarray(driver.values(motion, loads))
            spline = partial(_spline, site, driver.phrase)
            play = partial(_play, values, motion) if driver.loaded else None
            hysteresis = partial(_hysteresis, site, driver.phrase, values) if driver.loaded else None
            drivers.append(CurveDriver(values, pieces, _LOCAL.get(quantity, ()), spline, play, hysteresis))
        found.append(CurveFamily(site, sites["joint", j, 0], tuple(drivers)))
    return tuple(found)


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
