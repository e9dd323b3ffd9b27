"""The selection of terms by evidence: add, re-estimate, drop, exchange.

A *name* is a term with a formula, a *process* a nonparametric one, a Gaussian process. A *quantity* is a driver on
which a process may depend.

1. Add the names that nearly every problem has, then the term whose evidence most exceeds the cost of its choice, if by
   a margin.
2. Estimate the amplitude and the kernel of every process anew, the others integrated over.
3. Drop terms that are not worth their cost, the least first, until all that remain are.
4. Where nothing more is worth adding, put names, one or several, in the place of a process where that is likelier, or
   less likely by 2 at most.
5. Then exchange each term for whatever is likelier in its place.

Autocorrelated noise takes the place of processes where that is likelier, and terms its place where that is clearly so.

A site has one process, at one or more components, and may have the spectrum of its gear beside it: further processes
could not be told apart from these. A term is rejected if independent noise at the same component explains more.
"""

from collections import Counter
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import cast

import numpy as np

from lite6jax.array_types import Array, Mask
from lite6jax.effects.kernels import kernel_of, remembers
from lite6jax.estimation.evidence import Marginal
from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import (
    Component,
    CurvedProblem,
    Problem,
    acts_on,
    components_at,
    contribution,
    prior_precision,
    wave_of,
)
from lite6jax.estimation.projection import scaled_solve
from lite6jax.estimation.score_test import ScoreTest, remaining_noise_model, score_test
from lite6jax.estimation.terms import ProcessTerm, Term, Terms, is_process
from lite6jax.estimation.thresholds import BETTER, CLOSE, EXCHANGES, IMPOSSIBLE, LISTED, MARGIN
from lite6jax.estimation.whitening import Whitened
from lite6jax.search.scan import NEARLY, ModelScan, Pair, Ranked, Scan, is_wander
from lite6jax.search.spectrum import as_likely
from lite6jax.search.state import Alternative, SelectedTerm, State, beyond_limits, refitted

_NAMES_FOR_PROCESS = 3
"""Most names that take the place of a process: as many orders as gears have."""
_ESTIMATES = 4
"""Most estimates of tried numbers beside the others; each comes closer."""
_MOST_TERMS = 8
"""Terms of one group of rows from which none is added; bounds the time, and more were never true in a trial."""

_APART = 0.9
"""Share of its log odds that a term keeps beside another, from which both are added at once."""
_REFUSED = 40
"""Terms that are no other thing than those before, after which none of a ranking is looked at."""
_LARGE = 30.0
"""Log odds by their columns, from which curved terms are compared by their fits."""
_FAILURES = 2
"""Fits that are not likelier, from which columns are not believed at a site."""
_RIVALS = 4
"""Names of a site that are fitted beside the likeliest one, or in the place of two; beside it one of each other site
that moves the same rows as well."""
_LIKELY = 0.2
"""Share of the log odds of the likeliest name by its columns, from which others may be likelier by their fits."""
_LIKELY_IN_LOOP = 0.8
"""The same of processes whose functions pass the loop: these say more than columns of names."""
_PRODUCTS = 1 << 25
"""Of products of candidates that are kept from one model to the next: 256 MB."""


class Selector:
    """A problem with all that is tried in it."""

    def __init__(self, problem: Problem, options: EngineOptions, names_alone: bool = False) -> None:
        self.problem = problem
        self.options = options
        self.scan = Scan(problem, options, names_alone)
        self._preset = problem.preset[0].terms
        self._latest: ScoreTest | None = None
        self._grams: dict[Hashable, Array] = {}
        self._whitened = Whitened()
        self._known: dict[tuple[int, int], tuple[Fit, list[Ranked]]] = {}
        self._excluded = frozenset[object]()

    # -------------------------------------------------------------- the search

    def selected(self, state: State, exchanging: bool) -> State:
        """The likeliest set of terms, in the likeliest noise.

        Noise that is autocorrelated explains residuals as terms do. It is there first: in noise that is taken as white,
        many processes are significant that each describe a part of it. Terms are then tried in the place of what is
        left of it. These go on to names only where they are about as likely.
        Terms of an earlier search are taken over with its decisions between names, noise and processes, where any is
        still worth its cost.
        """
        autocorrelated = replace(state, fit=self.in_likeliest_noise(state.fit))
        begun = self._continued_from(autocorrelated)
        if self._has_terms(begun):
            return self.above_noise(self._grown(begun, exchanging, self._processes_of(begun)))
        grown = self._grown(begun, exchanging, set())
        if not grown.fit.noise.white:
            # terms of what varies slowly make rows autocorrelated too
            instead = self._with_all_worth(self._continued_from(state))
            if self._in_noise_left(instead).evidence > grown.evidence - CLOSE:
                instead = self._in_noise_left(self._grown(instead, exchanging, set()))
                grown = max(grown, instead, key=lambda trial: trial.evidence)
        grown = self._physics_instead(grown, begun, exchanging)
        while (simpler := self._noise_instead(grown)) is not None:
            grown = simpler
        return self.above_noise(grown)

    def _physics_instead(self, state: State, begun: State, exchanging: bool) -> State:
        """The likelier of a state and, where a read-out errs anew in each row, of what is found without that.

        Independent errors of a read-out explain whatever few rows do not resolve, and come before several effects that
        explain it together.
        """
        independent = {selected.term for selected in state.tested if self._forgets_at_once(selected.term)}
        if not independent:
            return state
        self._excluded = frozenset(self._key_of(term) for term in independent)
        instead = self._in_noise_left(self._grown(begun, exchanging, set()))
        self._excluded = frozenset()
        return max(state, instead, key=lambda trial: trial.evidence)

    def _forgets_at_once(self, term: Term) -> bool:
        """Tells whether a term is a read-out whose error is another one after a few rows."""
        return is_wander(term) and self._is_noise(term) and not remembers(term.rolloff, self.problem.samples)

    def _in_noise_left(self, state: State) -> State:
        """The terms that are worth their cost in the noise that all of them leave."""
        return self.dropped(replace(state, fit=self.in_likeliest_noise(state.fit)))

    def _continued_from(self, state: State) -> State:
        """A state with the terms of it that are worth their cost, estimated anew; itself where it has none."""
        return self._settled(self._estimated(state)) if self._has_terms(state) else state

    def _is_noise(self, term: Term) -> bool:
        """Tells whether a term is a read-out that wanders by itself."""
        return is_wander(term) and self.scan.is_read_out(term.site)

    def _processes_of(self, state: State) -> set[tuple[object, ...]]:
        """The processes of a state, by what they are."""
        return {self._key_of(selected.term) for selected in state.tested if selected.term.nonparametric}

    def _has_terms(self, state: State) -> bool:
        """Tells whether a state has terms beside those of the domain."""
        return any(selected.term not in self._preset for selected in state.tested)

    def supported(self, state: State) -> State:
        """The terms of a state, or likelier ones in their place, that are worth their cost in the likeliest noise."""
        state = replace(state, fit=self.in_likeliest_noise(state.fit))
        state = self._estimated(self._with_likeliest_alternatives(state))
        return self.above_noise(self._settled(state))

    def _with_likeliest_alternatives(self, state: State) -> State:
        """The state with the likeliest of each term, its alternatives and, of a process, those of its component."""
        for selected in state.tested:
            term = selected.term
            present = state.fit.terms.terms
            if term in self._preset or term not in present:  # one in its place may include others
                continue
            rivals = [other.term for other in selected.alternatives if not other.together_with]
            rivals = [rival for rival in rivals if rival not in present and is_known(self.problem, rival)]
            if not rivals and (not is_process(term) or is_wander(term)):
                continue
            k = present.index(term)
            test = self.beside(state, k)
            weighed = ModelScan(self.scan, test)
            before = self._as_it_is(weighed, term)
            candidates = [ranked for rival in rivals if (ranked := self._as_it_is(weighed, rival)) is not None]
            if is_process(term) and not is_wander(term):
                of_component = weighed.processes_of(self._process_of(term)[0])
                candidates += [process for process in of_component if not kernel_of(process.process[2]).undriven]
            possible = [
                candidate
                for candidate in self._not_refused(candidates, test, state)
                if self._has_room(candidate, test.fit.terms.terms) and self._is_possible(test, candidate)
            ]
            likeliest = max(possible, key=lambda candidate: candidate.net, default=None)
            if likeliest is None or (before is not None and likeliest.net <= before.net):
                continue
            exchanged = self._within_bounds(self._with(self._left_out(state, k), likeliest))
            if exchanged.evidence > state.evidence:
                state = exchanged
        return state

    def _noise_instead(self, state: State) -> State | None:
        """The state with other noise in the place of a process, where that is likelier; else None."""
        trials = []
        for k, selected in enumerate(state.tested):
            if selected.term.nonparametric and not self._is_noise(selected.term):
                trial = self._left_out(state, k)
                trial = replace(trial, fit=self.in_likeliest_noise(trial.fit))
                if trial.fit.noise.models != state.fit.noise.models:
                    trials.append(trial)
        if not trials:
            return None
        likeliest = self.dropped(self._estimated(max(trials, key=lambda trial: trial.evidence)))
        return likeliest if likeliest.evidence > state.evidence else None

    def _grown(self, state: State, exchanging: bool, asked: set[tuple[object, ...]]) -> State:
        """With all that is worth adding; names are tried for the processes that are not among those `asked`."""
        exchanged = 0
        while True:
            state = self._with_all_worth(state)
            named = self._with_names(state, asked)
            if named is not state:
                state = named
                continue
            if not exchanging or exchanged >= EXCHANGES:
                return state
            better = self._exchanged(state)
            if better is None:
                return state
            state = better
            exchanged = exchanged + 1

    def _with_names(self, state: State, asked: set[tuple[object, ...]]) -> State:
        """The state with names in the place of processes, each asked once, the one that explains most first."""
        while True:
            processes = [(k, selected) for k, selected in enumerate(state.tested) if selected.term.nonparametric]
            remaining = [(k, selected) for k, selected in processes if self._key_of(selected.term) not in asked]
            if not remaining:
                return state
            k, largest = max(remaining, key=lambda pair: pair[1].gain)
            asked.add(self._key_of(largest.term))
            state = self._named(state, k) or state

    @staticmethod
    def _key_of(term: Term) -> tuple[object, ...]:
        """As `Ranked.key`."""
        return term.site, term.component if is_process(term) else "", _phrases(term)

    def _with_all_worth(self, state: State) -> State:
        tried = set[object]()
        failures = Counter[str]()
        while worth := self._next(state := self._with_usual(state), tried):
            state = self._settled(self._likelier(state, worth, failures))
            tried |= {candidate.key for candidate in worth}
            tried |= {site for site, count in failures.items() if count >= _FAILURES}
        return state

    def _likelier(self, state: State, worth: Sequence[Ranked], failures: Counter[str]) -> State:
        """The state with more terms; where residuals are curved with those alone whose fit is likelier.

        Columns of large effects say little of their fits: the likeliest names of a site are all fitted. Where no fit is
        likelier, that is counted among the `failures` of the site: a process is worth all of them.
        """
        if not self.problem.curved:
            return self._added(state, worth)
        if len(worth) > 1 and max(candidate.net for candidate in worth) < _LARGE:
            added = self._added(state, worth)
            if added.evidence > state.evidence + len(worth) * MARGIN:
                return self._in_likeliest_components(added, state)
        for candidate in worth:
            added = self._added(state, [candidate])
            moved = self._acted_on(candidate, state)
            for rival in self._named_rivals(state, candidate):
                if added.evidence < state.evidence + self._most_gained(rival, moved, state):
                    added = max(added, self._added(state, [rival]), key=lambda trial: trial.evidence)
            if added.evidence > state.evidence + MARGIN:
                state = self._in_likeliest_components(added, state)
            else:
                failures[candidate.site] += _FAILURES if candidate.process else 1
        return state

    def _in_likeliest_components(self, state: State, before: State) -> State:
        """The state with each process that was not there before in the likeliest place of its loop."""
        for k, selected in enumerate(state.tested):
            if selected.term.nonparametric and selected.term not in before.fit.terms.terms:
                state = max([state, *self.elsewhere_in_loop(state, k)], key=lambda trial: trial.evidence)
        return state

    def elsewhere_in_loop(self, state: State, k: int) -> list[State]:
        """States with the k-th term, a process, at any component that is like its own, fitted there.

        What passes a loop is late, and where that is left out a function of two quantities may stand for one of either.
        So such a process is tried as one of either too. Those are fitted that are likely by their functions as they
        pass the loop.
        """
        selected = state.tested[k]
        process = selected.term
        assert is_process(process)
        component, quantity_indices = self._process_of(process)
        group = self._alike(component)
        if len(group) == 1:
            return []
        weighed = ModelScan(self.scan, self.beside(state, k), through_loop=True)
        trials = []
        for other, quantities in product(group, [quantity_indices, *_either(quantity_indices)]):
            trial = weighed.alike(other, quantities)
            if trial is not None and quantities == quantity_indices:  # one that continues another costs less
                further = self.scan.cost_of_component(other) - self.scan.cost_of_component(component)
                trial = replace(trial, cost=min(trial.cost, selected.cost + further))
            if trial is not None:
                trials.append(trial)
        least = _LIKELY_IN_LOOP * max((trial.net for trial in trials), default=0.0)
        states = []
        for trial in trials:
            term = trial.make()
            if trial.net < least or term == process:
                continue
            tested = list(state.tested)
            tested[k] = replace(selected, term=term, gain=trial.gain, cost=trial.cost, volume=trial.volume)
            states.append(self.weighed(self._refitted(state, tested)))
        return states

    def _alike(self, component: Component) -> tuple[Component, ...]:
        """The components of a group that are alike, of which this is one; itself alone where there are no others."""
        groups = ((first, *first.alike) for first in self.problem.components)
        return next(group for group in groups if any(one.place == component.place for one in group))

    def _named_rivals(self, state: State, candidate: Ranked) -> list[Ranked]:
        """Beside a candidate that is large the likeliest names of its site and of each that moves the same rows."""
        if candidate.net < _LARGE:
            return []
        rivals = list[Ranked]()
        of_sites = Counter[str]()
        names = self._names_moving(self._acted_on(candidate, state), self.test(state), state)
        for name in sorted(names, key=lambda name: -name.net):
            most = _RIVALS if name.site == candidate.site else 1
            if name.key != candidate.key and of_sites[name.site] < most:
                of_sites[name.site] += 1
                rivals.append(name)
        return rivals

    def _names_moving(self, rows: Mask, test: ScoreTest, state: State) -> list[Ranked]:
        """The names that act on some rows and are worth their cost beside a model."""
        worth = [name for name in ModelScan(self.scan, test).named() if name.net >= MARGIN]
        return [name for name in self._not_refused(worth, test, state) if (rows & self._acted_on(name, state)).any()]

    def _most_gained(self, rival: Ranked, moved: Mask, state: State) -> float:
        """The log-likelihood that a rival gains at most: of fewer rows than `moved` `(row,)` all but their noise."""
        acted_on = self._acted_on(rival, state)
        if np.all(acted_on >= moved):
            return float(np.inf)
        f = state.fit
        of_sample = np.log(np.maximum(f.scale[self.problem.groups], 1.0)) + 0.5
        return float(np.sum(of_sample[acted_on])) * int(f.training.sum())

    def _acted_on(self, candidate: Ranked, state: State) -> Mask:
        """`(row,)`, which a candidate changes."""
        if candidate.process:
            return np.any(candidate.process[0].column, 1)
        return self._rows(candidate.make(), state)

    def _with_usual(self, state: State) -> State:
        """The state with the names that nearly every problem has, before anything else is asked for.

        Numbers of them are chosen when all are there: that of one alone would describe what another one does. Where
        residuals are curved such a name may stand for any other of its rows, and is fitted beside these.
        """
        if self.problem.curved:
            return state
        before = state
        while worth := self._worth(ModelScan(self.scan, test := self.test(state)).usual(), test, state, set()):
            state = self._within_bounds(self._with(state, *worth))
        return state if state is before else self._settled(self._estimated(state))

    def _next(self, state: State, tried: set[object]) -> list[Ranked]:
        """What is to be added."""
        test = self.test(state)
        return self._worth(ModelScan(self.scan, test).ranked(), test, state, tried)

    def _added(self, state: State, worth: Sequence[Ranked]) -> State:
        """The state with more terms, those within their bounds."""
        return self._within_bounds(self._estimated(self._with(state, *worth)))

    def _worth(self, ranked: list[Ranked], test: ScoreTest, state: State, tried: set[object]) -> list[Ranked]:
        """The terms of a ranking that are worth their cost and within their bounds, the likeliest first.

        Of those that act on the same rows, further ones are taken that keep nine tenths of their odds beside any
        numbers of the ones before: they explain something else. Where residuals are curved none is taken, as columns
        say nothing of that.
        A further term may be a part of what a present one does not describe. It is left out where it explains less than
        noise of its own would at that one's component.
        """
        model = state.fit.terms.terms
        marginal = Marginal(test)
        counts = sum((self._rows(term, state) for term in model), np.zeros(self.problem.rows, int))
        components = [component for term in model if (component := self._component_of(term)) is not None]
        columns = {id(component): component.column for component in components}
        noises = [(np.any(column, 1), float(marginal.of_noise(column).gain)) for column in columns.values()]
        full = counts >= _MOST_TERMS
        taken = np.zeros(self.problem.rows, bool)
        refused = 0
        worth = list[Ranked]()
        weighed = [self._continued(candidate, model) for candidate in self._not_refused(ranked, test, state)]
        for candidate in sorted(weighed, key=lambda candidate: -candidate.net):
            if candidate.net < MARGIN or full.all() or refused == _REFUSED:
                break
            if candidate.key in tried or candidate.site in tried:
                continue
            if not self._has_room(candidate, model) or not self._is_possible(test, candidate):
                continue
            rows = self._acted_on(candidate, state)
            if (rows & full).any():
                continue
            if any(candidate.gain < gain for acted_on, gain in noises if (acted_on & rows).any()):
                full |= rows
                continue
            if (rows & taken).any() and not self._is_apart(candidate, test):
                refused = refused + 1
                continue
            worth.append(candidate)
            model = (*model, candidate.make())
            taken |= rows
            counts = counts + rows
            full |= counts >= _MOST_TERMS
            if self.problem.curved:
                full |= rows
            else:
                model_values = state.fit.terms, state.fit.values
                test = test.extend(test.problem.columns([candidate.make()], beside=model_values))
        return worth

    def _is_apart(self, candidate: Ranked, test: ScoreTest) -> bool:
        """Tells whether a candidate keeps its odds, but for a tenth, beside a model that has others of its ranking."""
        weighed = ModelScan(self.scan, test)
        if candidate.process:
            component, quantity_indices, kernel, rolloff = candidate.process
            beside = weighed.of_kernel(component, quantity_indices, kernel, rolloff, exact=True)
        else:
            beside = weighed.as_is(candidate.make())
        return beside is not None and beside.gain - candidate.cost >= max(_APART * candidate.net, MARGIN)

    def _has_room(self, candidate: Ranked, model: Sequence[Term]) -> bool:
        """Tells whether a term's site has no process, or a process may be added there; no name is added to one.

        The errors of a gear, a spectrum, do not describe what depends on loads or postures, nor do these describe them.
        """
        at_site = [term for term in model if is_process(term) and term.site == candidate.site]
        joined = [term for term in at_site if not kernel_of(term.kernel).apart]
        if not candidate.process:
            return not joined
        kernel = kernel_of(candidate.process[2])
        if kernel.undriven:
            at_site = [term for term in at_site if term.component == candidate.place]
        is_hidden = any(kernel.hides(kernel_of(term.kernel)) for term in at_site)
        if kernel.apart:
            return not is_hidden
        return (
            not joined
            or self._continues(candidate, model)
            or (candidate.cause not in map(_phrases, joined) and not is_hidden)
        )

    def _component_of(self, term: Term) -> Component | None:
        """The component of a process, or of a name at a site that has but one; None where a name may move several.

        None also of a component of one row: what moves there by itself is the noise of that row.
        """
        of_site = [component for component in self.problem.components if component.site == term.site]
        if is_process(term):
            of_site = [self._process_of(term)[0]]
        alone = len(of_site) == 1 and term not in self._preset and np.count_nonzero(of_site[0].column.any(1)) > 1
        return of_site[0] if alone else None

    def _continued(self, candidate: Ranked, model: Sequence[Term]) -> Ranked:
        """A process that continues one costs the choice of the component alone; a multiple of a wave, of that.

        A read-out that wanders costs less where one of its kind does, a hidden state where its site has one.
        """
        if candidate.process and kernel_of(candidate.process[2]).undriven:
            cost = self.scan.cost_of_wander_beside(candidate.site, model)
            return candidate if cost is None else replace(candidate, cost=min(candidate.cost, cost))
        if not candidate.process:
            cost = self.scan.cost_of_wave(candidate.make(), model)
            return candidate if cost is None else replace(candidate, cost=min(candidate.cost, cost))
        if not self._continues(candidate, model):
            return candidate
        count = sum(component.site == candidate.site for component in self.problem.components)
        return replace(candidate, cost=min(candidate.cost, float(np.log(count))))

    def _continues(self, candidate: Ranked, model: Sequence[Term]) -> bool:
        """Tells whether it is a process of the quantities that one has at its site already, at another component."""
        components = {
            term.component
            for term in model
            if is_process(term) and term.site == candidate.site and candidate.cause == _phrases(term)
        }
        if not candidate.process:
            return False
        alike = {component.name for component in self._alike(candidate.process[0])}
        return bool(components) and not alike & components

    def _not_refused(self, ranked: list[Ranked], test: ScoreTest, state: State) -> list[Ranked]:
        refused = {term.label for term in state.refused} | {term.label for term in test.fit.terms.terms}
        return [
            candidate
            for candidate in ranked
            if (candidate.process and candidate.key not in self._excluded)
            or (not candidate.process and candidate.cause[0] not in refused)
        ]

    def _rows(self, term: Term, state: State) -> Mask:
        return acts_on(self.problem, term, (state.fit.terms, state.fit.values))

    def _with(self, state: State, *ranked: Ranked) -> State:
        new = [SelectedTerm(candidate.make(), candidate.gain, candidate.cost, candidate.volume) for candidate in ranked]
        included = {term for selected in new for term in selected.term.includes}
        kept = [selected for selected in state.tested if selected.term not in included]
        starts = dict[Term, Array]()
        if self.problem.curved:
            names = [selected.term for selected in new if not selected.term.nonparametric]
            problem = cast(CurvedProblem, self.problem)
            f = state.fit
            starts = {name: problem.likeliest_start(name, f.terms, f.values) for name in names}
        return refitted(self.problem, state, [*kept, *new], self.options, self._whitened, starts)

    def _refitted(self, state: State, tested: Sequence[SelectedTerm]) -> State:
        starts = dict[Term, Array]()
        if len(tested) == len(state.tested):
            pairs = zip(state.tested, tested, strict=True)
            changed = [(before.term, after.term) for before, after in pairs if before.term != after.term]
            starts = {after: self._start_from(before, after, state) for before, after in changed}
        return refitted(self.problem, state, tested, self.options, self._whitened, starts)

    def _start_from(self, before: Term, after: Term, state: State) -> Array:
        """The numbers with which a term comes nearest to what one of a state did, in whose place it is.

        A process that starts from zero leaves what it describes to the tails of the noise, and takes many steps.
        """
        f = state.fit
        values = f.values[f.terms.slices[f.terms.terms.index(before)]]
        if before.label == after.label and not after.nonparametric:
            return values if before.size == after.size else np.zeros(after.size)
        beside = f.terms, f.values
        of_before = np.tensordot(values, self.problem.columns([before], values, beside), 1)
        columns = self.problem.columns([after], beside=beside)
        training = np.where(f.training, 1.0, 0.0)
        columns = (columns * training).reshape(after.size, -1)
        information = columns @ columns.T
        information[np.diag_indices_from(information)] += prior_precision(self.problem, [after])
        return scaled_solve(information, columns @ (of_before * training).ravel())

    def _without(self, state: State, left_out: set[int]) -> State:
        """Without some terms, refitted."""
        return self._refitted(state, [selected for k, selected in enumerate(state.tested) if k not in left_out])

    def _left_out(self, state: State, k: int) -> State:
        """Without the k-th term, refitted."""
        return self._without(state, {k})

    # -------------------------------------------------------------- each term beside the others

    def beside(self, state: State, k: int) -> ScoreTest:
        """The test of the model without its k-th term, in the noise that is left with it."""
        return self._beside_all_but(state, {k})

    def _beside_all_but(self, state: State, left_out: set[int]) -> ScoreTest:
        """The test of the model without some terms, in the noise that is left with them."""
        return self.test(state).beside([k not in left_out for k in range(len(state.tested))])

    def test(self, state: State) -> ScoreTest:
        """The test of a model, kept for the latest."""
        if self._latest is None or self._latest.fit is not state.fit:
            if sum(parts.size for parts in self._grams.values()) > _PRODUCTS:  # those of earlier noise are among them
                self._grams.clear()
            self._latest = score_test(self.problem, state.fit, self.options, self._grams, self._whitened)
        return self._latest

    def _estimated(self, state: State) -> State:
        """Amplitude and kernel of each process, and the tried number of each name, anew beside the others.

        A process is estimated once, and one of two quantities may become one of either. Numbers are estimated again:
        one that is far off leaves large residuals, which are winsorised, so that the next may be off as well.
        """
        open_ = [k for k, selected in enumerate(state.tested) if self._is_open(selected.term)]
        for _ in range(_ESTIMATES):
            tested = list(state.tested)
            for k in open_:
                tested[k] = self._chosen_again(self.beside(state, k), tested[k])
            moved = [k for k in open_ if tested[k].term != state.tested[k].term]
            if not moved:
                return replace(state, tested=tuple(tested))
            state = self._refitted(state, tested)
            open_ = [k for k in moved if not tested[k].term.nonparametric]
        return state

    def _is_open(self, term: Term) -> bool:
        """Tells whether something of a term is chosen, so that it may be chosen anew."""
        return term not in self._preset and (term.nonparametric or self._has_number(term))

    def _chosen_again(self, test: ScoreTest, selected: SelectedTerm) -> SelectedTerm:
        term = selected.term
        if is_process(term):
            component, which = self._process_of(term)
            candidates = self._processes(test, component, [which, *_either(which)])
            likeliest = max(candidates, key=lambda candidate: candidate.net, default=None)
        else:
            likeliest = ModelScan(self.scan, test).like(term)
        if likeliest is None:
            return replace(selected, gain=0.0)
        cost = likeliest.cost
        if is_process(term) and not (kernel_of(term.kernel).any_order or kernel_of(likeliest.process[2]).any_order):
            cost = min(cost, selected.cost)
        return replace(selected, term=likeliest.make(), gain=likeliest.gain, cost=cost, volume=likeliest.volume)

    def _process_of(self, term: ProcessTerm) -> tuple[Component, tuple[int, ...]]:
        """The component of a process, and the places of its quantities."""
        of_site = components_at(self.problem, term.site)
        component = next(component for component in of_site if component.name == term.component)
        return component, tuple(self.scan.phrases.index(driver.phrase) for driver in term.drivers)

    def weighed(self, state: State) -> State:
        """Each term weighed beside the others as it is; of waves of one angle the first costs most."""
        tested = []
        for k, selected in enumerate(state.tested):
            if selected.term in self._preset:
                tested.append(selected)
                continue
            cost = self.scan.cost_of_wave(selected.term, [before.term for before in tested])
            weighed = self._weighed_as_is(state, k)
            tested.append(weighed if cost is None else replace(weighed, cost=cost))
        return replace(state, tested=tuple(tested))

    def dropped(self, state: State) -> State:
        """Without the terms that are not worth their cost, the least of those that act on any row first."""
        while True:
            state = self.weighed(state)
            tested = state.tested
            order = np.argsort([np.inf if selected.term in self._preset else selected.net for selected in tested])
            least = set[int]()
            taken = np.zeros(self.problem.rows, bool)
            for k in order.tolist():
                if tested[k].term in self._preset or tested[k].net >= MARGIN or taken.all():
                    break
                rows = self._rows(tested[k].term, state)
                if not (rows & taken).any():
                    least.add(k)
                taken |= rows
            if not least:
                return state
            without = self._without(state, least)
            if self.problem.curved:
                lowest = state.evidence - MARGIN
                if len(least) > 1 and without.evidence < lowest:
                    without = self._without(state, {int(order[0])})
                if without.evidence < lowest:
                    return state
            state = without

    def above_noise(self, state: State) -> State:
        """Without terms that explain less than independent noise at their component."""
        while state.tested:
            marginal = Marginal(self.test(state))
            excess = []
            for selected in state.tested:
                component = None if self._is_noise(selected.term) else self._component_of(selected.term)
                if component is None:
                    excess.append(-np.inf)
                    continue
                excess.append(float(marginal.of_noise(component.column).gain) - selected.gain)
            k = int(np.argmax(excess))
            if excess[k] <= 0:
                break
            state = self.dropped(self._left_out(state, k))
        return state

    def _weighed_as_is(self, state: State, k: int) -> SelectedTerm:
        """The k-th term weighed beside the others as it is."""
        tested = state.tested[k]
        term = tested.term
        test = self.beside(state, k)
        weighed = ModelScan(self.scan, test)
        if self.problem.curved and not is_process(term):
            worth = weighed.by_columns(term, self.columns_at_estimate(test, state, k))
        else:
            worth = self._as_it_is(weighed, term)
        return replace(tested, gain=0.0) if worth is None else replace(tested, gain=worth.gain, volume=worth.volume)

    def _as_it_is(self, weighed: ModelScan, term: Term) -> Ranked | None:
        """A name with its number, a process with its kernel; None of a name that says nothing."""
        if is_process(term):
            return weighed.of_kernel(*self._process_of(term), term.kernel, term.rolloff, exact=True)
        return weighed.as_is(term)

    @staticmethod
    def columns_at_estimate(test: ScoreTest, state: State, k: int) -> Array:
        """The columns of the k-th term at its numbers, that of the largest part with all that the term contributes."""
        fit = state.fit
        model = fit.terms, fit.values
        term = fit.terms.terms[k]
        values = fit.values[fit.terms.slices[k]]
        columns = test.problem.columns([term], values, model)
        largest = np.argmax(np.linalg.norm(values[:, None, None] * columns, axis=(1, 2)))
        columns[largest] = contribution(test.problem, Terms((term,)), values, model)
        return columns

    def _within_bounds(self, state: State) -> State:
        """Without names whose numbers are beyond their bounds, or whose part in one noise group is likelier alone."""
        while True:
            beyond = [
                -np.inf if selected.term in self._preset else beyond_limits(self.problem, state.fit, k)
                for k, selected in enumerate(state.tested)
            ]
            k = int(np.argmax(beyond)) if beyond else 0
            if not beyond or beyond[k] <= IMPOSSIBLE:
                contradicted = next((k for k in range(len(beyond)) if self._is_contradicted(state, k)), None)
                if contradicted is None:
                    return state
                k = contradicted
            state = replace(self._left_out(state, k), refused=state.refused | {state.tested[k].term})

    def _is_contradicted(self, state: State, k: int) -> bool:
        """Tells whether the part of a name in one group of rows alone is likelier than the whole.

        A name acts on all groups by its definition: what one alone shows is something else, whatever it is.
        """
        term = state.tested[k].term
        if term.nonparametric or term in self._preset or len(set(self.problem.groups[self._rows(term, state)])) < 2:
            return False
        test = self.beside(state, k)
        columns = test.problem.columns(
            [term], state.fit.values[state.fit.terms.slices[k]], (test.fit.terms, test.fit.values)
        )
        groups = np.unique(self.problem.groups[np.any(columns, axis=(0, 2))])
        parts = [columns * (self.problem.groups == group)[:, None] for group in groups]
        whole, *alone = (
            float(evidence.gain + evidence.volume)
            for evidence in Marginal(test).of_names([columns, *parts], together=True)
        )
        return max(alone) > whole + CLOSE

    # -------------------------------------------------------------- exchange

    def _exchanged(self, state: State) -> State | None:
        """The state with another term, or names, in the place of one, where that is likelier; None where none is."""
        for k in np.argsort([selected.gain for selected in state.tested]).tolist():
            selected = state.tested[k]
            if selected.term in self._preset:
                continue
            if not selected.term.nonparametric and (paired := self._paired(state, k)) is not None:
                return paired
            if self.problem.curved and (merged := self._merged(state, k)) is not None:
                return merged
            absorbed = self._absorbed(state, k)
            if absorbed is not None and absorbed.evidence > state.evidence:
                return absorbed
            two = self._as_two_waves(state, k)
            if two is not None and (settled := self._settled(two)).evidence > state.evidence + BETTER:
                return settled
            likeliest = next(iter(self._in_place(state, k)), None)
            if likeliest is None or self._is(likeliest, selected.term):
                continue
            needed = self._needed(selected.term, bool(likeliest.process))
            if likeliest.net < selected.net + needed:
                continue
            candidate = self._settled(self._estimated(self._with(self._left_out(state, k), likeliest)))
            if candidate.evidence > state.evidence + needed:
                return candidate
        return None

    def _needed(self, old: Term, nonparametric: bool) -> float:
        """Log odds that another term must have over this one to take its place.

        A name may be slightly less likely than a process, but not than a read-out that wanders: that says nothing.
        """
        if old.nonparametric == nonparametric or self._is_noise(old):
            return BETTER
        return NEARLY if nonparametric else -NEARLY

    def _paired(self, state: State, k: int) -> State | None:
        """The state with another name beside one whose number is tried, where both together are likelier; else None."""
        selected = state.tested[k]
        if not self._has_number(selected.term):
            return None
        present = {term.label for term in state.fit.terms.terms}
        pair = self._likeliest_pair(self.beside(state, k), selected.term, selected.net, present)
        if pair is None:
            return None
        candidate = self._settled(self._estimated(self._with(self._left_out(state, k), *pair.names)))
        return candidate if candidate.evidence > state.evidence + BETTER else None

    def _merged(self, state: State, k: int) -> State | None:
        """The state with one name in the place of the k-th and of another name of its site, where that is likelier.

        Each of two names may describe a part of what a third one is: friction that falls with speed is less viscous
        friction, and more at rest. None where no such name is likelier than both.
        """
        site = state.tested[k].term.site
        if state.tested[k].term.nonparametric:
            return None
        likeliest = None
        for j, other in enumerate(state.tested[:k]):
            if other.term.nonparametric or other.term.site != site or other.term in self._preset:
                continue
            both = {state.tested[j].term.label, state.tested[k].term.label}
            test = self._beside_all_but(state, {j, k})
            named = self._not_refused(ModelScan(self.scan, test).named(), test, state)
            named = [name for name in named if name.site == site and name.cause[0] not in both]
            without = self._without(state, {j, k})
            for name in sorted(named, key=lambda name: -name.net)[:_RIVALS]:
                trial = self._settled(self._added(without, [name]))
                if trial.evidence > max(state.evidence, likeliest.evidence if likeliest else -np.inf):
                    likeliest = trial
        return likeliest

    def _absorbed(self, state: State, k: int) -> State | None:
        """The state with one process in the place of the k-th term, a name, and of a process beside it at its site.

        A step of the direction of motion and a curve of the velocity may be one function of both, of which the name
        says a part; a constant and what wanders may be what wanders more slowly. None where no such process is there,
        and of a name that nearly every problem has: it is known to be there.
        """
        term = state.tested[k].term
        if term.nonparametric or term.usual or self._component_of(term) is None:
            return None
        phrases = {phrase for phrase in _phrases(term) if phrase in self.scan.phrases}
        for j, beside in enumerate(state.tested):
            process = beside.term
            if process.site != term.site or not is_process(process):
                continue
            if not (kernel_of(process.kernel).takes_driver or (is_wander(process) and not phrases)):
                continue
            component, quantity_indices = self._process_of(process)
            together = sorted({*quantity_indices, *(self.scan.phrases.index(phrase) for phrase in phrases)})
            if len(phrases) < len(_phrases(term)) or len(together) > 2:
                continue
            rest = [selected for n, selected in enumerate(state.tested) if n not in (j, k)]
            test = self._beside_all_but(state, {j, k})
            likeliest = self._processes(test, component, [tuple(together)])
            if likeliest and likeliest[0].net >= MARGIN:
                bare = self._refitted(state, rest)
                return self._settled(self._estimated(self._with(bare, likeliest[0])))
        return None

    def _as_two_waves(self, state: State, k: int) -> State | None:
        """The state with waves of orders 1 and 2, its last terms, in the place of one between them.

        None where the k-th term is no wave, or no such waves are likely to first order.
        """
        wave = wave_of(self.problem, state.tested[k].term)
        if wave is None:
            return None
        family, order = wave
        for pair in ModelScan(self.scan, self.beside(state, k)).pairs_at(family.site):
            waves = [wave_of(self.problem, name.make()) for name in pair.names]
            orders = sorted(other[1] for other in waves if other is not None and other[0] is family)
            if len(orders) == 2 and orders[0] < order < orders[1]:
                if pair.net < state.tested[k].net - 2 * CLOSE:
                    return None
                return self.weighed(self._with(self._left_out(state, k), *pair.names))
        return None

    def _has_number(self, term: Term) -> bool:
        """Tells whether a number of a name is tried."""
        return not term.periodic and (bool(term.chosen) or self.scan.has_numbers(term))

    def _likeliest_pair(self, test: ScoreTest, term: Term, net: float, excluded: set[str]) -> Pair | None:
        """A name with another one beside it that is not `excluded`, where the two gain a margin over its own odds."""
        likeliest = next(
            (pair for pair in ModelScan(self.scan, test).together(term) if pair.names[1].cause[0] not in excluded), None
        )
        return None if likeliest is None or likeliest.net < net + MARGIN else likeliest

    def _likeliest_pair_at(self, test: ScoreTest, site: str, excluded: set[str]) -> Pair | None:
        """The likeliest two names of a site, neither of them `excluded`; where one has a number, with the likeliest."""
        pairs = ModelScan(self.scan, test).pairs_at(site)
        pair = next((pair for pair in pairs if not any(name.cause[0] in excluded for name in pair.names)), None)
        if pair is None:
            return None
        for name in pair.names:
            numbered = name.make()
            # those that are tried first, and then those near the likeliest of them
            while self._has_number(numbered):
                closer = self._likeliest_pair(test, numbered, pair.net, excluded)
                if closer is None:
                    break
                pair = closer
                numbered = pair.names[0].make()
        return pair

    def _named(self, state: State, k: int) -> State | None:
        """The state with names, one or several, in the place of a process, where that is likelier; else None.

        Of those that are as likely to first order, the fewest are fitted first.
        """
        process = state.tested[k]
        replaced = self._replaced_with(state, k)
        bare = None if len(replaced) == 1 else self._without(state, replaced)
        net = process.net if bare is None else state.evidence - self.weighed(bare).evidence
        for names, gain in self._names_for(state, k, replaced):
            needed = self._needed(process.term, bool(names[-1].process))
            if gain + CLOSE < net + needed:
                continue
            bare = bare or self._left_out(state, k)
            candidate = self._noise_chosen_again(self.dropped(self._added(bare, names)))
            if candidate.evidence > state.evidence + needed:
                return candidate
        return None

    def _replaced_with(self, state: State, k: int) -> set[int]:
        """The process that a name may replace; of a jump in time also the names of its site that have a number.

        A gear that gravity throws to its other flank jumps at a time. Of the jump and a play of another friction
        neither is likely without the other, and one play of the right friction may be as likely as both.
        """
        term = state.tested[k].term
        if not (is_process(term) and kernel_of(term.kernel).any_sample):
            return {k}
        replaced = {k}
        for j, selected in enumerate(state.tested):
            name = selected.term
            if name.site == term.site and not name.nonparametric and self._is_open(name):
                replaced.add(j)
        return replaced

    def _names_for(self, state: State, k: int, replaced: set[int]) -> Iterator[tuple[list[Ranked], float]]:
        """Sets of names that may replace a process, each name the likeliest beside those before, and their log odds.

        It is one of the terms that are `replaced`.

        After each, two names of the site in the place of the last ones: one wave of any order may be as likely to first
        order as two of whole ones. Then the same beside a process of one of the two quantities that the process has,
        and beside a read-out that wanders.
        """
        process = state.tested[k].term
        assert is_process(process)
        test = self._beside_all_but(state, replaced)
        names = list[Ranked]()
        gain = 0.0
        rows = self._rows(process, state)
        model = (state.fit.terms, state.fit.values)
        excluded = {term.label for term in (*state.refused, *test.fit.terms.terms) if not term.periodic}
        component, quantity_indices = self._process_of(process)
        while len(names) < _NAMES_FOR_PROCESS:
            likeliest = self._likeliest_name(test, state, rows, excluded)
            if likeliest is None:
                return
            pair = None
            if self._has_number(term := likeliest.make()):
                pair = self._likeliest_pair(test, term, likeliest.net, excluded)
            more, net = ((likeliest,), likeliest.net) if pair is None else pair
            site_pair = self._likeliest_pair_at(test, process.site, excluded)
            if site_pair is not None and site_pair.net > net + MARGIN:
                more, net = site_pair
                site_pair = None
            before = names, gain
            excluded |= {name.cause[0] for name in more}
            names = [*names, *more]
            gain = gain + net
            test = test.extend(test.problem.columns([name.make() for name in more], beside=model))
            yield names, gain
            if site_pair is not None:
                yield [*before[0], *site_pair.names], before[1] + site_pair.net
            wandering = [(self.scan.drivers,)] if self.scan.is_read_out(component.site) else []
            for less in self._processes(test, component, [*_either(quantity_indices), *wandering]):
                if less.net >= MARGIN:
                    yield [*names, less], gain + less.net

    def _likeliest_name(self, test: ScoreTest, state: State, rows: Mask, excluded: set[str]) -> Ranked | None:
        """The likeliest name not `excluded` that acts on some rows, of those worth their cost, usual ones first."""
        names = [
            name
            for name in ModelScan(self.scan, test).names_and_waves()
            if name.cause[0] not in excluded and name.net >= MARGIN
        ]
        names = [name for name in names if (self._rows(name.make(), state) & rows).any()]
        return next((name for name in names if name.make().usual), names[0] if names else None)

    def _processes(self, test: ScoreTest, component: Component, sets: Sequence[tuple[int, ...]]) -> list[Ranked]:
        """The likeliest kernel of each of some sets of quantities, as far as these say anything."""
        weighed = ModelScan(self.scan, test)
        return [
            likeliest
            for quantity_indices in sets
            if (likeliest := weighed.alike(component, quantity_indices)) is not None
        ]

    def _in_place(self, state: State, k: int) -> list[Ranked]:
        """The alternatives of the k-th term, that itself among them, the likeliest first."""
        key = id(state.fit), k
        if key not in self._known:
            rows = self._rows(state.tested[k].term, state)
            test = self.beside(state, k)
            term = state.tested[k].term
            likely = self._process_of(term)[0] if is_process(term) else None
            lowest_odds = state.tested[k].net - CLOSE
            candidates = self._not_refused(ModelScan(self.scan, test, rows, likely).ranked(lowest_odds), test, state)
            continued = [self._continued(candidate, test.fit.terms.terms) for candidate in candidates]
            ordered = continued if continued == candidates else sorted(continued, key=lambda candidate: -candidate.net)
            self._known[key] = state.fit, ordered  # the fit is kept, so that no other one has its identity
        return self._known[key][1]

    def names_instead(self, state: State, k: int, always: Sequence[Term] = ()) -> list[State]:
        """States with another name in the place of the k-th, one that moves the same rows, each fitted.

        These are names that by their columns are worth `_LIKELY` of the likeliest, and move enough rows to come near.

        Args:
            state: of which a term is exchanged.
            k: its place.
            always: names that are fitted whatever their columns say.
        """
        term = state.tested[k].term
        moved = self._rows(term, state)
        test = self.beside(state, k)
        named = self._names_moving(moved, test, state)
        named = [name for name in named if name.cause[0] != term.label]
        least = _LIKELY * max((name.net for name in named), default=0.0)
        named = [name for name in named if name.net >= least]
        present = {term.label, *(name.cause[0] for name in named)}
        weighed = ModelScan(self.scan, test)
        asked = [weighed.as_is(other) for other in always if other.label not in present]
        named += self._not_refused([name for name in asked if name is not None], test, state)
        without = self._left_out(state, k)
        near = state.evidence - CLOSE - without.evidence
        instead = list[State]()
        for name in named:
            if self._most_gained(name, moved, without) < near:
                continue
            trial = self._within_bounds(self._with(without, name))
            if len(trial.tested) > len(without.tested):
                instead.append(self.weighed(trial))
        return instead

    def alternatives(self, state: State, every: int = 1) -> list[tuple[Alternative, ...]]:
        """The alternatives of each term; gains are multiplied by the samples for which each sample stands."""
        alternatives_by_term = list[tuple[Alternative, ...]]()
        for k, selected in enumerate(state.tested):
            if selected.term in self._preset:
                alternatives_by_term.append(())
                continue
            test = self.beside(state, k)
            alternatives = list[Alternative]()
            listed_keys = set[object]()
            gaps = [
                (every * (selected.gain - candidate.gain) - (selected.cost - candidate.cost), candidate)
                for candidate in self._in_place(state, k)
            ]
            near = sorted((pair for pair in gaps if pair[0] < CLOSE), key=lambda pair: pair[0])
            # a process of a name's own driver at its site is that name, unless it is as likely
            names = [selected.term, *(candidate.make() for _, candidate in near if not candidate.process)]
            named_drivers = {
                (name.site, driver.phrase) for name in names if not name.nonparametric for driver in name.drivers
            }
            for gap, candidate in near:
                key = candidate.site, candidate.cause
                if len(alternatives) == LISTED:
                    break
                if (
                    candidate.process
                    and gap >= NEARLY
                    and any((candidate.site, phrase) in named_drivers for phrase in candidate.cause)
                ):
                    continue
                if (
                    not self._contains(candidate, selected.term)
                    and not self._is_near_order(candidate, selected.term)
                    and key not in listed_keys
                    and self._is_possible(test, candidate)
                ):
                    listed_keys.add(key)
                    alternatives.append(Alternative(candidate.make(), max(gap, 0.0)))
            alternatives += self._rivals(
                test, selected, every, {alternative.term.label for alternative in alternatives}
            )
            if every == 1 and (absorbed := self._absorbed(state, k)) is not None:
                gap = state.evidence - absorbed.evidence
                new = [test.term for test in absorbed.tested if test.term not in state.fit.terms.terms]
                if gap < CLOSE and new:
                    alternatives.append(Alternative(new[0], max(gap, 0.0)))
                    alternatives.sort(key=lambda alternative: alternative.gap)
            if (wave := wave_of(self.problem, selected.term)) is not None:
                waves = as_likely(test, *wave, CLOSE / every)
                alternatives += [Alternative(wave[0].term(order), every * gap) for order, gap in waves]
                two = self._as_two_waves(state, k)
                if two is not None and (gap := _gap(state, two, every)) < CLOSE:
                    low, high = (weighed.term for weighed in two.tested[-2:])
                    alternatives.append(Alternative(low, max(gap, 0.0), (high,)))
                alternatives.sort(key=lambda alternative: alternative.gap)
            alternatives_by_term.append(tuple(alternatives))
        return alternatives_by_term

    def _rivals(self, test: ScoreTest, selected: SelectedTerm, stride: int, excluded: set[str]) -> list[Alternative]:
        """The rivals of a term that are tried and not `excluded`, however much less these explain in its place."""
        rivals = list[Alternative]()
        for rival in (term for term in selected.term.rivals if term in self.scan.names and term.label not in excluded):
            weighed = ModelScan(self.scan, test).as_is(rival)
            gain, cost = (0.0, selected.cost) if weighed is None else (weighed.gain, weighed.cost)
            rivals.append(Alternative(rival, max(stride * (selected.gain - gain) - (selected.cost - cost), 0.0)))
        return rivals

    def _is_possible(self, test: ScoreTest, ranked: Ranked) -> bool:
        """False of a name of one number whose estimate is far beyond its bounds; else true."""
        term = ranked.make()
        if ranked.process or term.size != 1:
            return True
        score, ((lower, upper),) = test.score([term])[0], self.problem.limits(term)
        value = float(score.values[0])
        std = abs(value) / max(np.sqrt(2 * score.gain), 1e-300)
        return max(lower - value, value - upper) <= IMPOSSIBLE * std

    def _contains(self, ranked: Ranked, term: Term) -> bool:
        """Tells whether a ranked term is this one, or a process of its quantities and another one at its site."""
        phrases = {driver.phrase for driver in term.drivers}
        more = term.nonparametric and ranked.site == term.site and bool(ranked.process) and phrases <= set(ranked.cause)
        return more or self._is(ranked, term)

    def _is_near_order(self, ranked: Ranked, term: Term) -> bool:
        """Tells whether it is a wave of no whole order of an angle of which a term is one: both are the likeliest."""
        wave = wave_of(self.problem, term)
        candidate_wave = None if ranked.process else wave_of(self.problem, ranked.make())
        if wave is None or candidate_wave is None:
            return False
        return candidate_wave[0] is wave[0] and candidate_wave[1] % 1 != 0

    def _is(self, ranked: Ranked, term: Term) -> bool:
        """Tells whether a ranked term is this one, or a process of the same quantities at its site."""
        if ranked.site != term.site:
            return False
        if term.nonparametric:
            return bool(ranked.process) and ranked.cause == _phrases(term)
        if ranked.process:
            return False
        name = ranked.make()
        is_number_chosen = term.chosen is not None and not term.periodic
        return name == term or (is_number_chosen and name.label == term.label)

    # -------------------------------------------------------------- noise

    def _settled(self, state: State) -> State:
        """Without what is not possible or not worth its cost, in the noise that is then left."""
        return self._noise_chosen_again(self.dropped(self._within_bounds(state)))

    def _noise_chosen_again(self, state: State) -> State:
        """White noise stays white: `selected` asks for another. Where noise turns white, terms are estimated anew."""
        if state.fit.noise.white:
            return state
        again = replace(state, fit=self.in_likeliest_noise(state.fit))
        return self.dropped(self._within_bounds(self._estimated(again))) if again.fit.noise.white else again

    def in_likeliest_noise(self, fitted: Fit) -> Fit:
        """The same terms fitted in the likeliest noise of their residuals; the fit itself where all is white."""
        noise = remaining_noise_model(self.problem, fitted, self.options)
        if noise.white and fitted.noise.white:
            return fitted
        start = fitted.values, fitted.nuisance, fitted.training
        return fit(self.problem, fitted.terms, self.options, *start, noise, whitened=self._whitened)


def _gap(state: State, other: State, every: int) -> float:
    """By which another state is less likely, where each sample stands for some; costs are of the choice of terms."""
    cost = sum(selected.cost for selected in other.tested) - sum(selected.cost for selected in state.tested)
    return every * (state.evidence - other.evidence - cost) + cost


def is_known(problem: Problem, term: Term) -> bool:
    """Tells whether a problem has what a term acts on and depends on."""
    if is_process(term):
        names = {component.name for component in components_at(problem, term.site)}
        phrases = {quantity.driver.phrase for quantity in problem.quantities}
        return term.component in names and phrases.issuperset(_phrases(term))
    if term.periodic:
        return any(family.site == term.site for family in problem.periodic)
    return any(candidate.label == term.label for candidate in problem.candidates)


def _phrases(term: Term) -> tuple[str, ...]:
    """Phrases of its quantities, as `Ranked.cause` of a process."""
    return tuple(driver.phrase for driver in term.drivers)


def _either(quantity_indices: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Each of two quantities alone."""
    return [(k,) for k in quantity_indices] if len(quantity_indices) > 1 else []
