"""The selection of the effects of a type by evidence, as in the search of one recording: add, drop, exchange.

1. Add the term whose evidence over all arms most exceeds the cost of its choice, if by a margin.
2. Drop the term that is least worth its cost beside the others, as long as one is not.
3. Where nothing more is worth adding, exchange a term, or all of a site, for whatever is likelier in its place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.populations.hierarchy import fitted
from lite6jax.populations.pooling import Asked, Pool, Reduced, Way, likelihoods, pool, weigh
from lite6jax.populations.reduced import Evidence, order_grid
from lite6jax.populations.terms import PooledTerm, Process, Tested, Tried

Array = NDArray[np.floating]

_FINER = np.linspace(-1.0, 1.0, 9)
"""Of a step of the orders that are pooled, the orders that are measured."""


class Nearest(NamedTuple):
    """A named term, and the share that it explains of what a process does."""

    term: PooledTerm
    share: float


@final
@dataclass(frozen=True)
class Selected:
    """A term of the type, or one that may be added, measured in every arm.

    Attributes:
        term: which.
        evidence: of each arm, beside the others; None of an arm that does not show it.
        gain: log evidence over its absence from all arms.
        likelihood: gain of the likelihood.
        cost: −ln of its prior probability.
        way: in which it is likeliest.
        variance: of the coefficients of a process; infinite of a name.
        rivals: terms that may stand in its place, and by how much the evidence less the cost is lower.
        nearest: of a process, the named term that explains most of it.
    """

    term: Tested
    evidence: tuple[Evidence | None, ...]
    gain: float
    likelihood: float
    cost: float
    way: Way
    variance: float
    rivals: tuple[tuple[Tested, float], ...] = ()
    nearest: Nearest | None = None

    @property
    def net(self) -> float:
        """Log posterior odds of its presence."""
        return self.gain - self.cost

    @property
    def p_value(self) -> float:
        """A bound on the probability that chance alone makes anything so likely: that of an evidence is one over it."""
        return float(min(np.exp(-self.net), 1.0))


def search(
    reduced: Reduced,
    tried: Tried,
    covariate: Array | None = None,
    progress: Callable[[int], object] = lambda effects: None,
) -> list[Selected]:
    """Selects the effects of a type.

    Args:
        reduced: the recordings.
        tried: all that they are tested for.
        covariate: `(arm,)`, what effects may drift with, or None.
        progress: called with the number of effects at each round.
    """
    return _Search(reduced, tried, covariate, progress).selected()


@final
class _Search:
    """What all steps of a search share."""

    def __init__(
        self, reduced: Reduced, tried: Tried, covariate: Array | None, progress: Callable[[int], object]
    ) -> None:
        self._reduced, self._tried, self._covariate, self._progress = reduced, tried, covariate, progress
        self._options, self._least = reduced.options, -float(np.log(reduced.options.engine.level))
        self._known: dict[frozenset[Tested], list[Selected]] = {}

    def selected(self) -> list[Selected]:
        """The effects, in the order in which they were found, with what may stand in the place of each."""
        terms = self._grown([])
        for _ in range(self._options.engine.exchanges):
            better = self._exchanged(terms)
            if better is None:
                break
            terms = self._grown(better)
        return [self._reviewed(one, [term for term in terms if term != one.term]) for one in self._beside_others(terms)]

    def _grown(self, terms: list[Tested]) -> list[Tested]:
        seen = set[Tested]()
        while len(terms) < self._options.most_effects:
            self._progress(len(terms))
            more = next((one for one in self._ranked(terms) if one.term not in seen), None)
            if more is None or more.net < self._least:
                break
            seen.add(more.term)
            terms = self._dropped([*terms, more.term])
        return terms

    def _dropped(self, terms: list[Tested]) -> list[Tested]:
        """Without those that are not worth their cost beside the others, the least of them first."""
        while terms:
            worst = min(self._beside_others(terms), key=lambda one: one.net)
            if worst.net >= self._least:
                break
            terms = [term for term in terms if term != worst.term]
        return terms

    def _exchanged(self, terms: list[Tested]) -> list[Tested] | None:
        """With another term in the place of one, or of all of a site, that is likelier; None where none is."""
        sites = [[term for term in terms if self._site(term) == site] for site in dict.fromkeys(map(self._site, terms))]
        for some in (*([term] for term in terms), *(there for there in sites if len(there) > 1)):
            rest = [term for term in terms if term not in some]
            asked: list[Asked] = [(term, (*rest, *some[:k])) for k, term in enumerate(some)]
            worth = sum(one.net for one in self._measured(asked))
            best = next(iter(self._ranked(rest)), None)
            if best is None or best.term in some or best.net < worth + self._options.engine.better:
                continue
            return self._dropped([*rest, best.term])
        return None

    def _reviewed(self, one: Selected, rest: list[Tested]) -> Selected:
        """With its rivals, and of a process the nearest name."""
        others = [other for other in self._ranked(rest) if not _same(other.term, one.term, self._options.same_line)]
        gaps = [(other.term, max(one.net - other.net, 0.0)) for other in others]
        close = [pair for pair in gaps if pair[1] < self._options.engine.close][: self._options.engine.listed]
        nearest = None
        named = [(other.likelihood, other.term) for other in others if isinstance(other.term, PooledTerm)]
        if isinstance(one.term, Process) and named:
            likelihood, term = max(named, key=lambda pair: pair[0])
            nearest = Nearest(term, float(np.clip(likelihood / one.likelihood, 0.0, 1.0)))
        return replace(one, rivals=tuple(close), nearest=nearest)

    def _site(self, term: Tested) -> str:
        return self._tried.candidate(term).site

    # -------------------------------------------------------------- what is likeliest

    def _ranked(self, beside: Sequence[Tested]) -> list[Selected]:
        """All that is likely and possible beside some terms, the likeliest first; of processes the likeliest kernel."""
        key = frozenset(beside)
        if key not in self._known:
            groups, confounded = self._tried.groups, self._options.engine.confounded
            pooled = pool(self._reduced.scans(beside, groups), confounded)
            named = [self._weighed(PooledTerm(name), each) for name, each in pooled.named.items()]
            asked: list[Asked] = [(term, tuple(beside)) for term in (*self._lines(pooled, beside), *self._likely(pooled))]
            best: dict[str, Selected] = {}
            for one in sorted([*named, *self._measured(asked)], key=lambda one: -one.net):
                if one.gain > 0 and self._is_possible(one):
                    best.setdefault(one.term.key, one)
            self._known[key] = list(best.values())
        return self._known[key]

    def _lines(self, pooled: Pool, beside: Sequence[Tested]) -> list[Tested]:
        """Waves near the likeliest order of each family, of the likeliest families."""
        orders, lines = order_grid(self._options), []
        for key, gains in pooled.waves.items():
            net = gains - self._tried.cost_of_waves(orders)
            for one in beside:
                if isinstance(one, PooledTerm) and one.key == key and one.order is not None:
                    net[np.abs(orders - one.order) < self._options.same_line] = -np.inf
            lines.append((float(net.max()), key, float(orders[np.argmax(net)])))
        found: list[Tested] = []
        for net, key, order in sorted(lines, reverse=True)[: self._options.lines]:
            if net > 0:
                near = order + self._options.order_step * _FINER
                near = near[near >= self._options.engine.lowest_order]
                found += [PooledTerm(key, o) for o in sorted({float(max(round(order), 1)), *near.tolist()})]
        return found

    def _likely(self, pooled: Pool) -> list[Tested]:
        """Processes of the likeliest quantities and pairs of them, with every kernel."""
        tried, found = self._tried, list[tuple[float, list[int]]]()
        for which, gains in ((tried.groups.singles, pooled.singles), (tried.groups.pairs, pooled.pairs)):
            nets = [gain - tried.cost_of_group(*place) for place, gain in zip(which.tolist(), gains, strict=True)]
            found += zip(nets, which.tolist(), strict=True)
        close = sorted((one for one in found if one[0] > self._least - self._options.engine.close), reverse=True)
        return [one for _, place in close[: self._options.processes] for one in tried.processes(*place)]

    # -------------------------------------------------------------- measured in every arm

    def _beside_others(self, terms: Sequence[Tested]) -> list[Selected]:
        return self._measured([(one, tuple(other for other in terms if other != one)) for one in terms])

    def _measured(self, asked: Sequence[Asked]) -> list[Selected]:
        if not asked:
            return []
        columns = zip(*self._reduced.evidence(asked), strict=True)
        return [self._weighed(term, column) for (term, _), column in zip(asked, columns, strict=True)]

    def _weighed(self, term: Tested, evidence: Sequence[Evidence | None]) -> Selected:
        found = weigh(term, evidence, self._covariate, self._options.engine.confounded)
        return Selected(
            term, tuple(evidence), found.gain, found.likelihood, self._tried.cost(term), found.way, found.variance
        )

    def _is_possible(self, one: Selected) -> bool:
        """Whether the mean is not far outside what the named effect can be, as far as that matters."""
        candidate = self._tried.candidate(one.term)
        lower, upper = np.array(candidate.lower), np.array(candidate.upper)
        if one.net < 0 or np.isinf([lower, upper]).all():
            return True
        hierarchy = fitted(likelihoods(one.evidence, candidate.typical, self._covariate, one.variance))
        assert hierarchy is not None  # what too few arms show has no evidence
        limit = self._options.engine.impossible * np.hypot(hierarchy.std[0], hierarchy.between)
        mean = hierarchy.coefficients[0]
        return bool(((mean > lower - limit) & (mean < upper + limit)).all())


def _same(one: Tested, other: Tested, width: float) -> bool:
    """Whether two terms are one, or waves that are one line, or processes of the same drivers."""
    if one.key != other.key:
        return False
    orders = [term.order for term in (one, other) if isinstance(term, PooledTerm) and term.order is not None]
    return len(orders) < 2 or abs(orders[0] - orders[1]) < width
