"""The selection of terms by evidence: add, re-estimate, drop, exchange.

1. Add the term whose evidence most exceeds the cost of its choice, if by a margin.
2. Estimate the amplitude and the kernel of every process anew, the others integrated over.
3. Drop the term that is least worth its cost, as long as one is not.
4. Where nothing more is worth adding, exchange each term for whatever is likelier in its place.
"""

from dataclasses import replace

import numpy as np

from lite6jax.estimation.evidence import Marginal
from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import ScoreTest, remaining_noise_model, score_test
from lite6jax.estimation.terms import Term
from lite6jax.search.scan import Considered, Ranked, Scan
from lite6jax.search.state import Alternative, SelectedTerm, State, beyond_limits, refitted, without


class Selector:
    """A problem with all that is tried in it."""

    def __init__(self, problem: Problem, options: EngineOptions, among: Considered | None = None) -> None:
        self.problem, self.options, self.scan = problem, options, Scan(problem, options, among)
        self._preset = problem.preset[0].terms
        self._known: dict[tuple[int, int], list[Ranked]] = {}

    # -------------------------------------------------------------- the search

    def selected(self, state: State, thorough: bool) -> State:
        """The likeliest set of terms, in the likeliest noise."""
        white = self._grown(state, thorough)
        own = self.in_own_noise(white.fit)
        if own.noise.white:
            return white
        # noise that is autocorrelated explains residuals as terms do: either may be there first
        after = self._grown(self._dropped(replace(white, fit=own)), thorough)
        before = self._grown(replace(state, fit=self.in_own_noise(state.fit)), thorough)
        return max(before, after, key=lambda one: one.evidence)

    def _grown(self, state: State, thorough: bool) -> State:
        exchanged = 0
        while True:
            state = self._with_all_worth(state)
            if not thorough or exchanged >= self.options.exchanges:
                return state
            better = self._exchanged(state)
            if better is None:
                return state
            state, exchanged = better, exchanged + 1

    def _with_all_worth(self, state: State) -> State:
        tried = set[object]()
        while len(state.tested) < self.options.most_terms:
            test = score_test(self.problem, state.fit, self.options)
            worth = [
                one for one in self._ranked(test, state) if one.net >= self.options.margin and one.key not in tried
            ]
            if not worth:
                break
            tried.add(worth[0].key)
            more = self._estimated(self._with(state, worth[0]))
            more = self._dropped(self._within_bounds(more))
            if not more.fit.noise.white:
                more = replace(more, fit=self.in_own_noise(more.fit))
            state = more
        return state

    def _ranked(self, test: ScoreTest, state: State) -> list[Ranked]:
        refused = {term.label for term in state.refused}
        return [one for one in self.scan.ranked(test) if one.place or one.cause[0] not in refused]

    def _with(self, state: State, ranked: Ranked) -> State:
        term = ranked.make()
        kept = [one for one in state.tested if one.term not in term.includes]
        new = SelectedTerm(term, ranked.gain, ranked.cost, ranked.volume)
        return refitted(self.problem, state, [*kept, new], self.options)

    # -------------------------------------------------------------- each term beside the others

    def beside(self, state: State, k: int) -> ScoreTest:
        """The test of the model without its k-th term, in the noise that is left with it."""
        return score_test(self.problem, without(state.fit, k), self.options, within=state.fit)

    def _estimated(self, state: State) -> State:
        """Each term weighed beside the others, the amplitude and the kernel of each process anew."""
        tested, changed = list(state.tested), False
        for k, one in enumerate(tested):
            if one.term in self._preset:
                continue
            found = self._weighed(self.beside(state, k), one)
            if found.term != one.term:
                changed = True
            tested[k] = found
        if not changed:
            return replace(state, tested=tuple(tested))
        return refitted(self.problem, state, tested, self.options)

    def _weighed(self, test: ScoreTest, one: SelectedTerm) -> SelectedTerm:
        term = one.term
        if not term.nonparametric:
            columns = self.problem.columns([term], beside=(test.fit.terms, test.fit.values))
            (evidence,) = Marginal(test).of_names([columns])
            return replace(one, gain=float(evidence.gain), volume=float(evidence.volume))
        component, which = self._process_of(term)
        best = self.scan.alike(test, component, which)
        if best is None:
            return replace(one, gain=0.0)
        return replace(one, term=best.make(), gain=best.gain, cost=best.cost, volume=best.volume)

    def _process_of(self, term: Term):  # type: ignore[no-untyped-def]
        component = next(
            c for c in self.problem.components if (c.site, c.name) == (term.site, getattr(term, "component", ""))
        )
        phrases = [driver.phrase for driver in term.drivers]
        place = {one.driver.phrase: k for k, one in enumerate(self.scan.quantities)}
        return component, tuple(place[phrase] for phrase in phrases)

    def _dropped(self, state: State) -> State:
        """Without the terms that are not worth their cost, the least of them first."""
        while True:
            tested = [
                one if one.term in self._preset else self._weighed_as_is(self.beside(state, k), one)
                for k, one in enumerate(state.tested)
            ]
            nets = [np.inf if one.term in self._preset else one.net for one in tested]
            if not nets or min(nets) >= self.options.margin:
                return replace(state, tested=tuple(tested))
            k = int(np.argmin(nets))
            state = refitted(self.problem, state, [*tested[:k], *tested[k + 1 :]], self.options)

    def _weighed_as_is(self, test: ScoreTest, one: SelectedTerm) -> SelectedTerm:
        found = self._weighed(test, one)
        return replace(one, gain=found.gain, volume=found.volume)

    def _within_bounds(self, state: State) -> State:
        """Without names that are not possible."""
        while True:
            beyond = [
                -np.inf if one.term in self._preset else beyond_limits(self.problem, state.fit, k)
                for k, one in enumerate(state.tested)
            ]
            k = int(np.argmax(beyond)) if beyond else 0
            if not beyond or beyond[k] <= self.options.impossible:
                return state
            refused = state.refused | {state.tested[k].term}
            rest = [*state.tested[:k], *state.tested[k + 1 :]]
            state = replace(refitted(self.problem, state, rest, self.options), refused=refused)

    # -------------------------------------------------------------- exchange

    def _exchanged(self, state: State) -> State | None:
        """The state with another term, or names, in the place of one, where that is likelier; None where none is."""
        for k in np.argsort([one.gain for one in state.tested]).tolist():
            one = state.tested[k]
            if one.term in self._preset:
                continue
            if one.term.nonparametric and (named := self._named(state, k)) is not None:
                return named
            best = next(iter(self._in_place(state, k)), None)
            if best is None or best.net < one.net + self.options.better or self._is(best, one.term):
                continue
            rest = refitted(self.problem, state, [*state.tested[:k], *state.tested[k + 1 :]], self.options)
            trial = self._dropped(self._within_bounds(self._estimated(self._with(rest, best))))
            if trial.evidence > state.evidence + self.options.better:
                return trial
        return None

    def _named(self, state: State, k: int) -> State | None:
        """The state with names, one or several, in the place of a process, where that is likelier; else None."""
        trial = refitted(self.problem, state, [*state.tested[:k], *state.tested[k + 1 :]], self.options)
        fewest = len(trial.tested)
        while len(trial.tested) < fewest + self.options.names_for_process:
            test = score_test(self.problem, trial.fit, self.options, within=None)
            best = max(self.scan.named(test), key=lambda one: one.net, default=None)
            if best is None or best.net < self.options.margin or best.cause[0] in {t.label for t in trial.refused}:
                break
            more = self._within_bounds(self._with(trial, best))
            if len(more.tested) <= len(trial.tested):
                break
            trial = self._estimated(more)
            if trial.evidence > state.evidence:
                return self._dropped(trial)
        return None

    def _in_place(self, state: State, k: int) -> list[Ranked]:
        """What may stand in the place of the k-th term, that itself among it, the likeliest first."""
        key = id(state.fit), k
        if key not in self._known:
            self._known[key] = self._ranked(self.beside(state, k), state)
        return self._known[key]

    def with_alternatives(self, state: State) -> State:
        """Each term with what may stand in its place."""
        tested = []
        for k, one in enumerate(state.tested):
            if one.term in self._preset:
                tested.append(one)
                continue
            test = self.beside(state, k)
            one = self._weighed_as_is(test, one)
            others, seen = [], set[object]()
            for other in self._in_place(state, k):
                gap = one.net - other.net
                said = other.site, other.cause
                if gap >= self.options.close or len(others) == self.options.listed:
                    break
                if not self._is(other, one.term) and said not in seen:
                    seen.add(said)
                    others.append(Alternative(other.make(), max(gap, 0.0)))
            tested.append(replace(one, alternatives=tuple(others)))
        return replace(state, tested=tuple(tested))

    def _is(self, ranked: Ranked, term: Term) -> bool:
        """Whether a ranked term is this one, or a process of the same quantities at its site."""
        if ranked.site != term.site:
            return False
        if term.nonparametric:
            return bool(ranked.place) and ranked.cause == tuple(driver.phrase for driver in term.drivers)
        return not ranked.place and ranked.make() == term

    # -------------------------------------------------------------- noise

    def in_own_noise(self, fitted: Fit) -> Fit:
        """The same terms fitted in the likeliest noise of their residuals; the fit itself where all is white."""
        noise = remaining_noise_model(self.problem, fitted, self.options)
        if noise.white and fitted.noise.white:
            return fitted
        return fit(self.problem, fitted.terms, self.options, fitted.values, fitted.nuisance, fitted.training, noise)
