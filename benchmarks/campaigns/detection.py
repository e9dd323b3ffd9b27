"""The size from which a test finds an effect, and what of an effect the rest cannot do.

Threshold λ: P(χ²ₖ(λ²) > c) = ½, with P(χ²ₖ > c) = ALARM/SEARCHED. The test knows name, site and noise. All SEARCHED
tests together raise a false alarm in one of 1/ALARM recordings. At 2λ it finds at least 99.99 %.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

Array = NDArray[np.floating]

SEARCHED = 100
ALARM = 0.01
LEAST_SEEN = 0.01  # the share of what an effect does that the rest cannot do, below which it is out of sight


@dataclass(frozen=True)
class Threshold:
    """How large an effect must be."""

    size: float  # by what its sizes must be multiplied to be at the threshold
    seen: float  # the share of what it does that all the rest cannot do as well
    moved: float  # m or Nm RMS, what it does at the threshold


@dataclass(frozen=True)
class Rival:
    """The candidate that comes nearest to an effect."""

    name: str  # of the effect
    site: str  # of it
    apart: float  # standard deviations by which the data tell them apart; below 4 no name is expected (`DISTINGUISHED`)

    def or_nearer(self, name: str, site: str, apart: float) -> "Rival":
        """This one, or another if it is nearer."""
        return Rival(name, site, apart) if apart < self.apart else self


@lru_cache
def least_power(size: int) -> float:
    """The χ² distance at which an effect of so many numbers is found half the time."""
    limit = chi2.isf(ALARM / SEARCHED, size)
    found: Any = brentq(lambda power: ncx2.sf(limit, size, power) - 0.5, 1e-3, 1e3)
    return float(found)


def projector(span: Array) -> Callable[[Array], Array]:
    """What takes from columns all that `span` can do."""
    u = span
    if span.shape[1]:
        lengths = np.linalg.norm(span, axis=0)
        u, s, _ = np.linalg.svd(span / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
        u = u[:, s > 1e-9 * s[0]]
    return lambda columns: columns - u @ (u.T @ columns)


def project_out(span: Array, columns: Array) -> Array:
    """What of the columns no mixture of `span` can do."""
    return projector(span)(columns)


def threshold(g: Array, span: Array, count: int, moved: float) -> Threshold:
    """The threshold of an effect in a direction that is given.

    Args:
        g: `(number,)`, what a unit of it adds to the whitened numbers.
        span: the columns of all that may vary beside it.
        count: in how many numbers it is linear.
        moved: m or Nm RMS, what a unit of it does.
    """
    left, whole = float(np.linalg.norm(project_out(span, g[:, None]))), float(np.linalg.norm(g))
    if left == 0 or whole == 0:
        return Threshold(np.inf, 0.0, np.inf)
    size = float(np.sqrt(least_power(count)) / left)
    return Threshold(size, left / whole, float(moved * size))


def nearest(g: Array, span: Array, candidates: Iterable[tuple[str, str, Array]]) -> Rival:
    """Which candidate explains most of an effect, beside all that may vary.

    Args:
        g: `(number,)`, what the effect adds to the whitened numbers.
        span: the columns of all that may vary.
        candidates: name, site and columns of each.
    """
    left = projector(span)
    rest = left(g[:, None])[:, 0]
    best = Rival("", "", float(np.linalg.norm(rest)))
    for name, site, columns in candidates:
        best = best.or_nearer(name, site, apart(rest, columns, left(columns)))
    return best


def apart(rest: Array, columns: Array, left: Array) -> float:
    """Standard deviations of what columns leave of an effect.

    Args:
        rest: the effect's residual after projection on the nuisance.
        columns: of what it may be taken for.
        left: their residual after projection on the nuisance.
    """
    lengths = np.linalg.norm(columns, axis=0)
    ways, sizes, _ = np.linalg.svd(left / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
    done = ways[:, sizes > LEAST_SEEN**2].T @ rest
    return float(np.sqrt(max(0.0, rest @ rest - done @ done)))
