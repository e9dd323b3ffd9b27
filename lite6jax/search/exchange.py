"""Exchange: an alternative replaces a term and forward selection goes on; terms had been chosen one by one."""

from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import score_test, searched_size
from lite6jax.search.backward import eliminate, prune
from lite6jax.search.forward import forward
from lite6jax.search.state import SelectedTerm, State, extended, preferred, reduced


def exchange(problem: Problem, state: State, options: EngineOptions) -> State:
    """Tries the alternatives of every term in its place, and keeps the set that is clearly more likely."""
    searched = searched_size(problem, options)
    best, tried = state, {frozenset(state.fit.terms.terms)}
    improved = len(state.tested) >= options.several
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
            tested = SelectedTerm(term, score.familywise(searched), score)
            other = forward(problem, extended(problem, rest, tested, score.values, options), options)
            other = eliminate(problem, other, options)
            if preferred(other, best, options.close, options):
                best, improved = prune(problem, other, options), True
    return best
