"""Kernels: Gaussian processes of one driver or of two, of low rank, that nonparametric effects are made of.

f(x) = Σ wᵢ φᵢ(x) with independent normal wᵢ is a Gaussian process of the covariance Σ φᵢ(x) φᵢ(y) (C. Rasmussen and
C. Williams, Gaussian Processes for Machine Learning, 2006, 2.2). Every process here has a constant of unit variance
beside its own; a product of two processes therefore contains each of them alone.

Beyond the range of its driver a process is what it is given the same wᵢ: the functions φᵢ go back to those of the
constant over the length of the kernel (the extension of E. Nyström), and what they no longer say of it is `unknown`.
A line goes on, and so does play; waves and spectra are functions of an angle everywhere.

| kernel | covariance of a driver u that is scaled to [-1, 1] | describes |
|---|---|---|
| line | u v | what is in proportion |
| cubic | 4 exp(-d² / 8) | what is nearly a cubic |
| smooth, medium, fine | exp(-d² / 2 l²), l = 0.7, 0.3, 0.13 | curves, one finer than the other |
| rough | exp(-d) | steps and kinks |
| wave | Σ cos(k (x - y)) / k², k = 1, 2, 3, of an angle x | what repeats after a turn |
| spectrum | Σ cos(k (x - y)) / (1 + (k / c)ˢ), k to 60 | the errors of a gear |
| sine | cos(n (x - y)), of an angle x, n any order; beside a line alone | a wave whose size follows another driver |
| repeat | Σ cos(k n (x - y)) / kˢ, k = 1 to 8, of an angle x, n any order | what repeats with any period and is no
sine: a sawtooth, a ratchet |
| wander | nearly exp(-d / m) of the order of recording: Σ cos(π k s) cos(π k t) / (1 + (k / c)²), c = 1 / (π m) | what
wanders by itself, a first-order autoregression |
| step | 1 from a value of u on, else 0 | a jump |
| play | line, and Σ of what play operators of seven widths lag behind, over the width | hysteresis |
"""

from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.deferred import Array, jit, jnp, lax
from lite6jax.effects.deflection import library_of

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


class Kernel(NamedTuple):
    """A kernel of a scaled driver.

    Attributes:
        covariance: of two values and their distance.
        rank: of its features, the constant not counted.
        rank_in_product: the same where it is a factor.
    """

    covariance: Callable[[NDArray, NDArray, NDArray], NDArray]
    rank: int
    rank_in_product: int


def _squared_exponential(length: float, variance: float = 1.0) -> Callable[[NDArray, NDArray, NDArray], NDArray]:
    return lambda u, v, d: variance * np.exp(-0.5 * (d / length) ** 2)


SCALED: dict[str, Kernel] = {
    "line": Kernel(lambda u, v, d: u * v, 1, 1),
    "cubic": Kernel(_squared_exponential(2.0, 4.0), 6, 3),
    "smooth": Kernel(_squared_exponential(0.7), 10, 5),
    "medium": Kernel(_squared_exponential(0.3), 14, 10),
    "fine": Kernel(_squared_exponential(0.13), 26, 16),
    "rough": Kernel(lambda u, v, d: np.exp(-d), 18, 8),
}
OF_ANGLES = ("wave", "spectrum", "repeat")
MODULATED = ("sine*line", "line*sine")
"""Kernels of a wave of any order whose size follows another driver."""
AT_ANY_ORDER = ("repeat", *MODULATED)
"""Kernels of an angle whose order is no whole number, and is searched."""
KERNELS = (*SCALED, *OF_ANGLES, "play", "wander", "step")
_FASTEST = 96
"""Highest order of what wanders, in half-waves over a recording: with the rest of the samples' noise beside it, what
is faster is hardly told from that noise."""
_CORNERS = 30.0
"""Orders that are kept, over the corner: 98 % of the variance of an autoregression."""


def factors_of(kernel: str) -> list[str]:
    """The kernels of each driver: one, or two that are joined by `*`."""
    return kernel.split("*")


def is_kernel(kernel: str, drivers: int) -> bool:
    """Whether a kernel of so many drivers has this name; spectra and plays are of one driver."""
    factors = factors_of(kernel)
    is_known = set(factors) <= set(KERNELS) and (len(factors) == 1 or set(factors) <= {*SCALED, "wave"})
    return (is_known or kernel in MODULATED) and len(factors) == drivers


def features(
    kernel: str, values: Array, bounds: Sequence[float], run: Array | None = None, rolloff: Sequence[float] = ()
) -> Array:
    """The functions φ `(feature, sample)` of a kernel. Of NumPy values on the host.

    Args:
        kernel: its name.
        values: `(driver, sample)`.
        bounds: lower and upper of each driver, in its unit.
        run: `(2, sample)`, where runs begin and end, which plays require; one run where not given.
        rolloff: of a spectrum, the corner c and the slope s; without them its features are of unit variance. Of what
            repeats, the order n and the slope s; 1 and 2 where not given. Of a sine its order n, else 1. Of a step,
            the value from which on it is; the middle of its range where not given.
    """
    xp = library_of(values)
    names = factors_of(kernel)
    if kernel == "play":
        return _play_features(values[0], bounds, run)
    if kernel == "spectrum":
        turned = orders_of(bounds)[:, None] * values[0]
        waves = xp.stack([xp.sin(turned), xp.cos(turned)], 1).reshape(2 * len(turned), -1)
        return waves * spectrum_deviations(bounds, rolloff)[:, None]
    if kernel == "repeat":
        order, slope = rolloff or (1.0, 2.0)
        turned = order * _MULTIPLES[:, None] * values[0]
        waves = xp.concatenate([xp.sin(turned), xp.cos(turned)])
        return waves * deviations(kernel, bounds, (order, slope))[:, None]
    if kernel == "wander":
        size = wander_deviations(rolloff)
        place = (values[0] - bounds[0]) / (bounds[1] - bounds[0])
        return xp.cos(np.pi * np.arange(len(size))[:, None] * place) * size[:, None]
    if kernel == "step":
        (at,) = rolloff or (0.5 * (bounds[0] + bounds[1]),)
        return xp.concatenate([xp.ones_like(values), xp.where(values >= at, 1.0, 0.0)])
    by_factor = _factors(names, values, bounds, rolloff)
    if len(by_factor) == 1:
        return by_factor[0]
    return (by_factor[0][:, None] * by_factor[1][None]).reshape(-1, by_factor[0].shape[-1])


def unknown(kernel: str, values: Array, bounds: Sequence[float]) -> Array:
    """The variance `(sample,)` of a process, for coefficients of unit variance, that its features do not have.

    Within the bounds it is zero. Of NumPy values on the host; arguments as of `features`.
    """
    xp = library_of(values)
    names = factors_of(kernel)
    if not set(names) & set(SCALED) - {"line"}:
        return xp.zeros(values.shape[-1])
    inside = xp.stack([
        xp.clip(values[k], bounds[2 * k], bounds[2 * k + 1]) if name in SCALED and name != "line" else values[k]
        for k, name in enumerate(names)
    ])  # fmt: skip
    process_variance = 1.0
    feature_variance = 1.0
    for of_process, of_features in zip(_factors(names, inside, bounds), _factors(names, values, bounds), strict=True):
        process_variance = process_variance * xp.sum(of_process**2, 0)
        feature_variance = feature_variance * xp.sum(of_features**2, 0)
    return xp.maximum(process_variance - feature_variance, 0.0)  # type: ignore[return-value]


@lru_cache(maxsize=4096)
def size_of(kernel: str, bounds: tuple[float, ...], rolloff: tuple[float, ...] = ()) -> int:
    """How many features a kernel has."""
    if kernel == "wander":
        return len(wander_deviations(rolloff))
    if kernel == "step":
        return 2
    if kernel == "repeat":
        return 2 * len(_MULTIPLES)
    if kernel == "play":
        return len(_PLAYS) + 2
    if kernel == "spectrum":
        return 2 * len(orders_of(bounds))
    names = factors_of(kernel)
    of_angle = {"wave": 7, "sine": 2}
    sizes = [of_angle.get(name) or root(name, len(names) > 1).shape[1] for name in names]
    return int(np.prod(sizes))


def orders_of(bounds: Sequence[float]) -> NDArray:
    """The orders of a spectrum: whole ones; so fine that the range of an angle that turns far is within one period."""
    lowest = float(np.clip(2 * np.pi / (_PERIOD * max(bounds[1] - bounds[0], 1e-3)), 0.25, 1.0))
    return lowest * np.arange(1, int(_HIGHEST / lowest) + 1)


def highest_order(kernel: str, bounds: Sequence[float], rolloff: Sequence[float]) -> float:
    """The highest order of a spectrum, or of what repeats; 0 of other kernels."""
    if kernel == "spectrum":
        return float(orders_of(bounds)[-1])
    if kernel == "repeat":
        return float((rolloff or (1.0,))[0] * _MULTIPLES[-1])
    return 0.0


def spectrum_deviations(bounds: Sequence[float], rolloff: Sequence[float]) -> NDArray:
    """`(feature,)`, the prior's standard deviation of sine and cosine of each order: 1 at low ones."""
    orders = orders_of(bounds)
    corner, slope = rolloff or (1.0, 0.0)
    return np.repeat((1 + (orders / corner) ** slope) ** -0.5 if rolloff else np.ones_like(orders), 2)


def deviations(kernel: str, bounds: Sequence[float], rolloff: Sequence[float]) -> NDArray:
    """`(feature,)`, the prior's standard deviation of each order of a spectrum, of what repeats, or of what wanders."""
    if kernel == "repeat":
        return np.tile(_MULTIPLES ** (-0.5 * rolloff[1]), 2)
    return spectrum_deviations(bounds, rolloff) if kernel == "spectrum" else wander_deviations(rolloff)


def wander_deviations(rolloff: Sequence[float]) -> NDArray:
    """`(order,)`, the prior's standard deviation of each order of what wanders with unit variance; 1 without a corner.

    A first-order autoregression of memory m in a recording of length T has the spectrum 1 / (1 + (k / c)²) of its
    half-waves k, c = T / (π m).

    Args:
        rolloff: corner c and slope 2; empty for orders of unit variance.
    """
    if not rolloff:
        return np.ones(_FASTEST + 1)
    corner, slope = rolloff
    highest = min(int(np.ceil(_CORNERS * corner)), _FASTEST)
    variance = 4 / (np.pi * corner) / (1 + (np.arange(highest + 1) / corner) ** slope)
    variance[0] /= 2
    return np.sqrt(variance)


@cache
def root(name: str, in_product: bool = False) -> NDArray:
    """`(spline, feature)`, by which the splines of a scaled driver become the features of a kernel."""
    return _table(name, in_product)[_OUTER : _OUTER + PIECES + 3]


@cache
def _table(name: str, in_product: bool) -> NDArray:
    """As `root`, with the splines from `_REACH` half ranges before the range of the driver to as many beyond.

    The coefficients of the splines are the process at their centres. Features are the largest principal components of
    the process over an even grid of the range, and what they say of its values elsewhere.
    """
    kernel = SCALED[name]
    centres = np.arange(-_OUTER - 1, PIECES + _OUTER + 2) * (2 / PIECES) - 1
    if name == "line":
        return np.stack([np.ones_like(centres), centres], 1)  # splines with these coefficients add up to the line
    inner = centres[_OUTER : _OUTER + PIECES + 3]
    covariance = kernel.covariance(centres[:, None], inner, np.abs(centres[:, None] - inner)) + 1.0
    grid = spline_basis(np.linspace(-1, 1, 20 * PIECES), -1.0, 1.0).T  # type: ignore[arg-type]
    eigenvalues, V = np.linalg.eigh(covariance[_OUTER : _OUTER + PIECES + 3])
    U, S, _ = np.linalg.svd(grid @ (V * np.sqrt(np.maximum(eigenvalues, 0.0))), full_matrices=False)
    rank = (kernel.rank_in_product if in_product else kernel.rank) + 1
    return covariance @ grid.T @ U[:, :rank] / S[:rank]


def spline_basis(values: Array, lower: float, upper: float, pieces: int = PIECES) -> Array:
    """The cubic B-splines on `pieces` equal intervals from `lower` to `upper`, `(pieces + 3, sample)`.

    They add up to 1; before `lower` and beyond `upper` they keep their values there. Of NumPy values on the host.
    """
    xp = library_of(values)
    u = xp.clip((values - lower) / (upper - lower), 0.0, 1.0) * pieces
    t = xp.abs(u - np.arange(-1.0, pieces + 2.0)[:, None])
    near = xp.maximum(1 - t, 0.0)
    far = xp.maximum(2 - t, 0.0)
    return (far**3 - 4 * near**3) / 6  # the fourth difference of cubes (C. de Boor, A Practical Guide to Splines, IX)


def _factors(
    names: Sequence[str], values: Array, bounds: Sequence[float], rolloff: Sequence[float] = ()
) -> list[Array]:
    """The features `(feature, sample)` of each factor at values `(driver, sample)`."""
    return [
        _factor(name, values[k], bounds[2 * k], bounds[2 * k + 1], len(names) > 1, rolloff)
        for k, name in enumerate(names)
    ]


def _factor(
    name: str, values: Array, lower: float, upper: float, in_product: bool, rolloff: Sequence[float] = ()
) -> Array:
    xp = library_of(values)
    if name == "sine":
        (order,) = rolloff or (1.0,)
        return xp.stack([xp.sin(order * values), xp.cos(order * values)])
    if name == "wave":  # of an angle, each order over itself
        turned = _WAVES[:, None] * values
        over = _WAVES[:, None]
        return xp.concatenate([xp.ones_like(turned[:1]), xp.sin(turned) / over, xp.cos(turned) / over])
    scaled = 2 * (values - lower) / (upper - lower) - 1
    if name == "line":
        return xp.stack([xp.ones_like(scaled), scaled])
    u = xp.clip((scaled + 1) * (PIECES / 2) + _OUTER, 0.0, PIECES + 2.0 * _OUTER)
    first = xp.clip(xp.floor(u), 0, PIECES + 2 * _OUTER - 1).astype(int)
    t = u - first
    # the four cubic B-splines that are not zero there
    weights = (1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3
    columns = xp.asarray(_table(name, in_product).T / 6)
    return sum(columns[:, first + k] * weight for k, weight in enumerate(weights))  # type: ignore[return-value]


def _play_features(values: Array, bounds: Sequence[float], run: Array | None) -> Array:
    xp = library_of(values)
    half = 0.5 * (bounds[1] - bounds[0])
    single_run = np.stack([np.zeros(values.size, int), np.full(values.size, values.size - 1)])
    centred = values - 0.5 * (bounds[0] + bounds[1])
    behind = plays(jnp.asarray(centred), jnp.asarray(_PLAYS * half), jnp.asarray(single_run if run is None else run))
    behind = np.asarray(behind) if xp is np else behind
    # a spring that slips at the end of its play, from -1 to 1: friction and lost motion are sums of such
    slipping = (centred - behind) / (_PLAYS * half)[:, None]
    return xp.concatenate([xp.ones_like(centred)[None], centred[None] / half, slipping])


@jit
def plays(values: Array, widths: Array, run: Array) -> Array:
    """What follows a driver with play, `(width, sample)`: pushed along, and left behind by `width` at most.

    Sums of such plays are all hysteresis whose loops close and do not depend on speed (I. Mayergoyz, Mathematical
    Models of Hysteresis, 1991, ch. 1; of L. Prandtl and A. Ishlinskii). Each run begins at 0, as nearly as it can.

    Args:
        values: `(sample,)`, of the driver.
        widths: `(width,)` in its unit, from 0.
        run: `(2, sample)`, the first and the last sample of the run of each.
    """

    def pushed(follower: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        value, begins = now
        follower = jnp.clip(jnp.where(begins, 0.0, follower), value - widths, value + widths)
        return follower, follower

    begins = run[0] == jnp.arange(run.shape[1])
    return lax.scan(pushed, jnp.zeros_like(widths), (values, begins))[1].T
