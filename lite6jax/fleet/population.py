"""The result: effects of a type with mean and spread, each arm's numbers, outliers; codes and numbers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from lite6jax.array_types import Array
from lite6jax.effects.drivers import driver_of
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.projection import scaled_inverse
from lite6jax.fleet import FLEET
from lite6jax.fleet.hierarchy import Hierarchy, fitted
from lite6jax.fleet.pooling import PooledEvidence, Reduced, Search
from lite6jax.fleet.terms import Candidate, FleetProcess, Tested, Tried

_FEWEST_ARMS = 5
"""Arms below which none is said to differ from the others; four give a variance."""

POINTS = 41
"""Of the curve of a function of one driver."""


@final
@dataclass(frozen=True)
class Member:
    """A recording of the fleet.

    Attributes:
        file: its name.
        about: as in `ReducedArm`; empty where the recording is not used.
        found: as in `Heading`.
        unused: why it is not pooled; empty where it is.
    """

    file: str
    about: Mapping[str, Any]
    found: tuple[tuple[str, float], ...] = ()
    unused: str = ""


@final
@dataclass(frozen=True, eq=False)
class TypeEffect:
    """An effect of the type.

    Attributes:
        selected: which, and how it was found.
        candidate: as a report names it.
        hierarchy: of all arms but the outliers.
        outliers: p-values of the arms that differ from the others, family-wise over arms and effects, by arm.
    """

    selected: PooledEvidence
    candidate: Candidate
    hierarchy: Hierarchy
    outliers: Mapping[int, float]

    def estimates(self) -> list[tuple[Array, Array] | None]:
        """The numbers of each arm and their standard deviations; None of an arm that does not show the effect.

        Those of an outlier are of its recording alone; the others are estimates of empirical Bayes.
        """
        usual = iter(zip(*self.hierarchy.shrunken(), strict=True))
        estimates: list[tuple[Array, Array] | None] = []
        for arm, arm_evidence in enumerate(self.selected.evidence):
            if arm in self.outliers:
                assert arm_evidence is not None
                covariance = scaled_inverse(
                    arm_evidence.information + np.eye(len(arm_evidence.score)) / self.selected.variance
                )
                value = covariance @ arm_evidence.score
            else:
                value, covariance = next(usual)
            std = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
            estimates.append(None if arm_evidence is None else (value, std))
        return estimates


@final
@dataclass(frozen=True, eq=False)
class Population:
    """What the arms of a type share, and which of them differ.

    Attributes:
        arm: the name of the nominal arm.
        members: all recordings.
        effects: in the order in which they were found.
        tried: all that the recordings were tested for.
        options: thresholds.
    """

    arm: str
    members: tuple[Member, ...]
    effects: tuple[TypeEffect, ...]
    tried: Tried
    options: EngineOptions

    @cached_property
    def used(self) -> tuple[int, ...]:
        """The places of those that were pooled, in `members`."""
        return tuple(i for i, member in enumerate(self.members) if not member.unused)

    def to_dict(self) -> dict[str, Any]:
        """The document `lite6jax/fleet_diagnosis/1`: codes, and numbers in SI units."""
        return {
            "schema": FLEET,
            "arm": self.arm,
            "level": self.options.level,
            "recordings": [self._member(i) for i in range(len(self.members))],
            "effects": [self._effect(effect) for effect in self.effects],
        }

    def _member(self, place: int) -> dict[str, Any]:
        member = self.members[place]
        arm = self.used.index(place) if place in self.used else None
        return {
            "file": member.file,
            "used": arm is not None,
            "reason": member.unused or None,
            "date": member.about.get("date"),
            "verdict": member.about.get("verdict"),
            "found_alone": [{"label": label, "p_value": p_value} for label, p_value in member.found],
            "outlier_in": [self._named(effect.selected.term) for effect in self.effects if arm in effect.outliers],
        }

    def _named(self, term: Tested) -> dict[str, Any]:
        candidate = self.tried.candidate(term)
        further = dict[str, Any]()
        if isinstance(term, FleetProcess):
            further = {"component": term.component, "kernel": term.kernel}
        elif term.order is not None:
            further = {"order": term.order}
        elif source := term.key.partition("source_joint=")[2].partition(",")[0]:
            further = {"source_joint": int(source)}
        return {"effect": candidate.effect, "site": candidate.site, "driver": candidate.driver, **further}

    def _effect(self, effect: TypeEffect) -> dict[str, Any]:
        selected = effect.selected
        hierarchy = effect.hierarchy
        names = effect.candidate.names
        mean = hierarchy.mean
        document = {
            **self._named(selected.term),
            "found_by": selected.way,
            "p_value": selected.p_value,
            "parameters": {
                name: _interval(hierarchy, i) | {"between_std": float(hierarchy.between[i])}
                for i, name in enumerate(names)
            },
            "between_p_value": hierarchy.between_p_value,
        }
        if isinstance(selected.term, FleetProcess):
            document |= _curve(selected.term, hierarchy)
        elif selected.term.order is not None:
            unit = names[0].rpartition("_")[2]
            document[f"amplitude_rms_{unit}"] = float(np.sqrt(np.sum(mean**2 + hierarchy.between**2)))
        if selected.nearest is not None:
            document["nearest"] = {**self._named(selected.nearest[0]), "share": selected.nearest[1]}
        document["arms"] = [
            {
                "file": self.members[self.used[arm]].file,
                "parameters": {
                    name: {"value": float(estimate[0][i]), "std": float(estimate[1][i])} for i, name in enumerate(names)
                },
                "outlier_p_value": effect.outliers.get(arm),
            }
            for arm, estimate in enumerate(effect.estimates())
            if estimate is not None
        ]
        document["rivals"] = [{**self._named(term), "log_likelihood_gap": gap} for term, gap in selected.rivals]
        return document


def _interval(hierarchy: Hierarchy, number: int) -> dict[str, Any]:
    """A mean with its standard deviation and its 95 % interval."""
    value, std, half = (float(statistic[number]) for statistic in (hierarchy.mean, hierarchy.std, hierarchy.half_width))
    return {"mean": value, "std": std, "interval_95": [value - half, value + half]}


def _curve(process: FleetProcess, hierarchy: Hierarchy) -> dict[str, Any]:
    """The mean of a process of one driver, or of one and of a direction of motion, then forwards."""
    further = [driver_of(phrase).discrete for phrase in process.drivers[1:]]
    if not all(further):
        return {}
    low, high, *further_bounds = process.bounds
    at = np.linspace(low, high, POINTS)
    values = np.stack([at, *(np.full(POINTS, upper) for upper in further_bounds[1::2])])
    B = process.functions(values)
    std = np.sqrt(np.maximum(np.einsum("is,ij,js->s", B, hierarchy.covariance, B), 0.0))
    mean = hierarchy.mean @ B
    name = f"curve_{process.unit}"
    return {"curve": {"name": name, "driver": at.tolist(), "mean": mean.tolist(), "std": std.tolist()}}


def diagnose_population(
    arm: str,
    members: Sequence[Member],
    candidate_terms: Tried,
    reduced: Reduced,
    progress: Callable[[int], object] = lambda effects: None,
) -> Population:
    """Finds what the arms of a type share, and which of them differ.

    Args:
        arm: the name of the nominal arm.
        members: all recordings.
        candidate_terms: all that they are tested for.
        reduced: the recordings that are used, in their order.
        progress: called with the number of effects at each round of the search.
    """
    selected = Search(reduced, candidate_terms, progress).selected()
    effects = [
        _effect(weighed, candidate_terms.candidate(weighed.term), len(selected), reduced.options)
        for weighed in selected
    ]
    return Population(arm, tuple(members), tuple(effects), candidate_terms, reduced.options)


def _effect(selected: PooledEvidence, candidate: Candidate, effects: int, options: EngineOptions) -> TypeEffect:
    """The hierarchical model of an effect without the arms that differ from the others, one after the other."""
    evidence = selected.evidence
    included = list(range(len(evidence)))
    outliers = dict[int, float]()
    hierarchy = fitted(selected.likelihoods(candidate.typical))
    assert hierarchy is not None, "an effect was selected that too few arms show"
    shown = sum(arm_evidence is not None for arm_evidence in evidence)
    while shown - len(outliers) >= _FEWEST_ARMS:
        p_values = [hierarchy.outlier_p_value(i) for i in range(len(included))]
        farthest = int(np.argmin(p_values))
        p = min(p_values[farthest] * shown * effects, 1.0)
        if p >= options.level:
            break
        outliers[included.pop(farthest)] = p
        refitted = fitted(hierarchy.arms.without(farthest))
        assert refitted is not None
        hierarchy = refitted
    return TypeEffect(selected, candidate, hierarchy, outliers)
