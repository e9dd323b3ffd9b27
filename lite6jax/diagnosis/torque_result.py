"""The result of a diagnosis of torques: what it has in another form than that of poses."""

from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import by_kind
from lite6jax.diagnosis.document import effect_entry, torque_model_entry
from lite6jax.diagnosis.result import STATISTICS, DomainDiagnosis
from lite6jax.diagnosis.uncertainty import uncertainty_of_torques
from lite6jax.domains.torque.predict import DiagnosedMotors
from lite6jax.domains.torque.problem import FITTED, TorqueProblem
from lite6jax.effects.catalogue import torque_catalogue
from lite6jax.effects.dynamic import UnnamedTorque
from lite6jax.effects.effect import Effect, slides
from lite6jax.recordings import Recording
from lite6jax.results import PublicResult
from lite6jax.search.state import Alternative

Array = NDArray[np.floating]


@final
class TorqueDiagnosis(DomainDiagnosis[TorqueProblem], PublicResult):
    """The diagnosis of torques."""

    @property
    def recording(self) -> Recording:
        """As it was screened."""
        return self.problem.data.recording

    @property
    def confounded(self) -> tuple[Effect, ...]:
        """Effects that are confounded with the inertial numbers that are fitted."""
        problem = self.problem
        fitted = torque_catalogue(problem.rows, problem.data.arm.sliding) if len(problem.precision) else ()
        return (*super().confounded, *(effect for effect in fitted if isinstance(effect, FITTED)))

    @cached_property
    def over_noise(self) -> Array | None:
        """`(joint,)`, held-out errors, winsorised, over the declared noise as the filter leaves it."""
        if not self.problem.declared:
            return None
        errors = (self.after / self.problem.sigma)[:, self.problem.valid]
        # spikes that pass the filter are outliers of the sensor, and not what the model leaves; 1.4826: std over median
        limit = self.options.engine.winsor * 1.4826 * np.median(np.abs(errors), 1, keepdims=True)
        return np.sqrt(np.mean(np.clip(errors, -limit, limit) ** 2, 1))

    @cached_property
    def model(self) -> DiagnosedMotors:
        """The arm with the effects found, as `read_torque_model` gives it from a file."""
        problem, fit = self.problem, self.fit
        against = {} if self.against is None else self.against.to_dict()
        return DiagnosedMotors(
            arm=problem.data.arm,
            links=problem.links_at(fit.nuisance),
            payload_center=problem.data.bodies.payload_center,
            gravity=problem.data.bodies.gravity,
            terms=fit.terms,
            values=fit.values,
            reference_temperature=problem.data.recording.settings.reference_temperature_degC,
            uncertainty=uncertainty_of_torques(problem, fit, self.after, self.folds),
            relative_to=against["file"] if against.get("by") == "rows" else None,
        )

    @property
    def _leaves_noise(self) -> bool:
        if self.over_noise is None:
            return not self.findings and self.fit.noise.white and self.withdrawn is None
        return bool((self.over_noise <= self.options.as_noise).all())

    def _errors(self, errors: Array) -> dict[str, Any]:
        """Statistics of held-out errors `(joint, sample)` Nm: over revolute joints, and in N over those that slide."""
        errors, found = errors[:, self.problem.valid], {}
        there = errors if errors.size else np.zeros((len(errors), 1))
        for name, of in STATISTICS.items():
            found |= by_kind(f"heldout_torque_{name}_Nm", np.abs(there), self.problem.data.arm.slides, of)
        return found | {"heldout_torque_rms_by_joint_Nm": np.sqrt(np.mean(errors**2, 1)).tolist()}

    def _own_parts(self) -> dict[str, Any]:
        problem, data = self.problem, self.problem.data
        chosen = data.filter
        raw = problem.noise * np.sqrt(chosen.every)
        return {
            "domain": "torque",
            "before": self._errors(self.before),
            "after": self._errors(self.after),
            "left": {
                "torque_over_noise": None if self.over_noise is None else self.over_noise.tolist(),
                "white": self.fit.noise.white,
            },
            "withdrawn": [effect_entry(f.effect) for f in (self.withdrawn.findings if self.withdrawn else ())],
            "samples": data.recording.samples,
            "kept_samples": int(problem.valid.sum()),
            "filter": None
            if data.recording.motion == "static"
            else {
                "rate_Hz": chosen.rate,
                "cutoff_Hz": chosen.cutoff,
                "motion_cutoff_Hz": data.motion_cutoff,
                "every": chosen.every,
            },
            "noise": {
                "declared_torque_Nm": raw.tolist() if problem.declared else None,
                "estimated_torque_Nm": (raw * self.fit.scale).tolist(),
            },
            "torque_source": data.recording.settings.torque_source,
            "findings": [self._finding(k) for k in range(len(self.findings))],
            "nuisance": {"numbers": len(problem.precision), "relative_std": problem.relative_std},
            "model": torque_model_entry(self.model, [finding.covariance for finding in self.findings]),
        }

    def _finding(self, k: int) -> dict[str, Any]:
        problem, fit, finding = self.problem, self.fit, self.findings[k]
        effect, sliding = finding.effect, problem.data.arm.slides
        columns = problem.columns([effect], finding.values, (fit.terms, fit.values))
        moved = np.tensordot(fit.values[fit.terms.slices[k]], columns, 1) * problem.sigma
        acts = np.abs(moved).max(1) > 0
        where = acts if acts.any() else np.ones_like(acts)
        size: dict[str, Any] = {}
        if isinstance(effect, UnnamedTorque):
            size[effect.own("peak_to_peak_Nm")] = float(np.ptp(moved, axis=1).max())
        contribution: dict[str, Any] = by_kind("moves_rms_Nm", moved[where], sliding[where], STATISTICS["rms"])
        contribution["joints"] = (1 + np.flatnonzero(acts)).tolist()
        others = [one for one in finding.alternatives if one.term not in fit.terms.terms]
        alternatives = [self._alternative(one) for one in sorted(others, key=lambda one: one.gap)]
        return finding.to_dict(size, contribution, alternatives)

    def _alternative(self, one: Alternative) -> dict[str, Any]:
        assert isinstance(one.term, Effect)
        repeats = "period_m" if slides(one.term) else "order"
        numbers = {key: getattr(one.term, key, None) for key in (repeats, "source_joint")}
        known = {key: value for key, value in numbers.items() if value is not None}
        status = "rejected" if one.gap >= self.options.engine.close else "undecided"
        return {**effect_entry(one.term), **known, "log_likelihood_gap": one.gap, "status": status}
