"""The result: effects of a type with mean and spread, each arm's numbers, outliers, drifts; codes and numbers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from lite6jax.checksum import with_checksum
from lite6jax.populations.candidate import Candidate
from lite6jax.populations.evidence import Reduced
from lite6jax.populations.forward import Selected
from lite6jax.populations.functions import Function
from lite6jax.populations.hierarchy import Hierarchy, fitted
from lite6jax.populations.options import PoolingOptions
from lite6jax.populations.pooling import Overdispersion, likelihoods
from lite6jax.populations.reduced import Evidence, Found, PooledTerm
from lite6jax.populations.search import search

Array = NDArray[np.floating]

SCHEMA = "lite6jax/fleet_diagnosis/1"
POINTS = 41
"""Of the curve of a function of one driver."""


@final
@dataclass(frozen=True)
class Member:
    """A recording of the fleet.

    Attributes:
        file: its name.
        about: as in `ReducedArm`; empty where the recording is not used.
        found: by the recording alone.
        unused: why it is not pooled; empty where it is.
    """

    file: str
    about: Mapping[str, Any]
    found: tuple[Found, ...] = ()
    unused: str = ""


@final
@dataclass(frozen=True, eq=False)
class TypeEffect:
    """An effect of the type.

    Attributes:
        selected: which, and how it was found.
        hierarchy: of all arms but the outliers.
        evidence: of each arm beside all other effects; None of an arm that does not show it.
        outliers: p-values of the arms that differ from the others, family-wise over arms and effects, by arm.
        between_p_value: of estimates that vary as much if all arms but the outliers are alike (W. Cochran, Biometrics
            10, 1954).
        drift_p_value: of as large a slope, family-wise over effects, in a model whose arms vary about a line; None
            where there is no covariate.
    """

    selected: Selected
    hierarchy: Hierarchy
    evidence: tuple[Evidence | None, ...]
    outliers: Mapping[int, float]
    between_p_value: float
    drift_p_value: float | None

    def estimates(self) -> list[tuple[Array, Array] | None]:
        """Of each arm the numbers and their standard deviations; None of an arm that does not show the effect.

        Those of an outlier are of its recording alone; the others are estimates of empirical Bayes.
        """
        values, covariances = self.hierarchy.shrunken()
        usual = iter(zip(values, covariances, strict=True))
        found: list[tuple[Array, Array] | None] = []
        for arm, one in enumerate(self.evidence):
            if arm in self.outliers:
                assert one is not None
                covariance = np.linalg.pinv(one.information, rcond=1e-12, hermitian=True)
                found.append((covariance @ one.score, np.sqrt(np.diagonal(covariance))))
                continue
            value, covariance = next(usual)
            std = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
            found.append(None if one is None else (value, std))
        return found


@final
@dataclass(frozen=True, eq=False)
class Population:
    """What the arms of a type share, and which of them differ.

    Attributes:
        arm: the name of the nominal arm.
        members: all recordings.
        used: the places of those that were pooled, in `members`.
        effects: in the order in which they were found.
        candidates: by key, of all recordings, with functions without a name.
        functions: these, over the ranges of all recordings.
        overdispersion: of the statistics of what was searched.
        searched: the effective number of independent candidates.
        dates: `(used,)`, days as ordinals, where recordings are of one arm over time; else None. Means are those at
            their mean.
        options: thresholds.
    """

    arm: str
    members: tuple[Member, ...]
    used: tuple[int, ...]
    effects: tuple[TypeEffect, ...]
    candidates: Mapping[str, Candidate]
    functions: Mapping[str, Function]
    overdispersion: Overdispersion
    searched: float
    dates: Array | None
    options: PoolingOptions

    def to_dict(self) -> dict[str, Any]:
        """The document `lite6jax/fleet_diagnosis/1`: codes, numbers in SI units, a checksum."""
        return with_checksum(
            {
                "schema": SCHEMA,
                "arm": self.arm,
                "over": None if self.dates is None else "date",
                "mean_date": None
                if self.dates is None
                else date.fromordinal(round(float(self.dates.mean()))).isoformat(),
                "level": self.options.engine.level,
                "searched": self.searched,
                "recordings": [self._member(i) for i in range(len(self.members))],
                "effects": [self._effect(effect) for effect in self.effects],
            }
        )

    def _member(self, place: int) -> dict[str, Any]:
        member = self.members[place]
        arm = self.used.index(place) if place in self.used else None
        outlying = [] if arm is None else [effect for effect in self.effects if arm in effect.outliers]
        return {
            "file": member.file,
            "used": arm is not None,
            "reason": member.unused or None,
            "date": member.about.get("date"),
            "verdict": member.about.get("verdict"),
            "found_alone": [{"label": one.label, "p_value": one.p_value} for one in member.found],
            "outlier_in": [self._named(effect.selected.term, effect.selected.candidate) for effect in outlying],
        }

    def _named(self, term: PooledTerm, candidate: Candidate) -> dict[str, Any]:
        order = {} if term.order is None else {"order": term.order}
        source = term.key.partition("source_joint=")[2].partition(",")[0]
        if source:
            order = {"source_joint": int(source)}
        return {"effect": candidate.effect, "site": candidate.site, "driver": candidate.driver, **order}

    def _effect(self, effect: TypeEffect) -> dict[str, Any]:
        selected, hierarchy = effect.selected, effect.hierarchy
        names, size = selected.candidate.names, len(selected.candidate.names)
        mean, std, half = hierarchy.coefficients[0], hierarchy.std[0], hierarchy.half_width[0]
        parameters = {
            name: {
                "mean": float(mean[i]),
                "std": float(std[i]),
                "interval_95": [float(mean[i] - half[i]), float(mean[i] + half[i])],
                "between_std": float(hierarchy.between[i]),
            }
            for i, name in enumerate(names)
        }
        document = {
            **self._named(selected.term, selected.candidate),
            "found_by": selected.shown,
            "p_value": selected.p_value,
            "parameters": parameters,
            "between_p_value": effect.between_p_value,
        }
        if selected.term.order is not None:
            unit = names[0].rpartition("_")[2]
            document[f"amplitude_rms_{unit}"] = float(np.sqrt(np.sum(mean**2 + hierarchy.between**2)))
        function = self.functions.get(selected.term.key)
        if function is not None and function.is_curve:
            values, (low, high) = hierarchy.coefficients[0], function.ranges[0]
            at = np.linspace(low, high, POINTS)
            B = function.basis(at[None])
            covariance = hierarchy.covariance[: len(B), : len(B)]
            document["curve"] = {
                "name": f"curve_{function.units[0]}",
                "driver": at.tolist(),
                "mean": (values @ B).tolist(),
                "std": np.sqrt(np.maximum(np.einsum("is,ij,js->s", B, covariance, B), 0.0)).tolist(),
            }
        if selected.nearest is not None:
            term, share = selected.nearest
            document["nearest"] = {**self._named(term, self.candidates[term.key]), "share": share}
        if effect.drift_p_value is not None:
            slope, std, half = (each[1] for each in (hierarchy.coefficients, hierarchy.std, hierarchy.half_width))
            document["drift"] = {
                "p_value": effect.drift_p_value,
                "per_day": {
                    names[i]: {
                        "value": float(slope[i]),
                        "std": float(std[i]),
                        "interval_95": [float(slope[i] - half[i]), float(slope[i] + half[i])],
                    }
                    for i in range(size)
                },
            }
        document["arms"] = [
            {
                "file": self.members[self.used[arm]].file,
                "parameters": {
                    name: {"value": float(found[0][i]), "std": float(found[1][i])} for i, name in enumerate(names)
                },
                "outlier_p_value": effect.outliers.get(arm),
            }
            for arm, found in enumerate(effect.estimates())
            if found is not None
        ]
        document["rivals"] = [
            {**self._named(term, self.candidates[term.key]), "log_likelihood_gap": float(gap)}
            for term, gap in selected.rivals
        ]
        return document


def diagnose_population(
    arm: str,
    members: Sequence[Member],
    used: Sequence[int],
    candidates: Mapping[str, Candidate],
    reduced: Reduced,
    dates: Array | None = None,
    progress: Callable[[int], object] = lambda effects: None,
) -> Population:
    """Finds what the arms of a type share, and which of them differ.

    Args:
        arm: the name of the nominal arm.
        members: all recordings.
        used: places of those in `reduced`, in its order.
        candidates: by key, of all recordings.
        reduced: the recordings.
        dates: `(used,)`, days as ordinals, where recordings are of one arm over time.
        progress: called with the number of effects at each round of the search.
    """
    options, covariate = reduced.options, None if dates is None else dates - dates.mean()
    outcome = search(reduced, candidates, [members[i].found for i in used], covariate, progress)
    effects = [
        _effect(selected, evidence, covariate, len(outcome.selected), options)
        for selected, evidence in zip(outcome.selected, outcome.evidence, strict=True)
    ]
    return Population(
        arm=arm,
        members=tuple(members),
        used=tuple(used),
        effects=tuple(effects),
        candidates={**candidates, **{key: function.candidate for key, function in reduced.functions.items()}},
        functions=reduced.functions,
        overdispersion=outcome.overdispersion,
        searched=outcome.searched,
        dates=dates,
        options=options,
    )


def _effect(
    selected: Selected,
    evidence: tuple[Evidence | None, ...],
    covariate: Array | None,
    effects: int,
    options: PoolingOptions,
) -> TypeEffect:
    """The hierarchical model of an effect without the arms that differ from the others, one after the other."""
    whole = likelihoods(evidence, selected.candidate.typical, covariate)
    kept, outliers = list(range(len(evidence))), dict[int, float]()
    hierarchy = fitted(whole)
    assert hierarchy is not None, "an effect was selected that no arm shows"
    shown = sum(one is not None for one in evidence)
    while shown - len(outliers) >= options.fewest_arms:
        p_values = [hierarchy.outlier_p_value(i) for i in range(len(kept))]
        most = int(np.argmin(p_values))
        p = min(p_values[most] * shown * effects, 1.0)
        if p >= options.engine.level:
            break
        outliers[kept.pop(most)] = p
        rest = fitted(hierarchy.arms.without(most))
        assert rest is not None
        hierarchy = rest
    return TypeEffect(
        selected,
        hierarchy,
        evidence,
        outliers,
        _between_p_value(hierarchy),
        None if covariate is None else _drift_p_value(hierarchy, effects),
    )


def _between_p_value(hierarchy: Hierarchy) -> float:
    """Cochran's test that all arms are alike."""
    arms = hierarchy.arms
    values, _, along = arms.eigen
    coefficients, M, *_ = arms.solved(0.0)
    shown = values > 0
    each = float(np.sum(along[shown] ** 2 / values[shown]))
    freedom = int(shown.sum()) - hierarchy.determined
    return float(chdtrc(freedom, max(each - float(coefficients @ M @ coefficients), 0.0))) if freedom > 0 else 1.0


def _drift_p_value(hierarchy: Hierarchy, effects: int) -> float:
    """Of a slope as large, by F with the degrees of freedom of its interval."""
    size = hierarchy.coefficients.shape[1]
    slope, covariance = hierarchy.coefficients[1], hierarchy.covariance[size:, size:]
    root = np.sqrt(np.maximum(np.diagonal(covariance), np.finfo(float).tiny))
    squared = float((slope / root) @ np.linalg.pinv(covariance / np.outer(root, root), hermitian=True) @ (slope / root))
    return min(float(fdtrc(size, hierarchy.freedom, squared / size)) * effects, 1.0)
