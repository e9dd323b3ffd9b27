"""How sure the numbers of a selection are: what the search took for certain is let go once more."""

from dataclasses import replace

import numpy as np

from lite6jax.diagnosis.burden import gain_of, with_other_loads
from lite6jax.diagnosis.case import Case
from lite6jax.diagnosis.refit import Fitted, refit
from lite6jax.diagnosis.selection import Selection
from lite6jax.physics.composition import Physics
from lite6jax.physics.effect import Effect
from lite6jax.physics.joints import JointHarmonic


def stated(selection: Selection) -> Selection:
    """The selection with its numbers, and their covariance, as they are to be said.

    Derivatives are those where the fit ended; of harmonics, orders that are no whole numbers were read off a spectrum,
    and are fitted along. Which loads the data ask for is not certain either: covariances hold the square by which the
    other loads' values differ, times how probable those are (J. Hoeting et al., Bayesian Model Averaging, Statistical
    Science 14, 1999, eq. 3).
    """
    case, fitted = selection.case, selection.fitted
    other = with_other_loads(selection)
    if other is not None:
        difference = other.values - fitted.values
        probable = 1 / (1 + np.exp(np.clip(gain_of(fitted, other), -700, 700)))
        unsure = probable * np.outer(difference, difference)
    else:
        unsure = np.zeros_like(fitted.covariance)
    free = [isinstance(e, JointHarmonic) and e.order is not None and e.order % 1 > 0 for e in fitted.physics.effects]
    if any(free) or case.unknown:
        fitted = _let_go(case, fitted, free)
    fitted = replace(fitted, covariance=fitted.covariance + unsure)
    steps = zip(selection.steps, fitted.physics.effects, strict=True)
    return replace(selection, fitted=fitted, steps=tuple(replace(step, effect=effect) for step, effect in steps))


def _let_go(case: Case, fitted: Fitted, free: list[bool]) -> Fitted:
    """The fit with exact derivatives and with the orders of some harmonics free; these stay where they are then."""
    effects, values = [], []
    for effect, part, is_free in zip(fitted.physics.effects, fitted.physics.slices, free, strict=True):
        order = [effect.order] if is_free and isinstance(effect, JointHarmonic) else []
        effects.append(JointHarmonic(effect.joint) if is_free and isinstance(effect, JointHarmonic) else effect)
        values.append([*fitted.values[part], *order])
    physics = Physics(tuple(effects))
    found = refit(
        case, physics, physics.join(values), fitted.moved, fitted.used, fitted.colour, exact=bool(case.unknown)
    )
    if not any(free):
        return found
    held: list[Effect] = []
    kept = np.ones(physics.size, bool)
    for effect, part, is_free in zip(physics.effects, physics.slices, free, strict=True):
        last = part.stop - 1
        held.append(JointHarmonic(effect.joint, float(found.values[last])) if is_free else effect)  # type: ignore[attr-defined]
        kept[last] &= not is_free
    return replace(
        found,
        physics=Physics(tuple(held)),
        values=found.values[kept],
        covariance=found.covariance[np.ix_(kept, kept)],
    )
