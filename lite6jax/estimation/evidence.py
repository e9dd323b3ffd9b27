"""The evidence of a term: by how much its presence makes the residuals likelier, all else integrated over.

Columns X of a term, projected outside what the model explains, have the eigenvalues λ and, along their directions, the
squared pulls z² of the residuals. Under the prior N(0, τ²) of each coefficient the residuals are likelier by

    ΔL(τ) = ½ Σ [z² τ²λ / (1 + τ²λ) − ln(1 + τ²λ)],

which is at its largest where τ is as the data say (M. Tipping and A. Faul, Fast Marginal Likelihood Maximisation for
Sparse Bayesian Models, 2003, in block form). Of K directions of equal information that is ½ (T − K − K ln(T / K)), T
their χ² statistic. The scale of the noise is not known: integrated over, it makes ½ Σ z² … a Student's form,
−½ ν ln(1 − q / S), of ν degrees of freedom and the sum of squares S that is left without the term.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import PeriodicFamily
from lite6jax.estimation.score_test import ScoreTest
from lite6jax.estimation.thresholds import CONFOUNDED, LOWEST_ORDER

RESOLVED_ORDERS = 3.8
"""Independent orders per order, over a full turn: √(π gain / 3) at a gain of 14.

There family-wise p-values meet the level (Baluev 2008).
"""

_UNIFORM = 2 * np.pi / np.sqrt(12)
"""rad, the standard deviation of an angle that is spread evenly over a turn."""
_TRIED = 28
"""Variances τ² of the prior that are tried, in geometric steps."""
_LEAST = 1e-2
_MOST = 1e7
"""Least and greatest τ²λ that are tried, λ the largest eigenvalue; the greatest is more where the pulls z² need it."""
_DECLARED = 4.0
"""Degrees of freedom that a declared noise counts as: it is known to a factor of two."""


class Evidence(NamedTuple):
    """The evidence of some terms, each array `(…,)`.

    Attributes:
        gain: log evidence over their absence.
        variance: τ², of the coefficients.
        volume: ½ Σ ln(1 + τ²λ), by which the evidence is less than the likelihood's gain.
    """

    gain: Array
    variance: Array
    volume: Array


_NOTHING = Evidence(np.zeros(()), np.zeros(()), np.zeros(()))


class Sums(NamedTuple):
    """A site's column summed over the rows of each sample.

    Attributes:
        column: `(row, sample)`.
        weight: `(sample,)`, its square.
        pull: `(sample,)`, its product with what the model leaves.
        inside: `(k, sample)`, with each direction of the model, or with those by which it differs from a whole one.
        left: the sum of squares that is left in the groups of rows on which it acts.
        freedom: their degrees of freedom.
        exact: whether they hold of any function: in white noise, or of a site that acts on one row. Else functions are
            to vary slowly beside the noise.
    """

    column: Array
    weight: Array
    pull: Array
    inside: Array
    left: float
    freedom: float
    exact: bool


@final
@dataclass(frozen=True, eq=False)
class Marginal:
    """What a model leaves, the model integrated over, ready to weigh terms.

    Attributes:
        test: the score test of that model; its basis spans the nuisance and the terms, under their priors.
    """

    test: ScoreTest

    @cached_property
    def _by_group(self) -> tuple[Array, Array]:
        """The sum of squares left in each group of rows, and its degrees of freedom, with the declared noise."""
        problem = self.test.problem
        fit = self.test.fit
        measured = problem.rows * problem.samples
        # in sum that times the residual, which of a group alone may be negative
        by_row = np.sum(self.test.left_of_rows**2, 1)
        of_priors = np.sum(self.test.left_of_span[measured:] ** 2)
        counts = np.bincount(problem.groups)
        # after the measurements come the readings of priors, which all groups share
        squares = np.maximum(np.bincount(problem.groups, by_row) + of_priors, 1e-300)
        freedom = counts * fit.training.sum() * self.test.freedom / max(problem.rows * fit.training.sum(), 1)
        freedom = np.maximum(freedom, 1.0)
        if problem.floored:
            squares = np.maximum(squares, freedom * (fit.noise.least_scales(1.0) / self.test.scale) ** 2)
        declared = _DECLARED * problem.declared
        return squares + declared / self.test.scale**2, freedom + declared

    def _of_groups(self, rows: Mask) -> tuple[float, float]:
        """Sum of squares and degrees of freedom of the groups of some rows `(row,)`, and of all coupled with these."""
        squares, freedom = self._by_group
        groups = self._coupled(rows)
        return float(squares[groups].sum()), float(freedom[groups].sum())

    def _coupled(self, rows: Mask) -> Integers:
        """The groups of some rows `(row,)`, and those that the model couples with them."""
        coupled = self.test.coupled
        acting = np.bincount(self.test.problem.groups[rows], minlength=len(coupled)) > 0
        return np.flatnonzero(coupled[acting].any(0))

    @cached_property
    def _together(self) -> int:
        """The most groups of noise in which one component is seen: processes are weighed in their common scale."""
        return max(
            (len(self._coupled(np.any(component.column, 1))) for component in self.test.problem.components), default=1
        )

    @property
    def _whole(self) -> "Marginal":
        """That of the model from which this one differs by a few directions; itself where that is this one."""
        return self._another or self  # kept, a reference to itself would hold all tables until garbage is collected

    @cached_property
    def _another(self) -> "Marginal | None":
        return None if self.test.whole is None else Marginal(self.test.whole)

    def _beside(
        self, keys: Sequence[Hashable], of_whole: Callable[["Marginal", Sequence[int]], Array], inside: Array
    ) -> Array:
        """The information `(group, number, number)` of groups of columns beside the model.

        It is computed beside the whole model once. Directions that this one does not have add to it, and further ones
        take from it (M. Tipping and A. Faul, 2003, for a term that goes or comes).

        Args:
            keys: what each group is, so that its information is kept; None of one that is not.
            of_whole: computes that of some groups beside the whole model.
            inside: `(group, number, change)`, products of the columns with the changes.
        """
        whole = self._whole
        table = whole.test.table
        missing = [k for k, key in enumerate(keys) if key is None or key not in table]
        new = dict(zip(missing, of_whole(whole, missing) if missing else (), strict=True))
        table.update((keys[k], information) for k, information in new.items() if keys[k] is not None)
        information = np.stack([new[k] if k in new else table[key] for k, key in enumerate(keys)])
        if whole is self:
            return information
        return information - (inside * self.test.span.sign) @ inside.swapaxes(-1, -2)

    def sums(self, column: Array) -> Sums:
        """Sums of a site's column `(row, sample)`; computed once."""
        key = "sums", id(column)  # the sums have the column, so that no other one has its identity
        if key not in self.test.table:
            self.test.table[key] = self._sums(column)
        return self.test.table[key]

    def _sums(self, column: Array) -> Sums:
        test = self.test
        unit = 1 / test.scale[0]
        weight, inside, pull = test.over_rows(column)
        white = test.fit.noise.white
        rows = np.asarray(column.any(1))
        exact = white or np.count_nonzero(rows) == 1
        if exact and not white:
            inside, pull = test.unwhitened_sums(column)
        return Sums(column, weight * unit**2, pull * unit, inside * unit, *self._of_groups(rows), exact)

    def equations(self, sums: Sums, functions: Array, keys: Sequence[Hashable] = ()) -> tuple[Array, Array]:
        """Pull `(group, number)` and information `(group, number, number)` of functions `(group, number, sample)`.

        Args:
            sums: of the site.
            functions: whose columns are their products with that of the site.
            keys: what each group is, as of `_beside`; none is kept where these are not given.
        """
        test = self.test
        unit = 1 / test.scale[0]

        def products(groups: Array, of: Sums) -> Array:
            return (groups.reshape(-1, groups.shape[-1]) @ of.inside.T).reshape(*groups.shape[:-1], -1)

        def squares(some: Sequence[int]) -> Array:
            groups = functions[some]
            if sums.exact:
                return test.white_gram(sums.column, groups)
            weights = test.weights(sums.column)
            return np.stack([(groups * weight) @ groups.swapaxes(-1, -2) for weight in weights], 1)

        def of_whole(whole: Marginal, some: Sequence[int]) -> Array:
            groups = functions if len(some) == len(functions) else functions[some]
            inside = products(groups, whole.sums(sums.column))
            gram = test.gram(sums.column, [keys[k] for k in some], lambda few: squares([some[k] for k in few]))
            return gram * unit**2 - inside @ inside.swapaxes(-1, -2)

        keys = keys or [None] * len(functions)
        changed = products(functions, sums) if self._whole is not self else np.zeros(())
        return functions @ sums.pull, self._beside(keys, of_whole, changed)

    def dense(self, column: Array, functions: Array, key: Hashable = None) -> tuple[Array, Array, float, float]:
        """Pull, information, sum of squares and freedom of functions at a site, in any noise.

        Args:
            column: `(row, sample)`, of the site.
            functions: `(number, sample)`.
            key: as of `equations`.
        """
        test = self.test
        unit = 1 / test.scale[0]

        def of_whole(whole: Marginal, _: Sequence[int]) -> Array:
            inside = functions @ whole.test.unwhitened_sums(column)[0].T
            gram = test.gram(column, [key], lambda _: test.white_gram(column, functions[None]))
            return (gram - inside @ inside.T) * unit**2

        changes, pull = test.unwhitened_sums(column)
        changed = (functions @ changes.T * unit)[None] if self._whole is not self else np.zeros(())
        (information,) = self._beside([key], of_whole, changed)
        return functions @ pull * unit, information, *self._of_groups(np.any(column, 1))

    def of_sums(self, sums: Sums, added_up: Callable[[Array], Array], key: Hashable) -> Array:
        """The information `(function,)` of functions, each alone, which are 1 in some samples and 0 in all others.

        Args:
            sums: of the site.
            added_up: the sums `(…, function)` of `(…, sample)` over the samples in which each of them is 1.
            key: what they are.
        """
        table = self._whole.test.table
        if key not in table:
            table[key] = added_up(sums.weight) - np.sum(added_up(self._whole.sums(sums.column).inside) ** 2, 0)
        if self._whole is self:
            return table[key]
        return table[key] - self.test.span.sign @ added_up(sums.inside) ** 2

    def information_of_each(self, sums: Sums, functions: Array, key: Hashable) -> Array:
        """The information `(function,)` of functions `(function, sample)` at a site, each alone.

        Args:
            sums: of the site.
            functions: which.
            key: what they are at which site.
        """
        table = self._whole.test.table
        if key not in table:
            inside = functions @ self._whole.sums(sums.column).inside.T
            table[key] = functions**2 @ sums.weight - np.sum(inside**2, 1)
        if self._whole is self:
            return table[key]
        return table[key] - (functions @ sums.inside.T) ** 2 @ self.test.span.sign

    def of_noise(self, column: Array) -> Evidence:
        """The evidence that a component moves by a number of its own in each sample: the site is known, its cause not.

        Beside a model of much fewer numbers than samples; that it takes up some of them is left out.

        Args:
            column: `(row, sample)`.
        """
        white = self.test.whitened(column) / self.test.scale[0]
        eigenvalues = np.sum(white**2, 0)
        squares = np.sum(white * self.test.left_of_rows, 0) ** 2
        return best_amplitude(eigenvalues, squares, *self._of_groups(np.any(column, 1)))

    def columns_of(self, key: Hashable) -> Array | None:
        """The columns `(number, row, sample)` of a term that `of_names` was given with this key; None of another."""
        entry = self._whole.test.table.get(("columns", key))
        return None if entry is None else entry[0]

    def of_names(
        self, groups: Sequence[Array], together: bool = False, keys: Sequence[Hashable] = ()
    ) -> list[Evidence]:
        """The evidence of named terms, some of whose numbers may be zero.

        The numbers that are not have no prior: all their directions count as equally determined. How many there are,
        and which, are equally probable; they are chosen forward.

        Args:
            groups: of each term its columns `(number, row, sample)`.
            together: whether the noise of all rows on which any of them acts is one scale, as parts of one term need.
            keys: what each term is, so that what is computed of its columns beside the whole model is kept; None of one
                of which nothing is.
        """
        problem = self.test.problem
        rows_of = [np.any(columns, (0, 2)) for columns in groups]
        if together:
            rows_of = [np.any(rows_of, 0)] * len(groups)
        groups_of = [self._coupled(rows) for rows in rows_of]
        in_one_scale = [together or len(of) <= self._together for of in groups_of]
        sizes, informations = self._of_columns(groups, keys, in_one_scale)
        unit = 1 / self.test.scale[0]
        residuals = self.test.left_of_rows
        apart = [columns for columns, one_scale in zip(groups, in_one_scale, strict=True) if not one_scale]
        outside = iter(self._outside(apart))
        squares, freedom = self._by_group
        evidence_by_term = [_NOTHING] * len(groups)
        by_shape: dict[tuple[int, ...], list[tuple[int, tuple[Array, ...]]]] = {}
        for k, (columns, of, size) in enumerate(zip(groups, groups_of, sizes, strict=True)):
            if not of.size:  # in one scale, as `_together` is one at least
                continue
            if in_one_scale[k]:
                noise = squares[of].sum()[None], freedom[of].sum()[None]
                pull = (np.tensordot(columns, self.test.unwhitened[1], 2) * unit / size)[None]
                information = informations[k][None]
            else:
                rows = [problem.groups == group for group in of]
                alone = next(outside) * unit / size[:, None, None]
                parts = [alone[:, group_rows].reshape(len(size), -1) for group_rows in rows]
                pull = np.stack(
                    [part @ residuals[group_rows].ravel() for part, group_rows in zip(parts, rows, strict=True)]
                )
                information = np.stack([part @ part.T for part in parts])
                noise = (squares[of], freedom[of])
            by_shape.setdefault(pull.shape, []).append((k, (pull, information, *noise)))
        for members in by_shape.values():
            parts = zip(*(of for _, of in members), strict=True)
            pull, information, residual_sums, counted = (np.stack(part) for part in parts)
            evidence = _of_numbers(pull, information, residual_sums, counted, CONFOUNDED)
            for place, (k, _) in enumerate(members):
                evidence_by_term[k] = Evidence(*(part[place] for part in evidence))
        return evidence_by_term

    def _outside(self, groups: Sequence[Array]) -> list[Array]:
        """Columns `(number, row, sample)` of terms, whitened and outside the model."""
        if not groups:
            return []
        return np.split(self.test.outside(np.concatenate(groups)), np.cumsum([*map(len, groups)])[:-1])

    def _of_columns(
        self, groups: Sequence[Array], keys: Sequence[Hashable], needed: Sequence[bool]
    ) -> tuple[list[Array], list[Array]]:
        """The lengths `(number,)` of the columns of terms, and the information `(number, number)` of their directions.

        Arguments as of `of_names`; `needed` says of each term whether its information is: else it is empty.
        """
        whole = self._whole.test
        keys = keys or [None] * len(groups)
        entries: list[Any] = [None if key is None else whole.table.get(("columns", key)) for key in keys]
        # a term that is not linear has other columns elsewhere
        missing = [
            k
            for k, columns in enumerate(groups)
            if (entry := entries[k]) is None
            or (needed[k] and not entry[2].size)
            or not (entry[0] is columns or np.array_equal(entry[0], columns))
        ]
        computed = self._beside_whole([groups[k] for k in missing], [needed[k] for k in missing])
        for k, entry in zip(missing, computed, strict=True):
            entries[k] = entry
            if keys[k] is not None:
                whole.table["columns", keys[k]] = entry
        sizes = list[Array]()
        informations = list[Array]()
        for k, (columns, size, information) in enumerate(entries):
            if needed[k] and self._whole is not self:
                changes, _ = self.test.unwhitened
                inside = np.tensordot(columns, changes, ((1, 2), (1, 2))) / (self.test.scale[0] * size[:, None])
                information = information - (inside * self.test.span.sign) @ inside.T
            sizes.append(size)
            informations.append(information)
        return sizes, informations

    def _beside_whole(self, groups: Sequence[Array], needed: Sequence[bool]) -> list[tuple[Array, Array, Array]]:
        """Columns of terms, and their lengths and information beside the whole model, as of `_of_columns`."""
        if not groups:
            return []
        whole = self._whole.test
        columns = np.concatenate(groups)
        white = whole.whitened(columns).reshape(len(columns), -1) / whole.scale[0]
        inside = white @ whole.basis[:, : white.shape[1]].T if any(needed) else white[:, :0]
        lengths = np.sqrt(np.maximum(np.sum(white**2, 1), 1e-300))
        ends = np.cumsum([0, *map(len, groups)])
        entries = list[tuple[Array, Array, Array]]()
        for k, part in enumerate(map(slice, ends[:-1], ends[1:])):
            size = lengths[part]
            information = np.zeros((0, 0))
            if needed[k]:
                information = white[part] @ white[part].T - inside[part] @ inside[part].T
                information = information / np.outer(size, size)
            entries.append((groups[k], size, information))
        return entries


def _of_numbers(pull: Array, information: Array, residual_sums: Array, freedom: Array, confounded: float) -> Evidence:
    """As `of_names`, of terms of as many numbers, whose columns have unit length.

    Args:
        pull: `(term, group, number)`, of each group of noise.
        information: `(term, group, number, number)`.
        residual_sums: `(term, group)` S.
        freedom: `(term, group)` ν.
        confounded: as of `of_process`.
    """
    terms = len(pull)
    count = pull.shape[-1]
    at = np.arange(terms)
    chosen = np.zeros((terms, 0), int)
    remaining = np.tile(np.arange(count), (terms, 1))
    best_evidence = likelihood = Evidence(*(np.zeros(terms) for _ in Evidence._fields))
    for size in range(1, count + 1):
        subsets = np.concatenate([np.repeat(chosen[:, None], remaining.shape[1], 1), remaining[..., None]], 2)
        evidence = _of_all(
            np.moveaxis(pull[at[:, None, None], :, subsets], -1, -2),
            np.moveaxis(information[at[:, None, None, None], :, subsets[..., None], subsets[..., None, :]], -1, -3),
            residual_sums[:, None],
            freedom[:, None],
            confounded,
        )
        likeliest = np.argmax(evidence.gain + evidence.volume, 1)
        likelihood = Evidence(*(part[at, likeliest] for part in evidence))
        chosen = subsets[at, likeliest]
        remaining = remaining[np.arange(remaining.shape[1]) != likeliest[:, None]].reshape(terms, -1)
        gain = likelihood.gain - np.log(count * comb(count, size))
        better = gain > best_evidence.gain
        parts = zip((gain, likelihood.variance, likelihood.volume), best_evidence, strict=True)
        best_evidence = Evidence(*(np.where(better, candidate, before) for candidate, before in parts))
    # a fit takes also what directions give it that are too nearly confounded for evidence
    fitted = _of_all(pull, information, residual_sums, freedom, _ROUNDING) if count > 1 else likelihood
    return best_evidence._replace(volume=np.maximum(fitted.gain + fitted.volume - best_evidence.gain, 0.0))


_ROUNDING = 1e-9
"""Share of a column's square outside a model from which on a fit determines it: errors of the linearisation move the
estimate there, and hardly what the fit gains."""
_REWEIGHTED = 5
"""Solutions for the coefficients, each at the scales of the one before: these differ by less than 1 % then."""


def _of_all(pull: Array, information: Array, residual_sums: Array, freedom: Array, confounded: float) -> Evidence:
    """The evidence of numbers `(…,)`, all of which are not zero, where each group of rows has a scale of its own.

    Arguments as of `_of_numbers`, with `(…, group)` for `(term, group)`.
    """
    groups = residual_sums.shape[-1]
    determined, q, size = _of_least_squares(pull, information, freedom / residual_sums, confounded)
    for _ in range(_REWEIGHTED - 1 if groups > 1 else 0):
        remaining_sums = np.clip(residual_sums - 2 * q + size, 1e-12 * residual_sums, None)
        determined, q, size = _of_least_squares(pull, information, freedom / remaining_sums, confounded)
    remaining_sums = np.clip(residual_sums - 2 * q + size, 1e-12 * residual_sums, None)
    likelihood = -0.5 * np.sum(freedom * np.log(remaining_sums / residual_sums), -1)
    numbers = determined.sum(-1)
    count = np.maximum(numbers, 1)
    if groups == 1:
        squares = np.where(determined, q / count[..., None], 0.0)
        evidence = best_amplitude(determined.astype(float), squares, residual_sums[..., None], freedom[..., None])
        return evidence._replace(volume=np.maximum(likelihood - evidence.gain, 0.0))
    variance = np.where(numbers, np.maximum(np.sum(freedom / remaining_sums * size, -1) / count, 1.0), 0.0)
    volume = numbers / 2 * (1 + np.log(np.maximum(variance, 1.0)))
    return Evidence(likelihood - volume, variance, volume)


def _of_least_squares(pull: Array, information: Array, weight: Array, confounded: float) -> tuple[Mask, Array, Array]:
    """The numbers x that fit best where groups of rows have a weight `(…, group)`, arguments as of `_of_all`.

    Returns:
        which directions are determined `(…, number)`; x times the pull of each group, and xᵀ times its information
        times x, `(…, group)`.
    """
    weight = (weight / weight.max(-1, keepdims=True))[..., None]
    eigenvalues, V = np.linalg.eigh(np.sum(weight[..., None] * information, -3))
    determined = eigenvalues > confounded
    inside = np.einsum("...ij,...i->...j", V, np.sum(weight * pull, -2))
    x = np.einsum("...ij,...j->...i", V, np.where(determined, inside / np.where(determined, eigenvalues, 1.0), 0.0))
    return determined, np.sum(pull * x[..., None, :], -1), np.einsum("...i,...gij,...j->...g", x, information, x)


def best_amplitude(eigenvalues: Array, squares: Array, left: Array | float, freedom: Array | float) -> Evidence:
    """The evidence at the likeliest variance of the coefficients.

    Args:
        eigenvalues: `(…, direction)` λ.
        squares: `(…, direction)` z² λ, of pulls that are not divided by √λ.
        left: S, `(…, 1, 1)` or one for all.
        freedom: ν, likewise.
    """
    left, freedom = (
        np.asarray(statistic)[..., 0] if np.ndim(statistic) else statistic for statistic in (left, freedom)
    )
    top = np.maximum(eigenvalues.max(-1, keepdims=True), 1e-300)
    is_determined = eigenvalues > 1e-12 * top
    explained = np.sum(
        np.where(is_determined, squares, 0.0) / np.where(is_determined, eigenvalues, 1.0), -1, keepdims=True
    )
    largest_variance = np.maximum(_MOST, 10 * freedom * explained / np.maximum(left - explained, 1e-12 * left))
    s = _LEAST * (largest_variance / _LEAST) ** np.linspace(0, 1, _TRIED) / top
    grown = s[..., None] * eigenvalues[..., None, :]
    q = np.sum(s[..., None] * squares[..., None, :] / (1 + grown), -1)
    volume = 0.5 * np.sum(np.log1p(grown), -1)
    gains = -0.5 * freedom * np.log(np.maximum(1 - q / left, 1e-12)) - volume
    likeliest = np.argmax(gains, -1)[..., None]
    return Evidence(*(np.take_along_axis(array, likeliest, -1)[..., 0] for array in (gains, s, volume)))


def of_process(
    pull: Array, information: Array, left: Array | float, freedom: Array | float, confounded: float
) -> Evidence:
    """The evidence of processes whose coefficients have the same variance.

    Args:
        pull: `(…, number)`.
        information: `(…, number, number)`.
        left: S.
        freedom: ν.
        confounded: eigenvalue over the largest below which a direction is in the model's span.
    """
    eigenvalues, V = np.linalg.eigh(information)
    eigenvalues = np.maximum(eigenvalues, 0.0)
    squares = np.einsum("...ij,...i->...j", V, pull) ** 2
    squares = np.where(eigenvalues > confounded * eigenvalues[..., -1:], squares, 0.0)
    return best_amplitude(eigenvalues, squares, left, freedom)


def bound(pull: Array, information: Array, left: float, freedom: float, confounded: float) -> Array:
    """What no process of these functions can exceed, `(…,)`: the likelihood's gain."""
    size = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 1e-300))
    C = information / (size[..., None] * size[..., None, :]) + confounded * np.eye(information.shape[-1])
    z = pull / size
    q = np.sum(z * np.linalg.solve(C, z[..., None])[..., 0], -1)
    return -0.5 * freedom * np.log(np.maximum(1 - q / left, 1e-12))


def log_orders_of(family: PeriodicFamily, order: ArrayLike, options: EngineOptions) -> Array:
    """`log_orders` of the orders of a family."""
    turns = max(float(np.std(family.angle)) / _UNIFORM, 1.0)
    return log_orders(order, options, family.whole, family.highest, turns)


def log_orders(
    order: ArrayLike, options: EngineOptions, whole: bool = True, highest: float | None = None, turns: float = 1.0
) -> Array:
    """The logarithm of the number of orders that each order counts as the best of: less for one that is likelier.

    That is the number of independent orders per order over the prior density; of a whole order, one over its prior
    probability. Independent orders are the more, the farther the angles spread (R. V. Baluev, Monthly Notices of the
    Royal Astronomical Society 385, 2008).

    Args:
        order: `(order,)`, in waves per turn.
        options: thresholds.
        whole: whether whole orders are the likelier ones.
        highest: order that is searched; that of the options where not given.
        turns: spread of the angles over that of an even full turn, at least 1.
    """
    order = np.asarray(order, float)
    highest = highest or options.highest_order
    share = options.prior.whole_order if whole else 0.0
    at = np.maximum(order, LOWEST_ORDER)
    between = np.log(RESOLVED_ORDERS * turns * at * np.log(highest) / (1 - share))
    if not share:
        return between
    inverse = float(np.sum(1 / np.arange(1, highest + 0.5)))
    return np.where(order % 1 == 0, np.log(at * inverse / share), between)
