"""Functions without a name: the likely ones at every site, beside a model or where autocorrelated noise masks them."""

from collections.abc import Sequence
from dataclasses import replace
from heapq import nlargest
from typing import NamedTuple, final

import numpy as np

from lite6jax.estimation.equations import explained_by
from lite6jax.estimation.multiplicity import description_length, log_functions, multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import ScoreTest, gain_p_value, remaining_noise_model, score_test
from lite6jax.estimation.terms import Term
from lite6jax.search.against_noise import in_own_noise
from lite6jax.search.backward import prune
from lite6jax.search.curves import local_curves_of, with_curve
from lite6jax.search.state import State, preferred, reduced


class LikelyFunction(NamedTuple):
    """A function without a name, and the log-likelihood that it gains beyond the cost of its numbers."""

    term: Term
    gain: float


def unmasked(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state with a function without a name that leaves white noise, where autocorrelated residuals mask it.

    Along a slow motion an effect that the catalogue lacks looks like autocorrelated noise, in which nothing is
    significant. So the function in white noise is compared with autocorrelated noise without it, by likelihood. It
    must leave white noise in all groups: what two effects, or an effect and such noise, do is not told apart here.
    """
    correlated = in_own_noise(problem, state.fit, options)
    if correlated.noise.white:
        return state
    choices = list[State]()
    likely = likely_functions(problem, score_test(problem, state.fit, options, time=1.0), options)
    for choice in with_each(problem, state, likely, options):
        function = choice.tested[-1].term
        gain = choice.fit.own_likelihood - correlated.own_likelihood
        significant = gain_p_value(gain, function.size, 1.0) * multiplicity(problem, function, options) < options.level
        if function.nonparametric and significant and remaining_noise_model(problem, choice.fit, options).white:
            choices.append(choice)
    return most_preferred(problem, state, choices, options) or state


def beside_noise(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state, in which nothing was found, with a function without a name that is significant in its noise.

    The noise is autocorrelated with the function as without it; either model has the most likely noise of what it
    leaves. The function joins only if those at other sites are clearly less likely: such noise hides how they differ.
    """
    if state.tested or state.fit.noise.white:
        return state
    # this noise has taken up a part of the function: whether it is worth its numbers shows in its own
    likely = likely_functions(problem, score_test(problem, state.fit, options), options, least=-np.inf)
    gains: list[tuple[float, State]] = []
    for choice in with_each(problem, state, likely, options):
        if len(choice.tested) != 1 or not choice.tested[0].term.nonparametric:
            continue
        own = replace(choice, fit=in_own_noise(problem, choice.fit, options))
        function = own.tested[0].term
        gain = own.fit.own_likelihood - state.fit.own_likelihood
        p_value = min(gain_p_value(gain, function.size, 1.0) * multiplicity(problem, function, options), 1.0)
        length = description_length(problem, [function], own.fit.freedom, options)
        if p_value < options.level and gain > length + options.close:
            tested = replace(own.tested[0], p_value=p_value, score=own.tested[0].score._replace(gain=gain))
            gains.append((gain - length, replace(own, tested=(tested,))))
    if not gains:
        return state
    most, best = max(gains, key=lambda one: one[0])
    site = best.tested[0].term.site
    elsewhere = max((gain for gain, other in gains if other.tested[0].term.site != site), default=0.0)
    return best if most > elsewhere + options.close else state


def most_preferred(problem: Problem, state: State, choices: Sequence[State], options: EngineOptions) -> State | None:
    """The most likely of the states that are clearly more likely than another; None where none is."""
    best: State | None = None
    for choice in choices:
        if preferred(problem, choice, best or state, 0.0 if best else options.close, options):
            best = choice
    return best


def in_place_of(
    problem: Problem, state: State, k: int, options: EngineOptions, rest: State | None = None, alike: bool = False
) -> list[State]:
    """The state with each likely function in the place of its k-th term.

    Args:
        problem: the data.
        state: the model.
        k: which of its terms.
        options: thresholds.
        rest: the state without it, where it is known.
        alike: whether functions of its site that share a driver with it are tried too, if it is itself a function. That
            one of them is likely says nothing of the others there, where these are sought.
    """
    term, rest = state.tested[k].term, rest or reduced(problem, state, k, options)
    test = score_test(problem, rest.fit, options, within=state.fit)
    but = term if term.nonparametric and not alike else None
    return with_each(problem, rest, likely_functions(problem, test, options, but=but), options)


def with_each(
    problem: Problem, state: State, functions: Sequence[LikelyFunction], options: EngineOptions
) -> list[State]:
    """The state with each of these functions, as fine as is likely, without the terms that it makes unnecessary."""
    further = [
        _finest(problem, state, with_curve(problem, state, function.term, options), options)
        for function in functions
        if _has_samples(state, function.term, options)
    ]
    return [prune(problem, one, options) for one in further if one.tested[-1].p_value < options.level]


def _finest(problem: Problem, state: State, further: State, options: EngineOptions) -> State:
    """A state and one more function, or in its place the most likely finer one of its drivers.

    What a function does not describe of its own driver, functions of other drivers elsewhere would seem to explain.
    """
    term = further.tested[-1].term
    functions = [term, *(one for one in term.finer if _has_samples(state, one, options))]
    if len(functions) == 1:
        return further
    test = score_test(problem, state.fit, options, within=further.fit)
    scored = zip(functions, test.explained(functions), strict=True)
    gains = [one.gain - description_length(problem, [t], test.freedom, options) for t, one in scored]
    best = int(np.argmax(gains))
    if gains[best] <= gains[0] + options.close:
        return further
    finer = with_curve(problem, state, functions[best], options)
    return finer if preferred(problem, finer, further, options.close, options) else further


def _has_samples(state: State, function: Term, options: EngineOptions) -> bool:
    """Whether there are samples enough for one more function at a site that has functions."""
    there = [one for one in state.fit.terms.terms if one.nonparametric and one.site == function.site]
    numbers = function.size + sum(one.size for one in there)
    return not there or numbers * options.samples_a_number <= state.fit.training.sum()


def likely_functions(
    problem: Problem,
    test: ScoreTest,
    options: EngineOptions,
    site: str | None = None,
    least: float | None = None,
    but: Term | None = None,
) -> list[LikelyFunction]:
    """The few functions that are most likely beside a tested fit.

    Of one driver and of several each, the likeliest of each of `functions` sites, and the `ranked` likeliest of all. Of
    each, the parts that it contains, such as one component of a displacement, are tried too.

    Functions of two drivers, of which there are many, imitate one of another driver to first order, and a refit tells
    them apart.

    Args:
        problem: the data.
        test: of the fit beside which they are.
        options: thresholds.
        site: the only one, where given.
        least: gain that they must exceed; `close` where not given.
        but: a function; those at its site that share a driver with it are left out.
    """
    flexible = [*(term for term in problem.flexible if site in (None, term.site)), *local_curves_of(test, site)]
    if but is not None:
        flexible = [one for one in flexible if one.site != but.site or not set(one.drivers) & set(but.drivers)]
    least = options.close if least is None else least
    ranking = _Ranking(least, options, by_site=site is None)
    half_log_n = 0.5 * np.log(test.freedom)
    equations = test.equations(flexible)
    wholes = list(zip(flexible, equations, explained_by(equations, options.confounded), strict=True))
    for whole, _, one in wholes:
        # what the names and the nuisance explain already costs nothing
        length = description_length(problem, [whole], test.freedom, options) - (whole.size - one.size) * half_log_n
        ranking.add(whole, whole, one.gain - length)
    likely = [(one.gain - log_functions(problem, whole, options), whole, inside) for whole, inside, one in wholes]
    for most, whole, inside in sorted(likely, key=lambda each: -each[0]):
        if most - half_log_n <= max(ranking.reached, least, 0.0):
            break  # a part hardly explains more than the whole
        parts, a_function = whole.parts, log_functions(problem, whole, options)
        for part, own in zip(parts, test.explained_parts(inside, parts), strict=True):
            gain = own.gain - own.size * half_log_n - a_function
            if ranking.may_add(whole, gain):
                ranking.add(whole, part.made(), gain)
    found = [one for kind in ranking.of_sites() for one in _sure(kind, test, options)[: options.functions]]
    return [*found, *_sure([one for one in ranking.of_all() if one not in found], test, options)]


@final
class _Ranking:
    """The likeliest functions: of each site, those of one driver and those of several apart, and of all.

    Without `by_site`, where all functions are of one site, they are ranked singly.
    """

    def __init__(self, least: float, options: EngineOptions, by_site: bool) -> None:
        self._least, self._by_site = least, by_site
        self._of_each, self._of_all = 2 * options.functions, options.ranked
        self._likeliest: dict[object, LikelyFunction] = {}
        self._every: dict[object, LikelyFunction] = {}

    def may_add(self, whole: Term, gain: float) -> bool:
        """Whether a part of a function, of however many drivers, would be likelier than what is there."""
        there = (self._likeliest.get(self._key(whole, several)) for several in (False, True))
        return any(gain > self._gain(one) for one in (*there, self._every.get(whole)))

    def add(self, whole: Term, term: Term, gain: float) -> None:
        """Adds a function, or a part of it, where that is likelier than what is there."""
        key = self._key(whole, len(term.drivers) > 1)
        for found, place in ((self._likeliest, key), (self._every, whole)):
            if gain > self._gain(found.get(place)):
                found[place] = LikelyFunction(term, gain)

    @property
    def reached(self) -> float:
        """What a function must exceed to be among the likeliest, those of sites or those of all."""
        kinds = self._kinds()
        if min(map(len, kinds)) < self._of_each or len(self._every) < self._of_all:
            return -np.inf
        return min(*(kind[self._of_each - 1].gain for kind in kinds), self.of_all()[-1].gain)

    def of_sites(self) -> list[list[LikelyFunction]]:
        """The likeliest of sites, of one driver and of several, the likeliest first."""
        return [kind[: self._of_each] for kind in self._kinds()]

    def of_all(self) -> list[LikelyFunction]:
        """The likeliest of all, the likeliest first."""
        return nlargest(self._of_all, self._every.values(), key=lambda one: one.gain)

    def _kinds(self) -> list[list[LikelyFunction]]:
        ranked = sorted(self._likeliest.values(), key=lambda one: -one.gain)
        return [[one for one in ranked if (len(one.term.drivers) > 1) == several] for several in (False, True)]

    def _key(self, whole: Term, several: bool) -> object:
        return (whole.site, several) if self._by_site else whole

    def _gain(self, one: LikelyFunction | None) -> float:
        return self._least if one is None else one.gain


def _sure(likely: Sequence[LikelyFunction], test: ScoreTest, options: EngineOptions) -> list[LikelyFunction]:
    """Those that noise does not explain."""
    scored = zip(likely, test.score([one.term for one in likely]), strict=True)
    return [
        one
        for one, score in scored
        if gain_p_value(score.gain, score.size, test.time) * multiplicity(test.problem, one.term, options)
        < options.level
    ]
