"""What the two catalogues hold, from the effects themselves: domain, sites, drivers, numbers with units, formula."""

import inspect
import re
from collections.abc import Iterable
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any, final

from lite6jax.effects import catalogue
from lite6jax.effects.dynamic import catalogue as dynamic
from lite6jax.effects.effect import Effect


@final
@dataclass(frozen=True)
class Listed:
    """One effect of a catalogue.

    Attributes:
        domain: `kinematic` (moves the tool) or `dynamic` (adds to the motors' torques).
        name: as in files and with `simulate --effect`.
        sites: where it may act: `jointN`, `linkN`, `links`, `base`, `tool`, `sensor`, `clock`, `payload`.
        drivers: the quantities on which it depends; "any" of a function without a name.
        parameters: the numbers that a diagnosis reports, each with its unit in its name; none without a name.
        units: of the numbers that a fit moves.
        description: the first line of its documentation.
    """

    domain: str
    name: str
    sites: tuple[str, ...]
    drivers: tuple[str, ...]
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    description: str

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values."""
        return asdict(self)


def listed() -> list[Listed]:
    """Every effect of both catalogues, in their order."""
    made = [*catalogue.catalogue(_JOINTS), *dynamic.torque_catalogue(_JOINTS)]
    return [
        _of(kind, [effect for effect in made if type(effect) is kind])
        for built_in in (catalogue.BUILT_IN, dynamic.BUILT_IN)
        for kind in built_in.values()
    ]


_JOINTS = 2
"""Enough for an effect of one joint by another."""


def _of(kind: type[Effect], made: list[Effect]) -> Listed:
    effects = made or [_least(kind)]
    description = _one_line(inspect.getdoc(kind) or "")
    if kind.nonparametric:
        sites = ("jointN",) if kind.domain == "dynamic" else ("jointN", "linkN", "base", "tool", "sensor")
        return Listed(kind.domain, kind.name, sites, ("any",), (), (), description)
    return Listed(
        domain=kind.domain,
        name=kind.name,
        sites=_once(re.sub(r"\d+", "N", effect.site) for effect in effects),
        drivers=_once(driver.quantity for effect in effects for driver in effect.drivers),
        parameters=_once(name for effect in effects for name in effect.reporting.names(effect)),
        units=_once(number.unit for effect in effects for number in effect.coordinates),
        description=description,
    )


def _least(kind: type[Effect]) -> Effect:
    """An effect that no catalogue holds ready, as it is tried at values that a recording shows."""
    needed = [field for field in fields(kind) if field.default is MISSING and field.default_factory is MISSING]
    given: dict[str, Any] = {field.name: "position of joint 1" if field.name == "driver" else 1 for field in needed}
    if kind.nonparametric:
        given |= {name: value for name, value in {"where": "joint1", "lower": 0.0}.items() if name in given}
    return kind(**given)


def _once(values: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(values))


def _one_line(text: str) -> str:
    """The first paragraph of a docstring on one line."""
    return " ".join(text.partition("\n\n")[0].split())
