"""The result of a diagnosis: findings, data faults, errors before and after, verdict, and its document."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar, final

import numpy as np
from scipy.linalg import block_diag

from lite6jax.array_types import Array, Mask
from lite6jax.diagnosis.agreement import Agreement
from lite6jax.diagnosis.document import SCHEMA, Verdict
from lite6jax.diagnosis.fault_alternative import FaultAlternative
from lite6jax.diagnosis.options import Options
from lite6jax.domains.base import DomainName, DomainProblem
from lite6jax.domains.entries import effect_entry
from lite6jax.domains.registry import DOMAINS
from lite6jax.domains.uncertainty import ReferenceOrigin
from lite6jax.effects.catalogue import Untestable
from lite6jax.effects.effect import Effect, Estimate
from lite6jax.estimation.concentration import Concentration
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.thresholds import CLOSE
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault
from lite6jax.results import PublicResult
from lite6jax.search.search import Selection
from lite6jax.search.state import Alternative

P = TypeVar("P", bound=DomainProblem)

AS_NOISE = 1.2
"""Error over the declared noise up to which what is left is noise: the scatter of 30 rows."""
NEARLY_SIGNIFICANT = 0.05
"""Family-wise p-value of an effect that is no finding, below which it is not said that nothing else is missing.

It is the usual level of a single test.
"""

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
        block_std: `(coordinate,)`, standard deviations of its numbers from their scatter between blocks of the
            recording, and after them that of the chosen one where it has a standard deviation; empty where not known.
        faults: of the data, that explain nearly as much in its place.
    """

    effect: Effect
    values: Array
    covariance: Array
    p_value: float
    gain: float
    alternatives: tuple[Alternative, ...]
    chosen_std: float = 0.0
    input_share: float = 0.0
    block_std: Array = field(default_factory=lambda: np.zeros(0))
    faults: tuple[FaultAlternative, ...] = ()

    @property
    def name(self) -> str:
        """The name of its effect in the catalogue, such as `joint_compliance`."""
        return self.effect.name

    @property
    def site(self) -> str:
        """Where it acts, such as `joint2`."""
        return self.effect.site

    @property
    def nearest(self) -> tuple[Effect, float] | None:
        """The likeliest named effect in place of one without a name, and its share of the evidence; or None."""
        named_alternatives = [alternative for alternative in self.alternatives if not alternative.term.nonparametric]
        if not self.effect.nonparametric or not named_alternatives:
            return None
        closest = min(named_alternatives, key=lambda alternative: alternative.gap)
        assert isinstance(closest.term, Effect)
        return closest.term, float(np.clip(1 - closest.gap / max(self.gain, 1e-300), 0.0, 1.0))

    @property
    def effective_parameters(self) -> float:
        """How many of its numbers the data determine; fewer than there are, where these have a prior."""
        spread = np.array([coordinate.spread for coordinate in self.effect.coordinates])
        return float(len(spread) - np.sum(np.diagonal(self.covariance) / spread**2))

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Value and standard deviation of each parameter, by name with its unit.

        The standard deviation of each number is the larger one, of the fit or of blocks of the recording.
        """
        return self._reported(self._whole_covariance(larger=True))

    @property
    def fit_std(self) -> dict[str, float]:
        """Standard deviations by the fit alone, of parameters whose blocks scatter by more; by name with its unit."""
        by_fit = self._reported(self._whole_covariance(larger=False))
        larger = self.parameters
        return {name: estimate.std for name, estimate in by_fit.items() if larger[name].std > estimate.std}

    @property
    def larger_covariance(self) -> Array:
        """`(coordinate, coordinate)`, with the larger standard deviation of each, and the correlations of the fit."""
        count = len(self.values)
        return self._whole_covariance(larger=True)[:count, :count]

    def _whole_covariance(self, larger: bool) -> Array:
        """Covariance of its numbers, and of the chosen one where that has a standard deviation."""
        covariance = self.covariance
        if self.chosen_std:
            covariance = np.asarray(block_diag(covariance, self.chosen_std**2))
        if not larger or not self.block_std.size:
            return covariance
        std = np.sqrt(np.diagonal(covariance))
        ratio = np.divide(self.block_std, std, out=np.ones_like(std), where=std > 0)
        factor = np.maximum(ratio, 1.0)
        return covariance * np.outer(factor, factor)

    def _reported(self, covariance: Array) -> dict[str, Estimate]:
        """The parameters with a covariance as of `_whole_covariance`."""
        if not self.chosen_std:
            return self.effect.reported(self.values, covariance)
        return self.effect.released().reported(np.append(self.values, self.effect.chosen or 0.0), covariance)


class HeldOut(NamedTuple):
    """Errors on held-out rows, by group of channels: position and orientation of a pose, or the torque of each joint.

    Attributes:
        before: `(group, sample)`, with the nuisance alone: lengths in m and rad, of orientations zero where none were
            measured; or Nm, N of prismatic joints.
        after: likewise, with those of the effects that the other rows support, fitted to these.
        before_over_noise: as `before`, over the noise of each row. A camera sees depth worse than the rest.
        after_over_noise: likewise with the effects.
        with_effects: `(sample,)` bool, whether the rows without a row's fold support any effect.
    """

    before: Array
    after: Array
    before_over_noise: Array
    after_over_noise: Array
    with_effects: Mask

    def without_effects(self) -> "HeldOut":
        """The errors of the nuisance alone, before and after."""
        return self._replace(after=self.before, after_over_noise=self.before_over_noise)


@final
@dataclass(frozen=True, eq=False)
class Withdrawn:
    """Effects that were significant, and do not hold on rows that were not used.

    The errors there, of the rows `kept`, are larger than without them, or several times those on rows that they were
    fitted to.
    """

    findings: tuple[Finding, ...]
    errors: HeldOut
    kept: Mask


@final
@dataclass(frozen=True, eq=False)
class SearchedAgain:
    """Errors on contiguous blocks, which rejected effects that hold when they are fitted without shorter ones.

    Attributes:
        blocks: how many.
        ratio: of the held-out errors with the effects that the other blocks support to those without; of poses that of
            the root mean squares of position, of torques the mean of the logarithms over blocks.
    """

    blocks: int
    ratio: float


class SeparatingPoses(NamedTuple):
    """Poses `(pose, joint)` rad that separate two effects, given by their labels, in an order of short moves.

    They are inside the arm's limits, and not checked for collisions.
    """

    effects: tuple[str, str]
    joint_position: Array


class Against(Protocol):
    """How a recording was compared with a reference."""

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers, with the reference's name as `file`."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class DomainDiagnosis(PublicResult, ABC, Generic[P]):
    """What makes a recording depart from the arm's model: effects and data faults, with held-out errors.

    Attributes:
        problem: the screened recording as an estimation problem, linearised where its model is.
        selection: the search's result: fits without and with the effects.
        findings: the effects, in the order of their numbers in `fit`.
        errors: on held-out rows, with the nuisance alone, and with those of the effects that the other blocks support;
            where that rejected the findings and these hold when they are fitted again, with the findings.
        faults: of the data, in the order in which they were corrected.
        ruled_out: faults that were tested for and are not there; one that may be there in place of a finding is in
            `faults` of that finding.
        options: thresholds.
        folds: `(sample,)` bool each, the rows that were held out together for `errors`.
        outliers: `(sample,)` bool, outlying rows, of torques contacts, and rows without joints; statistics of `errors`
            omit them.
        withdrawn: effects that were not kept, because they do not hold on held-out rows; None where there are none.
        searched_again: errors on contiguous blocks; None where `errors` are these.
        against: how the recording was compared with a reference; None where it was not.
        separating: poses that separate findings from their alternatives.
        beside: the diagnoses of the same recording by other domains.
        shared: quantities on which two of these depend and which a finding concerns.
        refused: by domain, why the recording cannot be diagnosed by it as well, with the remedy.
    """

    domain: ClassVar[DomainName]

    problem: P
    selection: Selection
    findings: tuple[Finding, ...]
    errors: HeldOut
    faults: tuple[DataFault, ...]
    ruled_out: tuple[DataFault, ...]
    options: Options
    folds: Sequence[Mask]
    outliers: Mask
    withdrawn: Withdrawn | None = None
    searched_again: SearchedAgain | None = None
    against: Against | None = None
    separating: tuple[SeparatingPoses, ...] = ()
    beside: "tuple[DomainDiagnosis[Any], ...]" = ()
    shared: tuple[Agreement, ...] = ()
    refused: Mapping[DomainName, str] = field(default_factory=dict)

    @property
    def parts(self) -> "tuple[DomainDiagnosis[Any], ...]":
        """Itself, and the diagnoses of the same recording by other domains."""
        return (self, *self.beside)

    @property
    def fit(self) -> Fit:
        """The fit of the nuisance and all findings."""
        return self.selection.state.fit

    def has(self, effect: Effect) -> bool:
        """Tells whether this very effect is a finding."""
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
        has_findings = bool(self.findings)
        if not has_findings and self._too_few:
            return "undetermined"
        if has_findings and max(self.findings, key=lambda finding: finding.gain).effect.nonparametric:
            return "unnamed"
        if not self._leaves_noise:
            return "partly_explained" if has_findings else "unexplained"
        # What it moves may have gone into numbers of the findings, as the compliance of a joint goes into that of the
        # base where both are loaded alike. One that is significant and yet no finding was refused for a reason of its
        # own; beside effects that were withdrawn, the nearest is that of another model.
        nearest = self.selection.nearest
        options = self.options
        if self.withdrawn is None and nearest and options.engine.level <= nearest[1] < NEARLY_SIGNIFICANT:
            return "undetermined"
        return "explained" if has_findings else "consistent"

    @property
    def before(self) -> Array:
        """Held-out errors with the nuisance alone: of torques `(joint, sample)` Nm, N of prismatic joints; of commands
        `(joint, sample)` rad, of rollouts of the servos; of poses `(sample,)` m, of positions."""
        return self.errors.before

    @property
    def after(self) -> Array:
        """The same with the effects."""
        return self.errors.after

    @property
    @abstractmethod
    def recording(self) -> Recording:
        """As it was screened."""

    @cached_property
    @abstractmethod
    def moves(self) -> tuple[dict[str, Any], ...]:
        """What each finding moves, RMS over rows that are no outliers, by unit; of torques also the joints."""

    @cached_property
    @abstractmethod
    def over_noise(self) -> dict[str, float | None]:
        """What the model leaves over the declared noise, by group of channels; None where none is declared."""

    @cached_property
    def between_reversals(self) -> dict[str, float | None] | None:
        """As `over_noise`, where it is known which way each joint moves; None of poses."""
        return None

    @property
    def most_over_noise(self) -> float | None:
        """The largest of these ratios; None where no noise is declared."""
        return max((ratio for ratio in self.over_noise.values() if ratio is not None), default=None)

    @cached_property
    def acts_at(self) -> Concentration | None:
        """The joint at which most of what is left acts; None where there is no such, and of torques."""
        return None

    @property
    def _too_few(self) -> bool:
        """Tells whether the rows are too few to say anything where nothing was found."""
        return False

    @property
    def _reference(self) -> ReferenceOrigin | None:
        """The reference that the findings are the difference from."""
        against = None if self.against is None else self.against.to_dict()
        if against is None or against["basis"] == "effects":
            return None
        return ReferenceOrigin(against["file"], against["basis"])

    @property
    @abstractmethod
    def _leaves_noise(self) -> bool:
        """Tells whether what the model leaves is noise."""

    @property
    @abstractmethod
    def _noise(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """The noise as declared, and as estimated from the residuals."""

    @abstractmethod
    def _statistics(self, errors: Array, kept: Mask) -> dict[str, Any]:
        """Statistics of held-out errors `(group, sample)`, on the rows kept."""

    @abstractmethod
    def _peak_to_peak(self, k: int) -> dict[str, Estimate]:
        """The range of a nonparametric finding, by its name with its unit."""

    def _distinction(self, k: int, effect: Effect) -> str:
        """The status of an alternative that explains nearly as much as the k-th finding."""
        return "undecided"

    @abstractmethod
    def _own_parts(self) -> dict[str, Any]:
        """The model, and what of the document only this domain has."""

    def to_dict(self) -> dict[str, Any]:
        """The document `lite6jax/diagnosis/3`: codes and numbers in SI units."""
        settings = self.recording.settings
        inliers = ~self.outliers
        nearest = self.nearest
        again = self.searched_again
        withdrawn = self.withdrawn
        faults = list(self.faults)
        outliers = self.outliers & self.problem.valid
        if outliers.any():
            faults.append(DataFault("outliers", tuple(self.recording.row[outliers].tolist())))
        declared, estimated = self._noise
        at = self.acts_at
        return {
            "schema": SCHEMA,
            "domain": self.domain,
            "verdict": self.verdict,
            "samples": self.recording.samples,
            "heldout_rows": int(inliers.sum()),
            "heldout_blocks": block_count(self.folds),
            "searched_again": None if again is None else {"blocks": again.blocks, "heldout_ratio": again.ratio},
            "quick": self.options.quick,
            "date": settings.date,
            "instrument": settings.instrument,
            "source": DOMAINS[self.domain].source(settings),
            "data_faults": [fault.to_dict() for fault in faults],
            "ruled_out": [fault.to_dict() for fault in self.ruled_out],
            "before": self._statistics(self.errors.before, inliers),
            "after": self._statistics(self.errors.after, inliers),
            "left": {
                "over_noise": self.over_noise,
                "between_reversals": self.between_reversals,
                "white": self.fit.noise.white,
                "acts_at": None if at is None else {"site": at.site, "share": at.share, "share_of_noise": at.expected},
            },
            "noise": {"declared": declared, "estimated": estimated},
            "findings": [self._finding(k) for k in range(len(self.findings))],
            "withdrawn": None
            if withdrawn is None
            else {
                "effects": [effect_entry(finding.effect) for finding in withdrawn.findings],
                "before": self._statistics(withdrawn.errors.before, withdrawn.kept),
                "after": self._statistics(withdrawn.errors.after, withdrawn.kept),
            },
            "nearest": None
            if nearest is None
            else {"effect": nearest[0].name, "site": nearest[0].site, "p_value": nearest[1]},
            "untestable": [
                {"effect": item.effect.name, "site": item.effect.site, "driver": item.driver.phrase}
                for item in self.untestable
            ],
            "confounded": [effect_entry(effect) for effect in self.confounded],
            "separating_poses": [
                {"effects": list(item.effects), "joint_position_rad": item.joint_position.tolist()}
                for item in self.separating
            ],
            **({} if self.against is None else {"against": self.against.to_dict()}),
            **self._own_parts(),
            **{f"{domain}_refused": reason for domain, reason in self.refused.items()},
            **self._parts_beside(),
        }

    def _parts_beside(self) -> dict[str, Any]:
        """The documents of the other domains, by their names, and what they share with this one."""
        if not self.beside:
            return {}
        documents = {diagnosis.domain: diagnosis.to_dict() for diagnosis in self.beside}
        return {**documents, "shared": [agreement.to_dict() for agreement in self.shared]}

    def _finding(self, k: int) -> dict[str, Any]:
        finding = self.findings[k]
        size = {}
        if finding.effect.nonparametric:
            ranges = {name: estimate._asdict() for name, estimate in self._peak_to_peak(k).items()}
            size = {"peak_to_peak": ranges, "effective_parameters": finding.effective_parameters}
        if finding.nearest is not None:
            size["nearest"] = effect_entry(finding.nearest[0]) | {"share": finding.nearest[1]}
        if finding.fit_std:
            size["fit_std"] = finding.fit_std
        if finding.input_share:
            size["payload_share"] = finding.input_share
        alternatives = [self._alternative(k, alternative) for alternative in finding.alternatives]
        alternatives += [_fault_alternative(finding.effect, alternative) for alternative in finding.faults]
        return {
            **effect_entry(finding.effect),
            "parameters": {name: estimate._asdict() for name, estimate in finding.parameters.items()},
            **size,
            "p_value": finding.p_value,
            "log_likelihood_gain": finding.gain,
            **self.moves[k],
            "confusable_with": sorted(alternatives, key=lambda entry: entry["log_likelihood_gap"]),
        }

    def _alternative(self, k: int, alternative: Alternative) -> dict[str, Any]:
        """An alternative with its status: rejected, found, separable by designed poses, undecided, or equivalent."""
        effect = alternative.term
        assert isinstance(effect, Effect)
        if alternative.gap >= CLOSE:
            status = "rejected"
        else:
            status = "found"
            if effect not in self.fit.terms.terms:
                status = self._distinction(k, effect)
        entry = {**_stated_effect(effect), **self._wandering(effect)}
        if alternative.together_with:
            entry["together_with"] = [
                _stated_effect(other) for other in alternative.together_with if isinstance(other, Effect)
            ]
        return {**entry, "log_likelihood_gap": alternative.gap, "status": status}

    def _wandering(self, effect: Effect) -> dict[str, Any]:
        """The entry with the memory of an effect that wanders by itself; else, and of most domains, nothing."""
        return {}


def _fault_alternative(effect: Effect, alternative: FaultAlternative) -> dict[str, Any]:
    """A fault that may be there in place of an effect, with the other effects that it would explain or need."""
    code = alternative.fault.code
    entry: dict[str, Any] = {"effect": code, "site": "recording", "fault": code, "numbers": alternative.numbers}
    others = alternative.others(effect)
    if others:
        entry["instead_of"] = [_stated_effect(other) for other in others]
    if alternative.together_with:
        entry["together_with"] = [_stated_effect(other) for other in alternative.together_with]
    return {**entry, "log_likelihood_gap": alternative.gap, "status": "undecided"}


def _stated_effect(effect: Effect) -> dict[str, Any]:
    """Which effect, where, of what, and what tells it from others of its name and site."""
    numbers = {name: getattr(effect, name, None) for name in ("order", "period_m", "source_joint", "component")}
    stated = {name: value for name, value in numbers.items() if value not in (None, "")}
    if "period_m" in stated:  # what an order is of a prismatic joint
        del stated["order"]
    return {**effect_entry(effect), **stated}


def block_count(folds: Sequence[Mask]) -> int:
    """How many contiguous blocks of rows these sets have in all."""
    return sum(int(np.sum(np.diff(fold.astype(int), prepend=0) > 0)) for fold in folds)
