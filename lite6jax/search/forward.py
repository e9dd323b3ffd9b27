"""Forward selection: the most likely term is added as long as one is left that noise does not explain."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lite6jax.estimation.equations import Explained
from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.multiplicity import multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import Score, ScoreTest, score_test
from lite6jax.estimation.terms import Term, Terms
from lite6jax.search.spectrum import lines
from lite6jax.search.state import Alternative, SelectedTerm, State, added, extended, most_specific, reduced, refitted

_BETWEEN = 17
"""Numbers from half to twice a tried one that are scored: those that are tried are a factor of 2 to 3 apart."""


class Ranked(NamedTuple):
    """A candidate, what it would explain, and the log-likelihood that its choice among orders costs."""

    term: Term
    explained: Explained
    searched: float

    def penalised(self, n: float) -> float:
        """The gain less what its numbers and its choice cost, of n degrees of freedom."""
        return self.explained.gain - 0.5 * self.explained.size * np.log(n) - self.searched


def forward(problem: Problem, state: State, options: EngineOptions, shaped: bool = False) -> State:
    """Adds the most likely term, one after another.

    Named terms with a number that is tried at a few values come close to what others leave. They are tried where no
    other candidate is significant, and with `shaped` from the beginning, where a function without a name has shown that
    the others do not suffice.

    Terms that are not significant yet are added too, a few in a row: an effect that is not in the model yet makes the
    residual look autocorrelated, and so masks another. Backward elimination removes those that stay insignificant.
    """
    doubtful = 0
    while len(state.tested) < options.most_terms and doubtful < options.doubtful:
        further = with_next(problem, state, options, shaped)
        if further is None:
            break
        state = further
        doubtful = 0 if state.tested[-1].p_value < options.level else doubtful + 1
    return state


def with_next(problem: Problem, state: State, options: EngineOptions, shaped: bool) -> State | None:
    """The state with the best single addition, or None where none is significant."""
    tried = likeliest(problem, state, options, shaped)
    if not tried:
        return None
    n = state.fit.freedom
    refits = [(one, score, added(problem, state.fit, one.term, score.values, options)) for one, score in tried]
    scale = np.min([fit.scale for *_, fit in refits], axis=0)

    def judged(refit: tuple[Ranked, Score, Fit]) -> float:
        one, _, fit = refit
        return fit.log_likelihood(scale) - 0.5 * one.explained.size * np.log(n) - one.searched

    chosen = most_specific(refits, judged, lambda refit: refit[0].term, options.close)
    one, score, fitted = chosen
    likely = fitted.log_likelihood(scale)
    alternatives = tuple(
        Alternative(other.term, float(likely - fit.log_likelihood(scale)))
        for other, _, fit in sorted(refits, key=lambda refit: -judged(refit))
        if other is not one and other.term not in one.term.includes
    )
    tested = SelectedTerm(one.term, _familywise(problem, one, score, options), score, alternatives)
    further = State(state.baseline, fitted, (*state.tested, tested))
    return _refined(problem, _without_included(problem, further, options), options)


def likeliest(problem: Problem, state: State, options: EngineOptions, shaped: bool) -> list[tuple[Ranked, Score]]:
    """The candidate that explains most and noise does not, and then the few that explain nearly as much.

    Each comes with its score. There are none where noise explains them all.
    """
    test = score_test(problem, state.fit, options)
    # a term that is there explains more beside a linearisation that is not at its estimate, as that of a delay
    there = {one for term in state.fit.terms.terms for one in (term, *term.includes)}
    named = [term for term in problem.candidates if not (term.periodic or term in there)]
    candidates = [Ranked(*pair, 0.0) for pair in zip(named, test.explained(named), strict=True)]
    candidates += [Ranked(line.term, line.explained, line.searched) for line in lines(test)]
    found = [] if shaped else _likeliest_of(test, candidates)
    if found or not problem.shaped:
        return found
    best: dict[str, Ranked] = {}  # of the numbers that are tried of each
    for term, one in zip(problem.shaped, test.explained(problem.shaped), strict=True):
        if term.label not in best or one.gain > best[term.label].explained.gain:
            best[term.label] = Ranked(term, one, float(np.log(len(problem.shaped))))
    return _likeliest_of(test, [*candidates, *best.values()])


def _likeliest_of(test: ScoreTest, candidates: Sequence[Ranked]) -> list[tuple[Ranked, Score]]:
    problem, options, n = test.problem, test.options, test.freedom
    ranked = sorted(
        (one for one in candidates if not one.explained.confounded and one.explained.gain > 0),
        key=lambda one: -one.penalised(n),
    )
    first = ranked[: 3 * options.refitted]
    likely = [one for one in first if _familywise(problem, one, one.explained, options) < options.level]
    scores = dict(zip(likely, test.score([one.term for one in likely]), strict=True))
    # where correlated noise leaves none significant, the most likely one in white noise is tried
    significant = [one for one in likely if _familywise(problem, one, scores[one], options) < options.level] or likely
    if not significant or significant[0].penalised(n) < 0:
        return []
    best, enough = significant[0], options.refitted_share * significant[0].explained.gain
    close = [one for one in ranked if one.explained.gain > enough][: options.refitted]
    tried = (best, *(one for one in close if one is not best))
    more = [one for one in tried if one not in scores]
    scores |= zip(more, test.score([one.term for one in more]), strict=True)
    return [(one, scores[one]) for one in tried]


def _familywise(problem: Problem, one: Ranked, test: Explained | Score, options: EngineOptions) -> float:
    return test.familywise(multiplicity(problem, one.term, options))


def with_term(problem: Problem, state: State, term: Term, score: Score, options: EngineOptions) -> State:
    """The state with a named term, whose tried number is refined."""
    tested = SelectedTerm(term, score.familywise(multiplicity(problem, term, options)), score)
    further = extended(problem, state, tested, score.values, options)
    return _refined(problem, _without_included(problem, further, options), options)


def _without_included(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state without the terms that its last one includes."""
    term = state.tested[-1].term
    if not any(tested.term in term.includes for tested in state.tested):
        return state
    return refitted(problem, state, [t for t in state.tested if t.term not in term.includes], options)


def _refined(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state whose last term has the best of all numbers, where it had the best of a few that were tried.

    The likelihood of such a number can have several maxima, as every reversal that it separates from its neighbour is a
    step. So values between those that were tried are scored first, and a fit starts from the best of them.
    """
    last, f = state.tested[-1], state.fit
    if last.term.periodic or last.term.chosen is None:
        return state
    rest = reduced(problem, state, len(state.tested) - 1, options)
    numbers = last.term.chosen * np.geomspace(0.5, 2.0, _BETWEEN)
    test = score_test(problem, rest.fit, options, within=f)
    gains = [one.gain for one in test.explained([last.term.held(float(number)) for number in numbers])]
    before = f.terms.terms[:-1]
    start = np.append(f.values, numbers[int(np.argmax(gains))])
    free = fit(problem, Terms((*before, last.term.released())), options, start, f.nuisance, f.training, f.noise)
    term = last.term.held(float(free.values[-1]))
    held = fit(problem, Terms((*before, term)), options, free.values[:-1], free.nuisance, f.training, f.noise)
    if held.gain_over(f) <= 0:
        return state
    return State(state.baseline, held, (*state.tested[:-1], replace(last, term=term)))
