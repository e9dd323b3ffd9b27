"""Options of pooling: the engine's, and its own."""

from dataclasses import dataclass, field
from typing import final

from lite6jax.estimation.options import EngineOptions, option


@final
@dataclass(frozen=True)
class PoolingOptions:
    """The thresholds of pooling. Each field documents its meaning and the reason for its value.

    Attributes:
        engine: of estimation and search, as they were in the diagnoses.
    """

    engine: EngineOptions = field(default_factory=EngineOptions)
    order_step: float = option(
        0.125, "step of the orders that are pooled", "a quarter of a line's width over two turns: 5 % of its power"
    )
    most_effects: int = option(16, "most effects that a type is found to have", "twice those of one recording")
    lines: int = option(3, "sites whose best order is measured in every arm before one is added", "a line is narrow")
    processes: int = option(
        6, "processes whose kernels are measured in every arm", "twice the sites, as drivers differ"
    )
    same_line: float = option(0.5, "orders within which two waves are one line", "a line's width over two turns")
    fewest_arms: int = option(5, "arms below which none is said to differ from the others", "four give a variance")


DEFAULTS = PoolingOptions()
"""The options as they are documented."""
