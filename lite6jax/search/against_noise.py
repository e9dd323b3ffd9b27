"""Effects against autocorrelated noise: which of the two explains residuals, by likelihood.

Along a slow motion either can look like the other. The effect is taken with the most likely noise of the residuals that
it leaves, and the model without it with that of its own. Neither model contains the other, so that the tail of χ² is an
approximation; noise at its best is not charged for its two numbers, which favours noise.
"""

from dataclasses import replace

from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.multiplicity import description_length, multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.score_test import gain_p_value, remaining_noise_model
from lite6jax.search.state import SelectedTerm, State


def in_own_noise(problem: Problem, fitted: Fit, options: EngineOptions) -> Fit:
    """The same terms fitted in the most likely noise of their residuals; or the fit itself where all is white."""
    noise = remaining_noise_model(problem, fitted, options)
    if noise.white and fitted.noise.white:
        return fitted
    start = fitted.values, fitted.nuisance, fitted.training
    return fit(problem, fitted.terms, options, *start, noise)


def tested_against_noise(problem: Problem, state: State, k: int, options: EngineOptions, rest: State) -> SelectedTerm:
    """The k-th term tested by its gain over autocorrelated noise in its place; `rest` is the state without it.

    For terms of many numbers, which blocks of a short recording are too few to test.
    """
    tested = state.tested[k]
    gain = state.fit.own_likelihood - in_own_noise(problem, rest.fit, options).own_likelihood
    p_value = gain_p_value(gain, tested.term.size, 1.0) * multiplicity(problem, tested.term, options)
    return replace(tested, p_value=min(p_value, 1.0), score=tested.score._replace(gain=gain))


def is_noise(problem: Problem, state: State, k: int, options: EngineOptions, rest: State) -> bool:
    """Whether autocorrelated noise in the place of the k-th term is more likely; `rest` is the state without it.

    A few numbers along a slow motion can leave white residuals of such noise, and then look significant. The state is
    in its own noise.
    """
    other = in_own_noise(problem, rest.fit, options)
    gain = state.fit.own_likelihood - other.own_likelihood
    needed = description_length(problem, [state.tested[k].term], state.fit.freedom, options)
    return not other.noise.white and gain < needed
