"""Whole orders: what turns with a shaft repeats a whole number of times in a turn.

Over less than two turns a search finds one order between two neighbouring ones, and then the residuals beside it. The
orders of one site are therefore also tried together at whole numbers.
"""

from collections.abc import Sequence

import numpy as np

from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import PeriodicFamily, Problem
from lite6jax.estimation.score_test import score_test, searched_size
from lite6jax.search.state import SelectedTerm, State, extended, preferred, refitted


def with_whole_orders(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state with whole orders in place of those found, at each site where that is as likely."""
    for family in problem.periodic:
        waves = [tested.term for tested in state.tested if tested.term.periodic and tested.term.site == family.site]
        orders = [order for order in map(family.order, waves) if order is not None]
        if not any(order % 1 for order in orders) or len(orders) < len(waves):
            continue
        best = state
        for whole in _whole(orders):
            choice = _replaced(problem, state, family, whole, options)
            margin = options.whole_preferred * len(whole) if best is state else 0.0
            if preferred(choice, best, -margin, options):
                best = choice
        state = best
    return state


def _whole(orders: Sequence[float]) -> list[tuple[float, ...]]:
    """Sets of distinct whole orders to try in place of these: the first ones, and those that are nearest."""
    count = len(orders)
    nearest = tuple(sorted({float(max(round(order), 1)) for order in orders}))
    first = tuple(float(order) for order in range(1, count + 1))
    return list(dict.fromkeys((first, (*first, float(count + 1)), nearest)))


def _replaced(
    problem: Problem, state: State, family: PeriodicFamily, orders: Sequence[float], options: EngineOptions
) -> State:
    """The state with these orders of a family alone."""
    kept = [tested for tested in state.tested if not (tested.term.periodic and tested.term.site == family.site)]
    choice, searched = refitted(problem, state, kept, options), searched_size(problem, options)
    for order in orders:
        term = family.term(order)
        score = score_test(problem, choice.fit, options, within=state.fit).score([term])[0]
        start = np.zeros(term.size) if score.confounded else score.values
        choice = extended(problem, choice, SelectedTerm(term, score.familywise(searched), score), start, options)
    return choice
