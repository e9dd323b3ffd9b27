"""Tests of one effect over all arms: whether it has a mean, whether any arm has it, whether it drifts.

No effect in any arm is the hypothesis of all three. The first adds scores and information (fixed effect). The second
adds the statistics of the arms, so that the numbers of an effect, as the phase of a gear, may be others in each arm.
The third is the score of a slope over a covariate beside the mean. Each is computed twice, and the larger p-value
counts: in the noise model of each recording, divided by the overdispersion over all that was searched (B. Devlin and
K. Roeder, Biometrics 55, 1999), and from the scatter of scores between blocks of samples (Hotelling's T²; R. Fisher's
combination of the p-values of arms).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri, fdtrc

from lite6jax.populations.evidence import Scan
from lite6jax.populations.hierarchy import ArmLikelihoods
from lite6jax.populations.reduced import Evidence, PooledTerm

Array = NDArray[np.floating]
Way = Literal["mean", "any", "drift"]
WAYS: tuple[Way, ...] = ("mean", "any", "drift")

_ROUNDING = 1e-9


class Statistic(NamedTuple):
    """A quadratic form of scores with its degrees of freedom; χ² where there is no effect."""

    value: float
    freedom: int

    def p_value(self, overdispersion: float) -> float:
        """Of as large a value, once it is divided by the overdispersion."""
        return float(chdtrc(self.freedom, self.value / overdispersion)) if self.freedom else 1.0


@final
@dataclass(frozen=True)
class Overdispersion:
    """By how much statistics are larger than those of the noise models, at least 1: by the median over a search.

    Attributes:
        named: of candidates, by the way of testing.
        waves: of waves.
    """

    named: dict[Way, float]
    waves: dict[Way, float]

    def of(self, term: PooledTerm, way: Way) -> float:
        """That of a term."""
        return (self.named if term.order is None else self.waves)[way]


@final
@dataclass(frozen=True, eq=False)
class Pooled:
    """The statistics of all candidates over all arms.

    Attributes:
        named: of each candidate, by way.
        waves: of each family, values `(order,)` and degrees of freedom `(order,)` by way.
        overdispersion: over this search.
    """

    named: dict[str, dict[Way, Statistic]]
    waves: dict[str, dict[Way, tuple[Array, Array]]]
    overdispersion: Overdispersion


def pooled(scans: Iterable[tuple[int, Scan]], covariate: Array | None) -> Pooled:
    """Adds what all recordings say.

    Args:
        scans: in the order of the arms.
        covariate: `(arm,)`, what effects may drift with, or None.
    """
    named: dict[str, _Sums] = {}
    sums: dict[str, _WaveSums] = {}
    for number, scan in scans:
        x = 0.0 if covariate is None else float(covariate[number])
        for key, (score, information) in scan.named.items():
            named.setdefault(key, _Sums(len(score))).add(score, information, x)
        for key, (score, information) in scan.waves.items():
            sums.setdefault(key, _WaveSums(len(score))).add(score, information, x)
    ways = WAYS if covariate is not None else WAYS[:2]
    of_named = {key: each.statistics(ways) for key, each in named.items()}
    of_waves = {key: each.statistics(ways) for key, each in sums.items()}
    return Pooled(of_named, of_waves, _overdispersion(of_named, of_waves, ways))


def statistics(score: Array, information: Array, covariate: Array, ways: Sequence[Way]) -> dict[Way, Statistic]:
    """The statistics of one effect.

    Args:
        score: `(arm, number)`.
        information: `(arm, number, number)`.
        covariate: `(arm,)`.
        ways: which of them.
    """
    sums = _Sums(score.shape[1])
    for b, G, x in zip(score, information, covariate, strict=True):
        sums.add(b, G, float(x))
    return sums.statistics(ways)


def p_value(term: PooledTerm, evidence: Sequence[Evidence], x: Array, way: Way, over: Overdispersion) -> float:
    """Of one effect in one way, before the search is counted.

    Args:
        term: which.
        evidence: of the arms that show it.
        x: `(arm,)`, of these arms, what effects may drift with.
        way: of testing.
        over: of the search.
    """
    score, information = np.array([e.score for e in evidence]), np.array([e.information for e in evidence])
    white = statistics(score, information, x, WAYS)[way].p_value(over.of(term, way))
    if way == "any":
        # the logarithm of a p-value of zero is that of the smallest number
        logs = np.log(np.maximum([e.p_value for e in evidence], np.finfo(float).tiny))
        return max(white, float(chdtrc(2 * len(logs), -2 * float(logs.sum()))))
    covariance = np.array([e.covariance for e in evidence])
    b, G, C = score.sum(0), information.sum(0), covariance.sum(0)
    if way == "drift":
        moments = np.power(x, np.arange(3)[:, None])[..., None, None] * information
        b, G, centre = _slope(np.array([b, x @ score]), moments.sum(1))
        weights = x[:, None, None] * np.eye(len(b)) - centre
        C = np.einsum("aij,ajk,alk->il", weights, covariance, weights)
    T = _whitening(G)
    k, freedom = T.shape[1], sum(e.blocks - 1 for e in evidence)
    if not k or freedom < k + 1:
        return 1.0
    t = T.T @ b
    t2 = float(t @ np.linalg.lstsq(T.T @ C @ T, t, rcond=None)[0])
    return max(white, float(fdtrc(k, freedom - k + 1, t2 * (freedom - k + 1) / (freedom * k))))


def likelihoods(evidence: Sequence[Evidence | None], typical: Sequence[float], x: Array | None) -> ArmLikelihoods:
    """What the arms say of one effect, for its hierarchical model; nothing where there is no evidence.

    Args:
        evidence: of all arms.
        typical: sizes of its numbers.
        x: `(arm,)`, the covariate, or None.
    """
    size = len(typical)
    score, information = np.zeros((len(evidence), size)), np.zeros((len(evidence), size, size))
    for i, one in enumerate(evidence):
        if one is not None:
            score[i], information[i] = one.score, one.information
    ones = np.ones(len(evidence))
    design = ones[:, None] if x is None else np.stack([ones, x], 1)
    return ArmLikelihoods(score, information, np.array(typical, float), design)


class _Sums:
    """Sums over arms of what the statistics of one effect need: arms come one by one, and few numbers stay."""

    def __init__(self, size: int) -> None:
        self.score = np.zeros((2, size))  # times the covariate to the power 0 and 1
        self.information = np.zeros((3, size, size))
        self.any = Statistic(0.0, 0)

    def add(self, score: Array, information: Array, x: float) -> None:
        self.score += np.stack([score, x * score])
        self.information += np.stack([information, x * information, x**2 * information])
        own = _form(score, information)
        self.any = Statistic(self.any.value + own.value, self.any.freedom + own.freedom)

    def statistics(self, ways: Sequence[Way]) -> dict[Way, Statistic]:
        found: dict[Way, Statistic] = {"mean": _form(self.score[0], self.information[0]), "any": self.any}
        if "drift" in ways:
            b, G, _ = _slope(self.score, self.information)
            found["drift"] = _form(b, G)
        return found


class _WaveSums:
    """Sums over arms of what statistics of the waves of one family need, at every order."""

    def __init__(self, orders: int) -> None:
        self.score = np.zeros((2, orders, 2))  # times the covariate to the power 0 and 1
        self.information = np.zeros((3, orders, 3))
        self.any = np.zeros(orders)
        self.freedom = np.zeros(orders, int)

    def add(self, score: Array, information: Array, x: float) -> None:
        self.score += np.stack([score, x * score])
        self.information += np.stack([information, x * information, x**2 * information])
        shown = information.any(1)
        self.any += _forms(score, information)
        self.freedom += 2 * shown

    def statistics(self, ways: Sequence[Way]) -> dict[Way, tuple[Array, Array]]:
        two = np.where(self.freedom > 0, 2, 0)
        found: dict[Way, tuple[Array, Array]] = {
            "mean": (_forms(self.score[0], self.information[0]), two),
            "any": (self.any, self.freedom),
        }
        if "drift" in ways:
            whole, first, second = (_matrices(each) for each in self.information)
            centre = first @ np.linalg.pinv(whole, hermitian=True)
            b = self.score[1] - np.einsum("oij,oj->oi", centre, self.score[0])
            G = second - centre @ first
            known = np.stack([G[:, 0, 0], G[:, 0, 1], G[:, 1, 1]], 1)
            seen = np.diagonal(G, axis1=1, axis2=2).min(1) > _ROUNDING * self.information[2].max(1)
            found["drift"] = (np.where(seen, _forms(b, known), 0.0), np.where(seen, two, 0))
        return found


def _slope(score: Array, information: Array) -> tuple[Array, Array, Array]:
    """The score `(number,)` and information of a slope beside the mean, and what is taken off the covariate there.

    Args:
        score: `(2, number)`, sums over arms of scores, and of scores times the covariate.
        information: `(3, number, number)`, likewise of information, up to the covariate's square.
    """
    whole, first, second = information
    centre = first @ np.linalg.pinv(whole, hermitian=True)
    G = second - centre @ first
    # what one arm alone shows has no slope
    G[np.abs(G) < _ROUNDING * np.abs(second).max(initial=0.0)] = 0.0
    return score[1] - centre @ score[0], G, centre


def _matrices(packed: Array) -> Array:
    return packed[:, [0, 1, 1, 2]].reshape(-1, 2, 2)


def _forms(score: Array, packed: Array) -> Array:
    """bᵀ G⁻¹ b of many pairs of waves; zero where G is singular."""
    (s, c), (ss, sc, cc) = score.T, packed.T
    determinant = ss * cc - sc**2
    regular = determinant > _ROUNDING * ss * cc
    return np.where(regular, (cc * s**2 - 2 * sc * s * c + ss * c**2) / np.where(regular, determinant, 1.0), 0.0)


def _whitening(G: Array) -> Array:
    """T with TᵀGT the identity of the rank of G."""
    root = np.sqrt(np.maximum(np.diagonal(G), np.finfo(float).tiny))
    eigenvalues, V = np.linalg.eigh(G / np.outer(root, root))
    kept = eigenvalues > _ROUNDING
    return V[:, kept] / np.sqrt(eigenvalues[kept]) / root[:, None]


def _form(b: Array, G: Array) -> Statistic:
    T = _whitening(G)
    along = T.T @ b
    return Statistic(float(along @ along), T.shape[1])


def _overdispersion(
    named: dict[str, dict[Way, Statistic]],
    waves: dict[str, dict[Way, tuple[Array, Array]]],
    ways: Sequence[Way],
) -> Overdispersion:
    of_named, of_waves = dict.fromkeys(WAYS, 1.0), dict.fromkeys(WAYS, 1.0)
    for way in ways:
        of_named[way] = _median_ratio([(one[way].value, one[way].freedom) for one in named.values()])
        pairs = [one[way] for one in waves.values()]
        if pairs:
            of_waves[way] = _median_ratio(np.concatenate([np.stack(pair, 1) for pair in pairs]))
    return Overdispersion(of_named, of_waves)


def _median_ratio(found: Sequence[tuple[float, int]] | Array) -> float:
    """The median of statistics over the median of χ² of their degrees of freedom, at least 1."""
    pairs = np.asarray(found, float).reshape(-1, 2)
    pairs = pairs[pairs[:, 1] > 0]
    return max(1.0, float(np.median(pairs[:, 0] / chdtri(pairs[:, 1], 0.5)))) if len(pairs) else 1.0
