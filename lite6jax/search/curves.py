"""Nonparametric terms: the most likely curves of each site, and curves in place of named terms."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.estimation.equations import Explained
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.multiplicity import description_length, multiplicity, searched_size
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import CurveDriver, CurveFamily, LocalForm, Problem
from lite6jax.estimation.score_test import ScoreTest, gain_p_value, score_test
from lite6jax.estimation.terms import Term
from lite6jax.search.backward import eliminate
from lite6jax.search.forward import forward
from lite6jax.search.state import Alternative, SelectedTerm, State, added, preferred, refitted

Array = NDArray[np.floating]

_PLAYS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Half-widths of a single play operator over the largest value of its driver."""
_SEVERAL_PLAYS = (0.05, 0.1, 0.2, 0.4, 0.7)
"""Half-widths of several play operators in one term, over the same, as of hysteresis that sets in gradually."""
_WIDTHS = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5)
"""Of local forms, in the driver's unit: half a step's width, and a bump's standard deviation."""
_EDGE, _BEYOND = 2.0, 5
"""A local form is placed only where at least so many percent of the samples, and so many samples, lie on each side."""
_REFINED_WIDTHS = (0.3, 0.6, 1.0, 1.5)
_SHAPES: dict[LocalForm, tuple[tuple[int, float], ...]] = {"step": ((1, 1.0),), "bump": ((2, 2.0), (4, 2.5))}
"""Intervals of the splines of a local form, and half the range of each in its widths, beyond which it is constant."""


class Curve(NamedTuple):
    """A nonparametric term and what it would explain."""

    term: Term
    explained: Explained


def best_curves(test: ScoreTest, family: CurveFamily, local: bool) -> list[Curve]:
    """The curves of one site, the most likely few of each kind.

    Args:
        test: against a model without curves of this site.
        family: of the site.
        local: whether local forms, which are many, are tried as well.
    """
    curves: list[Term] = []
    for driver in family.drivers:
        if np.ptp(driver.values) <= test.options.least_varied:
            continue
        low, high = float(driver.values.min()), float(driver.values.max())
        curves += [driver.spline(low, high, count) for count in driver.pieces]
        if driver.local and local:
            curves += local_curves(test, family, driver)
        if driver.play is not None:
            curves += _hysteretic(test, family, driver)
    return list(map(Curve, curves, test.explained(curves)))


def replace_by_curves(problem: Problem, state: State, options: EngineOptions) -> State:
    """Replaces the named terms of a site by a curve, or adds one, where that is clearly more likely."""
    for _ in range(options.curve_rounds):
        better = _replaced(problem, state, options)
        if better is None:
            break
        state = forward(problem, better, options)
    return eliminate(problem, state, options)


def merge_harmonics(problem: Problem, state: State, options: EngineOptions) -> State:
    """Replaces many harmonics of one site by one curve: no gear has so many orders that are not whole."""
    for family in filter(lambda family: family.whole, problem.periodic):
        waves = [t.term for t in state.tested if t.term.periodic and t.term.site == family.site]
        fractional = sum(wave.chosen is not None and not wave.chosen.is_integer() for wave in waves)
        if len(waves) < options.merged or fractional < options.merged - 1:
            continue
        orders = tuple(sorted({order for wave in waves if (order := family.order(wave)) is not None}))
        beside = refitted(problem, state, [t for t in state.tested if t.term not in waves], options)
        merged = with_curve(problem, beside, family.curve(orders, state.baseline.training, None, options.fade), options)
        if merged.tested[-1].p_value < options.level:
            state = merged
    return state


def _replaced(problem: Problem, state: State, options: EngineOptions) -> State | None:
    """The most likely state in which a curve replaces all terms of its site; None where none is clearly preferred."""
    test, searched = score_test(problem, state.fit, options), searched_size(problem, options)
    best: State | None = None
    for family in problem.curves:
        kept = [tested for tested in state.tested if tested.term.site != family.site]
        if len(kept) == len(state.tested):
            curves = best_curves(test, family, local=False)
            likely = [curve.term for curve in curves if curve.explained.familywise(searched) < options.level]
            scores = zip(likely, test.score(likely), strict=True)
            worth = [term for term, score in scores if score.familywise(searched) < options.level]
            further = [with_curve(problem, state, term, options) for term in worth]
        else:
            beside = refitted(problem, state, kept, options)
            further = [state]
            # each scored in the last one's noise: a large effect masks the differences between curves
            for _ in range(options.curve_rounds):
                term = _more_likely(problem, beside.fit, further[-1], family, options)
                if term is None:
                    break
                further.append(with_curve(problem, beside, term, options))
            further = further[1:]
        for one in further:
            significant = one.tested[-1].p_value < options.level
            if significant and preferred(problem, one, best or state, 0.0 if best else options.close, options):
                best = one
    return best


def _more_likely(
    problem: Problem, beside: Fit, state: State, family: CurveFamily, options: EngineOptions
) -> Term | None:
    """The best curve of a site, to first order, where it is more likely than the terms fitted there; else None."""
    test = score_test(problem, beside, options, within=state.fit)
    there = [tested.term.site == family.site for tested in state.tested]
    terms, values = state.fit.terms.part(state.fit.values, there)
    now = test.score_columns([problem.columns(terms.terms, values)])[0].gain
    now -= description_length(problem, terms.terms, test.freedom, options)

    def likely(curve: Curve) -> float:
        return curve.explained.gain - description_length(problem, [curve.term], test.freedom, options)

    best = max(best_curves(test, family, local=True), key=likely, default=None)
    return None if best is None or likely(best) <= now else best.term


def with_curve(problem: Problem, beside: State, curve: Term, options: EngineOptions) -> State:
    """A state with a curve added, tested by its gain; the named terms nearest to it are its alternatives.

    A curve with impossible coefficients is not significant: readings that are too few for it determine the others.
    """
    test = score_test(problem, beside.fit, options)
    score = test.score([curve])[0]
    fit = added(problem, beside.fit, curve, score.values, options)
    gain, after = fit.gain_over(beside.fit), score_test(problem, fit, options)
    searched = multiplicity(problem, curve, options)
    p_value = min(gain_p_value(gain, curve.size, after.time) * searched, 1.0)
    if tested_by_blocks(curve, fit, options):
        # blocks as long as those of what is left: a large effect correlates neighbours until it is in the model
        p_value = max(p_value, test.with_time(after.time).score([curve])[0].familywise(searched))
    lower, upper = np.transpose(problem.limits(curve))
    if np.any((fit.values[-curve.size :] < lower) | (fit.values[-curve.size :] > upper)):
        p_value = 1.0
    # what a name explains of the curve is what it would explain without it, less what it still explains beside it: both
    # in the noise that the curve leaves, and as a share of what the curve explains by the same approximation
    before = score_test(problem, beside.fit, options, within=fit)
    whole, *alone = (one.gain for one in before.explained([curve, *problem.candidates]))
    left = (one.gain for one in after.explained(problem.candidates))
    shares = [min((one - other) / max(whole, 1e-300), 1.0) for one, other in zip(alone, left, strict=True)]
    near = sorted(zip(problem.candidates, shares, strict=True), key=lambda pair: -pair[1])[: options.nearest]
    alternatives = tuple(Alternative(term, gain * (1 - share)) for term, share in near if share > 0)
    tested = SelectedTerm(curve, p_value, score._replace(gain=gain), alternatives)
    return State(beside.baseline, fit, (*beside.tested, tested))


def tested_by_blocks(function: Term, fitted: Fit, options: EngineOptions) -> bool:
    """Whether a function has as few numbers, and the fit as many samples, that blocks test it as they do a name."""
    return function.size <= options.by_blocks and fitted.training.sum() >= options.sure_blocks


def local_curves_of(test: ScoreTest, site: str | None = None) -> list[Term]:
    """Local forms of a site over every quantity in which they are tried and which varies there.

    Without a site: of all sites, but only over quantities, such as time, that have no splines in their family.
    """
    of_site = [family for family in test.problem.curves if site in (None, family.site)]
    local = [(family, driver) for family in of_site for driver in family.drivers if driver.local]
    if site is None:
        local = [(family, driver) for family, driver in local if not driver.pieces]
    varied = [(family, driver) for family, driver in local if np.ptp(driver.values) > test.options.least_varied]
    return [curve for family, driver in varied for curve in local_curves(test, family, driver)]


def local_curves(test: ScoreTest, family: CurveFamily, driver: CurveDriver) -> list[Term]:
    """The most likely of each local form, of its best width."""
    found = []
    for form in driver.local:
        at, width = _placed(test, family.column, driver.values, _step if form == "step" else _bump)
        found += [driver.spline(at - reach * width, at + reach * width, pieces) for pieces, reach in _SHAPES[form]]
    return found


def _placed(test: ScoreTest, column: Array, values: Array, form: Callable[[Array], Array]) -> tuple[float, float]:
    """Where a form explains most, and its width, in the driver's unit; the grid is refined around the best."""
    options, used = test.options, values[test.fit.training]
    edge = min(max(_EDGE, 100 * _BEYOND / used.size), 25.0)
    lower, upper = np.percentile(used, (edge, 100 - edge))
    centres, widths = np.percentile(used, np.linspace(edge, 100 - edge, options.centres)), np.array(_WIDTHS)
    apart, found = float(np.diff(centres).max()), (float(lower), float(widths[0]))
    for _ in range(options.closer):
        at, width = (grid.ravel() for grid in np.meshgrid(centres, widths))
        drawn = form((values - at[:, None]) / width[:, None])
        lifted = np.stack([drawn, np.ones_like(drawn)], 1)  # a step may start from any level
        best = int(np.argmax(test.gains(column, lifted)))
        found = (float(at[best]), float(width[best]))
        centres = np.clip(found[0] + apart * np.linspace(-1, 1, 7), lower, upper)
        widths, apart = found[1] * np.array(_REFINED_WIDTHS), apart / 3
    return found


def _step(u: Array) -> Array:
    u = np.clip(u, -1, 1)
    return 0.5 * (1.5 * u - 0.5 * u**3)


def _bump(u: Array) -> Array:
    return np.exp(-0.5 * u**2)


def _hysteretic(test: ScoreTest, family: CurveFamily, driver: CurveDriver) -> list[Term]:
    """Terms linear in the driver and in play operators on it: one of the best half-width, and several at once."""
    assert driver.play is not None
    assert driver.hysteresis is not None
    most = float(np.abs(driver.values).max())
    widths = most * np.array(_PLAYS)
    followers = driver.play(widths)
    pairs = np.stack([np.broadcast_to(driver.values, followers.shape), followers], 1)
    best = float(widths[int(np.argmax(test.gains(family.column, pairs)))])
    several = tuple(most * share for share in _SEVERAL_PLAYS)
    return [driver.hysteresis((0.0, best)), driver.hysteresis((0.0, *several))]
