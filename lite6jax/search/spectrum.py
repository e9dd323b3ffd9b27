"""Which orders of an angle the residuals contain, at every site of a periodic family; orders need not be whole.

Where angles are multiples of 2°, as those that people type are, orders 2 and 178 are the same wave at every sample.
The prior of orders chooses among them.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from lite6jax.array_types import Array, Integers
from lite6jax.estimation.evidence import log_orders_of
from lite6jax.estimation.problem import PeriodicFamily
from lite6jax.estimation.score_test import ScoreTest
from lite6jax.estimation.terms import Term
from lite6jax.estimation.thresholds import EXACT_BELOW, LOWEST_ORDER

_OTHER_ORDERS = 3
"""Other orders that are reported beside one that explains no more; they fit on a screen."""
_SCORED_PEAKS = 4
"""Peaks of a spectrum that are scored exactly; side lobes are lower than these."""

_BIN = 2 * np.pi / 2**15
"""rad, to which angles are rounded: at order 400 that is a 25th of a radian of phase at most, and at order 1000
a tenth, by which a gain is a third of a per cent too low."""
_COARSE_BIN = 4 * _BIN
"""rad, the same where only the likeliest order is sought."""


class Line(NamedTuple):
    """A spectral line: the order of a family that explains most.

    Attributes:
        family: which.
        order: of its angle.
        gain: in log-likelihood, exactly, at that order.
        searched: the logarithm of the number of orders that it is the best of.
    """

    family: PeriodicFamily
    order: float
    gain: float
    searched: float

    @property
    def term(self) -> Term:
        """The term of this order."""
        return self.family.term(self.order)


def spectrum(test: ScoreTest, family: PeriodicFamily) -> tuple[Array, Array]:
    """Orders `(order,)` of a family's angle and the gain in log-likelihood of each.

    The nuisance is not projected out: gains of low orders, with which it is confounded, are overestimated.
    """
    site = family.column
    training = test.fit.training
    score = np.sum(site * test.left_of_rows, 0)[training]
    weight = np.sum(site**2, 0)[training]
    # sums over samples of e^{i n q}, for all n at once: a transform of histograms over q
    place, length, step, at = _histogram(test, family, _BIN)
    e = _transform(place, score, length)[at]
    w = _transform(place, weight, length)
    total = float(weight.sum())
    twice = w[2 * at]
    ss = 0.5 * (total - twice.real)
    cc = 0.5 * (total + twice.real)
    sc = 0.5 * twice.imag
    return at * step, _pair_gain(e.imag, e.real, ss, cc, sc)


def modulated_spectrum(test: ScoreTest, family: PeriodicFamily, sizes: Array) -> tuple[Array, Array]:
    """Orders `(order,)` and the gains `(driver, order)` of waves whose size is a constant and follows one driver.

    The sums of squares of sine and cosine are taken as equal, and the nuisance is not projected out: gains are rough.

    Args:
        test: of a model.
        family: whose orders.
        sizes: `(driver, sample)`, the values of drivers.
    """
    training = test.fit.training
    score = np.sum(family.column * test.left_of_rows, 0)[training]
    weight = np.sum(family.column**2, 0)[training]
    total = float(weight.sum())
    place, length, step, at = _histogram(test, family, _COARSE_BIN)
    if not total > 0 or not len(at):
        return at * step, np.zeros((len(sizes), len(at)))
    centred = sizes[:, training]
    centred = centred - (centred @ weight)[:, None] / total
    length_of = np.sqrt(centred**2 @ weight / total)
    centred = centred / np.maximum(length_of, 1e-12 * max(float(length_of.max(initial=0.0)), 1e-300))[:, None]
    weighted = score * np.concatenate([np.ones_like(weight)[None], centred])
    histograms = np.stack([np.bincount(place, values) for values in weighted])
    transformed: Any = rfft(histograms.astype(np.float32), length)  # rough gains need no more digits
    transformed = transformed[:, at]
    powers = (transformed.real**2 + transformed.imag**2) / total
    return at * step, powers[0] + powers[1:]


def _histogram(test: ScoreTest, family: PeriodicFamily, width: float) -> tuple[Integers, int, float, Integers]:
    """Bins of this width, rad, of a family's angle, whose Fourier transform has the orders that are searched.

    Returns:
        the bin of each training sample, the length of the transform, its step in orders, and the places of the orders.
    """
    q = family.angle
    span = max(float(np.ptp(q)), 1e-3)
    length = 2 ** int(np.ceil(np.log2(2 * np.pi / (width * min(0.5 * np.pi / span, 0.5)))))
    step = 2 * np.pi / (width * length)
    highest = min(family.highest or test.options.highest_order, np.pi / width)
    orders = np.arange(int(np.ceil(LOWEST_ORDER / step)), int(highest / step))
    return np.rint((q[test.fit.training] - q.min()) / width).astype(int), length, step, orders


def lines(test: ScoreTest) -> list[Line]:
    """The best order of each family, refined, the best family first."""
    best_lines = [line for family in test.problem.periodic if (line := line_of(test, family)) is not None]
    return sorted(best_lines, key=lambda line: -line.gain)


def line_of(test: ScoreTest, family: PeriodicFamily) -> Line | None:
    """The best order of a family, refined; None where no order explains anything."""
    orders, gains = spectrum(test, family)
    if not gains.any():
        return None
    low = orders[orders <= EXACT_BELOW][::2]
    peaks = orders[_peaks(test, family, orders, gains)[:_SCORED_PEAKS]]
    best_order = _best(test, family, np.unique(np.concatenate([low, peaks])))
    order = _refined(test, family, best_order, orders[1] - orders[0])
    return Line(family, order, _gain(test, family, order), float(log_orders_of(family, order, test.options)))


def as_likely(test: ScoreTest, family: PeriodicFamily, order: float, within: float) -> list[tuple[float, float]]:
    """Other orders of a family that explain as much as one of its orders.

    Args:
        test: of the model without the wave of this order.
        family: whose orders.
        order: the one, in waves per turn.
        within: the log-likelihood by which another explains less at most.

    Returns:
        at most `_OTHER_ORDERS` of these, with the log-likelihood by which each explains less, the nearest first and, of
        equals, the lowest; none that the angles do not resolve from the one or from another of them.
    """
    orders, gains = spectrum(test, family)
    if not gains.any():
        return []
    resolved = 2 * np.pi / max(float(np.ptp(family.angle)), 1e-3)
    gain = _gain(test, family, order)
    step = orders[1] - orders[0]
    limit = _OTHER_ORDERS
    alternatives: list[tuple[float, float]] = []
    # what the spectrum says is rounded: the lowest of equals to within one come first, and of twice as many the best
    peaks = _peaks(test, family, orders, gains)
    ranked = sorted(peaks, key=lambda k: (round(max(gain - float(gains[k]), 0.0)), float(orders[k])))
    for peak in orders[ranked]:
        if (
            len(alternatives) == 2 * limit
            or np.abs(np.array([order, *(alternative for _, alternative in alternatives)]) - peak).min() < resolved
        ):
            continue
        alternative = _refined(test, family, float(peak), step)
        # what only rounding separates is the same
        alternatives.append((round(max(gain - _gain(test, family, alternative), 0.0), 6), alternative))
    near = [
        (alternative, gap)
        for gap, alternative in sorted(alternatives)
        if gap < within and abs(alternative - order) >= resolved
    ]
    return near[:limit]


def _peaks(test: ScoreTest, family: PeriodicFamily, orders: Array, gains: Array) -> Integers:
    """Which orders explain more than their neighbours, the likeliest first."""
    around = np.concatenate([[0.0], gains, [0.0]])
    peaks = np.flatnonzero((gains > 0) & (gains >= around[:-2]) & (gains >= around[2:]))
    return peaks[np.argsort(-(gains - log_orders_of(family, orders, test.options))[peaks])]


def _refined(test: ScoreTest, family: PeriodicFamily, order: float, step: float) -> float:
    """The likeliest order within a step of the spectrum."""
    for width in (step, step / 5):
        near = order + width * np.linspace(-1, 1, 9)
        order = _best(test, family, near[near >= LOWEST_ORDER])
    return _best(test, family, np.array([order, max(round(order), 1)]))


def _transform(place: Integers, values: Array, length: int) -> NDArray[np.complexfloating]:
    return np.conj(np.fft.rfft(np.bincount(place, values), length)).astype(complex)


def _best(test: ScoreTest, family: PeriodicFamily, orders: Array) -> float:
    """The likeliest of some orders."""
    gains = _gains(test, family, orders)
    return float(orders[int(np.argmax(gains - log_orders_of(family, orders, test.options)))])


def _gains(test: ScoreTest, family: PeriodicFamily, orders: Array) -> Array:
    """The gains in log-likelihood `(order,)` of orders of a family, exactly."""
    keys = [(family, order) for order in orders.tolist()]
    return test.gains(family.column, family.waves_of(orders), keys)


def _gain(test: ScoreTest, family: PeriodicFamily, order: float) -> float:
    return float(_gains(test, family, np.array([order]))[0])


def _pair_gain(s: Array, c: Array, ss: Array, cc: Array, sc: Array) -> Array:
    determinant = ss * cc - sc**2
    safe = np.where(determinant > 1e-9 * ss * cc, determinant, 1.0)
    gain = 0.5 * (cc * s**2 - 2 * sc * s * c + ss * c**2) / safe
    return np.where(determinant > 1e-9 * ss * cc, gain, 0.0)
