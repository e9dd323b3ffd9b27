"""Retest with the noise model: the search assumes white noise; its terms are tested again in autocorrelated noise."""

from dataclasses import replace

import numpy as np

from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.multiplicity import description_length, multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import longest_time, score_test
from lite6jax.estimation.terms import Terms
from lite6jax.search.against_noise import in_own_noise, tested_against_noise
from lite6jax.search.possible import beyond_limits
from lite6jax.search.state import (
    Alternative,
    SelectedTerm,
    State,
    extended,
    most_specific,
    reduced,
    retested,
)


def retest(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state refitted in the noise model of its residuals, with further terms that are significant in that noise."""
    state = _in_noise_model(problem, state, options)
    while not state.fit.noise.white and len(state.tested) < options.most_terms:
        test = score_test(problem, state.fit, options)
        explained = zip(problem.candidates, test.explained(problem.candidates), strict=True)
        searched = {term: multiplicity(problem, term, options) for term in problem.candidates}
        likely = [term for term, one in explained if one.familywise(searched[term]) < options.level]
        scores = zip(likely, test.score(likely), strict=True)
        clear = [(term, s) for term, s in scores if not s.confounded and s.familywise(searched[term]) < options.level]
        if not clear:
            break
        n = state.fit.freedom
        term, score = max(clear, key=lambda pair: pair[1].gain - 0.5 * pair[1].size * np.log(n))
        tested = SelectedTerm(term, score.familywise(searched[term]), score)
        more = _in_noise_model(problem, extended(problem, state, tested, score.values, options), options)
        if len(more.tested) <= len(state.tested):
            break
        state = more
    return state


def _in_noise_model(problem: Problem, state: State, options: EngineOptions) -> State:
    """All terms fitted and tested in autocorrelated noise, where residuals have it; insignificant ones are removed."""
    while not (own := in_own_noise(problem, state.fit, options)).noise.white:
        state = replace(state, fit=own)
        time = longest_time(problem, own, options)
        rests = [reduced(problem, state, k, options) for k in range(len(state.tested))]
        tests = [
            tested_against_noise(problem, state, k, options, rest)
            if state.tested[k].term.nonparametric
            else retested(problem, state, k, time, options, rest)
            for k, rest in enumerate(rests)
        ]
        worst = max(range(len(tests)), key=lambda k: tests[k].p_value, default=None)
        if worst is None or tests[worst].p_value < options.level:
            state = replace(state, tested=tuple(tests))
            for k in range(len(tests)):
                state = renamed(problem, state, k, options)
            return state
        state = rests[worst]
    return replace(state, fit=own)


def renamed(problem: Problem, state: State, k: int, options: EngineOptions) -> State:
    """The state with the most likely of the k-th term and its alternatives.

    They may rank otherwise beside the terms and in the noise that have been found since. An alternative with a number
    more than `impossible` standard deviations outside its bounds is left out. Of those that the data do not distinguish
    it is the one with the most specific name; but a wave beside another one of its site stays, since all orders of a
    site are one cause.
    """
    tested = state.tested[k]
    rest = reduced(problem, state, k, options).fit
    # without the term, what it explains makes the residuals look autocorrelated
    test = score_test(problem, rest, options, longest_time(problem, state.fit, options))
    choices: list[tuple[SelectedTerm, Fit]] = [(tested, state.fit)]
    for alternative in tested.alternatives:
        if alternative.term in rest.terms.terms:
            continue
        score = test.score([alternative.term])[0]
        terms = Terms((*rest.terms.terms[:k], alternative.term, *rest.terms.terms[k:]))
        values = np.insert(rest.values, state.fit.terms.slices[k].start, score.values)
        other = fit(problem, terms, options, values, rest.nuisance, rest.training, rest.noise)
        if beyond_limits(problem, other, k) > options.impossible:
            continue
        p_value = score.familywise(multiplicity(problem, alternative.term, options))
        choices.append((SelectedTerm(alternative.term, p_value, score), other))
    scale, n = np.min([one.scale for _, one in choices], axis=0), rest.freedom

    def judged(choice: tuple[SelectedTerm, Fit]) -> float:
        return choice[1].log_likelihood(scale) - description_length(problem, [choice[0].term], n, options)

    best = most_specific(choices, judged, lambda choice: choice[0].term, options.close)
    waves = [term for term in state.fit.terms.terms if term.periodic and term.label == tested.term.label]
    if len(waves) > 1 and max(map(judged, choices)) - judged(choices[0]) < options.close:
        best = choices[0]
    likely = best[1].log_likelihood(scale)
    alternatives = tuple(
        Alternative(other.term, float(likely - one.log_likelihood(scale)))
        for other, one in sorted(choices, key=lambda choice: -judged(choice))
        if other is not best[0]
    )
    chosen = replace(best[0], alternatives=alternatives)
    return State(state.baseline, best[1], (*state.tested[:k], chosen, *state.tested[k + 1 :]))
