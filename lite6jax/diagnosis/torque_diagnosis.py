"""The diagnosis of torques: screen, filter, search, estimate finally, verify; alone, or relative to a reference.

Its result has what a diagnosis of poses has, some of it in another form.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, ClassVar, final

import numpy as np
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm, by_kind
from lite6jax.array_types import Array, Mask
from lite6jax.calibration.source import declared_arm_of, with_calibration
from lite6jax.diagnosis.estimates import compare_effects
from lite6jax.diagnosis.heldout import errors_of_folds, errors_of_selection, fold_count, judge_by_folds, verify
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import AS_NOISE, STATISTICS, DomainDiagnosis, HeldOut
from lite6jax.diagnosis.uncertainty import uncertainty_of_torques
from lite6jax.domains.base import DomainName
from lite6jax.domains.torque.entry import model_entry
from lite6jax.domains.torque.predict import DiagnosedMotors
from lite6jax.domains.torque.problem import FITTED, TorqueProblem, torque_problem
from lite6jax.domains.torque.reference import compare_rows
from lite6jax.domains.torque.screening import contacts, screen_torques
from lite6jax.effects.catalogue import torque_catalogue
from lite6jax.effects.dynamic import (
    CoulombFriction,
    RotorInertia,
    TorqueEffect,
    TorqueOffset,
    UnnamedTorque,
    ViscousFriction,
)
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.least_squares import fit as fit_numbers
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.projection import schur_complement
from lite6jax.estimation.score_test import longest_time, remaining_noise_model
from lite6jax.estimation.terms import Terms
from lite6jax.estimation.thresholds import CLOSE
from lite6jax.progress import Stage, entered, followed, part
from lite6jax.recordings import Recording
from lite6jax.recordings.sequence import contiguous_blocks
from lite6jax.search.final_estimates import final_estimates
from lite6jax.search.search import Selection, Start, search, supported
from lite6jax.search.state import State, fitted_again


@final
class TorqueDiagnosis(DomainDiagnosis[TorqueProblem]):
    """The diagnosis of torques."""

    domain: ClassVar[DomainName] = "torques"

    @property
    def recording(self) -> Recording:
        """As it was screened."""
        return self.problem.data.recording

    @property
    def confounded(self) -> tuple[Effect, ...]:
        """Effects that are confounded with the inertial numbers that are fitted."""
        problem = self.problem
        fitted = ()
        if len(problem.precision):
            fitted = torque_catalogue(problem.rows, problem.data.arm.sliding)
        return (*super().confounded, *(effect for effect in fitted if isinstance(effect, FITTED)))

    @cached_property
    def over_noise(self) -> dict[str, float | None]:
        """RMS of held-out errors of each joint over the declared noise as the filter leaves it.

        Every sample counts but those of data faults: a mean that is robust says nothing of what acts at reversals.
        """
        return self._over(self.problem.stated)

    @cached_property
    def between_reversals(self) -> dict[str, float | None]:
        """As `over_noise`, with the doubt of friction where the direction of motion is not known."""
        return self._over(self.problem.sigma)

    def _over(self, sigma: Array) -> dict[str, float | None]:
        """Held-out errors of each joint, RMS, over `sigma` `(joint, sample)` Nm; None where no noise is declared."""
        joints = [f"joint{j}" for j in range(1, self.problem.rows + 1)]
        if not self.problem.declared:
            return dict.fromkeys(joints)
        errors = (self.after / sigma)[:, self.problem.valid]
        return dict(zip(joints, np.sqrt(np.mean(errors**2, 1)).tolist(), strict=True))

    @cached_property
    def model(self) -> DiagnosedMotors:
        """The arm with the effects found, as `read_model` gives it from a file."""
        problem = self.problem
        fit = self.fit
        return DiagnosedMotors(
            arm=problem.data.arm,
            links=problem.links_at(fit.nuisance),
            payload_center=problem.data.bodies.payload_center,
            gravity=problem.data.bodies.gravity,
            terms=fit.terms,
            values=fit.values,
            reference_temperature=problem.data.recording.settings.reference_temperature_degC,
            uncertainty=uncertainty_of_torques(problem, fit, self.after, self.folds),
            reference=self._reference,
        )

    @property
    def _leaves_noise(self) -> bool:
        if self.most_over_noise is None:
            return not self.findings and self.fit.noise.white and self.withdrawn is None
        return self.most_over_noise <= AS_NOISE

    @property
    def _noise(self) -> tuple[dict[str, Any], dict[str, Any]]:
        raw = self.problem.noise * np.sqrt(self.problem.data.recorded.every)
        declared = raw.tolist() if self.problem.declared else None
        return {"torque_Nm": declared}, {"torque_Nm": (raw * self.fit.scale).tolist()}

    def _statistics(self, errors: Array, kept: Mask) -> dict[str, Any]:
        """Over revolute joints in Nm, and over those that slide in N."""
        errors = errors[:, kept]
        statistics = {}
        padded_errors = errors if errors.size else np.zeros((len(errors), 1))
        for name, of in STATISTICS.items():
            statistics |= by_kind(f"heldout_torque_{name}_Nm", np.abs(padded_errors), self.problem.data.arm.slides, of)
        return statistics | {"heldout_torque_rms_by_joint_Nm": np.sqrt(np.mean(errors**2, 1)).tolist()}

    @cached_property
    def _added(self) -> list[Array]:
        """`(joint, sample)` Nm of each finding, what it adds."""
        problem = self.problem
        fit = self.fit
        added = []
        for finding, numbers in zip(self.findings, fit.terms.slices, strict=True):
            columns = problem.columns([finding.effect], finding.values, (fit.terms, fit.values))
            added.append(np.tensordot(fit.values[numbers], columns, 1) * problem.sigma)
        return added

    @cached_property
    def moves(self) -> tuple[dict[str, Any], ...]:
        """What each finding moves, RMS at its joints, Nm and N, and these, from 1."""
        slides = self.problem.data.arm.slides
        movements = []
        for moved in self._added:
            acts = np.abs(moved).max(1) > 0
            where = acts if acts.any() else np.ones_like(acts)
            sizes = by_kind("moves_rms_Nm", moved[where], slides[where], STATISTICS["rms"])
            movements.append({**sizes, "joints": (1 + np.flatnonzero(acts)).tolist()})
        return tuple(movements)

    def _peak_to_peak(self, k: int) -> dict[str, Estimate]:
        effect = self.findings[k].effect
        assert isinstance(effect, UnnamedTorque)
        return {effect.own("peak_to_peak_Nm"): Estimate(float(np.ptp(self._added[k], axis=1).max()), 0.0)}

    def _own_parts(self) -> dict[str, Any]:
        problem = self.problem
        data = self.problem.data
        chosen = self.problem.data.recorded
        passed = {"rate_Hz": chosen.rate, "cutoff_Hz": chosen.cutoff, "motion_cutoff_Hz": data.motion_cutoff}
        return {
            "filter": None if data.recording.motion == "static" else {**passed, "every": chosen.every},
            "nuisance": {"numbers": len(problem.precision), "relative_std": problem.relative_std},
            "model": model_entry(self.model, [finding.larger_covariance for finding in self.findings]),
        }


# ------------------------------------------------------------------ the inertial numbers of the linearisation


_EVERYWHERE = (ViscousFriction, CoulombFriction, TorqueOffset, RotorInertia)
"""What every joint has, to some degree."""
_WIDTHS = (0.03, 0.1, 0.3, 1.0, 3.0)
"""Relative standard deviations of inertial numbers that are unknown: from another series of the arm to another arm."""
_BETWEEN = 2
"""Widths that are tried between two of these."""


def linearised(problem: TorqueProblem, options: EngineOptions, training: Mask | None = None) -> TorqueProblem:
    """The problem at the inertial numbers that fit best beside the effects that every arm has.

    Without these they would be those of an arm whose weight does what friction does, and so would its loads be. The
    `training` `(sample,)` bool is all that is valid where not given.
    """
    if not len(problem.directions):
        return problem
    if training is None:
        training = problem.valid
    return problem.relinearised(fit_numbers(problem, _everywhere(problem), options, training=training).nuisance)


def with_likely_prior(problem: TorqueProblem, options: EngineOptions) -> TorqueProblem:
    """The problem with a likely width of the prior of inertial numbers, where these are unknown.

    Widths are compared by their marginal likelihood (D. MacKay, Bayesian Interpolation, Neural Computation 4, 1992) in
    the noise model of what the widest leaves. Of those that the data do not distinguish from the most likely one it is
    the widest: a prior that is too narrow leaves torques of the links, which then look like ripple or springs.
    """
    if not len(problem.directions) or problem.data.recording.settings.inertial != "unknown":
        return problem
    terms = _everywhere(problem)

    def of_width(width: float) -> TorqueProblem:
        return replace(problem, precision=problem.precision / width**2)

    widest = of_width(_WIDTHS[-1])
    noise = remaining_noise_model(widest, fit_numbers(widest, terms, options, training=problem.valid), options)
    widest_fit = fit_numbers(widest, terms, options, training=problem.valid, noise=noise)
    time = max(longest_time(widest, widest_fit), 1.0)

    def judged(width: float) -> float:
        candidate = of_width(width)
        return _evidence(candidate, fit_numbers(candidate, terms, options, training=problem.valid, noise=noise), time)

    evidence = {width: judged(width) for width in _WIDTHS[:-1]} | {_WIDTHS[-1]: _evidence(widest, widest_fit, time)}
    threshold = max(evidence.values()) - CLOSE
    likely = max(width for width, log_evidence in evidence.items() if log_evidence > threshold)
    # the grid is coarse, and a prior half as wide as it should be already causes false findings
    wider = [width for width in _WIDTHS if width > likely]
    for width in np.geomspace(likely, wider[0], _BETWEEN + 2)[1:-1] if wider else ():
        if judged(float(width)) <= threshold:
            break
        likely = float(width)
    return of_width(likely)


def _everywhere(problem: TorqueProblem) -> Terms:
    slides = problem.data.arm.slides.tolist()
    return Terms(tuple(kind(j, of_slide=slide) for kind in _EVERYWHERE for j, slide in enumerate(slides, 1)))


def _evidence(problem: TorqueProblem, fitted: Fit, time: float) -> float:
    """The logarithm of the marginal likelihood of a prior's width, in the noise model of the fit.

    What no effect explains yet is not independent from sample to sample. What the noise model leaves of that is: so
    many samples as its autocorrelation `time` says count as one. If each counted, inertial numbers would be taken as
    less certain for what is missing beside them, and would follow it.
    """
    root = np.sqrt(np.where(fitted.training, fitted.residuals.row_weight / time, 0.0))
    columns = np.concatenate(
        [problem.nuisance_columns(fitted.terms, fitted.values), problem.columns(fitted.terms.terms)]
    )
    flat = (fitted.noise.whitened(columns) * root).reshape(len(columns), -1)
    k = len(problem.precision)
    S = schur_complement(flat @ flat.T, np.arange(k, len(columns)))[:k, :k] / np.sqrt(
        np.outer(problem.precision, problem.precision)
    )
    volume = float(np.linalg.slogdet(np.eye(k) + S)[1])
    return fitted.log_likelihood(fitted.scale) / time - 0.5 * volume


# ------------------------------------------------------------------ the diagnosis


_FOLDS = 10
"""Of static postures at least."""


# A second thread gains little on matrices of this size, and costs many times as much where another job has a core.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose_torques(
    recording: Recording,
    arm: Arm | None = None,
    *,
    reference: Recording | None = None,
    effects: Sequence[TorqueEffect] = (),
    options: Options | None = None,
    progress: Callable[[Stage], object] | None = None,
) -> TorqueDiagnosis:
    """Locates, names, models and verifies what makes motor torques depart from the inverse dynamics of the arm.

    Arguments are as of `diagnose`. Effects that raise the error on held-out rows are fitted again without shorter
    blocks. Where they raise it there too, they are withdrawn, and stand in `withdrawn` of the result.

    Raises:
        InputError: no arm is declared; no torques, no times, gaps in most of them, an arm at rest, or another unit;
            or as `compare_rows`.
    """
    alone = partial(_diagnose_alone, effects=effects, options=options or Options(), progress=progress)
    if reference is None:
        return alone(recording, arm)
    arm = arm or declared_arm_of(recording)
    by_rows = compare_rows(recording, reference, with_calibration(arm, recording))
    if by_rows is not None:  # both are of one motion: their difference is diagnosed
        return replace(alone(by_rows.recording, arm), against=by_rows)
    diagnosis = alone(recording, arm)
    return replace(diagnosis, against=compare_effects(diagnosis, alone(reference, arm)))


def _diagnose_alone(
    recording: Recording,
    arm: Arm | None,
    effects: Sequence[TorqueEffect],
    options: Options,
    progress: Callable[[Stage], object] | None,
) -> TorqueDiagnosis:
    """Without a reference; arguments as of `diagnose_torques`."""
    options = options.of(recording.settings)
    with followed(progress):
        arm = with_calibration(arm or declared_arm_of(recording), recording)
        with part(0, 1 + options.folds):
            entered("screening")
            screened = screen_torques(recording, arm)
            unlinearised = with_likely_prior(torque_problem(screened.data, effects), options.engine)
            problem = linearised(unlinearised, options.engine)
            pushed, events = contacts(problem, options.engine)
            problem = replace(problem, valid=problem.valid & ~pushed)
            if pushed.any():
                problem = linearised(problem, options.engine, problem.valid)
            selection = search(problem, options.engine)
            problem = selection.problem
            assert isinstance(problem, TorqueProblem)
            start = selection.start
            entered("estimating")
            selection = replace(selection, state=final_estimates(problem, selection.state, options.engine))
        # postures are few and independent: a model of half of them says little of the rest
        is_static = recording.motion == "static"
        used = int(problem.valid.sum())
        count = fold_count(used, replace(options, folds=max(options.folds, _FOLDS)) if is_static else options)
        blocks = contiguous_blocks(used, count)
        folds = [block[np.maximum(np.cumsum(problem.valid) - 1, 0)] for block in blocks]
        unlinearised = replace(unlinearised, valid=problem.valid)
        errors = errors_of_folds(errors_without, (unlinearised, options, start), folds)

        def refitted(spread: Sequence[Mask]) -> HeldOut:
            return errors_of_folds(errors_without, (unlinearised, options, start, selection.state), spread, False)

        verified = verify(selection, errors, folds, problem.valid, refitted, judge_by_folds)
        if not verified.findings:
            verified = verified._replace(errors=verified.errors.without_effects())
    return TorqueDiagnosis(
        problem=problem,
        faults=(*screened.found, *events),
        ruled_out=screened.ruled_out,
        options=options,
        outliers=~problem.valid,
        **verified._asdict(),
    )


def errors_without(
    held: Mask, problem: TorqueProblem, options: Options, start: Start, state: State | None = None
) -> HeldOut:
    """The errors on the samples of a fold `(sample,)`, by a model of the others, at which the problem is linearised.

    The filter spreads a sample over its neighbours: those beside a held-out block are not used either.

    Args:
        held: the fold.
        problem: not linearised.
        options: thresholds.
        start: terms, of which those are kept that the others support.
        state: whose terms are all fitted to the others, in the place of these.
    """
    training = ~(np.convolve(held, np.ones(3), "same") > 0) & problem.valid
    fold_problem = linearised(problem, options.engine, training)
    if state is None:
        return errors_of_selection(supported(fold_problem, start, options.engine, training), held)
    again = fitted_again(fold_problem, fold_problem, state, training, options.engine)
    return errors_of_selection(Selection(fold_problem, fold_problem, again), held)
