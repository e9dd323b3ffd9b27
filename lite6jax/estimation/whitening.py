"""Columns of a model, whitened by autocorrelated noise, each once for as long as it stays the same."""

from collections.abc import Hashable, Sequence
from typing import final

import numpy as np

from lite6jax.array_types import Array
from lite6jax.estimation.noise import NoiseModel
from lite6jax.estimation.problem import LinearisedProblem
from lite6jax.estimation.terms import Term, Terms

_MOST = 1 << 25
"""Numbers that are kept: 256 MB."""


@final
class Whitened:
    """Whitened columns (derivatives of the residuals) of one problem, kept while the noise model is the same.

    A fit takes columns anew at every step and a search at every model. Those of processes and of effects that are
    linear in their numbers do not change with the other terms, and are whitened once. To whiten all of them would take
    longer than to solve for their numbers.
    """

    def __init__(self) -> None:
        self._noise: NoiseModel | None = None
        self._kept: dict[Hashable, tuple[tuple[Array, ...], Array]] = {}
        self._numbers = 0

    def columns(self, problem: LinearisedProblem, terms: Terms, values: Array, noise: NoiseModel) -> list[Array]:
        """How whitened residuals change with the nuisance, and with the numbers of each term.

        Each is `(number, row, sample)` and is not to be changed.

        Args:
            problem: linearised at the model's nuisance.
            terms: of the model.
            values: `(terms.size,)`, their numbers.
            noise: in which the rows are whitened.
        """
        if self._noise is not noise:
            self._clear()
            self._noise = noise
        products = [problem.factored(term) for term in terms.terms]
        plain, plain_values = terms.part(values, [product is None for product in products])
        computed = problem.columns(plain.terms, plain_values, (terms, values)) if plain.size else np.zeros(0)
        parts = [self._by_value("nuisance", problem.nuisance_columns(terms, values), noise)]
        blocks = (computed[part] for part in plain.slices)
        for term, product in zip(terms.terms, products, strict=True):
            if product is None:
                parts.append(self._by_value(term, next(blocks), noise))
                continue
            # of one linearisation these are the same arrays each time
            key = id(product.site), id(product.functions)
            if key not in self._kept:
                dense = product.site[:, None] * product.functions[:, None]
                # in the order of all other columns, whatever that of the functions: sums then round alike
                dense = np.ascontiguousarray(dense.reshape(-1, *product.site.shape[1:]))
                self._keep(key, (product.site, product.functions), noise.whitened(dense))
            parts.append(self._kept[key][1])
        return [part for part in parts if len(part)]

    def _by_value(self, key: "str | Term", columns: Array, noise: NoiseModel) -> Array:
        """Columns whitened, of which those are computed that differ from the latest ones of a key."""
        before = self._kept.get(key)
        if before is None or before[0][0].shape != columns.shape:
            return self._keep(key, (columns.copy(),), noise.whitened(columns))
        (raw,), white = before
        if raw is columns:
            return white
        changed = [k for k, (old, new) in enumerate(zip(raw, columns, strict=True)) if not np.array_equal(old, new)]
        if not changed:
            return white
        white = white.copy()  # a fit may still have the former ones
        white[changed] = noise.whitened(columns[changed])
        return self._keep(key, (columns.copy(),), white)

    def _keep(self, key: Hashable, source: tuple[Array, ...], white: Array) -> Array:
        if self._numbers + white.size > _MOST:
            self._clear()
        replaced = self._kept.get(key)
        self._numbers += white.size - (0 if replaced is None else replaced[1].size)
        self._kept[key] = source, white
        return white

    def _clear(self) -> None:
        self._kept.clear()
        self._numbers = 0


def weighed_columns(parts: Sequence[Array], weight: Array, out: Array) -> Array:
    """Parts of columns `(number, row, sample)`, one after the other in `out`, times a weight `(row, sample)`."""
    at = 0
    for part in parts:
        np.multiply(part, weight, out=out[at : at + len(part)])
        at += len(part)
    return out
