"""What recordings are tested for, as a report names it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final


@final
@dataclass(frozen=True)
class Candidate:
    """An effect that recordings are tested for, as a report names it; that of a family of waves has no order yet.

    Attributes:
        key: tells it from all others.
        effect: its name.
        site: where it acts.
        driver: what it depends on.
        names: of its numbers, with their units.
        typical: their common sizes.
        lower: the least that each can be; minus infinity where there is no bound.
        upper: the most.
        specificity: rank of its name among effects that the data do not distinguish; the least is reported.
    """

    key: str
    effect: str
    site: str
    driver: str
    names: tuple[str, ...]
    typical: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    specificity: int

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> "Candidate":
        """From the JSON form of `asdict`."""
        lists = {name: tuple(stored[name]) for name in ("names", "typical", "lower", "upper")}
        return cls(**{**stored, **lists})
