"""Everything that may explain what a model leaves, each with its evidence and what its choice costs.

Tried are the names of the catalogue, waves of every order, and Gaussian processes of every quantity, and of pairs of
them, at every component of every site. The cost is −ln of the prior probability:

| | cost |
|---|---|
| a kind: name, wave, process of one quantity, of two; besides: repeats, a read-out that wanders or jumps | −ln p |
| a name | ln of their number, and ln 17 where a number of it is tried; −ln p in all if nearly every problem has it |
| a wave | that, and ln of the orders that it is the best of |
| a wave beside one of its angle, a multiple or a part of it | even odds of twice or half; else ln 2 and ln of these |
| a read-out that wanders | ln of these, ln of the memories |
| one that wanders where another of its kind does | −ln p, ln of the memories |
| a hidden state: another component that wanders | −ln p, ln of these, ln of the memories |
| one at a site that has one | ln of its components, ln of the memories |
| a function of the time, beside an order of recording | −ln p besides; alone as what wanders there, and −ln p |
| one that jumps | ln of these, ln of the samples |
| what repeats with a turn | as a wave of its order, ln of the slopes |
| a wave whose size follows a quantity | as a wave of its order, −ln p of the quantity |
| a process | ln of the components, −ln p of each quantity, ln of the kernels; −ln p of a component like the first |

The probabilities p are those of a `Prior`. A site's own quantities have one of them together, all quantities the rest.
"""

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from string import digits
from typing import Any, NamedTuple, TypeGuard, final

import numpy as np

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.effects.kernels import (
    KERNELS,
    MODULATED,
    PAIRS,
    PIECES,
    SCALED,
    SINGLE,
    Kernel,
    kernel_of,
    remembers,
    spline_basis,
)
from lite6jax.estimation.evidence import Evidence, Marginal, Sums, best_amplitude, bound, log_orders_of, of_process
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Component, DriverValues, PeriodicFamily, Problem, wave_of
from lite6jax.estimation.score_test import ScoreTest, bounded_parts
from lite6jax.estimation.terms import ProcessTerm, Term, is_process
from lite6jax.estimation.thresholds import CLOSE, CONFOUNDED, LOWEST_ORDER, MARGIN
from lite6jax.search.spectrum import Line, line_of, modulated_spectrum

_KERNELS_OF = {**Counter(kernel.prior for kernel in KERNELS.values()), "product": len(PAIRS) / 2}
"""How many kernels each kind of process has."""
_ROLLED_OFF = [
    name for name, kernel in KERNELS.items() if kernel.numbers and not (kernel.any_order or kernel.any_sample)
]
"""Kernels whose numbers are tried on a grid."""
_PLAYS = [name for name in SINGLE if KERNELS[name].hysteretic]
_UNSCALED = [name for name in SINGLE if name not in (*SCALED, *_PLAYS)]
_REPEATING = [name for name, kernel in KERNELS.items() if kernel.any_order]
_JUMPING = [name for name, kernel in KERNELS.items() if kernel.any_sample]
_UNDRIVEN = [name for name, kernel in KERNELS.items() if kernel.undriven]
_MEMORIES = sum(len(kernel.grid) for kernel in KERNELS.values() if kernel.undriven)
_LEAST_CORNER = 1.6
"""Half-waves over the recording of a hidden state, and of the first read-out that wanders, at least."""
_HIDDEN = 8
"""Components that wander without a read-out, the likeliest, that are weighed exactly: one shows at up to six."""
_LEAST_IN_STEP = 2
"""Samples before a jump in time, and after it."""
_FRACTIONS = (1, 2, 3)
"""Parts of the order of the likeliest wave that are tried as the order of what repeats: its multiple may be larger."""
_OFF_ORDER = (0.3, 0.08, 0.02)
"""How far that order may be off in each round, in orders that the angles resolve."""
_MODULATED = 4
"""Waves whose size follows a quantity, of each component the likeliest, that are weighed exactly."""
_ROUGH = 1.3
"""The exact gain of such a wave is at most this times that of the rough spectrum."""
_REFINED_GAIN = 0.4
"""Of its cost, that what repeats must gain at the order of the likeliest wave: at its own it gains up to twice that."""
_REFINED_LESS = 5.0
"""By which it may gain less there than that wave alone."""
NEARLY = 2.0
"""Log odds within which the priority of names decides."""
_TURNS = 1.5 * np.pi
"""rad, the range of an angle from which a wave says more of it than a cubic."""
_NUMBER_GAIN = 0.5
"""Of its cost, that a name must gain with one of the numbers that are tried first, for others near it to be tried."""
_REFINED_NUMBERS = 3
"""Names with a number that is tried, the likeliest, of which numbers near the best one are tried too."""
_RATIOS = np.geomspace(0.5, 2.0, 17)
"""Of these to the best one: those that are tried first are a factor of 2 to 3 apart."""
_FINEST = 5
_GAINED = 0.1
"""Rounds of ratios, each an eighth of the one before, and the gain below which no further one follows."""
_STEPS = 3
"""Linearisations of a name of several numbers that is not linear."""
_KEPT = 1 << 27
"""Of features of pairs that are kept: 1 GB. The likeliest pairs are weighed beside each model anew."""
_AT_ONCE = 1 << 22
"""Numbers of functions that are multiplied in one call: 32 MB."""
_WEIGHED = 100
"""Processes that are weighed in one call."""
_EXACT = 60
_UNDERRATED = 2.5
"""Terms, the likeliest, that are weighed exactly in autocorrelated noise, and what their log odds grow by at most.

Of 217 processes that were the likeliest of a UR10 in 1500 postures, by 2.06.
"""
_SHORTLIST = 120
_REFINED = 24
_BESIDE = 8
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


def is_wander(term: Term) -> TypeGuard[ProcessTerm]:
    """Tells whether a term is what wanders by itself, which nothing recorded drives: a read-out, or a hidden state."""
    return is_process(term) and kernel_of(term.kernel).undriven


def read_outs_of(problem: Problem) -> frozenset[str]:
    """The sites whose read-out may wander: what does so there is noise, and elsewhere it is a hidden state."""
    return frozenset(site for quantity in problem.quantities if quantity.driver.is_order for site in quantity.own)


@final
class Scan:
    """What is tried in one problem; the features of its quantities are computed once.

    Attributes:
        names: all terms with a formula.
        listed: the same as a set.
        quantities: what processes may depend on, and at last the order of recording, in which anything may wander.
        drivers: how many they are without that order.
        names_alone: whether no process is tried but what repeats and what wanders.
        prior: the probabilities of kinds.
    """

    def __init__(self, problem: Problem, options: EngineOptions, names_alone: bool = False) -> None:
        self.problem = problem
        self.options = options
        self.names_alone = names_alone
        self.prior = options.prior
        drivers = [quantity for quantity in problem.quantities if not quantity.driver.is_order]
        orders = [quantity for quantity in problem.quantities if quantity.driver.is_order]
        self.quantities = [*drivers, *orders]
        self.drivers = len(drivers)
        self.phrases = [quantity.driver.phrase for quantity in self.quantities]
        self.names = [*problem.candidates, *problem.shaped]
        self.listed = frozenset(self.names)
        self._features: dict[tuple[Any, ...], Array] = {}
        self._products: dict[tuple[Any, ...], Array] = {}
        self._kept = 0
        self._costs: dict[tuple[str, tuple[int, ...], str], float] = {}
        self.discrete = [_is_discrete(quantity) for quantity in self.quantities]
        sites = {component.site for component in problem.components}
        self.own = {site: [k for k, quantity in enumerate(drivers) if _is_own(quantity, site)] for site in sites}
        self.has_order = bool(orders)
        self.read_outs = read_outs_of(problem)
        self._read_out_count = max(sum(self.is_read_out(component.site) for component in problem.components), 1)
        self._hidden_count = max(len(problem.components) - self._read_out_count, 1)

    # -------------------------------------------------------------- costs

    def cost_of_name(self, term: Term) -> float:
        """Cost of a name at a site and of a number chosen for it; even odds of what nearly every problem has."""
        if term.usual:
            return self.prior.cost("usual")
        number = 0.0 if term.chosen is None or term.periodic else np.log(len(_RATIOS))
        return float(self.prior.cost("named") + np.log(max(len(self.names), 1)) + number)

    def cost_of_process(self, site: str, which: tuple[int, ...], kind: str = "") -> float:
        """Cost of a process of one quantity or of two, any kernel of its kind, any component."""
        if which == (self.drivers,):
            return self._cost_of_wander(site)
        if self.has_order and which == (self.time,):
            return self._cost_of_wander(site) + self.prior.cost("time_itself")
        kind = kind or ("process" if len(which) == 1 else "product")
        if (site, which, kind) in self._costs:
            return self._costs[site, which, kind]
        cost = self.prior.cost(kind)
        cost += np.log(max(len(self.problem.components), 1))
        cost += sum(self._cost_of_quantity(site, k) for k in which)
        cost += np.log(_KERNELS_OF[kind])
        return self._costs.setdefault((site, which, kind), float(cost))

    def cost_of_component(self, component: Component) -> float:
        """Cost of a component among those that are alike; nothing of the first of them."""
        return self.prior.cost(component.prior) if component.prior else 0.0

    def _cost_of_wander(self, site: str) -> float:
        """Cost of what wanders, any of its kind, with any memory: a read-out, or a hidden state."""
        kind, count = "hidden_state", self._hidden_count
        if self.is_read_out(site):
            kind, count = "wandering", self._read_out_count
        return float(self.prior.cost(kind) + np.log(count) + np.log(_MEMORIES))

    def cost_of_wander_beside(self, site: str, others: Sequence[Term]) -> float | None:
        """Cost of a read-out that wanders beside one of its kind, of a hidden state where its site has one; or None."""
        wandering = [other.site for other in others if is_wander(other)]
        if not self.is_read_out(site):
            count = sum(component.site == site for component in self.problem.components)
            return float(np.log(count) + np.log(_MEMORIES)) if site in wandering else None
        kind = site.rstrip(digits)
        alike = [other for other in wandering if other.rstrip(digits) == kind]
        return float(self.prior.cost("alike") + np.log(_MEMORIES)) if alike else None

    def cost_of_wave(self, term: Term, others: Sequence[Term]) -> float | None:
        """Cost of a wave beside other terms; None of a term that is no wave of a fixed order.

        An eccentric part makes waves of several whole multiples of its turn. Where one is there, one of twice its order
        is as probable as not, and else the multiple is chosen as whole orders are.
        """
        wave = wave_of(self.problem, term)
        if wave is None:
            return None
        family, order = wave
        cost = self._cost_of_order("wave", family, order)
        if term in self.names:  # the lowest orders are candidates of their own
            cost = self.cost_of_name(term)
        waves = [wave_of(self.problem, other) for other in others if other.site == term.site]
        for other_family, other_order in (other for other in waves if other is not None):
            multiple = max(order, other_order) / min(order, other_order)
            if other_family is family and multiple > 1 and multiple % 1 == 0:
                of_choice = float(np.exp(-log_orders_of(family, multiple, self.options)))
                of_twice = 1.0 if multiple == 2 else 0.0
                overtone = self.prior.overtone
                cost = min(cost, float(-np.log(overtone * of_twice + (1 - overtone) * of_choice)))
        return cost

    def cost_of_kernel(self, site: str, which: tuple[int, ...], kernel: Kernel, rolloff: tuple[float, ...]) -> float:
        """Cost of a process of one kernel at a site; where its order or its sample is searched, of that choice."""
        if kernel.any_sample:
            of_samples = float(np.log(self.problem.samples))
            return self.prior.cost(kernel.prior) + float(np.log(self._read_out_count)) + of_samples
        if not kernel.any_order:
            return self.cost_of_process(site, which, kernel.prior)
        family = self.family_of(site)
        if family is None:
            return self.cost_of_process(site, which)
        cost = self._cost_of_order(kernel.prior, family, rolloff[0]) + float(np.log(len(kernel.grid)))
        others = [k for k, factor in zip(which, kernel.factors, strict=True) if not factor.any_order]
        return cost + sum(float(self._cost_of_quantity(site, k)) for k in others)

    def _cost_of_order(self, kind: str, family: PeriodicFamily, order: float) -> float:
        """Cost of a kind, an angle, any of them, and an order of it."""
        families = max(len(self.problem.periodic), 1)
        return float(self.prior.cost(kind) + np.log(families) + log_orders_of(family, order, self.options))

    def turns(self, component: Component, k: int) -> bool:
        """Tells whether a quantity counts the turns of a component's site."""
        return self.quantities[k].driver.turns == component.site

    def family_of(self, site: str) -> PeriodicFamily | None:
        """The waves of a site's own turns; None where it has none, or of a slide, whose turns are its strokes."""
        return next((family for family in self.problem.periodic if family.site == site and family.whole), None)

    @cached_property
    def time(self) -> int | None:
        """Which quantity the time is; None where there is none."""
        return next((k for k, quantity in enumerate(self.quantities) if quantity.driver.is_time), None)

    @cached_property
    def later(self) -> tuple[Integers, Integers, Array]:
        """The samples from the last to the first; and of each jump in time how many are after it, and from when on."""
        assert self.time is not None
        times = self.problem.seen(np.asarray(self.quantities[self.time].values)[None])[0]
        order = np.argsort(times, kind="stable")
        first = 1 + np.flatnonzero(np.diff(times[order]) > 0)
        return order[::-1], len(times) - first, times[order[first]]

    def _cost_of_quantity(self, site: str, k: int) -> float:
        site_quantities = self.own[site]
        share = self.prior.own_driver
        probability = (1 - share) / self.drivers
        if k in site_quantities:
            probability += share / len(site_quantities)
        further = self.prior.cost("time_itself") if self.has_order and k == self.time else 0.0
        return further - np.log(probability)

    def may_act(self, site: str, *which: int) -> bool:
        """Tells whether these quantities can act at a site."""
        return all(self.quantities[k].only in ("", site) for k in which)

    def is_read_out(self, site: str) -> bool:
        """Tells whether what wanders at a site is a read-out, which is noise."""
        return site in self.read_outs

    def partners(self, component: Component, k: int) -> list[int]:
        """The quantities that the size of a wave of a component's angle may follow, of those that are to be tried."""
        return [j for j in range(self.drivers) if j != k and self.may_act(component.site, k, j)]

    def suits(self, kernel: str, which: tuple[int, ...]) -> bool:
        """Tells whether a kernel is one of these quantities."""
        factors = kernel_of(kernel).factors
        return all(
            factor.suits(self.quantities[k].driver, self.discrete[k]) for factor, k in zip(factors, which, strict=True)
        )

    # -------------------------------------------------------------- features

    def features(self, which: tuple[int, ...], kernel: str, rolloff: tuple[float, ...] = ()) -> Array:
        """The functions `(feature, sample)` of a kernel of some quantities, as they reach the samples."""
        key = which, kernel, rolloff
        if key not in self._features:
            if len(which) == 1:
                self._features[key] = self.problem.seen(self._factor(which, kernel_of(kernel), rolloff))
                return self._features[key]
            if kernel_of(kernel).any_order:
                return self._product(which, kernel, rolloff)
            if key not in self._products:
                functions = self._product(which, kernel)
                self._kept += functions.size
                if self._kept > _KEPT:  # there are thousands of pairs
                    self._products.clear()
                    self._kept = functions.size
                self._products[key] = functions
                return functions
            return self._products[key]
        return self._features[key]

    def _product(self, quantity_indices: tuple[int, ...], kernel: str, rolloff: tuple[float, ...] = ()) -> Array:
        first, second = (
            self._factor((k,), factor, rolloff if factor.any_order else ())
            for k, factor in zip(quantity_indices, kernel_of(kernel).factors, strict=True)
        )
        return self.problem.seen((first[:, None] * second).reshape(-1, first.shape[-1]))

    def _factor(self, quantity_indices: tuple[int, ...], kernel: Kernel, rolloff: tuple[float, ...] = ()) -> Array:
        """The functions of a kernel of one quantity at every sample, before any filter."""
        key = quantity_indices, kernel, rolloff
        if key in self._features:
            return self._features[key]
        (k,) = quantity_indices
        if kernel.scaled:
            functions = kernel.root.T @ self._every_spline(k)
        else:
            values: Any = self.quantities[k].values[None]
            run: Any = self.problem.every_run
            functions = np.asarray(kernel.features(values, self.quantities[k].bounds, run, rolloff))
        if not kernel.any_order:
            self._features[key] = functions
        return functions

    def _every_spline(self, k: int) -> Array:
        key = (k,), "spline"
        if key not in self._features:
            values: Any = self.quantities[k].values
            self._features[key] = np.asarray(spline_basis(values, *self.quantities[k].bounds))
        return self._features[key]

    @cached_property
    def splines(self) -> tuple[list[int], Array]:
        """The quantities of many values, and splines `(quantity, spline, sample)` that express all their kernels."""
        continuous = [k for k in range(self.drivers) if not self.discrete[k]]
        none = np.zeros((0, PIECES + 3, self.problem.samples))
        return continuous, np.stack(
            [self.problem.seen(self._every_spline(k)) for k in continuous]
        ) if continuous else none

    @cached_property
    def _few(self) -> tuple[Array, Integers, Array]:
        """A few functions `(function, sample)` of each quantity of unit size, where each begins, and their weights."""
        parts = []
        for k, quantity in enumerate(self.quantities[: self.drivers]):
            kernel = "line" if self.discrete[k] else "smooth"
            functions = self.features((k,), kernel)[1:4]
            if _is_angle(quantity):
                functions = np.concatenate([functions, self.features((k,), "wave")[[2, 3, 5, 6]]])
            functions = functions - functions.mean(1, keepdims=True)
            parts.append(functions / (np.sqrt(np.mean(functions**2, 1, keepdims=True)) + 1e-12))
        start = np.cumsum([0, *map(len, parts[:-1])])
        weights = np.concatenate([0.6 ** np.minimum(np.arange(len(part)), 3) for part in parts])
        return np.concatenate(parts), start, weights

    def has_numbers(self, term: Term) -> bool:
        """Tells whether a name is one of several that differ in a number that is tried."""
        return sum(name.label == term.label for name in self.names) > 1


@final
class ModelScan:
    """What is tried, beside one model, of what acts on some rows."""

    def __init__(
        self,
        scan: Scan,
        test: ScoreTest,
        rows: Mask | None = None,
        likely: Component | None = None,
        through_loop: bool = False,
    ) -> None:
        """Beside the model of a test, of sites that act on some `(row,)`; on any where these are not given.

        Of the components that are alike the first is looked at, or the likely one where it is among them. Functions
        pass the loop of a component or, which is faster, are taken as if they varied slowly.
        """
        self._through_loop = through_loop
        self._scan = scan
        self._test = test
        self._marginal = Marginal(test)
        components = scan.problem.components
        if likely is not None:
            is_like = [any(other.place == likely.place for other in component.alike) for component in components]
            components = [likely if alike else first for first, alike in zip(components, is_like, strict=True)]
        self.components = [component for component in components if rows is None or np.any(component.column[rows])]
        self._problem = test.problem
        self._options = scan.options
        self._rows = slice(None) if rows is None else rows
        self._lines: dict[int, Line | None] = {}
        self._waves: dict[int, Ranked] = {}

    def ranked(self, least: float = 0.0) -> list[Ranked]:
        """All that is worth its cost, and the best that is not, the likeliest first; of log odds from `least` on."""
        return self._ranked([*self.named(), *self.waves()], least)

    def processes_of(self, component: Component) -> list[Ranked]:
        """The processes of a component that are worth their cost, and the best that is not, the likeliest first."""
        alone = ModelScan(self._scan, self._test)
        alone.components = [component]
        return alone._ranked([], 0.0)

    def _ranked(self, candidates: list[Ranked], least: float) -> list[Ranked]:
        """As `ranked`, of some candidates and all processes."""
        white = self._test.fit.noise.white
        least /= 1 if white else _UNDERRATED
        candidates = [*candidates, *self.repeating(), *self.of_read_outs(), *self.hidden_states()]
        if not self._scan.names_alone:
            candidates += self.modulated(max([least, *(candidate.net - CLOSE for candidate in candidates)]))
            candidates += self.spectra()
            singles = self.singles(max([least, *(candidate.net - CLOSE for candidate in candidates)]))
            candidates += [*singles, *self.pairs(singles, 0.0 if white else least)]
        candidates.sort(key=lambda candidate: -candidate.net)
        if white:
            return _in_order(candidates)
        exact = list[Ranked]()
        best_odds = 0.0
        for candidate in candidates[:_EXACT]:
            if candidate.net < max(least, best_odds / _UNDERRATED):
                break
            exact.append(self.exact(candidate))
            best_odds = max(best_odds, exact[-1].net)
        return _in_order([candidate for candidate in exact if candidate.gain > 0])

    def usual(self) -> list[Ranked]:
        """The names that nearly every problem has, the likeliest first."""
        return sorted(self.named(usual=True), key=lambda candidate: -candidate.net)

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
        present = {included for term in test.fit.terms.terms for included in (term, *term.includes)}
        terms = [term for term in self._scan.names if term not in present and not term.periodic]
        terms = [term for term in terms if term.usual] if usual else terms
        candidates = self.of_terms(terms)
        with_number = [
            candidate
            for candidate in candidates
            if candidate.make().chosen is not None and candidate.gain > _NUMBER_GAIN * candidate.cost
        ]
        likely = sorted(with_number, key=lambda candidate: -candidate.net)[:_REFINED_NUMBERS]
        for name in likely:
            candidates = [candidate for candidate in candidates if candidate.cause != name.cause] + self._refined(name)
        return candidates

    def like(self, term: Term) -> Ranked | None:
        """A name with the likeliest of the numbers that are tried for it; None where it says nothing."""
        variants = [variant for variant in self._scan.names if variant.label == term.label and not term.periodic]
        candidates = self.of_terms([term, *variants])
        if candidates and candidates[0].make().chosen and variants:
            candidates = self._refined(candidates[0])
        return candidates[0] if candidates else None

    def together(self, term: Term) -> list[Pair]:
        """A name that has a number which is tried, each time with another name of its site, the likeliest pair first.

        Either alone may take another number: a spring and a play add up to a wider play.
        """
        variants = [variant for variant in self._scan.names if variant.label == term.label]
        variants = [*variants, *self._near(term)]
        partners = [
            partner for partner in self._scan.names if partner.site == term.site and partner.label != term.label
        ]
        partners = [partner for partner in partners if partner.chosen is None and not partner.periodic]
        return self._pairs(variants, partners, product(range(len(variants)), range(len(partners))))

    def pairs_at(self, site: str) -> list[Pair]:
        """Two names of a site that are not there yet, the likeliest pair first; waves of the lowest orders among them.

        Two may nearly cancel, as gravity and what balances it, so that either alone says little; or lie so near that a
        third explains more than either, as a wave between two orders does.
        """
        present = {included for term in self._test.fit.terms.terms for included in (term, *term.includes)}
        names = [name for name in self._scan.names if name.site == site and (name.chosen is None or name.periodic)]
        names = [name for name in names if name not in present and name.linear]
        return self._pairs(names, names, combinations(range(len(names)), 2))

    def _pairs(self, first: Sequence[Term], second: Sequence[Term], at: Iterable[tuple[int, int]]) -> list[Pair]:
        """Pairs of one of the first names with one of the second, by their places, the likeliest first."""
        model = self._test.fit.terms, self._test.fit.values
        columns = [[self._problem.columns([name], beside=model) for name in names] for names in (first, second)]
        pairs = list(at)
        if not pairs:
            return []
        evidence = self._marginal.of_names([np.concatenate([columns[0][a], columns[1][b]]) for a, b in pairs])
        weighed = []
        for (a, b), joint_evidence in zip(pairs, evidence, strict=True):
            cost_beside = self._scan.cost_of_wave(second[b], [first[a]])
            if cost_beside is None:
                cost_beside = self._scan.cost_of_name(second[b])
            costs = [self._scan.cost_of_name(first[a]), cost_beside]
            names = [
                _of_term(joint_evidence, cost, name, self._label(name))
                for name, cost in zip((first[a], second[b]), costs, strict=True)
            ]
            weighed.append(Pair((names[0], names[1]), float(joint_evidence.gain) - names[0].cost - names[1].cost))
        return sorted(weighed, key=lambda pair: -pair.net)

    def _label(self, name: Term) -> str:
        """The label of a name, of a wave with its order."""
        wave = wave_of(self._problem, name)
        return name.label if wave is None else f"{name.label} {wave[1]:.3g}"

    def _refined(self, ranked: Ranked) -> list[Ranked]:
        """A name with a number that is tried, at the likeliest near this, as fine as the data tell it."""
        candidates = [ranked]
        steps = _RATIOS
        for rounds in range(_FINEST):
            before = candidates[0].net
            term = candidates[0].make()
            candidates = self.of_terms([term, *self._near(term, steps)]) or candidates
            if rounds and candidates[0].net < before + _GAINED:
                break
            steps = steps ** (2 / (len(steps) - 1))
        return candidates

    def _near(self, term: Term, ratios: Array = _RATIOS) -> list[Term]:
        """A name with the numbers near its own, within those of the list."""
        listed = [name.chosen for name in self._scan.names if name.label == term.label and name.chosen]
        if not term.chosen or not listed:
            return []
        near = np.clip(term.chosen * ratios, min(listed), max(listed))
        return [term.held(float(number)) for number in np.unique(near)]

    def of_terms(self, terms: Sequence[Term]) -> list[Ranked]:
        """Names, of those with one label the likeliest."""
        likeliest: dict[str, Ranked] = {}
        for part in bounded_parts(terms, self._problem.rows * self._problem.samples):
            blocks = self._columns_of(part)
            acting = [k for k, block in enumerate(blocks) if np.any(block[:, self._rows])]
            keys = [part[k] if part[k] in self._scan.listed else None for k in acting]
            weighed = self._marginal.of_names([blocks[k] for k in acting], keys=keys) if acting else []
            for term, evidence in zip((part[k] for k in acting), weighed, strict=True):
                candidate = _of_term(evidence, self._scan.cost_of_name(term), term)
                if candidate.gain > 0 and (term.label not in likeliest or candidate.net > likeliest[term.label].net):
                    likeliest[term.label] = candidate
        return list(likeliest.values())

    def _columns_of(self, terms: Sequence[Term]) -> list[Array]:
        """The columns `(number, row, sample)` of names beside the model.

        Those of linear names are computed once, but of problems whose columns depend on what else the model has.
        """
        by_term = dict[Term, Array]()
        for term in terms:
            columns = self._marginal.columns_of(term) if term.linear and not self._problem.curved else None
            if columns is not None:
                by_term[term] = columns
        new = [term for term in terms if term not in by_term]
        columns = self._problem.columns(new, beside=(self._test.fit.terms, self._test.fit.values))
        ends = np.cumsum([term.size for term in new], dtype=int)
        for term, end in zip(new, ends, strict=True):
            block = columns[end - term.size : end]
            by_term[term] = block if term.linear else self._at_estimate(term, block)
        return [by_term[term] for term in terms]

    def _at_estimate(self, term: Term, columns: Array) -> Array:
        """The columns of a term that is not linear where it fits best: at zero they may miss most of it."""
        model = self._test.fit.terms, self._test.fit.values
        for _ in range(_STEPS if term.size > 1 else 0):
            columns = self._problem.columns([term], self._test.score_columns([columns])[0].values, model)
        return columns

    def waves(self) -> list[Ranked]:
        """The likeliest order of each angle."""
        families = [family for family in self._problem.periodic if np.any(family.column[self._rows])]
        candidates = [self._wave(line) for family in families if (line := self._line(family)) is not None]
        return [candidate for candidate in candidates if candidate.gain > 0]

    def _wave(self, line: Line) -> Ranked:
        """The likeliest order of an angle; computed once."""
        if id(line) not in self._waves:
            self._waves[id(line)] = self._weighed_wave(line)
        return self._waves[id(line)]

    def _weighed_wave(self, line: Line) -> Ranked:
        columns = (line.family.waves_of(np.array([line.order]))[0])[:, None] * line.family.column
        (evidence,) = self._marginal.of_names([columns])
        cost = self._scan.cost_of_wave(line.term, ())
        assert cost is not None
        return _of_term(evidence, cost, line.term, f"{line.term.label} {line.order:.3g}")

    def singles(self, least: float) -> list[Ranked]:
        """Processes of one quantity that may exceed `least`, each as its likeliest kernel.

        No function of a quantity explains more than all its splines without a prior: what is less is not looked at
        closer. A play depends on the past as well and may explain more: that of a site's own quantities is always
        weighed, another one where the splines of its quantity are among the first.
        """
        continuous, splines = self._scan.splines
        candidates: list[Ranked] = []
        at = []
        pulls = []
        informations = []
        limits = []
        for component in self.components if continuous else ():
            pull, information, residual_sum, freedom = self._equations(
                component, splines, [((k,), "splines") for k in continuous]
            )
            upper_bounds = bound(pull, information, residual_sum, freedom, CONFOUNDED)
            costs = np.array([self._scan.cost_of_process(component.site, (k,)) for k in continuous])
            for i in np.flatnonzero(upper_bounds > costs):
                if self._scan.may_act(component.site, continuous[i]):
                    at.append((component, continuous[i], residual_sum, freedom))
                    limits.append(upper_bounds[i] - costs[i])
                    pulls.append(pull[i])
                    informations.append(information[i])
        discrete = [k for k in range(self._scan.drivers) if k not in continuous]
        candidates += self._of_all(
            (component, (k,), "line")
            for component in self.components
            for k in discrete
            if self._scan.may_act(component.site, k)
        )
        candidates += self._of_all(self._own_plays())
        least = max([least, *(candidate.net - CLOSE for candidate in candidates)])
        order = np.argsort(limits)[::-1]
        while order.size and limits[order[0]] > least:
            batch = order[:_WEIGHED]
            order = order[_WEIGHED:]
            pull = np.stack([pulls[i] for i in batch])
            information = np.stack([informations[i] for i in batch])
            residual_sum, freedom = (np.array([at[i][n] for i in batch])[:, None, None] for n in (2, 3))
            evidence_by_kernel = [self._of_splines(name, pull, information, residual_sum, freedom) for name in SCALED]
            best_kernels = np.argmax([evidence.gain for evidence in evidence_by_kernel], 0)
            for n, (i, k) in enumerate(zip(batch, best_kernels, strict=True)):
                likeliest = Evidence(*(part[n] for part in evidence_by_kernel[k]))
                candidates.append(self._process(likeliest, at[i][0], (at[i][1],), SCALED[k]))
            processes = [(at[i][0], (at[i][1],), name) for name in _UNSCALED for i in batch]
            processes += [
                (at[i][0], (at[i][1],), name)
                for name in _PLAYS
                for i in batch
                if at[i][1] not in self._scan.own[at[i][0].site]
            ]
            candidates += self._of_all(process for process in processes if self._scan.suits(process[2], process[1]))
            least = max(least, max(candidate.net for candidate in candidates) - CLOSE)
        return _best_of_each(candidates)

    def _own_plays(self) -> Iterator[tuple[Component, tuple[int, ...], str]]:
        """The plays of each site's own quantities."""
        for component in self.components:
            for k in self._scan.own[component.site]:
                for name in _PLAYS:
                    if self._scan.suits(name, (k,)) and self._scan.may_act(component.site, k):
                        yield component, (k,), name

    def _of_splines(
        self, kernel: str, pull: Array, information: Array, residual_sum: Array | float, freedom: Array | float
    ) -> Evidence:
        """The evidence of a scaled kernel, arguments as of `of_process`, of all splines."""
        R = KERNELS[kernel].root
        return of_process(pull @ R, R.T @ information @ R, residual_sum, freedom, CONFOUNDED)

    def of_read_outs(self) -> list[Ranked]:
        """What the read-outs that may wander do by themselves: wander with the likeliest memory, or jump once.

        The first one that wanders has a memory of a fifth of the recording at most: what varies more slowly is an
        offset, unless others of its kind wander.
        """
        candidates = []
        for component in self.components:
            if self._scan.is_read_out(component.site):
                wandering = self._of_wander(component)
                if self._scan.cost_of_wander_beside(component.site, self._test.fit.terms.terms) is None:
                    wandering = _of_short_memory(wandering)
                candidates += wandering
                candidates += self._steps(component)
        return _best_of_each(candidates)

    def hidden_states(self) -> list[Ranked]:
        """What nobody recorded and no read-out does: components that wander, the likeliest weighed exactly.

        They have a memory of a fifth of the recording at most: what varies more slowly is a function of the time. Where
        independent noise at the component explains as much, that is larger there than at others, and nothing wanders.
        """
        hidden = [component for component in self.components if not self._scan.is_read_out(component.site)]
        if not self._scan.has_order or not hidden:
            return []
        present = self._test.fit.terms.terms
        costs = []
        for component in hidden:
            cost = self._scan.cost_of_wander_beside(component.site, present)
            if cost is None:
                cost = self._scan.cost_of_process(component.site, (self._scan.drivers,))
            costs.append(cost)
        rough = _ROUGH * self._rough_gains_of_wander(hidden) - costs
        candidates = []
        for place in np.argsort(-rough)[:_HIDDEN]:
            if rough[place] > 0:
                noise = float(self._marginal.of_noise(hidden[place].column).gain)
                candidates += [wander for wander in self._of_wander(hidden[place]) if wander.gain > noise + MARGIN]
        return _best_of_each(candidates)

    def _of_wander(self, component: Component) -> list[Ranked]:
        """What wanders at a component, with each memory that it may have there."""
        wandering = self._of_rolloffs(component, self._scan.drivers, exact=True)
        if self._scan.is_read_out(component.site):
            return wandering
        samples = self._problem.samples
        return [ranked for ranked in _of_short_memory(wandering) if remembers(ranked.process[3], samples)]

    def _rough_gains_of_wander(self, components: Sequence[Component]) -> Array:
        """The evidence of what wanders at each component, as if its waves had nothing in common."""
        k = self._scan.drivers
        bounds = self._scan.quantities[k].bounds
        gains = np.zeros(len(components))
        all_sums = [self._sums(component) for component in components]
        for name in _UNDRIVEN:
            kernel = KERNELS[name]
            functions = self._scan.features((k,), name)
            grid = [numbers for numbers in kernel.grid if numbers[0] >= _LEAST_CORNER]
            sizes = np.zeros((len(grid), len(functions)))
            for row, numbers in zip(sizes, grid, strict=True):
                deviations = kernel.deviations(bounds, numbers)
                row[: len(deviations)] = deviations
            pulls = np.stack([functions @ sums.pull for sums in all_sums])
            informations = np.stack(
                [
                    self._marginal.information_of_each(sums, functions, (component.site, component.name, name, "each"))
                    for component, sums in zip(components, all_sums, strict=True)
                ]
            )
            residual_sums = np.array([sums.left for sums in all_sums])[:, None, None, None]
            freedoms = np.array([sums.freedom for sums in all_sums])[:, None, None, None]
            variances = np.maximum(informations, 0.0)[:, None] * sizes**2
            squares = (pulls[:, None] * sizes) ** 2
            gains = np.maximum(gains, best_amplitude(variances, squares, residual_sums, freedoms).gain.max(1))
        return gains

    def _steps(self, component: Component) -> list[Ranked]:
        """The likeliest jump in time of a read-out; none where no time is known.

        Sums over the samples after each jump weigh all of them. At least two samples are before it and two after: one
        that differs from all others is an outlier.
        """
        if self._scan.time is None:
            return []
        backwards, count, begins = self._scan.later
        if not len(begins):
            return []
        sums = self._sums(component)

        def after(of_samples: Array) -> Array:
            return np.cumsum(of_samples[..., backwards], -1)[..., count - 1]

        key = component.site, component.name, "jumps"
        information = np.maximum(self._marginal.of_sums(sums, after, key), 0.0)
        gains = of_process(
            after(sums.pull)[:, None],
            information[:, None, None],
            sums.left,
            sums.freedom,
            CONFOUNDED,
        ).gain
        training = self._test.fit.training.astype(float)
        later = after(training)
        inside = (later >= _LEAST_IN_STEP) & (training.sum() - later >= _LEAST_IN_STEP)
        if not inside.any():
            return []
        at = float(begins[np.argmax(np.where(inside, gains, -np.inf))])
        return [self.of_kernel(component, (self._scan.time,), name, (at,), exact=True) for name in _JUMPING]

    def _line(self, family: PeriodicFamily) -> Line | None:
        """The likeliest order of an angle; computed once."""
        if id(family) not in self._lines:
            self._lines[id(family)] = line_of(self._test, family)
        return self._lines[id(family)]

    def repeating(self) -> list[Ranked]:
        """What repeats with the turns of each site, at the likeliest order, and is no sine."""
        candidates = []
        for component, k in self._turning():
            candidates += self._repeating_at(component, k)
        return candidates

    def _repeating_at(self, component: Component, k: int) -> list[Ranked]:
        """What repeats with the turns of a site, its likeliest order and slope; none where no wave says so.

        The order is that of the likeliest wave or a part of it, refined until the highest multiple is in phase; but
        not where that wave alone is clearly likelier.
        """
        family = self._scan.family_of(component.site)
        if family is None or not np.any(component.column[self._rows]):
            return []
        line = self._line(family)
        if line is None:
            return []
        wave = self._wave(line)
        orders = [line.order / part for part in _FRACTIONS if line.order / part >= LOWEST_ORDER]
        likeliest = max(self._repeats(component, k, orders), key=_by_net)
        if likeliest.gain < max(_REFINED_GAIN * likeliest.cost, wave.gain - _REFINED_LESS):
            return []
        resolved = 2 * np.pi / max(float(np.ptp(family.angle)), 1e-3)
        for width in _OFF_ORDER:
            near = likeliest.process[3][0] + width * resolved * np.linspace(-1, 1, 9)
            likeliest = max([likeliest, *self._repeats(component, k, near[near > 0])], key=_by_net)
        whole = self._repeats(component, k, [max(round(likeliest.process[3][0]), 1)])
        likeliest = max([likeliest, *whole], key=_by_net)
        return [likeliest] if likeliest.gain > 0 else []

    def _repeats(self, component: Component, k: int, orders: Sequence[float] | Array) -> list[Ranked]:
        """What repeats at each of some orders, of the likelier slope."""
        values: Any = self._scan.quantities[k].values[None]
        bounds = self._scan.quantities[k].bounds
        rounded = [float(f"{order:.6g}") for order in orders]
        by_numbers = []
        for name in _REPEATING:
            kernel = KERNELS[name]
            of_orders = [np.asarray(kernel.features(values, bounds, rolloff=(order, 0.0))) for order in rounded]
            functions = np.stack([self._problem.seen(of_order) for of_order in of_orders])
            keys = [((k,), name, order) for order in rounded]
            pull, information, residual_sum, freedom = self._equations(component, functions, keys, exact=True)
            for numbers in kernel.grid:
                size = kernel.deviations(bounds, (1.0, *numbers))
                scaled = information * np.outer(size, size)
                evidence = zip(*of_process(pull * size, scaled, residual_sum, freedom, CONFOUNDED), strict=True)
                by_numbers.append(
                    [
                        self._process(Evidence(*parts), component, (k,), name, (order, *numbers))
                        for order, parts in zip(rounded, evidence, strict=True)
                    ]
                )
        return [max(candidates, key=_by_net) for candidates in zip(*by_numbers, strict=True)]

    def modulated(self, least: float) -> list[Ranked]:
        """Waves of the turns of each site, of any order, whose size follows a quantity, that may exceed `least`."""
        candidates = []
        for component, k in self._turning():
            candidates += self._modulated_at(component, k, self._scan.partners(component, k), least)
        return _best_of_each(candidates)

    def _modulated_at(self, component: Component, k: int, partners: Sequence[int], least: float = 0.0) -> list[Ranked]:
        """Waves of an angle whose size follows one of its partners, each of the likeliest order.

        Orders are those of rough spectra; of the likeliest partners they are refined exactly.
        """
        family = self._scan.family_of(component.site)
        if family is None or not partners or not np.any(component.column[self._rows]):
            return []
        sizes = self._problem.seen(np.stack([np.asarray(self._scan.quantities[j].values) for j in partners]))
        orders, gains = modulated_spectrum(self._test, family, sizes)
        if not gains.size:
            return []
        choices = log_orders_of(family, orders, self._options)
        peaks = np.argmax(gains - choices, 1)
        likeliest_orders = orders[peaks].tolist()
        costs = np.array(
            [
                self._scan.cost_of_kernel(component.site, *_modulation(k, j), (order,))
                for order, j in zip(likeliest_orders, partners, strict=True)
            ]
        )
        rough = _of_equal_directions(gains[np.arange(len(gains)), peaks])
        order_step = float(orders[1] - orders[0]) if len(orders) > 1 else 0.0
        candidates = []
        for place in np.argsort(costs - rough)[:_MODULATED]:
            if rough[place] < (costs[place] + least) / _ROUGH:
                continue
            order = likeliest_orders[place]
            for width in (order_step, order_step / 5):
                near = order + width * np.linspace(-1, 1, 5)
                candidate = max(self._modulated(component, k, partners[place], near[near >= LOWEST_ORDER]), key=_by_net)
                order = candidate.process[3][0]
            whole = self._modulated(component, k, partners[place], np.array([max(round(order), 1)], float))
            candidates.append(max(candidate, *whole, key=_by_net))
        return [candidate for candidate in candidates if candidate.gain > 0]

    def _modulated(self, component: Component, k: int, partner: int, orders: Array) -> list[Ranked]:
        """Waves of some orders of an angle, whose size follows a partner."""
        which, modulated = _modulation(k, partner)
        kernel = modulated.name
        rolloffs = [(float(f"{order:.6g}"),) for order in orders]
        functions = np.stack([self._scan.features(which, kernel, rolloff) for rolloff in rolloffs])
        keys = [(which, kernel, rolloff) for rolloff in rolloffs]
        pull, information, residual_sum, freedom = self._equations(component, functions, keys, exact=True)
        evidence = of_process(pull, information, residual_sum, freedom, CONFOUNDED)
        return [
            self._process(Evidence(*numbers), component, which, kernel, rolloff)
            for rolloff, numbers in zip(rolloffs, zip(*evidence, strict=True), strict=True)
        ]

    def _turning(self) -> Iterator[tuple[Component, int]]:
        """The components of sites that turn, each with the quantity that counts the turns."""
        for component in self.components:
            for k in range(self._scan.drivers):
                if self._scan.turns(component, k):
                    yield component, k

    def spectra(self) -> list[Ranked]:
        """Spectra of angles at the sites whose turns they are, exactly: they vary fast."""
        candidates = []
        for component, k in self._turning():
            candidates += self._of_rolloffs(component, k, exact=True)
        return _best_of_each(candidates)

    def _of_rolloffs(self, component: Component, k: int, exact: bool = False) -> list[Ranked]:
        """Every roll-off of kernels of which several are tried: they differ in the size of their functions alone."""
        candidates = []
        for name in _ROLLED_OFF:
            if not self._scan.suits(name, (k,)):
                continue
            kernel = KERNELS[name]
            functions = self._scan.features((k,), name)[None]
            (pull,), (information,), residual_sum, freedom = self._equations(
                component, functions, [((k,), name, ())], exact
            )
            for rolloff in kernel.grid:
                size = kernel.deviations(self._scan.quantities[k].bounds, rolloff)
                acting = slice(len(size))
                scaled = information[acting, acting] * np.outer(size, size)
                evidence = of_process(pull[acting] * size, scaled, residual_sum, freedom, CONFOUNDED)
                candidates.append(self._process(evidence, component, (k,), name, rolloff))
        return candidates

    def pairs(self, singles: Sequence[Ranked], least: float) -> list[Ranked]:
        """Processes of two quantities: of a short list, the likeliest as every kernel, where one exceeds `least`."""
        if self._scan.drivers < 2:
            return []
        plain = [self._plain(k) for k in range(self._scan.drivers)]
        short = [(component, (a, b), f"{plain[a]}*{plain[b]}") for component, a, b in self._shortlist(singles)]
        first = sorted(
            (candidate for candidate in self._of_all(short) if candidate.net > least or not least),
            key=lambda candidate: -candidate.net,
        )
        likely_pairs = (candidate.process[:2] for candidate in first[:_REFINED])
        processes = [(*pair, kernel) for pair in likely_pairs for kernel in PAIRS if self._scan.suits(kernel, pair[1])]
        return _best_of_each(self._of_all(processes))

    def _of_all(self, processes: Iterable[tuple[Component, tuple[int, ...], str]]) -> list[Ranked]:
        """Processes by component, quantities and kernel; those of one kernel are weighed together."""
        by_kernel: dict[str, dict[int, tuple[Component, list[tuple[int, ...]]]]] = {}
        for component, quantity_indices, kernel in processes:
            by_kernel.setdefault(kernel, {}).setdefault(id(component), (component, []))[1].append(quantity_indices)
        candidates = list[Ranked]()
        for kernel, members in by_kernel.items():
            waiting = list[_Equations]()
            count = 0
            for component, sets in members.values():
                batch_size = max(_AT_ONCE // max(self._scan.features(sets[0], kernel).size, 1), 1)
                for k in range(0, len(sets), batch_size):
                    batch = sets[k : k + batch_size]
                    functions = np.stack([self._scan.features(quantity_indices, kernel) for quantity_indices in batch])
                    keys = [(quantity_indices, kernel, ()) for quantity_indices in batch]
                    waiting.append(_Equations(component, batch, *self._equations(component, functions, keys)))
                    count += len(batch)
                    if count >= _WEIGHED:
                        candidates += self._together(waiting, kernel)
                        waiting = []
                        count = 0
            candidates += self._together(waiting, kernel)
        return candidates

    def _together(self, waiting: Sequence[_Equations], kernel: str) -> list[Ranked]:
        """Processes of one kernel, whose equations are known."""
        if not waiting:
            return []
        counts = [len(equations.sets) for equations in waiting]
        residual_sum = np.repeat([equations.left for equations in waiting], counts)[:, None, None]
        freedom = np.repeat([equations.freedom for equations in waiting], counts)[:, None, None]
        pull = np.concatenate([equations.pull for equations in waiting])
        information = np.concatenate([equations.information for equations in waiting])
        evidence = of_process(pull, information, residual_sum, freedom, CONFOUNDED)
        places = (
            (equations.component, quantity_indices) for equations in waiting for quantity_indices in equations.sets
        )
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
            candidates = [self.of_kernel(component, which, name, exact=exact) for name in names]
            for k, partner in (which, which[::-1]):
                if self._scan.turns(component, k):
                    candidates += self._modulated_at(component, k, [partner])
            return candidates
        candidates = list[Ranked]()
        k = next(iter(which))
        if k == self._scan.drivers:
            return self._of_wander(component)
        continuous, splines = self._scan.splines
        if k in continuous:
            (pull,), (information,), *noise = self._equations(
                component, splines[[continuous.index(k)]], [((k,), "splines")], exact
            )
            candidates = [
                self._process(self._of_splines(name, pull, information, *noise), component, which, name)
                for name in SCALED
            ]
            names = [name for name in names if name not in SCALED]
        candidates += [self.of_kernel(component, which, name, exact=exact) for name in names]
        if k == self._scan.time and self._scan.is_read_out(component.site):
            candidates += self._steps(component)
        if self._scan.turns(component, k):
            candidates += self._of_rolloffs(component, k, exact)
            candidates += self._repeating_at(component, k)
        return candidates

    def alike(self, component: Component, which: tuple[int, ...]) -> Ranked | None:
        """The likeliest kernel of given quantities at a component; None where they say nothing there."""
        return max(self.kernels_of(component, which, exact=True), key=lambda candidate: candidate.net, default=None)

    def _shortlist(self, singles: Sequence[Ranked]) -> list[tuple[Component, int, int]]:
        """Pairs with the largest scores of products of a few functions, and those of which one alone does much."""
        functions, start, weights = self._scan._few
        i, j = np.triu_indices(self._scan.drivers, 1)
        squared = functions**2
        scored = []
        components = {(component.site, component.name): component for component in self.components}
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
        shortlist = {(component.site, component.name, a, b) for _, component, a, b in scored[:_SHORTLIST]}
        place = {phrase: k for k, phrase in enumerate(self._scan.phrases)}
        for single in sorted(singles, key=lambda single: -single.net)[:_BESIDE]:
            a = place[single.cause[0]]
            partners = (b for b in range(self._scan.drivers) if b != a and self._scan.may_act(single.site, a, b))
            shortlist |= {(single.site, single.place, min(a, b), max(a, b)) for b in partners}
        return [(components[site, name], a, b) for site, name, a, b in sorted(shortlist)]

    def _sums(self, component: Component) -> Sums:
        return self._marginal.sums(component.column)

    def exact(self, ranked: Ranked) -> Ranked:
        """A process in autocorrelated noise, where all but what varies fast are weighed as if they varied slowly."""
        if not ranked.process or kernel_of(ranked.process[2]).varies_fast or self._is_exact(ranked.process[0]):
            return ranked
        component, quantity_indices, kernel, rolloff = ranked.process
        return self.of_kernel(component, quantity_indices, kernel, rolloff, exact=True)

    def _is_exact(self, component: Component) -> bool:
        """Tells whether sums over rows suffice: in white noise, or of a component of one row."""
        return self._sums(component).exact

    def _equations(
        self, component: Component, functions: Array, which: Sequence[Hashable], exact: bool = False
    ) -> tuple[Array, Array, float, float]:
        """Pull and information of groups of functions `(group, function, sample)`, sum of squares and freedom.

        What is computed of each group at a component is kept by what it is, `which`.
        """
        if self._through_loop and component.passed is not None:
            functions = component.passed(functions)
            which = [(what, "passed") for what in which]
        if exact and not self._is_exact(component):
            keys = [(component.site, component.name, what, "exact") for what in which]
            dense = [
                self._marginal.dense(component.column, group, key) for group, key in zip(functions, keys, strict=True)
            ]
            return (
                np.stack([equations[0] for equations in dense]),
                np.stack([equations[1] for equations in dense]),
                *dense[0][2:],
            )
        sums = self._sums(component)
        keys = [(component.site, component.name, what) for what in which]
        return *self._marginal.equations(sums, functions, keys), sums.left, sums.freedom

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
        equations = self._equations(component, functions, [(which, kernel, rolloff)], exact)
        evidence = of_process(*equations, CONFOUNDED)
        return self._process(Evidence(*(part[0] for part in evidence)), component, which, kernel, rolloff)

    def _process(
        self,
        evidence: Evidence,
        component: Component,
        quantity_indices: tuple[int, ...],
        kernel: str,
        rolloff: tuple[float, ...] = (),
    ) -> Ranked:
        problem = self._problem
        quantities = [self._scan.quantities[k] for k in quantity_indices]
        variance = evidence.variance

        def make() -> Term:  # of few numbers: a reference to this scan would keep its tables as long as the candidate
            spread = float(f"{np.sqrt(variance):.4g}")
            return problem.process(component, quantities, kernel, spread, rolloff)

        site = component.site
        cost = self._scan.cost_of_kernel(site, quantity_indices, kernel_of(kernel), rolloff)
        cost += self._scan.cost_of_component(component)
        cause = tuple(self._scan.phrases[k] for k in quantity_indices)
        process = (component, quantity_indices, kernel, rolloff)
        return Ranked(float(evidence.gain), cost, float(evidence.volume), site, cause, component.name, make, process)


def _of_term(evidence: Evidence, cost: float, term: Term, label: str = "") -> Ranked:
    """A term with a formula, by its label or another one."""
    gain = float(evidence.gain)
    volume = float(evidence.volume)
    return Ranked(gain, cost, volume, term.site, (label or term.label,), "", lambda: term)


def _in_order(candidates: Sequence[Ranked]) -> list[Ranked]:
    """The likeliest first; of names that are nearly as likely as a first name, that of the highest priority.

    Of the same priority it is that of the fewest numbers.
    """
    ordered = sorted(candidates, key=lambda candidate: -candidate.net)
    if not ordered or ordered[0].process:
        return ordered
    near = [candidate for candidate in ordered if not candidate.process and candidate.net > ordered[0].net - NEARLY]
    first = min(near, key=lambda candidate: (candidate.make().specificity, candidate.make().size, -candidate.net))
    return [first, *(candidate for candidate in ordered if candidate is not first)]


def _best_of_each(candidates: Sequence[Ranked]) -> list[Ranked]:
    """The likeliest of processes that differ in their kernel alone; none that are not likely at all."""
    likeliest: dict[Any, Ranked] = {}
    for candidate in candidates:
        if candidate.gain > 0 and (candidate.key not in likeliest or candidate.gain > likeliest[candidate.key].gain):
            likeliest[candidate.key] = candidate
    return list(likeliest.values())


def _of_short_memory(wandering: Sequence[Ranked]) -> list[Ranked]:
    """What wanders with a memory of a fifth of the recording at most."""
    return [candidate for candidate in wandering if candidate.process[3][0] >= _LEAST_CORNER]


def _modulation(k: int, partner: int) -> tuple[tuple[int, int], Kernel]:
    """The quantities in their order, and the kernel of a wave of the first whose size follows a partner."""
    return (min(k, partner), max(k, partner)), MODULATED[k > partner]


def _of_equal_directions(gains: Array, directions: int = 4) -> Array:
    """The evidence of gains in log-likelihood, each of so many directions of equal information."""
    excess = np.maximum(2 * gains / directions, 1.0)
    return 0.5 * directions * (excess - 1 - np.log(excess))


def _by_net(candidate: Ranked) -> float:
    return candidate.net


def _is_own(quantity: DriverValues, site: str) -> bool:
    return site in quantity.own or "" in quantity.own


def _is_discrete(quantity: DriverValues) -> bool:
    return bool(quantity.driver.discrete) or len(np.unique(np.round(quantity.values[:200], 6))) <= 3


def _is_angle(quantity: DriverValues) -> bool:
    return bool(quantity.driver.is_angle)
