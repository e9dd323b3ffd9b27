"""Rao's score test of every candidate at once: what each would explain of the residuals, without a refit.

Names are tested here: `Score.p_value` is the larger of a test for white noise and Hotelling's T² of blocks of samples,
which is robust to correlated and unequal noise. `Score.familywise` multiplies it by what was searched: the number of
names, or the inverse of a name's prior probability where that is larger (`chance_of` in `search/search.py`). Processes
are not tested here: their p-value is the posterior odds against them.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple, final

import numpy as np
from scipy.special import chdtrc, fdtrc

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.estimation.least_squares import Fit, linear_columns
from lite6jax.estimation.noise import NoiseModel, autocorrelation_time, noise_model, run_starts
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem, contribution, linearised_at, prior_precision
from lite6jax.estimation.projection import Span, unit_rows
from lite6jax.estimation.terms import Term, Terms
from lite6jax.estimation.thresholds import CONFOUNDED, EIGENVALUE_ROUNDING
from lite6jax.estimation.whitening import Whitened, weighed_columns

_WINSOR = 4.0
"""Standard deviations at which residuals are winsorised; one normal sample in 16 000 is beyond."""
_MOST_BLOCKS = 200
"""Most blocks of a score test; at p-values of one in a million, 60 blocks need an effect a tenth larger."""
_LEAST_IN_BLOCK = 6
"""Fewest samples in a block; fewer make heavy-tailed sums."""
_ENOUGH_BLOCKS = 20
"""Blocks below which they are made shorter: a variance is then known to a third."""
_BLOCK_TIMES = 2.0
"""Autocorrelation times in a block; neighbouring blocks then correlate little."""

_MANY = 20
_UNDETERMINED = 1e-4
"""A process of more coefficients is reduced to the combinations whose information is this share of their prior's."""
_NUMBERS = 1 << 22
"""Of columns that are scored at once: 32 MB."""


class Score(NamedTuple):
    """What a candidate would explain, with its test.

    Attributes:
        gain: in log-likelihood, by its quadratic approximation.
        size: how many of its numbers are identifiable beside the model.
        p_value: of noise alone explaining as much; the larger of a test for white noise and one robust to correlation.
        confounded: whether its columns lie in the span of nuisance and model.
        values: `(number,)` of the candidate, estimated.
    """

    gain: float
    size: int
    p_value: float
    confounded: bool
    values: Array

    def familywise(self, searched: float) -> float:
        """The p-value of the best of `searched` independent candidates (Bonferroni)."""
        return min(self.p_value * searched, 1.0)


class Spanned(NamedTuple):
    """The columns of nuisance and model, attributes as of `ScoreTest`."""

    span: Span
    owners: Integers
    acting: Mask


@final
@dataclass(frozen=True, eq=False)
class ScoreTest:
    """A fitted model, ready to score candidates against what it leaves.

    Attributes:
        problem: the data.
        fit: the model that candidates are added to.
        options: thresholds.
        residual: `(reading,)` white, of unit noise, winsorised. Readings are the rows of all samples after whitening,
            and then one for each number of the nuisance that has a prior.
        blocks: the first sample of each block of neighbouring samples.
        freedom: residual degrees of freedom.
        time: autocorrelation time of the residual, in samples; 1 where it is white.
        scale: `(group,)`, of the noise over the declared one.
        span: of the columns of nuisance and model, with further readings of the other numbers' priors.
        owners: `(number,)` int, the place of the term that each of these columns is of; -1 of the nuisance.
        acting: `(number, group)`, whether it acts on a group of noise.
        whole: the test of the model in whose noise and span this one is, with changes; None where it is that one.
        table: what was computed of candidates beside this model, by what they are; `beside` and `extend` change it.
        grams: products of candidates with themselves in each group of noise of unit variance, by what they are: those
            of all models of one linearisation.
        whitened_model: the columns of all models of one linearisation.
    """

    problem: Problem
    fit: Fit
    options: EngineOptions
    residual: Array
    blocks: Integers
    freedom: float
    time: float
    scale: Array
    span: Span
    owners: Integers
    acting: Mask
    whole: "ScoreTest | None" = None
    table: dict[Hashable, Any] = field(default_factory=dict)
    grams: dict[Hashable, Array] = field(default_factory=dict)
    whitened_model: Whitened = field(default_factory=Whitened)

    @property
    def basis(self) -> Array:
        """`(k, reading)`, the span in the readings of the residual."""
        return self.span.basis[:, : len(self.residual)]

    @cached_property
    def coupled(self) -> Mask:
        """`(group, group)`, whether two groups of noise share a number of the model, directly or by others."""
        of_group = self.acting.astype(float)
        coupled = (of_group.T @ of_group + np.eye(of_group.shape[1])) > 0
        while True:
            further = (coupled.astype(float) @ coupled) > 0
            if (further == coupled).all():
                return coupled
            coupled = further

    def beside(self, kept: Sequence[bool]) -> "ScoreTest":
        """The test of the model with some of its terms alone, in the noise that all of them leave.

        What the others explain is a part of the residual. A missing large effect would inflate the noise estimate and
        mask differences between candidates.

        Args:
            kept: of each term of the model, whether it stays.
        """
        if all(kept):
            return self
        f = self.fit
        residual = self.residual
        # what a term explains under a prior is there already
        out = [not stays and not _has_prior(term) for term, stays in zip(f.terms.terms, kept, strict=True)]
        if any(out):
            more, values = f.terms.part(f.values, out)
            added = contribution(self.problem, more, values, (f.terms, f.values))[None]
            residual = residual.copy()
            residual[: added.size] -= _white(f, added, self.scale).ravel() / self.scale[0]
        part = f.part(kept)
        spanned = self._changed(part, kept)
        if spanned is None:
            spanned = _spanned(self.problem, part, self.scale, self.whitened_model)
        whole = None if spanned.span.whole is not self.span.whole else self.whole or self
        return replace(self, fit=part, residual=residual, whole=whole, table={}, **spanned._asdict())

    def extend(self, columns: Array) -> "ScoreTest":
        """The test of the model with more columns `(number, row, sample)`, to first order; the fit is as it was."""
        flat = self._flat(columns)
        span = self.span.extended(flat[flat.any(1)], EIGENVALUE_ROUNDING)
        further = len(span.changes) - len(self.span.changes)
        return replace(
            self,
            span=span,
            owners=np.append(self.owners, np.full(further, len(self.fit.terms.terms))),
            acting=np.concatenate([self.acting, np.tile(_acting(self.problem, columns).any(0), (further, 1))]),
            whole=self.whole or self,
            table={},
        )

    def _changed(self, part: Fit, kept: Sequence[bool]) -> Spanned | None:
        """The columns of a part of the model, as changes of this span; None where they are no changes of it.

        Masses act through what gives way: without it their columns go, and those beside the rest come; so does the
        column of an offset in time, which delays what the other terms do. Columns of processes are always the same.

        Args:
            part: of the model.
            kept: as of `beside`.
        """
        before, whole_columns = self._named
        nuisance, part_columns = _named_columns(self.problem, part)
        places = {term: place for place, term in enumerate(self.fit.terms.terms)}
        moved = [term for term, columns in part_columns.items() if not np.array_equal(whole_columns[term], columns)]
        stay = np.append(kept, True)[self.owners]
        for term in moved:
            stay[self.owners == places[term]] = False
        place = np.append(np.cumsum(kept) - 1, -1)
        changed = (before != nuisance).any((1, 2))
        if not stay[len(self.span.coordinates) :].all():  # directions that came are of several columns each
            return None
        if not changed.any() and not moved:
            span = self.span.part(stay, EIGENVALUE_ROUNDING)
            return Spanned(span, place[self.owners[stay]], self.acting[stay])
        acted, acts = (columns[..., self.fit.training].any((1, 2)) for columns in (before, nuisance))
        of_nuisance = np.flatnonzero(self.owners < 0)
        precision = self.problem.precision
        if len(self.span.changes) or len(of_nuisance) != acted.sum() or not precision[changed].all():
            return None
        stay[of_nuisance[changed[acted]]] = False
        numbers = np.flatnonzero(changed & acts)
        columns = np.concatenate([nuisance[numbers], *(part_columns[term] for term in moved)])
        flat = self._flat(columns)
        readings = _with_readings(self.problem, precision)
        measured = self.problem.rows * self.problem.samples
        flat[: len(numbers), measured : measured + len(readings)] = np.where(
            numbers[:, None] == readings, np.sqrt(precision[readings]) * self.fit.scale[0], 0.0
        )
        shorter = self.span.part(stay, EIGENVALUE_ROUNDING)
        span = shorter.extended(flat, EIGENVALUE_ROUNDING)
        if len(span.changes) - len(shorter.changes) != len(columns):
            return None
        of_terms = [np.full(len(part_columns[term]), place[places[term]]) for term in moved]
        owners = np.concatenate([place[self.owners[stay]], np.full(len(numbers), -1), *of_terms])
        return Spanned(span, owners, np.concatenate([self.acting[stay], _acting(self.problem, columns)]))

    @cached_property
    def _named(self) -> "tuple[Array, dict[Term, Array]]":
        return _named_columns(self.problem, self.fit)

    def score(self, terms: Sequence[Term]) -> list[Score]:
        """A score for each term."""
        scores = list[Score]()
        for part in bounded_parts(terms, self.problem.rows * self.problem.samples):
            columns = self.problem.columns(part, beside=(self.fit.terms, self.fit.values))
            scores += self.score_columns(np.split(columns, np.cumsum([term.size for term in part])[:-1]))
        return scores

    def score_columns(self, groups: Sequence[Array]) -> list[Score]:
        """A score for each group of columns `(number, row, sample)`."""
        flat = self._flat(np.concatenate(groups))
        norms = np.linalg.norm(flat, axis=1)
        projected = self.span.outside(flat)
        per_block = self._by_block(projected * self.left_of_span)
        ends = np.cumsum([0, *map(len, groups)])
        return [self._scored(projected[a:b], norms[a:b], per_block[a:b]) for a, b in pairwise(ends)]

    def confounded(self, terms: Sequence[Term]) -> list[bool]:
        """Tells whether each term is in the span of nuisance and model, under their priors."""
        is_confounded = list[bool]()
        for part in bounded_parts(terms, self.problem.rows * self.problem.samples):
            columns = self.problem.columns(part, beside=(self.fit.terms, self.fit.values))
            for block in np.split(columns, np.cumsum([term.size for term in part])[:-1]):
                flat = self._flat(block)
                information, _ = _of_unit_columns(flat @ flat.T, flat @ self.span.basis.T)
                is_confounded.append(bool(np.linalg.eigvalsh(information).max() <= CONFOUNDED))
        return is_confounded

    def gains(self, column: Array, functions: Array, keys: Sequence[Hashable] = ()) -> Array:
        """The gains in log-likelihood `(group,)` of many groups of functions at one site, without their tests.

        Args:
            column: `(row, sample)`, how residuals change with the site's deflection.
            functions: `(group, number, sample)`, deflections.
            keys: what each group is, so that what is computed of it beside the whole model is kept.
        """
        whole = self.whole or self
        missing = [k for k in range(len(functions)) if not keys or keys[k] not in whole.table]
        new = (np.zeros(0),) * 2
        if missing:
            new = whole._products(column, functions[missing], [keys[k] if keys else None for k in missing])
        if keys:
            whole.table.update((keys[k], parts) for k, parts in zip(missing, zip(*new, strict=True), strict=True))
            information, norms = map(np.stack, zip(*(whole.table[key] for key in keys), strict=True))
        else:
            information, norms = new
        unwhitened, pull = self.unwhitened_sums(column)
        if self.whole is not None:
            inside = functions @ unwhitened.T / norms[..., None]
            information = information - (inside * self.span.sign) @ inside.swapaxes(1, 2)
        eigenvalues, V = np.linalg.eigh(information)
        threshold = CONFOUNDED
        inverse = np.where(eigenvalues > threshold, 1 / np.maximum(eigenvalues, threshold), 0.0)
        along = np.einsum("gji,gj->gi", V, functions @ pull / norms)
        return 0.5 * np.sum(inverse * along**2, 1)

    def _products(self, column: Array, functions: Array, keys: Sequence[Hashable]) -> tuple[Array, Array]:
        """The information `(group, number, number)` of functions at a site, as columns of unit length, and lengths."""
        gram = self.gram(column, keys, lambda some: self.white_gram(column, functions[some]))
        return _of_unit_columns(gram, functions @ self.unwhitened_sums(column)[0].T)

    def gram(self, column: Array, keys: Sequence[Hashable], computed: Callable[[Sequence[int]], Array]) -> Array:
        """Products `(candidate, number, number)` of columns at a site with themselves, over the first group's noise.

        Args:
            column: `(row, sample)`, of the site.
            keys: what each candidate is, so that its products are kept; None of one that is not.
            computed: those of some candidates `(candidate, group, number, number)`, of the groups of noise in which the
                site is seen, each over its own noise.
        """
        names = [None if key is None else (key, self._noise) for key in keys]
        missing = [k for k, name in enumerate(names) if name is None or name not in self.grams]
        new = dict(zip(missing, computed(missing) if missing else (), strict=True))
        self.grams.update((names[k], parts) for k, parts in new.items() if names[k] is not None)
        parts = np.stack([new[k] if k in new else self.grams[name] for k, name in enumerate(names)])
        return np.tensordot((self.scale[0] / self.scale[self.groups_of(column)]) ** 2, parts, (0, 1))

    def white_gram(self, column: Array, functions: Array) -> Array:
        """As `computed` of `gram`, of functions `(candidate, number, sample)`, in any noise."""
        rows = np.flatnonzero(column.any(1))
        groups = self.fit.residuals.groups[rows]
        if self.fit.noise.white:
            weights = column[rows] ** 2 * self.fit.training
            sums = (weights[groups == group].sum(0) for group in self.groups_of(column))
            return np.stack([(functions * weight) @ functions.swapaxes(1, 2) for weight in sums], 1)
        # whitening mixes the samples of a column, which then is no product of site and function
        noise = replace(self.fit.noise, groups=groups)
        white = noise.whitened(functions[:, :, None] * column[rows]) * self.fit.training
        parts = (white[:, :, groups == group] for group in self.groups_of(column))
        flat = [part.reshape(*functions.shape[:2], -1) for part in parts]
        return np.stack([part @ part.swapaxes(1, 2) for part in flat], 1)

    def weights(self, column: Array) -> Array:
        """The squares of a whitened column `(row, sample)`, summed over the rows of each group in which it is seen.

        `(group, sample)`, over the noise of the group.
        """
        squares = (self.fit.noise.whitened(column) * self.fit.training) ** 2
        groups = self.fit.residuals.groups
        return np.stack([squares[groups == group].sum(0) for group in self.groups_of(column)])

    def groups_of(self, column: Array) -> Integers:
        """The groups of noise in which a site's column `(row, sample)` is seen; one of a site that is seen in none."""
        groups = self.fit.residuals.groups
        return np.unique(groups[column.any(1)]) if column.any() else groups[:1]

    @cached_property
    def _noise(self) -> Hashable:
        """What `grams` depend on."""
        models = tuple((model.coefficient, model.share) for model in self.fit.noise.models)
        return models, self.fit.noise.starts, self.fit.training.tobytes()

    def over_rows(self, column: Array) -> tuple[Array, Array, Array]:
        """Sums over the rows of each sample of products of a whitened column `(row, sample)`.

        With itself `(sample,)`, with each of the `directions` `(k, sample)`, and with what the model leaves
        `(sample,)`.
        """
        directions = self._directions
        white = _white(self.fit, column, self.scale)
        acting = np.flatnonzero(np.any(white, 1))
        rows = slice(acting.min(initial=self.problem.rows), acting.max(initial=-1) + 1)  # no copy of the directions
        white = white[rows]
        with_directions = np.einsum("rs,krs->ks", white, directions[:, rows])
        return np.sum(white**2, 0), with_directions, np.sum(white * self.left_of_rows[rows], 0)

    def unwhitened_sums(self, column: Array) -> tuple[Array, Array]:
        """As `over_rows`, with each of the directions `(k, sample)`, and with what the model leaves `(sample,)`.

        Times any function of the samples they are sums of products with its whitened column, in any noise.
        """
        key = "unwhitened", id(column)
        if key not in self.table:
            directions, left = self.unwhitened
            rows = np.flatnonzero(column.any(1))
            some = slice(rows.min(initial=len(column)), rows.max(initial=-1) + 1)
            sums = np.einsum("rs,krs->ks", column[some], directions[:, some]), np.sum(column * left, 0)
            self.table[key] = column, sums  # the column is kept, so that no other one has its identity
        return self.table[key][1]

    @cached_property
    def unwhitened(self) -> tuple[Array, Array]:
        """Directions `(k, row, sample)` and what the model leaves `(row, sample)`, whitened once more, backwards.

        Their products with columns are those of whitened columns with the directions and with what is left.
        """
        weights = (self.scale[0] / self.scale)[self.fit.residuals.groups, None] * self.fit.training
        return (
            self.fit.noise.transposed(self._directions * weights),
            self.fit.noise.transposed(self.left_of_rows * weights),
        )

    @property
    def _directions(self) -> Array:
        """`(k, row, sample)` in the measurements: those of the whole span, or those by which this one differs."""
        shape = self.problem.rows, self.problem.samples
        directions = self.span.basis if self.whole is None else self.span.changes
        return directions[:, : shape[0] * shape[1]].reshape(len(directions), *shape)

    @property
    def left(self) -> Array:
        """`(reading,)`, what the model, integrated over, leaves of the residual."""
        return self.left_of_span[: len(self.residual)]

    @cached_property
    def left_of_span(self) -> Array:
        """`left`, and what the model leaves of the priors' further readings, which are zero."""
        readings = self.span.whole.shape[1]
        return self.span.outside(np.pad(self.residual, (0, readings - len(self.residual)))[None])[0]

    @property
    def left_of_rows(self) -> Array:
        """`left` of the measurements, `(row, sample)`; without the readings of priors, which come after these."""
        rows = self.problem.rows
        samples = self.problem.samples
        return self.left[: rows * samples].reshape(rows, samples)

    def whitened(self, columns: Array) -> Array:
        """Columns `(…, row, sample)` whitened, of training samples, over the first group's noise."""
        return _white(self.fit, columns, self.scale)

    def outside(self, columns: Array) -> Array:
        """Columns `(number, row, sample)` whitened and outside nuisance and model, in the measurements."""
        measured = self.problem.rows * self.problem.samples
        return self.span.outside(self._flat(columns))[:, :measured].reshape(columns.shape)

    def _scored(self, projected: Array, norms: Array, per_block: Array) -> Score:
        return block_test(projected, norms, per_block, self._by_block, self.scale[0])

    def _flat(self, columns: Array) -> Array:
        """Columns `(number, row, sample)` as readings of the span: whitened, zero of held-out samples and priors."""
        flat = np.zeros((len(columns), self.span.whole.shape[1]))
        white = _white(self.fit, columns, self.scale)
        measured = self.problem.rows * self.problem.samples
        flat[:, :measured] = white.reshape(len(columns), measured)
        return flat

    def _by_block(self, products: Array) -> Array:
        return sums_by_block(products, self.problem.rows, self.problem.samples, self.blocks)


def _of_unit_columns(gram: Array, inside: Array) -> tuple[Array, Array]:
    """The information `(…, number, number)` of columns of unit length beside a model, and the lengths that they have.

    Args:
        gram: `(…, number, number)`, products of the columns with one another.
        inside: `(…, number, k)`, with the basis of the model.
    """
    norms = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 1e-300))
    return (gram - inside @ inside.swapaxes(-1, -2)) / (norms[..., None] * norms[..., None, :]), norms


def sums_by_block(products: Array, rows: int, samples: int, blocks: Integers) -> Array:
    """Sums over blocks of samples, `(column, block)`; those of the prior's readings come last, where there are any.

    Args:
        products: `(column, reading)`: the readings are those of all rows and samples, and then those of the prior.
        rows: numbers that a sample has.
        samples: how many.
        blocks: the first sample of each block.
    """
    measured = rows * samples
    per_sample = products[:, :measured].reshape(len(products), -1, samples).sum(1)
    sums = np.add.reduceat(per_sample, blocks, axis=1)
    prior = products[:, measured:]
    return np.concatenate([sums, prior.sum(1, keepdims=True)], 1) if prior.shape[1] else sums


def block_test(
    projected: Array,
    norms: Array,
    per_block: Array,
    by_block: Callable[[Array], Array],
    unit: float,
) -> Score:
    """The score of one candidate, with the test by blocks of samples (Hotelling's T²).

    Args:
        projected: `(number, reading)`, its whitened columns outside the span of nuisance and model.
        norms: `(number,)`, the lengths of these columns before that.
        per_block: `(number, block)`, the sums over blocks of projected columns times residuals.
        by_block: makes these sums of products `(number, reading)`.
        unit: of the residuals, in units of the columns.
    """
    size = len(projected)
    length = np.where(norms > 0, norms, 1.0)
    G = projected / length[:, None]
    eigenvalues, V = np.linalg.eigh(G @ G.T)
    identifiable = eigenvalues > CONFOUNDED
    if not identifiable.any():
        return Score(0.0, 0, 1.0, True, np.zeros(size))
    T = V[:, identifiable] / np.sqrt(eigenvalues[identifiable])  # of unit information
    s = T.T @ (per_block / length[:, None])
    total = s.sum(1)
    k = int(identifiable.sum())
    B = s.shape[1]
    statistic = float(total @ total)
    white = float(chdtrc(k, statistic))
    spread = block_covariance(T.T @ G, s, total, by_block)
    robust = 1.0
    if k + 2 < B:
        t2 = float(total @ np.linalg.lstsq(spread, total, rcond=None)[0])
        robust = float(fdtrc(k, B - k, t2 * (B - k) / (k * (B - 1))))
    values = -(T @ total) / length * unit
    return Score(0.5 * statistic, k, max(white, robust), False, values)


def block_covariance(columns: Array, per_block: Array, values: Array, by_block: Callable[[Array], Array]) -> Array:
    """The covariance `(k, k)` of scores from their scatter between blocks of samples.

    Args:
        columns: `(k, reading)`, outside the span of nuisance and model.
        per_block: `(k, block)`, the sums over blocks of columns times residuals.
        values: `(k,)`, what the scores estimate, in the sign of the residuals.
        by_block: makes sums over blocks of products `(k, reading)`.
    """
    # each block's score less its share of the candidate's whole effect, which is not noise
    share = np.stack([by_block(column * columns) for column in columns])
    centred = per_block - np.einsum("ijb,j->ib", share, values)
    return centred @ centred.T * per_block.shape[1] / (per_block.shape[1] - 1)


def score_test(
    problem: Problem,
    fit: Fit,
    options: EngineOptions,
    grams: dict[Hashable, Array] | None = None,
    whitened: Whitened | None = None,
) -> ScoreTest:
    """The score test against a fitted model.

    Args:
        problem: the data.
        fit: the model.
        options: thresholds.
        grams: what tests of other models of this problem know of candidates, and to which this one adds.
        whitened: columns of other models of this problem, to which this one adds.

    Returns:
        the test, of the problem whose columns are those at the fit.
    """
    off = problem.offset + fit.nuisance
    problem = linearised_at(problem, fit.nuisance)
    training = np.tile(fit.training, problem.rows).astype(float)
    n = float(training.sum())
    winsorised = _winsorised(fit.residuals.innovations, fit, _WINSOR) * fit.training
    freedom = max(n - fit.parameters, 1.0)
    # root mean square of each group; the degrees of freedom that are fitted are shared in proportion to its readings
    mean = [np.mean(winsorised[problem.groups == g][:, fit.training] ** 2) for g in range(len(fit.scale))]
    # of residuals that are exactly zero it is the fit's scale
    rms = np.sqrt(np.array([float(mean_square) * n / freedom or 1.0 for mean_square in mean]))
    scale = rms * fit.scale
    scale = np.maximum(scale, EIGENVALUE_ROUNDING * scale.max())  # of a group without noise
    residual = (winsorised / rms[problem.groups, None]).ravel()
    time = float(_times(winsorised, problem.groups).max())
    # the model is integrated over: what it explains under a prior is a part of what is to be explained
    apart = [_has_prior(term) for term in fit.terms.terms]
    if any(apart):
        more, values = fit.terms.part(fit.values, apart)
        added = contribution(problem, more, values, (fit.terms, fit.values))[None]
        residual = residual - _white(fit, added, scale).ravel() / scale[0]
    stated = _stated(problem)
    residual = np.concatenate([residual, np.sqrt(problem.precision[stated]) * off[stated]])
    blocks = _blocks(problem.samples, time)
    whitened = whitened or Whitened()
    spanned = _spanned(problem, fit, scale, whitened)
    freedom = n - fit.parameters
    test = ScoreTest(problem, fit, options, residual, blocks, freedom, time, scale, *spanned, whitened_model=whitened)
    return test if grams is None else replace(test, grams=grams)


def _named_columns(problem: Problem, fit: Fit) -> tuple[Array, dict[Term, Array]]:
    """The columns `(number, row, sample)` of a model: of its nuisance, and of each term that is no process."""
    named_terms, values = fit.terms.part(fit.values, [not term.nonparametric for term in fit.terms.terms])
    columns = problem.columns(named_terms.terms, values, (fit.terms, fit.values))
    columns_by_term = {term: columns[part] for term, part in named_terms.pairs}
    return problem.nuisance_columns(fit.terms, fit.values), columns_by_term


def _stated(problem: Problem) -> Integers:
    """The numbers of the nuisance whose prior is a reading."""
    return np.flatnonzero((problem.precision > 0) & problem.informative)


def _with_readings(problem: Problem, precision: Array) -> Integers:
    """The numbers of a model whose priors are readings, in the order of these: first those that are stated.

    Args:
        problem: the data.
        precision: `(number,)`, of the priors, the nuisance first.
    """
    stated = _stated(problem)
    return np.concatenate([stated, np.setdiff1d(np.flatnonzero(precision), stated)])


def _spanned(problem: Problem, fit: Fit, scale: Array, whitened: Whitened) -> Spanned:
    """The columns of a model, with the readings of priors after those of the measurements: those that are stated first.

    Args:
        problem: the data.
        fit: of the model.
        scale: `(group,)`, of the noise.
        whitened: columns of other models.
    """
    if fit.noise.white:
        parts = [linear_columns(problem, fit.terms, fit.values)]
    else:
        parts = whitened.columns(problem, fit.terms, fit.values, fit.noise)
    out = np.empty((sum(map(len, parts)), problem.rows, problem.samples))
    columns = weighed_columns(parts, (scale[0] / scale)[fit.residuals.groups, None] * fit.training, out)
    columns, precision, owners = _determined(problem, fit.terms, columns, fit.scale[0])
    acting = _acting(problem, columns)
    columns = columns.reshape(len(columns), problem.rows * problem.samples)
    with_prior = _with_readings(problem, precision)
    prior = np.zeros((len(columns), len(with_prior)))
    prior[with_prior, np.arange(len(with_prior))] = np.sqrt(precision[with_prior]) * fit.scale[0]
    is_nonzero = np.any(columns, 1)
    rows = np.concatenate([columns, prior], 1)
    del columns  # with hundreds of terms these are half a gigabyte each
    rows = unit_rows(rows if is_nonzero.all() else rows[is_nonzero])
    return Spanned(Span.of_rows(rows, EIGENVALUE_ROUNDING), owners[is_nonzero], acting[is_nonzero])


def _determined(problem: Problem, terms: Terms, columns: Array, noise: float) -> tuple[Array, Array, Integers]:
    """Columns without those combinations of a process's coefficients of which the data say nothing beside the prior.

    A rotation of coefficients of one variance leaves their prior as it is. Of the 120 of a spectrum half may count.
    The numbers of names count as free, without the priors of their limits.

    Args:
        problem: the data.
        terms: of a model.
        columns: `(number, row, sample)`, of its nuisance and its terms.
        noise: its standard deviation in the unit of the columns.

    Returns:
        the columns, the precision of their priors, and the place of the term that each is of; -1 of the nuisance.
    """
    precision = np.concatenate([problem.precision, prior_precision(problem, terms.terms)])
    first = len(problem.precision)
    blocks = [columns[:first]]
    of_prior = [precision[:first]]
    owners = [np.full(first, -1)]
    for k, (term, at) in enumerate(terms.pairs):
        part = columns[first:][at]
        part_precision = precision[first:][at]
        if not _has_prior(term):
            part_precision = np.zeros_like(part_precision)
        elif term.size > _MANY:
            flat = part.reshape(len(part), -1)
            eigenvalues, V = np.linalg.eigh(flat @ flat.T)
            V = V[:, eigenvalues > _UNDETERMINED * noise**2 * part_precision]
            part = np.tensordot(V.T, part, 1)
            part_precision = part_precision[: V.shape[1]]
        blocks.append(part)
        of_prior.append(part_precision)
        owners.append(np.full(len(part), k))
    return np.concatenate(blocks), np.concatenate(of_prior), np.concatenate(owners)


def _acting(problem: Problem, columns: Array) -> Mask:
    """`(number, group)`, on which groups of noise columns `(number, row, sample)` act."""
    return np.any(columns, 2) @ (np.arange(problem.groups.max(initial=0) + 1) == problem.groups[:, None])


def _has_prior(term: Term) -> bool:
    return bool(np.isfinite([number.spread for number in term.coordinates]).any())


def independent_runs(problem: Problem, training: Mask) -> Integers:
    """`(sample,)`, changes between runs, and where samples for training `(sample,)` and others meet."""
    begins = np.diff(np.asarray(problem.run), prepend=problem.run[0]).astype(bool) | np.diff(training, prepend=True)
    return np.cumsum(begins, dtype=int)


def remaining_noise_model(problem: Problem, fit: Fit, options: EngineOptions) -> NoiseModel:
    """The noise model of a fit's residuals; noise is independent between runs, and across held-out samples."""
    training = fit.training
    run = independent_runs(problem, training)
    rows = _winsorised(fit.residuals.rows, fit, _WINSOR)
    columns = linear_columns(linearised_at(problem, fit.nuisance), fit.terms, fit.values)
    columns /= fit.scale[fit.residuals.groups, None]
    columns, precision, _ = _determined(problem, fit.terms, columns[..., training], 1.0)
    declared = float(problem.floored) / fit.scale
    model = noise_model(
        rows[:, training], columns, np.sqrt(precision), problem.groups, run[training], options, fit.noise, declared
    )
    return model if model.white else replace(model, starts=run_starts(run))


def _white(fit: Fit, columns: Array, scale: Array) -> Array:
    """Columns `(…, row, sample)` whitened, of the training samples, in units of the first group's noise."""
    return fit.noise.whitened(columns) * ((scale[0] / scale)[fit.residuals.groups, None] * fit.training)


def bounded_parts(terms: Sequence[Term], length: int) -> list[list[Term]]:
    """Terms in parts, so that the columns of each part, of this length, do not take too much memory."""
    parts = list[list[Term]]()
    numbers = _NUMBERS
    for term in terms:
        numbers += term.size * length
        if numbers > _NUMBERS:
            parts.append([])
            numbers = term.size * length
        parts[-1].append(term)
    return parts


def _winsorised(rows: Array, fit: Fit, limit: float) -> Array:
    """Residuals `(row, sample)` over the scale, samples with an rms beyond `limit` scaled down to it."""
    out = np.empty_like(rows)
    for group, scale in enumerate(fit.scale):
        in_group = fit.residuals.groups == group
        part = rows[in_group] / scale
        length = np.sqrt(np.sum(part**2, 0) / len(part))
        out[in_group] = part * np.minimum(1.0, limit / np.maximum(length, 1e-300))
    return out


def autocorrelation_times(problem: Problem, fit: Fit) -> Array:
    """The autocorrelation time of the residuals of each group of noise, `(group,)` samples."""
    return _times(_winsorised(fit.residuals.innovations, fit, _WINSOR) * fit.training, problem.groups)


def longest_time(problem: Problem, fit: Fit) -> float:
    """The longest autocorrelation time of any group's residuals, in samples; `score_test` uses the same."""
    return float(autocorrelation_times(problem, fit).max())


def _times(residual: Array, groups: Integers) -> Array:
    return np.array([autocorrelation_time(residual[groups == group]) for group in range(int(groups.max()) + 1)])


def _blocks(samples: int, time: float) -> Integers:
    """The first sample of each block: longer than the autocorrelation time, and enough of them for a variance.

    Of few samples, blocks are shorter, down to one sample: a test by four blocks finds nothing.
    """
    shortest = int(np.clip(samples // _ENOUGH_BLOCKS, 1, _LEAST_IN_BLOCK))
    correlated = int(np.ceil(_BLOCK_TIMES * time)) if time > 1 else 1
    length = max(shortest, correlated)
    count = int(np.clip(samples // length, 4, _MOST_BLOCKS))
    return (np.arange(count) * samples) // count
