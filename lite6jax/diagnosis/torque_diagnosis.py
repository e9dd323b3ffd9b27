"""The diagnosis of torques: screen, filter, search, estimate finally, verify; alone, or relative to a reference.

Its result has what a diagnosis of poses has, some of it in another form.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm, by_kind
from lite6jax.calibration.source import declared_arm_of, with_calibration
from lite6jax.diagnosis.document import effect_entry, torque_model_entry
from lite6jax.diagnosis.estimates import (
    DISAGREE,
    EffectEstimate,
    difference_p_value,
    estimate_effect,
    fit_with_effect,
    side_entry,
)
from lite6jax.diagnosis.heldout import errors_of_folds, fold_count, verify
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import STATISTICS, DomainDiagnosis
from lite6jax.diagnosis.uncertainty import uncertainty_of_torques
from lite6jax.domains.torque.composition import read_driver
from lite6jax.domains.torque.linearisation import linearised, with_likely_prior
from lite6jax.domains.torque.predict import DiagnosedMotors
from lite6jax.domains.torque.problem import FITTED, TorqueProblem, torque_problem
from lite6jax.domains.torque.reference import RowComparison, compare_rows
from lite6jax.domains.torque.screening import contacts, screen_torques
from lite6jax.effects.catalogue import torque_catalogue
from lite6jax.effects.dynamic import TorqueEffect, UnnamedTorque
from lite6jax.effects.effect import Effect, Estimate, slides
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.problem import Mask, Problem
from lite6jax.progress import Stage, entered, followed, part
from lite6jax.recordings import Recording
from lite6jax.recordings.sequence import contiguous_blocks
from lite6jax.results import PublicResult
from lite6jax.search.final_estimates import final_estimates
from lite6jax.search.scan import Considered
from lite6jax.search.search import Selection, search
from lite6jax.search.state import Alternative, fitted_again

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
        """The arm with the effects found, as `read_model` gives it from a file."""
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
            reference=(against["file"], "rows") if against.get("by") == "rows" else None,
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
        chosen = data.recorded
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
        effect, of_slide = finding.effect, problem.data.arm.slides
        columns = problem.columns([effect], finding.values, (fit.terms, fit.values))
        moved = np.tensordot(fit.values[fit.terms.slices[k]], columns, 1) * problem.sigma
        acts = np.abs(moved).max(1) > 0
        where = acts if acts.any() else np.ones_like(acts)
        size: dict[str, Any] = {}
        if isinstance(effect, UnnamedTorque):
            size[effect.own("peak_to_peak_Nm")] = float(np.ptp(moved, axis=1).max())
        contribution: dict[str, Any] = by_kind("moves_rms_Nm", moved[where], of_slide[where], STATISTICS["rms"])
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


# ------------------------------------------------------------------ the diagnosis


_FOLDS = 10
"""Of static postures at least."""
_VISIBLE = 1e-3
"""Size of a torque over that of the most visible one, by unit of a direction of a function's numbers, from which rows
show it."""


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
    return _diagnose_against(recording, reference, arm or declared_arm_of(recording), alone)


@threadpool_limits.wrap(limits=1, user_api="blas")
def _diagnose_alone(
    recording: Recording,
    arm: Arm | None,
    effects: Sequence[TorqueEffect],
    options: Options,
    progress: Callable[[Stage], object] | None,
) -> TorqueDiagnosis:
    """Without a reference; arguments as of `diagnose_torques`."""
    with followed(progress):
        arm = with_calibration(arm or declared_arm_of(recording), recording)
        with part(0, 1 + options.folds):
            entered("screening")
            screened = screen_torques(recording, arm)
            whole = with_likely_prior(torque_problem(screened.data, effects), options.engine)
            problem = linearised(whole, options.engine)
            pushed, events = contacts(problem, options.engine)
            problem = replace(problem, valid=problem.valid & ~pushed)
            problem = linearised(problem, options.engine, problem.valid) if pushed.any() else problem
            selection = search(problem, options.engine)
            problem = selection.problem
            assert isinstance(problem, TorqueProblem)
            entered("estimating")
            selection = replace(selection, state=final_estimates(problem, selection.state, options.engine))
        # postures are few and independent: a model of half of them says little of the rest
        few = recording.motion == "static"
        used = int(problem.valid.sum())
        count = fold_count(used, replace(options, folds=max(options.folds, _FOLDS)) if few else options)
        blocks = contiguous_blocks(used, count)
        folds = [block[np.maximum(np.cumsum(problem.valid) - 1, 0)] for block in blocks]
        whole = replace(whole, valid=problem.valid)
        errors = errors_of_folds(errors_of_search, (whole, options, selection.considered), folds)
        state = selection.state

        def fitted(there: TorqueProblem, training: Mask) -> Selection:
            return Selection(there, there, fitted_again(there, there, state, training, options.engine))

        def refitted(spread: Sequence[Mask]) -> HeldOutTorques:
            return errors_of_folds(_errors_without, (whole, options, fitted), spread, anywhere=False)

        verified = verify(selection, errors, folds, problem.valid, options, refitted)
    return TorqueDiagnosis(
        problem=problem,
        selection=verified.selection,
        findings=verified.findings,
        before=verified.errors.before,
        after=verified.errors.after if verified.findings else verified.errors.before,
        faults=(*screened.found, *events),
        ruled_out=screened.ruled_out,
        options=options,
        folds=tuple(verified.folds),
        withdrawn=verified.withdrawn,
        searched_again=verified.searched_again,
    )


class HeldOutTorques(NamedTuple):
    """Errors on held-out samples, `(joint, sample)` Nm: with the nuisance alone, and with effects too.

    These are what a search of the other samples selects, or are fitted to them.
    """

    before: Array
    after: Array

    def without_effects(self) -> "HeldOutTorques":
        """The errors of the nuisance alone, before and after."""
        return self._replace(after=self.before)

    def rejects(self, selection: Selection, kept: Mask, folds: Sequence[Mask], options: Options) -> bool:
        """Whether the effects of a selection raise the errors on samples that were not used."""
        return self.ratio(selection, kept, folds) > options.heldout_rise

    def ratio(self, selection: Selection, kept: Mask, folds: Sequence[Mask]) -> float:
        """Errors with effects over those without, of the samples `kept`: the mean of the logarithms over folds.

        The variance of errors is unknown and differs between folds, so this is the ratio of likelihoods. No fold
        decides alone, such as one where a curve meets what it was never fitted to.
        """
        problem, ratios = selection.problem, []
        assert isinstance(problem, TorqueProblem)
        for fold in folds:
            held = fold & kept
            if held.any():
                squares = [float(np.sum((each[:, held] / problem.sigma[:, held]) ** 2)) for each in self]
                ratios.append(0.5 * np.log(max(squares[1], 1e-300) / max(squares[0], 1e-300)))
        return float(np.exp(np.mean(ratios)))


def errors_of_search(held: Mask, problem: TorqueProblem, options: Options, among: Considered) -> HeldOutTorques:
    """The errors on the samples of a fold `(sample,)`, with the model that a search of the others selects.

    The problem is not linearised; processes are chosen among `among`.
    """

    def searched(there: TorqueProblem, training: Mask) -> Selection:
        return search(there, options.engine, training, thorough=False, among=among)

    return _errors_without(held, problem, options, searched)


def _errors_without(
    held: Mask, problem: TorqueProblem, options: Options, model: Callable[[TorqueProblem, Mask], Selection]
) -> HeldOutTorques:
    """The errors on the samples of a fold, by a model of the other samples, at which the problem is linearised.

    The filter spreads a sample over its neighbours: those beside a held-out block are not used either.
    """
    near = np.convolve(held, np.ones(3), "same") > 0
    training = ~near & problem.valid
    found = model(linearised(problem, options.engine, training), training)

    def errors(problem: Problem, fit: Fit) -> Array:
        assert isinstance(problem, TorqueProblem)
        return (problem.residual(fit.nuisance, fit.terms, fit.values) * problem.sigma)[:, held]

    return HeldOutTorques(errors(found.reference, found.state.baseline), errors(found.problem, found.state.fit))


# ------------------------------------------------------------------ relative to a reference


@final
@dataclass(frozen=True, eq=False)
class EffectDifference:
    """An effect that one of two recordings shows, as the recording and the reference each show it, or None.

    The p-value of a difference as large is family-wise over all effects compared; None where one is silent.
    """

    effect: TorqueEffect
    here: EffectEstimate | None
    there: EffectEstimate | None
    p_value: float | None

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers."""
        sides = {"recording": side_entry(self.here), "reference": side_entry(self.there)}
        differs = None if self.p_value is None else self.p_value < DISAGREE
        place = {"effect": self.effect.name, "site": self.effect.site}
        if isinstance(self.effect, UnnamedTorque):
            place["driver"] = self.effect.driver
        return {**place, **sides, "p_value": self.p_value, "differs": differs}


@final
@dataclass(frozen=True, eq=False)
class TorqueComparison:
    """How a recording was compared with its reference.

    Of the same motion row by row: then the findings are what the recording has beyond the reference. Of different
    motions effect by effect: then they are those of the recording, beside those of the reference.

    Attributes:
        file: the reference's name.
        rows: the comparison row by row; None where the motions differ.
        effects: the comparison effect by effect; none where the motion is the same.
    """

    file: str
    rows: RowComparison | None
    effects: tuple[EffectDifference, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers in SI units."""
        if self.rows is None:
            return {"file": self.file, "by": "effects", "differences": [each.to_dict() for each in self.effects]}
        return {
            "file": self.file,
            "by": "rows",
            "rows": self.rows.rows,
            "matched_rows": self.rows.matched,
            "apart_rms_by_joint_Nm": self.rows.apart.tolist(),
            "reference_rms_by_joint_Nm": self.rows.from_model.tolist(),
        }


def _diagnose_against(
    recording: Recording, reference: Recording, arm: Arm, alone: Callable[[Recording, Arm], TorqueDiagnosis]
) -> TorqueDiagnosis:
    """The difference of two recordings of one motion, diagnosed; else each alone, and what either shows compared."""
    by_rows = compare_rows(recording, reference, with_calibration(arm, recording))
    if by_rows is not None:
        return replace(alone(by_rows.recording, arm), against=TorqueComparison(by_rows.file, by_rows))
    found, other = alone(recording, arm), alone(reference, arm)
    shown: dict[tuple[object, ...], TorqueEffect] = {}
    for finding in (*found.findings, *other.findings):
        assert isinstance(finding.effect, TorqueEffect)
        shown.setdefault(_function(finding.effect), finding.effect)
    differences = tuple(_difference(effect, found, other, len(shown)) for effect in shown.values())
    return replace(found, against=TorqueComparison(Path(reference.source).name, None, differences))


def _function(effect: Effect) -> tuple[object, ...]:
    """What two findings have in common that are compared: the name, or the driver of a function without one."""
    return (effect.site, effect.drivers) if effect.nonparametric else (effect.label,)


def _difference(
    effect: TorqueEffect, found: TorqueDiagnosis, other: TorqueDiagnosis, compared: int
) -> EffectDifference:
    if isinstance(effect, UnnamedTorque):
        here, there = _curves(effect, found, other)
    else:
        here, there = estimate_effect(found, effect), estimate_effect(other, effect)
    p = None
    if here is not None and there is not None:
        p = min(1.0, compared * difference_p_value(here, there))
    return EffectDifference(effect, here, there, p)


def _curves(
    effect: UnnamedTorque, found: TorqueDiagnosis, other: TorqueDiagnosis
) -> tuple[EffectEstimate | None, EffectEstimate | None]:
    """A function without a name as both results show it: its values on the rows whose drivers both have in range.

    A result that has another function of the same drivers is fitted with this one in its place.
    """
    problem, own, its = found.problem, _driven(found, effect), _driven(other, effect)
    common = np.zeros(problem.samples, bool)
    if own is not None and its is not None:
        low, high = its.min(1, keepdims=True), its.max(1, keepdims=True)
        common = np.all((own >= low) & (own <= high), 0)
    functions = (problem.columns([effect]) * problem.sigma)[:, effect.joint - 1, common].T if common.any() else None
    if functions is None or not functions.any():
        whole = np.eye(effect.size)
        here, there = (_fitted_curve(each, effect, whole) if each.has(effect) else None for each in (found, other))
        return here, there
    # the directions that these rows show, each a root mean square of the torque along it
    _, sizes, V = np.linalg.svd(functions / np.sqrt(common.sum()), full_matrices=False)
    seen = sizes > _VISIBLE * sizes[0]
    along = sizes[seen, None] * V[seen]
    return _fitted_curve(found, effect, along), _fitted_curve(other, effect, along)


def _driven(result: TorqueDiagnosis, effect: UnnamedTorque) -> Array | None:
    """`(driver, sample)` of the rows of a result; None where it does not have all drivers of an effect."""
    data, dynamics = result.problem.data, result.problem.dynamics
    values = [row for driver in effect.drivers if (row := read_driver(driver, dynamics)) is not None]
    if len(values) < len(effect.drivers):
        return None
    return np.stack(values)[:, data.filter.kept][:, result.problem.chosen]


def _fitted_curve(result: TorqueDiagnosis, effect: UnnamedTorque, along: Array) -> EffectEstimate:
    """A function's numbers in a result along some directions `(direction, number)`, with the size of the function."""
    at = result.fit
    if not result.has(effect):
        at = fit_with_effect(result, effect, lambda term: _function(term) == _function(effect))
    numbers = at.terms.slices[at.terms.terms.index(effect)]
    values, covariance = along @ at.values[numbers], along @ at.covariance[numbers, numbers] @ along.T
    size = float(np.sqrt(values @ values))
    std = float(np.sqrt(values @ covariance @ values)) / max(size, 1e-300)
    return EffectEstimate(result.has(effect), values, covariance, {"rms_Nm": Estimate(size, std)})
