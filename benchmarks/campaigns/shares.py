"""Shares and ratios of trials with their 95 % intervals, and goals that are set on them."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import beta

WITHIN = 1.959964
"""Standard deviations on either side that hold 95 %."""


class Share(NamedTuple):
    """So many of so many, and the 95 % interval of the share (Clopper and Pearson, 1934)."""

    hits: int
    of: int

    @property
    def value(self) -> float:
        """The share itself."""
        return self.hits / self.of if self.of else math.nan

    @property
    def low(self) -> float:
        """The interval's lower end."""
        return float(beta.ppf(0.025, self.hits, self.of - self.hits + 1)) if self.hits else 0.0

    @property
    def high(self) -> float:
        """The interval's upper end."""
        return float(beta.ppf(0.975, self.hits + 1, self.of - self.hits)) if self.hits < self.of else 1.0

    def __str__(self) -> str:
        return f"{self.short} of {self.of}" if self.of else "none"

    @property
    def short(self) -> str:
        """In words, where the count stands beside it."""
        return f"{100 * self.value:.3g} % ({_percent(self.low)}–{_percent(self.high)})" if self.of else "none"


def _percent(value: float) -> str:
    return f"{100 * value:.1f}" if 0 < value < 0.1 or 0.9 < value < 1 else f"{100 * value:.0f}"


def share(flags: Iterable[bool]) -> Share:
    """Of flags, those set."""
    found = [bool(flag) for flag in flags]
    return Share(sum(found), len(found))


class Ratio(NamedTuple):
    """A ratio of root mean squares over trials, and its 95 % interval by drawing trials again (B. Efron, 1979)."""

    value: float
    low: float
    high: float
    median: float
    of: int

    def __str__(self) -> str:
        said = f"{self.value:.2f} ({self.low:.2f}–{self.high:.2f}), median {self.median:.2f}, of {self.of}"
        return said if self.of else "none"


def ratio(ours: Sequence[float], theirs: Sequence[float], draws: int = 2000) -> Ratio:
    """Ratio of RMS errors, both in one unit, by paired bootstrap."""
    a, b = np.square(np.asarray(ours, float)), np.square(np.asarray(theirs, float))
    if not len(a) or not b.any():
        return Ratio(math.nan, math.nan, math.nan, math.nan, 0)
    chosen = np.random.default_rng(0).integers(0, len(a), (draws, len(a)))
    again = np.sqrt(a[chosen].sum(1) / np.maximum(b[chosen].sum(1), 1e-300))
    each = np.sqrt(a[b > 0] / b[b > 0])
    low, high = np.percentile(again, [2.5, 97.5])
    return Ratio(float(np.sqrt(a.sum() / b.sum())), float(low), float(high), float(np.median(each)), len(a))


class Goal(NamedTuple):
    """A goal."""

    asked: str  # in words, with the number
    reached: str  # the number with its interval
    met: bool | None  # None where there are no trials


def goal(
    asked: str, found: Share | Ratio, least: float = -math.inf, most: float = math.inf, upper: float = math.inf
) -> Goal:
    """A goal on a share or a ratio of trials, and on the upper end of its interval.

    Where there are no trials it is neither met nor missed.
    """
    met = least <= found.value <= most and found.high <= upper
    return Goal(asked, str(found), met if found.of else None)
