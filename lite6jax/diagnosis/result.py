"""The result of a diagnosis: findings, data faults, errors before and after, verdict, and its document."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from lite6jax.calibration.quality import Quality, quality_of_poses
from lite6jax.diagnosis.discrimination import SeparatingPoses, differ
from lite6jax.diagnosis.document import SCHEMA, Verdict, effect_entry, pose_model_entry
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.uncertainty import uncertainty_of_poses
from lite6jax.domains.pose.kinematics import unwhitened
from lite6jax.domains.pose.predict import DiagnosedArm, ReferenceOrigin
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.domains.uncertainty import freed
from lite6jax.effects.catalogue import Untestable
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.effects.kinematic import JointHarmonic
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.statics import with_mass_errors
from lite6jax.estimation.concentration import Concentration, concentration
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.problem import Mask
from lite6jax.estimation.projection import scaled_solve
from lite6jax.estimation.robust import FREEDOM, gaussian_t_scale, t_scale
from lite6jax.model import ArmModel
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault
from lite6jax.results import PublicResult
from lite6jax.search.scan import Scan
from lite6jax.search.search import Selection
from lite6jax.search.state import Alternative
from lite6jax.sensors.pose import Measured

Array = NDArray[np.floating]
P = TypeVar("P", PoseProblem, TorqueProblem)

STATISTICS: Mapping[str, Callable[[Array], Any]] = {
    "mean": np.mean,
    "rms": lambda size: np.sqrt(np.mean(size**2)),
    "p95": lambda size: np.percentile(size, 95),
    "max": np.max,
}
"""Of errors, none of which is missing."""


@final
@dataclass(frozen=True, eq=False)
class Finding:
    """An effect that was found in the recording.

    Attributes:
        effect: which, and where.
        values: `(coordinate,)`, its numbers.
        covariance: `(coordinate, coordinate)` of these.
        p_value: family-wise, over all that was searched.
        gain: its log evidence, over its absence.
        alternatives: effects that explain nearly as much in its place, the nearest first.
        chosen_std: standard deviation of the number that the search chose for it, an order; zero where it is exact.
        input_share: the share of the variance of its numbers, the greatest of them, that comes from a payload which may
            be wrong without being found so.
    """

    effect: Effect
    values: Array
    covariance: Array
    p_value: float
    gain: float
    alternatives: tuple[Alternative, ...]
    chosen_std: float = 0.0
    input_share: float = 0.0

    @property
    def nearest(self) -> tuple[Effect, float] | None:
        """Of an effect without a name, the likeliest named one, and its share of the evidence; or None."""
        named = [one for one in self.alternatives if not one.term.nonparametric]
        if not self.effect.nonparametric or not named:
            return None
        best = min(named, key=lambda one: one.gap)
        assert isinstance(best.term, Effect)
        return best.term, float(np.clip(1 - best.gap / max(self.gain, 1e-300), 0.0, 1.0))

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

    def to_dict(
        self, size: dict[str, Any], contribution: dict[str, Any], alternatives: list[dict[str, Any]]
    ) -> dict[str, Any]:
        """Codes and numbers.

        Args:
            size: of a nonparametric effect.
            contribution: what it moves.
            alternatives: as they are written.
        """
        nearest = (
            {} if self.nearest is None else {"nearest": effect_entry(self.nearest[0]) | {"share": self.nearest[1]}}
        )
        return {
            **effect_entry(self.effect),
            "parameters": {name: estimate._asdict() for name, estimate in self.parameters.items()},
            **size,
            **nearest,
            **({"payload_share": self.input_share} if self.input_share else {}),
            "p_value": self.p_value,
            "log_likelihood_gain": self.gain,
            **contribution,
            "confusable_with": alternatives,
        }


@final
@dataclass(frozen=True, eq=False)
class Withdrawn:
    """Effects that were significant, and do not hold on rows that were not used.

    RMS errors there, m or Nm, are larger than without them, or several times those on rows that they were fitted to.
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


class Contribution(NamedTuple):
    """What a finding of poses moves, RMS over rows that are no outliers: m, and rad, None where it was not measured."""

    position: float
    orientation: float | None


class Left(NamedTuple):
    """What a model of poses leaves of the residuals, outliers excluded.

    Attributes:
        position: root mean square of held-out position errors per axis over the declared noise; None where that of
            positions is not declared.
        orientation: the same of the fitted orientations; None where none were measured, or their noise is not declared.
        white: whether residuals of neighbouring rows are uncorrelated.
        acts_at: the joint at which most of it acts; None where there is no such.
    """

    position: float | None
    orientation: float | None
    white: bool
    acts_at: Concentration | None = None

    @property
    def over_noise(self) -> float | None:
        """The larger ratio; None where no noise is declared."""
        return max((ratio for ratio in (self.position, self.orientation) if ratio is not None), default=None)


class Against(Protocol):
    """How a recording was compared with a reference."""

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers, with the reference's name as `file`."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class DomainDiagnosis(Generic[P]):
    """What makes a recording depart from the arm's model: effects and data faults, with held-out errors.

    Errors are of positions `(sample,)` in m, or of torques `(joint, sample)` in Nm (N of prismatic joints). What a
    domain does not have is empty.

    Attributes:
        problem: the screened recording as an estimation problem, linearised where its model is.
        selection: the search's result: fits without and with the effects.
        findings: the effects, in the order of their numbers in `fit`.
        before: held-out errors with the nuisance alone.
        after: held-out errors with the effects that a search of the other blocks selects; where that rejected the
            findings and these hold when they are fitted again, with the findings.
        faults: of the data, in the order in which they were corrected.
        ruled_out: faults that were tested for and are not there.
        options: thresholds.
        folds: `(sample,)` bool each, the rows that were held out together for `before` and `after`.
        withdrawn: effects that were not kept, because they do not hold on held-out rows; None where there are none.
        searched_again: errors where the search was repeated; None where `before` and `after` are these.
        against: how the recording was compared with a reference; None where it was not.
        outliers: `(sample,)` bool, outlying rows and rows without joints; statistics of `before` and `after` omit them.
        separating: poses that separate findings from their alternatives.
        turned: `(sample,)` rad each, held-out errors of orientations before and after; None where none were measured.
    """

    problem: P
    selection: Selection
    findings: tuple[Finding, ...]
    before: Array
    after: Array
    faults: tuple[DataFault, ...]
    ruled_out: tuple[DataFault, ...]
    options: Options
    folds: tuple[Mask, ...]
    withdrawn: Withdrawn | None = None
    searched_again: SearchedAgain | None = None
    against: Against | None = None
    outliers: Mask = field(default_factory=lambda: np.zeros(0, bool))
    separating: tuple[SeparatingPoses, ...] = ()
    turned: tuple[Array, Array] | None = None

    @property
    def fit(self) -> Fit:
        """Of the nuisance and all findings."""
        return self.selection.state.fit

    def has(self, effect: Effect) -> bool:
        """Whether this very effect is a finding."""
        return any(finding.effect == effect for finding in self.findings)

    @property
    def untestable(self) -> tuple[Untestable, ...]:
        """Effects that this recording cannot show, and why."""
        return self.problem.untestable

    @property
    def confounded(self) -> tuple[Effect, ...]:
        """Effects that are confounded with the nuisance that is fitted."""
        return tuple(term for term in self.selection.confounded if isinstance(term, Effect))

    @property
    def nearest(self) -> tuple[Effect, float] | None:
        """The most significant effect that is no finding, and its family-wise p-value."""
        if self.selection.nearest is None:
            return None
        term, p_value = self.selection.nearest
        assert isinstance(term, Effect)
        return term, p_value

    @cached_property
    def verdict(self) -> Verdict:
        """By the findings, by what is left of the residuals, and by whether the rows are enough to tell.

        *consistent*: nothing was found, and what is left is noise. *explained*: with the findings it is.
        *partly_explained*: with the findings, more is left. *unnamed*: the largest finding has no name. *unexplained*:
        more is left than noise, and nothing was found. *undetermined*: the rows are too few to tell, or what is left is
        noise, but an effect that is no finding is nearly significant.
        """
        found = bool(self.findings)
        if not found and self._too_few:
            return "undetermined"
        if found and max(self.findings, key=lambda finding: finding.gain).effect.nonparametric:
            return "unnamed"
        if not self._leaves_noise:
            return "partly_explained" if found else "unexplained"
        # What it moves may have gone into numbers of the findings, as the compliance of a joint goes into that of the
        # base where both are loaded alike. One that is significant and yet no finding was refused for a reason of its
        # own; beside effects that were withdrawn, the nearest is that of another model.
        nearest, options = self.selection.nearest, self.options
        if self.withdrawn is None and nearest and options.engine.level <= nearest[1] < options.nearly_significant:
            return "undetermined"
        return "explained" if found else "consistent"

    @property
    def recording(self) -> Recording:
        """As it was screened."""
        raise NotImplementedError

    @property
    def _too_few(self) -> bool:
        """Whether the rows are too few to say anything where nothing was found."""
        return False

    @property
    def _leaves_noise(self) -> bool:
        """Whether what the model leaves is noise."""
        raise NotImplementedError

    def _own_parts(self) -> dict[str, Any]:
        """What of the document only this domain has, or has in another form."""
        raise NotImplementedError

    def to_dict(self) -> dict[str, Any]:
        """The document `lite6jax/diagnosis/2`: codes and numbers in SI units."""
        nearest, again, settings = self.nearest, self.searched_again, self.recording.settings
        shared = {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "heldout_blocks": block_count(self.folds),
            "searched_again": None if again is None else {"blocks": again.blocks, "heldout_ratio": again.ratio},
            "quick": self.options.quick,
            "date": settings.date,
            "instrument": settings.instrument,
            "data_faults": [fault.to_dict() for fault in self.faults],
            "ruled_out": [fault.to_dict() for fault in self.ruled_out],
            "nearest": None
            if nearest is None
            else {"effect": nearest[0].name, "site": nearest[0].site, "p_value": nearest[1]},
            "untestable": [
                {"effect": item.effect.name, "site": item.effect.site, "driver": item.driver.phrase}
                for item in self.untestable
            ],
            "confounded": [effect_entry(effect) for effect in self.confounded],
        }
        against = {} if self.against is None else {"against": self.against.to_dict()}
        return shared | self._own_parts() | against


def block_count(folds: tuple[Mask, ...] | list[Mask]) -> int:
    """How many contiguous blocks of rows these sets have in all."""
    return sum(int(np.sum(np.diff(held.astype(int), prepend=0) > 0)) for held in folds)


@final
class Diagnosis(DomainDiagnosis[PoseProblem], PublicResult):
    """The diagnosis of poses."""

    @property
    def recording(self) -> Recording:
        """As it was screened."""
        return self.problem.recording

    @property
    def left_out(self) -> Mask:
        """`(sample,)`, rows that were not fitted, because a finding does not say what it does there."""
        return self.problem.valid & ~self.fit.training if self.findings else np.zeros(self.problem.samples, bool)

    @property
    def estimated_noise(self) -> float:
        """Standard deviation per axis of position, m, estimated from the residuals."""
        scale = float(self.fit.scale[0])
        if self.problem.floored:  # by less the residuals are not weighed, and what they have is said all the same
            fit, rows = self.fit, self.problem.rows
            squares = fit.residuals.squares[fit.training] * scale**2
            scale = t_scale(squares, rows, FREEDOM) / gaussian_t_scale(rows, FREEDOM)
        return scale * self.problem.noise[0]

    @cached_property
    def moves(self) -> tuple[Contribution, ...]:
        """What each finding moves beyond what the fitted frames and geometry would take up, were it not in the model.

        The displacement is that of the whole model, with the finding less without it. From it the weighted
        least-squares fit of the nuisance beside the other findings, with its prior, is subtracted: an effect that a
        sensor's frame imitates moves a measured pose by much and its residual by little.
        """
        problem, fit, kept = self.problem, self.fit, ~self.outliers
        weight = np.where(fit.training & kept, fit.residuals.row_weight, 0.0)
        whole = problem.residual(fit.nuisance, fit.terms, fit.values)

        def rms(vectors: Array) -> float:
            return float(np.sqrt(np.mean(np.sum(vectors**2, 0)))) if vectors.shape[1] else 0.0

        moves = []
        for k in range(len(fit.terms.terms)):
            others = fit.terms.part(fit.values, [other != k for other in range(len(fit.terms.terms))])
            moved = whole - problem.residual(fit.nuisance, *others)
            nuisance = problem.nuisance_columns(*others)
            if len(nuisance):
                weighted = (nuisance * weight).reshape(len(nuisance), -1)
                H = weighted @ nuisance.reshape(len(nuisance), -1).T + np.diag(problem.precision)
                moved = moved - np.tensordot(scaled_solve(H, weighted @ moved.ravel()), nuisance, 1)
            displaced = unwhitened(moved, problem.measured.whitener)[:, kept]
            moves.append(Contribution(rms(displaced[:3]), rms(displaced[3:]) if problem.rows == 6 else None))
        return tuple(moves)

    @cached_property
    def left(self) -> Left:
        """What the model leaves of the residuals."""
        problem, fit, kept = self.problem, self.fit, ~self.outliers
        position, orientation = None, None
        if problem.declared_noise[0] is not None and kept.any():
            rows = min(problem.rows, 3)
            position = float(np.sqrt(np.mean(self.after[kept] ** 2) / rows) / problem.declared_noise[0])
        if problem.declared_noise[1] is not None and kept.any():
            freedom = max(1 - fit.parameters / max(problem.rows * kept.sum(), 1), 0.1)
            orientation = float(np.sqrt(np.mean(fit.residuals.rows[3:, kept] ** 2) / freedom))
        return Left(position, orientation, fit.noise.white, concentration(problem, fit, self.options.engine))

    @cached_property
    def quality(self) -> Quality:
        """Whether the model with the findings describes the poses, on rows that were not used."""
        problem, fit, kept = self.problem, self.fit, self.problem.valid
        predicted = measured = problem.rigid.frames[-1][:, :3, 3]  # touches have no positions of their own
        if isinstance(problem.measured, Measured):
            measured = np.asarray(problem.measured.position).T
            predicted = measured + problem.position_errors(fit.nuisance, fit.terms, fit.values).T
        reach, noise, over_noise = problem.arm.reach, problem.declared_noise[0], self.left.over_noise
        return quality_of_poses(self.after[kept], measured[kept], predicted[kept], reach, noise, over_noise)

    @cached_property
    def rows_needed(self) -> int:
        """About how many rows would make the nearest effect that is no finding significant, if it is real.

        The evidence of an effect grows with the number of rows.
        """
        least = max(self.options.fewest_rows, self.problem.samples + 1)
        if self.selection.nearest is None:
            return least
        term, p_value = self.selection.nearest
        cost = Scan(self.problem, self.options.engine).cost_of_name(term)
        now, needed = (cost - np.log(max(p, 1e-300)) for p in (p_value, self.options.engine.level))
        return max(int(np.ceil(self.problem.samples * needed / now)), least)

    @cached_property
    def model(self) -> DiagnosedArm:
        """The arm with the effects found, as `read_model` gives it from a file."""
        problem, fit = self.problem, self.fit
        arm, inertia, errors = problem.displaced(fit.nuisance), problem.inertia, problem.mass_errors(fit.nuisance)
        if inertia is not None and errors is not None:
            inertia = with_mass_errors(inertia, errors.links, errors.payload)
        effects, values = self._modelled
        physics = Physics(effects)
        against = None if self.against is None else self.against.to_dict()
        model = DiagnosedArm(
            model=ArmModel(*(np.asarray(part) for part in arm)),  # type: ignore[arg-type]
            values=physics.join(values),
            inertia=inertia,
            joint_limits=problem.arm.joint_limits,
            arm=problem.arm.name,
            physics=physics,
            orientation=problem.rows == 6,
            reference_temperature=problem.recording.settings.reference_temperature_degC,
            motion=problem.recording.motion,
            accelerated=problem.motion.joint_acceleration is not None,
            heldout_rms=(self._errors(0)["heldout_position_rms_m"], self._errors(1)["heldout_position_rms_m"]),
            reference=None if against is None else ReferenceOrigin(against["file"], against["rigid"]),
            sliding=problem.arm.sliding,
        )
        known = uncertainty_of_poses(problem, fit, model, ~self.outliers, self.after, self.folds)
        return replace(model, uncertainty=known)

    @cached_property
    def _modelled(self) -> tuple[tuple[Effect, ...], list[Array]]:
        """The effects of the model: the findings, and what joints do once a turn within their tolerance."""
        effects, values = [f.effect for f in self.findings], [f.values for f in self.findings]
        for j, wave in enumerate(self.problem.once_per_turn(self.fit.nuisance)):
            own = JointHarmonic(j + 1, 1.0)
            if own in effects:
                values[effects.index(own)] = values[effects.index(own)] + wave
            elif wave.any():
                effects.append(own)
                values.append(wave)
        return tuple(effects), values

    @property
    def _covariances(self) -> list[Array]:
        """Of the numbers of each effect of the model."""
        known, ends = self.model.uncertainty, np.cumsum([freed(e).size for e in self.model.physics.effects])
        more = []
        for effect, end in list(zip(self.model.physics.effects, ends, strict=True))[len(self.findings) :]:
            assert known is not None
            own = len(known.sites) + end - effect.size + np.arange(effect.size)
            more.append(known.covariance[np.ix_(own, own)])
        return [finding.covariance for finding in self.findings] + more

    def peak_to_peak(self, k: int) -> Estimate:
        """The range of a nonparametric finding where it was measured, m or rad, and its standard deviation.

        Of each driver the central 96 % count: few samples are beyond.
        """
        finding, at = self.findings[k], self.problem.deflections
        assert isinstance(finding.effect, Unnamed)
        drivers = np.asarray(finding.effect.values_at(at.host_motion, at.loads))
        low, high = np.percentile(drivers, (2, 98), axis=1)[..., None]
        functions = at.basis(finding.effect)[:, ((drivers >= low) & (drivers <= high)).all(0)]
        moved = finding.values @ functions
        apart = functions[:, np.argmax(moved)] - functions[:, np.argmin(moved)]
        variance = float(apart @ finding.covariance @ apart)
        return Estimate(float(apart @ finding.values), float(np.sqrt(max(variance, 0.0))))

    @property
    def _too_few(self) -> bool:
        if self.problem.samples < self.options.fewest_rows:
            return True
        bad = self.quality.verdict == "bad"
        return not self._leaves_noise and not bad and self.rows_needed <= self.options.within_reach

    @property
    def _leaves_noise(self) -> bool:
        # what a model that does not describe the poses leaves is not noise, whether or not noise is declared
        left = self.left
        as_noise = left.white and (left.over_noise or 0.0) <= self.options.as_noise and self.quality.verdict != "bad"
        return as_noise and (not self.findings or left.position is not None)

    def _errors(self, stage: int) -> dict[str, float]:
        """Statistics of the held-out errors before (0) or after (1)."""
        kept, found = ~self.outliers, {}
        turned = None if self.turned is None else self.turned[stage]
        for name, unit, errors in (("position", "m", (self.before, self.after)[stage]), ("orientation", "rad", turned)):
            if errors is not None:
                there = errors[kept] if kept.any() else np.zeros(1)
                found |= {f"heldout_{name}_{key}_{unit}": float(of(there)) for key, of in STATISTICS.items()}
        return found

    def _own_parts(self) -> dict[str, Any]:
        problem, left, withdrawn = self.problem, self.left, self.withdrawn
        faults, outliers, acts_at = list(self.faults), self.outliers & problem.valid, left.acts_at
        if outliers.any():
            faults.append(DataFault("outliers", tuple(problem.recording.row[outliers].tolist())))
        before, after = self._errors(0), self._errors(1)
        heldout = {
            "heldout_rms_before_m": before["heldout_position_rms_m"],
            "heldout_rms_after_m": after["heldout_position_rms_m"],
        }
        return {
            "data_faults": [fault.to_dict() for fault in faults],
            "before": before,
            "after": after,
            "left": {
                "position_over_noise": left.position,
                "orientation_over_noise": left.orientation,
                "white": left.white,
                "acts_at": None
                if acts_at is None
                else {"site": acts_at.site, "share": acts_at.share, "share_of_noise": acts_at.expected},
            },
            "quality": self.quality.to_dict(),
            "withdrawn": None
            if withdrawn is None
            else {
                "effects": [effect_entry(finding.effect) for finding in withdrawn.findings],
                "heldout_position_rms_m": {"before": withdrawn.before, "after": withdrawn.after},
            },
            "rows_needed": self.rows_needed if self.verdict == "undetermined" else None,
            "samples": problem.samples,
            "left_out": problem.recording.row[self.left_out].tolist(),
            "heldout_rows": int((~self.outliers).sum()),
            "pose_source": problem.recording.settings.pose_source,
            "noise": {
                "declared_position_m": problem.declared_noise[0],
                "declared_orientation_rad": problem.declared_noise[1],
                "estimated_position_m": self.estimated_noise,
            },
            "findings": [self._finding(k, heldout) for k in range(len(self.findings))],
            "separating_poses": [
                {"effects": list(item.effects), "joint_position_rad": item.joint_position.tolist()}
                for item in self.separating
            ],
            "nuisance": {
                "numbers": len(problem.frames),
                "parts": list(dict.fromkeys(name for name, _, _ in problem.frames)),
            },
            "model": pose_model_entry(self.model, self._covariances),
        }

    def _finding(self, k: int, heldout: dict[str, float]) -> dict[str, Any]:
        finding, size = self.findings[k], {}
        effect = finding.effect
        if isinstance(effect, Unnamed):
            end = effect.component if effect.unit == "1" else effect.unit
            sizes = {f"peak_to_peak_{end}": self.peak_to_peak(k)._asdict()}
            size = {"peak_to_peak": sizes, "effective_parameters": finding.effective_parameters}
        moves = {"moves_rms_m": self.moves[k].position, "moves_rms_rad": self.moves[k].orientation}
        return finding.to_dict(size, moves | heldout, [self._alternative(k, one) for one in finding.alternatives])

    def _alternative(self, k: int, one: Alternative) -> dict[str, Any]:
        """An alternative with its status: rejected, found, separable by designed poses, undecided, or equivalent."""
        effect, labels = one.term, (self.findings[k].effect.label, one.term.label)
        assert isinstance(effect, Effect)
        if one.gap >= self.options.engine.close:
            status = "rejected"
        elif effect in self.fit.terms.terms:
            status = "found"
        elif any(item.effects == labels for item in self.separating):
            status = "separable"
        elif effect.periodic and labels[0] == labels[1]:
            status = "undecided"  # another order of the same wave
        else:
            status = "undecided" if differ(self.selection, k, effect, self.options) else "equivalent"
        numbers = {key: getattr(effect, key) for key in ("order", "source_joint", "component") if hasattr(effect, key)}
        return {**effect_entry(effect), **numbers, "log_likelihood_gap": one.gap, "status": status}
