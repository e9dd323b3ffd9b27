"""The state of a search: the terms of the model with their fit, and the test of each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar, final

import numpy as np

from lite6jax.estimation.least_squares import Fit, fit, without
from lite6jax.estimation.multiplicity import description_length, multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Array, Mask, Problem
from lite6jax.estimation.score_test import Score, score_test
from lite6jax.estimation.terms import Term, Terms

T = TypeVar("T")


@final
@dataclass(frozen=True)
class Alternative:
    """A term that explains nearly the same as another.

    Attributes:
        term: which.
        gap: by which the log-likelihood of its refit is lower; beside a curve, and of another order of the same wave,
            that of its score test.
    """

    term: Term
    gap: float


@final
@dataclass(frozen=True, eq=False)
class SelectedTerm:
    """A term of the model with its test.

    Attributes:
        term: which.
        p_value: family-wise.
        score: beside the other terms of the model at the time of the test.
        alternatives: terms that it was preferred to.
        chosen_std: standard deviation of the number that was chosen for it; zero where that is exact, or not known yet.
        input_share: the share of the variance of its numbers, the greatest of them, that comes from inputs which may be
            wrong without being found so; zero where that is not known yet.
    """

    term: Term
    p_value: float
    score: Score
    alternatives: tuple[Alternative, ...] = ()
    chosen_std: float = 0.0
    input_share: float = 0.0


@final
@dataclass(frozen=True, eq=False)
class State:
    """The terms of a model, their tests, and their fit.

    Attributes:
        baseline: the fit of the nuisance alone.
        fit: of the nuisance and all terms.
        tested: one for each term of `fit`, in its order.

    Raises:
        ValueError: the tests are not those of the terms that were fitted.
    """

    baseline: Fit
    fit: Fit
    tested: tuple[SelectedTerm, ...] = ()

    def __post_init__(self) -> None:
        if tuple(test.term for test in self.tested) != self.fit.terms.terms:
            raise ValueError("the tests are not those of the fitted terms; build both from one list")


def extended(problem: Problem, state: State, tested: SelectedTerm, values: Array, options: EngineOptions) -> State:
    """The state with one more term, refitted from `values` `(term.size,)`."""
    return State(state.baseline, added(problem, state.fit, tested.term, values, options), (*state.tested, tested))


def added(problem: Problem, fitted: Fit, term: Term, values: Array, options: EngineOptions) -> Fit:
    """A fit with one more term, started from `values` `(term.size,)`."""
    terms = Terms((*fitted.terms.terms, term))
    start = np.concatenate([fitted.values, values])
    return fit(problem, terms, options, start, fitted.nuisance, fitted.training, fitted.noise)


def reduced(problem: Problem, state: State, k: int, options: EngineOptions) -> State:
    """The state without its k-th term, refitted."""
    rest, base, f = (*state.tested[:k], *state.tested[k + 1 :]), state.baseline, state.fit
    if rest:
        return State(base, without(problem, f, k, options), rest)
    # from the nuisance that was fitted alone: from that beside a term, another, lower maximum may be reached
    return State(base, fit(problem, Terms(), options, None, base.nuisance_about(problem), base.training, f.noise))


def refitted(problem: Problem, state: State, terms: Sequence[SelectedTerm], options: EngineOptions) -> State:
    """The baseline with some of the state's terms, fitted from zero in the state's noise."""
    model, base = Terms(tuple(test.term for test in terms)), state.baseline
    nuisance, noise = base.nuisance_about(problem), state.fit.noise
    return State(base, fit(problem, model, options, None, nuisance, base.training, noise), tuple(terms))


def fitted_again(problem: Problem, reference: Problem, state: State, training: Mask, options: EngineOptions) -> State:
    """The terms of a state fitted to other samples, in the same noise model.

    Args:
        problem: linearised at these samples.
        reference: the same without preset terms.
        state: whose terms, and the numbers to start from.
        training: `(sample,)` bool, the samples.
        options: thresholds.
    """
    baseline, of = fit(reference, Terms(), options, training=training), state.fit
    again = fit(problem, of.terms, options, of.values, baseline.nuisance_about(problem), training, of.noise)
    return State(baseline, again, state.tested)


def retested(
    problem: Problem, state: State, k: int, time: float, options: EngineOptions, rest: State | None = None
) -> SelectedTerm:
    """The k-th term tested beside all others, with the autocorrelation time of the residuals of the whole model.

    Args:
        problem: the data.
        state: the model.
        k: which of its terms.
        time: in samples.
        options: thresholds.
        rest: the state without it, where it is known.
    """
    tested = state.tested[k]
    if tested.term in problem.preset[0].terms:
        return tested  # its estimate is too far from zero for the linearisation of a score test
    rest = rest or reduced(problem, state, k, options)
    score = score_test(problem, rest.fit, options, time).score([tested.term])[0]
    return replace(tested, p_value=score.familywise(multiplicity(problem, tested.term, options)), score=score)


def preferred(problem: Problem, ours: State, theirs: State, by: float, options: EngineOptions) -> bool:
    """Whether the penalised log-likelihood of a state exceeds that of another by more than `by`.

    A model that leaves no degree of freedom is never preferred: it fits any readings, and says nothing of the noise.
    """
    return ours.fit.freedom > 0 and ours.fit.gain_over(theirs.fit) > longer(problem, ours, theirs, options) + by


def longer(problem: Problem, ours: State, theirs: State, options: EngineOptions) -> float:
    """By how much the description of a state's terms is longer than that of another's, a log-likelihood."""
    n = ours.fit.freedom
    length, other = (description_length(problem, one.fit.terms.terms, n, options) for one in (ours, theirs))
    return length - other


def listing(problem: Problem, named: State, rest: State, state: State, term: Term, options: EngineOptions) -> State:
    """The `named` state that takes the place of one with a further `term` than `rest`.

    Where that is a function, and the names at its site are not clearly likelier, these list it.
    """
    if not term.nonparametric or preferred(problem, named, state, options.close, options):
        return named
    return with_function_listed(named, rest, state, term)


def with_function_listed(named: State, rest: State, state: State, function: Term) -> State:
    """The `named` state, the names of which that `rest` lacks list the function at their site that `state` has."""
    alternative = Alternative(function, max(named.fit.gain_over(state.fit), 0.0))
    tested = [
        replace(one, alternatives=(*one.alternatives, alternative))
        if one.term not in rest.fit.terms.terms and one.term.site == function.site
        else one
        for one in named.tested
    ]
    return replace(named, tested=tuple(tested))


def most_specific(choices: Sequence[T], judged: Callable[[T], float], term: Callable[[T], Term], close: float) -> T:
    """Of the choices that the data do not distinguish from the best, the one whose term has the most specific name."""
    most = max(map(judged, choices))
    near = [choice for choice in choices if most - judged(choice) < close]
    return min(near, key=lambda choice: (term(choice).specificity, -judged(choice)))
