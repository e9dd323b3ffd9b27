"""Waves A·sin(n·q + φ) of an effect: their parameters for people, and their order, which a spectrum finds.

The coordinates of such an effect are A cos φ and A sin φ, in which it is linear, and after them the order n where its
field `order` does not fix it. Along a prismatic joint the wave is A·sin(2π·n·x + φ): n counts cycles per metre, and
people read its period 1/n, such as the lead of a screw.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax.effects.effect import Choice, Effect, Reporting, slides
from lite6jax.errors import InputError

PERIOD = "period_m"
"""The parameter of a wave along a prismatic joint, in place of its order."""
_ROUNDING = 1e-12
"""Relative: an order is stored beside its inverse."""


def order_of(effect: Any) -> float | None:
    """The fixed order of an effect that is a wave; None where it is a coordinate."""
    return None if effect.order is None else float(effect.order)


def order_choice(named: tuple[float, ...] = ()) -> Choice:
    """The order as a number that a spectrum chooses; orders in `named` are candidates of their own."""

    def of(effect: Any, order: float | None) -> Effect:
        return replace(effect, order=order)

    return Choice(
        number=order_of,
        searched=lambda effect: order_of(effect) not in (None, *named),
        released=lambda effect: of(effect, None),
        held=of,
        periodic=True,
    )


def wave_angle(position: NDArray[np.floating], of_slide: bool) -> NDArray[np.floating]:
    """The angle in rad of which an order counts the waves: a joint's position, or one turn a metre of a slide."""
    return 2 * np.pi * position if of_slide else position


def wave_reporting(amplitude: str) -> Reporting:
    """Order, or the period of a wave along a prismatic joint, amplitude under this name, and phase."""

    def names(effect: Any) -> tuple[str, ...]:
        return (PERIOD if slides(effect) else "order", effect.own(amplitude), "phase_rad")

    def parameters(effect: Any, values: NDArray) -> tuple[NDArray, NDArray]:
        sine, cosine = values[:2]
        order = values[2] if effect.order is None else effect.order
        size, phase = np.hypot(sine, cosine), np.arctan2(cosine, sine)
        jacobian = np.zeros((3, values.size))
        jacobian[0, 2:] = 1.0
        if slides(effect):  # of no order, as of an effect that is neutral, there is no period
            order = 1 / order if order else 0.0
            jacobian[0, 2:] = -(order**2)
        # at no amplitude the phase is anything: a huge derivative, which `reported` takes for no knowledge
        along = np.array([sine, cosine]) / size if size else np.array([1.0, 0.0])
        jacobian[1, :2] = along
        jacobian[2, :2] = np.array([-along[1], along[0]]) / max(size, 1e-300)
        return np.array([order, size, np.pi if phase == -np.pi else phase]), jacobian

    return Reporting(names, parameters, _values(amplitude))


def _values(amplitude: str) -> Callable[[Any, Mapping[str, float]], NDArray]:
    def values(effect: Any, given: Mapping[str, float]) -> NDArray:
        order, label = _order(effect, given), effect.label
        size, phase = given.get(effect.own(amplitude), 0.0), given.get("phase_rad", 0.0)
        if size < 0:
            raise InputError(f"{label}: {effect.own(amplitude)} is {size:g}; make it positive and add pi to phase_rad")
        numbers = [size * np.cos(phase), size * np.sin(phase)]
        return np.array(numbers if effect.order is not None else [*numbers, order])

    return values


def _order(effect: Any, given: Mapping[str, float]) -> float:
    """The order that is fixed or given, along a prismatic joint as a period."""
    of_slide, label, fixed = slides(effect), effect.label, effect.order
    name = PERIOD if of_slide else "order"
    if name not in given and fixed is None:
        example = "say after which length the force repeats, as period_m=0.005" if of_slide else ""
        example = example or "say how often the error comes in a turn, as order=2"
        raise InputError(f"{label}: no {'period' if of_slide else 'order'} is given; {example}")
    if name not in given:
        return float(fixed)
    number = given[name]
    if of_slide and not number > 0:
        raise InputError(f"{label}: {name} is {number:g}; give a positive length")
    order = 1 / number if of_slide else number
    if fixed is None:
        return order
    if abs(order - fixed) > (_ROUNDING * fixed if of_slide else 0.0):
        own = 1 / fixed if of_slide else fixed
        raise InputError(f"{label}: {name} {number:g} beside the fixed {name} {own:g}; give one of them")
    return float(fixed)
