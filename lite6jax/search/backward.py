"""Backward elimination: terms that are not significant, or not needed, beside all others leave the model."""

import numpy as np

from lite6jax.estimation.multiplicity import multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import longest_time
from lite6jax.search.state import State, reduced, retested

_CLEARLY = 5.0
"""Of the loss at which a term stays, from which a quadratic likelihood is believed that it stays."""


def eliminate(problem: Problem, state: State, options: EngineOptions) -> State:
    """Removes the terms that are not significant beside the others, the least significant first.

    Terms that were significant when they were added are not tested again.
    """
    while doubtful := [k for k, tested in enumerate(state.tested) if tested.p_value >= options.level]:
        time = longest_time(problem, state.fit, options)
        rests = {k: reduced(problem, state, k, options) for k in doubtful}
        tests = {k: retested(problem, state, k, time, options, rest) for k, rest in rests.items()}
        worst = max(tests, key=lambda k: tests[k].p_value)
        if tests[worst].p_value < options.level:
            return State(state.baseline, state.fit, tuple(tests.get(k, old) for k, old in enumerate(state.tested)))
        state = rests[worst]
    return state


def prune(problem: Problem, state: State, options: EngineOptions) -> State:
    """Removes the terms that the others make unnecessary, by penalised likelihood.

    Of the terms, those are refitted without that a quadratic likelihood would miss least, unless it would miss them
    clearly. A name that a function at its site may contain, as a cubic contains a line, is always refitted without: the
    quadratic likelihood says nothing of it, as the two are nearly confounded. A model that leaves no degree of freedom
    stays as it is: there, no likelihood says which of its terms are needed.
    """
    n = state.fit.freedom
    if n <= 0:
        return state
    while len(state.tested) > 1:
        allowed = [np.log(multiplicity(problem, tested.term, options)) for tested in state.tested]
        losses = []
        missed = [state.fit.quadratic_gain(k) - 0.5 * t.term.size * np.log(n) for k, t in enumerate(state.tested)]
        contained = [k for k in range(len(missed)) if _in_function(state, k)]
        others = [k for k in np.argsort(np.subtract(missed, allowed)).tolist() if k not in contained]
        least_missed = [k for k in others[: options.refitted_without] if missed[k] <= _CLEARLY * allowed[k]]
        for k in (*contained, *least_missed):
            tested = state.tested[k]
            rest = reduced(problem, state, k, options)
            scale = state.fit.scale
            loss = state.fit.log_likelihood(scale) - rest.fit.log_likelihood(scale)
            losses.append((loss - 0.5 * tested.term.size * np.log(n) - allowed[k], rest))
        least, rest = min(losses, key=lambda item: item[0], default=(np.inf, state))
        if least > 0:
            break
        state = rest
    return state


def _in_function(state: State, k: int) -> bool:
    """Whether the k-th term is a name, and a function without a name acts at its site, which may contain it."""
    term = state.tested[k].term
    return not term.nonparametric and any(one.term.nonparametric and one.term.site == term.site for one in state.tested)
