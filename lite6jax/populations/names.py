"""Tests of pooled names: a name of the type stands only where no function without a name is clearly likelier.

As in the search of one recording (`lite6jax.search.names`). The candidates are never all that there is. Where all arms
share what is none of them, the nearest one wins the search and is wrong; its significance says nothing of that. So
functions of every driver at every site are pooled over the arms as the names are. Where one of them, beside the names
or in the place of one or of several, is clearly likelier after the cost of its numbers, it joins the effects of the
type, and the names that it makes unnecessary leave.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from lite6jax.populations.forward import Nearest, Search, Selected, Tried
from lite6jax.populations.pooling import Overdispersion, Statistic, Way, pooled
from lite6jax.populations.reduced import PooledTerm, order_grid


class _Choice(NamedTuple):
    """A function in the place of some names, and by how much it is likelier than it must be."""

    instead: tuple[Selected, ...]
    function: Tried
    better: float


def apply_discrepancy_test(looked: Search, chosen: Sequence[Selected], over: Overdispersion) -> list[Selected]:
    """The effects with names that the recordings do not contradict, and functions without a name for what is left.

    Args:
        looked: the search.
        chosen: effects of the type, each tested beside all others.
        over: the overdispersion of what they leave.
    """
    names, chosen = _Names(looked, over), list(chosen)
    for _ in range(looked.options.engine.name_rounds if looked.reduced.functions else 0):
        better = names.likelier(chosen)
        if better is None:
            break
        chosen = names.necessary(better)
    return chosen


@final
@dataclass(frozen=True, eq=False)
class _Names:
    """What all rounds share; attributes as the arguments of `apply_discrepancy_test`."""

    looked: Search
    over: Overdispersion

    def likelier(self, chosen: list[Selected]) -> list[Selected] | None:
        """The effects with the function that is clearly likelier; None where none is."""
        engine = self.looked.options.engine
        choices = [_Choice((), one, one.penalised - engine.close) for one in self._functions(chosen)]
        named = [one for one in chosen if not self._unnamed(one) and one.shown != "one"]
        # a function that explains more in the place of one name explains something beside it too
        groups = [(one,) for one in named] if choices else []
        for site in dict.fromkeys(one.candidate.site for one in named):
            there = tuple(one for one in named if one.candidate.site == site)
            groups += [there] if len(there) > 1 else []
        for some in groups:
            choices += self._in_place_of(chosen, some)
        worth = [one for one in choices if one.better > 0]
        for best in sorted(worth, key=lambda one: -one.better):
            p, way = self.looked.tested(best.function.term, best.function.evidence, self.over)
            if p >= engine.level:
                continue
            rest = [one for one in chosen if one not in best.instead]
            rivals = [
                (one.function.term, best.function.penalised - one.function.penalised)
                for one in choices
                if one.instead == best.instead and one.function is not best.function
            ]
            nearest = self._nearest(best.function, way, [one.term for one in rest])
            rivals.sort(key=lambda pair: pair[1])
            function = Selected(best.function.term, best.function.candidate, way, p, tuple(rivals), nearest)
            return self.looked.retested([*rest, function], self.over)[0]
        return None

    def necessary(self, chosen: list[Selected]) -> list[Selected]:
        """Without names that do not pay for their numbers beside the functions, the least likely first.

        Nor do those stay that explain little beside a function at their site: that may be what it does not describe.
        """
        while True:
            measured: list[tuple[Selected, Tried]] = []
            for one in chosen:
                beside = [other.term for other in chosen if other is not one]
                measured += [(one, found) for found in self._measured([one.term], beside)]
            functions = [found for one, found in measured if self._unnamed(one)]
            leaving: list[tuple[float, Selected]] = []
            for one, found in measured:
                if self._unnamed(one) or one.shown == "one":
                    continue  # what one recording shows is tested in its own search
                there = [other.hierarchy.gain for other in functions if other.candidate.site == one.candidate.site]
                least = self.looked.options.engine.misfit * max(there, default=0.0)
                if found.penalised < 0 or found.hierarchy.gain < least:
                    leaving.append((found.penalised, one))
            if not leaving:
                return chosen
            _, worst = min(leaving, key=lambda pair: pair[0])
            chosen = self.looked.retested([one for one in chosen if one is not worst], self.over)[0]

    def _in_place_of(self, chosen: Sequence[Selected], some: tuple[Selected, ...]) -> list[_Choice]:
        """Functions in the place of one name, or of several at one site, which must be clearly likelier than one."""
        engine, rest = self.looked.options.engine, [one for one in chosen if one not in some]
        worth, beside = 0.0, [one.term for one in rest]
        for name in some:  # one beside the other
            worth += sum(one.penalised for one in self._measured([name.term], beside))
            beside.append(name.term)
        needed = worth + engine.close if len(some) == 1 else worth - engine.together * (len(some) - 1)
        return [_Choice(some, one, one.penalised - needed) for one in self._functions(rest)]

    def _functions(self, beside: Sequence[Selected]) -> list[Tried]:
        """The few functions that are most likely beside some effects, one of each site, measured in every arm."""
        looked, terms = self.looked, [one.term for one in beside]
        scanned = pooled(looked.reduced.scans_of_functions(terms), looked.covariate)
        likely: dict[str, tuple[float, PooledTerm]] = {}
        for key, by_way in scanned.named.items():
            term, site = PooledTerm(key), looked.candidates[key].site
            numbers = max(found.freedom for way, found in by_way.items() if way != "any")
            gain = max(self._gain(way, found) for way, found in by_way.items())
            penalised = gain - looked.cost(term, numbers)
            if penalised > likely.get(site, (0.0, term))[0]:
                likely[site] = (penalised, term)
        best = sorted(likely.values(), key=lambda pair: -pair[0])[: looked.options.engine.functions]
        return [one for one in self._measured([term for _, term in best], terms) if one.penalised > 0]

    def _gain(self, way: Way, found: Statistic) -> float:
        """What a statistic says of the gain in log-likelihood of the hierarchical model.

        Numbers that vary between arms gain as variances do: with a statistic r times its degrees of freedom f, f/2 (r -
        1 - log r), where all numbers are known equally well.
        """
        value = found.value / self._unit
        if way != "any":
            return 0.5 * value
        ratio = max(value / max(found.freedom, 1), 1.0)
        return 0.5 * found.freedom * (ratio - 1 - float(np.log(ratio)))

    def _measured(self, terms: Sequence[PooledTerm], beside: Sequence[PooledTerm]) -> list[Tried]:
        """Terms measured in every arm beside others, with gains in the noise that the recordings have over all."""
        looked = self.looked
        return [
            one._replace(penalised=one.hierarchy.gain / self._unit - looked.cost(one.term, one.hierarchy.determined))
            for one in (looked.tried(terms, tuple(beside)) if terms else [])
        ]

    @property
    def _unit(self) -> float:
        """By what all gains are divided, those of names and of functions alike."""
        return max(found[way] for found in (self.over.named, self.over.waves) for way in self.looked.ways)

    def _unnamed(self, one: Selected) -> bool:
        return one.term.key in self.looked.reduced.functions

    def _nearest(self, function: Tried, way: Way, beside: list[PooledTerm]) -> Nearest | None:
        """The named term that explains most of a function: what it explains without it, less what beside it."""
        looked = self.looked
        without, given = looked.scan(beside), looked.scan([*beside, function.term])
        shared = {
            PooledTerm(key): found[way].value - given.named[key][way].value for key, found in without.named.items()
        }
        orders = order_grid(looked.options)
        for key, found in without.waves.items():
            lost = found[way][0] - given.waves[key][way][0]
            shared[PooledTerm(key, float(orders[np.argmax(lost)]))] = float(lost.max())
        if not shared:
            return None
        term = max(shared, key=lambda one: shared[one])
        whole = max(looked.statistic(function.evidence, way), shared[term])
        return Nearest(term, max(shared[term] / whole, 0.0))
