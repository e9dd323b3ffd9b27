"""The state of a search: the terms of the model, what each is worth, and their fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np

from lite6jax.array_types import Array, Mask
from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.terms import Term, Terms, join
from lite6jax.estimation.whitening import Whitened


@final
@dataclass(frozen=True)
class Alternative:
    """A term, or several, that explain nearly the same as another.

    Attributes:
        term: which.
        gap: by which its log evidence, less the cost of its choice, is lower; where rollouts compare names, by which
            their log-likelihood is, if that is less.
        together_with: further terms without which it does not explain that.
    """

    term: Term
    gap: float
    together_with: tuple[Term, ...] = ()


@final
@dataclass(frozen=True, eq=False)
class SelectedTerm:
    """A term of the model, and what it is worth beside the others.

    Attributes:
        term: which.
        gain: log evidence over its absence.
        cost: −ln of its prior probability.
        volume: by which the evidence is less than the gain of the likelihood.
        p_value: family-wise.
        alternatives: terms that explain nearly as much.
        chosen_std: standard deviation of the number that was chosen for it; zero where that is exact, or not known yet.
        input_share: the share of the variance of its numbers, the greatest of them, that comes from inputs which may be
            wrong without being found so; zero where that is not known yet.
    """

    term: Term
    gain: float = 0.0
    cost: float = 0.0
    volume: float = 0.0
    p_value: float = 1.0
    alternatives: tuple[Alternative, ...] = ()
    chosen_std: float = 0.0
    input_share: float = 0.0

    @property
    def net(self) -> float:
        """Log posterior odds of its presence."""
        return self.gain - self.cost


@final
@dataclass(frozen=True, eq=False)
class State:
    """The terms of a model and their fit.

    Attributes:
        baseline: the fit of the nuisance alone.
        fit: of the nuisance and all terms.
        tested: one for each term of `fit`, in its order.
        refused: names whose numbers were not possible.

    Raises:
        ValueError: the tests are not those of the terms that were fitted.
    """

    baseline: Fit
    fit: Fit
    tested: tuple[SelectedTerm, ...] = ()
    refused: frozenset[Term] = field(default_factory=frozenset)

    def __post_init__(self) -> None:
        if tuple(test.term for test in self.tested) != self.fit.terms.terms:
            raise ValueError("the tests are not those of the fitted terms; build both from one list")

    @property
    def evidence(self) -> float:
        """Log evidence in its own noise, less what the choices of its terms and of its noise model cost."""
        names = sum(test.volume for test in self.tested if not test.term.nonparametric)
        choices = self.fit.noise.price + sum(test.cost for test in self.tested)
        return self.fit.own_likelihood - self.fit.volume - names - choices


def refitted(
    problem: Problem,
    state: State,
    tested: Sequence[SelectedTerm],
    options: EngineOptions,
    whitened: Whitened | None = None,
    starts: Mapping[Term, Array] | None = None,
) -> State:
    """The state with other terms, fitted from the numbers that it has of them, in its noise.

    Args:
        problem: of the state.
        state: to start from.
        tested: the terms.
        options: thresholds.
        whitened: as of `fit`.
        starts: the numbers of new terms to start from; zero where not given.
    """
    f = state.fit
    terms = Terms(tuple(test.term for test in tested))
    if not tested:  # from the nuisance alone: from that beside a term, another, lower maximum may be reached
        nuisance = state.baseline.nuisance_about(problem)
        bare = fit(problem, terms, options, None, nuisance, f.training, f.noise, whitened=whitened)
        return replace(state, fit=bare, tested=())
    present = {term: f.values[part] for term, part in f.terms.pairs}
    values_by_term = {**(starts or {}), **present}
    start = join([values_by_term.get(term, np.zeros(term.size)) for term in terms.terms])
    again = fit(problem, terms, options, start, f.nuisance, f.training, f.noise, whitened=whitened)
    return replace(state, fit=again, tested=tuple(tested))


def fitted_again(problem: Problem, reference: Problem, state: State, training: Mask, options: EngineOptions) -> State:
    """The terms of a state fitted to other samples, in the same noise model.

    Args:
        problem: linearised at these samples.
        reference: the same without preset terms.
        state: whose terms, and the numbers to start from.
        training: `(sample,)` bool, the samples.
        options: thresholds.
    """
    baseline = fit(reference, Terms(), options, training=training)
    of = state.fit
    again = fit(problem, of.terms, options, of.values, baseline.nuisance_about(problem), training, of.noise)
    return replace(state, baseline=baseline, fit=again)


def beyond_limits(problem: Problem, fitted: Fit, k: int) -> float:
    """By how many standard deviations a number of the k-th term is outside its bounds at most; negative within them."""
    part = fitted.terms.slices[k]
    values = fitted.values[part]
    std = np.maximum(np.sqrt(np.diagonal(fitted.covariance)[part]), 1e-300)
    lower, upper = np.transpose(problem.limits(fitted.terms.terms[k]))
    return float(np.max(np.maximum(lower - values, values - upper) / std))
