"""All options of a diagnosis in one object: the engine's, and its own."""

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
    """The thresholds of a diagnosis. Each field documents its meaning and the reason for its value.

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
    outlier_squares: float = option(
        30.0, "squared residual over the scale, per number, beyond which a row is an outlier", "5.5 standard deviations"
    )
    as_noise: float = option(
        1.2, "error over the declared noise up to which what is left is noise", "scatter of 30 rows"
    )
    heldout_rise: float = option(
        1.01,
        "ratio of held-out position errors with and without effects, above which these are not kept unless they have "
        "many numbers",
        "what effects that only turn the tool cost in precision",
    )
    heldout_excess: float = option(
        3.0,
        "ratio of held-out position errors to those of the fitted rows, above which effects are not kept",
        "1 to 2 where a model is right; more, where functions follow the rows that they were fitted to",
    )
    heldout_left: float = option(
        1 / 3,
        "ratio of held-out position errors with and without effects, in the geometric mean of blocks, below which "
        "effects are kept if errors are not raised",
        "what predicts most of rows that were not used is there, as drift that a block at an end continues",
    )
    spread_blocks: int = option(
        5,
        "blocks over the recording that are held out together where the effects found are fitted again",
        "none is then all that shows how a drift begins",
    )
    block_times: float = option(
        3.0,
        "autocorrelation times of the noise in the shortest of these blocks",
        "most of its rows are then independent of the rows beside it",
    )
    fewest_rows: int = option(15, "rows below which nothing is said where nothing is found", "five a fitted frame")
    nearly_significant: float = option(
        0.05,
        "family-wise p-value of an effect that is no finding, below which it is not said that nothing else is missing",
        "the usual level of a single test",
    )
    within_reach: int = option(200, "rows that may be asked for where something near was not found", "a day's work")
    most_separated: int = option(3, "pairs of effects for which separating poses are designed", "each takes 0.1 s")
    separating_poses: int = option(12, "poses that separate a pair", "half an hour of recording")
    separating_candidates: int = option(3000, "candidate poses they are chosen from", "dense enough for six joints")
    separating_margin: float = option(0.035, "rad from the joint limits that a separating pose keeps", "two degrees")
    same_effect: float = option(
        1e-4, "share of an effect that its alternative cannot do, below which both are the same", "1 % of its length"
    )

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
        """Whether fewer blocks are held out than usual."""
        return self.folds < _USUAL_FOLDS


QUICK = Options(folds=2, most_separated=0)
"""Those of a quick diagnosis: the same search of all rows, with two held-out blocks and without separating poses."""
