"""The diagnosis: screen, explain, estimate finally, verify on held-out rows, design what to record next.

Of a recording that has poses and torques, or torques and commands, both are diagnosed, and what they say of the
quantities that they share.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, TypedDict, Unpack, final, overload

import numpy as np
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.arms.simulator import Simulator, read_simulator
from lite6jax.array_types import Array, Mask
from lite6jax.calibration.problem import Geometry, recording_problem
from lite6jax.calibration.quality import ROUNDING, Quality, quality_of_poses
from lite6jax.calibration.source import arm_of, load_nominal, load_recording, with_arm
from lite6jax.design.candidates import candidates
from lite6jax.design.information import Experiment
from lite6jax.design.poses import plan_discrimination, short_path
from lite6jax.diagnosis.document import require_domain
from lite6jax.diagnosis.estimates import compare_domains
from lite6jax.diagnosis.explanation import Case, explain
from lite6jax.diagnosis.fault_alternative import FaultAlternative
from lite6jax.diagnosis.heldout import (
    errors_of_folds,
    errors_of_supported,
    fold_count,
    held_out_folds,
    judge_poses,
    refitted_errors,
    verify,
)
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import AS_NOISE, STATISTICS, DomainDiagnosis, Finding, SeparatingPoses
from lite6jax.diagnosis.torque_diagnosis import TorqueDiagnosis, diagnose_torques
from lite6jax.diagnosis.tracking_diagnosis import TrackingDiagnosis, diagnose_tracking
from lite6jax.diagnosis.uncertainty import uncertainty_of_poses
from lite6jax.domains.base import DomainName
from lite6jax.domains.pose.entry import model_entry
from lite6jax.domains.pose.kinematics import unwhitened
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.domains.pose.reference import compare
from lite6jax.domains.pose.rigid_arm import require_determined
from lite6jax.domains.pose.screening.screen import screen, screen_rows
from lite6jax.domains.registry import DOMAINS, POSES, TRACKING
from lite6jax.domains.tracking.simulator import naming_the_chain
from lite6jax.effects.composition import Physics, missing
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.effects.kernels import remembers
from lite6jax.effects.kinematic import JointHarmonic
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.statics import with_mass_errors
from lite6jax.effects.user_effects import by_domain, require_effects
from lite6jax.errors import InputError, require_type
from lite6jax.estimation.concentration import Concentration, concentration
from lite6jax.estimation.projection import orthonormal, outside, scaled_solve, unit_rows
from lite6jax.estimation.robust import FREEDOM, gaussian_t_scale, t_scale
from lite6jax.estimation.terms import Terms
from lite6jax.estimation.thresholds import CLOSE, EIGENVALUE_ROUNDING
from lite6jax.model import ArmModel
from lite6jax.progress import Stage, entered, followed, part
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.search.final_estimates import final_estimates
from lite6jax.search.scan import Scan
from lite6jax.search.search import Selection
from lite6jax.sensors.pose import PoseSensor
from lite6jax.sensors.usual import plan_sensor

_OUTLIER_SQUARES = 30.0
"""Squared residual over the scale, per number, beyond which a row is an outlier: 5.5 standard deviations."""
FEWEST_ROWS = 15
"""Rows below which nothing is said where nothing is found: five a fitted frame."""
_WITHIN_REACH = 200
"""Rows that may be asked for where something near was not found: a day's work."""
_SEPARATING_POSES = 12
"""Poses that separate a pair of effects: half an hour of recording."""
_SEPARATING_CANDIDATES = 3000
"""Candidate poses they are chosen from, dense enough for six joints."""
_SEPARATING_MARGIN = 0.035
"""rad from the joint limits that a separating pose keeps: two degrees."""
_SAME_EFFECT = 1e-4
"""Share of an effect that its alternative cannot do, below which both are the same: 1 % of its length."""
Source = Recording | str | Path
Nominal = Arm | str | Path | None


@final
@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(DomainDiagnosis[PoseProblem]):
    """The diagnosis of poses, and beside it that of the torques of the same recording where it has them."""

    domain: ClassVar[DomainName] = "poses"

    @property
    def torques(self) -> TorqueDiagnosis | None:
        """The diagnosis of the torques; None where there are none, or these cannot be diagnosed."""
        of_torques = (diagnosis for diagnosis in self.beside if isinstance(diagnosis, TorqueDiagnosis))
        return next(of_torques, None)

    @property
    def before(self) -> Array:
        """`(sample,)` m, held-out errors of positions with the nuisance alone."""
        return self.errors.before[0]

    @property
    def after(self) -> Array:
        """`(sample,)` m, held-out errors of positions with the effects."""
        return self.errors.after[0]

    @property
    def recording(self) -> Recording:
        """As it was screened; its joint positions contain `model.joint_zero`, which those for `predict` do not."""
        return self.problem.recording

    @property
    def left_out(self) -> Mask:
        """`(sample,)`, rows that were not fitted, because a finding does not say what it does there."""
        if self.findings:
            return self.problem.valid & ~self.fit.training
        return np.zeros(self.problem.samples, bool)

    @property
    def estimated_noise(self) -> float:
        """Standard deviation per axis of position, m, estimated from the residuals."""
        scale = float(self.fit.scale[0])
        if self.problem.floored:  # by less the residuals are not weighed, and what they have is said all the same
            fit = self.fit
            rows = self.problem.rows
            squares = fit.residuals.squares[fit.training] * scale**2
            scale = t_scale(squares, rows, FREEDOM) / gaussian_t_scale(rows, FREEDOM)
        return scale * self.problem.noise[0]

    @cached_property
    def moves(self) -> tuple[dict[str, Any], ...]:
        """What each finding moves beyond what the fitted frames and geometry would take up, were it not in the model.

        The displacement is that of the whole model, with the finding less without it. From it the weighted
        least-squares fit of the nuisance beside the other findings, with its prior, is subtracted: an effect that a
        sensor's frame imitates moves a measured pose by much and its residual by little.
        """
        problem = self.problem
        fit = self.fit
        inliers = ~self.outliers
        weight = np.where(fit.training & inliers, fit.residuals.row_weight, 0.0)
        full_residual = problem.residual(fit.nuisance, fit.terms, fit.values)

        def rms(vectors: Array) -> float:
            if vectors.shape[1]:
                return float(np.sqrt(np.mean(np.sum(vectors**2, 0))))
            return 0.0

        moves = []
        for k in range(len(fit.terms.terms)):
            reduced_model = fit.terms.part(fit.values, [index != k for index in range(len(fit.terms.terms))])
            moved = full_residual - problem.residual(fit.nuisance, *reduced_model)
            nuisance = problem.nuisance_columns(*reduced_model)
            if len(nuisance):
                weighted = (nuisance * weight).reshape(len(nuisance), -1)
                H = weighted @ nuisance.reshape(len(nuisance), -1).T + np.diag(problem.precision)
                moved = moved - np.tensordot(scaled_solve(H, weighted @ moved.ravel()), nuisance, 1)
            displaced = unwhitened(moved, problem.measured.whitener)[:, inliers]
            turned = {}
            if problem.rows == 6:
                turned = {"moves_rms_rad": rms(displaced[3:])}
            moves.append({"moves_rms_m": rms(displaced[:3]), **turned})
        return tuple(moves)

    @cached_property
    def over_noise(self) -> dict[str, float | None]:
        """Held-out errors over the noise: positions per axis, and orientations as they are fitted, where measured.

        Where read-outs wander, positions are as they are fitted too: how far read-outs are off in held-out rows is not
        known from the others. Where they err anew in each row, that is not known to be noise.
        """
        problem = self.problem
        fit = self.fit
        inliers = ~self.outliers
        position = orientation = None
        freedom = max(1 - fit.parameters / max(problem.rows * inliers.sum(), 1), 0.1)
        if problem.declared_noise[0] is not None and inliers.any():
            rows = min(problem.rows, 3)
            squares = self.after**2
            if problem.wandering and all(remembers(effect.rolloff, problem.samples) for effect in problem.wandering):
                lengths, _ = problem.errors(fit.nuisance, fit.terms, fit.values)
                squares = lengths[0] ** 2 / freedom
            position = float(np.sqrt(np.mean(squares[inliers]) / rows) / problem.declared_noise[0])
        if problem.declared_noise[1] is not None and inliers.any():
            orientation = float(np.sqrt(np.mean(fit.residuals.rows[3:, inliers] ** 2) / freedom))
        return {"position": position, "orientation": orientation}

    @cached_property
    def acts_at(self) -> Concentration | None:
        """The joint at which most of what is left acts; None where there is no such."""
        return concentration(self.problem, self.fit, self.options.engine)

    @cached_property
    def quality(self) -> Quality:
        """Judgement whether the model with the findings describes the poses, on rows that were not used."""
        problem = self.problem
        fit = self.fit
        valid = self.problem.valid
        predicted = measured = problem.rigid.frames[-1][:, :3, 3]  # touches have no positions of their own
        if problem.measured.reads_poses:
            assert isinstance(problem.measured, PoseSensor)
            measured = np.asarray(problem.measured.position).T
            predicted = measured + problem.position_errors(fit.nuisance, fit.terms, fit.values).T
        reach = problem.arm.reach
        noise = problem.declared_noise[0]
        over_noise = self.most_over_noise
        return quality_of_poses(self.after[valid], measured[valid], predicted[valid], reach, noise, over_noise)

    @cached_property
    def rows_needed(self) -> int:
        """About how many rows would make the nearest effect that is no finding significant, if it is real.

        The evidence of an effect grows with the number of rows.
        """
        minimum_rows = max(FEWEST_ROWS, self.problem.samples + 1)
        if self.selection.nearest is None:
            return minimum_rows
        term, p_value = self.selection.nearest
        cost = Scan(self.problem, self.options.engine).cost_of_name(term)
        now, needed = (cost - np.log(max(p, 1e-300)) for p in (p_value, self.options.engine.level))
        return max(int(np.ceil(self.problem.samples * needed / now)), minimum_rows)

    @cached_property
    def model(self) -> DiagnosedArm:
        """The arm with the effects found, as `read_model` gives it from a file."""
        problem = self.problem
        fit = self.fit
        arm = problem.displaced(fit.nuisance)
        inertia = problem.inertia
        errors = problem.mass_errors(fit.nuisance)
        if inertia is not None and errors is not None:
            inertia = with_mass_errors(inertia, errors.links, errors.payload)
        effects, values = self._modelled
        physics = Physics(effects)
        stages = (
            self._statistics(stage_errors, ~self.outliers) for stage_errors in (self.errors.before, self.errors.after)
        )
        before, after = (statistics["heldout_position_rms_m"] for statistics in stages)
        model = DiagnosedArm(
            model=ArmModel(*(np.asarray(part) for part in arm)),  # type: ignore[arg-type]
            values=physics.join(values),
            inertia=inertia,
            joint_limits=problem.arm.joint_limits,
            joint_zero=self._joint_zero,
            arm=problem.arm.name,
            physics=physics,
            orientation=problem.rows == 6,
            reference_temperature=problem.recording.settings.reference_temperature_degC,
            motion=problem.recording.motion,
            accelerated=problem.motion.joint_acceleration is not None,
            heldout_rms=(before, after),
            reference=self._reference,
            sliding=problem.arm.sliding,
        )
        pose_uncertainty = uncertainty_of_poses(problem, fit, model, ~self.outliers, self.after, self.folds)
        return replace(model, uncertainty=pose_uncertainty)

    @property
    def _joint_zero(self) -> Array:
        """`(joint,)` rad, what was added to recorded joint positions, in all rows, because their zeros are off."""
        zero = np.zeros(self.problem.arm.dof)
        for fault in self.faults:
            if fault.code == "joint_turns" and "added_rad" in fault.numbers:
                zero[fault.numbers["joint"] - 1] += fault.numbers["added_rad"]
        return zero

    @cached_property
    def _modelled(self) -> tuple[tuple[Effect, ...], list[Array]]:
        """The effects of the model: the findings, and what joints do once a turn within their tolerance."""
        effects = [f.effect for f in self.findings]
        values = [f.values for f in self.findings]
        for j, wave in enumerate(self.problem.once_per_turn(self.fit.nuisance)):
            harmonic = JointHarmonic(j + 1, 1.0)
            if harmonic in effects:
                values[effects.index(harmonic)] = values[effects.index(harmonic)] + wave
            elif wave.any():
                effects.append(harmonic)
                values.append(wave)
        return tuple(effects), values

    @property
    def _covariances(self) -> list[Array]:
        """Covariances of the numbers of each effect of the model, the last of which are no findings."""
        uncertainty = self.model.uncertainty
        more = Terms(self.model.physics.effects[len(self.findings) :])
        assert uncertainty is not None
        start = len(uncertainty.covariance) - more.size
        C = uncertainty.covariance[start:, start:]
        return [*(finding.larger_covariance for finding in self.findings), *(C[part, part] for part in more.slices)]

    def _peak_to_peak(self, k: int) -> dict[str, Estimate]:
        """The range of a nonparametric finding where it was measured, m or rad, and its standard deviation.

        Of each driver the central 96 % count: few samples are beyond.
        """
        finding = self.findings[k]
        at = self.problem.deflections
        assert isinstance(finding.effect, Unnamed)
        drivers = np.asarray(finding.effect.values_at(at.host_motion, at.loads))
        low, high = np.percentile(drivers, (2, 98), axis=1)[..., None]
        functions = at.basis(finding.effect)[:, ((drivers >= low) & (drivers <= high)).all(0)]
        moved = finding.values @ functions
        apart = functions[:, np.argmax(moved)] - functions[:, np.argmin(moved)]
        variance = float(apart @ finding.covariance @ apart)
        size = Estimate(float(apart @ finding.values), float(np.sqrt(max(variance, 0.0))))
        end = finding.effect.component if finding.effect.unit == "1" else finding.effect.unit
        return {f"peak_to_peak_{end}": size}

    def _finding(self, k: int) -> dict[str, Any]:
        return {**super()._finding(k), **self._wandering(self.findings[k].effect)}

    def _wandering(self, effect: Effect) -> dict[str, Any]:
        if not (isinstance(effect, Unnamed) and effect.covariance.undriven):
            return {}
        memory = self.problem.memory_of(effect)
        return {"wanders": {"memory_samples": memory.samples, "memory_s": memory.seconds}}

    @property
    def _too_few(self) -> bool:
        if self.problem.samples < FEWEST_ROWS:
            return True
        bad = self.quality.verdict == "bad"
        return not self._leaves_noise and not bad and self.rows_needed <= _WITHIN_REACH

    @property
    def _leaves_noise(self) -> bool:
        # what a model that does not describe the poses leaves is not noise, whether or not noise is declared
        if not self.fit.noise.white or (self.most_over_noise or 0.0) > AS_NOISE:
            return False
        return self.quality.verdict != "bad" and (not self.findings or self.over_noise["position"] is not None)

    @property
    def _noise(self) -> tuple[dict[str, Any], dict[str, Any]]:
        position, orientation = self.problem.declared_noise
        turned = {}
        if self.problem.rows == 6:
            turned = {"orientation_rad": orientation}
        return {"position_m": position, **turned}, {"position_m": self.estimated_noise}

    def _statistics(self, errors: Array, kept: Mask) -> dict[str, Any]:
        statistics: dict[str, Any] = {}
        groups = (("position", "m"), ("orientation", "rad"))[: 2 if self.problem.rows == 6 else 1]
        for (name, unit), sizes in zip(groups, errors, strict=False):
            inlier_errors = sizes[kept] if kept.any() else np.zeros(1)
            statistics |= {f"heldout_{name}_{key}_{unit}": float(of(inlier_errors)) for key, of in STATISTICS.items()}
        return statistics

    def _distinction(self, k: int, effect: Effect) -> str:
        labels = (self.findings[k].effect.label, effect.label)
        if any(item.effects == labels for item in self.separating):
            return "separable"
        if effect.periodic and labels[0] == labels[1]:
            return "undecided"  # another order of the same wave
        if isinstance(effect, Unnamed) and effect.covariance.undriven:
            return "undecided"  # its functions span any sequence of samples, which the same poses in another order show
        if _differ(self.selection, k, effect):
            return "undecided"
        return "equivalent"

    def _own_parts(self) -> dict[str, Any]:
        problem = self.problem
        nuisance: dict[str, Any] = {
            "numbers": len(problem.frames),
            "parts": list(dict.fromkeys(at[0] for at in problem.frames)),
        }
        if problem.recording.stations:
            nuisance["stations"] = len(problem.recording.stations) + 1
        return {
            "quality": self.quality.to_dict(),
            "rows_needed": self.rows_needed if self.verdict == "undetermined" else None,
            "left_out": problem.recording.row[self.left_out].tolist(),
            "nuisance": nuisance,
            "model": model_entry(self.model, self._covariances),
        }


# ------------------------------------------------------------------ the diagnosis of poses


# A second thread gains little on matrices of this size, and costs many times as much where another job has a core.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose_poses(
    recording: Recording,
    arm: Arm | None = None,
    *,
    reference: Recording | None = None,
    geometry: Geometry = "declared",
    effects: Sequence[Effect] = (),
    factory: FactoryCalibration | None = None,
    options: Options | None = None,
    progress: Callable[[Stage], object] | None = None,
) -> Diagnosis:
    """Locates, names, models and verifies what makes poses depart from the arm's model; arguments as of `diagnose`.

    Raises:
        InputError: no measured poses, too few of them, or as `fit` and `compare`.
    """
    if reference is not None:
        comparison = compare(recording, reference, arm, geometry)
        arguments: dict[str, Any] = {"geometry": comparison.geometry, "factory": comparison.factory, "effects": effects}
        diagnosis = diagnose_poses(comparison.recording, arm, **arguments, options=options, progress=progress)
        return replace(diagnosis, against=comparison)
    options = (options or Options()).of(recording.settings)
    with followed(progress):
        if arm is None:
            recording = with_arm(recording)
        rows = screen_rows(recording, arm)
        # what cannot be read at all ends here, before any process has begun
        begun = screen(rows.recording, arm, geometry, options.prior, factory=factory, coarse=True)
        require_determined(begun.rigid_arm)
        case = Case(rows.recording, arm, geometry, options, tuple(effects), factory)
        with part(0, 1 + fold_count(rows.recording.samples, options)):
            explanation = explain(case)
            selection = explanation.selection
            entered("estimating")
            selection = replace(selection, state=final_estimates(explanation.problem, selection.state, options.engine))
        folds = held_out_folds(explanation.problem, options)
        of_all = selection
        if selection.state.tested or explanation.screened.found:
            errors = errors_of_folds(errors_of_supported, (case, explanation.final_decisions), folds)
        else:  # no terms that other rows might not support
            errors = refitted_errors(selection, folds, options)
        inliers = ~_outliers(of_all)
        verified = verify(
            of_all,
            errors,
            folds,
            inliers,
            lambda spread: refitted_errors(of_all, spread, options),
            judge_poses,
        )
        selection = verified.selection
        with part(len(verified.folds) + 1, len(verified.folds) + 1):
            entered("planning")
            separating = _separating_poses(selection, geometry, factory, options)
    problem = selection.problem
    assert isinstance(problem, PoseProblem)
    ruled_out: dict[str, DataFault] = {}
    for fault in (*rows.ruled_out, *explanation.screened.ruled_out):
        if fault.code not in {corrected.code for corrected in rows.found}:  # for which the corrected rows are screened
            ruled_out.setdefault(fault.code, fault)
    findings = tuple(_with_faults(finding, explanation.alternatives) for finding in verified.findings)
    for alternative in (alternative for finding in findings for alternative in finding.faults):
        ruled_out.pop(alternative.fault.code, None)
    faults = (*rows.found, *explanation.screened.found)
    if not problem.valid.all():  # joints were not recorded at the instant of the pose
        without_joints = row_numbers(problem.recording.row[~problem.valid])
        faults = (*faults, DataFault("no_joints", without_joints, {"clock_offset_s": problem.clock_offset}))
    return Diagnosis(
        problem=problem,
        faults=faults,
        ruled_out=tuple(ruled_out.values()),
        options=options,
        outliers=_outliers(selection),
        separating=separating,
        **verified._replace(findings=findings)._asdict(),
    )


def _with_faults(finding: Finding, alternatives: Sequence[FaultAlternative]) -> Finding:
    """The finding with the faults that may be there in its place."""
    return replace(finding, faults=tuple(fault for fault in alternatives if fault.replaces(finding.effect)))


def _outliers(selection: Selection) -> Mask:
    """`(sample,)`, rows that are far from the model, and rows without joints.

    A residual within the declared noise, or within the rounding of a file, is none, however small the others are.
    """
    problem = selection.problem
    residuals = selection.state.fit.residuals
    assert isinstance(problem, PoseProblem)
    error_floor = ROUNDING if (declared := problem.declared_noise[0]) is None else declared
    far = residuals.squares > _OUTLIER_SQUARES * problem.rows
    return far & (np.sum(residuals.rows**2, 0) > (error_floor / problem.noise[0]) ** 2) | ~problem.valid


# ------------------------------------------------------------------ what to record next


def _separating_poses(
    selection: Selection, geometry: Geometry, factory: FactoryCalibration | None, options: Options
) -> tuple[SeparatingPoses, ...]:
    """Poses for each pair of effects that the recording does not distinguish, where poses at rest can.

    Nonparametric effects are no rivals here: what they are elsewhere is not known. Neither are other orders of the same
    wave: any position between those that were recorded separates them.
    """
    state = selection.state
    problem = selection.problem
    assert isinstance(problem, PoseProblem)
    if problem.recording.touches is not None:  # which poses a socket or a plate can be touched at is not known
        return ()
    pairs = [
        (k, alternative.term)
        for k, tested in enumerate(state.tested)
        for alternative in tested.alternatives
        if alternative.gap < CLOSE
        and isinstance(alternative.term, Effect)
        and not alternative.term.nonparametric
        and not (alternative.term.periodic and alternative.term.label == tested.term.label)
        and alternative.term not in state.fit.terms.terms
        and _differ(selection, k, alternative.term)
    ][: options.most_separated]
    if not pairs:
        return ()
    rigid = recording_problem(problem.recording, problem.arm, geometry, factory)
    position, orientation = problem.noise
    sensor = plan_sensor("position" if orientation is None else "pose", position, orientation)
    experiment = Experiment(problem.arm, rigid.form, rigid.start, sensor, rigid.movable, rigid.precision)
    drawn = candidates(problem.arm, _SEPARATING_CANDIDATES, limit_margin=_SEPARATING_MARGIN)
    recorded = problem.recording.joint_position
    count = _SEPARATING_POSES
    separating_poses = []
    for k, rival in pairs:
        effect = state.tested[k].term
        values = state.fit.values[state.fit.terms.slices[k]]
        assert isinstance(effect, Effect)
        pair = (effect, values), rival
        try:
            chosen = plan_discrimination(experiment, pair, drawn.joint_position, count, recorded=recorded)
        except InputError:  # the effects depend on time, temperature or velocity, which poses at rest do not vary
            continue
        q = chosen.joint_position
        separating_poses.append(SeparatingPoses((effect.label, rival.label), q[short_path(q)]))
    return tuple(separating_poses)


def _differ(selection: Selection, k: int, rival: Effect) -> bool:
    """Tells whether columns of the k-th finding and a rival differ: a link may turn about the next joint's axis."""
    problem = selection.problem
    fit = selection.state.fit
    assert isinstance(problem, PoseProblem)
    if missing(rival, problem.motion, problem.inertia is not None) is not None:
        return True
    part = fit.terms.slices[k]
    columns = problem.columns(fit.terms.terms, fit.values)[part]
    effect = np.tensordot(fit.values[part], columns, 1).reshape(1, -1)
    beside = problem.columns([rival], beside=(fit.terms, fit.values))
    span = np.concatenate([beside, problem.nuisance_columns(fit.terms, fit.values)]).reshape(-1, effect.size)
    remainder = outside(effect, orthonormal(unit_rows(span), EIGENVALUE_ROUNDING))
    return bool(np.sum(remainder**2) > _SAME_EFFECT * np.sum(effect**2))


# ------------------------------------------------------------------ of one domain, or of several


def domains_of(recording: Recording, domain: DomainName | None = None) -> tuple[DomainName, ...]:
    """The domains of a recording that are diagnosed, of all or of the one that is asked for.

    Commands are diagnosed where no poses were measured, or where they are asked for.

    Raises:
        InputError: no such domain; or one is asked for that was not recorded, where another but no poses was.
    """
    require_domain(domain)
    recorded = [candidate for candidate in DOMAINS.values() if candidate.is_recorded(recording)]
    if domain is None:
        names = {candidate.name for candidate in recorded}
        chosen = [candidate.name for candidate in recorded if names.isdisjoint(candidate.gives_way_to)]
        return tuple(chosen) or (POSES.name,)
    requested = DOMAINS[domain]
    if requested.words.absent and requested not in recorded:
        raise InputError(f"{recording.source}: {requested.words.absent}")
    if requested not in recorded and recorded and POSES not in recorded:
        option = f"--{domain} or domain={domain!r}"
        raise InputError(f"{recording.source}: has {recorded[0].words.measured} and no {domain}; leave {option} out")
    return (domain,)


@dataclass(frozen=True)
class _Request:
    """What `diagnose` was asked for, with its files read; names are those of its arguments."""

    recording: Recording
    arm: Arm | None
    reference: Recording | None
    simulator: Simulator | None
    geometry: Geometry
    effects: tuple[Effect, ...]
    factory: FactoryCalibration | None
    options: Options | None
    progress: Callable[[Stage], object] | None

    @property
    def particular(self) -> list[str]:
        """The arguments that not every domain takes, which were given."""
        is_given = {
            "reference": self.reference is not None,
            "simulator": self.simulator is not None,
            "geometry": self.geometry != "declared",
            "effects": bool(self.effects),
            "factory": self.factory is not None,
        }
        return [name for name, given in is_given.items() if given]


def _poses(request: _Request) -> Diagnosis:
    return diagnose_poses(
        request.recording,
        request.arm,
        reference=request.reference,
        geometry=request.geometry,
        effects=by_domain(request.effects)[0],
        factory=request.factory,
        options=request.options,
        progress=request.progress,
    )


def _torques(request: _Request) -> TorqueDiagnosis:
    return diagnose_torques(
        request.recording,
        request.arm,
        reference=request.reference,
        effects=by_domain(request.effects)[1],
        options=request.options,
        progress=request.progress,
    )


def _commands(request: _Request) -> TrackingDiagnosis:
    return diagnose_tracking(
        request.recording,
        request.arm,
        simulator=request.simulator,
        options=request.options,
        progress=request.progress,
    )


class Diagnoser(NamedTuple):
    """How a recording is diagnosed by one domain.

    Attributes:
        diagnosed: the diagnosis of a request.
        takes: the arguments of `diagnose` that not every domain takes, and this one does.
    """

    diagnosed: Callable[[_Request], DomainDiagnosis[Any]]
    takes: frozenset[str]


DIAGNOSERS: dict[DomainName, Diagnoser] = {
    "poses": Diagnoser(_poses, frozenset({"reference", "geometry", "effects", "factory"})),
    "torques": Diagnoser(_torques, frozenset({"reference", "effects"})),
    "tracking": Diagnoser(_commands, frozenset({"simulator"})),
}
"""The diagnoser of each domain; a new domain needs an entry here and in `DOMAINS`. "tracking" is that of commands."""


def _require_taken(request: _Request, domains: Sequence[DomainName]) -> None:
    """Refuses an argument that none of the domains takes."""
    measured = " and ".join(DOMAINS[domain].words.measured for domain in domains)
    taken = frozenset[str]().union(*(DIAGNOSERS[domain].takes for domain in domains))
    for argument in request.particular:
        if argument not in taken:
            source = request.recording.source
            raise InputError(f"{argument}: is not of {measured}, by which {source} is diagnosed; leave it out")


def _requests(request: _Request, domains: Sequence[DomainName]) -> dict[DomainName, _Request]:
    """The request of each domain: of several each has the reference only where that holds what it measures.

    One that holds nothing of any is left to the first domain, which refuses it.
    """
    reference = request.reference
    if reference is None or len(domains) == 1:
        return dict.fromkeys(domains, request)
    takers = [domain for domain in domains if DOMAINS[domain].is_recorded(reference)] or domains[:1]
    return dict.fromkeys(domains, replace(request, reference=None)) | dict.fromkeys(takers, request)


class _Given(TypedDict, total=False):
    """The other arguments of `diagnose`, for type checkers."""

    reference: Source | None
    simulator: Simulator | str | Path | None
    geometry: Geometry
    effects: Sequence[Effect]
    factory: FactoryCalibration | None
    options: Options | None
    progress: Callable[[Stage], object] | None


@overload
def diagnose(
    recording: Source, arm: Nominal = None, *, domain: Literal["poses"], **given: Unpack[_Given]
) -> Diagnosis: ...
@overload
def diagnose(
    recording: Source, arm: Nominal = None, *, domain: Literal["torques"], **given: Unpack[_Given]
) -> TorqueDiagnosis: ...
@overload
def diagnose(
    recording: Source, arm: Nominal = None, *, domain: Literal["tracking"], **given: Unpack[_Given]
) -> TrackingDiagnosis: ...
@overload
def diagnose(
    recording: Source, arm: Nominal = None, *, domain: DomainName | None = None, **given: Unpack[_Given]
) -> Diagnosis | TorqueDiagnosis | TrackingDiagnosis: ...
def diagnose(
    recording: Source,
    arm: Nominal = None,
    *,
    domain: DomainName | None = None,
    reference: Source | None = None,
    simulator: Simulator | str | Path | None = None,
    geometry: Geometry = "declared",
    effects: Sequence[Effect] = (),
    factory: FactoryCalibration | None = None,
    options: Options | None = None,
    progress: Callable[[Stage], object] | None = None,
) -> DomainDiagnosis[Any]:
    """Locates, names, models and verifies what makes a recording depart from the arm's model: effects and data faults.

    A recording of poses and torques, or of torques and commands, is diagnosed by both, and what they say of quantities
    on which both depend is compared: the result is that of the poses, or of the torques, with the other in `beside`.
    What cannot be diagnosed beside it (torques of an arm at rest, or without inertia) is left out, with the reason in
    `refused`. A log of commands and measured joints alone is diagnosed by rollouts from its commands.

    Args:
        recording: measured poses, or torques or currents with times, in SI units, or both; or the path of its file. Of
            torques of static postures gravity alone is compared: offsets, scales, masses, centres of mass, payload and
            tilt. Or commands beside measured joints, with times.
        arm: the nominal arm, a bundled name or a file; from the sidecar, or of poses recognised, where not given. Of
            torques its chain is that of the factory calibration, where the sidecar declares one.
        domain: what of the recording is diagnosed: "poses", "torques" or "tracking"; where not given all that was
            recorded, but commands only where there are no poses; with a simulator the commands.
        reference: another recording, or the path of its file, with which each domain that it has is compared: poses at
            the same joint positions; or torques, of which in the same motion the difference is diagnosed, and in
            another what either shows is compared. `against` of the result, and of those `beside`, is the comparison.
        simulator: an MJCF file with position actuators, of commands only: its arm and servos are the nominal ones, and
            what MuJoCo makes of the commands is compared with the log. `model.xml#tip` names a chain of several.
            Or what `read_simulator` makes of it.
        geometry: what is known of it, as in `fit`; of poses only.
        effects: a user's own candidates for poses or torques, tested like the catalogue's; those of a domain that is
            not diagnosed are not used. Commands take none.
        factory: the arm's calibration; from the sidecar where not given; of poses.
        options: thresholds; the documented ones where not given.
        progress: called as each stage begins: of all rows (part 0), and of those without each held-out block; of the
            first domain, and then of the others.

    Effects that raise the error on rows that were not used, or of poses leave several times as much there as in those
    that they were fitted to, are not kept, unless they hold in shorter blocks without which they are fitted again: they
    are in `withdrawn` of the result.

    Raises:
        InputError: nothing of the domain was recorded, or too little, or as `fit` and `compare`; of torques no arm is
            declared, no times, gaps in most of them, an arm at rest, or another unit; or an argument that is of another
            domain than those that are diagnosed.
    """
    simulated = None
    if simulator is None:
        arm = load_nominal(arm)
        recording = load_recording(recording, arm)
    else:
        if arm is not None:
            raise InputError("simulator: is the nominal arm as well; leave the arm out")
        simulated = simulator if isinstance(simulator, Simulator) else read_simulator(simulator)
        with naming_the_chain(simulated):
            recording = load_recording(recording, simulated.arm)
        if TRACKING.is_recorded(recording):
            domain = domain or TRACKING.name
    require_effects(effects)
    require_type("options", options, Options | None, "lite6jax.Options(…)")
    domains = domains_of(recording, domain)
    if POSES.name in domains and domains != (POSES.name,):
        arm = arm or arm_of(recording)  # the same for all
    reference_recording = None if reference is None else load_recording(reference, arm)
    request = _Request(
        recording, arm, reference_recording, simulated, geometry, tuple(effects), factory, options, progress
    )
    _require_taken(request, domains)
    first = domains[0]
    requests = _requests(request, domains)
    diagnosis = DIAGNOSERS[first].diagnosed(requests[first])
    beside = []
    refused = {}
    for name in domains[1:]:
        try:
            beside.append(DIAGNOSERS[name].diagnosed(requests[name]))
        except InputError as error:
            refused[name] = str(error)
    shared = [agreement for other in beside for agreement in compare_domains(diagnosis, other)]
    return replace(diagnosis, beside=tuple(beside), shared=tuple(shared), refused=refused)
