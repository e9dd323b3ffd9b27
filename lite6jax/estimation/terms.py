"""Terms of a model: what a search adds, several with their numbers in one vector, and their columns as products."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, Protocol, TypeGuard, final

import numpy as np

from lite6jax.array_types import Array


class Number(Protocol):
    """A number of a term that a fit estimates.

    Attributes:
        typical: the size that it commonly has, in its unit.
        spread: the standard deviation of its prior about zero, in its unit; infinite where its limits alone are one.
        lower: the least that is possible, in its unit.
        upper: the most that is possible.
    """

    @property
    def typical(self) -> float: ...
    @property
    def spread(self) -> float: ...
    @property
    def lower(self) -> float: ...
    @property
    def upper(self) -> float: ...


class Term(Protocol):
    """A candidate term. Hashable; at zero it changes nothing.

    Attributes:
        label: its name and site.
        site: where it acts; terms of one site can replace each other.
        size: how many numbers it has.
        coordinates: these numbers.
        specificity: rank of its name among terms that the data do not distinguish; the least is reported.
        periodic: whether it is found by the spectrum of a periodic family.
        usual: whether nearly every problem has it, so that its choice costs ln 2.
        linear: whether what it adds is proportional to its numbers.
        nonparametric: whether it is a Gaussian process rather than a named term.
        chosen: the number that a search chose instead of fitting it (an order), or None.
        includes: terms that are this one with some of its numbers zero; it takes their place.
        rivals: terms that it is always compared with, as they may be the same to it.
        drivers: the quantities that it is a function of.
    """

    specificity: ClassVar[int]
    nonparametric: ClassVar[bool]

    @property
    def usual(self) -> bool: ...

    @property
    def label(self) -> str: ...
    @property
    def site(self) -> str: ...
    @property
    def size(self) -> int: ...
    @property
    def coordinates(self) -> Sequence[Number]: ...
    @property
    def linear(self) -> bool: ...
    @property
    def periodic(self) -> bool: ...
    @property
    def chosen(self) -> float | None: ...
    @property
    def includes(self) -> "Sequence[Term]": ...
    @property
    def rivals(self) -> "Sequence[Term]": ...
    @property
    def drivers(self) -> "Sequence[Any]": ...

    def released(self) -> "Term":
        """The same term with its chosen number as its last free coordinate."""
        ...

    def held(self, number: float) -> "Term":
        """The same term with its chosen number fixed at `number`."""
        ...


class ProcessTerm(Term, Protocol):
    """A term that is a Gaussian process.

    Attributes:
        component: of its site, in which it moves; empty where the site has but one.
        kernel: by name.
        rolloff: the `numbers` of the kernel.
    """

    @property
    def component(self) -> str: ...
    @property
    def kernel(self) -> str: ...
    @property
    def rolloff(self) -> tuple[float, ...]: ...


def is_process(term: Term) -> TypeGuard[ProcessTerm]:
    """Tells whether a term is a Gaussian process and no named one."""
    return term.nonparametric


@final
@dataclass(frozen=True)
class Terms:
    """Several terms; their numbers stand one after the other in `values` `(size,)`.

    Attributes:
        terms: in the order of their numbers.
    """

    terms: tuple[Term, ...] = ()

    @cached_property
    def size(self) -> int:
        """How many numbers."""
        return sum(term.size for term in self.terms)

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Where each term's numbers stand."""
        ends = np.cumsum([0, *(term.size for term in self.terms)]).tolist()
        return tuple(slice(start, end) for start, end in pairwise(ends))

    @cached_property
    def pairs(self) -> tuple[tuple[Term, slice], ...]:
        """Each term with the place of its numbers."""
        return tuple(zip(self.terms, self.slices, strict=True))

    @cached_property
    def typical(self) -> Array:
        """`(size,)`, the common size of each number."""
        return np.array([number.typical for term in self.terms for number in term.coordinates])

    def part(self, values: Array, kept: Sequence[bool]) -> "tuple[Terms, Array]":
        """The terms that are kept, and their numbers out of `values` `(size,)`."""
        staying = [(term, values[at]) for (term, at), stays in zip(self.pairs, kept, strict=True) if stays]
        return Terms(tuple(term for term, _ in staying)), join(value for _, value in staying)


def join(values: Iterable[Sequence[float] | Array]) -> Array:
    """`(size,)` from the numbers of each term."""
    return np.concatenate([np.zeros(0), *(np.asarray(value, float) for value in values)])


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
        return np.concatenate([np.sum(rows * site_column, -2) @ self.functions.T for site_column in self.site], -1)

    def with_others(self, other: "Factored") -> Array:
        """Products `(number, number)` of the columns with those at another site."""
        blocks = [[(self.functions * np.sum(a * b, 0)) @ other.functions.T for b in other.site] for a in self.site]
        return np.block(blocks)

    def total(self, values: Array) -> Array:
        """Their sum `(row, sample)` with these numbers `(number,)`."""
        return np.sum(self.site * (values.reshape(len(self.site), -1) @ self.functions)[:, None], 0)


def gram(parts: Sequence[Array | Factored]) -> Array:
    """Products `(number, number)` of all columns; each part is `(number, row, sample)` or factored."""
    half = [[_products(row_part, column_part) for column_part in parts[: k + 1]] for k, row_part in enumerate(parts)]
    blocks = [[half[i][j] if j <= i else half[j][i].T for j in range(len(parts))] for i in range(len(parts))]
    return np.block(blocks)


def pulled(parts: Sequence[Array | Factored], rows: Array) -> Array:
    """Products `(number,)` of all columns with rows `(row, sample)`."""
    return np.concatenate(
        [part.with_rows(rows) if isinstance(part, Factored) else np.tensordot(part, rows, 2) for part in parts]
    )


def _products(first: Array | Factored, second: Array | Factored) -> Array:
    if isinstance(first, Factored):
        if isinstance(second, Factored):
            return first.with_others(second)
        return first.with_rows(second).T
    if isinstance(second, Factored):
        return second.with_rows(first)
    flat = first.reshape(len(first), -1)
    second_flat = second.reshape(len(second), -1)
    return flat @ (flat if first is second else second_flat).T
