"""How sure the numbers of a selection are: what the search took for certain is let go once more."""

from dataclasses import replace

import numpy as np

from lite6jax.domains.pose.load_model import gain_of, with_other_loads
from lite6jax.domains.pose.problem import Case
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect
from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.estimation.least_squares import Fitted, refit
from lite6jax.search.forward import Selection

_UNSURE = 2.0
"""Standard deviations."""


def stated(selection: Selection) -> Selection:
    """The selection with its numbers, and their covariance, as they are to be said.

    Derivatives are those where the fit ended; of harmonics, orders above 2 were read off a spectrum, and are fitted
    along, unless that leaves a whole number within what is unsure of it. Which loads the data ask for is not certain
    either: covariances hold the square by which the other loads' values differ, times how probable those are (J.
    Hoeting et al., Bayesian Model Averaging, Statistical Science 14, 1999, eq. 3).
    """
    case, fitted = selection.case, selection.fitted
    other = with_other_loads(selection)
    if other is not None:
        difference = other.values - fitted.values
        probable = 1 / (1 + np.exp(np.clip(gain_of(fitted, other), -700, 700)))
        unsure = probable * np.outer(difference, difference)
    else:
        unsure = np.zeros_like(fitted.covariance)
    free = [isinstance(e, JointHarmonic) and e.order not in (None, 1.0, 2.0) for e in fitted.physics.effects]
    if any(free) or case.unknown:
        opened = _opened(case, fitted, free)
        still = [is_free and not _is_whole(opened, k, fitted) for k, is_free in enumerate(free)]
        if still == free:
            fitted = _held(opened, free)
        elif any(still) or case.unknown:
            fitted = _held(_opened(case, fitted, still), still)
    fitted = replace(fitted, covariance=fitted.covariance + unsure)
    steps = zip(selection.steps, fitted.physics.effects, strict=True)
    return replace(selection, fitted=fitted, steps=tuple(replace(step, effect=effect) for step, effect in steps))


def _opened(case: Case, fitted: Fitted, free: list[bool]) -> Fitted:
    """The fit with exact derivatives and with the orders of some harmonics free."""
    effects, values = [], []
    for effect, part, is_free in zip(fitted.physics.effects, fitted.physics.slices, free, strict=True):
        order = [effect.order] if is_free and isinstance(effect, JointHarmonic) else []
        effects.append(JointHarmonic(effect.joint) if is_free and isinstance(effect, JointHarmonic) else effect)
        values.append([*fitted.values[part], *order])
    physics = Physics(tuple(effects))
    return refit(
        case, physics, physics.join(values), fitted.moved, fitted.used, fitted.colour, exact=bool(case.unknown)
    )


def _is_whole(opened: Fitted, k: int, fitted: Fitted) -> bool:
    """Whether an order was a whole number, and is so still for all that is sure."""
    effect, last = fitted.physics.effects[k], opened.physics.slices[k].stop - 1
    if not isinstance(effect, JointHarmonic) or effect.order is None or effect.order % 1:
        return False
    return bool((opened.values[last] - effect.order) ** 2 < _UNSURE**2 * opened.covariance[last, last])


def _held(opened: Fitted, free: list[bool]) -> Fitted:
    """The fit with the orders that were free where they are now."""
    held: list[Effect] = []
    kept = np.ones(opened.physics.size, bool)
    for effect, part, is_free in zip(opened.physics.effects, opened.physics.slices, free, strict=True):
        last = part.stop - 1
        if is_free and isinstance(effect, JointHarmonic):
            effect, kept[last] = JointHarmonic(effect.joint, float(opened.values[last])), False
        held.append(effect)
    covariance = opened.covariance[np.ix_(kept, kept)]
    return replace(opened, physics=Physics(tuple(held)), values=opened.values[kept], covariance=covariance)
