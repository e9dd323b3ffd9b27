"""Exchange of terms that were chosen one by one: alternatives in the place of a term, one term in that of several."""

from lite6jax.estimation.multiplicity import multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Term
from lite6jax.search.backward import eliminate, prune
from lite6jax.search.forward import forward, with_next
from lite6jax.search.state import SelectedTerm, State, extended, preferred, reduced, refitted


def exchange(problem: Problem, state: State, options: EngineOptions) -> State:
    """Tries the alternatives of every term in its place, and keeps the set that is clearly more likely.

    A single term of many numbers, such as a base that gives way in all directions, may have been found first where two
    plain ones are true: it is exchanged for two of no more numbers, if these are so much more likely. That a second
    cause is unlikely weighs against them only where the first is another one: beside its plain form, the second name
    takes the place of further numbers.
    """
    best, tried = state, {frozenset(state.fit.terms.terms)}
    alone = len(state.tested) < options.several
    improved = not alone or any(t.size > 2 and not t.nonparametric for t in state.fit.terms.terms)
    while improved:
        improved, state = False, best
        pairs = [(k, a.term) for k, old in enumerate(state.tested) for a in old.alternatives[: options.exchanged]]
        for k, term in pairs:
            rest = reduced(problem, state, k, options)
            begun = frozenset((*rest.fit.terms.terms, term))
            if begun in tried:
                continue
            tried.add(begun)
            score = score_test(problem, rest.fit, options, within=state.fit).score([term])[0]
            tested = SelectedTerm(term, score.familywise(multiplicity(problem, term, options)), score)
            other = forward(problem, extended(problem, rest, tested, score.values, options), options)
            other = eliminate(problem, other, options)
            if alone and other.fit.terms.size > best.fit.terms.size:
                continue
            kept = {t.label for t in best.fit.terms.terms} <= {t.label for t in other.fit.terms.terms}
            if preferred(problem, other, best, options.close if kept or not alone else options.together, options):
                best, improved = _ranked_anew(problem, prune(problem, other, options), term, options), True
    return best


def _ranked_anew(problem: Problem, state: State, term: Term, options: EngineOptions) -> State:
    """The state with the likeliest candidate beside its other terms in the place of a term that it began with.

    That term was an alternative beside others that have left since; its own alternatives are not known yet.
    """
    if term not in state.fit.terms.terms:
        return state
    rest = reduced(problem, state, state.fit.terms.terms.index(term), options)
    ranked = with_next(problem, rest, options, shaped=False)
    same = ranked is not None and ranked.tested[-1].term == term
    return ranked if ranked is not None and (same or preferred(problem, ranked, state, 0.0, options)) else state


def one_for_several(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state with one term in the place of several of its kind, where that is as likely: a cause that they share."""
    for kind in {type(tested.term) for tested in state.tested if not tested.term.nonparametric}:
        several = [tested for tested in state.tested if type(tested.term) is kind and not tested.term.periodic]
        if len(several) < 2:
            continue
        rest = refitted(problem, state, [tested for tested in state.tested if tested not in several], options)
        test = score_test(problem, rest.fit, options, within=state.fit)
        others = [term for term in problem.candidates if type(term) is kind]
        best = state
        for term, score in zip(others, test.score(others), strict=True):
            if score.confounded or term in state.fit.terms.terms:
                continue
            tested = SelectedTerm(term, score.familywise(multiplicity(problem, term, options)), score)
            choice = extended(problem, rest, tested, score.values, options)
            if preferred(problem, choice, best, 0.0, options):
                best = choice
        state = best
    return state
