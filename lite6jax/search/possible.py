"""Named terms whose numbers are possible: what a bound or another group of rows contradicts leaves the model."""

import numpy as np

from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Term
from lite6jax.search.backward import eliminate
from lite6jax.search.forward import forward
from lite6jax.search.functions import in_place_of
from lite6jax.search.state import State, preferred, reduced, refitted


def believable(problem: Problem, state: State, options: EngineOptions) -> State:
    """Named terms that are not possible leave; what else is most likely takes their place.

    That is what forward selection finds without them, or a function without a name. No other name takes the place of
    one that is clearly likelier.
    """
    impossible: list[Term] = []
    while (k := _not_possible(problem, state, options)) is not None:
        impossible.append(state.tested[k].term)
        restricted, rest = problem.without_candidates(impossible), reduced(problem, state, k, options)
        if len(impossible) > options.most_terms:
            state = rest
            continue
        choices = [eliminate(problem, forward(restricted, rest, options, shaped=True), options)]
        choices += in_place_of(problem, state, k, options, rest)
        best = rest
        for choice in choices:
            # a wave is no candidate that can be left out: the spectrum finds the same order again
            found_again = any(term in impossible for term in choice.fit.terms.terms)
            if not found_again and (best is rest or preferred(problem, choice, best, 0.0, options)):
                best = choice
        if preferred(problem, state, best, options.close, options):
            # the data say that it resembles what is not possible, so that a name of something else is as wrong
            kept = [t for t in best.tested if t.term.nonparametric or t.term in rest.fit.terms.terms]
            best = refitted(problem, best, kept, options)
        state = best
    return state


def _not_possible(problem: Problem, state: State, options: EngineOptions) -> int | None:
    """A named term whose numbers are outside their bounds, or that other groups of rows contradict."""
    farthest = _least_possible(problem, state, options)
    return _contradicted(problem, state, options) if farthest is None else farthest


def _least_possible(problem: Problem, state: State, options: EngineOptions) -> int | None:
    """The named term that is farthest outside its bounds, in standard deviations, if that is far enough."""
    farthest = [beyond_limits(problem, state.fit, k) for k in range(len(state.tested))]
    k = int(np.argmax(farthest)) if farthest else 0
    return k if farthest and farthest[k] > options.impossible else None


def beyond_limits(problem: Problem, fitted: Fit, k: int) -> float:
    """By how many standard deviations a number of the k-th term is outside its bounds at most; negative within them."""
    part = fitted.terms.slices[k]
    values, std = fitted.values[part], np.maximum(np.sqrt(np.diagonal(fitted.covariance)[part]), 1e-300)
    lower, upper = np.transpose(problem.limits(fitted.terms.terms[k]))
    return float(np.max(np.maximum(lower - values, values - upper) / std))


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
