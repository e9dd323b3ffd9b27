"""Whether loads hold what it takes to accelerate the arm's masses: the data say.

Springs give way to all that they hold. Of what moves, that is gravity's pull and the inertia's; but the catalogue's
compliances are defined by gravity alone, and recordings are made that way, too. The two differ by some percent for the
moves of small arms, which is many standard deviations of a large compliance. One arm has one physics: all loads hold
it, or none.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lite6jax.domains.pose.problem import Case
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect
from lite6jax.effects.motion import accelerated
from lite6jax.estimation.least_squares import Fitted, refit
from lite6jax.estimation.score_test import evidence_of
from lite6jax.search.backward import CLOSE
from lite6jax.search.forward import Search, Selection, search_of

INERTIA_COUNTS = "Torques and moments are those of gravity and of the masses' inertia: the data ask for it."


def searched(case: Case, effects: Sequence[Effect] = ()) -> tuple[Search, Selection]:
    """The search of a case over the catalogue and `effects`, of the loads that the data ask for, and what it selects.

    It begins with the loads by which one effect explains more; what is clearly likelier with the others is searched for
    anew with these.
    """
    search = _begun(search_of(case, effects))
    selection = search.run()
    other = with_other_loads(selection)
    if other is None:
        return search, selection
    gain = gain_of(other, selection.fitted)
    if gain > 0:
        search = _turned(search)
        selection = replace(selection, case=search.case, plain=search.plain, fitted=other)
    return search, search.run() if gain > CLOSE else selection


def with_other_loads(selection: Selection) -> Fitted | None:
    """The same effects fitted with the other loads; None where there are no other, or nothing gives way to them."""
    case, fitted = _otherwise(selection.case), selection.fitted
    if case is None or not fitted.physics.loaded:
        return None
    return refit(case, fitted.physics, fitted.values, fitted.moved, fitted.used, fitted.colour)


def gain_of(fitted: Fitted, over: Fitted) -> float:
    """Log-likelihood of a fit over another's."""
    scale = min(fitted.residual.scale, over.residual.scale)
    return fitted.log_likelihood(scale) - over.log_likelihood(scale)


def _begun(search: Search) -> Search:
    """With the loads by which the likeliest of the effects that they cause explains more."""
    turned = _turned(search)
    loaded = [effect for effect in search.candidates if Physics((effect,)).loaded]
    if turned is search or not loaded:
        return search
    baseline = refit(search.plain, Physics(), moved=search.start, used=search.case.seen)
    found = []
    for case in (search.plain, turned.plain):
        evidence = evidence_of(case, baseline)
        scored = zip(loaded, evidence.score(loaded), strict=True)
        effect, score = max(scored, key=lambda pair: pair[1].gain - 0.5 * pair[1].size * np.log(evidence.freedom))
        found.append(refit(case, Physics((effect,)), score.values, baseline.moved, baseline.used))
    return turned if gain_of(found[1], found[0]) > 0 else search


def _turned(search: Search) -> Search:
    """With the other loads, where there are other."""
    case, plain = _otherwise(search.case), _otherwise(search.plain)
    return search if case is None or plain is None else replace(search, case=case, plain=plain)


def _otherwise(case: Case) -> Case | None:
    """The case with the other loads; None where the arm stood still, or masses or times are not known."""
    motion, notes = case.motion, tuple(note for note in case.notes if note != INERTIA_COUNTS)
    if motion.joint_acceleration is None:
        other, notes = accelerated(motion), (*notes, INERTIA_COUNTS)
    else:
        other = motion._replace(joint_acceleration=None)
    return None if case.inertia is None or other is motion else replace(case, motion=other, notes=notes)
