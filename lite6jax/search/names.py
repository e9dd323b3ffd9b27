"""Tests of names: a name stands only where its numbers are possible and no function without a name is clearly likelier.

The candidates of a search are never all that there is. Where the truth is none of them, the nearest one wins the search
and is wrong; its significance against noise says nothing of that. So functions of every driver at every site are scored
against what the named terms leave. Where one of them, beside the names or in place of one, is clearly more likely, it
joins the model, and the names that it makes unnecessary leave.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from lite6jax.estimation.concentration import Concentration, concentration
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.multiplicity import description_length, multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem, wave_of
from lite6jax.estimation.score_test import ScoreTest, gain_p_value, score_test
from lite6jax.estimation.terms import Term
from lite6jax.search.against_noise import in_own_noise, is_noise
from lite6jax.search.backward import eliminate, prune
from lite6jax.search.forward import forward, with_term
from lite6jax.search.functions import likely_functions, most_preferred, with_each, with_functions
from lite6jax.search.state import (
    Alternative,
    SelectedTerm,
    State,
    extended,
    preferred,
    reduced,
    refitted,
    retested,
)
from lite6jax.search.whole_orders import slow_waves

_CYCLES = 16.0
"""Of a wave in the range of its angle: twice as many as the pieces of a spline without a name."""


def challenge_names(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state with names that the data do not contradict, and functions without a name for what is left."""
    state = _shaped_instead(problem, believable(problem, state, options), options)
    for _ in range(options.name_rounds):
        better = _more_likely(problem, state, options)
        if better is None:
            break
        state = believable(problem, better, options)
    return _one_for_names(problem, _named_again(problem, state, options), options)


def _shaped_instead(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state in which named terms with a number that is tried take the place of others at their site.

    Forward selection leaves them out, because they come close to others: a step of the load comes close to the load
    itself, and a step and a line together to a slow wave. Such a term is therefore tried in the place of each other
    one, alone and together with a second name of that site. In the place of a function without a name it need not be
    clearly likelier; it then lists the function.
    """
    for tested in state.tested:
        if tested.term.chosen is not None or tested.term not in state.fit.terms.terms:
            continue
        rest = reduced(problem, state, state.fit.terms.terms.index(tested.term), options)
        test = score_test(problem, rest.fit, options, within=state.fit)
        now, within = test.explained([tested.term])[0].gain, state.fit
        for instead, gain in _with_shaped(test, tested.term):
            # correlated samples count as fewer
            needed, saved = test.time * (options.close if len(instead) == 1 else options.together), 0.0
            if tested.term.nonparametric and len(instead) == 1:
                one, other = (description_length(problem, [t], test.freedom, options) for t in (tested.term, *instead))
                needed, saved = 0.0, test.time * (one - other)
            if gain < now + needed - saved:
                continue
            choice = rest
            for term in instead:
                score = score_test(problem, choice.fit, options, within=within).score([term])[0]
                choice = with_term(problem, choice, term, score, options)
            n = choice.fit.freedom
            longer = description_length(problem, choice.fit.terms.terms, n, options) - description_length(
                problem, state.fit.terms.terms, n, options
            )
            if choice.fit.gain_over(state.fit) <= needed + test.time * longer:
                continue
            # a function is tested by its gain, a name in blocks of samples, of which there may be too few
            if not tested.term.nonparametric or _all_significant(problem, choice, options):
                state = _listing(problem, choice, rest, state, tested.term, options)
    return _plain_again(problem, state, options)


def _all_significant(problem: Problem, state: State, options: EngineOptions) -> bool:
    time = score_test(problem, state.fit, options).time
    tests = (_tested_finally(problem, state, k, time, options) for k in range(len(state.tested)))
    return all(one.p_value < options.level for one in tests)


def _plain_again(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state with plain names in the place of those with a number that is tried, where they are as likely now.

    Beside the others that have joined since, that number may be needless: wind-up without friction is compliance.
    """
    for tested in state.tested:
        if tested.term.chosen is None or tested.term.periodic or tested.term in problem.preset[0].terms:
            continue
        rest = reduced(problem, state, state.fit.terms.terms.index(tested.term), options)
        plain = [term for term in problem.candidates if term.site == tested.term.site and term.chosen is None]
        plain = [term for term in plain if term not in rest.fit.terms.terms]
        scores = score_test(problem, rest.fit, options, within=state.fit).score(plain)
        cost = 0.5 * np.log(rest.fit.freedom)
        likely = [(s.gain - cost * s.size, k) for k, s in enumerate(scores) if not s.confounded]
        if not likely:
            continue
        best = max(likely)[1]
        choice = with_term(problem, rest, plain[best], scores[best], options)
        if preferred(problem, choice, state, 0.0, options):
            state = choice
    return state


def _with_shaped(test: ScoreTest, term: Term) -> Iterator[tuple[tuple[Term, ...], float]]:
    """Of the terms with a tried number at the site of `term`, the one that explains most, and how much.

    Then the same of such a term together with another name of the site.
    """
    problem = test.problem
    rivals = [rival for rival in problem.shaped if rival.site == term.site]
    if not rivals:
        return
    gains = [one.gain for one in test.explained(rivals)]
    yield (rivals[int(np.argmax(gains))],), max(gains)
    known = (*test.fit.terms.terms, term)
    others = [other for other in problem.candidates if other.site == term.site and other not in known]
    pairs: list[tuple[tuple[Term, ...], float]] = []
    for rival, gain in zip(rivals, gains, strict=True):
        columns = problem.columns([rival], beside=(test.fit.terms, test.fit.values))
        second = [other for other in others if other.label != rival.label]
        explained = test.given(columns).explained(second)
        pairs += [((other, rival), gain + one.gain) for other, one in zip(second, explained, strict=True)]
    yield from sorted(pairs, key=lambda pair: -pair[1])[:1]


def _named_again(problem: Problem, state: State, options: EngineOptions) -> State:
    """Named terms in the place of functions without a name, where they are as likely beside the other terms now.

    Where they are not clearly likelier, they list the function among their alternatives.
    """
    for tested in [tested for tested in state.tested if tested.term.nonparametric]:
        term, gain = tested.term, max(tested.score.gain, 1e-300)
        near = any(1 - alternative.gap / gain > options.named_share for alternative in tested.alternatives)
        if not near or term not in state.fit.terms.terms:
            continue
        rest = reduced(problem, state, state.fit.terms.terms.index(term), options)
        named = prune(problem, eliminate(problem, forward(problem, rest, options, shaped=True), options), options)
        named = believable(problem, named, options)
        if preferred(problem, named, state, 0.0, options):
            state = _listing(problem, named, rest, state, term, options)
    return state


def _listing(problem: Problem, named: State, rest: State, state: State, term: Term, options: EngineOptions) -> State:
    """The `named` state that takes the place of one with a further `term` than `rest`.

    Where that is a function, and the names at its site are not clearly likelier, these list it.
    """
    if not term.nonparametric or preferred(problem, named, state, options.close, options):
        return named
    function = Alternative(term, max(named.fit.gain_over(state.fit), 0.0))
    tested = [
        replace(one, alternatives=(*one.alternatives, function))
        if one.term not in rest.fit.terms.terms and one.term.site == term.site
        else one
        for one in named.tested
    ]
    return replace(named, tested=tuple(tested))


def _one_for_names(problem: Problem, state: State, options: EngineOptions) -> State:
    """One function without a name, or one slow wave, in the place of several terms, unless these are clearly likelier.

    The terms are those of one site, all names, or all there are. Several effects of the catalogue can add up to one
    that it does not have: at one site a spring and a slow wave to an end stop, at two a payload and a base that gives
    way to a sensor whose axes differ in scale. Over a part of a turn, an offset and a scale add up to a wave of
    order 1, and along one motion functions of two positions to one of the velocity. That so many effects are there at
    once is itself unlikely, the more so the more they are.
    """
    preset = problem.preset[0].terms
    while True:
        best: State | None = None
        for site, there in _together([tested for tested in state.tested if tested.term not in preset]):
            rest = refitted(problem, state, [t for t in state.tested if t not in there], options)
            test = score_test(problem, rest.fit, options, within=state.fit)
            named = [tested for tested in there if not tested.term.nonparametric]
            functions = with_each(problem, rest, likely_functions(problem, test, options, site), options)
            for choice in (*functions, *_with_slow_waves(problem, rest, test, options, site)):
                # beside the function a name may stay: it is then not what the function replaces
                choice = _restored(problem, choice, named, options)
                fewer = len(there) - sum(t.term in choice.fit.terms.terms for t in there)
                margin = options.together * (fewer - 1)
                if fewer > 1 and preferred(problem, choice, best or state, 0.0 if best else -margin, options):
                    best = choice
        if best is None:
            return state
        state = best


def _together(terms: Sequence[SelectedTerm]) -> Iterator[tuple[str | None, Sequence[SelectedTerm]]]:
    """Terms that one may replace, two at least: those of each site, and, of several sites, all names and all terms."""
    for site in sorted({tested.term.site for tested in terms}):
        there = [tested for tested in terms if tested.term.site == site]
        if len(there) > 1:
            yield site, there
    names = [tested for tested in terms if not tested.term.nonparametric]
    for group in (names, terms) if len(names) < len(terms) else (terms,):
        if len({tested.term.site for tested in group}) > 1:
            yield None, group


def _with_slow_waves(
    problem: Problem, rest: State, test: ScoreTest, options: EngineOptions, site: str | None
) -> list[State]:
    """The state with each of the lowest orders of a site that it does not have."""
    waves = [wave for wave in slow_waves(problem, site) if wave not in rest.fit.terms.terms]
    scored = zip(waves, test.score(waves), strict=True)
    return [with_term(problem, rest, wave, score, options) for wave, score in scored if not score.confounded]


def _restored(problem: Problem, state: State, names: Sequence[SelectedTerm], options: EngineOptions) -> State:
    """The state with those of some names that are significant beside its function, the most significant first."""
    left = list(names)
    while left:
        scores = score_test(problem, state.fit, options).score([tested.term for tested in left])
        p_values = [s.familywise(multiplicity(problem, t.term, options)) for s, t in zip(scores, left, strict=True)]
        k = int(np.argmin(p_values))
        if scores[k].confounded or p_values[k] >= options.level:
            break
        term = left.pop(k).term
        tested = SelectedTerm(term, p_values[k], scores[k])
        state = extended(problem, state, tested, scores[k].values, options)
    return prune(problem, state, options)


def believable(problem: Problem, state: State, options: EngineOptions) -> State:
    """Named terms that are not possible leave; what else is most likely takes their place.

    That is what forward selection finds without them, or a function without a name. No other name takes the place of
    one that is clearly likelier.
    """
    impossible: list[Term] = []
    while (k := _not_possible(problem, state, options)) is not None:
        impossible.append(state.tested[k].term)
        restricted, rest = problem.without_candidates(impossible), reduced(problem, state, k, options)
        choices = [eliminate(problem, forward(restricted, rest, options, shaped=True), options)]
        choices += with_functions(problem, rest, state.fit, options)
        best = choices[0]
        for choice in choices[1:]:
            if preferred(problem, choice, best, 0.0, options):
                best = choice
        if preferred(problem, state, best, options.close, options):
            # the data say that it resembles what is not possible, so that a name of something else is as wrong
            kept = [t for t in best.tested if t.term.nonparametric or t.term in rest.fit.terms.terms]
            best = refitted(problem, best, kept, options)
        state = best
    return state


def significant(problem: Problem, state: State, options: EngineOptions) -> State:
    """Each term tested beside all others of the final model; those that are not significant leave, the least first.

    So does what explains little beside a function at its site: that may be what the function does not describe, unless
    it is a wave that is too short for that.
    A name also leaves if the error that remains at its site exceeds a small share of what it explains, and any term if
    autocorrelated noise in its place is more likely.
    """
    left = concentration(problem, state.fit, options) if state.tested else None  # beside all of them
    while state.tested:
        # what left may have whitened the residuals
        state = replace(state, fit=in_own_noise(problem, state.fit, options))
        time = score_test(problem, state.fit, options).time
        tests = [_tested_finally(problem, state, k, time, options) for k in range(len(state.tested))]
        tests = [
            replace(one, p_value=1.0)
            if _misfit(problem, state, k, tests, options) or _leaves_more(one, k, state.fit, left, options)
            else one
            for k, one in enumerate(tests)
        ]
        worst = max(range(len(tests)), key=lambda k: (tests[k].p_value, -tests[k].score.gain))
        if tests[worst].p_value < options.level:
            return State(state.baseline, state.fit, tuple(tests))
        state = reduced(problem, state, worst, options)
    return replace(state, fit=in_own_noise(problem, state.fit, options))


def _misfit(problem: Problem, state: State, k: int, tests: Sequence[SelectedTerm], options: EngineOptions) -> bool:
    term, gain = tests[k].term, tests[k].score.gain
    functions = [one.term.nonparametric and one.term.site == term.site for one in tests]
    gains = [one.score.gain for one, there in zip(tests, functions, strict=True) if there]
    if not gains or _fine(problem, term):
        return False
    if not term.nonparametric:
        return any(gain < options.misfit * other for other in gains)
    if gain == max(gains):
        return False
    # functions of one site describe one another's misfit: each adds to what they explain together
    rest = state
    for there in reversed(np.flatnonzero(functions).tolist()):
        rest = reduced(problem, rest, there, options)
    return gain < options.misfit * state.fit.gain_over(rest.fit)


def _fine(problem: Problem, term: Term) -> bool:
    """Whether a term is a wave too short for a smooth function to describe, or to leave."""
    found = wave_of(problem, term)
    return found is not None and found[1] * float(np.ptp(found[0].angle)) > 2 * np.pi * _CYCLES


def _leaves_more(name: SelectedTerm, k: int, fit: Fit, left: Concentration | None, options: EngineOptions) -> bool:
    if left is None or left.site != name.term.site or name.term.nonparametric:
        return False
    return options.misfit * fit.quadratic_gain(k) < left.gain


def _tested_finally(problem: Problem, state: State, k: int, time: float, options: EngineOptions) -> SelectedTerm:
    tested = state.tested[k]
    if tested.term in problem.preset[0].terms:
        return tested
    rest = reduced(problem, state, k, options)
    if tested.term.nonparametric:
        gain = state.fit.gain_over(rest.fit)
        p_value = min(gain_p_value(gain, tested.term.size, time) * multiplicity(problem, tested.term, options), 1.0)
        tested = replace(tested, p_value=p_value, score=tested.score._replace(gain=gain))
    else:
        tested = retested(problem, state, k, time, options, rest)
    noise = tested.p_value < options.level and is_noise(problem, state, k, options, rest)
    return replace(tested, p_value=1.0) if noise else tested


def _not_possible(problem: Problem, state: State, options: EngineOptions) -> int | None:
    """A named term whose numbers are outside their bounds, or that other groups of rows contradict."""
    farthest = _least_possible(problem, state, options)
    return _contradicted(problem, state, options) if farthest is None else farthest


def _contradicted(problem: Problem, state: State, options: EngineOptions) -> int | None:
    """The named term of which the part in one group of rows alone is clearly more likely than the whole.

    Such a term acts on all groups by its definition. What one group alone shows is something else, whatever it is.
    """
    now = score_test(problem, state.fit, options)
    for k, tested in enumerate(state.tested):
        if tested.term.nonparametric or tested.term in problem.preset[0].terms:
            continue
        columns = problem.columns([tested.term], beside=(state.fit.terms, state.fit.values))
        groups = np.unique(problem.groups[np.any(columns, axis=(0, 2))])
        parts = [columns * (problem.groups == group)[:, None] for group in groups]
        needed = options.close * now.time
        # beside the whole, a part explains at least by how much it is more likely alone: this takes no refit
        if len(parts) < 2 or max(score.gain for score in now.score_columns(parts)) <= needed:
            continue
        without = score_test(problem, reduced(problem, state, k, options).fit, options, within=state.fit)
        whole, *alone = (score.gain for score in without.score_columns([columns, *parts]))
        if max(alone) > whole + needed:
            return k
    return None


def _least_possible(problem: Problem, state: State, options: EngineOptions) -> int | None:
    """The named term that is farthest outside its bounds, in standard deviations, if that is far enough."""
    farthest, found = options.impossible, None
    std = np.sqrt(np.diagonal(state.fit.covariance))
    for k, (tested, part) in enumerate(zip(state.tested, state.fit.terms.slices, strict=True)):
        for limits, value, s in zip(problem.limits(tested.term), state.fit.values[part], std[part], strict=True):
            beyond = max(limits[0] - value, value - limits[1]) / max(s, 1e-300)
            if beyond > farthest:
                farthest, found = beyond, k
    return found


def _more_likely(problem: Problem, state: State, options: EngineOptions) -> State | None:
    """The most likely state in which a function without a name joins; None where none is clearly more likely."""
    beside = likely_functions(problem, score_test(problem, state.fit, options), options)
    if not beside:
        return None  # a function that explains more in place of a name explains something beside it too
    choices = with_each(problem, state, beside, options)
    best = most_preferred(problem, state, choices, options)
    if best is not None and len(best.tested) <= len(state.tested):
        return best  # it makes names unnecessary: those that stay are challenged beside it in the next round
    for k, tested in enumerate(state.tested):
        if not tested.term.nonparametric and tested.term not in problem.preset[0].terms:
            choices += with_functions(problem, reduced(problem, state, k, options), state.fit, options)
    return most_preferred(problem, state, choices, options)
