"""What a joint does that has no name: the likeliest curve of each family over what drives the joint."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.effects.drivers import Driver
from lite6jax.effects.nonparametric import Unnamed, plays
from lite6jax.estimation.score_test import Evidence, Score

Array = NDArray[np.floating]

TRIED = 20.0
"""Curves of a joint that are looked through wherever something may be, about."""
_PIECES = {"position": (8, 24), "gravity torque": (1, 3, 8, 24), "velocity": (8, 24)}
_PLAYS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Half the width of a play over the largest value of its driver; of several at once:"""
_SOFTLY = (0.05, 0.1, 0.2, 0.4, 0.7)
_WIDTHS = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5)
"""rad, of what is only here and there: half a step's, and a bump's standard deviation."""
_CENTRES = 40
_CLOSER = 4
_BUMP = ((2, 2.0), (4, 2.5))
"""Pieces of a bump, and the widths on either side beyond which it is nothing."""
_LEAST_VARIED = 1e-6


class Shape(NamedTuple):
    """A curve of a joint, and what it would explain."""

    effect: Unnamed
    score: Score


def shapes(evidence: Evidence, joint: int, local: bool) -> list[Shape]:
    """Curves of one joint, the likeliest few of each family.

    Args:
        evidence: against a model without curves of this joint.
        joint: counted from 1.
        local: whether to look for steps and bumps, which are many, as well.
    """
    case = evidence.case
    curves: list[Unnamed] = []
    for quantity, pieces in _PIECES.items():
        driver = Driver(quantity, joint)
        if (driver.loaded and case.loads is None) or not driver.known(case.motion, case.loads):
            continue
        values = np.asarray(driver.values(case.lived, case.loads))
        if np.ptp(values) <= _LEAST_VARIED:
            continue
        low, high = float(values.min()), float(values.max())
        curves += [Unnamed(f"joint{joint}", driver.phrase, low, high, count) for count in pieces]
        if quantity == "position" and local:
            curves += _here_and_there(evidence, joint, values)
        elif quantity == "gravity torque":
            curves += _with_memory(evidence, joint, driver, values)
    return list(map(Shape, curves, evidence.score(curves)))


def _here_and_there(evidence: Evidence, joint: int, q: Array) -> list[Unnamed]:
    """The likeliest step and the likeliest bump, each of the width that fits."""
    found = []
    for drawn, forms in ((_step, ((1, 1.0),)), (_bump, _BUMP)):
        at, width = _placed(evidence, evidence.case.sites["joint", joint - 1, 0], q, drawn)
        for pieces, reach in forms:
            low, high = at - reach * width, at + reach * width
            found.append(Unnamed(f"joint{joint}", Driver("position", joint).phrase, low, high, pieces))
    return found


def _placed(evidence: Evidence, site: Array, q: Array, drawn: Callable[[Array], Array]) -> tuple[float, float]:
    """Where, and how wide, rad, a form explains most; looked for ever closer to where it is."""
    used = q[evidence.fitted.used]
    lower, upper = np.percentile(used, (2, 98))
    centres, widths = np.percentile(used, np.linspace(2, 98, _CENTRES)), np.array(_WIDTHS)
    apart, found = float(np.diff(centres).max()), (float(lower), float(widths[0]))
    for _ in range(_CLOSER):
        at, width = (grid.ravel() for grid in np.meshgrid(centres, widths))
        form = drawn((q - at[:, None]) / width[:, None])
        lifted = np.stack([form, np.ones_like(form)], 1)  # a step begins anywhere
        best = int(np.argmax(evidence.gains(site * lifted[:, :, None])))
        found = (float(at[best]), float(width[best]))
        centres = np.clip(found[0] + apart * np.linspace(-1, 1, 7), lower, upper)
        widths, apart = found[1] * np.array([0.3, 0.6, 1.0, 1.5]), apart / 3
    return found


def _step(u: Array) -> Array:
    u = np.clip(u, -1, 1)
    return 0.5 * (1.5 * u - 0.5 * u**3)


def _bump(u: Array) -> Array:
    return np.exp(-0.5 * u**2)


def _with_memory(evidence: Evidence, joint: int, driver: Driver, values: Array) -> list[Unnamed]:
    """Along with the driver and behind it: with the one play that fits, and with several, as what gives way softly."""
    case = evidence.case
    site = case.sites["joint", joint - 1, 0]
    most, low, high = float(np.abs(values).max()), float(values.min()), float(values.max())
    widths = most * np.array(_PLAYS)
    behind = np.asarray(plays(jnp.asarray(values), jnp.asarray(widths), case.lived.run))
    pairs = np.stack([np.broadcast_to(values, behind.shape), behind], 1)
    best = float(widths[int(np.argmax(evidence.gains(site * pairs[:, :, None])))])
    memories = ((0.0, best), (0.0, *(most * share for share in _SOFTLY)))
    return [Unnamed(f"joint{joint}", driver.phrase, low, high, memory=memory) for memory in memories]
