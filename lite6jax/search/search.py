"""The search of one problem: which terms, together, its residuals require, and which of them other samples support."""

from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple, cast, final

import numpy as np

from lite6jax.array_types import Array, Mask
from lite6jax.estimation.least_squares import fit, relinearised_fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem, WanderingProblem
from lite6jax.estimation.score_test import independent_runs, score_test
from lite6jax.estimation.terms import Term, Terms, join
from lite6jax.estimation.thresholds import MARGIN
from lite6jax.progress import entered
from lite6jax.search.scan import ModelScan, is_wander, read_outs_of
from lite6jax.search.select import Selector, is_known
from lite6jax.search.state import SelectedTerm, State, fitted_again, refitted

_ROUNDS = 3
"""Linearisations: the first about the nuisance alone, each next about what the one before has found."""


class Start(NamedTuple):
    """Terms to begin with.

    Attributes:
        tested: each term, with what it was worth.
        values: `(term.size,)` of each.
        refused: names whose numbers were not possible.
        nuisance: `(number,)` beside them, from the problem's point of linearisation; that without them where not given.
    """

    tested: tuple[SelectedTerm, ...] = ()
    values: tuple[Array, ...] = ()
    refused: frozenset[Term] = frozenset()
    nuisance: Array | None = None


NO_TERMS = Start()


@final
@dataclass(frozen=True, eq=False)
class Selection:
    """The terms that a problem's residuals require.

    Attributes:
        problem: linearised at its fitted nuisance and preset terms.
        reference: the same without preset terms, which `state.baseline` was fitted to.
        state: the terms with their fit.
        confounded: candidates that are confounded with the nuisance.
        nearest: the likeliest term that was not selected, and the probability that chance alone makes it so likely.
        wandering: what read-outs do by themselves, which is nuisance of `problem`.
        cost_of_wandering: what their priors and their choice cost in log evidence.
        every: n, where the terms were selected among every n-th sample and fitted to all.
        thinned: the selection among these; None where that is of all samples.
    """

    problem: Problem
    reference: Problem
    state: State
    confounded: tuple[Term, ...] = ()
    nearest: tuple[Term, float] | None = None
    wandering: tuple[SelectedTerm, ...] = ()
    cost_of_wandering: float = 0.0
    every: int = 1
    thinned: "Selection | None" = None

    @property
    def evidence(self) -> float:
        """Log evidence of the terms and of the read-outs that wander, less what their choice costs."""
        return self.state.evidence - self.cost_of_wandering

    @property
    def start(self) -> Start:
        """Its terms, and the read-outs that wander."""
        fit = self.state.fit
        values = (*(fit.values[part] for part in fit.terms.slices), *(np.zeros(w.term.size) for w in self.wandering))
        return Start((*self.state.tested, *self.wandering), values, self.state.refused)


def search(
    problem: Problem, options: EngineOptions, training: Mask | None = None, start: Start = NO_TERMS
) -> Selection:
    """Selects terms by evidence, with the alternatives of each; arguments as of `select`."""
    return reviewed(select(problem, options, training, start=start), options)


def select(
    problem: Problem,
    options: EngineOptions,
    training: Mask | None = None,
    reference: Problem | None = None,
    names_alone: bool = False,
    start: Start = NO_TERMS,
) -> Selection:
    """Selects terms by evidence, in a linearisation about what has been found, without their alternatives.

    Of many samples, terms are first selected in every n-th. That is where the search of more of them starts: what they
    do not support is dropped, and what they show besides is added. Of very many, every n-th decides everything, and the
    terms are fitted to all at last.

    Args:
        problem: the data, linearised.
        options: thresholds.
        training: `(sample,)` bool, the samples to use; all where not given.
        reference: the problem without its preset terms, linearised on its own; the problem itself where not given.
        names_alone: whether no process is tried but what repeats and what wanders, and no term exchanged.
        start: the terms that it begins with.
    """
    training = problem.valid if training is None else training & problem.valid
    if reference is None:
        reference = problem
    valid = int(problem.valid.sum())  # so that a search with held-out samples takes the same strides
    first, last = (_stride(valid, size) for size in (options.first_samples, options.most_samples))
    begun = _begun(*_every(problem, reference, first), training[::first], options, start)
    selection = _selected(begun, options, not names_alone, names_alone)
    if last != first:
        exchanging = not names_alone and not selection.state.tested
        begun = _begun(*_every(problem, reference, last), training[::last], options, selection.start)
        selection = _selected(begun, options, exchanging, names_alone)
    selection = confirmed(_with_wandering_as_noise(selection, training[::last], options), options)
    if not names_alone:
        selection = replace(selection, state=Selector(selection.problem, options.rough).weighed(selection.state))
    return selection if last == 1 else _of_all_samples(selection, last, problem, reference, training, options)


def supported(
    problem: Problem, start: Start, options: EngineOptions, training: Mask, reference: Problem | None = None
) -> Selection:
    """The terms of an earlier search that some of its samples support, in a linearisation about these.

    Of each term and its alternatives, and of all processes of a process's component, the likeliest is kept where it is
    worth its cost, with amplitude, kernel and tried numbers chosen anew, in the likeliest noise. No further term is
    added. Of many samples every n-th decides that, and the terms are fitted to all at last.

    Args:
        problem: the data, linearised.
        start: the terms.
        options: thresholds.
        training: `(sample,)` bool, the samples to use.
        reference: as of `search`.
    """
    training = training & problem.valid
    if reference is None:
        reference = problem
    every = _stride(int(problem.valid.sum()), options.most_samples)
    some = _every(problem, reference, every)
    kept = [is_known(some[0], selected.term) for selected in start.tested]
    start = start._replace(tested=tuple(compress(start.tested, kept)), values=tuple(compress(start.values, kept)))
    begun = at_estimate(_begun(*some, training[::every], options, start), options)
    state = Selector(begun.problem, options.rough).supported(begun.state)
    selection = at_estimate(replace(begun, state=state), options)
    selection = confirmed(_with_wandering_as_noise(selection, training[::every], options), options)
    return selection if every == 1 else _of_all_samples(selection, every, problem, reference, training, options)


def _of_all_samples(
    selection: Selection, every: int, problem: Problem, reference: Problem, training: Mask, options: EngineOptions
) -> Selection:
    """The terms of a selection among every n-th sample, fitted to all in the same noise.

    In autocorrelated noise the fit takes few steps, each of which takes a multiple of the time.
    """
    f = selection.state.fit
    if selection.wandering:
        wandering = [selected.term for selected in selection.wandering]
        problem = cast(WanderingProblem, problem).with_nuisance(wandering)
        reference = cast(WanderingProblem, reference).with_nuisance(wandering)
    noise = f.noise.between(every, independent_runs(problem, training))
    extent = options if noise.white else options.rough
    nuisance = f.nuisance_about(problem)
    problem, fitted = relinearised_fit(problem, f.terms, f.values, extent, nuisance, training, noise)
    baseline = fit(reference, Terms(), options, training=training)
    state = replace(selection.state, baseline=baseline, fit=fitted)
    return replace(selection, problem=problem, reference=reference, state=state, every=every, thinned=selection)


def _every(problem: Problem, reference: Problem, every: int) -> tuple[Problem, Problem]:
    """Both of every n-th sample."""
    return (problem, reference) if every == 1 else (problem.thinned(every), reference.thinned(every))


def _with_wandering_as_noise(selection: Selection, training: Mask, options: EngineOptions) -> Selection:
    """The selection with what read-outs do by themselves as nuisance: no physics, and no prediction has it."""
    state = selection.state
    read_outs = read_outs_of(selection.problem)
    is_noise = [is_wander(selected.term) and selected.term.site in read_outs for selected in state.tested]
    wandering = tuple(compress(state.tested, is_noise))
    if not wandering:
        return selection
    terms = [selected.term for selected in wandering]
    problem = cast(WanderingProblem, selection.problem).with_nuisance(terms)
    reference = cast(WanderingProblem, selection.reference).with_nuisance(terms)
    is_physics = [not noise for noise in is_noise]
    physics = tuple(compress(state.tested, is_physics))
    part = state.fit.part(is_physics)
    rest = fitted_again(problem, reference, replace(state, fit=part, tested=physics), training, options)
    cost = rest.evidence - state.evidence
    converted = replace(selection, problem=problem, reference=reference, state=rest)
    return at_estimate(replace(converted, wandering=wandering, cost_of_wandering=cost), options)


def _stride(samples: int, most: int) -> int:
    """Every how many samples leave at most so many; of less than twice as many, all."""
    return 1 if samples < 2 * most else -(-samples // most)


def _begun(problem: Problem, reference: Problem, training: Mask, options: EngineOptions, start: Start) -> Selection:
    """The nuisance, the terms that the domain has estimated before the search, and those to start from."""
    entered("selecting")
    baseline = fit(reference, Terms(), options, training=training)
    preset, values = problem.preset
    tested = [SelectedTerm(term) for term in preset.terms]
    known = [values[part] for part in preset.slices]
    for selected, numbers in zip(start.tested, start.values, strict=True):
        if selected.term not in preset.terms:
            tested.append(selected)
            known.append(numbers)
    state = State(baseline, baseline)
    if tested:
        terms = Terms(tuple(selected.term for selected in tested))
        nuisance = baseline.nuisance_about(problem) if start.nuisance is None else start.nuisance
        fitted = fit(problem, terms, options, join(known), nuisance, training)
        gain = fitted.log_likelihood(fitted.scale) - baseline.log_likelihood(fitted.scale)
        cost = np.log(3 * max(len(problem.candidates), 1))
        for k, term in enumerate(preset.terms):
            tested[k] = SelectedTerm(term, gain, cost)
        state = State(baseline, fitted, tuple(tested), start.refused)
    return Selection(problem, reference, state)


def _selected(selection: Selection, options: EngineOptions, exchanging: bool, names_alone: bool) -> Selection:
    """The terms, selected anew where those that were found move residuals by more than what a term must gain.

    They are exchanged in the first linearisation alone.
    """
    for turn in range(_ROUNDS):
        selector = Selector(selection.problem, options.rough, names_alone)
        state = selector.selected(selection.state, exchanging and not turn)
        selection = at_estimate(replace(selection, state=state), options)
        f = selection.state.fit
        moved = (f.residuals.rows - state.fit.residuals.rows) / f.scale[selection.problem.groups, None]
        if np.sum(moved[..., f.training] ** 2) < MARGIN:
            break
    return selection


def at_estimate(selection: Selection, options: EngineOptions) -> Selection:
    """The selection linearised at its estimate and fitted there; itself without terms.

    Drivers of terms that depend on the nuisance are computed where a problem is linearised. Before a search that is
    where the nuisance alone fits best, which is far from the estimate beside an effect of many times the noise.
    """
    if not selection.state.tested:
        return selection
    f = selection.state.fit
    start = f.values, options, f.nuisance, f.training, f.noise
    problem, fitted = relinearised_fit(selection.problem, f.terms, *start)
    return replace(selection, problem=problem, state=replace(selection.state, fit=fitted))


def chance_of(selector: Selector, state: State, k: int) -> float:
    """The probability that chance alone makes the k-th term of a state so likely, family-wise over all of its kind.

    That of a name is of the score test by blocks, whatever the noise; of a process it is of the evidence. A name that
    nearly every problem has costs less than the others, but counts as one of all names that were tried.
    """
    tested = state.tested[k]
    if tested.term.nonparametric:
        return min(float(np.exp(-tested.net)), 1.0)
    test = selector.beside(state, k)
    if selector.problem.curved:
        score = test.score_columns([selector.columns_at_estimate(test, state, k)])[0]
    else:
        score = test.score([tested.term])[0]
    return score.familywise(max(float(np.exp(tested.cost)), len(selector.scan.names)))


def confirmed(selection: Selection, options: EngineOptions) -> Selection:
    """With its fit to all digits, and without names that blocks of samples do not confirm.

    Evidence takes the noise as it is modelled; the score test by blocks does not.
    """
    problem = selection.problem
    state = selection.state
    at_once = replace(options, fit=replace(options.fit, may_relinearise=False))
    selector = Selector(problem, at_once)
    preset = problem.preset[0].terms
    while state.tested:
        chances = [chance_of(selector, state, k) for k in range(len(state.tested))]
        tested = [replace(selected, p_value=p) for selected, p in zip(state.tested, chances, strict=True)]
        refutable = [p if selected.term not in preset else 0.0 for selected, p in zip(tested, chances, strict=True)]
        k = int(np.argmax(refutable))
        if refutable[k] < options.level:
            state = refitted(problem, replace(state, tested=tuple(tested)), tested, at_once)
            break
        state = refitted(problem, state, [*tested[:k], *tested[k + 1 :]], options)
        state = replace(state, fit=selector.in_likeliest_noise(state.fit))
    return replace(selection, state=state)


def nearest_of(selector: Selector, state: State) -> tuple[Term, float] | None:
    """The likeliest name beside a state, and the probability that chance alone makes it so likely."""
    candidates = ModelScan(selector.scan, selector.test(state)).names_and_waves()
    likeliest = max(candidates, key=lambda candidate: candidate.net, default=None)
    return None if likeliest is None else (likeliest.make(), min(float(np.exp(-likeliest.net)), 1.0))


def reviewed(selection: Selection, options: EngineOptions) -> Selection:
    """With the alternatives of each term, what is confounded with the nuisance, and what is nearest.

    These are of the samples that decided. In white noise each of them stands for those between.
    """
    entered("naming")
    deciding = selection.thinned or selection
    problem = deciding.problem
    selector = Selector(problem, options.rough)
    state = selector.weighed(deciding.state)
    represented = selection.every if state.fit.noise.white else 1
    pairs = zip(state.tested, selector.alternatives(state, represented), strict=True)
    tested = tuple(replace(selected, alternatives=listed) for selected, listed in pairs)
    candidates = problem.candidates
    hidden = score_test(deciding.reference, state.baseline, options).confounded(candidates)
    confounded = tuple(term for term, is_hidden in zip(candidates, hidden, strict=True) if is_hidden)
    return replace(
        selection,
        state=replace(selection.state, tested=tested),
        confounded=confounded,
        nearest=nearest_of(selector, state),
        thinned=None,
    )
