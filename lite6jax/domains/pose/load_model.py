"""Which load model a recording supports: gravity's loads alone, or also the inertial forces of a moving arm.

Compliances deflect under all loads. In motion these are gravity and the inertia of the masses; the catalogue's
compliances are defined by gravity alone, and simulated recordings are made in either way. For small arms the two differ
by some per cent, which is many standard deviations of a large compliance. One arm has one load model.
"""

from dataclasses import replace

import numpy as np

from lite6jax.domains.pose.columns import physics_of
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.estimation.least_squares import Fit, fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Mask
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms
from lite6jax.search.final_estimates import with_alternative
from lite6jax.search.search import Selection, at_estimate, search


def search_load_model(
    problem: PoseProblem,
    reference: PoseProblem,
    options: EngineOptions,
    training: Mask | None = None,
    thorough: bool = True,
    start: Selection | None = None,
) -> Selection:
    """The search under the more likely load model.

    It starts with the load model under which the best single effect is more likely. Where the terms found are more
    likely under the other, the search is repeated with that, as other terms may be still more likely there. If the
    terms found then are not, and the two load models are not distinguished, the first ones are refitted.

    Args:
        problem: linearised.
        reference: the same without preset terms.
        options: thresholds.
        training: `(sample,)` bool; all where not given.
        thorough: as in `search`.
        start: as in `search`.
    """
    problem, reference = _first(problem, reference, options, training)
    selection = search(problem, options, training, reference, thorough, start)
    other = with_alternative(selection.problem, selection.state.fit, options)
    if other is None:
        return selection
    gain = other.gain_over(selection.state.fit)
    if gain <= 0:
        return selection
    other_problem, other_reference = _other(problem, reference)
    again = search(other_problem, options, training, other_reference, thorough, start)
    state = replace(selection.state, fit=other)
    if gain > options.close or again.state.evidence > state.evidence:
        return again
    assert isinstance(selection.problem, PoseProblem)
    assert isinstance(selection.reference, PoseProblem)
    problem, reference = _other(selection.problem, selection.reference)
    return at_estimate(replace(selection, problem=problem, reference=reference, state=state), options)


def _other(problem: PoseProblem, reference: PoseProblem) -> tuple[PoseProblem, PoseProblem]:
    """Both with the other load model, where there is one."""
    turned, turned_reference = problem.with_other_loads(), reference.with_other_loads()
    return (problem, reference) if turned is None or turned_reference is None else (turned, turned_reference)


def _first(
    problem: PoseProblem, reference: PoseProblem, options: EngineOptions, training: Mask | None
) -> tuple[PoseProblem, PoseProblem]:
    """Both with the load model under which the most likely effect of loads has the higher likelihood."""
    turned = _other(problem, reference)
    loaded = [effect for effect in problem.candidates if physics_of(Terms((effect,))).loaded]
    if turned[0] is problem or not loaded:
        return problem, reference
    used = problem.valid if training is None else training & problem.valid
    baseline = fit(reference, Terms(), options, training=used)

    def best(case: PoseProblem) -> Fit:
        test = score_test(case, baseline, options)
        scored = zip(loaded, test.score(loaded), strict=True)
        effect, score = max(scored, key=lambda pair: pair[1].gain - 0.5 * pair[1].size * np.log(test.freedom))
        return fit(case, Terms((effect,)), options, score.values, baseline.nuisance, used)

    return turned if best(turned[1]).gain_over(best(reference)) > 0 else (problem, reference)
