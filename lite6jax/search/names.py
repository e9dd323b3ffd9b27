"""Tests of names: a name stands only where its numbers are possible and no function without a name is clearly likelier.

The candidates of a search are never all that there is. Where the truth is none of them, the nearest one wins the search
and is wrong; its significance against noise says nothing of that. So functions of every driver at every site are scored
against what the named terms leave. Where one of them, beside the names or in place of one, is clearly more likely, it
joins the model, and the names that it makes unnecessary leave.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from lite6jax.estimation.multiplicity import multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Mask, Problem, acts_on
from lite6jax.estimation.score_test import ScoreTest, score_test
from lite6jax.search.backward import eliminate, prune
from lite6jax.search.forward import forward, with_term
from lite6jax.search.functions import in_place_of, likely_functions, most_preferred, with_each
from lite6jax.search.possible import believable
from lite6jax.search.state import SelectedTerm, State, extended, listing, preferred, reduced, refitted
from lite6jax.search.tried_numbers import with_tried_numbers
from lite6jax.search.whole_orders import slow_waves, with_whole_orders


def apply_discrepancy_test(problem: Problem, state: State, options: EngineOptions, several: bool = True) -> State:
    """The state with names that the data do not contradict, and functions without a name for what is left.

    Args:
        problem: the data.
        state: the model.
        options: thresholds.
        several: whether one function is tried in the place of several names, as what is unlikely to be there at once.
    """
    state = with_tried_numbers(problem, believable(problem, state, options), options)
    for _ in range(options.name_rounds):
        better = _more_likely(problem, state, options)
        if better is None:
            break
        state = with_tried_numbers(problem, believable(problem, better, options), options)
    state = _named_again(problem, state, options)
    return _one_for_names(problem, state, options) if several else state


def most_probable(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state with the most probable function without a name in the place of each of its own.

    Each was the most probable beside the terms that the model had when it was added, some of which have left since.
    """
    for function in [tested.term for tested in state.tested if tested.term.nonparametric]:
        if function.shrunk or function in problem.preset[0].terms or function not in state.fit.terms.terms:
            continue
        k = state.fit.terms.terms.index(function)
        for choice in in_place_of(problem, state, k, options, alike=True):
            if preferred(problem, choice, state, 0.0, options):
                state = choice
    return state


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
        named = believable(problem, with_whole_orders(problem, named, options), options)
        if preferred(problem, named, state, 0.0, options):
            state = listing(problem, named, rest, state, term, options)
    return state


def _one_for_names(problem: Problem, state: State, options: EngineOptions) -> State:
    """One function without a name, or slow waves of a site, in the place of several terms, unless clearly less likely.

    The terms are those of one site, all names, or all there are. Several effects of the catalogue can add up to one
    that it does not have: at one site a spring and a slow wave to an end stop, at two a payload and a base that gives
    way to a sensor whose axes differ in scale. Over a part of a turn, an offset and a scale add up to a wave of
    order 1, and along one motion functions of two positions to one of the velocity. That so many effects are there at
    once is itself unlikely, the more so the more they are.
    """
    preset = problem.preset[0].terms
    while True:
        best: State | None = None
        for site, there in _together(problem, state, [tested for tested in state.tested if tested.term not in preset]):
            rest = refitted(problem, state, [t for t in state.tested if t not in there], options)
            test = score_test(problem, rest.fit, options, within=state.fit)
            named = [tested for tested in there if not tested.term.nonparametric]
            functions = with_each(problem, rest, likely_functions(problem, test, options, site), options)
            largest = options.together * (_causes(problem, there) - 1)
            for choice in (*functions, *_with_slow_waves(problem, rest, test, options, site)):
                usual = len(there) == 2 and any(tested.term.usual for tested in there)
                if usual and not preferred(problem, choice, best or state, 0.0 if best else -largest, options):
                    continue  # none of two may stay: without them it is as it is
                # beside the function a name may stay: it is then not what the function replaces
                choice = _restored(problem, choice, named, options)
                gone = [t for t in there if t.term not in choice.fit.terms.terms]
                margin = options.together * (_causes(problem, gone) - 1)
                if len(gone) > 1 and preferred(problem, choice, best or state, 0.0 if best else -margin, options):
                    best = choice
        if best is None:
            return state
        state = best


def _together(
    problem: Problem, state: State, terms: Sequence[SelectedTerm]
) -> Iterator[tuple[str | None, Sequence[SelectedTerm]]]:
    """Terms that one may replace, two at least: those of each site, and, of several sites, all names and all terms.

    Of several sites are only terms that act on common rows: what acts on one row replaces nothing at others.
    """
    for site in sorted({tested.term.site for tested in terms}):
        there = [tested for tested in terms if tested.term.site == site]
        if len(there) > 1:
            yield site, there
    names = [tested for tested in terms if not tested.term.nonparametric]
    for group in (names, terms) if len(names) < len(terms) else (terms,):
        for part in _on_common_rows(problem, state, group):
            if len({tested.term.site for tested in part}) > 1:
                yield None, part


def _on_common_rows(problem: Problem, state: State, terms: Sequence[SelectedTerm]) -> list[list[SelectedTerm]]:
    """Terms in sets, no two of which act on the same rows of the residuals."""
    model, parts = (state.fit.terms, state.fit.values), list[tuple[Mask, list[SelectedTerm]]]()
    for tested in terms:
        rows, members = acts_on(problem, tested.term, model), [tested]
        for other in [part for part in parts if np.any(part[0] & rows)]:
            parts = [part for part in parts if part is not other]
            rows, members = rows | other[0], [*other[1], *members]
        parts.append((rows, members))
    return [[tested for tested in terms if any(tested is one for one in members)] for _, members in parts]


def _with_slow_waves(
    problem: Problem, rest: State, test: ScoreTest, options: EngineOptions, site: str | None
) -> list[State]:
    """The state with each of the lowest orders of a site that it does not have, and with all of them."""
    waves = [wave for wave in slow_waves(problem, site) if wave not in rest.fit.terms.terms]
    scored = zip(waves, test.score(waves), strict=True)
    found = [with_term(problem, rest, wave, score, options) for wave, score in scored if not score.confounded]
    if 1 < len(waves) == len(found):
        both = found[0]
        for wave in waves[1:]:
            score = score_test(problem, both.fit, options).score([wave])[0]
            both = with_term(problem, both, wave, score, options)
        found.append(both)
    return found


def _causes(problem: Problem, terms: Sequence[SelectedTerm]) -> int:
    """How many causes these have: the slow waves of a site have one, such as a circle that is off centre.

    So have the usual effects of a site: friction is Coulomb's and viscous, and that both are there is no coincidence.
    """
    slow = [tested.term.site for tested in terms if tested.term in slow_waves(problem, tested.term.site)]
    usual = [tested.term.site for tested in terms if tested.term.usual]
    return len(terms) - sum(len(sites) - len(set(sites)) for sites in (slow, usual))


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


def _more_likely(problem: Problem, state: State, options: EngineOptions) -> State | None:
    """The most likely state in which a function without a name joins; None where none is clearly more likely.

    It joins beside all terms or in the place of one, which may be a curve: a curve was compared only with others at its
    own site.
    """
    beside = likely_functions(problem, score_test(problem, state.fit, options), options)
    choices = with_each(problem, state, beside, options)
    best = most_preferred(problem, state, choices, options)
    if best is not None and len(best.tested) <= len(state.tested):
        return best  # it makes names unnecessary: those that stay are challenged beside it in the next round
    for k, tested in enumerate(state.tested):
        term = tested.term
        # what explains more than a name in its place gains beside it too; beside a curve it may gain nothing
        replaceable = term.nonparametric or bool(beside)
        if replaceable and not term.shrunk and term not in problem.preset[0].terms:
            choices += in_place_of(problem, state, k, options)
    return most_preferred(problem, state, choices, options)
