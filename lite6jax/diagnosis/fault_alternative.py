"""Faults of the data as alternatives of findings: what explains the same rows nearly as well without these effects."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, final

from lite6jax.effects.effect import Effect
from lite6jax.estimation.terms import is_process
from lite6jax.recordings.fault import DataFault

_SAME_NUMBER = 0.1
"""By how much the chosen numbers of one effect, such as the orders of a wave, differ between two fits, at most."""
_COMPARED = ("rival_terms", "log_likelihood_gap")
"""Numbers of a fault that compare it with physics, which an alternative says of itself."""


@final
@dataclass(frozen=True, eq=False)
class FaultAlternative:
    """A fault that explains nearly as much as some effects in their place.

    Attributes:
        fault: with what is known of it.
        gap: log evidence of the explanation with the effects over the likeliest one with the fault.
        replaced: the effects that the latter does without.
        together_with: effects that only the latter has.
    """

    fault: DataFault
    gap: float
    replaced: tuple[Effect, ...]
    together_with: tuple[Effect, ...] = ()

    def replaces(self, effect: Effect) -> bool:
        """Tells whether an effect is one of those that the fault explains."""
        return any(_is_same(effect, other) for other in self.replaced)

    def others(self, effect: Effect) -> list[Effect]:
        """The effects that the fault explains beside this one."""
        return list(missing_effects(self.replaced, [effect]))

    @property
    def numbers(self) -> dict[str, Any]:
        """What is known of the fault itself."""
        return {name: value for name, value in self.fault.numbers.items() if name not in _COMPARED}


def missing_effects(effects: Iterable[Effect], others: Iterable[Effect]) -> Iterator[Effect]:
    """Those of some effects that are not among others, each of which stands for one."""
    remaining = list(others)
    for effect in effects:
        same = next((k for k, other in enumerate(remaining) if _is_same(effect, other)), None)
        if same is None:
            yield effect
        else:
            del remaining[same]


def _is_same(effect: Effect, other: Effect) -> bool:
    """Tells whether two fits call an effect alike: numbers that were chosen for it may differ a little."""
    if (effect.label, effect.drivers, _component(effect)) != (other.label, other.drivers, _component(other)):
        return False
    return abs((effect.chosen or 0.0) - (other.chosen or 0.0)) < _SAME_NUMBER


def _component(effect: Effect) -> str:
    return effect.component if is_process(effect) else ""
