"""Harmonic shrinkage: all orders of all periodic families at once, under one prior, reduced to a curve for each site.

Adding orders one by one finds the largest first, and biases each by those still missing. All at once, with the prior's
variance estimated from the data (D. MacKay, Bayesian Interpolation, Neural Computation 4, 1992, eq. 4.9), coefficients
that the data do not determine stay near zero. The orders that matter least are then removed, step by step.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from lite6jax.estimation.least_squares import Fit, fit, linear_columns, without
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import PeriodicFamily, Problem
from lite6jax.estimation.robust import FREEDOM
from lite6jax.estimation.score_test import Score, gain_p_value, score_test, searched_size
from lite6jax.estimation.terms import Term, Terms
from lite6jax.search.state import SelectedTerm, State

Array = NDArray[np.floating]
Integers = NDArray[np.integer]

ORDERS = np.arange(1.0, 60.25, 0.5)
"""Half orders, which resolve an angle that varies over two turns; to 60, above which coefficients shrink to zero."""
_WEIGHINGS, _UPDATES = 3, 5
"""Rounds of robust weights, and of the prior's variance within each: both settle to a per cent."""
_MUCH = 0.3
"""Share of the best named term's gain from which another is added in the same round."""


class _Lines(NamedTuple):
    """The lines that are kept: families, orders, and the prior's standard deviation of a family's coefficients."""

    family: Integers
    order: Array
    spread: Array


def shrink(problem: Problem, state: State, options: EngineOptions) -> State | None:
    """The named terms of a state with curves instead of its periodic terms, where that explains more than these.

    Args:
        problem: the data.
        state: what forward selection found; its periodic terms are estimated anew.
        options: thresholds.

    Returns:
        None where the terms of the state are more likely.
    """
    named = [tested for tested in state.tested if not tested.term.periodic]
    plain = [term for term in problem.candidates if problem.shrinkable(term)]
    current, curves = _with_curves(problem, state.baseline, state.baseline, named, options)
    for _ in range(options.shrinkage_rounds - 1):
        room = options.named_numbers - sum(tested.term.size for tested in named)
        more = _named(problem, current, plain, options, room)
        if not more:
            break
        named += more
        current, curves = _with_curves(problem, state.baseline, current, named, options)
    n = state.baseline.freedom
    if current.gain_over(state.fit) < 0.5 * (current.terms.size - state.fit.terms.size) * np.log(n):
        return None
    return State(state.baseline, current, (*named, *(_tested(problem, current, curve, options) for curve in curves)))


def _with_curves(
    problem: Problem, baseline: Fit, current: Fit, named: Sequence[SelectedTerm], options: EngineOptions
) -> tuple[Fit, list[Term]]:
    """Named terms and the curves beside them, fitted; their orders are chosen from the residuals of `current`."""
    terms = tuple(tested.term for tested in named)
    curves = _curves(problem, _lines(problem, current, Terms(terms), options), current.training, options)
    model = Terms((*terms, *curves))
    return fit(problem, model, options, None, baseline.nuisance, baseline.training), curves


def _lines(problem: Problem, current: Fit, named: Terms, options: EngineOptions) -> _Lines:
    """The orders of each family that matter most, beside the nuisance and named terms."""
    training, families = np.flatnonzero(current.training), problem.periodic
    fixed = linear_columns(problem, named, np.zeros(named.size))[..., training]
    waves = [family.columns(ORDERS)[..., training].reshape(-1, *fixed.shape[1:]) for family in families]
    columns = np.concatenate([fixed, *waves]).reshape(len(fixed) + 2 * len(ORDERS) * len(families), -1)
    norms = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
    columns /= norms[:, None]
    # residuals without nuisance and terms, to first order: those of the current fit less its linear prediction
    model = linear_columns(problem, current.terms, current.values)
    explained = np.tensordot(np.concatenate([current.nuisance, current.values]), model, 1)
    target = (current.residuals.rows - explained)[:, training].ravel()
    free, shrink = len(fixed), 0.01
    weight = np.ones(len(training))
    total = squares = np.sum(target.reshape(-1, len(training)) ** 2, 0)
    for _ in range(_WEIGHINGS):
        H, g = _normal(columns, target, weight)
        solved, shrink = _ridge(H, g, free, shrink, float(weight @ total), target.size)
        squares = np.sum((target - solved @ columns).reshape(-1, len(training)) ** 2, 0)
        scale = np.median(squares) / chdtri(problem.rows, 0.5)
        weight = (FREEDOM + problem.rows) / (FREEDOM + squares / scale)
    H, g = _normal(columns, target, weight)
    noise = float(weight @ squares / max(target.size - len(H), 1))
    active = _reduced(H, g, free, shrink, options.lines_per_site * len(families), options.dropped)
    family, order = np.divmod(active, len(ORDERS))
    size = np.sqrt(noise / shrink) / norms[free:].reshape(len(families), -1)
    return _Lines(family, ORDERS[order], np.median(size, axis=1))


def _normal(columns: Array, target: Array, weight: Array) -> tuple[Array, Array]:
    weights = np.tile(np.sqrt(weight), target.size // weight.size)
    weighted = columns * weights
    return weighted @ weighted.T, weighted @ (weights * target)


def _ridge(H: Array, g: Array, free: int, shrink: float, total: float, count: int) -> tuple[Array, float]:
    """The coefficients, and the prior's precision over the noise's, by MacKay's fixed point."""
    x = np.zeros(len(H))
    for _ in range(_UPDATES):
        inverse = np.linalg.inv(_penalised(H, free, shrink))
        x = inverse @ g
        left = total - 2 * x @ g + x @ H @ x
        effective = len(H) - shrink * np.trace(inverse[free:, free:])
        wanted = (effective - free) * left / max(count - effective, 1.0) / max(float(np.sum(x[free:] ** 2)), 1e-300)
        shrink = float(np.clip(wanted, 1e-8, 1e8))
    return x, shrink


def _penalised(H: Array, free: int, shrink: float) -> Array:
    return H + np.diag(np.where(np.arange(len(H)) < free, 1e-9, shrink))


def _reduced(H: Array, g: Array, free: int, shrink: float, most: int, share: float) -> Integers:
    """The `most` lines left when those of the least Wald statistic have been removed, a `share` at a time."""
    active = np.arange((len(H) - free) // 2)
    while len(active) > most:
        at = np.concatenate([np.arange(free), (free + 2 * active[:, None] + np.arange(2)).ravel()])
        inverse = np.linalg.inv(_penalised(H[np.ix_(at, at)], free, shrink))
        pairs = (inverse @ g[at])[free:].reshape(-1, 2)
        k = np.arange(len(active))
        blocks = inverse[free:, free:].reshape(len(active), 2, len(active), 2)[k, :, k]
        wald = np.einsum("pi,pij,pj->p", pairs, np.linalg.inv(blocks), pairs)
        dropped = max(1, min(len(active) - most, int(share * len(active))))
        active = np.sort(active[np.argsort(wald)[dropped:]])
    return active


def _curves(problem: Problem, lines: _Lines, training: NDArray[np.bool_], options: EngineOptions) -> list[Term]:
    """One term for each family that has lines: a curve, or harmonics where they are few."""
    curves: list[Term] = []
    for at in np.unique(lines.family):
        family: PeriodicFamily = problem.periodic[int(at)]
        orders = tuple(float(order) for order in lines.order[lines.family == at])
        if len(orders) <= options.few_lines:
            curves += [family.term(order) for order in orders]
        else:
            curves.append(family.curve(orders, training, float(lines.spread[at]), options.fade))
    return curves


def _named(
    problem: Problem, current: Fit, candidates: Sequence[Term], options: EngineOptions, room: int
) -> list[SelectedTerm]:
    """Named terms that are significant beside the model, each tested after those before it."""
    test, searched = score_test(problem, current, options), searched_size(problem, options)
    pairs = [pair for pair in zip(candidates, test.score(candidates), strict=True) if not pair[1].confounded]
    found: list[SelectedTerm] = []
    for term, _ in sorted(pairs, key=lambda pair: -pair[1].gain)[: options.named_numbers]:
        columns = problem.columns([term])
        score = test.score_columns([columns])[0]
        p_value = score.familywise(searched)
        implausible = (np.abs(score.values) > options.plausible * Terms((term,)).typical).any()
        if term in current.terms.terms or implausible or score.confounded or p_value >= options.level:
            continue
        if score.gain < term.size * np.log(test.freedom) or term.size > room:
            continue
        if found and score.gain < _MUCH * found[0].score.gain:
            continue
        found.append(SelectedTerm(term, p_value, score))
        room -= term.size
        test = test.given(columns)
    return found


def _tested(problem: Problem, current: Fit, curve: Term, options: EngineOptions) -> SelectedTerm:
    """The test of a curve beside all else, by its gain: it has too many numbers for a test by blocks."""
    at = current.terms.terms.index(curve)
    scale = current.scale
    gain = current.log_likelihood(scale) - without(problem, current, at, options).log_likelihood(scale)
    time = score_test(problem, current, options).time
    p_value = min(gain_p_value(gain, curve.size, time) * searched_size(problem, options), 1.0)
    return SelectedTerm(
        curve, p_value, Score(gain, curve.size, p_value, False, current.values[current.terms.slices[at]])
    )
