"""Columns of terms with hundreds of numbers, as products of one column of a site and many functions of the sample.

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
    """The columns of functions at one site.

    Attributes:
        column: `(row, sample)`, of the site.
        functions: `(number, sample)`.
    """

    column: Array
    functions: Array

    def __len__(self) -> int:
        return len(self.functions)

    def weighed(self, root: Array) -> "Factored":
        """With columns times the roots of weights, `(sample,)` or `(row, sample)`."""
        return Factored(self.column * root, self.functions)

    def with_rows(self, rows: Array) -> Array:
        """Products `(…, number)` of the columns with rows `(…, row, sample)`."""
        return np.sum(rows * self.column, -2) @ self.functions.T

    def with_others(self, other: "Factored") -> Array:
        """Products `(number, number)` of the columns with those at another site."""
        return (self.functions * np.sum(self.column * other.column, 0)) @ other.functions.T

    def total(self, values: Array) -> Array:
        """Their sum `(row, sample)` with these numbers `(number,)`."""
        return self.column * (values @ self.functions)


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
