"""Kernels: Gaussian processes of one driver or of two, of low rank, that nonparametric effects are made of.

f(x) = Σ wᵢ φᵢ(x) with independent normal wᵢ is a Gaussian process of the covariance Σ φᵢ(x) φᵢ(y) (C. Rasmussen and
C. Williams, Gaussian Processes for Machine Learning, 2006, 2.2). Every process here has a constant of unit variance
beside its own; a product of two processes therefore contains each of them alone.

Beyond the range of its driver a process is what it is given the same wᵢ: the functions φᵢ go back to those of the
constant over the length of the kernel (the extension of E. Nyström), and what they no longer say of it is `unknown`.
A line goes on, and so does play; waves and spectra are functions of an angle everywhere.

A kernel is one object in `KERNELS`, with all that a search, a prediction and a report ask of it. They look it up by its
name, `kernel_of`; a search tries all that are there.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lite6jax.deferred import JaxArray, jit, jnp, lax
from lite6jax.effects.deflection import library_of
from lite6jax.effects.drivers import Driver
from lite6jax.errors import InputError

Floats = Sequence[float]

PIECES = 24
"""Intervals of the splines in which kernels of a scaled driver are expressed: three to the length of the finest."""
_HIGHEST = 60.0
"""Highest order of a spectrum: above it, coefficients of real gears are noise."""
_PERIOD = 1.25
"""Ranges of the angle in the period of a spectrum's lowest order, at least: errors need not repeat after a turn."""
_REACH = 8.0
"""Half ranges beyond its driver's range from which on a process of a scaled driver keeps its value."""
_OUTER = round(_REACH * PIECES / 2)
"""Intervals to each side of that range."""
_WAVES = np.array([1.0, 2.0, 3.0])
_MULTIPLES = np.arange(1.0, 9.0)
"""Of the order of what repeats: of a sawtooth's variance 7 % are above them."""
_PLAYS = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7])
"""Half-widths of play operators over half the range of their driver."""
_FASTEST = 96
"""Highest order of what wanders, in half-waves over a recording: with the rest of the samples' noise beside it, what
is faster is hardly told from that noise."""
_CORNERS = 30.0
"""Orders that are kept, over the corner: 98 % of the variance of an autoregression."""


@dataclass(frozen=True, eq=False)
class Kernel(ABC):
    """A Gaussian process of one driver or of two: its functions, and what a search has to know of it.

    Attributes:
        name: by which documents know it; of two drivers the kernels of each, joined by `*`.
        formula: its covariance of a driver u that is scaled to [-1, 1], or of an angle x.
        describes: what it is for.
        partners: kernels with which a search tries its products, each of the two first.
        drivers: how many it depends on.
        prior: which of the kinds of a `Prior` it is.
        numbers: what the numbers of its `rolloff` mean.
        grid: values of these that a search tries; but an order and a place are searched.
        count: how many features it has, where neither driver nor numbers say so.
        scaled: whether splines of its driver express it, by `root`.
        joins: whether it may be a factor of a product.
        goes_on: whether its functions say all of it beyond the range of its driver too.
        any_order: whether the first of its numbers is the order of a wave, which need not be whole.
        any_sample: whether the first of its numbers is a value, at any sample, from which on it is.
        varies_fast: whether a search weighs it exactly at once in autocorrelated noise.
        takes_driver: whether another driver may join its own, in one process of both.
        hysteretic: whether it depends on the way to a value of its driver.
        undriven: whether it is what wanders by itself, so that its driver is the order of recording.
        of_gear: whether it is the errors of a gear, which do not depend on loads or postures.
        apart: whether names and processes at its site are distinguishable from it.
    """

    name: str
    formula: str
    describes: str
    partners: tuple[str, ...] = ()

    drivers = 1
    prior = "process"
    numbers: ClassVar[tuple[str, ...]] = ()
    grid: ClassVar[tuple[tuple[float, ...], ...]] = ((),)
    count = 0
    scaled = False
    joins = False
    goes_on = True
    any_order = False
    any_sample = False
    varies_fast = False
    takes_driver = True
    hysteretic = False
    undriven = False
    of_gear = False
    apart = False

    @property
    def factors(self) -> "tuple[Kernel, ...]":
        """The kernels of each driver."""
        return (self,)

    @property
    def root(self) -> NDArray:
        """`(spline, feature)`, by which the splines of a scaled driver become its features."""
        raise NotImplementedError(f"{self.name} is no kernel of a scaled driver")

    @cached_property
    def factor(self) -> "Kernel | None":
        """The kernel as a factor of a product, where its rank may be lower; None where it is none."""
        return self if self.joins else None

    @abstractmethod
    def features(self, values: JaxArray, bounds: Floats, run: JaxArray | None = None, rolloff: Floats = ()) -> JaxArray:
        """The functions φ `(feature, sample)`. Of NumPy values on the host.

        Args:
            values: `(driver, sample)`.
            bounds: lower and upper of each driver, in its unit.
            run: `(2, sample)`, where runs begin and end, which plays require; one run where not given.
            rolloff: its `numbers`; usual ones where not given.
        """

    def size(self, bounds: Floats, rolloff: Floats = ()) -> int:
        """How many features it has."""
        return self.count

    def unknown(self, values: JaxArray, bounds: Floats) -> JaxArray:
        """The variance `(sample,)` of the process, for coefficients of unit variance, that its features do not have.

        Within the bounds it is zero. Of NumPy values on the host; arguments as of `features`.
        """
        xp = library_of(values)
        if all(factor.goes_on for factor in self.factors):
            return xp.zeros(values.shape[-1])
        process_variance = 1.0
        feature_variance = 1.0
        for k, factor in enumerate(self.factors):
            ends = bounds[2 * k : 2 * k + 2]
            row = values[k : k + 1]
            inside = row if factor.goes_on else xp.clip(row, *ends)
            process_variance = process_variance * xp.sum(factor.features(inside, ends) ** 2, 0)
            feature_variance = feature_variance * xp.sum(factor.features(row, ends) ** 2, 0)
        return xp.maximum(process_variance - feature_variance, 0.0)  # type: ignore[return-value]

    def deviations(self, bounds: Floats, rolloff: Floats) -> NDArray:
        """`(feature,)`, the prior's standard deviation of each coefficient over the spread."""
        return np.ones(self.size(bounds, rolloff))

    def orders(self, bounds: Floats, rolloff: Floats = ()) -> NDArray:
        """`(order,)`, the orders of a spectrum or of what repeats, the highest last; none of other kernels."""
        return np.zeros(0)

    def suits(self, driver: Driver, discrete: bool) -> bool:
        """Tells whether it may be a kernel of a driver, which may be `discrete`: of few values."""
        return not driver.is_order and not discrete

    def hides(self, other: "Kernel") -> bool:
        """Tells whether another process at its site cannot be told apart from it, so that it is not added beside it."""
        return not other.apart and not other.of_gear

    def fault(self, bounds: Floats, rolloff: Floats) -> str:
        """What is wrong with these numbers; empty where they are possible."""
        return _no_spectrum(rolloff) if rolloff else ""


def _no_spectrum(rolloff: Floats) -> str:
    return f"rolloff {rolloff} is not possible; give corner and slope of a spectrum"


# ------------------------------------------------------------------ of a scaled driver


class _Line(Kernel):
    count = 2
    scaled = True
    joins = True

    @property
    def root(self) -> NDArray:
        centres = _centres(0)
        return np.stack([np.ones_like(centres), centres], 1)  # splines with these coefficients add up to the line

    def features(self, values: JaxArray, bounds: Floats, run: JaxArray | None = None, rolloff: Floats = ()) -> JaxArray:
        scaled = _scaled(values[0], bounds)
        return library_of(values).stack([library_of(values).ones_like(scaled), scaled])

    def suits(self, driver: Driver, discrete: bool) -> bool:
        return not driver.is_order


@dataclass(frozen=True, eq=False, kw_only=True)
class _Curve(Kernel):
    """A stationary covariance.

    Attributes:
        of_distance: the covariance of two values by their distance.
        rank: of its features, the constant not counted.
        rank_in_product: the same where it is a factor.
    """

    of_distance: Callable[[NDArray], NDArray]
    rank: int
    rank_in_product: int

    scaled = True
    goes_on = False

    @cached_property
    def factor(self) -> "Kernel | None":
        return replace(self, rank=self.rank_in_product)

    @property
    def root(self) -> NDArray:
        return self._table[_OUTER : _OUTER + PIECES + 3]

    @cached_property
    def _table(self) -> NDArray:
        """As `root`, with the splines from `_REACH` half ranges before the range of the driver to as many beyond.

        The coefficients of the splines are the process at their centres. Features are the largest principal components
        of the process over an even grid of the range, and what they say of its values elsewhere.
        """
        inner = _centres(0)
        covariance = self.of_distance(np.abs(_centres(_OUTER)[:, None] - inner)) + 1.0
        grid = spline_basis(np.linspace(-1, 1, 20 * PIECES), -1.0, 1.0).T  # type: ignore[arg-type]
        eigenvalues, V = np.linalg.eigh(covariance[_OUTER : _OUTER + PIECES + 3])
        U, S, _ = np.linalg.svd(grid @ (V * np.sqrt(np.maximum(eigenvalues, 0.0))), full_matrices=False)
        rank = self.rank + 1
        return covariance @ grid.T @ U[:, :rank] / S[:rank]

    def features(self, values: JaxArray, bounds: Floats, run: JaxArray | None = None, rolloff: Floats = ()) -> JaxArray:
        xp = library_of(values)
        u = xp.clip((_scaled(values[0], bounds) + 1) * (PIECES / 2) + _OUTER, 0.0, PIECES + 2.0 * _OUTER)
        first = xp.clip(xp.floor(u), 0, PIECES + 2 * _OUTER - 1).astype(int)
        t = u - first
        # the four cubic B-splines that are not zero there
        weights = (1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3
        columns = xp.asarray(self._table.T / 6)
        return sum(columns[:, first + k] * weight for k, weight in enumerate(weights))  # type: ignore[return-value]

    def size(self, bounds: Floats, rolloff: Floats = ()) -> int:
        return self.rank + 1


def _scaled(values: JaxArray, bounds: Floats) -> JaxArray:
    lower, upper = bounds
    return 2 * (values - lower) / (upper - lower) - 1


def _centres(outer: int) -> NDArray:
    """Centres of the splines on the range, and on so many intervals to each side of it."""
    return np.arange(-outer - 1, PIECES + outer + 2) * (2 / PIECES) - 1


def _squared_exponential(length: float, variance: float = 1.0) -> Callable[[NDArray], NDArray]:
    return lambda d: variance * np.exp(-0.5 * (d / length) ** 2)


def spline_basis(values: JaxArray, lower: float, upper: float, pieces: int = PIECES) -> JaxArray:
    """The cubic B-splines on `pieces` equal intervals from `lower` to `upper`, `(pieces + 3, sample)`.

    They add up to 1; before `lower` and beyond `upper` they keep their values there. Of NumPy values on the host.
    """
    xp = library_of(values)
    u = xp.clip((values - lower) / (upper - lower), 0.0, 1.0) * pieces
    t = xp.abs(u - np.arange(-1.0, pieces + 2.0)[:, None])
    near = xp.maximum(1 - t, 0.0)
    far = xp.maximum(2 - t, 0.0)
    return (far**3 - 4 * near**3) / 6  # the fourth difference of cubes (C. de Boor, A Practical Guide to Splines, IX)


# ------------------------------------------------------------------ of an angle


class _Waves(Kernel):
    count = 1 + 2 * len(_WAVES)
    joins = True

    def features(self, values: JaxArray, bounds: Floats, run: JaxArray | None = None, rolloff: Floats = ()) -> JaxArray:
        xp = library_of(values)
        turned = _WAVES[:, None] * values[0]
        over = _WAVES[:, None]
        return xp.concatenate([xp.ones_like(turned[:1]), xp.sin(turned) / over, xp.cos(turned) / over])

    def suits(self, driver: Driver, discrete: bool) -> bool:
        return super().suits(driver, discrete) and driver.is_angle


class _Sine(Kernel):
    """The factor of a modulated wave; alone it is a wave with a name."""

    count = 2
    any_order = True

    def features(self, values: JaxArray, bounds: Floats, run: JaxArray | None = None, rolloff: Floats = ()) -> JaxArray:
        xp = library_of(values)
        (order,) = rolloff or (1.0,)
        return xp.stack([xp.sin(order * values[0]), xp.cos(order * values[0])])

    def suits(self, driver: Driver, discrete: bool) -> bool:
        return bool(driver.turns)


class _Orders(Kernel):
    """Waves of many orders, of less variance the higher their order is."""

    varies_fast = True
    takes_driver = False

    def features(self, values: JaxArray, bounds: Floats, run: JaxArray | None = None, rolloff: Floats = ()) -> JaxArray:
        return self.waves(values[0], bounds, rolloff) * self.deviations(bounds, rolloff)[:, None]

    @abstractmethod
    def waves(self, values: JaxArray, bounds: Floats, rolloff: Floats) -> JaxArray:
        """The same of unit variance."""

    def suits(self, driver: Driver, discrete: bool) -> bool:
        return bool(driver.turns)

    def fault(self, bounds: Floats, rolloff: Floats) -> str:
        return _no_spectrum(rolloff) if rolloff and (len(rolloff) != 2 or rolloff[0] <= 0) else ""


class _Spectrum(_Orders):
    """Waves of order k with the variance spread² / (1 + (k / c)ˢ), of a corner c and a slope s; else spread²."""

    numbers = ("corner", "slope")
    grid = tuple(product((3.0, 8.0, 20.0), (2.0, 4.0)))
    of_gear = True

    def waves(self, values: JaxArray, bounds: Floats, rolloff: Floats) -> JaxArray:
        xp = library_of(values)
        turned = self.orders(bounds)[:, None] * values
        return xp.stack([xp.sin(turned), xp.cos(turned)], 1).reshape(2 * len(turned), -1)

    def size(self, bounds: Floats, rolloff: Floats = ()) -> int:
        return 2 * len(self.orders(bounds))

    def deviations(self, bounds: Floats, rolloff: Floats) -> NDArray:
        """Deviations of sine and cosine of each order: 1 at low ones; 1 of all without a corner."""
        orders = self.orders(bounds)
        corner, slope = rolloff or (1.0, 0.0)
        return np.repeat((1 + (orders / corner) ** slope) ** -0.5 if rolloff else np.ones_like(orders), 2)

    def orders(self, bounds: Floats, rolloff: Floats = ()) -> NDArray:
        """Whole ones; so fine that the range of an angle that turns far is within one period."""
        lowest = float(np.clip(2 * np.pi / (_PERIOD * max(bounds[1] - bounds[0], 1e-3)), 0.25, 1.0))
        return lowest * np.arange(1, int(_HIGHEST / lowest) + 1)

    def hides(self, other: Kernel) -> bool:
        return other.of_gear


class _Repeat(_Orders):
    """Waves of the orders k n with the variance spread² / kˢ, of an order n and a slope s; 1 and 2 where not given."""

    count = 2 * len(_MULTIPLES)
    prior = "repeating"
    numbers = ("order", "slope")
    grid = ((2.0,), (4.0,))
    """Slopes: of a sawtooth, and of a triangle."""
    any_order = True
    apart = True

    def waves(self, values: JaxArray, bounds: Floats, rolloff: Floats) -> JaxArray:
        xp = library_of(values)
        turned = self.orders(bounds, rolloff)[:, None] * values
        return xp.concatenate([xp.sin(turned), xp.cos(turned)])

    def deviations(self, bounds: Floats, rolloff: Floats) -> NDArray:
        _, slope = rolloff or (1.0, 2.0)
        return np.tile(_MULTIPLES ** (-0.5 * slope), 2)

    def orders(self, bounds: Floats, rolloff: Floats = ()) -> NDArray:
        order, _ = rolloff or (1.0, 2.0)
        return order * _MULTIPLES

    def hides(self, other: Kernel) -> bool:
        return other.of_gear or other is self


class _Wander(_Orders):
    """A first-order autoregression of unit variance.

    With the memory m in a recording of length T it has the spectrum 1 / (1 + (k / c)²) of its half-waves k > 0,
    c = T / (π m). Its mean over the recording has the variance 2μ (1 − μ (1 − exp(−1/μ))), μ = m / T. Corners are
    half-waves over the recording: memories of 1.3 recordings, of a half, a fifth, a 13th, a 31st and a 75th of one.
    In another recording, whose order is beyond the bounds, it is zero, and as unknown as before any data.
    """

    prior = "wandering"
    numbers = ("corner", "slope")
    grid = tuple(product((0.25, 0.64, 1.6, 4.0, 10.0, 24.0), (2.0,)))
    undriven = True
    apart = True

    def waves(self, values: JaxArray, bounds: Floats, rolloff: Floats) -> JaxArray:
        xp = library_of(values)
        place = (values - bounds[0]) / (bounds[1] - bounds[0])
        waves = xp.cos(np.pi * np.arange(self.size(bounds, rolloff))[:, None] * place)
        return xp.where((place >= 0) & (place <= 1), waves, 0.0)

    def unknown(self, values: JaxArray, bounds: Floats) -> JaxArray:
        xp = library_of(values)
        return xp.where((values[0] >= bounds[0]) & (values[0] <= bounds[1]), 0.0, 1.0)

    def size(self, bounds: Floats, rolloff: Floats = ()) -> int:
        return 1 + (min(int(np.ceil(_CORNERS * rolloff[0])), _FASTEST) if rolloff else _FASTEST)

    def deviations(self, bounds: Floats, rolloff: Floats) -> NDArray:
        """Deviations of each order; 1 of all without a corner."""
        orders = np.arange(self.size(bounds, rolloff))
        if not rolloff:
            return np.ones(len(orders))
        corner, slope = rolloff
        variance = 4 / (np.pi * corner) / (1 + (orders / corner) ** slope)
        memory = 1 / (np.pi * corner)
        variance[0] = 2 * memory * (1 - memory * -np.expm1(-1 / memory))
        return np.sqrt(variance)

    def suits(self, driver: Driver, discrete: bool) -> bool:
        return driver.is_order

    def hides(self, other: Kernel) -> bool:
        return other.undriven


# ------------------------------------------------------------------ jumps and hysteresis


class _Jump(Kernel):
    """A constant, and what is there from a value on; from the middle of its range on where that is not given."""

    count = 2
    prior = "jump"
    numbers = ("value",)
    any_sample = True

    def features(self, values: JaxArray, bounds: Floats, run: JaxArray | None = None, rolloff: Floats = ()) -> JaxArray:
        xp = library_of(values)
        (at,) = rolloff or (0.5 * (bounds[0] + bounds[1]),)
        return xp.concatenate([xp.ones_like(values), xp.where(values >= at, 1.0, 0.0)])

    def suits(self, driver: Driver, discrete: bool) -> bool:
        return driver.is_time

    def fault(self, bounds: Floats, rolloff: Floats) -> str:
        if len(rolloff) == 1 and bounds[0] < rolloff[0] <= bounds[1]:
            return ""
        return f"a step is not possible at {rolloff}; give one value within its range"


class _Plays(Kernel):
    count = len(_PLAYS) + 2
    hysteretic = True

    def features(self, values: JaxArray, bounds: Floats, run: JaxArray | None = None, rolloff: Floats = ()) -> JaxArray:
        xp = library_of(values)
        half = 0.5 * (bounds[1] - bounds[0])
        count = values.shape[-1]
        single_run = np.stack([np.zeros(count, int), np.full(count, count - 1)])
        centred = values[0] - 0.5 * (bounds[0] + bounds[1])
        behind = plays(
            jnp.asarray(centred), jnp.asarray(_PLAYS * half), jnp.asarray(single_run if run is None else run)
        )
        behind = np.asarray(behind) if xp is np else behind
        # a spring that slips at the end of its play, from -1 to 1: friction and lost motion are sums of such
        slipping = (centred - behind) / (_PLAYS * half)[:, None]
        return xp.concatenate([xp.ones_like(centred)[None], centred[None] / half, slipping])

    def suits(self, driver: Driver, discrete: bool) -> bool:
        return super().suits(driver, discrete) and driver.is_remembered


@jit
def plays(values: JaxArray, widths: JaxArray, run: JaxArray) -> JaxArray:
    """What follows a driver with play, `(width, sample)`: pushed along, and left behind by `width` at most.

    Sums of such plays are all hysteresis whose loops close and do not depend on speed (I. Mayergoyz, Mathematical
    Models of Hysteresis, 1991, ch. 1; of L. Prandtl and A. Ishlinskii). Each run begins at 0, as nearly as it can.

    Args:
        values: `(sample,)`, of the driver.
        widths: `(width,)` in its unit, from 0.
        run: `(2, sample)`, the first and the last sample of the run of each.
    """

    def pushed(follower: JaxArray, now: tuple[JaxArray, JaxArray]) -> tuple[JaxArray, JaxArray]:
        value, begins = now
        follower = jnp.clip(jnp.where(begins, 0.0, follower), value - widths, value + widths)
        return follower, follower

    begins = run[0] == jnp.arange(run.shape[1])
    return lax.scan(pushed, jnp.zeros_like(widths), (values, begins))[1].T


# ------------------------------------------------------------------ of two drivers


@dataclass(frozen=True, eq=False)
class _Product(Kernel):
    both: tuple[Kernel, ...] = ()

    drivers = 2
    prior = "product"

    @property
    def factors(self) -> tuple[Kernel, ...]:
        return self.both

    def features(self, values: JaxArray, bounds: Floats, run: JaxArray | None = None, rolloff: Floats = ()) -> JaxArray:
        first, second = (
            factor.features(values[k : k + 1], bounds[2 * k : 2 * k + 2], run, rolloff)
            for k, factor in enumerate(self.both)
        )
        return (first[:, None] * second[None]).reshape(-1, first.shape[-1])

    def size(self, bounds: Floats, rolloff: Floats = ()) -> int:
        first, second = (factor.size(bounds[2 * k : 2 * k + 2], rolloff) for k, factor in enumerate(self.both))
        return first * second


class _Modulated(_Product):
    """A sine of an order, which is 1 where not given, whose size is a constant and follows a line."""

    prior = "modulated"
    numbers = ("order",)
    any_order = True
    varies_fast = True

    def fault(self, bounds: Floats, rolloff: Floats) -> str:
        if len(rolloff) == 1 and rolloff[0] > 0:
            return ""
        return f"a sine of order {rolloff} is not possible; give one positive order"


# ------------------------------------------------------------------ the table

_LINE = _Line("line", "u v", "what is in proportion", ("line", "smooth", "medium", "fine", "rough", "wave"))
_SINE = _Sine(
    "sine",
    "cos(n (x - y)), of an angle x, n any order; beside a line alone",
    "a wave whose size follows another driver",
)
KERNELS: dict[str, Kernel] = {
    kernel.name: kernel
    for kernel in (
        _LINE,
        _Curve("cubic", "4 exp(-d² / 8)", "what is nearly a cubic", ("cubic", "wave"),
               of_distance=_squared_exponential(2.0, 4.0), rank=6, rank_in_product=3),
        _Curve("smooth", "exp(-d² / 2 l²), l = 0.7", "curves", ("smooth",),
               of_distance=_squared_exponential(0.7), rank=10, rank_in_product=5),
        _Curve("medium", "the same, l = 0.3", "finer ones",
               of_distance=_squared_exponential(0.3), rank=14, rank_in_product=10),
        _Curve("fine", "the same, l = 0.13", "the finest",
               of_distance=_squared_exponential(0.13), rank=26, rank_in_product=16),
        _Curve("rough", "exp(-d)", "steps and kinks", ("rough",),
               of_distance=lambda d: np.exp(-d), rank=18, rank_in_product=8),
        _Waves("wave", "Σ cos(k (x - y)) / k², k = 1, 2, 3, of an angle x", "what repeats after a turn", ("wave",)),
        _Spectrum("spectrum", "Σ cos(k (x - y)) / (1 + (k / c)ˢ), k to 60", "the errors of a gear"),
        _Repeat("repeat", "Σ cos(k n (x - y)) / kˢ, k = 1 to 8, of an angle x, n any order",
                "what repeats with any period and is no sine: a sawtooth, a ratchet"),
        _Plays("play", "line, and Σ of what play operators of seven widths lag behind, over the width", "hysteresis"),
        _Wander("wander", "nearly exp(-d / m) of the order of recording: Σ cos(π k s) cos(π k t) / (1 + (k / c)²), "
                "c = 1 / (π m)", "what wanders by itself, a first-order autoregression"),
        _Jump("step", "1 from a value of u on, else 0", "a jump"),
    )
}  # fmt: skip
"""All kernels of one driver by their names."""
MODULATED: tuple[Kernel, Kernel] = (
    _Modulated("sine*line", _SINE.formula, _SINE.describes, both=(_SINE, _LINE)),
    _Modulated("line*sine", _SINE.formula, _SINE.describes, both=(_LINE, _SINE)),
)
"""Waves of any order of the first and of the second of two drivers, whose size follows the other."""
SCALED = tuple(name for name, kernel in KERNELS.items() if kernel.scaled)
SINGLE = tuple(name for name, kernel in KERNELS.items() if not kernel.numbers)
"""Kernels of one driver that have no numbers."""
PAIRS = (
    *(f"{name}*{name}" for name, kernel in KERNELS.items() if name in kernel.partners),
    *(
        f"{first}*{second}"
        for name, kernel in KERNELS.items()
        for partner in kernel.partners
        if partner != name
        for first, second in ((name, partner), (partner, name))
    ),
)
"""Kernels of two drivers that are tried."""
__doc__ = "\n".join([
    f"{__doc__}\n| kernel | covariance of a driver u that is scaled to [-1, 1] | describes |\n|---|---|---|",
    *(f"| {kernel.name} | {kernel.formula} | {kernel.describes} |" for kernel in (*KERNELS.values(), _SINE)),
])  # fmt: skip


@lru_cache(maxsize=1024)
def _kernel(name: str) -> Kernel | None:
    by_name = KERNELS | {kernel.name: kernel for kernel in MODULATED}
    if name in by_name:
        return by_name[name]
    factors = [KERNELS[part].factor if part in KERNELS else None for part in name.split("*")]
    both = tuple(factor for factor in factors if factor is not None)
    return _Product(name, "", "", both=both) if len(both) == len(factors) == 2 else None


def kernel_of(name: str) -> Kernel:
    """The kernel of this name: one of `KERNELS`, or two that are joined by `*`, such as smooth*line.

    Raises:
        InputError: no kernel has this name.
    """
    kernel = _kernel(name)
    if kernel is None:
        raise InputError(f"no kernel is called {name!r}; give one of {', '.join(KERNELS)}, or two that are joined by *")
    return kernel


def memory_of(rolloff: Floats) -> float:
    """The memory of what wanders by itself, over the length of the recording."""
    corner, _ = rolloff
    return 1 / (np.pi * corner)


LEAST_MEMORY = 3.0
"""Samples after which what wanders is still like itself, by e⁻¹: what forgets sooner is independent noise."""


def remembers(rolloff: Floats, samples: int) -> bool:
    """Tells whether what wanders by itself remembers more than a few of so many samples."""
    return memory_of(rolloff) * samples >= LEAST_MEMORY


def is_kernel(name: str, drivers: int) -> bool:
    """Tells whether a kernel of so many drivers has this name."""
    kernel = _kernel(name)
    return kernel is not None and kernel.drivers == drivers
