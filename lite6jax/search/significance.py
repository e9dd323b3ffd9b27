"""The last tests of a search: each term beside all others, in the noise that they leave."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lite6jax.estimation.concentration import Concentration, concentration
from lite6jax.estimation.equations import explained_by
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.multiplicity import multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem, acts_on, wave_of
from lite6jax.estimation.score_test import gain_p_value, longest_time, score_test
from lite6jax.estimation.terms import Term
from lite6jax.search.against_noise import in_own_noise, is_noise
from lite6jax.search.curves import tested_by_blocks
from lite6jax.search.state import SelectedTerm, State, reduced, retested

_FEWEST_OTHERS = 2
"""Groups of rows beside one's own, from which their median says what noise is."""
_CYCLES = 16.0
"""Of a wave in the range of its angle: twice as many as the pieces of a spline without a name."""


def significant(problem: Problem, state: State, options: EngineOptions) -> State:
    """Each term tested beside all others of the final model; those that are not significant leave, the least first.

    So does what explains little beside a function at its site: that may be what the function does not describe, unless
    it is a wave that is too short for that.
    A name also leaves if the error that remains at its site exceeds a small share of what it explains, or the one that
    remains in the only group of rows on which it acts exceeds all that it explains, and any term if autocorrelated
    noise in its place is more likely.
    """
    left = concentration(problem, state.fit, options) if state.tested else None  # beside all of them
    while state.tested:
        # what left may have whitened the residuals
        state = replace(state, fit=in_own_noise(problem, state.fit, options))
        time = longest_time(problem, state.fit, options)
        tests = [_tested_finally(problem, state, k, time, options) for k in range(len(state.tested))]
        tests = [
            replace(one, p_value=1.0)
            if _misfit(problem, state, k, tests, options)
            or _leaves_more(one, k, state.fit, left, options)
            or _outweighed(problem, state, k, options)
            else one
            for k, one in enumerate(tests)
        ]
        worst = max(range(len(tests)), key=lambda k: (tests[k].p_value, -tests[k].score.gain))
        if tests[worst].p_value < options.level:
            return State(state.baseline, state.fit, tuple(tests))
        state = reduced(problem, state, worst, options)
    return replace(state, fit=in_own_noise(problem, state.fit, options))


def _misfit(problem: Problem, state: State, k: int, tests: Sequence[SelectedTerm], options: EngineOptions) -> bool:
    """Whether the k-th term may be what a function without a name at its place does not describe.

    A name has to explain a share of what that function explains, and in autocorrelated noise as much: there neither
    the function nor the noise need be what they are taken for.
    """
    term, gain = tests[k].term, tests[k].score.gain
    functions = [one.term.nonparametric and _at_its_place(problem, state, k, tests, one, options) for one in tests]
    gains = [one.score.gain for one, there in zip(tests, functions, strict=True) if there]
    if not gains or _fine(problem, term):
        return False
    if not term.nonparametric:
        share = options.misfit if state.fit.noise.white else 1.0
        return any(gain < share * other for other in gains)
    if gain == max(gains):
        return False
    # functions of one place describe one another's misfit: each adds to what they explain together
    rest = state
    for there in reversed(np.flatnonzero(functions).tolist()):
        rest = reduced(problem, rest, there, options)
    return gain < options.misfit * state.fit.gain_over(rest.fit)


def _at_its_place(
    problem: Problem, state: State, k: int, tests: Sequence[SelectedTerm], of: SelectedTerm, options: EngineOptions
) -> bool:
    """Whether a function acts at the site of the k-th term, or on some of the groups of rows and the term on no others.

    If the term is a function too, that explains less, also whether it is not distinguished from one at that site. If it
    is a name that shows only through functions, as the direction of gravity does through a function of a load, it is at
    the place of each function through which it shows.
    """
    term, function = tests[k].term, of.term
    if term.site == function.site:
        return True
    if term.nonparametric:
        return tests[k].score.gain < of.score.gain and _also_at(problem, state, k, function.site, options)
    model = state.fit.terms, state.fit.values
    names, alone = (
        state.fit.terms.part(state.fit.values, kept)
        for kept in ([not one.nonparametric for one in model[0].terms], [one == function for one in model[0].terms])
    )
    if not acts_on(problem, term, names).any():
        return bool(acts_on(problem, term, alone).any())
    acts, there = (set(problem.groups[acts_on(problem, one, model)].tolist()) for one in (term, function))
    return acts <= there < set(problem.groups.tolist())


def _also_at(problem: Problem, state: State, k: int, site: str, options: EngineOptions) -> bool:
    """Whether a function of the drivers of the k-th term explains at another site what that term does."""
    term = state.tested[k].term
    wholes = [one for one in problem.flexible if one.site == site and set(one.drivers) == set(term.drivers)]
    test = score_test(problem, reduced(problem, state, k, options).fit, options, within=state.fit)
    equations = test.equations([term, *wholes])
    own, *others = explained_by(equations, options.confounded)
    now, there = own.gain - 0.5 * own.size - options.rare * term.rare, [-np.inf]
    for inside, whole, one in zip(equations[1:], wholes, others, strict=True):
        parts = (one, *test.explained_parts(inside, whole.parts))
        there += [part.gain - 0.5 * part.size - options.rare * whole.rare for part in parts]
    return max(there) > now - options.close


def _fine(problem: Problem, term: Term) -> bool:
    """Whether a term is a wave too short for a smooth function to describe, or to leave."""
    found = wave_of(problem, term)
    return found is not None and found[1] * float(np.ptp(found[0].angle)) > 2 * np.pi * _CYCLES


def _leaves_more(name: SelectedTerm, k: int, fit: Fit, left: Concentration | None, options: EngineOptions) -> bool:
    if left is None or left.site != name.term.site or name.term.nonparametric:
        return False
    return options.misfit * fit.quadratic_gain(k) < left.gain


def _outweighed(problem: Problem, state: State, k: int, options: EngineOptions) -> bool:
    """Whether a named term explains less of its group's mean square than remains there beyond the noise.

    The noise is the median of the other groups' residual sizes over what is declared of theirs. The test applies where
    the remainder is `concentrated` times the mean square of that noise or more: a name that explains a small part of it
    may be a part of physics that no candidate describes.
    """
    name, fitted = state.tested[k].term, state.fit
    groups = np.unique(problem.groups[acts_on(problem, name, (fitted.terms, fitted.values))])
    if not problem.declared or name.nonparametric or len(groups) != 1 or problem.groups.max() < _FEWEST_OTHERS:
        return False
    now = _group_scales(fitted)
    noise = float(np.median(np.delete(now, groups)))
    left = float(now[groups[0]] / noise) ** 2
    if left < options.concentrated:
        return False
    without = float(_group_scales(reduced(problem, state, k, options).fit)[groups[0]] / noise) ** 2
    return without - left < left - 1


def _group_scales(fitted: Fit) -> NDArray[np.floating]:
    """The size of each group's residuals `(group,)`, by their median, over the declared noise."""
    groups, rows = fitted.residuals.groups, np.abs(fitted.residuals.rows[:, fitted.training])
    return np.array([np.median(rows[groups == group]) for group in range(int(groups.max()) + 1)])


def _tested_finally(problem: Problem, state: State, k: int, time: float, options: EngineOptions) -> SelectedTerm:
    tested = state.tested[k]
    if tested.term in problem.preset[0].terms:
        return tested
    rest = reduced(problem, state, k, options)
    if tested.term.nonparametric:
        gain = state.fit.gain_over(rest.fit)
        p_value = min(gain_p_value(gain, tested.term.size, time) * multiplicity(problem, tested.term, options), 1.0)
        if tested_by_blocks(tested.term, state.fit, options):
            p_value = max(p_value, retested(problem, state, k, time, options, rest).p_value)
        tested = replace(tested, p_value=p_value, score=tested.score._replace(gain=gain))
    else:
        tested = retested(problem, state, k, time, options, rest)
    noise = tested.p_value < options.level and is_noise(problem, state, k, options, rest)
    return replace(tested, p_value=1.0) if noise else tested


def all_significant(problem: Problem, state: State, options: EngineOptions) -> bool:
    time = longest_time(problem, state.fit, options)
    tests = (_tested_finally(problem, state, k, time, options) for k in range(len(state.tested)))
    return all(one.p_value < options.level for one in tests)
