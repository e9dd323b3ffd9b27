"""Polynomials in drivers: which products they consist of, which polynomials they contain, and their values."""

from collections.abc import Sequence
from functools import cache
from itertools import chain, combinations, combinations_with_replacement
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.deferred import Array
from lite6jax.effects.deflection import library_of
from lite6jax.effects.drivers import Driver

Products = tuple[tuple[int, ...], ...]
"""Of drivers, by their indices; the constant is the empty product."""


@cache
def products_of(drivers: tuple[Driver, ...], degree: int, power: int = 0) -> Products:
    """All products of up to `degree` drivers, the constant first.

    A direction of motion is in a product once at most: its square is the constant. Any other driver is there `power`
    times at most, where that is not 0.
    """
    most = [1 if driver.discrete else power or degree for driver in drivers]
    orders = (combinations_with_replacement(range(len(drivers)), order) for order in range(degree + 1))
    return tuple(which for found in orders for which in found if _within(which, most))


def _within(which: tuple[int, ...], most: Sequence[int]) -> bool:
    """Whether a product has no driver more often than allowed."""
    return all(which.count(k) <= most[k] for k in which)


def polynomial_basis(values: Array, ranges: NDArray, products: Products) -> Array:
    """The products of drivers, `(product, sample)`.

    Each driver is scaled so that its range is from -1 to 1, and keeps its value beyond. Of NumPy values on the host.

    Args:
        values: `(driver, sample)`.
        ranges: `(driver, 2)`, lower and upper.
        products: which.
    """
    xp = library_of(values)
    lower, upper = ranges.T[..., None]
    u = xp.clip(2 * (values - lower) / (upper - lower) - 1, -1.0, 1.0)
    return xp.stack([xp.prod(u[np.array(which, int)], 0) for which in products])


class Subset(NamedTuple):
    """Some functions of drivers that are complete by themselves: of fewer drivers, or of a lower degree or power.

    Attributes:
        drivers: that these have, by their indices.
        degree: of polynomials; 0 where they are none.
        power: highest power of each driver in these; 0 where the degree alone limits it.
        numbers: which of all the functions, counted from 0.
    """

    drivers: tuple[int, ...]
    degree: int
    power: int
    numbers: tuple[int, ...]


@cache
def polynomials_within(drivers: tuple[Driver, ...], degree: int, power: int, least: int) -> tuple[Subset, ...]:
    """Those in a polynomial, itself too: of all drivers (or one or two of three), of each degree from `least`.

    Of two drivers, neither of which is a direction of motion, there is also the one without their squares.
    """
    every, products = tuple(range(len(drivers))), products_of(drivers, degree, power)
    fewer = chain.from_iterable(combinations(every, n) for n in range(1, len(every)) if len(every) > 2)
    plain = [(n, min(power, n)) for n in range(min(degree, least), degree + 1)]
    bilinear = degree > 1 and not power and not any(driver.discrete for driver in drivers)
    subsets = []
    for which in (every, *fewer):
        for highest, most in [*plain, *([(2, 1)] if bilinear and len(which) == 2 else [])]:
            allowed = [(most or highest) * (k in which) for k in every]
            kept = (k for k, one in enumerate(products) if len(one) <= highest and _within(one, allowed))
            subsets.append(Subset(which, highest, most, tuple(kept)))
    return tuple(subsets)
