"""Columns of terms of many numbers, as products of the columns of a site and many functions of the sample.

Sums over the rows of a sample come first, so that the full columns `(number, row, sample)` are never formed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]


@final
@dataclass(frozen=True, eq=False)
class Factored:
    """The columns of functions at one site; each component of a displacement has numbers of its own for all functions.

    Attributes:
        site: `(component, row, sample)`, the columns of the site.
        functions: `(function, sample)`.
    """

    site: Array
    functions: Array

    def __len__(self) -> int:
        return len(self.site) * len(self.functions)

    def weighed(self, root: Array) -> "Factored":
        """With columns times the roots of weights, `(sample,)` or `(row, sample)`."""
        return Factored(self.site * root, self.functions)

    def with_rows(self, rows: Array) -> Array:
        """Products `(…, number)` of the columns with rows `(…, row, sample)`."""
        return np.concatenate([np.sum(rows * one, -2) @ self.functions.T for one in self.site], -1)

    def with_others(self, other: "Factored") -> Array:
        """Products `(number, number)` of the columns with those at another site."""
        blocks = [[(self.functions * np.sum(a * b, 0)) @ other.functions.T for b in other.site] for a in self.site]
        return np.block(blocks)

    def total(self, values: Array) -> Array:
        """Their sum `(row, sample)` with these numbers `(number,)`."""
        return np.sum(self.site * (values.reshape(len(self.site), -1) @ self.functions)[:, None], 0)


def gram(parts: Sequence[Array | Factored]) -> Array:
    """Products `(number, number)` of all columns; each part is `(number, row, sample)` or factored."""
    half = [[_products(one, other) for other in parts[: k + 1]] for k, one in enumerate(parts)]
    blocks = [[half[i][j] if j <= i else half[j][i].T for j in range(len(parts))] for i in range(len(parts))]
    return np.block(blocks)


def pulled(parts: Sequence[Array | Factored], rows: Array) -> Array:
    """Products `(number,)` of all columns with rows `(row, sample)`."""
    return np.concatenate(
        [one.with_rows(rows) if isinstance(one, Factored) else np.tensordot(one, rows, 2) for one in parts]
    )


def _products(one: Array | Factored, other: Array | Factored) -> Array:
    if isinstance(one, Factored):
        return one.with_others(other) if isinstance(other, Factored) else one.with_rows(other).T
    if isinstance(other, Factored):
        return other.with_rows(one)
    flat, others = one.reshape(len(one), -1), other.reshape(len(other), -1)
    return flat @ (flat if one is other else others).T
