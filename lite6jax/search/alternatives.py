"""What explains as much as a term of the final model: functions without a name elsewhere, other orders of a wave, and
names that a search leaves out at first.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lite6jax.estimation.equations import explained_by
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem, wave_of
from lite6jax.estimation.score_test import ScoreTest, score_test
from lite6jax.estimation.terms import Term
from lite6jax.search.curves import local_curves_of
from lite6jax.search.forward import likeliest
from lite6jax.search.retest import renamed
from lite6jax.search.spectrum import as_likely
from lite6jax.search.state import Alternative, SelectedTerm, State, added, reduced
from lite6jax.search.whole_orders import slow_waves

_SAME = 0.5
"""Of log-likelihood, within which the data say nothing of which of two terms it is: what noise lets a number gain."""


def named_again(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state each named term of which is the most likely of all candidates beside the other terms.

    A term has the alternatives of the step that found it, beside what was known then, and none where it took the
    place of others. The candidates are therefore ranked once more beside the final model.
    """
    for k, tested in enumerate(state.tested):
        if not tested.term.nonparametric and tested.term not in problem.preset[0].terms:
            state = renamed(problem, _ranked_again(problem, state, k, options), k, options)
    return state


def _ranked_again(problem: Problem, state: State, k: int, options: EngineOptions) -> State:
    """The state whose k-th term has what explains nearly as much beside the others among its alternatives.

    By how much they are less likely is not known yet. Other orders of a wave are not ranked here, as `_orders` lists
    those that are as likely, nor are other numbers of a term whose number is tried.
    """
    tested = state.tested[k]
    known = {tested.term, *(one.term for one in tested.alternatives)}
    near = likeliest(problem, reduced(problem, state, k, options), options, shaped=False)
    more = [
        Alternative(one.term, 0.0)
        for one, _ in near
        if one.term not in known
        and not (one.term.label == tested.term.label and (one.term.periodic or one.term.chosen is not None))
    ]
    again = replace(tested, alternatives=(*tested.alternatives, *more))
    return replace(state, tested=(*state.tested[:k], again, *state.tested[k + 1 :]))


def with_alternatives(problem: Problem, state: State, options: EngineOptions) -> State:
    """The state whose terms have these among their alternatives, where the data do not distinguish them.

    What acts at one site may act at its neighbour in nearly the same way, two drivers may vary alike, and at angles
    that are multiples of 2° orders 2 and 178 are one wave. Which of them it is, no test of the one that was chosen can
    say.
    """
    return replace(state, tested=tuple(_with_others(problem, state, k, options) for k in range(len(state.tested))))


def _with_others(problem: Problem, state: State, k: int, options: EngineOptions) -> SelectedTerm:
    """The k-th term with its alternatives that may replace it, other orders, and the most likely function of each site.

    Sites that have an equally likely named alternative are skipped. At the site of a name it is one that explains
    clearly more, though not enough more to pay for all of its numbers; at that of a function, one of other drivers. Of
    rare functions the most likely one of all sites is among them, and beside a name a step or a bump of its site that
    explains as much.

    Noise alone lets a number more gain half a unit of log-likelihood (H. Akaike, IEEE Transactions on Automatic Control
    19, 1974), which a function's gap accounts for.
    """
    tested = state.tested[k]
    if tested.term in problem.preset[0].terms:
        return tested
    rest = reduced(problem, state, k, options)
    test = score_test(problem, rest.fit, options, within=state.fit)
    named = (one.term.site for one in tested.alternatives if one.gap < options.close and not one.term.nonparametric)
    near = set(named) - {tested.term.site}
    own = test.explained([tested.term])[0]
    now = own.gain - _cost(test, tested.term, own.size)
    functions = [term for term in problem.flexible if term.site not in near and _may_replace(tested.term, term)]
    # something else may step at the same samples
    steps = [term for term in local_curves_of(test, tested.term.site) if _may_replace(tested.term, term)]
    functions += steps
    likely: dict[object, tuple[float, Term]] = {}
    for term, gain in _likeliest_parts(test, functions, now - 2 * options.close):
        beside = term.site == tested.term.site and not tested.term.nonparametric
        step = term in steps
        least = now + options.close if beside and not step else now - 2 * options.close  # a refit may differ by `close`
        key = term.site, term.drivers if step else term.rare
        if gain > likely.get(key, (least, term))[0]:
            likely[key] = (gain, term)
    ranked = [term for _, term in sorted(likely.values(), key=lambda pair: -pair[0])]
    named_steps = [] if tested.term.nonparametric else [term for term in ranked if term in steps]
    rare = [term for term in ranked if term.rare]
    usual = [term for term in ranked if term not in named_steps and not term.rare]
    best = [*usual[: options.functions], *rare[:1], *named_steps[:1]]
    found = []
    for term, score in zip(best, test.score(best), strict=True):
        fitted = added(problem, rest.fit, term, score.values, options)
        gap = state.fit.gain_over(fitted) + _cost(test, term, score.size) - _cost(test, tested.term, own.size)
        if gap < (_SAME if term in named_steps else options.close):
            found.append(Alternative(term, max(gap, 0.0)))
    before = [a for a in tested.alternatives if not a.term.nonparametric or _may_replace(tested.term, a.term)]
    others = (*before, *found, *_orders(test, tested.term), *_like(state, k, rest, test, own.gain))
    return replace(tested, alternatives=tuple(sorted(others, key=lambda one: one.gap)))


def _likeliest_parts(test: ScoreTest, functions: Sequence[Term], least: float) -> list[tuple[Term, float]]:
    """Of each function the part of it, or the whole, that gains most, less what numbers gain in noise and rarity costs.

    Only of functions that gain more than `least` as a whole, at the cost of one number: a part hardly explains more.
    """
    equations = test.equations(functions)
    explained = explained_by(equations, test.options.confounded)
    found = []
    for term, inside, whole in zip(functions, equations, explained, strict=True):
        if whole.gain - _cost(test, term, 1) <= least:
            continue
        parts = term.parts
        gains = [one.gain - _cost(test, term, one.size) for one in (whole, *test.explained_parts(inside, parts))]
        best = int(np.argmax(gains))
        found.append((parts[best - 1].made() if best else term, gains[best]))
    return found


def _cost(test: ScoreTest, term: Term, size: int) -> float:
    """What a term of so many identifiable numbers gains in noise, in log-likelihood, and more for a rare one."""
    return 0.5 * test.time * size + test.options.rare * term.rare


def _like(state: State, k: int, rest: State, test: ScoreTest, gain: float) -> list[Alternative]:
    """Names that a search leaves out at first and that explain as much as the k-th term, which gains `gain`.

    Of a function without a name, the shaped names of its site: too few samples may make none of them significant.

    Slow waves of its site, which over a part of a turn are a line, as far as they are not distinguished; and of each
    shaped name, the term of which the data say nothing at all. A step at a value that the driver always exceeds is a
    constant, for example.
    """
    problem, options, term = test.problem, test.options, state.tested[k].term
    known = {term.label, *(one.term.label for one in state.tested[k].alternatives if one.gap < options.close)}
    slow: list[Term] = []
    shaped = [other for other in problem.shaped if not term.nonparametric or other.site == term.site]
    if not term.nonparametric:
        slow = [wave for wave in slow_waves(problem, term.site) if wave not in state.fit.terms.terms]
    others = [other for other in (*slow, *shaped) if other.label not in known]
    best: dict[str, tuple[float, Term]] = {}
    for other, one in zip(others, test.explained(others), strict=True):
        if not one.confounded and one.gain > best.get(other.label, (gain - 2 * options.close, other))[0]:
            best[other.label] = (one.gain, other)
    found = []
    terms = [other for _, other in best.values()]
    for other, score in zip(terms, test.score(terms), strict=True):
        gap = state.fit.gain_over(added(problem, rest.fit, other, score.values, options)) - options.rare * term.rare
        if gap < (options.close if other in slow or term.nonparametric else _SAME):
            found.append(Alternative(other, gap))  # negative where it explains more, though not enough for its number
    return found


def _orders(test: ScoreTest, term: Term) -> list[Alternative]:
    """Other orders of a wave that its site shows as well."""
    found = wave_of(test.problem, term)
    if found is None:
        return []
    family, order = found
    near = as_likely(test, family, order, test.options.close)
    return [Alternative(family.term(other), gap) for other, gap in near]


def _may_replace(term: Term, function: Term) -> bool:
    """Whether a function is an alternative of its own: at a function's site, only one of other drivers is."""
    return function.site != term.site or not (term.nonparametric and set(function.drivers) & set(term.drivers))
