"""Waves A·sin(n·q + φ) of an effect: their parameters for people, and their order, which a spectrum finds.

The coordinates of such an effect are A cos φ and A sin φ, in which it is linear, and after them the order n where its
field `order` does not fix it.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax.effects.effect import Choice, Effect, Reporting
from lite6jax.errors import InputError


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


def wave_reporting(amplitude: str) -> Reporting:
    """Order, amplitude under this name, and phase."""

    def parameters(effect: Any, values: NDArray) -> tuple[NDArray, NDArray]:
        sine, cosine = values[:2]
        order = values[2] if effect.order is None else effect.order
        size, phase = np.hypot(sine, cosine), np.arctan2(cosine, sine)
        jacobian = np.zeros((3, values.size))
        jacobian[0, 2:] = 1.0
        # at no amplitude the phase is anything: a huge derivative, which `reported` takes for no knowledge
        along = np.array([sine, cosine]) / size if size else np.array([1.0, 0.0])
        jacobian[1, :2] = along
        jacobian[2, :2] = np.array([-along[1], along[0]]) / max(size, 1e-300)
        return np.array([order, size, np.pi if phase == -np.pi else phase]), jacobian

    return Reporting(lambda effect: ("order", amplitude, "phase_rad"), parameters, _values(amplitude))


def _values(amplitude: str) -> Callable[[Any, Mapping[str, float]], NDArray]:
    def values(effect: Any, given: Mapping[str, float]) -> NDArray:
        order, label = given.get("order", effect.order), effect.label
        if order is None:
            raise InputError(f"{label}: no order is given; say how often the error comes in a turn, as order=2")
        if effect.order is not None and order != effect.order:
            raise InputError(f"{label}: order {order:g} beside the fixed order {effect.order:g}; give one of them")
        size, phase = given.get(amplitude, 0.0), given.get("phase_rad", 0.0)
        if size < 0:
            raise InputError(f"{label}: {amplitude} is {size:g}; make it positive and add pi to phase_rad")
        numbers = [size * np.cos(phase), size * np.sin(phase)]
        return np.array(numbers if effect.order is not None else [*numbers, order])

    return values
