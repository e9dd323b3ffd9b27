"""Whole orders: what turns with a shaft repeats a whole number of times in a turn.

Over less than two turns a search finds one order between two neighbouring ones, or beside one, and then the residuals
beside it: 54, 65 and 67 for 54 and 66. The orders of one site are therefore also tried together at whole numbers, and
of three, two.
"""

from collections.abc import Sequence
from itertools import combinations, product

import numpy as np

from lite6jax.estimation.multiplicity import multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import PeriodicFamily, Problem
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Term
from lite6jax.search.state import SelectedTerm, State, extended, preferred, refitted

_SLOW = (1.0, 2.0)
"""Orders."""
_REACH = 2
"""By how much a whole order may be off an order that was found: orders that are close pull each other."""
_MOST = 3
"""Orders of a site of which all neighbours are tried: 125 sets."""


def with_whole_orders(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state with whole orders in place of those found, at each site where that is as likely.

    Of whole orders and others, the prior of orders says which are as likely.
    """
    for family in filter(lambda family: family.whole, problem.periodic):
        waves = [tested.term for tested in state.tested if tested.term.periodic and tested.term.site == family.site]
        orders = [order for order in map(family.order, waves) if order is not None]
        found_whole = not any(order % 1 for order in orders)
        if len(orders) < len(waves) or (found_whole and len(orders) < 2):
            continue
        best = state
        for whole in dict.fromkeys((*_whole(orders), *_near(problem, state, family, orders, options))):
            if set(whole) == set(orders):
                continue
            choice = _replaced(problem, state, family, whole, options)
            if preferred(problem, choice, best, 0.0, options):
                best = choice
        state = best
    return state


def slow_waves(problem: Problem, site: str | None) -> list[Term]:
    """The waves of the lowest orders of a site: over a part of a turn, several names may add up to one."""
    return [family.term(order) for family in problem.periodic if family.site == site for order in _SLOW]


def _whole(orders: Sequence[float]) -> list[tuple[float, ...]]:
    """Sets of distinct whole orders to try in place of these: the first ones, and those that are nearest."""
    count = len(orders)
    nearest = tuple(sorted({float(max(round(order), 1)) for order in orders}))
    first = tuple(float(order) for order in range(1, count + 1))
    return list(dict.fromkeys((first, (*first, float(count + 1)), nearest)))


def _near(
    problem: Problem, state: State, family: PeriodicFamily, orders: Sequence[float], options: EngineOptions
) -> list[tuple[float, ...]]:
    """The most likely set of whole numbers near all of several orders, and of those near all but one."""
    if not 2 <= len(orders) <= _MOST:
        return []
    test = score_test(problem, _without(problem, state, family, options).fit, options, within=state.fit)
    found = []
    for size in {len(orders) - 1, len(orders)} - {1}:
        near = [
            product(*(np.round(order) + np.arange(-_REACH, _REACH + 1) for order in some))
            for some in combinations(orders, size)
        ]
        sets = sorted({tuple(sorted(map(float, one))) for some in near for one in some if min(one) >= 1})
        sets = [one for one in sets if len(set(one)) == size]
        waves = np.stack([np.concatenate(list(family.waves_of(np.array(one)))) for one in sets])
        found.append(sets[int(np.argmax(test.gains(family.column, waves)))])
    return found


def _without(problem: Problem, state: State, family: PeriodicFamily, options: EngineOptions) -> State:
    """The state without the orders of a family."""
    kept = [tested for tested in state.tested if not (tested.term.periodic and tested.term.site == family.site)]
    return refitted(problem, state, kept, options)


def _replaced(
    problem: Problem, state: State, family: PeriodicFamily, orders: Sequence[float], options: EngineOptions
) -> State:
    """The state with these orders of a family alone."""
    choice = _without(problem, state, family, options)
    for order in orders:
        term = family.term(order)
        score = score_test(problem, choice.fit, options, within=state.fit).score([term])[0]
        start = np.zeros(term.size) if score.confounded else score.values
        p_value = score.familywise(multiplicity(problem, term, options))
        choice = extended(problem, choice, SelectedTerm(term, p_value, score), start, options)
    return choice
