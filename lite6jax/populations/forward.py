"""Forward selection of the effects of a type, by what all recordings say, and the test of each beside the others."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, gammaln

from lite6jax.estimation.multiplicity import log_orders, relative_multiplicity
from lite6jax.populations.candidate import Candidate
from lite6jax.populations.evidence import Asked, Reduced
from lite6jax.populations.hierarchy import Hierarchy, fitted
from lite6jax.populations.options import PoolingOptions
from lite6jax.populations.pooling import WAYS, Overdispersion, Pooled, Way, likelihoods, p_value, pooled, statistics
from lite6jax.populations.reduced import Evidence, Found, PooledTerm, order_grid

Array = NDArray[np.floating]
Shown = Way | Literal["one"]
"""How an effect was found: in a way of pooling, or by one recording alone."""

_FINER = np.linspace(-1.0, 1.0, 9)


class Nearest(NamedTuple):
    """A named term, and the share that it explains of what a function without a name does."""

    term: PooledTerm
    share: float


@final
@dataclass(frozen=True)
class Selected:
    """An effect of the type.

    Attributes:
        term: which.
        candidate: as a report names it.
        shown: how it was found.
        p_value: family-wise, over all that was searched and the ways of testing.
        rivals: terms that explain nearly as much, and by how much the log-likelihood is lower.
        nearest: of a function without a name, the named term that explains most of it.
    """

    term: PooledTerm
    candidate: Candidate
    shown: Shown
    p_value: float
    rivals: tuple[tuple[PooledTerm, float], ...] = ()
    nearest: Nearest | None = None


class Tried(NamedTuple):
    """A term that was measured in every arm.

    Attributes:
        term: which.
        candidate: as a report names it.
        evidence: of each arm, beside the model; None of an arm that does not show the term.
        hierarchy: fitted to it.
        penalised: the gain in log-likelihood less the cost of its numbers.
    """

    term: PooledTerm
    candidate: Candidate
    evidence: tuple[Evidence | None, ...]
    hierarchy: Hierarchy
    penalised: float


@final
class Search:
    """What all steps of a search share."""

    def __init__(self, reduced: Reduced, candidates: Mapping[str, Candidate], covariate: Array | None) -> None:
        functions = {key: function.candidate for key, function in reduced.functions.items()}
        self.reduced, self.candidates, self.covariate = reduced, {**candidates, **functions}, covariate
        self.options: PoolingOptions = reduced.options
        self.ways = WAYS if covariate is not None else WAYS[:2]
        self.searched = 1.0

    def scan(self, beside: Sequence[PooledTerm]) -> Pooled:
        """The statistics of all candidates beside some terms."""
        scanned = pooled(self.reduced.scans(beside), self.covariate)
        if not beside:
            engine, sites = self.options.engine, {one.site for one in self.reduced.functions.values()}
            self.searched = len(scanned.named) + len(scanned.waves) * engine.searched_orders
            self.searched += len(sites) * engine.searched_curves
        return scanned

    def forward(self, chosen: list[Selected], progress: Callable[[int], object]) -> tuple[list[Selected], Pooled]:
        """With what is significant beside it, the most likely first; and the statistics of what is left."""
        scanned = self.scan([one.term for one in chosen])
        while len(chosen) < self.options.most_effects:
            progress(len(chosen))
            more = self.best(scanned, [one.term for one in chosen])
            if more is None:
                break
            chosen = [*chosen, more]
            scanned = self.scan([one.term for one in chosen])
        return chosen, scanned

    def familywise(self, p: float, term: PooledTerm) -> float:
        """Of a term, over the search and the ways of testing (Bonferroni, with the prior of orders as weights)."""
        return min(p * self._multiplicity(term) * len(self.ways), 1.0)

    def _multiplicity(self, term: PooledTerm) -> float:
        """The factor by which the p-value of a term becomes one over the search."""
        if term.order is None:
            return self.searched
        engine = self.options.engine
        return self.searched * relative_multiplicity(log_orders(term.order, engine), engine)

    def best(self, scanned: Pooled, beside: Sequence[PooledTerm]) -> Selected | None:
        """The most likely addition; None where none is significant."""
        asked = self._likely(scanned, beside)
        if not asked:
            return None
        tried = [one for one in self.tried(asked, tuple(beside)) if self._possible(one)]
        tests = {one.term: self.tested(one.term, one.evidence, scanned.overdispersion) for one in tried}
        lines = _by_line([one for one in tried if one.term.order is not None])
        significant = [
            one
            for one in (*(one for one in tried if one.term.order is None), *lines)
            if tests[one.term][0] < self.options.engine.level
        ]
        if not significant:
            return None
        most = max(one.penalised for one in significant)
        near = [one for one in significant if most - one.penalised < self.options.engine.close]
        chosen = min(near, key=lambda one: (one.candidate.specificity, -one.penalised))
        p, way = tests[chosen.term]
        rivals = sorted(
            ((one.term, chosen.penalised - one.penalised) for one in significant if one is not chosen),
            key=lambda pair: pair[1],
        )[: self.options.engine.nearest]
        return Selected(chosen.term, chosen.candidate, way, p, tuple(rivals))

    def with_found_alone(self, chosen: list[Selected], found: Sequence[Sequence[Found]]) -> list[Selected]:
        """With effects that one recording shows by itself, over all arms, beside those that were chosen."""
        arms, level = len(self.reduced), self.options.engine.level
        alone = sorted(
            (
                (one.p_value * arms, arm, one.term)
                for arm, each in enumerate(found)
                for one in each
                if one.term is not None and one.p_value * arms < level
            ),
            key=lambda each: each[:2],
        )
        for _, arm, term in alone:
            known = term.key in self.candidates and len(chosen) < self.options.most_effects
            if not known or any(_same(term, one.term, self.options.same_line) for one in chosen):
                continue
            own = self.reduced.evidence([(term, tuple(one.term for one in chosen))])[arm][0]
            p = 1.0 if own is None else self._of_one([own], term)
            if p < level:
                chosen = [*chosen, Selected(term, self.candidates[term.key], "one", p)]
        return chosen

    def _of_one(self, evidence: Sequence[Evidence], term: PooledTerm) -> float:
        """The least p-value of single arms, over the search and the arms."""
        least = min((one.p_value for one in evidence), default=1.0)
        return min(least * self._multiplicity(term) * len(self.reduced), 1.0)

    def retested(
        self, chosen: list[Selected], over: Overdispersion
    ) -> tuple[list[Selected], list[tuple[Evidence | None, ...]]]:
        """Each beside all others, without those that are not significant there; and the evidence of each."""
        while True:
            terms = [one.term for one in chosen]
            asked: list[Asked] = [(t, tuple(o for o in terms if o != t)) for t in terms]
            columns = [tuple(column) for column in zip(*self.reduced.evidence(asked), strict=True)] if asked else []
            again = []
            for one, evidence in zip(chosen, columns, strict=True):
                p, way = self.tested(one.term, evidence, over)
                p_one = self._of_one([each for each in evidence if each is not None], one.term)
                shown: Shown = way
                if one.shown == "one" and p_one < p:
                    p, shown = p_one, "one"
                again.append(replace(one, shown=shown, p_value=p))
            if all(one.p_value < self.options.engine.level for one in again):
                return again, columns
            worst = max(range(len(again)), key=lambda i: again[i].p_value)
            chosen = [one for i, one in enumerate(again) if i != worst]

    def tested(self, term: PooledTerm, evidence: Sequence[Evidence | None], over: Overdispersion) -> tuple[float, Way]:
        """The least family-wise p-value of all ways, and the way."""
        shown, x = self._shown(evidence)
        if not shown:
            return 1.0, self.ways[0]
        return min((self.familywise(p_value(term, shown, x, way, over), term), way) for way in self.ways)

    def statistic(self, evidence: Sequence[Evidence | None], way: Way) -> float:
        """Of a term in one way of testing."""
        shown, x = self._shown(evidence)
        score, information = np.array([one.score for one in shown]), np.array([one.information for one in shown])
        return statistics(score, information, x, self.ways)[way].value

    def _shown(self, evidence: Sequence[Evidence | None]) -> tuple[list[Evidence], Array]:
        """What the arms say that show a term, and their covariate."""
        at = [i for i, one in enumerate(evidence) if one is not None]
        x = np.zeros(len(at)) if self.covariate is None else self.covariate[at]
        return [one for one in evidence if one is not None], x

    def _likely(self, scanned: Pooled, beside: Sequence[PooledTerm]) -> list[PooledTerm]:
        """The candidates and waves that are to be measured in every arm, if any is significant."""
        over, ranked = scanned.overdispersion, []
        for key, found in scanned.named.items():
            ranked.append((min(_log_tail(found[w].value / over.named[w], found[w].freedom) for w in self.ways), key))
        ranked.sort()
        grid, lines, engine = order_grid(self.options), [], self.options.engine
        among = log_orders(grid, engine)
        for key, by_way in scanned.waves.items():
            logs = np.min([_log_tails(by_way[w][0] / over.waves[w], by_way[w][1]) for w in self.ways], axis=0)
            for one in beside:
                if one.key == key and one.order is not None:
                    logs[np.abs(grid - one.order) < self.options.same_line] = 0.0
            best = int(np.argmin(logs + among))
            lines.append((float((logs + among)[best]) - np.log(engine.searched_orders), key, float(grid[best])))
        lines.sort()
        least = min([log for log, *_ in (*ranked[:1], *lines[:1])], default=0.0)
        if least + np.log(self.searched * len(self.ways)) >= np.log(engine.level):
            return []
        asked = [PooledTerm(key) for _, key in ranked[: self.options.candidates]]
        for _, key, order in lines[: self.options.lines]:
            near = order + self.options.order_step * _FINER
            orders = {
                float(max(round(order), 1)),
                *(float(o) for o in near if o >= engine.lowest_order / 2),
            }
            asked += [PooledTerm(key, o) for o in sorted(orders)]
        return asked

    def tried(self, terms: Sequence[PooledTerm], beside: tuple[PooledTerm, ...]) -> list[Tried]:
        """Terms measured in every arm beside others, those that some arm shows."""
        rows = self.reduced.evidence([(term, beside) for term in terms])
        found = []
        for term, column in zip(terms, zip(*rows, strict=True), strict=True):
            candidate = self.candidates[term.key]
            hierarchy = fitted(likelihoods(column, candidate.typical, self.covariate))
            if hierarchy is None:
                continue
            cost = self.cost(term, hierarchy.determined)
            found.append(Tried(term, candidate, tuple(column), hierarchy, hierarchy.gain - cost))
        return found

    def cost(self, term: PooledTerm, numbers: int) -> float:
        """What a term costs in log-likelihood, with its spread: Schwarz's approximation, the arms being the sample.

        The choice of an order, or of a form, among many costs as in one recording.
        """
        engine, among = self.options.engine, 0.0
        if term.order is not None:
            among = float(log_orders(term.order, engine))
        elif term.key in self.reduced.functions:
            among = float(np.log(engine.searched_shapes))
        return 0.5 * (numbers + 1) * float(np.log(len(self.reduced))) + among

    def _possible(self, one: Tried) -> bool:
        """Whether the mean is not far outside what the named effect can be."""
        mean, std = one.hierarchy.coefficients[0], one.hierarchy.std[0]
        spread = np.hypot(std, one.hierarchy.between)
        lower, upper = (np.array(bound) for bound in (one.candidate.lower, one.candidate.upper))
        limit = self.options.engine.impossible * spread
        return bool(((mean > lower - limit) & (mean < upper + limit)).all())


def _same(one: PooledTerm, other: PooledTerm, width: float) -> bool:
    if one.key != other.key:
        return False
    return one.order is None or other.order is None or abs(one.order - other.order) < width


def _by_line(tried: Sequence[Tried]) -> list[Tried]:
    """Of the waves of each site the most likely one."""
    best: dict[str, Tried] = {}
    for one in tried:
        if one.term.key not in best or one.penalised > best[one.term.key].penalised:
            best[one.term.key] = one
    return list(best.values())


def _log_tail(value: float, freedom: int) -> float:
    return float(_log_tails(np.array([value]), np.array([freedom]))[0])


def _log_tails(values: Array, freedom: Array | NDArray[np.integer]) -> Array:
    """The logarithm of the tail of χ², by its asymptotic form where that is too small for a number; 0 of no freedom."""
    k = np.maximum(freedom, 1)
    tails = chdtrc(k, values)
    half = np.maximum(values, 1e-300) / 2
    far = -half + (k / 2 - 1) * np.log(half) - gammaln(k / 2)
    logs = np.where(tails > 1e-290, np.log(np.maximum(tails, 1e-300)), far)
    return np.where(np.asarray(freedom) > 0, logs, 0.0)
