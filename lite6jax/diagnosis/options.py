"""All that a caller may set of a diagnosis in one object: the engine's options, and its own."""

from dataclasses import dataclass, field, replace
from typing import final

from lite6jax.errors import InputError
from lite6jax.estimation.documented import option
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.prior import Prior
from lite6jax.recordings import RecordingSettings

_USUAL_FOLDS = 5


@final
@dataclass(frozen=True)
class Options:
    """What a caller may set of a diagnosis. Each field documents its meaning and the reason for its value.

    For example, `Options(engine=EngineOptions(level=0.01))` reports findings at a false-alarm level of 1 %.

    Attributes:
        engine: of estimation and search.

    Raises:
        InputError: fewer than two held-out blocks.
    """

    engine: EngineOptions = field(default_factory=EngineOptions)
    folds: int = option(
        _USUAL_FOLDS, "contiguous held-out blocks", "each leaves four fifths of the rows for the search"
    )
    most_separated: int = option(3, "pairs of effects for which separating poses are designed", "each takes 0.1 s")

    def __post_init__(self) -> None:
        if self.folds < 2:
            raise InputError(f"folds: {self.folds}; give 2 or more, of which each is predicted from the others")

    @property
    def prior(self) -> Prior:
        """The probabilities of explanations before any data."""
        return self.engine.prior

    def of(self, settings: RecordingSettings) -> "Options":
        """With the probabilities that a recording's settings give.

        Raises:
            InputError: a name that is no explanation.
        """
        prior = self.prior.given(settings.prior or {})
        engine = replace(self.engine, prior=prior)
        return replace(self, engine=engine)

    @property
    def quick(self) -> bool:
        """Tells whether fewer blocks are held out than usual."""
        return self.folds < _USUAL_FOLDS


QUICK = Options(folds=2, most_separated=0)
"""Those of a quick diagnosis: the same search of all rows, with two held-out blocks and without separating poses."""
