"""Backward selection from all terms that most problems of a domain have, where a problem has many of them.

Where many effects are missing at once, their residuals inflate the estimate of autocorrelated noise, which masks each
of them, and forward selection ends early. The noise is therefore estimated from the residuals of the saturated model,
and terms are removed one by one as long as what they explain is not significant in that noise (backward elimination in
generalised least squares).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.multiplicity import multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Mask, Problem
from lite6jax.estimation.score_test import Score, autocorrelation_times, gain_p_value, score_test
from lite6jax.estimation.terms import Term, Terms
from lite6jax.progress import entered
from lite6jax.search.against_noise import in_own_noise
from lite6jax.search.backward import eliminate, prune
from lite6jax.search.forward import forward
from lite6jax.search.names import apply_discrepancy_test, most_probable
from lite6jax.search.state import SelectedTerm, State

Array = NDArray[np.floating]

_STEPS = 6
"""Most steps of a fit whose terms are about to leave."""


def from_saturated(problem: Problem, training: Mask, options: EngineOptions) -> State | None:
    """The terms of `problem.ladder` that its residuals require, in their noise; None where forward selection suffices.

    It does unless they are more than `most_terms`, or usual terms gain more than `together` at over half of the sites.

    Args:
        problem: the data.
        training: `(sample,)` bool, the samples to use.
        options: thresholds.
    """
    if not problem.ladder:
        return None
    baseline = fit(problem, Terms(), options, training=training)
    explained = zip(problem.ladder, score_test(problem, baseline, options).explained(problem.ladder), strict=True)
    terms = _distinct(problem, [term for term, one in explained if not one.confounded], baseline.training, options)
    rough = replace(options, steps=_STEPS, relinearisations=0)
    found = in_own_noise(problem, fit(problem, terms, rough, training=baseline.training), rough)
    times = autocorrelation_times(problem, found, options)
    while (leaving := _unnecessary(problem, found, times, options)) and len(found.terms.terms) > len(leaving):
        kept = [k not in leaving for k in range(len(found.terms.terms))]
        rest, values = found.terms.part(found.values, kept)
        found = fit(problem, rest, rough, values, found.nuisance, found.training, found.noise)
    named, there = found.terms.terms, {term.site for term in problem.ladder if term.usual}
    gains = [found.quadratic_gain(k) / time for k, time in enumerate(_of_terms(problem, named, times))]
    lacking = {t.site for t, gain in zip(named, gains, strict=True) if t.usual and gain > options.together}
    if len(named) <= options.most_terms and 2 * len(lacking) <= len(there):
        return None
    return _tested(problem, State(baseline, found, _untested(found)), times, options)


def refined(problem: Problem, state: State, options: EngineOptions) -> State:
    """A state of many terms with what it still lacks, and without what that makes unnecessary.

    Each term is finally tested by what it explains, in as many independent samples as the autocorrelation time of the
    groups that it acts on leaves: blocks of samples are too few for a test of so many terms. The times are those of
    the model with all of them, as what a term leaves that should have stayed would mask the next one. One function in
    the place of several names is not tried: that a domain's usual effects are there at once is no coincidence.
    """
    more = replace(options, most_terms=len(state.tested) + options.most_terms)
    state = prune(problem, eliminate(problem, forward(problem, state, more, shaped=True), more), more)
    entered("naming")
    more = replace(more, name_rounds=2 * options.name_rounds)
    state = most_probable(problem, apply_discrepancy_test(problem, state, more, several=False), more)
    times = autocorrelation_times(problem, state.fit, options)
    while leaving := _unnecessary(problem, state.fit, times, options):
        kept = [k not in leaving for k in range(len(state.tested))]
        rest, values = state.fit.terms.part(state.fit.values, kept)
        f = state.fit
        found = fit(problem, rest, options, values, f.nuisance, f.training, f.noise)
        tested = tuple(test for test, stays in zip(state.tested, kept, strict=True) if stays)
        state = State(state.baseline, found, tested)
    # the noise of neighbouring samples is not independent: so many of them count as one
    terms = state.fit.terms.terms
    wider = np.sqrt(np.repeat(_of_terms(problem, terms, times), [term.size for term in terms]))
    inflated = replace(state.fit, covariance=state.fit.covariance * np.outer(wider, wider))
    return _tested(problem, replace(state, fit=inflated), np.ones_like(times), options)


def _distinct(problem: Problem, terms: Sequence[Term], training: Mask, options: EngineOptions) -> Terms:
    """The terms that no others say as well.

    Of two that are the same there, the usual one stays.
    """
    known = np.zeros((0, problem.rows * int(training.sum())))
    kept = set[int]()
    for k in sorted(range(len(terms)), key=lambda k: not terms[k].usual):
        columns = problem.columns([terms[k]])[..., training].reshape(terms[k].size, -1)
        columns = columns / np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), 1e-300)
        own = columns - (columns @ known.T) @ known
        if np.linalg.svd(own, compute_uv=False).min() ** 2 > options.confounded:
            known = np.concatenate([known, np.linalg.qr(own.T)[0].T])
            kept.add(k)
    return Terms(tuple(term for k, term in enumerate(terms) if k in kept))


def _untested(found: Fit) -> tuple[SelectedTerm, ...]:
    return tuple(
        SelectedTerm(term, 1.0, Score(0.0, term.size, 1.0, False, found.values[part]))
        for term, part in zip(found.terms.terms, found.terms.slices, strict=True)
    )


def _of_terms(problem: Problem, terms: Sequence[Term], times: Array) -> Array:
    """The autocorrelation time for each term, at least 1 sample: the longest of the groups that it acts on."""
    acts = [np.any(problem.columns([term]), axis=(0, 2)) for term in terms]
    return np.array([max(1.0, float(times[problem.groups[rows]].max(initial=1.0))) for rows in acts])


def _tested(problem: Problem, state: State, times: Array, options: EngineOptions) -> State:
    """With each term tested by what it explains to second order, in noise of these autocorrelation times `(group,)`."""
    tested = []
    of_terms = _of_terms(problem, state.fit.terms.terms, times)
    for k, (test, time) in enumerate(zip(state.tested, of_terms, strict=True)):
        gain = state.fit.quadratic_gain(k)
        p_value = min(gain_p_value(gain, test.term.size, time) * multiplicity(problem, test.term, options), 1.0)
        tested.append(replace(test, p_value=p_value, score=test.score._replace(gain=gain, p_value=p_value)))
    return replace(state, tested=tuple(tested))


def _unnecessary(problem: Problem, found: Fit, times: Array, options: EngineOptions) -> set[int]:
    """Of each site, the term that leaves, if there is one: the least possible, or else the least significant one.

    What nearly every problem has stays longer than what else would explain the same.
    """
    std = np.sqrt(np.maximum(np.diagonal(found.covariance), 1e-300))
    worst: dict[str, tuple[tuple[bool, float], int]] = {}
    of_terms = _of_terms(problem, found.terms.terms, times)
    for k, (term, part, time) in enumerate(zip(found.terms.terms, found.terms.slices, of_terms, strict=True)):
        p_value = gain_p_value(found.quadratic_gain(k), term.size, time) * multiplicity(problem, term, options)
        beyond = max(
            max(lower - value, value - upper) / s
            for (lower, upper), value, s in zip(problem.limits(term), found.values[part], std[part], strict=True)
        )
        impossible = beyond > options.impossible
        badness = (impossible or not term.usual, 1e6 + beyond if impossible else p_value)
        if badness[1] >= options.level and badness > worst.get(term.site, ((False, 0.0), 0))[0]:
            worst[term.site] = (badness, k)
    return {k for _, k in worst.values()}
