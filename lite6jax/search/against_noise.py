"""Effects against autocorrelated noise: which of the two explains residuals, by likelihood.

Along a slow motion either can look like the other. The effect is taken with the noise that it leaves, and the model
without it with the most likely autocorrelated noise of its residuals.
"""

from dataclasses import replace

from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.multiplicity import description_length, multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import gain_p_value, remaining_noise_model
from lite6jax.search.state import SelectedTerm, State, reduced


def tested_against_noise(problem: Problem, state: State, k: int, options: EngineOptions) -> SelectedTerm:
    """The k-th term tested by its gain over autocorrelated noise in its place.

    For terms of many numbers, which blocks of a short recording are too few to test.
    """
    tested, rest = state.tested[k], reduced(problem, state, k, options).fit
    gain = own_likelihood(state.fit) - own_likelihood(in_correlated_noise(problem, rest, options) or rest)
    p_value = gain_p_value(gain, tested.term.size, 1.0) * multiplicity(problem, tested.term, options)
    return replace(tested, p_value=min(p_value, 1.0), score=tested.score._replace(gain=gain))


def is_noise(problem: Problem, state: State, k: int, options: EngineOptions) -> bool:
    """Whether autocorrelated noise in the place of the k-th term is more likely.

    A few numbers along a slow motion can leave white residuals of such noise, and then look significant.
    """
    term = state.tested[k].term
    if term in problem.preset[0].terms:
        return False
    correlated = in_correlated_noise(problem, reduced(problem, state, k, options).fit, options)
    if correlated is None:
        return False
    gain = own_likelihood(state.fit) - own_likelihood(correlated)
    return gain < description_length(problem, [term], state.fit.freedom, options)


def in_correlated_noise(problem: Problem, fitted: Fit, options: EngineOptions) -> Fit | None:
    """The same terms fitted in the autocorrelated noise of their residuals; None where these are white."""
    noise = remaining_noise_model(problem, fitted, options)
    if noise.white:
        return None
    start = fitted.values, fitted.nuisance, fitted.training
    return fit(problem, fitted.terms, options, *start, noise)


def own_likelihood(fitted: Fit) -> float:
    """The log-likelihood at the fit's own noise: its scale and its autocorrelation."""
    return fitted.log_likelihood(fitted.scale) + fitted.noise.log_volume(int(fitted.training.sum()))
