"""Names with a number in which no fit is linear, such as a friction: forward selection, which tries few, may miss them.

They come close to other terms: a step of the load to the load itself, and a step and a line together to a slow wave.
"""

from collections.abc import Iterator

import numpy as np

from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import ScoreTest, score_test
from lite6jax.estimation.terms import Term
from lite6jax.search.forward import with_term
from lite6jax.search.significance import all_significant
from lite6jax.search.state import State, fitted_again, listing, longer, preferred, reduced, with_function_listed


def with_tried_numbers(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state with such names in the place of other terms of their sites, and plain ones where these do as well."""
    for tested in state.tested:
        if tested.term.chosen is None and tested.term in state.fit.terms.terms:
            state = _instead(problem, state, tested.term, options)
    for tested in state.tested:
        if tested.term.nonparametric and tested.term in state.fit.terms.terms:
            state = _where_determined(problem, state, tested.term, options)
    return _plain_again(problem, state, options)


def _instead(problem: Problem, state: State, term: Term, options: EngineOptions) -> State:
    """The state with such a name in the place of a term, alone or together with a second name of that site.

    In the place of a function without a name it need not be clearly likelier; it then lists the function.
    """
    if not any(rival.site == term.site for rival in problem.shaped):
        return state
    rest = reduced(problem, state, state.fit.terms.terms.index(term), options)
    test = score_test(problem, rest.fit, options, within=state.fit)
    now, best = test.explained([term])[0].gain, state
    for names, gain in _with_tried_number(test, term):
        # correlated samples count as fewer
        needed = test.time * (options.close if len(names) == 1 else options.together)
        if term.nonparametric and len(names) == 1:
            needed = 0.0
        # the friction is one of a few that are tried: once fitted, it may explain more than it does now
        if gain < (options.named_share * now if term.nonparametric else now + needed):
            continue
        choice = rest
        for name in names:
            score = score_test(problem, choice.fit, options, within=state.fit).score([name])[0]
            choice = with_term(problem, choice, name, score, options)
        if choice.fit.gain_over(best.fit) <= needed + test.time * longer(problem, choice, best, options):
            continue
        # a function is tested by its gain, a name in blocks of samples, of which there may be too few
        if not term.nonparametric or all_significant(problem, choice, options):
            best = listing(problem, choice, rest, state, term, options)
    return best


def _where_determined(problem: Problem, state: State, function: Term, options: EngineOptions) -> State:
    """The state with such a name in the place of a function, without the samples at which the name says nothing.

    A gear is between its flanks at a few samples, where inertia and friction leave it. A function with a number for
    their place describes these few as well, in the place of the name or beside it. Where the name alone is preferred
    without them, they stay out of the fit, and a name that takes the function's place lists it.
    """
    rivals = [rival for rival in problem.shaped if rival.site == function.site and problem.undetermined(rival).any()]
    if not rivals or problem.preset[0].terms:
        return state
    k = state.fit.terms.terms.index(function)
    beside = [t.term for t in state.tested if t.term.site == function.site and problem.undetermined(t.term).any()]
    if beside:
        name = beside[0]
    else:
        test = score_test(problem, reduced(problem, state, k, options).fit, options, within=state.fit)
        name = rivals[int(np.argmax([one.gain for one in test.explained(rivals)]))]
    determined = state.fit.training & ~problem.undetermined(name)
    there = fitted_again(problem, problem, state, determined, options)
    named = rest = reduced(problem, there, k, options)
    if not beside:
        score = score_test(problem, rest.fit, options, within=there.fit).score([name])[0]
        named = with_term(problem, rest, name, score, options)
    if not preferred(problem, named, there, 0.0, options) or not all_significant(problem, named, options):
        return state
    return with_function_listed(named, rest, there, function)


def _with_tried_number(test: ScoreTest, term: Term) -> Iterator[tuple[tuple[Term, ...], float]]:
    """Of the names with a tried number at the site of `term`, which has some, the one that explains most, and how much.

    Then the same of such a name together with another of the site.
    """
    problem = test.problem
    rivals = [rival for rival in problem.shaped if rival.site == term.site]
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
        likely = [(score.gain - cost * score.size, k) for k, score in enumerate(scores) if not score.confounded]
        if not likely:
            continue
        best = max(likely)[1]
        choice = with_term(problem, rest, plain[best], scores[best], options)
        # an insignificant plain name would be removed later, and its effect with it
        significant = choice.tested[-1].p_value < options.level
        if significant and preferred(problem, choice, state, 0.0, options):
            state = choice
    return state
