"""Many effects at once: of an arm whose every joint errs at many orders, what is left is swept line by line."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lite6jax.diagnosis.case import Case
from lite6jax.diagnosis.evidence import Score, evidence_of
from lite6jax.diagnosis.refit import Fitted, refit
from lite6jax.diagnosis.spectrum import lines
from lite6jax.physics.composition import Physics
from lite6jax.physics.effect import Effect

NUMBERS_PER_JOINT = 24
"""What a sweep may fit at most: beyond, a table of corrections would say as much."""
_WORTH = 0.3
"""Of a pass' best gain: what explains less waits for the next pass, when more is known."""


class Swept(NamedTuple):
    """An effect that was added, as significant as `p`, family-wise."""

    effect: Effect
    p: float
    score: Score


def sweep(case: Case, fitted: Fitted, named: Sequence[Effect], tried: float, level: float) -> tuple[Fitted, list[Swept]]:
    """Adds effects to a fitted model, several in each pass, until nothing is left or the numbers are too many.

    In a pass every effect is judged after those before it are projected out.

    Args:
        case: the data.
        fitted: the model so far.
        named: candidates beside the orders of each joint.
        tried: how many independent candidates there are.
        level: of the family-wise error.
    """
    most = NUMBERS_PER_JOINT * case.motion.dof
    state, found = fitted, list[Swept]()
    while added := _pass(case, state, named, tried, level, most - state.physics.size):
        found += added
        physics = Physics((*state.physics.effects, *(item.effect for item in added)))
        start = np.concatenate([state.values, *(item.score.values for item in added)])
        state = refit(case, physics, start, state.moved, state.used)
    return state, found


def _pass(
    case: Case, state: Fitted, named: Sequence[Effect], tried: float, level: float, room: int
) -> list[Swept]:
    evidence = evidence_of(case, state)
    singles = [pair for pair in zip(named, evidence.score(named), strict=True) if not pair[1].hidden]
    best = max(singles, key=lambda pair: pair[1].gain - 0.5 * pair[1].size * np.log(evidence.freedom))
    candidates = [*((line.effect, line.score, line.tried) for line in lines(evidence)), (*best, 1.0)]
    candidates.sort(key=lambda item: -item[1].gain)
    added: list[Swept] = []
    for effect, _, searched in candidates:
        columns = case.columns([effect])
        score = evidence.score_columns([columns])[0]
        worth = 0.5 * score.size * np.log(evidence.freedom) + np.log(searched)
        if added:
            worth = max(worth, _WORTH * added[0].score.gain)
        p = min(score.p * tried, 1.0)
        if score.hidden or p >= level or score.gain < worth or effect.size + 1 > room:
            continue
        added.append(Swept(effect, p, score))
        room -= effect.size + 1  # an order is a number too
        evidence = evidence.given(columns)
    return added
