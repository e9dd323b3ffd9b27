"""The search of one problem: which terms, together, its residuals require."""

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.multiplicity import multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Mask, Problem
from lite6jax.estimation.score_test import Score, gain_p_value, longest_time, score_test
from lite6jax.estimation.terms import Term, Terms
from lite6jax.progress import entered
from lite6jax.search.alternatives import named_again, with_alternatives
from lite6jax.search.backward import eliminate, prune
from lite6jax.search.curves import merge_harmonics, replace_by_curves
from lite6jax.search.exchange import exchange, one_for_several
from lite6jax.search.forward import forward
from lite6jax.search.functions import beside_noise, unmasked
from lite6jax.search.names import apply_discrepancy_test, most_probable
from lite6jax.search.possible import believable
from lite6jax.search.retest import retest
from lite6jax.search.saturated import from_saturated, refined
from lite6jax.search.shrinkage import shrink
from lite6jax.search.significance import significant
from lite6jax.search.state import SelectedTerm, State, preferred
from lite6jax.search.whole_orders import with_whole_orders

_ROUNDS = 2
"""Times that names are tested, the second one in the linearisation at what the first has found."""


@final
@dataclass(frozen=True, eq=False)
class Selection:
    """The terms that a problem's residuals require.

    Attributes:
        problem: linearised at its fitted nuisance and preset terms.
        reference: the same without preset terms, which `state.baseline` was fitted to.
        state: the terms with their fit.
        confounded: candidates that are confounded with the nuisance.
        nearest: the most significant candidate that was not selected, and its family-wise p-value.
        saturated: whether terms were selected backward from the saturated model.
    """

    problem: Problem
    reference: Problem
    state: State
    confounded: tuple[Term, ...] = ()
    nearest: tuple[Term, float] | None = None
    saturated: bool = False


def search(
    problem: Problem,
    options: EngineOptions,
    training: Mask | None = None,
    reference: Problem | None = None,
    thorough: bool = True,
    saturated: bool = True,
) -> Selection:
    """Selects terms: forward, backward, curves, exchange, merging of harmonics, and a retest with the noise model.

    Where forward selection reaches its most terms, harmonic shrinkage may replace the rest. Of very many samples, terms
    are selected in every n-th; they are then fitted to all samples, and forward selection goes on there.

    Args:
        problem: the data, linearised.
        options: thresholds.
        training: `(sample,)` bool, the samples to use; all where not given.
        reference: the problem without its preset terms, linearised on its own; the problem itself where not given.
        thorough: whether sets of terms are exchanged, and what is confounded or nearest is determined.
        saturated: whether a backward selection from the problem's ladder is tried first.
    """
    training = problem.valid if training is None else training & problem.valid
    reference = problem if reference is None else reference
    many = from_saturated(problem, training, options) if saturated else None
    if many is not None:
        selection = Selection(problem, reference, refined(problem, many, options), saturated=True)
        if selection.state.tested:
            return _reviewed(selection, options) if thorough else selection
    every = max(int(training.sum()) // options.first_samples, 1)
    if every == 1:
        selection = _selected(problem, reference, training, options, thorough)
    else:
        part = _selected(problem.thinned(every), reference.thinned(every), training[::every], options, thorough)
        selection = _continued(problem, reference, part, training, options)
    if not any(term.shrunk for term in selection.state.fit.terms.terms):
        entered("noise")
        problem, rough = selection.problem, options.rough
        state = retest(problem, selection.state, rough)
        state = beside_noise(problem, significant(problem, believable(problem, state, rough), rough), rough)
        if thorough:
            state = with_alternatives(problem, named_again(problem, state, rough), rough)
        selection = _finished(at_estimate(replace(selection, state=state), options), options)
    return _reviewed(selection, options) if thorough else selection


def _finished(selection: Selection, options: EngineOptions) -> Selection:
    """The selection with its fit to all digits, which a search does not need to compare it with others."""
    state, f = selection.state, selection.state.fit
    if not state.tested:
        return selection
    options = replace(options, relinearisations=0)  # it is at its estimate
    fitted = fit(selection.problem, f.terms, options, f.values, f.nuisance, f.training, f.noise)
    return replace(selection, state=replace(state, fit=fitted))


def at_estimate(selection: Selection, options: EngineOptions) -> Selection:
    """The selection linearised at its estimate and fitted there, where that changes its residuals.

    Drivers of terms that depend on the nuisance are computed where a problem is linearised. Before a search that is
    where the nuisance alone fits best, which is far from the estimate beside an effect of many times the noise.
    """
    if not selection.state.tested:
        return selection
    for _ in range(options.relinearisations):
        problem, f = selection.problem, selection.state.fit
        there, none = problem.relinearised(f.nuisance), np.zeros_like(f.nuisance)
        here = problem.residual(f.nuisance, f.terms, f.values), there.residual(none, f.terms, f.values)
        apart = (np.stack(here) - f.residuals.rows) / f.scale[problem.groups, None]
        if np.max(np.sum(apart[..., f.training] ** 2, (1, 2))) < options.same:
            break
        fitted = fit(there, f.terms, options, f.values, None, f.training, f.noise)
        selection = replace(selection, problem=there, state=replace(selection.state, fit=fitted))
    return selection


def _selected(
    problem: Problem, reference: Problem, training: Mask, options: EngineOptions, thorough: bool
) -> Selection:
    rough = options.rough
    state = _names_selected(problem, reference, training, rough, thorough)
    selection = Selection(problem, reference, state)
    if any(term.shrunk for term in state.fit.terms.terms):
        return _finished(selection, options)
    entered("naming")
    selection = at_estimate(selection, options)
    selection = replace(selection, state=unmasked(selection.problem, selection.state, rough))
    for _ in range(_ROUNDS):
        before = selection.problem
        state = apply_discrepancy_test(before, selection.state, rough)
        selection = at_estimate(replace(selection, state=state), options)
        if selection.problem is before:
            break  # else other functions may be likelier in the linearisation at what was found
    return replace(selection, state=most_probable(selection.problem, selection.state, options))


def _names_selected(
    problem: Problem, reference: Problem, training: Mask, options: EngineOptions, thorough: bool
) -> State:
    entered("selecting")
    baseline = fit(reference, Terms(), options, training=training)
    added = forward(problem, _with_preset(problem, baseline, options), options)
    state = eliminate(problem, added, options)
    if len(state.tested) == options.most_terms:
        entered("shrinking")
        shrunk = shrink(problem, state, options)
        if shrunk is not None:
            return shrunk
        entered("selecting")
    with_curves = replace_by_curves(problem, added, options)
    # a curve that was significant beside terms that have left since may alone explain less than its numbers cost
    stand = any(tested.term not in problem.preset[0].terms for tested in state.tested)
    if stand or preferred(problem, with_curves, state, 0.0, options):
        state = with_curves
    state = prune(problem, state, options)
    if thorough:
        state = exchange(problem, state, options)
    state = merge_harmonics(problem, with_whole_orders(problem, state, options), options)
    state = prune(problem, state, options)  # beside an order between two whole ones, an offset may have been needed
    return one_for_several(problem, state, options)


def _with_preset(problem: Problem, baseline: Fit, options: EngineOptions) -> State:
    """The baseline, with the terms that the domain has estimated before the search."""
    terms, values = problem.preset
    if not terms.terms:
        return State(baseline, baseline)
    fitted = fit(problem, terms, options, values, training=baseline.training)
    gain = fitted.log_likelihood(fitted.scale) - baseline.log_likelihood(fitted.scale)
    time = longest_time(problem, fitted, options)
    tested = []
    for term, part in zip(terms.terms, terms.slices, strict=True):
        p_value = min(gain_p_value(gain, term.size, time) * multiplicity(problem, term, options), 1.0)
        tested.append(SelectedTerm(term, p_value, Score(gain, term.size, p_value, False, fitted.values[part])))
    return State(baseline, fitted, tuple(tested))


def _continued(
    problem: Problem, reference: Problem, part: Selection, training: Mask, options: EngineOptions
) -> Selection:
    """The terms found in a part of the samples, fitted to all, with further ones that are significant there."""
    baseline, found = fit(reference, Terms(), options, training=training), part.state.fit
    nuisance = found.nuisance_about(problem)
    if any(term.shrunk for term in found.terms.terms):
        # hundreds of numbers: a step from the estimate of enough samples
        options = replace(options, steps=1, relinearisations=0)
        fitted = fit(problem, found.terms, options, found.values, nuisance, training)
        return Selection(problem, reference, State(baseline, fitted, part.state.tested))
    fitted = fit(problem, found.terms, options, found.values, nuisance, training) if part.state.tested else baseline
    selection = at_estimate(Selection(problem, reference, State(baseline, fitted, part.state.tested)), options)
    state = forward(selection.problem, selection.state, options)
    return replace(selection, state=eliminate(selection.problem, state, options))


def _reviewed(selection: Selection, options: EngineOptions) -> Selection:
    """With the candidates that are confounded with the nuisance, and the most significant one that was not selected."""
    problem, state = selection.problem, selection.state
    candidates = problem.candidates
    explained = score_test(selection.reference, state.baseline, options).explained(candidates)
    confounded = tuple(term for term, one in zip(candidates, explained, strict=True) if one.confounded)
    if any(term.shrunk for term in state.fit.terms.terms):
        return replace(selection, confounded=confounded)
    left = [term for term in candidates if term not in state.fit.terms.terms]
    scored = zip(left, score_test(problem, state.fit, options).score(left), strict=True)
    p_values = [
        (term, score.familywise(multiplicity(problem, term, options))) for term, score in scored if not score.confounded
    ]
    return replace(selection, confounded=confounded, nearest=min(p_values, key=lambda pair: pair[1], default=None))
