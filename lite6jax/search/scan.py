"""Everything that may explain what a model leaves, each with its evidence and what its choice costs.

Tried are the names of the catalogue, waves of every order, and Gaussian processes of every quantity, and of pairs of
them, at every component of every site. The cost is −ln of the prior probability:

| | cost |
|---|---|
| a kind: name, wave, process of one quantity, process of two, and besides a read-out that wanders or jumps | −ln p |
| a name | ln of their number, and ln 17 where a number of it is tried; −ln p in all if nearly every problem has it |
| a wave | that, and ln of the orders that it is the best of |
| a read-out that wanders | ln of these, ln of the memories |
| one that jumps | ln of these, ln of the samples |
| a process | ln of the components, −ln p of each quantity, ln of the kernels |

The probabilities p are those of a `Prior`. A site's own quantities have one of them together, all quantities the rest.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.effects import kernels
from lite6jax.estimation.evidence import Evidence, Marginal, Sums, bound, of_process
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Component, Mask, Problem, Quantity, wave_of
from lite6jax.estimation.score_test import ScoreTest, bounded_parts
from lite6jax.estimation.terms import Term
from lite6jax.search.spectrum import lines

Array = NDArray[np.floating]

SINGLE = (*kernels.SCALED, "wave", "play")
PAIRS = (
    *("line*line", "cubic*cubic", "smooth*smooth", "rough*rough", "wave*wave"),
    *(f"{a}*{b}" for pair in (("line", "smooth"), ("line", "medium"), ("line", "fine"), ("line", "rough"),
                              ("line", "wave"), ("cubic", "wave")) for a, b in (pair, pair[::-1])),
)  # fmt: skip
_ROLLOFFS = {
    "spectrum": tuple(product((3.0, 8.0, 20.0), (2.0, 4.0))),
    "wander": tuple(product((1.6, 4.0, 10.0, 24.0), (2.0,))),
}
"""Corner and slope that are tried. Of what wanders, corners are half-waves over the recording: memories of a fifth, a
13th, a 31st and a 75th of it."""
_Considered = tuple[str, str, tuple[str, ...], str, tuple[float, ...]]
Considered = frozenset[_Considered]
"""Processes by site, component, phrases of their quantities, kernel and rolloff."""
_CONSIDERED = 40
"""Processes of each scan, the likeliest, among which a search of fewer rows chooses."""
NEARLY = 2.0
"""Log odds within which the priority of names decides."""
_TURNS = 1.5 * np.pi
"""rad, the range of an angle from which a wave says more of it than a cubic."""
_REFINED_NUMBERS = 3
"""Names with a number that is tried, the likeliest, of which numbers near the best one are tried too."""
_RATIOS = np.geomspace(0.5, 2.0, 17)
"""Of these to the best one: those that are tried first are a factor of 2 to 3 apart."""
_FINEST, _GAINED = 5, 0.1
"""Rounds of ratios, each an eighth of the one before, and the gain below which no further one follows."""
_STEPS = 3
"""Linearisations of a name of several numbers that is not linear."""
_KEPT = 1 << 27
"""Of features of pairs that are kept: 1 GB. The likeliest pairs are weighed beside each model anew."""
_AT_ONCE = 1 << 22
"""Numbers of functions that are multiplied in one call: 32 MB."""
_WEIGHED = 100
"""Processes that are weighed in one call."""
_EXACT, _UNDERRATED = 60, 2.5
"""Terms, the likeliest, that are weighed exactly in autocorrelated noise, and what their log odds grow by at most.

Of 217 processes that were the likeliest of a UR10 in 1500 postures, by 2.06.
"""
_SHORTLIST, _REFINED, _BESIDE = 120, 24, 8
"""Pairs of quantities that are weighed as cubics, those of them as every kernel, and the singles that others join."""


@final
@dataclass(frozen=True, eq=False)
class Ranked:
    """A term that may be added, and what it is worth.

    Attributes:
        gain: log evidence over its absence.
        cost: −ln of its prior probability.
        volume: by which the evidence is less than the likelihood's gain.
        site: where it acts.
        cause: what it is: the label of a name, the phrases of the quantities of a process.
        place: the component of a process.
        make: makes the term.
        process: of a process, component, quantities, kernel and rolloff.
    """

    gain: float
    cost: float
    volume: float
    site: str
    cause: tuple[str, ...]
    place: str
    make: Callable[[], Term]
    process: tuple[Any, ...] = ()

    @property
    def net(self) -> float:
        """Log posterior odds of its presence."""
        return self.gain - self.cost

    @property
    def key(self) -> tuple[Any, ...]:
        """The same for processes of the same quantities at the same component, whatever their kernel."""
        return self.site, self.place, self.cause


class Pair(NamedTuple):
    """Two names that may be added together.

    Attributes:
        names: each with the gain of both.
        net: log posterior odds of the presence of both.
    """

    names: tuple[Ranked, Ranked]
    net: float


class _Equations(NamedTuple):
    """Equations of processes of one kernel at a component.

    Attributes:
        component: where.
        sets: the quantities of each process.
        pull: `(process, function)`.
        information: `(process, function, function)`.
        left: the sum of squares that is left there.
        freedom: its degrees of freedom.
    """

    component: Component
    sets: Sequence[tuple[int, ...]]
    pull: Array
    information: Array
    left: float
    freedom: float


@final
class Scan:
    """What is tried in one problem; the features of its quantities are computed once.

    Attributes:
        names: all terms with a formula.
        quantities: what processes may depend on, and at last the order of recording, in which read-outs may wander.
        drivers: how many they are without that order.
        among: the processes to choose from; None where that is all.
        prior: the probabilities of kinds.
        considered: the processes that were among the likeliest of a scan, each as its likeliest kernel.
    """

    def __init__(self, problem: Problem, options: EngineOptions, among: Considered | None = None) -> None:
        """Tries all processes, or those `among` which it is to choose."""
        self.problem, self.options, self.among = problem, options, among
        self.prior = options.prior
        self.considered = set[_Considered]()
        drivers = [one for one in problem.quantities if not one.driver.is_order]
        orders = [one for one in problem.quantities if one.driver.is_order]
        self.quantities = [*drivers, *orders]
        self.drivers = len(drivers)
        self.phrases = [one.driver.phrase for one in self.quantities]
        self.names = [*problem.candidates, *problem.shaped]
        self._features: dict[tuple[Any, ...], Array] = {}
        self._products: dict[tuple[Any, ...], Array] = {}
        self._kept = 0
        self._costs: dict[tuple[str, tuple[int, ...]], float] = {}
        self.discrete = [_is_discrete(one) for one in self.quantities]
        sites = {component.site for component in problem.components}
        self.own = {site: [k for k, one in enumerate(drivers) if _is_own(one, site)] for site in sites}
        self.wandering = [component for one in orders for component in problem.components if component.site in one.own]

    # -------------------------------------------------------------- costs

    def cost_of_name(self, term: Term) -> float:
        """Of a name at one site, and of a number that is chosen for it; even odds of what nearly every problem has."""
        if term.usual:
            return self.prior.cost("usual")
        number = 0.0 if term.chosen is None or term.periodic else np.log(len(_RATIOS))
        return float(self.prior.cost("named") + np.log(max(len(self.names), 1)) + number)

    def cost_of_process(self, site: str, which: tuple[int, ...]) -> float:
        """Of a process of one quantity or of two, any kernel, any component."""
        if which == (self.drivers,):
            return float(self.prior.cost("wandering") + np.log(len(self.wandering)) + np.log(len(_ROLLOFFS["wander"])))
        if (site, which) in self._costs:
            return self._costs[site, which]
        cost = self.prior.cost("process" if len(which) == 1 else "product")
        cost += np.log(max(len(self.problem.components), 1))
        cost += sum(self._cost_of_quantity(site, k) for k in which)
        cost += np.log(1 + len(SINGLE)) if len(which) == 1 else np.log(len(PAIRS) / 2)  # the spectrum is one more
        return self._costs.setdefault((site, which), float(cost))

    @cached_property
    def cost_of_step(self) -> float:
        """Of a read-out that jumps, any of them, at any sample."""
        return float(self.prior.cost("jump") + np.log(max(len(self.wandering), 1)) + np.log(self.problem.samples))

    @cached_property
    def time(self) -> int | None:
        """Which quantity the time is; None where there is none."""
        return next((k for k, one in enumerate(self.quantities) if one.driver.is_time), None)

    @cached_property
    def later(self) -> tuple[NDArray[np.integer], NDArray[np.integer], Array]:
        """The samples from the last to the first; and of each jump in time how many are after it, and from when on."""
        assert self.time is not None
        times = self.problem.seen(np.asarray(self.quantities[self.time].values)[None])[0]
        order = np.argsort(times, kind="stable")
        first = 1 + np.flatnonzero(np.diff(times[order]) > 0)
        return order[::-1], len(times) - first, times[order[first]]

    def _cost_of_quantity(self, site: str, k: int) -> float:
        own = self.own[site]
        share = self.prior.own_driver
        return -np.log((share / len(own) if k in own else 0.0) + (1 - share) / self.drivers)

    def may_act(self, site: str, *which: int) -> bool:
        """Whether these quantities can act at a site."""
        return all(self.quantities[k].only in ("", site) for k in which)

    def may_wander(self, component: Component) -> bool:
        """Whether a component is a read-out that may wander by itself."""
        return any(one is component for one in self.wandering)

    def suits(self, kernel: str, which: tuple[int, ...]) -> bool:
        """Whether a kernel is one of these quantities."""
        for name, k in zip(kernels.factors_of(kernel), which, strict=True):
            driver = self.quantities[k].driver
            if driver.is_order or name == "wander":
                return bool(driver.is_order) and kernel == "wander"
            if name == "step":
                return bool(driver.is_time)
            if self.discrete[k] and name != "line":
                return False
            if (name == "wave" and not driver.is_angle) or (name == "play" and not driver.is_remembered):
                return False
        return True

    # -------------------------------------------------------------- features

    def features(self, which: tuple[int, ...], kernel: str, rolloff: tuple[float, ...] = ()) -> Array:
        """The functions `(feature, sample)` of a kernel of some quantities, as they reach the samples."""
        key = which, kernel, rolloff
        if key not in self._features:
            if len(which) == 1:
                self._features[key] = self.problem.seen(self._factor(*key))
                return self._features[key]
            if key not in self._products:
                found = self._product(which, kernel)
                self._kept += found.size
                if self._kept > _KEPT:  # there are thousands of pairs
                    self._products.clear()
                    self._kept = found.size
                self._products[key] = found
                return found
            return self._products[key]
        return self._features[key]

    def _product(self, which: tuple[int, ...], kernel: str) -> Array:
        one, other = (
            self._factor((k,), name, in_product=True) for k, name in zip(which, kernels.factors_of(kernel), strict=True)
        )
        return self.problem.seen((one[:, None] * other).reshape(-1, one.shape[-1]))

    def _factor(
        self, which: tuple[int, ...], kernel: str, rolloff: tuple[float, ...] = (), in_product: bool = False
    ) -> Array:
        """The functions of a kernel of one quantity at every sample, before any filter."""
        key = which, kernel, rolloff, in_product
        if key not in self._features:
            (k,) = which
            if kernel in kernels.SCALED:
                self._features[key] = kernels.root(kernel, in_product).T @ self._every_spline(k)
            else:
                values: Any = self.quantities[k].values[None]
                run: Any = self.problem.every_run
                found = kernels.features(kernel, values, self.quantities[k].bounds, run, rolloff)
                self._features[key] = np.asarray(found)
        return self._features[key]

    def _every_spline(self, k: int) -> Array:
        key = (k,), "spline"
        if key not in self._features:
            values: Any = self.quantities[k].values
            self._features[key] = np.asarray(kernels.spline_basis(values, *self.quantities[k].bounds))
        return self._features[key]

    @cached_property
    def splines(self) -> tuple[list[int], Array]:
        """The quantities of many values, and splines `(quantity, spline, sample)` that express all their kernels."""
        many = [k for k in range(self.drivers) if not self.discrete[k]]
        none = np.zeros((0, kernels.PIECES + 3, self.problem.samples))
        return many, np.stack([self.problem.seen(self._every_spline(k)) for k in many]) if many else none

    @cached_property
    def _few(self) -> tuple[Array, NDArray[np.integer], Array]:
        """A few functions `(function, sample)` of each quantity of unit size, where each begins, and their weights."""
        parts = []
        for k, one in enumerate(self.quantities[: self.drivers]):
            kernel = "line" if self.discrete[k] else "smooth"
            own = self.features((k,), kernel)[1:4]
            if _is_angle(one):
                own = np.concatenate([own, self.features((k,), "wave")[[2, 3, 5, 6]]])
            own = own - own.mean(1, keepdims=True)
            parts.append(own / (np.sqrt(np.mean(own**2, 1, keepdims=True)) + 1e-12))
        start = np.cumsum([0, *map(len, parts[:-1])])
        weights = np.concatenate([0.6 ** np.minimum(np.arange(len(part)), 3) for part in parts])
        return np.concatenate(parts), start, weights

    @cached_property
    def processes(self) -> list[tuple[Component, tuple[int, ...], str, tuple[float, ...]]]:
        """Those that are tried, where it is not all of them."""
        components = {(one.site, one.name): one for one in self.problem.components}
        place = {phrase: k for k, phrase in enumerate(self.phrases)}
        return [
            (components[site, name], tuple(place[phrase] for phrase in phrases), kernel, rolloff)
            for site, name, phrases, kernel, rolloff in sorted(self.among or ())
            if (site, name) in components and all(phrase in place for phrase in phrases)
        ]

    def has_numbers(self, term: Term) -> bool:
        """Whether a name is one of several that differ in a number that is tried."""
        return sum(one.label == term.label for one in self.names) > 1


@final
class Weighed:
    """What is tried, beside one model, of what acts on some rows."""

    def __init__(self, scan: Scan, test: ScoreTest, rows: Mask | None = None) -> None:
        """Beside the model of a test, of sites that act on some `(row,)`; on any where these are not given."""
        self._scan, self._test, self._marginal = scan, test, Marginal(test)
        every = scan.problem.components
        self.components = [one for one in every if rows is None or np.any(one.column[rows])]
        self._problem = test.problem
        self._options, self._rows = scan.options, slice(None) if rows is None else rows
        self._known: dict[int, Sums] = {}

    def ranked(self, least: float = 0.0) -> list[Ranked]:
        """All that is worth its cost, and the best that is not, the likeliest first; of log odds from `least` on."""
        scan, white = self._scan, self._test.fit.noise.white
        least /= 1 if white else _UNDERRATED
        found = [*self.named(), *self.waves()]
        found += self.of_read_outs()
        if scan.among is None:
            found += self.spectra()
            singles = self.singles(max([least, *(one.net - self._options.close for one in found)]))
            found += [*singles, *self.pairs(singles, 0.0 if white else least)]
        else:
            there = (one for one in scan.processes if one[0] in self.components and one[2] != "wander")
            few = (self.of_kernel(*one, exact=one[2] == "spectrum") for one in there)
            found += (one for one in few if one.gain > 0)
        found.sort(key=lambda one: -one.net)
        likely = [one for one in found if one.process][:_CONSIDERED]
        scan.considered |= {(*one.key, *one.process[2:]) for one in likely}
        if white:
            return _in_order(found)
        exact, best = list[Ranked](), 0.0
        for one in found[:_EXACT]:
            if one.net < max(least, best / _UNDERRATED):
                break
            exact.append(self.exact(one))
            best = max(best, exact[-1].net)
        return _in_order([one for one in exact if one.gain > 0])

    def usual(self) -> list[Ranked]:
        """The names that nearly every problem has, the likeliest first."""
        return sorted(self.named(usual=True), key=lambda one: -one.net)

    def names_and_waves(self) -> list[Ranked]:
        """Names and waves alone, the likeliest first."""
        return _in_order([*self.named(), *self.waves()])

    def as_is(self, name: Term) -> Ranked | None:
        """A name with the number that it has; None where it says nothing."""
        return next(iter(self.of_terms([name])), None)

    def by_columns(self, name: Term, columns: Array) -> Ranked:
        """A name whose numbers change residuals by these columns `(number, row, sample)`."""
        return _of_term(self._marginal.of_names([columns])[0], self._scan.cost_of_name(name), name)

    def named(self, usual: bool = False) -> list[Ranked]:
        """Names that are not there yet, all or the usual ones; of those with a number that is tried the likeliest."""
        test = self._test
        there = {one for term in test.fit.terms.terms for one in (term, *term.includes)}
        terms = [term for term in self._scan.names if term not in there and not term.periodic]
        terms = [term for term in terms if term.usual] if usual else terms
        found = self.of_terms(terms)
        likely = sorted((one for one in found if one.make().chosen is not None), key=lambda one: -one.net)[
            :_REFINED_NUMBERS
        ]
        for one in likely:
            found = [other for other in found if other.cause != one.cause] + self._refined(one)
        return found

    def like(self, term: Term) -> Ranked | None:
        """A name with the likeliest of the numbers that are tried for it; None where it says nothing."""
        same = [one for one in self._scan.names if one.label == term.label and not term.periodic]
        found = self.of_terms([term, *same])
        if found and found[0].make().chosen and same:
            found = self._refined(found[0])
        return found[0] if found else None

    def together(self, term: Term) -> list[Pair]:
        """A name that has a number which is tried, each time with another name of its site, the likeliest pair first.

        Either alone may take another number: a spring and a play add up to a wider play.
        """
        same = [one for one in self._scan.names if one.label == term.label]
        same = [*same, *self._near(term)]
        others = [one for one in self._scan.names if one.site == term.site and one.label != term.label]
        others = [one for one in others if one.chosen is None and not one.periodic]
        return self._pairs(same, others, product(range(len(same)), range(len(others))))

    def pairs_at(self, site: str) -> list[Pair]:
        """Two names of a site that are not there yet, the likeliest pair first; waves of the lowest orders among them.

        Two may nearly cancel, as gravity and what balances it, so that either alone says little; or lie so near that a
        third explains more than either, as a wave between two orders does.
        """
        present = {one for term in self._test.fit.terms.terms for one in (term, *term.includes)}
        names = [one for one in self._scan.names if one.site == site and (one.chosen is None or one.periodic)]
        names = [one for one in names if one not in present and one.linear]
        return self._pairs(names, names, combinations(range(len(names)), 2))

    def _pairs(self, first: Sequence[Term], second: Sequence[Term], at: Iterable[tuple[int, int]]) -> list[Pair]:
        """Pairs of one of the first names with one of the second, by their places, the likeliest first."""
        model = self._test.fit.terms, self._test.fit.values
        columns = [[self._problem.columns([one], beside=model) for one in names] for names in (first, second)]
        pairs = list(at)
        if not pairs:
            return []
        evidence = self._marginal.of_names([np.concatenate([columns[0][a], columns[1][b]]) for a, b in pairs])
        weighed = []
        for (a, b), one in zip(pairs, evidence, strict=True):
            names = [
                _of_term(one, self._scan.cost_of_name(name), name, self._label(name)) for name in (first[a], second[b])
            ]
            weighed.append(Pair((names[0], names[1]), float(one.gain) - names[0].cost - names[1].cost))
        return sorted(weighed, key=lambda pair: -pair.net)

    def _label(self, name: Term) -> str:
        """The label of a name, of a wave with its order."""
        wave = wave_of(self._problem, name)
        return name.label if wave is None else f"{name.label} {wave[1]:.3g}"

    def _refined(self, one: Ranked) -> list[Ranked]:
        """A name with a number that is tried, at the likeliest near this, as fine as the data tell it."""
        found, steps = [one], _RATIOS
        for rounds in range(_FINEST):
            before, term = found[0].net, found[0].make()
            found = self.of_terms([term, *self._near(term, steps)]) or found
            if rounds and found[0].net < before + _GAINED:
                break
            steps = steps ** (2 / (len(steps) - 1))
        return found

    def _near(self, term: Term, ratios: Array = _RATIOS) -> list[Term]:
        """A name with the numbers near its own, within those of the list."""
        listed = [one.chosen for one in self._scan.names if one.label == term.label and one.chosen]
        if not term.chosen or not listed:
            return []
        near = np.clip(term.chosen * ratios, min(listed), max(listed))
        return [term.held(float(number)) for number in np.unique(near)]

    def of_terms(self, terms: Sequence[Term]) -> list[Ranked]:
        """Names, of those with one label the likeliest."""
        best: dict[str, Ranked] = {}
        for some in bounded_parts(terms, self._problem.rows * self._problem.samples):
            columns = self._problem.columns(some, beside=(self._test.fit.terms, self._test.fit.values))
            each = np.split(columns, np.cumsum([term.size for term in some])[:-1])
            each = [own if term.linear else self._at_estimate(term, own) for term, own in zip(some, each, strict=True)]
            acting = [k for k, own in enumerate(each) if np.any(own[:, self._rows])]
            weighed = self._marginal.of_names([each[k] for k in acting]) if acting else []
            for term, evidence in zip((some[k] for k in acting), weighed, strict=True):
                one = _of_term(evidence, self._scan.cost_of_name(term), term)
                if one.gain > 0 and (term.label not in best or one.net > best[term.label].net):
                    best[term.label] = one
        return list(best.values())

    def _at_estimate(self, term: Term, columns: Array) -> Array:
        """The columns of a term that is not linear where it fits best: at zero they may miss most of it."""
        model = self._test.fit.terms, self._test.fit.values
        for _ in range(_STEPS if term.size > 1 else 0):
            columns = self._problem.columns([term], self._test.score_columns([columns])[0].values, model)
        return columns

    def waves(self) -> list[Ranked]:
        """The likeliest order of each angle."""
        found = []
        families = max(len(self._problem.periodic), 1)
        for line in lines(self._test):
            column = line.family.column
            if not np.any(column[self._rows]):
                continue
            columns = (line.family.waves_of(np.array([line.order]))[0])[:, None] * column
            (evidence,) = self._marginal.of_names([columns])
            named = line.term in self._scan.names  # the lowest orders are candidates of their own
            cost = self._scan.prior.cost("wave") + np.log(families) + line.searched
            if named:
                cost = self._scan.cost_of_name(line.term)
            found.append(_of_term(evidence, float(cost), line.term, f"{line.term.label} {line.order:.3g}"))
        return [one for one in found if one.gain > 0]

    def singles(self, least: float) -> list[Ranked]:
        """Processes of one quantity that may exceed `least`, each as its likeliest kernel.

        No function of a quantity explains more than all its splines without a prior: what is less is not looked at
        closer. A play depends on the past as well and may explain more: that of a site's own quantities is always
        weighed, another one where the splines of its quantity are among the first.
        """
        many, splines = self._scan.splines
        found: list[Ranked] = []
        at, pulls, informations, limits = [], [], [], []
        for component in self.components:
            pull, information, left, freedom = self._equations(component, splines)
            most = bound(pull, information, left, freedom, self._options.confounded)
            costs = np.array([self._scan.cost_of_process(component.site, (k,)) for k in many])
            for i in np.flatnonzero(most > costs):
                if self._scan.may_act(component.site, many[i]):
                    at.append((component, many[i], left, freedom))
                    limits.append(most[i] - costs[i])
                    pulls.append(pull[i])
                    informations.append(information[i])
        few = [k for k in range(self._scan.drivers) if k not in many]
        found += self._of_all(
            (one, (k,), "line") for one in self.components for k in few if self._scan.may_act(one.site, k)
        )
        found += self._of_all(self._own_plays())
        least = max([least, *(one.net - self._options.close for one in found)])
        order = np.argsort(limits)[::-1]
        while order.size and limits[order[0]] > least:
            some, order = order[:_WEIGHED], order[_WEIGHED:]
            pull, information = np.stack([pulls[i] for i in some]), np.stack([informations[i] for i in some])
            left, freedom = (np.array([at[i][n] for i in some])[:, None, None] for n in (2, 3))
            every = [self._of_splines(name, pull, information, left, freedom) for name in kernels.SCALED]
            best = np.argmax([one.gain for one in every], 0)
            for n, (i, k) in enumerate(zip(some, best, strict=True)):
                likeliest = Evidence(*(part[n] for part in every[k]))
                found.append(self._process(likeliest, at[i][0], (at[i][1],), list(kernels.SCALED)[k]))
            others = [(at[i][0], (at[i][1],), "wave") for i in some]
            others += [(at[i][0], (at[i][1],), "play") for i in some if at[i][1] not in self._scan.own[at[i][0].site]]
            found += self._of_all(one for one in others if self._scan.suits(one[2], one[1]))
            least = max(least, max(one.net for one in found) - self._options.close)
        return _best_of_each(found)

    def _own_plays(self) -> Iterator[tuple[Component, tuple[int, ...], str]]:
        """The plays of each site's own quantities."""
        for component in self.components:
            for k in self._scan.own[component.site]:
                if self._scan.suits("play", (k,)) and self._scan.may_act(component.site, k):
                    yield component, (k,), "play"

    def _of_splines(
        self, kernel: str, pull: Array, information: Array, left: Array | float, freedom: Array | float
    ) -> Evidence:
        """The evidence of a scaled kernel, arguments as of `of_process`, of all splines."""
        R = kernels.root(kernel)
        return of_process(pull @ R, R.T @ information @ R, left, freedom, self._options.confounded)

    def of_read_outs(self) -> list[Ranked]:
        """What the read-outs that may wander do by themselves: wander with the likeliest memory, or jump once."""
        found = []
        for component in self.components:
            if self._scan.may_wander(component):
                found += self._of_rolloffs(component, self._scan.drivers, "wander", exact=True)
                found += self._steps(component)
        return _best_of_each(found)

    def _steps(self, component: Component) -> list[Ranked]:
        """The likeliest jump in time of a read-out; none where no time is known.

        Sums over the samples after each jump weigh all of them.
        """
        if self._scan.time is None:
            return []
        backwards, count, begins = self._scan.later
        if not len(begins):
            return []
        sums = self._sums(component)

        def after(of_samples: Array) -> Array:
            return np.cumsum(of_samples[..., backwards], -1)[..., count - 1]

        information = np.maximum(after(sums.weight) - np.sum(after(sums.inside) ** 2, 0), 0.0)
        gains = of_process(
            after(sums.pull)[:, None],
            information[:, None, None],
            sums.left,
            sums.freedom,
            self._options.confounded,
        ).gain
        at = float(begins[np.argmax(gains)])
        return [self.of_kernel(component, (self._scan.time,), "step", (at,), exact=True)]

    def spectra(self) -> list[Ranked]:
        """Spectra of angles at the sites whose turns they are, exactly: they vary fast."""
        found = []
        for component in self.components:
            for k, one in enumerate(self._scan.quantities[: self._scan.drivers]):
                if one.driver.turns == component.site:
                    found += self._of_rolloffs(component, k, "spectrum", exact=True)
        return _best_of_each(found)

    def _of_rolloffs(self, component: Component, k: int, kernel: str, exact: bool = False) -> list[Ranked]:
        """Every roll-off that is tried of a kernel: they differ in the size of their functions alone."""
        functions = self._scan.features((k,), kernel)[None]
        (pull,), (information,), left, freedom = self._equations(component, functions, exact)
        found = []
        for rolloff in _ROLLOFFS[kernel]:
            size = kernels.deviations(kernel, self._scan.quantities[k].bounds, rolloff)
            acting = slice(len(size))
            scaled = information[acting, acting] * np.outer(size, size)
            one = of_process(pull[acting] * size, scaled, left, freedom, self._options.confounded)
            found.append(self._process(one, component, (k,), kernel, rolloff))
        return found

    def pairs(self, singles: Sequence[Ranked], least: float) -> list[Ranked]:
        """Processes of two quantities: of a short list, the likeliest as every kernel, where one exceeds `least`."""
        plain = [self._plain(k) for k in range(self._scan.drivers)]
        short = [(component, (a, b), f"{plain[a]}*{plain[b]}") for component, a, b in self._shortlist(singles)]
        first = sorted((one for one in self._of_all(short) if one.net > least or not least), key=lambda one: -one.net)
        every = (one.process[:2] for one in first[:_REFINED])
        asked = [(*pair, kernel) for pair in every for kernel in PAIRS if self._scan.suits(kernel, pair[1])]
        return _best_of_each(self._of_all(asked))

    def _of_all(self, asked: Iterable[tuple[Component, tuple[int, ...], str]]) -> list[Ranked]:
        """Processes by component, quantities and kernel; those of one kernel are weighed together."""
        alike: dict[str, dict[int, tuple[Component, list[tuple[int, ...]]]]] = {}
        for component, which, kernel in asked:
            alike.setdefault(kernel, {}).setdefault(id(component), (component, []))[1].append(which)
        found = list[Ranked]()
        for kernel, members in alike.items():
            waiting, count = list[_Equations](), 0
            for component, sets in members.values():
                most = max(_AT_ONCE // max(self._scan.features(sets[0], kernel).size, 1), 1)
                for k in range(0, len(sets), most):
                    some = sets[k : k + most]
                    functions = np.stack([self._scan.features(which, kernel) for which in some])
                    waiting.append(_Equations(component, some, *self._equations(component, functions)))
                    count += len(some)
                    if count >= _WEIGHED:
                        found += self._together(waiting, kernel)
                        waiting, count = [], 0
            found += self._together(waiting, kernel)
        return found

    def _together(self, waiting: Sequence[_Equations], kernel: str) -> list[Ranked]:
        """Processes of one kernel, whose equations are known."""
        if not waiting:
            return []
        counts = [len(one.sets) for one in waiting]
        left = np.repeat([one.left for one in waiting], counts)[:, None, None]
        freedom = np.repeat([one.freedom for one in waiting], counts)[:, None, None]
        pull = np.concatenate([one.pull for one in waiting])
        information = np.concatenate([one.information for one in waiting])
        evidence = of_process(pull, information, left, freedom, self._options.confounded)
        places = ((one.component, which) for one in waiting for which in one.sets)
        return [
            self._process(Evidence(*numbers), *place, kernel)
            for place, numbers in zip(places, zip(*evidence, strict=True), strict=True)
        ]

    def _plain(self, k: int) -> str:
        """The kernel as which a quantity of a pair is first weighed."""
        quantity = self._scan.quantities[k]
        turns = quantity.driver.is_angle and np.ptp(quantity.values) > _TURNS
        return "line" if self._scan.discrete[k] else "wave" if turns else "cubic"

    def kernels_of(self, component: Component, which: tuple[int, ...], exact: bool = False) -> list[Ranked]:
        """Every kernel of given quantities at a component."""
        names = [name for name in (SINGLE if len(which) == 1 else PAIRS) if self._scan.suits(name, which)]
        if len(which) > 1:
            return [self.of_kernel(component, which, name, exact=exact) for name in names]
        found, k = list[Ranked](), next(iter(which))
        if k == self._scan.drivers:
            return self._of_rolloffs(component, k, "wander", exact=True)
        many, splines = self._scan.splines
        if k in many:
            (pull,), (information,), *noise = self._equations(component, splines[[many.index(k)]], exact)
            found = [
                self._process(self._of_splines(name, pull, information, *noise), component, which, name)
                for name in kernels.SCALED
            ]
            names = [name for name in names if name not in kernels.SCALED]
        found += [self.of_kernel(component, which, name, exact=exact) for name in names]
        if k == self._scan.time and self._scan.may_wander(component):
            found += self._steps(component)
        if self._scan.quantities[k].driver.turns == component.site:
            found += self._of_rolloffs(component, k, "spectrum", exact)
        return found

    def alike(self, component: Component, which: tuple[int, ...]) -> Ranked | None:
        """The likeliest kernel of given quantities at a component; None where they say nothing there."""
        return max(self.kernels_of(component, which, exact=True), key=lambda one: one.net, default=None)

    def _shortlist(self, singles: Sequence[Ranked]) -> list[tuple[Component, int, int]]:
        """Pairs with the largest scores of products of a few functions, and those of which one alone does much."""
        functions, start, weights = self._scan._few
        i, j = np.triu_indices(self._scan.drivers, 1)
        squared, scored = functions**2, []
        components = {(one.site, one.name): one for one in self.components}
        for component in self.components:
            sums = self._sums(component)
            score = (functions * sums.pull) @ functions.T
            size = (squared * sums.weight) @ squared.T
            z = score**2 / np.maximum(size, 1e-12 * size.max()) * weights[:, None] * weights
            of_pairs = np.add.reduceat(np.add.reduceat(z, start, 0), start, 1)[i, j]
            for at in np.argpartition(-of_pairs, min(40, len(of_pairs) - 1))[:40]:
                if self._scan.may_act(component.site, int(i[at]), int(j[at])):
                    scored.append((float(of_pairs[at]), component, int(i[at]), int(j[at])))
        scored.sort(key=lambda item: -item[0])
        found = {(component.site, component.name, a, b) for _, component, a, b in scored[:_SHORTLIST]}
        place = {phrase: k for k, phrase in enumerate(self._scan.phrases)}
        for one in sorted(singles, key=lambda one: -one.net)[:_BESIDE]:
            a = place[one.cause[0]]
            others = (b for b in range(self._scan.drivers) if b != a and self._scan.may_act(one.site, a, b))
            found |= {(one.site, one.place, min(a, b), max(a, b)) for b in others}
        return [(components[site, name], a, b) for site, name, a, b in sorted(found)]

    def _sums(self, component: Component) -> Sums:
        if id(component) not in self._known:
            self._known[id(component)] = self._marginal.sums(component.column)
        return self._known[id(component)]

    def exact(self, ranked: Ranked) -> Ranked:
        """A process in autocorrelated noise, where all but what varies fast are weighed as if they varied slowly."""
        if not ranked.process or ranked.process[2] in ("spectrum", "wander") or self._is_exact(ranked.process[0]):
            return ranked
        component, which, kernel, rolloff = ranked.process
        return self.of_kernel(component, which, kernel, rolloff, exact=True)

    def _is_exact(self, component: Component) -> bool:
        """Whether sums over rows suffice: in white noise, or of a component of one row."""
        return self._test.fit.noise.white or self._sums(component).row is not None

    def _equations(
        self, component: Component, functions: Array, exact: bool = False
    ) -> tuple[Array, Array, float, float]:
        """Pull and information of groups of functions `(group, function, sample)`, sum of squares and freedom."""
        if exact and not self._is_exact(component):
            each = [self._marginal.dense(one[:, None] * component.column) for one in functions]
            return np.stack([one[0] for one in each]), np.stack([one[1] for one in each]), *each[0][2:]
        sums = self._sums(component)
        return *self._marginal.equations(sums, functions), sums.left, sums.freedom

    def of_kernel(
        self,
        component: Component,
        which: tuple[int, ...],
        kernel: str,
        rolloff: tuple[float, ...] = (),
        exact: bool = False,
    ) -> Ranked:
        """A process of one kernel."""
        functions = self._scan.features(which, kernel, rolloff)[None]
        evidence = of_process(*self._equations(component, functions, exact), self._options.confounded)
        return self._process(Evidence(*(part[0] for part in evidence)), component, which, kernel, rolloff)

    def _process(
        self,
        evidence: Evidence,
        component: Component,
        which: tuple[int, ...],
        kernel: str,
        rolloff: tuple[float, ...] = (),
    ) -> Ranked:
        def make() -> Term:
            own = [self._scan.quantities[k] for k in which]
            spread = float(f"{np.sqrt(evidence.variance):.4g}")
            return self._problem.process(component, own, kernel, spread, rolloff)

        site = component.site
        cost = self._scan.cost_of_step if kernel == "step" else self._scan.cost_of_process(site, which)
        cause, process = tuple(self._scan.phrases[k] for k in which), (component, which, kernel, rolloff)
        return Ranked(float(evidence.gain), cost, float(evidence.volume), site, cause, component.name, make, process)


def _of_term(evidence: Evidence, cost: float, term: Term, label: str = "") -> Ranked:
    """A term with a formula, by its label or another one."""
    gain, volume = float(evidence.gain), float(evidence.volume)
    return Ranked(gain, cost, volume, term.site, (label or term.label,), "", lambda: term)


def _in_order(found: Sequence[Ranked]) -> list[Ranked]:
    """The likeliest first; of names that are nearly as likely as a first name, that of the highest priority.

    Of the same priority it is that of the fewest numbers.
    """
    ordered = sorted(found, key=lambda one: -one.net)
    if not ordered or ordered[0].process:
        return ordered
    near = [one for one in ordered if not one.process and one.net > ordered[0].net - NEARLY]
    first = min(near, key=lambda one: (one.make().specificity, one.make().size, -one.net))
    return [first, *(one for one in ordered if one is not first)]


def _best_of_each(found: Sequence[Ranked]) -> list[Ranked]:
    """Of processes that differ in their kernel alone, the likeliest; none that are not likely at all."""
    best: dict[Any, Ranked] = {}
    for one in found:
        if one.gain > 0 and (one.key not in best or one.gain > best[one.key].gain):
            best[one.key] = one
    return list(best.values())


def _is_own(quantity: Quantity, site: str) -> bool:
    return site in quantity.own or "" in quantity.own


def _is_discrete(quantity: Quantity) -> bool:
    return bool(quantity.driver.discrete) or len(np.unique(np.round(quantity.values[:200], 6))) <= 3


def _is_angle(quantity: Quantity) -> bool:
    return bool(quantity.driver.is_angle)
