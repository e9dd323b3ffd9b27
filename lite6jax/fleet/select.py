"""The selection of the effects of a type by evidence, as in the search of one recording: add, drop, exchange.

1. Add the term whose evidence over all arms most exceeds the cost of its choice, if by a margin.
2. Drop the term that is least worth its cost beside the others, as long as one is not.
3. Where nothing more is worth adding, exchange a term, or all of a site, for whatever is likelier in its place.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from lite6jax.fleet.hierarchy import fitted
from lite6jax.fleet.pooling import Asked, Reduced, Weighed, screen, weigh
from lite6jax.fleet.reduced import Evidence, order_grid
from lite6jax.fleet.terms import CUBICS, SPLINES, PooledTerm, Process, Tested, Tried

Array = NDArray[np.floating]

_FINER = np.linspace(-1.0, 1.0, 9)
"""Of a step of the orders that are pooled, the orders that are measured."""


@final
class Search:
    """Which effects the arms of a type have."""

    def __init__(
        self, reduced: Reduced, tried: Tried, progress: Callable[[int], object] = lambda effects: None
    ) -> None:
        """Computes nothing; `progress` is called with the number of effects at each round."""
        self._reduced, self._tried, self._progress = reduced, tried, progress
        self._options, self._least = reduced.options, -float(np.log(reduced.options.engine.level))
        self._known: dict[frozenset[Tested], list[Weighed]] = {}

    def selected(self) -> list[Weighed]:
        """The effects, in the order in which they were found, each with its alternatives."""
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
            worth = (one for one in self._ranked(terms) if one.term not in seen and one.sure >= self._least)
            more = next(worth, None)
            if more is None:
                break
            seen.add(more.term)
            terms = self._dropped([*terms, more.term])
        return terms

    def _dropped(self, terms: list[Tested]) -> list[Tested]:
        """Without those that are not worth their cost beside the others, the least of them first."""
        while terms:
            worst = min(self._beside_others(terms), key=lambda one: one.sure)
            if worst.sure >= self._least:
                break
            terms = [term for term in terms if term != worst.term]
        return terms

    def _exchanged(self, terms: list[Tested]) -> list[Tested] | None:
        """With another term in the place of one, or of all of a site, that is likelier; None where none is."""
        site_of = {term: self._tried.candidate(term).site for term in terms}
        sites = [[term for term in terms if site_of[term] == site] for site in dict.fromkeys(site_of.values())]
        for some in (*([term] for term in terms), *(there for there in sites if len(there) > 1)):
            rest = [term for term in terms if term not in some]
            worth = sum(one.net for one in self._measured([(one, (*rest, *some[:k])) for k, one in enumerate(some)]))
            best = next(iter(self._ranked(rest)), None)
            if best is not None and best.term not in some and best.net >= worth + self._options.engine.better:
                return self._dropped([*rest, best.term])
        return None

    def _reviewed(self, one: Weighed, rest: list[Tested]) -> Weighed:
        """With its rivals, and of a process the nearest name."""
        others = [other for other in self._ranked(rest) if not _is_same(other.term, one.term, self._options.same_line)]
        gaps = [(other.term, max(one.net - other.net, 0.0)) for other in others[: self._options.engine.listed]]
        named = [(other.likelihood, other.term) for other in others if isinstance(other.term, PooledTerm)]
        nearest = None
        if isinstance(one.term, Process) and named:
            likelihood, term = max(named, key=lambda pair: pair[0])
            nearest = term, float(np.clip(likelihood / one.likelihood, 0.0, 1.0))
        return replace(
            one, rivals=tuple(pair for pair in gaps if pair[1] < self._options.engine.close), nearest=nearest
        )

    # -------------------------------------------------------------- what is likeliest

    def _ranked(self, beside: Sequence[Tested]) -> list[Weighed]:
        """All that is likely and possible beside some terms, the likeliest first; of processes the likeliest kernel."""
        key = frozenset(beside)
        if key not in self._known:
            named, groups = screen(self._reduced.scans(beside, self._tried), self._options.engine.confounded)
            asked = [(term, tuple(beside)) for term in (*self._lines(groups, beside), *self._processes(groups))]
            found = [*(self._weighed(PooledTerm(name), each) for name, each in named.items()), *self._measured(asked)]
            best: dict[str, Weighed] = {}
            for one in sorted(found, key=lambda one: -one.net):
                if one.gain > 0 and self._is_possible(one):
                    best.setdefault(one.term.key, one)
            self._known[key] = list(best.values())
        return self._known[key]

    def _lines(self, groups: Mapping[str, Array], beside: Sequence[Tested]) -> list[Tested]:
        """Waves near the likeliest order of each family, of the likeliest families."""
        orders, lines = order_grid(self._options), []
        for key in self._tried.families:
            net = groups[key] - self._tried.cost_of_waves(orders)
            for one in beside:
                if isinstance(one, PooledTerm) and one.key == key and one.order is not None:
                    net[np.abs(orders - one.order) < self._options.same_line] = -np.inf
            lines.append((float(net.max()), key, float(orders[np.argmax(net)])))
        found: list[Tested] = []
        for net, key, order in sorted(lines, reverse=True)[: self._options.lines]:
            near = order + self._options.order_step * _FINER if net > 0 else np.zeros(0)
            likely = {max(round(order), 1.0), *near[near >= self._options.engine.lowest_order].tolist()}
            found += [PooledTerm(key, float(one)) for one in sorted(likely)] if net > 0 else []
        return found

    def _processes(self, groups: Mapping[str, Array]) -> list[Tested]:
        """Processes of the likeliest quantities and pairs of them, with every kernel."""
        screened = zip((*self._tried.singles, *self._tried.pairs), (*groups[SPLINES], *groups[CUBICS]), strict=True)
        nets = [(gain - self._tried.cost(one), one) for one, gain in screened]
        close = [pair for pair in nets if pair[0] > self._least - self._options.engine.close]
        likely = sorted(close, key=lambda pair: -pair[0])[: self._options.processes]
        return [kernel for _, one in likely for kernel in self._tried.with_every_kernel(one)]

    # -------------------------------------------------------------- measured in every arm

    def _beside_others(self, terms: Sequence[Tested]) -> list[Weighed]:
        return self._measured([(one, tuple(other for other in terms if other != one)) for one in terms])

    def _measured(self, asked: Sequence[Asked]) -> list[Weighed]:
        columns = zip(*self._reduced.evidence(asked), strict=True) if asked else ()
        return [self._weighed(term, column) for (term, _), column in zip(asked, columns, strict=True)]

    def _weighed(self, term: Tested, evidence: Sequence[Evidence | None]) -> Weighed:
        return weigh(term, evidence, self._options.engine.confounded, self._tried.cost(term))

    def _is_possible(self, one: Weighed) -> bool:
        """Whether the mean is not far outside what the named effect can be, as far as that matters."""
        candidate = self._tried.candidate(one.term)
        lower, upper = np.array(candidate.lower), np.array(candidate.upper)
        if one.net < 0 or np.isinf([lower, upper]).all():
            return True
        hierarchy = fitted(one.likelihoods(candidate.typical))
        assert hierarchy is not None  # what too few arms show has no evidence
        limit = self._options.engine.impossible * np.hypot(hierarchy.std, hierarchy.between)
        mean = hierarchy.mean
        return bool(((mean > lower - limit) & (mean < upper + limit)).all())


def _is_same(one: Tested, other: Tested, width: float) -> bool:
    """Whether two terms are one, or waves that are one line, or processes of the same drivers."""
    orders = [term.order for term in (one, other) if isinstance(term, PooledTerm) and term.order is not None]
    return one.key == other.key and (len(orders) < 2 or abs(orders[0] - orders[1]) < width)
