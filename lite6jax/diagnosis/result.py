"""The result of a diagnosis: findings, data faults, errors before and after, verdict; codes and numbers only."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.diagnosis.discrimination import SeparatingPoses
from lite6jax.diagnosis.options import Options
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.effects.catalogue import BUILT_IN, Untestable
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.estimation.least_squares import Fit
from lite6jax.recordings.fault import DataFault
from lite6jax.search.search import Selection
from lite6jax.summary import Summarised

Array = NDArray[np.floating]
Verdict = Literal["consistent", "explained", "partly_explained", "unnamed"]


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
    """

    effect: Effect
    values: Array
    covariance: Array
    p_value: float
    gain: float
    rivals: tuple[Rival, ...]

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Value and standard deviation of each parameter, by name with its unit."""
        return self.effect.reported(self.values, self.covariance)


@final
@dataclass(frozen=True, eq=False)
class Diagnosis(Summarised):
    """What makes a recording depart from the arm's model: effects and data faults, with held-out errors.

    Attributes:
        problem: the screened recording as an estimation problem, linearised where the geometry is.
        selection: the search's result: fits without and with the effects.
        findings: the effects, in the order of their numbers in `fit`.
        before: `(sample,)` m, held-out position errors with the nuisance alone.
        after: `(sample,)` m, held-out errors with the effects that the other blocks support.
        outliers: `(sample,)` bool, outlying rows and rows without joints; statistics of `before` and `after` omit them.
        faults: of the data, in the order in which they were corrected.
        ruled_out: faults that were tested for and are not there.
        separating: poses that separate findings from their rivals.
        options: thresholds.
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

    @property
    def fit(self) -> Fit:
        """Of the nuisance and all findings."""
        return self.selection.state.fit

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
    def verdict(self) -> Verdict:
        """By the findings, and by whether the held-out error with them is that of the declared noise."""
        if not self.findings:
            return "consistent"
        if max(self.findings, key=lambda finding: finding.gain).effect.nonparametric:
            return "unnamed"
        left = np.sqrt(np.mean(self.after[~self.outliers] ** 2) / 3)
        as_noise = self.problem.declared and left < self.options.as_noise * self.problem.noise[0]
        return "explained" if as_noise else "partly_explained"

    def to_dict(self) -> dict[str, Any]:
        """The document `lite6jax/diagnosis/2`: codes and plain numbers in SI units."""
        from lite6jax.diagnosis.document import (
            to_document,  # which reads and writes results, and so imports this module
        )

        return to_document(self)

    @cached_property
    def model(self) -> DiagnosedArm:
        """The arm with the effects found, as `read_model` gives it from a file."""
        from lite6jax.diagnosis.document import model_from_document

        effects = tuple(finding.effect for finding in self.findings)
        return model_from_document(self.to_dict(), tuple(e for e in effects if e.name not in BUILT_IN))
