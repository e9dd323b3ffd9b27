"""Which effects the arms of a type have: forward selection, what one recording shows, tests of all, tests of names."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from lite6jax.populations.candidate import Candidate
from lite6jax.populations.evidence import Reduced
from lite6jax.populations.forward import Search, Selected
from lite6jax.populations.names import apply_discrepancy_test
from lite6jax.populations.pooling import Overdispersion
from lite6jax.populations.reduced import Evidence, Found


@final
@dataclass(frozen=True, eq=False)
class Outcome:
    """What a search of a type found.

    Attributes:
        selected: the effects.
        evidence: of each effect, that of every arm beside all other effects.
        overdispersion: of what is left.
        searched: the effective number of independent candidates.
    """

    selected: tuple[Selected, ...]
    evidence: tuple[tuple[Evidence | None, ...], ...]
    overdispersion: Overdispersion
    searched: float


def search(
    reduced: Reduced,
    candidates: Mapping[str, Candidate],
    found: Sequence[Sequence[Found]],
    covariate: NDArray[np.floating] | None = None,
    progress: Callable[[int], object] = lambda effects: None,
) -> Outcome:
    """Selects the effects of a type.

    Args:
        reduced: the recordings.
        candidates: by key, those of all recordings, with one for each family of waves.
        found: by each recording alone.
        covariate: `(arm,)`, what effects may drift with, or None.
        progress: called with the number of effects at each round.
    """
    looked = Search(reduced, candidates, covariate)
    chosen, scanned = looked.forward([], progress)
    chosen = looked.with_found_alone(chosen, found)
    chosen, evidence = looked.retested(chosen, scanned.overdispersion)
    if (unnamed := apply_discrepancy_test(looked, chosen, scanned.overdispersion)) != chosen:
        chosen, scanned = looked.forward(unnamed, progress)  # what a wrong name has hidden
        if len(chosen) > len(unnamed):
            chosen = apply_discrepancy_test(looked, chosen, scanned.overdispersion)
        chosen, evidence = looked.retested(chosen, scanned.overdispersion)
    return Outcome(tuple(chosen), tuple(evidence), scanned.overdispersion, looked.searched)
