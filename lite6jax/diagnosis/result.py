"""The result of a diagnosis: findings, data faults, errors before and after, verdict; codes and numbers only."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from lite6jax.checksum import with_checksum
from lite6jax.diagnosis.discrimination import SeparatingPoses
from lite6jax.diagnosis.moves import Moves, moves_of
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.verdict import Left, Verdict, left_of, rows_needed, verdict_of
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.effects.catalogue import BUILT_IN, Untestable
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.problem import Mask
from lite6jax.fitting.quality import Quality, quality_of_poses
from lite6jax.recordings.fault import DataFault
from lite6jax.results import PublicResult
from lite6jax.search.search import Selection

Array = NDArray[np.floating]


@final
@dataclass(frozen=True, eq=False)
class Rival:
    """An effect that explains nearly as much as a finding.

    Attributes:
        effect: which.
        gap: by which the log-likelihood of its refit, or beside a curve that of its score test, is lower.
    """

    effect: Effect
    gap: float


@final
@dataclass(frozen=True, eq=False)
class Finding:
    """An effect that was found in the recording.

    Attributes:
        effect: which, and where.
        values: `(coordinate,)`, its numbers.
        covariance: `(coordinate, coordinate)` of these.
        p_value: family-wise, over all that was searched.
        gain: log-likelihood that it explains.
        rivals: effects that it was preferred to, the nearest first.
        chosen_std: standard deviation of the number that the search chose for it, an order; zero where it is exact.
        input_share: the share of the variance of its numbers, the greatest of them, that comes from a payload which may
            be wrong without being found so.
    """

    effect: Effect
    values: Array
    covariance: Array
    p_value: float
    gain: float
    rivals: tuple[Rival, ...]
    chosen_std: float = 0.0
    input_share: float = 0.0

    @property
    def nearest(self) -> tuple[Rival, float] | None:
        """Of an effect without a name, the named one that explains most, and its share of the explained; or None."""
        named = [rival for rival in self.rivals if not rival.effect.nonparametric]
        if not self.effect.nonparametric or not named:
            return None
        rival = min(named, key=lambda rival: rival.gap)
        return rival, float(np.clip(1 - rival.gap / max(self.gain, 1e-300), 0.0, 1.0))

    @property
    def effective_parameters(self) -> float:
        """How many of its numbers the data determine; fewer than there are, where these have a prior."""
        spread = np.array([coordinate.spread for coordinate in self.effect.coordinates])
        return float(len(spread) - np.sum(np.diagonal(self.covariance) / spread**2))

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Value and standard deviation of each parameter, by name with its unit."""
        if not self.chosen_std:
            return self.effect.reported(self.values, self.covariance)
        covariance = np.asarray(block_diag(self.covariance, self.chosen_std**2))
        return self.effect.released().reported(np.append(self.values, self.effect.chosen or 0.0), covariance)


@final
@dataclass(frozen=True, eq=False)
class Withdrawn:
    """Effects that were significant, and do not hold on rows that were not used.

    The errors there are larger than without them, or several times those on the rows that they were fitted to.

    Attributes:
        findings: the effects.
        before: m, the root mean square of held-out position errors without them.
        after: m, with them.
    """

    findings: tuple[Finding, ...]
    before: float
    after: float


@final
@dataclass(frozen=True, eq=False)
class SearchedAgain:
    """Errors on contiguous blocks, each searched without, which rejected effects that hold when they are fitted again.

    Attributes:
        blocks: how many.
        ratio: of the held-out errors with the effects that the search of the other blocks selects to those without; of
            poses that of the root mean squares of position, of torques the mean of the logarithms over blocks.
    """

    blocks: int
    ratio: float

    def to_dict(self) -> dict[str, float]:
        """Numbers by name."""
        return {"blocks": self.blocks, "heldout_ratio": self.ratio}


@final
@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(PublicResult):
    """What makes a recording depart from the arm's model: effects and data faults, with held-out errors.

    Attributes:
        problem: the screened recording as an estimation problem, linearised where the geometry is.
        selection: the search's result: fits without and with the effects.
        findings: the effects, in the order of their numbers in `fit`.
        before: `(sample,)` m, held-out position errors with the nuisance alone.
        after: `(sample,)` m, held-out errors with the effects that a search of the other blocks selects; where that
            rejected the findings and these hold when they are fitted again, with the findings.
        outliers: `(sample,)` bool, outlying rows and rows without joints; statistics of `before` and `after` omit them.
        faults: of the data, in the order in which they were corrected.
        ruled_out: faults that were tested for and are not there.
        separating: poses that separate findings from their rivals.
        options: thresholds.
        folds: `(sample,)` bool each, the rows that were held out together for `before` and `after`.
        withdrawn: effects that were not kept, because they do not hold on held-out rows; None where there are none.
        searched_again: errors where the search was repeated; None where `before` and `after` are these.
        turned: `(sample,)` rad each, held-out errors of orientations before and after; None where none were measured.
    """

    problem: PoseProblem
    selection: Selection
    findings: tuple[Finding, ...]
    before: Array
    after: Array
    outliers: NDArray[np.bool_]
    faults: tuple[DataFault, ...]
    ruled_out: tuple[DataFault, ...]
    separating: tuple[SeparatingPoses, ...]
    options: Options
    folds: tuple[Mask, ...]
    withdrawn: Withdrawn | None = None
    searched_again: SearchedAgain | None = None
    turned: tuple[Array, Array] | None = None

    @property
    def fit(self) -> Fit:
        """Of the nuisance and all findings."""
        return self.selection.state.fit

    @property
    def left_out(self) -> NDArray[np.bool_]:
        """`(sample,)`, rows that were not fitted, because a finding does not say what it does there."""
        return self.problem.valid & ~self.fit.training if self.findings else np.zeros(self.problem.samples, bool)

    @cached_property
    def moves(self) -> tuple[Moves, ...]:
        """What each finding moves beyond what the nuisance would take up."""
        return moves_of(self)

    @property
    def untestable(self) -> tuple[Untestable, ...]:
        """Effects that this recording cannot show, and why."""
        return self.problem.untestable

    @property
    def confounded(self) -> tuple[Effect, ...]:
        """Effects that are confounded with the frames and the geometry that are fitted."""
        return tuple(term for term in self.selection.confounded if isinstance(term, Effect))

    @property
    def nearest(self) -> tuple[Effect, float] | None:
        """The most significant effect that is no finding, and its family-wise p-value."""
        if self.selection.nearest is None:
            return None
        term, p_value = self.selection.nearest
        assert isinstance(term, Effect)
        return term, p_value

    @property
    def inertial_loads(self) -> bool:
        """Whether loads include the inertial forces of the moving arm."""
        return self.problem.motion.joint_acceleration is not None

    @property
    def estimated_noise(self) -> float:
        """Standard deviation per axis of position, m, estimated from the residuals."""
        return float(self.fit.scale[0] * self.problem.noise[0])

    @cached_property
    def left(self) -> Left:
        """What the model leaves of the residuals."""
        return left_of(self)

    @cached_property
    def quality(self) -> Quality:
        """Whether the model with the findings describes the poses, on rows that were not used."""
        problem, fit, kept = self.problem, self.fit, self.problem.valid
        measured = np.asarray(problem.measured.position).T
        predicted = measured + problem.position_errors(fit.nuisance, fit.terms, fit.values).T
        left = [ratio for ratio in (self.left.position, self.left.orientation) if ratio is not None]
        reach, over_noise = problem.arm.reach, max(left, default=None)
        noise = problem.declared_noise[0]
        return quality_of_poses(self.after[kept], measured[kept], predicted[kept], reach, noise, over_noise)

    @cached_property
    def rows_needed(self) -> int:
        """About how many rows would make the nearest effect that is no finding significant, if it is real."""
        return rows_needed(self)

    @cached_property
    def verdict(self) -> Verdict:
        """By the findings, by what is left of the residuals, and by whether the rows are enough to tell."""
        return verdict_of(self)

    def to_dict(self) -> dict[str, Any]:
        """The document `lite6jax/diagnosis/2`, as `read_model` reads it: codes, numbers in SI units, a checksum."""
        from lite6jax.diagnosis.document import (
            to_document,  # which reads and writes results, and so imports this module
        )

        return with_checksum(to_document(self))

    @cached_property
    def model(self) -> DiagnosedArm:
        """The arm with the effects found, as `read_model` gives it from a file."""
        from lite6jax.diagnosis.document import model_from_document

        effects = tuple(finding.effect for finding in self.findings)
        return model_from_document(self.to_dict(), tuple(e for e in effects if e.name not in BUILT_IN))
