"""The result of a diagnosis of torques: findings, data faults, errors before and after, verdict."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.checksum import with_checksum
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import Finding, SearchedAgain
from lite6jax.diagnosis.torque_uncertainty import torque_uncertainty_of
from lite6jax.diagnosis.verdict import Verdict, nearly_significant
from lite6jax.domains.torque.predict import DiagnosedMotors
from lite6jax.domains.torque.problem import FITTED, TorqueProblem
from lite6jax.effects.catalogue import Untestable
from lite6jax.effects.dynamic.catalogue import torque_catalogue
from lite6jax.effects.dynamic.torque_effect import TorqueEffect
from lite6jax.effects.effect import Effect
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.problem import Mask
from lite6jax.recordings.fault import DataFault
from lite6jax.results import PublicResult
from lite6jax.search.search import Selection

Array = NDArray[np.floating]

_NORMAL = 1.4826
"""Standard deviation over median magnitude of a normal distribution."""


@final
@dataclass(frozen=True, eq=False, repr=False)
class TorqueDiagnosis(PublicResult):
    """What makes measured torques depart from the inverse dynamics of the arm.

    Attributes:
        problem: the screened recording as an estimation problem.
        selection: the search's result: fits without and with the effects.
        findings: the effects, in the order of their numbers in `fit`.
        before: `(joint, sample)` Nm, held-out errors with the nuisance alone, of the samples that the filter keeps.
        after: `(joint, sample)` Nm, with the effects that a search of the other blocks selects; where that rejected
            the findings and these hold when they are fitted again, with the findings.
        faults: of the data.
        ruled_out: faults that were tested for and are not there.
        options: thresholds.
        folds: `(sample,)` bool each, the samples that were held out together for `before` and `after`.
        withdrawn: effects that were significant and raise the held-out errors; they are no findings.
        searched_again: errors where the search was repeated; None where `before` and `after` are these.
    """

    problem: TorqueProblem
    selection: Selection
    findings: tuple[Finding, ...]
    before: Array
    after: Array
    faults: tuple[DataFault, ...]
    ruled_out: tuple[DataFault, ...]
    options: Options
    folds: tuple[Mask, ...]
    withdrawn: tuple[Finding, ...] = ()
    searched_again: SearchedAgain | None = None

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
        """Effects that are confounded with the inertial numbers that are fitted."""
        fitted = (
            torque_catalogue(self.problem.rows, self.problem.data.arm.sliding) if len(self.problem.precision) else ()
        )
        return (
            *(term for term in self.selection.confounded if isinstance(term, Effect)),
            *(effect for effect in fitted if isinstance(effect, FITTED)),
        )

    @property
    def nearest(self) -> tuple[Effect, float] | None:
        """The most significant effect that is no finding, and its family-wise p-value."""
        if self.selection.nearest is None:
            return None
        term, p_value = self.selection.nearest
        assert isinstance(term, TorqueEffect)
        return term, p_value

    @cached_property
    def over_noise(self) -> Array | None:
        """`(joint,)`, held-out errors, winsorised, over the declared noise as the filter leaves it."""
        if not self.problem.declared:
            return None
        errors = (self.after / self.problem.sigma)[:, self.problem.valid]
        # spikes that pass the filter are outliers of the sensor and nothing that the model leaves
        limit = self.options.engine.winsor * _NORMAL * np.median(np.abs(errors), 1, keepdims=True)
        return np.sqrt(np.mean(np.clip(errors, -limit, limit) ** 2, 1))

    @cached_property
    def verdict(self) -> Verdict:
        """By the findings and by what is left of the residuals; see `diagnosis.verdict`."""
        white = self.fit.noise.white
        as_noise = self.over_noise is not None and bool((self.over_noise <= self.options.as_noise).all())
        doubtful = not self.withdrawn and nearly_significant(self.selection.nearest, self.options)
        if not self.findings:
            unknown = self.over_noise is None and white and not self.withdrawn
            if not (as_noise or unknown):
                return "unexplained"
            return "undetermined" if doubtful else "consistent"
        if max(self.findings, key=lambda finding: finding.gain).effect.nonparametric:
            return "unnamed"
        if not as_noise:
            return "partly_explained"
        return "undetermined" if doubtful else "explained"

    @cached_property
    def model(self) -> DiagnosedMotors:
        """The arm with the effects found."""
        bodies = self.problem.data.bodies
        return DiagnosedMotors(
            arm=self.problem.data.arm,
            links=self.problem.links_at(self.fit.nuisance),
            payload_center=bodies.payload_center,
            gravity=bodies.gravity,
            terms=self.fit.terms,
            values=self.fit.values,
            reference_temperature=self.problem.data.recording.settings.reference_temperature_degC,
            uncertainty=torque_uncertainty_of(self),
        )

    def to_dict(self) -> dict[str, Any]:
        """The document `lite6jax/diagnosis/2` with `domain` "torque": codes, numbers in SI units, a checksum."""
        from lite6jax.diagnosis.torque_document import (
            to_torque_document,  # which reads and writes results, and so imports this module
        )

        return with_checksum(to_torque_document(self))
