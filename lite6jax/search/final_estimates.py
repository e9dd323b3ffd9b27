"""Final estimates: values and covariance, with the numbers that the search held fixed estimated as well."""

from dataclasses import replace

import numpy as np

from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Term, Terms, join
from lite6jax.search.state import State

_WHOLE_WITHIN = 2.0
"""Standard deviations within which an order is taken as whole: 95 %."""


def final_estimates(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state with its numbers and their covariance as they are reported.

    Derivatives are taken at the estimate. Orders that were chosen from a spectrum are fitted as well, unless one was
    whole and stays within `_WHOLE_WITHIN` standard deviations. So are other numbers that the search chose, unless one
    would leave its limits. Which of two models of the inputs holds is uncertain
    too: covariances include the squared difference between the values under both, times the probability of the other
    (J. Hoeting et al., Bayesian Model Averaging, Statistical Science 14, 1999, eq. 3). So they do for an input that may
    be wrong without being found so, on which every number may depend in proportion.
    """
    # the problem is linearised at the estimate
    options = replace(options, fit=replace(options.fit, may_relinearise=False))
    fitted = state.fit
    between = _between_models(problem, fitted, options)
    of_inputs = _beside_inputs(problem, fitted, options)
    free = [term.chosen is not None for term in fitted.terms.terms]
    stds = [0.0] * len(free)
    uncertain = _with_exact_derivatives(problem, fitted, options)
    if any(free) or uncertain:
        released = _released(problem, fitted, free, options)
        still = [f and not _is_whole(released, k, fitted) for k, f in enumerate(free)]
        still = [f and not _is_beyond(problem, released, k) for k, f in enumerate(still)]
        if still != free:
            released = None
            if any(still) or uncertain:
                released = _released(problem, fitted, still, options)
        if released is not None:
            fitted, stds = _held(released, fitted, still)
    fitted = replace(fitted, covariance=fitted.covariance + between + of_inputs)
    variance = np.diagonal(fitted.covariance)  # zero of what neither a sample nor a limit determines
    shares = np.divide(np.diagonal(of_inputs), variance, out=np.zeros_like(variance), where=variance > 0)
    tested = tuple(
        replace(test, term=term, chosen_std=std, input_share=float(np.clip(np.max(shares[part]), 0.0, 1.0)))
        for test, (term, part), std in zip(state.tested, fitted.terms.pairs, stds, strict=True)
    )
    return replace(state, fit=fitted, tested=tested)


def _between_models(problem: Problem, fitted: Fit, options: EngineOptions) -> np.ndarray:
    alternative = with_alternative(problem, fitted, options)
    if alternative is None:
        return np.zeros_like(fitted.covariance)
    difference = alternative.values - fitted.values
    probability = 1 / (1 + np.exp(np.clip(fitted.gain_over(alternative), -700, 700)))
    return probability * np.outer(difference, difference)


def _beside_inputs(problem: Problem, fitted: Fit, options: EngineOptions) -> np.ndarray:
    """What the covariance of the numbers gains as inputs may be wrong: by how much each would shift them, squared."""
    gained = np.zeros_like(fitted.covariance)
    inputs = problem.inputs(fitted.terms)
    if not inputs:
        return gained
    test = score_test(problem, fitted, options)
    for term, confounded in zip(inputs, test.confounded(inputs), strict=True):
        if confounded:
            continue
        extended = added(problem, fitted, term, np.zeros(term.size), options)
        shared = slice(fitted.terms.size)
        difference = extended.values[shared] - fitted.values
        gain = extended.gain_over(fitted) / test.time - 0.5 * term.size * np.log(fitted.freedom)
        before = options.prior.wrong_input
        probability = before / (before + (1 - before) * np.exp(-np.clip(gain, -700, 700)))
        gained += probability * (
            extended.covariance[shared, shared] - fitted.covariance + np.outer(difference, difference)
        )
    return gained


def added(problem: Problem, fitted: Fit, term: Term, values: np.ndarray, options: EngineOptions) -> Fit:
    """A fit with one more term, started from `values` `(term.size,)`."""
    terms = Terms((*fitted.terms.terms, term))
    start = np.concatenate([fitted.values, values])
    return fit(problem, terms, options, start, fitted.nuisance, fitted.training, fitted.noise)


def with_alternative(problem: Problem, fitted: Fit, options: EngineOptions) -> Fit | None:
    """The same terms fitted under the other model of the inputs; None where they do not depend on it."""
    alternative = problem.alternative(fitted.terms)
    if alternative is None:
        return None
    return fit(alternative, fitted.terms, options, fitted.values, fitted.nuisance, fitted.training, fitted.noise)


def _released(problem: Problem, fitted: Fit, free: list[bool], options: EngineOptions) -> Fit:
    """The fit with exact derivatives, and with the chosen numbers of some terms free."""
    terms = []
    values = []
    for (term, part), is_free in zip(fitted.terms.pairs, free, strict=True):
        terms.append(term.released() if is_free else term)
        values.append([*fitted.values[part], *([term.chosen] if is_free else [])])
    start = join(values)
    exact = _with_exact_derivatives(problem, fitted, options)
    return fit(problem, Terms(tuple(terms)), options, start, fitted.nuisance, fitted.training, fitted.noise, exact)


def _with_exact_derivatives(problem: Problem, fitted: Fit, options: EngineOptions) -> bool:
    """Tells whether derivatives are taken at the estimate.

    Differences by each of hundreds of coefficients would take minutes, for the last per cent of their uncertainty.
    """
    return bool(len(problem.precision)) and fitted.terms.size <= options.most_exact


def _is_whole(released: Fit, k: int, fitted: Fit) -> bool:
    """Tells whether a chosen number was whole, and its estimate is within `_WHOLE_WITHIN` standard deviations of it."""
    chosen = fitted.terms.terms[k].chosen
    last = released.terms.slices[k].stop - 1
    if chosen is None or chosen % 1:
        return False
    return bool((released.values[last] - chosen) ** 2 < _WHOLE_WITHIN**2 * released.covariance[last, last])


def _is_beyond(problem: Problem, released: Fit, k: int) -> bool:
    """Tells whether a number that was chosen leaves its limits where it is fitted: there the data say nothing of it."""
    lower, upper = problem.limits(released.terms.terms[k])[-1]
    return not lower <= released.values[released.terms.slices[k].stop - 1] <= upper


def _held(released: Fit, fitted: Fit, free: list[bool]) -> tuple[Fit, list[float]]:
    """The fit with the numbers that were free held at their estimates, and the standard deviation of each of these."""
    terms = []
    remaining = np.ones(released.terms.size, bool)
    stds = []
    for before, term, part, is_free in zip(
        fitted.terms.terms, released.terms.terms, released.terms.slices, free, strict=True
    ):
        last = part.stop - 1
        if is_free:
            term = before.held(float(released.values[last]))
            remaining[last] = False
        terms.append(term)
        stds.append(float(np.sqrt(released.covariance[last, last])) if is_free else 0.0)
    covariance = released.covariance[np.ix_(remaining, remaining)]
    return replace(released, terms=Terms(tuple(terms)), values=released.values[remaining], covariance=covariance), stds
